"""Sentences about fits, made from their figures."""

import math
from collections.abc import Collection, Sequence

from mirdrake.identification.estimators.experiment_design import Candidate
from mirdrake.identification.judgement import Combination, Direction, Judgement
from mirdrake.identification.parameters import FitParameter
from mirdrake.readers.units import format_unit

NOTABLE = 0.02
"""Standard deviation between logs or models from which it is named [1]."""

SHOWN = 5
"""Number of parameters named with a recommended manoeuvre."""

FACTOR = 0.5
"""Half of a 95 % interval of a logarithm above which it is written as a factor."""


def explanation(judgement: Judgement) -> str:
    """Return the reasons for a verdict."""
    parameter, info = judgement.parameter, judgement.parameter.info
    width = _width(parameter, judgement.sigma)
    usual = "" if judgement.plausible is None else "usual: {:.4g} to {:.4g}".format(*judgement.plausible)
    # The reasons are in the order of the verdicts: a bound explains everything else.
    if judgement.bound is not None:
        side, edge = ("lower", info.low) if judgement.bound == "low" else ("upper", info.high)
        text = f"is at its {side} bound of {_quantity(edge, info.unit)}"
    elif not judgement.is_certain:
        text = f"known to {width} only"
    elif judgement.is_meaningless:
        text = f"{_quantity(judgement.value, info.unit)} has no physical meaning ({usual}); "
        text += "the model is forced to fit the log"
    else:
        text = f"known to {width}"
        text += f"; unusual ({usual})" if usual and judgement.verdict != "weakly identified" else ""
    # The largest source of uncertainty is named if it matters, and an assumption that may be its cause.
    others = max(judgement.noise, judgement.by_assumptions, NOTABLE)
    if judgement.between > max(others, judgement.structures):
        text += f"; the logs or channels differ by {_width(parameter, judgement.between)}: the model lacks an effect"
    elif judgement.structures > others:
        text += f"; models that predict as well differ by {_width(parameter, judgement.structures)}"
    if judgement.depends_on is not None:
        text += f"; depends on {judgement.depends_on.description}: {judgement.depends_on.remedy}"
    if judgement.inseparable:
        text += f"; {info.name} and {' and '.join(judgement.inseparable)} are not separable in this log"
    if judgement.remedy:
        text += f"; {judgement.remedy}"
    if judgement.contradicts and parameter.given is not None:
        text += f"; the given {_quantity(parameter.given, info.unit)} lies outside of the interval"
        text += "; this proves neither wrong"
    if judgement.prior_share > 0.5:
        text += f"; its prior holds it, the log adds {'little' if judgement.prior_share > 0.9 else 'to it'}"
    return text


def uncertain_prediction(log: str, channel: str, percent: float | None) -> str:
    """Return a note that the training logs do not determine a validation log."""
    size = (
        "not at all" if percent is None or 1.96 * percent > 100.0 else f"to ± {1.96 * percent:.0f} % of its motion only"
    )
    return f"log {log}: the training logs determine its {channel} {size}; train with a manoeuvre that is as fast"


def _width(parameter: FitParameter, sigma: float) -> str:
    """Return half of a 95 % interval as text with its unit."""
    if parameter.logarithmic:
        if 1.96 * sigma > FACTOR:
            return f"a factor of {math.exp(1.96 * sigma):.2g}" if sigma < 3.0 else "no better than a factor of 300"
        return f"± {196.0 * sigma:.2g} %"
    return f"± {_quantity(1.96 * sigma * parameter.info.scale, parameter.info.unit, 2)}"


def _quantity(number: float, unit: str, digits: int = 4) -> str:
    """Return a number with its unit; a pure number has none."""
    return f"{number:.{digits}g}" + (f" {format_unit(unit)}" if unit != "1" else "")


def combination(found: Combination | Direction) -> str:
    """Return a combination of parameters and how well it is known."""
    if isinstance(found, Combination):
        return f"{found.name}: {found.value:.4g} ± {1.96 * found.sigma:.2g} {format_unit(found.unit)}"
    return direction(found)


def direction(found: Direction) -> str:
    """Return a direction of the scaled parameters: a product of powers, or a sum if one of them may be zero."""
    # A sum is needed as soon as one parameter may be zero or negative, whose logarithm does not exist.
    plain = [(parameter, weight) for parameter, weight in found.parts if not parameter.logarithmic]
    first, lead = max(plain or found.parts, key=lambda part: abs(part[1]))
    rest = [(parameter, weight / lead) for parameter, weight in found.parts if parameter is not first]
    # Normalised by the leading weight, so that the text reads as this parameter plus multiples of others.
    sigma = found.sigma / abs(lead)
    if not plain:
        powers = "".join(f" × {parameter.info.name}^{weight:.2g}" for parameter, weight in rest)
        return f"{first.info.name}{powers}: known to ± {196.0 * sigma:.2g} %"
    text, scale, unit = first.info.name, first.info.scale, first.info.unit
    for parameter, weight in rest:
        size = abs(weight) * scale / (1.0 if parameter.logarithmic else parameter.info.scale)
        per = unit if parameter.logarithmic else _ratio_unit(unit, parameter.info.unit)
        name = f"ln({parameter.info.name})" if parameter.logarithmic else parameter.info.name
        text += f" {'+' if weight > 0.0 else '-'} {size:.2g} {format_unit(per)}{' ' if per else ''}{name}"
    return f"{text}: known to ± {_quantity(1.96 * sigma * scale, unit, 2)}"


def _ratio_unit(unit: str, other: str) -> str:
    """Return a unit divided by another one; empty if they are the same."""
    if unit == other:
        return ""
    return unit if other == "1" else f"{unit}/({other})" if " " in other or "/" in other else f"{unit}/{other}"


def not_white(inflation: float) -> str:
    """Return the note of a fit whose residuals are not white.

    Args:
        inflation: largest factor on the variances by the autocorrelation [1].
    """
    return (
        "the residuals are not white: intervals are those of correlated residuals, "
        f"up to {max(inflation, 1.0) ** 0.5:.2g} times those of white ones"
    )


def recommendation(
    best: Candidate, speed: float, parameters: Sequence[FitParameter], sigmas: Sequence[float], poor: Collection[str]
) -> str:
    """Return the advice to drive a manoeuvre, and the intervals that it would give.

    Args:
        best: the manoeuvre.
        speed: highest speed [m/s].
        parameters: free parameters.
        sigmas: present standard deviations of the scaled parameters by noise [1].
        poor: names of the parameters that are not identified.
    """
    rows = sorted(zip(best.sigmas, sigmas, parameters, strict=True), key=lambda row: float(row[0] / max(row[1], 1e-12)))
    gains = [
        f"{parameter.info.name} {_width(parameter, float(after))} (now {_width(parameter, float(now))})"
        for after, now, parameter in rows
        if parameter.info.name in poor
    ]
    advice = f"next, drive '{best.name}' at up to {speed:.3g} m/s"
    return f"{advice}; expected 95 % intervals by noise: {', '.join(gains[:SHOWN])}"
