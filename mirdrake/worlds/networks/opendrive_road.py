"""One road of an OpenDRIVE file: its reference line and profiles, the edges and the centre lines of its lanes.

After ASAM OpenDRIVE, chapters "Road reference line", "Elevation" and "Lanes": a lane is between two edges at t(s)
beside the reference line. Its centre line at t has the heading ψ + atan2(t', 1 - κ t), from the derivative of
r(s) + t(s) n(s) by s (do Carmo, "Differential Geometry of Curves and Surfaces", section 1-5).
"""

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np

from mirdrake.core.errors import ConfigError
from mirdrake.worlds.opendrive_parts import SAME, Cubics, Leg, Places, number_of, read_leg
from mirdrake.worlds.pieces import Array

_SAGITTA = 1e-3  # [m] of the polylines
_STEPS = (0.1, 2.0)  # [m] shortest and longest step
_FOLD = 0.02  # least 1 - κ t of a lane


@dataclass(frozen=True)
class LaneRow:
    """A lane of a section: its element and the polynomials of its width or its outer border."""

    element: Element
    number: int
    kind: str
    widths: Cubics
    borders: Cubics


@dataclass(frozen=True)
class Section:
    """A lane section."""

    begin: float
    end: float
    """[m] along the reference line"""
    lanes: dict[int, LaneRow]
    """by number"""
    centre: Element | None
    """lane 0, which has road marks only"""
    where: str
    """``file:line``"""

    def edges_of(self, lane: str) -> Iterator[int]:
        """Yield the numbers of the lanes of a type or an id, and of the next lanes towards the centre, or 0."""
        for sign in (1, -1):
            inner = 0
            for number in sorted((n for n in self.lanes if n * sign > 0), key=abs):
                element = self.lanes[number].element
                if lane in {element.get("type"), element.get("id")}:
                    yield inner
                    yield number
                inner = number


@dataclass(frozen=True)
class Strip:
    """A line beside the reference line, M nodes: positions, headings, and distance between its edges."""

    s: Array
    """[m] along the reference line"""
    t: Array
    """[m] beside it, + left"""
    x: Array
    y: Array
    z: Array
    yaw: Array
    width: Array
    """[m]"""
    bank: Array
    """slope across the road [-], + where its left is higher"""


class RoadLanes:
    """A road of the file.

    Args:
        road: its element.
        places: line of each element, for messages.
        carry: whether a section of one side (`singleSide`) has the lanes of the section before on the other side.

    Raises:
        ConfigError: the road has no length or no lanes.

    Attributes:
        id: its id.
        name: its name, or its id.
        where: ``file:line`` of the road.
        element: its element.
        junction: id of its junction, or None.
        legs: stations [m] and geometries of the reference line.
        length: length of the reference line [m], as its stations state.
        sections: its lane sections.
    """

    def __init__(self, road: Element, places: Places, *, carry: bool = False) -> None:
        self.id, self.where, self.element, self._places = road.get("id", ""), places[road], road, places
        self.name = road.get("name", "") or self.id
        junction = road.get("junction", "-1")
        self.junction = None if junction in {"-1", ""} else junction
        geometries = sorted(road.iterfind("planView/geometry"), key=lambda part: number_of(part, "s", places))
        legs = [(number_of(part, "s", places), read_leg(part, places)) for part in geometries]
        self.legs: list[tuple[float, Leg]] = [(s, leg) for s, leg in legs if leg is not None]
        if not self.legs:
            raise ConfigError(f"road '{self.name}' has no <geometry> of any length in <planView>", where=self.where)
        # The stated station of the last geometry counts, since all tables refer to stated stations.
        self.length = self.legs[-1][0] + self.legs[-1][1].length
        self._offset = Cubics.read(road.iterfind("lanes/laneOffset"), "s", places)
        self._elevation = Cubics.read(road.iterfind("elevationProfile/elevation"), "s", places)
        self._banking = Cubics.read(road.iterfind("lateralProfile/superelevation"), "s", places)
        self.sections = self._read_sections(road, carry=carry)

    def limit(self, s: float) -> float | None:
        """Return the speed limit of the road at a station [m/s]; None without one."""
        types = [e for e in self.element.iterfind("type") if number_of(e, "s", self._places, 0.0) <= s + SAME]
        speeds = types[-1].findall("speed") if types else []
        return read_speed(speeds[-1]) if speeds else None

    def stations(self, section: Section) -> Array:
        """Return stations of a section [m] at which polylines are accurate to 1 mm, with all joints."""
        # Polynomials change at these stations, and edges may have kinks there: each must be a node.
        breaks = {section.begin, section.end, *(s for s, _ in self.legs)}
        for table in (self._offset, self._elevation, self._banking):
            breaks.update(table.rows[:, 0].tolist())
        for lane in section.lanes.values():
            breaks.update(lane.widths.rows[:, 0].tolist(), lane.borders.rows[:, 0].tolist())
        inside = sorted(s for s in breaks if section.begin <= s <= section.end)
        knots = [inside[0], *(b for a, b in itertools.pairwise(inside) if b - a > 1e-3)]
        knots[-1] = section.end
        parts = [np.array([section.begin])]
        for begin, end in itertools.pairwise(knots):
            # The bend of a part is estimated from nine samples, of the reference line and of all edges.
            u = np.linspace(begin, end, 9)
            bend = np.abs(self._reference(u)[3]).max()
            for edge in self.edges(section, u, begin).values():
                bend = max(bend, float(np.abs(edge[2]).max()) + bend)
            # Sagitta of a curve with curvature k over a step h: k h² / 8.
            step = min(_STEPS[1], max(_STEPS[0], math.sqrt(8.0 * _SAGITTA / max(bend, 1e-9))))
            parts.append(np.linspace(begin, end, max(1, math.ceil((end - begin) / step)) + 1)[1:])
        return np.concatenate(parts)

    def strip(self, section: Section, s: Array, inner: int, outer: int) -> Strip:
        """Return the line midway between the outer edges of two lanes, in the direction of the reference line.

        Args:
            section: section of the lanes.
            s: stations within the section [m].
            inner: number of a lane; 0 is the reference line with its offset.
            outer: number of the other one; the same for the edge itself.
        """
        # At a break edges may jump; each part is evaluated by the polynomials valid at its start.
        ends = np.append(np.searchsorted(s, self._all_breaks(section)), len(s) - 1)
        t, slope, width = np.empty_like(s), np.empty_like(s), np.empty_like(s)
        for i, j in itertools.pairwise(np.unique(np.concatenate(([0], ends)))):
            part = slice(i, j + 1)
            edges = self.edges(section, s[part], float(s[i]))
            (a, da, _), (b, db, _) = edges[inner], edges[outer]
            t[part], slope[part], width[part] = (a + b) / 2.0, (da + db) / 2.0, np.abs(b - a)
        x, y, yaw, k = self._reference(s)

        # 1 - k t, the ratio of lengths beside the reference line; limited where a lane folds inside a bend.
        scale = 1.0 - k * t
        turn = np.arctan2(slope, np.maximum(scale, _FOLD))
        bank = np.tan(self._profile(self._banking, s))
        z = self._height(s) + t * bank
        # The width across the lane is that across the road times the cosine of the angle between them.
        return Strip(s, t, x - t * np.sin(yaw), y + t * np.cos(yaw), z, yaw + turn, width * np.cos(turn), bank)

    def place(self, s: float, t: float) -> tuple[float, float, float, float]:
        """Return x, y, z [m] and yaw [rad] of road coordinates s and t [m]."""
        at = np.array([min(max(s, 0.0), self.length)])
        x, y, yaw, _ = (float(v[0]) for v in self._reference(at))
        z = float(self._height(at)[0]) + t * math.tan(float(self._profile(self._banking, at)[0]))
        return x - t * math.sin(yaw), y + t * math.cos(yaw), z, yaw

    def section_at(self, s: float) -> int:
        """Return the index of the section at a station [m]."""
        return max((i for i, section in enumerate(self.sections) if section.begin <= s + SAME), default=0)

    # --- the inner parts ------------------------------------------------------------------------------------------

    def _read_sections(self, road: Element, *, carry: bool) -> list[Section]:
        elements = sorted(road.iterfind("lanes/laneSection"), key=lambda e: number_of(e, "s", self._places))
        if not elements:
            raise ConfigError(f"road '{self.name}' has no <laneSection> and therefore no width", where=self.where)
        begins = [max(0.0, number_of(e, "s", self._places)) for e in elements]
        # The first section must cover the start, even if the file lets it begin a little later.
        begins[0] = 0.0
        ends = [*begins[1:], self.length]
        sections: list[Section] = []
        for element, begin, end in zip(elements, begins, ends, strict=True):
            # Sections without length have no nodes.
            if end - begin > 1e-3:
                before = sections[-1].lanes if carry and sections and element.get("singleSide") == "true" else {}
                sections.append(self._read_section(element, begin, end, before))
        return sections

    def _read_section(self, section: Element, begin: float, end: float, before: Mapping[int, LaneRow]) -> Section:
        lanes: dict[int, LaneRow] = {}
        for side, sign in (("left", 1), ("right", -1)):
            if section.find(side) is None:
                lanes |= {number: row for number, row in before.items() if number * sign > 0}
            for element in section.iterfind(f"{side}/lane"):
                number = round(number_of(element, "id", self._places))
                widths = Cubics.read(element.iterfind("width"), "sOffset", self._places, begin=begin)
                borders = Cubics.read(element.iterfind("border"), "sOffset", self._places, begin=begin)
                lanes[number] = LaneRow(element, number, element.get("type", "none"), widths, borders)
        centre = section.find("center/lane")
        return Section(begin, end, dict(sorted(lanes.items())), centre, self._places[section])

    def edges(self, section: Section, s: Array, at: float) -> dict[int, tuple[Array, Array, Array]]:
        """Return t of the outer edge of each lane, and of 0, with two derivatives, at stations between two breaks."""
        middle = self._offset(s, at)
        edges = {0: middle}
        for sign in (1, -1):
            inner = middle
            for number in sorted((n for n in section.lanes if n * sign > 0), key=abs):
                lane = section.lanes[number]
                if lane.widths.rows.size or not lane.borders.rows.size:  # widths have priority over borders
                    value, first, second = lane.widths(s, at)
                    # A negative width by rounding of the coefficients is none, and has no slope.
                    positive = value > 0.0
                    rows = (np.where(positive, v, 0.0) for v in (value, first, second))
                    inner = tuple(a + sign * b for a, b in zip(inner, rows, strict=True))
                else:
                    inner = tuple(a + b for a, b in zip(middle, lane.borders(s, at), strict=True))  # type: ignore[assignment]
                edges[number] = inner
        return edges

    def breaks(self) -> set[float]:
        """Return the stations at which an edge of a lane may jump or bend [m]."""
        inner = (s for section in self.sections for s in (section.begin, *self._all_breaks(section).tolist()))
        return {*self._offset.rows[:, 0].tolist(), *inner}

    def _all_breaks(self, section: Section) -> Array:
        """Return the starts of all polynomials of lanes within a section [m]."""
        tables = [self._offset, *(table for lane in section.lanes.values() for table in (lane.widths, lane.borders))]
        starts = np.concatenate([table.rows[:, 0] for table in tables])
        return np.asarray(starts[(starts > section.begin + SAME) & (starts < section.end - SAME)])

    def _reference(self, s: Array) -> tuple[Array, Array, Array, Array]:
        """Return x, y, heading and curvature of the reference line at stations."""
        starts = np.array([begin for begin, _ in self.legs])
        leg_of = np.clip(np.searchsorted(starts, s + SAME, side="right") - 1, 0, len(starts) - 1)
        x, y, yaw, k = (np.empty_like(s) for _ in range(4))
        for i in np.unique(leg_of):
            begin, leg = self.legs[i]
            here = leg_of == i
            # Stated stations and lengths differ by rounding: between two geometries the end of the first one is held.
            u = np.clip(s[here] - begin, 0.0, leg.length)
            x[here], y[here], yaw[here] = leg.pose(u)
            k[here] = _curvature(leg, u)
        return x, y, yaw, k

    def _profile(self, table: Cubics, s: Array) -> Array:
        """Return the values of a table at stations."""
        value = np.zeros_like(s)
        for i, row in enumerate(table.rows):
            here = s >= row[0] - SAME if i else np.full(len(s), True)
            u = s[here] - row[0]
            value[here] = row[1] + u * (row[2] + u * (row[3] + u * row[4]))
        return value

    def _height(self, s: Array) -> Array:
        return self._profile(self._elevation, s)


def read_speed(element: Element) -> float | None:
    """Return the speed of a <speed> element [m/s]; None if it is not a number, for example "no limit"."""
    try:
        value = float(element.get("max", ""))
    except ValueError:
        return None
    factor = {"km/h": 1.0 / 3.6, "mph": 0.44704}.get(element.get("unit", "m/s"), 1.0)
    return value * factor if 0.0 < value < math.inf else None


def _curvature(leg: Leg, u: Array) -> Array:
    """Return the curvature of a geometry [1/m] at distances from its start."""
    if leg.piece is not None:
        length, first, last = leg.piece
        return first + (last - first) * u / length
    # Polynomials have no curvature of their own here: the heading is differentiated, inside of the geometry.
    h = min(0.05, leg.length / 4.0)
    middle = np.clip(u, h, leg.length - h)
    return np.asarray((leg.pose(middle + h)[2] - leg.pose(middle - h)[2]) / (2.0 * h))
