"""Channels of the messages of ROS and of vehicle interfaces: which field of which type is which channel.

A new type is one line of :data:`MESSAGE_FIELDS`. Names of types are written without ``/msg``.
"""

_TWIST = {"linear.x": ("vx", "m/s"), "linear.y": ("vy", "m/s"), "angular.z": ("yaw_rate", "rad/s")}
_POSE = {"position.x": ("x", "m"), "position.y": ("y", "m"), "orientation.yaw": ("yaw", "rad")}
_COMMAND = {"speed": ("speed_command", "m/s"), "steering_angle": ("steering_command", "1")}

Fields = dict[str, tuple[str, str]]
"""Channel and unit by field."""


def _below(prefix: str, fields: Fields) -> Fields:
    return {f"{prefix}.{name}": entry for name, entry in fields.items()}


MESSAGE_FIELDS: dict[str, Fields] = {
    "sensor_msgs/Imu": {
        "angular_velocity.x": ("roll_rate", "rad/s"), "angular_velocity.y": ("pitch_rate", "rad/s"),
        "angular_velocity.z": ("yaw_rate", "rad/s"), "linear_acceleration.x": ("longitudinal_acceleration", "m/s^2"),
        "linear_acceleration.y": ("lateral_acceleration", "m/s^2"),
        "linear_acceleration.z": ("vertical_acceleration", "m/s^2"),
    },
    "nav_msgs/Odometry": _below("twist.twist", _TWIST) | _below("pose.pose", _POSE),
    "geometry_msgs/TwistStamped": _below("twist", _TWIST),
    "geometry_msgs/TwistWithCovarianceStamped": _below("twist.twist", _TWIST),
    "geometry_msgs/PoseStamped": _below("pose", _POSE),
    "geometry_msgs/PoseWithCovarianceStamped": _below("pose.pose", _POSE),
    "sensor_msgs/NavSatFix": {"latitude": ("latitude", "deg"), "longitude": ("longitude", "deg")},
    "gps_common/GPSFix": {
        "latitude": ("latitude", "deg"), "longitude": ("longitude", "deg"), "speed": ("speed", "m/s"),
    },
    "geometry_msgs/Twist": {"linear.x": ("speed_command", "m/s")},
    "ackermann_msgs/AckermannDrive": _COMMAND,
    "ackermann_msgs/AckermannDriveStamped": _below("drive", _COMMAND),
    "autoware_vehicle_msgs/SteeringReport": {"steering_tire_angle": ("road_wheel_angle", "rad")},
    "autoware_vehicle_msgs/VelocityReport": {
        "longitudinal_velocity": ("vx", "m/s"), "lateral_velocity": ("vy", "m/s"),
        "heading_rate": ("yaw_rate", "rad/s"),
    },
    "dbw_mkz_msgs/SteeringReport": {
        "steering_wheel_angle": ("steering_wheel_angle", "rad"), "speed": ("speed", "m/s"),
        "steering_wheel_torque": ("steering_torque", "N m"),
    },
    "dbw_mkz_msgs/ThrottleReport": {"pedal_output": ("throttle", "1")},
    "dbw_mkz_msgs/BrakeReport": {"pedal_output": ("brake", "1"), "torque_output": ("brake_torque", "N m")},
}  # fmt: skip
"""Channel and unit by field, by type of message; ``geometry_msgs/Twist`` without a stamp is a command."""


def fields_of(kind: str) -> Fields:
    """Return the known fields of a type, such as ``sensor_msgs/msg/Imu``; empty for others."""
    bare = kind.replace("/msg/", "/").replace(".msg.", "/").replace("::msg::dds_::", "/").rstrip("_")
    return MESSAGE_FIELDS.get(bare, MESSAGE_FIELDS.get(bare.replace("autoware_auto_", "autoware_"), {}))
