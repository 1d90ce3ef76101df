"""Rays against uneven ground: the exact distance near a guess; :mod:`mirdrake.core.compiled` compiles the functions.

A mesh of the ground gives the guess, which is off by the error of the mesh over the sine of the grazing angle. The ray
crosses the ground where its height over it changes its sign; the crossing is found by the method of false position with
the Illinois rule (M. Dowell, P. Jarratt, A modified regula falsi method, BIT 11, 1971).
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from mirdrake.ground.layers import GROUND_PARTS, TerrainData, ground_at

_SPANS = 5  # brackets around a guess: 1 cm, 4 cm, ... 2.6 m
_FIRST = 0.01  # [m]
_ROUNDS = 40
_EXACT = 1e-5  # [m]


def above_ground(terrain: TerrainData, start: Any, direction: Any, along: float) -> float:
    """Return the height of a point of a ray over the ground [m]."""
    z, _, _ = ground_at(terrain, start[0] + along * direction[0], start[1] + along * direction[1])
    height: float = start[2] + along * direction[2] - z
    return height


def refine_hits(
    terrain: TerrainData,
    starts: npt.NDArray[np.float64],
    directions: npt.NDArray[np.float64],
    distances: npt.NDArray[np.float64],
) -> None:
    """Move the hits of rays on a mesh to the ground itself.

    Args:
        terrain: the ground.
        starts: origins of the rays (n, 3) [m].
        directions: unit vectors (n, 3).
        distances: distances to the mesh (n) [m], changed; infinite ones stay. A ray that passes the ground within 2.6 m
            of its hit on the mesh without a crossing, which happens at silhouettes, keeps its distance.
    """
    for i in range(len(distances)):
        if not np.isfinite(distances[i]):
            continue
        start, direction, guess, span = starts[i], directions[i], distances[i], _FIRST
        low, high, above, below = 0.0, 0.0, 0.0, 0.0

        # The smallest bracket first: the mesh is near the ground, and a wide one could contain another crossing.
        found = False
        for _ in range(_SPANS):
            low, high = max(guess - span, 0.0), guess + span
            above, below = above_ground(terrain, start, direction, low), above_ground(terrain, start, direction, high)
            if above >= 0.0 and below <= 0.0:
                found = True
                break
            span *= 4.0
        if not found:
            continue
        side = 0
        for _ in range(_ROUNDS):
            # The height difference is checked too: it is the divisor of the next secant.
            if high - low < _EXACT or above - below < _EXACT:
                break
            middle = (above * high - below * low) / (above - below)
            height = above_ground(terrain, start, direction, middle)
            if height > 0.0:
                low, above = middle, height
                # Illinois rule: halve the value of an end that is kept twice, else convergence is one-sided.
                below = 0.5 * below if side > 0 else below
                side = 1
            else:
                high, below = middle, height
                above = 0.5 * above if side < 0 else above
                side = -1
            if abs(height) < 0.1 * _EXACT:
                low, high = middle, middle
                break
        distances[i] = 0.5 * (low + high)


RAY_PARTS = (*GROUND_PARTS, above_ground)
"""Functions that :mod:`mirdrake.core.compiled` compiles for :func:`refine_hits`."""
