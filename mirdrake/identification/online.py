"""Online identification: joint unscented Kalman filter of a single track and its parameters.

State: vy, yaw rate, and slowly drifting parameters: the logarithm of a factor on both cornering stiffnesses, that of
the steering ratio, and the steering offset. Sigma points after S. J. Julier and J. K. Uhlmann, Proc. IEEE 92, 2004;
linear tyres. Below a least speed the car is kinematic and the parameters are not updated.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mirdrake.core.errors import ConfigError
from mirdrake.identification.data import Log
from mirdrake.identification.models.base import SPEED, find_channel
from mirdrake.identification.models.steer import STEERING
from mirdrake.identification.relations import make_grid
from mirdrake.single_track.parameters import SingleTrackParameters

Array = NDArray[np.float64]

STATES = ("vy", "yaw_rate", "stiffness_factor", "steering_ratio", "steering_offset")

_N = len(STATES)
_SPREAD = _N - 2.0 if _N > 3 else 1.0  # κ of Julier's sigma points, positive for every n
_MEAN = np.full(2 * _N + 1, 0.5 / (_N + _SPREAD))
_MEAN[0] = _SPREAD / (_N + _SPREAD)


@dataclass(frozen=True)
class OnlineSettings:
    """Noise and limits of the filter.

    Attributes:
        yaw_rate: noise of the measured yaw rate [rad/s].
        lateral_acceleration: noise of the measured lateral acceleration [m/s²].
        vy: process noise of the lateral velocity [m/s per √s].
        spin: process noise of the yaw rate [rad/s per √s].
        factor: drift of the logarithms of stiffness and ratio [1/√s].
        offset: drift of the steering offset [rad/√s].
        start: initial standard deviations of these logarithms and of the offset [1, 1, rad].
        least_speed: no update of the parameters below this speed [m/s].
        most_lateral: nor above this lateral acceleration, where tyres are not linear [m/s²].
    """

    yaw_rate: float = 0.005
    lateral_acceleration: float = 0.2
    vy: float = 0.1
    spin: float = 0.02
    factor: float = 2e-3
    offset: float = 1e-4
    start: tuple[float, float, float] = (0.3, 0.2, 0.02)
    least_speed: float = 4.0
    most_lateral: float = 4.0


@dataclass(frozen=True)
class OnlineTrace:
    """Estimates of the filter over time.

    Attributes:
        time: (n) [s].
        mean: (n, 5) in the order of :data:`STATES`: [m/s, rad/s, 1, 1, rad].
        sigma: standard deviations (n, 5), those of factor and ratio in the unit of the mean.
    """

    time: Array
    mean: Array
    sigma: Array


class OnlineFilter:
    """The filter; call :meth:`step` for each sample.

    Args:
        car: known parameters; the estimated factor multiplies its stiffnesses.
        ratio: first guess of steering channel over road wheel angle [1].
        settings: noise and limits.
    """

    def __init__(
        self, car: SingleTrackParameters, *, ratio: float = 1.0, settings: OnlineSettings | None = None
    ) -> None:
        self._car, self._set = car, settings or OnlineSettings()
        s = self._set
        self.mean = np.array([0.0, 0.0, 0.0, np.log(ratio), 0.0])
        self.covariance = np.diag(np.square([0.5, 0.2, *s.start]))
        self._before: tuple[float, float] | None = None  # steering and speed of the last sample
        self._noise = np.diag(np.square([s.vy, s.spin, s.factor, s.factor, s.offset]))
        self._seen = np.diag(np.square([s.yaw_rate, s.lateral_acceleration]))

    def _sigma_points(self) -> Array:
        root = np.linalg.cholesky((_N + _SPREAD) * (self.covariance + 1e-14 * np.eye(_N)))
        return np.concatenate((self.mean[:, None], self.mean[:, None] + root, self.mean[:, None] - root), axis=1)

    def _motion(self, x: Array, steer: float, v: float) -> tuple[Array, Array]:
        """Return lateral acceleration [m/s²] and yaw acceleration [rad/s²] of all sigma points."""
        car = self._car
        delta = steer / np.exp(x[3]) + x[4]
        factor = np.exp(x[2])
        front = -car.front_stiffness * factor * ((x[0] + car.front_length * x[1]) / v - delta)
        rear = -car.rear_stiffness * factor * (x[0] - car.rear_length * x[1]) / v
        return (front + rear) / car.mass, (car.front_length * front - car.rear_length * rear) / car.yaw_inertia

    def step(self, step: float, steer: float, v: float, yaw_rate: float, lateral: float) -> None:
        """Predict over a step and update with a sample.

        Args:
            step: time since the last sample [s].
            steer: steering channel.
            v: speed [m/s].
            yaw_rate: measured [rad/s]; NaN if missing.
            lateral: measured lateral acceleration of the centre of mass [m/s²]; NaN if missing.
        """
        s, car = self._set, self._car
        last_steer, last_v = self._before or (steer, v)
        self._before = steer, v
        if v < s.least_speed:  # kinematic motion; the parameters are not observable
            self.mean[1] = yaw_rate if np.isfinite(yaw_rate) else self.mean[1]
            self.mean[0] = car.rear_length * self.mean[1]
            self.covariance[:2, :] = self.covariance[:, :2] = 0.0
            self.covariance[0, 0], self.covariance[1, 1] = 0.01, 1e-4
            return
        x = self._sigma_points()
        # Prediction by Heun's steps, short against the fastest time constant.
        fast = 1.5 * (car.front_stiffness + car.rear_stiffness) / (car.mass * v)
        many = max(1, int(np.ceil(step * fast / 0.7)))
        h = step / many
        for k in range(many):
            part, v_then = (k + 0.5) / many, max(0.5 * (v + last_v), s.least_speed)
            steer_then = last_steer + part * (steer - last_steer)
            side, turn = self._motion(x, steer_then, v_then)
            first = side - x[1] * v_then
            y = x.copy()
            y[0] += h * first
            y[1] += h * turn
            side2, turn2 = self._motion(y, steer_then, v_then)
            x[0] += 0.5 * h * (first + side2 - y[1] * v_then)
            x[1] += 0.5 * h * (turn + turn2)
        mean = x @ _MEAN
        off = x - mean[:, None]
        covariance = (off * _MEAN) @ off.T + step * self._noise
        if abs(lateral) > s.most_lateral or not (np.isfinite(yaw_rate) or np.isfinite(lateral)):
            self.mean, self.covariance = mean, covariance
            return
        # Update with the values that were measured.
        side, _ = self._motion(x, steer, v)
        seen = np.stack((x[1], side))
        rows = [i for i, value in enumerate((yaw_rate, lateral)) if np.isfinite(value)]
        seen = seen[rows]
        shown = seen @ _MEAN
        away = seen - shown[:, None]
        inside = (away * _MEAN) @ away.T + self._seen[np.ix_(rows, rows)]
        inside[range(len(rows)), range(len(rows))] += [step * s.spin**2 if row == 0 else 0.0 for row in rows]
        gain = np.linalg.solve(inside, ((off * _MEAN) @ away.T).T).T
        self.mean = mean + gain @ (np.array([yaw_rate, lateral])[rows] - shown)
        covariance = covariance - gain @ inside @ gain.T
        self.covariance = 0.5 * (covariance + covariance.T) + 1e-14 * np.eye(_N)


def filter_log(
    log: Log,
    car: SingleTrackParameters,
    *,
    ratio: float = 1.0,
    settings: OnlineSettings | None = None,
    rate: float = 50.0,
) -> OnlineTrace:
    """Run the filter over a recorded log.

    Args:
        log: with steering, speed and yaw rate; lateral acceleration if available.
        car: known parameters.
        ratio: first guess of the steering ratio [1].
        settings: noise and limits.
        rate: rate of the filter; samples in between are averaged [Hz].

    Raises:
        ConfigError: a channel is missing.
    """
    offered = set(log.channels)
    steer = find_channel(offered, STEERING, "the steering", "online")
    forward = find_channel(offered, SPEED, "the speed", "online")
    find_channel(offered, ("yaw_rate",), "the yaw rate", "online")
    # The filter runs at a constant rate on averages.
    grid = make_grid(log)
    n = len(grid.channels[forward])
    if n < 2:
        raise ConfigError(f"log {log.name}: has {n} samples; an online filter needs more")
    lateral = grid.channels.get("lateral_acceleration", np.full(n, np.nan))
    estimator = OnlineFilter(car, ratio=ratio, settings=settings)
    many = max(int(1.0 / (rate * grid.step) + 1e-6), 1)
    count, step = n // many, many * grid.step
    columns = (grid.channels[steer], grid.channels[forward], grid.channels["yaw_rate"], lateral)
    rows = np.stack([values[: count * many].reshape(-1, many).mean(axis=1) for values in columns], axis=1)
    mean, sigma = np.empty((count, _N)), np.empty((count, _N))
    for k, (angle, v, turn, side) in enumerate(rows.tolist()):
        estimator.step(step, angle, v, turn, side)
        mean[k] = estimator.mean
        sigma[k] = np.sqrt(np.diag(estimator.covariance))
    mean[:, 2:4] = np.exp(mean[:, 2:4])
    sigma[:, 2:4] *= mean[:, 2:4]
    return OnlineTrace(log.time[0] + step * (np.arange(count) + 0.5), mean, sigma)
