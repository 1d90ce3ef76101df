"""Drive to the nearest object and stop before it, as the parking-lot test of the world-language paper does.

The object that is nearest at first is kept in mind: of each new scan, what is nearest to the last place counts, if it
is within 2 m of it; else the nearest of all. The car steers on the circle through it, curvature 2 y/(x^2 + y^2) (pure
pursuit: R. C. Coulter, CMU-RI-TR-92-01), and brakes on :func:`~.laws.approach_speed`.
"""

import math
from typing import Literal

import numpy as np
from pydantic import Field

from mirdrake.controllers.behaviours.base import Behaviour, Decision, View
from mirdrake.controllers.behaviours.fan import Array
from mirdrake.controllers.behaviours.laws import approach_speed, free_distance, gap_to
from mirdrake.controllers.behaviours.outline import ShapedVehicle
from mirdrake.controllers.driver import BehaviourDriver, DecisionPeriod, Reaction
from mirdrake.core.yaml_io import Acceleration, Length, Speed

_SAME = 2.0  # what is nearer to the last place than this is the same object [m]


class DriveToNearest(Behaviour):
    """Drives to the nearest object and stops before it; straight on while it sees none. Ports as in :class:`Behaviour`.

    The distance is that of the car's front edge, over its whole width, to the object, or to anything else in its way.

    Memory: x, y of the object in the world [m].
    """

    def __init__(self, vehicle: ShapedVehicle, spec: "DriveToNearestSpec"):
        super().__init__(vehicle, period=spec.period, memory=2)
        self.spec = spec

    def decide(self, view: View, memory: Array) -> Decision:
        """Steer towards the object, within the braking profile."""
        points = view.points
        if len(points) == 0:
            memory[:] = math.nan
            return Decision(min(self.spec.speed, self._profile(math.inf)), 0.0)
        cos, sin = math.cos(view.yaw), math.sin(view.yaw)
        place = memory - (view.x, view.y)
        last = np.array([cos * place[0] + sin * place[1], cos * place[1] - sin * place[0]])
        gaps = gap_to(points, self.outline)
        away = np.hypot(*(points - last).T)  # NaN before there is an object
        # Stay with the object chosen before, as others may come nearer; then take its point nearest to the bumper.
        target = int(np.argmin(away)) if np.min(away) < _SAME else int(np.argmin(gaps))
        same = np.hypot(*(points - points[target]).T) < _SAME
        target = int(np.argmin(np.where(same, gaps, math.inf)))
        x, y = points[target].tolist()
        memory[:] = view.x + cos * x - sin * y, view.y + sin * x + cos * y

        # Pure pursuit: the circle through the rear axle centre, tangential to the heading, and the point.
        steering = self.law.clip(self.law.steering(2.0 * y / (x * x + y * y)))
        curvature = self.law.curvature(steering)
        way = free_distance(points, [curvature], self.outline)[0]
        profile = self._profile(min(float(gaps[target]), float(way)))
        limit = math.sqrt(self.spec.lateral_acceleration / max(abs(curvature), 1e-6))
        return Decision(min(self.spec.speed, profile, limit), steering)

    def _profile(self, gap: float) -> float:
        """Return the largest speed with an obstacle at a gap [m], m/s."""
        return approach_speed(
            gap,
            distance=self.spec.distance,
            deceleration=self.spec.deceleration,
            reaction=self.spec.reaction,
            period=self.spec.period,
        )


class DriveToNearestSpec(BehaviourDriver):
    """Drive to the nearest object, and stop at a safe distance before it."""

    system = DriveToNearest

    kind: Literal["drive_to_nearest_and_stop"] = Field(description="to the nearest object, and stop before it [-]")
    speed: Speed = Field(3.0, ge=0.0, le=100.0, description="set-point of the speed [m/s]")
    distance: Length = Field(2.0, ge=0.0, description="distance of the front edge to the object at the end [m]")
    deceleration: Acceleration = Field(2.0, gt=0.0, description="deceleration of the braking profile [m/s²]")
    reaction: Reaction = 0.3
    lateral_acceleration: Acceleration = Field(3.0, gt=0.0, description="largest lateral acceleration [m/s²]")
    period: DecisionPeriod = 0.05
