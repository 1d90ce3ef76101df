"""Recorded commands: a table with units in its header, the driving log of a camera, or a run folder.

A table (any format of :mod:`mirdrake.readers`) has columns such as ::

    time [s],speed [km/h],steering [deg]

Without units, they are s, m/s and rad. Other columns are ignored. Columns ``<vehicle>.speed_command`` and
``<vehicle>.steering_command``, as ``mirdrake export RUN --to csv`` writes them, are accepted as well. Each line of a
driving log (driving_log.txt) has the name of a picture, the steering angle [rad] and the speed [m/s]; times count from
the first picture. It holds measurements, which follow the commands with the lag of the vehicle.
"""

import math
import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mirdrake.controllers.schedule import Interpolation
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.files import read_errors
from mirdrake.core.recording.pictures import picture_time
from mirdrake.core.yaml_io import display_path, read_text
from mirdrake.readers import CsvLayout, Table, read_table
from mirdrake.readers.tables import read_bytes
from mirdrake.readers.units import unit_factor

Row = tuple[float, float, float]

_NAMES = {"time": ("t",), "speed": ("velocity", "speed_command"), "steering": ("steering_angle", "steering_command")}
_UNITS = {"time": "s", "speed": "m/s", "steering": "rad"}
_LIMITS = {"time": math.inf, "speed": 100.0, "steering": 0.5 * math.pi}
_PICTURE = re.compile(rb"\s*\d{4}(-\d\d){5}-\d{6}\.\w+")
_EARLIER = 1e-6  # [s] a held command takes effect right after the sample before


class CommandLog(NamedTuple):
    """Recorded commands.

    Attributes:
        rows: (time [s], speed [m/s], steering [rad]), times strictly increasing.
        interpolation: "hold" each row until the next, or "linear" between them.
    """

    rows: tuple[Row, ...]
    interpolation: Interpolation

    @property
    def duration(self) -> float:
        """Time of the last row [s]."""
        return self.rows[-1][0]


def read_commands(path: Path, *, vehicle: str | None = None) -> CommandLog:
    """Return recorded commands.

    Args:
        path: a table, a driving log or a run folder.
        vehicle: vehicle whose commands are read, if there are several; the first one's by default.

    Raises:
        ConfigError: there is no such file, or it has faults.
    """
    if path.is_dir():
        return _read_run(path, vehicle)
    # A driving log has no header: its first line begins with the name of a picture.
    if path.is_file() and _PICTURE.match(read_bytes(path)[:64]):
        layout = CsvLayout(delimiter="\t", columns=["picture", "steering", "speed"])
        table = read_table(path, layout=layout)
        columns = {key: _numbers(table, key, key) for key in ("steering", "speed")} | {"time": _picture_times(table)}
        return CommandLog(_rows(table, columns), "linear")
    table = read_table(path, [*_UNITS, *(name for names in _NAMES.values() for name in names)])
    columns = {key: _numbers(table, key, _find_column(table, key, vehicle)) for key in _UNITS}
    return CommandLog(_rows(table, columns), "hold")


def _picture_times(table: Table) -> NDArray[np.float64]:
    """Return the times of the pictures from the first one on [s]."""
    times = []
    for row, name in enumerate(table.columns["picture"]):
        try:
            times.append(picture_time(str(name)))
        except ValueError:
            raise ConfigError(
                f"'{name}' is not the name of a picture, YYYY-mm-dd-HH-MM-SS-ffffff.jpg", where=table.row(row)
            ) from None
    # Driving logs have dates; a schedule begins at zero.
    return np.array(times) - times[0]


def _find_column(table: Table, key: str, vehicle: str | None) -> str:
    """Return the name of the column of time, speed or steering."""
    # Names of mirdrake's own runs come first, then those of other loggers.
    names = [key, *_NAMES[key]]
    if vehicle is not None and key != "time":
        names.insert(0, f"{vehicle}.{key}_command")
    for name in names:
        if name in table.names:
            return name
    of_vehicles = [name for name in table.names if name.endswith(f".{key}_command")]
    if of_vehicles and vehicle is None:
        return of_vehicles[0]
    others = [name for name in names[1:] if "." not in name]
    raise ConfigError(
        f"no column '{key}' (or {', '.join(others)}); there are: {', '.join(table.names[:12])}", where=table.name
    )


def _numbers(table: Table, key: str, column: str) -> NDArray[np.float64]:
    """Return a column in SI units; the values must be given and within their limits.

    Raises:
        ConfigError: the unit is unknown, a cell is not a number, or a value is out of range.
    """
    try:
        factor = unit_factor(table.units[column], _UNITS[key]) if table.units.get(column) else 1.0
    except ValueError as error:
        raise ConfigError(f"{key}: {error}", where=table.name) from None
    values = table.numbers(column, table.name) * factor
    # Written so that NaN is out of range, too.
    for row in np.flatnonzero(~(np.abs(values) < _LIMITS[key])).tolist()[:1]:
        if math.isnan(values[row]):
            raise ConfigError(f"{key}: a finite number is missing", where=table.row(row))
        raise ConfigError(
            f"{key}: {values[row]:g} {_UNITS[key]} is out of range (below ±{_LIMITS[key]:.4g})", where=table.row(row)
        )
    return values


def _rows(table: Table, columns: dict[str, NDArray[np.float64]]) -> tuple[Row, ...]:
    """Return (time, speed, steering) of each row; the times must increase."""
    times: Sequence[float] = columns["time"].tolist()
    for row in np.flatnonzero(np.diff(times) <= 0.0).tolist()[:1]:
        raise ConfigError(
            f"time {times[row + 1]:g} s is not later than the time of the row before, {times[row]:g} s",
            where=table.row(row + 1),
        )
    return tuple(zip(times, columns["speed"].tolist(), columns["steering"].tolist(), strict=True))


def _read_run(folder: Path, vehicle: str | None) -> CommandLog:
    """Return the commands of a run.

    A sample shows the command that is valid up to its time: a driver that works in steps has given it at the sample
    before. Drivers that read a table show the present command.
    """
    table = read_table(folder)
    drivers = [name.removesuffix(".steering_command") for name in table.names if name.endswith(".steering_command")]
    if vehicle not in drivers and len(drivers) == 1:
        vehicle = drivers[0]  # it may have another name in the other diagram
    if vehicle is None or vehicle not in drivers:
        hint = did_you_mean(vehicle, drivers) if drivers else "no vehicle has a driver"
        raise ConfigError(f"no commands of '{vehicle}' were recorded; {hint}", where=display_path(folder))
    names = ("time", f"{vehicle}.speed_command", f"{vehicle}.steering_command")
    columns = [table.numbers(name, table.name).tolist() for name in names]
    rows: list[Row] = list(zip(*columns, strict=True))
    if _kind(folder, vehicle) not in {"constant", "schedule"} and len(rows) > 1:
        # Shift each command to just after the sample before, when the driver gave it.
        later = [(row[0] + _EARLIER, *following[1:]) for row, following in pairwise(rows)]
        rows = [rows[0], *later, rows[-1]]
    return CommandLog(tuple(rows), "hold")


def _kind(folder: Path, vehicle: str) -> Any:
    import yaml

    with read_errors(folder / "spec.yaml"):
        spec = yaml.safe_load(read_text(folder / "spec.yaml"))
        return spec.get("control", {}).get(vehicle, {}).get("kind")
