"""Models of identification: their integration against scipy, their derivatives against differences, filters, errors."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import root

from mirdrake.core.constants import GRAVITY
from mirdrake.core.errors import ConfigError
from mirdrake.identification import DataSet, Log
from mirdrake.identification.estimators.problem import Problem
from mirdrake.identification.estimators.segments import make_segments
from mirdrake.identification.estimators.shooting import make_shots, simulate
from mirdrake.identification.models import MODELS, ModelSpec, make_model
from mirdrake.identification.models import single_track as module
from mirdrake.identification.models.base import Segment
from mirdrake.identification.models.equations import EquationModel
from mirdrake.identification.models.filters import backlash, first_order, second_order, smooth_between
from mirdrake.identification.models.single_track_equations import (
    TrackInputs,
    TrackState,
    accelerations,
    axle_forces,
    lateral_force,
    slip_angles,
    total_force,
)
from mirdrake.identification.parameters import Setting, resolve_parameters
from mirdrake.single_track import SingleTrack, SingleTrackParameters
from mirdrake.single_track.dynamics import Variant
from mirdrake.tyres.brush import brush_lateral_force
from tests.identification_rigs import FRONT, MASS, REAR, TRUTH, exact, lateral_data

KNOWN = {"mass": MASS, "front_length": FRONT, "rear_length": REAR}
HELD = {name: Setting(fixed=value) for name, value in KNOWN.items()} | {"accelerometer_ahead": Setting(free=False)}


def single_track(**options):
    return make_model(ModelSpec("single_track", options), lateral_data(), KNOWN)


@pytest.mark.parametrize("speed", [6.0, 15.0])
def test_the_force_of_the_wheels_in_a_steady_turn_is_what_slip_dissipates(speed):
    """X vx of a rear axle equals the lateral forces times the lateral velocities of the axles along them."""
    model = single_track()
    p = {info.name: info.guess for info in model.parameters} | TRUTH | {"front_drive": 0.0, "front_brake": 0.0}
    numbers, delta = model._numbers(p), 0.12
    u = np.array([delta, speed, 0.0, 0.0, 0.0])
    steady = root(lambda x: model.rates(x[:, None, None], u[:, None, None], p)[:, 0, 0], np.zeros(2), tol=1e-13).x
    state, inputs = TrackState(*steady), TrackInputs(*u)
    front, rear = forces_of(model, steady, u, p, slip_angles(model._flags([p]), numbers, state, inputs))
    across = (state.vy + FRONT * state.yaw_rate) * np.cos(delta) - speed * np.sin(delta)
    dissipated = -front * across - rear * (state.vy - REAR * state.yaw_rate)
    assert dissipated > 0.0
    assert total_force(numbers, state, inputs) * speed == pytest.approx(dissipated, rel=1e-6)


def test_wheels_that_roll_without_slip_need_no_force_in_a_turn():
    model = single_track()
    p = {info.name: info.guess for info in model.parameters} | TRUTH
    rate = 5.0 * math.tan(0.4) / (FRONT + REAR)
    state = TrackState(vy=REAR * rate, yaw_rate=rate)
    force = total_force(model._numbers(p), state, TrackInputs(0.4, 5.0, 0.0, 0.0, 0.0))
    assert force == pytest.approx(0.0, abs=1e-9 * MASS)


def forces_of(model, x, u, p, slips=(0.0, 0.0)):
    """Return the lateral forces of the axles."""
    return axle_forces(model._flags([p]), model._numbers(p), model._states_of(x), TrackInputs(*u), *slips)


@pytest.mark.parametrize("step", [0.01, 0.005])  # at 200 Hz, the mean of two samples
def test_single_track_equals_equations_written_independently(step):
    time, clean = exact(step=step)
    model = make_model(ModelSpec("single_track"), lateral_data(), KNOWN)
    p = {info.name: info.guess for info in model.parameters} | TRUTH
    (drive,), notes = make_segments(model, (Log("exact", "train", time, clean),))
    assert drive.step == pytest.approx(0.01)
    assert notes == ([] if step == 0.01 else ["log exact: averaged over 2 samples to 100 Hz"])
    run = simulate(model, make_shots(model, drive, p), [p], np.array([0.0, 0.0]), derivatives=False)
    assert run is not None
    begin = 0 if step == 0.01 else 100  # the first mean is 2.5 ms after the start, whose states are given
    for i, name in enumerate(model.outputs):
        # Straight lines between samples of the steering are the difference.
        off = (run.y[i] - drive.outputs[name])[begin:]
        assert np.max(np.abs(off)) < 2e-3 * np.max(np.abs(clean[name]))


def test_logs_of_a_small_car_are_averaged_to_its_own_time_scale():
    """Time scales with the square root of the length: 5 ms for 0.3 m, 10 ms for a car."""
    time, clean = exact(duration=5.0, step=0.001)
    model = make_model(ModelSpec("single_track"), lateral_data(), {"front_length": 0.14, "rear_length": 0.16})
    (drive,), _ = make_segments(model, (Log("exact", "train", time, clean),))
    assert drive.step == pytest.approx(0.005)


@pytest.mark.parametrize("count", [1, 7])
def test_shots_form_one_trajectory(count):
    model = single_track(tyres="fiala")
    model.uses_machine_code = False  # which needs no shots
    p = {info.name: info.guess for info in model.parameters}
    (drive,), _ = make_segments(model, lateral_data().logs)
    shots = make_shots(model, drive, p)
    whole = simulate(model, shots, [p], np.zeros(2), derivatives=False)
    shots = make_shots(model, drive, p)
    shots.length, shots.count = (drive.size, 1) if count == 1 else (-(-drive.size // count), count)
    shots.times = np.arange(shots.count * shots.length * 2 * shots.substeps + 1) * drive.step / (2 * shots.substeps)
    shots.nodes = np.zeros((2, shots.count))
    other = simulate(model, shots, [p], np.zeros(2), derivatives=False)
    assert whole is not None
    assert other is not None
    assert other.y == pytest.approx(whole.y, abs=1e-7)


@pytest.mark.parametrize("tyres", ["linear", "fiala", "magic_formula"])
def test_derivatives_of_the_residuals_equal_differences(tyres):
    options = {"tyres": tyres, "relaxation": tyres == "fiala"}
    model = make_model(ModelSpec("single_track_roll", options), lateral_data(), KNOWN)
    settings = HELD | {"steering_lag": Setting(guess=0.05), "steering_delay": Setting(guess=0.033)}
    settings |= {
        "roll_steer": Setting(free=True),
        "roll_steer_rear": Setting(free=True),
        "accelerometer_height": Setting(guess=0.4),
        "roll_arm": Setting(guess=0.3),
    }
    if options["relaxation"]:
        settings |= {"relaxation_front": Setting(guess=0.5), "trail_rear": Setting(guess=0.03)}
    drives, _ = make_segments(model, lateral_data().logs, 8.0)
    sigmas = {"yaw_rate": 0.003, "lateral_acceleration": 0.1}
    problem = Problem(model, drives, resolve_parameters(model.parameters, settings), sigmas, joined=0.1)
    z = np.random.default_rng(1).normal(0.0, 0.02, problem.size)
    slopes = problem.jacobian(z)
    for i in range(problem.size):
        step = np.zeros(problem.size)
        step[i] = 1e-4
        around = (problem.residuals(z + step) - problem.residuals(z - step)) / 2e-4
        assert np.linalg.norm(slopes[:, i] - around) < 2e-3 * np.linalg.norm(around) + 1e-6, i


def test_relaxation_and_roll_are_those_of_the_reduced_model():
    """Return the same car in both models, fast enough for tyre relaxation and roll to matter."""
    p = SingleTrackParameters(
        mass=MASS, yaw_inertia=2400.0, front_length=FRONT, rear_length=REAR, front_stiffness=9e4, rear_stiffness=1.1e5,
        front_relaxation=0.5, rear_relaxation=0.4, roll_mass=1300.0, roll_height=0.45, roll_inertia=500.0,
        roll_stiffness=9e4, roll_damping=3e3,
    )  # fmt: skip
    arm = p.roll_mass * p.roll_height
    righting = p.roll_stiffness - arm * GRAVITY
    inertia = p.roll_inertia + arm * p.roll_height - arm * arm / p.mass
    natural = (righting / inertia) ** 0.5
    values = {
        "cornering_stiffness_front": 9e4, "cornering_stiffness_rear": 1.1e5, "yaw_inertia": 2400.0,
        "relaxation_front": 0.5, "relaxation_rear": 0.4, "roll_arm": arm / p.mass, "roll_gain": arm / righting,
        "roll_frequency": natural, "roll_damping": 0.5 * p.roll_damping / (natural * inertia),
    }  # fmt: skip
    model = make_model(ModelSpec("single_track_roll", {"relaxation": True}), lateral_data(), KNOWN)
    assert isinstance(model, EquationModel)
    other = SingleTrack(p, Variant("linear", relaxation=True, roll=True))
    context = other.CreateDefaultContext()
    random = np.random.default_rng(3)
    for _ in range(5):
        vx, delta = 20.0, float(random.normal(0.0, 0.02))
        ours = random.normal(0.0, 0.02, 6)
        names = ("vy", "yaw_rate", "roll", "roll_rate", "front_slip", "rear_slip")
        states = dict.fromkeys(other.state_names, 0.0) | {"vx": vx} | dict(zip(names, ours, strict=True))
        context.SetContinuousState([states[name] for name in other.state_names])
        other.GetInputPort("steering").FixValue(context, [delta])
        other.GetInputPort("forces").FixValue(context, [0.0, 0.0])
        rates = dict(zip(other.state_names, other.EvalTimeDerivatives(context).CopyToVector(), strict=True))
        p_all = {info.name: info.guess for info in model.parameters} | values
        actual = model.rates(ours, np.array([delta, vx, 0.0, 0.0, 0.0]), p_all)
        theirs = [rates[name] for name in names]
        assert actual == pytest.approx(theirs, rel=0.01, abs=0.02)


YIELDING = KNOWN | {
    "roll_gain": 0.009, "roll_steer": -0.07, "roll_steer_rear": -0.05, "roll_moment": -3000.0, "camber_moment": -1200.0,
    "relaxation_front": 0.4, "relaxation_rear": 0.35, "trail_front": 0.036, "trail_rear": 0.028,
    "wheel_momentum": 13.0, "spin_inertia": 24.0, "steering_compliance": 2e-5, "steering_compliance_time": 0.02,
}  # fmt: skip


def yielding(kind="single_track_roll"):
    model = make_model(ModelSpec(kind), lateral_data(), YIELDING)
    names = {info.name for info in model.parameters}
    values = {name: value for name, value in YIELDING.items() if name in names}
    return model, {info.name: info.guess for info in model.parameters} | values


def test_a_compliant_steering_deflects_under_the_moments_of_its_wheels():
    """A spring with a damper, 1 / s = 50 kN m/rad, pushed by a moment that is worked out by hand."""
    model, p = yielding()
    # Slip of 0.01 and -0.07 of a roll of 0.02: 90 kN/rad (0.01 + 0.0014) to the right.
    p |= {"cornering_stiffness_front": 9e4}
    force = -9e4 * (0.01 + 0.07 * 0.02)
    moment = -0.036 * force - 1200.0 * 0.02 - 0.5 * 13.0 * 20.0 * 0.1
    state = np.array([0.0, 0.0, 0.02, 0.1, 0.01, 0.0, 0.0004])
    rates = dict(zip(model.states, model.rates(state, np.array([0.0, 20.0, 0.0, 0.0, 0.0]), p), strict=True))
    assert rates["steering_deflection"] == pytest.approx((2e-5 * moment - 0.0004) / 0.02)
    # The tyres slip by where the wheels are.
    assert rates["slip_front"] == pytest.approx(20.0 * (-0.0004 - 0.01) / 0.4)


@pytest.mark.parametrize("kind", ["single_track", "single_track_roll"])
def test_understeer_gradient_is_that_of_the_equations_at_rest(kind):
    model, p = yielding(kind)
    speed, angle = 20.0, 1e-4

    def rest(x):
        return model.rates(x, np.array([angle, speed, 0.0, 0.0, 0.0]), p) * np.array(model.state_scales)

    x = root(rest, np.zeros(len(model.states)), tol=1e-13).x
    turn = x[model.states.index("yaw_rate")]
    side = speed * turn
    gradient = (angle - (FRONT + REAR) * turn / speed) / side
    assert model.derived_quantities(p)["understeer gradient"][0] == pytest.approx(gradient, rel=1e-4)


def test_spinning_wheels_resist_yawing():
    model, p = yielding()
    p["spin_inertia"] = 0.0
    state, inputs = np.array([0.0, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0]), np.array([0.0, 20.0, 0.0, 0.0, 0.0])
    plain, heavy = (
        model.rates(state, inputs, p | {"spin_inertia": extra})[1] for extra in (0.0, 0.1 * p["yaw_inertia"])
    )
    assert heavy == pytest.approx(plain / 1.1)


def test_the_reaction_of_steering_turns_the_car_the_other_way():
    """A moment of 1.5 kg m² times 4 rad/s² on 2500 + 24 kg m²."""
    model, p = yielding()
    p |= {"steering_inertia": 1.5, "yaw_inertia": 2500.0, "spin_inertia": 24.0}
    plain, quick = (model.rates(np.zeros(7), np.array([0.0, 20.0, 0.0, 0.0, rate]), p)[1] for rate in (0.0, 4.0))
    assert quick - plain == pytest.approx(-1.5 * 4.0 / 2524.0)


def test_wheels_that_yaw_and_are_steered_roll_the_body():
    """Gyroscopes of 13 kg m times 20 m/s: 260 N m s times 0.2 rad/s and, for the front half, 0.1 rad/s.

    In a turn without side force that is (52 + 13) N m of the moment with which m h ay + H vx r = (720 + 13) kg m times
    1 m/s² would roll the body by the gain.
    """
    model, p = yielding()
    p |= {"mass": 1500.0, "roll_arm": 0.48, "roll_gain": 0.009, "roll_frequency": 10.0, "wheel_momentum": 13.0}
    state = np.zeros(7)
    state[model.states.index("yaw_rate")] = 0.2
    rates = model.rates(state, np.array([0.0, 20.0, 0.0, 0.1, 0.0]), p)[model.states.index("roll_rate")]
    assert rates == pytest.approx(10.0**2 * 0.009 * (52.0 + 13.0) / 733.0)


def test_a_damper_in_series_with_a_tyre_lags():
    """The damper acts on its own rate, which follows the roll rate with its time constant."""
    given = YIELDING | {"roll_damper_time": 0.01}
    model = make_model(ModelSpec("single_track_roll"), lateral_data(), given)
    assert isinstance(model, EquationModel)
    p = {info.name: info.guess for info in model.parameters} | {"roll_frequency": 10.0, "roll_damping": 0.3}
    p |= {"roll_damper_time": 0.01}
    state = np.zeros(len(model.states))
    state[[model.states.index("roll_rate"), model.states.index("damper_rate")]] = 0.5, 0.2
    rates = dict(zip(model.states, model.rates(state, np.array([0.0, 20.0, 0.0, 0.0, 0.0]), p), strict=True))
    assert rates["roll_rate"] == pytest.approx(-2.0 * 0.3 * 10.0 * 0.2)
    assert rates["damper_rate"] == pytest.approx((0.5 - 0.2) / 0.01)


def test_the_air_moves_load_to_the_rear():
    """0.5 N s²/m² at 20 m/s are 200 N; 0.3 m high they move 60 N m, over the static moments of the loads."""
    model, p = yielding()
    p |= {"load_transfer": 0.3, "drag": 0.5, "mass": 1500.0}
    state, inputs = np.zeros(7), np.array([0.0, 20.0, 0.0, 0.0, 0.0])
    state[4:6] = -0.01, -0.01  # slips
    calm, windy = (forces_of(model, state, inputs, p | {"drag": drag}) for drag in (0.0, 0.5))
    weight = 1500.0 * 9.80665
    assert windy[0] / calm[0] == pytest.approx(1.0 - 60.0 / (weight * REAR))
    assert windy[1] / calm[1] == pytest.approx(1.0 + 60.0 / (weight * FRONT))


def test_longitudinal_force_of_the_front_axle_follows_its_wheels():
    """0.5 N s²/m² at 20 m/s and 0.2 m/s² of 1500 kg are 500 N, of which 0.05 rad turn 25 N to the left.

    Braking with 1 m/s² takes 1300 N beside the air, the part of the front wheels of which pulls to the right.
    """
    model, p = yielding()
    p |= {"drag": 0.5, "mass": 1500.0}

    def side(rate, **shares):
        inputs = np.array([0.05, 20.0, rate, 0.0, 0.0])
        numbers = model._numbers(p | shares)
        return accelerations(model._flags([p]), numbers, TrackState(), TrackInputs(*inputs), 0.0, 0.0)[0]

    drives, brakes = {"front_drive": 1.0, "front_brake": 0.0}, {"front_drive": 0.0, "front_brake": 0.6}
    assert side(0.2, **drives) - side(0.2, **brakes) == pytest.approx(500.0 * math.sin(0.05) / 1500.0)
    assert side(-1.0, **brakes) - side(-1.0, **drives) == pytest.approx(-0.6 * 1300.0 * math.sin(0.05) / 1500.0)


def test_a_lateral_velocity_measured_on_the_roof_contains_roll():
    """The velocity of a point of a rigid body: v + ω x p, with p 1.2 m ahead and 0.9 m above the roll axis."""
    model = make_model(ModelSpec("single_track_roll", {"outputs": ["vy"]}), lateral_data(channels=["vy"]), KNOWN)
    assert isinstance(model, EquationModel)
    p = {info.name: info.guess for info in model.parameters} | {"velocity_ahead": 1.2, "velocity_height": 0.9}
    vy, spin, roll, roll_rate = 0.3, 0.2, 0.01, -0.15
    observed = model.observe(np.array([vy, spin, roll, roll_rate]), np.array([0.02, 20.0, 0.0, 0.0, 0.0]), p)
    theirs = np.array([20.0, vy, 0.0]) + np.cross([roll_rate, 0.0, spin], [1.2, 0.0, 0.9])
    assert observed == pytest.approx(theirs[1:2])


def test_fiala_force_is_that_of_the_reduced_model():
    flags = single_track(tyres="fiala")._flags([{}])
    slip = np.linspace(-0.4, 0.4, 41)
    ours = lateral_force(flags, slip, 8000.0, 0.0, 90e3, 0.8, 0.0, 0.0)
    theirs = [brush_lateral_force(np.tan(tangent), 90e3, 6400.0) for tangent in slip]
    assert ours == pytest.approx(np.array(theirs), rel=1e-9, abs=1e-6)


def test_magic_formula_has_its_slope_and_its_peak():
    flags = single_track(tyres="magic_formula")._flags([{}])
    small, forces = (
        lateral_force(flags, slip, 8000.0, 0.0, 90e3, 0.8, 1.4, 0.0) for slip in (1e-6, np.linspace(0.0, 1.0, 2001))
    )
    assert small == pytest.approx(-0.09, rel=1e-5)
    assert np.min(forces) == pytest.approx(-6400.0, rel=1e-4)


def test_lag_and_second_order_are_exact_for_straight_lines():
    time = np.arange(0.0, 3.0, 0.05)
    values = np.cumsum(np.random.default_rng(0).normal(size=len(time)))

    def asked(t):
        return np.interp(t, time, values)

    for edges, ours in (
        (lambda t, x: [(asked(t) - x[0]) / 0.12, 0.0], first_order(values, 0.05, 0.12)),
        (lambda t, x: [x[1], 64.0 * (asked(t) - x[0]) - 2.0 * 0.4 * 8.0 * x[1]], second_order(values, 0.05, 8.0, 0.4)),
    ):
        theirs = [np.array([values[0], 0.0])]
        for line in itertools.pairwise(time):  # an integrator of high order stumbles over corners
            theirs.append(solve_ivp(edges, line, theirs[-1], rtol=1e-10, atol=1e-12).y[:, -1])
        assert ours == pytest.approx(np.array(theirs)[:, 0], abs=1e-8)
    assert first_order(values, 0.05, 0.0) is values


def test_interpolation_is_smooth_and_keeps_held_values():
    wave = np.sin(0.4 * np.arange(60))
    places = np.linspace(2.0, 57.0, 500)
    off = np.max(np.abs(smooth_between(wave, places) - np.sin(0.4 * places)))
    assert off < 0.1 * np.max(np.abs(np.interp(places, np.arange(60), wave) - np.sin(0.4 * places)))
    steps = np.repeat([0.0, 1.0, 3.0], 5)
    assert set(smooth_between(steps, np.array([-3.0, 0.0, 3.3, 6.6, 12.5, 40.0])).tolist()) == {0.0, 1.0, 3.0}
    assert smooth_between(wave, np.arange(60.0)) == pytest.approx(wave)


def test_backlash_lags_by_half_its_width():
    wave = np.sin(np.linspace(0.0, 20.0, 2001))
    behind = backlash(wave, 0.2)
    assert np.max(behind[500:]) == pytest.approx(0.9, abs=1e-4)
    assert np.max(np.abs(behind - wave)) <= 0.1 + 1e-12


def test_every_model_can_be_made_and_has_a_title():
    time = np.arange(0.0, 5.0, 0.01)
    names = ["vx", "road_wheel_angle", "steering_command", "yaw_rate", "throttle", "brake"]
    names += ["road_height_front", "road_height_rear", "suspension_travel_front", "suspension_travel_rear"]
    data = DataSet((Log("all", "train", time, {name: np.sin(time) for name in names}),), wheelbase=2.7)
    for kind in MODELS:
        model = make_model(ModelSpec(kind, {"vehicle": "bolt"} if kind == "plant" else {}), data, {})
        assert model.title
        assert all(info.low <= info.guess <= info.high for info in model.parameters)
        # Without a scale the logarithm is estimated.
        assert all(info.low >= 0.0 for info in model.parameters if info.is_positive), kind
        assert len({info.name for info in model.parameters}) == len(model.parameters)
        assert model.derived_quantities({info.name: info.guess for info in model.parameters}) is not None


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        (ModelSpec("singel_track"), "did you mean 'single_track'"),
        (ModelSpec("single_track", {"tyres": "fialla"}), "model.tyres: 'fialla' is not allowed; allowed: .*'fiala'"),
        (ModelSpec("single_track", {"tires": "fiala"}), "model.tires"),
        (ModelSpec("single_track", {"outputs": ["vy"]}), "map its column"),
        (ModelSpec("single_track", {"outputs": ["vx"]}), "has no output 'vx'"),
        (ModelSpec("longitudinal", {"drive": "throttle"}), "throttle"),
        (ModelSpec("longitudinal", {"brake": "hand"}), "model.brake"),
        (ModelSpec("steering"), "steering_wheel_angle or steering_command"),
        (ModelSpec("joint_loop"), "steering_command"),
    ],
)
def test_a_model_that_cannot_be_made_names_the_reason(spec, words):
    with pytest.raises(ConfigError, match=words) as caught:
        make_model(spec, lateral_data(), {})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("choice", "words"),
    [
        (Setting(low=2.0, high=1.0), "is not below high"),
        (Setting(low=1e3, high=2e3, guess=5e3), "lies outside"),
        (Setting(fixed=1.0, guess=2.0), "is fixed, and has guess as well"),
        (Setting(fixed=-1.0), "must be positive"),
        (Setting(guess=float("nan")), "finite"),
        (Setting(prior=(9e4, -1.0)), "sigma must be positive"),
        (Setting(prior=(9e4, 1.0), high=1e4), "prior mean"),
    ],
)
def test_contradictory_settings_are_rejected(choice, words):
    with pytest.raises(ConfigError, match=words):
        resolve_parameters(single_track().parameters, {"yaw_inertia": choice})


def test_all_faults_of_the_settings_are_reported_together():
    with pytest.raises(ConfigError) as caught:
        resolve_parameters(single_track().parameters, {"yaw_inertai": Setting(), "mass": Setting(fixed=-1.0)})
    assert "did you mean 'yaw_inertia'" in str(caught.value)
    assert "parameters.mass" in str(caught.value)


def test_default_values_of_a_magic_formula_are_assumptions():
    """Its curvature, and the share of drive and braking of the front wheels, which cannot be negative."""
    model = single_track(tyres="magic_formula")
    values = {info.name: info.guess for info in model.parameters}
    shares, curves = {"front_drive", "front_brake"}, {"curvature_front", "curvature_rear"}
    assumptions = {
        frozenset(assumption.changes): assumption
        for assumption in model.assumptions(values, frozenset(shares | curves))
    }
    required = {frozenset({"front_drive"}), frozenset({"front_brake"}), frozenset(curves)}
    assert required <= assumptions.keys()
    for name in shares:
        share = assumptions[frozenset({name})]
        sigma = (share.changes[name] - values[name]) / share.fraction
        assert share.max_size * sigma == pytest.approx(max(values[name], 1.0 - values[name]))
    known = {frozenset(assumption.changes) for assumption in model.assumptions(values, frozenset())}
    assert not known & required
    assert model.suggest_experiment(frozenset({"roll_gain", "accelerometer_tilt"})) == "record the roll rate"


def steered(frequency, *, speeds=(15.0, 15.0), bias=0.0, duration=80.0):
    """Return a segment of a linear sweep of the steering from 0 Hz to a frequency [Hz], half at each speed [m/s]."""
    t = np.arange(0.0, duration, 0.02)
    angle = 0.03 * np.sin(np.pi * frequency / duration * t**2) + bias
    vx = np.where(t < 0.5 * duration, *speeds)
    return Segment("sweep", "train", 0.0, 0.02, {"road_wheel_angle": angle, "vx": vx}, {"yaw_rate": angle * vx / 2.7})


STIFF, OFFSETS = frozenset({"cornering_stiffness_front"}), frozenset({"accelerometer_ahead"})


def model_with(kind, *names):
    """Return a model for a log with further channels."""
    log = lateral_data().logs[0]
    channels = {**log.channels, **dict.fromkeys(names, 0.1 * log.channels["yaw_rate"])}
    return make_model(ModelSpec(kind), DataSet((replace(log, channels=channels),), wheelbase=FRONT + REAR), KNOWN)


def test_advice_names_what_the_logs_lack():
    model = model_with("single_track", "vy")
    fast = steered(4.0, speeds=(10.0, 16.0))
    cases = [
        (STIFF, [steered(4.0)], "do a step steer at two speeds"),
        (STIFF, [steered(0.2, speeds=(10.0, 16.0))], "do a step steer at two speeds"),
        (STIFF, [fast], ""),
        (STIFF, [steered(4.0, speeds=(10.0, 10.0)), steered(4.0, speeds=(16.0, 16.0))], ""),
        (frozenset({"yaw_inertia"}), [steered(1.0)], "do step steers, or a sweep to 2 Hz"),
        (frozenset({"yaw_inertia"}), [fast], ""),
        (frozenset({"steering_delay"}), [steered(2.0)], "do step steers, or a sweep to 3 Hz"),
        (frozenset({"steering_delay"}), [fast], ""),
        (frozenset({"steering_ratio"}), [fast], ""),
        (OFFSETS, [fast], ""),
        (OFFSETS, [steered(4.0, bias=0.05)], "drive turns to both sides"),
        (OFFSETS, [steered(4.0, bias=0.05, duration=10.0)], "record longer, and drive turns to both sides"),
    ]
    for names, drives, expected in cases:
        assert model.suggest_experiment(names, drives) == expected, (names, expected)


def test_channels_that_are_recorded_are_not_asked_for():
    fast, roll = [steered(4.0, speeds=(10.0, 16.0))], frozenset({"roll_gain"})
    advice = model_with("single_track").suggest_experiment(STIFF, fast)
    assert advice == "record the lateral velocity if possible"
    rolls = model_with("single_track_roll", "roll_rate")
    assert rolls.suggest_experiment(roll, fast) == ""
    assert rolls.suggest_experiment(roll, [steered(1.0)]) == "do step steers, or a sweep to 3 Hz"


@pytest.mark.parametrize("tyres", ["fiala", "magic_formula"])
def test_braking_tyres_have_less_lateral_force(tyres):
    """Braking with 5 m/s² takes 7500 N, 4500 of them in front; √(1 - X² / μ² N²) is left, but at least 0.3."""
    model = single_track(tyres=tyres)
    p = {info.name: info.guess for info in model.parameters} | {"front_drive": 1.0, "front_brake": 0.6}
    p |= {"friction_front": 0.9, "friction_rear": 0.8, "shape_front": 1.0, "shape_rear": 1.0, "mass": 1500.0}
    loads = [1500.0 * 9.80665 * arm / (FRONT + REAR) for arm in (REAR, FRONT)]
    slips = (-1.5, -1.5)  # all of the contact slides
    inputs = np.array([0.0, 20.0, -5.0, 0.0, 0.0])
    forces = forces_of(model, np.zeros(2), inputs, p, slips)
    expected = [math.sqrt((0.9 * loads[0]) ** 2 - 4500.0**2), math.sqrt((0.8 * loads[1]) ** 2 - 3000.0**2)]
    assert forces == pytest.approx(expected, rel=0.02 if tyres == "magic_formula" else 1e-9)
    locked = forces_of(model, np.zeros(2), inputs * 10.0, p, slips)
    assert locked[0] == pytest.approx(0.3 * 0.9 * loads[0], rel=0.02)


def test_a_segment_in_shots_equals_one_shot_and_the_machine_code(monkeypatch):
    """Gaps between shots are closed to first order at the end: the rest is far below the resolution of any sensor."""
    model = make_model(ModelSpec("single_track", {"tyres": "magic_formula", "relaxation": True}), lateral_data(), KNOWN)
    (drive,), _ = make_segments(model, lateral_data().logs, None)
    p = {info.name: info.guess for info in model.parameters}
    shots = make_shots(model, drive, p)
    assert shots.count > 20
    first = shots.nodes[:, 0].copy()
    stiffer = p | {"cornering_stiffness_front": p["cornering_stiffness_front"] * (1.0 + 1e-5)}
    compiled = simulate(model, shots, [p, stiffer], first, changes=1e-5)
    monkeypatch.setattr(type(model), "uses_machine_code", False)
    many = simulate(model, shots, [p, stiffer], first, changes=1e-5)
    whole = replace(shots, count=1, length=drive.size, nodes=first[:, None])
    unsplit = simulate(model, whole, [p], first, derivatives=False)
    assert many is not None
    assert unsplit is not None
    assert compiled is not None
    for y, whole_y, compiled_y in zip(many.y, unsplit.y, compiled.y, strict=True):
        assert y == pytest.approx(whole_y, abs=1e-7 * float(np.ptp(whole_y)))
        assert compiled_y == pytest.approx(whole_y, abs=1e-7 * float(np.ptp(whole_y)))
    for name in ("by_parameters", "by_start", "last_by"):
        theirs = getattr(many, name)
        assert getattr(compiled, name) == pytest.approx(theirs, abs=1e-4 * float(np.abs(theirs).max()))


def test_runs_that_converge_to_the_first_one_have_the_same_derivatives(monkeypatch):
    model = single_track(tyres="fiala", relaxation=True)
    (drive,), _ = make_segments(model, lateral_data().train)
    p = {info.name: info.guess for info in model.parameters} | TRUTH
    names = ("yaw_inertia", "accelerometer_ahead")
    columns = [p, *({**p, name: p[name] + 1e-4} for name in names)]
    first = np.array([0.1, 0.05, 0.0, 0.0])
    runs = []
    for equal in (1e-12, -1.0):
        monkeypatch.setattr(module, "_EQUAL", equal)
        run = simulate(model, make_shots(model, drive, p), columns, first, changes=1e-4)
        assert run is not None
        runs.append((run.by_parameters, run.by_start))
    for converged, whole in zip(*runs, strict=True):
        assert converged == pytest.approx(whole, rel=1e-5, abs=1e-5 * float(np.max(np.abs(whole))))
    # From then on the initial state has no effect; the accelerometer's place has one at all times.
    ends = [np.flatnonzero(np.any(by_start, axis=(0, 2)))[-1] for _, by_start in runs]
    assert ends[0] < 0.8 * ends[1]
    assert np.any(runs[0][0][1, -1, 1])
