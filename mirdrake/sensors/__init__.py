"""Sensors of a vehicle.

A kind is a module with a system and its mount, a class derived from :class:`mirdrake.sensors.mount.SensorMount`, and a
line in :data:`mirdrake.vehicles.mounts.SENSORS`. The inputs of the system are named after what they need
(:func:`sensor_feeds`); its output ``sample`` is known as ``<vehicle>.<sensor>`` and recorded, others are
``<vehicle>.<sensor>.<port>``.
"""

from typing import TYPE_CHECKING

from pydrake.systems.framework import OutputPort, System

from mirdrake.sensors.mount import SensorMount
from mirdrake.sensors.noise import noise_stream

if TYPE_CHECKING:
    from mirdrake.plant.plant import PlantParts, VehicleInPlant

__all__ = ["make_sensor", "sensor_feeds"]


def make_sensor(name: str, *, parts: "PlantParts", part: "VehicleInPlant", seed: int) -> System:
    """Return the system of a mounted sensor.

    Args:
        name: name of the mount in the vehicle's sensors.yaml.
        parts: plant, scene graph and world.
        part: the vehicle.
        seed: seed of the whole diagram; each sensor has its own random stream.

    Raises:
        MissingDependencyError: a package or driver that the sensor needs is not installed.
    """
    mount = part.vehicle.sensors.mounts[name]
    assert isinstance(mount, SensorMount)
    return mount.make(parts=parts, part=part, stream=noise_stream(seed, f"{part.name}.{name}"))


def sensor_feeds(parts: "PlantParts") -> dict[str, OutputPort]:
    """Return the output ports that inputs of sensors are connected to, by the names of the inputs."""
    plant, scene_graph = parts.plant, parts.scene_graph
    return {
        "plant_state": plant.get_state_output_port(),
        "body_poses": plant.get_body_poses_output_port(),
        "body_spatial_velocities": plant.get_body_spatial_velocities_output_port(),
        "body_spatial_accelerations": plant.get_body_spatial_accelerations_output_port(),
        "query_object": scene_graph.get_query_output_port(),
    }
