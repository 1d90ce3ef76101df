"""Drive straight on, steer around obstacles, return to the line, stop if there is no passage.

At every decision the car predicts its path for a number of steering angles: the angle changes with the rate of the
steering, then it stays (the dynamic window of D. Fox, W. Burgard, S. Thrun, The dynamic window approach to collision
avoidance, IEEE Robotics & Automation Magazine 4(1), 1997, for a car with a limited steering rate). Such a path has one
bend; paths to lines beside the car, parallel to its own, have two. Bends become tighter along a path as the car can
brake for them. Each path is free as far as a box as wide as the car
and the clearance to both sides can follow it. The path back to the line is taken when it is free as far as the car
looks, with the whole clearance and with half of it. Otherwise that one counts on which the bumper makes most way along
the line, with the whole clearance and with half of it alike, with a little preference for the present steering and for
the way back, so that the car does not alternate between two sides. The speed is such that the car can stop before the
chosen path ends for half the clearance.

The scan does not see beside the car: what passes out of it is remembered until the car has gone by.
"""

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from mirdrake.controllers.behaviours.base import Behaviour, Decision, View
from mirdrake.controllers.behaviours.fan import Array
from mirdrake.controllers.behaviours.laws import approach_speed, bend_speed, line_curvature, stopping_distance
from mirdrake.controllers.behaviours.outline import Outline, ShapedVehicle
from mirdrake.controllers.driver import BehaviourDriver, DecisionPeriod, Reaction
from mirdrake.core.yaml_io import Acceleration, Length, Speed

_ANGLES = 21
_LINES = 8  # to either side, half the width of the car apart
_STEP = 0.25  # between the poses of a path; a front end moves less to the side than the clearance [m]
_BLOCK = 12  # poses that are evaluated together
_PREFERENCE = 0.1  # cost of full steering away from the present or the target angle, as a share of the path looked at
_BESIDE = 5.0  # lateral distance beyond which points are not remembered [m]
_GRAIN = 0.1  # points closer together are remembered as one [m]
_MOST = 256  # points remembered


class Paths(NamedTuple):
    """Poses of the rear axle centre along paths (n, m) in B [m, rad], every 0.25 m; the first one is the present."""

    x: Array
    y: Array
    yaw: Array


class StraightAndAvoid(Behaviour):
    """Straight on from where it starts, around obstacles. Ports as in :class:`Behaviour`.

    Memory: x, y, yaw of the line in the world [m, rad]; steering angle [rad]; x and y of points in the world [m].
    """

    def __init__(self, vehicle: ShapedVehicle, spec: "StraightAndAvoidSpec"):
        super().__init__(vehicle, period=spec.period, memory=4 + 2 * _MOST)
        self.spec, self._wheelbase = spec, vehicle.geometry.wheelbase
        share = np.linspace(-1.0, 1.0, _ANGLES)
        self._shares = share * np.abs(share)  # closer together near straight ahead
        self._lines = -self.outline.half_width * np.arange(-_LINES, _LINES + 1)
        # Wider by the largest deviation of a bent path from a straight line between two poses.
        bulge = self.law.curvature(self.law.limit) * _STEP**2 / 8.0
        self._box = self.outline._replace(half_width=self.outline.half_width + bulge)

    def decide(self, view: View, memory: Array) -> Decision:
        """Choose the best steering angle, and the speed allowed with it."""
        # The line is fixed by the pose at the first decision.
        if math.isnan(memory[0]):
            memory[:4] = view.x, view.y, view.yaw, 0.0
        x0, y0, yaw0, present = memory[:4].tolist()
        heading = math.remainder(view.yaw - yaw0, 2.0 * math.pi)
        lateral = math.cos(yaw0) * (view.y - y0) - math.sin(yaw0) * (view.x - x0)
        points = self._remember(view, memory)
        speed = max(view.speed, 0.0)

        look = self.spec.distance + stopping_distance(
            speed, deceleration=self.spec.deceleration, reaction=self.spec.reaction
        )
        # It looks farther than it needs to stop, so that it can still choose.
        look = max(self.spec.lookahead, 1.2 * look)
        steps = math.ceil(look / _STEP)
        points = points[np.hypot(points[:, 0], points[:, 1]) < look + self.outline.front + self.outline.half_width]
        # The largest angles for the lateral acceleration v² κ along a way on which the car brakes from now on, and the
        # change of the angle within a step.
        along = _STEP * np.arange(steps)
        braked = 2.0 * self.spec.deceleration * np.maximum(along - speed * self.spec.reaction, 0.0)
        bends = self.spec.lateral_acceleration / np.maximum(speed**2 - braked, 1.0)
        largest = np.minimum(self.law.limit, np.arctan(self._wheelbase * bends))
        change = self.law.rate * _STEP / max(speed, 1.0)

        convergence = max(self.spec.convergence_distance, 0.8 * speed)
        # Ways to lines parallel to its own: first its own, then those beside where the car is.
        lines = np.append(lateral, self._lines)
        target, ways = self._ways_to(lines, heading, convergence, largest, present, change, steps)
        steering, way, followed = float(target[0]), math.inf, ways[0]
        clearances = [self.spec.clearance, 0.5 * self.spec.clearance]
        # Paths are compared only if the way back to the line is not free.
        if free_ways(clearances, points, self._paths(ways[:1]), self._box).min() < steps:
            turned: Array = self.law.limit * self._shares
            bent = np.clip(turning(present, turned, change, steps), -largest, largest)
            angles, followable = np.concatenate((turned, target)), np.vstack((bent, ways))
            angles = np.clip(angles, -largest[0], largest[0])
            paths = self._paths(followable)
            wide, narrow = free_ways(clearances, points, paths, self._box)
            # Mean progress with full and with half clearance; the cost keeps it from alternating between the sides.
            made = sum(self._progress(paths, heading, way) for way in (wide, narrow)) / (2.0 * look)
            cost = (np.abs(angles - steering) + np.abs(angles - present)) / (2.0 * largest[0])
            chosen = int(np.argmax(made - _PREFERENCE * cost))
            steering, followed = float(angles[chosen]), followable[chosen]
            way = float(narrow[chosen]) * _STEP if narrow[chosen] < steps else math.inf
        memory[3] = self.law.approach(present, steering, period=self.period)
        profile = approach_speed(
            way,
            distance=self.spec.distance,
            deceleration=self.spec.deceleration,
            reaction=self.spec.reaction,
            period=self.spec.period,
        )
        # Lateral acceleration v² κ: of the present set-point of the steering, and of the bends ahead.
        curvatures = np.tan(np.append(steering, followed)) / self._wheelbase
        limit = bend_speed(
            curvatures,
            np.append(0.0, along),
            lateral_acceleration=self.spec.lateral_acceleration,
            deceleration=self.spec.deceleration,
            reaction=self.spec.reaction,
        )
        return Decision(min(self.spec.speed, profile, limit), steering)

    def _ways_to(
        self,
        lateral: Array,
        heading: float,
        convergence: float,
        largest: Array,
        steering: float,
        change: float,
        steps: int,
    ) -> tuple[Array, Array]:
        """Return the steering angles that the ways to parallel lines ask for now (n), and after each step (n, steps).

        Args:
            lateral: offsets of the car from the lines (n) [m].
            heading: course minus direction of the lines [rad].
            convergence: distance over which a line is approached [m].
            largest: largest steering angle in each step (steps) [rad].
            steering: present steering angle [rad].
            change: largest change of the angle in a step [rad].
            steps: number of steps.
        """
        angle, yaw = np.full(len(lateral), steering), np.full(len(lateral), heading)
        angles, now = np.empty((len(lateral), steps)), angle
        for k in range(steps):
            target = np.arctan(self._wheelbase * line_curvature(lateral, yaw, distance=convergence))
            target = np.minimum(np.maximum(target, -largest[k]), largest[k])
            now = target if k == 0 else now
            angle = angle + np.minimum(np.maximum(target - angle, -change), change)
            angles[:, k] = angle
            turn = np.tan(angle) * (_STEP / self._wheelbase)
            lateral = lateral + _STEP * np.sin(yaw + 0.5 * turn)
            yaw = yaw + turn
        return now, angles

    def _paths(self, angles: Array) -> Paths:
        """Return the paths for steering angles in each step (n, steps) [rad]."""
        turn = np.tan(angles) / self._wheelbase * _STEP
        yaw = np.cumsum(turn, axis=1)
        middle = yaw - 0.5 * turn
        moves = np.cumsum(np.cos(middle) * _STEP, axis=1), np.cumsum(np.sin(middle) * _STEP, axis=1), yaw
        return Paths(*(np.insert(column, 0, 0.0, axis=1) for column in moves))

    def _progress(self, paths: Paths, heading: float, way: Array) -> Array:
        """Return the progress of the front end along the line (n) [m] after a number of steps of each path (n)."""
        lever = self.outline.front * (np.cos(paths.yaw + heading) - math.cos(heading))
        along = paths.x * math.cos(heading) - paths.y * math.sin(heading) + lever
        row, last = np.arange(len(along)), along.shape[1] - 1
        way = np.minimum(way, last)
        step = np.minimum(way.astype(int), last - 1)
        share = way - step
        return np.asarray(along[row, step] + share * (along[row, step + 1] - along[row, step]))

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


def turning(present: float, angles: Array, change: float, steps: int) -> Array:
    """Return steering angles in each step (n, steps) [rad] that change from the present one as fast as they can.

    Args:
        present: the present angle [rad].
        angles: those at the end (n) [rad].
        change: largest change of the angle in a step [rad].
        steps: number of steps.
    """
    difference = (angles - present)[:, None]
    # The angle in a step is that in its middle.
    largest = change * (np.arange(steps) + 0.5)
    return np.asarray(present + np.clip(difference, -largest, largest))


def free_ways(clearances: Sequence[float], points: Array, paths: Paths, outline: Outline) -> Array:
    """Return how many steps a vehicle can follow paths with clearances to both sides (k, n); infinite: all of them.

    Between two poses points move on straight lines in the frame of the car, which is exact for a straight path. To a
    point that is nearer than the clearance beside the car already, half of its present distance is kept, since no
    steering can keep the clearance.

    Args:
        clearances: the clearances (k) [m].
        points: points in B (m, 2) [m].
        paths: the paths (n).
        outline: the box.
    """
    result = np.full((len(clearances), len(paths.x)), math.inf)
    if len(points) == 0:
        return result
    rear, front, half, _ = outline
    aside = np.abs(points[:, 1]) - half
    beside_now = (points[:, 0] > rear) & (points[:, 0] < front) & (aside > 0.0)

    kept = [half + np.where(beside_now & (aside < one), 0.5 * aside, one) for one in clearances]
    # A few poses at a time, since most paths end before the last ones.
    for begin in range(0, paths.x.shape[1] - 1, _BLOCK):
        rows = np.flatnonzero(np.isinf(result).any(axis=0))
        if not rows.size:
            break
        x, y, yaw = (column[rows, begin : begin + _BLOCK + 1, None] for column in paths)
        # Points in the frame of the car at each pose: how far they are outside of the ends and of the sides of the box.
        cosine, sine, dx, dy = np.cos(yaw), np.sin(yaw), points[:, 0] - x, points[:, 1] - y
        ahead, beside = cosine * dx + sine * dy, np.abs(cosine * dy - sine * dx)
        end = np.maximum(rear - ahead, ahead - front)
        for way, width in zip(result, kept, strict=True):
            inside = (end < 0.0) & (beside < width)
            hit: NDArray[np.bool_] = np.any(inside, axis=2)
            blocked = np.flatnonzero(hit.any(axis=1) & np.isinf(way[rows]))
            first = np.argmax(hit[blocked], axis=1)
            last = np.maximum(first - 1, 0)
            # Between the last free pose and the next one, a point is inside when both distances have become negative.
            distances = (end, beside - width)
            shares = [_crossing(one[blocked, last], one[blocked, first]) for one in distances]
            way[rows[blocked]] = begin + last + np.maximum(*shares).min(axis=1)
    return result


def _crossing(before: Array, after: Array) -> Array:
    """Return the share of a step after which distances become negative; infinite if they do not."""
    before = np.maximum(before, 0.0)
    return np.where(after < 0.0, before / (before - np.minimum(after, -1e-9)), np.inf)


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
        12.0, gt=0.0, description="least distance that it looks ahead [m]; always at least its stopping distance"
    )
    deceleration: Acceleration = Field(3.0, gt=0.0, description="deceleration of the braking profile [m/s²]")
    reaction: Reaction = 0.3
    lateral_acceleration: Acceleration = Field(3.0, gt=0.0, description="largest lateral acceleration [m/s²]")
    convergence_distance: Length = Field(3.0, gt=0.0, description="distance over which it returns to the line [m]")
    period: DecisionPeriod = 0.05
