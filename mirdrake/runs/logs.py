"""Runs and their folders: labelled signals with units, written so that a kill leaves them readable.

::

    runs/<diagram>-<UTC time>/
      spec.yaml          the resolved spec, seed, versions and hash
      scene/             the world and the vehicles as they were, see :mod:`mirdrake.assembly.scene`
      signals.parquet    time [s] and named signals; units in the column metadata
      actors.parquet     the same of the actors of the world: lead.x, lead.speed, ...
      events.jsonl       occurrences, one JSON object in each line
      ego.front_camera/  pictures named by simulated time, and driving_log.txt beside them
      ego.lidar.parquet  samples of a sensor that outputs arrays, one in each row
      ego.imu.parquet    samples of a sensor that outputs vectors, at its own rate, one in each row
      summary.json       figures of the run
      recording.html     Meshcat replay        report.html, diagram.svg

During a run, a Parquet table is a folder of finished parts, which pandas and pyarrow read like a file. At the end, also
after Ctrl-C, it becomes one file. If the process is killed, all parts written before can be read.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property, wraps
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypedDict, TypeVar, cast

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import yaml
from numpy.typing import NDArray

from mirdrake.assembly.scene import Scene, read_scene, write_scene
from mirdrake.core.errors import ConfigError, MirdrakeError, RunError, did_you_mean, first_line
from mirdrake.core.files import read_errors, write_errors, write_file
from mirdrake.core.json_io import Json, parse_json
from mirdrake.core.recording.arrays import RunArrays
from mirdrake.core.recording.parts import PartedTable, read_part, stored
from mirdrake.core.recording.pictures import Picture, parse_start, picture_folders, read_pictures
from mirdrake.core.recording.pictures import picture_name as picture_name
from mirdrake.core.recording.vectors import ROWS, make_table
from mirdrake.runs.incidents import OF_ACTORS
from mirdrake.runs.plots import Animation, animate_run, describe, make_statistics, plot_runs
from mirdrake.runs.stop import Stop, StopReason

P = ParamSpec("P")
T = TypeVar("T")

SIGNALS, SUMMARY, SPEC, EVENTS = "signals.parquet", "summary.json", "spec.yaml", "events.jsonl"

ACTORS = "actors.parquet"
"""Table of the signals of actors, whose names begin with :data:`OF_ACTORS` among those of a run."""


class Event(TypedDict):
    """Occurrence during a run: time [s], kind and one line of text."""

    time: float
    kind: str
    text: str


@dataclass(frozen=True)
class Run:
    """Result of a simulation.

    Attributes:
        folder: run folder; None if the run is only in memory.
        spec: resolved diagram spec as plain data, with seed and versions.
        summary: figures of the run, see summary.json.
        units: unit of every signal, "" for pure numbers.
        events: occurrences during the run.
        table: samples of a run that is only in memory; use :attr:`signals` and :attr:`actors`.
        laid_out: scene of a run that was made in this process; use :meth:`scene`.
    """

    folder: Path | None
    spec: Json
    summary: Json
    units: dict[str, str] = field(default_factory=dict)
    events: list[Event] = field(default_factory=list)
    table: pd.DataFrame | None = None
    laid_out: Scene | None = field(default=None, repr=False, compare=False)

    @cached_property
    def signals(self) -> pd.DataFrame:
        """Samples by name, index ``time`` [s]; read from the folder at the first access.

        ``signals.attrs["units"]`` has the unit of each column.
        """
        table = self._tables[0]
        of_actors = [name for name in table.columns if name.startswith(OF_ACTORS)]
        table = table.drop(columns=of_actors) if of_actors else table
        table.attrs["units"] = {name: unit for name, unit in self.units.items() if not name.startswith(OF_ACTORS)}
        return table

    @cached_property
    def actors(self) -> pd.DataFrame:
        """Samples of the actors at the same times, by ``<actor>.<signal>``; without columns if there are none."""
        return self._tables[1]

    @cached_property
    def _tables(self) -> tuple[pd.DataFrame, pd.DataFrame]:
        """Samples of the vehicles and of the actors, with equally many rows."""
        if self.table is not None:
            names = [name for name in self.table.columns if name.startswith(OF_ACTORS)]
            return self.table, self.table[names].rename(columns=lambda name: name.removeprefix(OF_ACTORS))
        signals = read_signals(self.folder)
        actors = read_table(None if self.folder is None else self.folder / ACTORS)
        # The two are written one after the other, so that a kill may leave one longer than the other.
        rows = min(len(signals), len(actors)) if len(actors.columns) else len(signals)
        return signals.head(rows), actors.head(rows)

    def scene(self) -> Scene:
        """Return the world and the vehicles of the run as they were, read from the folder at the first call.

        Raises:
            RunError: the run has no scene, or a damaged one.
        """
        return self._scene

    @cached_property
    def _scene(self) -> Scene:
        if self.laid_out is not None:
            return self.laid_out
        if self.folder is None:
            raise RunError("the run is only in memory and has no scene")
        return read_scene(self.folder)

    @property
    def stop(self) -> Stop:
        """Why the simulation ended."""
        return Stop(StopReason(self.summary["stop_reason"]), str(self.summary.get("stop_detail", "")))

    @property
    def diverged(self) -> bool:
        """Whether the simulation ended because a number became infinite or undefined."""
        return self.stop.reason is StopReason.DIVERGED

    @property
    def start(self) -> datetime:
        """Date and time of the start, from which the names of pictures are derived."""
        with read_errors((self.folder or Path()) / SPEC):
            return parse_start(_mapping(self.spec.get("record", {})).get("start_time"))

    @cached_property
    def arrays(self) -> RunArrays:
        """Samples by sensor at its own rate: ``run.arrays["ego.lidar"]["ranges"]``, ``run.arrays["ego.imu"]["wz"]``."""
        return RunArrays(self.folder, apart=(SIGNALS, ACTORS))

    @cached_property
    def pictures(self) -> dict[str, list[Picture]]:
        """Recorded pictures in the order of time, by camera: ``run.pictures["ego.front_camera"][0].pixels``."""
        return {path.name: read_pictures(path, self.start) for path in picture_folders(self.folder)}

    def __getitem__(self, name: str) -> pd.Series:
        """Return a signal by name."""
        if name not in self.signals:
            raise ConfigError(f"run: no signal '{name}'; {did_you_mean(name, map(str, self.signals.columns))}")
        return self.signals[name]

    def __repr__(self) -> str:
        """Return what ran, how it ended, and main figures, in about ten lines."""
        return describe(self)

    def plot(self, *patterns: str) -> Any:
        """Return a figure of signals over time, a panel for each unit: ``run.plot("ego.vx", "ego.control.*_pid.*")``.

        Without patterns: speed, steering and lateral error of all vehicles.

        Raises:
            ConfigError: a pattern chooses nothing.
        """
        return plot_runs({"": self}, patterns)

    def compare(self, other: "Run", *patterns: str, labels: tuple[str, str] = ("this", "other")) -> Any:
        """Return a plot of the same signals of two runs.

        Args:
            other: the other run.
            patterns: names of signals, with wildcards; speed, steering and lateral error if left out.
            labels: names of the two runs in the legend.

        Raises:
            ConfigError: a pattern chooses nothing in one of the runs.
        """
        if not isinstance(other, Run):
            raise ConfigError(f"compare: expected a Run, got {type(other).__name__}; write run.compare(other_run, …)")
        return plot_runs(dict(zip(labels, (self, other), strict=True)), patterns)

    def statistics(self, *patterns: str) -> pd.DataFrame:
        """Return a table of signals: unit, min, mean, max, rms, last; of all signals without patterns.

        Raises:
            ConfigError: a pattern chooses nothing.
        """
        return make_statistics(self, patterns)

    def animate(self, *, height: int = 420, frames_per_second: float = 20.0) -> Animation:
        """Return the run as a 3D animation with play controls, which a notebook shows.

        Args:
            height: height of the view [px].
            frames_per_second: of simulated time [Hz].

        Raises:
            RunError: the run has no scene or no samples.
        """
        return animate_run(self, height=height, frames_per_second=frames_per_second)


def load_run(folder: Path | str) -> Run:
    """Load a run folder, also one whose run was killed.

    Raises:
        ConfigError: the path is not a run folder, or its files are invalid.
    """
    folder = Path(folder)
    if not folder.exists():
        raise ConfigError("no such folder", where=str(folder))
    if not (folder / SPEC).is_file():
        raise ConfigError(f"not a run folder (it has no {SPEC})", where=str(folder))
    with read_errors(folder / SPEC):
        spec = _mapping(yaml.safe_load((folder / SPEC).read_text(encoding="utf-8")))
    with read_errors(folder / SUMMARY):
        # A killed run has no summary.json, but all of its samples up to then.
        written = (folder / SUMMARY).exists()
        killed = {"stop_reason": StopReason.KILLED, "stop_detail": ""}
        summary = _mapping(parse_json((folder / SUMMARY).read_text(encoding="utf-8")) if written else killed)
    with read_errors(folder / SIGNALS):
        units = _units(folder / SIGNALS)
    with read_errors(folder / ACTORS):
        units |= {f"{OF_ACTORS}{name}": unit for name, unit in _units(folder / ACTORS).items() if name != "time"}
    with read_errors(folder / EVENTS):
        events = _read_events(folder)
    run = Run(folder, spec, summary, units, events)
    with read_errors(folder / SIGNALS):
        # The duration of a killed run is that of its samples.
        if "simulated_s" not in summary and len(run.signals):
            summary["simulated_s"] = float(run.signals.index[-1])
    return run


@contextmanager
def reading_run(folder: Path | None) -> Iterator[None]:
    """Convert exceptions due to inconsistent values of a damaged run folder to a ConfigError with one line.

    Files that cannot be read are reported by their readers.
    """
    try:
        with read_errors(folder or Path()):
            yield
    except (RuntimeError, AssertionError, SystemExit) as error:  # Drake raises SystemExit for a failed assertion
        raise ConfigError(f"damaged, cannot be used: {first_line(error)[:160]}", where=str(folder)) from error


def reads_run(function: Callable[Concatenate[Run, P], T]) -> Callable[Concatenate[Run, P], T]:
    """Decorate a function of a run with :func:`reading_run`."""

    @wraps(function)
    def read(run: Run, /, *arguments: P.args, **options: P.kwargs) -> T:
        with reading_run(run.folder):
            return function(run, *arguments, **options)

    return read


def _mapping(data: Any) -> Json:
    if not isinstance(data, dict):
        raise ValueError("its top level is not a mapping (key: value)")
    return data


def read_signals(folder: Path | None, columns: Sequence[str] | None = None) -> pd.DataFrame:
    """Read the samples in a run folder, index ``time`` [s].

    Args:
        folder: the run folder; None gives an empty table.
        columns: names of columns; missing ones are ignored.
    """
    return read_table(None if folder is None else folder / SIGNALS, columns)


def read_table(path: Path | None, columns: Sequence[str] | None = None) -> pd.DataFrame:
    """Read a table of samples, index ``time`` [s]; an empty one if there is no such file.

    Args:
        path: path of the table; None gives an empty one.
        columns: names of columns; missing ones are ignored.
    """
    with read_errors(path or Path()):
        parts = stored(path) if path is not None else []
        if not parts:
            return pd.DataFrame(index=pd.Index([], name="time"))
        # Parts of a table have the same columns, so the schema of the first is that of all.
        known = pq.read_schema(parts[0]).names
        wanted = None if columns is None else ["time", *(name for name in columns if name in known)]
        table: pd.DataFrame = pa.concat_tables([read_part(part, wanted) for part in parts]).to_pandas()
        return table.set_index("time")


def _units(path: Path) -> dict[str, str]:
    """Return the units of the columns of a table; none if there is no such file."""
    parts = stored(path)
    schema = pq.read_schema(parts[0]) if parts else pa.schema([])
    return {name: (schema.field(name).metadata or {}).get(b"unit", b"").decode() for name in schema.names}


def _read_events(folder: Path) -> list[Event]:
    if not (folder / EVENTS).is_file():
        return []
    # A kill may truncate the last line; only lines that end are complete.
    lines = (folder / EVENTS).read_text(encoding="utf-8").splitlines(keepends=True)
    return [cast(Event, _mapping(parse_json(line))) for line in lines if line.endswith("\n")]


def occupied(folder: Path) -> RunError:
    """Return the error of a folder for new results that is not empty."""
    try:
        summary = parse_json((folder / SUMMARY).read_text(encoding="utf-8"))
    except (OSError, ValueError, MirdrakeError):
        summary = None
    failed = isinstance(summary, dict) and summary.get("stop_reason") == StopReason.FAILED
    reason = "holds a failed run, which can be deleted; do so, or" if failed else "is not empty;"
    return RunError(f"{reason} choose another folder with --out", where=str(folder))


class RunWriter:
    """Writer of a run folder during the run.

    Args:
        folder: new or empty folder.
        spec: resolved spec as plain data.
        scene: world and vehicles of the run.

    Raises:
        RunError: the folder is not empty or cannot be created.
    """

    def __init__(self, folder: Path, spec: Mapping[str, Any], scene: Scene | None = None) -> None:
        self.folder = folder
        self._signals = PartedTable(folder / SIGNALS, rows=ROWS)
        self._actors = PartedTable(folder / ACTORS, rows=ROWS)
        # Remembered, so that a failure below removes only a folder that did not exist before.
        new = not folder.exists()
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if any(folder.iterdir()):
                raise occupied(folder)
        except OSError as error:
            raise RunError(
                f"cannot be created: {error.strerror}; choose another folder with --out", where=str(folder)
            ) from None
        try:
            write_file(folder / SPEC, yaml.safe_dump(dict(spec), sort_keys=False, allow_unicode=True, width=100))
        except RunError:
            if new:
                folder.rmdir()
            raise
        if scene is not None:
            write_scene(scene, folder)

    def write_signals(self, times: NDArray[np.float64], columns: Mapping[str, Any], units: Mapping[str, str]) -> None:
        """Add a block of samples; it is on disk within a quarter of a second."""
        if not len(times):
            return
        # Actors have a table of their own, without the prefix: their number differs
        # between worlds, that of vehicles does not.
        actors = {name: values for name, values in columns.items() if name.startswith(OF_ACTORS)}
        self._signals.add(make_table(times, {name: columns[name] for name in columns if name not in actors}, units))
        if actors:
            own = {name.removeprefix(OF_ACTORS): units[name] for name in actors}
            short = {name.removeprefix(OF_ACTORS): values for name, values in actors.items()}
            self._actors.add(make_table(times, short, {"time": "s", **own}))

    def flush(self) -> None:
        """Write the blocks that are still in memory."""
        self._signals.flush()
        self._actors.flush()

    def write_event(self, event: Event) -> None:
        """Add a line to events.jsonl."""
        path = self.folder / EVENTS
        with write_errors(path), path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(event) + "\n")

    def finish(self, summary: Callable[[], Mapping[str, object]]) -> dict[str, object]:
        """Merge signals.parquet into one file and write summary.json.

        The file does not depend on the parts: equal samples give equal bytes.

        Args:
            summary: called when all samples are on disk.
        """
        self._signals.finish()
        self._actors.finish()
        figures = dict(summary())
        # Arrow keeps freed pages in its pool; in a study of many runs that memory would grow from run to run.
        pa.default_memory_pool().release_unused()
        # Written last: a summary.json marks a run folder as complete.
        write_file(self.folder / SUMMARY, json.dumps(figures, indent=2) + "\n")
        return figures
