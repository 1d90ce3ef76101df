"""Objects on lanes, and the search for the next one ahead and behind."""

import math
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from mirdrake.actors.lanes import LaneTable, foot, is_beyond, nearest_node, project, wrapped
from mirdrake.core.compiled import Records, record_type
from mirdrake.worlds.pieces import Array


class OnLane(NamedTuple):
    """An object on a lane."""

    lane: int
    """number of the lane"""
    owner: int
    """number of the actor; n and more: vehicle; :data:`LINE`"""
    middle: float
    """station of its middle [m]"""
    half: float
    """half its length [m]"""
    speed: float
    """speed along the lane [m/s]"""
    low: float
    """offset of its right side [m]"""
    high: float
    """offset of its left side [m]"""
    blocker: int
    """of a yield line: the object that has priority, for which the line is open; -1: none"""


OBJECT: Final = record_type(OnLane)
"""Type of the records of :class:`OnLane`."""

LINE: Final = -1
"""Owner of a stop line."""

ANTICIPATION: Final = 1.5
"""Time for which drivers foresee the lateral motion of others [s]: an object that will be on the lane counts."""

_ASIDE = 0.3  # [m] objects that are farther than this beside an actor are not in its way
_HOPS = 20  # lanes ahead that are searched
_CLEAR = 2.0  # [m] before and behind a vehicle with priority that must be free
_EVERYWHERE = 1e9  # [m] offset of the sides of an object that counts on the whole width of its lane


def fill(
    t: LaneTable,
    shape: Array,
    owners: npt.NDArray[np.int64],
    obeys: npt.NDArray[np.int64],
    spans: Array,
    now: Records,
    vehicles: Array,
    objects: Records,
) -> int:
    """Write all objects on lanes; return their number.

    An actor is on its lane, and during a lane change on both lanes. Vehicles are on every lane that they touch, and so
    are actors on a path of their own; on such a path are all others that touch it. Where several lanes begin, an actor
    on one of them is also on those of the others that it touches.

    The motion across a lane is anticipated, but not within a junction for those that drive by its right of way.

    Args:
        t: lanes.
        shape: front, rear [m], half of the width [m] of the actors, then of the vehicles (n + m, 3).
        owners: number as an object of each actor and vehicle (n + m); -1: none, as its body is a vehicle.
        obeys: 1 for each that drives by the right of way of junctions (n + m).
        spans: lane, begin and end of the parts of tracks within junctions (k, 3) [m].
        now: states of the actors (n).
        vehicles: x, y, yaw, vx, vy of the vehicles (m, 5) [m, rad, m/s].
        objects: :class:`OnLane`; written.
    """
    count, n = 0, len(now)
    for i in range(n):
        if owners[i] < 0:
            continue
        front, rear, half_width = shape[i, 0], shape[i, 1], shape[i, 2]
        lane = int(now[i].lane)
        count = _put(objects, count, lane, i, now[i].s + 0.5 * (front - rear), 0.5 * (front + rear), now[i].v)

        # Until a lane change ends, those behind on the old lane must not close the gap.
        if now[i].old >= 0.0 and now[i].done < now[i].span:
            old = int(now[i].old)
            s, _ = project(t, old, now[i].x, now[i].y)
            count = _put(objects, count, old, i, s + 0.5 * (front - rear), 0.5 * (front + rear), now[i].v)
    # Other lanes, of actors and vehicles.
    for i in range(n + len(vehicles)):
        if owners[i] < 0:
            continue
        if i < n:
            mine, x, y, yaw, vx, vy = int(now[i].lane), now[i].x, now[i].y, now[i].yaw, now[i].vx, now[i].vy
        else:
            j = i - n
            mine, x, y, yaw, vx, vy = -1, vehicles[j, 0], vehicles[j, 1], vehicles[j, 2], vehicles[j, 3], vehicles[j, 4]
        front, rear, half_width = shape[i, 0], shape[i, 1], shape[i, 2]
        middle, half = 0.5 * (front - rear), 0.5 * (front + rear)
        x, y = x + middle * math.cos(yaw), y + middle * math.sin(yaw)
        # Bounding circle and anticipated motion: cheap tests first, the projection is by far the most expensive part.
        reach = half + half_width + ANTICIPATION * math.hypot(vx, vy)
        for lane in range(len(t.lanes)):
            # An actor on a lane does not count on lanes that cross it; a path may cross any lane, and any lane a path.
            if mine >= 0 and not _may_touch(t, mine, lane):
                continue
            box = t.lanes[lane].box
            if box[0] - reach <= x <= box[2] + reach and box[1] - reach <= y <= box[3] + reach:
                count = _touch(
                    t, lane, owners[i], x, y, yaw, vx, vy, half, half_width, reach, obeys[i] == 1, spans, objects, count
                )
    return count


def _may_touch(t: LaneTable, mine: int, lane: int) -> bool:
    """Return whether an actor on a lane is also on another one if it touches that."""
    if lane == mine or t.lanes[mine].own == 1 or t.lanes[lane].own == 1:
        return lane != mine
    return bool(t.lanes[lane].fork >= 0 and t.lanes[lane].fork == t.lanes[mine].fork)


def _put(objects: Records, count: int, lane: int, owner: int, middle: float, half: float, speed: float) -> int:
    """Write an object that counts on the whole width of a lane; return the number of objects."""
    # The array has a fixed size; an object beyond it is dropped, because compiled code cannot enlarge it.
    if count < len(objects):
        one = objects[count]
        one.lane, one.owner, one.middle, one.half, one.speed = lane, owner, middle, half, speed
        one.low, one.high, one.blocker = -_EVERYWHERE, _EVERYWHERE, -1
        return count + 1
    return count


def _touch(
    t: LaneTable, lane: int, owner: int, x: float, y: float, yaw: float, vx: float, vy: float,
    half: float, half_width: float, reach: float, obeys: bool, spans: Array, objects: Records, count: int,
) -> int:  # fmt: skip
    """Write an object on a lane if the box around it touches the lane, or will soon; return the number of objects.

    Here x and y are those of its middle.
    """
    # What touches the lane is within a distance of a node. Cheap tests first, as the foot takes longest. Whatever the
    # heading of the lane, motion across it ends on the circle over the foreseen motion as its diameter (Thales).
    ahead_x, ahead_y = 0.5 * ANTICIPATION * vx, 0.5 * ANTICIPATION * vy
    size = half + half_width + 2.0 * t.lanes[lane].step + 0.5 * t.lanes[lane].width
    farthest = math.hypot(ahead_x, ahead_y) + half + half_width + size
    if is_beyond(t.pieces[t.lanes[lane].piece], x + ahead_x, y + ahead_y, farthest):
        return count
    near = nearest_node(t, lane, x, y, reach + size)
    if near < 0 or _is_clear(t, lane, near, x, y, yaw, vx, vy, half, half_width):
        return count
    s, offset = foot(t, lane, x, y, near)
    if abs(offset) > 0.5 * t.lanes[lane].width + reach:
        return count

    # Projection of the rectangle onto the lane's axes, with the heading of the lane at its nearest node.
    i = t.lanes[lane].first + min(int(s / t.lanes[lane].step + 0.5), t.lanes[lane].nodes - 1)
    along = t.nodes[i].yaw
    cosine, sine = abs(math.cos(yaw - along)), abs(math.sin(yaw - along))
    aside = half * sine + half_width * cosine
    # How far it moves to the left. Who crosses a lane within a junction does so by the right of way, or waits.
    towards = ANTICIPATION * (vy * math.cos(along) - vx * math.sin(along))
    if obeys and _in_junction(t, lane, s, spans):
        towards = 0.0
    # Extended only on the side to which it moves: what leaves the lane frees it only when it has left.
    low, high = offset - aside + min(towards, 0.0), offset + aside + max(towards, 0.0)
    if low > 0.5 * t.lanes[lane].width or high < -0.5 * t.lanes[lane].width or count >= len(objects):
        return count
    beyond = (x - t.nodes[i].x) * math.cos(along) + (y - t.nodes[i].y) * math.sin(along)
    # Before the begin of the lane or beyond its end.
    if t.lanes[lane].closed == 0 and abs(beyond) > half + half_width + t.lanes[lane].step:
        return count

    # Speed along the lane: negative for oncoming objects, which the law then sees as closing faster.
    one = objects[count]
    one.lane, one.owner = lane, owner
    one.middle, one.half = s, half * cosine + half_width * sine
    one.speed = vx * math.cos(along) + vy * math.sin(along)
    one.low, one.high, one.blocker = low, high, -1
    return count + 1


def _in_junction(t: LaneTable, lane: int, s: float, spans: Array) -> bool:
    """Return whether a station of a lane is within a junction."""
    for k in range(len(spans)):
        if int(spans[k, 0]) == lane and spans[k, 1] <= s <= spans[k, 2]:
            return True
    return bool(t.lanes[lane].junction == 1)


def _is_clear(
    t: LaneTable, lane: int, near: int, x: float, y: float, yaw: float, vx: float, vy: float,
    half: float, half_width: float,
) -> bool:  # fmt: skip
    """Return whether an object certainly does not touch a lane, from the node nearest to it.

    The node replaces the foot: they are at most one step apart. All differences of what follows from them are
    bounded by the turn of the lane there; false where it turns too much for that.
    """
    row = t.lanes[lane]
    i, last = row.first + near, row.first + row.nodes - 1
    node = t.nodes[i]
    turn = max(abs(t.nodes[min(i + 1, last)].yaw - node.yaw), abs(node.yaw - t.nodes[max(i - 1, row.first)].yaw))
    dx, dy = x - node.x, y - node.y
    away = math.hypot(dx, dy)
    # Towards the centre of curvature the foot may be anywhere; the ends of a ring have different neighbours.
    if away * turn > 0.5 * row.step or (row.closed == 1 and (near == 0 or i == last)):
        return False
    spare = 1e-6 + 2.0 * turn * (row.step + away + half + half_width + ANTICIPATION * math.hypot(vx, vy))

    cosine, sine = math.cos(node.yaw), math.sin(node.yaw)
    if row.closed == 0 and abs(dx * cosine + dy * sine) > half + half_width + 2.0 * row.step + spare:
        return True
    offset, towards = dy * cosine - dx * sine, ANTICIPATION * (vy * cosine - vx * sine)
    aside = half * abs(math.sin(yaw - node.yaw)) + half_width * abs(math.cos(yaw - node.yaw)) + 0.5 * row.width + spare
    return bool(offset + min(towards, 0.0) > aside or offset + max(towards, 0.0) < -aside)


def fill_lines(stops: Array, programmes: Array, time: float, objects: Records, count: int) -> int:
    """Write the stop lines whose light is red or amber; return the number of objects.

    Args:
        stops: lane and light of each stop line, and its station [m] (k, 3).
        programmes: durations of green, amber, red and the offset of each light (p, 4) [s].
        time: time since the start [s].
        objects: objects on lanes.
        count: their number.
    """
    for k in range(len(stops)):
        light = int(stops[k, 1])
        green, amber = programmes[light, 0], programmes[light, 1]
        # Phases in the order green, amber, red; the offset shifts the begin of green backwards.
        phase = (time + programmes[light, 3]) % (green + amber + programmes[light, 2])
        if phase >= green:
            # The speed column of a stop line is free, as a line does not move; here it is the time left of amber.
            left = max(green + amber - phase, 0.0)
            count = _put(objects, count, int(stops[k, 0]), LINE, stops[k, 2], 0.0, left)
    return count


def fill_yield_lines(t: LaneTable, lines: Array, objects: Records, count: int) -> int:
    """Write the yield lines that are closed; return the number of objects.

    A line is closed while an object is at the place of conflict, or arrives there within the gap at its present speed.

    Args:
        t: lanes.
        lines: lane and station of each line [m]; a lane to its conflict, begin and end of that [m], gap [s], distance
            from the begin of the lane to that of the lane of the conflict [m] (k, 7).
        objects: objects on lanes.
        count: their number.
    """
    known = count
    for k in range(len(lines)):
        lane, place, size = int(lines[k, 2]), lines[k, 3] + lines[k, 6], lines[k, 4] - lines[k, 3]
        first = -1
        for j in range(known):
            one = objects[j]
            if one.lane != lane or one.owner == LINE or one.owner == first:
                continue
            if not arrives(one, place, size, lines[k, 5], t.lanes[lane].length if t.lanes[lane].closed == 1 else 0.0):
                continue
            # Nobody waits for itself; two objects close the line for everyone.
            if count < len(objects):
                count = _put(objects, count, int(lines[k, 0]), LINE, lines[k, 1], 0.0, 0.0)
                objects[count - 1].blocker = one.owner
            if first >= 0:
                break
            first = one.owner
    return count


def arrives(one: Any, place: float, size: float, gap: float, period: float) -> bool:
    """Return whether an object is at a place of its lane, or arrives there within a time.

    Args:
        one: the object.
        place: begin of the place [m].
        size: its length [m].
        gap: the time [s].
        period: length of a closed lane, otherwise 0 [m].
    """
    # From its middle to the conflict; negative until its rear has left it, also across the seam of a ring.
    left = one.half + _CLEAR
    rest = place - one.middle
    if period > 0.0:
        rest = (rest + left) % period - left
    return bool(rest + size >= -left and rest - left <= max(one.speed, 0.0) * gap)


def ahead(
    t: LaneTable, lane: int, middle: float, half: float, low: float, high: float, me: int, look: float, stop: float,
    own: float, objects: Records, count: int,
) -> tuple[float, float, int]:  # fmt: skip
    """Return the gap to the next object ahead [m], its speed [m/s] and its owner; inf, 0 and -2 without one.

    The search follows the first successor of each lane.

    Args:
        t: lanes.
        lane: lane of the actor.
        middle: station of its middle [m].
        half: half of its length [m].
        low: offset of its right side [m].
        high: offset of its left side [m].
        me: number of the actor.
        look: largest distance of the search [m].
        stop: distance that it needs to stop [m]; nearer amber lights are passed if reached before red.
        own: its speed [m/s].
        objects: objects on lanes.
        count: their number.
    """
    gap, speed, owner, base = math.inf, 0.0, -2, 0.0

    # Lane by lane; `base` is the station of the begin of the searched lane, measured from the first one.
    for _ in range(_HOPS):
        for k in range(count):
            one = objects[k]
            if one.lane != lane or one.owner == me or one.low > high + _ASIDE or one.high < low - _ASIDE:
                continue
            away = base + one.middle - middle
            # On a closed lane everything is ahead; nothing beyond it needs to be searched.
            if t.lanes[lane].closed == 1:
                away = away % t.lanes[lane].length
            free = away - one.half - half
            if one.owner == LINE:
                # A line behind the front bumper was crossed. Amber is passed if a comfortable stop is too late and the
                # line is reached before red.
                if free < 0.0 or one.blocker == me or free < min(stop, own * one.speed):
                    continue
            # At equal stations the lower number is behind, so that the two do not wait for each other.
            elif away < 0.0 or (away == 0.0 and one.owner < me):
                continue
            if free < gap:
                gap, owner = free, one.owner
                speed = 0.0 if one.owner == LINE else one.speed
        base += t.lanes[lane].length
        if t.lanes[lane].closed == 1 or t.lanes[lane].successors[0] < 0 or base - middle > look:
            break
        lane = t.lanes[lane].successors[0]
    return gap, speed, owner


def behind(
    t: LaneTable, lane: int, middle: float, half: float, me: int, look: float, objects: Records, count: int
) -> tuple[float, float, int]:
    """Return the gap to the next object behind [m], its speed [m/s] and its owner; see `ahead`.

    Objects on other lanes count whose first successors lead to the lane.
    """
    gap, speed, owner = math.inf, 0.0, -2
    for k in range(count):
        one = objects[k]
        if one.owner == me or one.owner == LINE:
            continue
        # From the begin of its lane to that of this lane: the way that it looks ahead.
        at, base = one.lane, 0.0
        for _ in range(_HOPS):
            if at == lane or t.lanes[at].closed == 1 or t.lanes[at].successors[0] < 0 or base > look:
                break
            base += t.lanes[at].length
            at = t.lanes[at].successors[0]
        if at != lane:
            continue
        # On a ring, behind is also what is far ahead.
        away = base + middle - one.middle
        if t.lanes[lane].closed == 1:
            away = away % t.lanes[lane].length
        if away < 0.0 or (away == 0.0 and one.owner > me):
            continue
        free = away - one.half - half
        if free < gap:
            gap, speed, owner = free, one.speed, one.owner
    return gap, speed, owner


def way_to_end(t: LaneTable, lane: int, s: float, look: float) -> float:
    """Return the distance from a station to where the road ends [m]; inf if lanes up to `look` have no end."""
    rest: float = t.lanes[lane].length - s
    for _ in range(_HOPS):
        if t.lanes[lane].closed == 1:
            return math.inf
        if t.lanes[lane].successors[0] < 0:
            return rest
        if rest > look:
            return math.inf
        lane = t.lanes[lane].successors[0]
        rest += t.lanes[lane].length
    return math.inf


PARTS = (
    fill,
    fill_lines,
    fill_yield_lines,
    arrives,
    _may_touch,
    _put,
    _touch,
    _in_junction,
    _is_clear,
    ahead,
    behind,
    way_to_end,
    project,
    nearest_node,
    is_beyond,
    foot,
    wrapped,
)
"""Compiled functions of this module."""
