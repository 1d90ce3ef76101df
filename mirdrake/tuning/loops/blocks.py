"""Blocks that a bench puts between a control unit and its plant: a late actuator with a load, and a noisy sensor.

What they do is set in the Context, so that nothing is built for another delay or noise.
"""

import math

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from mirdrake.core.checks import check_number
from mirdrake.core.errors import ConfigError
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.tuning.models import Floats

LONGEST = 0.5
"""Longest delay of a :class:`LateActuator` [s]."""


class LateActuator(LeafSystem):  # type: ignore[misc, unused-ignore]
    """An actuator that acts late, with a disturbance before and a load behind it.

    Without delay the input passes through. With ``n + f`` periods of delay, f below 1, the output is that of a control
    held for a period, averaged over the period: ``(1 - f) u[k - n] + f u[k - n - 1]``.

    Input port:
        u (size): controls, held over a period by whoever gives them.
    Output port:
        y (size): ``late(u + excitation) + load``.

    Parameters of the Context: 0: delay [s]; 1: excitation (size) [u], then load (size) [u]. All may change while it
    runs: excitation and load act from the next update on.

    State: discrete, excitation and load in force, then the controls of the last periods, newest first.

    Args:
        size: number of controls.
        period: time between updates of the control [s].
    """

    def __init__(self, size: int, period: float) -> None:
        super().__init__()
        self.size = int(size)
        self.period = check_number("LateActuator", "period", period, unit="s", above=0.0)
        rows = math.ceil(LONGEST / self.period) + 2
        self.u = self.DeclareVectorInputPort("u", self.size)
        self._delay = self.DeclareNumericParameter(BasicVector([0.0]))
        self._force = self.DeclareNumericParameter(BasicVector([0.0] * (2 * self.size)))
        self._memory = self.DeclareDiscreteState([0.0] * ((2 + rows) * self.size))
        self.y = self.DeclareVectorOutputPort(
            "y",
            self.size,
            self._calc,
            prerequisites_of_calc={self.u.ticket(), self.xd_ticket(), self.all_parameters_ticket()},
        )
        self.DeclarePeriodicDiscreteUpdateEvent(self.period, 0.0, self._update)

    def set_delay(self, context: Context, delay: float) -> None:
        """Write the delay [s] into a Context of this system.

        Raises:
            ConfigError: negative, or longer than :data:`LONGEST`.
        """
        check_number("LateActuator", "delay", delay, unit="s", at_least=0.0, at_most=LONGEST)
        context.get_mutable_numeric_parameter(self._delay).SetAtIndex(0, delay)

    def excite(self, context: Context, values: list[float]) -> None:
        """Write what is added to the controls, before the delay."""
        context.get_mutable_numeric_parameter(self._force).get_mutable_value()[: self.size] = values

    def load(self, context: Context, values: list[float]) -> None:
        """Write what is added behind the delay."""
        context.get_mutable_numeric_parameter(self._force).get_mutable_value()[self.size :] = values

    def _calc(self, context: Context, output: BasicVector) -> None:
        n = self.size
        memory = context.get_discrete_state(self._memory).value()
        periods = context.get_numeric_parameter(self._delay).value().item() / self.period
        whole = math.floor(periods + 1e-9)
        part = max(periods - whole, 0.0)
        at = (1 + whole) * n  # the newest past control is at 2 n
        late = memory[at : at + n] if whole else self.u.Eval(context) + memory[:n]
        if part:
            late = (1.0 - part) * late + part * memory[at + n : at + 2 * n]
        output.SetFromVector(late + memory[n : 2 * n])

    def _update(self, context: Context, values: DiscreteValues) -> None:
        n = self.size
        old, new = context.get_discrete_state(self._memory).value(), values.get_mutable_value(self._memory)
        new[: 2 * n] = context.get_numeric_parameter(self._force).value()
        new[2 * n : 3 * n] = self.u.Eval(context) + old[:n]
        new[3 * n :] = old[2 * n : -n]


class NoisySensor(LeafSystem):  # type: ignore[misc, unused-ignore]
    """A vector with noise on some of its elements.

    Input port:
        u (size).
    Output port:
        y (size): u, and at each of `places` the noise of the present period.

    Abstract parameter 0 of the Context: the places, and the noise of every period, shape (n,); the last one holds on.
    No numbers: none.

    Args:
        size: of the vector.
        period: time for which a noise holds [s].
    """

    def __init__(self, size: int, period: float) -> None:
        super().__init__()
        self.size, self.period = int(size), check_number("NoisySensor", "period", period, unit="s", above=0.0)
        self.u = self.DeclareVectorInputPort("u", self.size)
        self._noise = self.DeclareAbstractParameter(Value[object](([], np.zeros(0))))
        self.y = self.DeclareVectorOutputPort("y", self.size, self._calc)

    def set_noise(self, context: Context, places: list[int], noise: Floats) -> None:
        """Write into a Context of this system which elements are noisy, and the noise of every period.

        Raises:
            ConfigError: a place outside of the vector.
        """
        if any(not 0 <= place < self.size for place in places):
            raise ConfigError(f"NoisySensor: places must be from 0 to {self.size - 1}")
        context.get_mutable_abstract_parameter(self._noise).set_value((list(places), noise))

    def _calc(self, context: Context, output: BasicVector) -> None:
        values = self.u.Eval(context)
        places, noise = context.get_abstract_parameter(self._noise).get_value()
        if len(noise):
            values = values.copy()
            values[places] += noise[min(int(context.get_time() / self.period + 1e-6), len(noise) - 1)]
        output.SetFromVector(values)
