"""Check of glTF files: VTK, which reads them for cameras, may crash on inconsistent ones."""

import base64
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from mirdrake.core.errors import ModelError

_SCALARS = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
_CONSTANTS: Mapping[str, Mapping[str, tuple[int | str, ...]]] = {
    "bufferViews": {"target": (34962, 34963)},
    "samplers": {
        "magFilter": (9728, 9729),
        "minFilter": (9728, 9729, 9984, 9985, 9986, 9987),
        "wrapS": (33071, 33648, 10497),
        "wrapT": (33071, 33648, 10497),
    },
    "materials": {"alphaMode": ("OPAQUE", "MASK", "BLEND")},
}
"""Allowed values of enumerated keys, from the JSON Schemas of glTF 2.0."""

_MODES = tuple(range(7))  # of a primitive, points to a triangle fan
_STRIDES = (4, 252)  # of a bufferView [byte]
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}


def check_gltf(path: Path, at: str) -> None:
    """Check that a glTF file is consistent with its buffers: VTK, which reads it for cameras, may crash otherwise."""
    try:
        text = path.read_text(encoding="utf-8")
        content = json.loads(
            # Python reads NaN, Infinity and numbers beyond the range of a float; VTK does not.
            text,
            parse_float=_finite,
            parse_int=lambda word: int(_finite(word)),
            parse_constant=_finite,
        )
        # The text of a glTF file states which files it needs; VTK crashes if one is missing.
        addresses = [entry.get("uri", "") for key in ("buffers", "images") for entry in content.get(key, [])]
        missing = [
            address
            for address in addresses
            if address and not address.startswith("data:") and not _beside(path, address).is_file()
        ]
    except (ValueError, AttributeError, TypeError, OSError, RecursionError) as error:
        raise ModelError(f"not a glTF file: {_plain(error)}", where=at) from None
    if missing:
        raise ModelError(f"it needs '{missing[0]}'; no such file: {_beside(path, missing[0])}", where=at)
    # Values of a wrong type raise errors of every kind below, which all mean a broken file.
    try:
        _check_constants(content)
        _check_appearance(content)
        _check_nodes(content)
        _check_data(content, path)
    except KeyError as error:
        raise ModelError(f"broken glTF file: {error} is missing", where=at) from None
    except (ValueError, AttributeError, TypeError, OSError, IndexError) as error:
        raise ModelError(f"broken glTF file: {_plain(error)}", where=at) from None


def _finite(text: str) -> float:
    """Return a number of a JSON file; Python accepts more than VTK."""
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text[:40]} is not a finite number")
    return value


def _beside(path: Path, address: str) -> Path:
    return path.parent / unquote(address)


def _plain(error: Exception) -> str:
    return " ".join(str(error).split())[:200]


def _entry(content: Mapping[str, Any], kind: str, number: Any) -> Any:
    """Return an entry of one of the lists of a glTF file, by number."""
    entries = content.get(kind, [])
    if type(number) is not int or not 0 <= number < len(entries):
        raise ValueError(f"{kind}[{str(number)[:40]}] does not exist")
    return entries[number]


def _check_constants(content: Mapping[str, Any]) -> None:
    """Check the version, and the keys that have one of a few values."""
    if not isinstance(content["asset"]["version"], str):
        raise ValueError("asset.version is not a string")
    # The glTF specification lists the allowed numbers, which readers take without a check of their own.
    for kind, keys in _CONSTANTS.items():
        for index, entry in enumerate(content.get(kind, [])):
            for key, allowed in keys.items():
                # A bool is an int in Python and would pass as 0 or 1.
                if key in entry and (isinstance(entry[key], bool) or entry[key] not in allowed):
                    words = ", ".join(map(str, allowed))
                    raise ValueError(f"{kind}[{index}].{key} is {str(entry[key])[:40]}, not one of {words}")


def _check_appearance(content: Mapping[str, Any]) -> None:
    """Check that textures and materials refer to existing entries, as VTK trusts in."""
    for texture in content.get("textures", []):
        for key, kind in (("source", "images"), ("sampler", "samplers")):
            if key in texture:
                _entry(content, kind, texture[key])
    for material in content.get("materials", []):
        for part in (material, material.get("pbrMetallicRoughness", {})):
            for key in [key for key in part if key.endswith("Texture")]:
                _entry(content, "textures", part[key]["index"])


def _check_nodes(content: Mapping[str, Any]) -> None:
    """Check that nodes and scenes refer to existing entries and form trees, and that the scene shows a mesh."""
    # Readers that follow a cycle would not end.
    parents = set()
    for node in content.get("nodes", []):
        if "mesh" in node:
            _entry(content, "meshes", node["mesh"])
        for child in node.get("children", []):
            _entry(content, "nodes", child)
            if child in parents:
                raise ValueError(f"nodes[{child}] is a child of two others")
            parents.add(child)
        for key, count in (("matrix", 16), ("translation", 3), ("rotation", 4), ("scale", 3)):
            numbers = np.array(node.get(key, [0] * count), dtype=float)
            if numbers.shape != (count,) or not np.isfinite(numbers).all():
                raise ValueError(f"{key} of a node should be {count} numbers")
    for scene in content["scenes"]:
        for index in scene.get("nodes", []):
            _entry(content, "nodes", index)
            if index in parents:
                raise ValueError(f"nodes[{index}] is in a scene and below another node")
    # Walk the default scene: a file whose scene has no mesh would be an invisible shape.
    waiting = list(_entry(content, "scenes", content.get("scene", 0)).get("nodes", []))
    shown = False
    while waiting:
        node = content["nodes"][waiting.pop()]
        shown = shown or "mesh" in node
        waiting += node.get("children", [])
    if not shown:
        raise ValueError("its scene shows no mesh")


def _check_data(content: Mapping[str, Any], path: Path) -> None:
    """Check the length of buffers, the ranges of views and accessors, and the numbers of points and triangles.

    Raises:
        ValueError, KeyError, TypeError, AttributeError or OSError: something is wrong.
    """
    # A reader that trusts the stated lengths reads beyond the end of a short buffer.
    buffers = []
    for index, buffer in enumerate(content.get("buffers", [])):
        uri = buffer["uri"]
        data = base64.b64decode(uri.partition(",")[2]) if uri.startswith("data:") else _beside(path, uri).read_bytes()
        if not 0 < buffer["byteLength"] <= len(data):
            name = f"buffers[{index}]" if uri.startswith("data:") else f"'{uri}'"
            raise ValueError(f"{name} has {len(data)} bytes and should have {buffer['byteLength']}")
        buffers.append(data[: buffer["byteLength"]])
    # A view is a range of a buffer.
    for index, view in enumerate(content.get("bufferViews", [])):
        _entry(content, "buffers", view["buffer"])
        begin, length = view.get("byteOffset", 0), view["byteLength"]
        # Without a stride the elements are packed; the smallest one stands for it here.
        stride = view.get("byteStride", _STRIDES[0])
        if type(stride) is not int or stride % 4 or not _STRIDES[0] <= stride <= _STRIDES[1]:
            raise ValueError(f"bufferViews[{index}].byteStride is {str(stride)[:40]}, not a multiple of 4 up to 252")
        if begin < 0 or length <= 0 or begin + length > len(buffers[view["buffer"]]):
            raise ValueError(f"bufferViews[{index}] does not lie in its buffer")

    def values(index: Any) -> np.ndarray:
        accessor = _entry(content, "accessors", index)
        kind, width, count = _SCALARS[accessor["componentType"]], _WIDTHS[accessor["type"]], accessor["count"]
        if any(len(accessor[key]) != width for key in ("min", "max") if key in accessor):
            raise ValueError(f"min and max of accessors[{index}] should be {width} numbers")
        view = _entry(content, "bufferViews", accessor["bufferView"])
        begin, size = accessor.get("byteOffset", 0), width * np.dtype(kind).itemsize
        stride = view.get("byteStride", size)
        # The last element must end within the view, which is within its buffer: so the strided view below is safe.
        if begin < 0 or count < 1 or stride < size or begin + stride * (count - 1) + size > view["byteLength"]:
            raise ValueError(f"accessors[{index}] does not lie in its bufferView")
        data = np.frombuffer(buffers[view["buffer"]], np.uint8, offset=view.get("byteOffset", 0) + begin)
        rows = np.lib.stride_tricks.as_strided(data, (count, size), (stride, 1))
        return np.ascontiguousarray(rows).view(kind)

    # Unused accessors count as well, since a reader may load them.
    for index in range(len(content.get("accessors", []))):
        values(index)
    for index, mesh in enumerate(content["meshes"]):
        for primitive in mesh["primitives"]:
            if primitive.get("mode", 4) not in _MODES:
                raise ValueError(f"meshes[{index}] has primitives of the unknown mode {str(primitive['mode'])[:40]}")
            points = values(primitive["attributes"]["POSITION"])
            if points.shape[1] != 3 or points.dtype != np.float32 or not (np.abs(points) < 1e6).all():
                raise ValueError(f"meshes[{index}] has points that are not three finite numbers")
            # All attributes of a primitive have one row for each point.
            for name, attribute in primitive["attributes"].items():
                if len(values(attribute)) != len(points):
                    raise ValueError(f"meshes[{index}] has {len(points)} points, but another count of {name}")
            if "indices" in primitive:
                corners = values(primitive["indices"])
                if corners.shape[1] != 1 or corners.dtype.kind != "u" or corners.max() >= len(points):
                    raise ValueError(f"meshes[{index}] has triangles whose corners are not among its points")
            if "material" in primitive:
                _entry(content, "materials", primitive["material"])
