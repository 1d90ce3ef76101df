"""Rooms for sensors that measure distances: fixed shapes, moving bodies, a body that carries the sensor."""

from collections.abc import Sequence
from math import pi
from typing import Any

import numpy as np
from pydrake.geometry import Shape
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
from pydrake.multibody.tree import RigidBody, SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from mirdrake.sensors.ranging.laser_scanner import LaserScannerMount
from mirdrake.sensors.ranging.lidar import LidarMount
from mirdrake.sensors.ranging.motion import BodyState
from mirdrake.sensors.ranging.radar import RadarMount
from mirdrake.sensors.ranging.sonar import SonarMount
from mirdrake.sensors.ranging.world import Beams, Hits, RayWorld

GREY = np.array([0.5, 0.5, 0.5, 1.0])
ABOVE = RigidTransform([0.0, 0.0, 1.0])


class Room:
    """A plant without gravity; bodies keep the velocity that they start with."""

    def __init__(self) -> None:
        self.builder = DiagramBuilder()
        config = MultibodyPlantConfig(time_step=0.005, use_sampled_output_ports=False)
        self.plant, self.scene_graph = AddMultibodyPlant(config, self.builder)
        self.plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, 0.0])
        self.starts: list[tuple[RigidBody, RigidTransform, Sequence[float], Sequence[float]]] = []
        self.carrier = self.body("carrier", X_WB=ABOVE)

    def put(self, shape: Shape, X_WG: RigidTransform, name: str | None = None) -> None:
        """A shape fixed in the world."""
        count = len(self.plant.GetVisualGeometriesForBody(self.plant.world_body()))
        self.plant.RegisterVisualGeometry(self.plant.world_body(), X_WG, shape, name or f"prop/{count}", GREY)

    def body(
        self,
        name: str,
        shape: Shape | None = None,
        *,
        X_WB: RigidTransform | None = None,
        velocity: Sequence[float] = (0.0, 0.0, 0.0),
        turn: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> RigidBody:
        """Return a body that flies, with a shape."""
        instance = self.plant.AddModelInstance(name)
        body = self.plant.AddRigidBody(name, instance, SpatialInertia.SolidSphereWithMass(1.0, 1.0))
        if shape is not None:
            self.plant.RegisterVisualGeometry(body, RigidTransform(), shape, "look", GREY)
        self.starts.append((body, X_WB or RigidTransform(), velocity, turn))
        return body

    def world(self, *, ground: bool = True) -> RayWorld:
        """Return the shapes that rays can hit; no more can be added."""
        if not self.plant.is_finalized():
            self.plant.Finalize()
        return RayWorld(self.plant, self.scene_graph, ground=ground)

    def start(self, *sensors: Any) -> Simulator:
        """Return a simulator with sensors in it."""
        for sensor in sensors:
            self.builder.AddSystem(sensor)
            for name in ("body_poses", "body_spatial_velocities"):
                if sensor.HasInputPort(name):
                    self.builder.Connect(self.plant.GetOutputPort(name), sensor.GetInputPort(name))
        simulator = Simulator(self.builder.Build())
        context = self.plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
        for body, X_WB, velocity, turn in self.starts:
            self.plant.SetFloatingBaseBodyPoseInWorldFrame(context, body, X_WB)
            self.plant.SetFreeBodySpatialVelocity(context=context, body=body, V_JpJc=SpatialVelocity(turn, velocity))
        return simulator

    def measure(self, sensor: Any) -> Any:
        """Return the measurement of a sensor that is alone in the room, at the start."""
        simulator = self.start(sensor)
        context = sensor.GetMyContextFromRoot(simulator.get_context())
        return sensor.look(context) if hasattr(sensor, "look") else sensor.measure(context)


def cast(room: Room, start: Any, directions: Any, *, ground: bool = False, far: float = 200.0) -> Hits:
    """Return the hits of simultaneous rays from a point, before anything moves."""
    world = room.world(ground=ground)
    unit_vectors = np.asarray(directions, dtype=float).reshape(1, -1, 3)
    unit_vectors = unit_vectors / np.linalg.norm(unit_vectors, axis=2, keepdims=True)
    state = BodyState(np.eye(3), np.asarray(start, dtype=float), np.zeros(3), np.zeros(3))
    beams = Beams(unit_vectors, np.zeros(1))
    return world.cast(beams, RigidTransform(), (None, state), {}, period=1.0, far=far)


def scanner(**more: Any) -> LaserScannerMount:
    """Return a scanner of 361 beams over half a turn."""
    data: dict[str, Any] = {"frame": "carrier", "rate": 10.0, "beams": 361, "start_angle": -pi / 2}
    data |= {"end_angle": pi / 2, "near": 0.1, "far": 100.0}
    return LaserScannerMount(kind="laser_scanner", **(data | more))


def lidar(**more: Any) -> LidarMount:
    """Return a lidar of 8 planes and 90 columns."""
    data: dict[str, Any] = {"frame": "carrier", "rate": 10.0, "columns": 90, "rows": 8, "near": 0.1, "far": 100.0}
    data |= {"horizontal_start": -pi, "horizontal_end": pi, "vertical_start": -0.3, "vertical_end": 0.1}
    return LidarMount(kind="lidar", **(data | more))


def sonar(**more: Any) -> SonarMount:
    """Return a sonar with a cone of 30 degrees."""
    data: dict[str, Any] = {"frame": "carrier", "rate": 10.0, "cone": pi / 6, "near": 0.2, "far": 5.0}
    return SonarMount(kind="sonar", **(data | more))


def radar(**more: Any) -> RadarMount:
    """Return a radar with a field of view of 60 x 10 degrees."""
    data: dict[str, Any] = {"frame": "carrier", "rate": 10.0, "horizontal_fov": pi / 3, "vertical_fov": pi / 18}
    return RadarMount(kind="radar", **(data | {"near": 0.5, "far": 150.0, "targets": 4} | more))
