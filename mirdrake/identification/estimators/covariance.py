"""How sure an estimate is when residuals are correlated in time.

The estimate moves by the sum of the influences of all samples, ψ_t = A⁻¹ Jᵀ_t w_t r_t with A the information matrix.
Its covariance is that of the sum. White residuals give A⁻¹; residuals of real logs are not white, and A⁻¹ is too small
by a large factor. Here: the long-run covariance of the influences, each prewhitened by an autoregression of first order
(D. W. K. Andrews and J. C. Monahan, Econometrica 60, 1992) and weighed by Bartlett's kernel (W. K. Newey and K. D.
West, Econometrica 55, 1987); and beside it a block bootstrap, whose blocks are long against that correlation.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_MOST = 0.97
"""Largest autoregression of the prewhitening."""


def long_run(series: Array, groups: list[slice]) -> Array:
    """Covariance of the sum of a series (p, p).

    Args:
        series: (n, p).
        groups: rows that follow one another in time; between groups there is no correlation.
    """
    p = series.shape[1]
    series = series - series.mean(axis=0)  # priors pull against the data
    top = sum(np.sum(series[rows][1:] * series[rows][:-1], axis=0) for rows in groups)
    rho = np.clip(top / np.maximum(np.sum(series**2, axis=0), 1e-300), -_MOST, _MOST)
    colour = 1.0 / (1.0 - rho)
    total = np.zeros((p, p))
    for rows in groups:
        part = series[rows]
        white = part.copy()
        white[1:] -= rho * part[:-1]
        n = len(white)
        lags = min(int(np.ceil(4.0 * (n / 100.0) ** (2.0 / 9.0))) + int(0.01 * n), n - 1)
        one = white.T @ white
        for lag in range(1, lags + 1):
            cross = white[lag:].T @ white[:-lag]
            one += (1.0 - lag / (lags + 1.0)) * (cross + cross.T)
        total += one
    return np.asarray(colour[:, None] * total * colour[None, :])


def inflation(series: Array, groups: list[slice]) -> Array:
    """Variance of the sum over that of independent samples, by column (p)."""
    return np.asarray(
        np.diag(long_run(series, groups)) / np.maximum(np.sum((series - series.mean(axis=0)) ** 2, axis=0), 1e-300)
    )


def block_bootstrap(information: list[Array], scores: list[Array], prior: Array, count: int, seed: int = 0) -> Array:
    """Shifts of the estimate when blocks of the data are drawn with replacement (count, p).

    One Gauss-Newton step each: the model is not run again.

    Args:
        information: JᵀWJ by block (p, p).
        scores: JᵀWr by block (p).
        prior: information that is no data (p, p).
        count: draws.
        seed: of the draws.
    """
    random = np.random.default_rng(seed)
    blocks, right = np.array(information), np.array(scores)
    centre = right.mean(axis=0)
    found = np.empty((count, right.shape[1]))
    for k in range(count):
        drawn = random.integers(0, len(blocks), len(blocks))
        weights = np.bincount(drawn, minlength=len(blocks)).astype(float)
        inside = np.tensordot(weights, blocks, axes=1) + prior
        found[k] = -np.linalg.lstsq(inside, weights @ (right - centre), rcond=None)[0]
    return found
