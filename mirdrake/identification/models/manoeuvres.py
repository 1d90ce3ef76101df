"""Standard manoeuvres as channels over time, for the experiment design."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from mirdrake.identification.models.steer import STEERING

Array = NDArray[np.float64]

STEP, DURATION = 0.01, 20.0
LATERAL = 3.0
"""Lateral acceleration of a neutral-steering car [m/s²]."""

MAX_ANGLE = 0.5
"""Largest road wheel angle [rad]; most steerings reach 0.5 to 0.7 rad. A slow or long vehicle turns with less than
:data:`LATERAL`."""


def steering_manoeuvres(speed: float, wheelbase: float) -> dict[str, tuple[Array, Array]]:
    """Return road wheel angle [rad] and speed [m/s] of lateral manoeuvres, 20 s in steps of 0.01 s.

    Args:
        speed: highest [m/s].
        wheelbase: [m].
    """
    t = np.arange(0.0, DURATION, STEP)

    def angle_at(speed: float) -> float:
        """Return the angle of a neutral-steering car for the lateral acceleration, δ = L ay / v² [rad]."""
        return min(LATERAL * wheelbase / speed**2, MAX_ANGLE)

    angle, slow = angle_at(speed), 0.5 * speed
    square = np.sign(np.sin(2.0 * np.pi * 0.2 * t))
    # Phase of a linear sweep, the integral of 0.2 Hz + 2.3 Hz · t / duration.
    sweep = np.sin(2.0 * np.pi * (0.2 * t + 0.5 * (2.3 / DURATION) * t**2))
    phase = np.clip(t, 0.0, DURATION)
    lane = np.where(phase % 10.0 < 4.0, np.sin(2.0 * np.pi * 0.5 * (phase % 10.0)), 0.0)
    full = np.full(len(t), speed)
    both = np.where(t < 0.5 * DURATION, slow, speed)
    growing = np.where(t < 0.5 * DURATION, angle_at(slow), angle)
    return {
        "step steer": (angle * square, full),
        "step steer at two speeds": (growing * square, both),
        "swept sine to 2.5 Hz": (angle * sweep, full),
        "swept sine at two speeds": (growing * sweep, both),
        "double lane change": (angle * lane, full),
        "slowly increasing steer": (min(2.0 * angle, MAX_ANGLE) * t / DURATION, full),
        "steady circle with rising speed": (np.full(len(t), angle), np.linspace(0.3 * speed, speed, len(t))),
    }


def lateral_manoeuvres(p: Mapping[str, float], speed: float) -> dict[str, dict[str, Array]]:
    """Return the channels of the lateral manoeuvres, whichever steering and speed channel a model uses."""
    wheelbase = p.get("wheelbase") or p["front_length"] + p["rear_length"]
    manoeuvres = {}
    for name, (angle, v) in steering_manoeuvres(speed, wheelbase).items():
        channels = {"vx": v, "speed": v, "y": cumulative_trapezoid(v, dx=STEP, initial=0.0)}
        manoeuvres[name] = channels | dict.fromkeys(STEERING, angle * p["steering_ratio"])
    return manoeuvres


def longitudinal_manoeuvres(speed: float) -> dict[str, dict[str, Array]]:
    """Return pedals of longitudinal manoeuvres, 60 s in steps of 0.01 s, and their initial speed [m/s]."""
    t = np.arange(0.0, 60.0, STEP)
    zero, wave = np.zeros(len(t)), np.sign(np.sin(2.0 * np.pi * t / 12.0))
    levels = 0.3 + 0.3 * (t // 12.0 % 2.0)
    return {
        "coast-down": {"throttle": zero, "brake": zero, "vx": np.full(len(t), speed)},
        "throttle steps": {"throttle": levels * np.maximum(wave, 0.0), "brake": zero, "vx": 0.3 * speed + zero},
        "brake steps": {
            "throttle": 0.6 * np.maximum(wave, 0.0), "brake": 0.5 * levels * np.maximum(-wave, 0.0) * (t % 6.0 < 1.0),
            "vx": np.full(len(t), 0.7 * speed),
        },
    }  # fmt: skip
