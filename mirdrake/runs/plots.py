"""Plots and texts of runs for notebooks."""

from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any

from mirdrake.core.errors import ConfigError, did_you_mean

if TYPE_CHECKING:
    from mirdrake.runs.logs import Run

WIDTH, HEIGHT = 9.0, 2.2
"""Size of a panel [in]."""


def choose_signals(run: "Run", patterns: Sequence[str]) -> list[str]:
    """Return the signals of a run that patterns choose, such as ``ego.control.*_pid.output``.

    Raises:
        ConfigError: a pattern chooses nothing.
    """
    columns = [str(name) for name in run.signals]
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
    lines.append(f"  stopped by {summary.get('stop_reason')} after {summary.get('simulated_s', 0.0):.2f} s")
    if "real_time_factor" in summary:
        lines.append(f"  real-time factor {summary['real_time_factor']:.2f}")
    for name in vehicles:
        figures = summary.get("vehicles", {}).get(name, {})
        numbers = [f"{key} {value:.4g}" for key, value in figures.items() if isinstance(value, float)]
        lines.append(f"  {name}: {', '.join(numbers[:4])}" if numbers else f"  {name}")
    lines.append(f"  {len(run.signals.columns)} signals, {len(run.signals)} samples; {len(run.events)} events")
    lines.append(f"  folder: {run.folder or 'none, in memory'}")
    return "\n".join(lines)
