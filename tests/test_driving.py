"""Driving of the Bolt against geometry: circles, lines, laps, and standstill."""

from math import atan, radians, tan

import numpy as np
import pandas as pd
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from mirdrake.assembly.diagram import assemble
from mirdrake.plant.plant import PlantSpec, make_plant, set_start
from mirdrake.runs.simulation import Simulation
from mirdrake.vehicles import load_vehicle
from mirdrake.worlds import load_world
from tests.rigs import add_tyres, drive, free_rolling

WHEELBASE = 2.601
TOLERANCE = {"point": 0.005, "hydroelastic": 0.01}


def circle(steering, contact, speed=5.0, **plant):
    rows = [
        {"time": 0, "speed": speed},
        {"time": 0.5, "speed": speed},
        {"time": 1.5, "speed": speed, "steering": steering},
    ]
    run = drive(14.0, speed=speed, control={"kind": "schedule", "rows": rows}, contact=contact, **plant)
    return run.signals.loc[8.0:]


@pytest.mark.parametrize(
    ("contact", "step"),
    [
        ("point", 0.005),
        ("hydroelastic", 0.005),
        ("hydroelastic", 0.01),
        *(pytest.param(contact, 0.002, marks=pytest.mark.slow) for contact in TOLERANCE),
        pytest.param("point", 0.01, marks=pytest.mark.slow),
    ],
)
def test_yaw_rate_on_a_circle_is_speed_times_tangent_of_steering_over_wheelbase(contact, step):
    steady = circle(0.2, contact, time_step=step)
    ideal = steady["ego.vx"].mean() * tan(0.2) / WHEELBASE
    assert steady["ego.wz"].mean() == pytest.approx(ideal, rel=TOLERANCE[contact])
    assert steady["ego.vx"].mean() == pytest.approx(5.0, rel=0.005)
    assert steady["ego.wz"].std() < 0.002 * ideal


@pytest.mark.parametrize(("contact", "speed"), [("point", 5.0), ("point", 25.0), ("hydroelastic", 5.0)])
def test_straight_ahead_the_wheels_do_not_push_against_each_other(contact, speed):
    # a steering deflection of 1e-4 rad increases the force to 3.9 kN, all the friction of a wheel
    spec = {
        "world": "empty",
        "vehicles": {"ego": {"model": "bolt", "speed": speed}},
        "control": {"ego": {"kind": "constant", "speed": speed}},
        "plant": {"contact": contact},
    }
    assembly = assemble(spec)
    plant, context = assembly.parts.plant, assembly.make_context()
    simulator = Simulator(assembly.diagram, context)
    own, sideways = plant.GetMyContextFromRoot(context), []
    for time in np.arange(1.0, 2.0, 0.02):
        simulator.AdvanceTo(time)
        results = plant.get_contact_results_output_port().Eval(own)
        points = [results.point_pair_contact_info(i) for i in range(results.num_point_pair_contacts())]
        patches = [results.hydroelastic_contact_info(i) for i in range(results.num_hydroelastic_contacts())]
        forces = [point.contact_force() for point in points] + [patch.F_Ac_W().translational() for patch in patches]
        assert len(forces) == 4
        sideways += [abs(force[1]) for force in forces]
    assert max(sideways) < 100.0  # N, of 4.4 kN on a wheel


@pytest.mark.parametrize("contact", ["point", "hydroelastic"])
def test_left_and_right_circles_mirror_each_other(contact):
    left, right = circle(0.2, contact), circle(-0.2, contact)
    assert right["ego.wz"].mean() == pytest.approx(-left["ego.wz"].mean(), rel=1e-3)
    assert right["ego.vy"].mean() == pytest.approx(-left["ego.vy"].mean(), abs=1e-3)


@pytest.mark.parametrize("drive_axle", ["front", "rear", "all"])
def test_each_drive_reaches_the_speed_and_turns_alike(drive_axle):
    spec = {
        "world": "empty",
        "vehicles": {"ego": {"model": "bolt", "arguments": {"drive": drive_axle}}},
        "control": {"ego": {"kind": "schedule", "rows": [{"time": 0, "speed": 5, "steering": 0.1}]}},
        "plant": {"contact": "point"},
    }
    run = Simulation(assemble(spec)).run(duration=12.0)
    steady = run.signals.loc[8.0:]
    torque = steady[[f"ego.wheel_torque.{wheel}" for wheel in ("front_left", "rear_left")]].abs().mean()
    driven = {"front": (True, False), "rear": (False, True), "all": (True, True)}[drive_axle]
    assert tuple(torque > 1.0) == driven
    assert steady["ego.vx"].mean() == pytest.approx(5.0, rel=0.005)
    assert steady["ego.wz"].mean() == pytest.approx(5.0 * tan(0.1) / WHEELBASE, rel=0.005)


@pytest.mark.parametrize("contact", ["point", "hydroelastic"])
def test_standing_start_follows_the_slope_of_the_command(contact):
    # 2 m/s² for 2 s, then 4 m/s: after 4 s the car has driven 2·2²/2 + 4·2 = 12 m
    rows = [{"time": 0, "speed": 0}, {"time": 2, "speed": 4}, {"time": 4, "speed": 4}]
    run = drive(4.0, control={"kind": "schedule", "rows": rows}, contact=contact)
    assert run["ego.x"].iloc[-1] == pytest.approx(12.0, abs=0.4)
    assert run["ego.vx"].iloc[-1] == pytest.approx(4.0, rel=0.01)


@pytest.mark.parametrize("contact", ["point", "hydroelastic"])
def test_braking_to_a_stop_ends_at_rest_with_the_drive_holding(contact):
    rows = [{"time": 0, "speed": 4}, {"time": 1, "speed": 4}, {"time": 3, "speed": 0}]
    run = drive(7.0, speed=4.0, control={"kind": "schedule", "rows": rows}, contact=contact)
    assert abs(run["ego.vx"].iloc[-1]) < 1e-3
    assert run["ego.x"].iloc[-1] == pytest.approx(4.0 + 4.0, abs=0.4)  # 4 m/s for 1 s, then 4²/(2·2)


def slope_world(tmp_path, degrees):
    path = tmp_path / "slope.yaml"
    path.write_text(
        "mirdrake: world/1\nname: slope\n"
        f"ground: {{surface: asphalt, mu: 0.9, slope: {{grade: {tan(radians(degrees))}, heading: 0 deg}}}}\n"
        "start: {origin: {at: [0, 0], yaw: 0 deg}}\n"
    )
    return str(path)


@pytest.mark.parametrize("approximation", ["lagged", "sap"])
@pytest.mark.parametrize("contact", ["point", "hydroelastic"])
@pytest.mark.parametrize("degrees", [pytest.param(0.0, marks=pytest.mark.slow), 5.0])
def test_parked_for_ten_seconds_it_creeps_less_than_a_twentieth_of_a_millimetre(
    tmp_path, degrees, contact, approximation
):
    spec = {
        "world": slope_world(tmp_path, degrees),
        "vehicles": {"ego": {"model": "bolt", "parked": True}},
        "control": {"ego": {"kind": "constant", "speed": 0}},
        "plant": {"contact": contact, "approximation": approximation},
    }
    signals = Simulation(assemble(spec)).run(duration=12.0).signals.loc[2.0:]
    creep = np.hypot(signals["ego.x"] - signals["ego.x"].iloc[0], signals["ego.y"] - signals["ego.y"].iloc[0])
    assert creep.max() < 5e-5


def test_without_brakes_it_rolls_down_a_slope_as_in_closed_form(tmp_path):
    # a = g (sin 5° - Crr cos 5°) / (1 + sum of I/R² over m); no driver, wheel loops off
    world = slope_world(tmp_path, 5.0)
    vehicle = free_rolling(load_vehicle("bolt"))
    assert vehicle.spec.tyres.rolling_resistance == 0.0079
    angle = radians(5.0)
    expected = 9.80665 * (np.sin(angle) - 0.0079 * np.cos(angle)) / (1.0 + 40.0 / 1616.0)
    signals = coast_on(world, vehicle, duration=4.0)
    measured = (signals[3.0] - signals[1.0]) / 2.0
    assert -measured == pytest.approx(expected, rel=0.01)


def coast_on(world, vehicle, duration):
    """Return the forward speed [m/s] by time [s] of a free-rolling vehicle."""
    builder = DiagramBuilder()
    parts = make_plant(builder, load_world(world), {"ego": vehicle}, spec=PlantSpec(contact="point"))
    plant, part = parts.plant, parts.vehicles["ego"]
    tyres = add_tyres(builder, parts)
    builder.Connect(tyres.generalized_force, plant.get_applied_generalized_force_input_port())
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    set_start(plant, context, part, x=0.0, y=0.0, yaw=0.0)
    for joint in part.steering:
        joint.set_angle(context, 0.0)
    speeds = {}
    for time in np.arange(0.0, duration + 1e-9, 0.5):
        simulator.AdvanceTo(float(time))
        speeds[float(time)] = float(plant.GetVelocities(context)[part.base.floating_velocities_start_in_v() + 3])
    return speeds


@pytest.mark.slow
def test_one_lap_of_the_test_track_on_points():
    check_lap("point")


@pytest.mark.slow
def test_one_lap_of_the_test_track_on_hydroelastic_patches():
    check_lap("hydroelastic")


def check_lap(contact):
    control = {"kind": "path_tracking", "track": "main", "speed": 5.0}
    spec = {
        "world": "test_track",
        "vehicles": {"ego": {"model": "bolt", "start": "line"}},
        "control": {"ego": control},
        "plant": {"contact": contact},
        "laps": 1,
    }
    run = Simulation(assemble(spec)).run(duration=260.0)
    figures = run.summary["vehicles"]["ego"]
    assert run.summary["stop_reason"] == "laps"
    assert figures["laps"] == pytest.approx(1.0, abs=0.01)
    assert run["ego.wheels_on_road"].min() == 4
    assert figures["max_abs_lateral_error_m"] < 0.30
    straight = run.signals[(run["ego.curvature"].abs() < 1e-6) & (run.signals.index > 8.0)]
    cruising = straight[straight["ego.speed_command"] == 5.0]
    assert len(cruising) > 1000
    assert (cruising["ego.vx"].rolling(50).mean().dropna() - 5.0).abs().max() < 0.005 * 5.0


def test_steering_command_and_wheel_angles_are_related_by_the_turning_centre():
    steady = circle(0.2, "point")
    radius = WHEELBASE / tan(0.2)
    kingpin = 1.461 / 2.0
    assert steady["ego.steering_angle.left"].mean() == pytest.approx(atan(WHEELBASE / (radius - kingpin)), abs=2e-3)
    assert steady["ego.steering_angle.right"].mean() == pytest.approx(atan(WHEELBASE / (radius + kingpin)), abs=2e-3)


@pytest.mark.parametrize("contact", ["hydroelastic", "point"])
def test_grip_does_not_fade_with_speed(contact):
    """Drake's `lagged` loses the patch of a wheel that moves half its length in a step; the default must not."""
    rows = [{"time": 0, "speed": 30}, {"time": 0.5, "speed": 30}, {"time": 0.51, "speed": 0}]
    braking = drive(
        3.5, speed=30.0, control={"kind": "schedule", "rows": rows, "interpolation": "hold"}, contact=contact
    )
    speed = braking["ego.vx"]
    slope = (speed.loc[3.0] - speed.loc[1.5]) / 1.5
    assert slope == pytest.approx(-5.0, rel=0.05)  # max_deceleration of the Bolt's control.yaml


@pytest.mark.parametrize("contact", ["point", "hydroelastic"])
def test_machine_code_drives_as_python_does(contact):
    drives = []
    for machine_code in (False, True):
        plant = {"contact": contact, "machine_code": machine_code}
        spec = {
            "world": "empty",
            "vehicles": {"ego": {"model": "bolt", "start": {"x": 0, "y": 0}}},
            "control": {"ego": {"kind": "constant", "speed": 4.0, "steering": 0.2}},
            "plant": plant,
        }
        drives.append(Simulation(assemble(spec)).run(duration=2.0).signals)
    assert drives[0]["ego.wz"].abs().max() > 0.1
    pd.testing.assert_frame_equal(drives[0], drives[1], check_exact=True)
