"""Actors that overlap one another, or a vehicle at its start, at t = 0."""

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np
import shapely

from mirdrake.controllers.behaviours.outline import volume_of
from mirdrake.core.errors import MirdrakeError, Place
from mirdrake.core.yaml_io import where
from mirdrake.vehicles import load_vehicle
from mirdrake.world_checks import sentences
from mirdrake.world_checks.faults import Fault
from mirdrake.world_checks.overlaps import LEAST_DEPTH
from mirdrake.worlds import World
from mirdrake.worlds.actors import Actor, FullActor
from mirdrake.worlds.clearance import Volume, clearance_between, place_outline
from mirdrake.worlds.pieces import Array
from mirdrake.worlds.recorded import recorded_rows, recorded_start


class Standing(NamedTuple):
    """An actor or a vehicle at t = 0: its name and place in the world file, its volume, and x, y, yaw of its frame."""

    name: str
    where: Place
    volume: Volume
    pose: Array

    @property
    def file_line(self) -> str:
        """``file:line`` of its entry."""
        return Place(self.where.file, self.where.line)

    @property
    def area(self) -> shapely.Polygon:
        """What it covers, seen from above."""
        return shapely.Polygon(place_outline(self.volume.outline, self.pose[None])[0])

    def depth(self, other: "Standing") -> float:
        """Return the depth of the overlap with another one [m], negative for their distance."""
        return -float(clearance_between(self.volume, self.pose[None], other.volume, other.pose[None])[0])


def place_actors(world: World, failed: Callable[[MirdrakeError], None]) -> list[Standing]:
    """Return the actors of a world at t = 0 in the order of the file.

    Args:
        world: the world.
        failed: called with the error of an actor whose vehicle cannot be loaded; the actor is left out.
    """
    order = {spec.name: index for index, spec in enumerate(world.spec.actors)}
    actors: list[Standing] = []
    for actor in sorted(world.moving, key=lambda actor: order[actor.name]):
        location = where(actor.spec, "actor")
        try:
            volume = actor.volume if isinstance(actor, Actor) else volume_of(load_vehicle(actor.model, where=location))
        except MirdrakeError as error:
            failed(error)
        else:
            actors.append(Standing(actor.name, location, volume, _pose(world, actor)))
    return actors


def _pose(world: World, actor: Actor | FullActor) -> Array:
    if actor.spec.recorded is None:
        return np.array(world.actor_start(actor))
    return np.array(recorded_start(recorded_rows(actor.spec, actor.rear_axle)))


def find_actor_overlaps(actors: Sequence[Standing]) -> list[Fault]:
    """Return a fault for each actor that overlaps one before it in the file; the first of those is named."""
    areas = np.array([actor.area for actor in actors], dtype=object)
    faults, found = [], set()
    first, second = shapely.STRtree(areas).query(areas, predicate="intersects")
    for a, b in sorted(zip(first.tolist(), second.tolist(), strict=True)):
        # One fault an actor: a row of them in one place has as many faults as actors, not as pairs.
        if a < b and b not in found and (depth := actors[a].depth(actors[b])) > LEAST_DEPTH:
            found.add(b)
            message, names = sentences.actors_overlap(actors[b], actors[a], depth), (actors[b].name, actors[a].name)
            faults.append(_fault(actors[b], actors[a], names, depth, message))
    return faults


def find_actors_at(start: Standing, actors: Iterable[Standing]) -> list[Fault]:
    """Return the faults of a vehicle at a start, whose name it has, that overlaps actors."""
    depths = [(start.depth(actor), actor) for actor in actors if start.area.intersects(actor.area)]
    return [
        _fault(start, actor, (actor.name,), depth, sentences.start_in_actor(start, actor, depth))
        for depth, actor in depths
        if depth > LEAST_DEPTH
    ]


def _fault(one: Standing, other: Standing, names: tuple[str, ...], depth: float, message: str) -> Fault:
    shared = one.area.intersection(other.area)
    polygon = tuple((float(x), float(y)) for x, y in shapely.get_coordinates(shared.convex_hull)[:-1])
    middle = shared.centroid
    return Fault("actor", message, one.where, names, depth, (middle.x, middle.y, 0.0), polygon)
