"""The ports of a diagram under construction by name, and their connections."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Any

from pydrake.systems.framework import DiagramBuilder, InputPort, OutputPort, PortDataType, System
from pydrake.systems.primitives import Demultiplexer, Multiplexer
from pydrake.systems.sensors import ImageDepth32F, ImageLabel16I, ImageRgba8U

from mirdrake.assembly.diagram_spec import DiagramSpec, connections_of
from mirdrake.controllers.control_diagram import ControlDiagram
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.signals import Signal, signals_of
from mirdrake.core.yaml_io import where
from mirdrake.plant.plant import PlantParts

JOIN = ("speed_reference", "steering_reference", "reference_stamp")
"""Inputs of a vehicle's control unit, which its driver or user blocks feed."""

_RESERVED = {"plant", "scene_graph", "meshcat_visualizer"}  # Drake gives its own systems these names

MOST_PORTS = 25
"""Largest number of ports that an error lists."""

_Source = tuple[OutputPort, tuple[Signal, ...] | None]
_Sink = tuple[InputPort, tuple[Signal, ...] | None]


@dataclass
class Wiring:
    """The ports of a diagram under construction by name, and their connections.

    Attributes:
        builder: of the diagram.
        spec: of the diagram.
        sources: outputs by name, with names and units of their elements.
        sinks: the same of the inputs.
        defaults: connections that are made if the user makes no other to the input.
        systems: systems by name.
        factories: functions that make systems of a class or object in Python, by name.
        blocks: control units that were added as blocks, by name.
        aliases: other names of ports and elements, as ``ego.vx`` for ``ego.state.vx``.
        inner: inputs that are connected within a subsystem.
        open: inputs that become inputs of the diagram if nothing is connected to them.
        read: outputs that are connected.
        mounted: sensors of each vehicle, in use or not.
    """

    builder: DiagramBuilder
    spec: DiagramSpec
    sources: dict[str, _Source] = field(default_factory=dict)
    sinks: dict[str, _Sink] = field(default_factory=dict)
    defaults: list[tuple[str, str]] = field(default_factory=list)
    systems: dict[str, System] = field(default_factory=dict)
    factories: Mapping[str, Callable[[], System]] = field(default_factory=dict)
    blocks: dict[str, ControlDiagram] = field(default_factory=dict)
    aliases: dict[str, str] = field(default_factory=dict)
    inner: set[str] = field(default_factory=set)
    open: set[str] = field(default_factory=set)
    read: set[str] = field(default_factory=set)
    mounted: Mapping[str, Collection[str]] = field(default_factory=dict)

    def add(self, name: str, system: System) -> None:
        """Add a system under a name; the ports of a user system are named ``name.port``."""
        if name in self.systems or name in self.spec.vehicles or name in _RESERVED:
            place = where(self.spec, "systems", name)
            raise ConfigError(f"the name '{name}' is taken; choose another", where=place)
        system.set_name(name)
        self.builder.AddSystem(system)
        self.systems[name] = system
        if name in self.spec.systems:
            outputs = [system.get_output_port(index) for index in range(system.num_output_ports())]
            inputs = [system.get_input_port(index) for index in range(system.num_input_ports())]
            self.sources |= {f"{name}.{_short(port, outputs)}": (port, signals_of(port)) for port in outputs}
            self.sinks |= {f"{name}.{_short(port, inputs)}": (port, signals_of(port)) for port in inputs}

    def link(self, source: OutputPort, sink: InputPort) -> None:
        """Connect two ports."""
        self.builder.Connect(source, sink)

    def connect(self) -> None:
        """Make the user's connections, then the default ones whose input is still open."""
        taken: dict[str, str] = {}
        for given_source, given_sink, place in connections_of(self.spec):
            source, sink = self._full_name(given_source, self.sources), self._full_name(given_sink, self.sinks)
            output, given = self._find(source, self.sources, self.sinks, place, "output", "write it second")
            port, wanted = self._find(sink, self.sinks, self.sources, place, "input", "write it first")
            # A whole port and its elements exclude each other.
            other = next(
                (entry for entry in taken if entry == sink or sink == port == _port_of(entry, self.sinks)), None
            )
            other = port if other is None and wanted is not None and port in taken else other
            if other is not None:
                raise ConfigError(
                    f"input '{sink}' is already fed by '{taken[other]}'; remove one of the two", where=place
                )
            self._check(source, (output, given), sink, (port, wanted), place)
            taken[sink] = source
        # A default is skipped as soon as the user feeds any part of the port; the first default of an input wins.
        fed = {_port_of(sink, self.sinks) for sink in taken}
        for source, sink in self.defaults:
            if sink in fed:
                continue
            vehicle, _, port = sink.partition(".")
            # The input of a driver may be that of a user's class, of any size.
            if sink not in taken and port.startswith("driver_") and _port_of(source, self.sources) == source:
                place = where(self.spec, "control", vehicle)
                self._check(source, (source, None), sink, (sink, None), place)
            taken.setdefault(sink, source)

        # Connections of elements are collected first, as a port has one multiplexer for all of them.
        elements: dict[str, dict[str, str]] = {}
        for sink, source in taken.items():
            port = _port_of(sink, self.sinks)
            if port == sink:
                self.link(self._output(source), self.sinks[sink][0])
            else:
                elements.setdefault(port, {})[sink.removeprefix(f"{port}.")] = source
        for port, given_elements in elements.items():
            self._join(port, given_elements)

    def _full_name(self, name: str, ports: Mapping[str, Any]) -> str:
        """Return the name of a port, or of an element of one, for a name that may be another name of it."""
        return name if _port_of(name, ports) else self.aliases.get(name, name)

    def name_elements(self, port: str, owner: str) -> None:
        """Let the elements of an output have the short name ``owner.element``, where nothing else has it."""
        for signal in self.sources[port][1] or ():
            self.aliases.setdefault(f"{owner}.{signal.name}", f"{port}.{signal.name}")

    def _find(
        self, name: str, ports: Mapping[str, Any], others: Mapping[str, Any], place: str, kind: str, advice: str
    ) -> tuple[str, str | None]:
        """Return the port of a name in `connect`, and its element if the name has one."""
        port = _port_of(name, ports)
        if port and port == name:
            return port, None
        if port:
            element, contents = name.removeprefix(f"{port}."), ports[port][1]
            names = [signal.name for signal in contents or ()]
            if element in names:
                return port, element
            if not names:
                raise ConfigError(f"the elements of '{port}' have no names; connect the whole port", where=place)
            listed = ", ".join(f"{signal.name} [{signal.unit or '-'}]" for signal in contents)
            raise ConfigError(f"'{port}' has no element '{element}'; its elements: {listed}", where=place)
        # The reversed pair [input, output] is a frequent mistake and gets its own message.
        if _port_of(name, others):
            other = {"output": "an input", "input": "an output"}[kind]
            raise ConfigError(f"'{name}' is {other}; {advice}", where=place)

        # A sensor has ports only if the diagram uses it.
        vehicle, _, rest = name.partition(".")
        sensor, used = rest.partition(".")[0], self.spec.sensors.get(vehicle, [])
        if kind == "output" and sensor in self.mounted.get(vehicle, ()) and sensor not in used:
            line = f"sensors: {{{vehicle}: [{', '.join([*used, sensor])}]}}"
            raise ConfigError(
                f"unknown output '{name}': the sensor '{sensor}' is mounted but not in use; write `{line}`", where=place
            )

        # Unknown name: list the ports of the longest beginning that exists, and the nearest name.
        owner, own = self._nearest_owner(name, ports)
        shown = sorted(own)[:MOST_PORTS] + (["…"] if len(own) > MOST_PORTS else [])
        listed = f"; {kind}s of '{owner}': {', '.join(shown)}" if own else ""
        others_of_ports = [alias for alias, full in self.aliases.items() if _port_of(full, ports)]
        near = get_close_matches(name, [*ports, *others_of_ports], n=1) if own else []
        hint = f"; did you mean '{near[0]}'?" if near else f"; {did_you_mean(name, ports)}" if not own else ""
        raise ConfigError(f"unknown {kind} '{name}'{hint}{listed}", where=place)

    def _nearest_owner(self, name: str, ports: Mapping[str, Any]) -> tuple[str, list[str]]:
        """Return the longest beginning of a name that has ports, and these without those of inner blocks."""
        parts = name.split(".")
        for count in range(len(parts) - 1, 0, -1):
            owner = ".".join(parts[:count])
            own = [port for port in ports if port.startswith(f"{owner}.")]
            if own:
                inside = ".control." in f"{owner}."
                return owner, [port for port in own if inside or ".control." not in port]
        return parts[0], []

    def _output(self, source: str) -> OutputPort:
        """Return the port of a source; that of an element is from a demultiplexer, one for each port."""
        name = _port_of(source, self.sources)
        self.read.add(name)
        port, contents = self.sources[name]
        if name == source:
            return port
        full = f"{name}.elements"
        if full not in self.systems:
            split = self.builder.AddNamedSystem(full, Demultiplexer(port.size(), 1))
            self.systems[full] = split
            self.link(port, split.get_input_port())
        names = [signal.name for signal in contents or ()]
        return self.systems[full].get_output_port(names.index(source.removeprefix(f"{name}.")))

    def _join(self, name: str, given: Mapping[str, str]) -> None:
        """Connect an input by elements; the others come from its default.

        Raises:
            ConfigError: an element is not given, and the input has no default whose elements have names.
        """
        port, contents = self.sinks[name]
        names = [signal.name for signal in contents or ()]
        default = next((source for source, sink in self.defaults if sink == name), None)
        # The elements of the default source may have other names; their order is the same.
        known = [signal.name for signal in self.sources[default][1] or ()] if default is not None else []
        missing = [element for element in names if element not in given]
        # Elements of a source without names cannot be taken one by one.
        if missing and not known:
            raise ConfigError(
                f"input '{name}' has no value for {', '.join(missing)}; connect them", where=where(self.spec, "connect")
            )
        join = self.builder.AddNamedSystem(f"{name}.elements", Multiplexer(len(names)))
        self.systems[f"{name}.elements"] = join
        for index, element in enumerate(names):
            source = given.get(element)
            if source is None:
                source = f"{default}.{known[index]}"
            self.link(self._output(source), join.get_input_port(index))
        self.link(join.get_output_port(), port)

    def _check(
        self,
        source: str,
        output: tuple[str, str | None],
        sink: str,
        taker: tuple[str, str | None],
        place: str,
    ) -> None:
        """Check sizes, types and units of a connection."""
        port, contents, size = _part(self.sources[output[0]], output[1])
        taking, wanted, taken_size = _part(self.sinks[taker[0]], taker[1])
        if port.get_data_type() != taking.get_data_type():
            kinds = {PortDataType.kVectorValued: "a vector", PortDataType.kAbstractValued: "an abstract value"}
            given, taken = kinds[port.get_data_type()], kinds[taking.get_data_type()]
            raise ConfigError(f"'{source}' gives {given}, '{sink}' takes {taken}", where=place)
        if port.get_data_type() == PortDataType.kAbstractValued:
            _check_images(source, port, sink, taking, place)
        if port.get_data_type() == PortDataType.kVectorValued and size != taken_size:
            hint = ""
            if taken_size == 1 and contents:
                hint = f"; connect one of them, as '{source}.{contents[0].name}'"
            count = "1 element" if size == 1 else f"{size} elements"
            raise ConfigError(f"'{source}' has {count}, '{sink}' takes {taken_size}{hint}", where=place)
        # Units are compared only where both sides state one; lengths may differ for ports without names.
        for have, want in zip(contents or (), wanted or (), strict=False):
            if have.unit != want.unit and have.unit and want.unit:
                raise ConfigError(
                    f"'{source}' gives {have.name} in {have.unit}, '{sink}' takes {want.name} in {want.unit}",
                    where=place,
                )

    def export(self, parts: PlantParts) -> tuple[str, ...]:
        """Export ports, reject open inputs, and return the names of outputs that are not connected."""
        # Inputs of a vehicle without a driver become inputs of the diagram, so that it can be driven from outside.
        for name in parts.vehicles:
            self.builder.ExportOutput(self.sources[f"{name}.state"][0], f"{name}.state")
            for port in JOIN:
                sink = self.sinks[f"{name}.{port}"][0]
                if not self.builder.IsConnectedOrExported(sink):
                    self.builder.ExportInput(sink, f"{name}.{port}")
        for sink in sorted(self.open):
            if not self.builder.IsConnectedOrExported(self.sinks[sink][0]):
                self.builder.ExportInput(self.sinks[sink][0], sink)
        for sink, (port, _) in self.sinks.items():
            # The builder does not know what is connected within a subsystem.
            if sink in self.inner:
                continue
            system = sink.split(".", maxsplit=1)[0]
            optional = getattr(self.systems.get(system, port.get_system()), "optional_inputs", ())
            if not self.builder.IsConnectedOrExported(port) and port.get_name() not in optional:
                place = where(self.spec, "systems", system)
                names = sorted(name for name in self.sources if ".control." not in name)
                choices = ", ".join(names[:MOST_PORTS] + (["…"] if len(names) > MOST_PORTS else []))
                raise ConfigError(
                    f"input '{sink}' is not connected; add [<output>, {sink}] to connect (outputs: {choices})",
                    where=place,
                )
        return tuple(
            source for source in self.sources if source.split(".")[0] in self.spec.systems and source not in self.read
        )


def _port_of(name: str, ports: Mapping[str, Any]) -> str:
    """Return the port that a name begins with: the name itself, or the vector of an element; "" if there is none."""
    parts = name.split(".")
    for count in range(len(parts), 1, -1):
        if (port := ".".join(parts[:count])) in ports:
            return port
    return ""


def _check_images(source: str, port: OutputPort, sink: str, taking: InputPort, place: str) -> None:
    """Check that an input of pictures of a fixed size gets pictures of this kind and size."""
    # Kind and size of a picture are in the default value of an abstract port only.
    given = port.Allocate().get_value()
    wanted = taking.get_system().AllocateInputAbstract(taking).get_value()
    if not (hasattr(wanted, "width") and hasattr(wanted, "height")):
        return
    if type(given) is not type(wanted):
        raise ConfigError(f"'{source}' gives {_noun(given)}, '{sink}' takes {_noun(wanted)}", where=place)
    have, want = (given.width(), given.height()), (wanted.width(), wanted.height())
    # Pictures of size zero: an input that takes every size.
    if want != (0, 0) and have != want:
        raise ConfigError(
            f"'{source}' gives pictures of {have[0]} x {have[1]} pixels, '{sink}' takes {want[0]} x "
            f"{want[1]}; set width and height of the camera under vehicles.<name>.mounts",
            where=place,
        )


def _noun(value: Any) -> str:
    """Return what the value of an abstract port is, for errors."""
    nouns = {ImageRgba8U: "colours", ImageDepth32F: "depths", ImageLabel16I: "labels"}
    return nouns.get(type(value), "a value of another type")


def _part(entry: tuple[Any, tuple[Signal, ...] | None], element: str | None) -> tuple[Any, tuple[Signal, ...], int]:
    """Return a port with the names and the number of its elements, or of one of them."""
    port, contents = entry
    if element is not None:
        return port, tuple(signal for signal in contents or () if signal.name == element), 1
    return port, contents or (), port.size()


def _short(port: InputPort | OutputPort, ports: Sequence[InputPort | OutputPort]) -> str:
    """Return the name of a port in diagram files: u or y for the only port of a system without a name in Drake."""
    name: str = port.get_name()
    return {"u0": "u", "y0": "y", "delayed_u": "y"}.get(name, name) if len(ports) == 1 else name
