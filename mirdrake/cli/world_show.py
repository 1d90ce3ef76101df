"""``mirdrake world show``: show a world and what a check of it finds."""

import argparse
import sys
from pathlib import Path

from mirdrake.cli.common import add_param, add_set, world_overrides

MORE = """\
Red: props that overlap, are buried or float, each with a needle above. Green arrows: starts. Blue: goals. Violet: the
paths of the vehicles of tests and rules. A name that would cover another one at first is left out; names of faults and
actors come first. Keys: N names, C collision shapes, F faults, P paths; Escape or Ctrl-C ends.
Faults are printed as well. Exit codes: 0 shown, 2 the world cannot be laid out.

examples:
  mirdrake world show parking_lot
  mirdrake world show parking_lot --set seed=3 --save lot.html        a page that opens offline"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("file", metavar="FILE", help="name or path of a world")
    add_set(parser, "seed=3")
    add_param(parser)
    parser.add_argument("--vehicle", metavar="NAME", help="a vehicle that must fit at all starts")
    parser.add_argument("--save", type=Path, metavar="FILE", help="write an HTML page that opens offline, and stop")
    parser.add_argument("--collision", action="store_true", help="show the collision shapes at first")
    parser.add_argument("--no-names", action="store_true", help="hide the names at first")


def run(options: argparse.Namespace) -> int:
    """Show the world until the page or Ctrl-C ends it."""
    from mirdrake.core.yaml_io import display_path
    from mirdrake.viewer.meshcat import meshcat_faults
    from mirdrake.viewer.show import write_page
    from mirdrake.viewer.world_view import show_examination
    from mirdrake.world_checks import examine

    # A world with faults is shown as well, with the faults marked; only an unreadable one is not.
    result = examine(options.file, overrides=world_overrides(options), vehicle=options.vehicle)
    for fault in result.faults:
        print(f"error: {fault}", file=sys.stderr)
    if result.world is None:
        return 2
    offline = options.save is not None
    meshcat, view = show_examination(result, offline=offline, collision=options.collision, names=not options.no_names)
    if options.save is not None:
        write_page(meshcat, options.save)
        print(display_path(options.save))
        return 0
    print(f"Meshcat: {meshcat.web_url()}  (Ctrl-C ends)", flush=True)
    with meshcat_faults():
        view.run()
    return 0
