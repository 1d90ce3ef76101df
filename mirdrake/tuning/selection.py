"""Which rule to compare with, and which candidate is the best: by cost, among those that stand.

To stand is to be stable in all runs of the Monte Carlo, and at a finer step of the plant.
"""

from collections.abc import Sequence
from typing import Any

import pandas as pd

from mirdrake.tuning.designs import Design
from mirdrake.tuning.grip import axles_of, grip_use
from mirdrake.tuning.loops.base import Conditions
from mirdrake.tuning.loops.evaluate import LoopEvaluator, bench_of
from mirdrake.tuning.outcome import Candidate
from mirdrake.tuning.robustness import draw_conditions, read_ranges
from mirdrake.tuning.scenarios import corners, hardest, words
from mirdrake.tuning.stages import Stages, rounded
from mirdrake.tuning.trials import Trial, Trials

POOL = 8
"""Candidates that are shaken at most before the one that fails least is taken; rules, too."""

HARD = 6
"""Draws in which others have failed, known to a search at most."""


class Selection:
    """Chooses among candidates.

    Args:
        stages: of the study.
        tried: candidates; a softer rule is added if it comes to that.
        softer: rules to compare with if none of `tried` stands, the fastest first.

    Attributes:
        hard: draws of the Monte Carlo in which candidates that keep the constraints have failed.
        fallen_rules: rules that keep the constraints, cost less than the one compared with, and do not stand.
        at_finer: candidates at a finer step of the plant, by name; None where that cannot be tried.
        lost_at_finer: whether a finer step has taken candidates of the search.
    """

    def __init__(self, stages: Stages, tried: list[Candidate], softer: Sequence[Design] = ()) -> None:
        self.stages, self._tried, self._softer = stages, tried, softer
        spreads = read_ranges(stages.ranges) if stages.ranges else {}
        runs = stages.spec.robustness.runs
        self._draws = draw_conditions(spreads, runs=runs, seed=stages.spec.seed) if spreads and runs else []
        self._first = hardest(stages.spec, stages.ranges) if self._draws else []
        self.hard: tuple[Conditions, ...] = ()
        self.fallen_rules: list[Candidate] = []
        self._failures: dict[str, int] = {}
        self._made: dict[tuple[float, ...], Candidate] = {}
        self.at_finer: dict[str, Candidate | None] = {}
        self.lost_at_finer = False

    def finer(self, one: Candidate) -> Candidate | None:
        """A candidate at a finer step of the plant; None where nothing is known of the loop but its signals."""
        name = one.design.name
        if name not in self.at_finer:
            self.at_finer[name] = self.stages.try_finer(one.design)
        return self.at_finer[name]

    def falls(self, one: Candidate) -> int:
        """In how many runs of the Monte Carlo, and at a finer step of the plant, a candidate is not stable."""
        return self.failures(one) + _swings(self.finer(one))

    def failures(self, one: Candidate) -> int:
        """Runs of the Monte Carlo in which a candidate is not stable; those draws become hard ones."""
        name = one.design.name
        if name not in self._failures:
            robust = self.stages.shake([one])
            lost = [] if robust is None else robust.table.loc[robust.table["status"] != "ok", "run"].tolist()
            self._failures[name] = len(lost)
            new = [self._draws[run] for run in lost if self._draws[run] not in self.hard]
            self.hard = (*self.hard, *new)[:HARD]
        return self._failures[name]

    def best_rule(self) -> Candidate | None:
        """The cheapest rule that keeps the constraints and stands; if none does, the fastest of the softer ones.

        If none of these does either, that nearest to it.
        """
        rules = sorted((one for one in self._tried if one.design.kind == "rule"), key=lambda one: one.rank)
        able = [one for one in rules if one.trial.feasible]
        for one in able[:POOL]:
            if not self.falls(one):
                return one
            self.fallen_rules.append(one)
        for design in self._softer:
            (one,) = self.stages.try_designs([design], "softer rules")
            if one.trial.feasible and not _swings(self.finer(one)) and not self.failures(one):
                self._tried.append(one)
                return one
        if self.fallen_rules:
            nearest = min(self.fallen_rules, key=self.falls)
            self.fallen_rules.remove(nearest)
            return nearest
        return rules[0] if rules else None

    def best(self, fine: Sequence[Trials]) -> Candidate | None:
        """The cheapest candidate that keeps the constraints and stands.

        If none does, the one that falls least among those that were shaken; None if none keeps the constraints.
        """
        known = [one for one in self._tried if one.trial.feasible and one.design.kind != "baseline"]
        found = [one for trials in fine for one in trials.trials if one.feasible]
        pool: list[Candidate | Trial] = sorted([*known, *found], key=_cost)
        fallen: list[tuple[int, int, Candidate]] = []
        for at, one in enumerate(pool):
            chosen = one if isinstance(one, Candidate) else self._searched(one)
            if chosen is None:
                continue
            lost = self.falls(chosen)
            if not lost:
                return chosen
            fallen.append((lost, at, chosen))
            if len(fallen) == POOL:
                break
        return min(fallen)[2] if fallen else None

    def good(self, best: Candidate, rule: Candidate | None) -> bool:
        """Whether a candidate stands, and costs less than the rule if that does."""
        if self.falls(best):
            return False
        return rule is None or bool(self.falls(rule)) or best.trial.cost < rule.trial.cost

    def _searched(self, trial: Trial) -> Candidate | None:
        """A trial as a candidate, rounded; None if it does not stand what comes first, or the rounding."""
        gains = rounded(trial.gains)
        key = tuple(gains.values())
        if key in self._made:
            return self._made[key]
        if not self.stages.stands(gains, [*self.hard, *self._first]):
            return None
        how = f"{self.stages.spec.search.method} on the reduced model, refined on the plant"
        name = "searched" if not self._made else f"searched {len(self._made) + 1}"
        design = Design(name, "searched", how, gains)
        fine = self.stages.try_finer(design)
        if _swings(fine):
            self.lost_at_finer = True
            return None
        (chosen,) = self.stages.try_designs([design], "best")
        if not chosen.trial.feasible:
            return None
        self.at_finer[name] = fine
        self._made[key] = chosen
        return chosen

    # --- what the reader must know ---

    def notes(self, winner: Candidate) -> list[str]:
        """Rules that look better than they are."""
        runs, told = self.stages.spec.robustness.runs, []
        for one in self.fallen_rules:
            lost, fine = self.failures(one), self.falls(one) > self.failures(one)
            where = [f"in {lost} of {runs} runs"] * bool(lost) + ["at a finer step of the plant"] * fine
            if one is not winner:
                told.append(f"{one.design.name} costs {one.trial.cost:.4g}, but is not stable {' and '.join(where)}")
        return told

    def corners(self, chosen: Sequence[Candidate]) -> dict[str, list[dict[str, str]]]:
        """Corners of the ranges, harder than nearly every draw: conditions, status and reason for each candidate."""
        if self.stages.bare:
            return {}
        places, evaluate = corners(self.stages.ranges), LoopEvaluator(self.stages.loop)
        found: dict[str, list[dict[str, str]]] = {}
        for one in chosen:
            rows = [evaluate(one.design.gains, place) for place in places]
            found[one.design.name] = [
                {"conditions": words(place), "status": row.status, "reason": row.reason}
                for place, row in zip(places, rows, strict=True)
            ]
        return found

    def with_grip(self, table: pd.DataFrame) -> pd.DataFrame:
        """The Monte Carlo with what each run asks of the tyres, over what they can give."""
        loop = self.stages.loop
        if self.stages.bare or loop.kind == "steering":
            return table
        bench: Any = bench_of(loop)
        axles = axles_of(bench)
        use = [grip_use(axles, loop, one) for one in self._draws]
        at = list(table.columns).index("seed")
        table = table.copy()
        table.insert(at, "grip_use", [use[run] for run in table["run"]])
        return table


def _swings(one: Candidate | None) -> bool:
    return one is not None and one.trial.status != "ok"


def _cost(one: Candidate | Trial) -> float:
    return one.trial.cost if isinstance(one, Candidate) else one.cost
