"""SDF models into a :class:`SourceModel`.

Poses follow the SDF specification: those of links, frames and nested models count from the model they stand in, that of
a joint from its child link, unless ``relative_to`` names another frame; a joint's axis counts from the joint frame
unless ``expressed_in`` says otherwise (before 1.7: ``use_parent_model_frame``, which was the rule before 1.5).
Names inside nested models are joined with ``::``.
"""

from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from pydrake.math import RigidTransform

from mirdrake.core.errors import ModelError
from mirdrake.core.yaml_io import shown
from mirdrake.importing.vehicles.gazebo_tags import SCRIPT, colour_of, read_sensor, read_spring_damper
from mirdrake.importing.vehicles.model import (
    Change,
    Inertial,
    Joint,
    Limits,
    Link,
    Plugin,
    Shape,
    SourceModel,
    Surface,
)
from mirdrake.importing.vehicles.packages import Packages
from mirdrake.importing.vehicles.plugin_sensors import take_plugin
from mirdrake.importing.vehicles.xml_lines import leaves, make_pose, parse_xml, read_number, read_numbers

DEEPEST = 20
"""Levels of nested models and includes."""

_WITHOUT_EFFECT = {"pose", "self_collide", "allow_auto_disable", "static", "enable_wind", "plugin", "link", "joint",
                   "model", "include", "frame", "gripper"}  # fmt: skip


_IN_LINK = {
    "pose", "inertial", "gravity", "self_collide", "kinematic", "velocity_decay", "must_be_base_link", "enable_wind"
}  # fmt: skip

_WITHOUT_AXIS = {"fixed", "ball"}


@dataclass
class _Frame:
    """A named frame: its pose, and the name of the frame that the pose counts from."""

    pose: RigidTransform
    relative_to: str
    where: str


@dataclass
class _Scope:
    """A model, flattened or not: prefix of its names and its frames."""

    prefix: str
    version: tuple[int, ...]
    folder: Path
    frames: dict[str, _Frame] = field(default_factory=dict)
    """of the whole model, by full name; the model itself is its prefix without the last ``::``"""


def read_sdf(path: Path, *, packages: Packages) -> SourceModel:
    """An SDF file with one model.

    Raises:
        ModelError: it is no SDF, holds several models or a static one, or something in it makes no sense.
    """
    root, places = parse_xml(path)
    if root.tag != "sdf":
        raise ModelError(f"{places[root]}: <{root.tag}> is no SDF; it should begin with <sdf>")
    model = SourceModel(path.parent.name, files=[path])
    reader = _Reader(model, packages, places)
    element = reader.choose(root, path)
    model.name = element.get("name", "") or model.name
    reader.read(element, _version(root), path.parent)
    return model


def _version(root: ElementTree.Element) -> tuple[int, ...]:
    try:
        return tuple(int(part) for part in root.get("version", "1.6").split("."))
    except ValueError:
        return (1, 6)


class _Reader:
    """Reads one model with all that it includes."""

    def __init__(self, model: SourceModel, packages: Packages, places: dict[ElementTree.Element, str]) -> None:
        self._model, self._packages, self._places = model, packages, places
        self._frames: dict[str, _Frame] = {}
        self._poses: dict[str, RigidTransform] = {}
        self._plugins: list[Plugin] = []
        self._springs: list[ElementTree.Element] = []

    def where(self, element: ElementTree.Element) -> str:
        return self._places.get(element, shown(self._model.files[0]))

    def choose(self, root: ElementTree.Element, path: Path) -> ElementTree.Element:
        """The only model of a file that can move."""
        world = root.find("world")
        models = root.findall("model") if world is None else world.findall("model")
        moving = [model for model in models if (model.findtext("static") or "").strip() not in {"1", "true"}]
        if len(moving) == 1:
            if world is not None:
                why = "the rest of the world is no vehicle"
                what = f"world '{world.get('name', '')}'"
                self._change(world, what, f"{len(list(world))} elements", f"model '{moving[0].get('name', '')}'", why)
            return moving[0]
        if models and not moving:
            names = ", ".join(model.get("name", "") for model in models[:8])
            raise ModelError(f"{self.where(models[0])}: static model '{names}': a prop, not a vehicle")
        names = ", ".join(model.get("name", "") for model in moving[:8]) or "none"
        raise ModelError(f"{shown(path)}:1: one model is expected in the file; there are {len(moving)} ({names})")

    def read(self, element: ElementTree.Element, version: tuple[int, ...], folder: Path) -> None:
        """The model and all in it."""
        self._frames["__model__"] = _Frame(RigidTransform(), "", self.where(element))
        scope = _Scope("", version, folder)
        self._gather(element, scope, 0)
        for link in self._model.links.values():
            self._pose(link.name)
        self._set_joints()
        for plugin in self._plugins:  # which may name links that stand after them
            take_plugin(plugin, "", self._model)
        for spring in self._springs:
            read_spring_damper(spring, self._model, self.where)
        names = {name: self._pose(name) for name in self._model.links}
        self._link_poses = names

    # --- frames ---

    def _pose(self, name: str, trail: tuple[str, ...] = ()) -> RigidTransform:
        """Pose of a frame in the outermost model."""
        if name in self._poses:
            return self._poses[name]
        frame = self._frames.get(name)
        if frame is None or name in trail or len(trail) > 200:
            at = self._frames[trail[-1]].where if trail else shown(self._model.files[0])
            why = "counts from itself" if frame is not None else "does not exist"
            raise ModelError(f"{at}: frame '{name}' {why}")
        below = self._pose(frame.relative_to, (*trail, name)) if frame.relative_to else RigidTransform()
        self._poses[name] = below @ frame.pose
        return self._poses[name]

    def _read_pose(self, element: ElementTree.Element, scope: _Scope, default: str) -> tuple[RigidTransform, str]:
        """Pose of an element, and the full name of the frame that it counts from."""
        pose = element.find("pose")
        if pose is None:
            return RigidTransform(), default
        where = self.where(pose)
        if pose.get("rotation_format", "euler_rpy") == "quat_xyzw":
            values = read_numbers(pose.text, count=7, default=[0, 0, 0, 0, 0, 0, 1], where=where, what="<pose>")
            from pydrake.common.eigen_geometry import Quaternion

            x, y, z, w = values[3:] / (np.linalg.norm(values[3:]) or 1.0)
            X = RigidTransform(Quaternion(w, x, y, z), values[:3])
        else:
            values = read_numbers(pose.text, count=6, default=[0.0] * 6, where=where, what="<pose>")
            angles = np.radians(values[3:]) if pose.get("degrees") in {"1", "true"} else values[3:]
            X = make_pose(values[:3], angles)
        relative = pose.get("relative_to") or (pose.get("frame") if scope.version < (1, 7) else "") or ""
        return X, self._full(relative, scope) if relative else default

    @staticmethod
    def _full(name: str, scope: _Scope) -> str:
        return f"{scope.prefix}{name}"

    # --- gathering ---

    def _gather(self, element: ElementTree.Element, scope: _Scope, depth: int) -> None:
        """Frames, links and joints of a model and of those nested in it."""
        if depth > DEEPEST:
            raise ModelError(f"{self.where(element)}: models are nested more than {DEEPEST} deep")
        origin = f"{scope.prefix}__model__"
        for child in element:
            name, full = child.get("name", ""), self._full(child.get("name", ""), scope)
            if child.tag == "link":
                pose, base = self._read_pose(child, scope, origin)
                self._frame(full, pose, base, child)
                self._model.links[full] = self._link(child, full, scope)
            elif child.tag == "frame":
                attached = child.get("attached_to", "")
                pose, base = self._read_pose(child, scope, self._full(attached, scope) if attached else origin)
                self._frame(full, pose, base, child)
            elif child.tag == "joint":
                self._joint(child, full, scope)
            elif child.tag == "model":
                self._nested(child, name, child, scope, depth, scope.folder, scope.version)
            elif child.tag == "include":
                self._include(child, scope, depth)
            elif child.tag == "plugin":
                self._plugins.append(Plugin(name, child.get("filename", ""), leaves(child), self.where(child)))
            elif child.tag.endswith("linear_spring_damper"):
                self._springs.append(child)
            elif child.tag not in _WITHOUT_EFFECT:
                self._change(child, f"model: <{child.tag}>", "…", "left out", "nothing here corresponds to it")

    def _frame(self, name: str, pose: RigidTransform, base: str, element: ElementTree.Element) -> None:
        if not name or name in self._frames:
            what = "has no name" if not name else "stands here again; names must differ"
            raise ModelError(f"{self.where(element)}: <{element.tag}> '{name}' {what}")
        self._frames[name] = _Frame(pose, base, self.where(element))

    def _nested(
        self,
        element: ElementTree.Element,
        name: str,
        placed: ElementTree.Element,
        scope: _Scope,
        depth: int,
        folder: Path,
        version: tuple[int, ...],
        *,
        merge: bool = False,
    ) -> None:
        """A model inside another one; `placed` has its pose."""
        pose, base = self._read_pose(placed, scope, f"{scope.prefix}__model__")
        if placed is not element and placed.find("pose") is None:
            pose, _ = self._read_pose(element, scope, "")
        inner = _Scope(scope.prefix if merge else f"{scope.prefix}{name}::", version, folder)
        if merge:
            self._change(placed, f"include '{name}'", "merged", "part of the model", "as merge asks")
        else:
            self._frame(f"{inner.prefix}__model__", pose, base, placed)
            self._frames[f"{scope.prefix}{name}"] = _Frame(
                RigidTransform(), f"{inner.prefix}__model__", self.where(placed)
            )
        self._gather(element, inner, depth + 1)

    def _include(self, element: ElementTree.Element, scope: _Scope, depth: int) -> None:
        address = (element.findtext("uri") or "").strip()
        where = self.where(element)
        path, remark = self._packages.resolve(address, folder=scope.folder)
        if path is None and address.startswith(("model://", "package://")):
            inside = self._packages.find(address.partition("://")[2].split("/")[0])
            path = model_file(inside / "/".join(address.partition("://")[2].split("/")[1:])) if inside else None
        elif path is None and (scope.folder / address).is_dir():
            path = model_file(scope.folder / address)
        if path is None:
            raise ModelError(f"{where}: include '{address}': {remark or 'no model there'}")
        if path in self._model.files and depth > DEEPEST:
            raise ModelError(f"{where}: '{address}' includes itself")
        root, places = parse_xml(path)
        self._places |= places
        self._model.files.append(path)
        inner = root.find("model")
        if inner is None:
            raise ModelError(f"{shown(path)}:1: no <model> in the file that {where} includes")
        name = (element.findtext("name") or "").strip() or inner.get("name", "")
        merge = element.get("merge") in {"1", "true"}
        self._nested(inner, name, element, scope, depth, path.parent, _version(root), merge=merge)

    # --- links ---

    def _link(self, element: ElementTree.Element, name: str, scope: _Scope) -> Link:
        where = self.where(element)
        link = Link(name, self._inertial(element.find("inertial"), name, scope), where=where)
        for child in element:
            if child.tag in {"visual", "collision"}:
                shape = self._shape(child, f"link '{name}': {child.tag}", scope)
                if shape is not None:
                    (link.visuals if child.tag == "visual" else link.collisions).append(shape)
                if child.tag == "collision":
                    self._surface(child.find("surface"), link)
            elif child.tag == "sensor":
                self._model.sensors.append(read_sensor(child, name, self.where, self._model))
            elif child.tag not in _IN_LINK:
                self._change(child, f"link '{name}': <{child.tag}>", "…", "left out", "nothing here corresponds to it")
        return link

    def _inertial(self, element: ElementTree.Element | None, name: str, scope: _Scope) -> Inertial | None:
        if element is None:
            return None
        where = self.where(element)
        mass = read_number(element.findtext("mass"), where=where, what=f"link '{name}': mass")
        keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        defaults = {"ixx": 1.0, "iyy": 1.0, "izz": 1.0}
        inertia = element.find("inertia")
        values = []
        for key in keys:
            text = inertia.findtext(key) if inertia is not None else None
            number = read_number(text, where=where, what=f"link '{name}': {key}")
            values.append(defaults.get(key, 0.0) if number is None else number)
        xx, xy, xz, yy, yz, zz = values
        pose, _ = self._read_pose(element, scope, "")
        return Inertial(
            1.0 if mass is None else mass, pose, np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), where
        )

    def _surface(self, element: ElementTree.Element | None, link: Link) -> None:
        if element is None:
            return
        found = {
            "mu": ("friction/ode/mu", "friction/bullet/friction"),
            "mu2": ("friction/ode/mu2", "friction/bullet/friction2"),
            "stiffness": ("contact/ode/kp",),
            "damping": ("contact/ode/kd",),
        }
        link.surface = link.surface or Surface(where=self.where(element))
        for key, paths in found.items():
            for path in paths:
                value = read_number(element.findtext(path), where=self.where(element), what=f"<{path}>")
                if value is not None:
                    setattr(link.surface, key, value)
                    break
        for key in ("min_depth", "max_vel"):
            text = element.findtext(f"contact/ode/{key}")
            if text:
                link.surface.others[key] = text.strip()

    def _shape(self, element: ElementTree.Element, what: str, scope: _Scope) -> Shape | None:
        where, geometry = self.where(element), element.find("geometry")
        inner = next(iter(geometry), None) if geometry is not None else None
        if inner is None or inner.tag == "empty":
            return None

        def size(tag: str, count: int = 1) -> tuple[float, ...]:
            text = inner.findtext(tag)
            if text is None:
                raise ModelError(f"{where}: <{inner.tag}> without <{tag}>")
            return tuple(read_numbers(text, count=count, default=[], where=where, what=f"<{tag}>").tolist())

        shape: Shape | None = None
        if inner.tag == "box":
            shape = Shape("box", size("size", 3))
        elif inner.tag in {"cylinder", "capsule"}:
            shape = Shape(inner.tag, (*size("radius"), *size("length")))
        elif inner.tag == "sphere":
            shape = Shape("sphere", size("radius"))
        elif inner.tag == "ellipsoid":
            shape = Shape("ellipsoid", size("radii", 3))
        elif inner.tag == "plane":
            shape = Shape("plane")
        elif inner.tag == "mesh":
            shape = self._mesh(inner, what, scope, where)
        if shape is None:
            self._change(element, what, f"<{inner.tag}>", "left out", "no such shape is known")
            return None
        shape.X_LG, _ = self._read_pose(element, scope, "")
        shape.where = where
        shape.rgba, shape.texture = self._material(element.find("material"), scope, what)
        return shape

    def _mesh(self, element: ElementTree.Element, what: str, scope: _Scope, where: str) -> Shape:
        address = (element.findtext("uri") or "").strip()
        scale = read_numbers(element.findtext("scale"), count=3, default=[1.0] * 3, where=where, what="<scale>")
        path, remark = self._packages.resolve(address, folder=scope.folder)
        if remark:
            became = "left out" if path is None else path.name
            self._model.changes.append(Change(where, f"{what} mesh", address, became, remark))
        submesh = (element.findtext("submesh/name") or "").strip()
        center = (element.findtext("submesh/center") or "").strip() in {"1", "true"}
        a, b, c = scale.tolist()
        return Shape("mesh", mesh=path, address=address, scale=(a, b, c), submesh=submesh, center=center)

    def _material(
        self, element: ElementTree.Element | None, scope: _Scope, what: str
    ) -> tuple[tuple[float, float, float, float] | None, Path | None]:
        if element is None:
            return None, None
        script = (element.findtext("script/name") or "").strip()
        rgba, texture = colour_of(script), None
        for key in ("diffuse", "ambient"):
            text = element.findtext(key)
            if text:
                values = [float(word) for word in text.split()] if _all_numbers(text) else []
                if len(values) in (3, 4):
                    a, b, c, d = (*values, 1.0)[:4]
                    rgba = (a, b, c, d)
                    break
        address = (element.findtext("pbr/metal/albedo_map") or "").strip()
        if address:
            texture, remark = self._packages.resolve(address, folder=scope.folder)
            if remark:
                self._change(
                    element, f"{what} texture", address, "left out" if texture is None else texture.name, remark
                )
        if script and rgba is None and texture is None:
            self._change(element, f"{what} material", script, "left out", SCRIPT)
        return rgba, texture

    # --- joints ---

    def _joint(self, element: ElementTree.Element, name: str, scope: _Scope) -> None:
        where, kind = self.where(element), element.get("type", "").strip().lower()
        if name in self._model.joints:
            raise ModelError(f"{where}: joint '{name}' stands here again; names must differ")
        parent, child = (self._end(element, tag) for tag in ("parent", "child"))
        pose, base = self._read_pose(element, scope, self._full(child, scope))
        self._frame(name, pose, base, element)
        above = "world" if parent == "world" else self._full(parent, scope)
        joint = Joint(name, kind, above, self._full(child, scope), where=where)
        for number, tag in enumerate(("axis", "axis2")):
            axis = element.find(tag)
            if axis is None:
                continue
            vector = read_numbers(axis.findtext("xyz"), count=3, default=[0, 0, 1], where=where, what=f"<{tag}> xyz")
            if not vector.any() and kind not in _WITHOUT_AXIS:
                raise ModelError(f"{where}: joint '{name}': its axis has no direction")
            xyz = axis.find("xyz")
            frame = (xyz.get("expressed_in") or "") if xyz is not None else ""
            old = (axis.findtext("use_parent_model_frame") or "").strip() in {"1", "true"} or scope.version < (1, 5)
            joint.others[f"{tag} frame"] = (
                self._full(frame, scope) if frame else f"{scope.prefix}__model__" if old else ""
            )
            limits = self._limits(axis.find("limit"), name, where)
            dynamics = axis.find("dynamics")
            if number == 0:
                joint.axis, joint.limits = vector, limits
                if dynamics is not None:
                    damping, friction, stiffness = (
                        read_number(dynamics.findtext(key), where=where, what=f"joint '{name}': {key}")
                        for key in ("damping", "friction", "spring_stiffness")
                    )
                    joint.damping, joint.friction, joint.stiffness = damping or 0.0, friction or 0.0, stiffness or None
            else:
                joint.axis2, joint.limits2 = vector, limits
        self._model.joints[name] = joint

    def _end(self, element: ElementTree.Element, tag: str) -> str:
        """Name of the parent or child link as written."""
        end = element.find(tag)
        text = (end.text or "").strip() if end is not None else ""
        return text or ((end.findtext("link_name") or "").strip() if end is not None else "")

    def _limits(self, element: ElementTree.Element | None, name: str, where: str) -> Limits:
        if element is None:
            return Limits()
        return Limits(
            *(
                read_number(element.findtext(key), where=where, what=f"joint '{name}': {key}")
                for key in ("lower", "upper", "effort", "velocity")
            )
        )

    def _set_joints(self) -> None:
        """Poses of the joints in their links, and axes in the joint frames, now that all frames are known."""
        for name, joint in list(self._model.joints.items()):
            for end in (joint.parent, joint.child):
                if end != "world" and end not in self._model.links:
                    link = self._attached_link(end)
                    if link is None:
                        raise ModelError(f"{joint.where}: joint '{name}': link '{end}' does not exist")
                    if end == joint.parent:
                        joint.parent = link
                    if end == joint.child:
                        joint.child = link
            if joint.parent == "world":
                why = "a vehicle is not fixed to the ground"
                self._model.changes.append(Change(joint.where, f"joint '{name}'", "to the world", "left out", why))
                del self._model.joints[name]
                continue
            X_MJ = self._pose(name)
            joint.X_PJ = self._pose(joint.parent).inverse() @ X_MJ
            joint.X_JC = X_MJ.inverse() @ self._pose(joint.child)
            for tag in ("axis", "axis2"):
                frame = joint.others.pop(f"{tag} frame", "")
                vector = joint.axis if tag == "axis" else joint.axis2
                if frame and vector is not None:
                    vector = (X_MJ.inverse() @ self._pose(frame)).rotation().multiply(vector)
                    if tag == "axis":
                        joint.axis = vector
                    else:
                        joint.axis2 = vector

    def _attached_link(self, name: str) -> str | None:
        """The link that a frame or model stands for."""
        for _ in range(DEEPEST):
            if name in self._model.links:
                return name
            frame = self._frames.get(name)
            if frame is None:
                return None
            inside = [link for link in self._model.links if link.startswith(f"{name}::")]
            if inside:
                return inside[0]
            name = frame.relative_to
        return None

    def _change(self, element: ElementTree.Element, what: str, was: str, became: str, why: str) -> None:
        self._model.changes.append(Change(self.where(element), what, was, became, why))


def model_file(folder: Path) -> Path | None:
    """The SDF file of a Gazebo model's folder: of the newest version that its model.config names."""
    config = folder / "model.config"
    if config.is_file():
        root, _ = parse_xml(config)
        named: dict[tuple[int, ...], Path] = {}
        for entry in root.findall("sdf"):
            try:
                version = tuple(int(part) for part in entry.get("version", "1.0").split("."))
            except ValueError:
                version = (0,)
            named[version] = folder / (entry.text or "").strip()
        files = [path for _, path in sorted(named.items(), reverse=True) if path.is_file()]
        if files:
            return files[0]
    return folder / "model.sdf" if (folder / "model.sdf").is_file() else None


def _all_numbers(text: str) -> bool:
    try:
        return all(np.isfinite(float(word)) for word in text.split())
    except ValueError:
        return False
