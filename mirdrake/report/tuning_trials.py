"""Charts of the trials of a tuning study: the Pareto front of two figures, and parallel coordinates."""

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd
from markupsafe import Markup
from matplotlib.axes import Axes

from mirdrake.report.svg import SCALE_STEPS, THEME
from mirdrake.report.tuning_axes import HALF, SCALE, Array, Shown, add_axes, colour_bounds, embed, label, new_figure
from mirdrake.report.words import format_quantity
from mirdrake.studies.fronts import find_knee, pareto_front


def draw_front(
    trials: pd.DataFrame, x: tuple[str, str], y: tuple[str, str], marks: Sequence[tuple[Shown, tuple[float, float]]]
) -> Markup:
    """Draw two figures of all trials against each other, the Pareto front and its knee.

    Args:
        trials: trials with both figures.
        x: column and label of the horizontal axis.
        y: column and label of the vertical axis.
        marks: candidates and their positions.
    """
    values = trials[[x[0], y[0]]].to_numpy(dtype=float)
    keep = np.isfinite(values).all(axis=1)
    values, allowed = values[keep], trials["feasible"].to_numpy(dtype=bool)[keep]
    figure = new_figure(HALF, 360.0)
    axes = add_axes(figure, (0.0, 0.0, 1.0, 1.0))
    # Trials outside of the constraints are hollow, so that they are not read as possible choices.
    axes.plot(*values[~allowed].T, marker="o", markersize=3.6, markerfacecolor="none", linestyle="none",
              markeredgecolor=THEME["edge"], markeredgewidth=0.9)  # fmt: skip
    axes.plot(
        *values[allowed].T, marker="o", markersize=3.8, markeredgewidth=0.0, linestyle="none", color=THEME["own2"]
    )
    if len(values):
        front = values[pareto_front(values)]
        front = front[np.argsort(front[:, 0])]
        axes.plot(*front.T, color=THEME["ink"], linewidth=1.3, drawstyle="steps-post")
        knee = front[find_knee(front)]
        axes.plot(*knee, marker="D", markersize=9.0, color=THEME["own3"], linestyle="none", zorder=4)
        # No trial is below and to the left of the Pareto front.
        axes.annotate("knee", knee, xytext=(-6, -6), textcoords="offset points", color=THEME["own3"], fontsize=12.0,
                      ha="right", va="top")  # fmt: skip
        _trim(axes, values, front, [point for _, point in marks])
    # The candidates of the page are ringed in their colours.
    for entry, point in marks:
        if all(map(math.isfinite, point)):
            axes.plot(*point, marker="o", markersize=9.0, markerfacecolor="none", markeredgewidth=2.6,
                      markeredgecolor=THEME[entry.colour], linestyle="none", zorder=5)  # fmt: skip
    label(axes, x[1], y[1])
    return embed(figure, "front", f"{y[1]} against {x[1]}")


def draw_parallel(trials: pd.DataFrame, columns: Sequence[tuple[str, str]], logs: Sequence[bool]) -> Markup:
    """Draw a line per trial through its gains and figures, coloured by cost; grey if it is not feasible.

    Args:
        trials: trials with the columns, cost and feasible.
        columns: names and labels, from left to right.
        logs: whether an axis is logarithmic.
    """
    rows = trials[np.isfinite(trials[[name for name, _ in columns]].to_numpy(dtype=float)).all(axis=1)]
    rows = rows[np.isfinite(rows["cost"].to_numpy(dtype=float))].sort_values("cost", ascending=False)
    figure = new_figure(HALF, 360.0)
    axes = figure.add_axes((30.0 / HALF, 62.0 / 360.0, (HALF - 60.0) / HALF, (360.0 - 96.0) / 360.0))
    axes.set_axis_off()
    # More lines than this cannot be seen; the best hundred are always drawn.
    if len(rows) > 300:
        rows = pd.concat([rows.iloc[:: max(1, len(rows) // 200)], rows.tail(100)]).drop_duplicates()
    scaled = []
    for column, ((name, title), log) in enumerate(zip(columns, logs, strict=True)):
        values = rows[name].to_numpy(dtype=float)
        log = log and bool((values > 0.0).all())
        inside = np.log10(values) if log else values
        # The worst tenth of a figure is clipped to the top, so that the others can be distinguished.
        low, high = float(inside.min()), float(inside.max() if log else np.quantile(inside, 0.9))
        scaled.append(np.clip((inside - low) / ((high - low) or 1.0), 0.0, 1.0))
        ends = (10.0**low, 10.0**high) if log else (low, high)
        more = "≥ " if not log and float(inside.max()) > high else ""
        axes.plot([column, column], [0.0, 1.0], color=THEME["muted"], linewidth=1.0)
        for height, text, where in (
            (-0.03, format_quantity(ends[0]), "top"),
            (1.03, more + format_quantity(ends[1]), "bottom"),
        ):
            axes.text(column, height, text, ha="center", va=where, color=THEME["muted"], fontsize=11.0)
        axes.text(column, -0.14, title, ha="center", va="top", fontsize=12.0)
    # From the worst to the best, so that good trials are drawn on top.
    lines = np.array(scaled).T
    feasible = rows["feasible"].to_numpy(dtype=bool)
    good = rows["cost"].to_numpy(dtype=float)[feasible]
    bounds = colour_bounds(good) if len(good) else np.zeros(0)
    for line, is_feasible, cost in zip(lines, feasible, rows["cost"].to_numpy(dtype=float), strict=True):
        if not is_feasible:
            axes.plot(line, color=THEME["grid"], linewidth=0.9, zorder=1.0)
            continue
        step = int(np.clip(np.searchsorted(bounds, cost, side="right") - 1, 0, SCALE_STEPS - 1))
        axes.plot(line, color=SCALE[step], linewidth=1.1, zorder=2.0)
    if len(rows):
        # The last feasible row has the lowest cost.
        best = np.flatnonzero(feasible)[-1] if feasible.any() else len(rows) - 1
        axes.plot(lines[best], color=THEME["main"], linewidth=2.6, zorder=3.0)
    axes.set_xlim(-0.1, len(columns) - 0.9)
    axes.set_ylim(-0.02, 1.02)
    return embed(figure, "parallel", "Gains and figures of all trials as parallel coordinates")


def _trim(axes: Axes, values: Array, front: Array, marks: Sequence[tuple[float, float]]) -> None:
    """Set the axis limits so that the Pareto front, the better trials and nearby marks are visible."""
    for column, name in ((0, "x"), (1, "y")):
        # Trials that nearly diverged are orders of magnitude worse: the worst fifth is cut off, but never the Pareto
        # front.
        low = float(values[:, column].min())
        high = max(
            float(np.quantile(values[:, column], 0.8)), float(front[:, column].max()) if len(front) < 50 else low
        )
        high = min(high, low + 6.0 * (float(np.median(values[:, column])) - low) or high)
        # Marks such as the baseline extend the view if they are near; far ones would compress the trials into a corner.
        near = [
            point[column]
            for point in marks
            if math.isfinite(point[column]) and point[column] < low + 4.0 * (high - low)
        ]
        low, high = min([low, *near]), max([high, *near])
        # Equal values would give an axis of zero length.
        room = 0.08 * (high - low) or 0.1 * abs(high) or 1.0
        getattr(axes, f"set_{name}lim")(low - room, high + room)
