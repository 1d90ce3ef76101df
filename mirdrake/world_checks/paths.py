"""Paths of a vehicle from a start to a goal; if there is none, the reason."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from mirdrake.world_checks import sentences
from mirdrake.world_checks.obstacles import Array, Body, Obstacle, Room
from mirdrake.world_checks.passages import Bottleneck, Passage
from mirdrake.world_checks.search import SEARCH_TIME, search_path
from mirdrake.worlds import PlacedProp, World

_NEAR = 0.5  # [m] radius of a start that is a goal
_GATE = 0.5  # [m] half of the thickness of a gate


@dataclass(frozen=True)
class VehiclePath:
    """A path that a vehicle can drive.

    Attributes:
        vehicle: name of the vehicle.
        start: name of the start.
        goal: name of the goal or start at its end.
        poses: (n, 3) of the vehicle's frame B: x, y [m], yaw [rad].
    """

    vehicle: str
    start: str
    goal: str
    poses: Array

    @property
    def length(self) -> float:
        """Length of the path [m]."""
        return float(np.hypot(*np.diff(self.poses[:, :2], axis=0).T).sum())


def goal_area(world: World, name: str) -> BaseGeometry | None:
    """Return the area that a vehicle's origin must reach for a goal or start; None for laps and unknown names.

    A gate is a line that is 1 m thick here; a start is a disc with a radius of 0.5 m.
    """
    goal = world.goals.get(name)
    if goal is not None and goal.gate is not None:
        track, s = world.tracks[goal.gate[0]], np.array([goal.gate[1]])
        ends = [np.ravel(track.point(s, offset)).tolist() for offset in (-track.right_width(s), track.left_width(s))]
        return shapely.LineString(ends).buffer(_GATE, cap_style="flat")
    if goal is not None:
        return goal.area
    start = world.starts.get(name)
    return shapely.Point(start.x, start.y).buffer(_NEAR) if start is not None else None


def find_path(
    world: World,
    body: Body,
    obstacles: Sequence[Obstacle],
    start: str,
    goal: str,
    *,
    margin: float = 0.0,
    time_limit: float = SEARCH_TIME,
) -> VehiclePath | str:
    """Return a path for a vehicle, or the message that there is none.

    The edge of the ground is a wall. The vehicle must be free at its start.

    Args:
        world: the world.
        body: the vehicle.
        obstacles: its obstacles.
        start: name of the start.
        goal: name of a goal with an area, or of a start.
        margin: distance from obstacles on all sides [m].
        time_limit: computing time of the search [s].
    """
    area = goal_area(world, goal)
    if area is None:
        return sentences.goal_without_area(goal, world)
    begin = world.starts[start]
    wide = body.wider(margin)
    around = np.array([[begin.x, begin.y], *np.reshape(area.bounds, (2, 2)).tolist()])
    room = Room(obstacles, world.ground.extent, wide, around)
    pose = begin.x, begin.y, begin.yaw

    def failed(reason: str) -> str:
        return sentences.no_path(body.text, margin, start, goal, reason)

    # A bottleneck for a disc inside the vehicle's box is a proof, and names the props; the search comes after it.
    if not room.domain.intersects(area):
        return failed(f"'{goal}' is outside the ground")
    bottleneck = _find_bottleneck(room, area, pose)
    if bottleneck is not None:
        return failed(_reason(bottleneck, obstacles, world.props, 2.0 * wide.half_width))
    result = search_path(room, pose, area, time_limit=time_limit)
    if result.outcome == "found":
        return VehiclePath(body.name, start, goal, result.path)
    if result.outcome == "none":
        return failed(sentences.cannot_turn(result.nearest))
    return failed(sentences.search_ended(time_limit, result.nearest))


def _find_bottleneck(room: Room, area: BaseGeometry, pose: tuple[float, float, float]) -> Bottleneck | None:
    """Return where discs in the vehicle's box are stopped: one about its origin, and one about the box's centre."""
    body = room.body
    x, y, yaw = pose
    # The box contains both discs in every pose, so that a disc that cannot pass proves that no path exists. At a goal
    # the centre of the box is within its distance from the origin.
    small = min(body.half_width, -body.rear, body.front)
    middle = 0.5 * (body.rear + body.front)
    for ahead, radius, goal in ((0.0, small, area), (middle, body.half_width, area.buffer(abs(middle)))):
        if radius <= 0.0:
            continue
        centre = x + ahead * float(np.cos(yaw)), y + ahead * float(np.sin(yaw))
        passage = Passage(room.areas, room.domain, centre, goal)
        if not passage.is_open(radius - 1e-6):
            return passage.narrowest(radius)
    return None


def _reason(bottleneck: Bottleneck, obstacles: Sequence[Obstacle], props: Sequence[PlacedProp], needed: float) -> str:
    if bottleneck.position is None:
        return "the goal is enclosed"
    names = list(dict.fromkeys(props[obstacles[index].prop].name for index in bottleneck.between))
    return sentences.too_narrow(bottleneck.width, bottleneck.position, names, needed)
