"""Logs of the vectors of a diagram that a run records."""

from dataclasses import dataclass

from pydrake.systems.framework import OutputPort, PortDataType
from pydrake.systems.primitives import VectorLogSink

from mirdrake.assembly.diagram_spec import DiagramSpec
from mirdrake.assembly.parts.sensors import how_recorded, sensors_of
from mirdrake.assembly.wiring import Wiring
from mirdrake.core.signals import Signal, signals_of
from mirdrake.plant.plant import PlantParts
from mirdrake.plant.wheels import GroundReadings, RollingResistance


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


def add_taps(
    wiring: Wiring, parts: PlantParts, rolling: RollingResistance | GroundReadings, spec: DiagramSpec
) -> dict[str, Tap]:
    """Add log sinks for the recorded signals; they are C++ and take little time."""
    wanted: dict[str, tuple[OutputPort, tuple[Signal, ...] | None]] = {
        "plant_state": (parts.plant.get_state_output_port(), None),
        "wheel_load": (rolling.wheel_load, signals_of(rolling.wheel_load)),
        "resistance": (rolling.resistance, signals_of(rolling.resistance)),
        "other_contacts": (rolling.other_contacts, signals_of(rolling.other_contacts)),
    }
    for name in parts.vehicles:
        sensors = [sensor for sensor in spec.sensors.get(name, ()) if how_recorded(wiring, f"{name}.{sensor}") is None]
        for port in ("status", "command", "joint_torques", "powertrain_status", "tyre_forces", *sensors):
            if f"{name}.{port}" in wiring.sources:
                wanted[f"{name}.{port}"] = wiring.sources[f"{name}.{port}"]
    inner = [f"{full}." for full in wiring.systems if full in sensors_of(spec) and how_recorded(wiring, full) is None]
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
