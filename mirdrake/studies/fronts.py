"""Several objectives: the Pareto front and its knee."""

import numpy as np
from numpy.typing import NDArray


def pareto_front(values: NDArray[np.float64]) -> list[int]:
    """Return the rows that no other row dominates (nowhere larger, somewhere smaller); of equal rows the first.

    Args:
        values: objectives to minimise, shape (n, m), finite.
    """
    front: list[int] = []
    for k in np.lexsort(values.T[::-1]):  # a row is only dominated by rows before it
        if not any((values[other] <= values[k]).all() for other in front):
            front.append(int(k))
    return sorted(front)


def find_knee(values: NDArray[np.float64]) -> int:
    """Return the row of a front beyond which a better objective costs more in the others than it gains.

    Each objective is scaled to run from 0, its best on the front, to 1, its worst. The knee is the row with the
    smallest sum: for two objectives the one farthest from the line through the front's ends (I. Das, On characterizing
    the knee of the Pareto curve, Structural Optimization 18 (1999) 107), for more the one farthest from the plane
    through the points where one objective is at its worst and the others are at their best. Of equals the first.

    Args:
        values: objectives of the front, shape (n, m), n >= 1.
    """
    low, high = values.min(axis=0), values.max(axis=0)
    # An objective that is the same everywhere has no range; it becomes zero.
    scaled = (values - low) / np.where(high > low, high - low, 1.0)
    # Rounded, so that sums that are equal except for rounding count as equal.
    return int(np.argmin(np.round(scaled.sum(axis=1), 12)))
