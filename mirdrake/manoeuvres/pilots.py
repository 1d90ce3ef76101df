"""Drivers of manoeuvres for batches of cars: the laws of :mod:`mirdrake.manoeuvres.drivers`, compiled."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from mirdrake.batched.arrays import Floats
from mirdrake.batched.control_kernel import COMMAND, OWN, PEDALS, PRESSES, STARTED
from mirdrake.core.compiled import Records, records
from mirdrake.core.errors import ConfigError
from mirdrake.core.maths import wrap_angle
from mirdrake.manoeuvres.drivers import (
    STEERING_PARTS,
    THROTTLE,
    LineNumbers,
    OpenLoopDriver,
    PathDriver,
    Rows,
    steer_along,
)
from mirdrake.manoeuvres.profiles import tabulate
from mirdrake.single_track.dynamics import State
from mirdrake.vehicles import Vehicle

PERIOD = 0.01
"""Time between two steps of a driver [s]."""

_MODULE = "mirdrake.manoeuvres.drivers:"
_NO_LINE = LineNumbers(1.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, hands=False)


class PilotNumbers(NamedTuple):
    """Numbers of a driver; tables are shared, and given by their first row and the row after the last one.

    Attributes:
        follows: whether it steers along a line; otherwise by a table of angles.
        steering: settings of the steering along the line.
        line: rows of its line.
        profile: rows of its angles, one for each step.
        speeds: rows of time [s] and speed [m/s]; without rows the present speed is commanded.
        pedals: rows of time [s], throttle, brake and gear; without rows it does not press pedals.
        holds: whether the throttle holds a speed before the rows of the pedals apply.
        held_speed: this speed [m/s].
        held_until: x of the world up to which it does [m].
    """

    follows: bool
    steering: LineNumbers
    line: tuple[int, int]
    profile: tuple[int, int]
    speeds: tuple[int, int]
    pedals: tuple[int, int]
    holds: bool
    held_speed: float
    held_until: float


class Pilots(NamedTuple):
    """Drivers of all cars.

    Attributes:
        numbers: a record of :class:`PilotNumbers` per car.
        lines: tables of all lines (rows, 5).
        profiles: angles of all profiles (rows) [rad].
        rows: rows of all speeds and pedals (rows, 4).
    """

    numbers: Records
    lines: Floats
    profiles: Floats
    rows: Floats


class _Tables:
    """Tables one below the other; equal ones are kept once."""

    def __init__(self, width: int) -> None:
        self._parts: list[Floats] = [np.empty((0, width))]
        self._known: dict[bytes, tuple[int, int]] = {}
        self._count = 0

    def add(self, table: Floats) -> tuple[int, int]:
        """Add a table and return its first row and the row after its last one."""
        key = table.tobytes()
        if key not in self._known:
            self._known[key] = self._count, self._count + len(table)
            self._parts.append(table)
            self._count += len(table)
        return self._known[key]

    def table(self) -> Floats:
        """Return all rows."""
        return np.concatenate(self._parts)


def make_pilots(drivers: Sequence[Mapping[str, Any]], vehicle: Vehicle, durations: Sequence[float]) -> Pilots:
    """Return the drivers of cars for compiled loops.

    Args:
        drivers: driver of each car, as under ``control`` of a diagram file.
        vehicle: the vehicle.
        durations: simulated time of each car [s].

    Raises:
        ConfigError: a driver has no compiled law, or a setting is out of range.
    """
    lines, profiles, rows = _Tables(5), _Tables(1), _Tables(4)
    made = []
    for entry, duration in zip(drivers, durations, strict=True):
        driver = _make_driver(entry, vehicle)
        line, profile, steering = (0, 0), (0, 0), _NO_LINE
        if isinstance(driver, PathDriver):
            line, steering = lines.add(driver.line.table), driver.numbers
        else:
            # The angle of each step, as it depends on the time only.
            times = np.arange(math.ceil(duration / PERIOD) + 2) * PERIOD
            profile = profiles.add(tabulate(entry["profile"], times)[:, None])
        held = driver.held
        made.append(
            PilotNumbers(
                follows=isinstance(driver, PathDriver),
                steering=steering,
                line=line,
                profile=profile,
                speeds=_add_rows(rows, driver.speeds),
                pedals=_add_rows(rows, driver.pedal_rows),
                holds=held is not None,
                held_speed=0.0 if held is None else held[0],
                held_until=0.0 if held is None else held[1],
            )
        )
    return Pilots(records(PilotNumbers, made), lines.table(), profiles.table()[:, 0].copy(), rows.table())


def _add_rows(tables: _Tables, rows: Rows | None) -> tuple[int, int]:
    if rows is None:
        return 0, 0
    table = np.zeros((len(rows.rows), 4))
    table[:, : len(rows.rows[0])] = rows.rows
    return tables.add(table)


def _make_driver(entry: Mapping[str, Any], vehicle: Vehicle) -> PathDriver | OpenLoopDriver:
    settings = dict(entry)
    kind = str(settings.pop("kind"))
    if kind == f"{_MODULE}PathDriver" and settings.get("period", PERIOD) == PERIOD:
        return PathDriver(vehicle=vehicle, **settings)
    if kind == f"{_MODULE}OpenLoopDriver" and settings.get("period", PERIOD) == PERIOD:
        return OpenLoopDriver(**settings)
    raise ConfigError(
        f"the single-track model is driven by PathDriver and OpenLoopDriver with a period of {PERIOD:g} s; "
        "use the full plant",
        where=f"driver {kind}",
    )


def pilot(pilots: Pilots, i: int, x: State, rear_length: float, time: float, memory: Any) -> None:
    """Advance the driver of a car by a step, as the drivers of :mod:`mirdrake.manoeuvres.drivers`.

    Args:
        pilots: drivers of all cars.
        i: the car.
        x: its states.
        rear_length: from the centre of mass to the rear axle [m].
        time: present time [s].
        memory: memory of the driver, updated.
    """
    numbers, rows = pilots.numbers[i], pilots.rows
    if memory[STARTED] == 0.0:
        memory[OWN], memory[OWN + 1], memory[OWN + 2], memory[STARTED] = -1.0, -math.inf, 0.0, 1.0
    speed = x.vx
    if numbers.speeds[1] > numbers.speeds[0]:
        speed = value_at(rows, numbers.speeds[0], numbers.speeds[1], time, 1)
    angle = 0.0
    if not numbers.follows:
        angle = pilots.profiles[min(numbers.profile[0] + int(time / PERIOD + 0.5), numbers.profile[1] - 1)]
    elif numbers.steering.hands:
        angle = steer_along(
            numbers.steering, pilots.lines[numbers.line[0] : numbers.line[1]], memory, OWN, time,
            x.x, x.y, wrap_angle(x.yaw), x.vx, x.vy - rear_length * x.yaw_rate, x.yaw_rate,
        )  # fmt: skip
    memory[COMMAND], memory[COMMAND + 1], memory[COMMAND + 2] = speed, angle, time
    first, last = numbers.pedals[0], numbers.pedals[1]
    if last == first:
        return
    memory[PRESSES] = 1.0
    if numbers.holds and x.x < numbers.held_until:
        # Up to the x at which it is released the throttle holds the speed; later the rows of the pedals apply.
        memory[PEDALS] = min(max(THROTTLE * (numbers.held_speed - x.vx), 0.0), 1.0)
        memory[PEDALS + 1], memory[PEDALS + 2] = 0.0, 1.0
    else:
        for k in range(3):
            memory[PEDALS + k] = value_at(rows, first, last, time, 1 + k)


def value_at(rows: Floats, first: int, last: int, time: float, column: int) -> float:
    """Return a column of rows over time, as :meth:`mirdrake.manoeuvres.drivers.Rows.at`.

    Args:
        rows: all rows.
        first: first row.
        last: row after the last one.
        time: time [s].
        column: column.
    """
    after = first
    while after < last and rows[after, 0] <= time:
        after += 1
    if after in (first, last):
        end: float = rows[min(after, last - 1), column]
        return end
    part = (time - rows[after - 1, 0]) / (rows[after, 0] - rows[after - 1, 0])
    value: float = rows[after - 1, column]
    value += part * (rows[after, column] - value)
    return value


PILOTING: tuple[Callable[..., None], tuple[Any, ...]] = (pilot, (*STEERING_PARTS, pilot, value_at))
"""Driver law, and functions that it calls, for :meth:`mirdrake.batched.BatchControl.drive`."""
