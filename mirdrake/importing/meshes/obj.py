"""Wavefront OBJ files as triangles: one piece for each object, set of groups and material.

The reader of trimesh divides concave polygons into fans, which cover their notches, and joins the names of object and
groups, by which SDF files choose parts of a mesh.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import shapely
from numpy.typing import NDArray
from PIL import Image

from mirdrake.importing.meshes.read import INVISIBLE, Array, Material, Note, Piece, TextureFolder

_OPTION_VALUES = {"-blendu": 1, "-blendv": 1, "-bm": 1, "-boost": 1, "-cc": 1, "-clamp": 1, "-imfchan": 1, "-mm": 2,
                  "-o": 3, "-s": 3, "-t": 3, "-texres": 1, "-type": 1}  # fmt: skip
_NUMERIC = {"-o", "-s", "-t"}  # the second and third value may be left out

Corner = tuple[int, int, int]
"""Index of position, texture coordinate and normal; -1 for none."""


@dataclass
class _Part:
    """Faces of one object, set of groups and material."""

    names: tuple[str, ...]
    material: str
    triangles: list[tuple[Corner, Corner, Corner]] = field(default_factory=list)


@dataclass
class _Content:
    """Contents of an OBJ file."""

    points: list[list[float]] = field(default_factory=list)
    uv: list[list[float]] = field(default_factory=list)
    normals: list[list[float]] = field(default_factory=list)
    parts: dict[tuple[str, tuple[str, ...], str], _Part] = field(default_factory=dict)
    polygons: dict[int, list[tuple[_Part, list[Corner]]]] = field(default_factory=dict)
    libraries: list[str] = field(default_factory=list)


def read_obj(data: bytes, folder: TextureFolder) -> Iterator[Piece]:
    """Yield the faces of an OBJ file as triangles.

    A piece has the names of its object and its groups, whichever material splits them. A new object ends the groups
    of the one before.

    Args:
        data: content of the file.
        folder: finds material files and textures, and takes the notes.
    """
    content = _read_lines(data.decode("utf-8-sig", errors="replace"))
    materials: dict[str, Material] = {}
    for library in dict.fromkeys(content.libraries):
        _read_library(library, folder, materials)
    # Positions may be followed by a colour, so rows have three or six values.
    points = _table(content.points, 6)
    uv, normals = _table(content.uv, 2), _table(content.normals, 3)
    for polygons in content.polygons.values():
        _triangulate(polygons, points[:, :3])
    for part in content.parts.values():
        if part.triangles:
            yield _piece(part, points, uv, normals, materials.get(part.material))


def _piece(part: _Part, points: Array, uv: Array, normals: Array, material: Material | None) -> Piece:
    index = np.array(part.triangles, dtype=np.int64)
    rows = _take(points, index[..., 0])
    colors = None
    if material is None and np.isfinite(rows[..., 3:]).any():  # positions may carry a colour
        rgb = np.nan_to_num(rows[..., 3:], nan=1.0)
        # Some programs write colours from 0 to 255.
        rgb = rgb / 255.0 if rgb.max() > 1.0 else rgb
        colors = np.concatenate((rgb, np.ones((*rgb.shape[:2], 1))), axis=2)
    return Piece(
        part.names,
        rows[..., :3],
        _take(normals, index[..., 2]) if (index[..., 2] >= 0).any() else None,
        np.nan_to_num(_take(uv, index[..., 1])) if (index[..., 1] >= 0).any() else None,
        colors,
        material or Material(part.material),
    )


def _take(table: Array, index: NDArray[np.int64]) -> Array:
    """Return rows of a table; NaN for rows that do not exist."""
    # A row of NaN at the end serves all indices that do not exist.
    padded = np.concatenate((table, np.full((1, table.shape[1]), np.nan)))
    rows: Array = padded[np.where((index >= 0) & (index < len(table)), index, len(table))]
    return rows


def _table(rows: list[list[float]], width: int) -> Array:
    """Return rows of different lengths as an array padded with NaN."""
    if rows and all(len(row) == len(rows[0]) for row in rows):
        known = np.array(rows, dtype=float)[:, :width]
        return np.pad(known, ((0, 0), (0, width - known.shape[1])), constant_values=np.nan)
    table = np.full((len(rows), width), np.nan)
    for number, row in enumerate(rows):
        table[number, : min(len(row), width)] = row[:width]
    return table


# --- lines -------------------------------------------------------------------------------------------------------


def _read_lines(text: str) -> _Content:
    content = _Content()
    vertex_lists = {"v": content.points, "vt": content.uv, "vn": content.normals}
    # An object, groups and a material stay active until the next line of their kind; faces belong to all three.
    target, material = "", ""
    groups: tuple[str, ...] = ()
    part: _Part | None = None
    # A backslash at its end continues a line.
    for line in text.replace("\\\r\n", " ").replace("\\\n", " ").splitlines():
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        key = words[0]
        # A comment may follow the numbers, but names of groups and materials may contain '#'.
        if "#" in line and (key == "f" or key in vertex_lists):
            words = line.partition("#")[0].split()
        if key in vertex_lists:
            vertex_lists[key].append(_floats(words[1:], colour=key == "v"))
        elif key in ("f", "fo"):
            if part is None:
                part = content.parts.setdefault((target, groups, material), _Part(_names(target, groups), material))
            corners = [_corner(word, content) for word in words[1:]]
            # Triangles are kept at once; larger polygons are collected by size and triangulated together, as arrays.
            if len(corners) == 3:
                part.triangles.append((corners[0], corners[1], corners[2]))
            elif len(corners) > 3:
                content.polygons.setdefault(len(corners), []).append((part, corners))
        elif key == "mtllib":
            content.libraries.append(_rest(line))
        elif key in ("o", "g", "usemtl"):
            part = None
            # The next face opens a part for the new combination of object, groups and material.
            if key == "o":
                target, groups = _rest(line), ()
            elif key == "g":
                # A group line lists several groups; the whole rest counts as well, for exporters whose names have
                # spaces.
                groups = tuple(dict.fromkeys((*words[1:], _rest(line)))) if len(words) > 1 else ()
            else:
                material = _rest(line)
    return content


def _names(target: str, groups: Sequence[str]) -> tuple[str, ...]:
    """Return the names by which a submesh can be selected: object, each group, all groups of the line."""
    return tuple(dict.fromkeys(name for name in (target, *groups) if name))


def _rest(line: str) -> str:
    """Return the line after its first word; names may contain spaces."""
    return " ".join(line.split()[1:])


def _floats(words: Sequence[str], *, colour: bool) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError:
        return []
    return values[:3] if colour and len(values) < 6 else values  # a fourth value of a position is a weight


def _corner(word: str, content: _Content) -> Corner:
    """Return the indices of ``position/texture/normal``; they count from 1, or backwards if negative."""
    parts = (*word.split("/"), "", "")[:3]
    counts = (len(content.points), len(content.uv), len(content.normals))
    values = []
    for text, count in zip(parts, counts, strict=True):
        try:
            value = int(text) if text else 0
        except ValueError:
            value = 0
        values.append(value - 1 if value > 0 else count + value if value < 0 else -1)
    return values[0], values[1], values[2]


# --- polygons ----------------------------------------------------------------------------------------------------


def _triangulate(polygons: list[tuple[_Part, list[Corner]]], points: Array) -> None:
    """Add polygons of the same number of corners to their parts: as a fan if convex, else as triangles inside."""
    # Polygons of one size are checked together: a negative turn along the normal means a concave corner.
    index = np.array([[corner[0] for corner in corners] for _, corners in polygons])
    positions = _take(points, index)
    # Coordinates from the first corner keep digits far from the origin.
    positions = positions - positions[:, :1]
    edges = np.roll(positions, -1, axis=1) - positions
    turns = np.cross(np.roll(edges, 1, axis=1), edges)
    # Newell's normal, also for polygons that are not quite flat.
    normals = 0.5 * np.cross(positions, np.roll(positions, -1, axis=1)).sum(axis=1)
    along = np.einsum("nkj,nj->nk", turns, normals)
    hollow = along.min(axis=1) < -1e-6 * np.einsum("nj,nj->n", normals, normals)
    for number, (part, corners) in enumerate(polygons):
        inside = _triangles_inside(positions[number], normals[number]) if hollow[number] else []
        fan = [(0, k, k + 1) for k in range(1, len(corners) - 1)]
        part.triangles += [(corners[a], corners[b], corners[c]) for a, b, c in inside or fan]


def _triangles_inside(place: Array, normal: Array) -> list[tuple[int, int, int]]:
    """Return the triangles of a concave polygon by their corners; none if it intersects itself."""
    # Project onto the plane of the polygon; its normal is the Newell normal.
    along = place[np.argmax(np.linalg.norm(place, axis=1))]
    x = along - normal * float(along @ normal) / float(normal @ normal)
    flat = np.column_stack((place @ x, place @ np.cross(normal, x) / np.linalg.norm(normal)))
    outline = shapely.Polygon(flat)
    if not outline.is_valid:
        return []
    triangles = []
    for triangle in shapely.get_parts(shapely.constrained_delaunay_triangles(outline)):
        ring = shapely.get_coordinates(shapely.orient_polygons(triangle))[:3]
        # The triangulation returns coordinates; the nearest corner gives the index.
        a, b, c = (int(np.argmin(np.linalg.norm(flat - point, axis=1))) for point in ring)
        triangles.append((a, b, c))
    return triangles


# --- materials ---------------------------------------------------------------------------------------------------


def _read_library(given: str, folder: TextureFolder, materials: dict[str, Material]) -> None:
    """Add the materials of a line ``mtllib``: one file whose name has spaces, or several files."""
    # One file whose name has spaces, if it exists; otherwise several names.
    files = [given] if folder.find(given) is not None else given.split()
    for name in files:
        path = folder.find(name)
        if path is None:
            folder.notes.append(Note(f"material file {name}", None, "the file is missing"))
            continue
        entries: list[tuple[str, dict[str, list[str]]]] = []
        for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
            words = line.split()
            if len(words) > 1 and words[0].lower() == "newmtl":
                entries.append((_rest(line), {}))
            elif len(words) > 1 and entries and not words[0].startswith("#"):
                entries[-1][1][words[0].lower()] = words[1:]
        for material, values in entries:
            materials.setdefault(material, _material(material, values, folder))


def _material(name: str, values: dict[str, list[str]], folder: TextureFolder) -> Material:
    opacity = _number(values.get("d"), lambda value: value)
    if opacity is None:
        opacity = _number(values.get("tr"), lambda value: 1.0 - value)
    if opacity is not None and opacity < INVISIBLE:
        why = "some exporters write opacity and transparency the wrong way round"
        folder.notes.append(Note(f"material {name} invisible", "opaque", why))
        opacity = 1.0
    alpha = min(1.0 if opacity is None else opacity, 1.0)
    glow = _color(values.get("ke")) or (0.0, 0.0, 0.0)
    picture = _texture(values, folder)
    if picture is not None:
        # A texture replaces the diffuse colour, by which others would multiply it.
        return Material(name, (1.0, 1.0, 1.0, alpha), picture, glow)
    return Material(name, (*(_color(values.get("kd")) or (0.7, 0.7, 0.7)), alpha), None, glow)


def _texture(values: dict[str, list[str]], folder: TextureFolder) -> Image.Image | None:
    """Return the picture of ``map_Kd`` with the opacity of ``map_d``, which may be the same file.

    Without ``map_d`` an alpha channel is not opacity: programs keep gloss or paint masks in it.
    """
    address, mask_address = (_texture_address(values.get(key, [])) for key in ("map_kd", "map_d"))
    picture = folder.picture(address, alpha=mask_address == address) if address else None
    mask = (
        folder.picture(mask_address, alpha=True) if picture is not None and mask_address not in ("", address) else None
    )
    if picture is not None and mask is not None:
        opacity = mask.getchannel("A") if mask.mode == "RGBA" else mask.convert("L")
        picture.putalpha(opacity.resize(picture.size))
    return picture


def _number(words: list[str] | None, change: Callable[[float], float]) -> float | None:
    values = _floats((words or [])[-1:], colour=False)  # behind an option such as -halo
    return change(values[0]) if values and np.isfinite(values[0]) else None


def _color(words: list[str] | None) -> tuple[float, float, float] | None:
    values = _floats(words or [], colour=False)
    if not values or not np.isfinite(values).all():
        return None
    r, g, b = np.resize(np.clip(values, 0.0, 1.0), 3).tolist()
    return r, g, b


def _texture_address(words: list[str]) -> str:
    """Return the file name of a texture line without its options; it may contain spaces."""
    start = 0
    while start < len(words) and words[start] in _OPTION_VALUES:
        option = words[start]
        end = start + 1 + _OPTION_VALUES[option]
        if option in _NUMERIC:
            end = next(
                (k for k in range(start + 2, min(end, len(words))) if not _floats([words[k]], colour=False)), end
            )
        start = end
    return " ".join(words[start:])
