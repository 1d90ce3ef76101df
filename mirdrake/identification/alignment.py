"""How late channels are against each other, to a fraction of a sample, from pairs that kinematics ties together."""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from mirdrake.identification.data import Array, Log
from mirdrake.identification.findings import Finding
from mirdrake.identification.relations import Grid, Relation, kinematic_relations, make_grid
from mirdrake.identification.splines import Curve

LONGEST = 0.6
"""Delays are sought up to this [s]."""

SMOOTHING = 0.05
"""Standard deviation of the Gaussian that both sides pass before they are compared [s]; it shifts nothing."""

LEVELS = 4
"""The comparison is made with that smoothing, twice, four times, …; the one that is surest counts."""

STEERING = ("road_wheel_angle", "steering_wheel_angle", "steering_command")

BLOCKS = 10
"""Parts of a log, whose delays give the uncertainty and the drift."""


class Delay(NamedTuple):
    """How late one signal is behind another.

    Attributes:
        value: positive when the first one is late [s].
        sigma: its standard deviation, from its scatter over the log [s].
        drift: change of the delay with time [s/s].
        drift_sigma: its standard deviation [s/s].
        correlation: of both, once they are aligned.
    """

    value: float
    sigma: float
    drift: float
    drift_sigma: float
    correlation: float


def estimate_delay(left: Array, right: Array, step: float) -> Delay | None:
    """How late the first signal is behind the second, whatever its scale and offset; None: too little moves.

    It is where the cross-correlation has its peak; noise leaves it alone, if that of one side is not of the other.

    Args:
        left: samples on even steps (n).
        right: samples at the same times (n).
        step: [s].
    """
    if np.ptp(left) == 0.0 or np.ptp(right) == 0.0:
        return None
    best, width, passed, sides = None, SMOOTHING, 0.0, (left - left.mean(), right - right.mean())
    for _ in range(LEVELS):
        rows = np.sqrt(max(width**2 - passed**2, 0.0)) / step
        if rows >= 1.0 or passed == 0.0:
            rows = max(rows, 1.0)
            sides = (
                gaussian_filter1d(sides[0], rows, mode="nearest"),
                gaussian_filter1d(sides[1], rows, mode="nearest"),
            )
            passed = np.hypot(passed, rows * step)
            thin = max(1, int(passed / (2.0 * step)))  # what is smooth needs few samples
            sides, step = (sides[0][::thin], sides[1][::thin]), step * thin
            found = _delay_at(*sides, step, passed)
            if found is not None and (best is None or found.sigma < 0.7 * best.sigma):
                best = found
        width *= 2.0
    return best


def _delay_at(a: Array, b: Array, step: float, width: float) -> Delay | None:
    """The delay between two smooth signals; `width` is that of their smoothing [s]."""
    margin = int(np.ceil(3 * width / step))
    reach = min(int(LONGEST / step) + 1, len(a) // 4)
    if len(a) < 4 * margin + 40 or np.ptp(a) == 0.0 or np.ptp(b) == 0.0:
        return None
    size = 1 << int(2 * len(a) - 1).bit_length()
    # Differences of the samples weigh the fast part, which has the timing.
    spectrum = np.fft.rfft(np.gradient(a), size) * np.conj(np.fft.rfft(np.gradient(b), size))
    product = np.fft.irfft(spectrum, size)
    lags = np.arange(-reach, reach + 1)
    at = int(np.argmax(np.abs(product[lags])))
    delay = float(lags[at])
    if abs(delay) == reach:
        return None
    inner = slice(margin + reach, len(a) - margin - reach)
    curve, own = Curve(b), np.gradient(a)[inner]
    # Newton's steps to the peak of the cross-correlation. Its curvature is that of one slope with the other, in which
    # noise of either side has no part.
    for _ in range(20):
        rest, slope, shifted = _compared(a[inner], curve, inner, -delay)
        curvature = float(own @ slope)
        change = float(np.clip(-(rest @ slope) / curvature, -1.0, 1.0)) if curvature else 0.0
        delay += change
        if abs(delay) > reach:
            return None
        if abs(change) < 1e-4:
            break
    rest, slope, shifted = _compared(a[inner], curve, inner, -delay)
    correlation = float(np.corrcoef(a[inner], shifted)[0, 1])
    # One more step in each part by itself. The offset may wander (grade, mounting): each part has its own.
    parts = np.array_split(np.arange(len(shifted)), BLOCKS)
    values, weights, times, sign = [], [], [], np.sign(own @ slope)
    for part in parts:
        tangent = slope[part] - slope[part].mean()
        weight = float(sign * (own[part] @ tangent))
        if weight > 0.0:
            values.append(-float(sign * (tangent @ (rest[part] - rest[part].mean()))) / weight)
            weights.append(weight)
            times.append(float(part.mean()) * step)
    if not weights:
        return None
    value, share, time = np.array(values) * step, np.array(weights) / sum(weights), np.array(times)
    enough = 1.0 / float(np.sum(share**2))  # effective number of parts
    if enough < 1.5:
        return None
    spread = float(np.sum(share * value**2)) / max(enough - 1.0, 0.5)
    mean = float(np.sum(share * time))
    across = float(np.sum(share * (time - mean) ** 2))
    drift = float(np.sum(share * (time - mean) * value)) / across
    left_over = float(np.sum(share * (value - drift * (time - mean)) ** 2)) / max(enough - 2.0, 0.5)
    return Delay(delay * step, float(np.sqrt(spread)), drift, float(np.sqrt(left_over / across)), correlation)


def _compared(left: Array, curve: Curve, rows: slice, moved: float) -> tuple[Array, Array, Array]:
    """What the right side leaves of the left one, the slope of the right side, and itself, each without its mean."""
    right, slope = curve.at(rows, moved), curve.at(rows, moved, 1)
    right, slope, left = right - right.mean(), slope - slope.mean(), left - left.mean()
    gain = np.sign(left @ right) * left.std() / max(right.std(), 1e-300)
    return left - gain * right, slope, right


def pair_delays(grid: Grid) -> list[tuple[Relation, Delay]]:
    """The delays of all pairs of a log that move alike enough to tell."""
    found = []
    for relation in kinematic_relations(grid.channels):
        delay = estimate_delay(relation.left(grid), relation.right(grid), grid.step)
        if delay is not None and abs(delay.correlation) > 0.8:
            found.append((relation, delay))
    return found


def check_response(log: Log) -> list[Finding]:
    """How late the yaw rate is behind the steering: the response of the car and the delay of the channels together."""
    grid, found = make_grid(log), []
    for name in STEERING:
        if name in grid.channels and "yaw_rate" in grid.channels:
            delay = estimate_delay(grid.channels["yaw_rate"], grid.channels[name], grid.step)
            if delay is not None and abs(delay.correlation) > 0.7:
                text = f"the yaw rate follows {name} by {1e3 * delay.value:.3g} ms, with the response of the vehicle"
                found.append(Finding(log.name, "response", f"yaw_rate, {name}", "info", delay.value, "s", text))
    return found


def smooth(grid: Grid, name: str) -> Array:
    """A channel of a grid without its fast noise (n)."""
    return np.asarray(gaussian_filter1d(grid.channels[name], max(1.0, SMOOTHING / grid.step)))
