"""Proposers of the next points of a search: a fixed list, or a sampler of Optuna that learns from results.

Points are proposed and results reported in batches of fixed size and in order, so that the points depend only on the
seed and on earlier results. A sampler gets finite numbers only.

Sources: TPE: J. Bergstra et al., Algorithms for Hyper-Parameter Optimization, NIPS 2011; CMA-ES: N. Hansen, The CMA
Evolution Strategy: A Tutorial (2016); NSGA-II: K. Deb et al., IEEE Trans. Evol. Comput. 6 (2002) 182; all as in Optuna.
"""

import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import product
from typing import Any, Protocol

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.extras import import_extra
from mirdrake.studies.sampling import divide, draw, spread
from mirdrake.studies.spec import ParameterSpec

Point = dict[str, float]
Space = Mapping[str, ParameterSpec]

LEARNING = ("tpe", "cma", "nsga2")
METHODS = (*LEARNING, "grid", "latin_hypercube", "sobol", "random")

LARGEST = 1e15
"""Upper limit of the objectives that is passed to a sampler [their unit]."""


class Proposer(Protocol):
    """Source of points to evaluate."""

    @property
    def batch(self) -> int | None:
        """Number of points per batch; None: all at once."""

    def ask(self, count: int) -> list[Point]:
        """Return the next points, at most `count`; none at the end."""
        ...

    def tell(self, objectives: Sequence[float], violation: float) -> None:
        """Report the result of the oldest point without one.

        Args:
            objectives: objectives to be minimised; they need not be finite.
            violation: 0 if the constraints hold, otherwise a finite measure of their violation.
        """
        ...


def make_proposer(
    method: str, space: Space, *, trials: int, objectives: int, seed: int, batch: int, start: Sequence[Point]
) -> Proposer:
    """Return the proposer of a method.

    Args:
        method: one of :data:`METHODS`.
        space: range of each coordinate; a grid uses its count or values, otherwise `trials` are divided evenly.
        trials: number of points including those of `start`; a grid must not have more.
        objectives: number of objectives; more than one for nsga2 only.
        seed: seed of all random numbers.
        batch: number of points that a sampler proposes before it needs a result.
        start: points to begin with.

    Raises:
        ConfigError: the method is unknown, or cannot search this space.
        MissingDependencyError: Optuna is not installed.
    """
    if method not in METHODS:
        raise ConfigError(f"method: unknown method '{method}'; {did_you_mean(method, METHODS)}")
    if method in LEARNING:
        return OptunaProposer(method, space, trials=trials, objectives=objectives, seed=seed, batch=batch, start=start)
    return ListProposer([*start, *_listed(method, space, trials - len(start), seed)])


class ListProposer:
    """Proposer of a fixed list.

    Args:
        points: points in the order of proposal.
    """

    batch = None

    def __init__(self, points: Sequence[Point]) -> None:
        self._rest = list(points)

    def ask(self, count: int) -> list[Point]:
        """Return the next points."""
        given, self._rest = self._rest[:count], self._rest[count:]
        return given

    def tell(self, objectives: Sequence[float], violation: float) -> None:
        """Ignore the result."""


class OptunaProposer:
    """Proposer that uses a sampler of Optuna; arguments as in :func:`make_proposer`.

    CMA-ES has no constraints: a point that violates one is reported as worse than all that do not, by its violation.
    """

    def __init__(
        self,
        method: str,
        space: Space,
        *,
        trials: int,
        objectives: int,
        seed: int,
        batch: int,
        start: Sequence[Point],
    ) -> None:
        if objectives > 1 and method != "nsga2":
            raise ConfigError(f"method: {method} optimises one objective; use nsga2 for {objectives}")
        for name, entry in space.items():
            if entry.low is None:
                raise ConfigError(f"{method} needs a range, low and high, not values", where=name)
        self._optuna = _optuna()
        self.batch: int | None = batch
        self._barrier = method == "cma"
        with self._quietly():
            distribution = self._optuna.distributions.FloatDistribution
            self._space = {
                name: distribution(entry.low, entry.high, log=entry.scale == "log") for name, entry in space.items()
            }
            self._study = self._optuna.create_study(
                directions=["minimize"] * objectives, sampler=self._sampler(method, trials, seed, start)
            )
            # Enqueued trials are the first ones that are asked for.
            for point in start:
                self._study.enqueue_trial(dict(point))
        self._open: list[Any] = []

    def ask(self, count: int) -> list[Point]:
        """Return the next points."""
        with self._quietly():
            asked = [self._study.ask(self._space) for _ in range(count)]
        self._open += asked
        return [{name: float(trial.params[name]) for name in self._space} for trial in asked]

    def tell(self, objectives: Sequence[float], violation: float) -> None:
        """Report the result to the sampler."""
        # Results are reported in the order in which the points were proposed.
        trial = self._open.pop(0)
        # Optuna fails trials with NaN; a large finite value keeps the point as a bad one.
        values = [min(value, LARGEST) if math.isfinite(value) else LARGEST for value in objectives]
        if self._barrier:
            # Above every feasible value, which is at most `LARGEST`, and increasing with the violation.
            values = [LARGEST * (2.0 + violation) if violation > 0.0 else values[0]]
        with self._quietly():
            if not self._barrier:
                trial.set_constraint("violation", violation)
            self._study.tell(trial, values)

    def _sampler(self, method: str, trials: int, seed: int, start: Sequence[Point]) -> Any:
        samplers = self._optuna.samplers
        if method == "tpe":
            return samplers.TPESampler(seed=seed, multivariate=True, n_startup_trials=max(10, 2 * len(self._space)))
        if method == "nsga2":
            # About a dozen generations within the trials.
            population = max(8, min(50, trials // 12))
            # The default crossover exchanges coordinates only; blending also searches between the parents.
            crossover = samplers.nsgaii.BLXAlphaCrossover()
            return samplers.NSGAIISampler(seed=seed, population_size=population, crossover=crossover)
        if len(self._space) < 2:
            raise ConfigError("method: cma needs at least two ranges; use tpe for one")
        import_extra("cmaes", need="CMA-ES needs cmaes", extra="tuning")
        first = dict(start[0]) if start else None
        return samplers.CmaEsSampler(seed=seed, x0=first, warn_independent_sampling=False)

    @contextmanager
    def _quietly(self) -> Iterator[None]:
        """Silence Optuna within the block."""
        logging = self._optuna.logging
        before = logging.get_verbosity()
        logging.set_verbosity(logging.ERROR)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                yield
        finally:
            logging.set_verbosity(before)


def _listed(method: str, space: Space, count: int, seed: int) -> list[Point]:
    """Return the points of a method that does not learn."""
    names = list(space)
    if method == "grid":
        # The largest equal number of values whose product is within the trials; the tolerance corrects the root.
        each = max(2, math.floor(max(count, 1) ** (1.0 / len(names)) + 1e-9))
        lists = [
            divide(entry if entry.values or entry.count else entry.model_copy(update={"count": each}))
            for entry in space.values()
        ]
        rows = list(product(*lists)) if math.prod(map(len, lists)) <= count else None
        if rows is None:
            size = " x ".join(str(len(values)) for values in lists)
            raise ConfigError(
                f"trials: a grid of {size} has more than {count} points; use more trials, or fewer values"
            )
    else:
        unit = draw(method, max(count, 0), len(names), seed)
        rows = list(zip(*(spread(entry, unit[:, column]) for column, entry in enumerate(space.values())), strict=True))
    return [dict(zip(names, map(float, row), strict=True)) for row in rows]


def _optuna() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return import_extra(
            "optuna", need="tpe, cma and nsga2 need Optuna", extra="tuning",
            otherwise="; grid, sobol and latin_hypercube do not",
        )  # fmt: skip
