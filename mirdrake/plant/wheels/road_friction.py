"""Friction that changes with the place: patches, verges and tracks of a world as the tyres feel them.

Drake keeps friction with the shapes, and the road is one plane. So the tyres carry it: whenever a wheel comes to ground
of another friction, the friction of its shape is changed in the Context.

The friction of a tyre on the road is the smaller one of theirs, as in Gazebo (ODE takes the smaller mu of a pair);
Drake takes the harmonic mean 2 a b / (a + b) of a pair. The tyre is therefore given the value for which the mean with
that of the plane is what it should be.
"""

from collections.abc import Mapping
from math import hypot, inf, sqrt

import shapely
from pydrake.geometry import ProximityProperties, RoleAssign
from pydrake.multibody.plant import CoulombFriction
from pydrake.systems.framework import Context

from mirdrake.plant.plant import PlantParts, matched_friction
from mirdrake.plant.wheels.tyre_forces import WheelTyres
from mirdrake.vehicles import WHEELS

_ACCELERATION = 30.0
"""No wheel gets faster by more than that [m/s²] before it is looked at again."""

_NEAR = 1e-3  # [m] from an edge, a wheel is looked at in every step


class RoadFriction:
    """Gives the tyres the friction of the ground below them, step by step.

    It is no system, for a system must not change the Context of another one: hand :meth:`watch` to a Simulator as its
    monitor. :class:`mirdrake.runs.simulation.Simulation` does so by itself.

    Args:
        parts: plant, world and vehicles.
        tyres: tyre models of the vehicles that have one, by name of the vehicle; they get the friction of the ground as
            it is.

    Attributes:
        varies: whether the friction changes anywhere; if not, there is nothing to watch.
    """

    def __init__(self, parts: PlantParts, tyres: Mapping[str, WheelTyres] | None = None) -> None:
        self._parts, self._world = parts, parts.world
        areas = self._world.friction_areas
        self.varies = len({self._world.ground.mu, *(mu for _, mu in areas)}) > 1
        self._edges = shapely.MultiLineString([line for area, _ in areas for line in _lines(area)])
        shapely.prepare(self._edges)
        self._wheels = [
            (joint.child_body(), tyre, mu)
            for part in parts.vehicles.values()
            for joint, tyre, mu in zip(part.wheels, part.tyres, part.tyre_mu, strict=True)
        ]
        models = tyres or {}
        self._models = [(models.get(name), number) for name in parts.vehicles for number in range(len(WHEELS))]
        self._due: list[float] = []
        self._now: list[float] = []

    def start(self) -> None:
        """Forget everything: a new Context comes."""
        self._due = [-inf] * len(self._wheels)
        self._now = [self._world.road_mu] * len(self._wheels)

    def watch(self, context: Context) -> None:
        """Look at the wheels that may have come to other ground, and change what has changed.

        Args:
            context: of the whole diagram, changed.
        """
        time = context.get_time()
        if not self._due:
            self.start()
        if time < min(self._due):
            return
        plant = self._parts.plant
        plant_context = plant.GetMyContextFromRoot(context)
        for index, (body, _, _) in enumerate(self._wheels):
            if time < self._due[index]:
                continue
            x, y, _ = plant.EvalBodyPoseInWorld(plant_context, body).translation()
            vx, vy, _ = plant.EvalBodySpatialVelocityInWorld(plant_context, body).translational()
            mu = float(self._world.mu(x, y))
            if mu != self._now[index]:
                self._change(context, index, mu)
            distance = float(shapely.distance(self._edges, shapely.Point(x, y))) - _NEAR
            # How long it takes at least to the next edge: distance = speed t + acceleration t² / 2.
            speed, a = hypot(vx, vy), _ACCELERATION
            self._due[index] = time + (sqrt(speed**2 + 2.0 * a * max(0.0, distance)) - speed) / a

    def _change(self, context: Context, index: int, mu: float) -> None:
        """Give one tyre the friction of ground with that coefficient."""
        self._now[index] = mu
        model, number = self._models[index]
        if model is not None:
            model.set_friction(model.GetMyMutableContextFromRoot(context), number, mu)
            return
        scene_graph, (_, tyre, own) = self._parts.scene_graph, self._wheels[index]
        properties = ProximityProperties(scene_graph.model_inspector().GetProximityProperties(tyre))
        value = matched_friction(own, mu, plane=self._world.road_mu)
        properties.UpdateProperty("material", "coulomb_friction", CoulombFriction(value, value))
        scene_graph.AssignRole(
            scene_graph.GetMyMutableContextFromRoot(context),
            self._parts.plant.get_source_id(),
            tyre,
            properties,
            RoleAssign.kReplace,
        )


def _lines(area: shapely.Geometry) -> list[shapely.LineString]:
    return list(shapely.get_parts(shapely.boundary(shapely.get_parts(area))))
