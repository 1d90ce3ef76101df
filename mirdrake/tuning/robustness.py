"""Monte Carlo: candidates under conditions that are drawn, the same for each of them (common random numbers).

Each condition has a random stream of its own, made of the seed and its name. So run i has the same conditions whatever
the candidate, the number of runs and workers, and the other conditions that are drawn. Draws are independent, not
stratified: then failures are binomial, and their rate has the exact interval of C. J. Clopper and E. S. Pearson,
Biometrika 26 (1934) 404.

A run that is unstable or failed counts as worse than every other in the statistics of the figures.
"""

import math
import zlib
from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import scipy  # which imports its parts when they are first named

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.execution.calls import open_executor
from mirdrake.execution.journal import Journal
from mirdrake.studies.sampling import spread
from mirdrake.studies.spec import ParameterSpec
from mirdrake.tuning.loops.base import Conditions, Evaluator
from mirdrake.tuning.search import LIMIT, Evaluations, TrialProgress, read_space
from mirdrake.tuning.spec import AT_LEAST

DRAWN = tuple(field.name for field in fields(Conditions) if field.name != "seed")
"""Conditions that can be drawn."""

SIGNED = frozenset({"steady_error"})
"""Figures of which the size counts, not the sign."""


@dataclass(frozen=True)
class Spread:
    """A figure over the runs, from good to bad; inf (-inf where more is better) if that many runs are not ok.

    Attributes:
        median: half of the runs are not worse.
        p95: 95 % of the runs are not worse.
        worst: of all runs.
    """

    median: float
    p95: float
    worst: float


@dataclass(frozen=True)
class Failures:
    """How often a candidate is not ok.

    Attributes:
        runs: number of runs.
        failures: those unstable or failed.
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
class Robustness:
    """What a Monte Carlo gave.

    Attributes:
        table: a row a run of a candidate: candidate, run, the drawn conditions, noise seed, figures, status, reason.
        ranges: of each condition, as plain data.
        runs: number of runs a candidate.
        seed: of the draws.
        complete: whether all runs were made; not if Ctrl-C came before.
    """

    table: pd.DataFrame
    ranges: dict[str, Any]
    runs: int
    seed: int
    complete: bool = True

    @property
    def candidates(self) -> list[str]:
        """Names, in the order given."""
        return list(dict.fromkeys(self.table["candidate"]))

    @cached_property
    def figures(self) -> list[str]:
        """Names of the figures."""
        columns = list(self.table.columns)
        return columns[columns.index("seed") + 1 : columns.index("status")]

    def spread(self, candidate: str, figure: str) -> Spread:
        """Median, 95th percentile and worst of a figure.

        Raises:
            ConfigError: no such candidate or figure.
        """
        rows = self._rows(candidate)
        if figure not in self.figures:
            raise ConfigError(f"no figure is called '{figure}'; {did_you_mean(figure, self.figures)}")
        return spread_of(figure, rows[figure].to_numpy(dtype=float), (rows["status"] == "ok").to_numpy())

    def failures(self, candidate: str) -> Failures:
        """How often it is unstable or failed.

        Raises:
            ConfigError: no such candidate.
        """
        rows = self._rows(candidate)
        return failure_rate(int((rows["status"] != "ok").sum()), len(rows))

    def data(self) -> dict[str, Any]:
        """Runs, ranges, and per candidate its figures and failures, as plain data; None for what is not finite."""
        candidates = {}
        for name in self.candidates:
            found = self.failures(name)
            spreads = {figure: asdict(self.spread(name, figure)) for figure in self.figures}
            candidates[name] = {
                "figures": {figure: {k: _finite(v) for k, v in entry.items()} for figure, entry in spreads.items()},
                "failures": found.failures,
                "failure_rate": found.rate,
                "low": found.low,
                "high": found.high,
            }
        return {"runs": self.runs, "ranges": self.ranges, "seed": self.seed, "candidates": candidates}

    def _rows(self, candidate: str) -> pd.DataFrame:
        if candidate not in self.candidates:
            raise ConfigError(f"no candidate is called '{candidate}'; {did_you_mean(candidate, self.candidates)}")
        return self.table[self.table["candidate"] == candidate]


def monte_carlo(
    evaluate: Evaluator,
    candidates: Mapping[str, Mapping[str, float]],
    ranges: Mapping[str, Any],
    *,
    runs: int = 100,
    seed: int = 0,
    fidelity: str | None = None,
    executor: Executor | None = None,
    workers: int | None = 0,
    limit: float = LIMIT,
    store: Path | str | None = None,
    purpose: Mapping[str, Any] | None = None,
    progress: TrialProgress | None = None,
) -> Robustness:
    """Try candidates under drawn conditions. Ctrl-C gives the runs that every candidate has done.

    Args:
        evaluate: tries gains under conditions; with workers it can be pickled.
        candidates: gains by name of the candidate.
        ranges: of the conditions (mass, friction, delay, grade, noise): ``{"low": ..., "high": ...}``, or two numbers.
        runs: number of runs a candidate.
        seed: of the draws; the noise of run i has a seed of its own, the same for every candidate.
        fidelity: reduced or plant; that of `evaluate` if left out.
        executor: see :func:`mirdrake.tuning.search.search`, as are the others.
        workers: see there.
        limit: see there.
        store: see there.
        purpose: see there.
        progress: see there.

    Raises:
        ConfigError: no candidate, an unknown condition or an empty range.
        RunError: the journal belongs to something else, or workers cannot start.
    """
    spreads = read_ranges(ranges)
    if not candidates:
        raise ConfigError("candidates: none is given; name at least one set of gains")
    draws = draw_conditions(spreads, runs=runs, seed=seed)
    told = {name: {key: value for key, value in spec.model_dump().items() if value is not None}
            for name, spec in spreads.items()}  # fmt: skip
    gains = {name: {key: float(value) for key, value in entry.items()} for name, entry in candidates.items()}
    asked = {"ranges": told, "seed": seed, "fidelity": fidelity}  # more runs or candidates may follow
    journal = Journal(store, {**(purpose or {}), "monte_carlo": asked})
    options = {} if fidelity is None else {"fidelity": fidelity}
    tasks = {
        f"{name} {run}": (entry, {"conditions": conditions, **options})
        for run, conditions in enumerate(draws)
        for name, entry in gains.items()
    }
    missing = sum(key not in journal for key in tasks)
    complete = True
    with open_executor(executor, workers, calls=missing, limit=limit) as (runner, ahead):
        evaluations = Evaluations(evaluate, journal, runner, ahead, total=len(tasks), progress=progress)
        try:
            evaluations.make(tasks)
        except KeyboardInterrupt:
            complete = False
    done = [run for run in range(runs) if all(f"{name} {run}" in journal for name in gains)]
    rows: list[dict[str, Any]] = []
    columns: dict[str, None] = {}
    for name in gains:
        for run in done:
            record = journal[f"{name} {run}"]
            columns |= dict.fromkeys(record.get("figures") or {})
            given = {key: value for key, value in draws[run].data().items() if key in spreads or key == "seed"}
            rows.append({"candidate": name, "run": run, **given, **(record.get("figures") or {})}
                        | {"status": record["status"], "reason": record.get("reason", "")})  # fmt: skip
    order = ["candidate", "run", *spreads, "seed", *columns, "status", "reason"]
    return Robustness(pd.DataFrame(rows, columns=order), told, runs, seed, complete)


def read_ranges(ranges: Mapping[str, Any]) -> dict[str, ParameterSpec]:
    """Ranges of conditions, checked.

    Raises:
        ConfigError: an unknown condition, an empty range, or values that are not allowed.
    """
    pairs = {}
    for name, entry in ranges.items():
        if name not in DRAWN:
            raise ConfigError(f"robustness.{name}: no such condition; {did_you_mean(name, DRAWN)}")
        if isinstance(entry, list | tuple):
            if len(entry) != 2:
                raise ConfigError(f"robustness.{name}: two numbers are needed, low and high, got {len(entry)}")
            entry = {"low": entry[0], "high": entry[1]}
        pairs[name] = entry
    spreads = read_space(pairs)
    for name, spec in spreads.items():
        least = min(spec.ends())
        if name in ("mass", "friction") and least <= 0.0:
            raise ConfigError(f"robustness.{name}: {least:g} is not allowed; it must be above 0")
        if name in ("delay", "noise") and least < 0.0:
            raise ConfigError(f"robustness.{name}: {least:g} is not allowed; it must be 0 or more")
    return spreads


def draw_conditions(ranges: Mapping[str, ParameterSpec], *, runs: int, seed: int) -> list[Conditions]:
    """Conditions of each run; what is not drawn is nominal.

    Args:
        ranges: by name of the condition.
        runs: number of runs.
        seed: of the draws.

    Raises:
        ConfigError: no run.
    """
    if runs < 1:
        raise ConfigError(f"runs: {runs} is not allowed; it must be 1 or more")

    def stream(name: str) -> np.random.Generator:
        return np.random.default_rng([seed, zlib.crc32(name.encode())])

    columns = {name: spread(spec, stream(name).random(runs)) for name, spec in ranges.items()}
    seeds = stream("seed").integers(0, 2**31, runs)
    return [
        Conditions(**{name: float(values[run]) for name, values in columns.items()}, seed=int(seeds[run]))
        for run in range(runs)
    ]


def spread_of(figure: str, values: "np.ndarray[Any, Any]", ok: "np.ndarray[Any, Any]") -> Spread:
    """Median, 95th percentile and worst: order statistics, the smallest that so many runs are not worse than.

    Args:
        figure: name.
        values: of each run, shape (n,).
        ok: whether each run counts; one that does not, or is nan, is the worst of all.
    """
    sign = -1.0 if figure in AT_LEAST else 1.0
    sizes = np.abs(values) if figure in SIGNED else sign * values
    bad = np.sort(np.where(ok & ~np.isnan(sizes), sizes, math.inf))
    at = [math.ceil(part * len(bad) - 1e-9) - 1 for part in (0.5, 0.95, 1.0)]
    return Spread(*(sign * float(bad[max(k, 0)]) if len(bad) else math.nan for k in at))


def failure_rate(failures: int, runs: int) -> Failures:
    """A rate with its exact 95 % interval.

    Args:
        failures: number of failures.
        runs: number of runs, 1 or more.
    """
    if runs < 1:
        return Failures(0, 0, math.nan, 0.0, 1.0)
    interval = scipy.stats.binomtest(failures, runs).proportion_ci(0.95, "exact")
    return Failures(runs, failures, failures / runs, float(interval.low), float(interval.high))


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
