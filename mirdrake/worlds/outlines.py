"""Solids of props seen from above: a convex core and a radius about it, whole or between two heights.

A disc is its centre and its radius, which is exact: two barrels side by side touch. A cylinder that is not upright is
replaced by the prism around it, which is at most 0.9 % of its radius too wide.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import shapely
from numpy.typing import NDArray
from pydrake.geometry import Cylinder, Sphere
from shapely.geometry.base import BaseGeometry

if TYPE_CHECKING:
    from mirdrake.worlds.props import PlacedProp

Array = NDArray[np.float64]

_UPRIGHT = 1e-9  # 1 - |cosine| of an upright axis: 45 µrad
_TOUCH = 1e-9  # [m] smallest height of a solid between two heights
_QUARTER = 24  # segments of a quarter of a disc that becomes a polygon


@dataclass(frozen=True)
class Outline:
    """A solid in the world, seen from above.

    Attributes:
        core: convex hull of its points seen from above, in W [m]; a point for a disc.
        radius: radius of the disc that is swept over the core [m]; 0 for anything with corners.
        bottom: height of its lowest point [m].
        top: height of its highest point [m].
    """

    core: BaseGeometry
    radius: float
    bottom: float
    top: float

    @cached_property
    def area(self) -> BaseGeometry:
        """Covered area as a polygon in W [m]."""
        return self.core.buffer(self.radius, _QUARTER) if self.radius else self.core

    @cached_property
    def bounds(self) -> tuple[float, float, float, float]:
        """Smallest x, y, largest x, y in W [m]."""
        xmin, ymin, xmax, ymax = self.core.bounds
        return xmin - self.radius, ymin - self.radius, xmax + self.radius, ymax + self.radius

    def may_touch(self, other: "Outline") -> bool:
        """Return whether both bounding boxes touch, seen from above."""
        a, b = self.bounds, other.bounds
        return a[0] <= b[2] and b[0] <= a[2] and a[1] <= b[3] and b[1] <= a[3]

    @cached_property
    def corners(self) -> Array:
        """Corners of the core (n, 2) in W [m], without the closing one."""
        points = shapely.get_coordinates(self.core)
        return points[:-1] if len(points) > 2 else points

    @cached_property
    def normals(self) -> Array:
        """Unit normals of the edges of the core (n, 2); a line has one, a point none."""
        corners = self.corners
        if len(corners) < 2:
            return np.empty((0, 2))
        edges = np.roll(corners, -1, axis=0) - corners
        lengths = np.hypot(edges[:, 0], edges[:, 1])
        edges = edges[lengths > 1e-12] / lengths[lengths > 1e-12, None]
        return np.column_stack((-edges[:, 1], edges[:, 0]))


def outlines_of(placed: "PlacedProp", low: float = -math.inf, high: float = math.inf) -> tuple[Outline, ...]:
    """Return the solids of a prop seen from above, in their order.

    Args:
        placed: the prop.
        low: height below which solids are cut off [m]; solids outside of both heights are left out.
        high: height above which solids are cut off [m].
    """
    return tuple(_outlines(placed, low, high))


def section(points: Array, low: float, high: float) -> Array:
    """Return points (m, 2) whose convex hull is a convex solid between two heights, seen from above.

    Args:
        points: points whose convex hull is the solid (n, 3) [m].
        low: height of the lower plane [m].
        high: height of the upper plane [m].
    """
    z = points[:, 2]
    parts = [points[(z >= low) & (z <= high)]]
    for level in (low, high):  # all segments through the plane; those that are not edges end inside the hull
        below, above = points[z < level], points[z > level]
        if len(below) and len(above):
            share = (level - below[:, 2])[:, None] / (above[None, :, 2] - below[:, None, 2])
            parts.append((below[:, None] + share[..., None] * (above[None] - below[:, None])).reshape(-1, 3))
    return np.asarray(np.vstack(parts)[:, :2])


def _outlines(placed: "PlacedProp", low: float, high: float) -> Iterator[Outline]:
    R, p = placed.X_WP.rotation().matrix(), placed.X_WP.translation()
    for solid in placed.prop.solids:
        shape = solid.shape
        middle = R @ solid.X_PS.translation() + p
        if isinstance(shape, Sphere):
            r = shape.radius()
            # The widest circle between both heights is the outline: at the height nearest to the middle of the sphere.
            bottom, top = max(low, middle[2] - r), min(high, middle[2] + r)
            if top - bottom > _TOUCH:
                off = max(0.0, low - middle[2], middle[2] - high)  # of the widest circle from the sphere's middle
                yield Outline(shapely.Point(middle[:2]), math.sqrt(r * r - off * off), bottom, top)
            continue
        points = solid.corners_in(placed.X_WP)
        bottom, top = float(points[:, 2].min()), float(points[:, 2].max())
        if isinstance(shape, Cylinder):
            # Cosine of the tilt: the half height of a tilted cylinder is h/2 cos + r sin.
            upright = abs(float(R[2] @ solid.X_PS.rotation().matrix()[:, 2]))
            half = 0.5 * shape.length() * upright + shape.radius() * math.sqrt(max(0.0, 1.0 - upright**2))
            bottom, top = middle[2] - half, middle[2] + half
            if upright > 1.0 - _UPRIGHT:
                bottom, top = max(low, bottom), min(high, top)
                if top - bottom > _TOUCH:
                    yield Outline(shapely.Point(middle[:2]), shape.radius(), bottom, top)
                continue
        if min(high, top) - max(low, bottom) <= _TOUCH:
            continue
        whole = low <= bottom and high >= top
        # All points if nothing is cut off, as a section is more expensive.
        flat = points[:, :2] if whole else section(points, low, high)
        yield Outline(shapely.MultiPoint(flat).convex_hull, 0.0, max(low, bottom), min(high, top))


def gap_between(first: Outline, second: Outline) -> float:
    """Return the distance of two outlines seen from above [m], negative for the depth of an overlap.

    The depth is the length of the shortest translation that separates them: exact for polygons, and for a disc whose
    centre is outside the other core; otherwise an upper bound.
    """
    apart = float(first.core.distance(second.core))
    if apart > 0.0:
        return apart - first.radius - second.radius
    a, b, normals = first.corners, second.corners, np.concatenate((first.normals, second.normals))
    if not len(normals):  # two discs about the same point
        return -first.radius - second.radius
    # Separating axis theorem: the smallest overlap over all edge normals is the depth.
    spans_a, spans_b = a @ normals.T, b @ normals.T
    overlap = np.minimum(spans_a.max(axis=0) - spans_b.min(axis=0), spans_b.max(axis=0) - spans_a.min(axis=0))
    return -float(overlap.min()) - first.radius - second.radius
