"""Whether a vehicle can get from one place to another; if not, why."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from mirdrake.core.errors import did_you_mean
from mirdrake.world_checks.faults import spot
from mirdrake.world_checks.gaps import Gap, Passage
from mirdrake.world_checks.obstacles import Array, Body, Obstacle, Room
from mirdrake.world_checks.search import SEARCH_TIME, search_way
from mirdrake.worlds import World
from mirdrake.worlds.props import PlacedProp

_NEAR = 0.5  # [m] of a start that is driven to
_GATE = 0.5  # [m] half of the thickness of a gate


@dataclass(frozen=True)
class Way:
    """A way that a vehicle can drive.

    Attributes:
        vehicle: its name.
        start: name of the start.
        goal: name of the goal, or start, that it leads to.
        poses: (n, 3) of the vehicle's frame B: x, y [m], yaw [rad].
    """

    vehicle: str
    start: str
    goal: str
    poses: Array

    @property
    def length(self) -> float:
        """[m]."""
        return float(np.hypot(*np.diff(self.poses[:, :2], axis=0).T).sum())


def goal_area(world: World, name: str) -> BaseGeometry | None:
    """Where a vehicle's origin has to get for a goal, or a start; None for laps, and for unknown names.

    A gate is a line, here 1 m thick; a start is a disc of half a metre.
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


def find_way(
    world: World,
    body: Body,
    obstacles: Sequence[Obstacle],
    start: str,
    goal: str,
    *,
    margin: float = 0.0,
    patience: float = SEARCH_TIME,
) -> Way | str:
    """A way for a vehicle, or why there is none, without ``file:line``.

    The ground's extent is a wall. The vehicle must have room at its start.

    Args:
        world: where.
        body: of the vehicle.
        obstacles: in its way.
        start: name of the start.
        goal: name of a goal with a place, or of a start.
        margin: that it keeps on all sides [m].
        patience: computing time after which the search is given up [s].
    """
    area = goal_area(world, goal)
    if area is None:
        return f"'{goal}' has no place; {did_you_mean(goal, [*world.goals, *world.starts])}"
    begin = world.starts[start]
    wide = body.wider(margin)
    around = np.array([[begin.x, begin.y], *np.reshape(area.bounds, (2, 2)).tolist()])
    room = Room(obstacles, world.ground.extent, wide, around)
    kept = f" with {margin:g} m on each side" if margin else ""
    whom = f"no way for {body.text}{kept} from '{start}' to '{goal}'"
    if not room.domain.intersects(area):
        return f"{whom}: '{goal}' lies beyond the ground"
    gap = _too_narrow(room, area, (begin.x, begin.y, begin.yaw))
    if gap is not None:
        return f"{whom}: {_told(gap, obstacles, world.props, 2.0 * wide.half_width)}"
    found = search_way(room, (begin.x, begin.y, begin.yaw), area, patience=patience)
    if found.outcome == "found":
        return Way(body.name, start, goal, found.way)
    nearest = f"it gets as far as {spot(*found.nearest)}"
    if found.outcome == "none":
        return f"{whom}: it is wide enough everywhere, but it cannot turn there, even with reversing; {nearest}"
    return f"{whom} was found within {patience:g} s of computing; {nearest}"


def _too_narrow(room: Room, area: BaseGeometry, pose: tuple[float, float, float]) -> Gap | None:
    """Where a disc in the vehicle's box gets stuck: one about its origin, and one about the box's middle."""
    body = room.body
    x, y, yaw = pose
    small = min(body.half_width, -body.rear, body.front)
    middle = 0.5 * (body.rear + body.front)
    for ahead, radius, goal in ((0.0, small, area), (middle, body.half_width, area.buffer(abs(middle)))):
        if radius <= 0.0:
            continue
        place = x + ahead * float(np.cos(yaw)), y + ahead * float(np.sin(yaw))
        passage = Passage(room.areas, room.domain, place, goal)
        if not passage.is_open(radius - 1e-6):
            return passage.narrowest(radius)
    return None


def _told(gap: Gap, obstacles: Sequence[Obstacle], props: Sequence[PlacedProp], needed: float) -> str:
    if gap.place is None:
        return "nothing leads there"
    names = list(dict.fromkeys(f"'{props[obstacles[index].prop].name}'" for index in gap.between))
    between = f", {'between' if len(names) > 1 else 'at'} {' and '.join(names)}" if names else ""
    return f"the widest way is {gap.width:.2f} m wide at {spot(*gap.place)}{between}; {needed:.2f} m are needed"
