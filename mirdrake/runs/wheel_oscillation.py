"""Wheels whose slip oscillates while the speed of their vehicle is smooth."""

from collections.abc import Mapping

import numpy as np

from mirdrake.runs.telemetry import Array

WINDOW = 1.0
"""Time over which speeds are averaged [s]."""

SHARE = 0.25
"""A wheel oscillates if the RMS of its spin rate about the average is this share of the average [1]."""

SLOW = 0.1
"""Averages below this share of the largest one of the run count as that [1]."""

SMOOTH = 0.2
"""The speed of the vehicle is smooth if its share is at most this part of that of the wheel [1]."""

LOWEST = 2.0
"""Lowest frequency of an oscillation [Hz]."""

LASTING = 3.0
"""Shortest time of an oscillation that is reported [s]."""


def find_wheel_oscillation(times: Array, wheels: Mapping[str, Array], vx: Array) -> dict[str, float | str] | None:
    """Return the longest oscillation of the spin rate of a wheel while the speed of the vehicle is smooth.

    Args:
        times: evenly spaced [s] (n).
        wheels: spin rates by name of the wheel [rad/s] (n each).
        vx: longitudinal velocity of the vehicle [m/s] (n).

    Returns:
        ``wheel``, ``from_s``, ``duration_s``, ``frequency_hz``, ``amplitude_radps`` (of a sine of the same RMS) and
        ``speed_radps`` (mean spin rate); None if no wheel oscillates for :data:`LASTING`.
    """
    step = float(times[1] - times[0]) if len(times) > 1 else 0.0
    count = round(WINDOW / step) | 1 if step > 0.0 else 0
    # The signals of a run that diverged are not finite.
    if (
        count < 5
        or len(times) < round(LASTING / step)
        or not all(np.isfinite(row).all() for row in (vx, *wheels.values()))
    ):
        return None
    body = _share(vx, count)
    longest: dict[str, float | str] | None = None
    for wheel, spin in wheels.items():
        mean, fast = _mean(spin, count), spin - _mean(spin, count)
        share = _share(spin, count)
        # Two changes of sign per period.
        changes = _mean((np.diff(np.signbit(fast), prepend=False) != 0).astype(float), count) / step
        oscillates = (share > SHARE) & (body < SMOOTH * share) & (changes > 2.0 * LOWEST)
        edges = np.flatnonzero(np.diff(oscillates.astype(int), prepend=0, append=0)).reshape(-1, 2)
        for first, end in edges:
            duration = float(times[end - 1] - times[first])
            if duration < LASTING or (longest is not None and duration <= float(longest["duration_s"])):
                continue
            part = slice(first, end)
            longest = {
                "wheel": wheel,
                "from_s": round(float(times[first]), 3),
                "duration_s": round(duration, 3),
                "frequency_hz": round(0.5 * float(np.mean(changes[part])), 2),
                "amplitude_radps": round(float(np.sqrt(2.0 * np.mean(fast[part] ** 2))), 3),
                "speed_radps": round(float(np.mean(mean[part])), 3),
            }
    return longest


def _mean(values: Array, count: int) -> Array:
    """Return the moving average of an odd number of samples, of fewer at the ends."""
    sums = np.concatenate([[0.0], np.cumsum(values)])
    places, half = np.arange(len(values)), count // 2
    first, end = np.maximum(places - half, 0), np.minimum(places + half + 1, len(values))
    return np.asarray((sums[end] - sums[first]) / (end - first), dtype=float)


def _share(values: Array, count: int) -> Array:
    """Return the moving RMS about the moving average over that average [1]."""
    mean = _mean(values, count)
    rms = np.sqrt(np.maximum(_mean((values - mean) ** 2, count), 0.0))
    size = np.abs(mean)
    return np.asarray(rms / np.maximum(size, max(SLOW * float(size.max()), 1e-9)), dtype=float)
