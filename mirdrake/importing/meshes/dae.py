"""COLLADA files as triangles, read as by Gazebo; needs pycollada."""

from collections.abc import Iterator, Mapping
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from collada import Collada
from collada.material import Map
from collada.polylist import Polylist
from collada.scene import ControllerNode, GeometryNode, Node, RotateTransform
from collada.triangleset import TriangleSet

from mirdrake.importing.meshes.read import INVISIBLE, Array, Material, Note, Piece, TextureFolder

_LUMINANCE = np.array([0.212671, 0.715160, 0.072169])  # ITU-R BT.709-4, as COLLADA 1.4.1 specifies for RGB_ZERO


def read_collada(document: Collada, folder: TextureFolder) -> Iterator[Piece]:
    """Yield all triangles of the scene; its unit is applied, its up axis is not (see :mod:`.read`).

    Args:
        document: document of pycollada, without its faulty parts.
        folder: finds the textures and takes the notes.
    """
    root = document.xmlnode.getroot()
    scale = _unit(root)
    if scale != 1.0:
        folder.notes.append(Note(f"unit of {scale:g} m", "metres", "unit of the file"))
    axis = next((e.text or "" for e in root.iter() if _tag(e) == "up_axis"), "").strip()
    if axis and axis != "Z_UP":
        folder.notes.append(
            Note(
                f"up axis {axis}",
                "axes as in the file",
                "as in Gazebo and RViz, which ignore the up axis of COLLADA files",
            )
        )
    # Files without a scene, which some exporters write, have geometries only.
    reader = _Reader(folder)
    matrix = np.diag([scale, scale, scale, 1.0])
    if document.scene is not None and document.scene.nodes:
        for node in document.scene.nodes:
            yield from reader.walk(node, matrix, ())
        return
    for geometry in document.geometries:
        yield from reader.geometry(geometry, {}, matrix, ())


def _matrix(node: Node) -> Array:
    """Return the transformation of a node; unlike in pycollada, rotation axes may have any length."""
    matrix = np.eye(4)
    for step in node.transforms:
        local = np.asarray(step.matrix, dtype=float)
        if isinstance(step, RotateTransform):
            length = float(np.linalg.norm((step.x, step.y, step.z)))
            if length > 0.0:
                axis = (step.x / length, step.y / length, step.z / length)
                local = np.asarray(RotateTransform(*axis, step.angle).matrix, dtype=float)
        matrix = matrix @ local
    return matrix


def _tag(element: Element) -> str:
    return str(element.tag).rsplit("}", 1)[-1]


def _unit(root: Element) -> float:
    for asset in (child for child in root if _tag(child) == "asset"):
        for unit in (child for child in asset if _tag(child) == "unit"):
            try:
                # Some programs write a decimal comma.
                value = float(str(unit.get("meter", "1")).replace(",", "."))
            except ValueError:
                return 1.0
            return value if value > 0.0 and np.isfinite(value) else 1.0
    return 1.0


class _Reader:
    """Walks through the nodes of a scene."""

    def __init__(self, folder: TextureFolder) -> None:
        self.folder = folder
        self.materials: dict[str, Material] = {}

    def walk(self, node: Any, matrix: Array, names: tuple[str, ...]) -> Iterator[Piece]:
        if isinstance(node, GeometryNode):
            yield from self.geometry(node.geometry, self._bound(node.materials), matrix, names)
        elif isinstance(node, ControllerNode):  # a skin in its rest pose
            skin = node.controller
            bind = np.asarray(getattr(skin, "bind_shape_matrix", np.eye(4)), dtype=float).reshape(4, 4)
            if getattr(skin, "geometry", None) is not None:
                yield from self.geometry(skin.geometry, self._bound(node.materials), matrix @ bind, names)
        elif isinstance(node, Node):  # an instance of another node too
            inner = getattr(node, "node", None) or node
            # Names of all nodes above a geometry can select it as a submesh.
            node_names = tuple(str(word) for word in (inner.xmlnode.get("name"), inner.id) if word)
            for child in node.children:
                yield from self.walk(child, matrix @ _matrix(inner), names + node_names)

    def _bound(self, bindings: Any) -> Mapping[str, Any]:
        return {binding.symbol: binding.target for binding in bindings}

    def geometry(
        self, geometry: Any, bound: Mapping[str, Any], matrix: Array, names: tuple[str, ...]
    ) -> Iterator[Piece]:
        geometry_names = tuple(str(word) for word in (geometry.name, geometry.id) if word)
        for given in geometry.primitives:
            triangles = given.triangleset() if isinstance(given, Polylist) else given  # Polygons is a Polylist
            if not isinstance(triangles, TriangleSet) or triangles.vertex is None or not len(triangles.index):
                continue
            uv = colors = normals = None
            if triangles.normal is not None and len(triangles.normal):
                normals = np.asarray(triangles.normal, dtype=float)[triangles.normal_index]
            if triangles.texcoordset:
                uv = np.asarray(triangles.texcoordset[0], dtype=float)[triangles.texcoord_indexset[0]][..., :2]
            if triangles.sources.get("COLOR"):
                # An input of pycollada is (offset, semantic, source, set, data).
                offset, source = triangles.sources["COLOR"][0][0], triangles.sources["COLOR"][0][4]
                colors = np.asarray(source.data, dtype=float)[triangles.index[:, :, offset]]
                if colors.shape[-1] == 3:
                    colors = np.concatenate((colors, np.ones((*colors.shape[:-1], 1))), axis=-1)
                colors = colors[..., :4]
            corners = np.asarray(triangles.vertex, dtype=float)[triangles.vertex_index]
            material = self._material(bound.get(triangles.material), str(triangles.material or ""))
            piece = Piece(tuple(dict.fromkeys(names + geometry_names)), corners, normals, uv, colors, material)
            yield piece.moved(matrix)

    def _material(self, given: Any, symbol: str) -> Material:
        if given is None or given.effect is None:
            return Material(symbol)
        if given.id not in self.materials:
            self.materials[given.id] = self._look(given.name or given.id, given.effect)
        return self.materials[given.id]

    def _look(self, name: str, effect: Any) -> Material:
        diffuse, emission = effect.diffuse, effect.emission
        opacity = self._opacity(name, effect)
        if diffuse is None and emission is not None:  # a material that only glows
            diffuse, emission = emission, None
        glow = (0.0, 0.0, 0.0) if emission is None or isinstance(emission, Map) else _color(emission)[:3]
        if isinstance(diffuse, Map):
            picture = self.folder.picture(_image_address(diffuse))
            rgba = (1.0, 1.0, 1.0, opacity) if picture is not None else (0.7, 0.7, 0.7, opacity)
            return Material(name, rgba, picture, glow)
        if diffuse is None:
            return Material(name, None, None, glow)
        return Material(name, (*_color(diffuse)[:3], opacity), None, glow)

    def _opacity(self, name: str, effect: Any) -> float:
        """Return the opacity as Gazebo computes it: 1 for a material without the attribute ``opaque``."""
        node = next((e for e in effect.xmlnode.iter() if _tag(e) == "transparent"), None)
        if node is None or node.get("opaque") is None or isinstance(effect.transparent, Map):
            return 1.0
        text = next((e.text or "" for e in node.iter() if _tag(e) == "color"), "1 1 1 1")
        try:
            color = np.array([float(word) for word in text.split()])
            written = next((e for e in effect.xmlnode.iter() if _tag(e) == "transparency"), None)
            words = "" if written is None else "".join(written.itertext())
            # Exporters leave the factor out or write it empty: both mean 1.
            factor = float(words) if words.strip() else 1.0
        except ValueError:
            return 1.0
        # COLLADA 1.4.1, "Determining Transparency": RGB_ZERO weighs the colour by luminance, A_ONE takes its alpha.
        if node.get("opaque") == "RGB_ZERO":
            opacity = 1.0 - float(_LUMINANCE @ color[:3]) * factor
        else:
            opacity = (float(color[3]) if len(color) > 3 else 1.0) * factor
        # The comparison is false for NaN, too.
        if not opacity >= INVISIBLE:
            self.folder.notes.append(
                Note(
                    f"material {name} invisible",
                    "opaque",
                    "some exporters write opacity and transparency the wrong way round",
                )
            )
            return 1.0
        return min(opacity, 1.0)


def _color(given: Any) -> tuple[float, float, float]:
    values = np.clip(np.nan_to_num(np.asarray(given, dtype=float).ravel()), 0.0, 1.0)
    return tuple(np.resize(values, 3).tolist()) if len(values) else (0.7, 0.7, 0.7)


def _image_address(texture: Any) -> str:
    try:
        return str(texture.sampler.surface.image.path or "")
    except AttributeError:
        return ""
