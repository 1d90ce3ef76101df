"""The formats of recorded drives: one registry, from the suffix of a file to its reader.

A format to come, as ROS bags and MCAP, is one more function and one more line in :data:`FORMATS`.
"""

from collections.abc import Callable, Collection
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from scipy.io import loadmat

from mirdrake.errors import ConfigError, MissingDependencyError, did_you_mean
from mirdrake.identification.csv_files import read_csv
from mirdrake.identification.spec import CsvLayout
from mirdrake.identification.tables import Table, read_bytes
from mirdrake.logs import SIGNALS, SPEC, load_run
from mirdrake.yaml_io import shown

Reader = Callable[[Path, Collection[str], CsvLayout], Table]


def read_table(path: Path, wanted: Collection[str], layout: CsvLayout) -> Table:
    """A recorded drive as a table.

    Args:
        path: file or run folder.
        wanted: names of the columns that will be asked for.
        layout: what the user says of a CSV file.

    Raises:
        ConfigError: it cannot be read, or its format is not known.
    """
    if path.is_dir():
        return read_run(path, wanted, layout)
    if not path.exists():
        raise ConfigError(f"{shown(path)}: no such file")
    reader = FORMATS.get(path.suffix.lower())
    if reader is None:
        raise ConfigError(f"{shown(path)}: unknown format '{path.suffix}'; {did_you_mean(path.suffix, FORMATS)}")
    return reader(path, wanted, layout)


def read_run(path: Path, wanted: Collection[str], layout: CsvLayout) -> Table:  # noqa: ARG001
    """A run folder of ours: the columns of signals.parquet, and ``time``."""
    if not (path / SPEC).is_file():
        raise ConfigError(f"{shown(path)}: is a folder and no run folder (it has no {SPEC})")
    run = load_run(path)
    if not len(run.signals):
        raise ConfigError(f"{shown(path / SIGNALS)}: has no samples")
    columns = {"time": run.signals.index.to_numpy(), **{str(name): run.signals[name] for name in run.signals}}
    return Table(shown(path), list(columns), columns, {"time": "s", **run.units})


def read_parquet(path: Path, wanted: Collection[str], layout: CsvLayout) -> Table:  # noqa: ARG001
    """A Parquet file; units from the metadata of its columns."""
    try:
        table = pq.read_table(path)
    except (OSError, pa.ArrowInvalid):
        raise ConfigError(f"{shown(path)}: is not a Parquet file") from None
    units = {name: (table.schema.field(name).metadata or {}).get(b"unit", b"").decode() for name in table.column_names}
    columns = {name: table.column(name).to_pandas() for name in table.column_names}
    return Table(shown(path), list(columns), columns, {name: unit for name, unit in units.items() if unit})


def read_mat(path: Path, wanted: Collection[str], layout: CsvLayout) -> Table:  # noqa: ARG001
    """A MAT file up to version 7: its vectors by name, fields of structs as ``struct.field``."""
    raw = read_bytes(path)
    if raw[:10] == b"MATLAB 7.3":
        raise ConfigError(f"{shown(path)}: is MAT version 7.3, which is not read; save it with -v7")
    try:
        content = loadmat(BytesIO(raw), simplify_cells=True)
    except Exception:  # scipy raises what its parser meets on a broken file
        raise ConfigError(f"{shown(path)}: is not a MAT file, or is broken") from None
    columns: dict[str, Any] = {}

    def collect(prefix: str, value: Any) -> None:
        if isinstance(value, dict):
            for key, item in value.items():
                collect(f"{prefix}.{key}" if prefix else key, item)
        elif isinstance(value, np.ndarray) and value.size > 1 and value.size == max(value.shape):
            columns[prefix] = value.ravel()

    collect("", {key: value for key, value in content.items() if not key.startswith("__")})
    return Table(shown(path), list(columns), columns)


def read_bag(path: Path, wanted: Collection[str], layout: CsvLayout) -> Table:  # noqa: ARG001
    """ROS bags and MCAP: not read yet."""
    raise MissingDependencyError(f"{shown(path)}: bags and MCAP are not read yet; convert the topics to CSV or Parquet")


FORMATS: dict[str, Reader] = {
    ".csv": read_csv,
    ".txt": read_csv,
    ".tsv": read_csv,
    ".asc": read_csv,
    ".parquet": read_parquet,
    ".mat": read_mat,
    ".bag": read_bag,
    ".db3": read_bag,
    ".mcap": read_bag,
}
"""Readers by the suffix of the file."""
