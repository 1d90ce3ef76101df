"""Rolling resistance of a coasting car is that of its tyres at any step, speed and solver."""

from itertools import product

import numpy as np
import pytest

from mirdrake.plant.plant import PlantSpec
from tests.marks import mostly_slow
from tests.rigs import GRAVITY, coasting_car, drive

BOLT_CRR = 0.0079
SETTLE, COAST = 0.6, 2.0


def effective_coefficient(speed, spec, *, coefficient=None):
    """Return the deceleration times the car's inertia, wheels included, over its weight."""
    car = coasting_car(speed, spec, coefficient=coefficient)
    car.advance(SETTLE)
    before = car.speed
    car.advance(COAST)
    wheels = 4 * 0.5 * 20.0  # four cylinders of 20 kg: I / R² = m / 2
    inertia = (1616.0 + wheels) / 1616.0
    return (before - car.speed) / COAST * inertia / GRAVITY


CASES = list(product([2.0, 10.0, 20.0], [0.001, 0.002, 0.005], ["hydroelastic", "point"], ["lagged", "sap"]))
# Each speed at each step, and all four pairs of contact and solver among them.
FAST = [CASES[4 * pair + pair % 4] for pair in range(9)]


@pytest.mark.parametrize(
    ("speed", "step", "contact", "approximation"),
    mostly_slow([*FAST, *(case for case in CASES if case not in FAST)], fast=len(FAST)),
)
def test_coast_down_has_the_specified_coefficient(speed, step, contact, approximation):
    spec = PlantSpec(time_step=step, contact=contact, approximation=approximation)
    assert effective_coefficient(speed, spec) == pytest.approx(BOLT_CRR, abs=0.001)


@pytest.mark.parametrize("contact", ["hydroelastic", "point"])
def test_without_rolling_resistance_a_car_keeps_its_speed(contact):
    assert effective_coefficient(10.0, PlantSpec(contact=contact), coefficient=0.0) == pytest.approx(0.0, abs=3e-4)


def test_opposing_forces_of_the_front_wheels_do_not_move_the_car():
    # At 25 m/s on patches they push against each other with up to half of their loads; see docs/tyres.md.
    run = drive(2.0, speed=25.0, contact="hydroelastic").signals
    for name in ("y", "vy", "wz"):
        assert run[f"ego.{name}"].abs().max() < 1e-4


def mean_loads(speed, contact):
    """Return wheel loads [N] over a second, in which the car bounces some times on its undamped tyres."""
    car = coasting_car(speed, PlantSpec(contact=contact))
    car.advance(1.0)
    samples = []
    for _ in range(50):
        car.advance(0.02)
        samples.append(car.loads)
    return np.mean(samples, axis=0)


@pytest.mark.parametrize("contact", ["hydroelastic", "point"])
def test_wheel_loads_carry_the_weight_and_follow_the_centre_of_mass(contact):
    loads = mean_loads(5.0, contact)
    assert loads.sum() == pytest.approx(1616.0 * GRAVITY, rel=0.005)
    assert loads[:2].sum() / loads.sum() == pytest.approx(0.56, abs=0.005)


def test_hydroelastic_and_point_contact_load_the_axles_alike_at_speed():
    # without the outer moments the load would move back by v dt = 0.1 m, 4 % of the wheelbase
    hydroelastic, point = mean_loads(20.0, "hydroelastic"), mean_loads(20.0, "point")
    assert hydroelastic[:2].sum() / hydroelastic.sum() == pytest.approx(point[:2].sum() / point.sum(), abs=0.005)


@pytest.mark.parametrize("contact", ["hydroelastic", "point"])
def test_a_car_at_rest_stays_at_rest_without_brakes(contact):
    car = coasting_car(0.0, PlantSpec(contact=contact))
    car.advance(5.0)
    assert abs(car.speed) < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("contact", ["hydroelastic", "point"])
def test_an_hour_of_coasting_without_losses_neither_gains_nor_loses_speed(contact):
    car = coasting_car(10.0, PlantSpec(contact=contact, time_step=0.01), coefficient=0.0)
    car.advance(SETTLE)
    before = car.speed
    car.advance(3600.0)
    # one part in a thousand of the weight would have stopped the car after 17 minutes
    assert car.speed == pytest.approx(before, rel=0.05)
