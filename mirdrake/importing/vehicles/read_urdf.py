"""URDF and xacro into a :class:`SourceModel`; elements without counterpart become changes."""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TypeVar
from xml.etree import ElementTree

import numpy as np
from pydrake.math import RigidTransform

from mirdrake.core.errors import ModelError, Place
from mirdrake.importing.changes import Change, Code
from mirdrake.importing.packages import Packages
from mirdrake.importing.shape import Shape
from mirdrake.importing.values import make_pose, read_number, read_numbers
from mirdrake.importing.vehicles.gazebo_tags import read_gazebo_tag, read_spring_damper
from mirdrake.importing.vehicles.model import Hint, Inertial, Joint, Limits, Link, SourceModel, Surface
from mirdrake.importing.vehicles.ros_control import read_ros2_control, read_transmission
from mirdrake.vehicles.xacro_render import MissingArgumentsError, Urdf, render_xacro

_SPRING = re.compile("stiff|spring", re.IGNORECASE)
_KNOWN = {
    "robot": {"link", "joint", "material", "gazebo", "transmission", "ros2_control", "drake:collision_filter_group"},
    "link": {"inertial", "visual", "collision", "contact"},
    "joint": {"parent", "child", "origin", "axis", "limit", "dynamics", "mimic", "safety_controller", "calibration"},
}
_MACRO = re.compile(r"<(?:xacro:)?macro\s[^>]*?\bname\s*=\s*[\"']([\w.-]+)")
_XACRO = {"macro", "property", "include", "arg", "if", "unless", "insert_block", "call"}
_TYPES = {
    "revolute", "continuous", "prismatic", "fixed", "floating", "planar", "universal", "ball", "screw", "revolute2"
}  # fmt: skip

_CONTACT = {"lateral_friction": "mu", "stiffness": "stiffness", "damping": "damping"}
_WITHOUT_AXIS = {"fixed", "floating", "ball"}

_Part = TypeVar("_Part", Link, Joint)


def read_urdf(path: Path, *, packages: Packages, arguments: Mapping[str, str]) -> SourceModel:
    """Read a URDF or xacro file.

    Raises:
        MissingArgumentsError: xacro arguments need values.
        ModelError: the file is not URDF, or contains invalid values.
    """
    urdf = _render(path, packages, arguments)
    if urdf.root.tag != "robot":
        raise ModelError(
            f"<{urdf.root.tag}> is not URDF; the root element should be <robot>", where=urdf.where(urdf.root)
        )
    model = SourceModel(urdf.root.get("name", "") or path.name.split(".")[0], files=list(urdf.files))
    model.changes += [
        Change(Code.ELEMENT, warning.where, "xacro", warning.text, "as xacro expanded it", "xacro warned about it")
        for warning in urdf.warnings
    ]
    model.hints = list(_missing_prefixes(urdf))
    try:
        _Reader(urdf, model, packages, path.parent).read()
    except ModelError as error:
        raise ModelError("; ".join([error.text, *map(str, model.hints)]), where=error.where) from None
    return model


def _render(path: Path, packages: Packages, arguments: Mapping[str, str]) -> Urdf:
    """Return the expanded file. Missing arguments are collected over all files, with stand-in values.

    Raises:
        MissingArgumentsError: with all arguments that need values.
    """
    # Xacro stops at the first missing argument of a file. Stand-in values let it go on, so that all are asked for at
    # once.
    missing: dict[str, Place] = {}
    while True:
        try:
            urdf = render_xacro(path, arguments={**dict.fromkeys(missing, "0"), **arguments}, find=packages.find)
        except MissingArgumentsError as error:
            places = {name: place for name, place in error.arguments.items() if name not in missing}
            # Nothing new was found, so that the next round would end here as well.
            if not places:
                raise MissingArgumentsError(missing) from None
            missing |= places
        except ModelError:
            if missing:  # other errors may be due to the stand-in values
                raise MissingArgumentsError(missing) from None
            raise
        else:
            if missing:
                raise MissingArgumentsError(missing)
            return urdf


def _missing_prefixes(urdf: Urdf) -> Iterator[Hint]:
    """Yield elements that look like macro calls or tags of xacro without the prefix ``xacro:``."""
    macros: set[str] = set()
    for path in urdf.files:
        macros |= set(_MACRO.findall(path.read_text(encoding="utf-8", errors="replace")))
    standard = set().union(*_KNOWN.values())
    children = [child for parent in (urdf.root, *urdf.root) for child in parent if isinstance(child.tag, str)]
    for element in children:
        tag = element.tag
        if tag in standard or not (tag in macros or tag in _XACRO):
            continue
        meant = f"a call of the macro '{tag}'" if tag in macros else "a tag of xacro"
        text = f"looks like {meant} without the prefix xacro:, write <xacro:{tag}>"
        yield Hint(tag, urdf.where(element), text)


class _Reader:
    """Reads one expanded model."""

    def __init__(self, urdf: Urdf, model: SourceModel, packages: Packages, folder: Path) -> None:
        self._urdf, self._model, self._packages, self._folder = urdf, model, packages, folder
        self._materials = {element.get("name", ""): element for element in urdf.root.findall("material")}

    def read(self) -> None:
        root, where = self._urdf.root, self._urdf.where
        # Links come before joints, which are checked against them, and both before the tags that refer to them.
        for element in root.findall("link"):
            self._add(self._model.links, self._link(element), where(element), "link")
        for element in root.findall("joint"):
            if element.get("type") is None and element.find("parent") is None:
                continue  # the joint of a transmission dialect
            self._add(self._model.joints, self._joint(element), where(element), "joint")
        for element in root.findall("gazebo"):
            read_gazebo_tag(element, self._model, where)
        for element in root:
            if element.tag.endswith("linear_spring_damper"):
                read_spring_damper(element, self._model, where)
        for element in root.findall("transmission"):
            read_transmission(element, self._model, where)
        for element in root.findall("ros2_control"):
            read_ros2_control(element, self._model, where)
        self._strays(root, "robot")

    def _add(self, table: dict[str, _Part], item: _Part, where: str, kind: str) -> None:
        if not item.name:
            raise ModelError(f"a {kind} without a name", where=where)
        if item.name in table:
            raise ModelError(
                f"{kind} '{item.name}' is defined twice; the other one is at {table[item.name].where}", where=where
            )
        table[item.name] = item

    def _strays(self, element: ElementTree.Element, kind: str) -> None:
        """Report elements that are not part of URDF."""
        for child in element:
            if child.tag not in _KNOWN[kind] and not child.tag.startswith("{"):
                name = element.get("name", "")
                hints = (hint.text for hint in self._model.hints if hint.tag == child.tag)
                why = next(hints, "it is not part of URDF")
                self._change(Code.ELEMENT, child, f"{kind} '{name}': <{child.tag}>", "…", None, why)

    def _change(
        self, code: Code, element: ElementTree.Element, part: str, old: str, new: str | None, reason: str
    ) -> None:
        self._model.changes.add(code, self._urdf.where(element), part, old, new, reason)

    # --- links ---

    def _link(self, element: ElementTree.Element) -> Link:
        name = element.get("name", "")
        self._strays(element, "link")
        link = Link(name, self._inertial(element.find("inertial"), name), where=self._urdf.where(element))
        for tag, shapes in (("visual", link.visuals), ("collision", link.collisions)):
            for part in element.findall(tag):
                shapes += self._shapes(part, f"link '{name}': {tag}")
        self._contact(element.find("contact"), link)
        return link

    def _contact(self, element: ElementTree.Element | None, link: Link) -> None:
        """Read the contact data of a link in Bullet's dialect of URDF."""
        if element is None:
            return
        link.surface = Surface(where=self._urdf.where(element))
        for child in element:
            text = child.get("value", "")
            if child.tag in _CONTACT:
                value = read_number(text, where=self._urdf.where(child), what=f"<{child.tag}>")
                setattr(link.surface, _CONTACT[child.tag], value)
            else:
                link.surface.others[child.tag] = text

    def _inertial(self, element: ElementTree.Element | None, name: str) -> Inertial | None:
        if element is None:
            return None
        where, part = self._urdf.where(element), f"link '{name}':"
        mass, inertia = element.find("mass"), element.find("inertia")
        value = read_number(mass.get("value") if mass is not None else None, where=where, what=f"{part} mass")
        keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        # Missing elements count as zero; impossible tensors are corrected later.
        given = [
            read_number(inertia.get(key) if inertia is not None else None, where=where, what=f"{part} {key}") or 0.0
            for key in keys
        ]
        xx, xy, xz, yy, yz, zz = given
        # URDF states elements of the tensor, ixy = -∫xy dm, so that the signs stay as they are.
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        return Inertial(value or 0.0, self._origin(element), tensor, where)

    def _origin(self, element: ElementTree.Element) -> RigidTransform:
        origin = element.find("origin")
        if origin is None:
            return make_pose([0.0] * 3, [0.0] * 3)
        where = self._urdf.where(origin)
        xyz, rpy = (
            read_numbers(origin.get(key), count=3, default=[0.0] * 3, where=where, what=f"<origin> {key}")
            for key in ("xyz", "rpy")
        )
        return make_pose(xyz, rpy)

    def _shapes(self, element: ElementTree.Element, part: str) -> Iterator[Shape]:
        # Without a geometry, the element is left out: a placeholder would collide with something.
        geometry = element.find("geometry")
        if geometry is None:  # some files nest the whole visual once more
            inner = [child for child in element if child.find("geometry") is not None]
            if inner:
                yield from self._shapes(inner[0], part)
            else:
                self._change(Code.SHAPE, element, part, "no geometry", None, "it has no geometry")
            return
        where, pose = self._urdf.where(element), self._origin(element)
        inside = geometry.find("material")  # where some files have it
        rgba, texture = self._material(inside if element.find("material") is None else element.find("material"), part)
        for shape in geometry:
            if shape is inside:
                continue
            result = self._shape(shape, where, part)
            if result is not None:
                result.X_LG, result.rgba, result.texture = pose, rgba, texture
                yield result

    def _shape(self, shape: ElementTree.Element, where: str, part: str) -> Shape | None:
        def size(key: str, count: int = 1) -> tuple[float, ...]:
            values = read_numbers(shape.get(key), count=count, default=[], where=where, what=f"<{shape.tag}> {key}")
            if len(values) != count:
                raise ModelError(f"<{shape.tag}> without {key}", where=where)
            return tuple(float(value) for value in values)

        # Sizes without a default are errors of the file: a shape of a guessed size would change the contact.
        if shape.tag == "box":
            return Shape("box", size("size", 3), where=where)
        if shape.tag in {"cylinder", "capsule"}:
            return Shape(shape.tag, (*size("radius"), *size("length")), where=where)
        if shape.tag == "sphere":
            return Shape("sphere", size("radius"), where=where)
        if shape.tag == "mesh":
            address = shape.get("filename", "")
            return self.mesh(address, self._scale(shape, where), where, part)
        self._change(Code.SHAPE, shape, part, f"<{shape.tag}>", None, "this shape is not supported")
        return None

    def _scale(self, shape: ElementTree.Element, where: str) -> tuple[float, ...]:
        """Return the scale of a mesh: three factors, or one for all."""
        text = shape.get("scale")
        if text is not None and len(text.split()) > 3:
            text = " ".join(text.split()[:3])
            self._change(Code.MESH, shape, "<mesh> scale", shape.get("scale", ""), text, "a scale has three factors")
        count = 1 if text is not None and len(text.split()) == 1 else 3
        scale = read_numbers(text, count=count, default=[1.0] * 3, where=where, what="<mesh> scale")
        return tuple((np.repeat(scale, 3) if len(scale) == 1 else scale).tolist())

    def mesh(self, address: str, scale: tuple[float, ...], where: str, part: str) -> Shape:
        """Return a mesh shape with its file; a missing file becomes a change."""
        path, remark = self._packages.resolve(address, folder=self._folder)
        if remark:
            became = None if path is None else path.name
            self._model.changes.add(Code.MESH, where, f"{part} mesh", address, became, remark)
        return Shape("mesh", mesh=path, address=address, scale=scale, where=where)  # type: ignore[arg-type]

    def _material(
        self, element: ElementTree.Element | None, part: str
    ) -> tuple[tuple[float, float, float, float] | None, Path | None]:
        if element is None:
            return None, None
        # A material with nothing but a name refers to one at the top of the file.
        if element.find("color") is None and element.find("texture") is None:
            element = self._materials.get(element.get("name", ""), element)
        color, texture = element.find("color"), element.find("texture")
        rgba, path = None, None
        if color is not None and color.get("rgba"):
            a, b, c, d = read_numbers(
                color.get("rgba"), count=4, default=[], where=self._urdf.where(color), what="<color> rgba"
            ).tolist()
            rgba = (a, b, c, d)
        if texture is not None and texture.get("filename"):
            path, remark = self._packages.resolve(texture.get("filename", ""), folder=self._folder)
            if remark:
                became = None if path is None else path.name
                self._change(Code.MATERIAL, texture, f"{part} texture", texture.get("filename", ""), became, remark)
        return rgba, path

    # --- joints ---

    def _joint(self, element: ElementTree.Element) -> Joint:
        name, where = element.get("name", ""), self._urdf.where(element)
        part = f"joint '{name}'"
        kind = element.get("type", "").strip().lower()
        if kind not in _TYPES:
            raise ModelError(f"{part} is of type '{kind}'; allowed: {', '.join(sorted(_TYPES))}", where=where)
        # A joint without its links is an error in ROS as well; no position could be found for the child.
        ends = []
        for tag in ("parent", "child"):
            end = element.find(tag)
            link = end.get("link", "") if end is not None else ""
            if link not in self._model.links:
                raise ModelError(f"{part}: {tag} link '{link}' does not exist", where=where)
            ends.append(link)
        # Values are read as written; impossible ones are corrected later, with a change.
        axis, mimic = element.find("axis"), element.find("mimic")
        joint = Joint(name, kind, ends[0], ends[1], X_PJ=self._origin(element), where=where)
        # The default axis of URDF is x.
        joint.axis = read_numbers(
            axis.get("xyz") if axis is not None else None, count=3, default=[1, 0, 0], where=where, what=f"{part} axis"
        )
        if not joint.axis.any() and kind not in _WITHOUT_AXIS:
            # Mimic joints follow another one, for example the left kingpin the right one.
            raise ModelError(f"{part}: its axis has no direction", where=where)
        joint.mimic = mimic.get("joint", "") if mimic is not None else ""
        limit, dynamics = element.find("limit"), element.find("dynamics")
        if limit is not None:
            lower, upper, effort, velocity = (
                read_number(limit.get(key), where=where, what=f"{part} {key}")
                for key in ("lower", "upper", "effort", "velocity")
            )
            joint.limits = Limits(lower, upper, effort, velocity)
            self._others(joint, limit, {"lower", "upper", "effort", "velocity"})
        if dynamics is not None:
            joint.damping = read_number(dynamics.get("damping"), where=where, what=f"{part} damping") or 0.0
            joint.friction = read_number(dynamics.get("friction"), where=where, what=f"{part} friction") or 0.0
            self._others(joint, dynamics, {"damping", "friction"})
        self._strays(element, "joint")
        return joint

    def _others(self, joint: Joint, element: ElementTree.Element, known: set[str]) -> None:
        """Read attributes that are not in the standard: springs are used, others reported."""
        for key, text in element.attrib.items():
            if key in known:
                continue
            joint.others[key] = text
            where = self._urdf.where(element)
            # A spring reference is the position at rest, not a stiffness.
            if _SPRING.search(key) and "ref" not in key.lower():
                joint.stiffness = read_number(text, where=where, what=f"joint '{joint.name}' {key}")
                continue
            self._change(
                Code.ELEMENT, element, f"joint '{joint.name}': {key}", text, None, "the attribute is not part of URDF"
            )
