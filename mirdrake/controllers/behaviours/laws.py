"""Laws of the behaviours on plain numbers and arrays: speed, steering and free distance.

Points are in the vehicle frame B: origin below the rear axle centre, x ahead, y left.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from mirdrake.controllers.behaviours.fan import REACH, Array
from mirdrake.controllers.behaviours.outline import Outline

_STEEPEST = 0.5  # tangent of the steepest angle at which a line is approached
_STEEPEST_COURSE = 1.2  # course errors beyond this count as this [rad]
_STRAIGHT = 1e-6  # curvatures below this are straight [1/m]
_AT_REST = 0.01  # a gap this small needs no more driving [m]


def brake_speed(gap: float, *, deceleration: float, reaction: float) -> float:
    """Return the speed [m/s] from which the car stops within a distance.

    The distance is that of the reaction time t at constant speed, and of braking with the deceleration a::

        gap = v t + v^2/(2 a),   v = sqrt((a t)^2 + 2 a gap) - a t

    so v = sqrt(2 a gap) for t = 0. Near the goal v goes as gap/t: the car settles there instead of overshooting.

    Args:
        gap: how far the car may still go [m]; 0 below 1 cm.
        deceleration: a [m/s²].
        reaction: t, the delay until the brakes act [s].
    """
    if gap < _AT_REST:
        return 0.0
    if math.isinf(gap):
        return math.inf
    lag = deceleration * reaction
    return math.sqrt(lag * lag + 2.0 * deceleration * gap) - lag


def stopping_distance(speed: float, *, deceleration: float, reaction: float) -> float:
    """Return the distance [m] that :func:`brake_speed` needs for a speed [m/s]."""
    return speed * reaction + 0.5 * speed * speed / deceleration


def approach_speed(gap: float, *, distance: float, deceleration: float, reaction: float, period: float) -> float:
    """Return the speed [m/s] from which the car stops before what it sees, and within the range of the scan.

    Without the second part, the assured clear distance ahead, a fast car sees an obstacle too late to stop. What comes
    within the range right after a decision is noticed at the next one, a period T later. The speed is therefore the
    smaller one of :func:`brake_speed` and of the v with::

        v T + v t + v^2/(2 a) = REACH - distance

    Args:
        gap: distance of the nearest obstacle on the way [m]; infinite without one.
        distance: the gap that is left when the car stops [m].
        deceleration: a [m/s²].
        reaction: t, the delay until the brakes act [s].
        period: T, the time between decisions [s].
    """
    return min(
        brake_speed(gap - distance, deceleration=deceleration, reaction=reaction),
        brake_speed(REACH - distance, deceleration=deceleration, reaction=reaction + period),
    )


def bend_speed(
    curvatures: ArrayLike, distances: ArrayLike, *, lateral_acceleration: float, deceleration: float, reaction: float
) -> float:
    """Return the speed [m/s] from which the car can slow down in time for all bends of its way.

    At the distance s, the curvature k allows the speed v with v^2 |k| = a_y. The car is not faster, or brakes to it in
    time, as in :func:`brake_speed`: v t + (v^2 - a_y/|k|)/(2 a) = s.

    Args:
        curvatures: k of the way (n) [1/m].
        distances: s at which the curvatures begin (n) [m].
        lateral_acceleration: a_y [m/s²].
        deceleration: a [m/s²].
        reaction: t, the delay until the brakes act [s].
    """
    lag = deceleration * reaction
    squares = lateral_acceleration / np.maximum(np.abs(curvatures), _STRAIGHT)
    braked = np.sqrt(lag * lag + squares + 2.0 * deceleration * np.asarray(distances)) - lag
    return float(np.min(np.maximum(np.sqrt(squares), braked)))


def line_curvature(lateral: ArrayLike, heading: ArrayLike, *, distance: float) -> Array:
    """Return the curvature [1/m] that leads the rear axle centre to a straight line, critically damped over a distance.

    The law of :mod:`mirdrake.controllers.path_tracking` for a straight line: e'' = -(2/d) e' - e/d^2 with e' = tan of
    the course; far away the line is approached at an angle of at most 27 degrees.

    Args:
        lateral: offset from the line, positive to the left [m]; one or several.
        heading: course minus direction of the line [rad].
        distance: d [m].
    """
    theta = np.mod(np.asarray(heading) + math.pi, 2.0 * math.pi) - math.pi
    theta = np.minimum(np.maximum(theta, -_STEEPEST_COURSE), _STEEPEST_COURSE)
    # 2/d (tan θ + e / (2 d)), with the offset limited to the steepest angle of approach.
    approach = np.minimum(np.maximum(0.5 / distance * np.asarray(lateral), -_STEEPEST), _STEEPEST)
    return np.asarray(-2.0 / distance * (np.tan(theta) + approach) * np.cos(theta) ** 3)


def gap_to(points: Array, outline: Outline) -> Array:
    """Return the distances (m) [m] from the front edge of a vehicle to points (m, 2) ahead of it."""
    beside = np.maximum(np.abs(points[:, 1]) - outline.half_width, 0.0)
    return np.asarray(np.hypot(np.maximum(points[:, 0] - outline.front, 0.0), beside))


def free_distance(points: Array, curvatures: ArrayLike, outline: Outline, *, reach: float = math.inf) -> Array:
    """Return the distances that the rear axle centre can travel on circles until the vehicle's box touches a point.

    Exact. In the box's frame a point moves on a circle of radius rho about the turning centre C = (0, R). It enters
    through the front end, through the inner side ahead of the rear axle, or through the outer side behind it, where
    rear ends swing out; each entry is an intersection of that circle with an edge. The first one counts.

    Args:
        points: in B (m, 2) [m].
        curvatures: of the path of the rear axle centre (k) [1/m]; their radii are larger than half the width.
        outline: the box.
        reach: result where nothing is met on the way [m].

    Returns:
        Distances (k) [m], at most `reach`; 0 if a point lies within the box.
    """
    kappa = np.atleast_1d(np.asarray(curvatures, dtype=float))
    result = np.full(kappa.shape, reach)
    if len(points) == 0:
        return result
    rear, front, half, _ = outline
    x, y = points[:, 0], points[:, 1]
    if np.any((x > rear) & (x < front) & (np.abs(y) < half)):
        return np.zeros_like(result)
    straight = np.abs(kappa) < _STRAIGHT
    # Straight: only points in the strip ahead of the front end are met.
    ahead = x[(np.abs(y) < half) & (x >= front)]
    if ahead.size:
        result[straight] = min(reach, float(ahead.min()) - front)
    turning = ~straight
    if not turning.any():
        return result

    radius = 1.0 / np.abs(kappa[turning])[:, None]
    side = np.sign(kappa[turning])[:, None] * y  # mirrored: every turn is to the left
    rho = np.hypot(x, side - radius)
    now = np.arctan2(x, radius - side)  # angle from the foot of C, falling as the vehicle goes on
    # NaN where a circle does not meet an edge: fmin below ignores it.
    with np.errstate(invalid="ignore", divide="ignore"):
        front_y = radius - np.sqrt(rho * rho - front * front)
        at_front = np.where(np.abs(front_y) <= half, np.arcsin(front / rho), np.nan)
        inner_x = np.sqrt(rho * rho - (radius - half) ** 2)
        at_inner = np.where(inner_x <= front, np.arccos((radius - half) / rho), np.nan)
        outer_x = np.sqrt(rho * rho - (radius + half) ** 2)
        at_outer = np.where(outer_x <= -rear, -np.arccos((radius + half) / rho), np.nan)
    angle = np.full(rho.shape, math.inf)
    for entry in (at_front, at_inner, at_outer):
        # An entry behind the point is met after nearly a full turn.
        to_go = now - entry
        angle = np.fmin(angle, np.where(to_go < -1e-9, to_go + 2.0 * math.pi, to_go))
    result[turning] = np.clip(np.min(angle, axis=1) * radius[:, 0], 0.0, reach)
    return result
