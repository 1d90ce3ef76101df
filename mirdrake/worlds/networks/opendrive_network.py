"""Road networks from OpenDRIVE files: all roads and junctions.

::

    <road> ──► RoadLanes ──► Lane                    opendrive_road.py, here
    lanes, <junction> ── find_links ──► Links        opendrive_links.py
    <signal>, <object> ──► Signal, StopLine          opendrive_signals.py
    signals, conflicts ──► Junction, priorities      right_of_way.py
    <roadMark> ──► PaintedLine                       opendrive_marks.py
    all that is left out ──► notes                   opendrive_omissions.py
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import display_path
from mirdrake.worlds.networks.lane import Change, Lane, connect, lane_along
from mirdrake.worlds.networks.network import DRIVEN, Network
from mirdrake.worlds.networks.opendrive_links import find_links, lane_id
from mirdrake.worlds.networks.opendrive_marks import read_marks
from mirdrake.worlds.networks.opendrive_omissions import omissions
from mirdrake.worlds.networks.opendrive_road import LaneRow, RoadLanes, Section, read_speed
from mirdrake.worlds.networks.opendrive_signals import read_signals
from mirdrake.worlds.networks.right_of_way import decide
from mirdrake.worlds.opendrive_parts import LONGEST, parse_opendrive

_NARROWEST = 0.05  # [m] largest width of a lane that is left out


def read_network(path: str | Path) -> Network:
    """Read all roads and junctions of an OpenDRIVE file.

    Raises:
        ConfigError: the file or a road of it is invalid.
    """
    path = Path(path)
    root, places = parse_opendrive(path)
    roads = {road.id: road for road in (RoadLanes(element, places) for element in root.iterfind("road"))}
    if not roads:
        raise ConfigError("contains no road", where=places[root])
    if (total := math.fsum(road.length for road in roads.values())) > LONGEST:
        raise ConfigError(f"{total / 1e3:.4g} km of roads; allowed are {LONGEST / 1e3:g} km", where=display_path(path))

    # Lanes first, because the direction of a connection results from those of its lanes.
    lanes = {lane.id: lane for road in roads.values() for lane in _lanes_of(road)}
    if not any(lane.kind in DRIVEN for lane in lanes.values()):
        raise ConfigError(f"none of its {len(lanes)} lanes is for motor vehicles", where=display_path(path))
    links = find_links(root, roads, lanes)
    lanes = connect(lanes, links.following)
    left_hand = any(road.element.get("rule") == "LHT" for road in roads.values())
    network = Network(path.stem, lanes, left_hand=left_hand, markings=read_marks(roads, places))

    # Signals and stop lines decide who yields in a junction.
    signals, stop_lines, unread = read_signals(root, roads, lanes, places)
    network = replace(network, signals=signals, stop_lines=stop_lines)
    junctions, priorities = decide(network, root)
    notes = (*omissions(root, roads, network, links), *unread)
    return replace(network, junctions=junctions, priorities=priorities, notes=notes)


# --- lanes --------------------------------------------------------------------------------------------------------


def _lanes_of(road: RoadLanes) -> Iterator[Lane]:
    """Yield the lanes of a road, with their neighbours, in the direction of travel."""
    with_line = -1 if road.element.get("rule") != "LHT" else 1  # sign of the lanes that share its direction
    for i, section in enumerate(road.sections):
        s = road.stations(section)
        lanes: dict[int, Lane] = {}
        for number, row in section.lanes.items():
            # The inner neighbour is towards lane 0, the reference line with its offset.
            inner = number - (1 if number > 0 else -1)
            strip = road.strip(section, s, inner if inner in section.lanes or not inner else 0, number)
            if strip.width.max() < _NARROWEST:
                continue
            order = slice(None) if number * with_line > 0 else slice(None, None, -1)
            yaw = strip.yaw if number * with_line > 0 else strip.yaw + math.pi
            points = np.column_stack((strip.x, strip.y))[order]
            # Points coincide where a lane has no length on the inside of a bend.
            apart = np.append(True, np.hypot(*np.diff(points, axis=0).T) > 1e-5)
            if apart.sum() < 2:
                continue
            lanes[number] = replace(
                lane_along(
                    lane_id(road.id, i, number),
                    points[apart],
                    yaw=yaw[order][apart],
                    width=strip.width[order][apart],
                    z=strip.z[order][apart],
                ),
                kind=row.kind,
                junction=road.junction,
                road=road.id,
                number=number,
                road_s=s[order][apart],
                # Seen in the other direction, left and right are exchanged.
                bank=(strip.bank if number * with_line > 0 else -strip.bank)[order][apart],
                speed_limit=_limit(road, section, row),
                change=_change(section, number, with_line),
            )
        yield from _with_neighbours(lanes, with_line).values()


def _with_neighbours(lanes: dict[int, Lane], with_line: int) -> dict[int, Lane]:
    """Return the lanes of a section with their neighbours for motor vehicles."""
    driven = {number: lane for number, lane in lanes.items() if lane.kind in DRIVEN}
    done = dict(lanes)
    for number, lane in driven.items():
        sign = 1 if number > 0 else -1
        inner, outer = driven.get(number - sign), driven.get(number + sign)
        # The outer side is on the left of lanes with positive numbers in the direction of the reference line.
        outer_is_left = (number > 0) == (number * with_line > 0)
        left, right = (outer, inner) if outer_is_left else (inner, outer)
        # Only the innermost lanes border on the opposite direction.
        across = driven.get(-sign) if number == sign else None
        done[number] = replace(
            lane,
            left=None if left is None else left.id,
            right=None if right is None else right.id,
            opposite=None if across is None else across.id,
        )
    return done


def _limit(road: RoadLanes, section: Section, row: LaneRow) -> float | None:
    """Return the speed limit of a lane [m/s], else that of its road."""
    speeds = row.element.findall("speed")
    return road.limit(section.begin) if not speeds else read_speed(speeds[0])


def _change(section: Section, number: int, with_line: int) -> Change:
    """Return the sides to which the first road marks of a lane and of its inner neighbour allow a lane change.

    A lane change over the outer mark of a lane towards larger numbers is an "increase".
    """
    sign = 1 if number > 0 else -1
    inner = section.lanes.get(number - sign)
    elements = (section.lanes[number].element, inner.element if inner is not None else section.centre)
    allowed = [_allowed(element, step) for element, step in zip(elements, (sign, -sign), strict=True)]
    outer_is_left = (number > 0) == (number * with_line > 0)
    left, right = allowed if outer_is_left else allowed[::-1]
    return ("both" if right else "left") if left else ("right" if right else "none")


def _allowed(element: Element | None, step: int) -> bool:
    mark = None if element is None else element.find("roadMark")
    if mark is None:
        return True
    # Without a stated attribute the kind of the paint decides: solid lines must not be crossed.
    default = "none" if mark.get("type", "none").startswith("solid") else "both"
    return mark.get("laneChange", default) in {"both", "increase" if step > 0 else "decrease"}
