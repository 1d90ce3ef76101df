"""The folder of a study: a row per run, on disk as soon as the run is finished, and in the end one table.

::

    study.json         the study, its diagram, versions, and the digest of all that
    results.jsonl      rows in the order in which runs finished, until the study is complete
    shards/*.parquet   the same of a study of the single-track model: a file per shard, in place of results.jsonl
    results.parquet    all rows in the order of the runs, when it is complete; equal studies give equal bytes

Whatever kills the process, the rows written until then can be read.
"""

import json
import shutil
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from mirdrake.core.errors import ConfigError, RunError
from mirdrake.core.files import read_errors, replacing, write_errors, write_file
from mirdrake.core.json_io import Json, parse_json
from mirdrake.core.recording.parts import read_part
from mirdrake.execution.journal import Journal, Record, read_records

STUDY_FILE, JOURNAL_FILE, RESULTS_FILE, SHARDS = "study.json", "results.jsonl", "results.parquet", "shards"

Row = Json
"""A row of the table: run, parameters, status, reason, simulated, metrics."""


def open_journal(folder: Path | None, manifest: Mapping[str, Any], *, resume: bool) -> Journal:
    """Create the folder of a study, or continue with the rows that it has.

    Args:
        folder: None keeps everything in memory.
        manifest: content of study.json.
        resume: whether the folder may hold rows of this very study.

    Raises:
        RunError: the folder cannot be written, or holds something else.
    """
    if folder is None:
        return Journal(None, key="run")
    with write_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        used = any(folder.iterdir())
    if used and not resume:
        raise RunError("is not empty; choose another folder, or resume the study in it", where=str(folder))
    if used:
        before = read_manifest(folder)
        # Compared in full, not by digest alone, so that the message can say which part has changed.
        if before.get("study") != manifest["study"]:
            raise RunError("was begun with another study; it cannot be resumed with this one", where=str(folder))
        for key, name in (("content", "models or worlds"), ("versions", "versions")):
            if before.get(key) != manifest[key]:
                raise RunError(
                    f"the {name} have changed since the study was begun; choose another folder", where=str(folder)
                )
    else:
        write_file(folder / STUDY_FILE, json.dumps(manifest, indent=1) + "\n")

    # A complete study has no journal any more; its rows are read back, so that nothing is computed again.
    complete = (folder / RESULTS_FILE).is_file()
    journal = Journal(None if complete else folder / JOURNAL_FILE, key="run")
    if complete:
        journal.records = _read_table(folder / RESULTS_FILE)
    return journal


def write_results(folder: Path, table: pa.Table) -> None:
    """Write the table of a complete study in place of its journal.

    Raises:
        RunError: the folder cannot be written.
    """
    # Written to a temporary file and renamed: a reader never sees half a table.
    if not (folder / RESULTS_FILE).is_file():
        with replacing(folder / RESULTS_FILE) as temporary:
            pq.write_table(table, temporary)
    with write_errors(folder):
        # Only after the table is in place, so that a crash in between loses nothing.
        (folder / JOURNAL_FILE).unlink(missing_ok=True)


def read_manifest(folder: Path) -> Json:
    """Return the content of study.json.

    Raises:
        ConfigError: the folder is not that of a study, or the file is damaged.
    """
    file = folder / STUDY_FILE
    if not file.is_file():
        raise ConfigError(f"not the folder of a study (it has no {STUDY_FILE})", where=str(folder))
    with read_errors(file):
        data = parse_json(file.read_text(encoding="utf-8"))
        if not isinstance(data, dict):
            raise ValueError("not a JSON object")
        return data


def read_rows(folder: Path) -> dict[str, Record]:
    """Return the rows of a study folder by their runs.

    Raises:
        ConfigError: a file is damaged.
    """
    complete = (folder / RESULTS_FILE).is_file()
    return _read_table(folder / RESULTS_FILE) if complete else read_records(folder / JOURNAL_FILE, key="run")


def make_schema(parameters: Mapping[str, str | None], metrics: Iterable[str], *, verdict: bool = False) -> pa.Schema:
    """Return the columns of the table: run, parameters, status, verdict, reason, simulated time, metrics.

    Args:
        parameters: unit by name; None for a parameter whose values are not numbers.
        metrics: names.
        verdict: whether the study is one of a manoeuvre, which has a verdict.
    """
    fields = [pa.field("run", pa.int64(), nullable=False)]
    for name, unit in parameters.items():
        kind = pa.string() if unit is None else pa.float64()
        fields.append(pa.field(name, kind, metadata={"unit": unit or ""}))
    fields.append(pa.field("status", pa.string()))
    fields += [pa.field("verdict", pa.string())] if verdict else []
    fields.append(pa.field("reason", pa.string()))
    fields.append(pa.field("simulated", pa.float64(), metadata={"unit": "s"}))
    fields += [pa.field(name, pa.float64()) for name in metrics]
    return pa.schema(fields)


def make_table(records: Mapping[str, Record], schema: pa.Schema) -> pa.Table:
    """Return rows in the order of the runs as a table."""
    # JSON keys are texts; sorted as numbers, else run 10 would come before run 2.
    rows: list[Row] = [{"run": int(run), **records[run]} for run in sorted(records, key=int)]
    return pa.Table.from_pylist(rows, schema=schema)


class ShardStore:
    """Finished shards of a study of the single-track model.

    Attributes:
        numbers: of the finished shards.
        rows: number of their rows.

    Args:
        folder: of the study; None keeps the tables in memory.
        schema: columns of the table.

    Raises:
        RunError: a file is damaged.
    """

    def __init__(self, folder: Path | None, schema: pa.Schema) -> None:
        self._folder = None if folder is None else folder / SHARDS
        self._schema, self._tables = schema, dict[int, pa.Table]()
        if self._folder is not None and self._folder.is_dir():
            for file in sorted(self._folder.glob("*.parquet")):
                with read_errors(file):
                    self._tables[int(file.stem)] = pq.read_table(file, schema=schema)

    @property
    def numbers(self) -> set[int]:
        """Numbers of the finished shards."""
        return set(self._tables)

    @property
    def rows(self) -> int:
        """Number of their rows."""
        return sum(table.num_rows for table in self._tables.values())

    def add(self, number: int, rows: Sequence[Row]) -> None:
        """Keep the rows of a shard.

        Raises:
            RunError: the file cannot be written.
        """
        table = self._tables[number] = pa.Table.from_pylist(list(rows), schema=self._schema)
        if self._folder is not None:
            with write_errors(self._folder):
                self._folder.mkdir(exist_ok=True)
            with replacing(self._folder / f"{number:06d}.parquet") as temporary:
                pq.write_table(table, temporary)

    def table(self) -> pa.Table:
        """Return the rows of all finished shards."""
        tables = [self._tables[number] for number in sorted(self._tables)]
        return pa.concat_tables(tables).combine_chunks() if tables else self._schema.empty_table()

    def clear(self) -> None:
        """Delete the files."""
        if self._folder is not None and self._folder.is_dir():
            with write_errors(self._folder):
                shutil.rmtree(self._folder)


def read_shards(folder: Path, schema: pa.Schema) -> pa.Table:
    """Return the rows of the finished shards of a study folder.

    Raises:
        RunError: a file is damaged.
    """
    return ShardStore(folder, schema).table()


def _read_table(file: Path) -> dict[str, Record]:
    with read_errors(file):
        return {str(row.pop("run")): row for row in read_part(file).to_pylist()}
