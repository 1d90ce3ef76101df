"""Identification of a loop on the full plant: step test, relay feedback and frequency response, and what follows.

The car runs straight and even. Step and free run are subtracted, so that what drags the car is not in the model. In the
frequency response the loop is closed by gains that any car stands: a speed loop of 1 rad/s from the mass, a steering
loop by SIMC from the inertia and the damping of the joint. A motor behind a gear damps its joint so that torque gives
speed, not acceleration: where that lag is shorter than the delay, the rules see an integrator, else a double one.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy  # which imports its parts when they are first named

from mirdrake.core.constants import GRAVITY
from mirdrake.core.errors import ConfigError, MirdrakeError, RunError
from mirdrake.tuning.frequency_response import FrequencyResponse, measure_frequency_response
from mirdrake.tuning.loops.base import Conditions, LoopSpec
from mirdrake.tuning.loops.bench import BenchLoop, BenchProcess, PlantBench
from mirdrake.tuning.models import FirstOrder, Floats, Integrator, TransferFunction
from mirdrake.tuning.processes import LinearProcess
from mirdrake.tuning.relay import RelayResult, run_relay_test
from mirdrake.tuning.rules import simc, simc_double_integrator
from mirdrake.tuning.step_test import StepRecord, fit_first_order, fit_integrator

FAST = 1.0
"""Bandwidth of the speed loop that is closed for the experiments [rad/s]."""


@dataclass(frozen=True)
class Model:
    """A model of a loop.

    Attributes:
        name: of the experiment.
        kind: in words.
        parameters: value and unit, by name.
        fit_percent: 100 (1 - |error| / |data - mean|); nan if there is nothing to compare with.
        note: a sentence.
    """

    name: str
    kind: str
    parameters: dict[str, tuple[float, str]]
    fit_percent: float = math.nan
    note: str = ""


@dataclass(frozen=True)
class Identified:
    """What the experiments found.

    Attributes:
        spec: the loop, with its reduced model.
        models: of each experiment.
        first: first order with delay, or an integrator, for the rules; None for a steering loop with little damping.
        inertial: gain [y/(u s²)] and delay [s] of a double integrator, the larger ones of the two wheels together and
            against each other; steering loops with little damping only.
        relay: None where there is no limit cycle.
        frequency: None where it was not measured.
        lag: time constant behind the integrator `first`, which counts it as half of it in its delay [s]; damped
            steering loops only.
    """

    spec: LoopSpec
    models: tuple[Model, ...]
    first: FirstOrder | Integrator | None = None
    inertial: tuple[float, float] | None = None
    relay: RelayResult | None = None
    frequency: FrequencyResponse | None = field(default=None)
    lag: float = 0.0


def identify_loop(bench: PlantBench) -> Identified:
    """Identify a loop on its bench.

    Raises:
        RunError: the plant could not be measured.
    """
    if bench.spec.options["pedals"]:
        return _pedals(bench)
    spec = _with_facts(bench)
    bench.spec = spec
    return _steering(bench, spec) if spec.kind == "steering" else _wheels(bench, spec)


def _with_facts(bench: PlantBench) -> LoopSpec:
    """The loop with what its vehicle says: slope and feed-forward of the set-point, limits, scales."""
    spec, part, plant = bench.spec, bench.part, bench.assembly.parts.plant
    limit = bench.limits.maximum
    options: dict[str, Any] = {**spec.options, "limit": limit if math.isfinite(limit) else None}
    if spec.kind == "steering":
        options |= {"slope": part.vehicle.geometry.steering_rate, "scale": 1.0}
        return replace(spec, options=options)
    mass = plant.CalcTotalMass(plant.CreateDefaultContext(), [part.instance])
    driven, radius = len(part.vehicle.spec.driven_wheels()), bench.radius
    per = 1.0 if spec.kind == "wheel_speed" else 1.0 / radius
    limits = part.vehicle.control.speed
    slope = 1.0 if spec.kind == "speed" else 1.0 / radius
    options |= {
        "scale": per,
        "per_speed": 1.0 / radius,
        "slope": limits.max_acceleration * slope,
        "slope_down": limits.max_deceleration * slope,
        "push": mass * radius / driven * (1.0 if spec.kind == "speed" else radius),
        "weight": mass * GRAVITY * radius / driven,
    }
    return replace(spec, options=options)


# --- wheels and car ----------------------------------------------------------------------------------------------


def _wheels(bench: PlantBench, spec: LoopSpec) -> Identified:
    scale, push = float(spec.options["scale"]), float(spec.options["push"])
    inertia = push / scale if spec.kind == "wheel_speed" else push * bench.radius  # torque per slope of the wheel speed
    hold = {"kp": FAST * inertia, "ki": 0.0, "kd": 0.0}
    limit = bench.limits.maximum

    # What drags the car: the torque that holds it.
    rest = BenchProcess(bench, hold)
    for _ in range(round(8.0 / bench.period)):
        rest(0.0)
    drag, even = bench.control_value(rest.context), rest.measurement * scale
    spec = replace(spec, options={**spec.options, "drag": drag})

    # Step: with and without, subtracted.
    size, duration = 0.1 * limit, 6.0
    free, pushed = BenchProcess(bench), BenchProcess(bench)
    count = round(duration / bench.period)
    free_run = np.array([free.measurement, *(free(drag) for _ in range(count))]) * scale
    run = np.array([pushed.measurement, *(pushed(drag + size) for _ in range(count))]) * scale
    record = StepRecord(np.arange(count + 1, dtype=float) * bench.period, np.asarray(run - free_run, dtype=float), size)
    models = []
    step: FirstOrder | Integrator
    try:
        step = fit_first_order(record)
    except RunError:
        step = fit_integrator(record)
    models.append(_model("step test", step, fit=_step_fit(record, step)))

    # Relay, about the torque that holds the car.
    relay, process = None, BenchProcess(bench)
    try:
        relay = run_relay_test(
            lambda control: process(control) * scale,
            period=bench.period,
            amplitude=0.2 * limit,
            reference=process.measurement * scale,
            measurement=process.measurement * scale,
            control=drag,
            duration=15.0,
            tolerance=0.1,
        )
        models.append(_relay_model(relay))
    except MirdrakeError as error:
        models.append(Model("relay", "ultimate point", {}, note=str(error)))

    # Frequency response in closed loop.
    loop = BenchLoop(bench, hold, rest=(drag, even / scale))
    top = min(0.4 * math.pi / bench.period, 4.0 / (spec.nominal["delay"] + bench.period))
    wanted = np.geomspace(0.5, top, 14)
    found = measure_frequency_response(
        lambda e: _scaled(loop.step(e), scale),
        period=bench.period,
        frequencies=wanted,
        amplitude=0.1 * limit,
        cycles=2,
        settle=1,
    )
    start = (2.0 / inertia, 2.0, spec.nominal["delay"] + bench.period)
    main, fit = fit_response(found, start, order=1)
    first = FirstOrder(main.numerator[0] / main.denominator[1], 1.0 / main.denominator[1], main.delay)
    models.append(_model("frequency response", first, fit=fit))
    return Identified(_with_model(spec, main), tuple(models), _usable(first), None, relay, found)


def _usable(first: FirstOrder) -> FirstOrder | Integrator:
    """A lag so slow that nobody saw its end counts as an integrator."""
    slow = first.time_constant > 100.0 * max(first.delay, 1e-3)
    return Integrator(first.gain / first.time_constant, first.delay) if slow else first


def _scaled(pair: tuple[float, float], scale: float) -> tuple[float, float]:
    return pair[0], pair[1] * scale


def _pedals(bench: PlantBench) -> Identified:
    """Pedals, from the data of the vehicle.

    The law turns an acceleration into pedals through the powertrain's own curves, so that what is left is an integrator
    behind the lag and delay of the actuators.
    """
    spec, control = bench.spec, bench.part.vehicle.control
    throttle = bench.part.vehicle.spec.actuators.throttle
    delay = spec.nominal["delay"] + throttle.delay + bench.period
    main = TransferFunction((1.0,), (max(throttle.time_constant, 1e-3), 1.0, 0.0), delay)
    first = Integrator(1.0, delay + throttle.time_constant)
    options = {
        **spec.options,
        "scale": 1.0,
        "slope": control.speed.max_acceleration,
        "slope_down": control.speed.max_deceleration,
        "push": 1.0,
        "limit": None,
        "weight": GRAVITY,
    }
    spec = replace(spec, options=options)
    bench.spec = spec
    note = "from the data of the vehicle: its law cancels mass, resistance and pedal maps"
    return Identified(_with_model(spec, main), (replace(_model("vehicle data", first), note=note),), first)


# --- steering ----------------------------------------------------------------------------------------------------


def _steering(bench: PlantBench, spec: LoopSpec) -> Identified:
    plant, joint = bench.assembly.parts.plant, bench.part.steering[0]
    context = bench.context(dict.fromkeys(spec.gains, 0.0), Conditions())
    matrix = plant.CalcMassMatrix(plant.GetMyContextFromRoot(context))
    at = int(joint.velocity_start())
    inertia, damping = float(matrix[at, at]), float(joint.default_damping())
    delay = spec.nominal["delay"] + 1.5 * bench.period
    if damping * delay > inertia:
        hold = simc(Integrator(1.0 / damping, delay + 0.5 * inertia / damping))
        gains, start = {"kp": hold.kp, "ki": 0.0, "kd": 0.0}, (1.0 / inertia, damping / inertia, 1.0, delay)
    else:
        hold = simc_double_integrator(1.0 / inertia, delay)
        gains, start = {"kp": hold.kp - hold.ki * delay, "ki": 0.0, "kd": hold.kd}, (1.0 / inertia, 0.5, 1.0, delay)
    size = 0.5 * hold.kp * float(spec.course["step"])

    # Step of the torque of both joints, with and without, subtracted.
    count = round(1.0 / bench.period)
    free, pushed = BenchProcess(bench), BenchProcess(bench)
    free_run = np.array([free.measurement, *(free(0.0) for _ in range(count))])
    run = np.array([pushed.measurement, *(pushed(size) for _ in range(count))])
    record = StepRecord(np.arange(count + 1, dtype=float) * bench.period, np.asarray(run - free_run, dtype=float), size)
    step, fit = _fit_inertial_step(record, start)
    models = [_inertial_model("step test", step, fit)]

    relay, process = None, BenchProcess(bench, {**gains, "kp": 0.0})
    note = "with the derivative part of the loop on, which a relay needs" if gains["kd"] else ""
    try:
        relay = run_relay_test(
            process, period=bench.period, amplitude=size, reference=0.0, duration=15.0, tolerance=0.1, refine=False
        )
        models.append(replace(_relay_model(relay), note=note))
    except MirdrakeError as error:
        models.append(Model("relay", "ultimate point", {}, note=str(error)))

    # Both wheels the same way, and against each other: the road ties them to the car in other ways.
    wanted = np.geomspace(1.0, min(0.3 * math.pi / bench.period, 3.0 / delay), 12)
    fits = []
    for name, apart in (("frequency response", False), ("wheels against each other", True)):
        loop = BenchLoop(bench, gains, apart=apart)
        found = measure_frequency_response(
            loop.step, period=bench.period, frequencies=wanted, amplitude=size, cycles=3, settle=1
        )
        main, fit = fit_response(found, start, order=2)
        fits.append((found, main))
        models.append(_inertial_model(name, main, fit))
    (found, main), (_, apart_model) = fits
    spec = _with_model(spec, main, apart=apart_model)
    gain, rate, late = (
        max(main.numerator[0], apart_model.numerator[0]),
        min(main.denominator[1], apart_model.denominator[1]),
        max(main.delay, apart_model.delay),
    )
    if rate * late > 1.0:
        speed = max(model.numerator[0] / model.denominator[1] for model in (main, apart_model))
        first = Integrator(speed, late + 0.5 / rate)
        return Identified(spec, tuple(models), first, None, relay, found, lag=1.0 / rate)
    return Identified(spec, tuple(models), None, (gain, late), relay, found)


def _fit_inertial_step(record: StepRecord, start: tuple[float, ...]) -> tuple[TransferFunction, float]:
    """``b / (s² + a1 s + a0)`` with dead time that follows a step best."""
    period = float(record.time[1] - record.time[0])

    def model(x: Floats) -> TransferFunction:
        b, a1, a0, late = np.exp(x)
        return TransferFunction((float(b),), (1.0, float(a1), float(a0)), float(min(late, 0.5)))

    def follow(x: Floats) -> Floats:
        process = LinearProcess(model(x), period)
        return np.array([0.0, *(process(record.amplitude) for _ in range(len(record.time) - 1))])

    data = record.measurement - record.measurement[0]
    size = max(float(np.abs(data).max()), 1e-12)
    fit = scipy.optimize.least_squares(lambda x: (follow(x) - data) / size, np.log(start), max_nfev=60)
    return model(fit.x), _percent(follow(fit.x), data)


# --- both --------------------------------------------------------------------------------------------------------


def fit_response(found: FrequencyResponse, start: tuple[float, ...], *, order: int) -> tuple[TransferFunction, float]:
    """A transfer function of low order with dead time that follows a frequency response.

    The sum of the squared logarithms of measured over modelled response is made small, so that a part counts the same
    wherever it stands; points with more deviation count less.

    Args:
        found: the response.
        start: gain b, the lower coefficients of the denominator, and the dead time [s], to begin with; all positive.
            With order 1 the second is the time constant.
        order: ``b / (s + a0)`` (1) or ``b / (s² + a1 s + a0)`` (2).

    Returns:
        The model, and how well it fits [%].
    """
    weight = np.ones(len(found.frequencies))
    if found.deviation is not None:
        weight = 1.0 / np.maximum(found.deviation / np.abs(found.values), 0.02)
    weight = weight / weight.max()

    def model(x: Floats) -> TransferFunction:
        values = [float(value) for value in np.exp(x)]
        if order == 1:
            return TransferFunction((values[0],), (1.0, 1.0 / values[1]), min(values[2], 1.0))
        return TransferFunction((values[0],), (1.0, values[1], values[2]), min(values[3], 1.0))

    def gap(x: Floats) -> Floats:
        ratio = found.values / model(x).response(found.frequencies)
        return np.asarray(np.concatenate([np.log(np.abs(ratio)) * weight, np.angle(ratio) * weight]))

    first = list(start)
    if order == 1:
        first[0] = start[0] / 2.0
    begin = np.log(np.maximum(first, 1e-6))
    fit = scipy.optimize.least_squares(
        gap, begin, bounds=(np.full(len(begin), -20.0), np.full(len(begin), 20.0)), max_nfev=400
    )
    best = model(fit.x)
    return best, _percent(best.response(found.frequencies), found.values)


def _percent(model: Any, data: Any) -> float:
    spread = float(np.linalg.norm(data - np.mean(data)))
    return 100.0 * (1.0 - float(np.linalg.norm(model - data)) / max(spread, 1e-300))


def _step_fit(record: StepRecord, model: FirstOrder | Integrator) -> float:
    period = float(record.time[1] - record.time[0])
    process = LinearProcess(model.transfer_function(), period)
    follow = np.array([0.0, *(process(record.amplitude) for _ in range(len(record.time) - 1))])
    return _percent(follow, record.measurement - record.measurement[0])


def _with_model(spec: LoopSpec, main: TransferFunction, **others: TransferFunction) -> LoopSpec:
    data = {
        name: {"numerator": list(model.numerator), "denominator": list(model.denominator), "delay": model.delay}
        for name, model in {"main": main, **others}.items()
    }
    return replace(spec, models=data)


def _model(name: str, model: FirstOrder | Integrator, *, fit: float = math.nan) -> Model:
    if isinstance(model, Integrator):
        return Model(name, "integrator with delay", {"gain": (model.gain, "y/(u s)"), "delay": (model.delay, "s")}, fit)
    values = {
        "gain": (model.gain, "y/u"),
        "time_constant": (model.time_constant, "s"),
        "delay": (model.delay, "s"),
    }
    return Model(name, "first order with delay", values, fit)


def _inertial_model(name: str, model: TransferFunction, fit: float) -> Model:
    values = {
        "gain": (model.numerator[0], "y/(u s²)"),
        "damping": (model.denominator[1], "1/s"),
        "stiffness": (model.denominator[2], "1/s²"),
        "delay": (model.delay, "s"),
    }
    return Model(name, "inertia with damping, stiffness and delay", values, fit)


def _relay_model(relay: RelayResult) -> Model:
    values = {"ultimate_gain": (relay.ultimate_gain, "u/y"), "ultimate_period": (relay.ultimate_period, "s")}
    return Model("relay", "ultimate point", values)


def check_identified(found: Identified) -> None:
    """Refuse a loop through which nothing goes.

    Raises:
        ConfigError: the output does not follow the effort.
    """
    gain = found.spec.models["main"]["numerator"][0]
    if not gain > 0.0 or not math.isfinite(gain):
        raise ConfigError("the output does not follow the effort; is the loop connected?")
