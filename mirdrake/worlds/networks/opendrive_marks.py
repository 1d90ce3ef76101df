"""Road marks of OpenDRIVE files as painted lines."""

import itertools
from collections.abc import Iterator, Mapping
from xml.etree.ElementTree import Element

import numpy as np

from mirdrake.worlds.networks.network import PaintedLine
from mirdrake.worlds.networks.opendrive_road import RoadLanes, Section
from mirdrake.worlds.opendrive_parts import Places, number_of
from mirdrake.worlds.pieces import Array

_WIDTH = 0.12  # [m] of marks without one
_DASH = (3.0, 6.0)  # [m] length of dashes and gaps of marks without them
_UNPAINTED = {"none", "curb", "botts dots", "grass", "edge"}


def read_marks(roads: Mapping[str, RoadLanes], places: Places) -> tuple[PaintedLine, ...]:
    """Return the road marks of all roads."""
    return tuple(line for road in roads.values() for section in road.sections for line in _marks(road, section, places))


def _marks(road: RoadLanes, section: Section, places: Places) -> Iterator[PaintedLine]:
    s = road.stations(section)
    elements = [(0, section.centre), *((number, row.element) for number, row in section.lanes.items())]
    for number, element in elements:
        marks = [] if element is None else element.findall("roadMark")
        starts = [section.begin + number_of(mark, "sOffset", places, 0.0) for mark in marks]
        for mark, (begin, end) in zip(marks, itertools.pairwise([*starts, section.end]), strict=True):
            if mark.get("type", "none") in _UNPAINTED or end - begin < 0.1:
                continue
            inside = np.unique(np.concatenate(([begin], s[(s > begin) & (s < end)], [end])))
            edge = road.strip(section, inside, number, number)
            yield _line(mark, np.column_stack((edge.x, edge.y)), places)


def _line(mark: Element, points: Array, places: Places) -> PaintedLine:
    """Return the painted line of a mark; double lines are one line of their width together."""
    width = number_of(mark, "width", places, 0.0) or _WIDTH
    color = mark.get("color", "standard")
    dash = None
    if mark.get("type", "").startswith("broken"):
        line = mark.find("type/line")
        lengths = [0.0, 0.0] if line is None else [number_of(line, key, places, 0.0) for key in ("length", "space")]
        dash = (lengths[0], lengths[1]) if min(lengths) > 0.1 else _DASH
    return PaintedLine(points, min(max(width, 0.02), 1.0), dash, "yellow" if color == "yellow" else "white")
