"""The control unit of one vehicle in a diagram: one fused system, or a Diagram of its blocks."""

from pathlib import Path

from pydrake.systems.framework import System

from mirdrake.assembly.blocks import make_block
from mirdrake.assembly.diagram_spec import DiagramSpec
from mirdrake.assembly.parts.taps import columns_of, is_chosen
from mirdrake.assembly.wiring import JOIN, Wiring
from mirdrake.controllers.control_diagram import expand_control
from mirdrake.controllers.vehicle_control import VehicleControl
from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import Source, where
from mirdrake.plant.plant import PlantParts, VehicleInPlant

# Steps of a control unit for which machine code is faster: it takes up to 0.1 s to load, and saves 20 µs in each step.
_COMPILED = 1000


def uses_machine_code(spec: DiagramSpec, part: VehicleInPlant) -> bool:
    """Return whether control unit and powertrain of a vehicle are compiled."""
    given = spec.plant.machine_code
    return spec.duration * part.vehicle.control.rate >= _COMPILED if given is None else given


def is_expanded(spec: DiagramSpec, unit: VehicleControl, name: str) -> bool:
    """Return whether a diagram needs the blocks of a vehicle's control unit: to replace, connect or record one."""
    prefix = f"{name}.control."
    patterns = spec.record.inner_signals
    named = [*spec.systems, *(end for pair in spec.connect for end in pair), *patterns]
    return (
        any(text.startswith(prefix) and text.removeprefix(prefix) not in JOIN for text in named)
        or bool(unit.vehicle.control.disabled_blocks())
        or (bool(patterns) and _records_blocks(patterns, unit, prefix))
    )


def _records_blocks(patterns: list[str], unit: VehicleControl, prefix: str) -> bool:
    """Return whether patterns of record.signals choose an output of a block of a control unit."""
    # The blocks are made for their names alone: what they are called is known nowhere else.
    columns = {prefix + name: columns_of(prefix + name, *port) for name, port in expand_control(unit).outputs.items()}
    return any(is_chosen(pattern, name, elements) for pattern in patterns for name, elements in columns.items())


def add_control(wiring: Wiring, parts: PlantParts, part: VehicleInPlant, spec: DiagramSpec, *, expand: bool) -> System:
    """Add the control unit of a vehicle: one fused system, or its blocks if the diagram needs them.

    Args:
        wiring: the diagram under construction.
        parts: plant and vehicles.
        part: the vehicle.
        spec: the diagram.
        expand: whether to add the blocks even if nothing refers to them.
    """
    unit = VehicleControl(parts.plant, part, machine_code=uses_machine_code(spec, part))
    if not expand and not is_expanded(spec, unit, part.name):
        wiring.add(f"{part.name}.control", unit)
        return unit
    prefix = f"{part.name}.control."
    replaced, folder = {}, Path(spec.folder) if spec.folder is not None else None
    for name, entry in spec.systems.items():
        if name.startswith(prefix):
            source = entry._source or Source("diagram", {}, ("systems", name))
            replaced[name.removeprefix(prefix)] = make_block(
                entry.kind, entry.parameters(), source=source, folder=folder, factory=wiring.factories.get(name)
            )
    # Inputs of blocks that the user connects must be ports of the unit; names are vehicle.control.block.port.
    opened = {".".join(sink.split(".")[2:4]) for _, sink in spec.connect if sink.startswith(prefix)}
    try:
        control = expand_control(unit, replaced=replaced, opened=opened)
    except ConfigError as error:
        # The line of the block: a file may replace several.
        block = [f"{prefix}{error.path[0]}"] if error.path else []
        raise ConfigError(error.text, where=where(spec, "systems", *block)) from None
    wiring.add(f"{part.name}.control", control.diagram)
    wiring.blocks[f"{part.name}.control"] = control
    for name, port in control.outputs.items():
        wiring.sources[prefix + name] = port
        # A block with one vector output lets its elements be named without the port.
        if len(port[1] or ()) > 1:
            wiring.name_elements(prefix + name, prefix + name.split(".")[0])
    wiring.sinks |= {prefix + name: port for name, port in control.inputs.items()}
    # Inputs connected within the unit may be named, but are not open.
    wiring.inner |= {prefix + name for name in control.inputs if name not in opened and name not in control.open}
    wiring.open |= {prefix + name for name in control.open}
    wiring.defaults += [(prefix + source, prefix + sink) for source, sink in control.defaults]
    return control.diagram
