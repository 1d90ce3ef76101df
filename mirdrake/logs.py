"""Runs and their folders: labelled signals with units, written so that a kill leaves them readable.

::

    runs/<diagram>-<UTC time>/
      spec.yaml          the resolved spec, seed, versions and hash
      signals.parquet    time [s] and named signals; units in the column metadata
      events.jsonl       what happened, one JSON object a line
      summary.json       figures of the run
      recording.html     Meshcat replay        report.html, diagram.svg

While a run goes on, ``signals.parquet`` is a folder of finished parts, which pandas and pyarrow read like a file; at
the end, also after Ctrl-C, it becomes one file. Whatever kills the process, all parts written so far can be read.
"""

import hashlib
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import yaml
from numpy.typing import NDArray

from mirdrake.errors import ConfigError, RunError, did_you_mean

SIGNALS, SUMMARY, SPEC, EVENTS = "signals.parquet", "summary.json", "spec.yaml", "events.jsonl"
_PARTS = f".{SIGNALS}.parts"


@dataclass(frozen=True)
class Run:
    """What a simulation gave.

    Attributes:
        folder: where it was written, or None if it is only in memory.
        spec: the resolved diagram spec as plain data, with seed and versions.
        summary: figures of the run, see summary.json.
        signals: samples by name, index ``time`` [s].
        units: unit of every signal, "" for pure numbers.
        events: what happened: time [s], kind, text.
    """

    folder: Path | None
    spec: dict[str, Any]
    summary: dict[str, Any]
    signals: pd.DataFrame
    units: dict[str, str] = field(default_factory=dict)
    events: list[dict[str, Any]] = field(default_factory=list)

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
    signals, units = pd.DataFrame(index=pd.Index([], name="time")), {}
    stored = folder / SIGNALS if (folder / SIGNALS).exists() else folder / _PARTS  # killed between two renames
    if stored.exists():
        table = _read_table(stored)
        units = {name: (table.field(name).metadata or {}).get(b"unit", b"").decode() for name in table.column_names}
        signals = table.to_pandas().set_index("time")
        if "simulated_s" not in summary and len(signals):
            summary["simulated_s"] = float(signals.index[-1])
    events = []
    if (folder / EVENTS).is_file():
        lines = (folder / EVENTS).read_text(encoding="utf-8").splitlines(keepends=True)
        events = [json.loads(line) for line in lines if line.endswith("\n")]
    return Run(folder, spec, summary, signals, units, events)


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
        """Add a block of samples."""
        if not len(times):
            return
        folder = self.folder / SIGNALS
        with _told(folder):
            folder.mkdir(exist_ok=True)
        table = make_table(times, columns, units)
        part = folder / f"part-{self._parts:06d}.parquet"
        temporary = folder / f".{part.name}.tmp"
        with _told(part):
            pq.write_table(table, temporary)
            os.replace(temporary, part)
        self._parts += 1

    def write_event(self, time: float, kind: str, text: str) -> None:
        """Add a line to events.jsonl."""
        path = self.folder / EVENTS
        with _told(path), path.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"time": round(time, 6), "kind": kind, "text": text}) + "\n")

    def finish(self, summary: Mapping[str, Any]) -> None:
        """Make signals.parquet one file and write summary.json."""
        folder = self.folder / SIGNALS
        if folder.is_dir():
            whole = self.folder / f".{SIGNALS}.tmp"
            writer: Any = None
            with _told(folder):
                for part in sorted(folder.glob("part-*.parquet")):
                    table = pq.read_table(part)
                    writer = writer or pq.ParquetWriter(whole, table.schema)
                    writer.write_table(table)
                if writer is not None:
                    writer.close()
                    os.replace(folder, self.folder / _PARTS)
                    os.replace(whole, folder)
                    shutil.rmtree(self.folder / _PARTS)
        write_file(self.folder / SUMMARY, json.dumps(dict(summary), indent=2) + "\n")


def make_table(times: NDArray[np.float64], columns: Mapping[str, Any], units: Mapping[str, str]) -> pa.Table:
    """An Arrow table of samples: each column's metadata has its ``unit``; pandas finds all in ``attrs["units"]``."""
    names = ["time", *columns]
    fields = [pa.field(name, pa.float64(), metadata={"unit": units.get(name, "")}) for name in names]
    attributes = json.dumps({"units": {name: units.get(name, "") for name in names}})
    schema = pa.schema(fields, metadata={"PANDAS_ATTRS": attributes})
    return pa.Table.from_arrays(
        [pa.array(np.asarray(a, dtype=float)) for a in (times, *columns.values())], schema=schema
    )


def _read_table(path: Path) -> pa.Table:
    """A Parquet file, or the parts of one that is being written."""
    if path.is_file():
        return pq.read_table(path)
    parts = sorted(path.glob("part-*.parquet"))
    if not parts:
        return make_table(np.empty(0), {}, {})
    return pa.concat_tables([pq.read_table(part) for part in parts])
