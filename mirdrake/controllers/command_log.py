"""Recorded commands: a table with units in its header, the driving log of a camera, or a run folder.

A table (.csv; commas, semicolons or tabs between the columns) has a header such as ::

    time [s],speed [km/h],steering [deg]

Units may be left out: then they are s, m/s and rad. Other columns are skipped. Columns called
``<vehicle>.speed_command`` and ``<vehicle>.steering_command``, as ``mirdrake export RUN --to csv`` writes them, count
as well. A driving log (driving_log.txt) has the name of a picture, the steering angle [rad] and the speed [m/s] in each
line; its times are counted from the first picture. It holds measurements, which follow the commands with the lag of the
vehicle.
"""

import csv
import math
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow.parquet as pq

from mirdrake.controllers.schedule import Interpolation
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.files import read_errors
from mirdrake.core.recording.parts import read_groups, stored
from mirdrake.core.recording.pictures import picture_time
from mirdrake.core.yaml_io import read_text, shown, to_si

Row = tuple[float, float, float]

_SAME = {"time": ("t",), "speed": ("velocity", "speed_command"), "steering": ("steering_angle", "steering_command")}
_UNITS = {"time": "s", "speed": "m/s", "steering": "rad"}
_LIMITS = {"time": math.inf, "speed": 100.0, "steering": 0.5 * math.pi}
_PICTURE = re.compile(r"\d{4}(-\d\d){5}-\d{6}\.\w+")
_COLUMN = re.compile(r"(?P<name>[^\[(]*?)\s*(?:[\[(](?P<unit>[^\])]*)[\])])?\s*")
_EARLIER = 1e-6  # [s] a held command takes effect right after the sample before


class CommandLog(NamedTuple):
    """Recorded commands.

    Attributes:
        rows: (time [s], speed [m/s], steering [rad]), times rising.
        interpolation: "hold" each row until the next, or "linear" between them.
    """

    rows: tuple[Row, ...]
    interpolation: Interpolation

    @property
    def duration(self) -> float:
        """Time of the last row [s]."""
        return self.rows[-1][0]


def read_commands(path: Path, *, vehicle: str | None = None) -> CommandLog:
    """Recorded commands.

    Args:
        path: of a table, a driving log or a run folder.
        vehicle: whose commands, where there are several; the first one's if left out.

    Raises:
        ConfigError: no such file, or it has faults.
    """
    if path.is_dir():
        return _read_run(path, vehicle)
    text = read_text(path)
    lines = [(number, line) for number, line in enumerate(text.splitlines(), start=1) if line.strip()]
    if not lines:
        raise ConfigError(f"{shown(path)}: is empty; a table of time, speed and steering is expected")
    if _PICTURE.match(lines[0][1]):
        return CommandLog(_rising(path, _driving_log(path, lines)), "linear")
    return CommandLog(_rising(path, _table(path, lines, vehicle)), "hold")


def _driving_log(path: Path, lines: Sequence[tuple[int, str]]) -> Iterable[tuple[int, Row]]:
    first: float | None = None
    for number, line in lines:
        cells = line.split("\t")
        place = f"{shown(path)}:{number}"
        if len(cells) != 3:
            raise ConfigError(f"{place}: a name, a steering angle and a speed between tabs are expected, got '{line}'")
        try:
            at = picture_time(cells[0])
        except ValueError:
            raise ConfigError(
                f"{place}: '{cells[0]}' is no picture named by its time, YYYY-mm-dd-HH-MM-SS-ffffff.jpg"
            ) from None
        first = at if first is None else first
        steering, speed = (_number(place, key, cells[i], 1) for i, key in ((1, "steering"), (2, "speed")))
        yield number, (at - first, speed, steering)


def _table(path: Path, lines: Sequence[tuple[int, str]], vehicle: str | None) -> Iterable[tuple[int, Row]]:
    number, header = lines[0]
    separator = next((mark for mark in "\t;" if mark in header), ",")
    titles = next(csv.reader([header], delimiter=separator))
    names, units = [], []
    for title in titles:
        match = _COLUMN.fullmatch(title.strip())
        names.append(match["name"].strip() if match else title.strip())
        units.append(match["unit"] if match else None)
    place = f"{shown(path)}:{number}"
    columns = {key: _find(place, key, names, vehicle) for key in _UNITS}
    factors = {key: _factor(place, key, units[column]) for key, column in columns.items()}
    for number, line in lines[1:]:
        place = f"{shown(path)}:{number}"
        cells = next(csv.reader([line], delimiter=separator))
        if len(cells) != len(titles):
            raise ConfigError(f"{place}: {len(cells)} values, but the header has {len(titles)} columns")
        time, speed, steering = (_number(place, key, cells[columns[key]], factors[key]) for key in _UNITS)
        yield number, (time, speed, steering)


def _find(place: str, key: str, names: Sequence[str], vehicle: str | None) -> int:
    """The column of time, speed or steering."""
    wanted = [key, *_SAME[key]]
    if vehicle is not None and key != "time":
        wanted.insert(0, f"{vehicle}.{key}_command")
    for name in wanted:
        if name in names:
            return names.index(name)
    ends = [name for name in names if name.endswith(f".{key}_command")]
    if ends and vehicle is None:
        return names.index(ends[0])
    wanted = [name for name in wanted if "." not in name]
    raise ConfigError(f"{place}: no column '{key}' (or {', '.join(wanted[1:])}); there are: {', '.join(names[:12])}")


def _factor(place: str, key: str, unit: str | None) -> float:
    if not unit:
        return 1.0
    try:
        return float(to_si(f"1 {unit}", _UNITS[key]))
    except ValueError as error:
        raise ConfigError(f"{place}: {key}: {error}") from None


def _number(place: str, key: str, text: str, factor: float) -> float:
    try:
        value = float(text) * factor
    except ValueError:
        raise ConfigError(f"{place}: {key}: '{text.strip()}' is no number") from None
    if not abs(value) < _LIMITS[key]:
        raise ConfigError(f"{place}: {key}: {value:g} {_UNITS[key]} is out of range (below ±{_LIMITS[key]:.4g})")
    return value


def _rising(path: Path, rows: Iterable[tuple[int, Row]]) -> tuple[Row, ...]:
    """The rows, whose times must rise."""
    kept: list[Row] = []
    for number, row in rows:
        if kept and row[0] <= kept[-1][0]:
            raise ConfigError(
                f"{shown(path)}:{number}: time {row[0]:g} s is not later than that of the row before, {kept[-1][0]:g} s"
            )
        kept.append(row)
    if not kept:
        raise ConfigError(f"{shown(path)}: has a header, but no rows")
    return tuple(kept)


def _read_run(folder: Path, vehicle: str | None) -> CommandLog:
    """The commands of a run.

    A sample at a time shows what holds up to then: a driver that works in steps has said it at the sample before. Only
    drivers that read a table say at once what it holds.
    """
    table = folder / "signals.parquet"
    parts = stored(table)
    if not parts:
        raise ConfigError(f"{shown(folder)}: is no run folder with signals; give one, a table or a driving_log.txt")
    with read_errors(parts[0]):
        known = pq.read_schema(parts[0]).names
    drivers = [name.removesuffix(".steering_command") for name in known if name.endswith(".steering_command")]
    if vehicle not in drivers and len(drivers) == 1:
        vehicle = drivers[0]  # of another name in the other diagram
    if vehicle is None or vehicle not in drivers:
        words = did_you_mean(vehicle, drivers) if drivers else "nobody drove"
        raise ConfigError(f"{shown(folder)}: no commands of '{vehicle}' were recorded; {words}")
    keys = ["time", f"{vehicle}.speed_command", f"{vehicle}.steering_command"]
    rows: list[Row] = []
    with read_errors(table):
        for group in read_groups(table, keys):
            rows += zip(*(map(float, group[key].to_pylist()) for key in keys), strict=True)
    if _kind(folder, vehicle) not in {"constant", "schedule"} and len(rows) > 1:
        times = [row[0] for row in rows]
        later = [(time + _EARLIER, *row[1:]) for time, row in zip(times, rows[1:], strict=False)]
        rows = [rows[0], *later, rows[-1]]
    return CommandLog(tuple(rows), "hold")


def _kind(folder: Path, vehicle: str) -> Any:
    import yaml

    with read_errors(folder / "spec.yaml"):
        spec = yaml.safe_load(read_text(folder / "spec.yaml"))
        return spec.get("control", {}).get(vehicle, {}).get("kind")
