"""Least squares over a problem, alternating with the noise weights, and the covariance of the result."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from mirdrake.core.errors import RunError
from mirdrake.identification.estimators.bootstrap import block_bootstrap
from mirdrake.identification.estimators.covariance import Stretch, score_covariance
from mirdrake.identification.estimators.options import EstimatorOptions
from mirdrake.identification.estimators.problem import Problem
from mirdrake.identification.models.base import Array

_ROBUST = {"huber": 2.5, "soft_l1": 2.5, "linear": 1.0}


@dataclass(frozen=True)
class Solution:
    """Solved problem with its uncertainty.

    Attributes:
        z: unknowns.
        problem: problem with the estimated noise.
        cost: half the sum of the losses.
        covariance: covariance of the scaled free parameters (p, p), allowing for autocorrelated residuals.
        white: the same for white residuals.
        inflation: ratio of variances by parameter (p).
        information: Fisher information of the free parameters, the other unknowns eliminated (p, p).
        bound: "low", "high" or None, by parameter.
        draws: shifts of the scaled parameters by the block bootstrap (count, p), or None.
        message: message of the optimiser.
    """

    z: Array
    problem: Problem
    cost: float
    covariance: Array
    white: Array
    inflation: Array
    information: Array
    bound: tuple[str | None, ...]
    draws: Array | None
    message: str


class Minimum(NamedTuple):
    """Minimum of the cost.

    Attributes:
        z: unknowns.
        problem: problem with the estimated noise.
        cost: half the sum of the losses.
        message: message of the optimiser.
    """

    z: Array
    problem: Problem
    cost: float
    message: str

    @property
    def values(self) -> dict[str, float]:
        """Values of all parameters."""
        return self.problem.values(self.z)


def minimise(
    problem: Problem, options: EstimatorOptions, z: Array | None = None, *, passes: int = 1, close: float | None = None
) -> Minimum:
    """Minimise the cost.

    Args:
        problem: problem with a first guess of the noise.
        options: options of the estimator.
        z: initial unknowns; None starts from the guesses with a more tolerant loss and a coarse first pass.
        passes: largest number of passes that update the noise; 1 keeps it.
        close: relative change of the cost at which to stop; None for that of the model.

    Raises:
        RunError: the model diverges from the first guess.
    """
    begun = z is not None
    z = np.zeros(problem.size) if z is None else z.copy()
    low, high = problem.bounds()
    result, tolerance = None, problem.model.tolerance
    # Derivatives of a simulated plant are rough, so that a fine tolerance would never be met.
    fine, coarse = (1e-6, 1e-5) if tolerance < 1e-6 else (1e-4, 1e-2)
    for turn in range(passes):
        # Far from the minimum nearly all residuals are outliers: a smooth loss and a coarse tolerance find the
        # neighbourhood.
        near = turn > 0 or passes == 1 or begun
        z = _inside(z, low, high)
        first = problem.residuals(z)
        if not np.isfinite(first).all():
            raise RunError(
                f"model {problem.model.kind}: diverges from the guess; "
                "give guesses or bounds that are nearer to the vehicle"
            )
        result = least_squares(
            problem.residuals, z, jac=problem.jacobian, bounds=(low, high), method="trf", x_scale=1.0,
            loss=robust(options.loss if near else "soft_l1", problem.measured), f_scale=1.0,
            max_nfev=options.iterations, xtol=tolerance, gtol=1e-8,
            ftol=close or (fine if near else coarse),
        )  # fmt: skip
        z = result.x
        if passes == 1:
            break
        # The noise weights follow from the residuals, until they settle.
        before = problem.sigmas
        problem = replace(problem, sigmas={name: max(s, 1e-9) for name, s in problem.spread(z).items()})
        if near and all(abs(problem.sigmas[name] / before[name] - 1.0) < 0.02 for name in before):
            break
    assert result is not None
    return Minimum(z, problem, float(result.cost), str(result.message))


def robust(loss: str, measured: int) -> Callable[[Array], Array]:
    """Return a loss of squared residuals with two derivatives (3, n): robust for measurements, quadratic for priors.

    Args:
        loss: "huber", "soft_l1" or "linear".
        measured: number of residuals of measurements, which come first.
    """
    width = _ROBUST[loss] ** 2

    def rho(squares: Array) -> Array:
        loss_values = np.stack((squares, np.ones_like(squares), np.zeros_like(squares)))
        if loss == "linear":
            return loss_values
        # The three rows are value and first two derivatives by the squared residual, as least_squares requires.
        z = squares[:measured] / width
        if loss == "huber":
            far = z > 1.0
            root = np.sqrt(np.where(far, z, 1.0))
            loss_values[0, :measured] = width * np.where(far, 2.0 * root - 1.0, z)
            loss_values[1, :measured] = np.where(far, 1.0 / root, 1.0)
            loss_values[2, :measured] = np.where(far, -0.5 / root**3, 0.0) / width
        else:
            root = np.sqrt(1.0 + z)
            loss_values[0, :measured] = 2.0 * width * (root - 1.0)
            loss_values[1, :measured] = 1.0 / root
            loss_values[2, :measured] = -0.5 / root**3 / width
        return loss_values

    return rho


def _inside(z: Array, low: Array, high: Array) -> Array:
    """Move unknowns strictly within the bounds, as the optimiser requires."""
    room = np.where(np.isfinite(high - low), 1e-3 * (high - low), 1e-3)
    room = np.minimum(room, 0.02)
    return np.minimum(np.maximum(z, low + room), high - room)


def loss_weights(residuals: Array, loss: str) -> Array:
    """Return the weight of each residual in the robust loss, its first derivative."""
    if loss == "linear":
        return np.ones(len(residuals))
    ratio = np.abs(residuals) / _ROBUST[loss]
    if loss == "huber":
        return 1.0 / np.maximum(ratio, 1.0)
    return np.asarray((1.0 + ratio**2) ** -0.5)


def loss_curvature(residuals: Array, loss: str) -> Array:
    """Return the second derivative of half the robust loss by each residual, ψ' for the score ψ = weight · residual."""
    if loss == "linear":
        return np.ones(len(residuals))
    ratio = np.abs(residuals) / _ROBUST[loss]
    if loss == "huber":
        return np.asarray((ratio <= 1.0).astype(np.float64))
    return np.asarray((1.0 + ratio**2) ** -1.5)


def inverse(matrix: Array) -> Array:
    """Invert a positive semidefinite matrix; its null directions get a very large value."""
    size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    # Scaled to a unit diagonal, so that units do not decide which directions count as null.
    values, vectors = np.linalg.eigh(matrix / np.outer(size, size))
    return np.asarray((vectors / np.maximum(values, 1e-13)) @ vectors.T / np.outer(size, size))


def assess(found: Minimum, options: EstimatorOptions) -> Solution:
    """Return the uncertainty of a minimum.

    An M-estimator with the scores Σ Jₜᵀ ψ(rₜ) has the covariance H⁻¹ G H⁻¹ with H = Σ ψ'(rₜ) Jₜᵀ Jₜ and the covariance
    G of the scores (P. J. Huber and E. M. Ronchetti, Robust Statistics, 2nd ed., 2009, sections 6.3 and 7.6). The
    weights ψ(r) / r of iterated least squares in place of ψ' would make H too large, and the intervals too narrow.
    """
    problem, z = found.problem, found.z
    p = len(problem.free)
    residuals, jacobian = problem.residuals(z), problem.jacobian(z)

    # Parameters at a bound.
    low, high = problem.bounds()
    bound: list[str | None] = []
    for i, parameter in enumerate(problem.free):
        # Near is relative to the scaled range, at most 2, as ranges of positive parameters span orders of magnitude.
        near = 1e-3 * max(
            min(parameter.to_scaled(parameter.info.high) - parameter.to_scaled(parameter.info.low), 2.0), 1e-6
        )
        bound.append("low" if z[i] - low[i] < near else "high" if high[i] - z[i] < near else None)

    # Information of the measurements with the curvature of the robust loss, and of the priors.
    data = problem.measured
    weights, curvature = (of(residuals, options.loss) for of in (loss_weights, loss_curvature))
    curvature[data:] = 1.0
    inner = jacobian * np.sqrt(curvature)[:, None]
    information = inner.T @ inner
    prior = inner[data:].T @ inner[data:]
    whole = inverse(information)

    # Scores sample by sample for the covariance, and the blocks of the bootstrap.
    stretches: list[Stretch] = []
    blocks: list[slice] = []
    row = 0
    for drive, mask in zip(problem.drives, problem.masks, strict=True):
        part, shape = slice(row, row + mask.size), (drive.size, len(mask))
        slopes, pulls = jacobian[part].reshape(*shape, -1), (weights[part] * residuals[part]).reshape(shape)
        stretches.append(Stretch(slopes, pulls, mask.T))
        # Blocks of at least 2 s, or a fortieth of the segment: longer than the memory of the residuals.
        length = max(int(np.ceil(max(2.0, drive.size * drive.step / 40.0) / drive.step)), 10)
        count = max(drive.size // length, 1)
        blocks += [
            slice(row + int(rows_[0]) * len(mask), row + (int(rows_[-1]) + 1) * len(mask))
            for rows_ in np.array_split(np.arange(drive.size), count)
        ]
        row += mask.size

    # Information of the data weighted by the covariance of the scores, plus that of the priors.
    measured = inner[:data].T @ inner[:data]
    size = np.sqrt(np.maximum(np.diag(measured), 1e-300))
    inside = measured / np.outer(size, size)
    noise, memoryless = (matrix / np.outer(size, size) for matrix in score_covariance(stretches))
    # Degrees of freedom: the fit has removed as many as there are unknowns.
    noise *= problem.samples / max(problem.samples - problem.size, 1)
    effective = inside @ np.linalg.pinv(noise, rcond=1e-12, hermitian=True) @ inside * np.outer(size, size)
    spread = inverse(effective + prior)[:p, :p]
    white = whole[:p, :p]
    # How much wider each parameter is than with white residuals, for the notes and the profiles.
    moved = whole[:p] * size
    inflation = np.einsum("ij,jk,ik->i", moved, noise, moved) / np.maximum(
        np.einsum("ij,jk,ik->i", moved, memoryless, moved), 1e-300
    )
    draws = None
    if options.bootstrap and len(blocks) > 4:
        loss = robust(options.loss, data)
        draws = block_bootstrap(problem, z, blocks, loss=loss, count=options.bootstrap, seed=options.seed)[:, :p]
    return Solution(
        z, problem, found.cost, spread, white, inflation, inverse(white),
        tuple(bound), draws, found.message,
    )  # fmt: skip
