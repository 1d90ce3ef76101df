"""Choice of the model structure where a study leaves it open: tyre relaxation, by drives with and without it."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mirdrake.identification import DataSet, Log
from mirdrake.identification.estimators import EstimatorOptions, fit
from mirdrake.identification.estimators.structure import choose_structure
from mirdrake.identification.identifiability import CALIBRATION
from mirdrake.identification.models import ModelSpec
from mirdrake.identification.models.single_track import SingleTrackModel, SingleTrackOptions
from mirdrake.identification.parameters import Setting
from tests.identification_rigs import FRONT, MASS, NOISE, REAR, TRUTH, lateral_data, pull, speed, steering

CAR = {"mass": Setting(fixed=MASS), "front_length": Setting(fixed=FRONT), "rear_length": Setting(fixed=REAR)}
SPEC = ModelSpec("single_track", {"roll": False, "tyres": "linear"})


@cache
def relaxing(length, seed=0, duration=20.0):
    """Drive of a single track whose slip angles relax over a length [m], from an independent implementation."""
    p = TRUTH

    def rates(t, x):
        vy, r, front, rear = x
        v, angle = speed(t), steering(t)
        slips = np.arctan((vy + FRONT * r) / v) - angle, np.arctan((vy - REAR * r) / v)
        if length == 0.0:
            front, rear = slips
        tyres = -p["cornering_stiffness_front"] * front
        # 1.4 cos 0.2 t is the rate of the speed.
        ahead = pull(MASS * (1.4 * np.cos(0.2 * t) - r * vy) + tyres * np.sin(angle), angle)
        side = ahead + tyres * np.cos(angle), -p["cornering_stiffness_rear"] * rear
        late = [v * (slip - now) / length if length else 0.0 for slip, now in zip(slips, (front, rear), strict=True)]
        return [sum(side) / MASS - v * r, (FRONT * side[0] - REAR * side[1]) / p["yaw_inertia"], *late]

    time = np.arange(0.0, duration, 0.02)
    x = solve_ivp(rates, (0.0, duration), np.zeros(4), t_eval=time, rtol=1e-8, atol=1e-10, max_step=0.02).y
    random = np.random.default_rng(seed)
    channels = {
        "vx": speed(time), "vy": x[0] + random.normal(0.0, NOISE["vy"], len(time)),
        "yaw_rate": x[1] + random.normal(0.0, NOISE["yaw_rate"], len(time)), "road_wheel_angle": steering(time),
    }  # fmt: skip
    return DataSet((Log("drive", "train", time, channels),), wheelbase=FRONT + REAR)


@pytest.mark.parametrize("length", [0.0, 0.4])
def test_relaxation_is_fitted_where_the_logs_support_it(length):
    data = relaxing(length)
    structure = choose_structure(data, SPEC, CAR, EstimatorOptions())
    assert ("relaxation" in structure.model.options) == (length > 0.0)
    assert bool(structure.notes) == (length > 0.0)
    if length:
        assert "relax" in structure.notes[0]
        assert all("relaxation" in rival for rival in structure.rivals)  # a model without it predicts worse
        result: Any = fit(data, structure.model, parameters=structure.settings, start=structure.start)
        for name in ("cornering_stiffness_front", "cornering_stiffness_rear", "yaw_inertia"):
            parameter = result[name]
            assert parameter.sigma < 0.03 * CALIBRATION * parameter.value
            assert abs(parameter.value - TRUTH[name]) < 1.5 * 1.96 * parameter.sigma
        parameter = result["relaxation"]
        assert parameter.sigma < 0.1 * CALIBRATION * length
        assert abs(parameter.value - length) < 1.5 * 1.96 * parameter.sigma


@pytest.mark.parametrize("delay", [0.0, 0.015])
def test_a_delay_of_the_accelerometer_is_fitted_where_the_logs_support_it(delay):
    """Without vy no kinematic relation shows it; the dynamics of the vehicle do."""
    (log,) = lateral_data().logs
    moved = np.interp(log.time - delay, log.time, log.channels["lateral_acceleration"])
    data = DataSet((replace(log, channels={**log.channels, "lateral_acceleration": moved}),), wheelbase=FRONT + REAR)
    spec = ModelSpec("single_track", {"roll": False, "tyres": "linear", "relaxation": False})
    known = CAR | {"steering_lag": Setting(free=True)}
    structure = choose_structure(data, spec, known, EstimatorOptions())
    assert ("accelerometer_delay" in structure.settings) == (delay > 0.0)
    result: Any = fit(data, structure.model, parameters=structure.settings, start=structure.start)
    late = result["accelerometer_delay"]
    assert late.value == pytest.approx(delay, abs=1.96 * (late.sigma or 0.0))
    assert late.value >= 0.8 * delay
    for name in ("cornering_stiffness_front", "cornering_stiffness_rear", "yaw_inertia"):
        assert result[name].low < TRUTH[name] < result[name].high, name


def test_a_fit_without_relaxation_names_it_as_an_assumption():
    """The plain model underestimates the inertia by far more than its noise; the truth is in its interval."""
    data = relaxing(0.4)
    parameter: Any = fit(data, SPEC, parameters=CAR)["yaw_inertia"]
    assert parameter.value < 0.95 * TRUTH["yaw_inertia"]
    assert parameter.value + 1.96 * parameter.sigma_noise < TRUTH["yaw_inertia"] < parameter.high
    assert parameter.verdict in {"weakly identified", "not identifiable"}
    remedy = "name the vehicle in a study (vehicle: NAME), or give its relaxation length"
    assert f"whether tyre relaxation matters: {remedy}" in parameter.explanation


def test_settings_of_a_study_or_vehicle_disable_the_search():
    data = relaxing(0.4)

    def tried(options, settings):
        return [
            addition.description
            for addition in SingleTrackModel.additions(data, SingleTrackOptions(**options), settings)
        ]

    assert "tyre relaxation" in tried({}, {})
    assert "tyre relaxation" not in tried({"relaxation": False}, {})
    assert "tyre relaxation" not in tried({}, {"relaxation_front": Setting(given=0.4)})
    assert "roll of the body" in tried({}, {})
    assert "roll of the body" not in tried({"roll": False}, {})
    assert "roll of the body" not in tried({"outputs": ["yaw_rate"]}, {})
    assert "roll of the body" not in tried({}, {"yaw_inertia": Setting(given=2400.0)})


def test_an_effect_that_has_further_outputs_is_compared_by_those_of_the_plain_model(monkeypatch):
    """With roll, a single track also simulates the recorded roll rate; its cost would count more samples."""
    (log,) = lateral_data(duration=8.0).logs
    rolls = 0.1 * log.channels["lateral_acceleration"], np.gradient(0.1 * log.channels["lateral_acceleration"], 0.02)
    log = replace(log, channels={**log.channels, "roll": rolls[0], "roll_rate": rolls[1]})
    monkeypatch.setattr("mirdrake.identification.estimators.structure.PROMISE", -np.inf)  # every effect is tried
    monkeypatch.setattr("mirdrake.identification.estimators.structure.predicts_better", lambda *_: True)
    others = ("steering_lag", "accelerometer_delay", "load_transfer")
    settings = CAR | {name: Setting(fixed=0.0) for name in others}
    spec = ModelSpec("single_track", {"tyres": "linear", "relaxation": False})
    options = EstimatorOptions(iterations=2)
    structure = choose_structure(DataSet((log,), wheelbase=FRONT + REAR), spec, settings, options)
    assert structure.model.options["roll"]
    assert structure.start is not None
    assert "roll_rate" not in structure.start.problem.model.outputs
    assert structure.start.problem.model.outputs == tuple(structure.model.options["outputs"])


def test_a_recorded_set_point_of_the_road_wheel_angle_gets_a_lag():
    """A delay of 30 ms and a lag of 50 ms, recorded before both: as a dead time alone they cost yaw inertia."""
    closed = ModelSpec("single_track", {"roll": False, "tyres": "linear", "relaxation": False})
    data = lateral_data(0)
    structure = choose_structure(data, closed, CAR, EstimatorOptions())
    assert any("a lag of the steering" in note for note in structure.notes)
    result: Any = fit(data, structure.model, parameters=structure.settings, start=structure.start)
    for name in ("yaw_inertia", "steering_delay", "steering_lag"):
        assert result[name].low < TRUTH[name] < result[name].high, name
    plain: Any = fit(data, closed, parameters=CAR)
    assert plain["yaw_inertia"].value > 1.1 * TRUTH["yaw_inertia"]
    assert "a lag of the steering: record the actual road wheel angle" in plain["yaw_inertia"].explanation
    # Where the wheels do as they are recorded, none is tried.
    assert not choose_structure(relaxing(0.0), closed, CAR, EstimatorOptions()).notes
