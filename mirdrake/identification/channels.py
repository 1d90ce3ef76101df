"""Channels of a log: names, SI units and signs.

Axes and signs are those of ISO 8855: x forward, y to the left, z up; angles and rates are positive to the left (yaw),
to the right (roll) and nose down (pitch). Velocities and accelerations are those of the sensor's position, in the frame
of the vehicle, and accelerations contain gravity. A second measurement of a quantity has its source in the name:
``yaw_rate`` and ``yaw_rate@imu``.
"""

from typing import NamedTuple

from mirdrake.core.errors import did_you_mean


class Channel(NamedTuple):
    """Definition of a channel.

    Attributes:
        unit: SI unit; "1" for a pure number.
        meaning: what it measures, and its positive direction.
        limit: magnitude that no road vehicle or robot reaches [unit].
        moves: whether it is a measured motion that changes from sample to sample; pedals and codes may be constant.
        jumps: whether it may change by any amount within a sample, as forces do; speeds and positions do not.
    """

    unit: str
    meaning: str
    limit: float
    moves: bool = True
    jumps: bool = False


WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
AXLES = ("front", "rear")

CHANNELS: dict[str, Channel] = {
    "speed": Channel("m/s", "over ground, along the path", 150.0),
    "vx": Channel("m/s", "velocity forward", 150.0),
    "vy": Channel("m/s", "velocity to the left", 60.0),
    "yaw_rate": Channel("rad/s", "to the left", 30.0),
    "roll_rate": Channel("rad/s", "to the right", 30.0, jumps=True),
    "pitch_rate": Channel("rad/s", "nose down", 30.0, jumps=True),
    "longitudinal_acceleration": Channel("m/s^2", "forward", 200.0, jumps=True),
    "lateral_acceleration": Channel("m/s^2", "to the left", 200.0, jumps=True),
    "vertical_acceleration": Channel("m/s^2", "up", 500.0),
    "yaw": Channel("rad", "to the left", 1e4),
    "roll": Channel("rad", "to the right", 4.0),
    "pitch": Channel("rad", "nose down", 4.0),
    "sideslip": Channel("rad", "to the left", 4.0),
    "x": Channel("m", "position on the ground", 1e8),
    "y": Channel("m", "position on the ground, 90 degrees left of x", 1e8),
    "latitude": Channel("rad", "of the position, WGS 84, north", 1.6),
    "longitude": Channel("rad", "of the position, WGS 84, east", 6.3),
    "steering_wheel_angle": Channel("rad", "hand wheel angle, to the left", 40.0),
    "road_wheel_angle": Channel("rad", "angle of the front wheels, to the left", 4.0),
    "road_wheel_angle_left": Channel("rad", "angle of the left front wheel, to the left", 4.0),
    "road_wheel_angle_right": Channel("rad", "angle of the right front wheel, to the left", 4.0),
    "steering_command": Channel("1", "set-point in any unit, to the left", 1e6, jumps=True),
    "steering_torque": Channel("N m", "at the hand wheel, to the left", 1e4, jumps=True),
    "speed_command": Channel("m/s", "set-point of the speed", 150.0, moves=False),
    "throttle": Channel("1", "pedal, 0 to 1", 10.0, moves=False),
    "brake": Channel("1", "pedal, 0 to 1", 10.0, moves=False),
    "gear": Channel("1", "code of the gear", 100.0, moves=False),
    "engine_speed": Channel("rad/s", "of the engine or motor", 1e4),
    "drive_torque": Channel("N m", "at the wheels, forward", 1e6, jumps=True),
    "brake_torque": Channel("N m", "at the wheels, as logged", 1e6, jumps=True),
    "grade": Channel("rad", "of the road, upward", 1.6),
    "bank": Channel("rad", "of the road, the left side up", 1.6),
    **{f"wheel_speed_{wheel}": Channel("m/s", "of the wheel's rim, forward", 300.0) for wheel in WHEELS},
    **{f"wheel_rate_{wheel}": Channel("rad/s", "of the wheel, forward", 3e3) for wheel in WHEELS},
    **{f"suspension_travel_{wheel}": Channel("m", "of the wheel, positive in bump", 2.0) for wheel in WHEELS},
    **{f"road_height_{wheel}": Channel("m", "of the road under the wheel", 1e4) for wheel in WHEELS},
    **{
        f"suspension_travel_{axle}": Channel("m", f"mean of the {axle} wheels, positive in bump", 2.0) for axle in AXLES
    },
    **{f"road_height_{axle}": Channel("m", f"of the road, mean of the {axle} wheels", 1e4) for axle in AXLES},
    **{
        f"tyre_force_x_{wheel}": Channel("N", "on the tyre along the wheel, forward", 1e6, jumps=True)
        for wheel in WHEELS
    },
    **{
        f"tyre_force_y_{wheel}": Channel("N", "on the tyre across the wheel, to the left", 1e6, jumps=True)
        for wheel in WHEELS
    },
    **{f"tyre_force_z_{wheel}": Channel("N", "on the tyre, up", 1e6) for wheel in WHEELS},
}


def quantity(name: str) -> str:
    """Return the name of a channel without its source: ``yaw_rate`` for ``yaw_rate@imu``."""
    return name.partition("@")[0]


def channel(name: str) -> Channel:
    """Return the definition of a channel.

    Raises:
        ValueError: the channel is unknown.
    """
    known = CHANNELS.get(quantity(name))
    if known is None:
        raise ValueError(f"unknown channel '{name}'; {did_you_mean(quantity(name), CHANNELS)}")
    return known
