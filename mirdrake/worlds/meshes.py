"""Triangulation of flat polygons with textures, and glTF texts of triangles.

Follows the Khronos glTF 2.0 specification: buffers embedded as data URIs, y up. Drake converts it to z up.
A glTF texture repeats outside 0 .. 1 by default, both in Meshcat and in Drake's VTK renderer (an OBJ's does not).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from mirdrake.core.meshes import Primitive, gltf_text, pbr_material

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Surface:
    """Triangles of one material.

    Its normals agree with the winding of the triangles (counter-clockwise seen from outside).
    """

    vertices: Array
    """N x 3 positions [m], z up"""
    triangles: NDArray[np.int64]
    """M x 3 indices of vertices"""
    normal: Array
    """N x 3 unit normals"""
    uv: Array
    """N x 2 texture coordinates, 1 = one tile"""
    color: tuple[float, float, float]
    """linear red, green, blue, 0 .. 1; multiplies the texture"""
    texture: str | None = None
    """name of a texture file"""
    roughness: float = 0.95
    """0 mirrors, 1 is matt"""


def fill(
    polygon: BaseGeometry, *, z: float, tile: float, color: tuple[float, float, float], texture: str | None
) -> Surface:
    """Return a horizontal polygon with its holes as triangles.

    Args:
        polygon: polygon or multipolygon in the xy plane [m].
        z: height [m].
        tile: side of a texture tile [m]; tiles are aligned with the world's axes.
        color: linear red, green, blue.
        texture: name of a texture file.
    """
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(_pieces(polygon)))
    corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3]
    edge1, edge2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    # Counter-clockwise seen from above, as the normal is upwards; the triangulation does not promise it.
    clockwise = edge1[:, 0] * edge2[:, 1] - edge1[:, 1] * edge2[:, 0] < 0.0
    corners[clockwise] = corners[clockwise][:, ::-1]
    places, index = np.unique(corners.reshape(-1, 2) @ [1.0, 1.0j], return_inverse=True)  # quicker than by rows
    xy = np.column_stack((places.real, places.imag))
    vertices = np.column_stack((xy, np.full(len(xy), z)))
    normal = np.tile([0.0, 0.0, 1.0], (len(xy), 1))
    return Surface(vertices, index.reshape(-1, 3).astype(np.int64), normal, xy / tile, color, texture)


def skirt(
    polygon: BaseGeometry, *, height: float, length: float, tile: float, color: tuple[float, float, float]
) -> Surface:
    """Return the faces at the edge of a slab, without texture.

    Args:
        polygon: outline of its top in the xy plane [m].
        height: height of the top, z = 0, above the lower edge of the faces [m].
        length: length of the faces outwards [m].
        tile: side of a texture tile [m].
        color: linear red, green, blue.
    """
    vertices: list[Array] = []
    triangles: list[Array] = []
    normals: list[Array] = []
    count = 0
    for part in shapely.get_parts(shapely.orient_polygons(polygon)):  # outside counter-clockwise, holes clockwise
        for ring in [part.exterior, *part.interiors]:
            a = shapely.get_coordinates(ring)[:-1]
            b = np.roll(a, -1, axis=0)
            along = (b - a) / np.linalg.norm(b - a, axis=1)[:, None]
            # To the right of the direction of the ring, which is outwards for an exterior in counter-clockwise order.
            out = np.c_[along[:, 1], -along[:, 0]]
            # Lower corners on the lines parallel to both neighbouring sides; at spikes not beyond 5 lengths.
            before = np.roll(out, 1, axis=0)
            shift = length * (before + out) / np.maximum(1.0 + np.sum(before * out, axis=1), 0.1)[:, None]
            low_a, low_b = a + shift, b + np.roll(shift, -1, axis=0)
            low, high = np.full(len(a), -height), np.zeros(len(a))
            quad = np.stack((np.c_[low_a, low], np.c_[low_b, low], np.c_[b, high], np.c_[a, high]), axis=1)
            first = count + 4 * np.arange(len(a))[:, None]
            vertices.append(quad.reshape(-1, 3))
            triangles.append((first + np.array([[0, 1, 2, 0, 2, 3]])).reshape(-1, 3))
            normal = np.c_[height * out, np.full(len(a), length)] / np.hypot(height, length)
            normals.append(np.repeat(normal, 4, axis=0))
            count += 4 * len(a)
    points = np.vstack(vertices)
    return Surface(points, np.vstack(triangles).astype(np.int64), np.vstack(normals), points[:, :2] / tile, color)


def make_gltf(surfaces: Sequence[Surface]) -> str:
    """Return a glTF text with one mesh; its textures are named, not embedded, and looked for beside it."""
    images = list(dict.fromkeys(surface.texture for surface in surfaces if surface.texture))
    primitives = []
    for surface in surfaces:
        image = images.index(surface.texture) if surface.texture else None
        material = pbr_material((*surface.color, 1.0), roughness=surface.roughness, texture=image)
        # The second texture coordinate of glTF points down.
        uv = surface.uv * [1.0, -1.0]
        primitives.append(Primitive(surface.vertices, surface.normal, surface.triangles, material, uv))
    return gltf_text(primitives, images=[Path(name).name for name in images])


def _pieces(polygon: BaseGeometry, *, size: float = 60.0) -> NDArray[np.object_]:
    """Return a polygon cut along a grid, because the time of triangulation grows faster than the number of corners.

    The grid is the same for all polygons, so that neighbours are cut at the same points, without cracks between them.
    Parts are halved repeatedly, so that every cut is of a small part. Rectangles are not cut, but get points where the
    grid meets their edges.
    """
    parts = np.asarray(shapely.get_parts(polygon))
    # The triangulation of a small polygon is fast; cutting it would only add triangles.
    if shapely.get_num_coordinates(polygon) < 200:
        return parts
    done: list[NDArray[np.object_]] = []
    # All parts are halved at once along lines of the grid until each is within one cell.
    while parts.size:
        low, high = np.split(shapely.bounds(parts), 2, axis=1)
        first, last = np.floor(low / size + 1e-6), np.ceil(high / size - 1e-6)  # lines of the grid around each part
        cells = last - first
        area = shapely.area(parts)
        # A part within one cell, or a rectangle, which needs few triangles only.
        small, whole = (cells <= 1.0).all(axis=1), area > (1.0 - 1e-12) * np.prod(high - low, axis=1)
        done.append(parts[small])
        done += [np.array([_with_points(low[i], high[i], size)]) for i in np.flatnonzero(whole & ~small)]
        small |= whole
        parts, low, high, first, cells = (values[~small] for values in (parts, low, high, first, cells))
        across = np.argmax(cells, axis=1)[:, None] == [0, 1]  # the longer way
        middle = size * (first + np.floor(cells / 2.0))
        halves = [
            shapely.intersection(parts, shapely.box(*np.hstack((begin, end)).T))
            for begin, end in (
                (low - 1.0, np.where(across, middle, high + 1.0)),
                (np.where(across, middle, low - 1.0), high + 1.0),
            )
        ]
        parts = shapely.get_parts(shapely.get_parts(np.concatenate(halves)))
        # Slivers at the lines of the grid have no area and only disturb the triangulation.
        parts = parts[shapely.area(parts) > 1e-8]
    return np.concatenate(done)


def _with_points(low: Array, high: Array, size: float) -> shapely.Polygon:
    """Return the rectangle between two corners with points on its edges where the lines of a grid meet them."""
    x, y = (
        np.unique([a, *(size * np.arange(np.floor(a / size + 1e-6) + 1.0, np.ceil(b / size - 1e-6))), b])
        for a, b in zip(low, high, strict=True)
    )
    sides = [(x, y[:1]), (x[-1:], y), (x[::-1], y[-1:]), (x[:1], y[::-1])]
    return shapely.Polygon(np.concatenate([np.column_stack(np.broadcast_arrays(*side))[:-1] for side in sides]))
