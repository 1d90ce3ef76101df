"""Trials of a search: figures, cost, constraints and the best of them; reasons for the rejection of a candidate.

A *cost* is a weighted sum of figures. A *constraint* is an upper bound of a figure, or a lower one if larger is better
(:data:`mirdrake.tuning.spec.AT_LEAST`). A candidate that is unstable, failed, breaks a constraint or has a cost that is
not finite is never the best; the sampler gets a finite violation instead, the largest one for an unstable candidate.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
import pandas as pd

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.json_io import finite_or_none
from mirdrake.studies.fronts import find_knee, pareto_front
from mirdrake.studies.optimise import Point
from mirdrake.tuning.loops.base import Conditions, Evaluation, Status
from mirdrake.tuning.spec import AT_LEAST, breaks_limit

BROKEN, UNSTABLE = 1e9, 1e12
"""Violation of a constraint on a figure that is not finite, and that of an unstable or failed candidate [1]."""


@dataclass(frozen=True)
class Rejection:
    """Reason why a candidate was rejected.

    Attributes:
        check: ``test``: unstable or failed in the nominal test; ``constraint``: breaks a limit in it;
            ``margin``: a margin of the plant breaks its limit; ``scenario``: not stable in one of the hardest
            conditions; ``finer_step``: not stable at a finer step of the plant; ``own_slopes``: does not follow the
            vehicle's own slopes of the set-point; ``monte_carlo``: not stable in a run.
        figure: whose limit is broken; empty for other checks.
        value: of the figure; None if it is undefined.
        limit: of the figure.
        run: number of the run of the Monte Carlo.
        conditions: of the run or scenario.
        reason: what happened, in one line; empty for a constraint.
        made_runs: number of runs of the Monte Carlo after which the candidate was rejected.
        needs: changes with which it would pass, each by name: the largest slopes of the set-point, which have to be met
            together, or conditions of the run, each of which alone would have to be nominal.
    """

    check: Literal["test", "constraint", "margin", "scenario", "finer_step", "own_slopes", "monte_carlo"]
    figure: str = ""
    value: float | None = None
    limit: float | None = None
    run: int | None = None
    conditions: Conditions | None = None
    reason: str = ""
    made_runs: int | None = None
    needs: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Trial:
    """A candidate and its evaluation.

    Attributes:
        number: from 0, in the order of the proposals.
        gains: by name.
        status: ok, unstable or failed.
        figures: by name; empty unless ok.
        cost: weighted sum; inf if a figure in it is not finite, or the status is not ok.
        violation: 0 if all constraints are met; otherwise the sum of the excesses, relative to the limits.
        reason: one line; empty if ok.
    """

    number: int
    gains: Point
    status: Status
    figures: dict[str, float]
    cost: float
    violation: float
    reason: str = ""

    @property
    def feasible(self) -> bool:
        """Whether it is ok and meets all constraints."""
        return self.violation == 0.0 and math.isfinite(self.cost)

    def rejections(self, constraints: Mapping[str, float]) -> tuple[Rejection, ...]:
        """Return the reasons of the nominal test to reject it; none if it is feasible."""
        if self.status != "ok":
            return (Rejection("test", reason=self.reason),)
        values = {name: self.figures.get(name, math.nan) for name in constraints}
        return tuple(
            Rejection("constraint", name, finite_or_none(values[name]), limit)
            for name, limit in constraints.items()
            if breaks_limit(name, values[name], limit)
        )

    def objectives(self, names: Sequence[str]) -> list[float]:
        """Return figures to minimise, of which those where larger is better change sign; nan for unknown ones."""
        signs = [-1.0 if name in AT_LEAST else 1.0 for name in names]
        return [sign * self.figures.get(name, math.nan) for sign, name in zip(signs, names, strict=True)]


@dataclass(frozen=True)
class Trials:
    """Result of a search.

    Attributes:
        trials: in the order of their numbers.
        gains: names.
        cost: weight of each figure in the cost.
        constraints: limit of each figure.
        method: that proposed the candidates.
        seed: of the random numbers.
        complete: whether all trials were made; False after Ctrl-C.
    """

    trials: tuple[Trial, ...]
    gains: tuple[str, ...]
    cost: dict[str, float]
    constraints: dict[str, float] = field(default_factory=dict)
    method: str = ""
    seed: int = 0
    complete: bool = True

    def extended(self, other: "Trials") -> "Trials":
        """Return the trials with those of a further search, numbered in sequence."""
        first = len(self.trials)
        return replace(
            self, trials=self.trials + tuple(replace(one, number=first + one.number) for one in other.trials)
        )

    @property
    def best(self) -> Trial | None:
        """The feasible trial with the smallest cost; None without a feasible one."""
        feasible = [trial for trial in self.trials if trial.feasible]
        return min(feasible, key=lambda trial: (trial.cost, trial.number), default=None)

    @property
    def leaders(self) -> list[Trial]:
        """The five best stable trials, feasible ones first."""
        ranked = sorted(self.trials, key=lambda trial: (trial.violation, trial.cost, trial.number))
        return [trial for trial in ranked if trial.status == "ok"][:5]

    @cached_property
    def table(self) -> pd.DataFrame:
        """A row per trial: number, the gains, the figures, cost, violation, feasible, status, reason."""
        # Trials may have different figures; the columns are all of them, in the order of their appearance.
        names = dict.fromkeys(name for trial in self.trials for name in trial.figures)
        rows = [
            {
                "number": trial.number,
                **trial.gains,
                **{name: trial.figures.get(name, math.nan) for name in names},
                "cost": trial.cost,
                "violation": trial.violation,
                "feasible": trial.feasible,
                "status": trial.status,
                "reason": trial.reason,
            }
            for trial in self.trials
        ]
        columns = ["number", *self.gains, *names, "cost", "violation", "feasible", "status", "reason"]
        return pd.DataFrame(rows, columns=columns)

    def front(self, figures: Sequence[str] | None = None) -> tuple[Trial, ...]:
        """Return the Pareto front of the feasible trials.

        Args:
            figures: names; by default those of the cost. Sorted by the first of them.
        """
        names = list(self.cost if figures is None else figures)
        feasible = [trial for trial in self.trials if trial.feasible and np.isfinite(trial.objectives(names)).all()]
        chosen = pareto_front(np.array([trial.objectives(names) for trial in feasible]).reshape(-1, len(names)))
        return tuple(sorted((feasible[k] for k in chosen), key=lambda trial: (*trial.objectives(names), trial.number)))

    def knee(self, figures: Sequence[str] | None = None) -> Trial | None:
        """Return the knee of the Pareto front, see :func:`find_knee`; None without a front."""
        front = self.front(figures)
        names = list(self.cost if figures is None else figures)
        return front[find_knee(np.array([trial.objectives(names) for trial in front]))] if front else None


def make_trial(
    number: int,
    gains: Mapping[str, float],
    evaluation: Evaluation,
    cost: Mapping[str, float],
    constraints: Mapping[str, float],
) -> Trial:
    """Return the trial of an evaluation.

    Raises:
        ConfigError: the evaluation does not have a figure of the cost or the constraints.
    """
    figures = evaluation.figures
    # The worst violation, so that samplers move away from unstable gains; figures of an unstable test mean nothing.
    if evaluation.status != "ok":
        return Trial(number, dict(gains), evaluation.status, {}, math.inf, UNSTABLE, evaluation.reason)
    for part, names in (("cost", cost), ("constraints", constraints)):
        for name in names:
            if name not in figures:
                raise ConfigError(f"{part}: no figure '{name}'; {did_you_mean(name, figures)}")
    # A weight of zero must not multiply an infinite figure (0 · inf = NaN).
    total = sum(weight * figures[name] for name, weight in cost.items() if weight)
    violation = sum(_excess(name, figures[name], limit) for name, limit in constraints.items())
    # Undefined costs are worse than any broken limit, but better than instability.
    if not math.isfinite(total):
        total, violation = math.inf, violation + BROKEN
    return Trial(number, dict(gains), "ok", figures, total, violation, evaluation.reason)


def _excess(name: str, value: float, limit: float) -> float:
    """Return by how much a figure breaks its limit, relative to the limit."""
    if not breaks_limit(name, value, limit):
        return 0.0
    # Relative to the limit, so that limits of different units add up; limited, since figures may be infinite.
    excess = limit - value if name in AT_LEAST else value - limit
    if math.isnan(excess):
        return BROKEN
    return min(excess / (abs(limit) or 1.0), BROKEN)
