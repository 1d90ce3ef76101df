"""Wheel encoder: counts of a wheel's rotation."""

from math import floor, pi
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint
from pydrake.systems.framework import Context, DiscreteValues

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.signals import signals
from mirdrake.core.yaml_io import where
from mirdrake.sensors.mount import SensorMount
from mirdrake.sensors.sampling import Array, SampledSensor

if TYPE_CHECKING:
    from mirdrake.plant.plant import PlantParts, VehicleInPlant

COUNTS = signals(("counts", "", "of the counter, 0 where the wheel's angle is 0"))
"""Output of an encoder."""


class WheelEncoder(SampledSensor):
    """Counter of the edges of a wheel encoder; rolling forward counts up.

    The count is the whole number of steps in the wheel's angle. Without quadrature, an encoder cannot detect the
    direction: the absolute rotation from sample to sample is added.

    Input ports:
        plant_state: the plant's state, positions and velocities.
    Output ports:
        sample (1) [-]: :data:`COUNTS`. The first sample is there from the start, unless there is a latency.
        stamp (1) [s]: when it was taken; -inf before the first.

    Args:
        plant: the finalised plant.
        joint: joint of the wheel.
        mount: rate, counts per revolution, quadrature, modulus, latency and dropout; a lost sample loses no counts.
        stream: stream of random numbers, from :func:`mirdrake.sensors.noise.noise_stream`.
        lead: time by which positions of the plant lead its velocities [s]; the angle is moved back, as in the truth.
    """

    def __init__(
        self, plant: MultibodyPlant, joint: Joint, mount: "WheelEncoderMount", *, stream: int = 0, lead: float = 0.0
    ) -> None:
        super().__init__(COUNTS, mount, stream=stream, initial=[0.0])
        self._angle, self._rate, self._lead = (
            joint.position_start(),
            plant.num_positions() + joint.velocity_start(),
            lead,
        )
        self._per_radian, self._wrap = mount.counts / (2.0 * pi), mount.wrap
        self._seen = None if mount.quadrature else self.DeclareDiscreteState([0.0, 0.0])  # position and total, in steps
        self.plant_state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
        self.declare_first_sample()

    def _steps(self, context: Context) -> int:
        # floor, not truncation: steps must have equal width on both sides of zero. The tolerance keeps an exact edge.
        state = self.plant_state.Eval(context)
        return floor(float(state[self._angle] - self._lead * state[self._rate]) * self._per_radian + 1e-9)

    def measure(self, context: Context) -> Array:
        """Return the count (1) [-]."""
        steps = self._steps(context)
        if self._seen is not None:
            # The total is a state: without quadrature the count does not follow from the angle alone.
            before, total = context.get_discrete_state(self._seen).get_value()
            steps = int(total) + abs(steps - int(before))
        # Python's remainder is never negative, so a counter that turns backwards wraps to modulus - 1 as in hardware.
        return np.array([float(steps if self._wrap is None else steps % self._wrap)])

    def keep(self, context: Context, state: DiscreteValues) -> None:
        """Update the total rotation, for an encoder without quadrature."""
        if self._seen is not None:
            steps = self._steps(context)
            before, total = context.get_discrete_state(self._seen).get_value()
            state.get_mutable_vector(self._seen).SetFromVector([steps, total + abs(steps - before)])


class WheelEncoderMount(SensorMount):
    """Incremental encoder on a wheel."""

    kind: Literal["wheel_encoder"]
    counts: float = Field(gt=0, description="counts per revolution: all counted edges")
    quadrature: bool = Field(
        default=True, description="true: counts down when rolling backwards; false: counts up both ways"
    )
    wrap: int | None = Field(
        default=None, ge=2, description="modulus of the counter, for example 65536; null: unlimited"
    )

    def make(self, *, parts: "PlantParts", part: "VehicleInPlant", stream: int) -> WheelEncoder:
        """Return the encoder.

        Raises:
            ConfigError: the encoder is not mounted on a wheel.
        """
        plant = parts.plant
        body = plant.GetFrameByName(self.frame, part.instance).body()
        joints = {joint.child_body().name(): joint for joint in part.wheels}
        if body.name() not in joints:
            location = where(self, "frame")
            raise ConfigError(f"'{self.frame}' is not on a wheel; {did_you_mean(self.frame, joints)}", where=location)
        return WheelEncoder(plant, joints[body.name()], self, stream=stream, lead=parts.lead)
