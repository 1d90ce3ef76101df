"""Behaviours as data: entries of ``control`` in a diagram file, and of ``behaviour`` in a world's tests.

::

    control:
      ego: {kind: straight_and_avoid, speed: 4 m/s}
      other: {kind: obstacle_stopper, speed: 5, as_published: true}
"""

import math
from collections.abc import Mapping
from typing import Annotated, Literal, Protocol

from pydantic import Field, model_validator

from mirdrake.controllers.ackermann import Ackermann
from mirdrake.controllers.behaviours.drive_to_nearest import DriveToNearest
from mirdrake.controllers.behaviours.follow_path import track_through
from mirdrake.controllers.behaviours.hold_lane import HoldLane
from mirdrake.controllers.behaviours.obstacle_stopper import PUBLISHED_DISTANCE, ObstacleStopper
from mirdrake.controllers.behaviours.outline import ShapedVehicle
from mirdrake.controllers.behaviours.straight_and_avoid import StraightAndAvoid
from mirdrake.controllers.drivable_line import DrivingLimits, Track
from mirdrake.controllers.path_tracking import PathGains, PathTracker
from mirdrake.controllers.schedule import ConstantCommand
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.yaml_io import Acceleration, Angle, Duration, Length, Schema, Speed
from mirdrake.core.yaml_io import where as place_of

_RADIUS_MARGIN = 1.25  # corners of a path of points over the tightest turn of the vehicle

Reaction = Annotated[Duration, Field(ge=0.0, description="delay of the brakes that the braking profile allows for [s]")]
Period = Annotated[Duration, Field(gt=0.0, le=0.2, description="time between decisions [s]")]
Points = list[tuple[Length, Length]]


class World(Protocol):
    """What a behaviour needs to know of its world."""

    @property
    def tracks(self) -> Mapping[str, Track]:
        """Tracks by name."""


class StraightAndAvoidSpec(Schema):
    """Straight on, around obstacles, back to the line; stop where there is no way through."""

    kind: Literal["straight_and_avoid"] = Field(description="straight on, around obstacles [-]")
    speed: Speed = Field(4.0, ge=0.0, le=100.0, description="wanted speed [m/s]; curves and stops are driven slower")
    clearance: Length = Field(0.5, ge=0.0, description="wanted distance to the side of obstacles [m]")
    distance: Length = Field(1.0, ge=0.0, description="gap in front of the car when it stops [m]")
    lookahead: Length = Field(
        12.0, gt=0.0, description="how far it looks at least [m]; never less than it takes to stop"
    )
    deceleration: Acceleration = Field(3.0, gt=0.0, description="of the braking profile [m/s^2]")
    reaction: Reaction = 0.3
    lateral_acceleration: Acceleration = Field(3.0, gt=0.0, description="largest lateral acceleration [m/s^2]")
    convergence_distance: Length = Field(3.0, gt=0.0, description="distance over which the line is come back to [m]")
    period: Period = 0.05

    def make_system(
        self,
        vehicle: ShapedVehicle,
        world: World | None = None,  # noqa: ARG002
        *,
        where: str = "",  # noqa: ARG002
    ) -> StraightAndAvoid:
        """The driver as a system with the inputs ``state`` and ``ranges`` and the output ``command``."""
        return StraightAndAvoid(
            vehicle,
            speed=self.speed,
            clearance=self.clearance,
            distance=self.distance,
            lookahead=self.lookahead,
            deceleration=self.deceleration,
            reaction=self.reaction,
            lateral_acceleration=self.lateral_acceleration,
            convergence_distance=self.convergence_distance,
            period=self.period,
        )


class DriveToNearestSpec(Schema):
    """Drive to the nearest object, and stop at a safe distance before it."""

    kind: Literal["drive_to_nearest_and_stop"] = Field(description="to the nearest object, and stop before it [-]")
    speed: Speed = Field(3.0, ge=0.0, le=100.0, description="wanted speed [m/s]")
    distance: Length = Field(2.0, ge=0.0, description="distance of the front edge to the object at the end [m]")
    deceleration: Acceleration = Field(2.0, gt=0.0, description="of the braking profile [m/s^2]")
    reaction: Reaction = 0.3
    lateral_acceleration: Acceleration = Field(3.0, gt=0.0, description="largest lateral acceleration [m/s^2]")
    period: Period = 0.05

    def make_system(
        self,
        vehicle: ShapedVehicle,
        world: World | None = None,  # noqa: ARG002
        *,
        where: str = "",  # noqa: ARG002
    ) -> DriveToNearest:
        """The driver as a system with the inputs ``state`` and ``ranges`` and the output ``command``."""
        return DriveToNearest(
            vehicle,
            speed=self.speed,
            distance=self.distance,
            deceleration=self.deceleration,
            reaction=self.reaction,
            lateral_acceleration=self.lateral_acceleration,
            period=self.period,
        )


class ObstacleStopperSpec(Schema):
    """Constant steering, and a stop before an obstacle: as published for the CAT Vehicle, or with a braking profile."""

    kind: Literal["obstacle_stopper"] = Field(description="constant steering, and a stop before an obstacle [-]")
    speed: Speed = Field(5.0, ge=0.0, le=100.0, description="wanted speed [m/s]")
    steering: Angle = Field(
        0.0,
        gt=-0.5 * math.pi,
        lt=0.5 * math.pi,
        description="wanted bicycle steering angle, positive to the left [rad]",
    )
    distance: Length = Field(
        PUBLISHED_DISTANCE,
        ge=0.0,
        description="as published: where speed 0 is commanded [m]; else the gap that is left [m]",
    )
    as_published: bool = Field(False, description="the published switch, without a braking profile [-]")
    deceleration: Acceleration = Field(3.0, gt=0.0, description="of the braking profile [m/s^2]")
    reaction: Reaction = 0.3
    period: Period = 0.05

    def make_system(
        self,
        vehicle: ShapedVehicle,
        world: World | None = None,  # noqa: ARG002
        *,
        where: str = "",  # noqa: ARG002
    ) -> ObstacleStopper:
        """The driver as a system with the inputs ``state`` and ``ranges`` and the output ``command``."""
        return ObstacleStopper(
            vehicle,
            speed=self.speed,
            steering=self.steering,
            distance=self.distance,
            as_published=self.as_published,
            deceleration=self.deceleration,
            reaction=self.reaction,
            period=self.period,
        )


class FollowPathSpec(Schema):
    """Follow a track of the world, or a path of points; obstacles are not looked at."""

    kind: Literal["follow_path"] = Field(description="follow a track or points, blind to obstacles [-]")
    track: str | None = Field(None, description="name of a track of the world, default its first [-]")
    points: Points | None = Field(None, min_length=2, description="x, y of a path in the world instead [m]")
    speed: Speed = Field(5.0, gt=0.0, le=100.0, description="set-point [m/s]; corners may be driven slower")
    lateral_acceleration: Acceleration = Field(3.0, gt=0.0, description="largest lateral acceleration [m/s^2]")
    acceleration: Acceleration = Field(1.5, gt=0.0, description="largest acceleration [m/s^2]")
    deceleration: Acceleration = Field(2.0, gt=0.0, description="largest deceleration [m/s^2]")
    period: Period = 0.05

    @model_validator(mode="after")
    def _one_path(self) -> "FollowPathSpec":
        if self.track is not None and self.points is not None:
            raise ValueError("track and points are given; a path is one of them")
        return self

    def make_system(self, vehicle: ShapedVehicle, world: World, *, where: str = "") -> PathTracker:
        """The driver as a system with the input ``state`` and the outputs ``command`` and ``path_error``.

        Raises:
            ConfigError: no such track, or the path is too tight for the vehicle.
        """
        place = _place(self, where, "points" if self.points else "track")
        try:
            if self.points is None:
                track = _track(world, self.track)
            else:
                law = Ackermann(vehicle.geometry)
                track = track_through(self.points, radius=_RADIUS_MARGIN / law.curvature(law.limit))
            limits = DrivingLimits(self.lateral_acceleration, self.acceleration, self.deceleration)
            return PathTracker(track, vehicle.geometry, gains=PathGains(self.speed), period=self.period, limits=limits)
        except ConfigError as error:
            raise ConfigError(f"{place}: {error}") from None


class HoldLaneSpec(Schema):
    """Hold a lane of a track, and stop before what stands in it."""

    kind: Literal["hold_lane"] = Field(description="hold a lane of a track, and stop before obstacles in it [-]")
    track: str | None = Field(None, description="name of a track of the world, default its first [-]")
    offset: Length = Field(0.0, description="of the lane, to the left of the centre line [m]")
    speed: Speed = Field(5.0, gt=0.0, le=100.0, description="set-point [m/s]; corners may be driven slower")
    distance: Length = Field(2.0, ge=0.0, description="gap in front of the car when it stops [m]")
    clearance: Length = Field(0.2, ge=0.0, description="distance to the side within which something is in the way [m]")
    lateral_acceleration: Acceleration = Field(3.0, gt=0.0, description="largest lateral acceleration [m/s^2]")
    acceleration: Acceleration = Field(1.5, gt=0.0, description="largest acceleration [m/s^2]")
    deceleration: Acceleration = Field(2.0, gt=0.0, description="largest deceleration, also of the stop [m/s^2]")
    reaction: Reaction = 0.3
    period: Period = 0.05

    def make_system(self, vehicle: ShapedVehicle, world: World, *, where: str = "") -> HoldLane:
        """The driver as a system with the inputs ``state`` and ``ranges``, the outputs ``command`` and ``path_error``.

        Raises:
            ConfigError: no such track, or the lane is too tight for the vehicle.
        """
        place = _place(self, where, "track")
        try:
            return HoldLane(
                vehicle,
                _track(world, self.track),
                gains=PathGains(self.speed),
                offset=self.offset,
                distance=self.distance,
                clearance=self.clearance,
                reaction=self.reaction,
                limits=DrivingLimits(self.lateral_acceleration, self.acceleration, self.deceleration),
                period=self.period,
            )
        except ConfigError as error:
            raise ConfigError(f"{place}: {error}") from None


class BlindSpec(Schema):
    """Straight on without looking: a bad driver, to see whether a test notices."""

    kind: Literal["blind"] = Field(description="straight on without looking: a bad driver to test tests with [-]")
    speed: Speed = Field(5.0, ge=0.0, le=100.0, description="wanted speed [m/s]")
    period: Period = 0.05

    def make_system(
        self,
        vehicle: ShapedVehicle | None = None,  # noqa: ARG002
        world: World | None = None,  # noqa: ARG002
        *,
        where: str = "",  # noqa: ARG002
    ) -> LeafSystem:
        """The driver as a system with the output ``command``; it needs to know of nothing."""
        return ConstantCommand(self.speed, period=self.period)


def _place(spec: Schema, where: str, key: str) -> str:
    return place_of(spec, key) if spec._source else where or "control"


def _track(world: World, name: str | None) -> Track:
    """The track of that name, or the first."""
    if not world.tracks:
        raise ConfigError("the world has no track to follow")
    if name is None:
        return next(iter(world.tracks.values()))
    if name not in world.tracks:
        raise ConfigError(f"unknown track '{name}'; {did_you_mean(name, world.tracks)}")
    return world.tracks[name]
