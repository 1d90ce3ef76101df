"""``mirdrake tune apply``: write the gains of a tuning result to control.yaml."""

import argparse
from pathlib import Path

MORE = """\
RESULT is the folder of a tuning study. Only the gains change, and the entries that they need (such as the kind of the
controller); comments, order and layout are kept, and a comment above states the origin of the gains. The difference is
printed, and the test manoeuvre is driven before and after. Gains that do not meet the criteria of the study, or are not
better than the present ones on that manoeuvre, are rejected unless --force is given. A second call changes nothing.
Exit codes: 0 done, 2 invalid input.

examples:
  mirdrake tune apply runs/bolt_speed --dry-run              print the changes only
  mirdrake tune apply runs/bolt_speed                        the best candidate
  mirdrake tune apply runs/bolt_speed --candidate "SIMC"     another one
  mirdrake tune apply runs/bolt_speed --vehicle models/my_bolt"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("result", type=Path, metavar="RESULT", help="folder of a tuning result")
    parser.add_argument("--candidate", metavar="NAME", help="candidate whose gains are written (default: the best)")
    parser.add_argument(
        "--vehicle", metavar="FOLDER", help="name or folder of the vehicle (default: that of the study)"
    )
    parser.add_argument("--force", action="store_true", help="write gains that do not meet the criteria of the study")
    parser.add_argument("--dry-run", action="store_true", help="print the difference, write nothing")


def run(options: argparse.Namespace) -> int:
    """Write the gains."""
    from mirdrake.core.errors import ConfigError
    from mirdrake.core.yaml_io import display_path
    from mirdrake.report.tuning_texts import acceptance_notes, comparison_lines, robustness_notes
    from mirdrake.tuning.apply import compare, plan_apply
    from mirdrake.tuning.result import read_result
    from mirdrake.tuning.spec import printed

    result = read_result(options.result)
    chosen = result.candidate(options.candidate)
    # Notes on the candidate come first: they explain why it may be rejected.
    for note in (*acceptance_notes(result, chosen), *robustness_notes(result, chosen.name)):
        print(f"note: {note}")
    change = plan_apply(result, candidate=options.candidate, vehicle=options.vehicle, force=options.force)
    for note in change.notes:
        print(f"note: {note}")
    if not change.changes:
        print(f"{display_path(change.path)}: has these gains already; nothing to do")
        return 0
    # Both sets of gains are simulated again, since the vehicle may have changed after the study.
    compared = compare(result, candidate=options.candidate, vehicle=options.vehicle)
    for line in comparison_lines(compared, result, chosen):
        print(line)
    before, after = (printed(cost) for cost in compared.cost(result.cost))
    if not after < before and not options.force:
        raise ConfigError(
            "the present gains are not worse on the test manoeuvre of the study (cost "
            f"{before:.4g}, with the new gains {after:.4g}); --force writes them",
            where=display_path(change.path),
        )
    print(change.diff(), end="")
    if options.dry_run:
        print(f"{display_path(change.path)}: not written (--dry-run)")
        return 0
    change.write()
    print(f"{display_path(change.path)}: written")
    return 0
