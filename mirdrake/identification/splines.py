"""Cubic splines through samples, evaluated at the rows of a slice shifted by any fraction of a row."""

import numpy as np
from scipy.interpolate import CubicSpline

from mirdrake.identification.data import Array


class Spline:
    """Samples (n) as a cubic spline, extrapolated by its end pieces."""

    def __init__(self, values: Array) -> None:
        self._pieces: Array = CubicSpline(np.arange(float(len(values))), values).c

    def at(self, rows: slice, moved: float, derivative: int = 0) -> Array:
        """Return the values at the rows of a slice shifted by `moved` rows (m), or their derivatives by the row."""
        whole = int(np.floor(moved))
        first, last = rows.start + whole, rows.stop + whole
        count = self._pieces.shape[1]
        # Inside, all rows share the same fraction t, so one slice of coefficients serves; only the ends need a clipped
        # index.
        if first >= 0 and last <= count:
            a, b, c, d = self._pieces[:, first:last]
            t: Array | float = moved - whole
        else:
            index = np.arange(first, last)
            inside = np.clip(index, 0, count - 1)
            a, b, c, d = self._pieces[:, inside]
            t = moved - whole + (index - inside)
        if derivative == 0:
            return np.asarray(((a * t + b) * t + c) * t + d)
        if derivative == 1:
            return np.asarray((3.0 * a * t + 2.0 * b) * t + c)
        return np.asarray(6.0 * a * t + 2.0 * b)
