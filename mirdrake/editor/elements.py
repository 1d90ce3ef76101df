"""Elements of a world on the map: parts of the file with the handles that move them.

What a layout means under the mouse is one class derived from :class:`Shape` and one name in
:data:`mirdrake.editor.scene.SHAPES`: where its handles are, and which values of the file a moved handle changes.
"""

import math
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

from mirdrake.editor.values import lock_reason, plain_number, write_number
from mirdrake.worlds.pieces import Array
from mirdrake.worlds.tracks import Track
from mirdrake.worlds.world import World

Path = tuple[str, ...]
Change = tuple[Path, str]
"""A path in the file and its new value as YAML."""

Point = tuple[float, float]

BODY = "body"
"""Name of the handle that moves an element as a whole."""

TURN = "yaw"
"""Name of the handle that turns an element about its body."""


class LockedError(Exception):
    """A gesture would change a value that is not a plain number; the message states why."""


@dataclass(frozen=True)
class Handle:
    """A point that can be dragged.

    Attributes:
        name: unique in its element.
        x, y: where it is [m].
        move: returns the changes of the file for a new position of the handle [m].
        lock: why it cannot be dragged; empty if it can.
    """

    name: str
    x: float
    y: float
    move: Callable[[float, float], list[Change]] = field(repr=False, default=lambda _x, _y: [])
    lock: str = ""


@dataclass(frozen=True)
class Outline:
    """A line of an element beside the element itself.

    Attributes:
        role: path of an actor, or the place of a trigger.
        points: (n, 2) in W [m].
        moves: whether it is moved with the element.
    """

    role: Literal["path", "trigger"]
    points: Array
    moves: bool


@dataclass(frozen=True)
class Element:
    """A part of the file that is shown on the map.

    Attributes:
        path: path of the part.
        kind: prop, actor, start, goal, patch or track.
        label: name in the panel.
        layout: key of its layout.
        handles: points that can be dragged; the first is the body.
        outlines: its path and triggers, of an actor.
        points: path of its list of points, to which points can be added; None if it has none.
        closed: the last of these points is joined to the first.
    """

    path: Path
    kind: str
    label: str
    layout: str
    handles: tuple[Handle, ...]
    outlines: tuple[Outline, ...] = ()
    points: Path | None = None
    closed: bool = False

    @property
    def key(self) -> str:
        """The path as one text, the element's name for the page."""
        return "/".join(self.path)

    def handle(self, name: str) -> Handle:
        """Return the handle of a name.

        Raises:
            LockedError: the name is unknown.
        """
        for handle in self.handles:
            if handle.name == name:
                return handle
        raise LockedError(f"{self.label} has no handle '{name}'")


class Shape:
    """Handles and movements of a layout or region in the editor.

    Args:
        path: path of the value of the layout's key.
        entry: the part of the file that has this key.
        world: the world.

    Attributes:
        raw: the value as it is in the file; None if it is not there.
        points: path of its list of points, if it has one.
        closed: the last of these points is joined to the first.
    """

    key: ClassVar[str]
    points: Path | None = None
    closed: bool = False

    def __init__(self, path: Path, entry: Mapping[str, Any], world: World) -> None:
        self.path, self.entry, self.world = path, entry, world
        self.raw = entry.get(self.key)

    @abstractmethod
    def handles(self) -> Iterator[Handle]:
        """Yield the handles, that of the body first.

        Raises:
            LockedError: the element as a whole cannot be dragged.
        """

    # The helpers below read plain numbers and write them back where they are.

    def _part(self, *keys: str) -> Any:
        part = self.raw
        for key in keys:
            if isinstance(part, Mapping):
                part = part.get(key)
            elif isinstance(part, Sequence) and not isinstance(part, str) and int(key) < len(part):
                part = part[int(key)]
            else:
                return None
        return part

    def _number(self, *keys: str) -> float:
        raw = self._part(*keys)
        number = plain_number(raw, "m")
        if number is None:
            raise LockedError(lock_reason(raw))
        return number

    def _point(self, *keys: str, default: Point | None = None) -> Point:
        # A default serves keys that the file leaves out.
        if default is not None and self._part(*keys) is None:
            return default
        return self._number(*keys, "0"), self._number(*keys, "1")

    def _set(self, value: float, *keys: str) -> list[Change]:
        # `like` keeps the unit and notation that the value has in the file.
        raw = self._part(*keys)
        written, present = write_number(value, "m", like=raw), plain_number(raw, "m")
        # A number that stays keeps its digits.
        same = present is not None and written == write_number(present, "m", like=raw)
        return [] if same else [((*self.path, *keys), written)]

    def _set_count(self, number: float, *keys: str) -> list[Change]:
        return self._set(float(max(1, round(number))), *keys)

    def _set_point(self, x: float, y: float, *keys: str) -> list[Change]:
        if self._part(*keys) is None:
            # A point that is not in the file is added as a whole.
            return [((*self.path, *keys), f"[{write_number(x, 'm')}, {write_number(y, 'm')}]")]
        return [*self._set(x, *keys, "0"), *self._set(y, *keys, "1")]

    def _point_handle(self, name: str, *keys: str, default: Point | None = None) -> Handle:
        """Return the handle of one point of the file.

        Raises:
            LockedError: it is not plain.
        """
        x, y = self._point(*keys, default=default)
        return Handle(name, x, y, lambda x, y: self._set_point(x, y, *keys))

    def _along(self, track_name: Any, move: Callable[[float, float], list[Change]]) -> Callable[..., list[Change]]:
        """Return a move that gets s and the offset on a track instead of x and y."""
        track = self._track(track_name)
        # Handles of elements on a track are moved in track coordinates (s, lateral offset).
        return lambda x, y: move(*map(float, track.project(x, y)))

    def _track(self, name: Any) -> Track:
        if not isinstance(name, str) or name not in self.world.tracks:
            raise LockedError(f"its track '{name}' is not in the world")
        return self.world.tracks[name]


def turn_handle(path: Path, given: Any, body: Handle, *, reach: float, yaw: float = 0.0) -> Handle:
    """Return the handle that turns an element about its body.

    Args:
        path: path of the angle.
        given: the angle as it is in the file; None if it is not there.
        body: the handle of the body.
        reach: distance of the handle from the body [m].
        yaw: the angle without one in the file [rad].
    """
    number = yaw if given is None else plain_number(given, "rad")
    if number is None:
        return Handle(TURN, body.x + reach, body.y, lock=lock_reason(given))

    def turn(x: float, y: float) -> list[Change]:
        return [(path, write_number(math.atan2(y - body.y, x - body.x), "rad", like=given))]

    return Handle(TURN, body.x + reach * math.cos(number), body.y + reach * math.sin(number), turn)
