"""The single-track model: closed forms, an exact solution, its derivatives, and comparison with the full Bolt."""

from dataclasses import replace
from math import atan, cos, hypot, isnan, pi, sin, sqrt, tan

import numpy as np
import pytest
from pydrake.autodiffutils import AutoDiffXd, InitializeAutoDiff
from pydrake.symbolic import Expression
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Linearize, LogVectorOutput
from scipy.integrate import quad
from scipy.linalg import expm

from mirdrake.assembly.diagram import assemble
from mirdrake.controllers.schedule import ConstantCommand
from mirdrake.core.errors import ConfigError
from mirdrake.core.signals import signals_of
from mirdrake.plant.plant import PlantSpec, make_plant, set_start
from mirdrake.runs.simulation import Simulation
from mirdrake.single_track import (
    SingleTrack,
    SingleTrackControl,
    SingleTrackParameters,
    characteristic_speed,
    estimate_parameters,
    find_steady_state,
    linearize_single_track,
    make_single_track,
    make_single_track_vehicle,
    steady_gain,
    steady_steering,
    understeer_gradient,
)
from mirdrake.single_track.dynamics import BLEND_TIME, CompiledEquations, Variant, evaluate
from mirdrake.single_track.parameters import PARAMETERS
from mirdrake.tyres.brush import brush_lateral_force
from mirdrake.tyres.magic_formula_tyres import MagicFormulaTyres, magic_formula_lateral_force
from mirdrake.vehicles import load_vehicle
from mirdrake.vehicles.inspection import inspect_vehicle
from mirdrake.worlds import load_world

GRAVITY = 9.80665
CAR = SingleTrackParameters(
    mass=1500.0, yaw_inertia=2400.0, front_length=1.2, rear_length=1.5, front_stiffness=90e3, rear_stiffness=110e3
)
LOSSES = replace(CAR, rolling_resistance=0.01, drag=0.5, rotating_mass=40.0)
LINEAR, KINEMATIC, BRUSH = Variant("linear"), Variant("kinematic"), Variant("brush")
VARIANTS = [
    KINEMATIC,
    Variant("kinematic", actuators=True),
    LINEAR,
    Variant("linear", relaxation=True),
    BRUSH,
    Variant("brush", relaxation=True, actuators=True),
    Variant("linear", roll=True),
    Variant("brush", relaxation=True, actuators=True, roll=True),
    Variant("magic_formula", relaxation=True, actuators=True, roll=True),
]
ROLLING = replace(CAR, roll_mass=1300.0, roll_height=0.45, roll_inertia=400.0, roll_stiffness=60e3, roll_damping=2500.0)


def names_of(port):
    """Return names of a port's signals, in order."""
    contents = signals_of(port)
    assert contents is not None
    return [signal.name for signal in contents]


class Ride:
    """A model on its own under inputs that do not change."""

    def __init__(self, parameters, variant=LINEAR, *, steering=0.0, drive=0.0, brake=0.0, step=0.01, **state):
        self.model = SingleTrack(parameters, variant)
        self.simulator = Simulator(self.model)
        self.context = self.simulator.get_mutable_context()
        self.model.set_state(self.context, **state)
        self.model.steering.FixValue(self.context, [steering, 0.0][: self.model.steering.size()])
        self.model.forces.FixValue(self.context, [drive, brake, 0.0][: self.model.forces.size()])
        ResetIntegratorFromFlags(self.simulator, "runge_kutta3", step)
        self.simulator.get_mutable_integrator().set_fixed_step_mode(True)
        self.simulator.Initialize()

    def at(self, time):
        self.simulator.AdvanceTo(time)
        return self

    def __getitem__(self, name):
        for port in (self.model.state, self.model.motion):
            if name in names_of(port):
                return port.Eval(self.context)[names_of(port).index(name)]
        raise KeyError(name)


# --- closed forms ------------------------------------------------------------------------------------------------


def test_the_kinematic_car_drives_a_circle_of_wheelbase_over_tangent():
    ride = Ride(CAR, KINEMATIC, steering=0.3, vx=4.0, step=0.005)
    radius = 2.7 / tan(0.3)
    for time in (1.0, 3.7, 9.0):
        ride.at(time)
        assert hypot(ride["x"], ride["y"] - radius) == pytest.approx(radius, rel=1e-6)
        assert ride["wz"] == pytest.approx(4.0 / radius, rel=1e-12)
        assert (ride["vx"], ride["vy"]) == (4.0, 0.0)
    assert ride["yaw"] == pytest.approx(np.remainder(9.0 * 4.0 / radius + pi, 2.0 * pi) - pi, rel=1e-9)
    assert ride["sideslip"] == pytest.approx(atan(1.5 / radius))
    assert hypot(ride["longitudinal_acceleration"], ride["lateral_acceleration"]) == pytest.approx(
        16.0 / radius**2 * hypot(radius, 1.5)
    )


def test_the_kinematic_car_gains_the_energy_that_the_motor_gives():
    ride = Ride(replace(CAR, rotating_mass=50.0), KINEMATIC, steering=0.3, drive=2000.0, vx=1.0, step=0.005).at(5.0)
    turn = tan(0.3) / 2.7
    energy = 0.5 * (1500.0 + 50.0 + (1500.0 * 1.5**2 + 2400.0) * turn**2)
    # The front wheel, which drives, runs 1 / cos 0.3 times as far as the rear axle: force over effective mass.
    acceleration = 2000.0 / cos(0.3) / (2.0 * energy)
    assert ride["vx"] == pytest.approx(1.0 + 5.0 * acceleration, rel=1e-9)


@pytest.mark.parametrize("speed", [8.0, 20.0, 35.0])
def test_yaw_rate_and_sideslip_on_a_circle_are_those_of_the_textbook(speed):
    """R. Rajamani, sections 3.1 to 3.3, with a small steering angle; the drive force holds the speed."""
    steering = 1e-4
    gradient = 1500.0 / 2.7 * (1.5 / 90e3 - 1.2 / 110e3)
    assert understeer_gradient(CAR) == pytest.approx(gradient, rel=1e-12)
    yaw_rate = speed / (2.7 + gradient * speed**2) * steering
    ride = Ride(CAR, steering=steering, vx=speed).at(8.0)
    assert ride["wz"] == pytest.approx(yaw_rate, rel=1e-6)
    assert steady_gain(CAR, speed) == pytest.approx(yaw_rate / steering, rel=1e-12)
    assert ride["lateral_acceleration"] == pytest.approx(speed * yaw_rate, rel=1e-6)
    rear_slip = -1500.0 * 1.2 / 2.7 * speed * yaw_rate / 110e3  # lateral force of the rear axle over its stiffness
    assert ride["rear_slip_angle"] == pytest.approx(rear_slip, rel=1e-5)
    assert ride["sideslip"] == pytest.approx(1.5 * yaw_rate / speed + rear_slip, rel=1e-5)
    steady = find_steady_state(CAR, LINEAR, speed=speed, steering=steering)
    assert steady["yaw_rate"] == pytest.approx(yaw_rate, rel=1e-6)
    # The motor holds against the front axle's side force, which points back, and turns the velocity of the mass.
    sideslip = 1.5 * yaw_rate / speed + rear_slip
    against = 1.5 / 2.7 * speed * yaw_rate * steering - yaw_rate * sideslip * speed
    assert steady["drive"] == pytest.approx(1500.0 * against, rel=1e-4)


@pytest.mark.parametrize("arm", [0.0, 0.03])
def test_a_car_rolls_out_of_the_turn_and_turns_as_one_without_roll(arm):
    """φ (K - ms g h) = (ms h + m e) ay, R. Rajamani, section 15.2, with the overturning moment e F of the tyres."""
    car = replace(ROLLING, overturning_arm=arm)
    steady = find_steady_state(car, Variant("linear", roll=True), speed=20.0, steering=0.01)
    lateral = steady["lateral_acceleration"]
    roll = (1300.0 * 0.45 + 1500.0 * arm) * lateral / (60e3 - 1300.0 * GRAVITY * 0.45)
    assert lateral > 1.0
    assert steady["roll"] == pytest.approx(roll, rel=1e-9)
    assert steady["roll_rate"] == pytest.approx(0.0, abs=1e-12)
    flat = find_steady_state(CAR, LINEAR, speed=20.0, steering=0.01)
    assert steady["yaw_rate"] == pytest.approx(flat["yaw_rate"], rel=1e-9)
    ride = Ride(car, Variant("linear", roll=True), steering=0.01, drive=steady["drive"], vx=20.0).at(8.0)
    assert (ride["roll"], ride["wx"]) == pytest.approx((roll, 0.0), rel=1e-3, abs=1e-6)


def test_roll_and_lateral_motion_are_those_of_newton_and_euler():
    """Linear tyres at 20 m/s; F and e F by hand."""
    car = replace(ROLLING, overturning_arm=0.03, roll_damping=2500.0)
    model = SingleTrack(car, Variant("linear", roll=True))
    context = model.CreateDefaultContext()
    model.set_state(context, vx=20.0, vy=0.3, yaw_rate=0.2, roll=0.02, roll_rate=0.1)
    model.steering.FixValue(context, [0.0])
    model.forces.FixValue(context, [0.0, 0.0])
    names = model.variant.state_names
    rates = dict(zip(names, model.EvalTimeDerivatives(context).CopyToVector(), strict=True))
    force = -90e3 * atan((0.3 + 1.2 * 0.2) / 20.0) - 110e3 * atan((0.3 - 1.5 * 0.2) / 20.0)
    sideways, rolling, arm = rates["vy"] + 0.2 * 20.0, rates["roll_rate"], 1300.0 * 0.45
    assert 1500.0 * sideways - arm * rolling == pytest.approx(force, rel=1e-9)
    moment = arm * sideways + 0.03 * force - (60e3 - arm * GRAVITY) * 0.02 - 2500.0 * 0.1
    assert (400.0 + 1300.0 * 0.45**2) * rolling == pytest.approx(moment, rel=1e-9)


def test_roll_slip_of_an_axle_is_a_softer_axle_in_a_steady_turn():
    gain = 1300.0 * 0.45 / (60e3 - 1300.0 * GRAVITY * 0.45)  # rad s²/m
    for name, slip, stiffness, share in (("rear", 0.1, 110e3, 1.2 / 2.7), ("front", -0.2, 90e3, 1.5 / 2.7)):
        softness = 1.0 / stiffness + slip * gain / (1500.0 * share)  # F / C = F / C0 + ε φ, with F = m ay share
        soft = replace(CAR, **{f"{name}_stiffness": 1.0 / softness})
        leaning = replace(ROLLING, **{f"{name}_roll_slip": slip})
        slips = [
            find_steady_state(car, variant, speed=25.0, steering=1e-3)["yaw_rate"]
            for car, variant in ((leaning, Variant("linear", roll=True)), (soft, LINEAR))
        ]
        assert slips[0] == pytest.approx(slips[1], rel=2e-4), name


@pytest.mark.parametrize("mass", [1300.0, 1500.0])
def test_a_rolling_car_without_grip_oscillates_about_its_centre_of_mass(mass):
    """The axles are free: the car as a whole stays, the sprung and unsprung masses oscillate against each other."""
    loose = replace(ROLLING, roll_mass=mass, roll_damping=0.0, front_stiffness=1e-6, rear_stiffness=1e-6)
    linear = linearize_single_track(loose, Variant("linear", roll=True), speed=20.0)
    arm = mass * 0.45
    inertia = 400.0 + mass * 0.45**2 - arm**2 / 1500.0
    frequency = np.sqrt((60e3 - arm * GRAVITY) / inertia)
    assert np.abs(linear.eigenvalues().imag).max() == pytest.approx(frequency, rel=1e-9)
    ride = Ride(loose, Variant("linear", roll=True), vx=20.0, roll=0.02, step=0.002).at(pi / frequency)
    assert ride["roll"] == pytest.approx(-0.02, rel=1e-5)
    moved = arm / 1500.0 * 0.04  # the road's point goes the way that keeps the centre of all masses in its place
    assert ride["y"] == pytest.approx(-moved, rel=1e-3)


def test_the_roll_of_a_vehicle_is_that_of_its_springs_and_tyres():
    vehicle = load_vehicle("bolt@handling")
    rolling, flat = estimate_parameters(vehicle, roll=True), estimate_parameters(vehicle)
    springs = [(28000.0, 12000.0), (27000.0, 17000.0)]
    track = vehicle.geometry.front_track
    stiffness = sum(0.5 * track**2 / (1.0 / (k + 2.0 * bar) + 1.0 / 2e5) for k, bar in springs)
    assert rolling.roll_stiffness == pytest.approx(stiffness, rel=1e-6)
    assert rolling.roll_mass == rolling.mass
    assert rolling.roll_height == rolling.com_height
    assert 0.5 * track**2 * 3800.0 > rolling.roll_damping > 0.4 * 0.5 * track**2 * 3800.0
    loads = [0.5 * rolling.mass * GRAVITY * share / 2.601 for share in (rolling.rear_length, rolling.front_length)]
    arm = 0.3234 * 0.088 / 4000.0 * sum(load**2 for load in loads) / sum(loads)  # R0 QSX3 N Fy / FNOMIN over Fy
    assert rolling.overturning_arm == pytest.approx(arm, rel=1e-6)
    assert flat.overturning_arm == 0.0
    assert rolling.front_stiffness > flat.front_stiffness
    assert 0.0 < rolling.front_roll_slip < 0.2
    assert flat.front_roll_slip == 0.0


def test_an_understeering_car_has_its_largest_yaw_gain_at_the_characteristic_speed():
    best = characteristic_speed(CAR)
    speeds = np.linspace(0.7, 1.3, 61) * best
    models = [linearize_single_track(CAR, LINEAR, speed=v).part(states=["vy", "yaw_rate"]) for v in speeds]
    gains = [model.gain("yaw_rate", "steering") for model in models]
    assert speeds[np.argmax(gains)] == pytest.approx(best, rel=0.011)
    assert max(gains) == pytest.approx(best / 2.7 / 2.0, rel=1e-4)


def test_an_oversteering_car_is_unstable_beyond_its_critical_speed():
    car = replace(CAR, front_stiffness=110e3, rear_stiffness=70e3)
    critical = -characteristic_speed(car)
    assert critical == pytest.approx(sqrt(2.7**2 * 110e3 * 70e3 / (1500.0 * (1.2 * 110e3 - 1.5 * 70e3))))
    for factor, stable in ((0.999, True), (1.001, False)):
        poles = linearize_single_track(car, LINEAR, speed=factor * critical).part(states=["vy", "yaw_rate"])
        assert (poles.eigenvalues().real.max() < 0.0) == stable
    straight = Ride(car, vx=1.2 * critical, yaw_rate=1e-7)
    lateral = linearize_single_track(car, LINEAR, speed=1.2 * critical).part(states=["vy", "yaw_rate"])
    early = straight.at(5.0)["wz"]
    growth = straight.at(6.0)["wz"] / early
    assert growth == pytest.approx(np.exp(lateral.eigenvalues().real.max()), rel=1e-3)


def test_coast_down_equals_the_integral_of_the_losses():
    """M v' = -(A + C v²) has v = sqrt(A/C) tan(atan(v0 sqrt(C/A)) - t sqrt(A C) / M)."""
    a, c, m = 0.01 * 1500.0 * GRAVITY, 0.5, 1540.0
    for variant in (KINEMATIC, LINEAR, BRUSH):
        ride = Ride(LOSSES, variant, vx=30.0, step=0.02)
        for time in (5.0, 40.0, 100.0):
            exact = sqrt(a / c) * tan(atan(30.0 * sqrt(c / a)) - time * sqrt(a * c) / m)
            assert ride.at(time)["vx"] == pytest.approx(exact, rel=1e-7)


def test_a_braking_car_stops_after_the_distance_of_its_force_and_stays():
    ride = Ride(CAR, brake=6000.0, vx=20.0, step=0.005).at(6.0)
    assert ride["x"] == pytest.approx(20.0**2 / (2.0 * 4.0), rel=0.002)
    assert abs(ride["vx"]) < 1e-9


@pytest.mark.parametrize("variant", [KINEMATIC, LINEAR, BRUSH])
def test_a_car_rolls_down_the_slope_that_its_heading_gives(variant):
    slope = replace(CAR, gravity_x=-GRAVITY * sin(0.05), gravity_z=-GRAVITY * cos(0.05))
    assert Ride(slope, variant).at(4.0)["vx"] == pytest.approx(-4.0 * GRAVITY * sin(0.05), rel=1e-6)
    across = Ride(slope, variant, yaw=pi / 2.0).at(4.0)
    assert abs(across["vx"]) < 1e-3


def test_the_friction_of_brush_tyres_limits_turning_and_braking():
    slippery = replace(CAR, front_friction=0.4, rear_friction=0.4, com_height=0.5)
    hard = Ride(slippery, BRUSH, steering=0.3, vx=20.0)
    turning = max(abs(hard.at(0.1 * i)["lateral_acceleration"]) for i in range(1, 12))
    assert 0.3 * GRAVITY < turning < 0.4 * GRAVITY * 1.001
    braking = Ride(slippery, BRUSH, brake=50e3, vx=20.0).at(1.0)
    assert 0.9 * 0.4 * GRAVITY < -braking["longitudinal_acceleration"] < 0.4 * GRAVITY
    state = [0.0, 0.0, 0.0, 20.0, 8.0, 0.0]  # both axles slide
    limit = 0.4 * 1500.0 * GRAVITY * 1.5 / 2.7
    rates = evaluate(BRUSH, replace(slippery, com_height=0.0).values(), state, [0.0, 0.6 * limit, 0.0])
    assert rates.motion[5:] == pytest.approx([-0.8 * limit, -limit * 1.2 / 1.5])
    with pytest.raises(ConfigError, match=r"cannot hold 20 m/s at 0\.3 rad; reduce speed or steering"):
        find_steady_state(slippery, BRUSH, speed=20.0, steering=0.3)


@pytest.mark.parametrize(
    ("car", "variant"),
    [
        (CAR, BRUSH),
        (replace(ROLLING, front_roll_slip=0.1, rear_roll_slip=-0.05), Variant("magic_formula", roll=True)),
        (replace(ROLLING, front_roll_slip=0.1, rear_roll_slip=-0.05), Variant("brush", roll=True)),
    ],
)
@pytest.mark.parametrize("lateral", [1.0, 4.0, 6.5])
def test_the_steering_of_a_turn_gives_its_lateral_acceleration(car, variant, lateral):
    """The steady state by Newton's method on the whole equations."""
    car = replace(car, front_shape=1.4, front_curvature=-0.5, com_height=0.5)
    steering = steady_steering(car, variant.tyres, lateral, 25.0)
    assert find_steady_state(car, variant, speed=25.0, steering=steering)["lateral_acceleration"] == pytest.approx(
        lateral, rel=0.02
    )
    assert isnan(steady_steering(car, variant.tyres, 12.0, 25.0))


# --- independent computations ------------------------------------------------------------------------------------


def _rajamani(p, speed):
    """Return matrices of the states y, y', ψ, ψ' (section 2.3), from its equations with 2 Cf = front_stiffness."""
    cf, cr, a, b, m, i = p.front_stiffness, p.rear_stiffness, p.front_length, p.rear_length, p.mass, p.yaw_inertia
    matrix = [
        [0.0, 1.0, 0.0, 0.0],
        [0.0, -(cf + cr) / (m * speed), 0.0, -speed - (cf * a - cr * b) / (m * speed)],
        [0.0, 0.0, 0.0, 1.0],
        [0.0, -(cf * a - cr * b) / (i * speed), 0.0, -(cf * a * a + cr * b * b) / (i * speed)],
    ]
    return np.array(matrix), np.array([0.0, cf / m, 0.0, a * cf / i])


@pytest.mark.parametrize("speed", [5.0, 25.0])
def test_the_linear_model_is_that_of_the_textbook(speed):
    matrix, column = _rajamani(CAR, speed)
    linear = linearize_single_track(CAR, LINEAR, speed=speed).part(states=["vy", "yaw_rate"], inputs=["steering"])
    np.testing.assert_allclose(linear.A, matrix[np.ix_([1, 3], [1, 3])], rtol=1e-12)
    np.testing.assert_allclose(linear.B[:, 0], column[[1, 3]], rtol=1e-12)
    poles = np.sort_complex(np.linalg.eigvals(matrix[np.ix_([1, 3], [1, 3])]))
    np.testing.assert_allclose(np.sort_complex(linear.eigenvalues()), poles, rtol=1e-10)


@pytest.mark.parametrize("variant", VARIANTS)
def test_the_linear_model_is_that_of_drake(variant):
    linear = linearize_single_track(LOSSES, variant, speed=15.0, steering=0.03)
    model = SingleTrack(LOSSES, variant)
    context = model.CreateDefaultContext()
    context.SetContinuousState(linear.steady.state)
    inputs = dict(zip(linear.inputs, linear.steady.inputs, strict=True))
    for port in (model.steering, model.forces):
        port.FixValue(context, [inputs[name] for name in names_of(port)])
    derivatives = model.EvalTimeDerivatives(context).CopyToVector()[3:]
    np.testing.assert_allclose(derivatives, 0.0, atol=1e-7)
    port = model.motion.get_index()
    theirs = Linearize(model, context, model.steering.get_index(), port, equilibrium_check_tolerance=100.0)
    column = linear.inputs.index("steering")
    np.testing.assert_allclose(linear.A, theirs.A()[3:, 3:], atol=1e-9)
    np.testing.assert_allclose(linear.B[:, column], theirs.B()[3:, 0], atol=1e-9)
    np.testing.assert_allclose(linear.C[2:], theirs.C()[:, 3:], rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(linear.D[2:, column], theirs.D()[:, 0], rtol=1e-9, atol=1e-6)
    assert linear.system().A().shape == linear.A.shape
    assert linear.steady["vx"] == 15.0


def test_a_step_of_steering_follows_the_exact_solution():
    speed, steering = 20.0, 1e-4
    ride = Ride(CAR, steering=steering, vx=speed, step=0.005)
    matrix, column = _rajamani(CAR, speed)
    whole = np.zeros((5, 5))
    whole[:4, :4], whole[:4, 4] = matrix, column * steering
    largest = 0.0
    for time in np.arange(1, 40) * 0.05:
        exact = (expm(whole * time) @ [0.0, 0.0, 0.0, 0.0, 1.0])[:4]
        ride.at(time)
        largest = max(largest, abs(exact[3]))
        assert ride["wz"] == pytest.approx(exact[3], abs=2e-6 * largest)
        assert ride["vy"] + 1.5 * ride["wz"] == pytest.approx(exact[1], abs=1e-5 * speed * largest)
    assert largest > 1.0001 * ride["wz"]  # it overshoots


@pytest.mark.parametrize("variant", [KINEMATIC, LINEAR, BRUSH, Variant("brush", relaxation=True)])
def test_results_do_not_depend_on_the_time_step(variant):
    rides = [Ride(LOSSES, variant, steering=0.05, drive=1000.0, step=step, vx=12.0).at(3.0) for step in (0.02, 0.01)]
    for name in ("x", "y", "vx", "wz", "lateral_acceleration"):
        assert rides[0][name] == pytest.approx(rides[1][name], rel=1e-4)


@pytest.mark.parametrize("variant", [LINEAR, BRUSH])
def test_the_power_of_the_forces_is_the_change_of_the_energy(variant):
    """Without losses; the tyres take away side force times sliding speed, and nothing else is lost."""
    steering, state = 0.1, [0.0, 0.0, 0.0, 15.0, -0.4, 0.35]
    rates = evaluate(variant, CAR.values(), state, [steering, 1200.0, 0.0])
    vx, vy, spin = state[3:]
    front, rear = rates.motion[5], rates.motion[6]
    ahead = vy + 1.2 * spin
    power = 1200.0 * (vx * cos(steering) + ahead * sin(steering))
    lost = front * (ahead * cos(steering) - vx * sin(steering)) + rear * (vy - 1.5 * spin)
    gained = 1500.0 * (vx * rates.state[3] + vy * rates.state[4]) + 2400.0 * spin * rates.state[5]
    assert lost < 0.0
    assert gained == pytest.approx(power + lost, rel=1e-12)


@pytest.mark.parametrize("slip", [0.0, 0.01, -0.05, 0.0999, 0.1001, -0.4])
def test_the_brush_force_is_that_of_bristles_under_a_parabolic_pressure(slip):
    stiffness, limit, half = 30e3, 1000.0, 0.06  # slides from tan α = 3 · 1000 / 30e3 = 0.1 on
    bristle = stiffness / (2.0 * half**2)  # N/m²: all of them stick at a force of 2 c a² tan α

    def force(x):  # from the leading edge
        pressure = 3.0 * limit / (4.0 * half**3) * x * (2.0 * half - x)
        return min(bristle * x * abs(slip), pressure)

    sticking = max(2.0 * half - bristle * abs(slip) * 4.0 * half**3 / (3.0 * limit), 0.0)
    expected = quad(force, 0.0, 2.0 * half, points=[sticking])[0]
    assert brush_lateral_force(slip, stiffness, limit) == pytest.approx(-np.sign(slip) * expected, abs=1e-6)


def test_relaxation_delays_the_slip_by_a_distance():
    car = replace(CAR, front_relaxation=0.6, rear_relaxation=0.3, mass=1e9, yaw_inertia=1e9)  # goes straight on
    ride = Ride(car, Variant("linear", relaxation=True), vx=10.0, vy=0.1, step=0.001).at(0.05)
    assert ride["front_slip_angle"] == pytest.approx(0.01 * (1.0 - np.exp(-0.5 / 0.6)), rel=1e-3)
    assert ride["rear_slip_angle"] == pytest.approx(0.01 * (1.0 - np.exp(-0.5 / 0.3)), rel=1e-3)


@pytest.mark.parametrize("variant", [LINEAR, BRUSH])
def test_gravity_and_velocity_have_the_components_of_the_heading(variant):
    bank, yaw = replace(CAR, gravity_x=0.3, gravity_y=-0.5), 0.7
    ahead, side = np.array([cos(yaw), sin(yaw)]), np.array([-sin(yaw), cos(yaw)])
    rates = evaluate(variant, bank.values(), [0.0, 0.0, yaw, 20.0, 0.0, 0.0], [0.0, 0.0, 0.0]).state
    assert rates[3:5] == pytest.approx([ahead @ [0.3, -0.5], side @ [0.3, -0.5]])
    rates = evaluate(variant, bank.values(), [0.0, 0.0, yaw, 20.0, 1.0, 0.2], [0.0, 0.0, 0.0]).state
    assert rates[:3] == pytest.approx([*(20.0 * ahead + (1.0 - 1.5 * 0.2) * side), 0.2])


def test_gravity_across_a_car_that_rolls_in_a_curve_does_work_on_its_mass():
    bank, turn = replace(CAR, gravity_y=-0.5), tan(0.3) / 2.7
    rates = evaluate(KINEMATIC, bank.values(), [0.0, 0.0, 0.0, 3.0], [0.3, 0.0, 0.0]).state
    power = 1500.0 * -0.5 * 1.5 * turn * 3.0  # force times sideways velocity of the centre of mass
    assert (1500.0 + (1500.0 * 1.5**2 + 2400.0) * turn**2) * 3.0 * rates[3] == pytest.approx(power)


# --- derivatives and other scalars -------------------------------------------------------------------------------

POINTS = [(15.0, 0.05), (-6.0, 0.2), (1.7, 0.3), (0.3, -0.1), (12.0, 0.6)]  # from the blend to sliding


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize(("speed", "steering"), POINTS)
def test_derivatives_by_state_inputs_and_parameters_are_those_of_differences(variant, speed, steering):
    car = replace(
        LOSSES, com_height=0.5, servo_gain=300.0, front_drive=0.7, gravity_x=-0.3, gravity_y=0.2,
        roll_mass=1300.0, roll_height=0.45, roll_inertia=400.0, roll_stiffness=60e3, roll_damping=2500.0,
        front_roll_slip=0.1, rear_roll_slip=-0.2, overturning_arm=0.03,
    )  # fmt: skip
    start = {"yaw": 0.4, "vx": speed, "vy": 0.1, "yaw_rate": 0.2, "front_slip": 0.02, "rear_slip": -0.01}
    start |= {"roll": 0.03, "roll_rate": -0.2}
    x = [{"steering": steering, **start}.get(name, 0.5) for name in variant.state_names]
    u = [steering, 900.0, 700.0, *([0.1, speed + 0.5] if variant.actuators else [])]
    model = SingleTrack(car, variant)
    point = np.array([*x, *u, *car.values()])

    def rates(system, z):
        context = system.CreateDefaultContext()
        state, inputs, numbers = np.split(z, [len(x), len(x) + len(u)])
        context.SetContinuousState(state)
        inputs_by_name = dict(zip(["steering", "drive", "brake", "steering_rate", "speed"], inputs, strict=False))
        system.steering.FixValue(context, np.array([inputs_by_name[name] for name in names_of(model.steering)]))
        system.forces.FixValue(context, np.array([inputs_by_name[name] for name in names_of(model.forces)]))
        system.set_parameters(context, **dict(zip(PARAMETERS, numbers, strict=True)))
        outputs = [port.Eval(context) for port in (system.state, system.motion)]
        return np.concatenate([system.EvalTimeDerivatives(context).CopyToVector(), *outputs])

    exact = rates(model.ToAutoDiffXd(), InitializeAutoDiff(point).ravel())
    np.testing.assert_allclose([value.value() for value in exact], rates(model, point), rtol=1e-12, atol=1e-12)
    for column in range(len(point)):
        step = 1e-6 * max(1.0, abs(point[column]))
        moved = [rates(model, point + sign * step * np.eye(len(point))[column]) for sign in (1.0, -1.0)]
        slopes = (moved[0] - moved[1]) / (2.0 * step)
        derivatives = [value.derivatives()[column] if value.derivatives().size else 0.0 for value in exact]
        np.testing.assert_allclose(derivatives, slopes, rtol=2e-5, atol=2e-5 * max(1.0, np.abs(slopes).max()))


@pytest.mark.parametrize("variant", VARIANTS)
def test_the_compiled_equations_give_the_same_numbers_to_the_last_bit(variant):
    rng, states, inputs = np.random.default_rng(0), len(variant.state_names), len(variant.input_names)
    scales = np.resize([0.3, 4e3, 4e3, 1.0, 20.0], inputs)
    equations = CompiledEquations(variant)
    for parameters in (ROLLING, replace(ROLLING, mass=1200.0, drag=0.4, rotating_mass=30.0, gravity_x=0.5)):
        record = equations.parameters(np.array(parameters.values()))
        for size in np.repeat([0.0, 1e-3, 0.1, 1.0, 5.0], 40):  # standstill, the blend, sliding
            x, u = size * rng.normal(size=states), rng.normal(size=inputs) * scales
            x[3] *= 5.0
            expected = evaluate(variant, parameters.values(), x.tolist(), u.tolist())
            rates, motion = equations(record, x, equations.inputs(u))
            assert rates.tolist() == expected.state
            assert motion.tolist() == expected.motion


def test_changed_parameters_count_from_the_next_evaluation_on():
    model = SingleTrack(CAR, BRUSH)
    contexts = [model.CreateDefaultContext() for _ in range(2)]
    states = []
    for context in contexts:
        model.set_state(context, vx=20.0)
        model.steering.FixValue(context, [0.05])
        model.forces.FixValue(context, [0.0, 0.0])
        states.append(model.EvalTimeDerivatives(context).CopyToVector())
    model.set_parameters(contexts[0], yaw_inertia=2.0 * CAR.yaw_inertia)
    twice, once = (model.EvalTimeDerivatives(context).CopyToVector() for context in contexts)
    assert 2.0 * twice[5] == pytest.approx(once[5])
    assert once == pytest.approx(states[0], rel=0.0, abs=0.0)
    assert model.EvalTimeDerivatives(contexts[0].Clone()).CopyToVector() == pytest.approx(twice, rel=0.0, abs=0.0)


@pytest.mark.parametrize("variant", VARIANTS)
def test_at_standstill_all_derivatives_are_finite(variant):
    model = SingleTrack(LOSSES, variant).ToAutoDiffXd()
    context = model.CreateDefaultContext()
    count = context.num_continuous_states()
    context.SetContinuousState(InitializeAutoDiff(np.zeros(count)).ravel())
    for port in (model.steering, model.forces):
        port.FixValue(context, np.array([AutoDiffXd(0.0)] * port.size()))
    values = [*model.EvalTimeDerivatives(context).CopyToVector(), *model.motion.Eval(context)]
    assert all(np.isfinite(value.value()) and np.isfinite(value.derivatives()).all() for value in values)


def test_the_model_as_an_expression_gives_the_same_numbers():
    numbers = [1.0, 2.0, 0.3, 11.0, -0.2, 0.15]
    model = SingleTrack(CAR, BRUSH)
    context, symbolic = model.CreateDefaultContext(), model.ToSymbolic()
    context.SetContinuousState(numbers)
    other = symbolic.CreateDefaultContext()
    for system, where, kind in ((model, context, float), (symbolic, other, Expression)):
        system.steering.FixValue(where, np.array([kind(0.04)]))
        system.forces.FixValue(where, np.array([kind(500.0), kind(0.0)]))
    other.SetContinuousState(np.array([Expression(value) for value in numbers]))
    mine = model.EvalTimeDerivatives(context).CopyToVector()
    theirs = [value.Evaluate() for value in symbolic.EvalTimeDerivatives(other).CopyToVector()]
    np.testing.assert_allclose(theirs, mine, rtol=1e-12)


# --- low speed ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_parked_car_stays_where_it_is(variant):
    ride = Ride(LOSSES, variant, steering=0.4, vx=0.0).at(5.0)
    assert (ride["x"], ride["y"], ride["vx"], ride["wz"]) == (0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("speed", [0.2, 0.9, 2.0, -0.5, -2.5])
def test_a_slow_car_turns_on_the_circle_of_its_geometry(speed):
    ride = Ride(CAR, steering=0.2, drive=0.0, vx=speed, vy=0.3).at(3.0)
    assert ride["wz"] == pytest.approx(ride["vx"] * tan(0.2) / 2.7, rel=0.02)
    assert abs(ride["vy"]) < 0.02 * abs(speed)


def test_a_car_that_slides_sideways_is_not_kinematic():
    ride = Ride(CAR, BRUSH, vy=10.0).at(0.5)
    assert ride["vy"] + 1.5 * ride["wz"] == pytest.approx(10.0 - 0.5 * GRAVITY, rel=0.02)


def test_a_car_drives_off_through_the_blend_without_a_jerk():
    ride = Ride(CAR, BRUSH, steering=0.1, drive=3000.0)
    rates = [ride.at(0.02 * i)["wz"] / max(ride["vx"], 1e-3) for i in range(30, 250)]
    assert np.abs(np.diff(rates)).max() < 2e-3
    assert ride["vx"] > CAR.blend_end
    assert BLEND_TIME < 0.1


# --- the vehicle folder ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["bolt", "mkz", "catvehicle", "unior"])
def test_the_parameters_of_a_vehicle_are_what_its_inspection_measures(name):
    vehicle = load_vehicle(name)
    parameters, figures = estimate_parameters(vehicle), inspect_vehicle(vehicle)
    assert parameters.mass == pytest.approx(figures.mass)
    assert parameters.yaw_inertia == pytest.approx(figures.inertia[2])
    assert parameters.wheelbase == pytest.approx(figures.wheelbase)
    assert parameters.rear_length == pytest.approx(figures.com[0])
    assert parameters.front_stiffness == pytest.approx(12.0 * figures.loads[0])
    assert parameters.rear_stiffness == pytest.approx(16.0 * figures.loads[1])
    assert parameters.front_friction == max(link.friction or 0.0 for link in figures.links if link.spin is not None)
    wheels = sum(link.spin * link.mass for link in figures.links if link.spin is not None)
    assert parameters.rotating_mass == pytest.approx(wheels)  # these cars have no rotors
    assert parameters.front_drive == {"front": 1.0, "rear": 0.0, "all": 0.5}[vehicle.spec.drive]
    assert estimate_parameters(vehicle, drag=False).drag == 0.0
    assert estimate_parameters(vehicle, friction=0.5).rear_friction == 0.5


@pytest.mark.parametrize("name", ["bolt", "bolt@handling", "mkz@handling", "unior@handling"])
def test_the_height_of_the_centre_of_mass_is_that_of_the_plant_at_rest(name):
    """The plant at rest in point contact: tyres of stiffness k are deflected by N / k, which is 2 cm for a car."""
    vehicle, builder = load_vehicle(name), DiagramBuilder()
    parts = make_plant(builder, load_world("empty"), {"ego": vehicle}, spec=PlantSpec(time_step=0.005, contact="point"))
    simulator = Simulator(builder.Build())
    context = parts.plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    set_start(parts.plant, context, parts.vehicles["ego"], x=0.0, y=0.0, yaw=0.0, speed=0.0)
    simulator.AdvanceTo(1.0)
    height = parts.plant.CalcCenterOfMassPositionInWorld(context)[2]
    assert estimate_parameters(vehicle).com_height == pytest.approx(height, abs=1e-4 + 0.002 * height)


def test_a_context_has_its_own_parameters():
    model = make_single_track(load_vehicle("bolt"), tyres="brush", front_stiffness=80e3, rear_stiffness=90e3)
    context, other = model.CreateDefaultContext(), model.CreateDefaultContext()
    model.set_parameters(context, mass=2000.0)
    assert model.get_parameters(context).mass == 2000.0
    assert model.get_parameters(context).front_stiffness == 80e3
    assert model.get_parameters(other) == model.parameters
    with pytest.raises(ConfigError, match="no parameter 'mas'; did you mean 'mass'"):
        model.set_parameters(context, mas=1.0)
    with pytest.raises(ConfigError, match="mass must be > 0 and finite"):
        model.set_parameters(context, mass=0.0)
    with pytest.raises(ConfigError, match="no state 'v'"):
        model.set_state(context, v=1.0)


def test_invalid_arguments_are_rejected():
    vehicle = load_vehicle("bolt")
    with pytest.raises(ConfigError, match="unknown tyres 'brus'; did you mean 'brush'"):
        make_single_track(vehicle, tyres="brus")
    with pytest.raises(ConfigError, match="kinematic tyres have no slip"):
        make_single_track(vehicle, tyres="kinematic", relaxation=True)
    with pytest.raises(ConfigError, match="leave out roll, or use linear tyres"):
        SingleTrack(CAR, Variant("kinematic", roll=True))
    with pytest.raises(ConfigError, match="with roll: it has no suspension"):
        make_single_track(vehicle, roll=True)
    with pytest.raises(ConfigError, match=r"roll_stiffness must be above .* 5736\.89 N m/rad"):
        replace(ROLLING, roll_stiffness=5000.0)
    with pytest.raises(ConfigError, match="either parameters or stiffnesses"):
        make_single_track(vehicle, parameters=CAR, rear_stiffness=1e5)
    with pytest.raises(ConfigError, match="delay must be a multiple of the period"):
        make_single_track_vehicle(vehicle, delay=0.03)
    with pytest.raises(ConfigError, match="blend_end must be above blend_start"):
        replace(CAR, blend_end=0.5)
    with pytest.raises(ConfigError, match="gravity_z must be negative"):
        replace(CAR, gravity_z=9.81)
    with pytest.raises(ConfigError, match="front_drive must be"):
        replace(CAR, front_drive=1.5)


@pytest.mark.parametrize("variant", [LINEAR, Variant("linear", actuators=True), "control"])
def test_the_ports_are_those_of_the_docstring(variant):
    if variant == "control":
        system = SingleTrackControl(load_vehicle("bolt"), mass=1600.0)
    else:
        system = SingleTrack(CAR, variant)
    ports = [system.get_input_port(i) for i in range(system.num_input_ports())]
    ports += [system.get_output_port(i) for i in range(system.num_output_ports())]
    for port in ports:
        assert f"{port.get_name()} (" in (type(system).__doc__ or "")
        assert signals_of(port) is not None


# --- the control unit, and the full vehicle ----------------------------------------------------------------------


def _reduced(name, duration, *, speed=0.0, speed_setpoint, steering=0.0, **options):
    """Return the log of the state of a vehicle under a constant command: rows are those of the state, columns times."""
    builder = DiagramBuilder()
    vehicle = builder.AddSystem(make_single_track_vehicle(load_vehicle(name), **options))
    driver = builder.AddSystem(ConstantCommand(speed_setpoint, steering, period=0.02))
    builder.Connect(driver.get_output_port(0), vehicle.GetInputPort("command"))
    log = LogVectorOutput(vehicle.GetOutputPort("state"), builder, publish_period=0.02)
    simulator = Simulator(builder.Build())
    model = vehicle.GetSubsystemByName("single_track")
    model.set_state(model.GetMyMutableContextFromRoot(simulator.get_mutable_context()), vx=speed)
    ResetIntegratorFromFlags(simulator, "runge_kutta3", 0.01)
    simulator.get_mutable_integrator().set_fixed_step_mode(True)
    simulator.Initialize()
    simulator.AdvanceTo(duration)
    signal_log = log.FindLog(simulator.get_context())
    return signal_log.sample_times(), dict(zip(names_of(model.state), signal_log.data(), strict=True))


def _full(duration, *, speed=0.0, speed_setpoint, steering=0.0):
    spec = {
        "world": "empty",
        "vehicles": {"ego": {"model": "bolt", "speed": speed}},
        "control": {"ego": {"kind": "constant", "speed": speed_setpoint, "steering": steering}},
        "plant": {"contact": "point"},
    }
    return Simulation(assemble(spec)).run(duration=duration).signals


def test_the_reduced_bolt_turns_like_the_full_one():
    """Its contact has no slip, so stiff tyres come nearest; with the stiffness of rubber a car understeers."""
    full = _full(5.0, speed=5.0, speed_setpoint=5.0, steering=0.2)["ego.wz"]
    for factor, steady, transient in ((4.0, 0.01, 0.05), (1.0, 0.03, 0.12)):
        car = estimate_parameters(load_vehicle("bolt"))
        car = replace(car, front_stiffness=factor * car.front_stiffness, rear_stiffness=factor * car.rear_stiffness)
        times, state = _reduced("bolt", 5.0, speed=5.0, speed_setpoint=5.0, steering=0.2, parameters=car)
        assert state["wz"][-1] == pytest.approx(full.iloc[-1], rel=steady)
        difference = np.abs(state["wz"] - np.interp(times, full.index, full)).max()
        assert difference < transient * full.iloc[-1]


@pytest.mark.parametrize(("speed", "target_speed"), [(0.0, 5.0), (6.0, 1.5), (2.0, 0.0)])
def test_the_reduced_bolt_changes_its_speed_like_the_full_one(speed, target_speed):
    full = _full(4.0, speed=speed, speed_setpoint=target_speed)["ego.vx"]
    times, state = _reduced("bolt", 4.0, speed=speed, speed_setpoint=target_speed)
    assert np.abs(state["vx"] - np.interp(times, full.index, full)).max() < 0.05
    assert state["vx"][-1] == pytest.approx(target_speed, abs=0.05)


def test_the_unior_with_its_pid_and_linkage_reaches_its_speed():
    _, state = _reduced("unior", 6.0, speed_setpoint=1.0, steering=0.2, tyres="brush", relaxation=True)
    assert state["vx"][-1] == pytest.approx(1.0, rel=0.02)
    assert state["wz"][-1] > 0.05


def test_a_delay_shifts_the_response():
    times, prompt = _reduced("bolt", 2.0, speed=5.0, speed_setpoint=5.0, steering=0.1)
    _, late = _reduced("bolt", 2.0, speed=5.0, speed_setpoint=5.0, steering=0.1, delay=0.1)
    assert prompt["wz"][10] > 0.02
    np.testing.assert_allclose(late["wz"][5:50], prompt["wz"][:45], rtol=0.01, atol=1e-4)
    assert times[5] == pytest.approx(0.1)


def test_a_centre_of_mass_below_the_road_is_rejected():
    message = (
        r"catvehicle/\w+\.xacro:\d+: the centre of mass of 'catvehicle@published' is 0\.\d+ m below the road; check "
        r"mass and origin of link '\w+'"
    )
    with pytest.raises(ConfigError, match=message):
        estimate_parameters(load_vehicle("catvehicle@published"))


def test_dampers_behind_tyres_stiffen_a_body_that_rolls_quickly():
    """By complex moduli: 52 kN/m of spring and bar beside 2 kN s/m, and 61 beside 1.8, behind 200 kN/m each.

    Wheels of 40 and 30 kg that swing with 14 rad/s make it 7.84 and 5.88 kN/m less.
    """
    vehicle = load_vehicle("bolt@handling")
    slow, quick = (estimate_parameters(vehicle, roll=True, roll_frequency=w) for w in (0.0, 14.0))
    half = 0.5 * 1.501**2
    front = 1.0 / (1.0 / (2e5 - 7840.0) + 1.0 / (52e3 + 28e3j))
    rear = 1.0 / (1.0 / (2e5 - 5880.0) + 1.0 / (61e3 + 25.2e3j))
    assert quick.roll_stiffness == pytest.approx(half * (front + rear).real, rel=1e-6)
    assert quick.roll_damping == pytest.approx(half * (front + rear).imag / 14.0, rel=1e-6)
    assert slow.roll_stiffness == pytest.approx(half * (200e3 / (1.0 + 200 / 52) + 200e3 / (1.0 + 200 / 61)), rel=1e-6)
    # A damper works on the part of the way that the tyre leaves it, and its force as well.
    parts = (200 / 252) ** 2, (200 / 261) ** 2
    assert slow.roll_damping == pytest.approx(half * (2000.0 * parts[0] + 1800.0 * parts[1]), rel=1e-6)


def test_the_magic_formula_has_its_stiffness_its_peak_and_its_asymptote():
    stiffness, limit, shape, curvature = 90e3, 6400.0, 1.4, -1.2
    law = magic_formula_lateral_force
    assert law(1e-7, stiffness, limit, shape, curvature) == pytest.approx(-stiffness * 1e-7, rel=1e-6)
    slips = np.linspace(0.0, 3.0, 30001)
    forces = np.array([law(float(slip), stiffness, limit, shape, curvature) for slip in slips])
    assert forces.min() == pytest.approx(-limit, rel=1e-7)
    # For large slips, B x - E (B x - atan B x) grows without limit: the force tends to D sin(C pi / 2).
    assert law(1e6, stiffness, limit, shape, curvature) == pytest.approx(-limit * sin(shape * pi / 2.0), rel=1e-6)


def test_the_axle_of_the_handling_bolt_has_the_force_of_its_tyres():
    """The lateral force of the model against that of two full tyres at the static load, up to their shifts."""
    vehicle = load_vehicle("bolt@handling")
    parameters = estimate_parameters(vehicle, roll=True)
    load = 0.5 * parameters.mass * GRAVITY * parameters.rear_length / parameters.wheelbase
    assert isinstance(vehicle.spec.tyres, MagicFormulaTyres)
    tyre = vehicle.spec.tyres.axle_laws(vehicle.folder)[0](load, 0.0, 1.0)
    stiffness, limit = 2.0 * tyre.contact.stiffness_y, 2.0 * tyre.contact.friction_y
    for slip in (0.02, 0.05, 0.1, 0.2):
        both = tyre.forces(0.0, slip, 20.0)[1] - tyre.forces(0.0, -slip, 20.0)[1]
        ours = magic_formula_lateral_force(slip, stiffness, limit, parameters.front_shape, parameters.front_curvature)
        assert ours == pytest.approx(both, rel=0.02)


def test_wind_from_behind_carries_the_car_until_it_has_its_speed():
    # m v' = c (w - v)²: w - v = w / (1 + c w t / m) from standstill in the kinematic model
    car = replace(CAR, drag=0.5, wind_x=10.0)
    ride = Ride(car, KINEMATIC)
    ride.simulator.AdvanceTo(20.0)
    speed = ride.context.get_continuous_state_vector()[3]
    assert speed == pytest.approx(10.0 - 10.0 / (1.0 + 0.5 * 10.0 * 20.0 / 1500.0), rel=1e-6)
    assert ride.model.get_parameters(ride.context).wind_x == 10.0
