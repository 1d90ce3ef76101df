"""The surfaces of a vehicle as triangles, and a shaded picture of them along one axis: a drawing to scale.

Parallel projection and a depth buffer; Drake's own renderer has perspective only, and needs EGL.
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
from PIL import Image
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

from mirdrake.core.hulls import read_hull
from mirdrake.vehicles import Vehicle
from mirdrake.vehicles.parse import parse_urdf
from mirdrake.viewer.pages import data_address

Array = NDArray[np.float64]
Colour = tuple[float, float, float]

GREY: Colour = (0.62, 0.66, 0.70)
_UPRIGHT = np.array(
    [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]
)  # glTF has y up (glTF 2.0 specification, section 3.4)
_LIGHT = np.array([0.35, -0.30, 0.89])  # towards the sun
_MOST = 400_000  # triangles that are drawn; of more, every second or third
_AT_ONCE = 1_500_000  # pixels that are looked at together
_VIEWS = {  # axis and sign of what is across and up in the picture, and towards the viewer
    "side": ((0, 1), (2, 1), (1, -1)),
    "top": ((0, 1), (1, 1), (2, 1)),
    "front": ((1, 1), (2, 1), (0, 1)),
}
_FINER = 2  # pixels drawn for one that is kept, each way


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
        parts = _read_mesh(Path(shape.source().path()), colour)
        scale = np.asarray(shape.scale3())
        if parts:
            # Scale and mirror images of the URDF apply to the vertices of the file.
            return [(points * scale, faces, colours) for points, faces, colours in parts]
        _report_hull(str(shape.source().path()))
    if mesh is None:
        hull = read_hull(inspector, geometry)
        if hull is None:
            return []
        points = [hull.vertex(index) for index in range(hull.num_vertices())]
        mesh = trimesh.convex.convex_hull(np.array(points))
    return [(np.asarray(mesh.vertices), np.asarray(mesh.faces), np.tile(colour, (len(mesh.faces), 1)))]


@lru_cache(maxsize=1024)  # once for each mesh
def _report_hull(name: str) -> None:
    """Report that the drawings show another shape than the mesh."""
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


def _read_mesh(path: Path, colour: Sequence[float]) -> list[tuple[Array, NDArray[np.int64], Array]]:
    """Return the parts of a mesh file with the colours of their materials; none if it cannot be read."""
    try:
        scene = trimesh.load(path, force="scene")
        parts = scene.dump()
    except Exception:  # whatever a reader of foreign files raises; the hull is drawn instead
        return []
    upright = path.suffix.lower() in {".gltf", ".glb"}
    surfaces = []
    for part in parts:
        if not isinstance(part, trimesh.Trimesh) or not len(part.faces):
            continue
        points = np.asarray(part.vertices) @ (_UPRIGHT.T if upright else np.eye(3))
        colours = _face_colours(part, colour)
        # glTF stores linear light; the drawing is in sRGB, approximated by gamma 2.2.
        surfaces.append((points, np.asarray(part.faces), colours ** (1.0 / 2.2) if upright else colours))
    return surfaces


def _face_colours(part: trimesh.Trimesh, colour: Sequence[float]) -> Array:
    """Return colours (n, 3) of the faces, 0 .. 1: of the texture, of the material, or the given one."""
    material = getattr(part.visual, "material", None)
    if material is None:
        return np.tile(colour, (len(part.faces), 1))
    texture = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    if texture is not None and getattr(part.visual, "uv", None) is not None:
        of_vertices = np.asarray(part.visual.to_color().vertex_colors)[:, :3] / 255.0
        mean: Array = of_vertices[part.faces].mean(axis=1)
        return mean
    return np.tile(np.asarray(material.main_color)[:3] / 255.0, (len(part.faces), 1))


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
    across, up, near = _VIEWS[view]
    left, low, right, high = box
    columns = _FINER * width
    scale = columns / (right - left)
    rows = _FINER * max(1, round((high - low) * scale / _FINER))
    pixels = np.zeros((rows, columns, 4), dtype=np.uint8)
    if surfaces:
        triangles = np.concatenate([surface.triangles for surface in surfaces])
        colours = np.concatenate([surface.colours for surface in surfaces])
        # A drawing of a thousand pixels does not need every triangle of a scanned body.
        step = -(-len(triangles) // _MOST)
        triangles, colours = triangles[::step], colours[::step]
        normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-12)[:, None]
        # Orientation of foreign meshes is unreliable; every normal is turned to the viewer.
        normals *= np.where(near[1] * normals[:, near[0]] < 0.0, -1.0, 1.0)[:, None]
        light = _LIGHT.copy()
        # The light always comes from the viewer's side.
        light[near[0]] = near[1] * abs(light[near[0]])
        shade = 0.50 + 0.50 * np.clip(normals @ light, 0.0, 1.0) + 0.12 * normals[:, near[0]] * near[1]
        painted = 255.0 * np.clip(colours * shade[:, None] + 0.03, 0.0, 1.0)
        x = (across[1] * triangles[:, :, across[0]] - left) * scale
        y = (high - up[1] * triangles[:, :, up[0]]) * scale
        _fill(pixels, x, y, near[1] * triangles[:, :, near[0]], painted.astype(np.uint8))
    # Reduced by averaging: smooth edges, also in the opacity.
    small = Image.fromarray(pixels).resize((width, rows // _FINER), Image.Resampling.BOX)
    file = io.BytesIO()
    small.save(file, "PNG")
    return data_address(file.getvalue(), "image/png")


def _fill(pixels: NDArray[np.uint8], x: Array, y: Array, depth: Array, colours: NDArray[np.uint8]) -> None:
    """Fill triangles; the nearest triangle of a pixel is visible.

    Args:
        pixels: picture (rows, columns, 4), red, green, blue, opacity; changed.
        x: corners (n, 3), across [pixel].
        y: the same, downwards [pixel].
        depth: the same, towards the viewer.
        colours: colours of the triangles (n, 3).
    """
    rows, columns, _ = pixels.shape
    picture, nearest = pixels.reshape(-1, 4), np.full(rows * columns, -np.inf)
    # Twice the signed area; the barycentric coordinates below are divided by it.
    twice = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
    # Pixels whose middles may be inside: those of the box around each triangle.
    first_x = np.clip(np.ceil(x.min(axis=1) - 0.5), 0, columns).astype(int)
    first_y = np.clip(np.ceil(y.min(axis=1) - 0.5), 0, rows).astype(int)
    wide = np.clip(np.floor(x.max(axis=1) - 0.5) + 1, 0, columns).astype(int) - first_x
    count = np.maximum(wide, 0) * np.maximum(
        np.clip(np.floor(y.max(axis=1) - 0.5) + 1, 0, rows).astype(int) - first_y, 0
    )
    # Triangles seen edge-on cover no pixel and would divide by zero.
    count[np.abs(twice) < 1e-9] = 0
    some = np.nonzero(count)[0]
    begin = 0
    total = np.cumsum(count[some])
    while begin < len(some):
        before = total[begin - 1] if begin else 0
        # At least one triangle at a time, even if it covers more pixels than the limit.
        end = max(begin + 1, int(np.searchsorted(total, before + _AT_ONCE)))
        part = some[begin:end]
        begin = end
        which = np.repeat(part, count[part])
        # Number of each pixel within the box of its triangle, which gives row and column.
        within = np.arange(len(which)) - np.repeat(np.cumsum(count[part]) - count[part], count[part])
        column, row = first_x[which] + within % wide[which], first_y[which] + within // wide[which]
        u, v = column + 0.5 - x[which, 0], row + 0.5 - y[which, 0]
        second = (u * (y[which, 2] - y[which, 0]) - v * (x[which, 2] - x[which, 0])) / twice[which]
        third = (v * (x[which, 1] - x[which, 0]) - u * (y[which, 1] - y[which, 0])) / twice[which]
        z = depth[which, 0] + second * (depth[which, 1] - depth[which, 0]) + third * (depth[which, 2] - depth[which, 0])
        pixel = row * columns + column
        # Tolerance at the edges, so that no gap remains between neighbouring triangles.
        seen = (second >= -1e-9) & (third >= -1e-9) & (second + third <= 1.0 + 1e-9) & (z > nearest[pixel])
        which, pixel, z = which[seen], pixel[seen], z[seen]
        order = np.argsort(z, kind="stable")  # the last one written stays
        pixel, which = pixel[order], which[order]
        nearest[pixel] = z[order]
        picture[pixel, :3] = colours[which]
        picture[pixel, 3] = 255
