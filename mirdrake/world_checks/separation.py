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

from mirdrake.core.compiled import compiled
from mirdrake.worlds import PlacedProp
from mirdrake.worlds.props import Solid

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Vector = tuple[float, float, float]

TOLERANCE = 5e-4
"""Difference of the bounds at which the search ends [m]."""

_GAP = 1e-6  # [m] accuracy of a ray's end; at least 1e-9 of the size of the solids
_MOST_CASTS = 1_000_000  # of rays against pairs of boxes, after which the search ends
_MOST_LEVELS = 16  # of splitting, down to cones of 1e-5 rad
_POLISHED = 16  # rays per level after which another one is cast along the normal at their end


@dataclass(frozen=True)
class Separation:
    """Translation that separates two sets of solids, and a lower bound of all such translations.

    Attributes:
        translation: translation of the first set, which separates them [m] (3).
        least: lower bound: no shorter translation separates them [m].
    """

    translation: Array
    least: float

    @property
    def depth(self) -> float:
        """Length of the translation [m]."""
        return float(np.linalg.norm(self.translation))


def separate(moving: PlacedProp, fixed: PlacedProp, *, tolerance: float = TOLERANCE) -> Separation:
    """Return the shortest translation of one prop that separates all its solids from those of the other.

    Args:
        moving: the prop that is translated.
        fixed: the other.
        tolerance: difference of the bounds of the depth at which the search ends [m].
    """
    return _separate(moving, moving.prop.solids, fixed, fixed.prop.solids, tolerance)


def separate_solids(moving: PlacedProp, fixed: PlacedProp, numbers: tuple[int, int]) -> Separation:
    """Return the shortest translation that separates one solid of each prop, regardless of their other solids."""
    first, second = numbers
    return _separate(moving, [moving.prop.solids[first]], fixed, [fixed.prop.solids[second]])


# --- the inner parts ----------------------------------------------------------------------------------------------


def _separate(
    moving: PlacedProp,
    moving_solids: Sequence[Solid],
    fixed: PlacedProp,
    fixed_solids: Sequence[Solid],
    tolerance: float = TOLERANCE,
) -> Separation:
    origin = moving.X_WP.translation()  # coordinates near it are accurate far from the origin of the world
    differences = _Differences(
        [_Core.of(moving, solid, origin) for solid in moving_solids],
        [_Core.of(fixed, solid, origin) for solid in fixed_solids],
    )
    return Separation(np.zeros(3), 0.0) if differences.count == 0 else _search(differences, tolerance)


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
        return cls(solid.corners_in(placed.X_WP) - origin, 0.0, axis, 0.0)

    def span(self) -> tuple[Array, Array]:
        """Return the smallest and the largest x, y, z [m]."""
        # A disc with the unit axis u reaches sqrt(1 - u_i²) radii along the coordinate axis i.
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
        # The difference b - a spans low(b) - high(a) to high(b) - low(a) along each axis.
        lows, highs = low[second] - high[first], high[second] - low[first]
        self.reach = float(min(highs.max(axis=0).min(), -lows.min(axis=0).max()))  # separates along an axis
        # A difference beyond the reach cannot block a shorter translation; without reach nothing overlaps.
        within_reach = (lows < self.reach).all(axis=1) & (highs > -self.reach).all(axis=1) & (self.reach > 0.0)
        self.pairs = np.column_stack((first, second))[within_reach]
        self.count = len(self.pairs)
        sizes = np.array([len(core.points) for core in cores])
        self.cost = 20.0 + float(sizes[self.pairs].sum()) / 16.0  # of a ray, in casts against a pair of boxes
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
        return compiled(_cast_rays, parts=_PARTS)(  # type: ignore[no-any-return]
            rays, 1.001 * self.reach + self.gap, self.gap, self.pairs, self.points, self.begin, self.round
        )


def _search(differences: _Differences, tolerance: float) -> Separation:
    """Split cones until the bounds agree."""
    # The first cones are the octants; their rays are the axes.
    signs = np.array([1.0, -1.0])
    rays = np.vstack([sign * np.eye(3) for sign in signs])
    cones = np.array([(i, j, k) for i in (0, 3) for j in (1, 4) for k in (2, 5)])
    near = np.zeros(len(cones))
    enters, leaves, free, normals = differences.cast(rays)
    casts, lower_bound = len(rays) * differences.cost, 0.0
    best = rays[np.argmin(free)] * free.min()
    for _ in range(_MOST_LEVELS):
        # A ray along the normal where a good one ends finds the nearest point of a face or a smooth surface.
        good = np.argsort(free, kind="stable")[:_POLISHED]
        along = normals[good][np.isfinite(free[good])]
        _, _, ends, _ = differences.cast(along)
        casts += len(along) * differences.cost
        for candidates, radii in ((rays, free), (along, ends)):
            if len(radii) and radii.min() < np.linalg.norm(best):
                best = candidates[np.argmin(radii)] * radii.min()
        bound = float(np.linalg.norm(best))

        # A cone that is covered up to the upper bound contains no shorter translation.
        near = compiled(_cover, parts=_PARTS)(cones, near, rays, enters, leaves)
        left = near < bound - tolerance
        cones, near = cones[left], near[left]
        # Cones that were dropped are covered up to the upper bound minus the tolerance.
        lower_bound = min(float(near.min()), bound) if len(near) else max(0.0, bound - tolerance)
        if not len(near):
            break

        # Three new rays split a cone in four; neighbours share them.
        edges = np.sort(cones[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        edges, new = np.unique(edges, axis=0, return_inverse=True)
        casts += len(edges) * differences.cost
        if casts > _MOST_CASTS:
            break
        middles = rays[edges].sum(axis=1)
        middles /= np.linalg.norm(middles, axis=1)[:, None]
        a, b, c = cones.T
        # `new` leads from the three edges of each cone to their new rays.
        ab, bc, ca = (new.reshape(-1, 3) + len(rays)).T
        cones = np.concatenate([np.column_stack(t) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
        # A part of a cone is covered at least as far as the whole.
        near = np.tile(near, 4)
        more = differences.cast(middles)
        rays, enters, leaves, free, normals = (
            np.concatenate(pair) for pair in zip((rays, enters, leaves, free, normals), (middles, *more), strict=True)
        )
    return Separation(best, lower_bound)


def _cover(cones: Indices, near: Array, rays: Array, enters: Array, leaves: Array) -> Array:
    """Return the radius up to which each cone is covered by differences, one after the other."""
    reached = near.copy()
    for index in range(len(cones)):
        a, b, c = cones[index, 0], cones[index, 1], cones[index, 2]
        corner = _row(rays, a)
        normal = _cross(_minus(_row(rays, b), corner), _minus(_row(rays, c), corner))
        flat = abs(_dot(normal, corner)) / math.sqrt(_dot(normal, normal))  # distance of the plane through the corners
        # Repeated, since a difference that comes later in the list may close the gap before an earlier one.
        begin = -1.0
        while reached[index] > begin:
            begin = reached[index]
            for k in range(enters.shape[1]):
                # The difference continues the cover only if all three rays have entered it before.
                if max(enters[a, k], enters[b, k], enters[c, k]) <= begin:
                    # A convex set that reaches radius r on three rays holds the triangle between them, flat * r away.
                    end = flat * min(leaves[a, k], leaves[b, k], leaves[c, k])
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
    first, last, faces = np.empty(size), np.empty(size), np.empty((size, 3))
    # A ray that begins inside of a difference enters it there, whichever way it goes.
    zero = (0.0, 0.0, 0.0)
    inside = np.zeros(size, dtype=np.bool_)
    for k in range(size):
        ahead, sure, _ = _cast_ray(zero, _row(rays, 0), far, gap, pairs[k, 0], pairs[k, 1], points, begin, roundings)
        inside[k] = sure and ahead == 0.0
    for i in range(count):
        ray = _row(rays, i)
        back_ray, end = (-ray[0], -ray[1], -ray[2]), (far * ray[0], far * ray[1], far * ray[2])
        for k in range(size):
            a, b = pairs[k, 0], pairs[k, 1]
            first[k], last[k] = np.inf, -np.inf
            ahead, sure = 0.0, True
            if not inside[k]:
                ahead, sure, _ = _cast_ray(zero, ray, far, gap, a, b, points, begin, roundings)
                if ahead > far:
                    continue
            # Cast from the far end backwards, the ray ends where it leaves the difference.
            back, known, face = _cast_ray(end, back_ray, far, gap, a, b, points, begin, roundings)
            first[k], last[k] = ahead, far - back
            faces[k, 0], faces[k, 1], faces[k, 2] = face
            if sure and known and back <= far:
                enters[i, k], leaves[i, k] = ahead, far - back
        # From one interval into the next that begins before its end.
        more = True
        while more:
            more = False
            for k in range(size):
                if first[k] < free[i] + 1e-9 and last[k] > free[i] + 1e-12:
                    free[i], more = last[k], True
                    normals[i, 0], normals[i, 1], normals[i, 2] = faces[k, 0], faces[k, 1], faces[k, 2]
        if free[i] >= far:
            free[i] = np.inf
    return enters, leaves, free, normals


def _cast_ray(
    start: Vector, ray: Vector, far: float, gap: float, a: int, b: int, points: Array, begin: Indices, roundings: Array
) -> tuple[float, bool, Vector]:
    """Return how far a ray goes to a difference, inf if it misses; whether that is sure; the normal there.

    What is not sure is a lower bound.
    """
    simplex = np.empty((4, 3))
    used, distance = 0, 0.0
    # GJK: `point` is the place on the ray, `off` leads to it from the nearest point of the simplex.
    normal, point = (-ray[0], -ray[1], -ray[2]), start
    off = _minus(point, _support(normal, a, b, points, begin, roundings))
    for _ in range(100):
        length = math.sqrt(_dot(off, off))
        if length <= gap or used == 4:
            return distance, True, normal
        support = _support(off, a, b, points, begin, roundings)
        ahead = _dot(off, _minus(point, support))
        if ahead > 0.0:  # the plane through this point is between the place and the difference
            speed = _dot(off, ray)
            # The ray does not approach the separating plane, so that it misses.
            if speed >= 0.0:
                return np.inf, True, normal
            step = -ahead / speed
            if step > 1e-12:
                distance += step
                if distance > far:
                    return np.inf, True, normal
                point = (start[0] + distance * ray[0], start[1] + distance * ray[1], start[2] + distance * ray[2])
                normal = (off[0] / length, off[1] / length, off[2] / length)
        # A support point that is in the simplex already cannot extend it.
        repeated = False
        for i in range(used):
            if _row(simplex, i) == support:
                repeated = True
        if not repeated:
            simplex[used, 0], simplex[used, 1], simplex[used, 2] = support
            used += 1
        off, used = _reduce(simplex, used, point)
    return distance, False, normal


def _support(direction: Vector, a: int, b: int, points: Array, begin: Indices, roundings: Array) -> Vector:
    """Return the point of the difference of solids b and a that is farthest in a direction."""
    dx, dy, dz = direction
    size = math.sqrt(_dot(direction, direction))
    x, y, z = 0.0, 0.0, 0.0
    # Support of b - a: that of b in the direction, minus that of a in the opposite one.
    for side in range(2):
        solid, sign = (b, 1.0) if side else (a, -1.0)
        largest, best = -np.inf, 0
        for i in range(begin[solid], begin[solid + 1]):
            height = sign * (dx * points[i, 0] + dy * points[i, 1] + dz * points[i, 2])
            if height > largest:
                largest, best = height, i
        ball, disc = roundings[solid, 0] / size, roundings[solid, 1]
        x += sign * points[best, 0] + ball * dx
        y += sign * points[best, 1] + ball * dy
        z += sign * points[best, 2] + ball * dz
        # A cylinder is its axis plus a disc, whose farthest point is across the axis.
        if disc > 0.0:
            ux, uy, uz = roundings[solid, 2], roundings[solid, 3], roundings[solid, 4]
            along = dx * ux + dy * uy + dz * uz
            across = (dx - along * ux, dy - along * uy, dz - along * uz)
            length = math.sqrt(_dot(across, across))
            if length > 1e-12 * size:
                x += disc / length * across[0]
                y += disc / length * across[1]
                z += disc / length * across[2]
    return x, y, z


def _reduce(simplex: Array, used: int, point: Vector) -> tuple[Vector, int]:
    """Reduce up to four points to those whose hull contains the point nearest to a given position.

    Returns:
        the vector from that point to the place; how many points are kept: four if the place is inside.
    """
    off, corners = _minus(point, _row(simplex, 0)), (0, 0, 0, 1)
    if used == 4:
        best, inside = np.inf, True
        for skip in range(4):
            i, j, k = (skip + 1) % 4, (skip + 2) % 4, (skip + 3) % 4
            corner = _row(simplex, i)
            normal = _cross(_minus(_row(simplex, j), corner), _minus(_row(simplex, k), corner))
            # The place is on the side of the opposite corner, so that this face does not separate it.
            if _dot(normal, _minus(_row(simplex, skip), corner)) * _dot(normal, _minus(point, corner)) > 0.0:
                continue
            inside = False
            trial, row = _from_triangle(simplex, i, j, k, point)
            if _dot(trial, trial) < best:
                best, off, corners = _dot(trial, trial), trial, row
        if inside:
            return (0.0, 0.0, 0.0), 4
    elif used == 3:
        off, corners = _from_triangle(simplex, 0, 1, 2, point)
    elif used == 2:
        off, corners = _from_segment(simplex, 0, 1, point)
    # All rows are read before one is overwritten.
    p, q, r = _row(simplex, corners[0]), _row(simplex, corners[1]), _row(simplex, corners[2])
    simplex[0, 0], simplex[0, 1], simplex[0, 2] = p
    simplex[1, 0], simplex[1, 1], simplex[1, 2] = q
    simplex[2, 0], simplex[2, 1], simplex[2, 2] = r
    return off, corners[3]


def _from_segment(simplex: Array, i: int, j: int, point: Vector) -> tuple[Vector, tuple[int, int, int, int]]:
    """Return the vector from the nearest point between two points; the points that span it, and their number."""
    a, b = _row(simplex, i), _row(simplex, j)
    along, off = _minus(b, a), _minus(point, a)
    square, share = _dot(along, along), _dot(along, off)
    if share <= 0.0:
        return off, (i, i, i, 1)
    if share >= square:
        return _minus(point, b), (j, j, j, 1)
    share /= square
    return (off[0] - share * along[0], off[1] - share * along[1], off[2] - share * along[2]), (i, j, j, 2)


def _from_triangle(simplex: Array, i: int, j: int, k: int, point: Vector) -> tuple[Vector, tuple[int, int, int, int]]:
    """Return the vector from the nearest point of a triangle, likewise."""
    a, b, c = _row(simplex, i), _row(simplex, j), _row(simplex, k)
    normal = _cross(_minus(b, a), _minus(c, a))
    square = _dot(normal, normal)
    if (
        square > 0.0
        and _dot(_cross(_minus(b, a), _minus(point, a)), normal) >= 0.0
        and _dot(_cross(_minus(c, b), _minus(point, b)), normal) >= 0.0
        and _dot(_cross(_minus(a, c), _minus(point, c)), normal) >= 0.0
    ):
        # The projection is inside of all edges: the nearest point is in the face.
        share = _dot(_minus(point, a), normal) / square
        return (share * normal[0], share * normal[1], share * normal[2]), (i, j, k, 3)
    off, corners = _from_segment(simplex, i, j, point)
    for p, q in ((j, k), (k, i)):
        trial, row = _from_segment(simplex, p, q, point)
        if _dot(trial, trial) < _dot(off, off):
            off, corners = trial, row
    return off, corners


def _row(rows: Array, index: int) -> Vector:
    return rows[index, 0], rows[index, 1], rows[index, 2]


def _minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


_PARTS = (_row, _minus, _dot, _cross, _support, _from_segment, _from_triangle, _reduce, _cast_ray)
"""Functions that machine code calls."""
