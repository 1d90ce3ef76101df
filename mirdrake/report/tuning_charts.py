"""Charts of the tuning report: responses, map of two gains, frequency response, Monte Carlo, schedule."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import shapely
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from mirdrake.core.curves import thin
from mirdrake.report.svg import SCALE_STEPS, THEME
from mirdrake.report.tuning_axes import (
    HALF,
    SCALE,
    WIDE,
    Array,
    Shown,
    add_axes,
    colour_bounds,
    embed,
    label,
    make_log,
    new_figure,
)
from mirdrake.report.words import format_quantity
from mirdrake.tuning.result import ScheduleRow

_POINTS = 600
_CELL: dict[str, Any] = {"edgecolors": "face", "linewidth": 0.6}  # closes the seams between cells


def draw_responses(
    table: pd.DataFrame, shown: Sequence[Shown], units: tuple[str, str], limits: tuple[str, ...]
) -> Markup:
    """Draw output and effort of the candidates over time; values outside of the frame are cut off.

    Args:
        table: candidate, t [s], reference, output, effort.
        shown: candidates; the last one is drawn on top.
        units: units of output and effort.
        limits: names of the candidates that set the vertical range.
    """
    figure = new_figure(WIDE, 520.0)
    top = add_axes(figure, (0.0, 0.44, 1.0, 0.56))
    low = add_axes(figure, (0.0, 0.0, 1.0, 0.44))
    first = True
    ranges: dict[str, list[float]] = {"output": [], "effort": []}
    for entry in shown:
        # Candidates that diverged would set the scale for all others, so that only `limits` frame the chart.
        rows = table[table["candidate"] == entry.name]
        if rows.empty:
            continue
        t = rows["t"].to_numpy(dtype=float)
        # The reference is the same for all candidates and is drawn once.
        if first:
            reference = rows["reference"].to_numpy(dtype=float)
            top.plot(t, reference, color=THEME["muted"], linewidth=1.1, drawstyle="steps-post", zorder=1.5)
            ranges["output"] += [float(reference.min()), float(reference.max())]
            first = False
        for axes, key in ((top, "output"), (low, "effort")):
            values = rows[key].to_numpy(dtype=float)
            axes.plot(*thin(t, values, _POINTS), **entry.style)
            finite = values[np.isfinite(values)]
            if entry.name in limits and len(finite):
                ranges[key] += [float(finite.min()), float(finite.max())]
    for axes, key, unit in ((top, "output", units[0]), (low, "effort", units[1])):
        if ranges[key]:
            # A constant signal has no height: the axis would be of length zero.
            bottom, highest = min(ranges[key]), max(ranges[key])
            room = 0.06 * (highest - bottom) or 1.0
            axes.set_ylim(bottom - room, highest + room)
        label(axes, "Time [s]" if axes is low else "", f"{key.capitalize()} [{unit}]")
    top.tick_params(labelbottom=False)
    low.set_xlim(top.get_xlim())
    return embed(figure, "resp", "Output and effort of the candidates over time")


def draw_map(table: pd.DataFrame, marks: Sequence[tuple[Shown, Mapping[str, float]]], max_ms: float | None) -> Markup:
    """Draw the cost over two gains, the limit of stability and the line of the largest allowed Ms.

    Args:
        table: two gains, cost, ms, stable; a full grid.
        marks: candidates and their gains.
        max_ms: largest allowed Ms; None if it is not constrained.
    """
    x_name, y_name = map_gains(table)
    grid = table.pivot_table(index=y_name, columns=x_name, values="cost", aggfunc="first", dropna=False)
    x, y = grid.columns.to_numpy(dtype=float), grid.index.to_numpy(dtype=float)
    # Costs of unstable points have no meaning and would dominate the scale of colours.
    stable = _grid(table, "stable", x, y) > 0.5
    cost = np.where(stable, _grid(table, "cost", x, y), np.nan)
    cost[~np.isfinite(cost)] = np.nan
    figure = new_figure(WIDE, 420.0)
    axes = add_axes(figure, (0.0, 0.0, 0.84, 1.0))
    # Gains are often searched on a logarithmic grid, which needs logarithmic borders of cells.
    logs = (_is_log(x), _is_log(y))
    edges = (_edges(x, logs[0]), _edges(y, logs[1]))
    axes.pcolormesh(*edges, np.where(stable, np.nan, 1.0), cmap=ListedColormap([THEME["grid"]]), **_CELL)
    finite = cost[np.isfinite(cost)]
    if len(finite):
        bounds = colour_bounds(finite)
        # Clipped to the scale: extreme costs would stretch it.
        axes.pcolormesh(
            *edges, np.clip(cost, bounds[0], bounds[-1]), cmap=ListedColormap(SCALE),
            norm=BoundaryNorm(bounds, SCALE_STEPS), **_CELL,
        )  # fmt: skip
        _scale_bar(figure, bounds)
    for segment in _edge_lines(stable, *edges):
        axes.plot(*segment, color=THEME["alarm"], linewidth=2.2, solid_capstyle="projecting")
    if max_ms is not None and "ms" in table:
        ms = np.where(stable, _grid(table, "ms", x, y), np.nan)
        # A contour exists only if the limit lies within the values.
        if np.isfinite(ms).sum() > 3 and np.nanmin(ms) < max_ms < np.nanmax(ms):
            # Unstable points get a large Ms, so that the contour ends at the limit of stability.
            axes.contour(x, y, np.where(np.isfinite(ms), ms, 10.0 * max_ms), [max_ms], colors=["#17202a"],
                         linewidths=2.0, linestyles="dashed")  # fmt: skip
    axes.set_xlim(edges[0][0], edges[0][-1])
    axes.set_ylim(edges[1][0], edges[1][-1])
    for axis, name, log in (("x", x_name, logs[0]), ("y", y_name, logs[1])):
        if log:
            make_log(axes, axis)
        getattr(axes, f"set_{axis}label")(name)
    dots = []
    for entry, gains in marks:
        point = float(gains.get(x_name, math.nan)), float(gains.get(y_name, math.nan))
        if edges[0][0] <= point[0] <= edges[0][-1] and edges[1][0] <= point[1] <= edges[1][-1]:
            axes.plot(*point, marker="o", markersize=9.0, markerfacecolor=THEME["paper"], markeredgewidth=2.6,
                      markeredgecolor=THEME[entry.colour], linestyle="none")  # fmt: skip
            dots.append((entry.role, point))
    # In reverse, so that the candidate on top has the best place.
    _label_dots(axes, dots[::-1])
    return embed(figure, "map", f"Cost over {x_name} and {y_name}, with the limit of stability")


def _label_dots(axes: Axes, dots: Sequence[tuple[str, tuple[float, float]]]) -> None:
    """Write labels beside dots, inside the axes and without overlaps if possible.

    Args:
        axes: axes with their final limits.
        dots: text and point of each label; the first ones choose first.
    """
    # A figure has 72 dots per inch: pixels are points.
    places = [axes.transData.transform(point) for _, point in dots]
    taken = [shapely.box(x - 6.0, y - 6.0, x + 6.0, y + 6.0) for x, y in places]
    frame = shapely.box(*axes.bbox.extents)
    for (text, point), (x, y) in zip(dots, places, strict=True):
        label = axes.annotate(
            text,
            point,
            xytext=(0.0, 0.0),
            textcoords="offset points",
            color=THEME["ink"],
            fontsize=12.0,
            bbox={"boxstyle": "round,pad=0.15", "facecolor": THEME["paper"], "edgecolor": "none", "alpha": 0.85},
        )
        size = label.get_window_extent()
        choices = [(dx, dy) for dy in (6.0, -15.0, 26.0, -35.0) for dx in (10.0, -10.0 - size.width)]
        boxes = [shapely.box(x + dx, y + dy - 4.0, x + dx + size.width, y + dy + size.height) for dx, dy in choices]
        # The first of the choices with the smallest part outside or over something.
        losses = [
            box.area - box.intersection(frame).area + sum(box.intersection(other).area for other in taken)
            for box in boxes
        ]
        best = losses.index(min(losses))
        taken.append(boxes[best])
        label.xyann = choices[best]


def map_gains(table: pd.DataFrame) -> tuple[str, str]:
    """Return the names of the two gains of a map."""
    names = [str(name) for name in table.columns if name not in {"cost", "ms", "stable", "feasible", "status"}]
    return names[0], names[1]


def draw_bode(table: pd.DataFrame, shown: Sequence[Shown]) -> Markup:
    """Draw magnitude and phase of the open loop, with dots at the crossovers."""
    figure = new_figure(HALF, 460.0)
    top, low = add_axes(figure, (0.0, 0.46, 1.0, 0.54)), add_axes(figure, (0.0, 0.0, 1.0, 0.54))
    for entry in shown:
        w, value = curve_of(table, entry.name)
        if not len(w):
            continue
        size, phase = np.abs(value), np.degrees(np.unwrap(np.angle(value)))
        phase -= 360.0 * round((phase[0] + 90.0) / 360.0)  # the loop begins between -270° and +90°
        top.plot(w, size, **entry.style)
        low.plot(w, phase, **entry.style)
        # Gain crossover: |L| falls below 1; the last one defines the phase margin.
        crossing = np.flatnonzero((size[:-1] >= 1.0) & (size[1:] < 1.0))
        # A loop may cross the unit circle several times.
        for k in crossing[-1:]:
            for axes, values in ((top, size), (low, phase)):
                axes.plot(w[k], values[k], marker="o", markersize=6.0, color=THEME[entry.colour], linestyle="none")
    make_log(top, "x")
    make_log(low, "x")
    make_log(top, "y")
    top.axhline(1.0, color=THEME["muted"], linewidth=1.0)
    low.axhline(-180.0, color=THEME["muted"], linewidth=1.0)
    # Resonances and integrators would hide the region around the crossover.
    bottom, highest = top.get_ylim()
    top.set_ylim(max(bottom, 1e-3), min(highest, 1e4))
    bottom, highest = low.get_ylim()
    low.set_ylim(max(bottom, -400.0), min(highest, 120.0))
    # Steps of 45 and 90 degrees.
    low.yaxis.set_major_locator(MaxNLocator(6, steps=[1, 4.5, 9]))
    low.set_xlim(top.get_xlim())
    label(top, "", "Open loop |L| [1]")
    label(low, "Frequency [rad/s]", "Phase [°]")
    top.tick_params(labelbottom=False)
    return embed(figure, "bode", "Bode diagram of the open loop")


def draw_nyquist(table: pd.DataFrame, shown: Sequence[Shown], max_ms: float, margins: Mapping[str, float]) -> Markup:
    """Draw the open loop in the complex plane, the circle of the largest allowed Ms, and the margins of the best.

    Args:
        table: candidate, omega, re, im.
        shown: candidates.
        max_ms: Ms of the circle.
        margins: margins of the last one of `shown`: gain_margin [1], phase_margin_deg [°].
    """
    figure = new_figure(HALF, 460.0)
    axes = add_axes(figure, (0.0, 0.0, 1.0, 1.0))
    turn = np.linspace(0.0, 2.0 * math.pi, 181)
    axes.plot(np.cos(turn), np.sin(turn), color=THEME["grid"], linewidth=1.3)
    radius = 1.0 / max_ms
    # |1 + L| >= 1 / Ms: outside of this circle around -1, the sensitivity stays below Ms.
    axes.fill(radius * np.cos(turn) - 1.0, radius * np.sin(turn), color=THEME["alarm"], alpha=0.13, linewidth=0.0)
    axes.plot(radius * np.cos(turn) - 1.0, radius * np.sin(turn), color=THEME["alarm"], linewidth=1.3)
    axes.text(-1.0, radius + 0.05, f"Ms = {max_ms:g}", color=THEME["alarm"], ha="center", fontsize=12.0)
    axes.plot(-1.0, 0.0, marker="+", markersize=11.0, markeredgewidth=2.0, color=THEME["alarm"])
    for entry in shown:
        _, value = curve_of(table, entry.name)
        axes.plot(value.real, value.imag, **entry.style)
    last = shown[-1] if shown else None
    if last is not None:
        gain, phase = margins.get("gain_margin"), margins.get("phase_margin_deg")
        if phase is not None and math.isfinite(phase):
            # The phase margin is the angle between -180 deg and the crossing of the unit circle.
            angle = math.radians(phase) - math.pi
            arc = np.linspace(-math.pi, angle, 40)
            axes.plot(np.cos(arc), np.sin(arc), color=THEME[last.colour], linewidth=3.2, alpha=0.55)
            axes.plot(math.cos(angle), math.sin(angle), marker="o", markersize=6.5, color=THEME[last.colour])
            axes.annotate(f"{phase:.0f}°", (math.cos(angle), math.sin(angle)), xytext=(-8, -14),
                          textcoords="offset points", ha="right", fontsize=12.0)  # fmt: skip
        if gain is not None and math.isfinite(gain) and gain > 0.0:
            # The loop crosses the negative axis at -1 / gain margin.
            axes.plot(-1.0 / gain, 0.0, marker="o", markersize=6.5, color=THEME[last.colour])
            axes.annotate(f"1/{gain:.2g}", (-1.0 / gain, 0.0), xytext=(2, 8), textcoords="offset points", fontsize=12.0)
    axes.axhline(0.0, color=THEME["muted"], linewidth=0.8, zorder=1.0)
    axes.axvline(0.0, color=THEME["muted"], linewidth=0.8, zorder=1.0)
    label(axes, "Re L", "Im L")
    # The axes have the ratio of the box, so that angles are seen as they are.
    box = axes.get_window_extent()
    axes.set_xlim(-2.6, 1.1)
    axes.set_ylim(-2.2, -2.2 + 3.7 * box.height / box.width)  # circles are round
    return embed(figure, "nyquist", "Nyquist diagram of the open loop with the circle of Ms")


def draw_distribution(table: pd.DataFrame, figure_name: str, title: str, shown: Sequence[Shown]) -> Markup:
    """Draw the distribution of a figure in the Monte Carlo; failed runs are missing at the upper end."""
    figure = new_figure(WIDE, 300.0)
    axes = add_axes(figure, (0.0, 0.0, 1.0, 1.0))
    tops = []
    for entry in shown:
        rows = table[table["candidate"] == entry.name]
        if rows.empty:
            continue
        good = rows.loc[rows["status"] == "ok", figure_name].to_numpy(dtype=float)
        good = np.sort(good[np.isfinite(good)])
        if len(good):
            # Relative to all runs: failed ones are missing, so that the curve ends below 100 %.
            share = 100.0 * np.arange(1, len(good) + 1) / len(rows)
            axes.plot(
                np.concatenate(([good[0]], good)), np.concatenate(([0.0], share)), drawstyle="steps-post", **entry.style
            )
            tops.append(float(good[-1]))
    axes.set_ylim(0.0, 103.0)
    axes.axhline(100.0, color=THEME["muted"], linewidth=0.8)
    # A candidate that is far worse would hide the others; a ratio of figures has a meaning only if they are positive.
    if len(tops) > 1 and max(tops) > 6.0 * min(tops) > 0.0:
        axes.set_xlim(0.0, 6.0 * min(tops))
    label(axes, title, "Share of the runs [%]")
    return embed(figure, "spread", f"Distribution of {title} over the Monte Carlo")


def draw_schedule(schedule: Sequence[ScheduleRow], gains: Sequence[str]) -> Markup:
    """Draw the gains over speed, each relative to its largest value."""
    figure = new_figure(WIDE, 260.0)
    axes = add_axes(figure, (0.0, 0.0, 1.0, 1.0))
    speeds = [row.speed for row in schedule]
    for number, name in enumerate(gains):
        values = np.array([row.gains.get(name, 0.0) for row in schedule])
        if values.any():
            colour = THEME[("main", "own1", "own2", "own3")[number % 4]]
            axes.plot(speeds, values / np.abs(values).max(), color=colour, marker="o", markersize=5.0)
            axes.annotate(name, (speeds[-1], values[-1] / np.abs(values).max()), xytext=(6, 4),
                          textcoords="offset points", color=colour)  # fmt: skip
    label(axes, "Speed [m/s]", "Gain / largest gain [1]")
    return embed(figure, "schedule", "Gains over speed")


def curve_of(table: pd.DataFrame, name: str) -> tuple[Array, NDArray[np.complex128]]:
    """Return frequencies [rad/s] and open-loop frequency response of a candidate; empty without data."""
    rows = table[table["candidate"] == name].sort_values("omega")
    value = rows["re"].to_numpy(dtype=float) + 1j * rows["im"].to_numpy(dtype=float)
    keep = np.isfinite(value)
    return rows["omega"].to_numpy(dtype=float)[keep], value[keep]


# --- helpers ----------------------------------------------------------------------------------------------------------


def _grid(table: pd.DataFrame, name: str, x: Array, y: Array) -> Array:
    """Return a column of the map as rows of y and columns of x; nan for missing points."""
    x_name, y_name = map_gains(table)
    values = table.assign(**{name: table[name].astype(float)})
    grid = values.pivot_table(index=y_name, columns=x_name, values=name, aggfunc="first", dropna=False)
    return np.asarray(grid.reindex(index=y, columns=x).to_numpy(dtype=float))


def _is_log(values: Array) -> bool:
    if len(values) < 3 or values[0] <= 0.0:
        return False
    # Equal ratios from value to value mean a logarithmic grid.
    steps = np.diff(np.log(values))
    return bool(np.ptp(steps) < 0.2 * steps.mean() and values[-1] > 3.0 * values[0])


def _edges(values: Array, log: bool) -> Array:
    """Return the borders of the cells around the values."""
    inside = np.log(values) if log else values
    if len(inside) == 1:
        return np.array([values[0] * 0.9, values[0] * 1.1 or 1.0])
    middle = 0.5 * (inside[1:] + inside[:-1])
    # The outer borders mirror the inner ones.
    borders = np.concatenate(([inside[0] - (middle[0] - inside[0])], middle, [2.0 * inside[-1] - middle[-1]]))
    return np.asarray(np.exp(borders) if log else borders)


def _edge_lines(stable: NDArray[np.bool_], x: Array, y: Array) -> list[tuple[list[float], list[float]]]:
    """Return the borders between stable and unstable cells."""
    # A border between two cells in one row is vertical, between two rows horizontal.
    lines = [([x[j + 1]] * 2, [y[i], y[i + 1]]) for i, j in np.argwhere(stable[:, 1:] != stable[:, :-1])]
    lines += [([x[j], x[j + 1]], [y[i + 1]] * 2) for i, j in np.argwhere(stable[1:] != stable[:-1])]
    return lines


def _scale_bar(figure: Figure, bounds: Array) -> None:
    axes = figure.add_axes((0.872, 0.14, 0.022, 0.78))
    for step in range(SCALE_STEPS):
        axes.fill_between([0.0, 1.0], step, step + 1, color=SCALE[step], linewidth=0.0)
    axes.set_ylim(0, SCALE_STEPS)
    axes.set_xlim(0, 1)
    axes.set_xticks([])
    axes.spines["bottom"].set_visible(False)
    axes.yaxis.tick_right()
    axes.set_yticks(range(SCALE_STEPS + 1), [format_quantity(float(value)) for value in bounds])
    # Above the number of the upper end, which is half a line higher than the bar.
    axes.set_title("Cost", fontsize=12.0, color=THEME["muted"], loc="left", pad=14.0)
