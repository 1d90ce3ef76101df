"""Drive with constant steering, and stop before what is ahead.

As published, in the CAT Vehicle's node `obstaclestopper` (jmscslgroup/obstaclestopper, also in the Bolt's
mir_vehicle_fasil; generated from Simulink, model 1.8) fed by its `distanceEstimator`::

    v_out = v_in sign(clip(dist - 5 m, 0, 1)),   steering unchanged

`dist` is the nearest return within 0.1 rad of straight ahead. It is a switch without a braking profile: speed 0 is
commanded at 5 m, whatever the speed. A car that then brakes with a after a delay t stops ``5 m - v t - v^2/(2 a)`` from
the obstacle and hits it when that is negative; with a = 5 m/s^2 and no delay above 7.1 m/s. (Model 1.86 puts a state
machine for a three-second distance before the same switch; it is not reproduced here.)

With the braking profile, the speed is also limited to that from which the car stops within the range of the scan.
"""

from typing import Literal

import numpy as np
from pydantic import Field

from mirdrake.controllers.behaviours.base import Behaviour, Decision, View
from mirdrake.controllers.behaviours.fan import Array
from mirdrake.controllers.behaviours.laws import approach_speed, free_distance
from mirdrake.controllers.behaviours.outline import Outline, ShapedVehicle
from mirdrake.controllers.driver import BehaviourDriver, DecisionPeriod, Reaction, SteeringAngle
from mirdrake.core.yaml_io import Acceleration, Length, Speed

PUBLISHED_DISTANCE = 5.0
"""Where the published stopper commands speed 0 [m]."""
PUBLISHED_ANGLE = 0.1
"""How far to each side the published distance estimator looks [rad]."""


class ObstacleStopper(Behaviour):
    """Constant steering, and a stop before an obstacle. Ports as in :class:`Behaviour`."""

    def __init__(self, vehicle: ShapedVehicle, spec: "ObstacleStopperSpec"):
        super().__init__(vehicle, period=spec.period)
        self.spec = spec
        self.steering = self.law.clip(spec.steering)
        # The published law looks at a narrow sector of the scan only.
        self._ahead = np.abs(self.fan.angles) < PUBLISHED_ANGLE

    def decide(self, view: View, memory: Array) -> Decision:  # noqa: ARG002
        """Apply the published switch, or the braking profile over the free distance along the circle."""
        if self.spec.as_published:
            dist = float(view.ranges[self._ahead].min())
            return Decision(published_speed(self.spec.speed, dist, distance=self.spec.distance), self.steering)
        profile = approach_speed(
            free_way(view.points, self.law.curvature(self.steering), self.outline),
            distance=self.spec.distance,
            deceleration=self.spec.deceleration,
            reaction=self.spec.reaction,
            period=self.spec.period,
        )
        return Decision(min(self.spec.speed, profile), self.steering)


def published_speed(speed: float, dist: float, *, distance: float = PUBLISHED_DISTANCE) -> float:
    """Return the speed of the published law: v sign(clip(dist - distance, 0, 1)) [m/s]."""
    return speed if dist > distance else 0.0


def free_way(points: Array, curvature: float, outline: Outline) -> float:
    """Return the free distance [m] along one circle; inf without an obstacle, 0 in contact."""
    return float(free_distance(points, [curvature], outline)[0])


class ObstacleStopperSpec(BehaviourDriver):
    """Constant steering, and a stop before an obstacle: as published for the CAT Vehicle, or with a braking profile."""

    system = ObstacleStopper

    kind: Literal["obstacle_stopper"] = Field(description="constant steering, and a stop before an obstacle [-]")
    speed: Speed = Field(5.0, ge=0.0, le=100.0, description="set-point of the speed [m/s]")
    steering: SteeringAngle = 0.0
    distance: Length = Field(
        PUBLISHED_DISTANCE,
        ge=0.0,
        description="gap at standstill; as published: gap at which speed 0 is commanded [m]",
    )
    as_published: bool = Field(
        False, description="switch the speed off at `distance`, as published, without a braking profile [-]"
    )
    deceleration: Acceleration = Field(3.0, gt=0.0, description="deceleration of the braking profile [m/s²]")
    reaction: Reaction = 0.3
    period: DecisionPeriod = 0.05
