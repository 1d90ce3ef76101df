"""Identification held against truths: many noise seeds, other people's multi-body cars, the logs of a real car."""

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mirdrake.identification import DataSet, Log, check_data, load_data
from mirdrake.identification.estimators import EstimatorOptions, fit
from mirdrake.identification.models import ModelSpec
from mirdrake.identification.online import filter_log
from mirdrake.identification.parameters import Choice
from mirdrake.single_track import SingleTrackParameters, estimate_parameters
from mirdrake.vehicles import load_vehicle
from tests.commonroad_car import write_car
from tests.commonroad_rig import car, manoeuvre, reference_trace
from tests.identification_rigs import COAST, FRONT, MASS, REAR, TRUTH, coast_data, lateral_data, lateral_log

CAR = {"mass": Choice(fixed=MASS), "front_length": Choice(fixed=FRONT), "rear_length": Choice(fixed=REAR)}
LATERAL = CAR | {"steering_lag": Choice(free=True), "accelerometer_ahead": Choice(free=False)}
LOGS = Path(__file__).resolve().parent.parent.parent / "shared" / "data" / "bmw_m8"


def _inside(found, truth, counts):
    for name, value in truth.items():
        counts[name] = counts.get(name, 0) + (found[name].low < value < found[name].high)


@pytest.mark.slow
def test_intervals_of_a_single_track_hold_the_truth_in_90_to_99_of_100_seeds():
    counts: dict[str, int] = {}
    values = []
    for seed in range(100):
        found: Any = fit(lateral_data(seed), ModelSpec("single_track"), parameters=LATERAL)
        _inside(found, TRUTH, counts)
        values.append([found[name].value for name in TRUTH])
    assert all(90 <= count <= 99 for count in counts.values()), counts
    means = np.mean(values, axis=0)
    for name, mean in zip(TRUTH, means, strict=True):
        assert mean == pytest.approx(TRUTH[name], rel=0.02), name


@pytest.mark.slow
def test_intervals_of_a_coast_down_hold_the_truth_in_90_to_99_of_100_seeds():
    counts: dict[str, int] = {}
    spec = ModelSpec("longitudinal", {"drive": "none", "brake": "none"})
    for seed in range(100):
        found: Any = fit(coast_data(seed), spec, parameters={"mass": Choice(fixed=MASS)})
        _inside(found, COAST, counts)
        for name, value in COAST.items():
            assert found[name].value == pytest.approx(value, rel=0.02)
    assert all(90 <= count <= 99 for count in counts.values()), counts


@pytest.mark.slow
def test_a_log_of_90_s_at_200_hz_takes_less_than_20_s_and_the_filter_runs_50_times_faster_than_time():
    log = lateral_log(duration=90.0)
    times = np.arange(log.time[0], log.time[-1], 0.005)
    channels = {name: np.interp(times, log.time, values) for name, values in log.channels.items()}
    data = DataSet((Log("long", "train", times, channels),), wheelbase=FRONT + REAR)
    begun = time.process_time()
    fit(data, ModelSpec("single_track"), parameters=LATERAL)
    assert time.process_time() - begun < 20.0
    known = SingleTrackParameters(
        mass=MASS, yaw_inertia=2400.0, front_length=FRONT, rear_length=REAR, front_stiffness=9e4, rear_stiffness=1.1e5
    )
    begun = time.process_time()
    filter_log(data.logs[0], known)
    assert time.process_time() - begun < 90.0 / 50.0


# --- the multi-body cars of commonroad-vehicle-models ------------------------------------------------------------


@pytest.mark.slow
def test_axle_stiffnesses_of_a_multi_body_car(tmp_path):
    """The truth is what the axles of that car are worth in a slow turn: tyres, camber by roll and load transfer."""
    p = car("BMW 320i")
    axles = estimate_parameters(load_vehicle(str(write_car(tmp_path / "car", p))))
    random = np.random.default_rng(1)
    logs = []
    for name in ("step", "sweep", "ramp"):
        steer = manoeuvre(name, p.a + p.b)
        trace = reference_trace("BMW 320i", steer)
        n = len(trace.time)
        logs.append(Log(name, "validation" if name == "ramp" else "train", np.asarray(trace.time, dtype=np.float64), {
            "vx": trace.speed + random.normal(0.0, 0.02, n),
            "road_wheel_angle": np.array([steer.angle(t) for t in trace.time]),
            "yaw_rate": trace.yaw_rate + random.normal(0.0, 0.002, n),
            "lateral_acceleration": trace.lateral_acceleration + random.normal(0.0, 0.05, n),
        }))  # fmt: skip
    parameters = {"mass": Choice(fixed=p.m), "front_length": Choice(fixed=p.a), "rear_length": Choice(fixed=p.b)}
    parameters |= {name: Choice(fixed=0.0) for name in ("steering_delay", "steering_offset", "accelerometer_ahead")}
    found: Any = fit(DataSet(tuple(logs), wheelbase=p.a + p.b), ModelSpec("single_track"), parameters=parameters)
    assert found["cornering_stiffness_front"].value == pytest.approx(axles.front_stiffness, rel=0.15)
    assert found["cornering_stiffness_rear"].value == pytest.approx(axles.rear_stiffness, rel=0.15)
    assert found.channel("yaw_rate", log="ramp").nrmse_percent >= 95.0


# --- a real car --------------------------------------------------------------------------------------------------

DATA = """
mirdrake: data/1
wheelbase: 2.827 m
time: {{column: t_s, unit: s}}
channels:
  vx: {{column: vx_mps, unit: m/s}}
  yaw_rate: {{column: yaw_rate_radps, unit: rad/s}}
  lateral_acceleration: {{column: ay_mps2, unit: m/s^2}}
  longitudinal_acceleration: {{column: ax_mps2, unit: m/s^2}}
  steering_command: {{column: steering_signal_rad, unit: "1"}}
  brake: {{column: brake, unit: "1"}}
logs:
  - {{file: {file}, start: {start} s, end: {end} s, name: log}}
"""
M8 = {"mass": Choice(fixed=2074.4), "front_length": Choice(fixed=1.331), "rear_length": Choice(fixed=1.496)}


def _m8(folder, name, start, end):
    file = LOGS / f"bmw_m8_{name}_100hz.csv"
    if not file.exists():
        pytest.skip("the logs of the real car are not here")
    (folder / "data.yaml").write_text(DATA.format(file=file, start=start, end=end))
    return check_data(load_data(folder / "data.yaml")).data


def test_a_double_lane_change_of_a_real_car_is_followed_but_gives_no_stiffness(tmp_path):
    found: Any = fit(_m8(tmp_path, "double_lane_change", 5.0, 15.3), ModelSpec("single_track"), parameters=M8)
    assert found.channel("yaw_rate", part="train").nrmse_percent >= 93.0
    for name in ("cornering_stiffness_front", "cornering_stiffness_rear"):
        assert found[name].verdict == "not identifiable"
        assert "step steer" in found[name].words
    # Yaw rate is 1.37 times speed · signal / wheelbase: the ratio is the inverse.
    ratio = found["steering_ratio"]
    assert ratio.low < 1.0 / 1.37 < ratio.high


def test_braking_of_a_real_car_gives_deceleration_lag_and_drag_with_intervals(tmp_path):
    data = _m8(tmp_path, "braking", 6.3, 9.7)
    parameters = {"mass": Choice(fixed=2074.4)}
    options = EstimatorOptions(bootstrap=200)
    found: Any = fit(data, ModelSpec("longitudinal", {"drive": "none"}), parameters=parameters, options=options)
    full = found["brake_force"].value / 2074.4
    assert 9.0 < full < 12.5
    for name in ("brake_force", "brake_delay", "brake_lag", "drag", "rolling_resistance"):
        assert found[name].low is not None
        assert found[name].low < found[name].value < found[name].high or found[name].at_bound
    assert found["drag"].verdict == "not identifiable"  # three seconds of hard braking
    assert 0.1 < found["brake_delay"].value + found["brake_lag"].value < 0.6
    assert found.channel("vx", part="train").nrmse_percent > 95.0
