"""Every bundled vehicle at rest, straight ahead, on circles to both sides, in a figure eight, under random commands."""

from itertools import product

import numpy as np
import pytest
import yaml

from mirdrake.assembly.diagram import assemble
from mirdrake.core.paths import data_root
from mirdrake.runs.simulation import Simulation
from mirdrake.vehicles import load_vehicle, variants
from tests.marks import mostly_slow

ROOT = data_root()
WORLDS = sorted(path.stem for path in (ROOT / "worlds").glob("*.yaml"))
MODELS = sorted(path.parent.name for path in (ROOT / "models").glob("*/vehicle.yaml"))
CONTACTS = ("point", "hydroelastic")
FILES = {name: yaml.safe_load((ROOT / "worlds" / f"{name}.yaml").read_text(encoding="utf-8")) for name in WORLDS}
RELIEF = {name for name, file in FILES.items() if "relief" in (file.get("ground") or {})}
"""Worlds with a ground that only `plant.contact: tyre` touches."""
ONE_MODEL_PER_WORLD = [
    (MODELS[index % len(MODELS)], world, CONTACTS[index // len(MODELS) % len(CONTACTS)])
    for index, world in enumerate(WORLDS)
    if world not in RELIEF and not FILES[world].get("actors")  # their ground or traffic takes long to be made
]
ALL_OTHERS = [
    case
    for case in product(MODELS, WORLDS, [*CONTACTS, "tyre"])
    if case not in ONE_MODEL_PER_WORLD and (case[2] == "tyre") == (case[1] in RELIEF)
]
EACH_CONTACT = [
    *((model, "point") for model in MODELS),
    *mostly_slow([(model, "hydroelastic") for model in ("bolt", "unior", "catvehicle", "mkz")], fast=2),
]
"""Every vehicle in point contact, and the car with most validation and the smallest vehicle in hydroelastic contact."""

_FAST_VARIANTS = ["bolt@energy", "catvehicle@explorer", "mkz@handling", "unior@published"]
_VARIANTS = [f"{model}@{name}" for model in MODELS for name in variants(ROOT / "models" / model)]
VARIANTS = mostly_slow(
    [*_FAST_VARIANTS, *(name for name in _VARIANTS if name not in _FAST_VARIANTS)], fast=len(_FAST_VARIANTS)
)


def run(model, control, *, duration, world="empty", contact="point", start=None, speed=None):
    entry = {"model": model, "start": start, "speed": speed}
    spec = {
        "world": world,
        "vehicles": {"ego": entry},
        "control": {"ego": control},
        "plant": {"contact": contact},
    }
    return Simulation(assemble(spec)).run(duration=duration)


def pace(model):
    """Return a speed that is brisk for the size of a vehicle: Froude number 0.4 on its wheelbase [m/s]."""
    return round(float(np.sqrt(0.4 * 9.80665 * load_vehicle(model).geometry.wheelbase)), 1)


@pytest.mark.parametrize("model", MODELS)
def test_it_loads_without_a_warning(model):
    assert load_vehicle(model).warnings == ()


@pytest.mark.parametrize("contact", CONTACTS)
@pytest.mark.parametrize("model", MODELS)
def test_it_rests(model, contact):
    still = run(model, {"kind": "constant", "speed": 0}, duration=4.0, contact=contact)
    last = still.signals[still.signals.index >= 3.0]
    for name in ("vx", "vy", "vz"):
        assert last[f"ego.{name}"].abs().max() < 1e-3  # 1 mm/s


@pytest.mark.parametrize(("model", "contact"), EACH_CONTACT)
def test_it_keeps_speed_and_heading_on_the_straight(model, contact):
    speed = pace(model)
    straight = run(model, {"kind": "constant", "speed": speed}, duration=10.0, contact=contact)
    last = straight.signals[straight.signals.index >= 6.0]
    assert last["ego.vx"].mean() == pytest.approx(speed, rel=0.005)
    assert straight["ego.y"].abs().max() < 0.01
    assert straight["other_contacts"].max() == 0


@pytest.mark.parametrize(("model", "contact"), EACH_CONTACT)
def test_turning_radius_is_that_of_the_geometry_to_both_sides(model, contact):
    # 1 %: the pivoting moment of a patch, 0.9 N m at 0.2 rad, turns the servo of the Unior, 540 N m/rad, by 0.8 %.
    tolerance = 0.01
    geometry, speed = load_vehicle(model).geometry, 0.7 * pace(model)
    rates = []
    for steering in (0.2, -0.2):
        circle = run(
            model, {"kind": "constant", "speed": speed, "steering": steering}, duration=8.0, contact=contact
        ).signals
        last = circle[circle.index >= 5.0]
        rates.append(last["ego.wz"].mean())
        expected = last["ego.vx"].mean() * np.tan(steering) / geometry.wheelbase
        assert rates[-1] == pytest.approx(expected, rel=tolerance)
        assert last["ego.vx"].mean() == pytest.approx(speed, rel=0.005)
    assert rates[0] == pytest.approx(-rates[1], rel=0.005)


@pytest.mark.essential
@pytest.mark.parametrize("contact", ["point", pytest.param("hydroelastic", marks=pytest.mark.slow)])
@pytest.mark.parametrize("model", MODELS)
def test_it_drives_a_figure_eight_under_path_tracking(model, contact):
    length = 2.0 * 2.0 * np.pi * 9.125
    eight = run(
        model,
        {"kind": "path_tracking", "track": "eight", "speed": 5},
        world="skidpad",
        start="eight",
        contact=contact,
        duration=length / 5.0 + 6.0,
    )
    assert eight["ego.lap"].max() > 1.0
    assert eight["ego.lateral_error"].abs().max() < 0.3
    assert eight["ego.vx"].loc[6.0:].mean() == pytest.approx(5.0, rel=0.005)


@pytest.mark.parametrize(
    ("model", "world", "contact"),
    mostly_slow([*ONE_MODEL_PER_WORLD, *ALL_OTHERS], fast=2 * len(MODELS)),
)
def test_random_commands_leave_it_finite_and_no_deeper_in_the_road(model, world, contact):
    rng = np.random.default_rng(2026)
    times = np.arange(0.0, 1.0, 0.1)
    rows = [{"time": t, "speed": rng.uniform(-2, 8), "steering": rng.uniform(-0.5, 0.5)} for t in times.tolist()]
    drive = run(model, {"kind": "schedule", "rows": rows}, world=world, contact=contact, duration=1.0, speed=0.0)
    assert np.isfinite(drive.signals.to_numpy()).all()
    assert -0.01 < drive["ego.z"].iloc[-1] - drive["ego.z"].iloc[0] < 0.03  # braking lifts the rear axle a little
    assert drive["other_contacts"].max() == 0


@pytest.mark.parametrize("model", VARIANTS)
def test_a_variant_loads_and_moves(model):
    moved = run(model, {"kind": "constant", "speed": 2.0}, duration=3.0)
    assert np.isfinite(moved.signals.to_numpy()).all()
    # With its published gains the Unior does not move, see test_reference_vehicles.py.
    assert moved["ego.x"].iloc[-1] > 1.0 or model == "unior@published"
