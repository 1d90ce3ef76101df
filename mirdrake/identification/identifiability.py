"""Which parameters a log gives, in words, and which combinations instead of those that it does not."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from mirdrake.identification.fit import FittedParameter, Verdict
from mirdrake.identification.models.base import Assumption, AssumptionEffect, Model
from mirdrake.identification.parameters import FitParameter

Array = NDArray[np.float64]

IDENTIFIED = 0.06
"""Standard deviation, relative or over what is a large change, up to which a parameter is identified."""

WEAK = 0.15
"""The same up to which it is weakly identified."""

DOUBTFUL = 0.02
"""Standard deviation up to which a parameter is identified that is less sure by what the model takes for granted than
by the noise; such a bias does not shrink in longer logs."""

TOGETHER = 0.95
"""Correlation from which on two parameters are not told apart."""

BY_FACTOR = 0.5
"""Half of an interval of a logarithm from which on it is told as a factor."""

GIVEN = 0.05
"""Difference from the given value that matters, relative or over what is a large change."""


def judge(
    model: Model,
    unknowns: Sequence[FitParameter],
    values: Mapping[str, float],
    sigmas: Array,
    correlation: Array,
    bounds: Sequence[str | None],
    *,
    effects: Sequence[AssumptionEffect] = (),
    model_error: bool = False,
) -> tuple[FittedParameter, ...]:
    """Parameters with their intervals and verdicts.

    Args:
        model: what was fitted.
        unknowns: all parameters.
        values: estimates.
        sigmas: of the scaled free parameters, by noise (p).
        correlation: of these (p, p).
        bounds: where they stand (p).
        effects: what may be off besides.
        model_error: the residuals are far from white, so that a doubtful value is no value.
    """
    free = [one for one in unknowns if one.kind != "fixed"]
    names = [one.info.name for one in free]
    found = []
    for one in unknowns:
        info = one.info
        if one.kind == "fixed":
            found.append(
                FittedParameter(info.name, info.unit, values[info.name], kind="fixed", given=one.given,
                                source=one.source, verdict="fixed", words=info.source)
            )  # fmt: skip
            continue
        i = names.index(info.name)
        shifts = [(abs(float(effect.shift[i])), effect.assumption) for effect in effects]
        found.append(
            _judge(model, one, values, float(sigmas[i]), shifts, correlation[i], names, bounds[i], model_error)
        )
    return tuple(found)


def _judge(
    model: Model,
    one: FitParameter,
    values: Mapping[str, float],
    noise: float,
    shifts: Sequence[tuple[float, Assumption]],
    correlation: Array,
    names: Sequence[str],
    bound: str | None,
    model_error: bool,
) -> FittedParameter:
    info, value = one.info, values[one.info.name]
    scaled = one.to_scaled(value)
    doubtful = math.hypot(*(shift for shift, _ in shifts))
    sigma = math.hypot(noise, doubtful)
    wide = not math.isfinite(sigma) or (one.logarithmic and sigma > 3.0)
    span = sigma if one.logarithmic else sigma / max(1.0, abs(value) / info.scale)
    low = None if wide else one.to_value(scaled - 1.96 * sigma)
    high = None if wide else one.to_value(scaled + 1.96 * sigma)
    if low is not None and high is not None:
        low, high = max(low, min(info.low, value)), min(high, max(info.high, value))
    kin = [(abs(rho), name) for rho, name in zip(correlation, names, strict=True) if name != info.name]
    near = [name for rho, name in sorted(kin, reverse=True) if rho > TOGETHER][:2]
    least, most = model.plausible_range(info.name, values)
    odd = not least <= value <= most
    if bound is not None:
        verdict: Verdict = "not identifiable"
        side, edge = ("lower", info.low) if bound == "low" else ("upper", info.high)
        words = f"stands at its {side} bound of {_told(edge, info.unit)}"
    elif not span <= WEAK:
        verdict, words = "not identifiable", f"known to {_percent(one, sigma)} only"
    elif odd and (model_error or span > IDENTIFIED):
        verdict = "not identifiable"
        words = f"{_told(value, info.unit)} has no physical meaning (usual: {least:.4g} to {most:.4g}); "
        words += "the model is bent to the log"
    elif span > IDENTIFIED or (doubtful > noise and span > DOUBTFUL):
        verdict, words = "weakly identified", f"known to {_percent(one, sigma)}"
    else:
        verdict, words = "identified", f"known to {_percent(one, sigma)}"
        if odd:
            words += f"; unusual (usual: {least:.4g} to {most:.4g})"
    if verdict in {"weakly identified", "not identifiable"}:
        if doubtful > noise:
            worst = max(shifts, key=lambda shift: shift[0])[1]
            words += f"; depends on {worst.words}: {worst.remedy}"
        if near:
            words += f"; {info.name} and {' and '.join(near)} are not separable in this log"
        if near or doubtful <= noise or noise * span > IDENTIFIED * sigma:
            words += f": {model.suggest_experiment(frozenset({info.name, *near}))}"
    elif one.given is not None:
        apart = abs(one.to_scaled(one.given) - scaled) if one.given > 0.0 or not one.logarithmic else math.inf
        if apart > max(1.96 * sigma, GIVEN * (sigma / span if span > 0.0 else 1.0)):
            verdict = "contradicts the given value"
            words += f"; the given {_told(one.given, info.unit)} lies outside of the interval"
            words += "; neither is proven wrong by this"
    if one.kind == "prior" and one.prior is not None:
        shrunk = noise * one.slope(value) / one.prior[1]
        words += f"; its prior holds it, the log adds {'little' if shrunk > 0.9 else 'to it'}" if shrunk > 0.5 else ""
    return FittedParameter(
        info.name, info.unit, value, abs(one.slope(value)) * sigma if math.isfinite(sigma) else None, low, high,
        one.kind, bound, one.given, one.source, verdict, words,  # type: ignore[arg-type]
        sigma_noise=abs(one.slope(value)) * noise if math.isfinite(noise) else None,
        sigma_model=abs(one.slope(value)) * doubtful,
    )  # fmt: skip


def _percent(one: FitParameter, sigma: float) -> str:
    if one.logarithmic:
        if 1.96 * sigma > BY_FACTOR:
            return f"a factor of {math.exp(1.96 * sigma):.2g}" if sigma < 3.0 else "no better than a factor of 300"
        return f"± {196.0 * sigma:.2g} %"
    return f"± {_told(1.96 * sigma * one.info.scale, one.info.unit, 2)}"


def combinations(
    model: Model,
    unknowns: Sequence[FitParameter],
    values: Mapping[str, float],
    covariance: Array,
    judged: Sequence[FittedParameter],
    effects: Sequence[AssumptionEffect] = (),
) -> tuple[str, ...]:
    """What is identified where single parameters are not: named combinations of the model, then eigenvectors.

    Args:
        model: what was fitted.
        unknowns: all parameters.
        values: estimates.
        covariance: of the scaled free parameters, by noise (p, p).
        judged: parameters with their verdicts.
        effects: what may be off besides; a combination may not feel it, since it goes with what is assumed, too.
    """
    poor = {one.name for one in judged if one.verdict in {"not identifiable", "weakly identified"}}
    if not poor:
        return ()
    free = [one for one in unknowns if one.kind != "fixed"]
    texts = []
    base = model.derived_quantities(values)
    slopes = {name: np.zeros(len(free)) for name in base}
    for i, one in enumerate(free):
        scaled = one.to_scaled(values[one.info.name])
        up, down = (
            model.derived_quantities({**values, one.info.name: one.to_value(scaled + step)}) for step in (1e-4, -1e-4)
        )
        for name in base:
            slopes[name][i] = (up[name][0] - down[name][0]) / 2e-4
    others = [(effect, model.derived_quantities({**values, **effect.assumption.changes})) for effect in effects]
    for name, (value, unit) in base.items():
        variance = float(slopes[name] @ covariance @ slopes[name])
        for effect, other in others:
            itself = effect.size * (other[name][0] - value) / effect.assumption.part
            variance += (float(slopes[name] @ effect.shift) + itself) ** 2
        sigma = max(variance, 0.0) ** 0.5
        touched = {free[i].info.name for i in np.flatnonzero(np.abs(slopes[name]) > 1e-12)}
        if touched & poor and sigma < 0.15 * abs(value):
            texts.append(f"{name}: {value:.4g} ± {1.96 * sigma:.2g} {unit}")
    # Directions of the scaled parameters: those of a small variance that are made of poor ones.
    index = [i for i, one in enumerate(free) if one.info.name in poor]
    if len(index) > 1:
        wide = covariance + sum(np.outer(one.shift, one.shift) for one in effects)
        values_, vectors = np.linalg.eigh(wide[np.ix_(index, index)])
        for variance, vector in zip(values_, vectors.T, strict=True):
            big = np.abs(vector) > 0.2
            if variance**0.5 < IDENTIFIED and big.sum() > 1:
                together = [(free[index[k]], float(vector[k])) for k in np.flatnonzero(big)]
                texts.append(_together(together, float(variance) ** 0.5))
    return tuple(texts)


def _told(number: float, unit: str, digits: int = 4) -> str:
    """A number with its unit; a plain one has none."""
    return f"{number:.{digits}g}" + (f" {unit}" if unit != "1" else "")


def _together(parts: Sequence[tuple[FitParameter, float]], sigma: float) -> str:
    """A direction of the scaled parameters in words: a product of powers, or a sum if one of them may be zero."""
    plain = [(one, weight) for one, weight in parts if not one.logarithmic]
    first, lead = max(plain or parts, key=lambda part: abs(part[1]))
    rest = [(one, weight / lead) for one, weight in parts if one is not first]
    sigma /= abs(lead)
    if not plain:
        powers = "".join(f" × {one.info.name}^{weight:.2g}" for one, weight in rest)
        return f"{first.info.name}{powers}: known to ± {196.0 * sigma:.2g} %"
    text, scale, unit = first.info.name, first.info.scale, first.info.unit
    for one, weight in rest:
        size = abs(weight) * scale / (1.0 if one.logarithmic else one.info.scale)
        per = unit if one.logarithmic else _over(unit, one.info.unit)
        name = f"ln({one.info.name})" if one.logarithmic else one.info.name
        text += f" {'+' if weight > 0.0 else '-'} {size:.2g} {per}{' ' if per else ''}{name}"
    return f"{text}: known to ± {_told(1.96 * sigma * scale, unit, 2)}"


def _over(unit: str, other: str) -> str:
    """A unit by another one; none if they are the same."""
    if unit == other:
        return ""
    return unit if other == "1" else f"{unit}/({other})" if " " in other or "/" in other else f"{unit}/{other}"
