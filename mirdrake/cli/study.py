"""``mirdrake study``: run a study, many variations of one diagram, on all cores or on a cluster."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from mirdrake.cli.common import add_quiet, add_set, add_workers, open_dask, print_files
from mirdrake.core.errors import ConfigError
from mirdrake.core.paths import find
from mirdrake.core.yaml_io import display_path
from mirdrake.execution.worker_server import STUDY, start_server

if TYPE_CHECKING:
    from mirdrake.studies import StudyResult

MORE = """\
The folder holds study.json and results.parquet with one row per run. Give the same command again to continue a study
that was interrupted or killed. Rows do not depend on the number of workers or on where they run.

examples:
  mirdrake study gains.yaml                    on all cores; results go to runs/gains
  mirdrake study gains.yaml --workers 1 --set sampling.runs=500 --out runs/more
  dask scheduler                               on several computers with Dask (pip install 'mirdrake[cluster]'):
  dask worker tcp://ADDRESS:8786 --nworkers 4 --nthreads 1     on each of them, then
  mirdrake study gains.yaml --scheduler tcp://ADDRESS:8786

A study file:
  mirdrake: study/1
  diagram: bolt_test_track
  parameters:                                  parameters of the vehicles, and dotted paths of the diagram
    ego.speed.kp: {low: 0.3, high: 3, scale: log}
    ego.mass_scale: {values: [0.8, 1, 1.2]}
  sampling: {kind: sobol, runs: 64}            or grid, list, random, latin_hypercube
  metrics: [ego.distance_m, ego.mean_speed_error_percent]
  duration: 20 s
  model: single_track                          optional: thousands of runs in seconds, without contact and suspension

A study of a manoeuvre has, in place of a diagram, and with figures of the manoeuvre as metrics:
  manoeuvre: step_steer
  vehicle: bolt@handling
  parameters: {single_track.mass: {low: 1400, high: 1900}, friction: {low: 0.5, high: 0.9}}
  metrics: [yaw_response, yaw_overshoot]"""

_MOST_ROWS = 12  # of the table
_LONGEST_REASON = 60  # characters


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("study", help="path of a study file")
    add_set(parser, "sampling.runs=500")
    add_workers(parser)
    parser.add_argument("--out", type=Path, metavar="DIR", help="study folder (default: runs/<name>)")
    add_quiet(parser)


def run(options: argparse.Namespace) -> int:
    """Run the study; 0: all runs done, 1: all done and some failed, 130: interrupted."""
    if options.scheduler and options.workers is not None:
        raise ConfigError("--workers and --scheduler exclude each other; Dask's workers are started by Dask")
    path = find("studies", options.study)
    # Worker processes start from a server that imports Drake once; it is started while the study is read.
    if options.scheduler is None and options.workers != 0:
        start_server(STUDY)
    from mirdrake.studies import load_study, run_study

    spec = load_study(path, overrides=options.set)
    folder = options.out or Path("runs") / spec.name
    with open_dask(options.scheduler) as executor:
        result = run_study(
            spec, out=folder, executor=executor, workers=options.workers, resume=True, progress=not options.quiet
        )
    if not options.quiet:
        _print(result)
    if not result.complete:
        print(
            f"interrupted; {result.arrow.num_rows} of {result.runs} runs are kept, give the same command to continue",
            file=sys.stderr,
        )
        return 130
    failed = result.counts["failed"]
    if failed:
        print(
            f"error: {display_path(folder)}: {failed} of {result.runs} runs failed; see the column reason",
            file=sys.stderr,
        )
    return 1 if failed else 0


def _print(result: "StudyResult") -> None:
    counts = ", ".join(f"{count} {status}" for status, count in result.counts.items() if count)
    print(f"{result.arrow.num_rows} of {result.runs} runs: {counts or 'none'}")
    if "verdict" in result.table:
        verdicts = result.table["verdict"].value_counts()
        print(", ".join(f"{verdict}: {count}" for verdict, count in verdicts.items() if verdict))
    if result.model == "single_track":
        print("single-track model: run the best candidates again with model: plant")
    # Columns without information about this study would push the others off the screen.
    table = result.table.drop(columns=["simulated"])
    if not table["reason"].any():
        table = table.drop(columns=["reason"])
    else:
        longest = _LONGEST_REASON
        table["reason"] = [text if len(text) <= longest else f"{text[: longest - 1]}…" for text in table["reason"]]
    units = result.table.attrs["units"]
    table.columns = [f"{name} [{units[name]}]" if units.get(name) not in (None, "", "1") else name for name in table]
    if len(table):
        print(table.to_string(max_rows=_MOST_ROWS, float_format=lambda value: f"{value:.4g}", na_rep="-"))
    if result.folder is not None:
        files = (("results.parquet", "all rows"), ("study.json", "the study and its settings"))
        print_files(result.folder, files, indent="  ")
