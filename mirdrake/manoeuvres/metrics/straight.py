"""Figures of driving straight ahead: accelerating, braking, coasting, standing."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from mirdrake.manoeuvres.base import Array
from mirdrake.manoeuvres.metrics.transient import crossing

FOOT = 0.3048
"""[m]"""
MILE = 1609.344
"""[m]"""
MPH = 0.44704
"""[m/s]"""
KMH = 1.0 / 3.6
"""[m/s]"""
MOVED = 0.05
"""Speed from which on a vehicle counts as moving [m/s]."""


def time_to_speed(time: Array, speed: Array, wanted: float, *, start: float) -> float:
    """Time from `start` until a speed is reached [s]; NaN if never."""
    return crossing(time, speed, wanted, after=start) - start


def time_to_distance(time: Array, distance: Array, wanted: float, *, start: float) -> float:
    """Time from `start` until a way is covered [s], from where the vehicle stood then; NaN if never."""
    here = float(np.interp(start, time, distance))
    return crossing(time, distance - here, wanted, after=start) - start


def moves_off(time: Array, speed: Array, level: float) -> float:
    """When a standing vehicle drives off [s]: the last time it passes `level` before 20 of it; NaN if it never does.

    What an automatic does before, as it creeps against its brakes or rocks on its wheels, does not count.
    """
    driving = np.flatnonzero(speed > 20.0 * level)
    if not len(driving):
        return math.nan
    slow = np.flatnonzero(speed[: driving[0]] <= level)
    return crossing(time, speed, level, after=float(time[slow[-1]])) if len(slow) else float(time[0])


@dataclass(frozen=True)
class Stop:
    """Braking from one speed to another.

    Attributes:
        distance: [m].
        time: [s].
        mean: deceleration of the distance, (v0² - v1²) / 2 s [m/s²].
        developed: mean fully developed deceleration, between 80 % and 10 % of the first speed [m/s²].
    """

    distance: float
    time: float
    mean: float
    developed: float


def stop_from(time: Array, speed: Array, distance: Array, first: float, last: float = 0.0) -> Stop:
    """Braking from a speed, from the moment it is passed; NaN where that does not happen.

    Args:
        time: rising [s].
        speed: falling [m/s].
        distance: travelled [m].
        first: speed at which the distance begins [m/s].
        last: at which it ends; zero: at :func:`standstill`.
    """
    begin = crossing(time, speed, first)
    end = crossing(time, speed, last, after=begin) if last > 0.0 else standstill(time, speed, after=begin)
    way = float(np.interp(end, time, distance) - np.interp(begin, time, distance)) if end > begin else math.nan
    eight, one = (crossing(time, speed, share * first, after=begin) for share in (0.8, 0.1))
    between = float(np.interp(one, time, distance) - np.interp(eight, time, distance)) if one > eight else math.nan
    return Stop(
        distance=way,
        time=end - begin,
        mean=(first**2 - last**2) / (2.0 * way),
        developed=(0.64 - 0.01) * first**2 / (2.0 * between),
    )


def standstill(time: Array, speed: Array, *, after: float) -> float:
    """Return when the speed first crosses zero after `after` [s]; of a speed that only approaches zero, 0.02 m/s.

    Tyres and springs push a stopped vehicle back, so its speed is negative for a moment; that is not braking.
    """
    end = crossing(time, speed, 0.0, after=after)
    return end if math.isfinite(end) else crossing(time, speed, 0.02, after=after)


@dataclass(frozen=True)
class RoadLoad:
    """F = a + b v + c v² [N], with v in m/s; and the root mean square of what is left of the speed [m/s]."""

    a: float
    b: float
    c: float
    error: float

    def at(self, speed: float) -> float:
        """Force at a speed [N]."""
        return self.a + self.b * speed + self.c * speed**2


def road_load(time: Array, speed: Array, mass: float) -> RoadLoad:
    """Road load of a coast-down, from the speed over time alone: least squares of its integral.

    m (v0 - v(t)) = a t + b ∫ v dt + c ∫ v² dt needs no derivative. Coefficients are not negative.

    Args:
        time: of the coast-down alone [s].
        speed: [m/s].
        mass: with that of what rotates [kg].
    """
    step = np.diff(time)

    def summed(values: Array) -> Array:
        return np.concatenate(([0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * step)))

    since = time - time[0]
    matrix = np.column_stack([since, summed(speed), summed(speed**2)])
    scale = np.abs(matrix).max(axis=0)
    lost = mass * (speed[0] - speed)
    found = nnls(matrix / scale, lost)[0] / scale
    error = float(np.sqrt(np.mean((matrix @ found - lost) ** 2))) / mass
    return RoadLoad(float(found[0]), float(found[1]), float(found[2]), error)


def coast_times(time: Array, speed: Array, steps: Sequence[tuple[float, float]]) -> list[float]:
    """Time from one speed down to another [s], by pairs of speeds [m/s]; NaN where they are not passed."""
    return [crossing(time, speed, low) - crossing(time, speed, high) for high, low in steps]


def creep(time: Array, x: Array, y: Array, *, settle: float) -> tuple[float, float]:
    """Speed of a drifting place [m/s], by a straight line through it, and how far it went [m], after settling.

    Args:
        time: [s].
        x: [m].
        y: [m].
        settle: time at the start that does not count [s].
    """
    chosen = time >= settle
    t, px, py = time[chosen], x[chosen], y[chosen]
    speed = math.hypot(float(np.polyfit(t, px, 1)[0]), float(np.polyfit(t, py, 1)[0]))
    return speed, float(np.max(np.hypot(px - px[0], py - py[0])))
