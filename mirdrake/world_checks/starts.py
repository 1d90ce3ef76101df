"""Starts and goals that are outside the ground or inside a prop."""

from collections.abc import Iterable, Iterator

import numpy as np
import shapely

from mirdrake.core.yaml_io import where
from mirdrake.world_checks import sentences
from mirdrake.world_checks.faults import Fault, Kind
from mirdrake.world_checks.obstacles import Body, obstacles_of
from mirdrake.world_checks.overlaps import Neighbours
from mirdrake.world_checks.paths import goal_area
from mirdrake.worlds import PlacedProp, World
from mirdrake.worlds.clearance import Volume, clearance, place_outline

_MOST = 20  # props that are reported at one start
_HEIGHTS = 0.1, 1.0  # [m] heights between which a prop is an obstacle for an unknown vehicle


def find_bad_start(world: World, near: Neighbours, name: str, body: Body, volume: Volume) -> list[Fault]:
    """Return the faults of a start for a vehicle: outside the ground, or overlapping props."""
    start, location = world.starts[name], where(world.spec, "start", name)
    pose = (np.array([start.x]), np.array([start.y]), np.array([start.yaw]))
    corners = body.corners(*pose)[0]
    faults = []
    xmin, ymin, xmax, ymax = world.ground.extent
    over = max(
        xmin - corners[:, 0].min(), corners[:, 0].max() - xmax, ymin - corners[:, 1].min(), corners[:, 1].max() - ymax
    )
    if over > 0.0:
        message = sentences.start_off_ground(body.name, name, float(over), world.ground.extent)
        faults.append(Fault("start", message, location, (), float(over), (start.x, start.y, 0.0)))
    poses = np.column_stack(pose)
    # The union of the slabs is what the vehicle covers from above: props beside it need no check in height.
    covered = shapely.union_all([shapely.Polygon(place_outline(slab.outline, poses)[0]) for slab in volume.slabs])
    for number in near.touching(covered):
        if len(faults) > _MOST:
            break
        prop = near.props[number]
        depth = -float(clearance(volume, poses, [prop])[0])
        # Contact and rounding are not a collision.
        if depth <= 1e-4:
            continue
        # The solid that the vehicle is deepest in shows best where the fault is.
        solids = [obstacle.outline for obstacle in obstacles_of(near, number, volume.low, volume.high)]
        outline = max(solids, key=lambda solid: covered.intersection(solid.area).area)
        shared = covered.intersection(outline.area)
        middle = shared.centroid
        message = sentences.start_in_prop(body.name, name, prop, depth, middle.x, middle.y)
        polygon = tuple((float(x), float(y)) for x, y in shapely.get_coordinates(shared.convex_hull)[:-1])
        height = 0.5 * (max(outline.bottom, 0.0) + min(outline.top, body.height))
        faults.append(Fault("start", message, location, (prop.name,), depth, (middle.x, middle.y, height), polygon))
    return faults


def find_inside_props(world: World, near: Neighbours, *, starts: Iterable[str], goals: Iterable[str]) -> list[Fault]:
    """Return the faults of starts and goals whose centre is inside a prop, for those that no vehicle was tried on.

    Args:
        world: the world.
        near: its props.
        starts: names of starts.
        goals: names of goals.
    """
    faults = []
    for key, name in [("start", name) for name in starts] + [("goals", name) for name in goals]:
        point = shapely.Point(world.starts[name].x, world.starts[name].y) if key == "start" else None
        # Goals that are areas are represented by their middle.
        if key == "goals":
            area = goal_area(world, name)
            point = area.centroid if area is not None else None
        prop = next(_around(near, point), None) if point is not None else None
        if point is not None and prop is not None:
            kind: Kind = "start" if key == "start" else "goal"
            message = sentences.inside_prop(kind, name, prop, point.x, point.y)
            location = where(world.spec, key, name)
            faults.append(Fault(kind, message, location, (prop.name,), None, (point.x, point.y, 0.0)))
    return faults


def _around(near: Neighbours, point: shapely.Point) -> Iterator[PlacedProp]:
    """Yield the props that contain a point on the ground."""
    for index in near.touching(point):
        if any(obstacle.outline.area.intersects(point) for obstacle in obstacles_of(near, index, *_HEIGHTS)):
            yield near.props[index]
