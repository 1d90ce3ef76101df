"""Drivers that read their commands from a table: constant, or a schedule over time."""

import math
from bisect import bisect_right
from collections.abc import Iterable
from typing import Literal

from pydrake.systems.framework import BasicVector, Context

from mirdrake.core.checks import check_number
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import declare_vector_output
from mirdrake.core.vectors import COMMAND, Setpoint

Interpolation = Literal["linear", "hold"]
INTERPOLATIONS = ("linear", "hold")


class Schedule:
    """Speed and steering over time; before the first row the first counts, after the last the last.

    Args:
        rows: (time [s], speed [m/s], steering [rad]), times rising.
        interpolation: "linear" between the rows, or "hold" each row until the next.

    Raises:
        ConfigError: no rows, a row that is not three finite numbers, times that do not rise, or an unknown
            interpolation.
    """

    __slots__ = ("_linear", "_rows", "_times")

    def __init__(self, rows: Iterable[tuple[float, float, float]], *, interpolation: Interpolation = "linear"):
        if interpolation not in INTERPOLATIONS:
            words = did_you_mean(interpolation, INTERPOLATIONS)
            raise ConfigError(f"schedule: unknown interpolation '{interpolation}'; {words}")
        self._linear = interpolation == "linear"
        self._rows: list[tuple[float, float, float]] = []
        for number, row in enumerate(rows, start=1):
            owner = f"schedule row {number}"
            if len(tuple(row)) != 3:
                raise ConfigError(f"{owner}: time, speed and steering are expected, got {tuple(row)}")
            time, speed, steering = row
            previous = self._rows[-1][0] if self._rows else float("-inf")
            self._rows.append(
                (
                    check_number(owner, "time", time, unit="s", above=previous),
                    check_number(owner, "speed", speed, unit="m/s"),
                    check_number(owner, "steering", steering, unit="rad"),
                )
            )
        if not self._rows:
            raise ConfigError("schedule: at least one row (time, speed, steering) is needed, got none")
        self._times = [time for time, _, _ in self._rows]

    @property
    def rows(self) -> list[tuple[float, float, float]]:
        """(time [s], speed [m/s], steering [rad]), times rising."""
        return list(self._rows)

    def at(self, time: float) -> Setpoint:
        """Speed [m/s] and steering [rad] at a time [s]."""
        after = bisect_right(self._times, time)
        t0, speed, steering = self._rows[max(after - 1, 0)]
        if not self._linear or after in (0, len(self._rows)):
            return Setpoint(speed, steering)
        t1, speed1, steering1 = self._rows[after]
        part = (time - t0) / (t1 - t0)
        return Setpoint(speed + part * (speed1 - speed), steering + part * (steering1 - steering))


class CommandSchedule(LeafSystem):
    """A driver that follows a :class:`Schedule`.

    Output ports:
        command (3) [m/s, rad, s]: the message of the last multiple of `period`: speed, steering, and that time as its
            stamp. It depends on the time alone, is there without delay and costs nothing when nobody reads it.

    Args:
        schedule: what to command when.
        period: time between messages [s]; a dead-man acts when it is longer than its timeout.

    Raises:
        ConfigError: the period is not positive.
    """

    def __init__(self, schedule: Schedule, *, period: float = 0.02):
        super().__init__()
        self.schedule = schedule
        self.period = check_number(type(self).__name__, "period", period, unit="s", above=0.0)
        self.command = declare_vector_output(self, "command", COMMAND, self._calc, prerequisites=[self.time_ticket()])

    def _calc(self, context: Context, output: BasicVector) -> None:
        stamp = math.floor(context.get_time() / self.period + 1e-9) * self.period
        speed, steering = self.schedule.at(stamp)
        output.SetFromVector([speed, steering, stamp])


class ConstantCommand(CommandSchedule):
    """A driver that always wants the same.

    Output ports:
        command (3) [m/s, rad, s]: speed, steering, stamp; see :class:`CommandSchedule`.

    Args:
        speed: wanted speed [m/s].
        steering: wanted bicycle angle [rad].
        period: time between messages [s].

    Raises:
        ConfigError: not finite numbers, or the period is not positive.
    """

    def __init__(self, speed: float, steering: float = 0.0, *, period: float = 0.02):
        super().__init__(Schedule([(0.0, speed, steering)], interpolation="hold"), period=period)
