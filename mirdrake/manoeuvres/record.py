"""Record of a run of a manoeuvre: the logged signals, and those that figures of handling are computed from."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cache, cached_property
from typing import Any

import numpy as np

from mirdrake.manoeuvres.base import Array

SMOOTHING = 0.1
"""Window of the parabola that differentiates velocities [s]."""

_GREGORY = (95.0 / 288.0, 317.0 / 240.0, 23.0 / 30.0, 793.0 / 720.0, 157.0 / 160.0)


@dataclass(frozen=True)
class Record:
    """Record of one run; all arrays (n,), axes and signs of ISO 8855.

    Attributes:
        label: name of the run.
        time: time [s].
        x: x of the rear axle's centre [m].
        y: y of the rear axle's centre [m].
        yaw: unwrapped yaw angle [rad].
        vx: forward velocity of the rear axle's centre [m/s].
        vy: velocity of the rear axle's centre to the left [m/s].
        yaw_rate: yaw rate [rad/s].
        roll: roll angle [rad].
        steering: bicycle angle of the front wheels [rad].
        ahead: distance of the centre of mass ahead of the rear axle [m].
        ratio: hand-wheel angle over road-wheel angle [1].
        others: further signals by name, without the name of the vehicle.
        units: units of the signals.
        stop: reason why the run ended.
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
        """Angle of the road wheels times the steering ratio: that of a hand-wheel without compliance [rad]."""
        return self.ratio * self.steering

    @cached_property
    def speed(self) -> Array:
        """Speed of the centre of mass [m/s]."""
        return np.hypot(self.vx, self.vy_com)

    @cached_property
    def vy_com(self) -> Array:
        """Lateral velocity of the centre of mass [m/s]."""
        return self.vy + self.ahead * self.yaw_rate

    @cached_property
    def sideslip(self) -> Array:
        """Sideslip angle of the centre of mass [rad]."""
        return np.arctan2(self.vy_com, np.maximum(np.abs(self.vx), 1e-3))

    @cached_property
    def lateral_acceleration(self) -> Array:
        """Lateral acceleration of the centre of mass, in the plane of the road [m/s²]."""
        return self._slope(self.vy_com) + self.vx * self.yaw_rate

    @cached_property
    def longitudinal_acceleration(self) -> Array:
        """Longitudinal acceleration of the centre of mass [m/s²]."""
        return self._slope(self.vx) - self.vy_com * self.yaw_rate

    @cached_property
    def distance(self) -> Array:
        """Distance travelled forward by the rear axle's centre [m]."""
        steps = 0.5 * (self.vx[1:] + self.vx[:-1]) * np.diff(self.time)
        return np.concatenate(([0.0], np.cumsum(steps)))

    @cached_property
    def x_com(self) -> Array:
        """X of the centre of mass [m]."""
        return self.x + self.ahead * np.cos(self.yaw)

    @cached_property
    def y_com(self) -> Array:
        """Y of the centre of mass [m]."""
        return self.y + self.ahead * np.sin(self.yaw)

    def until(self, end: float) -> "Record":
        """Return the record up to a time [s]; its last sample is interpolated."""
        # An interpolated last sample, so that integrals and final values end exactly at that time.
        time = np.append(self.time[self.time < end], end)

        def cut(values: Array) -> Array:
            shortened: Array = np.append(values[: len(time) - 1], np.interp(end, self.time, values))
            return shortened

        names = [f.name for f in fields(self) if f.name != "time" and isinstance(getattr(self, f.name), np.ndarray)]
        channels: Mapping[str, Any] = {name: cut(getattr(self, name)) for name in names}
        return replace(self, **channels, time=time, others={name: cut(values) for name, values in self.others.items()})

    def _slope(self, values: Array) -> Array:
        """Return the derivative by time: that of a parabola through the samples around."""
        # An odd window, and more than three samples for a parabola.
        window = max(5, 2 * round(0.5 * SMOOTHING / self.step) + 1)
        if len(values) <= window:
            return np.gradient(values, self.time)
        # The filter needs even steps; the last step of a record that was cut is shorter.
        even = len(values) - int(self.time[-1] - self.time[-2] < 0.999 * self.step)
        slope = _slopes_of_parabolas(values[:even], window) / self.step
        return np.append(slope, slope[even - 1 :][: len(values) - even])


def unwrapped(angle: Array) -> Array:
    """Return an angle without jumps of 2 π, as :func:`numpy.unwrap`, which takes long where there are none."""
    return np.unwrap(angle) if len(angle) and np.abs(np.diff(angle)).max(initial=0.0) > np.pi else angle


def _slopes_of_parabolas(values: Array, window: int) -> Array:
    """Return the slope per sample of the parabola that fits best to the window around each sample.

    Samples nearer to an end than half a window have the parabola of the first or last window. The filter is that of A.
    Savitzky and M. J. E. Golay, Analytical Chemistry 36 (1964) 1627, for the curve through the samples instead of the
    samples: the sum of squares is an integral, so that the bandwidth does not depend on the number of samples.
    """
    half, slopes = window // 2, _slope_weights(window)
    inside = np.convolve(values, slopes[half, ::-1], mode="valid")
    return np.concatenate((slopes[:half] @ values[:window], inside, slopes[half + 1 :] @ values[-window:]))


@cache
def _slope_weights(window: int) -> Array:
    """Return the weights (window, window) of the samples of a window in the slope of its parabola at each sample."""
    place = np.arange(window) - window // 2
    # Coefficients 1, x, x² of the least-squares parabola; its slope is c1 + 2 c2 x.
    root = np.sqrt(_integration_weights(window))
    coefficients = np.linalg.pinv(root[:, None] * np.vander(place.astype(float), 3, increasing=True)) * root
    weights: Array = coefficients[1] + 2.0 * place[:, None] * coefficients[2]
    return weights


def _integration_weights(count: int) -> Array:
    """Return the weights of an odd number of samples in the integral over them, per sample.

    Gregory's rule with the differences up to the fourth, or Simpson's rule if there are fewer than eleven samples (F.
    B. Hildebrand, Introduction to Numerical Analysis, sections 3.5 and 5.9).
    """
    weights = np.ones(count)
    if count < 2 * len(_GREGORY) + 1:
        weights[1:-1:2], weights[2:-1:2], weights[[0, -1]] = 4.0 / 3.0, 2.0 / 3.0, 1.0 / 3.0
        return weights
    weights[: len(_GREGORY)] = _GREGORY
    weights[-len(_GREGORY) :] = _GREGORY[::-1]
    return weights


def bicycle_angles(left: Array, right: Array) -> Array:
    """Return the bicycle angle of two wheels with Ackermann steering [rad]: cot δ = (cot left + cot right) / 2."""
    tl, tr = np.tan(left), np.tan(right)
    total = tl + tr
    # np.where evaluates both branches, so the denominator must not be zero in the unused one.
    safe = np.where(np.abs(total) > 1e-9, total, 1.0)
    angles: Array = np.where(np.abs(total) > 1e-6, np.arctan(2.0 * tl * tr / safe), 0.5 * (left + right))
    # Near straight ahead the cotangents are infinite, and wheels of opposite sign have no Ackermann centre: the mean.
    return np.where((tl * tr <= 0.0), 0.5 * (left + right), angles)
