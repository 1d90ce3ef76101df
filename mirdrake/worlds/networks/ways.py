"""Ways through the junctions of a network: where one waits before them, and the places of conflict on them.

A way begins at a line: the stop line before the junction, else the begin of its first lane in it. It ends where it
leaves the junction. Lanes of tracks that follow lanes of the network, such as routes, have ways of their own.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mirdrake.worlds.networks.conflicts import Conflict
from mirdrake.worlds.networks.lane import Lane
from mirdrake.worlds.networks.network import Network
from mirdrake.worlds.networks.right_of_way import controls_of, entry_of

_BEFORE = 15.0  # [m] before a junction in which a stop line belongs to it
_START = 1.0  # [m/s²] acceleration of the intelligent driver model from standstill
_LENGTH = 5.0  # [m] of a car that must have left the conflict
_GAPS = (3.0, 8.0)  # [s] range of critical gaps
_OCCUPIED = 1.0  # [s] before the conflict, in which a vehicle within the junction occupies it
_BESIDE = 1.0  # [m] largest distance of a lane from one that it follows
_ALONG = math.radians(30.0)  # largest angle between them


@dataclass(frozen=True)
class Zone:
    """A place of conflict on a way."""

    begin: float
    """distance from the line [m]"""
    end: float
    """[m]"""
    other: str
    """lane of the network that the way meets there"""
    span: tuple[float, float]
    """begin and end of the place on that lane [m]"""
    yields: bool
    """the other lane has priority"""
    prior: bool
    """this way has priority"""
    gap: float
    """critical gap for a vehicle on the other lane [s]"""


@dataclass(frozen=True)
class Way:
    """A way through a junction."""

    junction: str
    lane: str
    """first lane in the junction, or lane of a track that follows it"""
    s: float
    """station of the line on the lane; negative: before its begin, on a lane that leads to it [m]"""
    length: float
    """from the line to the end of the junction [m]"""
    lanes: tuple[tuple[str, float], ...]
    """lanes of the network within the junction, and the distances of their begins from the line [m]"""
    stops: bool
    """a stop sign: vehicles stop at the line before they request to pass"""
    zones: tuple[Zone, ...]
    """places of conflict"""


def find_ways(network: Network, lanes: Mapping[str, Lane]) -> tuple[Way, ...]:
    """Return the ways through all junctions of a network.

    Args:
        network: the network.
        lanes: its lanes for motor vehicles, and the lanes of tracks; by id.
    """
    conflicts: dict[str, list[Conflict]] = {}
    for conflict in network.conflicts:
        if conflict.kind != "split":
            for name in conflict.lanes:
                conflicts.setdefault(name, []).append(conflict)
    ways = list(_ways_of_network(network))
    entries = {way.lane: way for way in ways}
    for lane in lanes.values():
        if lane.id not in network.lanes:
            ways += _ways_along(network, lane, entries)
    return tuple(replace(way, zones=tuple(_zones(network, way, conflicts))) for way in ways)


def _ways_of_network(network: Network) -> Iterator[Way]:
    """Yield the ways along the first successors of each lane that enters a junction; without zones."""
    controls = controls_of(network)
    lines: dict[str, float] = {}
    for line in network.stop_lines:
        lines[line.lane] = max(line.s, lines.get(line.lane, 0.0))
    for lane in network.driving():
        if lane.junction is None or lane.junction in {network.lanes[name].junction for name in lane.predecessors}:
            continue
        # The line before the junction that is nearest to it.
        before = [network.lanes[name].length - lines[name] for name in lane.predecessors if name in lines]
        setback = min((one for one in before if one <= _BEFORE), default=0.0)
        inner: list[tuple[str, float]] = []
        distance = setback
        name: str | None = lane.id
        while name is not None and network.lanes[name].junction == lane.junction and len(inner) <= len(network.lanes):
            inner.append((name, distance))
            distance += network.lanes[name].length
            name = next(iter(network.lanes[name].successors), None)
        signs = {controls.get(one, "none") for one in (lane.id, *lane.predecessors)}
        yield Way(lane.junction, lane.id, -setback, distance, tuple(inner), "stop" in signs, ())


def _ways_along(network: Network, lane: Lane, entries: Mapping[str, Way]) -> Iterator[Way]:
    """Yield the ways on the lane of a track, wherever it follows lanes through a junction.

    Args:
        network: the network.
        lane: the lane.
        entries: ways of the network, by their first lanes.
    """
    inner = [one for one in network.driving() if one.junction is not None]
    if not inner:
        return
    # The begin, the middle and the end of each lane in a junction, on this lane.
    shares = np.array([[0.0], [0.5], [1.0]]) * [one.length for one in inner]
    x, y, yaw = (
        np.array(part) for part in zip(*(one.pose(s) for one, s in zip(inner, shares.T, strict=True)), strict=True)
    )
    s, offset = lane.project(x, y)
    turn = np.abs(np.remainder(lane.pose(s)[2] - yaw + math.pi, 2.0 * math.pi) - math.pi)
    followed = (
        (np.abs(offset) < _BESIDE).all(axis=1) & (turn < _ALONG).all(axis=1) & (np.diff(s, axis=1) > 0.0).all(axis=1)
    )
    found = sorted((float(s[k, 0]), float(s[k, 2]), inner[k].id) for k in np.flatnonzero(followed))
    for begin, end, name in found:
        if name not in entries:
            continue
        entry = entries[name]
        parts, at = [(name, -entry.s)], end
        # The following lanes of the same junction that this lane follows as well.
        for first, last, other in found:
            follows = other in network.lanes[parts[-1][0]].successors and abs(first - at) < _BESIDE
            if follows and network.lanes[other].junction == entry.junction:
                parts.append((other, first - begin - entry.s))
                at = last
        yield Way(entry.junction, lane.id, begin + entry.s, at - begin - entry.s, tuple(parts), entry.stops, ())


def _zones(network: Network, way: Way, conflicts: Mapping[str, list[Conflict]]) -> Iterator[Zone]:
    approach = set(network.lanes[way.lanes[0][0]].predecessors)
    for name, distance in way.lanes:
        for conflict in conflicts.get(name, []):
            other = conflict.other(name)
            # Vehicles from one approach follow each other.
            if approach & set(network.lanes[entry_of(network.lanes, other)].predecessors):
                continue
            begin, end = (distance + s for s in conflict.span(name))
            yields = (other, name) in network.priorities
            # From standstill with constant acceleration: s = a t² / 2.
            time = math.sqrt(2.0 * (end + _LENGTH) / _START)
            gap = min(max(time, _GAPS[0]), _GAPS[1]) if yields else _OCCUPIED
            yield Zone(begin, end, other, conflict.span(other), yields, (name, other) in network.priorities, gap)


@dataclass(frozen=True)
class Meeting:
    """A conflict of two ways: the place on the first one, from the first to the last of several."""

    way: int
    """number of the first way"""
    other: int
    """number of the other one"""
    begin: float
    """distance from the line of the first way [m]"""
    end: float
    """[m]"""
    yields: bool
    """the other way has priority"""
    gap: float
    """critical gap for a vehicle on the other way [s]"""


def meetings(ways: Sequence[Way]) -> Iterator[Meeting]:
    """Yield the pairs of ways that conflict, each in both orders; ways are numbered as given."""
    by_lane: dict[str, list[int]] = {}
    for number, way in enumerate(ways):
        for name, _ in way.lanes:
            by_lane.setdefault(name, []).append(number)
    for number, way in enumerate(ways):
        zones: dict[int, list[Zone]] = {}
        for zone in way.zones:
            for other in by_lane.get(zone.other, []):
                zones.setdefault(other, []).append(zone)
        for other, places in zones.items():
            yield Meeting(
                number,
                other,
                min(zone.begin for zone in places),
                max(zone.end for zone in places),
                # Neither yields where the priorities at several places are opposite.
                any(zone.yields for zone in places) and not any(zone.prior for zone in places),
                max(zone.gap for zone in places),
            )
