"""Motion of actors: the state of each in one row of numbers, and poses on lanes.

An actor follows its lane, or is at an offset from it that changes over a distance. Its frame A, at the rear axle of a
vehicle, moves along its x axis as that of a kinematic bicycle (R. Rajamani, Vehicle Dynamics and Control, 2.2), so that
it cannot move sideways or turn at standstill.
"""

import math
from typing import Final

from mirdrake.actors.lanes import LaneTable, lane_pose
from mirdrake.worlds.pieces import Array

X: Final = 0
Y: Final = 1
YAW: Final = 2
VX: Final = 3
VY: Final = 4
WZ: Final = 5
"""Columns: pose of A in W [m, m, rad], velocity of A [m/s, m/s], yaw rate [rad/s]."""
LANE: Final = 6
S: Final = 7
V: Final = 8
A: Final = 9
"""Columns: number of the lane, station [m], speed along its path [m/s], its acceleration until now [m/s^2]."""
FROM: Final = 10
OFFSET: Final = 11
DONE: Final = 12
SPAN: Final = 13
OLD: Final = 14
"""Columns of a lane change: offset at its begin, wanted offset [m]; distance since the begin, its length [m], 0: no
change; number of the lane that it leaves, -1: none."""
STARTED: Final = 15
STEP: Final = 16
SIDE: Final = 17
WANTED: Final = 18
RAMP: Final = 19
HELD: Final = 20
"""Columns: whether it moves; number of the next step; signed distance of the subject beyond the gate of its trigger
[m]; wanted speed [m/s]; rate of the present change of speed, 0: none [m/s^2]; 1: it stands until `go`."""
GAP: Final = 21
LIMIT: Final = 22
"""Columns: distance to the object ahead [m]; 1: its braking is limited."""
AIM: Final = 23
WAIT: Final = 24
"""Columns of a walker: its speed across its lane, + left [m/s]; 1: it waits at a crossing."""
COLUMNS: Final = 25


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


def set_pose(t: LaneTable, row: Array) -> float:
    """Write pose and velocity of an actor on a lane; return its change of station per metre of its path [-].

    With the offset d, its derivative d' and the curvature k of the lane, heading and path follow the Frenet equations
    (M. Werling et al., ICRA 2010, appendix): tan of the heading error p is d' / (1 - k d), ds = cos p / (1 - k d) per
    metre of the path, whose curvature is ((d'' + k d' tan p) cos² p / (1 - k d) + k) cos p / (1 - k d).
    """
    x, y, yaw, k = lane_pose(t, int(row[LANE]), row[S])
    d, slope, bend = lateral(row[FROM], row[OFFSET], row[DONE], row[SPAN])

    # 1 - k d, limited as it vanishes at the centre of curvature; the station then runs at most ten times faster.
    shorter = max(1.0 - k * d, 0.1)
    tangent = slope / shorter
    error = math.atan(tangent)
    cosine = math.cos(error)
    curvature = ((bend + k * slope * tangent) * cosine * cosine / shorter + k) * cosine / shorter
    row[X] = x - d * math.sin(yaw)
    row[Y] = y + d * math.cos(yaw)
    row[YAW] = yaw + error
    row[VX] = row[V] * math.cos(row[YAW])
    row[VY] = row[V] * math.sin(row[YAW])
    row[WZ] = row[V] * curvature
    return cosine / shorter


def approach(speed: float, wanted: float, rate: float, dt: float) -> tuple[float, float]:
    """Return the speed [m/s] and the distance [m] after a change of speed at a rate until it is reached; exact."""
    change = wanted - speed
    needed = abs(change) / rate
    # The wanted speed is not reached within this step; otherwise the rest of the step is driven at it.
    if needed >= dt:
        after = speed + math.copysign(rate, change) * dt
        return after, 0.5 * (speed + after) * dt
    return wanted, 0.5 * (speed + wanted) * needed + wanted * (dt - needed)


def accelerate(speed: float, a: float, dt: float) -> tuple[float, float]:
    """Return the speed [m/s] and the distance [m] after a constant acceleration; it ends at standstill."""
    after = speed + a * dt
    if after >= 0.0:
        return after, 0.5 * (speed + after) * dt
    return 0.0, -0.5 * speed * speed / a


PARTS = (lateral, span_of, set_pose, approach, accelerate)
"""Compiled functions of this module."""
