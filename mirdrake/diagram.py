"""From a diagram spec to a Drake Diagram: make the systems, wire them by name, check the wiring.

Every subsystem is named ``<vehicle>.<part>`` or as the user called it, every port can be reached as
``<vehicle>.<port>`` or ``<system>.<port>``. Per vehicle the chain is

::

    ego.driver ─ ego.command ─ ego.split ─ ego.speed_command    ─► ego.speed_reference    ─ ego.join ─ ego.control
                                           ego.steering_command ─► ego.steering_reference
                                           ego.command_stamp    ─► ego.reference_stamp

and a connection of the user's to an input replaces the one drawn here. A vehicle that is driven by pedals also has
``ego.pedals ─► ego.pedals_reference ─ ego.powertrain``; a driver with an output ``pedals`` presses them itself. Sensors
are ``<vehicle>.<sensor>``, and so is what they measure; a camera's pictures are ``<vehicle>.<sensor>.color_image``.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations
from math import hypot
from pathlib import Path
from typing import Any

from pydrake.geometry import Meshcat, MeshcatVisualizer, MeshcatVisualizerParams
from pydrake.systems.framework import Diagram, DiagramBuilder, OutputPort, PortDataType, System
from pydrake.systems.primitives import Adder, Demultiplexer, Multiplexer, VectorLogSink

from mirdrake.aerodynamics import AirForces, feels_air
from mirdrake.blocks import make_block
from mirdrake.controllers import VehicleControl
from mirdrake.controllers.drivers import OwnDriverSpec
from mirdrake.controllers.vectors import COMMAND
from mirdrake.diagram_spec import DiagramSpec, Place, load_diagram, make_spec
from mirdrake.errors import ConfigError, DiagramError, did_you_mean
from mirdrake.perception import add_cloud_overlays
from mirdrake.plant import PlantParts, VehicleInPlant, make_plant, set_start
from mirdrake.powertrain import PEDALS, Powertrain
from mirdrake.sensors import SENSORS, Camera, GroundTruth, Lidar, make_sensor, sensor_feeds
from mirdrake.sensors.range_scan import PropPoses, RangeScan
from mirdrake.signals import Signal, signals_of
from mirdrake.suspension import make_anti_roll
from mirdrake.tyres import LOAD_PERIOD, RollingResistance, WheelTyres, make_rolling_wheels, make_wheel_tyres
from mirdrake.vehicles import Vehicle, load_vehicle
from mirdrake.vehicles.mounts import PictureMount, change_mounts
from mirdrake.wiring import JOIN, SPLIT, Wiring
from mirdrake.worlds import Start
from mirdrake.worlds.tracks import Track
from mirdrake.yaml_io import Source, where

__all__ = ["Assembly", "DiagramSpec", "Tap", "assemble", "load_diagram", "make_diagram", "make_spec"]


@dataclass(frozen=True)
class Tap:
    """A vector that is logged.

    Attributes:
        name: what it is, for example "ego.status".
        sink: the log in the diagram.
        contents: names and units of its elements, or None where the system did not say.
    """

    name: str
    sink: VectorLogSink
    contents: tuple[Signal, ...] | None


@dataclass(frozen=True)
class Assembly:
    """A built diagram with what is needed to run it and to read its logs.

    Attributes:
        spec: what it was made from.
        diagram: the Drake Diagram.
        parts: plant, world and vehicles.
        starts: where each vehicle starts.
        taps: the logged vectors.
        tracks: track that each vehicle follows or is measured against; None in a world without tracks.
        unread: outputs that nothing reads, by name.
        visualizer: draws in Meshcat, if a Meshcat was given.
        cameras: those whose pictures shall be recorded, by name, and the name of their vehicle.
        arrays: sensors whose samples are arrays and shall be recorded, by name.
        tyres: tyre models of the vehicles that have one, by name of the vehicle.
    """

    spec: DiagramSpec
    diagram: Diagram
    parts: PlantParts
    starts: dict[str, Start]
    taps: dict[str, Tap]
    tracks: dict[str, str | None]
    unread: tuple[str, ...] = ()
    visualizer: MeshcatVisualizer | None = None
    cameras: dict[str, tuple[Camera, str]] = field(default_factory=dict)
    arrays: dict[str, System] = field(default_factory=dict)
    tyres: dict[str, WheelTyres] = field(default_factory=dict)

    def own_systems(self) -> dict[str, System]:
        """The user's own systems, those written as ``module:Class``, by name."""
        own = {name for name, entry in self.spec.systems.items() if ":" in entry.kind}
        return {system.get_name(): system for system in self.diagram.GetSystems() if system.get_name() in own}

    def make_context(self) -> Any:
        """A new Context with every vehicle at its start."""
        context = self.diagram.CreateDefaultContext()
        plant = self.parts.plant
        plant_context = plant.GetMyMutableContextFromRoot(context)
        for name, part in self.parts.vehicles.items():
            start = self.starts[name]
            set_start(plant, plant_context, part, x=start.x, y=start.y, yaw=start.yaw, speed=start.speed)
        self.parts.props.reset(plant, plant_context)
        return context


def make_diagram(spec: DiagramSpec | Mapping[str, Any] | str, *, meshcat: Meshcat | None = None) -> Diagram:
    """An ordinary Drake Diagram from a diagram spec, its data or its name.

    A vehicle without an entry under ``control`` gets its ports exported as inputs ``<name>.speed_reference`` [m/s],
    ``<name>.steering_reference`` [rad] and ``<name>.reference_stamp`` [s]; the state of every vehicle is exported as
    output ``<name>.state``, and so are its sensors. A camera whose pictures nothing reads or records is left out, as
    rendering takes longer than all the rest.

    Raises:
        ConfigError, ModelError, WorldError, DiagramError: what is wrong, on one line each.
    """
    return assemble(spec, meshcat=meshcat).diagram


def assemble(spec: DiagramSpec | Mapping[str, Any] | str, *, meshcat: Meshcat | None = None) -> Assembly:
    """The same as :func:`make_diagram`, with the handles that a run needs."""
    if isinstance(spec, str):
        spec = load_diagram(spec)
    elif isinstance(spec, Mapping):
        spec = make_spec(spec)

    # World and vehicles.
    world = spec.world.load(where=where(spec, "world"))
    vehicles = {name: _load(spec, name) for name in spec.vehicles}
    starts = {name: _start(spec, name, world) for name in spec.vehicles}
    _check_starts(spec, vehicles, starts)
    for key in ("control", "sensors"):
        for name in getattr(spec, key):
            if name not in vehicles:
                raise ConfigError(f"{where(spec, key, name)}: no vehicle '{name}'; {did_you_mean(name, vehicles)}")
    _check_sensors(spec, vehicles)

    # The plant, and per vehicle its control unit, driver, ground truth and sensors.
    builder = DiagramBuilder()
    parked = {name for name, entry in spec.vehicles.items() if entry.parked}
    parts = make_plant(builder, world, vehicles, spec=spec.plant, parked=parked)
    wiring = Wiring(builder, spec)
    rolling = _add_rolling_resistance(wiring, parts, spec)
    tracks = {}
    for part in parts.vehicles.values():
        tracks[part.name] = _add_vehicle_systems(wiring, parts, part, spec, starts[part.name])
        _add_sensors(wiring, parts, part, spec)
    tyres = _add_tyres(wiring, parts, rolling)
    _add_outer_forces(wiring, parts, rolling, spec)

    # The user's own blocks, then all connections.
    folder = Path(spec.folder) if spec.folder is not None else None
    for name, entry in spec.systems.items():
        source = entry._source or Source("diagram", {}, ("systems", name))
        wiring.add(name, make_block(entry.kind, entry.parameters(), source=source, folder=folder))
    wiring.connect()

    visualizer = None
    if meshcat is not None:
        params = MeshcatVisualizerParams(publish_period=1.0 / 32.0, delete_on_initialization_event=False)
        visualizer = MeshcatVisualizer.AddToBuilder(builder, parts.scene_graph, meshcat, params)
        lidars = {name: system for name, system in wiring.systems.items() if isinstance(system, Lidar)}
        add_cloud_overlays(builder, meshcat, lidars)
    taps = _add_taps(wiring, parts, rolling, spec) if spec.record.signals else {}
    unread = wiring.export(parts)
    idle = [f"{vehicle}.{sensor}" for vehicle, sensor in _cameras(spec, vehicles)]
    unread = (*unread, *(f"{name}.color_image" for name in idle if name not in wiring.systems))
    try:
        diagram = builder.Build()
    except RuntimeError as error:
        raise DiagramError(f"{where(spec, 'connect')}: {_build_fault(error)}") from None
    diagram.set_name(spec.name)
    cameras = {
        f"{vehicle}.{sensor}": (wiring.systems[f"{vehicle}.{sensor}"], vehicle)
        for vehicle, sensor in _cameras(spec, vehicles)
        if spec.record.cameras
    }
    arrays = {
        name: wiring.systems[name]
        for name in _sensors(spec)
        if spec.record.arrays and _records(wiring, name) == "array"
    }
    return Assembly(spec, diagram, parts, starts, taps, tracks, unread, visualizer, cameras, arrays, tyres)


# --- the parts ---------------------------------------------------------------------------------------------------


def _load(spec: DiagramSpec, name: str) -> Vehicle:
    entry = spec.vehicles[name]
    vehicle = load_vehicle(entry.model, arguments=entry.arguments, where=where(spec, "vehicles", name, "model"))
    if not entry.mounts:
        return vehicle
    source = entry._source or Source("diagram", {}, ("vehicles", name))
    source = source._replace(prefix=(*source.prefix, "mounts"))
    return replace(vehicle, sensors=change_mounts(vehicle.sensors, entry.mounts, source=source))


def _start(spec: DiagramSpec, name: str, world: Any) -> Start:
    entry = spec.vehicles[name]
    if isinstance(entry.start, Place):
        start = Start(entry.start.x, entry.start.y, entry.start.yaw)
        world.ground.check_place(start.x, start.y, where=where(spec, "vehicles", name, "start"))
    elif entry.start is None and not world.starts:
        start = Start(0.0, 0.0, 0.0)
    else:
        start = world.start(entry.start or next(iter(world.starts)), where=where(spec, "vehicles", name, "start"))
    speed = start.speed if entry.speed is None else entry.speed
    return Start(start.x, start.y, start.yaw, speed, start.track, start.s)


def _check_starts(spec: DiagramSpec, vehicles: Mapping[str, Vehicle], starts: Mapping[str, Start]) -> None:
    """Refuse vehicles that start inside one another: nearer than a track width, however they are turned."""
    for (first, a), (second, b) in combinations(starts.items(), 2):
        width = min(vehicles[name].geometry.rear_track for name in (first, second))
        if hypot(a.x - b.x, a.y - b.y) < width:
            raise ConfigError(
                f"{where(spec, 'vehicles', second, 'start')}: '{second}' starts where '{first}' stands, at "
                f"({b.x:g}, {b.y:g}) m; give each vehicle a start of its own"
            )


def _check_sensors(spec: DiagramSpec, vehicles: Mapping[str, Vehicle]) -> None:
    """Refuse sensors that a vehicle does not have, or that are named twice."""
    for name, names in spec.sensors.items():
        mounts = vehicles[name].sensors.mounts
        for index, sensor in enumerate(names):
            place = where(spec, "sensors", name, index)
            if sensor not in mounts:
                raise ConfigError(
                    f"{place}: {vehicles[name].name} has no sensor '{sensor}'; {did_you_mean(sensor, mounts)}"
                )
            kind = mounts[sensor].kind
            if kind not in SENSORS:
                raise ConfigError(
                    f"{place}: '{sensor}' is mounted, but no {kind} is simulated yet; simulated: {', '.join(SENSORS)}"
                )
            if sensor in names[:index]:
                raise ConfigError(f"{place}: '{sensor}' is named twice; once is enough")
    if spec.record.cameras and not _cameras(spec, vehicles):
        raise ConfigError(
            f"{where(spec, 'record', 'cameras')}: no camera is in use; name one under sensors, "
            "for example sensors: {ego: [front_camera]}"
        )


def _cameras(spec: DiagramSpec, vehicles: Mapping[str, Vehicle]) -> list[tuple[str, str]]:
    """(vehicle, sensor) of the cameras of all kinds that a diagram names."""
    named = [(name, sensor) for name, sensors in spec.sensors.items() for sensor in sensors]
    return [(name, sensor) for name, sensor in named if isinstance(vehicles[name].sensors.mounts[sensor], PictureMount)]


def _sensors(spec: DiagramSpec) -> list[str]:
    """``<vehicle>.<sensor>`` of all sensors that a diagram names."""
    return [f"{name}.{sensor}" for name, sensors in spec.sensors.items() for sensor in sensors]


def _records(wiring: Wiring, name: str) -> str | None:
    """How a sensor wants to be recorded: "pictures", "array", or None as a vector among the signals."""
    return getattr(wiring.systems.get(name), "record", None)


def _add_rolling_resistance(wiring: Wiring, parts: PlantParts, spec: DiagramSpec) -> RollingResistance:
    """One system for all wheels, so that contact results are read once."""
    plant = parts.plant
    rate = max(part.vehicle.control.rate for part in parts.vehicles.values())
    wheels = [wheel for part in parts.vehicles.values() for wheel in make_rolling_wheels(part)]
    raw = spec.plant.rolling_resistance == "raw"
    cancel = not raw and spec.plant.contact == "hydroelastic"
    system = RollingResistance(
        plant,
        [wheel._replace(coefficient=0.0) for wheel in wheels] if raw else wheels,
        ground=parts.ground,
        scenery=parts.props.owners,
        bumps=parts.props.bumps,
        period=1.0 / rate if cancel or any(part.tyre_model for part in parts.vehicles.values()) else LOAD_PERIOD,
        cancel_numerical=cancel,
    )
    wiring.add("rolling_resistance", system)
    wiring.link(plant.get_contact_results_output_port(), system.contact_results)
    wiring.link(plant.get_state_output_port(), system.plant_state)
    return system


def _add_outer_forces(wiring: Wiring, parts: PlantParts, rolling: RollingResistance, spec: DiagramSpec) -> None:
    """Air and anti-roll bars, and the sum of all that acts on the plant from outside."""
    plant = parts.plant
    forces: list[OutputPort] = [rolling.generalized_force]
    for name, part in parts.vehicles.items():
        tyres = wiring.systems.get(f"{name}.tyres")
        if isinstance(tyres, WheelTyres):
            forces.append(tyres.generalized_force)
        anti_roll = make_anti_roll(plant, part)
        if anti_roll is not None:
            wiring.add(f"{name}.anti_roll", anti_roll)
            wiring.link(plant.get_state_output_port(part.instance), anti_roll.get_input_port())
            forces.append(anti_roll.get_output_port())
        if feels_air(part, spec.plant.air_density):
            air = AirForces(plant, part, density=spec.plant.air_density, wind=spec.plant.wind)
            wiring.add(f"{name}.aerodynamics", air)
            wiring.link(plant.get_state_output_port(), air.plant_state)
            wiring.sources[f"{name}.air_force"] = (air.air_force, signals_of(air.air_force))
            forces.append(air.generalized_force)
    total = Adder(len(forces), plant.num_velocities())
    wiring.add("generalized_forces", total)
    for index, port in enumerate(forces):
        wiring.link(port, total.get_input_port(index))
    wiring.link(total.get_output_port(), plant.get_applied_generalized_force_input_port())


def _add_tyres(wiring: Wiring, parts: PlantParts, rolling: RollingResistance) -> dict[str, WheelTyres]:
    """Tyre models of the vehicles that have one; a powertrain drives and brakes their wheels."""
    plant, found = parts.plant, {}
    for index, (name, part) in enumerate(parts.vehicles.items()):
        first, loads = index * len(part.wheels), len(parts.vehicles) * len(part.wheels)
        tyres = make_wheel_tyres(plant, part, loads=loads, first=first, friction=parts.world.road_mu)
        if tyres is None:
            continue
        wiring.add(f"{name}.tyres", tyres)
        wiring.link(plant.get_state_output_port(), tyres.plant_state)
        wiring.link(rolling.wheel_load, tyres.wheel_load)
        wiring.sinks[f"{name}.wheel_torque"] = (tyres.wheel_torque, signals_of(tyres.wheel_torque))
        wiring.sources[f"{name}.tyre_forces"] = (tyres.tyre_forces, signals_of(tyres.tyre_forces))
        if f"{name}.wheel_torque" in wiring.sources:
            wiring.defaults.append((f"{name}.wheel_torque", f"{name}.wheel_torque"))
        found[name] = tyres
    return found


def _track_at(start: Start, tracks: Mapping[str, Track]) -> str | None:
    """The track that a vehicle is measured against if its driver names none: the one it starts on or nearest to."""
    if start.track is not None or not tracks:
        return start.track
    return min(tracks, key=lambda name: abs(float(tracks[name].project(start.x, start.y)[1])))


def _add_vehicle_systems(
    wiring: Wiring, parts: PlantParts, part: VehicleInPlant, spec: DiagramSpec, start: Start
) -> str | None:
    """Control unit, ground truth and driver of one vehicle; returns the track it is measured against."""
    plant, name, tracks = parts.plant, part.name, parts.world.tracks
    driver_spec = spec.control.get(name)
    track = getattr(driver_spec, "track", None) or _track_at(start, tracks)
    control, truth = VehicleControl(plant, part), GroundTruth(plant, part, track=tracks.get(track or ""))
    split, join = Demultiplexer(len(COMMAND), 1), Multiplexer(len(COMMAND))
    wiring.add(f"{name}.control", control)
    wiring.add(f"{name}.truth", truth)
    wiring.add(f"{name}.join", join)
    wiring.link(plant.get_state_output_port(), control.plant_state)
    wiring.link(plant.get_state_output_port(), truth.plant_state)
    wiring.link(control.desired_state, plant.get_desired_state_input_port(part.instance))
    wiring.link(control.actuation, plant.get_actuation_input_port(part.instance))
    wiring.link(join.get_output_port(), control.command)
    for index, (port, signal) in enumerate(zip(JOIN, COMMAND, strict=True)):
        wiring.sinks[f"{name}.{port}"] = (join.get_input_port(index), (signal,))
    for port in (*(truth.get_output_port(index) for index in range(truth.num_output_ports())), control.status):
        wiring.sources[f"{name}.{port.get_name()}"] = (port, signals_of(port))
    torques = plant.get_net_actuation_output_port(part.instance)
    wiring.sources[f"{name}.joint_torques"] = (torques, None)
    powertrain = _add_powertrain(wiring, parts, part, control)

    if driver_spec is None:
        return track
    place = where(spec, "control", name)
    if isinstance(driver_spec, OwnDriverSpec):
        folder = Path(spec.folder) if spec.folder is not None else None
        driver = driver_spec.make_system(part.vehicle, parts.world, where=place, folder=folder)
    else:
        driver = driver_spec.make_system(part.vehicle, parts.world, where=place)
    wiring.add(f"{name}.driver", driver)
    if driver.HasInputPort("ranges"):
        _add_range_scan(wiring, parts, part, truth)
    wiring.add(f"{name}.split", split)
    wiring.link(driver.GetOutputPort("command"), split.get_input_port())
    wiring.sources[f"{name}.command"] = (driver.GetOutputPort("command"), COMMAND)
    for index, (port, signal) in enumerate(zip(SPLIT, COMMAND, strict=True)):
        wiring.sources[f"{name}.{port}"] = (split.get_output_port(index), (signal,))
        wiring.defaults.append((f"{name}.{port}", f"{name}.{JOIN[index]}"))
    if driver.HasOutputPort("pedals"):  # a foot of its own
        if powertrain is None:
            raise ConfigError(
                f"{place}: this driver presses pedals, but {part.vehicle.name} has none; take a vehicle with a "
                "wheel_speed of kind pedals in control.yaml, and not parked"
            )
        wiring.sources[f"{name}.driver_pedals"] = (driver.GetOutputPort("pedals"), PEDALS)
        wiring.defaults.insert(0, (f"{name}.driver_pedals", f"{name}.pedals_reference"))
    for index in range(driver.num_output_ports()):
        port = driver.get_output_port(index)
        wiring.sources.setdefault(f"{name}.{port.get_name()}", (port, signals_of(port)))
    for index in range(driver.num_input_ports()):
        port = driver.get_input_port(index)
        wiring.sinks[f"{name}.driver_{port.get_name()}"] = (port, signals_of(port))
        if f"{name}.{port.get_name()}" in wiring.sources:
            wiring.defaults.append((f"{name}.{port.get_name()}", f"{name}.driver_{port.get_name()}"))
    return track


def _add_powertrain(
    wiring: Wiring, parts: PlantParts, part: VehicleInPlant, control: VehicleControl
) -> Powertrain | None:
    """Powertrain and brakes of a vehicle that is driven by pedals; the tyres take its torques."""
    name = part.name
    if not control.HasOutputPort("pedals"):
        return None
    powertrain = Powertrain(parts.plant, part)
    wiring.add(f"{name}.powertrain", powertrain)
    wiring.link(parts.plant.get_state_output_port(), powertrain.plant_state)
    wiring.sources[f"{name}.pedals"] = (control.pedals, PEDALS)
    wiring.sinks[f"{name}.pedals_reference"] = (powertrain.pedals, PEDALS)
    wiring.defaults.append((f"{name}.pedals", f"{name}.pedals_reference"))
    for port in (powertrain.wheel_torque, powertrain.powertrain_status):
        wiring.sources[f"{name}.{port.get_name()}"] = (port, signals_of(port))
    return powertrain


def _add_range_scan(wiring: Wiring, parts: PlantParts, part: VehicleInPlant, truth: GroundTruth) -> None:
    """The stated ground-truth range sensor of one vehicle, for a driver that looks."""
    scan = RangeScan(parts.world, part.vehicle)
    wiring.add(f"{part.name}.scan", scan)
    wiring.link(truth.state, scan.state)
    if scan.prop_poses is not None:
        poses = PropPoses([parts.props.bodies[name].index() for name in scan.movable], scan.movable)
        wiring.add(f"{part.name}.prop_poses", poses)
        wiring.link(parts.plant.get_body_poses_output_port(), poses.body_poses)
        wiring.link(poses.prop_poses, scan.prop_poses)
    wiring.sources[f"{part.name}.ranges"] = (scan.ranges, signals_of(scan.ranges))


def _add_sensors(wiring: Wiring, parts: PlantParts, part: VehicleInPlant, spec: DiagramSpec) -> None:
    """The sensors of one vehicle; a camera only if its pictures are wanted."""
    feeds = sensor_feeds(parts)
    for index, sensor in enumerate(spec.sensors.get(part.name, ())):
        name = f"{part.name}.{sensor}"
        if name in wiring.systems or name in wiring.sources:
            raise ConfigError(
                f"{where(spec, 'sensors', part.name, index)}: '{name}' is no sensor but a part of every vehicle; "
                f"rename the mount in {part.vehicle.folder / 'sensors.yaml'}"
            )
        unread = not any(source.startswith(f"{name}.") for source, _ in spec.connect)
        if isinstance(part.vehicle.sensors.mounts[sensor], PictureMount) and unread and not spec.record.cameras:
            continue
        system = make_sensor(sensor, parts=parts, part=part, seed=spec.seed)
        wiring.add(name, system)
        for port in map(system.get_input_port, range(system.num_input_ports())):
            wiring.link(feeds[port.get_name()], port)
        for port in map(system.get_output_port, range(system.num_output_ports())):
            full = name if port.get_name() == "sample" else f"{name}.{port.get_name()}"
            wiring.sources[full] = (port, signals_of(port))
            wiring.builder.ExportOutput(port, full)


def _add_taps(wiring: Wiring, parts: PlantParts, rolling: RollingResistance, spec: DiagramSpec) -> dict[str, Tap]:
    """Log sinks, which are C++ and cost nothing to speak of, on what a run writes down."""
    wanted: dict[str, tuple[OutputPort, tuple[Signal, ...] | None]] = {
        "plant_state": (parts.plant.get_state_output_port(), None),
        "wheel_load": (rolling.wheel_load, signals_of(rolling.wheel_load)),
        "resistance": (rolling.resistance, signals_of(rolling.resistance)),
        "other_contacts": (rolling.other_contacts, signals_of(rolling.other_contacts)),
    }
    for name in parts.vehicles:
        sensors = [sensor for sensor in spec.sensors.get(name, ()) if _records(wiring, f"{name}.{sensor}") is None]
        for port in ("status", "command", "joint_torques", "powertrain_status", "tyre_forces", *sensors):
            if f"{name}.{port}" in wiring.sources:
                wanted[f"{name}.{port}"] = wiring.sources[f"{name}.{port}"]
    inner = [f"{full}." for full in wiring.systems if full in _sensors(spec) and _records(wiring, full) is None]
    inner += [f"{name}." for name in spec.systems]
    for full, (port, contents) in wiring.sources.items():
        stamp = port.get_name() == "stamp"  # -inf before the first sample
        vector = port.get_data_type() == PortDataType.kVectorValued
        if vector and full.startswith(tuple(inner)) and not (stamp and full.split(".")[0] in parts.vehicles):
            wanted[full] = (port, contents)
    taps = {}
    for name, (port, contents) in wanted.items():
        sink = wiring.builder.AddSystem(VectorLogSink(port.size(), publish_period=1.0 / spec.record.rate))
        sink.set_name(f"log/{name}")
        wiring.link(port, sink.get_input_port())
        taps[name] = Tap(name, sink, contents)
    return taps


def _build_fault(error: Exception) -> str:
    """What Drake says when it cannot build a diagram, on one line; an algebraic loop as the ports it runs through."""
    text = str(error).strip()
    if "algebraic loop" not in text:
        return f"the blocks cannot be built together: {text.splitlines()[0]}"
    ports = re.findall(r"putPort\[\d+\] \((.*?)\) of System (?:\S*::)?(\S+) \(", text)
    circle = " → ".join(f"{system}.{port}" for port, system in ports)
    return f"algebraic loop {circle}: put a block with memory into it, for example kind: hold or delay"
