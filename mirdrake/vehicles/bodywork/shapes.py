"""Building blocks of bodies and wheels: extruded outlines, surfaces of revolution, rounded boxes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry

from mirdrake.vehicles.bodywork.mesh import Mesh

Array = NDArray[np.float64]

ALONG_Z = np.eye(3)
ALONG_Y = np.array([[1.0, 0, 0], [0, 0, 1], [0, 1, 0]])
"""Axes of an extrusion: columns are the outline's first and second axis and the direction of the extrusion."""


def triangulate(shape: BaseGeometry) -> Array:
    """Return the triangles (n, 3, 2) of a plane shape."""
    parts = [part for part in shapely.get_parts(shape) if isinstance(part, Polygon) and part.area > 1e-10]
    triangles = [
        # A triangle is a ring of four points, the last one equal to the first.
        shapely.get_coordinates(shapely.constrained_delaunay_triangles(part)).reshape(-1, 4, 2)[:, :3]
        for part in parts
    ]
    return np.concatenate(triangles) if triangles else np.zeros((0, 3, 2))


def rounded_rectangle(x: tuple[float, float], y: tuple[float, float], radius: float) -> BaseGeometry:
    """Return a rectangle with rounded corners."""
    radius = min(radius, 0.49 * (x[1] - x[0]), 0.49 * (y[1] - y[0]))
    box = shapely.box(x[0] + radius, y[0] + radius, x[1] - radius, y[1] - radius)
    return box.buffer(radius, quad_segs=5)


def extrude(
    material: str, shape: BaseGeometry, low: float, high: float, *, axes: Array = ALONG_Z, bevel: float = 0.0
) -> Mesh:
    """Return an outline extruded from ``low`` to ``high``, with its upper edge bevelled."""
    mesh = Mesh()
    top = shape.buffer(-bevel, quad_segs=3) if bevel else shape

    def place(flat: Array, height: float | Array) -> Array:
        return np.concatenate([flat, np.broadcast_to(height, flat.shape[:-1])[..., None]], axis=-1) @ axes.T

    up = axes[:, 2]
    mesh.add_flat(material, place(triangulate(top), high), up)
    mesh.add_flat(material, place(triangulate(shape), low), -up)
    for part in shapely.get_parts(shape):
        # Oriented rings have the material on their left, so the normal of the wall is to the right, also at holes.
        for ring in (shapely.orient_polygons(part).exterior, *shapely.orient_polygons(part).interiors):
            for a, b in pairwise(np.array(ring.coords)):
                along = (b - a) / max(float(np.linalg.norm(b - a)), 1e-12)
                out = np.array([along[1], -along[0]])
                corners = place(np.stack([a, b, b, a]), np.array([low, low, high - bevel, high - bevel]))
                normal = axes[:, :2] @ out
                mesh.add_flat(material, corners[[[0, 1, 2], [0, 2, 3]]], normal)
                if bevel:
                    rim = place(np.stack([a, b, b - bevel * out, a - bevel * out]),
                                np.array([high - bevel, high - bevel, high, high]))  # fmt: skip
                    mesh.add_flat(material, rim[[[0, 1, 2], [0, 2, 3]]], (normal + up) / np.sqrt(2.0))
    return mesh


def revolve(material: str, profile: Sequence[tuple[float, float]], count: int) -> Mesh:
    """Return a profile of (y, radius) points revolved about y; its outer side is on the left of its direction."""
    mesh = Mesh()
    points = np.array(profile, dtype=float)
    along = np.diff(points, axis=0)
    normals = np.stack([-along[:, 1], along[:, 0]], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    angle = np.linspace(0.0, 2 * np.pi, count + 1)

    def ring(y: float | Array, radius: float | Array) -> Array:
        return np.stack([radius * np.cos(angle), np.full_like(angle, y), radius * np.sin(angle)], axis=1)

    for i, normal in enumerate(normals):
        ends = []
        for k in (i, i + 1):
            other = k - 1 if k == i else k
            # Neighbouring strips share a normal where the profile bends by less than about 55 degrees.
            near = 0 <= other < len(normals) and float(normal @ normals[other]) > 0.55
            mean = normal + normals[other] if near else normal
            ends.append((ring(*points[k]), ring(*(mean / np.linalg.norm(mean)))))
        mesh.add_grid(material, np.stack([ends[0][0], ends[1][0]]), np.stack([ends[0][1], ends[1][1]]))
    return mesh


def rounded_box(
    material: str, size: Sequence[float], *, sharpness: float = 0.4, count: tuple[int, int] = (16, 9)
) -> Mesh:
    """Return a superellipsoid of the given full size about the origin; it is a box for a small ``sharpness``."""
    a = np.linspace(0, 2 * np.pi, count[0] + 1)[:, None]
    b = np.linspace(-np.pi / 2, np.pi / 2, count[1])[None, :]

    def power(value: Array, exponent: float) -> Array:
        # Rounding errors at zero would become large by a small exponent.
        value = np.where(np.abs(value) < 1e-12, 0.0, value)
        result: Array = np.sign(value) * np.abs(value) ** exponent
        return result

    def surface(exponent: float) -> Array:
        level, tall = power(np.cos(b), exponent), power(np.sin(b), exponent)
        parts = (power(np.cos(a), exponent) * level, power(np.sin(a), exponent) * level, np.ones_like(a) * tall)
        return np.stack(parts, axis=-1)

    half = np.array(size) / 2
    # Normals of a superellipsoid: the dual exponent, over the half axes.
    normals = surface(2 - sharpness) / half
    mesh = Mesh()
    mesh.add_grid(
        material,
        surface(sharpness) * half,
        normals / np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12),
    )
    return mesh
