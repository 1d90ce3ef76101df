"""Moving frames that carry a sensor, with its samples."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlant, MultibodyPlantConfig
from pydrake.multibody.tree import FixedOffsetFrame, RevoluteJoint, SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder, System

from mirdrake.core.paths import data_root
from mirdrake.core.signals import signals
from mirdrake.sensors.noise import Noise
from mirdrake.sensors.sampling import Array, SampledSensor, SampledValue
from mirdrake.vehicles.mount import Mount

GRAVITY = 9.80665


class Carousel:
    """An arm on an axis through the origin, with a mounting frame on it.

    The axis is vertical, or tilted with the plane on which the arm turns by `slope` about the world's y axis; gravity
    is always vertical.
    """

    def __init__(
        self,
        place: Sequence[float] = (0.0, 0.0, 0.0),
        *,
        rpy: Sequence[float] = (0.0, 0.0, 0.0),
        angle: float = 0.0,
        rate: float = 0.0,
        slope: float = 0.0,
        axis: Sequence[float] = (0.0, 0.0, 1.0),
    ) -> None:
        self.builder = DiagramBuilder()
        config = MultibodyPlantConfig(time_step=0.005, use_sampled_output_ports=False)
        self.plant, self.scene_graph = AddMultibodyPlant(config, self.builder)
        self.plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -GRAVITY])
        arm = self.plant.AddRigidBody("arm", SpatialInertia.SolidBoxWithMass(1.0, 1.0, 1.0, 1.0))
        tilt = RigidTransform(RollPitchYaw(0.0, slope, 0.0), [0.0, 0.0, 0.0])
        base = self.plant.AddFrame(FixedOffsetFrame("plane", self.plant.world_frame(), tilt))
        self.joint = self.plant.AddJoint(RevoluteJoint("axis", base, arm.body_frame(), axis))
        X_BS = RigidTransform(RollPitchYaw(*rpy), place)
        self.mount = self.plant.AddFrame(FixedOffsetFrame("mount", arm, X_BS))
        self.angle, self.rate = angle, rate

    def finalize(self) -> MultibodyPlant:
        """Return the plant, ready for sensors."""
        self.plant.Finalize()
        return self.plant

    def start(self, sensor: System) -> Simulator:
        """Return a simulator of the arm and a sensor on it, at the start."""
        plant = self.plant
        feeds = {
            "plant_state": plant.get_state_output_port(),
            "body_poses": plant.get_body_poses_output_port(),
            "body_spatial_velocities": plant.get_body_spatial_velocities_output_port(),
            "body_spatial_accelerations": plant.get_body_spatial_accelerations_output_port(),
        }
        self.builder.AddSystem(sensor)
        for port in map(sensor.get_input_port, range(sensor.num_input_ports())):
            self.builder.Connect(feeds[port.get_name()], port)
        simulator = Simulator(self.builder.Build())
        context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
        self.joint.set_angle(context, self.angle)
        self.joint.set_angular_rate(context, self.rate)
        simulator.Initialize()
        return simulator

    def run(self, sensor: Any, duration: float, *, rate: float) -> np.ndarray:
        """Return the samples of the sensor, n x time, taken midway between two updates."""
        simulator = self.start(sensor)
        observed = []
        for step in range(round(duration * rate)):
            simulator.AdvanceTo((step + 0.5) / rate)
            observed.append(held(sensor, simulator))
        return np.array(observed).T


def vehicle_with(folder: Path, sensors: str, *, model: str = "mkz") -> Path:
    """Return a copy of a vehicle with other sensors, in a new folder."""
    folder.mkdir()
    for path in (data_root() / "models" / model).iterdir():
        if path.name != "sensors.yaml":
            (folder / path.name).symlink_to(path)
    (folder / "sensors.yaml").write_text(sensors, encoding="utf-8")
    return folder


def held(sensor: Any, simulator: Simulator, port: str = "sample") -> Any:
    """Return the present output of a sensor."""
    output = sensor.GetOutputPort(port)
    return output.Eval(sensor.GetMyContextFromRoot(simulator.get_context()))


class Clock(SampledSensor):
    """Measures the time, with noise."""

    def __init__(self, *, noise: float | Noise = 0.0, stream: int = 1, **keys: float) -> None:
        errors = noise if isinstance(noise, Noise) else [noise]
        mount = Mount(kind="clock", frame="any", **keys)
        super().__init__(signals(("time", "s")), mount, noise=errors, stream=stream, initial=[np.nan])

    def measure(self, context: Context) -> Array:
        return np.array([context.get_time()])


class TextClock(SampledValue):
    """Writes the number of the sample."""

    def __init__(self, *, stream: int = 0, **keys: Any) -> None:
        mount = Mount(kind="clock", frame="any", **keys)
        super().__init__("text", AbstractValue.Make("nothing"), mount, stream=stream)

    def take(self, context: Context, index: int, sample: AbstractValue) -> None:
        sample.set_value(f"{index} at {context.get_time():.6f}")


def shown(sensor: Any, times: Sequence[float], port: str = "sample") -> list[Any]:
    """Return the output of a sensor without inputs just before the updates of each time."""
    builder = DiagramBuilder()
    builder.AddSystem(sensor)
    simulator = Simulator(builder.Build())
    observed = []
    for time in times:
        simulator.AdvanceTo(time)
        value = held(sensor, simulator, port)
        observed.append(value.copy() if isinstance(value, np.ndarray) else value)
    return observed
