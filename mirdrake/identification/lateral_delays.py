"""Delays of lateral acceleration and lateral velocity against the yaw rate, and the position of the accelerometer.

With the accelerometer d ahead of the point whose velocity is logged, and h lower, on a body that rolls by k times the
lateral acceleration::

    ay = vx r + dvy/dt + d dr/dt + h k d²ay/dt²

The accelerometer also rolls with the body, which makes its signal larger and delays it, as roll lags.

A delay of vy, a delay of ay and another position of a sensor look alike: at one speed v, a distance d is a delay d / v.
So all are estimated together, at the speeds of the log, and a delay is reported only if it remains when the others are
free. Noise of the slopes would make delays look small and certain; instrumental variables avoid it. Logs of one
recorder are used together, as each may determine what another does not.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d, uniform_filter1d

from mirdrake.identification.data import Array
from mirdrake.identification.relations import Grid
from mirdrake.identification.splines import Spline

WIDTHS = (0.05, 0.1, 0.2, 0.4)
"""Smoothings of all channels [s]; the most certain result counts."""

MAX_DELAY = 0.4
"""Largest delay [s]."""

SLOW = 2.0
"""Time scale above which changes are removed before the comparison [s]."""

SCALES = 0.05
"""Standard deviation of the scale of an acceleration, by sensor errors and roll [1]."""

ROLL_LAG = 0.06
"""Lag of roll behind the acceleration, of a car: 2 ζ / ω for roll of 9 rad/s with a damping ratio of 0.3 [s]; for
smaller vehicles it scales with POSITION_TIME. An accelerometer that measures a tenth more by roll is 6 ms late."""

ROLL_HEIGHT = 0.004
"""Standard deviation of the height difference of two sensors times roll angle over lateral acceleration [s²], of a car;
for smaller vehicles it scales with the square of POSITION_TIME. The roll acceleration is in their difference."""

POSITION_TIME, MAX_POSITION = 0.05, 1.0
"""Standard deviation of a sensor's position: seconds of driving at the usual speed [s], limited to a distance [m]."""

SIGNIFICANT = 6.0
"""Standard deviations above which an estimate is significant."""

LIKELY, RESIDUAL_FACTOR, NEGLIGIBLE = 4.0, 1.5, 0.001
"""A delay is accepted if it exceeds LIKELY standard deviations and if removing it multiplies the residual of dvy/dt by
at least RESIDUAL_FACTOR; residuals below NEGLIGIBLE of dvy/dt are negligible."""

CONTRADICTS = 0.04
"""Least difference between the delays of a single log and of all logs that counts as a contradiction [s]."""

BLOCKS, MIN_ROWS = 20, 150
"""Parts of the logs whose scatter gives the uncertainty; and the least number of smoothed rows."""

MAX_ROWS = 50_000
"""Largest number of rows of a long log that are used."""


class FreeUnknowns(NamedTuple):
    """Which unknowns are estimated; the others are 0."""

    acceleration: bool
    velocity: bool
    arm: bool


class LateralDelays(NamedTuple):
    """Delays and position estimated from lateral channels.

    Attributes:
        acceleration: delay of the lateral acceleration against the yaw rate [s]; 0 if it has none.
        velocity: delay of vy [s].
        sigmas: standard deviations of both [s].
        arm: distance of the accelerometer ahead of the position of vy [m].
        arm_sigma: its standard deviation [m].
        correlation: correlation of dvy/dt with what the others give.
        together: whether vx has the same delay as vy.
        width: smoothing with the most certain result [s].
        rest: mean square of the residual of dvy/dt, without its noise [m²/s⁴].
        size: mean square of dvy/dt [m²/s⁴].
        free: which unknowns were estimated.
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
    free: FreeUnknowns


def estimate_lateral_delays(
    grids: Sequence[Grid], least: float, *, together: bool | None = None
) -> LateralDelays | None:
    """Return the delays of the lateral acceleration and of vy; None if channels or information are missing.

    Args:
        grids: logs of one recorder; those without the channels do not count.
        least: shorter delays count as none [s].
        together: whether vx and vy have one clock, as from one source; None for what fits better.
    """
    forward = "vx" if all("vx" in grid.channels for grid in grids) else "speed"
    needed = {"vy", "yaw_rate", "lateral_acceleration", forward}
    drives = _LogSet([grid for grid in grids if needed <= set(grid.channels)], forward)
    if together is not None:
        return _select_delays(drives, least, together)
    alone, both = (_select_delays(drives, least, one) for one in (False, True))
    if alone is None or both is None or not both.velocity:
        return alone
    # A delay of the speed must reduce the residual, at the same smoothing.
    # Residuals are comparable only at the same smoothing.
    width = max(alone.width, both.width)
    rests = [
        np.inf if (found := drives.estimate(width, one.free, one.together)) is None else found.rest
        for one in (alone, both)
    ]
    return both if rests[1] < rests[0] else alone


def logs_contradict(grids: Sequence[Grid], found: LateralDelays | None) -> bool:
    """Whether single logs have a significantly different delay of vy than all logs together.

    Args:
        grids: logs that were used together.
        found: their common result.
    """
    if found is None:
        return False
    forward = "vx" if all("vx" in grid.channels for grid in grids) else "speed"
    needed = {"vy", "yaw_rate", "lateral_acceleration", forward}
    free = found.free._replace(velocity=True, arm=True)
    for grid in grids:
        if needed <= set(grid.channels):
            own = _LogSet([grid], forward).estimate(found.width, free, found.together)
            apart = 0.0 if own is None else abs(own.velocity - found.velocity)
            if own is not None and apart > max(CONTRADICTS, SIGNIFICANT * own.sigmas[1]):
                return True
    return False


def _select_delays(drives: "_LogSet", least: float, together: bool) -> LateralDelays | None:
    """Estimate all unknowns first, then remove delays that are not significant."""
    free, found = FreeUnknowns(True, True, True), None
    for _ in range(3):
        found = drives.estimate_best(free, together)
        if found is None:
            return None
        sure = {
            name: abs(value) / max(sigma, 1e-12) if abs(value) > least else 0.0
            for name, value, sigma in zip(
                FreeUnknowns._fields, (found.acceleration, found.velocity), found.sigmas, strict=False
            )
            if getattr(free, name)
        }
        doubtful = [name for name, size in sure.items() if size < LIKELY or not drives.is_needed(name, found)]
        if not doubtful:
            break
        # Remove the least certain delay, or the one without which the other one is positive, and estimate again.
        least_sure = min(doubtful, key=lambda name: sure[name])
        makes_late = [name for name in doubtful if _leaves_positive_delay(drives, found, name)] if len(sure) > 1 else []
        free = free._replace(**{makes_late[0] if len(makes_late) == 1 else least_sure: False})
    if found is not None and not free.acceleration and abs(found.arm) > 2.0 * found.arm_sigma:
        # At one speed a delayed acceleration and another position of the sensor are not separable: the smaller residual
        # decides; it must be much smaller if vy has a delay, as a separate instrument is in another position.
        other = drives.estimate(found.width, free._replace(acceleration=True, arm=False), together)
        sharp = other is not None and abs(other.acceleration) > max(least, SIGNIFICANT * other.sigmas[0])
        if other is not None and sharp:
            limit = RESIDUAL_FACTOR * max(other.rest, NEGLIGIBLE * other.size) if found.velocity else other.rest
            if found.rest > limit:
                return other
    return found


def _leaves_positive_delay(drives: "_LogSet", found: LateralDelays, name: str) -> bool:
    """Whether without this delay the other one is positive: behind a gyroscope no channel is early."""
    without = drives.estimate(found.width, found.free._replace(**{name: False}), found.together)
    return without is not None and max(without.acceleration, without.velocity) > 0.0


class _LogSet:
    """Logs that are used together."""

    def __init__(self, grids: Sequence[Grid], forward: str) -> None:
        self._grids, self._forward = [_most_active(grid) for grid in grids], forward
        self._smoothed: dict[float, list[_SmoothedLog]] = {}
        self._coarsest = max((grid.step for grid in grids), default=0.0)

    def estimate_best(self, free: FreeUnknowns, together: bool) -> LateralDelays | None:
        """Estimate with the smoothing that gives the most certain delays and arm."""
        found = [self.estimate(max(width, 2.0 * self._coarsest), free, together) for width in WIDTHS]
        tried = [one for one in found if one is not None]
        return min(tried, key=lambda one: (max(one.sigmas), one.arm_sigma)) if tried else None

    def is_needed(self, name: str, found: LateralDelays) -> bool:
        """Whether the residual of dvy/dt is much larger without a delay."""
        without = self.estimate(found.width, found.free._replace(**{name: False}), found.together)
        return without is not None and without.rest > RESIDUAL_FACTOR * max(found.rest, NEGLIGIBLE * found.size)

    def estimate(self, width: float, free: FreeUnknowns, together: bool) -> LateralDelays | None:
        """Estimate with a smoothing over a width [s]; delays that are not free are 0.

        Rows with even numbers give the residuals, those with odd numbers the instrumental variables: their noise is
        independent, so it neither causes a delay nor makes one look certain.
        """
        if width not in self._smoothed:
            made = [_SmoothedLog(grid, self._forward, width) for grid in self._grids]
            self._smoothed[width] = [drive for drive in made if drive.count > 0]
        drives = self._smoothed[width]
        count = sum(drive.count for drive in drives)
        if count < MIN_ROWS:
            return None
        step = max(drive.step for drive in drives)
        # Unknowns: both delays, arm, two scales, an offset, height; each with a normal prior, infinite for the offset.
        usual = np.sqrt(np.mean(np.concatenate([grid.channels[self._forward] for grid in self._grids]) ** 2))
        reach = min(POSITION_TIME * float(usual), MAX_POSITION)
        wide = (MAX_DELAY, MAX_DELAY, reach, SCALES, SCALES, np.inf, ROLL_HEIGHT * reach**2)
        widths = np.where([*free, True, True, True, True], wide, 1e-9)
        unknown, lag = np.zeros(len(wide)), ROLL_LAG * reach

        def compared(half: int) -> list[Array]:
            parts = [drive.compared(half, unknown, lag, together) for drive in drives]
            return [np.concatenate(columns) for columns in zip(*parts, strict=True)]

        for _ in range(30):
            (rest, base, up), (_, other, _) = compared(0), compared(1)
            noise = 2.0 * float(np.sqrt(np.mean(rest**2)))  # neighbours are correlated: each counts for a quarter
            held = np.where(np.isfinite(widths), (noise / np.maximum(widths, 1e-12)) ** 2, 0.0)
            normal = other.T @ base
            normal = 0.5 * (normal + normal.T) + np.diag(held)
            if not np.all(np.isfinite(normal)) or np.linalg.cond(normal / _sizes(normal)) > 1e10:
                return None
            change = np.linalg.solve(normal, other.T @ rest - held * unknown)
            change[:2] = np.clip(change[:2], -step, step)
            unknown = unknown + change
            if np.any(np.abs(unknown[:2]) > MAX_DELAY):
                return None
            if np.all(np.abs(change) < 1e-5 * (1.0 + np.abs(unknown))):
                break
        else:
            return None
        correlation = float(np.corrcoef(up, up - rest)[0, 1])
        if correlation < 0.7:
            return None
        left, _, rise = compared(1)
        # Uncertainty by the scatter of the parts of the logs, as residuals contain errors of road and model, too.
        scores = np.array([other[part].T @ rest[part] for part in np.array_split(np.arange(count), BLOCKS)])
        inverse = np.linalg.inv(normal)
        spread = inverse @ (scores.T @ scores) @ inverse * BLOCKS / (BLOCKS - len(unknown))
        sigma = np.sqrt(np.diag(spread))
        return LateralDelays(
            float(unknown[0]) if free.acceleration else 0.0,
            float(unknown[1]) if free.velocity else 0.0,
            (float(sigma[0]) if free.acceleration else 0.0, float(sigma[1]) if free.velocity else 0.0),
            float(unknown[2]),
            float(sigma[2]),
            correlation,
            together,
            width,
            float(np.mean(rest * left)),
            float(np.mean(up * rise)),
            free,
        )


def _most_active(grid: Grid) -> Grid:
    """Return the part of a long log with the largest yaw motion."""
    size = len(grid.channels["vy"])
    if size <= 2 * MAX_ROWS:
        return grid
    starts = range(0, size - MAX_ROWS + 1, MAX_ROWS)
    begin = max(starts, key=lambda at: float(np.var(grid.channels["yaw_rate"][at : at + MAX_ROWS])))
    return Grid(grid.step, {name: values[begin : begin + MAX_ROWS] for name, values in grid.channels.items()})


def _sizes(matrix: Array) -> Array:
    size = np.sqrt(np.maximum(np.abs(np.diag(matrix)), 1e-300))
    return np.asarray(np.outer(size, size))


class _SmoothedLog:
    """One log, smoothed, as two halves of its rows."""

    def __init__(self, grid: Grid, forward: str, width: float) -> None:
        rows = width / grid.step
        thin = max(1, int(0.5 * rows))
        self.step = thin * grid.step
        margin = int((MAX_DELAY + 3.0 * width) / self.step) + 1
        self.count = -(-len(grid.channels["vy"]) // thin) - 2 * margin
        if self.count > 0:
            self._inner = slice(margin, margin + self.count)
            self._halves = [_Half(grid, forward, rows, thin, part) for part in range(2)]

    def compared(self, half: int, unknown: Array, lag: float, together: bool) -> tuple[Array, Array, Array]:
        """Return residuals, slopes and dvy/dt of a half, with a lag of roll [s]."""
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
        self.rest = soft(turn * speed) - soft(turn) * soft(speed)  # the mean of a product is not the product of means
        self.speed = Spline(soft(speed))
        self.spin = np.gradient(self.turn, step)
        sides = (soft(grid.channels["lateral_acceleration"]), np.gradient(soft(grid.channels["vy"]), step))
        self.curves = [Spline(values) for values in sides]

    def compared(self, unknown: Array, inner: slice, lag: float, together: bool) -> tuple[Array, Array, Array]:
        """Return residuals (n) of ``dvy/dt - ay + vx r + …``, their negative slopes (n, 7), and dvy/dt."""
        moved = unknown[:2] / self.step
        push, rise = (curve.at(inner, late) for curve, late in zip(self.curves, moved, strict=True))
        slopes = [curve.at(inner, late, 1) / self.step for curve, late in zip(self.curves, moved, strict=True)]
        late = moved[1] if together else 0.0
        turn, spin = self.turn[inner], self.spin[inner]
        whirl = self.rest[inner] + turn * self.speed.at(inner, late)
        if together:
            slopes[1] = slopes[1] + turn * self.speed.at(inner, late, 1) / self.step
        curvature = self.curves[0].at(inner, moved[0], 2) / self.step**2
        roll_lag = lag * slopes[0]  # a larger measured acceleration comes with more roll, and its lag
        base = np.column_stack(
            (slopes[0], -slopes[1], -spin, push - roll_lag, roll_lag - whirl, np.ones(len(push)), curvature)
        )
        rest = rise - push + whirl + spin * unknown[2] - base[:, 3:] @ unknown[3:]
        # Slow changes are the bank of the road and the bias of sensors.
        fast = [values - _slow(values, SLOW / self.step) for values in (rest, base, rise)]
        fast[1][:, 5] = 1.0
        return fast[0], fast[1], fast[2]


def _slow(values: Array, rows: float) -> Array:
    """Return three running means, nearly a Gaussian of that many rows, in a time independent of the width."""
    size = 2 * max(1, round(rows)) + 1
    for _ in range(3):
        values = uniform_filter1d(values, size, axis=0, mode="reflect")
    return values
