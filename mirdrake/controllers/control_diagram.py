"""The control unit of a vehicle as a Diagram of blocks, with the same ports, numbers and bits as the fused unit.

::

    command ─ dead_man ┬ acceleration_limit ┬ speed_pid ─ wheel_speeds ─ wheel_loops ───────┬ actuators ─► desired_state
                       │                    └ (or) pedal_loop ──────────────────────────────┤              actuation
                       └ steering_rate_limit ─ steering_actuator ─ ackermann ┬ left_steering_loop          status
                                                                             └ right_steering_loop         pedals
    plant_state ─ measurements ─ (to all that measure)

:func:`expand_control` makes it from a :class:`~mirdrake.controllers.VehicleControl`. A block can be replaced by another
system, left out (then what it gave is an input), or disconnected at single inputs.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from pydrake.systems.framework import Diagram, DiagramBuilder, InputPort, OutputPort, System
from pydrake.systems.primitives import ConstantVectorSource, Gain

from mirdrake.controllers.ackermann import AckermannSteering
from mirdrake.controllers.control_blocks import (
    AccelerationLimit,
    DeadMan,
    Measurements,
    SpeedPid,
    SteeringActuator,
    SteeringRateLimit,
    WheelSpeeds,
)
from mirdrake.controllers.joint_blocks import ActuatorHold, PedalLoop, SteeringLoop, WheelLoops
from mirdrake.controllers.vehicle_control import VehicleControl
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.pid import PidGains
from mirdrake.core.signals import Signal, copy_signals, signals_of
from mirdrake.core.vectors import COMMAND, SIDES
from mirdrake.vehicles.spec import STEERING_LOOPS

HOLD = "actuators"
"""Name of the block that samples the others; it cannot be replaced."""

Port = tuple[Any, tuple[Signal, ...] | None]


class Wire(NamedTuple):
    """A connection within the control unit.

    Attributes:
        source: output as ``block.port``.
        sink: input as ``block.port``.
        default: value of each element if a replaced block does not have the output; None: it must have it.
    """

    source: str
    sink: str
    default: float | None = None


WIRES = (
    Wire("dead_man.speed", "acceleration_limit.reference"),
    Wire("dead_man.steering", "steering_rate_limit.reference"),
    Wire("measurements.speed", "acceleration_limit.measured_speed"),
    Wire("measurements.steering", "steering_rate_limit.measured_steering"),
    Wire("steering_rate_limit.steering", "steering_actuator.reference"),
    Wire("measurements.steering", "steering_actuator.measured_steering"),
    Wire("steering_actuator.steering", "ackermann.steering"),
    Wire("acceleration_limit.speed", "speed_pid.reference"),
    Wire("measurements.speed", "speed_pid.measurement"),
    Wire("acceleration_limit.speed", "wheel_speeds.speed"),
    Wire("speed_pid.output", "wheel_speeds.correction"),
    Wire("ackermann.speed_ratios", "wheel_speeds.ratios", 1.0),
    Wire("wheel_speeds.wheel_speeds", "wheel_loops.setpoint"),
    Wire("measurements.wheel_speeds", "wheel_loops.measurement"),
    Wire("acceleration_limit.slope", "wheel_loops.slope", 0.0),
    Wire("measurements.speed", "wheel_loops.speed"),
    Wire("acceleration_limit.speed", "pedal_loop.reference"),
    Wire("acceleration_limit.slope", "pedal_loop.slope", 0.0),
    Wire("measurements.speed", "pedal_loop.measurement"),
    *(
        wire
        for side in SIDES
        for wire in (
            Wire(f"ackermann.{side}", f"{side}_steering_loop.setpoint"),
            Wire(f"measurements.{side}_angle", f"{side}_steering_loop.measurement"),
            Wire("measurements.speed", f"{side}_steering_loop.speed"),
            Wire(f"{side}_steering_loop.torque", f"{HOLD}.{side}_torque"),
            Wire(f"{side}_steering_loop.servo_setpoint", f"{HOLD}.{side}_servo"),
        )
    ),
    Wire("wheel_loops.torque", f"{HOLD}.wheel_torque"),
    Wire("wheel_loops.servo_setpoint", f"{HOLD}.wheel_servo"),
    Wire("pedal_loop.pedals", f"{HOLD}.pedals"),
    Wire("acceleration_limit.speed", f"{HOLD}.speed"),
    Wire("speed_pid.output", f"{HOLD}.correction"),
    Wire("steering_rate_limit.steering", f"{HOLD}.steering"),
    Wire("measurements.speed", f"{HOLD}.measured_speed"),
    Wire("measurements.steering", f"{HOLD}.measured_steering"),
)
"""Connections of the blocks; those of blocks and ports that a vehicle does not have are left out."""


@dataclass(frozen=True)
class ControlDiagram:
    """A control unit as a Diagram of blocks.

    Attributes:
        diagram: ports as :class:`~mirdrake.controllers.VehicleControl`, and those of all blocks as ``block.port``.
        blocks: the systems in it by name.
        outputs: outputs of the blocks as ``block.port``, with names and units; ports of the diagram.
        inputs: inputs of the blocks; ports of the diagram if they were opened, otherwise of the block.
        defaults: source of each opened input within the unit.
        open: inputs that stand for the outputs of blocks that are left out.
    """

    diagram: Diagram
    blocks: dict[str, System]
    outputs: dict[str, Port] = field(default_factory=dict)
    inputs: dict[str, Port] = field(default_factory=dict)
    defaults: list[tuple[str, str]] = field(default_factory=list)
    open: tuple[str, ...] = ()


def make_control_blocks(unit: VehicleControl) -> dict[str, System]:
    """Return the blocks of a control unit by name, with its numbers, not connected."""
    setup, law, control = unit.setup, unit.steering_law, unit.vehicle.control
    period = setup.period
    # Names are those of the signals that users connect to; each block can be replaced by one with equal ports.
    blocks: dict[str, System] = {
        "measurements": Measurements(
            unit.plant_state.size(),
            law,
            quaternion=setup.quaternion,
            velocity=setup.velocity,
            wheels=setup.wheel_velocities,
            steering=setup.steering_positions,
        ),
        "dead_man": DeadMan(period=period, limits=setup.command),
        "acceleration_limit": AccelerationLimit(setup.acceleration, setup.deceleration, period=period),
        "steering_rate_limit": SteeringRateLimit(law, period=period),
        "steering_actuator": SteeringActuator(unit.actuator),
        "ackermann": AckermannSteering(law),
    }
    for block in STEERING_LOOPS:
        blocks[block] = SteeringLoop(control.steering, period=period, limits=setup.steering_limits)
    # Pedals replace speed loop and wheel loops: the powertrain turns the wheels.
    if unit.pedal_law is not None:
        blocks["pedal_loop"] = PedalLoop(control.wheel_speed, unit.pedal_law, period=period)
        return blocks
    # In cascade: the speed loop corrects the speed from which the set-points of the wheel loops are calculated.
    gains = PidGains(control.speed.kp, control.speed.ki)
    blocks["speed_pid"] = SpeedPid(gains, period=period, limits=setup.speed_limits)
    blocks["wheel_speeds"] = WheelSpeeds(setup.radii)
    blocks["wheel_loops"] = WheelLoops(
        control.wheel_speed,
        period=period,
        torque_per_acceleration=setup.torque_per_acceleration,
        driven=setup.driven,
        limits=setup.wheel_limits,
    )
    return blocks


def expand_control(
    unit: VehicleControl,
    *,
    replaced: Mapping[str, System] | None = None,
    opened: Collection[str] = (),
) -> ControlDiagram:
    """Return a control unit as a Diagram of its blocks.

    Args:
        unit: the fused unit; it is not changed and not part of the result.
        replaced: systems in place of the blocks of these names. Their ports are those of the block by name; the only
            input and the only output may have any name.
        opened: inputs ``block.port`` that are inputs of the Diagram instead of being connected within it.

    Raises:
        ConfigError: no such block, or a system does not have the ports of the block that it replaces; the path of the
            error is the name of the block.
    """
    replaced = replaced or {}
    standard = make_control_blocks(unit)
    for block in replaced:
        if block not in standard:
            text = f"the control unit has no block '{block}' to replace; {did_you_mean(block, standard)}"
            raise ConfigError(text, path=(block,))
    absent = [block for block in unit.vehicle.control.disabled_blocks() if block in standard and block not in replaced]
    blocks = {block: replaced.get(block, own) for block, own in standard.items() if block not in absent}

    builder = DiagramBuilder()

    # Wires of this vehicle: both ends exist, or the source has a default or is left to the user.
    outputs, inputs = _ports(blocks, standard)
    wires = [wire for wire in WIRES if wire.sink in inputs or wire.sink.startswith(f"{HOLD}.")]
    wires = [wire for wire in wires if _exists(wire, outputs, standard, absent)]
    uses = [wire.sink.removeprefix(f"{HOLD}.") for wire in wires if wire.sink.startswith(f"{HOLD}.")]
    setup = unit.setup
    # One block holds all outputs for a period, as the fused unit does; so both give the same bits.
    hold = ActuatorHold(
        setup.wheel_inputs, setup.steering_inputs, actuators=unit.actuators, period=setup.period, uses=uses
    )
    blocks[HOLD] = hold
    inputs |= {f"{HOLD}.{port}": entry for port, entry in hold.inputs.items()}
    for block, system in blocks.items():
        system.set_name(block)
        builder.AddSystem(system)

    # Inputs of the whole unit.
    if "dead_man.command" in inputs:
        builder.ExportInput(inputs.pop("dead_man.command"), "command")
    else:
        # A replaced dead-man may have no command; the unit still needs the port, so an unread gain has it.
        builder.ExportInput(builder.AddNamedSystem("no_command", Gain(1.0, len(COMMAND))).get_input_port(), "command")
    builder.ExportInput(inputs.pop("measurements.plant_state"), "plant_state")

    # Connections; what an absent block gave is an input of the same name.
    defaults, exported = [], set()
    for wire in wires:
        sink = inputs[wire.sink]
        if wire.sink in opened:
            builder.ExportInput(sink, wire.sink)
            if wire.source in outputs:
                defaults.append((wire.source, wire.sink))
        elif wire.source in outputs:
            builder.Connect(outputs[wire.source], sink)
        elif wire.source.split(".")[0] in absent:
            # A diagram input exists once; later sinks of the same name are connected to it.
            if wire.source in exported:
                builder.ConnectInput(wire.source, sink)
            else:
                builder.ExportInput(sink, wire.source)
            exported.add(wire.source)
        else:
            constant = builder.AddNamedSystem(
                f"{wire.sink}.default", ConstantVectorSource([wire.default] * sink.size())
            )
            builder.Connect(constant.get_output_port(), sink)
    for source, port in outputs.items():
        builder.ExportOutput(port, source)
    own = {"desired_state": hold.desired_state, "actuation": hold.actuation, "status": hold.status}
    own |= {"pedals": hold.pedals} if "pedals" in uses else {}

    # Ports of the unit have the names that those of the fused unit have.
    for port_name, port in own.items():
        builder.ExportOutput(port, port_name)
    diagram = builder.Build()
    diagram.set_name("control")
    for port_name, port in own.items():
        # The exported port is another object than that of the block and has no names of its elements yet.
        copy_signals(port, diagram.GetOutputPort(port_name))

    given = {wire.source: (diagram.GetInputPort(wire.source), signals_of(inputs[wire.sink])) for wire in wires
             if wire.source in exported}  # fmt: skip
    return ControlDiagram(
        diagram,
        blocks,
        {source: (diagram.GetOutputPort(source), _signals(source, port, standard)) for source, port in outputs.items()},
        {
            sink: (diagram.GetInputPort(sink) if sink in opened else port, _signals(sink, port, standard))
            for sink, port in inputs.items()
        }
        | given,
        defaults,
        tuple(sorted(exported)),
    )


def _ports(
    blocks: Mapping[str, System], standard: Mapping[str, System]
) -> tuple[dict[str, OutputPort], dict[str, InputPort]]:
    """Return the ports of all blocks as ``block.port``, under the names of the blocks that they replace."""
    outputs: dict[str, OutputPort] = {}
    inputs: dict[str, InputPort] = {}
    for block, system in blocks.items():
        own_outputs = [system.get_output_port(i) for i in range(system.num_output_ports())]
        own_inputs = [system.get_input_port(i) for i in range(system.num_input_ports())]
        # The only port of a system may have any name; it takes that of the block's first port.
        first_output = standard[block].get_output_port(0).get_name()
        first_input = standard[block].get_input_port(0).get_name()
        for port in own_outputs:
            outputs[f"{block}.{first_output if len(own_outputs) == 1 else port.get_name()}"] = port
        for port in own_inputs:
            inputs[f"{block}.{first_input if len(own_inputs) == 1 else port.get_name()}"] = port
        if system is not standard[block]:
            _check_replacement(block, system, standard[block], outputs, inputs)
    return outputs, inputs


def _check_replacement(
    block: str,
    system: System,
    standard: System,
    outputs: Mapping[str, OutputPort],
    inputs: Mapping[str, InputPort],
) -> None:
    """Check the ports of a system that replaces a block.

    Raises:
        ConfigError: an output that others need is missing, it has another input, or a size is different.
    """
    known_inputs = [standard.get_input_port(i) for i in range(standard.num_input_ports())]
    known_outputs = [standard.get_output_port(i) for i in range(standard.num_output_ports())]
    kind = type(system).__name__
    for ports, known, direction in ((outputs, known_outputs, "output"), (inputs, known_inputs, "input")):
        mine = {name.split(".", 1)[1]: port for name, port in ports.items() if name.split(".", 1)[0] == block}
        theirs = {port.get_name(): port.size() for port in known}
        listed = ", ".join(f"{name} ({size})" for name, size in theirs.items())
        for name, port in mine.items():
            # Sizes are checked here, since Drake's own message would name neither block nor file.
            if name in theirs and port.size() != theirs[name]:
                raise ConfigError(
                    f"{direction} '{name}' of {kind} has {port.size()} elements; that of {block} has {theirs[name]}",
                    path=(block,),
                )
            if direction == "input" and name not in theirs:
                raise ConfigError(
                    f"{kind} in place of {block} has an unknown input '{name}'; inputs: {listed}", path=(block,)
                )
        # Outputs that no wire needs may be missing. The servo's set-point belongs only to vehicles with position
        # servos.
        needed = {
            wire.source.split(".")[1] for wire in WIRES if wire.source.split(".")[0] == block and wire.default is None
        }
        missing = sorted(needed & set(theirs) - set(mine) - {"servo_setpoint"}) if direction == "output" else []
        if missing:
            raise ConfigError(
                f"{kind} in place of {block} has no output '{missing[0]}'; outputs: {listed}", path=(block,)
            )


def _exists(wire: Wire, outputs: Mapping[str, Any], standard: Mapping[str, System], absent: Collection[str]) -> bool:
    """Return whether a vehicle has a wire: its block exists, and the output does or has a default."""
    block, port = wire.source.split(".")
    if block in absent:
        return standard[block].HasOutputPort(port) and port != "servo_setpoint"
    return wire.source in outputs or (block in standard and wire.default is not None)


def _signals(name: str, port: Any, standard: Mapping[str, System]) -> tuple[Signal, ...] | None:
    """Return names and units of a port; those of the standard block where a replacement has not declared them."""
    own = signals_of(port)
    block, _, short = name.partition(".")
    if own is not None or block not in standard:
        return own
    known = standard[block]
    if isinstance(port, OutputPort):
        return signals_of(known.GetOutputPort(short)) if known.HasOutputPort(short) else None
    return signals_of(known.GetInputPort(short)) if known.HasInputPort(short) else None
