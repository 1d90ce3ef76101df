"""The ports of a diagram under construction by name, and their connections."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from pydrake.systems.framework import DiagramBuilder, InputPort, OutputPort, PortDataType, System

from mirdrake.diagram_spec import DiagramSpec
from mirdrake.errors import ConfigError, did_you_mean
from mirdrake.plant import PlantParts
from mirdrake.signals import Signal, signals_of
from mirdrake.yaml_io import where

SPLIT = ("speed_command", "steering_command", "command_stamp")
JOIN = ("speed_reference", "steering_reference", "reference_stamp")
"""What the ports between a driver and a vehicle's control unit are called, where a user's blocks may stand."""

_RESERVED = {"plant", "scene_graph", "meshcat_visualizer"}  # Drake gives its own systems these names

_Source = tuple[OutputPort, tuple[Signal, ...] | None]
_Sink = tuple[InputPort, tuple[Signal, ...] | None]


@dataclass
class Wiring:
    """The ports of a diagram under construction by name, and their connections."""

    builder: DiagramBuilder
    spec: DiagramSpec
    sources: dict[str, _Source] = field(default_factory=dict)
    sinks: dict[str, _Sink] = field(default_factory=dict)
    defaults: list[tuple[str, str]] = field(default_factory=list)
    systems: dict[str, System] = field(default_factory=dict)
    read: set[str] = field(default_factory=set)

    def add(self, name: str, system: System) -> None:
        """Add a system under a name; the ports of a user's own become known as ``name.port``."""
        if name in self.systems or name in self.spec.vehicles or name in _RESERVED:
            place = where(self.spec, "systems", name)
            raise ConfigError(f"{place}: the name '{name}' is taken; choose another")
        system.set_name(name)
        self.builder.AddSystem(system)
        self.systems[name] = system
        if name in self.spec.systems:
            outputs = [system.get_output_port(index) for index in range(system.num_output_ports())]
            inputs = [system.get_input_port(index) for index in range(system.num_input_ports())]
            self.sources |= {f"{name}.{_short(port, outputs)}": (port, signals_of(port)) for port in outputs}
            self.sinks |= {f"{name}.{_short(port, inputs)}": (port, signals_of(port)) for port in inputs}

    def link(self, source: OutputPort, sink: InputPort) -> None:
        """Connect two ports of ours."""
        self.builder.Connect(source, sink)

    def connect(self) -> None:
        """Make the user's connections, then those of the defaults whose input is still free."""
        taken: dict[str, str] = {}
        for index, (source, sink) in enumerate(self.spec.connect):
            place = where(self.spec, "connect", index)
            if source not in self.sources:
                if source in self.sinks:
                    raise ConfigError(f"{place}: '{source}' is an input; write it second")
                raise ConfigError(f"{place}: unknown output '{source}'; {did_you_mean(source, self.sources)}")
            if sink not in self.sinks:
                if sink in self.sources:
                    raise ConfigError(f"{place}: '{sink}' is an output; write it first")
                raise ConfigError(f"{place}: unknown input '{sink}'; {did_you_mean(sink, self.sinks)}")
            if sink in taken:
                raise ConfigError(f"{place}: input '{sink}' is already fed by '{taken[sink]}'; remove one of the two")
            self._check(source, sink, place)
            taken[sink] = source
        for source, sink in self.defaults:
            taken.setdefault(sink, source)
        for sink, source in taken.items():
            self.link(self.sources[source][0], self.sinks[sink][0])
            self.read.add(source)

    def _check(self, source: str, sink: str, place: str) -> None:
        """Sizes, types and units of a connection."""
        (output, contents), (port, wanted) = self.sources[source], self.sinks[sink]
        if output.get_data_type() != port.get_data_type():
            kinds = {PortDataType.kVectorValued: "a vector", PortDataType.kAbstractValued: "an abstract value"}
            given, taken = kinds[output.get_data_type()], kinds[port.get_data_type()]
            raise ConfigError(f"{place}: '{source}' gives {given}, '{sink}' takes {taken}")
        if output.get_data_type() == PortDataType.kVectorValued and output.size() != port.size():
            raise ConfigError(f"{place}: '{source}' has {output.size()} elements, '{sink}' takes {port.size()}")
        for have, want in zip(contents or (), wanted or (), strict=False):
            if have.unit != want.unit and have.unit and want.unit:
                raise ConfigError(
                    f"{place}: '{source}' gives {have.name} in {have.unit}, '{sink}' takes {want.name} in {want.unit}"
                )

    def export(self, parts: PlantParts) -> tuple[str, ...]:
        """Export what the outside may need, refuse inputs that are open, name the outputs that nothing reads."""
        for name in parts.vehicles:
            self.builder.ExportOutput(self.sources[f"{name}.state"][0], f"{name}.state")
            for port in JOIN:
                sink = self.sinks[f"{name}.{port}"][0]
                if not self.builder.IsConnectedOrExported(sink):
                    self.builder.ExportInput(sink, f"{name}.{port}")
        for sink, (port, _) in self.sinks.items():
            system = sink.split(".", maxsplit=1)[0]
            optional = getattr(self.systems.get(system, port.get_system()), "optional_inputs", ())
            if not self.builder.IsConnectedOrExported(port) and port.get_name() not in optional:
                place = where(self.spec, "systems", system)
                choices = ", ".join([*sorted(self.sources)[:12], *(["…"] if len(self.sources) > 12 else [])])
                raise ConfigError(
                    f"{place}: input '{sink}' is not connected; add [<output>, {sink}] to connect (outputs: {choices})"
                )
        return tuple(
            source for source in self.sources if source.split(".")[0] in self.spec.systems and source not in self.read
        )


def _short(port: InputPort | OutputPort, ports: Sequence[InputPort | OutputPort]) -> str:
    """The name of a port in diagram files: u or y where it is the only one, and Drake has no word for it."""
    name: str = port.get_name()
    return {"u0": "u", "y0": "y", "delayed_u": "y"}.get(name, name) if len(ports) == 1 else name
