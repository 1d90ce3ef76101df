"""Which manoeuvre would reduce the uncertainty most, by the information that the model predicts for it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from mirdrake.identification.estimators.problem import Problem
from mirdrake.identification.models.base import Model, Segment
from mirdrake.identification.parameters import FitParameter

Array = NDArray[np.float64]

STEP, DURATION = 0.01, 20.0
_FINER = 4


@dataclass(frozen=True)
class Candidate:
    """A manoeuvre and what it would bring.

    Attributes:
        name: of the manoeuvre.
        sigmas: predicted standard deviations of the scaled free parameters, with what is known already (p).
        d_gain: how much smaller the volume of uncertainty gets, per parameter: factor on a standard deviation [1].
        a_gain: factor on the root of the mean variance [1].
    """

    name: str
    sigmas: Array
    d_gain: float
    a_gain: float


def manoeuvres(speed: float, wheelbase: float, *, lateral: float = 3.0) -> dict[str, tuple[Array, Array]]:
    """Angle of the front wheels [rad] and speed [m/s] of lateral manoeuvres, 20 s in steps of 0.01 s.

    Args:
        speed: highest [m/s].
        wheelbase: [m].
        lateral: lateral acceleration [m/s²] of a neutral car.
    """
    t = np.arange(0.0, DURATION, STEP)
    one = lateral * wheelbase / speed**2
    slow = 0.5 * speed
    square = np.sign(np.sin(2.0 * np.pi * 0.2 * t))
    sweep = np.sin(2.0 * np.pi * (0.2 * t + 0.5 * (2.3 / DURATION) * t**2))
    phase = np.clip(t, 0.0, DURATION)
    lane = np.where(phase % 10.0 < 4.0, np.sin(2.0 * np.pi * 0.5 * (phase % 10.0)), 0.0)
    full = np.full(len(t), speed)
    both = np.where(t < 0.5 * DURATION, slow, speed)
    return {
        "step steer": (one * square, full),
        "step steer at two speeds": (np.where(t < 0.5 * DURATION, 4.0 * one, one) * square, both),
        "swept sine to 2.5 Hz": (one * sweep, full),
        "swept sine at two speeds": (np.where(t < 0.5 * DURATION, 4.0 * one, one) * sweep, both),
        "double lane change": (one * lane, full),
        "slowly increasing steer": (2.0 * one * t / DURATION, full),
        "steady circle with rising speed": (np.full(len(t), one), np.linspace(0.3 * speed, speed, len(t))),
    }


def longitudinal_manoeuvres(speed: float) -> dict[str, dict[str, Array]]:
    """Pedals of longitudinal manoeuvres, 60 s in steps of 0.01 s, and the speed that they are driven at first [m/s]."""
    t = np.arange(0.0, 60.0, STEP)
    zero, wave = np.zeros(len(t)), np.sign(np.sin(2.0 * np.pi * t / 12.0))
    levels = 0.3 + 0.3 * (t // 12.0 % 2.0)
    return {
        "coast-down": {"throttle": zero, "brake": zero, "vx": np.full(len(t), speed)},
        "throttle steps": {"throttle": levels * np.maximum(wave, 0.0), "brake": zero, "vx": 0.3 * speed + zero},
        "brake steps": {
            "throttle": 0.6 * np.maximum(wave, 0.0), "brake": 0.5 * levels * np.maximum(-wave, 0.0) * (t % 6.0 < 1.0),
            "vx": np.full(len(t), 0.7 * speed),
        },
    }  # fmt: skip


def lists_manoeuvres(model: Model) -> bool:
    """Whether there are manoeuvres for a model here."""
    if model.kind == "longitudinal":
        return set(model.inputs) <= {"throttle", "brake"}
    return model.kind in {"kinematic", "single_track", "single_track_roll"}


def rank_manoeuvres(
    model: Model,
    unknowns: Sequence[FitParameter],
    values: Mapping[str, float],
    sigmas: Mapping[str, float],
    *,
    known: Array | None = None,
    candidates: Mapping[str, Mapping[str, Array]] | None = None,
    speed: float = 20.0,
) -> tuple[Candidate, ...]:
    """Manoeuvres, the best first, by D-optimality; without those that the model cannot follow.

    Args:
        model: the model.
        unknowns: its parameters; the free ones count.
        values: of the parameters.
        sigmas: noise by output.
        known: information that there is already (p, p); None: only weak priors.
        candidates: recorded channels by manoeuvre; None: those of this module that the model can drive.
        speed: highest that may be driven [m/s].
    """
    free = [one for one in unknowns if one.kind != "fixed"]
    base = np.diag([1.0 / one.info.usual**2 if one.info.usual > 0.0 else 1e-6 for one in free])
    now = base if known is None else known + 1e-9 * np.eye(len(free))
    before = np.linalg.inv(now)
    found = []
    plans = candidates or _candidates(model, values, speed)
    for name, drive in zip(plans, _driven(model, values, list(plans.values())), strict=True):
        gained = information(model, unknowns, values, sigmas, drive)
        if not np.isfinite(gained).all():
            continue
        after = np.linalg.inv(now + gained)
        signs = [np.linalg.slogdet(matrix)[1] for matrix in (before, after)]
        found.append(
            Candidate(
                name, np.sqrt(np.diag(after)), float(np.exp(0.5 * (signs[1] - signs[0]) / len(free))),
                float(np.sqrt(np.trace(after) / np.trace(before))),
            )
        )  # fmt: skip
    return tuple(sorted(found, key=lambda one: one.d_gain))


def information(
    model: Model,
    unknowns: Sequence[FitParameter],
    values: Mapping[str, float],
    sigmas: Mapping[str, float],
    drive: Segment,
) -> Array:
    """Fisher information of the scaled free parameters in a drive, offsets and first states taken out (p, p)."""
    problem = Problem(model, [drive], unknowns, sigmas)
    jacobian = problem.jacobian(problem.scaled(values))
    p = len(problem.free)
    data, rest = jacobian[: problem.measured], jacobian[problem.measured :, p:]
    inside = data.T @ data
    inside[p:, p:] += rest.T @ rest
    return np.asarray(inside[:p, :p] - inside[:p, p:] @ np.linalg.solve(inside[p:, p:], inside[p:, :p]))


def _driven(model: Model, values: Mapping[str, float], plans: Sequence[Mapping[str, Array]]) -> list[Segment]:
    """Drives with what the model itself shows, so that guesses of its states along the way are near; side by side."""
    drives = []
    for channels in plans:
        many = len(next(iter(channels.values())))
        inputs = {name: channels[name] for name in model.inputs}
        outputs = {name: channels.get(name, np.zeros(many)) for name in model.outputs}
        drives.append(Segment("plan", "train", 0.0, STEP, inputs, outputs))
    longest = max(drive.size for drive in drives)
    inputs_of = [model.input_signals(values, drive, drive.time) for drive in drives]
    u = np.stack([np.pad(one, ((0, 0), (0, longest - one.shape[1])), "edge") for one in inputs_of], axis=-1)
    first = np.zeros(1, dtype=np.intp)
    x = np.concatenate([model.initial_states(values, drive, first) for drive in drives], axis=1)
    seen = np.empty((len(model.outputs), longest, len(drives)))
    step = STEP / _FINER  # a small robot is stiff: its yaw answers within milliseconds
    with np.errstate(all="ignore"):
        for k in range(longest):
            now = u[:, k, None]
            seen[:, k] = model.observe(x[:, None, :, None], now[..., None], values)[:, 0, :, 0]
            for _ in range(_FINER):
                x = x + step * model.rates(x[:, None], now, values)[:, 0]
    return [
        replace(drive, outputs=dict(zip(model.outputs, seen[:, : drive.size, i], strict=True)))
        for i, drive in enumerate(drives)
    ]


def _candidates(model: Model, values: Mapping[str, float], speed: float) -> dict[str, dict[str, Array]]:
    if model.kind == "longitudinal":
        return longitudinal_manoeuvres(speed)
    wheelbase = values.get("wheelbase") or values["front_length"] + values["rear_length"]
    found = {}
    for name, (angle, v) in manoeuvres(speed, wheelbase).items():
        channels = {"vx": v, "speed": v, "y": cumulative_trapezoid(v, dx=STEP, initial=0.0)}
        for steer in ("road_wheel_angle", "steering_wheel_angle", "steering_command"):
            channels[steer] = angle * values["steering_ratio"]
        found[name] = channels
    return found
