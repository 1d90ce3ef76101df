"""Regions of a world as shapely polygons in W [m].

A new kind of region is a class derived from :class:`Region` and a field of :class:`RegionSpec`.
"""

# ruff: noqa: ARG002  # all kinds share one signature

import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np
import shapely
from pydantic import Field, RootModel, model_validator
from shapely.geometry.base import BaseGeometry

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.yaml_io import Schema, where
from mirdrake.worlds.draw import Draw
from mirdrake.worlds.pieces import Array
from mirdrake.worlds.schema_types import Label, Pair, SurfaceName, Value, exactly_one, given_one, kinds_of, origin
from mirdrake.worlds.tracks import Offset, Track, find_track, offset_at

_QUARTER = 16  # segments of a quarter of a disc


@dataclass(frozen=True)
class Patch:
    """A part of the ground with its own friction."""

    name: str
    area: BaseGeometry
    """polygon in W [m]"""
    surface: str | None
    """appearance; None: that of what is below"""
    mu: float
    """friction coefficient [-]"""


@dataclass(frozen=True)
class NamedAreas:
    """Tracks and patches to which regions and layouts may refer by name."""

    tracks: Mapping[str, Track]
    patches: Mapping[str, Patch]


# --- kinds of regions ---------------------------------------------------------------------------------------------


class Region:
    """A kind of region."""

    @abstractmethod
    def polygon(self, spec: "RegionSpec", areas: NamedAreas, draw: Draw) -> BaseGeometry | None:
        """Return the polygon in W [m], or None if a size is not above 0.

        Args:
            spec: entry of the file, for messages and random streams.
            areas: tracks and patches.
            draw: evaluates values.
        """


class RectSpec(Schema, Region):
    """A rectangle."""

    center: Pair = Field(default_factory=origin, description="its centre [m]")
    size: Pair = Field(description="size along its x and its y [m]")
    yaw: Value = Field(default=0.0, description="heading of its x axis [rad]")

    def polygon(self, spec: "RegionSpec", areas: NamedAreas, draw: Draw) -> BaseGeometry | None:
        """Return the polygon."""
        x, y = draw.numbers(self.center, "m", "rect.center", spec)
        length, width = draw.numbers(self.size, "m", "rect.size", spec)
        yaw = draw.number(self.yaw, "rad", "rect.yaw", spec)
        half = np.array([length, width]) / 2.0
        corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * half
        turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
        return shapely.Polygon(corners @ turn.T + [x, y]) if min(length, width) > 0.0 else None


class DiscSpec(Schema, Region):
    """A disc."""

    center: Pair = Field(default_factory=origin, description="its centre [m]")
    radius: Value = Field(description="its radius [m]")

    def polygon(self, spec: "RegionSpec", areas: NamedAreas, draw: Draw) -> BaseGeometry | None:
        """Return the polygon."""
        x, y = draw.numbers(self.center, "m", "disc.center", spec)
        radius = draw.number(self.radius, "m", "disc.radius", spec)
        return shapely.Point(x, y).buffer(radius, _QUARTER) if radius > 0.0 else None


class PolygonSpec(RootModel[Annotated[list[Pair], Field(min_length=3, max_length=1000)]], Region):
    """A polygon by its corners."""

    def polygon(self, spec: "RegionSpec", areas: NamedAreas, draw: Draw) -> BaseGeometry | None:
        """Return the polygon."""
        points = [draw.numbers(point, "m", f"polygon[{i}]", spec) for i, point in enumerate(self.root)]
        # Corners in an order that crosses itself are allowed; the area is that of both loops.
        return shapely.make_valid(shapely.Polygon(points))


class BandSpec(Schema, Region):
    """A strip along a track."""

    track: str = Field(description="name of the track [-]")
    s: Pair | None = Field(
        default=None, description="range of s along the centre line, from and to; default: all of it [m]"
    )
    right: Value | None = Field(default=None, description="offset of its right side, + left; default: road's edge [m]")
    left: Value | None = Field(default=None, description="offset of its left side, + left; default: road's edge [m]")

    def polygon(self, spec: "RegionSpec", areas: NamedAreas, draw: Draw) -> BaseGeometry | None:
        """Return the polygon."""
        track = find_track(self.track, areas.tracks, where=where(self, "track"))
        left: Offset = track.left_width
        right: Offset = lambda s: -track.right_width(s)  # noqa: E731
        if self.left is not None:
            left = draw.number(self.left, "m", "band.left", spec)
        if self.right is not None:
            right = draw.number(self.right, "m", "band.right", spec)
        begin, end = (0.0, track.length) if self.s is None else draw.numbers(self.s, "m", "band.s", spec)
        # On a closed track a strip may run over the start: its end then has the smaller station.
        s = np.linspace(begin, end + track.length if track.closed and end < begin else end, 1000)
        if np.min(offset_at(left, s) - offset_at(right, s)) <= 0.0:
            return None
        return track.band(right, left) if self.s is None else strip(track, begin, end, right, left)


class RegionSpec(Schema):
    """An area: exactly one of rect, disc, polygon and band."""

    rect: RectSpec | None = Field(default=None, description="rectangle [-]")
    disc: DiscSpec | None = Field(default=None, description="disc [-]")
    polygon: PolygonSpec | None = Field(default=None, description="corners in their order [m]")
    band: BandSpec | None = Field(default=None, description="strip along a track [-]")

    @model_validator(mode="after")
    def _one(self) -> Self:
        exactly_one(self, kinds_of(RegionSpec, Region))
        return self


class PatchSpec(RegionSpec):
    """A part of the ground with its own friction; it is above ground, roads and earlier patches."""

    name: Label | None = Field(default=None, description="its name, by which rules and regions refer to it [-]")
    surface: SurfaceName | None = Field(default=None, description="appearance; default: that of what is below [-]")
    mu: Value | None = Field(default=None, description="friction coefficient; default: that of the surface [-]")

    @model_validator(mode="after")
    def _has_an_effect(self) -> Self:
        if self.surface is None and self.mu is None:
            raise ValueError("give surface, mu or both")
        return self


def make_region(spec: RegionSpec | str, areas: NamedAreas, draw: Draw, *, location: str = "") -> BaseGeometry:
    """Return a region as a polygon in W [m].

    Args:
        spec: the region, or the name of a patch or a track.
        areas: patches and tracks.
        draw: evaluates values.
        location: ``file:line: path`` of a name.

    Raises:
        ConfigError: the name is unknown, or the region is empty.
    """
    # A name is that of a patch or a track; anything else is a shape.
    if isinstance(spec, str):
        if spec in areas.patches:
            return areas.patches[spec].area
        if spec in areas.tracks:
            return areas.tracks[spec].area
        known = [*areas.patches, *areas.tracks]
        hint = did_you_mean(spec, known) if known else "the world has no patches or tracks; give rect, disc or polygon"
        raise ConfigError(f"unknown region '{spec}'; {hint}", where=location)
    kind: Region = given_one(spec, kinds_of(RegionSpec, Region))
    polygon = kind.polygon(spec, areas, draw)
    if polygon is None or polygon.is_empty or polygon.area < 1e-9:
        raise ConfigError("the region is empty; make its sizes larger than 0", where=where(spec))
    return polygon


def strip(track: Track, begin: float, end: float, right: Offset, left: Offset) -> BaseGeometry:
    """Return the part of a track from one s [m] to another, between two offsets [m, + left]."""
    if track.closed and end < begin:
        end += track.length
    stations = track.stations()
    # Three laps, so that a strip over the start finds its stations on both sides of it.
    if track.closed:
        stations = np.concatenate([stations + lap * track.length for lap in (-1, 0, 1)])
    between = stations[(stations > begin + 1e-6) & (stations < end - 1e-6)]
    s: Array = np.concatenate(([begin], between, [max(end, begin)]))
    return track.quads(s, right, left)
