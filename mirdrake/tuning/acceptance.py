"""Acceptance criteria of a tuning study, and the effect of a finer step of the plant."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from mirdrake.core.json_io import finite_or_none
from mirdrake.tuning.robustness import MonteCarlo
from mirdrake.tuning.selection import Verification
from mirdrake.tuning.spec import breaks_limit, printed
from mirdrake.tuning.stages import Candidate

AGAINST_BASELINE = ("cheaper_than_baseline", "cheaper_in_runs")
"""Criteria that compare with the baseline."""

SIGNIFICANT = 0.05
"""Relative change of the IAE at a finer step of the plant that is reported."""


@dataclass(frozen=True)
class Criterion:
    """Criterion of a tuned loop.

    Attributes:
        name: ``cheaper_than_baseline``: cost less than that of the baseline; ``cheaper_in_runs``: median over the runs
            of the Monte Carlo of the cost over that of the baseline, less than 1; ``constraint``: a figure within its
            limit; ``monte_carlo``: number of runs that are not stable, at most those in which the present control is
            not stable either; ``finer_step``: 1 if not stable at a finer step of the plant; ``own_slopes``: 1 if it
            does not follow the vehicle's own slopes of the set-point; ``no_costlier_than_rule``: median over the runs
            of the cost over that of the best rule, at most 1; without a Monte Carlo, cost of at most that of the rule;
            ``robust_unlike_rules``: 1 if feasible and robust, as no rule is; ``feasible_unlike_rules``: 1 if feasible,
            as no rule is; ``schedule``: number of speeds at which the gain schedule breaks a constraint.
        value: of the candidate; None if it is undefined.
        limit: of the value.
        met: whether the criterion is met.
        figure: of a constraint.
        rule: name of the best rule.
    """

    name: Literal[
        "cheaper_than_baseline", "cheaper_in_runs", "constraint", "monte_carlo", "finer_step", "own_slopes",
        "no_costlier_than_rule", "robust_unlike_rules", "feasible_unlike_rules", "schedule",
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
    cost: Mapping[str, float],
    constraints: Mapping[str, float],
    monte_carlo: MonteCarlo | None = None,
    unavoidable: Mapping[str, int] = MappingProxyType({}),
    verified: Mapping[str, Verification],
) -> tuple[Criterion, ...]:
    """Return the criteria of a tuned loop, and whether they are met.

    The cost is less than that of a stable baseline, also in the median run of the Monte Carlo; the constraints are met;
    no run of the Monte Carlo is unstable in which the present control is stable, nor the test at a finer step of the
    plant, nor that on the vehicle's own slopes of the set-point; and the cost is at most that of the best rule that
    meets all of these. Costs that print equal are equal.

    Args:
        baseline: candidate to compare with.
        rule: best rule; None without one.
        winner: best candidate, or the nearest to it.
        cost: weights of figures.
        constraints: limits of figures.
        monte_carlo: with the baseline, the winner and the rule; None if the study has none.
        unavoidable: number of runs by candidate in which neither it nor the present control is stable; none if missing.
        verified: checks by name of the candidate.
    """
    before, after = baseline.trial.cost, winner.trial.cost
    # Costs are compared as printed: a difference that no report shows is not an improvement.
    met = winner.name != baseline.name and printed(after) < printed(before)
    criteria = [Criterion("cheaper_than_baseline", finite_or_none(after), before, met)]

    # One nominal test may favour a candidate by chance; the median ratio over the Monte Carlo must agree.
    ratio = monte_carlo.median_ratio(winner.name, baseline.name, cost) if monte_carlo is not None else None
    if ratio is not None:
        criteria.append(Criterion("cheaper_in_runs", finite_or_none(ratio), 1.0, printed(ratio) < 1.0))
    for name, limit in constraints.items():
        value = winner.trial.figures.get(name, math.nan)
        met = not breaks_limit(name, value, limit)
        criteria.append(Criterion("constraint", finite_or_none(value), limit, met, name))
    if monte_carlo is not None:
        failures = monte_carlo.failures(winner.name).failures
        allowed = unavoidable.get(winner.name, 0)
        criteria.append(Criterion("monte_carlo", float(failures), float(allowed), failures <= allowed))
    # A result that depends on the step of the plant is an artefact of the simulation.
    if winner.name in verified and verified[winner.name].finer is not None:
        fails = verified[winner.name].fails_at_finer_step
        criteria.append(Criterion("finer_step", float(fails), 0.0, not fails))

    if winner.name in verified and verified[winner.name].slopes is not None:
        fails = verified[winner.name].fails_on_slopes
        criteria.append(Criterion("own_slopes", float(fails), 0.0, not fails))

    # Comparison with the best rule, if it is feasible and robust.
    def is_robust(candidate: Candidate) -> bool:
        failures = monte_carlo.failures(candidate.name).failures if monte_carlo is not None else 0
        failures -= unavoidable.get(candidate.name, 0)
        check = verified.get(candidate.name)
        return not failures and not (check is not None and (check.fails_at_finer_step or check.fails_on_slopes))

    # The rule sets the bar only as far as it meets the constraints and is robust; else it has to be beaten in that.
    feasible = winner.trial.feasible
    if rule is not None and not rule.trial.feasible:
        criteria.append(Criterion("feasible_unlike_rules", float(feasible), 1.0, feasible))
    elif rule is not None and not is_robust(rule):
        met = feasible and is_robust(winner)
        criteria.append(Criterion("robust_unlike_rules", float(met), 1.0, met))
    elif rule is not None:
        # As between winner and baseline, the median counts: one test may favour either of them by chance.
        median = monte_carlo.median_ratio(winner.name, rule.name, cost) if monte_carlo is not None else None
        value, limit = (after, rule.trial.cost) if median is None else (median, 1.0)
        met = feasible and printed(value) <= printed(limit)
        criteria.append(Criterion("no_costlier_than_rule", finite_or_none(value), limit, met, rule=rule.name))
    return tuple(criteria)
