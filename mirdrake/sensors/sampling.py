"""What all sensors that give a vector have in common: a rate, white noise, and a sample that is held."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from mirdrake.sensors.noise import sample_noise
from mirdrake.signals import Signals, declare_state_output

Array = NDArray[np.float64]


class SampledSensor(LeafSystem):  # type: ignore[misc, unused-ignore]
    """Measures at a rate and holds the sample until the next.

    A sample taken at time t is at the output right after t; whoever reads at t itself still gets the one before, as
    always with discrete states in Drake. So the output depends on no input directly and closes no algebraic loop.

    Output ports:
        sample (n): the last sample.

    Args:
        contents: names and units of the elements.
        rate: samples per second [Hz].
        noise: standard deviation of each element's white noise, in its unit (n).
        stream: from :func:`mirdrake.sensors.noise.noise_stream`.
        initial: shown before the first sample (n).
    """

    def __init__(
        self, contents: Signals, *, rate: float, noise: Sequence[float], stream: int, initial: Sequence[float]
    ) -> None:
        super().__init__()
        self._rate, self._stream = rate, stream
        self._noise = np.array(noise, dtype=float)
        self._held = self.DeclareDiscreteState(list(initial))
        self.sample = declare_state_output(self, "sample", contents, self._held)
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / rate, 0.0, self._update)

    @abstractmethod
    def measure(self, context: Context) -> Array:
        """What a sensor without noise reads now."""

    def _update(self, context: Context, state: DiscreteValues) -> None:
        values = self.measure(context)
        if self._noise.any():
            generator = sample_noise(self._stream, round(context.get_time() * self._rate))
            values = values + self._noise * generator.standard_normal(self._noise.size)
        state.get_mutable_vector(self._held).SetFromVector(values)


def mount_pose(frame: Any) -> tuple[Any, Any]:
    """The body that a frame of a plant is fixed to, and the pose X_BS of the frame in it."""
    return frame.body(), frame.GetFixedPoseInBodyFrame()
