"""Roads under the mouse: control points, and the pose of a road of segments."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from mirdrake.editor.elements import Handle, LockedError, Path, Point, Shape, turn_handle
from mirdrake.editor.layouts import At, Points
from mirdrake.worlds.world import World

_ARM = 8.0  # [m], distance of the handle that turns a road


class _TrackPoints(Points):
    key = "points"

    def __init__(self, path: Path, entry: Mapping[str, Any], world: World) -> None:
        super().__init__(path, entry, world)
        self.closed = world.tracks[path[1]].closed

    def positions(self) -> Sequence[Point]:
        """Return the control points."""
        if self.entry.get("start") is not None:
            raise LockedError("start moves its points; change start in the panel")
        return self.world.spec.tracks[self.path[1]].points or []


class _Segments(Shape):
    key = "segments"

    def handles(self) -> Iterator[Handle]:
        """Yield the pose at its beginning."""
        start = self.entry.get("start") or {}
        # Read and written as `start: {at, yaw}`, beside the segments.
        place = At((*self.path[:-1], "start", "at"), start, self.world)
        x, y, yaw = self.world.tracks[self.path[1]].pose_at(0.0)
        place.default = (x, y)
        body = next(place.handles())
        yield body
        yield turn_handle((*self.path[:-1], "start", "yaw"), start.get("yaw"), body, reach=_ARM, yaw=yaw)


class _Foreign(Shape):
    """A centre line that other values or files give."""

    reason = "it comes from a file; change it there, or its values in the panel"

    def handles(self) -> Iterator[Handle]:
        """Raise: it has no points of its own."""
        raise LockedError(self.reason)


class _Csv(_Foreign):
    key = "csv"


class _Xodr(_Foreign):
    key = "xodr"


class _Random(_Foreign):
    key, reason = "random", "it is drawn at random; change its values in the panel"


class _Route(_Foreign):
    key, reason = "route", "it follows the lanes of the network; change from and to in the panel"


TRACKS: tuple[type[Shape], ...] = (_TrackPoints, _Segments, _Csv, _Xodr, _Random, _Route)
