"""Values of signals at given times, and conditions on them."""

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mirdrake.core.errors import ConfigError
from mirdrake.requirements import Observation, parse_requirement
from mirdrake.runs.logs import Run

Array = NDArray[np.float64]


def value_at(signals: pd.DataFrame, name: str, times: Array, *, held: bool = False) -> Array:
    """Return a signal at times [s], interpolated between samples.

    Args:
        signals: samples, index time [s].
        name: name of the signal.
        times: [s] (n).
        held: take the sample before instead, for signals that jump, such as progress at the end of a lap.
    """
    known, values = signals.index.to_numpy(dtype=float), signals[name].to_numpy(dtype=float)
    if held:
        rows = np.clip(np.searchsorted(known, times + 1e-9, side="right") - 1, 0, len(known) - 1)
        return np.asarray(values[rows])
    return np.asarray(np.interp(times, known, values))


def holds(condition: str, run: Run, vehicle: str, times: Array) -> NDArray[np.bool_]:
    """Return whether a condition on the signals of a vehicle holds at times [s] (n).

    Args:
        condition: an expression of :mod:`mirdrake.requirements` without an operator of time.
        run: the run.
        vehicle: its signals may be named without it: ``lateral_error``.
        times: [s] (n).

    Raises:
        ConfigError: the condition cannot be understood, or the run has no such signal.
    """
    prefix = f"where '{condition}': "
    try:
        # The language of requirements needs an operator of time; only the expression inside is evaluated.
        requirement = parse_requirement(f"always {condition}")
    except ConfigError as error:
        raise ConfigError(f"{prefix}{error}") from None
    table: dict[str, Any] = {str(name): value_at(run.signals, str(name), times) for name in run.signals}
    units = {name: run.units.get(name, "") for name in table}
    for name in [name for name in table if name.startswith(f"{vehicle}.")]:
        short = name.removeprefix(f"{vehicle}.")
        table[short], units[short] = table[name], units[name]
    if f"{vehicle}.vx" in table:
        table["speed"], units["speed"] = np.hypot(table[f"{vehicle}.vx"], table[f"{vehicle}.vy"]), "m/s"
    seen = Observation(times, table, units)
    for atom in requirement.atoms:
        atom.check(seen, prefix)
    return np.asarray(requirement.expression.evaluate(seen).truth, dtype=bool)
