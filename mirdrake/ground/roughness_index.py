"""International Roughness Index (IRI) of a road profile.

The index is the mean rectified velocity of the suspension of a standard quarter car at 80 km/h over its speed, in m per
km. The profile is averaged over 250 mm, the length that a tyre envelops, and is linear between its samples, so that one
transition matrix is exact for all steps (M. W. Sayers, On the calculation of international roughness index from
longitudinal road profile, Transportation Research Record 1501, 1995; ASTM E1926).
"""

import numpy as np
import scipy  # it imports its parts when they are first used
from numpy.typing import NDArray

Array = NDArray[np.float64]

SPEED = 80.0 / 3.6
"""Speed of the quarter car [m/s]."""

SUSPENSION, TYRE, DAMPING, UNSPRUNG = 63.3, 653.0, 6.0, 0.15
"""Stiffness of suspension and tyre [1/s²], damping [1/s] and unsprung mass [1] of the "golden car", over its sprung
mass."""

BASE = 0.25
"""Length of the moving average [m]."""

_START = 11.0  # length whose mean slope is the motion at the start, half a second at 80 km/h [m]


def quarter_car() -> tuple[Array, Array]:
    """Return A (4, 4) and B (4) of the golden car over time, ẋ = A x + B u.

    The states are slope-like, so that the profile enters by its slope: height and vertical velocity of the sprung mass,
    then of the unsprung mass [m, m/s]; the input is the height of the road [m].
    """
    A = np.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [-SUSPENSION, -DAMPING, SUSPENSION, DAMPING],
            [0.0, 0.0, 0.0, 1.0],
            [
                SUSPENSION / UNSPRUNG,
                DAMPING / UNSPRUNG,
                -(SUSPENSION + TYRE) / UNSPRUNG,
                -DAMPING / UNSPRUNG,
            ],
        ]
    )
    return A, np.array([0.0, 0.0, 0.0, TYRE / UNSPRUNG])


def roughness_index(z: Array, spacing: float) -> float:
    """Return the IRI of a profile [m/km], which is [mm/m].

    Args:
        z: heights along a straight line [m] (N).
        spacing: distance between them [m]; at most 0.3 m.

    Raises:
        ValueError: the profile is shorter than 11 m, or its spacing is too large.
    """
    if spacing > 0.3 or len(z) * spacing < _START:
        raise ValueError(f"{len(z)} heights every {spacing:g} m; the IRI needs 11 m, and at most 0.3 m between them")
    # Moving average over 250 mm; shorter profiles of coarse samples are already averages.
    width = max(int(BASE / spacing + 0.5), 1)
    smooth = np.convolve(z, np.full(width, 1.0 / width), mode="valid")
    slope = np.diff(smooth) / spacing

    # Derivatives of the states obey the same equations with the slope as input, which is constant between two samples.
    A, B = quarter_car()
    step = spacing / SPEED
    augmented = np.zeros((5, 5))
    augmented[:4, :4], augmented[:4, 4] = A * step, B * step
    transition = scipy.linalg.expm(augmented)[:4]
    phi, gamma = transition[:, :4], transition[:, 4]
    # The car begins as if it had followed the mean slope of the first part.
    first = float(np.mean(slope[: round(_START / spacing)]))
    x = np.array([first, 0.0, first, 0.0])
    total = 0.0
    for value in slope.tolist():
        x = phi @ x + gamma * value
        total += abs(float(x[0] - x[2]))
    return 1e3 * total / len(slope)
