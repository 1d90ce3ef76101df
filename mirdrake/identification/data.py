"""Recorded logs of one vehicle as a data set: channels in SI units with canonical names."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mirdrake.core.digest import digest
from mirdrake.core.errors import ConfigError, MirdrakeError
from mirdrake.core.yaml_io import display_path, load_yaml, where
from mirdrake.identification.channels import channel
from mirdrake.identification.derived import add_derived
from mirdrake.identification.spec import REPAIRS, Column, DataSpec, LogSpec, Repair, TimeColumn
from mirdrake.readers import read_table
from mirdrake.readers.tables import Table
from mirdrake.readers.time_columns import (
    MAX_BACKWARD_SHARE,
    MIN_ROWS,
    has_step_durations,
    is_time_of_day,
    seconds_of_day,
)
from mirdrake.readers.units import plain_unit, unit_factor

Array = NDArray[np.float64]

_FINE_UNITS = {"us": 1e-6, "ns": 1e-9}


@dataclass(frozen=True)
class Log:
    """One recorded log.

    Attributes:
        name: name in reports.
        use: "train" or "validation".
        time: times of the rows (n) [s].
        channels: channels by canonical name (n each), SI units, NaN for missing values.
        notes: what was detected or assumed when the file was read.
    """

    name: str
    use: str
    time: Array
    channels: Mapping[str, Array]
    notes: tuple[str, ...] = ()

    def to_pandas(self) -> pd.DataFrame:
        """Return the samples by channel, index ``time`` [s]; units in ``attrs["units"]``."""
        frame = pd.DataFrame(dict(self.channels), index=pd.Index(self.time, name="time"))
        frame.attrs["units"] = {name: channel(name).unit for name in self.channels}
        return frame


@dataclass(frozen=True)
class DataSet:
    """Logs of one vehicle.

    Attributes:
        logs: all logs.
        wheelbase: front to rear axle [m], if it is given.
        repairs: repairs that the data check may make.
        clock: channel without delay, if it is given.
        digest: SHA-256 of all times and values.
    """

    logs: tuple[Log, ...]
    wheelbase: float | None = None
    repairs: tuple[Repair, ...] = REPAIRS
    clock: str | None = None
    digest: str = field(init=False)

    def __post_init__(self) -> None:
        contents = [
            f"{log.name}/{log.use}/{name}/".encode() + np.ascontiguousarray(values).tobytes()
            for log in self.logs
            for name, values in (("time", log.time), *log.channels.items())
        ]
        object.__setattr__(self, "digest", digest(*contents))

    @cached_property
    def kept(self) -> dict[str, Any]:
        """Results that depend on the logs only, kept by the functions that compute them."""
        return {}

    @property
    def train(self) -> tuple[Log, ...]:
        """Logs that parameters are fitted to."""
        return tuple(log for log in self.logs if log.use == "train")

    @property
    def validation(self) -> tuple[Log, ...]:
        """Logs for validation."""
        return tuple(log for log in self.logs if log.use == "validation")


def load_data(file: Path | str) -> DataSet:
    """Load a data set.

    Args:
        file: YAML file of format ``mirdrake: data/1``.

    Raises:
        ConfigError: a file cannot be read, or lacks what the data file names; one line per fault.
    """
    file = Path(file)
    return make_data(load_yaml(file, DataSpec), file.parent)


def make_data(spec: DataSpec, folder: Path) -> DataSet:
    """Return the data set of a specification.

    Args:
        spec: files and the meaning of their columns.
        folder: folder that the files are relative to.

    Raises:
        ConfigError: as in :func:`load_data`.
    """
    # Faults of all logs are reported together; logs of one recorder often share them, hence the removal of repeated
    # lines.
    logs: list[Log] = []
    faults: list[MirdrakeError] = []
    for index, entry in enumerate(spec.logs):
        try:
            logs.append(_load_log(folder, spec, entry, index))
        except ConfigError as error:
            faults.append(error)
    if faults:
        raise ConfigError(faults=faults)
    names = [log.name for log in logs]
    for index, name in enumerate(names):
        if name in names[:index]:
            raise ConfigError(f"a second log '{name}'; give it another name", where=where(spec, "logs", index))
    return DataSet(tuple(logs), spec.wheelbase, tuple(spec.repairs), spec.clock)


def _load_log(folder: Path, spec: DataSpec, entry: LogSpec, index: int) -> Log:
    """Read one log: its channels in SI units, its clock, and the rows to use."""
    # Columns of the channels, each with the place that names it.
    channels: dict[str, tuple[Column, str]] = {}
    for name, column in spec.channels.items():
        channels[name] = (column, where(spec, "channels", name))
    for name, column in entry.channels.items():
        channels[name] = (column, where(spec, "logs", index, "channels", name))
    if not channels:
        raise ConfigError("no channel is mapped; add, for example, vx: {column: …}", where=where(spec, "channels"))
    # Settings of a log replace those of all logs, each with its own place for error messages.
    clock = entry.time or spec.time
    clock_place = where(spec, "logs", index, "time") if entry.time else where(spec, "time")
    columns = [column.column for column, _ in channels.values()] + ([clock.column] if clock.column else [])
    file = folder / entry.file
    if not file.exists():
        raise ConfigError(f"{display_path(file)}: no such file", where=where(spec, "logs", index, "file"))
    table = read_table(file, columns, entry.csv or spec.csv)
    values: dict[str, Array] = {}
    faults: list[MirdrakeError] = []
    # All faults of the channels at once: a wrong mapping is usually wrong in several columns.
    for name, (column, location) in channels.items():
        try:
            values[name] = _values(table, name, column, location)
        except ConfigError as error:
            faults.append(error)
    if faults:
        raise ConfigError(faults=faults)

    # The clock, in seconds.
    notes = list(table.notes)
    time = _time(table, clock, clock_place, len(next(iter(values.values()))))
    if clock.column is not None and is_time_of_day(time):
        notes.append(f"column '{clock.column}' has times of day, HHMMSS: converted to seconds")
        time = seconds_of_day(time)
    elif has_step_durations(time):
        usual = float(np.median(time))
        notes.append(f"column '{clock.column}' has the steps from row to row, {usual:.4g} s: summed up")
        time = np.cumsum(time) - time[0]
    # Formats with a table for each topic may give columns of different length.
    for name, numbers in values.items():
        if len(numbers) != len(time):
            location = channels[name][1]
            raise ConfigError(f"{table.name} has {len(numbers)} values, but {len(time)} times", where=location)
        if np.isnan(numbers).all():
            raise ConfigError(
                f"column '{channels[name][0].column}' of {table.name} has no numbers", where=channels[name][1]
            )

    # The rows between start and end that have a time.
    keep = np.isfinite(time)
    keep &= (time >= (-np.inf if entry.start is None else entry.start)) & (
        time <= (np.inf if entry.end is None else entry.end)
    )
    if keep.sum() < MIN_ROWS:
        location = where(spec, "logs", index)
        raise ConfigError(
            f"{table.name} has {int(keep.sum())} rows to use; at least {MIN_ROWS} are needed", where=location
        )
    if np.isnan(time).any():
        notes.append(f"{int(np.isnan(time).sum())} rows without a time are skipped")
    _check_forward(table, time, keep)
    # Channels such as the speed from wheel speeds follow from others, so that models and checks need not know both.
    values, derived = add_derived(values)
    notes += derived
    name = entry.name or Path(entry.file).name
    return Log(name, entry.use, time[keep], {key: item[keep] for key, item in values.items()}, tuple(notes))


def _values(table: Table, name: str, column: Column, place: str) -> Array:
    """Return a channel in its SI unit."""
    numbers = table.numbers(column.column, place)
    si = channel(name).unit
    # A unit that is stated twice and differently is an error: nobody can know which one is right.
    stated = table.units.get(column.column)
    if column.unit is not None and stated and plain_unit(stated) != plain_unit(column.unit):
        raise ConfigError(
            f"unit '{column.unit}', but {table.name} has '{stated}'; leave out one, or give the scale instead",
            where=place,
        )
    unit = column.unit if column.unit is not None else stated
    if unit is None and si != "1":
        raise ConfigError(f"needs a unit, for example 'unit: {si}'; {table.name} does not state it", where=place)
    try:
        factor = unit_factor(unit or "1", si)
    except ValueError as error:
        raise ConfigError(f"{error} (unit in {table.name})", where=place) from None
    # The offset is added last: it is in the SI unit of the channel.
    return np.asarray(column.sign * column.scale * factor * numbers + column.offset)


def _time(table: Table, clock: TimeColumn, clock_place: str, rows: int) -> Array:
    """Return the column of the clock [s], or equidistant times."""
    if clock.step is not None:
        return np.arange(float(rows)) * clock.step
    assert clock.column is not None  # the schema requires one of them
    numbers = table.numbers(clock.column, clock_place)
    unit = plain_unit(clock.unit or table.units.get(clock.column) or "s")
    try:
        factor = _FINE_UNITS.get(unit) or unit_factor(unit, "s")
    except ValueError as error:
        raise ConfigError(f"{error} (unit in {table.name})", where=clock_place) from None
    if len(numbers) and np.isfinite(numbers).any() and abs(np.nanmin(numbers)) * factor > 1e7:
        # The column has dates (seconds since 1970), which floats resolve coarsely: count from the first one.
        numbers = numbers - numbers[np.isfinite(numbers)][0]
    return np.asarray(numbers * factor, dtype=np.float64)


def _check_forward(table: Table, time: Array, keep: NDArray[np.bool_]) -> None:
    """Reject a time column that is constant or often decreases."""
    rows = np.flatnonzero(keep)
    used = time[rows]
    # Single rows out of order are repaired by the data check; many of them are several drives in one file.
    latest = np.maximum.accumulate(used)
    back = used < latest
    if used.max() == used.min():
        hint = f"; if that is the step of its rows, write time: {{step: {used[0]:g} s}}" if 0 < used[0] < 1 else ""
        raise ConfigError(f"time is constant at {used[0]:g} s{hint}", where=display_path(Path(table.name)))
    if back.mean() > MAX_BACKWARD_SHARE:
        row = int(np.argmax(back))
        raise ConfigError(
            f"time goes back from {latest[row]:g} s to {used[row]:g} s, "
            f"and {int(back.sum())} of {len(used)} rows lie before an earlier one; put each drive into a file",
            where=table.row(int(rows[row])),
        )
