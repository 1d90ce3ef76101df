"""Sensitivity of estimates to the assumptions of a fit.

A fit with z at the minimum of |r(z, q)|² holds q at zero: the error of an assumed value, or an effect that the model
omits. If q were one standard deviation, the residuals would change by Δ and the estimates by S = -A⁻¹ Jᵀ Δ, with the
information matrix A = Jᵀ J. The covariance of the estimates grows by S Sᵀ E[q²].

An assumed value is off by its standard deviation, E[q²] = 1. The log is not used to estimate q, because errors of the
model would bias that estimate, too. This is the consider covariance of orbit determination (B. D. Tapley,
B. E. Schutz, G. H. Born, Statistical Orbit Determination, 2004, section 6.2).

An omitted effect may be absent, or q of a standard normal distribution; both are equally likely a priori. The log gives
the estimate q̂ = -Δ'ᵀ r / Δ'ᵀ Δ, where Δ' = Δ + J S is the part that no other unknown compensates, with the variance v
computed from autocorrelated residuals without q̂. The odds for the effect are N(q̂; 0, 1 + v) / N(q̂; 0, v), the Bayes
factor of J. M. Dickey (Annals of Mathematical Statistics 42, 1971). The mean over both models is
E[q²] = P (m² + v / (1 + v)) with m = q̂ / (1 + v) (J. A. Hoeting et al., Bayesian model averaging, Statistical Science
14, 1999). Where the model is right P is small: about the standard deviation with which the log determines the effect,
over its prior standard deviation.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.special import expit

from mirdrake.core.errors import RunError
from mirdrake.identification.estimators.covariance import Stretch, score_covariance
from mirdrake.identification.estimators.options import EstimatorOptions
from mirdrake.identification.estimators.problem import Problem, transfer_states
from mirdrake.identification.estimators.solve import Solution, inverse, loss_weights, minimise
from mirdrake.identification.models.base import SMALL_FRACTION, Array, Assumption, AssumptionEffect, Model
from mirdrake.identification.parameters import FitParameter

LINEAR, REFIT = 0.3, 12
"""Shift of a scaled parameter above which an assumption is refitted [1]; evaluations of a refit."""

Remake = Callable[[Mapping[str, Any]], Model]
"""Makes the model with further options."""


class AssumptionEvidence(NamedTuple):
    """Evidence of a log about an assumption, to first order.

    Attributes:
        shift: shift of the unknowns for one standard deviation (unknowns).
        rest: change of the residuals that the unknowns do not compensate (rows).
        information: Fisher information on the assumption's error [1].
        estimate: estimated error, in standard deviations.
    """

    shift: Array
    rest: Array
    information: float
    estimate: float


class SensitivityAnalysis:
    """Linearisation of a fit at its minimum.

    Args:
        problem: least-squares problem with its noise.
        z: unknowns at the minimum.
        options: options of the fit.
        remake: makes a model with an omitted effect.
    """

    def __init__(self, problem: Problem, z: Array, options: EstimatorOptions, remake: Remake) -> None:
        self._problem, self._z, self._loss, self._remake = problem, z, options.loss, remake
        self._residuals, self._slopes = problem.residuals(z), problem.jacobian(z)
        self._weights = self._weights_of(self._residuals)
        self._inverse = inverse(self._slopes.T @ (self._weights[:, None] * self._slopes))

    def _weights_of(self, residuals: Array) -> Array:
        weights = loss_weights(residuals, self._loss)
        # The robust loss applies to measurements only; priors are quadratic.
        weights[self._problem.measured :] = 1.0
        return weights

    def evidence(self, assumption: Assumption) -> AssumptionEvidence | None:
        """Return the evidence; None if the model diverges or the log carries no information about the assumption."""
        problem, rows = self._problem, self._problem.measured
        moved = _residuals_without(problem, self._z, assumption, self._remake)
        if moved is None:
            return None
        change = np.zeros(problem.rows)
        change[:rows] = (moved - self._residuals[:rows]) / assumption.fraction
        # One Gauss-Newton step: how the unknowns move to compensate the change.
        shift = -self._inverse @ (self._slopes.T @ (self._weights * change))
        rest = change + self._slopes @ shift
        information = float(rest @ (self._weights * rest))
        if information <= 0.0:
            return None
        estimate = -float(rest @ (self._weights * self._residuals)) / information
        return AssumptionEvidence(shift, rest, information, estimate)

    def variance(self, evidence: AssumptionEvidence) -> float:
        """Return the variance of the estimate, allowing for autocorrelated residuals."""
        problem, row, stretches = self._problem, 0, []
        # Residuals with the estimated effect removed: with it they would look more correlated than noise is.
        left = self._residuals + evidence.estimate * evidence.rest
        pulls = self._weights_of(left) * left
        for drive, mask in zip(problem.drives, problem.masks, strict=True):
            rows, shape = slice(row, row + mask.size), (drive.size, len(mask))
            stretches.append(Stretch(evidence.rest[rows].reshape(*shape, 1), pulls[rows].reshape(shape), mask.T))
            row += mask.size
        return float(score_covariance(stretches)[0][0, 0]) / evidence.information**2


def assumption_effects(solution: Solution, options: EstimatorOptions, remake: Remake) -> tuple[AssumptionEffect, ...]:
    """Return the contribution of each assumption of a fit to the uncertainty of its parameters."""
    assumptions = list_assumptions(solution.problem, solution.z)
    if not assumptions:
        return ()
    analysis, effects = SensitivityAnalysis(solution.problem, solution.z, options, remake), []
    for assumption in assumptions:
        evidence = analysis.evidence(assumption)
        if evidence is not None:
            # An assumed value counts in full, an omitted effect as far as the log supports it.
            size = 1.0
            if assumption.is_omitted:
                size = expected_square(evidence.estimate, analysis.variance(evidence)) ** 0.5
            size = min(size, assumption.max_size)
            shift = size * evidence.shift[: len(solution.problem.free)]
            if np.max(np.abs(shift)) > LINEAR:
                shift = _refitted_shift(solution, assumption, size, options, remake, shift)
            effects.append(AssumptionEffect(assumption, shift, size))
    return tuple(effects)


def _refitted_shift(
    solution: Solution, assumption: Assumption, size: float, options: EstimatorOptions, remake: Remake, linear: Array
) -> Array:
    """Return the shift of the estimates by a refit with the assumption changed by its size.

    A linearisation overstates shifts along poorly determined directions many times. If the refit fails, it counts.
    """
    problem, count = solution.problem, len(solution.problem.free)
    values, known = problem.values(solution.z), {unknown.info.name: unknown.info for unknown in problem.unknowns}
    # A changed value is moved by its whole size; an option of the model has only the change that it was defined with.
    scale = 1.0 if assumption.options else size / assumption.fraction
    changes = {}
    for name, value in assumption.changes.items():
        changes[name] = value
        if name in known:
            info = known[name]
            changes[name] = min(max(values[name] + scale * (value - values[name]), info.low), info.high)
    other = _changed_problem(problem, replace(assumption, changes=changes), remake)
    start = np.concatenate((solution.z[:count], transfer_states(solution.z, problem, other)))
    try:
        refit = minimise(other, replace(options, iterations=REFIT), start, close=1e-4)
    except RunError:
        return linear
    shift = refit.z[:count] - solution.z[:count]
    return shift if not assumption.options else size / assumption.fraction * shift


def expected_square(estimate: float, variance: float) -> float:
    """Return the posterior mean square of an effect whose prior is a spike at zero plus a standard normal.

    Args:
        estimate: estimate from the log alone.
        variance: variance of the estimate.
    """
    variance = max(variance, 1e-12)
    # Logarithm of the Bayes factor; expit turns it into the probability of the effect at equal prior odds.
    odds = 0.5 * np.log(variance / (1.0 + variance)) + 0.5 * estimate**2 / (variance * (1.0 + variance))
    mean = estimate / (1.0 + variance)
    return float(expit(odds) * (mean**2 + variance / (1.0 + variance)))


def list_assumptions(problem: Problem, z: Array) -> tuple[Assumption, ...]:
    """Return the fixed values whose standard deviation the study states, and the assumptions of the model."""
    values = problem.values(z)
    fixed = [unknown for unknown in problem.unknowns if unknown.kind == "fixed"]
    free = {parameter.info.name for parameter in problem.free}
    own = problem.model.assumptions(values, frozenset(unknown.info.name for unknown in fixed if unknown.is_assumed))
    uncertain = {unknown.info.name for unknown in fixed if unknown.sigma is not None}
    stated = []
    for unknown in fixed:
        if unknown.sigma is None:
            continue
        name, step = unknown.info.name, SMALL_FRACTION * unknown.sigma
        changes = {name: values[name] + step}
        # With a known wheelbase the centre of mass moves between the axles; two uncertain parts are independent.
        other = problem.model.complement(name)
        if other is not None and other not in uncertain | free:
            changes[other] = values[other] - step
        what = f"{name}, which is fixed to ± {1.96 * unknown.sigma:.2g} {unknown.info.unit}".rstrip()
        stated.append(Assumption(what, f"measure {name} more accurately", changes, SMALL_FRACTION))
    return (*stated, *(assumption for assumption in own if not set(assumption.changes) & free))


def _residuals_without(problem: Problem, z: Array, assumption: Assumption, remake: Remake) -> Array | None:
    """Return the residuals of the measurements if an assumption is off by its fraction; None if the model diverges."""
    other = _changed_problem(problem, assumption, remake)
    residuals = other.residuals(np.concatenate((z[: len(problem.free)], transfer_states(z, problem, other))))
    return residuals[: problem.measured] if np.isfinite(residuals).all() else None


def _changed_problem(problem: Problem, assumption: Assumption, remake: Remake) -> Problem:
    """Return the problem with the changes of an assumption."""
    model = problem.model
    if assumption.options:
        model = remake({**assumption.options, "outputs": list(model.outputs)})
    known = {unknown.info.name: unknown for unknown in problem.unknowns}
    unknowns = []
    for info in model.parameters:
        parameter = known.get(info.name, FitParameter(info, "fixed"))
        value = assumption.changes.get(info.name)
        if value is not None:
            parameter = replace(parameter, info=replace(parameter.info, guess=value))
        unknowns.append(parameter)
    return Problem(model, problem.drives, unknowns, problem.sigmas, problem.offsets, problem.joined)
