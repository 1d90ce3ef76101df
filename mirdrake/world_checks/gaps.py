"""How wide the way is from one place to another: the narrowest place on the widest way.

A disc of radius r can go from A to B if both lie in one part of what is left when all obstacles have grown by r. That
is exact, but for the corners of the polygons that stand for discs, and quick; r is found by halving.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import shapely
from shapely.geometry.base import BaseGeometry
from shapely.ops import nearest_points

_STEPS = 12
_QUARTER = 8  # segments of a quarter of a disc


@dataclass(frozen=True)
class Gap:
    """The narrowest place on the widest way.

    Attributes:
        width: [m]; 0 if there is no way at all.
        place: x, y in W [m], None if there is no way at all.
        between: indices of the areas on both sides; none for the edge of the ground.
    """

    width: float
    place: tuple[float, float] | None = None
    between: tuple[int, ...] = ()


class Passage:
    """Between two places.

    Args:
        areas: of obstacles.
        domain: rectangle that must not be left.
        start: x, y of a point [m].
        goal: area to reach.
    """

    def __init__(
        self, areas: Sequence[BaseGeometry], domain: BaseGeometry, start: tuple[float, float], goal: BaseGeometry
    ) -> None:
        self._areas, self._domain, self._start, self._goal = areas, domain, shapely.Point(start), goal

    def is_open(self, radius: float) -> bool:
        """Whether a disc of a radius [m] can go."""
        return self._ends(radius)[2]

    def narrowest(self, radius: float) -> Gap:
        """Where a disc of a radius [m], which cannot go, gets stuck; the domain's edge is an obstacle, too."""
        low, high = 1e-3, radius
        if not self.is_open(low):
            return Gap(0.0)
        for _ in range(_STEPS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.is_open(middle) else (low, middle)
        here, there, _ = self._ends(high)
        if here is None or there is None:  # it does not even stand at one of the ends
            end = self._start if here is None else self._goal.centroid
            return self._at(end.x, end.y, low)
        one, other = nearest_points(here, there)
        return self._at(0.5 * (one.x + other.x), 0.5 * (one.y + other.y), low)

    def _at(self, x: float, y: float, radius: float) -> Gap:
        point = shapely.Point(x, y)
        far = shapely.distance(self._areas, point)
        near = [int(index) for index in far.argsort()[:2] if far[index] < 1.5 * radius + 0.1]
        return Gap(2.0 * radius, (x, y), tuple(sorted(near)))

    def _ends(self, radius: float) -> tuple[BaseGeometry | None, BaseGeometry | None, bool]:
        """The free parts in which start and goal lie, and whether a disc can go from one to the other."""
        grown = shapely.union_all(shapely.buffer(list(self._areas), radius, quad_segs=_QUARTER))
        free = shapely.difference(self._domain.buffer(-radius), grown)
        parts = shapely.get_parts(free)
        here = [part for part in parts if part.intersects(self._start)]
        there = [part for part in parts if part.intersects(self._goal)]
        if not here:
            return None, max(there, key=lambda part: part.area, default=None), False
        if here[0] in there:
            return here[0], here[0], True
        return here[0], min(there, key=here[0].distance, default=None), False
