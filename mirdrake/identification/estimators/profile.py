"""Profile likelihood: rise of the cost when one parameter is moved and the others are refitted."""

from dataclasses import replace

import numpy as np
import pandas as pd

from mirdrake.core.errors import RunError
from mirdrake.identification.estimators.options import EstimatorOptions
from mirdrake.identification.estimators.solve import Solution, minimise

_SIDES = ((-1.0, -2.0, -3.0), (1.0, 2.0, 3.0))
_WIDEST = 1.5
_CLOSE = 5e-3  # of half of the rise


def profiles_of(solution: Solution, options: EstimatorOptions) -> dict[str, pd.DataFrame]:
    """Return the profiles of all free parameters: value, and rise of -2 ln likelihood.

    The rise is divided by the factor by which the autocorrelation of the residuals widens the variance, so that 3.84 is
    the end of the 95 % interval.
    """
    profiles = {}
    problem = solution.problem
    quick = replace(options, iterations=15)
    # Refitted with the same quick options as the profile, so that both costs are comparable.
    min_cost = minimise(problem, quick, solution.z).cost
    close = max(_CLOSE / max(min_cost, 1e-9), 1e-8)
    for i, parameter in enumerate(problem.free):
        name = parameter.info.name
        # An unidentified parameter would be moved out of the range of the model.
        sigma = min(float(np.sqrt(solution.covariance[i, i])), _WIDEST)
        centre = float(solution.z[i])
        rows = [(parameter.to_value(centre), 0.0)]
        widened = float(solution.covariance[i, i] / max(solution.white[i, i], 1e-300)) or 1.0
        # The other unknowns start on the tangent of the profile, then from the neighbouring point.
        follow = np.delete(solution.white[:, i], i) / max(solution.white[i, i], 1e-300)
        follow = np.append(follow, np.zeros(len(solution.z) - len(problem.free)))
        for side in _SIDES:
            rest, last = np.delete(solution.z, i), 0.0
            for step in side:
                value = parameter.to_value(centre + step * sigma)
                if not parameter.info.low <= value <= parameter.info.high:
                    break
                # Fixing the parameter removes it from the unknowns; the others are minimised without constraint.
                unknowns = [
                    replace(other, kind="fixed", prior=None, info=replace(other.info, guess=value))
                    if other.info.name == name
                    else other
                    for other in problem.unknowns
                ]
                try:
                    other = minimise(
                        replace(problem, unknowns=unknowns), quick, rest + (step - last) * sigma * follow, close=close
                    )
                except RunError:
                    break
                rest, last = other.z, step
                rows.append((value, 2.0 * max(other.cost - min_cost, 0.0) / widened))
        profiles[name] = pd.DataFrame(sorted(rows), columns=["value", "cost"])
    return profiles
