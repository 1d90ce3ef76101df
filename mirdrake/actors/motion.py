"""Motion of actors: the state of each as a record, and poses on lanes.

An actor follows its lane, or is at an offset from it that changes over a distance. Its frame A, at the rear axle of a
vehicle, moves along its x axis as that of a kinematic bicycle (R. Rajamani, Vehicle Dynamics and Control, 2.2), so that
it cannot move sideways or turn at standstill.
"""

import math
from typing import Any, Final, NamedTuple

from mirdrake.actors.lanes import LaneTable, lane_pose
from mirdrake.core.compiled import record_type


class State(NamedTuple):
    """State of an actor."""

    x: float
    """position of A in W [m]"""
    y: float
    """[m]"""
    yaw: float
    """of A in W [rad]"""
    vx: float
    """velocity of A in W [m/s]"""
    vy: float
    """[m/s]"""
    wz: float
    """yaw rate [rad/s]"""
    lane: float
    """number of its lane"""
    s: float
    """station of A on it [m]"""
    v: float
    """speed along its path [m/s]"""
    a: float
    """acceleration in the last time step [m/s²]"""
    begin: float
    """offset at the begin of a lane change [m]"""
    offset: float
    """desired offset [m]"""
    done: float
    """distance since the begin of a lane change [m]"""
    span: float
    """its length, 0: no change [m]"""
    old: float
    """number of the lane that it leaves, -1: none"""
    started: float
    """1: it moves"""
    step: float
    """number of its next step of the scenario"""
    side: float
    """signed distance of the subject beyond the gate of its trigger [m]"""
    desired: float
    """desired speed [m/s]"""
    ramp: float
    """rate of the present change of speed, 0: none [m/s²]"""
    held: float
    """1: it waits until `go`"""
    gap: float
    """distance to the object ahead [m]"""
    limit: float
    """1: its braking is limited"""
    aim: float
    """of a walker: speed across its lane, + left [m/s]"""
    wait: float
    """of a walker: 1: it waits at a crossing"""


STATE: Final = record_type(State)
"""Type of the records of :class:`State`: floats only, so that a vector of states is one of records as well."""


def lateral(begin: float, end: float, done: float, span: float) -> tuple[float, float, float]:
    """Return the offset [m] of a lane change and its first two derivatives by the distance [-, 1/m].

    The offset is a polynomial of degree five; slope and curvature are zero at both ends.
    """
    if span <= 0.0 or done >= span:
        return end, 0.0, 0.0
    u, change = done / span, end - begin
    value = begin + change * u * u * u * (10.0 - 15.0 * u + 6.0 * u * u)
    slope = change / span * 30.0 * u * u * (1.0 - u) ** 2
    bend = change / (span * span) * 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u)
    return value, slope, bend


def span_of(change: float, distance: float, min_radius: float) -> float:
    """Return the length of a lane change [m]: at least so that its smallest radius is allowed.

    The largest second derivative of the polynomial of degree five is 10/sqrt(3) times change / span².
    """
    return max(distance, math.sqrt(10.0 / math.sqrt(3.0) * abs(change) * min_radius), 1e-3)


def set_pose(t: LaneTable, row: Any) -> float:
    """Write pose and velocity of an actor on a lane; return its change of station per metre of its path [-].

    With the offset d, its derivative d' and the curvature k of the lane, heading and path follow the Frenet equations
    (M. Werling et al., ICRA 2010, appendix): tan of the heading error p is d' / (1 - k d), ds = cos p / (1 - k d) per
    metre of the path, whose curvature is ((d'' + k d' tan p) cos² p / (1 - k d) + k) cos p / (1 - k d).
    """
    x, y, yaw, k = lane_pose(t, int(row.lane), row.s)
    d, slope, bend = lateral(row.begin, row.offset, row.done, row.span)

    # 1 - k d, limited as it vanishes at the centre of curvature; the station then runs at most ten times faster.
    shorter = max(1.0 - k * d, 0.1)
    tangent = slope / shorter
    error = math.atan(tangent)
    cosine = math.cos(error)
    curvature = ((bend + k * slope * tangent) * cosine * cosine / shorter + k) * cosine / shorter
    row.x = x - d * math.sin(yaw)
    row.y = y + d * math.cos(yaw)
    row.yaw = yaw + error
    row.vx = row.v * math.cos(row.yaw)
    row.vy = row.v * math.sin(row.yaw)
    row.wz = row.v * curvature
    return cosine / shorter


def approach(speed: float, desired: float, rate: float, dt: float) -> tuple[float, float]:
    """Return the speed [m/s] and the distance [m] after a change of speed at a rate until it is reached; exact."""
    change = desired - speed
    needed = abs(change) / rate
    # The desired speed is not reached within this step; otherwise the rest of the step is driven at it.
    if needed >= dt:
        after = speed + math.copysign(rate, change) * dt
        return after, 0.5 * (speed + after) * dt
    return desired, 0.5 * (speed + desired) * needed + desired * (dt - needed)


def accelerate(speed: float, a: float, dt: float) -> tuple[float, float]:
    """Return the speed [m/s] and the distance [m] after a constant acceleration; it ends at standstill."""
    after = speed + a * dt
    if after >= 0.0:
        return after, 0.5 * (speed + after) * dt
    return 0.0, -0.5 * speed * speed / a


PARTS = (lateral, span_of, set_pose, approach, accelerate)
"""Compiled functions of this module."""
