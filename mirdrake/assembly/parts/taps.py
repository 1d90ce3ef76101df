"""Logs of the vectors of a diagram that a run records."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np
import numpy.typing as npt
from pydrake.systems.framework import Context, DiscreteValues, OutputPort, PortDataType
from pydrake.systems.primitives import Multiplexer, VectorLogSink

from mirdrake.assembly.diagram_spec import DiagramSpec
from mirdrake.assembly.parts.sensors import how_recorded, sensors_of
from mirdrake.assembly.wiring import Wiring
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import Signal, signals_of
from mirdrake.core.yaml_io import where
from mirdrake.plant.plant import PlantParts
from mirdrake.plant.wheels import TyreSystem, WheelReadings
from mirdrake.vehicles import Vehicle

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Tap:
    """A vector that is logged.

    Attributes:
        name: what it is, for example "ego.status".
        sink: the log in the diagram, which other taps may share.
        rows: where its elements are in the log.
        contents: names and units of its elements, or None if the system does not state them.
        is_chosen: whether a pattern of record.signals chose it; its contents have full names.
    """

    name: str
    sink: VectorLogSink
    rows: slice
    contents: tuple[Signal, ...] | None
    is_chosen: bool = False

    def times(self, context: Context) -> Array:
        """Return the times of the samples [s] (n), a view.

        Args:
            context: Context of the whole diagram, as in the next functions.
        """
        times: Array = self.sink.FindLog(context).sample_times()
        return times

    def data(self, context: Context) -> Array:
        """Return the samples (elements, n), a view."""
        data: Array = self.sink.FindLog(context).data()
        return data[self.rows]

    def value(self, context: Context) -> Array:
        """Return the present value of the vector."""
        value: Array = self.sink.get_input_port().Eval(self.sink.GetMyContextFromRoot(context))
        return value[self.rows]


def clear_logs(taps: Iterable[Tap], context: Context) -> None:
    """Remove the samples of all taps.

    Args:
        taps: all taps of a diagram; some share a log.
        context: Context of the diagram.
    """
    for sink in {tap.sink for tap in taps}:
        sink.FindMutableLog(context).Clear()


class HeldSignals(LeafSystem):  # type: ignore[misc, unused-ignore]
    """Samples vectors every period and holds them, as the actuators of a control unit do.

    Input ports:
        u0, u1, ...: vectors.

    Output ports:
        y: all their elements.

    Args:
        sizes: lengths of the vectors.
        period: time between samples [s].
    """

    def __init__(self, sizes: Sequence[int], *, period: float) -> None:
        super().__init__()
        self.inputs = [self.DeclareVectorInputPort(f"u{index}", size) for index, size in enumerate(sizes)]
        state = self.DeclareDiscreteState(sum(sizes))
        self.DeclareStateOutputPort("y", state)
        self.DeclareInitializationDiscreteUpdateEvent(self._sample)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._sample)

    def _sample(self, context: Context, state: DiscreteValues) -> None:
        # One vector for all blocks of a unit: one log sink instead of one for each signal.
        state.set_value(0, np.concatenate([port.Eval(context) for port in self.inputs]))


def add_taps(
    wiring: Wiring, parts: PlantParts, readings: WheelReadings, tyres: Mapping[str, TyreSystem], spec: DiagramSpec
) -> dict[str, Tap]:
    """Add logs of the recorded signals."""
    # Vectors that every run records, as the columns of its table are computed from them.
    wanted: dict[str, tuple[OutputPort, tuple[Signal, ...] | None]] = {
        "plant_state": (parts.plant.get_state_output_port(), None),
        "other_contacts": (readings.other_contacts, signals_of(readings.other_contacts)),
    }
    for name, system in tyres.items():
        wanted[f"{name}.wheel_load"] = (system.wheel_load, signals_of(system.wheel_load))
        wanted[f"{name}.resistance"] = (system.resistance, signals_of(system.resistance))
    if "traffic" in wiring.systems:
        actors = wiring.systems["traffic"].GetOutputPort("signals")
        wanted["actors"] = (actors, signals_of(actors))
    # Sensors whose samples are pictures or arrays are recorded elsewhere.
    for name in parts.vehicles:
        sensors = [sensor for sensor in spec.sensors.get(name, ()) if how_recorded(wiring, f"{name}.{sensor}") is None]
        for port in (
            "status",
            "command",
            "joint_torques",
            "powertrain_status",
            "battery_status",
            "tyre_forces",
            "rear_steering",
            *sensors,
        ):
            if f"{name}.{port}" in wiring.sources:
                wanted[f"{name}.{port}"] = wiring.sources[f"{name}.{port}"]

    # Sensors and user systems may have several outputs: all vectors below their names.
    inner = [f"{full}." for full in wiring.systems if full in sensors_of(spec) and how_recorded(wiring, full) is None]
    inner += [f"{name}." for name in spec.systems if "." not in name]
    for full, (port, contents) in wiring.sources.items():
        stamp = port.get_name() == "stamp"  # -inf before the first sample
        vector = port.get_data_type() == PortDataType.kVectorValued
        if vector and full.startswith(tuple(inner)) and not (stamp and full.split(".")[0] in parts.vehicles):
            wanted[full] = (port, contents)
    # One log for all: each system of a diagram takes time in every step, even if it has nothing to do.
    sizes = {name: port.size() for name, (port, _) in wanted.items()}
    joined = Multiplexer([size for size in sizes.values() if size])  # it has no inputs without elements
    joined.set_name("log/joined")
    wiring.builder.AddSystem(joined)
    sink = wiring.builder.AddSystem(VectorLogSink(sum(sizes.values()), publish_period=1.0 / spec.record.rate))
    sink.set_name("log/signals")
    wiring.link(joined.get_output_port(), sink.get_input_port())
    taps, first = {}, 0
    inputs = iter(range(joined.num_input_ports()))
    for name, (port, contents) in wanted.items():
        if sizes[name]:
            wiring.link(port, joined.get_input_port(next(inputs)))
        taps[name] = Tap(name, sink, slice(first, first + sizes[name]), contents)
        first += sizes[name]
    taps |= _add_chosen_taps(wiring, spec, set(wanted), {name: part.vehicle for name, part in parts.vehicles.items()})
    return taps


def _add_chosen_taps(
    wiring: Wiring, spec: DiagramSpec, known: set[str], vehicles: Mapping[str, Vehicle]
) -> dict[str, Tap]:
    """Add log sinks for the signals that the patterns of record.signals choose.

    The outputs of the blocks of a control unit are functions of the present inputs. They are recorded as its actuators
    sample them: held for a period.

    Raises:
        ConfigError: a pattern chooses nothing.
    """
    # Only vectors can be recorded as columns.
    columns = {
        name: columns_of(name, port, contents)
        for name, (port, contents) in wiring.sources.items()
        if port.get_data_type() == PortDataType.kVectorValued
    }
    # Blocks that replace those of a control unit are user systems, and are recorded without a pattern.
    own_blocks = tuple(f"{name}." for name in spec.systems if "." in name)
    chosen = dict.fromkeys(name for name in columns if own_blocks and name.startswith(own_blocks))
    for index, pattern in enumerate(spec.record.inner_signals):
        names = [name for name, elements in columns.items() if is_chosen(pattern, name, elements)]
        if not names:
            place, near = where(spec, "record", "signals", index), did_you_mean(pattern, columns)
            raise ConfigError(f"no signal matches '{pattern}'; {near}. `mirdrake ports` lists all", where=place)
        chosen |= dict.fromkeys(name for name in names if name not in known)

    # A sink for each group keeps the number of systems small: hundreds of signals would slow the simulation.
    # Signals of one control unit are sampled together; each other port has a log of its own.
    groups: dict[str, list[str]] = {}
    for name in chosen:
        vehicle, _, rest = name.partition(".")
        groups.setdefault(f"{vehicle}.control" if rest.startswith("control.") else name, []).append(name)
    taps = {}
    for group, names in groups.items():
        port = wiring.sources[names[0]][0]
        contents = tuple(signal for name in names for signal in columns[name])
        if group.endswith(".control") and group not in wiring.sources:
            period = 1.0 / vehicles[group.partition(".")[0]].control.rate
            # Signals of a control unit change at its instants only; the hold samples all of them at the same time.
            sampler = HeldSignals([wiring.sources[name][0].size() for name in names], period=period)
            sampler.set_name(f"log/held/{group}")
            wiring.builder.AddSystem(sampler)
            for name, sink_port in zip(names, sampler.inputs, strict=True):
                wiring.link(wiring.sources[name][0], sink_port)
            port = sampler.get_output_port()
        sink = wiring.builder.AddSystem(VectorLogSink(port.size(), publish_period=1.0 / spec.record.rate))
        sink.set_name(f"log/{group}")
        wiring.link(port, sink.get_input_port())
        taps[group] = Tap(group, sink, slice(None), contents, is_chosen=True)
    return taps


def is_chosen(pattern: str, name: str, elements: Sequence[Signal]) -> bool:
    """Return whether a pattern of record.signals chooses an output, by its name or that of an element."""
    return any(fnmatchcase(text, pattern) for text in (name, *(signal.name for signal in elements)))


def columns_of(name: str, port: OutputPort, contents: tuple[Signal, ...] | None) -> tuple[Signal, ...]:
    """Return full names and units of the elements of an output."""
    if contents is None:
        contents = tuple(Signal(str(index), "") for index in range(port.size()))
    if len(contents) == 1:
        return (Signal(name, contents[0].unit),)
    return tuple(Signal(f"{name}.{signal.name}", signal.unit) for signal in contents)
