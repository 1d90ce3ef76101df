"""Steering angles over time for open-loop drivers, as pure functions.

Angles are bicycle angles [rad], positive to the left; all are zero before ``start``.
"""

import math
import random
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mirdrake.manoeuvres.base import Array
from mirdrake.manoeuvres.by_kind import make_by_kind

Profile = Callable[[float], float]

EASE = 0.5
"""Time of the fade-in and fade-out of the amplitude of random steering [s]."""


def step(*, amplitude: float, start: float = 0.0, rise: float = 0.0) -> Profile:
    """Return a step that is reached linearly in `rise` [s]."""
    return lambda t: amplitude * min(max((t - start) / rise if rise > 0.0 else float(t >= start), 0.0), 1.0)


def ramp(*, rate: float, limit: float, start: float = 0.0) -> Profile:
    """Return a ramp with a `rate` [rad/s], of the sign of the turn, up to an angle `limit` [rad] that is then held."""

    def angle(t: float) -> float:
        return math.copysign(min(abs(rate) * max(t - start, 0.0), abs(limit)), rate)

    return angle


def tabulate(data: Mapping[str, object], times: NDArray[np.floating[Any]]) -> Array:
    """Return the angles of a profile at times [s]; every bit is that of :func:`make_profile`.

    Steps, of which sweeps have thousands, are computed for all times at once; sines of an array could differ in their
    last bit.
    """
    profile = make_profile(data)  # checks the data
    if data["kind"] == "step":
        settings: dict[str, Any] = {key: value for key, value in data.items() if key != "kind"}
        return _step_over(np.asarray(times, dtype=float), **settings)
    return np.array([profile(time) for time in times.tolist()])


def _step_over(times: Array, *, amplitude: float, start: float = 0.0, rise: float = 0.0) -> Array:
    """Return :func:`step` at times [s]."""
    parts = (times - start) / rise if rise > 0.0 else (times >= start).astype(float)
    angles: Array = amplitude * np.minimum(np.maximum(parts, 0.0), 1.0)
    return angles


def sine(*, amplitude: float, frequency: float, start: float = 0.0, periods: float = 1.0) -> Profile:
    """Return a number of periods of a sine with a frequency [Hz]."""

    def angle(t: float) -> float:
        since = t - start
        return amplitude * math.sin(2.0 * math.pi * frequency * since) if 0.0 <= since < periods / frequency else 0.0

    return angle


def sine_with_dwell(*, amplitude: float, frequency: float, dwell: float, start: float = 0.0) -> Profile:
    """Return one period of a sine that dwells [s] at its second peak."""
    peak, period = 0.75 / frequency, 1.0 / frequency

    def angle(t: float) -> float:
        since = t - start
        if since < 0.0 or since >= period + dwell:
            return 0.0
        # Time stands still at the second peak for the dwell, then continues.
        phase = since if since < peak else max(peak, since - dwell)
        return amplitude * math.sin(2.0 * math.pi * frequency * phase)

    return angle


def sweep(*, amplitude: float, first: float, last: float, length: float, start: float = 0.0) -> Profile:
    """Return a sine whose frequency rises linearly from `first` to `last` [Hz] within `length` [s]."""

    def angle(t: float) -> float:
        since = t - start
        if not 0.0 <= since < length:
            return 0.0
        # The phase is the integral of the frequency, hence the half.
        return amplitude * math.sin(2.0 * math.pi * (first + 0.5 * (last - first) * since / length) * since)

    return angle


def random_steer(
    *, amplitude: float, first: float, last: float, length: float, start: float = 0.0, seed: int = 0, lines: int = 60
) -> Profile:
    """Return a sum of sines from `first` to `last` [Hz] with random phases and an RMS of amplitude / √2.

    It begins and ends at zero, within :data:`EASE`, as a steering cannot jump.
    """
    # A generator of its own, so that the seed fixes the angle on all machines and in all processes.
    rng = random.Random(seed)
    waves = [
        # One random frequency in each of `lines` equal bands: an even spectrum without a common period.
        (2.0 * math.pi * (first + (last - first) * (number + rng.random()) / lines), rng.uniform(0.0, math.tau))
        for number in range(lines)
    ]
    # Sines with independent phases: the RMS of the sum is height √(lines / 2).
    height = amplitude / math.sqrt(lines)

    def angle(t: float) -> float:
        since = t - start
        if not 0.0 <= since < length:
            return 0.0
        share = min(1.0, since / EASE, (length - since) / EASE)
        return height * share * math.fsum(math.sin(rate * since + phase) for rate, phase in waves)

    return angle


PROFILES: dict[str, Callable[..., Profile]] = {
    "step": step,
    "ramp": ramp,
    "sine": sine,
    "sine_with_dwell": sine_with_dwell,
    "sweep": sweep,
    "random": random_steer,
}


def make_profile(data: Mapping[str, object]) -> Profile:
    """Return a profile from ``{kind: step, amplitude: 0.02, ...}``, see :func:`make_by_kind`."""
    return make_by_kind(data, PROFILES, what="profile")
