"""The reduced model of a loop: identified transfer function, dead time, limits, the set-point's slope, feed-forward."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from mirdrake.core.errors import ConfigError
from mirdrake.core.pid import PidGains, PidLimits, PidState, pid_step
from mirdrake.tuning.loops.base import NOMINAL, Conditions, Evaluation, LoopSpec
from mirdrake.tuning.loops.judge import judge
from mirdrake.tuning.margins import find_margins
from mirdrake.tuning.models import Floats, TransferFunction
from mirdrake.tuning.processes import LinearProcess
from mirdrake.tuning.stability import is_stable


def pid_of(spec: LoopSpec, gains: Mapping[str, float]) -> PidGains:
    """Gains of a loop as those of its controller, with the loop's filter."""
    return PidGains(
        float(gains["kp"]), float(gains["ki"]), float(gains.get("kd", 0.0)), filter_time=float(spec.options["filter"])
    )


def nominal_model(spec: LoopSpec, name: str = "main") -> TransferFunction:
    """The model of the loop from control to what is fed back, hold of the control not in it.

    Args:
        spec: the loop.
        name: ``main``; a steering loop also has ``apart``, of the two wheels against each other.

    Raises:
        ConfigError: the loop has not been identified.
    """
    data = spec.models.get(name)
    if data is None:
        raise ConfigError("the loop has no reduced model; identify it first")
    return TransferFunction(tuple(data["numerator"]), tuple(data["denominator"]), float(data["delay"]))


def critical_model(spec: LoopSpec, gains: Mapping[str, float]) -> TransferFunction:
    """Of the models of the loop that on which these gains come closest to the edge, by Ms."""
    models = [nominal_model(spec, name) for name in spec.models]
    if len(models) < 2 or not any(gains.values()):
        return nominal_model(spec)
    pid, period = pid_of(spec, gains), float(spec.options["period"])
    return max(models, key=lambda model: find_margins(model, pid, period=period).max_sensitivity)


def model_under(spec: LoopSpec, conditions: Conditions, name: str = "main") -> TransferFunction:
    """The model under other conditions: another delay, and where the car's mass is what is moved, another mass."""
    model = nominal_model(spec, name)
    denominator = list(model.denominator)
    if conditions.mass != 1.0 and spec.kind != "steering" and len(denominator) > 1:
        denominator[0] *= conditions.mass
    delay = model.delay
    if conditions.delay is not None:
        delay = max(delay + conditions.delay - spec.nominal["delay"], 0.0)
    return TransferFunction(model.numerator, tuple(denominator), delay)


def find_loop_margins(spec: LoopSpec, gains: Mapping[str, float]) -> dict[str, float]:
    """Margins of the nominal loop by name, each the worst over its models; nan without model or without any gain."""
    names = ("ms", "mt", "gain_margin", "phase_margin_deg", "delay_margin_s", "disk_margin")
    if "main" not in spec.models or not any(gains.values()):
        return dict.fromkeys(names, math.nan)
    rows = []
    for name in spec.models:
        found = find_margins(nominal_model(spec, name), pid_of(spec, gains), period=spec.options["period"])
        rows.append(
            (
                -found.max_sensitivity,
                -found.max_complementary,
                found.gain_margin,
                math.degrees(found.phase_margin),
                found.delay_margin,
                found.disk_margin,
            )
        )
    worst = [min(column) for column in zip(*rows, strict=True)]
    return dict(zip(names, (-worst[0], -worst[1], *worst[2:]), strict=True))


def run_reduced(spec: LoopSpec, gains: Mapping[str, float], conditions: Conditions = NOMINAL) -> Evaluation:
    """One trial on the reduced model; friction does not act on it.

    Raises:
        ConfigError: the loop has not been identified, or a gain makes no sense.
    """
    pid = pid_of(spec, gains)
    model = model_under(spec, conditions)
    period, course, options = float(spec.options["period"]), spec.course, spec.options
    if any(gains.values()):
        for name in spec.models:
            part = model_under(spec, conditions, name)
            late = TransferFunction(part.numerator, part.denominator, part.delay + 0.5 * period)
            if not is_stable(late, pid):
                return Evaluation("unstable", reason="the closed loop has a pole in the right half plane")
    t = np.arange(round(course["duration"] / period) + 1) * period
    reference = set_points(spec, t)
    slope = np.diff(reference, prepend=reference[0]) / period
    scale = float(options.get("scale", 1.0))  # of what is fed back, per output
    loads = np.full(len(t), -float(options.get("drag", 0.0)))
    loads[t >= course["load_time"] - 1e-9] += course["load"]
    loads -= float(options.get("weight", 0.0)) * math.sin(conditions.grade) * conditions.mass
    forward = float(options.get("push", 0.0)) * slope
    noise = np.zeros(len(t))
    if conditions.noise:
        noise = np.random.default_rng(conditions.seed).normal(0.0, conditions.noise, len(t))
    limit = options.get("limit")
    limits = PidLimits() if limit is None else PidLimits(-limit, limit)
    process, state, value = LinearProcess(model, period), PidState(), 0.0
    rows: list[tuple[float, float]] = []
    start = reference[0]
    for k, wanted in enumerate(((reference - start) * scale).tolist()):
        state, control = pid_step(
            state, wanted, value + noise[k], gains=pid, period=period, limits=limits, feedforward=float(forward[k])
        )
        if not (abs(value) < 1e9 and abs(control) < 1e12):
            return Evaluation("unstable", reason="the output grows without bound")
        rows.append((value, control))
        value = process(control + loads[k])
    output, effort = np.array(rows).T
    return judge(
        t,
        reference,
        output / scale + start,
        effort,
        course=course,
        limits=limits,
        noise=conditions.noise / scale,
        margins=find_loop_margins(spec, gains),
    )


def set_points(spec: LoopSpec, t: Floats) -> Floats:
    """The set-point after the limit of its slope [y], shape as t."""
    course: Mapping[str, Any] = spec.course
    start = 0.0 if spec.kind == "steering" else float(course["speed"])
    step, up = float(course["step"]), float(spec.options.get("slope", math.inf))
    if spec.kind == "wheel_speed":
        start = start * float(spec.options["per_speed"])
    down = float(spec.options.get("slope_down", up))
    rate = up if step > 0.0 else down
    past = np.maximum(t - course["step_time"] + spec.options["period"], 0.0)
    moved = np.minimum(rate * past, abs(step)) if math.isfinite(rate) else np.where(past > 0.0, abs(step), 0.0)
    return np.asarray(start + math.copysign(1.0, step) * moved, dtype=float)
