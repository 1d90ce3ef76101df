"""Assumptions of a fit in its intervals: numbers computed by hand on a line."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from mirdrake.core.errors import ConfigError
from mirdrake.identification.estimators import EstimatorOptions, fit
from mirdrake.identification.estimators.problem import Problem
from mirdrake.identification.estimators.sensitivity import assumption_effects, expected_square
from mirdrake.identification.estimators.solve import assess, minimise
from mirdrake.identification.identifiability import CALIBRATION
from mirdrake.identification.models import ModelSpec
from mirdrake.identification.models.base import Assumption, Segment
from mirdrake.identification.models.registry import make_model
from mirdrake.identification.models.simulated import SimulatedModel
from mirdrake.identification.parameters import Parameter, Setting, resolve_parameters
from tests.identification_rigs import COAST, FRONT, MASS, REAR, coast_data, lateral_data

LINEAR = EstimatorOptions(loss="linear", offsets=False)
COUNT, NOISE = 4000, 0.1


class Line(SimulatedModel):
    """y = slope x + bend x², at rest; `curved`: with the bend as a parameter."""

    kind = title = "line"
    states, state_scales, inputs, outputs = ("none",), (1.0,), ("x",), ("y",)

    def __init__(self, assumption=None, *, curved=True):
        self.parameters = (Parameter("slope", "1", "of the line", 1.0, -10.0, 10.0, True, 1.0),)
        if curved:
            self.parameters += (Parameter("bend", "1/m", "of the line", 0.0, -10.0, 10.0, scale=1.0),)
        self._assumption = assumption

    def run(self, p, drive, first):
        x = drive.inputs["x"]
        return (p["slope"] * x + p.get("bend", 0.0) * x**2)[None], first

    def initial_states(self, p, drive, rows):
        return np.zeros((1, len(rows)))

    def assumptions(self, p, assumed):
        return () if self._assumption is None else (self._assumption,)

    def offset_scale(self, channel):
        return 0.0


def drive(bend, seed=0):
    """x is 1 and 2 by turns, so that the best slope for a bend c is off by c Σx³/Σx² = c 9/5."""
    x = np.tile([1.0, 2.0], COUNT // 2)
    y = 3.0 * x + bend * x**2 + np.random.default_rng(seed).normal(0.0, NOISE, COUNT)
    return Segment("line", "train", 0.0, 0.01, {"x": x}, {"y": y})


def effects(model, bend, settings, seed=0):
    problem = Problem(model, [drive(bend, seed)], resolve_parameters(model.parameters, settings), {"y": NOISE}, False)
    solution = assess(minimise(problem, LINEAR, passes=3), LINEAR)
    computed = assumption_effects(solution, LINEAR, lambda options: Line())
    return solution, computed


def test_the_sigma_of_a_fixed_value_widens_the_slope_by_9_over_5_of_it():
    _, computed = effects(Line(), 0.0, {"bend": Setting(fixed=0.0, sigma=0.05)})
    assert computed[0].shift[0] == pytest.approx(-1.8 * 0.05, rel=1e-3)
    # It does not depend on the log: a real bend gives the same shift.
    _, bent = effects(Line(), 0.3, {"bend": Setting(fixed=0.0, sigma=0.05)})
    assert bent[0].shift[0] == pytest.approx(-1.8 * 0.05, rel=1e-3)


@pytest.mark.parametrize(
    ("guess", "unlikely", "distance"), [(5.0, None, 2.0), (5.0, 3.0, 1.0), (5.0, -9.0, 2.0), (1.0, 0.0, 2.0)]
)
def test_a_prior_with_two_halves_counts_on_its_own_side(guess, unlikely, distance):
    """A slope of 3 with the standard deviation 1 by the log is 1 / (1 + 1 / d²) of its way from the guess."""
    model: Any = Line(curved=False)
    model.parameters = (
        Parameter("slope", "1", "of the line", guess, -10.0, 10.0, True, 1.0, usual=2.0, unlikely=unlikely),
    )
    x = np.tile([1.0, 2.0], COUNT // 2)
    log = Segment("line", "train", 0.0, 0.01, {"x": x}, {"y": 3.0 * x})
    noise = float(np.linalg.norm(x))
    problem = Problem(model, [log], resolve_parameters(model.parameters, {}), {"y": noise}, False)
    slope = minimise(problem, LINEAR).values["slope"]
    assert slope == pytest.approx(guess + (3.0 - guess) / (1.0 + distance**-2), abs=1e-4)


@pytest.mark.parametrize("loss", ["huber", "soft_l1"])
def test_the_interval_of_a_robust_fit_is_that_of_an_m_estimator(loss):
    """One noise in five is five times as large; the variance is E ψ² / (E ψ')² over Σ x² (Huber, 1964)."""
    random, width = np.random.default_rng(5), 2.5
    x = np.tile([1.0, 2.0], 10 * COUNT)
    noise = random.normal(0.0, NOISE, len(x)) * np.where(random.random(len(x)) < 0.2, 5.0, 1.0)
    log = Segment("line", "train", 0.0, 0.01, {"x": x}, {"y": 3.0 * x + noise})
    model = Line(curved=False)
    problem = Problem(model, [log], resolve_parameters(model.parameters, {}), {"y": NOISE}, False)
    options = replace(LINEAR, loss=loss)
    sigma = float(assess(minimise(problem, options), options).covariance[0, 0]) ** 0.5

    def score(r):
        return np.clip(r, -width, width) if loss == "huber" else r / np.sqrt(1.0 + (r / width) ** 2)

    def mean(of):
        return quad(lambda r: of(r) * (0.8 * norm.pdf(r) + 0.2 * norm.pdf(r, 0.0, 5.0)), -60.0, 60.0, limit=500)[0]

    slope = mean(lambda r: (score(r + 1e-5) - score(r - 1e-5)) / 2e-5)
    expected = NOISE * (mean(lambda r: score(r) ** 2) / slope**2 / float(x @ x)) ** 0.5
    assert sigma == pytest.approx(expected, rel=0.01)


class SumLine(Line):
    """y = slope x + bend x² + twist x³, where the sum of bend and twist is known."""

    def __init__(self):
        super().__init__()
        self.parameters += (Parameter("twist", "1/m^2", "of the line", 0.0, -10.0, 10.0, scale=1.0),)

    def run(self, p, drive, first):
        y, first = super().run(p, drive, first)
        return y + p["twist"] * drive.inputs["x"] ** 3, first

    def complement(self, name):
        return {"bend": "twist", "twist": "bend"}.get(name)


def test_of_two_values_with_a_known_sum_the_error_of_one_is_that_of_the_other():
    # Σx³/Σx² = 9/5 of the bend, less Σx⁴/Σx² = 17/5 of the twist, which is off by as much to the other side.
    _, computed = effects(SumLine(), 0.0, {"bend": Setting(fixed=0.0, sigma=0.05), "twist": Setting(fixed=0.0)})
    assert [effect.shift[0] for effect in computed] == pytest.approx([(17.0 - 9.0) / 5.0 * 0.05], rel=1e-3)
    # Two values with their own standard deviations are independent.
    both = {name: Setting(fixed=0.0, sigma=0.05) for name in ("bend", "twist")}
    _, computed = effects(SumLine(), 0.0, both)
    assert [effect.shift[0] for effect in computed] == pytest.approx([-1.8 * 0.05, -3.4 * 0.05], rel=1e-3)


def test_the_shape_of_a_magic_formula_is_an_assumption_until_it_is_given():
    model = make_model(ModelSpec("single_track", {"tyres": "magic_formula"}), lateral_data(), {})
    values = {info.name: info.guess for info in model.parameters}
    shapes = {"shape_front", "shape_rear"}
    found = [one for one in model.assumptions(values, frozenset(values)) if set(one.changes) == shapes]
    assert len(found) == 1
    assert found[0].changes["shape_front"] - values["shape_front"] == pytest.approx(0.2 * found[0].fraction)
    assert not [one for one in model.assumptions(values, frozenset(values) - shapes) if set(one.changes) == shapes]


def test_an_omitted_effect_counts_as_far_as_the_log_supports_it():
    """Information on the bend, the slope taken out: Σx⁴ - (Σx³)²/Σx² = n (17 - 81/5)/2 = 0.4 n over the noise."""
    lack = Assumption("a bend", "draw it straight", {"bend": 0.5}, 1.0, {"curved": True}, is_omitted=True)
    variance = NOISE**2 / (0.4 * COUNT) / 0.5**2
    for bend in (0.0, 0.02, 0.2):
        solution, computed = effects(Line(lack, curved=False), bend, {})
        x, y = solution.problem.drives[0].inputs["x"], solution.problem.drives[0].outputs["y"]
        best = np.linalg.lstsq(np.column_stack((x, x**2)), y, rcond=None)[0][1] / 0.5
        spread = float(np.std(y - np.polyval(np.array([best * 0.5, (x @ (y - best * 0.5 * x**2)) / (x @ x), 0.0]), x)))
        assert spread == pytest.approx(NOISE, rel=0.05)
        size = expected_square(best, variance * (solution.problem.sigmas["y"] / NOISE) ** 2)
        assert abs(computed[0].shift[0]) == pytest.approx(1.8 * 0.5 * size**0.5, rel=0.15)
    # The bend of 0.2 is in the interval with its own size, and one that is not there is not.
    assert abs(computed[0].shift[0]) == pytest.approx(1.8 * 0.2, rel=0.1)
    none = [abs(effects(Line(lack, curved=False), 0.0, {}, seed)[1][0].shift[0]) for seed in range(20)]
    assert np.median(none) < 0.2 * 0.5 * 1.8 * math.sqrt(variance)


@pytest.mark.parametrize(("estimate", "variance"), [(0.0, 0.01), (0.3, 0.01), (0.5, 0.3), (1.0, 100.0), (2.0, 1e-4)])
def test_mean_square_is_that_of_a_spike_and_a_slab(estimate, variance):
    sigma = variance**0.5

    def slab(q):
        return norm.pdf(q) * norm.pdf(estimate, q, sigma)

    near = estimate / (1.0 + variance), (variance / (1.0 + variance)) ** 0.5
    ends = near[0] - 10.0 * near[1], near[0] + 10.0 * near[1]
    evidence = quad(slab, *ends)[0]
    expected = quad(lambda q: q * q * slab(q), *ends)[0] / (evidence + norm.pdf(estimate, 0.0, sigma))
    assert expected_square(estimate, variance) == pytest.approx(expected, rel=1e-6)


def test_an_uncertain_mass_widens_the_stiffness_but_not_the_delay():
    """Motion determines force over mass: a mass of ± 2 % makes stiffness and inertia uncertain by 2 %."""
    known = {"front_length": Setting(fixed=FRONT), "rear_length": Setting(fixed=REAR)}
    spec = ModelSpec("single_track", {"relaxation": False, "roll": False, "tyres": "linear"})
    rest = {
        "steering_lag": Setting(free=True),
        "load_transfer": Setting(fixed=0.0),
        "accelerometer_ahead": Setting(free=False),
        "accelerometer_delay": Setting(fixed=0.0),
        "front_drive": Setting(fixed=0.5),
        "front_brake": Setting(fixed=0.6),
    }
    fitted_model: Any = fit(
        lateral_data(), spec, parameters={**known, **rest, "mass": Setting(fixed=MASS, sigma=0.02 * MASS)}
    )
    for name in ("cornering_stiffness_front", "cornering_stiffness_rear", "yaw_inertia"):
        parameter = fitted_model[name]
        assert parameter.sigma_model == pytest.approx(0.02 * parameter.value, rel=0.02)
        assert parameter.sigma == pytest.approx(CALIBRATION * math.hypot(parameter.sigma_noise, parameter.sigma_model))
        assert parameter.verdict == "identified"
        assert 0.5 * (parameter.high - parameter.low) == pytest.approx(1.96 * parameter.sigma, rel=0.01)
    assert fitted_model["steering_delay"].sigma_model < 0.05 * fitted_model["steering_delay"].sigma_noise


def test_an_assumed_centre_of_mass_is_in_the_interval_with_its_reason():
    spec = ModelSpec("single_track", {"relaxation": False, "roll": False, "tyres": "linear"})
    fitted_model: Any = fit(
        lateral_data(), spec, parameters={"mass": Setting(fixed=MASS), "steering_lag": Setting(free=True)}
    )
    for name, truth in (("cornering_stiffness_front", 90e3), ("cornering_stiffness_rear", 110e3)):
        parameter = fitted_model[name]
        assert parameter.verdict == "weakly identified"
        assert "where the centre of mass is: give front_length and rear_length" in parameter.explanation
        assert parameter.low < truth < parameter.high
        assert abs(parameter.value - truth) > 3.0 * parameter.sigma_noise
    text = fitted_model.table()
    assert "± noise" in text
    assert "± model" in text


def test_a_coast_down_determines_resistance_per_mass_on_a_road_that_may_slope():
    """The speed shows (c + γ) m g and D over m + mr: 3 % of m in mr are 3 % of both, 0.001 of γ is 0.001 of c."""
    spec = ModelSpec("longitudinal", {"drive": "none", "brake": "none"})
    settings = {"mass": Setting(fixed=MASS), "viscous_resistance": Setting(fixed=0.0)}
    fitted_model: Any = fit(coast_data(), spec, parameters=settings)
    rolling, drag = COAST["rolling_resistance"], COAST["drag"]
    assert fitted_model["rolling_resistance"].sigma_model == pytest.approx(math.hypot(0.001, 0.03 * rolling), rel=0.02)
    assert fitted_model["drag"].sigma_model == pytest.approx(0.03 * drag, rel=0.02)
    assert (
        "depends on the slope of the road: drive in both directions" in fitted_model["rolling_resistance"].explanation
    )
    assert "depends on the mass of rotating parts: give rotating_mass" in fitted_model["drag"].explanation
    # The deceleration goes with neither: it has the noise alone.
    (text,) = (text for text in fitted_model.combinations if text.startswith("deceleration without pedals at 20 m/s"))
    value, _, error, _ = text.split(": ")[1].split(" ")
    assert float(value) == pytest.approx(rolling * 9.80665 + 400.0 * drag / MASS, rel=1e-3)
    assert float(error) < 1e-3


def test_omitted_viscous_resistance_widens_what_it_would_bias():
    spec = ModelSpec("longitudinal", {"drive": "none", "brake": "none"})
    known = dict.fromkeys(("rotating_mass", "slope"), Setting(fixed=0.0)) | {"mass": Setting(fixed=MASS)}
    fitted_mass: Any = fit(coast_data(), spec, parameters=known)
    sure: Any = fit(coast_data(), spec, parameters={**known, "viscous_resistance": Setting(fixed=0.0)})
    for name in COAST:
        assert sure[name].sigma_model == 0.0
        assert sure[name].sigma_noise < fitted_mass[name].sigma_model < 0.01 * fitted_mass[name].value


def test_a_standard_deviation_is_that_of_a_fixed_value():
    parameters = Line().parameters
    with pytest.raises(ConfigError, match="sigma must be positive"):
        resolve_parameters(parameters, {"bend": Setting(fixed=0.0, sigma=0.0)})
    with pytest.raises(ConfigError, match="give a prior"):
        resolve_parameters(parameters, {"slope": Setting(sigma=0.1)})
    assert replace(resolve_parameters(parameters, {"bend": Setting(fixed=1.0, sigma=0.1)})[1], sigma=None).sigma is None
