"""Objects on lanes, and the search for the next one ahead and behind."""

import math
from typing import Final

from mirdrake.actors.lanes import Ints, LaneTable, project, wrapped
from mirdrake.actors.motion import DONE, LANE, OLD, SPAN, VX, VY, YAW, S, V, X, Y
from mirdrake.worlds.pieces import Array

MIDDLE: Final = 0
HALF: Final = 1
SPEED: Final = 2
LOW: Final = 3
HIGH: Final = 4
"""Columns of an object on a lane: station of its middle, half its length [m], speed along the lane [m/s], offsets of
its right and left side [m]."""
WIDE: Final = 5
"""Number of these columns."""

LINE: Final = -1
"""Owner of a stop line."""

ANTICIPATION: Final = 1.5
"""Time for which drivers foresee the lateral motion of others [s]: an object that will be on the lane counts."""

_ASIDE = 0.3  # [m] objects that are farther than this beside an actor are not in its way
_HOPS = 20  # lanes ahead that are searched
_EVERYWHERE = 1e9  # [m] offset of the sides of an object that counts on the whole width of its lane


def fill(
    t: LaneTable, own: Ints, shape: Array, now: Array, vehicles: Array, lanes: Ints, owners: Ints, rows: Array
) -> int:
    """Write all objects on lanes; return their number.

    An actor is on its lane, and during a lane change on both lanes. Vehicles are on every lane that they touch, and so
    are actors on a path of their own; on such a path are all others that touch it.

    Args:
        t: lanes.
        own: 1: the path of a single actor (l).
        shape: front, rear [m], half of the width [m] of the actors, then of the vehicles (n + m, 3).
        now: states of the actors (n, columns).
        vehicles: x, y, yaw, vx, vy of the vehicles (m, 5) [m, rad, m/s].
        lanes: lane of each object; written.
        owners: number of the actor, n and more: vehicle; written.
        rows: columns of each object; written.
    """
    count, n = 0, len(now)
    for i in range(n):
        front, rear, half_width = shape[i, 0], shape[i, 1], shape[i, 2]
        lane = int(now[i, LANE])
        count = _put(
            lanes, owners, rows, count, lane, i, now[i, S] + 0.5 * (front - rear), 0.5 * (front + rear), now[i, V]
        )

        # Until a lane change ends, those behind on the old lane must not close the gap.
        if now[i, OLD] >= 0.0 and now[i, DONE] < now[i, SPAN]:
            old = int(now[i, OLD])
            s, _ = project(t, old, now[i, X], now[i, Y])
            count = _put(lanes, owners, rows, count, old, i, s + 0.5 * (front - rear), 0.5 * (front + rear), now[i, V])
        # An actor on a lane does not count on lanes that cross it; a path may cross any lane, and any lane a path.
        for other in range(len(own)):
            if other != lane and (own[lane] == 1 or own[other] == 1):
                count = _touch(
                    t, other, i, now[i, X], now[i, Y], now[i, YAW], now[i, VX], now[i, VY], front, rear, half_width,
                    lanes, owners, rows, count,
                )  # fmt: skip
    for j in range(len(vehicles)):
        x, y, yaw, vx, vy = vehicles[j, 0], vehicles[j, 1], vehicles[j, 2], vehicles[j, 3], vehicles[j, 4]
        for lane in range(len(own)):
            count = _touch(
                t, lane, n + j, x, y, yaw, vx, vy, shape[n + j, 0], shape[n + j, 1], shape[n + j, 2],
                lanes, owners, rows, count,
            )  # fmt: skip
    return count


def _put(
    lanes: Ints, owners: Ints, rows: Array, count: int, lane: int, owner: int, middle: float, half: float, speed: float
) -> int:
    """Write an object that counts on the whole width of a lane; return the number of objects."""
    # The arrays have a fixed size; an object beyond it is dropped, because compiled code cannot enlarge them.
    if count < len(lanes):
        lanes[count], owners[count] = lane, owner
        rows[count, MIDDLE], rows[count, HALF], rows[count, SPEED] = middle, half, speed
        rows[count, LOW], rows[count, HIGH] = -_EVERYWHERE, _EVERYWHERE
        return count + 1
    return count


def _touch(
    t: LaneTable, lane: int, owner: int, x: float, y: float, yaw: float, vx: float, vy: float,
    front: float, rear: float, half_width: float, lanes: Ints, owners: Ints, rows: Array, count: int,
) -> int:  # fmt: skip
    """Write an object on a lane if the box around it touches the lane, or will soon; return the number of objects."""
    middle = 0.5 * (front - rear)
    x, y, half = x + middle * math.cos(yaw), y + middle * math.sin(yaw), 0.5 * (front + rear)
    # Bounding circle and anticipated motion: cheap tests first, the projection is by far the most expensive part.
    reach = half + half_width + ANTICIPATION * math.hypot(vx, vy)
    box = t.box[lane]
    if x < box[0] - reach or x > box[2] + reach or y < box[1] - reach or y > box[3] + reach:
        return count
    s, offset = project(t, lane, x, y)
    if abs(offset) > 0.5 * t.width[lane] + reach:
        return count

    # Projection of the rectangle onto the lane's axes, with the heading of the lane at its nearest node.
    i = t.first[lane] + min(int(s / t.step[lane] + 0.5), t.nodes[lane] - 1)
    along = t.yaw[i]
    cosine, sine = abs(math.cos(yaw - along)), abs(math.sin(yaw - along))
    aside = half * sine + half_width * cosine
    towards = ANTICIPATION * (vy * math.cos(along) - vx * math.sin(along))  # how far it moves to the left
    # Extended only on the side to which it moves: what leaves the lane frees it only when it has left.
    low, high = offset - aside + min(towards, 0.0), offset + aside + max(towards, 0.0)
    if low > 0.5 * t.width[lane] or high < -0.5 * t.width[lane] or count >= len(lanes):
        return count
    beyond = (x - t.x[i]) * math.cos(along) + (y - t.y[i]) * math.sin(along)
    if t.closed[lane] == 0 and abs(beyond) > half + half_width + t.step[lane]:  # before the begin or beyond the end
        return count

    # Speed along the lane: negative for oncoming objects, which the law then sees as closing faster.
    lanes[count], owners[count] = lane, owner
    rows[count, MIDDLE], rows[count, HALF] = s, half * cosine + half_width * sine
    rows[count, SPEED] = vx * math.cos(along) + vy * math.sin(along)
    rows[count, LOW], rows[count, HIGH] = low, high
    return count + 1


def fill_lines(
    stops: Ints, places: Array, programmes: Array, time: float, lanes: Ints, owners: Ints, rows: Array, count: int
) -> int:
    """Write the stop lines whose light is red or amber; return the number of objects.

    Args:
        stops: lane and light of each stop line (k, 2).
        places: stations of the stop lines (k) [m].
        programmes: durations of green, amber, red and the offset of each light (p, 4) [s].
        time: time since the start [s].
        lanes: objects, see :func:`fill`, as are the next three.
        owners: see `lanes`.
        rows: see `lanes`.
        count: see `lanes`.
    """
    for k in range(len(places)):
        light = stops[k, 1]
        green, amber = programmes[light, 0], programmes[light, 1]
        # Phases in the order green, amber, red; the offset shifts the begin of green backwards.
        phase = (time + programmes[light, 3]) % (green + amber + programmes[light, 2])
        if phase >= green and count < len(lanes):
            # The speed column of a stop line is free, as a line does not move; it says that the light is amber.
            is_amber = 1.0 if phase < green + amber else 0.0
            count = _put(lanes, owners, rows, count, stops[k, 0], LINE, places[k], 0.0, is_amber)
    return count


def ahead(
    t: LaneTable, lane: int, middle: float, half: float, low: float, high: float, me: int, look: float, stop: float,
    lanes: Ints, owners: Ints, rows: Array, count: int,
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
        stop: distance that it needs to stop [m]; amber lights nearer than this are passed.
        lanes: objects, see :func:`fill`, as are the next three.
        owners: see `lanes`.
        rows: see `lanes`.
        count: see `lanes`.
    """
    gap, speed, owner, base = math.inf, 0.0, -2, 0.0

    # Lane by lane; `base` is the station of the begin of the searched lane, measured from the first one.
    for _ in range(_HOPS):
        for k in range(count):
            if lanes[k] != lane or owners[k] == me or rows[k, LOW] > high + _ASIDE or rows[k, HIGH] < low - _ASIDE:
                continue
            away = base + rows[k, MIDDLE] - middle
            # On a closed lane everything is ahead; nothing beyond it needs to be searched.
            if t.closed[lane] == 1:
                away = away % t.length[lane]
            free = away - rows[k, HALF] - half
            if owners[k] == LINE:
                # A line behind the front bumper was crossed; amber is passed if a comfortable stop is too late.
                if free < 0.0 or (rows[k, SPEED] > 0.0 and free < stop):
                    continue
            # At equal stations the lower number is behind, so that the two do not wait for each other.
            elif away < 0.0 or (away == 0.0 and owners[k] < me):
                continue
            if free < gap:
                gap, owner = free, owners[k]
                speed = 0.0 if owners[k] == LINE else rows[k, SPEED]
        base += t.length[lane]
        if t.closed[lane] == 1 or t.successors[lane, 0] < 0 or base - middle > look:
            break
        lane = t.successors[lane, 0]
    return gap, speed, owner


def behind(
    t: LaneTable, lane: int, middle: float, half: float, me: int, lanes: Ints, owners: Ints, rows: Array, count: int
) -> tuple[float, float, int]:
    """Return the gap to the next object behind on the same lane [m], its speed [m/s] and its owner; see `ahead`."""
    gap, speed, owner = math.inf, 0.0, -2
    for k in range(count):
        if lanes[k] != lane or owners[k] == me or owners[k] == LINE:
            continue
        away = middle - rows[k, MIDDLE]
        if t.closed[lane] == 1:
            away = away % t.length[lane]
        if away < 0.0 or (away == 0.0 and owners[k] > me):
            continue
        free = away - rows[k, HALF] - half
        if free < gap:
            gap, speed, owner = free, rows[k, SPEED], owners[k]
    return gap, speed, owner


PARTS = (fill, fill_lines, _put, _touch, ahead, behind, project, wrapped)
"""Compiled functions of this module."""
