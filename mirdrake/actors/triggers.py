"""Steps of scenarios: triggers and actions as numbers, and their evaluation."""

import math
from typing import Any, Final

from mirdrake.actors.lanes import LaneTable, project
from mirdrake.actors.motion import span_of
from mirdrake.core.compiled import Records
from mirdrake.worlds.pieces import Array

AT: Final = 0
DISTANCE: Final = 1
TIME: Final = 2
PAST: Final = 3
GAP_BELOW: Final = 4
GAP_ABOVE: Final = 5
SPEED_BELOW: Final = 6
SPEED_ABOVE: Final = 7
"""Kinds of triggers."""

START: Final = 0
CHANGE_SPEED: Final = 1
CHANGE_LANE: Final = 2
STOP: Final = 3
GO: Final = 4
"""Kinds of actions."""

TRIGGER: Final = 0
SUBJECT: Final = 1
VALUE: Final = 2
GATE_X: Final = 3
GATE_Y: Final = 4
GATE_YAW: Final = 5
GATE_HALF: Final = 6
ACTION: Final = 7
FIRST: Final = 8
SECOND: Final = 9
"""Columns of a step: kind of its trigger, its subject (-1: the actor, else number of the actor or, from n on, vehicle),
its value; gate of a place [m, rad]; action and its two numbers."""
WIDE: Final = 10
"""Number of these columns."""


def is_due(step: Array, i: int, now: Records, vehicles: Array, time: float, next_row: Any) -> bool:
    """Return whether the trigger of a step fires.

    Args:
        step: the step.
        i: number of the actor.
        now: states of the actors (n).
        vehicles: x, y, yaw, vx, vy of the vehicles (m, 5).
        time: time since the start [s].
        next_row: next state of the actor; the side of a gate is remembered in it.
    """
    kind = int(step[TRIGGER])
    if kind == AT:
        # The tolerance absorbs rounding of the time, which would delay the step by one period.
        return bool(time >= step[VALUE] - 1e-9)
    if kind == GAP_BELOW:
        return bool(now[i].gap < step[VALUE])
    if kind == GAP_ABOVE:
        return bool(now[i].gap > step[VALUE])
    if kind == SPEED_BELOW:
        return bool(now[i].v < step[VALUE])
    if kind == SPEED_ABOVE:
        return bool(now[i].v > step[VALUE])

    # Numbers from n on are vehicles; -1 is the actor itself.
    subject = i if step[SUBJECT] < 0.0 else int(step[SUBJECT])
    if subject < len(now):
        x, y, vx, vy = now[subject].x, now[subject].y, now[subject].vx, now[subject].vy
    else:
        row = subject - len(now)
        x, y, vx, vy = vehicles[row, 0], vehicles[row, 1], vehicles[row, 3], vehicles[row, 4]
    if kind == PAST:
        dx, dy, cosine, sine = x - step[GATE_X], y - step[GATE_Y], math.cos(step[GATE_YAW]), math.sin(step[GATE_YAW])
        side, aside = dx * cosine + dy * sine, dy * cosine - dx * sine
        # The side in the last step against the present one: the gate fires on crossing it forwards, once.
        before = now[i].side
        next_row.side = side
        return bool(before < 0.0 <= side and abs(aside) <= step[GATE_HALF])
    distance = math.hypot(x - now[i].x, y - now[i].y)
    if kind == TIME:
        # Time to reach the actor at the present speed, without a division that fails at standstill.
        return bool(distance <= step[VALUE] * math.hypot(vx, vy))
    return bool(distance <= step[VALUE])


def act(t: LaneTable, step: Array, now_row: Any, row: Any, speed: float, min_radius: float) -> None:
    """Begin the action of a step.

    Args:
        t: lanes.
        step: the step.
        now_row: present state of the actor.
        row: its next state; changed.
        speed: its desired speed at the start [m/s].
        min_radius: smallest radius of its path [m].
    """
    action = int(step[ACTION])
    if action == START:
        row.started, row.desired = 1.0, speed
    elif action == CHANGE_SPEED:
        row.desired, row.ramp, row.held = step[FIRST], step[SECOND], 0.0
    elif action == STOP:
        row.ramp, row.held = step[FIRST], 1.0
    elif action == GO:
        row.ramp, row.held = step[FIRST], 0.0
    # A lane change during another one is ignored; the first one is finished.
    elif now_row.done >= now_row.span:
        # The time of the change at the present speed; `span_of` lengthens it if the curvature would be too large.
        distance = step[SECOND] * now_row.v
        change_lane(t, now_row, row, step[FIRST] > 0.0, distance, min_radius)


def change_lane(t: LaneTable, now_row: Any, row: Any, left: bool, distance: float, min_radius: float) -> None:
    """Begin a change to the lane to the left, else right, if there is one.

    Args:
        t: lanes.
        now_row: present state of the actor.
        row: its next state; changed.
        left: the side.
        distance: length of the change [m].
        min_radius: smallest radius of its path [m].
    """
    lane = int(now_row.lane)
    other = t.lanes[lane].left if left else t.lanes[lane].right
    if other < 0:
        return
    # The offset on the new lane is that of the present position, so that the pose does not jump.
    s, offset = project(t, other, now_row.x, now_row.y)
    row.old, row.lane, row.s, row.begin, row.done = lane, other, s, offset, 0.0
    row.span = span_of(row.offset - offset, distance, min_radius)


PARTS = (is_due, act, change_lane)
"""Compiled functions of this module."""
