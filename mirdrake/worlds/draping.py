"""Visual meshes that follow uneven ground: triangles are divided and moved to the height of the terrain.

An edge is halved where the terrain along it differs by more than a tolerance from the line between its ends. This
depends on the edge alone, so that neighbours fit without cracks; the lines that divide a thin triangle have no others
beside them, and stay. The tolerance is small near the roads and grows with
the distance from them, so that a large world stays small.
"""

from dataclasses import replace

import numpy as np
import scipy  # it imports its parts when they are first used
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from mirdrake.ground import Terrain
from mirdrake.worlds.meshes import Surface
from mirdrake.worlds.pieces import Array

TOLERANCE = 4e-3
"""Largest distance of a mesh from the terrain on and near the roads [m]."""

_GROWTH = 0.03  # growth of the tolerance with the distance from the roads [1]
_LONGEST, _SHORTEST = 4.0, 0.06  # edges of triangles that are always, and never, divided on the roads [m]
_EDGE_ERROR = 0.5  # half of the distance of points on the edges of roads [m]
_LEVEL = 0.99  # least z of the normals of horizontal triangles [1]
_MOST = 60_000  # triangles of a surface; then the coarsest ones stay as they are
_PROBES = np.array([0.25, 0.5, 0.75])  # points of an edge at which it is compared with the terrain


class Roads:
    """Distances from roads, up to half a metre too small.

    A search tree of points on their edges is a hundred times faster than exact distances from the polygons.

    Args:
        area: the roads [m]; may be empty.
    """

    def __init__(self, area: BaseGeometry) -> None:
        self._area = area
        shapely.prepare(area)
        edges = shapely.get_coordinates(shapely.segmentize(shapely.boundary(area), 2.0 * _EDGE_ERROR))
        self._tree = None if area.is_empty else scipy.spatial.cKDTree(edges)

    def distances(self, points: Array) -> Array:
        """Return the distance of each point (N, 2) from the nearest road [m]; zero on a road, and without roads."""
        if self._tree is None:
            return np.zeros(len(points))
        outside = np.maximum(self._tree.query(points)[0] - _EDGE_ERROR, 0.0)
        return np.where(shapely.contains_xy(self._area, points), 0.0, outside)


def drape(surface: Surface, terrain: Terrain, roads: Roads) -> Surface:
    """Return a surface that lies on the terrain, at its own height above it.

    Args:
        surface: horizontal triangles, or the faces at an edge.
        terrain: the ground.
        roads: area near which the mesh is fine; empty: everything is.
    """
    # On flat ground a mesh already lies where it should.
    if terrain.flat or not len(surface.triangles):
        return surface
    # Corners as rows: x, y, z, u, v and the normal.
    values = np.concatenate([surface.vertices, surface.uv, surface.normal], axis=1)[surface.triangles]
    done: list[Array] = []
    finished, inner = 0, np.zeros(surface.triangles.shape, dtype=bool)
    while len(values):
        long = _long_edges(values[:, :, :2], terrain, roads) & ~inner
        # Each division adds at most three triangles; above the limit the remaining ones are taken as they are.
        if finished + len(values) + 3 * int(long.any(axis=1).sum()) > _MOST:
            long[:] = False
        done.append(values[~long.any(axis=1)])
        finished += len(done[-1])
        values, inner = _divided(values, long, inner)
    rows = np.concatenate(done).reshape(-1, 8)
    points, uv, normal = rows[:, :3], rows[:, 3:5], rows[:, 5:]
    index = np.arange(len(points))
    if (normal[:, 2] > _LEVEL).all():  # horizontal: neighbours share corners
        # Complex numbers, because `unique` of one column is much faster than of rows.
        places = np.round(points[:, 0], 6) + 1j * np.round(points[:, 1], 6)
        _, first, index = np.unique(places, return_index=True, return_inverse=True)
        points, uv, normal = points[first], uv[first], normal[first]
    slopes = terrain.slopes(points[:, 0], points[:, 1])

    # The face at an edge keeps its normal; a horizontal one gets that of the terrain.
    upright = np.abs(normal[:, 2]) > _LEVEL
    tilted = np.column_stack([-slopes[:, 1], -slopes[:, 2], np.ones(len(points))])
    tilted /= np.linalg.norm(tilted, axis=1)[:, None]
    return replace(
        surface,
        vertices=np.column_stack([points[:, :2], points[:, 2] + slopes[:, 0]]),
        triangles=index.reshape(-1, 3).astype(np.int64),
        normal=np.where(upright[:, None], tilted, normal),
        uv=uv,
    )


def _long_edges(corners: Array, terrain: Terrain, roads: Roads) -> NDArray[np.bool_]:
    """Return which edges (N, 3) of triangles (N, 3, 2) must be halved; edge i is from corner i to the next one."""
    begin, end = corners, np.roll(corners, -1, axis=1)
    length = np.linalg.norm(end - begin, axis=2)
    heights = [terrain.height(point[..., 0], point[..., 1]) for point in (begin, end)]
    error = np.zeros_like(length)
    for t in _PROBES:
        position = begin + t * (end - begin)
        line = heights[0] + t * (heights[1] - heights[0])
        error = np.maximum(error, np.abs(terrain.height(position[..., 0], position[..., 1]) - line))
    # Distances take longest, so they are computed only for edges that are halved on the roads.
    away = np.zeros_like(length)
    chosen = ((error > TOLERANCE) & (length > _SHORTEST)) | (length > _LONGEST)
    if chosen.any():  # a long edge may come nearer to the road than its middle
        away[chosen] = np.maximum(roads.distances(0.5 * (begin[chosen] + end[chosen])) - length[chosen], 0.0)
    rough = (error > TOLERANCE + _GROWTH * away) & (length > _SHORTEST + _GROWTH * away)
    return np.asarray(rough | (length > _LONGEST + 0.5 * away), dtype=bool)


def _is_thin(corners: Array) -> NDArray[np.bool_]:
    """Return which triangles (N, 3, 3) have a height below the tolerance.

    They are as near to the terrain as their edges, so that only these are halved, not the lines inside. Else the parts
    of a triangle without area could keep its longest edge in every round, since the terrain can differ from a part of
    an edge, but not from the whole edge.
    """
    sides = np.roll(corners, -1, axis=1) - corners
    longest = np.linalg.norm(sides, axis=2).max(axis=1)
    return np.asarray(np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) <= TOLERANCE * longest)


def _divided(values: Array, long: NDArray[np.bool_], inner: NDArray[np.bool_]) -> tuple[Array, NDArray[np.bool_]]:
    """Return the parts of the triangles that have edges to halve, and which of their edges are inside thin ones.

    Args:
        values: corners of the triangles (N, 3, k).
        long: edges to halve (N, 3).
        inner: edges inside thin triangles (N, 3).
    """
    parts: list[Array] = [np.empty((0, 3, values.shape[2]))]
    marks: list[NDArray[np.bool_]] = [np.empty((0, 3), dtype=bool)]
    count, thin = long.sum(axis=1), _is_thin(values[:, :, :3])
    for number in (1, 2, 3):
        # Turn the triangles so that their first edges are the ones to halve.
        of_number = count == number
        chosen, flags = values[of_number], long[of_number]
        if not len(chosen):
            continue
        # With two edges to halve, the first is the one after the edge that stays.
        first = np.argmax(flags & ~np.roll(flags, 1, axis=1), axis=1) if number < 3 else np.zeros(len(chosen), int)
        order = (first[:, None] + np.arange(3)) % 3
        a, b, c = (chosen[np.arange(len(chosen)), order[:, i]] for i in range(3))
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        e, f, g = np.take_along_axis(inner[of_number], order, axis=1).T  # edges ab, bc and ca
        new = thin[of_number]
        # Corners, then edges; all parts keep the winding of their triangle.
        pieces = {
            1: [((a, ab, c), (e, new, g)), ((ab, b, c), (e, f, new))],
            2: [((ab, b, bc), (e, f, new)), ((a, ab, bc), (e, new, new)), ((a, bc, c), (new, f, g))],
            3: [
                ((a, ab, ca), (e, new, g)),
                ((ab, b, bc), (e, f, new)),
                ((ca, bc, c), (new, f, g)),
                ((ab, bc, ca), (new, new, new)),
            ],
        }[number]
        parts += [np.stack(corners, axis=1) for corners, _ in pieces]
        marks += [np.stack(edges, axis=1) for _, edges in pieces]
    return np.concatenate(parts), np.concatenate(marks)
