"""Estimators: known truth from short noisy drives, coverage of intervals, clear rejections."""

import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares
from scipy.signal import lfilter

from mirdrake.cli import main
from mirdrake.core.errors import ConfigError
from mirdrake.identification import DataSet, Log
from mirdrake.identification.estimators import EstimatorOptions, fit, output_error
from mirdrake.identification.estimators.bootstrap import block_bootstrap
from mirdrake.identification.estimators.covariance import Stretch, autoregression, score_covariance
from mirdrake.identification.estimators.experiment_design import rank_manoeuvres
from mirdrake.identification.estimators.output_error import initial_noise, prediction_deviations, validate_log
from mirdrake.identification.estimators.problem import Problem
from mirdrake.identification.estimators.segments import make_segments
from mirdrake.identification.estimators.solve import assess, minimise, robust
from mirdrake.identification.fit import load_fit
from mirdrake.identification.identify import identify
from mirdrake.identification.judgement import Direction
from mirdrake.identification.messages import direction
from mirdrake.identification.models import ModelSpec, make_model
from mirdrake.identification.models.filters import backlash, first_order, second_order
from mirdrake.identification.models.manoeuvres import steering_manoeuvres
from mirdrake.identification.parameters import FitParameter, Parameter, Setting, resolve_parameters
from mirdrake.identification.study import load_identification
from mirdrake.identification.validation import input_correlation, noise_limit_nrmse, nrmse, whiteness
from tests.identification_rigs import COAST, FRONT, MASS, REAR, TRUTH, coast_data, lateral_data, lateral_log

ROOT = Path(__file__).resolve().parent.parent


def fitted(*arguments: Any, **options: Any) -> Any:
    """Return a fit, typed as one whose numbers are available."""
    return fit(*arguments, **options)


CAR = {"mass": Setting(fixed=MASS), "front_length": Setting(fixed=FRONT), "rear_length": Setting(fixed=REAR)}
LATERAL = CAR | {"steering_lag": Setting(free=True), "accelerometer_ahead": Setting(free=False)}


def first_rows(log, count):
    return replace(log, time=log.time[:count], channels={name: values[:count] for name, values in log.channels.items()})


@pytest.fixture(scope="module")
def lateral() -> Any:
    logs = (lateral_log(), lateral_log(1, name="held", use="validation"))
    options = EstimatorOptions(bootstrap=200)
    return fitted(DataSet(logs, wheelbase=FRONT + REAR), ModelSpec("single_track"), parameters=LATERAL, options=options)


def test_a_single_track_is_found_again(lateral):
    for name, value in TRUTH.items():
        estimate = lateral[name]
        assert abs(estimate.value - value) < 4.0 * estimate.sigma, name
        if name in {"cornering_stiffness_front", "cornering_stiffness_rear", "yaw_inertia"}:
            assert estimate.value == pytest.approx(value, rel=0.02)
            assert estimate.verdict == "identified"
    assert lateral["mass"].verdict == "fixed"


def test_the_fit_has_the_noise_and_the_validation_fit(lateral):
    for part in ("train", "validation"):
        assert lateral.channel("yaw_rate", part=part).rms == pytest.approx(0.003, rel=0.1)
        assert lateral.channel("yaw_rate", part=part).nrmse_percent > 95.0
        assert lateral.channel("lateral_acceleration", part=part).whiteness_p > 1e-4
    assert lateral.channel("yaw_rate", part="train").prediction_sigma_percent is None
    assert lateral.channel("yaw_rate").prediction_sigma_percent < 2.0
    assert not any("determine" in note for note in lateral.notes)
    assert set(lateral.traces) == {"drive", "held"}
    assert {"t", "yaw_rate", "yaw_rate_model"} <= set(lateral.traces["held"])
    assert lateral.correlation.shape == (6, 6)
    assert 1.0 < lateral.condition_number < 1e6
    lines = lateral.table().splitlines()
    assert any(line.startswith("steering_delay ") for line in lines)
    # Fixed parameters share one line.
    (fixed,) = [line for line in lines if "fixed parameters: " in line]
    assert fixed.split(" ", 1)[0] == str(len(lateral.parameters) - len(lateral.free))


def test_offsets_begin_at_the_median_of_the_residuals():
    """A bias of 0.1 rad/s is 33 times the noise: with an offset of zero all samples would be outliers."""
    offsets = []
    for bias in (0.0, 0.1):
        log = lateral_log()
        log = replace(log, channels={**log.channels, "yaw_rate": log.channels["yaw_rate"] + bias})
        model = make_model(ModelSpec("single_track"), DataSet((log,), wheelbase=FRONT + REAR), {"mass": MASS})
        drives, _ = make_segments(model, (log,))
        unknowns = resolve_parameters(model.parameters, {name: Setting(fixed=value) for name, value in TRUTH.items()})
        problem = Problem(model, drives, unknowns, initial_noise(model, drives))
        z = problem.with_median_offsets(np.zeros(problem.size))
        offsets.append(z[len(problem.free)] * model.offset_scale("yaw_rate"))
        assert np.median(drives[0].outputs["yaw_rate"] - problem.traces(z)[0][0]) == pytest.approx(0.0, abs=1e-9)
    assert offsets[1] - offsets[0] == pytest.approx(0.1, abs=0.002)


def test_the_deviation_of_a_prediction_is_the_change_of_the_outputs_with_a_parameter():
    """A front stiffness that is known to 1 %, and nothing else unknown, against two runs that differ by 1 %."""
    held = lateral_log(1, name="held", use="validation")
    model = make_model(ModelSpec("single_track"), DataSet((held,), wheelbase=FRONT + REAR), {"mass": MASS})
    drives, _ = make_segments(model, (held,))
    problem = Problem(model, drives, resolve_parameters(model.parameters, LATERAL), initial_noise(model, drives), False)
    z = problem.scaled(problem.values(np.zeros(problem.size)) | TRUTH)
    solution: Any = SimpleNamespace(problem=problem, z=z)
    covariance = np.zeros((len(problem.free), len(problem.free)))
    covariance[0, 0] = 0.01**2
    sizes = prediction_deviations(validate_log(held, solution, "linear"), problem, covariance)
    assert problem.free[0].info.name == "cornering_stiffness_front"
    moved = z + 0.01 * np.eye(problem.size)[0]
    change = problem.traces(moved)[0] - problem.traces(z)[0]
    for size, row, name in zip(sizes, change, model.outputs, strict=True):
        expected = 100.0 * np.sqrt(np.mean(row**2)) / np.nanstd(drives[0].outputs[name])
        assert size == pytest.approx(expected, rel=0.05)


def test_a_fit_comes_back_from_its_folder(lateral, tmp_path):
    again = load_fit(lateral.save(tmp_path / "fit"))
    assert again.parameters == lateral.parameters
    assert again.channels == lateral.channels
    assert_allclose(again.correlation, lateral.correlation)
    assert again.traces["held"].equals(lateral.traces["held"])
    (tmp_path / "fit" / "fit.json").write_text("{")
    with pytest.raises(ConfigError, match="damaged"):
        load_fit(tmp_path / "fit")
    with pytest.raises(ConfigError, match="no saved fit"):
        load_fit(tmp_path)


def test_without_a_mass_stiffness_is_per_kilogram():
    parameters = {name: choice for name, choice in LATERAL.items() if name != "mass"}
    fitted_model = fitted(lateral_data(), ModelSpec("single_track"), parameters=parameters)
    estimate = fitted_model["cornering_stiffness_front"]
    assert estimate.unit == "N/(rad kg)"
    assert estimate.value == pytest.approx(TRUTH["cornering_stiffness_front"] / MASS, rel=0.02)
    assert any("per kilogram" in note for note in fitted_model.notes)


def test_a_given_value_that_the_log_contradicts_is_named():
    parameters = LATERAL | {"yaw_inertia": Setting(given=3500.0, source="data sheet")}
    estimate = fitted(lateral_data(), ModelSpec("single_track"), parameters=parameters)["yaw_inertia"]
    assert estimate.verdict == "contradicts the given value"
    assert estimate.given == 3500.0


def test_stiffnesses_of_one_slow_lane_change_are_not_identified():
    log = lateral_log()
    rows = log.time < 4.0
    calm = 0.1 * np.sin(2.0 * log.time)
    short = replace(
        log,
        time=log.time[rows],
        channels={
            "vx": np.full(rows.sum(), 10.0) + 0.02 * calm[rows],
            "road_wheel_angle": 0.01 * calm[rows],
            "yaw_rate": 0.0037 * 10.0 * calm[rows] / 10.0 + np.random.default_rng(0).normal(0.0, 0.002, rows.sum()),
        },
    )
    fitted_model = fitted(DataSet((short,), wheelbase=FRONT + REAR), ModelSpec("single_track"), parameters=CAR)
    for name in ("cornering_stiffness_front", "cornering_stiffness_rear", "yaw_inertia"):
        assert fitted_model[name].verdict == "not identifiable", fitted_model.table()
        assert "step" in fitted_model[name].explanation or "sweep" in fitted_model[name].explanation
    assert fitted_model.advice


def test_combinations_are_products_or_sums():
    a = FitParameter(Parameter("stiffness", "N/rad", "", 1e5, 1.0, 1e9), "free")
    b = FitParameter(Parameter("inertia", "kg m^2", "", 2e3, 1.0, 1e9), "free")
    c = FitParameter(Parameter("delay", "s", "", 0.0, -1.0, 1.0, scale=0.05), "free")
    d = FitParameter(Parameter("lag", "s", "", 0.0, -1.0, 1.0, scale=0.1), "free")
    assert direction(Direction(((a, 0.8), (b, -0.4)), 0.008)) == "stiffness × inertia^-0.5: known to ± 2 %"
    assert direction(Direction(((c, 0.8), (b, 0.4)), 0.008)) == "delay + 0.025 s ln(inertia): known to ± 0.00098 s"
    assert direction(Direction(((c, 0.6), (d, -0.5)), 0.006)) == "delay - 0.42 lag: known to ± 0.00098 s"


def test_a_prior_dominates_where_the_log_has_no_information():
    parameters = LATERAL | {"cornering_stiffness_front": Setting(prior=(80e3, 100.0))}
    estimate = fitted(lateral_data(duration=12.0), ModelSpec("single_track"), parameters=parameters)[
        "cornering_stiffness_front"
    ]
    assert estimate.kind == "prior"
    free = fitted(lateral_data(duration=12.0), ModelSpec("single_track"), parameters=LATERAL)[
        "cornering_stiffness_front"
    ]
    assert 80e3 < estimate.value < free.value
    assert estimate.sigma_noise < min(100.0, free.sigma_noise)


def test_an_estimate_at_its_bound_is_reported():
    parameters = LATERAL | {"yaw_inertia": Setting(high=2000.0)}
    estimate = fitted(lateral_data(duration=12.0), ModelSpec("single_track"), parameters=parameters)["yaw_inertia"]
    assert estimate.at_bound == "high"
    assert estimate.verdict == "not identifiable"


def test_glitches_hardly_move_a_robust_fit():
    log = lateral_log(duration=15.0)
    rate = log.channels["yaw_rate"].copy()
    rate[::97] += 5.0
    data = DataSet((replace(log, channels={**log.channels, "yaw_rate": rate}),), wheelbase=FRONT + REAR)
    fitted_model = fitted(data, ModelSpec("single_track"), parameters=LATERAL)
    assert fitted_model["yaw_inertia"].value == pytest.approx(TRUTH["yaw_inertia"], rel=0.03)


def test_missing_samples_and_a_gap_do_not_matter():
    log = lateral_log()
    channels = {name: values.copy() for name, values in log.channels.items()}
    channels["yaw_rate"][500:650] = np.nan
    keep = (log.time < 14.0) | (log.time > 15.0)
    cut = replace(log, time=log.time[keep], channels={name: values[keep] for name, values in channels.items()})
    fitted_model = fitted(DataSet((cut,), wheelbase=FRONT + REAR), ModelSpec("single_track"), parameters=LATERAL)
    assert fitted_model["yaw_inertia"].value == pytest.approx(TRUTH["yaw_inertia"], rel=0.02)
    assert any("gaps" in note for note in fitted_model.notes)


@pytest.mark.parametrize("continuity", [None, 0.02])
def test_pieces_with_first_states_of_their_own_give_the_same(continuity):
    options = EstimatorOptions(shooting=5.0, continuity=continuity)
    fitted_model = fitted(lateral_data(duration=15.0), ModelSpec("single_track"), parameters=LATERAL, options=options)
    for name in ("cornering_stiffness_front", "yaw_inertia"):
        assert fitted_model[name].value == pytest.approx(TRUTH[name], abs=4.0 * fitted_model[name].sigma)
        assert fitted_model[name].sigma < 0.03 * TRUTH[name]


def test_profile_has_its_minimum_at_the_estimate_and_3_84_at_the_ends_of_the_interval():
    parameters = CAR | {name: Setting(fixed=value) for name, value in TRUTH.items() if name.startswith("steering")}
    parameters |= {"accelerometer_ahead": Setting(free=False)}
    options = EstimatorOptions(profile=True, loss="linear")
    fitted_model = fitted(
        lateral_data(duration=15.0), ModelSpec("single_track"), parameters=parameters, options=options
    )
    estimate, profile = fitted_model["yaw_inertia"], fitted_model.profiles["yaw_inertia"]
    assert profile["cost"].min() == 0.0
    assert profile["value"][profile["cost"].argmin()] == pytest.approx(estimate.value)
    noise = 1.96 * estimate.sigma_noise / estimate.value  # the profile knows nothing of other models
    ends = np.interp(estimate.value * np.exp([-noise, noise]), profile["value"], np.sqrt(profile["cost"]))
    assert ends == pytest.approx([1.96, 1.96], rel=0.25)


def test_drag_and_rolling_resistance_of_a_coast_down():
    parameters = {"mass": Setting(fixed=MASS)}
    fitted_model = fitted(
        coast_data(), ModelSpec("longitudinal", {"drive": "none", "brake": "none"}), parameters=parameters
    )
    for name, value in COAST.items():
        assert fitted_model[name].value == pytest.approx(value, rel=0.02)
        assert fitted_model[name].low < value < fitted_model[name].high


def stretch(noise, slopes=None):
    """One output, one parameter."""
    slopes = np.ones(len(noise)) if slopes is None else slopes
    return Stretch(slopes[:, None, None], noise[:, None], np.ones((len(noise), 1), dtype=bool))


def coloured(count, seed=0, memory=0.7):
    return lfilter([1.0], [1.0, -memory], np.random.default_rng(seed).normal(size=count))


def test_covariance_of_the_sum_of_an_autoregression():
    noise = coloured(50_000)
    assert autoregression([noise])[1] == pytest.approx(-0.7, abs=0.02)
    covariance, forgetful = score_covariance([stretch(noise)])
    assert covariance[0, 0] / len(noise) == pytest.approx(1.0 / 0.3**2, rel=0.1)
    assert forgetful[0, 0] / len(noise) == pytest.approx(1.0 / (1.0 - 0.7**2), rel=0.05)
    # Two halves, of which one does not know of the other, and every second value missing.
    halves, _ = score_covariance([stretch(noise[:25_000]), stretch(noise[25_000:])])
    assert halves[0, 0] == pytest.approx(covariance[0, 0], rel=0.02)
    there = (np.arange(len(noise)) % 2 == 0)[:, None]
    gappy = Stretch(there[:, :, None].astype(float), np.where(there, noise[:, None], 0.0), there)
    assert score_covariance([gappy])[0][0, 0] / len(noise) == pytest.approx(0.5 * 1.49 / 0.51 / 0.51, rel=0.1)


def test_covariance_weighs_the_noise_at_the_frequencies_of_the_slopes():
    """Against the closed form Σ Σ J γ J with the known correlation of the noise."""
    noise = coloured(20_000)
    for pace in (0.02, 0.3):
        slopes = np.sin(pace * np.arange(len(noise)))
        spectrum = 1.0 / abs(1.0 - 0.7 * np.exp(-1j * pace)) ** 2
        covariance, forgetful = score_covariance([stretch(noise, slopes)])
        assert covariance[0, 0] == pytest.approx(spectrum * 0.5 * len(noise), rel=0.1)
    # A fast slope would be known better than with white noise; that is not credible.
    covariance, forgetful = score_covariance([stretch(noise, np.sin(2.5 * np.arange(len(noise))))])
    assert covariance[0, 0] == pytest.approx(forgetful[0, 0], rel=1e-9)


def test_noise_that_is_white_or_grows_with_the_slopes_is_taken_as_it_is():
    random = np.random.default_rng(3)
    slopes = np.abs(np.sin(0.01 * np.arange(20_000)))
    white = random.normal(size=len(slopes))
    assert score_covariance([stretch(white, slopes)])[0][0, 0] == pytest.approx(np.sum(slopes**2), rel=0.04)
    covariance = score_covariance([stretch(white * slopes, slopes)])[0][0, 0]
    assert covariance == pytest.approx(np.sum(slopes**4), rel=0.06)


class MeanProblem:
    """Mean of values as a problem: residuals are values less their mean."""

    def __init__(self, values):
        self.values, self.measured = values, len(values)

    def residuals(self, z):
        return self.values - z[0]

    def jacobian(self, z):
        return -np.ones((self.measured, 1))

    def bounds(self):
        return np.array([-np.inf]), np.array([np.inf])


def test_block_bootstrap_spreads_as_the_mean_does():
    random = np.random.default_rng(0)
    problem: Any = MeanProblem(random.normal(size=4000))
    blocks = [slice(40 * k, 40 * k + 40) for k in range(100)]
    z = np.array([problem.values.mean()])
    draws = block_bootstrap(problem, z, blocks, loss=robust("linear", 4000), count=2000)
    assert float(draws.std()) == pytest.approx(1.0 / 4000**0.5, rel=0.25)


def test_block_bootstrap_with_a_robust_loss_has_the_shifts_of_the_refitted_means():
    random = np.random.default_rng(1)
    problem: Any = MeanProblem(random.standard_t(3.0, size=400))
    loss, blocks = robust("huber", 400), [slice(40 * k, 40 * k + 40) for k in range(10)]

    def mean(times):
        # Iteratively reweighted to convergence (P. J. Huber, Robust Statistics, 1981, section 7.8).
        centre = 0.0
        for _ in range(200):
            weights = times * loss((problem.values - centre) ** 2)[1]
            centre = float(weights @ problem.values / weights.sum())
        return centre

    z = np.array([mean(np.ones(400))])
    draws = block_bootstrap(problem, z, blocks, loss=loss, count=50, seed=2)[:, 0]
    again = np.random.default_rng(2)
    drawn = [np.bincount(again.integers(0, 10, 10), minlength=10) for _ in range(50)]
    expected = np.array([mean(np.repeat(times, 40).astype(float)) for times in drawn]) - z
    assert draws == pytest.approx(expected, abs=0.005 * float(np.ptp(expected)))


def refit(found, options, blocks, weights):
    """Return the shift of the free parameters if each block counts as often as it was drawn, by a complete refit."""
    problem = found.problem
    # Blocks of samples; residuals are stored sample by sample.
    rows = [len(part) * len(problem.masks[0]) for part in np.array_split(np.arange(problem.drives[0].size), blocks)]
    each = np.concatenate([np.repeat(weights, rows), np.ones(problem.rows - problem.measured)])
    loss = robust(options.loss, problem.measured)
    result = least_squares(
        problem.residuals, found.z, jac=problem.jacobian, bounds=problem.bounds(), xtol=1e-7, ftol=1e-8,
        loss=lambda squares: each * loss(squares),
    )  # fmt: skip
    return (result.x - found.z)[: len(problem.free)]


def compare_with_refits(found, options):
    """Compare the intervals of the bootstrap with those of refits to the same draws, and the processor times."""
    # To the very minimum, from which both start.
    found = minimise(found.problem, options, found.z, close=1e-12)
    began = time.process_time()
    draws = assess(found, options).draws
    ours = time.process_time() - began
    assert draws is not None

    began, rng, shifts = time.process_time(), np.random.default_rng(options.seed), []
    drive = found.problem.drives[0]
    # Of 2 s, or a fortieth of the log, as of the bootstrap.
    blocks = drive.size // int(np.ceil(max(2.0, drive.size * drive.step / 40.0) / drive.step))
    for _ in range(options.bootstrap):
        drawn = rng.integers(0, blocks, blocks)
        shifts.append(refit(found, options, blocks, np.bincount(drawn, minlength=blocks).astype(float)))
    theirs = time.process_time() - began
    # The same blocks are drawn, so that no Monte Carlo noise is between both.
    widths = [np.ptp(np.percentile(values, (2.5, 97.5), axis=0), axis=0) for values in (draws, shifts)]
    assert widths[0] == pytest.approx(widths[1], rel=0.02)
    assert ours < 0.1 * theirs, (ours, theirs)


@pytest.mark.slow
def test_a_bootstrap_of_200_has_the_intervals_of_200_refits_in_a_tenth_of_their_time():
    data, options = lateral_data(), EstimatorOptions(bootstrap=200, seed=3)
    model = make_model(ModelSpec("single_track"), data, {"mass": MASS, "front_length": FRONT, "rear_length": REAR})
    drives, _ = make_segments(model, data.train)
    problem = Problem(model, drives, resolve_parameters(model.parameters, LATERAL), initial_noise(model, drives))
    compare_with_refits(minimise(problem, options, passes=3), options)


@pytest.mark.slow
def test_a_bootstrap_of_identify_bolt_has_the_intervals_of_refits_in_a_tenth_of_their_time(tmp_path, monkeypatch):
    # The study with its manoeuvres, as its head states.
    folder = tmp_path / "runs" / "bolt_handling"
    manoeuvres = ["manoeuvre", "frequency_response,step_steer", "bolt@handling", "--set", "plant.contact=point"]
    assert main([*manoeuvres, "--out", str(folder)]) == 0
    (tmp_path / "studies").mkdir()
    study = tmp_path / "studies" / "identify_bolt.yaml"
    study.write_text((ROOT / "studies" / "identify_bolt.yaml").read_text())
    minima: list[Any] = []

    def remember(found, options):
        minima.append(found)
        return assess(found, options)

    monkeypatch.setattr(output_error, "assess", remember)
    identify(load_identification(study), study.parent)
    compare_with_refits(minima[-1], EstimatorOptions(bootstrap=200, seed=3))


def test_steering_with_play_is_found_again():

    time = np.arange(0.0, 30.0, 0.01)
    wheel = 1.5 * np.sin(0.9 * time) + 0.8 * np.clip(30.0 * np.sin(0.37 * time), -1.0, 1.0)
    angle = first_order(np.interp(time - 0.04, time, wheel) / 16.0, 0.01, 0.06)
    angle = backlash(angle, 0.01) + 0.004 + np.random.default_rng(0).normal(0.0, 5e-4, len(time))
    data = DataSet((Log("a", "train", time, {"steering_wheel_angle": wheel, "road_wheel_angle": angle}),))
    fitted_model = fitted(data, ModelSpec("steering"), parameters={"steering_backlash": Setting(guess=0.005)})
    expected = {
        "steering_ratio": 16.0,
        "steering_delay": 0.04,
        "steering_lag": 0.06,
        "steering_backlash": 0.01,
        "steering_offset": 0.004,
    }
    for name, value in expected.items():
        assert fitted_model[name].value == pytest.approx(value, rel=0.02), name


def test_a_joint_loop_is_found_again_with_the_gains_of_its_servo():
    time = np.arange(0.0, 20.0, 0.01)
    command = np.clip(40.0 * np.sin(0.9 * time), -1.0, 1.0) + 0.3 * np.sin(time**2 / 4.0)
    moved = second_order(0.5 * np.interp(time - 0.03, time, command) + 0.01, 0.01, 12.0, 0.6)
    observed = moved + np.random.default_rng(0).normal(0.0, 0.003, len(time))
    data = DataSet((Log("a", "train", time, {"steering_command": command, "road_wheel_angle": observed}),))
    fitted_model = fitted(data, ModelSpec("joint_loop"), parameters={"inertia": Setting(fixed=2.0)})
    for name, value in (("gain", 0.5), ("natural_frequency", 12.0), ("damping_ratio", 0.6), ("delay", 0.03)):
        assert fitted_model[name].value == pytest.approx(value, rel=0.02), name


def test_a_kinematic_car_is_found_again():
    time = np.arange(0.0, 20.0, 0.01)
    v, wheel = 2.0 + np.sin(0.3 * time), 3.0 * np.sin(0.1 * time * time)
    angle = first_order(np.interp(time - 0.05, time, wheel) / 12.0, 0.01, 0.1) + 0.01
    rate = v * np.tan(angle) / 2.5 + np.random.default_rng(0).normal(0.0, 0.001, len(time))
    data = DataSet(
        (Log("a", "train", time, {"vx": v, "steering_wheel_angle": wheel, "yaw_rate": rate}),), wheelbase=2.5
    )
    fitted_model = fitted(data, ModelSpec("kinematic"), parameters={"steering_lag": Setting(free=True)})
    for name, value in (("steering_ratio", 12.0), ("steering_delay", 0.05), ("steering_lag", 0.1)):
        assert fitted_model[name].value == pytest.approx(value, rel=0.02), name


def test_experiment_design_prefers_two_speeds_and_a_coast_down():
    data = lateral_data()
    model = make_model(ModelSpec("single_track"), data, {"mass": MASS, "front_length": FRONT, "rear_length": REAR})
    unknowns = resolve_parameters(model.parameters, LATERAL)
    values = {info.name: info.guess for info in model.parameters} | TRUTH
    order = [
        manoeuvre.name
        for manoeuvre in rank_manoeuvres(model, unknowns, values, {"yaw_rate": 0.003, "lateral_acceleration": 0.1})
    ]
    assert order.index("step steer at two speeds") < order.index("slowly increasing steer")
    assert order.index("swept sine at two speeds") < order.index("steady circle with rising speed")
    data = coast_data()
    model = make_model(ModelSpec("longitudinal"), data, {"mass": MASS})
    held = ("drive_force", "drive_power", "drive_delay", "drive_lag", "brake_force", "brake_delay", "brake_lag")
    unknowns = resolve_parameters(model.parameters, {name: Setting(free=False) for name in held})
    values = {info.name: info.guess for info in model.parameters} | COAST
    gains = {
        manoeuvre.name: manoeuvre.d_gain
        for manoeuvre in rank_manoeuvres(model, unknowns, values, {"vx": 0.03}, speed=30.0)
    }
    assert gains["coast-down"] < 0.3
    assert gains["coast-down"] < gains["brake steps"]


def test_validation_figures():
    random = np.random.default_rng(0)
    white, wave = random.normal(size=2000), np.sin(np.arange(2000) / 50.0)
    assert nrmse(wave, 0.9 * wave) == pytest.approx(90.0, abs=0.1)
    assert np.isnan(nrmse(np.ones(5), np.ones(5)))
    assert whiteness(white) > 0.01
    assert whiteness(np.convolve(white, np.ones(3), "same")) < 1e-6
    assert input_correlation(white, [wave]) > 0.01
    assert input_correlation(white + 0.3 * wave, [wave]) < 0.01


@pytest.mark.parametrize("noise", [0.01, 0.1, 0.5])
def test_the_noise_limit_is_the_fit_of_the_true_model(noise):
    time = np.arange(0.0, 60.0, 0.01)
    exact_ = np.sin(3.0 * time) + (time > 20.0)  # motion with a corner
    observed = exact_ + np.random.default_rng(1).normal(0.0, noise, len(time))
    assert noise_limit_nrmse(observed) == pytest.approx(
        nrmse(observed, exact_), abs=0.02 * (100.0 - nrmse(observed, exact_))
    )
    assert noise_limit_nrmse(np.append(observed, np.nan)) == pytest.approx(noise_limit_nrmse(observed), abs=1e-9)
    assert np.isnan(noise_limit_nrmse(np.ones(100)))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda log: replace(log, channels={"vx": log.channels["vx"]}), "needs the steering"),
        (lambda log: first_rows(log, 0), "is empty"),
        (lambda log: replace(log, time=log.time[::-1].copy()), "times must increase"),
        (
            lambda log: replace(log, channels={**log.channels, "yaw_rate": np.full(len(log.time), 0.1)}),
            "is constant at",
        ),
        (lambda log: replace(log, channels={**log.channels, "vx": np.full(len(log.time), np.nan)}), "0 % of the rows"),
        (lambda log: first_rows(log, 30), "unknowns"),
        (lambda log: replace(log, use="validation"), "for training"),
    ],
)
def test_data_that_cannot_give_a_fit_are_rejected(change, words):
    data = DataSet((change(lateral_log()),), wheelbase=2.7)
    with pytest.raises(ConfigError, match=words) as caught:
        fit(data, ModelSpec("single_track"), parameters=LATERAL)
    assert "\n" not in str(caught.value)


def test_a_fit_without_free_parameters_is_rejected():
    data = lateral_data()
    model = make_model(ModelSpec("single_track"), data, {})
    parameters = {info.name: Setting(free=False) for info in model.parameters}
    with pytest.raises(ConfigError, match="nothing to fit"):
        fit(data, ModelSpec("single_track"), parameters=parameters)
    with pytest.raises(ConfigError, match="no log"):
        fit(DataSet(()), ModelSpec("single_track"))


def test_a_delay_of_vy_is_estimated_and_without_it_the_interval_contains_the_truth():
    log = lateral_log(0, channels=("yaw_rate", "lateral_acceleration", "vy"), duration=40.0)
    late = np.interp(log.time - 0.02, log.time, log.channels["vy"])
    data = DataSet((replace(log, channels={**log.channels, "vy": late}),), wheelbase=FRONT + REAR)
    parameters = LATERAL | {"velocity_ahead": Setting(free=False)}
    model = ModelSpec("single_track", {"tyres": "linear"})
    blind = fitted(data, model, parameters=parameters)["yaw_inertia"]
    assert abs(blind.value / TRUTH["yaw_inertia"] - 1.0) > 0.02  # twice what noise does
    assert blind.low < TRUTH["yaw_inertia"] < blind.high
    assert "whether vy has a delay" in blind.explanation
    seeing = fitted(data, model, parameters=parameters | {"velocity_delay": Setting(free=True)})
    assert seeing["velocity_delay"].value == pytest.approx(0.02, abs=0.001)
    assert seeing["yaw_inertia"].value == pytest.approx(TRUTH["yaw_inertia"], rel=0.01)
    assert seeing["yaw_inertia"].sigma < 0.3 * blind.sigma


@pytest.mark.parametrize(("speed", "wheelbase"), [(2.0, 0.7), (1.0, 3.0), (20.0, 2.7)])
def test_recommended_manoeuvres_are_within_the_steering_limit_and_the_lateral_acceleration(speed, wheelbase):
    """At 2 m/s a wheelbase of 0.7 m needs 0.53 rad for 3 m/s², and 2.1 rad at half of the speed."""
    for name, (angle, v) in steering_manoeuvres(speed, wheelbase).items():
        assert np.max(np.abs(angle)) <= 0.5, name
        lateral = v**2 * np.abs(angle) / wheelbase  # of a neutral-steering car
        limit = 6.0 if name == "slowly increasing steer" else 3.0  # towards the limit of the tyres
        assert np.max(lateral) <= 1.001 * limit, name
    if speed == 20.0:
        (angle, _) = steering_manoeuvres(speed, wheelbase)["step steer"]
        assert np.max(angle) == pytest.approx(3.0 * 2.7 / 400.0)


@pytest.mark.parametrize("guess", [0.6, 1.6])
def test_a_measured_angle_of_the_wheels_determines_an_unknown_wheelbase(guess):
    """The centre of mass is taken to be in the middle; the axle distances of the result follow the estimate."""
    length = FRONT + REAR
    data = replace(lateral_data(seed=3), wheelbase=None)
    settings = {"wheelbase": Setting(guess=guess * length)}
    fit_ = fitted(data, ModelSpec("single_track", {"tyres": "linear", "roll": False}), parameters=settings)
    assert fit_["wheelbase"].value == pytest.approx(length, rel=0.02)
    assert fit_["wheelbase"].verdict == "identified"
    assert fit_["front_length"].value + fit_["rear_length"].value == pytest.approx(fit_["wheelbase"].value)
    assert fit_["front_length"].kind == fit_["rear_length"].kind == "fixed"


def test_axle_distances_follow_a_wheelbase():
    model = make_model(ModelSpec("single_track"), replace(lateral_data(), wheelbase=None), {})
    p = {info.name: info.guess for info in model.parameters} | {
        "wheelbase": 4.0,
        "front_length": 1.0,
        "rear_length": 3.0,
    }
    moved = model.complete({**p, "wheelbase": 2.0})
    assert (moved["front_length"], moved["rear_length"]) == (0.5, 1.5)
    assert model.complete(moved) == moved
    known = make_model(ModelSpec("single_track"), lateral_data(), {})
    assert "wheelbase" not in {info.name for info in known.parameters}
