"""Directions and times of the rays of a sensor."""

from math import cos, pi, sqrt, tau

import numpy as np
from numpy.typing import ArrayLike

from mirdrake.sensors.ranging.faces import Array
from mirdrake.sensors.ranging.world import Beams


def grid(azimuths: ArrayLike, elevations: ArrayLike) -> Array:
    """Return unit vectors (columns, rows, 3) by azimuth (positive to the left) and elevation (positive up) [rad]."""
    azimuth, elevation = np.asarray(azimuths, dtype=float)[:, None], np.asarray(elevations, dtype=float)[None, :]
    level = np.cos(elevation)
    parts = np.broadcast_arrays(level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation))
    return np.stack(parts, axis=-1)


def turn_times(azimuths: ArrayLike, rate: float) -> Array:
    """Return when a rotating sensor measures each azimuth (n) [rad], relative to the last one [s], 0 or negative.

    It makes `rate` turns a second without a pause: a fan of half a turn takes half the period.
    """
    azimuth = np.asarray(azimuths, dtype=float)
    times: Array = -np.abs(azimuth[-1] - azimuth) / (tau * rate)
    return times


def turning(azimuths: ArrayLike, elevations: ArrayLike, *, rate: float, rolling: bool) -> Beams:
    """Return columns of beams, one for each azimuth, in the order of their times; all at once if not rolling."""
    azimuth = np.asarray(azimuths, dtype=float)
    times = turn_times(azimuth, rate) if rolling else np.zeros(azimuth.size)
    return Beams(grid(azimuth, elevations), times)


def cone(angle: float, rays: int) -> Beams:
    """Return simultaneous rays, evenly spread over a cone about x of a full angle [rad], including axis and rim.

    They are on a spiral that turns by the golden angle from one ray to the next.
    """
    share = np.arange(rays) / max(rays - 1, 1)
    along = 1.0 - (1.0 - cos(0.5 * angle)) * share
    across, turn = np.sqrt(1.0 - along * along), np.arange(rays) * pi * (3.0 - sqrt(5.0))
    directions = np.column_stack((along, across * np.cos(turn), across * np.sin(turn)))
    return Beams(directions[None], np.zeros(1))


def field(horizontal: float, vertical: float, columns: int, rows: int) -> Beams:
    """Return simultaneous rays, evenly spread over a field of view of full angles [rad]; (1, columns * rows, 3)."""
    azimuths = np.linspace(0.5 * horizontal, -0.5 * horizontal, columns) if columns > 1 else [0.0]
    elevations = np.linspace(-0.5 * vertical, 0.5 * vertical, rows) if rows > 1 else [0.0]
    return Beams(grid(azimuths, elevations).reshape(1, -1, 3), np.zeros(1))
