"""Gains over speed in control.yaml: read, interpolated by the controllers, written by ``mirdrake tune apply``."""

import json
import shutil
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from mirdrake.assembly.diagram import assemble
from mirdrake.core.errors import ConfigError
from mirdrake.core.vectors import STATE
from mirdrake.core.yaml_io import parse_yaml
from mirdrake.execution.parameters import find_context_parameters
from mirdrake.runs.simulation import Simulation
from mirdrake.single_track.control import SingleTrackControl
from mirdrake.tuning.apply import plan_apply
from mirdrake.tuning.result import read_result
from mirdrake.vehicles import load_vehicle
from mirdrake.vehicles.spec import ControlSpec
from mirdrake.worlds import load_world
from tests.tuning_sample import result_data

ROOT = Path(__file__).resolve().parent.parent
DAY = date(2026, 3, 1)
# At 100 Hz a wheel of 0.0076 kg m^2 on an elastic tyre is stable up to a gain of 2 J / T = 1.5 N m s/rad.
SPEEDS, KP, KI = [1.0, 3.0, 4.0], [0.5, 1.2, 0.8], [0.0, 2.0, 2.0]
ROWS = [{"speed": v, "gains": {"kp": p, "ki": i, "kd": 0.0}} for v, p, i in zip(SPEEDS, KP, KI, strict=True)]


@pytest.fixture
def scheduled(tmp_path: Path) -> Path:
    """A copy of the Unior with what apply writes in its control.yaml."""
    vehicle = Path(shutil.copytree(ROOT / "models/unior", tmp_path / "unior"))
    plan_apply(read_result(result(tmp_path, vehicle, schedule={"rows": ROWS})), today=DAY).write()
    return vehicle


def result(tmp_path: Path, vehicle: Path, **changes: Any) -> Path:
    folder = tmp_path / "result"
    folder.mkdir(exist_ok=True)
    (folder / "tuning.json").write_text(json.dumps(result_data(str(vehicle)) | changes))
    return folder


def torques(assembly: Any, speed: float, *gains: float) -> Any:
    """Actuation after some updates with wheels that turn a little too slowly, perhaps with gains given [N m]."""
    control = assembly.diagram.GetSubsystemByName("ego.control")
    plant, part = assembly.parts.plant, assembly.parts.vehicles["ego"]
    context = control.CreateDefaultContext()
    for index, value in enumerate(gains):
        context.get_mutable_numeric_parameter(1).SetAtIndex(index, value)
    x = np.zeros(plant.num_multibody_states())
    x[part.base.floating_positions_start()] = 1.0
    velocities = plant.num_positions()
    x[velocities + part.base.floating_velocities_start_in_v() + 3] = speed
    for joint in part.wheels:
        x[velocities + joint.velocity_start()] = 0.995 * speed / part.rolling_radii(plant)[0]
    control.plant_state.FixValue(context, x)
    control.command.FixValue(context, [speed, 0.0, 0.0])
    Simulator(control, context).AdvanceTo(0.025)  # the integral has something to do
    return np.array(control.actuation.Eval(context))


def test_the_controller_reads_its_gains_at_the_measured_speed(scheduled: Path) -> None:
    def make(**control: Any) -> Any:
        vehicle = {"model": str(scheduled), "control": control}
        return assemble({"world": "empty", "vehicles": {"ego": vehicle}, "plant": {"contact": "point"}})

    by_table, constant = make(), make(wheel_speed={"schedule": None})
    for speed in (0.5, 1.0, 1.5, 2.9, 3.25, 4.0, 6.0, -2.0):
        gains = [float(np.interp(abs(speed), SPEEDS, row)) for row in (KP, KI)]
        assert torques(by_table, speed) == pytest.approx(torques(constant, speed, *gains), rel=1e-12)
        assert 0.01 < np.abs(torques(by_table, speed)).max() < 10.0  # not at the limit
    assert torques(constant, 2.0) != pytest.approx(torques(by_table, 2.0), rel=0.01)


def test_the_single_track_model_has_the_same_gains(scheduled: Path) -> None:
    def force(vehicle: Any, speed: float) -> float:
        control = SingleTrackControl(vehicle, mass=100.0)
        context = control.CreateDefaultContext()
        control.command.FixValue(context, [speed + 0.01, 0.0, 0.0])
        state = [speed if signal.name == "vx" else 0.0 for signal in STATE]
        control.state.FixValue(context, state)
        control.steering_angle.FixValue(context, [0.0])
        Simulator(control, context).AdvanceTo(0.025)
        return float(control.forces.Eval(context)[0])

    vehicle = load_vehicle(str(scheduled))
    controller = vehicle.control.wheel_speed
    gains = {name: float(np.interp(2.0, SPEEDS, row)) for name, row in (("kp", KP), ("ki", KI))}
    flat = controller.model_copy(update={"schedule": None, **gains})
    other = replace(vehicle, control=vehicle.control.model_copy(update={"wheel_speed": flat}))
    assert force(vehicle, 2.0) == pytest.approx(force(other, 2.0), rel=1e-12)
    assert force(vehicle, 3.0) != pytest.approx(force(other, 3.0), rel=0.01)


def test_scheduled_gains_are_not_tunable_parameters(scheduled: Path) -> None:
    vehicle = load_vehicle(str(scheduled))
    parameters = find_context_parameters({"ego": vehicle}, load_world("empty"))
    assert "ego.speed.kp" in parameters
    assert not any(".wheel_speed." in name for name in parameters)
    assert [gain.path for gain in vehicle.control.gains()] == ["speed.kp", "speed.ki"]


def test_apply_writes_the_schedule_once_and_constant_gains_remove_it(tmp_path: Path, scheduled: Path) -> None:
    text = (scheduled / "control.yaml").read_text()
    assert (
        "  schedule:\n    speeds: [1.0, 3.0, 4.0]  # m/s\n    kp: [0.5, 1.2, 0.8]  # N m s/rad\n"
        "    ki: [0.0, 2.0, 2.0]  # N m/rad\n    kd: [0.0, 0.0, 0.0]  # N m s²/rad\n" in text
    )
    assert "cost 0.6046 (baseline 2.17), schedule over 3 speeds\n" in text
    assert text.count("# tuned ") == 1
    folder = result(tmp_path, scheduled, schedule={"rows": ROWS})
    assert not plan_apply(read_result(folder), today=date(2026, 4, 2)).changes
    fewer = plan_apply(read_result(result(tmp_path, scheduled, schedule={"rows": ROWS[:2]})), today=DAY)
    assert "speeds: [1.0, 3.0]  # m/s\n" in fewer.after
    plan = plan_apply(read_result(folder), candidate="searched", today=DAY)
    assert "schedule:" not in plan.after
    assert "kp: 3.54082" in plan.after


def test_apply_does_not_write_constant_gains_where_a_schedule_was_asked_for(tmp_path: Path) -> None:
    vehicle = Path(shutil.copytree(ROOT / "models/unior", tmp_path / "unior"))
    folder = result(tmp_path, vehicle, schedule={"rows": [], "failed_speed": 2.0})
    with pytest.raises(
        ConfigError, match="schedule: the study found no gains for one of the speeds; choose constant gains"
    ):
        plan_apply(read_result(folder), today=DAY)
    assert plan_apply(read_result(folder), candidate="searched", today=DAY).changes


def test_a_variant_cannot_have_constant_gains_over_a_schedule_below_it(tmp_path: Path, scheduled: Path) -> None:
    variant = scheduled / "variants" / "soft.yaml"
    variant.write_text("description: softer\ncontrol:\n  wheel_speed: {kp: 0.5}\n")
    folder = result(tmp_path, Path(f"{scheduled}@soft"))
    with pytest.raises(ConfigError, match=r"control.yaml:\d+: wheel_speed.schedule: has precedence over these gains"):
        plan_apply(read_result(folder), today=DAY)


def test_the_vehicle_drives_with_it(scheduled: Path) -> None:
    rows = [{"time": 0, "speed": 1}, {"time": 0.5, "speed": 1}, {"time": 2.5, "speed": 3.5}]
    run = Simulation(
        assemble(
            {
                "world": "empty",
                "vehicles": {"ego": {"model": str(scheduled), "speed": 1.0}},
                "control": {"ego": {"kind": "schedule", "rows": rows}},
                "plant": {"contact": "point"},
            }
        )
    ).run(duration=4.0)
    assert run.signals["ego.vx"].iloc[-1] == pytest.approx(3.5, abs=0.05)


@pytest.mark.parametrize(
    ("schedule", "message"),
    [
        ("{speeds: [3, 1], kp: [1, 2]}", "wheel_speed.schedule: speeds: must increase, got 3, 1"),
        ("{speeds: [1, 1], kp: [1, 2]}", "wheel_speed.schedule: speeds: must increase, got 1, 1"),
        ("{speeds: [1, 3], kp: [1, 2, 3]}", "wheel_speed.schedule: kp: 2 values are needed, one for each speed, not 3"),
        ("{speeds: [1, 3]}", "wheel_speed.schedule: no gain is given; write for example kp: [300, 400]"),
        ("{speeds: [1], kp: [1]}", "wheel_speed.schedule.speeds: has 1 items; at least 2"),
        ("{speeds: [1, 3], kp: [1, -2]}", "wheel_speed.schedule.kp.1: -2 is not allowed"),
        ("{speeds: [1, 3], kq: [1, 2]}", "wheel_speed.schedule.kq: unknown"),
    ],
)
def test_a_schedule_that_is_invalid_is_rejected_with_its_line(schedule: str, message: str) -> None:
    text = f"wheel_speed:\n  kind: pid\n  kp: 1\n  schedule: {schedule}\nsteering: {{kind: pid, kp: 1}}\n"
    with pytest.raises(ConfigError) as caught:
        parse_yaml(text, ControlSpec, name="control.yaml")
    assert str(caught.value).startswith(f"control.yaml:4: {message}")


def test_pedals_have_no_derivative() -> None:
    text = "wheel_speed: {kind: pedals, schedule: {speeds: [1, 3], kd: [1, 2]}}\nsteering: {kind: pid, kp: 1}\n"
    with pytest.raises(ConfigError, match="pedals have no kd; leave it out"):
        parse_yaml(text, ControlSpec, name="control.yaml")
