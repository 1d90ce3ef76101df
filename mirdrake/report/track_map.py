"""The drive from above: the road, the driven lines, and the places where a vehicle strayed most."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from markupsafe import Markup
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch, Polygon
from matplotlib.path import Path as Outline
from numpy.typing import NDArray

from mirdrake.report.figures import Array, to_svg
from mirdrake.report.svg import SCALE_STEPS, THEME, embed_svg

_SIZES = {
    "wide": (960.0, 220.0, 700.0),
    "narrow": (400.0, 140.0, 480.0),
}  # [px] width, least and most height of the map
_FOOT = 26.0  # [px] below the map, for the scale bar
_INSET = 300.0  # [px]
_MARGIN = 26.0  # [px]
_ARROWS = 100.0  # [px] from one arrow head to the next
_MOST_POINTS = 5000  # of one driven line


@dataclass(frozen=True)
class Road:
    """Edges and centre line of a road, each N x 2 [m], in driving order; closed: the last point is the first.

    Where the width varies, `width` is the largest, and `edges` are s and the distances of both edges there, N each [m].
    """

    left: Array
    right: Array
    centre: Array
    closed: bool
    width: float
    edges: tuple[Array, Array, Array] | None = None


@dataclass(frozen=True)
class Line:
    """Where a vehicle's origin went.

    Attributes:
        x: N coordinates in the world frame [m].
        y: N coordinates in the world frame [m].
        colour: a key of :data:`mirdrake.report.svg.THEME`.
        scale: N classes 0 … SCALE_STEPS - 1 that colour the line piece by piece, or None.
    """

    x: Array
    y: Array
    colour: str
    scale: NDArray[np.intp] | None = None


@dataclass(frozen=True)
class Place:
    """A place to look at closely: coordinates in the world frame [m] and half the width of the view [m]."""

    x: float
    y: float
    reach: float


def scale_colours() -> tuple[list[str], list[str]]:
    """The colours of the classes of :attr:`Line.scale`, from low to high, on light and on dark paper."""
    plasma = colormaps["plasma"]
    light = [to_hex(plasma(value)) for value in np.linspace(0.02, 0.72, SCALE_STEPS)]
    dark = [to_hex(plasma(value)) for value in np.linspace(0.34, 0.96, SCALE_STEPS)]
    return light, dark


def draw_map(
    roads: Sequence[Road],
    lines: Sequence[Line],
    places: Sequence[Place],
    prefix: str,
    description: str,
    props: Sequence[Array] = (),
) -> Markup:
    """Roads and driven lines from above, x to the right and y up, with start, end, direction and a scale bar.

    Args:
        roads: drawn below everything.
        lines: one per vehicle.
        places: marked by numbers from 1.
        prefix: of ids, unique in the page.
        description: what a listener is told in place of the picture.
        props: outlines of what stands around, each n x 2 [m]; those near the roads and lines are seen.
    """
    parts = [road.left for road in roads] + [road.right for road in roads]
    parts += [np.column_stack((line.x, line.y)) for line in lines]
    points = np.concatenate(parts) if parts else np.zeros((0, 2))
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        points = np.zeros((1, 2))
    (x0, y0), (x1, y1) = points.min(axis=0), points.max(axis=0)
    pictures = []
    for kind, (width, least, most) in _SIZES.items():
        size_x, size_y = max(x1 - x0, 5.0), max(y1 - y0, 5.0)
        scale = min((width - 2 * _MARGIN) / size_x, (most - 2 * _MARGIN - _FOOT) / size_y)  # [px/m]
        height = max(least, size_y * scale + 2 * _MARGIN + _FOOT)
        axes = _make_axes((x0 + x1) / 2.0, (y0 + y1) / 2.0 - _FOOT / 2.0 / scale, width, height, scale)
        _fill_map(axes, roads, lines, places, scale, props)
        _draw_scale_bar(axes, width, height, scale)
        attributes = {"class": f"plot map {kind}", "role": "img", "aria-label": description}
        pictures.append(_embed(axes, prefix + kind[0], attributes))
    return Markup("\n").join(pictures)


def _fill_map(
    axes: Axes,
    roads: Sequence[Road],
    lines: Sequence[Line],
    places: Sequence[Place],
    scale: float,
    props: Sequence[Array],
) -> None:
    for road in roads:
        _draw_road(axes, road, 0.25 / scale, edge_width=0.8)
    _draw_props(axes, props)
    for line, width in zip(lines, _line_widths(len(lines), 2.4 if scale > 1.5 else 1.7), strict=True):
        _draw_line(axes, line, 0.25 / scale, width=width)
        _draw_arrows(axes, line, scale)
    for line in lines:
        _draw_ends(axes, line, scale)
    for number, place in enumerate(places, start=1):
        axes.plot(
            place.x,
            place.y,
            "o",
            markersize=15.0,
            markerfacecolor="none",
            markeredgecolor=THEME["ink"],
            markeredgewidth=1.2,
        )
        axes.annotate(
            str(number), (place.x, place.y), (10.0, 8.0), textcoords="offset points", fontweight="bold", fontsize=13.0
        )


def draw_place(
    roads: Sequence[Road],
    lines: Sequence[Line],
    place: Place,
    prefix: str,
    description: str,
    props: Sequence[Array] = (),
) -> Markup:
    """One place closely, with the centre line of the road dashed; arguments as of :func:`draw_map`."""
    scale = _INSET / (2.0 * place.reach)
    axes = _make_axes(place.x, place.y, _INSET, _INSET, scale)
    box = np.array([place.x - place.reach, place.y - place.reach, place.x + place.reach, place.y + place.reach])
    for road in roads:
        _draw_road(axes, road, 0.1 / scale, edge_width=1.2, box=box)
        for begin, end in _stretches(road.centre, box):
            piece = _simplified(road.centre[begin:end], 0.1 / scale)
            axes.plot(piece[:, 0], piece[:, 1], color=THEME["muted"], linewidth=1.2, linestyle=(0, (6, 4)))
    _draw_props(axes, props)
    for line, width in zip(lines, _line_widths(len(lines), 2.0), strict=True):
        points = np.column_stack((line.x, line.y))
        for begin, end in _stretches(points, box):  # NaN is in no box
            piece = _simplified(points[begin:end], 0.1 / scale)
            axes.plot(piece[:, 0], piece[:, 1], color=THEME[line.colour], linewidth=width)
    axes.plot(
        place.x,
        place.y,
        "o",
        markersize=15.0,
        markerfacecolor="none",
        markeredgecolor=THEME["ink"],
        markeredgewidth=1.2,
    )
    _draw_scale_bar(axes, _INSET, _INSET, scale)
    attributes = {"class": "plot place", "role": "img", "aria-label": description}
    return _embed(axes, prefix, attributes)


def _embed(axes: Axes, prefix: str, attributes: dict[str, str]) -> Markup:
    figure = axes.get_figure(root=True)
    assert figure is not None
    return Markup(embed_svg(to_svg(figure), prefix, attributes=attributes))


def _make_axes(x: float, y: float, width: float, height: float, scale: float) -> Axes:
    figure = Figure(figsize=(width / 72.0, height / 72.0), dpi=72.0)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.set_xlim(x - width / 2.0 / scale, x + width / 2.0 / scale)
    axes.set_ylim(y - height / 2.0 / scale, y + height / 2.0 / scale)
    return axes


def _draw_road(axes: Axes, road: Road, tolerance: float, *, edge_width: float, box: Array | None = None) -> None:
    for begin, end in _stretches(road.centre, box):
        left, right = _simplified(road.left[begin:end], tolerance), _simplified(road.right[begin:end], tolerance)
        outline = np.concatenate((left, right[::-1]))
        axes.add_patch(PathPatch(Outline(outline), facecolor=THEME["road"], linewidth=0.0))
        for edge in (left, right):
            axes.plot(edge[:, 0], edge[:, 1], color=THEME["edge"], linewidth=edge_width)


def _draw_props(axes: Axes, props: Sequence[Array]) -> None:
    """Outlines that are at least partly within the axes."""
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    for outline in props:
        (x0, y0), (x1, y1) = outline.min(axis=0), outline.max(axis=0)
        if x0 < right and x1 > left and y0 < high and y1 > low:
            axes.add_patch(
                PathPatch(Outline(outline), facecolor=THEME["edge"], edgecolor=THEME["muted"], linewidth=0.6)
            )


def _draw_line(axes: Axes, line: Line, tolerance: float, *, width: float) -> None:
    """The driven line: one drawing element per colour, its pieces parted by NaN."""
    points = np.column_stack((line.x, line.y))
    finite = np.isfinite(points).all(axis=1)
    points, scale = points[finite], None if line.scale is None else line.scale[finite]
    if len(points) < 2:
        return
    moved = np.concatenate(([True], np.hypot(*np.diff(points, axis=0).T) > 0.0))
    points, scale = points[moved], None if scale is None else scale[moved]
    if len(points) < 2:
        return
    classes = np.zeros(len(points), dtype=np.intp) if scale is None else scale
    cuts = np.concatenate(([0], np.flatnonzero(np.diff(classes)) + 1, [len(points) - 1]))
    while True:
        by_class: dict[int, list[Array]] = {}
        count = 0
        for begin, end in itertools.pairwise(cuts):
            if end <= begin:
                continue
            piece = _simplified(points[begin : end + 1], tolerance)
            count += len(piece)
            by_class.setdefault(int(classes[begin]), []).extend((piece, np.full((1, 2), np.nan)))
        if count <= _MOST_POINTS or len(cuts) > _MOST_POINTS / 4:
            break
        tolerance *= 2.0
    for step, pieces in sorted(by_class.items()):
        path = np.concatenate(pieces)
        colour = line.colour if scale is None else f"scale{step}"
        axes.plot(path[:, 0], path[:, 1], color=THEME[colour], linewidth=width, solid_capstyle="round")


def _draw_arrows(axes: Axes, line: Line, scale: float) -> None:
    """Arrow heads along the way, none near another one."""
    points = np.column_stack((line.x, line.y))
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < 2:
        return
    travelled = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
    drawn: list[Array] = []
    for distance in np.arange(0.5, min(travelled[-1] * scale / _ARROWS, 80.0)) * _ARROWS / scale:
        here, ahead = (
            np.array([np.interp(distance + step, travelled, points[:, axis]) for axis in (0, 1)])
            for step in (0.0, 4.0 / scale)
        )
        direction = ahead - here
        if not np.hypot(*direction) or any(np.hypot(*(here - other)) * scale < 0.6 * _ARROWS for other in drawn):
            continue
        drawn.append(here)
        forward = direction / np.hypot(*direction) / scale
        side = np.array([-forward[1], forward[0]])
        corners = [
            here + 8.0 * forward,
            here - 4.0 * forward + 5.0 * side,
            here - 1.5 * forward,
            here - 4.0 * forward - 5.0 * side,
        ]
        axes.add_patch(Polygon(corners, facecolor=THEME["ink"], edgecolor=THEME["paper"], linewidth=0.8, zorder=4))


def _draw_ends(axes: Axes, line: Line, scale: float) -> None:
    points = np.column_stack((line.x, line.y))
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return
    first, last = points[0], points[-1]
    near = float(np.hypot(*(last - first))) * scale < 30.0
    for point, marker, word, offset in ((first, "o", "start", (-6.0, -18.0)), (last, "s", "end", (-6.0, 11.0))):
        axes.plot(
            *point,
            marker,
            markersize=7.5,
            markerfacecolor=THEME["paper"],
            markeredgecolor=THEME["ink"],
            markeredgewidth=1.6,
            zorder=6,
        )
        align = "right" if near and word == "end" else "left"
        axes.annotate(
            word,
            (float(point[0]), float(point[1])),
            offset,
            textcoords="offset points",
            ha=align,
            fontsize=12.0,
            zorder=7,
        )


def _draw_scale_bar(axes: Axes, width: float, height: float, scale: float) -> None:
    """A bar of a round length, about an eighth of the picture, bottom left."""
    length = round_down(width / 6.0 / scale)
    low, right = 14.0 / height, (14.0 + length * scale) / width
    axes.plot(
        [14.0 / width, right],
        [low, low],
        color=THEME["ink"],
        linewidth=2.0,
        solid_capstyle="butt",
        transform=axes.transAxes,
    )
    axes.text(14.0 / width, low + 6.0 / height, f"{length:g} m", transform=axes.transAxes, fontsize=12.0)


def round_down(value: float) -> float:
    """The largest of 1, 2, 5, 10, 20, 50, … that is not above a positive value."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(step * power for step in (5.0, 2.0, 1.0) if step * power <= value * (1.0 + 1e-9))


def _simplified(points: Array, tolerance: float) -> Array:
    if len(points) < 3:
        return points
    return np.asarray(
        shapely.get_coordinates(shapely.simplify(shapely.linestrings(points), tolerance, preserve_topology=False))
    )


def _line_widths(count: int, narrowest: float) -> list[float]:
    """Widths [px] of lines that may lie on top of each other: the first one, at the bottom, is the widest."""
    return [narrowest + 2.4 * (count - 1 - index) for index in range(count)]


def _stretches(points: Array, box: Array | None) -> list[tuple[int, int]]:
    """First and one past the last index of each part of a polyline in or near a box (x0, y0, x1, y1); no box: all."""
    if box is None:
        return [(0, len(points))] if len(points) > 1 else []
    reach = float(box[2] - box[0]) / 2.0
    close = ((points > box[:2] - reach) & (points < box[2:] + reach)).all(axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], close.astype(np.int8), [0]))))
    return [(int(begin), int(end)) for begin, end in edges.reshape(-1, 2) if end - begin > 1]
