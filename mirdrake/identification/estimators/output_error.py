"""The fit of a model to a data set: settings, least squares, intervals, verdicts, held-out fits."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version

import numpy as np
import pandas as pd

from mirdrake.core.errors import ConfigError, RunError
from mirdrake.identification.channels import channel
from mirdrake.identification.data import DataSet, Log
from mirdrake.identification.estimators.experiment_design import lists_manoeuvres, rank_manoeuvres
from mirdrake.identification.estimators.options import EstimatorOptions
from mirdrake.identification.estimators.problem import Problem, transfer_states
from mirdrake.identification.estimators.profile import profiles_of
from mirdrake.identification.estimators.segments import LEAST, make_segments
from mirdrake.identification.estimators.sensitivity import assumption_effects
from mirdrake.identification.estimators.solve import Minimum, Solution, minimise, solve
from mirdrake.identification.fit import ChannelFit, Fit
from mirdrake.identification.identifiability import combinations, judge
from mirdrake.identification.models.base import Array, AssumptionEffect, Model, ModelSpec, Segment
from mirdrake.identification.models.registry import make_model
from mirdrake.identification.models.single_track import SPEED
from mirdrake.identification.parameters import FitParameter, Setting, resolve_parameters
from mirdrake.identification.validation import input_correlation, noise_limit_nrmse, nrmse, whiteness


def fit(
    data: DataSet,
    model: ModelSpec,
    *,
    parameters: Mapping[str, Setting] | None = None,
    options: EstimatorOptions | None = None,
    name: str = "fit",
    start: Minimum | None = None,
) -> Fit:
    """Fit a model to the training logs of a data set and try it on all of its logs.

    Args:
        data: checked drives.
        model: which model.
        parameters: settings by name; those left out are as the model has them.
        options: how to fit.
        name: of the study.
        start: an end of the same model and logs from which the search begins; None: the guesses.

    Raises:
        ConfigError: the data or the settings cannot give a fit; one line per fault.
        RunError: the model runs away from its guess.
    """
    begun, options, parameters = time.perf_counter(), options or EstimatorOptions(), parameters or {}
    check_logs(data)
    known = {key: value for key, choice in parameters.items() if (value := known_value(choice)) is not None}
    made = make_model(model, data, known)
    unknowns = resolve_parameters(made.parameters, parameters)
    if all(one.kind == "fixed" for one in unknowns):
        raise ConfigError(f"parameters: all of model {made.kind} are fixed; there is nothing to fit, free one")
    drives, notes = make_segments(made, data.train, options.shooting)
    problem = Problem(made, drives, unknowns, first_noise(made, drives), options.offsets, options.continuity)
    if problem.samples <= 10 * problem.size:
        raise ConfigError(
            f"data: {problem.samples} values for {problem.size} unknowns; record longer, or cut into longer pieces"
        )
    z = None
    if start is not None:
        z = problem.scaled(start.values)
        z[len(problem.free) :] = transfer_states(start.z, start.problem, problem)
        if np.isfinite(problem.residuals(z)).all():
            problem = replace(problem, sigmas={key: max(sigma, 1e-9) for key, sigma in problem.spread(z).items()})
    solution = solve(problem, options, z)
    effects = assumption_effects(
        solution, options, lambda more: make_model(replace(model, options={**model.options, **more}), data, known)
    )
    result = describe(data, solution, unknowns, name=name, options=options, notes=notes, effects=effects)
    return replace(result, seconds=time.perf_counter() - begun)


def known_value(choice: Setting) -> float | None:
    """The number that a choice says before a fit."""
    numbers = (choice.fixed, choice.guess, choice.given, choice.prior[0] if choice.prior else None)
    return next((number for number in numbers if number is not None), None)


def check_logs(data: DataSet) -> None:
    """Refuse what no model can be fitted to.

    Raises:
        ConfigError: no training log, or one without samples or with times that do not rise.
    """
    if not data.logs:
        raise ConfigError("data: has no log; name at least one")
    if not data.train:
        raise ConfigError("data: no log is for training; set 'use: train' at one")
    for log in data.logs:
        if len(log.time) == 0 or not log.channels:
            raise ConfigError(f"log {log.name}: is empty; leave it out")
        if len(log.time) < LEAST or not np.isfinite(log.time).all() or np.any(np.diff(log.time) < 0.0):
            raise ConfigError(f"log {log.name}: times must rise; allow the repair 'stamps' in the data file")


def first_noise(model: Model, drives: Sequence[Segment]) -> dict[str, float]:
    """A part of what each output moves, glitches left aside: noise before the first fit."""
    found = {}
    for name in model.outputs:
        values = np.concatenate([drive.outputs[name] for drive in drives])
        low, high = np.nanpercentile(values, (5.0, 95.0))
        found[name] = max(0.03 * float(high - low), 1e-3 * float(np.nanstd(values)), 1e-9)
    return found


def describe(
    data: DataSet,
    solution: Solution,
    unknowns: Sequence[FitParameter],
    *,
    name: str,
    options: EstimatorOptions,
    notes: Sequence[str] = (),
    effects: Sequence[AssumptionEffect] = (),
) -> Fit:
    """From a solution to a fit: intervals, verdicts, traces, held-out fits."""
    problem, model = solution.problem, solution.problem.model
    values = problem.values(solution.z)
    sigmas = np.sqrt(np.diag(solution.covariance))
    if solution.draws is not None:
        sigmas = np.maximum(sigmas, 0.5 * np.ptp(np.percentile(solution.draws, (2.5, 97.5), axis=0), axis=0) / 1.96)
    scale = np.where(sigmas > 0.0, sigmas, 1.0)
    own = np.sqrt(np.maximum(np.diag(solution.white), 1e-300))
    correlation = solution.white / own[:, None] / own[None, :]
    wide = (
        solution.covariance
        * np.outer(scale, scale)
        / np.outer(*(2 * [np.sqrt(np.maximum(np.diag(solution.covariance), 1e-300))]))
    )
    values_ = np.linalg.eigvalsh(correlation)
    condition = float(values_[-1] / values_[0]) if values_[0] > 1e-14 else float("inf")
    channels, traces = evaluate_logs(data, solution)
    error = any(one.part == "train" and one.whiteness_p is not None and one.whiteness_p < 1e-3 for one in channels)
    judged = judge(model, unknowns, values, sigmas, correlation, solution.bound, effects=effects, model_error=error)
    told = [*notes]
    if error:
        most = float(np.max(solution.inflation))
        told.append(
            "the residuals are not white: intervals are those of correlated residuals, "
            f"up to {max(most, 1.0) ** 0.5:.2g} times those of white ones"
        )
    assumed = [one.info.name for one in unknowns if one.is_assumed]
    if {"front_length", "rear_length", "mass"} & set(assumed):
        told.append(f"assumed: {', '.join(assumed)}; give them if you know them, the others depend on them")
    told += [one.info.source for one in unknowns if one.info.source.startswith("not given")]
    advice = dict.fromkeys(
        model.suggest_experiment(frozenset({one.name}))
        for one in judged
        if one.verdict in {"not identifiable", "weakly identified"}
        and not (one.sigma_model or 0.0) > (one.sigma_noise or 0.0)
    )
    if advice:
        advice = dict.fromkeys([*advice, *recommend_manoeuvre(solution)])
    profiles = profiles_of(solution, options) if options.profile else {}
    how = f"output error, {options.loss} loss"
    if options.shooting is not None:
        how += f", pieces of {options.shooting:g} s" + (" joined" if options.continuity is not None else "")
    return Fit(
        name, model.title, how, judged, correlation, condition, channels, traces, profiles,
        combinations(model, unknowns, values, wide, judged, effects), tuple(advice), tuple(told), data.digest,
        versions={package: version(package) for package in ("numpy", "scipy")},
    )  # fmt: skip


def recommend_manoeuvre(solution: Solution) -> list[str]:
    """The manoeuvre that would shrink the intervals most, in a sentence; none for models without a list of them."""
    problem, model = solution.problem, solution.problem.model
    speeds = [drive.channels(name) for drive in problem.drives for name in SPEED if name in drive.names]
    if not speeds or not lists_manoeuvres(model):
        return []
    top = max(float(np.nanpercentile(values, 98.0)) for values in speeds)
    if top < 0.2:
        return []
    try:
        known = np.asarray(np.linalg.inv(solution.covariance), dtype=np.float64)
    except np.linalg.LinAlgError:
        return []
    values = problem.values(solution.z)
    ranked = rank_manoeuvres(model, problem.unknowns, values, problem.sigmas, known=known, speed=top)
    best = next((one for one in ranked if np.isfinite(one.d_gain)), None)
    if best is None:
        return []
    return [
        f"of the standard manoeuvres at up to {top:.3g} m/s, '{best.name}' would help most: standard deviations "
        f"would be {best.d_gain:.2g} times those of now, in the mean"
    ]


def evaluate_logs(data: DataSet, solution: Solution) -> tuple[tuple[ChannelFit, ...], dict[str, pd.DataFrame]]:
    """Fits of all logs with the parameters found: of the held-out ones only offsets and first states are estimated."""
    model, problem = solution.problem.model, solution.problem
    channels: list[ChannelFit] = []
    traces: dict[str, pd.DataFrame] = {}
    values = problem.values(solution.z)
    fixed = [
        replace(one, kind="fixed", prior=None, info=replace(one.info, guess=values[one.info.name]))
        for one in problem.unknowns
    ]
    for log in data.logs:
        if log.use == "train":
            runs = problem.traces(solution.z)
            pairs = [(drive, run) for drive, run in zip(problem.drives, runs, strict=True) if drive.log == log.name]
        else:
            pairs = simulate_validation(model, log, fixed, problem)
        if pairs:
            channels += _fits(model, log, pairs)
            traces[log.name] = _trace(model, pairs)
    return tuple(channels), traces


def simulate_validation(
    model: Model, log: Log, unknowns: Sequence[FitParameter], problem: Problem
) -> list[tuple[Segment, Array]]:
    """Drives of a log and what the model shows, from fitted first states and offsets."""
    drives, _ = make_segments(model, (log,))
    again = Problem(model, drives, unknowns, problem.sigmas, problem.offsets)
    try:
        z = minimise(again, EstimatorOptions(iterations=20)).z
        return list(zip(drives, again.traces(z), strict=True))
    except (RunError, FloatingPointError):
        return [(drive, np.full((len(model.outputs), drive.size), np.nan)) for drive in drives]


def _fits(model: Model, log: Log, pairs: Sequence[tuple[Segment, Array]]) -> list[ChannelFit]:
    found = []
    for i, name in enumerate(model.outputs):
        seen = np.concatenate([drive.outputs[name] for drive, _ in pairs])
        shown = np.concatenate([run[i] for _, run in pairs])
        off = seen - shown
        inputs = [np.concatenate([drive.inputs[key] for drive, _ in pairs]) for key in model.inputs]
        found.append(
            ChannelFit(
                log.name, log.use, name, channel(name).unit, nrmse(seen, shown), noise_limit_nrmse(seen),  # type: ignore[arg-type]
                float(np.sqrt(np.nanmean(off**2))) if np.isfinite(off).any() else float("nan"),
                whiteness(off), input_correlation(off, inputs),
            )
        )  # fmt: skip
    return found


def _trace(model: Model, pairs: Sequence[tuple[Segment, Array]]) -> pd.DataFrame:
    columns: dict[str, Array] = {"t": np.concatenate([drive.time for drive, _ in pairs])}
    for i, name in enumerate(model.outputs):
        columns[name] = np.concatenate([drive.outputs[name] for drive, _ in pairs])
        columns[f"{name}_model"] = np.concatenate([run[i] for _, run in pairs])
    return pd.DataFrame(columns)
