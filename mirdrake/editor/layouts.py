"""Layouts of props, starts and goals, and regions, under the mouse."""

import math
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from mirdrake.editor.elements import BODY, Change, Handle, LockedError, Path, Point, Shape, turn_handle
from mirdrake.editor.values import lock_reason, plain_number, write_number
from mirdrake.worlds.world import World

_MOST_POINTS = 200
_LEAST_SPACING = 0.1  # [m] of a row under the mouse


class At(Shape):
    """A position; `default` is where it is without one in the file [m]."""

    key = "at"
    default: Point | None = None

    def handles(self) -> Iterator[Handle]:
        """Yield the position."""
        yield self._point_handle(BODY, default=self.default)


class _GoalAt(At):
    def handles(self) -> Iterator[Handle]:
        """Yield the centre and the radius."""
        body = next(super().handles())
        yield body
        yield _goal_radius((*self.path[:-1], "radius"), self.entry.get("radius"), body)


class _Grid(Shape):
    key = "grid"

    def handles(self) -> Iterator[Handle]:
        """Yield the first position, the spacing as the next one along both axes, and the end of the last cell."""
        x, y = self._point("origin", default=(0.0, 0.0))
        yield Handle(BODY, x, y, lambda x, y: self._set_point(x, y, "origin"))
        dx, dy = self._point("step")
        yield Handle("step", x + dx, y + dy, lambda new_x, new_y: self._set_point(new_x - x, new_y - y, "step"))
        counts = [_plain_count(self._part("count", index)) for index in ("0", "1")]
        if None in counts:
            return
        # Half a cell behind the last prop, where it hides no other handle.
        steps, ends = (dx, dy), [(count or 1) - 0.5 for count in counts]

        def move(new_x: float, new_y: float) -> list[Change]:
            changes: list[Change] = []
            for index, (way, step) in enumerate(zip((new_x - x, new_y - y), steps, strict=True)):
                changes += self._set_count(way / step + 0.5, "count", str(index)) if step else []
            return changes

        yield Handle("count", x + ends[0] * dx, y + ends[1] * dy, move)


class _Row(Shape):
    """Props at equal distances, by `count` or `spacing`."""

    def neighbour(
        self, length: float, at: Callable[[float], Point], way_to: Callable[[float, float], float], *, is_open: bool
    ) -> Iterator[Handle]:
        """Yield the handle of the distance between neighbours, which changes their number or the spacing.

        It is a third of the way to the second prop, where it hides neither props nor other handles.

        Args:
            length: of the row [m].
            at: returns the place at a distance from the first prop [m].
            way_to: returns the distance of a place from the first prop along the row [m].
            is_open: whether the row has a prop at both ends.
        """
        count, spacing = _plain_count(self._part("count")), plain_number(self._part("spacing"), "m")
        more = 1 if is_open else 0
        if count is not None:
            # A row of one prop has no distance; one that is longer than the row means it.
            distance = length / max(0.4, count - more)
        elif spacing is not None and spacing > 0.0:
            distance = length / max(1, math.ceil(length / spacing - 1e-9))
        else:
            return

        def move(x: float, y: float) -> list[Change]:
            wanted = max(_LEAST_SPACING, 3.0 * float(way_to(x, y)))
            return self._set(wanted, "spacing") if count is None else self._set_count(length / wanted + more, "count")

        x, y = at(distance / 3.0)
        yield Handle("spacing", float(x), float(y), move)


class _Line(_Row):
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
        length = math.hypot(x1 - x0, y1 - y0)
        if length > 0.0:
            c, s = (x1 - x0) / length, (y1 - y0) / length
            yield from self.neighbour(
                length,
                lambda way: (x0 + c * way, y0 + s * way),
                lambda x, y: c * (x - x0) + s * (y - y0),
                is_open=True,
            )


class _Ring(Shape):
    key = "ring"

    def handles(self) -> Iterator[Handle]:
        """Yield the centre and the radius."""
        x, y = self._point("center", default=(0.0, 0.0))
        yield Handle(BODY, x, y, lambda x, y: self._set_point(x, y, "center"))
        radius = self._number("radius")

        def move(new_x: float, new_y: float) -> list[Change]:
            # A radius of zero would leave nothing to drag.
            return self._set(max(0.1, math.hypot(new_x - x, new_y - y)), "radius")

        yield Handle("radius", x + radius, y, move)


class _PropRing(_Ring):
    def handles(self) -> Iterator[Handle]:
        """Yield the centre and the radius, and the number of props as the place of the second one."""
        yield from super().handles()
        count = _plain_count(self._part("count"))
        if count is None:
            return
        (x, y), radius = self._point("center", default=(0.0, 0.0)), self._number("radius")
        angle = 2.0 * math.pi / max(count, 2)

        def move(new_x: float, new_y: float) -> list[Change]:
            turned = math.atan2(new_y - y, new_x - x) % (2.0 * math.pi)
            return self._set_count(2.0 * math.pi / max(turned, 1e-3), "count")

        yield Handle("count", x + radius * math.cos(angle), y + radius * math.sin(angle), move)


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


class Points(Shape):
    """A list of points: each can be dragged, all of them move with the body.

    Derived classes give the positions, which expressions may have.
    """

    def __init__(self, path: Path, entry: Mapping[str, Any], world: World) -> None:
        super().__init__(path, entry, world)
        self.points = path

    @abstractmethod
    def positions(self) -> Sequence[Point]:
        """Return the points in W [m]."""

    def handles(self) -> Iterator[Handle]:
        """Yield the mean of the points, which moves all of them, and the points."""
        points = self.positions()
        middle = sum(x for x, _ in points) / len(points), sum(y for _, y in points) / len(points)
        handles = [self._handle(index, point) for index, point in enumerate(points)]

        def move(x: float, y: float) -> list[Change]:
            dx, dy = x - middle[0], y - middle[1]
            moved = [self._set_point(px + dx, py + dy, str(index)) for index, (px, py) in enumerate(points)]
            return [change for changes in moved for change in changes]

        yield Handle(BODY, *middle, move, lock=next((handle.lock for handle in handles if handle.lock), ""))
        # Of a recorded line only the whole is dragged.
        if len(handles) <= _MOST_POINTS:
            yield from handles

    def _handle(self, index: int, point: Point) -> Handle:
        name = f"point {index}"
        try:
            return self._point_handle(name, str(index))
        except LockedError as error:
            return Handle(name, *point, lock=str(error))


class _Polygon(Points):
    key, closed = "polygon", True

    def positions(self) -> list[Point]:
        """Return the corners."""
        return [self._point(str(index)) for index in range(len(self.raw or ()))]


class _Along(_Row):
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
                return self._set(s, "s", str(index))

            yield Handle(name, x, y, self._along(self._part("track"), move))
        # As the layout has it: over the start of a closed track, or backwards on an open one.
        begin, length = ends[0], ends[1] - ends[0]
        length += track.length if track.closed and length < 0.0 else 0.0
        way = math.copysign(1.0, length)

        def way_to(x: float, y: float) -> float:
            s = float(track.project(x, y)[0]) - begin
            return s % track.length if track.closed else way * s

        yield from self.neighbour(
            abs(length),
            lambda distance: track.pose_at(begin + way * distance)[:2],
            way_to,
            is_open=not (track.closed and length >= track.length - 1e-9),
        )


class _Scatter(Shape):
    key = "scatter"

    def handles(self) -> Iterator[Handle]:
        """Yield the handles of its region."""
        region = self._part("region")
        if isinstance(region, str):
            raise LockedError(f"it is drawn in the region '{region}'; move that region instead")
        yield from _region_handles((*self.path, "region"), region, self.world)


class _Band(Shape):
    key = "band"

    def handles(self) -> Iterator[Handle]:
        """Raise: a band has no position of its own."""
        raise LockedError("it follows a track; change its values in the panel")


class _StartAt(At):
    """A start at a position; one without, or the one that a file without starts has, gets it when it is dragged."""

    def handles(self) -> Iterator[Handle]:
        """Yield the position and the heading."""
        start = self.world.starts[self.path[-2]]
        self.default = (start.x, start.y)
        body = next(super().handles())
        yield body
        yield turn_handle((*self.path[:-1], "yaw"), self.entry.get("yaw"), body, reach=4.0, yaw=start.yaw)


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
            changes = self._set(s, "s")
            if self._part("offset") is not None:
                changes += self._set(math.copysign(min(abs(offset), side), offset), "offset")
            return changes

        yield Handle(BODY, x, y, self._along(self._part("track"), move))


class _Gate(Shape):
    key = "gate"

    def handles(self) -> Iterator[Handle]:
        """Yield the place on the track."""
        x, y, _ = self._track(self._part("track")).pose_at(self._number("s") if self._part("s") is not None else 0.0)
        yield Handle(BODY, x, y, self._along(self._part("track"), lambda s, _: self._set(s, "s")))


def _plain_count(raw: Any) -> int | None:
    """Return a number of props of at least 1; None if it is an expression."""
    number = plain_number(raw, "m")
    return int(number) if number is not None and number >= 1.0 else None


def _region_handles(path: Path, raw: Any, world: World) -> Iterator[Handle]:
    if isinstance(raw, Mapping):
        for shape in REGIONS:
            if shape.key in raw:
                yield from shape((*path, shape.key), raw, world).handles()
                return
    raise LockedError("it has no region")


def _goal_radius(path: Path, given: Any, body: Handle) -> Handle:
    radius = plain_number(given if given is not None else 1.0, "m")
    if radius is None:
        return Handle("radius", body.x + 1.0, body.y, lock=lock_reason(given))

    def resize(x: float, y: float) -> list[Change]:
        value = max(0.1, math.hypot(x - body.x, y - body.y))
        return [(path, write_number(value, "m", like=given))]

    return Handle("radius", body.x + radius, body.y, resize)


REGIONS: tuple[type[Shape], ...] = (_Rect, _Disc, _Polygon, _Band)
PROPS: tuple[type[Shape], ...] = (At, _Grid, _Line, _Along, _PropRing, _Scatter)
STARTS: tuple[type[Shape], ...] = (_OnTrack, _StartAt)
GOALS: tuple[type[Shape], ...] = (_GoalAt, _Gate)
"""Layouts by the kind of element; the key of the first one that is in the file decides."""
