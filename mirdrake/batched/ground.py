"""Ground of a batch: friction, slope and wind by place, on a grid with bilinear interpolation."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mirdrake.batched.arrays import Floats
from mirdrake.core.errors import ConfigError

CHANNELS = ("friction", "slope_x", "slope_y", "wind_x", "wind_y")
"""Quantities of the grid: friction over that of the tyres' parameters [1], dz/dx and dz/dy [1], wind [m/s]."""


class Ground:
    """Friction, slope and wind on a grid; constant beyond its edges.

    A slope tilts gravity. Distances are measured along the road, so that slopes must be small: at 10 % the horizontal
    distance is 0.5 % shorter.

    Attributes:
        frame: x and y of the first point and the spacings along x and y (4) [m].
        grid: :data:`CHANNELS` at the points (nx, ny, 5).

    Args:
        x: evenly spaced coordinates (nx) [m], two or more.
        y: the same along y (ny) [m].
        friction: friction over that of the tyres' parameters [1]; a number or (nx, ny), like the others.
        slope_x: dz/dx [1].
        slope_y: dz/dy [1].
        wind_x: velocity of the air along x of the world [m/s], in addition to that of the cars' parameters.
        wind_y: the same along y [m/s].

    Raises:
        ConfigError: coordinates that are not evenly spaced, a wrong shape, or friction that is not positive.
    """

    def __init__(
        self,
        x: ArrayLike,
        y: ArrayLike,
        *,
        friction: ArrayLike = 1.0,
        slope_x: ArrayLike = 0.0,
        slope_y: ArrayLike = 0.0,
        wind_x: ArrayLike = 0.0,
        wind_y: ArrayLike = 0.0,
    ) -> None:
        axes: list[Floats] = [np.asarray(values, dtype=float) for values in (x, y)]
        for name, axis in zip("xy", axes, strict=True):
            # Even spacing makes the look-up of a cell a division, without a search in the inner loop.
            steps = np.diff(axis) if axis.ndim == 1 else np.empty(0)
            if not len(steps) or not (steps > 0.0).all() or np.ptp(steps) > 1e-6 * steps[0]:
                raise ConfigError(f"ground: {name} must be two or more evenly spaced, rising coordinates [m]")
        shape = (len(axes[0]), len(axes[1]))
        self.frame: Floats = np.array([line[0] for line in axes] + [line[1] - line[0] for line in axes])
        self.grid: Floats = np.empty((*shape, len(CHANNELS)))
        given = (friction, slope_x, slope_y, wind_x, wind_y)
        for channel, (name, values) in enumerate(zip(CHANNELS, given, strict=True)):
            array = np.asarray(values, dtype=float)
            if array.shape not in ((), shape) or not np.isfinite(array).all():
                raise ConfigError(f"ground: {name} has the shape {array.shape}; give a finite number or {shape}")
            self.grid[:, :, channel] = array
        if self.grid[:, :, 0].min() <= 0.0:
            raise ConfigError(f"ground: friction is {self.grid[:, :, 0].min():g}; it must be above 0")


NO_GROUND: tuple[Floats, Floats] = (np.zeros(4), np.zeros((0, 0, len(CHANNELS))))
"""Frame and grid of a batch without a ground."""


def apply_ground(frame: Floats, grid: Floats, p: Any, present: Any, x: float, y: float) -> None:
    """Write the parameters at a place into the record of a car.

    Args:
        frame: see :class:`Ground`.
        grid: see there; without points nothing is written.
        p: parameters of the car.
        present: record that is written.
        x: place [m].
        y: place [m].
    """
    if grid.shape[0] == 0:
        return
    # Cell, and position in it from 0 to 1.
    a, b = (x - frame[0]) / frame[2], (y - frame[1]) / frame[3]
    a, b = min(max(a, 0.0), grid.shape[0] - 1.0), min(max(b, 0.0), grid.shape[1] - 1.0)
    i, j = min(int(a), grid.shape[0] - 2), min(int(b), grid.shape[1] - 2)
    a, b = a - i, b - j
    friction = interpolate(grid, i, j, a, b, 0)
    slope_x, slope_y = interpolate(grid, i, j, a, b, 1), interpolate(grid, i, j, a, b, 2)

    # Gravity along the tangents of the road and normal to it.
    down = -p.gravity_z
    present.front_friction, present.rear_friction = p.front_friction * friction, p.rear_friction * friction
    present.gravity_x = p.gravity_x - down * slope_x / math.sqrt(1.0 + slope_x * slope_x)
    present.gravity_y = p.gravity_y - down * slope_y / math.sqrt(1.0 + slope_y * slope_y)
    present.gravity_z = -down / math.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
    present.wind_x = p.wind_x + interpolate(grid, i, j, a, b, 3)
    present.wind_y = p.wind_y + interpolate(grid, i, j, a, b, 4)


def interpolate(grid: Floats, i: int, j: int, a: float, b: float, channel: int) -> float:
    """Return the bilinear interpolation in a cell of a grid."""
    low = grid[i, j, channel] + b * (grid[i, j + 1, channel] - grid[i, j, channel])
    high = grid[i + 1, j, channel] + b * (grid[i + 1, j + 1, channel] - grid[i + 1, j, channel])
    value: float = low + a * (high - low)
    return value


GROUND_PARTS = (apply_ground, interpolate)
"""Functions that the loops call."""
