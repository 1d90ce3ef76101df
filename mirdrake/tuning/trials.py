"""A candidate and what became of it, and all those of a search: which is best, and what is given up for what.

A *cost* is a weighted sum of figures. A *constraint* bounds a figure from above, or from below where more of it is
better (:data:`mirdrake.tuning.spec.AT_LEAST`). A candidate that is unstable, failed, breaks a constraint or has a cost
that is not finite is never best; the sampler is told a finite violation instead, the worst for one that is unstable.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.studies.fronts import find_knee, pareto_front
from mirdrake.studies.optimise import Point
from mirdrake.tuning.spec import AT_LEAST

BROKEN, UNSTABLE = 1e9, 1e12
"""Violation of a constraint on a figure that is not finite, and that of an unstable or failed candidate [1]."""


@dataclass(frozen=True)
class Trial:
    """A candidate and what became of it.

    Attributes:
        number: from 0, in the order in which they were proposed.
        gains: by name.
        status: ok, unstable or failed.
        figures: by name; empty unless ok.
        cost: weighted sum; inf if a figure in it is not finite, or the status is not ok.
        violation: 0 if all constraints hold; else by how much they do not, in parts of their limits, added.
        reason: one line; empty if ok.
    """

    number: int
    gains: Point
    status: str
    figures: dict[str, float]
    cost: float
    violation: float
    reason: str = ""

    @property
    def feasible(self) -> bool:
        """Whether it is ok and all constraints hold."""
        return self.violation == 0.0 and math.isfinite(self.cost)

    def verdict(self) -> dict[str, Any]:
        """Cost, violation, feasible, status and reason, as the columns of a table."""
        return {
            "cost": self.cost,
            "violation": self.violation,
            "feasible": self.feasible,
            "status": self.status,
            "reason": self.reason,
        }

    def values(self, names: Sequence[str]) -> list[float]:
        """Figures to be made small: those of which more is better with the other sign; nan for unknown ones."""
        signs = [-1.0 if name in AT_LEAST else 1.0 for name in names]
        return [sign * self.figures.get(name, math.nan) for sign, name in zip(signs, names, strict=True)]


@dataclass(frozen=True)
class Trials:
    """What a search found.

    Attributes:
        trials: in the order of their numbers.
        gains: names.
        cost: weight of each figure in the cost.
        constraints: limit of each figure.
        method: how the candidates were proposed.
        seed: of what was drawn.
        complete: whether all trials were made; not if Ctrl-C came before.
    """

    trials: tuple[Trial, ...]
    gains: tuple[str, ...]
    cost: dict[str, float]
    constraints: dict[str, float] = field(default_factory=dict)
    method: str = ""
    seed: int = 0
    complete: bool = True

    @property
    def best(self) -> Trial | None:
        """The feasible trial of the smallest cost; None if there is none."""
        feasible = [trial for trial in self.trials if trial.feasible]
        return min(feasible, key=lambda trial: (trial.cost, trial.number), default=None)

    @cached_property
    def table(self) -> pd.DataFrame:
        """A row a trial: number, the gains, the figures, cost, violation, feasible, status, reason."""
        names = dict.fromkeys(name for trial in self.trials for name in trial.figures)
        rows = [
            {"number": trial.number, **trial.gains}
            | {name: trial.figures.get(name, math.nan) for name in names}
            | trial.verdict()
            for trial in self.trials
        ]
        columns = ["number", *self.gains, *names, "cost", "violation", "feasible", "status", "reason"]
        return pd.DataFrame(rows, columns=columns)

    def front(self, figures: Sequence[str] | None = None) -> tuple[Trial, ...]:
        """Feasible trials that no other feasible trial beats in one figure without being worse in another.

        Args:
            figures: names; those of the cost if left out. Sorted by the first of them.
        """
        names = self._named(figures)
        feasible = [trial for trial in self.trials if trial.feasible and np.isfinite(trial.values(names)).all()]
        kept = pareto_front(np.array([trial.values(names) for trial in feasible]).reshape(-1, len(names)))
        return tuple(sorted((feasible[k] for k in kept), key=lambda trial: (*trial.values(names), trial.number)))

    def knee(self, figures: Sequence[str] | None = None) -> Trial | None:
        """The knee of the front, see :func:`find_knee`; None without a front."""
        front = self.front(figures)
        if not front:
            return None
        names = self._named(figures)
        return front[find_knee(np.array([trial.values(names) for trial in front]))]

    def _named(self, figures: Sequence[str] | None) -> list[str]:
        return list(self.cost if figures is None else figures)


def judge(
    number: int,
    gains: Mapping[str, float],
    record: Mapping[str, Any],
    cost: Mapping[str, float],
    constraints: Mapping[str, float],
) -> Trial:
    """A trial from what its evaluation gave.

    Raises:
        ConfigError: the evaluation knows no such figure.
    """
    status, reason = str(record["status"]), str(record.get("reason", ""))
    figures: dict[str, float] = dict(record.get("figures") or {})
    if status != "ok":
        return Trial(number, dict(gains), status, {}, math.inf, UNSTABLE, reason)
    for what, names in (("cost", cost), ("constraints", constraints)):
        for name in names:
            if name not in figures:
                raise ConfigError(f"{what}: no figure is called '{name}'; {did_you_mean(name, figures)}")
    total = sum(weight * figures[name] for name, weight in cost.items() if weight)
    broken = sum(_excess(name, figures[name], limit) for name, limit in constraints.items())
    if not math.isfinite(total):
        total, broken = math.inf, broken + BROKEN
    return Trial(number, dict(gains), status, figures, total, broken, reason)


def _excess(name: str, value: float, limit: float) -> float:
    """By how much a figure breaks its limit, in parts of the limit."""
    over = limit - value if name in AT_LEAST else value - limit
    if math.isnan(over):
        return BROKEN
    return min(max(over, 0.0) / (abs(limit) or 1.0), BROKEN)
