"""A map of two gains: cost, Ms and stability on a grid, and the edge of stability in it."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mirdrake.core.errors import ConfigError
from mirdrake.tuning.loops.base import Evaluator
from mirdrake.tuning.search import read_space, search


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
        space: range of each of the two, see :func:`mirdrake.tuning.search.search`.
        cost: see :func:`mirdrake.tuning.search.search`.
        constraints: see :func:`mirdrake.tuning.search.search`.
        count: values of a range that does not say so itself.
        more: further arguments of :func:`mirdrake.tuning.search.search`: fixed, workers, store, options and so on.

    Raises:
        ConfigError: not two gains, and as :func:`mirdrake.tuning.search.search`.
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
