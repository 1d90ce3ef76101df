"""How far estimates move if what a fit takes for granted is not so.

A fit with z at the minimum of |r(z, q)|² holds q at zero: a value that was assumed, or an effect that the model has
not. Were it one standard deviation off, the residuals would change by Δ, and the estimates by S = -A⁻¹ Jᵀ Δ with the
information matrix A = Jᵀ J. Their covariance grows by S Sᵀ E[q²].

An assumed value is off by its standard deviation, E[q²] = 1, whatever the log says: what bends the model would bend
this, too. This is the consider covariance of orbit determination (B. D. Tapley, B. E. Schutz, G. H. Born, Statistical
Orbit Determination, 2004, section 6.2).

An effect that is left out may be nothing, or q of a normal distribution; both are as likely before. The log tells of
it q̂ = -Δ'ᵀ r / Δ'ᵀ Δ, where Δ' = Δ + J S is what no other unknown makes up for, with the variance v of residuals that
have a memory, q̂ taken out. The odds for the effect are N(q̂; 0, 1 + v) / N(q̂; 0, v), the Bayes
factor of J. M. Dickey (Annals of Mathematical Statistics 42, 1971), and the mean over both models is
E[q²] = P (m² + v / (1 + v)), m = q̂ / (1 + v) (J. A. Hoeting et al., Bayesian model averaging, Statistical Science 14,
1999). Where the model is right P is small: about the standard deviation to which the log knows the effect, over that
which was expected.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.special import expit

from mirdrake.identification.estimators.covariance import Stretch, score_covariance
from mirdrake.identification.estimators.options import EstimatorOptions
from mirdrake.identification.estimators.problem import Problem, transfer_states
from mirdrake.identification.estimators.solve import Solution, inverse, weights_of
from mirdrake.identification.models.base import SMALL, Array, Assumption, AssumptionEffect, Model
from mirdrake.identification.parameters import FitParameter

Remake = Callable[[Mapping[str, Any]], Model]
"""A model with other options."""


class AssumptionEvidence(NamedTuple):
    """What a log says of a assumption, to first order.

    Attributes:
        shift: of the unknowns, for one standard deviation (unknowns).
        rest: change of the residuals that they do not make up for (rows).
        known: information on it [1].
        estimate: of it, in standard deviations.
    """

    shift: Array
    rest: Array
    known: float
    estimate: float


class SensitivityAnalysis:
    """A minimum that assumptions are asked at.

    Args:
        problem: with its noise.
        z: unknowns at the minimum.
        options: of the fit.
        remake: for effects that the model has not.
    """

    def __init__(self, problem: Problem, z: Array, options: EstimatorOptions, remake: Remake) -> None:
        self._problem, self._z, self._loss, self._remake = problem, z, options.loss, remake
        self._residuals, self._slopes = problem.residuals(z), problem.jacobian(z)
        self._weights = self._weights_of(self._residuals)
        self._inverse = inverse(self._slopes.T @ (self._weights[:, None] * self._slopes))

    def _weights_of(self, residuals: Array) -> Array:
        found = weights_of(residuals, self._loss)
        found[self._problem.measured :] = 1.0
        return found

    def answer(self, assumption: Assumption) -> AssumptionEvidence | None:
        """None: the model runs away, or nothing tells of it."""
        problem, many = self._problem, self._problem.measured
        moved = _moved(problem, self._z, assumption, self._remake)
        if moved is None:
            return None
        change = np.zeros(problem.rows)
        change[:many] = (moved - self._residuals[:many]) / assumption.part
        shift = -self._inverse @ (self._slopes.T @ (self._weights * change))
        rest = change + self._slopes @ shift
        known = float(rest @ (self._weights * rest))
        if known <= 0.0:
            return None
        return AssumptionEvidence(shift, rest, known, -float(rest @ (self._weights * self._residuals)) / known)

    def variance(self, answer: AssumptionEvidence) -> float:
        """Of the estimate, with residuals that have a memory and not what it explains."""
        problem, at, stretches = self._problem, 0, []
        left = self._residuals + answer.estimate * answer.rest
        pulls = self._weights_of(left) * left
        for drive, mask in zip(problem.drives, problem.masks, strict=True):
            rows, shape = slice(at, at + mask.size), (drive.size, len(mask))
            stretches.append(Stretch(answer.rest[rows].reshape(*shape, 1), pulls[rows].reshape(shape), mask.T))
            at += mask.size
        return float(score_covariance(stretches)[0][0, 0]) / answer.known**2


def assumption_effects(solution: Solution, options: EstimatorOptions, remake: Remake) -> tuple[AssumptionEffect, ...]:
    """What each assumption of a fit does to its parameters."""
    assumptions = assumptions_of(solution.problem, solution.z)
    if not assumptions:
        return ()
    ask, found = SensitivityAnalysis(solution.problem, solution.z, options, remake), []
    for assumption in assumptions:
        answer = ask.answer(assumption)
        if answer is not None:
            size = expected_square(answer.estimate, ask.variance(answer)) ** 0.5 if assumption.is_omitted else 1.0
            size = min(size, assumption.most)
            found.append(AssumptionEffect(assumption, size * answer.shift[: len(solution.problem.free)], size))
    return tuple(found)


def expected_square(estimate: float, variance: float) -> float:
    """Of an effect that is nothing, or one of a standard normal distribution, by an estimate of it.

    Args:
        estimate: of the log alone.
        variance: of the estimate.
    """
    variance = max(variance, 1e-12)
    odds = 0.5 * np.log(variance / (1.0 + variance)) + 0.5 * estimate**2 / (variance * (1.0 + variance))
    mean = estimate / (1.0 + variance)
    return float(expit(odds) * (mean**2 + variance / (1.0 + variance)))


def assumptions_of(problem: Problem, z: Array) -> tuple[Assumption, ...]:
    """Doubts of the model, and values that the study is not sure of."""
    values = problem.values(z)
    held = [one for one in problem.unknowns if one.kind == "fixed"]
    names = [one.info.name for one in problem.free]
    own = problem.model.assumptions(values, frozenset(one.info.name for one in held if one.is_assumed))
    said = [
        Assumption(f"{one.info.name}, which is fixed to ± {1.96 * one.sigma:.2g} {one.info.unit}".rstrip(),
              f"know {one.info.name} better", {one.info.name: values[one.info.name] + SMALL * one.sigma}, SMALL)
        for one in held
        if one.sigma is not None
    ]  # fmt: skip
    return (*said, *(one for one in own if not set(one.changes) & set(names)))


def _moved(problem: Problem, z: Array, assumption: Assumption, remake: Remake) -> Array | None:
    """Residuals of what was measured if a assumption is true in part; None: the model runs away."""
    model = problem.model
    if assumption.options:
        model = remake({**assumption.options, "outputs": list(model.outputs)})
    known = {one.info.name: one for one in problem.unknowns}
    unknowns = []
    for info in model.parameters:
        one = known.get(info.name, FitParameter(info, "fixed"))
        value = assumption.changes.get(info.name)
        unknowns.append(one if value is None else replace(one, info=replace(one.info, guess=value)))
    other = Problem(model, problem.drives, unknowns, problem.sigmas, problem.offsets, problem.joined)
    found = other.residuals(np.concatenate((z[: len(problem.free)], transfer_states(z, problem, other))))
    return found[: problem.measured] if np.isfinite(found).all() else None
