"""Calibration of the online filter: coverage of its 95 % intervals on drawn vehicles with known parameters.

    python -m benchmarks.calibration.filters --cases 100:300 --out runs/filters.jsonl

Vehicles and drives are those of :mod:`benchmarks.calibration.cases`, without the multi-body cars. A filter gets
steering angle, speed, yaw rate and lateral acceleration with noise that is up to three times larger or smaller than it
assumes, and initial parameters that are as wrong as it assumes. Half of the truths have two tracks, roll and load
transfer, which the filter lacks.
"""

import argparse
import json
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d

from benchmarks.calibration.cases import courses, draw_case
from benchmarks.calibration.truth import GRAVITY, STEP, Array, Vehicle, drive
from mirdrake.estimation import Estimates, FilterBank, FilterSpec
from mirdrake.single_track import SingleTrackParameters

SPAN = 60.0
"""Duration of a drive [s]."""

TIMES = (15.0, 30.0, 59.9)
"""Times at which intervals are judged [s]."""

CAR = 2.7
"""Wheelbase for which periods and noise are given; others are scaled as similar motions are [m]."""

PERIOD = 0.02
NOISE = {"steering": 0.001, "vx": 0.05, "yaw_rate": 0.005, "lateral_acceleration": 0.15}
PRIOR = {"front_stiffness": 0.3, "rear_stiffness": 0.3, "yaw_inertia": 0.15, "friction": 0.15, "relaxation": 0.4}
BIAS = 0.005  # standard deviation of the bias of the steering angle [rad]
LAWS = {"linear": "linear", "magic": "magic_formula"}
STATES = ("vx", "vy", "yaw_rate")


@dataclass(frozen=True)
class Drive:
    """A drawn drive.

    Attributes:
        seed: seed.
        vehicle: the truth.
        parameters: what the filter begins with.
        period: sample time [s].
        noise: noise that the filter assumes, by sensor.
        measurements: (t, sensors).
        states: true vx, vy, yaw rate (t, 3).
        truth: true values of the estimated parameters.
    """

    seed: int
    vehicle: Vehicle
    parameters: SingleTrackParameters
    period: float
    noise: dict[str, float]
    measurements: Array
    states: Array
    truth: dict[str, float]


def draw(seed: int) -> Drive | None:
    """Return the drive of a seed; None for a multi-body car, and if the vehicle spins."""
    case = draw_case(seed)
    if case.vehicle.kind == "multi_body":
        return None
    random = np.random.default_rng([seed, 1])
    v = replace(case.vehicle, delay=0.0, lag=0.0, ratio=1.0)
    case = replace(case, vehicle=v)
    # Its drives, repeated up to the duration, with smooth changes from one to the next.
    parts, count = courses(case, random), round(SPAN / STEP)
    speed, command = (np.resize(np.concatenate([part[i] for part in parts]), count) for i in (0, 1))
    speed = gaussian_filter1d(speed, 0.7 / STEP, mode="nearest")
    command = gaussian_filter1d(command, 0.03 * math.sqrt(v.wheelbase / CAR) / STEP, mode="nearest")
    try:
        motion = drive(v, speed, command)
    except ValueError:
        return None
    # Measurements: the noise is up to three times that of the sheet, or down to a third.
    froude = math.sqrt(v.wheelbase / CAR)
    every = round(PERIOD * froude / STEP)
    lateral = motion.rate(motion.lateral) + motion.speed * motion.yaw_rate
    clean = np.stack([command, motion.speed, motion.yaw_rate, lateral], axis=1)[::every]
    noise = dict(zip(NOISE, np.array(list(NOISE.values())) * [1.0, froude, 1.0 / froude, 1.0], strict=True))
    factors = 3.0 ** random.uniform(-1.0, 1.0, len(noise))
    seen = clean + factors * list(noise.values()) * random.normal(size=clean.shape)
    # Initial parameters are wrong by their prior; a true relaxation length of zero is below its range.
    wrong = {name: float(np.exp(sigma * random.normal())) for name, sigma in PRIOR.items()}
    low = 0.2 * math.sqrt(GRAVITY * v.wheelbase)
    relaxation = 0.15 * v.wheelbase
    parameters = SingleTrackParameters(
        mass=v.mass, yaw_inertia=v.yaw_inertia * wrong["yaw_inertia"], front_length=v.front, rear_length=v.rear,
        front_stiffness=v.stiffness_front * wrong["front_stiffness"],
        rear_stiffness=v.stiffness_rear * wrong["rear_stiffness"],
        front_friction=v.friction * wrong["friction"], rear_friction=v.friction * wrong["friction"],
        front_shape=v.shape, rear_shape=v.shape, front_curvature=v.curvature, rear_curvature=v.curvature,
        front_relaxation=relaxation, rear_relaxation=relaxation, blend_start=low, blend_end=3.0 * low,
    )  # fmt: skip
    truth = {
        "front_stiffness": v.stiffness_front, "rear_stiffness": v.stiffness_rear, "yaw_inertia": v.yaw_inertia,
        "steering_bias": -v.offset,
    }  # fmt: skip
    # Linear tyres have no friction.
    truth |= {} if v.kind == "linear" else {"friction": 1.0 / wrong["friction"]}
    states = np.stack([motion.speed, motion.lateral, motion.yaw_rate], axis=1)[::every]
    return Drive(seed, v, parameters, every * STEP, noise, seen, states, truth)


def estimate(drawn: Drive) -> Estimates:
    """Return the estimates of a filter with default settings."""
    sensors = {name: {"noise": value} for name, value in drawn.noise.items()}
    spec = FilterSpec.model_validate(
        {
            "tyres": LAWS.get(drawn.vehicle.kind, "brush"),
            "period": drawn.period,
            "step": min(0.005, drawn.period / 2.0),
            "sensors": sensors | {"steering": {"noise": drawn.noise["steering"], "bias": BIAS}},
            "estimate": PRIOR,
        }
    )
    return FilterBank(drawn.parameters, spec).run(drawn.measurements)


def judge(drawn: Drive) -> dict[str, Any]:
    """Return the record of a drive."""
    found = estimate(drawn)
    rows = [int(time / drawn.period) for time in TIMES]
    parameters = {}
    for name, value in drawn.truth.items():
        low, high = (ends[0, rows] for ends in found.interval(name))
        size = abs(value) if value and name != "steering_bias" else 1.0
        parameters[name] = {
            "covered": ((low <= value) & (value <= high)).tolist(),
            "half": (0.5 * (high - low) / size).tolist(),
            "error": (np.abs(found[name][0, rows] - value) / (0.5 * (high - low))).tolist(),
        }
    errors = np.stack([found[name][0] - drawn.states[:, i] for i, name in enumerate(STATES)], axis=1)
    sizes = np.stack([(found.interval(name)[1] - found[name])[0] / 1.96 for name in STATES], axis=1)
    # After the first quarter of a minute, in which the noise is adapted.
    squares = np.square(errors / sizes)[rows[0] :]
    return {
        "seed": drawn.seed,
        "kind": drawn.vehicle.kind,
        "consistent": found.consistent[0, rows].tolist(),
        "consistent_share": float(found.consistent[0].mean()),
        "parameters": parameters,
        "states": np.mean(squares < 1.96**2, axis=0).tolist(),
        "nees": float(np.mean(squares)),
    }


def table(records: Iterable[dict[str, Any]]) -> str:
    """Return the rates as Markdown."""
    records = list(records)
    lines = ["| figure | model of the filter | other model |", "|---|---|---|"]
    groups = [[r for r in records if (r["kind"] == "two_track") == other] for other in (False, True)]

    def add(title: str, values: Iterable[str]) -> None:
        lines.append(f"| {title} | {' | '.join(values)} |")

    add("drives", (str(len(group)) for group in groups))
    for t, time in enumerate(TIMES):
        add(
            f"consistent after {time:.0f} s",
            (f"{100.0 * np.mean([r['consistent'][t] for r in group]):.0f} %" for group in groups),
        )
        for name in ("front_stiffness", "rear_stiffness", "yaw_inertia", "friction", "steering_bias"):
            cells = []
            for group in groups:
                chosen = [r["parameters"][name] for r in group if r["consistent"][t] and name in r["parameters"]]
                covered, half = [c["covered"][t] for c in chosen], [c["half"][t] for c in chosen]
                size = f"{np.median(half):.4f} rad" if name == "steering_bias" else f"{100.0 * np.median(half):.0f} %"
                cells.append(f"{100.0 * np.mean(covered):.0f} % ({sum(covered)} of {len(covered)}), ±{size}")
            add(f"`{name}` covered, consistent, after {time:.0f} s", cells)
    for i, name in enumerate(STATES):
        add(f"`{name}` covered", (f"{100.0 * np.mean([r['states'][i] for r in group]):.0f} %" for group in groups))
    add(
        "mean square of normalised errors of states, median",
        (f"{np.median([r['nees'] for r in g]):.2f}" for g in groups),
    )
    every = []
    for group in groups:
        hits = [
            c["covered"][t] for r in group for c in r["parameters"].values() for t in range(3) if r["consistent"][t]
        ]
        every.append(f"{100.0 * np.mean(hits):.1f} % of {len(hits)}")
    add("all parameters and times covered, consistent", every)
    return "\n".join(lines)


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", default="0:60", metavar="FIRST:LAST", help="seeds; the last one is not included")
    parser.add_argument(
        "--out", type=Path, required=True, help="records, a line for each drive; continued if it exists"
    )
    options = parser.parse_args()
    first, last = map(int, options.cases.split(":"))
    done = [json.loads(line) for line in options.out.read_text().splitlines()] if options.out.exists() else []
    options.out.parent.mkdir(parents=True, exist_ok=True)
    with options.out.open("a") as file:
        for seed in sorted(set(range(first, last)) - {record["seed"] for record in done}):
            drawn = draw(seed)
            if drawn is not None:
                done.append(judge(drawn))
                file.write(json.dumps(done[-1]) + "\n")
                file.flush()
    print(table(record for record in done if first <= record["seed"] < last))


if __name__ == "__main__":
    main()
