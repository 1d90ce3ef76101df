"""What a road network leaves out of an OpenDRIVE file, or approximates."""

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from xml.etree.ElementTree import Element

from mirdrake.core.xml_reader import count_unread
from mirdrake.worlds.networks.network import DRIVEN, Network, Note
from mirdrake.worlds.networks.opendrive_links import Links, miss
from mirdrake.worlds.networks.opendrive_road import RoadLanes

_APART = (0.01, math.radians(0.5))  # [m], [rad] above which a connection is reported

# Elements that are read; those whose parts are read or reported with them; those that describe the file.
_READ = {
    "header", "offset", "road", "link", "predecessor", "successor", "type", "speed", "planView", "elevationProfile",
    "elevation", "lateralProfile", "superelevation", "lanes", "laneOffset", "laneSection", "left", "center", "right",
    "lane", "width", "border", "objects", "signals", "controller", "control", "junction", "connection", "laneLink",
    "priority",
}  # fmt: skip
_LEAVES = {"geometry", "roadMark", "object", "signal", "signalReference"}
_METADATA = {"userData", "dataQuality", "license", "geoReference"}
_MEANING = {"shape": ", cross-section profiles", "height": " of lanes above the road, for example of kerbs"}


def continuity(network: Network) -> Iterator[tuple[str, str, float, float]]:
    """Yield all connections of lanes for motor vehicles: both ids, the gap [m] and the difference in heading [rad]."""
    for lane in network.driving():
        for name in lane.successors:
            if network.lanes[name].kind in DRIVEN:
                yield lane.id, name, *miss(lane, network.lanes[name])


def omissions(root: Element, roads: Mapping[str, RoadLanes], network: Network, links: Links) -> Iterator[Note]:
    """Yield the parts of the file that are left out or approximated.

    Args:
        root: element of the file.
        roads: its roads by id.
        network: the network that was made of them.
        links: the connections of its lanes.
    """
    # What this reader adds or drops changes where cars can go, so each kind is reported with its number.
    if links.added:
        yield Note("connections of lanes that the file leaves out", f"{links.added} added, where lanes meet")
    if links.wrong:
        yield Note(
            "connections of lanes with opposite directions, left out", f"{len(links.wrong)}, first {links.wrong[0]}"
        )
    # Gap and angle are weighed by their tolerances to find the worst connection.
    apart = [row for row in continuity(network) if row[2] > _APART[0] or row[3] > _APART[1]]
    if apart:
        a, b, gap, turn = max(apart, key=lambda row: row[2] / _APART[0] + row[3] / _APART[1])
        count = sum(1 for _ in continuity(network))
        worst = f"worst {a} to {b}, {gap:.3g} m and {math.degrees(turn):.2g} deg"
        yield Note("lanes that do not meet", f"{len(apart)} of {count} connections; {worst}")
    if missing := list(_missing_ends(root, roads)):
        yield Note("links to roads or junctions that the file does not contain", f"{len(missing)}, first {missing[0]}")
    kinds = Counter(element.get("type") for element in root.iterfind("junction"))
    if virtual := kinds["virtual"]:
        yield Note("virtual junctions, whose connections begin within a road", f"{virtual}")
    for tag, count in count_unread(root, read=_READ, leaves=_LEAVES, metadata=_METADATA).items():
        yield Note(f"elements <{tag}>{_MEANING.get(tag, '')}", f"{count}")
    offset = root.find("header/offset")
    # An offset such as "0.0" or "-0" shifts nothing.
    if offset is not None and any((offset.get(key) or "0").strip("-+.0eE") for key in ("x", "y", "hdg")):
        yield Note("offset of the header", "positions are those of the roads")


def _missing_ends(root: Element, roads: Mapping[str, RoadLanes]) -> Iterator[str]:
    """Yield links to what the file does not contain."""
    junctions = {element.get("id") for element in root.iterfind("junction")}
    for road in roads.values():
        for link in (*road.element.iterfind("link/predecessor"), *road.element.iterfind("link/successor")):
            kind, key = link.get("elementType", "road"), link.get("elementId", "")
            if key not in (junctions if kind == "junction" else roads):
                yield f"road {road.id} to {kind} {key}"
    for junction in root.iterfind("junction"):
        for connection in junction.iterfind("connection"):
            for name in ("incomingRoad", "connectingRoad", "linkedRoad"):
                end = connection.get(name)
                if end is not None and end not in roads:
                    yield f"junction {junction.get('id', '')} to road {end}"
