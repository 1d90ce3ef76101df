"""Identification of a loop on its test bench: results of the experiments, and fits of models to them.

A step test, relay feedback and a frequency response are made on the full plant while the car drives straight. The
response to a step is the difference of two runs, so that the resistances of the car have no effect on the model.
"""

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np
import scipy  # its parts are imported when they are first used

from mirdrake.core.errors import ConfigError
from mirdrake.tuning.frequency_response import FrequencyResponse
from mirdrake.tuning.loops.base import LoopSpec
from mirdrake.tuning.models import Complexes, FirstOrder, Floats, Integrator, TransferFunction
from mirdrake.tuning.process_models import LinearProcess
from mirdrake.tuning.relay import RelayResult
from mirdrake.tuning.step_test import StepRecord

if TYPE_CHECKING:
    from mirdrake.tuning.loops.bench import PlantBench
    from mirdrake.tuning.loops.kind import Bench

ExperimentName = Literal["step_test", "relay", "frequency_response", "wheels_apart", "vehicle_data", "linear_model"]
ModelName = Literal["first_order", "integrator", "inertia", "ultimate_point"]


@dataclass(frozen=True)
class Parameter:
    """Parameter of a model.

    Attributes:
        value: its value [unit].
        unit: with u and y for the units of effort and measurement.
    """

    value: float
    unit: str


@dataclass(frozen=True)
class Experiment:
    """An experiment on a loop and the model that it gave.

    Attributes:
        name: kind of the experiment; ``wheels_apart``: frequency response of the wheels against each other.
        model: kind of the model.
        parameters: of the model, by name; empty if the experiment failed.
        fit_percent: 100 (1 - |error| / |data - mean|) [%]; None if there is no measurement to compare with.
        derivative_on: whether the derivative part of the loop was active, which a relay may need.
        error: one line; empty unless the experiment failed.
    """

    name: ExperimentName
    model: ModelName
    parameters: dict[str, Parameter] = field(default_factory=dict)
    fit_percent: float | None = None
    derivative_on: bool = False
    error: str = ""


@dataclass(frozen=True)
class Identification:
    """Result of the experiments on a loop.

    Attributes:
        loop: the loop with its reduced model.
        experiments: in their order.
        first: first order with delay, or an integrator, for the rules; None for a steering loop with little damping.
        inertial: gain [y/(u s²)] and delay [s] of a double integrator, the larger ones of both wheels together and
            against each other; only for steering loops with little damping.
        relay: None without a limit cycle.
        frequency: None if it was not measured.
        lag: time constant behind the integrator `first`, half of which is in its delay [s]; only for damped steering
            loops.
    """

    loop: LoopSpec
    experiments: tuple[Experiment, ...] = ()
    first: FirstOrder | Integrator | None = None
    inertial: tuple[float, float] | None = None
    relay: RelayResult | None = None
    frequency: FrequencyResponse | None = None
    lag: float = 0.0


def identify_loop(bench: "Bench") -> Identification:
    """Identify a loop on its bench.

    Raises:
        ConfigError: the output does not follow the effort.
        RunError: the plant could not be measured.
    """
    identification = bench.identify()
    gain = identification.loop.model.plants["main"].numerator[0] if identification.loop.model else math.nan
    if not gain > 0.0 or not math.isfinite(gain):
        raise ConfigError("the output does not follow the effort; is the loop connected?")
    return identification


def measure_step(
    bench: "PlantBench", size: float, *, duration: float, control: float = 0.0, scale: float = 1.0
) -> StepRecord:
    """Measure the response to a step of the effort as the difference of a run with and one without it.

    Args:
        bench: the bench; its loop is open.
        size: height of the step [u].
        duration: of the step [s].
        control: effort without the step [u].
        scale: factor on the output [1].
    """
    from mirdrake.tuning.loops.bench import BenchProcess  # which needs the kinds of loops, which need this module

    count = round(duration / bench.period)
    runs = []
    for effort in (control, control + size):
        process = BenchProcess(bench)
        runs.append(np.array([process.measurement, *(process(effort) for _ in range(count))]) * scale)
    time = np.arange(count + 1, dtype=float) * bench.period
    return StepRecord(time, np.asarray(runs[1] - runs[0], dtype=float), size)


def fit_inertial_step(record: StepRecord, start: tuple[float, ...]) -> tuple[TransferFunction, float]:
    """Fit ``b / (s² + a1 s + a0)`` with dead time to a step response.

    Args:
        record: the response.
        start: first guess of b, a1, a0 and the dead time [s].

    Returns:
        The model, and how well it fits [%].
    """

    def model(x: Floats) -> TransferFunction:
        # Logarithms as unknowns keep all of them positive.
        b, a1, a0, delay = np.exp(x)
        return TransferFunction((float(b),), (1.0, float(a1), float(a0)), float(min(delay, 0.5)))

    data = record.measurement - record.measurement[0]
    size = max(float(np.abs(data).max()), 1e-12)
    fit = scipy.optimize.least_squares(
        lambda x: (_simulate(record, model(x)) - data) / size, np.log(start), max_nfev=60
    )
    return model(fit.x), _fit_percent(_simulate(record, model(fit.x)), data)


def fit_response(
    response: FrequencyResponse, start: tuple[float, ...], *, order: int
) -> tuple[TransferFunction, float]:
    """Fit a transfer function of low order with dead time to a frequency response.

    The squared logarithms of the ratio of measured to modelled response are minimised, so that relative errors count
    the same at all frequencies; points with a larger deviation have a smaller weight.

    Args:
        response: the measured response.
        start: first guess of the gain b, the lower coefficients of the denominator, and the dead time [s]; all
            positive. With order 1 the second is the time constant.
        order: ``b / (s + a0)`` (1) or ``b / (s² + a1 s + a0)`` (2).

    Returns:
        The model, and how well it fits [%].
    """
    # Relative deviations of less than 2 % count as 2 %, so that single points do not dominate.
    weight = np.ones(len(response.frequencies))
    if response.deviation is not None:
        weight = 1.0 / np.maximum(response.deviation / np.abs(response.values), 0.02)
    weight = weight / weight.max()

    # Logarithms as unknowns keep gain, coefficients and dead time positive; the dead time is at most 1 s.
    def model(x: Floats) -> TransferFunction:
        values = [float(value) for value in np.exp(x)]
        if order == 1:
            return TransferFunction((values[0],), (1.0, 1.0 / values[1]), min(values[2], 1.0))
        return TransferFunction((values[0],), (1.0, values[1], values[2]), min(values[3], 1.0))

    # log(measured / model) = log ratio of magnitudes + j phase error: both parts count the same.
    def residual(x: Floats) -> Floats:
        ratio = response.values / model(x).response(response.frequencies)
        return np.asarray(np.concatenate([np.log(np.abs(ratio)) * weight, np.angle(ratio) * weight]))

    # Start within the bounds of the logarithms, also for zeros.
    begin = np.log(np.maximum(start, 1e-6))
    fit = scipy.optimize.least_squares(
        residual, begin, bounds=(np.full(len(begin), -20.0), np.full(len(begin), 20.0)), max_nfev=400
    )
    best = model(fit.x)
    return best, _fit_percent(best.response(response.frequencies), response.values)


def step_fit(record: StepRecord, model: FirstOrder | Integrator) -> float:
    """Return how well a model fits a step response [%]."""
    return _fit_percent(_simulate(record, model.transfer_function()), record.measurement - record.measurement[0])


def _simulate(record: StepRecord, model: TransferFunction) -> Floats:
    """Return the response of a model to the step of a record."""
    process = LinearProcess(model, float(record.time[1] - record.time[0]))
    return np.array([0.0, *(process(record.amplitude) for _ in range(len(record.time) - 1))])


def _fit_percent(model: Floats | Complexes, data: Floats | Complexes) -> float:
    # Normalised as in Ljung: 100 % is a perfect fit, 0 % that of the mean value.
    spread = float(np.linalg.norm(data - np.mean(data)))
    return 100.0 * (1.0 - float(np.linalg.norm(model - data)) / max(spread, 1e-300))


def simple_experiment(
    name: ExperimentName, model: FirstOrder | Integrator, *, fit_percent: float | None = None
) -> Experiment:
    """Return an experiment that gave a first-order model or an integrator."""
    if isinstance(model, Integrator):
        values = {"gain": Parameter(model.gain, "y/(u s)"), "delay": Parameter(model.delay, "s")}
        return Experiment(name, "integrator", values, fit_percent)
    values = {
        "gain": Parameter(model.gain, "y/u"),
        "time_constant": Parameter(model.time_constant, "s"),
        "delay": Parameter(model.delay, "s"),
    }
    return Experiment(name, "first_order", values, fit_percent)


def inertial_experiment(name: ExperimentName, model: TransferFunction, fit_percent: float) -> Experiment:
    """Return an experiment that gave an inertia with damping and stiffness."""
    values = {
        "gain": Parameter(model.numerator[0], "y/(u s²)"),
        "damping": Parameter(model.denominator[1], "1/s"),
        "stiffness": Parameter(model.denominator[2], "1/s²"),
        "delay": Parameter(model.delay, "s"),
    }
    return Experiment(name, "inertia", values, fit_percent)


def relay_experiment(relay: RelayResult) -> Experiment:
    """Return a relay test that gave an ultimate point."""
    values = {
        "ultimate_gain": Parameter(relay.ultimate_gain, "u/y"),
        "ultimate_period": Parameter(relay.ultimate_period, "s"),
    }
    return Experiment("relay", "ultimate_point", values)


def failed_relay(error: Exception) -> Experiment:
    """Return a relay test without a limit cycle."""
    return Experiment("relay", "ultimate_point", error=str(error))
