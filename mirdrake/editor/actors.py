"""Actors under the mouse: their place on a lane or path, their path, and the places of their triggers."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from mirdrake.editor.elements import BODY, Change, Handle, LockedError, Outline, Path, Point, Shape
from mirdrake.editor.layouts import Points
from mirdrake.editor.values import lock_reason, plain_number, write_number
from mirdrake.worlds.actor_entries import split_condition
from mirdrake.worlds.actors import Actor, FullActor
from mirdrake.worlds.actors_spec import Condition
from mirdrake.worlds.world import World

_LEAST_SPACING = 1.0  # [m] of a row under the mouse
_CORNERS = 64  # of a circle


def actors_of(world: World, entry: int) -> list[Actor | FullActor]:
    """Return the actors that an entry of the file makes; those of a row are in the order of the row."""
    by_name = {actor.name: actor for actor in world.moving}
    specs = zip(world.spec.actors, world.actor_entries, strict=True)
    return [by_name[spec.name] for spec, number in specs if number == entry]


class _Placed(Shape):
    """A place on a lane, with `s` and `offset`."""

    def handles(self) -> Iterator[Handle]:
        """Yield the place of the actor, of a row that of the first one."""
        given = [key for key in ("s", "offset") if self._part(key) is not None]
        for key in given:
            self._number(key)  # raises if it is not plain
        actors = actors_of(self.world, int(self.path[1]))
        if not actors:
            raise LockedError("its count is 0")
        first = actors[0]

        def move(x: float, y: float) -> list[Change]:
            changes = self._set(self._station(x, y), "s")
            if "offset" in given:
                # Kept in its lane.
                lane = self.world.lanes[first.lane]
                s, offset = (float(value) for value in lane.project(x, y))
                room = 0.5 * float(lane.width_at(s))
                changes += self._set(max(-room, min(room, offset)), "offset")
            return changes

        x, y, _ = self.world.actor_start(first)
        yield Handle(BODY, x, y, move)

    def _station(self, x: float, y: float) -> float:
        """Return the value of `s` for a point [m]."""
        return float(self._track(self._part("track")).project(x, y)[0])


class _OnTrack(_Placed):
    key = "on_track"


class _OnLane(_Placed):
    key = "on_lane"

    def _station(self, x: float, y: float) -> float:
        return float(self.world.lanes[str(self._part("lane"))].project(x, y)[0])


class _Row(_Placed):
    key = "along"

    def handles(self) -> Iterator[Handle]:
        """Yield the place of the first actor, and the spacing at the second one."""
        yield from super().handles()
        actors = actors_of(self.world, int(self.path[1]))
        if len(actors) < 2:
            return
        x, y, _ = self.world.actor_start(actors[1])
        # A spacing that is an expression or a random draw cannot be dragged: the pointer would replace it by a number.
        begin = plain_number(self._part("s") or 0.0, "m")
        raw = self._part("spacing")
        if begin is None or plain_number(raw, "m") is None:
            yield Handle("spacing", x, y, lock=lock_reason(raw))
            return
        yield Handle(
            "spacing", x, y, lambda x, y: self._set(max(_LEAST_SPACING, self._station(x, y) - begin), "spacing")
        )


class _ActorPath(Points):
    key = "path"

    def positions(self) -> Sequence[Point]:
        """Return the corners of the path."""
        path = actors_of(self.world, int(self.path[1]))[0].spec.path
        assert path is not None
        return path


ACTORS: tuple[type[Shape], ...] = (_OnTrack, _OnLane, _Row, _ActorPath)


def decorations(path: Path, data: Mapping[str, Any], world: World) -> tuple[list[Handle], list[Outline]]:
    """Return the handles of the triggers of an entry of `actors`, and the paths and places to be drawn.

    Args:
        path: path of the entry.
        data: the whole file.
        world: the world.
    """
    entry, actors = data["actors"][int(path[1])], actors_of(world, int(path[1]))
    handles: list[Handle] = []
    outlines: list[Outline] = []
    if actors:
        outlines.append(_way(world, actors[0]))
    for actor in actors:
        steps = (data.get("scenario") or {}).get(actor.name) or []
        # What the file has, and what became of it.
        triggers = [((*path, "starts"), entry.get("starts"), actor.spec.starts)]
        triggers += [
            (("scenario", actor.name, str(number)), raw, step)
            for number, (raw, step) in enumerate(zip(steps, actor.steps, strict=True))
        ]
        # Only triggers by distance or place have something to drag.
        for where, raw, trigger in triggers:
            if trigger is None or trigger.when is None:
                continue
            name = f"trigger {len(handles)}" if where[0] == "scenario" else "trigger"
            part = _trigger((*where, "when"), raw["when"], trigger.when, actor, world, name)
            if part is not None:
                handles.append(part[0])
                outlines.append(part[1])
    return handles, outlines


def _way(world: World, actor: Actor | FullActor) -> Outline:
    """Return the lane or path of an actor from its place on."""
    lane = world.lanes[actor.lane]
    s = np.append(actor.s, lane.s[lane.s > actor.s + 1e-3])
    x, y, _ = lane.pose(s, actor.offset)
    return Outline("path", np.column_stack((x, y)), actor.lane in world.paths)


def _trigger(
    path: Path, raw: Any, condition: Condition, actor: Actor | FullActor, world: World, name: str
) -> tuple[Handle, Outline] | None:
    """Return the handle and the outline of a condition that has a place; None for others."""
    x, y, _ = world.actor_start(actor)
    # Stations beside the track make no sense: the mark is as wide as the road, and the pointer is projected on the
    # track.
    if condition.kind == "past" and condition.track in world.tracks:
        track = world.tracks[condition.track]
        px, py, _ = track.pose_at(condition.value)
        ends = [-float(track.right_width(condition.value)), float(track.left_width(condition.value))]
        outline = Outline("trigger", np.column_stack(track.point(condition.value, ends)), moves=False)
        return _value_handle(name, px, py, path, raw, lambda x, y: float(track.project(x, y)[0])), outline
    # The circle follows the actor while it is dragged, as the distance is measured from it.
    if condition.kind == "distance":
        angle = np.linspace(0.0, 2.0 * np.pi, _CORNERS + 1)
        circle = np.column_stack((x + condition.value * np.cos(angle), y + condition.value * np.sin(angle)))
        outline = Outline("trigger", circle, moves=True)
        edge = x - condition.value, y
        return _value_handle(name, *edge, path, raw, lambda px, py: max(0.5, math.hypot(px - x, py - y))), outline
    return None


def _value_handle(name: str, x: float, y: float, path: Path, raw: Any, value_at: Any) -> Handle:
    """Return the handle of the number of a condition: a text with a number at its end, or a mapping with a value."""
    words, number = "", raw.get("value") if isinstance(raw, Mapping) else None
    if isinstance(raw, str) and (parts := split_condition(raw)) is not None:
        words, number = parts
    if plain_number(number, "m") is None:
        return Handle(name, x, y, lock=lock_reason(number))
    where = path if words else (*path, "value")
    return Handle(name, x, y, lambda x, y: [(where, f"{words}{write_number(value_at(x, y), 'm', like=number)}")])
