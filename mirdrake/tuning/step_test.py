"""Step test: simple models from the response of an open loop to a step of the control.

There are three methods for first order with dead time, and one for an integrator. Source: K. J. Åström and T. Hägglund,
Advanced PID Control (2006), section 2.7 (tangent and 63 %; areas); least squares on the analytic step response.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy  # its parts are imported when they are first used

from mirdrake.core.checks import check_number
from mirdrake.core.errors import ConfigError, RunError, did_you_mean
from mirdrake.tuning.models import FirstOrder, Floats, Integrator
from mirdrake.tuning.process_models import Process

Method = Literal["tangent", "area", "least_squares"]


@dataclass(frozen=True, slots=True)
class StepRecord:
    """Response to a step at time 0.

    Attributes:
        time: from 0 on, evenly spaced, shape (n,) [s].
        measurement: at `time`, shape (n,); the first entry is the value before the step [y].
        amplitude: height of the step [u].
    """

    time: Floats
    measurement: Floats
    amplitude: float

    def __post_init__(self) -> None:
        if self.time.shape != self.measurement.shape or self.time.ndim != 1 or len(self.time) < 20:
            raise ConfigError(
                f"StepRecord: time and measurement must have the same length of at least 20; "
                f"got {self.time.shape} and {self.measurement.shape}"
            )
        if check_number("StepRecord", "amplitude", self.amplitude) == 0.0:
            raise ConfigError("StepRecord: the amplitude must not be zero")
        if not np.isfinite(self.measurement).all():
            raise RunError("step test: the measurement is not finite; the loop is unstable, or the amplitude too large")


def run_step_test(
    process: Process, *, period: float, duration: float, amplitude: float, control: float = 0.0, rest: float = 0.0
) -> StepRecord:
    """Apply a step to the control of an open loop and record the measurement.

    Args:
        process: the process, see :mod:`mirdrake.tuning.process_models`.
        period: its period [s].
        duration: time after the step [s].
        amplitude: height of the step [u].
        control: control before the step [u].
        rest: time at `control` before the step, at least one period [s].

    Raises:
        ConfigError: a time is out of range.
        RunError: the measurement is not finite.
    """
    check_number("step test", "period", period, unit="s", above=0.0)
    steps = round(check_number("step test", "duration", duration, unit="s", above=0.0) / period)
    measured = 0.0
    for _ in range(max(round(rest / period), 1)):
        measured = process(control)
    values = [measured, *(process(control + amplitude) for _ in range(steps))]
    return StepRecord(np.arange(steps + 1, dtype=float) * period, np.array(values), amplitude)


def fit_first_order(record: StepRecord, method: Method = "least_squares", *, settled: float = 0.05) -> FirstOrder:
    """Fit first order with dead time to a step response.

    Args:
        record: the response, long enough to settle.
        method: ``tangent``: dead time from the steepest tangent, T from the time to 63 % (as for the AMIGO rule;
            sensitive to noise). ``area``: from two areas, robust to noise, with a smaller dead time for lags of
            high order. ``least_squares``: best fit of the whole response.
        settled: largest allowed drift over the last tenth, relative to the whole change [1].

    Raises:
        ConfigError: unknown method.
        RunError: the response has not settled, or is constant.
    """
    if method not in ("tangent", "area", "least_squares"):
        raise ConfigError(f"unknown method '{method}'; {did_you_mean(method, ('tangent', 'area', 'least_squares'))}")
    time = record.time
    # Change from the first sample; gain and shape then do not depend on the operating point.
    change = record.measurement - record.measurement[0]
    # Final value and drift are means over a twentieth of the record each, against noise.
    tail = max(len(time) // 20, 2)
    final = float(np.mean(change[-tail:]))
    if final == 0.0:
        raise RunError("step test: the measurement is constant; is the loop connected, and the step large enough?")
    drift = abs(final - float(np.mean(change[-2 * tail : -tail]))) / abs(final)
    if drift > settled:
        raise RunError(
            f"step test: not settled at the end ({drift:.0%} in the last tenth); increase the duration, or fit an "
            "integrator"
        )
    # Normalised to a unit step for the graphical methods.
    gain = final / record.amplitude
    unit = change / final
    if method == "tangent":
        time_constant, delay = _by_tangent(time, unit)
        return _limited(gain, time_constant, delay, time)
    time_constant, delay = _by_areas(time, unit)
    if method == "area":
        return _limited(gain, time_constant, delay, time)
    # The area method starts the fit; the unknowns are scaled to 1, as gain, T and L have different sizes.
    step = time[1] - time[0]
    scale = np.array([gain, max(time_constant, step), max(delay, step)])

    def residual(x: Floats) -> Floats:
        k, t, d = x * scale
        # expm1 keeps the digits of a small exponent; before the dead time the model is zero.
        past = np.maximum(time - d, 0.0)
        return np.asarray(k * record.amplitude * -np.expm1(-past / t) - change)

    start = np.array([1.0, 1.0, delay / scale[2]])
    # A time constant of zero would divide by zero; the dead time is within the record.
    limits = ([-np.inf, 1e-3, 0.0], [np.inf, np.inf, time[-1] / scale[2]])
    fit = scipy.optimize.least_squares(
        residual, np.clip(start, limits[0], limits[1]), bounds=limits, x_scale=[1.0, 1.0, 1.0]
    )
    best = fit.x * scale
    return FirstOrder(float(best[0]), float(best[1]), float(best[2]))


def fit_integrator(record: StepRecord, *, part: float = 0.3) -> Integrator:
    """Fit an integrator with dead time: the line through the last part of the response, and its intersection with 0.

    Args:
        record: the response.
        part: last fraction of the record, in which the slope is constant [1].

    Raises:
        RunError: the measurement is constant.
    """
    check_number("fit_integrator", "part", part, above=0.0, at_most=1.0)
    last = record.time >= record.time[-1] * (1.0 - part)
    slope, offset = np.polyfit(record.time[last], record.measurement[last] - record.measurement[0], 1)
    if slope == 0.0:
        raise RunError("step test: the measurement is constant; is the loop connected, and the step large enough?")
    return Integrator(float(slope) / record.amplitude, max(float(-offset / slope), 0.0))


def _by_tangent(time: Floats, unit: Floats) -> tuple[float, float]:
    """Return T and L by the steepest tangent and the time to 63 %."""
    # Dead time: where the steepest tangent crosses zero; T: from there to 63 %.
    slope = np.gradient(unit, time)
    steepest = int(np.argmax(slope))
    delay = float(time[steepest] - unit[steepest] / slope[steepest])
    level = 1.0 - np.exp(-1.0)
    after = int(np.argmax(unit >= level))
    rise = (level - unit[after - 1]) / (unit[after] - unit[after - 1])
    return float(time[after - 1] + rise * (time[after] - time[after - 1])) - delay, delay


def _by_areas(time: Floats, unit: Floats) -> tuple[float, float]:
    """Return T and L by areas: T + L is the area above the response, T/e the area below it up to T + L."""
    total = float(scipy.integrate.trapezoid(1.0 - unit, time))
    # A finer grid, as T + L is between two samples.
    fine = np.linspace(0.0, max(total, 0.0), 2000)
    time_constant = float(np.e * scipy.integrate.trapezoid(np.interp(fine, time, unit), fine))
    return time_constant, total - time_constant


def _limited(gain: float, time_constant: float, delay: float, time: Floats) -> FirstOrder:
    """Return the model, with a time constant and a dead time that the sampling can resolve."""
    return FirstOrder(gain, max(time_constant, 0.1 * float(time[1] - time[0])), max(delay, 0.0))
