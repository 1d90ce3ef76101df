"""Roll centres, anti-dive and bump stops: worked numbers, and closed forms of load transfer."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml
from pydrake.systems.framework import DiagramBuilder

from mirdrake.assembly.diagram import assemble
from mirdrake.core.errors import ConfigError
from mirdrake.core.paths import data_root
from mirdrake.plant.plant import PlantSpec, make_plant
from mirdrake.plant.suspension import arms_transmit, make_arms, make_bump_stops
from mirdrake.runs.simulation import Simulation
from mirdrake.vehicles import Vehicle
from mirdrake.worlds import load_world
from tests.suspension_rigs import FRONT, REAR, on_springs, pushed_car

TRACK, HEIGHT = 1.501, 0.5  # the Bolt's [m]
HANDLING = {"front": {"stiffness": 28e3, "anti_roll": 12e3}, "rear": {"stiffness": 27e3, "anti_roll": 17e3}}
Axle = dict[str, Any]


def rows_of(vehicle: Vehicle) -> tuple[Any, Any, list[int]]:
    """Return a plant with the vehicle, its part, and the rows of its suspension joints."""
    parts = make_plant(DiagramBuilder(), load_world("empty"), {"ego": vehicle})
    part = parts.vehicles["ego"]
    return parts.plant, part, [joint.velocity_start() for joint in part.suspension]


def test_arms_press_the_outer_wheel_down_and_support_the_nose_under_braking() -> None:
    geometry = {"anti_brake": 0.1, "anti_drive": 0.05}
    vehicle = on_springs(front=FRONT | geometry | {"roll_centre": 0.15}, rear=REAR | geometry)
    plant, part, rows = rows_of(vehicle)
    arms = make_arms(plant, part, forces=8)
    context = arms.CreateDefaultContext()
    # Left turn with 1000 N on each wheel: 2 x 0.15 / 1.501 of it in front, the inner wheel up and the outer one down.
    arms.get_input_port().FixValue(context, [0.0, 1000.0] * 4)
    force = np.array(arms.get_output_port().Eval(context))
    assert force[rows] == pytest.approx([199.867, -199.867, 0.0, 0.0], abs=1e-3)
    assert np.delete(force, rows) == pytest.approx(0.0)
    # Braking with 1000 N a wheel: front wheels are pressed away from the body, rear wheels are drawn to it.
    arms.get_input_port().FixValue(context, [-1000.0, 0.0] * 4)
    assert np.array(arms.get_output_port().Eval(context))[rows] == pytest.approx([-100.0, -100.0, 100.0, 100.0])
    # Driving: the nose is drawn down, the tail pressed up.
    arms.get_input_port().FixValue(context, [1000.0, 0.0] * 4)
    assert np.array(arms.get_output_port().Eval(context))[rows] == pytest.approx([50.0, 50.0, -50.0, -50.0])
    assert arms_transmit(vehicle)
    assert not arms_transmit(on_springs())


def test_a_bump_stop_acts_beyond_its_travel_only() -> None:
    stop = {"bump_stop": {"travel": 0.05, "stiffness": 100e3}}
    plant, part, rows = rows_of(on_springs(front=FRONT | stop))
    stops = make_bump_stops(plant, part)
    assert stops is not None
    root, context = plant.CreateDefaultContext(), stops.CreateDefaultContext()
    for joint, travel in zip(part.suspension, (0.06, 0.04, 0.09, -0.09), strict=True):
        joint.set_translation(root, travel)
    stops.get_input_port().FixValue(context, plant.GetPositionsAndVelocities(root, part.instance))
    force = np.array(stops.get_output_port().Eval(context))
    assert force[rows] == pytest.approx([-1000.0, 0.0, 0.0, 0.0])
    assert np.delete(force, rows) == pytest.approx(0.0)


def test_a_bump_stop_too_stiff_for_the_time_step_is_an_error_with_the_largest_stiffness() -> None:
    vehicle = on_springs(front=FRONT | {"bump_stop": {"travel": 0.05, "stiffness": 5e6}})
    parts = make_plant(DiagramBuilder(), load_world("empty"), {"ego": vehicle}, spec=PlantSpec(time_step=0.005))
    # 40 kg below a front spring: 40 / 0.005² N/m.
    with pytest.raises(
        ConfigError, match=r"5e\+06 N/m is too stiff for 40 kg of unsprung mass .* at most 1.6e\+06 N/m"
    ):
        make_bump_stops(parts.plant, parts.vehicles["ego"])


# --- on the road -------------------------------------------------------------------------------------------------


def drive(
    folder: Path, front: Axle, rear: Axle, control: dict[str, Any], *, speed: float, duration: float
) -> pd.DataFrame:
    """Return the signals of a Bolt on slip tyres with these keys added to its axles."""
    folder.mkdir()
    (folder / "variants").mkdir()
    source = data_root() / "models" / "bolt"
    for path in source.iterdir():
        if path.name != "variants":
            (folder / path.name).symlink_to(path)
    change = yaml.safe_load((source / "variants" / "handling.yaml").read_text(encoding="utf-8"))
    for name, keys in (("front", front), ("rear", rear)):
        change["vehicle"]["suspension"][name] |= keys
    (folder / "variants" / "x.yaml").write_text(yaml.safe_dump(change), encoding="utf-8")
    spec = {
        "world": "empty",
        "vehicles": {"ego": {"model": f"{folder}@x", "speed": speed}},
        "control": {"ego": control},
        "plant": {"contact": "tyre", "time_step": 0.005},
    }
    return Simulation(assemble(spec)).run(duration=duration).signals


def test_in_a_steady_turn_arms_take_the_share_of_their_roll_centres(tmp_path: Path) -> None:
    turn = {"kind": "constant", "speed": 12.0, "steering": 0.07}
    heights = {"front": 0.10, "rear": 0.20}
    plain = drive(tmp_path / "plain", {}, {}, turn, speed=12.0, duration=5.0).iloc[-1]
    front, rear = ({"roll_centre": heights[axle]} for axle in ("front", "rear"))
    armed = drive(tmp_path / "arms", front, rear, turn, speed=12.0, duration=5.0).iloc[-1]
    lateral = {
        axle: sum(armed[f"ego.tyre_fy.{axle}_{side}"] for side in ("left", "right")) for axle in ("front", "rear")
    }
    assert armed["ego.wz"] == pytest.approx(plain["ego.wz"], rel=0.02)
    # Springs carry N T - F h of an axle's moment N T: (N T - F h) / K + N T / K_t = φ for both axles, with N T of both
    # together the moment of the lateral force. The plain car gives the softness 1 / K + 1 / K_t of each axle.
    springs = {axle: (row["stiffness"] / 2.0 + row["anti_roll"]) * TRACK**2 for axle, row in HANDLING.items()}
    softness = {axle: plain["ego.roll"] / (transfer(plain, axle) * TRACK) for axle in heights}
    lifted = {axle: lateral[axle] * heights[axle] / springs[axle] for axle in heights}
    moment = sum(transfer(armed, axle) for axle in heights) * TRACK
    assert moment == pytest.approx(HEIGHT * sum(lateral.values()), rel=0.05)  # and the shift of the weight by roll
    roll = (moment - sum(lifted[axle] / softness[axle] for axle in heights)) / sum(1.0 / s for s in softness.values())
    assert armed["ego.roll"] == pytest.approx(roll, rel=0.02)
    for axle in heights:
        assert transfer(armed, axle) * TRACK == pytest.approx((roll + lifted[axle]) / softness[axle], rel=0.02)
    assert roll < 0.9 * plain["ego.roll"]


def transfer(row: pd.Series, axle: str) -> float:
    """Return half of the difference of an axle's wheel loads [N]."""
    return float(row[f"ego.wheel_load.{axle}_right"] - row[f"ego.wheel_load.{axle}_left"]) / 2.0


def test_anti_dive_takes_its_part_of_the_front_springs_compression(tmp_path: Path) -> None:
    rows = [{"time": 0.0, "speed": 20.0}, {"time": 0.5, "speed": 20.0}, {"time": 4.5, "speed": 0.0}]
    control = {"kind": "schedule", "rows": [row | {"steering": 0.0} for row in rows]}
    travels, forces, pitches = [], [], []
    for name, slope in (("plain", 0.0), ("anti", 0.08)):
        signals = drive(tmp_path / name, {"anti_brake": slope}, {}, control, speed=20.0, duration=4.0)
        late = signals.loc[3.2:4.0].mean()  # the pitching has died out
        travels.append(sum(late[f"ego.travel.front_{side}"] for side in ("left", "right")))
        forces.append(sum(late[f"ego.tyre_fx.front_{side}"] for side in ("left", "right")))
        pitches.append(late["ego.pitch"])
    assert forces[1] == pytest.approx(forces[0], rel=0.02)
    # The two springs c carry anti_brake times the braking force of the axle less. Along the joints, which pitch with
    # the body, the braking force itself has a component that is smaller by the difference of the pitch angles.
    expected = -forces[1] * (0.08 - (pitches[0] - pitches[1]))
    assert (travels[0] - travels[1]) * FRONT["stiffness"] == pytest.approx(expected, rel=0.03)


def test_a_loaded_car_rests_where_springs_and_stops_carry_it_together() -> None:
    axle = FRONT | {"bump_stop": {"travel": 0.03, "stiffness": 60e3}, "damping": 4000.0}
    car = pushed_car(on_springs(front=axle, rear=axle), force=(0.0, 0.0, -12000.0), step=0.005)
    car.advance(2.0)
    # c z + c_s (z - z0) = F / 2 of the axle: 6720 N in front, 5280 N at the rear.
    expected = [(load / 2.0 + 60e3 * 0.03) / (28e3 + 60e3) for load in (6720.0, 6720.0, 5280.0, 5280.0)]
    assert car.travel == pytest.approx(expected, rel=0.02)
