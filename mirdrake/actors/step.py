"""One time step of all actors, from the states of all at its begin, so that their order has no effect."""

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from mirdrake.actors import lanes, motion, occupancy, reservations, triggers, walkers
from mirdrake.actors import laws as accelerations
from mirdrake.actors.behaviours import idm_mobil, recorded, walk
from mirdrake.actors.behaviours.base import LIMIT as BRAKING
from mirdrake.actors.lanes import LaneTable, project
from mirdrake.actors.laws import acceleration, at_end, sees, stopping_distance
from mirdrake.actors.motion import accelerate, approach, lateral, set_pose
from mirdrake.actors.occupancy import ahead, behind, fill, fill_lines, fill_yield_lines, way_to_end
from mirdrake.actors.reservations import HELD, Claim, Ways, reserve
from mirdrake.actors.triggers import act, change_lane, is_due
from mirdrake.actors.walkers import step_walker
from mirdrake.core.compiled import Records, compiled, records
from mirdrake.worlds.pieces import Array

LOOK = 300.0
"""Distance that actors look ahead [m]."""

DECISION = 10
"""Time steps between two decisions of an actor about its lane: 0.2 s."""


class Member(NamedTuple):
    """What does not change of an actor."""

    law: int
    """number of its law"""
    speed: float
    """speed that it wants at the start [m/s]"""
    min_radius: float
    """smallest radius of its path [m]"""
    first_step: int
    """its first step of a scenario"""
    last_step: int
    """one behind its last step"""


class Crew(NamedTuple):
    """Everything about the actors that does not change: those of the world, then the full vehicles among them."""

    members: Records
    """:class:`Member` (n)"""
    numbers: Array
    """parameters of the behaviours of the actors, and of the drivers of the vehicles (n + m, 12)"""
    shape: Array
    """front, rear and half of the width of the actors, then of the vehicles (n + m, 3) [m]"""
    owners: npt.NDArray[np.int64]
    """number as an object of each actor and vehicle, see :func:`mirdrake.actors.occupancy.fill` (n + m)"""
    steps: Array
    """steps of all scenarios (k, columns)"""
    stops: Array
    """lane and light of each stop line, and its station [m] (q, 3)"""
    programmes: Array
    """durations of green, amber, red and the offset of each light (p, 4) [s]"""
    yield_lines: Array
    """yield lines, see :func:`mirdrake.actors.occupancy.fill_yield_lines` (w, 7)"""
    recordings: Array
    """samples of the recorded actors, see :func:`mirdrake.actors.behaviours.recorded.replay_all` (r, 5)"""
    drivers: Records
    """:class:`mirdrake.actors.reservations.Driver` of the actors, then of the vehicles (n + m)"""
    ways: Ways
    """ways through junctions"""
    spans: Array
    """lane, begin and end of the parts of tracks within junctions (k, 3) [m]"""


def act_all(t: LaneTable, crew: Crew, now: Records, vehicles: Array, time: float, after: Records) -> None:
    """Begin the actions that are due.

    Args:
        t: lanes.
        crew: the actors.
        now: states of the actors (n).
        vehicles: x, y, yaw, vx, vy of the vehicles (m, 5) [m, rad, m/s].
        time: time of `now` since the start [s].
        after: next states; changed.
    """
    for i in range(len(now)):
        number = crew.members[i].first_step + int(now[i].step)
        if number < crew.members[i].last_step and is_due(crew.steps[number], i, now, vehicles, time, after[i]):
            after[i].step += 1.0
            # Not a number compares as false: the next gate needs one step to learn its side before it can fire.
            after[i].side = math.nan
            act(t, crew.steps[number], now[i], after[i], crew.members[i].speed, crew.members[i].min_radius)


def walk_all(t: LaneTable, crew: Crew, now: Records, vehicles: Array, dt: float, after: Records) -> None:
    """Write the motion of all pedestrians; arguments as those of :func:`act_all`, and the time step [s]."""
    for i in range(len(now)):
        if crew.members[i].law == walk.LAW:
            step_walker(t, crew.members, crew.numbers[i], crew.shape, i, now, vehicles, dt, after[i])


def move_all(
    t: LaneTable,
    crew: Crew,
    now: Records,
    dt: float,
    objects: Records,
    count: int,
    claims: Records,
    after: Records,
) -> None:
    """Write the motion of all actors on lanes; arguments as those of :func:`move`, and the claims of all."""
    for i in range(len(now)):
        if crew.members[i].law != walk.LAW and crew.members[i].law != recorded.LAW:
            line = claims[i].distance if claims[i].closed == 1.0 else math.inf
            move(t, crew, i, now[i], dt, objects, count, line, after[i])


def move(
    t: LaneTable, crew: Crew, i: int, now: Any, dt: float, objects: Records, count: int, line: float, row: Any
) -> None:
    """Write the motion of one actor.

    Args:
        t: lanes.
        crew: the actors.
        i: number of the actor.
        now: its state.
        dt: time step [s].
        objects: objects on lanes, see :class:`mirdrake.actors.occupancy.OnLane`.
        count: their number.
        line: distance to the line of a junction that it must not pass [m]; infinite: none.
        row: its next state, with the actions that begin now; written.
    """
    law, numbers, speed, lane = crew.members[i].law, crew.numbers[i], now.v, int(row.lane)
    front, rear, half_width = crew.shape[i, 0], crew.shape[i, 1], crew.shape[i, 2]
    # Frame A is at the rear axle; objects on lanes are described by their middle and half of their length.
    middle, half = row.s + 0.5 * (front - rear), 0.5 * (front + rear)
    d, _, _ = lateral(row.begin, row.offset, row.done, row.span)
    stop = stopping_distance(law, numbers, speed)

    # The object ahead; during a lane change on both lanes.
    gap, other = math.inf, 0.0
    gap, other, _ = ahead(t, lane, middle, half, d - half_width, d + half_width, i, LOOK, stop, speed, objects, count)
    if row.old >= 0.0 and row.done < row.span:
        s, d_old = project(t, int(row.old), now.x, now.y)
        gap_old, other_old, _ = ahead(
            t, int(row.old), s + 0.5 * (front - rear), half, d_old - half_width, d_old + half_width, i, LOOK, stop,
            speed, objects, count,
        )  # fmt: skip
        if gap_old < gap:
            gap, other = gap_old, other_old
    if line < gap:
        gap, other = line, 0.0
    row.gap = gap

    # Speed and distance: a change of speed by a scenario, or the law of the behaviour.
    desired = 0.0 if row.held > 0.0 else row.desired
    row.limit = 0.0
    # Not started yet; otherwise a rate set by a scenario takes precedence over the law, without regard to gaps.
    if row.started == 0.0:
        row.v, distance = 0.0, 0.0
    elif row.ramp > 0.0:
        row.v, distance = approach(speed, desired, row.ramp, dt)
        # While it is held the rate stays, so that the law of the behaviour does not take over at standstill.
        if row.v == desired and row.held == 0.0:
            row.ramp = 0.0
    else:
        a = acceleration(law, numbers, speed, desired, gap, other, dt)
        # A dead end is an obstacle, also behind further lanes; laws that ignore others must stop there as well.
        rest = way_to_end(t, lane, row.s, LOOK)
        if rest < math.inf:
            a = min(a, at_end(law, numbers, speed, desired, rest))
        # Recorded as `braking_limit`: the law asked for a harder braking than the actor is capable of.
        if a < -numbers[BRAKING]:
            a = -numbers[BRAKING]
            row.limit = 1.0
        row.v, distance = accelerate(speed, a, dt)
    row.a = (row.v - speed) / dt

    # The new place: the change of station per metre of path is the mean of that at both ends.
    begin, done = row.s, row.done
    rate = set_pose(t, row)
    for attempt in range(2):
        row.s = begin + distance * rate
        row.done = min(done + distance * rate, row.span)
        if attempt == 0:
            rate = 0.5 * (rate + set_pose(t, row))

    # The lane change is complete: the actor occupies only its new lane from now on.
    if row.span > 0.0 and row.done >= row.span:
        row.span, row.done, row.old = 0.0, 0.0, -1.0
    if not enter_next_lanes(t, row) and row.v > 0.0:
        row.v = 0.0

    # Once more: lane and station may have changed since the last call, and WZ and the velocity depend on row.v.
    set_pose(t, row)


def enter_next_lanes(t: LaneTable, row: Any) -> bool:
    """Put an actor beyond the end of its lane onto the next lanes, else at the end; return whether there is a lane."""
    lane = int(row.lane)
    # More than one lane may end within a step, because lanes of networks can be shorter than it.
    while row.s >= t.lanes[lane].length:
        following = t.lanes[lane].successors[0]
        if following < 0:
            row.s = t.lanes[lane].length
            return False
        row.s -= t.lanes[lane].length
        lane = following
        row.lane = lane
    return True


def go_on(t: LaneTable, rows: Records, distance: float) -> float:
    """Move an actor on along its path; return the curvature there [1/m].

    Args:
        t: lanes.
        rows: its state (1); changed.
        distance: along the path [m].
    """
    row = rows[0]
    # At unit speed, the yaw rate is the curvature.
    row.v = 1.0
    rate = set_pose(t, row)
    row.s += rate * distance
    row.done = min(row.done + rate * distance, row.span)
    enter_next_lanes(t, row)
    set_pose(t, row)
    return float(row.wz)


def change_lanes(
    t: LaneTable,
    crew: Crew,
    now: Records,
    time: float,
    dt: float,
    objects: Records,
    count: int,
    after: Records,
) -> None:
    """Begin the lane changes of actors that decide on them; of two that want the same gap only the first one changes.

    Args:
        t: lanes.
        crew: the actors.
        now: states of the actors (n).
        time: time of `now` since the start [s].
        dt: time step [s].
        objects: objects on lanes.
        count: their number.
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
        if crew.members[i].law != idm_mobil.LAW or now[i].span > 0.0 or after[i].span > 0.0 or now[i].started == 0.0:
            continue
        # The left side is evaluated first and wins a tie, because the right one must be better.
        best, left = 0.0, False
        for side in range(2):
            gain = advantage(t, crew, i, now, side == 0, dt, objects, count)
            if gain > best:
                best, left = gain, side == 0
        if best <= 0.0:
            continue
        lane = int(now[i].lane)
        other = t.lanes[lane].left if left else t.lanes[lane].right
        s, _ = project(t, other, now[i].x, now[i].y)

        # Decisions use the states at the begin of the step, in which two actors can see the same gap as free.
        room = 2.0 * now[i].v + crew.shape[i, 0] + crew.shape[i, 1] + 10.0
        free = True
        for j in range(i):
            if taken_lane[j] == other and abs(lanes.wrapped(taken_s[j] - s, t.lanes[other].length)) < room:
                free = False
        if free:
            taken_lane[i], taken_s[i] = other, s
            distance = crew.numbers[i][idm_mobil.TIME] * now[i].v
            change_lane(t, now[i], after[i], left, distance, crew.members[i].min_radius)


def advantage(
    t: LaneTable, crew: Crew, i: int, now: Records, left: bool, dt: float, objects: Records, count: int
) -> float:
    """Return the advantage of a lane change beyond the threshold [m/s²]; -inf if it is not possible.

    Followers that are vehicles or have no law that depends on gaps are taken for actors with the same parameters.

    Args:
        t: lanes.
        crew: the actors.
        i: number of the actor.
        now: states of the actors (n).
        left: the side.
        dt: time step [s].
        objects: objects on lanes.
        count: their number.
    """
    lane, speed, numbers = int(now[i].lane), now[i].v, crew.numbers[i]
    other = t.lanes[lane].left if left else t.lanes[lane].right
    if other < 0:
        return -math.inf
    front, rear, half_width = crew.shape[i, 0], crew.shape[i, 1], crew.shape[i, 2]
    half, middle = 0.5 * (front + rear), now[i].s + 0.5 * (front - rear)
    s, _ = project(t, other, now[i].x, now[i].y)
    beside = s + 0.5 * (front - rear)
    stop = stopping_distance(crew.members[i].law, numbers, speed)

    # What is ahead and behind on both lanes, as in the notation of MOBIL: c the actor, n new and o old follower.
    gap, lead, _ = ahead(t, lane, middle, half, -half_width, half_width, i, LOOK, stop, speed, objects, count)
    new_gap, new_lead, _ = ahead(t, other, beside, half, -half_width, half_width, i, LOOK, stop, speed, objects, count)
    back, back_speed, back_owner = behind(t, lane, middle, half, i, LOOK, objects, count)
    new_back, new_back_speed, new_owner = behind(t, other, beside, half, i, LOOK, objects, count)

    # Something is beside the actor; the law has no meaning for gaps that are not positive.
    if new_gap <= 0.0 or new_back <= 0.0:
        return -math.inf

    # Without the actor, a follower has the gap to the object ahead of it: both gaps and the length of the actor.
    law, desired = crew.members[i].law, now[i].desired
    own = acceleration(law, numbers, speed, desired, gap, lead, dt)
    own_then = acceleration(law, numbers, speed, desired, new_gap, new_lead, dt)
    new, new_then = followers(
        crew, i, now, new_owner, new_back_speed, new_back + 2.0 * half + new_gap, new_lead, new_back, speed, dt
    )
    # The order is reversed: the old follower has the actor ahead of it now and no longer after the change.
    old_then, old = followers(crew, i, now, back_owner, back_speed, back + 2.0 * half + gap, lead, back, speed, dt)
    return idm_mobil.mobil(numbers, own, own_then, new, new_then, old, old_then)


def followers(
    crew: Crew,
    i: int,
    now: Records,
    owner: int,
    speed: float,
    free: float,
    lead: float,
    near: float,
    mine: float,
    dt: float,
) -> tuple[float, float]:
    """Return the accelerations of a follower without and with the actor ahead of it [m/s²]; 0 without a follower.

    Args:
        crew: the actors.
        i: number of the actor.
        now: states of the actors (n).
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
    who = owner if owner < len(now) and sees(crew.members[owner].law) else i
    # A vehicle has no known set-point; its speed is at least as large as it drives now.
    desired = max(now[who].desired, speed) if who == i else now[who].desired
    return (
        acceleration(crew.members[who].law, crew.numbers[who], speed, desired, free, lead, dt),
        acceleration(crew.members[who].law, crew.numbers[who], speed, desired, near, mine, dt),
    )


class TimeStep:
    """The time step of all actors of a world.

    Its parts are compiled separately: one function of all would contain their code once more, and take twice as long
    to compile. Parts that no actor of a world needs are not compiled.

    Args:
        t: lanes.
        crew: the actors.
    """

    def __init__(self, t: LaneTable, crew: Crew) -> None:
        self._t, self._crew = t, crew
        # Room for all that can occur: two lanes per actor, all paths under each actor and the lanes that begin with
        # its lane, all lanes under each actor on a path and under each vehicle, and the stop lines.
        paths, n = int(t.lanes["own"].sum()), len(crew.members)
        forks = int((t.lanes["fork"] >= 0).any()) * lanes.CHOICES
        on_paths = n if paths else 0
        most = n * (2 + paths + forks) + (on_paths + len(crew.shape) - n) * len(t.lanes) + len(crew.stops)
        self._objects = np.empty(most + 2 * len(crew.yield_lines), occupancy.OBJECT)  # scratch of a time step
        laws = set(crew.members["law"].tolist())
        common = (*lanes.PARTS, *motion.PARTS, *occupancy.PARTS)
        on_lanes = (move, enter_next_lanes, advantage, followers, *common, *accelerations.PARTS, *triggers.PARTS)
        # The vehicle of an actor drives as the actor does.
        obeys = crew.drivers["obeys"]
        self._obeys = np.where(crew.owners >= 0, obeys[crew.owners], 0)
        reserving = (*common, *accelerations.PARTS, *reservations.PARTS)
        self._reserve = compiled(reserve, parts=reserving) if obeys.any() else None
        self._fill = compiled(fill, parts=common)
        self._fill_lines = compiled(fill_lines, parts=common) if len(crew.stops) else None
        self._yield = compiled(fill_yield_lines, parts=common) if len(crew.yield_lines) else None
        self._act = compiled(act_all, parts=(*common, *triggers.PARTS)) if len(crew.steps) else None
        self._change_lanes = compiled(change_lanes, parts=on_lanes) if idm_mobil.LAW in laws else None
        self._move = compiled(move_all, parts=on_lanes) if laws - {walk.LAW, recorded.LAW} else None
        self._walk = compiled(walk_all, parts=(*common, *walkers.PARTS)) if walk.LAW in laws else None
        self._replay = compiled(recorded.replay_all, parts=recorded.PARTS) if recorded.LAW in laws else None

    def claims(self) -> Records:
        """Return the claims at the start: none (n + m)."""
        start = Claim(-1.0, math.inf, math.inf, 0.0, (-1.0,) * HELD)
        return records(Claim, [start] * len(self._crew.drivers))

    def __call__(self, now: Records, vehicles: Array, time: float, dt: float, after: Records, claims: Records) -> None:
        """Write the states of all actors after a time step.

        Args:
            now: states (n).
            vehicles: x, y, yaw, vx, vy of the vehicles (m, 5) [m, rad, m/s].
            time: time of `now` since the start [s].
            dt: time step [s].
            after: states after the step (n); written.
            claims: see :meth:`claims`; changed.
        """
        t, crew, objects = self._t, self._crew, self._objects
        known = count = self._fill(t, crew.shape, crew.owners, self._obeys, crew.spans, now, vehicles, objects)
        if self._fill_lines is not None:
            count = self._fill_lines(crew.stops, crew.programmes, time, objects, count)
        if self._yield is not None:
            count = self._yield(t, crew.yield_lines, objects, count)

        if self._reserve is not None:
            self._reserve(
                t, crew.ways, crew.drivers, crew.numbers, crew.shape, now, vehicles, time, objects, known, count, claims
            )

        # Actions first: a step that fires now already acts on the motion of this time step. Lane changes before
        # motions, because they decide on which lane an actor then looks ahead.
        after.view(float)[:] = now.view(float)  # faster than a copy of records
        if self._act is not None:
            self._act(t, crew, now, vehicles, time, after)
        if self._change_lanes is not None:
            self._change_lanes(t, crew, now, time, dt, objects, count, after)
        if self._move is not None:
            self._move(t, crew, now, dt, objects, count, claims, after)
        if self._walk is not None:
            self._walk(t, crew, now, vehicles, dt, after)
        if self._replay is not None:
            self._replay(crew.members, crew.numbers, crew.recordings, time, dt, after)
