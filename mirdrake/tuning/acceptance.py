"""Acceptance criteria of a tuning study, and the effect of a finer step of the plant."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mirdrake.tuning.robustness import MonteCarlo
from mirdrake.tuning.selection import Verification
from mirdrake.tuning.spec import breaks_limit
from mirdrake.tuning.stages import Candidate
from mirdrake.tuning.trials import finite

SIGNIFICANT = 0.05
"""Relative change of the IAE at a finer step of the plant that is reported."""


@dataclass(frozen=True)
class Criterion:
    """Criterion of a tuned loop.

    Attributes:
        name: ``iae_ratio``: IAE over that of the baseline; ``constraint``: a figure within its limit; ``monte_carlo``:
            number of runs that are not stable; ``finer_step``: 1 if not stable at a finer step of the plant;
            ``cheaper_than_rule``: cost less than that of the best rule; ``robust_unlike_rules``: 1 if feasible and
            robust, as no rule is; ``feasible_unlike_rules``: 1 if feasible, as no rule is; ``schedule``: number of
            speeds at which the gain schedule breaks a constraint.
        value: of the candidate; None if it is undefined.
        limit: of the value.
        met: whether the criterion is met.
        figure: of a constraint.
        rule: name of the best rule.
    """

    name: Literal[
        "iae_ratio", "constraint", "monte_carlo", "finer_step", "cheaper_than_rule", "robust_unlike_rules",
        "feasible_unlike_rules", "schedule",
    ]  # fmt: skip
    value: float | None
    limit: float
    met: bool
    figure: str = ""
    rule: str = ""


@dataclass(frozen=True)
class StepEffect:
    """Effect of a finer step of the plant on the best gains.

    Attributes:
        step: usual step [s].
        finer_step: finer step [s].
        usual: figures at the usual step.
        finer: figures at the finer step; empty unless ok.
        status: at the finer step.
        reason: one line; empty if ok.
    """

    step: float
    finer_step: float
    usual: dict[str, float]
    finer: dict[str, float]
    status: str
    reason: str = ""

    @property
    def is_significant(self) -> bool:
        """Whether the loop is not stable at the finer step, or its IAE differs by more than :data:`SIGNIFICANT`."""
        if self.status != "ok":
            return True
        return abs(self.finer["iae"] - self.usual.get("iae", 0.0)) > SIGNIFICANT * self.finer["iae"]


def accept(
    baseline: Candidate,
    rule: Candidate | None,
    winner: Candidate,
    *,
    constraints: Mapping[str, float],
    step_time: float,
    monte_carlo: MonteCarlo | None = None,
    verified: Mapping[str, Verification],
) -> tuple[Criterion, ...]:
    """Return the criteria of a tuned loop, and whether they are met.

    The IAE is at most half of the baseline's, the constraints are met, no run of the Monte Carlo is unstable, nor the
    test at a finer step of the plant, and the cost is less than that of the best rule that meets all of these.

    Args:
        baseline: candidate to compare with.
        rule: best rule; None without one.
        winner: best candidate, or the nearest to it.
        constraints: limits of figures.
        step_time: of the test [s].
        monte_carlo: with the winner and the rule; None if the study has none.
        verified: checks by name of the candidate.
    """
    before, after = _iae(baseline, step_time), _iae(winner, step_time)
    ratio = after / before if math.isfinite(before) and before > 0.0 else 0.0 if math.isfinite(after) else math.inf
    criteria = [Criterion("iae_ratio", finite(ratio), 0.5, ratio <= 0.5)]
    for name, limit in constraints.items():
        value = winner.trial.figures.get(name, math.nan)
        criteria.append(Criterion("constraint", finite(value), limit, not breaks_limit(name, value, limit), name))
    if monte_carlo is not None:
        failures = monte_carlo.failures(winner.name).failures
        criteria.append(Criterion("monte_carlo", float(failures), 0.0, failures == 0))
    if winner.name in verified and verified[winner.name].finer is not None:
        fails = verified[winner.name].fails_at_finer_step
        criteria.append(Criterion("finer_step", float(fails), 0.0, not fails))

    # Comparison with the best rule, if it is feasible and robust.
    def is_robust(candidate: Candidate) -> bool:
        failures = monte_carlo.failures(candidate.name).failures if monte_carlo is not None else 0
        check = verified.get(candidate.name)
        return not failures and not (check is not None and check.fails_at_finer_step)

    feasible = winner.trial.feasible
    if rule is not None and not rule.trial.feasible:
        criteria.append(Criterion("feasible_unlike_rules", float(feasible), 1.0, feasible))
    elif rule is not None and not is_robust(rule):
        met = feasible and is_robust(winner)
        criteria.append(Criterion("robust_unlike_rules", float(met), 1.0, met))
    elif rule is not None:
        met = feasible and winner.trial.cost < rule.trial.cost
        cost = finite(winner.trial.cost)
        criteria.append(Criterion("cheaper_than_rule", cost, rule.trial.cost, met, rule=rule.name))
    return tuple(criteria)


def _iae(candidate: Candidate, step_time: float) -> float:
    """Return the IAE of a candidate; for an unstable one, up to where its response ends; inf without a response."""
    if "iae" in candidate.trial.figures or candidate.response is None:
        return candidate.trial.figures.get("iae", math.inf)
    part = candidate.response[candidate.response["t"] >= step_time - 1e-9]
    error = (part["reference"] - part["output"]).abs().to_numpy()
    return float(np.sum(0.5 * (error[1:] + error[:-1]) * np.diff(part["t"].to_numpy())))
