"""Vehicles with `plant.contact: tyre`: the same as point contact on a plane, grades, bumps, jumps, speed bumps."""

from math import atan, sin
from pathlib import Path

import numpy as np
import pytest
from pydrake.math import RigidTransform

from mirdrake.core.errors import ConfigError
from mirdrake.runs.simulation import Simulation
from tests.ground_rigs import TYRE_FX, TYRE_FY, WHEEL_LOADS, drive, on_ground


@pytest.mark.parametrize("model", ["bolt", "bolt@handling"])
def test_a_turn_on_a_plane_is_that_of_point_contact(tmp_path: Path, model: str) -> None:
    """At 8 m/s and 0.1 rad, 2.4 m/s²: yaw rate and speed within 0.5 %, wheel loads within 1 %."""
    last = []
    for contact in ("point", "tyre"):
        signals = drive(tmp_path, model=model, contact=contact, speed=8.0, steering=0.1, duration=4.0)
        last.append(signals[signals.index > 3.0].mean())
    point, tyre = last
    for name in ("ego.vx", "ego.wz"):
        assert tyre[name] == pytest.approx(point[name], rel=5e-3)
    for name in WHEEL_LOADS:
        assert tyre[name] == pytest.approx(point[name], rel=1e-2)


@pytest.mark.slow
@pytest.mark.parametrize(("model", "speed"), [("bolt", 6.0), ("unior", 1.5)])
def test_figures_on_a_plane_do_not_depend_on_step_and_contact(tmp_path: Path, model: str, speed: float) -> None:
    """Curvature of a circle at 0.1 rad, and speed over spin: 0.1 % from 10 to 2.5 ms, 1 % from point contact."""
    figures = []
    for contact, step in (("tyre", 0.01), ("tyre", 0.0025), ("point", 0.005)):
        signals = drive(tmp_path, model=model, contact=contact, speed=speed, step=step, steering=0.1, duration=2.5)
        last = signals[signals.index > 2.0].mean()
        spin = last["ego.wheel_speed.rear_left"] + last["ego.wheel_speed.rear_right"]
        figures.append((last["ego.wz"] / last["ego.vx"], 2.0 * last["ego.vx"] / spin))
    coarse, fine, point = figures
    assert coarse == pytest.approx(fine, rel=1e-3)
    assert coarse == pytest.approx(point, rel=1e-2)


def test_wheels_of_a_robot_with_torque_control_roll_at_every_step(tmp_path: Path) -> None:
    """The wheels of the Unior have 0.008 kg m² and loops of 100 Hz: speed over spin is the same from 10 to 2.5 ms.

    A tyre that does not know the torque of the actuator in the same step lets the spin oscillate by 20 rad/s.
    """
    radii = []
    for step in (0.01, 0.005, 0.0025):
        signals = drive(tmp_path, model="unior", speed=1.5, step=step, duration=1.0)
        last = signals[signals.index > 0.8]
        assert np.ptp(last["ego.wheel_speed.rear_left"]) < 0.05
        radii.append(last["ego.vx"].mean() / last["ego.wheel_speed.rear_left"].mean())
    assert radii == pytest.approx([radii[-1]] * 3, rel=1e-4)


def test_the_wheel_loads_on_a_grade_of_15_percent_are_along_its_normal(tmp_path: Path) -> None:
    """Their sum is m g cos θ."""
    end = drive(tmp_path, relief=[{"plane": {"grade": 0.15}}], parked=True, duration=6.0).iloc[-1]
    level = drive(tmp_path, parked=True, duration=1.0).iloc[-1]
    assert end[WHEEL_LOADS].sum() == pytest.approx(level[WHEEL_LOADS].sum() * np.cos(atan(0.15)), rel=1e-3)


def test_a_climb_of_5_percent_needs_the_force_of_gravity(tmp_path: Path) -> None:
    """Steady speed: the longitudinal forces exceed those on level ground by m g sin θ within 0.5 %."""
    forces, weight = [], 0.0
    for grade in (0.0, 0.05):
        signals = drive(tmp_path, relief=[{"plane": {"grade": grade}}], model="bolt", speed=10.0, duration=3.0)
        last = signals[signals.index > 2.0]
        weight = weight or last[WHEEL_LOADS].sum(axis=1).mean()
        acceleration = np.polyfit(last.index, np.hypot(last["ego.vx"], last["ego.vz"]), 1)[0]
        forces.append(last[TYRE_FX].sum(axis=1).mean() - weight / 9.81 * acceleration)
    assert forces[1] - forces[0] == pytest.approx(weight * sin(atan(0.05)), rel=5e-3)


def test_a_jump_is_a_parabola_and_ends_with_a_landing(tmp_path: Path) -> None:
    """From a ramp at 10 m/s: without load on any wheel the centre of mass accelerates downwards with g within 1 %.

    The vehicle bounces on bumpers and tyres, so at a given time any number of wheels may be in the air: each wheel
    bears more than its static load again, and the vehicle stays upright.
    """
    ramp = [{"ramp": {"at": [6.0, 0.0], "length": 6.0, "height": 0.8, "width": 6.0}}]
    assembly = on_ground(tmp_path, relief=ramp, model="bolt", speed=10.0, step=0.0025)
    signals = Simulation(assembly).run(duration=3.0).signals
    assert np.isfinite(signals.to_numpy()).all()
    flying = (signals[WHEEL_LOADS].sum(axis=1) < 1.0).to_numpy()
    ends = np.flatnonzero(np.diff(np.concatenate([[0], flying, [0]]).astype(int))).reshape(-1, 2)
    first, last = ends[np.argmax(ends[:, 1] - ends[:, 0])]  # the longest flight
    # The front bumper touches the ground before the wheels do.
    air = signals.iloc[first + 2 : (first + last) // 2]
    assert len(air) > 40
    plant, part = assembly.parts.plant, assembly.parts.vehicles["ego"]
    level = plant.CreateDefaultContext()
    plant.SetFloatingBaseBodyPoseInWorldFrame(level, part.base, RigidTransform())
    ahead, _, up = plant.CalcCenterOfMassPositionInWorld(level, [part.instance])
    z = air["ego.z"] - ahead * np.sin(air["ego.pitch"]) + up * np.cos(air["ego.pitch"])
    assert 2.0 * np.polyfit(air.index - air.index[0], z, 2)[0] == pytest.approx(-9.80665, rel=0.01)
    landed = signals.iloc[last:]
    assert landed[WHEEL_LOADS].max().min() > 4500.0
    assert landed["ego.roll"].abs().max() < 0.5


@pytest.mark.parametrize("contact", ["hydroelastic", "point", "tyre"])
def test_tyres_with_slip_have_grip_on_a_speed_bump(tmp_path: Path, contact: str) -> None:
    """A shipped speed bump lifts the wheels and carries them, whatever bears them on the plane; it is 75 mm high."""
    world = {"props": [{"prop": "speed_bump", "at": [4.0, 0.0]}]}
    signals = drive(tmp_path, world=world, contact=contact, speed=2.0, duration=3.5)
    assert signals["ego.z"].max() == pytest.approx(0.06, abs=0.02)
    assert signals["other_contacts"].max() == 0.0
    assert signals[WHEEL_LOADS[0]].max() > 5000.0


@pytest.mark.essential
def test_a_turn_on_a_plate_is_that_on_the_plane(tmp_path: Path) -> None:
    """On a box of 40 x 40 m that vehicles drive over, with the default contact: lateral force and yaw rate within 1 %.

    The vehicle drops by the height of the plate at the start.
    """
    plate = {"props": [{"box": [40.0, 40.0, 0.03], "at": [0.0, 0.0], "driven_over": True}]}
    last = []
    for world, contact in ((plate, "hydroelastic"), ({}, "tyre")):
        signals = drive(tmp_path, world=world, contact=contact, speed=5.0, steering=0.1, duration=3.0)
        last.append(signals[signals.index > 2.0].mean())
    assert last[0]["ego.wz"] == pytest.approx(last[1]["ego.wz"], rel=1e-2)
    assert last[0][TYRE_FY].sum() == pytest.approx(last[1][TYRE_FY].sum(), rel=1e-2)
    assert last[0]["ego.z"] - last[1]["ego.z"] == pytest.approx(0.03, abs=1e-3)


def test_a_relief_has_a_vertical_tyre_whatever_the_contact(tmp_path: Path) -> None:
    slope = [{"plane": {"grade": 0.1}}]
    ends = [drive(tmp_path, relief=slope, contact=name, speed=5.0, duration=0.2).iloc[-1] for name in ("point", "tyre")]
    assert ends[0].equals(ends[1])


def test_a_prop_that_vehicles_drive_over_must_be_static(tmp_path: Path) -> None:
    world = {"props": [{"prop": "speed_bump", "at": [4.0, 0.0], "static": False}]}
    with pytest.raises(ConfigError, match=r"world.yaml:\d+: props.0.static: false; .*make it static"):
        drive(tmp_path, world=world, duration=0.1)
