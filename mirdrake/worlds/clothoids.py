"""Clothoids through given joints: Newton's method for headings, curvatures and lengths.

The unknowns are heading and curvature at every joint and the length of every piece. Each piece must end at the next
joint with its heading: three equations. A cubic spline is the initial guess. The matrix is sparse because each piece
depends only on its own joints.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # it imports its parts when they are first used
from numpy.typing import ArrayLike, NDArray

from mirdrake.worlds.pieces import Array

_SAMPLES = 16  # per piece of the first guess
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(20)
_NODES, _WEIGHTS = (_NODES + 1.0) / 2.0, _WEIGHTS / 2.0  # on [0, 1]


@dataclass(frozen=True)
class _Arcs:
    """Displacements of pieces and their derivatives, N each."""

    chord: Array
    """displacement [m], N x 2"""
    by_yaw: Array
    by_first: Array
    by_last: Array
    by_length: Array


def _integrate(yaw: Array, first: Array, last: Array, length: Array) -> _Arcs:
    """Return displacements of clothoids, and their derivatives by heading, both curvatures and length, N x 2 each."""
    # Gauss-Legendre on the whole piece: the heading is a quadratic of u, so the integrand is smooth.
    u = _NODES
    bend = first[:, None] * u + (last - first)[:, None] * u * u / 2.0  # times the length it is the heading change
    angle = yaw[:, None] + length[:, None] * bend
    c, s = np.cos(angle) * _WEIGHTS, np.sin(angle) * _WEIGHTS
    size = length[:, None]

    def along(factor: Array) -> Array:
        return np.column_stack((-(s * factor).sum(axis=1), (c * factor).sum(axis=1)))

    straight = np.column_stack((c.sum(axis=1), s.sum(axis=1)))
    ones = np.ones_like(angle)
    return _Arcs(
        straight * size,
        along(ones) * size,
        along((u - u * u / 2.0) * ones) * size**2,
        along(u * u / 2.0 * ones) * size**2,
        straight + along(bend) * size,
    )


def solve(places: Array, t: Array, closed: bool) -> tuple[Array, Array, Array] | None:
    """Return headings [rad] and curvatures [1/m] at the joints, N, and lengths [m] of clothoids; None without solution.

    An open curve has two more unknowns than equations: its first two pieces, and its last two, form one clothoid.
    """
    nodes, parts = len(places), len(t) - 1
    yaw, k, length = _guess(places, t, closed)
    # Headings are continuous along a lap: at its end, the heading is the first one plus the turns of the lap.
    turn = yaw[-1] - yaw[0] if closed else 0.0
    yaw, k = yaw[:nodes], k[:nodes]
    ahead = (np.arange(parts) + 1) % nodes
    chord = places[ahead] - places[:parts]
    lap = np.where((np.arange(parts) == parts - 1) & closed, turn, 0.0)
    size = float(length.mean())  # scales curvatures to the order of headings

    def residual(yaw: Array, k: Array, length: Array) -> tuple[Array, _Arcs]:
        arcs = _integrate(yaw[:parts], k[:parts], k[ahead], length)
        turned = yaw[ahead] + lap - yaw[:parts] - length * (k[:parts] + k[ahead]) / 2.0
        # Positions over the mean length, so that metres and radians have one tolerance.
        rest = np.concatenate((((arcs.chord - chord) / size).T.ravel(), turned))
        if not closed:
            # Equal rates of curvature, multiplied by both lengths, to avoid a division.
            ends = [(k[b] - k[a]) * length[j] - (k[c] - k[b]) * length[i] for a, b, c, i, j in _ends(nodes)]
            rest = np.append(rest, ends)
        return rest, arcs

    # Damped Newton's method: the step is halved until the largest residual decreases.
    rest, arcs = residual(yaw, k, length)
    chain = length.sum()
    for _ in range(40):
        step = scipy.sparse.linalg.splu(_jacobian(k, length, arcs, size, closed)).solve(-rest)
        if not np.isfinite(step).all():
            return None
        by_yaw, by_k, by_length = step[:nodes], step[nodes : 2 * nodes] / size, step[2 * nodes :] * size
        share = min(1.0, 0.7 / max(1e-12, float((-by_length / length).max())))  # lengths stay positive
        for _ in range(8):
            trial = yaw + share * by_yaw, k + share * by_k, length + share * by_length
            after, arcs_after = residual(*trial)
            if np.abs(after).max() < max(np.abs(rest).max(), 1e-12):
                break
            share /= 2.0
        else:
            return None
        # One more step once the residual is small: Newton's method then converges down to rounding.
        done = np.abs(rest).max() < 1e-10 and np.abs(after).max() < 1e-12
        (yaw, k, length), rest, arcs = trial, after, arcs_after
        if done or np.abs(rest).max() < 1e-15:
            # A solution much longer than the spline has loops, which fulfil the equations, too.
            return (yaw, k, length) if length.sum() < 1.5 * chain else None
    return None


def _ends(nodes: int) -> tuple[tuple[int, int, int, int, int], ...]:
    """Return three joints at both ends of an open curve, and the two pieces between them."""
    return (0, 1, 2, 0, 1), (nodes - 3, nodes - 2, nodes - 1, nodes - 3, nodes - 2)


def _jacobian(k: Array, length: Array, arcs: _Arcs, size: float, closed: bool) -> Any:
    """Return the derivatives of the residual of :func:`solve` by headings, curvatures · `size`, lengths / `size`."""
    nodes, parts = len(k), len(length)
    i = np.arange(parts)
    ahead = (i + 1) % nodes
    rows: list[Array] = []
    columns: list[Array] = []
    values: list[Array] = []

    def put(row: ArrayLike, column: ArrayLike, value: ArrayLike) -> None:
        for store, part in ((rows, row), (columns, column), (values, value)):
            store.append(np.atleast_1d(np.asarray(part)))

    # Rows of x and y: the end of each arc is the next node.
    for axis in (0, 1):
        row = axis * parts + i
        put(row, i, arcs.by_yaw[:, axis] / size)
        put(row, nodes + i, arcs.by_first[:, axis] / size**2)
        put(row, nodes + ahead, arcs.by_last[:, axis] / size**2)
        put(row, 2 * nodes + i, arcs.by_length[:, axis])

    # Rows of the heading: that of the next node follows from curvature and length.
    row = 2 * parts + i
    put(row, i, -np.ones(parts))
    put(row, ahead, np.ones(parts))
    put(row, nodes + i, -length / 2.0 / size)
    put(row, nodes + ahead, -length / 2.0 / size)
    put(row, 2 * nodes + i, -(k[:parts] + k[ahead]) / 2.0 * size)

    # The ends of an open curve have equal changes of curvature in their first two and last two pieces.
    if not closed:
        for equation, (a, b, c, first, second) in enumerate(_ends(nodes), start=3 * parts):
            put(
                [equation] * 3,
                [nodes + a, nodes + b, nodes + c],
                np.array([-length[second], length[first] + length[second], -length[first]]) / size,
            )
            put([equation] * 2, [2 * nodes + second, 2 * nodes + first], np.array([k[b] - k[a], k[b] - k[c]]) * size)
    shape = (2 * nodes + parts,) * 2
    return scipy.sparse.coo_array(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=shape
    ).tocsc()


def _guess(places: Array, t: Array, closed: bool) -> tuple[Array, Array, Array]:
    """Return headings, curvatures (of a closed curve also at the end of the lap) and lengths of a cubic spline."""
    ring = np.vstack((places, places[:1])) if closed else places
    spline = scipy.interpolate.CubicSpline(t, ring, bc_type="periodic" if closed else "not-a-knot")
    fine = np.interp(np.arange((len(t) - 1) * _SAMPLES + 1) / _SAMPLES, np.arange(len(t)), t)
    velocity = spline(fine, 1)
    speed = np.hypot(*velocity.T)
    yaw = np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0]))[::_SAMPLES]
    if closed:
        # A periodic spline has equal headings at its ends, up to whole turns; rounding would leave a kink.
        yaw[-1] = yaw[0] + 2.0 * math.pi * round((yaw[-1] - yaw[0]) / (2.0 * math.pi))
    second = spline(t, 2)
    cross = velocity[::_SAMPLES, 0] * second[:, 1] - velocity[::_SAMPLES, 1] * second[:, 0]
    length = np.add.reduceat((speed[:-1] + speed[1:]) / 2.0 * np.diff(fine), np.arange(0, len(fine) - 1, _SAMPLES))
    return yaw, cross / np.maximum(speed[::_SAMPLES], 1e-9) ** 3, length


def distances(places: Array, t: Array, joints: NDArray[np.intp], found: tuple[Array, Array, Array]) -> Array:
    """Return the distance [m] of every point from the piece between its joints, an upper bound of that to the curve."""
    yaw, k, length = found
    i = np.minimum(np.searchsorted(joints, np.arange(len(places)), side="right") - 1, len(length) - 1)
    last = k[(i + 1) % len(k)]
    ends = np.append(t[joints], t[-1])

    # Projected by three steps along the tangent, from the share of the chord length.
    u = (t[: len(places)] - t[joints[i]]) / (ends[i + 1] - ends[i]) * length[i]
    for _ in range(3):
        end = k[i] + (last - k[i]) * u / length[i]
        rest = places - places[joints[i]] - _integrate(yaw[i], k[i], end, u).chord
        heading = yaw[i] + u * (k[i] + end) / 2.0
        u = np.clip(u + rest[:, 0] * np.cos(heading) + rest[:, 1] * np.sin(heading), 0.0, length[i])
    end = k[i] + (last - k[i]) * u / length[i]
    return np.asarray(np.hypot(*(places - places[joints[i]] - _integrate(yaw[i], k[i], end, u).chord).T))
