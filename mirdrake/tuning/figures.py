"""Figures of a time response.

Definitions: Åström and Hägglund, Advanced PID Control (2006), section 4.4 (IAE, ITAE, ISE, overshoot, rise, settling);
total variation of the control: Skogestad (2003), equation 30.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mirdrake.core.errors import ConfigError
from mirdrake.core.pid import NO_LIMITS, PidLimits
from mirdrake.tuning.models import Floats


@dataclass(frozen=True, slots=True)
class Figures:
    """Figures of one response; [y] and [u] are the units of measurement and control.

    Attributes:
        finite: whether all samples are finite; if not, the costs are inf and the others nan.
        iae: integral of the absolute error [y s].
        itae: integral of the absolute error, weighted with the time since the first sample [y s²].
        ise: integral of the squared error [y² s].
        overshoot: largest excess over the last set-point, relative to the step [1].
        rise_time: from 10 to 90 % of the step [s]; nan if 90 % are not reached.
        settling_time: until it stays within 2 % of the step around the last set-point [s]; nan if it does not.
        steady_error: mean error over the last tenth of the time [y].
        peak_effort: largest absolute control [u].
        rms_effort: root mean square of the control [u].
        total_variation: sum of the absolute changes of the control [u].
        saturation_time: time at a limit of value or rate [s].
        rms_jerk: root mean square of the second derivative of the measurement [y/s²]; of a speed, the jerk.
        peak_jerk: largest absolute second derivative of the measurement [y/s²].
    """

    finite: bool
    iae: float
    itae: float
    ise: float
    overshoot: float
    rise_time: float
    settling_time: float
    steady_error: float
    peak_effort: float
    rms_effort: float
    total_variation: float
    saturation_time: float
    rms_jerk: float
    peak_jerk: float


def response_figures(
    time: ArrayLike,
    reference: ArrayLike,
    measurement: ArrayLike,
    control: ArrayLike,
    *,
    limits: PidLimits = NO_LIMITS,
    band: float = 0.02,
) -> Figures:
    """Return the figures of a response to a step of the set-point, or of a load.

    The set-point is that of a sampled controller, which holds it between its updates, and the record has the values
    just before them, as a Drake log: the last value is the set-point since the sample before. With that, integrals use
    the trapezoidal rule. An error at the samples alone would be that against the set-point of a period ago, so that a
    loop which lags a ramp by a period would have none.

    The step is from the first measurement to the last set-point; without one (a step of the load) overshoot, rise and
    settling time are nan.

    Args:
        time: [s], increasing, shape (n,), n >= 3.
        reference: set-point [y], shape (n,) or one number; sample k is that between the times k - 1 and k.
        measurement: [y], shape (n,).
        control: [u], shape (n,).
        limits: limits of the control, for the saturation time.
        band: half the band of the settling time, relative to the step [1].

    Raises:
        ConfigError: shapes differ, or time does not increase.
    """
    t, y, u = (np.asarray(row, dtype=float) for row in (time, measurement, control))
    if t.ndim != 1 or len(t) < 3 or y.shape != t.shape or u.shape != t.shape or not (np.diff(t) > 0.0).all():
        raise ConfigError(
            f"response_figures: time must increase, and all rows have its length, 3 at least; "
            f"got {t.shape}, {y.shape}, {u.shape}"
        )
    r = np.broadcast_to(np.asarray(reference, dtype=float), t.shape)
    if not (np.isfinite(y).all() and np.isfinite(u).all() and np.isfinite(r).all()):
        # A response that is not finite has infinite costs and no figures, so that any search rejects it.
        return Figures(False, *[math.inf] * 3, *[math.nan] * 10)
    # Errors count from the first sample; `past` makes ITAE and times relative to the step.
    error = r - y
    sizes = held_errors(r, y)
    past = t - t[0]
    step = float(r[-1] - y[0])
    overshoot = rise = settling = math.nan
    # Relative to the signal: rounding of a constant set-point is not a step. Without one the figures stay NaN.
    if abs(step) > 1e-12 * max(abs(float(r[-1])), abs(float(y[0])), 1e-12):
        part = (y - y[0]) / step
        overshoot = max(float(part.max()) - 1.0, 0.0)
        # Rise time from 10 to 90 %, as usual for a step response.
        rise = _reach(past, part, 0.9) - _reach(past, part, 0.1)
        settling = _settle(past, part, band)

    # The effort is saturated at a limit of its value or of its rate.
    last = past >= 0.9 * past[-1]
    moves = np.diff(u)
    widths = np.diff(t)
    at_value = (u >= limits.maximum) | (u <= limits.minimum)

    # The controller limits its rate exactly; the tolerance allows for rounding in its sums.
    at_rate = np.concatenate([[False], np.abs(moves) >= limits.rate * widths * (1.0 - 1e-9)])
    # Jerk of the output for a speed loop: second difference, with the distance of the midpoints as step.
    speed = np.diff(y) / widths
    jerk = np.diff(speed) / (0.5 * (widths[1:] + widths[:-1]))
    return Figures(
        finite=True,
        iae=float(np.sum(0.5 * sum(sizes) * widths)),
        itae=float(np.sum(0.5 * (sizes[0] * past[:-1] + sizes[1] * past[1:]) * widths)),
        ise=float(np.sum(0.5 * (sizes[0] ** 2 + sizes[1] ** 2) * widths)),
        overshoot=overshoot,
        rise_time=rise,
        settling_time=settling,
        steady_error=float(error[last].mean()),
        peak_effort=float(np.abs(u).max()),
        rms_effort=math.sqrt(_integral(u**2, t) / float(past[-1])),
        total_variation=float(np.abs(moves).sum()),
        # A saturated sample counts with the step that follows it; the last one with its own.
        saturation_time=float(np.append(widths, widths[-1])[at_value | at_rate].sum()),
        rms_jerk=math.sqrt(float(np.mean(jerk**2))),
        peak_jerk=float(np.abs(jerk).max()),
    )


def held_errors(reference: Floats, measurement: Floats) -> tuple[Floats, Floats]:
    """Return the absolute error at the begin and at the end of each interval between samples [y], shapes (n - 1,).

    Args:
        reference: set-point [y], shape (n,); sample k is that between the times k - 1 and k.
        measurement: [y], shape (n,).
    """
    held = reference[1:]
    return np.abs(held - measurement[:-1]), np.abs(held - measurement[1:])


def _integral(values: Floats, time: Floats) -> float:
    return float(np.sum(0.5 * (values[1:] + values[:-1]) * np.diff(time)))


def _reach(time: Floats, part: Floats, level: float) -> float:
    """Return the time at which `part` first reaches `level`, interpolated between samples; nan if it does not."""
    over = part >= level
    if not over.any():
        return math.nan
    k = int(np.argmax(over))
    if k == 0:
        return float(time[0])
    share = (level - part[k - 1]) / (part[k] - part[k - 1])
    return float(time[k - 1] + share * (time[k] - time[k - 1]))


def _settle(time: Floats, part: Floats, band: float) -> float:
    """Return the time after which `part` stays within 1 ± band, interpolated; nan if it ends outside."""
    outside = np.abs(part - 1.0) > band
    if outside[-1]:
        return math.nan
    if not outside.any():
        return 0.0
    k = len(outside) - 1 - int(np.argmax(outside[::-1]))
    level = 1.0 + band if part[k] > 1.0 else 1.0 - band
    share = (level - part[k]) / (part[k + 1] - part[k])
    return float(time[k] + share * (time[k + 1] - time[k]))
