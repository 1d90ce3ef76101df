"""A Parquet table that grows on disk: a folder of finished parts, and in the end one file.

pandas and pyarrow read both in the same way. If the process is killed, all parts written so far can be read.
"""

import shutil
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from mirdrake.core.errors import ConfigError
from mirdrake.core.files import read_errors, replacing, write_errors

FLUSH_AFTER = 0.25
"""Time for which rows stay in memory before they are written [s]: what a kill can lose."""


class PartedTable:
    """Writer of a table in parts.

    The final file does not depend on the parts: equal rows give equal bytes.

    Args:
        path: path of the table; a folder at first.
        rows: rows of a row group of the final file.
        options: options of the Parquet writer.
    """

    def __init__(self, path: Path, *, rows: int, **options: Any) -> None:
        self.path = path
        self._rows, self._options = rows, options
        self._parts = 0
        self._pending: list[pa.Table] = []
        self._flushed = time.monotonic()

    def add(self, table: pa.Table) -> None:
        """Add rows; they are on disk within a quarter of a second."""
        self._pending.append(table)
        self.flush_if_due()

    def flush_if_due(self) -> None:
        """Write the rows that have been in memory for long."""
        if self._pending and time.monotonic() - self._flushed > FLUSH_AFTER:
            self.flush()

    def flush(self) -> None:
        """Write the rows that are still in memory as a new part."""
        self._flushed = time.monotonic()
        if not self._pending:
            return
        part = self.path / f"part-{self._parts:06d}.parquet"
        with write_errors(part):
            self.path.mkdir(exist_ok=True)
        # Written under another name first: a kill leaves no half part, which could not be read.
        with replacing(part) as temporary:
            pq.write_table(pa.concat_tables(self._pending), temporary, **self._options)
        self._parts += 1
        self._pending = []

    def finish(self) -> None:
        """Merge the parts into one file."""
        self.flush()
        if not self.path.is_dir():
            return
        parts, aside = stored(self.path), _aside(self.path)
        with replacing(self.path) as whole:
            # Row groups of a fixed size, so that equal rows give equal bytes however they were split into parts.
            with pq.ParquetWriter(whole, pq.read_schema(parts[0]), **self._options) as writer:
                for table in _regroup(parts, self._rows):
                    writer.write_table(table)
            self.path.rename(aside)  # the file takes the name of the folder of parts
        with write_errors(self.path):
            shutil.rmtree(aside)


def _aside(path: Path) -> Path:
    """Return the path of the parts between two renames."""
    return path.with_name(f".{path.name}.parts")


def stored(path: Path) -> list[Path]:
    """Return the Parquet files of a table: one, or the parts of a run that did not end; empty without a table."""
    if path.is_file():
        return [path]
    return sorted((path if path.is_dir() else _aside(path)).glob("part-*.parquet"))  # or killed between two renames


def read_part(path: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """Read a Parquet file in this thread, as the reader's own thread pool keeps some 10 MB."""
    with read_errors(path), pq.ParquetFile(path) as file:
        return file.read(columns=columns, use_threads=False)


def read_groups(path: Path, columns: Sequence[str] | None = None) -> Iterator[pa.Table]:
    """Yield a stored table by row groups.

    Args:
        path: path of the table.
        columns: only these.
    """
    for part in stored(path):
        with read_errors(part):
            file = pq.ParquetFile(part)
        with file:
            for index in range(file.num_row_groups):
                with read_errors(part):
                    group = file.read_row_group(index, columns=columns, use_threads=False)
                    missing = sorted(set(columns or ()) - set(group.column_names))
                    if missing:
                        raise ConfigError(f"has no column '{missing[0]}'", file=str(part))
                yield group


def _regroup(parts: Sequence[Path], rows: int) -> Iterator[pa.Table]:
    """Yield the rows of many files in groups of equal size, with few in memory at a time."""
    rest: pa.Table | None = None
    for part in parts:
        table = read_part(part)
        rest = table if rest is None else pa.concat_tables([rest, table])
        while rest.num_rows >= rows:
            # One chunk for each column: the bytes of a row group must not depend on how its rows arrived.
            yield rest.slice(0, rows).combine_chunks()
            rest = rest.slice(rows)
    if rest is not None and rest.num_rows:
        yield rest.combine_chunks()
