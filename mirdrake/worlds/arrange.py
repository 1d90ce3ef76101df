"""Props into their places: entries, groups and layouts written out, random ones drawn until they touch nothing.

All that is fixed is placed first; then what is random is drawn in the order of the file, each thing again and again
until it keeps its distance from everything that stands already. This is sequential local re-drawing: quick, but not the
distribution that drawing whole worlds until one fits would give.

Every thing has random streams of its own, by its name and what its entry says, so that a new entry leaves the others
where they were, unless it takes their place.
"""

import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RollPitchYaw

from mirdrake.core.digest import digest
from mirdrake.core.errors import ConfigError, WorldError, did_you_mean
from mirdrake.core.paths import resolved
from mirdrake.core.yaml_io import where
from mirdrake.worlds.draw import Draw
from mirdrake.worlds.layouts import Slot, draw_in, make_slots
from mirdrake.worlds.props import Color, PlacedProp, Prop, load_prop, make_mesh_prop, make_primitive
from mirdrake.worlds.props_spec import LARGEST_COUNT, GroupSpec, PropEntry
from mirdrake.worlds.regions import Places
from mirdrake.worlds.values import is_random

TRIES = 400
"""Draws of a random thing before there is said to be no place for it."""

MOST_DRAWS = 20_000
"""Draws of all random things of a world that found no free place, before each of the others is drawn only once.

A number, not a time: the same world file gives the same world on every computer.
"""

_DEEPEST = 6  # groups in groups
_Order = tuple[int, ...]


@dataclass(frozen=True)
class Frame:
    """Where a group lies in the world."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    yaw: float = 0.0

    def place(self, x: float, y: float) -> tuple[float, float]:
        """A point of this frame in W [m]."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return self.x + c * x - s * y, self.y + s * x + c * y


@dataclass(frozen=True)
class _Draft:
    """A thing that is still to be placed: one prop, or one group that is placed as a whole."""

    make: Callable[[int], list[PlacedProp]]
    random: bool
    name: str
    where: str


class Arranger:
    """Places props.

    Args:
        places: tracks and patches.
        groups: a function name -> group, or None.
        folder: of the world file, for `file`.
        min_gap: smallest distance between random props and anything else [m].
        allowed: whether a prop may stand where it does, as far as rules say.
        may_overlap: whether two props may touch each other.
    """

    def __init__(
        self,
        places: Places,
        *,
        groups: Callable[[str], GroupSpec | None],
        group_names: Callable[[], list[str]],
        folder: Path,
        min_gap: float = 0.0,
        allowed: Callable[[PlacedProp], bool] = lambda _: True,
        may_overlap: Callable[[PlacedProp, PlacedProp], bool] = lambda _a, _b: False,
    ) -> None:
        self._places, self._groups, self._group_names, self._folder = places, groups, group_names, folder
        self._gap, self._allowed, self._may_overlap = min_gap, allowed, may_overlap
        self._draws_left = MOST_DRAWS

    def arrange(self, entries: Sequence[PropEntry], draw: Draw) -> tuple[list[PlacedProp], list[str]]:
        """All props of a world, in the order of the file, and what found no place.

        Raises:
            ConfigError: an entry is wrong; all faults, one per line.
        """
        faults: list[str] = []
        drafts: list[_Draft] = []
        for index, (name, key, entry) in enumerate(_named(entries)):
            try:
                drafts += self._drafts(entry, name, draw.below(key), Frame(), (index,), depth=0)
            except (ConfigError, WorldError) as error:
                faults.append(str(error))
            if len(drafts) > LARGEST_COUNT:
                raise ConfigError(f"{where(entry)}: more than {LARGEST_COUNT} props")
        crowd = _Crowd(self._gap, self._may_overlap)
        placed: list[PlacedProp] = []
        homeless: dict[str, list[str]] = {}
        for draft in sorted(drafts, key=lambda draft: draft.random):  # stable: fixed ones first
            if draft.where in homeless:  # where one found no place, its like will not
                homeless[draft.where].append(draft.name)
                continue
            try:
                props = self._find_place(draft, crowd) if draft.random else draft.make(0)
            except (ConfigError, WorldError) as error:
                faults.append(str(error))
                continue
            if props is None:
                homeless[draft.where] = [draft.name]
                continue
            crowd.add(props)
            placed += props
        if faults:
            raise ConfigError("\n".join(dict.fromkeys(faults)))
        placed.sort(key=lambda prop: prop.order)
        return placed, [
            f"{place}: no free place for '{names[0]}'{f' and {len(names) - 1} more' if names[1:] else ''} in {TRIES} "
            "tries; make the region larger, or the count or the gaps smaller"
            for place, names in homeless.items()
        ]

    def _find_place(self, draft: _Draft, crowd: "_Crowd") -> list[PlacedProp] | None:
        """A random thing where it keeps to the rules and its distance, or None."""
        for attempt in range(min(TRIES, max(1, self._draws_left))):
            props = draft.make(attempt)
            if all(map(self._allowed, props)) and crowd.has_room(props):
                return props
            self._draws_left -= len(props)
        return None

    def _drafts(
        self, entry: PropEntry, name: str, draw: Draw, frame: Frame, order: _Order, *, depth: int
    ) -> Iterator[_Draft]:
        """The things of one entry in a frame."""
        slots = make_slots(entry, self._places, draw)
        single = entry.at is not None
        group = self._group(entry, depth)
        random = entry.scatter is not None or _is_drawn(entry)
        for index, slot in enumerate(slots):
            own = draw.below(str(index))
            label = name if single else f"{name}[{index}]"
            here = (*order, index)
            if group is None:
                yield _Draft(self._prop_maker(entry, label, own, slot, frame, here), random, label, where(entry))
                continue
            if random:
                yield _Draft(
                    self._group_maker(entry, group, label, own, slot, frame, here, depth), True, label, where(entry)
                )
            else:
                yield from self._group_drafts(entry, group, label, own, slot, frame, here, depth)

    def _prop_maker(
        self, entry: PropEntry, label: str, draw: Draw, slot: Slot, frame: Frame, order: _Order
    ) -> Callable[[int], list[PlacedProp]]:
        def make(attempt: int) -> list[PlacedProp]:
            once = draw.again(attempt)
            prop = self._prop(entry, once)
            x, y, yaw = _pose(entry, slot, once)
            z = self._height(entry, once)
            roll, pitch = (once.number(getattr(entry, key), "rad", key, entry) for key in ("roll", "pitch"))
            x, y = frame.place(x, y)
            X_WP = RigidTransform(RollPitchYaw(roll, pitch, frame.yaw + yaw), [x, y, frame.z + z])
            color = _color(entry, once)
            if entry.mass is not None:
                mass = once.number(entry.mass, "kg", "mass", entry)
                if not mass > 0.0:
                    raise ConfigError(f"{where(entry, 'mass')}: {mass:g} kg; it must be above 0")
                prop = Prop(**{**prop.__dict__, "mass": mass})
            random = entry.scatter is not None or _is_drawn(entry)
            return [PlacedProp(label, prop, X_WP, entry.static, color, where(entry), random, order)]

        return make

    def _group_maker(
        self,
        entry: PropEntry,
        group: GroupSpec,
        label: str,
        draw: Draw,
        slot: Slot,
        frame: Frame,
        order: _Order,
        depth: int,
    ) -> Callable[[int], list[PlacedProp]]:
        def make(attempt: int) -> list[PlacedProp]:
            drafts = self._group_drafts(entry, group, label, draw.again(attempt), slot, frame, order, depth)
            return [prop for draft in drafts for prop in draft.make(attempt)]

        return make

    def _group_drafts(
        self,
        entry: PropEntry,
        group: GroupSpec,
        label: str,
        draw: Draw,
        slot: Slot,
        frame: Frame,
        order: _Order,
        depth: int,
    ) -> list[_Draft]:
        """The things of a group in one place."""
        for key in entry.with_:
            if key not in group.params:
                hint = did_you_mean(key, group.params) if group.params else "it has none"
                raise ConfigError(
                    f"{where(entry, 'with', key)}: group '{entry.group}' has no parameter '{key}'; {hint}"
                )
        x, y, yaw = _pose(entry, slot, draw)
        x, y = frame.place(x, y)
        inner = Frame(x, y, frame.z + self._height(entry, draw), frame.yaw + yaw)
        parameters = {
            key: draw.parameter(value, f"params.{key}", place=where(group, "params", key))
            for key, value in group.params.items()
        }
        parameters |= {
            key: draw.parameter(value, f"with.{key}", place=where(entry, "with", key))
            for key, value in entry.with_.items()
        }
        below = Draw(draw.seed, draw.path, parameters, draw.attempt)
        return [
            draft
            for index, (name, key, part) in enumerate(_named(group.props))
            for draft in self._drafts(
                part, f"{label}.{name}", below.below(key), inner, (*order, index), depth=depth + 1
            )
        ]

    def _group(self, entry: PropEntry, depth: int) -> GroupSpec | None:
        if entry.group is None:
            return None
        if depth >= _DEEPEST:
            raise ConfigError(
                f"{where(entry, 'group')}: more than {_DEEPEST} groups in each other; does it hold itself?"
            )
        group = self._groups(entry.group)
        if group is None:
            names = self._group_names()
            hint = did_you_mean(entry.group, names) if names else "there are none; add it under groups"
            raise ConfigError(f"{where(entry, 'group')}: unknown group '{entry.group}'; {hint}")
        return group

    def _prop(self, entry: PropEntry, draw: Draw) -> Prop:
        """What is placed."""
        scale = draw.number(entry.scale, "", "scale", entry)
        if not 1e-3 <= scale <= 1e3:
            raise ConfigError(f"{where(entry, 'scale')}: {scale:g}; allowed are 0.001 to 1000")
        size = None
        if entry.size is not None:
            length, width, height = draw.numbers(entry.size, "m", "size", entry)
            if not min(length, width, height) > 0.0:
                raise ConfigError(f"{where(entry, 'size')}: all three must be above 0 m")
            size = (length, width, height)
        if entry.prop is not None:
            return load_prop(draw.word(entry.prop, "prop", entry), size=size, scale=scale, where=where(entry, "prop"))
        if size is not None:
            raise ConfigError(
                f"{where(entry, 'size')}: size belongs to a prop that is resizable; give the sides themselves"
            )
        if entry.file is not None:
            path = self._folder / entry.file
            if (path / "prop.yaml").is_file():
                return load_prop(f"{resolved(path)}/", scale=scale, where=where(entry, "file"))
            if path.suffix.lower() not in {".gltf", ".glb", ".obj"} or not path.is_file():
                raise ConfigError(
                    f"{where(entry, 'file')}: no prop at '{entry.file}': a folder with a prop.yaml, or a .gltf or .obj "
                    "file, beside the world file is expected"
                )
            return make_mesh_prop(resolved(path), scale=scale, where=where(entry, "file"))
        for kind in ("box", "cylinder", "sphere"):
            value = getattr(entry, kind)
            if value is not None:
                sides = draw.numbers(value if isinstance(value, list) else [value], "m", kind, entry)
                return make_primitive(kind, tuple(sides), scale=scale, where=where(entry, kind))
        raise AssertionError("an entry has a shape")

    @staticmethod
    def _height(entry: PropEntry, draw: Draw) -> float:
        if entry.at is not None and len(entry.at) == 3:
            return draw.number(entry.at[2], "m", "at[2]", entry)
        return draw.number(entry.z, "m", "z", entry) if entry.z is not None else 0.0


class _Crowd:
    """Props that stand already, found quickly by their boxes seen from above."""

    def __init__(self, gap: float, may_overlap: Callable[[PlacedProp, PlacedProp], bool]) -> None:
        self._gap, self._may_overlap = gap, may_overlap
        self._boxes: NDArray[np.float64] = np.empty((256, 6))
        self._props: list[PlacedProp] = []

    def add(self, props: Sequence[PlacedProp]) -> None:
        """Take in props."""
        for prop in props:
            if len(self._props) == len(self._boxes):
                self._boxes = np.vstack((self._boxes, np.empty_like(self._boxes)))
            self._boxes[len(self._props)] = (*prop.footprint.bounds, prop.bottom, prop.top)
            self._props.append(prop)

    def has_room(self, props: Sequence[PlacedProp]) -> bool:
        """Whether props keep their distance from all that stand, and do not touch each other's places."""
        boxes, gap = self._boxes[: len(self._props)], self._gap
        for prop in props:
            xmin, ymin, xmax, ymax = prop.footprint.bounds
            near = (
                (boxes[:, 0] < xmax + gap) & (boxes[:, 2] > xmin - gap)
                & (boxes[:, 1] < ymax + gap) & (boxes[:, 3] > ymin - gap)
                & (boxes[:, 4] < prop.top + gap) & (boxes[:, 5] > prop.bottom - gap)
            )  # fmt: skip
            for index in np.nonzero(near)[0].tolist():
                other = self._props[index]
                if self._may_overlap(prop, other):
                    continue
                if gap == 0.0:
                    if prop.footprint.intersects(other.footprint):
                        return False
                elif prop.footprint.distance(other.footprint) < gap:
                    return False
        return True


def _color(entry: PropEntry, draw: Draw) -> Color | None:
    """Red, green, blue, from numbers or from a name of CSS."""
    if entry.color is None:
        return None
    if isinstance(entry.color, list):
        red, green, blue = (min(1.0, max(0.0, c)) for c in draw.numbers(entry.color, "", "color", entry))
        return red, green, blue
    from matplotlib.colors import CSS4_COLORS, to_rgb  # takes a while, and most colours are numbers

    name = draw.word(entry.color, "color", entry)
    if name not in CSS4_COLORS:
        raise ConfigError(
            f"{where(entry, 'color')}: unknown colour '{name}'; {did_you_mean(name, CSS4_COLORS)}, or [red, green, "
            "blue] from 0 to 1"
        )
    red, green, blue = to_rgb(name)
    return red, green, blue


def _named(entries: Sequence[PropEntry]) -> Iterator[tuple[str, str, PropEntry]]:
    """Entries with unique names, and keys of their random streams that do not depend on other entries."""
    names: dict[str, int] = {}
    keys: dict[str, int] = {}
    given = {entry.name for entry in entries if entry.name}
    for entry in entries:
        label = entry.label
        if entry.name is None:
            while True:
                names[label] = names.get(label, 0) + 1
                name = label if names[label] == 1 else f"{label}_{names[label]}"
                if name not in given:
                    break
            text = json.dumps(entry.model_dump(mode="json", exclude_unset=True), sort_keys=True)
            key = f"{label}-{digest(text)[:12]}"
            keys[key] = keys.get(key, 0) + 1
            key = key if keys[key] == 1 else f"{key}-{keys[key]}"
        else:
            name = key = entry.name
            names[name] = names.get(name, 0) + 1
            if names[name] > 1:
                raise ConfigError(f"{where(entry, 'name')}: there is a '{name}' already; give each entry its own name")
        yield name, key, entry


def _pose(entry: PropEntry, slot: Slot, draw: Draw) -> tuple[float, float, float]:
    """X [m], y [m] and heading [rad] of one place, with jitter, in the frame of the layout."""
    x, y = (slot.x, slot.y) if slot.area is None else draw_in(slot.area, draw, place=where(entry, "scatter"))
    if slot.area is None and entry.at is not None and draw.attempt:
        x, y = draw.numbers(entry.at[:2], "m", "at", entry)
    heading = slot.heading
    if entry.jitter is not None:
        dx, dy = (draw.number(getattr(entry.jitter, key), "m", key, entry.jitter) for key in ("x", "y"))
        c, s = math.cos(heading), math.sin(heading)
        x, y = x + c * dx - s * dy, y + s * dx + c * dy
        heading += draw.number(entry.jitter.yaw, "rad", "yaw", entry.jitter)
    yaw = entry.yaw[slot.row % len(entry.yaw)] if isinstance(entry.yaw, list) else entry.yaw
    return x, y, heading + draw.number(yaw, "rad", "yaw", entry)


def _is_drawn(entry: PropEntry) -> bool:
    """Whether chance decides where an entry's things stand or how large they are."""
    values: list[object] = [entry.prop, entry.yaw, entry.z, entry.scale, entry.sphere]
    for part in (entry.at, entry.size, entry.box, entry.cylinder, entry.yaw):
        values += part if isinstance(part, list) else []
    if entry.jitter is not None:
        values += [entry.jitter.x, entry.jitter.y, entry.jitter.yaw]
    return any(map(is_random, values))
