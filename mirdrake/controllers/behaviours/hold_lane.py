"""Hold a lane of a track, a line at a constant offset from its centre, and stop before obstacles in it."""

import math
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field
from pydrake.systems.framework import Context, DiscreteValues

from mirdrake.controllers.behaviours.fan import BEAMS, Fan, range_signals
from mirdrake.controllers.behaviours.laws import approach_speed, stopping_distance
from mirdrake.controllers.behaviours.outline import ShapedVehicle, outline_of
from mirdrake.controllers.drivable_line import DrivingLimits, Track
from mirdrake.controllers.driver import DecisionPeriod, DrivenWorld, Driver, Reaction, track_to_follow
from mirdrake.controllers.path_tracking import PathGains, PathTracker
from mirdrake.core.errors import ConfigError
from mirdrake.core.signals import declare_vector_input
from mirdrake.core.vectors import Command
from mirdrake.core.yaml_io import Acceleration, Length, Speed

_SPACING = 0.05  # of the table of arc lengths [m]


class Lane:
    """A line at a constant offset from a track; it is a track, too.

    Its arc length is s' = s - offset (yaw(s) - yaw(0)), exactly, for any centre line.

    Args:
        track: the track.
        offset: to the left of its centre line [m].

    Raises:
        ConfigError: the offset is as large as the radius of a bend on its inside.
    """

    def __init__(self, track: Track, offset: float):
        self._track, self._offset, self.closed = track, offset, bool(track.closed)
        self._s = np.linspace(0.0, track.length, max(8, math.ceil(track.length / _SPACING)) + 1)
        s = self._s.copy()
        if self.closed:
            s[-1] = 0.0
        yaw = np.unwrap(np.asarray(track.pose(s)[2], dtype=float))
        self._along = self._s - offset * (yaw - yaw[0])
        if np.min(np.diff(self._along)) <= 0.0:
            at = float(self._s[int(np.argmin(np.diff(self._along)))])
            raise ConfigError(f"lane: an offset of {offset:g} m is beyond the centre of the bend at s = {at:.1f} m")
        self.length = float(self._along[-1])

    def pose(self, s: Any) -> tuple[Any, Any, Any]:
        """Return position x, y [m] and direction [rad] at arc lengths s [m] of the lane."""
        s = np.asarray(s, dtype=float)
        s = np.mod(s, self.length) if self.closed else s
        beyond = s - np.clip(s, 0.0, self.length)  # an open track goes on straight
        x, y, yaw = self._track.pose(np.interp(s, self._along, self._s) + beyond)
        return x - self._offset * np.sin(yaw), y + self._offset * np.cos(yaw), yaw

    def project(self, x: Any, y: Any, *, near: Any = None) -> tuple[Any, Any]:
        """Return arc length s [m] along the lane and offset to its left [m] of points; `near` is an arc length."""
        hint = None if near is None else np.interp(near, self._along, self._s)
        s, lateral = self._track.project(x, y, near=hint)
        return np.interp(s, self._s, self._along), lateral - self._offset


class HoldLane(PathTracker):
    """A path tracker that stops before obstacles in its lane.

    Input ports:
        state (12) [m, rad, m/s, rad/s]: :data:`~mirdrake.core.vectors.STATE`.
        ranges (181) [m]: distances from the middle of the front bumper, beams from -90 to 90 degrees.

    Output ports:
        command (3) [m/s, rad, s]: speed, steering, stamp.
        path_error (4) [m, rad, m, 1]: against the lane, not the centre line; see :class:`PathTracker`.

    What lies within half the car's width plus `clearance` of the lane's line, ahead of the bumper, is in the way; the
    distance to it is taken along the lane.

    Args:
        vehicle: vehicle to drive.
        track: the track.
        spec: its entry of the diagram; the deceleration is also that of the stop.

    Raises:
        ConfigError: the lane is too tight for the vehicle.
    """

    def __init__(self, vehicle: ShapedVehicle, track: Track, spec: "HoldLaneSpec"):
        # A lane beside the centre line is a track of its own, so that the tracker needs no offset.
        lane = Lane(track, spec.offset) if spec.offset else track
        limits = DrivingLimits(spec.lateral_acceleration, spec.acceleration, spec.deceleration)
        super().__init__(lane, vehicle.geometry, gains=PathGains(spec.speed), period=spec.period, limits=limits)
        self.distance, self.reaction = spec.distance, spec.reaction
        self.outline = outline_of(vehicle)
        # Half the width within which something obstructs the lane.
        self._half = self.outline.half_width + spec.clearance
        self.fan = Fan(self.outline.front)
        self.ranges = declare_vector_input(self, "ranges", range_signals(BEAMS))

    def _step(self, context: Context, values: DiscreteValues) -> None:
        super()._step(context, values)
        speed, steering, stamp = values.value(self._command).tolist()
        progress = float(values.value(self._error)[2])
        profile = approach_speed(
            self._gap(context, progress, speed),
            distance=self.distance,
            deceleration=self.limits.deceleration,
            reaction=self.reaction,
            period=self.period,
        )
        values.set_value(self._command, Command(min(speed, profile), steering, stamp))

    def _gap(self, context: Context, progress: float, command: float) -> float:
        """Return the free distance along the lane [m] ahead of the bumper; inf beyond the stopping distance.

        Args:
            context: Context of this system.
            progress: arc length of the rear axle centre [m].
            command: speed without obstacles [m/s].
        """
        x, y, _, _, _, yaw, *_ = self.state.Eval(context).tolist()
        points = self.fan.points(self.ranges.Eval(context))
        # The command exceeds a set-point that has just been lowered; farther obstacles do not lower the command.
        fastest = max(self.get_gains(context).speed, command)
        matters = self.distance + stopping_distance(
            fastest, deceleration=self.limits.deceleration, reaction=self.reaction
        )
        # Projection is costly: only points within the stopping distance are projected.
        points = points[np.hypot(points[:, 0] - self.outline.front, points[:, 1]) <= matters + self._half]
        if len(points) == 0:
            return math.inf
        cos, sin = math.cos(yaw), math.sin(yaw)
        s, lateral = self.track.project(
            x + cos * points[:, 0] - sin * points[:, 1], y + sin * points[:, 0] + cos * points[:, 1]
        )
        ahead = np.asarray(s) - progress
        if self.path.closed:
            # Signed distance on a closed track, from -L/2 to L/2.
            ahead = np.mod(ahead + 0.5 * self.path.length, self.path.length) - 0.5 * self.path.length
        ahead = (ahead - self.outline.front)[np.abs(lateral) < self._half]
        # Points behind the rear axle do not obstruct a vehicle that drives ahead.
        ahead = ahead[ahead > -self.outline.front]
        return max(float(ahead.min()), 0.0) if ahead.size else math.inf


class HoldLaneSpec(Driver):
    """Hold a lane of a track, and stop before obstacles in it."""

    kind: Literal["hold_lane"] = Field(description="hold a lane of a track, and stop before obstacles in it [-]")
    track: str | None = Field(None, description="name of a track of the world, default its first [-]")
    offset: Length = Field(0.0, description="offset of the lane to the left of the centre line [m]")
    speed: Speed = Field(
        5.0, gt=0.0, le=100.0, description="set-point of the speed [m/s]; corners may be driven slower"
    )
    distance: Length = Field(2.0, ge=0.0, description="gap in front of the car when it stops [m]")
    clearance: Length = Field(
        0.2, ge=0.0, description="lateral distance within which an object obstructs the vehicle [m]"
    )
    lateral_acceleration: Acceleration = Field(3.0, gt=0.0, description="largest lateral acceleration [m/s²]")
    acceleration: Acceleration = Field(1.5, gt=0.0, description="largest acceleration [m/s²]")
    deceleration: Acceleration = Field(2.0, gt=0.0, description="largest deceleration, also of the stop [m/s²]")
    reaction: Reaction = 0.3
    period: DecisionPeriod = 0.05

    def make_system(
        self, vehicle: ShapedVehicle, world: DrivenWorld, *, where: str = "", folder: Path | None = None
    ) -> HoldLane:
        """Return the driver as a system: inputs ``state`` and ``ranges``, outputs ``command`` and ``path_error``.

        Raises:
            ConfigError: no such track, or the lane is too tight for the vehicle.
        """
        del folder
        try:
            return HoldLane(vehicle, track_to_follow(world, self.track), self)
        except ConfigError as error:
            raise error.under(self.place("track", where)) from None
