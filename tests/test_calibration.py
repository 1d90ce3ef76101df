"""Calibration of the identification: its vehicles against closed forms, its draws, its table; and 60 cases."""

import math

import numpy as np
import pandas as pd
import pytest

from benchmarks.calibration.baseline import fit_baseline, simulate
from benchmarks.calibration.cases import draw_case
from benchmarks.calibration.record import record, with_ratio
from benchmarks.calibration.run import ParameterRow, Row, run_case
from benchmarks.calibration.table import make_table
from benchmarks.calibration.truth import GRAVITY, STEP, Vehicle, drive
from mirdrake.identification.data import make_data
from mirdrake.identification.models.first_guess import guess_steering
from mirdrake.identification.study import embedded_data, load_identification

CAR = Vehicle("linear", 1500.0, 1.2, 1.5, 2500.0, 8e4, 1e5, height=0.5, roll_gain=0.007)


@pytest.mark.parametrize(
    ("kind", "tolerance"), [("linear", 1e-3), ("brush", 0.01), ("magic", 0.01), ("two_track", 0.01)]
)
def test_slow_turn_has_the_yaw_rate_of_a_single_track(kind, tolerance):
    """r = v δ / (L + K v²) with K = m (b / Cf - a / Cr) / L (Rajamani, section 3.3), at 0.5 m/s²."""
    speed, angle = np.full(5000, 15.0), np.full(5000, 0.008)
    motion = drive(Vehicle(**{**vars(CAR), "kind": kind}), speed, angle)
    understeer = CAR.mass / CAR.wheelbase * (CAR.rear / CAR.stiffness_front - CAR.front / CAR.stiffness_rear)
    expected = 15.0 * 0.008 / (CAR.wheelbase + understeer * 15.0**2)
    assert motion.yaw_rate[-1] == pytest.approx(expected, rel=tolerance)
    assert STEP * len(motion.time) == pytest.approx(10.0)


def test_axle_force_is_limited_by_friction():
    """At full lock no drive exceeds μ g."""
    motion = drive(Vehicle(**{**vars(CAR), "kind": "brush", "friction": 0.7}), np.full(3000, 10.0), np.full(3000, 0.12))
    assert np.max(np.abs(10.0 * motion.yaw_rate[-500:])) < 0.7 * GRAVITY


def test_a_seed_has_one_case_and_the_vehicles_are_plausible():
    cases = [draw_case(seed) for seed in range(120)]
    assert cases[7] == draw_case(7)
    assert {case.vehicle.kind for case in cases} == {"linear", "brush", "magic", "two_track", "multi_body"}
    assert 0.4 < np.mean([case.is_of_the_fitted_family for case in cases]) < 0.6
    for case in cases:
        assert 0.25 < case.vehicle.wheelbase < 7.0
        assert 10.0 < case.vehicle.mass < 2.1e4
        assert math.isfinite(case.speed)


@pytest.mark.parametrize("wheelbase", [2.7, None])
def test_the_baseline_is_the_same_single_track_and_recovers_it(tmp_path, wheelbase):
    car = Vehicle(**{**vars(CAR), "front": 1.35, "rear": 1.35, "delay": 0.03})
    time = STEP * np.arange(5_000)
    motion = drive(car, 15.0 + np.sin(0.4 * time), 0.02 * np.sin(0.1 * time**2) + 0.01 * np.sin(0.7 * time))
    log = pd.DataFrame({"time": time, "vx": motion.speed, "steer": motion.command, "yaw_rate": motion.yaw_rate})[::5]
    values = np.log([car.stiffness_front / car.mass, car.stiffness_rear / car.mass, car.yaw_inertia / car.mass, 1.0])
    model = simulate(np.array([*values, 0.0, 0.03, np.log(2.7)]), log, "steer")
    assert model == pytest.approx(log["yaw_rate"].to_numpy(), abs=0.02 * log["yaw_rate"].abs().max())
    log.to_parquet(tmp_path / "log.parquet")
    assert fit_baseline([tmp_path / "log.parquet"], tmp_path / "log.parquet", "steer", wheelbase) > 98.0


def test_the_table_counts_coverage_and_wrong_decisions():
    parameter = ParameterRow(
        name="yaw_inertia", verdict="identified", truth=10.0, value=12.0, low=11.0, high=13.0, noise=0.5
    )
    right = ParameterRow(
        name="yaw_inertia", verdict="identified", truth=12.0, value=12.0, low=11.0, high=13.0, noise=0.5
    )
    fitted = Row(
        seed=0, kind="linear", fault="none", knowledge="all", manoeuvres=[], status="fitted", message="", seconds=1.0,
        parameters=[parameter, right], false_repairs=[], false_delays=["vy"], missed=False, limited=True,
        excluded=["vy"], found=[], held_out=90.0, noise_limit=95.0, prediction_sigma=4.0,
        baseline=95.0, notes=[],
    )  # fmt: skip
    rejected = fitted.copy()
    rejected["seed"], rejected["status"], rejected["parameters"] = 1, "rejected", []
    table = make_table([fitted, rejected])
    assert "| coverage, identified | 50 % (1 of 2) | 90 to 99 % |" in table
    assert "excludes the truth | 100 % (1 of 1) | 5 % |" in table
    assert "| false identified | 50 % (1 of 2) |" in table
    assert "| false delays | 100 % (1 of 1) | 2 % |" in table
    assert "| false rejections | 50 % (1 of 2) | 1 % |" in table
    assert "| validation, worse than the baseline by 2 points | 100 % (1 of 1) | 0 |" in table
    assert "| the same where the parameters predict the log to 5 % | 100 % (1 of 1) | 0 |" in table
    assert "| least difference over the stated deviation | -1.2 | > -2 |" in table


@pytest.mark.slow
def test_sixty_cases_run_through():
    rows = [run_case(seed) for seed in range(60)]
    assert "coverage, identified" in make_table(rows)
    assert sum(row["status"] == "fitted" for row in rows) > 45


def test_the_first_guess_of_the_steering_ratio_is_near_where_one_speed_hides_the_understeer(tmp_path):
    """Seed 2054: gain and understeer are hardly separable, and a free regression had a gain 90 times too small."""
    case = with_ratio(draw_case(2054))
    spec = load_identification(record(case, tmp_path))
    guess = guess_steering(make_data(embedded_data(spec), tmp_path).train, case.sensors.steering)
    assert guess is not None
    assert 0.5 < guess.gain * case.vehicle.ratio * case.vehicle.wheelbase < 2.0
