"""The folder of a study: rows that are on disk soon after their runs, and in the end one table.

::

    study.json         what was asked: the study, its diagram, versions, and the digest of it all
    parts/             rows as they came, while the study goes on
    results.parquet    all rows in the order of the runs, when it is complete; equal studies give equal bytes

Whatever kills the process, all parts written so far can be read.
"""

import json
import os
import shutil
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from mirdrake.core.errors import ConfigError, RunError
from mirdrake.core.files import write_errors, write_file
from mirdrake.core.json_io import parse_json
from mirdrake.core.recording.parts import read_part

STUDY_FILE, RESULTS_FILE, PARTS = "study.json", "results.parquet", "parts"

FLUSH_AFTER = 0.5
"""Time for which rows stay in memory before they are written [s], or a fiftieth of the time spent so far."""

Row = dict[str, Any]


class Store:
    """Writes the rows of a study.

    Args:
        folder: made if it is not there; None keeps everything in memory.
        schema: of the table; its first column is ``run``.
        runs: number of all runs.
    """

    def __init__(self, folder: Path | None, schema: pa.Schema, runs: int) -> None:
        self.folder, self.schema, self.runs = folder, schema, runs
        self.rows: dict[int, Row] = {}
        self._pending: list[Row] = []
        self._next = 0
        self._began = self._flushed = time.monotonic()

    def open(self, manifest: Mapping[str, Any], *, resume: bool) -> None:
        """Make the folder, or take up the rows that it has.

        Raises:
            RunError: it cannot be written, or has something else in it.
        """
        if self.folder is None:
            return
        with write_errors(self.folder):
            self.folder.mkdir(parents=True, exist_ok=True)
            used = any(self.folder.iterdir())
        if used and not resume:
            raise RunError(f"{self.folder}: is not empty; choose another folder, or resume the study in it")
        if used:
            before = read_manifest(self.folder)
            for key, what in (("study", "study"), ("content", "models or worlds"), ("versions", "versions")):
                if before.get(key) != manifest[key]:
                    raise RunError(
                        f"{self.folder}: was begun with another {what.removesuffix('s')}; it cannot go on with this one"
                        if key == "study"
                        else f"{self.folder}: the {what} have changed since it was begun; run it in another folder"
                    )
            self.rows = {row["run"]: row for row in read_rows(self.folder)}
            self._next = 1 + max([int(part.stem.rpartition("-")[2]) for part in _parts(self.folder)], default=-1)
        else:
            write_file(self.folder / STUDY_FILE, json.dumps(manifest, indent=1) + "\n")

    def add(self, row: Row) -> None:
        """Add a row; :meth:`flush_if_due` writes it."""
        self.rows[row["run"]] = row
        self._pending.append(row)

    def flush_if_due(self) -> None:
        """Write the rows that have been in memory for long."""
        now = time.monotonic()
        if now - self._flushed > max(FLUSH_AFTER, 0.02 * (now - self._began)):
            self.flush()

    def flush(self) -> None:
        """Write the rows that are still in memory, as a part of their own."""
        self._flushed = time.monotonic()
        if self.folder is None or not self._pending:
            return
        parts = self.folder / PARTS
        with write_errors(parts):
            parts.mkdir(exist_ok=True)
        _write(parts / f"part-{self._next:06d}.parquet", self._table(self._pending))
        self._next += 1
        self._pending = []

    def finish(self) -> None:
        """Write what is left; make it one file if it is complete."""
        self.flush()
        if self.folder is None or len(self.rows) < self.runs:
            return
        if not (self.folder / RESULTS_FILE).is_file() or (self.folder / PARTS).is_dir():
            _write(self.folder / RESULTS_FILE, self.table())
            shutil.rmtree(self.folder / PARTS, ignore_errors=True)

    def table(self) -> pa.Table:
        """All rows in the order of the runs."""
        return self._table([self.rows[index] for index in sorted(self.rows)])

    def _table(self, rows: Sequence[Row]) -> pa.Table:
        return pa.Table.from_pylist(list(rows), schema=self.schema)


def read_manifest(folder: Path) -> dict[str, Any]:
    """What a study folder was made for.

    Raises:
        ConfigError: it is no folder of a study.
    """
    file = folder / STUDY_FILE
    if not file.is_file():
        raise ConfigError(f"{folder}: not the folder of a study (it has no {STUDY_FILE})")
    try:
        data = parse_json(file.read_text(encoding="utf-8"))
        if not isinstance(data, dict):
            raise ValueError("no mapping")
    except ValueError as error:
        raise ConfigError(f"{file}: cannot be read: {error}") from None
    return data


def read_rows(folder: Path) -> list[Row]:
    """The rows of a study folder, each run once, in no certain order.

    Raises:
        ConfigError: a file is damaged.
    """
    rows: dict[int, Row] = {}
    whole = folder / RESULTS_FILE
    for part in [*_parts(folder), *([whole] if whole.is_file() else [])]:
        try:
            rows |= {row["run"]: row for row in read_part(part).to_pylist()}
        except (pa.ArrowException, OSError) as error:
            raise ConfigError(f"{part}: cannot be read: {str(error).splitlines()[0]}") from None
    return list(rows.values())


def make_schema(parameters: Mapping[str, str | None], metrics: Iterable[str]) -> pa.Schema:
    """Columns of the table: run, parameters, status, reason, simulated time, metrics.

    Args:
        parameters: unit by name; None for one whose values are no numbers.
        metrics: names.
    """
    fields = [pa.field("run", pa.int64(), nullable=False)]
    for name, unit in parameters.items():
        kind = pa.string() if unit is None else pa.float64()
        fields.append(pa.field(name, kind, metadata={"unit": unit or ""}))
    fields += [pa.field("status", pa.string()), pa.field("reason", pa.string())]
    fields.append(pa.field("simulated", pa.float64(), metadata={"unit": "s"}))
    fields += [pa.field(name, pa.float64()) for name in metrics]
    return pa.schema(fields)


def _parts(folder: Path) -> list[Path]:
    return sorted((folder / PARTS).glob("part-*.parquet"))


def _write(path: Path, table: pa.Table) -> None:
    """A whole Parquet file or none."""
    temporary = path.with_name(f".{path.name}.tmp")
    with write_errors(path):
        pq.write_table(table, temporary)
        os.replace(temporary, path)
