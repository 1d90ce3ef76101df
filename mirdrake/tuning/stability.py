"""Exact stability test of a closed loop with dead time, without Padé approximation or simulation.

With L = N(s) exp(-T s) / D(s), the closed loop's poles are the zeros of D(s) + N(s) exp(-T s). As ω goes from 0 to
infinity, the argument of that function at jω changes by (n - 2 Z) π/2, with the degree n of D and the number Z of zeros
in the right half plane (A. V. Mikhailov 1938; for dead times L. S. Pontryagin 1942; see R. F. Curtain and H. Zwart, or
K. Gu, V. Kharitonov and J. Chen, Stability of Time-Delay Systems, section 1.3). Poles of L at the origin need no
special treatment.
"""

import math

import numpy as np

from mirdrake.core.errors import ConfigError
from mirdrake.core.pid import PidGains
from mirdrake.tuning.gains import controller_transfer_function
from mirdrake.tuning.models import Complexes, Floats, TransferFunction

_MAX_POINTS = 200_000


def is_stable(plant: TransferFunction, gains: PidGains) -> bool:
    """Return whether a plant under continuous PID control is stable.

    Args:
        plant: the plant; add half a period of a sampled controller to its dead time.
        gains: the gains; not all zero.

    Raises:
        ConfigError: the controller is not proper.
    """
    return count_unstable_poles(plant * controller_transfer_function(gains)) == 0


def count_unstable_poles(loop: TransferFunction) -> float:
    """Return the number of poles of the closed loop in the right half plane or on the imaginary axis.

    Returns:
        The number, for unit negative feedback; inf for a loop with dead time and a high-frequency gain of 1 or more.

    Raises:
        ConfigError: the loop is too close to the limit of stability for a decision.
    """
    order = len(loop.denominator) - 1
    # Without dead time the characteristic polynomial D + N decides; an order that is lost is a pole at infinity.
    if not loop.delay:
        poles = np.roots(np.polyadd(loop.denominator, loop.numerator))
        lost = order - len(poles)  # the leading coefficients cancel
        # A relative tolerance: roots on the axis have real parts of rounding size, and count as unstable.
        return float(np.sum(poles.real >= -1e-12 * np.maximum(np.abs(poles), 1e-300))) + lost
    # Neutral type: with a feedthrough of 1 or more, dead time gives infinitely many unstable poles.
    through = abs(loop.numerator[0]) if len(loop.numerator) == len(loop.denominator) else 0.0
    if through >= 1.0:
        return math.inf
    turn = _turn(loop)
    if turn is None:
        return 1.0
    # Principle of the argument (Mikhailov): of n poles, p in the right half plane turn by (n - 2 p) π / 2.
    return float(max(round(0.5 * order - turn / math.pi), 0))


def _turn(loop: TransferFunction) -> float | None:
    """Return the change of the argument of D + N exp(-T s) along the upper imaginary axis [rad]; None at a zero."""

    def value(w: Floats) -> Complexes:
        s = 1j * w
        return np.asarray(
            np.polyval(loop.denominator, s) + np.polyval(loop.numerator, s) * np.exp(-loop.delay * s), dtype=complex
        )

    # A zero at s = 0 is a pole of the closed loop on the axis.
    start = loop.denominator[-1] + loop.numerator[-1]
    scale = abs(loop.denominator[-1]) + abs(loop.numerator[-1])
    if abs(start) <= 1e-12 * scale or scale == 0.0:
        return None
    # Above `high` the leading term of D decides; a feedthrough below 1 turns by less than 90°, which rounding removes.
    high = _highest(loop)
    w = np.concatenate([[0.0], np.geomspace(1e-9 * high, high, 800)])
    values = value(w)

    # Halve intervals in which the argument turns by more than 0.5 rad, so that no turn by ±π is ambiguous.
    for _ in range(40):
        steps = np.abs(np.angle(values[1:] / values[:-1]))
        split = np.flatnonzero(steps > 0.5)
        if not len(split):
            break
        if len(w) > _MAX_POINTS:
            raise ConfigError(
                "stability: the loop is too close to the limit of stability, or its dead time too long, for a decision"
            )
        new = 0.5 * (w[split] + w[split + 1])
        # The interval cannot be halved any more in floating point: the jump is a zero on the axis.
        if np.any((new <= w[split]) | (new >= w[split + 1])) or np.any(value(new) == 0.0):
            return None
        w = np.insert(w, split + 1, new)
        values = np.insert(values, split + 1, value(new))
    else:
        return None  # no refinement resolves the jump of the argument: a zero on the axis
    return float(np.sum(np.angle(values[1:] / values[:-1])))


def _highest(loop: TransferFunction) -> float:
    """Return the frequency [rad/s] above which the argument is constant: D is its leading term, N is negligible."""
    largest = 1.0
    order = len(loop.denominator) - 1
    # For each coefficient the frequency above which its term is less than a thousandth of the leading term.
    for polynomial in (loop.denominator, loop.numerator):
        degree = len(polynomial) - 1
        for k, coefficient in enumerate(polynomial):
            drop = order - degree + k
            if drop > 0 and coefficient != 0.0:
                largest = max(
                    largest if largest != 1.0 else 0.0, (1e3 * (order + 1) * abs(coefficient)) ** (1.0 / drop)
                )
    return largest
