"""Road wheel angle from the recorded steering channel: ratio, offset, delay, lag, backlash."""

from collections.abc import Mapping

import numpy as np

from mirdrake.identification.models.base import Array, Segment
from mirdrake.identification.models.filters import backlash, first_order
from mirdrake.identification.parameters import Parameter

STEERING = ("road_wheel_angle", "steering_wheel_angle", "steering_command")
STEERING_PARAMETERS = frozenset(
    {"steering_ratio", "steering_offset", "steering_delay", "steering_lag", "steering_backlash"}
)

SETPOINT_DELAY = 0.03
"""Dead time above which a recorded road wheel angle is taken for its set-point [s]; the relaxation of a car's tyres
alone looks like 20 ms."""

_FINER = 4

_RATIO = {"road_wheel_angle": 1.0, "steering_wheel_angle": 15.0, "steering_command": 1.5}


def steering_parameters(channel: str) -> tuple[Parameter, ...]:
    """Return the parameters between a steering channel and the road wheels."""
    # A command has no unit, so the unit of its ratio is per radian.
    wheels = channel == "road_wheel_angle"
    unit = "1" if channel != "steering_command" else "1/rad"
    low, high = (0.3, 3.0) if wheels else (0.02, 100.0)
    return (
        Parameter("steering_ratio", unit, f"{channel} over the road wheel angle", _RATIO[channel], low, high,
                  free=not wheels, usual=1.0, source="the channel is the road wheel angle" if wheels else ""),
        # 0.01 rad are 9 degrees of a hand wheel.
        Parameter("steering_offset", "rad", "road wheel angle at zero of the channel", 0.0, -0.2, 0.2, True, 0.01,
                  usual=1.0),
        # A cause precedes its effect: only skewed clocks of the channels make a dead time negative.
        Parameter("steering_delay", "s", "dead time of the steering", 0.02, -0.1, 0.5, True, 0.05, usual=1.0,
                  unlikely=-0.02),
        Parameter("steering_lag", "s", "time constant of the steering", 0.0, 0.0, 1.0, False, 0.05, usual=2.0),
        Parameter("steering_backlash", "rad", "backlash as road wheel angle from end to end", 0.0, 0.0, 0.1, False,
                  0.002, usual=5.0),
    )  # fmt: skip


def steering_angle(p: Mapping[str, float], drive: Segment, channel: str, times: Array) -> Array:
    """Return the road wheel angle (times) [rad]."""
    wide, early = drive.with_history(times)
    # The discrete lag is exact for straight lines, so the smooth input is approximated by short ones.
    finer = _FINER if p["steering_lag"] > 0.0 else 1
    step = float(times[1] - times[0]) / finer
    fine = wide[0] + step * np.arange(finer * (len(wide) - 1) + 1)
    # Order of the parts of a steering: delay and lag of the actuator, then the backlash of the linkage.
    angle = drive.at(channel, fine, p["steering_delay"], smooth=True) / p["steering_ratio"]
    angle = first_order(angle, step, p["steering_lag"])[::finer]
    if p["steering_backlash"] > 0.0:
        angle = backlash(angle, p["steering_backlash"])
    return angle[early:] + p["steering_offset"]
