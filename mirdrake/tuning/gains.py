"""Forms of a PID controller, and its frequency response.

The controllers of mirdrake (:mod:`mirdrake.controllers.pid`) have the parallel form, with a filtered derivative::

    C(s) = kp + ki / s + kd s / (1 + Tf s)

Conversion of other forms in the literature::

    standard (ISA)    K (1 + 1 / (Ti s) + Td s)            kp = K, ki = K / Ti, kd = K Td
    series            Kc (1 + 1 / (τI s)) (1 + τD s)       f = 1 + τD / τI; K = Kc f, Ti = τI f, Td = τD / f

Source: K. J. Åström and T. Hägglund, Advanced PID Control (2006), section 3.2; Skogestad (2003), equation 36.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from mirdrake.core.checks import check_number
from mirdrake.core.errors import ConfigError
from mirdrake.core.pid import PidGains
from mirdrake.tuning.models import Complexes, TransferFunction

FILTER_RATIO = 10.0
"""Default of Td / Tf: the derivative part is at most ten times the proportional part."""


def from_standard(
    gain: float,
    integral_time: float = math.inf,
    derivative_time: float = 0.0,
    *,
    filter_ratio: float = FILTER_RATIO,
    proportional_weight: float = 1.0,
) -> PidGains:
    """Return gains from the standard form.

    Args:
        gain: K [u/y].
        integral_time: Ti [s]; inf: no integral part.
        derivative_time: Td [s].
        filter_ratio: Td / Tf [1]; inf: no filter.
        proportional_weight: set-point weight b [1].

    Raises:
        ConfigError: a time out of range, or a number that is not finite.
    """
    check_number("PID", "integral_time", integral_time, unit="s", above=0.0, infinite=True)
    check_number("PID", "derivative_time", derivative_time, unit="s", at_least=0.0)
    check_number("PID", "filter_ratio", filter_ratio, above=0.0, infinite=True)
    return PidGains(
        gain,
        gain / integral_time,
        gain * derivative_time,
        filter_time=derivative_time / filter_ratio,
        proportional_weight=proportional_weight,
    )


def from_series(
    gain: float, integral_time: float, derivative_time: float = 0.0, *, filter_ratio: float = FILTER_RATIO
) -> PidGains:
    """Return gains from the series form; arguments as for :func:`from_standard`.

    The filter time is the series derivative time over `filter_ratio`.
    """
    check_number("PID", "integral_time", integral_time, unit="s", above=0.0, infinite=True)
    factor = 1.0 + derivative_time / integral_time
    return from_standard(
        gain * factor, integral_time * factor, derivative_time / factor, filter_ratio=filter_ratio / factor
    )


def to_standard(gains: PidGains) -> tuple[float, float, float]:
    """Return K [u/y], Ti [s] and Td [s] of the standard form; Ti is inf without integral part.

    Raises:
        ConfigError: without proportional part there is no standard form.
    """
    if gains.kp == 0.0:
        raise ConfigError("a controller without proportional part has no standard form; use kp, ki and kd")
    return gains.kp, gains.kp / gains.ki if gains.ki else math.inf, gains.kd / gains.kp


def controller_response(gains: PidGains, frequencies: ArrayLike, *, period: float | None = None) -> Complexes:
    """Return the frequency response C(jω) of the feedback part [u/y].

    Args:
        gains: the gains.
        frequencies: ω [rad/s], any shape.
        period: time between updates h [s]; None: the continuous controller. With a period: the difference equations of
            :func:`~mirdrake.core.pid.pid_step` at z = exp(jωh), and the hold of the control over h. Aliases
            are neglected: ω must be below π/h.
    """
    s = 1j * np.asarray(frequencies, dtype=float)
    kp, ki, kd, filter_time = gains.kp, gains.ki, gains.kd, gains.filter_time
    if period is None:
        value = kp + kd * s / (1.0 + filter_time * s)
        return np.asarray(value + ki / s if ki else value, dtype=complex)
    z = np.exp(s * period)
    sampled = kp + kd * (z - 1.0) / ((filter_time + period) * z - filter_time)
    sampled = sampled + ki * period / (z - 1.0) if ki else sampled
    return np.asarray(sampled * hold_response(frequencies, period), dtype=complex)


def hold_response(frequencies: ArrayLike, period: float) -> Complexes:
    """Return the frequency response (1 - exp(-jωh)) / (jωh) of a zero-order hold over `period` [s]."""
    x = 0.5 * period * np.asarray(frequencies, dtype=float)
    return np.asarray(np.sinc(x / np.pi) * np.exp(-1j * x), dtype=complex)


def controller_transfer_function(gains: PidGains) -> TransferFunction:
    """Return the continuous controller as a transfer function.

    Raises:
        ConfigError: a derivative part without filter is not proper; or all gains are zero.
    """
    kp, ki, kd, filter_time = gains.kp, gains.ki, gains.kd, gains.filter_time
    if kd and not filter_time:
        raise ConfigError("a derivative part without filter is not proper; set filter_time")
    numerator, denominator = np.array([kp]), np.array([1.0])
    if kd:
        numerator, denominator = np.array([kp * filter_time + kd, kp]), np.array([filter_time, 1.0])
    if ki:
        numerator = np.polyadd(np.polymul(numerator, [1.0, 0.0]), ki * denominator)
        denominator = np.polymul(denominator, [1.0, 0.0])
    return TransferFunction(tuple(numerator.tolist()), tuple(denominator.tolist()))
