"""The world of a text with its elements: what the page shows and what gestures act on."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from mirdrake.core.yaml_io import parse_tree, shown
from mirdrake.editor.elements import Element as Element
from mirdrake.editor.elements import LockedError, make_element
from mirdrake.world_checks.overlaps import Neighbours
from mirdrake.worlds.loading import parse_world
from mirdrake.worlds.props import PlacedProp
from mirdrake.worlds.world import World


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
    """Return the scene of a text.

    Raises:
        ConfigError: the text has faults.
        WorldError: the world cannot be laid out.
    """
    world = parse_world(text, path)
    data, _ = parse_tree(text, shown(path))
    return Scene(text, data, world, {element.key: element for element in _elements(data, world)})


def _elements(data: Mapping[str, Any], world: World) -> Iterator[Element]:
    reach: dict[int, float] = {}
    for placed in world.props:
        entry = placed.order[0]
        reach[entry] = max(reach.get(entry, 0.0), 0.5 * math.hypot(*placed.prop.size[:2]) + 0.8)
    for index, entry in enumerate(data.get("props") or []):
        size = min(8.0, reach.get(index, 2.0))
        yield make_element(("props", str(index)), "prop", entry, tracks=world.tracks, reach=size)
    for name, start in (data.get("start") or {}).items():
        yield make_element(("start", name), "start", start or {}, tracks=world.tracks, reach=4.0)
    for name, goal in (data.get("goals") or {}).items():
        yield make_element(("goals", name), "goal", goal, tracks=world.tracks)
    for index, patch in enumerate((data.get("ground") or {}).get("patches") or []):
        yield make_element(("ground", "patches", str(index)), "patch", patch, tracks=world.tracks)
