"""Springs, dampers and tyre stiffness from a ride over a known road: an independent half car, and the full plant."""

import math
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from scipy.signal import StateSpace, lsim

from mirdrake.assembly.diagram import assemble
from mirdrake.core.errors import ConfigError
from mirdrake.core.paths import data_root
from mirdrake.ground import Terrain
from mirdrake.ground.roughness import ROUGHNESS, Roughness
from mirdrake.identification import DataSet, Log
from mirdrake.identification.derived import add_derived
from mirdrake.identification.estimators import fit
from mirdrake.identification.models import ModelSpec, make_model
from mirdrake.identification.parameters import Setting
from mirdrake.runs.simulation import Simulation
from mirdrake.vehicles import load_vehicle

SPEED, STEP, DURATION = 20.0, 0.005, 20.0
MASS, FRONT, REAR = 1616.0, 1.144, 1.457
TRUTH = {
    "pitch_inertia": 2150.0,
    "front_stiffness": 56e3,
    "rear_stiffness": 54e3,
    "front_damping": 4000.0,
    "rear_damping": 3600.0,
    "front_tyre_stiffness": 4e5,
    "rear_tyre_stiffness": 4.2e5,
    "front_unsprung": 80.0,
    "rear_unsprung": 60.0,
    "tyre_damping": 800.0,
}
NOISE = {"suspension_travel": 5e-4, "vertical_acceleration": 0.1, "pitch_rate": 0.003}
KNOWN = {
    "mass": Setting(fixed=MASS),
    "front_length": Setting(fixed=FRONT),
    "rear_length": Setting(fixed=REAR),
    "contact_length": Setting(fixed=0.0),
}


@cache
def ride() -> dict[str, np.ndarray]:
    """Return the channels of a ride without noise, by Lagrange's equations of a half car and exact steps.

    The steps are a tenth of those of the log: straight lines between the samples of a log would have 1.2 % less of the
    road at the frequency of the hop.
    """
    step = 0.1 * STEP
    time = np.arange(0.0, DURATION, step)
    terrain = Terrain(list(Roughness(ROUGHNESS["C"], 1).grids()))
    roads = [terrain.height(SPEED * time + x, 0.0 * time) for x in (FRONT + REAR, 0.0)]
    p = TRUTH
    # Generalised coordinates z, pitch (nose down), hubs; the travels and tyre deflections are linear in them.
    travel = np.array([[-1.0, FRONT, 1.0, 0.0], [-1.0, -REAR, 0.0, 1.0]])
    hubs = np.array([[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    sprung = MASS - p["front_unsprung"] - p["rear_unsprung"]
    M = np.diag([sprung, p["pitch_inertia"], p["front_unsprung"], p["rear_unsprung"]])
    springs = np.diag([p["front_stiffness"], p["rear_stiffness"]])
    dampers = np.diag([p["front_damping"], p["rear_damping"]])
    tyres = np.diag([p["front_tyre_stiffness"], p["rear_tyre_stiffness"]])
    K = travel.T @ springs @ travel + hubs.T @ tyres @ hubs
    D = travel.T @ dampers @ travel + p["tyre_damping"] * hubs.T @ hubs
    inverse = np.linalg.inv(M)
    A = np.block([[np.zeros((4, 4)), np.eye(4)], [-inverse @ K, -inverse @ D]])
    push = np.hstack([inverse @ hubs.T @ tyres, p["tyre_damping"] * inverse @ hubs.T])
    B = np.vstack([np.zeros((4, 4)), push])
    inputs = np.column_stack([*roads, *(np.gradient(road, step) for road in roads)])
    _, _, x = lsim(StateSpace(A, B, np.eye(8), np.zeros((8, 4))), inputs, time)
    travels = x[:, :4] @ travel.T
    lift = x @ A[4] + inputs @ B[4]
    channels = {"vx": np.full(len(time), SPEED), "vertical_acceleration": lift + 9.80665, "pitch_rate": x[:, 5]}
    for axle, road, values in zip(("front", "rear"), roads, travels.T, strict=True):
        channels |= {f"road_height_{axle}": road, f"suspension_travel_{axle}": values}
    return {name: values[::10] for name, values in ({"time": time} | channels).items()}


def data(seed: int, drive: Callable[[], dict[str, np.ndarray]] = ride) -> DataSet:
    """Return a ride with sensor noise, without its first second."""
    random, channels = np.random.default_rng(seed), dict(drive())
    time = channels.pop("time")
    for name, values in channels.items():
        size = next((noise for quantity, noise in NOISE.items() if name.startswith(quantity)), 0.0)
        channels[name] = (values + size * random.standard_normal(len(values)))[200:]
    return DataSet((Log("ride", "train", time[200:], channels),), wheelbase=FRONT + REAR)


def test_springs_dampers_and_tyres_of_a_half_car_are_recovered():
    fitted = fit(data(0), ModelSpec("ride"), parameters=KNOWN)
    for name in TRUTH:
        if name != "tyre_damping":
            assert fitted[name].value == pytest.approx(TRUTH[name], rel=0.05), name
        low, high = fitted[name].low, fitted[name].high
        assert low is not None
        assert high is not None
        assert low < high
    # The quarter car's closed form; both values are of the same springs and masses as the parameters.
    model = make_model(ModelSpec("ride"), data(0), {"mass": MASS, "front_length": FRONT, "rear_length": REAR})
    hop, unit = model.derived_quantities(TRUTH | {"mass": MASS, "front_length": FRONT, "rear_length": REAR})[
        "hop frequency, front"
    ]
    assert hop == pytest.approx(math.sqrt(456e3 / 80.0) / (2.0 * math.pi))
    assert unit == "Hz"


@pytest.mark.slow
def test_intervals_hold_the_truth_in_90_to_99_of_100_rides():
    held = dict.fromkeys(TRUTH, 0)
    for seed in range(100):
        fitted = fit(data(seed), ModelSpec("ride"), parameters=KNOWN)
        for name, value in TRUTH.items():
            low, high = fitted[name].low, fitted[name].high
            held[name] += low is not None and high is not None and low < value < high
    assert all(90 <= count <= 100 for count in held.values()), held


@cache
def plant_ride() -> dict[str, np.ndarray]:
    """Return the channels of a ride of the full plant of a Bolt over a road of class C, without noise."""
    assembly = assemble(
        {
            "world": str(data_root() / "worlds" / "rough_road.yaml"),
            "vehicles": {"ego": {"model": "bolt@handling", "start": {"x": 20, "y": 0, "yaw": 0}, "speed": SPEED}},
            "control": {"ego": {"kind": "constant", "speed": SPEED}},
            "plant": {"time_step": 0.0025},
            "record": {"rate": 1.0 / STEP},
        }
    )
    signals = Simulation(assembly).run(duration=DURATION).signals
    terrain, part = assembly.parts.terrain, assembly.parts.vehicles["ego"]
    x, y, yaw = (signals[f"ego.{name}"].to_numpy() for name in ("x", "y", "yaw"))
    geometry = part.vehicle.geometry
    channels = {"time": signals.index.to_numpy(), "vx": signals["ego.vx"].to_numpy(), "pitch_rate": signals["ego.wy"]}
    for axle, ahead, track in (
        ("front", geometry.wheelbase, geometry.front_track),
        ("rear", 0.0, geometry.rear_track),
    ):
        sides = (0.5 * track, -0.5 * track)
        heights = [
            terrain.height(x + ahead * np.cos(yaw) - side * np.sin(yaw), y + ahead * np.sin(yaw) + side * np.cos(yaw))
            for side in sides
        ]
        channels[f"road_height_{axle}"] = np.mean(heights, axis=0)
        travels = [signals[f"ego.travel.{axle}_{side}"] for side in ("left", "right")]
        channels[f"suspension_travel_{axle}"] = np.mean(travels, axis=0)
    return {name: np.asarray(values) for name, values in channels.items()}


@pytest.mark.slow
def test_springs_dampers_and_tyres_of_the_bolt_are_recovered_from_a_noisy_ride():
    spec = load_vehicle("bolt@handling").spec.suspension
    known = {"mass": Setting(fixed=MASS), "front_length": Setting(fixed=FRONT), "rear_length": Setting(fixed=REAR)}
    fitted = fit(data(0, plant_ride), ModelSpec("ride"), parameters=known | {"contact_length": Setting(free=True)})
    for axle in ("front", "rear"):
        corner = getattr(spec, axle)
        assert fitted[f"{axle}_stiffness"].value == pytest.approx(2.0 * corner.stiffness, rel=0.05)
        assert fitted[f"{axle}_damping"].value == pytest.approx(2.0 * corner.damping, rel=0.05)
        assert fitted[f"{axle}_tyre_stiffness"].value == pytest.approx(4e5, rel=0.05)


def test_both_sides_give_the_mean_and_a_missing_road_is_an_error():
    left, right = np.array([0.0, 2.0]), np.array([1.0, 4.0])
    channels, _ = add_derived({"road_height_front_left": left, "road_height_front_right": right})
    assert channels["road_height_front"] == pytest.approx([0.5, 3.0])
    log = data(0).logs[0]
    short = {name: values for name, values in log.channels.items() if name != "road_height_rear"}
    bare = DataSet((Log("ride", "train", log.time, short),), wheelbase=2.6)
    with pytest.raises(ConfigError, match="road_height_rear"):
        make_model(ModelSpec("ride"), bare, {})
