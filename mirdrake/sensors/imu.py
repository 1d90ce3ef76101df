"""Inertial measurement unit: three accelerometers and three rate gyros."""

from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import Context, Diagram, DiagramBuilder
from pydrake.systems.sensors import Accelerometer, Gyroscope

from mirdrake.core.constants import GRAVITY
from mirdrake.core.leaf_system import FreeableType
from mirdrake.core.signals import copy_signals, signals
from mirdrake.sensors.mount import SensorMount
from mirdrake.sensors.noise import Noise
from mirdrake.sensors.noise_spec import AccelerationNoise, RateNoise
from mirdrake.sensors.sampling import Array, SampledSensor, aligned_period, mount_pose

if TYPE_CHECKING:
    from mirdrake.plant.plant import PlantParts, VehicleInPlant

IMU = signals(
    ("fx", "m/s²", "specific force, ahead"),
    ("fy", "m/s²", "specific force, to the left"),
    ("fz", "m/s²", "specific force, up: +g at rest"),
    ("wx", "rad/s", "roll rate"),
    ("wy", "rad/s", "pitch rate"),
    ("wz", "rad/s", "yaw rate"),
)
"""Specific force a - g of the mount's origin and angular velocity, both in the world and expressed in the mount."""


class Imu(Diagram, metaclass=FreeableType):  # type: ignore[misc, unused-ignore]
    """Specific force and angular velocity of a frame, in that frame; lever arm and rotation follow from the motion.

    Drake's Accelerometer and Gyroscope measure without noise; samples are taken at a rate, with noise. The acceleration
    is that of the plant; for a discrete plant it is the mean over the step that begins with the sample. A sample that
    coincides with a step of the plant is output right after that time, not to systems that update at that time.

    Input ports:
        body_poses, body_spatial_velocities, body_spatial_accelerations: the plant's outputs of all bodies.
    Output ports:
        sample (6) [m/s², rad/s]: :data:`IMU`; before the first sample that of an IMU at rest on the level.
        stamp (1) [s]: when it was taken; -inf before the first.

    Args:
        plant: the finalised plant.
        frame: mounting frame; fixed to a body.
        mount: rate, noise, latency and dropout.
        stream: stream of random numbers, from :func:`mirdrake.sensors.noise.noise_stream`.
        step: time step of the plant [s]; by default that of a discrete plant.

    Attributes:
        rate: samples per second [Hz].
        latency: time from a sample to its display [s].
    """

    def __init__(
        self, plant: MultibodyPlant, frame: Frame, mount: "ImuMount", *, stream: int = 0, step: float | None = None
    ) -> None:
        super().__init__()
        builder = DiagramBuilder()
        body, X_BS = mount_pose(frame)
        # Drake's accelerometer outputs specific force a - g, hence +g upwards at rest; it needs the field of the plant.
        gravity = plant.gravity_field().gravity_vector()
        force = builder.AddNamedSystem("accelerometer", Accelerometer(body, X_BS, gravity))
        rates = builder.AddNamedSystem("gyroscope", Gyroscope(body, X_BS))
        sampler = _Sampler(mount, stream, plant.time_step() if step is None else step)
        builder.AddNamedSystem("sampler", sampler)
        self.rate, self.latency, self._sampler = mount.rate, mount.latency, sampler
        builder.Connect(force.get_measurement_output_port(), sampler.force)
        builder.Connect(rates.get_measurement_output_port(), sampler.rates)
        for name, of_force, of_rates in (
            ("body_poses", force.get_body_poses_input_port(), rates.get_body_poses_input_port()),
            ("body_spatial_velocities", force.get_body_velocities_input_port(), rates.get_body_velocities_input_port()),
        ):
            builder.ExportInput(of_force, name)
            builder.ConnectInput(name, of_rates)
        builder.ExportInput(force.get_body_accelerations_input_port(), "body_spatial_accelerations")
        builder.ExportOutput(sampler.sample, "sample")
        builder.ExportOutput(sampler.stamp, "stamp")
        builder.BuildInto(self)
        # BuildInto replaces the contents of the Diagram, so ports can be kept only afterwards.
        self.sample, self.stamp = self.GetOutputPort("sample"), self.GetOutputPort("stamp")
        # Exported ports lose their signal names and units.
        copy_signals(sampler.sample, self.sample)
        copy_signals(sampler.stamp, self.stamp)

    def under_way(self, context: Context) -> list[tuple[float, Array]]:
        """Return the samples that are not output yet: time [s] and value (6), in the order of time.

        Args:
            context: Context of this diagram.
        """
        return self._sampler.under_way(self.GetSubsystemContext(self._sampler, context))


class _Sampler(SampledSensor):
    """Sampled specific force and angular velocity of the present time."""

    def __init__(self, mount: "ImuMount", stream: int, step: float) -> None:
        super().__init__(
            IMU,
            mount,
            stream=stream,
            initial=[0.0, 0.0, GRAVITY, 0.0, 0.0, 0.0],
            noise=Noise.of([mount.acceleration_noise] * 3 + [mount.gyro_noise] * 3, mount.rate),
            period=aligned_period(mount.rate, step),
        )
        self.force = self.DeclareVectorInputPort("specific_force", 3)
        self.rates = self.DeclareVectorInputPort("angular_velocity", 3)

    def measure(self, context: Context) -> Array:
        return np.concatenate((self.force.Eval(context), self.rates.Eval(context)))


class ImuMount(SensorMount):
    """Inertial measurement unit: rate gyros and accelerometers."""

    kind: Literal["imu"]
    gyro_noise: RateNoise = Field(default_factory=RateNoise, description="[rad/s] gyro error, each axis")
    acceleration_noise: AccelerationNoise = Field(
        default_factory=AccelerationNoise, description="[m/s²] accelerometer error, each axis"
    )

    def make(self, *, parts: "PlantParts", part: "VehicleInPlant", stream: int) -> Imu:
        """Return the IMU of this mount."""
        frame = parts.plant.GetFrameByName(self.frame, part.instance)
        return Imu(parts.plant, frame, self, stream=stream, step=part.period)
