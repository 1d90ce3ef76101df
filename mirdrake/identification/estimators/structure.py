"""Structure search: which effects a model needs, where a study leaves them open.

The plain model is fitted first, then each addition of :meth:`Model.additions` in turn, starting from the best fit so
far and with the noise of the first one. An addition that makes the residuals clearly smaller and has plausible values
is kept.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from mirdrake.core.errors import RunError
from mirdrake.identification.data import DataSet
from mirdrake.identification.estimators.options import EstimatorOptions
from mirdrake.identification.estimators.output_error import initial_noise
from mirdrake.identification.estimators.problem import Problem, transfer_states
from mirdrake.identification.estimators.segments import make_segments
from mirdrake.identification.estimators.sensitivity import SensitivityAnalysis, list_assumptions
from mirdrake.identification.estimators.solve import Minimum, assess, minimise
from mirdrake.identification.models.base import Addition, Model, ModelSpec
from mirdrake.identification.models.registry import check_options, make_model, model_class
from mirdrake.identification.parameters import Setting, known_values, resolve_parameters

MAX_FRICTION_WIDTH = 0.3
"""Half of the 95 % interval of a friction over its value, up to which saturating tyres are accepted: with a less
certain friction the model may spin where the vehicle did not."""

MAX_ITERATIONS = 15
"""Evaluations of an addition: one that is needed shows by then."""

MIN_PROMISE = 0.1
"""Share of the required saving that the gradient of the cost must promise before an addition is fitted."""

PASSES = 2
"""Passes over the additions while the model changes: an earlier effect may have hidden a later one."""

LAG_RANGE = (2e-3, 0.9)
"""Range of a plausible steering lag [s]."""

MIN_DELAY = -0.01
"""Least dead time beside a lag [s]: an earlier one means that the lag compensates for something else."""


class Structure(NamedTuple):
    """Model structure to fit.

    Attributes:
        model: kind and options.
        settings: settings by parameter.
        start: minimum from which the final fit starts; None for the guesses.
        notes: which effects were added.
    """

    model: ModelSpec
    settings: dict[str, Setting]
    start: Minimum | None = None
    notes: tuple[str, ...] = ()


def choose_structure(
    data: DataSet, model: ModelSpec, settings: Mapping[str, Setting], options: EstimatorOptions
) -> Structure:
    """Return the structure with the additions that the training logs support.

    Raises:
        ConfigError: as :func:`~mirdrake.identification.estimators.fit`.
        RunError: the plain model diverges from its guess.
    """
    best = Structure(model, dict(settings))
    candidates = list(model_class(model.kind).additions(data, check_options(model), settings))
    if not candidates:
        return best
    options = replace(options, bootstrap=0, profile=False)
    few = replace(options, iterations=min(options.iterations, MAX_ITERATIONS))
    least = first = _minimise(data, best, options, None)
    kept: list[Addition] = []
    notes: dict[str, str] = {}
    tried_on: dict[str, Structure] = {}
    for added in candidates * PASSES:
        # Skip what is in the model already, or was tried on this very model.
        if tried_on.get(added.description) is best or _has(best, added):
            continue
        if not least.values["steering_delay"] > added.delay:
            continue
        tried_on[added.description] = best
        if not _promises(data, best, least, added, options):
            continue
        additions = [*(addition for addition in kept if not {*addition.options} & {*added.options}), added]
        try:
            minimum = _minimise(data, _with_additions(model, settings, additions), few, least)
            faded = {addition.description for addition in kept if _has_faded(minimum, addition)}
            if faded:
                additions = [addition for addition in additions if addition.description not in faded]
                minimum = _minimise(data, _with_additions(model, settings, additions), few, least)
        except RunError:  # the model diverges with this effect
            continue
        saves = minimum.cost < (1.0 - added.min_saving) * least.cost
        if saves and _is_plausible(minimum, first) and _frictions_are_certain(minimum, options):
            notes = {name: note for name, note in notes.items() if name not in faded}
            notes.pop(added.description, None)
            saved = 100.0 * (1.0 - minimum.cost / least.cost)
            notes[added.description] = (
                f"left open by the study, supported by the training logs: {added.description} ({saved:.2g} % less cost)"
            )
            kept = additions
            best, least = _with_additions(model, settings, additions), minimum
    return best._replace(start=least, notes=tuple(notes.values()))


def _with_additions(model: ModelSpec, settings: Mapping[str, Setting], additions: Sequence[Addition]) -> Structure:
    options, more = dict(model.options), dict(settings)
    for addition in additions:
        options |= addition.options
        more |= addition.settings
    return Structure(replace(model, options=options), more)


def _has_faded(minimum: Minimum, added: Addition) -> bool:
    """Whether another addition has driven the parameter of this one out of its plausible range."""
    name = added.fading_parameter
    return bool(name) and minimum.values[name] <= minimum.problem.model.plausible_range(name, minimum.values)[0]


def _has(best: Structure, added: Addition) -> bool:
    """Whether a structure contains an addition."""
    options = best.model.options
    return {*added.settings} <= {*best.settings} and all(
        options.get(key) == value for key, value in added.options.items()
    )


def _promises(data: DataSet, best: Structure, least: Minimum, added: Addition, options: EstimatorOptions) -> bool:
    """Whether the residuals show traces of an addition, so that it is worth a fit: Rao's score test."""
    known = known_values(best.settings)

    def remake(more: Mapping[str, Any]) -> Model:
        return make_model(replace(best.model, options={**best.model.options, **more}), data, known)

    assumptions = [
        assumption
        for assumption in list_assumptions(least.problem, least.z)
        if assumption.is_omitted
        and assumption.options == added.options
        and (added.options or {*assumption.changes} == {*added.settings})
    ]
    if not assumptions:
        return True
    analysis = SensitivityAnalysis(least.problem, least.z, options, remake)
    threshold = MIN_PROMISE * added.min_saving * least.cost
    evidence = [analysis.evidence(assumption) for assumption in assumptions]
    return any(entry is None or 0.5 * entry.estimate**2 * entry.information > threshold for entry in evidence)


def _is_plausible(minimum: Minimum, first: Minimum) -> bool:
    """Whether the added parameters have values that a vehicle can have."""
    plain, now = ({parameter.info.name for parameter in each.problem.free} for each in (first, minimum))
    values = minimum.values
    for name in now - plain:
        least, most = LAG_RANGE if name == "steering_lag" else minimum.problem.model.plausible_range(name, values)
        if not least < values[name] < most:
            return False
    return "steering_lag" not in now - plain or values["steering_delay"] > MIN_DELAY


def _frictions_are_certain(minimum: Minimum, options: EstimatorOptions) -> bool:
    """Whether friction, if it is a free parameter, is known well enough to simulate with."""
    names = [parameter.info.name for parameter in minimum.problem.free]
    frictions = [i for i, name in enumerate(names) if name.startswith("friction")]
    if not frictions:
        return True
    sigmas = np.sqrt(np.diag(assess(minimum, options).covariance))
    for i in frictions:
        shift = np.zeros_like(minimum.z)
        shift[i] = 2.0 * sigmas[i]
        low, high = (minimum.problem.values(minimum.z + sign * shift)[names[i]] for sign in (-1.0, 1.0))
        if not high - low < 2.0 * MAX_FRICTION_WIDTH * minimum.values[names[i]]:
            return False
    return True


def _minimise(data: DataSet, structure: Structure, options: EstimatorOptions, first: Minimum | None) -> Minimum:
    """Return the minimum of a structure, starting from an earlier one and with its noise."""
    model = make_model(structure.model, data, known_values(structure.settings))
    drives, _ = make_segments(model, data.train, options.shooting)
    unknowns = resolve_parameters(model.parameters, structure.settings)
    noise = initial_noise(model, drives) if first is None else first.problem.sigmas
    problem = Problem(model, drives, unknowns, noise, options.offsets, options.continuity)
    if first is None:
        begun = minimise(problem, options, passes=2, close=1e-4)
        return minimise(begun.problem, options, begun.z, close=1e-4)
    values = {unknown.info.name: unknown.info.guess for unknown in unknowns}
    same = {parameter.info.name for parameter in first.problem.free}
    values |= {name: value for name, value in first.values.items() if name in same}
    if "steering_lag" not in same and "steering_lag" in {parameter.info.name for parameter in problem.free}:
        part = 0.3 * max(values["steering_delay"], 0.02)  # without a lag, the delay contained a part of it
        values |= {"steering_lag": part, "steering_delay": values["steering_delay"] - part}
    z = problem.scaled(values)
    z[len(problem.free) :] = transfer_states(first.z, first.problem, problem)
    return minimise(problem, options, z, close=1e-4)
