"""Which options a model needs, where a study leaves them open.

Load transfer, a lag of the steering, tyres that relax (one length for both axles), roll of the body (where sideways
speed or acceleration are compared; its arm is assumed), a late vy, tyres that saturate.

The plain model is fitted first, then each addition in turn, from where the best fit ended and with the noise of the
first. What makes the residuals clearly smaller, and has values with a meaning, is kept.
"""

from collections import ChainMap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from mirdrake.core.constants import GRAVITY
from mirdrake.core.errors import RunError
from mirdrake.identification.data import DataSet
from mirdrake.identification.estimators.options import EstimatorOptions
from mirdrake.identification.estimators.output_error import first_noise, known_value
from mirdrake.identification.estimators.problem import Problem, transfer_states
from mirdrake.identification.estimators.segments import make_segments
from mirdrake.identification.estimators.sensitivity import SensitivityAnalysis, assumptions_of
from mirdrake.identification.estimators.solve import Minimum, finish, minimise
from mirdrake.identification.models.base import Model, ModelSpec
from mirdrake.identification.models.registry import TURNING, make_model
from mirdrake.identification.models.steer import AHEAD
from mirdrake.identification.parameters import Setting, resolve_parameters

LIMIT, GRIP = 3.0, 0.9
"""Lateral acceleration from which on tyres may be seen to saturate [m/s²]; friction of a dry road [1]."""

ALONG = 2.0
"""From braking to acceleration, where a drive has so much of both that load transfer can be told [m/s²]."""

SMOOTHING = 0.2
"""Of a speed that is differentiated for that [s]."""

KNOWN = 0.3
"""Half of the 95 % interval of a friction over its value, so that tyres may saturate: one that is known worse lets the
model spin where the vehicle did not."""

MOST = 15
"""Evaluations of an addition: one that is needed shows by then."""

PROMISE = 0.1
"""Part of what an addition must save that the slope of the cost has to promise, before it is tried."""

PASSES = 2
"""Each addition is asked so often, as long as the model changes: what hid it may be in by then."""

LAGS = (2e-3, 0.9)
"""Between which values a lag is one [s]."""

EARLY = -0.01
"""Dead time beside a lag: what is earlier is no steering, but a lag that makes up for something else [s]."""

_FREE = Setting(free=True)


class Addition(NamedTuple):
    """What a model may need.

    Attributes:
        words: what it is.
        settings: of parameters that are estimated then.
        options: of the model.
        worth: part of the cost that it must save; load transfer, which goes with the speed as much else does, more than
            others, and roll, four numbers, most.
        delay: it is tried where the dead time of the steering is longer so far [s].
        fades: parameter that loses its meaning where a later addition explains the same better: then it is dropped.
    """

    words: str
    settings: Mapping[str, Setting] = MappingProxyType({})
    options: Mapping[str, Any] = MappingProxyType({})
    worth: float = 0.01
    delay: float = -np.inf
    fades: str = ""


class Structure(NamedTuple):
    """What is to be fitted.

    Attributes:
        model: with its options.
        settings: by parameter.
        start: where the fit is best begun; None: at its guesses.
        notes: what was assumed.
    """

    model: ModelSpec
    settings: dict[str, Setting]
    start: Minimum | None = None
    notes: tuple[str, ...] = ()


def choose_structure(
    data: DataSet, model: ModelSpec, settings: Mapping[str, Setting], options: EstimatorOptions
) -> Structure:
    """Try what the study leaves open, see :func:`additions`.

    Raises:
        ConfigError: as :func:`~mirdrake.identification.estimators.fit`.
        RunError: the plain model runs away from its guess.
    """
    best = Structure(model, dict(settings))
    left_open = list(additions(data, model, settings))
    if not left_open:
        return best
    options = replace(options, bootstrap=0, profile=False)
    few = replace(options, iterations=min(options.iterations, MOST))
    least = first = _solve(data, best, options, None)
    kept: list[Addition] = []
    notes: list[tuple[str, str]] = []
    asked: dict[str, Structure] = {}
    for added in left_open * PASSES:
        if asked.get(added.words) is best or _has(best, added):
            continue
        if not least.values["steering_delay"] > added.delay:
            continue
        asked[added.words] = best
        if not _promises(data, best, least, added, options):
            continue
        wanted = [*(one for one in kept if not {*one.options} & {*added.options}), added]
        try:
            found = _solve(data, _made(model, settings, wanted), few, least)
            faded = {one.words for one in kept if _has_faded(found, one)}
            if faded:
                wanted = [one for one in wanted if one.words not in faded]
                found = _solve(data, _made(model, settings, wanted), few, least)
        except RunError:
            continue
        saves = found.cost < (1.0 - added.worth) * least.cost
        if saves and _has_meaning(found, first) and _frictions_are_known(found, options):
            saved = 100.0 * (1.0 - found.cost / least.cost)
            text = f"left open by the study, wanted by the training drives: {added.words} ({saved:.2g} % less misfit)"
            notes = [*(note for note in notes if note[0] not in faded), (added.words, text)]
            kept = wanted
            best, least = _made(model, settings, wanted), found
    return best._replace(start=least, notes=tuple(text for _, text in notes))


def _made(model: ModelSpec, settings: Mapping[str, Setting], wanted: Sequence[Addition]) -> Structure:
    """A structure with additions."""
    options, more = dict(model.options), dict(settings)
    for one in wanted:
        options |= one.options
        more |= one.settings
    return Structure(replace(model, options=options), more)


def _has_faded(found: Minimum, added: Addition) -> bool:
    """Whether an addition has lost its meaning."""
    if not added.fades:
        return False
    return found.values[added.fades] <= found.problem.model.plausible_range(added.fades, found.values)[0]


def _has(best: Structure, added: Addition) -> bool:
    """Whether a structure has an addition."""
    options = best.model.options
    return {*added.settings} <= {*best.settings} and all(
        options.get(name) == one for name, one in added.options.items()
    )


def _promises(data: DataSet, best: Structure, least: Minimum, added: Addition, options: EstimatorOptions) -> bool:
    """Whether the residuals have something of an addition, so that it is worth a fit: the score test of Rao."""
    known = {name: value for name, choice in best.settings.items() if (value := known_value(choice)) is not None}

    def remake(more: Mapping[str, Any]) -> Model:
        return make_model(replace(best.model, options={**best.model.options, **more}), data, known)

    questions = [
        assumption
        for assumption in assumptions_of(least.problem, least.z)
        if assumption.is_omitted
        and assumption.options == added.options
        and (added.options or {*assumption.changes} == {*added.settings})
    ]
    if not questions:
        return True
    ask = SensitivityAnalysis(least.problem, least.z, options, remake)
    answers = [ask.answer(assumption) for assumption in questions]
    most = PROMISE * added.worth * least.cost
    return any(one is None or 0.5 * one.estimate**2 * one.known > most for one in answers)


def additions(data: DataSet, model: ModelSpec, settings: Mapping[str, Setting]) -> Iterator[Addition]:
    """What a study leaves open, in the order in which it is tried.

    Load transfer first: what it does to the bends before which a vehicle brakes looks like a delay. The steering before
    the tyres: relaxation makes the rear axle late, too. Once more behind roll, which may hide it.

    What part of drive and braking the front wheels have is never tried: freed, the two make up for tyres that saturate.
    """
    if model.kind not in TURNING:
        return
    slips = model.kind.startswith("single_track")
    if slips and "load_transfer" not in settings and _most_along(data) > ALONG:
        yield Addition("load transfer in braking", {"load_transfer": _FREE}, worth=0.03)
    # A measured angle of the wheels has the lag of the steering in it, if it is one.
    late, measured = "steering_lag" not in settings, all("road_wheel_angle" in log.channels for log in data.logs)
    lag = Addition("a lag of the steering", {"steering_lag": _FREE}, delay=AHEAD if measured else -np.inf)
    if late and not measured:
        yield lag
    if not slips:
        return
    if "relaxation" not in model.options and not any(name.startswith("relaxation") for name in settings):
        yield Addition("tyres that relax", options={"relaxation": "shared"}, fades="relaxation")
    # A vehicle has values of roll, for a study that asks for it.
    told = "yaw_inertia" in settings and settings["yaw_inertia"].given is not None
    asked = model.options.get("outputs") or ("lateral_acceleration", "vy")
    seen = [
        name
        for name in asked
        if name in {"lateral_acceleration", "vy"} and all(name in log.channels for log in data.logs)
    ]
    if model.kind == "single_track" and "roll" not in model.options and seen and not told:
        # A sensor leans with what it is bolted to.
        of_sensor = {
            "lateral_acceleration": {
                "accelerometer_tilt": Setting(free=True, guess=1.0),
                "accelerometer_height": _FREE,
            },
            "vy": {"velocity_height": _FREE},
        }
        places = dict(ChainMap(*(of_sensor[name] for name in seen)))
        yield Addition("roll of the body", places, {"roll": True}, worth=0.1)
    if late:
        yield lag
    if len(seen) > 1 and "velocity_delay" not in settings:
        yield Addition("a vy that is late", {"velocity_delay": _FREE})
    most = _most(data)
    if "tyres" not in model.options and most > LIMIT:
        # A start below what the vehicle did lets the model spin.
        grip = Setting(free=True, guess=max(GRIP, 1.5 * most / GRAVITY))
        frictions = {name: grip for name in ("friction_front", "friction_rear") if name not in settings}
        for law in ("magic_formula", "fiala"):  # the former is straight for longer, as measured tyres are
            yield Addition(f"tyres: {law}", frictions, {"tyres": law})


def _has_meaning(found: Minimum, first: Minimum) -> bool:
    """Whether what was added has values that a vehicle can have."""
    plain, now = ({one.info.name for one in each.problem.free} for each in (first, found))
    values = found.values
    for name in now - plain:
        least, most = LAGS if name == "steering_lag" else found.problem.model.plausible_range(name, values)
        if not least < values[name] < most:
            return False
    return "steering_lag" not in now - plain or values["steering_delay"] > EARLY


def _frictions_are_known(found: Minimum, options: EstimatorOptions) -> bool:
    """Whether friction, where there is one, is known well enough to be driven with."""
    names = [one.info.name for one in found.problem.free]
    at = [i for i, name in enumerate(names) if name.startswith("friction")]
    if not at:
        return True
    sigmas = np.sqrt(np.diag(finish(found, options).covariance))
    for i in at:
        shift = np.zeros_like(found.z)
        shift[i] = 2.0 * sigmas[i]
        low, high = (found.problem.values(found.z + sign * shift)[names[i]] for sign in (-1.0, 1.0))
        if not high - low < 2.0 * KNOWN * found.values[names[i]]:
            return False
    return True


def _most(data: DataSet) -> float:
    """Lateral acceleration that the training drives reach [m/s²]."""
    most = 0.0
    for log in data.train:
        forward = log.channels.get("vx", log.channels.get("speed"))
        rate, side = log.channels.get("yaw_rate"), log.channels.get("lateral_acceleration")
        if forward is not None and rate is not None:
            side = forward * rate
        if side is not None:
            most = max(most, float(np.nanpercentile(np.abs(side), 99.0)))
    return most


def _most_along(data: DataSet) -> float:
    """From the hardest braking to the hardest acceleration in the bends of the training drives [m/s²]."""
    most = 0.0
    for log in data.train:
        forward, turn = log.channels.get("vx", log.channels.get("speed")), log.channels.get("yaw_rate")
        if forward is None:
            continue
        side = log.channels.get("lateral_acceleration") if turn is None else forward * turn
        good, step = np.isfinite(forward), float(np.median(np.diff(log.time)))
        speed = np.interp(log.time, log.time[good], forward[good])
        rate = np.gradient(gaussian_filter1d(speed, max(SMOOTHING / step, 1e-3)), step)
        if side is not None:
            size = np.abs(np.nan_to_num(side))
            rate = rate[size >= 0.3 * float(np.percentile(size, 99.0))]
        most = max(most, float(np.ptp(np.percentile(rate, (5.0, 95.0)))))
    return most


def _solve(data: DataSet, tried: Structure, options: EstimatorOptions, first: Minimum | None) -> Minimum:
    """The least cost of a structure, from an earlier one and with its noise."""
    known = {name: value for name, choice in tried.settings.items() if (value := known_value(choice)) is not None}
    made = make_model(tried.model, data, known)
    drives, _ = make_segments(made, data.train, options.shooting)
    unknowns = resolve_parameters(made.parameters, tried.settings)
    noise = first_noise(made, drives) if first is None else first.problem.sigmas
    problem = Problem(made, drives, unknowns, noise, options.offsets, options.continuity)
    if first is None:
        begun = minimise(problem, options, passes=2, close=1e-4)
        return minimise(begun.problem, options, begun.z, close=1e-4)
    values = {one.info.name: one.info.guess for one in unknowns}
    same = {one.info.name for one in first.problem.free}
    values |= {name: value for name, value in first.values.items() if name in same}
    if "steering_lag" not in same and "steering_lag" in {one.info.name for one in problem.free}:
        part = 0.3 * max(values["steering_delay"], 0.02)  # what was taken for a dead time is a lag in part
        values |= {"steering_lag": part, "steering_delay": values["steering_delay"] - part}
    z = problem.scaled(values)
    z[len(problem.free) :] = transfer_states(first.z, first.problem, problem)
    return minimise(problem, options, z, close=1e-4)
