"""The sensors that a diagram names: checked, added, and how they are recorded."""

from collections.abc import Mapping

from mirdrake.assembly.diagram_spec import DiagramSpec
from mirdrake.assembly.wiring import Wiring
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.signals import signals_of
from mirdrake.core.yaml_io import where
from mirdrake.plant.plant import PlantParts, VehicleInPlant
from mirdrake.sensors import SENSORS, make_sensor, sensor_feeds
from mirdrake.vehicles import Vehicle
from mirdrake.vehicles.mounts import PictureMount


def check_sensors(spec: DiagramSpec, vehicles: Mapping[str, Vehicle]) -> None:
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
    if spec.record.cameras and not cameras_of(spec, vehicles):
        raise ConfigError(
            f"{where(spec, 'record', 'cameras')}: no camera is in use; name one under sensors, "
            "for example sensors: {ego: [front_camera]}"
        )


def cameras_of(spec: DiagramSpec, vehicles: Mapping[str, Vehicle]) -> list[tuple[str, str]]:
    """(vehicle, sensor) of the cameras of all kinds that a diagram names."""
    named = [(name, sensor) for name, sensors in spec.sensors.items() for sensor in sensors]
    return [(name, sensor) for name, sensor in named if isinstance(vehicles[name].sensors.mounts[sensor], PictureMount)]


def sensors_of(spec: DiagramSpec) -> list[str]:
    """``<vehicle>.<sensor>`` of all sensors that a diagram names."""
    return [f"{name}.{sensor}" for name, sensors in spec.sensors.items() for sensor in sensors]


def how_recorded(wiring: Wiring, name: str) -> str | None:
    """How a sensor wants to be recorded: "pictures", "array", or None as a vector among the signals."""
    return getattr(wiring.systems.get(name), "record", None)


def add_sensors(wiring: Wiring, parts: PlantParts, part: VehicleInPlant, spec: DiagramSpec) -> None:
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
