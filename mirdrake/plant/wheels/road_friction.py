"""Friction of the ground that varies with the position: patches, verges and tracks of a world.

Whenever a wheel reaches ground of another friction, the parameter of its tyre in the Context is changed.
"""

from collections.abc import Mapping
from math import hypot, inf, sqrt

import numpy as np
import shapely
from pydrake.systems.framework import Context

from mirdrake.plant.plant import PlantParts
from mirdrake.plant.wheels.tyre_forces import TyreSystem

_ACCELERATION = 30.0
"""Upper bound of a wheel's acceleration, for the time until its next check [m/s²]."""

_NEAR = 1e-3  # distance from an edge within which a wheel is checked in every step [m]


class RoadFriction:
    """Monitor that sets the friction of the tyres to that of the ground below them.

    It is not a system, as a system must not change the Context of another one: pass :meth:`watch` to a Simulator as
    its monitor. :class:`mirdrake.runs.simulation.Simulation` does so.

    Args:
        parts: plant, world and vehicles.
        tyres: tyre systems of the vehicles, by name of the vehicle.

    Attributes:
        varies: whether the friction changes anywhere; if not, :meth:`watch` has no effect.
    """

    def __init__(self, parts: PlantParts, tyres: Mapping[str, TyreSystem]) -> None:
        self._parts, self._world = parts, parts.world
        areas = self._world.friction_areas
        self.varies = len({self._world.ground.mu, *(mu for _, mu in areas)}) > 1
        self._edges = shapely.MultiLineString([line for area, _ in areas for line in _lines(area)])
        # The distance to the edges is asked for often; a prepared geometry has an index.
        shapely.prepare(self._edges)
        self._wheels = [[joint.child_body() for joint in part.wheels] for part in parts.vehicles.values()]
        self._models = [tyres[name] for name in parts.vehicles]
        self._due: list[float] = []
        self._next = -inf
        self._now: list[list[float]] = []

    def start(self) -> None:
        """Reset for a new Context."""
        self._due, self._next = [-inf] * len(self._wheels), -inf
        self._now = [[self._world.road_mu] * len(bodies) for bodies in self._wheels]

    def watch(self, context: Context) -> None:
        """Check the vehicles of which a wheel may have reached other ground, and update their friction.

        Args:
            context: context of the whole diagram, changed.
        """
        time = context.get_time()
        # Called after each step: it must cost nothing while no wheel can have reached an edge.
        if time < self._next:
            return
        if not self._due:
            self.start()
        plant = self._parts.plant
        plant_context = plant.GetMyContextFromRoot(context)
        for index, bodies in enumerate(self._wheels):
            if time < self._due[index]:
                continue
            # All wheels of a vehicle at once: for shapely, four points take hardly longer than one.
            places = np.array([plant.EvalBodyPoseInWorld(plant_context, body).translation() for body in bodies])
            speeds = [
                hypot(*plant.EvalBodySpatialVelocityInWorld(plant_context, body).translational()[:2]) for body in bodies
            ]
            x, y = places[:, 0], places[:, 1]
            for number, mu in enumerate(self._world.mu(x, y).tolist()):
                if mu != self._now[index][number]:
                    self._change(context, index, number, mu)
            distances = np.asarray(shapely.distance(self._edges, shapely.points(x, y))) - _NEAR
            # Shortest time to the next edge: distance = speed t + acceleration t² / 2.
            a = _ACCELERATION
            self._due[index] = time + min(
                (sqrt(speed * speed + 2.0 * a * max(0.0, distance)) - speed) / a
                for speed, distance in zip(speeds, distances.tolist(), strict=True)
            )
        self._next = min(self._due)

    def _change(self, context: Context, index: int, number: int, mu: float) -> None:
        """Set the friction of the ground below one tyre of a vehicle."""
        self._now[index][number] = mu
        model = self._models[index]
        model.set_friction(model.GetMyMutableContextFromRoot(context), number, mu)


def _lines(area: shapely.Geometry) -> list[shapely.LineString]:
    return list(shapely.get_parts(shapely.boundary(shapely.get_parts(area))))
