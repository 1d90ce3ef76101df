"""Search for the parameter values for which a case has the smallest margin.

Half of the budget goes to a Halton sequence (J. H. Halton 1960) over the ranges, shifted by a random vector; the other
half to the simplex search of J. A. Nelder and R. Mead (1965) from the worst point found, and when that converges, from
the next one. The objective is the smallest margin of the requirements, each as its quantile among those of the first
half, so that metres and seconds can be compared: see :class:`mirdrake.suites.quantiles.Quantiles`. The same seed tries
the same points, on any number of workers.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy  # it imports its parts when they are first used
from numpy.typing import NDArray

from mirdrake.core.errors import ConfigError
from mirdrake.suites.cases import Case, Result, Values, vary
from mirdrake.suites.quantiles import Quantiles
from mirdrake.suites.worker import RunCases, open_case_workers

Array = NDArray[np.float64]
Range = tuple[float, float]

SIMPLEX = 0.12
"""Edges of the first simplex, as a share of the ranges."""

DIGITS = 6
"""Significant digits of the values tried, so that the reported values are exactly those that were run."""


@dataclass(frozen=True)
class Trial:
    """A point of a search and its result; the shares of its findings are quantiles."""

    values: Values
    result: Result

    @property
    def margin(self) -> float:
        """Margin of the worst requirement in its unit; infinite if there is none, or it could not be judged."""
        return self.result.margin

    @property
    def share(self) -> float:
        """The quantile of that margin, negative for a failure [-]."""
        return self.result.share


@dataclass(frozen=True)
class SearchResult:
    """The result of a search.

    Attributes:
        case: the case that was varied.
        tried: the trials in their order.
        interrupted: whether Ctrl-C ended the search.
    """

    case: Case
    tried: tuple[Trial, ...]
    interrupted: bool = False

    @property
    def worst(self) -> Trial | None:
        """The judged trial with the smallest share."""
        judged = [trial for trial in self.tried if trial.result.findings]
        return min(judged, key=lambda trial: trial.share, default=None)

    @property
    def failures(self) -> list[Trial]:
        """The trials in which a requirement failed."""
        return [trial for trial in self.tried if trial.result.verdict == "fail"]

    def ranked(self) -> list[Trial]:
        """Return the trials, the worst first: failures, errors, passes, invalid worlds; each by the smallest share."""
        order = ("fail", "error", "pass", "invalid")
        return sorted(self.tried, key=lambda trial: (order.index(trial.result.verdict), trial.share))

    def replay(self, trial: Trial) -> Case:
        """Return the case of a trial."""
        return vary(self.case, trial.values)


class _Spent(Exception):  # noqa: N818 - not an error
    """The budget is used up."""


def search(
    case: Case,
    over: Mapping[str, Range],
    budget: int,
    *,
    seed: int = 0,
    workers: int = 1,
    timeout: float | None = None,
    progress: Callable[[int, int, Trial], None] | None = None,
) -> SearchResult:
    """Search for the values with the smallest margin.

    Args:
        case: the case to vary; its other values are kept.
        over: range of each parameter; `seed` may be one of them, its values are integers.
        budget: number of runs.
        seed: seed of the points tried.
        workers: number of processes for the first half; the simplex search uses one.
        timeout: wall time that a run may take [s]; see :func:`mirdrake.suites.worker.time_limit`.
        progress: called with the number of finished runs, the budget and the latest trial.

    Raises:
        ConfigError: a range is empty, or there is nothing to search.
    """
    # Faults of the request are reported before any process is started.
    for name, (low, high) in over.items():
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise ConfigError(f"search.over.{name}: [{low:g}, {high:g}] is not a range; give [low, high]")
    if not over or budget < 1:
        raise ConfigError("search: give at least one parameter under over, and a budget of at least one run")
    seeker = _Seeker(case, dict(over), budget, progress)

    # At least two points per parameter, else there is no spread to start a simplex from; never more than the budget.
    first = min(budget, max(budget // 2, 2 * len(over)))
    with open_case_workers(workers, cases=budget, timeout=timeout) as run_cases:
        try:
            points = _halton(len(over), first, seed)
            seeker.evaluate(run_cases, points)
            seeker.quantiles = Quantiles(trial.result for trial in seeker.tried.values())

            # Clipped, because only points of the unit cube have values within the ranges.
            def margin(point: Array) -> float:
                seeker.evaluate(run_cases, np.clip(point, 0.0, 1.0)[None])
                return seeker.objective(np.clip(point, 0.0, 1.0))

            # The simplex search is local: when it has converged with budget left, it starts from the next point.
            for corner in sorted(points, key=seeker.objective):
                edges = [corner + SIMPLEX * _inward(corner, axis) for axis in range(len(over))]
                # Points already run cost no budget, so the limit of evaluations is far above it.
                options = {"initial_simplex": [corner, *edges], "maxfev": 50 * budget, "xatol": 1e-3, "fatol": 1e-6}
                scipy.optimize.minimize(
                    margin, corner, method="Nelder-Mead", bounds=[(0.0, 1.0)] * len(over), options=options
                )
        except _Spent:
            pass
        except KeyboardInterrupt:  # the finished trials are kept
            return SearchResult(case, seeker.trials(), interrupted=True)
    return SearchResult(case, seeker.trials())


def _halton(dimensions: int, count: int, seed: int) -> Array:
    """Return points in the unit cube (count, dimensions): a Halton sequence with a random shift."""
    points = scipy.stats.qmc.Halton(dimensions, scramble=False).random(count)
    # A random shift modulo 1 (Cranley-Patterson) keeps the even spacing of the sequence, but not its fixed origin.
    return np.asarray((points + np.random.default_rng(seed).random(dimensions)) % 1.0)


def _inward(point: Array, axis: int) -> Array:
    """Return a unit vector along an axis, towards the farther end of the range."""
    step = np.zeros(len(point))
    step[axis] = 1.0 if point[axis] < 0.5 else -1.0
    return step


class _Seeker:
    """Evaluation of points of the unit cube, each once, until the budget is spent."""

    def __init__(
        self, case: Case, over: dict[str, Range], budget: int, progress: Callable[[int, int, Trial], None] | None
    ) -> None:
        self._case, self._over, self._budget, self._progress = case, over, budget, progress
        self.tried: dict[tuple[float, ...], Trial] = {}
        self.quantiles: Quantiles | None = None  # known after the first points

    def trials(self) -> tuple[Trial, ...]:
        """Return the trials in their order, with quantiles as shares."""
        quantiles = self.quantiles or Quantiles(trial.result for trial in self.tried.values())
        return tuple(replace(trial, result=quantiles.rescore(trial.result)) for trial in self.tried.values())

    def values(self, point: Array) -> dict[str, float]:
        """Return the values of the parameters at a point."""
        point_values: dict[str, float] = {}
        for share, (name, (low, high)) in zip(point, self._over.items(), strict=True):
            value = low + float(share) * (high - low)
            # Rounded before the run: what is reported and repeated is what was simulated.
            point_values[name] = round(value) if name == "seed" else float(f"{value:.{DIGITS}g}")
        return point_values

    def objective(self, point: Array) -> float:
        """Return the smallest share at a point that was run; a large number if there is none."""
        result = self.tried[tuple(self.values(point).values())].result
        assert self.quantiles is not None
        share = self.quantiles.rescore(result).share
        # A run that could not be judged has no information about the margin. Its value is large, to repel the search.
        return share if math.isfinite(share) else 1e9

    def evaluate(self, run_cases: RunCases, points: Array) -> None:
        """Run the points that have not been run yet.

        Raises:
            _Spent: the budget is used up.
        """
        # Duplicates within the batch are removed as well: rounding, and integer seeds, map near points to the same run.
        new = {tuple(point_values.values()): point_values for point_values in map(self.values, points)}
        new = {key: point_values for key, point_values in new.items() if key not in self.tried}
        # Checked before anything runs, so that the budget is never exceeded.
        if len(self.tried) + len(new) > self._budget:
            raise _Spent
        number = len(self.tried)
        cases = [
            vary(self._case, point_values, name=f"{self._case.test}@{number + offset}")
            for offset, point_values in enumerate(new.values(), start=1)
        ]
        trials: dict[int, Trial] = {}
        try:
            for index, result in run_cases(cases):
                trials[index] = Trial(list(new.values())[index], result)
                if self._progress is not None:
                    self._progress(number + len(trials), self._budget, trials[index])
        finally:
            for index in sorted(trials):  # in the order of the points, whichever finished first
                self.tried[list(new)[index]] = trials[index]
