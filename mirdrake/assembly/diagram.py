"""Assembly of a diagram spec into a Drake Diagram: make the systems, connect them by name, check the connections.

Every subsystem is named ``<vehicle>.<part>`` or as the user called it, every port can be reached as
``<vehicle>.<port>`` or ``<system>.<port>``. Per vehicle the chain is

::

    ego.driver ─ ego.command ─ ego.split ─ ego.speed_command    ─► ego.speed_reference    ─ ego.join ─ ego.control
                                           ego.steering_command ─► ego.steering_reference
                                           ego.command_stamp    ─► ego.reference_stamp

and a connection of the user's to an input replaces the one drawn here. A vehicle that is driven by pedals also has
``ego.pedals ─► ego.pedals_reference ─ ego.powertrain ─ ego.wheel_torque ─► ego.tyres``; a driver with an output
``pedals`` presses them itself. Sensors are ``<vehicle>.<sensor>``, and so is what they measure; a camera's pictures are
``<vehicle>.<sensor>.color_image``. The parts are added by the modules of :mod:`mirdrake.assembly.parts`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pydrake.geometry import Meshcat, MeshcatVisualizer, MeshcatVisualizerParams
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, OutputPort, System

from mirdrake.assembly.blocks import make_block
from mirdrake.assembly.diagram_spec import DiagramSpec, load_diagram, make_spec
from mirdrake.assembly.parts.actors import TRAFFIC, add_traffic
from mirdrake.assembly.parts.forces import add_outer_forces, add_tyres
from mirdrake.assembly.parts.places import check_starts, find_start, start_of_actor
from mirdrake.assembly.parts.sensors import add_sensors, cameras_of, check_sensors, how_recorded, sensors_of
from mirdrake.assembly.parts.steps import interrupting_event
from mirdrake.assembly.parts.taps import Tap, add_taps
from mirdrake.assembly.parts.vehicles import add_drawn_wheels, add_vehicle_systems
from mirdrake.assembly.scene import Scene, make_scene
from mirdrake.assembly.wiring import JOIN, Wiring
from mirdrake.core.drake_errors import algebraic_loop
from mirdrake.core.errors import ConfigError, DiagramError, did_you_mean
from mirdrake.core.signals import Signal
from mirdrake.core.yaml_io import Source, where
from mirdrake.plant.actors import add_actors
from mirdrake.plant.plant import SCHEME, PlantParts, make_plant, set_start, solves_joints
from mirdrake.plant.wheels import TyreSystem
from mirdrake.sensors.cameras.camera import Camera
from mirdrake.sensors.perception import add_cloud_overlays
from mirdrake.worlds import Start

__all__ = ["Assembly", "DiagramSpec", "Tap", "assemble", "load_diagram", "make_diagram", "make_spec"]

DRAWING_PERIOD = 1.0 / 32.0
"""Simulated time between two pictures of a live view [s]."""


@dataclass(frozen=True)
class Assembly:
    """A built diagram with the handles to run it and to read its logs.

    Attributes:
        spec: what it was made from.
        diagram: the Drake Diagram.
        parts: plant, world and vehicles.
        starts: where each vehicle starts.
        taps: the logged vectors.
        tracks: track that each vehicle follows or is measured against; None in a world without tracks.
        unread: outputs that nothing reads, by name.
        idle_cameras: cameras that are not in the diagram, since their pictures are neither recorded nor connected.
        meshcat: shows the run, if it was given; a run draws in it outside of the diagram.
        cameras: those whose pictures shall be recorded, by name, and the name of their vehicle.
        arrays: sensors whose samples are arrays and shall be recorded, by name.
        tyres: tyre systems of the vehicles, by name of the vehicle.
        outputs: names and units of the elements of all ports that `connect` may name first; None: they have no names.
        inputs: the same of those that it may name second.
        aliases: other names of ports and elements, as ``ego.vx`` for ``ego.state.vx``.
        defaults: source of each input that is connected if the user makes no other connection.
        ports: output ports by name.
    """

    spec: DiagramSpec
    diagram: Diagram
    parts: PlantParts
    starts: dict[str, Start]
    taps: dict[str, Tap]
    tracks: dict[str, str | None]
    unread: tuple[str, ...] = ()
    idle_cameras: tuple[str, ...] = ()
    meshcat: Meshcat | None = None
    cameras: dict[str, tuple[Camera, str]] = field(default_factory=dict)
    arrays: dict[str, System] = field(default_factory=dict)
    tyres: dict[str, TyreSystem] = field(default_factory=dict)
    outputs: dict[str, tuple[Signal, ...] | None] = field(default_factory=dict)
    inputs: dict[str, tuple[Signal, ...] | None] = field(default_factory=dict)
    aliases: dict[str, str] = field(default_factory=dict)
    defaults: dict[str, str] = field(default_factory=dict)
    ports: dict[str, OutputPort] = field(default_factory=dict)

    @cached_property
    def scene(self) -> Scene:
        """The world and the vehicles."""
        return Scene(self.parts.world, {name: part.vehicle for name, part in self.parts.vehicles.items()})

    def default_source(self, sink: str) -> str | None:
        """Return the source of an input, or of an element of it, if the user makes no other connection."""
        sink = sink if sink in self.inputs else self.aliases.get(sink, sink)
        if sink in self.defaults:
            return self.defaults[sink]
        port, _, element = sink.rpartition(".")
        source, contents = self.defaults.get(port), self.inputs.get(port)
        names = [signal.name for signal in contents or ()]
        known = None if source is None else self.outputs[source]
        # An element of a source without names cannot be connected.
        if element not in names or not known:
            return None
        return f"{source}.{known[names.index(element)].name}"

    def output_port(self, name: str) -> tuple[OutputPort, int]:
        """Return the port and the index of an element of an output.

        Raises:
            ConfigError: there is no such output, or it has several elements and none is named.
        """
        full = name if name in self.outputs else self.aliases.get(name, name)
        if full in self.ports and self.ports[full].size() == 1:
            return self.ports[full], 0
        port, _, element = full.rpartition(".")
        names = [signal.name for signal in self.outputs.get(port) or ()]
        if element in names:
            return self.ports[port], names.index(element)
        if full in self.ports:
            raise ConfigError(
                f"output '{name}' has {self.ports[full].size()} elements; name one of them: {name}.<element>"
            )
        raise ConfigError(f"unknown output '{name}'; {did_you_mean(name, self.outputs)}")

    def user_systems(self) -> dict[str, System]:
        """User systems, which are written as ``module:Class``, by name."""
        own = {name for name, entry in self.spec.systems.items() if ":" in entry.kind}
        return {system.get_name(): system for system in self.diagram.GetSystems() if system.get_name() in own}

    def check_inputs(self, context: Context) -> None:
        """Check that no input of the diagram is open.

        Args:
            context: Context of the diagram; an input with a fixed value in it is not open.

        Raises:
            ConfigError: a vehicle has no driver, or what replaces a disabled block is not connected.
        """
        ports = [self.diagram.get_input_port(index) for index in range(self.diagram.num_input_ports())]
        names = [port.get_name() for port in ports if not port.HasValue(context)]
        # An open command input is the usual case: nobody drives the vehicle. It gets its own advice.
        undriven = [name for name in names if name.partition(".")[2] in JOIN]
        if undriven:
            vehicle = undriven[0].partition(".")[0]
            raise ConfigError(
                f"'{vehicle}' has no driver (open inputs: {', '.join(names)}); "
                f"add control.{vehicle}, for example {{kind: constant, speed: 5}}, or connect your own blocks to them",
                where=where(self.spec, "control"),
            )
        if names:
            raise ConfigError(
                "nothing is connected in place of a disabled block: "
                f"{', '.join(names)}; add [<output>, {names[0]}] to connect",
                where=where(self.spec, "connect"),
            )

    def steps_in(self, time: float) -> int:
        """Return the number of steps of the plant, at least one, whose length is nearest to a time [s].

        A call of ``Simulator.AdvanceTo`` must end with a step: within a step it would divide it into two, in which a
        continuous plant has other results.
        """
        return max(round(time / self.spec.plant.time_step), 1)

    def make_simulator(self, context: Context | None = None) -> Simulator:
        """Return a Simulator of the diagram, with the integrator that a continuous plant needs.

        Args:
            context: Context of the diagram, changed by the Simulator; by default a new one.
        """
        simulator = Simulator(self.diagram, context)
        if not solves_joints(self.parts.plant):
            # Applying a config sets the time of the Context, by default to zero.
            config = SimulatorConfig(
                integration_scheme=SCHEME,
                max_step_size=self.spec.plant.time_step,
                use_error_control=False,
                start_time=simulator.get_context().get_time(),
            )
            ApplySimulatorConfig(config, simulator)
        return simulator

    @cached_property
    def _start(self) -> npt.NDArray[np.float64]:
        """State of the plant with every vehicle and prop at its start; to find the rest poses takes a millisecond."""
        plant = self.parts.plant
        context = plant.CreateDefaultContext()
        for name, part in self.parts.vehicles.items():
            start = self.starts[name]
            set_start(plant, context, part, x=start.x, y=start.y, yaw=start.yaw, speed=start.speed)
        self.parts.props.reset(plant, context)
        return np.array(plant.GetPositionsAndVelocities(context))

    def make_context(self) -> Any:
        """Return a new Context with every vehicle at its start."""
        context = self.diagram.CreateDefaultContext()
        plant = self.parts.plant
        plant_context = plant.GetMyMutableContextFromRoot(context)
        plant.SetPositionsAndVelocities(plant_context, self._start)
        if self.parts.actors.instance is not None:
            traffic = self.diagram.GetSubsystemByName(TRAFFIC)
            start = traffic.solid_states(traffic.GetMyContextFromRoot(context))
            plant.SetPositionsAndVelocities(plant_context, self.parts.actors.instance, start)
        return context


def make_diagram(spec: DiagramSpec | Mapping[str, Any] | str, *, meshcat: Meshcat | None = None) -> Diagram:
    """Return an ordinary Drake Diagram for a diagram spec, its data or its name.

    A vehicle without an entry under ``control`` gets its ports exported as inputs ``<name>.speed_reference`` [m/s],
    ``<name>.steering_reference`` [rad] and ``<name>.reference_stamp`` [s]; the state of every vehicle is exported as
    output ``<name>.state``, and so are its sensors. A camera whose pictures nothing reads or records is left out, as
    rendering takes longer than all the rest.

    Raises:
        ConfigError, ModelError, WorldError, DiagramError: what is wrong, on one line each.
    """
    return assemble(spec, meshcat=meshcat, drawing_period=DRAWING_PERIOD, expand=True, continuous=False).diagram


def assemble(
    spec: DiagramSpec | Mapping[str, Any] | str,
    *,
    meshcat: Meshcat | None = None,
    scene: Scene | None = None,
    drawing_period: float | None = None,
    drawn: bool = False,
    expand: bool = False,
    factories: Mapping[str, Callable[[], System]] | None = None,
    continuous: bool = True,
) -> Assembly:
    """Return the diagram of :func:`make_diagram` with the handles that a run needs.

    Args:
        spec: see :func:`make_diagram`.
        meshcat: see :func:`make_diagram`.
        scene: of this spec, if it is made already; see :func:`mirdrake.assembly.scene.make_scene`.
        drawing_period: simulated time between the drawings of a MeshcatVisualizer in the diagram [s]. None adds no
            MeshcatVisualizer: an exception of Meshcat within a step, or at the start, would end the simulation.
        drawn: whether a Meshcat outside of the diagram will draw it.
        expand: whether the control units are Diagrams of blocks. Otherwise a unit is one fused system with the same
            bits, which is faster, unless the spec replaces, connects or records one of its blocks.
        continuous: whether the plant may be continuous, which is three times as fast. It then is if nothing in it
            needs Drake's contact solver and no other event interrupts its steps; :meth:`Assembly.make_simulator` has
            the integrator for it.
        factories: functions that make the systems of classes and objects in Python, by their names under ``systems``.
    """
    if isinstance(spec, str):
        spec = load_diagram(spec)
    elif isinstance(spec, Mapping):
        spec = make_spec(spec)

    # World and vehicles.
    scene = make_scene(spec) if scene is None else scene
    world, vehicles = scene.world, scene.vehicles
    starts = {name: find_start(spec, name, world) for name in spec.vehicles}
    starts |= {actor.name: start_of_actor(actor, world) for actor in world.full_actors}
    check_starts(spec, vehicles, starts)
    for key in ("control", "sensors"):
        for name in getattr(spec, key):
            if name not in vehicles:
                raise ConfigError(f"no vehicle '{name}'; {did_you_mean(name, vehicles)}", where=where(spec, key, name))
            if key == "control" and name not in spec.vehicles:
                raise ConfigError(
                    f"'{name}' is an actor of the world, which moves by its behaviour", where=where(spec, key, name)
                )
    # A name with dots is that of a block of a control unit.
    for name in spec.systems:
        vehicle, dot, _ = name.partition(".")
        if dot and vehicle not in vehicles:
            place, hint = where(spec, "systems", name), did_you_mean(vehicle, vehicles)
            raise ConfigError(f"no vehicle '{vehicle}', of which a block is replaced; {hint}", where=place)
    check_sensors(spec, vehicles)

    continuous = continuous and not interrupting_event(spec, scene, factories)
    # The plant, and per vehicle its control unit, driver, ground truth and sensors.
    builder = DiagramBuilder()
    parked = {name for name, entry in spec.vehicles.items() if entry.parked}
    parts = make_plant(builder, world, vehicles, spec=spec.plant, parked=parked, continuous=continuous)
    # The scene graph moves every frame in each step of the plant, so that it gets actors only if something sees them.
    if meshcat is not None or drawn or sensors_of(spec):
        parts = replace(parts, actors=add_actors(parts.scene_graph, world, parts.actors))
    mounted = {name: vehicle.sensors.mounts for name, vehicle in vehicles.items()}
    wiring = Wiring(builder, spec, factories=factories or {}, mounted=mounted)
    add_traffic(wiring, parts, spec)
    # Tyres come first: the vehicles' systems connect the actuators to them.
    readings, tyres = add_tyres(wiring, parts)
    tracks = {}
    for part in parts.vehicles.values():
        tracks[part.name] = add_vehicle_systems(wiring, parts, part, spec, starts[part.name], expand=expand)
        add_sensors(wiring, parts, part, spec)
        if meshcat is not None or drawn:
            add_drawn_wheels(wiring, parts, part)
    # After the vehicles, whose powertrains are the default sources of the wheel torques.
    add_outer_forces(wiring, parts, tyres, spec)

    # The user's own blocks, then all connections.
    folder = Path(spec.folder) if spec.folder is not None else None
    for name, entry in spec.systems.items():
        if "." in name:  # in place of a block of a control unit
            continue
        source = entry._source or Source("diagram", {}, ("systems", name))
        factory = wiring.factories.get(name)
        wiring.add(name, make_block(entry.kind, entry.parameters(), source=source, folder=folder, factory=factory))
    wiring.connect()

    if meshcat is not None and drawing_period is not None:
        params = MeshcatVisualizerParams(publish_period=drawing_period, delete_on_initialization_event=False)
        MeshcatVisualizer.AddToBuilder(builder, parts.scene_graph, meshcat, params)
    if meshcat is not None:
        clouds = {name for name, system in wiring.systems.items() if getattr(system, "has_cloud_overlay", False)}
        add_cloud_overlays(builder, meshcat, {name: wiring.systems[name] for name in clouds})

    # Logs and exports come after the connections: they depend on what is connected and on what is still open.
    taps = add_taps(wiring, parts, readings, tyres, spec) if spec.record.signals else {}
    unread = wiring.export(parts)
    idle_cameras = tuple(
        f"{vehicle}.{sensor}"
        for vehicle, sensor in cameras_of(spec, vehicles)
        if f"{vehicle}.{sensor}" not in wiring.systems
    )
    try:
        diagram = builder.Build()
    except RuntimeError as error:
        raise DiagramError(_build_fault(error), where=where(spec, "connect")) from None
    diagram.set_name(spec.name)
    cameras = {
        f"{vehicle}.{sensor}": (wiring.systems[f"{vehicle}.{sensor}"], vehicle)
        for vehicle, sensor in cameras_of(spec, vehicles)
        if spec.record.cameras
    }
    arrays = {
        name: wiring.systems[name]
        for name in sensors_of(spec)
        if spec.record.arrays and how_recorded(wiring, name) == "array"
    }
    outputs, inputs = ({name: entry[1] for name, entry in ports.items()} for ports in (wiring.sources, wiring.sinks))
    return Assembly(
        spec,
        diagram,
        parts,
        starts,
        taps,
        tracks,
        unread,
        idle_cameras,
        meshcat,
        cameras,
        arrays,
        tyres,
        outputs,
        inputs,
        wiring.aliases,
        # Reversed, so that the first default of an input wins, as in Wiring.connect.
        {sink: source for source, sink in reversed(wiring.defaults)},
        {name: port for name, (port, _) in wiring.sources.items()},
    )


def _build_fault(error: Exception) -> str:
    """Return Drake's error of a diagram that cannot be built, in one line; an algebraic loop as the ports along it."""
    text = str(error).strip()
    loop = algebraic_loop(text)
    if loop is None:
        return f"the blocks cannot be built together: {text.splitlines()[0]}"
    return f"algebraic loop {' → '.join(loop)}: put a block with memory into it, for example kind: hold or delay"
