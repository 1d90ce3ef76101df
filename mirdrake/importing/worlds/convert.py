"""Things of the source as entries of the new world: primitives, props that are known, folders with a prop.yaml."""

import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw

from mirdrake.importing.changes import Change, Code
from mirdrake.importing.meshes.read import MeshError
from mirdrake.importing.shape import Shape
from mirdrake.importing.worlds.entry import Entry, degrees, is_word, number
from mirdrake.importing.worlds.ground import lowered
from mirdrake.importing.worlds.known import Known, colour_in, find_known, plain_name, stand_in
from mirdrake.importing.worlds.model import Crowd, SourceWorld, Thing
from mirdrake.importing.worlds.prop_folder import EmptyPropError, convex_outlines, key_of, write_prop, write_visual
from mirdrake.importing.worlds.surfaces import corners_of, cut_walls, kind_of

_WHEELS = 3  # turning joints that make a vehicle
_SUNK = 2e-3  # [m] and [rad] that Gazebo's soft contacts let a loose thing sink and lean
_LOOSE_MASS = 1.0  # [kg] of a loose thing without mass, as in Gazebo


@dataclass
class Converter:
    """Makes entries.

    Attributes:
        name: of the new world.
        folder: in which it is built; props go to ``<name>/props/`` below it.
        height: of the ground in the source [m].
        say: called with every change.
        progress: called with what is being done.
        lost: ``file:line: fault`` of everything that should stand in the world and does not.
        starts: vehicles of the source: name -> pose.
    """

    name: str
    folder: Path
    height: float
    say: Callable[[Change], None]
    progress: Callable[[str], None]
    lost: list[str] = field(default_factory=list)
    starts: dict[str, RigidTransform] = field(default_factory=dict)
    _names: set[str] = field(default_factory=set)
    _folders: dict[object, tuple[str, RigidTransform]] = field(default_factory=dict)
    _empty: dict[object, str] = field(default_factory=dict)
    _sunk: list[float] = field(default_factory=list)

    def entries(self, world: SourceWorld) -> list[Entry]:
        """Entries of all things, people and populations of a world, in order."""
        done = [entry for thing in world.things if (entry := self._entry(thing)) is not None]
        for actor, kind, X, where in world.actors:
            what, known = f"actor '{actor}'", find_known(kind)
            if known is None:
                self.say(
                    Change(Code.MODEL, where, what, kind, None, "actors do not move here, and its model is unknown")
                )
                continue
            x, y, _ = X.translation()
            X_WM = RigidTransform(RollPitchYaw(0.0, 0.0, _yaw(X)), [x, y, self.height])
            thing = Thing(actor, kind, X_WM, True, absent=True, where=where)
            done.append(self._known(thing, known, what, "actors do not move here; it stands at its start"))
        done += [entry for crowd in world.crowds if (entry := self._crowd(crowd)) is not None]
        if self._sunk:
            count = len(self._sunk)
            was = f"{count} thing{'s' if count > 1 else ''} up to {1e3 * max(self._sunk):.2g} mm off the ground"
            why = "contacts of Gazebo are soft; what is loose would jump"
            self.say(Change(Code.MODEL, f"{world.files[0]}:1", "loose things", was, "on the ground", why))
        return done

    def scenery(self, things: Sequence[Thing]) -> list[str]:
        """Keys of the meshes of things that are only drawn."""
        done = []
        for thing in things:
            what = f"model '{thing.name}'"
            key = ("drawn", key_of(thing))
            if key not in self._folders:
                short = self._new_folder(thing.kind)
                (self.folder / short).mkdir(parents=True)
                self.progress(f"converting {thing.kind}")
                if not write_visual(thing, RigidTransform(), self.folder / short, self.say):
                    shutil.rmtree(self.folder / short, ignore_errors=True)
                    short = ""
                self._folders[key] = (short, RigidTransform())
            short, _ = self._folders[key]
            if not short:
                self.say(Change(Code.MODEL, thing.where, what, "visuals", None, "none of its meshes can be drawn"))
                continue
            X = lowered(thing.X_WM, self.height)
            at = ", ".join(number(value) for value in X.translation())
            roll, pitch, yaw = RollPitchYaw(X.rotation()).vector()
            turned = (("yaw", yaw), ("pitch", pitch), ("roll", roll))
            angles = "".join(f", {word}: {degrees(angle)}" for word, angle in turned if degrees(angle) != "0 deg")
            done.append(f"file: {short}/visual.gltf, at: [{at}]{angles}")
        return done

    # --- one thing ---

    def _entry(self, thing: Thing) -> Entry | None:
        what = f"model '{thing.name}'"
        if thing.wheels >= _WHEELS and not thing.static:
            name = self._new_name(thing.name)
            self.starts[name] = lowered(thing.X_WM, self.height)
            was = f"{thing.wheels} turning joints"
            why = "a vehicle, not a prop; mirdrake import vehicle takes it"
            self.say(Change(Code.START, thing.where, what, was, f"start '{name}'", why))
            return None
        known = self._known_for(thing)
        if known is not None:
            why = "the model is not at hand" if thing.absent else "its meshes are not at hand"
            return self._known(thing, known, what, why)
        self.lost += thing.broken
        for change in thing.missing:
            self.say(change)
        if thing.absent or not thing.collisions:
            why = thing.broken[0].partition(": ")[2] if thing.broken else (
                "it is only seen; nothing of it can be touched" if thing.visuals else "it has no shapes"
            )  # fmt: skip
            self.say(Change(Code.MODEL, thing.where, what, thing.kind, None, why))
            return None
        if not np.isfinite(thing.X_WM.GetAsMatrix34()).all():
            self.say(Change(Code.MODEL, thing.where, what, thing.kind, None, "its place is no number"))
            return None
        if thing.loose and not thing.static:
            was, became = f"{thing.loose} joints that move", "one rigid thing"
            self.say(Change(Code.MODEL, thing.where, what, was, became, "props do not have joints"))
        return self._primitive(thing) or self._file(thing)

    def _known_for(self, thing: Thing) -> Known | None:
        """The known model that a thing is, if its own files are not at hand."""
        if not thing.sources or (thing.collisions and not thing.absent and not _sees_nothing(thing)):
            return None
        return next((found for name in (thing.kind, *thing.sources) if (found := find_known(name))), None)

    def _known(self, thing: Thing, known: Known, what: str, why: str) -> Entry:
        prop = stand_in(known)
        X_MP = RigidTransform(RollPitchYaw(0.0, 0.0, known.yaw), [*known.middle, 0.0])
        X_WP = lowered(thing.X_WM @ X_MP, self.height)
        name = self._new_name(thing.name)
        words = " x ".join(f"{side:.3g}" for side in known.size)
        about = "" if known.sure else "; size and heading are not measured, please check"
        if prop is None:
            entry = Entry(("box", known.size), name, X_WP, thing)
            became = f"box of {words} m"
        else:
            entry = Entry(("prop", prop.name), name, X_WP, thing, size=prop.asked, scale=prop.scale)
            entry.color = colour_in(thing.kind)
            sides = " x ".join(f"{side:.3g}" for side in prop.size)
            became = f"prop {prop.name}, {sides} m" + (f" for {words} m" if prop.asked is None else "")
        self._set_loose(entry)
        self.say(
            Change(
                Code.STAND_IN if known.sure else Code.STAND_IN_UNSURE,
                thing.where,
                what,
                thing.kind,
                became,
                f"{why}{about}",
            )
        )
        return entry

    def _primitive(self, thing: Thing) -> Entry | None:
        """A thing of one box, cylinder or sphere that looks like that too."""
        if len(thing.collisions) != 1:
            return None
        shape = thing.collisions[0]
        if shape.kind not in {"box", "cylinder", "sphere"} or any(not _same(shape, seen) for seen in thing.visuals):
            return None
        half = shape.size[0] if shape.kind == "sphere" else 0.5 * shape.size[-1]
        X_MP = shape.X_LG @ RigidTransform([0.0, 0.0, -half])
        X_WP = lowered(thing.X_WM @ X_MP, self.height)
        rgba = next((seen.rgba for seen in thing.visuals if seen.rgba is not None), None)
        entry = Entry((shape.kind, shape.size), self._new_name(thing.name), X_WP, thing)
        entry.color = None if rgba is None else (rgba[0], rgba[1], rgba[2])
        self._set_loose(entry)
        return entry

    def _file(self, thing: Thing) -> Entry | None:
        key = key_of(thing)
        what = f"model '{thing.name}'"
        if key in self._empty:
            self.say(Change(Code.MODEL, thing.where, what, thing.kind, None, self._empty[key]))
            return None
        if key not in self._folders:
            short = self._new_folder(thing.kind)
            target = self.folder / short
            self.progress(f"converting {thing.kind}")
            try:
                cut = self._cut(thing, target)
                X_MP, size = write_prop(cut, target, say=self.say)
            except EmptyPropError as error:
                shutil.rmtree(target, ignore_errors=True)
                self._empty[key] = str(error)
                self.lost.append(f"{thing.where}: {what}: {error}")
                self.say(Change(Code.MODEL, thing.where, what, thing.kind, None, str(error)))
                return None
            if np.abs(X_MP.translation()).max() > 5e-5:
                x, y, z = (number(value) for value in X_MP.translation())
                why = "a prop's frame is on the ground below the middle of its box"
                sides = " x ".join(f"{side:.3g}" for side in size)
                became = f"frame at {x} {y} {z} m in the model, box of {sides} m"
                self.say(Change(Code.MODEL, thing.where, what, "frame of the model", became, why))
            self._folders[key] = (short, X_MP)
        short, X_MP = self._folders[key]
        entry = Entry(("file", short), self._new_name(thing.name), lowered(thing.X_WM @ X_MP, self.height), thing)
        self._set_loose(entry)
        return entry

    def _cut(self, thing: Thing, target: Path) -> Thing:
        """A thing whose walls are cut and whose terrain is gone.

        Raises:
            EmptyPropError: nothing is left.
        """
        shapes: list[Shape] = []
        for index, shape in enumerate(thing.collisions):
            try:
                corners = corners_of(shape) if shape.kind == "mesh" else None
            except MeshError:
                corners = None  # said later
            kind = kind_of(corners) if corners is not None else "solid"
            what = f"model '{thing.name}': collision mesh {shape.address}"
            if kind == "walls" and corners is not None:
                parts = cut_walls(shape, corners, target, name=f"wall_{index}")
                why = "the hull of walls around a place would fill it"
                self.say(Change(Code.MODEL, shape.where, what, "walls", f"{len(parts)} convex parts", why))
                shapes += parts
            elif kind == "terrain":
                why = "it is terrain; the ground is a plane, and its hull would bury everything"
                self.say(Change(Code.MODEL, shape.where, what, "wide and low", None, why))
                self.lost.append(f"{shape.where}: {what}: {why}")
            elif shape.kind == "polyline":
                shapes += convex_outlines(shape)
            else:
                shapes.append(shape)
        if not shapes:
            raise EmptyPropError("its collision shapes are terrain; the ground is a plane")
        return replace(thing, collisions=shapes)

    # --- crowds ---

    def _crowd(self, crowd: Crowd) -> Entry | None:
        x, y, z = crowd.thing.X_WM.translation().tolist()
        yaw = _yaw(crowd.thing.X_WM)
        c, s = np.cos(yaw), np.sin(yaw)
        crowd.thing.X_WM = RigidTransform([x, y, z])  # Gazebo turns the region, not what stands in it
        entry = self._entry(crowd.thing)
        if entry is None:
            return None
        x, y, _ = entry.X_WP.translation().tolist()
        was = f"{crowd.count} by {crowd.layout}"
        if crowd.layout == "grid" and abs(yaw) < 1e-6:
            (columns, rows), (dx, dy) = crowd.grid, crowd.step
            origin = f"[{number(x - dx * (columns - 1) / 2)}, {number(y - dy * (rows - 1) / 2)}]"
            entry.layout = f"grid: {{origin: {origin}, step: [{number(dx)}, {number(dy)}], count: [{columns}, {rows}]}}"
            why = "a grid, as Gazebo lays it out"
        elif crowd.layout.startswith("linear") and crowd.box is not None and crowd.layout != "linear-z":
            axis = "xy".index(crowd.layout[-1])
            reach = crowd.box[axis] * (crowd.count - 1) / crowd.count
            start = np.array([0.0, 0.0])
            start[axis] = -crowd.box[axis] / 2.0
            end = start.copy()
            end[axis] += reach
            ends = [np.array([x + c * u - s * v, y + s * u + c * v]) for u, v in (start, end)]
            texts = [f"[{number(u)}, {number(v)}]" for u, v in ends]
            entry.layout = f"line: {{from: {texts[0]}, to: {texts[1]}, count: {crowd.count}}}"
            heading = RollPitchYaw(0.0, 0.0, yaw + axis * np.pi / 2.0).ToRotationMatrix()  # a line turns its props
            entry.X_WP = RigidTransform(heading.inverse() @ entry.X_WP.rotation(), entry.X_WP.translation())
            why = "a line, as Gazebo lays it out"
        else:
            if crowd.radius is not None:
                region = f"disc: {{center: [{number(x)}, {number(y)}], radius: {number(crowd.radius)}}}"
            else:
                a, b, _ = crowd.box or (crowd.step[0] * crowd.grid[0], crowd.step[1] * crowd.grid[1], 0.0)
                turned = f", yaw: {np.degrees(yaw):.4g} deg" if abs(yaw) > 1e-6 else ""
                region = (
                    f"rect: {{center: [{number(x)}, {number(y)}], size: [{number(abs(a))}, {number(abs(b))}]{turned}}}"
                )
            entry.layout = f"scatter: {{region: {{{region}}}, count: {crowd.count}}}"
            why = "drawn by the seed of the world, without touching anything"
        X = entry.X_WP
        entry.X_WP = RigidTransform(X.rotation(), [*X.translation()[:2], 0.0])
        if abs(z - self.height) > 1e-3 or crowd.box is not None:
            why += "; on the ground"
        self.say(
            Change(Code.POPULATION, crowd.where, f"population '{crowd.name}'", was, entry.layout.partition(":")[0], why)
        )
        return entry

    # --- small parts ---

    def _set_loose(self, entry: Entry) -> None:
        thing = entry.thing
        entry.static = thing.static
        if thing.static:
            return
        sound = thing.mass is not None and 1e-6 < thing.mass < 1e9
        if thing.mass is not None and not sound:
            what = f"model '{thing.name}': mass"
            self.say(
                Change(Code.MODEL, thing.where, what, f"{thing.mass:g} kg", f"{_LOOSE_MASS:g} kg", "no thing has that")
            )
        if sound or entry.what[0] in {"box", "cylinder", "sphere"}:
            entry.mass = thing.mass if sound else _LOOSE_MASS
        z = float(entry.X_WP.translation()[2])
        roll, pitch, yaw = RollPitchYaw(entry.X_WP.rotation()).vector()
        if max(abs(z), abs(roll), abs(pitch)) < _SUNK and max(abs(z), abs(roll), abs(pitch)) > 5e-5:
            self._sunk.append(abs(z))
            x, y, _ = entry.X_WP.translation()
            entry.X_WP = RigidTransform(RollPitchYaw(0.0, 0.0, yaw), [x, y, 0.0])

    def _new_folder(self, kind: str) -> str:
        """The folder of a new prop, below that of the world."""
        taken = {path for path, _ in self._folders.values()}
        short, count, plain = "", 1, plain_name(kind) or "prop"
        while not short or short in taken:
            short = f"{self.name}/props/{plain}{f'_{count}' if count > 1 else ''}"
            count += 1
        return short

    def _new_name(self, source: str) -> str:
        plain = re.sub(r"[^A-Za-z0-9_]+", "_", source.replace("::", "_")).strip("_")
        plain = re.sub(r"(_clone|_copy)(_\d+|_clone|_copy)*$", "", plain) or "prop"
        plain = plain.lower() if plain[0].isalpha() and not is_word(plain) else f"prop_{plain}".lower()
        name, count = plain, 1
        while name in self._names:
            count += 1
            name = f"{plain}_{count}"
        self._names.add(name)
        return name


def _sees_nothing(thing: Thing) -> bool:
    """Whether all meshes that should be seen are missing."""
    return not thing.visuals


def _same(shape: Shape, seen: Shape) -> bool:
    """Whether a visual has the form of the collision shape."""
    if seen.kind != shape.kind or seen.texture is not None or len(seen.size) != len(shape.size):
        return False
    return bool(np.allclose(seen.size, shape.size, atol=1e-3)) and seen.X_LG.IsNearlyEqualTo(shape.X_LG, 1e-3)


def _yaw(X: RigidTransform) -> float:
    return float(RollPitchYaw(X.rotation()).yaw_angle())
