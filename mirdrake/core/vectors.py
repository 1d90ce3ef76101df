"""Named vectors that controllers exchange with each other, with vehicles and with logs.

Units are SI, angles in radians; x forward, y left, z up (ISO 8855); positive steering turns left. ``steering`` is
always the angle of an ideal bicycle wheel at the centre of the front axle, never the angle of a real wheel.
"""

from typing import NamedTuple

from mirdrake.core.signals import signals

WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
"""Names of the wheels, in the order of every vector of four."""

COMMAND = signals(
    ("speed", "m/s", "desired speed of the rear axle centre, forward"),
    ("steering", "rad", "desired bicycle steering angle, positive to the left"),
    ("stamp", "s", "time of the message; -inf: none yet"),
)
"""A message of a driver or of manual input."""

STATE = signals(
    ("x", "m"),
    ("y", "m"),
    ("z", "m"),
    ("roll", "rad"),
    ("pitch", "rad"),
    ("yaw", "rad"),
    ("vx", "m/s"),
    ("vy", "m/s"),
    ("vz", "m/s"),
    ("wx", "rad/s"),
    ("wy", "rad/s"),
    ("wz", "rad/s"),
)
"""Pose X_WB of the vehicle frame, velocity of its origin and angular velocity, both expressed in B."""

WHEEL_SPEEDS = signals(*((name, "rad/s") for name in WHEELS))
"""Spin rates of the wheels, positive when rolling forward."""

SPEED_RATIOS = signals(*((name, "") for name in WHEELS))
"""Speeds of the wheel centres along their wheels over that of the rear axle's centre."""

SIDES = ("left", "right")

STEERING_ANGLES = signals(*((side, "rad") for side in SIDES))
"""Angles of the two front wheels about their kingpins, positive to the left."""

PATH_ERROR = signals(
    ("lateral", "m", "offset of the rear axle centre from the centre line, positive to the left"),
    ("heading", "rad", "yaw minus the direction of the centre line, in (-pi, pi]"),
    ("progress", "m", "arc length of the nearest point of the centre line, in [0, length)"),
    ("laps", "", "distance covered along the centre line since the start, over its length"),
)
"""Position of a vehicle on its track."""


class Command(NamedTuple):
    """A message in the order of :data:`COMMAND`."""

    speed: float
    steering: float
    stamp: float


class Setpoint(NamedTuple):
    """A command after the dead-man switch and the limits: speed [m/s] and bicycle steering angle [rad]."""

    speed: float
    steering: float
