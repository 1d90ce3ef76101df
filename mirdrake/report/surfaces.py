"""The surfaces of a vehicle as triangles, and a shaded picture of them along one axis: a drawing to scale.

Drake's own renderer has perspective only, and needs EGL; see :mod:`mirdrake.viewer.raster`.
"""

import io
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from pydrake.geometry import (
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    GeometryId,
    Mesh,
    Role,
    SceneGraphInspector,
    Shape,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.tree import BodyIndex

from mirdrake.core.hulls import hull_points
from mirdrake.vehicles import Vehicle
from mirdrake.vehicles.parse import parse_urdf
from mirdrake.viewer.pages import data_address
from mirdrake.viewer.raster import draw_triangles, read_triangles

Array = NDArray[np.float64]
Colour = tuple[float, float, float]

GREY: Colour = (0.62, 0.66, 0.70)
_LIGHT = np.array([0.35, -0.30, 0.89])  # towards the sun
_MOST = 400_000  # triangles that are drawn; of more, every second or third
_VIEWS = {  # axis and sign of what is across and up in the picture, and towards the viewer
    "side": ((0, 1), (2, 1), (1, -1)),
    "top": ((0, 1), (1, 1), (2, 1)),
    "front": ((1, 1), (2, 1), (0, 1)),
}


@dataclass(frozen=True)
class Surface:
    """Triangles of one shape of a vehicle.

    Attributes:
        link: it belongs to.
        triangles: corners in base_link (n, 3, 3) [m].
        colours: colours of the triangles (n, 3), 0 .. 1.
    """

    link: str
    triangles: Array
    colours: Array


def collect_surfaces(
    vehicle: Vehicle, *, collision: bool = False, steering: tuple[float, float] = (0.0, 0.0)
) -> list[Surface]:
    """Return the visual or the collision shapes of a vehicle as triangles.

    Args:
        vehicle: the vehicle.
        collision: whether to return the collision shapes, of meshes their hulls.
        steering: angles of the left and the right wheel [rad].
    """
    plant, scene_graph, _ = parse_urdf(vehicle.urdf, packages=vehicle.packages, where_line=str)
    inspector, context = scene_graph.model_inspector(), plant.CreateDefaultContext()
    base = plant.GetBodyByName(vehicle.spec.base_link)
    # The vehicle frame is at the origin, so that coordinates are those of base_link.
    plant.SetFloatingBaseBodyPoseInWorldFrame(context, base, RigidTransform())
    for name, angle in zip(vehicle.spec.joints.steering.names(), steering, strict=True):
        plant.GetJointByName(name).set_angle(context, angle)
    surfaces: list[Surface] = []
    # Body 0 is the world.
    for number in range(1, plant.num_bodies()):
        body = plant.get_body(BodyIndex(number))
        X_BL = plant.EvalBodyPoseInWorld(context, body)
        shapes = plant.GetCollisionGeometriesForBody(body) if collision else plant.GetVisualGeometriesForBody(body)
        role = Role.kProximity if collision else Role.kIllustration
        for geometry in shapes:
            # Geometries of another role share the list of the body.
            if inspector.GetProperties(geometry, role) is None:
                continue
            X_BG = X_BL @ inspector.GetPoseInFrame(geometry)
            for points, faces, colours in _triangulate(inspector, geometry, collision=collision):
                placed = points @ X_BG.rotation().matrix().T + X_BG.translation()
                surfaces.append(Surface(body.name(), placed[faces], colours))
    return surfaces


def _triangulate(
    inspector: SceneGraphInspector, geometry: GeometryId, *, collision: bool
) -> list[tuple[Array, NDArray[np.int64], Array]]:
    """Return (points, faces, colours) of a shape in its own frame."""
    shape = inspector.GetShape(geometry)
    properties = None if collision else inspector.GetIllustrationProperties(geometry)
    colour: Sequence[float] = GREY
    if properties is not None and properties.HasProperty("phong", "diffuse"):
        rgba = properties.GetProperty("phong", "diffuse")
        colour = (rgba.r(), rgba.g(), rgba.b())
    mesh = _primitive(shape)
    if mesh is None and not collision and isinstance(shape, Mesh) and shape.source().is_path():
        parts = read_triangles(Path(shape.source().path()), colour)
        scale = np.asarray(shape.scale3())
        if parts:
            # Scale and mirror images of the URDF apply to the vertices of the file.
            return [(points * scale, faces, colours) for points, faces, colours in parts]
        _report_hull(str(shape.source().path()))
    if mesh is None:
        points = hull_points(inspector, geometry)
        if points is None:
            return []
        mesh = trimesh.convex.convex_hull(points)
    return [(np.asarray(mesh.vertices), np.asarray(mesh.faces), np.tile(colour, (len(mesh.faces), 1)))]


@lru_cache(maxsize=1024)  # once for each mesh
def _report_hull(name: str) -> None:
    """Warn that the drawings show the convex hull of a mesh file; `name` is its path."""
    logging.getLogger("mirdrake").warning("%s: cannot be read as triangles; drawings show its convex hull", name)


def _primitive(shape: Shape) -> trimesh.Trimesh | None:
    """Return a primitive shape as a mesh; None for other shapes."""
    if isinstance(shape, Box):
        return trimesh.creation.box(extents=shape.size())
    if isinstance(shape, Cylinder):
        return trimesh.creation.cylinder(shape.radius(), shape.length(), sections=64)
    if isinstance(shape, Sphere):
        return trimesh.creation.icosphere(subdivisions=3, radius=shape.radius())
    if isinstance(shape, Capsule):
        capsule = trimesh.creation.capsule(height=shape.length(), radius=shape.radius())
        # Drake's origin is the middle; that of trimesh was once the centre of the lower cap.
        return capsule.apply_translation(-capsule.bounds.mean(axis=0))
    if isinstance(shape, Ellipsoid):
        ball = trimesh.creation.icosphere(subdivisions=3)
        return ball.apply_scale([shape.a(), shape.b(), shape.c()])
    return None


# --- pictures ----------------------------------------------------------------------------------------------------


def picture_of(surfaces: Sequence[Surface], *, view: str, box: tuple[float, float, float, float], width: int) -> str:
    """Return a shaded picture as PNG in a ``data:`` address, for the href of an SVG image.

    Args:
        surfaces: surfaces to draw.
        view: "side", from the right with x to the right and z up; "top", x to the right and y up; "front", from ahead
            with y to the right and z up.
        box: region in the two axes of the view: left, low, right, high [m].
        width: width of the picture [pixel].
    """
    rotation = np.zeros((3, 3))
    for row, (axis, sign) in enumerate(_VIEWS[view]):
        rotation[row, axis] = sign
    triangles = np.concatenate([surface.triangles for surface in surfaces]) if surfaces else np.zeros((0, 3, 3))
    colours = np.concatenate([surface.colours for surface in surfaces]) if surfaces else np.zeros((0, 3))
    # A drawing of a thousand pixels does not need every triangle of a scanned body.
    step = max(1, -(-len(triangles) // _MOST))
    picture = draw_triangles(
        triangles[::step] @ rotation.T, colours[::step], light=rotation @ _LIGHT, box=box, width=width
    )
    file = io.BytesIO()
    picture.save(file, "PNG")
    return data_address(file.getvalue(), "image/png")
