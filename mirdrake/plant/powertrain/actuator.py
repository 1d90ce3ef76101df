"""Actuator: a pure delay, then a first-order lag with a limited rate.

The input is held between two steps, so that the step is exact: with y the output, u the delayed input, τ the time
constant and R the largest rate, dy/dt = (u - y) / τ within ± R. While |u - y| > R τ the output runs at the rate R; from
then on the rest decays with exp(-t/τ). Without a time constant the output follows at once, within the rate.
"""

from collections.abc import MutableSequence
from math import exp, inf
from typing import NamedTuple

from mirdrake.core.checks import whole_periods
from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import where
from mirdrake.vehicles.powertrain_spec import Actuator


class ActuatorNumbers(NamedTuple):
    """Lag of an actuator: time between steps [s], time constant [s], largest change per second."""

    period: float
    time_constant: float
    rate: float


class ActuatorLaw:
    """One actuator, stepped at a fixed period; the caller keeps its memory, a list of `size` numbers.

    Attributes:
        size: length of the memory: delayed inputs, then the output.
        numbers: the lag.

    Args:
        actuator: delay, time constant and rate.
        period: time between steps [s].

    Raises:
        ConfigError: the delay is not a multiple of the period.
    """

    def __init__(self, actuator: Actuator, *, period: float) -> None:
        steps = whole_periods(actuator.delay, period)
        if steps is None:
            near = max(round(actuator.delay / period), 1) * period
            raise ConfigError(
                f"{actuator.delay:g} s is not a multiple of the {period:g} s between two "
                f"set-points; write for example {near:g}",
                where=where(actuator, "delay"),
            )
        rate = inf if actuator.rate is None else actuator.rate
        self.numbers = ActuatorNumbers(period, actuator.time_constant, rate)
        self.size = steps + 1

    def rest(self, value: float) -> list[float]:
        """Return the memory of an actuator at rest at a value."""
        return [value] * self.size

    def step(self, memory: list[float], value: float) -> tuple[list[float], float]:
        """Advance by one period with a demanded value.

        Returns:
            The memory for the next step, and the output at the end of the period; without delay and lag the value.
        """
        line = list(memory)
        output = actuator_step(line, 0, self.size, value, self.numbers)
        return line, output


def actuator_step(memory: MutableSequence[float], at: int, size: int, value: float, numbers: ActuatorNumbers) -> float:
    """Advance an actuator in a section of a longer memory; see :meth:`ActuatorLaw.step`.

    Args:
        memory: whole memory, changed.
        at: start of the actuator's section.
        size: length of the section.
        value: demanded value.
        numbers: lag of the actuator.

    Returns:
        The output at the end of the period.
    """
    # Layout: delay line, oldest value first, then the output.
    last = at + size - 1
    due = memory[at] if size > 1 else value
    for i in range(at, last - 1):
        memory[i] = memory[i + 1]
    if size > 1:
        memory[last - 1] = value
    memory[last] = follow(memory[last], due, numbers.period, numbers.time_constant, numbers.rate)
    return memory[last]


def follow(output: float, wanted: float, period: float, time_constant: float, rate: float = inf) -> float:
    """Return the output of a lag with a limited rate after a period of constant `wanted`; exact.

    Args:
        output: output at the start of the period.
        wanted: demanded value.
        period: [s].
        time_constant: τ [s]; 0: no lag.
        rate: largest change per second.
    """
    gap = wanted - output
    if rate == inf:
        return wanted if time_constant == 0.0 else wanted - gap * exp(-period / time_constant)
    sign, distance = (1.0, gap) if gap >= 0.0 else (-1.0, -gap)
    running = max(distance - rate * time_constant, 0.0) / rate  # time at the full rate
    if running >= period:
        return output + sign * rate * period
    # Full rate while the gap exceeds rate x τ, then the exponential of the lag: both parts are exact.
    rest = distance - rate * running
    return wanted - sign * rest * exp(-(period - running) / time_constant) if time_constant > 0.0 else wanted
