"""Write the OpenDRIVE map of the shipped world `town`: a crossing with lights and a roundabout.

    python -m tools.town worlds/maps/town.xodr

Roads have one lane to each side and sidewalks. The crossing is at the origin, the roundabout 150 m east of it. Every
lane through a junction is a road with its reference line on the middle of the lane: a chain of clothoids and arcs.
"""

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import scipy

from mirdrake.worlds.pieces import Piece, Placement, advance

LANE, WALK = 3.5, 2.0  # widths of lanes and sidewalks [m]
RING, RING_LANE = 16.0, 5.0  # radius of the middle of the lane of the roundabout, and its width [m]
MOUTH = 12.0  # distance of the ends of arms from the middle of the crossing [m]
ENTRY = 28.0  # the same of the roundabout [m]
SPLAY = math.radians(36.0)  # of the ring on each side of an arm that belongs to its junction
TOWN_LIMIT = "50"  # [km/h]


@dataclass
class Town:
    """The map: its root element, and the connections of its junctions."""

    root: Element = field(default_factory=lambda: Element("OpenDRIVE"))
    junctions: dict[str, list[tuple[str, str, str, str]]] = field(default_factory=dict)
    """incoming road, connecting road, lane from, lane to"""

    def road(
        self,
        name: str,
        start: Placement,
        pieces: Sequence[Piece],
        *,
        before: tuple[str, str, str] | None = None,
        after: tuple[str, str, str] | None = None,
        junction: str = "-1",
        width: float = 0.0,
        lanes: tuple[str, str] | None = None,
        limit: str = TOWN_LIMIT,
        walk: bool = False,
    ) -> Element:
        """Add a road: with one lane along its reference line if `width` is given, else a lane to each side.

        `before` and `after` are the type, id and contact point of what it is linked to; `lanes` are the lanes that a
        single lane is linked to; `walk` adds a sidewalk on its right.
        """
        length = math.fsum(piece.length for piece in pieces)
        road = SubElement(self.root, "road", {"name": name, "length": _text(length), "id": name, "junction": junction})
        link = SubElement(road, "link")
        for tag, other in (("predecessor", before), ("successor", after)):
            if other is not None:
                kind, key, contact = other
                SubElement(
                    link, tag, {"elementType": kind, "elementId": key} | ({"contactPoint": contact} if contact else {})
                )
        kind_of_road = SubElement(road, "type", {"s": "0", "type": "town"})
        SubElement(kind_of_road, "speed", {"max": limit, "unit": "km/h"})
        _plan_view(road, start, pieces)
        table = SubElement(road, "lanes")
        if width:
            SubElement(table, "laneOffset", {"s": "0", "a": _text(width / 2.0), "b": "0", "c": "0", "d": "0"})
        section = SubElement(table, "laneSection", {"s": "0"})
        if not width:
            left = SubElement(section, "left")
            _lane(left, 2, "sidewalk", WALK)
            _lane(left, 1, "driving", LANE, mark="solid")
        centre = SubElement(SubElement(section, "center"), "lane", {"id": "0", "type": "none", "level": "false"})
        if not width:
            _mark(centre, "broken")
        right = SubElement(section, "right")
        _lane(right, -1, "driving", width or LANE, mark="" if width else "solid", links=lanes)
        if not width or walk:
            _lane(right, -2, "sidewalk", WALK)
        return road

    def connect(
        self,
        junction: str,
        name: str,
        start: Placement,
        pieces: Sequence[Piece],
        ends: tuple[tuple[str, str, str], tuple[str, str, str]],
        *,
        width: float = LANE,
        limit: str = TOWN_LIMIT,
        walk: bool = False,
    ) -> None:
        """Add a lane through a junction between two roads, each with its contact point and its lane."""
        (incoming, contact, lane), (outgoing, other, to) = ends
        self.road(
            name,
            start,
            pieces,
            before=("road", incoming, contact),
            after=("road", outgoing, other),
            junction=junction,
            width=width,
            lanes=(lane, to),
            limit=limit,
            walk=walk,
        )
        self.junctions.setdefault(junction, []).append((incoming, name, lane, "-1"))


def make_town() -> Element:
    """Return the map."""
    town = Town()
    SubElement(town.root, "header", {"revMajor": "1", "revMinor": "6", "name": "town", "version": "1.0"})
    middle = (150.0, 0.0)

    # Arms lead away from the crossing; the eastern one ends at the roundabout.
    names = {0: "east", 90: "north", 180: "west", 270: "south"}
    lengths = {0: middle[0] - MOUTH - ENTRY, 90: 90.0, 180: 110.0, 270: 90.0}
    for degrees, name in names.items():
        after = ("junction", "ring_west", "") if degrees == 0 else None
        arm = town.road(
            name,
            _polar((0.0, 0.0), MOUTH, degrees, degrees),
            [Piece(lengths[degrees], 0.0, 0.0)],
            before=("junction", "crossing", ""),
            after=after,
        )
        _light(arm, name)
    for degrees, name in names.items():
        begin = _aside(_polar((0.0, 0.0), MOUTH, degrees, degrees + 180.0), -LANE / 2.0)
        for turn, way in ((0.0, "straight"), (90.0, "left"), (-90.0, "right")):
            target = names[int(degrees + 180.0 + turn) % 360]
            reach = MOUTH + LANE / 2.0 * (1.0 if turn > 0.0 else -1.0)
            pieces = [Piece(2.0 * MOUTH, 0.0, 0.0)] if not turn else _corner(reach, math.radians(turn))
            ends = ((name, "start", "1"), (target, "start", "-1"))
            limit = TOWN_LIMIT if not turn else "30"
            town.connect("crossing", f"{name}_{way}", begin, pieces, ends, limit=limit, walk=turn < 0.0)

    # The ring turns counter-clockwise; its junctions are at the arms.
    arms = {180: ("west", "east", "end"), 270: ("south", "ring_south_arm", "start")}
    arms |= {0: ("east", "ring_east_arm", "start"), 90: ("north", "ring_north_arm", "start")}
    for degrees, (side, arm_name, _) in arms.items():
        if degrees != 180:
            start = _polar(middle, ENTRY, degrees, degrees)
            town.road(arm_name, start, [Piece(70.0, 0.0, 0.0)], before=("junction", f"ring_{side}", ""), after=None)
        arc = math.radians(90.0) - 2.0 * SPLAY
        following = arms[(degrees + 90) % 360][0]
        town.road(
            f"ring_from_{side}",
            _polar(middle, RING, degrees + math.degrees(SPLAY), degrees + math.degrees(SPLAY) + 90.0),
            [Piece(RING * arc, 1.0 / RING, 1.0 / RING)],
            before=("junction", f"ring_{side}", ""),
            after=("junction", f"ring_{following}", ""),
            width=RING_LANE,
            limit="30",
        )
    for degrees, (side, arm_name, contact) in arms.items():
        junction, splay = f"ring_{side}", math.degrees(SPLAY)
        last, following = f"ring_from_{arms[(degrees - 90) % 360][0]}", f"ring_from_{side}"
        into = _polar(middle, RING, degrees - splay, degrees - splay + 90.0)
        out = _polar(middle, RING, degrees + splay, degrees + splay + 90.0)
        entry = _aside(_polar(middle, ENTRY, degrees, degrees + 180.0), -LANE / 2.0)
        leave = _aside(_polar(middle, ENTRY, degrees, degrees), -LANE / 2.0)
        inward, outward = ("-1", "1") if contact == "end" else ("1", "-1")
        ring = [Piece(2.0 * RING * SPLAY, 1.0 / RING, 1.0 / RING)]
        town.connect(
            junction, f"{junction}_on", into, ring, ((last, "end", "-1"), (following, "start", "-1")),
            width=RING_LANE, limit="30",
        )  # fmt: skip
        town.connect(
            junction, f"{junction}_in", entry, _blend(entry, out, 0.0, 1.0 / RING),
            ((arm_name, contact, inward), (following, "start", "-1")), limit="30",
        )  # fmt: skip
        town.connect(
            junction, f"{junction}_out", into, _blend(into, leave, 1.0 / RING, 0.0),
            ((last, "end", "-1"), (arm_name, contact, outward)), limit="30",
        )  # fmt: skip
        arm = next(road for road in town.root.iter("road") if road.get("id") == arm_name)
        _yield_sign(arm, junction, contact)
    _junctions(town)
    return town.root


# --- curves -------------------------------------------------------------------------------------------------------


def _polar(middle: tuple[float, float], radius: float, degrees: float, heading: float) -> Placement:
    """Return a pose on a circle: direction from its middle and heading [deg]."""
    a = math.radians(degrees)
    return middle[0] + radius * math.cos(a), middle[1] + radius * math.sin(a), math.radians(heading)


def _aside(pose: Placement, offset: float) -> Placement:
    """Return a pose moved to its left [m]."""
    x, y, yaw = pose
    return x - offset * math.sin(yaw), y + offset * math.cos(yaw), yaw


def _corner(reach: float, turn: float) -> list[Piece]:
    """Return clothoid, arc and clothoid around a corner at a distance [m] from both ends, by an angle [rad]."""
    share = 0.25  # of the angle in each clothoid
    k = math.copysign(1.0, turn)
    pieces = [Piece(2.0 * share * abs(turn), 0.0, k), Piece((1.0 - 2.0 * share) * abs(turn), k, k)]
    pieces.append(Piece(2.0 * share * abs(turn), k, 0.0))
    pose: Placement = (0.0, 0.0, 0.0)
    for piece in pieces:
        pose = advance(pose, piece)
    # Its tangents meet at this distance from the ends, for a radius of 1 m.
    scale = reach / (pose[0] - pose[1] / math.tan(turn))
    return [Piece(piece.length * scale, piece.start_curvature / scale, piece.end_curvature / scale) for piece in pieces]


def _blend(start: Placement, end: Placement, first: float, last: float) -> list[Piece]:
    """Return three clothoids of equal length from pose to pose, with given curvatures at both ends [1/m]."""
    distance = math.dist(start[:2], end[:2])

    def chain(values: Sequence[float]) -> list[Piece]:
        a, b, length = values
        return [Piece(length / 3.0, first, a), Piece(length / 3.0, a, b), Piece(length / 3.0, b, last)]

    def rest(values: Sequence[float]) -> list[float]:
        pose = start
        for piece in chain(values):
            pose = advance(pose, piece)
        turn = math.remainder(pose[2] - end[2], 2.0 * math.pi)
        return [pose[0] - end[0], pose[1] - end[1], distance * turn]

    turn = math.remainder(end[2] - start[2], 2.0 * math.pi)
    found, _, code, message = scipy.optimize.fsolve(
        rest, [turn / distance, turn / distance, distance], full_output=True, xtol=1e-14
    )
    if code != 1 and max(map(abs, rest(found))) > 1e-9:
        raise ValueError(message)
    return chain(found.tolist())


# --- elements -----------------------------------------------------------------------------------------------------


def _text(value: float) -> str:
    return f"{value:.12g}"


def _plan_view(road: Element, start: Placement, pieces: Sequence[Piece]) -> None:
    view, pose, s = SubElement(road, "planView"), start, 0.0
    for piece in pieces:
        x, y, yaw = pose
        given = {"s": s, "x": x, "y": y, "hdg": yaw, "length": piece.length}
        geometry = SubElement(view, "geometry", {key: _text(value) for key, value in given.items()})
        if piece.start_curvature != piece.end_curvature:
            ends = {"curvStart": piece.start_curvature, "curvEnd": piece.end_curvature}
            SubElement(geometry, "spiral", {key: _text(value) for key, value in ends.items()})
        elif piece.start_curvature:
            SubElement(geometry, "arc", {"curvature": _text(piece.start_curvature)})
        else:
            SubElement(geometry, "line")
        pose, s = advance(pose, piece), s + piece.length


def _lane(
    side: Element, number: int, kind: str, width: float, *, mark: str = "", links: tuple[str, str] | None = None
) -> None:
    lane = SubElement(side, "lane", {"id": str(number), "type": kind, "level": "false"})
    link = SubElement(lane, "link")
    for tag, other in zip(("predecessor", "successor"), links or (), strict=False):
        SubElement(link, tag, {"id": other})
    SubElement(lane, "width", {"sOffset": "0", "a": _text(width), "b": "0", "c": "0", "d": "0"})
    if mark:
        _mark(lane, mark)


def _mark(lane: Element, kind: str) -> None:
    given = {"sOffset": "0", "type": kind, "weight": "standard", "color": "white", "width": "0.12"}
    mark = SubElement(lane, "roadMark", given | {"laneChange": "none"})
    if kind == "broken":
        line = {"length": "3", "space": "6", "tOffset": "0", "sOffset": "0", "width": "0.12"}
        SubElement(SubElement(mark, "type", {"name": kind, "width": "0.12"}), "line", line)


def _light(road: Element, name: str) -> None:
    """Add a traffic light and a stop line at the start of an arm, for the lane that leads to the crossing."""
    signal = {"name": f"light {name}", "id": f"light_{name}", "type": "1000001", "subtype": "-1", "dynamic": "yes"}
    place = {"s": "1", "t": _text(LANE + 0.8), "zOffset": "2.4", "orientation": "-", "country": "OpenDRIVE"}
    signals = SubElement(road, "signals")
    SubElement(signals, "signal", signal | place)
    line = {"name": "stop line", "id": f"line_{name}", "type": "294", "subtype": "-1", "dynamic": "no"}
    SubElement(signals, "signal", line | {"s": "2", "t": "0", "zOffset": "0", "orientation": "-", "country": "DE"})


def _yield_sign(road: Element, junction: str, contact: str) -> None:
    """Add a yield sign at the end of an arm at the roundabout."""
    at_end = contact == "end"
    s = float(road.get("length", "0")) - 0.5 if at_end else 0.5
    signals = road.find("signals")
    signals = SubElement(road, "signals") if signals is None else signals
    side = -1.0 if at_end else 1.0
    given = {"name": "yield", "id": f"yield_{junction}", "type": "205", "subtype": "-1", "dynamic": "no"}
    place = {"s": _text(s), "t": _text(side * (LANE + 0.8)), "zOffset": "2", "orientation": "+" if at_end else "-"}
    SubElement(signals, "signal", given | place | {"country": "DE"})


def _junctions(town: Town) -> None:
    for key, connections in town.junctions.items():
        junction = SubElement(town.root, "junction", {"name": key, "id": key})
        for i, (incoming, connecting, lane, to) in enumerate(connections):
            given = {"id": str(i), "incomingRoad": incoming, "connectingRoad": connecting, "contactPoint": "start"}
            SubElement(SubElement(junction, "connection", given), "laneLink", {"from": lane, "to": to})
    for i, arms in enumerate((("east", "west"), ("north", "south"))):
        controller = SubElement(town.root, "controller", {"id": f"phase_{'ab'[i]}", "name": " and ".join(arms)})
        for name in arms:
            SubElement(controller, "control", {"signalId": f"light_{name}", "type": "lights"})


if __name__ == "__main__":
    tree = make_town()
    ElementTree.indent(tree)
    Path(sys.argv[1]).write_text(ElementTree.tostring(tree, encoding="unicode") + "\n", encoding="utf-8")
