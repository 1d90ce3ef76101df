"""Speed loop of a vehicle: wheel-speed set-points, trimmed until the vehicle reaches its set-point.

The feed-forward is free rolling, speed over wheel radius times the Ackermann ratio of each wheel; a PI controller adds
a speed trim, which takes up slip and tyre deflection.
"""

from collections.abc import Sequence

from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from mirdrake.controllers.ackermann import Ackermann, SteeringGeometry
from mirdrake.core.checks import check_number
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.pid import PidGains, PidLimits, PidNumbers, PidState, pid_step
from mirdrake.core.signals import declare_state_output, declare_vector_input, signals
from mirdrake.core.vectors import SETPOINT, WHEEL_SPEEDS

WheelRates = tuple[float, float, float, float]

CRUISE_GAINS = PidGains(kp=0.5, ki=0.5)
"""Trim per speed error: kp [1], ki [1/s]. Half the error at once, the rest in about three seconds."""

CRUISE_LIMITS = PidLimits(minimum=-1.0, maximum=1.0)
"""The trim is limited to 1 m/s."""

_EMPTY = PidState()


def wheel_speed_setpoints(speed: float, ratios: WheelRates, radii: WheelRates) -> WheelRates:
    """Return the spin rates of free rolling [rad/s].

    Args:
        speed: speed of the rear axle centre [m/s].
        ratios: speeds of the wheel centres over that speed, from :meth:`Ackermann.wheel_speed_ratios`.
        radii: rolling radius of each wheel [m].
    """
    front_left, front_right, rear_left, rear_right = ratios
    return (
        speed * front_left / radii[0],
        speed * front_right / radii[1],
        speed * rear_left / radii[2],
        speed * rear_right / radii[3],
    )


def cruise_step(
    state: Sequence[float],
    reference: float,
    measurement: float,
    period: float,
    gains: PidGains | PidNumbers = CRUISE_GAINS,
    limits: PidLimits = CRUISE_LIMITS,
) -> tuple[PidState, float]:
    """Advance the speed loop by one period.

    When the set-point is exactly zero there is no trim and the integral is reset, so that the wheels stop and
    stay stopped.

    Args:
        state: what the last step returned, or its numbers; ``PidState()`` at first.
        reference: set-point of the speed [m/s].
        measurement: speed of the rear axle centre [m/s].
        period: time since the last step [s].
        gains: gains from speed error to speed trim.
        limits: limits of the trim [m/s].

    Returns:
        The state for the next step, and the trimmed speed [m/s] for :func:`wheel_speed_setpoints`.
    """
    if reference == 0.0:
        return _EMPTY, 0.0
    after, trim = pid_step(state, reference, measurement, gains, period, limits)
    return after, reference + trim


class SpeedControl(LeafSystem):
    """Speed and steering set-point to wheel-speed set-points.

    Input ports:
        setpoint (2) [m/s, rad]: speed and bicycle steering angle.
        speed (1) [m/s]: forward speed of the rear axle centre.

    Output ports:
        wheel_speeds (4) [rad/s]: front_left, front_right, rear_left, rear_right; a state output, held between the
            updates.

    Parameters of the Context: kp [1], ki [1/s] of the trim.

    State: discrete, group 0 the wheel speeds, group 1 a :class:`~mirdrake.core.pid.PidState`.

    Args:
        geometry: lengths and limits of the vehicle.
        wheel_radius: rolling radius [m].
        period: time between updates [s].
        gains: gains of the trim; only kp and ki are used.
        limits: limits of the trim [m/s].

    Raises:
        ConfigError: a length or the period is not positive.
    """

    def __init__(
        self,
        geometry: SteeringGeometry,
        *,
        wheel_radius: float,
        period: float,
        gains: PidGains = CRUISE_GAINS,
        limits: PidLimits = CRUISE_LIMITS,
    ):
        super().__init__()
        self.law = Ackermann(geometry)
        self.wheel_radius = check_number("SpeedControl", "wheel_radius", wheel_radius, unit="m", above=0.0)
        self.period = check_number("SpeedControl", "period", period, unit="s", above=0.0)
        self.limits = limits
        self.setpoint = declare_vector_input(self, "setpoint", SETPOINT)
        self.speed = declare_vector_input(self, "speed", signals(("speed", "m/s")))
        self._gains = self.DeclareNumericParameter(BasicVector([gains.kp, gains.ki]))
        self._wheels = self.DeclareDiscreteState(4)
        self._memory = self.DeclareDiscreteState(list(PidState()))
        self.wheel_speeds = declare_state_output(self, "wheel_speeds", WHEEL_SPEEDS, self._wheels)
        self.DeclareInitializationDiscreteUpdateEvent(self._initialize)
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=self.period, offset_sec=0.0, update=self._update)

    def set_gains(self, context: Context, gains: PidGains) -> None:
        """Write kp and ki into a Context of this system; the trim does not jump."""
        context.get_mutable_numeric_parameter(self._gains).SetFromVector([gains.kp, gains.ki])

    def get_gains(self, context: Context) -> PidGains:
        """Return the gains of a Context of this system."""
        return PidGains(*context.get_numeric_parameter(self._gains).value().tolist())

    def _step(self, context: Context) -> tuple[PidState, WheelRates]:
        speed, steering = self.setpoint.Eval(context).tolist()
        state = PidState(*context.get_discrete_state(self._memory).value().tolist())
        measured = self.speed.Eval(context).item()
        gains = self.get_gains(context)
        state, trimmed = cruise_step(state, speed, measured, period=self.period, gains=gains, limits=self.limits)
        ratios = self.law.wheel_speed_ratios(self.law.clip(steering))
        return state, wheel_speed_setpoints(trimmed, ratios, radii=(self.wheel_radius,) * 4)

    def _initialize(self, context: Context, values: DiscreteValues) -> None:
        """Output the set-points of the first inputs; the first update, at the same time, counts as the first step."""
        values.set_value(self._wheels, self._step(context)[1])

    def _update(self, context: Context, values: DiscreteValues) -> None:
        state, wheels = self._step(context)
        values.set_value(self._wheels, wheels)
        values.set_value(self._memory, state)
