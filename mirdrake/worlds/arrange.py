"""Placement of props: entries, groups and layouts become props; random ones are drawn until they touch nothing.

Fixed props are placed first. Then each random prop is drawn, in the order of the file, again and again until it keeps
its distance from all props that are placed already. This is sequential and quick, but not the distribution that drawing
whole worlds until one is valid would give.

Each prop has its own random streams, which depend on its name and its entry, so that a new entry leaves the other props
where they were, unless it takes their place.
"""

import hashlib
import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydrake.common.eigen_geometry import AngleAxis
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix

from mirdrake.core.errors import ConfigError, MirdrakeError, WorldError, did_you_mean
from mirdrake.core.yaml_io import file_line, where
from mirdrake.ground import FLAT, Terrain
from mirdrake.worlds.draw import Draw
from mirdrake.worlds.layouts import Slot, draw_in
from mirdrake.worlds.props import Color, PlacedProp, Prop
from mirdrake.worlds.props_spec import GroupSpec, PropEntry
from mirdrake.worlds.regions import NamedAreas
from mirdrake.worlds.schema_types import LARGEST_COUNT
from mirdrake.worlds.solids import Size

TRIES = 400
"""Draws of a random prop before it remains unplaced."""

MOST_DRAWS = 20_000
"""Draws of all random props of a world that found no free position, before each other prop is drawn only once.

This is a number and not a time, so that a world file gives the same world on every computer.
"""

_DEEPEST = 6  # groups inside groups
_Order = tuple[int, ...]
_MayOverlap = Callable[[PlacedProp, PlacedProp], bool]


@dataclass(frozen=True)
class GroupPose:
    """Pose of a group in the world.

    Attributes:
        x: [m].
        y: [m].
        z: [m].
        yaw: [rad].
        grounded: whether its props without a height of their own stand on the ground, not at the height of the group.
    """

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    yaw: float = 0.0
    grounded: bool = True

    def point(self, x: float, y: float) -> tuple[float, float]:
        """Return a point of the group's frame in W [m]."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return self.x + c * x - s * y, self.y + s * x + c * y


@dataclass(frozen=True)
class _Draft:
    """A prop, or a group that is placed as a whole, before it is placed.

    Attributes:
        make: returns its props for a number of earlier attempts.
        random: whether it is drawn until it touches nothing.
        name: its name.
        where: ``file:line: path`` of its entry.
        entry: name of its entry; that of a group has another one in each position of the group.
    """

    make: Callable[[int], list[PlacedProp]]
    random: bool
    name: str
    where: str
    entry: str


@dataclass(frozen=True)
class _Item:
    """One position of an entry.

    Attributes:
        entry: the entry.
        label: name of the prop or group.
        draw: evaluates its values.
        slot: its position in the layout.
        frame: frame of the layout.
        order: its position in the file.
        depth: number of groups around it.
        terrain: the ground.
    """

    entry: PropEntry
    label: str
    draw: Draw
    slot: Slot
    frame: GroupPose
    order: _Order
    depth: int
    terrain: Terrain

    def again(self, attempt: int) -> "_Item":
        """Return the item for a repeated draw."""
        return replace(self, draw=self.draw.again(attempt))

    def pose(self) -> GroupPose:
        """Return its pose in W, with jitter; it is grounded if no height is given for it or a group around it."""
        entry, slot, draw = self.entry, self.slot, self.draw
        # A region is drawn anew at every attempt; so is a random position given by `at`.
        x, y = (slot.x, slot.y) if slot.area is None else draw_in(slot.area, draw, location=where(entry, "scatter"))
        if slot.area is None and entry.at is not None and draw.attempt:
            x, y = entry.at.position(entry, draw)
        heading = slot.heading
        # Jitter is in the frame of the slot, so that x remains along the line or the track.
        if entry.jitter is not None:
            dx, dy = (draw.number(getattr(entry.jitter, key), "m", key, entry.jitter) for key in ("x", "y"))
            c, s = math.cos(heading), math.sin(heading)
            x, y = x + c * dx - s * dy, y + s * dx + c * dy
            heading += draw.number(entry.jitter.yaw, "rad", "yaw", entry.jitter)
        # A list of headings belongs to the rows of a grid, or to the positions of another layout, in turn.
        yaw = entry.yaw[slot.row % len(entry.yaw)] if isinstance(entry.yaw, list) else entry.yaw
        heading += draw.number(yaw, "rad", "yaw", entry)
        x, y = self.frame.point(x, y)
        above = self._height()
        grounded = above is None and self.frame.grounded
        z = float(self.terrain.height(x, y)) if grounded else self.frame.z + (above or 0.0)
        return GroupPose(x, y, z, self.frame.yaw + heading, grounded)

    def _height(self) -> float | None:
        """Return its height above the frame [m], if one is given."""
        entry = self.entry
        if entry.at is not None and entry.at.z is not None:
            return self.draw.number(entry.at.z, "m", "at[2]", entry)
        return self.draw.number(entry.z, "m", "z", entry) if entry.z is not None else None

    def standing(self, pose: GroupPose, rotation: RollPitchYaw, *, inclined: bool) -> RigidTransform:
        """Return the pose of a prop: its z axis along the normal of the ground if it is grounded and `inclined`."""
        R_WP = rotation.ToRotationMatrix()
        if inclined and pose.grounded and not self.terrain.flat:
            normal = np.array(self.terrain.at(pose.x, pose.y).normal)
            # The smallest rotation from the vertical to the normal.
            axis = np.cross([0.0, 0.0, 1.0], normal)
            angle = math.atan2(float(np.linalg.norm(axis)), float(normal[2]))
            if angle > 0.0:
                R_WP = RotationMatrix(AngleAxis(angle, axis / np.linalg.norm(axis))) @ R_WP
        return RigidTransform(R_WP, [pose.x, pose.y, pose.z])


class Arranger:
    """Placement of the props of a world.

    Args:
        areas: tracks and patches.
        groups: returns the group of a name, or None.
        group_names: returns the names of all groups.
        folder: folder of the world file, for `file`.
        terrain: the ground, on which props without a height stand.
        min_gap: smallest distance between random props and all others [m].
        allowed: whether the rules allow a prop in its place.
        may_overlap: whether two props may touch each other.
    """

    def __init__(
        self,
        areas: NamedAreas,
        *,
        groups: Callable[[str], GroupSpec | None],
        group_names: Callable[[], list[str]],
        folder: Path,
        terrain: Terrain = FLAT,
        min_gap: float = 0.0,
        allowed: Callable[[PlacedProp], bool] = lambda _: True,
        may_overlap: _MayOverlap = lambda _a, _b: False,
    ) -> None:
        self._areas, self._groups, self._group_names, self._folder = areas, groups, group_names, folder
        self._terrain = terrain
        self._gap, self._allowed, self._may_overlap = min_gap, allowed, may_overlap
        self._draws_left = MOST_DRAWS

    def arrange(self, entries: Sequence[PropEntry], draw: Draw) -> tuple[list[PlacedProp], list[WorldError]]:
        """Return all props of a world in the order of the file, and an error for each entry with unplaced props.

        Raises:
            ConfigError: an entry is invalid; all faults, one per line.
        """
        # All faults of the entries are collected, so that they are reported at once.
        faults: list[MirdrakeError] = []
        drafts: list[_Draft] = []
        for index, (name, key, entry) in enumerate(_named(entries)):
            try:
                drafts += self._drafts(entry, name, draw.below(key), GroupPose(), (index,), depth=0)
            except (ConfigError, WorldError) as error:
                faults.append(error)
            if len(drafts) > LARGEST_COUNT:
                raise ConfigError(f"more than {LARGEST_COUNT} props; reduce a count", where=where(entry))

        # Fixed props are placed first, as random ones avoid them.
        placed_props = _PlacedProps(self._gap, self._may_overlap)
        unplaced: dict[str, list[str]] = {}
        failed: set[str] = set()
        for draft in sorted(drafts, key=lambda draft: draft.random):  # stable: fixed ones first
            if draft.entry in failed:  # other props of the same entry will not find a position either
                unplaced[draft.where].append(draft.name)
                continue
            try:
                props = self._find_position(draft, placed_props) if draft.random else draft.make(0)
            except (ConfigError, WorldError) as error:
                faults.append(error)
                continue
            if props is None:
                unplaced.setdefault(draft.where, []).append(draft.name)
                failed.add(draft.entry)
                continue
            placed_props.add(props)
        if faults:
            raise ConfigError(faults=faults)
        tries = f"in {TRIES} tries" if self._draws_left > 0 else f"within {MOST_DRAWS} tries for the whole world"
        return sorted(placed_props.props, key=lambda prop: prop.order), [
            WorldError(
                f"no free position for '{names[0]}'{f' and {len(names) - 1} more' if names[1:] else ''} {tries}; "
                "enlarge the region, or reduce the count or the gaps",
                where=location,
            )
            for location, names in unplaced.items()
        ]

    def _find_position(self, draft: _Draft, placed_props: "_PlacedProps") -> list[PlacedProp] | None:
        """Return a random prop or group where it obeys the rules and keeps its distance, or None."""
        # Once the draws of the world are used up, each prop is tried once, so that loading ends in time.
        for attempt in range(min(TRIES, max(1, self._draws_left))):
            props = draft.make(attempt)
            if all(map(self._allowed, props)) and placed_props.has_room(props):
                return props
            # Counted in props: an attempt of a group costs as much as its props.
            self._draws_left -= len(props)
        return None

    def _drafts(
        self, entry: PropEntry, name: str, draw: Draw, frame: GroupPose, order: _Order, *, depth: int
    ) -> Iterator[_Draft]:
        """Yield the props and groups of one entry in a frame."""
        slots = list(entry.layout.slots(entry, self._areas, draw))
        if len(slots) > LARGEST_COUNT:
            raise ConfigError(f"{len(slots)} props; at most {LARGEST_COUNT} are allowed", where=where(entry))
        group = self._group(entry, depth)
        random = entry.is_random
        for index, slot in enumerate(slots):
            # The index is part of the name and of the random stream: one more prop does not change those before it.
            label = name if entry.at is not None else f"{name}[{index}]"
            item = _Item(entry, label, draw.below(str(index)), slot, frame, (*order, index), depth, self._terrain)
            if group is None:
                yield _Draft(self._prop_maker(item), random, label, where(entry), name)
            elif random:
                yield _Draft(self._group_maker(item, group), True, label, where(entry), name)
            else:
                yield from self._group_drafts(item, group)

    def _prop_maker(self, item: _Item) -> Callable[[int], list[PlacedProp]]:
        def make(attempt: int) -> list[PlacedProp]:
            # Every attempt draws all values of the prop, not only its position, from streams of its own.
            entry, draw = item.entry, item.draw.again(attempt)
            prop = self._prop(entry, draw)
            pose = item.again(attempt).pose()
            roll, pitch = (draw.number(getattr(entry, key), "rad", key, entry) for key in ("roll", "pitch"))
            # Streams are named by their values, so that this order has no effect on what is drawn.
            color = _color(entry, draw)
            if entry.mass is not None:
                mass = draw.number(entry.mass, "kg", "mass", entry)
                if not mass > 0.0:
                    raise ConfigError(f"{mass:g} kg; it must be above 0", where=where(entry, "mass"))
                prop = replace(prop, mass=mass)
            if entry.driven_over is not None:
                prop = replace(prop, driven_over=entry.driven_over)
            if prop.driven_over and not entry.static:
                raise ConfigError(
                    f"false; vehicles drive over '{item.label}', so it is part of the "
                    "ground: make it static, or set driven_over: false",
                    where=where(entry, "static"),
                )
            # Walls, posts and trees stay upright on a slope; what can be moved or driven over lies on it.
            inclined = prop.driven_over or not entry.static
            X_WP = item.standing(pose, RollPitchYaw(roll, pitch, pose.yaw), inclined=inclined)
            return [
                PlacedProp(
                    item.label,
                    prop,
                    X_WP,
                    static=entry.static,
                    color=color,
                    where=where(entry),
                    file_line=file_line(entry),
                    random=entry.is_random,
                    order=item.order,
                )
            ]

        return make

    def _group_maker(self, item: _Item, group: GroupSpec) -> Callable[[int], list[PlacedProp]]:
        def make(attempt: int) -> list[PlacedProp]:
            drafts = self._group_drafts(item.again(attempt), group)
            return [prop for draft in drafts for prop in draft.make(attempt)]

        return make

    def _group_drafts(self, item: _Item, group: GroupSpec) -> list[_Draft]:
        """Return the props and groups of a group in one position."""
        # A misspelt parameter would silently leave the default of the group in place.
        entry, draw = item.entry, item.draw
        for key in entry.with_:
            if key not in group.params:
                hint = did_you_mean(key, group.params) if group.params else "it has no parameters"
                raise ConfigError(
                    f"group '{entry.group}' has no parameter '{key}'; {hint}", where=where(entry, "with", key)
                )
        # Parts of a group are placed relative to it; the draws of each come from a stream below that of the group.
        inner = item.pose()
        parameters = {
            key: draw.parameter(value, f"params.{key}", location=where(group, "params", key))
            for key, value in group.params.items()
        }
        parameters |= {
            key: draw.parameter(value, f"with.{key}", location=where(entry, "with", key))
            for key, value in entry.with_.items()
        }
        # A group sees its own parameters only; `with` passes values of the world to them.
        below = Draw(draw.seed, draw.path, parameters, draw.attempt)
        return [
            draft
            for index, (name, key, part) in enumerate(_named(group.props))
            for draft in self._drafts(
                part, f"{item.label}.{name}", below.below(key), inner, (*item.order, index), depth=item.depth + 1
            )
        ]

    def _group(self, entry: PropEntry, depth: int) -> GroupSpec | None:
        if entry.group is None:
            return None
        if depth >= _DEEPEST:
            raise ConfigError(
                f"more than {_DEEPEST} nested groups; does the group contain itself?", where=where(entry, "group")
            )
        group = self._groups(entry.group)
        if group is None:
            names = self._group_names()
            hint = did_you_mean(entry.group, names) if names else "the world has no groups; add it under groups"
            raise ConfigError(f"unknown group '{entry.group}'; {hint}", where=where(entry, "group"))
        return group

    def _prop(self, entry: PropEntry, draw: Draw) -> Prop:
        """Return the prop of an entry."""
        scale = draw.number(entry.scale, "", "scale", entry)
        if not 1e-3 <= scale <= 1e3:
            raise ConfigError(f"{scale:g}; allowed are 0.001 to 1000", where=where(entry, "scale"))
        size: Size | None = None
        if entry.size is not None:
            length, width, height = draw.numbers(entry.size, "m", "size", entry)
            if not min(length, width, height) > 0.0:
                raise ConfigError("all three must be above 0 m", where=where(entry, "size"))
            size = (length, width, height)
        # Only props that are written for it keep sensible proportions.
        if size is not None and not entry.shape.resizable:
            raise ConfigError(
                "size belongs to a prop that is resizable; change the sides instead", where=where(entry, "size")
            )
        return entry.shape.make(entry, draw, self._folder, size, scale)


class _PlacedProps:
    """Props that are placed already, searched by their bounding boxes.

    Args:
        gap: smallest distance to new props [m].
        may_overlap: whether two props may touch each other.

    Attributes:
        props: the props.
    """

    def __init__(self, gap: float, may_overlap: _MayOverlap) -> None:
        self._gap, self._may_overlap = gap, may_overlap
        self._boxes: NDArray[np.float64] = np.empty((256, 6))
        self.props: list[PlacedProp] = []

    def add(self, props: Sequence[PlacedProp]) -> None:
        """Add props."""
        for prop in props:
            # The array doubles, as appending a row at a time copies all rows for each prop.
            if len(self.props) == len(self._boxes):
                self._boxes = np.vstack((self._boxes, np.empty_like(self._boxes)))
            self._boxes[len(self.props)] = (*prop.footprint.bounds, prop.bottom, prop.top)
            self.props.append(prop)

    def has_room(self, props: Sequence[PlacedProp]) -> bool:
        """Return whether new props keep their distance from all props that are placed."""
        boxes, gap = self._boxes[: len(self.props)], self._gap
        for prop in props:
            # Bounding boxes first, all at once; exact shapes only where these are near.
            xmin, ymin, xmax, ymax = prop.footprint.bounds
            near = (
                (boxes[:, 0] < xmax + gap) & (boxes[:, 2] > xmin - gap)
                & (boxes[:, 1] < ymax + gap) & (boxes[:, 3] > ymin - gap)
                & (boxes[:, 4] < prop.top + gap) & (boxes[:, 5] > prop.bottom - gap)
            )  # fmt: skip
            for index in np.nonzero(near)[0].tolist():
                other = self.props[index]
                if self._may_overlap(prop, other):
                    continue
                # Touching props count as overlapping without a gap; with one, the distance decides.
                if gap == 0.0:
                    if prop.footprint.intersects(other.footprint):
                        return False
                elif prop.footprint.distance(other.footprint) < gap:
                    return False
        return True


def _color(entry: PropEntry, draw: Draw) -> Color | None:
    """Return red, green, blue of numbers or of a CSS colour name."""
    if entry.color is None:
        return None
    if isinstance(entry.color, list):
        red, green, blue = (min(1.0, max(0.0, c)) for c in draw.numbers(entry.color, "", "color", entry))
        return red, green, blue
    return css_color(draw.word(entry.color, "color", entry), where=where(entry, "color"))


def css_color(name: str, *, where: str = "") -> Color:
    """Return red, green, blue, 0 to 1, of a CSS colour name.

    Raises:
        ConfigError: there is no such colour; `where` is the prefix of the message.
    """
    from matplotlib.colors import CSS4_COLORS, to_rgb  # slow to import, and most colours are numbers

    if name not in CSS4_COLORS:
        raise ConfigError(
            f"unknown colour '{name}'; {did_you_mean(name, CSS4_COLORS)}, or [red, green, blue] from 0 to 1",
            where=where,
        )
    red, green, blue = to_rgb(name)
    return red, green, blue


def _named(entries: Sequence[PropEntry]) -> Iterator[tuple[str, str, PropEntry]]:
    """Yield entries with unique names, and keys of their random streams that do not depend on other entries."""
    names: dict[str, int] = {}
    keys: dict[str, int] = {}
    given = {entry.name for entry in entries if entry.name}
    # A generated name must not take one that another entry has in the file.
    for entry in entries:
        label = entry.label
        if entry.name is None:
            while True:
                names[label] = names.get(label, 0) + 1
                name = label if names[label] == 1 else f"{label}_{names[label]}"
                if name not in given:
                    break
            # The key is made of the content, so that inserting another entry does not move props of this one.
            text = json.dumps(entry.model_dump(mode="json", exclude_unset=True), sort_keys=True)
            key = f"{label}-{hashlib.sha256(text.encode()).hexdigest()[:12]}"
            keys[key] = keys.get(key, 0) + 1
            key = key if keys[key] == 1 else f"{key}-{keys[key]}"
        else:
            name = key = entry.name
            names[name] = names.get(name, 0) + 1
            if names[name] > 1:
                raise ConfigError(f"'{name}' is used twice; give each entry its own name", where=where(entry, "name"))
        yield name, key, entry
