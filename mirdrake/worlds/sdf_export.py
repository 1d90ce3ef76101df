"""SDF export of worlds, for Gazebo and Drake.

Meshes become OBJ files beside it, see :mod:`mirdrake.worlds.obj_files`. The ground is one large box, because
Drake's parser can crash on planes. SDF cannot represent friction patches.

SDF: http://sdformat.org/spec (1.7, which Gazebo classic 11 reads too); the tags of Drake: its page "Parsing Models for
Multibody Simulation".
"""

import json
import math
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from pydrake.geometry import Box, Convex, Shape
from pydrake.math import RigidTransform, RollPitchYaw

from mirdrake.worlds.obj_files import ObjFiles, plain_color
from mirdrake.worlds.props import DISSIPATION, STIFFNESS, PlacedProp, Prop
from mirdrake.worlds.scenery import scenery, sky_colors, sun_light
from mirdrake.worlds.solids import Size, kind_of
from mirdrake.worlds.world import World

_GREY = (0.72, 0.71, 0.68)  # of a prop without mesh and colour
_APRON = 1000.0  # [m] of ground beyond the world
_DEPTH = 10.0  # [m] of the ground box
_HINT = 0.05  # [m] resolution hint of hydroelastic props


@dataclass(frozen=True)
class SdfExport:
    """The files of an SDF world.

    Attributes:
        files: content by path relative to the folder of the SDF file; the SDF file is the last.
        models: name of the model of each prop.
        left_out: lines about what SDF cannot represent.
    """

    files: dict[str, bytes]
    models: dict[str, str]
    left_out: tuple[str, ...]


@dataclass(frozen=True)
class _Geometry:
    """A geometry element: its tag, and the texts of its children."""

    tag: str
    children: Mapping[str, str]


def export_sdf(world: World, *, file: str = "world.sdf") -> SdfExport:
    """Return a world as SDF with its meshes; nothing is written.

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
    if not world.ground.terrain.flat:
        left_out.append("collision with the relief of the ground (it collides as a plane at z = 0)")
    # Two hyphens are not allowed in an XML comment.
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
    """Return unique names that SDF, ROS and Gazebo's topics allow: letters, digits and single underscores.

    ``block[2].building[0]`` becomes ``block_2_building_0``.
    """
    used, result = set(taken), []
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_") or "world"
        plain = plain if plain[0].isalpha() else f"m_{plain}"
        unique, number = plain, 1
        while unique in used:
            number += 1
            unique = f"{plain}_no_{number}"
        used.add(unique)
        result.append(unique)
    return result


# --- tags -------------------------------------------------------------------------------------------------------


def _ground_mu(world: World) -> tuple[float, list[str]]:
    """Return the single friction coefficient of the ground [-], and the others, which are lost."""
    roads = {road.name: road.mu for road in world.road_areas}
    # SDF has one coefficient for the whole ground: the largest of the roads.
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
    # The ground collides as a box below z = 0, while the scenery is visual only.
    _add_collision(link, "plane", box, X, mu, meshes)
    for number, item in enumerate(scenery(world)):
        name = model_names([item.name])[0]
        if item.shape.source().is_path():
            for part, (uri, own) in enumerate(meshes.add_mesh(name, item.shape.source().path(), None)):
                _add_visual(link, f"scenery_{number}_{part}", _mesh(uri), item.X_WG, own)
            continue
        data = json.loads(item.shape.source().in_memory().mesh_file.contents())
        for part, (uri, color) in enumerate(meshes.add_gltf(f"scenery/{name}", plain_color(data))):
            _add_visual(link, f"scenery_{number}_{part}", _mesh(uri), item.X_WG, color)


def _add_prop(tree: Element, placed: PlacedProp, name: str, meshes: ObjFiles) -> None:
    prop = placed.prop
    model = SubElement(tree, "model", {"name": name})
    # Names in SDF are restricted, so that the name of the prop is kept as a comment.
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
    # A mesh is exported once and used by all props of its kind; its parts carry the colour of each prop.
    for index, (uri, own) in enumerate(meshes.add_mesh(prop.name, prop.visual, prop.paint)):
        # Only painted parts have a colour of their own to replace; the others keep their materials.
        paint = own if own is None or placed.color is None else placed.color
        _add_visual(link, f"visual_{index}", _mesh(uri, prop.scale), RigidTransform(), paint)


def _add_inertial(link: Element, prop: Prop) -> None:
    """Add mass, centre of mass and the inertia about it."""
    sum_P = prop.inertia
    centre = sum_P.get_com()
    # SDF wants the inertia about the centre of mass, Drake has it about P.
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
    # Gazebo reads the friction of ODE, Drake its own element.
    ode = SubElement(SubElement(SubElement(collision, "surface"), "friction"), "ode")
    for key in ("mu", "mu2"):  # static and dynamic friction in Drake
        _text(ode, key, _numbers([mu]))
    drake = SubElement(collision, "drake:proximity_properties")
    _text(drake, "drake:hunt_crossley_dissipation", _numbers([DISSIPATION]))
    if name != "plane":
        _text(drake, "drake:point_contact_stiffness", _numbers([STIFFNESS]))
    if driven_over:
        SubElement(drake, "drake:rigid_hydroelastic")
        _text(drake, "drake:mesh_resolution_hint", _numbers([_HINT]))


def _add_visual(link: Element, name: str, shape: _Geometry, X: RigidTransform, color: Sequence[float] | None) -> None:
    visual = SubElement(link, "visual", {"name": name})
    _text(visual, "pose", _pose(X))
    _add_geometry(visual, shape)
    if color is not None:
        material = SubElement(visual, "material")
        for key in ("ambient", "diffuse"):
            _text(material, key, _color(color))


def _shape(shape: Shape, meshes: ObjFiles, label: str) -> _Geometry:
    """Return the geometry element of a shape."""
    kind = kind_of(shape)
    if isinstance(shape, Convex):
        return _Geometry("mesh", {"uri": meshes.add_hull(label, shape), "scale": _numbers(kind.sizes(shape))})
    values = (np.ravel(np.asarray(value, dtype=float)) for value in kind.sdf_values(shape))
    return _Geometry(kind.key, dict(zip(kind.sdf_keys, map(_numbers, values), strict=True)))


def _mesh(uri: str, scale: Size = (1.0, 1.0, 1.0)) -> _Geometry:
    """Return the geometry element of a mesh file."""
    return _Geometry("mesh", {"uri": uri, "scale": _numbers(scale)})


def _add_geometry(parent: Element, shape: _Geometry, *, convex: bool = False) -> None:
    element = SubElement(SubElement(parent, "geometry"), shape.tag)
    if shape.tag == "mesh" and convex:
        SubElement(element, "drake:declare_convex")
    for key, value in shape.children.items():
        _text(element, key, value)


def _text(parent: Element, tag: str, text: str) -> None:
    SubElement(parent, tag).text = text


def _pose(X: RigidTransform) -> str:
    return _numbers([*X.translation(), *RollPitchYaw(X.rotation()).vector()])


def _color(color: Iterable[float]) -> str:
    return _numbers([*(round(float(part), 4) for part in color), 1.0])


def _numbers(values: Iterable[float]) -> str:
    """Return numbers with twelve digits, separated by blanks; values below 1e-12 are 0."""
    return " ".join(f"{value:.12g}" if math.fabs(value) >= 1e-12 else "0" for value in map(float, values))
