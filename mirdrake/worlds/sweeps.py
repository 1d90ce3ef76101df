"""Contacts between samples: moving outlines that touch between two poses, and the time until they would touch.

Between two samples poses are linear in time. A contact is found by conservative advancement (B. Mirtich, Impulse-based
Dynamic Simulation, 1996): two outlines at the distance d cannot touch before the time d / L, where L is the largest
speed of their points relative to each other, so that time may advance by it. In the end the distance is below
:data:`TOUCH` or the next sample is reached.
"""

import math
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from mirdrake.core.compiled import compiled
from mirdrake.worlds.clearance import Volume, place_outline

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

TOUCH = 1e-4
"""Distance at which two outlines touch [m]."""


def first_contacts(volume: Volume, poses: Array, other: Volume, other_poses: Array) -> Array:
    """Return when two moving volumes first touch in each step (n): the fraction of the step, inf without contact.

    Args:
        volume: volume of the first object.
        poses: x, y [m] and yaw [rad] of its frame (n, 3), at equal steps of time.
        other: volume of the second object.
        other_poses: its poses at the same times (n, 3).
    """
    result = np.full(len(poses), math.inf)
    pairs = [(a, b) for a in volume.slabs for b in other.slabs if a.low < b.high and b.low < a.high]
    good = np.asarray(np.isfinite(np.column_stack((poses, other_poses))).all(axis=1))
    if not pairs or not good.any():
        return result
    # Only samples between which the circles around both may meet are examined.
    reach = volume.reach + other.reach
    away = np.hypot(*(poses[:, :2] - other_poses[:, :2]).T)
    # The relative movement since the sample before; both objects may have met anywhere along it.
    step = np.hypot(*np.diff(poses[:, :2] - other_poses[:, :2], axis=0, prepend=(poses - other_poses)[:1, :2]).T)
    near = np.flatnonzero(good & (away - step <= reach))
    if not near.size:
        return result
    near = near[_may_touch(volume, poses, other, other_poses, near)]
    advance = _compiled()
    for row in near.tolist():
        before = max(row - 1, 0)
        # Without a valid sample before there is no movement to examine.
        if not good[before]:
            continue
        for a, b in pairs:
            share = advance(a.outline, poses[before], poses[row], b.outline, other_poses[before], other_poses[row])
            result[row] = min(result[row], share)
            if share == 0.0:  # no pair touches earlier
                break
    return result


def times_to_contact(
    volume: Volume, poses: Array, velocities: Array, other: Volume, other_poses: Array, other_velocities: Array
) -> Array:
    """Return the times until two volumes touch if both keep their velocities and do not turn (n) [s]; inf: never.

    Args:
        volume: volume of the first object.
        poses: x, y [m] and yaw [rad] of its frame (n, 3).
        velocities: its velocities in W (n, 2) [m/s].
        other: volume of the second object.
        other_poses: its poses (n, 3).
        other_velocities: its velocities (n, 2) [m/s].
    """
    result = np.full(len(poses), math.inf)
    pairs = [(a, b) for a in volume.slabs for b in other.slabs if a.low < b.high and b.low < a.high]
    relative = other_velocities - velocities
    reach = volume.reach + other.reach
    between = other_poses[:, :2] - poses[:, :2]
    away, speed = np.hypot(*between.T), np.hypot(*relative.T)
    # The circles around both meet only if the objects approach, and pass each other near enough.
    with np.errstate(invalid="ignore", divide="ignore"):
        # Distance at which the centres pass: cross product of distance and direction; NaN at equal velocities.
        aside = np.abs(between[:, 0] * relative[:, 1] - between[:, 1] * relative[:, 0]) / speed
    meets = (away <= reach) | (((between * relative).sum(axis=1) < 0.0) & (aside <= reach))
    good = np.isfinite(poses).all(axis=1) & np.isfinite(other_poses).all(axis=1)
    touch = compiled(time_to_touch, parts=_PARTS)
    for row in np.flatnonzero(meets & good).tolist():
        for a, b in pairs:
            first, second = np.empty_like(a.outline), np.empty_like(b.outline)
            _place_rows(a.outline, poses[row], first)
            _place_rows(b.outline, other_poses[row], second)
            result[row] = min(result[row], touch(first, second, relative[row, 0], relative[row, 1]))
    return result


def _may_touch(first_volume: Volume, poses: Array, other: Volume, other_poses: Array, rows: Ints) -> NDArray[np.bool_]:
    """Return at which rows the hulls of two volumes may have touched since the sample before."""
    before = np.maximum(rows - 1, 0)
    hulls: list[Any] = [
        shapely.polygons(place_outline(volume.outline, at[before]))
        for volume, at in ((first_volume, poses), (other, other_poses))
    ]
    change = (poses - other_poses)[rows] - (poses - other_poses)[before]
    fastest = np.hypot(change[:, 0], change[:, 1])
    # A corner moves at most by the turn, the shorter way round, times its distance from the origin of the frame.
    for volume, at in ((first_volume, poses), (other, other_poses)):
        turn = at[rows, 2] - at[before, 2]
        fastest += np.abs(turn - 2.0 * np.pi * np.round(turn / (2.0 * np.pi))) * volume.reach
    return np.asarray(~(shapely.distance(*hulls) > fastest + 2.0 * TOUCH))


def _compiled() -> Any:
    return compiled(advance_to_contact, parts=_PARTS)


# --- compiled -----------------------------------------------------------------------------------------------------


def _place_rows(outline: Array, pose: Array, out: Array) -> None:
    """Write the corners of an outline at a pose."""
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    for i in range(len(outline)):
        x, y = outline[i, 0], outline[i, 1]
        out[i, 0] = pose[0] + cosine * x - sine * y
        out[i, 1] = pose[1] + sine * x + cosine * y


def _point_to_edge(px: float, py: float, ax: float, ay: float, bx: float, by: float) -> float:
    """Return the distance of a point from a segment [m]."""
    dx, dy = bx - ax, by - ay
    square = dx * dx + dy * dy
    share = 0.0 if square == 0.0 else max(0.0, min(1.0, ((px - ax) * dx + (py - ay) * dy) / square))
    return math.hypot(px - ax - share * dx, py - ay - share * dy)


def _distance(a: Array, b: Array) -> float:
    """Return the distance of two convex polygons [m], 0 if they overlap: no edge of either separates them."""
    # Separating axis theorem: convex polygons are apart if an edge normal of one of them separates them.
    if not _separated(a, b) and not _separated(b, a):
        return 0.0
    best = math.inf
    for i in range(len(a)):
        for j in range(len(b)):
            best = min(best, _point_to_edge(a[i, 0], a[i, 1], b[j - 1, 0], b[j - 1, 1], b[j, 0], b[j, 1]))
            best = min(best, _point_to_edge(b[j, 0], b[j, 1], a[i - 1, 0], a[i - 1, 1], a[i, 0], a[i, 1]))
    return best


def _separated(a: Array, b: Array) -> bool:
    """Return whether an edge of polygon a separates it from polygon b."""
    for i in range(len(a)):
        ax, ay = a[i - 1, 0], a[i - 1, 1]
        # The normal need not have unit length, as only projections on it are compared.
        nx, ny = a[i, 1] - ay, ax - a[i, 0]
        low_a, high_a, low_b, high_b = math.inf, -math.inf, math.inf, -math.inf
        for k in range(len(a)):
            value = (a[k, 0] - ax) * nx + (a[k, 1] - ay) * ny
            low_a, high_a = min(low_a, value), max(high_a, value)
        for k in range(len(b)):
            value = (b[k, 0] - ax) * nx + (b[k, 1] - ay) * ny
            low_b, high_b = min(low_b, value), max(high_b, value)
        if low_b > high_a or high_b < low_a:
            return True
    return False


def advance_to_contact(a: Array, start_a: Array, end_a: Array, b: Array, start_b: Array, end_b: Array) -> float:
    """Return the share of a time step after which two outlines touch; inf if they do not.

    Args:
        a: corners of the first outline in its frame (k, 2) [m].
        start_a: its pose at the begin: x, y [m], yaw [rad].
        end_a: at the end.
        b: corners of the second outline.
        start_b: its pose at the begin.
        end_b: at the end.
    """
    # Radius about the origin of the frame: a turn by an angle moves no corner farther than angle times radius.
    radius_a, radius_b = 0.0, 0.0
    for i in range(len(a)):
        radius_a = max(radius_a, math.hypot(a[i, 0], a[i, 1]))
    for j in range(len(b)):
        radius_b = max(radius_b, math.hypot(b[j, 0], b[j, 1]))
    turn_a = end_a[2] - start_a[2]
    # The shorter way round, as headings are wrapped between samples.
    turn_a -= 2.0 * math.pi * math.floor(turn_a / (2.0 * math.pi) + 0.5)
    turn_b = end_b[2] - start_b[2]
    turn_b -= 2.0 * math.pi * math.floor(turn_b / (2.0 * math.pi) + 0.5)
    dx = end_a[0] - start_a[0] - end_b[0] + start_b[0]
    dy = end_a[1] - start_a[1] - end_b[1] + start_b[1]

    # Conservative advancement: no pair of points approaches faster, so that a step never passes a contact.
    fastest = math.hypot(dx, dy) + abs(turn_a) * radius_a + abs(turn_b) * radius_b
    first, second, pose = np.empty_like(a), np.empty_like(b), np.empty(3)
    share = 0.0
    while True:
        pose[0] = start_a[0] + share * (end_a[0] - start_a[0])
        pose[1] = start_a[1] + share * (end_a[1] - start_a[1])
        pose[2] = start_a[2] + share * turn_a
        _place_rows(a, pose, first)
        pose[0] = start_b[0] + share * (end_b[0] - start_b[0])
        pose[1] = start_b[1] + share * (end_b[1] - start_b[1])
        pose[2] = start_b[2] + share * turn_b
        _place_rows(b, pose, second)
        distance = _distance(first, second)
        # A tolerance, because the steps become ever shorter towards a contact and never reach it.
        if distance <= TOUCH:
            return share
        if share >= 1.0 or fastest <= 0.0:
            return math.inf
        share = min(1.0, share + distance / fastest)


def time_to_touch(a: Array, b: Array, vx: float, vy: float) -> float:
    """Return the time until polygon b, moving at (vx, vy) [m/s], touches polygon a [s]; 0 if they overlap, inf: never.

    The first contact of convex polygons is that of a corner of one with an edge of the other.
    """
    if _distance(a, b) <= 0.0:
        return 0.0
    best = math.inf
    for i in range(len(a)):
        for j in range(len(b)):
            best = min(best, _ray(b[j, 0], b[j, 1], vx, vy, a[i - 1, 0], a[i - 1, 1], a[i, 0], a[i, 1]))
            best = min(best, _ray(a[i, 0], a[i, 1], -vx, -vy, b[j - 1, 0], b[j - 1, 1], b[j, 0], b[j, 1]))
    return best


def _ray(px: float, py: float, vx: float, vy: float, ax: float, ay: float, bx: float, by: float) -> float:
    """Return the time at which a moving point meets a segment [s]; inf: never."""
    # Intersection of the line of motion with the line of the edge, by cross products.
    ex, ey = bx - ax, by - ay
    across = vx * ey - vy * ex
    if across == 0.0:
        return math.inf
    time = ((ax - px) * ey - (ay - py) * ex) / across
    share = ((ax - px) * vy - (ay - py) * vx) / across
    return time if time >= 0.0 and -1e-12 <= share <= 1.0 + 1e-12 else math.inf


_PARTS = (_place_rows, _point_to_edge, _distance, _separated, _ray)
