"""Figures of steady-state cornering (ISO 4138)."""

import math
from dataclasses import dataclass

import numpy as np

from mirdrake.manoeuvres.base import Array


@dataclass(frozen=True)
class Fit:
    """A straight line through points.

    Attributes:
        slope: of the line.
        offset: its value at zero.
        error: root mean square of what the line leaves.
        low: smallest abscissa that was used.
        high: largest one.
        count: of points.
    """

    slope: float
    offset: float
    error: float
    low: float
    high: float
    count: int


def fit_line(x: Array, y: Array, low: float, high: float) -> Fit | None:
    """Least squares over the points with low <= x <= high; None if there are fewer than three, or all at one place."""
    chosen = (x >= low) & (x <= high) & np.isfinite(x) & np.isfinite(y)
    px, py = x[chosen], y[chosen]
    if len(px) < 3 or float(np.ptp(px)) < 1e-9:
        return None
    slope, offset = np.polyfit(px, py, 1)
    error = float(np.sqrt(np.mean((py - slope * px - offset) ** 2)))
    return Fit(float(slope), float(offset), error, float(px.min()), float(px.max()), len(px))


def means(time: Array, values: Array, window: float) -> Array:
    """Moving mean over a window [s], centred; shorter at the ends."""
    half = max(0, round(0.5 * window / float(time[1] - time[0])))
    total = np.concatenate(([0.0], np.cumsum(values)))
    index = np.arange(len(values))
    low, high = np.maximum(index - half, 0), np.minimum(index + half + 1, len(values))
    result: Array = (total[high] - total[low]) / (high - low)
    return result


def understeer_constant_radius(lateral: Array, steering: Array, low: float, high: float) -> Fit | None:
    """Understeer gradient dδ/day [rad s²/m] on a circle of constant radius.

    Args:
        lateral: lateral acceleration, positive in the turn [m/s²].
        steering: angle of the road wheels, positive in the turn [rad].
        low: lower end of the range of the regression [m/s²].
        high: its upper end [m/s²].
    """
    return fit_line(lateral, steering, low, high)


def understeer_constant_speed(
    lateral: Array, steering: Array, speed: Array, wheelbase: float, low: float, high: float
) -> Fit | None:
    """Understeer gradient [rad s²/m] at constant speed: dδ/day less L / v², the share of a neutral car.

    Args:
        lateral: see :func:`understeer_constant_radius`.
        steering: see there.
        speed: of each point [m/s].
        wheelbase: [m].
        low: see there.
        high: see there.
    """
    return fit_line(lateral, steering - wheelbase * lateral / speed**2, low, high)


def characteristic_speed(wheelbase: float, gradient: float) -> float:
    """Speed at which an understeering car's yaw gain is largest, √(L / K) [m/s]; NaN for others."""
    return math.sqrt(wheelbase / gradient) if gradient > 0.0 else math.nan


def critical_speed(wheelbase: float, gradient: float) -> float:
    """Speed above which an oversteering car is unstable, √(-L / K) [m/s]; NaN for others."""
    return math.sqrt(-wheelbase / gradient) if gradient < 0.0 else math.nan
