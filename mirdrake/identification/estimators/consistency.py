"""Consistency of an estimate between logs, and cross-validation of a model by parts of the logs, both to first order.

A wrong model fits each manoeuvre with other parameters. Its estimate depends on what was driven, by more than the noise
explains, and a longer log of the same manoeuvres does not help. Each log k by itself moves the estimate by dₖ with the
variance vₖ for autocorrelated residuals. If the logs differ by more than that, the true parameter "of a manoeuvre"
scatters with a variance τ² between manoeuvres, by the random-effects model of meta-analysis (R. DerSimonian and
N. Laird, Controlled Clinical Trials 7, 1986)::

    Q = Σ (dₖ - d̄)² / vₖ        τ² = (Q - (K - 1)) / (Σ 1/vₖ - Σ 1/vₖ² / Σ 1/vₖ)

By noise alone Q is χ² with K - 1 degrees of freedom and half of all τ² are positive. τ counts from the quantile
:data:`CHANCE` of Q on (W. G. Cochran, Biometrics 10, 1954): a model is called wrong by evidence only.

τ is not divided by the number of logs, as the next manoeuvre differs again: an identified value is one that a further
manoeuvre would confirm. Validation logs count as well: the fit has not seen them.

A wrong model also fits each output with other parameters. Outputs in place of logs give the same standard deviation.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from mirdrake.identification.estimators.covariance import Stretch, noise_models, score_covariance
from mirdrake.identification.estimators.problem import Problem
from mirdrake.identification.estimators.solve import Minimum, loss_weights, robust
from mirdrake.identification.models.base import Array

PARTS, MIN_LENGTH = 8, 2.0
"""Number of parts of the training logs, nearly; shortest part [s]."""

CHANCE = 0.99
"""Probability below which a scatter between parts is one of noise [1]."""


class Part(NamedTuple):
    """Stretch of a log, to first order.

    Attributes:
        information: information on the free parameters, sensor offsets and initial states eliminated (p, p).
        score: sum of the scores (p).
        noise: covariance of the score (p, p).
        slopes: derivatives of the residuals by the free parameters, the others eliminated (n, outputs, p).
        residuals: residuals over their noise (n, outputs).
    """

    information: Array
    score: Array
    noise: Array
    slopes: Array
    residuals: Array

    def cost(self, shift: Array, loss: str) -> float:
        """Return half the sum of the losses for shifted parameters (p), to first order."""
        moved = (self.residuals + self.slopes @ shift).ravel()
        return 0.5 * float(np.sum(robust(loss, len(moved))(moved**2)[0]))


def part_length(problem: Problem) -> float:
    """Return the length of the parts of a problem [s]."""
    return max(sum(drive.size * drive.step for drive in problem.drives) / PARTS, MIN_LENGTH)


def split(problem: Problem, z: Array, loss: str, length: float = np.inf) -> list[Part]:
    """Return the parts of a problem at its minimum.

    Args:
        problem: least-squares problem.
        z: unknowns at the minimum.
        loss: loss function.
        length: length of a part, nearly [s]; infinite: each segment is one.
    """
    residuals, slopes = problem.residuals(z), problem.jacobian(z)
    weights = loss_weights(residuals, loss)
    count, data = len(problem.free), problem.measured
    # Offsets and initial states have their priors in each part, as a sensor may drift.
    prior = slopes[data:, count:].T @ slopes[data:, count:]
    blocks, row = [], 0
    for drive, mask in zip(problem.drives, problem.masks, strict=True):
        number = max(round(drive.size * drive.step / length), 1)
        # Residuals are stored sample by sample, so consecutive samples are one slice.
        for rows in np.array_split(np.arange(drive.size), number):
            part = slice(row + int(rows[0]) * len(mask), row + (int(rows[-1]) + 1) * len(mask))
            inner = slopes[part]
            whole = inner.T @ (weights[part, None] * inner)
            # Schur complement: offsets and initial states of the part follow the parameters, and their freedom is
            # eliminated.
            turn = np.linalg.solve(whole[count:, count:] + prior, whole[count:, :count])
            own = inner[:, :count] - inner[:, count:] @ turn
            pulls = weights[part] * residuals[part]
            shape = (len(rows), len(mask))
            stretch = Stretch(own.reshape(*shape, count), pulls.reshape(shape), mask[:, rows].T)
            inside = whole[:count, :count] - whole[:count, count:] @ turn
            blocks.append((stretch, inside, own.T @ pulls, residuals[part].reshape(shape)))
        row += mask.size
    # One noise model for all parts: a short part alone could not determine it.
    models = noise_models([stretch for stretch, *_ in blocks])
    return [Part(inside, score, score_covariance([stretch], models)[0], stretch.slopes, rest)
            for stretch, inside, score, rest in blocks]  # fmt: skip


def split_by_output(problem: Problem, z: Array, loss: str) -> list[Part]:
    """Return the outputs of a problem at its minimum as parts, each with its samples of all segments."""
    parts = split(problem, z, loss)
    slopes = np.concatenate([part.slopes for part in parts])
    residuals = np.concatenate([part.residuals for part in parts])
    outputs = []
    for k in range(len(problem.model.outputs)):
        inner, rest = slopes[:, k : k + 1], residuals[:, k : k + 1]
        weights = loss_weights(rest[:, 0], loss)[:, None]
        # Missing values have slopes and residuals of zero.
        stretch = Stretch(inner, weights * rest, np.any(inner, axis=2))
        whole = inner[:, 0].T @ (weights * inner[:, 0])
        outputs.append(
            Part(whole, inner[:, 0].T @ stretch.residuals[:, 0], score_covariance([stretch])[0], inner, rest)
        )
    return outputs


def cross_validate(minimum: Minimum, loss: str) -> Array:
    """Return the cost of each part by the estimate of all others, to first order (parts).

    Without part k the estimate is θ + d with (A - Aₖ) d = gₖ, as the scores of all parts and of the prior cancel.
    """
    problem, z = minimum.problem, minimum.z
    parts, count = split(problem, z, loss, part_length(problem)), len(problem.free)
    # First order only: refitting the model without each part would take as many fits as there are parts.
    prior = problem.jacobian(z)[problem.measured :, :count]
    whole = prior.T @ prior + sum(part.information for part in parts)
    costs = []
    for part in parts:
        shift: Array = np.linalg.lstsq(whole - part.information, part.score, rcond=1e-10)[0].astype(np.float64)
        costs.append(part.cost(shift, loss))
    return np.array(costs)


def variation(parts: Sequence[Part], prior: Array) -> Array:
    """Return the standard deviation τ of the scaled free parameters between parts of the logs (p), 0 for one part.

    Args:
        parts: parts, each with enough information for an estimate of its own.
        prior: information of the priors on the free parameters (p, p), for a part without information of its own.
    """
    if len(parts) < 2:
        return np.zeros(len(prior))
    shifts, variances = [], []
    for part in parts:
        # A part that does not excite a parameter keeps it near the common estimate, by its prior, with a small weight.
        inside = np.linalg.inv(part.information + prior)
        shifts.append(-inside @ part.score)
        variances.append(np.diag(inside @ (part.noise + prior) @ inside))
    shift, weight = np.array(shifts), 1.0 / np.maximum(variances, 1e-300)
    total = weight.sum(axis=0)
    mean = (weight * shift).sum(axis=0) / total
    scatter, freedom = (weight * (shift - mean) ** 2).sum(axis=0), len(parts) - 1
    size = np.sqrt(np.maximum(scatter - freedom, 0.0) / (total - (weight**2).sum(axis=0) / total))
    return np.where(scatter > chi2.ppf(CHANCE, freedom), size, 0.0)


def prior_information(problem: Problem) -> Array:
    """Return the information of the priors on the free parameters (p, p)."""
    return np.diag([1.0 / max(parameter.info.usual, 1e-3) ** 2 if parameter.info.usual > 0.0 else 1e-6
                    for parameter in problem.free])  # fmt: skip
