"""Reduced model of a loop: identified transfer function, dead time, limits, slope of the set-point, feed-forward."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mirdrake.core.errors import ConfigError
from mirdrake.core.pid import PidGains, PidLimits, PidState, pid_step
from mirdrake.tuning.loops.base import NOMINAL, Conditions, Evaluation, LoopModel, LoopSpec
from mirdrake.tuning.loops.block_response import loop_of
from mirdrake.tuning.loops.judge import judge
from mirdrake.tuning.margins import LoopResponse, loop_range, loop_response, margins_of
from mirdrake.tuning.models import Floats, TransferFunction
from mirdrake.tuning.process_models import LinearProcess
from mirdrake.tuning.spec import MARGINS
from mirdrake.tuning.stability import is_stable


def pid_of(spec: LoopSpec, gains: Mapping[str, float]) -> PidGains:
    """Return the gains of a loop as those of a controller, with the loop's filter."""
    value = {spec.role(name): float(gain) for name, gain in gains.items()}
    return PidGains(value["kp"], value["ki"], value.get("kd", 0.0), filter_time=spec.filter_time)


def model_of(spec: LoopSpec) -> tuple[LoopModel, float]:
    """Return the model of a loop and the period of its controller [s].

    Raises:
        ConfigError: the loop has not been identified.
    """
    if spec.model is None or spec.period is None:
        raise ConfigError("the loop has no reduced model; identify it first")
    return spec.model, spec.period


def loop_plants(spec: LoopSpec) -> dict[str, TransferFunction]:
    """Return the transfer functions that a loop's own controller sees, with the speed loop around it.

    With the speed loop, the controller gets r + D (r - y) - y = (1 + D) (r - y), with D = kp + ki / s.
    """
    model, _ = model_of(spec)
    if model.outer is None:
        return model.plants
    kp, ki = model.outer.kp, model.outer.ki
    factor = TransferFunction((1.0 + kp, ki), (1.0, 0.0)) if ki else TransferFunction((1.0 + kp,), (1.0,))
    return {name: plant * factor for name, plant in model.plants.items()}


def open_loops(spec: LoopSpec, gains: Mapping[str, float]) -> list[tuple[LoopResponse, float, float]]:
    """Return the open loops of a loop, each with the lowest and the highest frequency [rad/s] of its range."""
    model, period = model_of(spec)
    if model.block is not None:
        return [(loop_of(model.block, gains), model.block.frequencies[0], model.block.frequencies[-1])]
    pid, plants = pid_of(spec, gains), loop_plants(spec).values()
    return [(loop_response(plant, pid, period=period), *loop_range(plant, pid, period=period)) for plant in plants]


def critical_loop(spec: LoopSpec, gains: Mapping[str, float]) -> LoopResponse:
    """Return the open loop with the largest Ms of a loop."""
    loops = open_loops(spec, gains)
    # Without gains there is no loop to compare.
    return (
        loops[0][0]
        if len(loops) < 2 or not any(gains.values())
        else max(loops, key=lambda loop: margins_of(*loop).max_sensitivity)[0]
    )


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
    rows = []
    # A loop with several transfer functions (both wheels together, and apart) has the margins of the worst.
    for loop in open_loops(spec, gains):
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
    worst = [min(column) for column in zip(*rows, strict=True)]
    return dict(zip(MARGINS, (-worst[0], -worst[1], *worst[2:]), strict=True))


def run_reduced(spec: LoopSpec, gains: Mapping[str, float], conditions: Conditions = NOMINAL) -> Evaluation:
    """Run the test manoeuvre on the reduced model, on which friction has no effect.

    Raises:
        ConfigError: the loop has not been identified, or a gain is not valid.
    """
    model, period = model_of(spec)
    pid, course = pid_of(spec, gains), spec.course
    plants = {name: plant_under(spec, conditions, plant) for name, plant in model.plants.items()}
    # A pole test first: a slowly growing oscillation may not be visible within the test.
    if any(gains.values()):
        for plant in loop_plants(replace(spec, model=replace(model, plants=plants))).values():
            # Half a period stands for the hold of the sampled controller.
            held = TransferFunction(plant.numerator, plant.denominator, plant.delay + 0.5 * period)
            if not is_stable(held, pid):
                return Evaluation("unstable", reason="the closed loop has a pole in the right half plane")

    # Inputs of the simulation, a value per period.
    t: Floats = np.arange(round(course.duration / period) + 1, dtype=float) * period
    reference = set_points(spec, t)
    # Set-points and feed-forward as the control unit makes them: slope limited, from differences per period.
    feedforward = model.feedforward * (np.diff(reference, prepend=reference[0]) / period)
    # Resistances act against the drive; gravity on a grade grows with the mass.
    loads = np.full(len(t), -model.drag)
    loads[t >= course.load_time - 1e-9] += course.load
    loads -= model.weight * math.sin(conditions.grade) * conditions.mass
    noise = np.zeros(len(t))
    if conditions.noise:
        noise = np.random.default_rng(conditions.seed).normal(0.0, conditions.noise, len(t))
    limits = PidLimits() if model.limit is None else PidLimits(-model.limit, model.limit)

    # Deviations of the measurement from the start.
    process, state, value = LinearProcess(plants["main"], period), PidState(), 0.0
    rows: list[tuple[float, float]] = []
    start, outer, trim_state = reference[0], model.outer, PidState()

    # All values are deviations from the start in units of the measurement (scale).
    for k, wanted in enumerate(((reference - start) * model.scale).tolist()):
        # The outer loop, the speed control, corrects the set-point; its gains are those of control.yaml.
        if outer is not None:
            trim_state, trim = pid_step(
                trim_state, wanted / model.scale, value / model.scale, gains=PidGains(outer.kp, outer.ki),
                period=period, limits=PidLimits(-outer.limit, outer.limit),
            )  # fmt: skip
            wanted += trim * model.scale
        state, control = pid_step(
            state, wanted, value + noise[k], gains=pid, period=period, limits=limits, feedforward=float(feedforward[k])
        )
        # Written so that NaN counts as unstable.
        if not (abs(value) < 1e9 and abs(control) < 1e12):
            return Evaluation("unstable", reason="the output grows without bound")
        # Control and output before the process moves on, as the plant logs them.
        rows.append((value, control))
        value = process(control + loads[k])
    output, effort = np.array(rows).T
    return judge(
        t,
        reference,
        output / model.scale + start,
        effort,
        course=course,
        limits=limits,
        noise=conditions.noise / model.scale,
        margins=find_loop_margins(spec, gains),
    )


def set_points(spec: LoopSpec, t: Floats) -> Floats:
    """Return the set-point with its limited slope [y], shape as t."""
    model, period = model_of(spec)
    step = spec.course.step
    rate = model.rise if step > 0.0 else model.fall
    # At the sample of the step the control unit has moved the set-point by one period already.
    past = np.maximum(t - spec.course.step_time + period, 0.0)
    moved = np.minimum(rate * past, abs(step)) if math.isfinite(rate) else np.where(past > 0.0, abs(step), 0.0)
    return np.asarray(model.start + math.copysign(1.0, step) * moved, dtype=float)
