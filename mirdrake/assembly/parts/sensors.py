"""The sensors that a diagram uses: checks, systems, and how they are recorded."""

from collections.abc import Mapping

from mirdrake.assembly.diagram_spec import DiagramSpec, connections_of
from mirdrake.assembly.wiring import Wiring
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.signals import signals_of
from mirdrake.core.yaml_io import where
from mirdrake.plant.plant import PlantParts, VehicleInPlant
from mirdrake.sensors import make_sensor, sensor_feeds
from mirdrake.vehicles import Vehicle


def check_sensors(spec: DiagramSpec, vehicles: Mapping[str, Vehicle]) -> None:
    """Check the sensors of a diagram.

    Raises:
        ConfigError: a vehicle does not have a sensor, a sensor is named twice, or pictures of no camera are recorded.
    """
    for name, names in spec.sensors.items():
        mounts = vehicles[name].sensors.mounts
        for index, sensor in enumerate(names):
            place = where(spec, "sensors", name, index)
            if sensor not in mounts:
                raise ConfigError(
                    f"{vehicles[name].name} has no sensor '{sensor}'; {did_you_mean(sensor, mounts)}", where=place
                )
            if sensor in names[:index]:
                raise ConfigError(f"'{sensor}' is named twice; once is enough", where=place)
    # Cameras are recorded all together, so at least one must be in use.
    if spec.record.cameras and not cameras_of(spec, vehicles):
        raise ConfigError(
            "no camera is in use; name one under sensors, for example sensors: {ego: [front_camera]}",
            where=where(spec, "record", "cameras"),
        )


def cameras_of(spec: DiagramSpec, vehicles: Mapping[str, Vehicle]) -> list[tuple[str, str]]:
    """Return (vehicle, sensor) of all cameras that a diagram uses."""
    named = [(name, sensor) for name, sensors in spec.sensors.items() for sensor in sensors]
    return [(name, sensor) for name, sensor in named if vehicles[name].sensors.mounts[sensor].takes_pictures]


def sensors_of(spec: DiagramSpec) -> list[str]:
    """Return ``<vehicle>.<sensor>`` of all sensors that a diagram uses."""
    return [f"{name}.{sensor}" for name, sensors in spec.sensors.items() for sensor in sensors]


def how_recorded(wiring: Wiring, name: str) -> str | None:
    """Return how a sensor is recorded: "pictures", "array", or None as a vector among the signals."""
    return getattr(wiring.systems.get(name), "record", None)


def add_sensors(wiring: Wiring, parts: PlantParts, part: VehicleInPlant, spec: DiagramSpec) -> None:
    """Add the sensors of one vehicle; a camera only if its pictures are recorded or connected."""
    feeds = sensor_feeds(parts)
    if "traffic" in wiring.systems:
        for inputs, output in (("actor_states", "states"), ("actor_poses", "poses")):
            feeds[inputs] = wiring.systems["traffic"].GetOutputPort(output)
    for index, sensor in enumerate(spec.sensors.get(part.name, ())):
        name = f"{part.name}.{sensor}"
        if name in wiring.systems or name in wiring.sources:
            raise ConfigError(
                f"'{name}' is the name of an output of every vehicle; "
                f"rename the mount in {part.vehicle.folder / 'sensors.yaml'}",
                where=where(spec, "sensors", part.name, index),
            )
        # Rendering takes longer than everything else: a camera is added only if its pictures are used.
        unread = not any(source.startswith(f"{name}.") for source, _, _ in connections_of(spec))
        if part.vehicle.sensors.mounts[sensor].takes_pictures and unread and not spec.record.cameras:
            continue
        system = make_sensor(sensor, parts=parts, part=part, seed=spec.seed)
        wiring.add(name, system)
        for port in map(system.get_input_port, range(system.num_input_ports())):
            wiring.link(feeds[port.get_name()], port)
        for port in map(system.get_output_port, range(system.num_output_ports())):
            # The main output has the name of the sensor itself.
            full = name if port.get_name() == "sample" else f"{name}.{port.get_name()}"
            wiring.sources[full] = (port, signals_of(port))
            wiring.builder.ExportOutput(port, full)
