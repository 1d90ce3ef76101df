"""The handling report: all manoeuvres of a vehicle on one page."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullFormatter, ScalarFormatter

from mirdrake.core.constants import GRAVITY
from mirdrake.core.curves import thin
from mirdrake.core.files import write_file
from mirdrake.manoeuvres.base import Chart, Metric, Outcome
from mirdrake.manoeuvres.registry import MANOEUVRES
from mirdrake.manoeuvres.results import (
    HandlingResults,
    format_figure,
    format_number,
    format_setting,
    format_status,
    recalled,
)
from mirdrake.readers.units import format_unit
from mirdrake.report.figures import drawing_style, to_svg
from mirdrake.report.page import Tile, render_page
from mirdrake.report.svg import THEME, embed_svg
from mirdrake.report.words import format_quantity
from mirdrake.single_track.dynamics import lateral_forces

_TEMPLATE = "handling.html.jinja"
_COLOURS = ("main", "own1", "edge", "own2", "own3")
_FILE_COLOURS = {
    "ink": "#17202a", "muted": "#5d6975", "grid": "#e5e8ec", "paper": "#ffffff", "edge": "#8a949e",
    "main": "#0067a5", "own1": "#c65000", "own2": "#00825e", "own3": "#a6378a",
}  # fmt: skip
_WIDTH, _HEIGHT, _MAP_WIDTH = 480.0, 300.0, 980.0  # [px]
_LEFT, _RIGHT, _TOP, _BOTTOM = 58.0, 14.0, 12.0, 44.0  # [px]
_POINTS = 400
_WORDS = {
    "done": "done",
    "pass": "passed",
    "fail": "failed",
    "not possible": "not possible",
    "diverged": "diverged",
}


def write_handling(results: HandlingResults) -> Path:
    """Write handling.html, and the figures of each manoeuvre as SVG, into the folder of the results.

    Raises:
        RunError: the file cannot be written.
    """
    assert results.folder is not None
    path = results.folder / "handling.html"
    write_file(path, render_handling(results))
    for outcome in results.outcomes:
        if outcome.charts:
            shown = [chart for chart in outcome.charts if _is_informative(chart)]
            write_file(results.folder / outcome.name / f"{outcome.name}.svg", draw_sheet(shown))
    return path


def render_handling(results: HandlingResults) -> str:
    """Return the page; see :func:`write_handling`."""
    # Charts are drawn with the style of reports, which is global in Matplotlib.
    with drawing_style():
        sections = [
            Section(
                outcome,
                _WORDS[outcome.verdict],
                _TONES[outcome.verdict],
                recalled(outcome),
                _charts(outcome),
                _key_figures(outcome),
            )
            for outcome in results.outcomes
        ]
    facts = results.facts
    return render_page(
        _TEMPLATE,
        filters={"figure": format_figure, "units": format_unit, "value": format_setting, "status": format_status},
        title=f"{facts.title} · handling",
        over=f"{facts.name} · handling report · {'full plant' if results.model == 'full' else 'single-track model'}",
        headline=f"{facts.title}: {_headline(results.outcomes)}",
        tiles=_tiles(results),
        notices=_warnings(results),
        sections=sections,
    )


def _tiles(results: HandlingResults) -> list[Tile]:
    facts, p = results.facts, results.facts.parameters
    # Static load of the front axle: the share of the distance from the centre of mass to the rear axle.
    front = 100.0 * p.rear_length / p.wheelbase
    per_g = math.degrees(facts.understeer) * GRAVITY
    scale = "full size" if facts.scale == 1.0 else f"estimated understeer gradient {per_g:.2f} deg/g"
    return [
        Tile("Mass", f"{format_number(facts.mass)} kg", f"{front:.0f} % on the front axle"),
        Tile("Wheelbase", f"{facts.wheelbase:.3f} m", f"{facts.width:.2f} m wide"),
        Tile("Height of centre of mass", f"{p.com_height:.3f} m", f"{facts.ahead:.3f} m ahead of the rear axle"),
        Tile("Steering ratio", f"{facts.ratio:g}", f"road wheels up to {math.degrees(facts.steering_limit):.0f}°"),
        Tile(
            "Tyres",
            facts.tyres.replace("_", " "),
            f"ground of friction {results.friction:g}; tyre data are those of 0.85, dry asphalt",
        ),
        Tile("Driven by", "pedals" if facts.pedals else "speed command", _powertrain(results)),
        Tile("Model", "full plant" if results.model == "full" else "single track", _plant(results)),
        Tile("Scale", f"{facts.scale:.3g}", scale),
    ]


def _powertrain(results: HandlingResults) -> str:
    return f"top speed on the flat {results.facts.top_speed * 3.6:.0f} km/h"


def _plant(results: HandlingResults) -> str:
    plant = results.plant
    if results.model != "full":
        # As of the variant that the rig chooses.
        kind = results.facts.tyres if results.facts.tyres in lateral_forces() else "brush"
        return f"{kind.replace('_', ' ')} tyres, relaxation"
    # The contact on the plane, and the vertical tyre on a relief.
    uneven = [MANOEUVRES[outcome.name].uneven for outcome in results.outcomes if outcome.name in MANOEUVRES]
    contacts = [str(plant.get("contact"))] * (not all(uneven) or not uneven) + ["tyre"] * any(uneven)
    step = 1000.0 * float(plant.get("time_step", 0.0))
    return f"{' and '.join(dict.fromkeys(contacts))} contact, step {step:g} ms"


def _warnings(results: HandlingResults) -> list[str]:
    warnings = []
    if not results.facts.has_slip and results.model == "full":
        warnings.append(
            "The tyres are of kind coulomb: dry friction without slip angles. Understeer, response times and the "
            "behaviour at the limit are those of dry friction, not of tyres."
        )
    if results.model == "single_track":
        warnings.append(
            "Load transfer and camber of the single-track model are those of small lateral accelerations, so that its "
            "largest one may be too high."
            if results.facts.has_slip
            else "The single-track model has assumed cornering stiffnesses, no roll and no lateral load transfer."
        )
    if not results.facts.pedals:
        warnings.append(
            "The vehicle is driven by a speed command: acceleration and braking are those of its speed control."
        )
    return warnings


def _headline(outcomes: Sequence[Outcome]) -> str:
    """Return the result: manoeuvres that failed, and the first headline figure of up to three others."""
    words = [_WORDS[outcome.verdict] for outcome in outcomes]
    bad = [word for word in dict.fromkeys(words) if word not in {"done", "passed"}]
    parts = [f"{words.count(word)} of {len(words)} manoeuvres {word}" for word in bad]
    figures = [figures[0] for outcome in outcomes if (figures := _headline_figures(outcome))]
    # Failures take the place of figures, as the title has room for three.
    parts += [_figure_text(metric) for metric in figures[: _MOST_FIGURES - len(parts)]]
    return ", ".join(parts) or f"{len(words)} manoeuvres done"


def _headline_figures(outcome: Outcome) -> list[Metric]:
    """Return the headline figures of a manoeuvre that have a value."""
    if outcome.verdict in {"not possible", "diverged"}:
        return []
    keys = MANOEUVRES[outcome.name].headline
    return [metric for metric in outcome.metrics if metric.key in keys and metric.value is not None]


def _key_figures(outcome: Outcome) -> str:
    """Return the headline figures as a text, or the reason why there are none."""
    if outcome.verdict in {"not possible", "diverged"}:
        return outcome.reason
    return "; ".join(map(_figure_text, _headline_figures(outcome)))


def _figure_text(metric: Metric) -> str:
    """Return a figure within a sentence: ``understeer gradient 0.87 deg/g``."""
    text = metric.text
    # Abbreviations such as ABS keep their capitals.
    lower = text if text[:2].isupper() or text[1:2] in {"", ",", " "} else f"{text[:1].lower()}{text[1:]}"
    link = " in" if " to " in lower else ""  # "0 to 100 km/h in 7.05 s"
    return f"{lower.removeprefix('from ')}{link} {format_quantity(metric.value, metric.unit)}"


_MOST_FIGURES = 3  # of the title


# --- charts ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class DrawnChart:
    """A chart of the page; `legend` has name, colour and style of each curve."""

    title: str
    picture: Markup
    legend: Sequence[tuple[str, str, str]]
    wide: bool


@dataclass(frozen=True)
class Section:
    """A manoeuvre on the page.

    Attributes:
        outcome: outcome of the manoeuvre.
        word: its verdict in words.
        tone: class of the verdict.
        recalled: names of settings whose values are not verified.
        charts: charts of its figures.
        key: headline figures, or the reason why there are none.
    """

    outcome: Outcome
    word: str
    tone: str
    recalled: list[str]
    charts: list[DrawnChart]
    key: str


_TONES = {"done": "plain", "pass": "good", "fail": "bad", "not possible": "plain", "diverged": "bad"}


def _charts(outcome: Outcome) -> list[DrawnChart]:
    """Return the charts that are not all zero; an odd half-width chart at the end becomes wide."""
    shown = [chart for chart in outcome.charts if _is_informative(chart)]
    halves = [number for number, chart in enumerate(shown) if not _is_map(chart)]
    # Half-width charts are side by side in pairs.
    alone = halves[-1] if len(halves) % 2 else -1
    return [
        _chart(chart, f"{outcome.name}{number}-", wide=_is_map(chart) or (number == alone and not chart.equal))
        for number, chart in enumerate(shown)
    ]


def _is_informative(chart: Chart) -> bool:
    """Whether a curve differs from zero; roll is zero in a model without roll."""
    return any(bool(np.any(np.abs(np.nan_to_num(line.y)) > 1e-9)) for line in chart.lines)


def _chart(chart: Chart, prefix: str, *, wide: bool) -> DrawnChart:
    """Return a chart with its legend."""
    figure = _figure_of([chart], THEME, width=_MAP_WIDTH if wide else _WIDTH)
    text = f"{chart.y_label} over {chart.x_label[:1].lower()}{chart.x_label[1:]}"
    # For readers who do not see the picture.
    text = "From above" if chart.y_label == "y" else text
    picture = embed_svg(to_svg(figure), prefix, attributes={"class": "plot", "role": "img", "aria-label": text})
    # A legend for a single curve would repeat the title of the axis.
    legend = [
        (line.name, _COLOURS[line.colour], line.style)
        for line in chart.lines
        if line.name and len({curve.name for curve in chart.lines if curve.name}) > 1
    ]
    return DrawnChart(text, Markup(picture), legend, wide)


def _is_map(chart: Chart) -> bool:
    return chart.x_label == "x" and chart.y_label == "y" and not chart.equal


def draw_sheet(charts: Sequence[Chart]) -> str:
    """Return all charts of a manoeuvre, one below the other, as an SVG document."""
    with drawing_style():
        text = to_svg(_figure_of(charts, THEME, width=_MAP_WIDTH if any(map(_is_map, charts)) else 640.0, legend=True))
    # A file of its own has no CSS variables of a page.
    for name, value in _FILE_COLOURS.items():
        text = text.replace(THEME[name], value)
    return re.sub(r"(<svg [^>]*>)", r'\1<rect width="100%" height="100%" fill="#ffffff"/>', text, count=1)


def _figure_of(charts: Sequence[Chart], theme: dict[str, str], *, width: float, legend: bool = False) -> Figure:
    # Equal axes need the height of their width; all others have the same height.
    rows = [_HEIGHT if not chart.equal else width * 1.5 for chart in charts]
    head = _TOP + (20.0 if legend else 0.0)
    total = sum(rows)
    figure = Figure(figsize=(width / 72.0, total / 72.0), dpi=72.0)
    top = total
    for chart, height in zip(charts, rows, strict=True):
        box = (_LEFT / width, (top - height + _BOTTOM) / total)
        axes = figure.add_axes((*box, (width - _LEFT - _RIGHT) / width, (height - _BOTTOM - head) / total))
        _draw(axes, chart, theme)
        # Names with an underscore are hidden by Matplotlib's convention.
        named = [line for line in axes.get_lines() if not str(line.get_label()).startswith("_")]
        if legend and len(named) > 1:
            axes.legend(
                handles=named, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, frameon=False, borderaxespad=0.1
            )
        top -= height
    return figure


def _draw(axes: Axes, chart: Chart, theme: dict[str, str]) -> None:
    seen: set[str] = set()
    # A name that several curves share is shown once in the legend; Matplotlib leaves out names that begin with "_".
    for line in chart.lines:
        x, y = np.asarray(line.x, dtype=float), np.asarray(line.y, dtype=float)
        # Only functions of x can be thinned by buckets; loops and dots by a step.
        if len(x) > 2 * _POINTS and line.style != "dots" and bool(np.all(np.diff(x) >= 0.0)):
            x, y = thin(x, y, _POINTS)
        elif len(x) > 2 * _POINTS:
            step = len(x) // _POINTS
            x, y = x[::step], y[::step]
        name = line.name if line.name and line.name not in seen else "_"
        seen.add(line.name)
        (drawn,) = axes.plot(x, y, color=theme[_COLOURS[line.colour]], label=name, linewidth=1.6)
        if line.style == "dashed":
            drawn.set(linestyle="dashed", linewidth=1.3)
        elif line.style == "dots":
            drawn.set(linestyle="none", marker="o", markersize=2.6, markeredgewidth=0.0)
    axes.grid(color=theme["grid"], linewidth=1.0)
    axes.set_xlabel(f"{chart.x_label} [{chart.x_unit}]", labelpad=3.0)
    axes.set_ylabel(f"{chart.y_label} [{chart.y_unit}]")
    # The same distance of all labels from the axis, whatever the width of its numbers.
    axes.yaxis.set_label_coords(-(_LEFT - 14.0) / axes.get_window_extent().width, 0.5)
    axes.yaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]))
    low, high = axes.get_ylim()
    # A constant curve would otherwise show rounding noise over the full height.
    if high - low < 1e-6 * max(abs(high), 1e-6) or high - low < 1e-7:
        axes.set_ylim(low - 0.5, high + 0.5)
    if chart.log:
        axes.set_xscale("log")
        # Fixed ticks, as a short logarithmic axis may have only one power of ten.
        axes.set_xticks([tick for tick in (0.2, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0) if _inside(axes, tick)])
        axes.xaxis.set_major_formatter(ScalarFormatter())
        axes.xaxis.set_minor_formatter(NullFormatter())
    else:
        axes.xaxis.set_major_locator(MaxNLocator(7, steps=[1, 2, 5, 10]))
    # Zero separates left from right in most charts.
    if low < 0.0 < high:
        axes.axhline(0.0, color=theme["muted"], linewidth=0.8)
    if chart.equal:
        axes.set_aspect("equal", adjustable="datalim")


def _inside(axes: Axes, tick: float) -> bool:
    low, high = axes.get_xlim()
    return bool(low <= tick <= high)
