"""Block bootstrap of a minimum: its shifts when blocks of the data are drawn with replacement.

The blocks are much longer than the autocorrelation of the residuals (H. R. Künsch, Annals of Statistics 17, 1989). A
draw is not fitted anew. Two Newton steps with the derivatives at the minimum replace the fit: one from there, and one
from where it leads, with the residuals of a simulation. The curvature of the loss is ρ' + 2 r² ρ'' (B. Triggs et al.,
Bundle adjustment: a modern synthesis, 2000, section 4.3): residuals beyond the width of a Huber loss have none. With
the weights ρ' alone the steps would be too short, and the intervals up to a tenth too narrow.
"""

from collections.abc import Callable, Sequence

import numpy as np

from mirdrake.identification.estimators.problem import Problem
from mirdrake.identification.models.base import Array


def block_bootstrap(
    problem: Problem,
    z: Array,
    blocks: Sequence[slice],
    *,
    loss: Callable[[Array], Array],
    count: int,
    seed: int = 0,
) -> Array:
    """Return shifts of the unknowns when blocks are drawn with replacement (count, unknowns).

    Args:
        problem: the problem.
        z: its minimum.
        blocks: rows of the residuals in each block; together all measurements.
        loss: loss of squared residuals with two derivatives, as of :func:`.solve.robust`.
        count: number of draws.
        seed: seed of the draws.
    """
    random = np.random.default_rng(seed)
    first, slopes = problem.residuals(z), problem.jacobian(z)
    low, high = problem.bounds()
    shifts = np.zeros((count, len(z)))
    for k in range(count):
        drawn = np.bincount(random.integers(0, len(blocks), len(blocks)), minlength=len(blocks))
        # How often each residual counts; those of the priors count once.
        times = np.ones(len(slopes))
        for block, number in zip(blocks, drawn.tolist(), strict=True):
            times[block] = number
        for turn in range(2):
            place = np.clip(z + shifts[k], low, high) if turn else z
            residuals = problem.residuals(place) if turn else first
            # A draw from which the model diverges keeps its first step.
            if not np.isfinite(residuals).all():
                break
            _, weights, bend = loss(residuals**2)
            curvature = times * np.maximum(weights + 2.0 * bend * residuals**2, 0.0)
            inside = (slopes * curvature[:, None]).T @ slopes
            step = np.linalg.lstsq(inside, slopes.T @ (times * weights * residuals), rcond=None)[0]
            shifts[k] = place - z - step
    return shifts
