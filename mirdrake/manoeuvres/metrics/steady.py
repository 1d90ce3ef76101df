"""Figures of steady-state cornering (ISO 4138)."""

import math
from dataclasses import dataclass

import numpy as np

from mirdrake.manoeuvres.base import Array


@dataclass(frozen=True)
class Fit:
    """Straight line fitted to points.

    Attributes:
        slope: slope of the line.
        offset: value of the line at zero.
        error: root mean square of the residuals.
        low: smallest abscissa that was used.
        high: largest abscissa that was used.
        count: number of points.
    """

    slope: float
    offset: float
    error: float
    low: float
    high: float
    count: int


def fit_line(x: Array, y: Array, low: float, high: float) -> Fit | None:
    """Return the least-squares line of the points with low <= x <= high; None for fewer than three distinct points."""
    chosen = (x >= low) & (x <= high) & np.isfinite(x) & np.isfinite(y)
    px, py = x[chosen], y[chosen]
    # A line through equal abscissas has no slope.
    if len(px) < 3 or float(np.ptp(px)) < 1e-9:
        return None
    slope, offset = np.polyfit(px, py, 1)
    error = float(np.sqrt(np.mean((py - slope * px - offset) ** 2)))
    return Fit(float(slope), float(offset), error, float(px.min()), float(px.max()), len(px))


def means(time: Array, values: Array, window: float) -> Array:
    """Return the centred moving mean over a window [s]; the window is shorter at the ends."""
    half = max(0, round(0.5 * window / float(time[1] - time[0])))
    # Differences of a cumulative sum: the cost does not depend on the window.
    total = np.concatenate(([0.0], np.cumsum(values)))
    index = np.arange(len(values))
    low, high = np.maximum(index - half, 0), np.minimum(index + half + 1, len(values))
    result: Array = (total[high] - total[low]) / (high - low)
    return result


def understeer_constant_radius(lateral: Array, steering: Array, low: float, high: float) -> Fit | None:
    """Return the understeer gradient dδ/day [rad s²/m] on a circle of constant radius.

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
    """Return the understeer gradient [rad s²/m] at constant speed: dδ/day less L / v², the share of a neutral car.

    Args:
        lateral: lateral acceleration, positive in the turn [m/s²].
        steering: angle of the road wheels, positive in the turn [rad].
        speed: speed of each point [m/s].
        wheelbase: wheelbase [m].
        low: lower end of the range of the regression [m/s²].
        high: its upper end [m/s²].
    """
    return fit_line(lateral, steering - wheelbase * lateral / speed**2, low, high)


def characteristic_speed(wheelbase: float, gradient: float) -> float:
    """Return the speed of the largest yaw gain of an understeering car, √(L / K) [m/s]; NaN for others."""
    return math.sqrt(wheelbase / gradient) if gradient > 0.0 else math.nan


def critical_speed(wheelbase: float, gradient: float) -> float:
    """Return the speed above which an oversteering car is unstable, √(-L / K) [m/s]; NaN for others."""
    return math.sqrt(-wheelbase / gradient) if gradient < 0.0 else math.nan
