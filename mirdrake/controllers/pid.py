"""A discrete PID controller as a LeafSystem; :mod:`mirdrake.core.pid` has its law."""

from typing import Any

from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from mirdrake.core.checks import check_number
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.pid import NO_LIMITS, PidGains, PidLimits, PidState, pid_step
from mirdrake.core.signals import declare_state_output, declare_vector_input, signals

AUTOMATIC = -1.0
"""Value of the Context parameter ``tracking_time`` that represents None, the rule of :class:`PidGains`."""


class DiscretePid(LeafSystem):
    """A PID controller that runs every `period`.

    Input ports:
        reference (1) [signal_unit]: set-point.
        measurement (1) [signal_unit]: measured value.
        feedforward (1) [control_unit]: added before the limits; only with ``feedforward=True``.

    Output ports:
        control (1) [control_unit]: held between the updates; a state output, never evaluated in Python. The update at
            time t reads the inputs at t and shows its control right after t. Initialisation shows the control of the
            first inputs, so the port is right from t = 0; it leaves a controller that has run already as it is.

    Parameters of the Context: kp, ki, kd, filter_time, proportional_weight, derivative_weight, tracking_time (see
    :class:`PidGains`; a negative tracking_time stands for None). Change them with :meth:`set_gains`, at any time and
    without a bump.

    State: discrete, group 0 the control, group 1 the rest of :class:`PidState`.

    Args:
        gains: default gains of a new Context.
        period: time between updates [s].
        limits: limits of the control.
        feedforward: whether there is a port for it.
        signal_unit: unit of reference and measurement.
        control_unit: unit of the control.

    Raises:
        ConfigError: the period is not positive.
    """

    def __init__(
        self,
        gains: PidGains,
        *,
        period: float,
        limits: PidLimits = NO_LIMITS,
        feedforward: bool = False,
        signal_unit: str = "",
        control_unit: str = "",
    ):
        super().__init__()
        self.period = check_number("DiscretePid", "period", period, unit="s", above=0.0)
        self.limits = limits
        self.reference = declare_vector_input(self, "reference", signals(("reference", signal_unit)))
        self.measurement = declare_vector_input(self, "measurement", signals(("measurement", signal_unit)))
        self.feedforward: Any = None
        if feedforward:
            self.feedforward = declare_vector_input(self, "feedforward", signals(("feedforward", control_unit)))
        self._gains = self.DeclareNumericParameter(BasicVector(_to_vector(gains)))
        self._control = self.DeclareDiscreteState(1)
        # The control is a state of its own, so that its output port needs no calculation.
        self._memory = self.DeclareDiscreteState(list(PidState()[1:]))
        self.control = declare_state_output(self, "control", signals(("control", control_unit)), self._control)
        self.DeclareInitializationDiscreteUpdateEvent(self._initialize)
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=self.period, offset_sec=0.0, update=self._update)

    def set_gains(self, context: Context, gains: PidGains) -> None:
        """Write gains into a Context of this system; the running control does not jump."""
        context.get_mutable_numeric_parameter(self._gains).SetFromVector(_to_vector(gains))

    def get_gains(self, context: Context) -> PidGains:
        """Return the gains of a Context of this system."""
        kp, ki, kd, filter_time, b, c, tracking, clamp = context.get_numeric_parameter(self._gains).value().tolist()
        return PidGains(kp, ki, kd, filter_time, b, c, None if tracking < 0.0 else tracking, clamp)

    def set_integral(self, context: Context, integral: float) -> None:
        """Write the integral part [control_unit] into a Context of this system, for a warm start."""
        memory = self._read(context)._replace(integral=integral)
        context.SetDiscreteState(self._memory, list(memory[1:]))

    def get_integral(self, context: Context) -> float:
        """Return the integral part [control_unit] of a Context of this system."""
        return self._read(context).integral

    def _read(self, context: Context) -> PidState:
        (control,) = context.get_discrete_state(self._control).value().tolist()
        return PidState(control, *context.get_discrete_state(self._memory).value().tolist())

    def _step(self, context: Context, state: PidState) -> tuple[PidState, float]:
        return pid_step(
            state,
            self.reference.Eval(context).item(),
            self.measurement.Eval(context).item(),
            gains=self.get_gains(context),
            period=self.period,
            limits=self.limits,
            feedforward=0.0 if self.feedforward is None else self.feedforward.Eval(context).item(),
        )

    def _initialize(self, context: Context, values: DiscreteValues) -> None:
        """Output the control of the first inputs; the first update, at the same time, is the first step that counts."""
        state = self._read(context)
        if not state.started:
            values.set_value(self._control, [self._step(context, state)[1]])

    def _update(self, context: Context, values: DiscreteValues) -> None:
        state, control = self._step(context, self._read(context))
        values.set_value(self._control, [control])
        values.set_value(self._memory, list(state[1:]))


def _to_vector(gains: PidGains) -> list[float]:
    tracking_time = AUTOMATIC if gains.tracking_time is None else gains.tracking_time
    return [
        gains.kp,
        gains.ki,
        gains.kd,
        gains.filter_time,
        gains.proportional_weight,
        gains.derivative_weight,
        tracking_time,
        gains.max_integral,
    ]
