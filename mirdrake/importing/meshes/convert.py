"""Meshes of a package in formats of Drake: visuals as glTF, collisions as boxes, cylinders and convex OBJ parts.

Drake's cameras render .obj and .gltf; its collision geometry is the convex hull of an .obj, .vtk or .gltf file. The
extra ``import`` has the packages for COLLADA (pycollada), convex decomposition (coacd) and simplification
(fast-simplification). :mod:`mirdrake.importing.meshes.read` defines units and axes.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mirdrake.importing.changes import Change, Code
from mirdrake.importing.meshes.convex import CutTime, Hull, Parts, fit_box, fit_cylinder, split_convex
from mirdrake.importing.meshes.read import (
    Material,
    MeshError,
    Note,
    Piece,
    SubmeshError,
    TextureFolder,
    read_mesh,
    select_submesh,
)
from mirdrake.importing.meshes.write import write_gltf, write_obj
from mirdrake.importing.shape import Shape

Array = NDArray[np.float64]

WHOLE = "the whole mesh"
"""Replacement of a submesh that does not exist, in reports."""

__all__ = [
    "WHOLE",
    "MeshError",
    "convert_collision",
    "convert_visual",
    "load_mesh",
    "load_visual",
    "mesh_bounds",
    "with_known_submesh",
]

_MOST_EXCESS = 100.0  # hull over mesh; beyond it the mesh is a sheet, and the ratio is rounding


def mesh_bounds(shape: Shape) -> tuple[Array, Array]:
    """Return the corners [m] of the bounding box of a shape along the axes of its link.

    Args:
        shape: a primitive, or a mesh in any format; its unit, nodes, submesh, scale and pose are applied.

    Returns:
        lower and upper corner (3,); of a plane infinite.

    Raises:
        MeshError: the mesh is missing, unreadable or empty.
        MissingDependencyError: pycollada is not installed.
    """
    if shape.kind == "mesh":
        pieces, _ = load_mesh(shape)
        points = np.concatenate([piece.corners.reshape(-1, 3) for piece in pieces])
        points = points @ shape.X_LG.rotation().matrix().T + shape.X_LG.translation()
        return points.min(axis=0), points.max(axis=0)
    half = _half_extent(shape)
    middle = shape.X_LG.translation()
    return middle - half, middle + half


def with_known_submesh(shape: Shape) -> tuple[Shape, list[Change]]:
    """Return a shape whose submesh exists: the whole mesh instead of an unknown submesh, and the change.

    A body that is drawn with more than its submesh is noticed; one that is not drawn is lost.
    """
    if shape.kind != "mesh" or shape.mesh is None or not shape.submesh:
        return shape, []
    try:
        read = read_mesh(shape.mesh)
    except MeshError:  # reported where the mesh is converted
        return shape, []
    # An unknown submesh is not a reason to draw nothing: the whole mesh shows what the vehicle looks like, if with too
    # many parts.
    try:
        select_submesh(read, shape.mesh, shape.submesh)
    except SubmeshError as error:
        part = f"mesh {shape.address or shape.mesh}"
        change = Change(Code.SUBMESH, shape.where, part, f"submesh '{shape.submesh}'", WHOLE, error.text)
        return replace(shape, submesh=""), [change]
    return shape, []


def _half_extent(shape: Shape) -> Array:
    R = shape.X_LG.rotation().matrix()
    if shape.kind == "box":
        # Half the extents of a rotated box: |R| times half its edges.
        box: Array = np.abs(R) @ (0.5 * np.array(shape.size))
        return box
    if shape.kind == "sphere":
        return np.full(3, shape.size[0])
    if shape.kind == "ellipsoid":
        # An ellipsoid reaches the length of the row of R times its half axes.
        ellipsoid: Array = np.linalg.norm(R * np.array(shape.size), axis=1)
        return ellipsoid
    if shape.kind in ("cylinder", "capsule"):
        radius, length = shape.size[:2]
        z = R[:, 2]
        # The discs at the ends reach r sqrt(1 - z_i²) along axis i.
        round_part = radius * np.ones(3) if shape.kind == "capsule" else radius * np.sqrt(np.maximum(0.0, 1.0 - z**2))
        result: Array = 0.5 * length * np.abs(z) + round_part
        return result
    return np.full(3, np.inf)


def convert_visual(shape: Shape, folder: Path, *, name: str) -> tuple[Shape, list[Change]]:
    """Write a visual mesh as glTF; a primitive stays as it is.

    As in RViz, colours and textures of the file take precedence over the colour of the shape, and a texture of the
    shape over both. Meshes without colour are grey. Meshes of more than 500 000 triangles are simplified.

    Args:
        shape: visual shape of a link.
        folder: the vehicle's.
        name: name of the file, without extension; must be new.

    Returns:
        the shape with the address ``meshes/<name>.gltf`` without scale and colour (both are in the file), and what was
        changed.

    Raises:
        MeshError: the mesh is missing, unreadable or empty; `MeshError.left_out` gives the line for the report if the
            caller leaves the shape out instead.
        MissingDependencyError: pycollada is not installed.
    """
    if shape.kind != "mesh":
        return shape, []
    pieces, notes = load_visual(shape)
    target = folder / "meshes" / f"{name}.gltf"
    target.parent.mkdir(parents=True, exist_ok=True)
    notes += write_gltf(pieces, target)
    written = replace(
        shape, mesh=target, address=f"meshes/{name}.gltf", scale=(1.0, 1.0, 1.0), submesh="", rgba=None, texture=None
    )
    return written, _changes(shape, "visual", notes)


def convert_collision(
    shape: Shape, folder: Path, *, name: str, time: CutTime | None = None
) -> tuple[list[Shape], list[Change]]:
    """Return a collision mesh as a box, a cylinder or at most 16 convex parts; primitives are unchanged.

    A mesh that fills a box to 97 % or a cylinder to 93 % becomes that one. A mesh that is convex becomes one part
    with at most 128 corners. Anything else is decomposed into convex parts; the volume that they add is reported
    in the change.

    Args:
        shape: collision shape of a link.
        folder: the vehicle's; parts go to ``meshes/<name>.obj`` or ``meshes/<name>_<number>.obj``.
        name: name of the files, without extension; must be new.
        time: time for cutting, shared by several meshes; when it is used up, they become their convex hulls.

    Returns:
        shapes that together replace the given one, and the changes.

    Raises:
        MeshError: the mesh is missing, unreadable or empty.
        MissingDependencyError: pycollada is not installed.
    """
    if shape.kind != "mesh":
        return [shape], []
    # For point contact Drake takes the convex hull of a mesh, which would fill every hollow.
    pieces, notes = load_mesh(shape)
    # Notes on textures and materials do not concern collision geometry.
    notes = [note for note in notes if not note.old.startswith(("texture", "material"))]
    parts = split_convex(np.concatenate([piece.corners for piece in pieces]), time)
    # Contact with a primitive is cheaper and smoother than with a hull of many faces.
    if len(parts.hulls) == 1 and not parts.missing:
        primitive = _as_primitive(shape, parts.hulls[0], notes)
        if primitive is not None:
            return [primitive], _changes(shape, "collision", notes)
    notes.append(_parts_note(shape, parts))
    (folder / "meshes").mkdir(parents=True, exist_ok=True)
    shapes = []
    for number, hull in enumerate(parts.hulls):
        # Hulls are written in metres in the frame of the mesh, so that scale and submesh of the source are used up.
        file = f"{name}.obj" if len(parts.hulls) == 1 else f"{name}_{number}.obj"
        write_obj(hull.points, hull.faces, folder / "meshes" / file)
        shapes.append(
            replace(
                shape, mesh=folder / "meshes" / file, address=f"meshes/{file}", scale=(1.0, 1.0, 1.0), submesh="",
                rgba=None, texture=None
            )
        )  # fmt: skip
    return shapes, _changes(shape, "collision", notes)


def _as_primitive(shape: Shape, hull: Hull, notes: list[Note]) -> Shape | None:
    # A mesh that fills a box or a cylinder becomes one: contact with a primitive is exact, faster and free of edges.
    box, cylinder = fit_box(hull), fit_cylinder(hull)
    size: tuple[float, ...]
    if box is not None:
        kind, (size, X_GF) = "box", box
        volume = size[0] * size[1] * size[2]
        words = f"box {size[0]:.4g} x {size[1]:.4g} x {size[2]:.4g} m"
    elif cylinder is not None:
        kind, (size, X_GF) = "cylinder", cylinder
        volume = np.pi * size[0] ** 2 * size[1]
        words = f"cylinder of radius {size[0]:.4g} m, length {size[1]:.4g} m"
    else:
        return None
    # The filled share shows the user how much volume the primitive adds.
    notes.append(Note(f"mesh {shape.address}", words, f"it fills {min(100.0, 100 * hull.volume / volume):.0f} % of it"))
    return Shape(kind, tuple(size), shape.X_LG.multiply(X_GF), where=shape.where)


def _parts_note(shape: Shape, parts: Parts) -> Note:
    total = sum(hull.volume for hull in parts.hulls)
    became = "its convex hull" if len(parts.hulls) == 1 else f"{len(parts.hulls)} convex parts"
    share = total / (parts.volume or parts.whole.volume)
    if parts.volume and share > _MOST_EXCESS:
        excess = "the mesh itself has next to no volume"
    elif parts.volume:
        excess = f"{round(100 * (share - 1.0)):+d} % volume"
    else:
        excess = f"{100 * share:.0f} % of the volume of its hull; it is not closed"
    return Note(f"mesh {shape.address}", f"{became} ({excess})", parts.missing or "Drake collides meshes by their hull")


def load_mesh(shape: Shape) -> tuple[list[Piece], list[Note]]:
    """Return the triangles of a mesh in the frame of the shape, with submesh and scale applied."""
    if shape.mesh is None:
        raise MeshError(shape.address or "without address", "leads to no file")
    read = read_mesh(shape.mesh)
    notes = list(read.notes)
    pieces: Sequence[Piece] = select_submesh(read, shape.mesh, shape.submesh)
    scale = np.array(shape.scale, dtype=float)
    if not np.isfinite(scale).all() or (scale == 0.0).any():
        raise MeshError(shape.mesh, f"scale {' '.join(f'{factor:g}' for factor in shape.scale)} leaves nothing of it")
    matrix = np.diag([*scale, 1.0])
    if shape.submesh and shape.center:
        points = np.concatenate([piece.corners.reshape(-1, 3) for piece in pieces])
        # SDF's <center>: the middle of the submesh becomes its origin, before the scale.
        matrix[:3, 3] = -scale * 0.5 * (points.min(axis=0) + points.max(axis=0))
    if np.prod(scale) < 0.0:
        words = " ".join(f"{factor:g}" for factor in shape.scale)
        notes.append(
            Note(f"scale {words}", "mirrored, outside kept outside", "a negative factor turns a mesh inside out")
        )
    return [piece.moved(matrix) for piece in pieces], notes


def load_visual(shape: Shape) -> tuple[list[Piece], list[Note]]:
    """Return the triangles of a visual mesh as :func:`load_mesh`, with the texture and colour of the shape.

    A texture of the shape replaces all materials of the file; its colour is that of triangles without one.
    """
    pieces, notes = load_mesh(shape)
    if shape.texture is not None:
        picture = TextureFolder(shape.texture.parent, notes).picture(shape.texture.name)
        if picture is not None:
            pieces = [replace(p, material=Material(p.material.name, (1.0, 1.0, 1.0, 1.0), picture)) for p in pieces]
    # The colour of the link counts only where the mesh has none of its own.
    if shape.rgba is not None:
        pieces = [
            replace(p, material=replace(p.material, rgba=shape.rgba))
            if p.material.rgba is None and p.material.picture is None and p.colors is None
            else p
            for p in pieces
        ]
    return pieces, notes


def _changes(shape: Shape, role: str, notes: Sequence[Note]) -> list[Change]:
    part = f"{role} mesh {shape.address or shape.mesh}"
    return [Change(Code.MESH, shape.where, part, note.old, note.new, note.reason) for note in dict.fromkeys(notes)]
