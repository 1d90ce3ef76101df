"""Labels of a plan or a map: inside props and areas or beside them, without overlaps."""

import re
from collections.abc import Iterable, Sequence

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from mirdrake.report.map_props import prop_box
from mirdrake.report.map_sheet import (
    DOCUMENT,
    INK,
    MUTED,
    Array,
    Box,
    Sheet,
    fill_of,
    friction_label,
    ink_on,
    text_length,
    text_tag,
)
from mirdrake.worlds import PlacedProp, World

_APART = 3.0  # [px] least distance between a label and a prop


class Labels:
    """Labels that do not overlap.

    Args:
        sheet: where they are written.
        paper: colour around those that are beside something.

    Attributes:
        elements: SVG elements.
    """

    def __init__(self, sheet: Sheet, *, paper: str = DOCUMENT.paper) -> None:
        self._sheet, self._paper = sheet, paper
        self._texts, self._things, self._roads, self._props = _Boxes(), _Boxes(), _Boxes(), _Boxes()
        self.elements: list[str] = []

    def block(self, box: Box, *, text: bool = False) -> None:
        """Keep labels out of a box; with `text`, also labels inside props."""
        (self._texts if text else self._things).add(box)

    def avoid_prop(self, box: Box) -> None:
        """Prefer positions of labels that do not touch the box of a prop, even if they are on a road."""
        x0, y0, x1, y1 = box
        self._props.add((x0 - _APART, y0 - _APART, x1 + _APART, y1 + _APART))

    def avoid(self, points: Array, reach: float) -> None:
        """Prefer positions of labels that are away from points of the picture."""
        for x, y in points.tolist():
            self._roads.add((x - reach, y - reach, x + reach, y + reach))

    def avoid_line(self, points: Array, reach: float) -> None:
        """Prefer positions of labels that are away from a polyline of the picture."""
        distance = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
        along = np.arange(0.0, distance[-1] + reach, reach)
        self.avoid(np.column_stack([np.interp(along, distance, points[:, axis]) for axis in (0, 1)]), reach)

    def write_inside(self, area: BaseGeometry, text: str, fill: str, *, only_try: bool = False) -> bool:
        """Write a label inside an area of W, horizontally or vertically; return whether it fits.

        Args:
            area: area in W.
            text: text of the label.
            fill: colour of the area.
            only_try: write nothing.
        """
        long, high = text_length(text, 12.0) + 5.0, 14.0
        x0, y0, x1, y1 = self._sheet.bounds(area)
        # A quick test: most props are smaller than any label.
        if max(x1 - x0, y1 - y0) < min(long, high):
            return False
        # The hull, as a label may cross a notch but must not reach outside.
        shape = shapely.Polygon(self._sheet.place(shapely.get_coordinates(area.convex_hull)))
        middle = shape.centroid
        # Horizontal first, then vertical for narrow areas.
        for wide, tall, turn in ((long, high, 0), (high, long, -90)):
            for dx, dy in ((0.0, 0.0), (0.0, -0.25), (0.0, 0.25), (-0.25, 0.0), (0.25, 0.0)):
                x, y = middle.x + dx * (x1 - x0), middle.y + dy * (y1 - y0)
                box = (x - wide / 2.0, y - tall / 2.0, x + wide / 2.0, y + tall / 2.0)
                if not (shape.contains(shapely.box(*box)) and self._free(box, self._texts)):
                    continue
                if not only_try:
                    self._texts.add(box)
                    self.elements.append(
                        text_tag(x, y, text, color=ink_on(fill), anchor="middle", turn=turn, middle=True)
                    )
                return True
        return False

    def write_beside(self, boxes: Iterable[Box], text: str, *, color: str = INK, weight: int = 400) -> bool:
        """Write a label beside the first box of the picture with free room, if possible off the props and roads."""
        boxes = list(boxes)
        # First off props and roads, then off the props, then anywhere: a label on a road is better than none.
        choices = ((self._props, self._roads), (self._props,), ())
        return any(self._write_beside(boxes, text, color, weight, avoided=avoided) for avoided in choices)

    def _write_beside(
        self, boxes: Sequence[Box], text: str, color: str, weight: int, *, avoided: "Sequence[_Boxes]"
    ) -> bool:
        # Places are tried in the order in which maps are read: right, above, below, left, then the corners; then
        # further away.
        long, high = text_length(text, 12.0, bold=weight > 500), 15.0
        for x0, y0, x1, y1 in boxes:
            x, y = (x0 + x1) / 2.0, (y0 + y1) / 2.0
            for gap in (4.0, 14.0):
                # The anchor is the end of the text at the labelled object: texts are shorter than they are measured.
                for left, top, anchor in (
                    (x1 + gap, y - high / 2.0, "start"), (x - long / 2.0, y0 - gap - high, "middle"),
                    (x - long / 2.0, y1 + gap, "middle"), (x0 - gap - long, y - high / 2.0, "end"),
                    (x1 + gap / 2.0, y0 - gap / 2.0 - high, "start"), (x1 + gap / 2.0, y1 + gap / 2.0, "start"),
                    (x0 - gap / 2.0 - long, y0 - gap / 2.0 - high, "end"),
                    (x0 - gap / 2.0 - long, y1 + gap / 2.0, "end"),
                ):  # fmt: skip
                    box = (left, top, left + long, top + high)
                    if not all(self._free(box, taken) for taken in avoided):
                        continue
                    if self._write(left, top, (long, high), text, color, weight, anchor):
                        return True
        return False

    def write_at(self, point: Array, text: str) -> bool:
        """Write a label centred at a point of the picture, if there is room."""
        long, high = text_length(text, 12.0), 15.0
        left, top = float(point[0]) - long / 2.0, float(point[1]) - high / 2.0
        return self._write(left, top, (long, high), text, INK, 400, "middle")

    def _write(
        self, left: float, top: float, size: tuple[float, float], text: str, color: str, weight: int, anchor: str
    ) -> bool:
        box = (left - 1.0, top, left + size[0] + 1.0, top + size[1])
        if not (self._free(box, self._texts) and self._free(box, self._things)):
            return False
        self._texts.add(box)
        x, middle = left + {"start": 0.0, "middle": 0.5, "end": 1.0}[anchor] * size[0], top + size[1] / 2.0
        self.elements.append(
            text_tag(x, middle, text, color=color, weight=weight, anchor=anchor, middle=True, halo=self._paper)
        )
        return True

    def _free(self, box: Box, taken: "_Boxes") -> bool:
        sheet = self._sheet
        x0, y0, x1, y1 = box
        if x0 < sheet.left + 2 or x1 > sheet.left + sheet.width - 2 or y0 < sheet.top + 2 or y1 > sheet.bottom - 2:
            return False
        return not taken.overlap(box)


class _Boxes:
    """Boxes of the picture, in a table for fast comparisons."""

    def __init__(self) -> None:
        self._table, self._count = np.empty((64, 4)), 0

    def add(self, box: Box) -> None:
        # The table doubles, so that adding a box takes constant time on average.
        if self._count == len(self._table):
            self._table = np.concatenate((self._table, np.empty_like(self._table)))
        self._table[self._count] = box
        self._count += 1

    def overlap(self, box: Box) -> bool:
        """Whether one of the boxes overlaps another box."""
        x0, y0, x1, y1 = box
        table = self._table[: self._count]
        return bool(((table[:, 0] < x1) & (table[:, 2] > x0) & (table[:, 1] < y1) & (table[:, 3] > y0)).any())


# --- labels of a world -------------------------------------------------------------------------------------------


def label_tracks(sheet: Sheet, world: World, labels: Labels) -> None:
    """Write the name of each track beside it, once."""
    for name, track in world.roads().items():
        s = np.linspace(0.0, track.length, 24, endpoint=False) + track.length / 48.0
        x, y = track.point(s)
        reach = track.width / 2.0 * sheet.scale + 2.0
        spots = [(px - reach, py - reach, px + reach, py + reach) for px, py in sheet.place(np.column_stack((x, y)))]
        if len(world.tracks) > 1 or reach < 20.0:
            # An eighth of the way along, as the beginning often has a start line and an arrow.
            labels.write_beside(spots[len(spots) // 8 :] + spots, f"{name} ({track.length:.4g} m)", color=MUTED)


def label_patches(sheet: Sheet, world: World, labels: Labels) -> None:
    """Write the names of patches where they hardly reach beyond the patch; the key lists the others."""
    for patch in world.patches:
        x0, y0, x1, y1 = sheet.bounds(patch.area)
        # Beside a small patch there is room on the ground; beside a large one the name would seem to belong to
        # something else.
        small = max(x1 - x0, y1 - y0) < 80.0
        # The short text if the long one has no room: friction is what a patch is for.
        texts = (friction_label(patch.name, patch.surface, patch.mu), f"μ {patch.mu:.3g}")
        spots = [(text, point, room) for text in texts for point, room in _spots(sheet, patch.area)]
        if not any(
            (small or 0.7 * text_length(text, 12.0) < room) and labels.write_at(point, text)
            for text, point, room in spots
        ):
            labels.write_beside([(x0, y0, x1, y1)] if small else [], texts[0])


def _spots(sheet: Sheet, area: BaseGeometry) -> list[tuple[Array, float]]:
    """Return points of the picture within an area, and the horizontal extent of the area there [px]."""
    x0, y0, x1, y1 = area.bounds
    spots = []
    for part in (0.5, 0.3, 0.7, 0.1, 0.9):
        x, y = x0 + part * (x1 - x0), y0 + part * (y1 - y0)
        for line in (shapely.LineString([(x0, y), (x1, y)]), shapely.LineString([(x, y0), (x, y1)])):
            chords = shapely.get_parts(area.intersection(line))
            if not len(chords):
                continue
            # The longest chord is where the area has the most room.
            middle = max(chords, key=lambda chord: float(chord.length)).centroid
            level = area.intersection(shapely.LineString([(x0, middle.y), (x1, middle.y)]))
            room = min(shapely.get_parts(level), key=lambda chord: float(chord.distance(middle))).length
            spots.append((sheet.place(middle.coords)[0], room * sheet.scale))
    return spots


def label_props(sheet: Sheet, world: World, labels: Labels) -> None:
    """Write names inside props and actors where they fit, otherwise the name of a series or group once."""
    groups: dict[str, list[PlacedProp]] = {}
    series: dict[str, list[PlacedProp]] = {}
    for placed in [*world.props, *(actor.placed(*world.actor_start(actor)) for actor in world.actors)]:
        if "." in placed.name:
            groups.setdefault(placed.name.partition(".")[0], []).append(placed)
        series.setdefault(re.sub(r"\[\d+\]$", "", placed.name), []).append(placed)
    single = {name: members for name, members in series.items() if len(members) == 1}
    # Single props first: their names cannot be replaced by that of a series.
    for name, members in sorted(series.items(), key=lambda item: item[0] not in single):
        nested = "." in name
        full = [placed.name for placed in members]
        short = [text.rpartition(".")[2] for text in full]
        if not _write_all(labels, members, short if nested else full):
            if name not in single:
                _write_all(labels, members, [placed.name[len(name) :].strip("[]") for placed in members])
            if not nested:
                text = members[0].name if name in single else f"{name} × {len(members)}"
                labels.write_beside(_near(sheet, members), text)
    for name, members in groups.items():
        labels.write_beside(_near(sheet, members), name, weight=700)
    for vehicle in world.full_actors:
        labels.write_beside([sheet.bounds(vehicle.area(*world.actor_start(vehicle)))], vehicle.name)


def _write_all(labels: Labels, members: Sequence[PlacedProp], texts: Sequence[str]) -> bool:
    """Write a name into each prop where it fits, if it fits into most of them."""
    pairs = list(zip(members, texts, strict=True))
    fits = sum(labels.write_inside(placed.footprint, text, fill_of(placed), only_try=True) for placed, text in pairs)
    # If the names fit into a few members only, that of the series is written once instead.
    if fits < 0.6 * len(pairs):
        return False
    for placed, text in pairs:
        labels.write_inside(placed.footprint, text, fill_of(placed))
    return True


def _near(sheet: Sheet, members: Sequence[PlacedProp]) -> list[Box]:
    """Return boxes for a common label of props: those of the first few, and the box around all."""
    boxes = [prop_box(placed, sheet) for placed in members]
    table = np.array(boxes)
    (x0, y0), (x1, y1) = table[:, :2].min(axis=0).tolist(), table[:, 2:].max(axis=0).tolist()
    return [*boxes[:20], (x0, y0, x1, y1)]
