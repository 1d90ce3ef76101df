"""Fixed objects merged for rendering: boxes and cylinders of one colour become one mesh.

VTK spends time on each object that it draws, however small, while all processors but one wait: without a graphics card
some 0.1 ms in colour and depth, a fifth of a picture of 36 obstacles. Labels distinguish objects, so a
renderer that draws labels does not merge them.
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from pydrake.common import MemoryFile
from pydrake.geometry import (
    Box,
    Cylinder,
    GeometryId,
    GeometryInstance,
    InMemoryMesh,
    Mesh,
    PerceptionProperties,
    RenderLabel,
    SceneGraph,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant

from mirdrake.sensors.cameras.looks import add_to_look, seen_by
from mirdrake.worlds.meshes import Surface, make_gltf

Array = NDArray[np.float64]
Color = tuple[float, float, float]
Faces = tuple[Array, Array, NDArray[np.int64]]
"""Points (n, 3) [m], normals (n, 3), triangles (m, 3)."""

NAME = "scenery/merged"
"""Name of the merged mesh; rays and labels use the geometries that it is made of."""

SIDES = 64
"""Of a cylinder; Drake's own has 50."""

ROUGHNESS = 0.5
"""Of what has a colour only, as Drake draws it."""


def merge_still_things(
    plant: MultibodyPlant, scene_graph: SceneGraph, *, merged_in: Iterable[str], apart_in: Iterable[str] = ()
) -> int:
    """Draw boxes and cylinders that are fixed in the world, and have a colour and no more, as one mesh.

    Args:
        plant: the finalised plant.
        scene_graph: its scene graph, before the renderers are added.
        merged_in: names of the renderers that draw the mesh.
        apart_in: names of those that draw the objects one by one; no others draw them any more.

    Returns:
        how many objects are in the mesh; with less than two, nothing is changed.
    """
    inspector = scene_graph.model_inspector()
    faces_by_color: dict[Color, list[Faces]] = {}
    merged: list[GeometryId] = []
    for geometry in plant.GetVisualGeometriesForBody(plant.world_body()):
        shape, color = inspector.GetShape(geometry), _plain_color(inspector.GetPerceptionProperties(geometry))
        if color is not None and type(shape) in (Box, Cylinder):
            faces = _box(shape) if isinstance(shape, Box) else _cylinder(shape)
            faces_by_color.setdefault(color, []).append(_moved(faces, inspector.GetPoseInFrame(geometry)))
            merged.append(geometry)
    # A single object would gain nothing.
    if len(merged) < 2:
        return 0
    surfaces = [_surface(color, parts) for color, parts in faces_by_color.items()]
    mesh = Mesh(InMemoryMesh(mesh_file=MemoryFile(make_gltf(surfaces), ".gltf", "merged")))
    source = plant.get_source_id()
    whole = scene_graph.RegisterAnchoredGeometry(source, GeometryInstance(RigidTransform(), mesh, NAME))
    look = seen_by(merged_in)
    # Labels do not apply: the renderer that draws labels uses the separate objects.
    look.UpdateProperty("label", "id", RenderLabel.kDontCare)
    scene_graph.AssignRole(source, whole, look)
    # The originals keep their geometry for rays and labels; only the listed renderers draw them from now on.
    apart = seen_by(apart_in)
    for geometry in merged:
        add_to_look(plant, scene_graph, geometry, apart)
    return len(merged)


def _plain_color(look: PerceptionProperties | None) -> Color | None:
    """Return the colour of an opaque geometry without texture and without a specific renderer; else None."""
    if look is None or look.HasGroup("renderer") or not look.HasProperty("phong", "diffuse"):
        return None
    rgba = look.GetProperty("phong", "diffuse")
    if rgba.a() < 1.0 or set(look.GetPropertiesInGroup("phong")) != {"diffuse"}:
        return None
    return (rgba.r(), rgba.g(), rgba.b())


def _surface(color: Color, parts: list[Faces]) -> Surface:
    # Indices of triangles are shifted by the number of points before them.
    begin = np.cumsum([0, *(len(points) for points, _, _ in parts)])
    points, normals = (np.concatenate([part[number] for part in parts]) for number in (0, 1))
    triangles = np.concatenate([part[2] + first for part, first in zip(parts, begin, strict=False)])
    return Surface(points, triangles, normals, np.zeros((len(points), 2)), color, roughness=ROUGHNESS)


def _moved(faces: Faces, X_WG: RigidTransform) -> Faces:
    # Points are rows, so a rotation is a multiplication by R^T from the right.
    points, normals, triangles = faces
    R = X_WG.rotation().matrix()
    return points @ R.T + X_WG.translation(), normals @ R.T, triangles


def _box(box: Box) -> Faces:
    """Return the faces of a box."""
    points: list[Array] = []
    normals: list[Array] = []
    triangles: list[NDArray[np.int64]] = []
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    for axis in range(3):
        # The order of the corners is reversed on the negative side, so that triangles
        # are counter-clockwise seen from outside.
        for side in (-1.0, 1.0):
            corners = np.insert(square[:: int(side)], axis, side, axis=1)
            corners[:, [(axis + 1) % 3, (axis + 2) % 3]] = square[:: int(side)]
            triangles.append(4 * len(triangles) + np.array([[0, 1, 2], [0, 2, 3]]))
            points.append(0.5 * corners * box.size())
            normals.append(np.tile(side * np.eye(3)[axis], (4, 1)))
    return np.concatenate(points), np.concatenate(normals), np.concatenate(triangles)


def _cylinder(cylinder: Cylinder) -> Faces:
    """Return the faces of a cylinder; it looks round, since the normals of its sides are exact."""
    angle = 2.0 * np.pi / SIDES * np.arange(SIDES)
    ring = np.column_stack((np.cos(angle), np.sin(angle), np.zeros(SIDES)))
    up, here = np.array([0.0, 0.0, 1.0]), np.arange(SIDES)
    after = np.roll(here, -1)
    half, radius = 0.5 * cylinder.length(), cylinder.radius()
    low, high = radius * ring - half * up, radius * ring + half * up
    sides = [np.column_stack((here, after, after + SIDES)), np.column_stack((here, after + SIDES, here + SIDES))]
    inner = np.arange(1, SIDES - 1)
    fan = np.column_stack((np.zeros_like(inner), inner, inner + 1))
    # Rings are stored twice: at the edges, side and cap have different normals.
    points = np.concatenate((low, high, low, high))
    normals = np.concatenate((ring, ring, np.tile(-up, (SIDES, 1)), np.tile(up, (SIDES, 1))))
    # The lower cap is reversed, so that it faces down.
    return points, normals, np.concatenate((*sides, fan[:, ::-1] + 2 * SIDES, fan + 3 * SIDES))
