"""Processes and loops for experiments, and the exact simulation of a linear process with dead time.

A *process* is a callable that holds a control [u] for one period and returns the measurement [y] at its end, such as a
Drake simulator or :class:`LinearProcess`. A *loop* is a callable that adds an excitation to the control of a closed
loop for one period, such as :class:`PidLoop`.
"""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy  # its parts are imported when they are first used
from numpy.typing import ArrayLike

from mirdrake.core.checks import check_number
from mirdrake.core.errors import ConfigError
from mirdrake.core.pid import NO_LIMITS, PidGains, PidLimits, PidState, pid_step
from mirdrake.tuning.models import Floats, TransferFunction

Process = Callable[[float], float]
Loop = Callable[[float], tuple[float, float]]


class LinearProcess:
    """Transfer function with dead time under a held control, exact at the ends of the periods.

    The dead time need not be a multiple of the period: the old control acts for the first part of the period, the new
    one for the rest (K. J. Åström and B. Wittenmark, Computer-Controlled Systems, 3rd ed., section 2.3).

    Args:
        plant: the transfer function, initially at rest.
        period: time for which the control is held [s].

    Raises:
        ConfigError: the period is not positive.
    """

    def __init__(self, plant: TransferFunction, period: float):
        self.plant = plant
        self.period = check_number("LinearProcess", "period", period, unit="s", above=0.0)
        self.matrices = discrete_matrices(plant, self.period)
        self.reset()

    def reset(self) -> None:
        """Reset to rest."""
        whole = self.matrices.whole
        self._state = np.zeros(len(self.matrices.row))
        self._controls = deque([0.0] * (whole + 2), maxlen=whole + 2)

    def __call__(self, control: float) -> float:
        """Hold `control` [u] for one period and return the measurement [y] at its end."""
        # The queue has one control more than whole periods of dead time, for the rest of a period.
        self._controls.append(control)
        old, new = self._controls[0], self._controls[1]
        parts = self.matrices
        self._state = parts.step @ self._state + parts.old * old + parts.new * new
        return float(parts.row @ self._state) + parts.through * new


@dataclass(frozen=True, slots=True)
class DiscreteMatrices:
    """Transfer function with dead time over one period of a held control.

    With the state x and the control u of each period, ``x <- step x + old u[k - whole - 1] + new u[k - whole]``; the
    measurement is ``row x + through u[k - whole]``. An input without dead time adds ``held`` times its value.

    Attributes:
        step: transition of the state, shape (n, n).
        old: effect of the control before the last whole period of dead time, shape (n).
        new: effect of the control after it, shape (n).
        held: effect of an input without dead time, shape (n).
        row: measurement per state, shape (n).
        through: direct feedthrough [y/u].
        whole: whole periods of dead time.
    """

    step: Floats
    old: Floats
    new: Floats
    held: Floats
    row: Floats
    through: float
    whole: int


@lru_cache(maxsize=512)
def discrete_matrices(plant: TransferFunction, period: float) -> DiscreteMatrices:
    """Return the matrices of a transfer function for a control that is held for a period [s]; they are not changed."""
    order = len(plant.denominator) - 1
    # Pad the numerator to the order of the denominator; its first coefficient is the direct feedthrough.
    numerator = np.concatenate([np.zeros(order + 1 - len(plant.numerator)), plant.numerator])
    row = np.asarray(numerator[1:] - numerator[0] * np.array(plant.denominator[1:]), dtype=float)

    # Controllable canonical form; the last state of the extended matrix is the control.
    extended = np.zeros((order + 1, order + 1))
    if order:
        extended[0, :order] = -np.array(plant.denominator[1:])
        extended[1:order, : order - 1] = np.eye(order - 1)
        extended[0, order] = 1.0
    # Dead time = whole periods plus a rest; within a period the older control acts first, for the rest.
    periods = plant.delay / period
    whole = math.floor(periods + 1e-9)
    late = max(periods - whole, 0.0) * period
    # exp of the extended matrix holds the state transition and the integral over the held control (van Loan).
    first, second = (scipy.linalg.expm(extended * time) for time in (late, period - late))
    step = second[:order, :order] @ first[:order, :order]
    old, new = second[:order, :order] @ first[:order, order], second[:order, order].copy()
    return DiscreteMatrices(step, old, new, old + new, row, float(numerator[0]), whole)


class PidLoop:
    """A process under PID control, with an excitation added to the control.

    Args:
        process: the process, at rest.
        gains: gains of the controller.
        period: period of controller and process [s].
        reference: set-point [y].
        measurement: the measurement before the first period [y].
        limits: limits of the control.
    """

    def __init__(
        self,
        process: Process,
        gains: PidGains,
        period: float,
        *,
        reference: float = 0.0,
        measurement: float = 0.0,
        limits: PidLimits = NO_LIMITS,
    ):
        self.process, self.gains, self.limits = process, gains, limits
        self.period = check_number("PidLoop", "period", period, unit="s", above=0.0)
        self.reference, self.measurement = reference, measurement
        self._state = PidState()

    def __call__(self, excitation: float) -> tuple[float, float]:
        """Advance by one period; return the control [u] and the measurement at its beginning [y]."""
        measured = self.measurement
        # The excitation enters as feed-forward, so that the controller's limits apply to the sum.
        self._state, control = pid_step(
            self._state,
            self.reference,
            measured,
            gains=self.gains,
            period=self.period,
            limits=self.limits,
            feedforward=excitation,
        )
        self.measurement = self.process(control)
        return control, measured


@dataclass(frozen=True, slots=True)
class Response:
    """Response of a closed loop; every array has one entry per period.

    Attributes:
        time: beginning of the period [s].
        reference: set-point [y].
        measurement: measurement at `time` [y].
        control: control held from `time` on [u].
    """

    time: Floats
    reference: Floats
    measurement: Floats
    control: Floats


def simulate_loop(
    process: Process,
    gains: PidGains,
    *,
    period: float,
    reference: ArrayLike,
    disturbance: ArrayLike = 0.0,
    measurement: float = 0.0,
    limits: PidLimits = NO_LIMITS,
) -> Response:
    """Simulate a process under PID control.

    The simulation of an unstable loop ends before the first number that is not finite or exceeds 1e12.

    Args:
        process: the process, at rest.
        gains: gains of the controller.
        period: period of controller and process [s].
        reference: set-point of each period, shape (n,) [y].
        disturbance: load added to the control after its limits, shape (n,) or one number [u].
        measurement: the measurement at time 0 [y].
        limits: limits of the control.

    Raises:
        ConfigError: the reference is not a row of numbers.
    """
    set_points = np.asarray(reference, dtype=float)
    if set_points.ndim != 1 or not np.isfinite(set_points).all():
        raise ConfigError(f"simulate_loop: reference must be a row of finite numbers, got shape {set_points.shape}")
    # A load may be given as one number; it acts behind the limits of the controller.
    loads = np.broadcast_to(np.asarray(disturbance, dtype=float), set_points.shape)
    state, rows = PidState(), np.zeros((len(set_points), 2))
    done = len(set_points)
    for k, (set_point, load) in enumerate(zip(set_points.tolist(), loads.tolist(), strict=True)):
        state, control = pid_step(state, set_point, measurement, gains=gains, period=period, limits=limits)
        # Not finite or huge: stop before the numbers overflow, and keep the samples so far.
        if not (abs(measurement) < 1e12 and abs(control) < 1e12):
            done = k
            break
        rows[k] = measurement, control
        measurement = process(control + load)
    return Response(np.arange(done, dtype=float) * period, set_points[:done], rows[:done, 0], rows[:done, 1])
