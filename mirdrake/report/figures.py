"""Charts over time, drawn by Matplotlib without pyplot, each in a wide and a narrow version.

Curves are thinned to the resolution of the screen (:func:`thin`), so that a run of an hour costs as much as one of a
minute. Texts in a chart are SVG texts in the font of the page.
"""

import io
import json
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from mirdrake.core.curves import thin
from mirdrake.readers.units import format_unit
from mirdrake.report.svg import THEME, embed_svg
from mirdrake.report.words import format_quantity

Array = NDArray[np.float64]

_WIDE, _NARROW = 960.0, 400.0  # [px]
_PANEL_HEIGHT = {_WIDE: 190.0, _NARROW: 150.0}
_BUCKETS = {_WIDE: 600, _NARROW: 250}  # two points of each are kept: the lowest and the highest
_LEFT, _RIGHT, _TOP, _BOTTOM, _GAP = 50.0, 12.0, 24.0, 36.0, 20.0  # [px]
_FONT_SIZE = 12.0  # [px]


@dataclass(frozen=True)
class Curve:
    """One line of a panel.

    Attributes:
        name: name in the legend.
        values: N numbers in the unit of the panel; NaN where there is none.
        colour: a key of :data:`mirdrake.report.svg.THEME`.
        dashed: whether the line is dashed, as for set-points.
        width: width of the line [px]; of two lines that may coincide, the lower one is wider.
    """

    name: str
    values: Array
    colour: str
    dashed: bool = False
    width: float = 1.6


@dataclass(frozen=True)
class Panel:
    """One pair of axes.

    Attributes:
        label: label of the vertical axis, without the unit.
        unit: unit of the vertical axis.
        curves: drawn in this order, the last one on top.
        limits: limits of the vertical axis; by default those of the curves.
        bands: (low, high, colour): shaded ranges of the vertical axis.
        zero: keep zero in view.
        trim: cut off spikes of fewer samples than this share [%], with a note.
        relative_height: 1 for a usual panel.
    """

    label: str
    unit: str
    curves: Sequence[Curve]
    limits: tuple[float, float] | None = None
    bands: Sequence[tuple[float, float, str]] = ()
    zero: bool = False
    trim: float = 0.0
    relative_height: float = 1.0


def drawing_style() -> AbstractContextManager[None]:
    """Return a context with the Matplotlib settings of reports, independent of the user's matplotlibrc."""
    # Only what changes the drawing is taken from the defaults; other settings of the user do not matter.
    settings = {
        name: matplotlib.rcParamsDefault[name]
        for name in ("font.family", "font.sans-serif", "path.simplify", "path.simplify_threshold", "axes.unicode_minus")
    }
    style: Any = {  # Matplotlib 3.11 lists every key as a literal type, 3.8 knows none
        **settings,
        # Texts stay texts, in the font of the page; paths would be larger and not searchable.
        "svg.fonttype": "none",
        # Without a fixed salt, ids differ from run to run, and so do the bytes of the page.
        "svg.hashsalt": "mirdrake",
        "text.usetex": False,
        # A name such as "a_b$" is not a formula.
        "text.parse_math": False,
        "font.size": _FONT_SIZE,
        "axes.edgecolor": THEME["muted"],
        "axes.labelcolor": THEME["muted"],
        "axes.formatter.useoffset": False,
        "axes.formatter.limits": (-6, 7),
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.spines.left": False,
        "axes.linewidth": 1.0,
        "axes.axisbelow": True,
        "axes.grid": False,
        "xtick.color": THEME["muted"],
        "ytick.color": THEME["muted"],
        "xtick.major.size": 4.0,
        "ytick.major.size": 0.0,
        "text.color": THEME["ink"],
        "lines.solid_joinstyle": "round",
        "lines.dashed_pattern": (4.0, 2.5),
        "figure.dpi": 72.0,
        "savefig.dpi": "figure",
        "savefig.bbox": None,
        "savefig.facecolor": "auto",
    }
    return matplotlib.rc_context(style)


def to_svg(figure: Figure) -> str:
    """Return a figure as an SVG document; the same figure gives the same bytes."""
    buffer = io.StringIO()
    # Date and creator would make equal figures differ.
    figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def draw_chart(
    time: Array, panels: Sequence[Panel], prefix: str, description: str, *, marks: Sequence[float] = ()
) -> Markup:
    """Return panels one above the other with a common time axis.

    Args:
        time: N stamps [s], increasing.
        panels: panels from top to bottom.
        prefix: prefix of ids, unique in the page.
        description: text for readers who cannot see the picture.
        marks: times [s] of events, drawn as vertical lines.

    Returns:
        two SVG elements; the page shows the one that fits the screen.
    """
    pictures = [_draw(time, panels, prefix, description, marks, width=width) for width in (_WIDE, _NARROW)]
    return Markup("\n").join(pictures)


def _draw(
    time: Array, panels: Sequence[Panel], prefix: str, description: str, marks: Sequence[float], *, width: float
) -> Markup:
    # The height of the figure follows from its panels: the width is given by the page.
    heights = [_PANEL_HEIGHT[width] * panel.relative_height for panel in panels]
    total = sum(heights) + (_TOP + _GAP) * len(panels) - _GAP + _BOTTOM
    figure = Figure(figsize=(width / 72.0, total / 72.0), dpi=72.0)
    span = _time_span(time)
    boxes: list[dict[str, object]] = []
    data: dict[str, dict[str, str]] = {}
    top = 0.0
    # Panels are placed by hand: all charts of a page have the same margins, so that their time axes are aligned.
    for number, (panel, height) in enumerate(zip(panels, heights, strict=True)):
        top += _TOP
        box = (_LEFT / width, 1.0 - (top + height) / total, (width - _LEFT - _RIGHT) / width, height / total)
        axes = figure.add_axes(box)
        # Limits are those of all curves of the panel, trimmed where peaks would flatten the rest.
        low, high, note = _limits(panel)
        _draw_panel(axes, time, panel, span, (low, high), number, buckets=_BUCKETS[width])
        for mark in marks:
            axes.axvline(mark, color=THEME["alarm"], linewidth=1.0, linestyle=(0, (2, 2)), zorder=1.5)
        # Labels stand above the axes, horizontally: a vertical label is hard to read and takes width.
        lift = 9.0 / height
        axes.text(
            -(_LEFT - 4.0) / (width - _LEFT - _RIGHT),
            1.0 + lift,
            f"{panel.label} [{format_unit(panel.unit)}]",
            transform=axes.transAxes,
        )
        if note:
            axes.text(1.0, 1.0 + lift, note, transform=axes.transAxes, ha="right", color=THEME["muted"])
        # Only the lowest panel has numbers on the time axis, which all panels share.
        axes.xaxis.set_major_locator(MaxNLocator(10 if width == _WIDE else 5, steps=[1, 2, 5, 10]))
        if number == len(panels) - 1:
            axes.set_xlabel("Time [s]", labelpad=3.0)
        else:
            axes.tick_params(labelbottom=False)
        # The page's script shows the values under the pointer and needs the axes in pixels and in units.
        boxes.append(
            {
                "x": [_LEFT, width - _RIGHT],
                "t": span,
                "y": [top + height, top],
                "v": [low, high],
                "unit": format_unit(panel.unit),
            }
        )
        # Ids of the curves connect them to the legend and to the script.
        for index, curve in enumerate(panel.curves):
            data[f"curve-{number}-{index}"] = {"data-panel": str(number), "data-name": curve.name}
        top += height + _GAP
    attributes = {
        "class": f"plot {'wide' if width == _WIDE else 'narrow'}",
        "role": "img",
        "aria-label": description,
        "data-panels": json.dumps(boxes, separators=(",", ":")),
    }
    tag = prefix + ("w" if width == _WIDE else "n")
    return Markup(embed_svg(to_svg(figure), tag, attributes=attributes, data=data))


def _draw_panel(
    axes: Axes,
    time: Array,
    panel: Panel,
    span: tuple[float, float],
    limits: tuple[float, float],
    number: int,
    *,
    buckets: int,
) -> None:
    axes.set_xlim(*span)
    axes.set_ylim(*limits)
    axes.yaxis.set_major_locator(MaxNLocator(6 if panel.relative_height >= 0.8 else 3, steps=[1, 2, 5, 10]))
    axes.grid(axis="y", color=THEME["grid"], linewidth=1.0)
    for low, high, colour in panel.bands:
        axes.axhspan(low, high, color=THEME[colour], alpha=0.14, linewidth=0.0)
        # The edge as a line, as the shade alone is hard to see.
        for edge in (low, high):
            if limits[0] < edge < limits[1]:
                axes.axhline(edge, color=THEME[colour], linewidth=1.0)
    if limits[0] < 0.0 < limits[1]:
        axes.axhline(0.0, color=THEME["muted"], linewidth=0.8)
    for index, curve in enumerate(panel.curves):
        (line,) = axes.plot(
            *thin(time, curve.values, buckets),
            color=THEME[curve.colour],
            linewidth=1.2 if curve.dashed else curve.width,
            linestyle="dashed" if curve.dashed else "solid",
        )
        # The id is found again in the SVG to attach the name of the curve; see `embed_svg`.
        line.set_gid(f"curve-{number}-{index}")


def _time_span(time: Array) -> tuple[float, float]:
    if not len(time):
        return 0.0, 1.0
    first, last = float(time[0]), float(time[-1])
    return (first, last) if last > first else (first, first + 1.0)


def _limits(panel: Panel) -> tuple[float, float, str]:
    """Return the limits of the vertical axis, and a note about values outside."""
    if panel.limits is not None:
        return *panel.limits, ""
    values = np.concatenate([curve.values for curve in panel.curves]) if panel.curves else np.zeros(0)
    values = values[np.isfinite(values)]
    if not len(values):
        return 0.0, 1.0, "no values"
    lowest, highest = float(values.min()), float(values.max())
    low, high = lowest, highest
    if panel.trim and len(values) > 200:
        # Percentiles ignore short spikes; with few samples they are not meaningful.
        bottom, ceiling = (float(value) for value in np.percentile(values, (panel.trim, 100.0 - panel.trim)))
        reach = ceiling - bottom
        if high - low > 3.0 * reach > 0.0:
            low, high = max(low, bottom - 0.3 * reach), min(high, ceiling + 0.3 * reach)
    if panel.zero:
        low, high = min(low, 0.0), max(high, 0.0)
    # The third term keeps constant curves from a range of zero.
    room = max(0.06 * (high - low), 1e-3 * max(abs(low), abs(high)), 1e-9)
    if high - low < 1e-9:
        room = max(0.1 * abs(high), 0.1)
    low, high = (low if panel.zero and low == 0.0 else low - room), high + room
    # Only what is outside of the final limits is reported: an axis from 0 shows all drops to 0.
    peak = max(highest, lowest, key=lambda end: max(end - high, low - end))
    note = "" if low <= peak <= high else f"spikes to {format_quantity(peak, panel.unit)} not shown"
    return low, high, note
