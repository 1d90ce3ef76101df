"""Meshes that are too large for convex decomposition: walls are cut along a grid, terrain is rejected."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import shapely
import trimesh
from numpy.typing import NDArray

from mirdrake.core.meshes import area_vectors
from mirdrake.importing.meshes.convex import make_hull
from mirdrake.importing.meshes.write import weld, write_obj
from mirdrake.importing.shape import Shape
from mirdrake.importing.worlds.model import Array
from mirdrake.importing.worlds.prop_folder import pieces_of

LARGE = 15.0
"""Side of a mesh in the plan view [m] above which it may be terrain."""

FLAT = 0.05
"""Thickness up to which a surface is a part of the ground [m]."""

_ROOM = 2.0  # [m] smallest side of a room within walls
_LOW = 0.15  # height over side of what may be terrain or walls around a place
_UPRIGHT = 0.3  # largest z of the normal of a wall
_MOST_PARTS = 180
_MOST_TRIANGLES = 400_000
_MOST_CORNERS = 400


def corners_of(shape: Shape) -> Array:
    """Return the triangles of a shape in its model (n, 3, 3) [m].

    Raises:
        MeshError: the mesh cannot be read.
    """
    pieces, _ = pieces_of(shape)
    corners = np.concatenate([piece.corners for piece in pieces])
    moved: Array = corners @ shape.X_LG.rotation().matrix().T + shape.X_LG.translation()
    return moved


def kind_of(corners: Array) -> str:
    """Return the kind of a mesh [m], z up: solid, walls or terrain.

    Walls enclose a space that is open from above. Terrain is wide and low, so that its hull would be wrong. Any other
    mesh is solid and becomes convex parts.
    """
    # The share of the plan view that is open from above separates rooms and terrain from solids.
    points = corners.reshape(-1, 3)
    edges = np.ptp(points, axis=0)
    side, height = float(edges[:2].max()), float(edges[2])
    if side < _ROOM or height <= FLAT:
        return "solid"
    normal = area_vectors(corners)
    area = np.linalg.norm(normal, axis=1)
    upright = np.abs(normal[:, 2]) <= _UPRIGHT * area
    walled = area[upright].sum() > 0.3 * area.sum() or (upright.any() and _is_level(corners[~upright], area[~upright]))
    gaps = _gaps(corners)
    if walled and np.mean(gaps > 0.5) > 0.5:
        return "walls"
    if side < LARGE or height > _LOW * side or np.mean(gaps * height < max(FLAT, 0.02 * height)) > 0.9:
        return "solid"
    return "walls" if walled else "terrain"


def _is_level(corners: Array, area: Array) -> bool:
    """Return whether at least 80 % of the area of triangles is at one height."""
    order = np.argsort(corners.mean(axis=1)[:, 2])
    height = corners.mean(axis=1)[order, 2]
    if not len(order):
        return True
    middle = height[np.searchsorted(np.cumsum(area[order]), 0.5 * area.sum())]
    return float(area[order][np.abs(height - middle) > FLAT].sum()) < 0.2 * float(area.sum())


def _gaps(corners: Array) -> Array:
    """Return the depth below the convex hull over its height, in the plan view.

    It is sampled at up to 900 points of a grid within the hull in the plan view; 1 at points without a triangle.
    """
    hull = make_hull(corners.reshape(-1, 3))
    low, high = hull.points.min(axis=0), hull.points.max(axis=0)
    steps = (np.arange(30) + 0.5) / 30.0
    places = np.stack(np.meshgrid(*(low[k] + steps * (high[k] - low[k]) for k in (0, 1))), axis=-1).reshape(-1, 2)
    roof = tops_at(hull.points[hull.faces], places)
    covered = np.isfinite(roof)
    gaps: Array = np.clip((roof[covered] - tops_at(corners, places[covered])) / (high[2] - low[2]), 0.0, 1.0)
    return gaps if len(gaps) else np.zeros(1)


def tops_at(corners: Array, places: Array) -> Array:
    """Return the height of the highest triangle at points (n, 2) [m]; -inf without one."""
    flat = corners[:, :, :2]
    a, b = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    double = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    # Upright triangles have no area in the plan view.
    some = np.abs(double) > 1e-9
    corners, flat, a, b, double = corners[some], flat[some], a[some], b[some], double[some]
    heights = np.full(len(places), -np.inf)
    if not len(corners):
        return heights
    # The tree avoids a test of every point against every triangle.
    boxes = shapely.box(*flat.min(axis=1).T, *flat.max(axis=1).T)
    place, face = shapely.STRtree(boxes).query(shapely.points(places), predicate="intersects")
    # Barycentric coordinates in the plan view; the tolerance closes the seams of triangles.
    p = places[place] - flat[face, 0]
    u = (p[:, 0] * b[face, 1] - p[:, 1] * b[face, 0]) / double[face]
    v = (a[face, 0] * p[:, 1] - a[face, 1] * p[:, 0]) / double[face]
    inside = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1.0 + 1e-9)
    z = corners[face, 0, 2] + u * (corners[face, 1, 2] - corners[face, 0, 2])
    z += v * (corners[face, 2, 2] - corners[face, 0, 2])
    np.maximum.at(heights, place[inside], z[inside])
    return heights


def cut_walls(shape: Shape, corners: Array, folder: Path, *, name: str) -> tuple[list[Shape], int]:
    """Return walls as many small convex shapes, and the number of parts that are left out.

    Each convex body of the mesh is one shape. Floors of the others are ignored, and each shape is a connected part
    within a square of a grid. The squares are 0.5 m wide, or as much larger as it takes for 180 parts. Of more than 180
    parts that are not connected the largest ones are kept.

    Args:
        shape: shape that the triangles belong to.
        corners: corners in its model (n, 3, 3) [m].
        folder: folder for the OBJ files.
        name: name of the files, without number.
    """
    points, index = weld(corners.reshape(-1, 3))
    faces = index.reshape(-1, 3)
    bodies = [faces[rows] for rows in _bodies(faces)]
    whole: list[NDArray[np.int64]] = []
    rest: list[NDArray[np.int64]] = []
    # With more bodies than parts all of them are cut along the grid.
    for body in bodies if len(bodies) <= _MOST_PARTS else ():
        (whole if _is_full(points, body) else rest).append(body)
    # Floors and low faces are removed: the ground of the world replaces them.
    faces = np.concatenate(rest or [faces[:0]]) if len(bodies) <= _MOST_PARTS else faces
    parts = [points[np.unique(body)] for body in whole if np.ptp(points[np.unique(body)][:, 2]) > FLAT]
    triangles = points[faces]
    normal = area_vectors(triangles)
    low, high = points[:, 2].min(), points[:, 2].max()
    above = triangles.mean(axis=1)[:, 2] > low + max(FLAT, 0.25 * (high - low))
    faces = faces[above | (np.abs(normal[:, 2]) <= 0.9 * np.linalg.norm(normal, axis=1))]
    # Wider squares until there are few enough parts. Squares wider than the mesh cut nothing more, so that they are
    # the last ones: what is left then are separate bodies.
    width, room, left_out = 0.5, max(_MOST_PARTS - len(parts), 1), 0
    widest = float(np.linalg.norm(np.ptp(points, axis=0)))
    while len(faces):
        last = width > widest
        cut = _parts(points, faces, width, any_number=last)
        if cut is not None and (last or len(cut) <= room):
            if len(cut) > room:
                cut.sort(key=lambda part: -float(np.linalg.norm(np.ptp(part, axis=0))))
                left_out = len(cut) - room
            parts += cut[:room]
            break
        width *= 1.5
    folder.mkdir(parents=True, exist_ok=True)
    shapes = []
    for number, part in enumerate(parts):
        hull = make_hull(part)
        path = folder / f"{name}_{number}.obj"
        write_obj(hull.points, hull.faces, path)
        shapes.append(Shape("convex", mesh=path, where=shape.where))
    return shapes, left_out


def _bodies(faces: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Return the connected parts of a mesh as rows of `faces`; edges of two triangles connect."""
    label = trimesh.graph.connected_component_labels(trimesh.graph.face_adjacency(faces), len(faces))
    order = np.argsort(label, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)


def _is_full(points: Array, faces: NDArray[np.int64]) -> bool:
    """Return whether a body is convex to 2 mm and closed on top."""
    hull = make_hull(points[np.unique(faces)])
    # The matrix of all distances would need too much memory.
    if len(faces) * len(hull.faces) > 2_000_000:
        return False
    return (
        float(hull.depths(points[faces].mean(axis=1)).max()) < 2e-3
        and float(np.mean(_gaps(points[faces]) < 0.05)) > 0.9
    )


def _parts(points: Array, faces: NDArray[np.int64], width: float, *, any_number: bool) -> list[Array] | None:
    """Return the corners of the connected parts within grid cells.

    None if splitting would need too many triangles, or if there are too many parts, unless any number is asked for.
    """
    areas = np.linalg.norm(np.ptp(points[faces], axis=1), axis=1)
    # A triangle is split into about (edge / width)² pieces: too many would exhaust the memory.
    if (np.maximum(1.0, areas / width) ** 2).sum() > max(_MOST_TRIANGLES, len(faces)):
        return None
    points, faces = trimesh.remesh.subdivide_to_size(points, faces, max_edge=width, max_iter=20)
    square = np.floor(points[faces].mean(axis=1)[:, :2] / width).astype(np.int64)
    _, cell = np.unique(square, axis=0, return_inverse=True)
    parts: list[Array] = []
    order = np.argsort(cell.ravel(), kind="stable")
    for group in np.split(order, np.flatnonzero(np.diff(cell.ravel()[order])) + 1):
        used, inner = np.unique(faces[group], return_inverse=True)
        inner = inner.reshape(-1, 3)
        parts += [points[used[np.unique(inner[rows])]] for rows in _bodies(inner)]
        if len(parts) > 20 * _MOST_PARTS and not any_number:
            return None
    return parts


def outline(polygons: Sequence[shapely.Geometry]) -> list[shapely.Polygon]:
    """Return simple polygons [m] that together cover the given ones to 2 cm; holes are cut open."""
    # Rounding to a grid of 1 mm closes slivers between neighbours.
    whole = shapely.union_all([shapely.make_valid(polygon) for polygon in polygons], grid_size=1e-3)
    whole = shapely.simplify(whole.buffer(1e-3), 0.02)
    done: list[shapely.Polygon] = []
    waiting = [part for part in shapely.get_parts(whole) if part.geom_type == "Polygon"]
    while waiting:
        part = waiting.pop()
        if part.area < 0.01 or len(done) + len(waiting) > 500:
            continue
        if not part.interiors and len(part.exterior.coords) <= _MOST_CORNERS:
            done.append(part)
            continue
        xmin, ymin, xmax, ymax = part.bounds
        # A cut through the hole makes its ring a part of the outline.
        hole = part.interiors[0].centroid if part.interiors else part.centroid
        if xmax - xmin > ymax - ymin:
            halves = [shapely.box(xmin, ymin, hole.x, ymax), shapely.box(hole.x, ymin, xmax, ymax)]
        else:
            halves = [shapely.box(xmin, ymin, xmax, hole.y), shapely.box(xmin, hole.y, xmax, ymax)]
        for half in halves:
            pieces = shapely.get_parts(shapely.intersection(part, half))
            waiting += [piece for piece in pieces if piece.geom_type == "Polygon"]
    return sorted(done, key=lambda polygon: polygon.bounds)


def seen_from_above(corners: Array) -> list[shapely.Polygon]:
    """Return the triangles [m] in the plan view, without upright ones."""
    flat = corners[:, :, :2]
    edge1, edge2 = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    area = np.abs(edge1[:, 0] * edge2[:, 1] - edge1[:, 1] * edge2[:, 0])
    return [shapely.Polygon(triangle) for triangle in flat[area > 1e-6]]
