"""Verbs of the command line and their parser; the module of a verb is imported only when the verb is used."""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

from mirdrake.core.errors import did_you_mean


@dataclass(frozen=True)
class Verb:
    """A verb, with a module or with verbs below it.

    The module has ``MORE`` (text below the help line, with examples), ``add_arguments(parser)`` and ``run(options)``,
    which returns the exit code.

    Attributes:
        help: one line.
        module: name of the module in :mod:`mirdrake.cli`; empty for a verb that has others below it.
        more: text below the help line, for a verb without a module.
        verbs: the verbs below it.
        default: entry of ``verbs`` that applies if the next word is not one of them, as in ``identify study.yaml``.
    """

    help: str
    module: str = ""
    more: str = ""
    verbs: Mapping[str, "Verb"] = field(default_factory=dict)
    default: str = ""


class VerbParser(argparse.ArgumentParser):
    """Parser of a verb that learns its arguments when it is used for the first time."""

    def __init__(self, *args: Any, verb: Verb | None = None, **kwargs: Any) -> None:
        kwargs.setdefault("formatter_class", argparse.RawDescriptionHelpFormatter)
        super().__init__(*args, **kwargs)
        self._verb = verb
        self._is_complete = verb is None

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Complete the parser, then parse."""
        if not self._is_complete:
            self._is_complete = True
            assert self._verb is not None
            self._add_arguments(self._verb)
        verb = self._verb
        if verb is not None and verb.default and args and args[0] not in {*verb.verbs, "-h", "--help"}:
            args = [verb.default, *args]
        namespace, unknown = super().parse_known_args(args, namespace)
        # Here, so that the usage of this verb is printed and not that of the whole program.
        if unknown and verb is not None and not verb.verbs:
            options = [option for option in self._option_string_actions if option.startswith("--")]
            near = did_you_mean(unknown[0], options).partition(" (allowed")[0] if unknown[0].startswith("-") else ""
            self.error(f"unrecognized arguments: {' '.join(unknown)}" + (f"; {near}" if near.endswith("?") else ""))
        return namespace, unknown

    def _add_arguments(self, verb: Verb) -> None:
        if verb.verbs:
            self.description = f"{verb.help}\n\n{verb.more}".strip()
            add_verbs(self, verb.verbs)
            return
        module = import_module(f"mirdrake.cli.{verb.module}")
        self.description = f"{verb.help}\n\n{module.MORE}".strip()
        module.add_arguments(self)
        self.set_defaults(execute=module.run)


def add_verbs(parser: argparse.ArgumentParser, verbs: Mapping[str, Verb]) -> None:
    """Add verbs to a parser; none of their modules is imported."""
    group = parser.add_subparsers(title="commands", metavar="COMMAND", required=True, parser_class=VerbParser)
    for name, verb in verbs.items():
        group.add_parser(name, help=verb.help, verb=verb)


def modules(verbs: Mapping[str, Verb]) -> Sequence[str]:
    """Return the names of the modules of all verbs, those below others included."""
    return [name for verb in verbs.values() for name in ([verb.module] if verb.module else modules(verb.verbs))]
