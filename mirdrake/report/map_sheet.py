"""The sheet on which a world is drawn from above: metres to pixels, palettes, elements of SVG."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import matplotlib
import numpy as np
import shapely
from markupsafe import escape
from numpy.typing import NDArray
from PIL import ImageFont
from shapely.geometry.base import BaseGeometry

from mirdrake.worlds import PlacedProp

Array = NDArray[np.float64]
Box = tuple[float, float, float, float]
"""Left, top, right, bottom in the picture [px]."""


class Sheet:
    """A rectangle of the world [m] in a rectangle of a picture [px]; x of W to the right, y up.

    Attributes:
        x: smallest x of W in the picture [m]; `y` likewise.
        scale: [px/m].
        left: left edge of the rectangle in the picture [px]; `top`, `bottom`, `width` and `height` likewise.
    """

    def __init__(
        self, corner: tuple[float, float], scale: float, size: tuple[float, float],
        *, left: float = 0.0, top: float = 0.0, decimals: int = 1,
    ) -> None:  # fmt: skip
        self.x, self.y = corner
        self.scale, (self.width, self.height) = scale, size
        self.left, self.top, self.bottom = left, top, top + size[1]
        self._decimals = decimals
        # Only what is near the rectangle is written; a margin keeps the cut edges outside of the picture.
        margin, (wide, high) = 10.0 / scale, (size[0] / scale, size[1] / scale)
        self._window = (self.x - margin, self.y - margin, self.x + wide + margin, self.y + high + margin)

    @classmethod
    def around(
        cls, bounds: Box, width: float, heights: tuple[float, float], *, margin: float = 0.0, foot: float = 0.0
    ) -> "Sheet":
        """Return a sheet that shows a region of W in its middle, as large as possible.

        Args:
            bounds: smallest x and y, largest x and y of the region [m].
            width: width of the picture [px].
            heights: least and largest height of the picture [px].
            margin: around the region [px].
            foot: kept free below the region, for the scale bar [px].
        """
        x0, y0, x1, y1 = bounds
        # The whole region fits: the direction with less room decides.
        scale = min((width - 2.0 * margin) / (x1 - x0), (heights[1] - 2.0 * margin - foot) / (y1 - y0))
        height = min(max(heights[0], (y1 - y0) * scale + 2.0 * margin + foot), heights[1])
        corner = ((x0 + x1 - width / scale) / 2.0, (y0 + y1 - (height + foot) / scale) / 2.0)
        return cls(corner, scale, (width, height))

    def place(self, points: object) -> Array:
        """Return points (n, 2) of W in the picture [px]."""
        xy = np.atleast_2d(np.asarray(points, dtype=float))
        return np.column_stack(
            (self.left + (xy[:, 0] - self.x) * self.scale, self.bottom - (xy[:, 1] - self.y) * self.scale)
        )

    def line(self, points: object, *, closed: bool = False) -> str:
        """Return points of W as the data of an SVG path."""
        digits = self._decimals
        return "M" + "L".join(f"{x:.{digits}f} {y:.{digits}f}" for x, y in self.place(points).tolist()) + "Z" * closed

    def path(self, area: BaseGeometry) -> str:
        """Return the visible part of an area of W as the data of an SVG path; empty if none is visible."""
        # Details below a sixth of a pixel are not visible.
        simple = shapely.simplify(area, 0.15 / self.scale)
        if not _within(simple.bounds, self._window):
            simple = shapely.clip_by_rect(simple, *self._window)
        parts = [part for part in shapely.get_parts(simple) if part.geom_type == "Polygon" and not part.is_empty]
        rings = [ring for part in parts for ring in (part.exterior, *part.interiors)]
        return "".join(self.line(shapely.get_coordinates(ring)[:-1], closed=True) for ring in rings)

    def polyline(self, points: Array) -> str:
        """Return the visible parts of a polyline of W as the data of an SVG path; empty if none is visible."""
        if len(points) < 2:
            return ""
        line: BaseGeometry = shapely.LineString(points).simplify(0.15 / self.scale, preserve_topology=False)
        if not _within(line.bounds, self._window):
            line = shapely.clip_by_rect(line, *self._window)
        parts = [part for part in shapely.get_parts(line) if part.geom_type == "LineString" and not part.is_empty]
        return "".join(self.line(shapely.get_coordinates(part)) for part in parts)

    def bounds(self, area: BaseGeometry) -> Box:
        """Return the box around an area of W in the picture: left, top, right, bottom [px]."""
        (x0, y1), (x1, y0) = self.place(np.reshape(area.bounds, (2, 2))).tolist()
        return x0, y0, x1, y1


def _within(inner: tuple[float, ...], outer: Box) -> bool:
    return inner[0] >= outer[0] and inner[1] >= outer[1] and inner[2] <= outer[2] and inner[3] <= outer[3]


# --- palettes ----------------------------------------------------------------------------------------------------

_GROUND = {"asphalt": "#e3e4e6", "concrete": "#ebe8e1", "grass": "#e0ecd3", "gravel": "#eee5d3", "ice": "#e2f3fa"}
_ROAD = {"asphalt": "#b7bcc3", "concrete": "#cfcac0", "grass": "#b5d09a", "gravel": "#d5c39c", "ice": "#a6d8ee"}
_KINDS = {
    "barrel": "#e8742a", "box": "#a89a88", "building": "#b8a590", "cone": "#f08632", "cylinder": "#9c92ad",
    "house": "#c08f72", "jersey_barrier": "#9da3a9", "lamp_post": "#6b7280", "pedestrian": "#c02a78",
    "cyclist": "#d2691e", "sedan": "#5c81ab", "speed_bump": "#d9ad2b", "sphere": "#7fa3a0", "stop_sign": "#c8322b",
    "thrift_store": "#b98f5d", "traffic_light": "#c99a16", "tree": "#74a85e", "van": "#8276ab", "wall": "#a8806a",
}  # fmt: skip
_PLAIN_PATCH = "#d7c4e8"  # a patch without a surface of its own
_OTHER_KINDS = ("#4f9a94", "#a5678e", "#8d8a3f", "#6f86c9", "#b5735a", "#5f9e6e")
INK, MUTED = "#1f2937", "#6b7280"


@dataclass(frozen=True)
class Palette:
    """Colours of a world from above.

    Attributes:
        ink: texts and arrows; `muted`, `paper`, `marking`, `start`, `goal`, `alarm`, `vehicle` likewise.
        ground: map from a surface to the fill of the ground.
        road: map from a surface to the fill of a track.
        patch: map from a surface, or None, to the fill of a patch.
        prop: map from a prop to its fill.
        edge: map from a fill to the colour of its edge.
        detailed: whether elements have tooltips and the fronts of vehicles are drawn.
    """

    ink: str
    muted: str
    paper: str
    marking: str
    start: str
    goal: str
    alarm: str
    vehicle: str
    ground: Callable[[str], str]
    road: Callable[[str], str]
    patch: Callable[[str | None], str]
    prop: Callable[[PlacedProp], str]
    edge: Callable[[str], str]
    detailed: bool


def fill_of(placed: PlacedProp) -> str:
    """Return the colour of a prop: its own, or that of its kind."""
    if placed.color is not None:
        return "#" + "".join(f"{round(255.0 * min(1.0, max(0.0, part))):02x}" for part in placed.color)
    kind = placed.prop.name
    return _KINDS.get(kind) or _OTHER_KINDS[sum(kind.encode()) % len(_OTHER_KINDS)]


def _channels(color: str) -> tuple[int, int, int]:
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)


def darken(color: str) -> str:
    """Return the edge colour of an area with a fill colour."""
    return "#" + "".join(f"{round(0.58 * part):02x}" for part in _channels(color))


def ink_on(color: str) -> str:
    """Return black or white, whichever has more contrast with a colour."""
    red, green, blue = _channels(color)
    return "#ffffff" if 0.299 * red + 0.587 * green + 0.114 * blue < 140.0 else "#111827"


DOCUMENT = Palette(
    ink=INK, muted=MUTED, paper="#ffffff", marking="#ffffff", start="#1d4ed8", goal="#15803d", alarm="#dc2626",
    vehicle="#1d4ed8", ground=_GROUND.__getitem__, road=_ROAD.__getitem__,
    patch=lambda surface: _ROAD.get(surface or "", _PLAIN_PATCH), prop=fill_of, edge=darken, detailed=True,
)  # fmt: skip
"""Fixed colours, one per surface and kind of prop: a picture that is a file of its own."""

PAGE = Palette(
    ink="var(--ink)", muted="var(--muted)", paper="var(--paper)", marking="var(--paper)", start="var(--main)",
    goal="var(--good)", alarm="var(--alarm)", vehicle="var(--main)", ground=lambda _: "none",
    road=lambda _: "var(--road)", patch=lambda _: "var(--patch)", prop=lambda _: "var(--edge)",
    edge=lambda _: "var(--muted)", detailed=False,
)  # fmt: skip
"""Variables of the page's style sheet: a figure inside a page, light or dark."""


# --- elements ----------------------------------------------------------------------------------------------------


def shape_tag(
    data: str, fill: str, *, stroke: str | None = None, title: str = "", kind: str = "", more: str = ""
) -> str:
    """Return an area as an SVG element.

    Args:
        data: data of the path; without data, the result is empty.
        fill: colour of the area.
        stroke: colour of its edge.
        title: tooltip.
        kind: class of the element.
        more: further attributes.
    """
    if not data:
        return ""
    line = f' stroke="{stroke}"' if stroke else ""
    named = f' class="{kind}"' if kind else ""
    inner = f"<title>{escape(title)}</title>" if title else ""
    extra = f" {more}" if more else ""
    return f'<path d="{data}"{named} fill="{fill}" fill-rule="evenodd"{line}{extra}>{inner}</path>'


def line_tag(data: str, color: str, width: float, *, more: str = "") -> str:
    """Return a line as an SVG element; an empty text without data of a path."""
    extra = f" {more}" if more else ""
    return f'<path d="{data}" fill="none" stroke="{color}" stroke-width="{width:g}"{extra}/>' if data else ""


def text_tag(
    x: float, y: float, text: str, *, size: float = 12.0, color: str = INK, weight: int = 400, anchor: str = "start",
    turn: int = 0, middle: bool = False, halo: str = "",
) -> str:  # fmt: skip
    """Return a text at a point [px]; `turn` [deg], `middle` centres it vertically, `halo` is the colour around it."""
    extra = f' text-anchor="{anchor}"' if anchor != "start" else ""
    extra += f' font-weight="{weight}"' if weight != 400 else ""
    extra += f' transform="rotate({turn} {x:.2f} {y:.2f})"' if turn else ""
    extra += ' dy="0.35em"' if middle else ""
    if halo:
        extra += f' stroke="{halo}" stroke-opacity="0.85" stroke-width="3" stroke-linejoin="round" paint-order="stroke"'
    return f'<text x="{x:.2f}" y="{y:.2f}" font-size="{size:g}" fill="{color}"{extra}>{escape(text)}</text>'


@lru_cache(maxsize=4)
def _font(*, bold: bool) -> ImageFont.FreeTypeFont:
    """Return a wide font for measuring; texts in the reader's font are hardly ever longer."""
    folder = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    return ImageFont.truetype(str(folder / ("DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf")), 24)


def text_length(text: str, size: float, *, bold: bool = False) -> float:
    """Return the length of a text [px]."""
    return float(_font(bold=bold).getlength(text)) * size / 24.0


def friction_label(name: str, surface: str | None, mu: float) -> str:
    """Return the label of a surface; what is cut first is at its end."""
    return f"{name}: μ {mu:.3g}" if surface in {None, name} else f"{name}: μ {mu:.3g}, {surface}"
