"""``mirdrake tune apply``: gains of a tuning result into control.yaml."""

import argparse
from pathlib import Path

MORE = """\
RESULT is the folder of a tuning study. Only the gains change, and what they need (such as the kind of the controller);
comments, order and layout stay, and a line above says where the gains are from. The difference is shown. A candidate
that does not meet the constraints of the study is rejected. Running it again changes nothing. Exit codes: 0 done,
2 bad input.

examples:
  mirdrake tune apply runs/bolt_speed --dry-run              show what would change
  mirdrake tune apply runs/bolt_speed                        the best candidate
  mirdrake tune apply runs/bolt_speed --candidate "SIMC"     another one
  mirdrake tune apply runs/bolt_speed --vehicle models/my_bolt"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("result", type=Path, metavar="RESULT", help="folder of a tuning result")
    parser.add_argument("--candidate", metavar="NAME", help="whose gains (default: the best)")
    parser.add_argument("--vehicle", metavar="FOLDER", help="name or folder of the vehicle (default: the study's)")
    parser.add_argument("--dry-run", action="store_true", help="show the difference, write nothing")


def run(options: argparse.Namespace) -> int:
    """Plan the changes, print the difference and write it."""
    from mirdrake.core.yaml_io import shown
    from mirdrake.tuning.apply import plan_apply
    from mirdrake.tuning.result_folder import read_result

    result = read_result(options.result)
    change = plan_apply(result, candidate=options.candidate, vehicle=options.vehicle)
    for note in change.notes:
        print(f"note: {note}")
    if not change.changes:
        print(f"{shown(change.path)}: has these gains already; nothing to do")
        return 0
    print(change.diff(), end="")
    if options.dry_run:
        print(f"{shown(change.path)}: not written (--dry-run)")
        return 0
    change.write()
    print(f"{shown(change.path)}: written")
    return 0
