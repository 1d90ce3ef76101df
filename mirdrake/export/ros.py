"""ROS 2 messages for an MCAP file: their definitions, and their contents in CDR encoding, by rosbags.

Foxglove and ROS both read sensor_msgs/msg/Imu and sensor_msgs/msg/JointState.
"""

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from mirdrake.core.extras import import_extra

ENCODING, SCHEMA = "cdr", "ros2msg"
NEED = "MCAP needs some packages"

IMU = "sensor_msgs/msg/Imu"
JOINT_STATE = "sensor_msgs/msg/JointState"


class Ros2Message(NamedTuple):
    """A message.

    Attributes:
        kind: name of its type.
        data: its contents in CDR.
    """

    kind: str
    data: bytes


@cache
def _types() -> Any:
    """Return the message types of ROS 2 Humble."""
    typesys = import_extra("rosbags.typesys", need=NEED, extra="mcap")
    return typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)


def definition(kind: str) -> str:
    """Return the definition of a message type with those of its fields."""
    return str(_types().generate_msgdef(kind, ros_version=2)[0])


def _message(kind: str, time: int, frame: str, **fields: Any) -> Ros2Message:
    types = _types().types
    seconds, rest = divmod(time, 10**9)
    stamp = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=rest)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)
    return Ros2Message(kind, bytes(_types().serialize_cdr(types[kind](header=header, **fields), kind)))


def imu_message(time: int, frame: str, rate: Sequence[float], acceleration: Sequence[float]) -> Ros2Message:
    """Return an Imu message without orientation: the first element of its covariance is -1.

    Args:
        time: time of the sample [ns].
        frame: frame of the sensor.
        rate: angular velocity along x, y, z [rad/s].
        acceleration: specific force along x, y, z [m/s²].
    """
    types = _types().types
    vector = types["geometry_msgs/msg/Vector3"]
    unknown = np.zeros(9)  # covariances of zero mean unknown
    return _message(
        IMU, time, frame,
        orientation=types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
        orientation_covariance=np.array([-1.0, *unknown[1:]]),
        angular_velocity=vector(*rate), angular_velocity_covariance=unknown,
        linear_acceleration=vector(*acceleration), linear_acceleration_covariance=unknown,
    )  # fmt: skip


def joint_message(time: int, names: Sequence[str], positions: Sequence[float], rates: Sequence[float]) -> Ros2Message:
    """Return a JointState message without efforts.

    Args:
        time: time of the sample [ns].
        names: names of the joints.
        positions: positions [rad] or [m].
        rates: velocities [rad/s] or [m/s]; NaN where none was recorded.
    """
    values = {"position": np.array(positions), "velocity": np.array(rates), "effort": np.zeros(0)}
    return _message(JOINT_STATE, time, "", name=list(names), **values)
