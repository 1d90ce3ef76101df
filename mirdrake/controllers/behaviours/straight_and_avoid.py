"""Drive straight on, steer around obstacles, return to the line, stop if there is no passage.

At every decision the car looks along circles, how far they are free for a box as wide as the car and the clearance to
both sides (:func:`~.laws.free_distance`). The circle that leads back to the line is taken when it is free as far as the
car looks. Otherwise that one counts on which the bumper makes most way along the line, with the whole clearance and
with half of it alike, with a little preference for the present steering and for the way back, so that the car does not
dither. The speed is such that the car can stop before the chosen circle ends for half the clearance.

The scan does not see beside the car: what passes out of it is remembered until the car has gone by.
"""

import math
from typing import Literal

import numpy as np
from pydantic import Field

from mirdrake.controllers.behaviours.base import Behaviour, Decision, View
from mirdrake.controllers.behaviours.fan import Array
from mirdrake.controllers.behaviours.laws import (
    brake_speed,
    free_distance,
    headway,
    line_curvature,
    stopping_distance,
)
from mirdrake.controllers.behaviours.outline import Outline, ShapedVehicle
from mirdrake.controllers.driver import BehaviourDriver, DecisionPeriod, Reaction
from mirdrake.core.yaml_io import Acceleration, Length, Speed

_CIRCLES = 31
_PREFERENCE = 0.1  # what full steering away from the present or the wanted one costs, in parts of the way looked at
_BESIDE = 5.0  # lateral distance beyond which points are not remembered [m]
_GRAIN = 0.1  # points closer together are remembered as one [m]
_MOST = 256  # points remembered


class StraightAndAvoid(Behaviour):
    """Straight on from where it starts, around obstacles. Ports as in :class:`Behaviour`.

    Memory: x, y, yaw of the line in the world [m, rad]; last curvature [1/m]; x and y of points in the world [m].
    """

    def __init__(self, vehicle: ShapedVehicle, spec: "StraightAndAvoidSpec"):
        super().__init__(vehicle, period=spec.period, memory=4 + 2 * _MOST)
        self.spec = spec
        share = np.linspace(-1.0, 1.0, _CIRCLES)
        self._shares = share * np.abs(share)  # closer together near straight ahead

    def decide(self, view: View, memory: Array) -> Decision:
        """Choose the best circle, and the speed allowed on it."""
        # The line is fixed by the pose at the first decision.
        if math.isnan(memory[0]):
            memory[:4] = view.x, view.y, view.yaw, 0.0
        x0, y0, yaw0, previous = memory[:4].tolist()
        heading = math.remainder(view.yaw - yaw0, 2.0 * math.pi)
        lateral = math.cos(yaw0) * (view.y - y0) - math.sin(yaw0) * (view.x - x0)
        points = self._remember(view, memory)
        speed = max(view.speed, 0.0)

        look = self.spec.distance + stopping_distance(
            speed, deceleration=self.spec.deceleration, reaction=self.spec.reaction
        )
        # It looks farther than it needs to stop, so that it can still choose.
        look = max(self.spec.lookahead, 1.2 * look)
        max_curvature = min(self.law.curvature(self.law.limit), self.spec.lateral_acceleration / max(speed, 1.0) ** 2)
        distance = max(self.spec.convergence_distance, 0.8 * speed)
        wanted = min(max(line_curvature(lateral, heading, distance=distance), -max_curvature), max_curvature)
        points = points[np.hypot(points[:, 0], points[:, 1]) < look + self.outline.front + self.outline.half_width]
        curvature, way = wanted, math.inf
        # Circles are compared only if the way back to the line is not free.
        if way_with(self.spec.clearance, points, np.array([wanted]), self.outline, reach=look)[0] < look:
            kappa = np.append(self._shares * max_curvature, wanted)
            wide = way_with(self.spec.clearance, points, kappa, self.outline, reach=look)
            narrow = way_with(0.5 * self.spec.clearance, points, kappa, self.outline, reach=look)
            # Mean progress with full and with half clearance; the cost keeps it from alternating between the sides.
            made = sum(headway(way, kappa, heading, lever=self.outline.front) for way in (wide, narrow)) / (2.0 * look)
            cost = (np.abs(kappa - wanted) + np.abs(kappa - previous)) / (2.0 * max_curvature)
            chosen = int(np.argmax(made - _PREFERENCE * cost))
            curvature, way = float(kappa[chosen]), float(narrow[chosen])
        memory[3] = curvature
        profile = math.inf
        if way < look:
            profile = brake_speed(
                way - self.spec.distance, deceleration=self.spec.deceleration, reaction=self.spec.reaction
            )
        # Lateral acceleration v² κ.
        limit = math.sqrt(self.spec.lateral_acceleration / max(abs(curvature), 1e-6))
        return Decision(min(self.spec.speed, profile, limit), self.law.steering(curvature))

    def _remember(self, view: View, memory: Array) -> Array:
        """Points in B (m, 2) [m]: those of the scan, and those that have passed out of it but not yet the car."""
        known = memory[4:].reshape(-1, 2)
        known = known[~np.isnan(known[:, 0])] - (view.x, view.y)
        R = np.array([[math.cos(view.yaw), -math.sin(view.yaw)], [math.sin(view.yaw), math.cos(view.yaw)]])
        passed = known @ R  # rows of R are the axes of W in B
        beside = (passed[:, 0] <= self.outline.front) & (passed[:, 0] > self.outline.rear - self.spec.clearance)
        near = np.hypot(view.points[:, 0] - self.outline.front, view.points[:, 1]) < 2.0 * _BESIDE
        keep = np.vstack((passed[beside & (np.abs(passed[:, 1]) < _BESIDE)], view.points[near]))
        in_world = keep @ R.T + (view.x, view.y)
        # One point per cell of the grid in the world; if there are too many, the nearest are kept.
        _, first = np.unique(np.round(in_world / _GRAIN), axis=0, return_index=True)
        nearest = np.sort(first)[np.argsort(np.hypot(*keep[np.sort(first)].T), kind="stable")][:_MOST]
        memory[4:] = math.nan
        memory[4 : 4 + 2 * len(nearest)] = in_world[nearest].ravel()
        return np.vstack((passed[beside], view.points))


def way_with(clearance: float, points: Array, curvatures: Array, outline: Outline, *, reach: float) -> Array:
    """Free distances (k) [m] on circles with a clearance [m] to both sides.

    What is nearer than that beside the car already, so that no steering could keep the clearance, is only not to be
    touched.
    """
    rear, front, half, _ = outline
    box = outline._replace(half_width=half + clearance)
    x, side = points[:, 0], np.abs(points[:, 1])
    # Points within the clearance already would make every free distance zero.
    close = (x > rear) & (x < front) & (side < half + clearance) & (side > half)
    free = free_distance(points[~close], curvatures, box, reach=reach)
    return np.minimum(free, free_distance(points[close], curvatures, outline, reach=reach))


class StraightAndAvoidSpec(BehaviourDriver):
    """Driver that goes straight on, around obstacles, back to the line, and stops if there is no passage."""

    system = StraightAndAvoid

    kind: Literal["straight_and_avoid"] = Field(description="straight on, around obstacles [-]")
    speed: Speed = Field(
        4.0, ge=0.0, le=100.0, description="set-point of the speed [m/s]; curves and stops are driven slower"
    )
    clearance: Length = Field(0.5, ge=0.0, description="desired lateral distance to obstacles [m]")
    distance: Length = Field(1.0, ge=0.0, description="gap in front of the car when it stops [m]")
    lookahead: Length = Field(
        12.0, gt=0.0, description="how far it looks at least [m]; never less than it takes to stop"
    )
    deceleration: Acceleration = Field(3.0, gt=0.0, description="of the braking profile [m/s^2]")
    reaction: Reaction = 0.3
    lateral_acceleration: Acceleration = Field(3.0, gt=0.0, description="largest lateral acceleration [m/s^2]")
    convergence_distance: Length = Field(3.0, gt=0.0, description="distance over which the line is come back to [m]")
    period: DecisionPeriod = 0.05
