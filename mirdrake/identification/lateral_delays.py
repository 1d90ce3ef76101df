"""How late lateral acceleration and lateral velocity are behind the yaw rate, and where the accelerometer sits.

With the accelerometer d ahead of the place whose velocity is logged, and h lower, on a body that leans by k times the
lateral acceleration::

    ay = vx r + dvy/dt + d dr/dt + h k d²ay/dt²

It leans, too, which makes the acceleration larger, and late, as the lean is.

A late vy, a late ay and a sensor in another place look alike: at one speed v, a distance d is a delay d / v. So all
are found together, at the speeds that the drive has, and a delay is told only if it remains when the others are
free. Noise of slopes would make delays look small and sure; instruments keep it out. Drives with one recorder are
looked at together: what one of them does not tell, the others do.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d, uniform_filter1d

from mirdrake.identification.data import Array
from mirdrake.identification.relations import Grid
from mirdrake.identification.splines import Curve

WIDTHS = (0.05, 0.1, 0.2, 0.4)
"""Smoothing of all channels [s]; the one that is surest counts."""

LONGEST = 0.4
"""Longest delay [s]."""

SLOW = 2.0
"""What is left of the channels by a smoothing over this is not compared [s]."""

SCALES = 0.05
"""What scales of sensors, and the lean of the body, make of an acceleration: standard deviation [1]."""

LEAN_LAG = 0.06
"""How late the lean is behind the acceleration, of a car: 2 ζ / ω of a roll of 9 rad/s with a damping ratio of 0.3 [s];
that of smaller vehicles goes with REACH. Of an accelerometer that leans by a tenth it makes one that is 6 ms late."""

LEAN = 0.004
"""Height of one sensor over another times roll angle over lateral acceleration [s²], as standard deviation, of a car;
that of smaller vehicles goes with the square of REACH. The roll acceleration is in the difference of both."""

REACH, FARTHEST = 0.05, 1.0
"""Where a sensor sits, as standard deviation: so many seconds of driving at the usual speed [s], and not more [m]."""

SURE = 6.0
"""Standard deviations from which on an estimate is no chance."""

LIKELY, MISSED, LITTLE = 4.0, 1.5, 0.001
"""A delay is one if it has so many standard deviations and, without it, so many times as much is left of dvy/dt; what
is less than such a part of it is nothing."""

CONTRADICTS = 0.04
"""A log whose own delay is nearer than this to that of all logs does not contradict it [s]."""

BLOCKS, FEWEST = 20, 150
"""Parts of the drives, whose scatter gives the uncertainty; and smoothed rows that tell something."""

MOST_ROWS = 50_000
"""Rows of a long drive that are looked at."""


class Opened(NamedTuple):
    """Which unknowns are sought; the others are 0."""

    acceleration: bool
    velocity: bool
    arm: bool


class LateralDelays(NamedTuple):
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
        size: the same of all of dvy/dt [m²/s⁴].
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
    size: float
    opened: Opened


def estimate_lateral_delays(
    grids: Sequence[Grid], least: float, *, together: bool | None = None
) -> LateralDelays | None:
    """The delays of the lateral acceleration and of vy; None: the channels are not there, or do not tell.

    Args:
        grids: of logs with one recorder; those without the channels do not count.
        least: shorter delays are none [s].
        together: whether vx and vy have one clock, as those of one source; None: what fits better.
    """
    forward = "vx" if all("vx" in grid.channels for grid in grids) else "speed"
    needed = {"vy", "yaw_rate", "lateral_acceleration", forward}
    drives = _Drives([grid for grid in grids if needed <= set(grid.channels)], forward)
    if together is not None:
        return _sought(drives, least, together)
    alone, both = (_sought(drives, least, one) for one in (False, True))
    if alone is None or both is None or not both.velocity:
        return alone
    # A speed that is late, too, must leave less: compared with the same smoothing.
    width = max(alone.width, both.width)
    rests = [
        np.inf if (found := drives.at(width, one.opened, one.together)) is None else found.rest for one in (alone, both)
    ]
    return both if rests[1] < rests[0] else alone


def contradict(grids: Sequence[Grid], found: LateralDelays | None) -> bool:
    """Whether single logs tell surely of another delay of vy than all together.

    Args:
        grids: of logs that were looked at together.
        found: what they told together.
    """
    if found is None:
        return False
    forward = "vx" if all("vx" in grid.channels for grid in grids) else "speed"
    needed = {"vy", "yaw_rate", "lateral_acceleration", forward}
    opened = found.opened._replace(velocity=True, arm=True)
    for grid in grids:
        if needed <= set(grid.channels):
            own = _Drives([grid], forward).at(found.width, opened, found.together)
            apart = 0.0 if own is None else abs(own.velocity - found.velocity)
            if own is not None and apart > max(CONTRADICTS, SURE * own.sigmas[1]):
                return True
    return False


def _sought(drives: "_Drives", least: float, together: bool) -> LateralDelays | None:
    """With all unknowns first, and then without the delays that are none."""
    opened, found = Opened(True, True, True), None
    for _ in range(3):
        found = drives.surest(opened, together)
        if found is None:
            return None
        sure = {
            name: abs(value) / max(sigma, 1e-12) if abs(value) > least else 0.0
            for name, value, sigma in zip(
                Opened._fields, (found.acceleration, found.velocity), found.sigmas, strict=False
            )
            if getattr(opened, name)
        }
        doubtful = [name for name, size in sure.items() if size < LIKELY or not drives.is_missed(name, found)]
        if not doubtful:
            break
        # The one that says least is none, or the one without which the other is late; then once more without it.
        least_sure = min(doubtful, key=lambda name: sure[name])
        makes_late = [name for name in doubtful if _leaves_late(drives, found, name)] if len(sure) > 1 else []
        opened = opened._replace(**{makes_late[0] if len(makes_late) == 1 else least_sure: False})
    if found is not None and not opened.acceleration and abs(found.arm) > 2.0 * found.arm_sigma:
        # At one speed nothing tells a late acceleration from a sensor in another place: what leaves less; and much less
        # if vy is late, that is, of another instrument, which is in another place.
        other = drives.at(found.width, opened._replace(acceleration=True, arm=False), together)
        sharp = other is not None and abs(other.acceleration) > max(least, SURE * other.sigmas[0])
        if other is not None and sharp:
            limit = MISSED * max(other.rest, LITTLE * other.size) if found.velocity else other.rest
            if found.rest > limit:
                return other
    return found


def _leaves_late(drives: "_Drives", found: LateralDelays, name: str) -> bool:
    """Whether without a delay the other one is a lateness: behind a gyroscope nothing is early."""
    without = drives.at(found.width, found.opened._replace(**{name: False}), found.together)
    return without is not None and max(without.acceleration, without.velocity) > 0.0


class _Drives:
    """Logs that are looked at together."""

    def __init__(self, grids: Sequence[Grid], forward: str) -> None:
        self._grids, self._forward = [_liveliest(grid) for grid in grids], forward
        self._smoothed: dict[float, list[_Drive]] = {}
        self._coarsest = max((grid.step for grid in grids), default=0.0)

    def surest(self, opened: Opened, together: bool) -> LateralDelays | None:
        """With the smoothing that leaves the delays, or the arm, surest."""
        found = [self.at(max(width, 2.0 * self._coarsest), opened, together) for width in WIDTHS]
        tried = [one for one in found if one is not None]
        return min(tried, key=lambda one: (max(one.sigmas), one.arm_sigma)) if tried else None

    def is_missed(self, name: str, found: LateralDelays) -> bool:
        """Whether much more is left of dvy/dt without a delay."""
        without = self.at(found.width, found.opened._replace(**{name: False}), found.together)
        return without is not None and without.rest > MISSED * max(found.rest, LITTLE * found.size)

    def at(self, width: float, opened: Opened, together: bool) -> LateralDelays | None:
        """With a smoothing over a width [s]; a delay that is not open is 0.

        Rows with even numbers give the residuals, those with odd numbers what these are compared with (instruments):
        their noise is not the same, so that it neither makes a delay nor makes one look sure.
        """
        if width not in self._smoothed:
            made = [_Drive(grid, self._forward, width) for grid in self._grids]
            self._smoothed[width] = [drive for drive in made if drive.count > 0]
        drives = self._smoothed[width]
        count = sum(drive.count for drive in drives)
        if count < FEWEST:
            return None
        step = max(drive.step for drive in drives)
        # Unknowns: both delays, arm, two scales, an offset, height. A prior of infinite width is none.
        usual = np.sqrt(np.mean(np.concatenate([grid.channels[self._forward] for grid in self._grids]) ** 2))
        reach = min(REACH * float(usual), FARTHEST)
        wide = (LONGEST, LONGEST, reach, SCALES, SCALES, np.inf, LEAN * reach**2)
        widths = np.where([*opened, True, True, True, True], wide, 1e-9)
        unknown, lag = np.zeros(len(wide)), LEAN_LAG * reach

        def compared(half: int) -> list[Array]:
            parts = [drive.compared(half, unknown, lag, together) for drive in drives]
            return [np.concatenate(columns) for columns in zip(*parts, strict=True)]

        for _ in range(30):
            (rest, base, up), (_, other, _) = compared(0), compared(1)
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
        left, _, rise = compared(1)
        # The scatter of the parts of the drive: residuals are those of the road and of the model, too.
        scores = np.array([other[part].T @ rest[part] for part in np.array_split(np.arange(count), BLOCKS)])
        inverse = np.linalg.inv(normal)
        spread = inverse @ (scores.T @ scores) @ inverse * BLOCKS / (BLOCKS - len(unknown))
        sigma = np.sqrt(np.diag(spread))
        return LateralDelays(
            float(unknown[0]) if opened.acceleration else 0.0,
            float(unknown[1]) if opened.velocity else 0.0,
            (float(sigma[0]) if opened.acceleration else 0.0, float(sigma[1]) if opened.velocity else 0.0),
            float(unknown[2]),
            float(sigma[2]),
            correlation,
            together,
            width,
            float(np.mean(rest * left)),
            float(np.mean(up * rise)),
            opened,
        )


def _liveliest(grid: Grid) -> Grid:
    """Of a long drive, the part that turns most: it tells enough."""
    size = len(grid.channels["vy"])
    if size <= 2 * MOST_ROWS:
        return grid
    starts = range(0, size - MOST_ROWS + 1, MOST_ROWS)
    begin = max(starts, key=lambda at: float(np.var(grid.channels["yaw_rate"][at : at + MOST_ROWS])))
    return Grid(grid.step, {name: values[begin : begin + MOST_ROWS] for name, values in grid.channels.items()})


def _sizes(matrix: Array) -> Array:
    size = np.sqrt(np.maximum(np.abs(np.diag(matrix)), 1e-300))
    return np.asarray(np.outer(size, size))


class _Drive:
    """One log, smoothed, as two halves of its rows."""

    def __init__(self, grid: Grid, forward: str, width: float) -> None:
        rows = width / grid.step
        thin = max(1, int(0.5 * rows))
        self.step = thin * grid.step
        margin = int((LONGEST + 3.0 * width) / self.step) + 1
        self.count = -(-len(grid.channels["vy"]) // thin) - 2 * margin
        if self.count > 0:
            self._inner = slice(margin, margin + self.count)
            self._halves = [_Half(grid, forward, rows, thin, part) for part in range(2)]

    def compared(self, half: int, unknown: Array, lag: float, together: bool) -> tuple[Array, Array, Array]:
        """Residuals, slopes and dvy/dt of a half, with a lag of the lean [s]."""
        return self._halves[half].compared(unknown, self._inner, lag, together)


class _Half:
    """Every second row of the channels, smoothed."""

    def __init__(self, grid: Grid, forward: str, rows: float, thin: int, part: int) -> None:
        size = len(grid.channels["vy"])
        use = (np.arange(size) % 2 == part).astype(float)
        share = gaussian_filter1d(use, rows, mode="nearest")
        step = thin * grid.step

        def soft(values: Array) -> Array:
            return np.asarray((gaussian_filter1d(values * use, rows, mode="nearest") / share)[::thin])

        turn = grid.channels["yaw_rate"]
        self.step = step
        self.turn, speed = soft(turn), grid.channels[forward]
        self.rest = soft(turn * speed) - soft(turn) * soft(speed)  # what smoothing makes of a product
        self.speed = Curve(soft(speed))
        self.spin = np.gradient(self.turn, step)
        sides = (soft(grid.channels["lateral_acceleration"]), np.gradient(soft(grid.channels["vy"]), step))
        self.curves = [Curve(values) for values in sides]

    def compared(self, unknown: Array, inner: slice, lag: float, together: bool) -> tuple[Array, Array, Array]:
        """Residuals (n) of ``dvy/dt - ay + vx r + …``, their slopes (n, 7) with the other sign, and dvy/dt."""
        moved = unknown[:2] / self.step
        push, rise = (curve.at(inner, late) for curve, late in zip(self.curves, moved, strict=True))
        slopes = [curve.at(inner, late, 1) / self.step for curve, late in zip(self.curves, moved, strict=True)]
        late = moved[1] if together else 0.0
        turn, spin = self.turn[inner], self.spin[inner]
        whirl = self.rest[inner] + turn * self.speed.at(inner, late)
        if together:
            slopes[1] = slopes[1] + turn * self.speed.at(inner, late, 1) / self.step
        sway = self.curves[0].at(inner, moved[0], 2) / self.step**2
        lean = lag * slopes[0]  # an acceleration that is larger than what turns leans
        base = np.column_stack((slopes[0], -slopes[1], -spin, push - lean, lean - whirl, np.ones(len(push)), sway))
        rest = rise - push + whirl + spin * unknown[2] - base[:, 3:] @ unknown[3:]
        # What changes slowly is the bank of the road and the bias of sensors.
        fast = [values - _slow(values, SLOW / self.step) for values in (rest, base, rise)]
        fast[1][:, 5] = 1.0
        return fast[0], fast[1], fast[2]


def _slow(values: Array, rows: float) -> Array:
    """Three running means, which together are nearly a Gaussian of so many rows, in a time that does not go with it."""
    size = 2 * max(1, round(rows)) + 1
    for _ in range(3):
        values = uniform_filter1d(values, size, axis=0, mode="reflect")
    return values
