"""Friction of the ground that varies with the position: patches, verges and tracks of a world.

Whenever a wheel reaches ground of another friction, the parameter of its tyre in the Context is changed.
"""

from collections.abc import Mapping
from math import hypot, inf, sqrt

import shapely
from pydrake.systems.framework import Context

from mirdrake.plant.plant import PlantParts
from mirdrake.plant.wheels.tyre_forces import TyreSystem
from mirdrake.vehicles import WHEELS

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
        self._wheels = [joint.child_body() for part in parts.vehicles.values() for joint in part.wheels]
        self._models = [(tyres[name], number) for name in parts.vehicles for number in range(len(WHEELS))]
        self._due: list[float] = []
        self._now: list[float] = []

    def start(self) -> None:
        """Reset for a new Context."""
        self._due = [-inf] * len(self._wheels)
        self._now = [self._world.road_mu] * len(self._wheels)

    def watch(self, context: Context) -> None:
        """Check the wheels that may have reached other ground, and update their friction.

        Args:
            context: context of the whole diagram, changed.
        """
        time = context.get_time()
        if not self._due:
            self.start()
        # Called after each step: it must cost nothing while no wheel can have reached an edge.
        if time < min(self._due):
            return
        plant = self._parts.plant
        plant_context = plant.GetMyContextFromRoot(context)
        for index, body in enumerate(self._wheels):
            if time < self._due[index]:
                continue
            x, y, _ = plant.EvalBodyPoseInWorld(plant_context, body).translation()
            vx, vy, _ = plant.EvalBodySpatialVelocityInWorld(plant_context, body).translational()
            mu = float(self._world.mu(x, y))
            if mu != self._now[index]:
                self._change(context, index, mu)
            distance = float(shapely.distance(self._edges, shapely.Point(x, y))) - _NEAR
            # Shortest time to the next edge: distance = speed t + acceleration t² / 2.
            speed, a = hypot(vx, vy), _ACCELERATION
            self._due[index] = time + (sqrt(speed**2 + 2.0 * a * max(0.0, distance)) - speed) / a

    def _change(self, context: Context, index: int, mu: float) -> None:
        """Set the friction of the ground below one tyre."""
        self._now[index] = mu
        model, number = self._models[index]
        model.set_friction(model.GetMyMutableContextFromRoot(context), number, mu)


def _lines(area: shapely.Geometry) -> list[shapely.LineString]:
    return list(shapely.get_parts(shapely.boundary(shapely.get_parts(area))))
