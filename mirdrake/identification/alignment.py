"""Delays between channels to a fraction of a sample, from pairs that kinematics relates."""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from mirdrake.identification.data import Array, Log
from mirdrake.identification.evidence import likelihood_gain, required_gain
from mirdrake.identification.findings import Finding, Severity, statement
from mirdrake.identification.relations import Grid, Relation, kinematic_relations, make_grid
from mirdrake.identification.splines import Spline

MAX_DELAY = 0.6
"""Largest delay [s]."""

SMOOTHING = 0.05
"""Standard deviation of the Gaussian that smooths both sides [s]; it causes no delay."""

LEVELS = 4
"""Number of smoothings, each twice the one before; the most certain result counts."""

STEERING = ("road_wheel_angle", "steering_wheel_angle", "steering_command")

DELAY_ODDS = 100.0
"""Prior odds against a delay of a channel [1]."""

MIN_COMMON = 0.3
"""Least correlation of the rates of both signals, after alignment, for evidence of a delay [1]."""

CERTAIN = 4.0
"""Standard deviations, by its scatter over the log, that a delay must exceed [1]."""

BLOCKS = 10
"""Parts of a log whose separate delays give uncertainty and drift."""


class Delay(NamedTuple):
    """Delay of one signal against another.

    Attributes:
        value: positive if the first signal lags [s].
        sigma: its standard deviation, from its scatter over the log [s].
        drift: change of the delay with time [s/s].
        drift_sigma: its standard deviation [s/s].
        correlation: correlation of both after alignment.
        gain: twice the logarithm of the likelihood ratio of this delay to none.
        effective: number of independent samples.
    """

    value: float
    sigma: float
    drift: float
    drift_sigma: float
    correlation: float
    gain: float = 0.0
    effective: float = 1.0

    @property
    def is_likely(self) -> bool:
        """Whether the fast part of the signals shows the delay, by the Bayesian information criterion."""
        # Slow signals with a common trend fit many delays alike: the parts of the log must agree.
        agrees = abs(self.value) > CERTAIN * self.sigma
        return agrees and self.gain > required_gain(self.effective, DELAY_ODDS)


def estimate_delay(left: Array, right: Array, step: float) -> Delay | None:
    """Return the delay of the first signal against the second, for any scale and offset; None without variation.

    It is the maximum of the cross-correlation, which is unbiased if the noise of both sides is independent.

    Args:
        left: samples at a constant step (n).
        right: samples at the same times (n).
        step: sample time [s].
    """
    if np.ptp(left) == 0.0 or np.ptp(right) == 0.0:
        return None
    best, width, passed, sides = None, SMOOTHING, 0.0, (left - left.mean(), right - right.mean())
    for _ in range(LEVELS):
        # Variances of successive Gaussians add, so each level only smooths by what the one before lacks.
        rows = np.sqrt(max(width**2 - passed**2, 0.0)) / step
        if rows >= 1.0 or passed == 0.0:
            rows = max(rows, 1.0)
            sides = (
                gaussian_filter1d(sides[0], rows, mode="nearest"),
                gaussian_filter1d(sides[1], rows, mode="nearest"),
            )
            passed = np.hypot(passed, rows * step)
            thin = max(1, int(passed / (2.0 * step)))  # smooth signals need few samples
            sides, step = (sides[0][::thin], sides[1][::thin]), step * thin
            delay = _delay_at(*sides, step, passed)
            # Less smoothing is preferred: a wider one must be clearly more certain, as it removes the fast part.
            if delay is not None and (best is None or delay.sigma < 0.7 * best.sigma):
                best = delay
        width *= 2.0
    return best


def _delay_at(a: Array, b: Array, step: float, width: float) -> Delay | None:
    """Return the delay between two smooth signals; `width` is that of their smoothing [s]."""
    # Rows next to the ends are left out: the smoothing there has one side only.
    margin = int(np.ceil(3 * width / step))
    reach = min(int(MAX_DELAY / step) + 1, len(a) // 4)
    if len(a) < 4 * margin + 40 or np.ptp(a) == 0.0 or np.ptp(b) == 0.0:
        return None
    # Padding with zeros to twice the length, as the correlation by Fourier transforms is circular.
    size = 1 << int(2 * len(a) - 1).bit_length()
    # Differences emphasise the fast part of the signals, which contains the timing.
    spectrum = np.fft.rfft(np.gradient(a), size) * np.conj(np.fft.rfft(np.gradient(b), size))
    product = np.fft.irfft(spectrum, size)
    lags = np.arange(-reach, reach + 1)
    # The magnitude, as the scale between the signals may be negative. A maximum at the edge of the range is none.
    peak = int(np.argmax(np.abs(product[lags])))
    delay = float(lags[peak])
    if abs(delay) == reach:
        return None
    inner = slice(margin + reach, len(a) - margin - reach)
    curve, own = Spline(b), np.gradient(a)[inner]
    # Newton's steps to the maximum of the cross-correlation. Its curvature is the product of both slopes, which noise
    # of one side alone does not bias.
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
    plain = _compared(a[inner], curve, inner, 0.0)[0]
    # Without a common fast part, as on a circle, noise or a trend decides.
    common = abs(float(np.corrcoef(own, slope)[0, 1]))
    gain = likelihood_gain(plain, rest) if common > MIN_COMMON else (0.0, 1.0)
    # One more step in each part by itself, with an offset of its own, as offsets wander (grade, mounting).
    parts = np.array_split(np.arange(len(shifted)), BLOCKS)
    values, weights, times, sign = [], [], [], np.sign(own @ slope)
    for part in parts:
        tangent = slope[part] - slope[part].mean()
        weight = float(sign * (own[part] @ tangent))
        if weight > 0.0:
            values.append(-float(sign * (tangent @ (rest[part] - rest[part].mean()))) / weight)
            weights.append(weight)
            times.append(float(part.mean()) * step)
    # Parts are weighted by their motion; standstill carries no information about a delay.
    if not weights:
        return None
    value, share, time = np.array(values) * step, np.array(weights) / sum(weights), np.array(times)
    # One part with nearly all of the motion has no scatter, so its uncertainty is unknown.
    enough = 1.0 / float(np.sum(share**2))  # effective number of parts
    if enough < 1.5:
        return None
    spread = float(np.sum(share * value**2)) / max(enough - 1.0, 0.5)
    # Weighted regression of the delay over time: its slope is the difference between the rates of two clocks.
    mean = float(np.sum(share * time))
    across = float(np.sum(share * (time - mean) ** 2))
    drift = float(np.sum(share * (time - mean) * value)) / across
    left_over = float(np.sum(share * (value - drift * (time - mean)) ** 2)) / max(enough - 2.0, 0.5)
    return Delay(delay * step, float(np.sqrt(spread)), drift, float(np.sqrt(left_over / across)), correlation, *gain)


def _compared(left: Array, curve: Spline, rows: slice, moved: float) -> tuple[Array, Array, Array]:
    """Return the residual of the left side, the slope of the right side, and the right side, each without its mean."""
    right, slope = curve.at(rows, moved), curve.at(rows, moved, 1)
    right, slope, left = right - right.mean(), slope - slope.mean(), left - left.mean()
    # Ratio of standard deviations (reduced major axis): with noise on both sides, the slope of a regression is too
    # small.
    gain = np.sign(left @ right) * left.std() / max(right.std(), 1e-300)
    return left - gain * right, slope, right


def pair_delays(grid: Grid) -> list[tuple[Relation, Delay]]:
    """Return the delays of all pairs of a log that are sufficiently correlated."""
    pairs = []
    for relation in kinematic_relations(grid.channels):
        delay = estimate_delay(relation.left(grid), relation.right(grid), grid.step)
        if delay is not None and abs(delay.correlation) > 0.8:
            pairs.append((relation, delay))
    return pairs


def steering_response(grid: Grid) -> tuple[str, Delay] | None:
    """Return the steering channel and the delay of the yaw rate behind it; None if they are not correlated."""
    for name in STEERING:
        if name in grid.channels and "yaw_rate" in grid.channels:
            delay = estimate_delay(grid.channels["yaw_rate"], grid.channels[name], grid.step)
            if delay is not None and abs(delay.correlation) > 0.7:
                return name, delay
    return None


def slack(delay: Delay, step: float) -> float:
    """Return how early a response may seem by its uncertainty [s]."""
    return max(step, CERTAIN * delay.sigma)


def check_response(log: Log) -> list[Finding]:
    """Report the delay of the yaw rate against the steering: response of the car plus delays of the channels."""
    grid = make_grid(log)
    found = steering_response(grid)
    if found is None:
        return []
    name, delay = found
    # A response before its cause shows that the clocks of the channels differ.
    early = delay.is_likely and delay.value < -slack(delay, grid.step)
    text = statement("response", channel=name, delay=delay.value, early=early)
    severity: Severity = "warning" if early else "info"
    return [Finding(log.name, "response", f"yaw_rate, {name}", severity, delay.value, "s", text)]


def smooth(grid: Grid, name: str) -> Array:
    """Return a channel of a grid without its fast noise (n)."""
    return np.asarray(gaussian_filter1d(grid.channels[name], max(1.0, SMOOTHING / grid.step)))
