"""The beams of a range scan, shared by the sensor and the drivers that read it.

The scan's origin is the middle of the front bumper; angles count from straight ahead, positive to the left.
"""

import math

import numpy as np
from numpy.typing import NDArray

from mirdrake.core.signals import Signal, Signals

Array = NDArray[np.float64]

BEAMS = 181
"""Number of beams."""
START_ANGLE = -0.5 * math.pi
"""Angle of the first beam [rad]."""
END_ANGLE = 0.5 * math.pi
"""Angle of the last beam [rad]."""
REACH = 50.0
"""Range of the scan [m]."""


def beam_angles(beams: int = BEAMS, start_angle: float = START_ANGLE, end_angle: float = END_ANGLE) -> Array:
    """Return the angles of the beams (n) [rad], evenly spaced; a single beam is in the middle."""
    if beams == 1:
        return np.array([0.5 * (start_angle + end_angle)])
    return np.linspace(start_angle, end_angle, beams)


def range_signals(beams: int = BEAMS) -> Signals:
    """Return names and units of a scan: ``beam[0]`` to ``beam[n - 1]`` [m]."""
    return tuple(Signal(f"beam[{number}]", "m") for number in range(beams))


class Fan:
    """Conversion of the distances of a scan to points.

    Args:
        front: how far the scan's origin is ahead of the vehicle frame B [m].

    Attributes:
        angles: of the beams (n) [rad].
    """

    __slots__ = ("_cos", "_front", "_sin", "angles")

    def __init__(self, front: float):
        self.angles = beam_angles()
        self._front, self._cos, self._sin = front, np.cos(self.angles), np.sin(self.angles)

    def points(self, ranges: Array) -> Array:
        """Return the points hit by the beams in B (m, 2) [m]; beams without a hit (inf) are omitted."""
        hit = np.isfinite(ranges)
        reach = ranges[hit]
        return np.column_stack((self._front + reach * self._cos[hit], reach * self._sin[hit]))
