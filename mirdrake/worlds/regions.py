"""Areas of a world: rectangles, discs, polygons and strips along tracks as shapely polygons in W [m]."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.yaml_io import where
from mirdrake.worlds.draw import Draw
from mirdrake.worlds.pieces import Array
from mirdrake.worlds.props_spec import RegionSpec
from mirdrake.worlds.tracks import Offset, Track, offset_at

_QUARTER = 16  # segments of a quarter of a disc


@dataclass(frozen=True)
class Patch:
    """A part of the ground with a friction of its own."""

    name: str
    area: BaseGeometry
    """polygon in W [m]"""
    surface: str | None
    """what it looks like; None: as it is there"""
    mu: float
    """friction coefficient [-]"""


@dataclass(frozen=True)
class Places:
    """What regions may refer to."""

    tracks: Mapping[str, Track]
    patches: Mapping[str, Patch]


def make_region(spec: RegionSpec | str, places: Places, draw: Draw, *, place: str = "") -> BaseGeometry:
    """A region as a polygon in W [m].

    Args:
        spec: the region, or the name of a patch or a track.
        places: patches and tracks.
        draw: finds the values.
        place: ``file:line: path``, for a name.

    Raises:
        ConfigError: no such name, or an area of nothing.
    """
    if isinstance(spec, str):
        if spec in places.patches:
            return places.patches[spec].area
        if spec in places.tracks:
            return places.tracks[spec].area
        known = [*places.patches, *places.tracks]
        hint = did_you_mean(spec, known) if known else "there are none; give rect, disc, polygon or band"
        raise ConfigError(f"{place}: unknown region '{spec}'; {hint}")
    if spec.rect is not None:
        x, y = draw.numbers(spec.rect.center, "m", "rect.center", spec)
        length, width = draw.numbers(spec.rect.size, "m", "rect.size", spec)
        yaw = draw.number(spec.rect.yaw, "rad", "rect.yaw", spec)
        half = np.array([length, width]) / 2.0
        corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * half
        turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
        area: BaseGeometry = shapely.Polygon(corners @ turn.T + [x, y])
        sizes = [length, width]
    elif spec.disc is not None:
        x, y = draw.numbers(spec.disc.center, "m", "disc.center", spec)
        radius = draw.number(spec.disc.radius, "m", "disc.radius", spec)
        area, sizes = shapely.Point(x, y).buffer(max(radius, 0.0), _QUARTER), [radius]
    elif spec.polygon is not None:
        points = [draw.numbers(point, "m", f"polygon[{i}]", spec) for i, point in enumerate(spec.polygon)]
        area, sizes = shapely.make_valid(shapely.Polygon(points)), []
    else:
        assert spec.band is not None
        band = spec.band
        if band.track not in places.tracks:
            hint = did_you_mean(band.track, places.tracks) if places.tracks else "the world has none"
            raise ConfigError(f"{where(band, 'track')}: unknown track '{band.track}'; {hint}")
        track = places.tracks[band.track]
        left: Offset = track.left_width
        right: Offset = lambda s: -track.right_width(s)  # noqa: E731
        if band.left is not None:
            left = draw.number(band.left, "m", "band.left", spec)
        if band.right is not None:
            right = draw.number(band.right, "m", "band.right", spec)
        begin, end = (0.0, track.length) if band.s is None else draw.numbers(band.s, "m", "band.s", spec)
        area = track.band(right, left) if band.s is None else strip(track, begin, end, right, left)
        s = np.linspace(begin, end + track.length if track.closed and end < begin else end, 1000)
        sizes = [float(np.min(offset_at(left, s) - offset_at(right, s)))]
    if min(sizes, default=1.0) <= 0.0 or area.is_empty or area.area < 1e-9:
        raise ConfigError(f"{where(spec)}: the region has no area")
    return area


def strip(track: Track, begin: float, end: float, right: Offset, left: Offset) -> BaseGeometry:
    """The part of a track from one s [m] to another, between two offsets [m, + left]."""
    if track.closed and end < begin:
        end += track.length
    stations = track.stations()
    if track.closed:
        stations = np.concatenate([stations + lap * track.length for lap in (-1, 0, 1)])
    between = stations[(stations > begin + 1e-6) & (stations < end - 1e-6)]
    s: Array = np.concatenate(([begin], between, [max(end, begin)]))
    a, b = (np.column_stack(track.point(s, offset_at(side, s))) for side in (left, right))
    parts = [shapely.Polygon(np.vstack((a[i : i + 21], b[i : i + 21][::-1]))) for i in range(0, len(s) - 1, 20)]
    return shapely.union_all(shapely.make_valid(parts), grid_size=1e-6)
