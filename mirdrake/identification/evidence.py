"""Evidence for one model against a plainer one: the Bayesian information criterion with autocorrelated residuals.

Twice the logarithm of the Bayes factor is about ``n ln(RSS₀ / RSS₁) - k ln n`` for k further parameters (G. Schwarz,
Annals of Statistics 6, 1978; R. E. Kass and A. E. Raftery, Journal of the American Statistical Association 90, 1995).
Autocorrelated residuals count for n effective samples (M. S. Bartlett, Journal of the Royal Statistical Society B 8,
1946): a systematic error of the model is not evidence, however many samples contain it.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len

Array = NDArray[np.float64]

LEAST_SHARE = 0.2
"""Least share of the variance of the residual that an effect explains [1]: a smaller one may be any effect that the
relation lacks, as roll or the bank of the road, however certain its estimate is."""


def effective_samples(residuals: Array) -> float:
    """Return the number of independent samples that autocorrelated residuals count for."""
    size, left = len(residuals), residuals - residuals.mean()
    # Autocorrelation by the Wiener-Khinchin theorem; with zeros of at least its length it does not wrap around.
    length = next_fast_len(2 * size, real=True)
    correlation = np.fft.irfft(np.abs(np.fft.rfft(left, length)) ** 2, length)[:size]
    correlation = correlation / max(correlation[0], 1e-300)
    end = int(np.argmax(correlation <= 0.0)) or size  # it ends where it first vanishes
    return size / (1.0 + 2.0 * float(np.sum(correlation[1:end] ** 2)))


def likelihood_gain(without: Array, residuals: Array) -> tuple[float, float]:
    """Return twice the logarithm of the likelihood ratio of an effect, and the number of independent samples.

    Args:
        without: residuals without the effect (n).
        residuals: residuals with it (n).
    """
    effective = effective_samples(residuals)
    ratio = float(without @ without) / max(float(residuals @ residuals), 1e-300)
    return effective * float(np.log(max(ratio, 1e-300))), effective


def is_certain(gain: float, effective: float, odds: float) -> bool:
    """Return whether the residuals show an effect: its likelihood, and at least a part of their variance.

    Args:
        gain: twice the logarithm of the likelihood ratio.
        effective: number of independent samples.
        odds: prior odds against the effect [1].
    """
    share = 1.0 - float(np.exp(-gain / max(effective, 1e-300)))
    return share > LEAST_SHARE and gain > required_gain(effective, odds)


def required_gain(effective: float, odds: float) -> float:
    """Return what an effect of one parameter must gain.

    Args:
        effective: number of independent samples.
        odds: prior odds against the effect [1].
    """
    return float(np.log(max(effective, 1.0))) + 2.0 * float(np.log(odds))
