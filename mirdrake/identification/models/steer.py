"""From the recorded steering channel to the angle of the front wheels: scale, offset, delay, lag, backlash."""

from collections.abc import Mapping

import numpy as np

from mirdrake.identification.models.base import Array, Segment, first_order
from mirdrake.identification.parameters import Parameter

STEERING = ("road_wheel_angle", "steering_wheel_angle", "steering_command")
STEERING_PARAMETERS = frozenset(
    {"steering_ratio", "steering_offset", "steering_delay", "steering_lag", "steering_backlash"}
)

AHEAD = 0.03
"""Dead time from which on a recorded angle of the wheels is what they were asked for, and not where they are [s]: the
tyres of a car, which relax, are late by 20 ms."""

_FINER = 4

_RATIO = {"road_wheel_angle": 1.0, "steering_wheel_angle": 15.0, "steering_command": 1.5}


def steering_parameters(channel: str) -> tuple[Parameter, ...]:
    """Parameters of the way from a steering channel to the wheels."""
    wheels = channel == "road_wheel_angle"
    unit = "1" if channel != "steering_command" else "1/rad"
    low, high = (0.3, 3.0) if wheels else (0.02, 100.0)
    return (
        Parameter(
            "steering_ratio",
            unit,
            f"{channel} over the angle of the front wheels",
            _RATIO[channel],
            low,
            high,
            free=not wheels,
            usual=1.0,
            source="the channel is the angle of the wheels" if wheels else "",
        ),
        Parameter(
            "steering_offset",
            "rad",
            "angle of the wheels at zero of the channel",
            0.0,
            -0.2,
            0.2,
            True,
            0.01,
            usual=5.0,
        ),
        Parameter("steering_delay", "s", "dead time of the steering", 0.02, -0.1, 0.5, True, 0.05, usual=2.0),
        Parameter("steering_lag", "s", "time constant of the steering", 0.0, 0.0, 1.0, False, 0.05, usual=2.0),
        Parameter(
            "steering_backlash",
            "rad",
            "play, as angle of the wheels from end to end",
            0.0,
            0.0,
            0.1,
            False,
            0.002,
            usual=5.0,
        ),
    )


def steering_angle(p: Mapping[str, float], drive: Segment, channel: str, times: Array) -> Array:
    """Angle of the front wheels (times) [rad]."""
    wide, early = drive.with_history(times)
    # A lag is exact for straight lines: short ones.
    many = _FINER if p["steering_lag"] > 0.0 else 1
    step = float(times[1] - times[0]) / many
    fine = wide[0] + step * np.arange(many * (len(wide) - 1) + 1)
    angle = drive.at(channel, fine, p["steering_delay"], smooth=True) / p["steering_ratio"]
    angle = first_order(angle, step, p["steering_lag"])[::many]
    if p["steering_backlash"] > 0.0:
        angle = play(angle, p["steering_backlash"])
    return angle[early:] + p["steering_offset"]


def play(values: Array, width: float) -> Array:
    """What is behind a play of a width, from end to end; it starts in its middle."""
    half, now, found = 0.5 * width, float(values[0]), np.empty(len(values))
    for i, value in enumerate(values.tolist()):
        now = min(max(now, value - half), value + half)
        found[i] = now
    return found
