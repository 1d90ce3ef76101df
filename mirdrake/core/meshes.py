"""Triangle meshes to glTF 2.0: bodies of new vehicles, imported meshes and the scenery of worlds.

The same arrays give the same bytes, which trimesh does not promise: it merges vertices and orders buffers by itself.
Positions and normals are given with z up (ISO 8855) and stored with y up, as glTF demands; Drake turns them back.
"""

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mirdrake.core.json_io import Json

Array = NDArray[np.float64]

_FLOAT, _SHORT, _INT = 5126, 5123, 5125  # component types of glTF
_VERTICES, _INDICES = 34962, 34963  # targets of buffer views
_LINEAR, _MIPMAP, _REPEAT = 9729, 9987, 10497  # filters and wrapping of textures


@dataclass(frozen=True)
class Primitive:
    """Indexed triangles of one material.

    Attributes:
        positions: positions of the vertices (n, 3), z up [m].
        normals: unit normals of the vertices (n, 3).
        triangles: indices of vertices (m, 3), counter-clockwise seen from outside; stored as 16 bit if they are uint16.
        material: a material of glTF, see :func:`pbr_material`.
        uv: texture coordinates (n, 2), v downwards, or None.
        colors: linear red, green, blue and opacity of the vertices (n, 4), or None.
    """

    positions: NDArray[Any]
    normals: NDArray[Any]
    triangles: NDArray[Any]
    material: Mapping[str, Any]
    uv: NDArray[Any] | None = None
    colors: NDArray[Any] | None = None


def srgb_to_linear(srgb: Array) -> Array:
    """Return the linear light of sRGB values from 0 to 1 (IEC 61966-2-1); glTF gives its colours in linear light."""
    c = np.clip(srgb, 0.0, 1.0)
    result: Array = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    return result


def linear_to_srgb(linear: Array) -> Array:
    """Return sRGB values of linear light from 0 to 1 (IEC 61966-2-1)."""
    c = np.clip(linear, 0.0, 1.0)
    result: Array = np.where(c <= 0.0031308, 12.92 * c, 1.055 * c ** (1.0 / 2.4) - 0.055)
    return result


def area_vectors(triangles: Array) -> Array:
    """Return the outward normals of counter-clockwise triangles (n, 3, 3); their length is twice the area."""
    vectors: Array = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return vectors


def pbr_material(
    color: Sequence[float], *, roughness: float, metallic: float = 0.0, texture: int | None = None
) -> Json:
    """Return a material of glTF's metallic-roughness model.

    Args:
        color: linear red, green, blue and opacity; multiplies the texture.
        roughness: 0 is a mirror, 1 is matt.
        metallic: 0 is a dielectric, 1 is a metal.
        texture: index of the image.
    """
    pbr: Json = {"baseColorFactor": list(color), "metallicFactor": metallic, "roughnessFactor": roughness}
    if texture is not None:
        pbr["baseColorTexture"] = {"index": texture}
    return {"pbrMetallicRoughness": pbr}


def write_gltf(path: Path, primitives: Sequence[Primitive], *, generator: str = "mirdrake",
               images: Sequence[str] = ()) -> None:  # fmt: skip
    """Write a ``.gltf`` file and its buffer as a ``.bin`` file beside it; ``images`` are relative to its folder."""
    document, buffer = _build(primitives, images, generator, mipmaps=False)
    name = path.stem
    document["nodes"] = [{"name": name, "mesh": 0}]
    document["meshes"] = [{"name": name, **document["meshes"][0]}]
    document["buffers"] = [{"uri": f"{name}.bin", "byteLength": len(buffer)}]
    path.with_suffix(".bin").write_bytes(buffer)
    path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def gltf_text(primitives: Sequence[Primitive], *, images: Sequence[str] = ()) -> str:
    """Return a glTF text with an embedded buffer; images are named, not embedded."""
    document, buffer = _build(primitives, images, "mirdrake", mipmaps=True)
    uri = "data:application/octet-stream;base64," + base64.b64encode(buffer).decode()
    document["buffers"] = [{"uri": uri, "byteLength": len(buffer)}]
    return json.dumps(document)


def _build(
    primitives: Sequence[Primitive], images: Sequence[str], generator: str, *, mipmaps: bool
) -> tuple[Json, bytes]:
    """Return the glTF document, without the address of its buffer, and the buffer."""
    blob = bytearray()
    views: list[Json] = []
    accessors: list[Json] = []

    # One accessor per buffer view, without interleaving: the bytes follow from the arrays alone.
    def store(array: NDArray[Any], kind: str, component: int, target: int, *, bounds: bool = False) -> int:
        blob.extend(bytes(-len(blob) % 4))  # glTF aligns floats to four bytes
        raw = array.tobytes()
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(raw), "target": target})
        entry: Json = {"bufferView": len(views) - 1, "componentType": component, "count": len(array)}
        entry["type"] = kind
        # glTF requires the bounds of POSITION; viewers and Drake read the size of the mesh from them.
        if bounds:
            entry["min"], entry["max"] = array.min(axis=0).tolist(), array.max(axis=0).tolist()
        accessors.append(entry)
        blob.extend(raw)
        return len(accessors) - 1

    # Each primitive has its own material, all in one mesh.
    entries = []
    for number, part in enumerate(primitives):
        attributes = {
            "POSITION": store(_y_up(part.positions), "VEC3", _FLOAT, _VERTICES, bounds=True),
            "NORMAL": store(_y_up(part.normals), "VEC3", _FLOAT, _VERTICES),
        }
        if part.uv is not None:
            attributes["TEXCOORD_0"] = store(part.uv.astype("<f4"), "VEC2", _FLOAT, _VERTICES)
        if part.colors is not None:
            attributes["COLOR_0"] = store(part.colors.astype("<f4"), "VEC4", _FLOAT, _VERTICES)
        # 16 bits halve the indices; the caller decides, as it knows the number of vertices.
        short = part.triangles.dtype == np.uint16
        index = store(part.triangles.ravel().astype("<u2" if short else "<u4"), "SCALAR", _SHORT if short else _INT,
                      _INDICES)  # fmt: skip
        entries.append({"attributes": attributes, "indices": index, "material": number})
    document: Json = {
        "asset": {"version": "2.0", "generator": generator},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": entries}],
        "materials": [dict(part.material) for part in primitives],
        "accessors": accessors,
        "bufferViews": views,
        # Filled in by the callers, who store the buffer beside the document or inside it.
        "buffers": [],
    }
    if images:
        document["images"] = [{"uri": name} for name in images]
        # Mipmaps avoid flicker of distant textures in browsers.
        smaller = _MIPMAP if mipmaps else _LINEAR
        document["samplers"] = [
            {"magFilter": _LINEAR, "minFilter": smaller, "wrapS": _REPEAT, "wrapT": _REPEAT}
        ]  # fmt: skip
        document["textures"] = [{"sampler": 0, "source": number} for number in range(len(images))]
    return document, bytes(blob)


def _y_up(vectors: NDArray[Any]) -> NDArray[Any]:
    """Return vectors (x, y, z) with z up as (x, z, -y) with y up, without negative zeros."""
    # Adding +0.0 turns -0.0 into 0.0, so that equal shapes have equal bytes.
    return np.column_stack((vectors[:, 0], vectors[:, 2], -vectors[:, 1])).astype("<f4") + np.float32(0.0)
