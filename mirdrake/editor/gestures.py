"""Gestures of the page as changes of the text of a world file.

A gesture is a JSON object with a ``kind``; each kind is one class with a ``text`` method, and :data:`GESTURES` is the
only list. A gesture changes the text as little as possible, or is rejected with the reason.
"""

import math
import re
from abc import abstractmethod
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter, ValidationError

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_edit import scalar_text
from mirdrake.core.yaml_io import Schema
from mirdrake.core.yaml_items import insert_item, item_text, remove_item, set_scalar, set_scalars
from mirdrake.editor.elements import BODY, Change, LockedError
from mirdrake.editor.scene import Scene
from mirdrake.editor.values import write_number
from mirdrake.worlds.actors import WALKER_LENGTH
from mirdrake.worlds.props import PlacedProp, load_prop
from mirdrake.worlds.world import World

_CROSSING, _AHEAD = 8.0, 30.0  # [m], paths of new actors
_WALK, _DRIVE = 1.4, 8  # [m/s], their speeds
_LINE_END = re.compile(r"(\r\n|\r|\n)")

Meters = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]


class Gesture(Schema):
    """A change of the world that a user makes on the page."""

    @abstractmethod
    def text(self, scene: Scene, name: str) -> str:
        """Return the changed text of the scene's file; `name` is that of the file.

        Raises:
            LockedError: a value is not a plain number, or the element is gone.
            ConfigError: the text cannot be changed so.
        """


class Move(Schema):
    """A handle of an element at a new position."""

    element: str = Field(description="key of the element [-]")
    handle: str = Field(default=BODY, description="name of the handle [-]")
    x: Meters = Field(description="new position [m]")
    y: Meters = Field(description="new position [m]")


class DragGesture(Gesture):
    """Handles are moved."""

    kind: Literal["drag"] = Field(description="[-]")
    moves: Annotated[list[Move], Field(min_length=1, max_length=1000)] = Field(description="handles that moved [-]")

    def text(self, scene: Scene, name: str) -> str:
        """Return the changed text."""
        return _apply(scene.text, changes_of(scene, self.moves), name)


class SetGesture(Gesture):
    """A value is typed in the panel."""

    kind: Literal["set"] = Field(description="[-]")
    path: Annotated[list[str], Field(min_length=1, max_length=40)] = Field(description="path of the value [-]")
    value: Annotated[str, Field(max_length=1000)] = Field(description="the new text of the value [-]")

    def text(self, scene: Scene, name: str) -> str:
        """Return the changed text; an empty value removes the key."""
        if not self.value.strip():
            return remove_item(scene.text, self.path, name=name)
        return set_scalar(scene.text, self.path, self.value.strip(), name=name)


class InsertGesture(Gesture):
    """A prop, group or actor of the palette is dropped on the map, or a start or goal is added."""

    kind: Literal["insert"] = Field(description="[-]")
    what: Literal["prop", "group", "actor", "start", "goal"] = Field(description="[-]")
    name: Annotated[str, Field(min_length=1, max_length=200)] = Field(
        description="name of the prop, group, start or goal"
    )
    x: Meters = Field(description="position [m]")
    y: Meters = Field(description="position [m]")

    def text(self, scene: Scene, name: str) -> str:
        """Return the changed text, with one line more."""
        # Written in one line with the fewest values, so that the file stays readable.
        position = f"at: [{write_number(self.x, 'm')}, {write_number(self.y, 'm')}]"
        if self.what in {"prop", "group"}:
            item = f"{{{self.what}: {scalar_text(self.name)}, {position}}}"
            return insert_item(scene.text, ("props",), item, name=name)
        if self.what == "actor":
            item = f"{{actor: {scalar_text(self.name)}, {_motion(scene.world, self.name, self.x, self.y)}}}"
            return insert_item(scene.text, ("actors",), item, name=name)
        key = "start" if self.what == "start" else "goals"
        used = scene.data.get(key) or {}
        label = _free_name(self.name, used)
        entry = f"{{{position}, yaw: 0 deg}}" if self.what == "start" else f"{{{position}, radius: 2}}"
        return set_scalar(scene.text, (key, label), entry, name=name)


class DeleteGesture(Gesture):
    """Elements are removed with their comments."""

    kind: Literal["delete"] = Field(description="[-]")
    elements: Annotated[list[str], Field(min_length=1, max_length=1000)] = Field(description="their keys [-]")

    def text(self, scene: Scene, name: str) -> str:
        """Return the changed text."""
        text = scene.text
        # The last entry of a list first, so that the indices of the others stay.
        paths = sorted((scene.element(key).path for key in set(self.elements)), key=_order, reverse=True)
        for path in paths:
            text = remove_item(text, path, name=name)
        return text


class InsertPointGesture(Gesture):
    """A point is added to a polygon, a path or the control points of a road."""

    kind: Literal["insert_point"] = Field(description="[-]")
    element: str = Field(description="its key [-]")
    index: Annotated[int, Field(ge=0)] = Field(description="number of the point that it comes before [-]")
    x: Meters = Field(description="position [m]")
    y: Meters = Field(description="position [m]")

    def text(self, scene: Scene, name: str) -> str:
        """Return the changed text."""
        point = f"[{write_number(self.x, 'm')}, {write_number(self.y, 'm')}]"
        return insert_item(scene.text, _points_of(scene, self.element), point, index=self.index, name=name)


class DeletePointGesture(Gesture):
    """A point is removed."""

    kind: Literal["delete_point"] = Field(description="[-]")
    element: str = Field(description="its key [-]")
    index: Annotated[int, Field(ge=0)] = Field(description="number of the point [-]")

    def text(self, scene: Scene, name: str) -> str:
        """Return the changed text."""
        return remove_item(scene.text, (*_points_of(scene, self.element), str(self.index)), name=name)


class CopyGesture(Gesture):
    """Entries of props and actors are repeated at the end of their list, displaced."""

    kind: Literal["copy"] = Field(description="[-]")
    elements: Annotated[list[str], Field(min_length=1, max_length=200)] = Field(description="their keys [-]")
    dx: Meters = Field(description="displacement [m]")
    dy: Meters = Field(description="displacement [m]")

    def text(self, scene: Scene, name: str) -> str:
        """Return the changed text."""
        text = scene.text
        names = {key: {entry.get("name") for entry in scene.data.get(key) or []} for key in ("props", "actors")}
        counts = {key: len(scene.data.get(key) or []) for key in names}
        for key in self.elements:
            element = scene.element(key)
            item = item_text(scene.text, element.path)
            if element.kind not in {"prop", "actor"} or item is None:
                raise LockedError(f"{element.label} cannot be copied; only entries of props and actors can")
            where = element.path[0]
            copy = (where, str(counts[where]))
            text = insert_item(text, (where,), item, name=name)
            # The copy is moved by the changes that would move the original, applied to the new index.
            changes = _shifted(scene, Move(element=key, x=0.0, y=0.0), self.dx, self.dy)
            text = _apply(text, [((*copy, *path[2:]), value) for path, value in changes], name)
            given = scene.data[where][int(element.path[1])].get("name")
            if given is not None:
                label = _free_name(str(given), names[where])
                names[where].add(label)
                text = _apply(text, [((*copy, "name"), scalar_text(label))], name)
            # The next copy comes after this one.
            counts[where] += 1
        return text


class ExpandGesture(Gesture):
    """An entry of several props becomes one entry for each, at their present positions."""

    kind: Literal["expand"] = Field(description="[-]")
    element: str = Field(description="its key [-]")

    def text(self, scene: Scene, name: str) -> str:
        """Return the changed text; random values become the present ones."""
        element, props = scene.element(self.element), scene.props_of(self.element)
        # An entry with a group or a shape has no single prop to repeat.
        entry = scene.data["props"][int(element.path[1])] if element.kind == "prop" else {}
        if "prop" not in entry or not props:
            raise LockedError(f"{element.label} cannot be expanded; only entries with 'prop' can")
        text = scene.text
        for placed in props:
            # Appended first and removed afterwards: the index of the entry stays until then.
            text = insert_item(text, ("props",), _single_entry(placed, entry), name=name)
        return remove_item(text, element.path, name=name)


class TextGesture(Gesture):
    """The text is typed beside the map."""

    kind: Literal["text"] = Field(description="[-]")
    value: str = Field(description="the whole text [-]")

    def text(self, scene: Scene, name: str) -> str:  # noqa: ARG002  # all gestures share one signature
        """Return the typed text with the line ends of the file."""
        return with_line_ends(self.value, scene.text)


GESTURES = (
    DragGesture | SetGesture | InsertGesture | InsertPointGesture | DeletePointGesture | DeleteGesture | CopyGesture
    | ExpandGesture | TextGesture
)  # fmt: skip
"""All gestures."""

_ADAPTER: TypeAdapter[Gesture] = TypeAdapter(Annotated[GESTURES, Field(discriminator="kind")])


def read_gesture(message: Mapping[str, Any]) -> Gesture:
    """Return the gesture of a JSON object.

    Raises:
        ConfigError: the object is not a valid gesture.
    """
    try:
        return _ADAPTER.validate_python(dict(message))
    except ValidationError as error:
        fault = error.errors()[0]
        raise ConfigError(f"not a gesture: {'.'.join(map(str, fault['loc']))}: {fault['msg']}") from None


def with_line_ends(typed: str, before: str) -> str:
    """Return a text of a browser, which has line feeds only, with the line ends of the text before.

    Lines at the beginning and the end that have not changed keep their own; new ones have that of the first line.
    """
    parts, new = _LINE_END.split(before), _LINE_END.sub("\n", typed).split("\n")
    old, ends = parts[::2], parts[1::2]
    usual = ends[0] if ends else "\n"
    shorter = min(len(old), len(new))
    same = next((i for i in range(shorter) if old[i] != new[i]), shorter)
    tail = next((i for i in range(shorter - same) if old[-1 - i] != new[-1 - i]), shorter - same)
    moved = len(old) - len(new)  # of the lines at the end

    def end_of(line: int) -> str:
        number = line if line < same else line + moved if line >= len(new) - tail else len(ends)
        return ends[number] if number < len(ends) else usual

    return "".join(line + end_of(number) for number, line in enumerate(new[:-1])) + new[-1]


def changes_of(scene: Scene, moves: list[Move]) -> list[Change]:
    """Return the changes of the file for moved handles.

    Raises:
        LockedError: a handle cannot be dragged.
    """
    changes: list[Change] = []
    for move in moves:
        element = scene.element(move.element)
        handle = element.handle(move.handle)
        if handle.lock:
            raise LockedError(f"{element.label}: {handle.lock}")
        changes += handle.move(move.x, move.y)
    return changes


def _points_of(scene: Scene, key: str) -> tuple[str, ...]:
    element = scene.element(key)
    if element.points is None or element.handles[0].lock:
        raise LockedError(f"{element.label}: {element.handles[0].lock or 'it has no points'}")
    return element.points


def _motion(world: World, prop: str, x: float, y: float) -> str:
    """Return place and speed of a new actor: along the road below it, else on a straight path of its own."""
    length = load_prop(prop).size[0]
    walks = length <= WALKER_LENGTH
    track = next((name for name, road in world.roads().items() if not walks and road.inside(x, y)), None)
    if track is not None:
        place = (
            f"on_track: {{track: {scalar_text(track)}, s: {write_number(world.tracks[track].project(x, y)[0], 'm')}}}"
        )
    else:
        # A pedestrian crosses a road of usual width; a vehicle drives ahead.
        end = (x, y + _CROSSING) if walks else (x + _AHEAD, y)
        points = [f"[{write_number(px, 'm')}, {write_number(py, 'm')}]" for px, py in ((x, y), end)]
        place = f"path: [{', '.join(points)}]"
    return f"{place}, speed: {_WALK if walks else _DRIVE}"


def _shifted(scene: Scene, move: Move, dx: float, dy: float) -> list[Change]:
    handle = scene.element(move.element).handle(move.handle)
    return changes_of(scene, [move.model_copy(update={"x": handle.x + dx, "y": handle.y + dy})])


def _apply(text: str, changes: list[Change], name: str) -> str:
    return set_scalars(text, changes, name=name, keep_quotes=True) if changes else text


def _order(path: tuple[str, ...]) -> tuple[str, int]:
    # By list, then by index as a number: "10" must come after "9".
    return ".".join(path[:-1]), int(path[-1]) if path[-1].isdecimal() else 0


def _free_name(wanted: str, used: Any) -> str:
    number, name = 2, wanted
    while name in used:
        name, number = f"{wanted}_{number}", number + 1
    return name


def _single_entry(placed: PlacedProp, entry: Mapping[str, Any]) -> str:
    """Return the entry of one prop in one position, as YAML in one line."""
    x, y, z = placed.X_WP.translation().tolist()
    R = placed.X_WP.rotation().matrix()
    # Yaw of the first column of R: the direction of the prop's x axis.
    yaw = math.atan2(R[1, 0], R[0, 0])
    values = [write_number(x, "m"), write_number(y, "m")]
    # Height, yaw and colour only if they differ from the default, to keep the entry short.
    if abs(z) > 5e-4:
        values.append(write_number(z, "m"))
    parts = [f"prop: {scalar_text(placed.prop.name)}", f"at: [{', '.join(values)}]"]
    if abs(yaw) > 1e-4:
        parts.append(f"yaw: {write_number(yaw, 'rad')}")
    if placed.color is not None:
        parts.append(f"color: [{', '.join(f'{part:.3g}' for part in placed.color)}]")
    if not placed.static:
        parts.append("static: false")
    # What is a plain value in the entry stays as it is written there.
    for key in ("name", "scale", "size", "mass", "pitch", "roll"):
        value = entry.get(key)
        if key == "name" and value is not None:
            parts.append(f"name: {scalar_text(placed.name.replace('[', '_').replace(']', ''))}")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            parts.append(f"{key}: {value}")
        elif value is not None and key != "name":
            # A random or computed value would be the same for all copies, or drawn anew for each.
            raise LockedError(f"{key}: {value} is not a plain number; write the entries by hand")
    return f"{{{', '.join(parts)}}}"
