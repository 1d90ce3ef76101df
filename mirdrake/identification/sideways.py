"""How late lateral acceleration and lateral velocity are behind the yaw rate, and where the accelerometer sits.

With the accelerometer d ahead of the place whose velocity is logged::

    ay = vx r + dvy/dt + d dr/dt

A late vy, a late ay and a sensor in another place look alike: at one speed v, a distance d is a delay d / v. So all
three are found together, at the speeds that the drive has, and a delay is told only if it remains when the others are
free. Noise of slopes would make delays look small and sure; instruments keep it out.
"""

from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from mirdrake.identification.data import Array
from mirdrake.identification.relations import Grid

WIDTHS = (0.05, 0.1, 0.2, 0.4)
"""Smoothing of all channels [s]; the one that is surest counts."""

LONGEST = 0.4
"""Longest delay [s]."""

SLOW = 2.0
"""What is left of the channels by a smoothing over this is not compared [s]."""

SCALES = 0.05
"""What scales of sensors, and the lean of the body, make of an acceleration: standard deviation [1]."""

REACH, FARTHEST = 0.05, 1.0
"""Where a sensor sits, as standard deviation: so many seconds of driving at the usual speed [s], and not more [m]."""

SURE = 6.0
"""A delay is one from so many standard deviations on."""

BLOCKS = 20

MOST_ROWS = 50_000
"""Rows of a long drive that are looked at."""


class Opened(NamedTuple):
    """Which unknowns are sought; the others are 0."""

    acceleration: bool
    velocity: bool
    arm: bool


class Sideways(NamedTuple):
    """What lateral channels say of each other.

    Attributes:
        acceleration: how late the lateral acceleration is behind the yaw rate [s]; 0: it is not.
        velocity: the same of vy [s].
        sigmas: standard deviations of both [s].
        arm: how far ahead of the place of vy the accelerometer sits [m].
        arm_sigma: its standard deviation [m].
        correlation: of dvy/dt with what the others give.
        together: whether vx is as late as vy.
        width: smoothing that was surest [s].
        rest: mean square of what is left of dvy/dt, without its noise [m²/s⁴].
        opened: what was sought.
    """

    acceleration: float
    velocity: float
    sigmas: tuple[float, float]
    arm: float
    arm_sigma: float
    correlation: float
    together: bool
    width: float
    rest: float
    opened: Opened


def sideways_delays(grid: Grid, least: float, *, together: bool | None = None) -> Sideways | None:
    """The delays of the lateral acceleration and of vy; None: the channels are not there, or do not tell.

    Args:
        grid: of a log.
        least: shorter delays are none [s].
        together: whether vx and vy have one clock, as those of one source; None: what fits better.
    """
    forward = "vx" if "vx" in grid.channels else "speed"
    if not {"vy", "yaw_rate", "lateral_acceleration", forward} <= set(grid.channels):
        return None
    if len(grid.channels["vy"]) > 2 * MOST_ROWS:  # the part that turns most tells enough
        starts = range(0, len(grid.channels["vy"]) - MOST_ROWS + 1, MOST_ROWS)
        begin = max(starts, key=lambda at: float(np.var(grid.channels["yaw_rate"][at : at + MOST_ROWS])))
        grid = Grid(grid.step, {name: values[begin : begin + MOST_ROWS] for name, values in grid.channels.items()})
    if together is None:
        alone, both = (sideways_delays(grid, least, together=one) for one in (False, True))
        if alone is None or both is None or not both.velocity:
            return alone
        # A speed that is late, too, must leave less: compared with the same smoothing.
        width = max(alone.width, both.width)
        rests = [
            np.inf if (found := _at(grid, forward, width, one.opened, one.together)) is None else found.rest
            for one in (alone, both)
        ]
        return both if rests[1] < rests[0] else alone
    opened, found = Opened(True, True, True), None
    for _ in range(3):
        found = _surest(grid, forward, opened, together)
        if found is None:
            return None
        sure = {
            name: abs(value) / max(sigma, 1e-12) if abs(value) > least else 0.0
            for name, value, sigma in zip(
                Opened._fields, (found.acceleration, found.velocity), found.sigmas, strict=False
            )
            if getattr(opened, name)
        }
        doubtful = [name for name, size in sure.items() if size < SURE]
        if not doubtful:
            break
        # The one that says least is none; then once more without it.
        opened = opened._replace(**{min(doubtful, key=lambda name: sure[name]): False})
    if found is not None and not opened.acceleration and abs(found.arm) > 2.0 * found.arm_sigma:
        # At one speed nothing tells a late acceleration from a sensor in another place: what leaves less.
        other = _at(grid, forward, found.width, opened._replace(acceleration=True, arm=False), together)
        sharp = other is not None and abs(other.acceleration) > max(least, SURE * other.sigmas[0])
        if other is not None and sharp and other.rest < found.rest:
            return other
    return found


def _surest(grid: Grid, forward: str, opened: Opened, together: bool) -> Sideways | None:
    """With the smoothing that leaves the delays, or the arm, surest."""
    found = [_at(grid, forward, max(width, 2.0 * grid.step), opened, together) for width in WIDTHS]
    tried = [one for one in found if one is not None]
    return min(tried, key=lambda one: (max(one.sigmas), one.arm_sigma)) if tried else None


def _at(grid: Grid, forward: str, width: float, opened: Opened, together: bool) -> Sideways | None:
    """The same with a smoothing over a width [s]; a delay that is not open is 0.

    Rows with even numbers give the residuals, those with odd numbers what these are compared with (instruments): their
    noise is not the same, so that it neither makes a delay nor makes one look sure.
    """
    rows = width / grid.step
    thin = max(1, int(0.5 * rows))
    step = thin * grid.step
    margin = int((LONGEST + 3.0 * width) / step) + 1
    count = -(-len(grid.channels["vy"]) // thin) - 2 * margin
    if count < 150:
        return None
    index, inner = np.arange(margin, margin + count, dtype=float), slice(margin, margin + count)
    halves = [_Half(grid, forward, rows, thin, part, together) for part in range(2)]
    # Unknowns: both delays, arm, two scales, an offset. A prior of infinite width is none.
    reach = min(REACH * float(np.sqrt(np.mean(grid.channels[forward] ** 2))), FARTHEST)
    widths = np.where([*opened, True, True, True], (LONGEST, LONGEST, reach, SCALES, SCALES, np.inf), 1e-9)
    unknown = np.zeros(6)
    for _ in range(30):
        (rest, base, up), (_, other, _) = (half.compared(unknown, index, inner) for half in halves)
        noise = 2.0 * float(np.sqrt(np.mean(rest**2)))  # neighbours are alike: each counts for a quarter
        held = np.where(np.isfinite(widths), (noise / np.maximum(widths, 1e-12)) ** 2, 0.0)
        normal = other.T @ base
        normal = 0.5 * (normal + normal.T) + np.diag(held)
        if not np.all(np.isfinite(normal)) or np.linalg.cond(normal / _sizes(normal)) > 1e10:
            return None
        change = np.linalg.solve(normal, other.T @ rest - held * unknown)
        change[:2] = np.clip(change[:2], -step, step)
        unknown = unknown + change
        if np.any(np.abs(unknown[:2]) > LONGEST):
            return None
        if np.all(np.abs(change) < 1e-5 * (1.0 + np.abs(unknown))):
            break
    else:
        return None
    correlation = float(np.corrcoef(up, up - rest)[0, 1])
    if correlation < 0.7:
        return None
    # The scatter of the parts of the drive: residuals are those of the road and of the model, too.
    scores = np.array([other[part].T @ rest[part] for part in np.array_split(np.arange(count), BLOCKS)])
    inverse = np.linalg.inv(normal)
    spread = inverse @ (scores.T @ scores) @ inverse * BLOCKS / (BLOCKS - len(unknown))
    sigma = np.sqrt(np.diag(spread))
    return Sideways(
        float(unknown[0]) if opened.acceleration else 0.0,
        float(unknown[1]) if opened.velocity else 0.0,
        (float(sigma[0]) if opened.acceleration else 0.0, float(sigma[1]) if opened.velocity else 0.0),
        float(unknown[2]),
        float(sigma[2]),
        correlation,
        together,
        width,
        float(np.mean(rest * halves[1].compared(unknown, index, inner)[0])),
        opened,
    )


def _sizes(matrix: Array) -> Array:
    size = np.sqrt(np.maximum(np.abs(np.diag(matrix)), 1e-300))
    return np.asarray(np.outer(size, size))


class _Half:
    """Every second row of the channels, smoothed."""

    def __init__(self, grid: Grid, forward: str, rows: float, thin: int, part: int, together: bool) -> None:
        size = len(grid.channels["vy"])
        use = (np.arange(size) % 2 == part).astype(float)
        share = gaussian_filter1d(use, rows, mode="nearest")
        step = thin * grid.step

        def soft(values: Array) -> Array:
            return np.asarray((gaussian_filter1d(values * use, rows, mode="nearest") / share)[::thin])

        turn = grid.channels["yaw_rate"]
        self.step = step
        self.together, self.turn, speed = together, soft(turn), grid.channels[forward]
        self.rest = soft(turn * speed) - soft(turn) * soft(speed)  # what smoothing makes of a product
        self.speed = CubicSpline(np.arange(float(len(self.turn))), soft(speed))
        self.spin = np.gradient(self.turn, step)
        sides = (soft(grid.channels["lateral_acceleration"]), np.gradient(soft(grid.channels["vy"]), step))
        self.curves = [CubicSpline(np.arange(float(len(values))), values) for values in sides]

    def compared(self, unknown: Array, index: Array, inner: slice) -> tuple[Array, Array, Array]:
        """Residuals (n) of ``dvy/dt - ay + vx r + d dr/dt``, their slopes (n, 6) with the other sign, and dvy/dt."""
        push, rise = (curve(index + late / self.step) for curve, late in zip(self.curves, unknown, strict=False))
        slopes = [
            curve(index + late / self.step, 1) / self.step for curve, late in zip(self.curves, unknown, strict=False)
        ]
        moved = index + (unknown[1] / self.step if self.together else 0.0)
        turn, spin = self.turn[inner], self.spin[inner]
        whirl = self.rest[inner] + turn * self.speed(moved)
        if self.together:
            slopes[1] = slopes[1] + turn * self.speed(moved, 1) / self.step
        base = np.column_stack((slopes[0], -slopes[1], -spin, push, -whirl, np.ones(len(index))))
        rest = rise - push + whirl + spin * unknown[2] - base[:, 3:] @ unknown[3:]
        # What changes slowly is the bank of the road and the bias of sensors.
        fast = [values - gaussian_filter1d(values, SLOW / self.step, axis=0) for values in (rest, base, rise)]
        fast[1][:, 5] = 1.0
        return fast[0], fast[1], fast[2]
