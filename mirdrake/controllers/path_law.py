"""Law of the path tracker, for Python and for machine code; equations in :mod:`mirdrake.controllers.path_tracking`.

A centre line is a table of rows x [m], y [m], yaw [rad], curvature [1/m] with constant spacing. A drivable line is one
of rows offset [m], slope [1], curvature [1/m], speed [m/s]. Tables are lists of rows, or arrays.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mirdrake.core.maths import wrap_angle

Table = Sequence[Sequence[float]] | NDArray[np.float64]
"""Rows of numbers; a list of lists is fastest in Python."""

SETTLED, STEPS = 1e-6, 20
"""Newton step below which a projection has settled [m], and the most steps."""

_APPROACH = 0.5  # share of d times that curvature that the slope of the approach may have
_STEEPEST = 0.7  # tangent of the steepest angle at which the line is approached
_STEEPEST_COURSE = 1.2  # course errors beyond this count as this [rad]
_NEAREST = 0.2  # smallest 1 - kappa e that counts: 80 % of the way to the centre of the curve
_LARGEST_SLIP = 0.2  # measured side slip beyond this counts as this [rad]
_TURN_MARGIN = 1.3  # how much more than the lateral limit a correction may take before the car slows down
_BRAKE_MARGIN = 1.25  # how much faster than planned the speed command may fall


class Place(NamedTuple):
    """Position and direction in the frame of the centre line.

    Attributes:
        s: arc length of the nearest point [m]; in [0, length) on a closed track, may lie outside an open one.
        lateral: offset to the left [m].
        yaw: direction of the centre line there [rad].
        curvature: of the centre line there [1/m].
    """

    s: float
    lateral: float
    yaw: float
    curvature: float


class PathNumbers(NamedTuple):
    """Numbers of a centre line.

    Attributes:
        length: [m]
        spacing: of its table [m].
        closed: whether it is closed.
        last: index of the last interval of its table.
    """

    length: float
    spacing: float
    closed: bool
    last: int


class TrackerNumbers(NamedTuple):
    """Numbers of the vehicle and its limits.

    Attributes:
        wheelbase: [m]
        limit: largest bicycle angle [rad].
        rate: its largest rate [rad/s].
        lateral: largest lateral acceleration [m/s²].
        acceleration: largest acceleration [m/s²].
        deceleration: largest deceleration [m/s²].
        period: time between two steps [s].
    """

    wheelbase: float
    limit: float
    rate: float
    lateral: float
    acceleration: float
    deceleration: float
    period: float


class Motion(NamedTuple):
    """Motion of the rear axle centre.

    Attributes:
        x: [m]
        y: [m]
        yaw: [rad]
        vx: velocity ahead [m/s].
        vy: velocity to the left [m/s].
        yaw_rate: [rad/s]
    """

    x: float
    y: float
    yaw: float
    vx: float
    vy: float
    yaw_rate: float


def project(path: PathNumbers, table: Table, x: float, y: float, near: float) -> tuple[bool, Place]:
    """Return the nearest point of the centre line, by Newton's method from a nearby one, and whether it has settled.

    Args:
        path: numbers of the centre line.
        table: its table.
        x: position [m].
        y: position [m].
        near: arc length to start from [m].
    """
    s, h, place = near, path.spacing, Place(near, 0.0, 0.0, 0.0)
    for _ in range(STEPS):
        # Newton's iterate may leave a closed track at either end.
        if path.closed:
            s %= path.length
        i = min(max(int(s / h), 0), path.last)
        curvature, along = table[i][3], s - i * h
        turn = curvature * along
        # Each interval is an arc of constant curvature; chord to third order in its angle.
        middle = table[i][2] + 0.5 * turn
        chord = along * (1.0 - turn * turn / 24.0)
        dx, dy = x - table[i][0] - chord * math.cos(middle), y - table[i][1] - chord * math.sin(middle)
        yaw = middle + 0.5 * turn
        cosine, sine = math.cos(yaw), math.sin(yaw)
        lateral = dy * cosine - dx * sine
        # Derivative of the foot point, 1 - κ e; bounded near the centre of the curve, where it vanishes.
        step = (dx * cosine + dy * sine) / max(1.0 - curvature * lateral, _NEAREST)
        place = Place(s, lateral, yaw, curvature)
        if -SETTLED < step < SETTLED:
            return True, place
        s += step
    return False, place


def nearest_point(path: PathNumbers, table: Table, x: float, y: float) -> float:
    """Return the arc length [m] of the point of the table that is nearest to a position [m]."""
    best, nearest = 0, math.inf
    for i in range(path.last + 1):
        dx, dy = x - table[i][0], y - table[i][1]
        if dx * dx + dy * dy < nearest:
            best, nearest = i, dx * dx + dy * dy
    return best * path.spacing


def line_place(path: PathNumbers, line: Table, s: float) -> tuple[int, float]:
    """Return the interval of a drivable line at an arc length [m], and the place in it from 0 to 1."""
    if path.closed:
        s %= path.length
    position = s / path.spacing
    i = min(max(int(position), 0), len(line) - 2)
    return i, min(max(position - i, 0.0), 1.0)


def line_value(line: Table, i: int, part: float, column: int) -> float:
    """Return a column of a drivable line between two rows."""
    return line[i][column] + part * (line[i + 1][column] - line[i][column])


def steering_step(
    path: PathNumbers, line: Table, gains: Any, vehicle: TrackerNumbers, place: Place, course: float, speed: float
) -> float:
    """Return the bicycle angle [rad] that leads the rear axle centre to the drivable line.

    The steering rate limits the curvature that feedback can reach over the distance d to rate d/(L v), and the slope to
    d times that. With a larger demand the steering would lag, and finally oscillate. Both parts of the feedback are
    therefore limited, one inside the other.

    Args:
        path: numbers of the centre line.
        line: the line to drive.
        gains: :class:`mirdrake.controllers.path_tracking.PathGains`.
        vehicle: numbers of the vehicle.
        place: where the rear axle centre is, or will be when the steering acts.
        course: direction of its velocity (its yaw when it rolls without slip) [rad].
        speed: forward speed [m/s].
    """
    # Second-order approach over the distance d with the damping ratio of the gains, as in the head of path_tracking.
    i, part = line_place(path, line, place.s)
    offset, slope, curvature = line_value(line, i, part, 0), line_value(line, i, part, 1), line_value(line, i, part, 2)
    distance = max(gains.convergence_distance, speed * gains.convergence_time)
    k2 = 2.0 * gains.damping / distance
    largest_change = vehicle.rate * distance / (vehicle.wheelbase * max(speed, 0.1))
    steepest = min(_STEEPEST, _APPROACH * largest_change * distance)

    # Far from the direction of the track there is no line to keep: turn back, up to full lock.
    theta = min(max(wrap_angle(course - place.yaw), -_STEEPEST_COURSE), _STEEPEST_COURSE)
    largest_change += max(0.0, abs(theta) - 0.5) * 4.0 / vehicle.wheelbase
    cos, tan = max(math.cos(theta), 0.7), math.tan(theta)
    # Kinematics over the arc length s of the track: z = e' = (1 - κ e) tan θ; u is the demanded z'.
    lever = max(1.0 - place.curvature * place.lateral, _NEAREST)
    z = lever * tan
    approach = min(max((place.lateral - offset) / (distance * distance * k2), -steepest), steepest)
    u = curvature - place.curvature - min(max(k2 * (z - slope + approach), -largest_change), largest_change)
    turning = cos / lever * (place.curvature + cos * cos / lever * (u + place.curvature * z * tan))
    # Bicycle angle of this curvature, and the understeer that the tyres add at speed.
    steering: float = math.atan(vehicle.wheelbase * turning) + gains.understeer_gradient * speed * speed * turning
    return min(max(steering, -vehicle.limit), vehicle.limit)


def speed_step(
    path: PathNumbers,
    line: Table,
    gains: Any,
    vehicle: TrackerNumbers,
    previous: float,
    place: Place,
    steering: float,
) -> float:
    """Return the speed command [m/s]: the profile of the line, approached with the allowed acceleration.

    Args:
        path: numbers of the centre line.
        line: the line to drive.
        gains: gains, with the set-point.
        vehicle: numbers of the vehicle.
        previous: last speed command [m/s].
        place: where the rear axle centre is, or will be.
        steering: bicycle angle that is commanded [rad]; one much tighter than planned slows down as well.
    """
    i, part = line_place(path, line, place.s)
    # A correction that is tighter than planned must not exceed the lateral limit.
    target: float = min(line_value(line, i, part, 3), gains.speed)
    turning = abs(math.tan(steering) / vehicle.wheelbase)
    if turning * target * target > _TURN_MARGIN * vehicle.lateral:
        target = math.sqrt(_TURN_MARGIN * vehicle.lateral / turning)
    # Planned speeds fall with the limit; the margin lets the command catch up with them.
    lowest = previous - _BRAKE_MARGIN * vehicle.deceleration * vehicle.period
    return max(min(target, previous + vehicle.acceleration * vehicle.period), lowest, 0.0)


def tracker_step(
    path: PathNumbers,
    table: Table,
    line: Table,
    gains: Any,
    vehicle: TrackerNumbers,
    place: Place,
    motion: Motion,
    previous: float,
    slip: float,
    started: bool,
) -> tuple[float, float, float]:
    """Return the commands of speed [m/s] and steering [rad], and the filtered side slip [rad].

    The course is the yaw plus the side slip. On elastic tyres the rear axle slips to the other side first when the car
    is steered, so that feedback of the present side slip makes the loop oscillate; only its slow part counts, that of a
    bend. The time constant of the filter is the time of convergence.

    Args:
        path: numbers of the centre line.
        table: its table.
        line: the line to drive.
        gains: :class:`mirdrake.controllers.path_tracking.PathGains`.
        vehicle: numbers of the vehicle.
        place: where the rear axle centre is.
        motion: its motion.
        previous: last speed command [m/s].
        slip: last filtered side slip [rad].
        started: whether there is a last one; the speed command starts from the speed that the vehicle has.
    """
    # Side slip means nothing at a crawl.
    speed = max(motion.vx, 0.0)
    measured = min(max(math.atan2(motion.vy, max(motion.vx, 1.0)), -_LARGEST_SLIP), _LARGEST_SLIP)
    lag = max(gains.convergence_time, gains.convergence_distance / max(speed, 1.0))
    slip = slip + (measured - slip) * vehicle.period / (lag + vehicle.period) if started else measured
    course = motion.yaw + slip

    # Where the vehicle will be when the steering acts.
    way, turn = speed * gains.preview_time, motion.yaw_rate * gains.preview_time
    middle = course + 0.5 * turn
    x, y = motion.x + way * math.cos(middle), motion.y + way * math.sin(middle)
    settled, ahead = project(path, table, x, y, place.s + way)
    # Near the centre of a curve the projection does not settle; the present place is good enough.
    if not settled:
        ahead = place
    steering = steering_step(path, line, gains, vehicle, ahead, course + turn, speed)
    if not started:
        return min(speed, gains.speed), steering, slip
    return speed_step(path, line, gains, vehicle, previous, ahead, steering), steering, slip


PATH_PARTS = (project, nearest_point, line_place, line_value, steering_step, speed_step, tracker_step)
"""Functions of this module, for :func:`mirdrake.core.compiled.compiled`."""
