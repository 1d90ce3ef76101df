"""The formats of recorded drives: one registry, from the suffix of a file to its reader.

A further format is one more function and one more line in :data:`FORMATS`.
"""

import pickle
import subprocess
import sys
from collections.abc import Callable, Collection
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from mirdrake.core.errors import ConfigError, MissingDependencyError, did_you_mean
from mirdrake.core.yaml_io import shown
from mirdrake.identification.bags import read_bag
from mirdrake.identification.csv_files import read_csv
from mirdrake.identification.spec import CsvLayout
from mirdrake.identification.tables import Table, read_bytes
from mirdrake.identification.vbo_files import read_vbo
from mirdrake.runs.logs import SIGNALS, SPEC, load_run

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
        return (read_bag if (path / "metadata.yaml").is_file() else read_run)(path, wanted, layout)
    if not path.exists():
        raise ConfigError(f"{shown(path)}: no such file")
    suffix = path.suffix.lower()
    reader = FORMATS.get(Path(path.stem).suffix.lower() if suffix == ".gz" else suffix)
    if suffix == ".gz" and reader is not read_csv:
        raise ConfigError(f"{shown(path)}: unpack it first; of compressed files only text is read")
    if reader is None and suffix in {".xlsx", ".xls", ".ods"}:
        raise ConfigError(f"{shown(path)}: is a workbook; export its sheet as CSV")
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
    """A MAT file: its vectors by name, fields of structs as ``struct.field``, of what was saved as timeseries too.

    Version 7.3 is HDF5 and needs h5py.
    """
    raw = read_bytes(path)
    columns: dict[str, Any] = {}

    def collect(prefix: str, value: Any) -> None:
        if isinstance(value, dict):
            for key, item in value.items():
                collect(f"{prefix}.{key}" if prefix else key, item)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and value.size > 1:
            if value.size == max(value.shape):
                columns[prefix] = value.ravel()
            elif value.ndim == 2:  # the columns of a matrix, counted from 1 as there
                tall = value if value.shape[0] >= value.shape[1] else value.T
                columns.update({f"{prefix}.{at + 1}": tall[:, at] for at in range(tall.shape[1])})

    content = (_read_hdf5 if raw[:10] == b"MATLAB 7.3" else _read_mat5)(path, raw)
    collect("", {key: value for key, value in content.items() if not key.startswith(("__", "#"))})
    if not columns:
        raise ConfigError(f"{shown(path)}: has no vectors of numbers")
    return Table(shown(path), list(columns), columns)


MAT_TIME = 20.0
"""Time after which reading a MAT file is given up [s]."""

_READ_MAT = """
import pickle, sys
from io import BytesIO
from scipy.io import loadmat
pickle.dump(loadmat(BytesIO(sys.stdin.buffer.read()), simplify_cells=True), sys.stdout.buffer)
"""


def _read_mat5(path: Path, raw: bytes) -> dict[str, Any]:
    """Return the contents of a MAT file before version 7.3.

    It is read in another process, as compiled code of SciPy crashes on some broken files.
    """
    command = [sys.executable, "-P", "-W", "ignore", "-c", _READ_MAT]
    try:
        done = subprocess.run(command, input=raw, capture_output=True, timeout=MAT_TIME, check=True)
        content: dict[str, Any] = pickle.loads(done.stdout)
    except subprocess.TimeoutExpired:
        raise ConfigError(f"{shown(path)}: cannot be read within {MAT_TIME:g} s; is it broken?") from None
    except (subprocess.SubprocessError, EOFError, pickle.UnpicklingError):
        raise ConfigError(f"{shown(path)}: is not a MAT file, or is broken") from None
    return content


def _read_hdf5(path: Path, raw: bytes) -> dict[str, Any]:
    """The numbers of a MAT file of version 7.3, groups as mappings."""
    try:
        h5py = import_module("h5py")
    except ImportError:
        raise MissingDependencyError(
            f"{shown(path)}: is MAT version 7.3, which needs h5py: pip install 'mirdrake[bags]'; or save it with -v7"
        ) from None

    def plain(item: Any) -> Any:
        if isinstance(item, h5py.Group):
            return {key: plain(inner) for key, inner in item.items()}
        return np.asarray(item) if item.dtype.kind in "biuf" else None

    try:
        with h5py.File(BytesIO(raw), "r") as file:
            return {key: plain(item) for key, item in file.items()}
    except Exception:  # h5py raises what HDF5 meets on a broken file
        raise ConfigError(f"{shown(path)}: says that it is MAT version 7.3, and is broken") from None


FORMATS: dict[str, Reader] = {
    ".csv": read_csv,
    ".txt": read_csv,
    ".tsv": read_csv,
    ".asc": read_csv,
    ".vbo": read_vbo,
    ".parquet": read_parquet,
    ".mat": read_mat,
    ".bag": read_bag,
    ".db3": read_bag,
    ".mcap": read_bag,
}
"""Readers by the suffix of the file."""
