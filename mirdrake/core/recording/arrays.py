"""Array samples: the scans of laser scanners and lidars, each sensor in a compact table.

``ego.front_lidar.parquet`` has a row for each scan: ``time`` [s], and a column for each array of it, flat, with its
shape in the column's metadata. Distances are float32 [m]; inf where there was no return. Any reader of Parquet opens
it, and so does one line of Python::

    ranges = np.stack(pandas.read_parquet("ego.front_lidar.parquet")["ranges"])  # (scans, rows * columns)
    ranges = load_run("runs/drive").arrays["ego.front_lidar"]["ranges"]           # (scans, rows, columns)
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.files import read_errors
from mirdrake.core.recording.parts import PartedTable, read_groups, stored

Array = NDArray[Any]

SUFFIX = ".parquet"
_GROUP = 8 * 2**20  # bytes of a row group, about


class ArrayLog:
    """Writer of the samples of one sensor during a run.

    Args:
        path: path of the table, with the suffix .parquet; until the end of the run a folder.
        units: unit of each column, as far as they have one.
    """

    def __init__(self, path: Path, *, units: Mapping[str, str] | None = None) -> None:
        self._path, self._units = path, dict(units or {})
        self.name = path.name.removesuffix(SUFFIX)
        self._table: PartedTable | None = None
        self._schema: pa.Schema | None = None
        self.count = 0

    def write(self, time: float, sample: Any) -> None:
        """Add a sample.

        Args:
            time: when it was taken [s].
            sample: an array, or a dataclass with arrays and numbers.

        Raises:
            RunError: the folder cannot be written.
        """
        columns = columns_of(sample)
        if self._table is None or self._schema is None:
            self._schema = _schema(columns, self._units)
            size = 8 + sum(values.nbytes for values in columns.values())
            # Row groups by bytes: a scan has from ten to a million values.
            rows = max(1, _GROUP // size)
            self._table = PartedTable(self._path, rows=rows, compression="zstd", use_dictionary=False)
        flat = [pa.array([time], pa.float64())]
        for name, values in columns.items():
            kind = self._schema.field(name).type
            # Flat lists: Parquet has no multidimensional arrays; the shape is in the metadata of the column.
            if pa.types.is_list(kind):
                items = pa.array(values.ravel(), kind.value_type)
                flat.append(pa.ListArray.from_arrays(pa.array([0, values.size], pa.int32()), items))
            else:
                flat.append(pa.array([values.item()], kind))
        self._table.add(pa.Table.from_arrays(flat, schema=self._schema))
        self.count += 1

    def flush_if_due(self) -> None:
        """Write the samples that have been in memory for long."""
        if self._table is not None:
            self._table.flush_if_due()

    def close(self) -> None:
        """Merge the parts into one file."""
        if self._table is not None:
            self._table.finish()


def columns_of(sample: Any) -> dict[str, Array]:
    """Return the arrays of a sample by name, without its time; a bare array has the name ``ranges``."""
    if not is_dataclass(sample):
        return {"ranges": np.asarray(sample, dtype=np.float32)}
    pairs = ((field.name, getattr(sample, field.name)) for field in fields(sample) if field.name != "time")
    return {name: np.asarray(value) for name, value in pairs if isinstance(value, np.ndarray | float | int)}


def _schema(columns: Mapping[str, Array], units: Mapping[str, str]) -> pa.Schema:
    entries = [pa.field("time", pa.float64(), metadata={"unit": "s"})]
    for name, values in columns.items():
        item = pa.from_numpy_dtype(values.dtype)
        about = {"unit": units.get(name, ""), "shape": json.dumps(values.shape)}
        entries.append(pa.field(name, pa.list_(item) if values.ndim else item, metadata=about))
    return pa.schema(entries)


class Samples(Mapping[str, Any]):
    """The samples of one sensor: ``samples.times`` [s] (n), ``samples["ranges"]`` (n, ...); read on access.

    Args:
        path: path of the table.

    Attributes:
        path: the same.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with read_errors(path):
            self._schema = pq.read_schema(stored(path)[0])

    @property
    def times(self) -> NDArray[np.float64]:
        """Times of the samples [s] (n)."""
        parts = [table["time"].to_numpy() for table in read_groups(self.path, ["time"])]
        return np.concatenate(parts)

    @property
    def units(self) -> dict[str, str]:
        """Unit of each column, "" for pure numbers."""
        return {name: (self._schema.field(name).metadata or {}).get(b"unit", b"").decode() for name in self}

    def __getitem__(self, name: str) -> Any:
        """Return a column: an array (n, ...), or a list of arrays if the samples differ in size."""
        if name not in self._schema.names or name == "time":
            raise ConfigError(f"no array '{name}'; {did_you_mean(name, self)}", where=self.path.stem)
        with read_errors(self.path):
            parts = [self._values(table, name) for table in read_groups(self.path, [name])]
        if all(isinstance(part, np.ndarray) for part in parts):
            return np.concatenate(parts)
        return [array for part in parts for array in part]

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of the arrays of this name; empty for numbers."""
        about = self._schema.field(name).metadata or {}
        return tuple(json.loads(about.get(b"shape", b"[]")))

    def sample(self, index: int) -> dict[str, Array]:
        """Return the arrays of one sample by name; only its row group is read.

        Raises:
            IndexError: there are not so many samples.
        """
        rest = index
        for part in stored(self.path):
            with read_errors(part), pq.ParquetFile(part) as file:
                for group in range(file.num_row_groups):
                    rows = file.metadata.row_group(group).num_rows
                    if 0 <= rest < rows:
                        row = file.read_row_group(group, use_threads=False).slice(rest, 1)
                        return {name: self._values(row, name)[0] for name in self}
                    rest -= rows
        raise IndexError(f"{self.path.stem}: no sample {index}")

    def is_number(self, name: str) -> bool:
        """Return whether each sample has a single number of this name."""
        return not pa.types.is_list(self._schema.field(name).type)

    def frame(self) -> pd.DataFrame:
        """Return all columns, with arrays as cells, index ``time`` [s]."""
        table: pd.DataFrame = pa.concat_tables(list(read_groups(self.path))).to_pandas()
        return table.set_index("time")

    def __iter__(self) -> Iterator[str]:
        return (name for name in self._schema.names if name != "time")

    def __contains__(self, name: object) -> bool:
        """Return whether the samples have a column of this name."""
        return name in self._schema.names and name != "time"

    def __len__(self) -> int:
        return len(self._schema.names) - 1

    def each(self) -> Iterator[tuple[float, dict[str, Array]]]:
        """Yield time [s] and arrays by name of each sample, with few samples in memory at a time."""
        for table in read_groups(self.path):
            with read_errors(self.path):
                values = {name: self._values(table, name) for name in self}
                times = table["time"].to_pylist()
            for row, time in enumerate(times):
                yield time, {name: column[row] for name, column in values.items()}

    def _values(self, table: pa.Table, name: str) -> Any:
        column = table[name].combine_chunks()
        if isinstance(column, pa.ChunkedArray):  # an empty one, in some versions
            column = pa.concat_arrays(column.chunks)
        if not pa.types.is_list(column.type):
            return column.to_numpy(zero_copy_only=False)
        shape = json.loads((self._schema.field(name).metadata or {})[b"shape"])
        sizes = np.diff(column.offsets.to_numpy())
        flat = column.flatten().to_numpy(zero_copy_only=False)
        if (sizes == np.prod(shape, dtype=int)).all():
            return flat.reshape(len(column), *shape)
        return np.split(flat, np.cumsum(sizes)[:-1])


class RunArrays(Mapping[str, Samples]):
    """All sensors of a run whose samples are arrays or vectors, by name.

    Args:
        folder: folder of the run; None if it is only in memory.
        apart: names of the tables that are none of them.
    """

    def __init__(self, folder: Path | None, *, apart: Sequence[str]) -> None:
        self._paths = {}
        if folder is not None:
            names = {path.name.removeprefix(".").removesuffix(".parts") for path in folder.glob("*.parquet*")}
            names |= {path.name[1:].removesuffix(".parts") for path in folder.glob(".*.parquet.parts")}
            paths = {name.removesuffix(SUFFIX): folder / name for name in names if name.endswith(SUFFIX)}
            self._paths = {
                name: paths[name] for name in sorted(paths) if paths[name].name not in apart and stored(paths[name])
            }

    def __getitem__(self, name: str) -> Samples:
        if name not in self._paths:
            raise ConfigError(f"run: no arrays of '{name}'; {did_you_mean(name, self._paths)}")
        return Samples(self._paths[name])

    def __iter__(self) -> Iterator[str]:
        return iter(self._paths)

    def __contains__(self, name: object) -> bool:
        """Return whether a sensor of this name has samples."""
        return name in self._paths

    def __len__(self) -> int:
        return len(self._paths)
