"""Curves through knots, and maxima and minima with rounded creases."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Curve = Callable[[Array], Array]


def curve(*knots: tuple[float, float]) -> Curve:
    """Return the shape-preserving cubic through knots of ascending abscissa, constant beyond them.

    Source: F. N. Fritsch, R. E. Carlson, Monotone Piecewise Cubic Interpolation (1980), slopes by the weighted
    harmonic mean.
    """
    t, f = np.array(knots, dtype=float).T
    h, s = np.diff(t), np.diff(f) / np.diff(t)
    m = np.zeros_like(f)
    w1, w2 = 2 * h[1:] + h[:-1], h[1:] + 2 * h[:-1]
    same = s[1:] * s[:-1] > 0
    safe = np.where(same, s[:-1], 1.0), np.where(same, s[1:], 1.0)
    m[1:-1] = np.where(same, (w1 + w2) / (w1 / safe[0] + w2 / safe[1]), 0.0)
    m[0], m[-1] = s[0], s[-1]

    def evaluate(x: Array) -> Array:
        q = np.clip(x, t[0], t[-1])
        i = np.clip(np.searchsorted(t, q, side="right") - 1, 0, len(h) - 1)
        u = (q - t[i]) / h[i]
        a, b = (1 + 2 * u) * (1 - u) ** 2, u * (1 - u) ** 2
        c, d = u * u * (3 - 2 * u), u * u * (u - 1)
        result: Array = a * f[i] + b * h[i] * m[i] + c * f[i + 1] + d * h[i] * m[i + 1]
        return result

    return evaluate


def smooth_line(points: Sequence[Sequence[float]], count: int = 24) -> list[tuple[float, float]]:
    """Return ``count`` points on a smooth plane curve through the given ones."""
    p = np.array(points, dtype=float)
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))])
    t = np.linspace(0.0, s[-1], count)
    fx, fy = (curve(*zip(s.tolist(), p[:, i].tolist(), strict=True))(t) for i in (0, 1))
    return list(zip(fx.tolist(), fy.tolist(), strict=True))


def smooth_max(a: Array, b: Array, k: float) -> Array:
    """Return max(a, b) with the crease rounded where |a − b| < k."""
    h: Array = np.maximum(k - np.abs(a - b), 0.0) / k
    return np.maximum(a, b) + h * h * k / 4


def smooth_min(a: Array, b: Array, k: float) -> Array:
    """Return min(a, b) with the crease rounded where |a − b| < k."""
    return -smooth_max(-a, -b, k)
