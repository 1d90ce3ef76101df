"""Screening of the Monte Carlo: the reduced model makes all runs, the plant confirms those that matter.

Gains that cost least in one test may do so only there. Searches therefore rank gains by their mean cost in the test and
in a sample of the runs: that of the test, on the plant, times the ratio of both on the model.

The plant makes the runs that are most likely to fail, and the first ones, which are a random sample. The rank
correlation of the cost on both (C. Spearman, American Journal of Psychology 15 (1904) 72) decides whether the model
may stand for the other runs. If it may not, the plant makes all of them.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import scipy  # its parts are imported when they are first used

from mirdrake.tuning.loops.base import NOMINAL, Conditions, Evaluation, Evaluator, Fidelity
from mirdrake.tuning.models import Floats
from mirdrake.tuning.scenarios import hardest

COST = "cost_in_runs"
"""Figure by which searches rank gains."""

SAMPLE = 12
"""First runs, which the plant makes for every candidate: all on one side of 1 mean a median there (p = 0.0005)."""

WORST = 6
"""Runs of the largest cost on the model, and of the largest use of grip, that the plant makes."""

RANKS = 0.9
"""Rank correlation above which the model may stand for the plant."""

DECIDED = 0.05
"""Two-sided probability of the sign test below which a median is decided."""


@dataclass(frozen=True)
class InRuns:
    """Tests gains, and adds their mean cost in the test and in some runs as the figure :data:`COST`; can be pickled.

    Attributes:
        evaluate: tests gains.
        draws: conditions of the runs; none: the cost is that of the test.
        cost: weights of figures.
    """

    evaluate: Evaluator
    draws: tuple[Conditions, ...]
    cost: dict[str, float]

    def __call__(
        self, gains: Mapping[str, float], conditions: Conditions = NOMINAL, fidelity: Fidelity = "plant"
    ) -> Evaluation:
        """Test gains; every failure is an evaluation."""
        result = self.evaluate(gains, conditions, fidelity)
        if result.status != "ok" or conditions != NOMINAL:
            return result
        cost = self._sum(result) * cost_ratio(self.evaluate, gains, self.draws, self.cost)
        return replace(result, figures={**result.figures, COST: cost})

    def _sum(self, result: Evaluation) -> float:
        return sum(weight * result.figures.get(figure, math.nan) for figure, weight in self.cost.items() if weight)


def cost_ratio(
    evaluate: Evaluator, gains: Mapping[str, float], draws: Sequence[Conditions], cost: Mapping[str, float]
) -> float:
    """Return the mean cost of gains in a test and in runs over that in the test, on the reduced model [1].

    It is inf if a run is not stable, and 1 without runs, or without gains: servos have no model.
    """
    if not draws or not gains:
        return 1.0
    costs = []
    for conditions in (NOMINAL, *draws):
        result = evaluate(gains, conditions, "reduced")
        if result.status != "ok":
            return math.inf
        costs.append(sum(weight * result.figures[figure] for figure, weight in cost.items() if weight))
    return float(np.mean(costs)) / max(costs[0], 1e-300)


def choose_runs(
    model: pd.DataFrame, draws: Sequence[Conditions], cost: Mapping[str, float], *, grip: Floats | None = None
) -> set[int]:
    """Return the runs that are most likely to fail.

    Args:
        model: a row per run, from the reduced model.
        draws: conditions of the runs.
        cost: weights of figures.
        grip: force per mass that the driven tyres can provide in each run [m/s²]; None if it does not matter.
    """
    chosen = {draws.index(draw) for draw in hardest(draws)}
    # A run that is unstable on the model has no cost: it is the worst.
    costs = np.nan_to_num(total_cost(model, cost) / [draw.step for draw in draws], nan=np.inf)
    chosen |= set(np.argsort(-costs, kind="stable")[:WORST].tolist())
    if grip is not None:
        mass = np.array([draw.mass for draw in draws])
        use = np.nan_to_num(_figure(model, "peak_effort") / mass / grip, nan=np.inf)
        chosen |= set(np.argsort(-use, kind="stable")[:WORST].tolist())
    return chosen


def total_cost(rows: pd.DataFrame, cost: Mapping[str, float]) -> Floats:
    """Return the weighted sum of figures of each row; nan for a row that is not ok."""
    parts = [weight * _figure(rows, figure) for figure, weight in cost.items() if weight]
    return np.where(rows["status"] == "ok", np.sum(parts, axis=0), np.nan)


def _figure(rows: pd.DataFrame, name: str) -> Floats:
    """Return a figure of each row; nan where it is undefined, as in runs that are not ok."""
    # Without a run that is ok there is no column.
    return rows[name].to_numpy(dtype=float) if name in rows else np.full(len(rows), np.nan)


@dataclass(frozen=True)
class RankCheck:
    """Runs of a candidate on the reduced model against those on the plant.

    Attributes:
        correlation: rank correlation of the cost [1].
        is_trusted: whether the model may stand for the plant. A candidate that fails on the plant needs no more runs.
    """

    correlation: float
    is_trusted: bool


def check_ranks(model: pd.DataFrame, plant: pd.DataFrame, cost: Mapping[str, float]) -> RankCheck:
    """Compare the costs of a candidate's runs on the model, a row per run, with those of the runs on the plant."""
    same = model.set_index("run").loc[plant["run"]]
    correlation = rank_correlation(total_cost(same, cost), total_cost(plant, cost))
    if (plant["status"] != "ok").any():
        return RankCheck(correlation, is_trusted=True)
    return RankCheck(correlation, correlation > RANKS and bool((model["status"] == "ok").all()))


def rank_correlation(model: Floats, plant: Floats) -> float:
    """Return Spearman's rank correlation; nan, of a run that is not stable, is the worst of all."""
    ranks = [scipy.stats.rankdata(np.nan_to_num(values, nan=np.inf)) for values in (model, plant)]
    # Equal ranks have no correlation: such a model has no information about the runs.
    if any(np.ptp(values) == 0.0 for values in ranks):
        return 0.0
    return float(np.corrcoef(*ranks)[0, 1])


def is_decided(ratios: Floats) -> bool:
    """Return whether a sample of ratios decides on which side of 1 their median is."""
    above, below = int(np.sum(ratios > 1.0)), int(np.sum(ratios < 1.0))
    return above + below > 0 and scipy.stats.binomtest(above, above + below).pvalue < DECIDED
