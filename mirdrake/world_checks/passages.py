"""Width of passages: the bottleneck on the widest path between two positions.

A disc of radius r can move from A to B if both are in one part of the free space after all obstacles are grown by r.
This is exact except for the polygons that replace discs; r is found by bisection.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import shapely
from shapely.geometry.base import BaseGeometry
from shapely.ops import nearest_points

_STEPS = 12
_QUARTER = 8  # segments of a quarter of a disc


@dataclass(frozen=True)
class Bottleneck:
    """The narrowest position on the widest path.

    Attributes:
        width: width [m]; 0 if no path exists.
        position: x, y in W [m]; None if no path exists.
        between: indices of the areas on both sides; the edge of the ground has none.
    """

    width: float
    position: tuple[float, float] | None = None
    between: tuple[int, ...] = ()


class Passage:
    """Passage for a disc from a point to an area.

    Args:
        areas: areas of obstacles.
        domain: rectangle in which the disc stays.
        start: x, y of the point [m].
        goal: area to reach.
    """

    def __init__(
        self, areas: Sequence[BaseGeometry], domain: BaseGeometry, start: tuple[float, float], goal: BaseGeometry
    ) -> None:
        self._areas, self._domain, self._start, self._goal = areas, domain, shapely.Point(start), goal

    def is_open(self, radius: float) -> bool:
        """Return whether a disc of a radius [m] can pass."""
        return self._ends(radius)[2]

    def narrowest(self, radius: float) -> Bottleneck:
        """Return where a disc of a radius [m] that cannot pass is stopped; the domain's edge is an obstacle, too."""
        low, high = 1e-3, radius
        if not self.is_open(low):
            return Bottleneck(0.0)
        for _ in range(_STEPS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.is_open(middle) else (low, middle)
        # Just above the largest open radius the free space has two parts, with the bottleneck between them.
        here, to_goal, _ = self._ends(high)
        if here is None or to_goal is None:  # it does not fit at one of the ends
            end = self._start if here is None else self._goal.centroid
            return self._at(end.x, end.y, low)
        a, b = nearest_points(here, to_goal)
        return self._at(0.5 * (a.x + b.x), 0.5 * (a.y + b.y), low)

    def _at(self, x: float, y: float, radius: float) -> Bottleneck:
        point = shapely.Point(x, y)
        far = shapely.distance(self._areas, point)
        near = [int(index) for index in far.argsort()[:2] if far[index] < 1.5 * radius + 0.1]
        return Bottleneck(2.0 * radius, (x, y), tuple(sorted(near)))

    def _ends(self, radius: float) -> tuple[BaseGeometry | None, BaseGeometry | None, bool]:
        """Return the free parts that contain start and goal, and whether a disc can pass from one to the other."""
        grown = shapely.union_all(shapely.buffer(list(self._areas), radius, quad_segs=_QUARTER))
        # In a domain that is smaller by the radius the centre keeps the disc within the edge.
        free = shapely.difference(self._domain.buffer(-radius), grown)
        parts = shapely.get_parts(free)
        here = [part for part in parts if part.intersects(self._start)]
        at_goal = [part for part in parts if part.intersects(self._goal)]
        if not here:
            return None, max(at_goal, key=lambda part: part.area, default=None), False
        if here[0] in at_goal:
            return here[0], here[0], True
        return here[0], min(at_goal, key=here[0].distance, default=None), False
