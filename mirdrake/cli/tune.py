"""``mirdrake tune``: good gains for a loop, with evidence."""

import argparse
import math
import sys
from pathlib import Path
from typing import Any

from mirdrake.cli.common import add_quiet, add_set, add_workers, open_dask
from mirdrake.core.paths import find
from mirdrake.core.progress import Progress
from mirdrake.execution.worker_server import LOOP, start_server

MORE = """\
STUDY.yaml names the loop of a vehicle (mirdrake: tuning/1). The loop is identified on the full plant; tuning rules,
loop shaping and a search give candidates; the best are confirmed on the plant and evaluated by Monte Carlo. The folder
holds tuning.json, tables and the page tuning.html. Ctrl-C keeps what is done; the same command continues from there.
`mirdrake tune apply RESULT` writes the gains into control.yaml; see mirdrake tune apply --help.
Exit codes: 0 all acceptance criteria are met, 1 one is not, 2 bad input, 130 stopped.

examples:
  mirdrake tune studies/bolt_speed.yaml --out runs/bolt_speed
  mirdrake tune studies/unior_steering.yaml --set search.trials=200 --set robustness.runs=20
  mirdrake tune studies/bolt_speed.yaml --scheduler tcp://192.168.1.5:8786      workers of Dask on other computers
  mirdrake tune apply runs/bolt_speed --dry-run"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("study", metavar="STUDY.yaml", help="a tuning file (mirdrake: tuning/1)")
    add_set(parser, "search.trials=200")
    add_workers(parser)
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder (default: runs/tune-<study>, continued)")
    add_quiet(parser)


def run(options: argparse.Namespace) -> int:
    """Tune the loop; 0: all acceptance criteria are met, 1: one is not, 130: stopped."""
    path = find("studies", options.study)
    if options.scheduler is None and options.workers != 0:
        start_server(LOOP)
    from mirdrake.tuning.spec import load_tuning

    spec = load_tuning(path, overrides=options.set)
    from mirdrake.tuning.tune import StoppedError, tune

    folder = options.out or Path("runs") / f"tune-{spec.name}"
    with Progress(spec.name, quiet=options.quiet) as progress, open_dask(options.scheduler) as executor:

        def show(stage: str, done: int, total: int, left: float) -> None:
            time_left = "" if not math.isfinite(left) else f"{left / 60.0:.0f}:{left % 60.0:02.0f} left"
            progress.update(text=f"{stage} {done}/{total}  {time_left}".rstrip())

        try:
            result = tune(spec, out=folder, executor=executor, workers=options.workers, progress=show)
        except StoppedError as stop:
            progress.close()
            print(str(stop), file=sys.stderr)
            return 130
    _report(result)
    met = all(row["met"] for row in result.data["acceptance"])
    if not options.quiet:
        _show(result)
    return 0 if met else 1


def _report(result: Any) -> None:
    from mirdrake.report.tuning import write_tuning_report  # Matplotlib takes half a second

    write_tuning_report(result.folder)


def _show(result: Any) -> None:
    """The candidates, and what was reached."""
    data = result.data
    names = list(data["loop"]["gains"])
    width = max(len(str(one["name"])) for one in data["candidates"])
    units = ", ".join(f"{name} [{entry['unit']}]" for name, entry in data["loop"]["gains"].items())
    print(f"{data['name']}: {units}")
    for one in data["candidates"]:
        gains = "  ".join(f"{one['gains'][name]:>9.4g}" for name in names)
        cost = "        -" if one["cost"] is None else f"{one['cost']:9.4g}"
        word = "best" if one["name"] == data["best"] else "" if one["feasible"] else one["status"]
        word = "breaks a constraint" if word == "ok" else word
        print(f"  {one['name']:<{width}}  {gains}  cost {cost}  {word}")
    for row in data["acceptance"]:
        value = "-" if row["value"] is None else f"{row['value']:.3g}"
        limit = "-" if row["limit"] is None else f"{row['limit']:.3g}"
        print(f"  {'met    ' if row['met'] else 'NOT met'} {row['what']}: {value} (limit {limit})")
    if data["best"] is None:
        print("  no candidate meets the constraints; relax them, widen search.ranges, or give more trials")
    print(f"  {result.folder}")
