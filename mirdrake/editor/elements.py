"""Elements of a world on the map: entries of props, starts, goals and patches, with the handles that move them.

What a layout means under the mouse is one class derived from :class:`Shape` and one line of :data:`SHAPES`: where its
handles are, and which values of the file a moved handle changes.
"""

import math
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

from mirdrake.editor.values import lock_reason, plain_number, write_number
from mirdrake.worlds.tracks import Track

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
class Element:
    """A part of the file that is shown on the map.

    Attributes:
        path: path of the part.
        kind: prop, start, goal or patch.
        label: name in the panel.
        layout: key of its layout.
        handles: points that can be dragged; the first is the body.
    """

    path: Path
    kind: str
    label: str
    layout: str
    handles: tuple[Handle, ...]

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
        raw: the value as it is in the file.
        tracks: tracks of the world.
    """

    key: ClassVar[str]

    def __init__(self, path: Path, raw: Any, tracks: Mapping[str, Track]) -> None:
        self.path, self.raw, self.tracks = path, raw, tracks

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

    def _set(self, value: float, *keys: str) -> Change:
        # `like` keeps the unit and notation that the value has in the file.
        return (*self.path, *keys), write_number(value, "m", like=self._part(*keys))

    def _set_point(self, x: float, y: float, *keys: str) -> list[Change]:
        if self._part(*keys) is None:
            # A point that is not in the file is added as a whole.
            return [((*self.path, *keys), f"[{write_number(x, 'm')}, {write_number(y, 'm')}]")]
        return [self._set(x, *keys, "0"), self._set(y, *keys, "1")]

    def _point_handle(self, name: str, *keys: str) -> Handle:
        """Return the handle of one point of the file, locked if it is not plain."""
        x, y = self._point(*keys)
        return Handle(name, x, y, lambda x, y: self._set_point(x, y, *keys))

    def _along(self, track_name: Any, move: Callable[[float, float], list[Change]]) -> Callable[..., list[Change]]:
        """Return a move that gets s and the offset on a track instead of x and y."""
        track = self._track(track_name)
        # Handles of elements on a track are moved in track coordinates (s, lateral offset).
        return lambda x, y: move(*map(float, track.project(x, y)))

    def _track(self, name: Any) -> Track:
        if not isinstance(name, str) or name not in self.tracks:
            raise LockedError(f"its track '{name}' is not in the world")
        return self.tracks[name]


class _At(Shape):
    key = "at"

    def handles(self) -> Iterator[Handle]:
        """Yield the position."""
        yield self._point_handle(BODY)


class _Grid(Shape):
    key = "grid"

    def handles(self) -> Iterator[Handle]:
        """Yield the first position, and the spacing as the next one along both axes."""
        x, y = self._point("origin", default=(0.0, 0.0))
        yield Handle(BODY, x, y, lambda x, y: self._set_point(x, y, "origin"))
        dx, dy = self._point("step")
        yield Handle("step", x + dx, y + dy, lambda new_x, new_y: self._set_point(new_x - x, new_y - y, "step"))


class _Line(Shape):
    key = "line"

    def handles(self) -> Iterator[Handle]:
        """Yield the middle, which moves both ends, and the ends."""
        (x0, y0), (x1, y1) = self._point("from"), self._point("to")
        middle = (x0 + x1) / 2.0, (y0 + y1) / 2.0

        def move(x: float, y: float) -> list[Change]:
            # Both ends move by the same displacement.
            dx, dy = x - middle[0], y - middle[1]
            return [*self._set_point(x0 + dx, y0 + dy, "from"), *self._set_point(x1 + dx, y1 + dy, "to")]

        yield Handle(BODY, *middle, move)
        yield self._point_handle("from", "from")
        yield self._point_handle("to", "to")


class _Ring(Shape):
    key = "ring"

    def handles(self) -> Iterator[Handle]:
        """Yield the centre and the radius."""
        x, y = self._point("center", default=(0.0, 0.0))
        yield Handle(BODY, x, y, lambda x, y: self._set_point(x, y, "center"))
        radius = self._number("radius")

        def move(new_x: float, new_y: float) -> list[Change]:
            # A radius of zero would leave nothing to drag.
            return [self._set(max(0.1, math.hypot(new_x - x, new_y - y)), "radius")]

        yield Handle("radius", x + radius, y, move)


class _Disc(_Ring):
    key = "disc"


class _Rect(Shape):
    key = "rect"

    def handles(self) -> Iterator[Handle]:
        """Yield the centre and a corner."""
        x, y = self._point("center", default=(0.0, 0.0))
        yield Handle(BODY, x, y, lambda x, y: self._set_point(x, y, "center"))
        length, width = self._point("size")
        yaw = plain_number(self._part("yaw") or 0.0, "rad")
        if yaw is None:
            raise LockedError(lock_reason(self._part("yaw")))
        # The position of the corner in the axes of the rectangle; the size is twice that, as its centre stays.
        c, s = math.cos(yaw), math.sin(yaw)

        def move(new_x: float, new_y: float) -> list[Change]:
            dx, dy = new_x - x, new_y - y
            return self._set_point(max(0.1, 2.0 * abs(c * dx + s * dy)), max(0.1, 2.0 * abs(c * dy - s * dx)), "size")

        yield Handle("corner", x + (c * length - s * width) / 2.0, y + (s * length + c * width) / 2.0, move)


class _Polygon(Shape):
    key = "polygon"

    def handles(self) -> Iterator[Handle]:
        """Yield the mean of the corners, which moves all of them, and the corners."""
        points = [self._point(str(index)) for index in range(len(self.raw))]
        middle = sum(x for x, _ in points) / len(points), sum(y for _, y in points) / len(points)

        def move(x: float, y: float) -> list[Change]:
            dx, dy = x - middle[0], y - middle[1]
            moved = [self._set_point(px + dx, py + dy, str(index)) for index, (px, py) in enumerate(points)]
            return [change for changes in moved for change in changes]

        yield Handle(BODY, *middle, move)
        for index in range(len(points)):
            yield self._point_handle(f"corner {index + 1}", str(index))


class _Along(Shape):
    key = "along"

    def handles(self) -> Iterator[Handle]:
        """Yield the ends of its part of the track."""
        track = self._track(self._part("track"))
        ends = self._point("s", default=(0.0, track.length))
        x, y, _ = track.pose_at(sum(ends) / 2.0)
        yield Handle(BODY, x, y, lock="it follows the track; drag its ends, or change distance or offset in the panel")
        for index, name in enumerate(("begin", "end")):
            x, y, _ = track.pose_at(ends[index])

            # `index` as a default argument binds the value of this pass of the loop.
            def move(s: float, _: float, index: int = index) -> list[Change]:
                if self._part("s") is None:
                    return self._set_point(*((s, ends[1]) if index == 0 else (ends[0], s)), "s")
                return [self._set(s, "s", str(index))]

            yield Handle(name, x, y, self._along(self._part("track"), move))


class _Scatter(Shape):
    key = "scatter"

    def handles(self) -> Iterator[Handle]:
        """Yield the handles of its region."""
        region = self._part("region")
        if isinstance(region, str):
            raise LockedError(f"it is drawn in the region '{region}'; move that region instead")
        yield from _region_handles((*self.path, "region"), region, self.tracks)


class _Band(Shape):
    key = "band"

    def handles(self) -> Iterator[Handle]:
        """Raise: a band has no position of its own."""
        raise LockedError("it follows a track; change its values in the panel")


class _OnTrack(Shape):
    key = "on_track"

    def handles(self) -> Iterator[Handle]:
        """Yield the place on the track."""
        track = self._track(self._part("track"))
        s, offset = (self._number(key) if self._part(key) is not None else 0.0 for key in ("s", "offset"))
        x, y, yaw = track.pose_at(s)
        # Offset to the left of the track: (-sin, cos) is its left normal.
        x, y = x - offset * math.sin(yaw), y + offset * math.cos(yaw)

        def move(s: float, offset: float) -> list[Change]:
            # Kept on the road: the offset is limited by the width on its side.
            side = float(track.left_width(s)) if offset > 0.0 else float(track.right_width(s))
            changes = [self._set(s, "s")]
            if self._part("offset") is not None:
                changes.append(self._set(math.copysign(min(abs(offset), side), offset), "offset"))
            return changes

        yield Handle(BODY, x, y, self._along(self._part("track"), move))


class _Gate(Shape):
    key = "gate"

    def handles(self) -> Iterator[Handle]:
        """Yield the place on the track."""
        x, y, _ = self._track(self._part("track")).pose_at(self._number("s") if self._part("s") is not None else 0.0)
        yield Handle(BODY, x, y, self._along(self._part("track"), lambda s, _: [self._set(s, "s")]))


SHAPES: Mapping[str, type[Shape]] = {
    shape.key: shape
    for shape in (_At, _Grid, _Line, _Ring, _Along, _Scatter, _Rect, _Disc, _Polygon, _Band, _OnTrack, _Gate)
}
"""Layouts and regions by their key in the file."""

_LAYOUTS = {
    "prop": ("at", "grid", "line", "along", "ring", "scatter"),
    "start": ("at", "on_track"),
    "goal": ("at", "gate"),
    "patch": ("rect", "disc", "polygon", "band"),
}
_ARM = 2.0  # [m], distance of the handle that turns an element, where its size is not known


def make_element(
    path: Path, kind: str, raw: Mapping[str, Any], *, tracks: Mapping[str, Track], reach: float = _ARM
) -> Element:
    """Return the element of a part of the file.

    Args:
        path: path of the part.
        kind: prop, start, goal or patch.
        raw: the part as it is in the file.
        tracks: tracks of the world.
        reach: distance of the handle that turns it [m].
    """
    # The first key of a layout that is there decides, as in the schema only one is allowed.
    layout = next((key for key in _LAYOUTS[kind] if key in raw), "")
    label = path[-1] if kind in {"start", "goal"} else str(raw.get("name") or _content(raw) or f"{kind} {path[-1]}")
    try:
        if not layout:
            raise LockedError("it has no position of its own")
        handles = list(SHAPES[layout]((*path, layout), raw[layout], tracks).handles())
    except LockedError as error:
        # A locked element stays in the list, so that it can be selected and its values edited in the panel.
        return Element(path, kind, label, layout, (Handle(BODY, math.nan, math.nan, lock=str(error)),))
    if layout == "at" and kind in {"prop", "start"}:
        handles.append(_turn_handle(path, raw, handles[0], reach))
    if kind == "goal" and layout == "at":
        handles.append(_goal_radius(path, raw, handles[0]))
    return Element(path, kind, label, layout, tuple(handles))


def _content(raw: Mapping[str, Any]) -> str:
    for key in ("prop", "group", "file"):
        if key in raw:
            return str(raw[key])
    return next((key for key in ("box", "cylinder", "sphere") if key in raw), "")


def _region_handles(path: Path, raw: Any, tracks: Mapping[str, Track]) -> Iterator[Handle]:
    for key in _LAYOUTS["patch"]:
        if isinstance(raw, Mapping) and key in raw:
            yield from SHAPES[key]((*path, key), raw[key], tracks).handles()
            return
    raise LockedError("it has no region")


def _turn_handle(path: Path, raw: Mapping[str, Any], body: Handle, reach: float) -> Handle:
    given = raw.get("yaw")
    yaw = plain_number(given if given is not None else 0.0, "rad")
    if yaw is None:
        return Handle(TURN, body.x + reach, body.y, lock=lock_reason(given))

    def turn(x: float, y: float) -> list[Change]:
        angle = math.atan2(y - body.y, x - body.x)
        return [((*path, "yaw"), write_number(angle, "rad", like=given))]

    return Handle(TURN, body.x + reach * math.cos(yaw), body.y + reach * math.sin(yaw), turn)


def _goal_radius(path: Path, raw: Mapping[str, Any], body: Handle) -> Handle:
    given = raw.get("radius")
    radius = plain_number(given if given is not None else 1.0, "m")
    if radius is None:
        return Handle("radius", body.x + 1.0, body.y, lock=lock_reason(given))

    def resize(x: float, y: float) -> list[Change]:
        value = max(0.1, math.hypot(x - body.x, y - body.y))
        return [((*path, "radius"), write_number(value, "m", like=given))]

    return Handle("radius", body.x + radius, body.y, resize)
