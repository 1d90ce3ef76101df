"""Signals at the ports of the single-track model."""

from mirdrake.core.signals import signals

STEERING = signals(
    ("steering", "rad", "bicycle steering angle, positive to the left"),
    ("steering_rate", "rad/s", "rate of its set-point"),
)
FORCES = signals(
    ("drive", "N", "drive force at the road, negative for engine braking"),
    ("brake", "N", "brake force at the road, positive"),
    ("speed", "m/s", "set-point of the wheel servos"),
)
MOTION = signals(
    ("sideslip", "rad", "sideslip angle of the centre of mass"),
    ("longitudinal_acceleration", "m/s²", "of the centre of mass"),
    ("lateral_acceleration", "m/s²", "of the centre of mass"),
    ("front_slip_angle", "rad", "positive when the axle moves to its left"),
    ("rear_slip_angle", "rad", "positive when the axle moves to its left"),
    ("front_lateral_force", "N", "on the front axle, across its wheels"),
    ("rear_lateral_force", "N", "on the rear axle"),
)
"""Handling quantities; slips and forces are zero in the kinematic model."""
