"""Schema of sensors.yaml: the sensors of a vehicle, each mounted in a frame.

A kind of sensor is a class derived from :class:`mirdrake.sensors.mount.SensorMount`, and a line here.
"""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.kinds import SelectedByKind
from mirdrake.core.yaml_io import Schema, Source, validate
from mirdrake.core.yaml_tree import below_preset
from mirdrake.vehicles.mount import Mount
from mirdrake.vehicles.presets import with_preset

SENSORS: dict[str, str] = {
    "camera": "mirdrake.sensors.cameras.mounts:CameraMount",
    "depth_camera": "mirdrake.sensors.cameras.mounts:DepthCameraMount",
    "gps": "mirdrake.sensors.gps:GpsMount",
    "ground_truth": "mirdrake.sensors.ground_truth:GroundTruthMount",
    "imu": "mirdrake.sensors.imu:ImuMount",
    "laser_scanner": "mirdrake.sensors.ranging.laser_scanner:LaserScannerMount",
    "lidar": "mirdrake.sensors.ranging.lidar:LidarMount",
    "radar": "mirdrake.sensors.ranging.radar:RadarMount",
    "sonar": "mirdrake.sensors.ranging.sonar:SonarMount",
    "steering_angle": "mirdrake.sensors.steering_angle:SteeringAngleMount",
    "stereo_camera": "mirdrake.sensors.cameras.mounts:StereoCameraMount",
    "wheel_encoder": "mirdrake.sensors.wheel_encoder:WheelEncoderMount",
}
"""Class of each kind in sensors.yaml, imported when a file has a sensor of that kind."""

SENSOR_KINDS: SelectedByKind[Mount] = SelectedByKind(SENSORS)
"""Classes of :data:`SENSORS` by kind."""


class SensorsSpec(Schema):
    """sensors.yaml: the mounted sensors by name."""

    mounts: dict[str, Annotated[Mount, SENSOR_KINDS, BeforeValidator(with_preset)]] = Field(default_factory=dict)


def change_mounts(sensors: SensorsSpec, changes: Mapping[str, Mapping[str, Any]], *, source: Source) -> SensorsSpec:
    """Return mounted sensors with some keys changed; a preset replaces all keys except frame and datum.

    Args:
        sensors: sensors of a vehicle.
        changes: changed keys by the name of the mount.
        source: file of the changes, for messages.

    Raises:
        ConfigError: a mount or key does not exist, or a value is out of range.
    """
    mounts = dict(sensors.mounts)
    for name, keys in changes.items():
        if name not in mounts:
            raise ConfigError(f"no sensor '{name}' is mounted; {did_you_mean(name, mounts)}", where=source.where(name))
        # Keys that were given before stay only where a new preset does not replace them.
        data = below_preset(mounts[name].model_dump(exclude_unset=True), keys) | dict(keys)
        location = source._replace(prefix=(*source.prefix, name))
        try:
            data = with_preset(data)
        except ValueError as error:
            raise ConfigError(str(error), where=location.where("preset")) from None
        # A preset may be of another kind than the sensor that it replaces.
        kind = str(data.get("kind"))
        mounts[name] = validate(data, SENSOR_KINDS[kind] if kind in SENSORS else type(mounts[name]), location)
    return SensorsSpec(mounts=mounts)
