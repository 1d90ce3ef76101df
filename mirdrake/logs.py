"""Runs and their folders: labelled signals with units, written so that a kill leaves them readable.

::

    runs/<diagram>-<UTC time>/
      spec.yaml          the resolved spec, seed, versions and hash
      signals.parquet    time [s] and named signals; units in the column metadata
      events.jsonl       what happened, one JSON object a line
      ego.front_camera/  pictures named by simulated time, and driving_log.txt beside them
      summary.json       figures of the run
      recording.html     Meshcat replay        report.html, diagram.svg

While a run goes on, ``signals.parquet`` is a folder of finished parts, which pandas and pyarrow read like a file; at
the end, also after Ctrl-C, it becomes one file. Whatever kills the process, all parts written so far can be read.
"""

import hashlib
import io
import json
import os
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import yaml
from numpy.typing import NDArray
from PIL import Image

from mirdrake.errors import ConfigError, RunError, did_you_mean

SIGNALS, SUMMARY, SPEC, EVENTS = "signals.parquet", "summary.json", "spec.yaml", "events.jsonl"
DRIVING_LOG = "driving_log.txt"
_PARTS = f".{SIGNALS}.parts"

FLUSH_AFTER = 0.25
"""Time for which samples stay in memory before they are written [s]: what a kill can lose."""

JPEG_QUALITY = 90
"""Of pictures, 1 .. 95."""

ROWS = 5_000
"""Rows of a row group of signals.parquet."""


@dataclass(frozen=True)
class Run:
    """What a simulation gave.

    Attributes:
        folder: where it was written, or None if it is only in memory.
        spec: the resolved diagram spec as plain data, with seed and versions.
        summary: figures of the run, see summary.json.
        units: unit of every signal, "" for pure numbers.
        events: what happened: time [s], kind, text.
        table: the samples of a run that is only in memory; use :attr:`signals`.
    """

    folder: Path | None
    spec: dict[str, Any]
    summary: dict[str, Any]
    units: dict[str, str] = field(default_factory=dict)
    events: list[dict[str, Any]] = field(default_factory=list)
    table: pd.DataFrame | None = None

    @cached_property
    def signals(self) -> pd.DataFrame:
        """Samples by name, index ``time`` [s]; read from the folder when first asked for."""
        return self.table if self.table is not None else read_signals(self.folder)

    def __getitem__(self, name: str) -> pd.Series:
        """One signal by name."""
        if name not in self.signals:
            raise ConfigError(f"run: no signal '{name}'; {did_you_mean(name, map(str, self.signals.columns))}")
        return self.signals[name]


def load_run(folder: Path | str) -> Run:
    """A run folder, also one whose run was killed.

    Raises:
        ConfigError: it is no run folder.
    """
    folder = Path(folder)
    if not (folder / SPEC).is_file():
        raise ConfigError(f"{folder}: not a run folder (it has no {SPEC})")
    spec = yaml.safe_load((folder / SPEC).read_text(encoding="utf-8"))
    summary: dict[str, Any] = {"stop_reason": "killed"}
    if (folder / SUMMARY).is_file():
        summary = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
    schema = _stored_schema(folder)
    units = {name: (schema.field(name).metadata or {}).get(b"unit", b"").decode() for name in schema.names}
    run = Run(folder, spec, summary, units, _read_events(folder))
    if "simulated_s" not in summary and len(run.signals):
        summary["simulated_s"] = float(run.signals.index[-1])
    return run


def read_signals(folder: Path | None, columns: Sequence[str] | None = None) -> pd.DataFrame:
    """The samples in a run folder, index ``time`` [s].

    Args:
        folder: the run folder; None gives an empty table.
        columns: only these, as far as they exist.
    """
    stored = _stored(folder) if folder is not None else []
    if not stored:
        return pd.DataFrame(index=pd.Index([], name="time"))
    known = pq.read_schema(stored[0]).names
    wanted = None if columns is None else ["time", *(name for name in columns if name in known)]
    table: pd.DataFrame = pa.concat_tables([_read(part, wanted) for part in stored]).to_pandas()
    return table.set_index("time")


def _stored(folder: Path) -> list[Path]:
    """The Parquet files that hold a run's samples: one, or the parts of a run that did not end."""
    if (folder / SIGNALS).is_file():
        return [folder / SIGNALS]
    parts = folder / SIGNALS if (folder / SIGNALS).is_dir() else folder / _PARTS  # killed between two renames
    return sorted(parts.glob("part-*.parquet"))


def _read(path: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """A Parquet file, read in this thread: the reader's own pool would keep some ten megabytes for good."""
    with pq.ParquetFile(path) as file:
        return file.read(columns=columns, use_threads=False)


def _stored_schema(folder: Path) -> pa.Schema:
    stored = _stored(folder)
    return pq.read_schema(stored[0]) if stored else pa.schema([])


def _read_events(folder: Path) -> list[dict[str, Any]]:
    if not (folder / EVENTS).is_file():
        return []
    lines = (folder / EVENTS).read_text(encoding="utf-8").splitlines(keepends=True)
    return [json.loads(line) for line in lines if line.endswith("\n")]


def spec_hash(spec: Mapping[str, Any]) -> str:
    """SHA-256 of a spec as canonical JSON: equal specs, equal hash."""
    return hashlib.sha256(json.dumps(spec, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def write_file(path: Path, content: str | bytes) -> None:
    """Write a whole file or nothing: to a temporary name, then renamed.

    Raises:
        RunError: it cannot be written.
    """
    temporary = path.with_name(f".{path.name}.tmp")
    try:
        with _told(path):
            temporary.write_bytes(content.encode() if isinstance(content, str) else content)
            os.replace(temporary, path)
    except RunError:
        with suppress(OSError):  # below a file, or in a folder that is not there
            temporary.unlink(missing_ok=True)
        raise


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """Failures of the file system as RunError."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error).splitlines()[0]
        raise RunError(f"{path}: cannot be written: {reason}; choose another folder with --out") from None


class RunWriter:
    """Writes a run folder while the run goes on.

    Args:
        folder: created; must not exist yet or be empty.
        spec: the resolved spec as plain data.

    Raises:
        RunError: the folder cannot be made.
    """

    def __init__(self, folder: Path, spec: Mapping[str, Any]) -> None:
        self.folder = folder
        self._parts = 0
        self._pending: list[pa.Table] = []
        self._flushed = time.monotonic()
        new = not folder.exists()
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if any(folder.iterdir()):
                raise RunError(f"{folder}: is not empty; choose another folder with --out")
        except OSError as error:
            raise RunError(f"{folder}: cannot be made: {error.strerror}; choose another folder with --out") from None
        try:
            write_file(folder / SPEC, yaml.safe_dump(dict(spec), sort_keys=False, allow_unicode=True, width=100))
        except RunError:
            if new:
                folder.rmdir()
            raise

    def write_signals(self, times: NDArray[np.float64], columns: Mapping[str, Any], units: Mapping[str, str]) -> None:
        """Add a block of samples; it is on disk within a quarter of a second."""
        if not len(times):
            return
        self._pending.append(make_table(times, columns, units))
        if time.monotonic() - self._flushed > FLUSH_AFTER:
            self.flush()

    def flush(self) -> None:
        """Write the blocks that are still in memory, as a part of their own."""
        self._flushed = time.monotonic()
        if not self._pending:
            return
        folder = self.folder / SIGNALS
        part = folder / f"part-{self._parts:06d}.parquet"
        temporary = folder / f".{part.name}.tmp"
        with _told(part):
            folder.mkdir(exist_ok=True)
            pq.write_table(pa.concat_tables(self._pending), temporary)
            os.replace(temporary, part)
        self._parts += 1
        self._pending = []

    def write_event(self, at: float, kind: str, text: str) -> None:
        """Add a line to events.jsonl."""
        path = self.folder / EVENTS
        with _told(path), path.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"time": round(at, 6), "kind": kind, "text": text}) + "\n")

    def finish(self, summary: Callable[[], Mapping[str, Any]]) -> dict[str, Any]:
        """Make signals.parquet one file and write summary.json.

        How the parts were cut does not show in the file: equal samples give equal bytes.

        Args:
            summary: called when all samples are on disk.
        """
        self.flush()
        parts = self.folder / SIGNALS
        if parts.is_dir():
            whole = self.folder / f".{SIGNALS}.tmp"
            stored = _stored(self.folder)
            with _told(parts):
                with pq.ParquetWriter(whole, pq.read_schema(stored[0])) as writer:
                    for table in _regroup(stored):
                        writer.write_table(table)
                os.replace(parts, self.folder / _PARTS)
                os.replace(whole, parts)
                shutil.rmtree(self.folder / _PARTS)
        figures = dict(summary())
        pa.default_memory_pool().release_unused()
        write_file(self.folder / SUMMARY, json.dumps(figures, indent=2) + "\n")
        return figures


class PictureLog:
    """Writes the pictures of one camera, and what the vehicle did at each, while the run goes on.

    Pictures are called ``YYYY-mm-dd-HH-MM-SS-ffffff.jpg``: 1970-01-01 plus the simulated time, so that equal runs give
    equal files. ``driving_log.txt`` has a line for each picture that is on disk: its name, the steering angle [rad] and
    the speed [m/s], separated by tabs.

    Args:
        folder: is made.

    Raises:
        RunError: the folder cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        with _told(folder):
            folder.mkdir()

    def write(self, at: float, pixels: NDArray[np.uint8], *, steering: float, speed: float) -> None:
        """Add a picture.

        Args:
            at: simulated time [s].
            pixels: red, green, blue (height, width, 3).
            steering: measured bicycle steering angle, positive to the left [rad].
            speed: measured speed of the vehicle frame's origin, forward [m/s].
        """
        name = f"{picture_name(at)}.jpg"
        jpeg = io.BytesIO()
        Image.fromarray(pixels).save(jpeg, "JPEG", quality=JPEG_QUALITY)
        write_file(self._folder / name, jpeg.getvalue())
        path = self._folder / DRIVING_LOG
        with _told(path), path.open("a", encoding="utf-8") as file:
            file.write(f"{name}\t{steering:.6f}\t{speed:.6f}\n")


def picture_name(at: float) -> str:
    """A simulated time [s] as date and time, counted from 1970-01-01, to the microsecond."""
    moment = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=round(1e6 * at))
    return moment.strftime("%Y-%m-%d-%H-%M-%S-%f")


def _regroup(parts: Sequence[Path]) -> Iterator[pa.Table]:
    """The rows of many files in groups of the same size, few at a time in memory."""
    rest: pa.Table | None = None
    for part in parts:
        table = _read(part)
        rest = table if rest is None else pa.concat_tables([rest, table])
        while rest.num_rows >= ROWS:
            yield rest.slice(0, ROWS).combine_chunks()
            rest = rest.slice(ROWS)
    if rest is not None and rest.num_rows:
        yield rest.combine_chunks()


def make_table(times: NDArray[np.float64], columns: Mapping[str, Any], units: Mapping[str, str]) -> pa.Table:
    """An Arrow table of samples: each column's metadata has its ``unit``; pandas finds all in ``attrs["units"]``."""
    names = ["time", *columns]
    fields = [pa.field(name, pa.float64(), metadata={"unit": units.get(name, "")}) for name in names]
    attributes = json.dumps({"units": {name: units.get(name, "") for name in names}})
    schema = pa.schema(fields, metadata={"PANDAS_ATTRS": attributes})
    return pa.Table.from_arrays(
        [pa.array(np.asarray(a, dtype=float)) for a in (times, *columns.values())], schema=schema
    )
