"""``mirdrake world check``: every fault of worlds with file and line, before anything runs."""

import argparse
import sys

HELP = "check worlds: every fault with file and line"
MORE = """\
Props that overlap (how deep and where), that are buried or hang in the air; starts and goals in a prop; goals to which
a vehicle has no way; broken rules; faults of tests. A vehicle is that of a test or of a rule `drivable`; --vehicle
tries one more at all starts. At last the plant is built and makes a few steps with that vehicle, or a car, at the first
start.
Exit codes: 0 sound, 2 faults.

examples:
  mirdrake world check parking_lot
  mirdrake world check lots/*.yaml --set seed=3 -p cars=20 --vehicle mkz"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's arguments."""
    parser.add_argument("files", nargs="+", metavar="FILE", help="names or paths of worlds")
    add_changes(parser)
    parser.add_argument("--vehicle", metavar="NAME", help="a vehicle that must have room at all starts")


def add_changes(parser: argparse.ArgumentParser) -> None:
    """The options that change a world: ``--set`` and ``-p``."""
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="override a key of the file, say seed=3"
    )
    parser.add_argument(
        "-p",
        "--param",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="another value of a parameter, or of seed; may be given again",
    )


def changes(options: argparse.Namespace) -> tuple[str, ...]:
    """What those options say, as overrides."""
    given = (text if text.partition("=")[0].strip() == "seed" else f"params.{text}" for text in options.param)
    return (*options.set, *given)


def run(options: argparse.Namespace) -> int:
    """Check each."""
    from mirdrake.world_checks import examine

    code = 0
    for name in options.files:
        found = examine(name, overrides=changes(options), vehicle=options.vehicle, first_steps=True)
        for fault in found.faults:
            print(f"error: {fault}", file=sys.stderr)
        if found.faults:
            code = 2
            continue
        assert found.world is not None
        count = len(found.world.props)
        print(f"{name}: sound{f', {count} props' if count else ''}")
        for track in found.world.tracks.values():
            for note in track.notes:
                print(f"  {note}")
        for way in found.ways:
            print(f"  {way.vehicle} has a way of {way.length:.1f} m from '{way.start}' to '{way.goal}'")
    return code
