"""``mirdrake identify apply``: write the parameters of a fit into vehicle.yaml."""

import argparse
from pathlib import Path

MORE = """\
FIT is the folder of a fit. Identified parameters with an entry in vehicle.yaml are written there, and their source into
'sources'; comments, order and layout stay. Weakly identified parameters are written with --force only. Parameters that
are fixed, not identifiable, at a bound or without an entry are not written. Each of them is listed with the reason. The
difference is printed. Running it again changes nothing. Exit codes: 0 done, 2 bad input.

examples:
  mirdrake identify apply runs/my_fit bolt --dry-run         show what would change
  mirdrake identify apply runs/my_fit models/my_car
  mirdrake identify apply runs/my_fit --vehicle mkz@handling   also into the variant's own file"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("fit", type=Path, metavar="FIT", help="folder of a fit")
    parser.add_argument("name", nargs="?", metavar="VEHICLE", help="name or folder of the vehicle")
    parser.add_argument("--vehicle", metavar="FOLDER", help="the same")
    parser.add_argument("--force", action="store_true", help="write weakly identified parameters as well")
    parser.add_argument("--dry-run", action="store_true", help="show the difference, write nothing")


def run(options: argparse.Namespace) -> int:
    """Plan the changes, print them and write the files."""
    from mirdrake.core.errors import ConfigError
    from mirdrake.core.yaml_io import display_path
    from mirdrake.identification.apply import describe, plan_apply, read_fit

    fit = read_fit(options.fit)
    vehicle = options.vehicle or options.name
    if vehicle is None:
        raise ConfigError(f"the vehicle is missing: mirdrake identify apply {display_path(options.fit)} --vehicle bolt")
    change = plan_apply(fit, vehicle, force=options.force)
    # All notes and differences are printed before the first file is written.
    for line in describe(change):
        print(line)
    if not change.changes:
        print("nothing to write")
        return 0
    for file in change.files:
        print(file.diff(), end="")
    for file in change.files:
        if not options.dry_run:
            file.write()
        print(f"{display_path(file.path)}: {'not written (--dry-run)' if options.dry_run else 'written'}")
    return 0
