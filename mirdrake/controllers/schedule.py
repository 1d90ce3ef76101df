"""Drivers that read their commands from a table: constant, or a schedule over time."""

import math
from bisect import bisect_right
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal, get_args

from pydantic import Field, model_validator
from pydrake.systems.framework import BasicVector, Context

from mirdrake.controllers.driver import Driver, SteeringAngle
from mirdrake.core.checks import check_number
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.paths import resolved
from mirdrake.core.signals import declare_vector_output
from mirdrake.core.vectors import COMMAND, Setpoint
from mirdrake.core.yaml_io import Duration, Period, Schema, Speed

Interpolation = Literal["linear", "hold"]
INTERPOLATIONS = get_args(Interpolation)


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
            # A row is checked by itself, so that the message names its number.
            if len(tuple(row)) != 3:
                raise ConfigError(f"time, speed and steering are expected, got {tuple(row)}", where=owner)
            time, speed, steering = row
            # Times must increase, since interpolation divides by their difference.
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
        """Rows (time [s], speed [m/s], steering [rad]), times strictly increasing."""
        return list(self._rows)

    def at(self, time: float) -> Setpoint:
        """Return speed [m/s] and steering [rad] at a time [s]."""
        # The row at exactly this time counts already.
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
        # Rounding of the time must not lose the message of this instant.
        stamp = math.floor(context.get_time() / self.period + 1e-9) * self.period
        speed, steering = self.schedule.at(stamp)
        output.SetFromVector([speed, steering, stamp])


class ConstantCommand(CommandSchedule):
    """A driver with constant set-points.

    Output ports:
        command (3) [m/s, rad, s]: speed, steering, stamp; see :class:`CommandSchedule`.

    Args:
        speed: set-point of the speed [m/s].
        steering: set-point of the bicycle angle [rad].
        period: time between messages [s].

    Raises:
        ConfigError: not finite numbers, or the period is not positive.
    """

    def __init__(self, speed: float, steering: float = 0.0, *, period: float = 0.02):
        super().__init__(Schedule([(0.0, speed, steering)], interpolation="hold"), period=period)


class ConstantSpec(Driver):
    """Always the same command."""

    kind: Literal["constant"] = Field(description="always the same command [-]")
    speed: Speed = Field(0.0, ge=-100.0, le=100.0, description="set-point of the forward speed [m/s]")
    steering: SteeringAngle = 0.0
    period: Period = Field(0.02, gt=0.0, le=0.2, description="time between messages [s]")

    def make_system(self, *_: Any, **__: Any) -> ConstantCommand:
        """Return the driver as a system with the output port ``command``."""
        return ConstantCommand(self.speed, self.steering, period=self.period)

    def event_periods(self, folder: Path | str | None = None) -> tuple[float | None, ...]:  # noqa: ARG002
        """Return no period: the command is a function of time, without events."""
        return ()


class ScheduleRow(Schema):
    """Command at a time."""

    time: Duration = Field(ge=0.0, description="time from the start of the simulation [s]")
    speed: Speed = Field(0.0, ge=-100.0, le=100.0, description="set-point of the forward speed [m/s]")
    steering: SteeringAngle = 0.0


class ScheduleSpec(Driver):
    """Commands over time: rows, or a file of recorded commands."""

    kind: Literal["schedule"] = Field(description="commands over time [-]")
    interpolation: Interpolation | None = Field(
        None,
        description="linear between the rows, or hold each row until the next; default: linear, but hold for a table "
        "of recorded commands [-]",
    )
    rows: list[ScheduleRow] | None = Field(
        None, min_length=1, description="commands with rising times [s, m/s, rad]; either rows or a file"
    )
    file: str | None = Field(
        None, min_length=1, description="recorded commands: a table (.csv), a driving_log.txt or a run folder [-]"
    )
    vehicle: str | None = Field(
        None, description="vehicle whose commands are read; default: the only one in the file [-]"
    )
    period: Period | None = Field(
        None, gt=0.0, le=0.2, description="time between messages [s]; default: 0.02, with a file 0.001"
    )

    @model_validator(mode="after")
    def _times_rise(self) -> "ScheduleSpec":
        if (self.rows is None) == (self.file is None):
            raise ValueError("needs either rows or a file")
        for i, (first, second) in enumerate(zip(self.rows or [], (self.rows or [])[1:], strict=False), start=1):
            if second.time <= first.time:
                raise ValueError(
                    f"rows.{i}.time must be later than the row before ({first.time:g} s), got {second.time:g} s"
                )
        return self

    def schedule(self) -> Schedule:
        """Return the rows, or those of the file, as a law.

        Raises:
            ConfigError: the file does not exist, or has faults.
        """
        if self.file is not None:
            # pandas takes most of a second to import, which commands without recorded files need not spend.
            from mirdrake.controllers.command_log import read_commands

            log = read_commands(Path(self.file), vehicle=self.vehicle)
            return Schedule(log.rows, interpolation=self.interpolation or log.interpolation)
        rows = ((row.time, row.speed, row.steering) for row in self.rows or ())
        return Schedule(rows, interpolation=self.interpolation or "linear")

    def resolve_paths(self, folder: Path) -> None:
        """Make the path of the file absolute, relative to the folder of the diagram file if it is there."""
        if self.file is not None:
            beside = folder / self.file
            self.file = str(resolved(beside if beside.exists() else Path(self.file)))

    def make_system(self, *_: Any, where: str = "", **__: Any) -> CommandSchedule:
        """Return the driver as a system with the output port ``command``.

        Raises:
            ConfigError: the file does not exist, or has faults.
        """
        try:
            schedule = self.schedule()
        except ConfigError as error:
            raise error.under(self.place("file", where)) from None
        return CommandSchedule(schedule, period=self.period or (0.02 if self.file is None else 0.001))

    def event_periods(self, folder: Path | str | None = None) -> tuple[float | None, ...]:  # noqa: ARG002
        """Return no period: the command is a function of time, without events."""
        return ()
