"""Validation figures: fit of a channel, and tests of the residuals."""

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve
from scipy.stats import chi2

Array = NDArray[np.float64]

_LAGS = 20


def nrmse(measured: Array, model: Array) -> float:
    """Return the fit 100 (1 - |y - model| / |y - mean y|) [%]; NaN without values or without motion."""
    good = np.isfinite(measured) & np.isfinite(model)
    if not good.any():
        return float("nan")
    y, off = measured[good], (measured - model)[good]
    spread = float(np.linalg.norm(y - y.mean()))
    return float("nan") if spread == 0.0 else 100.0 * (1.0 - float(np.linalg.norm(off)) / spread)


def noise_limit_nrmse(measured: Array) -> float:
    """Return the largest fit that the noise of the sensor allows [%]; NaN as in nrmse.

    The variance of white noise is the mean square of the third differences over 20, to which smooth motion contributes
    little (J. von Neumann and others, The mean square successive difference, Annals of Mathematical Statistics 12,
    1941, for first differences). Filtered noise is larger than this estimate.
    """
    y = measured[np.isfinite(measured)]
    if len(y) < 8 or np.ptp(y) == 0.0:
        return float("nan")
    # 20 = 1 + 9 + 9 + 1, the sum of the squared weights of a third difference.
    away = np.abs(np.diff(y, 3))
    away = np.minimum(away, 6.0 * float(np.median(away)))  # corners of the motion are not noise
    noise = float(np.sqrt(np.mean(away**2) / 20.0))
    return 100.0 * max(1.0 - noise / float(np.std(y)), 0.0)


def whiteness(residual: Array, lags: int = _LAGS) -> float:
    """Return the p-value of the hypothesis that residuals are white (Ljung-Box).

    G. M. Ljung and G. E. P. Box, Biometrika 65, 1978: Q = n (n + 2) Σ ρ_k² / (n - k) is χ² with as many degrees of
    freedom as lags.
    """
    series = _clean(residual)
    n = len(series)
    if n <= 3 * lags:
        return float("nan")
    rho = _correlation(series, series, lags)[1:] / max(float(series @ series), 1e-300)
    q = n * (n + 2.0) * float(np.sum(rho**2 / (n - np.arange(1, lags + 1))))
    return float(chi2.sf(q, lags))


def input_correlation(residual: Array, inputs: list[Array], lags: int = _LAGS) -> float:
    """Return the p-value of the hypothesis that residuals are uncorrelated with past inputs; the least over the inputs.

    The variance of a cross-correlation of two coloured series is Σ ρ_e(k) ρ_u(k) / n (M. S. Bartlett); the largest
    square over the lags is compared with it, with Bonferroni's factor for lags and inputs.
    """
    series = _clean(residual)
    n, probability = len(series), 1.0
    if n <= 3 * lags or not inputs:
        return float("nan")
    # Autocorrelations at long lags are mostly noise: Bartlett's taper lets them fade.
    many = min(n - 1, max(lags, n // 10))
    own = _correlation(series, series, many) / max(float(series @ series), 1e-300)
    taper = 1.0 - np.arange(many + 1) / (many + 1.0)
    for values in inputs:
        other = _clean(values)[:n]
        power = float(other @ other)
        if power == 0.0:
            continue
        theirs = _correlation(other, other, many) / power
        # At least that of white series, below which the truncated sum may fall by chance.
        variance = max(1.0 + 2.0 * float(np.sum((taper * own * theirs)[1:])), 1.0) / n
        cross = _correlation(series, other, lags) / np.sqrt(max(float(series @ series), 1e-300) * power)
        worst = float(np.max(cross**2) / variance)
        probability = min(probability, float(chi2.sf(worst, 1)) * (lags + 1) * len(inputs))
    return min(probability, 1.0)


def _clean(values: Array) -> Array:
    good = np.isfinite(values)
    return np.where(good, values - (values[good].mean() if good.any() else 0.0), 0.0)


def _correlation(first: Array, other: Array, lags: int) -> Array:
    """Return the sums of one[t] other[t - k] for k from 0 to lags."""
    n = len(first)
    # By Fourier transforms: a direct sum over all lags would take n² operations.
    whole = fftconvolve(first, other[::-1])
    return np.asarray(whole[n - 1 : n + lags])
