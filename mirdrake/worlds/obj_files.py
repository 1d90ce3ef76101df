"""Meshes as OBJ files with their materials, for SDF export.

Drake converts a glTF mesh from y up to z up and Gazebo does not, but both read an OBJ file unchanged.
"""

import io
import json
import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image
from pydrake.geometry import Convex

from mirdrake.core.errors import WorldError, first_line
from mirdrake.core.json_io import Json
from mirdrake.worlds.lock import mesh_files, read_bytes
from mirdrake.worlds.scenery import texture_path

Array = NDArray[np.float64]
Color = tuple[float, float, float]

_UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # y up to z up


class _Part(NamedTuple):
    """Triangles of one material, z up."""

    material: str
    color: Color  # as shown on a screen, 0 .. 1
    points: Array
    normals: Array
    faces: NDArray[np.int64]
    uv: Array | None
    picture: bytes | None  # PNG


class ObjFiles:
    """The mesh files of one world.

    Attributes:
        files: content by path, for example ``meshes/cone/cone.obj``.
    """

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}
        self._known: dict[object, list[tuple[str, Color | None]]] = {}
        self._folders: dict[str, Path] = {}

    def add_mesh(self, kind: str, path: Path, paint: str | None) -> list[tuple[str, Color | None]]:
        """Add a visual mesh.

        Args:
            kind: name of the prop.
            path: glTF or OBJ.
            paint: material that gets the colour of the prop.

        Returns:
            paths of OBJ files with their colours; None where the file contains its own.

        Raises:
            WorldError: the mesh cannot be read.
        """
        if (path, paint) in self._known:
            return self._known[path, paint]
        folder = self._folder(kind, path)
        if path.suffix.lower() == ".obj":
            for file in mesh_files(path):
                self.files[f"{folder}/{file.name}"] = read_bytes(file)
            paths: list[tuple[str, Color | None]] = [(f"{folder}/{path.name}", None)]
        else:
            # The painted parts are a mesh of their own, because each prop has its own colour.
            parts = _load(path)
            paths = self._write(f"{folder}/{path.stem}", [part for part in parts if part.material != paint])
            painted = [part for part in parts if part.material == paint]
            if painted:
                self._write(f"{folder}/{path.stem}_paint", painted, colored=False)
                paths.append((f"{folder}/{path.stem}_paint.obj", painted[0].color))
        self._known[path, paint] = paths
        return paths

    def add_gltf(self, name: str, data: Mapping[str, Any]) -> list[tuple[str, Color | None]]:
        """Add a self-contained glTF document; returns as :meth:`add_mesh`."""
        return self._write(f"meshes/{name}", _parts(io.BytesIO(json.dumps(data).encode()), name))

    def add_hull(self, name: str, shape: Convex) -> str:
        """Add the convex hull of a mesh, unscaled; return the path of the OBJ file."""
        path = Path(shape.source().path())
        if ("hull", path) not in self._known:
            read_bytes(path)  # reports a missing file
            hull = Convex(str(path), np.ones(3)).GetConvexHull()
            kind, _, stem = name.partition("/")
            target = f"{self._folder(kind, path)}/{stem}.obj"
            # Nine digits: more than the single precision of renderers.
            lines = ["v " + " ".join(f"{x:.9g}" for x in hull.vertex(i)) for i in range(hull.num_vertices())]
            for i in range(hull.num_elements()):
                face = hull.element(i)
                lines.append("f " + " ".join(str(face.vertex(k) + 1) for k in range(face.num_vertices())))
            self.files[target] = ("\n".join(lines) + "\n").encode()
            self._known["hull", path] = [(target, None)]
        return self._known["hull", path][0][0]

    def _folder(self, kind: str, path: Path) -> str:
        """Return a folder for the meshes of a kind of prop; kinds of the same name have different folders."""
        plain = re.sub(r"\W+", "_", kind, flags=re.ASCII).strip("_") or "mesh"
        name, number = plain, 1
        while self._folders.setdefault(name, path.parent) != path.parent:
            number += 1
            name = f"{plain}_{number}"
        return f"meshes/{name}"

    def _write(self, stem: str, parts: Sequence[_Part], *, colored: bool = True) -> list[tuple[str, Color | None]]:
        """Write parts as one OBJ file with its materials."""
        if not parts:
            return []
        name = stem.rpartition("/")[2]
        lines, materials = ([f"mtllib {name}.mtl"] if colored else []), []
        # OBJ counts positions, normals and texture coordinates separately, from 1, over the whole file.
        base = np.ones(3, dtype=np.int64)
        for number, part in enumerate(parts):
            # Rounded and merged, which makes files small; adding zero turns -0 into 0.
            points, point_index = np.unique(np.round(part.points, 5) + 0.0, axis=0, return_inverse=True)
            normals, normal_index = np.unique(np.round(part.normals, 3) + 0.0, axis=0, return_inverse=True)
            lines += ["v " + " ".join(f"{x:.9g}" for x in point) for point in points.tolist()]
            lines += ["vn " + " ".join(f"{x:.9g}" for x in normal) for normal in normals.tolist()]
            textured = colored and part.picture is not None and part.uv is not None
            if textured:
                assert part.uv is not None
                lines += [f"vt {u:.6g} {v:.6g}" for u, v in part.uv.tolist()]
            if colored:
                lines.append(f"usemtl m{number}")
                materials += [f"newmtl m{number}", "Kd " + " ".join(f"{c:.4g}" for c in part.color), "Ks 0 0 0"]
            if textured:
                assert part.picture is not None
                # A picture replaces the colour, which would otherwise multiply it.
                materials[-2] = "Kd 1 1 1"
                materials.append(f"map_Kd {name}_{number}.png")
                self.files[f"{stem}_{number}.png"] = part.picture
            corner = part.faces.ravel()
            vertex, normal = point_index.ravel()[corner] + base[0], normal_index.ravel()[corner] + base[1]
            middle = [str(i) for i in (corner + base[2])] if textured else [""] * len(corner)
            texts = [f"{v}/{t}/{n}" for v, t, n in zip(vertex.tolist(), middle, normal.tolist(), strict=True)]
            lines += [f"f {texts[i]} {texts[i + 1]} {texts[i + 2]}" for i in range(0, len(texts), 3)]
            base += [len(points), len(normals), len(part.points) if textured else 0]
        self.files[f"{stem}.obj"] = ("\n".join(lines) + "\n").encode()
        if colored:
            self.files[f"{stem}.mtl"] = ("\n".join(materials) + "\n").encode()
        return [(f"{stem}.obj", None)]


def plain_color(data: Mapping[str, Any]) -> Json:
    """Return a glTF document of :mod:`mirdrake.worlds.scenery` with mean colours instead of textures.

    Textures of OBJ files are not repeated in Drake, so that tiled ones would be stretched.
    """
    document: Json = json.loads(json.dumps(data))
    images = [Path(image["uri"]).stem for image in document.pop("images", ())]
    for key in ("textures", "samplers"):
        document.pop(key, None)
    for material in document.get("materials", ()):
        shading = material["pbrMetallicRoughness"]
        texture = shading.pop("baseColorTexture", None)
        if texture is not None:
            # Pictures are in sRGB, factors of glTF are linear.
            shading["baseColorFactor"] = [*(c**2.2 for c in _mean_color(images[texture["index"]])), 1.0]
    return document


@lru_cache(maxsize=16)
def _mean_color(surface: str) -> Color:
    with Image.open(texture_path(surface)) as picture:
        red, green, blue = np.asarray(picture.convert("RGB"), dtype=float).mean(axis=(0, 1)) / 255.0
    return float(red), float(green), float(blue)


def _load(path: Path) -> list[_Part]:
    for file in mesh_files(path):
        read_bytes(file)  # reports a missing buffer or picture by its name
    return _parts(path, path.name)


def _parts(source: Path | io.BytesIO, name: str) -> list[_Part]:
    """Return the parts of a glTF mesh.

    Raises:
        WorldError: the file is not a mesh.
    """
    kind = source.suffix.lower().lstrip(".") if isinstance(source, Path) else "gltf"
    try:
        scene = trimesh.load(source, file_type=kind, force="scene", process=False)
        # dump() applies the transforms of the scene, which OBJ files do not have.
        meshes = [part for part in scene.dump() if isinstance(part, trimesh.Trimesh) and len(part.faces)]
    except Exception as error:  # readers of mesh files raise many types
        raise WorldError(f"is not a mesh that can be read: {first_line(error)}", where=name) from None
    parts = []
    for mesh in meshes:
        material, uv, picture = getattr(mesh.visual, "material", None), getattr(mesh.visual, "uv", None), None
        image = getattr(material, "baseColorTexture", None)
        # OBJ knows one picture for each material; opaque RGB is enough, because visuals have no transparency here.
        if image is not None and uv is not None:
            buffer = io.BytesIO()
            image.convert("RGB").save(buffer, "PNG")
            picture = buffer.getvalue()
        factor = getattr(material, "baseColorFactor", None)
        # glTF stores linear colours, OBJ display colours: gamma 2.2 approximates the sRGB curve.
        linear = np.array([0.5, 0.5, 0.5]) if factor is None else _linear(factor)
        red, green, blue = (float(c) for c in np.clip(linear, 0.0, 1.0) ** (1.0 / 2.2))
        parts.append(
            _Part(
                str(getattr(material, "name", "")), (red, green, blue), np.asarray(mesh.vertices) @ _UPRIGHT.T,
                np.asarray(mesh.vertex_normals) @ _UPRIGHT.T, np.asarray(mesh.faces, dtype=np.int64), uv, picture,
            )
        )  # fmt: skip
    return parts


def _linear(factor: Any) -> Array:
    """Return a colour factor of trimesh, bytes or fractions, as linear red, green, blue."""
    values = np.asarray(factor)
    return np.asarray(values[:3] / 255.0 if values.dtype == np.uint8 else values[:3], dtype=float)
