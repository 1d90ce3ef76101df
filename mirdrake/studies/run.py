"""Run a study through an executor; each row is written as soon as its run is finished, so that it can be resumed."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa

from mirdrake.core.errors import ConfigError
from mirdrake.core.progress import Progress
from mirdrake.execution.calls import Lost, call_all, open_executor
from mirdrake.execution.job import Outcome, run_job
from mirdrake.execution.journal import Journal
from mirdrake.execution.worker_server import STUDY, start_server
from mirdrake.studies.folder import (
    RESULTS_FILE,
    Row,
    ShardStore,
    make_schema,
    make_table,
    open_journal,
    read_manifest,
    read_rows,
    read_shards,
    write_results,
)  # fmt: skip
from mirdrake.studies.manoeuvres import (
    ManoeuvreShard,
    make_manoeuvre_plan,
    make_manoeuvre_shards,
    run_manoeuvre_shard,
)
from mirdrake.studies.plan import Plan, make_plan
from mirdrake.studies.single_track import BatchShard, check_single_track, make_shards, run_shard
from mirdrake.studies.spec import StudySpec, make_study

GRACE = 30.0
"""Wall time above a run's limit after which its process is ended [s]; building the diagram is in it."""

StudyProgress = Callable[[int, int, Row], None]
"""Called with the number of finished runs, of all runs, and the latest row."""


@dataclass(frozen=True)
class StudyResult:
    """The rows of a study.

    Attributes:
        arrow: a row per finished run, in the order of the runs: run, the parameters, status (ok, unstable, failed),
            reason, simulated [s], the metrics (empty unless ok); units in the metadata of the columns.
        runs: number of all runs.
        folder: the study folder; None if the rows are only in memory.
        model: plant or single_track.
    """

    arrow: pa.Table
    runs: int
    folder: Path | None = None
    model: str = "plant"

    @cached_property
    def table(self) -> pd.DataFrame:
        """The rows, index ``run``; units in ``attrs["units"]``."""
        table: pd.DataFrame = self.arrow.to_pandas().set_index("run")
        fields = [self.arrow.schema.field(name) for name in self.arrow.schema.names]
        table.attrs["units"] = {field.name: (field.metadata or {}).get(b"unit", b"").decode() for field in fields}
        return table

    @property
    def complete(self) -> bool:
        """Whether every run is finished."""
        return bool(self.arrow.num_rows == self.runs)

    @property
    def counts(self) -> dict[str, int]:
        """Number of runs by status."""
        given = self.arrow.column("status").to_pylist()
        return {status: given.count(status) for status in ("ok", "unstable", "failed")}


def run_study(
    study: StudySpec | Mapping[str, Any] | Path | str,
    *,
    out: Path | str | None = None,
    executor: Executor | None = None,
    workers: int | None = None,
    resume: bool = False,
    progress: StudyProgress | bool = False,
) -> StudyResult:
    """Run a study.

    A run that diverges, raises an error, hangs or crashes its process becomes a row with its status and reason; the
    others continue. Rows do not depend on the executor, the number of workers or the order. After Ctrl-C the result
    has the finished runs.

    Args:
        study: a study spec, its data or its file.
        out: study folder; it is created, and must be empty unless `resume`. None keeps the rows in memory.
        executor: runs the jobs, for example ``ProcessPoolExecutor()``, or ``get_executor()`` of a Dask client; it is
            not shut down. Only our own worker processes end a run that hangs in a user's block.
        workers: number of processes if no executor is given; 0 runs in this process. As many as cores if omitted.
        resume: continue with the rows that `out` has of this study.
        progress: called after every run, or True for a progress bar.

    Raises:
        ConfigError, ModelError, WorldError: the study, its diagram, a model or the world has faults.
        RunError: the folder cannot be written, or worker processes cannot start.
    """
    # The server imports the library while the study is checked here, so that its worker processes start at once.
    if executor is None and workers != 0:
        start_server(STUDY)
    spec = make_study(study)
    folder = Path(out) if out is not None else None
    plan = make_plan(spec) if spec.manoeuvre is None else make_manoeuvre_plan(spec)
    if spec.model == "single_track" or spec.manoeuvre is not None:
        return _run_shards(plan, folder, executor, workers, resume=resume, progress=progress)

    # Rows that the journal of a resumed study has are not computed again.
    schema, total = make_schema(plan.units, spec.metrics), len(plan.rows)
    journal = open_journal(folder, plan.manifest(), resume=resume)
    missing = [index for index in range(total) if index not in journal]
    with ExitStack() as stack:
        runner, ahead = stack.enter_context(
            open_executor(executor, workers, calls=len(missing), limit=GRACE + plan.limit)
        )
        report = (
            stack.enter_context(_progress_bar(spec.name, total, len(journal))) if progress is True else progress or None
        )

        # Results in the order in which they finish; the table is sorted by run at the end.
        with suppress(KeyboardInterrupt):  # the finished runs are kept
            _run_all(plan, journal, missing, runner, ahead, report)
    result = StudyResult(make_table(journal.records, schema), total, folder)
    # The journal is replaced by a Parquet file only when it is complete; until then it can be resumed.
    if folder is not None and result.complete:
        write_results(folder, result.arrow)
    return result


def load_results(folder: Path | str) -> StudyResult:
    """Load the rows of a study folder, complete or not.

    Raises:
        ConfigError: the folder is not that of a study, or is damaged.
    """
    folder = Path(folder)
    manifest = read_manifest(folder)
    try:
        of_manoeuvre = manifest["study"].get("manoeuvre") is not None
        schema = make_schema(manifest["units"], manifest["study"]["metrics"], verdict=of_manoeuvre)
        runs = int(manifest["runs"])
    except (KeyError, TypeError, ValueError):
        raise ConfigError("its study.json is incomplete", where=str(folder)) from None
    model = manifest["study"].get("model", "plant")
    # Until the study is complete, its rows are in one file per shard.
    in_shards = (model == "single_track" or of_manoeuvre) and not (folder / RESULTS_FILE).is_file()
    table = read_shards(folder, schema) if in_shards else make_table(read_rows(folder), schema)
    return StudyResult(table, runs, folder, model)


def _run_shards(
    plan: Plan,
    folder: Path | None,
    executor: Executor | None,
    workers: int | None,
    *,
    resume: bool,
    progress: StudyProgress | bool,
) -> StudyResult:
    """Run a study of the single-track model or of a manoeuvre; each shard is a call, and a file until the end."""
    of_manoeuvre = plan.spec.manoeuvre is not None
    schema, total = make_schema(plan.units, plan.spec.metrics, verdict=of_manoeuvre), len(plan.rows)
    if not of_manoeuvre:
        check_single_track(plan)
    # The journal rejects a folder of another study before anything is simulated.
    open_journal(folder, plan.manifest(), resume=resume)
    if folder is not None and (folder / RESULTS_FILE).is_file():
        return load_results(folder)
    # Shards have fixed bounds, so that results do not depend on the number of workers.
    shards: Sequence[BatchShard | ManoeuvreShard] = make_manoeuvre_shards(plan) if of_manoeuvre else make_shards(plan)
    store = ShardStore(folder, schema)
    missing = [shard for shard in shards if shard.number not in store.numbers]
    run: Callable[[Any], list[Outcome]] = run_manoeuvre_shard if of_manoeuvre else run_shard
    with ExitStack() as stack:
        # No time limit of a call: a shard is one batch of many runs, whose duration is not known in advance.
        runner, ahead = stack.enter_context(open_executor(executor, workers, calls=len(missing), limit=math.inf))
        shows = stack.enter_context(_progress_bar(plan.spec.name, total, store.rows)) if progress is True else progress
        with suppress(KeyboardInterrupt):  # the finished shards are kept
            for position, result in call_all(runner, run, ((shard,) for shard in missing), ahead=ahead):
                shard = missing[position]
                outcomes = shard.lost(result.reason) if isinstance(result, Lost) else result
                rows = [_row(plan, outcome) for outcome in outcomes]
                store.add(shard.number, rows)
                # After each shard, not each run: a batch has no progress inside.
                if callable(shows):
                    shows(store.rows, total, rows[-1])
    result = StudyResult(store.table(), total, folder, plan.spec.model)
    if folder is not None and result.complete:
        write_results(folder, result.arrow)
        store.clear()
    return result


def _run_all(
    plan: Plan,
    journal: Journal,
    missing: Sequence[int],
    executor: Executor,
    ahead: int,
    progress: StudyProgress | None,
) -> None:
    """Run the jobs that have no row yet, and add their rows to the journal."""
    jobs = ((plan.job(index),) for index in missing)
    for position, result in call_all(executor, run_job, jobs, ahead=ahead):
        outcome = Outcome(missing[position], "failed", result.reason) if isinstance(result, Lost) else result
        row = _row(plan, outcome)
        journal.add(row["run"], {key: value for key, value in row.items() if key != "run"})
        if progress is not None:
            progress(len(journal), len(plan.rows), row)


def _row(plan: Plan, outcome: Outcome) -> Row:
    """Return the row of an outcome."""
    row: Row = {"run": outcome.index}
    for (name, unit), value in zip(plan.units.items(), plan.rows[outcome.index], strict=True):
        row[name] = str(value) if unit is None else float(value)
    row |= {"status": outcome.status, "reason": outcome.reason, "simulated": outcome.simulated}
    row |= {"verdict": outcome.verdict} if plan.spec.manoeuvre is not None else {}
    # Only runs with status ok have metrics; the others have empty cells.
    values = outcome.metrics or [None] * len(plan.spec.metrics)
    return row | dict(zip(plan.spec.metrics, values, strict=True))


@contextmanager
def _progress_bar(title: str, total: int, done: int) -> Iterator[StudyProgress]:
    """Yield a function that shows the progress on standard error."""
    with Progress(title, total, "runs") as progress:
        progress.update(done)
        yield lambda count, _, __: progress.update(count)
