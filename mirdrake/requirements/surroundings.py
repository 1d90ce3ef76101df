"""Actors and other vehicles around a vehicle: clearance, contacts between samples, gaps, time to collision."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from mirdrake.controllers.behaviours.outline import volume_of
from mirdrake.vehicles import Vehicle
from mirdrake.worlds import World
from mirdrake.worlds.clearance import Array, Slab, Volume, clearance_between
from mirdrake.worlds.sweeps import first_contacts, times_to_contact

GAP = "gap to "
"""Begin of the name of a signal: the clearance to one vehicle or actor [m]."""

TIME_TO_COLLISION = "time_to_collision"


@dataclass(frozen=True)
class Mover:
    """Something that moves: a vehicle or an actor.

    Attributes:
        name: its name.
        volume: its collision shapes in its frame.
        poses: x, y [m] and yaw [rad] of its frame at the samples (n, 3).
        velocities: of the origin of its frame in W (n, 2) [m/s].
    """

    name: str
    volume: Volume
    poses: Array
    velocities: Array

    def outline_at(self, row: int) -> Array:
        """Return the corners (k, 2) of its outline in W at a sample [m]."""
        x, y, yaw = self.poses[row]
        c, s = np.cos(yaw), np.sin(yaw)
        return np.asarray(self.volume.outline @ np.array([[c, s], [-s, c]]) + [x, y])


def movers_of(
    world: World, actors: pd.DataFrame, signals: Mapping[str, Array], vehicles: Mapping[str, Vehicle]
) -> Iterator[Mover]:
    """Yield the vehicles and the actors of a run.

    Args:
        world: world of the run.
        actors: samples of its actors.
        signals: samples of its vehicles.
        vehicles: vehicles by name.
    """
    for name, vehicle in vehicles.items():
        if f"{name}.x" in signals:
            x, y, yaw, vx, vy = (signals[f"{name}.{key}"] for key in ("x", "y", "yaw", "vx", "vy"))
            # Vehicles record their velocity in their own frame; rotate it to W.
            turned = np.column_stack((vx * np.cos(yaw) - vy * np.sin(yaw), vx * np.sin(yaw) + vy * np.cos(yaw)))
            yield Mover(name, volume_of(vehicle), np.column_stack((x, y, yaw)), turned)
    for actor in world.actors:
        if f"{actor.name}.x" in actors:
            keys = [f"{actor.name}.{key}" for key in ("x", "y", "yaw", "speed")]
            x, y, yaw, speed = actors[keys].to_numpy(dtype=float).T
            # The recorded speed of an actor is along its heading.
            velocity = np.column_stack((speed * np.cos(yaw), speed * np.sin(yaw)))
            yield Mover(actor.name, actor.volume, np.column_stack((x, y, yaw)), velocity)


def clearance_to(mover: Mover, others: Sequence[Mover], at_most: Array) -> Array:
    """Return the clearance to the nearest of other movers [m] (n), or `at_most` where that is smaller.

    Only those are compared that can be nearer than the nearest one, by the circles around them.

    Args:
        mover: the vehicle.
        others: the others.
        at_most: clearance that is known already (n) [m].
    """
    result = at_most.copy()
    for other in others:
        # Lower bound of the clearance by circles around both; the exact distance is computed only where it can matter.
        away = np.hypot(*(mover.poses[:, :2] - other.poses[:, :2]).T)
        rows = np.flatnonzero(away - mover.volume.reach - other.volume.reach < result)
        if rows.size:
            free = clearance_between(mover.volume, mover.poses, other.volume, other.poses, rows=rows)
            result = np.minimum(result, free)
    return result


def gap_to(mover: Mover, other: Mover) -> Array:
    """Return the clearance to one other mover [m] (n)."""
    return clearance_between(mover.volume, mover.poses, other.volume, other.poses)


def touches(mover: Mover, others: Iterable[Mover]) -> NDArray[np.bool_]:
    """Return whether a mover has touched another one since the sample before (n)."""
    result = np.zeros(len(mover.poses), dtype=bool)
    for other in others:
        result |= np.isfinite(first_contacts(mover.volume, mover.poses, other.volume, other.poses))
    return result


def time_to_collision(mover: Mover, others: Iterable[Mover], world: World) -> Array:
    """Return the time until a mover touches another one or a prop if all keep their velocities [s] (n); inf: never."""
    result = np.full(len(mover.poses), math.inf)
    standing = np.zeros_like(mover.velocities)
    for other in others:
        result = np.minimum(
            result,
            times_to_contact(mover.volume, mover.poses, mover.velocities, other.volume, other.poses, other.velocities),
        )
    for prop in world.props:
        # Only objects at the same height can be touched; what is driven over or overhead cannot.
        if prop.prop.driven_over or prop.top <= mover.volume.low or prop.bottom >= mover.volume.high:
            continue
        # Props do not move: a mover at its centroid with zero velocity, cut into slabs of equal height.
        middle = np.array([*prop.footprint.centroid.coords[0]])
        slabs = [
            Slab(shapely.get_coordinates(area)[:-1] - middle, slab.low, slab.high)
            for slab in mover.volume.slabs
            for area in prop.between(slab.low, slab.high)
        ]
        place = np.tile([*middle, 0.0], (len(mover.poses), 1))
        volume = Volume(tuple(slabs), mover.volume.low)
        result = np.minimum(
            result, times_to_contact(mover.volume, mover.poses, mover.velocities, volume, place, standing)
        )
    return result
