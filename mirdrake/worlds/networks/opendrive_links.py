"""Connections of the lanes of an OpenDRIVE file.

After ASAM OpenDRIVE, chapters "Lane linkage" and "Junctions": lanes are joined by the links of lane sections, by the
links of roads, and by the lane links of the connections of a junction. A joint has no direction: which of two joined
lanes follows the other results from their directions of travel.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal
from xml.etree.ElementTree import Element

import scipy  # it imports its parts when they are first used

from mirdrake.worlds.networks.lane import Lane
from mirdrake.worlds.networks.opendrive_road import RoadLanes

End = Literal["start", "end"]
Port = tuple[str, End]
"""A lane and one of its ends in the direction of the reference line."""

_CLOSE = (0.05, math.radians(2.0))  # [m], [rad] within which lanes are joined that the file does not link


@dataclass(frozen=True)
class Links:
    """Connections of all lanes."""

    following: dict[str, list[str]]
    """successors of each lane"""
    added: int
    """connections that the file leaves out, from the geometry"""
    wrong: tuple[str, ...]
    """connections of lanes whose directions of travel do not match"""


def lane_id(road: str, section: int, number: int | str) -> str:
    """Return the id of a lane in a network."""
    return f"{road}.{section}.{number}"


def find_links(root: Element, roads: Mapping[str, RoadLanes], lanes: Mapping[str, Lane]) -> Links:
    """Return the connections of lanes.

    Args:
        root: element of the file.
        roads: its roads by id.
        lanes: their lanes by id, without connections.
    """
    joints = [joint for road in roads.values() for joint in _of_road(road, roads)]
    joints += [joint for junction in root.iterfind("junction") for joint in _of_junction(junction, roads)]
    following: dict[str, list[str]] = {name: [] for name in lanes}
    wrong: list[str] = []
    # Links are stated from both sides, in either order; the directions of travel decide which lane comes first.
    for first, second in dict.fromkeys(joints):
        if first[0] not in lanes or second[0] not in lanes:
            continue
        # Whether traffic leaves the lane at this end: one side must leave and the other one enter.
        exits = [(lanes[name].direction > 0) == (end == "end") for name, end in (first, second)]
        if exits[0] == exits[1]:
            wrong.append(f"{first[0]} and {second[0]}")
            continue
        before, after = (first[0], second[0]) if exits[0] else (second[0], first[0])
        if after not in following[before]:
            following[before].append(after)
    added = _add_by_geometry(roads, lanes, following)
    return Links(following, added, tuple(wrong))


def miss(a: Lane, b: Lane) -> tuple[float, float]:
    """Return the distance [m] and the difference in heading [rad] from the end of a lane to the start of another."""
    gap = math.hypot(a.x[-1] - b.x[0], a.y[-1] - b.y[0])
    return gap, abs(math.remainder(float(a.yaw[-1] - b.yaw[0]), 2.0 * math.pi))


# --- links of the file --------------------------------------------------------------------------------------------


def _of_road(road: RoadLanes, roads: Mapping[str, RoadLanes]) -> Iterator[tuple[Port, Port]]:
    """Yield the joints of the lane sections of a road, and those with the roads that it is linked to."""
    last = len(road.sections) - 1
    for i, section in enumerate(road.sections):
        for number, row in section.lanes.items():
            for key, own, beside in (("predecessor", "start", i - 1), ("successor", "end", i + 1)):
                # A lane may be linked to several ones where it splits.
                for link in row.element.iterfind(f"link/{key}"):
                    other = link.get("id", "")
                    port: Port = (lane_id(road.id, i, number), own)  # type: ignore[assignment]
                    if 0 <= beside <= last:
                        # Within a road, the end of a section meets the start of the next one.
                        yield port, (lane_id(road.id, beside, other), "end" if own == "start" else "start")
                    elif (neighbour := _linked(road, key, roads)) is not None:
                        linked, end = neighbour
                        at = 0 if end == "start" else len(linked.sections) - 1
                        yield port, (lane_id(linked.id, at, other), end)


def _linked(road: RoadLanes, key: str, roads: Mapping[str, RoadLanes]) -> tuple[RoadLanes, End] | None:
    """Return the road to which a road is linked, and the end of it; None for a junction."""
    link = road.element.find(f"link/{key}")
    if link is None or link.get("elementType", "road") != "road":
        return None
    other = roads.get(link.get("elementId", ""))
    if other is None:
        return None
    contact = link.get("contactPoint")
    own: End = "start" if key == "predecessor" else "end"
    return other, contact if contact in {"start", "end"} else _nearest_end(other, road, own)  # type: ignore[return-value]


def _of_junction(junction: Element, roads: Mapping[str, RoadLanes]) -> Iterator[tuple[Port, Port]]:
    """Yield the joints of the connections of a junction: incoming lane with connecting, or directly linked, lane."""
    for connection in junction.iterfind("connection"):
        incoming = roads.get(connection.get("incomingRoad", ""))
        other = roads.get(connection.get("connectingRoad") or connection.get("linkedRoad") or "")
        if incoming is None or other is None:
            continue
        contact = connection.get("contactPoint")
        end: End = contact if contact in {"start", "end"} else "start"  # type: ignore[assignment]
        # The file states which end of the connecting road is used, but not which end of the incoming one.
        own = _nearest_end(incoming, other, end)
        at = 0 if end == "start" else len(other.sections) - 1
        here = 0 if own == "start" else len(incoming.sections) - 1
        for link in connection.iterfind("laneLink"):
            yield (
                (lane_id(incoming.id, here, link.get("from", "")), own),
                (lane_id(other.id, at, link.get("to", "")), end),
            )


def _nearest_end(road: RoadLanes, other: RoadLanes, end: End) -> End:
    """Return the end of a road that is nearest to an end of another road."""
    x, y, _, _ = other.place(0.0 if end == "start" else other.length, 0.0)

    def distance(s: float) -> float:
        px, py, _, _ = road.place(s, 0.0)
        return math.hypot(px - x, py - y)

    return "start" if distance(0.0) < distance(road.length) else "end"


# --- links that the file leaves out -------------------------------------------------------------------------------


def _add_by_geometry(roads: Mapping[str, RoadLanes], lanes: Mapping[str, Lane], following: dict[str, list[str]]) -> int:
    """Add connections of lanes for motor vehicles that meet, where the file links neither; return their number.

    The connections of junctions are not guessed: only lanes that have no successor are joined with lanes that have no
    predecessor, and their roads must be linked.
    """
    preceded = {name for names in following.values() for name in names}
    # A stated link is never contradicted by the geometry.
    ends = [lane for lane in lanes.values() if lane.kind == "driving" and not following[lane.id]]
    starts = [lane for lane in lanes.values() if lane.kind == "driving" and lane.id not in preceded]
    if not ends or not starts:
        return 0
    # Only pairs that are close: all pairs of a map without links would be too many.
    begins = scipy.spatial.cKDTree([(lane.x[0], lane.y[0]) for lane in starts])
    near = begins.query_ball_point([(lane.x[-1], lane.y[-1]) for lane in ends], _CLOSE[0], return_sorted=True)
    added = 0
    for end, indices in zip(ends, near, strict=True):
        for start in (starts[index] for index in indices):
            gap, turn = miss(end, start)
            if end is not start and gap < _CLOSE[0] and turn < _CLOSE[1] and _are_linked(roads, end, start):
                following[end.id].append(start.id)
                added += 1
    return added


def _are_linked(roads: Mapping[str, RoadLanes], end: Lane, start: Lane) -> bool:
    """Return whether the roads of two lanes are linked with each other or by a junction."""
    first, second = roads[end.road], roads[start.road]
    if first is second:
        return True
    for a, b in ((first, second), (second, first)):
        for link in (*a.element.iterfind("link/predecessor"), *a.element.iterfind("link/successor")):
            is_road = link.get("elementType", "road") == "road"
            if link.get("elementId") == (b.id if is_road else b.junction):
                return True
    return False
