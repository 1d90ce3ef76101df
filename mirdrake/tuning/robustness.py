"""Monte Carlo: candidates under random conditions, the same for each of them (common random numbers).

Each condition has its own random stream, from the seed and its name. So run i has the same conditions whatever the
candidate, the numbers of runs and workers, and the other conditions. Draws are independent, not stratified: the number
of failures is binomial, and the rate has the exact interval of C. J. Clopper and E. S. Pearson, Biometrika 26 (1934)
404.

In the statistics of the figures, a run that is unstable or failed counts as worse than all others.
"""

import math
import zlib
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pandas as pd
import scipy  # its parts are imported when they are first used
from numpy.typing import NDArray

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.execution.calls import open_executor
from mirdrake.execution.journal import Journal
from mirdrake.studies.sampling import spread
from mirdrake.studies.spec import ParameterSpec
from mirdrake.tuning.loops.base import Conditions, Evaluation, Evaluator, Fidelity
from mirdrake.tuning.models import Floats
from mirdrake.tuning.scenarios import Ranges
from mirdrake.tuning.search import LIMIT, Evaluations, TrialProgress, record_of
from mirdrake.tuning.spec import AT_LEAST

DRAWN = tuple(field.name for field in fields(Conditions) if field.name != "seed")
"""Conditions that can be drawn."""

SIGNED = frozenset({"steady_error"})
"""Figures whose absolute value counts."""


@dataclass(frozen=True)
class Quantiles:
    """Quantiles of a figure over the runs, from good to bad; infinite if that many runs are not ok.

    Attributes:
        median: half of the runs are not worse.
        p95: 95 % of the runs are not worse.
        worst: of all runs.
    """

    median: float
    p95: float
    worst: float


@dataclass(frozen=True)
class FailureRate:
    """Rate of the runs that are unstable or failed.

    Attributes:
        runs: number of runs.
        failures: number of those that are not ok.
        rate: failures / runs.
        low: lower end of the 95 % interval of the rate (Clopper-Pearson).
        high: upper end of it.
    """

    runs: int
    failures: int
    rate: float
    low: float
    high: float


@dataclass(frozen=True)
class CandidateRobustness:
    """Statistics of a candidate in the Monte Carlo.

    Attributes:
        failures: rate of the runs that are not ok.
        figures: quantiles by figure.
        on_plant: number of runs that the plant made; the reduced model made the others.
        correlation: rank correlation of the cost on the model and on the plant; None if the plant made all runs.
    """

    failures: FailureRate
    figures: dict[str, Quantiles]
    on_plant: int
    correlation: float | None = None


@dataclass(frozen=True)
class CornerTest:
    """Test at a corner of the ranges.

    Attributes:
        conditions: of the test.
        status: ok, unstable or failed.
        reason: one line; empty if ok.
    """

    conditions: Conditions
    status: str
    reason: str = ""


@dataclass(frozen=True)
class Robustness:
    """Summary of a Monte Carlo.

    Attributes:
        runs: per candidate.
        seed: of the draws.
        ranges: of each condition.
        candidates: by name.
        corners: tests at the corners of the ranges, by candidate.
    """

    runs: int
    seed: int
    ranges: Ranges
    candidates: dict[str, CandidateRobustness]
    corners: dict[str, tuple[CornerTest, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class MonteCarlo:
    """Runs of a Monte Carlo.

    Attributes:
        table: a row per run and candidate: candidate, run, fidelity, the drawn conditions, noise seed, figures, status,
            reason.
        ranges: of each condition.
        runs: per candidate.
        seed: of the draws.
        complete: whether all runs were made; False after Ctrl-C.
        sampled: by candidate the number of first runs that were all made: a random sample; missing: all runs.
        correlation: by candidate, see :class:`CandidateRobustness`.
    """

    table: pd.DataFrame
    ranges: Ranges
    runs: int
    seed: int
    complete: bool = True
    sampled: dict[str, int] = field(default_factory=dict)
    correlation: dict[str, float] = field(default_factory=dict)

    @property
    def candidates(self) -> list[str]:
        """Names, in the order given."""
        return list(dict.fromkeys(self.table["candidate"]))

    @cached_property
    def figures(self) -> list[str]:
        """Names of the figures."""
        columns = list(self.table.columns)
        return columns[columns.index("seed") + 1 : columns.index("status")]

    def quantiles(self, candidate: str, figure: str) -> Quantiles:
        """Return median, 95th percentile and worst of a figure.

        Raises:
            ConfigError: unknown candidate or figure.
        """
        rows = self.rows(candidate)
        if figure not in self.figures:
            raise ConfigError(f"no figure '{figure}'; {did_you_mean(figure, self.figures)}")
        return quantiles_of(figure, rows[figure].to_numpy(dtype=float), (rows["status"] == "ok").to_numpy())

    def failures(self, candidate: str) -> FailureRate:
        """Return how often a candidate is unstable or failed.

        Raises:
            ConfigError: unknown candidate.
        """
        rows = self.rows(candidate)
        return failure_rate(int((rows["status"] != "ok").sum()), len(rows))

    def summary(self, corners: dict[str, tuple[CornerTest, ...]]) -> Robustness:
        """Return the statistics of all candidates."""
        candidates = {}
        for name in self.candidates:
            figures = {figure: self.quantiles(name, figure) for figure in self.figures}
            on_plant = int((self.rows(name)["fidelity"] == "plant").sum())
            candidates[name] = CandidateRobustness(self.failures(name), figures, on_plant, self.correlation.get(name))
        return Robustness(self.runs, self.seed, self.ranges, candidates, corners)

    def median_ratio(self, candidate: str, other: str, cost: Mapping[str, float]) -> float | None:
        """Return the median over the sampled runs of the cost of a candidate over that of another one.

        Args:
            candidate: its name.
            other: name of the other one.
            cost: weights of figures.

        Returns:
            The median over the runs of :meth:`ratios`; None without one, or without the figures.
        """
        ratios = self.ratios(candidate, other, cost)
        return float(np.median(ratios)) if len(ratios) else None

    def ratios(self, candidate: str, other: str, cost: Mapping[str, float]) -> Floats:
        """Return the cost of a candidate over that of another one, in the sampled runs in which one is stable at least.

        A run that is not stable has an infinite cost: the ratio is 0, or inf.
        """
        if candidate == other or not {candidate, other} <= set(self.candidates) or not set(cost) <= set(self.figures):
            return np.zeros(0)
        sampled = min(self.sampled.get(name, self.runs) for name in (candidate, other))
        costs = []
        for name in (candidate, other):
            rows = self.rows(name).set_index("run")
            rows = rows[rows.index < sampled]
            total = pd.DataFrame({figure: weight * rows[figure] for figure, weight in cost.items()}).sum(axis=1)
            costs.append(total.where(rows["status"] == "ok", math.inf))
        # Runs in which both are not stable are nan.
        return np.asarray((costs[0] / costs[1]).dropna(), dtype=float)

    def rows(self, candidate: str) -> pd.DataFrame:
        """Return the runs of a candidate.

        Raises:
            ConfigError: unknown candidate.
        """
        if candidate not in self.candidates:
            raise ConfigError(f"no candidate '{candidate}'; {did_you_mean(candidate, self.candidates)}")
        return self.table[self.table["candidate"] == candidate]


def run_monte_carlo(
    evaluate: Evaluator,
    candidates: Mapping[str, Mapping[str, float]],
    ranges: Ranges,
    *,
    runs: int = 100,
    seed: int = 0,
    fidelity: Fidelity = "plant",
    executor: Executor | None = None,
    workers: int | None = 0,
    limit: float = LIMIT,
    store: Path | str | None = None,
    purpose: Mapping[str, object] | None = None,
    progress: TrialProgress | None = None,
    selected: Mapping[str, Sequence[int]] | None = None,
    known: Mapping[str, Mapping[Conditions, Evaluation]] = MappingProxyType({}),
) -> MonteCarlo:
    """Evaluate candidates under random conditions. After Ctrl-C, return the finished runs.

    Args:
        evaluate: tests gains under conditions; with workers it can be pickled.
        candidates: gains by name of the candidate.
        ranges: lower and upper end of conditions (mass, friction, delay, grade, noise).
        runs: per candidate.
        seed: of the draws; the noise of run i has its own seed, the same for every candidate.
        fidelity: reduced or plant.
        executor: see :func:`mirdrake.tuning.search.search`, also for the other arguments.
        workers: number of processes.
        limit: wall time of an evaluation [s].
        store: file that keeps every evaluation.
        purpose: of the file.
        progress: called after every evaluation.
        selected: runs to make by candidate; by default all.
        known: evaluations that have been made already, by candidate and conditions.

    Raises:
        ConfigError: no candidate, an unknown condition or an empty range.
        RunError: the file belongs to something else, or workers cannot start.
    """
    if not candidates:
        raise ConfigError("candidates: none is given; name at least one set of gains")
    draws = draw_conditions(ranges, runs=runs, seed=seed)
    # Numbers as floats, so that they are equal to those of the journal.
    gains = {name: {key: float(value) for key, value in entry.items()} for name, entry in candidates.items()}
    asked = {"ranges": ranges, "seed": seed, "fidelity": fidelity}  # not the runs and candidates, which may be extended
    journal = Journal(store, {**(purpose or {}), "monte_carlo": asked})
    # By runs, then candidates: after an interruption all candidates have the same runs.
    wanted = {name: set(range(runs)) if selected is None else set(selected[name]) for name in gains}
    tasks = {
        f"{name} {run}": (entry, conditions)
        for run, conditions in enumerate(draws)
        for name, entry in gains.items()
        if run in wanted[name]
    }
    for name, entry in gains.items():
        for run in sorted(wanted[name]):
            done = known.get(name, {}).get(draws[run])
            if done is not None and f"{name} {run}" not in journal:
                journal.add(f"{name} {run}", {"gains": entry, **record_of(done)})
    # Only those that the journal lacks need workers.
    missing = sum(key not in journal for key in tasks)
    complete = True
    with open_executor(executor, workers, calls=missing, limit=limit) as (runner, ahead):
        evaluations = Evaluations(
            evaluate, journal, runner, ahead, fidelity=fidelity, total=len(tasks), progress=progress
        )
        try:
            evaluations.make(tasks)
        except KeyboardInterrupt:
            complete = False

    rows: list[dict[str, object]] = []
    columns: dict[str, None] = {}
    # Common random numbers compare candidates run by run, so a run that was interrupted does not count.
    lost = {run for name in gains for run in wanted[name] if f"{name} {run}" not in journal}
    for name in gains:
        # Columns in the order of their first appearance; a dict keeps it.
        for run in sorted(wanted[name] - lost):
            record = journal[f"{name} {run}"]
            figures = record.get("figures") or {}
            columns |= dict.fromkeys(figures)
            # Conditions that are not drawn are nominal and have no column.
            given = {key: value for key, value in draws[run].numbers().items() if key in ranges or key == "seed"}
            outcome = {"status": record["status"], "reason": record.get("reason", "")}
            rows.append({"candidate": name, "run": run, "fidelity": fidelity, **given, **figures, **outcome})
    order = ["candidate", "run", "fidelity", *ranges, "seed", *columns, "status", "reason"]
    return MonteCarlo(pd.DataFrame(rows, columns=order), ranges, runs, seed, complete)


def draw_conditions(ranges: Ranges, *, runs: int, seed: int) -> list[Conditions]:
    """Return the conditions of each run; those that are not drawn are nominal.

    Args:
        ranges: lower and upper end by name of the condition.
        runs: number of runs.
        seed: of the draws.

    Raises:
        ConfigError: no run, an unknown condition, an empty range, or values that are not allowed.
    """
    if runs < 1:
        raise ConfigError(f"runs: {runs} is not allowed; it must be 1 or more")
    for name, (low, high) in ranges.items():
        if name not in DRAWN:
            raise ConfigError(f"robustness.{name}: no such condition; {did_you_mean(name, DRAWN)}")
        if not low < high:
            raise ConfigError(f"robustness.{name}: the range from {low:g} to {high:g} is empty")
        # Scales must be positive, delays and noise not negative.
        if name in ("mass", "friction", "step") and low <= 0.0:
            raise ConfigError(f"robustness.{name}: {low:g} is not allowed; it must be above 0")
        if name in ("delay", "noise") and low < 0.0:
            raise ConfigError(f"robustness.{name}: {low:g} is not allowed; it must be 0 or more")

    # One stream per condition, by its name: adding a condition does not change the draws of the others.
    def stream(name: str) -> np.random.Generator:
        return np.random.default_rng([seed, zlib.crc32(name.encode())])

    columns = {
        name: spread(ParameterSpec(low=low, high=high), stream(name).random(runs))
        for name, (low, high) in ranges.items()
    }
    # Same noise for all candidates of a run.
    seeds = stream("seed").integers(0, 2**31, runs)
    return [
        Conditions(**{name: float(values[run]) for name, values in columns.items()}, seed=int(seeds[run]))
        for run in range(runs)
    ]


def quantiles_of(figure: str, values: NDArray[np.float64], ok: NDArray[np.bool_]) -> Quantiles:
    """Return median, 95th percentile and worst as order statistics: values that so many runs do not exceed.

    Args:
        figure: name.
        values: of each run, shape (n,).
        ok: whether each run counts; one that does not, or is nan, is the worst of all.
    """
    sign = -1.0 if figure in AT_LEAST else 1.0
    sizes = np.abs(values) if figure in SIGNED else sign * values
    ranked = np.sort(np.where(ok & ~np.isnan(sizes), sizes, math.inf))
    places = [math.ceil(share * len(ranked) - 1e-9) - 1 for share in (0.5, 0.95, 1.0)]
    return Quantiles(*(sign * float(ranked[max(place, 0)]) if len(ranked) else math.nan for place in places))


def failure_rate(failures: int, runs: int) -> FailureRate:
    """Return a rate with its exact 95 % interval.

    Args:
        failures: number of failures.
        runs: number of runs, 1 or more.
    """
    if runs < 1:
        return FailureRate(0, 0, math.nan, 0.0, 1.0)
    interval = scipy.stats.binomtest(failures, runs).proportion_ci(0.95, "exact")
    return FailureRate(runs, failures, failures / runs, float(interval.low), float(interval.high))
