"""Sensors of a vehicle.

A new kind is a module with a function ``make_...`` and a line in :data:`SENSORS`; its data are a Mount in
:mod:`mirdrake.vehicles.mounts`. The system's inputs are named after what they need (:func:`sensor_feeds`); its output
``sample`` is known as ``<vehicle>.<sensor>`` and recorded, others are ``<vehicle>.<sensor>.<port>``.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from pydrake.systems.framework import OutputPort, System

from mirdrake.sensors.cameras import Camera, make_camera
from mirdrake.sensors.gps import Gps, make_gps
from mirdrake.sensors.ground_truth import GroundTruth, TruthSensor, make_ground_truth
from mirdrake.sensors.imu import Imu, make_imu
from mirdrake.sensors.noise import noise_stream
from mirdrake.sensors.ranging import (
    LaserScanner,
    Lidar,
    LidarScan,
    Radar,
    Sonar,
    make_laser_scanner,
    make_lidar,
    make_radar,
    make_sonar,
)
from mirdrake.sensors.steering_angle import SteeringAngle, make_steering_angle
from mirdrake.sensors.wheel_encoder import WheelEncoder, make_wheel_encoder

if TYPE_CHECKING:
    from mirdrake.plant.plant import PlantParts, VehicleInPlant

__all__ = [
    "SENSORS",
    "Camera",
    "Gps",
    "GroundTruth",
    "Imu",
    "LaserScanner",
    "Lidar",
    "LidarScan",
    "Radar",
    "Sonar",
    "SteeringAngle",
    "TruthSensor",
    "WheelEncoder",
    "make_sensor",
    "sensor_feeds",
]

SENSORS: dict[str, Callable[..., System]] = {
    "camera": make_camera,
    "depth_camera": make_camera,
    "gps": make_gps,
    "ground_truth": make_ground_truth,
    "imu": make_imu,
    "laser_scanner": make_laser_scanner,
    "lidar": make_lidar,
    "radar": make_radar,
    "sonar": make_sonar,
    "steering_angle": make_steering_angle,
    "stereo_camera": make_camera,
    "wheel_encoder": make_wheel_encoder,
}
"""Function that makes the system of each kind in sensors.yaml."""


def make_sensor(name: str, *, parts: "PlantParts", part: "VehicleInPlant", seed: int) -> System:
    """Return the system of a mounted sensor.

    Args:
        name: of the mount in the vehicle's sensors.yaml.
        parts: plant, scene graph and world.
        part: the vehicle.
        seed: of the whole diagram; each sensor has a stream of its own.

    Raises:
        MissingDependencyError: a camera, and nothing to render with.
    """
    mount: Any = part.vehicle.sensors.mounts[name]
    return SENSORS[mount.kind](mount, parts=parts, part=part, stream=noise_stream(seed, f"{part.name}.{name}"))


def sensor_feeds(parts: "PlantParts") -> dict[str, OutputPort]:
    """Return the output ports to which inputs of sensors are connected, by the names of the inputs."""
    plant, scene_graph = parts.plant, parts.scene_graph
    return {
        "plant_state": plant.get_state_output_port(),
        "body_poses": plant.get_body_poses_output_port(),
        "body_spatial_velocities": plant.get_body_spatial_velocities_output_port(),
        "body_spatial_accelerations": plant.get_body_spatial_accelerations_output_port(),
        "query_object": scene_graph.get_query_output_port(),
    }
