"""Pieces of a centre line with linear curvature: poses along them.

Track coordinates: s [m] along the centre line, e_y [m] to its left. With curvature k(u) = k0 + c u over a piece, the
heading is yaw(u) = yaw0 + k0 u + c u²/2 and the position is the integral of its cosine and sine: a straight line
(k0 = c = 0), a circle (c = 0) or a clothoid (do Carmo, "Differential Geometry of Curves and Surfaces", section 1-5: a
plane curve follows from its curvature by these two integrations).

Each piece is cut into cells that turn at most 0.08 rad; within a cell three-point Gauss quadrature of the integral is
exact to 1e-12 m, without the cancellation of the closed form by Fresnel integrals for small c.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Placement = tuple[float, float, float]

# Gauss-Legendre on [0, 1] with three points: exact for polynomials up to degree 5.
NODES = (0.5 - math.sqrt(0.15), 0.5, 0.5 + math.sqrt(0.15))
WEIGHTS = (5.0 / 18.0, 8.0 / 18.0, 5.0 / 18.0)
_CELL_ANGLE = 0.08  # [rad] largest turn of a cell
_CELL_LENGTH = 0.5  # [m] longest cell
_CELLS = 8  # fewest cells of a piece


class Piece(NamedTuple):
    """A part of a centre line whose curvature changes linearly, + left."""

    length: float
    """[m]"""
    start_curvature: float
    """[1/m]"""
    end_curvature: float
    """[1/m]"""

    @property
    def turn(self) -> float:
        """Heading change [rad]."""
        return self.length * (self.start_curvature + self.end_curvature) / 2.0


def advance(pose: Placement, piece: Piece) -> Placement:
    """Return the pose (x [m], y [m], yaw [rad]) at the end of a piece that starts at `pose`.

    Closed forms are used for lines and arcs, Gauss quadrature over their cells for clothoids.
    """
    x, y, yaw = pose
    if piece.start_curvature == piece.end_curvature:
        half = piece.turn / 2.0
        # sin(x)/x is 1 at zero, where the division would fail.
        chord = piece.length * (math.sin(half) / half if half else 1.0)
        return x + chord * math.cos(yaw + half), y + chord * math.sin(yaw + half), yaw + piece.turn
    step, cells, rate = cells_of(piece)
    u = step * np.arange(cells)
    k = np.asarray(piece.start_curvature + rate * u)
    dx, dy = displace(yaw + (piece.start_curvature + k) / 2.0 * u, k, np.full(cells, rate), np.full(cells, step))
    return x + math.fsum(dx), y + math.fsum(dy), yaw + piece.turn


def cells_of(piece: Piece) -> tuple[float, int, float]:
    """Return the cell length [m], the number of cells and the rate of curvature [1/m²] of a piece."""
    sharpest = max(abs(piece.start_curvature), abs(piece.end_curvature))
    # Small enough cells that three nodes of the quadrature are exact almost to rounding.
    cells = max(_CELLS, math.ceil(piece.length / _CELL_LENGTH), math.ceil(piece.length * sharpest / _CELL_ANGLE))
    return piece.length / cells, cells, (piece.end_curvature - piece.start_curvature) / piece.length


def displace(yaw: Array, k: Array, c: Array, u: Array) -> tuple[Array, Array]:
    """Return the displacement [m] in x and y over a length u for initial heading yaw, curvature k and its rate c."""
    dx, dy = np.zeros_like(u), np.zeros_like(u)
    for node, weight in zip(NODES, WEIGHTS, strict=True):
        part = node * u
        angle = yaw + (k + c * part / 2.0) * part
        dx += weight * np.cos(angle)
        dy += weight * np.sin(angle)
    return u * dx, u * dy
