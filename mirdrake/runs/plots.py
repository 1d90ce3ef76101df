"""Plots and texts of runs for notebooks."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.wording import plural
from mirdrake.runs.texts import describe_figures, describe_stop

if TYPE_CHECKING:
    from mirdrake.runs.logs import Run

# Named as text and resolved when needed: the viewer imports this package, not the other way round.
ANIMATION = "mirdrake.viewer.inline:RunView"
"""Class of :func:`animate_run`, of a later package."""

WIDTH, HEIGHT = 9.0, 2.2
"""Size of a panel [in]."""

USUAL = ("*.vx", "*.steering_setpoint", "*.lateral_error")
"""Signals that are plotted if none are named."""


class Animation(ABC):
    """3D animation of a run, which a notebook shows."""

    @classmethod
    @abstractmethod
    def of_run(cls, run: "Run", *, height: int, frames_per_second: float) -> "Animation":
        """Return the animation of a run; see :func:`animate_run`."""

    @abstractmethod
    def _repr_html_(self) -> str:
        """Return the HTML element for a notebook."""

    @abstractmethod
    def save(self, path: Path | str) -> Path:
        """Write a page that opens offline."""


def animate_run(run: "Run", *, height: int, frames_per_second: float) -> Animation:
    """Return the 3D animation of a run.

    Args:
        run: the run.
        height: height of the view [px].
        frames_per_second: of simulated time [Hz].
    """
    view: type[Animation] = resolve_name(ANIMATION)
    return view.of_run(run, height=height, frames_per_second=frames_per_second)


def make_statistics(run: "Run", patterns: Sequence[str]) -> pd.DataFrame:
    """Return a table of signals: unit, smallest, mean and largest value, root mean square, last value.

    Args:
        run: the run.
        patterns: names of signals, with wildcards; none: all signals.

    Raises:
        ConfigError: a pattern chooses nothing.
    """
    names = choose_signals(run, patterns or ["*"])
    table = run.signals[names]
    columns = {
        "unit": pd.Series({name: run.units.get(name, "") or "-" for name in names}),
        "min": table.min(),
        "mean": table.mean(),
        "max": table.max(),
        "rms": np.sqrt((table**2).mean()),
        # `iloc[-1]` of an empty table raises; the mean of an empty table is NaN, as is every other column.
        "last": table.iloc[-1] if len(table) else table.mean(),
    }
    result = pd.DataFrame(columns)
    result.index.name = "signal"
    return result


def choose_signals(run: "Run", patterns: Sequence[str]) -> list[str]:
    """Return the signals of a run that patterns choose, such as ``ego.control.*_pid.output``.

    Without patterns those of :data:`USUAL` that the run has.

    Raises:
        ConfigError: a pattern chooses nothing.
    """
    columns = [str(name) for name in run.signals]
    # Usual signals, as far as this run has them.
    if not patterns:
        patterns = [pattern for pattern in USUAL if any(fnmatchcase(name, pattern) for name in columns)]
    if not patterns:
        raise ConfigError(f"run: name the signals to plot, such as '{next(iter(columns), 'ego.vx')}' or 'ego.v*'")
    chosen: dict[str, None] = {}
    for pattern in patterns:
        names = [name for name in columns if fnmatchcase(name, pattern)]
        if not names:
            hint = (
                "; inner signals are recorded with record: {signals: [ego.control.**]}"
                if ".control." in pattern
                else ""
            )
            raise ConfigError(f"run: no signal matches '{pattern}'; {did_you_mean(pattern, columns)}{hint}")
        chosen |= dict.fromkeys(names)
    return list(chosen)


def plot_runs(runs: dict[str, "Run"], patterns: Sequence[str]) -> Any:
    """Return a figure with a panel for each unit, and a line for each signal of each run.

    Args:
        runs: runs by their labels in the legend; the label of a single run may be empty.
        patterns: names of signals, with wildcards.

    Raises:
        ConfigError: a pattern chooses nothing in one of the runs.
    """
    # Imported here: matplotlib is slow to load and not needed for runs without plots.
    import matplotlib.pyplot as plt

    names = {label: choose_signals(run, patterns) for label, run in runs.items()}
    units: dict[str, list[tuple[str, str]]] = {}
    for label, chosen in names.items():
        for name in chosen:
            units.setdefault(runs[label].units.get(name, ""), []).append((label, name))
    figure, axes = plt.subplots(
        len(units), 1, sharex=True, squeeze=False, figsize=(WIDTH, HEIGHT * len(units)), layout="constrained"
    )
    for panel, (unit, lines) in zip(axes[:, 0], units.items(), strict=True):
        for label, name in lines:
            panel.plot(runs[label][name], label=f"{name}, {label}" if label else name)
        panel.set_ylabel(f"[{unit or '-'}]")
        panel.grid(alpha=0.3)
        panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize="small", frameon=False)
    axes[-1, 0].set_xlabel("time [s]")
    plt.close(figure)  # a notebook shows the returned figure once
    return figure


def describe(run: "Run") -> str:
    """Return a run as about ten lines: what ran, how it ended, and its main figures with units."""
    summary = run.summary
    vehicles = run.spec.get("vehicles", {})
    models = ", ".join(f"{name} ({entry['model'].rpartition('/')[2]})" for name, entry in vehicles.items())
    lines = [f"Run of '{run.spec.get('name', 'diagram')}': {models}"]
    lines.append(f"  {summary.get('simulated_s', 0.0):.2f} s; {describe_stop(summary)}")
    if "real_time_factor" in summary:
        lines.append(f"  real-time factor {summary['real_time_factor']:.2f}")
    for name in vehicles:
        figures = summary.get("vehicles", {}).get(name, {})
        lines.append(f"  {name}: {', '.join(describe_figures(figures))}".removesuffix(": "))
    lines.append(
        f"  {len(run.signals.columns)} signals, {len(run.signals)} samples; {plural(len(run.events), 'event')}"
    )
    lines.append(f"  folder: {run.folder or 'none, in memory'}")
    return "\n".join(lines)
