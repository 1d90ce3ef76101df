"""SDF models into a :class:`SourceModel`.

Poses follow the rules of :mod:`mirdrake.importing.sdf.frames`. The axis of a joint is given in the joint frame unless
``expressed_in`` names another one (before SDF 1.7: ``use_parent_model_frame``, which was the default before 1.5). Names
within nested models are joined with ``::``.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from mirdrake.core.errors import ModelError
from mirdrake.core.yaml_io import display_path
from mirdrake.importing.changes import Code
from mirdrake.importing.gazebo_xml import XmlFiles
from mirdrake.importing.sdf.colours import Rgba
from mirdrake.importing.sdf.elements import (
    DEEPEST,
    is_true,
    read_colour,
    read_frame,
    read_placement,
    read_pose,
    read_shape,
    text_of,
    version_of,
)
from mirdrake.importing.sdf.frames import WORLD, Frames, Scope
from mirdrake.importing.sdf.search import Models
from mirdrake.importing.shape import Shape
from mirdrake.importing.values import leaves, read_number, read_numbers
from mirdrake.importing.vehicles.gazebo_tags import SCRIPT, read_sensor, read_spring_damper
from mirdrake.importing.vehicles.model import Inertial, Joint, Limits, Link, Plugin, SourceModel, Surface
from mirdrake.importing.vehicles.plugin_sensors import take_plugin

_WITHOUT_EFFECT = {"pose", "self_collide", "allow_auto_disable", "static", "enable_wind", "gripper"}
_LINK_WITHOUT_EFFECT = {
    "pose", "inertial", "gravity", "self_collide", "kinematic", "velocity_decay", "must_be_base_link", "enable_wind"
}  # fmt: skip
_WITHOUT_AXIS = {"fixed", "ball"}
_CONTACT = {
    "mu": ("friction/ode/mu", "friction/bullet/friction"),
    "mu2": ("friction/ode/mu2", "friction/bullet/friction2"),
    "stiffness": ("contact/ode/kp",),
    "damping": ("contact/ode/kd",),
}


def read_sdf(path: Path, *, models: Models) -> SourceModel:
    """Read an SDF file with one model.

    Raises:
        ModelError: the file is not SDF, holds several models or a static one, or contains invalid values.
    """
    files = XmlFiles()
    root = files.parse(path)
    if root.tag != "sdf":
        raise ModelError(f"<{root.tag}> is not SDF; the root element should be <sdf>", where=files.where(root))
    model = SourceModel(path.parent.name, files=[path])
    element = _choose_model(root, model, files)
    model.name = element.get("name", "") or model.name
    _Reader(model, models, files).read(element, Scope("", WORLD, version_of(root), path.parent, (path,)))
    return model


def _choose_model(root: Element, model: SourceModel, files: XmlFiles) -> Element:
    """Return the only model of a file that can move."""
    world = root.find("world")
    models = root.findall("model") if world is None else world.findall("model")
    # A world may contain buildings beside the vehicle, which are static.
    moving = [element for element in models if not is_true(text_of(element, "static"))]
    if len(moving) == 1:
        if world is not None:
            became, why = f"model '{moving[0].get('name', '')}'", "the rest of the world is not a vehicle"
            part = f"world '{world.get('name', '')}'"
            model.changes.add(Code.ELEMENT, files.where(world), part, f"{len(world)} elements", became, why)
        return moving[0]
    if models and not moving:
        names = ", ".join(element.get("name", "") for element in models[:8])
        raise ModelError(f"static model '{names}': a prop, not a vehicle", where=files.where(models[0]))
    names = ", ".join(element.get("name", "") for element in moving[:8]) or "none"
    location = f"{display_path(model.files[0])}:1"
    raise ModelError(f"one model is expected in the file; there are {len(moving)} ({names})", where=location)


@dataclass(frozen=True)
class _Axis:
    """An axis of a joint, and the full name of the frame it is expressed in; "" for the joint frame."""

    joint: Joint
    second: bool
    frame: str


class _Reader:
    """Reads one model with everything that it includes: first all elements, then poses and axes."""

    def __init__(self, model: SourceModel, models: Models, files: XmlFiles) -> None:
        self._model, self._models, self._files = model, models, files
        self._frames = Frames()
        self._axes: list[_Axis] = []
        self._plugins: list[Plugin] = []
        self._springs: list[Element] = []

    def read(self, element: Element, scope: Scope) -> None:
        self._read_model(element, scope, 0)
        # Faulty poses of links are errors before joints refer to them.
        for name in self._model.links:
            self._frames.pose(name)
        self._set_joints()
        for plugin in self._plugins:  # which may name links that follow in the file
            take_plugin(plugin, "", self._model)
        # Springs name their links, so that they follow when all joints are known.
        for spring in self._springs:
            read_spring_damper(spring, self._model, self._files.where)

    # --- models, frames and includes ---

    def _read_model(self, element: Element, scope: Scope, depth: int) -> None:
        """Read frames, links and joints of a model and of those nested in it."""
        # A model that includes itself would recurse without end.
        if depth > DEEPEST:
            raise ModelError(f"models are nested more than {DEEPEST} deep", where=self._files.where(element))
        # Poses, axes and springs may refer to frames that come later in the file, so they are resolved after the loop.
        for child in element:
            name, where = child.get("name", ""), self._files.where(child)
            full = scope.full(name)
            if child.tag == "link":
                self._add_frame(full, child, scope)
                self._model.links[full] = self._read_link(child, full, scope)
            elif child.tag == "frame":
                self._add_frame(full, child, scope, default=scope.base(child.get("attached_to", "")))
            elif child.tag == "joint":
                self._read_joint(child, full, scope)
            elif child.tag == "model":
                self._read_nested(child, full, scope, depth, include=None)
            elif child.tag == "include":
                self._read_include(child, scope, depth)
            elif child.tag == "plugin":
                self._plugins.append(Plugin(name, child.get("filename", ""), leaves(child), where))
            elif child.tag.endswith("linear_spring_damper"):
                self._springs.append(child)
            elif child.tag not in _WITHOUT_EFFECT:
                self._change(
                    Code.ELEMENT, child, f"model: <{child.tag}>", "…", None, "it has no counterpart in mirdrake"
                )

    def _add_frame(self, name: str, element: Element, scope: Scope, *, default: str | None = None) -> None:
        """Add the frame of a link, joint or frame; `default` is the base if its pose names none."""
        if not element.get("name"):
            raise ModelError(f"<{element.tag}> without a name", where=self._files.where(element))
        self._frames.add(name, read_frame(element, self._files, scope, default=default))

    def _read_nested(self, element: Element, full: str, scope: Scope, depth: int, *, include: Element | None) -> None:
        """Read a model within another one, or one that is included."""
        self._frames.add(full, read_placement(element, include, full, scope, self._files))
        self._read_model(element, replace(scope, prefix=f"{full}::", origin=full), depth + 1)

    def _read_include(self, element: Element, scope: Scope, depth: int) -> None:
        address, where = text_of(element, "uri"), self._files.where(element)
        path, reason = self._models.find_model(address, scope.folder)
        if path is None:
            raise ModelError(f"include '{address}': {reason}", where=where)
        if path in scope.files:
            raise ModelError(f"include '{address}' includes itself", where=where)
        root = self._files.parse(path)
        self._model.files.append(path)
        inner = root.find("model")
        if inner is None:
            raise ModelError(f"no <model> in the file that {where} includes", where=f"{display_path(path)}:1")
        name = text_of(element, "name") or inner.get("name", "")
        inside = replace(scope, version=version_of(root), folder=path.parent, files=(*scope.files, path))
        if not is_true(element.get("merge", "")):
            self._read_nested(inner, scope.full(name), inside, depth, include=element)
            return
        # The parts of a merged model are named as if they were in the including model, but keep their common frame.
        frame = scope.full(f"__merged__{name}")
        self._frames.add(frame, read_placement(inner, element, frame, inside, self._files))
        self._change(Code.ELEMENT, element, f"include '{name}'", "merged", "part of the model", "merge is true")
        self._read_model(inner, replace(inside, origin=frame), depth + 1)

    # --- links ---

    def _read_link(self, element: Element, name: str, scope: Scope) -> Link:
        link = Link(name, self._read_inertial(element.find("inertial"), name), where=self._files.where(element))
        # In the order of the file, so that changes are reported in the order in which a reader finds their places.
        for child in element:
            if child.tag in {"visual", "collision"}:
                shape = self._read_shape(child, f"link '{name}': {child.tag}", scope)
                if shape is not None:
                    (link.visuals if child.tag == "visual" else link.collisions).append(shape)
                if child.tag == "collision":
                    self._read_surface(child.find("surface"), link)
            elif child.tag == "sensor":
                self._model.sensors.append(read_sensor(child, name, self._files.where, self._model))
            elif child.tag not in _LINK_WITHOUT_EFFECT:
                part = f"link '{name}': <{child.tag}>"
                self._change(Code.SHAPE, child, part, "…", None, "it has no counterpart in mirdrake")
        return link

    def _read_inertial(self, element: Element | None, name: str) -> Inertial | None:
        """Return mass and inertia; what is missing has the defaults of SDF, 1 kg and 1 kg m²."""
        if element is None:
            return None
        where = self._files.where(element)

        def number(path: str, default: float) -> float:
            value = read_number(element.findtext(path), where=where, what=f"link '{name}': {path.rpartition('/')[2]}")
            return default if value is None else value

        xx, yy, zz = (number(f"inertia/{key}", 1.0) for key in ("ixx", "iyy", "izz"))
        xy, xz, yz = (number(f"inertia/{key}", 0.0) for key in ("ixy", "ixz", "iyz"))
        X_LI, _ = read_pose(element.find("pose"), self._files, (1, 7))
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        return Inertial(number("mass", 1.0), X_LI, inertia, where)

    def _read_surface(self, element: Element | None, link: Link) -> None:
        """Read friction and contact stiffness of a collision into its link; the first path that is given counts."""
        if element is None:
            return
        where = self._files.where(element)
        link.surface = link.surface or Surface(where=where)
        # SDF versions and engines have different paths for the same value.
        for key, paths in _CONTACT.items():
            values = (read_number(element.findtext(path), where=where, what=f"<{path}>") for path in paths)
            value = next((value for value in values if value is not None), None)
            if value is not None:
                setattr(link.surface, key, value)
        for key in ("min_depth", "max_vel"):
            text = text_of(element, f"contact/ode/{key}")
            if text:
                link.surface.others[key] = text

    def _read_shape(self, element: Element, part: str, scope: Scope) -> Shape | None:
        where = self._files.where(element)
        read = read_shape(element, self._files, self._models, scope.folder, check_sizes=False)
        shape, remark = read.shape, read.remark
        # A missing shape without a tag is an empty <geometry>, which means nothing to draw and is not a change.
        if shape is None or shape.kind == "polyline":
            if read.tag:
                self._change(
                    Code.SHAPE, element, part, f"<{read.tag}>", None, remark or f"<{read.tag}> is not supported"
                )
            return None
        # A mesh is reported by its address: the tag alone would not tell which of the meshes.
        if remark and shape.kind == "mesh":
            became = None if shape.mesh is None else shape.mesh.name
            self._model.changes.add(Code.MESH, where, f"{part} mesh", shape.address, became, remark)
        elif remark:
            self._change(Code.SHAPE, element, part, f"<{read.tag}>", shape.kind, remark)
        shape.X_LG, _ = read_pose(element.find("pose"), self._files, scope.version)
        shape.where = where
        shape.rgba, shape.texture = self._read_material(element.find("material"), scope, part)
        return shape

    def _read_material(self, element: Element | None, scope: Scope, part: str) -> tuple[Rgba | None, Path | None]:
        if element is None:
            return None, None
        rgba, texture = read_colour(element), None
        address, script = text_of(element, "pbr/metal/albedo_map"), text_of(element, "script/name")
        if address:
            texture, remark = self._models.resolve(address, folder=scope.folder)
            if remark:
                became = None if texture is None else texture.name
                self._change(Code.MATERIAL, element, f"{part} texture", address, became, remark)
        if script and rgba is None and texture is None:
            self._change(Code.MATERIAL, element, f"{part} material", script, None, SCRIPT)
        return rgba, texture

    # --- joints ---

    def _read_joint(self, element: Element, name: str, scope: Scope) -> None:
        where, kind = self._files.where(element), element.get("type", "").strip().lower()
        if name in self._model.joints:
            raise ModelError(f"the joint name '{name}' is used twice; names must differ", where=where)
        parent, child = (_end_of(element, tag) for tag in ("parent", "child"))
        self._add_frame(name, element, scope, default=scope.full(child))
        joint = Joint(name, kind, "world" if parent == "world" else scope.full(parent), scope.full(child), where=where)
        for tag in ("axis", "axis2"):
            # axis2 belongs to universal and revolute2 joints, by which old models steer and drive a wheel.
            axis = element.find(tag)
            if axis is None:
                continue
            vector = read_numbers(axis.findtext("xyz"), count=3, default=[0, 0, 1], where=where, what=f"<{tag}> xyz")
            if not vector.any() and kind not in _WITHOUT_AXIS:
                raise ModelError(f"joint '{name}': its axis has no direction", where=where)
            xyz = axis.find("xyz")
            frame = (xyz.get("expressed_in") or "") if xyz is not None else ""
            # Before SDF 1.5 an axis was in the frame of the model.
            if not frame and (is_true(text_of(axis, "use_parent_model_frame")) or scope.version < (1, 5)):
                frame = "__model__"
            if frame:
                self._axes.append(_Axis(joint, tag == "axis2", scope.full(frame)))
            limits = self._read_limits(axis.find("limit"), name, where)
            if tag == "axis2":
                joint.axis2, joint.limits2 = vector, limits
                continue
            joint.axis, joint.limits = vector, limits
            damping, friction, stiffness = (
                read_number(axis.findtext(f"dynamics/{key}"), where=where, what=f"joint '{name}': {key}")
                for key in ("damping", "friction", "spring_stiffness")
            )
            # SDF's default stiffness of zero means that there is no spring.
            joint.damping, joint.friction, joint.stiffness = damping or 0.0, friction or 0.0, stiffness or None
        self._model.joints[name] = joint

    def _read_limits(self, element: Element | None, name: str, where: str) -> Limits:
        if element is None:
            return Limits()
        return Limits(
            *(
                read_number(element.findtext(key), where=where, what=f"joint '{name}': {key}")
                for key in ("lower", "upper", "effort", "velocity")
            )
        )

    def _set_joints(self) -> None:
        """Set the poses of the joints in their links, and the axes in the joint frames, now that frames are known."""
        for name, joint in list(self._model.joints.items()):
            joint.parent, joint.child = (
                end if end == "world" else self._attached_link(end, joint) for end in (joint.parent, joint.child)
            )
            if joint.parent == "world":
                why = "a vehicle is not fixed to the ground"
                self._model.changes.add(Code.JOINT, joint.where, f"joint '{name}'", "to the world", None, why)
                del self._model.joints[name]
                continue
            # At joint position zero: X_PJ from the parent link to the joint, X_JC from there to the child link.
            X_MJ = self._frames.pose(name)
            joint.X_PJ = self._frames.pose(joint.parent).inverse() @ X_MJ
            joint.X_JC = X_MJ.inverse() @ self._frames.pose(joint.child)
        # Axes are given in any frame, but a Joint has them in its own.
        for axis in self._axes:
            joint = axis.joint
            if joint.name not in self._model.joints:
                continue
            R_JF = (self._frames.pose(joint.name).inverse() @ self._frames.pose(axis.frame)).rotation()
            if axis.second and joint.axis2 is not None:
                joint.axis2 = R_JF.multiply(joint.axis2)
            elif not axis.second:
                joint.axis = R_JF.multiply(joint.axis)

    def _attached_link(self, name: str, joint: Joint) -> str:
        """Return the link that a link, frame or model refers to."""
        step: str | None = name
        for _ in range(DEEPEST):
            if step in self._model.links:
                return step
            # A joint may refer to a nested model, which stands for its first link.
            inside = [link for link in self._model.links if link.startswith(f"{step}::")]
            if step is None or step not in self._frames:
                break
            if inside:
                return inside[0]
            step = self._frames.base(step)
        raise ModelError(f"joint '{joint.name}': link '{name}' does not exist", where=joint.where)

    def _change(self, code: Code, element: Element, part: str, old: str, new: str | None, reason: str) -> None:
        self._model.changes.add(code, self._files.where(element), part, old, new, reason)


def _end_of(element: Element, tag: str) -> str:
    """Return the name of the parent or child link as written, in either form of SDF."""
    return text_of(element, tag) or text_of(element, f"{tag}/link_name")
