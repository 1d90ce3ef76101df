"""Coulomb tyres: a stiff brush with a pivoting moment, the same on every contact."""

from math import atan, sin
from pathlib import Path

import numpy as np
import pytest

from mirdrake.assembly.diagram import assemble
from mirdrake.plant.wheels.motion import NO_JOINT, WheelPlace
from mirdrake.plant.wheels.step import SpinningWheel, pivoting, rolling_moment
from mirdrake.runs.simulation import Simulation
from mirdrake.tyres.coulomb import DAMPING, LENGTH, PIVOT_LENGTH, PIVOT_STIFFNESS, STIFFNESS, make_coulomb_law
from mirdrake.tyres.relaxation import Contact, RelaxationSettings
from tests.rigs import drive

LOAD, WIDTH, MU = 4000.0, 0.2, 0.85


def contact(mu: float = MU) -> Contact:
    return make_coulomb_law(mu, MU)(LOAD, 0.0, 1.0).contact


def wheel(*, coulomb: bool = True) -> SpinningWheel:
    place = WheelPlace((0.0, 0.0, 0.3), 0.0, 0, NO_JOINT, NO_JOINT, (0, 0))
    settings = RelaxationSettings(lasting_damping=DAMPING * LOAD)
    numbers = (1.0, 0.0, False, 0.3, 2e5, 0.1, 0.0, 0.1, place, LOAD, settings, WIDTH, 0.01, coulomb, 0, 100.0)
    return SpinningWheel(place, *numbers, (0.0, 0.0, 0.0, 0.0), 1.0)


def test_the_brush_sticks_at_small_slips_and_slides_with_the_friction_force() -> None:
    law = make_coulomb_law(MU, MU)(LOAD, 0.0, 1.0)
    assert contact().stiffness_x == contact().stiffness_y == STIFFNESS * LOAD == 600e3
    # Slope at zero slip: 600 kN. At 0.1 % it is 600 N less the share that slides, |F| / (3 μ N) = 5.9 %.
    fx, fy, mz = law.forces(1e-6, 0.0, 5.0)
    assert fx == pytest.approx(0.6, rel=1e-3)
    assert law.forces(0.0, 1e-3, 5.0)[1] == pytest.approx(-600.0 * (1 - 0.0588 + 0.0588**2 / 3), rel=1e-3)
    assert (fy, mz) == pytest.approx((0.0, 0.0))
    # The whole patch slides from the slip 3 μ / 150 = 1.7 % on: 3400 N, opposite to the slip.
    for kappa, tan_alpha in ((-0.5, 0.0), (0.0, 0.4), (-0.3, 0.4)):
        fx, fy, _ = law.forces(kappa, tan_alpha, 5.0)
        assert np.hypot(fx, fy) == pytest.approx(MU * LOAD, rel=1e-6)
        assert fx * tan_alpha == pytest.approx(-fy * kappa, abs=1e-6)


@pytest.mark.parametrize(("tyre", "relative", "expected"), [(0.9, 1.0, 0.85), (0.5, 1.0, 0.5), (0.9, 0.1 / 0.85, 0.1)])
def test_the_smaller_friction_of_tyre_and_ground_holds(tyre: float, relative: float, expected: float) -> None:
    assert make_coulomb_law(tyre, MU)(LOAD, 0.0, relative).contact.friction_y == pytest.approx(expected * LOAD)


def settle(turn: float, speed: float, *, duration: float, step: float = 0.005) -> float:
    """Return the pivoting moment [N m] after a time at constant turn rate [rad/s] and speed [m/s]."""
    twist, moment = 0.0, 0.0
    for _ in range(round(duration / step)):
        twist, moment = pivoting(wheel(), LOAD, twist, turn, speed, contact(), step)
    return moment


def test_the_pivoting_moment_of_a_rolling_wheel_is_that_of_slip_across_its_width() -> None:
    # C w² / 12 = 30 x 4000 x 0.04 / 12 = 400 N m²: at 5 m/s and 0.2 rad/s, a circle of 25 m, 16 N m against the turn.
    assert PIVOT_STIFFNESS == 30.0
    assert settle(0.2, 5.0, duration=2.0) == pytest.approx(-16.0, rel=1e-3)
    assert settle(-0.2, 5.0, duration=2.0) == pytest.approx(16.0, rel=1e-3)
    assert settle(-0.2, -5.0, duration=2.0) == pytest.approx(16.0, rel=1e-3)


def test_at_standstill_it_is_a_spring_with_sliding_friction() -> None:
    # 400 / 0.25 = 1600 N m/rad for small angles; μ N w / 4 = 170 N m, whatever the angle.
    assert settle(0.01, 0.0, duration=1.0) == pytest.approx(-1600.0 / (0.25 / PIVOT_LENGTH) * 0.01, rel=0.01)
    assert settle(0.5, 0.0, duration=10.0) == pytest.approx(-170.0, rel=0.05)
    assert abs(settle(50.0, 1.0, duration=1.0)) <= 170.0


def test_tyres_with_slip_do_not_pivot_and_a_wheel_in_the_air_neither() -> None:
    assert pivoting(wheel(coulomb=False), LOAD, 0.1, 1.0, 5.0, contact(), 0.005) == (0.0, 0.0)
    empty = make_coulomb_law(MU, MU)(0.0, 0.0, 1.0).contact
    assert pivoting(wheel(), 0.0, 0.1, 1.0, 5.0, empty, 0.005) == (0.0, 0.0)


def test_rolling_resistance_is_the_coefficient_times_load_and_radius() -> None:
    assert rolling_moment(wheel(), LOAD, 0.3, 10.0) == pytest.approx(-0.01 * 4000.0 * 0.3)
    assert rolling_moment(wheel(), LOAD, 0.3, -10.0) == pytest.approx(12.0)
    assert rolling_moment(wheel(), LOAD, 0.3, 0.0) == 0.0


def test_contact_and_step_do_not_change_a_turn() -> None:
    """A Bolt at 4 m/s²: curvature and speed within 0.1 %, lateral forces of the axles within 0.5 %."""
    rows = [{"time": 0.0, "speed": 8.0, "steering": 0.0}, {"time": 0.5, "speed": 8.0, "steering": 0.16}]
    ends = {}
    for bearing, step in [("hydroelastic", 0.005), ("point", 0.0025), ("point", 0.01), ("tyre", 0.005)]:
        run = drive(3.0, speed=8.0, control={"kind": "schedule", "rows": rows}, contact=bearing, time_step=step)
        ends[bearing, step] = run.signals.loc[2.0:].mean()
    first = ends["point", 0.0025]
    for end in ends.values():
        curvature, reference = (e["ego.wz"] / e["ego.vx"] for e in (end, first))
        assert curvature == pytest.approx(reference, rel=1e-3)
        assert end["ego.vx"] == pytest.approx(first["ego.vx"], rel=1e-3)
        for axle in ("front", "rear"):
            forces = [sum(e[f"ego.tyre_fy.{axle}_{side}"] for side in ("left", "right")) for e in (end, first)]
            assert forces[0] == pytest.approx(forces[1], rel=5e-3)


def test_a_parked_car_on_a_slope_of_15_percent_does_not_creep(tmp_path: Path) -> None:
    """After 2 s, in which the brush takes up σ/C m g sin θ = 0.5 mm: below 0.05 mm in 10 s."""
    world = tmp_path / "slope.yaml"
    world.write_text("mirdrake: world/1\nground: {surface: asphalt, slope: {grade: 0.15, heading: 30 deg}}\n")
    spec = {
        "world": str(world),
        "vehicles": {"ego": {"model": "bolt", "parked": True, "start": {"x": 0, "y": 0, "yaw": 0}}},
        "control": {"ego": {"kind": "constant", "speed": 0}},
        "plant": {"contact": "point", "time_step": 0.01},
    }
    course = Simulation(assemble(spec)).run(duration=12.0).signals
    rest = course.loc[2.0:]
    creep = np.hypot(rest["ego.x"] - rest["ego.x"].iloc[0], rest["ego.y"] - rest["ego.y"].iloc[0])
    assert creep.max() < 5e-5
    slid = np.hypot(course["ego.x"].iloc[-1], course["ego.y"].iloc[-1])
    assert slid == pytest.approx(LENGTH / STIFFNESS * sin(atan(0.15)), rel=0.2)
