"""Output-error fit of a model to a data set: settings, least squares, intervals, verdicts, validation."""

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import pandas as pd

from mirdrake.core.errors import ConfigError, RunError
from mirdrake.identification import messages
from mirdrake.identification.channels import channel
from mirdrake.identification.data import DataSet, Log
from mirdrake.identification.estimators.consistency import Part, prior_information, split, split_by_output, variation
from mirdrake.identification.estimators.experiment_design import Candidate, rank_manoeuvres
from mirdrake.identification.estimators.options import EstimatorOptions
from mirdrake.identification.estimators.problem import Problem, transfer_states
from mirdrake.identification.estimators.profile import profiles_of
from mirdrake.identification.estimators.segments import MIN_SAMPLES, after_unknown_inputs, make_segments
from mirdrake.identification.estimators.sensitivity import assumption_effects
from mirdrake.identification.estimators.solve import Minimum, Solution, assess, minimise
from mirdrake.identification.fit import ChannelFit, Fit
from mirdrake.identification.identifiability import Uncertainty, combinations, judge
from mirdrake.identification.models.base import SPEED, Array, AssumptionEffect, Model, ModelSpec, Segment
from mirdrake.identification.models.registry import make_model
from mirdrake.identification.parameters import FitParameter, Setting, known_values, resolve_parameters
from mirdrake.identification.validation import input_correlation, noise_limit_nrmse, nrmse, whiteness

UNCERTAIN = 5.0
"""Standard deviation of a prediction by the parameters from which it is noted [%]."""


def fit(
    data: DataSet,
    model: ModelSpec,
    *,
    parameters: Mapping[str, Setting] | None = None,
    options: EstimatorOptions | None = None,
    name: str = "fit",
    start: Minimum | None = None,
    rivals: Sequence[Mapping[str, float]] = (),
) -> Fit:
    """Fit a model to the training logs of a data set and evaluate it on all of its logs.

    Args:
        data: checked logs.
        model: kind and options of the model.
        parameters: settings by name; the others are as in the model.
        options: options of the estimator.
        name: name of the study.
        start: minimum of the same model and logs to start from; None for the guesses.
        rivals: estimates by other structures that predict as well.

    Raises:
        ConfigError: the data or the settings do not allow a fit; one line per fault.
        RunError: the model diverges from its guess.
    """
    begun, options, parameters = time.perf_counter(), options or EstimatorOptions(), parameters or {}
    check_logs(data)
    known = known_values(parameters)
    made = make_model(model, data, known)
    unknowns = resolve_parameters(made.parameters, parameters)
    if all(unknown.kind == "fixed" for unknown in unknowns):
        raise ConfigError(f"all of model {made.kind} are fixed; there is nothing to fit, free one", path=["parameters"])
    drives, notes = make_segments(made, data.train, options.shooting)
    problem = Problem(made, drives, unknowns, initial_noise(made, drives), options.offsets, options.continuity)
    # Ten values per unknown at least: with fewer, the residuals show little about the noise.
    if problem.samples <= 10 * problem.size:
        text = f"{problem.samples} values for {problem.size} unknowns; record longer, or cut into longer pieces"
        raise ConfigError(text, path=("data",))
    solution = assess(_minimum(problem, options, start), options)
    effects = assumption_effects(
        solution, options, lambda more: make_model(replace(model, options={**model.options, **more}), data, known)
    )
    validated = {log.name: validate_log(log, solution, options.loss) for log in data.validation}
    between, structures = between_parts(solution, options, validated.values()), between_structures(solution, rivals)
    result = summarise(
        data, solution, unknowns, name=name, options=options, notes=notes, effects=effects, between=between,
        structures=structures, validated=validated,
    )  # fmt: skip
    return replace(result, seconds=time.perf_counter() - begun)


def _minimum(problem: Problem, options: EstimatorOptions, start: Minimum | None) -> Minimum:
    """Return the minimum over the samples that depend on recorded inputs only.

    Args:
        problem: problem with all samples and a first guess of the noise.
        options: options of the estimator.
        start: minimum of the same structure; None starts from the guesses.
    """
    found = start or minimise(problem, options, passes=3)
    # Only now are the delays and lags known that relate the first samples to inputs before the log.
    drives = after_unknown_inputs(problem.model, problem.drives, found.values)
    is_whole = all(short is drive for short, drive in zip(drives, problem.drives, strict=True))
    if is_whole and start is None:
        return found
    # The earlier minimum gives the unknowns and the noise; initial states only where the first samples are the same.
    problem = replace(problem, drives=drives)
    z = problem.scaled(found.values)
    if is_whole:
        z[len(problem.free) :] = transfer_states(found.z, found.problem, problem)
    # A start from which the model diverges is left to the optimiser, which reports it.
    if np.isfinite(problem.residuals(z)).all():
        problem = replace(problem, sigmas={key: max(sigma, 1e-9) for key, sigma in problem.spread(z).items()})
    return minimise(problem, options, z, passes=3)


class Validation(NamedTuple):
    """Validation log, with fitted offsets and initial states.

    Attributes:
        pairs: its segments, and the outputs of the model with offsets (outputs, n).
        parts: segments to first order in the parameters; empty if the model diverges.
    """

    pairs: list[tuple[Segment, Array]]
    parts: list[Part]


def validate_log(log: Log, solution: Solution, loss: str) -> Validation:
    """Return a validation log at the parameters of a fit; only what belongs to the log is estimated again."""
    problem, model = solution.problem, solution.problem.model
    values = problem.values(solution.z)
    drives = after_unknown_inputs(model, make_segments(model, (log,))[0], values)
    fixed = Problem(model, drives, _fixed(problem, values), problem.sigmas, problem.offsets)
    try:
        own = _fit_offsets(fixed)
        pairs = list(zip(drives, fixed.traces(own), strict=True))
    except (RunError, FloatingPointError):
        return Validation([(drive, np.full((len(model.outputs), drive.size), np.nan)) for drive in drives], [])
    other = replace(fixed, unknowns=problem.unknowns)
    z = np.append(other.scaled(values)[: len(problem.free)], own)
    return Validation(pairs, split(other, z, loss))


def between_parts(solution: Solution, options: EstimatorOptions, validated: Iterable[Validation] = ()) -> Array:
    """Return the standard deviation of the scaled free parameters between logs, and between outputs (p).

    Validation logs count as well: their score tests the parameters.
    """
    problem = solution.problem
    span = sum(drive.size * drive.step for drive in problem.drives)
    # A single log is cut into halves.
    parts = split(problem, solution.z, options.loss, 0.5 * span if len(problem.drives) == 1 else np.inf)
    parts += [part for one in validated for part in one.parts]
    prior = prior_information(problem)
    outputs = split_by_output(problem, solution.z, options.loss)
    return np.asarray(np.hypot(variation(parts, prior), variation(outputs, prior)), dtype=np.float64)


def between_structures(solution: Solution, rivals: Sequence[Mapping[str, float]]) -> Array:
    """Return the root mean square difference of the scaled free parameters from their estimates by other structures."""
    sizes = []
    for parameter, scaled in zip(solution.problem.free, solution.z, strict=False):
        others = [parameter.to_scaled(rival[parameter.info.name]) for rival in rivals if parameter.info.name in rival]
        sizes.append(float(np.sqrt(np.mean((np.array(others) - scaled) ** 2))) if others else 0.0)
    return np.array(sizes)


def _fit_offsets(problem: Problem) -> Array:
    """Return offsets and initial states of a problem without free parameters.

    The offsets begin at the median of the residuals. From zero, an offset of several standard deviations of the noise
    makes all samples outliers of the robust loss, whose curvature is zero there, and the fit ends before it gets there.

    Raises:
        FloatingPointError: the model diverges.
        RunError: as FloatingPointError.
    """
    return minimise(problem, EstimatorOptions(), problem.with_median_offsets(np.zeros(problem.size))).z


def _fixed(problem: Problem, values: Mapping[str, float]) -> list[FitParameter]:
    """Return the parameters of a problem, fixed to values."""
    return [
        replace(unknown, kind="fixed", prior=None, info=replace(unknown.info, guess=values[unknown.info.name]))
        for unknown in problem.unknowns
    ]


def check_logs(data: DataSet) -> None:
    """Reject data that no model can be fitted to.

    Raises:
        ConfigError: no training log, or a log without samples or with times that do not increase.
    """
    if not data.logs:
        raise ConfigError("has no log; name at least one", path=("data",))
    if not data.train:
        raise ConfigError("no log is for training; set 'use: train' at one", path=("data",))
    for log in data.logs:
        if len(log.time) == 0 or not log.channels:
            raise ConfigError(f"log {log.name}: is empty; leave it out")
        if len(log.time) < MIN_SAMPLES or not np.isfinite(log.time).all() or np.any(np.diff(log.time) < 0.0):
            raise ConfigError(f"log {log.name}: times must increase; allow the repair 'timestamps' in the data file")


def initial_noise(model: Model, drives: Sequence[Segment]) -> dict[str, float]:
    """Return a share of the range of each output, without glitches, as noise before the first fit."""
    noise = {}
    for name in model.outputs:
        values = np.concatenate([drive.outputs[name] for drive in drives])
        # A share of the range is the right order before residuals exist; percentiles keep glitches out.
        low, high = np.nanpercentile(values, (5.0, 95.0))
        noise[name] = max(0.03 * float(high - low), 1e-3 * float(np.nanstd(values)), 1e-9)
    return noise


def summarise(
    data: DataSet,
    solution: Solution,
    unknowns: Sequence[FitParameter],
    *,
    name: str,
    options: EstimatorOptions,
    notes: Sequence[str] = (),
    effects: Sequence[AssumptionEffect] = (),
    between: Array | None = None,
    structures: Array | None = None,
    validated: Mapping[str, Validation] = MappingProxyType({}),
) -> Fit:
    """Return the fit of a solution: intervals, verdicts, traces, validation."""
    problem, model = solution.problem, solution.problem.model
    values = problem.values(solution.z)
    sigmas = np.sqrt(np.diag(solution.covariance))
    # The larger of both estimates counts, as either may be too small by chance.
    if solution.draws is not None:
        sigmas = np.maximum(sigmas, 0.5 * np.ptp(np.percentile(solution.draws, (2.5, 97.5), axis=0), axis=0) / 1.96)

    # Correlations for white residuals: those of the problem itself, which do not depend on the noise of these logs.
    scale = np.where(sigmas > 0.0, sigmas, 1.0)
    own = np.sqrt(np.maximum(np.diag(solution.white), 1e-300))
    correlation = solution.white / own[:, None] / own[None, :]
    wide = (
        solution.covariance
        * np.outer(scale, scale)
        / np.outer(*(2 * [np.sqrt(np.maximum(np.diag(solution.covariance), 1e-300))]))
    )
    # Condition number of the correlations, which does not depend on the scales of the parameters.
    values_ = np.linalg.eigvalsh(correlation)
    condition = float(values_[-1] / values_[0]) if values_[0] > 1e-14 else float("inf")
    # Residuals that are far from white show an error of the model.
    uncertainty = Uncertainty(sigmas, correlation, solution.bound, effects, between, structures)
    channels, traces = evaluate_logs(data, solution, validated, uncertainty.covariance(wide))
    error = any(
        channel.part == "train" and channel.whiteness_p is not None and channel.whiteness_p < 1e-3
        for channel in channels
    )
    uncertainty = replace(uncertainty, model_error=error)
    judged = judge(model, unknowns, values, uncertainty, problem.drives)

    # Notes and advice.
    lines = [*notes]
    if error:
        lines.append(messages.not_white(float(np.max(solution.inflation))))
    assumed = [unknown.info.name for unknown in unknowns if unknown.is_assumed]
    if {"front_length", "rear_length", "mass"} & set(assumed):
        lines.append(f"assumed: {', '.join(assumed)}; give them if you know them, the others depend on them")
    lines += [unknown.info.source for unknown in unknowns if unknown.info.source.startswith("not given")]
    lines += [
        messages.uncertain_prediction(item.log, item.channel, item.prediction_sigma_percent)
        for item in channels
        if (item.prediction_sigma_percent or 0.0) > UNCERTAIN
    ]
    # A dict removes repeated advice and keeps its order. Where the error of the model dominates, another drive does
    # not help.
    advice = dict.fromkeys(
        model.suggest_experiment(frozenset({parameter.name}), problem.drives)
        for parameter in judged
        if parameter.verdict == "not identifiable"
        or (
            parameter.verdict == "weakly identified"
            and not (parameter.sigma_model or 0.0) > (parameter.sigma_noise or 0.0)
        )
    )
    is_wanted = bool(advice)
    advice.pop("", None)  # no text: the model knows no better drive
    if is_wanted and (best := recommend_manoeuvre(solution)) is not None:
        poor = {parameter.name for parameter in judged if parameter.verdict not in {"identified", "fixed"}}
        noise = np.sqrt(np.diag(solution.covariance))
        advice = {messages.recommendation(*best, problem.free, noise.tolist(), poor): None, **advice}
    profiles = profiles_of(solution, options) if options.profile else {}
    how = f"output error, {options.loss} loss"
    if options.shooting is not None:
        how += f", pieces of {options.shooting:g} s" + (" joined" if options.continuity is not None else "")
    return Fit(
        name, model.title, how, judged, correlation, condition, channels, traces, profiles,
        tuple(map(messages.combination, combinations(model, unknowns, values, wide, judged, uncertainty))),
        tuple(advice), tuple(lines), data.digest,
        versions={package: version(package) for package in ("numpy", "scipy")},
    )  # fmt: skip


def recommend_manoeuvre(solution: Solution) -> tuple[Candidate, float] | None:
    """Return the manoeuvre that would shrink the intervals most and its speed [m/s]; None if none can be compared."""
    problem, model = solution.problem, solution.problem.model
    speeds = [drive.channels(name) for drive in problem.drives for name in SPEED if name in drive.names]
    # Proposed speeds stay within those that were driven.
    top = max((float(np.nanpercentile(values, 98.0)) for values in speeds), default=0.0)
    if top < 0.2:
        return None
    values = problem.values(solution.z)
    if not model.candidate_manoeuvres(values, top):
        return None
    try:
        known = np.asarray(np.linalg.inv(solution.covariance), dtype=np.float64)
    except np.linalg.LinAlgError:
        return None
    ranked = rank_manoeuvres(model, problem.unknowns, values, problem.sigmas, known=known, speed=top)
    best = next((candidate for candidate in ranked if np.isfinite(candidate.d_gain)), None)
    return None if best is None else (best, top)


def evaluate_logs(
    data: DataSet, solution: Solution, validated: Mapping[str, Validation], covariance: Array
) -> tuple[tuple[ChannelFit, ...], dict[str, pd.DataFrame]]:
    """Return fits and traces of all logs.

    Args:
        data: logs.
        solution: fit to the training logs.
        validated: validation logs by name.
        covariance: covariance of the scaled free parameters by all causes (p, p).
    """
    model, problem = solution.problem.model, solution.problem
    channels: list[ChannelFit] = []
    traces: dict[str, pd.DataFrame] = {}
    for log in data.logs:
        sizes: list[float | None] = [None] * len(model.outputs)
        if log.use == "train":
            runs = problem.traces(solution.z)
            pairs = [(drive, run) for drive, run in zip(problem.drives, runs, strict=True) if drive.log == log.name]
        else:
            pairs = validated[log.name].pairs
            sizes = prediction_deviations(validated[log.name], problem, covariance)
        if pairs:
            channels += [
                replace(entry, prediction_sigma_percent=size)
                for entry, size in zip(_fits(model, log, pairs), sizes, strict=True)
            ]
            traces[log.name] = _trace(model, pairs)
    return tuple(channels), traces


def prediction_deviations(validation: Validation, problem: Problem, covariance: Array) -> list[float | None]:
    """Return the standard deviation of each output of a validation log by the parameters, over that of its values [%].

    It is the root mean square over the log of D C Dᵀ, for the covariance C of the parameters and the derivatives D of
    the outputs, in which offsets and initial states follow the parameters. None if the model diverges.

    Args:
        validation: validation log.
        problem: problem of the fit.
        covariance: covariance of the scaled free parameters by all causes (p, p).
    """
    if not validation.parts:
        return [None] * len(problem.model.outputs)
    slopes = np.concatenate([part.slopes for part in validation.parts])
    sizes: list[float | None] = []
    for i, name in enumerate(problem.model.outputs):
        variance = float(np.mean(np.einsum("np,pq,nq->n", slopes[:, i], covariance, slopes[:, i])))
        motion = float(np.nanstd(np.concatenate([drive.outputs[name] for drive, _ in validation.pairs])))
        # A channel without motion has no fit either.
        size = 100.0 * problem.sigmas[name] * max(variance, 0.0) ** 0.5 / motion if motion > 0.0 else np.nan
        sizes.append(size if np.isfinite(size) else None)
    return sizes


def _fits(model: Model, log: Log, pairs: Sequence[tuple[Segment, Array]]) -> list[ChannelFit]:
    fits = []
    for i, name in enumerate(model.outputs):
        seen = np.concatenate([drive.outputs[name] for drive, _ in pairs])
        shown = np.concatenate([run[i] for _, run in pairs])
        off = seen - shown
        inputs = [np.concatenate([drive.inputs[key] for drive, _ in pairs]) for key in model.inputs]
        # The noise limit is an estimate; what a model reached, the noise allows.
        reached = nrmse(seen, shown)
        limit = float(np.fmax(noise_limit_nrmse(seen), reached))
        fits.append(
            ChannelFit(
                log.name, log.use, name, channel(name).unit, reached, limit,  # type: ignore[arg-type]
                float(np.sqrt(np.nanmean(off**2))) if np.isfinite(off).any() else float("nan"),
                whiteness(off), input_correlation(off, inputs),
            )
        )  # fmt: skip
    return fits


def _trace(model: Model, pairs: Sequence[tuple[Segment, Array]]) -> pd.DataFrame:
    columns: dict[str, Array] = {"t": np.concatenate([drive.time for drive, _ in pairs])}
    for i, name in enumerate(model.outputs):
        columns[name] = np.concatenate([drive.outputs[name] for drive, _ in pairs])
        columns[f"{name}_model"] = np.concatenate([run[i] for _, run in pairs])
    return pd.DataFrame(columns)
