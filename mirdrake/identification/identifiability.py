"""Identifiability: parameters that the logs determine, and combinations in place of those that they do not."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mirdrake.identification import messages
from mirdrake.identification.fit import FittedParameter, Verdict
from mirdrake.identification.judgement import Combination, Direction, Judgement
from mirdrake.identification.models.base import Assumption, AssumptionEffect, Model, Segment
from mirdrake.identification.parameters import FitParameter

Array = NDArray[np.float64]

CALIBRATION = 1.4
"""Factor on the standard deviation by all known causes [1]: the effects that no cause contains, such as noise of the
inputs. Measured on 100 drawn cases, seeds 1200 to 1319 of `benchmarks/calibration`."""

IDENTIFIED = 0.06
"""Largest standard deviation of an identified parameter, relative or over the scale of the parameter."""

WEAK = 0.15
"""Largest standard deviation of a weakly identified parameter, relative or over its scale."""

DOUBTFUL = 0.02
"""Standard deviation from which the assumption that causes it is named, relative or over the scale."""

INSEPARABLE = 0.95
"""Correlation above which two parameters are not separable."""

GIVEN = 0.05
"""Least difference from the given value that counts as a contradiction, relative or over the scale."""

NEGLIGIBLE_COMBINATION = 0.15
"""Largest relative standard deviation of a combination that is worth reporting."""


@dataclass(frozen=True)
class Uncertainty:
    """Uncertainty of the scaled free parameters.

    Attributes:
        sigmas: standard deviations by noise (p).
        correlation: correlations (p, p).
        bounds: bound that an estimate is at (p).
        effects: contributions of the assumptions.
        between: standard deviations between parts of the logs (p).
        structures: standard deviations between structures that predict as well (p).
        model_error: whether the residuals are far from white, so that an implausible value is not an estimate.
    """

    sigmas: Array
    correlation: Array
    bounds: Sequence[str | None]
    effects: Sequence[AssumptionEffect] = ()
    between: Array | None = None
    structures: Array | None = None
    model_error: bool = False

    def covariance(self, noise: Array) -> Array:
        """Return the covariance of the scaled free parameters by all causes (p, p), with the factor of calibration.

        Args:
            noise: covariance by noise (p, p).
        """
        whole = noise.copy()
        for effect in self.effects:
            whole += np.outer(effect.shift, effect.shift)
        for sizes in (self.between, self.structures):
            if sizes is not None:
                whole += np.diag(sizes**2)
        return CALIBRATION**2 * whole


def judge(
    model: Model,
    unknowns: Sequence[FitParameter],
    values: Mapping[str, float],
    uncertainty: Uncertainty,
    drives: Sequence[Segment] = (),
) -> tuple[FittedParameter, ...]:
    """Return the parameters with their intervals and verdicts.

    Args:
        model: fitted model.
        unknowns: all parameters.
        values: estimates.
        uncertainty: uncertainty of the free parameters.
        drives: segments of the logs, so that advice names what they lack.
    """
    # Correlations and combinations refer to the free parameters only.
    names = [unknown.info.name for unknown in unknowns if unknown.kind != "fixed"]
    judgements = []
    for unknown in unknowns:
        info, value = unknown.info, values[unknown.info.name]
        if unknown.kind == "fixed":
            judgements.append(
                FittedParameter(info.name, info.unit, value, kind="fixed", given=unknown.given, source=unknown.source,
                                verdict="fixed", explanation=info.source)
            )  # fmt: skip
            continue
        judgement = _judge(model, unknown, values, uncertainty, names, drives)
        # Deviations are those of the scaled parameter; to first order, the slope converts them to its unit.
        slope = abs(unknown.slope(value))
        low, high = _interval(unknown, value, judgement.sigma)
        finite = math.isfinite(judgement.sigma), math.isfinite(judgement.noise)
        at_bound: Literal["low", "high"] | None = judgement.bound
        judgements.append(
            FittedParameter(
                info.name, info.unit, value, slope * judgement.sigma if finite[0] else None, low, high, unknown.kind,
                at_bound, unknown.given, unknown.source, judgement.verdict, messages.explanation(judgement),
                sigma_noise=slope * judgement.noise if finite[1] else None,
                sigma_model=slope * math.hypot(judgement.by_assumptions, judgement.between, judgement.structures),
            )
        )  # fmt: skip
    return tuple(judgements)


def _interval(unknown: FitParameter, value: float, sigma: float) -> tuple[float | None, float | None]:
    """Return the 95 % interval, within the bounds; None if it is open."""
    # A factor of exp(3 · 1.96), about 350, in both directions means that the log determines nothing.
    if not math.isfinite(sigma) or (unknown.logarithmic and sigma > 3.0):
        return None, None
    scaled, info = unknown.to_scaled(value), unknown.info
    # Transformed ends instead of value ± 1.96 σ: the interval of a positive parameter is not symmetric.
    low, high = unknown.to_value(scaled - 1.96 * sigma), unknown.to_value(scaled + 1.96 * sigma)
    return max(low, min(info.low, value)), min(high, max(info.high, value))


def _judge(
    model: Model,
    unknown: FitParameter,
    values: Mapping[str, float],
    uncertainty: Uncertainty,
    names: Sequence[str],
    drives: Sequence[Segment],
) -> Judgement:
    """Return the verdict on a free parameter and the figures that lead to it."""
    info, value = unknown.info, values[unknown.info.name]
    i = names.index(info.name)
    noise = float(uncertainty.sigmas[i])
    # Independent contributions: their variances add.
    shifts = [(abs(float(effect.shift[i])), effect.assumption) for effect in uncertainty.effects]
    by_assumptions = math.hypot(*(shift for shift, _ in shifts))
    between, structures = (
        0.0 if values is None else float(values[i]) for values in (uncertainty.between, uncertainty.structures)
    )
    sigma = CALIBRATION * math.hypot(noise, by_assumptions, between, structures)
    # Relative for logarithms; otherwise over the scale, or over the value where that is larger.
    per_scale = 1.0 if unknown.logarithmic else 1.0 / max(1.0, abs(value) / info.scale)
    span = sigma * per_scale
    plausible = model.plausible_range(info.name, values)
    is_plausible = plausible[0] <= value <= plausible[1]
    bound = uncertainty.bounds[i]

    # The verdict by uncertainty and plausibility alone.
    verdict: Verdict = "identified"
    is_meaningless = not is_plausible and (uncertainty.model_error or span > IDENTIFIED)
    if bound is not None or not noise * per_scale <= WEAK or is_meaningless:
        verdict = "not identifiable"
    elif span > IDENTIFIED:
        verdict = "weakly identified"  # also if only the model makes it uncertain: the logs do determine it

    # The reason of the uncertainty: assumptions, correlated parameters or noise.
    depends_on: Assumption | None = None
    inseparable: list[str] = []
    remedy = ""
    # A wrong assumption may be what logs and channels differ by, so that a larger difference does not hide it.
    if by_assumptions > max(noise, structures) and span > DOUBTFUL:
        depends_on = max(shifts, key=lambda shift: shift[0])[1]
    if verdict != "identified":
        ranked = sorted(zip(np.abs(uncertainty.correlation[i]), names, strict=True), reverse=True)
        inseparable = [name for rho, name in ranked if name != info.name and rho > INSEPARABLE][:2]
        # Where the model makes the estimate uncertain, another drive does not help.
        by_model = math.hypot(by_assumptions, between, structures)
        if inseparable or noise * span > IDENTIFIED * sigma or (depends_on is None and not noise < by_model):
            remedy = model.suggest_experiment(frozenset({info.name, *inseparable}), drives)
    # A wide interval excludes a given value as well as a narrow one; a value without meaning excludes nothing.
    is_usable = bound is None and not is_meaningless and math.isfinite(sigma)
    contradicts = is_usable and unknown.given is not None and _contradicts(unknown, value, sigma, span)
    if contradicts and verdict == "identified":
        verdict = "contradicts the given value"
    prior_share = noise * unknown.slope(value) / unknown.prior[1] if unknown.kind == "prior" and unknown.prior else 0.0
    return Judgement(
        unknown, value, verdict, noise, by_assumptions, between, structures, sigma,
        "low" if bound == "low" else "high" if bound else None,
        span <= WEAK, is_meaningless, None if is_plausible else plausible, depends_on, tuple(inseparable), remedy,
        prior_share, contradicts,
    )  # fmt: skip


def _contradicts(unknown: FitParameter, value: float, sigma: float, span: float) -> bool:
    """Whether the given value lies outside of the interval, by a difference that matters."""
    given = unknown.given
    assert given is not None
    # A given value that a logarithm cannot have differs by any measure.
    apart = math.inf
    if given > 0.0 or not unknown.logarithmic:
        apart = abs(unknown.to_scaled(given) - unknown.to_scaled(value))
    return apart > max(1.96 * sigma, GIVEN * (sigma / span if span > 0.0 else 1.0))


def combinations(
    model: Model,
    unknowns: Sequence[FitParameter],
    values: Mapping[str, float],
    covariance: Array,
    judged: Sequence[FittedParameter],
    uncertainty: Uncertainty,
) -> tuple[Combination | Direction, ...]:
    """Return derived quantities of the model that the logs determine, and directions of poorly known parameters.

    Args:
        model: fitted model.
        unknowns: all parameters.
        values: estimates.
        covariance: covariance of the scaled free parameters by noise (p, p).
        judged: parameters with their verdicts.
        uncertainty: uncertainty of the free parameters; a combination may be insensitive to the assumptions.
    """
    # Logs and structures move each parameter for itself.
    apart = np.zeros(len(covariance))
    for values_ in (uncertainty.between, uncertainty.structures):
        apart += 0.0 if values_ is None else values_**2
    poor = {judgement.name for judgement in judged if judgement.verdict in {"not identifiable", "weakly identified"}}
    free = [unknown for unknown in unknowns if unknown.kind != "fixed"]
    return (
        *_derived_combinations(model, free, values, covariance + np.diag(apart), uncertainty.effects),
        *_directions(free, covariance, poor, uncertainty.effects),
    )


def _derived_combinations(
    model: Model,
    free: Sequence[FitParameter],
    values: Mapping[str, float],
    covariance: Array,
    effects: Sequence[AssumptionEffect],
) -> Iterator[Combination]:
    """Yield the derived quantities of a model that are known, whether or not the parameters in them are."""
    base = model.derived_quantities(values)
    slopes = {name: np.zeros(len(free)) for name in base}
    for i, unknown in enumerate(free):
        name, scaled = unknown.info.name, unknown.to_scaled(values[unknown.info.name])
        # Central differences: the delta method needs gradients of quantities that models state as plain formulas.
        moved = [{**values, name: unknown.to_value(scaled + step)} for step in (1e-4, -1e-4)]
        up, down = (model.derived_quantities(p) for p in moved)
        for key in base:
            slopes[key][i] = (up[key][0] - down[key][0]) / 2e-4
    others = [(effect, model.derived_quantities({**values, **effect.assumption.changes})) for effect in effects]
    for key, (value, unit) in base.items():
        variance = float(slopes[key] @ covariance @ slopes[key])
        for effect, other in others:
            # An assumption moves the quantity through the estimates and directly.
            itself = effect.size * (other[key][0] - value) / effect.assumption.fraction
            variance += (float(slopes[key] @ effect.shift) + itself) ** 2
        sigma = CALIBRATION * max(variance, 0.0) ** 0.5
        if np.any(np.abs(slopes[key]) > 1e-12) and sigma < NEGLIGIBLE_COMBINATION * abs(value):
            yield Combination(key, value, sigma, unit)


def _directions(
    free: Sequence[FitParameter], covariance: Array, poor: set[str], effects: Sequence[AssumptionEffect]
) -> Iterator[Direction]:
    """Yield directions of small variance that consist of poorly known parameters."""
    index = [i for i, unknown in enumerate(free) if unknown.info.name in poor]
    if len(index) < 2:
        return
    # Covariance with the assumptions: a direction may be insensitive to them although its parameters are not.
    wide = covariance + sum(np.outer(effect.shift, effect.shift) for effect in effects)
    variances, vectors = np.linalg.eigh(wide[np.ix_(index, index)])
    for variance, vector in zip(variances, vectors.T, strict=True):
        big = np.abs(vector) > 0.2
        if variance**0.5 < IDENTIFIED and big.sum() > 1:
            parts = tuple((free[index[k]], float(vector[k])) for k in np.flatnonzero(big).tolist())
            yield Direction(parts, float(variance) ** 0.5)
