"""Noise of recorded inputs: its size and the expected input without it.

An output-error fit takes its inputs as exact. Noise of an input moves the estimates whatever the length of the log: a
lag with a negative dead time, or a relaxation length, filters the noise and so reduces the residuals. Regression
calibration replaces a recorded input w = u + n by its expectation E[u | w]; what is left of the noise is then
uncorrelated with the input of the model, and the estimates are consistent (R. J. Carroll, D. Ruppert, L. A. Stefanski
and C. M. Crainiceanu, Measurement Error in Nonlinear Models, 2nd ed., 2006, chapter 4).

For a stationary input in noise of the power N that expectation is the filter of N. Wiener, with the gain S / (S + N) at
a frequency. Here S is the mean over a band of frequencies of the discrete cosine transform, whose even continuation has
no jump at the ends, less N.

The noise is an autoregression of first order, with the standard deviation σ and the correlation ρ from sample to
sample. Both follow from fourth differences, in which a slow input vanishes. Over k samples their variance is
σ² (70 - 112 q + 56 q² - 16 q³ + 2 q⁴) with q = ρᵏ; it is 70 σ² for white noise and grows at most k-fold for
autocorrelated noise. What grows faster is motion. Motion only adds to it, so the least ρ of several k counts.

Their median is robust against the steps of a command, and zero for a computed one, which stays as it is. Fast steering
is not noise: the quietest eighth of the log counts, and no more than the power of the highest eighth of the
frequencies.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct

Array = NDArray[np.float64]

_NORMAL_MEDIAN = 0.6745
"""Median of the magnitude of a standard normal variable."""

_PARTS = 8
"""Parts of the time and of the frequencies in which the noise is looked for."""

_LEAST_PART, _SELECTION = 32, 2.1
"""Least number of samples of a part; relative bias of the least of eight medians times the root of that number [1], by
simulation of white noise: 2.03 to 2.20 for parts of 60 to 1000 samples."""

_DISTANCES = (2, 4, 8)
"""Numbers of samples of the differences that show the autocorrelation of noise, beside neighbouring ones."""

_CORRELATIONS = np.linspace(0.0, 0.95, 96)
"""Correlations from sample to sample that are compared [1]; noise with a larger one is slow motion."""

_HELD = 0.3
"""Share of repeated samples above which values are held or coarser than their noise [1]."""

_LEAST, _GROWTH = 8, 1.15
"""Least number of frequencies in a band; ratio of the ends of a band [1]."""


class Noise(NamedTuple):
    """Noise of an input.

    Attributes:
        size: standard deviation [unit of the input].
        correlation: that from sample to sample [1].
    """

    size: float
    correlation: float = 0.0

    def power(self, count: int) -> Array:
        """Return the variance of each coefficient of an orthonormal discrete cosine transform (count)."""
        correlation, angle = self.correlation, np.pi * np.arange(count) / count
        spread = 1.0 - 2.0 * correlation * np.cos(angle) + correlation**2
        return np.asarray(self.size**2 * (1.0 - correlation**2) / spread)


def estimate_noise(values: Array) -> Noise:
    """Return the noise of an evenly sampled signal (n)."""
    # Differences of values that are held over several samples are not those of noise.
    if len(values) < _PARTS * _LEAST_PART or np.mean(np.diff(values) == 0.0) > _HELD:
        return Noise(0.0)
    least = _quietest(values, 1)
    if least == 0.0:
        return Noise(0.0)
    found = []
    for distance in _DISTANCES:
        if len(values) < _PARTS * _LEAST_PART * distance:
            break
        growth = (_quietest(values, distance) / least) ** 2
        if growth < distance:
            expected = _fourth_differences(_CORRELATIONS**distance) / _fourth_differences(_CORRELATIONS)
            found.append(float(np.interp(growth, expected, _CORRELATIONS)))
    correlation = min(found, default=0.0)
    # Standard deviation of white noise with the same differences.
    white = least / (_NORMAL_MEDIAN * 70.0**0.5 * (1.0 - _SELECTION * (_PARTS / len(values)) ** 0.5))
    fastest: Array = dct(values, norm="ortho")[-(len(values) // _PARTS) :]
    white = min(white, float(np.sqrt(np.mean(fastest**2))))
    return Noise(white * float(70.0 / _fourth_differences(correlation)) ** 0.5, correlation)


def _quietest(values: Array, distance: int) -> float:
    """Return the least median of the fourth differences over a number of samples, of all parts of a signal (n)."""
    parts = np.array_split(values, _PARTS)
    weights = (1.0, -4.0, 6.0, -4.0, 1.0)
    sums = [
        sum(w * part[k * distance : len(part) - (4 - k) * distance] for k, w in enumerate(weights)) for part in parts
    ]
    return min(float(np.median(np.abs(part))) for part in sums)


def _fourth_differences(correlation: Array | float) -> Array:
    """Return the variance of fourth differences of autocorrelated noise, over that of the noise."""
    return np.asarray(np.polyval([2.0, -16.0, 56.0, -112.0, 70.0], correlation))


def without_noise(values: Array, noise: Noise) -> Array:
    """Return the expectation of an evenly sampled signal in noise (n).

    Args:
        values: samples (n).
        noise: its noise; a size of 0 returns the samples.
    """
    if noise.size <= 0.0:
        return values
    # An orthonormal transform: white noise has the variance σ² in each of its coefficients.
    waves, power = np.asarray(dct(values, norm="ortho")), noise.power(len(values))
    # The mean and the slowest waves are kept: they have no band of their own kind around them.
    first = _LEAST
    while first < len(waves):
        last = max(first + _LEAST, int(_GROWTH * first))
        if last + _LEAST > len(waves):
            last = len(waves)
        band = slice(first, last)
        waves[band] *= np.maximum(1.0 - power[band] / max(float(np.mean(waves[band] ** 2)), 1e-300), 0.0)
        first = last
    return np.asarray(idct(waves, norm="ortho"))
