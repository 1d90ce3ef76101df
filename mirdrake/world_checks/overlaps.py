"""Overlapping props, with depth and position, by the collision shapes of the simulation.

::

    bounding boxes seen from above ──► outlines and heights ──► shortest translation that separates the shapes

The first two steps exclude pairs that cannot overlap. The last one is in separation.py; Drake's penetration queries are
not used, because some of them end the process or return more than the smallest depth.
"""

from collections.abc import Callable, Iterator, Sequence

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from mirdrake.world_checks import sentences
from mirdrake.world_checks.faults import Fault
from mirdrake.world_checks.separation import Separation, separate, separate_solids
from mirdrake.worlds import PlacedProp
from mirdrake.worlds.outlines import Outline, gap_between, outlines_of

LEAST_DEPTH = 1e-4
"""Smallest depth of an overlap [m]; less is contact, or rounding."""

UNCERTAIN = 1e-3
"""Difference of the bounds of a depth above which both are reported [m]."""

MOST_NEIGHBOURS = 100_000
"""Pairs of props whose bounding boxes touch that are examined."""

MOST_OVERLAPS = 200
"""Pairs of props that are reported as overlapping, or as closer than `min_gap`; the others are counted."""

_CHUNK = 256  # props whose neighbours are looked up at once

Pair = tuple[int, int]
MayOverlap = Callable[[PlacedProp, PlacedProp], bool]


class Neighbours:
    """Search for props of a world that are near each other, and their outlines.

    Args:
        props: props of the world.

    Attributes:
        is_crowded: more than `MOST_NEIGHBOURS` pairs are near each other, and only the first ones were returned.
    """

    def __init__(self, props: Sequence[PlacedProp]) -> None:
        self.props = props
        self.is_crowded = False
        self._outlines: dict[int, tuple[Outline, ...]] = {}
        self._bounds = shapely.bounds([prop.footprint for prop in props]).reshape(-1, 4)
        self._heights = np.array([(prop.bottom, prop.top) for prop in props]).reshape(-1, 2)
        xmin, ymin, xmax, ymax = self._bounds.T
        self._tree = shapely.STRtree(shapely.box(xmin, ymin, xmax, ymax))

    def outlines(self, index: int) -> tuple[Outline, ...]:
        """Return the outlines of one prop, in the order of its solids."""
        if index not in self._outlines:
            self._outlines[index] = outlines_of(self.props[index])
        return self._outlines[index]

    def pairs(self, gap: float = 0.0) -> list[Pair]:
        """Return pairs of props whose bounding boxes are within a gap [m], the first one earlier in the file."""
        wide = self._bounds + gap * np.array([-1.0, -1.0, 1.0, 1.0])
        boxes = np.asarray(shapely.box(*wide.T))
        pairs: list[Pair] = []
        # In chunks, because the number of pairs grows with the square of the number of props in one place.
        for begin in range(0, len(boxes), _CHUNK):
            first, second = self._tree.query(boxes[begin : begin + _CHUNK])
            first = first + begin
            near = (
                (first < second)
                & (self._heights[first, 0] <= self._heights[second, 1] + gap)
                & (self._heights[second, 0] <= self._heights[first, 1] + gap)
            )
            pairs += sorted(zip(first[near].tolist(), second[near].tolist(), strict=True))
            if len(pairs) > MOST_NEIGHBOURS:
                self.is_crowded = True
                return pairs[:MOST_NEIGHBOURS]
        return pairs

    def touching(self, area: BaseGeometry) -> list[int]:
        """Return the props whose bounding boxes seen from above touch that of an area."""
        return sorted(self._tree.query(area).tolist())

    def colliding(self, first: int, second: int) -> Iterator[Pair]:
        """Yield the pairs of solids of two props that may overlap."""
        for i, a in enumerate(self.outlines(first)):
            for j, b in enumerate(self.outlines(second)):
                high = min(a.top, b.top) - max(a.bottom, b.bottom)
                if high > LEAST_DEPTH and a.may_touch(b) and gap_between(a, b) < -LEAST_DEPTH:
                    yield i, j

    def gap(self, first: int, second: int) -> float:
        """Return the distance of two props seen from above [m], negative if they overlap."""
        return min(gap_between(a, b) for a in self.outlines(first) for b in self.outlines(second))


def find_overlaps(near: Neighbours, may_overlap: MayOverlap) -> list[Fault]:
    """Return the faults of props that overlap, and one fault if some pairs were not examined.

    Args:
        near: the props.
        may_overlap: whether two props may overlap.
    """
    props = near.props
    faults: list[Fault] = []
    suspects = 0
    for a, b in near.pairs():
        # Broad phase first: only pairs whose shapes collide are examined exactly.
        if may_overlap(props[a], props[b]) or not (solids := list(near.colliding(a, b))):
            continue
        suspects += 1
        # The number of examined pairs bounds the time for a world with a fault in each prop.
        if suspects > MOST_OVERLAPS:
            break
        separation = separate(props[a], props[b])
        if separation.depth > LEAST_DEPTH:
            faults.append(_overlap(near, (a, b), solids, separation))
    if suspects > MOST_OVERLAPS or near.is_crowded:
        faults.append(Fault("unchecked", sentences.too_many_pairs(MOST_OVERLAPS, MOST_NEIGHBOURS), "props"))
    return faults


def _overlap(near: Neighbours, pair: Pair, solids: Sequence[Pair], separation: Separation) -> Fault:
    """Return the fault of two props; its position is that of the deepest overlap of two of their solids."""
    a, b = (near.props[index] for index in pair)
    deepest = max(solids, key=lambda numbers: separate_solids(a, b, numbers).depth) if len(solids) > 1 else solids[0]
    first, second = (near.outlines(index)[number] for index, number in zip(pair, deepest, strict=True))
    shared = shapely.intersection(first.area, second.area)
    height = 0.5 * (max(first.bottom, second.bottom) + min(first.top, second.top))
    position = (float(shared.centroid.x), float(shared.centroid.y), height)
    polygon = tuple((float(x), float(y)) for x, y in shapely.get_coordinates(shared.convex_hull)[:-1])
    depth = separation.depth
    # Bounds that agree to a millimetre are reported as one number.
    min_depth = separation.least if depth - separation.least > UNCERTAIN else depth
    message = sentences.overlap(a, b, (min_depth, depth), position)
    return Fault("overlap", message, a.where, (a.name, b.name), depth, position, polygon)
