"""Search for gains: try many, keep what each of them gave, and say which is best and what it costs.

A *cost* is a weighted sum of figures. A *constraint* bounds a figure from above, or from below where more of it is
better (:data:`MORE_IS_BETTER`). A candidate that is unstable, failed, breaks a constraint or has a cost that is not
finite is never best; the sampler is told a finite violation instead, the worst for one that is unstable.

The outcome depends on the seed and the evaluations only: neither on the number of workers, nor on how often the search
was killed and resumed. A resumed search asks a fresh sampler of the same seed and takes known answers from the journal.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mirdrake.errors import ConfigError, RunError, did_you_mean
from mirdrake.studies.calls import Lost, call_all, open_executor
from mirdrake.studies.fronts import find_knee, pareto_front
from mirdrake.studies.job import one_line
from mirdrake.studies.journal import Journal, Record
from mirdrake.studies.optimise import Point, make_proposer
from mirdrake.studies.spec import ParameterSpec
from mirdrake.tuning.loops.base import Evaluation, Evaluator
from mirdrake.yaml_io import Source, validate

MORE_IS_BETTER = frozenset({"gain_margin", "phase_margin_deg", "delay_margin_s", "disk_margin"})
"""Figures that a constraint bounds from below."""

BROKEN, UNSTABLE = 1e9, 1e12
"""Violation of a constraint on a figure that is not finite, and that of an unstable or failed candidate [1]."""

LIMIT = 600.0
"""Wall time that one evaluation may take in a worker process [s]."""

BATCH = 8
"""Candidates that a sampler proposes before it learns what the first of them gave."""

TrialProgress = Callable[[int, int, float], None]
"""Called with the number of trials done, of all trials, and the time left [s]."""


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
            | {"cost": trial.cost, "violation": trial.violation, "feasible": trial.feasible}
            | {"status": trial.status, "reason": trial.reason}
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
        feasible = [trial for trial in self.trials if trial.feasible and np.isfinite(_values(trial, names)).all()]
        kept = pareto_front(np.array([_values(trial, names) for trial in feasible]).reshape(-1, len(names)))
        return tuple(sorted((feasible[k] for k in kept), key=lambda trial: (*_values(trial, names), trial.number)))

    def knee(self, figures: Sequence[str] | None = None) -> Trial | None:
        """The knee of the front, see :func:`find_knee`; None without a front."""
        front = self.front(figures)
        if not front:
            return None
        names = self._named(figures)
        return front[find_knee(np.array([_values(trial, names) for trial in front]))]

    def _named(self, figures: Sequence[str] | None) -> list[str]:
        return list(self.cost if figures is None else figures)


def search(
    evaluate: Evaluator,
    space: Mapping[str, Any],
    *,
    method: str = "tpe",
    trials: int = 100,
    cost: Mapping[str, float],
    constraints: Mapping[str, float] | None = None,
    fixed: Mapping[str, float] | None = None,
    start: Sequence[Mapping[str, float]] = (),
    seed: int = 0,
    executor: Executor | None = None,
    workers: int | None = 0,
    batch: int = BATCH,
    limit: float = LIMIT,
    store: Path | str | None = None,
    purpose: Mapping[str, Any] | None = None,
    progress: TrialProgress | None = None,
    options: Mapping[str, Any] | None = None,
) -> Trials:
    """Try gains from a space. Ctrl-C gives the trials that are done.

    Args:
        evaluate: tries gains; with workers it can be pickled.
        space: range of each gain, ``{"low": ..., "high": ..., "scale": "linear" | "log"}``, with a count for a grid.
        method: tpe, cma, nsga2 (its objectives are the figures of the cost, one by one), grid, latin_hypercube, sobol
            or random.
        trials: number of candidates, those of `start` with them.
        cost: weight of each figure [1/its unit].
        constraints: limit of each figure [its unit]; see the head of the module.
        fixed: gains that do not vary.
        start: candidates to begin with, as the baseline or that of a rule; within the ranges.
        seed: of what is drawn.
        executor: evaluates; not shut down.
        workers: processes if there is no executor; 0: this process; None: as many as cores.
        batch: see :data:`BATCH`; a part of what decides on the outcome, so do not take it from the number of workers.
        limit: wall time of an evaluation [s].
        store: journal of finished trials; if it is there, the search goes on from it.
        purpose: what else must be the same for that: plain data, for example the digest of the loop.
        progress: called after each trial.
        options: further arguments of `evaluate`: conditions, fidelity.

    Raises:
        ConfigError: an empty range, no such method or figure, or a start outside the ranges.
        MissingDependencyError: the method needs Optuna, which is not installed.
        RunError: the journal belongs to another search, or workers cannot start.
    """
    ranges, limits, kept = read_space(space), dict(constraints or {}), dict(fixed or {})
    _check(ranges, cost, trials, batch, kept, start)
    asked = {
        "space": {name: entry.model_dump() for name, entry in ranges.items()},
        "method": method,
        "trials": trials,
        "cost": dict(cost),
        "constraints": limits,
        "fixed": kept,
        "start": [dict(point) for point in start],
        "seed": seed,
        "batch": batch,
        "options": repr(dict(options or {})),
    }
    proposer = make_proposer(
        method,
        ranges,
        trials=trials,
        objectives=len(cost) if method == "nsga2" else 1,
        seed=seed,
        batch=batch,
        start=[{name: float(point[name]) for name in ranges} for point in start],
    )
    journal = Journal(store, {**(purpose or {}), "search": asked})
    left = trials - min(len(journal), trials)
    done: list[Trial] = []
    tasks: dict[int, tuple[Point, dict[str, Any]]] = {}
    complete = False
    with open_executor(executor, workers, calls=left, limit=limit) as (runner, ahead):
        evaluations = Evaluations(evaluate, journal, runner, ahead, total=trials, progress=progress)
        try:
            while len(done) < trials:
                points = proposer.ask(min(proposer.batch or trials, trials - len(done)))
                if not points:
                    break
                tasks = {len(done) + at: (kept | point, dict(options or {})) for at, point in enumerate(points)}
                evaluations.make(tasks)
                for number, (gains, _) in tasks.items():
                    trial = judge(number, gains, journal[number], cost, limits)
                    proposer.tell(_values(trial, list(cost)) if method == "nsga2" else [trial.cost], trial.violation)
                    done.append(trial)
            complete = True
        except KeyboardInterrupt:  # what is done counts
            rest = [(number, gains) for number, (gains, _) in tasks.items() if number >= len(done)]
            done += [judge(n, gains, journal[n], cost, limits) for n, gains in rest if n in journal]
    return Trials(tuple(done), (*kept, *ranges), dict(cost), limits, method, seed, complete)


class Evaluations:
    """Makes evaluations, and keeps what each of them gave in a journal.

    Args:
        evaluate: tries gains.
        journal: of what is known.
        executor: makes the calls.
        ahead: calls handed to it at a time.
        total: number of all evaluations, for the progress.
        progress: called after each of them.
    """

    def __init__(
        self,
        evaluate: Callable[..., Evaluation],
        journal: Journal,
        executor: Executor,
        ahead: int,
        *,
        total: int,
        progress: TrialProgress | None = None,
    ) -> None:
        self._evaluate, self._journal, self._executor, self._ahead = evaluate, journal, executor, ahead
        self._total, self._progress = total, progress
        self._done = self._made = 0
        self._began = time.monotonic()

    def make(self, tasks: Mapping[Any, tuple[Mapping[str, float], Mapping[str, Any]]]) -> None:
        """Make those that the journal does not know.

        Args:
            tasks: gains, and further arguments of `evaluate`, by the key in the journal.

        Raises:
            RunError: the journal has other gains under a key.
        """
        missing = []
        for key, (gains, options) in tasks.items():
            if key not in self._journal:
                missing.append((key, dict(gains), dict(options)))
            elif self._journal[key].get("gains") != dict(gains):
                raise RunError(f"{self._journal.file}: has other gains for trial {key}; choose another file")
        self._done += len(tasks) - len(missing)
        calls = ((self._evaluate, gains, options) for _, gains, options in missing)
        for at, given in call_all(self._executor, try_gains, calls, ahead=self._ahead):
            key, gains, _ = missing[at]
            record = {"status": "failed", "reason": given.reason} if isinstance(given, Lost) else given
            self._journal.add(key, {"gains": gains, **record})
            self._done += 1
            self._made += 1
            if self._progress is not None:
                each = (time.monotonic() - self._began) / self._made
                self._progress(self._done, self._total, each * (self._total - self._done))


def try_gains(evaluate: Callable[..., Evaluation], gains: Mapping[str, float], options: Mapping[str, Any]) -> Record:
    """Evaluate, in whatever process; what it gives as plain data, without the response."""
    try:
        given = evaluate(gains, **options)
    except Exception as error:
        return {"status": "failed", "reason": one_line(error)}
    figures = {name: float(value) for name, value in given.figures.items()} if given.status == "ok" else {}
    return {"status": given.status, "reason": given.reason, "figures": figures}


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


@dataclass(frozen=True)
class GainMap:
    """Cost and stability over two gains.

    Attributes:
        table: columns: the two gains, cost (inf where it is not finite), ms (nan if unknown), stable, feasible; a row a
            point, the second gain varies fastest.
        gains: names of the two.
        edge: points between a stable and an unstable neighbour, halfway on the scale of the axis, shape (n, 2).
    """

    table: pd.DataFrame
    gains: tuple[str, str]
    edge: NDArray[np.float64]


def map_of_two_gains(
    evaluate: Evaluator,
    space: Mapping[str, Any],
    *,
    cost: Mapping[str, float],
    constraints: Mapping[str, float] | None = None,
    count: int = 15,
    **more: Any,
) -> GainMap:
    """Cost, Ms and stability on a grid of two gains.

    Args:
        evaluate: tries gains.
        space: range of each of the two, see :func:`search`.
        cost: see :func:`search`.
        constraints: see :func:`search`.
        count: values of a range that does not say so itself.
        more: further arguments of :func:`search`: fixed, workers, store, options and so on.

    Raises:
        ConfigError: not two gains, and as :func:`search`.
    """
    ranges = {
        name: entry if entry.values or entry.count else entry.model_copy(update={"count": count})
        for name, entry in read_space(space).items()
    }
    if len(ranges) != 2:
        raise ConfigError(f"a map needs two gains, got {len(ranges)}: {', '.join(ranges) or 'none'}")
    sizes = [len(entry.values) if entry.values else entry.count or 0 for entry in ranges.values()]
    found = search(evaluate, ranges, method="grid", trials=math.prod(sizes), cost=cost, constraints=constraints, **more)
    first, second = ranges
    table = pd.DataFrame(
        {
            first: [trial.gains[first] for trial in found.trials],
            second: [trial.gains[second] for trial in found.trials],
            "cost": [trial.cost for trial in found.trials],
            "ms": [trial.figures.get("ms", math.nan) for trial in found.trials],
            "stable": [trial.status == "ok" for trial in found.trials],
            "feasible": [trial.feasible for trial in found.trials],
        }
    )
    scales = [entry.scale for entry in ranges.values()]
    return GainMap(table, (first, second), _edge(table, (first, second), sizes, scales, found.complete))


def read_space(space: Mapping[str, Any]) -> dict[str, ParameterSpec]:
    """Ranges of gains, checked.

    Raises:
        ConfigError: none, or an empty one.
    """
    if not space:
        raise ConfigError("space: no gain has a range; give one for at least one gain")
    ranges = {}
    for name, entry in space.items():
        if isinstance(entry, ParameterSpec):
            ranges[name] = entry
            continue
        data = dict(entry) if isinstance(entry, Mapping) else entry.model_dump(exclude_unset=True)
        ranges[name] = validate(data, ParameterSpec, Source(f"range of {name}", {}))
    return ranges


def _check(
    ranges: Mapping[str, ParameterSpec],
    cost: Mapping[str, float],
    trials: int,
    batch: int,
    fixed: Mapping[str, float],
    start: Sequence[Mapping[str, float]],
) -> None:
    if trials < 1 or batch < 1:
        raise ConfigError(f"trials and batch must be 1 or more, got {trials} and {batch}")
    if not any(cost.values()):
        raise ConfigError("cost: no figure has a weight; give one, for example {iae: 1}")
    for name, weight in cost.items():
        if not (math.isfinite(weight) and weight >= 0.0):
            raise ConfigError(f"cost.{name}: {weight:g} is not allowed; a weight is 0 or more")
        if name in MORE_IS_BETTER:
            raise ConfigError(f"cost.{name}: more of it is better; make it a constraint, or take ms or mt")
    both = sorted(set(ranges) & set(fixed))
    if both:
        raise ConfigError(f"fixed.{both[0]}: has a range as well; leave out one of them")
    if len(start) > trials:
        raise ConfigError(f"start: {len(start)} candidates are more than the {trials} trials")
    for at, point in enumerate(start):
        for name, entry in ranges.items():
            if name not in point:
                raise ConfigError(f"start.{at}: {name} is missing")
            low, high = min(entry.ends()), max(entry.ends())
            if not low <= point[name] <= high:
                raise ConfigError(f"start.{at}.{name}: {point[name]:g} is outside its range, {low:g} to {high:g}")


def _excess(name: str, value: float, limit: float) -> float:
    """By how much a figure breaks its limit, in parts of the limit."""
    over = limit - value if name in MORE_IS_BETTER else value - limit
    if math.isnan(over):
        return BROKEN
    return min(max(over, 0.0) / (abs(limit) or 1.0), BROKEN)


def _values(trial: Trial, names: Sequence[str]) -> list[float]:
    """Figures to be made small."""
    signs = [-1.0 if name in MORE_IS_BETTER else 1.0 for name in names]
    return [sign * trial.figures.get(name, math.nan) for sign, name in zip(signs, names, strict=True)]


def _edge(
    table: pd.DataFrame, gains: tuple[str, str], sizes: Sequence[int], scales: Sequence[str], complete: bool
) -> NDArray[np.float64]:
    if not complete:
        return np.zeros((0, 2))
    stable = table["stable"].to_numpy(dtype=bool).reshape(sizes)
    x, y = (table[name].to_numpy(dtype=float).reshape(sizes) for name in gains)
    points = []
    for along, (values, scale) in enumerate(zip((x, y), scales, strict=True)):
        near, far = (np.take(stable, part, axis=along) for part in (range(sizes[along] - 1), range(1, sizes[along])))
        for i, j in np.argwhere(near != far):
            other = (i + 1, j) if along == 0 else (i, j + 1)
            a, b = float(values[i, j]), float(values[other])
            middle = math.sqrt(a * b) if scale == "log" else 0.5 * (a + b)
            points.append((middle, float(y[i, j])) if along == 0 else (float(x[i, j]), middle))
    return np.array(points, dtype=float).reshape(-1, 2)
