"""``mirdrake identify``: parameters of a model from recorded drives; one module a sub-verb, a study is the default."""

import argparse
from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from typing import Any

HELP = "fit the parameters of a model to recorded drives"
MORE = """\
examples:
  mirdrake identify check drives.yaml               check the logs before any fit
  mirdrake identify study.yaml                      check, fit, table and report
  mirdrake identify study.yaml --set model.tyres=fiala --out runs/fiala
  mirdrake identify apply runs/study bolt           write the result and its source into vehicle.yaml"""

VERBS = {"run": "identify_run", "check": "identify_check", "apply": "identify_apply"}
"""Module of each sub-verb in this package; a file name in its place stands for ``run``."""


class _Verbs(argparse._SubParsersAction):  # type: ignore[type-arg]
    """Sub-verbs, with ``run`` for anything that is none."""

    def __call__(self, parser: Any, namespace: Any, values: Any, option_string: Any = None) -> None:
        words: Sequence[str] = values
        super().__call__(parser, namespace, words if words[0] in VERBS else ["run", *words], option_string)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's arguments."""
    verbs = parser.add_subparsers(title="what to do", metavar="VERB|STUDY.yaml", required=True, action=_Verbs)
    for name, module in VERBS.items():
        if find_spec(f"mirdrake.cli.{module}") is None:
            continue
        verb = import_module(f"mirdrake.cli.{module}")
        text = f"{verb.HELP}\n\n{verb.MORE}".strip()
        child = verbs.add_parser(
            name, help=verb.HELP, description=text, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        child.set_defaults(subverb=verb)
        verb.add_arguments(child)
    verbs.choices = None  # type: ignore[assignment]  # any first word is allowed: it may be a file


def run(options: argparse.Namespace) -> int:
    """Run the sub-verb."""
    code: int = options.subverb.run(options)
    return code
