"""Charts of the inner signals of a run: outputs of the blocks of control units, and of the blocks of a diagram."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas

from mirdrake.report.figures import Array, Curve, Panel, draw_chart
from mirdrake.report.vehicle_charts import Chart, numbers

COLOURS = ("main", "own1", "own2", "own3", "own4", "ink")
"""Colours of the curves of a panel; a panel has at most as many curves."""


def make_inner_charts(
    signals: pandas.DataFrame,
    units: Mapping[str, str],
    *,
    vehicles: Iterable[str],
    systems: Iterable[str],
    marks: Sequence[float] = (),
) -> list[Chart]:
    """Return a chart for each block with recorded signals, with a panel for each unit, or port without unit.

    Args:
        signals: all signals, one row per stamp.
        units: unit of each signal.
        vehicles: names of the vehicles, whose blocks are ``<vehicle>.control.<block>``.
        systems: names of the blocks of the diagram.
        marks: times of events [s].
    """
    # Signals of a vehicle's control belong to the block of three parts, `ego.control.speed_pid`; other blocks have one
    # part.
    inner, blocks = tuple(f"{name}.control." for name in vehicles), {name for name in systems if "." not in name}
    groups: dict[str, list[str]] = {}
    for column in map(str, signals.columns):
        parts = column.split(".")
        if column.startswith(inner):
            groups.setdefault(".".join(parts[:3]), []).append(column)
        elif parts[0] in blocks:
            groups.setdefault(parts[0], []).append(column)
    time = numbers(signals.index)
    # Blocks whose signals are all NaN have no chart.
    charts = (
        _chart(number, block, {name: numbers(signals[name]) for name in names}, units, time, marks)
        for number, (block, names) in enumerate(groups.items())
    )
    return [chart for chart in charts if chart is not None]


def _chart(
    number: int,
    block: str,
    columns: Mapping[str, Array],
    units: Mapping[str, str],
    time: Array,
    marks: Sequence[float],
) -> Chart | None:
    """Return the chart of a block; None if none of its signals has a finite value."""
    finite = {name: values for name, values in columns.items() if np.isfinite(values).any()}
    # One panel for each unit, and no more curves in it than there are colours. Signals without a unit may be of
    # different kinds, such as a speed and a distance: each port of them has its own panel.
    by_unit: dict[tuple[str, str], list[str]] = {}
    for name in finite:
        unit = units.get(name, "")
        port = "" if unit not in {"", "1"} else name.removeprefix(f"{block}.").partition(".")[0]
        by_unit.setdefault((unit, port), []).append(name)
    panels = []
    for (unit, _), names in by_unit.items():
        for start in range(0, len(names), len(COLOURS)):
            short = [name.removeprefix(f"{block}.") for name in names[start : start + len(COLOURS)]]
            label = _common_start(short)
            curves = [
                Curve(name.removeprefix(f"{label}."), finite[f"{block}.{name}"], colour)
                for name, colour in zip(short, COLOURS, strict=False)
            ]
            panels.append(Panel(label, unit or "1", curves, relative_height=0.7))
    if not panels:
        return None
    entries = [(curve.name, curve.colour, "") for panel in panels for curve in panel.curves]
    legend: list[tuple[str, str, str]] = list(dict.fromkeys(entries))
    caption = "As the actuators of the control unit sample them." if ".control." in block else ""
    picture = draw_chart(time, panels, f"inner{number}-", f"Signals of {block} against time.", marks=marks)
    return Chart(f"inner-{number}", block, caption, picture, legend)


def _common_start(names: Sequence[str]) -> str:
    """Return the only name, or the first part of all names, such as ``torque``; "signals" without one."""
    if len(names) == 1:
        return names[0]
    first: Any = {name.partition(".")[0] for name in names}
    return first.pop() if len(first) == 1 else "signals"
