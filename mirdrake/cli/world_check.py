"""``mirdrake world check``: every fault of worlds with file and line, before anything runs."""

import argparse
import sys
from collections import Counter

from mirdrake.cli.common import add_param, add_set, add_trust, world_overrides
from mirdrake.core.wording import plural

MORE = """\
Faults are: props that overlap (with depth and place), that are buried or float; starts and goals inside a prop; goals
that a vehicle cannot reach; rules that do not hold; faults of tests. The vehicle is that of a test or of a rule
`drivable`; --vehicle checks one more at all starts. Finally the plant is built and makes a few steps with that vehicle,
or with a car, at the first start. Drivers of tests that are user classes (module:Class) are executed and checked only
with --trust.
Exit codes: 0 sound, 2 faults.

examples:
  mirdrake world check parking_lot
  mirdrake world check lots/*.yaml --set seed=3 -p cars=20 --vehicle mkz"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("files", nargs="+", metavar="FILE", help="names or paths of worlds")
    add_set(parser, "seed=3")
    add_param(parser)
    add_trust(parser)
    parser.add_argument("--vehicle", metavar="NAME", help="a vehicle that must fit at all starts")


def run(options: argparse.Namespace) -> int:
    """Check each world and print its faults, or its routes if it is sound."""
    from mirdrake.world_checks import examine

    code = 0
    # Worlds are independent, so that a faulty one does not hide the others.
    for name in options.files:
        result = examine(
            name, overrides=world_overrides(options), vehicle=options.vehicle, first_steps=True, trust=options.trust
        )
        for fault in result.faults:
            print(f"error: {fault}", file=sys.stderr)
        if result.faults:
            code = 2
            continue
        assert result.world is not None
        count = len(result.world.props)
        print(f"{name}: sound" + (f", {plural(count, 'prop')}" if count else ""))
        for line in result.remarks:
            print(f"  {line}")
        for track in result.world.tracks.values():
            for note in track.notes:
                print(f"  {note}")
        draws = Counter((path.vehicle, path.start, path.goal) for path in result.paths)
        seen: Counter[tuple[str, str, str]] = Counter()
        for path in result.paths:
            seen[key := (path.vehicle, path.start, path.goal)] += 1
            draw = f" (draw {seen[key]} of {draws[key]} of the world)" if draws[key] > 1 else ""
            print(f"  {path.vehicle} has a path of {path.length:.1f} m from '{path.start}' to '{path.goal}'{draw}")
    return code
