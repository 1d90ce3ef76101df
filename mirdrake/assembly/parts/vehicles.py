"""Systems of every vehicle of a diagram: control unit, ground truth, driver, powertrain."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from pydrake.systems.framework import InputPort, OutputPort, System
from pydrake.systems.primitives import Demultiplexer, Gain, Multiplexer, PassThrough, ZeroOrderHold

from mirdrake.assembly.diagram_spec import SPLIT, DiagramSpec
from mirdrake.assembly.parts.actors import add_road_ahead
from mirdrake.assembly.parts.control import add_control, uses_machine_code
from mirdrake.assembly.wiring import JOIN, Wiring
from mirdrake.controllers.motion_tracking import MotionTracker
from mirdrake.core.errors import ConfigError
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import signals_of
from mirdrake.core.vectors import COMMAND
from mirdrake.core.yaml_io import where
from mirdrake.plant.plant import PlantParts, VehicleInPlant, solves_joints
from mirdrake.plant.powertrain import PEDALS, BatteryPack, DifferentialCoupling, Powertrain
from mirdrake.plant.rear_steering import RearSteering
from mirdrake.plant.wheels.wheel_looks import WheelPoses, add_wheel_looks
from mirdrake.sensors.ground_truth import GroundTruth
from mirdrake.sensors.range_scan import PropPoses, RangeScan
from mirdrake.vehicles.powertrain_spec import ElectricPowertrain
from mirdrake.worlds import Start
from mirdrake.worlds.tracks import Track


def _track_at(start: Start, tracks: Mapping[str, Track]) -> str | None:
    """Return the reference track of a vehicle whose driver has none: the one that it starts on or nearest to."""
    if start.track is not None or not tracks:
        return start.track
    return min(tracks, key=lambda name: abs(float(tracks[name].project(start.x, start.y)[1])))


def add_vehicle_systems(
    wiring: Wiring, parts: PlantParts, part: VehicleInPlant, spec: DiagramSpec, start: Start, *, expand: bool = False
) -> str | None:
    """Add control unit, ground truth and driver of one vehicle, and return its reference track."""
    plant, name, tracks = parts.plant, part.name, parts.world.tracks
    driver_spec = spec.control.get(name)
    # The reference track is that of the driver, else the one on which the vehicle starts.
    track = getattr(driver_spec, "track", None) or _track_at(start, tracks)
    control = add_control(wiring, parts, part, spec, expand=expand)
    truth = GroundTruth(plant, part, track=tracks.get(track or ""))
    split, join = Demultiplexer(len(COMMAND), 1), Multiplexer(len(COMMAND))
    wiring.add(f"{name}.truth", truth)
    wiring.add(f"{name}.join", join)
    wiring.link(plant.get_state_output_port(), truth.plant_state)
    set_points = _set_points(wiring, part, control)
    if solves_joints(plant):
        wiring.link(set_points, plant.get_desired_state_input_port(part.instance))
    else:
        wiring.link(set_points, wiring.systems[f"{name}.tyres"].GetInputPort("desired_state"))
    wiring.link(join.get_output_port(), control.GetInputPort("command"))
    between = (  # connections into which users insert blocks: noise of sensors, delay of actuators
        ("plant_state", plant.get_state_output_port(), "measured_state", control.GetInputPort("plant_state")),
        (
            "torque_command",
            control.GetOutputPort("actuation"),
            "torque_reference",
            _actuation(wiring, parts, part),
        ),
    )
    for source, output, sink, port in between:
        wiring.sources[f"{name}.{source}"], wiring.sinks[f"{name}.{sink}"] = (output, None), (port, None)
        wiring.defaults.append((f"{name}.{source}", f"{name}.{sink}"))
    # Each element of the command is an input by itself, so that a user's block can replace one of them.
    for index, (port, signal) in enumerate(zip(JOIN, COMMAND, strict=True)):
        wiring.sinks[f"{name}.{port}"] = (join.get_input_port(index), (signal,))
        wiring.aliases[f"{name}.control.{port}"] = f"{name}.{port}"
    for port in (
        *(truth.get_output_port(index) for index in range(truth.num_output_ports())),
        control.GetOutputPort("status"),
    ):
        wiring.sources[f"{name}.{port.get_name()}"] = (port, signals_of(port))
    for vector in ("state", "status"):
        wiring.name_elements(f"{name}.{vector}", name)
    wiring.sources[f"{name}.joint_torques"] = (_joint_torques(wiring, parts, part), None)
    powertrain = _add_powertrain(wiring, parts, part, control, machine_code=uses_machine_code(spec, part))
    if part.vehicle.spec.steering.rear is not None:
        _add_rear_steering(wiring, parts, part, powertrain)

    place = where(spec, "control", name)
    if f"{name}.motion" in wiring.sources:  # a full vehicle among the actors of the world
        driver: LeafSystem = MotionTracker(part.vehicle.geometry)
    elif driver_spec is not None:
        folder = Path(spec.folder) if spec.folder is not None else None
        driver = driver_spec.make_system(part.vehicle, parts.world, where=place, folder=folder)
    else:  # a diagram without a driver is driven by signals of the user
        return track
    wiring.add(f"{name}.driver", driver)
    # Sensors of drivers exist only where a driver reads them.
    if driver.HasInputPort("ranges"):
        _add_range_scan(wiring, parts, part, truth)
    if driver.HasInputPort("road_ahead") and track is not None:
        add_road_ahead(wiring, parts, spec, name, track)
    wiring.add(f"{name}.split", split)
    wiring.link(driver.GetOutputPort("command"), split.get_input_port())
    wiring.sources[f"{name}.command"] = (driver.GetOutputPort("command"), COMMAND)
    # Command and control unit are connected element by element: a user block can replace each connection.
    for index, (port, signal) in enumerate(zip(SPLIT, COMMAND, strict=True)):
        wiring.sources[f"{name}.{port}"] = (split.get_output_port(index), (signal,))
        wiring.defaults.append((f"{name}.{port}", f"{name}.{JOIN[index]}"))
        wiring.aliases[f"{name}.driver.{port}"] = f"{name}.{port}"
    if driver.HasOutputPort("pedals"):  # the driver computes the pedal positions
        if powertrain is None:
            raise ConfigError(
                f"this driver presses pedals, but {part.vehicle.name} has none; use a vehicle with a "
                "wheel_speed of kind pedals in control.yaml, and not parked",
                where=place,
            )
        wiring.sources[f"{name}.driver_pedals"] = (driver.GetOutputPort("pedals"), PEDALS)
        # The first default of an input wins: pedals of the driver come before those of the control unit.
        wiring.defaults.insert(0, (f"{name}.driver_pedals", f"{name}.pedals_reference"))

    # Any other port of a driver has its own name; an input is fed by the vehicle's output of the same name.
    for index in range(driver.num_output_ports()):
        port = driver.get_output_port(index)
        wiring.sources.setdefault(f"{name}.{port.get_name()}", (port, signals_of(port)))
        wiring.aliases[f"{name}.driver.{port.get_name()}"] = f"{name}.{port.get_name()}"
    for index in range(driver.num_input_ports()):
        port = driver.get_input_port(index)
        wiring.sinks[f"{name}.driver_{port.get_name()}"] = (port, signals_of(port))
        if f"{name}.{port.get_name()}" in wiring.sources:
            wiring.defaults.append((f"{name}.{port.get_name()}", f"{name}.driver_{port.get_name()}"))
    return track


def _set_points(wiring: Wiring, part: VehicleInPlant, control: System) -> OutputPort:
    """Return the set-points of the servos; those of rates are adapted to the time step of the plant."""
    port: OutputPort = control.GetOutputPort("desired_state")
    if not part.rate_gains:
        return port
    gains = np.ones(port.size())
    actuators = (*part.wheel_actuators, *part.steering_actuators)
    first = min(actuator.input_start() for actuator in actuators)
    for actuator in actuators:
        gains[port.size() // 2 + actuator.input_start() - first] = part.rate_gains.get(actuator.joint().index(), 1.0)
    scaled = Gain(gains)
    wiring.add(f"{part.name}.set_points", scaled)
    wiring.link(port, scaled.get_input_port())
    return scaled.get_output_port()


def _joint_torques(wiring: Wiring, parts: PlantParts, part: VehicleInPlant) -> OutputPort:
    """Return the torques of the actuators in the last step of the plant."""
    port: OutputPort = parts.plant.get_net_actuation_output_port(part.instance)
    if not solves_joints(parts.plant):  # the tyres hold them during a step
        return port
    # A discrete plant solves them with its contact. A log reads before the control units update; for it the plant would
    # solve a step that is never taken, with the new state and the old command.
    held = ZeroOrderHold(parts.plant.time_step(), port.size())
    wiring.add(f"{part.name}.joint_torques", held)
    wiring.link(port, held.get_input_port())
    return held.get_output_port()


def _actuation(wiring: Wiring, parts: PlantParts, part: VehicleInPlant) -> InputPort:
    """Return the input of the torques of the actuators; the tyres, which predict the spin, get them as well."""
    port = parts.plant.get_actuation_input_port(part.instance)
    tyres = wiring.systems[f"{part.name}.tyres"]
    if not solves_joints(parts.plant):
        wiring.link(tyres.GetOutputPort("net_actuation"), port)
        actuation: InputPort = tyres.actuation
        return actuation
    # The input of the plant and that of the tyres must get the same torques, also if the user replaces them.
    split = PassThrough(port.size())
    wiring.add(f"{part.name}.actuation", split)
    wiring.link(split.get_output_port(), port)
    wiring.link(split.get_output_port(), tyres.actuation)
    return split.get_input_port()


def _add_powertrain(
    wiring: Wiring, parts: PlantParts, part: VehicleInPlant, control: System, *, machine_code: bool
) -> Powertrain | None:
    """Add powertrain and brakes of a vehicle that is driven by pedals; the tyres take its torques."""
    name = part.name
    if not control.HasOutputPort("pedals"):
        return None
    powertrain = Powertrain(parts.plant, part, machine_code=machine_code)
    wiring.add(f"{name}.powertrain", powertrain)
    wiring.link(parts.plant.get_state_output_port(), powertrain.plant_state)
    wiring.sources[f"{name}.pedals"] = (control.GetOutputPort("pedals"), PEDALS)
    wiring.sinks[f"{name}.pedals_reference"] = (powertrain.pedals, PEDALS)
    wiring.defaults.append((f"{name}.pedals", f"{name}.pedals_reference"))
    torque = powertrain.wheel_torque
    if part.vehicle.spec.powertrain.coupled:
        coupling = DifferentialCoupling(parts.plant, part)
        wiring.add(f"{name}.differential", coupling)
        wiring.link(parts.plant.get_state_output_port(), coupling.plant_state)
        wiring.link(powertrain.wheel_torque, coupling.torque)
        torque = coupling.wheel_torque
    for port in (torque, powertrain.powertrain_status):
        wiring.sources[f"{name}.{port.get_name()}"] = (port, signals_of(port))
    motor = part.vehicle.spec.powertrain
    if isinstance(motor, ElectricPowertrain) and motor.battery is not None:
        battery = BatteryPack(motor.battery, motor.losses)
        wiring.add(f"{name}.battery", battery)
        wiring.link(powertrain.powertrain_status, battery.powertrain_status)
        wiring.sources[f"{name}.battery_status"] = (battery.battery_status, signals_of(battery.battery_status))
    return powertrain


def add_drawn_wheels(wiring: Wiring, parts: PlantParts, part: VehicleInPlant) -> None:
    """Add the poses of the drawn wheels of a vehicle, if they have angles that the bodies of the plant do not have."""
    looks = add_wheel_looks(parts.plant, parts.scene_graph, part)
    if looks is None:
        return
    poses = WheelPoses(looks, parts.plant)
    wiring.add(f"{part.name}.wheel_poses", poses)
    wiring.link(parts.plant.get_state_output_port(), poses.plant_state)
    wiring.link(poses.poses, parts.scene_graph.get_source_pose_port(looks.source))
    rear = wiring.systems.get(f"{part.name}.rear_steering")
    if rear is not None:
        wiring.link(rear.rear_steering, poses.rear_steering)


def _add_rear_steering(wiring: Wiring, parts: PlantParts, part: VehicleInPlant, powertrain: Powertrain | None) -> None:
    """Add the actuator of the rear steering of a vehicle, for its tyres and its stability control."""
    name, steering = part.name, RearSteering(parts.plant, part)
    wiring.add(f"{name}.rear_steering", steering)
    wiring.link(parts.plant.get_state_output_port(), steering.plant_state)
    wiring.link(steering.rear_steering, wiring.systems[f"{name}.tyres"].GetInputPort("rear_steering"))
    if powertrain is not None:
        wiring.link(steering.rear_steering, powertrain.GetInputPort("rear_steering"))
    wiring.sinks[f"{name}.rear_steering_reference"] = (steering.reference, signals_of(steering.reference))
    wiring.sources[f"{name}.rear_steering"] = (steering.rear_steering, signals_of(steering.rear_steering))
    wiring.name_elements(f"{name}.rear_steering", name)


def _add_range_scan(wiring: Wiring, parts: PlantParts, part: VehicleInPlant, truth: GroundTruth) -> None:
    """Add the ideal range scan of one vehicle, for a driver that reads it."""
    others = {name: other for name, other in parts.vehicles.items() if name != part.name}
    scan = RangeScan(
        parts.world,
        part.vehicle,
        vehicles={name: other.vehicle for name, other in others.items()},
        actors=parts.world.actors if "traffic" in wiring.systems else (),
    )
    wiring.add(f"{part.name}.scan", scan)
    wiring.link(truth.state, scan.state)
    if scan.prop_poses is not None:
        # The movable obstacles are the props, then the other vehicles; the poses must have this order.
        props = scan.movable[: len(scan.movable) - len(others)]
        bodies = [parts.props.bodies[name].index() for name in props] + [
            other.base.index() for other in others.values()
        ]
        poses = PropPoses(bodies, scan.movable)
        wiring.add(f"{part.name}.prop_poses", poses)
        wiring.link(parts.plant.get_body_poses_output_port(), poses.body_poses)
        wiring.link(poses.prop_poses, scan.prop_poses)
    if scan.actor_states is not None:
        wiring.link(wiring.systems["traffic"].GetOutputPort("states"), scan.actor_states)
    wiring.sources[f"{part.name}.ranges"] = (scan.ranges, signals_of(scan.ranges))
