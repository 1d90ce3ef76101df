"""One time step of a pedestrian, in the coordinates of its path: along it, and to its left."""

import math
from typing import Any

from mirdrake.actors.behaviours import walk
from mirdrake.actors.behaviours.walk import arrives_within, repulsion
from mirdrake.actors.lanes import LaneTable, lane_pose
from mirdrake.actors.motion import set_pose
from mirdrake.core.compiled import Records
from mirdrake.worlds.pieces import Array

_FASTEST = 1.3  # largest speed over the desired one
_KERB = 0.3  # [m] from a waiting pedestrian to the road
_ASIDE = 1.0  # [m] beside the path that a vehicle may pass
_SLOW = 0.5  # [m/s] speed below which vehicles are not a danger


def step_walker(
    t: LaneTable,
    members: Records,
    numbers: Array,
    shape: Array,
    i: int,
    now: Records,
    vehicles: Array,
    dt: float,
    row: Any,
) -> None:
    """Write the next state of a pedestrian.

    The force towards its desired velocity and its path is critically damped.

    Args:
        t: lanes.
        members: :class:`mirdrake.actors.step.Member` (n).
        numbers: parameters of the pedestrian.
        shape: front, rear and half of the width of the actors, then of the vehicles (n + m, 3) [m].
        i: number of the pedestrian.
        now: states of all actors (n).
        vehicles: x, y, yaw, vx, vy of the vehicles (m, 5).
        dt: time step [s].
        row: its next state; written.
    """
    me, tau, n = now[i], numbers[walk.RELAXATION], len(now)
    lane, speed, aside, offset = int(me.lane), me.v, me.aim, me.offset
    row.gap, row.a = math.inf, 0.0
    if row.started == 0.0:
        return
    desired = 0.0 if row.held > 0.0 else row.desired

    # At the kerb it waits until the gap to every vehicle is long enough.
    begin, end = numbers[walk.BEGIN], numbers[walk.END]
    row.wait = 0.0
    # The speed decays with the time constant tau, so that stopping takes speed * tau; later it could not stop.
    rest = begin - me.s
    if end > begin and 0.0 <= rest <= speed * tau + _KERB:
        x, y, heading, _ = lane_pose(t, lane, 0.5 * (begin + end))
        half = 0.5 * (end - begin) + _ASIDE
        for j in range(n + len(vehicles)):
            # Other pedestrians are not a danger; vehicles at standstill have no arrival time.
            if j < n and members[j].law != walk.LAW and math.hypot(now[j].vx, now[j].vy) > _SLOW:
                other = now[j]
                if arrives_within(x, y, heading, half, other.x, other.y, other.vx, other.vy, numbers[walk.CRITICAL]):
                    row.wait = 1.0
            elif j >= n and math.hypot(vehicles[j - n, 3], vehicles[j - n, 4]) > _SLOW:
                car = vehicles[j - n]
                if arrives_within(x, y, heading, half, car[0], car[1], car[3], car[4], numbers[walk.CRITICAL]):
                    row.wait = 1.0
    if row.wait > 0.0:
        desired = 0.0

    # Forces along the path and to its left.
    _, _, direction, _ = lane_pose(t, lane, me.s)
    cosine, sine = math.cos(direction), math.sin(direction)
    # Poles of the lateral motion: s² + s/tau + 1/(4 tau²) = (s + 1/(2 tau))², critically damped.
    along, across = (desired - speed) / tau, -aside / tau - offset / (4.0 * tau * tau)
    for j in range(n):
        if j != i and members[j].law == walk.LAW:
            # Pedestrians count as circles, whatever their heading.
            contact = max(shape[i, 0], shape[i, 2]) + max(shape[j, 0], shape[j, 2])
            fx, fy = repulsion(numbers, me.x - now[j].x, me.y - now[j].y, contact)
            along += fx * cosine + fy * sine
            across += fy * cosine - fx * sine

    # Semi-implicit Euler: the new speed moves it. It does not walk backwards, nor is it pushed beyond a run.
    row.v = max(0.0, min(speed + along * dt, _FASTEST * row.desired))
    row.a = (row.v - speed) / dt
    row.aim = aside + across * dt
    row.s = min(me.s + row.v * dt, t.lanes[lane].length)
    row.offset = offset + row.aim * dt
    # Without a lane change in progress, `set_pose` takes the offset as it is.
    row.begin, row.span = row.offset, 0.0
    if row.s >= t.lanes[lane].length:
        row.v, row.aim = 0.0, 0.0
    set_pose(t, row)
    # `set_pose` knows only the speed along the path; the lateral one is added in W.
    row.vx -= row.aim * math.sin(row.yaw)
    row.vy += row.aim * math.cos(row.yaw)
    # The body turns to its velocity; the lower bound keeps it from spinning at standstill.
    row.yaw += math.atan2(row.aim, max(row.v, 0.5))
    row.wz = 0.0


PARTS = (step_walker, *walk.PARTS)
"""Compiled functions of this module."""
