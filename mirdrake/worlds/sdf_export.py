"""A world as an SDF file that Gazebo and Drake load.

Meshes become OBJ files beside it: Drake turns a glTF mesh from y up to z up and Gazebo does not, but both take an OBJ
as it stands. The ground is one large box: Drake's parser can crash on planes. Friction patches have no place in SDF.

SDF: http://sdformat.org/spec (1.7, which Gazebo classic 11 reads too); the tags of Drake: its page "Parsing Models for
Multibody Simulation".
"""

import io
import json
import math
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image
from pydrake.geometry import Box, Convex, Cylinder, Shape, Sphere
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.tree import SpatialInertia

from mirdrake.errors import WorldError
from mirdrake.worlds.lock import mesh_files, read_bytes
from mirdrake.worlds.props import PlacedProp, Prop
from mirdrake.worlds.scenery import scenery, sky_colors, sun_light, texture_path
from mirdrake.worlds.world import World, track_mu

Array = NDArray[np.float64]
Color = tuple[float, float, float]

STIFFNESS = 1e6
"""Point contact stiffness of a prop in Drake [N/m], as :data:`mirdrake.obstacles.STIFFNESS`."""

DISSIPATION = 1.0
"""Hunt-Crossley dissipation of all shapes in Drake [s/m]; its default of 50 s/m makes contact stick."""

_GREY = (0.72, 0.71, 0.68)  # of a prop without mesh and colour
_APRON = 1000.0  # [m] of ground beyond the world
_DEPTH = 10.0  # [m] of the box that is the ground
_HINT = 0.05  # [m] resolution of hydroelastic props
_UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # y up to z up


@dataclass(frozen=True)
class SdfExport:
    """The files of an SDF world.

    Attributes:
        files: content by path relative to the folder of the SDF file; that one comes last.
        models: name of the model of each prop.
        left_out: what the file cannot say, one line each.
    """

    files: dict[str, bytes]
    models: dict[str, str]
    left_out: tuple[str, ...]


def export_sdf(world: World, *, file: str = "world.sdf") -> SdfExport:
    """A world as SDF with its meshes; nothing is written.

    Args:
        world: the world.
        file: name of the SDF file.

    Raises:
        WorldError: a mesh cannot be read.
    """
    meshes = ObjFiles()
    root = Element("sdf", {"version": "1.7", "xmlns:drake": "http://drake.mit.edu"})
    tree = SubElement(root, "world", {"name": model_names([world.name])[0]})
    _text(tree, "gravity", _numbers(world.ground.gravity))
    _add_light(tree, world)
    mu, left_out = _ground_mu(world)
    for line in left_out:
        tree.append(ElementTree.Comment(f" left out: {line.replace('--', '- -')} "))
    _add_ground(tree, world, mu, meshes)
    names = model_names([placed.name for placed in world.props], taken={"ground", "sun"})
    for placed, name in zip(world.props, names, strict=True):
        _add_prop(tree, placed, name, meshes)
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode", xml_declaration=False)
    files = meshes.files | {file: f'<?xml version="1.0"?>\n{text}\n'.encode()}
    models = {placed.name: name for placed, name in zip(world.props, names, strict=True)}
    return SdfExport(files, models, tuple(left_out))


def model_names(names: Sequence[str], *, taken: Iterable[str] = ()) -> list[str]:
    """Names as SDF, ROS and Gazebo's topics allow them: letters, digits and single underscores, all different.

    ``block[2].building[0]`` becomes ``block_2_building_0``.
    """
    used, found = set(taken), []
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_") or "world"
        plain = plain if plain[0].isalpha() else f"m_{plain}"
        unique, number = plain, 1
        while unique in used:
            number += 1
            unique = f"{plain}_no_{number}"
        used.add(unique)
        found.append(unique)
    return found


# --- meshes ------------------------------------------------------------------------------------------------------


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
    """The mesh files of one SDF world.

    Attributes:
        files: content by path, for example ``meshes/cone/cone.obj``.
    """

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}
        self._known: dict[object, list[tuple[str, Color | None]]] = {}
        self._folders: dict[str, Path] = {}

    def add_mesh(self, kind: str, path: Path, paint: str | None) -> list[tuple[str, Color | None]]:
        """A mesh that is seen.

        Args:
            kind: name of the prop.
            path: glTF or OBJ.
            paint: material that has the colour of the prop.

        Returns:
            paths of OBJ files with the colour they are to get; None where they bring their own.

        Raises:
            WorldError: the mesh cannot be read.
        """
        if (path, paint) in self._known:
            return self._known[path, paint]
        folder = self._folder(kind, path)
        if path.suffix.lower() == ".obj":
            for file in mesh_files(path):
                self.files[f"{folder}/{file.name}"] = read_bytes(file)
            found: list[tuple[str, Color | None]] = [(f"{folder}/{path.name}", None)]
        else:
            parts = _load(path)
            found = self._write(f"{folder}/{path.stem}", [part for part in parts if part.material != paint])
            painted = [part for part in parts if part.material == paint]
            if painted:
                self._write(f"{folder}/{path.stem}_paint", painted, colored=False)
                found.append((f"{folder}/{path.stem}_paint.obj", painted[0].color))
        self._known[path, paint] = found
        return found

    def add_gltf(self, name: str, data: Mapping[str, Any]) -> list[tuple[str, Color | None]]:
        """A glTF document with everything in it; as :meth:`add_mesh`."""
        return self._write(f"meshes/{name}", _parts(io.BytesIO(json.dumps(data).encode()), name))

    def add_hull(self, name: str, shape: Convex) -> str:
        """The convex hull of a mesh, in its unscaled size; returns the path of the OBJ file."""
        path = Path(shape.source().path())
        if ("hull", path) not in self._known:
            read_bytes(path)  # tells of a file that has gone
            hull = Convex(str(path), np.ones(3)).GetConvexHull()
            kind, _, stem = name.partition("/")
            target = f"{self._folder(kind, path)}/{stem}.obj"
            lines = ["v " + " ".join(f"{x:.9g}" for x in hull.vertex(i)) for i in range(hull.num_vertices())]
            for i in range(hull.num_elements()):
                face = hull.element(i)
                lines.append("f " + " ".join(str(face.vertex(k) + 1) for k in range(face.num_vertices())))
            self.files[target] = ("\n".join(lines) + "\n").encode()
            self._known["hull", path] = [(target, None)]
        return self._known["hull", path][0][0]

    def _folder(self, kind: str, path: Path) -> str:
        """A folder for the meshes of a kind of prop; another one for another kind of the same name."""
        plain = re.sub(r"\W+", "_", kind, flags=re.ASCII).strip("_") or "mesh"
        name, number = plain, 1
        while self._folders.setdefault(name, path.parent) != path.parent:
            number += 1
            name = f"{plain}_{number}"
        return f"meshes/{name}"

    def _write(self, stem: str, parts: Sequence[_Part], *, colored: bool = True) -> list[tuple[str, Color | None]]:
        """Parts as one OBJ file with its materials."""
        if not parts:
            return []
        name = stem.rpartition("/")[2]
        lines, materials = ([f"mtllib {name}.mtl"] if colored else []), []
        base = np.ones(3, dtype=np.int64)
        for number, part in enumerate(parts):
            points, at = np.unique(np.round(part.points, 5) + 0.0, axis=0, return_inverse=True)
            normals, facing = np.unique(np.round(part.normals, 3) + 0.0, axis=0, return_inverse=True)
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
                materials[-2] = "Kd 1 1 1"
                materials.append(f"map_Kd {name}_{number}.png")
                self.files[f"{stem}_{number}.png"] = part.picture
            corner = part.faces.ravel()
            vertex, normal = at.ravel()[corner] + base[0], facing.ravel()[corner] + base[1]
            middle = [str(i) for i in (corner + base[2])] if textured else [""] * len(corner)
            texts = [f"{v}/{t}/{n}" for v, t, n in zip(vertex.tolist(), middle, normal.tolist(), strict=True)]
            lines += [f"f {texts[i]} {texts[i + 1]} {texts[i + 2]}" for i in range(0, len(texts), 3)]
            base += [len(points), len(normals), len(part.points) if textured else 0]
        self.files[f"{stem}.obj"] = ("\n".join(lines) + "\n").encode()
        if colored:
            self.files[f"{stem}.mtl"] = ("\n".join(materials) + "\n").encode()
        return [(f"{stem}.obj", None)]


def _plain_color(data: Mapping[str, Any]) -> dict[str, Any]:
    """A glTF document of :mod:`mirdrake.worlds.scenery` with the mean colours of its textures in their place.

    A texture of an OBJ file does not repeat in Drake, so that a tiled one would be smeared.
    """
    document: dict[str, Any] = json.loads(json.dumps(data))
    images = [Path(image["uri"]).stem for image in document.pop("images", ())]
    for key in ("textures", "samplers"):
        document.pop(key, None)
    for material in document.get("materials", ()):
        shading = material["pbrMetallicRoughness"]
        texture = shading.pop("baseColorTexture", None)
        if texture is not None:
            shading["baseColorFactor"] = [*(c**2.2 for c in _mean_color(images[texture["index"]])), 1.0]
    return document


@lru_cache(maxsize=16)
def _mean_color(surface: str) -> Color:
    with Image.open(texture_path(surface)) as picture:
        red, green, blue = np.asarray(picture.convert("RGB"), dtype=float).mean(axis=(0, 1)) / 255.0
    return float(red), float(green), float(blue)


def _load(path: Path) -> list[_Part]:
    for file in mesh_files(path):
        read_bytes(file)  # a missing buffer or picture is told by its name
    return _parts(path, path.name)


def _parts(source: Path | io.BytesIO, name: str) -> list[_Part]:
    """The parts of a glTF mesh.

    Raises:
        WorldError: it is none.
    """
    kind = source.suffix.lower().lstrip(".") if isinstance(source, Path) else "gltf"
    try:
        scene = trimesh.load(source, file_type=kind, force="scene", process=False)
        meshes = [part for part in scene.dump() if isinstance(part, trimesh.Trimesh) and len(part.faces)]
    except Exception as error:  # whatever a reader of foreign files raises
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        raise WorldError(f"{name}: is no mesh that can be read: {reason}") from None
    found = []
    for mesh in meshes:
        material, uv, picture = getattr(mesh.visual, "material", None), getattr(mesh.visual, "uv", None), None
        image = getattr(material, "baseColorTexture", None)
        if image is not None and uv is not None:
            buffer = io.BytesIO()
            image.convert("RGB").save(buffer, "PNG")
            picture = buffer.getvalue()
        factor = getattr(material, "baseColorFactor", None)
        linear = np.array([0.5, 0.5, 0.5]) if factor is None else _linear(factor)
        red, green, blue = (float(c) for c in np.clip(linear, 0.0, 1.0) ** (1.0 / 2.2))
        found.append(
            _Part(
                str(getattr(material, "name", "")), (red, green, blue), np.asarray(mesh.vertices) @ _UPRIGHT.T,
                np.asarray(mesh.vertex_normals) @ _UPRIGHT.T, np.asarray(mesh.faces, dtype=np.int64), uv, picture,
            )
        )  # fmt: skip
    return found


def _linear(factor: Any) -> Array:
    """A colour factor of trimesh, bytes or fractions, as linear red, green, blue."""
    values = np.asarray(factor)
    return np.asarray(values[:3] / 255.0 if values.dtype == np.uint8 else values[:3], dtype=float)


# --- tags -------------------------------------------------------------------------------------------------------


def _ground_mu(world: World) -> tuple[float, list[str]]:
    """The one friction coefficient of the ground [-], and what is lost by having one only."""
    roads = {name: track_mu(world.spec.tracks[name]) for name in world.roads()}
    mu = max(roads.values(), default=world.ground.mu)
    lost = [
        f"friction {value:g} of track '{name}' (the ground has {mu:g})" for name, value in roads.items() if value != mu
    ]
    if roads and world.ground.mu != mu:
        lost.append(f"friction {world.ground.mu:g} beside the tracks (the ground has {mu:g} everywhere)")
    lost += [f"friction {patch.mu:g} of patch '{patch.name}'" for patch in world.patches]
    return mu, lost


def _add_light(tree: Element, world: World) -> None:
    sun, (_, horizon) = sun_light(world), sky_colors(world)
    scene = SubElement(tree, "scene")
    _text(scene, "ambient", _color([world.spec.lights.ambient] * 3))
    _text(scene, "background", _color(horizon))
    light = SubElement(tree, "light", {"name": "sun", "type": "directional"})
    _text(light, "cast_shadows", "true")
    _text(light, "pose", _numbers([*(-100.0 * sun.direction), 0.0, 0.0, 0.0]))
    _text(light, "diffuse", _color(np.minimum(0.9 * sun.intensity * np.array(sun.color), 1.0)))
    _text(light, "specular", _color([0.2, 0.2, 0.2]))
    _text(light, "direction", _numbers(sun.direction))


def _add_ground(tree: Element, world: World, mu: float, meshes: ObjFiles) -> None:
    model = SubElement(tree, "model", {"name": "ground"})
    _text(model, "static", "true")
    link = SubElement(model, "link", {"name": "body"})
    xmin, ymin, xmax, ymax = world.ground.extent
    box = Box(xmax - xmin + 2.0 * _APRON, ymax - ymin + 2.0 * _APRON, _DEPTH)
    X = RigidTransform([(xmin + xmax) / 2.0, (ymin + ymax) / 2.0, -_DEPTH / 2.0])
    _add_collision(link, "plane", box, X, mu, meshes)
    for number, item in enumerate(scenery(world)):
        name = model_names([item.name])[0]
        data = json.loads(item.shape.source().in_memory().mesh_file.contents())
        for part, (uri, color) in enumerate(meshes.add_gltf(f"scenery/{name}", _plain_color(data))):
            _add_visual(link, f"scenery_{number}_{part}", ("mesh", uri, (1.0, 1.0, 1.0)), item.X_WG, color)


def _add_prop(tree: Element, placed: PlacedProp, name: str, meshes: ObjFiles) -> None:
    prop = placed.prop
    model = SubElement(tree, "model", {"name": name})
    if name != placed.name:
        model.append(ElementTree.Comment(f" {placed.name} "))
    _text(model, "static", "true" if placed.static else "false")
    _text(model, "pose", _pose(placed.X_WP))
    link = SubElement(model, "link", {"name": "body"})
    if not placed.static:
        _add_inertial(link, prop)
    for index, solid in enumerate(prop.solids):
        _add_collision(
            link, f"collision_{index}", solid.shape, solid.X_PS, prop.mu, meshes, driven_over=prop.driven_over,
            label=f"{prop.name}/solid_{index}",
        )  # fmt: skip
    color = placed.color or _GREY
    if prop.visual is None:
        for index, solid in enumerate(prop.solids):
            shape = _shape(solid.shape, meshes, f"{prop.name}/solid_{index}")
            _add_visual(link, f"visual_{index}", shape, solid.X_PS, color)
        return
    for index, (uri, own) in enumerate(meshes.add_mesh(prop.name, prop.visual, prop.paint)):
        paint = own if own is None or placed.color is None else placed.color
        _add_visual(link, f"visual_{index}", ("mesh", uri, prop.scale), RigidTransform(), paint)


def _add_inertial(link: Element, prop: Prop) -> None:
    """Mass, centre and inertia: the mass spread evenly over the boxes around the solids, by their volumes."""
    total = sum(solid.volume for solid in prop.solids)
    sum_P = SpatialInertia.Zero()
    for solid in prop.solids:
        size, middle = np.ptp(solid.corners, axis=0), 0.5 * (solid.corners.min(axis=0) + solid.corners.max(axis=0))
        sum_P += SpatialInertia.SolidBoxWithMass(prop.mass * solid.volume / total, *size).Shift(-middle)
    centre = sum_P.get_com()
    moments = sum_P.Shift(centre).CalcRotationalInertia().CopyToFullMatrix3()
    inertial = SubElement(link, "inertial")
    _text(inertial, "pose", _numbers([*centre, 0.0, 0.0, 0.0]))
    _text(inertial, "mass", _numbers([prop.mass]))
    inertia = SubElement(inertial, "inertia")
    for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        _text(inertia, f"i{'xyz'[i]}{'xyz'[j]}", _numbers([moments[i, j]]))


def _add_collision(
    link: Element,
    name: str,
    shape: Shape,
    X: RigidTransform,
    mu: float,
    meshes: ObjFiles,
    *,
    driven_over: bool = False,
    label: str = "",
) -> None:
    collision = SubElement(link, "collision", {"name": name})
    _text(collision, "pose", _pose(X))
    _add_geometry(collision, _shape(shape, meshes, label), convex=True)
    ode = SubElement(SubElement(SubElement(collision, "surface"), "friction"), "ode")
    for key in ("mu", "mu2"):  # Drake reads them as the static and the dynamic one
        _text(ode, key, _numbers([mu]))
    drake = SubElement(collision, "drake:proximity_properties")
    _text(drake, "drake:hunt_crossley_dissipation", _numbers([DISSIPATION]))
    if name != "plane":
        _text(drake, "drake:point_contact_stiffness", _numbers([STIFFNESS]))
    if driven_over:
        SubElement(drake, "drake:rigid_hydroelastic")
        _text(drake, "drake:mesh_resolution_hint", _numbers([_HINT]))


def _add_visual(
    link: Element, name: str, shape: tuple[object, ...], X: RigidTransform, color: Sequence[float] | None
) -> None:
    visual = SubElement(link, "visual", {"name": name})
    _text(visual, "pose", _pose(X))
    _add_geometry(visual, shape)
    if color is not None:
        material = SubElement(visual, "material")
        for key in ("ambient", "diffuse"):
            _text(material, key, _color(color))


def _shape(shape: Shape, meshes: ObjFiles, label: str) -> tuple[object, ...]:
    """A shape as the name of its tag, and what stands in it."""
    if isinstance(shape, Box):
        return "box", _numbers(shape.size())
    if isinstance(shape, Cylinder):
        return "cylinder", shape.radius(), shape.length()
    if isinstance(shape, Sphere):
        return "sphere", shape.radius()
    assert isinstance(shape, Convex)
    return "mesh", meshes.add_hull(label, shape), tuple(shape.scale3())


def _add_geometry(parent: Element, shape: tuple[object, ...], *, convex: bool = False) -> None:
    tag, *values = shape
    element = SubElement(SubElement(parent, "geometry"), str(tag))
    keys = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",), "mesh": ("uri", "scale")}
    if tag == "mesh" and convex:
        SubElement(element, "drake:declare_convex")
    for key, value in zip(keys[str(tag)], values, strict=True):
        _text(element, key, value if isinstance(value, str) else _numbers(np.ravel(np.asarray(value, dtype=float))))


def _text(parent: Element, tag: str, text: str) -> None:
    SubElement(parent, tag).text = text


def _pose(X: RigidTransform) -> str:
    return _numbers([*X.translation(), *RollPitchYaw(X.rotation()).vector()])


def _color(color: Iterable[float]) -> str:
    return _numbers([*(round(float(part), 4) for part in color), 1.0])


def _numbers(values: Iterable[float]) -> str:
    """Numbers to twelve digits, parted by blanks; what is nearly nothing is 0."""
    return " ".join(f"{value:.12g}" if math.fabs(value) >= 1e-12 else "0" for value in map(float, values))
