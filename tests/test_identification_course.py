"""A made car on a sideslip course, and a mapping of its columns."""

import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

from mirdrake.identification.fit import load_fit
from tests.identification_course import CAR, COURSES, LATE, recorded

CHANNELS = {
    "vx": "m/s", "vy": "m/s", "yaw_rate": "rad/s", "lateral_acceleration": "m/s^2", "steering_wheel_angle": "rad",
}  # fmt: skip


@pytest.mark.slow
def test_a_sideslip_course_and_a_mapping_give_the_car_and_foretell_a_step(tmp_path):
    """The drive that turns in most quickly, the sine with dwell, is trained on; the next one, the step, is held out."""
    random = np.random.default_rng(1)
    for name, course in COURSES.items():
        pd.DataFrame(recorded(course, random)).to_csv(tmp_path / f"{name}.csv", index=False)
    lines = [f"  {name}: {{column: {name}, unit: {unit}}}" for name, unit in CHANNELS.items()]
    logs = [f"  - {{file: {name}.csv}}" for name in COURSES]
    head = ["mirdrake: data/1", f"wheelbase: {CAR['wheelbase']} m", "time: {column: time}", "channels:"]
    (tmp_path / "course.yaml").write_text("\n".join([*head, *lines, "logs:", *logs]) + "\n")
    command = [sys.executable, "-m", "mirdrake.cli", "identify", "course.yaml", "--out", "fit"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode in {0, 1}, done.stderr
    found = load_fit(tmp_path / "fit")
    fits = {(one.log, one.channel): one.nrmse_percent for one in found.channels if one.part != "train"}
    for channel in ("yaw_rate", "lateral_acceleration"):
        assert fits["step.csv", channel] > 90.0
        assert fits["slalom.csv, held out", channel] > 90.0
    assert fits["slalom.csv, held out", "vy"] > 90.0
    assert found["steering_ratio"].value == pytest.approx(CAR["ratio"], rel=0.02)
    assert found["velocity_delay"].value == pytest.approx(LATE, abs=0.003)
    truth = {
        "cornering_stiffness_front": CAR["stiffness_front"], "cornering_stiffness_rear": CAR["stiffness_rear"],
        "yaw_inertia": CAR["yaw_inertia"],
    }  # fmt: skip
    for name, value in truth.items():
        one = found[name]
        assert one.low is not None
        assert one.high is not None
        assert one.low < value / CAR["mass"] < one.high, name
