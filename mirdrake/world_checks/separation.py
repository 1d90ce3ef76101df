"""Depth of an overlap: the length of the shortest translation that separates two sets of convex solids.

A solid A moved by t overlaps a solid B if t is inside the Minkowski difference {b - a}, which is convex. A translation
separates the two sets if it is inside none of these differences, and the depth is the distance from the origin to the
nearest such translation.

::

    rays from the origin ──► where each leaves all differences ──► the shortest one is an upper bound
    cones between three rays ──► how far one difference after the other covers them ──► the lowest is a lower bound
    cones that reach less far than the upper bound ──► split in four, until the bounds agree

A cone is covered between two radii if one difference holds six points around that part, because it is convex. Both
bounds are therefore guaranteed, except that gaps of `_GAP` count as closed. Rays are cast with support functions [1],
so that cylinders, spheres and capsules are not approximated.

[1] G. van den Bergen, Ray casting against general convex objects with application to continuous collision detection,
2004.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Capsule, Cylinder, Sphere

from mirdrake.compiled import compiled
from mirdrake.worlds import PlacedProp
from mirdrake.worlds.props import Solid

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

TOLERANCE = 5e-4
"""Difference of the bounds at which the search ends [m]."""

_GAP = 1e-6  # [m] accuracy of a ray's end, and of coordinates relative to the sizes of the solids: 1e-9
_MOST_CASTS = 200_000  # rays times differences; then the bounds reached so far are the result
_MOST_LEVELS = 16  # of splitting: cones of 1e-5 rad
_POLISHED = 16  # rays per level that are followed by one along the normal of the surface where they end


@dataclass(frozen=True)
class Separation:
    """How two sets of solids can be separated.

    Attributes:
        translation: of the first set, which separates them [m] (3).
        least: no translation shorter than this separates them [m].
    """

    translation: Array
    least: float

    @property
    def depth(self) -> float:
        """Length of the translation [m]."""
        return float(np.linalg.norm(self.translation))


def separate(one: PlacedProp, other: PlacedProp) -> Separation:
    """Return the shortest translation of one prop that separates all its solids from those of the other."""
    origin = one.X_WP.translation()
    moving = [_Core.of(one, solid, origin) for solid in one.prop.solids]
    fixed = [_Core.of(other, solid, origin) for solid in other.prop.solids]
    differences = _Differences(moving, fixed)
    return Separation(np.zeros(3), 0.0) if differences.count == 0 else _search(differences)


# --- the inner parts ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Core:
    """A solid: the convex hull of points (n, 3), plus a disc and a ball [m]; an axis of a disc is a unit vector."""

    points: Array
    ball: float
    axis: Array
    disc: float

    @classmethod
    def of(cls, placed: PlacedProp, solid: Solid, origin: Array) -> "_Core":
        """Return the solid of a placed prop, seen from a point of W."""
        X_WS, shape = placed.X_WP @ solid.X_PS, solid.shape
        middle, axis = X_WS.translation() - origin, X_WS.rotation().matrix()[:, 2]
        if isinstance(shape, Sphere):
            return cls(middle[None], shape.radius(), axis, 0.0)
        if isinstance(shape, Capsule | Cylinder):
            ends = middle + 0.5 * shape.length() * np.array([[-1.0], [1.0]]) * axis
            radius = shape.radius()
            return cls(ends, radius, axis, 0.0) if isinstance(shape, Capsule) else cls(ends, 0.0, axis, radius)
        return cls(solid.corners @ placed.X_WP.rotation().matrix().T + placed.X_WP.translation() - origin, 0.0, axis, 0)

    def span(self) -> tuple[Array, Array]:
        """Return the smallest and the largest x, y, z [m]."""
        grown = self.ball + self.disc * np.sqrt(np.maximum(0.0, 1.0 - self.axis**2))
        return self.points.min(axis=0) - grown, self.points.max(axis=0) + grown


class _Differences:
    """The Minkowski differences that a shortest translation may meet, as arrays for machine code.

    Args:
        moving: the solids that are translated.
        fixed: the others.
    """

    def __init__(self, moving: Sequence[_Core], fixed: Sequence[_Core]) -> None:
        cores = [*moving, *fixed]
        spans = np.array([core.span() for core in cores])
        low, high = spans[:, 0], spans[:, 1]
        first, second = (part.ravel() for part in np.mgrid[: len(moving), len(moving) : len(cores)])
        lows, highs = low[second] - high[first], high[second] - low[first]
        self.reach = float(min(highs.max(axis=0).min(), -lows.min(axis=0).max()))  # separates along an axis
        kept = (lows < self.reach).all(axis=1) & (highs > -self.reach).all(axis=1) & (self.reach > 0.0)
        self.pairs = np.column_stack((first, second))[kept]
        self.count = len(self.pairs)
        self.points = np.vstack([core.points for core in cores])
        self.begin = np.cumsum([0, *(len(core.points) for core in cores)])
        self.round = np.array([(core.ball, core.disc, *core.axis) for core in cores])
        self.gap = max(_GAP, 1e-9 * float(np.ptp(spans, axis=(0, 1)).max()))

    def cast(self, rays: Array) -> tuple[Array, Array, Array, Array]:
        """Return for each ray (n, 3) where it is inside each difference, and where it has left all of them.

        Returns:
            radii where it enters each (n, k) and where it leaves each (n, k), inf and -inf where it does not;
            radius from which it is free (n); unit normal of the surface there (n, 3).
        """
        functions = (_support, _closest_of_segment, _closest_of_triangle, _closest, _cast_ray)
        return compiled(_cast_rays, parts=functions)(
            rays, 1.001 * self.reach + self.gap, self.gap, self.pairs, self.points, self.begin, self.round
        )  # type: ignore[no-any-return]


def _search(differences: _Differences) -> Separation:
    """Split cones until the bounds agree."""
    signs = np.array([1.0, -1.0])
    rays = np.vstack([sign * np.eye(3) for sign in signs])
    cones = np.array([(i, j, k) for i in (0, 3) for j in (1, 4) for k in (2, 5)])
    near = np.zeros(len(cones))
    enters, leaves, free, normals = differences.cast(rays)
    casts, least = len(rays) * differences.count, 0.0
    best = rays[np.argmin(free)] * free.min()
    for _ in range(_MOST_LEVELS):
        # A ray along the normal where a good one ends finds the nearest point of a face or a smooth surface.
        good = np.argsort(free, kind="stable")[:_POLISHED]
        along = normals[good][np.isfinite(free[good])]
        _, _, ends, _ = differences.cast(along)
        casts += len(along) * differences.count
        for candidates, radii in ((rays, free), (along, ends)):
            if len(radii) and radii.min() < np.linalg.norm(best):
                best = candidates[np.argmin(radii)] * radii.min()
        bound = float(np.linalg.norm(best))

        near = compiled(_cover, parts=())(cones, near, rays, enters, leaves)
        left = near < bound - TOLERANCE
        cones, near = cones[left], near[left]
        least = min(float(near.min()), bound) if len(near) else max(0.0, bound - TOLERANCE)
        if not len(near):
            break

        # Three new rays split a cone in four; neighbours share them.
        edges = np.sort(cones[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        edges, new = np.unique(edges, axis=0, return_inverse=True)
        casts += len(edges) * differences.count
        if casts > _MOST_CASTS:
            break
        middles = rays[edges].sum(axis=1)
        middles /= np.linalg.norm(middles, axis=1)[:, None]
        a, b, c = cones.T
        ab, bc, ca = (new.reshape(-1, 3) + len(rays)).T
        cones = np.concatenate([np.column_stack(t) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
        near = np.tile(near, 4)
        more = differences.cast(middles)
        rays, enters, leaves, free, normals = (
            np.concatenate(pair) for pair in zip((rays, enters, leaves, free, normals), (middles, *more), strict=True)
        )
    return Separation(best, least)


def _cover(cones: Indices, near: Array, rays: Array, enters: Array, leaves: Array) -> Array:
    """Return the radius up to which each cone is covered by differences, one after the other."""
    reached = near.copy()
    for index in range(len(cones)):
        a, b, c = cones[index, 0], cones[index, 1], cones[index, 2]
        normal = np.cross(rays[b] - rays[a], rays[c] - rays[a])
        flat = abs(np.dot(normal, rays[a])) / math.sqrt(np.dot(normal, normal))
        begin = -1.0
        while reached[index] > begin:
            begin = reached[index]
            for k in range(enters.shape[1]):
                if max(enters[a, k], enters[b, k], enters[c, k]) <= begin:
                    end = flat * min(leaves[a, k], leaves[b, k], leaves[c, k])
                    # The inner three points are inside only if the rays have not left before.
                    if end > reached[index]:
                        reached[index] = end
    return reached


def _cast_rays(
    rays: Array, far: float, gap: float, pairs: Indices, points: Array, begin: Indices, roundings: Array
) -> tuple[Array, Array, Array, Array]:
    """Cast rays against all differences; see :meth:`_Differences.cast`."""
    count, size = len(rays), len(pairs)
    enters, leaves = np.full((count, size), np.inf), np.full((count, size), -np.inf)
    free, normals = np.zeros(count), rays.copy()
    outer = np.empty((size, 2))
    last = np.empty((size, 3))
    normal = np.empty(3)
    zero = np.zeros(3)
    for i in range(count):
        ray = rays[i]
        for k in range(size):
            a, b = pairs[k, 0], pairs[k, 1]
            ahead, sure = _cast_ray(zero, ray, far, gap, a, b, points, begin, roundings, normal)
            outer[k, 0], outer[k, 1] = np.inf, -np.inf
            if ahead > far:
                continue
            back, known = _cast_ray(far * ray, -ray, far, gap, a, b, points, begin, roundings, normal)
            outer[k, 0], outer[k, 1] = ahead, far - back
            last[k] = normal
            if sure and known and back <= far:
                enters[i, k], leaves[i, k] = ahead, far - back
        # From one interval into the next that begins before its end.
        more = True
        while more:
            more = False
            for k in range(size):
                if outer[k, 0] < free[i] + 1e-9 and outer[k, 1] > free[i] + 1e-12:
                    free[i], normals[i], more = outer[k, 1], last[k], True
        if free[i] >= far:
            free[i] = np.inf
    return enters, leaves, free, normals


def _cast_ray(
    start: Array,
    ray: Array,
    far: float,
    gap: float,
    a: int,
    b: int,
    points: Array,
    begin: Indices,
    roundings: Array,
    normal: Array,
) -> tuple[float, bool]:
    """Return how far a ray goes to a difference, inf if it misses; whether that is sure, not only a lower bound.

    The normal of the surface is written to `normal`.
    """
    simplex = np.empty((4, 3))
    used, at = 0, 0.0
    normal[:] = -ray
    place = start.copy()
    support = np.empty(3)
    _support(-ray, a, b, points, begin, roundings, support)
    off = place - support
    for _ in range(100):
        length = math.sqrt(np.dot(off, off))
        if length <= gap:
            return at, True
        _support(off, a, b, points, begin, roundings, support)
        ahead = np.dot(off, place - support)
        if ahead > 0.0:
            speed = np.dot(off, ray)
            if speed >= 0.0:
                return np.inf, True
            step = -ahead / speed
            if step > 1e-12:
                at += step
                if at > far:
                    return np.inf, True
                place = start + at * ray
                normal[:] = off / length
        repeated = False
        for i in range(used):
            repeated = repeated or np.all(simplex[i] == support)
        if not repeated:
            simplex[used] = support
            used += 1
        used = _closest(simplex, used, place, off)
        if used == 4:
            return at, True
    return at, False


def _support(direction: Array, a: int, b: int, points: Array, begin: Indices, roundings: Array, out: Array) -> None:
    """Write the point of the difference of solids b and a that is farthest in a direction to `out`."""
    dx, dy, dz = direction[0], direction[1], direction[2]
    size = math.sqrt(dx * dx + dy * dy + dz * dz)
    out[:] = 0.0
    for solid, sign in ((a, -1.0), (b, 1.0)):
        most, best = -np.inf, 0
        for i in range(begin[solid], begin[solid + 1]):
            height = sign * (dx * points[i, 0] + dy * points[i, 1] + dz * points[i, 2])
            if height > most:
                most, best = height, i
        ball, disc, axis = roundings[solid, 0], roundings[solid, 1], roundings[solid, 2:]
        out += sign * points[best] + (ball / size) * direction
        if disc > 0.0:
            across = direction - np.dot(direction, axis) * axis
            length = math.sqrt(np.dot(across, across))
            if length > 1e-12 * size:
                out += (disc / length) * across


def _closest(simplex: Array, used: int, place: Array, off: Array) -> int:
    """Keep of up to four points those whose hull holds its nearest point to a place; return their number.

    The vector from that point to the place is written to `off`. Four are kept if the place is inside.
    """
    rows = np.empty((4, 3), dtype=np.int64)
    sizes = np.zeros(4, dtype=np.int64)
    offs = np.empty((4, 3))
    kept = np.empty(3, dtype=np.int64)
    count = 0
    if used == 4:
        inside = True
        for skip in range(4):
            i, j, k = (skip + 1) % 4, (skip + 2) % 4, (skip + 3) % 4
            across = np.cross(simplex[j] - simplex[i], simplex[k] - simplex[i])
            opposite, mine = np.dot(across, simplex[skip] - simplex[i]), np.dot(across, place - simplex[i])
            if opposite * mine > 0.0:
                continue
            inside = False
            sizes[count] = _closest_of_triangle(simplex, i, j, k, place, offs[count], rows[count])
            count += 1
        if inside:
            off[:] = 0.0
            return 4
    elif used == 3:
        sizes[0], count = _closest_of_triangle(simplex, 0, 1, 2, place, offs[0], rows[0]), 1
    elif used == 2:
        sizes[0], count = _closest_of_segment(simplex, 0, 1, place, offs[0], rows[0]), 1
    else:
        off[:] = place - simplex[0]
        return 1
    best = 0
    for i in range(1, count):
        if np.dot(offs[i], offs[i]) < np.dot(offs[best], offs[best]):
            best = i
    off[:] = offs[best]
    kept[:] = rows[best]
    copy = simplex.copy()
    for i in range(sizes[best]):
        simplex[i] = copy[kept[i]]
    return int(sizes[best])


def _closest_of_segment(simplex: Array, i: int, j: int, place: Array, off: Array, kept: Indices) -> int:
    """Like :func:`_closest` for two points, whose indices are written to `kept`."""
    along, to = simplex[j] - simplex[i], place - simplex[i]
    square = np.dot(along, along)
    share = np.dot(along, to) / square if square > 0.0 else 0.0
    kept[0], kept[1] = i, j
    if share <= 0.0:
        off[:] = to
        return 1
    if share >= 1.0:
        off[:] = place - simplex[j]
        kept[0] = j
        return 1
    off[:] = to - share * along
    return 2


def _closest_of_triangle(simplex: Array, i: int, j: int, k: int, place: Array, off: Array, kept: Indices) -> int:
    """Like :func:`_closest_of_segment` for three points."""
    normal = np.cross(simplex[j] - simplex[i], simplex[k] - simplex[i])
    square = np.dot(normal, normal)
    to = place - simplex[i]
    if square > 0.0:
        inside = True
        for p, q in ((i, j), (j, k), (k, i)):
            inside = inside and np.dot(np.cross(simplex[q] - simplex[p], place - simplex[p]), normal) >= 0.0
        if inside:
            off[:] = (np.dot(to, normal) / square) * normal
            kept[0], kept[1], kept[2] = i, j, k
            return 3
    size = 0
    best = np.inf
    trial, row = np.empty(3), np.empty(3, dtype=np.int64)
    for p, q in ((i, j), (j, k), (k, i)):
        count = _closest_of_segment(simplex, p, q, place, trial, row)
        length = np.dot(trial, trial)
        if length < best:
            best, size = length, count
            off[:], kept[:] = trial, row
    return size
