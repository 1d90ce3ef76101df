"""Differentials: the torque split in closed form, alone and in the full plant."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from mirdrake.assembly.diagram import assemble
from mirdrake.core.errors import ConfigError
from mirdrake.core.paths import data_root
from mirdrake.core.yaml_io import parse_yaml
from mirdrake.plant.powertrain.differential import Coupling, couple
from mirdrake.plant.powertrain.system import wheel_inertias
from mirdrake.runs.simulation import Simulation
from mirdrake.tyres.brush import BrushTyre, brush_forces
from mirdrake.vehicles.differential_spec import (
    ClutchDifferential,
    Differential,
    Differentials,
    LockedDifferential,
    OpenDifferential,
    TorqueSensingDifferential,
)

INERTIA, PERIOD = 1.2, 0.0025


def spin(kind: Differential, *, torque: float, grip: tuple[float, float], duration: float = 2.0):
    """Return rates [rad/s] and torques [N m] of two wheels on an axle, each held by a viscous road up to its grip."""
    coupling = Coupling(kind, 4000.0, 2.0 * 0.3 * (4000.0 * INERTIA / 2.0) ** 0.5)
    rates, twist, torques = np.zeros(2), 0.0, np.zeros(2)
    for _ in range(round(duration / PERIOD)):
        twist, moment = couple(coupling, twist, rates[0] - rates[1], torque, PERIOD)
        torques = 0.5 * torque + np.array([-moment, moment])
        road = np.clip(400.0 * rates, -np.array(grip), grip)
        # The road is implicit, as its damping is stiff.
        stiff = np.where(np.abs(400.0 * rates) < grip, 400.0, 0.0)
        rates = rates + PERIOD * (torques - road) / (INERTIA + PERIOD * stiff)
    return rates, torques


def test_the_slipping_wheel_limits_the_other_one_to_its_bias_ratio():
    # 100 N m of grip on the left. The right wheel gets B times the left one's torque, which exceeds the grip by what
    # accelerates the wheel: T = T_left + T_right and T_right = B T_left.
    rates, torques = spin(TorqueSensingDifferential(bias_ratio=3.0), torque=800.0, grip=(100.0, 1000.0))
    assert torques == pytest.approx([200.0, 600.0])
    assert rates[0] > 50.0
    # A torque that both wheels can take by the ratio does not let the left one slip: it turns as the right one.
    rates, torques = spin(TorqueSensingDifferential(bias_ratio=3.0), torque=390.0, grip=(100.0, 1000.0))
    assert torques == pytest.approx([100.0, 290.0], rel=1e-3)
    assert rates[0] == pytest.approx(rates[1], abs=1e-3)


def test_a_clutch_has_preload_and_ramps_and_a_locked_one_no_limit():
    clutch = ClutchDifferential(preload=50.0, drive_lock=0.4, coast_lock=0.1)
    # T_right - T_left = 50 + 0.4 T.
    _, torques = spin(clutch, torque=1000.0, grip=(50.0, 2000.0))
    assert torques == pytest.approx([275.0, 725.0])
    _, torques = spin(clutch, torque=-1000.0, grip=(50.0, 2000.0))
    assert torques == pytest.approx([-425.0, -575.0])
    rates, torques = spin(LockedDifferential(), torque=1000.0, grip=(50.0, 2000.0))
    assert torques == pytest.approx([50.0, 950.0], rel=1e-3)
    assert rates[0] == pytest.approx(rates[1], abs=1e-3)


def test_locking_values():
    # The locking value of a torque bias ratio is (B - 1) / (B + 1).
    assert TorqueSensingDifferential(bias_ratio=4.0).locking(-100.0) == pytest.approx(60.0)
    assert OpenDifferential().locking(1e6) == 0.0


def test_entries_of_a_file_and_their_messages():
    read = parse_yaml("front: locked\nrear: {kind: clutch, preload: 60 N m}\n", Differentials, name="d")
    assert isinstance(read.front, LockedDifferential)
    assert isinstance(read.rear, ClutchDifferential)
    assert read.rear.preload == 60.0
    with pytest.raises(ConfigError, match="torque_sensing"):
        parse_yaml("front: torsen\n", Differentials, name="d")
    with pytest.raises(ConfigError, match=r"bias_ratio"):
        parse_yaml("front: {kind: torque_sensing, bias_ratio: 0.5}\n", Differentials, name="d")


# --- the full plant ---------------------------------------------------------------------------------------------------

TYRE: dict[str, Any] = {
    "nominal_load": 4000.0,
    "longitudinal_stiffness": 88000.0,
    "cornering_stiffness": 56000.0,
    "friction": 1.0,
    "peak_load": 8000.0,
    "half_length": 0.06,
    "relaxation_x": 0.2,
    "relaxation_y": 0.4,
}


def bolt(folder: Path, differential: object) -> str:
    """Return a Bolt with a differential on its front axle, without traction control, on brush tyres."""
    model = folder / "bolt"
    shutil.copytree(data_root() / "models" / "bolt", model)
    variant = yaml.safe_load((model / "variants" / "handling.yaml").read_text(encoding="utf-8"))
    variant["vehicle"].pop("sources")
    variant["vehicle"]["tyres"] = {"kind": "brush", "rolling_resistance": 0.0, "front": TYRE}
    variant["vehicle"]["powertrain"] |= {"traction": False, "differential": {"front": differential}}
    (model / "variants" / "coupled.yaml").write_text(yaml.safe_dump(variant), encoding="utf-8")
    return f"{model}@coupled"


def drive(folder: Path, differential: object, control: dict[str, Any], *, speed: float, duration: float, **world: Any):
    """Return the signals of a drive, and the spin inertia of a front wheel [kg m²]."""
    model = bolt(folder, differential)
    file = folder / "asphalt.yaml"
    file.write_text(yaml.safe_dump({"mirdrake": "world/1", "ground": {"surface": "asphalt", **world}}), "utf-8")
    spec = {
        "world": str(file),
        "vehicles": {"ego": {"model": model, "speed": speed, "start": {"x": 0, "y": 0}}},
        "control": {"ego": control},
        "plant": {"air_density": 0.0, "contact": "point", "time_step": 0.0025},
    }
    assembly = assemble(spec)
    inertia = wheel_inertias(assembly.parts.plant, assembly.parts.vehicles["ego"])[0]
    return Simulation(assembly).run(duration=duration).signals, inertia


@pytest.mark.parametrize(
    ("differential", "ratio"), [("open", 1.0), ({"kind": "torque_sensing", "bias_ratio": 2.5}, 2.5)]
)
def test_on_split_friction_the_drive_force_is_that_of_the_poorer_wheel_times_the_ratio(tmp_path, differential, ratio):
    ice = {"rect": {"center": [0.0, 50.0], "size": [1000.0, 100.0]}, "mu": 0.085, "name": "ice"}
    control = {"kind": "mirdrake.manoeuvres.drivers:OpenLoopDriver", "profile": {"kind": "step", "amplitude": 0.0},
               "pedals": [[0.0, 0.35, 0.0, 1.0]]}  # fmt: skip
    signals, inertia = drive(tmp_path, differential, control, speed=3.0, duration=1.0, patches=[ice])
    late = signals.loc[0.7:1.0]
    # Brush tyres slide on ice (a tenth of the friction of asphalt); the wheel's inertia takes the rest of its torque.
    left = late["ego.tyre_fx.front_left"]
    assert left.mean() == pytest.approx(0.1 * late["ego.wheel_load.front_left"].mean(), rel=0.01)
    radius = 0.97 * 0.3234  # rolling
    acceleration = {
        side: np.polyfit(late.index, late[f"ego.wheel_speed.front_{side}"], 1)[0] for side in ("left", "right")
    }
    torque = {
        side: late[f"ego.tyre_fx.front_{side}"].mean() * radius + inertia * acceleration[side]
        for side in ("left", "right")
    }
    assert torque["right"] / torque["left"] == pytest.approx(ratio, rel=0.03)


def test_a_locked_axle_in_a_circle_has_the_understeer_moment_of_its_slips(tmp_path):
    control = {"kind": "constant", "speed": 5.0, "steering": 0.015}
    signals, _ = drive(tmp_path, "locked", control, speed=5.0, duration=4.0)
    row = signals.loc[3.5:].mean()
    assert row["ego.wheel_speed.front_left"] == pytest.approx(row["ego.wheel_speed.front_right"], rel=1e-4)
    # Both wheels turn alike, while their centres move with v ± r t / 2: their slips differ by t / R.
    track = 1.501
    slip = 0.5 * track * row["ego.wz"] / row["ego.vx"]
    tyre = BrushTyre(**{name: value for name, value in TYRE.items() if not name.startswith("relaxation")})
    load = 0.5 * (row["ego.wheel_load.front_left"] + row["ego.wheel_load.front_right"])
    force = float(brush_forces(tyre, slip, 0.0, load, friction=1.0).fx)
    difference = 0.5 * (row["ego.tyre_fx.front_left"] - row["ego.tyre_fx.front_right"])
    assert difference == pytest.approx(force, rel=0.03)
    # The inner wheel of the left turn drives: the moment is against the turn.
    assert difference > 0.0


def test_a_coupling_too_stiff_for_the_step_is_one_line(tmp_path):
    with pytest.raises(ConfigError, match=r"at most .* or smaller steps"):
        drive(tmp_path, {"kind": "locked", "stiffness": 1e9}, {"kind": "constant", "speed": 1.0, "steering": 0.0},
              speed=1.0, duration=0.1)  # fmt: skip
