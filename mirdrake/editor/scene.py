"""The world of a text with its elements: what the page shows and what gestures act on."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from mirdrake.core.yaml_io import display_path, parse_tree
from mirdrake.editor.actors import ACTORS, decorations
from mirdrake.editor.elements import BODY, Element, Handle, LockedError, Shape, turn_handle
from mirdrake.editor.layouts import GOALS, PROPS, REGIONS, STARTS
from mirdrake.editor.roads import TRACKS
from mirdrake.world_checks.overlaps import Neighbours
from mirdrake.worlds.loading import parse_world
from mirdrake.worlds.props import PlacedProp
from mirdrake.worlds.world import World

_ARM = 2.0  # [m], distance of the handle that turns an element, where its size is not known


@dataclass(frozen=True)
class Scene:
    """A text, its plain data, its world and its elements by key."""

    text: str
    data: Mapping[str, Any]
    world: World
    elements: Mapping[str, Element]

    def element(self, key: str) -> Element:
        """Return the element of a key.

        Raises:
            LockedError: the element was deleted.
        """
        if key not in self.elements:
            raise LockedError(f"'{key}' is not in the world any more")
        return self.elements[key]

    def props_of(self, key: str) -> list[PlacedProp]:
        """Return the props that an element places."""
        return [placed for placed in self.world.props if prop_key(placed) == key]

    @cached_property
    def near(self) -> Neighbours:
        """The search for props that are near each other."""
        return Neighbours(self.world.props)


def prop_key(placed: PlacedProp) -> str:
    """Return the key of the element that places a prop; one inside a group belongs to the entry of the group."""
    return f"props/{placed.order[0]}"


def read_scene(text: str, path: Path) -> Scene:
    """Return the scene of the text of a world file.

    Raises:
        ConfigError: the text has faults.
        WorldError: the world cannot be laid out.
    """
    world = parse_world(text, path)
    data, _ = parse_tree(text, display_path(path))
    return Scene(text, data, world, {element.key: element for element in _elements(data, world)})


SHAPES: Mapping[str, tuple[type[Shape], ...]] = {
    "prop": PROPS, "actor": ACTORS, "start": STARTS, "goal": GOALS, "patch": REGIONS, "track": TRACKS,
}  # fmt: skip
"""Layouts by the kind of element; the key of the first one that is in the file decides."""


def _elements(data: Mapping[str, Any], world: World) -> Iterator[Element]:
    reach: dict[int, float] = {}
    for placed in world.props:
        number = placed.order[0]
        reach[number] = max(reach.get(number, 0.0), 0.5 * math.hypot(*placed.prop.size[:2]) + 0.8)
    for index, entry in enumerate(data.get("props") or []):
        element = _element(("props", str(index)), "prop", entry, world)
        # The handle that turns a prop is outside of its outline.
        if element.layout == "at" and math.isfinite((body := element.handles[0]).x):
            arm = min(8.0, reach.get(index, _ARM))
            turn = turn_handle((*element.path, "yaw"), entry.get("yaw"), body, reach=arm)
            element = replace(element, handles=(body, turn))
        yield element
    for index, entry in enumerate(data.get("actors") or []):
        element = _element(("actors", str(index)), "actor", entry, world)
        handles, outlines = decorations(element.path, data, world)
        yield replace(element, handles=(*element.handles, *handles), outlines=tuple(outlines))
    # A file without starts has one all the same.
    for name, start in (data.get("start") or dict.fromkeys(world.starts)).items():
        yield _element(("start", name), "start", start or {}, world)
    for name, goal in (data.get("goals") or {}).items():
        yield _element(("goals", name), "goal", goal, world)
    for index, patch in enumerate((data.get("ground") or {}).get("patches") or []):
        yield _element(("ground", "patches", str(index)), "patch", patch, world)
    for name, track in (data.get("tracks") or {}).items():
        yield _element(("tracks", name), "track", track, world)


def _element(path: tuple[str, ...], kind: str, entry: Mapping[str, Any], world: World) -> Element:
    """Return the element of a part of the file."""
    shapes = SHAPES[kind]
    # A start without a place gets a position when it is dragged.
    kinds = [shape for shape in shapes if shape.key in entry] or [shape for shape in shapes if kind == "start"][-1:]
    named = kind in {"start", "goal", "track"}
    label = path[-1] if named else str(entry.get("name") or _content(entry) or f"{kind} {path[-1]}")
    layout = kinds[0].key if kinds else ""
    shape = kinds[0]((*path, layout), entry, world) if kinds else None
    try:
        if shape is None:
            raise LockedError("it has no position of its own")
        handles = tuple(shape.handles())
    except LockedError as error:
        # A locked element stays in the list, so that it can be selected and its values edited in the panel.
        return Element(path, kind, label, layout, (Handle(BODY, math.nan, math.nan, lock=str(error)),))
    return Element(path, kind, label, layout, handles, points=shape.points, closed=shape.closed)


def _content(entry: Mapping[str, Any]) -> str:
    for key in ("prop", "group", "file", "actor"):
        if key in entry:
            return str(entry[key])
    return next((key for key in ("box", "cylinder", "sphere") if key in entry), "")
