"""Where the props of one entry stand: grids, lines, along tracks, rings, or anywhere in an area."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.yaml_io import where
from mirdrake.worlds.draw import Draw
from mirdrake.worlds.props_spec import LARGEST_COUNT, AlongSpec, PropEntry
from mirdrake.worlds.regions import Places, make_region

_TRIES = 10_000  # draws of a point in an area, before it is called too thin


@dataclass(frozen=True)
class Slot:
    """A place of a layout, in the frame of the world or the group."""

    x: float
    """[m]"""
    y: float
    """[m]"""
    heading: float
    """[rad]"""
    row: int
    """of a grid, else its number in the layout"""
    area: BaseGeometry | None = None
    """the place is drawn in it"""


def make_slots(entry: PropEntry, places: Places, draw: Draw) -> list[Slot]:
    """The places of an entry, in order.

    Args:
        entry: with one layout.
        places: tracks and patches.
        draw: finds the values of the layout.

    Raises:
        ConfigError: a value is wrong, a track or region is unknown, or there are too many places.
    """
    slots = list(_slots(entry, places, draw))
    if len(slots) > LARGEST_COUNT:
        raise ConfigError(f"{where(entry)}: {len(slots)} props; allowed are {LARGEST_COUNT}")
    return slots


def draw_in(area: BaseGeometry, draw: Draw, *, place: str) -> tuple[float, float]:
    """A point [m] in an area, all equally likely.

    Raises:
        ConfigError: the area is too thin to be hit.
    """
    generator = draw.stream("place").generator
    xmin, ymin, xmax, ymax = area.bounds
    shapely.prepare(area)
    for _ in range(_TRIES // 100):
        points = generator.uniform((xmin, ymin), (xmax, ymax), (100, 2))
        hits = np.nonzero(shapely.contains_xy(area, points[:, 0], points[:, 1]))[0]
        if hits.size:
            x, y = points[hits[0]]
            return float(x), float(y)
    raise ConfigError(f"{place}: the region is too thin to draw points in it")


# --- the inner parts ----------------------------------------------------------------------------------------------


def _slots(entry: PropEntry, places: Places, draw: Draw) -> Iterator[Slot]:
    if entry.at is not None:
        x, y = draw.numbers(entry.at[:2], "m", "at", entry)
        yield Slot(x, y, 0.0, 0)
    elif entry.grid is not None:
        x, y = draw.numbers(entry.grid.origin, "m", "origin", entry.grid)
        dx, dy = draw.numbers(entry.grid.step, "m", "step", entry.grid)
        columns, rows = (
            draw.count(value, f"count[{i}]", entry.grid, largest=LARGEST_COUNT)
            for i, value in enumerate(entry.grid.count)
        )
        if columns * rows > LARGEST_COUNT:
            raise ConfigError(f"{where(entry.grid, 'count')}: {columns * rows} props; allowed are {LARGEST_COUNT}")
        for row in range(rows):
            for column in range(columns):
                yield Slot(x + column * dx, y + row * dy, 0.0, row)
    elif entry.line is not None:
        (x0, y0), (x1, y1) = (draw.numbers(getattr(entry.line, key), "m", key, entry.line) for key in ("from_", "to"))
        length = math.hypot(x1 - x0, y1 - y0)
        heading = math.atan2(y1 - y0, x1 - x0)
        for index, share in enumerate(_shares(entry.line, length, draw, open_ended=True)):
            yield Slot(x0 + share * (x1 - x0), y0 + share * (y1 - y0), heading, index)
    elif entry.along is not None:
        yield from _along(entry.along, places, draw)
    elif entry.ring is not None:
        x, y = draw.numbers(entry.ring.center, "m", "center", entry.ring)
        radius = draw.number(entry.ring.radius, "m", "radius", entry.ring)
        count = draw.count(entry.ring.count, "count", entry.ring, largest=LARGEST_COUNT)
        for index in range(count):
            angle = 2.0 * math.pi * index / count
            yield Slot(x + radius * math.cos(angle), y + radius * math.sin(angle), angle + math.pi / 2.0, index)
    else:
        assert entry.scatter is not None
        scatter = entry.scatter
        area = make_region(scatter.region, places, draw, place=where(scatter, "region"))
        for index in range(draw.count(scatter.count, "count", scatter, largest=LARGEST_COUNT)):
            yield Slot(0.0, 0.0, 0.0, index, area)


def _shares(spec: "object", length: float, draw: Draw, *, open_ended: bool) -> list[float]:
    """Parts of the way, 0 .. 1, of things at equal distances; both ends if open."""
    spacing, count = spec.spacing, spec.count  # type: ignore[attr-defined]
    if count is not None:
        number = draw.count(count, "count", spec, largest=LARGEST_COUNT)  # type: ignore[arg-type]
    else:
        gap = draw.number(spacing, "m", "spacing", spec)  # type: ignore[arg-type]
        if not gap > 0.0 or length / gap > LARGEST_COUNT:
            place = where(spec, "spacing")  # type: ignore[arg-type]
            raise ConfigError(f"{place}: {gap:g} m; it must be above 0 and give at most {LARGEST_COUNT} props")
        number = math.ceil(length / gap - 1e-9) + (1 if open_ended else 0)
    if number <= 1:
        return [0.0] * number
    return [index / (number - 1 if open_ended else number) for index in range(number)]


def _along(spec: AlongSpec, places: Places, draw: Draw) -> Iterator[Slot]:
    if spec.track not in places.tracks:
        hint = did_you_mean(spec.track, places.tracks) if places.tracks else "the world has none"
        raise ConfigError(f"{where(spec, 'track')}: unknown track '{spec.track}'; {hint}")
    track = places.tracks[spec.track]
    begin, end = draw.numbers(spec.s, "m", "s", spec) if spec.s is not None else (0.0, track.length)
    whole = track.closed and end - begin >= track.length - 1e-9
    shares = _shares(spec, end - begin, draw, open_ended=not whole)
    distance = draw.number(spec.distance, "m", "distance", spec)
    middle = draw.number(spec.offset, "m", "offset", spec)
    for index, share in enumerate(shares):
        s = begin + share * (end - begin)
        x, y, yaw = track.pose_at(s)
        left, right = float(track.left_width(s)) + distance, -float(track.right_width(s)) - distance
        offsets = {"left": (left,), "right": (right,), "both": (left, right), "center": (middle,)}[spec.side]
        for offset in offsets:
            yield Slot(x - offset * math.sin(yaw), y + offset * math.cos(yaw), yaw, index)
