"""Logs of a case as files: positions and errors of the sensors, faults of the logger, a data file and a study."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import yaml
from numpy.random import Generator

from benchmarks.calibration.cases import Case, courses
from benchmarks.calibration.truth import GRAVITY, STEP, Array, Motion, drive
from mirdrake.identification.channels import channel

RATIOS = {"road_wheel_angle": 1.0, "steering_wheel_angle": 16.0, "steering_command": 2.2}


def with_ratio(case: Case) -> Case:
    """Return a case whose vehicle has the ratio of its steering channel."""
    return replace(case, vehicle=replace(case.vehicle, ratio=RATIOS[case.sensors.steering]))


def record(case: Case, folder: Path) -> Path:
    """Write the logs and a study of a case, and return the study.

    Raises:
        ValueError: the vehicle spins in one of the drives.
    """
    random = np.random.default_rng(case.seed + 1_000_000)
    logs = []
    for number, (speed, command) in enumerate(courses(case, random)):
        motion = drive(case.vehicle, speed, command)
        name = f"log_{number}.parquet"
        pd.DataFrame(_logged(case, motion, random)).to_parquet(folder / name)
        logs.append({"file": name, "use": "validation" if number == len(case.manoeuvres) - 1 else "train"})
    return _study(case, folder, logs)


def _logged(case: Case, motion: Motion, random: Generator) -> dict[str, Array]:
    """Return the columns of a log, with all errors."""
    sensors = case.sensors
    v, r = motion.speed, motion.yaw_rate
    spin = motion.rate(r)
    side = motion.rate(motion.lateral) + v * r + spin * sensors.accelerometer
    side = side + GRAVITY * np.sin(motion.roll) - sensors.height * motion.rate(motion.rate(motion.roll))
    ahead = motion.rate(v) - r * motion.lateral - r**2 * sensors.accelerometer
    turned = (np.cos(sensors.misaligned), np.sin(sensors.misaligned))
    true = {
        "vx": v,
        "yaw_rate": r,
        "vy": motion.lateral + r * sensors.velocity,
        "lateral_acceleration": turned[0] * side - turned[1] * ahead,
        "longitudinal_acceleration": turned[0] * ahead + turned[1] * side,
        "yaw": np.cumsum(r) * STEP,
        sensors.steering: motion.command,
    }
    time = np.arange(0.2, motion.time[-1] - 0.2, sensors.step)
    columns = {"time": time}
    for name in (*sensors.channels, sensors.steering):
        values = np.interp(time - case.late.get(name, 0.0), motion.time, true[name])
        level = sensors.noise[name] * (case.vehicle.ratio if name == sensors.steering else 1.0)
        noise = random.normal(size=len(time))
        for i in range(1, len(time)) if sensors.memory else ():
            noise[i] = sensors.memory * noise[i - 1] + np.sqrt(1.0 - sensors.memory**2) * noise[i]
        values = values + level * noise + sensors.bias.get(name, 0.0) + sensors.drift.get(name, 0.0) * time
        coarse = sensors.resolution.get(name, 0.0) * (case.vehicle.ratio if name == sensors.steering else 1.0)
        columns[name] = np.round(values / coarse) * coarse if coarse else values
    return _damaged(case, columns, random)


def _damaged(case: Case, columns: dict[str, Array], random: Generator) -> dict[str, Array]:
    """Return the columns with the fault of the logger."""
    time, fault, steering = columns["time"], case.fault, case.sensors.steering
    names = [name for name in columns if name not in {"time", steering}]
    victim = str(names[int(random.integers(len(names)))])
    if fault == "held":
        columns[victim] = np.repeat(columns[victim][::4], 4)[: len(time)]
    elif fault == "glitches":
        rows = random.choice(len(time), max(3, len(time) // 300), replace=False)
        columns[victim][rows] += 30.0 * np.std(columns[victim]) * random.choice([-1.0, 1.0], len(rows))
    elif fault in {"sign", "vy_sign"}:
        victim = "vy" if fault == "vy_sign" else str(random.choice(["yaw_rate", steering]))
        columns[victim] = -columns[victim]
    elif fault == "degrees":
        columns["yaw_rate"] = np.rad2deg(columns["yaw_rate"])
    keep = np.ones(len(time), dtype=bool)
    if fault == "dropped":
        keep = random.random(len(time)) > 0.03
    elif fault == "gap":
        keep = np.abs(time - time[len(time) // 2]) > 1.0
    columns = {name: values[keep] for name, values in columns.items()}
    if fault == "repeated":
        rows = np.sort(np.append(np.arange(len(time)), random.choice(len(time), 10, replace=False)))
        columns = {name: values[rows] for name, values in columns.items()}
    elif fault == "dummy":
        columns = {name: np.append(np.zeros(15), values) for name, values in columns.items()}
        columns["time"][:15] = columns["time"][15] - case.sensors.step * np.arange(15, 0, -1)
    return columns


def _study(case: Case, folder: Path, logs: list[dict[str, str]]) -> Path:
    v = case.vehicle
    names = (*case.sensors.channels, case.sensors.steering)
    data: dict[str, object] = {
        "channels": {name: {"column": name, "unit": channel(name).unit} for name in names},
        "logs": logs,
    }  # fmt: skip
    parameters: dict[str, object] = {}
    if case.knowledge != "nothing":
        data["wheelbase"] = float(v.wheelbase)
    for name, (value, sigma) in case.known.items():
        parameters[name] = {"fixed": float(value)} | ({"sigma": float(sigma)} if sigma else {})
    if "front_length" in case.known:
        parameters["rear_length"] = {"fixed": float(v.wheelbase - case.known["front_length"][0])}
    study = {"mirdrake": "identification/1", "name": f"case {case.seed}", "data": data,
             "model": {"kind": "single_track"}, "parameters": parameters}  # fmt: skip
    path = folder / "study.yaml"
    path.write_text(yaml.safe_dump(study, sort_keys=False))
    return path
