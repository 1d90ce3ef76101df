"""One road of an OpenDRIVE file as a part of a track: its geometries end to end, and the edges of some of its lanes."""

import itertools
import math
from xml.etree.ElementTree import Element

import numpy as np

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.worlds.networks.opendrive_road import RoadLanes
from mirdrake.worlds.opendrive_parts import SAME, Places
from mirdrake.worlds.pieces import Array

_SHORTEST = 1e-3  # [m] road


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
        lanes = RoadLanes(road, places, carry=True)
        self.where, self.name = lanes.where, lanes.name
        self.legs = [leg for _, leg in lanes.legs]
        self.length = math.fsum(leg.length for leg in self.legs)
        if self.length < _SHORTEST:
            raise ConfigError(f"road '{self.name}' is {self.length:.3g} m long; remove it", where=self.where)

        # Files disagree about where geometries begin: s stated by the file against the sum of the lengths.
        declared = np.array([s for s, _ in lanes.legs])
        declared = np.append(declared - declared[0], declared[-1] - declared[0] + self.legs[-1].length)
        real = np.cumsum([0.0] + [leg.length for leg in self.legs])
        for leg, given, travelled in zip(self.legs, declared, real, strict=False):
            if abs(given - travelled) > 1.0 + 0.01 * travelled:
                raise ConfigError(
                    f"<geometry> begins at s = {given:g} m after the first, but the parts before are "
                    f"{travelled:g} m long; correct s or the lengths",
                    where=leg.where,
                )
        s, self.top, self.bottom = _edges(lanes, lane, float(declared[-1]))
        # Widths are given over the stated s; the track has the real one.
        self.s = np.interp(s, declared, real)


def _edges(road: RoadLanes, lane: str, length: float) -> tuple[Array, Array, Array]:
    """Return stations, and the left and right edges there; twice the same station where they may jump."""
    # Breaks that differ only by rounding would give parts without length.
    knots = sorted(s for s in {0.0, length, *road.breaks()} if 0.0 <= s <= length)
    knots = [knots[0]] + [b for a, b in itertools.pairwise(knots) if b - a > SAME]
    parts: list[tuple[Array, Array, Array]] = []
    for begin, end in itertools.pairwise(knots):
        section = road.sections[road.section_at(begin)]
        numbers = list(section.edges_of(lane))
        if not numbers:
            types = [row.element.get("type", "") for row in section.lanes.values()]
            raise ConfigError(f"no lane '{lane}' here; {did_you_mean(lane, types)}", where=section.where)
        # The start of a part decides which polynomials hold, because at its end the next ones already do.
        s = np.linspace(begin, end, max(2, math.ceil(end - begin) + 1))
        edges = road.edges(section, s, float(s[0]))
        # The outer edges of the chosen lanes bound the road, also if other lanes are between them.
        chosen = [edges[number][0] for number in numbers]
        parts.append((s, np.max(chosen, axis=0), np.min(chosen, axis=0)))
    stations, tops, bottoms = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return stations, tops, bottoms
