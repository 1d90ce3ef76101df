"""Clearance of a vehicle from props and other vehicles, by its collision shapes.

A vehicle is a :class:`Volume`: outlines seen from above, each between two heights. Each is compared only with the parts
of solids at its own heights, so that a vehicle can pass below a tree crown or a bridge. Steps that wheels roll over are
not obstacles.

The depth of an overlap is the length of the shortest translation in the plane that separates the vehicle from a body.
After a translation t two convex parts A and B overlap if t is inside the Minkowski difference {b - a}, so the depth is
the distance from the origin to the boundary of the union of these polygons.
"""

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from mirdrake.worlds.outlines import section

Array = NDArray[np.float64]

ROLLS_OVER = 2.0 / 3.0
"""Height over the radius of a wheel up to which it rolls over a step."""

FLAT = 0.02
"""Height [m] up to which nothing is an obstacle, as plates and paint."""

_SLICES = 4  # slices of a part that is not a prism
_ALIKE = 1e-6  # [m], [rad] resolution of poses for which depths are cached
_REACH = 1e-9  # [m] smallest common height
_SPARE = 1e-6  # [m] by which a bound of a distance is lowered for rounding


class Part(NamedTuple):
    """A convex part of a vehicle."""

    points: Array
    """points whose convex hull it is (n, 3), in the vehicle's frame B [m]"""
    wheel: bool
    """whether it belongs to a wheel"""


class Slab(NamedTuple):
    """Area of a vehicle between two heights."""

    outline: Array
    """corners of a convex polygon (n, 2), in the vehicle's frame B [m]"""
    low: float
    """[m]"""
    high: float
    """[m]"""


@dataclass(frozen=True)
class Volume:
    """Collision volume of a vehicle.

    Attributes:
        slabs: outlines between heights.
        low: height above the ground from which props are obstacles [m].
    """

    slabs: tuple[Slab, ...]
    low: float

    @classmethod
    def of(cls, parts: Sequence[Part], wheel_radius: float) -> "Volume":
        """Return the volume of a vehicle's convex parts.

        It begins at the ground clearance, or at the height of a step that wheels of a radius [m] cannot roll over.
        """
        body = [float(part.points[:, 2].min()) for part in parts if not part.wheel]
        # Wheels can climb what is lower than this; the body can hit what is higher than its clearance.
        low = max(FLAT, min([ROLLS_OVER * wheel_radius, *body]))
        return cls(tuple(slab for part in parts for slab in _slabs(part.points, low)), low)

    @cached_property
    def high(self) -> float:
        """Height of its top [m]."""
        return max((slab.high for slab in self.slabs), default=self.low)

    @cached_property
    def outline(self) -> Array:
        """Corners of the convex hull of all slabs (n, 2), in B [m]."""
        return _hull(np.vstack([slab.outline for slab in self.slabs]))

    @cached_property
    def reach(self) -> float:
        """Largest distance of a corner from the origin of B in the plane [m]."""
        return max((float(np.hypot(*slab.outline.T).max()) for slab in self.slabs), default=0.0)

    @cached_property
    def bands(self) -> dict[tuple[float, float], list[Array]]:
        """Outlines by their heights."""
        bands: dict[tuple[float, float], list[Array]] = {}
        for slab in self.slabs:
            bands.setdefault((slab.low, slab.high), []).append(slab.outline)
        return bands


def _slabs(points: Array, low: float) -> Iterator[Slab]:
    """Yield slabs that contain a convex part above a height: one for a prism, else slices."""
    bottom, top = max(low, float(points[:, 2].min())), float(points[:, 2].max())
    if top - bottom <= _REACH:
        return
    levels = np.linspace(bottom, top, _SLICES + 1).tolist()
    outlines = [_hull(section(points, *pair)) for pair in itertools.pairwise(levels)]
    whole = _hull(section(points, bottom, top))
    # A prism has the same area in every slice, and is kept as one slab.
    if all(_area(outline) > (1.0 - 1e-9) * _area(whole) for outline in outlines):
        yield Slab(whole, bottom, top)
    else:
        yield from (Slab(*slab) for slab in zip(outlines, levels[:-1], levels[1:], strict=True))


def _hull(points: Array) -> Array:
    corners = shapely.get_coordinates(shapely.convex_hull(shapely.multipoints(points)))
    return np.asarray(corners[:-1] if len(corners) > 2 else corners)


def _area(corners: Array) -> float:
    return float(shapely.area(shapely.convex_hull(shapely.multipoints(corners))))


def place_outline(outline: Array, poses: Array) -> Array:
    """Return the corners (n, m, 2) in W of an outline (m, 2) at poses (n, 3): x, y [m], yaw [rad]."""
    cos, sin = np.cos(poses[:, 2])[:, None], np.sin(poses[:, 2])[:, None]
    x, y = outline.T
    return np.stack((poses[:, :1] + cos * x - sin * y, poses[:, 1:2] + sin * x + cos * y), axis=-1)


def clearance(volume: Volume, poses: Array, props: Iterable[Any], *, rows: Any = slice(None)) -> Array:
    """Return the distance of a vehicle to the nearest prop in the plane [m] (n), negative for the depth of an overlap.

    Props that vehicles drive over do not count. The distance is infinite without other props, and for poses that are
    not finite.

    Args:
        volume: volume of the vehicle.
        poses: x, y [m] and yaw [rad] of its frame B (n, 3).
        props: props with `between` and `prop.driven_over`, see :class:`mirdrake.worlds.PlacedProp`.
        rows: rows of the poses to evaluate; the others are infinite.
    """
    result = np.full(len(poses), math.inf)
    good = np.zeros(len(poses), dtype=bool)
    good[rows] = True
    good &= np.isfinite(poses).all(axis=1)
    index = np.flatnonzero(good)
    solid = [
        prop for prop in props if not prop.prop.driven_over and prop.top > volume.low and prop.bottom < volume.high
    ]
    if not solid or not index.size or not volume.slabs:
        return result
    # Distances by a search tree; only the few pairs that overlap need the depth, which is expensive.
    touched: set[tuple[int, int]] = set()
    nearest = np.full(index.size, math.inf)
    # The largest slab first: most of the others then cannot be nearer, as the circles around them show.
    slabs = sorted((_Placed(slab, poses[index]) for slab in volume.slabs), key=lambda slab: -slab.radius)
    trees: dict[tuple[float, float], tuple[Any, NDArray[np.int64]]] = {}
    for placed in slabs:
        band = placed.slab.low, placed.slab.high
        if band not in trees:
            pairs = [(number, area) for number, prop in enumerate(solid) for area in prop.between(*band)]
            trees[band] = shapely.STRtree([area for _, area in pairs]), np.array([number for number, _ in pairs])
        tree, owners = trees[band]
        if not owners.size:
            continue
        (row, _), away = tree.query_nearest(shapely.points(placed.middle), return_distance=True, all_matches=False)
        near = row[away - placed.radius - _SPARE < np.maximum(nearest[row], _SPARE)]
        if not near.size:
            continue
        shapes = placed.polygons(near)
        (row, _), distance = tree.query_nearest(shapes, return_distance=True, all_matches=False)
        nearest[near[row]] = np.minimum(nearest[near[row]], distance)
        inside = np.flatnonzero(distance <= 0.0)
        # All props that overlap, not only the nearest one found: the deepest overlap counts.
        hit, area = tree.query(shapes[row[inside]], predicate="intersects")
        touched |= set(zip(index[near[row[inside][hit]]].tolist(), owners[area].tolist(), strict=True))
    result[index] = nearest
    known: dict[tuple[int, ...], float] = {}
    for pose, number in sorted(touched):
        # A parked vehicle has thousands of equal poses; rounding makes them equal as keys.
        key = (number, *np.round(poses[pose] / _ALIKE).astype(np.int64).tolist())
        if key not in known:
            known[key] = depth(_pairs_with_prop(volume, poses[pose], solid[number]))
        result[pose] = min(result[pose], -known[key])
    return result


class _Placed:
    """A slab at poses; its polygons are made when they are first used.

    Args:
        slab: the slab.
        poses: x, y [m] and yaw [rad] of frame B (n, 3).
    """

    def __init__(self, slab: Slab, poses: Array) -> None:
        self.slab, self._poses = slab, poses
        centre = 0.5 * (slab.outline.min(axis=0) + slab.outline.max(axis=0))
        self.radius = float(np.hypot(*(slab.outline - centre).T).max())
        self.middle = place_outline(centre[None], poses)[:, 0]
        self._shapes: Any = np.empty(len(poses), dtype=object)
        self._made = np.zeros(len(poses), dtype=bool)

    def polygons(self, rows: NDArray[np.int64]) -> Any:
        """Return the polygons at some of the poses."""
        new = rows[~self._made[rows]]
        if new.size:
            self._shapes[new] = shapely.polygons(place_outline(self.slab.outline, self._poses[new]))
            self._made[new] = True
        return self._shapes[rows]


def clearance_between(
    first_volume: Volume, poses: Array, other: Volume, other_poses: Array, *, rows: Any = slice(None)
) -> Array:
    """Return the distance of two moving vehicles in the plane [m] (n), negative for the depth of an overlap.

    Args:
        first_volume: volume of the first vehicle.
        poses: x, y [m] and yaw [rad] of its frame B (n, 3).
        other: volume of the second vehicle.
        other_poses: its poses (n, 3) at the same times.
        rows: rows of the poses to evaluate; the others are infinite.
    """
    # Rows that are left out, and rows with NaN after a divergence, are infinitely far away.
    result = np.full(len(poses), math.inf)
    good = np.zeros(len(poses), dtype=bool)
    good[rows] = True
    good &= np.isfinite(poses).all(axis=1) & np.isfinite(other_poses).all(axis=1)
    index = np.flatnonzero(good)
    if not index.size:
        return result
    first = [_Placed(slab, poses[index]) for slab in first_volume.slabs]
    second = [_Placed(slab, other_poses[index]) for slab in other.slabs]
    # Bodies are stacks of prisms: only slabs at the same height can touch, for example not a bumper under a trailer.
    pairs = [
        (a, b) for a in first for b in second if min(a.slab.high, b.slab.high) - max(a.slab.low, b.slab.low) > _REACH
    ]
    # The largest pair first: most of the other pairs then cannot be nearer, as the circles around them show.
    nearest = np.full(index.size, math.inf)
    for a, b in sorted(pairs, key=lambda pair: -pair[0].radius - pair[1].radius):
        apart = np.hypot(*(a.middle - b.middle).T) - a.radius - b.radius - _SPARE
        near = np.flatnonzero(apart < nearest)
        nearest[near] = np.minimum(nearest[near], shapely.distance(a.polygons(near), b.polygons(near)))
    result[index] = nearest
    known: dict[tuple[int, ...], float] = {}
    # As above: depths only where outlines overlap, and once per pair of poses.
    for row in np.flatnonzero(result <= 0.0).tolist():
        both = np.concatenate((poses[row], other_poses[row]))
        key = tuple(np.round(both / _ALIKE).astype(np.int64).tolist())
        if key not in known:
            known[key] = depth(
                (
                    place_outline(a.outline, poses[row : row + 1])[0],
                    place_outline(b.outline, other_poses[row : row + 1])[0],
                )
                for a in first_volume.slabs
                for b in other.slabs
                if min(a.high, b.high) - max(a.low, b.low) > _REACH
            )
        result[row] = -known[key]
    return result


def depth(pairs: Iterable[tuple[Array, Array]]) -> float:
    """Return the length of the shortest translation in the plane that separates all pairs [m]; 0 without overlap.

    Args:
        pairs: corners of a convex outline that is translated (n, 2), and of a fixed one (m, 2) [m].
    """
    # Minkowski difference of convex outlines: all translations for which the pair overlaps.
    forbidden = [
        shapely.MultiPoint((stays[None] - moves[:, None]).reshape(-1, 2)).convex_hull for moves, stays in pairs
    ]
    if not forbidden:
        return 0.0
    # The nearest translation outside of all of them is the shortest one that separates every pair.
    area, origin = shapely.union_all(forbidden), shapely.Point(0.0, 0.0)
    return float(area.boundary.distance(origin)) if area.intersects(origin) else 0.0


def _pairs_with_prop(volume: Volume, pose: Array, prop: Any) -> Iterator[tuple[Array, Array]]:
    for (low, high), outlines in volume.bands.items():
        for area in prop.between(low, high):
            stays = shapely.get_coordinates(area)
            for outline in outlines:
                yield place_outline(outline, pose[None])[0], stays
