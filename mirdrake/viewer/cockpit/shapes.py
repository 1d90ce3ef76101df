"""Ribbons and arrows as triangles, as lines of WebGL are always one pixel wide."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

_SIDES = 6
_HEAD, _HEAD_WIDTH = 6.0, 2.4  # length and radius of an arrow's head over the radius of its shaft


class Triangles(NamedTuple):
    """A mesh as Meshcat takes it.

    Attributes:
        vertices: (3, n) [m].
        faces: (3, m), indices of vertices.
    """

    vertices: Array
    faces: NDArray[np.int32]


def ribbon(points: ArrayLike, *, width: float, height: float) -> Triangles:
    """Return a flat strip along a line.

    Args:
        points: points of the line (n, 2) [m], n at least 2, neighbours apart.
        width: width of the strip [m].
        height: above the ground [m].
    """
    line = np.asarray(points, dtype=float)
    # Central differences; the strip is mitred in bends.
    ahead = np.gradient(line, axis=0)
    ahead /= np.maximum(np.hypot(*ahead.T), 1e-12)[:, None]
    left = 0.5 * width * np.column_stack((-ahead[:, 1], ahead[:, 0]))
    count = len(line)
    vertices = np.empty((3, 2 * count), order="F")
    vertices[:2, :count], vertices[:2, count:], vertices[2] = (line + left).T, (line - left).T, height
    i = np.arange(count - 1)
    upper = np.stack((i, i + count, i + count + 1))
    lower = np.stack((i, i + count + 1, i + 1))
    return Triangles(vertices, np.asfortranarray(np.hstack((upper, lower)), dtype=np.int32))


def arrows(starts: ArrayLike, vectors: ArrayLike, *, radius: float) -> Triangles:
    """Return arrows as one mesh.

    Args:
        starts: positions of their tails (n, 3) [m].
        vectors: vectors from tails to tips (n, 3) [m]; those shorter than twice the radius are omitted.
        radius: radius of the shafts [m].
    """
    tails = np.asarray(starts, dtype=float).reshape(-1, 3)
    shafts = np.asarray(vectors, dtype=float).reshape(-1, 3)
    lengths = np.linalg.norm(shafts, axis=1)
    # An arrow shorter than it is thick is a blob and is left out.
    long = lengths > 2.0 * radius
    tails, shafts, lengths = tails[long], shafts[long], lengths[long]
    if not len(tails):
        return Triangles(np.zeros((3, 3), order="F"), np.zeros((3, 1), dtype=np.int32, order="F"))
    along = shafts / lengths[:, None]
    # Any vector that is not parallel to the arrow spans the plane across it.
    other = np.where(np.abs(along[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    across = np.cross(along, other)
    across /= np.linalg.norm(across, axis=1)[:, None]
    third = np.cross(along, across)
    angles = np.linspace(0.0, 2.0 * np.pi, _SIDES, endpoint=False)
    around = np.cos(angles)[None, :, None] * across[:, None] + np.sin(angles)[None, :, None] * third[:, None]
    # A short arrow has a shorter head instead of a negative shaft.
    necks = tails + along * np.maximum(lengths - _HEAD * radius, 0.3 * lengths)[:, None]
    # Rings of vertices from the tail to the tip, all arrows at once: a mesh each would take Meshcat longer than a
    # frame.
    rings = [
        tails[:, None] + radius * around,
        necks[:, None] + radius * around,
        necks[:, None] + _HEAD_WIDTH * radius * around,
        (tails + shafts)[:, None],
    ]
    vertices = np.concatenate(rings, axis=1)  # (n, 3 sides + 1, 3)
    i = np.arange(_SIDES)
    j = (i + 1) % _SIDES
    tip = np.full(_SIDES, 3 * _SIDES)
    # Triangles of one arrow: two for each side of the shaft, two for the back of the head, one for its tip.
    pattern = np.hstack(
        (
            np.stack((i, j, j + _SIDES)),
            np.stack((i, j + _SIDES, i + _SIDES)),
            np.stack((i + _SIDES, j + _SIDES, j + 2 * _SIDES)),
            np.stack((i + _SIDES, j + 2 * _SIDES, i + 2 * _SIDES)),
            np.stack((i + 2 * _SIDES, j + 2 * _SIDES, tip)),
        )
    )
    firsts = np.arange(len(tails)) * (3 * _SIDES + 1)
    faces = (pattern[:, None, :] + firsts[None, :, None]).reshape(3, -1)
    return Triangles(np.asfortranarray(vertices.reshape(-1, 3).T), np.asfortranarray(faces, dtype=np.int32))
