"""Blocks that a bench puts between a control unit and its plant: a late actuator with a load, and a noisy sensor.

What they do is set in the Context, so that nothing is built for another delay or noise.
"""

import math

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from mirdrake.controllers.checks import check_number
from mirdrake.errors import ConfigError
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

    Parameters of the Context: 0: delay [s]; 1: excitation (size) [u]; 2: load (size) [u]. All may change while it runs:
    excitation and load act from the next update on.

    State: discrete, group 0 the controls of the last periods, newest first; 1: excitation and load in force.

    Args:
        size: number of controls.
        period: time between updates of the control [s].
    """

    def __init__(self, size: int, period: float) -> None:
        super().__init__()
        self.size = int(size)
        self.period = check_number("LateActuator", "period", period, unit="s", above=0.0)
        self._rows = math.ceil(LONGEST / self.period) + 2
        self.u = self.DeclareVectorInputPort("u", self.size)
        self._delay = self.DeclareNumericParameter(BasicVector([0.0]))
        self._excitation = self.DeclareNumericParameter(BasicVector([0.0] * self.size))
        self._load = self.DeclareNumericParameter(BasicVector([0.0] * self.size))
        self._past = self.DeclareDiscreteState([0.0] * (self._rows * self.size))
        self._force = self.DeclareDiscreteState([0.0] * (2 * self.size))
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
        context.get_mutable_numeric_parameter(self._excitation).SetFromVector(values)

    def load(self, context: Context, values: list[float]) -> None:
        """Write what is added behind the delay."""
        context.get_mutable_numeric_parameter(self._load).SetFromVector(values)

    def _calc(self, context: Context, output: BasicVector) -> None:
        n = self.size
        now = self.u.Eval(context)
        force = context.get_discrete_state(self._force).value()
        delay = context.get_numeric_parameter(self._delay).value()[0]
        if delay == 0.0:
            output.SetFromVector(now + force[:n] + force[n:])
            return
        row = np.concatenate([now + force[:n], context.get_discrete_state(self._past).value()])
        periods = delay / self.period
        whole = math.floor(periods + 1e-9)
        part = max(periods - whole, 0.0)
        late = (1.0 - part) * row[whole * n : (whole + 1) * n]
        if part:
            late = late + part * row[(whole + 1) * n : (whole + 2) * n]
        output.SetFromVector(late + force[n:])

    def _update(self, context: Context, values: DiscreteValues) -> None:
        n = self.size
        force = context.get_discrete_state(self._force).value()
        past = context.get_discrete_state(self._past).value()
        values.set_value(self._past, np.concatenate([self.u.Eval(context) + force[:n], past[:-n]]))
        excitation = context.get_numeric_parameter(self._excitation).value()
        load = context.get_numeric_parameter(self._load).value()
        values.set_value(self._force, np.concatenate([excitation, load]))


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
