"""Rear-wheel steering: turning centre, yaw gain, side slip, and its actuator."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml

from mirdrake.assembly.diagram import assemble
from mirdrake.core.errors import ConfigError
from mirdrake.core.paths import data_root
from mirdrake.plant.rear_steering import rear_wheel_angles
from mirdrake.runs.simulation import Simulation
from mirdrake.single_track import estimate_parameters, zero_side_slip_ratio
from mirdrake.vehicles import load_vehicle

WHEELBASE, TRACK, FRONT = 2.601, 1.501, 1.144  # the Bolt's; distance of the centre of mass from the front axle [m]
Rear = dict[str, Any] | None


def steered(folder: Path, rear: Rear, *, variant: str = "handling") -> str:
    """Return the name of a Bolt with rear steering."""
    source = data_root() / "models" / "bolt"
    (folder / "variants").mkdir(parents=True)
    for path in source.iterdir():
        if path.name != "variants":
            (folder / path.name).symlink_to(path)
    change = yaml.safe_load((source / "variants" / f"{variant}.yaml").read_text(encoding="utf-8"))
    change["vehicle"]["steering"] = {"rear": rear}
    (folder / "variants" / "x.yaml").write_text(yaml.safe_dump(change), encoding="utf-8")
    return f"{folder}@x"


def drive(model: str, control: dict[str, Any], *, speed: float, duration: float, **more: Any) -> pd.DataFrame:
    """Return the signals of a drive."""
    spec = {
        "world": "empty",
        "vehicles": {"ego": {"model": model, "speed": speed}},
        "control": {"ego": control},
        "plant": {"contact": "tyre"},
    }
    return Simulation(assemble(spec | more)).run(duration=duration).signals


def bicycle(row: pd.Series) -> tuple[float, float]:
    """Return the mean steering angle of the front and of the rear wheels [rad]."""
    front, rear = (
        float(np.mean([row[f"ego.steering_angle.{axle}{side}"] for side in ("left", "right")]))
        for axle in ("", "rear_")
    )
    return front, rear


@pytest.mark.parametrize(("front", "rear"), [(0.4, -0.2), (0.4, 0.1), (-0.3, 0.15), (0.2, 0.2), (0.0, 0.1)])
def test_all_wheels_turn_about_one_point(front: float, rear: float) -> None:
    left, right = rear_wheel_angles(front, rear, wheelbase=WHEELBASE, track=TRACK)
    if front == rear:  # they go straight ahead, obliquely
        assert (left, right) == pytest.approx((rear, rear))
        return
    # The point is on the normals of both bicycle wheels, at (0, 0) and (L, 0).
    radius = WHEELBASE / (np.tan(front) - np.tan(rear))
    x = -radius * np.tan(rear)
    assert (WHEELBASE - x) / radius == pytest.approx(np.tan(front))
    for angle, y in ((left, 0.5 * TRACK), (right, -0.5 * TRACK)):
        along = np.array([np.cos(angle), np.sin(angle)])
        assert along @ [x, radius - y] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("ratio", [-0.25, 0.25])
def test_the_steady_yaw_rate_follows_the_ratio(ratio: float, tmp_path: Path) -> None:
    turn = {"kind": "constant", "speed": 14.0, "steering": 0.012}  # below 1 m/s²: linear tyres
    plain = drive("bolt@handling", turn, speed=14.0, duration=4.0).iloc[-1]
    row = drive(steered(tmp_path, {"ratio": ratio}), turn, speed=14.0, duration=4.0).iloc[-1]
    front, rear = bicycle(row)
    assert rear == pytest.approx(ratio * front, rel=1e-3)
    # r = v (1 - k) δ / (L + K v²), with the understeer gradient K of the car without rear steering.
    angle, speed = plain[["ego.steering_angle.left", "ego.steering_angle.right"]].mean(), plain["ego.vx"]
    gradient = (angle - WHEELBASE * plain["ego.wz"] / speed) / (speed * plain["ego.wz"])
    expected = row["ego.vx"] * (1.0 - ratio) * front / (WHEELBASE + gradient * row["ego.vx"] ** 2)
    assert row["ego.wz"] == pytest.approx(expected, rel=0.015)


@pytest.mark.parametrize("speed", [5.0, 18.0])
def test_the_ratio_of_sano_leaves_no_side_slip(speed: float, tmp_path: Path) -> None:
    parameters = estimate_parameters(load_vehicle("bolt@handling"))
    ratio = zero_side_slip_ratio(parameters, speed)
    assert ratio * (speed - 10.0) > 0.0  # opposite at low speed, in the same direction at high speed
    turn = {"kind": "constant", "speed": speed, "steering": 0.01}
    slips = []
    for model in ("bolt@handling", steered(tmp_path, {"ratio": ratio})):
        row = drive(model, turn, speed=speed, duration=5.0).iloc[-1]
        slips.append((row["ego.vy"] + row["ego.wz"] * (WHEELBASE - FRONT)) / row["ego.vx"] / row["ego.wz"])
    # Suspension and the angles of both wheels leave a rest of 0.0027 rad s/m at small steps of the plant.
    assert abs(slips[1]) < 0.04 * abs(slips[0]) + 1e-3


def test_a_table_over_speed_a_limit_and_an_actuator(tmp_path: Path) -> None:
    rear = {
        "ratio": [[0, -0.5], ["10 m/s", 0.1]],
        "limit": "2 deg",
        "actuator": {"delay": 0.05, "time_constant": 0.1, "rate": 0.05},
    }
    rows = [{"time": t, "speed": 5.0, "steering": angle} for t, angle in ((0.0, 0.0), (1.0, 0.0), (1.01, 0.3))]
    model = steered(tmp_path, rear)
    signals = drive(model, {"kind": "schedule", "rows": rows}, speed=5.0, duration=3.0)
    last = signals.iloc[-1]
    # -0.2 x 0.3 rad would be 3.4 degrees; the limit is that of the bicycle angle.
    assert np.tan(bicycle(last)[1]) == pytest.approx(-np.tan(np.deg2rad(2.0)), rel=0.01)
    rates = np.diff(signals[["ego.steering_angle.rear_left", "ego.steering_angle.rear_right"]].mean(axis=1)) / np.diff(
        signals.index
    )
    assert np.abs(rates).max() == pytest.approx(0.05, rel=0.03)


def test_a_block_replaces_the_ratio(tmp_path: Path) -> None:
    (tmp_path / "crab.py").write_text(
        "from pydrake.systems.primitives import ConstantVectorSource\n"
        "class Crab(ConstantVectorSource):\n    def __init__(self):\n        super().__init__([0.05])\n",
        encoding="utf-8",
    )
    model = steered(tmp_path / "car", {"ratio": 0.0})
    turn = {"kind": "constant", "speed": 5.0, "steering": 0.05}
    more = {"systems": {"crab": {"kind": "crab:Crab"}}, "connect": [["crab.y", "ego.rear_steering_reference"]]}
    row = drive(model, turn, speed=5.0, duration=4.0, folder=str(tmp_path), **more).iloc[-1]
    # Both axles in parallel: the car moves obliquely and does not turn.
    assert abs(row["ego.wz"]) < 0.02
    assert row["ego.vy"] / row["ego.vx"] == pytest.approx(0.05, rel=0.05)


def test_a_rear_steering_without_rows_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="ascending speed"):
        load_vehicle(steered(tmp_path, {"ratio": [[10, 0.1], [5, 0.0]]}))
