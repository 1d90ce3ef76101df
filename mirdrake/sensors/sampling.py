"""Base of all sensors: rate, noise, latency and dropout.

A sample that is taken at time t is output from t + latency until the next one is. Samples on their way wait in a queue,
so that each is output however long the latency is. Samples, queue and slowly varying errors are states in the Context;
the system of a sensor has no state of its own.

Sensors update 1e-15 of the time before other systems. In floating point 3 x 0.1 s is later than 60 x 0.005 s, so that a
sample would sometimes see the plant one step too late.
"""

from abc import abstractmethod
from collections.abc import Sequence
from functools import lru_cache
from math import floor, inf
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, DiscreteValues, State

from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import Signals, declare_state_output, signals
from mirdrake.sensors.noise import Noise, is_lost
from mirdrake.vehicles.mount import Mount

Array = NDArray[np.float64]

STAMP = signals(("stamp", "s", "time at which the sample was taken; -inf: there was none yet"))
"""Time at which the sample at the output was taken; its age is the present time minus the stamp."""


class SampledSensor(LeafSystem):  # type: ignore[misc, unused-ignore]
    """A sensor that measures a vector at a rate and holds the sample until the next.

    A sample that is taken at time t is at the output at t + latency; without latency, that of t = 0 comes right after
    0. The output does not depend directly on an input, so that it closes no algebraic loop. In place of a lost sample
    the one before it stays.

    Output ports:
        sample (n): the last sample.
        stamp (1) [s]: :data:`STAMP`.

    Args:
        contents: names and units of the elements.
        mount: its rate, latency and dropout.
        stream: stream of random numbers, from :func:`mirdrake.sensors.noise.noise_stream`.
        initial: output before the first sample (n).
        noise: measurement noise (m); plain numbers are standard deviations of white noise; default: none.
        period: time from sample to sample [s]; default: :func:`sample_period`.

    Attributes:
        rate: samples per second [Hz].
        latency: time from a sample to its output [s].
    """

    def __init__(
        self,
        contents: Signals,
        mount: Mount,
        *,
        stream: int,
        initial: Sequence[float],
        noise: Sequence[float] | Noise | None = None,
        period: float | None = None,
    ) -> None:
        super().__init__()
        self.rate, self.latency = mount.rate, mount.latency
        self._stream, self._dropout = stream, mount.dropout
        period = sample_period(mount.rate) if period is None else period
        noise = [0.0] * len(contents) if noise is None else noise
        self._noise = noise if isinstance(noise, Noise) else Noise.plain(noise)
        self._bias, start = self._noise.constant(stream), self._noise.start(stream)
        # All memory is in the Context: cloned Contexts, repeated runs and steps taken twice give the same samples.
        self._held = self.DeclareDiscreteState(list(initial))
        self._held_stamp = self.DeclareDiscreteState([-inf])
        self._wandering = self.DeclareDiscreteState(start) if start.size else None
        self.sample = declare_state_output(self, "sample", contents, self._held)
        self.stamp = declare_state_output(self, "stamp", STAMP, self._held_stamp)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)
        # The buffer is a ring; each slot holds a stamp and a sample, with -inf for an empty or lost one.
        if self.latency > 0.0:
            self._row, self._slots = 1 + len(initial), slots(self.latency, self.rate)
            self._queue = self.DeclareDiscreteState(np.full(self._row * self._slots, -inf))
            # Output times are the sample times shifted by the latency; they need not be multiples of the period.
            self.DeclarePeriodicDiscreteUpdateEvent(period, self.latency, self._show)

    @abstractmethod
    def measure(self, context: Context) -> Array:
        """Return the present reading without noise (m)."""

    def report(self, values: Array) -> Array:
        """Return the output (n) for a noisy reading (m), for example rounded to a resolution."""
        return values

    def keep(self, context: Context, state: DiscreteValues) -> None:
        """Store what the next measurement needs of this one; most sensors need nothing."""

    def under_way(self, context: Context) -> list[tuple[float, Array]]:
        """Return the samples that are not output yet: time [s] and value (n), in the order of time.

        Args:
            context: Context of this system.
        """
        if not self.latency:
            return []
        shown = float(context.get_discrete_state(self._held_stamp).get_value()[0])
        rows = context.get_discrete_state(self._queue).get_value().reshape(self._slots, self._row)
        # Slots that were output already still hold their old stamps, which are not later than the one shown.
        return [(float(row[0]), row[1:].copy()) for row in rows[np.argsort(rows[:, 0])] if row[0] > shown]

    def declare_first_sample(self) -> None:
        """Take a sample at initialisation, for sensors whose inputs are known then; not with a latency."""
        if not self.latency:
            self.DeclareInitializationDiscreteUpdateEvent(self._begin)

    def _begin(self, context: Context, state: DiscreteValues) -> None:
        time = context.get_time()
        if not is_lost(self._stream, round(time * self.rate), self._dropout):
            self._put(state, time, self._read(context)[0])

    def _update(self, context: Context, state: DiscreteValues) -> None:
        values, wandering = self._read(context)
        if self._wandering is not None:
            state.get_mutable_vector(self._wandering).SetFromVector(wandering)
        # After the measurement, as `keep` stores the reading for the next sample.
        self.keep(context, state)
        # Rounded, because sampling events are 1e-15 early; index / rate is then the nominal time.
        index = round(context.get_time() * self.rate)
        time = index / self.rate
        lost = is_lost(self._stream, index, self._dropout)
        if self.latency:
            row = state.get_mutable_vector(self._queue).get_mutable_value()[self._slot(index)]
            row[0], row[1:] = -inf if lost else time, values
        elif not lost:
            self._put(state, time, values)

    def _read(self, context: Context) -> tuple[Array, Array]:
        """Return the present sample, and the state of the slowly varying errors at the next one."""
        wandering = np.zeros(0)
        if self._wandering is not None:
            wandering = context.get_discrete_state(self._wandering).get_value()
        error, wandering = self._noise.step(self._stream, round(context.get_time() * self.rate), wandering)
        return self.report(self.measure(context) + error + self._bias), wandering

    def _put(self, state: DiscreteValues, time: float, values: Array) -> None:
        state.get_mutable_vector(self._held).SetFromVector(values)
        state.get_mutable_vector(self._held_stamp).SetFromVector([time])

    def _slot(self, index: int) -> slice:
        begin = index % self._slots * self._row
        return slice(begin, begin + self._row)

    def _show(self, context: Context, state: DiscreteValues) -> None:
        """Output the sample whose latency has passed."""
        # The slot follows from the time at which the sample was taken, not from a
        # pointer that a lost sample could shift.
        index = round((context.get_time() - self.latency) * self.rate)
        row = context.get_discrete_state(self._queue).get_value()[self._slot(index)]
        # A lost sample leaves the previous one at the output.
        if row[0] > -inf:
            self._put(state, row[0], row[1:])


class SampledValue(LeafSystem):  # type: ignore[misc, unused-ignore]
    """A sensor whose samples are not vectors: pictures, clouds. Subclasses declare inputs and define :meth:`take`.

    Output ports:
        the one named `port`: the last sample.
        stamp (1) [s]: :data:`STAMP`.

    Args:
        port: name of the output.
        empty: output before the first sample; all samples are of its type.
        mount: its rate, latency and dropout.
        stream: stream of random numbers, from :func:`mirdrake.sensors.noise.noise_stream`.

    Attributes:
        rate: samples per second [Hz].
        latency: time from a sample to its output [s].
    """

    def __init__(self, port: str, empty: AbstractValue, mount: Mount, *, stream: int = 0) -> None:
        super().__init__()
        self.rate, self.latency = mount.rate, mount.latency
        self._stream, self._dropout = stream, mount.dropout
        self._held = self.DeclareAbstractState(empty)
        self._held_stamp = self.DeclareDiscreteState([-inf])
        self.value = self.DeclareStateOutputPort(port, self._held)
        self.stamp = declare_state_output(self, "stamp", STAMP, self._held_stamp)
        period = sample_period(self.rate)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._update)
        # A latency longer than the period needs a queue of samples that are under way.
        if self.latency > 0.0:
            self._queue = [self.DeclareAbstractState(empty) for _ in range(slots(self.latency, self.rate))]
            self._stamps = self.DeclareDiscreteState(np.full(len(self._queue), -inf))
            self.DeclarePeriodicUnrestrictedUpdateEvent(period, self.latency, self._show)

    @abstractmethod
    def take(self, context: Context, index: int, sample: AbstractValue) -> None:
        """Write the present sample, which has this number, into `sample`."""

    def under_way(self, context: Context) -> list[tuple[float, Any]]:
        """Return the samples that are not output yet: time [s] and value, in the order of time.

        Args:
            context: Context of this system.
        """
        if not self.latency:
            return []
        shown = float(context.get_discrete_state(self._held_stamp).get_value()[0])
        stamps = context.get_discrete_state(self._stamps).get_value()
        waiting = [(float(stamps[i]), self._queue[i]) for i in np.argsort(stamps) if stamps[i] > shown]
        return [(time, context.get_abstract_state(int(state)).get_value()) for time, state in waiting]

    def _update(self, context: Context, state: State) -> None:
        index = round(context.get_time() * self.rate)
        time = index / self.rate
        # The decision about loss is made before the sample is taken: a lost picture is not rendered.
        lost = is_lost(self._stream, index, self._dropout)
        if self.latency:
            slot = index % len(self._queue)
            state.get_mutable_discrete_state(self._stamps).get_mutable_value()[slot] = -inf if lost else time
            target = self._queue[slot]
        else:
            if not lost:
                state.get_mutable_discrete_state(self._held_stamp).SetFromVector([time])
            # Without latency the sample is written in place of the held one, which saves a copy.
            target = self._held
        if not lost:
            self.take(context, index, state.get_mutable_abstract_state(int(target)))

    def _show(self, context: Context, state: State) -> None:
        slot = round((context.get_time() - self.latency) * self.rate) % len(self._queue)
        stamp = context.get_discrete_state(self._stamps).get_value()[slot]
        if stamp > -inf:
            state.get_mutable_discrete_state(self._held_stamp).SetFromVector([stamp])
            arrived = context.get_abstract_state(int(self._queue[slot]))
            state.get_mutable_abstract_state(int(self._held)).SetFrom(arrived)


def sample_period(rate: float) -> float:
    """Return the time between two samples, shortened by 1e-15 of it, so that a sample precedes a plant step.

    Args:
        rate: [Hz].

    Returns:
        [s].
    """
    return (1.0 - 1e-15) / rate


@lru_cache(maxsize=64)
def aligned_period(rate: float, step: float) -> float:
    """Return the time between two samples of a sensor whose input is also computed in the plant's step: accelerations.

    If the samples coincide with steps of the plant in floating point, it is exactly 1 / rate. What is computed for the
    sample then serves for the step, and the sample is output right after its time.

    Args:
        rate: [Hz].
        step: step of the plant [s]; 0: none.
    """
    number = np.arange(1.0, 1e6)
    # Drake computes event times as offset + number x period; both sequences must agree bit for bit.
    steps = round(1.0 / (rate * step)) if step > 0.0 else 0
    if steps and np.all(number * (1.0 / rate) == number * steps * step):
        return 1.0 / rate
    return sample_period(rate)


def slots(latency: float, rate: float) -> int:
    """Return the size of the sample buffer.

    It holds all samples within the latency, and one more if a sample is taken while another is output.
    """
    return floor(latency * rate + 1e-6) + 2


def mount_pose(frame: Any) -> tuple[Any, Any]:
    """Return the body that a frame of a plant is fixed to, and the pose X_BS of the frame in it."""
    return frame.body(), frame.GetFixedPoseInBodyFrame()
