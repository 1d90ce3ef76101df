"""``mirdrake check``: every fault with file and line, without running."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from mirdrake.cli.verb import add_set, kind_of
from mirdrake.errors import MirdrakeError

HELP = "check diagrams, vehicles and worlds without running them"
MORE = """\
Every fault is one line with file and line number; the exit code is 2 if there is one.

example:
  mirdrake check bolt test_track my_diagram.yaml"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's arguments."""
    parser.add_argument("names", nargs="+", metavar="NAME", help="names or paths")
    add_set(parser)


def run(options: argparse.Namespace) -> int:
    """Check each."""
    faults = 0
    for name in options.names:
        try:
            notes = _check_one(name, options.set)
        except MirdrakeError as error:
            faults += 1
            for line in str(error).splitlines():
                print(f"error: {line}", file=sys.stderr)
            continue
        print(f"{name}: sound")
        for note in notes:
            print(f"  {note}")
    return 2 if faults else 0


def _check_one(name: str, overrides: Sequence[str]) -> list[str]:
    """Check one thing; returns remarks that are no faults."""
    from mirdrake.diagram import assemble, load_diagram
    from mirdrake.vehicles import load_vehicle
    from mirdrake.worlds import load_world

    kind = kind_of(name)
    if kind == "models":
        return list(load_vehicle(name).warnings)
    if kind == "worlds":
        load_world(name)
        return []
    assembly = assemble(load_diagram(str(Path(name) / "spec.yaml") if kind == "runs" else name, overrides=overrides))
    return [f"output '{port}' is not read" for port in assembly.unread]
