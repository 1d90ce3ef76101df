"""Layers of a run on the map of its world: driven lines, vehicles, marked places; see :mod:`world_map`."""

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from matplotlib import colormaps
from matplotlib.colors import to_hex
from numpy.typing import NDArray

from mirdrake.report.map_sheet import Array, Palette, Sheet, line_tag, shape_tag, text_tag
from mirdrake.report.svg import SCALE_STEPS
from mirdrake.report.world_map import Layer
from mirdrake.worlds import World

_ARROW_DISTANCE = 100.0  # [px] from one arrow head to the next
_MOST_ARROWS = 80  # of one line
_MOST_POINTS = 5000  # of one driven line
_ROUND = 'stroke-linecap="round" stroke-linejoin="round"'


@dataclass(frozen=True)
class DrivenLine:
    """Path of a vehicle's origin.

    Attributes:
        x: N coordinates in the world frame [m].
        y: N coordinates in the world frame [m].
        colour: name of a CSS variable of the page.
        scale: N classes 0 … SCALE_STEPS - 1 that colour the line piece by piece, or None.
    """

    x: Array
    y: Array
    colour: str = "main"
    scale: NDArray[np.intp] | None = None

    @property
    def finite(self) -> NDArray[np.bool_]:
        """Samples (N) with a position."""
        return np.isfinite(self.x) & np.isfinite(self.y)

    @property
    def points(self) -> Array:
        """Finite points (n, 2) in the world frame [m]."""
        return np.column_stack((self.x, self.y))[self.finite]


@dataclass(frozen=True)
class Place:
    """A place for a close view: coordinates in the world frame [m] and half the width of the view [m]."""

    x: float
    y: float
    reach: float


@dataclass(frozen=True)
class VehicleOutline:
    """A vehicle seen from above at one moment.

    Attributes:
        corners: n points in the world frame [m].
        label: text beside it.
        above: whether the label is above it.
        ring: whether a dashed circle is drawn around it.
        failed: whether it is drawn in the colour of alarms.
    """

    corners: Sequence[Sequence[float]]
    label: str
    above: bool = False
    ring: bool = False
    failed: bool = False


def scale_colours() -> tuple[list[str], list[str]]:
    """Return the colours of the classes of :attr:`DrivenLine.scale`, from low to high, on light and on dark paper."""
    plasma = colormaps["plasma"]
    light = [to_hex(plasma(value)) for value in np.linspace(0.02, 0.72, SCALE_STEPS)]
    dark = [to_hex(plasma(value)) for value in np.linspace(0.34, 0.96, SCALE_STEPS)]
    return light, dark


def driven_lines(lines: Sequence[DrivenLine], *, width: float, arrows: bool = False) -> Layer:
    """Return a layer of driven lines.

    Args:
        lines: one per vehicle.
        width: width of the last line [px]; those below it are wider, so that lines that coincide are all visible.
        arrows: whether arrow heads show the direction.
    """

    def draw(_: World, sheet: Sheet, palette: Palette) -> Iterable[str]:
        for index, line in enumerate(lines):
            yield from _driven_line(line, sheet, width + 2.4 * (len(lines) - 1 - index))
            if arrows:
                yield from _arrows(line, sheet, palette)

    return draw


def _driven_line(line: DrivenLine, sheet: Sheet, width: float) -> Iterable[str]:
    """Draw a driven line: one element per colour."""
    points, scale = line.points, None if line.scale is None else line.scale[line.finite]
    if len(points) < 2:
        return
    # Repeated points have no direction and would give degenerate pieces.
    moved = np.concatenate(([True], np.hypot(*np.diff(points, axis=0).T) > 0.0))
    points, scale = points[moved], None if scale is None else scale[moved]
    if len(points) < 2:
        return
    classes = np.zeros(len(points), dtype=np.intp) if scale is None else scale
    # The line is cut where its colour changes; each piece shares a point with the next, so that no gap appears.
    cuts = np.concatenate(([0], np.flatnonzero(np.diff(classes)) + 1, [len(points) - 1]))

    # Each piece of one colour is simplified; a long drive is simplified more, until the picture is small enough.
    tolerance = 0.25 / sheet.scale
    while True:
        by_class: dict[int, list[Array]] = {}
        for begin, end in itertools.pairwise(cuts):
            if end > begin:
                piece = shapely.simplify(shapely.linestrings(points[begin : end + 1]), tolerance)
                by_class.setdefault(int(classes[begin]), []).append(shapely.get_coordinates(piece))
        count = sum(len(piece) for pieces in by_class.values() for piece in pieces)
        if count <= _MOST_POINTS or len(cuts) > _MOST_POINTS / 4:
            break
        tolerance *= 2.0
    for step, pieces in sorted(by_class.items()):
        data = "".join(sheet.polyline(piece) for piece in pieces)
        color = line.colour if scale is None else f"scale{step}"
        yield line_tag(data, f"var(--{color})", width, more=_ROUND)


def _arrows(line: DrivenLine, sheet: Sheet, palette: Palette) -> Iterable[str]:
    """Draw arrow heads along a driven line, none near another one."""
    points = line.points
    if len(points) < 2:
        return
    # Distances are in pixels, so that arrows have the same density at every scale.
    pixels = sheet.place(points)
    travelled = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(pixels, axis=0).T))))
    drawn: list[Array] = []
    for distance in np.arange(0.5, min(travelled[-1] / _ARROW_DISTANCE, float(_MOST_ARROWS))) * _ARROW_DISTANCE:
        here, ahead = (
            np.array([np.interp(distance + step, travelled, pixels[:, axis]) for axis in (0, 1)]) for step in (0.0, 4.0)
        )
        direction = ahead - here
        length = float(np.hypot(*direction))
        if not length or any(np.hypot(*(here - other)) < 0.6 * _ARROW_DISTANCE for other in drawn):
            continue
        drawn.append(here)
        forward = direction / length
        side = np.array([-forward[1], forward[0]])
        corners = (
            here + 8.0 * forward,
            here - 4.0 * forward + 5.0 * side,
            here - 1.5 * forward,
            here - 4.0 * forward - 5.0 * side,
        )
        data = "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in corners) + "Z"
        yield shape_tag(data, palette.ink, stroke=palette.paper, more='stroke-width="0.8"')


def line_ends(lines: Sequence[DrivenLine]) -> Layer:
    """Return a layer with a circle at the start and a square at the end of each line, with the words."""

    def draw(_: World, sheet: Sheet, palette: Palette) -> Iterable[str]:
        edge = f'fill="{palette.paper}" stroke="{palette.ink}" stroke-width="1.6"'
        for line in lines:
            points = line.points
            if not len(points):
                continue
            # The words collide if start and end are closer than a word is long, as on closed tracks; then they go to
            # opposite sides.
            (x0, y0), (x1, y1) = sheet.place(points[[0, -1]]).tolist()
            near = np.hypot(x1 - x0, y1 - y0) < 30.0
            yield f'<circle cx="{x0:.1f}" cy="{y0:.1f}" r="4" {edge}/>'
            yield f'<rect x="{x1 - 3.5:.1f}" y="{y1 - 3.5:.1f}" width="7" height="7" {edge}/>'
            yield text_tag(x0 - 6.0, y0 + 18.0, "start", color=palette.ink)
            yield text_tag(x1 - 6.0, y1 - 11.0, "end", color=palette.ink, anchor="end" if near else "start")

    return draw


def numbered_places(places: Sequence[Place], *, numbers: bool = True) -> Layer:
    """Return a layer of circles around places, numbered from 1."""

    def draw(_: World, sheet: Sheet, palette: Palette) -> Iterable[str]:
        for number, place in enumerate(places, start=1):
            ((x, y),) = sheet.place([[place.x, place.y]]).tolist()
            yield f'<circle cx="{x:.1f}" cy="{y:.1f}" r="7.5" fill="none" stroke="{palette.ink}" stroke-width="1.2"/>'
            if numbers:
                yield text_tag(x + 10.0, y - 8.0, str(number), size=13.0, weight=700, color=palette.ink)

    return draw


def centre_lines(world: World, sheet: Sheet, palette: Palette) -> Iterable[str]:
    """Draw the centre lines of the tracks, dashed."""
    for track in world.tracks.values():
        points = np.column_stack(track.point(np.append(track.stations(sagitta=0.01), track.length)))
        yield line_tag(sheet.polyline(points), palette.muted, 1.2, more='stroke-dasharray="6 4"')


def vehicles(outlines: Sequence[VehicleOutline]) -> Layer:
    """Return a layer of vehicles, each with a label."""

    def draw(_: World, sheet: Sheet, palette: Palette) -> Iterable[str]:
        for outline in outlines:
            color = palette.alarm if outline.failed else palette.vehicle
            opacity, width = (0.35, 1.8) if outline.ring else (0.12, 1.2)
            look = f'fill-opacity="{opacity}" stroke-width="{width}"'
            yield shape_tag(sheet.line(outline.corners, closed=True), color, stroke=color, more=look)
            # The label stands above or below its vehicle, within the picture.
            points = sheet.place(outline.corners)
            (x, middle), low, high = points.mean(axis=0), points[:, 1].min(), points[:, 1].max()
            if outline.ring:
                radius = max(16.0, 3.2 * sheet.scale)
                ring = f'<circle cx="{x:.1f}" cy="{middle:.1f}" r="{radius:.1f}" fill="none" stroke="{color}"'
                yield f'{ring} stroke-width="1.4" stroke-dasharray="3 3"/>'
                low, high = middle - radius, middle + radius
            above = outline.above and low > 18.0
            y = low - 5.0 if above else min(high + 13.0, sheet.height - 4.0)
            yield text_tag(x, y, outline.label, color=palette.ink, anchor="middle")

    return draw
