"""One time step of all actors, from the states of all at its begin, so that their order has no effect."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from mirdrake.actors import lanes, laws, motion, occupancy, triggers, walkers
from mirdrake.actors.behaviours import idm_mobil, walk
from mirdrake.actors.behaviours.base import LIMIT as BRAKING
from mirdrake.actors.lanes import Ints, LaneTable, project
from mirdrake.actors.laws import acceleration, at_end, sees, stopping_distance
from mirdrake.actors.motion import (
    DONE,
    GAP,
    HELD,
    LANE,
    LIMIT,
    OFFSET,
    OLD,
    RAMP,
    SIDE,
    SPAN,
    STARTED,
    STEP,
    WANTED,
    A,
    S,
    V,
    accelerate,
    approach,
    lateral,
    set_pose,
)
from mirdrake.actors.occupancy import ahead, behind, fill, fill_lines
from mirdrake.actors.triggers import act, change_lane, is_due
from mirdrake.actors.walkers import step_walker
from mirdrake.core.compiled import compiled
from mirdrake.worlds.pieces import Array

LOOK = 300.0
"""Distance that actors look ahead [m]."""

DECISION = 10
"""Time steps between two decisions of an actor about its lane: 0.2 s."""


class Crew(NamedTuple):
    """Everything about the actors that does not change, in the order of their names."""

    own: Ints
    """1: the lane is the path of a single actor (l)"""
    shape: Array
    """front, rear and half of the width of the actors, then of the vehicles (n + m, 3) [m]"""
    law: Ints
    """law of each actor (n)"""
    numbers: Array
    """parameters of the behaviours (n, 12)"""
    speed: Array
    """speed that each wants at the start (n) [m/s]"""
    min_radius: Array
    """(n) [m]"""
    steps: Array
    """steps of all scenarios (k, columns)"""
    first_step: Ints
    """first step of each actor; the last entry is k (n + 1)"""
    stops: Ints
    """lane and light of each stop line (q, 2)"""
    places: Array
    """stations of the stop lines (q) [m]"""
    programmes: Array
    """durations of green, amber, red and the offset of each light (p, 4) [s]"""


def step(t: LaneTable, crew: Crew, now: Array, vehicles: Array, time: float, dt: float, after: Array) -> None:
    """Write the states of all actors after a time step.

    Args:
        t: lanes.
        crew: the actors.
        now: states (n, columns).
        vehicles: x, y, yaw, vx, vy of the vehicles (m, 5) [m, rad, m/s].
        time: time of `now` since the start [s].
        dt: time step [s].
        after: states after the step; written.
    """
    n = len(now)
    # Arrays of one size for compiled code, with room for all that can occur: two lanes per actor, all paths under each
    # actor, all lanes under each actor on a path and under each vehicle, and the stop lines.
    paths = crew.own.sum()
    most = 2 * n + n * paths + (paths + len(vehicles)) * len(crew.own) + len(crew.places)
    on, owners, rows = np.empty(most, np.int64), np.empty(most, np.int64), np.empty((most, occupancy.WIDE))
    count = fill(t, crew.own, crew.shape, now, vehicles, on, owners, rows)
    count = fill_lines(crew.stops, crew.places, crew.programmes, time, on, owners, rows, count)

    # Actions first: a step that fires now already acts on the motion of this time step.
    after[:] = now
    for i in range(n):
        number = crew.first_step[i] + int(now[i, STEP])
        if number < crew.first_step[i + 1] and is_due(crew.steps[number], i, now, vehicles, time, after[i]):
            after[i, STEP] += 1.0
            # Not a number compares as false: the next gate needs one step to learn its side before it can fire.
            after[i, SIDE] = math.nan
            act(t, crew.steps[number], now[i], after[i], crew.speed[i], crew.min_radius[i])

    # Lane changes before motions, because they decide on which lane an actor then looks ahead.
    change_lanes(t, crew, now, time, dt, on, owners, rows, count, after)
    for i in range(n):
        if crew.law[i] == walk.LAW:
            step_walker(t, crew.law, crew.numbers[i], crew.shape, i, now, vehicles, dt, after[i])
        else:
            move(t, crew, i, now[i], dt, on, owners, rows, count, after[i])


def move(
    t: LaneTable, crew: Crew, i: int, now: Array, dt: float, on: Ints, owners: Ints, rows: Array, count: int, row: Array
) -> None:
    """Write the motion of one actor.

    Args:
        t: lanes.
        crew: the actors.
        i: number of the actor.
        now: its state.
        dt: time step [s].
        on: objects on lanes, see :func:`mirdrake.actors.occupancy.fill`, as are the next three.
        owners: see `on`.
        rows: see `on`.
        count: see `on`.
        row: its next state, with the actions that begin now; written.
    """
    law, numbers, speed, lane = crew.law[i], crew.numbers[i], now[V], int(row[LANE])
    front, rear, half_width = crew.shape[i, 0], crew.shape[i, 1], crew.shape[i, 2]
    # Frame A is at the rear axle; objects on lanes are described by their middle and half of their length.
    middle, half = row[S] + 0.5 * (front - rear), 0.5 * (front + rear)
    d, _, _ = lateral(row[motion.FROM], row[OFFSET], row[DONE], row[SPAN])
    stop = stopping_distance(law, numbers, speed)

    # The object ahead; during a lane change on both lanes.
    gap, other = math.inf, 0.0
    gap, other, _ = ahead(t, lane, middle, half, d - half_width, d + half_width, i, LOOK, stop, on, owners, rows, count)
    if row[OLD] >= 0.0 and row[DONE] < row[SPAN]:
        s, d_old = project(t, int(row[OLD]), now[motion.X], now[motion.Y])
        gap_old, other_old, _ = ahead(
            t, int(row[OLD]), s + 0.5 * (front - rear), half, d_old - half_width, d_old + half_width, i, LOOK, stop,
            on, owners, rows, count,
        )  # fmt: skip
        if gap_old < gap:
            gap, other = gap_old, other_old
    row[GAP] = gap

    # Speed and distance: a change of speed by a scenario, or the law of the behaviour.
    wanted = 0.0 if row[HELD] > 0.0 else row[WANTED]
    row[LIMIT] = 0.0
    # Not started yet; otherwise a rate set by a scenario takes precedence over the law, without regard to gaps.
    if row[STARTED] == 0.0:
        row[V], distance = 0.0, 0.0
    elif row[RAMP] > 0.0:
        row[V], distance = approach(speed, wanted, row[RAMP], dt)
        # While it is held the rate stays, so that the law of the behaviour does not take over at standstill.
        if row[V] == wanted and row[HELD] == 0.0:
            row[RAMP] = 0.0
    else:
        a = acceleration(law, numbers, speed, wanted, gap, other, dt)
        # A dead end is an obstacle; laws that ignore others must stop there as well.
        if t.closed[lane] == 0 and t.successors[lane, 0] < 0:
            a = min(a, at_end(law, numbers, speed, wanted, t.length[lane] - row[S]))
        # Recorded as `braking_limit`: the law asked for a harder braking than the actor is capable of.
        if a < -numbers[BRAKING]:
            a = -numbers[BRAKING]
            row[LIMIT] = 1.0
        row[V], distance = accelerate(speed, a, dt)
    row[A] = (row[V] - speed) / dt

    # The new place: the change of station per metre of path is the mean of that at both ends.
    begin, done = row[S], row[DONE]
    rate = set_pose(t, row)
    for attempt in range(2):
        row[S] = begin + distance * rate
        row[DONE] = min(done + distance * rate, row[SPAN])
        if attempt == 0:
            rate = 0.5 * (rate + set_pose(t, row))

    # The lane change is complete: the actor occupies only its new lane from now on.
    if row[SPAN] > 0.0 and row[DONE] >= row[SPAN]:
        row[SPAN], row[DONE], row[OLD] = 0.0, 0.0, -1.0
    # More than one lane may end within a step, because lanes of networks can be shorter than it.
    while row[S] >= t.length[lane]:
        following = t.successors[lane, 0]
        if following < 0:
            row[S] = t.length[lane]
            if row[V] > 0.0:
                row[V] = 0.0
            break
        row[S] -= t.length[lane]
        lane = following
        row[LANE] = lane

    # Once more: lane and station may have changed since the last call, and WZ and the velocity depend on row[V].
    set_pose(t, row)


def change_lanes(
    t: LaneTable,
    crew: Crew,
    now: Array,
    time: float,
    dt: float,
    on: Ints,
    owners: Ints,
    rows: Array,
    count: int,
    after: Array,
) -> None:
    """Begin the lane changes of actors that decide on them; of two that want the same gap only the first one changes.

    Args:
        t: lanes.
        crew: the actors.
        now: states of the actors (n, columns).
        time: time of `now` since the start [s].
        dt: time step [s].
        on: objects on lanes, as are the next three.
        owners: see `on`.
        rows: see `on`.
        count: see `on`.
        after: next states; changed.
    """
    n = len(now)
    taken_lane, taken_s = np.full(n, -1, np.int64), np.zeros(n)
    # The rounded number of the time step; truncation would skip or repeat one for times just below a multiple.
    number = math.floor(time / dt + 0.5)
    for i in range(n):
        if (number + i) % DECISION != 0:  # each decides at its own time
            continue
        # No decision during a lane change, whether an earlier one or one that a scenario begins in this step.
        if crew.law[i] != idm_mobil.LAW or now[i, SPAN] > 0.0 or after[i, SPAN] > 0.0 or now[i, STARTED] == 0.0:
            continue
        # The left side is evaluated first and wins a tie, because the right one must be better.
        best, left = 0.0, False
        for side in range(2):
            gain = advantage(t, crew, i, now, side == 0, dt, on, owners, rows, count)
            if gain > best:
                best, left = gain, side == 0
        if best <= 0.0:
            continue
        lane = int(now[i, LANE])
        other = t.left[lane] if left else t.right[lane]
        s, _ = project(t, other, now[i, motion.X], now[i, motion.Y])

        # Decisions use the states at the begin of the step, in which two actors can see the same gap as free.
        room = 2.0 * now[i, V] + crew.shape[i, 0] + crew.shape[i, 1] + 10.0
        free = True
        for j in range(i):
            if taken_lane[j] == other and abs(lanes.wrapped(taken_s[j] - s, t.length[other])) < room:
                free = False
        if free:
            taken_lane[i], taken_s[i] = other, s
            distance = crew.numbers[i, idm_mobil.TIME] * now[i, V]
            change_lane(t, now[i], after[i], left, distance, crew.min_radius[i])


def advantage(
    t: LaneTable, crew: Crew, i: int, now: Array, left: bool, dt: float, on: Ints, owners: Ints, rows: Array, count: int
) -> float:
    """Return the advantage of a lane change beyond the threshold [m/s^2]; -inf if it is not possible.

    Followers that are vehicles or have no law that depends on gaps are taken for actors with the same parameters.

    Args:
        t: lanes.
        crew: the actors.
        i: number of the actor.
        now: states of the actors (n, columns).
        left: the side.
        dt: time step [s].
        on: objects on lanes, as are the next three.
        owners: see `on`.
        rows: see `on`.
        count: see `on`.
    """
    lane, speed, numbers = int(now[i, LANE]), now[i, V], crew.numbers[i]
    other = t.left[lane] if left else t.right[lane]
    if other < 0:
        return -math.inf
    front, rear, half_width = crew.shape[i, 0], crew.shape[i, 1], crew.shape[i, 2]
    half, middle = 0.5 * (front + rear), now[i, S] + 0.5 * (front - rear)
    s, _ = project(t, other, now[i, motion.X], now[i, motion.Y])
    beside = s + 0.5 * (front - rear)
    stop = stopping_distance(crew.law[i], numbers, speed)

    # What is ahead and behind on both lanes, as in the notation of MOBIL: c the actor, n new and o old follower.
    gap, lead, _ = ahead(t, lane, middle, half, -half_width, half_width, i, LOOK, stop, on, owners, rows, count)
    new_gap, new_lead, _ = ahead(
        t, other, beside, half, -half_width, half_width, i, LOOK, stop, on, owners, rows, count
    )
    back, back_speed, back_owner = behind(t, lane, middle, half, i, on, owners, rows, count)
    new_back, new_back_speed, new_owner = behind(t, other, beside, half, i, on, owners, rows, count)

    # Something is beside the actor; the law has no meaning for gaps that are not positive.
    if new_gap <= 0.0 or new_back <= 0.0:
        return -math.inf

    # Without the actor, a follower has the gap to the object ahead of it: both gaps and the length of the actor.
    law, wanted = crew.law[i], now[i, WANTED]
    own = acceleration(law, numbers, speed, wanted, gap, lead, dt)
    own_then = acceleration(law, numbers, speed, wanted, new_gap, new_lead, dt)
    new, new_then = followers(
        crew, i, now, new_owner, new_back_speed, new_back + 2.0 * half + new_gap, new_lead, new_back, speed, dt
    )
    # The order is reversed: the old follower has the actor ahead of it now and no longer after the change.
    old_then, old = followers(crew, i, now, back_owner, back_speed, back + 2.0 * half + gap, lead, back, speed, dt)
    return idm_mobil.mobil(numbers, own, own_then, new, new_then, old, old_then)


def followers(
    crew: Crew,
    i: int,
    now: Array,
    owner: int,
    speed: float,
    free: float,
    lead: float,
    near: float,
    mine: float,
    dt: float,
) -> tuple[float, float]:
    """Return the accelerations of a follower without and with the actor ahead of it [m/s^2]; 0 without a follower.

    Args:
        crew: the actors.
        i: number of the actor.
        now: states of the actors (n, columns).
        owner: number of the follower, -2: none.
        speed: speed of the follower [m/s].
        free: its gap without the actor [m].
        lead: speed of the object ahead then [m/s].
        near: its gap with the actor [m].
        mine: speed of the actor [m/s].
        dt: time step [s].
    """
    if owner < 0:
        return 0.0, 0.0
    who = owner if owner < len(now) and sees(crew.law[owner]) else i
    # A vehicle has no known set-point; its speed is at least as large as it drives now.
    wanted = max(now[who, WANTED], speed) if who == i else now[who, WANTED]
    return (
        acceleration(crew.law[who], crew.numbers[who], speed, wanted, free, lead, dt),
        acceleration(crew.law[who], crew.numbers[who], speed, wanted, near, mine, dt),
    )


def compiled_step() -> Callable[..., None]:
    """Return :func:`step`, compiled."""
    parts = (
        move, change_lanes, advantage, followers,
        *lanes.PARTS, *motion.PARTS, *occupancy.PARTS, *laws.PARTS, *triggers.PARTS, *walkers.PARTS,
    )  # fmt: skip
    machine_code: Callable[..., None] = compiled(step, parts=parts)
    return machine_code
