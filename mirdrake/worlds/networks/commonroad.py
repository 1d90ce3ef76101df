"""Road networks from CommonRoad scenarios (XML, versions 2018b and 2020a): lanelets as lanes.

After M. Althoff, M. Koschi and S. Manzinger, "CommonRoad: Composable benchmarks for motion planning on roads",
IEEE Intelligent Vehicles Symposium, 2017, and the documentation of its XML format.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from mirdrake.core.errors import ConfigError
from mirdrake.core.xml_reader import XmlDocument, parse_xml, read_xml_bytes
from mirdrake.core.yaml_io import display_path
from mirdrake.worlds.networks.lane import Lane, connect, lane_along
from mirdrake.worlds.networks.network import Control, Network, PaintedLine, Signal, StopLine, signal_name
from mirdrake.worlds.networks.right_of_way import decide
from mirdrake.worlds.pieces import Array

_LARGEST = 100_000_000  # bytes
_KINDS = {
    "crosswalk": "sidewalk", "sidewalk": "sidewalk", "bicycleLane": "biking", "busStop": "bus", "border": "border",
    "shoulder": "shoulder", "parking": "parking", "accessRamp": "onRamp", "exitRamp": "offRamp",
    "restrictedAccess": "restricted", "driveWay": "driving",
}  # fmt: skip
_SIGNS: Mapping[str, Control] = {"206": "stop", "R1-1": "stop", "205": "yield", "R1-2": "yield"}
_LIMITS = {"274", "R2-1", "274.1"}
_STEP = 0.05  # [m] least distance of nodes


def parse_commonroad(path: Path) -> XmlDocument:
    """Return the tree of a CommonRoad scenario.

    Raises:
        ConfigError: the file cannot be read or is not such a scenario.
    """
    data = read_xml_bytes(path, largest=_LARGEST, error=ConfigError, advice="cut out the lanelets that are needed")
    document = parse_xml(data, display_path(path), error=ConfigError, prefixes=False)
    if document.root.tag != "commonRoad":
        tag = document.root.tag
        raise ConfigError(f"<{tag}> is not CommonRoad, whose root is <commonRoad>", where=document.where(document.root))
    return document


def read_commonroad(path: str | Path) -> Network:
    """Read the lanelets, signs and lights of a CommonRoad scenario.

    Raises:
        ConfigError: the file or a lanelet is invalid.
    """
    path = Path(path)
    document = parse_commonroad(path)
    root = document.root
    elements = {element.get("id", ""): element for element in root.iterfind("lanelet")}
    if not elements:
        raise ConfigError("contains no lanelet", where=document.where(root))
    signs = {element.get("id", ""): element for element in root.iterfind("trafficSign")}
    junction_of = dict(_junctions(root))
    lanes: dict[str, Lane] = {}
    marks: list[PaintedLine] = []
    for name, element in elements.items():
        lanes[name] = replace(_lane(element, name, document), junction=junction_of.get(name))
        marks += _marks(element, document)

    # Links refer to lanelets further down in the file, so that they follow once all are known.
    lanes = {name: _connected(lane, elements[name], lanes, signs) for name, lane in lanes.items()}
    lanes = connect(lanes, {name: lane.successors for name, lane in lanes.items()})
    signals = {signal.name: signal for signal in _signals(root, elements, lanes, document)}
    stop_lines = tuple(_stop_lines(elements, lanes, signals, document))
    network = Network(path.stem, lanes, stop_lines, signals, markings=tuple(marks))
    junctions, priorities = decide(network)
    return replace(network, junctions=junctions, priorities=priorities)


def number_at(element: Element, path: str, document: XmlDocument, default: float | None = None) -> float:
    """Return the number in a child, or the middle of its interval.

    Raises:
        ConfigError: it is not a number, or it is missing and has no default.
    """
    child = element.find(path)
    texts: list[str | None] = []
    if child is not None:
        exact = child if child.find("exact") is None else child.find("exact")
        # An interval stands for an uncertain value; its middle is the nominal one.
        ends = [child.findtext("intervalStart"), child.findtext("intervalEnd")]
        texts = list(ends) if None not in ends else [None if exact is None else exact.text]
    elif default is not None:
        return default
    try:
        values = [float(text or "") for text in texts]
        value = math.fsum(values) / len(values)
    except (ValueError, ZeroDivisionError):
        raise ConfigError(f"<{element.tag}> needs a number in <{path}>", where=document.where(element)) from None
    if not abs(value) < 1e8:
        raise ConfigError(f"{path} {value:g} of <{element.tag}> should be within ±1e8", where=document.where(element))
    return value


def points_of(element: Element | None, document: XmlDocument) -> Array:
    """Return the points of an element, N x 2 [m]."""
    points = [] if element is None else element.findall("point")
    rows = [(number_at(point, "x", document), number_at(point, "y", document)) for point in points]
    return np.array(rows, dtype=float).reshape(-1, 2)


# --- lanes --------------------------------------------------------------------------------------------------------


def _lane(element: Element, name: str, document: XmlDocument) -> Lane:
    """Return a lanelet as a lane midway between its bounds."""
    left, right = (points_of(element.find(f"{side}Bound"), document) for side in ("left", "right"))
    if len(left) != len(right) or len(left) < 2:
        raise ConfigError(
            f"lanelet {name} has {len(left)} points on its left bound and {len(right)} on "
            "its right one; it needs the same number, two or more",
            where=document.where(element),
        )
    middle, width = (left + right) / 2.0, np.hypot(*(left - right).T)
    # Lanelets often have nodes a few millimetres apart, whose headings would be noise.
    indices = [0]
    for i in range(1, len(middle)):
        if math.dist(middle[i], middle[indices[-1]]) >= _STEP:
            indices.append(i)
    if len(indices) < 2:
        raise ConfigError(f"lanelet {name} is shorter than {_STEP:g} m", where=document.where(element))
    kinds = [kind.text or "" for kind in element.iterfind("laneletType")]
    known = [_KINDS[kind] for kind in kinds if kind in _KINDS]
    return replace(
        lane_along(name, middle[indices], width=width[indices]), kind=known[0] if known else "driving", road=name
    )


def _connected(lane: Lane, element: Element, lanes: Mapping[str, Lane], signs: Mapping[str, Element]) -> Lane:
    """Return a lane with its successors, neighbours and speed limit."""
    # CommonRoad has an adjacent lane on each side in either direction; oncoming ones are stored as opposite.
    beside: dict[str, str | None] = {"left": None, "right": None, "opposite": None}
    for side in ("left", "right"):
        other = element.find(f"adjacent{side.capitalize()}")
        if other is not None and other.get("ref") in lanes:
            beside[side if other.get("drivingDir") == "same" else "opposite"] = other.get("ref")
    marks = [element.findtext(f"{side}Bound/lineMarking") or "" for side in ("left", "right")]
    # Solid bounds must not be crossed.
    left, right = ("solid" not in mark for mark in marks)
    # Limits of all signs that the lane refers to; units are m/s in CommonRoad.
    limits = [
        float(value.text or "nan")
        for reference in element.iterfind("trafficSignRef")
        if (sign := signs.get(reference.get("ref", ""))) is not None
        for part in sign.iterfind("trafficSignElement")
        if part.findtext("trafficSignID") in _LIMITS
        for value in part.iterfind("additionalValue")
    ]
    return replace(
        lane,
        left=beside["left"],
        right=beside["right"],
        opposite=beside["opposite"],
        change=("both" if right else "left") if left else ("right" if right else "none"),
        successors=tuple(e.get("ref", "") for e in element.iterfind("successor") if e.get("ref") in lanes),
        # The lowest of several limits holds; zero is none.
        speed_limit=min(limits) if limits and min(limits) > 0.0 else None,
    )


def _junctions(root: Element) -> Iterator[tuple[str, str]]:
    """Yield the lanelets that leave the incoming ones of intersections, and the intersection of each."""
    for intersection in root.iterfind("intersection"):
        for incoming in intersection.iterfind("incoming"):
            for key in ("successorsRight", "successorsStraight", "successorsLeft"):
                for reference in incoming.iterfind(key):
                    yield reference.get("ref", ""), intersection.get("id", "")


def _marks(element: Element, document: XmlDocument) -> Iterator[PaintedLine]:
    for side in ("left", "right"):
        bound = element.find(f"{side}Bound")
        kind = "" if bound is None else bound.findtext("lineMarking") or ""
        points = points_of(bound, document)
        if kind not in {"", "no_marking", "unknown"} and len(points) > 1:
            width = 0.25 if kind.startswith("broad") else 0.12
            yield PaintedLine(points, width, (3.0, 6.0) if "dashed" in kind else None)


# --- signs and lights ---------------------------------------------------------------------------------------------


def _signals(
    root: Element, elements: Mapping[str, Element], lanes: Mapping[str, Lane], document: XmlDocument
) -> Iterator[Signal]:
    """Yield lights and signs; those without a position are at the end of the first lane that they control."""
    for tag in ("trafficLight", "trafficSign"):
        # Lanes refer to their signals, not the other way round.
        lanes_of: dict[str, dict[str, None]] = {}
        for key, lanelet in elements.items():
            for reference in lanelet.iterfind(f"{tag}Ref"):
                lanes_of.setdefault(reference.get("ref", ""), {})[key] = None
        for element in root.iterfind(tag):
            name = element.get("id", "")
            controlled = tuple(lanes_of.get(name, ()))
            codes = [part.findtext("trafficSignID") or "" for part in element.iterfind("trafficSignElement")]
            kind: Control = (
                "lights" if tag == "trafficLight" else next((_SIGNS[c] for c in codes if c in _SIGNS), "none")
            )
            places = points_of(element.find("position"), document)
            # Without a position and without a lane there is no place for it.
            if not controlled and not len(places):
                continue
            lane = lanes[controlled[0]] if controlled else None
            # Without a position: at the right edge of the lane, where it ends.
            x, y = places[0] if len(places) else (lane.right_edge[-1] if lane is not None else (0.0, 0.0))
            yaw = 0.0 if lane is None else float(lane.yaw[-1])
            yield Signal(
                signal_name(tag[7:].lower(), name),
                kind,
                float(x),
                float(y),
                2.0,
                yaw,
                controlled,
                code=codes[0] if codes else "",
            )


def _stop_lines(
    elements: Mapping[str, Element], lanes: Mapping[str, Lane], signals: Mapping[str, Signal], document: XmlDocument
) -> Iterator[StopLine]:
    """Yield the stop lines of lanelets, and of those with lights or signs but without a line one at their end."""
    for name, element in elements.items():
        lane, line = lanes[name], element.find("stopLine")
        own = [signal for signal in signals.values() if name in signal.lanes and signal.kind != "none"]
        if line is None and not own:
            continue
        points = points_of(line, document)
        s = float(lane.project(*points.mean(axis=0))[0]) if len(points) else lane.length
        lights = next((signal for signal in own if signal.kind == "lights"), None)
        kind = lights.kind if lights is not None else own[0].kind if own else "none"
        yield StopLine(f"{name}@{s:.4g}", name, s, kind, None if lights is None else lights.name)
