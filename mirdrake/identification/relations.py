"""Kinematic relations between the channels of one log: scales, signs, sample time, gravity.

For velocities and accelerations of one point of a rigid body on a flat road (ISO 8855)::

    ax = dvx/dt - r vy        r = dψ/dt
    ay = dvy/dt + r vx        |v| = ds/dt,  wheels ≈ vx

On a road with a bank φ, left side up, ay also has g sin φ, as accelerometers measure the force of the ground. Each is a
relation ``left = gain · right + offset``. The gain is 1 if units, signs and sample time are right. A wrong sample time
shows in all relations with one derivative and in no other; a wrong unit in all relations of its channel.

Noise on both sides biases each regression: the gain lies between those of either side on the other (R. Frisch,
Statistical Confluence Analysis by Means of Complete Regression Systems, 1934). A value between them is not excluded.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

from mirdrake.core.constants import GRAVITY
from mirdrake.identification.channels import WHEELS, quantity
from mirdrake.identification.data import Array, Log
from mirdrake.identification.timing import median_step, resolution

Channels = Mapping[str, Array]

MAX_BRIDGE = 50.0
"""Longest gap on a grid, in median steps."""

REVERSE = 0.1
"""Speed above which a negative one is not noise [m/s]."""

MIN_SINGLE_DEVIATION = 0.25
"""Least deviation of the sample time from 1 if only one relation shows it: gravity in a pitching car causes 10 %."""


@dataclass(frozen=True)
class Grid:
    """A log at a constant step, gaps and missing values bridged linearly.

    Attributes:
        step: [s].
        channels: channels by name (n each).
    """

    step: float
    channels: Channels

    def rate(self, values: Array) -> Array:
        """Return the derivative by central differences (n)."""
        return np.gradient(values, self.step)


def make_grid(log: Log) -> Grid:
    """Resample a log to its median step."""
    step = median_step(log.time)
    steady = np.diff(log.time)
    clock = log.time
    if np.all(np.abs(steady - step) < 1e-3 * step):
        time = clock
    else:
        # A long gap contains no data: only a short piece of it is bridged.
        clock = np.append(0.0, np.cumsum(np.clip(steady, 0.0, MAX_BRIDGE * step)))
        time = np.arange(0.0, clock[-1] + 0.5 * step, step)
    channels = {}
    for name, values in log.channels.items():
        good = np.isfinite(values)
        if good.sum() > 2:
            # An even log without holes keeps its own samples: interpolation would smooth them.
            channels[name] = values if good.all() and time is clock else np.interp(time, clock[good], values[good])
    return Grid(step, channels)


class Relation(NamedTuple):
    """Kinematic relation ``left = right`` in SI units.

    Attributes:
        measured: channel of the left side.
        others: channels of the right side.
        orders: exponents of the scales of those channels in the right side.
        derivative: whether the right side is a time derivative, so that it grows if the step is too short.
        right: the right side (n).
        timed: whether both sides have the same timing; without vy, ay leads vx r by the change of vy.
        known: part of the right side without a derivative, which is moved to the left for the gain: ax + r vy = dvx/dt.
        beside: further terms of unknown size, such as those of the position of a sensor (n each).
    """

    measured: str
    others: tuple[str, ...]
    orders: tuple[int, ...]
    derivative: bool
    right: Callable[[Grid], Array]
    timed: bool = True
    known: Callable[[Grid], Array] | None = None
    beside: Callable[[Grid], list[Array]] | None = None

    def left(self, grid: Grid) -> Array:
        """Return the measured channel without the known part (n)."""
        values = grid.channels[self.measured]
        return values if self.known is None else values - self.known(grid)

    def __str__(self) -> str:
        return f"{self.measured}, {', '.join(self.others)}"


def kinematic_relations(channels: Channels, *, use_vy: bool = True) -> list[Relation]:
    """Return the relations that the channels of a log allow.

    Args:
        channels: channels of a log.
        use_vy: whether dvy/dt counts in the lateral acceleration; it should not if the step may be wrong.
    """
    relations: list[Relation] = []
    forward = "vx" if "vx" in channels else "speed" if "speed" in channels else None

    def get(grid: Grid, name: str) -> Array:
        return grid.channels[name]

    def turn(grid: Grid) -> Array:
        """Return -r vy if it is measured, else zero."""
        if "vy" in grid.channels and "yaw_rate" in grid.channels:
            return -get(grid, "yaw_rate") * get(grid, "vy")
        return np.zeros(len(next(iter(grid.channels.values()))))

    def side(grid: Grid) -> Array:
        # Without vy the turn counts as quasi-steady, dvy/dt = 0.
        known = use_vy and "vy" in grid.channels
        values = grid.rate(get(grid, "vy")) if known else np.zeros(len(get(grid, "yaw_rate")))
        return values + GRAVITY * np.sin(get(grid, "bank")) if "bank" in grid.channels else values

    def mounting(grid: Grid) -> list[Array]:
        """Return r² and r vx: an accelerometer ahead of the centre of mass measures one, a turned one the other.

        Without vy, r vy is nearly proportional to r² as well.
        """
        if "yaw_rate" not in grid.channels:
            return []
        return [get(grid, "yaw_rate") ** 2, get(grid, "yaw_rate") * get(grid, str(forward))]

    # Each relation determines other scales: together they show which channel or step is wrong.
    if forward and "longitudinal_acceleration" in channels:
        relations.append(
            Relation("longitudinal_acceleration", (forward,), (1,), True, lambda g: g.rate(get(g, forward)), known=turn,
                     beside=mounting)
        )  # fmt: skip
    if forward and "lateral_acceleration" in channels and "yaw_rate" in channels:
        relations.append(
            Relation(
                "lateral_acceleration",
                (forward, "yaw_rate"),
                (1, 1),
                False,
                lambda g: get(g, forward) * get(g, "yaw_rate") + side(g),
                "vy" in channels,
                beside=lambda g: [g.rate(get(g, "yaw_rate"))],  # by the position of the accelerometer
            )
        )
    if "yaw" in channels and "yaw_rate" in channels:
        relations.append(Relation("yaw_rate", ("yaw",), (1,), True, lambda g: g.rate(np.unwrap(get(g, "yaw")))))
    if forward and "x" in channels and "y" in channels:
        # The speed scales with both coordinates alike, so the exponent counts once.
        relations.append(Relation(forward, ("x", "y"), (1, 0), True, lambda g: _travel(g, str(forward))))
    if "speed" in channels and "vx" in channels:
        relations.append(Relation("speed", ("vx",), (1,), False, _ground_speed))
    # Wheel speeds are in m/s at the contact, so that they are compared with the speed directly.
    if forward:
        for wheel in WHEELS:
            name = f"wheel_speed_{wheel}"
            if name in channels:
                relations.append(Relation(name, (forward,), (1,), False, lambda g: get(g, forward)))
    # Several channels of one quantity, such as speed@gps, are compared with the first.
    for name in channels:
        first = quantity(name)
        if name != first and first in channels:
            relations.append(Relation(name, (first,), (1,), False, lambda g, first=first: get(g, first)))  # type: ignore[misc]
    return relations


def _ground_speed(grid: Grid) -> Array:
    """Return the speed by vx and vy, negative in reverse if the recorded speed is so."""
    forward = grid.channels["vx"]
    size = np.hypot(forward, grid.channels["vy"]) if "vy" in grid.channels else np.abs(forward)
    return size * np.sign(forward) if np.min(grid.channels["speed"]) < -REVERSE else size


def _travel(grid: Grid, forward: str) -> Array:
    """Return the speed along the positions, with the sign of the speed.

    The positions are smoothed over enough rows to suppress noise and resolution; longer smoothing would cut turns.
    """
    places = [grid.channels[a] for a in ("x", "y")]
    noise = max(
        float(np.median(np.abs(np.diff(coordinate, 3)))) / 3.0 for coordinate in places
    )  # smooth motion has little
    # The median third difference of white noise is 0.67 · √20 = 3 times its standard deviation.
    quantum = max((resolution(coordinate) or 0.0) for coordinate in places)
    way = np.hypot(*(np.diff(coordinate[::5]) for coordinate in places)) / 5.0
    width = max(3, int(min(max(20.0 * noise, 10.0 * quantum) / max(float(np.percentile(way, 75.0)), 1e-9), 401)) | 1)
    box = np.ones(width) / width
    parts = [grid.rate(np.convolve(np.pad(grid.channels[a], width // 2, "edge"), box, "valid")) for a in ("x", "y")]
    return np.hypot(*parts) * np.sign(grid.channels[forward])


class Gain(NamedTuple):
    """Scale of a relation in a log.

    Attributes:
        relation: the relation.
        gain: slope of the left over the right side, 1 if everything is right.
        sigma: its standard deviation.
        offset: offset of the left side [its unit].
        correlation: correlation of both sides, without the further terms of the relation.
    """

    relation: Relation
    gain: float
    sigma: float
    offset: float
    correlation: float

    @property
    def bounds(self) -> tuple[float, float]:
        """Bounds of the magnitude of the gain by noise on either side (Frisch), and four standard deviations [1]."""
        size, share = abs(self.gain), abs(self.correlation)
        # The gain of a derivative is the regression of the right on the left side, others lie in the middle.
        low, high = (share**2, 1.0) if self.relation.derivative else (share, 1.0 / share)
        return low * size - 4.0 * self.sigma, high * size + 4.0 * self.sigma


def estimate_gain(relation: Relation, grid: Grid) -> Gain | None:
    """Return the scale of a relation from means over windows, which delays hardly affect; None if too little moves."""
    left, right = relation.left(grid), relation.right(grid)
    # Means over windows suppress noise, and delays much shorter than a window.
    width = max(4, round(0.4 / grid.step))
    if len(left) < 20 * width:
        width = max(4, len(left) // 40)
    count = len(left) // width
    if count < 8:
        return None
    terms = [] if relation.beside is None else relation.beside(grid)
    columns = [values[: count * width].reshape(count, width).mean(axis=1) for values in (left, right, *terms)]
    # Few windows do not determine more than the gain and the offset.
    beside = np.column_stack((*columns[2:], np.ones(count))) if count >= 8 + 4 * len(terms) else np.ones((count, 1))
    use = np.ones(count, dtype=bool)
    slope = offset = correlation = sigma = 0.0
    # Outliers beyond 4 deviations (by the median) are left out until the set is stable enough: shocks, GPS jumps.
    for _ in range(5):
        if use.sum() < 6 + beside.shape[1]:
            return None
        # Partial regression: what the further terms and the offset explain is removed from both sides.
        pair = np.column_stack(columns[:2])
        a, b = (pair - beside @ np.linalg.lstsq(beside[use], pair[use], rcond=None)[0]).T
        if np.std(a[use]) <= 1e-12 * np.std(pair[:, 0]) or np.std(b[use]) <= 1e-12 * np.std(pair[:, 1]):
            return None
        correlation = float(np.corrcoef(a[use], b[use])[0, 1])
        if relation.derivative:  # the noise is in the derivative, so it is the dependent variable
            slope = float(a[use].var() / np.cov(a[use], b[use], bias=True)[0, 1])
        else:  # both sides have noise: reduced major axis
            slope = float(np.sign(correlation) * a[use].std() / b[use].std())
        offset = float(np.mean(columns[0][use]) - slope * np.mean(columns[1][use]))
        away = np.abs(a - slope * b)
        spread = 1.4826 * float(np.median(away[use]))
        sigma = abs(slope) * np.sqrt(max(1.0 - correlation**2, 1e-12) / max(use.sum() - 2, 1))
        use = away <= max(4.0 * spread, 1e-12)
    return Gain(relation, slope, float(sigma), offset, correlation)


FACTORS = {
    "deg as rad": (("rad", "rad/s"), 57.29577951308232),
    "rad as deg": (("rad", "rad/s"), 0.017453292519943295),
    "km/h as m/s": (("m/s",), 3.6),
    "m/s as km/h": (("m/s",), 1 / 3.6),
    "g as m/s^2": (("m/s^2",), 1 / GRAVITY),
    "m/s^2 as g": (("m/s^2",), GRAVITY),
    "wrong sign": ((), -1.0),
}
"""Mistakes: the units that they apply to, and the factor by which the values are too large."""


class Mistake(NamedTuple):
    """Channel and mistake that would explain the gains."""

    channel: str
    what: str


def explain_gains(gains: list[Gain], units: Mapping[str, str]) -> tuple[list[Mistake], float | None]:
    """Return the smallest set of mistakes that explains gains other than 1.

    Args:
        gains: gains of the relations of a log.
        units: SI units by channel.

    Returns:
        The mistakes, each of which alone explains everything; and the factor by which the step is too short, or None.
    """
    factor = step_factor(gains)
    if factor is not None:
        return [], factor
    if all(_is_near_one(gain.gain) for gain in gains):
        return [], None
    candidates = []
    names = sorted({name for gain in gains for name in (gain.relation.measured, *gain.relation.others)})
    # A single mistake that explains all gains is more probable than several at once.
    for name, (mistake, (of, size)) in product(names, FACTORS.items()):
        if of and units[name] not in of:
            continue
        if all(_is_near_one(gain.gain / relation_effect(gain.relation, name, size)) for gain in gains):
            candidates.append(Mistake(name, mistake))
    return candidates, None


def relation_effect(relation: Relation, name: str, factor: float) -> float:
    """Return the factor on the gain of a relation if the values of a channel are multiplied by a factor."""
    if name == relation.measured:
        return factor if relation.measured not in relation.others else 1.0
    if name in relation.others:
        order = relation.orders[relation.others.index(name)]
        return float(factor ** (-order)) if order else 1.0
    return 1.0


def _is_near_one(gain: float) -> bool:
    return 0.8 < gain < 1.25


def step_factor(gains: list[Gain]) -> float | None:
    """Return the true over the stated step, if relations with a derivative agree on it and the others hold; else None.

    One relation with a derivative suffices if one without shows that the units are right.
    """
    timed = [gain for gain in gains if gain.relation.derivative and abs(gain.correlation) > 0.8]
    others = [gain for gain in gains if not gain.relation.derivative and abs(gain.correlation) > 0.8]
    # One relation alone cannot distinguish a wrong step from a wrong unit.
    if not timed or len(timed) + len(others) < 2 or not all(_is_near_one(gain.gain) for gain in others):
        return None
    # A step of one is possible if no relation excludes it, however noisy its channels are.
    least, largest = (max(gain.bounds[0] for gain in timed), min(gain.bounds[1] for gain in timed))
    if least < 1.0 < largest:
        return None
    # left = gain · right, and the right side is too large by the ratio of true to stated step.
    # The step is the weighted mean of all relations, if they agree.
    weights = np.array([1.0 / max(gain.sigma / abs(gain.gain), 1e-3) ** 2 for gain in timed])
    factors = np.array([1.0 / gain.gain for gain in timed])
    if np.any(factors <= 0.0):
        return None
    # Ratios are averaged as logarithms, so that a factor and its inverse count alike.
    mean = float(np.exp(np.average(np.log(factors), weights=weights)))
    agree = np.all(np.abs(factors / mean - 1.0) < 0.06)
    sigma = mean / float(np.sqrt(weights.sum()))
    # The limit is symmetric in the logarithm: for short steps it is the inverse of that for long ones.
    min_deviation = 0.05 if len(timed) > 1 else MIN_SINGLE_DEVIATION * max(mean, 1.0) / (1.0 + MIN_SINGLE_DEVIATION)
    return mean if agree and abs(mean - 1.0) > max(min_deviation, 4.0 * sigma) else None
