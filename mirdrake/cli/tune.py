"""``mirdrake tune``: tune the gains of a control loop."""

import argparse
import math
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from mirdrake.cli.common import add_quiet, add_set, add_workers, open_dask
from mirdrake.core.paths import find
from mirdrake.core.progress import Progress
from mirdrake.execution.worker_server import ENVIRONMENT, LOOP, start_server

if TYPE_CHECKING:
    from mirdrake.tuning.result import TuningResult

MORE = """\
STUDY.yaml names the loop of a vehicle (mirdrake: tuning/1). The loop is identified on the full plant; tuning rules,
loop shaping and a search give candidates; the best are tested on the plant and in a Monte Carlo. The folder has
tuning.json, tables and the report tuning.html. Ctrl-C keeps finished work; the same command resumes the study.
`mirdrake tune apply RESULT` writes the gains to control.yaml; see mirdrake tune apply --help.
Exit codes: 0 all acceptance criteria are met, 1 one is not (such as: nothing is better than the present gains), 2
invalid input, 130 stopped.

examples:
  mirdrake tune studies/bolt_speed.yaml --out runs/bolt_speed
  mirdrake tune studies/unior_steering.yaml --set search.trials=200 --set robustness.runs=20
  mirdrake tune studies/bolt_speed.yaml --scheduler tcp://192.168.1.5:8786      Dask workers on other computers
  mirdrake tune apply runs/bolt_speed --dry-run"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("study", metavar="STUDY.yaml", help="a tuning file (mirdrake: tuning/1)")
    add_set(parser, "search.trials=200")
    add_workers(parser)
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder (default: runs/tune-<study>, continued)")
    add_quiet(parser)


def format_time_left(seconds: float) -> str:
    """Return the time until the end of a stage as minutes and seconds, ``1:30 left``; empty if it is not finite."""
    if not math.isfinite(seconds):
        return ""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02d} left"


def run(options: argparse.Namespace) -> int:
    """Tune the loop; 0: all acceptance criteria are met, 1: one is not, 130: stopped."""
    # Before NumPy is loaded, one thread for linear algebra, as in the workers: threads for small matrices take longer.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", ENVIRONMENT["OPENBLAS_NUM_THREADS"])
    path = find("studies", options.study)
    # The server of the workers imports Drake while the specification is read.
    if options.scheduler is None and options.workers != 0:
        start_server(LOOP)
    from mirdrake.tuning.spec import load_tuning

    spec = load_tuning(path, overrides=options.set)
    from mirdrake.tuning.stages import StoppedError
    from mirdrake.tuning.tune import tune

    folder = options.out or Path("runs") / f"tune-{spec.name}"
    with Progress(spec.name, quiet=options.quiet) as progress, open_dask(options.scheduler) as executor:

        def show(stage: str, done: int, total: int, seconds_left: float) -> None:
            progress.update(text=f"{stage} {done}/{total}  {format_time_left(seconds_left)}".rstrip())

        try:
            result = tune(spec, out=folder, executor=executor, workers=options.workers, progress=show)
        except StoppedError as stop:
            progress.close()
            print(str(stop), file=sys.stderr)
            return 130
    from mirdrake.report.tuning import write_tuning_report  # importing Matplotlib takes half a second

    write_tuning_report(result)
    if not options.quiet:
        _print_result(result)
    return 0 if result.is_accepted else 1


def _print_result(result: "TuningResult") -> None:
    """Print the candidates and the criteria."""
    from mirdrake.report.tuning_texts import Texts, criterion_text

    # One sentence first; numbers of all candidates follow in columns.
    texts = Texts(result)
    print(f"{result.name}: {texts.headline()}")
    for sentence in texts.after_verdict():
        print(f"  {sentence}")
    width = max(len(candidate.name) for candidate in result.candidates)
    units = ", ".join(f"{name} [{gain.unit}]" for name, gain in result.loop.gains.items())
    print(f"  gains {units}")
    for candidate in result.candidates:
        values = [candidate.gains.get(name) for name in result.loop.gains]
        gains = "  ".join("        -" if value is None else f"{value:>9.4g}" for value in values)
        cost = "        -" if candidate.cost is None else f"{candidate.cost:9.4g}"
        verdict = "best" if candidate.name == result.best else texts.rejections(candidate.rejections)
        print(f"  {candidate.name:<{width}}  {gains}  cost {cost}  {verdict}")
    for criterion in result.acceptance:
        value = "-" if criterion.value is None else f"{criterion.value:.4g}"
        met = "met    " if criterion.met else "NOT met"
        print(f"  {met} {criterion_text(criterion, result)}: {value} (limit {criterion.limit:.4g})")
    if result.best is None:
        print("  relax the constraints, extend search.ranges, or increase search.trials")
    print(f"  {result.folder}/\n    tuning.html  report")
