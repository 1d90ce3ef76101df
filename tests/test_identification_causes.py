"""Causes of wrong verdicts that acceptance found: each is a class of drives, by an independent single track."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter

from benchmarks.calibration.cases import draw_case
from benchmarks.calibration.record import record, with_ratio
from benchmarks.calibration.showcase import CAR as SHOWN
from benchmarks.calibration.truth import STEP, Motion, Vehicle, drive
from mirdrake.identification import DataSet, Log
from mirdrake.identification.check import check_data
from mirdrake.identification.data import make_data
from mirdrake.identification.estimators.consistency import Part, variation
from mirdrake.identification.estimators.output_error import between_structures
from mirdrake.identification.estimators.problem import Problem
from mirdrake.identification.estimators.structure import (
    _implausible,
    _is_excused,
    predicts_better,
    rivals_of,
    standard_deviations,
)
from mirdrake.identification.fit import ChannelFit
from mirdrake.identification.identifiability import CALIBRATION, Uncertainty, combinations, judge
from mirdrake.identification.identify import identify
from mirdrake.identification.models import ModelSpec, make_model
from mirdrake.identification.models.single_track_parameters import single_track_parameters
from mirdrake.identification.parameters import FitParameter, Parameter, Setting, resolve_parameters
from mirdrake.identification.plausibility import check_step
from mirdrake.identification.study import embedded_data, load_identification
from mirdrake.report.identification import worst_fit

CAR = Vehicle("linear", 1500.0, 1.2, 1.5, 2400.0, 9e4, 1.1e5)


def recorded(motion: Motion, random: np.random.Generator, late: dict[str, float]) -> DataSet:
    """Return a log at 100 Hz with the noise of usual sensors; delays by channel [s]."""
    time = np.arange(0.2, motion.time[-1] - 0.2, 0.01)
    true = {
        "vx": (motion.speed, 0.03), "yaw_rate": (motion.yaw_rate, 0.003), "yaw_rate@imu": (motion.yaw_rate, 0.003),
        "lateral_acceleration": (motion.rate(motion.lateral) + motion.speed * motion.yaw_rate, 0.05),
        "vy": (motion.lateral, 0.02), "road_wheel_angle": (motion.command, np.deg2rad(0.03)),
    }  # fmt: skip
    channels = {
        name: np.interp(time - late.get(name, 0.0), motion.time, values) + random.normal(0.0, noise, len(time))
        for name, (values, noise) in true.items()
    }
    return DataSet((Log("drive", "train", time, channels),), wheelbase=CAR.wheelbase)


@pytest.mark.parametrize("seed", range(5))
def test_a_circle_with_rising_speed_has_no_delays(seed):
    """30 m at 4 to 12 m/s: nothing fast moves but noise of 0.03 deg, which is no excitation of a delay."""
    time = np.arange(0.0, 60.0, STEP)
    speed = np.linspace(4.0, 12.0, len(time))
    gradient = CAR.mass / CAR.wheelbase * (CAR.rear / CAR.stiffness_front - CAR.front / CAR.stiffness_rear)
    angle = (CAR.wheelbase + gradient * speed**2) / 30.0 * np.minimum(time, 1.0)
    report = check_data(recorded(drive(CAR, speed, angle), np.random.default_rng(seed), {}))
    assert not [finding.channel for finding in report.of("delay") if finding.done or finding.severity != "info"]


@pytest.mark.parametrize("late", ["yaw_rate", "yaw_rate@imu"])
@pytest.mark.parametrize("seed", range(2))
def test_of_two_yaw_rates_the_late_one_is_shifted_alone(late, seed):
    """The clock is that of most channels."""
    random = np.random.default_rng(seed)
    time = np.arange(0.0, 40.0, STEP)
    shape = gaussian_filter1d(random.normal(size=len(time)), 0.2 / STEP)
    motion = drive(CAR, 15.0 + 3.0 * np.sin(0.3 * time), 0.03 * shape / np.std(shape))
    report = check_data(recorded(motion, random, {late: 0.03}))
    shifts: dict[str, float | str] = {}
    for finding in report.of("delay"):
        shifts |= {} if finding.done is None else finding.done.figures
    values = {name: value for name, value in shifts.items() if name not in {"shifts", "together"}}
    assert set(values) == {late}
    assert values[late] == pytest.approx(0.03, abs=0.003)


@pytest.mark.slow
def test_the_shipped_showcase_identifies_a_car_of_another_model():
    """Stiffness, inertia, ratio and delay of a car with two tracks, roll and relaxation lie in their intervals."""
    study = Path(__file__).parents[1] / "studies" / "identify_two_track.yaml"
    fit = identify(load_identification(study), study.parent).fit
    truth = {
        "cornering_stiffness_front": SHOWN.stiffness_front, "cornering_stiffness_rear": SHOWN.stiffness_rear,
        "yaw_inertia": SHOWN.yaw_inertia, "steering_ratio": SHOWN.ratio, "steering_delay": SHOWN.delay,
    }  # fmt: skip
    for name, value in truth.items():
        parameter = fit[name]
        assert parameter.verdict == "identified", name
        assert parameter.low is not None
        assert parameter.high is not None
        assert parameter.low < value < parameter.high, name
    assert min(channel.nrmse_percent for channel in fit.channels if channel.part == "validation") > 90.0


def test_variation_between_logs_is_their_variance_less_that_of_the_noise():
    """Two logs of equal variance v that are d to both sides: the random-effects estimate is 2 d² - v, at least 0."""
    information, weak = 400.0, np.array([[1e-9]])

    def between(shift, noise):
        parts = [
            Part(
                np.array([[information]]),
                np.array([sign * information * shift]),
                np.array([[noise]]),
                np.zeros((0, 1, 1)),
                np.zeros((0, 1)),
            )
            for sign in (-1.0, 1.0)
        ]
        return float(variation(parts, weak)[0])

    variance = 100.0 / information**2
    assert between(0.1, 100.0) == pytest.approx((2.0 * 0.1**2 - variance) ** 0.5, rel=1e-6)
    assert between(0.5 * variance**0.5, 100.0) == 0.0


def test_an_effect_is_kept_if_most_parts_of_the_logs_are_predicted_better():
    plain = np.full(8, 100.0)
    assert predicts_better(plain, plain - np.array([3.0, 2.0, 4.0, 3.0, 2.0, 3.0, 4.0, 3.0]))
    assert not predicts_better(plain, plain - np.array([20.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]))  # one part only
    assert not predicts_better(plain, plain + 1.0)


def test_one_lively_part_does_not_decide_what_is_kept():
    """Seven of eight parts are predicted 30 % better; the sum of the costs would be 1.2 standard errors better."""
    plain = np.array([10_000.0, 100.0, 80.0, 120.0, 90.0, 110.0, 100.0, 90.0])
    added = 0.7 * plain
    added[1] = 101.0
    assert np.sum(plain - added) < 1.5 * np.std(plain - added, ddof=1) * 8**0.5
    assert predicts_better(plain, added)


def test_models_that_predict_as_well_within_a_standard_error_count_as_uncertainty():
    """Their root mean square difference, of logarithms for a positive parameter; a worse model does not count."""
    inertia = FitParameter(Parameter("yaw_inertia", "kg m^2", "", 2000.0, 1.0, 1e5), "free")
    best, other, worse = (
        SimpleNamespace(values={"yaw_inertia": value}, problem=SimpleNamespace(free=[inertia]))
        for value in (2000.0, 2200.0, 4000.0)
    )
    costs = np.full(8, 100.0)
    scatter = np.array([3.0, -3.0, 3.0, -3.0, 3.0, -3.0, 3.0, -3.0])
    trials: list[Any] = [(best, costs), (other, costs + 1.0 + scatter), (worse, costs + 4.0 + scatter)]
    rivals = rivals_of(trials)
    assert [rival["yaw_inertia"] for rival in rivals] == [2000.0, 2200.0]
    solution: Any = SimpleNamespace(problem=SimpleNamespace(free=[inertia]), z=np.zeros(1))
    assert between_structures(solution, rivals) == pytest.approx(np.log(1.1) / 2.0**0.5)
    assert between_structures(solution, ()) == 0.0


@pytest.mark.parametrize("shared", [True, False])
def test_the_memory_that_all_residuals_share_enlarges_all_noise_alike(shared):
    """An autoregression of first order φ counts for (1 - φ²) / (1 + φ²) of its samples (Bartlett)."""
    random, memory = np.random.default_rng(0), 0.9
    white = random.normal(size=(2, 100_000))
    for k in range(2) if shared else (1,):
        white[k] = lfilter([(1.0 - memory**2) ** 0.5], [1.0, -memory], white[k])
    problem: Any = SimpleNamespace(
        traces=lambda _: [white], model=SimpleNamespace(outputs=("yaw_rate", "vy")), _measured=[np.zeros_like(white)],
        masks=[np.ones_like(white, dtype=bool)],
    )  # fmt: skip
    noise = Problem.spread(problem, np.zeros(0))
    expected = ((1.0 + memory**2) / (1.0 - memory**2)) ** 0.5 if shared else 1.0
    assert noise["yaw_rate"] == pytest.approx(expected, rel=0.05)
    assert noise["vy"] == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize(("sigma", "excluded"), [(0.05, True), (0.3, False)])
def test_a_value_that_no_vehicle_has_counts_where_the_logs_exclude_the_range(sigma, excluded):
    """A friction of 2.4 is 0.18 above 2.0 in its logarithm: 3.6 or 0.6 standard deviations."""
    friction = FitParameter(Parameter("friction_rear", "1", "", 0.9, 0.05, 3.0), "free")
    problem: Any = SimpleNamespace(
        free=[friction], jacobian=lambda _: np.array([[1.0 / sigma]]),
        model=SimpleNamespace(plausible_range=lambda *_: (0.05, 2.0)),
    )  # fmt: skip
    minimum: Any = SimpleNamespace(values={"friction_rear": 2.4}, problem=problem, z=np.zeros(1))
    assert standard_deviations(minimum) == pytest.approx(sigma)
    assert _implausible(minimum) == ({"friction_rear": pytest.approx(np.log(1.2))} if excluded else {})


@pytest.mark.parametrize(("share", "expected"), [(0.0, 1.0), (0.03, 1.5), (0.2, 0.2**0.5 * 1e3)])
def test_outliers_are_a_few_samples_and_transients_that_do_not_fit_are_not(share, expected):
    """White residuals of size 1, a share of them of size 1000: their root mean square is the root of the share."""
    random = np.random.default_rng(0)
    off = random.normal(size=(1, 50_000))
    off[:, random.random(50_000) < share] *= 1e3
    problem: Any = SimpleNamespace(
        traces=lambda _: [off], model=SimpleNamespace(outputs=("vy",)), _measured=[np.zeros_like(off)],
        masks=[np.ones_like(off, dtype=bool)],
    )  # fmt: skip
    noise = Problem.spread(problem, np.zeros(0))["vy"]
    # Twice the 95th percentile of the sizes limits the outliers: their root mean square is less than the plain one.
    assert 0.5 * expected < noise < 1.5 * expected


def weave(seed, late):
    """Return a log of random steering."""
    random = np.random.default_rng(seed)
    time = np.arange(0.0, 40.0, STEP)
    shape = gaussian_filter1d(random.normal(size=len(time)), 0.15 / STEP)
    motion = drive(CAR, 15.0 + 3.0 * np.sin(0.3 * time), 0.03 * shape / np.std(shape))
    return recorded(motion, random, late).logs[0]


@pytest.mark.parametrize("seed", range(3))
def test_a_noisy_vy_of_the_wrong_sign_is_found_and_a_late_one_is_not_of_the_wrong_sign(seed):
    log, late = weave(seed, {}), weave(seed, {"vy": 0.12})
    vy = log.channels["vy"] + np.random.default_rng(seed).normal(0.0, 0.03, len(log.time))
    for sign, other, found in ((-1.0, log, True), (1.0, log, False), (1.0, late, False)):
        channels = {**other.channels, "vy": sign * (vy if other is log else other.channels["vy"])}
        report = check_data(DataSet((replace(other, channels=channels),), wheelbase=CAR.wheelbase))
        assert ("vy" in {finding.channel for finding in report.of("units")}) == found
        if found:
            assert not report.of("delay")


@pytest.mark.parametrize("seed", range(3))
def test_a_noisy_accelerometer_does_not_make_the_clock_slow(seed):
    """Noise of the left side raises the reverse regression; the clock is wrong only if both directions show it."""
    log, random = weave(seed, {}), np.random.default_rng(seed)
    time = log.time
    speed, ahead = 15.0 + 1.5 * np.sin(0.4 * time), 0.6 * np.cos(0.4 * time)
    noise = np.repeat(random.normal(0.0, 0.25, len(time) // 40 + 1), 40)[: len(time)]
    channels = {**log.channels, "vx": speed, "longitudinal_acceleration": ahead + noise}
    channels["lateral_acceleration"] = speed * channels["yaw_rate"]
    del channels["vy"]
    noisy = replace(log, channels=channels)
    assert not check_step(noisy, repair=True)[1]
    (found,) = check_step(replace(noisy, time=time / 2.0), repair=True)[1]
    assert found.value == pytest.approx(0.01, rel=0.2)


@pytest.mark.parametrize(
    ("seed", "check"),
    [
        (775, "clock_drift"), (901, "sample_time"), (922, "held_values"), (939, "glitches"), (1021, "glitches"),
        (1044, "glitches"),
    ],
)  # fmt: skip
def test_no_repair_of_a_fault_that_a_drawn_log_does_not_have(seed, check, tmp_path):
    """A sensor ahead in a sweep, one ahead of the centre of mass, coarse speeds, fast motions, also at the end."""
    study = load_identification(record(with_ratio(draw_case(seed)), tmp_path))
    found = [finding for finding in check_data(make_data(embedded_data(study), tmp_path)).of(check) if finding.done]
    assert not [finding.channel for finding in found]


def judged(given, sigma):
    """Return the verdict on a stiffness of 9e4 N/rad, and the combinations; `sigma` of each parameter [1]."""
    motion = drive(CAR, np.full(2000, 15.0), np.zeros(2000))
    known = {"mass": 1500.0, "front_length": 1.2, "rear_length": 1.5, "steering_ratio": 1.0}
    model = make_model(ModelSpec("single_track"), recorded(motion, np.random.default_rng(0), {}), known)
    settings = {name: Setting(fixed=value) for name, value in known.items()}
    stiffness = {"cornering_stiffness_front": 9e4, "cornering_stiffness_rear": 1.4e5}
    settings |= {info.name: Setting(fixed=info.guess) for info in model.parameters if info.name not in settings}
    settings |= {name: Setting(guess=value, free=True) for name, value in stiffness.items()}
    settings["cornering_stiffness_front"] = Setting(guess=9e4, free=True, given=given)
    unknowns = resolve_parameters(model.parameters, settings)
    values = {item.info.name: stiffness.get(item.info.name, item.info.guess) for item in unknowns}
    uncertainty = Uncertainty(np.full(2, sigma), np.eye(2), [None, None])
    parameters = judge(model, unknowns, values, uncertainty)
    return parameters, combinations(model, unknowns, values, sigma**2 * np.eye(2), parameters, uncertainty)


@pytest.mark.parametrize(
    ("sigma", "verdict"),
    [(0.03, "contradicts the given value"), (0.1, "weakly identified"), (0.3, "not identifiable")],
)
def test_a_given_value_outside_of_the_interval_is_reported_whatever_the_verdict(sigma, verdict):
    front, inside = (next(item for item in judged(given, sigma)[0] if item.kind == "free") for given in (3e4, 8.8e4))
    assert front.verdict == verdict
    assert "the given 3e+04 N/rad lies outside of the interval" in front.explanation
    assert "outside" not in inside.explanation


def test_the_understeer_gradient_is_listed_where_both_stiffnesses_are_identified():
    """K = m/L (b/Cf - a/Cr), and its relative deviation by 1 % of each stiffness."""
    parameters, found = judged(9e4, 0.01)
    assert {item.verdict for item in parameters if item.kind == "free"} == {"identified"}
    (gradient,) = (item for item in found if item.name == "understeer gradient")
    parts = np.array([1.5 / 9e4, -1.2 / 1.4e5]) * 1500.0 / 2.7
    assert gradient.value == pytest.approx(parts.sum(), rel=1e-6)
    assert gradient.sigma == pytest.approx(CALIBRATION * 0.01 * np.hypot(*parts), rel=1e-3)


def test_a_noisy_accelerometer_is_not_the_headline_of_a_report():
    """It misses 2 points of what its noise allows, the yaw rate 11."""
    noisy = ChannelFit("log", "train", "lateral_acceleration", "m/s^2", 29.0, 31.0, 1.0)
    missed = ChannelFit("log", "train", "yaw_rate", "rad/s", 88.0, 99.0, 0.01)
    assert worst_fit([noisy, missed]) is missed
    assert worst_fit([missed, noisy]) is missed


@pytest.mark.parametrize(("wheelbase", "deviation"), [(2.7, 0.3), (None, (0.3**2 + 1.0**2) ** 0.5)])
def test_the_prior_of_the_yaw_inertia_includes_the_square_of_an_assumed_wheelbase(wheelbase, deviation):
    parameters = single_track_parameters(
        {}, wheelbase, "steering_command", outputs=("yaw_rate",), tyres="linear", roll=False, relaxation=(),
        compliant=False, damper_lag=False,
    )  # fmt: skip
    usual = {parameter.name: parameter.usual for parameter in parameters}
    assert usual["yaw_inertia"] == pytest.approx(deviation)


def test_an_effect_may_not_move_a_value_further_out_of_range_than_the_plain_model():
    assert _is_excused({}, {})
    assert _is_excused({"steering_delay": 0.4}, {"steering_delay": 0.5})
    assert not _is_excused({"steering_delay": 0.6}, {"steering_delay": 0.5})
    assert not _is_excused({"relaxation": 0.0}, {"steering_delay": 0.5})
