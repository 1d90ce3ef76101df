"""Visual meshes that follow uneven ground: triangles are divided and moved to the height of the terrain.

A triangle is divided into four where the terrain differs by more than a tolerance from the plane through its corners.
The tolerance is small near the roads and grows with the distance from them, so that a large world stays small. Corners
of neighbours may differ by the tolerance.
"""

from dataclasses import replace
from math import sqrt

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from mirdrake.ground import Terrain
from mirdrake.worlds.meshes import Surface
from mirdrake.worlds.pieces import Array

TOLERANCE = 3e-3
"""Largest distance of a mesh from the terrain on and near the roads [m]."""

_GROWTH = 0.01  # growth of the tolerance with the distance from the roads [1]
_LONGEST, _SHORTEST = 2.0, 0.03  # edges of triangles that are always, and never, divided on the roads [m]
_MOST = 400_000  # triangles of a surface; then the coarsest ones stay as they are
_PROBES = np.array(
    [[1, 1, 0], [0, 1, 1], [1, 0, 1], [1, 1, 1], [3, 1, 1], [1, 3, 1], [1, 1, 3]], dtype=float
)  # barycentric coordinates of the points at which a triangle is compared with the terrain, not normalised
_PROBES /= _PROBES.sum(axis=1)[:, None]


def drape(surface: Surface, terrain: Terrain, roads: BaseGeometry) -> Surface:
    """Return a surface that lies on the terrain, at its own height above it.

    Args:
        surface: horizontal or vertical triangles.
        terrain: the ground.
        roads: area near which the mesh is fine [m]; empty: everything is.
    """
    if terrain.flat or not len(surface.triangles):
        return surface
    corners = surface.vertices[surface.triangles]
    uvs = surface.uv[surface.triangles]
    normals = surface.normal[surface.triangles]
    done: list[tuple[Array, Array, Array]] = []
    total = len(corners)
    while len(corners):
        coarse = _coarse(corners, terrain, roads)
        if total + 3 * int(coarse.sum()) > _MOST:
            coarse[:] = False
        done.append((corners[~coarse], uvs[~coarse], normals[~coarse]))
        corners, uvs, normals = (_quarters(values[coarse]) for values in (corners, uvs, normals))
        total += len(corners) * 3 // 4
    points, uv, normal = (
        np.concatenate([part[i] for part in done]).reshape(-1, done[0][i].shape[-1]) for i in range(3)
    )
    slopes = terrain.slopes(points[:, 0], points[:, 1])
    upright = np.abs(normal[:, 2]) > sqrt(0.5)
    tilted = np.column_stack([-slopes[:, 1], -slopes[:, 2], np.ones(len(points))])
    tilted /= np.linalg.norm(tilted, axis=1)[:, None]
    return replace(
        surface,
        vertices=np.column_stack([points[:, :2], points[:, 2] + slopes[:, 0]]),
        triangles=np.arange(len(points), dtype=np.int64).reshape(-1, 3),
        normal=np.where(upright[:, None], tilted, normal),
        uv=uv,
    )


def _coarse(corners: Array, terrain: Terrain, roads: BaseGeometry) -> NDArray[np.bool_]:
    """Return which triangles (N, 3, 3) must be divided."""
    middle = corners[:, :, :2].mean(axis=1)
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    away = np.zeros(len(corners))
    if not roads.is_empty:
        radius = longest  # a large triangle may reach the road
        away = np.maximum(shapely.distance(roads, shapely.points(middle)) - radius, 0.0)
    heights = terrain.height(corners[:, :, 0], corners[:, :, 1])
    points = np.einsum("pc,ncd->npd", _PROBES, corners[:, :, :2])
    error = np.abs(terrain.height(points[..., 0], points[..., 1]) - heights @ _PROBES.T).max(axis=1)
    limit = TOLERANCE + _GROWTH * away
    coarse: NDArray[np.bool_] = (error > limit) & (longest > _SHORTEST + _GROWTH * away)
    return np.asarray(coarse | (longest > _LONGEST + 0.5 * away), dtype=bool)


def _quarters(values: Array) -> Array:
    """Return four triangles (4 N, 3, k) for each one (N, 3, k), divided at the middles of its edges."""
    a, b, c = values[:, 0], values[:, 1], values[:, 2]
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(part, axis=1) for part in parts])
