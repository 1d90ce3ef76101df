"""Layouts: positions of the props of one entry.

A new layout is a class derived from :class:`Layout` and a field of :class:`mirdrake.worlds.props_spec.PropEntry`.
"""

# ruff: noqa: ARG002  # all kinds share one signature

import math
from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Literal, Self

import numpy as np
import shapely
from pydantic import Field, RootModel, model_validator
from shapely.geometry.base import BaseGeometry

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import Schema, where
from mirdrake.worlds.draw import Draw
from mirdrake.worlds.regions import NamedAreas, RegionSpec, make_region
from mirdrake.worlds.schema_types import LARGEST_COUNT, Pair, Value, exactly_one, origin
from mirdrake.worlds.tracks import find_track
from mirdrake.worlds.values import Number, is_random

_TRIES = 10_000  # draws of a point in an area, before it is called too thin


@dataclass(frozen=True)
class Slot:
    """A position of a layout, in the frame of the world or the group."""

    x: float
    """[m]"""
    y: float
    """[m]"""
    heading: float
    """[rad]"""
    row: int
    """row of a grid, else the number of the position in the layout"""
    area: BaseGeometry | None = None
    """area in which the position is drawn at random"""


class Layout:
    """A kind of layout."""

    @abstractmethod
    def slots(self, entry: Schema, areas: NamedAreas, draw: Draw) -> Iterator[Slot]:
        """Yield the positions in their order.

        Args:
            entry: entry of the file, for messages.
            areas: tracks and patches.
            draw: evaluates values.

        Raises:
            ConfigError: a value is invalid, or a track or region is unknown.
        """

    @property
    def random_values(self) -> list[Number | str]:
        """Values that make the positions random if one of them is."""
        return []

    @property
    def is_random(self) -> bool:
        """Whether the positions are drawn at random."""
        return any(map(is_random, self.random_values))


class AtLayout(RootModel[Annotated[list[Value], Field(min_length=2, max_length=3)]], Layout):
    """One position: x, y and optionally z [m]."""

    def slots(self, entry: Schema, areas: NamedAreas, draw: Draw) -> Iterator[Slot]:
        """Yield the position."""
        x, y = self.position(entry, draw)
        yield Slot(x, y, 0.0, 0)

    def position(self, entry: Schema, draw: Draw) -> tuple[float, float]:
        """Return x and y [m]."""
        x, y = draw.numbers(self.root[:2], "m", "at", entry)
        return x, y

    @property
    def z(self) -> Number | str | None:
        """Height, or None if it is not given."""
        return self.root[2] if len(self.root) == 3 else None

    @property
    def random_values(self) -> list[Number | str]:
        """Values that make the position random if one of them is."""
        return self.root


class GridLayout(Schema, Layout):
    """Columns along x, rows along y."""

    origin: Pair = Field(default_factory=origin, description="first position [m]")
    step: Pair = Field(description="spacing along x and y [m]")
    count: Pair = Field(description="number of columns and rows [-]")

    def slots(self, entry: Schema, areas: NamedAreas, draw: Draw) -> Iterator[Slot]:
        """Yield the positions, row by row."""
        x, y = draw.numbers(self.origin, "m", "origin", self)
        dx, dy = draw.numbers(self.step, "m", "step", self)
        columns, rows = (
            draw.count(value, f"count[{i}]", self, largest=LARGEST_COUNT) for i, value in enumerate(self.count)
        )
        if columns * rows > LARGEST_COUNT:
            raise ConfigError(
                f"{columns * rows} props; at most {LARGEST_COUNT} are allowed", where=where(self, "count")
            )
        for row in range(rows):
            for column in range(columns):
                yield Slot(x + column * dx, y + row * dy, 0.0, row)


class LineLayout(Schema, Layout):
    """From one point to another, both included; x of the props points along the line."""

    from_: Pair = Field(alias="from", description="first position [m]")
    to: Pair = Field(description="last position [m]")
    spacing: Value | None = Field(default=None, description="largest distance between neighbours [m]")
    count: Value | None = Field(default=None, description="number of props [-]")

    @model_validator(mode="after")
    def _one(self) -> Self:
        exactly_one(self, ("spacing", "count"))
        return self

    def slots(self, entry: Schema, areas: NamedAreas, draw: Draw) -> Iterator[Slot]:
        """Yield the positions."""
        x0, y0 = draw.numbers(self.from_, "m", "from_", self)
        x1, y1 = draw.numbers(self.to, "m", "to", self)
        heading = math.atan2(y1 - y0, x1 - x0)
        shares = _shares(self, self.spacing, self.count, math.hypot(x1 - x0, y1 - y0), draw, is_open=True)
        for index, share in enumerate(shares):
            yield Slot(x0 + share * (x1 - x0), y0 + share * (y1 - y0), heading, index)


class AlongLayout(Schema, Layout):
    """Along a track; x of the props points along it."""

    track: str = Field(description="name of the track [-]")
    s: Pair | None = Field(
        default=None, description="range of s along the centre line, from and to; default: all of it [m]"
    )
    spacing: Value | None = Field(default=None, description="largest distance between neighbours [m]")
    count: Value | None = Field(default=None, description="number of props, on each side [-]")
    side: Literal["left", "right", "both", "center"] = Field(default="center", description="side of the road [-]")
    distance: Value = Field(default=1.0, description="distance from the edge of the road, outwards [m]")
    offset: Value = Field(default=0.0, description="offset to the left of the centre line, for side: center [m]")

    @model_validator(mode="after")
    def _one(self) -> Self:
        exactly_one(self, ("spacing", "count"))
        if self.side != "center" and "offset" in self.model_fields_set:
            raise ValueError("offset belongs to side: center; give distance")
        if self.side == "center" and "distance" in self.model_fields_set:
            raise ValueError("distance belongs to side: left, right or both; give offset")
        return self

    def slots(self, entry: Schema, areas: NamedAreas, draw: Draw) -> Iterator[Slot]:
        """Yield the positions, the left one of a pair first."""
        track = find_track(self.track, areas.tracks, where=where(self, "track"))
        begin, end = draw.numbers(self.s, "m", "s", self) if self.s is not None else (0.0, track.length)
        # On a closed track a range may run over the start: its end then has the smaller station.
        if track.closed and end < begin:
            end += track.length
        # On the whole of a closed track the last position would be the first one again.
        whole = track.closed and end - begin >= track.length - 1e-9
        shares = _shares(self, self.spacing, self.count, abs(end - begin), draw, is_open=not whole)
        distance = draw.number(self.distance, "m", "distance", self)
        middle = draw.number(self.offset, "m", "offset", self)
        for index, share in enumerate(shares):
            s = begin + share * (end - begin)
            x, y, yaw = track.pose_at(s)
            left, right = float(track.left_width(s)) + distance, -float(track.right_width(s)) - distance
            offsets = {"left": (left,), "right": (right,), "both": (left, right), "center": (middle,)}[self.side]
            for offset in offsets:
                yield Slot(x - offset * math.sin(yaw), y + offset * math.cos(yaw), yaw, index)


class RingLayout(Schema, Layout):
    """On a circle, the first one on its x axis; x of the props points along the tangent, counter-clockwise."""

    center: Pair = Field(default_factory=origin, description="centre of the circle [m]")
    radius: Value = Field(description="radius of the circle [m]")
    count: Value = Field(description="number of props [-]")

    def slots(self, entry: Schema, areas: NamedAreas, draw: Draw) -> Iterator[Slot]:
        """Yield the positions."""
        x, y = draw.numbers(self.center, "m", "center", self)
        radius = draw.number(self.radius, "m", "radius", self)
        count = draw.count(self.count, "count", self, largest=LARGEST_COUNT)
        for index in range(count):
            angle = 2.0 * math.pi * index / count
            yield Slot(x + radius * math.cos(angle), y + radius * math.sin(angle), angle + math.pi / 2.0, index)


class ScatterLayout(Schema, Layout):
    """At random in a region, without touching anything."""

    region: RegionSpec | str = Field(description="a region, or the name of a patch or a track [-]")
    count: Value = Field(description="number of props [-]")

    def slots(self, entry: Schema, areas: NamedAreas, draw: Draw) -> Iterator[Slot]:
        """Yield the region once for each prop."""
        area = make_region(self.region, areas, draw, location=where(self, "region"))
        for index in range(draw.count(self.count, "count", self, largest=LARGEST_COUNT)):
            yield Slot(0.0, 0.0, 0.0, index, area)

    @property
    def is_random(self) -> bool:
        """Whether the positions are drawn at random: always."""
        return True


def draw_in(area: BaseGeometry, draw: Draw, *, location: str) -> tuple[float, float]:
    """Return a point [m] of an area, all equally likely.

    Raises:
        ConfigError: the area is too thin.
    """
    generator = draw.stream("place").generator
    xmin, ymin, xmax, ymax = area.bounds
    shapely.prepare(area)
    # Rejection sampling, a hundred points at a time: uniform in any shape of the area.
    for _ in range(_TRIES // 100):
        points = generator.uniform((xmin, ymin), (xmax, ymax), (100, 2))
        hits = np.nonzero(shapely.contains_xy(area, points[:, 0], points[:, 1]))[0]
        if hits.size:
            x, y = points[hits[0]]
            return float(x), float(y)
    raise ConfigError("the region is too thin to draw points in it; make it wider", where=location)


def _shares(
    spec: Schema, spacing: Number | str | None, count: Number | str | None, length: float, draw: Draw, *, is_open: bool
) -> list[float]:
    """Return positions at equal distances as shares of a length [m], 0 .. 1; both ends if it is open."""
    if count is not None:
        number = draw.count(count, "count", spec, largest=LARGEST_COUNT)
    else:
        assert spacing is not None
        gap = draw.number(spacing, "m", "spacing", spec)
        if not gap > 0.0 or length / gap > LARGEST_COUNT:
            raise ConfigError(
                f"{gap:g} m; it must be above 0 and give at most {LARGEST_COUNT} props", where=where(spec, "spacing")
            )
        # The spacing is the largest distance allowed; the tolerance absorbs rounding of the quotient.
        number = math.ceil(length / gap - 1e-9) + (1 if is_open else 0)
    if number <= 1:
        return [0.0] * number
    return [index / (number - 1 if is_open else number) for index in range(number)]
