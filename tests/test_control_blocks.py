"""The control unit as a Diagram of blocks: the same bits as the fused unit, and blocks that can be replaced."""

from typing import Any

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

import mirdrake as mir
from mirdrake.assembly.diagram import assemble, load_diagram, make_diagram, make_spec
from mirdrake.assembly.drawing import write_dot
from mirdrake.core.errors import ConfigError, DiagramError
from mirdrake.runs.simulation import Simulation

DRIVES = {
    "path": {"kind": "path_tracking", "track": "main", "speed": 3.0},
    "schedule": {
        "kind": "schedule",
        "rows": [
            {"time": 0.0, "speed": 2.0},
            {"time": 0.4, "speed": -1.0, "steering": 0.2},
            {"time": 0.9, "speed": 0.0},
        ],
    },
}


def spec_of(vehicle, *, contact="point", drive="path", **more):
    data = {
        "world": "test_track",
        "vehicles": {"ego": {"model": vehicle, "start": "line"}},
        "control": {"ego": DRIVES[drive]},
        "plant": {"contact": contact},
        "record": {"meshcat": False, "report": False},
    }
    return make_spec(data | more)


def assert_same_bits(spec, duration):
    fused, expanded = (Simulation(assemble(spec, expand=expand)).run(duration=duration) for expand in (False, True))
    assert list(fused.signals) == list(expanded.signals)
    different = [
        name for name in map(str, fused.signals) if not np.array_equal(fused[name], expanded[name], equal_nan=True)
    ]
    assert different == []
    assert np.ptp(fused["ego.speed_setpoint"]) > 0.5


@pytest.mark.parametrize("vehicle", ["bolt", "mkz", "catvehicle", "unior"])
def test_the_blocks_give_the_same_bits_as_the_fused_unit(vehicle):
    assert_same_bits(spec_of(vehicle, drive="schedule"), 1.2)


@pytest.mark.slow
@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("contact", ["point", "hydroelastic"])
@pytest.mark.parametrize(
    "vehicle", ["bolt", "mkz", "catvehicle", "unior", "mkz@handling", "bolt@published", "unior@printed_steering"]
)
def test_the_same_over_vehicles_contacts_and_drives(vehicle, contact, drive):
    assert_same_bits(spec_of(vehicle, contact=contact, drive=drive), 6.0)


def test_a_diagram_for_python_has_the_blocks_and_their_ports():
    control = make_diagram("bolt_test_track").GetSubsystemByName("ego.control")
    names = [system.get_name() for system in control.GetSystems()]
    assert {"dead_man", "acceleration_limit", "speed_pid", "ackermann", "wheel_loops", "left_steering_loop"} <= set(
        names
    )
    assert control.HasOutputPort("speed_pid.error")
    assert control.HasOutputPort("ackermann.left")


# --- replaced blocks ---------------------------------------------------------------------------------------------

OWN_BLOCKS = """\
from math import tan

from pydrake.systems.framework import LeafSystem


class Own(LeafSystem):
    INPUTS, OUTPUTS = {}, {}

    def __init__(self):
        super().__init__()
        self.ports = {name: self.DeclareVectorInputPort(name, size) for name, size in self.INPUTS.items()}
        for name, size in self.OUTPUTS.items():
            self.DeclareVectorOutputPort(name, size, lambda c, o, name=name: o.SetFromVector(getattr(self, name)(c)))

    def read(self, context, name):
        return self.ports[name].Eval(context).tolist()


class DeadMan(Own):
    INPUTS, OUTPUTS = {"command": 3}, {"speed": 1, "steering": 1}
    speed = lambda self, c: self.read(c, "command")[:1]
    steering = lambda self, c: self.read(c, "command")[1:2]


class Slope(Own):
    INPUTS, OUTPUTS = {"reference": 1}, {"speed": 1}
    speed = lambda self, c: [0.5 * self.read(c, "reference")[0]]


class Through(Own):
    INPUTS, OUTPUTS = {"reference": 1}, {"steering": 1}
    steering = lambda self, c: self.read(c, "reference")


class Parallel(Own):
    INPUTS, OUTPUTS = {"steering": 1}, {"left": 1, "right": 1}
    left = right = lambda self, c: self.read(c, "steering")


class Proportional(Own):
    INPUTS, OUTPUTS = {"reference": 1, "measurement": 1}, {"u": 1}
    u = lambda self, c: [0.7 * (self.read(c, "reference")[0] - self.read(c, "measurement")[0])]


class Spin(Own):
    INPUTS, OUTPUTS = {"speed": 1, "correction": 1}, {"wheel_speeds": 4}
    wheel_speeds = lambda self, c: 4 * [(self.read(c, "speed")[0] + self.read(c, "correction")[0]) / 0.3]


class Wheels(Own):
    INPUTS, OUTPUTS = {"setpoint": 4, "measurement": 4}, {"torque": 4}
    torque = lambda self, c: [2.0 * (a - b) for a, b in zip(self.read(c, "setpoint"), self.read(c, "measurement"))]


class Joint(Own):
    INPUTS, OUTPUTS = {"setpoint": 1, "measurement": 1}, {"torque": 1}
    torque = lambda self, c: [3.0 * (a - b) for a, b in zip(self.read(c, "setpoint"), self.read(c, "measurement"))]
"""

REPLACED = {
    "dead_man": "DeadMan",
    "acceleration_limit": "Slope",
    "speed_pid": "Proportional",
    "wheel_speeds": "Spin",
    "wheel_loops": "Wheels",
    "steering_rate_limit": "Through",
    "steering_actuator": "Through",
    "ackermann": "Parallel",
    "left_steering_loop": "Joint",
    "right_steering_loop": "Joint",
}


def own_blocks(folder, names):
    (folder / "own_control_blocks.py").write_text(OWN_BLOCKS, encoding="utf-8")
    return {f"ego.control.{name}": {"kind": f"own_control_blocks:{REPLACED[name]}"} for name in names}


@pytest.mark.parametrize("vehicle", ["bolt", "mkz", "catvehicle", "unior"])
def test_every_block_can_be_replaced_in_a_diagram_file(vehicle, tmp_path):
    spec = spec_of(
        vehicle,
        control={"ego": {"kind": "constant", "speed": 2.0, "steering": 0.1}},
        systems=own_blocks(tmp_path, REPLACED),
        folder=str(tmp_path),
        record={"signals": ["ego.control.**"], "meshcat": False, "report": False},
    )
    assembly = assemble(spec)
    s = {name: values.to_numpy() for name, values in Simulation(assembly).run(duration=0.1).signals.items()}
    block = "ego.control"
    assert s["ego.speed_setpoint"][1:] == pytest.approx(1.0)  # half of the command at once
    error = 1.0 - s[f"{block}.measurements.speed"]
    assert s[f"{block}.speed_pid.output"] == pytest.approx(0.7 * error)
    spin = (1.0 + 0.7 * error) / 0.3
    measured = s[f"{block}.measurements.wheel_speeds.front_left"]
    assert s[f"{block}.wheel_loops.torque.front_left"] == pytest.approx(2.0 * (spin - measured))
    limit = assembly.parts.vehicles["ego"].wheel_actuators[0].effort_limit()
    torque = np.clip(s[f"{block}.wheel_loops.torque.front_left"], -limit, limit)
    assert s["ego.wheel_torque.front_left"][1:] == pytest.approx(torque[1:])
    assert s[f"{block}.ackermann.left"] == pytest.approx(0.1)  # no limit of the rate any more
    for side in ("left", "right"):
        joint = s[f"{block}.measurements.{side}_angle"]
        assert s[f"{block}.{side}_steering_loop.torque"] == pytest.approx(3.0 * (0.1 - joint))


@pytest.mark.parametrize("vehicle", ["bolt", "mkz", "catvehicle", "unior"])
def test_every_block_can_be_replaced_in_python_with_the_same_bits(vehicle, tmp_path):
    own: dict[str, Any] = {}
    exec(OWN_BLOCKS, own)
    d = mir.Diagram("test_track", contact="point")
    ego = d.add_vehicle(vehicle, start="line")
    d.drive(ego, "constant", speed=2.0, steering=0.1)
    d.record(meshcat=False, report=False)
    for name, kind in REPLACED.items():
        d.replace(ego.control[name], own[kind])
    run = d.simulate(0.1)
    spec = spec_of(
        vehicle,
        control={"ego": {"kind": "constant", "speed": 2.0, "steering": 0.1}},
        systems=own_blocks(tmp_path, REPLACED),
        folder=str(tmp_path),
        record={"signals": ["ego.control.**"], "meshcat": False, "report": False},
    )
    file = Simulation(assemble(spec)).run(duration=0.1)
    assert [name for name in map(str, file.signals) if not np.array_equal(file[name], run[name], equal_nan=True)] == []


@pytest.mark.slow
@pytest.mark.parametrize("block", REPLACED)
@pytest.mark.parametrize("vehicle", ["bolt", "mkz", "catvehicle", "unior"])
def test_each_block_can_be_replaced_alone(vehicle, block, tmp_path):
    spec = spec_of(vehicle, systems=own_blocks(tmp_path, [block]), folder=str(tmp_path))
    standard = Simulation(assemble(spec_of(vehicle))).run(duration=0.3).signals
    run = Simulation(assemble(spec)).run(duration=0.3)
    assert run.summary["stop_reason"] == "duration"
    if block not in {"dead_man", "steering_rate_limit", "steering_actuator", "ackermann"}:  # the same on a straight
        assert not np.array_equal(standard["ego.vx"], run.signals["ego.vx"])


def test_a_block_of_drake_replaces_one_with_a_single_input_and_output():
    kind = {"kind": "pydrake.systems.primitives:FirstOrderLowPassFilter", "time_constant": 0.1, "size": 1}
    spec = spec_of("bolt", systems={"ego.control.steering_actuator": kind})
    diagram = assemble(spec).diagram
    assert diagram.GetSubsystemByName("ego.control").HasSubsystemNamed("steering_actuator")


@pytest.mark.parametrize(
    ("systems", "message"),
    [
        (
            {"ego.control.speed_pd": {"kind": "gain", "gain": 1.0}},
            "has no block 'speed_pd' to replace; did you mean 'speed_pid'",
        ),
        (
            {"eg.control.speed_pid": {"kind": "gain", "gain": 1.0}},
            "systems.eg.control.speed_pid: no vehicle 'eg', of which",
        ),
        ({"ego.control.speed_pid": {"kind": "sine", "frequency": 1.0}}, "in place of speed_pid has no output 'output'"),
        (
            {"ego.control.ackermann": {"kind": "gain", "gain": 1.0, "size": 2}},
            "output 'left' of Gain has 2 elements; that of ackermann has 1",
        ),
        (
            {"ego.control.dead_man": {"kind": "adder"}},
            "in place of dead_man has no output 'steering'; outputs: speed (1)",
        ),
        (
            {"ego.control.speed_pid": {"kind": "adder"}},
            "in place of speed_pid has an unknown input 'u0'; inputs: refer",
        ),
    ],
)
def test_an_unsuitable_replacement_of_a_block_is_a_one_line_error(systems, message):
    with pytest.raises(ConfigError) as caught:
        assemble(spec_of("bolt", systems=systems))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("entry", "fault"),
    [
        ("ego.control.speed_pd: {kind: gain, gain: 1}", "ego.control.speed_pd: the control unit has no block"),
        ("ego.control.speed_pid: {kind: adder}", "ego.control.speed_pid: Adder in place of speed_pid"),
        ("ego.control.ackermann: {kind: gain, gain: 1, size: 2}", "ego.control.ackermann: output 'left' of Gain"),
    ],
)
def test_an_unsuitable_replacement_is_reported_with_its_line(entry, fault, tmp_path):
    lines = ["world: test_track", "vehicles: {ego: {model: bolt}}", "systems:", "  other: {kind: sine, frequency: 1}"]
    (tmp_path / "own.yaml").write_text("\n".join([*lines, f"  {entry}"]) + "\n", encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        assemble(load_diagram(str(tmp_path / "own.yaml")))
    assert f"own.yaml:5: systems.{fault}" in str(caught.value)


def test_a_disabled_block_leaves_an_input_for_what_it_gave():
    vehicles = {"ego": {"model": "bolt", "start": "line", "control": {"disable": ["speed_pid"]}}}
    names = [port for port in assemble(spec_of("bolt", vehicles=vehicles)).inputs if "speed_pid" in port]
    assert names == ["ego.control.speed_pid.output"]
    own = {"systems": {"trim": {"kind": "constant", "value": [0.25]}}}
    connect = {"connect": [["trim.y", "ego.control.speed_pid.output"]]}
    run = Simulation(assemble(spec_of("bolt", vehicles=vehicles, **own, **connect))).run(duration=0.1)
    assert run["ego.speed_trim"].iloc[-1] == pytest.approx(0.25)


@pytest.mark.parametrize("vehicle", ["bolt", "unior"])
def test_external_loops_take_torques_from_the_diagram(vehicle):
    control = {"wheel_speed": {"kind": "external"}, "steering": {"kind": "external"}}
    spec = spec_of(
        vehicle,
        vehicles={"ego": {"model": vehicle, "start": "line", "control": control}},
        systems={
            "drive": {"kind": "constant", "value": [0.0, 0.0, 0.5, 0.25]},
            "left": {"kind": "constant", "value": [0.1]},
            "right": {"kind": "constant", "value": [0.2]},
        },
        connect=[
            ["drive.y", "ego.control.wheel_loops.torque"],
            ["left.y", "ego.control.left_steering_loop.torque"],
            ["right.y", "ego.control.right_steering_loop.torque"],
        ],
    )
    run = Simulation(assemble(spec)).run(duration=0.1)
    assert run["ego.wheel_torque.rear_left"].iloc[-1] == pytest.approx(0.5)
    assert run["ego.wheel_torque.rear_right"].iloc[-1] == pytest.approx(0.25)


@pytest.mark.parametrize("vehicle", ["bolt", "mkz", "catvehicle", "unior"])
def test_a_disabled_steering_loop_takes_a_torque_and_leaves_the_other_alone(vehicle):
    vehicles = {"ego": {"model": vehicle, "start": "line", "control": {"disable": ["left_steering_loop"]}}}
    spec = spec_of(
        vehicle,
        vehicles=vehicles,
        systems={"own": {"kind": "constant", "value": [0.5]}},
        connect=[["own.y", "ego.control.left_steering_loop.torque"]],
    )
    ends = []
    for assembly in (assemble(spec_of(vehicle)), assemble(spec)):
        simulator = Simulator(assembly.diagram, assembly.make_context())
        simulator.AdvanceTo(0.1)
        (part,) = assembly.parts.vehicles.values()
        context = assembly.parts.plant.GetMyContextFromRoot(simulator.get_context())
        torques = assembly.parts.plant.get_net_actuation_output_port(part.instance).Eval(context)
        first = min(actuator.input_start() for actuator in (*part.wheel_actuators, *part.steering_actuators))
        left, right = part.steering
        torque = torques[part.steering_actuators[0].input_start() - first]
        ends.append((torque, left.get_angle(context), right.get_angle(context)))
    (_, left, right), (torque, free, held) = ends
    assert torque == pytest.approx(0.5)  # without Drake's servo
    # The free wheel turns the car a little, whose tyres then turn the held one against its servo.
    assert held == pytest.approx(right, abs=2e-3)
    assert abs(free - left) > 10.0 * abs(held - right)


# --- ports and signals -------------------------------------------------------------------------------------------


def test_inner_signals_are_recorded_as_the_actuators_sample_them():
    record = {"signals": ["ego.control.acceleration_limit.*", "ego.control.*_pid.*"], "meshcat": False, "report": False}
    run = Simulation(assemble(spec_of("unior", record=record))).run(duration=0.3)
    assert np.array_equal(run["ego.control.acceleration_limit.speed"], run["ego.speed_setpoint"])
    assert run.units["ego.control.acceleration_limit.slope"] == "m/s²"
    assert "ego.control.speed_pid.integral" in run.signals


@pytest.mark.parametrize(
    ("pattern", "inner"),
    [("*.speed_pid.*", True), ("ego*", True), ("*_pid.error", True), ("*.vx", False)],
)
def test_a_pattern_expands_the_unit_if_it_chooses_one_of_its_signals(pattern, inner):
    record = {"signals": [pattern], "meshcat": False, "report": False}
    diagram = {"vehicles": {"ego": {"model": "bolt"}}, "world": "empty", "plant": {"contact": "point"}}
    taps = assemble(make_spec(diagram | {"record": record})).taps
    names = [signal.name for signal in taps["ego.control"].contents or ()] if "ego.control" in taps else []
    assert ("ego.control.speed_pid.error" in names) == inner


def test_a_pattern_without_a_signal_is_reported_with_the_nearest():
    record = {"signals": ["ego.control.speedpid.error"]}
    with pytest.raises(
        ConfigError, match=r"no signal matches 'ego.control.speedpid.error'; did you mean 'ego.control.sp"
    ):
        assemble(spec_of("bolt", record=record))


def test_a_connection_to_an_inner_input_replaces_the_built_in_one():
    spec = spec_of(
        "bolt",
        systems={"gain": {"kind": "gain", "gain": 0.0}},
        connect=[["ego.control.speed_pid.output", "gain.u"], ["gain.y", "ego.control.wheel_speeds.correction"]],
        record={"signals": ["ego.control.wheel_speeds.**", "ego.control.speed_pid.output"]},
    )
    run = Simulation(assemble(spec)).run(duration=0.2)
    # free rolling at the set-point: the trim does not reach the wheels
    spin = run["ego.control.wheel_speeds.wheel_speeds.rear_left"] / run["ego.speed_setpoint"]
    assert np.ptp(spin.to_numpy()[3:]) == pytest.approx(0.0, abs=1e-9)
    assert run["ego.control.speed_pid.output"].abs().max() > 0.0


def test_an_algebraic_loop_through_the_blocks_is_one_line():
    spec = spec_of(
        "bolt",
        systems={"gain": {"kind": "gain", "gain": 1.0}},
        connect=[["ego.control.speed_pid.output", "gain.u"], ["gain.y", "ego.control.speed_pid.measurement"]],
    )
    with pytest.raises(DiagramError, match="algebraic loop") as caught:
        assemble(spec)
    assert "\n" not in str(caught.value)


def test_short_names_are_ports():
    spec = spec_of("bolt", systems={"twice": {"kind": "gain", "gain": 2.0}}, connect=[["ego.vx", "twice.u"]])
    run = Simulation(assemble(spec)).run(duration=0.1)
    assert run["twice.y"].to_numpy() == pytest.approx(2.0 * run["ego.vx"].to_numpy())


def test_the_drawing_shows_the_blocks_of_a_control_unit():
    text = write_dot(assemble("bolt_test_track", expand=True), expand=["ego.control"])
    assert '"ego.join" -> "ego.control.dead_man"' in text
    assert '"ego.control.speed_pid" -> "ego.control.wheel_speeds"' in text
    assert '"ego.control.actuators" -> "ego.set_points"' in text
    assert '"ego.set_points" -> "ego.tyres"' in text
    with pytest.raises(ConfigError, match=r"'ego.truth' has no blocks to draw; these have: ego.tyres, ego.control"):
        write_dot(assemble("bolt_test_track", expand=True), expand=["ego.truth"])
