"""Drivers as data: the ``control`` entries of a diagram file.

``kind`` chooses between following a track, a constant command and a schedule of commands::

    control:
      ego: {kind: path_tracking, track: main, speed: 5 m/s}
      other: {kind: constant, speed: 3, steering: 10 deg}
      third: {kind: schedule, rows: [{time: 0, speed: 0}, {time: 4 s, speed: 18 km/h, steering: 0.1}]}
      fourth: {kind: schedule, file: commands.csv}
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Literal, Protocol

from pydantic import Field, model_validator

from mirdrake.controllers.ackermann import SteeringGeometry
from mirdrake.controllers.command_log import read_commands
from mirdrake.controllers.drivable_line import DrivingLimits, Track
from mirdrake.controllers.path_tracking import PathGains, PathTracker
from mirdrake.controllers.schedule import CommandSchedule, ConstantCommand, Schedule
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.yaml_io import Acceleration, Angle, Duration, Length, Period, Schema, Speed
from mirdrake.core.yaml_io import where as place_of

_STEERING_RANGE = 0.5 * math.pi


class DrivenVehicle(Protocol):
    """What a driver needs to know of its vehicle."""

    @property
    def geometry(self) -> SteeringGeometry:
        """Lengths and steering limits."""


class DrivenWorld(Protocol):
    """What a driver needs to know of its world."""

    @property
    def tracks(self) -> Mapping[str, Track]:
        """Tracks by name."""


class PathTrackingSpec(Schema):
    """Follow a track of the world."""

    kind: Literal["path_tracking"] = Field(description="follow a track [-]")
    track: str = Field("main", description="name of a track of the world [-]")
    speed: Speed = Field(5.0, gt=0.0, le=100.0, description="set-point [m/s]; corners may be driven slower")
    lateral_acceleration: Acceleration = Field(5.0, gt=0.0, description="largest lateral acceleration [m/s^2]")
    acceleration: Acceleration = Field(1.5, gt=0.0, description="largest acceleration [m/s^2]")
    deceleration: Acceleration = Field(2.0, gt=0.0, description="largest deceleration [m/s^2]")
    tolerance: Length = Field(
        0.1, gt=0.0, description="largest planned offset from the centre line [m]; the car slows down where it needs to"
    )
    convergence_distance: Length = Field(
        1.5, gt=0.0, description="least distance over which an offset is taken back [m]"
    )
    convergence_time: Duration = Field(0.6, ge=0.0, description="least time over which an offset is taken back [s]")
    damping: float = Field(1.0, gt=0.0, description="damping ratio of the return to the line [1]")
    preview_time: Duration = Field(0.06, ge=0.0, le=1.0, description="delay until the steering acts [s]")
    understeer_gradient: float = Field(
        0.0, ge=-0.1, le=0.1, description="extra steering angle per lateral acceleration [rad s^2/m]"
    )
    period: Period = Field(0.02, gt=0.0, le=0.2, description="time between updates [s]")

    def gains(self) -> PathGains:
        """The settings that may change while the tracker runs."""
        return PathGains(
            self.speed,
            self.convergence_distance,
            self.convergence_time,
            self.damping,
            self.preview_time,
            self.understeer_gradient,
        )

    def limits(self) -> DrivingLimits:
        """How hard to drive."""
        return DrivingLimits(self.lateral_acceleration, self.acceleration, self.deceleration, self.tolerance)

    def make_system(self, vehicle: DrivenVehicle, world: DrivenWorld, *, where: str = "") -> PathTracker:
        """The driver as a system with the output ports ``command`` and ``path_error``.

        Args:
            vehicle: what is driven.
            world: where the track is.
            where: ``file:line: path`` of this spec, for errors, when it does not know itself.

        Raises:
            ConfigError: the world has no such track, or it is too tight for the vehicle.
        """
        place = place_of(self, "track") if self._source else where or "control"
        track = world.tracks.get(self.track)
        if track is None:
            hint = did_you_mean(self.track, world.tracks) if world.tracks else "the world has none"
            raise ConfigError(f"{place}: unknown track '{self.track}'; {hint}")
        try:
            return PathTracker(track, vehicle.geometry, gains=self.gains(), period=self.period, limits=self.limits())
        except ConfigError as error:
            raise ConfigError(f"{place}: {error}") from None


class ConstantSpec(Schema):
    """Always the same command."""

    kind: Literal["constant"] = Field(description="always the same command [-]")
    speed: Speed = Field(0.0, ge=-100.0, le=100.0, description="wanted speed, forward [m/s]")
    steering: Angle = Field(
        0.0,
        gt=-_STEERING_RANGE,
        lt=_STEERING_RANGE,
        description="wanted bicycle steering angle, positive to the left [rad]",
    )
    period: Period = Field(0.02, gt=0.0, le=0.2, description="time between messages [s]")

    def make_system(
        self,
        vehicle: DrivenVehicle | None = None,  # noqa: ARG002
        world: DrivenWorld | None = None,  # noqa: ARG002
        *,
        where: str = "",  # noqa: ARG002
    ) -> ConstantCommand:
        """The driver as a system with the output port ``command``; it needs to know of no vehicle and no world."""
        return ConstantCommand(self.speed, self.steering, period=self.period)


class ScheduleRow(Schema):
    """Command at a time."""

    time: Duration = Field(ge=0.0, description="time from the start of the simulation [s]")
    speed: Speed = Field(0.0, ge=-100.0, le=100.0, description="wanted speed, forward [m/s]")
    steering: Angle = Field(
        0.0,
        gt=-_STEERING_RANGE,
        lt=_STEERING_RANGE,
        description="wanted bicycle steering angle, positive to the left [rad]",
    )


class ScheduleSpec(Schema):
    """Commands over time: rows, or a file of recorded commands (:mod:`mirdrake.controllers.command_log`)."""

    kind: Literal["schedule"] = Field(description="commands over time [-]")
    interpolation: Literal["linear", "hold"] | None = Field(
        None,
        description="straight lines between the rows, or each row until the next; left out: lines, but in a table of "
        "recorded commands hold [-]",
    )
    rows: list[ScheduleRow] | None = Field(
        None, min_length=1, description="commands, times rising [s, m/s, rad]; or give a file"
    )
    file: str | None = Field(
        None, min_length=1, description="recorded commands: a table (.csv), a driving_log.txt or a run folder [-]"
    )
    vehicle: str | None = Field(None, description="whose commands of the file; left out: the only one's [-]")
    period: Period | None = Field(
        None, gt=0.0, le=0.2, description="time between messages [s]; left out: 0.02, with a file 0.001"
    )

    @model_validator(mode="after")
    def _times_rise(self) -> "ScheduleSpec":
        if (self.rows is None) == (self.file is None):
            raise ValueError("needs rows or a file, one of the two")
        for i, (first, second) in enumerate(zip(self.rows or [], (self.rows or [])[1:], strict=False), start=1):
            if second.time <= first.time:
                raise ValueError(
                    f"rows.{i}.time must be later than the row before ({first.time:g} s), got {second.time:g} s"
                )
        return self

    def schedule(self) -> Schedule:
        """The table as a law.

        Raises:
            ConfigError: the file is not there, or has faults.
        """
        if self.file is not None:
            log = read_commands(Path(self.file), vehicle=self.vehicle)
            return Schedule(log.rows, interpolation=self.interpolation or log.interpolation)
        rows = ((row.time, row.speed, row.steering) for row in self.rows or ())
        return Schedule(rows, interpolation=self.interpolation or "linear")

    def make_system(
        self,
        vehicle: DrivenVehicle | None = None,  # noqa: ARG002
        world: DrivenWorld | None = None,  # noqa: ARG002
        *,
        where: str = "",
    ) -> CommandSchedule:
        """The driver as a system with the output port ``command``; it needs to know of no vehicle and no world.

        Raises:
            ConfigError: the file is not there, or has faults.
        """
        try:
            schedule = self.schedule()
        except ConfigError as error:
            place = place_of(self, "file") if self._source else where or "control"
            raise ConfigError(f"{place}: {error}") from None
        return CommandSchedule(schedule, period=self.period or (0.02 if self.file is None else 0.001))
