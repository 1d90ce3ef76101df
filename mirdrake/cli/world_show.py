"""``mirdrake world show``: look at a world and at what a check of it finds."""

import argparse
import sys
from pathlib import Path

from mirdrake.cli.world_check import add_changes, changes

HELP = "look at a world in Meshcat, overlaps in red"
MORE = """\
Red: what overlaps, is buried or hangs in the air, each with a needle. Green arrows: starts. Blue: goals. Violet: the
ways that vehicles of tests and rules have. Keys: N names, C collision shapes, F faults, W ways; Escape or Ctrl-C ends.
What is wrong is printed, too. Exit codes: 0 shown, 2 the world cannot be laid out.

examples:
  mirdrake world show parking_lot
  mirdrake world show parking_lot --set seed=3 --save lot.html        a page that opens offline"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's arguments."""
    parser.add_argument("file", metavar="FILE", help="name or path of a world")
    add_changes(parser)
    parser.add_argument("--vehicle", metavar="NAME", help="a vehicle that must have room at all starts")
    parser.add_argument("--save", type=Path, metavar="FILE", help="write an HTML page that opens offline, and stop")
    parser.add_argument("--collision", action="store_true", help="show the collision shapes at first")
    parser.add_argument("--no-names", action="store_true", help="hide the names at first")


def run(options: argparse.Namespace) -> int:
    """Show."""
    from mirdrake.core.yaml_io import shown
    from mirdrake.viewer.meshcat import meshcat_faults
    from mirdrake.viewer.show import write_page
    from mirdrake.viewer.world_view import show_found
    from mirdrake.world_checks import examine

    found = examine(options.file, overrides=changes(options), vehicle=options.vehicle)
    for fault in found.faults:
        print(f"error: {fault}", file=sys.stderr)
    if found.world is None:
        return 2
    offline = options.save is not None
    meshcat, view = show_found(found, offline=offline, collision=options.collision, names=not options.no_names)
    if options.save is not None:
        write_page(meshcat, options.save)
        print(shown(options.save))
        return 0
    print(f"Meshcat: {meshcat.web_url()}  (Ctrl-C ends)", flush=True)
    with meshcat_faults():
        view.run()
    return 0
