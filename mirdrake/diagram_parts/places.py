"""The vehicles of a diagram and where they start."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations
from math import hypot
from typing import Any

from mirdrake.diagram_spec import DiagramSpec, Place
from mirdrake.errors import ConfigError
from mirdrake.vehicles import Vehicle, load_vehicle
from mirdrake.vehicles.mounts import change_mounts
from mirdrake.vehicles.spec import ControlSpec
from mirdrake.vehicles.vehicle import check_pedals
from mirdrake.worlds import Start, World
from mirdrake.yaml_io import Source, validate, where
from mirdrake.yaml_tree import lay_over


def load_by_name(spec: DiagramSpec, name: str) -> Vehicle:
    """The vehicle of one entry of ``vehicles``, with the diagram's changes to its control and mounted sensors."""
    entry = spec.vehicles[name]
    vehicle = load_vehicle(entry.model, arguments=entry.arguments, where=where(spec, "vehicles", name, "model"))
    source = entry._source or Source("diagram", {}, ("vehicles", name))
    if entry.control:
        place = source._replace(prefix=(*source.prefix, "control"))
        control = change_control(vehicle.control, entry.control, source=place)
        check_pedals(vehicle.spec, control)
        vehicle = replace(vehicle, control=control)
    if not entry.mounts:
        return vehicle
    source = source._replace(prefix=(*source.prefix, "mounts"))
    return replace(vehicle, sensors=change_mounts(vehicle.sensors, entry.mounts, source=source))


def change_control(control: ControlSpec, changes: Mapping[str, Any], *, source: Source) -> ControlSpec:
    """Gains and limits with some entries changed; an entry of another kind is replaced as a whole.

    Args:
        control: of a vehicle.
        changes: a part of control.yaml.
        source: where the changes were written, for errors.

    Raises:
        ConfigError: no such entry, or a value out of range.
    """
    below = (control._source or Source("control", {}))._replace(prefix=())
    data, places = lay_over(control.model_dump(exclude_unset=True), below, dict(changes), source)
    return validate(data, ControlSpec, places)


def find_start(spec: DiagramSpec, name: str, world: World) -> Start:
    """Where a vehicle starts: at a place of its own, at a start of the world, or at the origin."""
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


def check_starts(spec: DiagramSpec, vehicles: Mapping[str, Vehicle], starts: Mapping[str, Start]) -> None:
    """Refuse vehicles that start inside one another: nearer than a track width, however they are turned."""
    for (first, a), (second, b) in combinations(starts.items(), 2):
        width = min(vehicles[name].geometry.rear_track for name in (first, second))
        if hypot(a.x - b.x, a.y - b.y) < width:
            raise ConfigError(
                f"{where(spec, 'vehicles', second, 'start')}: '{second}' starts where '{first}' stands, at "
                f"({b.x:g}, {b.y:g}) m; give each vehicle a start of its own"
            )
