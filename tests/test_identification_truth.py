"""Identification held against truths: many noise seeds, other people's multi-body cars."""

import time
from typing import Any

import numpy as np
import pytest

from mirdrake.identification import DataSet, Log
from mirdrake.identification.estimators import fit
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
