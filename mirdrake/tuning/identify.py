"""Identification of a loop on its test bench: results of the experiments, and fits of models to them.

A step test, relay feedback and a frequency response are made on the full plant while the car drives straight. The
response to a step is the difference of two runs, so that the resistances of the car have no effect on the model.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
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

LEAST_DEVIATION = 0.02
"""Relative error of a model's response that does not matter."""

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
        lag: time constant behind `first`, half of which is in its delay [s]; only for damped steering loops.
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
    model = identification.loop.model
    gain = 1.0 if model is None else model.plants["main"].numerator[0]
    if not gain > 0.0 or not math.isfinite(gain):
        raise ConfigError("the output does not follow the effort; is the loop connected?")
    return identification


def measure_step(bench: "PlantBench", size: float, *, duration: float, control: float = 0.0) -> StepRecord:
    """Measure the response to a step of the effort as the difference of a run with and one without it.

    Args:
        bench: the bench; its loop is open.
        size: height of the step [u].
        duration: of the step [s].
        control: effort without the step [u].
    """
    from mirdrake.tuning.loops.bench import BenchProcess  # which needs the kinds of loops, which need this module

    count = round(duration / bench.period)
    runs = []
    for effort in (control, control + size):
        process = BenchProcess(bench)
        runs.append(np.array([process.measurement, *(process(effort) for _ in range(count))]))
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

    # Logarithms as unknowns keep gain, coefficients and dead time positive; the dead time is at most 1 s.
    def model(x: Floats) -> TransferFunction:
        values = [float(value) for value in np.exp(x)]
        if order == 1:
            return TransferFunction((values[0],), (1.0, 1.0 / values[1]), min(values[2], 1.0))
        return TransferFunction((values[0],), (1.0, values[1], values[2]), min(values[3], 1.0))

    # Start within the bounds of the logarithms, also for zeros.
    begin = np.log(np.maximum(start, 1e-6))
    fit = scipy.optimize.least_squares(
        lambda x: _log_ratio(response, model(x)),
        begin,
        bounds=(np.full(len(begin), -20.0), np.full(len(begin), 20.0)),
        max_nfev=400,
    )
    best = model(fit.x)
    return best, response_fit(response, best)


def fit_joint(response: FrequencyResponse, start: tuple[float, ...]) -> tuple[TransferFunction, float]:
    """Fit an inertia with damping and stiffness, ``b / (s² + a1 s + a0)`` with dead time, to a frequency response.

    The stiffness is that of a spring which relaxes, ``a0 (s + z) / (s + p)``, if the data are evidence (Schwarz's
    criterion, as in :func:`fit_factors`): a rolling tyre resists a turn by the deflection of its patch, which fades as
    it rolls.

    Args:
        response: from a torque to an angle.
        start: first guess of b, a1, a0 and the dead time [s].

    Returns:
        The model, and how well it fits [%].
    """
    plain, _ = fit_response(response, start, order=2)

    def model(x: Floats) -> TransferFunction:
        b, a1, a0, z, p, delay = (float(value) for value in np.exp(x))
        return TransferFunction((b, b * p), (1.0, a1 + p, a1 * p + a0, a0 * z), min(delay, 1.0))

    lowest, highest = float(response.frequencies[0]), float(response.frequencies[-1])
    fits = []
    # The misfit has several minima over the rate of the relaxation.
    for rate in np.geomspace(lowest, highest, 6)[1:-1]:
        b, a1, _, delay = start
        begin = np.log([b, a1, a1 * rate, 0.3 * rate, rate, delay])
        fit = scipy.optimize.least_squares(
            lambda x: _log_ratio(response, model(x)), begin, bounds=(begin - 5.0, begin + 5.0), max_nfev=200
        )
        fits.append((float(np.sum(fit.fun**2)), fit.x))
    misfit, best = min(fits, key=lambda pair: pair[0])
    before, data = float(np.sum(_log_ratio(response, plain) ** 2)), 2 * len(response.frequencies)
    chosen = plain if before - misfit < 2 * math.log(data) * LEAST_DEVIATION**2 else model(best)
    return chosen, response_fit(response, chosen)


def fit_factors(
    responses: Sequence[FrequencyResponse], plain: TransferFunction
) -> tuple[TransferFunction, tuple[TransferFunction, ...]]:
    """Extend a first-order model ``b / (s + a)`` with dead time by a factor per response, if the data are evidence.

    The factors ``(p s² + q wp s + wp²) / (s² + 2 zp wp s + wp²)`` have the same poles and are 1 at low frequencies: a
    body on springs, which moves with the load of its wheels. Their parameters have to lower Schwarz's criterion
    (G. Schwarz, Estimating the dimension of a model, Annals of Statistics 6 (1978) 461).

    Args:
        responses: from one control to one or several signals.
        plain: the model that was fitted to them, of order 1.

    Returns:
        The model, and the factors; they are 1 if the plain model is sufficient.
    """
    count = len(responses)

    # Logarithms of b, time constant, dead time, wp and zp; then p and q of each factor.
    def model(x: Floats) -> tuple[TransferFunction, tuple[TransferFunction, ...]]:
        b, time, delay, wp, zp = (float(value) for value in np.exp(x[:5]))
        below = (1.0, 2.0 * zp * wp, wp**2)
        factors = [TransferFunction((float(p), float(q) * wp, wp**2), below) for p, q in x[5:].reshape(count, 2)]
        return TransferFunction((b,), (1.0, 1.0 / time), min(delay, 1.0)), tuple(factors)

    def residual(x: Floats) -> Floats:
        main, factors = model(x)
        return np.concatenate(
            [_log_ratio(response, main * factor) for response, factor in zip(responses, factors, strict=True)]
        )

    lowest, highest = (float(responses[0].frequencies[index]) for index in (1, -2))
    start = np.log([plain.numerator[0], 1.0 / max(plain.denominator[1], 1e-6), max(plain.delay, 1e-4)])
    fits = []
    # The misfit has several minima over the frequency of the poles.
    for centre in np.geomspace(lowest, highest, 6)[1:-1]:
        begin = np.array([*start, math.log(centre), math.log(0.3), *([1.0, 0.6] * count)])
        span = np.array([1.0, 5.0, 1.0, 2.0, 2.0, *([5.0] * 2 * count)])
        fit = scipy.optimize.least_squares(residual, begin, bounds=(begin - span, begin + span), max_nfev=100)
        fits.append((float(np.sum(fit.fun**2)), fit.x))
    misfit, best = min(fits, key=lambda pair: pair[0])
    before = sum(float(np.sum(_log_ratio(response, plain) ** 2)) for response in responses)
    # RSS / σ² + k log(n) has to fall with the new parameters.
    data = 2 * count * len(responses[0].frequencies)
    if before - misfit < (2 + 2 * count) * math.log(data) * LEAST_DEVIATION**2:
        return plain, (TransferFunction((1.0,), (1.0,)),) * count
    return model(best)


def slow_model(main: TransferFunction, factor: TransferFunction) -> TransferFunction:
    """Return a first-order model with the dead time that equals a lagging factor, of static gain 1, at low frequencies.

    A lag T has the phase -ω T there, as a dead time T has. A lead does not make the dead time shorter at the
    frequencies where that limits the loop, so it is neglected. Rules for simple models assume that all dynamics that
    are faster than the loop are in the dead time (S. Skogestad, Journal of Process Control 13 (2003) 291, section 2).
    """
    if len(factor.denominator) < 2:
        return main
    lag = factor.denominator[-2] / factor.denominator[-1] - factor.numerator[-2] / factor.numerator[-1]
    return replace(main, delay=main.delay + max(lag, 0.0))


def response_fit(response: FrequencyResponse, model: TransferFunction) -> float:
    """Return how well a model fits a frequency response [%]."""
    return _fit_percent(model.response(response.frequencies), response.values)


def _log_ratio(response: FrequencyResponse, model: TransferFunction) -> Floats:
    """Return the logarithm of measured over modelled response, real and imaginary parts, weighted by its deviation."""
    # Smaller deviations count as the least one, so that single points do not dominate.
    weight = np.ones(len(response.frequencies))
    if response.deviation is not None:
        weight = 1.0 / np.maximum(response.deviation / np.abs(response.values), LEAST_DEVIATION)
    weight = weight / weight.max()
    # log(measured / model) = log ratio of magnitudes + j phase error: both parts count the same.
    ratio = response.values / model.response(response.frequencies)
    return np.asarray(np.concatenate([np.log(np.abs(ratio)) * weight, np.angle(ratio) * weight]))


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
    """Return an experiment that gave an inertia with damping and stiffness, of a spring that relaxes or not."""
    damping, stiffness, relaxation = model.denominator[1], model.denominator[2], {}
    if len(model.numerator) > 1:  # of fit_joint
        rate = model.numerator[1] / model.numerator[0]
        damping -= rate
        stiffness -= damping * rate
        relaxation = {"relaxation_time": Parameter(1.0 / rate, "s")}
    values = {
        "gain": Parameter(model.numerator[0], "y/(u s²)"),
        "damping": Parameter(damping, "1/s"),
        "stiffness": Parameter(stiffness, "1/s²"),
        **relaxation,
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
