"""Mesh files of ROS and Gazebo packages as triangles with materials.

Units and axes are those of Gazebo. The unit of a COLLADA file is applied, its up axis is not: the axes of the file are
the axes of the link (gazebo-classic: common/ColladaLoader.cc reads ``<unit meter>`` only, and
its issue 1305 asks for the axis; rviz: mesh_loader.cpp leaves out the root transform in which assimp hides the axis,
and reads the unit itself; gz-common: AssimpLoader.cc drops the root's rotation). A glTF file keeps its axes too
(gz-common adds no rotation), although the format calls y up and Drake would turn it. All other formats are in metres.
"""

import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image

from mirdrake.core.errors import MissingDependencyError, ModelError, did_you_mean
from mirdrake.core.extras import import_extra
from mirdrake.core.meshes import area_vectors, linear_to_srgb
from mirdrake.importing.changes import Change, Code

Array = NDArray[np.float64]

FORMATS = ("dae", "stl", "obj", "gltf", "glb", "ply")
INVISIBLE = 0.01
"""Opacity below which opacity and transparency of a material are assumed to be exchanged."""

_FAR = 1e9  # in the file's unit, beyond which a coordinate is taken for a broken number


class MeshError(ModelError):
    """A mesh cannot be used; the caller may reject the model or leave the shape out.

    Attributes:
        file: the mesh.
    """

    def __init__(self, file: Path | str, reason: str) -> None:
        super().__init__(reason, where=f"mesh {file}")
        self.file = str(file)

    def left_out(self, where: str, part: str) -> Change:
        """Return the change to report if the shape is left out."""
        return Change(Code.MESH, where, part, self.file, None, self.text)


class SubmeshError(MeshError):
    """A mesh has no submesh of the requested name."""


class Note(NamedTuple):
    """A change of a mesh, without its place."""

    old: str
    new: str | None
    reason: str


@dataclass(frozen=True)
class Material:
    """Appearance of a surface.

    Attributes:
        name: name in the file, or "".
        rgba: colour in sRGB and opacity, 0 .. 1; None if the file has none.
        picture: texture, mode RGB or RGBA; alpha counts only if it is RGBA.
        emission: emitted colour in sRGB.
    """

    name: str = ""
    rgba: tuple[float, float, float, float] | None = None
    picture: Image.Image | None = None
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Piece:
    """Triangles of one material, in metres along the axes of the file.

    Attributes:
        names: names that a submesh may be called by: of the nodes above it and of its geometry.
        corners: (n, 3, 3), counter-clockwise from outside.
        normals: normals at the corners (n, 3, 3).
        uv: texture coordinates at the corners (n, 3, 2), from the lower left of the picture.
        colors: colours at the corners (n, 3, 4) in sRGB.
        material: their common material.
    """

    names: tuple[str, ...]
    corners: Array
    normals: Array | None = None
    uv: Array | None = None
    colors: Array | None = None
    material: Material = Material()

    def taking(self, which: NDArray[Any]) -> "Piece":
        """Return the piece with the triangles of a mask or of indices only."""
        return self._with(lambda array: array[which])

    def reversed(self, which: NDArray[Any]) -> "Piece":
        """Return the piece with reversed winding of the triangles of a mask; normals are unchanged."""
        return self._with(lambda array: np.where(which[:, None, None], array[:, ::-1], array))

    def _with(self, change: Callable[[Array], Array]) -> "Piece":
        normals, uv, colors = (
            None if array is None else change(array) for array in (self.normals, self.uv, self.colors)
        )
        return replace(self, corners=change(self.corners), normals=normals, uv=uv, colors=colors)

    def moved(self, matrix: Array) -> "Piece":
        """Return the piece under an affine map (4, 4); a reflection reverses the winding to keep the outside."""
        linear = matrix[:3, :3]
        corners = self.corners @ linear.T + matrix[:3, 3]
        normals = self.normals
        mirrored = float(np.linalg.det(linear)) < 0.0
        if normals is not None:
            # Normals follow the cofactors, which point inwards after a reflection.
            normals = normals @ _cofactors(linear).T * (-1.0 if mirrored else 1.0)
        piece = replace(self, corners=corners, normals=normals)
        return piece._with(lambda array: array[:, ::-1]) if mirrored else piece


def _cofactors(linear: Array) -> Array:
    """Return det(A) A⁻ᵀ, which transforms area normals, also for singular A."""
    a, b, c = linear
    return np.array([np.cross(b, c), np.cross(c, a), np.cross(a, b)])


class ReadMesh(NamedTuple):
    """Contents of a mesh file."""

    pieces: tuple[Piece, ...]
    notes: tuple[Note, ...]


def read_mesh(path: Path) -> ReadMesh:
    """Return the triangles of a DAE, STL, OBJ, glTF, GLB or PLY file; the extension may be in upper case.

    Lines and points are passed over, as are triangles without area or with invalid coordinates.

    Raises:
        MeshError: the file is missing, unreadable or has no triangle.
        MissingDependencyError: pycollada is not installed.
    """
    try:
        state = path.stat()
    except OSError:
        raise MeshError(path, "does not exist") from None
    # Time and size of the file are parts of the key, so that an edited file is read again.
    return _read(path, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=4)
def _read(path: Path, _changed: int, _size: int) -> ReadMesh:
    kind = path.suffix.lower().lstrip(".")
    if not path.is_file():
        raise MeshError(path, "is not a file")
    data = path.read_bytes()
    # A clone without LFS has a small text file in place of each mesh, which readers would report as damaged.
    if data.startswith(b"version https://git-lfs"):
        raise MeshError(path, "is a Git LFS pointer, not the mesh; run `git lfs pull` in the package")
    if kind not in FORMATS:
        raise MeshError(path, f"has an unknown format (supported: .{', .'.join(FORMATS)})")
    if not data:
        raise MeshError(path, "is an empty file")
    # Readers raise errors of every kind for damaged files; the caller gets one kind with the name of the file.
    notes: list[Note] = []
    folder = TextureFolder(path.parent, notes)
    try:
        with warnings.catch_warnings():  # warnings of the readers do not concern the file
            warnings.simplefilter("ignore")
            pieces = list(_reader(kind)(data, folder))
    except (MeshError, MissingDependencyError):
        raise
    except Exception as error:  # the readers' own errors are of every kind
        reason = " ".join(str(error).split()) or type(error).__name__
        raise MeshError(path, f"cannot be read as {kind.upper()} ({reason})") from error
    # Triangles that cannot be drawn go first, since winding and doubles need areas and normals.
    pieces = _without_broken(pieces, notes)
    if not pieces:
        # Order matters: a winding turned by its normals can make two triangles equal, which are then doubles.
        raise MeshError(path, "has no triangle")
    pieces = _without_doubles(_wound_by_normals(pieces, notes), notes)
    return ReadMesh(tuple(pieces), tuple(dict.fromkeys(notes)))


def select_submesh(mesh: ReadMesh, path: Path, name: str) -> tuple[Piece, ...]:
    """Return the pieces of the node or geometry of a name; all pieces for "".

    Raises:
        MeshError: the name is unknown.
    """
    if not name:
        return mesh.pieces
    pieces = tuple(piece for piece in mesh.pieces if name in piece.names)
    if not pieces:
        names = [known for piece in mesh.pieces for known in piece.names]
        raise SubmeshError(path, f"has no submesh '{name}': {did_you_mean(name, names)}")
    return pieces


def _without_broken(pieces: Sequence[Piece], notes: list[Note]) -> list[Piece]:
    valid, broken, count = [], 0, 0
    for piece in pieces:
        # The comparison is false for NaN, too.
        finite = np.asarray((np.abs(piece.corners) < _FAR).all(axis=(1, 2)))  # False where a coordinate is not a number
        count += len(finite)
        broken += int((~finite).sum())
        corners = np.where(finite[:, None, None], piece.corners, 0.0)
        area = np.linalg.norm(area_vectors(corners), axis=1)
        good = finite & (area > 0.0)
        if good.any():
            valid.append(piece if good.all() else piece.taking(good))
    if broken:
        notes.append(Note(f"{count} triangles", f"{count - broken} triangles", "they have invalid coordinates"))
    return valid


def _wound_by_normals(pieces: Sequence[Piece], notes: list[Note]) -> list[Piece]:
    """Return the pieces with the winding of each triangle according to its vertex normals.

    A renderer takes the outside of a triangle from its winding and the light from its normals; where they disagree it
    draws black. The normals count. They have gone through the same transformations, and unlike the winding they are
    not reversed by a mirror, which some exporters account for and others do not.
    """
    result, turned, count = [], 0, 0
    for piece in pieces:
        count += len(piece.corners)
        if piece.normals is not None:
            # The sum of the normals at the corners: single ones may be wrong at sharp edges.
            stated = np.nan_to_num(_unit(piece.normals)).sum(axis=1)
            against = np.einsum("ij,ij->i", area_vectors(piece.corners), stated) < 0.0
            if against.any():
                turned += int(against.sum())
                piece = piece.reversed(against)
        result.append(piece)
    if turned:
        notes.append(
            Note(f"{turned} of {count} triangles wound against their normals", "reversed", "the normals count")
        )
    return result


def _without_doubles(pieces: Sequence[Piece], notes: list[Note]) -> list[Piece]:
    """Return the pieces without one of each two coincident, opposite triangles.

    Surfaces are drawn from both sides, so that one is enough; two flicker, and are not a solid. Of a pair in one
    submesh the one with a texture stays, else the one that faces away from the middle of the mesh.
    """
    if not pieces:
        return []
    corners = np.concatenate([piece.corners for piece in pieces])
    # Corners are compared on a grid of a millionth of the size, so that rounding in the file does not matter.
    low, extent = corners.min(axis=(0, 1)), float(np.ptp(corners.reshape(-1, 3), axis=0).max()) or 1.0
    grid = np.round((corners - low) / (1e-6 * extent)).astype(np.int64)
    # Sorted corners are equal for both windings.
    codes = np.sort((grid[..., 0] << 42) | (grid[..., 1] << 21) | grid[..., 2], axis=1)
    submeshes = {names: number for number, names in enumerate(dict.fromkeys(piece.names for piece in pieces))}
    owner = np.concatenate([np.full(len(piece.corners), submeshes[piece.names]) for piece in pieces])
    order = np.lexsort((np.arange(len(codes)), codes[:, 2], codes[:, 1], codes[:, 0], owner))
    same = (codes[order[1:]] == codes[order[:-1]]).all(axis=1) & (owner[order[1:]] == owner[order[:-1]])
    if not same.any():
        return list(pieces)
    # Of each pair, the textured triangle stays, else the one that faces outwards.
    face = area_vectors(corners)
    # Positive for a triangle that faces away from the middle of the mesh.
    rank = np.einsum("ij,ij->i", face, corners.mean(axis=1) - corners.mean(axis=(0, 1)))
    textured = np.concatenate([np.full(len(piece.corners), piece.material.picture is not None) for piece in pieces])
    rank = np.where(textured, np.inf, rank)
    dropped = np.zeros(len(corners), dtype=bool)
    for start, end in _runs(same):
        run = order[start : end + 1]
        along = face[run] @ face[run[0]] > 0.0
        for first, other in zip(run[along].tolist(), run[~along].tolist(), strict=False):
            dropped[other if rank[first] >= rank[other] else first] = True
    if dropped.any():
        why = "they would be drawn at the same place"
        notes.append(Note(f"{int(dropped.sum())} pairs of coincident opposite triangles", "one of each", why))
    masks = np.split(~dropped, np.cumsum([len(piece.corners) for piece in pieces])[:-1])
    return [piece.taking(keep) for piece, keep in zip(pieces, masks, strict=True) if keep.any()]


def _runs(same: NDArray[Any]) -> Iterator[tuple[int, int]]:
    """Yield first and last index of each run of true values."""
    edges = np.diff(np.concatenate(([0], same.astype(np.int8), [0])))
    yield from zip(np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist(), strict=True)


def _unit(vectors: Array) -> Array:
    """Return unit vectors; NaN for vectors of length zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    unit: Array = np.divide(vectors, length, out=np.full_like(vectors, np.nan), where=length > 1e-12)
    return unit


class TextureFolder(trimesh.resolvers.Resolver):  # type: ignore[misc, unused-ignore]
    """Finds textures and buffers beside a mesh, also with other case, slashes or folder than written."""

    def __init__(self, folder: Path, notes: list[Note]) -> None:
        self.folder, self.notes = folder, notes

    def find(self, address: str) -> Path | None:
        """Return the file of an address; None if there is none."""
        words = unquote(address.strip()).replace("\\", "/")
        words = words.split("://", 1)[-1] if "://" in words else words.removeprefix("file:")
        name = words.rsplit("/", 1)[-1]
        if not name:
            return None
        near = (".", "textures", "../textures", "../materials/textures", "../../materials/textures", "../images")
        for candidate in (words.lstrip("/"), words, *(f"{subfolder}/{name}" for subfolder in near)):
            path = _find_any_case(self.folder, candidate)
            if path is not None:
                return path
        return None

    def get(self, key: str) -> bytes:
        """Return the content of a file that a mesh refers to (for trimesh)."""
        path = self.find(key)
        if path is None:
            if Path(key).suffix.lower() in (".png", ".jpg", ".jpeg", ".tga", ".bmp", ".tif", ".tiff", ".gif", ".dds"):
                self.notes.append(_missing(key))
            raise ValueError(f"{key} is missing")
        return path.read_bytes()

    def write(self, name: str, data: bytes) -> None:
        """Raise an error: nothing is written beside the source (for trimesh)."""
        raise NotImplementedError

    def keys(self) -> list[str]:
        """Return the names of the files beside the mesh (for trimesh)."""
        return sorted(path.name for path in self.folder.iterdir() if path.is_file())

    def namespaced(self, namespace: str) -> "TextureFolder":
        """Return a resolver for a folder below (for trimesh)."""
        return TextureFolder(self.folder / namespace, self.notes)

    def picture(self, address: str, *, alpha: bool = False) -> Image.Image | None:
        """Return an opened texture, with opacity if `alpha`; None and a note if it cannot be read."""
        path = self.find(address)
        if path is None:
            self.notes.append(_missing(address))
            return None
        try:
            with Image.open(BytesIO(path.read_bytes())) as image:
                return _plain(image, alpha=alpha)
        except Exception as error:  # Pillow's errors are of every kind
            self.notes.append(Note(f"texture {address}", None, f"cannot be read: {error}"))
            return None


def _missing(address: str) -> Note:
    return Note(f"texture {address}", None, "the file is missing")


def _find_any_case(folder: Path, address: str) -> Path | None:
    # Packages made on file systems without case need a search for each part of the path.
    direct = folder / address
    if direct.is_file():
        return direct
    # Files from Windows refer to textures in another case than their names have.
    base = Path("/") if address.startswith("/") else folder
    for part in (part for part in address.split("/") if part not in ("", ".")):
        if part == "..":
            base = base.resolve().parent
            continue
        exact = base / part
        if not exact.exists():
            if not base.is_dir():
                return None
            same = sorted(entry for entry in base.iterdir() if entry.name.lower() == part.lower())
            if not same:
                return None
            exact = same[0]
        base = exact
    return base if base.is_file() else None


def _plain(image: Image.Image, *, alpha: bool = False) -> Image.Image:
    """Return a picture as RGB, or as RGBA if it uses an alpha channel that counts."""
    if alpha and ("A" in image.getbands() or "transparency" in image.info):
        full = image.convert("RGBA")
        if np.asarray(full)[:, :, 3].min() < 255:
            return full
    return image.convert("RGB")


def _reader(kind: str) -> Callable[[bytes, TextureFolder], Iterable[Piece]]:
    if kind == "dae":
        return _read_dae
    if kind == "obj":
        return _read_obj
    return lambda data, folder: _read_with_trimesh(data, kind, folder)


def _read_obj(data: bytes, folder: TextureFolder) -> Iterator[Piece]:
    from mirdrake.importing.meshes.obj import read_obj

    return read_obj(data, folder)


def _read_with_trimesh(data: bytes, kind: str, folder: TextureFolder) -> Iterator[Piece]:
    scene = trimesh.load_scene(BytesIO(data), file_type=kind, resolver=folder, process=False)
    if kind in ("gltf", "glb"):
        folder.notes.append(
            Note("glTF", "axes as in the file", "as in Gazebo and RViz, which do not rotate glTF from y up to z up")
        )
    for node in sorted(scene.graph.nodes_geometry):
        matrix, name = scene.graph[node]
        geometry = scene.geometry[name]
        # Lines and points of a glTF scene have no surface.
        if not isinstance(geometry, trimesh.Trimesh) or not len(geometry.faces):
            continue
        faces = np.asarray(geometry.faces)
        normals = None
        if "vertex_normals" in geometry._cache and kind != "stl":  # those of the file, none made up
            normals = np.asarray(geometry.vertex_normals)[faces]
        uv = colors = None
        material = Material()
        visual = geometry.visual
        # Vertex data become data of corners, since corners of one vertex may differ in other formats.
        if visual.kind == "texture":
            uv = None if visual.uv is None or len(visual.uv) < len(geometry.vertices) else np.asarray(visual.uv)[faces]
            material = _trimesh_material(visual.material)
        elif visual.kind == "vertex" and kind != "stl":
            colors = np.asarray(visual.vertex_colors, dtype=float)[faces] / 255.0
        elif visual.kind == "face" and kind != "stl":
            colors = np.repeat(np.asarray(visual.face_colors, dtype=float)[:, None] / 255.0, 3, axis=1)
        names = tuple(dict.fromkeys(str(word) for word in (node, name, geometry.metadata.get("name", "")) if word))
        # The transform of the node, with its scale, is applied here: the rest of the import knows no scene graph.
        piece = Piece(names, np.asarray(geometry.vertices, dtype=float)[faces], normals, uv, colors, material)
        yield piece.moved(np.asarray(matrix, dtype=float))


def _trimesh_material(given: Any) -> Material:
    name = str(getattr(given, "name", "") or "")
    if isinstance(given, trimesh.visual.material.PBRMaterial):
        factor = given.baseColorFactor
        rgba = np.ones(4) if factor is None else np.asarray(factor, dtype=float)
        rgba = rgba / 255.0 if np.asarray(factor).dtype == np.uint8 else rgba
        # glTF ignores the opacity of opaque materials.
        opaque = given.alphaMode in (None, "OPAQUE")
        picture = given.baseColorTexture
        picture = None if picture is None else _plain(picture, alpha=not opaque)
        glow = np.zeros(3) if given.emissiveFactor is None else np.asarray(given.emissiveFactor, dtype=float)[:3]
        color = (*linear_to_srgb(rgba[:3]).tolist(), 1.0 if opaque else float(rgba[3]))
        return Material(name, color, picture, tuple(linear_to_srgb(glow).tolist()))
    rgba = np.asarray(given.diffuse, dtype=float) / 255.0
    picture = getattr(given, "image", None)
    if picture is not None:
        return Material(name, (1.0, 1.0, 1.0, float(rgba[3])), _plain(picture, alpha=True))
    return Material(name, tuple(rgba.tolist()))


def _read_dae(data: bytes, folder: TextureFolder) -> Iterator[Piece]:
    collada = import_extra("collada", need="COLLADA meshes (.dae) need pycollada", extra="import")
    from mirdrake.importing.meshes.dae import read_collada

    document = collada.Collada(BytesIO(data), ignore=[collada.common.DaeError])
    return read_collada(document, folder)
