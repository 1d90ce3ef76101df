"""``mirdrake world``: check, build, show, test, search and import worlds; one module a sub-verb."""

import argparse
from importlib import import_module

HELP = "check, build, show, test, search or import worlds"
MORE = """\
examples:
  mirdrake world check parking_lot            every fault with file and line
  mirdrake world build parking_lot -o out     lock file, SDF world and plan picture
  mirdrake world show parking_lot             look at it in Meshcat, overlaps in red
  mirdrake world test parking_lot barrels     run all tests with all variations; pass or fail
  mirdrake world import old.world             a world of Gazebo as a world file"""

VERBS = {
    "check": "world_check",
    "build": "world_build",
    "show": "world_show",
    "test": "world_test",
    "search": "world_search",
    "import": "world_import",
}
"""Module of each sub-verb in this package."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's arguments."""
    verbs = parser.add_subparsers(title="what to do", metavar="VERB", required=True)
    for name, module in VERBS.items():
        verb = import_module(f"mirdrake.cli.{module}")
        text = f"{verb.HELP}\n\n{verb.MORE}".strip()
        child = verbs.add_parser(
            name, help=verb.HELP, description=text, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        child.set_defaults(subverb=verb)
        verb.add_arguments(child)


def run(options: argparse.Namespace) -> int:
    """Do it."""
    code: int = options.subverb.run(options)
    return code
