"""Triangles with references to the exact surfaces that they approximate.

A flat face is exact. A round surface is enclosed in triangles, and each such triangle refers to the :class:`Quadric`
inside; a ray that hits the triangle is then intersected with the quadric. An object that protrudes from a round surface
by less than the enclosing triangles, a thousandth of the radius, may be missed.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Quadric:
    """The round surface of all p for which F (p - c) has the length 1, between two planes across its axis."""

    factor: Array
    """F (3, 3) [1/m]: scales the surface to a unit sphere, or to a unit cylinder if one of its rows is 0"""
    centre: Array
    """c (3) [m]"""
    axis: Array
    """unit vector (3)"""
    low: float
    """where the surface begins along the axis, from c [m]"""
    high: float
    """where it ends [m]"""


@dataclass(frozen=True)
class Faces:
    """Triangles with the surfaces that they approximate."""

    corners: Array
    """(m, 3, 3) [m], counter-clockwise seen from outside"""
    curve: Ints
    """(m) index of the quadric that a triangle encloses, -1 for a flat face that is exact"""
    cap: Bools
    """(m) whether it is in an end of its quadric; its corners are then beyond the edge of the end"""
    quadrics: tuple[Quadric, ...] = ()

    def moved(self, X: RigidTransform) -> "Faces":
        """Return the faces in another frame, in which their frame has the pose X."""
        R, p = X.rotation().matrix(), X.translation()
        quadrics = tuple(Quadric(q.factor @ R.T, R @ q.centre + p, R @ q.axis, q.low, q.high) for q in self.quadrics)
        return Faces(self.corners @ R.T + p, self.curve, self.cap, quadrics)


def flat_faces(points: Array, triangles: Any) -> Faces:
    """Return the flat faces of a mesh: points (n, 3) [m], indices of corners (m, 3)."""
    corners = np.asarray(points, dtype=float)[np.asarray(triangles, dtype=int)]
    count = len(corners)
    return Faces(corners, np.full(count, -1), np.zeros(count, dtype=bool))


def joined(parts: Sequence[Faces]) -> Faces:
    """Return the faces of several objects as those of one; the objects must not move relative to one another."""
    if not parts:
        return flat_faces(np.empty((0, 3)), np.empty((0, 3), dtype=int))
    first = np.cumsum([0, *(len(part.quadrics) for part in parts)])
    curve = [
        np.where(part.curve < 0, -1, part.curve + shift) for part, shift in zip(parts, first[:-1].tolist(), strict=True)
    ]
    return Faces(
        np.concatenate([part.corners for part in parts]),
        np.concatenate(curve),
        np.concatenate([part.cap for part in parts]),
        tuple(quadric for part in parts for quadric in part.quadrics),
    )
