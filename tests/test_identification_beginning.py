"""Beginning of a log: delays and lags respond to inputs that are not recorded."""

import numpy as np
import pytest

from mirdrake.identification.data import DataSet, Log
from mirdrake.identification.estimators import fit, output_error
from mirdrake.identification.estimators.segments import after_unknown_inputs, make_segments
from mirdrake.identification.models import ModelSpec, make_model
from mirdrake.identification.parameters import Setting

LENGTH, SPEED, DELAY, LAG, FREQUENCY = 2.7, 8.0, 0.06, 0.25, 3.0
KINEMATIC = ModelSpec("kinematic")
FREE = {"steering_ratio": Setting(fixed=1.0), "steering_offset": Setting(fixed=0.0), "steering_lag": Setting(free=True)}


def kinematic_data(command, angle):
    """Return a log of a kinematic car with a command and the road wheel angle that follows it, at 100 Hz."""
    channels = {
        "vx": np.full(len(command), SPEED),
        "steering_command": command,
        "yaw_rate": SPEED * np.tan(angle) / LENGTH,
    }
    time = np.arange(0.0, len(command), dtype=np.float64) / 100.0
    return DataSet((Log("short", "train", time, channels),), wheelbase=LENGTH)


def sine_data(seconds):
    """Return a log of a sine of the steering that began long before it; the response is in closed form."""
    time = np.arange(0.0, seconds, 0.01)
    size, late = 1.0 / np.hypot(1.0, FREQUENCY * LAG), np.arctan(FREQUENCY * LAG)
    angle = 0.1 * size * np.sin(FREQUENCY * (time - DELAY) - late)
    return kinematic_data(0.1 * np.sin(FREQUENCY * time), angle)


def segments_of(data):
    model = make_model(KINEMATIC, data, {})
    return model, make_segments(model, data.logs)[0]


def test_a_log_that_begins_in_motion_gives_delay_and_lag(monkeypatch):
    data = sine_data(4.0)
    found = fit(data, KINEMATIC, parameters=FREE)
    assert found["steering_delay"].value == pytest.approx(DELAY, abs=0.003)
    assert found["steering_lag"].value == pytest.approx(LAG, rel=0.02)
    # With the command held before the log, the lag is wrong.
    monkeypatch.setattr(output_error, "after_unknown_inputs", lambda model, drives, p: drives)
    assert abs(fit(data, KINEMATIC, parameters=FREE)["steering_lag"].value / LAG - 1.0) > 0.1


def test_the_unknown_beginning_is_the_dead_time_and_three_lags():
    model, drives = segments_of(sine_data(8.0))
    (shorter,) = after_unknown_inputs(model, drives, {"steering_delay": DELAY, "steering_lag": LAG})
    assert shorter.start == pytest.approx(DELAY + 3.0 * LAG)
    assert len(shorter.before["steering_command"]) == 81
    assert shorter.size == drives[0].size - 81
    # A very slow response leaves four fifths.
    (shorter,) = after_unknown_inputs(model, drives, {"steering_delay": DELAY, "steering_lag": 10.0})
    assert shorter.size == pytest.approx(0.8 * drives[0].size, abs=1)


@pytest.mark.parametrize("noise", [0.0, 0.0003])
def test_a_log_that_begins_with_a_command_at_rest_keeps_its_beginning(noise):
    """A step after 0.4 s would be lost otherwise."""
    time = 0.01 * np.arange(800)
    command = np.where(time < 0.4, 0.0, 0.1) + noise * np.random.default_rng(0).normal(size=len(time))
    model, drives = segments_of(kinematic_data(command, command))
    (same,) = after_unknown_inputs(model, drives, {"steering_delay": DELAY, "steering_lag": LAG})
    assert same is drives[0]
