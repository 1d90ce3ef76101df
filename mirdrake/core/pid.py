"""Law of a discrete PID controller: set-point weights, filtered derivative, anti-windup, bumpless gain changes.

Source of the algorithm: K. J. Åström and R. M. Murray, Feedback Systems, 2nd ed., section 11.5 (implementation), and
K. J. Åström and T. Hägglund, Advanced PID Control, chapters 3 and 13. With period h, reference r, measurement y,
feed-forward f::

    P = kp (b r - y)
    D = kd (w - x) / (Tf + h),   w = c r - y,   x <- x + h (w - x) / (Tf + h)      backward difference of the filtered w
    v = P + I + D + f
    u = v, limited in value and in rate
    I <- I + ki h (r - y) + min(1, h / Tt) (u - v)                                  forward difference, back-calculation
    I <- I limited to ± max_integral

The integral part I is stored in units of the control, so a new ki acts on future errors only. When kp, b, kd, c or Tf
change, I takes up the change of P + D at that instant: the control continues from the value it would
have had with the old gains (bumpless). Without integral action (ki = 0) such a shift would remain, so there it
is not made, and I stays as it is, as a constant bias.
"""

import math
from collections.abc import MutableSequence, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

from mirdrake.core.checks import check_number


class PidNumbers(NamedTuple):
    """Gains as :func:`pid_step` uses them: checked, with the anti-windup time computed."""

    kp: float = 0.0
    ki: float = 0.0
    kd: float = 0.0
    filter_time: float = 0.0
    proportional_weight: float = 1.0
    derivative_weight: float = 0.0
    anti_windup_time: float = 0.0
    max_integral: float = math.inf


def tracking_time(kp: float, ki: float, kd: float) -> float:
    """Return the default time constant of the anti-windup [s], see :class:`PidGains`."""
    if ki == 0.0:
        return 0.0
    return math.sqrt(abs(kd / ki)) if kd != 0.0 else abs(kp / ki)


@dataclass(frozen=True, slots=True)
class PidGains:
    """Gains of a PID controller; [u], [y] are the units of control and measurement.

    Attributes:
        kp: proportional gain [u/y].
        ki: integral gain [u/(y s)].
        kd: derivative gain [u s/y].
        filter_time: time constant Tf of the derivative filter [s]; 0: none.
        proportional_weight: set-point weight b of the proportional part [1].
        derivative_weight: set-point weight c of the derivative part [1]; 0: no derivative kick.
        tracking_time: time constant Tt of the anti-windup [s]; 0: the integral follows at once, inf: no anti-windup,
            None: sqrt(kd/ki) with derivative part, kp/ki without (Åström and Murray 11.4), and 0 for a pure integrator.
        max_integral: limit of the magnitude of the integral part [u]; inf: none.
        anti_windup_time: the value in use [s], computed.

    Raises:
        ConfigError: a gain is not finite, or a time is negative or not a number.
    """

    kp: float
    ki: float = 0.0
    kd: float = 0.0
    filter_time: float = 0.0
    proportional_weight: float = 1.0
    derivative_weight: float = 0.0
    tracking_time: float | None = None
    max_integral: float = math.inf
    anti_windup_time: float = field(init=False)

    def __post_init__(self) -> None:
        kp, ki, kd, filter_time, tracking = self.kp, self.ki, self.kd, self.filter_time, self.tracking_time
        # One sum finds any value that is not finite; the loop then names it.
        if not math.isfinite(kp + ki + kd + self.proportional_weight + self.derivative_weight):
            for name in ("kp", "ki", "kd", "proportional_weight", "derivative_weight"):
                check_number("PidGains", name, getattr(self, name))
        if not 0.0 <= filter_time < math.inf:
            check_number("PidGains", "filter_time", filter_time, unit="s", at_least=0.0)
        if tracking is None:
            tracking = tracking_time(kp, ki, kd)
        elif not tracking >= 0.0:
            check_number("PidGains", "tracking_time", tracking, unit="s", at_least=0.0, infinite=True)
        if not self.max_integral >= 0.0:
            check_number("PidGains", "max_integral", self.max_integral, at_least=0.0, infinite=True)
        object.__setattr__(self, "anti_windup_time", tracking)

    def numbers(self) -> PidNumbers:
        """Return the gains as plain numbers."""
        return PidNumbers(*(getattr(self, name) for name in PidNumbers._fields))


@dataclass(frozen=True, slots=True)
class PidLimits:
    """Limits of the control.

    Attributes:
        minimum: smallest control [u].
        maximum: largest control [u].
        rate: largest change of the control per second [u/s].

    Raises:
        ConfigError: not numbers, minimum above maximum, or a rate that is not positive.
    """

    minimum: float = -math.inf
    maximum: float = math.inf
    rate: float = math.inf

    def __post_init__(self) -> None:
        check_number("PidLimits", "minimum", self.minimum, infinite=True)
        check_number("PidLimits", "maximum", self.maximum, infinite=True, at_least=self.minimum)
        check_number("PidLimits", "rate", self.rate, infinite=True, above=0.0)


class PidState(NamedTuple):
    """Memory of the controller between two steps.

    Attributes:
        control: the last control [u].
        integral: the integral part I [u].
        filtered: low-pass filtered c r - y [y].
        kp: gain of the last step, as are the next four.
        kd: see kp.
        filter_time: see kp.
        proportional_weight: see kp.
        derivative_weight: see kp.
        started: 0 before the first step, then 1.
    """

    control: float = 0.0
    integral: float = 0.0
    filtered: float = 0.0
    kp: float = 0.0
    kd: float = 0.0
    filter_time: float = 0.0
    proportional_weight: float = 1.0
    derivative_weight: float = 0.0
    started: float = 0.0


NO_LIMITS = PidLimits()


class AnyLimits(Protocol):
    """The limits that :func:`pid_step` reads: those of :class:`PidLimits`, checked or not."""

    @property
    def minimum(self) -> float: ...  # noqa: D102
    @property
    def maximum(self) -> float: ...  # noqa: D102
    @property
    def rate(self) -> float: ...  # noqa: D102


def pid_step(
    state: Sequence[float],
    reference: float,
    measurement: float,
    gains: PidGains | PidNumbers,
    period: float,
    limits: AnyLimits = NO_LIMITS,
    feedforward: float = 0.0,
) -> tuple[PidState, float]:
    """Advance the controller by one period; equations in the head of the module.

    Args:
        state: what the last step returned, or its numbers; ``PidState()`` at first, ``PidState(integral=...)`` for a
            warm start.
        reference: set-point r [y].
        measurement: measured value [y].
        gains: gains; may differ from step to step.
        period: time since the last step h [s], positive.
        limits: limits of the control. The rate limit does not act on the first step.
        feedforward: added to the control before the limits [u].

    Returns:
        The state for the next step, and the control [u].
    """
    last, integral, filtered, kp0, kd0, tf0, b0, c0, started = state
    kp, kd, tf, b, c = gains.kp, gains.kd, gains.filter_time, gains.proportional_weight, gains.derivative_weight
    ki = gains.ki
    weighted = c * reference - measurement

    # Derivative of the filtered signal; a change of c moves the signal, not the derivative.
    if not started:
        filtered = weighted
    elif c != c0:
        filtered += (c - c0) * reference
    gap = weighted - filtered
    proportional = kp * (b * reference - measurement)
    derivative = kd * gap / (tf + period)

    # Bumpless: the integral takes up what changed gains do to P + D.
    if started and ki != 0.0 and (kp != kp0 or kd != kd0 or b != b0 or tf != tf0):
        integral += kp0 * (b0 * reference - measurement) - proportional + kd0 * gap / (tf0 + period) - derivative

    # Value limit first, then rate limit.
    unlimited = proportional + integral + derivative + feedforward
    control = unlimited
    if control > limits.maximum:
        control = limits.maximum
    elif control < limits.minimum:
        control = limits.minimum
    if started:
        step = limits.rate * period
        if control > last + step:
            control = last + step
        elif control < last - step:
            control = last - step

    # Integral for the next step, with back-calculation from the control that was really given.
    if ki != 0.0:
        integral += ki * period * (reference - measurement)
        if control != unlimited:
            time = gains.anti_windup_time
            integral += (control - unlimited) * (period / time if time > period else 1.0)
        if integral > gains.max_integral:
            integral = gains.max_integral
        elif integral < -gains.max_integral:
            integral = -gains.max_integral
    filtered += gap * period / (tf + period)
    return PidState(control, integral, filtered, kp, kd, tf, b, c, 1.0), control


def read_pid(memory: Sequence[float], begin: int) -> PidState:
    """Return the state of a controller that begins at an index of a longer memory."""
    return PidState(
        memory[begin], memory[begin + 1], memory[begin + 2], memory[begin + 3], memory[begin + 4],
        memory[begin + 5], memory[begin + 6], memory[begin + 7], memory[begin + 8],
    )  # fmt: skip


def write_pid(memory: MutableSequence[float], begin: int, state: PidState) -> None:
    """Write the state of a controller into a longer memory; the inverse of :func:`read_pid`."""
    memory[begin], memory[begin + 1], memory[begin + 2] = state.control, state.integral, state.filtered
    memory[begin + 3], memory[begin + 4], memory[begin + 5] = state.kp, state.kd, state.filter_time
    memory[begin + 6], memory[begin + 7] = state.proportional_weight, state.derivative_weight
    memory[begin + 8] = state.started
