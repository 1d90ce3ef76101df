"""Registry of the file formats, from the suffix of a file to its reader."""

from collections.abc import Callable, Collection
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.files import read_errors
from mirdrake.core.recording.parts import read_part, stored
from mirdrake.readers.bags import read_bag
from mirdrake.readers.csv_files import read_csv
from mirdrake.readers.json_files import read_json_lines
from mirdrake.readers.mat_files import read_mat
from mirdrake.readers.npy_files import read_npy
from mirdrake.readers.pickle_files import read_pickle
from mirdrake.readers.tables import CsvLayout, Request, Table
from mirdrake.readers.vbo_files import read_vbo

Reader = Callable[[Request], Table]

_SIGNALS = "signals.parquet"
_WORKBOOKS = {".xlsx", ".xls", ".ods"}


def read_table(path: Path, columns: Collection[str] = (), layout: CsvLayout | None = None) -> Table:
    """Read a recorded file as a table.

    Args:
        path: file or run folder.
        columns: names of the columns that will be used.
        layout: layout of a CSV file.

    Raises:
        ConfigError: the file cannot be read, or its format is unknown.
    """
    request = Request(path, columns, layout or CsvLayout())
    if path.is_dir():
        return (read_bag if is_bag(path) else read_run)(request)
    if not path.exists():
        raise ConfigError("no such file", where=request.name)
    suffix = path.suffix.lower()
    # Compressed text has the format of its inner suffix.
    reader = FORMATS.get(Path(path.stem).suffix.lower() if suffix == ".gz" else suffix)
    if suffix == ".gz" and reader is not read_csv:
        raise ConfigError("unpack it first; only compressed text can be read", where=request.name)
    if reader is None and suffix in _WORKBOOKS:
        raise ConfigError("is a workbook; export its sheet as CSV", where=request.name)
    if reader is None:
        raise ConfigError(f"unknown format '{path.suffix}'; {did_you_mean(path.suffix, FORMATS)}", where=request.name)
    return reader(request)


def is_bag(path: Path) -> bool:
    """Whether a file is a bag, whose columns are topics and fields; a ROS 2 bag is a folder with metadata.yaml."""
    return FORMATS.get(path.suffix.lower()) is read_bag or (path / "metadata.yaml").is_file()


def read_run(request: Request) -> Table:
    """Read a run folder: ``time`` and the columns of signals.parquet."""
    file = request.path / _SIGNALS
    if not (request.path / "spec.yaml").is_file():
        raise ConfigError("is a folder, but not a run folder (it has no spec.yaml)", where=request.name)
    with read_errors(file):
        parts = stored(file)
        if not parts:
            raise ConfigError("has no samples", where=f"{request.name}/{_SIGNALS}")
        table = pa.concat_tables([read_part(part) for part in parts])
    return _columns(f"{request.name}", table, {"time": "s"})


def read_parquet(request: Request) -> Table:
    """Read a Parquet file; units are in the metadata of its columns."""
    try:
        table = pq.read_table(request.path)
    except (OSError, pa.ArrowInvalid):
        raise ConfigError("is not a Parquet file", where=request.name) from None
    return _columns(request.name, table, {})


def _columns(name: str, table: pa.Table, units: dict[str, str]) -> Table:
    columns = {column: table.column(column).to_pandas() for column in table.column_names}
    for column in columns:
        unit = (table.schema.field(column).metadata or {}).get(b"unit", b"").decode()
        units |= {column: unit} if unit else {}
    return Table(name, list(columns), columns, units)


FORMATS: dict[str, Reader] = {
    ".csv": read_csv,
    ".txt": read_csv,
    ".tsv": read_csv,
    ".log": read_csv,
    ".asc": read_csv,
    ".vbo": read_vbo,
    ".jsonl": read_json_lines,
    ".ndjson": read_json_lines,
    ".json": read_json_lines,
    ".parquet": read_parquet,
    ".mat": read_mat,
    ".npy": read_npy,
    ".npz": read_npy,
    ".pkl": read_pickle,
    ".pickle": read_pickle,
    ".bag": read_bag,
    ".db3": read_bag,
    ".mcap": read_bag,
}
"""Readers by suffix."""
