"""Lanes: centre lines as polylines by arc length, in the direction of travel."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
import scipy  # it imports its parts when they are first used
import shapely
from numpy.typing import ArrayLike

from mirdrake.core.errors import WorldError
from mirdrake.worlds.pieces import Array

_CLOSE = 0.02  # [m] half of the largest gap between lanes that is closed

Change = Literal["both", "left", "right", "none"]


@dataclass(frozen=True, eq=False)
class Lane:
    """A lane of a road network. All arrays have one value per node, N, two or more, in the direction of travel."""

    id: str
    """unique in the network; ``road.section.number`` for OpenDRIVE"""
    s: Array
    """arc length along the centre line [m], from 0 to the length"""
    x: Array
    """nodes of the centre line, world x [m]"""
    y: Array
    """world y [m]"""
    z: Array
    """height of the road surface on the centre line [m]"""
    yaw: Array
    """heading [rad], continuous along the lane, not wrapped"""
    curvature: Array
    """[1/m], + left"""
    width: Array
    """[m]"""
    left: str | None = None
    """the next lane to the left with the same direction"""
    right: str | None = None
    """the next lane to the right with the same direction"""
    opposite: str | None = None
    """the lane beside it, on the left or right, that goes in the opposite direction"""
    successors: tuple[str, ...] = ()
    """lanes that begin where this one ends"""
    predecessors: tuple[str, ...] = ()
    """lanes that end where this one begins"""
    change: Change = "both"
    """sides to which the road marks allow a lane change"""
    speed_limit: float | None = None
    """[m/s]"""
    kind: str = "driving"
    """driving, biking, sidewalk, shoulder, parking, ...: the lane types of OpenDRIVE; path: of an actor;
    line: of a track that is not a road"""
    junction: str | None = None
    """junction that the lane is a part of"""
    road: str = ""
    """road that the lane is a part of"""
    number: int = 0
    """number on its road: + left, - right of the reference line, whose direction negative lanes share"""
    road_s: Array = field(default_factory=lambda: np.empty(0))
    """station of the nodes on the reference line of the road [m]; empty without one"""

    bank: Array = field(default_factory=lambda: np.empty(0))
    """slope across the lane [-], + where its left edge is higher; empty: none"""

    @property
    def length(self) -> float:
        """Length of the centre line [m]."""
        return float(self.s[-1])

    @property
    def direction(self) -> int:
        """1 in the direction of the reference line of the road, -1 against it."""
        # By its stations and not its number, because numbers mean the opposite in left-hand traffic.
        return -1 if len(self.road_s) and self.road_s[-1] < self.road_s[0] else 1

    def pose(self, s: ArrayLike, offset: ArrayLike = 0.0) -> tuple[Array, Array, Array]:
        """Return x [m], y [m] and yaw [rad] at s [m] and an offset to the left [m], broadcast; straight beyond ends."""
        s, offset = np.broadcast_arrays(np.asarray(s, dtype=float), np.asarray(offset, dtype=float))
        inside = np.clip(s, 0.0, self.length)
        beyond = s - inside
        i = np.clip(np.searchsorted(self.s, inside, side="right") - 1, 0, len(self.s) - 2)
        h = self.s[i + 1] - self.s[i]
        u = (inside - self.s[i]) / h
        yaw = self.yaw[i] + u * (self.yaw[i + 1] - self.yaw[i])

        # Cubic Hermite polynomials of positions and tangents at both nodes.
        end, first, last = u * u * (3.0 - 2.0 * u), h * u * (1.0 - u) ** 2, h * u * u * (u - 1.0)
        c, d = np.cos(self.yaw), np.sin(self.yaw)
        x = self.x[i] + end * (self.x[i + 1] - self.x[i]) + first * c[i] + last * c[i + 1]
        y = self.y[i] + end * (self.y[i + 1] - self.y[i]) + first * d[i] + last * d[i + 1]
        x = x + beyond * np.cos(yaw) - offset * np.sin(yaw)
        y = y + beyond * np.sin(yaw) + offset * np.cos(yaw)
        return x, y, yaw

    def width_at(self, s: ArrayLike) -> Array:
        """Return the width [m] at s [m], any shape."""
        return np.asarray(np.interp(np.asarray(s, dtype=float), self.s, self.width))

    def curvature_at(self, s: ArrayLike) -> Array:
        """Return the curvature [1/m] at s [m], any shape, + left."""
        return np.asarray(np.interp(np.asarray(s, dtype=float), self.s, self.curvature))

    def project(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        """Return s [m] and the offset [m, + left] of the nearest point of the centre line, for points of any shape."""
        x, y = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))

        # Chord lengths are a little shorter than arc lengths; stations are transferred node by node.
        chord = np.asarray(shapely.line_locate_point(self._line, shapely.points(x, y)))
        s = np.interp(chord, self._chords, self.s)
        for _ in range(3):  # Newton's method from the nearest point of the polyline
            px, py, yaw = self.pose(s)
            along = (x - px) * np.cos(yaw) + (y - py) * np.sin(yaw)
            offset = (y - py) * np.cos(yaw) - (x - px) * np.sin(yaw)
            # The divisor is limited, because points near the centre of curvature would be thrown far along the lane.
            s = np.clip(s + along / np.maximum(1.0 - self.curvature_at(s) * offset, 0.2), 0.0, self.length)
        px, py, yaw = self.pose(s)
        return np.asarray(s), np.asarray((y - py) * np.cos(yaw) - (x - px) * np.sin(yaw))

    @cached_property
    def _line(self) -> shapely.LineString:
        """The nodes of the centre line, joined by chords."""
        return shapely.LineString(np.column_stack((self.x, self.y)))

    @cached_property
    def _chords(self) -> Array:
        """Distance along the chords [m] at the nodes."""
        return np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(self.x), np.diff(self.y)))))

    @cached_property
    def left_edge(self) -> Array:
        """Nodes of the left edge, N x 2 [m]."""
        return np.column_stack(self.pose(self.s, self.width / 2.0)[:2])

    @cached_property
    def right_edge(self) -> Array:
        """Nodes of the right edge, N x 2 [m]."""
        return np.column_stack(self.pose(self.s, -self.width / 2.0)[:2])

    @cached_property
    def area(self) -> shapely.geometry.base.BaseGeometry:
        """The lane as a polygon [m]."""
        ring = shapely.Polygon(np.vstack((self.left_edge, self.right_edge[::-1])))
        # The inner edge of a tight bend may cross itself.
        return ring if ring.is_valid else shapely.make_valid(ring).buffer(0.0)


def lane_along(
    name: str, points: ArrayLike, *, yaw: ArrayLike | None = None, width: ArrayLike = 3.5, z: ArrayLike = 0.0
) -> Lane:
    """Return a lane through points, with its arc length, heading and curvature, and without neighbours.

    Args:
        name: its id.
        points: N x 2 [m], two or more, in the direction of travel.
        yaw: heading at the points [rad], N; default: that of a cubic spline through them.
        width: [m], one or N.
        z: height [m], one or N.

    Raises:
        WorldError: the points are fewer than two, or two in a row are equal.
    """
    places = np.asarray(points, dtype=float)
    chords = np.hypot(*np.diff(places, axis=0).T)
    if len(places) < 2 or (chords < 1e-6).any():
        raise WorldError(f"{len(places)} points, {(chords < 1e-6).sum()} of them repeated; a lane needs two or more")
    # Headings of the source are exact at the points; a spline is used only where there are none.
    if yaw is None:
        yaw = _spline_headings(places, chords)
    heading = np.unwrap(np.asarray(yaw, dtype=float))
    # An arc that turns by a has the chord 2 sin(a/2)/a times its length.
    half = np.diff(heading) / 2.0
    arcs = chords / np.sinc(np.clip(half / math.pi, -0.5, 0.5))
    s = np.concatenate(([0.0], np.cumsum(arcs)))
    rate = 2.0 * half / arcs

    # Mean curvatures hold in the middle of each arc; those at the nodes are interpolated.
    curvature = np.interp(s, (s[1:] + s[:-1]) / 2.0, rate)
    count = len(places)
    # Copies: a broadcast array is a read-only view, and the caller may change its points later.
    return Lane(
        id=name,
        s=s,
        x=places[:, 0].copy(),
        y=places[:, 1].copy(),
        z=np.array(np.broadcast_to(np.asarray(z, dtype=float), count)),
        yaw=heading,
        curvature=curvature,
        width=np.array(np.broadcast_to(np.asarray(width, dtype=float), count)),
    )


def close_gaps(areas: list[shapely.geometry.base.BaseGeometry]) -> shapely.geometry.base.BaseGeometry:
    """Return the union of areas [m], with gaps of up to 4 cm between them closed."""
    union = shapely.union_all(areas, grid_size=1e-6)
    # Growing and shrinking by the same distance closes gaps, and mitred corners stay where they are.
    return union.buffer(_CLOSE, join_style="mitre").buffer(-_CLOSE, join_style="mitre")


def _spline_headings(places: Array, chords: Array) -> Array:
    """Return the headings of a cubic spline by chord length; of two points that of their chord."""
    t = np.concatenate(([0.0], np.cumsum(chords)))
    if len(places) == 2:
        dx, dy = places[1] - places[0]
        return np.full(2, math.atan2(dy, dx))
    slope = scipy.interpolate.CubicSpline(t, places, bc_type="natural" if len(places) == 3 else "not-a-knot")(t, 1)
    return np.asarray(np.arctan2(slope[:, 1], slope[:, 0]))


def connect(lanes: Mapping[str, Lane], following: Mapping[str, Sequence[str]]) -> dict[str, Lane]:
    """Return the lanes with the given successors, and with the predecessors that result from them."""
    preceding: dict[str, list[str]] = {name: [] for name in lanes}
    for before, names in following.items():
        for name in names:
            preceding[name].append(before)
    return {
        name: replace(lane, successors=tuple(following[name]), predecessors=tuple(preceding[name]))
        for name, lane in lanes.items()
    }
