"""Vector samples: of an IMU, a GPS receiver or an encoder, each at the sensor's own rate.

``ego.imu.parquet`` has a row for each sample: ``time`` [s], when it was taken, and a column for each element, with its
unit in the column's metadata. What signals.parquet has of the sensor is what it shows at the rate of the signals.
"""

import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from mirdrake.core.recording import parts
from mirdrake.core.recording.arrays import SUFFIX
from mirdrake.core.recording.parts import PartedTable

ROWS = 5_000
"""Rows of a row group."""


class VectorLog:
    """Writer of the samples of one sensor during a run.

    Args:
        path: path of the table, with the suffix .parquet; until the end of the run a folder.
        units: units of the elements, by their names.
    """

    def __init__(self, path: Path, units: Mapping[str, str]) -> None:
        self.name = path.name.removesuffix(SUFFIX)
        self._names, self._units = list(units), {"time": "s", **units}
        self._table = PartedTable(path, rows=ROWS)
        self._rows: list[NDArray[np.float64]] = []
        self._flushed = time.monotonic()
        self.count = 0

    def write(self, time: float, sample: NDArray[np.float64]) -> None:
        """Add a sample; it is on disk within a quarter of a second.

        Args:
            time: when it was taken [s].
            sample: its elements (n).

        Raises:
            RunError: the folder cannot be written.
        """
        self._rows.append(np.concatenate(([time], sample)))
        self.count += 1

    def flush_if_due(self) -> None:
        """Write what has been in memory for long."""
        if self._rows and time.monotonic() - self._flushed > parts.FLUSH_AFTER:
            self._flush()

    def close(self) -> None:
        """Make it one file."""
        self._flush()
        self._table.finish()

    def _flush(self) -> None:
        self._flushed = time.monotonic()
        if self._rows:
            # Transposed once per block; Arrow stores by column.
            times, *columns = np.array(self._rows).T
            self._rows = []
            self._table.add(make_table(times, dict(zip(self._names, columns, strict=True)), self._units))
            self._table.flush()


def make_table(times: NDArray[np.float64], columns: Mapping[str, Any], units: Mapping[str, str]) -> pa.Table:
    """Return an Arrow table of samples: units are in the metadata of the columns, in pandas in ``attrs["units"]``."""
    names = ["time", *columns]
    fields = [pa.field(name, pa.float64(), metadata={"unit": units.get(name, "")}) for name in names]
    # pandas restores `attrs` from this key of the metadata.
    attributes = json.dumps({"units": {name: units.get(name, "") for name in names}})
    schema = pa.schema(fields, metadata={"PANDAS_ATTRS": attributes})
    return pa.Table.from_arrays(
        [pa.array(np.asarray(a, dtype=float)) for a in (times, *columns.values())], schema=schema
    )
