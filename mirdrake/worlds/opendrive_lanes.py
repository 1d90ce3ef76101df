"""One road of an OpenDRIVE file: its geometries end to end, and the edges of its lanes beside them.

After ASAM OpenDRIVE, chapter "Lanes": lanes are side by side from the reference line, shifted by `laneOffset`, with
widths or borders that are cubic in s.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.worlds.opendrive_parts import SAME, Cubics, Places, number_of, read_leg
from mirdrake.worlds.pieces import Array

_SHORTEST = 1e-3  # [m] road


@dataclass(frozen=True)
class _Lane:
    """A lane of a section: its type and id, and the records of its width or its outer border."""

    names: set[str | None]
    widths: Cubics
    borders: Cubics


class RoadPart:
    """A road of the file: its legs, and the t coordinates [m, + left] of the edges of its lanes over s.

    Args:
        road: its element.
        lane: type or id of the lanes that are used.
        places: line of each element, for messages.

    Raises:
        ConfigError: the road has no length, no lanes, or none that is used.

    Attributes:
        where: ``file:line`` of the road.
        name: name of the road, or its id.
        legs: its geometries.
        length: length of all legs [m].
        s: stations [m], N; twice the same where an edge may jump.
        top: the left edge there [m], N.
        bottom: the right edge there [m], N.
    """

    def __init__(self, road: Element, lane: str, places: Places) -> None:
        self.where = places[road]
        self.name = road.get("name", "") or road.get("id", "")
        self._lane, self._places = lane, places
        geometries = sorted(road.iterfind("planView/geometry"), key=lambda part: number_of(part, "s", places))
        legs = [(number_of(part, "s", places), read_leg(part, places)) for part in geometries]
        self.legs = [leg for _, leg in legs if leg is not None]
        if not self.legs:
            raise ConfigError(f"{self.where}: road '{self.name}' has no <geometry> of any length in <planView>")
        self.length = math.fsum(leg.length for leg in self.legs)
        if self.length < _SHORTEST:
            raise ConfigError(f"{self.where}: road '{self.name}' is {self.length:.3g} m long; remove it")

        # Files disagree about where geometries begin: s stated by the file against the sum of the lengths.
        declared = np.array([s for s, leg in legs if leg is not None])
        declared = np.append(declared - declared[0], declared[-1] - declared[0] + self.legs[-1].length)
        real = np.cumsum([0.0] + [leg.length for leg in self.legs])
        for leg, given, travelled in zip(self.legs, declared, real, strict=False):
            if abs(given - travelled) > 1.0 + 0.01 * travelled:
                raise ConfigError(
                    f"{leg.where}: <geometry> begins at s = {given:g} m after the first, but the parts before are "
                    f"{travelled:g} m long; correct s or the lengths"
                )
        s, self.top, self.bottom = self._edges(road, float(declared[-1]))
        # Widths are given over the stated s; the track has the real one.
        self.s = np.interp(s, declared, real)

    def _edges(self, road: Element, length: float) -> tuple[Array, Array, Array]:
        """Return stations, and the left and right edges there; twice the same station where they may jump."""
        offsets = Cubics.read(road.iterfind("lanes/laneOffset"), "s", self._places)
        sections = sorted(road.iterfind("lanes/laneSection"), key=lambda part: number_of(part, "s", self._places))
        if not sections:
            raise ConfigError(f"{self.where}: road '{self.name}' has no <laneSection> and therefore no width")
        # Lanes are counted from the centre to the outside, on either side, and widths add up in this order.
        sides: dict[str, list[tuple[float, list[_Lane]]]] = {"left": [], "right": []}
        breaks = {0.0, length, *offsets.rows[:, 0]}
        for section in sections:
            begin = number_of(section, "s", self._places)
            breaks.add(begin)
            for side, side_lanes in sides.items():
                # A section of one side leaves the section before it valid on the other one.
                if section.get("singleSide") == "true" and section.find(side) is None:
                    continue
                lanes = sorted(section.iterfind(f"{side}/lane"), key=lambda e: abs(number_of(e, "id", self._places)))
                rows = [
                    _Lane(
                        {element.get("type"), element.get("id")},
                        Cubics.read(element.iterfind("width"), "sOffset", self._places, begin=begin),
                        Cubics.read(element.iterfind("border"), "sOffset", self._places, begin=begin),
                    )
                    for element in lanes
                ]
                # Between breaks all edges are polynomials; at breaks they may jump, so stations are repeated there.
                breaks.update(float(s) for row in rows for s in (*row.widths.rows[:, 0], *row.borders.rows[:, 0]))
                side_lanes.append((begin, rows))
        stations: list[Array] = []
        tops: list[Array] = []
        bottoms: list[Array] = []

        # Breaks that differ only by rounding would give parts without length.
        knots = sorted(s for s in breaks if 0.0 <= s <= length)
        knots = [knots[0]] + [b for a, b in itertools.pairwise(knots) if b - a > SAME]
        for begin, end in itertools.pairwise(knots):
            s = np.linspace(begin, end, max(2, math.ceil(end - begin) + 1))
            # The start of a part decides which polynomials hold, because at its end the next ones already do.
            middle = offsets(s, s[0])[0]
            edges = [
                edge
                for sign, side in ((1.0, "left"), (-1.0, "right"))
                for edge in self._lane_edges(sides[side], s, middle, sign)
            ]
            if not edges:
                section = [e for e in sections if number_of(e, "s", self._places) <= begin + SAME or e is sections[0]][
                    -1
                ]
                types = [e.get("type", "") for e in section.iter("lane") if e.get("id") != "0"]
                raise ConfigError(
                    f"{self._places[section]}: no lane '{self._lane}' here; {did_you_mean(self._lane, types)}"
                )
            # The outer edges of the chosen lanes bound the road, also if other lanes are between them.
            stations.append(s)
            tops.append(np.max(edges, axis=0))
            bottoms.append(np.min(edges, axis=0))
        return np.concatenate(stations), np.concatenate(tops), np.concatenate(bottoms)

    def _lane_edges(
        self, sections: Sequence[tuple[float, list[_Lane]]], s: Array, middle: Array, sign: float
    ) -> Iterator[Array]:
        """Yield inner and outer edges of the selected lanes on one side, at stations between two breaks."""
        # The last section that begins before the part; those after it are not valid yet.
        lanes = next((rows for begin, rows in reversed(sections) if begin <= s[0] + SAME), [])
        inner = middle
        for lane in lanes:
            if lane.widths.rows.size or not lane.borders.rows.size:  # widths have priority over borders
                # Widths add up outwards, borders are measured from the reference line; a width below zero is none.
                outer = inner + sign * np.maximum(lane.widths(s, s[0])[0], 0.0)
            else:
                outer = middle + lane.borders(s, s[0])[0]
            if self._lane in lane.names:
                yield inner
                yield outer
            inner = outer
