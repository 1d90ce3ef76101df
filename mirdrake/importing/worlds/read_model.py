"""SDF models with everything that they include: all frames, links and shapes are read first and placed later.

Poses follow the rules of :mod:`mirdrake.importing.sdf.frames`. Static models nested in static ones become separate
objects; the parts of a model that can move stay together.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.etree import ElementTree

from pydrake.math import RigidTransform

from mirdrake.core.errors import ModelError
from mirdrake.core.yaml_io import display_path
from mirdrake.importing.changes import Changes, Code
from mirdrake.importing.gazebo_xml import XmlFiles
from mirdrake.importing.sdf.elements import (
    DEEPEST,
    is_true,
    read_colour,
    read_frame,
    read_mu,
    read_placement,
    read_pose,
    read_shape,
    text_of,
    version_of,
)
from mirdrake.importing.sdf.frames import Frames, Scope
from mirdrake.importing.sdf.search import Models, model_name
from mirdrake.importing.shape import Shape
from mirdrake.importing.values import read_number
from mirdrake.importing.worlds.model import SourceObject

Element = ElementTree.Element

MOST = 50_000
"""Models and links of a world, with all that they include."""

_TURNING = {"revolute", "continuous", "revolute2", "universal"}
_SILENT = {"pose", "inertial", "static", "link", "model", "include", "frame", "visual", "collision", "self_collide",
           "allow_auto_disable", "enable_wind", "gravity", "kinematic", "velocity_decay", "must_be_base_link",
           "joint", "light", "script", "audio_source"}  # fmt: skip


@dataclass
class _Placed:
    """A shape, not yet placed."""

    shape: Shape
    X: RigidTransform
    base: str
    link: str


@dataclass
class Draft:
    """An object whose frames are known by name only."""

    obj: SourceObject
    frame: str
    links: list[str] = field(default_factory=list)
    visuals: list[_Placed] = field(default_factory=list)
    collisions: list[_Placed] = field(default_factory=list)


class ModelReader:
    """Reads models.

    Args:
        models: find included models.
        tree: give the places.
        frames: collect all frames.
        changes: get every change.
        files: collect all files that are read.
    """

    def __init__(self, models: Models, tree: XmlFiles, frames: Frames, changes: Changes, files: list[Path]) -> None:
        self._models, self._tree, self._frames, self._changes, self._files = models, tree, frames, changes, files
        self._parsed: dict[Path, Element] = {}
        self._count = 0
        self.drafts: list[Draft] = []
        self.lights: list[tuple[Element, str]] = []
        """lights of included files and the frames of their poses"""

    # --- models and includes ---

    def model(
        self,
        element: Element,
        scope: Scope,
        *,
        name: str = "",
        placed: Element | None = None,
        draft: Draft | None = None,
    ) -> None:
        """Read a ``<model>``.

        Args:
            element: its ``<model>``.
            scope: scope that contains it.
            name: instead of its own.
            placed: an ``<include>`` whose pose and ``static`` take precedence.
            draft: the moving object that it is part of; None for one of its own.
        """
        where = self._tree.where(placed if placed is not None else element)
        self._one_more(where)
        kind = element.get("name", "") or "model"
        full = self._new_name(scope.full(name or kind), where)
        self._frames.add(full, read_placement(element, placed, full, scope, self._tree))
        # An <include> may override whether its model is static.
        still = element.find("static") if placed is None or placed.find("static") is None else placed.find("static")
        static = is_true(still.text or "") if still is not None else False
        if draft is None:
            draft = Draft(SourceObject(full, kind, RigidTransform(), static, where=where), full)
            self.drafts.append(draft)
        inner = Scope(f"{full}::", full, scope.version, scope.folder, scope.files)
        try:
            # A fault in one model ends the reading of this model only.
            self._inside(element, inner, draft)
        except ModelError as error:
            draft.obj.broken.append(error)
            became = "left out with all its following elements"
            self._changes.add_fault(Code.MODEL, error, f"model '{draft.obj.name}': a part of it", "…", became)

    def include(self, element: Element, scope: Scope, *, draft: Draft | None = None) -> None:
        """Read an ``<include>``; see :meth:`model`."""
        where, address = self._tree.where(element), text_of(element, "uri")
        kind = model_name(address)
        name = text_of(element, "name")
        path, remark = self._models.find_model(address, scope.folder)
        if path is not None and (path in scope.files or len(scope.files) > DEEPEST):
            raise ModelError(f"include '{address}' includes itself", where=where)
        if path is None:
            self._absent(element, scope, name or kind or "include", kind, where, remark)
            return
        root = self._parse(path)
        version = version_of(root)
        inside = Scope(scope.prefix, scope.origin, version, path.parent, (*scope.files, path))
        # Files may contain lights beside or instead of a model, such as model://sun.
        model = root if root.tag == "model" else root.find("model")
        for light in root.findall("light"):
            frame = self._new_name(scope.full(name or light.get("name", "light")), where)
            self._frames.add(frame, read_placement(light, element, frame, inside, self._tree))
            self.lights.append((light, frame))
        if model is None:
            if root.find("light") is None:
                raise ModelError(f"no <model> in the file that {where} includes", where=f"{display_path(path)}:1")
            return
        # The links become those of the including model, in a hidden frame for their poses.
        if is_true(element.get("merge", "")) and draft is not None:
            frame = self._new_name(scope.full(f"__merged__{model.get('name', '')}"), where)
            self._frames.add(frame, read_placement(model, element, frame, inside, self._tree))
            self._inside(model, replace(inside, origin=frame), draft)
            return
        before = len(self.drafts)
        self.model(model, inside, name=name, placed=element, draft=draft)
        # The address, and not the name inside of the file, is what known models are found by.
        if draft is None:
            self.drafts[before].obj.kind = kind or self.drafts[before].obj.kind

    def _absent(self, element: Element, scope: Scope, name: str, kind: str, where: str, remark: str) -> None:
        self._one_more(where)
        full = self._new_name(scope.full(name), where)
        self._frames.add(full, read_placement(element, element, full, scope, self._tree))
        static = element.find("static")
        obj = SourceObject(
            full, kind, RigidTransform(), is_true(static.text or "") if static is not None else True, where=where
        )
        obj.absent, obj.sources = True, [kind] if kind else []
        obj.broken = [ModelError(f"include '{text_of(element, 'uri')}': {remark}", where=where)]
        self.drafts.append(Draft(obj, full))

    def _parse(self, path: Path) -> Element:
        if path not in self._parsed:
            self._parsed[path] = self._tree.parse(path)
            self._files.append(path)
        return self._parsed[path]

    def _new_name(self, wanted: str, where: str) -> str:
        """Return a name that is not used; a repeated model name gets a number, as in Gazebo."""
        name, number = wanted, 0
        while name in self._frames:
            name, number = f"{wanted}_{number}", number + 1
        if name != wanted:
            why = "the name is used already"
            self._changes.add(Code.MODEL, where, "name of a model", wanted, name, why)
        return name

    def _one_more(self, where: str) -> None:
        self._count += 1
        if self._count > MOST:
            raise ModelError(
                f"more than {MOST} models and links; does something include itself many times?", where=where
            )

    # --- contents of a model ---

    def _inside(self, element: Element, scope: Scope, draft: Draft) -> None:
        for child in element:
            where, name = self._tree.where(child), child.get("name", "")
            if child.tag == "link":
                self._link(child, scope, draft)
            elif child.tag == "frame":
                base = scope.base(child.get("attached_to", ""))
                self._frames.add(scope.full(name), read_frame(child, self._tree, scope, default=base))
            elif child.tag in {"model", "include"}:
                # Models that include each other would recurse without end.
                if len(scope.prefix.split("::")) > DEEPEST:
                    raise ModelError(f"models are nested more than {DEEPEST} deep", where=where)
                # Parts of a moving model move with it as one object; those of a static one are static objects.
                apart = None if draft.obj.static else draft
                first = len(self.drafts)
                (self.model if child.tag == "model" else self.include)(child, scope, draft=apart)
                for inner in self.drafts[first:]:
                    # The whole moves as one prop; an inner part that moved by itself would collide with the rest.
                    inner.obj.static = True
            elif child.tag == "joint":
                self._joint(child, scope, draft)
            elif child.tag == "plugin":
                part = f"model '{draft.obj.name}': <plugin>"
                self._changes.add(
                    Code.SHAPE, where, part, child.get("filename", ""), None, "Gazebo plugins are not executed"
                )
            elif child.tag not in _SILENT:
                part = f"model '{draft.obj.name}': <{child.tag}>"
                self._changes.add(Code.SHAPE, where, part, "…", None, "it has no counterpart in mirdrake")

    def _joint(self, element: Element, scope: Scope, draft: Draft) -> None:
        kind = element.get("type", "").strip().lower()
        name, child, parent = element.get("name", ""), text_of(element, "child"), text_of(element, "parent")
        # Joints that move are counted: several turning ones make the object a vehicle.
        if kind != "fixed":
            draft.obj.loose += 1
            draft.obj.wheels += kind in _TURNING
        # A joint to the world fixes the whole object.
        elif parent == "world" and not draft.obj.static:
            draft.obj.static = True
        frame = read_frame(element, self._tree, scope, default=scope.full(child))
        if name and scope.full(name) not in self._frames:
            self._frames.add(scope.full(name), frame)

    def _link(self, element: Element, scope: Scope, draft: Draft) -> None:
        where, obj = self._tree.where(element), draft.obj
        self._one_more(where)
        full = scope.full(element.get("name", "link"))
        self._frames.add(full, read_frame(element, self._tree, scope))
        draft.links.append(full)
        # A kinematic link is moved by a plugin, which is not executed.
        if not obj.static and text_of(element, "kinematic") in {"1", "true"}:
            obj.static = True
            self._changes.add(
                Code.MODEL, where, f"model '{obj.name}'", "kinematic", "static", "it cannot move in mirdrake"
            )
        mass = read_number(element.findtext("inertial/mass"), where=where, what="<mass>")
        if mass is not None:
            # A prop is one rigid body, so its links' masses add up.
            obj.mass = (obj.mass or 0.0) + mass
        # A faulty collision shape makes the model faulty, since cars would pass through it; a visual does not.
        for child in element:
            if child.tag in {"visual", "collision"}:
                try:
                    self._shape(child, scope, full, draft)
                except ModelError as error:
                    if child.tag == "collision":
                        obj.broken.append(error)
                    part = f"model '{obj.name}': {child.tag}"
                    self._changes.add_fault(Code.SHAPE, error, part, child.get("name", ""))
            elif child.tag == "light":
                part, why = f"model '{obj.name}': <light>", "only the sun is supported"
                self._changes.add(Code.LIGHT, self._tree.where(child), part, child.get("name", ""), None, why)
            elif child.tag == "sensor":
                part, why = f"model '{obj.name}': <sensor>", "a prop has no sensors"
                self._changes.add(Code.SENSOR, self._tree.where(child), part, child.get("name", ""), None, why)
            elif child.tag not in _SILENT:
                part = f"model '{obj.name}': <{child.tag}>"
                self._changes.add(
                    Code.SHAPE, self._tree.where(child), part, "…", None, "it has no counterpart in mirdrake"
                )

    def _shape(self, element: Element, scope: Scope, link: str, draft: Draft) -> None:
        where, obj = self._tree.where(element), draft.obj
        part = f"model '{obj.name}': {element.tag}"
        X, relative = read_pose(element.find("pose"), self._tree, scope.version)
        # Plugins of shapes are visual effects and cannot change the contact.
        for plugin in element.findall("plugin"):
            where_plugin, file = self._tree.where(plugin), plugin.get("filename", "")
            self._changes.add(
                Code.PLUGIN, where_plugin, f"{part}: <plugin>", file, None, "Gazebo plugins are not executed"
            )
        read = read_shape(element, self._tree, self._models, scope.folder, check_sizes=True)
        shape, remark = read.shape, read.remark
        if shape is None:
            if remark:
                self._changes.add(Code.SHAPE, where, part, element.get("name", ""), None, remark)
            if remark and element.tag == "collision":
                obj.broken.append(ModelError(f"{part}: {remark}", where=where))
            return
        shape.where = where
        if element.tag == "visual":
            shape.rgba = read_colour(element.find("material"))
            address = text_of(element, "material/pbr/metal/albedo_map")
            if address:
                shape.texture, _ = self._models.resolve(address, folder=scope.folder)
            shape.submesh = shape.submesh or ""
            # The name of a material is a hint at the kind of surface.
            shape = replace(shape, address=shape.address or text_of(element, "material/script/name"))
        else:
            # The most slippery shape of a model counts, since a prop has one coefficient.
            mu = read_mu(element, self._tree)
            if mu is not None:
                obj.mu = mu if obj.mu is None else min(obj.mu, mu)
        # A missing mesh may be replaced by a prop of known size, so its report waits until then.
        if shape.kind == "mesh" and shape.mesh is None:
            obj.sources.append(model_name(shape.address))
            if element.tag == "collision":
                obj.broken.append(ModelError(f"{part}: mesh '{shape.address}': {remark}", where=where))
            obj.missing.add(Code.MESH, where, f"{part} mesh", shape.address, None, remark)
            return
        if remark:
            became = shape.mesh.name if shape.mesh is not None else shape.kind
            self._changes.add(Code.MODEL, where, part, shape.address or element.get("name", ""), became, remark)
        placed = _Placed(shape, X, scope.full(relative) if relative else link, link)
        (draft.visuals if element.tag == "visual" else draft.collisions).append(placed)
