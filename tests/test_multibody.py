"""Our models against the multi-body cars of commonroad-vehicle-models: tyre forces, mass properties, manoeuvres."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import vehiclemodels.utils.tire_model as theirs
from pydrake.math import RigidTransform

from mirdrake.single_track import estimate_parameters
from mirdrake.tyres.magic_formula import magic_formula, relaxation_lengths, slip_curve
from mirdrake.tyres.magic_formula_tyres import MagicFormulaTyres
from mirdrake.tyres.tir import parse_tir, read_tir
from mirdrake.vehicles import load_vehicle
from mirdrake.vehicles.parse import parse_urdf
from tests.commonroad_car import (
    STIFF,
    camber_by_roll,
    centre_of_sprung_mass,
    load_ratios,
    plant_trace,
    single_track_trace,
    tyre,
    write_car,
)
from tests.commonroad_rig import (
    CARS,
    GRAVITY,
    Reference,
    Trace,
    car,
    fit,
    fits,
    manoeuvre,
    reference_trace,
)
from tests.marks import mostly_slow
from tests.tir_files import write_tir

SLIPS = np.random.default_rng(6).uniform([-0.5, -0.4, 500.0, -0.1], [0.5, 0.4, 9000.0, 0.1], size=(200, 4))
"""Longitudinal slip, slip angle [rad], load [N], camber [rad]."""

KINDS: tuple[Reference, ...] = ("wheel_slip", "slip_only", "published")


# --- the tyre ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def escort() -> Any:
    p = car("Ford Escort")
    p.tire.p_hx1 = p.tire.p_vx1 = p.tire.p_hy1 = p.tire.p_vy1 = 0.0  # see the rig
    return p


def test_tyre_forces_equal_those_of_the_package(escort):
    p, t = parse_tir(write_tir(tyre(escort))).parameters, escort.tire
    for kappa, alpha, load, gamma in SLIPS.tolist():
        sine_of_camber = math.sin(gamma)  # Magic Formula 6.1 has the sine of the camber angle
        pure_x = theirs.formula_longitudinal(-kappa, gamma, load, t)
        pure_y, mu = theirs.formula_lateral(alpha, sine_of_camber, load, t)
        fx = theirs.formula_longitudinal_comb(kappa, alpha, pure_x, t)
        fy = theirs.formula_lateral_comb(kappa, alpha, sine_of_camber, mu, load, pure_y, t)
        ours = magic_formula(p, kappa, alpha, load, vx=20.0, gamma=gamma)
        assert (ours.fx, ours.fy) == pytest.approx((fx, fy), rel=1e-6, abs=1e-6 * load)


def test_relaxation_length_is_cornering_stiffness_by_lateral_stiffness(escort):
    p = tyre(escort, lateral=1e5)
    for load in (1000.0, 3000.0, 6000.0):
        assert slip_curve(p, load).kya == pytest.approx(escort.tire.p_ky1 * load)
        assert relaxation_lengths(p, load)[1] == pytest.approx(-escort.tire.p_ky1 * load / 1e5)


# --- the car -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CARS)
def test_car_has_the_parameters_of_the_package(name, tmp_path):
    p, vehicle = car(name), load_vehicle(str(write_car(tmp_path / "car", car(name))))
    measured = estimate_parameters(vehicle)
    assert measured.mass == pytest.approx(p.m, rel=1e-6)
    assert measured.yaw_inertia == pytest.approx(p.I_z, rel=1e-6)
    assert (measured.front_length, measured.rear_length) == pytest.approx(
        (p.a, p.b), rel=1e-6
    )  # its masses are not an exact sum
    assert measured.rotating_mass == pytest.approx(4.0 * p.I_y_w / p.R_w**2)
    geometry = vehicle.geometry
    assert (geometry.front_track, geometry.rear_track) == pytest.approx((p.T_f, p.T_r))
    plant, _, _ = parse_urdf(vehicle.urdf, packages=vehicle.packages, where_line=str)
    context = plant.CreateDefaultContext()
    body = plant.GetBodyByName("base_link")
    plant.SetFloatingBaseBodyPoseInWorldFrame(context, body, RigidTransform())
    sprung = body.CalcSpatialInertiaInBodyFrame(context)
    roll, pitch, _ = np.diag(sprung.Shift(sprung.get_com()).CalcRotationalInertia().CopyToFullMatrix3())
    assert (sprung.get_mass(), roll, pitch) == pytest.approx((p.m_s, p.I_Phi_s, p.I_y_s))


def test_ride_height_is_that_of_the_package(tmp_path):
    p = car("Ford Escort")
    vehicle = load_vehicle(str(write_car(tmp_path / "car", p)))
    sag = p.m * GRAVITY / (4.0 * p.K_zt)
    assert centre_of_sprung_mass(p)[1] - p.h_s == pytest.approx(sag, rel=0.1)
    assert sum(vehicle.spring_loads) == pytest.approx(p.m_s * 9.80665)


def test_quantities_derived_from_the_parameters():
    p = car("Ford Escort")
    front, rear = load_ratios(p)
    assert front < 1.0 < rear
    assert front * p.m * p.b + rear * p.m * p.a == pytest.approx((p.m_s + p.m_uf + p.m_ur) * (p.a + p.b))
    assert all(0.5 < gain < 1.0 for gain in camber_by_roll(p))


def test_tyres_have_spring_and_damper_of_the_axles_where_slip_is_taken_there(tmp_path):
    p = car("VW Vanagon")
    results = {}
    for kind in KINDS:
        vehicle = load_vehicle(str(write_car(tmp_path / kind, p, kind=kind)))
        springs = {read_tir(vehicle.folder / f"{axle}.tir").parameters.lateral_stiffness for axle in ("front", "rear")}
        tyres = vehicle.spec.tyres
        assert isinstance(tyres, MagicFormulaTyres)
        results[kind] = (*springs, tyres.lateral_damping)
        assert tyres.rolling_ratio == 1.0  # R_w, whatever the load
    assert results["published"] == (STIFF, 0.0)
    assert results["slip_only"] == results["wheel_slip"] == pytest.approx((0.5 * p.K_ras, 0.5 * p.K_rad))


# --- the manoeuvres ----------------------------------------------------------------------------------------------


def test_fit_is_the_normalised_root_mean_square():
    t = np.linspace(0.0, 1.0, 1001)
    wave = np.sin(2.0 * np.pi * t)
    assert fit(wave, wave) == 100.0
    assert fit(wave, 0.9 * wave) == pytest.approx(90.0)
    assert fit(wave, 0.0 * wave) == pytest.approx(0.0, abs=1e-9)


def _both(folder: Path, name: str, kind: Reference, steering: str) -> tuple[Trace, Trace]:
    p = car(name)
    steer = manoeuvre(steering, p.a + p.b)
    vehicle = load_vehicle(str(write_car(folder / "car", p, kind=kind)))
    return reference_trace(name, steer, kind=kind), plant_trace(vehicle, steer, centre_of_sprung_mass(p))


def test_full_model_follows_the_step_of_the_bmw(tmp_path):
    yaw, side = fits(*_both(tmp_path, "BMW 320i", "wheel_slip", "step"))
    assert yaw > 97.0
    assert side > 97.0


FITS = {
    ("Ford Escort", "step"): ((98.5, 98.4), (97.7, 98.1), (98.0, 88.8)),
    ("Ford Escort", "sweep"): ((97.4, 96.4), (97.6, 92.4), (97.2, 49.1)),
    ("Ford Escort", "ramp"): ((99.3, 99.3), (98.0, 98.4), (97.8, 98.0)),
    ("BMW 320i", "step"): ((98.4, 98.2), (98.4, 97.6), (98.6, 91.5)),
    ("BMW 320i", "sweep"): ((97.4, 95.9), (97.7, 92.5), (97.6, 56.4)),
    ("BMW 320i", "ramp"): ((98.8, 98.9), (98.8, 98.4), (98.7, 98.1)),
    ("VW Vanagon", "step"): ((99.1, 98.7), (99.3, 98.2), (99.1, 90.1)),
    ("VW Vanagon", "sweep"): ((97.7, 97.1), (98.0, 92.8), (98.8, 51.0)),
    ("VW Vanagon", "ramp"): ((99.7, 99.7), (99.5, 99.2), (99.5, 98.8)),
}
"""Fits of the full model, yaw rate and lateral acceleration, to the package [%]: in the order of KINDS."""


@pytest.mark.slow
@pytest.mark.parametrize(("name", "steering"), FITS)
def test_full_model_follows_the_package(name, steering, tmp_path):
    p = car(name)
    steer, point = manoeuvre(steering, p.a + p.b), centre_of_sprung_mass(p)

    def ours(kind: Reference) -> Trace:
        return plant_trace(load_vehicle(str(write_car(tmp_path / kind, p, kind=kind))), steer, point)

    at_wheels, at_body = ours("wheel_slip"), ours("published")
    for kind, expected in zip(KINDS, FITS[name, steering], strict=True):
        fit_percent = fits(reference_trace(name, steer, kind=kind), at_body if kind == "published" else at_wheels)
        assert fit_percent == pytest.approx(expected, abs=0.3), kind
        assert min(fit_percent) > 90.0 or kind == "published"


@pytest.mark.slow
@pytest.mark.parametrize("steering", ["step", "low_sweep", "ramp"])
@pytest.mark.parametrize("name", CARS)
def test_full_model_follows_the_package_as_published_up_to_0_7_hz(name, steering, tmp_path):
    """Lateral acceleration at the point of the slip angles: on the road in ours, at the sprung mass in the package.

    At our sprung mass, with its lateral motion due to roll, the fit is up to 4 percentage points lower.
    """
    p = car(name)
    steer, (ahead, height) = manoeuvre(steering, p.a + p.b), centre_of_sprung_mass(p)
    vehicle, published = load_vehicle(str(write_car(tmp_path / "car", p))), reference_trace(name, steer)
    for z, least in ((0.0, 90.0), (height, 87.5)):
        yaw, side = fits(published, plant_trace(vehicle, steer, (ahead, z)))
        assert yaw > 97.0
        assert side > least


def _reduced(folder: Path, name: str, steering: str) -> tuple[float, float]:
    """Return fits of our single track, yaw rate and lateral acceleration, to the package as published [%]."""
    p = car(name)
    steer = manoeuvre(steering, p.a + p.b)
    vehicle = load_vehicle(str(write_car(folder / "car", p)))
    return fits(reference_trace(name, steer), single_track_trace(vehicle, steer))


@pytest.mark.parametrize(
    ("steering", "yaw", "side"),
    [("step", 95.0, 95.0), ("low_sweep", 95.0, 95.0), ("mid_sweep", 93.0, 90.0), ("ramp", 95.0, 95.0)],
)
@pytest.mark.parametrize("name", mostly_slow(CARS))
def test_reduced_model_follows_the_package_as_published_up_to_1_5_hz(name, steering, yaw, side, tmp_path):
    fit_percent = _reduced(tmp_path, name, steering)
    assert fit_percent[0] > yaw
    assert fit_percent[1] > side


@pytest.mark.slow
@pytest.mark.parametrize("name", CARS)
def test_forms_of_the_package_differ_more_than_our_model_from_each(name):
    p = car(name)
    steer = manoeuvre("sweep", p.a + p.b)
    published, corrected = (reference_trace(name, steer, kind=kind) for kind in ("published", "wheel_slip"))
    assert fits(published, corrected)[1] < min(side for _, side in FITS[name, "sweep"])
