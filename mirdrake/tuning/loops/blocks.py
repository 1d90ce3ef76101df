"""Blocks between a control unit and its plant on a test bench: a delayed actuator with a load, and a noisy sensor.

Delay, load and noise are values in the Context, so that nothing is rebuilt to change them.
"""

import math
from typing import ClassVar

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, State

from mirdrake.core.checks import check_number
from mirdrake.core.errors import ConfigError
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.tuning.models import Floats

LONGEST = 0.5
"""Longest delay of a :class:`DelayedActuator` [s]."""


class DelayedActuator(LeafSystem):  # type: ignore[misc, unused-ignore]
    """An actuator with a delay, an excitation before it and a load after it.

    Without delay the input passes through. With a delay of ``n + f`` periods, f below 1, the output is the delayed
    control, which is held for a period, averaged over the period: ``(1 - f) u[k - n] + f u[k - n - 1]``.

    Input port:
        u (size): controls, constant during a period.
    Output port:
        y (size): ``delayed(u + excitation) + load``.

    Parameters of the Context: 0: delay [s]; 1: excitation (size) [u], then load (size) [u]. They may change during a
    simulation: excitation and load act from the next update on.

    State: discrete; active excitation and load, then the controls of the past periods, newest first.

    Args:
        size: number of controls.
        period: time between updates of the control [s].
        at_once: whether the control changes in unrestricted updates, as that of a control unit: it acts in the step of
            the plant that begins, and the block has to sample the control of the past period before that. The control
            of a block with discrete updates acts one step of the plant later, and is sampled so.
    """

    sampled_with: ClassVar[str] = "period"
    """Argument with the period of all events."""

    def __init__(self, size: int, period: float, at_once: bool = False) -> None:
        super().__init__()
        self.size = int(size)
        self.period = check_number("DelayedActuator", "period", period, unit="s", above=0.0)
        # Rows of past controls for the longest delay, one for interpolation and one for rounding up.
        rows = math.ceil(LONGEST / self.period) + 2
        self.u = self.DeclareVectorInputPort("u", self.size)
        self._delay = self.DeclareNumericParameter(BasicVector([0.0]))
        self._force = self.DeclareNumericParameter(BasicVector([0.0] * (2 * self.size)))
        # Memory: excitation, load, then past controls, newest first. The additions act from the next update on.
        self._memory = self.DeclareDiscreteState([0.0] * ((2 + rows) * self.size))
        self.y = self.DeclareVectorOutputPort(
            "y",
            self.size,
            self._calc,
            # Depends on u at zero delay; the plant behind it has state, so there is no algebraic loop.
            prerequisites_of_calc={self.u.ticket(), self.xd_ticket(), self.all_parameters_ticket()},
        )
        if at_once:
            self.DeclarePeriodicUnrestrictedUpdateEvent(self.period, 0.0, self._update_at_once)
        else:
            self.DeclarePeriodicDiscreteUpdateEvent(self.period, 0.0, self._update)

    def set_delay(self, context: Context, delay: float) -> None:
        """Write the delay [s] to a Context of this system.

        Raises:
            ConfigError: negative, or longer than :data:`LONGEST`.
        """
        check_number("DelayedActuator", "delay", delay, unit="s", at_least=0.0, at_most=LONGEST)
        context.get_mutable_numeric_parameter(self._delay).SetAtIndex(0, delay)

    def set_excitation(self, context: Context, values: list[float]) -> None:
        """Write the addition to the controls, before the delay."""
        context.get_mutable_numeric_parameter(self._force).get_mutable_value()[: self.size] = values

    def set_load(self, context: Context, values: list[float]) -> None:
        """Write the addition after the delay."""
        context.get_mutable_numeric_parameter(self._force).get_mutable_value()[self.size :] = values

    def _calc(self, context: Context, output: BasicVector) -> None:
        n = self.size
        memory = context.get_discrete_state(self._memory).value()
        periods = context.get_numeric_parameter(self._delay).value().item() / self.period
        # The tolerance keeps whole numbers of periods from being rounded down.
        whole = math.floor(periods + 1e-9)
        part = max(periods - whole, 0.0)
        start = (1 + whole) * n  # the newest past control is at 2 n
        delayed = memory[start : start + n] if whole else self.u.Eval(context) + memory[:n]
        # Within the period the delayed control changes once: apply its average over the period.
        if part:
            delayed = (1.0 - part) * delayed + part * memory[start + n : start + 2 * n]
        # The load acts on the plant directly, behind the delay.
        output.SetFromVector(delayed + memory[n : 2 * n])

    def _update_at_once(self, context: Context, state: State) -> None:
        self._update(context, state.get_mutable_discrete_state())

    def _update(self, context: Context, values: DiscreteValues) -> None:
        n = self.size
        old, new = context.get_discrete_state(self._memory).value(), values.get_mutable_value(self._memory)
        # Sampled, not read in _calc: a write between two updates must not change a control that is held.
        new[: 2 * n] = context.get_numeric_parameter(self._force).value()
        new[2 * n : 3 * n] = self.u.Eval(context) + old[:n]
        new[3 * n :] = old[2 * n : -n]


class NoisySensor(LeafSystem):  # type: ignore[misc, unused-ignore]
    """A vector with noise on some of its elements.

    Input port:
        u (size).
    Output port:
        y (size): u, plus the noise of the present period on the noisy elements.

    Abstract parameter 0 of the Context: indices of the noisy elements, and the noise of every period, shape (n,), of
    which the last value is held. An empty array: no noise.

    Args:
        size: of the vector.
        period: time for which a value of the noise is held [s].
    """

    sampled_with: ClassVar[str] = "period"
    """Argument with the period of all events."""

    def __init__(self, size: int, period: float) -> None:
        super().__init__()
        self.size, self.period = int(size), check_number("NoisySensor", "period", period, unit="s", above=0.0)
        self.u = self.DeclareVectorInputPort("u", self.size)
        self._noise = self.DeclareAbstractParameter(Value[object](([], np.zeros(0))))
        self.y = self.DeclareVectorOutputPort("y", self.size, self._calc)

    def set_noise(self, context: Context, elements: list[int], noise: Floats) -> None:
        """Write the noisy elements and the noise of every period to a Context of this system.

        Raises:
            ConfigError: an index outside of the vector.
        """
        if any(not 0 <= element < self.size for element in elements):
            raise ConfigError(f"NoisySensor: indices must be from 0 to {self.size - 1}")
        context.get_mutable_abstract_parameter(self._noise).set_value((list(elements), noise))

    def _calc(self, context: Context, output: BasicVector) -> None:
        values = self.u.Eval(context)
        elements, noise = context.get_abstract_parameter(self._noise).get_value()
        if len(noise):
            # The array of the input port is Drake's own and must not be changed.
            values = values.copy()
            values[elements] += noise[min(int(context.get_time() / self.period + 1e-6), len(noise) - 1)]
        output.SetFromVector(values)
