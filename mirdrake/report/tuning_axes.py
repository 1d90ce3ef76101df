"""Axes, scales and colours that the charts of the tuning report share."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from mirdrake.report.figures import to_svg
from mirdrake.report.svg import SCALE_STEPS, THEME, embed_svg

Array = NDArray[np.float64]

WIDE, HALF = 1000.0, 480.0  # [px]
_LEFT, _RIGHT, _TOP, _BOTTOM = 60.0, 14.0, 12.0, 44.0  # [px]
SCALE = [THEME[f"scale{step}"] for step in range(SCALE_STEPS)]
"""Colours from good to bad."""


@dataclass(frozen=True)
class Shown:
    """A candidate in the charts.

    Attributes:
        name: name of the candidate.
        role: baseline, best rule, best or nearest.
        colour: a key of THEME.
        dashed: whether its line is dashed.
    """

    name: str
    role: str
    colour: str
    dashed: bool = False

    @property
    def style(self) -> dict[str, Any]:
        """Style of its line, for Matplotlib."""
        return {
            "color": THEME[self.colour],
            "linestyle": "dashed" if self.dashed else "solid",
            "linewidth": 1.4 if self.dashed else 1.9,
        }


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure of a width and height in pixels."""
    return Figure(figsize=(width / 72.0, height / 72.0), dpi=72.0)


def add_axes(figure: Figure, box: tuple[float, float, float, float]) -> Axes:
    """Add axes inside a part of the figure (left, bottom, width, height as fractions), with room for their labels."""
    # Margins are in points, for text of one size, while Matplotlib wants fractions of the figure.
    width, height = 72.0 * figure.get_figwidth(), 72.0 * figure.get_figheight()
    left, bottom, wide, high = box[0] * width, box[1] * height, box[2] * width, box[3] * height
    return figure.add_axes(
        (
            (left + _LEFT) / width,
            (bottom + _BOTTOM) / height,
            (wide - _LEFT - _RIGHT) / width,
            (high - _BOTTOM - _TOP) / height,
        )
    )


def label(axes: Axes, x: str, y: str) -> None:
    """Set the labels of the axes and draw a grid."""
    axes.grid(color=THEME["grid"], linewidth=1.0)
    axes.set_xlabel(x, labelpad=3.0)
    axes.set_ylabel(y)
    axes.yaxis.set_label_coords(-(_LEFT - 12.0) / axes.get_window_extent().width, 0.5)


def make_log(axes: Axes, axis: str) -> None:
    """Make the axis x or y logarithmic, after its limits are set."""
    getattr(axes, f"set_{axis}scale")("log")
    scale = axes.xaxis if axis == "x" else axes.yaxis
    low, high = getattr(axes, f"get_{axis}lim")()
    narrow = low > 0.0 and math.log10(high / low) < 1.7
    scale.set_major_locator(LogLocator(10.0, subs=(1.0, 2.0, 5.0) if narrow else (1.0,), numticks=8))
    scale.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    scale.set_minor_formatter(NullFormatter())


def embed(figure: Figure, prefix: str, text: str) -> Markup:
    """Return a figure as an SVG element; the prefix makes its ids unique on the page."""
    return Markup(
        embed_svg(to_svg(figure), f"{prefix}-", attributes={"class": "plot", "role": "img", "aria-label": text})
    )


def colour_bounds(values: Array) -> Array:
    """Return the borders of the colours, from the best to the worst, with the same number of values in each."""
    bounds = np.quantile(values, np.linspace(0.0, 1.0, SCALE_STEPS + 1))
    min_difference = 1e-9 * max(abs(float(bounds[-1])), 1e-12)
    return np.asarray(np.maximum.accumulate(bounds + min_difference * np.arange(len(bounds))))
