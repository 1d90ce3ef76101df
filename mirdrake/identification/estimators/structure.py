"""Structure search: which effects a model needs, where a study leaves them open.

The plain model is fitted first, then each addition of :meth:`Model.additions` in turn, starting from the best fit so
far and with its noise. An addition is kept if its values are plausible and if it predicts parts of the
logs better that it was not fitted to (:func:`~mirdrake.identification.estimators.consistency.cross_validate`), by
more than the standard error over the parts allows for chance (M. Stone, Cross-validatory choice, J. R. Statist. Soc. B
36, 1974; the rule of standard errors is that of L. Breiman and others, Classification and Regression Trees, 1984).

Structures that predict as well as the best one, within a standard error, are not excluded by the logs. The scatter of
their estimates is a part of the uncertainty (D. Draper, Assessment and propagation of model uncertainty, J. R. Statist.
Soc. B 57, 1995).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from mirdrake.core.errors import RunError
from mirdrake.identification.data import DataSet
from mirdrake.identification.estimators.consistency import cross_validate
from mirdrake.identification.estimators.options import EstimatorOptions
from mirdrake.identification.estimators.output_error import initial_noise
from mirdrake.identification.estimators.problem import Problem, transfer_states
from mirdrake.identification.estimators.segments import make_segments
from mirdrake.identification.estimators.sensitivity import SensitivityAnalysis, list_assumptions
from mirdrake.identification.estimators.solve import Minimum, inverse, minimise
from mirdrake.identification.models.base import Addition, Array, Model, ModelSpec
from mirdrake.identification.models.registry import check_options, make_model, model_class
from mirdrake.identification.parameters import Setting, known_values, resolve_parameters

STANDARD_ERRORS = 1.5
"""Standard errors by which an addition must predict better [1]."""

MAX_ITERATIONS = 15
"""Evaluations of an addition: one that is needed shows by then."""

PROMISE = 2.0
"""Gain of twice the log-likelihood that the gradient must promise before an addition is fitted [1]."""

EXCLUDED = 2.0
"""Standard deviations from which on the logs exclude a value [1]."""

ROUNDS = 6
"""Largest number of additions, one a round: an earlier effect may have hidden a later one."""


class Structure(NamedTuple):
    """Model structure to fit.

    Attributes:
        model: kind and options.
        settings: settings by parameter.
        start: minimum from which the final fit starts; None for the guesses.
        notes: which effects were added.
        rivals: estimates by the structures that predict as well as the best one, itself included, within its standard
            error: each a mapping of its free parameters.
    """

    model: ModelSpec
    settings: dict[str, Setting]
    start: Minimum | None = None
    notes: tuple[str, ...] = ()
    rivals: tuple[Mapping[str, float], ...] = ()


def choose_structure(
    data: DataSet, model: ModelSpec, settings: Mapping[str, Setting], options: EstimatorOptions
) -> Structure:
    """Return the structure with the additions that the training logs support.

    Raises:
        ConfigError: as :func:`~mirdrake.identification.estimators.fit`.
        RunError: the plain model diverges from its guess.
    """
    best = Structure(model, dict(settings))
    # Nothing is tried where the study or the model leaves nothing open.
    candidates = list(model_class(model.kind).additions(data, check_options(model), settings))
    if not candidates:
        return best
    options = replace(options, bootstrap=0, profile=False)
    few = replace(options, iterations=min(options.iterations, MAX_ITERATIONS))
    best_fit = first = _minimise(data, best, options, None)
    # Costs are comparable for the same outputs only: an effect such as roll does not add the channels that it has.
    model = replace(model, options={**model.options, "outputs": list(first.problem.model.outputs)})
    costs = cross_validate(best_fit, options.loss)
    tried = [(best_fit, costs)]
    accepted: list[Addition] = []
    shares: dict[str, float] = {}
    for turn in range(ROUNDS):
        # What the gradient promises most is tried first: similar effects, as lag and relaxation, exclude one another.
        # A lag or a tyre law that is missing makes all others misleading, so they are tried before and after them.
        for added in _promising(data, best, best_fit, candidates, options, nonlinear_first=turn == 0):
            # An addition replaces one that sets the same option, such as another tyre law.
            additions = [*(addition for addition in accepted if not {*addition.options} & {*added.options}), added]
            minimum = _best_start(data, _with_additions(model, settings, additions), few, best_fit, added.starts)
            # An effect that the new one drives to where it vanishes is left out again.
            odd = set() if minimum is None else {*_implausible(minimum)}
            faded = [addition for addition in additions[:-1] if {*addition.settings, *addition.options} & odd]
            if faded:
                additions = [addition for addition in additions if addition not in faded]
                minimum = _best_start(data, _with_additions(model, settings, additions), few, best_fit, ())
            # Values that no vehicle has show that the effect imitates another one; as far as the plain model has them,
            # they are excused.
            if minimum is None or not _is_excused(_implausible(minimum), _implausible(first)):
                continue
            own = cross_validate(minimum, options.loss)
            tried.append((minimum, own))
            if predicts_better(costs, own):
                # Only the additions that are still there keep their note.
                shares = {addition.description: shares.get(addition.description, 0.0) for addition in additions}
                shares[added.description] = 100.0 * float(1.0 - np.sum(own) / np.sum(costs))
                accepted, best = additions, _with_additions(model, settings, additions)
                # The noise of a model that lacks the effect would hide further ones in the same output.
                problem = replace(minimum.problem, sigmas=minimum.problem.spread(minimum.z))
                best_fit = minimise(problem, few, minimum.z, close=1e-4)
                costs = cross_validate(best_fit, options.loss)
                tried = [(best_fit, costs)]
                break
        else:
            break
    # Without one of the effects another may do as well: whether it is needed shows only beside all others.
    for added in accepted:
        fewer = [addition for addition in accepted if addition is not added]
        minimum = _best_start(data, _with_additions(model, settings, fewer), few, best_fit, ())
        if minimum is not None:
            tried.append((minimum, cross_validate(minimum, options.loss)))
    notes = tuple(
        f"not specified by the study, added because the training logs support it: {name} "
        f"({gain:.2g} % less cost of prediction)"
        for name, gain in shares.items()
    )
    return best._replace(start=best_fit, notes=notes, rivals=rivals_of(tried))


def rivals_of(tried: Sequence[tuple[Minimum, Array]]) -> tuple[dict[str, float], ...]:
    """Return the free parameters of the structures that predict as well as the best one.

    Args:
        tried: minima with their costs of prediction by part.
    """
    _, least = min(tried, key=lambda trial: float(np.sum(np.log(trial[1]))))
    return tuple(
        {parameter.info.name: minimum.values[parameter.info.name] for parameter in minimum.problem.free}
        for minimum, costs in tried
        if float(np.sum(gains(least, costs))) >= -standard_error(gains(least, costs))
    )


def gains(plain: Array, added: Array) -> Array:
    """Return the logarithms of the costs of prediction without an effect over those with it (parts).

    Half of it times the number of samples is the gain of the log-likelihood where each part has its own variance: the
    misfit of a model grows with the motion, and one lively part would decide a sum of costs.
    """
    return np.log(plain) - np.log(added)


def standard_error(gain: Array) -> float:
    """Return the standard error of the sum of gains over parts, which are taken as independent."""
    return float(np.std(gain, ddof=1)) * len(gain) ** 0.5 if len(gain) > 1 else 0.0


def predicts_better(plain: Array, added: Array) -> bool:
    """Return whether costs of prediction (parts) are less by enough standard errors."""
    gain = gains(plain, added)
    return float(np.sum(gain)) > STANDARD_ERRORS * standard_error(gain)


def _best_start(
    data: DataSet, trial: Structure, options: EstimatorOptions, best_fit: Minimum, starts: Sequence[Mapping[str, float]]
) -> Minimum | None:
    """Return the least of the minima from several starts; None if the model diverges from all."""
    minima = []
    for start in ({}, *starts):
        try:
            minima.append(_minimise(data, trial, options, best_fit, start))
        except RunError:  # the model diverges with this effect
            continue
    return min(minima, key=lambda minimum: minimum.cost, default=None)


def _with_additions(model: ModelSpec, settings: Mapping[str, Setting], additions: Sequence[Addition]) -> Structure:
    options, more = dict(model.options), dict(settings)
    for addition in additions:
        options |= addition.options
        more |= addition.settings
    return Structure(replace(model, options=options), more)


def _has(best: Structure, added: Addition) -> bool:
    """Whether a structure contains an addition."""
    options = best.model.options
    return {*added.settings} <= {*best.settings} and all(
        options.get(key) == value for key, value in added.options.items()
    )


def _promising(
    data: DataSet,
    best: Structure,
    minimum: Minimum,
    candidates: Sequence[Addition],
    options: EstimatorOptions,
    *,
    nonlinear_first: bool,
) -> list[Addition]:
    """Return the additions of which the residuals show traces, the clearest first: Rao's score test.

    Effects that the gradient does not show come first or last.
    """
    known = known_values(best.settings)

    def remake(more: Mapping[str, Any]) -> Model:
        return make_model(replace(best.model, options={**best.model.options, **more}), data, known)

    omitted = [assumption for assumption in list_assumptions(minimum.problem, minimum.z) if assumption.is_omitted]
    analysis = SensitivityAnalysis(minimum.problem, minimum.z, options, remake)
    promises: list[tuple[float, Addition]] = []
    for added in candidates:
        own = [
            assumption
            for assumption in omitted
            if assumption.options == added.options and (added.options or {*assumption.changes} == {*added.settings})
        ]
        # q̂² times its information is the score statistic: the gain that a linear fit would have.
        evidence = [entry for assumption in own if (entry := analysis.evidence(assumption)) is not None]
        gain = max((entry.estimate**2 * entry.information for entry in evidence), default=0.0 if omitted else np.inf)
        is_possible = added.is_nonlinear and bool(own or added.options)
        if not _has(best, added) and (is_possible or gain > PROMISE):
            promises.append(((np.inf if nonlinear_first else 0.0) if added.is_nonlinear else gain, added))
    return [added for _, added in sorted(promises, key=lambda entry: -entry[0])]


def _implausible(minimum: Minimum) -> dict[str, float]:
    """Return the free parameters whose values no vehicle can have, and how far their scaled values are out of range.

    The logs must exclude the range: a parameter that they do not determine, as the friction of tyres that do not
    saturate, has any value.
    """
    values, out = minimum.values, {}
    for parameter, sigma in zip(minimum.problem.free, standard_deviations(minimum), strict=True):
        name = parameter.info.name
        low, high = minimum.problem.model.plausible_range(name, values)
        if not low < values[name] < high:
            end = low if values[name] <= low else high
            distance = abs(parameter.to_scaled(values[name]) - parameter.to_scaled(end))
            if distance > EXCLUDED * sigma:
                out[name] = distance
    return out


def standard_deviations(minimum: Minimum) -> Array:
    """Return the standard deviations of the scaled free parameters (p), for white noise of the size of the problem."""
    jacobian, count = minimum.problem.jacobian(minimum.z), len(minimum.problem.free)
    return np.asarray(np.sqrt(np.diag(inverse(jacobian.T @ jacobian))[:count]))


def _is_excused(implausible: Mapping[str, float], plain: Mapping[str, float]) -> bool:
    """Whether no value is further out of range than in the plain model."""
    return all(distance <= plain.get(name, -1.0) for name, distance in implausible.items())


def _minimise(
    data: DataSet,
    structure: Structure,
    options: EstimatorOptions,
    first: Minimum | None,
    factors: Mapping[str, float] = MappingProxyType({}),
) -> Minimum:
    """Return the minimum of a structure, starting from an earlier one times factors, and with its noise."""
    model = make_model(structure.model, data, known_values(structure.settings))
    drives, _ = make_segments(model, data.train, options.shooting)
    unknowns = resolve_parameters(model.parameters, structure.settings)
    # The noise of the best structure so far serves all others, so that their costs can be compared.
    noise = initial_noise(model, drives) if first is None else first.problem.sigmas
    problem = Problem(model, drives, unknowns, noise, options.offsets, options.continuity)
    if first is None:
        begun = minimise(problem, options, passes=2, close=1e-4)
        return minimise(begun.problem, options, begun.z, close=1e-4)
    values = {unknown.info.name: unknown.info.guess for unknown in unknowns}
    same = {parameter.info.name for parameter in first.problem.free}
    # Start from the earlier minimum where parameters are common, so that few iterations suffice.
    values |= {name: value for name, value in first.values.items() if name in same}
    if "steering_lag" not in same and "steering_lag" in {parameter.info.name for parameter in problem.free}:
        part = 0.3 * max(values["steering_delay"], 0.02)  # without a lag, the delay contained a part of it
        values |= {"steering_lag": part, "steering_delay": values["steering_delay"] - part}
    # Other starting points are multiples of the guesses, within the bounds.
    for name, factor in factors.items():
        info = next((parameter.info for parameter in problem.free if parameter.info.name == name), None)
        if info is not None:
            values[name] = min(max(factor * values[name], 1.001 * info.low), 0.999 * info.high)
    z = problem.scaled(values)
    z[len(problem.free) :] = transfer_states(first.z, first.problem, problem)
    return minimise(problem, options, z, close=1e-4)
