"""A run of a manoeuvre as channels: what was logged, and what handling is judged by."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.signal import savgol_filter

from mirdrake.manoeuvres.base import Array

SMOOTHING = 0.1
"""Length of the parabola through which velocities are differentiated [s]."""


@dataclass(frozen=True)
class Record:
    """One run; all arrays (n,), SI, ISO 8855.

    Attributes:
        label: of the run.
        time: [s].
        x: of the rear axle's centre [m].
        y: the same [m].
        yaw: without jumps [rad].
        vx: of the rear axle's centre, forward [m/s].
        vy: the same, to the left [m/s].
        yaw_rate: [rad/s].
        roll: [rad].
        steering: bicycle angle of the front wheels, measured [rad].
        ahead: of the centre of mass before the rear axle [m].
        ratio: hand-wheel angle over road-wheel angle [1].
        others: further signals by name, without the vehicle's.
        units: of them.
        stop: why the run ended.
    """

    label: str
    time: Array
    x: Array
    y: Array
    yaw: Array
    vx: Array
    vy: Array
    yaw_rate: Array
    roll: Array
    steering: Array
    ahead: float
    ratio: float
    others: Mapping[str, Array] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    stop: str = "duration"

    @property
    def step(self) -> float:
        """Time between samples [s]."""
        return float(self.time[1] - self.time[0])

    @cached_property
    def hand_wheel(self) -> Array:
        """Angle of the hand-wheel [rad]."""
        return self.ratio * self.steering

    @cached_property
    def speed(self) -> Array:
        """Of the centre of mass [m/s]."""
        return np.hypot(self.vx, self.vy_com)

    @cached_property
    def vy_com(self) -> Array:
        """Lateral velocity of the centre of mass [m/s]."""
        return self.vy + self.ahead * self.yaw_rate

    @cached_property
    def sideslip(self) -> Array:
        """Of the centre of mass [rad]."""
        return np.arctan2(self.vy_com, np.maximum(np.abs(self.vx), 1e-3))

    @cached_property
    def lateral_acceleration(self) -> Array:
        """Of the centre of mass, across the car, in the plane of the road [m/s²]."""
        return self._slope(self.vy_com) + self.vx * self.yaw_rate

    @cached_property
    def longitudinal_acceleration(self) -> Array:
        """Of the centre of mass, along the car [m/s²]."""
        return self._slope(self.vx) - self.vy_com * self.yaw_rate

    @cached_property
    def distance(self) -> Array:
        """Travelled by the rear axle's centre, along the car [m]."""
        steps = 0.5 * (self.vx[1:] + self.vx[:-1]) * np.diff(self.time)
        return np.concatenate(([0.0], np.cumsum(steps)))

    @cached_property
    def x_com(self) -> Array:
        """Of the centre of mass [m]."""
        return self.x + self.ahead * np.cos(self.yaw)

    @cached_property
    def y_com(self) -> Array:
        """Of the centre of mass [m]."""
        return self.y + self.ahead * np.sin(self.yaw)

    def until(self, end: float) -> "Record":
        """Return the record up to a time [s]; its last sample is interpolated."""
        time = np.append(self.time[self.time < end], end)

        def cut(values: Array) -> Array:
            kept: Array = np.append(values[: len(time) - 1], np.interp(end, self.time, values))
            return kept

        names = [one.name for one in fields(self) if isinstance(getattr(self, one.name), np.ndarray)]
        channels: dict[str, Any] = {name: cut(getattr(self, name)) for name in names}
        others = {name: cut(values) for name, values in self.others.items()}
        return replace(self, **(channels | {"time": time, "others": others}))

    def _slope(self, values: Array) -> Array:
        """Derivative by time: that of a parabola through the samples around."""
        window = max(5, 2 * round(0.5 * SMOOTHING / self.step) + 1)
        if len(values) <= window:
            return np.gradient(values, self.time)
        # The filter needs even steps; the last step of a record that was cut is shorter.
        even = len(values) - int(self.time[-1] - self.time[-2] < 0.999 * self.step)
        slope: Array = savgol_filter(values[:even], window, 2, deriv=1, delta=self.step)
        return np.append(slope, slope[even - 1 :][: len(values) - even])


def bicycle_angles(left: Array, right: Array) -> Array:
    """Angle of the ideal wheel between two that stand by the Ackermann law: cot δ = (cot l + cot r) / 2 [rad]."""
    tl, tr = np.tan(left), np.tan(right)
    total = tl + tr
    safe = np.where(np.abs(total) > 1e-9, total, 1.0)
    angles: Array = np.where(np.abs(total) > 1e-6, np.arctan(2.0 * tl * tr / safe), 0.5 * (left + right))
    return np.where((tl * tr <= 0.0), 0.5 * (left + right), angles)
