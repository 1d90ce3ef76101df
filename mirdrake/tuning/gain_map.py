"""Map of two gains: cost, Ms and stability on a grid."""

import math
from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from mirdrake.core.errors import ConfigError
from mirdrake.studies.spec import ParameterSpec
from mirdrake.tuning.loops.base import Evaluator, Fidelity
from mirdrake.tuning.search import TrialProgress, search


def map_of_two_gains(
    evaluate: Evaluator,
    space: Mapping[str, ParameterSpec],
    *,
    cost: Mapping[str, float],
    constraints: Mapping[str, float] | None = None,
    fixed: Mapping[str, float] | None = None,
    count: int = 15,
    fidelity: Fidelity = "plant",
    store: Path | None = None,
    purpose: Mapping[str, object] | None = None,
    progress: TrialProgress | None = None,
) -> pd.DataFrame:
    """Evaluate a grid of two gains.

    Args:
        evaluate: tests gains.
        space: range of each of the two.
        cost: see :func:`mirdrake.tuning.search.search`, also for the other arguments.
        constraints: limits of figures.
        fixed: gains that do not vary.
        count: values of a range that has no count of its own.
        fidelity: reduced or plant.
        store: file that keeps the evaluations.
        purpose: of the file.
        progress: called after every evaluation.

    Returns:
        A row per point, of which the second gain varies fastest: the two gains, cost (inf if it is not finite), ms (nan
        if unknown), stable, feasible.

    Raises:
        ConfigError: not two gains, and as :func:`mirdrake.tuning.search.search`.
    """
    if len(space) != 2:
        raise ConfigError(f"a map needs two gains, got {len(space)}: {', '.join(space) or 'none'}")
    # A gain of the study has its own values or number of values; only others get the default.
    ranges = {
        name: entry if entry.values or entry.count else entry.model_copy(update={"count": count})
        for name, entry in space.items()
    }
    sizes = [len(entry.values) if entry.values else entry.count or 0 for entry in ranges.values()]
    # The grid method of the search, so that maps resume from their journal as well.
    outcome = search(
        evaluate,
        ranges,
        method="grid",
        trials=math.prod(sizes),
        cost=cost,
        constraints=constraints,
        fixed=fixed,
        fidelity=fidelity,
        store=store,
        purpose=purpose,
        progress=progress,
    )
    # The table has stability beside cost, so that the map shows where the loop cannot be used.
    rows = [
        {
            **{name: trial.gains[name] for name in ranges},
            "cost": trial.cost,
            "ms": trial.figures.get("ms", math.nan),
            "stable": trial.status == "ok",
            "feasible": trial.feasible,
        }
        for trial in outcome.trials
    ]
    return pd.DataFrame(rows)
