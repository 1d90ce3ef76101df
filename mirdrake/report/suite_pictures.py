"""Pictures of a suite's report as SVG: the map of a case, margins over time, bars."""

import math
from collections.abc import Sequence

import numpy as np
from markupsafe import Markup, escape

from mirdrake.report.drive_layers import DrivenLine, VehicleOutline, driven_lines, vehicles
from mirdrake.report.map_props import props
from mirdrake.report.map_sheet import PAGE, Box, Sheet
from mirdrake.report.words import format_quantity
from mirdrake.report.world_map import Layer, draw_figure, signals, surfaces
from mirdrake.suites.trace import MarginCurve, Trace
from mirdrake.worlds import World

_MAP, _HEIGHTS = 520.0, (190.0, 460.0)  # [px] width of a map, its least and largest height
_AROUND = 8.0  # [m] shown around the drive
_WIDEST = 40.0  # [m] width that a map shows at least
_CURVE = (520.0, 104.0)  # [px] width and height of a curve
_LEFT, _RIGHT, _TOP, _BOTTOM = 66.0, 18.0, 8.0, 20.0  # [px] around its axes


def draw_case(world: World, trace: Trace | None, worst: int | None, *, failed: bool) -> Markup:
    """Return the map of a case: the world, the driven line, the vehicle at its worst moment.

    Args:
        world: world of the case.
        trace: trace of its drive; None if it was not driven.
        worst: index of the curve whose worst moment is shown.
        failed: whether its requirement failed.
    """
    sheet = Sheet.around(_bounds(world, trace), _MAP, _HEIGHTS)
    layers: list[Layer] = [surfaces, signals, props]
    if trace is not None:
        outlines = [
            VehicleOutline(corners, label) for corners, label in ((trace.start, "start"), (trace.end, "end")) if corners
        ]
        # The vehicle at the decisive moment, ringed, so that it is found on a large map.
        if worst is not None and trace.curves[worst].outline:
            curve = trace.curves[worst]
            label = f"{curve.worst_time:.2f} s"
            outlines += [VehicleOutline(corners, name, other=True) for name, corners in curve.others.items()]
            outlines.append(VehicleOutline(curve.outline, label, ring=True, failed=failed))
        x, y = np.reshape(np.asarray(trace.line, dtype=float), (-1, 2)).T
        layers += [driven_lines([DrivenLine(x, y)], width=2.2), vehicles(outlines, np.column_stack((x, y)))]
    description = "The world from above with the driven line." if trace is not None else "The world from above."
    return draw_figure(world, sheet, PAGE, layers, kind="plot map", description=description)


def _bounds(world: World, trace: Trace | None) -> Box:
    """Return the region of a map [m]: the drive with a margin; the whole world if nothing was driven."""
    points: list[Sequence[float]] = []
    if trace is not None:
        points += [*trace.line, *trace.start, *trace.end]
        points += [point for curve in trace.curves for point in curve.outline]
    # Nothing was driven if the run failed in its first step; the whole world then shows where things are.
    if not points:
        areas = [road.area for road in world.road_areas] + [prop.footprint for prop in world.props]
        areas += [goal.area for goal in world.goals.values() if goal.area is not None]
        points = [corner for area in areas for corner in np.reshape(area.bounds, (2, 2)).tolist()] or [[0.0, 0.0]]
    low, high = np.min(points, axis=0) - _AROUND, np.max(points, axis=0) + _AROUND
    # A straight drive along y would give a very narrow picture.
    grow = max(0.0, _WIDEST - float(high[0] - low[0])) / 2.0
    return float(low[0]) - grow, float(low[1]), float(high[0]) + grow, float(high[1])


def draw_speed(trace: Trace) -> Markup:
    """Return the chart of the speed over time; empty if the trace has none."""
    curve = MarginCurve(trace.times, trace.speeds, worst_time=0.0, outline=[])
    return draw_curve(curve, unit="m/s", margin=None, passed=True, quantity="Speed")


def draw_curve(
    curve: MarginCurve, *, unit: str, margin: float | None, passed: bool, quantity: str = "Margin"
) -> Markup:
    """Return the chart of a margin over time, with a dot at the decisive moment; a failure is red below zero.

    Args:
        curve: margin over time.
        unit: unit of the margin.
        margin: margin of the requirement; None if it is not finite.
        passed: whether the requirement holds.
        quantity: what the chart shows, if it is not a margin.
    """
    width, height = _CURVE
    known = [float(value) for value in curve.margins if value is not None]
    if not known:
        return Markup("")
    # Zero is always in view: it separates passed from failed.
    low, high = min(0.0, *known), max(0.0, *known)
    room = 0.08 * (high - low) or 0.1
    low, high = low - room, high + room
    first = float(curve.times[0])
    last = max(float(curve.times[-1]), first + 1e-3)

    def x_of(time: float) -> float:
        return _LEFT + (time - first) / (last - first) * (width - _LEFT - _RIGHT)

    def y_of(value: float) -> float:
        return _TOP + (high - value) / (high - low) * (height - _TOP - _BOTTOM)

    # Axes first; the curve is drawn over them, and a failed margin has an area below zero.
    zero, parts = y_of(0.0), []
    # The unit is written once, at the last tick.
    values = _ticks(low, high, 3)
    for value in values:
        y, mark = y_of(value), f"{_number(value)} {unit if value == values[-1] else ''}".strip()
        parts.append(f'<path class="grid" d="M{_LEFT:.0f} {y:.1f}H{width - _RIGHT:.0f}"/>')
        parts.append(f'<text x="{_LEFT - 6:.0f}" y="{y + 4:.1f}" text-anchor="end">{escape(mark)}</text>')
    times = _ticks(first, last, 6)
    parts += [
        f'<text x="{x_of(time):.1f}" y="{height - 5:.0f}" text-anchor="middle">{_number(time)}'
        f"{' s' if time == times[-1] else ''}</text>"
        for time in times
    ]
    for piece in _pieces(curve):
        line = " ".join(f"{x_of(t):.1f} {y_of(v):.1f}" for t, v in piece)
        # Values above zero are cut to it, so that the area is only below.
        below = " ".join(f"{x_of(t):.1f} {max(y_of(v), zero):.1f}" for t, v in piece)
        ends = x_of(piece[-1][0]), x_of(piece[0][0])
        if not passed:
            parts.append(f'<path class="below" d="M{below}L{ends[0]:.1f} {zero:.1f}H{ends[1]:.1f}Z"/>')
        parts.append(f'<path class="curve" d="M{line}"/>')
    parts.append(f'<path class="zero" d="M{_LEFT:.0f} {zero:.1f}H{width - _RIGHT:.0f}"/>')
    # A decisive moment outside of the recorded range is drawn at its edge.
    if margin is not None:
        x, y = x_of(min(max(curve.worst_time, first), last)), y_of(min(max(margin, low), high))
        parts.append(f'<circle class="dot{"" if passed else " bad"}" cx="{x:.1f}" cy="{y:.1f}" r="4"/>')
    moment = f"; the decisive moment is {curve.worst_time:g} s" if quantity == "Margin" else ""
    text = f"{quantity} over time [{unit or '-'}]{moment}."
    return _svg("margin", width, height, text, parts)


def draw_bar(margin: float | None, largest: float, *, passed: bool) -> Markup:
    """Return a bar from the middle: to the right for a requirement that holds, to the left for a failure."""
    # Without a finite margin, the bar is full.
    share = 1.0 if margin is None else min(1.0, abs(margin) / largest) if largest > 0.0 else 0.0
    length = max(1.5, 40.0 * share)
    x = 41.0 if passed else 41.0 - length
    rect = f'<rect class="{"good" if passed else "bad"}" x="{x:.1f}" y="2" width="{length:.1f}" height="8" rx="1.5"/>'
    return _svg("tiny", 82.0, 12.0, "", [rect, '<path class="zero" d="M41 0V12"/>'])


def _pieces(curve: MarginCurve) -> list[list[tuple[float, float]]]:
    """Return the stretches without gaps: times and margins."""
    pieces: list[list[tuple[float, float]]] = [[]]
    for time, value in zip(curve.times, curve.margins, strict=True):
        if value is None:
            pieces.append([])
        else:
            pieces[-1].append((time, value))
    return [piece for piece in pieces if piece]


def _ticks(low: float, high: float, count: int) -> list[float]:
    # Steps of 1, 2 or 5 times a power of ten with at most `count` of them.
    step = 10.0 ** math.floor(math.log10((high - low) / count))
    step *= next(factor for factor in (1.0, 2.0, 5.0, 10.0) if (high - low) / (step * factor) <= count)
    return [step * index for index in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]


def _number(value: float) -> str:
    # A true minus sign, as in the other numbers.
    return format_quantity(value, digits=2) if value % 1.0 else f"{value:.0f}".replace("-", "−")


def _svg(name: str, width: float, height: float, label: str, parts: Sequence[str]) -> Markup:
    role = f'role="img" aria-label="{escape(label)}"' if label else 'aria-hidden="true"'
    return Markup(f'<svg class="{name}" viewBox="0 0 {width:.0f} {height:.0f}" {role}>{"".join(parts)}</svg>')
