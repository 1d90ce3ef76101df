"""Aerodynamic forces against closed forms: drag, wind, lift, their points of action, and a coast-down.

With k = ½ ρ A and the inertia m' = m + 4 I / R² of a car on rolling wheels, a coast-down without other losses is
v(t) = v0 / (1 + k v0 t / m'); in a wind along the road the same holds of the speed past the air.
"""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder, ConstantVectorSource

from mirdrake.assembly.diagram import assemble, load_diagram, make_spec
from mirdrake.core.errors import ConfigError
from mirdrake.plant.aerodynamics import AirForces, Gust, has_air_forces, pressure_centre
from mirdrake.plant.plant import PlantSpec, make_plant, set_start
from mirdrake.runs.simulation import Simulation
from mirdrake.vehicles import load_vehicle
from mirdrake.worlds import load_world
from tests.rigs import add_tyres, free_rolling, with_rolling_resistance

AREA, DENSITY = 0.825, 1.2
MASS = 1616.0 + 4 * 0.5 * 20.0  # with the spin of four cylinders of 20 kg


def in_air(*, density=DENSITY, wind=(0.0, 0.0), **shape):
    """Return a Bolt with some of its aerodynamics changed, in a plant, and the air around it."""
    vehicle = free_rolling(with_rolling_resistance(load_vehicle("bolt"), 0.0))
    air = vehicle.spec.aerodynamics.model_copy(update={"drag_area": AREA} | shape)
    vehicle = replace(vehicle, spec=vehicle.spec.model_copy(update={"aerodynamics": air}))
    builder = DiagramBuilder()
    parts = make_plant(builder, load_world("empty"), {"ego": vehicle}, spec=PlantSpec(contact="point"))
    return builder, parts, AirForces(parts.plant, parts.vehicles["ego"], density=density, wind=wind)


def air_force(*, speed, yaw=0.0, turning=0.0, **options):
    """Generalised force on the base [N m, N] in a state: forward speed [m/s], heading [rad], yaw rate [rad/s]."""
    _, parts, air = in_air(**options)
    plant, part = parts.plant, parts.vehicles["ego"]
    root = plant.CreateDefaultContext()
    set_start(plant, root, part, x=3.0, y=-2.0, yaw=yaw, speed=speed)
    velocities = plant.GetVelocities(root).copy()
    start = part.base.floating_velocities_start_in_v()
    velocities[start + 2] = turning
    plant.SetVelocities(root, velocities)
    context = air.CreateDefaultContext()
    air.plant_state.FixValue(context, plant.GetPositionsAndVelocities(root))
    state = air.EvalUniquePeriodicDiscreteUpdate(context)
    force = np.array(state.value(0))
    assert np.delete(force, range(start, start + 6)) == pytest.approx(0.0)
    assert np.array(state.value(1)) == pytest.approx(force[start + 3 : start + 6])
    return force[start : start + 6], plant, part, root


def test_drag_is_half_the_density_times_area_times_speed_squared_and_points_backwards():
    force, *_ = air_force(speed=20.0)
    assert force[3:] == pytest.approx([-0.5 * DENSITY * AREA * 400.0, 0.0, 0.0])
    assert air_force(speed=-20.0)[0][3] == pytest.approx(0.5 * DENSITY * AREA * 400.0)


@pytest.mark.parametrize("yaw", [0.0, 0.7, 2.5])
def test_wind_counts_by_the_velocity_of_the_air_past_the_car(yaw):
    force, *_ = air_force(speed=12.0, yaw=yaw, wind=(-3.0, 5.0))
    past = np.array([-3.0, 5.0]) - 12.0 * np.array([np.cos(yaw), np.sin(yaw)])
    assert force[3:5] == pytest.approx(0.5 * DENSITY * AREA * np.linalg.norm(past) * past)
    assert force[5] == 0.0
    assert air_force(speed=8.0, wind=(8.0, 0.0))[0] == pytest.approx(0.0, abs=1e-9)  # driving with the wind


def test_drag_acts_at_the_centre_of_mass_or_at_a_stated_height():
    for height in (None, 0.9, 0.0):
        force, plant, part, root = air_force(speed=20.0, yaw=0.4, wind=(0.0, 6.0), height=height)
        com = plant.CalcCenterOfMassPositionInWorld(root, [part.instance])
        lever = com - plant.EvalBodyPoseInWorld(root, part.base).translation()
        torque = force[:3] - np.cross(lever, force[3:])  # about the centre of mass
        up = plant.EvalBodyPoseInWorld(root, part.base).rotation().matrix()[:, 2]
        above = (0.5 if height is None else height) - 0.5
        assert torque == pytest.approx(np.cross(above * up, force[3:]), abs=1e-9)
        assert pressure_centre(plant, part) == pytest.approx((0.56 * 2.601, 0.0, 0.5 if height is None else height))


def test_a_car_that_yaws_about_its_pressure_centre_has_no_airspeed_there():
    # yaw rate w moves the centre of mass by w x to the left, a wind of that speed goes with it
    x = 0.56 * 2.601
    assert air_force(speed=0.0, turning=2.0, wind=(0.0, 2.0 * x))[0] == pytest.approx(0.0, abs=1e-2)


def test_lift_loads_each_axle_by_its_own_coefficient():
    front, rear = 0.1, -0.2
    force, *_ = air_force(speed=30.0, drag_area=0.0, front_lift_area=front, rear_lift_area=rear)
    q = 0.5 * DENSITY * 900.0
    assert force[5] == pytest.approx(q * (front + rear), rel=1e-5)
    assert force[1] == pytest.approx(-q * front * 2.601, rel=1e-5)  # up at the front: nose up is negative about y
    side, *_ = air_force(speed=0.0, wind=(0.0, 30.0), drag_area=0.0, front_lift_area=front)
    assert side == pytest.approx(0.0, abs=1e-9)  # across the car


@pytest.mark.parametrize("step", [0.0025, 0.005])
@pytest.mark.parametrize("wind", [0.0, -10.0, 10.0])
def test_coast_down_follows_the_closed_form(wind, step):
    builder, parts, air = in_air(wind=(wind, 0.0))
    plant, part = parts.plant, parts.vehicles["ego"]
    tyres = add_tyres(builder, parts)
    total = builder.AddSystem(Adder(2, plant.num_velocities()))
    builder.AddSystem(air)
    builder.Connect(tyres.generalized_force, total.get_input_port(0))
    builder.Connect(air.generalized_force, total.get_input_port(1))
    builder.Connect(plant.get_state_output_port(), air.plant_state)
    builder.Connect(total.get_output_port(), plant.get_applied_generalized_force_input_port())
    straight = builder.AddSystem(ConstantVectorSource(np.zeros(2 * plant.num_actuators(part.instance))))
    builder.Connect(straight.get_output_port(), plant.get_desired_state_input_port(part.instance))
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    start, duration = 40.0, 8.0
    set_start(plant, context, part, x=0.0, y=0.0, yaw=0.0, speed=start)
    simulator.AdvanceTo(duration)
    past, k = start - wind, 0.5 * DENSITY * AREA
    expected = past / (1.0 + k * past * duration / MASS) + wind
    speed = plant.GetVelocities(context)[part.base.floating_velocities_start_in_v() + 3]
    assert (start - speed) == pytest.approx(start - expected, rel=0.005)


def test_a_diagram_has_the_air_density_and_wind_of_its_plant():
    def settled(**plant):
        spec = {
            "world": "empty",
            "vehicles": {"ego": {"model": "bolt", "speed": 25}},
            "control": {"ego": {"kind": "constant", "speed": 25}},
            "plant": {"contact": "point", **plant},
        }
        signals = Simulation(assemble(spec)).run(duration=6.0).signals.loc[5.0:]
        radius = 0.3234 - 8875.0 / 2.0 / 2e5  # tyres of 2e5 N/m under the front axle's load
        return sum(signals[f"ego.wheel_torque.{wheel}"].mean() for wheel in ("front_left", "front_right")) / radius

    # what drives against the air is what drives with it less what drives without
    still = settled(air_density=0)
    area = load_vehicle("bolt").spec.aerodynamics.drag_area
    assert settled() - still == pytest.approx(0.5 * DENSITY * area * 625.0, rel=0.03)
    assert settled(wind=[-5, 0]) - still == pytest.approx(0.5 * DENSITY * area * 900.0, rel=0.03)


def test_without_air_or_area_nothing_is_added():
    def systems(model, **plant):
        spec = {"world": "empty", "vehicles": {"ego": {"model": model}}, "plant": plant}
        spec["control"] = {"ego": {"kind": "constant", "speed": 0}}
        return {system.get_name() for system in assemble(spec).diagram.GetSystems()}

    assert "ego.aerodynamics" in systems("bolt")
    assert "ego.aerodynamics" not in systems("bolt", air_density=0)
    part = in_air(drag_area=0.0)[1].vehicles["ego"]
    assert not has_air_forces(part, 1.2)


@pytest.mark.parametrize(
    ("plant", "expected"),
    [
        (
            "air_density: -1",
            "air.yaml:3: plant.air_density: -1 is not allowed; it should be greater than or equal to 0",
        ),
        ("wind: [1]", "air.yaml:3: plant.wind"),
        ("wind: 3", "air.yaml:3: plant.wind: 3 is not a list"),
        ("wind: [0, fast]", "air.yaml:3: plant.wind.1: 'fast' is not a number"),
    ],
)
def test_bad_values_are_rejected_with_file_and_line(tmp_path, plant, expected):
    file = tmp_path / "air.yaml"
    file.write_text(f"world: empty\nvehicles: {{ego: {{model: bolt}}}}\nplant: {{{plant}}}\n", encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_diagram(str(file))
    assert expected in str(caught.value)


def test_wind_takes_units():
    spec = make_spec({"world": "empty", "vehicles": {"ego": {"model": "bolt"}}, "plant": {"wind": ["36 km/h", 0]}})
    assert spec.plant.wind == (10.0, 0.0)


def test_a_side_wind_pushes_by_its_own_area_and_turns_the_nose_away():
    area, ahead = 2.4, 0.4
    plain, plant, part, root = air_force(speed=0.0, wind=(0.0, 10.0))
    force, *_ = air_force(speed=0.0, wind=(0.0, 10.0), side_area=area, side_ahead=ahead)
    # ½ ρ A w² = 144 N to the left; its moment about the centre of mass is 144 N x 0.4 m, to the left.
    assert force[4] == pytest.approx(0.5 * DENSITY * area * 100.0)
    com = plant.CalcCenterOfMassPositionInWorld(root, [part.instance])
    lever = com - plant.EvalBodyPoseInWorld(root, part.base).translation()
    about = force[:3] - np.cross(lever, force[3:])
    assert about[2] == pytest.approx(0.5 * DENSITY * area * 100.0 * ahead, rel=1e-5)
    assert plain[4] == pytest.approx(0.5 * DENSITY * AREA * 100.0)  # without data as the drag
    # Driving into the wind: drag only.
    assert air_force(speed=20.0, side_area=area, side_ahead=ahead)[0] == pytest.approx(air_force(speed=20.0)[0])


def test_a_gust_rises_and_falls_with_half_a_cosine():
    gust = Gust((0.0, 12.0), 3.0, 2.0, 0.4)
    times = (2.9, 3.0, 3.1, 3.2, 3.4, 4.0, 4.8, 5.1)
    expected = (0.0, 0.0, 0.5 - 0.5 * np.cos(np.pi / 4.0), 0.5, 1.0, 1.0, 0.5, 0.0)
    assert [gust.strength(time) for time in times] == pytest.approx(expected)
    # In the middle of its rise the air of a car at rest has half of the speed, a quarter of the force.
    _, parts, _ = in_air()
    plant, part = parts.plant, parts.vehicles["ego"]
    air = AirForces(plant, part, density=DENSITY, gusts=[gust])
    root, context = plant.CreateDefaultContext(), air.CreateDefaultContext()
    set_start(plant, root, part, x=0.0, y=0.0, yaw=0.0)
    air.plant_state.FixValue(context, plant.GetPositionsAndVelocities(root))
    for time, share in ((2.0, 0.0), (3.2, 0.25), (4.0, 1.0)):
        context.SetTime(time)
        force = np.array(air.EvalUniquePeriodicDiscreteUpdate(context).value(1))
        assert force[1] == pytest.approx(share * 0.5 * DENSITY * AREA * 144.0, abs=1e-9)
