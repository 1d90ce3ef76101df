"""Entries of control.yaml that a diagram changes, and the ports between a control unit and its plant."""

from typing import Any

import pytest

from mirdrake.assembly.diagram_spec import DiagramSpec
from mirdrake.assembly.scene import make_scene
from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import parse_yaml
from mirdrake.runs.simulation import simulate

TEXT = "world: empty\nvehicles:\n  ego:\n    model: bolt\n    control:\n      {}\n"


def control(entry: str) -> Any:
    return make_scene(parse_yaml(TEXT.format(entry), DiagramSpec, name="d.yaml")).vehicles["ego"].control


def test_entries_are_laid_over() -> None:
    changed = control("wheel_speed: {gain: 150}")
    assert changed.wheel_speed.gain == 150.0
    assert changed.steering.stiffness == 5.0e7


def test_another_kind_replaces_the_whole_entry() -> None:
    assert control("wheel_speed: {kind: pid, kp: 3}").wheel_speed.model_dump(exclude_unset=True) == {
        "kind": "pid",
        "kp": 3.0,
    }


@pytest.mark.parametrize(
    ("entry", "expected"),
    [
        ("wheel_speed: {gian: 3}", "d.yaml:6: wheel_speed.gian: unknown field; did you mean 'gain'"),
        ("weel_speed: {gain: 3}", "d.yaml:6: weel_speed: unknown field; did you mean 'wheel_speed'"),
        ("wheel_speed: {gain: -3}", "d.yaml:6: wheel_speed.gain: -3 is not allowed"),
        ("wheel_speed: {kind: pedals}", "pedals drive tyres of kind brush or magic_formula"),
    ],
)
def test_faults_are_reported_with_file_and_line(entry: str, expected: str) -> None:
    with pytest.raises(ConfigError) as error:
        control(entry)
    assert expected in str(error.value)


def test_a_block_connects_control_unit_and_joints() -> None:
    spec: dict[str, Any] = {
        "world": "empty",
        "vehicles": {"ego": {"model": "bolt", "control": {"wheel_speed": {"kind": "pid", "kp": 400}}}},
        "control": {"ego": {"kind": "constant", "speed": 2.0}},
        "plant": {"contact": "point"},
        "record": {"meshcat": False, "report": False},
        "duration": 1.5,
    }
    free = simulate(spec).signals["ego.vx"].iloc[-1]
    spec["systems"] = {"off": {"kind": "gain", "gain": 0.0, "size": 6}}
    spec["connect"] = [["ego.torque_command", "off.u"], ["off.y", "ego.torque_reference"]]
    assert free > 1.0
    assert abs(simulate(spec).signals["ego.vx"].iloc[-1]) < 0.01
