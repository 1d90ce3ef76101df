"""Search for gains: try many, and keep what each of them gave.

The outcome depends on the seed and the evaluations only: neither on the number of workers, nor on how often the search
was killed and resumed. A resumed search asks a fresh sampler of the same seed and takes known answers from the journal.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from mirdrake.core.errors import ConfigError, RunError
from mirdrake.core.yaml_io import Source, validate
from mirdrake.execution.calls import Lost, call_all, open_executor
from mirdrake.execution.job import one_line
from mirdrake.execution.journal import Journal, Record
from mirdrake.studies.optimise import Point, make_proposer
from mirdrake.studies.spec import ParameterSpec
from mirdrake.tuning.loops.base import Evaluation, Evaluator
from mirdrake.tuning.spec import AT_LEAST
from mirdrake.tuning.trials import Trial, Trials, judge

LIMIT = 600.0
"""Wall time that one evaluation may take in a worker process [s]."""

BATCH = 8
"""Candidates that a sampler proposes before it learns what the first of them gave."""

TrialProgress = Callable[[int, int, float], None]
"""Called with the number of trials done, of all trials, and the time left [s]."""


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
        constraints: limit of each figure [its unit]; see :mod:`mirdrake.tuning.trials`.
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
                    proposer.tell(trial.values(list(cost)) if method == "nsga2" else [trial.cost], trial.violation)
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
        if name in AT_LEAST:
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
