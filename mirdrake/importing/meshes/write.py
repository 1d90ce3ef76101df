"""Triangles as glTF with separate pictures, and convex parts as OBJ; the same triangles give the same bytes."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from mirdrake.core import meshes
from mirdrake.core.meshes import Primitive, area_vectors, pbr_material, srgb_to_linear
from mirdrake.importing.meshes.read import Array, Material, Note, Piece

GREY = (0.7, 0.7, 0.7, 1.0)
"""Colour of a surface that has none, in sRGB."""

FACE_LIMIT = 500_000
"""Triangles of a visual; above it is simplified."""

PICTURE_LIMIT = 4096
"""Pixels along the longer edge of a texture; above it is made smaller."""

_CREASE = np.cos(np.deg2rad(40.0))
_ROUGHNESS = 0.6


def write_gltf(pieces: Sequence[Piece], path: Path) -> list[Note]:
    """Write ``<name>.gltf``, ``<name>.bin`` and a PNG for every texture.

    Core glTF 2.0 only: what Drake's VTK renderer and Meshcat both show. z up becomes y up, which Drake turns back.
    Surfaces show from both sides.

    Args:
        pieces: pieces in metres, z up.
        path: path of the .gltf; its folder exists.

    Returns:
        what was changed.
    """
    pieces, notes = _within_limit(pieces)
    images: list[str] = []
    pictures: dict[int, int] = {}

    def texture(picture: Image.Image) -> int:
        # Materials that share a picture share its file.
        if id(picture) not in pictures:
            if max(picture.size) > PICTURE_LIMIT:
                size = f"{picture.width} x {picture.height} pixels"
                # A copy, since the picture may be shared with other meshes.
                small = picture.copy()
                small.thumbnail((PICTURE_LIMIT, PICTURE_LIMIT))
                notes.append(Note(f"texture of {size}", f"{small.width} x {small.height} pixels", "too large to draw"))
            else:
                small = picture
            name = f"{path.stem}_{len(images)}.png"
            small.save(path.with_name(name), format="PNG", compress_level=6)
            pictures[id(picture)] = len(images)
            images.append(name)
        return pictures[id(picture)]

    # One primitive per material, since glTF draws each with one material.
    primitives = []
    for piece in _by_material(pieces):
        points, normals, uv, colors, index = _indexed(piece)
        # A picture without texture coordinates cannot be drawn; with them it replaces the colours of vertices.
        look, picture = piece.material, piece.material.picture if uv is not None else None
        material = _material(look, None if picture is None else texture(picture), tinted=colors is not None)
        primitives.append(
            Primitive(
                points, normals, index, material,
                uv=None if picture is None else uv, colors=colors if picture is None else None
            )
        )  # fmt: skip
    meshes.write_gltf(path, primitives, images=images)
    return notes


def write_obj(points: Array, faces: NDArray[np.int64], path: Path) -> None:
    """Write a convex part [m], to the micrometre."""
    # Adding 0.0 turns -0.0 into 0.0; indices of OBJ count from 1.
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in (points + 0.0).tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _material(look: Material, picture: int | None, *, tinted: bool) -> dict[str, object]:
    rgba = look.rgba or (GREY if picture is None and not tinted else (1.0, 1.0, 1.0, 1.0))
    # Colours of the sources are sRGB, factors of glTF are linear.
    color = (*_rounded(srgb_to_linear(np.array(rgba[:3]))), round(rgba[3], 5))
    entry = {
        "name": look.name,
        **pbr_material(color, roughness=_ROUGHNESS, texture=picture),
        "doubleSided": True,
    }
    if any(look.emission):
        entry["emissiveFactor"] = _rounded(srgb_to_linear(np.array(look.emission)))
    if rgba[3] < 1.0:
        entry["alphaMode"] = "BLEND"
    elif picture is not None and look.picture is not None and look.picture.mode == "RGBA":
        entry["alphaMode"] = "MASK"
    return entry


def _rounded(values: Array) -> list[float]:
    return [round(float(value), 5) for value in values]


def _by_material(pieces: Sequence[Piece]) -> list[Piece]:
    """Return one piece per material and set of arrays, in the order of their first appearance."""
    groups: dict[tuple[Any, ...], list[Piece]] = {}
    for piece in pieces:
        look = piece.material
        # Normals before merging, so that edges between pieces stay sharp.
        normals = corner_normals(piece)
        uv = piece.uv if look.picture is not None else None
        key = (look.name, look.rgba, id(look.picture), look.emission, uv is None, piece.colors is None)
        groups.setdefault(key, []).append(replace(piece, normals=normals, uv=uv))
    merged = []
    for members in groups.values():
        corners = np.concatenate([member.corners for member in members])
        all_normals, all_uv, colors = (
            _joined([getattr(member, key) for member in members]) for key in ("normals", "uv", "colors")
        )
        merged.append(replace(members[0], corners=corners, normals=all_normals, uv=all_uv, colors=colors))
    return merged


def _joined(arrays: Sequence[Array | None]) -> Array | None:
    """Return the arrays of all pieces as one; None if they have none."""
    known = [array for array in arrays if array is not None]
    return np.concatenate(known) if known else None


def _indexed(piece: Piece) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any] | None, NDArray[Any] | None, NDArray[Any]]:
    """Return vertices without repetition as glTF wants them, and the index of each corner."""
    assert piece.normals is not None
    # Rows are compared as bytes: equal position, normal, texture coordinate and colour are one vertex.
    columns = [piece.corners.reshape(-1, 3), piece.normals.reshape(-1, 3)]
    if piece.uv is not None:
        uv = np.nan_to_num(piece.uv.reshape(-1, 2))
        # Texture coordinates begin at the bottom in the sources, at the top in glTF.
        columns.append(np.column_stack((uv[:, 0], 1.0 - uv[:, 1])))
    if piece.colors is not None:
        colors = np.clip(piece.colors.reshape(-1, 4), 0.0, 1.0)
        columns.append(np.column_stack((srgb_to_linear(colors[:, :3]), colors[:, 3])))
    # Adding 0.0 turns -0.0 into 0.0, whose bytes differ.
    rows = np.ascontiguousarray(np.concatenate(columns, axis=1).astype("<f4") + np.float32(0.0))
    keys = rows.view(np.dtype((np.void, rows.dtype.itemsize * rows.shape[1]))).ravel()
    _, first, index = np.unique(keys, return_index=True, return_inverse=True)
    vertices = rows[first]
    column = 6
    vertex_uv = vertex_colors = None
    if piece.uv is not None:
        vertex_uv, column = np.ascontiguousarray(vertices[:, column : column + 2]), column + 2
    if piece.colors is not None:
        vertex_colors = np.ascontiguousarray(vertices[:, column : column + 4])
    points, normals = (np.ascontiguousarray(vertices[:, start : start + 3]) for start in (0, 3))
    return points, normals, vertex_uv, vertex_colors, index.ravel().astype("<u4")


def corner_normals(piece: Piece) -> Array:
    """Return unit normals at the corners (n, 3, 3): those of the file, else smoothed up to edges of 40°."""
    corners = piece.corners
    face = area_vectors(corners)
    unit = face / np.linalg.norm(face, axis=1)[:, None]
    if piece.normals is not None:
        length = np.linalg.norm(piece.normals, axis=2, keepdims=True)
        good = np.isfinite(length) & (length > 1e-12)
        if good.all():
            given: Array = piece.normals / length
            return given
    # Sharp edges keep the face normal; other corners get the area-weighted mean of their faces.
    _, vertex = weld(corners.reshape(-1, 3))
    total = np.zeros((vertex.max() + 1, 3))
    for axis in range(3):
        total[:, axis] = np.bincount(vertex, weights=np.repeat(face[:, axis], 3), minlength=len(total))
    length = np.linalg.norm(total, axis=1, keepdims=True)
    mean = np.divide(total, length, out=np.zeros_like(total), where=length > 0.0)
    aside = np.einsum("ij,ij->i", mean[vertex], np.repeat(unit, 3, axis=0)) < _CREASE
    edged = np.bincount(vertex, weights=aside, minlength=len(total)) > 0.0
    smooth = np.where(edged[vertex][:, None], np.repeat(unit, 3, axis=0), mean[vertex])
    result: Array = smooth.reshape(-1, 3, 3)
    return result


def weld(points: Array) -> tuple[Array, NDArray[np.int64]]:
    """Return distinct points (to 1e-6 of their extent) and the index of each given point."""
    extent = float(np.ptp(points, axis=0).max()) or 1.0
    grid = np.round((points - points.min(axis=0)) / (1e-6 * extent)).astype(np.int64)
    # Three numbers of 21 bits in one key: the grid has 1e6 steps, less than 2^21.
    keys = (grid[:, 0] << 42) | (grid[:, 1] << 21) | grid[:, 2]
    _, first, index = np.unique(keys, return_index=True, return_inverse=True)
    return points[first], index.ravel().astype(np.int64)


def _within_limit(pieces: Sequence[Piece]) -> tuple[list[Piece], list[Note]]:
    count = sum(len(piece.corners) for piece in pieces)
    if count <= FACE_LIMIT:
        return list(pieces), []
    try:
        import fast_simplification  # noqa: F401 - an extra
    except ImportError:
        why = "more than can be drawn fluently; fast-simplification, which could reduce them, is not installed"
        return list(pieces), [Note(f"{count} triangles", f"{count} triangles", why)]
    reduced = [simplify(piece, keep=FACE_LIMIT / count) for piece in pieces]
    left = sum(len(piece.corners) for piece in reduced)
    return reduced, [Note(f"{count} triangles", f"{left} triangles", f"at most {FACE_LIMIT} are drawn fluently")]


def simplify(piece: Piece, *, keep: float) -> Piece:
    """Return a piece reduced to about a share of its triangles; textures are those of the nearest vertex."""
    import fast_simplification
    from scipy.spatial import cKDTree

    if len(piece.corners) < 100:
        return piece
    points, index = weld(piece.corners.reshape(-1, 3))
    fewer, faces = fast_simplification.simplify(points, index.reshape(-1, 3), target_reduction=1.0 - keep)
    corners = np.asarray(fewer, dtype=float)[np.asarray(faces)]
    area = np.linalg.norm(area_vectors(corners), axis=1)
    corners = corners[area > 0.0]
    if not len(corners):
        return piece
    old = piece.corners.mean(axis=1)
    _, nearest = cKDTree(old).query(corners.mean(axis=1))
    # Texture and colours are those of the nearest corner of the nearest old triangle.
    apart = np.linalg.norm(corners[:, :, None] - piece.corners[nearest][:, None], axis=-1)
    uv, colors = (
        None if values is None else np.take_along_axis(values[nearest], apart.argmin(axis=2)[:, :, None], axis=1)
        for values in (piece.uv, piece.colors)
    )
    return replace(piece, corners=corners, normals=None, uv=uv, colors=colors)
