"""Curves of samples, for pictures."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


def thin(x: Array, y: Array, buckets: int) -> tuple[Array, Array]:
    """Return a curve with the same outline in at most two points per bucket: the lowest and the highest.

    Args:
        x: N abscissae.
        y: N ordinates; a bucket without a finite one becomes a gap.
        buckets: number of stretches of equal count.

    Returns:
        the points that are left, at most 2·`buckets` + 2: first and last point are always kept.
    """
    count = len(x)
    # Fewer points than the result may have: nothing to thin.
    if count <= 2 * buckets + 2:
        return x, y
    # Buckets of equal count as rows of a matrix; the rest is the tail.
    size = math.ceil(count / buckets)
    whole = count // size * size
    rows = np.isfinite(y[:whole]).reshape(-1, size)
    values = y[:whole].reshape(-1, size)
    first = np.arange(0, whole, size)
    # NaN is replaced by the value that cannot win, so that a bucket with some finite values has a finite point.
    lowest = first + np.where(rows, values, np.inf).argmin(axis=1)
    highest = first + np.where(rows, values, -np.inf).argmax(axis=1)
    tail = np.arange(whole, count, max(1, size // 2))
    # Sorted and unique: the points stay in the order of time.
    index = np.unique(np.concatenate(([0], lowest, highest, tail, [count - 1])))
    return x[index], y[index]
