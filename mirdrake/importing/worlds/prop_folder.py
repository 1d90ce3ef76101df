"""Objects with several shapes or meshes as folders with a prop.yaml, a glTF visual and convex collision parts."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely
import trimesh
from pydrake.math import RigidTransform, RollPitchYaw
from trimesh import Trimesh

from mirdrake.core.errors import ModelError
from mirdrake.importing.changes import Changes, Code
from mirdrake.importing.meshes.convert import convert_collision, load_visual
from mirdrake.importing.meshes.convex import make_hull
from mirdrake.importing.meshes.read import (
    Material,
    MeshError,
    Note,
    Piece,
)
from mirdrake.importing.meshes.write import write_gltf, write_obj
from mirdrake.importing.shape import Shape
from mirdrake.importing.worlds.entry import degrees, number
from mirdrake.importing.worlds.model import Array, SourceObject
from mirdrake.worlds.props import DENSITY

MOST_SOLIDS = 200
"""Shapes of a prop.yaml."""


class EmptyPropError(Exception):
    """An object has no collision geometry left; the message states the reason."""


def write_prop(
    obj: SourceObject, folder: Path, *, changes: Changes
) -> tuple[RigidTransform, tuple[float, float, float]]:
    """Write an object as a prop.

    Args:
        obj: object with collision shapes, none of them a plane; those of kind convex are in the folder already.
        folder: folder of the prop; it is made.
        changes: get every change.

    Returns:
        pose X_MP of the prop's frame P in the model (on the ground below the middle of its box, to the millimetre), and
        its size along x, y, z [m].

    Raises:
        EmptyPropError: it has no usable collision geometry.
    """
    # Collision geometry: convex parts that exist already, and conversions of all other shapes.
    folder.mkdir(parents=True, exist_ok=True)
    solids: list[tuple[Shape, Array]] = []
    for index, shape in enumerate(obj.collisions):
        if shape.kind == "convex":
            solids.append((shape, _points(shape)))
            continue
        try:
            parts, more = convert_collision(shape, folder, name=f"solid_{index}")
        except MeshError as error:
            changes.append(error.left_out(shape.where, f"model '{obj.name}': collision"))
            obj.broken.append(ModelError(str(error), where=shape.where))
            continue
        for change in more:
            changes.append(change)
        solids += [(part, _points(part)) for part in parts]
    if not solids:
        raise EmptyPropError("none of its collision shapes can be read")
    # Every solid costs contact checks in each step; the largest ones give a prop its outline.
    if len(solids) > MOST_SOLIDS:
        solids.sort(key=lambda solid: -float(np.prod(np.ptp(solid[1], axis=0))))
        why = f"a prop has at most {MOST_SOLIDS} shapes"
        changed_part = f"model '{obj.name}': collisions"
        changes.add(Code.MESH, obj.where, changed_part, f"{len(solids)} shapes", f"the {MOST_SOLIDS} largest", why)
        solids = solids[:MOST_SOLIDS]
    # The frame of the prop is on the ground below the centre of its bounding box.
    cloud = np.concatenate([points for _, points in solids])
    low, high = cloud.min(axis=0), cloud.max(axis=0)
    # x and y need no more than a millimetre; z is exact, because the prop has to be on the ground.
    origin = np.array([*np.round(0.5 * (low + high)[:2], 3), low[2]])
    X_PM = RigidTransform(-origin)
    size = np.maximum(high - low, 1e-3)
    visual = write_visual(obj, X_PM, folder, changes)
    lines = [
        f"description: {_quoted(f'{obj.kind}, imported from Gazebo')}",
        f"size: [{', '.join(number(side) for side in size)}]",
        f"mass: {_mass(obj, cloud):.6g}",
    ]
    # Friction of 0 or above 2 is Gazebo's way of saying "none" or "never slips".
    if obj.mu is not None and 0.0 < obj.mu <= 2.0:
        lines.append(f"mu: {obj.mu:.4g}")
    if visual:
        lines.append("visual: visual.gltf")
    lines.append("solids:")
    lines += [f"  - {{{_solid_text(shape, points, X_PM, folder, i)}}}" for i, (shape, points) in enumerate(solids)]
    _tidy(folder)
    (folder / "prop.yaml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return X_PM.inverse(), (float(size[0]), float(size[1]), float(size[2]))


def _mass(obj: SourceObject, cloud: Array) -> float:
    if obj.mass is not None and 1e-6 < obj.mass < 1e9:
        return obj.mass
    return max(DENSITY * 0.3 * float(np.prod(np.maximum(np.ptp(cloud, axis=0), 1e-2))), 1e-3)


def _tidy(folder: Path) -> None:
    """Move mesh parts beside prop.yaml."""
    if (folder / "meshes").is_dir():
        for path in sorted((folder / "meshes").iterdir()):
            path.rename(folder / path.name)
        (folder / "meshes").rmdir()


def _solid_text(shape: Shape, points: Array, X_PM: RigidTransform, folder: Path, index: int) -> str:
    X_PS = X_PM @ shape.X_LG
    if shape.kind in {"box", "cylinder"}:
        parts = [f"{shape.kind}: [{', '.join(number(side) for side in shape.size)}]"]
    elif shape.kind == "sphere":
        parts = [f"sphere: {number(shape.size[0])}"]
    elif shape.mesh is not None:
        parts = [f"convex: {shape.mesh.name}"]
    else:  # capsules, ellipsoids and outlines
        # The hull is written in the frame G of its shape, whose pose follows as keys of the solid.
        hull = make_hull((points - shape.X_LG.translation()) @ shape.X_LG.rotation().matrix())
        write_obj(hull.points, hull.faces, folder / f"round_{index}.obj")
        parts = [f"convex: round_{index}.obj"]
    position = [number(value) for value in X_PS.translation()]
    if position != ["0", "0", "0"]:
        parts.append(f"at: [{', '.join(position)}]")
    angles = RollPitchYaw(X_PS.rotation()).vector()
    turned = zip(("yaw", "pitch", "roll"), (degrees(angles[i]) for i in (2, 1, 0)), strict=True)
    return ", ".join([*parts, *(f"{word}: {angle}" for word, angle in turned if angle != "0 deg")])


def _points(shape: Shape) -> Array:
    """Return points of a shape in M [m] with the same bounding box."""
    if shape.mesh is not None:
        points: Array = np.array(
            [line.split()[1:4] for line in shape.mesh.read_text().splitlines() if line.startswith("v ")], dtype=float
        )
    else:
        points = np.asarray(as_mesh(shape).vertices, dtype=float)
        # The triangles of a sphere are inside of it; its six poles make the bounding box exact.
        if shape.kind in {"sphere", "ellipsoid"}:
            half = np.array([shape.size[0]] * 3 if shape.kind == "sphere" else shape.size)
            points = np.concatenate((points, np.diag(half), -np.diag(half)))
    moved: Array = points @ shape.X_LG.rotation().matrix().T + shape.X_LG.translation()
    return moved


def as_mesh(shape: Shape) -> Trimesh:
    """Return a primitive or outline as triangles about its origin."""
    make = trimesh.creation
    if shape.kind == "polyline":
        return _pulled_up(shapely.from_wkt(shape.submesh), shape.size[0])
    if shape.kind == "plane":
        return _sheet(shape)
    if shape.kind == "box":
        return make.box(extents=shape.size)
    if shape.kind == "cylinder":
        return make.cylinder(radius=shape.size[0], height=shape.size[1], sections=32)
    if shape.kind == "capsule":
        mesh = make.capsule(radius=shape.size[0], height=shape.size[1], count=[16, 16])
        # trimesh does not centre a capsule at its origin.
        mesh.apply_translation(-0.5 * mesh.bounds.sum(axis=0))
        return mesh
    mesh = make.icosphere(subdivisions=3, radius=1.0)
    mesh.apply_scale([shape.size[0]] * 3 if shape.kind == "sphere" else list(shape.size))
    return mesh


def _sheet(shape: Shape) -> Trimesh:
    """Return a plane of finite size as two triangles; its normal is in `scale`.

    Raises:
        MeshError: it has no size.
    """
    if len(shape.size) != 2 or min(shape.size) <= 0.0:
        raise MeshError("plane", "has no size")
    normal = np.array(shape.scale) / np.linalg.norm(shape.scale)
    # The other axis must not be parallel to the normal.
    across = np.cross(normal, [1.0, 0.0, 0.0] if abs(normal[0]) < 0.9 else [0.0, 1.0, 0.0])
    v = across / np.linalg.norm(across)
    u = np.cross(v, normal)
    a, b = 0.5 * shape.size[0] * u, 0.5 * shape.size[1] * v
    return Trimesh(np.array([a + b, b - a, -a - b, a - b]), np.array([[0, 1, 2], [0, 2, 3]]), process=False)


def _pulled_up(area: shapely.Geometry, height: float) -> Trimesh:
    """Return polygons extruded from z = 0 to a height [m]."""
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(area))
    flat = np.array([shapely.orient_polygons(part).exterior.coords[:3] for part in triangles])
    low, high = (np.insert(flat, 2, z, axis=2) for z in (0.0, height))
    # The bottom face is reversed, so that its normal points down.
    faces = [low[:, ::-1], high]
    # Outlines run counter-clockwise and holes clockwise, so that all side faces point outwards.
    for ring in shapely.get_rings(shapely.orient_polygons(area)):
        start, end = np.array(ring.coords[:-1]), np.array(ring.coords[1:])
        a, b, c, d = (np.insert(row, 2, z, axis=1) for row, z in ((start, 0), (end, 0), (end, height), (start, height)))
        faces += [np.stack((a, b, c), axis=1), np.stack((a, c, d), axis=1)]
    corners = np.concatenate(faces)
    return Trimesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), process=False)


def convex_outlines(shape: Shape) -> list[Shape]:
    """Return a polyline shape as convex ones: its triangles, merged while they stay convex."""
    # Triangles would do, but each part costs time in every contact query: a greedy merge keeps the parts few.
    waiting: list[shapely.Geometry] = []
    for part in shapely.get_parts(shapely.from_wkt(shape.submesh)):
        waiting += [part] if _bulges(part) else list(shapely.get_parts(shapely.constrained_delaunay_triangles(part)))
    done: list[shapely.Geometry] = []
    while waiting:
        part = waiting.pop()
        while True:
            # A generator, so that the unions are computed only up to the first that fits.
            both = ((other, shapely.union(part, other)) for other in waiting if shapely.intersects(part, other))
            concave = next(((other, whole) for other, whole in both if _bulges(whole)), None)
            if concave is None:
                break
            waiting.remove(concave[0])
            part = concave[1]
        done.append(part)
    # Nine digits are a nanometre; the default of 6 would move corners apart that coincide.
    return [replace(shape, submesh=shapely.to_wkt(part, rounding_precision=9)) for part in done]


def _bulges(area: shapely.Geometry) -> bool:
    """Return whether an area is convex up to rounding."""
    size = float(shapely.area(area))
    whole = int(shapely.get_num_geometries(area)) == 1 and int(shapely.get_dimensions(area)) == 2
    return whole and float(shapely.area(shapely.convex_hull(area))) <= (1.0 + 1e-6) * size


# --- visuals --------------------------------------------------------------------------------------------------------


def write_visual(obj: SourceObject, X_PM: RigidTransform, folder: Path, changes: Changes) -> bool:
    """Write all visuals as one glTF file; return whether there are any."""
    pieces: list[Piece] = []
    notes: list[tuple[str, str, Note]] = []
    for shape in obj.visuals:
        part = f"model '{obj.name}': visual"
        # The infinite plane of a model with collision shapes is its ground, not a part of it.
        if shape.kind == "plane" and obj.collisions:
            continue
        try:
            parts, remarks = pieces_of(shape)
        except MeshError as error:
            changes.append(error.left_out(shape.where, part))
            continue
        notes += [(shape.where, f"{part} {shape.address}".strip(), note) for note in remarks]
        matrix = (X_PM @ shape.X_LG).GetAsMatrix4()
        pieces += [piece.moved(matrix) for piece in parts]
    if pieces:
        written = write_gltf(pieces, folder / "visual.gltf")
        notes += [(obj.where, f"model '{obj.name}': visuals", note) for note in written]
    # Copies of a shape give the same note, which is reported once.
    for where, part, note in dict.fromkeys(notes):
        changes.add(Code.MESH, where, part, note.old, note.new, note.reason)
    return bool(pieces)


def pieces_of(shape: Shape) -> tuple[list[Piece], list[Note]]:
    """Return the coloured triangles of a shape about its origin [m], and notes for the report.

    Raises:
        MeshError: the mesh cannot be read.
    """
    if shape.kind != "mesh" or shape.mesh is None:
        mesh = as_mesh(shape)
        corners = np.asarray(mesh.vertices, dtype=float)[np.asarray(mesh.faces)]
        return [Piece((), corners, material=Material("", shape.rgba))], []
    return load_visual(shape)


def _quoted(text: str) -> str:
    """Return a text as a YAML scalar of one line."""
    return "'" + re.sub(r"[\x00-\x1f]", " ", text).replace("'", "''")[:200] + "'"


def key_of(obj: SourceObject) -> tuple[Any, ...]:
    """Return a key that is equal for objects that are the same prop."""

    def part(shape: Shape) -> tuple[Any, ...]:
        # Copies whose poses differ by rounding share a prop; adding 0.0 turns -0.0 into 0.0.
        X = np.round(shape.X_LG.GetAsMatrix34(), 4) + 0.0
        return (shape.kind, shape.size, tuple(X.ravel().tolist()), shape.mesh, shape.scale, shape.submesh, shape.center,
                shape.rgba, shape.texture)  # fmt: skip

    return (*map(part, obj.visuals), "|", *map(part, obj.collisions), obj.mass, obj.mu)
