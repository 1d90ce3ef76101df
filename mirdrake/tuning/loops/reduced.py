"""Reduced model of a loop: identified transfer function, dead time, limits, slope of the set-point, feed-forward."""

import math
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from mirdrake.core.compiled import Records, compiled, records
from mirdrake.core.errors import ConfigError
from mirdrake.core.pid import PidGains, PidLimits
from mirdrake.tuning.loops.base import NOMINAL, Conditions, Evaluation, LoopModel, LoopSpec, OuterLoop
from mirdrake.tuning.loops.block_response import loop_of
from mirdrake.tuning.loops.judge import judge
from mirdrake.tuning.loops.reduced_kernel import KERNEL_PARTS, RunNumbers, simulate_test
from mirdrake.tuning.margins import LoopResponse, loop_range, loop_response, margins_of
from mirdrake.tuning.models import Floats, TransferFunction
from mirdrake.tuning.process_models import DiscreteMatrices, discrete_matrices
from mirdrake.tuning.spec import MARGINS
from mirdrake.tuning.stability import is_stable

OpenLoop = tuple[LoopResponse, float, float]
"""Loop transfer function, with the lowest and the highest frequency [rad/s] of its range."""

MOST_TESTS = 2000
"""Conditions whose tests on the reduced model a thread keeps."""


def pid_of(spec: LoopSpec, gains: Mapping[str, float]) -> PidGains:
    """Return the gains of a loop as those of a controller, with the loop's filter."""
    value = {spec.role(name): float(gain) for name, gain in gains.items()}
    return PidGains(value["kp"], value.get("ki", 0.0), value.get("kd", 0.0), filter_time=spec.filter_time)


def model_of(spec: LoopSpec) -> tuple[LoopModel, float]:
    """Return the model of a loop and the period of its controller [s].

    Raises:
        ConfigError: the loop has not been identified.
    """
    if spec.model is None or spec.period is None:
        raise ConfigError("the loop has no reduced model; identify it first")
    return spec.model, spec.period


def loop_plants(spec: LoopSpec) -> dict[str, TransferFunction]:
    """Return the transfer functions that a loop's own controller sees, with the speed loop around it."""
    model, _ = model_of(spec)
    outer = model.outer or OuterLoop(0.0, 0.0, 0.0)
    factor = outer_factor(model, outer.kp, outer.ki)
    return {name: plant * factor for name, plant in model.plants.items()}


def outer_factor(model: LoopModel, kp: float, ki: float) -> TransferFunction:
    """Return the factor of an outer speed loop on the transfer functions of a model, as the inner controller sees them.

    With the speed loop D = kp + ki / s around it, the controller gets r + D (r - y) - x, with the output y and the
    measurement x: the factor is that of x + D y.

    Args:
        model: the model.
        kp: of the speed loop [1].
        ki: of the speed loop [1/s].
    """
    one = TransferFunction((1.0,), (1.0,))
    measured, output = model.to_measurement(one), model.to_output(one)
    # Both factors have the same denominator.
    numerator = np.asarray(np.polyadd(measured.numerator, kp * np.array(output.numerator)), dtype=float)
    if not ki:
        return TransferFunction(tuple(map(float, numerator)), measured.denominator)
    numerator = np.asarray(np.polyadd(np.polymul(numerator, (1.0, 0.0)), ki * np.array(output.numerator)), dtype=float)
    denominator = np.polymul(measured.denominator, (1.0, 0.0))
    return TransferFunction(tuple(map(float, numerator)), tuple(map(float, denominator)))


def open_loops(spec: LoopSpec, gains: Mapping[str, float]) -> list[OpenLoop]:
    """Return the open loops of a loop with a model."""
    model, period = model_of(spec)
    if model.block is not None:
        return [(loop_of(model.block, gains), model.block.frequencies[0], model.block.frequencies[-1])]
    pid, plants = pid_of(spec, gains), loop_plants(spec).values()
    return [(loop_response(plant, pid, period=period), *loop_range(plant, pid, period=period)) for plant in plants]


def critical_loop(loops: Sequence[OpenLoop]) -> LoopResponse:
    """Return the loop with the largest Ms of some open loops, one at least."""
    return loops[0][0] if len(loops) < 2 else max(loops, key=lambda loop: margins_of(*loop).max_sensitivity)[0]


def plant_under(spec: LoopSpec, conditions: Conditions, plant: TransferFunction) -> TransferFunction:
    """Return a transfer function of a loop with the delay, and where it acts the mass, of other conditions."""
    denominator = list(plant.denominator)
    if conditions.mass != 1.0 and model_of(spec)[0].mass_acts and len(denominator) > 1:
        # Inertia is the leading coefficient: damping and stiffness do not grow with the mass.
        denominator[0] *= conditions.mass
    delay = plant.delay
    if conditions.delay is not None:
        delay = max(delay + conditions.delay - spec.delay, 0.0)
    return TransferFunction(plant.numerator, tuple(denominator), delay)


def find_loop_margins(spec: LoopSpec, gains: Mapping[str, float]) -> dict[str, float]:
    """Return the margins of the nominal loop by name, each the worst of its transfer functions; nan if undefined."""
    # Without gains there is no loop.
    if spec.model is None or not any(gains.values()):
        return dict.fromkeys(MARGINS, math.nan)
    # The same gains are tested under many conditions, which do not change the margins of the nominal loop.
    if (known := _last_margins.get(spec, gains)) is not None:
        return known
    margins = worst_margins(open_loops(spec, gains))
    _last_margins.keep(spec, gains, margins)
    return margins


def worst_margins(loops: Sequence[OpenLoop]) -> dict[str, float]:
    """Return the margins by name, each the worst of some open loops; nan if undefined."""
    rows = []
    # A loop with several transfer functions (both wheels together, and apart) has the margins of the worst.
    for loop in loops:
        computed = margins_of(*loop)
        rows.append(
            (
                # Ms and Mt are worse when larger: negated, so that the minimum is the worst for all.
                -computed.max_sensitivity,
                -computed.max_complementary,
                computed.gain_margin,
                math.degrees(computed.phase_margin),
                computed.delay_margin,
                computed.disk_margin,
            )
        )
    if not rows:
        return dict.fromkeys(MARGINS, math.nan)
    worst = [float(min(column)) for column in zip(*rows, strict=True)]
    return dict(zip(MARGINS, (-worst[0], -worst[1], *worst[2:]), strict=True))


class _LastMargins(threading.local):
    """The margins that a thread computed last, of a loop and gains."""

    def __init__(self) -> None:
        self._loop: tuple[object, ...] = ()
        self._gains: dict[str, float] = {}
        self._margins: dict[str, float] = {}

    def get(self, spec: LoopSpec, gains: Mapping[str, float]) -> dict[str, float] | None:
        """Return the margins if they are of this loop and these gains."""
        same = len(self._loop) and self._loop[0] is spec.model and self._loop[1:] == (spec.period, spec.filter_time)
        return dict(self._margins) if same and dict(gains) == self._gains else None

    def keep(self, spec: LoopSpec, gains: Mapping[str, float], margins: Mapping[str, float]) -> None:
        """Keep margins."""
        self._loop = (spec.model, spec.period, spec.filter_time)
        self._gains, self._margins = dict(gains), dict(margins)


_last_margins = _LastMargins()


@dataclass(frozen=True)
class ReducedTest:
    """What a test on the reduced model needs besides the gains.

    Attributes:
        delayed: transfer functions of the loop, with half a period for the hold of the sampled controller.
        parts: the plant over a period, from effort to measurement.
        output_row: output times scale per state.
        t: times of the samples [s].
        reference: set-point [y].
        wanted: set-point of each period, less the start, times scale.
        feedforward: control that is added [u].
        loads: part of the effort without dead time [u].
        resistances: forces on the plant that are not effort [u].
        noise: of the measurement.
        limits: of the control.
    """

    delayed: tuple[TransferFunction, ...]
    parts: DiscreteMatrices
    output_row: Floats
    t: Floats
    reference: Floats
    wanted: Floats
    feedforward: Floats
    loads: Floats
    resistances: Floats
    noise: Floats
    limits: PidLimits


def run_reduced(
    spec: LoopSpec, gains: Mapping[str, float], conditions: Conditions = NOMINAL, *, keep: bool = True
) -> Evaluation:
    """Run the test manoeuvre on the reduced model, on which friction has no effect.

    Args:
        spec: the loop.
        gains: by name.
        conditions: of the test.
        keep: whether the evaluation has the response.

    Raises:
        ConfigError: the loop has not been identified, or a gain is not valid.
    """
    pid, test = pid_of(spec, gains), reduced_test(spec, conditions)
    # A pole test first: a slowly growing oscillation may not be visible within the test.
    if any(gains.values()) and not all(is_stable(plant, pid) for plant in test.delayed):
        return Evaluation("unstable", reason="the closed loop has a pole in the right half plane")
    output, effort, stable = simulate_reduced(spec, pid, test, conditions)
    if not stable:
        return Evaluation("unstable", reason="the output grows without bound")
    return judge_test(spec, test, gains, conditions, output, effort, keep=keep)


def simulate_reduced(
    spec: LoopSpec, pid: PidGains, test: ReducedTest, conditions: Conditions
) -> tuple[Floats, Floats, bool]:
    """Simulate a test on the reduced model; return output [y], effort [u], and whether all numbers stay in bounds."""
    output, effort = np.zeros(len(test.t)), np.zeros(len(test.t))
    parts = test.parts
    stable = compiled(simulate_test, parts=KERNEL_PARTS)(
        _numbers(spec, pid, test.limits, parts, conditions),
        parts.step, parts.old, parts.new, parts.held, parts.row, test.output_row,
        test.wanted, test.feedforward, test.loads, test.resistances, test.noise, output, effort,
    )  # fmt: skip
    return output, effort, bool(stable)


def judge_test(
    spec: LoopSpec,
    test: ReducedTest,
    gains: Mapping[str, float],
    conditions: Conditions,
    output: Floats,
    effort: Floats,
    *,
    keep: bool,
    others: Mapping[str, Floats] = MappingProxyType({}),
) -> Evaluation:
    """Evaluate the response of a test on a model, see :func:`mirdrake.tuning.loops.judge.judge`."""
    return judge(
        test.t,
        test.reference,
        output,
        effort,
        course=spec.course,
        limits=test.limits,
        noise=conditions.noise / model_of(spec)[0].scale,
        margins=find_loop_margins(spec, gains),
        others=others,
        keep=keep,
    )


def _make_test(spec: LoopSpec, conditions: Conditions) -> ReducedTest:
    """Return what a test under conditions needs besides the gains."""
    model, period = model_of(spec)
    course = spec.course
    plants = {name: plant_under(spec, conditions, plant) for name, plant in model.plants.items()}
    loops = loop_plants(replace(spec, model=replace(model, plants=plants))).values()

    # Set-points and feed-forward as the control unit makes them: slope limited, from differences per period. At a
    # sample the unit has moved the set-point by one period already.
    t: Floats = np.arange(round(course.duration / period) + 1, dtype=float) * period
    reference, ahead = set_points(spec, t), set_points(spec, t + period)
    noise = np.zeros(len(t))
    if conditions.noise:
        noise = np.random.default_rng(conditions.seed).normal(0.0, conditions.noise, len(t))
    return ReducedTest(
        delayed=tuple(TransferFunction(one.numerator, one.denominator, one.delay + 0.5 * period) for one in loops),
        parts=discrete_matrices(model.to_measurement(plants["main"]), period),
        output_row=discrete_matrices(model.to_output(plants["main"]), period).row,
        t=t,
        reference=reference,
        wanted=(ahead - model.start) * model.scale,
        feedforward=model.feedforward * (ahead - reference) / period,
        # A load acts from the first period that begins after its time.
        loads=np.where(t > course.load_time - 1e-9, float(course.load), 0.0),
        # Resistances act against the drive; gravity on a grade grows with the mass.
        resistances=np.full(len(t), -model.drag - model.weight * math.sin(conditions.grade) * conditions.mass),
        noise=noise,
        limits=PidLimits() if model.limit is None else PidLimits(-model.limit, model.limit),
    )


class _Tests(threading.local):
    """Tests of loops that a thread has made: many gains are tested under the same conditions."""

    def __init__(self) -> None:
        self._made: dict[tuple[object, ...], ReducedTest] = {}

    def get(self, spec: LoopSpec, conditions: Conditions) -> ReducedTest:
        """Return the test of a loop under conditions."""
        key = (model_of(spec)[0].key, spec.period, spec.delay, spec.course, conditions)
        if key not in self._made:
            # Studies draw some hundred conditions; the limit is for other uses.
            if len(self._made) >= MOST_TESTS:
                self._made.clear()
            self._made[key] = _make_test(spec, conditions)
        return self._made[key]


_tests = _Tests()


def reduced_test(spec: LoopSpec, conditions: Conditions) -> ReducedTest:
    """Return what a test of a loop under conditions needs besides the gains."""
    return _tests.get(spec, conditions)


def _numbers(
    spec: LoopSpec, pid: PidGains, limits: PidLimits, parts: DiscreteMatrices, conditions: Conditions
) -> Records:
    """Return the numbers of a test as an array of one record."""
    model, period = model_of(spec)
    outer = model.outer or OuterLoop(0.0, 0.0, 0.0)
    numbers = RunNumbers(
        period,
        parts.whole,
        parts.through,
        model.scale,
        model.start,
        # Wheels of a smaller radius turn faster at the same speed of the car.
        radius=1.0 / (1.0 + model.radius_per_mass * (conditions.mass - 1.0)),
        is_output=model.output is None,
        outer=model.outer is not None,
        pid=pid.numbers(),
        limits=limits,
        outer_pid=PidGains(outer.kp, outer.ki).numbers(),
        outer_limits=PidLimits(-outer.limit, outer.limit),
    )
    return records(RunNumbers, [numbers])


def set_points(spec: LoopSpec, t: Floats) -> Floats:
    """Return the set-point with its limited slopes [y], shape as t."""
    model, _ = model_of(spec)
    course = spec.course
    rise, fall = (model.rise, model.fall) if course.step > 0.0 else (model.fall, model.rise)

    def moved(past: Floats, rate: float) -> Floats:
        whole = abs(course.step)
        ramp = np.minimum(rate * past, whole) if math.isfinite(rate) else np.where(past > 1e-9, whole, 0.0)
        return np.asarray(ramp, dtype=float)

    distance = moved(np.maximum(t - course.step_time, 0.0), rise)
    if course.return_time is not None:
        reached = float(moved(np.array(course.return_time - course.step_time), rise))
        back = moved(np.maximum(t - course.return_time, 0.0), fall)
        distance = np.where(t > course.return_time, np.maximum(reached - back, 0.0), distance)
    return np.asarray(model.start + math.copysign(1.0, course.step) * distance, dtype=float)
