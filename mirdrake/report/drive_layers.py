"""Layers of a run on the map of its world: driven lines, vehicles, marked places; see :mod:`world_map`."""

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from matplotlib import colormaps
from matplotlib.colors import to_hex
from numpy.typing import NDArray

from mirdrake.report.map_labels import Labels
from mirdrake.report.map_props import prop_box
from mirdrake.report.map_sheet import Array, Box, Palette, Sheet, line_tag, shape_tag
from mirdrake.report.svg import SCALE_STEPS
from mirdrake.report.world_map import Layer, scale_bar_box
from mirdrake.worlds import World

_ARROW_DISTANCE = 100.0  # [px] from one arrow head to the next
_MOST_ARROWS = 80  # of one line
_MOST_POINTS = 5000  # of one driven line
_BESIDE = 5.0  # [px] from a driven line to a label
_ROUND = 'stroke-linecap="round" stroke-linejoin="round"'


@dataclass(frozen=True)
class DrivenLine:
    """Path of a vehicle's origin.

    Attributes:
        x: N coordinates in the world frame [m].
        y: N coordinates in the world frame [m].
        colour: name of a CSS variable of the page.
        scale: N classes 0 … SCALE_STEPS - 1 that colour the line piece by piece, or None.
        name: of an actor: label of its start, instead of the words start and end.
    """

    x: Array
    y: Array
    colour: str = "main"
    scale: NDArray[np.intp] | None = None
    name: str = ""

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
        other: whether it is another vehicle or an actor, without a label if there is no room.
        ring: whether a dashed circle is drawn around it.
        failed: whether it is drawn in the colour of alarms.
    """

    corners: Sequence[Sequence[float]]
    label: str
    other: bool = False
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
        width: width of the last line [px]; vehicles below it have wider ones, so that lines that coincide are visible.
        arrows: whether arrow heads show the direction.
    """

    def draw(_: World, sheet: Sheet, palette: Palette) -> Iterable[str]:
        above = sum(not line.name for line in lines)
        for line in lines:
            # Actors may be many: their lines are not widened, and have no arrow heads.
            above -= not line.name
            yield from _driven_line(line, sheet, width if line.name else width + 2.4 * above)
            if arrows and not line.name:
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


def marks(lines: Sequence[DrivenLine], places: Sequence[Place]) -> Layer:
    """Return a layer with a circle at the start and a square at the end of each line, and of numbered places.

    Labels do not overlap each other and the marks. Names of actors without room are left out.
    """

    def draw(world: World, sheet: Sheet, palette: Palette) -> Iterable[str]:
        labels = Labels(sheet, paper=palette.paper)
        labels.block(scale_bar_box(sheet))
        for placed in world.props:
            labels.avoid_prop(prop_box(placed, sheet))
        edge = f'fill="{palette.paper}" stroke="{palette.ink}" stroke-width="1.6"'
        wanted: list[tuple[int, Box, str, int]] = []
        for line in lines:
            points = line.points
            if not len(points):
                continue
            pixels = sheet.place(points)
            labels.avoid_line(pixels, _BESIDE)
            (x0, y0), (x1, y1) = pixels[[0, -1]].tolist()
            yield f'<circle cx="{x0:.1f}" cy="{y0:.1f}" r="4" {edge}/>'
            yield f'<rect x="{x1 - 3.5:.1f}" y="{y1 - 3.5:.1f}" width="7" height="7" {edge}/>'
            first, last = (x0 - 4.0, y0 - 4.0, x0 + 4.0, y0 + 4.0), (x1 - 4.0, y1 - 4.0, x1 + 4.0, y1 + 4.0)
            labels.block(first)
            labels.block(last)
            wanted += [(2, first, line.name, 400)] if line.name else [(1, first, "start", 400), (1, last, "end", 400)]
        for number, place in enumerate(places, start=1):
            yield from place_circle(place)(world, sheet, palette)
            ((x, y),) = sheet.place([[place.x, place.y]]).tolist()
            labels.block(box := (x - 7.5, y - 7.5, x + 7.5, y + 7.5))
            wanted.append((0, box, str(number), 700))
        # Numbers first, as the text of the page refers to them; then the ends of the vehicles, then the actors.
        for _rank, box, text, weight in sorted(wanted, key=lambda row: row[0]):
            labels.write_beside([box], text, color=palette.ink, weight=weight)
        yield from labels.elements

    return draw


def place_circle(place: Place) -> Layer:
    """Return a layer with a circle around a place."""

    def draw(_: World, sheet: Sheet, palette: Palette) -> Iterable[str]:
        ((x, y),) = sheet.place([[place.x, place.y]]).tolist()
        yield f'<circle cx="{x:.1f}" cy="{y:.1f}" r="7.5" fill="none" stroke="{palette.ink}" stroke-width="1.2"/>'

    return draw


def centre_lines(world: World, sheet: Sheet, palette: Palette) -> Iterable[str]:
    """Draw the centre lines of the tracks, dashed."""
    for track in world.tracks.values():
        points = np.column_stack(track.point(np.append(track.stations(sagitta=0.01), track.length)))
        yield line_tag(sheet.polyline(points), palette.muted, 1.2, more='stroke-dasharray="6 4"')


def vehicles(outlines: Sequence[VehicleOutline], line: Array) -> Layer:
    """Return a layer of vehicles, each with a label.

    Labels overlap neither each other nor the vehicles; if there is room, they touch neither props nor the driven line.

    Args:
        outlines: the vehicles, the decisive one last.
        line: driven line (n, 2) in the world frame [m].
    """

    def draw(world: World, sheet: Sheet, palette: Palette) -> Iterable[str]:
        labels = Labels(sheet, paper=palette.paper)
        labels.block(scale_bar_box(sheet))
        for placed in world.props:
            labels.avoid_prop(prop_box(placed, sheet))
        if len(line):
            labels.avoid_line(sheet.place(line), _BESIDE)
        boxes: list[Box] = []
        for outline in outlines:
            color = palette.alarm if outline.failed else palette.muted if outline.other else palette.vehicle
            opacity, width = (0.35, 1.8) if outline.ring else (0.12, 1.2)
            look = f'fill-opacity="{opacity}" stroke-width="{width}"'
            yield shape_tag(sheet.line(outline.corners, closed=True), color, stroke=color, more=look)
            points = sheet.place(outline.corners)
            (x0, y0), (x1, y1) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
            if outline.ring:
                (x, y), radius = points.mean(axis=0).tolist(), max(16.0, 3.2 * sheet.scale)
                ring = f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:.1f}" fill="none" stroke="{color}"'
                yield f'{ring} stroke-width="1.4" stroke-dasharray="3 3"/>'
                x0, y0, x1, y1 = x - radius, y - radius, x + radius, y + radius
            labels.block(box := (x0, y0, x1, y1))
            boxes.append(box)
        # The last one is the decisive one: its label has the first choice, and those of others have the last one.
        order = sorted(range(len(outlines)), key=lambda number: (outlines[number].other, -number))
        for number in order:
            labels.write_beside([boxes[number]], outlines[number].label, color=palette.ink)
        yield from labels.elements

    return draw
