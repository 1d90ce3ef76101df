"""A world from above as an SVG picture: ground, friction, roads, props and their names, starts, goals, overlaps.

x goes to the right and y up. The element with the class ``map`` tells how a point of W becomes one of the picture:
``data-left + (x - data-x) · data-scale`` and ``data-bottom - (y - data-y) · data-scale``.
"""

import math
import re
from collections.abc import Iterable, Sequence
from functools import lru_cache
from pathlib import Path

import matplotlib
import numpy as np
import shapely
from markupsafe import escape
from numpy.typing import NDArray
from PIL import ImageFont
from shapely.geometry.base import BaseGeometry

from mirdrake.report.track_map import round_down
from mirdrake.worlds import PlacedProp, World
from mirdrake.worlds.world import track_mu, verge

Array = NDArray[np.float64]
Box = tuple[float, float, float, float]
Overlap = tuple[str, str, BaseGeometry]
"""Names of two props, and where both are, seen from above [m]."""

_GROUND = {"asphalt": "#e3e4e6", "concrete": "#ebe8e1", "grass": "#e0ecd3", "gravel": "#eee5d3", "ice": "#e2f3fa"}
_ROAD = {"asphalt": "#b7bcc3", "concrete": "#cfcac0", "grass": "#b5d09a", "gravel": "#d5c39c", "ice": "#a6d8ee"}
_KINDS = {
    "barrel": "#e8742a", "box": "#a89a88", "building": "#b8a590", "cone": "#f08632", "cylinder": "#9c92ad",
    "house": "#c08f72", "jersey_barrier": "#9da3a9", "lamp_post": "#6b7280", "pedestrian": "#c02a78",
    "sedan": "#5c81ab", "speed_bump": "#d9ad2b", "sphere": "#7fa3a0", "stop_sign": "#c8322b",
    "thrift_store": "#b98f5d", "traffic_light": "#c99a16", "tree": "#74a85e", "van": "#8276ab", "wall": "#a8806a",
}  # fmt: skip
_PLAIN = "#d7c4e8"  # of a patch that looks like what is below it
_OTHERS = ("#4f9a94", "#a5678e", "#8d8a3f", "#6f86c9", "#b5735a", "#5f9e6e")
_FACING = {"sedan", "van", "pedestrian"}  # kinds whose front is shown
_INK, _MUTED, _RED, _GREEN, _BLUE = "#1f2937", "#6b7280", "#dc2626", "#15803d", "#1d4ed8"
_FONT = "Helvetica, Arial, 'Liberation Sans', 'DejaVu Sans', sans-serif"

_LEFT, _TOP, _BOTTOM, _SIDE = 48.0, 66.0, 34.0, 250.0  # [px] around the map; the key is at its right side
_LEAST, _MOST = 420.0, 740.0  # [px] least width and height, most height of the map
_ROW = 21.0  # [px] of the key
_MOST_ROWS = 10  # of one part of the key
_FOOT = 66.0  # [px] for scale bar and axes below everything


def find_overlaps(world: World) -> list[Overlap]:
    """Props that overlap seen from above and in height, as far as no rule allows it; less than 1 cm² is none."""
    props = world.props
    tree = shapely.STRtree([placed.footprint for placed in props])
    found: list[Overlap] = []
    pairs = tree.query([placed.footprint for placed in props], predicate="intersects").T.tolist() if props else []
    for i, j in sorted(pairs):
        a, b = props[i], props[j]
        if i >= j or min(a.top, b.top) - max(a.bottom, b.bottom) < 1e-3:
            continue
        area = a.footprint.intersection(b.footprint)
        if area.area > 1e-4 and not (world.rules is not None and world.rules.may_overlap(a, b)):
            found.append((a.name, b.name, area))
    return found


def draw_world(world: World, *, overlaps: Sequence[Overlap] = (), width: float = 1200.0) -> str:
    """A world from above as an SVG document.

    Args:
        world: the world.
        overlaps: where props are in each other; drawn in red.
        width: of the picture [px]; a narrow world makes it narrower.
    """
    sheet = _Sheet(world, max(width, _LEFT + _LEAST + _SIDE))
    names = _Names(sheet)
    body = [_draw_ground(sheet, world), _draw_grid(sheet), _draw_goals(sheet, world, names)]
    body += [_draw_props(sheet, world), _draw_overlaps(sheet, overlaps, names), _draw_starts(sheet, world, names)]
    bar, ticks = _draw_scale(sheet, names), _draw_ticks(sheet)
    for placed in world.props:
        names.block(sheet.bounds(placed.footprint))
    _name_patches(sheet, world, names)
    for track in world.roads().values():
        s = np.arange(0.0, track.length, max(6.0 / sheet.scale, track.length / 2000.0))
        names.avoid(sheet.place(np.column_stack(track.point(s))), track.width / 2.0 * sheet.scale)
    _name_tracks(sheet, world, names)
    _name_props(sheet, world, names)
    rows = _key(world, overlaps)
    right = sheet.left + sheet.width + 26.0
    height = max(sheet.bottom + _BOTTOM, sheet.top + _ROW * len(rows) + 10.0)
    total = sheet.left + sheet.width + _SIDE
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {total:.0f} {height:.0f}" width="{total:.0f}" '
        f'height="{height:.0f}" font-family="{_FONT}" role="img" aria-label="{escape(world.name)} from above">'
    )
    frame = f'x="{sheet.left:.2f}" y="{sheet.top:.2f}" width="{sheet.width:.2f}" height="{sheet.height:.2f}"'
    return "\n".join([
        head,
        f'<rect width="{total:.0f}" height="{height:.0f}" fill="#ffffff"/>',
        f'<clipPath id="frame"><rect {frame}/></clipPath>',
        _text(sheet.left, 30.0, world.name, size=22.0, weight=700),
        _text(sheet.left, 51.0, _about(world), size=13.0, color=_MUTED),
        f'<g class="map" clip-path="url(#frame)" data-x="{sheet.x:.4f}" data-y="{sheet.y:.4f}" '
        f'data-scale="{sheet.scale:.6f}" data-left="{sheet.left:.2f}" data-bottom="{sheet.bottom:.2f}">',
        *body, *names.written, bar,
        "</g>",
        f'<rect {frame} fill="none" stroke="#9ca3af"/>',
        ticks,
        *(row.format(x=right, x2=right + 24.0, y=sheet.top + _ROW * i, ym=sheet.top + _ROW * i + 10.0)
          for i, row in enumerate(rows)),
        "</svg>\n",
    ])  # fmt: skip


# --- the sheet and the names on it -------------------------------------------------------------------------------


class _Sheet:
    """From the world [m] to the picture [px]."""

    def __init__(self, world: World, width: float) -> None:
        boxes = [area.bounds for area in _contents(world)] or [world.ground.extent]
        low, high = np.array(boxes)[:, :2].min(axis=0), np.array(boxes)[:, 2:].max(axis=0)
        size = np.maximum(high - low, 12.0)
        middle, size = (low + high) / 2.0, size + 2.0 * (1.0 + 0.05 * size.max())
        across = width - _LEFT - _SIDE
        self.scale = float(min(across / size[0], (_MOST - _FOOT / 2.0) / size[1]))
        self.width = max(_LEAST, float(size[0]) * self.scale)
        foot = max(0.0, _FOOT - 0.05 * float(size.max()) * self.scale)
        self.height = max(_LEAST, float(size[1]) * self.scale + foot)
        self.x, self.y = middle - np.array([self.width, self.height + foot]) / 2.0 / self.scale
        self.left, self.top, self.bottom = _LEFT, _TOP, _TOP + self.height

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


class _Names:
    """Names that do not lie on each other.

    Attributes:
        written: their elements.
    """

    def __init__(self, sheet: _Sheet) -> None:
        self._sheet = sheet
        self._texts: list[Box] = []
        self._things: list[Box] = []
        self._roads: list[Box] = []
        self._tables: dict[int, Array] = {}
        self.written: list[str] = []

    def block(self, box: Box, *, text: bool = False) -> None:
        """Keep names out of a box; with `text`, also those inside of props."""
        (self._texts if text else self._things).append(box)

    def avoid(self, points: Array, reach: float) -> None:
        """Rather keep names that stand beside something away from points of the picture."""
        self._roads += [(x - reach, y - reach, x + reach, y + reach) for x, y in points.tolist()]

    def write_inside(self, area: BaseGeometry, text: str, fill: str, *, only_try: bool = False) -> bool:
        """Write a name inside an area of W, level or upright, if it fits; with `only_try`, only say whether it does."""
        long, high = _length(text, 12.0) + 5.0, 14.0
        x0, y0, x1, y1 = self._sheet.bounds(area)
        if max(x1 - x0, y1 - y0) < min(long, high):
            return False
        shape = shapely.Polygon(self._sheet.place(shapely.get_coordinates(area.convex_hull)))
        middle = shape.centroid
        for wide, tall, turn in ((long, high, 0), (high, long, -90)):
            for dx, dy in ((0.0, 0.0), (0.0, -0.25), (0.0, 0.25), (-0.25, 0.0), (0.25, 0.0)):
                x, y = middle.x + dx * (x1 - x0), middle.y + dy * (y1 - y0)
                box = (x - wide / 2.0, y - tall / 2.0, x + wide / 2.0, y + tall / 2.0)
                if not (shape.contains(shapely.box(*box)) and self._free(box, self._texts)):
                    continue
                if not only_try:
                    self._texts.append(box)
                    self.written.append(_text(x, y, text, color=_on(fill), anchor="middle", turn=turn, middle=True))
                return True
        return False

    def write_beside(self, boxes: Iterable[Box], text: str, *, color: str = _INK, weight: int = 400) -> bool:
        """Write a name beside the first of some boxes of the picture where it is free, rather not on a road."""
        boxes = list(boxes)
        return any(self._write_beside(boxes, text, color, weight, avoid=avoid) for avoid in (True, False))

    def _write_beside(self, boxes: Sequence[Box], text: str, color: str, weight: int, *, avoid: bool) -> bool:
        long, high = _length(text, 12.0, bold=weight > 500), 15.0
        for x0, y0, x1, y1 in boxes:
            x, y = (x0 + x1) / 2.0, (y0 + y1) / 2.0
            for gap in (4.0, 14.0):
                for left, top in (
                    (x1 + gap, y - high / 2.0), (x - long / 2.0, y0 - gap - high), (x - long / 2.0, y1 + gap),
                    (x0 - gap - long, y - high / 2.0), (x1 + gap / 2.0, y0 - gap / 2.0 - high),
                    (x1 + gap / 2.0, y1 + gap / 2.0), (x0 - gap / 2.0 - long, y0 - gap / 2.0 - high),
                    (x0 - gap / 2.0 - long, y1 + gap / 2.0),
                ):  # fmt: skip
                    if avoid and not self._free((left, top, left + long, top + high), self._roads):
                        continue
                    if self._write(left, top, (long, high), text, color, weight):
                        return True
        return False

    def write_at(self, point: Array, text: str) -> bool:
        """Write a name with its middle at a point of the picture, if it is free."""
        long, high = _length(text, 12.0), 15.0
        return self._write(float(point[0]) - long / 2.0, float(point[1]) - high / 2.0, (long, high), text, _INK, 400)

    def _write(self, left: float, top: float, size: tuple[float, float], text: str, color: str, weight: int) -> bool:
        box = (left - 1.0, top, left + size[0] + 1.0, top + size[1])
        if not (self._free(box, self._texts) and self._free(box, self._things)):
            return False
        self._texts.append(box)
        middle = top + size[1] / 2.0
        self.written.append(_text(left, middle, text, color=color, weight=weight, middle=True, halo=True))
        return True

    def _free(self, box: Box, taken: list[Box]) -> bool:
        sheet = self._sheet
        x0, y0, x1, y1 = box
        if x0 < sheet.left + 2 or x1 > sheet.left + sheet.width - 2 or y0 < sheet.top + 2 or y1 > sheet.bottom - 2:
            return False
        if not taken:
            return True
        other = self._tables.get(id(taken))
        if other is None or len(other) != len(taken):
            other = self._tables[id(taken)] = np.array(taken)
        return not bool(((other[:, 0] < x1) & (other[:, 2] > x0) & (other[:, 1] < y1) & (other[:, 3] > y0)).any())


# --- what is drawn -----------------------------------------------------------------------------------------------


def _contents(world: World) -> list[BaseGeometry]:
    """What must be in the picture."""
    areas: list[BaseGeometry] = [track.area for track in world.tracks.values()]
    areas += [patch.area for patch in world.patches] + [placed.footprint for placed in world.props]
    areas += [goal.area for goal in world.goals.values() if goal.area is not None]
    return areas + [shapely.Point(start.x, start.y) for start in world.starts.values()]


def _draw_ground(sheet: _Sheet, world: World) -> str:
    parts = [
        f'<rect x="{sheet.left:.2f}" y="{sheet.top:.2f}" width="{sheet.width:.2f}" height="{sheet.height:.2f}" '
        'fill="#f8f9fa"/>',
        _shape(sheet.path(shapely.box(*world.ground.extent)), _GROUND[world.ground.surface], stroke="#cbd0d6"),
    ]
    for name, track in world.roads().items():
        edges = world.spec.tracks[name].edges
        if edges is not None and edges != world.ground.surface:
            parts.append(_shape(sheet.path(verge(track)), _GROUND[edges]))
    for name, track in world.roads().items():
        spec = world.spec.tracks[name]
        most = "" if track.edges is None else "up to "
        wide = f"{track.length:.1f} m, {most}{track.width:.4g} m wide"
        title = f"track {name}: {wide}, {spec.surface}, μ {track_mu(spec):g}"
        parts.append(_shape(sheet.path(track.area), _ROAD[spec.surface], stroke="#8d949d", title=title, kind="road"))
        for marking in spec.markings:
            inset = 0.05 + marking.width / 2.0
            s = np.zeros(1) if marking.line == "start" else np.append(track.stations(), track.length)
            left, right = track.left_width(s) - inset, inset - track.right_width(s)
            if marking.line == "start":
                points = np.array(track.point(0.0, np.append(right, left))).T
            else:
                points = np.array(
                    track.point(s, {"left": left, "right": right, "center": np.zeros_like(s)}[marking.line])
                ).T
            dash = ""
            if marking.kind == "dashed":
                dash = f' stroke-dasharray="{marking.dash[0] * sheet.scale:.1f} {marking.dash[1] * sheet.scale:.1f}"'
            thick = max(marking.width * sheet.scale, 1.6 if marking.line == "start" else 0.7)
            line = sheet.line(_simple(points, 0.15 / sheet.scale))
            parts.append(f'<path d="{line}" fill="none" stroke="#ffffff" stroke-width="{thick:.2f}"{dash}/>')
    for patch in world.patches:
        fill, title = _ROAD.get(patch.surface or "", _PLAIN), f"patch {_friction(patch.name, patch.surface, patch.mu)}"
        element = _shape(sheet.path(patch.area), fill, stroke=_darker(fill), title=title, kind="patch")
        parts.append(element.replace("<path ", '<path fill-opacity="0.8" stroke-dasharray="6 4" '))
    return "\n".join(parts)


def _draw_goals(sheet: _Sheet, world: World, names: _Names) -> str:
    parts = []
    for name, goal in world.goals.items():
        if goal.area is not None:
            element = _shape(sheet.path(goal.area), _GREEN, stroke=_GREEN, title=f"goal {name}", kind="goal")
            parts.append(element.replace("<path ", '<path fill-opacity="0.16" stroke-dasharray="5 3" '))
            box = sheet.bounds(goal.area)
        elif goal.gate is not None:
            track = world.tracks[goal.gate[0]]
            right, left = float(track.right_width(goal.gate[1])) + 0.5, float(track.left_width(goal.gate[1])) + 0.5
            ends = np.array(track.point([goal.gate[1]] * 2, [-right, left])).T
            parts.append(f'<path class="goal" d="{sheet.line(ends)}" stroke="{_GREEN}" stroke-width="4"/>')
            box = sheet.bounds(shapely.LineString(ends))
        else:
            continue
        names.block(box)
        names.write_beside([box], name, color=_GREEN, weight=700)
    return "\n".join(parts)


def _draw_props(sheet: _Sheet, world: World) -> str:
    """Props, higher ones on top; small ones get a dot."""
    parts = []
    for placed in sorted(world.props, key=lambda placed: placed.top):
        x, y, _ = placed.X_WP.translation()
        moves = "" if placed.static else ", can be knocked over"
        title = f"{placed.name}: {placed.prop.name} at ({x:.2f}, {y:.2f}) m, {placed.top:.2f} m high{moves}"
        fill = _fill(placed)
        x0, y0, x1, y1 = sheet.bounds(placed.footprint)
        if max(x1 - x0, y1 - y0) < 6.0:
            parts.append(
                f'<circle class="prop" cx="{(x0 + x1) / 2.0:.2f}" cy="{(y0 + y1) / 2.0:.2f}" r="3.2" fill="{fill}" '
                f'stroke="{_darker(fill)}"><title>{escape(title)}</title></circle>'
            )
            continue
        parts.append(_shape(sheet.path(placed.footprint), fill, stroke=_darker(fill), title=title, kind="prop"))
        length, breadth, _ = placed.prop.size
        if placed.prop.name in _FACING and length * sheet.scale > 4.0:
            tip = np.array([[0.5, 0.0, 0.0], [0.32, 0.42, 0.0], [0.32, -0.42, 0.0]]) * [length, breadth, 0.0]
            points = [(placed.X_WP @ point)[:2] for point in tip]
            parts.append(f'<path d="{sheet.line(points, closed=True)}" fill="{_darker(fill)}" fill-opacity="0.75"/>')
    return "\n".join(parts)


def _draw_overlaps(sheet: _Sheet, overlaps: Sequence[Overlap], names: _Names) -> str:
    parts = []
    for a, b, area in overlaps:
        title = f"{a} and {b} overlap"
        element = _shape(sheet.path(area), _RED, stroke="#991b1b", title=title, kind="overlap")
        parts.append(element.replace("<path ", '<path fill-opacity="0.75" stroke-width="1.5" '))
        x0, y0, x1, y1 = sheet.bounds(area)
        names.block((x0 - 2.0, y0 - 2.0, x1 + 2.0, y1 + 2.0), text=True)
        if max(x1 - x0, y1 - y0) < 12.0:
            x, y = (x0 + x1) / 2.0, (y0 + y1) / 2.0
            names.block((x - 12.0, y - 12.0, x + 12.0, y + 12.0))
            parts.append(f'<circle cx="{x:.2f}" cy="{y:.2f}" r="11" fill="none" stroke="{_RED}" stroke-width="2"/>')
    return "\n".join(parts)


def _draw_starts(sheet: _Sheet, world: World, names: _Names) -> str:
    """Arrows from the vehicle's origin on."""
    parts, boxes = [], []
    outline = np.array([[0.0, 3.5], [14.0, 3.5], [14.0, 9.0], [28.0, 0.0], [14.0, -9.0], [14.0, -3.5], [0.0, -3.5]])
    for name, start in world.starts.items():
        c, s = math.cos(start.yaw), math.sin(start.yaw)
        points = sheet.place([[start.x, start.y]]) + outline @ np.array([[c, -s], [s, c]])
        text = f"start {name} at ({start.x:.2f}, {start.y:.2f}) m, {math.degrees(start.yaw):.1f}°"
        data = "M" + "L".join(f"{x:.2f} {y:.2f}" for x, y in points) + "Z"
        parts.append(_shape(data, _BLUE, stroke="#ffffff", title=text, kind="start"))
        (x0, y0), (x1, y1) = points.min(axis=0), points.max(axis=0)
        boxes.append((name, (float(x0), float(y0), float(x1), float(y1))))
        names.block(boxes[-1][1], text=True)
    for name, box in boxes:
        names.write_beside([box], name, color=_BLUE, weight=700)
    return "\n".join(parts)


def _name_tracks(sheet: _Sheet, world: World, names: _Names) -> None:
    """The name of each road beside it, once; roads keep other names away."""
    for name, track in world.roads().items():
        s = np.linspace(0.0, track.length, 24, endpoint=False) + track.length / 48.0
        x, y = track.point(s)
        reach = track.width / 2.0 * sheet.scale + 2.0
        spots = [(px - reach, py - reach, px + reach, py + reach) for px, py in sheet.place(np.column_stack((x, y)))]
        if len(world.tracks) > 1 or reach < 20.0:
            names.write_beside(spots[len(spots) // 8 :] + spots, f"{name} ({track.length:.4g} m)", color=_MUTED)


def _name_patches(sheet: _Sheet, world: World, names: _Names) -> None:
    """Names of patches where they hardly reach beyond them; the key has the others."""
    for patch in world.patches:
        x0, y0, x1, y1 = sheet.bounds(patch.area)
        small = max(x1 - x0, y1 - y0) < 80.0
        texts = (_friction(patch.name, patch.surface, patch.mu), f"μ {patch.mu:.3g}")
        spots = [(text, point, room) for text in texts for point, room in _spots(sheet, patch.area)]
        if not any(
            (small or 0.7 * _length(text, 12.0) < room) and names.write_at(point, text) for text, point, room in spots
        ):
            names.write_beside([(x0, y0, x1, y1)] if small else [], texts[0])


def _spots(sheet: _Sheet, area: BaseGeometry) -> list[tuple[Array, float]]:
    """Places in the picture within an area, and how far it reaches there from left to right [px]."""
    x0, y0, x1, y1 = area.bounds
    found = []
    for part in (0.5, 0.3, 0.7, 0.1, 0.9):
        x, y = x0 + part * (x1 - x0), y0 + part * (y1 - y0)
        for line in (shapely.LineString([(x0, y), (x1, y)]), shapely.LineString([(x, y0), (x, y1)])):
            chords = shapely.get_parts(area.intersection(line))
            if not len(chords):
                continue
            middle = max(chords, key=lambda chord: float(chord.length)).centroid
            level = area.intersection(shapely.LineString([(x0, middle.y), (x1, middle.y)]))
            room = min(shapely.get_parts(level), key=lambda chord: float(chord.distance(middle))).length
            found.append((sheet.place(middle.coords)[0], room * sheet.scale))
    return found


def _name_props(sheet: _Sheet, world: World, names: _Names) -> None:
    """Names inside of props where they fit, otherwise the name of a series or a group once."""
    groups: dict[str, list[PlacedProp]] = {}
    series: dict[str, list[PlacedProp]] = {}
    for placed in world.props:
        if "." in placed.name:
            groups.setdefault(placed.name.partition(".")[0], []).append(placed)
        series.setdefault(re.sub(r"\[\d+\]$", "", placed.name), []).append(placed)
    lonely = {name: members for name, members in series.items() if len(members) == 1}
    for name, members in sorted(series.items(), key=lambda item: item[0] not in lonely):
        nested = "." in name
        full = [placed.name for placed in members]
        short = [text.rpartition(".")[2] for text in full]
        if not _write_all(names, members, short if nested else full):
            if name not in lonely:
                _write_all(names, members, [placed.name[len(name) :].strip("[]") for placed in members])
            if not nested:
                text = members[0].name if name in lonely else f"{name} × {len(members)}"
                names.write_beside(_near(sheet, members), text)
    for name, members in groups.items():
        names.write_beside(_near(sheet, members), name, weight=700)


def _write_all(names: _Names, members: Sequence[PlacedProp], texts: Sequence[str]) -> bool:
    """Write a name into each of some props where it fits, if it fits into most of them."""
    pairs = list(zip(members, texts, strict=True))
    fits = sum(names.write_inside(placed.footprint, text, _fill(placed), only_try=True) for placed, text in pairs)
    if fits < 0.6 * len(pairs):
        return False
    for placed, text in pairs:
        names.write_inside(placed.footprint, text, _fill(placed))
    return True


def _near(sheet: _Sheet, members: Sequence[PlacedProp]) -> list[Box]:
    """Boxes beside which the name of some props may stand: those of the first few, and that around all."""
    boxes = [sheet.bounds(placed.footprint) for placed in members]
    table = np.array(boxes)
    (x0, y0), (x1, y1) = table[:, :2].min(axis=0).tolist(), table[:, 2:].max(axis=0).tolist()
    return [*boxes[:20], (x0, y0, x1, y1)]


def _draw_grid(sheet: _Sheet) -> str:
    lines = [f"M{x:.2f} {sheet.top:.2f}V{sheet.bottom:.2f}" for x, _ in _ticks(sheet, 0)]
    lines += [f"M{sheet.left:.2f} {y:.2f}H{sheet.left + sheet.width:.2f}" for y, _ in _ticks(sheet, 1)]
    return f'<path d="{"".join(lines)}" fill="none" stroke="{_INK}" stroke-opacity="0.07"/>'


def _draw_ticks(sheet: _Sheet) -> str:
    parts = [_text(x, sheet.bottom + 16.0, t, size=11.0, color=_MUTED, anchor="middle") for x, t in _ticks(sheet, 0)]
    parts += [_text(sheet.left - 7.0, y, t, size=11.0, color=_MUTED, anchor="end", middle=True)
              for y, t in _ticks(sheet, 1)]  # fmt: skip
    return "\n".join(parts)


def _ticks(sheet: _Sheet, axis: int) -> list[tuple[float, str]]:
    """Places in the picture of round coordinates, and what stands there."""
    step = 2.0 * round_down(50.0 / sheet.scale)
    step = step if str(step).strip("0.")[0] in "125" else 5.0 * step / 4.0
    low, size = (sheet.x, sheet.width) if axis == 0 else (sheet.y, sheet.height)
    marks = np.arange(math.ceil(low / step), math.floor((low + size / sheet.scale) / step) + 1) * step
    placed = sheet.place(np.column_stack((marks, marks)))[:, axis]
    return [(place, f"{mark + 0.0:g}".replace("-", "−")) for place, mark in zip(placed.tolist(), marks, strict=True)]


def _draw_scale(sheet: _Sheet, names: _Names) -> str:
    """A bar of a round length at the bottom left, the axes at the bottom right."""
    length = round_down(160.0 / sheet.scale)
    x, y, long = sheet.left + 16.0, sheet.bottom - 16.0, length * sheet.scale
    text = f"{length:g} m"
    parts = [
        f'<path d="M{x:.2f} {y - 4:.2f}v8M{x:.2f} {y:.2f}h{long:.2f}m0 -4v8" stroke="{_INK}" stroke-width="1.6" '
        'fill="none"/>',
        _text(x + long / 2.0, y - 7.0, text, anchor="middle", halo=True),
    ]
    names.block((x - 6.0, y - 24.0, x + long + 6.0, y + 8.0), text=True)
    x, y = sheet.left + sheet.width - 58.0, sheet.bottom - 18.0
    for dx, dy, name, color in ((1.0, 0.0, "x", "#b91c1c"), (0.0, -1.0, "y", _GREEN)):
        tip = (x + 32.0 * dx, y + 32.0 * dy)
        sides = ((6.0 * dx, 6.0 * dy), (4.0 * dy, 4.0 * dx), (-4.0 * dy, -4.0 * dx))
        corners = "L".join(f"{tip[0] + px:.2f} {tip[1] + py:.2f}" for px, py in sides)
        parts += [
            f'<path d="M{x:.2f} {y:.2f}L{tip[0]:.2f} {tip[1]:.2f}" stroke="{color}" stroke-width="2"/>',
            f'<path d="M{corners}Z" fill="{color}"/>',
            _text(tip[0] + 13.0 * dx, tip[1] + 13.0 * dy, name, color=color, weight=700, anchor="middle", middle=True),
        ]
    names.block((x - 8.0, y - 56.0, x + 54.0, y + 10.0), text=True)
    return "\n".join(parts)


# --- the key -----------------------------------------------------------------------------------------------------


def _key(world: World, overlaps: Sequence[Overlap]) -> list[str]:
    """Rows of the key as templates of their place."""
    ground = world.ground
    parts = [("Ground", [_row([_GROUND[ground.surface]], _friction("ground", ground.surface, ground.mu))])]
    for name in world.roads():
        spec = world.spec.tracks[name]
        parts[0][1].append(_row([_ROAD[spec.surface]], _friction(name, spec.surface, track_mu(spec))))
    for patch in world.patches:
        fill = _ROAD.get(patch.surface or "", _PLAIN)
        parts[0][1].append(_row([fill], _friction(patch.name, patch.surface, patch.mu), dashed=True))
    if ground.grade:
        parts[0][1].append(_row([], f"slope {100 * ground.grade:g} % up towards {math.degrees(ground.heading):g}°"))
    kinds: dict[str, list[PlacedProp]] = {}
    for placed in world.props:
        kinds.setdefault(placed.prop.name, []).append(placed)
    fills = {kind: list(dict.fromkeys(map(_fill, members)))[:4] for kind, members in kinds.items()}
    parts.append(("Props", [_row(fills[kind], f"{len(members)} × {kind}") for kind, members in kinds.items()]))
    places = [_row([_BLUE], f"start {name}") for name in world.starts]
    for name, goal in world.goals.items():
        what = f": {goal.laps} lap{'s' if goal.laps > 1 else ''}" if goal.laps else ""
        places.append(_row([_GREEN], f"goal {name}{what}", dashed=True))
    parts.append(("Starts and goals", places))
    parts.append((f"Overlaps: {len(overlaps)}", [_row([_RED], f"{a}, {b}") for a, b, _ in overlaps]))
    rows: list[str] = []
    for title, entries in parts:
        if not entries:
            continue
        shown = entries if len(entries) <= _MOST_ROWS else entries[: _MOST_ROWS - 1]
        rest = [] if shown is entries else [_row([], f"and {len(entries) - len(shown)} more")]
        bold = 'dy="0.35em" font-size="13" font-weight="700"'
        heading = f'<text x="{{x:.2f}}" y="{{ym:.2f}}" {bold} fill="{_INK}">{title}</text>'
        rows += [*([""] if rows else []), heading, *shown, *rest]
    return rows


def _row(fills: Sequence[str], text: str, *, dashed: bool = False) -> str:
    """A row: a swatch with one or several colours, and a text that is cut where the picture ends."""
    while _length(text, 12.0) > _SIDE - 62.0:
        text = text[:-2].rstrip("…") + "…"
    dash = ' stroke-dasharray="3 2"' if dashed else ""
    swatch, part = "", 16.0 / max(len(fills), 1)
    for number, fill in enumerate(fills):
        swatch += (
            f'<rect x="{{x:.2f}}" y="{{y:.2f}}" transform="translate({number * part:.2f} 4)" width="{part:.2f}" '
            f'height="12" fill="{fill}" stroke="{_darker(fill)}"{dash}/>'
        )
    shown = str(escape(text)).replace("{", "{{").replace("}", "}}")
    return f'{swatch}<text x="{{x2:.2f}}" y="{{ym:.2f}}" dy="0.35em" font-size="12" fill="{_INK}">{shown}</text>'


def _about(world: World) -> str:
    xmin, ymin, xmax, ymax = world.ground.extent
    facts = [f"seed {world.spec.seed}"]
    for key, value in list(world.spec.params.items())[:5]:
        facts.append(f"{key} = {value:.6g}" if isinstance(value, int | float) else f"{key} = {value}")
    facts.append(f"{len(world.props)} prop{'s' * (len(world.props) != 1)}")
    return "  ·  ".join([*facts, f"ground {xmax - xmin:.4g} m × {ymax - ymin:.4g} m"])


# --- elements ----------------------------------------------------------------------------------------------------


def _shape(data: str, fill: str, *, stroke: str | None = None, title: str = "", kind: str = "") -> str:
    line = f' stroke="{stroke}"' if stroke else ""
    named = f' class="{kind}"' if kind else ""
    inner = f"<title>{escape(title)}</title>" if title else ""
    return f'<path d="{data}"{named} fill="{fill}" fill-rule="evenodd"{line}>{inner}</path>'


def _text(
    x: float, y: float, text: str, *, size: float = 12.0, color: str = _INK, weight: int = 400, anchor: str = "start",
    turn: int = 0, middle: bool = False, halo: bool = False,
) -> str:  # fmt: skip
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


def _length(text: str, size: float, *, bold: bool = False) -> float:
    """Length of a text [px]."""
    return float(_font(bold=bold).getlength(text)) * size / 24.0


def _friction(name: str, surface: str | None, mu: float) -> str:
    """What stands at a surface; its end is what is cut first."""
    return f"{name}: μ {mu:.3g}" if surface in {None, name} else f"{name}: μ {mu:.3g}, {surface}"


def _fill(placed: PlacedProp) -> str:
    if placed.color is not None:
        return "#" + "".join(f"{round(255.0 * min(1.0, max(0.0, part))):02x}" for part in placed.color)
    kind = placed.prop.name
    return _KINDS.get(kind) or _OTHERS[sum(kind.encode()) % len(_OTHERS)]


def _channels(color: str) -> tuple[int, int, int]:
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)


def _darker(color: str) -> str:
    return "#" + "".join(f"{round(0.58 * part):02x}" for part in _channels(color))


def _on(color: str) -> str:
    """Black or white, whichever is read better on a colour."""
    red, green, blue = _channels(color)
    return "#ffffff" if 0.299 * red + 0.587 * green + 0.114 * blue < 140.0 else "#111827"


def _simple(points: Array, tolerance: float) -> Array:
    return np.asarray(shapely.get_coordinates(shapely.simplify(shapely.LineString(points), tolerance)))
