"""Steering angle sensor."""

from collections.abc import Sequence
from math import pi
from typing import TYPE_CHECKING, Literal, Self

import numpy as np
from pydantic import Field, model_validator
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint
from pydrake.systems.framework import Context

from mirdrake.core.signals import signals
from mirdrake.core.yaml_io import Angle
from mirdrake.sensors.mount import SensorMount
from mirdrake.sensors.noise import Noise
from mirdrake.sensors.noise_spec import AngleNoise
from mirdrake.sensors.sampling import Array, SampledSensor

if TYPE_CHECKING:
    from mirdrake.plant.plant import PlantParts, VehicleInPlant

STEERING_ANGLE = signals(
    ("angle", "rad", "positive to the left, in whole steps"),
    ("counts", "", "the same in steps; 0 for a sensor without steps"),
)
"""Output of a steering angle sensor."""


class SteeringAngle(SampledSensor):
    """Angle of the steering: mean of the joints x ratio + offset + noise, rounded to whole steps.

    Input ports:
        plant_state: the plant's state, positions and velocities.
    Output ports:
        sample (2) [rad, -]: :data:`STEERING_ANGLE`. The first is there from the start, unless there is a latency.
        stamp (1) [s]: when it was taken; -inf before the first.

    Args:
        plant: the finalised plant.
        joints: one steering joint, or both.
        mount: rate, resolution, offset, noise, latency and dropout.
        ratio: ratio of the angle that it measures over that of the joints [-].
        stream: stream of random numbers, from :func:`mirdrake.sensors.noise.noise_stream`.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        joints: Sequence[Joint],
        mount: "SteeringAngleMount",
        *,
        ratio: float = 1.0,
        stream: int = 0,
    ) -> None:
        noise = Noise.of([mount.noise], mount.rate)
        super().__init__(STEERING_ANGLE, mount, stream=stream, initial=[0.0, 0.0], noise=noise)
        self._angles = [joint.position_start() for joint in joints]
        self._ratio, self._resolution, self._offset = ratio, mount.step(), mount.offset
        self.plant_state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
        self.declare_first_sample()

    def measure(self, context: Context) -> Array:
        """Return the angle before rounding (1) [rad]."""
        # Mean of both road wheels: with Ackermann steering left and right differ.
        angle = self._ratio * self.plant_state.Eval(context)[self._angles].mean() + self._offset
        return np.array([angle])

    def report(self, values: Array) -> Array:
        """Return the angle in whole steps [rad] and their number (2)."""
        if not self._resolution:
            return np.array([values[0], 0.0])
        # Noise is added before the rounding, as the electronics of a sensor quantise the noisy signal.
        steps = float(np.rint(values[0] / self._resolution))
        return np.array([steps * self._resolution, steps])


class SteeringAngleMount(SensorMount):
    """Angle sensor of the steering."""

    kind: Literal["steering_angle"]
    of: Literal["road_wheels", "left", "right", "hand_wheel"] = Field(
        default="road_wheels",
        description="road_wheels: mean of both; left, right: one of them; hand_wheel: mean x steering ratio",
    )
    counts: float | None = Field(default=None, gt=0, description="counts per revolution, instead of `resolution`")
    resolution: Angle = Field(default=0.0, ge=0, description="[rad] resolution; 0: continuous")
    offset: Angle = Field(default=0.0, description="[rad] reading with the wheels straight ahead")
    noise: AngleNoise = Field(default_factory=AngleNoise, description="[rad] error of the angle")

    @model_validator(mode="after")
    def _one_step(self) -> Self:
        if self.counts is not None and self.resolution:
            raise ValueError("counts and resolution are both given; give one of them")
        return self

    def step(self) -> float:
        """Return the resolution [rad]; 0: continuous."""
        return self.resolution if self.counts is None else 2.0 * pi / self.counts

    def make(self, *, parts: "PlantParts", part: "VehicleInPlant", stream: int) -> SteeringAngle:
        """Return the steering angle sensor."""
        left, right = part.steering
        joints = {"left": [left], "right": [right]}.get(self.of, [left, right])
        ratio = part.vehicle.spec.steering.ratio if self.of == "hand_wheel" else 1.0
        return SteeringAngle(parts.plant, joints, self, ratio=ratio, stream=stream)
