"""Right of way in junctions: vehicles reserve their ways through a junction, and wait at the line until they have them.

One law for actors on lanes and for full vehicles with the driver ``traffic``:

1. A way through a junction is reserved as a whole, before the line: no vehicle waits within a junction for another one.
   Ways that follow each other with no room between them, as in a roundabout, are reserved together. Two ways that
   conflict are not reserved at the same time, except where the first vehicle has left the place of conflict.
2. A vehicle requests its way at the distance at which it would begin to brake for the line. It is the first before the
   line, its light is not red, and there is room for it behind the junction. At a stop sign it has stopped at the line.
3. Requests have a total order: vehicles with priority come before those that yield to them; apart from that, first
   come, first served; at the same time, in the order of the names. Of vehicles that wait for one another in a circle,
   the one that came first is the first.
4. In this order, a request is granted if its way conflicts with no reserved one and with none of an earlier request,
   and if no other vehicle with priority arrives within the critical gap.
5. One that has waited for 180 s yields no longer: its request comes before those that have not been granted, and it
   does not wait for vehicles that have not requested their way. These still have room to brake for the line. It is the
   law of impatience of SUMO (docs "Vehicle parameters", `impatience`; `--time-to-impatience`, 180 s) at its upper end,
   where others are assumed to brake.

The first request in the order waits only for vehicles that have reserved their ways, and these wait for none: they
pass, so that each vehicle passes after finitely many others. First come, first served is the rule of reservations of
K. Dresner and P. Stone, "A multiagent approach to autonomous intersection management", JAIR 31, 2008. Their all-way
stop is the case in which vehicles request after a stop. The priorities are those of the network.
"""

import math
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from mirdrake.actors.behaviours import idm
from mirdrake.actors.behaviours.base import LIMIT
from mirdrake.actors.lanes import LaneTable, project
from mirdrake.actors.occupancy import LINE, ahead, arrives
from mirdrake.core.compiled import Records, record_type
from mirdrake.worlds.pieces import Array


class WayRow(NamedTuple):
    """A way through a junction, see :class:`mirdrake.worlds.networks.ways.Way`."""

    lane: int
    """number of its lane"""
    junction: int
    """number of the junction"""
    s: float
    """station of the line [m]"""
    length: float
    """from the line to the end of the junction [m]"""
    stops: int
    """1: a stop sign"""
    first: int
    """its first meeting"""
    last: int
    """one behind its last meeting"""
    begin: int
    """first of the lanes from which others come"""
    end: int
    """one behind the last of them"""


class MeetingRow(NamedTuple):
    """A conflict of a way with another one."""

    other: int
    """number of the other way"""
    begin: float
    """place on this way, from the line [m]"""
    end: float
    """[m]"""
    other_begin: float
    """place on the other way [m]"""
    other_end: float
    """[m]"""
    yields: int
    """1: the other way has priority"""
    gap: float
    """critical gap [s]"""


class ComingRow(NamedTuple):
    """A lane from which others come to a place of conflict on a way."""

    lane: int
    """number of the lane"""
    begin: float
    """place on the lane of the conflict [m]"""
    end: float
    """[m]"""
    gap: float
    """critical gap [s]"""
    distance: float
    """from the begin of the lane to that of the lane of the conflict [m]"""


class Ways(NamedTuple):
    """All ways through junctions, by the numbers of their lanes and by their stations."""

    rows: Records
    """:class:`WayRow` (w)"""
    meetings: Records
    """:class:`MeetingRow`"""
    coming: Records
    """:class:`ComingRow`"""
    begins: npt.NDArray[np.int64]
    """first way of each lane, and the number of ways (l + 1)"""


class Driver(NamedTuple):
    """How an actor or a vehicle drives through junctions."""

    obeys: int
    """1: by the right of way"""
    first: int
    """of a vehicle: first lane of its track"""
    last: int
    """one behind the last one"""


class Claim(NamedTuple):
    """What an actor or a vehicle reserves."""

    way: float
    """number of the next way, -1: none"""
    distance: float
    """from its front to the line [m]"""
    since: float
    """time of its request [s]; infinite: none"""
    closed: float
    """1: it must not pass the line"""
    held: tuple[float, float, float, float, float, float, float, float]
    """numbers of the ways that it is on or has reserved, -1: none"""


CLAIM: Final = record_type(Claim)
"""Type of the records of :class:`Claim`: floats only, as that of the states of actors."""

HELD: Final = 8
"""Most ways that one is on or has reserved."""

_HOPS = 20  # lanes ahead that are searched
_FAR = 150.0  # [m] distance to which they are searched
_BEYOND = 2.0  # [m] added to the distance of requests: one that has stopped before the line requests
_STOPPED = 0.1  # [m/s] speed of one that has stopped
_SLOW = 2.0  # [m/s] one slower than this can come to a stop where it is
_BEFORE = 1.0  # [m] behind the line in which a red light counts
_CLEAR = 2.0  # [m] before a place of conflict that must be free
_PATIENCE = 180.0  # [s] of waiting after which one yields no longer


def reserve(
    t: LaneTable, ways: Ways, drivers: Records, numbers: Array, shape: Array, now: Records, vehicles: Array,
    time: float, objects: Records, known: int, count: int, claims: Records,
) -> None:  # fmt: skip
    """Update the claims of all actors and vehicles.

    Args:
        t: lanes.
        ways: ways through junctions.
        drivers: :class:`Driver` of the actors, then of the vehicles (n + m).
        numbers: parameters of their behaviours (n + m, 12).
        shape: front, rear and half of the width of them (n + m, 3) [m].
        now: states of the actors (n).
        vehicles: x, y, yaw, vx, vy of the vehicles (m, 5) [m, rad, m/s].
        time: since the start [s].
        objects: objects on lanes, then stop lines.
        known: number of objects without stop lines.
        count: number of both.
        claims: :class:`Claim` (n + m); changed.
    """
    n, total = len(now), len(claims)
    lanes, places, speeds = np.full(total, -1, np.int64), np.zeros(total), np.zeros(total)
    # Who drives by the right of way: its lane, the station of its middle, its speed, the ways that it is on, and those
    # that it needs next; `ends` are the distances from its front to the end of the last one of these.
    chains, ends = np.full((total, HELD), -1, np.int64), np.zeros(total)
    for i in range(total):
        if drivers[i].obeys == 1:
            if i < n:
                lanes[i], speeds[i] = int(now[i].lane), now[i].v
                places[i] = now[i].s + 0.5 * (shape[i, 0] - shape[i, 1])
            else:
                lanes[i], places[i] = on_track(t, drivers[i], shape[i], vehicles[i - n])
                speeds[i] = math.hypot(vehicles[i - n, 3], vehicles[i - n, 4])
        half = 0.5 * (shape[i, 0] + shape[i, 1])
        ends[i] = advance(t, ways, lanes[i], places[i] + half, 2.0 * half, room(numbers[i], half), claims[i], chains[i])

    # Requests: 0 none, 1 not yet possible, 2 waits, 3 reserved. All are decided from the claims at the begin.
    kinds = np.zeros(total, np.int64)
    for i in range(total):
        drives = lanes[i] >= 0 and (i >= n or (now[i].started > 0.0 and now[i].held == 0.0 and now[i].desired > 0.0))
        if drives and claims[i].way >= 0.0:
            kinds[i] = request(
                t, ways, numbers[i], shape[i], i, lanes[i], places[i], speeds[i], ends[i], objects, known, count, lanes,
                chains[i], claims,
            )  # fmt: skip
    for i in range(total):
        claims[i].since = min(claims[i].since, time) if kinds[i] > 0 else math.inf
        # A request that is no longer valid gives back what it has reserved.
        if kinds[i] != 3:
            for k in range(HELD):
                if is_next(chains[i], claims[i].held[k]):
                    claims[i].held[k] = -1.0
    grant(t, ways, speeds, shape, time, objects, known, lanes, places, kinds, chains, claims)
    # A line is closed for all that are near enough to request, and have not reserved their way.
    for i in range(total):
        near = claims[i].way >= 0.0 and claims[i].distance <= request_distance(numbers[i], speeds[i])
        claims[i].closed = 1.0 if near and kinds[i] != 3 else 0.0


def on_track(t: LaneTable, driver: Any, shape: Array, vehicle: Array) -> tuple[int, float]:
    """Return the lane of its track on which a vehicle is, -1: beside all of them, and the station of its middle [m]."""
    middle = 0.5 * (shape[0] - shape[1])
    x, y = vehicle[0] + middle * math.cos(vehicle[2]), vehicle[1] + middle * math.sin(vehicle[2])
    best, lane, place = math.inf, -1, 0.0
    for number in range(driver.first, driver.last):
        s, aside = project(t, number, x, y)
        if abs(aside) < best and abs(aside) < t.lanes[number].width:
            best, lane, place = abs(aside), number, s
    return lane, place


def room(numbers: Array, half: float) -> float:
    """Return the distance between two junctions in which one can wait [m]; `half`: half of its length."""
    return float(2.0 * half + numbers[idm.STANDSTILL] + _BEYOND)


def advance(
    t: LaneTable, ways: Ways, lane: int, front: float, size: float, between: float, claim: Any,
    chain: npt.NDArray[np.int64],
) -> float:  # fmt: skip
    """Update the ways that one is on, its next way and those that it needs with it; return where the last one ends.

    Args:
        t: lanes.
        ways: ways through junctions.
        lane: lane of its middle; -1: none, and it has no ways.
        front: station of its front on that [m].
        size: its length [m].
        between: distance between two junctions in which it can wait [m].
        claim: its claim; changed.
        chain: the next way, and those that follow it without room between them, -1: none; written.

    Returns:
        distance from its front to the end of the last way of the chain [m].
    """
    length, end, base, at = 0, 0.0, 0.0, lane
    for _ in range(_HOPS if lane >= 0 else 0):
        for w in range(ways.begins[at], ways.begins[at + 1]):
            away = base + ways.rows[w].s - front
            # Its front has passed the line, its rear is not yet behind the junction.
            if -(ways.rows[w].length + size) < away <= 0.0:
                hold(claim, w)
            elif away > 0.0 and length < HELD - 2 and (length == 0 or away < end + between):
                if length == 0:
                    distance = away
                chain[length] = w
                length += 1
                end = away + ways.rows[w].length
            elif away > 0.0:
                at = -1
                break
        if at < 0:
            break
        base += t.lanes[at].length
        at = t.lanes[at].successors[0]
        if at < 0 or base - front > _FAR:
            break
    # Ways that it has left; those before it are left only together with its lane.
    for k in range(HELD):
        way = claim.held[k]
        if way < 0.0 or is_next(chain, way):
            continue
        if lane < 0 or progress(t, ways, int(way), lane, front) - size > ways.rows[int(way)].length:
            claim.held[k] = -1.0
    if float(chain[0]) != claim.way:
        claim.since = math.inf
    claim.way, claim.distance = float(chain[0]), distance if length > 0 else math.inf
    return end


def hold(claim: Any, way: int) -> None:
    """Add a way to those that one holds, if it is not among them."""
    free = 0
    for k in range(HELD):
        if claim.held[k] == float(way):
            return
        if claim.held[k] < 0.0:
            free = k
    claim.held[free] = float(way)


def is_next(chain: npt.NDArray[np.int64], way: float) -> bool:
    """Return whether a way is among the next ones."""
    found = False
    for k in range(HELD):
        found = found or (way >= 0.0 and float(chain[k]) == way)
    return found


def holds(ways: Ways, claim: Any, junction: int) -> bool:
    """Return whether one is on a way through a junction or has reserved one."""
    found = False
    for k in range(HELD):
        found = found or in_junction(ways, claim.held[k], junction)
    return found


def progress(t: LaneTable, ways: Ways, way: int, lane: int, front: float) -> float:
    """Return the distance from the line of a way to a station on a lane [m]; infinite if it does not lead there."""
    # The line may be on the lane before that of the way.
    if t.lanes[lane].successors[0] == ways.rows[way].lane and front - t.lanes[lane].length > ways.rows[way].s:
        return float(front - t.lanes[lane].length - ways.rows[way].s)
    base, at = 0.0, ways.rows[way].lane
    for _ in range(_HOPS):
        if at == lane:
            return float(base + front - ways.rows[way].s)
        base += t.lanes[at].length
        at = t.lanes[at].successors[0]
        if at < 0:
            break
    return math.inf


def request_distance(numbers: Array, speed: float) -> float:
    """Return the distance of the line at which one requests its way [m]: the gap that its law keeps to an obstacle."""
    dynamic = speed * numbers[idm.HEADWAY] + 0.5 * speed * speed / math.sqrt(
        numbers[idm.ACCELERATION] * numbers[idm.DECELERATION]
    )
    return float(numbers[idm.STANDSTILL] + dynamic + _BEYOND)


def request(
    t: LaneTable, ways: Ways, numbers: Array, shape: Array, i: int, lane: int, middle: float, speed: float, end: float,
    objects: Records, known: int, count: int, lanes: npt.NDArray[np.int64], chain: npt.NDArray[np.int64],
    claims: Records,
) -> int:  # fmt: skip
    """Return the state of the request of one: 0 none, 1 not yet possible, 2 waits, 3 reserved before and still valid.

    Args:
        t: lanes.
        ways: ways through junctions.
        numbers: parameters of its behaviour (12).
        shape: its front, rear and half of the width (3) [m].
        i: its number.
        lane: its lane.
        middle: station of its middle [m].
        speed: [m/s].
        end: distance from its front to the end of the ways that it needs [m].
        objects: objects on lanes, then stop lines.
        known: number of objects without stop lines.
        count: number of both.
        lanes: lanes of all that drive by the right of way, -1 for others.
        chain: the ways that it needs.
        claims: claims of all.
    """
    claim = claims[i]
    row, distance, half = ways.rows[int(claim.way)], claim.distance, 0.5 * (shape[0] + shape[1])
    reserved, inside = False, False
    for k in range(HELD):
        reserved = reserved or claim.held[k] == claim.way
        inside = inside or (claim.held[k] >= 0.0 and not is_next(chain, claim.held[k]))
    # Within a junction it keeps what it has reserved. Or it cannot stop before the line any more, not even by its
    # hardest braking.
    if (reserved and inside) or distance <= 0.5 * speed * speed / numbers[LIMIT]:
        return 3
    if distance > request_distance(numbers, speed):
        return 0
    # A red light, or amber at which it stops; both in the same direction as the line.
    stop = 0.5 * speed * speed / numbers[idm.DECELERATION]
    light, _, _ = ahead(
        t, lane, middle, half, -shape[2], shape[2], i, _FAR, stop, speed, objects[known:], count - known
    )
    if light < distance + _BEFORE:
        return 0
    # It is the first before the line: the next one ahead has reserved its way, or is already in the junction.
    gap, other_speed, owner = ahead(t, lane, middle, half, -shape[2], shape[2], i, _FAR, 0.0, 0.0, objects, known)
    if gap < distance and (owner < 0 or lanes[owner] < 0 or not holds(ways, claims[owner], row.junction)):
        return 0
    has_stopped = speed <= _STOPPED and distance <= numbers[idm.STANDSTILL] + _BEYOND
    if row.stops == 1 and claim.since == math.inf and not has_stopped:
        return 0
    # Room behind the junction: one ahead that may come to a stop must not keep it within the junction.
    if other_speed < _SLOW and gap < end + 2.0 * half + numbers[idm.STANDSTILL]:
        return 1
    return 3 if reserved else 2


def in_junction(ways: Ways, way: float, junction: int) -> bool:
    """Return whether a way, -1: none, leads through a junction."""
    return way >= 0.0 and ways.rows[int(way)].junction == junction


def meeting(ways: Ways, way: float, other: float) -> int:
    """Return the number of the meeting of a way with another one; -1: they do not conflict."""
    for k in range(ways.rows[int(way)].first, ways.rows[int(way)].last):
        if ways.meetings[k].other == int(other):
            return k
    return -1


def conflict(ways: Ways, chain: npt.NDArray[np.int64], other: npt.NDArray[np.int64]) -> bool:
    """Return whether one of some ways conflicts with one of some other ways."""
    for a in range(HELD):
        for b in range(HELD):
            if chain[a] >= 0 and other[b] >= 0 and meeting(ways, float(chain[a]), float(other[b])) >= 0:
                return True
    return False


def yields(ways: Ways, chain: npt.NDArray[np.int64], other: npt.NDArray[np.int64]) -> bool:
    """Return whether one on some ways yields to one on some other ways; not if each yields somewhere."""
    mine, theirs = False, False
    for a in range(HELD):
        for b in range(HELD):
            if chain[a] < 0 or other[b] < 0:
                continue
            k = meeting(ways, float(chain[a]), float(other[b]))
            if k >= 0:
                mine = mine or ways.meetings[k].yields == 1
                back = meeting(ways, float(other[b]), float(chain[a]))
                theirs = theirs or ways.meetings[back].yields == 1
    return mine and not theirs


def grant(
    t: LaneTable, ways: Ways, speeds: Array, shape: Array, time: float, objects: Records, known: int,
    lanes: npt.NDArray[np.int64], places: Array, kinds: npt.NDArray[np.int64], chains: npt.NDArray[np.int64],
    claims: Records,
) -> None:  # fmt: skip
    """Grant the requests for ways through junctions, one after the other in the order of :func:`next_in_order`.

    Arrays have a row for each of the n actors, then for each of the m vehicles.

    Args:
        t: lanes.
        ways: ways through junctions.
        speeds: speeds (n + m) [m/s].
        shape: front, rear and half of the width (n + m, 3) [m].
        time: time since the start [s].
        objects: objects on lanes.
        known: number of the objects on lanes.
        lanes: lanes of those that obey the right of way, -1 for the others (n + m).
        places: stations of their middles (n + m) [m].
        kinds: states of the requests; those that are granted are changed to 3.
        chains: the ways that each needs next (n + m, 8).
        claims: claims of all; changed.
    """
    total = len(claims)
    # Reserved ways, and the distance of the rear of those who have them from the line.
    held, rears, owners, reserved = np.empty(HELD * total), np.empty(HELD * total), np.empty(HELD * total, np.int64), 0
    for i in range(total):
        half = 0.5 * (shape[i, 0] + shape[i, 1])
        if kinds[i] == 3:
            hold_all(claims[i], chains[i])
        for k in range(HELD):
            way = claims[i].held[k]
            if way >= 0.0:
                held[reserved], rears[reserved], owners[reserved] = way, -math.inf, i
                if not is_next(chains[i], way):
                    rears[reserved] = progress(t, ways, int(way), lanes[i], places[i] + half) - 2.0 * half
                reserved += 1

    waiting = np.flatnonzero(kinds == 2)
    placed = np.zeros(len(waiting), np.bool_)
    for _ in range(len(waiting)):
        position = next_in_order(ways, waiting, placed, chains, time, claims)
        placed[position] = True
        i = waiting[position]
        free = True
        for k in range(HELD):
            way = float(chains[i, k])
            for h in range(reserved if way >= 0.0 else 0):
                number = meeting(ways, way, held[h]) if owners[h] != i else -1
                if number >= 0 and rears[h] <= ways.meetings[number].other_end:
                    free = False
        # One that is earlier in the order and still waits keeps its turn.
        for other in range(len(waiting)):
            j = waiting[other]
            if free and placed[other] and kinds[j] == 2 and j != i and conflict(ways, chains[i], chains[j]):
                free = False
        for k in range(HELD):
            if free and chains[i, k] >= 0:
                free = not must_yield(ways, i, chains[i, k], speeds, time, objects, known, lanes, kinds, claims)
        if free:
            kinds[i] = 3
            hold_all(claims[i], chains[i])
            for k in range(HELD):
                if chains[i, k] >= 0 and reserved < len(held):
                    held[reserved], rears[reserved], owners[reserved] = float(chains[i, k]), -math.inf, i
                    reserved += 1


def hold_all(claim: Any, chain: npt.NDArray[np.int64]) -> None:
    """Add all ways of a chain to those that one holds."""
    for k in range(HELD):
        if chain[k] >= 0:
            hold(claim, chain[k])


def next_in_order(
    ways: Ways, waiting: npt.NDArray[np.int64], placed: npt.NDArray[np.bool_], chains: npt.NDArray[np.int64],
    time: float, claims: Records,
) -> int:  # fmt: skip
    """Return the position of the next request in the order of all.

    It is the earliest one that yields to none of the others; if each yields to another one, the earliest of a circle.
    """
    best = -1
    for k in range(len(waiting)):
        earlier = best < 0 or claims[waiting[k]].since < claims[waiting[best]].since
        if not placed[k] and earlier and first_before(ways, waiting, placed, chains, time, claims, k) < 0:
            best = k
    if best >= 0:
        return best
    # Whoever it is followed from, the chain of those to whom each one yields ends in a circle.
    k = 0
    while placed[k]:
        k += 1
    for _ in range(len(waiting)):
        k = first_before(ways, waiting, placed, chains, time, claims, k)
    best, at = k, first_before(ways, waiting, placed, chains, time, claims, k)
    while at != k:
        since = claims[waiting[at]].since
        if since < claims[waiting[best]].since or (since == claims[waiting[best]].since and at < best):
            best = at
        at = first_before(ways, waiting, placed, chains, time, claims, at)
    return best


def first_before(
    ways: Ways, waiting: npt.NDArray[np.int64], placed: npt.NDArray[np.bool_], chains: npt.NDArray[np.int64],
    time: float, claims: Records, k: int,
) -> int:  # fmt: skip
    """Return the position of the earliest request, not yet placed, to which another one yields; -1: none."""
    best = -1
    if time - claims[waiting[k]].since > _PATIENCE:
        return best
    for other in range(len(waiting)):
        if placed[other] or other == k:
            continue
        earlier = best < 0 or claims[waiting[other]].since < claims[waiting[best]].since
        if earlier and yields(ways, chains[waiting[k]], chains[waiting[other]]):
            best = other
    return best


def must_yield(
    ways: Ways, i: int, way: int, speeds: Array, time: float, objects: Records, known: int,
    lanes: npt.NDArray[np.int64], kinds: npt.NDArray[np.int64], claims: Records,
) -> bool:  # fmt: skip
    """Return whether one on a way must wait for others who have not requested one.

    Args:
        ways: ways through junctions.
        i: its number.
        way: number of the way.
        speeds: of all [m/s].
        time: since the start [s].
        objects: objects on lanes.
        known: their number.
        lanes: lanes of all that drive by the right of way, -1 for others.
        kinds: states of the requests.
        claims: claims of all.
    """
    row = ways.rows[way]
    patient = time - claims[i].since <= _PATIENCE
    # Vehicles that drive by the right of way to the same junction, and come to the place of conflict within the gap.
    for j in range(len(claims) if patient else 0):
        if j == i or lanes[j] < 0 or kinds[j] >= 2 or not in_junction(ways, claims[j].way, row.junction):
            continue
        k = meeting(ways, float(way), claims[j].way)
        if k >= 0 and ways.meetings[k].yields == 1:
            rest = claims[j].distance + ways.meetings[k].other_begin - _CLEAR
            if rest <= speeds[j] * ways.meetings[k].gap:
                return True
    # All others, on the lanes from which they come.
    for k in range(row.begin, row.end):
        come = ways.coming[k]
        for number in range(known):
            one = objects[number]
            if one.lane != come.lane or one.owner == i or one.owner == LINE:
                continue
            j = one.owner
            if lanes[j] >= 0 and (
                in_junction(ways, claims[j].way, row.junction) or holds(ways, claims[j], row.junction)
            ):
                continue
            if arrives(one, come.begin + come.distance, come.end - come.begin, come.gap, 0.0):
                return True
    return False


PARTS = (
    on_track, room, advance, hold, is_next, holds, progress, request_distance, request, in_junction, meeting, conflict,
    yields, grant, hold_all, next_in_order, first_before, must_yield, project,
)  # fmt: skip
"""Compiled functions of this module."""
