"""The sheet that a world is drawn on from above: metres to pixels, colours, elements of SVG."""

from functools import lru_cache
from pathlib import Path

import matplotlib
import numpy as np
import shapely
from markupsafe import escape
from numpy.typing import NDArray
from PIL import ImageFont
from shapely.geometry.base import BaseGeometry

from mirdrake.worlds import PlacedProp, World

Array = NDArray[np.float64]
Box = tuple[float, float, float, float]
"""Left, top, right, bottom in the picture [px]."""

GROUND = {"asphalt": "#e3e4e6", "concrete": "#ebe8e1", "grass": "#e0ecd3", "gravel": "#eee5d3", "ice": "#e2f3fa"}
ROAD = {"asphalt": "#b7bcc3", "concrete": "#cfcac0", "grass": "#b5d09a", "gravel": "#d5c39c", "ice": "#a6d8ee"}
_KINDS = {
    "barrel": "#e8742a", "box": "#a89a88", "building": "#b8a590", "cone": "#f08632", "cylinder": "#9c92ad",
    "house": "#c08f72", "jersey_barrier": "#9da3a9", "lamp_post": "#6b7280", "pedestrian": "#c02a78",
    "sedan": "#5c81ab", "speed_bump": "#d9ad2b", "sphere": "#7fa3a0", "stop_sign": "#c8322b",
    "thrift_store": "#b98f5d", "traffic_light": "#c99a16", "tree": "#74a85e", "van": "#8276ab", "wall": "#a8806a",
}  # fmt: skip
PLAIN = "#d7c4e8"  # of a patch that looks like what is below it
_OTHERS = ("#4f9a94", "#a5678e", "#8d8a3f", "#6f86c9", "#b5735a", "#5f9e6e")
INK, MUTED, RED, GREEN, BLUE = "#1f2937", "#6b7280", "#dc2626", "#15803d", "#1d4ed8"

LEFT, _TOP, BOTTOM, SIDE = 48.0, 66.0, 34.0, 250.0  # [px] around the map; the key is at its right side
LEAST, _MOST = 420.0, 740.0  # [px] least width and height, most height of the map
_FOOT = 66.0  # [px] for scale bar and axes below everything


class Sheet:
    """From the world [m] to the picture [px]."""

    def __init__(self, world: World, width: float) -> None:
        boxes = [area.bounds for area in _contents(world)] or [world.ground.extent]
        low, high = np.array(boxes)[:, :2].min(axis=0), np.array(boxes)[:, 2:].max(axis=0)
        size = np.maximum(high - low, 12.0)
        middle, size = (low + high) / 2.0, size + 2.0 * (1.0 + 0.05 * size.max())
        across = width - LEFT - SIDE
        self.scale = float(min(across / size[0], (_MOST - _FOOT / 2.0) / size[1]))
        self.width = max(LEAST, float(size[0]) * self.scale)
        foot = max(0.0, _FOOT - 0.05 * float(size.max()) * self.scale)
        self.height = max(LEAST, float(size[1]) * self.scale + foot)
        self.x, self.y = middle - np.array([self.width, self.height + foot]) / 2.0 / self.scale
        self.left, self.top, self.bottom = LEFT, _TOP, _TOP + self.height

    def place(self, points: object) -> Array:
        """Points (n, 2) of W in the picture."""
        xy = np.atleast_2d(np.asarray(points, dtype=float))
        return np.column_stack(
            (self.left + (xy[:, 0] - self.x) * self.scale, self.bottom - (xy[:, 1] - self.y) * self.scale)
        )

    def line(self, points: object, *, closed: bool = False) -> str:
        """Points of W as the data of a path."""
        return "M" + "L".join(f"{x:.2f} {y:.2f}" for x, y in self.place(points)) + ("Z" if closed else "")

    def path(self, area: BaseGeometry) -> str:
        """An area of W as the data of a path."""
        simple = shapely.simplify(area, 0.15 / self.scale)
        parts = [part for part in shapely.get_parts(simple) if part.geom_type == "Polygon" and not part.is_empty]
        rings = [ring for part in parts for ring in (part.exterior, *part.interiors)]
        return "".join(self.line(shapely.get_coordinates(ring)[:-1], closed=True) for ring in rings)

    def bounds(self, area: BaseGeometry) -> Box:
        """Box around an area of W: left, top, right, bottom in the picture."""
        (x0, y1), (x1, y0) = self.place(np.reshape(area.bounds, (2, 2))).tolist()
        return x0, y0, x1, y1


def _contents(world: World) -> list[BaseGeometry]:
    """What must be in the picture."""
    areas: list[BaseGeometry] = [track.area for track in world.tracks.values()]
    areas += [patch.area for patch in world.patches] + [placed.footprint for placed in world.props]
    areas += [goal.area for goal in world.goals.values() if goal.area is not None]
    return areas + [shapely.Point(start.x, start.y) for start in world.starts.values()]


# --- elements ----------------------------------------------------------------------------------------------------


def shape_tag(data: str, fill: str, *, stroke: str | None = None, title: str = "", kind: str = "") -> str:
    """An area, given as the data of a path; `title` is shown where the pointer rests, `kind` is its class."""
    line = f' stroke="{stroke}"' if stroke else ""
    named = f' class="{kind}"' if kind else ""
    inner = f"<title>{escape(title)}</title>" if title else ""
    return f'<path d="{data}"{named} fill="{fill}" fill-rule="evenodd"{line}>{inner}</path>'


def text_tag(
    x: float, y: float, text: str, *, size: float = 12.0, color: str = INK, weight: int = 400, anchor: str = "start",
    turn: int = 0, middle: bool = False, halo: bool = False,
) -> str:  # fmt: skip
    """A text at a point [px]; `turn` in degrees, with `middle` level with the point, with `halo` read on anything."""
    extra = f' text-anchor="{anchor}"' if anchor != "start" else ""
    extra += f' font-weight="{weight}"' if weight != 400 else ""
    extra += f' transform="rotate({turn} {x:.2f} {y:.2f})"' if turn else ""
    extra += ' dy="0.35em"' if middle else ""
    if halo:
        extra += ' stroke="#ffffff" stroke-opacity="0.85" stroke-width="3" stroke-linejoin="round" paint-order="stroke"'
    return f'<text x="{x:.2f}" y="{y:.2f}" font-size="{size:g}" fill="{color}"{extra}>{escape(text)}</text>'


@lru_cache(maxsize=4)
def _font(*, bold: bool) -> ImageFont.FreeTypeFont:
    """A wide font to measure with; what is shown with another one is hardly ever longer."""
    folder = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    return ImageFont.truetype(str(folder / ("DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf")), 24)


def length_of(text: str, size: float, *, bold: bool = False) -> float:
    """Length of a text [px]."""
    return float(_font(bold=bold).getlength(text)) * size / 24.0


def friction_of(name: str, surface: str | None, mu: float) -> str:
    """What stands at a surface; its end is what is cut first."""
    return f"{name}: μ {mu:.3g}" if surface in {None, name} else f"{name}: μ {mu:.3g}, {surface}"


# --- colours -----------------------------------------------------------------------------------------------------


def fill_of(placed: PlacedProp) -> str:
    """The colour of a prop: its own, or that of its kind."""
    if placed.color is not None:
        return "#" + "".join(f"{round(255.0 * min(1.0, max(0.0, part))):02x}" for part in placed.color)
    kind = placed.prop.name
    return _KINDS.get(kind) or _OTHERS[sum(kind.encode()) % len(_OTHERS)]


def _channels(color: str) -> tuple[int, int, int]:
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)


def darker(color: str) -> str:
    """A colour for the edge of what is filled with another."""
    return "#" + "".join(f"{round(0.58 * part):02x}" for part in _channels(color))


def ink_on(color: str) -> str:
    """Black or white, whichever is read better on a colour."""
    red, green, blue = _channels(color)
    return "#ffffff" if 0.299 * red + 0.587 * green + 0.114 * blue < 140.0 else "#111827"
