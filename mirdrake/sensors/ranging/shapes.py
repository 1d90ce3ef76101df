"""Drake's shapes as faces for ray casting.

Box, cylinder, capsule, sphere and ellipsoid are exact; a cone is faceted, within 0.5 mm of the exact surface.
It is imported when the first ray world is made, as trimesh takes long to import.
"""

import io
import logging
from functools import lru_cache
from math import acos, ceil, cos, pi
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from pydrake.geometry import (
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    GeometryId,
    Mesh,
    MeshcatCone,
    SceneGraphInspector,
    Shape,
    Sphere,
)
from pydrake.math import RigidTransform

from mirdrake.core.hulls import hull_points
from mirdrake.core.meshes import area_vectors
from mirdrake.sensors.ranging.faces import Array, Faces, Quadric, flat_faces, joined

_UP = np.array([0.0, 0.0, 1.0])
_SIDES = 64  # of the prism around a cylinder
_CHORD = 5e-4  # [m] by which a faceted cone may miss the true one
_UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # glTF's y up to Drake's z up
_READABLE = {".obj", ".gltf", ".glb", ".stl", ".ply"}


def faces_of(inspector: SceneGraphInspector, geometry: GeometryId) -> Faces | None:
    """Return the faces of a geometry in its own frame; None for a half space and for a mesh that cannot be read.

    A mesh is taken triangle by triangle as it is seen, with its scale; a Convex is its hull.
    """
    shape = inspector.GetShape(geometry)
    faces = _primitive(shape)
    if faces is None and isinstance(shape, Mesh):
        faces = _mesh(shape)
    if faces is None:
        points = hull_points(inspector, geometry)
        if points is not None:
            solid = trimesh.convex.convex_hull(points)
            faces = flat_faces(solid.vertices, solid.faces)
    return faces


def _primitive(shape: Shape) -> Faces | None:
    # Round shapes are enclosed by triangles, which the exact equations replace at the hit.
    if isinstance(shape, Box):
        box = trimesh.creation.box(extents=shape.size())
        return flat_faces(box.vertices, box.faces)
    if isinstance(shape, Cylinder):
        return _tube(shape.radius(), 0.5 * shape.length(), closed=True)
    if isinstance(shape, Sphere):
        return _ball(np.full(3, shape.radius()))
    if isinstance(shape, Ellipsoid):
        return _ball(np.array([shape.a(), shape.b(), shape.c()]))
    if isinstance(shape, Capsule):
        # A capsule is an open tube and two half balls, without inner faces.
        radius, half = shape.radius(), 0.5 * shape.length()
        ball = np.full(3, radius)
        bottom = _ball(ball, high=0.0).moved(RigidTransform([0.0, 0.0, -half]))
        top = _ball(ball, low=0.0).moved(RigidTransform([0.0, 0.0, half]))
        return joined([_tube(radius, half, closed=False), bottom, top])
    if isinstance(shape, MeshcatCone):
        return _cone(shape.height(), shape.a(), shape.b())
    return None


def _tube(radius: float, half: float, *, closed: bool) -> Faces:
    """Return a cylinder about z, wrapped in a prism; with its ends if closed."""
    angle = 2.0 * pi / _SIDES * np.arange(_SIDES)
    # Radius of the corners of a prism whose sides touch the cylinder.
    outer = radius / cos(pi / _SIDES)
    ring = outer * np.column_stack((np.cos(angle), np.sin(angle)))
    low, high = (np.column_stack((ring, np.full(_SIDES, z))) for z in (-half, half))
    low_next, high_next = np.roll(low, -1, axis=0), np.roll(high, -1, axis=0)
    sides = [np.stack((low, low_next, high_next), axis=1), np.stack((low, high_next, high), axis=1)]
    ends = []
    if closed:
        bottom, top = np.broadcast_to([0.0, 0.0, -half], low.shape), np.broadcast_to([0.0, 0.0, half], low.shape)
        ends = [np.stack((bottom, low_next, low), axis=1), np.stack((top, high, high_next), axis=1)]
    corners = np.concatenate(sides + ends)
    # Triangles of the ends follow those of the sides.
    cap = np.arange(len(corners)) >= 2 * _SIDES
    mantle = Quadric(np.diag([1.0 / radius, 1.0 / radius, 0.0]), np.zeros(3), _UP, -half, half)
    return Faces(corners, np.zeros(len(corners), dtype=int), cap, (mantle,))


@lru_cache(maxsize=1)
def _wrapped_sphere() -> Array:
    """Return triangles (m, 3, 3) around a unit sphere, none of them inside of it."""
    corners = np.asarray(trimesh.creation.icosphere(subdivisions=4).triangles)
    normal = area_vectors(corners)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    # Enlarged until no triangle is inside of the sphere: a ray then meets the wrapping before the sphere.
    wrapped: Array = corners / float(np.einsum("ij,ij->i", normal, corners[:, 0]).min())
    return wrapped


def _ball(radii: Array, *, low: float = -np.inf, high: float = np.inf) -> Faces:
    """Return an ellipsoid with radii [m] along x, y, z, cut at two heights [m]; its wrapping is not cut."""
    corners = _wrapped_sphere() * radii
    count = len(corners)
    ball = Quadric(np.diag(1.0 / radii), np.zeros(3), _UP, low, high)
    return Faces(corners, np.zeros(count, dtype=int), np.zeros(count, dtype=bool), (ball,))


def _cone(height: float, a: float, b: float) -> Faces:
    """Return Drake's cone: tip at the origin, elliptic base at z = height."""
    # Sagitta of a chord: r (1 - cos(pi / n)) stays below the limit.
    sides = max(16, ceil(pi / acos(max(1.0 - _CHORD / max(a, b), 0.9))))
    angle = 2.0 * pi / sides * np.arange(sides)
    ring = np.column_stack((a * np.cos(angle), b * np.sin(angle), np.full(sides, height)))
    points = np.vstack((ring, [0.0, 0.0, 0.0], [0.0, 0.0, height]))
    here, after = np.arange(sides), np.roll(np.arange(sides), -1)
    mantle = np.column_stack((after, here, np.full(sides, sides)))
    base = np.column_stack((here, after, np.full(sides, sides + 1)))
    return flat_faces(points, np.concatenate((mantle, base)))


# --- meshes ------------------------------------------------------------------------------------------------------


def _mesh(shape: Mesh) -> Faces | None:
    source = shape.source()
    if source.is_path():
        path = Path(source.path())
        # Files of other formats are not tried; the caller takes the convex hull instead.
        corners = _read_file(path) if path.suffix.lower() in _READABLE else None
    else:
        memory = source.in_memory()
        file, beside = memory.mesh_file, memory.supporting_files
        corners = _read(io.BytesIO(_contents(file)), file.extension().lower(), _Beside(beside))
    if corners is None:
        _report_hull(str(source.path()) if source.is_path() else source.in_memory().mesh_file.filename_hint())
        return None
    corners = corners * np.asarray(shape.scale3())
    count = len(corners)
    # -1: no quadric, the triangles themselves are the surface.
    return Faces(corners, np.full(count, -1), np.zeros(count, dtype=bool))


@lru_cache(maxsize=1024)  # once for each mesh
def _report_hull(name: str) -> None:
    """Report that range sensors see another shape than the mesh."""
    logging.getLogger("mirdrake").warning("%s: cannot be read as triangles; range sensors see its convex hull", name)


@lru_cache(maxsize=256)
def _read_file(path: Path) -> Array | None:
    """Return the triangles (m, 3, 3) of a mesh file, z up; None if it cannot be read."""
    try:
        with path.open("rb") as file:
            return _read(file, path.suffix.lower(), trimesh.resolvers.FilePathResolver(str(path)))
    except OSError:
        return None


def _read(file: Any, extension: str, resolver: Any) -> Array | None:
    if extension not in _READABLE:
        return None
    try:
        # Materials and textures are not needed, and may be missing.
        options: dict[str, Any] = {"skip_materials": True} if extension in {".obj", ".gltf", ".glb"} else {}
        scene = trimesh.load_scene(file, file_type=extension[1:], resolver=resolver, **options)
        parts = [part.triangles for part in scene.dump() if isinstance(part, trimesh.Trimesh) and len(part.faces)]
    except Exception:  # readers of mesh files raise many types; the convex hull is used then
        return None
    if not parts:
        return None
    corners: Array = np.concatenate([np.asarray(part, dtype=float) for part in parts])
    return corners @ _UPRIGHT.T if extension in {".gltf", ".glb"} else corners


class _Beside(trimesh.resolvers.Resolver):
    """Supporting files of a mesh in memory."""

    def __init__(self, files: Any) -> None:
        self._files = dict(files)

    def get(self, name: str) -> bytes:
        """Return the contents of a file by its name in the mesh."""
        return _contents(self._files[name])

    def write(self, name: str, data: bytes) -> None:
        """Nothing is written."""

    def namespaced(self, namespace: str) -> "_Beside":  # noqa: ARG002
        """Return this resolver; there is only one name space."""
        return self

    def keys(self) -> list[str]:
        """Return the names of the files."""
        return list(self._files)


def _contents(file: Any) -> bytes:
    data = file.read_bytes() if isinstance(file, Path) else file.contents()
    return data if isinstance(data, bytes) else data.encode()
