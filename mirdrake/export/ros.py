"""ROS 2 messages for an MCAP file: their definitions, and their contents in CDR encoding.

Foxglove and ROS both read sensor_msgs/msg/Imu and sensor_msgs/msg/JointState. CDR is defined in OMG's Common Object
Request Broker Architecture (formal/2021-11-03, section 9.3). It is little-endian here. Numbers are aligned to their own
size, counted from the end of the four header bytes. Texts and lists begin with their length as uint32, and texts end
with a zero byte.
"""

import struct
from collections.abc import Sequence

ENCODING, SCHEMA = "cdr", "ros2msg"

IMU = "sensor_msgs/msg/Imu"
JOINT_STATE = "sensor_msgs/msg/JointState"

_LINE = "\n" + "=" * 80 + "\n"
_HEADER = f"""\
{_LINE}MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_LINE}MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""

DEFINITIONS = {
    IMU: f"""\
std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
{_LINE}MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
{_LINE}MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
{_HEADER}""",
    JOINT_STATE: f"""\
std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
{_HEADER}""",
}
"""Definition of each message with those of its fields."""


class Ros2Message:
    """Contents of a message.

    Args:
        kind: key of :data:`DEFINITIONS`.
        time: time of the header [ns].
        frame: frame of the header.
    """

    def __init__(self, kind: str, time: int, frame: str) -> None:
        self.kind = kind
        self._data = bytearray()
        seconds, rest = divmod(time, 10**9)
        self._add("i", seconds)
        self._add("I", rest)
        self._text(frame)

    def bytes(self) -> bytes:
        """Return the message in CDR."""
        # Header of the encapsulation: CDR, little-endian, no options.
        return b"\x00\x01\x00\x00" + bytes(self._data)

    def numbers(self, values: Sequence[float]) -> "Ros2Message":
        """Add an array of float64 of fixed length."""
        for value in values:
            self._add("d", value)
        return self

    def number_list(self, values: Sequence[float]) -> "Ros2Message":
        """Add a list of float64."""
        self._add("I", len(values))
        return self.numbers(values)

    def text_list(self, values: Sequence[str]) -> "Ros2Message":
        """Add a list of texts."""
        self._add("I", len(values))
        for value in values:
            self._text(value)
        return self

    def _text(self, value: str) -> None:
        # The length includes the zero byte at the end.
        data = value.encode() + b"\0"
        self._add("I", len(data))
        self._data += data

    def _add(self, code: str, value: float) -> None:
        # A number is aligned to its own size.
        self._data += b"\0" * (-len(self._data) % struct.calcsize(code))
        self._data += struct.pack(f"<{code}", value)


def imu_message(time: int, frame: str, rate: Sequence[float], acceleration: Sequence[float]) -> Ros2Message:
    """Return an Imu message without orientation: the first element of its covariance is -1.

    Args:
        time: time of the sample [ns].
        frame: frame of the sensor.
        rate: angular velocity along x, y, z [rad/s].
        acceleration: specific force along x, y, z [m/s²].
    """
    unknown = [0.0] * 9  # covariances of zero mean unknown
    message = Ros2Message(IMU, time, frame).numbers([0.0, 0.0, 0.0, 1.0]).numbers([-1.0, *unknown[1:]])
    return message.numbers(rate).numbers(unknown).numbers(acceleration).numbers(unknown)


def joint_message(time: int, names: Sequence[str], positions: Sequence[float], rates: Sequence[float]) -> Ros2Message:
    """Return a JointState message without efforts.

    Args:
        time: time of the sample [ns].
        names: names of the joints.
        positions: positions [rad] or [m].
        rates: velocities [rad/s] or [m/s]; NaN where none was recorded.
    """
    return Ros2Message(JOINT_STATE, time, "").text_list(names).number_list(positions).number_list(rates).number_list([])
