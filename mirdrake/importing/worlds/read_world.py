"""World files of Gazebo classic and Gazebo into a :class:`SourceWorld`.

A saved world has a ``<state>``, whose poses take precedence. Elements without counterpart become changes. A model with
faults is kept with its faults, so that the caller can report all of them.
"""

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import shapely
from pydrake.math import RigidTransform, RotationMatrix

from mirdrake.core.errors import ModelError
from mirdrake.importing.changes import Code
from mirdrake.importing.gazebo_xml import XmlFiles
from mirdrake.importing.sdf.elements import read_frame, read_pose, text_of, version_of
from mirdrake.importing.sdf.frames import WORLD, Frames, Scope
from mirdrake.importing.sdf.search import Models, model_name
from mirdrake.importing.shape import Shape
from mirdrake.importing.values import read_number, read_numbers
from mirdrake.importing.worlds.known import plain_name
from mirdrake.importing.worlds.model import Array, Plane, Road, SourceObject, SourceWorld, Sun
from mirdrake.importing.worlds.read_crowd import read_crowd
from mirdrake.importing.worlds.read_model import Draft, ModelReader

Element = ElementTree.Element

SUN = np.array([-0.5, 0.1, -0.9])
"""Direction of the light that ``model://sun`` is."""

_WHY = {
    "physics": "mirdrake has its own solver and time step", "gui": "mirdrake has its own viewer",
    "scene": "mirdrake has its own sky and ambient light",
    "spherical_coordinates": "worlds have no geographic position",
    "magnetic_field": "mirdrake has no magnetic sensor", "atmosphere": "mirdrake has its own air density",
    "audio": "sound is not supported", "wind": "worlds have no wind", "plugin": "Gazebo plugins are not executed",
    "joint": "objects of a world have no joints",
}  # fmt: skip
_PLANES = {"ground_plane", "asphalt_plane", "grass_plane", "mud_plane", "plane"}


def read_world(path: Path, *, models: Models) -> SourceWorld:
    """Read a world file.

    Raises:
        ModelError: the file cannot be read, is not XML, or contains no world.
    """
    tree = XmlFiles()
    root = tree.parse(path)
    # Files without <sdf> exist from the time before SDF 1.0.
    worlds = root.findall("world") if root.tag in {"sdf", "gazebo"} else [root] if root.tag == "world" else []
    if not worlds:
        models_in = root.findall("model")
        hint = "it contains a model; use mirdrake import vehicle for vehicles" if models_in else (
            "<world> inside <sdf> is expected"
        )  # fmt: skip
        raise ModelError(f"<{root.tag}> contains no world; {hint}", where=tree.where(root))
    version = version_of(root)
    if version < (1, 2):
        raise ModelError(f"SDF {root.get('version')} is too old; convert it with gz sdf -c", where=tree.where(root))
    # xacro elements would be dropped like unknown elements, and the world would be almost empty.
    for element in worlds[0]:
        if "xacro" in element.tag:
            raise ModelError(
                f"<{element.tag}> is xacro; render the file first: xacro FILE > OUT", where=tree.where(element)
            )
    name = worlds[0].get("name", "")
    world = SourceWorld(path.stem if name in {"", "default", "world", "default_world"} else name, files=[path])
    for extra in worlds[1:]:
        why = "only the first world of a file is read"
        world.changes.add(
            Code.ELEMENT, tree.where(extra), f"world '{extra.get('name', '')}'", "a second world", None, why
        )
    _Reader(world, models, tree, Scope("", WORLD, version, path.parent, (path,))).read(worlds[0])
    return world


class _Reader:
    """Reads one world."""

    def __init__(self, world: SourceWorld, models: Models, tree: XmlFiles, scope: Scope) -> None:
        self._world, self._tree, self._scope = world, tree, scope
        self._frames = Frames()
        self._models = ModelReader(models, tree, self._frames, world.changes, world.files)
        self._scales: dict[str, tuple[float, float, float]] = {}
        self._gone: set[str] = set()
        self._lights: list[tuple[Element, str]] = []
        self._crowds: list[tuple[Element, range]] = []

    def read(self, element: Element) -> None:
        # The state refers to models by name, so it is read after all of them.
        states = []
        for child in element:
            if child.tag == "state":
                states.append(child)
                for inserted in child.iterfind("insertions/*"):
                    self._child(inserted)
            else:
                self._child(child)
        # The saved state overrides poses and deletes models, hence after all children.
        for state in states:
            self._state(state)
        for light, frame in [*self._lights, *self._models.lights]:
            self._light(light, frame)
        # Poses are known once all frames are read.
        objects = [self._finish(draft) for draft in self._models.drafts]
        copies = {index for _, indices in self._crowds for index in indices}
        for crowd, indices in self._crowds:  # a model may hold nothing but an include
            copied = [objects[index] for index in indices]
            self._crowd(crowd, next((obj for obj in copied if obj.collisions or obj.absent), copied[0]))
        # A model of nothing but models is a name for them.
        groups = {obj.name.rpartition("::")[0] for obj in objects}
        for index, (obj, draft) in enumerate(zip(objects, self._models.drafts, strict=True)):
            if index in copies or (obj.name in groups and not draft.links and not obj.broken):
                continue
            if obj.name in self._gone:
                why = "the saved state deletes it"
                self._world.changes.add(Code.MODEL, obj.where, f"model '{obj.name}'", "deleted in <state>", None, why)
            elif not self._planes(obj):
                self._world.objects.append(obj)

    def _child(self, child: Element) -> None:
        where = self._tree.where(child)
        try:
            self._known_child(child, where)
        except ModelError as error:
            # A faulty object is kept with its fault, so that a strict import rejects the world.
            if child.tag in {"model", "include", "population"}:
                name = child.get("name", "") or text_of(child, "name") or model_name(text_of(child, "uri"))
                self._world.objects.append(
                    SourceObject(
                        name or child.tag, name or child.tag, RigidTransform(), True, broken=[error], where=where
                    )
                )
            else:
                self._world.changes.add_fault(Code.ELEMENT, error, f"<{child.tag}>", child.get("name", ""))

    def _known_child(self, child: Element, where: str) -> None:
        tag, name = child.tag, child.get("name", "")
        if tag == "model":
            self._models.model(child, self._scope)
        elif tag == "include":
            kind = plain_name(model_name(text_of(child, "uri")))
            before, lights = len(self._models.drafts), len(self._models.lights)
            self._models.include(child, self._scope)
            # The number of drafts before and after shows what the include added: none if it was a light, several if
            # nested.
            added = self._models.drafts[before:]
            # model://sun is a light; without its files it has the direction of Gazebo's.
            if kind == "sun" and added and added[0].obj.absent:
                self._models.drafts.pop()
                X = self._frames.pose(added[0].frame)
                self._world.suns.append(Sun("sun", X.rotation().multiply(SUN), where))
            elif kind == "sun" and not added and len(self._models.lights) == lights:
                self._world.suns.append(Sun("sun", SUN, where))
        elif tag == "frame":
            base = self._scope.base(child.get("attached_to", ""))
            self._frames.add(self._scope.full(name), read_frame(child, self._tree, self._scope, default=base))
        elif tag == "light":
            # Lights get a hidden frame, because their poses may refer to frames that follow.
            frame = f"__light__{len(self._lights)}"
            self._frames.add(frame, read_frame(child, self._tree, self._scope))
            self._lights.append((child, frame))
        elif tag == "actor":
            self._actor(child, where)
        elif tag == "road":
            self._road(child, where)
        elif tag == "population":
            inner = child.find("model") if child.find("model") is not None else child.find("include")
            if inner is None:
                raise ModelError("<population> without a <model>", where=where)
            before = len(self._models.drafts)
            # A population repeats its model, whose drafts are marked here and not placed themselves.
            (self._models.model if inner.tag == "model" else self._models.include)(inner, self._scope)
            self._crowds.append((child, range(before, len(self._models.drafts))))
        elif tag == "gravity" or (tag == "physics" and child.find("gravity") is not None):
            self._gravity(child if tag == "gravity" else child.find("gravity"), where)
            if tag == "physics":
                self._world.changes.add(Code.ELEMENT, where, "<physics>", name, None, _WHY["physics"])
        else:
            was = child.get("filename", "") or name or child.get("type", "")
            self._world.changes.add(
                Code.ELEMENT, where, f"<{tag}>", was, None, _WHY.get(tag, "it has no counterpart in mirdrake")
            )

    def _gravity(self, element: Element | None, where: str) -> None:
        text = element.text if element is not None else None
        value = read_numbers(text, count=3, default=[0, 0, -9.81], where=where, what="<gravity>")
        # The tolerance includes 9.8 m/s², the default of SDF.
        if not np.allclose(value, [0.0, 0.0, -9.81], atol=0.03):
            was = " ".join(f"{part:g}" for part in value)
            self._world.changes.add(
                Code.ELEMENT, where, "<gravity>", f"{was} m/s²", "9.81 m/s² downwards", "gravity is fixed in mirdrake"
            )

    def _actor(self, child: Element, where: str) -> None:
        pose = child.find("pose")
        waypoint = child.find("script/trajectory/waypoint/pose")
        X, _ = read_pose(pose if pose is not None else waypoint, self._tree, self._scope.version)
        kind = model_name(text_of(child, "include/uri")) or "person_standing"
        self._world.actors.append((child.get("name", "") or "actor", kind, X, where))

    def _road(self, child: Element, where: str) -> None:
        points = [
            read_numbers(point.text, count=3, default=[0, 0, 0], where=self._tree.where(point), what="<point>")
            for point in child.findall("point")
        ]
        width = read_number(child.findtext("width"), where=where, what="<width>")
        width = 1.0 if width is None else width
        if len(points) < 2 or not 0.01 <= width <= 1000.0:
            raise ModelError("<road> needs two points and a width above 1 cm", where=where)
        words = f"{child.get('name', '')} {text_of(child, 'material/script/name')}"
        self._world.roads.append(Road(child.get("name", "") or "road", np.array(points), width, words, where))

    # --- state ---

    def _state(self, state: Element) -> None:
        # <state> is what the simulator saved when the world was last open; it overrides the poses of the models.
        for name in state.iterfind("deletions/name"):
            self._gone.add((name.text or "").strip())
        moved = 0
        for child in state.findall("model"):
            # A model with a fault stays at its own pose, and the others are moved all the same.
            try:
                moved += self._state_of(child, "")
            except ModelError as error:
                self._world.changes.add_fault(Code.MODEL, error, "<state> of a model", child.get("name", ""))
        why = "the poses of the saved state are used"
        became = f"{moved} moved"
        self._world.changes.add(
            Code.ELEMENT, self._tree.where(state), "<state>", f"{len(state.findall('model'))} models", became, why
        )

    def _state_of(self, element: Element, prefix: str, depth: int = 0) -> int:
        """Read the poses of a model, its nested models and links; return the number of models that moved."""
        name = f"{prefix}{element.get('name', '')}"
        if name not in self._frames or name == WORLD or depth > 20:
            return 0
        pose, moved = element.find("pose"), 0
        # The state has world poses of models and links, so that only those that differ are taken.
        if pose is not None:
            X, _ = read_pose(pose, self._tree, self._scope.version)
            moved += _differ(self._frames.pose(name), X)
            self._frames.set(name, X)
        scale = element.find("scale")
        if scale is not None:
            where = self._tree.where(scale)
            a, b, c = read_numbers(scale.text, count=3, default=[1, 1, 1], where=where, what="<scale>").tolist()
            if not all(1e-3 <= factor <= 1e3 for factor in (a, b, c)):
                raise ModelError(f"<scale> {a:g} {b:g} {c:g} leaves nothing of the model", where=where)
            if (a, b, c) != (1.0, 1.0, 1.0):
                self._scales[name] = (a, b, c)
                # Scaled props need their shapes scaled, which happens when the model is finished.
                why = "scale of the saved state"
                self._world.changes.add(
                    Code.MODEL, where, f"model '{name}': scale", f"{a:g} {b:g} {c:g}", "applied to its shapes", why
                )
        for child in element:
            inner = f"{name}::{child.get('name', '')}"
            if child.tag == "model":
                moved += self._state_of(child, f"{name}::", depth + 1)
            elif child.tag == "link" and inner in self._frames and child.find("pose") is not None:
                X, _ = read_pose(child.find("pose"), self._tree, self._scope.version)
                if _differ(self._frames.pose(inner), X):
                    self._frames.set(inner, X)
        return moved

    # --- finishing ---

    def _finish(self, draft: Draft) -> SourceObject:
        """Return an object with its pose and those of its shapes."""
        obj = draft.obj
        # Frames are resolved only now: a pose may be relative to a frame that the file defines further down.
        try:
            obj.X_WM = self._frames.pose(draft.frame)
            X_MW = obj.X_WM.inverse()
            scale = self._scales.get(draft.frame, (1.0, 1.0, 1.0))
            for placed, shapes in ((draft.visuals, obj.visuals), (draft.collisions, obj.collisions)):
                for part in placed:
                    X_MG = X_MW @ self._frames.pose(part.base, where=part.shape.where) @ part.X
                    shapes.append(_scaled(replace(part.shape, X_LG=X_MG), scale, X_MW, self._frames.pose(part.link)))
        except ModelError as error:
            # One broken pose makes the whole object unusable, as parts at wrong places would mislead more than none.
            obj.broken.append(error)
            obj.visuals, obj.collisions = [], []
        return obj

    def _planes(self, obj: SourceObject) -> bool:
        """Remove the planes from an object; return whether it consists of planes only."""
        if obj.absent and plain_name(obj.kind) in _PLANES:
            size = (20.0, 20.0) if plain_name(obj.kind) == "asphalt_plane" else (100.0, 100.0)
            self._world.planes.append(Plane(obj.name, obj.X_WM, size, None, obj.kind, obj.where))
            return True
        planes = [shape for shape in obj.collisions if shape.kind == "plane"]
        seen = [shape for shape in obj.visuals if shape.kind == "plane"]
        if not planes:
            return False
        words = " ".join([obj.name, obj.kind, *(shape.address for shape in seen)])
        for shape in planes:
            sizes = [other.size for other in (*seen, shape) if len(other.size) == 2 and min(other.size) > 0.0]
            edges = (sizes[0][0], sizes[0][1]) if sizes else None
            # z of the plane's frame is along its normal, which a plane shape has in `scale`.
            X_WP = obj.X_WM @ shape.X_LG @ RigidTransform(_onto(np.array(shape.scale)), np.zeros(3))
            self._world.planes.append(Plane(obj.name, X_WP, edges, obj.mu, words, shape.where))
        obj.collisions = [shape for shape in obj.collisions if shape.kind != "plane"]
        obj.visuals = [shape for shape in obj.visuals if shape.kind != "plane"]
        # What it shows besides its planes is drawn, like that of any other object without collision shapes.
        return not obj.collisions and not obj.visuals

    def _light(self, element: Element, frame: str) -> None:
        where, name = self._tree.where(element), element.get("name", "")
        kind = element.get("type", "directional" if element.find("direction") is not None else "point")
        try:
            # Worlds have a sun, which is a directional light, and no other lights.
            if kind != "directional":
                raise ModelError("only the sun is supported", where=where)
            text = element.findtext("direction")
            direction = read_numbers(text, count=3, default=[0, 0, -1], where=where, what="<direction>")
            # The direction is given in the frame of the light, not of the world.
            X = self._frames.pose(frame)
        except ModelError as error:
            self._world.changes.add_fault(Code.LIGHT, error, f"{kind} light '{name}'", "…")
            return
        self._world.suns.append(Sun(name, X.rotation().multiply(direction), where))

    def _crowd(self, element: Element, obj: SourceObject) -> None:
        where, name = self._tree.where(element), element.get("name", "") or obj.name
        try:
            crowd = read_crowd(element, obj, name, where, self._tree, self._scope.version)
        except ModelError as error:
            obj.broken.append(error)
            obj.visuals, obj.collisions = [], []
            self._world.objects.append(obj)
            return
        self._world.crowds.append(crowd)


def _differ(X: RigidTransform, Y: RigidTransform) -> bool:
    """Return whether two poses differ by more than 0.1 mm or 1e-4 rad."""
    return not X.IsNearlyEqualTo(Y, 1e-4)


def _onto(normal: Array) -> RotationMatrix:
    """Return the smallest rotation of the z axis onto a direction."""
    n = normal / np.linalg.norm(normal)
    # Half a turn about x; the formula below would divide by zero.
    if n[2] < -1.0 + 1e-12:
        return RotationMatrix(np.diag([1.0, -1.0, -1.0]))
    # Rodrigues' formula for the rotation about z x n, with K as the matrix of the cross product.
    v = np.cross([0.0, 0.0, 1.0], n)
    K = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    return RotationMatrix(np.eye(3) + K + K @ K / (1.0 + n[2]))


def _scaled(shape: Shape, scale: tuple[float, float, float], X_MW: RigidTransform, X_WL: RigidTransform) -> Shape:
    """Return a shape scaled along the axes of its link as by Gazebo; round shapes along their own axes."""
    if scale == (1.0, 1.0, 1.0):
        return shape
    # Gazebo scales along the axes of the link, so that the pose is scaled there and not in the model.
    X_ML = X_MW @ X_WL
    X_LG = X_ML.inverse() @ shape.X_LG
    x, y, z = scale
    size = shape.size
    if shape.kind == "box":
        size = (size[0] * x, size[1] * y, size[2] * z)
    elif shape.kind in {"cylinder", "capsule"}:
        size = (size[0] * max(x, y), size[1] * z)
    elif shape.kind == "sphere":
        size = (size[0] * max(scale),)
    moved = RigidTransform(X_LG.rotation(), np.array(scale) * X_LG.translation())
    outline = shape.submesh
    if shape.kind == "polyline":
        size = (size[0] * z,)
        outline = shapely.transform(shapely.from_wkt(outline), lambda points: points * (x, y)).wkt
    factors = (shape.scale[0] * x, shape.scale[1] * y, shape.scale[2] * z) if shape.kind == "mesh" else shape.scale
    return replace(shape, size=size, scale=factors, submesh=outline, X_LG=X_ML @ moved)
