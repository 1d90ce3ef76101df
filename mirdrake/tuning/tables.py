"""Tables of a tuning result: responses, trials, open loops, and the Monte Carlo with its use of grip."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from mirdrake.tuning.grip import axles_of, grip_use
from mirdrake.tuning.loops.base import Conditions, Fidelity, LoopSpec
from mirdrake.tuning.loops.evaluate import loops_of, plant_bench
from mirdrake.tuning.loops.reduced import critical_loop
from mirdrake.tuning.loops.registry import LOOP_KINDS
from mirdrake.tuning.scenarios import MOST_SLIP, SLIP
from mirdrake.tuning.spec import AT_LEAST, MARGINS
from mirdrake.tuning.stages import Candidate
from mirdrake.tuning.trials import Trials


def responses_table(tried: Sequence[Candidate]) -> pd.DataFrame:
    """Return the responses of all candidates: candidate, t, reference, output, effort."""
    parts = [entry.response.assign(candidate=entry.name) for entry in tried if entry.response is not None]
    columns = ["candidate", "t", "reference", "output", "effort"]
    return pd.concat(parts, ignore_index=True)[columns] if parts else pd.DataFrame(columns=columns)


def trials_table(
    coarse: Trials, fine: Sequence[Trials], *, limits: Mapping[str, float], coarse_on: Fidelity = "reduced"
) -> pd.DataFrame:
    """Return the trials of the search and of the searches on the plant, numbered in sequence, with their fidelity.

    Trials of the latter that break the limit of a margin, or that of sliding wheels, were evaluated on the reduced
    model: see :class:`mirdrake.tuning.loops.evaluate.LoopEvaluator` and :class:`mirdrake.tuning.scenarios.InSlip`.
    """
    parts = [coarse.table.assign(fidelity=coarse_on)]
    for trials in fine:
        table = trials.table
        # Trials whose margins break a limit were tested on the reduced model only.
        broken = np.zeros(len(table), dtype=bool)
        if SLIP in table:
            broken |= table[SLIP].to_numpy(dtype=float) > MOST_SLIP
        for name in MARGINS:
            if name in limits and name in table:
                value = table[name].to_numpy(dtype=float)
                broken |= value < limits[name] if name in AT_LEAST else value > limits[name]
        parts.append(table.assign(fidelity=np.where(broken, "reduced", "plant")))
    table = pd.concat(parts, ignore_index=True)
    table["number"] = range(len(table))
    return table


def frequency_table(loop: LoopSpec, chosen: Sequence[Candidate]) -> pd.DataFrame:
    """Return the open loop of candidates over frequency, of the loop with the largest Ms; empty if it is not known."""
    if loop.period is None:
        return pd.DataFrame()
    top = 0.99 * np.pi / loop.period
    omega = np.geomspace(top / 3e3, top, 300)
    parts = []
    for entry in chosen:
        gains = entry.design.gains or loop.present
        # The present controller may be of another kind, and without gains there is no loop.
        loops = loops_of(loop, gains) if any(gains.values()) else []
        if not loops:
            continue
        value = critical_loop(loops)(omega)
        parts.append(pd.DataFrame({"candidate": entry.name, "omega": omega, "re": value.real, "im": value.imag}))
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()


def with_grip(table: pd.DataFrame, loop: LoopSpec, draws: Sequence[Conditions]) -> pd.DataFrame:
    """Return the runs of the Monte Carlo with the grip that each requires over the available grip."""
    if not LOOP_KINDS[loop.kind].uses_traction:
        return table
    axles = axles_of(plant_bench(loop))
    use = [grip_use(axles, loop, draw) for draw in draws]
    table = table.copy()
    table.insert(list(table.columns).index("seed"), "grip_use", [use[run] for run in table["run"]])
    return table
