"""Verbs of the command line and their parser; the module of a verb is imported only when the verb is used."""

import argparse
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, NoReturn

from mirdrake.core.errors import closest, did_you_mean


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

    def __init__(
        self, *args: Any, verb: Verb | None = None, verbs: Mapping[str, Verb] | None = None, **kwargs: Any
    ) -> None:
        kwargs.setdefault("formatter_class", argparse.RawDescriptionHelpFormatter)
        super().__init__(*args, **kwargs)
        self._verb, self._verbs = verb, verbs or {}
        self._meant = ""  # name of another verb, if the first argument of this default verb is similar to it
        self._is_complete = verb is None

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Complete the parser, then parse."""
        if not self._is_complete:
            self._is_complete = True
            assert self._verb is not None
            self._add_arguments(self._verb)
        verb = self._verb
        if verb is not None and verb.default and args and args[0] not in {*verb.verbs, "-h", "--help"}:
            self._default_parser()._meant = closest(args[0], verb.verbs) or ""
            args = [verb.default, *args]
        namespace, unknown = super().parse_known_args(args, namespace)
        # Here, so that the help of this verb is named and not that of the whole program.
        if unknown and verb is not None and not verb.verbs:
            self.error(f"unknown arguments: {' '.join(unknown)}{self._hint(unknown[0].partition('=')[0])}")
        return namespace, unknown

    def _default_parser(self) -> "VerbParser":
        """Return the parser of the default verb."""
        assert self._verb is not None
        (action,) = (action for action in self._actions if isinstance(action, argparse._SubParsersAction))
        parser = action.choices[self._verb.default]
        assert isinstance(parser, VerbParser)
        return parser

    def error(self, message: str) -> NoReturn:
        """Print what is wrong in one line, without the usage, and exit with code 2."""
        text = message.removeprefix("argument ")
        self.exit(2, f"error: {text}{' ' if text.endswith('?') else '; '}see {self.prog} --help\n")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Raise an error with the most similar of the allowed values."""
        if action.choices is not None and value not in action.choices:
            raise argparse.ArgumentError(action, f"unknown '{value}'; {did_you_mean(value, action.choices)}")

    def _hint(self, option: str) -> str:
        """Return what an unknown option may be: a misspelt one of this verb, or one of other verbs."""
        if not option.startswith("--"):
            return f"; did you mean the command '{self._meant}'?" if self._meant else ""
        if others := [name for name, module in modules(self._verbs) if option in _options(module)]:
            program = self.prog.partition(" ")[0]
            return f"; it is an option of {', '.join(f'{program} {name}' for name in others)} only"
        # Compared without the dashes, which all options have.
        near = closest(option[2:], [name[2:] for name in self._option_string_actions if name.startswith("--")])
        return f"; did you mean '--{near}'?" if near else ""

    def _add_arguments(self, verb: Verb) -> None:
        if verb.verbs:
            self.description = f"{verb.help}\n\n{verb.more}".strip()
            add_verbs(self, verb.verbs, self._verbs)
            return
        module = import_module(f"mirdrake.cli.{verb.module}")
        self.description = f"{verb.help}\n\n{module.MORE}".strip()
        module.add_arguments(self)
        self.set_defaults(execute=module.run)


def add_verbs(
    parser: argparse.ArgumentParser, verbs: Mapping[str, Verb], all_verbs: Mapping[str, Verb] | None = None
) -> None:
    """Add verbs to a parser; none of their modules is imported.

    Args:
        parser: parser of the program, or of a verb that has others below it.
        verbs: the verbs.
        all_verbs: verbs of the program, for hints to their options; `verbs` if None.
    """
    group = parser.add_subparsers(title="commands", metavar="COMMAND", required=True, parser_class=VerbParser)
    for name, verb in verbs.items():
        group.add_parser(name, help=verb.help, verb=verb, verbs=all_verbs or verbs)


def modules(verbs: Mapping[str, Verb], above: str = "") -> Sequence[tuple[str, str]]:
    """Return name and module of all verbs, those below others included, such as ``world test``."""
    found: list[tuple[str, str]] = []
    for key, verb in verbs.items():
        name = f"{above} {key}".strip()
        found += [(name, verb.module)] if verb.module else modules(verb.verbs, name)
    return found


def _options(module: str) -> Collection[str]:
    """Return the options of the verb of a module."""
    parser = argparse.ArgumentParser()
    import_module(f"mirdrake.cli.{module}").add_arguments(parser)
    return parser._option_string_actions
