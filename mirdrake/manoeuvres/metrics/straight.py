"""Figures of straight driving: acceleration, braking, coasting, creep at standstill."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # it imports its parts when they are first used

from mirdrake.manoeuvres.base import Array
from mirdrake.manoeuvres.metrics.transient import crossing

FOOT, MILE = 0.3048, 1609.344
"""Foot and mile [m]."""
MPH, KMH = 0.44704, 1.0 / 3.6
"""Mile per hour and kilometre per hour [m/s]."""
MOVED = 0.05
"""Speed above which a vehicle counts as moving [m/s]."""


def time_to_speed(time: Array, speed: Array, target: float, *, start: float) -> float:
    """Return the time from `start` until a speed is reached [s]; NaN if it is not."""
    return crossing(time, speed, target, after=start) - start


def time_to_distance(time: Array, distance: Array, target: float, *, start: float) -> float:
    """Return the time from `start` until a distance is covered from then on [s]; NaN if it is not."""
    before = float(np.interp(start, time, distance))
    return crossing(time, distance - before, target, after=start) - start


def moves_off(time: Array, speed: Array, level: float) -> float:
    """Return the time at which a vehicle moves off [s]; NaN if it does not.

    It is the last time at which the speed passes `level` before it reaches 20 times that: a vehicle that creeps against
    its brakes or rocks on its suspension has not moved off.
    """
    driving = np.flatnonzero(speed > 20.0 * level)
    if not len(driving):
        return math.nan
    slow = np.flatnonzero(speed[: driving[0]] <= level)
    return crossing(time, speed, level, after=float(time[slow[-1]])) if len(slow) else float(time[0])


@dataclass(frozen=True)
class Stop:
    """Braking from a speed to standstill.

    Attributes:
        distance: braking distance [m].
        time: braking time [s].
        mean: mean deceleration over the distance, v² / 2 s [m/s²].
        developed: mean fully developed deceleration, between 80 % and 10 % of the first speed [m/s²].
    """

    distance: float
    time: float
    mean: float
    developed: float


def stop_from(time: Array, speed: Array, distance: Array, first: float) -> Stop:
    """Return the figures of braking to :func:`standstill` from the time at which a speed is passed; NaN if it is not.

    Args:
        time: increasing times [s].
        speed: decreasing speed [m/s].
        distance: distance travelled [m].
        first: speed at which the distance begins [m/s].
    """

    def between(begin: float, end: float) -> float:
        return float(np.interp(end, time, distance) - np.interp(begin, time, distance)) if end > begin else math.nan

    begin = crossing(time, speed, first)
    end = standstill(time, speed, after=begin)
    # Mean fully developed deceleration of UN R13-H: (v1² - v2²) / 2 s between 80 and 10 % of the speed.
    developed = between(*(crossing(time, speed, share * first, after=begin) for share in (0.8, 0.1)))
    return Stop(
        distance=between(begin, end),
        time=end - begin,
        mean=first**2 / (2.0 * between(begin, end)),
        developed=(0.64 - 0.01) * first**2 / (2.0 * developed),
    )


def standstill(time: Array, speed: Array, *, after: float) -> float:
    """Return when the speed first crosses zero after `after` [s]; of a speed that only approaches zero, 0.02 m/s.

    Tyres and springs push a stopped vehicle back, so its speed is negative for a moment; that is not braking.
    """
    end = crossing(time, speed, 0.0, after=after)
    return end if math.isfinite(end) else crossing(time, speed, 0.02, after=after)


@dataclass(frozen=True)
class RoadLoad:
    """Road load F = a + b v + c v² [N] with v in m/s, and the root mean square error of the speed [m/s]."""

    a: float
    b: float
    c: float
    error: float

    def at(self, speed: float) -> float:
        """Return the force at a speed [N]."""
        return self.a + self.b * speed + self.c * speed**2


def road_load(time: Array, speed: Array, mass: float) -> RoadLoad:
    """Return the road load of a coast-down by least squares of the integrated equation of motion.

    m (v0 - v(t)) = a t + b ∫ v dt + c ∫ v² dt needs no derivative. The coefficients are not negative.

    Args:
        time: times of the coast-down only [s].
        speed: speed [m/s].
        mass: mass with the equivalent mass of rotating parts [kg].
    """
    step = np.diff(time)

    # Trapezoidal integrals of 1, v and v² over time: each coefficient then multiplies a column.
    def integral(values: Array) -> Array:
        return np.concatenate(([0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * step)))

    since = time - time[0]
    matrix = np.column_stack([since, integral(speed), integral(speed**2)])
    # Columns differ by the powers of v; scaling them keeps the least squares well conditioned.
    scale = np.abs(matrix).max(axis=0)
    momentum = mass * (speed[0] - speed)

    # Non-negative least squares: a small negative coefficient of a noisy fit has no physical meaning.
    coefficients = scipy.optimize.nnls(matrix / scale, momentum)[0] / scale
    error = float(np.sqrt(np.mean((matrix @ coefficients - momentum) ** 2))) / mass
    a, b, c = coefficients.tolist()
    return RoadLoad(a, b, c, error)


def coast_times(time: Array, speed: Array, steps: Sequence[tuple[float, float]]) -> list[float]:
    """Return the times from a higher to a lower speed [s] for pairs of speeds [m/s]; NaN where they are not passed."""
    return [crossing(time, speed, low) - crossing(time, speed, high) for high, low in steps]


def creep(time: Array, x: Array, y: Array, *, settle: float) -> tuple[float, float]:
    """Return the creep speed by a line fitted to the position [m/s], and the largest drift [m], after settling.

    Args:
        time: times [s].
        x: position [m].
        y: position [m].
        settle: time at the start that is not evaluated [s].
    """
    chosen = time >= settle
    t, px, py = time[chosen], x[chosen], y[chosen]
    # The slope of a line is robust against oscillation on tyres and springs, a difference of two positions is not.
    speed = math.hypot(float(np.polyfit(t, px, 1)[0]), float(np.polyfit(t, py, 1)[0]))
    return speed, float(np.max(np.hypot(px - px[0], py - py[0])))
