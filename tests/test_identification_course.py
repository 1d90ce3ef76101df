"""A synthetic car on a sideslip course, and a mapping of its columns."""

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
    """The drive with the highest lateral jerk, sine with dwell, is for training; the next, the step, for validation."""
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
    fit = load_fit(tmp_path / "fit")
    fits = {
        (channel.log, channel.channel): channel.nrmse_percent for channel in fit.channels if channel.part != "train"
    }
    for channel in ("yaw_rate", "lateral_acceleration"):
        assert fits["step.csv", channel] > 90.0
        assert fits["slalom.csv, end", channel] > 90.0
    assert fits["slalom.csv, end", "vy"] > 90.0
    assert fit["steering_ratio"].value == pytest.approx(CAR["ratio"], rel=0.02)
    # A delay of vy of 15 ms is not certain beside roll and sensor positions; the interval that is stated contains it.
    findings = pd.read_csv(tmp_path / "fit" / "data_check.csv").query("channel.str.startswith('vy')")
    assert "delay" not in set(findings["check"])
    (limit,) = set(findings["value"][findings["check"] == "delay_limit"])
    assert LATE < limit < 2.0 * LATE
    # The centre of mass is 0.22 m ahead of the middle, which is assumed: an axle is known by what it carries. A shape
    # factor of 1.4 and no curvature are assumed as well, 1.3 and -1 are true: with these two values the stiffness is 4
    # and 3 % too large, without them 8 and 6 %. The intervals contain both.
    behind = CAR["wheelbase"] - CAR["front"]
    for axle, carries in (("front", behind), ("rear", CAR["front"])):
        found = fit[f"cornering_stiffness_{axle}"]
        true = CAR[f"stiffness_{axle}"] / CAR["mass"] / carries * 0.5 * CAR["wheelbase"]
        assert found.value == pytest.approx(true, rel=0.09)
        assert found.low is not None
        assert found.high is not None
        assert found.low < true < found.high
    inertia = fit["yaw_inertia"]
    assert inertia.low is not None
    assert inertia.high is not None
    assert inertia.low < CAR["yaw_inertia"] / CAR["mass"] < inertia.high
