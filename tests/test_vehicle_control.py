"""The control unit of a vehicle in a small diagram, against numbers computed by hand."""

from math import atan, tan

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder

from mirdrake.controllers import VehicleControl
from mirdrake.plant.plant import PlantSpec, make_plant
from mirdrake.vehicles import load_vehicle
from mirdrake.worlds import load_world

L, KINGPIN = 2.601, 1.461 / 2.0


@pytest.fixture(scope="module")
def unit():
    """A control unit whose plant does not move: its state is given from outside."""
    builder = DiagramBuilder()
    parts = make_plant(builder, load_world("empty"), {"ego": load_vehicle("bolt")}, spec=PlantSpec(contact="point"))
    control = VehicleControl(parts.plant, parts.vehicles["ego"])
    return parts, control


def context_with(unit, *, speed, steering, stamp=0.0, vehicle_speed=0.0):
    parts, control = unit
    context = control.CreateDefaultContext()
    plant = parts.plant
    state = plant.GetPositionsAndVelocities(plant.CreateDefaultContext()).copy()
    base = parts.vehicles["ego"].base
    state[plant.num_positions() + base.floating_velocities_start_in_v() + 3] = vehicle_speed
    control.plant_state.FixValue(context, state)
    control.command.FixValue(context, [speed, steering, stamp])
    return context


def step(unit, context, *, times=1):
    """Run the periodic update, 20 ms apart."""
    _, control = unit
    for _ in range(times):
        control._update(context, context.get_mutable_state())
        context.SetTime(context.get_time() + 0.02)


def status(unit, context):
    return unit[1].status.Eval(context)


def test_speed_and_steering_set_points_rise_with_the_limited_slopes(unit):
    # 3 m/s² and 0.5 rad/s for 0.2 s: 0.6 m/s and 0.1 rad
    context = context_with(unit, speed=5.0, steering=0.3)
    step(unit, context, times=10)
    assert status(unit, context)[:2] == pytest.approx([0.6, 0.1])


def test_wheel_angles_follow_from_the_turning_centre(unit):
    context = context_with(unit, speed=0.0, steering=0.05)
    step(unit, context, times=5)  # 0.5 rad/s · 0.1 s
    radius = L / tan(0.05)
    desired = unit[1].desired_state.Eval(context)
    angles = sorted(angle for angle in desired[:6] if angle != 0.0)
    assert angles == pytest.approx([atan(L / (radius + KINGPIN)), atan(L / (radius - KINGPIN))])


def test_after_0_2_s_without_messages_the_speed_set_point_is_zero_and_the_steering_stays(unit):
    context = context_with(unit, speed=0.3, steering=0.05)
    step(unit, context, times=11)  # the eleventh update is at 0.20 s: still alive
    assert status(unit, context)[:2] == pytest.approx([0.3, 0.05])
    step(unit, context, times=3)  # 0.22, 0.24 and 0.26 s: 5 m/s² down
    assert status(unit, context)[:2] == pytest.approx([0.0, 0.05])


def test_a_command_that_is_not_a_number_is_ignored(unit):
    context = context_with(unit, speed=np.nan, steering=0.05)
    step(unit, context, times=3)
    assert status(unit, context)[:2] == pytest.approx([0.0, 0.0])


def test_torque_for_the_slope_is_mass_times_slope_times_radius_over_the_driven_wheels(unit):
    parts, control = unit
    context = context_with(unit, speed=5.0, steering=0.0)
    step(unit, context)
    rest, _ = parts.vehicles["ego"].rest_compressions(parts.plant)
    expected = 1616.0 * 3.0 * (0.3234 - rest) / 2.0
    torques = control.actuation.Eval(context)
    assert sorted(torques)[-2:] == pytest.approx([expected, expected])
    assert np.count_nonzero(torques) == 2  # front wheels only


def test_it_starts_from_the_speed_that_the_vehicle_has(unit):
    _, control = unit
    context = context_with(unit, speed=5.0, steering=0.0, vehicle_speed=5.0)
    control.ExecuteInitializationEvents(context)
    assert status(unit, context)[0] == pytest.approx(5.0)


def test_gains_of_the_speed_loop_are_parameters_of_the_context(unit):
    _, control = unit
    context = context_with(unit, speed=1.0, steering=0.0, vehicle_speed=0.96)
    control.ExecuteInitializationEvents(context)
    other = context_with(unit, speed=1.0, steering=0.0, vehicle_speed=0.96)
    control.ExecuteInitializationEvents(other)
    other.get_mutable_numeric_parameter(0).SetFromVector([10.0, 0.0])
    step(unit, context)
    step(unit, other)
    # set-point 1.0 after one step (3 m/s² · 0.02 s = 0.06 > 0.04), error 0.04
    assert status(unit, context)[2] == pytest.approx(1.0 * 0.04)
    assert status(unit, other)[2] == pytest.approx(10.0 * 0.04)


@pytest.mark.parametrize(
    "name",
    ["bolt", "bolt@published", "mkz@handling", "catvehicle", "unior", "unior@published", "unior@printed_steering"],
)
def test_machine_code_does_the_same_to_the_bit(name):
    parts = make_plant(
        DiagramBuilder(), load_world("empty"), {"ego": load_vehicle(name)}, spec=PlantSpec(contact="point")
    )
    plant, trajectories = parts.plant, []
    at_rest = plant.GetPositionsAndVelocities(plant.CreateDefaultContext())
    for machine_code in (False, True):
        control = VehicleControl(plant, parts.vehicles["ego"], machine_code=machine_code)
        context, random, states = control.CreateDefaultContext(), np.random.default_rng(1), []
        for k in range(60):
            state = at_rest + np.where(np.arange(len(at_rest)) < 7, 0.0, random.uniform(-0.3, 0.3, len(at_rest)))
            control.plant_state.FixValue(context, state)
            stamp = -1.0 if 30 < k < 45 else context.get_time()  # no message for a while
            control.command.FixValue(context, [random.uniform(-2.0, 6.0), random.uniform(-0.6, 0.6), stamp])
            control._update(context, context.get_mutable_state())
            context.SetTime(context.get_time() + 1.0 / parts.vehicles["ego"].vehicle.control.rate)
            values = context.get_discrete_state()
            states.append(np.concatenate([values.get_vector(i).value() for i in range(values.num_groups())]))
        trajectories.append(np.array(states))
    assert np.ptp(trajectories[0], axis=0).max() > 0.1
    assert np.array_equal(trajectories[0], trajectories[1])
