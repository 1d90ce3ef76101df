"""Follow a track of the world or a path of points, without regard to obstacles.

A path of points becomes a track of straights with arcs in its corners.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Literal

from pydantic import Field, model_validator

from mirdrake.controllers.ackermann import Ackermann
from mirdrake.controllers.behaviours.outline import ShapedVehicle
from mirdrake.controllers.drivable_line import DrivingLimits
from mirdrake.controllers.driver import DecisionPeriod, DrivenWorld, Driver, track_to_follow
from mirdrake.controllers.path_tracking import PathGains, PathTracker
from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import Acceleration, Length, Speed
from mirdrake.worlds.pieces import Piece
from mirdrake.worlds.tracks import Track

_RADIUS_MARGIN = 1.25  # radius of the corners over that of the tightest turn of the vehicle [1]


def track_through(points: Sequence[tuple[float, float]], *, radius: float) -> Track:
    """An open track along a polyline, its corners rounded by arcs.

    Args:
        points: x, y in the world (2 or more) [m].
        radius: of the arcs [m]; smaller where the straights between corners are too short: each corner has half of the
            straight to the next one.

    Raises:
        ConfigError: fewer than two points, two in one place, or a corner that turns back on itself.
    """
    if len(points) < 2:
        raise ConfigError(f"points: a path needs at least two, got {len(points)}")
    legs, headings = [], []
    for number, ((x0, y0), (x1, y1)) in enumerate(pairwise(points)):
        legs.append(math.hypot(x1 - x0, y1 - y0))
        headings.append(math.atan2(y1 - y0, x1 - x0))
        if legs[-1] < 1e-6:
            raise ConfigError(f"points: {number} and {number + 1} are in the same place, ({x0:g}, {y0:g}) m; drop one")
    # Wrapped to ±180 degrees, so that a corner never takes the long way round.
    turns = [math.remainder(b - a, 2.0 * math.pi) for a, b in pairwise(headings)]
    cuts = [0.0]  # how much of the straights a corner takes away [m]
    for number, turn in enumerate(turns):
        if abs(turn) > math.radians(170.0):
            raise ConfigError(f"points: the path turns back on itself at point {number + 1}; a car needs a wider turn")
        # A corner may use half of the straight to the next corner, and all of the first and last one.
        room = min(
            legs[number] * (1.0 if number == 0 else 0.5), legs[number + 1] * (1.0 if number == len(turns) - 1 else 0.5)
        )
        cuts.append(min(radius * math.tan(0.5 * abs(turn)), room))
    cuts.append(0.0)
    # Straights that are left between the cuts, each followed by its arc.
    pieces = []
    for number, leg in enumerate(legs):
        straight = leg - cuts[number] - cuts[number + 1]
        if straight > 1e-9:
            pieces.append(Piece(straight, 0.0, 0.0))
        if number < len(turns) and abs(turns[number]) > 1e-9:
            # The arc touches both straights at the cut: R = cut / tan(turn / 2).
            curvature = math.copysign(math.tan(0.5 * abs(turns[number])) / cuts[number + 1], turns[number])
            pieces.append(Piece(turns[number] / curvature, curvature, curvature))
    return Track(pieces, start=(*points[0], headings[0]), closed=False, name="path")


class FollowPathSpec(Driver):
    """Follow a track of the world, or a path of points, without regard to obstacles."""

    kind: Literal["follow_path"] = Field(description="follow a track or points, blind to obstacles [-]")
    track: str | None = Field(None, description="name of a track of the world, default its first [-]")
    points: list[tuple[Length, Length]] | None = Field(
        None, min_length=2, description="x and y of a path in the world, in place of a track [m]"
    )
    speed: Speed = Field(
        5.0, gt=0.0, le=100.0, description="set-point of the speed [m/s]; corners may be driven slower"
    )
    lateral_acceleration: Acceleration = Field(3.0, gt=0.0, description="largest lateral acceleration [m/s²]")
    acceleration: Acceleration = Field(1.5, gt=0.0, description="largest acceleration [m/s²]")
    deceleration: Acceleration = Field(2.0, gt=0.0, description="largest deceleration [m/s²]")
    period: DecisionPeriod = 0.05

    @model_validator(mode="after")
    def _one_path(self) -> "FollowPathSpec":
        if self.track is not None and self.points is not None:
            raise ValueError("track and points are given; a path is one of them")
        return self

    def make_system(
        self, vehicle: ShapedVehicle, world: DrivenWorld, *, where: str = "", folder: Path | None = None
    ) -> PathTracker:
        """Return the driver as a system with the input ``state`` and the outputs ``command`` and ``path_error``.

        Raises:
            ConfigError: no such track, or the path is too tight for the vehicle.
        """
        del folder
        try:
            if self.points is None:
                track = track_to_follow(world, self.track)
            else:
                law = Ackermann(vehicle.geometry)
                track = track_through(self.points, radius=_RADIUS_MARGIN / law.curvature(law.limit))
            limits = DrivingLimits(self.lateral_acceleration, self.acceleration, self.deceleration)
            return PathTracker(track, vehicle.geometry, gains=PathGains(self.speed), period=self.period, limits=limits)
        except ConfigError as error:
            raise error.under(self.place("points" if self.points else "track", where)) from None
