"""Objects of the source as entries of the new world: primitives, known props, folders with a prop.yaml."""

import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw

from mirdrake.core.errors import ModelError
from mirdrake.core.wording import plural
from mirdrake.importing.changes import Changes, Code
from mirdrake.importing.meshes.read import MeshError
from mirdrake.importing.shape import Shape
from mirdrake.importing.target import is_word
from mirdrake.importing.worlds.entry import Entry, degrees, number
from mirdrake.importing.worlds.ground import lowered
from mirdrake.importing.worlds.known import Known, colour_in, find_known, plain_name, stand_in
from mirdrake.importing.worlds.model import Crowd, SourceObject, SourceWorld
from mirdrake.importing.worlds.prop_folder import EmptyPropError, convex_outlines, key_of, write_prop, write_visual
from mirdrake.importing.worlds.surfaces import corners_of, cut_walls, kind_of
from mirdrake.worlds.props import DEFAULT_MU

_WHEELS = 3  # turning joints that make a vehicle
_SUNK = 2e-3  # [m] and [rad]: penetration and tilt of a loose object due to Gazebo's soft contacts
_LOOSE_MASS = 1.0  # [kg] of a loose object without mass, as in Gazebo


@dataclass
class Converter:
    """Makes entries.

    Attributes:
        name: name of the new world.
        folder: folder of the world file; props are written to ``<name>/props/`` below it.
        height: height of the ground in the source [m].
        changes: get every change.
        progress: called with the current step.
        lost: the faults of all objects with collision geometry that were left out.
        starts: vehicles of the source: name -> pose.
    """

    name: str
    folder: Path
    height: float
    changes: Changes
    progress: Callable[[str], None]
    lost: list[ModelError] = field(default_factory=list)
    starts: dict[str, RigidTransform] = field(default_factory=dict)
    _names: set[str] = field(default_factory=set)
    _folders: dict[object, tuple[str, RigidTransform]] = field(default_factory=dict)
    _empty: dict[object, str] = field(default_factory=dict)
    _sunk: list[float] = field(default_factory=list)

    def entries(self, world: SourceWorld) -> list[Entry]:
        """Return the entries of all objects, people and populations of a world in order."""
        done = [entry for obj in world.objects if (entry := self._entry(obj)) is not None]
        for actor, kind, X, where in world.actors:
            part, known = f"actor '{actor}'", find_known(kind)
            if known is None:
                self.changes.add(
                    Code.MODEL, where, part, kind, None, "its motion is not imported, and its model is unknown"
                )
                continue
            # A person stands upright on the ground: only position and heading remain.
            x, y, _ = X.translation()
            X_WM = RigidTransform(RollPitchYaw(0.0, 0.0, _yaw(X)), [x, y, self.height])
            obj = SourceObject(actor, kind, X_WM, True, absent=True, where=where)
            done.append(self._known(obj, known, part, "its motion is not imported; it is placed at its first position"))
        done += [entry for crowd in world.crowds if (entry := self._crowd(crowd)) is not None]
        if self._sunk:
            count = len(self._sunk)
            was = f"{plural(count, 'object')} up to {1e3 * max(self._sunk):.2g} mm off the ground"
            why = "contacts of Gazebo are soft; loose objects would jump"
            self.changes.add(Code.MODEL, f"{world.files[0]}:1", "loose objects", was, "on the ground", why)
        return done

    def scenery(self, objects: Sequence[SourceObject]) -> list[str]:
        """Return the entries of visual-only meshes."""
        done = []
        for obj in objects:
            part = f"model '{obj.name}'"
            # Objects with equal shapes share a folder; those that are visual only have keys of their own.
            key = ("drawn", key_of(obj))
            if key not in self._folders:
                short = self._new_folder(obj.kind)
                (self.folder / short).mkdir(parents=True)
                self.progress(f"converting {obj.kind}")
                if not write_visual(obj, RigidTransform(), self.folder / short, self.changes):
                    shutil.rmtree(self.folder / short, ignore_errors=True)
                    short = ""
                self._folders[key] = (short, RigidTransform())
            short, _ = self._folders[key]
            if not short:
                self.changes.add(Code.MODEL, obj.where, part, "visuals", None, "none of its meshes can be read")
                continue
            # Objects are written relative to the ground of the world, which is at z = 0.
            X = lowered(obj.X_WM, self.height)
            position = ", ".join(number(value) for value in X.translation())
            roll, pitch, yaw = RollPitchYaw(X.rotation()).vector()
            turned = (("yaw", yaw), ("pitch", pitch), ("roll", roll))
            angles = "".join(f", {word}: {degrees(angle)}" for word, angle in turned if degrees(angle) != "0 deg")
            done.append(f"file: {short}/visual.gltf, at: [{position}]{angles}")
        return done

    # --- one object ---

    def _entry(self, obj: SourceObject) -> Entry | None:
        part = f"model '{obj.name}'"
        # A model with turning wheels is a car of the source: its place is kept as a start.
        if obj.wheels >= _WHEELS and not obj.static:
            name = self._new_name(obj.name)
            self.starts[name] = lowered(obj.X_WM, self.height)
            was = f"{obj.wheels} turning joints"
            why = "a vehicle, not a prop; use mirdrake import vehicle"
            self.changes.add(Code.START, obj.where, part, was, f"start '{name}'", why)
            return None
        # A model without its own files becomes a prop of its size, if it is well known.
        known = self._known_for(obj)
        if known is not None:
            why = "the files of the model are missing" if obj.absent else "its meshes are missing"
            return self._known(obj, known, part, why)
        self.lost += obj.broken
        # Reports of missing meshes waited until here, since a known prop makes them irrelevant.
        for change in obj.missing:
            self.changes.append(change)
        if obj.absent or not obj.collisions:
            why = obj.broken[0].text if obj.broken else (
                "it is visual only" if obj.visuals else "it has no shapes"
            )  # fmt: skip
            self.changes.add(Code.MODEL, obj.where, part, obj.kind, None, why)
            return None
        # Damaged files have NaN in poses, which would pass every later comparison.
        if not np.isfinite(obj.X_WM.GetAsMatrix34()).all():
            self.changes.add(Code.MODEL, obj.where, part, obj.kind, None, "its pose is not finite")
            return None
        if obj.loose and not obj.static:
            was, became = f"{obj.loose} joints that move", "one rigid body"
            self.changes.add(Code.MODEL, obj.where, part, was, became, "props do not have joints")
        return self._primitive(obj) or self._file(obj)

    def _known_for(self, obj: SourceObject) -> Known | None:
        """Return the known model for an object without its own files."""
        if not obj.sources or (obj.collisions and not obj.absent and obj.visuals):
            return None
        return next((known for name in (obj.kind, *obj.sources) if (known := find_known(name))), None)

    def _known(self, obj: SourceObject, known: Known, part: str, why: str) -> Entry:
        prop = stand_in(known)
        # The prop's frame is below its middle; the model may have its origin elsewhere and another heading.
        X_MP = RigidTransform(RollPitchYaw(0.0, 0.0, known.yaw), [*known.middle, 0.0])
        X_WP = lowered(obj.X_WM @ X_MP, self.height)
        name = self._new_name(obj.name)
        words = " x ".join(f"{side:.3g}" for side in known.size)
        about = "" if known.sure else "; size and heading were not measured: please check"
        if prop is None:
            entry = Entry(("box", known.size), name, X_WP, obj)
            became = f"box of {words} m"
        else:
            entry = Entry(("prop", prop.name), name, X_WP, obj, size=prop.asked, scale=prop.scale)
            entry.color = colour_in(obj.kind)
            sides = " x ".join(f"{side:.3g}" for side in prop.size)
            became = f"prop {prop.name}, {sides} m" + (f" for {words} m" if prop.asked is None else "")
        self._set_loose(entry)
        self.changes.add(
            Code.STAND_IN if known.sure else Code.STAND_IN_UNSURE, obj.where, part, obj.kind, became, f"{why}{about}"
        )
        return entry

    def _primitive(self, obj: SourceObject) -> Entry | None:
        """Return the entry of an object that consists of one box, cylinder or sphere."""
        if len(obj.collisions) != 1:
            return None
        shape = obj.collisions[0]
        if shape.kind not in {"box", "cylinder", "sphere"} or any(not _same(shape, seen) for seen in obj.visuals):
            return None
        # The frame of a primitive is at its bottom here and in its middle in SDF.
        half = shape.size[0] if shape.kind == "sphere" else 0.5 * shape.size[-1]
        X_MP = shape.X_LG @ RigidTransform([0.0, 0.0, -half])
        X_WP = lowered(obj.X_WM @ X_MP, self.height)
        rgba = next((seen.rgba for seen in obj.visuals if seen.rgba is not None), None)
        entry = Entry((shape.kind, shape.size), self._new_name(obj.name), X_WP, obj)
        entry.color = None if rgba is None else (rgba[0], rgba[1], rgba[2])
        if obj.mu is not None and abs(obj.mu - DEFAULT_MU) > 1e-9:
            part = f"model '{obj.name}': friction"
            why = f"the entry of a {shape.kind} has no friction of its own; write a prop.yaml for another one"
            self.changes.add(Code.MODEL, obj.where, part, f"mu {obj.mu:g}", f"mu {DEFAULT_MU:g}", why)
        self._set_loose(entry)
        return entry

    def _file(self, obj: SourceObject) -> Entry | None:
        key = key_of(obj)
        part = f"model '{obj.name}'"
        # An object without usable shapes fails for each copy, but is reported for each.
        if key in self._empty:
            self.changes.add(Code.MODEL, obj.where, part, obj.kind, None, self._empty[key])
            return None
        if key not in self._folders:
            short = self._new_folder(obj.kind)
            target = self.folder / short
            self.progress(f"converting {obj.kind}")
            try:
                cut = self._cut(obj, target)
                X_MP, size = write_prop(cut, target, changes=self.changes)
            except EmptyPropError as error:
                shutil.rmtree(target, ignore_errors=True)
                # Copies of this object fail in the same way and are not converted again.
                self._empty[key] = str(error)
                self.lost.append(ModelError(f"{part}: {error}", where=obj.where))
                self.changes.add(Code.MODEL, obj.where, part, obj.kind, None, str(error))
                return None
            # The frame of the model matters to users who refer to its position, so a displacement is reported.
            if np.abs(X_MP.translation()).max() > 5e-5:
                x, y, z = (number(value) for value in X_MP.translation())
                why = "the frame of a prop is on the ground below the centre of its bounding box"
                sides = " x ".join(f"{side:.3g}" for side in size)
                became = f"frame at {x} {y} {z} m in the model, box of {sides} m"
                self.changes.add(Code.MODEL, obj.where, part, "frame of the model", became, why)
            self._folders[key] = (short, X_MP)
        short, X_MP = self._folders[key]
        entry = Entry(("file", short), self._new_name(obj.name), lowered(obj.X_WM @ X_MP, self.height), obj)
        self._set_loose(entry)
        return entry

    def _cut(self, obj: SourceObject, target: Path) -> SourceObject:
        """Return an object with its walls cut into parts and without terrain.

        Raises:
            EmptyPropError: nothing is left.
        """
        shapes: list[Shape] = []
        for index, shape in enumerate(obj.collisions):
            try:
                corners = corners_of(shape) if shape.kind == "mesh" else None
            except MeshError:
                corners = None  # reported when the prop is written
            kind = kind_of(corners) if corners is not None else "solid"
            part = f"model '{obj.name}': collision mesh {shape.address}"
            # A closed room is one mesh in many worlds: its convex hull would be a solid block.
            if kind == "walls" and corners is not None:
                parts, left_out = cut_walls(shape, corners, target, name=f"wall_{index}")
                why = "the convex hull of the walls would fill the room"
                self.changes.add(Code.MODEL, shape.where, part, "walls", f"{len(parts)} convex parts", why)
                if left_out:
                    why = f"{left_out} of {left_out + len(parts)} separate parts are too many; the largest are kept"
                    self.changes.add(Code.MODEL, shape.where, part, f"{left_out} smaller parts", None, why)
                    self.lost.append(ModelError(f"{part}: {why}", where=shape.where))
                shapes += parts
            elif kind == "terrain":
                why = "it is terrain; the ground of a world is a plane"
                self.changes.add(Code.MODEL, shape.where, part, "wide and low", None, why)
                self.lost.append(ModelError(f"{part}: {why}", where=shape.where))
            elif shape.kind == "polyline":
                shapes += convex_outlines(shape)
            else:
                shapes.append(shape)
        if not shapes:
            raise EmptyPropError("its collision shapes are terrain; the ground of a world is a plane")
        return replace(obj, collisions=shapes)

    # --- crowds ---

    def _crowd(self, crowd: Crowd) -> Entry | None:
        x, y, z = crowd.obj.X_WM.translation().tolist()
        yaw = _yaw(crowd.obj.X_WM)
        c, s = np.cos(yaw), np.sin(yaw)
        crowd.obj.X_WM = RigidTransform([x, y, z])  # Gazebo rotates the region, not the objects in it
        entry = self._entry(crowd.obj)
        if entry is None:
            return None
        x, y, _ = entry.X_WP.translation().tolist()
        # Layouts with an exact counterpart keep the positions of Gazebo; others are random in both programs.
        was = f"{crowd.count} by {crowd.layout}"
        if crowd.layout == "grid" and abs(yaw) < 1e-6:
            (columns, rows), (dx, dy) = crowd.grid, crowd.step
            # The grid of Gazebo is centred at the population; here its origin is the first object.
            origin = f"[{number(x - dx * (columns - 1) / 2)}, {number(y - dy * (rows - 1) / 2)}]"
            entry.layout = f"grid: {{origin: {origin}, step: [{number(dx)}, {number(dy)}], count: [{columns}, {rows}]}}"
            why = "same grid as in Gazebo"
        elif crowd.layout.startswith("linear") and crowd.box is not None and crowd.layout != "linear-z":
            axis = "xy".index(crowd.layout[-1])
            # Gazebo divides the length by the number of objects, so that the last one is a step before the end.
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
            why = "same line as in Gazebo"
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
            why = "positions are random (seed of the world), without collisions"
        # A layout has positions of its own, so that only the height and rotation of the entry remain.
        X = entry.X_WP
        entry.X_WP = RigidTransform(X.rotation(), [*X.translation()[:2], 0.0])
        if abs(z - self.height) > 1e-3 or crowd.box is not None:
            why += "; on the ground"
        self.changes.add(
            Code.POPULATION, crowd.where, f"population '{crowd.name}'", was, entry.layout.partition(":")[0], why
        )
        return entry

    # --- small parts ---

    def _set_loose(self, entry: Entry) -> None:
        obj = entry.obj
        entry.static = obj.static
        if obj.static:
            return
        sound = obj.mass is not None and 1e-6 < obj.mass < 1e9
        if obj.mass is not None and not sound:
            part = f"model '{obj.name}': mass"
            self.changes.add(
                Code.MODEL, obj.where, part, f"{obj.mass:g} kg", f"{_LOOSE_MASS:g} kg", "the mass is not plausible"
            )
        if sound or entry.what[0] in {"box", "cylinder", "sphere"}:
            entry.mass = obj.mass if sound else _LOOSE_MASS
        z = float(entry.X_WP.translation()[2])
        roll, pitch, yaw = RollPitchYaw(entry.X_WP.rotation()).vector()
        # Less than 5e-5 m does not appear in the digits of the file.
        if max(abs(z), abs(roll), abs(pitch)) < _SUNK and max(abs(z), abs(roll), abs(pitch)) > 5e-5:
            self._sunk.append(abs(z))
            x, y, _ = entry.X_WP.translation()
            entry.X_WP = RigidTransform(RollPitchYaw(0.0, 0.0, yaw), [x, y, 0.0])

    def _new_folder(self, kind: str) -> str:
        """Return the folder of a new prop."""
        taken = {path for path, _ in self._folders.values()}
        short, count, plain = "", 1, plain_name(kind) or "prop"
        while not short or short in taken:
            short = f"{self.name}/props/{plain}{f'_{count}' if count > 1 else ''}"
            count += 1
        return short

    def _new_name(self, source: str) -> str:
        plain = re.sub(r"[^A-Za-z0-9_]+", "_", source.replace("::", "_")).strip("_")
        # Gazebo's editor appends these words to the names of copies.
        plain = re.sub(r"(_clone|_copy)(_\d+|_clone|_copy)*$", "", plain) or "prop"
        plain = plain.lower() if plain[0].isalpha() and not is_word(plain) else f"prop_{plain}".lower()
        name, count = plain, 1
        while name in self._names:
            count += 1
            name = f"{plain}_{count}"
        self._names.add(name)
        return name


def _same(shape: Shape, seen: Shape) -> bool:
    """Return whether a visual has the geometry of a collision shape."""
    if seen.kind != shape.kind or seen.texture is not None or len(seen.size) != len(shape.size):
        return False
    return bool(np.allclose(seen.size, shape.size, atol=1e-3)) and seen.X_LG.IsNearlyEqualTo(shape.X_LG, 1e-3)


def _yaw(X: RigidTransform) -> float:
    return float(RollPitchYaw(X.rotation()).yaw_angle())
