"""Export of signals as a CSV table with units in its header, and a table for each sensor with vector samples.

The header has ``name [unit]`` for each column, ``name`` alone for pure numbers: ``time [s],ego.x [m],ego.lap``. Numbers
have full precision; a value that is not finite is an empty cell. ``mirdrake run --commands`` reads such a table.
``signals.ego.imu.csv`` has the samples of the sensor ``ego.imu`` at its own rate, with their times.
"""

import csv
import math
from collections.abc import Iterator, Mapping
from pathlib import Path

import pyarrow.parquet as pq

from mirdrake.core.errors import RunError
from mirdrake.core.files import replacing
from mirdrake.core.recording.parts import read_groups, stored
from mirdrake.runs.logs import SIGNALS, Run, reads_run


def title(name: str, units: Mapping[str, str]) -> str:
    """Return a column's name with its unit in brackets."""
    unit = units.get(name, "")
    return f"{name} [{unit}]" if unit else name


@reads_run
def write_csv(run: Run, path: Path) -> dict[Path, int]:
    """Write the signals of a run and the samples of its sensors.

    Args:
        run: run with a folder.
        path: path of the table of the signals.

    Returns:
        number of rows by table.

    Raises:
        RunError: no signals were recorded, or a file cannot be written.
    """
    counts = {path: _write_table(_table_of(run), path, run.units)}
    for name, samples in run.arrays.items():
        if all(map(samples.is_number, samples)):
            beside = path.with_name(f"{path.stem}.{name}{path.suffix}")
            counts[beside] = _write_table(samples.path, beside, {"time": "s", **samples.units})
    return counts


def _write_table(table: Path, path: Path, units: Mapping[str, str]) -> int:
    names = pq.read_schema(stored(table)[0]).names
    count = 0
    with replacing(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([title(name, units) for name in names])
        for row in _rows(table):
            writer.writerow(row)
            count += 1
    return count


def _rows(table: Path) -> Iterator[list[str]]:
    for group in read_groups(table):
        for row in zip(*(column.to_pylist() for column in group.columns), strict=True):
            yield [repr(value) if math.isfinite(value) else "" for value in row]


def _table_of(run: Run) -> Path:
    if run.folder is None or not stored(run.folder / SIGNALS):
        raise RunError("no signals were recorded; there is nothing to export", where=str(run.folder))
    return run.folder / SIGNALS
