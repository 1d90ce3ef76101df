"""Drivable surfaces: wide level faces of slabs and meshes that are not far above the ground."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePath

import numpy as np
import shapely

from mirdrake.core.meshes import area_vectors
from mirdrake.importing.meshes.read import MeshError
from mirdrake.importing.shape import Shape
from mirdrake.importing.worlds.model import Array, SourceObject
from mirdrake.importing.worlds.prop_folder import as_mesh, pieces_of
from mirdrake.importing.worlds.surfaces import FLAT, LARGE, corners_of, kind_of, outline, seen_from_above, tops_at

HIGHEST = 0.45
"""Height above the ground up to which a wide level face is a road and not the top of an obstacle [m]."""

_LEVEL = math.cos(math.radians(2.0))  # z of the normal of a level face
_GENTLE = math.cos(math.radians(10.0))  # of a road with slopes
_RISE = 0.15  # [m] within a sheet on the ground
_SMALLEST = 1.0  # [m²] of surfaces on the ground
_SMALLEST_RAISED, _NARROWEST_RAISED = 12.0, 1.5  # [m²], [m] of surfaces above it
_STEP, _AROUND = 0.1, 0.5  # [m] height of a step that is an edge, and width of what is around it
_OBSTACLES = ("kerb", "curb", "sidewalk", "pavement_edge", "barrier", "wall", "platform", "stage", "step", "stair",
              "bump", "table", "pallet", "bed", "container", "trailer", "roof")  # fmt: skip
_MOST_TRIANGLES = 60_000
ROAD_WORDS = ("asphalt", "road", "street", "track", "circuit", "highway", "tarmac")
"""Parts of names by which models, materials and parts of a mesh are recognised as roads."""

_NOT_ROAD = (*_OBSTACLES, "sign", "light", "lamp", "mark", "line", "bridge", "building", "house", "fence", "tree",
             "field", "grass", "lawn", "terrain", "ground")  # fmt: skip


@dataclass(eq=False)
class Surface:
    """A part of an object that is ground.

    Attributes:
        obj: the object.
        shapes: shapes that it consists of.
        triangles: its upper faces in W (n, 3, 3) [m].
        polygons: its outlines seen from above [m].
        area: their area [m²].
        top: height in W [m].
        rise: height of its highest over its lowest point [m].
        thickness: the same height, including the faces below [m].
        box: its box; None if it is not a single upright box.
        whole: no part of its shapes is above it.
        words: names of model and materials.
        own_words: the same, of meshes only those that the surface is part of.
    """

    obj: SourceObject
    shapes: list[Shape]
    triangles: Array
    polygons: list[shapely.Polygon]
    area: float
    top: float
    rise: float
    thickness: float
    box: Shape | None
    whole: bool
    words: str
    own_words: str

    @property
    def width(self) -> float:
        """Mean width of the outlines [m]."""
        return 2.0 * self.area / max(sum(polygon.length for polygon in self.polygons), 1e-9)


def surfaces_of(obj: SourceObject, *, seen: bool = False) -> list[Surface]:
    """Return the level faces of an object on which a car could drive, grouped by height, lowest first.

    Args:
        obj: an object of the source.
        seen: look at its visuals instead of its collision shapes.
    """
    shapes = obj.visuals if seen else obj.collisions
    words = " ".join([obj.name, obj.kind, *(shape.address for shape in obj.visuals)])
    # A road of its own mesh beside others, such as track_road.dae beside track_field.dae, is not merged with them.
    road_meshes = [shape for shape in shapes if _names_a_road((PurePath(shape.address).stem, shape.submesh))]
    road_meshes = road_meshes if len(road_meshes) < len(shapes) else []
    floors: list[Surface] = []
    roads: list[Surface] = []
    # Visuals count where collisions are missing or coarse: roads are often drawn on top of a plane.
    for shape in shapes:
        try:
            corners = corners_in_world(shape, obj)
        except MeshError:
            continue
        upper, whole = _upper_faces(corners, shape)
        road = _road_in_mesh(shape, obj, whole=whole)
        if road is not None:
            roads.append(road)
        if not len(upper):
            continue
        name = PurePath(shape.address).stem if shape in road_meshes else words
        # The walls.stl of an arena do not make its floor.stl an obstacle.
        own = " ".join((obj.name, obj.kind, shape.address, shape.submesh)) if shape.kind == "mesh" else words
        surface = _surface(obj, shape, upper, float(corners[:, :, 2].min()), whole=whole, words=name)
        surface.own_words = name if shape in road_meshes else own
        # Only an upright box or plane can be written as a rectangle.
        level = abs(float((obj.X_WM @ shape.X_LG).rotation().matrix()[2, 2])) > _LEVEL
        surface.box = shape if shape.kind in {"box", "plane"} and level else None
        top, polygons = surface.top, surface.polygons
        # Parts of one floor, such as its tiles, are level and have the same names; they become one surface.
        same = next((other for other in floors if other.words == surface.words and abs(other.top - top) <= FLAT), None)
        if same is None:
            floors.append(surface)
            continue
        merged = outline([*same.polygons, *polygons])
        same.shapes.append(shape)
        same.triangles, same.polygons = np.concatenate((same.triangles, upper)), merged
        same.area, same.top = sum(polygon.area for polygon in merged), max(same.top, top)
        same.rise, same.thickness = max(same.rise, surface.rise), max(same.thickness, surface.thickness)
        same.box, same.whole, same.own_words = None, same.whole and whole, f"{same.own_words} {surface.own_words}"
    return sorted((surface for surface in (*floors, *roads) if surface.polygons), key=lambda surface: surface.top)


def _surface(obj: SourceObject, shape: Shape, upper: Array, lowest: float, *, whole: bool, words: str) -> Surface:
    """Return the surface of the upper faces of one shape, whose lowest point is given in W [m]."""
    heights = upper[:, :, 2]
    polygons = outline(seen_from_above(upper))
    rise = float(np.ptp(heights))
    # A surface with a slope has no single height; the median stands for it.
    top = float(heights.max()) if rise <= FLAT else float(np.median(heights))
    area = sum(polygon.area for polygon in polygons)
    thickness = float(heights.max()) - lowest
    return Surface(obj, [shape], upper, polygons, area, top, rise, thickness, None, whole, words, words)


def _road_in_mesh(shape: Shape, obj: SourceObject, *, whole: bool) -> Surface | None:
    """Return the road in a mesh that holds a whole town or circuit, by the names of its parts and materials.

    None if no part is named as a road, or all parts are: the surface of the mesh is the road then.
    """
    if shape.kind != "mesh":
        return None
    pieces, _ = pieces_of(shape)
    roads = [piece for piece in pieces if _names_a_road((*piece.names, piece.material.name))]
    # If all parts have such names, they do not show where the road is.
    if not roads or len(roads) == len(pieces):
        return None
    X = obj.X_WM @ shape.X_LG
    corners = np.concatenate([piece.corners for piece in roads]) @ X.rotation().matrix().T + X.translation()
    if len(corners) > _MOST_TRIANGLES or not np.isfinite(corners).all():
        return None
    normal = area_vectors(corners)
    upper = corners[np.abs(normal[:, 2]) > _GENTLE * np.maximum(np.linalg.norm(normal, axis=1), 1e-12)]
    if not len(upper):
        return None
    words = " ".join(dict.fromkeys(name for piece in roads for name in (*piece.names, piece.material.name)))
    return _surface(obj, shape, upper, float(upper[:, :, 2].min()), whole=whole, words=words)


def _names_a_road(names: Sequence[str]) -> bool:
    """Return whether a name of a part of a mesh means a road, and none an obstacle or a marking."""
    roads = others = False
    for name in names:
        rest = name.lower()
        for word in ROAD_WORDS:
            roads |= word in rest
            rest = rest.replace(word, " ")  # "street" holds "tree"
        others |= any(word in rest for word in _NOT_ROAD)
    return roads and not others


def is_ground(surface: Surface, height: float) -> bool:
    """Return whether a surface is ground and not the top of an obstacle.

    Args:
        surface: the surface.
        height: height of the ground in W [m].
    """
    # On the ground any thin surface counts; above it only wide ones that are not named as an obstacle.
    above = surface.top - height
    named = any(word in surface.own_words.lower() for word in _OBSTACLES)
    if surface.rise > HIGHEST and not surface.whole:
        return False
    if surface.rise <= HIGHEST and above <= FLAT:
        thin = surface.thickness <= 0.1 * math.sqrt(surface.area) or above <= 0.5 * FLAT
        # The foot of a barrier may be level with the ground, and the barrier itself above it.
        foot = named and len(surface.obj.collisions) > len(surface.shapes)
        return surface.area >= _SMALLEST and thin and not foot
    wide = surface.area >= _SMALLEST_RAISED and surface.width >= _NARROWEST_RAISED
    return wide and not named and (above <= HIGHEST or surface.rise > HIGHEST)


def is_island(surface: Surface, others: Iterable[Surface]) -> bool:
    """Return whether a surface is a step above lower surfaces all around it, as the middle of a roundabout is.

    Args:
        surface: the surface.
        others: surfaces of roads and yards; those that touch it at its own height make it a part of them.
    """
    if surface.width < 0.25 * math.sqrt(surface.area):
        return False  # long ones are roads
    area = shapely.union_all(surface.polygons)
    ring = shapely.difference(area.buffer(_AROUND), area)
    lower = []
    for other in others:
        step = surface.top - other.top
        if step > _STEP:
            lower += other.polygons
        elif other is not surface and shapely.union_all(other.polygons).distance(area) <= FLAT:
            return False
    return bool(shapely.intersection(ring, shapely.union_all(lower)).area > 0.95 * ring.area)


def corners_in_world(shape: Shape, obj: SourceObject) -> Array:
    """Return the triangles of a shape in W (n, 3, 3) [m].

    Raises:
        MeshError: its mesh cannot be read, or it has no size.
    """
    if shape.kind == "mesh":
        moved = corners_of(shape)
        X = obj.X_WM
    else:
        mesh = as_mesh(shape)
        moved = np.asarray(mesh.vertices, dtype=float)[np.asarray(mesh.faces)]
        X = obj.X_WM @ shape.X_LG
    placed: Array = moved @ X.rotation().matrix().T + X.translation()
    return placed


def _upper_faces(corners: Array, shape: Shape) -> tuple[Array, bool]:
    """Return the level upper faces of a shape and whether nothing of it is above them; none if it has no wide one."""
    none = corners[:0]
    normal = area_vectors(corners)
    area = np.linalg.norm(normal, axis=1)
    slope = np.abs(normal[:, 2]) / np.maximum(area, 1e-12)
    low, high = float(corners[:, :, 2].min()), float(corners[:, :, 2].max())
    if len(corners) > _MOST_TRIANGLES or not np.isfinite(corners).all() or (slope * area).sum() < 2.0 * _SMALLEST:
        return none, False

    # A slab: its level faces at the top cover it.
    level = slope > _LEVEL
    top = level & (corners[:, :, 2].min(axis=1) > high - FLAT)
    flat_rise = (slope > _GENTLE) & (area > 0.0)
    if (slope * area)[top].sum() >= 0.35 * (slope * area).sum():
        return corners[top], True
    # A sheet with gentle slopes and without upright faces.
    if high - low <= _RISE and (slope * area)[flat_rise].sum() > 0.9 * area.sum():
        return corners[flat_rise], True
    if shape.kind != "mesh":
        return none, False

    # Walls around a floor; a wide sheet with gentle slopes.
    kind = kind_of(corners)
    if kind == "walls":
        order = np.argsort(corners.mean(axis=1)[:, 2][level])
        if not len(order):
            return none, False
        heights, parts = corners.mean(axis=1)[:, 2][level][order], (slope * area)[level][order]
        # The floor has a tenth of the level area below it at most, so that single lower faces do not count.
        lowest = float(heights[np.searchsorted(np.cumsum(parts), 0.1 * parts.sum())])
        floor = level & (np.abs(corners.mean(axis=1)[:, 2] - lowest) <= FLAT)
        if (slope * area)[floor].sum() < 0.3 * (slope * area).sum():
            return none, False
        return corners[floor], False
    if kind == "terrain" and (slope * area)[flat_rise].sum() > 0.9 * area.sum():
        return corners[flat_rise], True
    return none, False


def without(obj: SourceObject, surfaces: list[Surface]) -> SourceObject:
    """Return an object without the collision shapes that are ground, except those with something above them."""
    gone = [shape for surface in surfaces if surface.whole for shape in surface.shapes]
    return replace(obj, collisions=[shape for shape in obj.collisions if all(shape is not other for other in gone)])


def footprints(objects: Iterable[SourceObject], low: float, high: float) -> list[shapely.Polygon]:
    """Return the outlines seen from above [m] of the collision shapes between two heights of W [m].

    The outline is that of the convex hull. Wide meshes are left out, since they may hold a town around its roads.
    """
    outlines = []
    for obj in objects:
        for shape in obj.collisions:
            try:
                points = corners_in_world(shape, obj).reshape(-1, 3)
            except MeshError:
                continue
            wide = shape.kind == "mesh" and float(np.ptp(points[:, :2], axis=0).max(initial=0.0)) > LARGE
            if len(points) and not wide and points[:, 2].max() > low and points[:, 2].min() < high:
                outlines.append(shapely.MultiPoint(points[:, :2]).convex_hull)
    return [polygon for polygon in outlines if isinstance(polygon, shapely.Polygon)]


def heights_below(surfaces: list[Surface], points: Array, height: float) -> Array:
    """Return the height of the surface below each point (n, 3) of W above the ground [m]; 0 without one.

    Args:
        surfaces: surfaces that are ground.
        points: the lowest point of each object [m].
        height: height of the ground in W [m].
    """
    best = np.zeros(len(points))
    for surface in surfaces:
        # A surface at the height of the ground lowers nothing.
        if abs(surface.top - height) < 1e-4 and surface.rise < 1e-3:
            continue
        top = tops_at(surface.triangles, points[:, :2])
        below = np.isfinite(top) & (points[:, 2] > top - FLAT)
        best[below] = np.maximum(best[below], top[below] - height)
    return best
