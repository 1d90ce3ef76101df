"""Uncertainty of an estimate with autocorrelated residuals.

To first order the estimate moves by A⁻¹ g, with the information matrix A = Σ Jₜᵀ Jₜ and g = Σ Jₜᵀ rₜ over all samples
of all outputs; J are derivatives of the residuals r over their noise. With white residuals of equal variance the
covariance of g is A, and that of the estimate A⁻¹. Residuals of real logs are not white, and A⁻¹ is too small by a
large factor.

The derivatives are known; only the autocorrelation of the residuals has to be estimated (E. A. Morelli and V. Klein,
Determining the accuracy of maximum likelihood parameter estimates with colored residuals, NASA CR-194893, 1994). Here
each output has an autoregression a(q) r = e by Burg's method, of the order with the least Akaike information criterion
(as W. J. den Haan and A. Levin, A practitioner's guide to robust covariance matrix estimation, Handbook of Statistics
15, 1997), so white residuals stay white. Then g = Σ bₜᵀ eₜ, where b follows from J by the same recursion backwards in
time. The innovations eₜ are white, so the covariance of g is Σ bₜᵀ eₜ eₜᵀ bₜ, whatever their variance from sample to
sample (H. White, Econometrica 48, 1980): noise that grows with the motion is covered, too.

A fit removes its own frequencies from the residuals, and a wrong model leaves residuals that seem to cancel. So the
covariance is kept at least at the value for white residuals, in every direction.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]

_MIN_SAMPLES = 8
"""Smallest number of consecutive samples per order of the autoregression."""


class Stretch(NamedTuple):
    """Consecutive samples.

    Attributes:
        slopes: derivatives of the residuals (n, outputs, p).
        residuals: residuals over their noise, times their weight in a robust loss (n, outputs).
        measured: where there is a value (n, outputs); elsewhere slopes and residuals are zero.
    """

    slopes: Array
    residuals: Array
    measured: NDArray[np.bool_]


def noise_models(stretches: Sequence[Stretch]) -> list[Array]:
    """Return the autoregression of the residuals of each output."""
    outputs = stretches[0].residuals.shape[1]
    return [
        autoregression([stretch.residuals[stretch.measured[:, k], k] for stretch in stretches]) for k in range(outputs)
    ]


def score_covariance(stretches: Sequence[Stretch], models: Sequence[Array] | None = None) -> tuple[Array, Array]:
    """Return the covariance of Σ Jᵀ r for autocorrelated and for white residuals (p, p) each.

    Different stretches are independent. Samples on both sides of a missing value count as neighbours.

    Args:
        stretches: stretches of consecutive samples.
        models: autoregression of each output; None estimates it from these stretches.
    """
    models = noise_models(stretches) if models is None else models
    coloured, white = [_Sums(stretches[0].slopes.shape[2]) for _ in range(2)]
    for slopes, residuals, measured in stretches:
        sums = np.zeros((len(slopes), slopes.shape[2]))
        for k, model in enumerate(models):
            rows = measured[:, k]
            if not rows.any():
                continue
            # Whitening residuals forwards and filtering slopes backwards in time leaves their inner product as it is.
            fresh = lfilter(model, [1.0], residuals[rows, k])
            ahead = lfilter([1.0], model, slopes[rows, k][::-1], axis=0)[::-1]
            sums[rows] += ahead * fresh[:, None]
        coloured.add(sums)
        white.add(np.einsum("nop,no->np", slopes, residuals))
    return _at_least(coloured.covariance, white.covariance), white.covariance


def autoregression(series: Sequence[Array]) -> Array:
    """Return the coefficients 1, a1, a2, … of the autoregression shared by several stretches of a noise.

    Burg's method; order by the Akaike information criterion, at most 10 log10 n.
    """
    ahead = [part for part in series if len(part)]
    count = sum(len(part) for part in ahead)
    model = best = np.ones(1)
    if count == 0:
        return model
    power = sum(float(part @ part) for part in ahead) / count
    # Enough samples for each coefficient, or the model would follow the noise of the log.
    max_order = min(int(10.0 * np.log10(count)), max(len(part) for part in ahead) // _MIN_SAMPLES)
    behind, best_criterion = ahead, count * np.log(max(power, 1e-300))
    for order in range(1, max_order + 1):
        # Forward and backward errors of all stretches are pooled; no product crosses the end of a stretch.
        ahead, behind = [part[1:] for part in ahead], [part[:-1] for part in behind]
        top = sum(float(f @ b) for f, b in zip(ahead, behind, strict=True))
        size = sum(float(f @ f + b @ b) for f, b in zip(ahead, behind, strict=True))
        # Nothing is left to predict, as for a deterministic series.
        if size <= 1e-12 * power * count:
            break
        turn = -2.0 * top / size
        # Levinson's recursion; the reflection coefficient is at most 1 in magnitude, so that the model is stable.
        model = np.append(model, 0.0) + turn * np.append(model, 0.0)[::-1]
        ahead, behind = (
            [f + turn * b for f, b in zip(ahead, behind, strict=True)],
            [b + turn * f for f, b in zip(ahead, behind, strict=True)],
        )
        power *= 1.0 - turn * turn
        cost = count * np.log(max(power, 1e-300)) + 2.0 * order
        if cost < best_criterion:
            best, best_criterion = model, cost
    return best


class _Sums:
    """Sum of squares of rows about their mean, which is not zero where priors pull against the data."""

    def __init__(self, size: int) -> None:
        self._count, self._sum, self._square = 0, np.zeros(size), np.zeros((size, size))

    def add(self, rows: Array) -> None:
        self._count += len(rows)
        self._sum += rows.sum(axis=0)
        self._square += rows.T @ rows

    @property
    def covariance(self) -> Array:
        return np.asarray(self._square - np.outer(self._sum, self._sum) / max(self._count, 1))


def _at_least(noise: Array, floor: Array) -> Array:
    """Return a covariance raised to at least another one in every direction."""
    # Scaled by the least variances, so that the eigenvectors do not depend on units.
    size = np.sqrt(np.maximum(np.diag(floor), 1e-300))
    values, vectors = np.linalg.eigh((noise - floor) / np.outer(size, size))
    return np.asarray(floor + (vectors * np.maximum(values, 0.0)) @ vectors.T * np.outer(size, size))
