"""Search for gains: evaluates many candidates and keeps the result of each in a journal.

The outcome depends on the seed and the evaluations only, not on the number of workers or on interruptions: a resumed
search creates a new sampler with the same seed and reads known results from the journal.
"""

import math
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Protocol

from mirdrake.core.errors import ConfigError, RunError, one_line
from mirdrake.execution.calls import Lost, call_all, open_executor
from mirdrake.execution.journal import Journal, Record
from mirdrake.studies.optimise import Point, make_proposer
from mirdrake.studies.spec import ParameterSpec
from mirdrake.tuning.loops.base import NOMINAL, Conditions, Evaluation, Evaluator, Fidelity
from mirdrake.tuning.spec import AT_LEAST
from mirdrake.tuning.trials import Trial, Trials, make_trial

LIMIT = 600.0
"""Wall time that one evaluation may take in a worker process [s]."""

BATCH = 8
"""Candidates that a sampler proposes before it gets the result of the first of them."""


class TrialProgress(Protocol):
    """Receives the progress of a search."""

    def __call__(self, done: int, total: int, left: float, /) -> None:
        """Receive the numbers of finished and of all evaluations, and the estimated time left [s]."""


def search(
    evaluate: Evaluator,
    space: Mapping[str, ParameterSpec],
    *,
    method: str = "tpe",
    trials: int = 100,
    cost: Mapping[str, float],
    constraints: Mapping[str, float] | None = None,
    fixed: Mapping[str, float] | None = None,
    start: Sequence[Mapping[str, float]] = (),
    seed: int = 0,
    fidelity: Fidelity = "plant",
    executor: Executor | None = None,
    workers: int | None = 0,
    limit: float = LIMIT,
    store: Path | str | None = None,
    purpose: Mapping[str, object] | None = None,
    progress: TrialProgress | None = None,
) -> Trials:
    """Evaluate gains from a space. After Ctrl-C, return the finished trials.

    Args:
        evaluate: tests gains; with workers it can be pickled.
        space: range of each gain, with a count for a grid.
        method: tpe, cma, nsga2 (whose objectives are the figures of the cost), grid, latin_hypercube, sobol or random.
        trials: number of candidates, including those of `start`.
        cost: weight of each figure [1/its unit].
        constraints: limit of each figure [its unit]; see :mod:`mirdrake.tuning.trials`.
        fixed: gains that do not vary.
        start: first candidates, such as those of rules; within the ranges.
        seed: of the random numbers.
        fidelity: reduced or plant.
        executor: makes the evaluations; not shut down.
        workers: processes if there is no executor; 0: this process; None: as many as cores.
        limit: wall time that one evaluation may take in a process of our own [s].
        store: file that keeps every evaluation; a search with the same file resumes there.
        purpose: what the file is for, besides the arguments of the search; a file for another purpose is rejected.
        progress: called after every evaluation.

    Raises:
        ConfigError: unknown method, gain or figure, or a range or number that is not valid.
        RunError: the file belongs to another search, or workers cannot start.
    """
    # All arguments that influence the proposals: a journal of a search with others is rejected.
    limits, kept = dict(constraints or {}), dict(fixed or {})
    _check(space, cost, trials, kept, start)
    asked = {
        "space": {name: entry.model_dump() for name, entry in space.items()},
        "method": method,
        "trials": trials,
        "cost": dict(cost),
        "constraints": limits,
        "fixed": kept,
        "start": [dict(point) for point in start],
        "seed": seed,
        "batch": BATCH,
        "fidelity": fidelity,
    }
    proposer = make_proposer(
        method,
        space,
        trials=trials,
        objectives=len(cost) if method == "nsga2" else 1,
        seed=seed,
        batch=BATCH,
        start=[{name: float(point[name]) for name in space} for point in start],
    )
    # Trials of the journal are not repeated, so fewer workers may be needed.
    journal = Journal(store, {**(purpose or {}), "search": asked})
    left = trials - min(len(journal), trials)
    done: list[Trial] = []
    points: dict[int, Point] = {}
    complete = False
    with open_executor(executor, workers, calls=left, limit=limit) as (runner, ahead):
        evaluations = Evaluations(evaluate, journal, runner, ahead, fidelity=fidelity, total=trials, progress=progress)
        try:
            while len(done) < trials:
                # Batches of a fixed size, whatever the workers: the proposals, and thus the result, do not depend on
                # their number.
                proposed = proposer.ask(min(proposer.batch or trials, trials - len(done)))
                if not proposed:
                    break
                points = {len(done) + index: kept | point for index, point in enumerate(proposed)}
                # In the order of the numbers, not of completion, so that a repeated search gives the same result.
                evaluations.make({str(number): (gains, NOMINAL) for number, gains in points.items()})
                for number, gains in points.items():
                    # NSGA-II has one objective per figure of the cost; other methods their weighted sum. Constraints
                    # count apart.
                    trial = make_trial(number, gains, evaluation_of(journal[number]), cost, limits)
                    proposer.tell(trial.objectives(list(cost)) if method == "nsga2" else [trial.cost], trial.violation)
                    done.append(trial)
            complete = True
        except KeyboardInterrupt:  # finished evaluations of the batch count
            rest = [(number, gains) for number, gains in points.items() if number >= len(done) and number in journal]
            done += [make_trial(number, gains, evaluation_of(journal[number]), cost, limits) for number, gains in rest]
    return Trials(tuple(done), (*kept, *space), dict(cost), limits, method, seed, complete)


class Evaluations:
    """Makes evaluations and keeps the result of each in a journal.

    Args:
        evaluate: tests gains.
        journal: of finished evaluations.
        executor: makes the calls.
        ahead: number of calls that it gets at a time.
        fidelity: of the evaluations.
        total: number of all evaluations, for the progress.
        progress: called after each of them.
    """

    def __init__(
        self,
        evaluate: Evaluator,
        journal: Journal,
        executor: Executor,
        ahead: int,
        *,
        fidelity: Fidelity,
        total: int,
        progress: TrialProgress | None = None,
    ) -> None:
        self._evaluate, self._journal, self._executor, self._ahead = evaluate, journal, executor, ahead
        self._fidelity, self._total, self._progress = fidelity, total, progress
        self._done = self._made = 0
        self._began = time.monotonic()

    def make(self, tasks: Mapping[str, tuple[Point, Conditions]]) -> None:
        """Make those evaluations that the journal does not have.

        Args:
            tasks: gains and conditions by the key in the journal.

        Raises:
            RunError: the journal has other gains under a key.
        """
        missing = []
        for key, (gains, conditions) in tasks.items():
            # Resume: only evaluations that are not in the journal; gains under a known key must agree.
            if key not in self._journal:
                missing.append((key, gains, conditions))
            elif self._journal[key].get("gains") != gains:
                raise RunError(f"{self._journal.file}: has other gains for trial {key}; choose another file")
        # Resumed evaluations count as done, but not in the mean time per evaluation.
        self._done += len(tasks) - len(missing)
        calls = ((self._evaluate, gains, conditions, self._fidelity) for _, gains, conditions in missing)
        for index, given in call_all(self._executor, evaluate_record, calls, ahead=self._ahead):
            key, gains, _ = missing[index]
            # A worker that was killed or exceeded its time is a failed evaluation, not the end of the search.
            record = {"status": "failed", "reason": given.reason} if isinstance(given, Lost) else given
            self._journal.add(key, {"gains": gains, **record})
            self._done += 1
            self._made += 1
            if self._progress is not None:
                each = (time.monotonic() - self._began) / self._made
                self._progress(self._done, self._total, each * (self._total - self._done))


def evaluate_record(evaluate: Evaluator, gains: Point, conditions: Conditions, fidelity: Fidelity) -> Record:
    """Evaluate gains, in any process; return status, reason and figures as a record of a journal."""
    try:
        return record_of(evaluate(gains, conditions, fidelity))
    except Exception as error:
        return {"status": "failed", "reason": one_line(error)}


def record_of(result: Evaluation) -> Record:
    """Return status, reason and figures of an evaluation as a record of a journal."""
    figures = {name: float(value) for name, value in result.figures.items()} if result.status == "ok" else {}
    return {"status": result.status, "reason": result.reason, "figures": figures}


def evaluation_of(record: Record) -> Evaluation:
    """Return the evaluation in a record of a journal."""
    return Evaluation(record["status"], dict(record.get("figures") or {}), reason=str(record.get("reason", "")))


def _check(
    space: Mapping[str, ParameterSpec],
    cost: Mapping[str, float],
    trials: int,
    fixed: Mapping[str, float],
    start: Sequence[Mapping[str, float]],
) -> None:
    """Reject arguments that are not valid."""
    # All arguments are checked before the first simulation, which may take minutes.
    if not space:
        raise ConfigError("space: no gain has a range; give one for at least one gain")
    if trials < 1:
        raise ConfigError(f"trials: {trials} is not allowed; it must be 1 or more")
    if not any(cost.values()):
        raise ConfigError("cost: no figure has a weight; give one, for example {iae: 1}")
    for name, weight in cost.items():
        if not (math.isfinite(weight) and weight >= 0.0):
            raise ConfigError(f"cost.{name}: {weight:g} is not allowed; a weight is 0 or more")
        if name in AT_LEAST:
            raise ConfigError(f"cost.{name}: a larger value is better; make it a constraint, or use ms or mt")
    # A gain either varies or is fixed.
    both = sorted(set(space) & set(fixed))
    if both:
        raise ConfigError(f"fixed.{both[0]}: has a range as well; remove one of them")
    if len(start) > trials:
        raise ConfigError(f"start: {len(start)} candidates are more than the {trials} trials")
    for index, point in enumerate(start):
        for name, entry in space.items():
            if name not in point:
                raise ConfigError(f"start.{index}: {name} is missing")
            # Explicit values may be in any order.
            low, high = min(entry.ends()), max(entry.ends())
            if not low <= point[name] <= high:
                raise ConfigError(f"start.{index}.{name}: {point[name]:g} is outside its range, {low:g} to {high:g}")
