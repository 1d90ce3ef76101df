"""Delay of vy against the yaw rate by the slip of the rear tyres, where no lateral acceleration is logged.

With A = dvy/dt + v r, the forces of a single track determine the vy at a point p ahead of the rear axle::

    vy = p r - c v (A - κ L dr/dt) - e v A³,    κ L = Iz / (m a) - σ

c is the slip of the rear tyres over the lateral acceleration, e their loss of stiffness near saturation, σ their
relaxation length. Inertia, relaxation, roll and downforce, which are unknown here, look like a part of L / v, the time
in which the vehicle moves by its wheelbase: up to half of it in simulated logs. Only longer times count as delays.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from mirdrake.identification.data import Array
from mirdrake.identification.relations import Grid

MAX_DELAY, STEP = 0.3, 0.01
"""Largest delay, and step of the search [s]."""

WIDTH = 0.1
"""Smoothing of all channels [s]."""

KAPPA = 0.27
"""κ for Iz = 0.85 m a b, axles at L / 2 and a relaxation length of 0.15 L [1]."""

EXPLAINED, MIN_ROWS, MAX_ROWS = 0.8, 150, 50_000
"""Share of vy that the tyres must explain; threshold number of usable rows, and largest number of rows of a log."""


class SlipDelay(NamedTuple):
    """Delay by the slip of the rear tyres.

    Attributes:
        value: delay of vy against the yaw rate [s].
        threshold: shorter delays may be an effect of the tyres [s].
    """

    value: float
    threshold: float


def slip_delay(grids: Sequence[Grid], wheelbase: float) -> SlipDelay | None:
    """Return the delay of vy from all logs together; None if channels or information are missing.

    Args:
        grids: logs of one recorder.
        wheelbase: [m].
    """
    drives = [_Turning(grid) for grid in grids if {"vx", "vy", "yaw_rate"} <= set(grid.channels)]
    drives = [drive for drive in drives if drive.size > 0]
    if sum(drive.size for drive in drives) < MIN_ROWS:
        return None
    delays = np.arange(-MAX_DELAY, MAX_DELAY + 0.5 * STEP, STEP)
    left = np.array([_unexplained(drives, delay, wheelbase) for delay in delays])
    at = int(np.argmin(left))
    if at in {0, len(delays) - 1} or left[at] > 1.0 - EXPLAINED:
        return None
    # The minimum of a parabola through three points refines the search grid.
    bend, slope = left[at - 1] - 2.0 * left[at] + left[at + 1], 0.5 * (left[at + 1] - left[at - 1])
    usual = float(np.sqrt(np.mean(np.concatenate([drive.speed for drive in drives]) ** 2)))
    return SlipDelay(float(delays[at] - STEP * slope / bend), wheelbase / usual)


def _unexplained(drives: Sequence["_Turning"], delay: float, wheelbase: float) -> float:
    """Return the share of vy that the tyres do not explain if it has a given delay."""
    parts = [drive.columns(delay, wheelbase) for drive in drives]
    base, side = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    rest = side - base @ np.linalg.lstsq(base, side, rcond=None)[0]
    return float(rest @ rest / max(side @ side, 1e-300))


class _Turning:
    """A log, smoothed, without its slow parts."""

    def __init__(self, grid: Grid) -> None:
        rows = max(WIDTH / grid.step, 1.0)
        thin = max(1, int(0.5 * rows), len(grid.channels["vy"]) // MAX_ROWS)
        self._step = thin * grid.step

        def soft(name: str) -> Array:
            return np.asarray(gaussian_filter1d(grid.channels[name], rows, mode="nearest")[::thin])

        speed, self._turn, self._side = soft("vx"), soft("yaw_rate"), soft("vy")
        self._spin, self._rise = np.gradient(self._turn, self._step), np.gradient(self._side, self._step)
        self._speed = speed
        # Rows near the ends have no shifted partner; slow rows have no slip.
        margin = int((MAX_DELAY + 3.0 * WIDTH) / self._step) + 1
        inner = np.zeros(len(speed), dtype=bool)
        inner[margin:-margin] = True
        self._rows = np.flatnonzero(inner & (speed > 0.3 * float(np.median(speed))))
        self.size, self.speed = len(self._rows), speed[self._rows]

    def columns(self, delay: float, wheelbase: float) -> tuple[Array, Array]:
        """Return the regressors of p, c and e (n, 3), and vy (n), each without its mean."""
        index, rows = np.arange(float(len(self._speed))), self._rows
        moved = rows + delay / self._step
        side, rise = np.interp(moved, index, self._side), np.interp(moved, index, self._rise)
        speed, turn, spin = self._speed[rows], self._turn[rows], self._spin[rows]
        push = rise + speed * turn
        base = np.column_stack((turn, -speed * (push - KAPPA * wheelbase * spin), -speed * push**3))
        return base - base.mean(axis=0), side - side.mean()
