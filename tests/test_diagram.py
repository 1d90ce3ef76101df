"""Diagrams: a file and its Python equivalent, named ports, user blocks, two vehicles, the drawing."""

import math
import re
import shutil
from dataclasses import replace
from pathlib import Path
from textwrap import dedent
from typing import Any

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, PassThrough

import mirdrake as mir
from mirdrake.assembly.diagram import assemble, make_spec
from mirdrake.assembly.diagram_spec import without_user_systems
from mirdrake.assembly.drawing import draw_svg, fit_svg, layout_command, run_dot, write_dot
from mirdrake.assembly.speed_limits import limited_speeds
from mirdrake.assembly.wiring import Wiring
from mirdrake.cli import main as mir_main
from mirdrake.controllers.platoon import CaccSpec
from mirdrake.core.errors import ConfigError, MissingDependencyError
from mirdrake.core.signals import signals
from mirdrake.core.yaml_io import Source, validate
from mirdrake.runs.simulation import simulate
from mirdrake.vehicles import load_vehicle

POINT: dict[str, Any] = {"contact": "point"}
QUIET = {"meshcat": False, "report": False}

OWN_BLOCKS = dedent(
    """\
    from pydrake.systems.framework import LeafSystem

    from mirdrake.core.signals import declare_vector_input, declare_vector_output, signals


    class Scale(LeafSystem):
        def __init__(self, *, gain: float = {gain}):
            super().__init__()
            self._gain = gain
            self._u = declare_vector_input(self, "u", signals(("steering", "rad")))
            declare_vector_output(self, "y", signals(("steering", "rad")), self._calc)

        def _calc(self, context, output):
            output.SetFromVector(self._gain * self._u.Eval(context))
    """
)

OWN_DRIVE = dedent(
    """\
    world: empty
    vehicles: {ego: {model: bolt, start: origin}}
    control: {ego: {kind: constant, speed: 3, steering: 0.2}}
    systems:
      scale: {kind: "own_blocks:Scale"}
    connect:
      - [ego.steering_command, scale.u]
      - [scale.y, ego.steering_reference]
    plant: {contact: point}
    duration: 2
    """
)


def drive(**changes: Any) -> dict[str, Any]:
    """Return a Bolt with set-points of 3 m/s and 0.2 rad for two seconds, as plain data."""
    return {
        "world": "empty",
        "vehicles": {"ego": {"model": "bolt"}},
        "control": {"ego": {"kind": "constant", "speed": 3.0, "steering": 0.2}},
        "plant": POINT,
        "duration": 2.0,
    } | changes


def port_names(diagram: Diagram) -> tuple[list[str], list[str]]:
    """Return names of a diagram's inputs and outputs."""
    inputs = [diagram.get_input_port(i).get_name() for i in range(diagram.num_input_ports())]
    return inputs, [diagram.get_output_port(i).get_name() for i in range(diagram.num_output_ports())]


def test_without_user_systems_nothing_is_connected_to_what_is_left_out() -> None:
    spec = make_spec(
        drive(
            vehicles={"ego": {"model": "bolt"}, "other": {"model": "bolt", "start": {"x": 20.0}}},
            control={"ego": {"kind": "own:Driver"}, "other": {"kind": "constant", "speed": 1.0}},
            systems={
                "painter": {"kind": "own:Painter"},
                "pilot": {"kind": "network", "image": "painter.y"},
                "half": {"kind": "gain", "gain": 0.5},
                "twice": {"kind": "gain", "gain": 2.0},
                "kept": {"kind": "gain", "gain": 1.0},
            },
            connect=[
                ["ego.steering_command", "half.u"],
                ["half.y", "ego.steering_reference"],
                ["ego.command.speed", "twice.u"],
                ["ego.vx", "ego.driver_speed"],
                ["other.steering_command", "kept.u"],
                ["kept.y", "other.steering_reference"],
            ],
        )
    )
    rest, left_out = without_user_systems(spec)
    assert list(rest.systems) == ["kept"]
    assert list(rest.control) == ["other"]
    assert rest.connect == spec.connect[-2:]
    assert left_out == [
        "systems.painter (own:Painter)",
        "systems.half (an input is from ego.driver)",
        "systems.twice (an input is from ego.driver)",
        "systems.pilot (an input is from painter)",
        "control.ego (own:Driver)",
        "4 connections of these",
    ]
    assert assemble(rest).unread == ()


@pytest.mark.parametrize(
    ("pattern", "left_out"),
    [
        ("slow.limited", True),
        ("sl?w.*", True),
        ("*.limited", True),
        ("[rs]low.limited", True),
        ("ego.driver.state", True),
        ("ego.control.pedals.gain", True),
        ("slower.limited", False),
        ("ego.control.steering*", False),
        ("ego.vx", False),
    ],
)
def test_patterns_of_signals_that_are_left_out_are_left_out_too(pattern: str, left_out: bool) -> None:
    spec = make_spec(
        drive(
            control={"ego": {"kind": "own:Driver"}},
            systems={"slow": {"kind": "own:Slow"}, "ego.control.pedals": {"kind": "own:Pedals"}},
            record={"signals": [pattern]},
        )
    )
    rest, lines = without_user_systems(spec)
    assert rest.record.signals == (True if left_out else [pattern])
    assert (f"record.signals: {pattern}" in lines) is left_out
    assert spec.record.signals == [pattern]


@pytest.mark.parametrize(
    ("driver", "given"),
    [
        ({"kind": "constant", "speed": 2.1}, "2.1 m/s"),
        ({"kind": "constant", "speed": -2.1}, "2.1 m/s"),
        ({"kind": "constant", "speed": 2.0}, None),
        ({"kind": "blind"}, "5 m/s"),
        ({"kind": "schedule", "rows": [{"time": 0, "speed": 1}, {"time": 1, "speed": 3}]}, "3 m/s"),
        ({"kind": "own:Driver", "speed": 9.0}, None),
    ],
)
def test_set_points_above_the_speed_limit_of_the_control_unit_are_reported(
    driver: dict[str, Any], given: str | None
) -> None:
    bolt = load_vehicle("bolt")
    assert bolt.control.speed.max_speed is None
    spec = make_spec(drive(control={"ego": driver}))
    assert limited_speeds(spec, {"ego": bolt}) == []
    control = bolt.control.model_copy(update={"speed": bolt.control.speed.model_copy(update={"max_speed": 2.0})})
    lines = limited_speeds(spec, {"ego": replace(bolt, control=control)})
    assert len(lines) == (given is not None)
    for line in lines:
        assert f"the set-point is {given}; the control unit of ego limits it to 2 m/s" in line


def test_elements_of_a_default_source_without_names_cannot_be_filled_in() -> None:
    wiring = Wiring(DiagramBuilder(), make_spec(drive(connect=[["one.y", "two.u.a"]])))
    one = wiring.builder.AddNamedSystem("one", ConstantVectorSource([1.0]))
    three = wiring.builder.AddNamedSystem("three", ConstantVectorSource([1.0, 1.0]))
    two = wiring.builder.AddSystem(PassThrough(2))
    wiring.sources |= {"one.y": (one.get_output_port(), None), "three.y": (three.get_output_port(), None)}
    wiring.sinks["two.u"] = (two.get_input_port(), signals(("a", ""), ("b", "")))
    wiring.defaults.append(("three.y", "two.u"))
    with pytest.raises(ConfigError, match=r"input 'two.u' has no value for b; connect them"):
        wiring.connect()


def test_an_unknown_element_of_an_input_has_no_default_source() -> None:
    assembly = assemble(make_spec(drive()))
    assert assembly.default_source("ego.speed_reference") == "ego.speed_command"
    assert assembly.default_source("ego.speed_reference.nothing") is None


@pytest.mark.parametrize("delay", [0.001, 0.05, 0.0999])
def test_a_delay_between_two_periods_is_an_error(delay: float) -> None:
    systems = {"late": {"kind": "delay", "delay": delay, "period": 0.02}}
    with pytest.raises(ConfigError, match=rf"delay: {delay} s is not a multiple of the period, 0.02 s"):
        assemble(make_spec(drive(systems=systems, connect=[["ego.vx", "late.u"]])))
    spec = validate({"kind": "cacc", "delay": delay}, CaccSpec, Source("d.yaml", {}))
    with pytest.raises(ConfigError, match=rf"delay: {delay} s is not a multiple of the period, 0.02 s"):
        spec.make_system(None, None)  # type: ignore[arg-type]


# --- file and twin ---------------------------------------------------------------------------------------------------


def test_a_file_and_its_data_give_the_same_spec() -> None:
    spec = mir.load_diagram("bolt_test_track")
    assert make_spec(spec.model_dump()) == spec
    assert make_spec(spec.model_dump(mode="json")) == spec


def test_units_in_a_file_and_si_numbers_in_data_mean_the_same(tmp_path: Path) -> None:
    text = "world: empty\nvehicles: {ego: {model: bolt, speed: 36 km/h}}\nduration: 1 min\n"
    (tmp_path / "fast.yaml").write_text(text, encoding="utf-8")
    data = {"world": "empty", "vehicles": {"ego": {"model": "bolt", "speed": 10.0}}, "duration": 60.0, "name": "fast"}
    assert mir.load_diagram(str(tmp_path / "fast.yaml")) == make_spec(data)


def test_building_a_diagram_leaves_its_spec_alone() -> None:
    spec = make_spec(drive(systems={"wave": {"kind": "sine", "frequency": 1.0}}))
    before = spec.model_dump()
    simulate(spec, duration=0.1)
    assert spec.model_dump() == before


def test_data_given_to_a_diagram_are_left_alone() -> None:
    data = drive()
    mir.make_diagram(data)
    assert data == drive()


def test_a_world_beside_the_diagram_file_is_found_from_any_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "field.yaml").write_text("mirdrake: world/1\nname: field\n", encoding="utf-8")
    (tmp_path / "mine" / "drive.yaml").write_text(
        "world: field.yaml\nvehicles: {ego: {model: bolt}}\n", encoding="utf-8"
    )
    monkeypatch.chdir(tmp_path)
    spec = mir.load_diagram("mine/drive.yaml")
    assert spec.world.name == str(tmp_path / "mine" / "field.yaml")
    assert assemble(spec).parts.world.name == "field"


# --- an ordinary Drake diagram ----------------------------------------------------------------------------------------


def test_a_diagram_has_named_ports_and_systems() -> None:
    diagram = mir.make_diagram(drive())
    assert diagram.get_name() == "diagram"
    assert port_names(diagram) == ([], ["ego.state"])
    names = {system.get_name() for system in diagram.GetSystems()}
    assert {"plant", "scene_graph", "ego.driver", "ego.control", "ego.truth", "wheel_readings", "ego.tyres"} <= names


def test_a_plain_drake_simulator_steps_a_diagram() -> None:
    diagram = mir.make_diagram(drive())
    simulator = Simulator(diagram)
    simulator.AdvanceTo(2.0)
    state = diagram.GetOutputPort("ego.state").Eval(simulator.get_context())
    assert state[6] > 2.0  # vx [m/s], accelerating at 1.5 m/s² or more
    assert state[5] > 0.0  # yaw [rad], to the left


def test_a_vehicle_without_driver_obeys_the_inputs_of_the_diagram() -> None:
    diagram = mir.make_diagram(drive(control={}))
    assert port_names(diagram)[0] == ["ego.speed_reference", "ego.steering_reference", "ego.reference_stamp"]
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    for port, value in (("speed_reference", 2.0), ("steering_reference", -0.2), ("reference_stamp", 0.0)):
        diagram.GetInputPort(f"ego.{port}").FixValue(context, [value])
    stamp = diagram.GetInputPort("ego.reference_stamp")
    for tenth in range(20):  # a message every 0.1 s keeps the dead-man of 0.2 s awake
        stamp.FixValue(context, [0.1 * tenth])
        simulator.AdvanceTo(0.1 * (tenth + 1))
    state = diagram.GetOutputPort("ego.state").Eval(context)
    assert 1.0 < state[6] < 2.5  # [m/s]
    assert state[5] < -0.01  # [rad], to the right


def test_a_vehicle_whose_messages_stop_is_stopped_by_the_dead_man() -> None:
    diagram = mir.make_diagram(drive(control={}, vehicles={"ego": {"model": "bolt", "speed": 2.0}}))
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    for port, value in (("speed_reference", 2.0), ("steering_reference", 0.0), ("reference_stamp", 0.0)):
        diagram.GetInputPort(f"ego.{port}").FixValue(context, [value])
    simulator.AdvanceTo(4.0)
    assert abs(diagram.GetOutputPort("ego.state").Eval(context)[6]) < 0.1


def test_two_vehicles_do_what_each_of_them_does_alone(tmp_path: Path) -> None:
    world = "mirdrake: world/1\nname: two\nstart: {left: {at: [0, 20], yaw: 0}, right: {at: [0, -20], yaw: 90 deg}}\n"
    (tmp_path / "two.yaml").write_text(world, encoding="utf-8")
    vehicles = {"one": {"model": "bolt", "start": "left"}, "two": {"model": "bolt", "start": "right"}}
    control: dict[str, dict[str, Any]] = {
        "one": {"kind": "constant", "speed": 2.0, "steering": 0.3},
        "two": {"kind": "constant", "speed": 4.0, "steering": -0.1},
    }

    def run(*names: str) -> mir.Run:
        chosen = {name: vehicles[name] for name in names}
        drivers = {name: control[name] for name in names}
        return simulate(drive(world=str(tmp_path / "two.yaml"), vehicles=chosen, control=drivers))

    both = run("one", "two")
    for name in vehicles:
        alone = run(name)
        # One solver iterates until both cars are done; 0.01 N m is one in 10^5 of the torque.
        for signal, tolerance in {"x": 1e-6, "yaw": 1e-6, "vx": 1e-6, "wheel_torque.front_left": 0.01}.items():
            values, expected = both[f"{name}.{signal}"], alone[f"{name}.{signal}"]
            np.testing.assert_allclose(values, expected, rtol=0.0, atol=tolerance, err_msg=signal)


def test_two_vehicles_at_the_same_position_are_rejected() -> None:
    vehicles = {"one": {"model": "bolt"}, "two": {"model": "bolt"}}
    with pytest.raises(ConfigError, match=r"vehicles\.two\.start: .*'one'"):
        mir.make_diagram(drive(vehicles=vehicles, control={}))


# --- blocks of the user's ---------------------------------------------------------------------------------------------


@pytest.fixture
def own_drive(tmp_path: Path) -> Path:
    """Return a diagram file with a user block beside it, outside the working directory."""
    (tmp_path / "own_blocks.py").write_text(OWN_BLOCKS.format(gain=1.0), encoding="utf-8")
    (tmp_path / "own.yaml").write_text(OWN_DRIVE, encoding="utf-8")
    return tmp_path / "own.yaml"


def test_a_gain_of_one_in_the_steering_line_changes_nothing(own_drive: Path) -> None:
    with_block = simulate(str(own_drive))
    without = simulate(mir.load_diagram(str(own_drive)).model_copy(update={"systems": {}, "connect": []}))
    assert set(with_block.signals) - set(without.signals) == {"scale.y"}
    for name in map(str, without.signals):
        np.testing.assert_allclose(with_block[name], without[name], rtol=0.0, atol=1e-12, err_msg=name)


def test_the_parameters_of_a_user_block_are_data(own_drive: Path) -> None:
    run = simulate(mir.load_diagram(str(own_drive), overrides=["systems.scale.gain=0.5"]))
    assert run.units["scale.y"] == "rad"
    assert run["scale.y"].iloc[-1] == 0.1
    assert math.isclose(run["ego.steering_setpoint"].iloc[-1], 0.1, abs_tol=1e-9)


def test_a_user_block_is_restored_from_plain_data_alone(own_drive: Path, tmp_path: Path) -> None:
    data = mir.load_diagram(str(own_drive)).model_dump(mode="json")
    assert data["folder"] == str(tmp_path)
    assert simulate(data, duration=0.2)["scale.y"].iloc[-1] == 0.2


def test_user_blocks_of_the_same_name_in_two_folders_are_distinct(own_drive: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    (other / "own_blocks.py").write_text(OWN_BLOCKS.format(gain=0.5), encoding="utf-8")
    shutil.copy(own_drive, other)
    first, second = simulate(str(own_drive), duration=0.2), simulate(str(other / "own.yaml"), duration=0.2)
    assert (first["scale.y"].iloc[-1], second["scale.y"].iloc[-1]) == (0.2, 0.1)
    assert first.summary["spec_sha256"] != second.summary["spec_sha256"]


def test_library_blocks_compute_what_their_names_state() -> None:
    systems = {
        "half": {"kind": "constant", "value": [0.5]},
        "wave": {"kind": "sine", "amplitude": 2.0, "frequency": 1.0, "phase": math.pi / 2.0},
        "twice": {"kind": "gain", "gain": 2.0},
        "sum": {"kind": "adder"},
        "cut": {"kind": "saturation", "minimum": -1.0, "maximum": 1.0},
        "slow": {"kind": "low_pass", "time_constant": 0.5},
        "late": {"kind": "delay", "delay": 0.2, "period": 0.02},
        "held": {"kind": "hold", "period": 0.5},
        "loop": {"kind": "pid", "kp": 3.0, "ki": 2.0, "period": 0.02},
    }
    connect = [
        ["half.y", "twice.u"],
        ["half.y", "sum.u0"],
        ["wave.y0", "sum.u1"],
        ["wave.y0", "cut.u"],
        ["half.y", "slow.u"],
        ["wave.y0", "late.u"],
        ["wave.y0", "held.u"],
        ["half.y", "loop.reference"],
        ["slow.y", "loop.measurement"],
    ]
    run = simulate(drive(systems=systems, connect=connect))
    t = run.signals.index.to_numpy()
    wave = 2.0 * np.cos(2.0 * np.pi * t)
    outputs = {name: f"{name}.y" for name in systems} | {"wave": "wave.y0", "sum": "sum.sum", "loop": "loop.control"}
    by_system = {name: run[output].to_numpy() for name, output in outputs.items()}
    np.testing.assert_allclose(by_system["wave"], wave, atol=1e-9)
    np.testing.assert_allclose(by_system["twice"], 1.0)
    np.testing.assert_allclose(by_system["sum"], 0.5 + wave, atol=1e-9)
    np.testing.assert_allclose(by_system["cut"], np.clip(wave, -1.0, 1.0), atol=1e-9)
    np.testing.assert_allclose(by_system["slow"], 0.5 * (1.0 - np.exp(-t / 0.5)), atol=1e-3)
    np.testing.assert_allclose(by_system["late"][11:], wave[:-11], atol=0.3)  # 0.2 s and up to one sample
    assert len(np.unique(by_system["held"].round(9))) <= 5
    assert by_system["loop"][1] > 1.0  # 3 · 0.5 at first


def test_a_user_block_may_replace_the_driver() -> None:
    systems = {
        "speed": {"kind": "constant", "value": [2.0]},
        "wave": {"kind": "sine", "frequency": 0.5, "amplitude": 0.1},
    }
    connect = [["speed.y", "ego.speed_reference"], ["wave.y0", "ego.steering_reference"]]
    run = simulate(drive(systems=systems, connect=connect, duration=3.0))
    assert math.isclose(run["ego.speed_setpoint"].iloc[-1], 2.0, abs_tol=1e-6)
    assert 0.09 < run["ego.steering_setpoint"].max() <= 0.1


def test_outputs_that_nothing_reads_are_named() -> None:
    assert assemble(drive(systems={"wave": {"kind": "sine", "frequency": 1.0}})).unread == (
        "wave.y0",
        "wave.y1",
        "wave.y2",
    )


# --- the drawing ------------------------------------------------------------------------------------------------------


def test_the_drawing_leads_from_driver_to_control_to_plant(own_drive: Path) -> None:
    text = write_dot(assemble(str(own_drive)))
    for arrow in ('"ego.driver" -> "ego.split"', '"ego.split" -> "scale"', '"scale" -> "ego.join"'):
        assert arrow in text
    assert '"ego.join" -> "ego.control"' in text
    assert '"ego.control" -> "ego.set_points" [label="desired_state"]' in text
    assert '"ego.control" -> "ego.actuation"' in text
    assert 'subgraph "cluster_ego"' in text
    assert "log/" not in text


def test_the_drawing_shows_inputs_that_are_left_to_the_user() -> None:
    assert '"in/ego.speed_reference" -> "ego.join"' in write_dot(assemble(drive(control={})))


@pytest.mark.skipif(layout_command() is None, reason="Graphviz is not installed")
def test_the_drawing_is_an_svg_picture_with_every_block() -> None:
    svg = draw_svg(assemble("bolt_test_track"))
    assert svg.startswith("<svg")
    for word in ("driver", "PathTracker", "control", "plant", "MultibodyPlant", "wheel_readings"):
        assert word in svg


@pytest.mark.skipif(layout_command() is None, reason="Graphviz is not installed")
@pytest.mark.parametrize(("expand", "widest"), [((), 750), (("ego.control",), 1150)])
def test_a_drawing_fits_the_width_of_a_page(expand: tuple[str, ...], widest: float) -> None:
    """In points at full size; the expanded drawing of a row from left to right had 3365."""
    svg = draw_svg(assemble("bolt_test_track", expand=bool(expand)), expand=expand)

    def size(text: str) -> list[float]:
        found = re.search(r'width="(\d+)pt" height="(\d+)pt"', text)
        assert found is not None
        return [float(number) for number in found.groups()]

    width, height = size(svg)
    assert width < widest
    assert size(fit_svg(svg, widest=400.0)) == pytest.approx([400.0, 400.0 * height / width], abs=0.5)


def test_without_dot_the_package_pygraphviz_draws(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    pytest.importorskip("pygraphviz")
    monkeypatch.setenv("PATH", str(tmp_path))
    svg = run_dot('digraph { "driver" -> "plant" [label="command"]; }', purpose="a test")
    assert svg.startswith("<svg")
    assert {"driver", "plant", "command"} <= set(re.findall(r">(\w+)</text>", svg))


def test_without_graphviz_the_drawing_names_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mirdrake.assembly.drawing.layout_command", lambda: None)
    with pytest.raises(MissingDependencyError, match="mirdrake\\[drawing\\]"):
        draw_svg(assemble(drive()))


# --- elements of vectors ----------------------------------------------------------------------------------------------


def with_blocks(connect: list[list[str]], **systems: Any) -> dict[str, Any]:
    return {
        "world": "empty",
        "vehicles": {"ego": {"model": "bolt", "speed": 3.0}},
        "control": {"ego": {"kind": "constant", "speed": 3.0, "steering": 0.05}},
        "systems": systems,
        "connect": connect,
        "plant": {"contact": "point"},
        "duration": 0.3,
    }


def test_an_element_of_each_named_vector_can_be_connected() -> None:
    outputs = assemble(with_blocks([])).outputs
    named = [(port, signal.name) for port, contents in outputs.items() for signal in contents or ()]
    assert {port for port, _ in named} >= {"ego.state", "ego.status", "ego.command", "ego.speed_command"}
    gains = {f"gain{index}": {"kind": "gain", "gain": 1.0} for index in range(len(named))}
    connect = [[f"{port}.{name}", f"gain{index}.u"] for index, (port, name) in enumerate(named)]
    run = simulate(with_blocks(connect, **gains))
    for name in ("x", "vx", "wz"):
        index = named.index(("ego.state", name))
        gain = next(column for column in map(str, run.signals) if column.startswith(f"gain{index}."))
        assert run.signals[gain].to_numpy() == pytest.approx(run.signals[f"ego.{name}"].to_numpy(), abs=1e-9), name


def test_an_element_of_an_input_is_fed_and_the_others_keep_their_default() -> None:
    spec = with_blocks([["foot.y", "ego.pedals_reference.throttle"]], foot={"kind": "constant", "value": [0.5]})
    spec["vehicles"]["ego"]["model"] = "bolt@handling"
    run = simulate(spec)
    plain = simulate(spec | {"connect": [], "systems": {}})
    assert run.signals["ego.vx"].iloc[-1] > plain.signals["ego.vx"].iloc[-1]


@pytest.mark.parametrize(
    ("pair", "text"),
    [
        (["ego.state.vxx", "notch.u"], r"'ego.state' has no element 'vxx'; its elements: x \[m\], y \[m\], .*wz"),
        (["ego.joint_torques.left", "notch.u"], "the elements of 'ego.joint_torques' have no names"),
        (["ego.state", "notch.u"], "'ego.state' has .* elements, 'notch.u' takes 1; connect one of them, as"),
        (["ego.stat", "notch.u"], "unknown output 'ego.stat'; did you mean 'ego.stat.*outputs of 'ego': .*ego.status"),
        (["ego.state.vx", "ego.steering_reference"], "gives vx in m/s, .* takes .* in rad"),
        (["notch.y", "ego.state.vx"], "'ego.state.vx' is an output; write it first"),
    ],
)
def test_a_fault_of_an_element_is_a_one_line_error(pair: list[str], text: str) -> None:
    with pytest.raises(ConfigError, match=text) as error:
        assemble(with_blocks([pair], notch={"kind": "gain", "gain": 1.0}))
    assert "\n" not in str(error.value)


def test_the_line_that_adds_a_mounted_sensor_is_named() -> None:
    spec = with_blocks([["ego.front_lidar", "notch.u"]], notch={"kind": "gain", "gain": 1.0}) | {
        "sensors": {"ego": ["imu"]}
    }
    with pytest.raises(ConfigError, match=r"'front_lidar' is mounted .*; write `sensors: {ego: \[imu, front_lidar\]}`"):
        assemble(spec)


def test_a_port_and_an_element_of_it_are_not_both_fed() -> None:
    foot = {"kind": "constant", "value": [0.5]}
    feet = {"kind": "constant", "value": [0.5, 0.0, 1.0]}
    pairs = [["feet.y", "ego.pedals_reference"], ["foot.y", "ego.pedals_reference.throttle"]]
    for connect in (pairs, pairs[::-1], [pairs[1], pairs[1]]):
        spec = with_blocks(connect, foot=foot, feet=feet)
        spec["vehicles"]["ego"]["model"] = "bolt@handling"
        with pytest.raises(ConfigError, match="is already fed by"):
            assemble(spec)


def test_draw_lists_all_ports_with_their_elements(capsys: pytest.CaptureFixture[str]) -> None:
    assert mir_main(["ports", "bolt_test_track"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) < 1500  # front_lidar has 181 beams
    known = assemble("bolt_test_track")
    for ports in (known.outputs, known.inputs):
        for port in ports:
            assert any(line.split()[0] == port for line in lines if line.strip()), port
    assert any("ego.state " in line and "vx [m/s]" in line for line in lines)
