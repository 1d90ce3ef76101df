"""``mirdrake study``: run a study, many variations of one diagram, on all cores or on a cluster."""

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mirdrake.cli.verb import add_set
from mirdrake.core.errors import ConfigError, MissingDependencyError
from mirdrake.core.paths import find
from mirdrake.core.yaml_io import shown
from mirdrake.execution.worker_server import STUDY, start_server

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from mirdrake.studies import StudyResult

HELP = "run a study: many variations of one diagram, on all cores or on a cluster"
MORE = """\
The folder holds study.json and results.parquet, a row a run. A study that was interrupted or killed goes on where it
was when the same command is given again. Rows do not depend on the number of workers, nor on what runs them.

examples:
  mirdrake study gains.yaml                    on all cores; results go to runs/gains
  mirdrake study gains.yaml --workers 1 --set sampling.runs=500 --out runs/more
  dask scheduler                               on several computers with Dask (pip install 'mirdrake[cluster]'):
  dask worker tcp://ADDRESS:8786 --nworkers 4 --nthreads 1     on each of them, then
  mirdrake study gains.yaml --scheduler tcp://ADDRESS:8786

A study file:
  mirdrake: study/1
  diagram: bolt_test_track
  parameters:                                  knobs of the vehicles, and dotted paths of the diagram
    ego.speed.kp: {low: 0.3, high: 3, scale: log}
    ego.mass_scale: {values: [0.8, 1, 1.2]}
  sampling: {kind: sobol, runs: 64}            or grid, list, random, latin_hypercube
  metrics: [ego.distance_m, ego.mean_speed_error_percent]
  duration: 20 s"""

ROWS = 12
"""Rows of the table that are printed."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's arguments."""
    parser.add_argument("study", help="path of a study file")
    add_set(parser)
    parser.add_argument("--workers", type=_count, metavar="N", help="processes (default: as many as cores; 0: none)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask scheduler, whose workers run the study")
    parser.add_argument("--out", type=Path, metavar="DIR", help="study folder (default: runs/<name>)")
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")


def run(options: argparse.Namespace) -> int:
    """Run the study; 0: all runs done, 1: all done and some failed, 130: interrupted."""
    if options.scheduler and options.workers is not None:
        raise ConfigError("--workers and --scheduler exclude each other; Dask's workers are started by Dask")
    path = find("studies", options.study)
    if options.scheduler is None and options.workers != 0:
        start_server(STUDY)
    from mirdrake.studies import load_study, run_study

    spec = load_study(path, overrides=options.set)
    folder = options.out or Path("runs") / spec.name
    with _executor(options.scheduler) as executor:
        result = run_study(
            spec, out=folder, executor=executor, workers=options.workers, resume=True, progress=not options.quiet
        )
    if not options.quiet:
        _print(result)
    if not result.complete:
        print(f"interrupted; {result.arrow.num_rows} of {result.runs} runs are kept, "
              "give the same command to go on", file=sys.stderr)  # fmt: skip
        return 130
    failed = result.counts["failed"]
    if failed:
        print(f"error: {shown(folder)}: {failed} of {result.runs} runs failed; see the column reason", file=sys.stderr)
    return 1 if failed else 0


@contextmanager
def _executor(scheduler: str | None) -> Iterator["Executor | None"]:
    """The executor of a Dask scheduler, None without one."""
    if scheduler is None:
        yield None
        return
    try:
        from distributed import Client
    except ImportError:
        raise MissingDependencyError("--scheduler needs Dask: pip install 'mirdrake[cluster]'") from None
    try:
        client: Any = Client(scheduler, timeout="10 s", set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        first = (str(error).splitlines() or [type(error).__name__])[0]
        raise ConfigError(
            f"--scheduler {scheduler}: no Dask scheduler answers ({first}); start one with: dask scheduler"
        ) from None
    with client:
        if not client.scheduler_info()["workers"]:
            raise ConfigError(f"--scheduler {scheduler}: it has no workers; start some with: dask worker {scheduler}")
        with client.get_executor() as executor:
            yield executor


def _print(result: "StudyResult") -> None:
    counts = ", ".join(f"{count} {status}" for status, count in result.counts.items() if count)
    print(f"{result.arrow.num_rows} of {result.runs} runs: {counts or 'none'}")
    table = result.table.drop(columns=["simulated"])
    if not table["reason"].any():
        table = table.drop(columns=["reason"])
    else:
        table["reason"] = [text if len(text) <= 60 else f"{text[:59]}…" for text in table["reason"]]
    units = result.table.attrs["units"]
    table.columns = [f"{name} [{units[name]}]" if units.get(name) not in (None, "", "1") else name for name in table]
    if len(table):
        print(table.to_string(max_rows=ROWS, float_format=lambda value: f"{value:.4g}", na_rep="-"))
    if result.folder is not None:
        print(f"  {shown(result.folder)}/")
        for file, text in (("results.parquet", "all rows"), ("study.json", "what was asked")):
            if (result.folder / file).is_file():
                print(f"    {file:16} {text}")


def _count(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text} is not allowed; it must be 0 or more")
    return int(text)
