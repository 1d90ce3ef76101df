"""Every reference vehicle on its tyres, springs and pedals: standstill, walking pace, energy."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid

from mirdrake.assembly.diagram import assemble
from mirdrake.core.constants import GRAVITY
from mirdrake.runs.simulation import Simulation
from tests.ground_rigs import drive as on_ground_drive
from tests.handling_rigs import HANDLING, EnergyWatch, free_handling, rolling_car
from tests.tyre_rigs import make_slope

FIVE_DEGREES = float(np.tan(np.radians(5.0)))
FX = [f"ego.tyre_fx.{wheel}" for wheel in ("front_left", "front_right", "rear_left", "rear_right")]


def drive(folder: Path, name: str, rows, *, duration, grade=0.0, contact="point", parked=False):
    """Return assembly and signals of a vehicle that follows rows of time [s], speed [m/s] and steering angle [rad]."""
    spec = {
        "world": str(make_slope(folder, grade)),
        "vehicles": {
            "ego": {"model": f"{name}@handling", "speed": rows[0][1], "parked": parked, "start": {"x": 0, "y": 0}}
        },
        "control": {"ego": {"kind": "schedule", "rows": [{"time": t, "speed": v, "steering": s} for t, v, s in rows]}},
        "plant": {"air_density": 0.0, "contact": contact},
        "record": {"rate": 50.0},
    }
    assembly = assemble(spec)
    return assembly, Simulation(assembly).run(duration=duration).signals


# --- energy ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", HANDLING)
@pytest.mark.parametrize("contact", ["point", "tyre"])
def test_a_coast_without_losses_keeps_its_energy(tmp_path, name, contact):
    speed = 8.0 if name == "unior" else 20.0
    assembly = rolling_car(free_handling(tmp_path, name), speed=speed, steering=0.0, contact=contact)
    watch = EnergyWatch(assembly)
    Simulation(assembly).run(duration=2.0, monitor=watch)
    assert watch.stored[-1] == pytest.approx(watch.stored[0], rel=1e-4)


@pytest.mark.parametrize("name", HANDLING)
@pytest.mark.parametrize("contact", ["point", "tyre"])
def test_energy_lost_in_a_turn_is_dissipated_by_tyres_and_dampers(tmp_path, name, contact):
    speed, steering = (8.0, 0.06) if name == "unior" else (20.0, 0.03)
    assembly = rolling_car(free_handling(tmp_path, name), speed=speed, steering=steering, contact=contact)
    watch = EnergyWatch(assembly)
    end = Simulation(assembly).run(duration=4.0, monitor=watch).signals.iloc[-1]
    assert end["ego.wz"] * end["ego.vx"] > 0.25 * GRAVITY
    lost, dissipated = watch.stored[-1] - watch.stored[0], watch.taken[-1] + watch.steered[-1]
    assert lost < -0.02 * watch.stored[0]
    assert dissipated == pytest.approx(lost, rel=0.01)


@pytest.mark.parametrize("contact", ["point", "tyre"])
def test_the_pose_is_the_integral_of_the_velocities(tmp_path, contact):
    """A step of the steering with time steps of 10 ms; half a step would be 1e-3 rad, 0.1 m ahead and 0.03 m aside."""
    signals = on_ground_drive(tmp_path, duration=2.0, contact=contact, step=0.01, speed=20.0, steering=0.03)
    names = ("roll", "pitch", "yaw", "vx", "vy", "vz", "wy", "wz", "x", "y")
    roll, pitch, yaw, vx, vy, vz, wy, wz, x, y = (signals[f"ego.{name}"].to_numpy() for name in names)
    assert yaw[-1] > 0.2
    turn = (wy * np.sin(roll) + wz * np.cos(roll)) / np.cos(pitch)
    # Velocity in horizontal axes along the heading.
    left = vy * np.cos(roll) - vz * np.sin(roll)
    ahead = vx * np.cos(pitch) + (vy * np.sin(roll) + vz * np.cos(roll)) * np.sin(pitch)
    rates = turn, ahead * np.cos(yaw) - left * np.sin(yaw), ahead * np.sin(yaw) + left * np.cos(yaw)
    for position, rate, tolerance in zip((yaw, x, y), rates, (1e-4, 1e-3, 1e-3), strict=True):
        moved = cumulative_trapezoid(rate, signals.index, initial=0.0)
        assert position - position[0] == pytest.approx(moved, abs=tolerance)
    assert [x[0], y[0]] == pytest.approx([0.0, 0.0], abs=1e-9)


# --- standstill and walking pace ---------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", HANDLING)
@pytest.mark.parametrize("contact", ["point", "hydroelastic"])
@pytest.mark.parametrize("parked", [True, False], ids=["parked", "pedals"])
def test_on_a_slope_of_five_degrees_nothing_creeps(tmp_path, name, contact, parked):
    _, run = drive(
        tmp_path, name, [(0, 0, 0), (1, 0, 0)], duration=14.0, grade=FIVE_DEGREES, contact=contact, parked=parked
    )
    x, y = run["ego.x"].to_numpy(), run["ego.y"].to_numpy()
    assert -0.01 < x[200] - x[0] < 0.0  # tyre deflection, and motion until the brakes act
    assert np.abs(x[200:] - x[200]).max() < 1e-4
    assert np.abs(y[200:] - y[200]).max() < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("name", HANDLING)
@pytest.mark.parametrize("speed", [0.1, -0.1])
@pytest.mark.parametrize("grade", [0.0, FIVE_DEGREES], ids=["flat", "slope"])
def test_there_is_no_oscillation_at_a_tenth_of_a_metre_per_second(tmp_path, name, speed, grade):
    assembly, run = drive(tmp_path, name, [(0, speed, 0), (1, speed, 0)], duration=35.0, grade=grade)
    last = run.loc[25.0:]
    speeds, forces = last["ego.vx"].to_numpy(), last[FX].sum(axis=1).to_numpy()
    assert speeds == pytest.approx(speed, rel=0.01)
    assert np.ptp(speeds) < 0.005 * abs(speed)
    plant, part = assembly.parts.plant, assembly.parts.vehicles["ego"]
    weight = plant.CalcTotalMass(plant.CreateDefaultContext(), [part.instance]) * GRAVITY
    # What holds the weight on the slope, without a swing; rolling resistance is a moment.
    assert forces == pytest.approx(weight * np.sin(np.arctan(grade)), abs=2e-4 * weight)
    assert np.abs(np.diff(forces, n=2)).max() < 1e-5 * weight


@pytest.mark.slow
@pytest.mark.parametrize("name", HANDLING)
@pytest.mark.parametrize("grade", [0.0, FIVE_DEGREES, -FIVE_DEGREES], ids=["flat", "up", "down"])
def test_stop_and_go_and_back_ends_at_rest(tmp_path, name, grade):
    """A car without springs oscillates on its tyres, damped by the rubber."""
    rows = [(0, 0, 0), (1, 0, 0), (1.01, 1.0, 0), (6, 1.0, 0.1), (8, 0, 0.1), (10, 0, 0), (10.01, -0.5, 0)]
    rows += [(14, -0.5, 0), (16, 0, 0)]
    _, run = drive(tmp_path, name, rows, duration=34.0, grade=grade)
    assert run["ego.vx"].max() > 0.8
    assert run["ego.vx"].min() < -0.3
    soon, later = (np.ptp(run.loc[time : time + 3.0, "ego.x"]) for time in (21.0, 26.0))
    assert soon < 1e-4
    assert later < max(0.2 * soon, 1e-6)
    last = run.loc[31.0:]
    assert np.ptp(last["ego.x"]) < 1e-5
    assert np.abs(last["ego.vx"]).max() < 1e-4
    assert np.ptp(last[FX].to_numpy(), axis=0).max() < 2.0


@pytest.mark.parametrize("contact", ["point", "tyre"])
@pytest.mark.parametrize("step", [0.01, 0.0025])
def test_brakes_hold_the_wheels_of_a_robot_that_rocks_as_parking_brakes_do(contact, step):
    """The robot rocks at 10 Hz on its tyres; torques that are late by a step would feed it at 10 ms."""
    ranges: list[list[float]] = []
    for parked in (True, False):
        line = {"kind": "straight", "length": 50.0}
        driver = {"kind": "mirdrake.manoeuvres.drivers:PathDriver", "line": line, "hands": False}
        driver |= {"speeds": [[0.0, 0.0]]} if parked else {"pedals": [[0.0, 0.0, 1.0, 0.0]]}
        spec = {
            "world": "empty",
            "vehicles": {"ego": {"model": "unior@handling", "speed": 0.05, "parked": parked}},
            "control": {"ego": driver},
            "plant": {"contact": contact, "time_step": step},
            "record": {"rate": 100.0},
        }
        speed = Simulation(assemble(spec)).run(duration=3.0).signals["ego.vx"]
        ranges.append([float(np.ptp(speed.loc[begin : begin + 0.5])) for begin in (0.5, 1.5, 2.5)])
    assert ranges[1] == pytest.approx(ranges[0], rel=0.1)
    assert ranges[1][2] < 0.25 * ranges[1][0]
