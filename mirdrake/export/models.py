"""Visual shapes of a run as entities of a foxglove.SceneUpdate: the world, its props and the links of vehicles.

The shapes are those that Meshcat draws. A glTF mesh is written as GLB with its buffers and pictures; meshes of other
formats and convex hulls become triangles.
"""

import json
import struct
from base64 import b64decode
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import unquote_to_bytes

import numpy as np
import trimesh
from pydrake.common import MemoryFile
from pydrake.geometry import Box, Capsule, Convex, Cylinder, Ellipsoid, Mesh, Rgba, Role, Shape, Sphere
from pydrake.math import RigidTransform

from mirdrake.export.frames import WORLD, Frames, actor_frame, link_name, pose_of
from mirdrake.plant.actors import GREY
from mirdrake.plant.obstacles import looks
from mirdrake.worlds import Actor

_MEDIA = "model/gltf-binary"
_GREY = Rgba(0.7, 0.7, 0.7, 1.0)  # of a shape without a colour


Fields = Mapping[str, Any]
"""Fields of a primitive of SceneEntity; poses as :data:`mirdrake.export.frames.Pose`, colours as RGBA."""

Primitive = tuple[str, Fields]
"""Name of a list of SceneEntity, and the fields of an element of it."""


def scene_entities(frames: Frames) -> Iterator[tuple[str, str, list[Primitive]]]:
    """Yield the id of each entity, its frame and its primitives."""
    parts = frames.parts
    plant, inspector = parts.plant, parts.scene_graph.model_inspector()
    # Vehicles and movable props have frames of their own, all else is fixed to the world.
    names = {part.base.index(): name for name, part in parts.vehicles.items()}
    names |= {body.index(): f"props.{name}" for name, body in parts.props.bodies.items()}
    vehicles = {part.instance: name for name, part in parts.vehicles.items()}
    entities: dict[tuple[str, str], list[Primitive]] = {}
    for geometry in inspector.GetAllGeometryIds(Role.kIllustration):
        body = plant.GetBodyFromFrameId(inspector.GetFrameId(geometry))
        if body.index() == plant.world_body().index():
            # An entity for each prop and each part of the scenery, so that a panel can hide one of them.
            label = inspector.GetName(geometry).rpartition("::")[2].rpartition("/")[0]
            key = (label or WORLD, WORLD)
        else:
            frame = names.get(body.index()) or link_name(vehicles.get(body.model_instance(), ""), body)
            key = (frame, frame)
        properties = inspector.GetIllustrationProperties(geometry)
        # The colour is in the properties of Drake, not in the shape.
        rgba = properties.GetPropertyOrDefault("phong", "diffuse", _GREY)
        X_FG = inspector.GetPoseInFrame(geometry)
        color = (rgba.r(), rgba.g(), rgba.b(), rgba.a())
        entities.setdefault(key, []).extend(_primitives(inspector.GetShape(geometry), X_FG, color))
    for (name, frame), primitives in sorted(entities.items(), key=lambda item: item[0]):
        yield name, frame, primitives


def actor_entities(actors: Iterable[Actor]) -> Iterator[tuple[str, str, list[Primitive]]]:
    """Yield the id of the entity of each actor, its frame and its primitives."""
    for actor in actors:
        frame, color = actor_frame(actor.name), (*(actor.color or GREY), 1.0)
        shapes = looks(actor.placed(0.0, 0.0, 0.0))
        primitives = [one for shape, X_PG in shapes for one in _primitives(shape, actor.prop_pose @ X_PG, color)]
        yield frame, frame, primitives


def _primitives(shape: Shape, X_FG: RigidTransform, color: tuple[float, ...]) -> Iterator[Primitive]:
    """Yield the primitives of a shape; none for an unbounded shape."""
    common: Fields = {"pose": pose_of(X_FG), "color": color}
    # Foxglove's scene has cubes, spheres, cylinders and triangles; other shapes are composed of them.
    if isinstance(shape, Box):
        yield "cubes", {**common, "size": shape.size().tolist()}
    elif isinstance(shape, Sphere):
        yield "spheres", {**common, "size": [2.0 * shape.radius()] * 3}
    elif isinstance(shape, Ellipsoid):
        yield "spheres", {**common, "size": [2.0 * shape.a(), 2.0 * shape.b(), 2.0 * shape.c()]}
    elif isinstance(shape, Cylinder | Capsule):
        width = 2.0 * shape.radius()
        size = [width, width, shape.length()]
        yield "cylinders", {**common, "size": size, "bottom_scale": 1.0, "top_scale": 1.0}
        if isinstance(shape, Capsule):
            for z in (-0.5 * shape.length(), 0.5 * shape.length()):
                end = pose_of(X_FG @ RigidTransform([0.0, 0.0, z]))
                yield "spheres", {"pose": end, "color": color, "size": [width] * 3}
    elif isinstance(shape, Convex):
        # The faces of Drake's hull are polygons; a panel draws triangles.
        hull = shape.GetConvexHull()
        corners = np.array([hull.vertex(index) for index in range(hull.num_vertices())])
        mesh = trimesh.convex.convex_hull(corners)
        yield "triangles", {**common, "points": mesh.vertices, "indices": mesh.faces.ravel()}
    elif isinstance(shape, Mesh):
        yield from _mesh(shape, common)


def _mesh(shape: Mesh, common: Fields) -> Iterator[Primitive]:
    source, scale = shape.source(), shape.scale3()
    model = {**common, "scale": scale.tolist(), "media_type": _MEDIA}
    # Viewers get one file per mesh: a glTF is packed with its buffers and textures, as they cannot read beside the log.
    if shape.extension() == ".gltf" and source.is_path():
        yield "models", {**model, "data": pack_gltf(source.path().read_bytes(), source.path().parent, {})}
    elif shape.extension() == ".gltf":
        memory = source.in_memory()
        yield "models", {**model, "data": pack_gltf(memory.mesh_file.contents(), Path(), memory.supporting_files)}
    elif shape.extension() == ".glb":
        yield "models", {**model, "data": source.path().read_bytes()}
    elif source.is_path():
        # Other formats are sent as triangles, which every viewer can draw.
        mesh = trimesh.load(source.path(), force="mesh", process=False)
        yield "triangles", {**common, "points": np.asarray(mesh.vertices) * scale, "indices": mesh.faces.ravel()}


def pack_gltf(text: bytes, folder: Path, supporting: Mapping[str, Path | MemoryFile]) -> bytes:
    """Return a glTF file with all its buffers and pictures as one GLB.

    Args:
        text: contents of the .gltf file.
        folder: folder of its other files.
        supporting: files elsewhere or in memory, by their names in the .gltf file.
    """

    # Buffers and pictures may be embedded, in memory or beside the file.
    def read(uri: str) -> bytes:
        if uri.startswith("data:"):
            head, _, body = uri.partition(",")
            return b64decode(body) if head.endswith(";base64") else unquote_to_bytes(body)
        source = supporting.get(uri, folder / uri)
        return bytes(source.contents()) if isinstance(source, MemoryFile) else Path(source).read_bytes()

    data = json.loads(text)
    views = data.setdefault("bufferViews", [])
    # A GLB has one buffer, in which each part starts at a multiple of four bytes, as glTF 2.0 demands.
    binary, starts = bytearray(), []
    for buffer in data.get("buffers", []):
        starts.append(len(binary))
        binary += _padded(read(buffer["uri"]), b"\0")
    for view in views:
        view["byteOffset"] = view.get("byteOffset", 0) + starts[view["buffer"]]
        view["buffer"] = 0
    for image in data.get("images", []):
        if "uri" in image:
            uri = image.pop("uri")
            content = read(uri)
            views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(content)})
            image["bufferView"] = len(views) - 1
            image["mimeType"] = "image/png" if content[:4] == b"\x89PNG" else "image/jpeg"
            binary += _padded(content, b"\0")
    data["buffers"] = [{"byteLength": len(binary)}]
    # Two chunks of a multiple of four bytes: JSON padded with blanks, binary data with zeros (glTF 2.0).
    head = _padded(json.dumps(data, separators=(",", ":")).encode(), b" ")
    chunks = struct.pack("<I4s", len(head), b"JSON") + head + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _padded(content: bytes, filler: bytes) -> bytes:
    return content + filler * (-len(content) % 4)
