"""Profile likelihood: how much worse the fit gets when one parameter is held elsewhere and the others follow."""

from dataclasses import replace

import numpy as np
import pandas as pd

from mirdrake.errors import RunError
from mirdrake.identification.estimators.options import EstimatorOptions
from mirdrake.identification.estimators.solve import Solution, solve

_STEPS = (-3.0, -2.0, -1.0, 1.0, 2.0, 3.0)
_WIDEST = 1.5


def profiles_of(solution: Solution, options: EstimatorOptions) -> dict[str, pd.DataFrame]:
    """Profiles of all free parameters: value, and rise of -2 ln likelihood.

    The rise is divided by the factor by which the autocorrelation of the residuals widens the variance, so that 3.84 is
    the end of the 95 % interval.
    """
    found = {}
    problem = solution.problem
    quick = replace(options, iterations=15)
    least = solve(problem, quick, solution.z, passes=1).cost
    for i, one in enumerate(problem.free):
        name = one.info.name
        sigma = min(float(np.sqrt(solution.covariance[i, i])), _WIDEST)
        centre = float(solution.z[i])
        rows = [(one.to_value(centre), 0.0)]
        widened = max(float(solution.covariance[i, i] / max(solution.white[i, i], 1e-300)), 1.0)
        for step in _STEPS:
            scaled = centre + step * sigma
            value = one.to_value(scaled)
            if not one.info.low <= value <= one.info.high:
                continue
            held = [
                replace(other, kind="fixed", prior=None, info=replace(other.info, guess=value))
                if other.info.name == name
                else other
                for other in problem.unknowns
            ]
            part = replace(problem, unknowns=held)
            try:
                other = solve(part, quick, np.delete(solution.z, i), passes=1)
            except RunError:
                continue
            rows.append((value, 2.0 * max(other.cost - least, 0.0) / widened))
        found[name] = pd.DataFrame(sorted(rows), columns=["value", "cost"])
    return found
