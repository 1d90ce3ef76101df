"""Drives of a known single track with sensor noise, simulated by SciPy with an independent implementation."""

from functools import cache
from math import pi

import numpy as np
from scipy.integrate import solve_ivp

from mirdrake.identification import DataSet, Log

MASS, FRONT, REAR = 1500.0, 1.2, 1.5
TRUTH = {
    "cornering_stiffness_front": 90e3,
    "cornering_stiffness_rear": 110e3,
    "yaw_inertia": 2400.0,
    "steering_offset": 0.003,
    "steering_delay": 0.03,
    "steering_lag": 0.05,
}
NOISE = {"vx": 0.02, "yaw_rate": 0.003, "lateral_acceleration": 0.1, "vy": 0.02}
OFFSET = {"yaw_rate": 0.002, "lateral_acceleration": -0.05, "vy": 0.02}


def steering(t):
    """Rounded steps and a sweep to 2 Hz [rad]: samples at 100 Hz joined by straight lines are nearly the same."""
    return 0.02 * np.sin(2.0 * pi * (0.2 + 0.03 * t) * t) + 0.02 * np.tanh(6.0 * np.sin(0.9 * t))


def speed(t):
    return 20.0 + 7.0 * np.sin(0.2 * t)


def pull(push, angle, drive=0.5):
    """Return the lateral part of the longitudinal force of the front wheels, which have 0.6 of the braking.

    Args:
        push: force along the vehicle, or acceleration.
        angle: of the wheels [rad].
        drive: part of the drive that is theirs [1].
    """
    return (drive if push > 0.0 else 0.6) * push * np.sin(angle)


def steps(t):
    """Return steps to both sides, each within 0.1 s: 4 m/s² at 25 m/s, as in ISO 7401 [rad]."""
    return 0.024 * np.tanh(50.0 * np.sin(2.0 * pi * t / 5.0) / (2.0 * pi))


def sweep(t):
    """Return a sweep from 0.2 to 4 Hz within 30 s, with 4 m/s² at low frequencies [rad]."""
    return 0.024 * np.sin(2.0 * pi * (0.2 + 0.5 * (3.8 / 30.0) * t) * t)


def ramp(t):
    """Return a ramp up to 4 m/s² and back, to the left and to the right [rad]."""
    return 0.024 * np.sin(2.0 * pi * t / 30.0)


STANDARD = {"step": (steps, 25.0), "sweep": (sweep, 25.0), "ramp": (ramp, 25.0)}
"""Steering and speed [m/s] of the manoeuvres that a test driver would do, 30 s each."""


@cache
def exact(duration=30.0, step=0.01, manoeuvre=None):
    """Return the time and exact channels; the recorded steering is the input of delay and lag.

    Args:
        duration: [s].
        step: of the samples [s].
        manoeuvre: of :data:`STANDARD`; None: a bit of all at a changing speed.
    """
    p = TRUTH
    if manoeuvre is None:
        steer, pace = steering, speed
    else:
        steer, constant = STANDARD[manoeuvre]

        def pace(t):
            return constant + 0.0 * t

    def push(t):
        return MASS * (pace(t + 1e-4) - pace(t - 1e-4)) / 2e-4

    late, lag = p["steering_delay"], p["steering_lag"]

    def rates(t, x):
        vy, r, delta = x
        v, angle = pace(t), delta + p["steering_offset"]
        tyres = -p["cornering_stiffness_front"] * (np.arctan((vy + FRONT * r) / v) - angle)
        # The wheels hold the speed against the backward part of the front lateral force.
        front = tyres * np.cos(angle) + pull(push(t) - MASS * r * vy + tyres * np.sin(angle), angle)
        rear = -p["cornering_stiffness_rear"] * np.arctan((vy - REAR * r) / v)
        command = steer(max(t - late, 0.0))
        return [
            (front + rear) / MASS - v * r,
            (FRONT * front - REAR * rear) / p["yaw_inertia"],
            (command - delta) / lag,
        ]

    time = np.arange(0.0, duration - 1e-9, step)
    x = solve_ivp(rates, (0.0, duration), [0.0, 0.0, steer(0.0)], t_eval=time, rtol=1e-8, atol=1e-10, max_step=0.02).y
    slope = np.array([rates(t, x[:, k])[0] for k, t in enumerate(time)])
    v = pace(time)
    return time, {
        "vx": v,
        "vy": x[0],
        "yaw_rate": x[1],
        "lateral_acceleration": slope + v * x[1],
        "road_wheel_angle": steer(time),
    }


def lateral_log(
    seed=0, *, name="drive", use="train", duration=30.0, channels=("yaw_rate", "lateral_acceleration"), manoeuvre=None
):
    """Return a log with noise and offsets of the sensors."""
    time, clean = exact(duration, manoeuvre=manoeuvre)
    random = np.random.default_rng(seed)
    measured = {"road_wheel_angle": clean["road_wheel_angle"]}
    for channel in ("vx", *channels):
        measured[channel] = clean[channel] + OFFSET.get(channel, 0.0) + random.normal(0.0, NOISE[channel], len(time))
    return Log(name, use, time, measured)


def lateral_data(seed=0, **options):
    return DataSet((lateral_log(seed, **options),), wheelbase=FRONT + REAR)


def standard_data(seed=0):
    """Return the standard set of manoeuvres, 90 s together."""
    logs = [lateral_log(10 * seed + k, name=name, manoeuvre=name) for k, name in enumerate(STANDARD)]
    return DataSet(tuple(logs), wheelbase=FRONT + REAR)


COAST = {"rolling_resistance": 0.009, "drag": 0.45}


def coast_data(seed=0, *, duration=120.0, start=32.0):
    """Return a coast-down of the same mass, by closed form: v = √(A/D) tan(φ - √(A D) t / m)."""
    time = np.arange(0.0, duration, 0.02)
    a, d = COAST["rolling_resistance"] * MASS * 9.80665, COAST["drag"]
    size = np.sqrt(a / d)
    v = size * np.tan(np.arctan(start / size) - np.sqrt(a * d) / MASS * time)
    assert v.min() > 1.0
    v = v + np.random.default_rng(seed).normal(0.0, 0.03, len(time))
    zero = np.zeros(len(time))
    return DataSet((Log("coast", "train", time, {"vx": v, "throttle": zero, "brake": zero}),))
