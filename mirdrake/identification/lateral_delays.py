"""Delays of lateral acceleration and lateral velocity against the yaw rate, and the position of the accelerometer.

With the accelerometer d ahead of the point whose velocity is logged, and h lower, on a body that rolls by k times the
lateral acceleration::

    ay = vx r + dvy/dt + d dr/dt + h k d²ay/dt²

The last term is the roll acceleration of quasi-steady roll. If the roll rate p is logged, the term h dp/dt is added,
which also holds near the natural frequency of roll.

A delay of vy, a delay of ay and another position of a sensor look alike: at one speed v, a distance d is a delay d / v.
So position, scales and roll are free in every hypothesis, and a delay is one only if the logs distinguish it from them:
of the hypotheses (no delay, ay, vy, yaw rate) that of the least Bayesian information criterion counts
(G. Schwarz, Annals of Statistics 6, 1978), with prior odds against each delay. Noise of the slopes would make delays
look small and certain; instrumental variables that the steering causes avoid it (L. Ljung, System Identification,
1999, section 7.6).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d, uniform_filter1d

from mirdrake.identification.alignment import DELAY_ODDS, STEERING
from mirdrake.identification.data import Array
from mirdrake.identification.evidence import effective_samples, is_certain, required_gain
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

MAX_SCALE = 2.0 * SCALES
"""Largest scale of an acceleration: sensors have no larger errors [1]."""

ROLL_LAG = 0.06
"""Lag of roll behind the acceleration, of a car: 2 ζ / ω for roll of 9 rad/s with a damping ratio of 0.3 [s]; for
smaller vehicles it scales with POSITION_TIME. An accelerometer that measures a tenth more by roll lags by 6 ms."""

ROLL_HEIGHT = 0.004
"""Standard deviation of the height difference of two sensors times roll angle over lateral acceleration [s²], of a car;
for smaller vehicles it scales with the square of POSITION_TIME. The roll acceleration is in their difference."""

POSITION_TIME, MAX_POSITION = 0.05, 1.0
"""Size of a vehicle in seconds of driving at its usual speed [s], and that of a car, which is also the standard
deviation of a sensor's position [m]."""

LAGS = np.arange(-0.2, 0.9, 0.2)
"""Lags of the motion behind the steering, for instrumental variables [s]; many more would explain noise as well."""

BLOCKS, MIN_ROWS = 20, 150
"""Number of parts of the logs whose scatter gives the uncertainty, and smallest number of smoothed rows."""

MAX_ROWS = 50_000
"""Largest number of rows of a long log that are used."""


MIN_CORRELATION = 0.7
"""Least correlation of dvy/dt with what the other channels give [1]."""


class Hypothesis(NamedTuple):
    """Set of delayed channels. A delay of the yaw rate equals a delay of both others with the opposite sign."""

    acceleration: bool = False
    velocity: bool = False
    speed: bool = False
    apart: bool = False
    arm: bool = True

    @property
    def of_yaw_rate(self) -> bool:
        """Whether the yaw rate alone has a delay."""
        return self.acceleration and self.velocity and not self.apart


NO_DELAY = Hypothesis()
DELAYED = (Hypothesis(acceleration=True), Hypothesis(velocity=True), Hypothesis(acceleration=True, velocity=True))
"""One clock that differs from the others."""

APART = Hypothesis(acceleration=True, velocity=True, apart=True)
"""Both with a delay of their own: the estimates that the others restrict."""


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
        residual: root mean square of the residual of dvy/dt [m/s²].
        evidence: twice the logarithm of the odds for the delay; 0 without one.
        effective: number of independent samples of the residual.
        against: Wald's statistic against each of DELAYED, if both delays are free.
        deviation: standard deviation of the delay, with that by scale and roll of the acceleration [s].
        limits: 95 % intervals of a delay of the lateral acceleration alone and of vy alone [s], where none is found;
            None where the logs do not determine it.
    """

    acceleration: float
    velocity: float
    sigmas: tuple[float, float]
    arm: float
    arm_sigma: float
    correlation: float
    together: bool
    width: float
    residual: float
    evidence: float
    effective: float
    against: tuple[float, ...] = ()
    deviation: float = 0.0
    limits: tuple[tuple[float, float] | None, tuple[float, float] | None] = (None, None)


def estimate_lateral_delays(grids: Sequence[Grid], *, together: bool | None = None) -> LateralDelays | None:
    """Return the delays of the lateral acceleration and of vy; None if channels or information are missing.

    Args:
        grids: logs of one recorder; those without the channels do not count.
        together: whether vx and vy have one clock, as from one source; None for what fits better.
    """
    forward = "vx" if all("vx" in grid.channels for grid in grids) else "speed"
    needed = {"vy", "yaw_rate", "lateral_acceleration", forward}
    logs = _LogSet([grid for grid in grids if needed <= set(grid.channels)], forward)
    plain, joint = logs.estimate_best(NO_DELAY), logs.estimate_best(APART)
    if plain is None:
        return None
    # Of one clock that differs, the one whose restriction contradicts the joint estimates least (Wald's test).
    order = range(len(DELAYED)) if joint is None else np.argsort(joint.against)
    delayed = [logs.estimate_best(hypothesis) for hypothesis in DELAYED]
    estimates = [estimate for index in order if (estimate := delayed[index]) is not None]
    plain = plain._replace(limits=(_interval(delayed[0]), _interval(delayed[1])))
    best = (
        max(estimates, key=lambda estimate: estimate.evidence)
        if estimates and joint is None
        else next(iter(estimates), plain)
    )
    hypothesis = Hypothesis(bool(best.acceleration), bool(best.velocity))
    if best.evidence <= 0.0 or not _explains(hypothesis, logs):
        return plain
    if abs(best.arm) < 2.0 * best.arm_sigma:  # beside each other the delay is more certain
        beside = logs.estimate_best(hypothesis._replace(arm=False))
        best, hypothesis = (best, hypothesis) if beside is None else (beside, hypothesis._replace(arm=False))
    if not best.velocity or best.acceleration or together is False:
        return best
    # Whether the speed has the delay of vy shows in the residuals, at the same smoothing and with the same unknowns. A
    # speed that hardly changes shows nothing, and stays as it is.
    both = logs.estimate(best.width, hypothesis._replace(speed=True))
    if both is None:
        return best
    gain = 2.0 * both.effective * float(np.log(best.residual / max(both.residual, 1e-300)))
    return both if together or gain > required_gain(both.effective, DELAY_ODDS) else best


def _interval(estimate: LateralDelays | None) -> tuple[float, float] | None:
    """Return the 95 % interval of the delay of one channel [s]."""
    if estimate is None:
        return None
    delay, width = estimate.acceleration or estimate.velocity, 1.96 * estimate.deviation
    return delay - width, delay + width


def _explains(hypothesis: Hypothesis, logs: "_LogSet") -> bool:
    """Return whether the channels agree better with a delay than without one, by the likelihood of the residuals.

    Wald's statistic alone takes an effect that the hypothesis lacks for a delay: the estimate is then certain, and
    the residuals stay as they were. Noise hides the difference at little smoothing, so any smoothing may show it.
    """
    for width in logs.widths:
        delayed, plain = logs.estimate(width, hypothesis), logs.estimate(width, NO_DELAY)
        if delayed is None or plain is None or delayed.correlation < MIN_CORRELATION:
            continue
        gain = 2.0 * delayed.effective * float(np.log(plain.residual / max(delayed.residual, 1e-300)))
        if is_certain(gain, delayed.effective, DELAY_ODDS):
            return True
    return False


class _LogSet:
    """Logs that are used together."""

    def __init__(self, grids: Sequence[Grid], forward: str) -> None:
        self._grids, self._forward = [_most_active(grid) for grid in grids], forward
        # The roll rate counts only if it is known everywhere, so that its coefficient is the same height everywhere.
        self._rolls = all("roll_rate" in grid.channels for grid in grids)
        self._smoothed: dict[float, list[_SmoothedLog]] = {}
        coarsest = max((grid.step for grid in grids), default=0.0)
        self.widths = sorted({max(width, 2.0 * coarsest) for width in WIDTHS})

    def estimate_best(self, hypothesis: Hypothesis) -> LateralDelays | None:
        """Estimate with the smoothing that gives the most certain delay, or position if there is none."""
        found = [estimate for width in self.widths if (estimate := self.estimate(width, hypothesis)) is not None]
        # Without a common signal the channels are not related as assumed, and a delay has no meaning.
        tried = [estimate for estimate in found if estimate.correlation > MIN_CORRELATION]
        return min(tried, key=lambda estimate: (max(estimate.sigmas), estimate.arm_sigma), default=None)

    def estimate(self, width: float, free: Hypothesis) -> LateralDelays | None:
        """Estimate with a smoothing over a width [s]; delays outside of the hypothesis are 0.

        Rows with even numbers give the residuals, those with odd numbers the instrumental variables: white noise of
        both is independent, so it neither causes a delay nor makes one look certain. Autocorrelated noise and rounding
        are alike in both; of the odd rows, only what the steering causes is used.
        """
        if width not in self._smoothed:
            made = [_SmoothedLog(grid, self._forward, width, rolls=self._rolls) for grid in self._grids]
            self._smoothed[width] = [drive for drive in made if drive.count > 0]
        drives = self._smoothed[width]
        count = sum(drive.count for drive in drives)
        if count < MIN_ROWS:
            return None
        step = max(drive.step for drive in drives)
        # Unknowns: both delays, arm, two scales, an offset, height times roll angle over acceleration, and with a roll
        # rate the height; each with a normal prior, infinite for the offset.
        # Scales of position and roll follow the size of the vehicle, for which its usual speed is the measure.
        usual = np.sqrt(np.mean(np.concatenate([grid.channels[self._forward] for grid in self._grids]) ** 2))
        reach = min(POSITION_TIME * float(usual), MAX_POSITION)
        wide = np.array([MAX_DELAY, MAX_DELAY, MAX_POSITION, SCALES, SCALES, np.inf, ROLL_HEIGHT * reach**2])
        wide = np.append(wide, [MAX_POSITION] * self._rolls)
        # A tiny deviation of the prior fixes an unknown at zero without changing the size of the equations.
        delayed = (free.acceleration, free.velocity and not free.of_yaw_rate)
        widths = np.where([*delayed, free.arm, *[True] * (len(wide) - 3)], wide, 1e-9)
        unknown, lag = np.zeros(len(wide)), ROLL_LAG * reach

        for _ in range(30):
            parts = [drive.compared(unknown, lag, free) for drive in drives]
            rest, base, up, other = (np.concatenate(columns) for columns in zip(*parts, strict=True))
            noise = 2.0 * float(np.sqrt(np.mean(rest**2)))  # neighbours are correlated: each counts for a quarter
            regularisation = np.where(np.isfinite(widths), (noise / np.maximum(widths, 1e-12)) ** 2, 0.0)
            normal = other.T @ base
            normal = 0.5 * (normal + normal.T) + np.diag(regularisation)
            if not np.all(np.isfinite(normal)) or np.linalg.cond(normal / _sizes(normal)) > 1e10:
                return None
            change = np.linalg.solve(normal, other.T @ rest - regularisation * unknown)
            # At most a row per iteration: the slopes of the splines are valid nearby only.
            change[:2] = np.clip(change[:2], -step, step)
            # Autocorrelated noise is alike in both halves and pulls the scales to -1; a delay would make up for it.
            change[3:5] = np.clip(unknown[3:5] + change[3:5], -MAX_SCALE, MAX_SCALE) - unknown[3:5]
            unknown = unknown + change
            # Beyond the margin that the smoothed logs keep, the splines would be extrapolated.
            if np.any(np.abs(unknown[:2]) > MAX_DELAY):
                return None
            if np.all(np.abs(change) < 1e-5 * (1.0 + np.abs(unknown))):
                break
        else:
            return None
        correlation = float(np.corrcoef(up, up - rest)[0, 1])
        # Uncertainty by the scatter of the parts of the logs, as residuals contain errors of road and model, too.
        scores = np.array([other[part].T @ rest[part] for part in np.array_split(np.arange(count), BLOCKS)])
        inverse = np.linalg.inv(normal)
        spread = inverse @ (scores.T @ scores) @ inverse * BLOCKS / (BLOCKS - len(unknown))
        sigma = np.sqrt(np.diag(spread))
        # Wald's statistic takes the place of the likelihood ratio, which instrumental variables do not maximise. An
        # accelerometer that measures a tenth more by roll lags by a tenth of the roll.
        columns = [0, 0 if free.of_yaw_rate else 1]
        delays = [float(unknown[i]) if is_free else 0.0 for i, is_free in zip(columns, free[:2], strict=True)]
        sigmas = [float(sigma[i]) if is_free else 0.0 for i, is_free in zip(columns, free[:2], strict=True)]
        evidence, effective, variance = 0.0, effective_samples(rest), 0.0
        against: tuple[float, ...] = ()
        if free.apart:
            apart = spread[0, 0] + spread[1, 1] - 2.0 * spread[0, 1]
            # What each hypothesis of DELAYED sets to zero: the delay of vy, that of ay, or their difference (the yaw
            # rate's delay).
            left = ((delays[1], sigmas[1]), (delays[0], sigmas[0]), (delays[0] - delays[1], float(np.sqrt(apart))))
            against = tuple((value / size) ** 2 for value, size in left)
        elif free != NO_DELAY:
            delay, own = (delays[0], sigmas[0]) if free.acceleration else (delays[1], sigmas[1])
            variance = own**2 + (2.0 * SCALES * lag if free.acceleration else 0.0) ** 2
            # Behind a gyroscope no channel is early, and the gyroscope is seldom earlier than both others.
            odds = DELAY_ODDS ** (2.0 if free.of_yaw_rate and delay > 0.0 else 1.0)
            evidence = delay**2 / variance - required_gain(effective, odds)
        return LateralDelays(
            delays[0], delays[1], (sigmas[0], sigmas[1]), float(unknown[2]), float(sigma[2]), correlation, free.speed,
            width, float(np.std(rest)), evidence, effective, against, float(np.sqrt(variance)),
        )  # fmt: skip


def _most_active(grid: Grid) -> Grid:
    """Return the part of a long log with the largest yaw motion."""
    size = len(grid.channels["vy"])
    if size <= 2 * MAX_ROWS:
        return grid
    starts = range(0, size - MAX_ROWS + 1, MAX_ROWS)
    # Only rows with yaw motion carry information about delays.
    begin = max(starts, key=lambda at: float(np.var(grid.channels["yaw_rate"][at : at + MAX_ROWS])))
    return Grid(grid.step, {name: values[begin : begin + MAX_ROWS] for name, values in grid.channels.items()})


def _sizes(matrix: Array) -> Array:
    size = np.sqrt(np.maximum(np.abs(np.diag(matrix)), 1e-300))
    return np.asarray(np.outer(size, size))


class _SmoothedLog:
    """One log, smoothed, as two halves of its rows."""

    def __init__(self, grid: Grid, forward: str, width: float, *, rolls: bool) -> None:
        rows = width / grid.step
        # Smoothed rows are redundant: two per width keep the information.
        thin = max(1, int(0.5 * rows))
        self.step = thin * grid.step
        margin = int((MAX_DELAY + 3.0 * width) / self.step) + 1
        self.count = -(-len(grid.channels["vy"]) // thin) - 2 * margin
        if self.count > 0:
            self._inner = slice(margin, margin + self.count)
            self._halves = [_Half(grid, forward, rows, thin, part, rolls=rolls) for part in range(2)]
            self._responses = _responses(grid, forward, rows, thin, self._inner)

    def compared(self, unknown: Array, lag: float, delayed: Hypothesis) -> tuple[Array, Array, Array, Array]:
        """Return residuals (n), slopes (n, 7 or 8) and dvy/dt (n) of a half, and instrumental variables (n, 7 or 8).

        Args:
            unknown: delays, position, scales, offset and roll.
            lag: lag of roll [s].
            delayed: the delayed channels.
        """
        rest, base, rise = self._halves[0].compared(unknown, self._inner, lag, delayed)
        _, other, _ = self._halves[1].compared(unknown, self._inner, lag, delayed)
        # Projection on what the steering causes: autocorrelated noise is alike in both halves.
        steered = self._responses
        return rest, base, rise, other if steered is None else steered @ (steered.T @ other)


def _responses(grid: Grid, forward: str, rows: float, thin: int, inner: slice) -> Array | None:
    """Return orthonormal responses to the steering (n, k): its lagged angles, and these times the speed.

    Returns None without a steering channel.

    Args:
        grid: log.
        forward: channel of the speed.
        rows: standard deviation of the Gaussian in rows of the log.
        thin: rows of the log for each smoothed row.
        inner: the smoothed rows that are compared.
    """
    name = next((name for name in STEERING if name in grid.channels), None)
    if name is None:
        return None
    angle, step = gaussian_filter1d(grid.channels[name], rows, mode="nearest")[::thin], thin * grid.step
    speed = gaussian_filter1d(grid.channels[forward], rows, mode="nearest")[::thin]
    at = np.arange(inner.start, inner.stop)[:, None] - np.unique(np.round(LAGS / step).astype(int))
    lagged = angle[np.clip(at, 0, len(angle) - 1)]
    steered = np.column_stack((np.ones(len(at)), lagged, lagged * speed[inner, None]))
    steered[:, 1:] -= _slow(steered[:, 1:], SLOW / step)
    left, sizes, _ = np.linalg.svd(steered / np.maximum(np.linalg.norm(steered, axis=0), 1e-300), full_matrices=False)
    return np.asarray(left[:, sizes > 1e-6 * sizes[0]])


class _Half:
    """Every second row of the channels, smoothed."""

    def __init__(self, grid: Grid, forward: str, rows: float, thin: int, part: int, *, rolls: bool) -> None:
        size = len(grid.channels["vy"])
        use = (np.arange(size) % 2 == part).astype(float)
        # Normalised by the smoothed mask, so that leaving out every second row causes no bias, also at the ends.
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
        self.roll_accelerations = [np.gradient(soft(grid.channels["roll_rate"]), step)] if rolls else []

    def compared(self, unknown: Array, inner: slice, lag: float, hypothesis: Hypothesis) -> tuple[Array, Array, Array]:
        """Return residuals (n) of ``dvy/dt - ay + vx r + …``, their negative slopes (n, 7 or 8), and dvy/dt."""
        # A delay of the yaw rate is modelled as one common delay of both other channels, with the opposite sign.
        moved = unknown[[0, 0] if hypothesis.of_yaw_rate else [0, 1]] / self.step
        push, rise = (curve.at(inner, delay) for curve, delay in zip(self.curves, moved, strict=True))
        slopes = [curve.at(inner, delay, 1) / self.step for curve, delay in zip(self.curves, moved, strict=True)]
        shift = moved[1] if hypothesis.speed else 0.0
        turn, spin = self.turn[inner], self.spin[inner]
        whirl = self.rest[inner] + turn * self.speed.at(inner, shift)
        if hypothesis.speed:
            slopes[1] = slopes[1] + turn * self.speed.at(inner, shift, 1) / self.step
        # The roll acceleration acts on a sensor at another height; roll follows ay, so its second derivative stands for
        # it.
        curvature = self.curves[0].at(inner, moved[0], 2) / self.step**2
        roll_lag = lag * slopes[0]  # a larger measured acceleration comes with more roll, and its lag
        base = np.column_stack(
            (
                slopes[0] - slopes[1] if hypothesis.of_yaw_rate else slopes[0],
                -slopes[1],
                -spin,
                push - roll_lag,
                roll_lag - whirl,
                np.ones(len(push)),
                curvature,
                *(values[inner] for values in self.roll_accelerations),
            )
        )
        rest = rise - push + whirl + spin * unknown[2] - base[:, 3:] @ unknown[3:]
        # Slow changes are the bank of the road and the bias of sensors.
        fast = [values - _slow(values, SLOW / self.step) for values in (rest, base, rise)]
        fast[1][:, 5] = 1.0
        return fast[0], fast[1], fast[2]


def _slow(values: Array, rows: float) -> Array:
    """Return three running means, nearly a Gaussian of that many rows, in a time independent of the width."""
    # A Gaussian of this width would need kernels of thousands of rows; three box filters approach it (central limit).
    size = 2 * max(1, round(rows)) + 1
    for _ in range(3):
        values = uniform_filter1d(values, size, axis=0, mode="reflect")
    return values
