"""Synthetic logs of a front-driven car on a sideslip course, from an independent two-track model.

Four wheels with Magic Formula tyres (load dependence, combined slip, relaxation), a body that rolls, a hand wheel
with a lag. The channels are those of a satellite receiver with an inertial unit and of the vehicle bus: a delayed vy,
an accelerometer that rolls with the body, hand-wheel angles at half the rate with spikes.

Mass, track, yaw inertia and sensor position are those that the sideslip course SD2231 of KTH gives for a Volvo V40;
the rest is assumed, with values usual for a car of this size.
"""

import math
from collections.abc import Callable

import numpy as np

from mirdrake.core.constants import GRAVITY

CAR = {
    "mass": 1435.0, "wheelbase": 2.645, "front": 1.10, "height": 0.54, "roll_arm": 0.42, "track": 1.565,
    "yaw_inertia": 2380.0, "roll_inertia": 520.0, "roll_stiffness": 70e3, "roll_damping": 4.2e3, "front_roll": 0.60,
    "relaxation": 0.5, "lag": 0.025, "ratio": 15.5, "stiffness_front": 105e3, "stiffness_rear": 140e3, "friction": 0.95,
    "shape": 1.3, "curvature": -1.0, "drag": 0.38, "sensor_ahead": 0.4, "trail": 0.015, "ackermann": 0.7,
}  # fmt: skip
STEP = 0.002
LATE = 0.015
"""How late vy is [s]."""


def ramp(t: float, start: float, end: float) -> float:
    return min(max((t - start) / (end - start), 0.0), 1.0)


def dwell(t: float) -> float:
    """Return a sine of 0.7 Hz that rests for half a second behind its third quarter [1]."""
    three = 0.75 / 0.7
    if not 14.0 < t < 14.5 + 1.0 / 0.7:
        return 0.0
    return 1.0 if 0.0 <= t - 14.0 - three < 0.5 else -math.sin(1.4 * math.pi * (t - 14.0 - 0.5 * (t > 14.0 + three)))


Course = tuple[Callable[[float], float], Callable[[float], float], float]
COURSES: dict[str, Course] = {
    "circle": (
        lambda t: 260.0 * ramp(t, 3, 6) * (1.0 + 0.05 * math.sin(0.7 * t)) * (1.0 - ramp(t, 52, 55)),
        lambda t: 1.0 + 7.0 * ramp(t, 4, 40) - 6.0 * ramp(t, 53, 60),
        60.0,
    ),
    "slalom": (
        lambda t: 85.0 * math.sin(2.0 * math.pi * 0.42 * (t - 8.0)) * ramp(t, 8, 9) * (1.0 - ramp(t, 30, 31)),
        lambda t: 2.0 + 7.7 * ramp(t, 1, 7) - 6.0 * ramp(t, 33, 37),
        38.0,
    ),
    "step": (
        lambda t: 45.0 * ramp(t, 14, 14.15) * (1.0 - ramp(t, 19, 19.3)) + 1.5 * math.sin(0.4 * t),
        lambda t: 6.0 + 16.2 * ramp(t, 1, 11) - 12.0 * ramp(t, 22, 28),
        30.0,
    ),
    "dwell": (
        lambda t: 70.0 * dwell(t) + 1.2 * math.sin(0.5 * t),
        lambda t: 6.0 + 16.2 * ramp(t, 1, 11) - 12.0 * ramp(t, 19, 25),
        27.0,
    ),
}
"""Hand wheel [deg] and speed [m/s] over time, and how long it takes [s]."""


def tyre(slip: float, load: float, usual: float, stiffness: float) -> float:
    share = load / usual
    most = CAR["friction"] * (1.0 - 0.15 * (share - 1.0)) * load
    slope = stiffness * share**0.65 / (CAR["shape"] * most) * slip
    bent = slope - CAR["curvature"] * (slope - math.atan(slope))
    return most * math.sin(CAR["shape"] * math.atan(bent))


def rates(x: np.ndarray, command: float, along: float) -> tuple[np.ndarray, float]:
    """Return the derivatives of vx, vy, yaw rate, roll, its rate, wheel angle, slips and lagged ay; and ay."""
    c, (vx, vy, turn, roll, roll_rate, angle) = CAR, x[:6]
    m, length, ahead = c["mass"], c["wheelbase"], c["front"]
    behind, half = length - ahead, 0.5 * c["track"]
    usual = (0.5 * m * GRAVITY * behind / length, 0.5 * m * GRAVITY * ahead / length)
    moved = 0.5 * m * c["height"] * along / length
    push = m * along + c["drag"] * vx * vx + 0.012 * m * GRAVITY
    part = 1.0 if push > 0.0 else 0.62
    side = moment = 0.0
    slips = []
    for i, (px, py) in enumerate(((ahead, half), (ahead, -half), (-behind, half), (-behind, -half))):
        front = i < 2
        lateral_transfer = (c["front_roll"] if front else 1.0 - c["front_roll"]) * m * c["height"] * x[10] / c["track"]
        load = usual[not front] - (lateral_transfer if py > 0.0 else -lateral_transfer) - (moved if front else -moved)
        load = max(load, 50.0)
        stiffness = 0.5 * (c["stiffness_front"] if front else c["stiffness_rear"])
        pull = 0.5 * push * (part if front else 1.0 - part)
        left = math.sqrt(max(1.0 - (pull / (c["friction"] * load)) ** 2, 0.04))
        across = left * tyre(x[6 + i], load, usual[not front], stiffness)
        pointed = 0.0
        if front and abs(angle) > 1e-4:
            pointed = math.atan(length / (length / math.tan(angle) - c["ackermann"] * py))
        ux, uy, cos, sin = vx - turn * py, vy + turn * px, math.cos(pointed), math.sin(pointed)
        forward = max(ux * cos + uy * sin, 0.5)
        slips.append((-math.atan2(uy * cos - ux * sin, forward) - x[6 + i]) * forward / c["relaxation"])
        fx, fy = pull * cos - across * sin, pull * sin + across * cos
        side += fy
        moment += px * fy - py * fx - c["trail"] * across
    ay = side / m
    arm = c["roll_arm"]
    roll_acceleration = (
        m * arm * (ay + GRAVITY * roll) - c["roll_stiffness"] * roll - c["roll_damping"] * roll_rate
    ) / c["roll_inertia"]
    steer = (command / c["ratio"] - angle) / c["lag"]
    moves = (
        along,
        ay - vx * turn + arm * roll_acceleration,
        moment / c["yaw_inertia"],
        roll_rate,
        roll_acceleration,
        steer,
    )
    return np.array([*moves, *slips, (ay - x[10]) / 0.02]), ay


def recorded(course: Course, random: np.random.Generator) -> dict[str, np.ndarray]:
    """Columns of a log at 100 Hz: time [s], vx, vy [m/s], yaw rate [rad/s], ay [m/s²], hand wheel [rad]."""
    steer, pace, duration = course
    times = np.arange(0.0, duration, STEP)
    x, states, sides = np.zeros(11), [], []
    x[0] = pace(0.0)
    for t in times:
        along = min(max((pace(t + 0.05) - x[0]) / 0.25, -9.0), 5.0)
        slope, ay = rates(x, math.radians(steer(t)), along)
        states.append(x[:6])
        sides.append(ay)
        x = x + STEP * rates(x + 0.5 * STEP * slope, math.radians(steer(t + 0.5 * STEP)), along)[0]
    state, side = np.array(states).T, np.array(sides)
    time = np.arange(0.0, duration - 0.3, 0.01)
    many, ahead = len(time), CAR["sensor_ahead"]

    def at(values: np.ndarray, late: float = 0.0) -> np.ndarray:
        return np.asarray(np.interp(time - late, times, values))

    vy = state[1] + ahead * state[2] - CAR["roll_arm"] * state[4]
    measured_ay = side + ahead * np.gradient(state[2], STEP) + GRAVITY * np.sin(state[3])
    wheel = np.round([steer(t) + 1.8 for t in time], 1)
    wheel = np.repeat(wheel[::2], 2)[:many]
    wheel[random.integers(0, many, 3)] += 800.0
    return {
        "time": time,
        "vx": at(state[0], LATE) + random.normal(0.0, 0.01, many),
        "vy": np.round(at(vy, LATE) + random.normal(0.0, 0.017, many) + 0.014, 3),
        "yaw_rate": at(state[2]) + random.normal(0.0, 0.0044, many) - 0.0017,
        "lateral_acceleration": at(measured_ay) + random.normal(0.0, 0.12, many) + 0.08,
        "steering_wheel_angle": np.radians(wheel),
    }
