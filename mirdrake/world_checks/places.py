"""Starts and goals: on the ground, and not in a prop."""

from collections.abc import Iterable, Iterator

import numpy as np
import shapely

from mirdrake.core.yaml_io import where
from mirdrake.world_checks.faults import Fault, Kind, amount, spot
from mirdrake.world_checks.obstacles import Body, obstacles_of
from mirdrake.world_checks.overlaps import Neighbours, place_of
from mirdrake.world_checks.ways import goal_area
from mirdrake.worlds import PlacedProp, World
from mirdrake.worlds.clearance import Volume, clearance, place_outline

_MOST = 20  # props that are reported at one start
_HEIGHTS = 0.1, 1.0  # [m] heights between which something is in the way of a vehicle that nobody has named


def find_bad_start(world: World, near: Neighbours, name: str, body: Body, volume: Volume) -> list[Fault]:
    """What is wrong with a start for a vehicle: beyond the ground, or its collision shapes in props."""
    start, place = world.starts[name], where(world.spec, "start", name)
    pose = (np.array([start.x]), np.array([start.y]), np.array([start.yaw]))
    corners = body.corners(*pose)[0]
    faults = []
    xmin, ymin, xmax, ymax = world.ground.extent
    over = max(
        xmin - corners[:, 0].min(), corners[:, 0].max() - xmax, ymin - corners[:, 1].min(), corners[:, 1].max() - ymax
    )
    if over > 0.0:
        text = (
            f"{place}: {body.name} at '{name}' stands {amount(float(over))} beyond the ground, which reaches from "
            f"{spot(xmin, ymin)} to {spot(xmax, ymax)}; move the start or set ground.size"
        )
        faults.append(Fault("start", text, (), float(over), (start.x, start.y, 0.0)))
    there = np.column_stack(pose)
    covered = shapely.union_all([shapely.Polygon(place_outline(slab.outline, there)[0]) for slab in volume.slabs])
    for number in near.at(covered):
        if len(faults) > _MOST:
            break
        prop = near.props[number]
        depth = -float(clearance(volume, there, [prop])[0])
        if depth <= 1e-4:
            continue
        solids = [obstacle.outline for obstacle in obstacles_of(near, number, volume.low, volume.high)]
        outline = max(solids, key=lambda solid: covered.intersection(solid.area).area)
        shared = covered.intersection(outline.area)
        middle = shared.centroid
        text = (
            f"{place}: {body.name} at '{name}' stands in '{prop.name}' ({place_of(prop)}), {amount(depth)} deep at "
            f"{spot(middle.x, middle.y)}; move the start or the prop"
        )
        polygon = tuple((float(x), float(y)) for x, y in shapely.get_coordinates(shared.convex_hull)[:-1])
        height = 0.5 * (max(outline.bottom, 0.0) + min(outline.top, body.height))
        faults.append(Fault("start", text, (prop.name,), depth, (middle.x, middle.y, height), polygon))
    return faults


def find_walled_in(world: World, near: Neighbours, *, starts: Iterable[str], goals: Iterable[str]) -> list[Fault]:
    """Starts, and goals with a place, whose middle is in a prop; for those that no vehicle has been tried on.

    Args:
        world: where.
        near: its props.
        starts: names of the starts to look at.
        goals: names of the goals to look at.
    """
    faults = []
    for key, name in [("start", name) for name in starts] + [("goals", name) for name in goals]:
        point = shapely.Point(world.starts[name].x, world.starts[name].y) if key == "start" else None
        if key == "goals":
            area = goal_area(world, name)
            point = area.centroid if area is not None else None
        prop = next(_around(near, point), None) if point is not None else None
        if point is not None and prop is not None:
            what: Kind = "start" if key == "start" else "goal"
            text = (
                f"{where(world.spec, key, name)}: {what} '{name}' at {spot(point.x, point.y)} is in '{prop.name}' "
                f"({place_of(prop)}); move the {what} or the prop"
            )
            faults.append(Fault(what, text, (prop.name,), None, (point.x, point.y, 0.0)))
    return faults


def _around(near: Neighbours, point: shapely.Point) -> Iterator[PlacedProp]:
    """The props that a point on the ground is in."""
    for index in near.at(point):
        if any(obstacle.outline.area.intersects(point) for obstacle in obstacles_of(near, index, *_HEIGHTS)):
            yield near.props[index]
