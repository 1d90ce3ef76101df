"""Roads: a centre line, the distances of its edges, and the area between them."""

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely.geometry.base import BaseGeometry

from mirdrake.core.errors import ConfigError, WorldError, did_you_mean
from mirdrake.worlds.curve import Curve
from mirdrake.worlds.pieces import Array, Piece, Placement

Edges = tuple[ArrayLike, ArrayLike, ArrayLike]
Offset = float | Callable[[Array], Array]


def offset_at(offset: Offset, s: Array) -> Array:
    """Return an offset, a number or a function of s, at all s [m]."""
    return np.broadcast_to(np.asarray(offset(s) if callable(offset) else offset, dtype=float), s.shape)


class Track(Curve):
    """A road: a centre line and its widths on both sides.

    Args:
        pieces: the centre line, end to end with a common tangent.
        start: pose (x [m], y [m], yaw [rad]) at s = 0 in the world frame.
        closed: the end meets the start; s is then periodic.
        width: width of the road [m], half of it to each side; not used when `edges` is given.
        edges: edges of a road of varying width: s [m], rising from 0 to the length, and the distances of the left and
            the right edge from the centre line there [m], three arrays (N), interpolated linearly.
        name: name for messages.
        notes: parts of its source that it does not represent, one line each.

    Raises:
        WorldError: `edges` do not fit the centre line.

    Attributes:
        length: length of the centre line [m].
        width: width of the road [m]; where it varies, the largest.
        min_radius: smallest radius of the centre line [m]; infinite for a straight.
        gap: distance [m] and heading difference [rad] from the end back to the start.

    The constructor does not check `gap`; :func:`mirdrake.worlds.make_world` does.
    """

    def __init__(
        self,
        pieces: Sequence[Piece],
        *,
        start: Placement = (0.0, 0.0, 0.0),
        closed: bool = False,
        width: float = 3.0,
        edges: Edges | None = None,
        name: str = "track",
        notes: Sequence[str] = (),
    ) -> None:
        super().__init__(pieces, start=start, closed=closed, name=name)
        self.notes = tuple(notes)
        self._edges = None if edges is None else self._check_edges(edges)
        self.width = width if self._edges is None else float((self._edges[1] + self._edges[2]).max())
        # Computed when it is first needed, since many tracks are made only to try a centre line.
        self._area: BaseGeometry | None = None

    def __repr__(self) -> str:
        shape = "closed" if self.closed else "open"
        sizes = f"length={self.length:.3f}, width={self.width:g}, min_radius={self.min_radius:.3f}"
        return f"Track({self.name!r}, {shape}, {sizes})"

    def left_width(self, s: ArrayLike) -> Array:
        """Return the distance [m] of the left edge from the centre line at s [m], any shape; constant beyond ends."""
        return self._side_width(s, 1)

    def right_width(self, s: ArrayLike) -> Array:
        """Return the distance [m] of the right edge from the centre line at s [m], any shape, positive."""
        return self._side_width(s, 2)

    @property
    def edges(self) -> tuple[Array, Array, Array] | None:
        """Stations s and distances of the left and right edges there [m] (N) of a road of varying width; else None."""
        return self._edges

    def folds(self) -> float | None:
        """Return s [m] where the inner edge of a bend folds back on itself most, None if it does not.

        An edge at the distance d inside a bend of curvature k advances by 1 - k d per metre of the centre line, so it
        folds where k d >= 1. Between joints and stations both are linear; the largest k d is found exactly.
        """
        s, end, k, k_end = self._intervals()
        worst, worst_s = -math.inf, 0.0
        for side, sign in ((1, 1.0), (2, -1.0)):
            # k d = (k + p u)(d + q u), u from 0 to 1 over an interval, is largest at an end or at its vertex.
            d = sign * self._at_stations(s, side)
            p, q = k_end - k, sign * self._at_stations(end, side) - d
            bend = 2.0 * p * q
            vertex = np.clip(np.divide(-(k * q + p * d), bend, out=np.zeros_like(bend), where=bend < 0.0), 0.0, 1.0)
            # Both ends and the vertex of the parabola; the vertex is a maximum only where it opens downwards.
            for u in (np.zeros_like(s), np.ones_like(s), vertex):
                product = (k + p * u) * (d + q * u)
                i = int(np.argmax(product))
                if product[i] > worst:
                    worst, worst_s = float(product[i]), float(s[i] + u[i] * (end[i] - s[i]))
        return worst_s if worst >= 1.0 else None

    def inside(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.bool_]:
        """Return whether points (world x, y [m], any shape) are on the road, with an accuracy of 1 mm."""
        shapely.prepare(self.area)
        return np.asarray(shapely.contains_xy(self.area, np.asarray(x, dtype=float), np.asarray(y, dtype=float)))

    # --- outline --------------------------------------------------------------------------------------------------

    def stations(self, *, sagitta: float = 1e-3, longest: float = 10.0) -> Array:
        """Return stations s [m] at which to sample the road: every joint, and more between them in bends.

        Args:
            sagitta: largest distance [m] between the outer edge and its polyline.
            longest: largest spacing [m].
        """
        if self._edges is not None:
            return self._varying_stations(sagitta, longest)
        values: list[Array] = []
        for begin, piece in zip(self.knots[:-1], self.pieces, strict=True):
            sharpest = max(abs(piece.start_curvature), abs(piece.end_curvature))
            if sharpest:
                radius = 1.0 / sharpest + self.width / 2.0
                # Chord of an arc with a given sagitta, at the outer edge, where the radius is largest.
                step = min(longest, 2.0 * math.acos(1.0 - min(sagitta / radius, 0.01)) / sharpest)
            else:
                step = longest
            values.append(begin + piece.length * np.arange(n := max(1, math.ceil(piece.length / step))) / n)
        return np.append(np.concatenate(values), self.length)

    def boundaries(self) -> tuple[Array, Array]:
        """Return the left and right edges, N x 2 [m] each, accurate to 1 mm; last = first if closed."""
        s = self.stations(sagitta=1e-3)
        if self.closed:
            # The end of a closed track may miss its start by a fraction of a millimetre; the polygon must close.
            s[-1] = 0.0
        left = np.column_stack(self.point(s, self.left_width(s)))
        right = np.column_stack(self.point(s, -self.right_width(s)))
        return left, right

    @property
    def area(self) -> BaseGeometry:
        """The road as a shapely polygon [m], accurate to 1 mm; overlapping parts are merged."""
        if self._area is None:
            self._area = self.outline()
        return self._area

    def outline(self, *, sagitta: float = 1e-3) -> BaseGeometry:
        """Return the road as a shapely polygon [m], accurate to `sagitta` [m]; :attr:`area` caches that of 1 mm."""
        return self.band(lambda s: -self.right_width(s), self.left_width, sagitta=sagitta)

    def band(self, right: Offset, left: Offset, *, sagitta: float = 1e-3) -> BaseGeometry:
        """Return the strip between two offsets over the whole length, as a polygon accurate to `sagitta` [m].

        Args:
            right: offset [m, + left] of its right side, a number or a function of s [m], N to N.
            left: offset of its left side, likewise.
            sagitta: largest distance [m] between a side and its polyline.
        """
        s = self.stations(sagitta=sagitta)
        if self.closed:
            s[-1] = 0.0
        a, b = (np.column_stack(self.point(s, offset_at(side, s))) for side in (left, right))
        if self.closed:  # a ring, unless the road crosses itself
            # Whichever side encloses the other: a track may be driven in both senses of rotation.
            outer, inner = sorted((shapely.Polygon(a), shapely.Polygon(b)), key=lambda ring: -ring.area)
            ring = shapely.Polygon(outer.exterior, [inner.exterior])
            if ring.is_valid:
                return ring
        return _union_of_strips(a, b)

    def quads(self, s: Array, right: Offset, left: Offset) -> BaseGeometry:
        """Return the strip between two offsets [m, + left] along stations s [m], as a polygon."""
        a, b = (np.column_stack(self.point(s, offset_at(side, s))) for side in (left, right))
        return _union_of_strips(a, b)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Smallest x, smallest y, largest x and largest y of the road [m]."""
        xmin, ymin, xmax, ymax = np.vstack(self.boundaries())[:, [0, 1, 0, 1]].T
        return float(xmin.min()), float(ymin.min()), float(xmax.max()), float(ymax.max())

    # --- the edges ------------------------------------------------------------------------------------------------

    def _check_edges(self, edges: Edges) -> tuple[Array, Array, Array]:
        """Return stations and widths on both sides as arrays; the last station is exactly the length.

        Raises:
            WorldError: the edges do not fit the centre line.
        """
        s, left, right = (np.array(values, dtype=float) for values in edges)
        where = f"track '{self.name}': edges"
        if s.ndim != 1 or len(s) < 2 or s.shape != left.shape or s.shape != right.shape:
            shapes = ", ".join(str(values.shape) for values in (s, left, right))
            raise WorldError(
                f"shapes {shapes}; give s, left and right with one value each per station, two or more", where=where
            )
        if not all(np.isfinite(values).all() for values in (s, left, right)):
            raise WorldError("some values are not finite; give numbers in m", where=where)
        # Lengths come from sums of many pieces: a relative tolerance allows for their rounding.
        slack = 1e-6 * max(1.0, self.length)
        if abs(s[0]) > slack or abs(s[-1] - self.length) > slack:
            raise WorldError(
                f"s goes from {s[0]:g} to {s[-1]:g} m; make it go from 0 to {self.length:.6f} m", where=where
            )
        s[0], s[-1] = 0.0, self.length
        if (np.diff(s) <= 0.0).any():
            i = int(np.argmax(np.diff(s) <= 0.0))
            raise WorldError(
                f"s does not increase from {s[i]:g} to {s[i + 1]:g} m; sort the stations, each once", where=where
            )
        # The edges of a closed track have to meet at the start.
        for side, values in (("left", left), ("right", right)):
            if values.min() <= 0.0:
                i = int(np.argmin(values))
                raise WorldError(f"{side} is {values[i]:g} m at s = {s[i]:g} m; make it more than 0", where=where)
            if self.closed and abs(values[-1] - values[0]) > 1e-6:
                raise WorldError(
                    f"{side} is {values[0]:g} m at the start and {values[-1]:g} m at the end of a closed "
                    "track; make them equal",
                    where=where,
                )
        return s, left, right

    def _side_width(self, s: ArrayLike, side: int) -> Array:
        """Return the distance [m] of an edge at s [m], any shape; side 1 is left, 2 is right."""
        flat, shape = self._flat(s)
        return self._at_stations(flat, side).reshape(shape)

    def _at_stations(self, s: Array, side: int) -> Array:
        """Return the distance [m] of an edge for a flat s within 0 to the length, without wrapping at the end."""
        if self._edges is None:
            return np.full(len(s), self.width / 2.0)
        return np.interp(s, self._edges[0], self._edges[side])

    def _intervals(self) -> tuple[Array, Array, Array, Array]:
        """Return start and end [m] of the intervals with linear curvature and widths, and both curvatures [1/m]."""
        s = self.knots if self._edges is None else np.unique(np.concatenate((self.knots, self._edges[0])))
        # Stations of widths that are joints up to rounding would give intervals without length.
        s = s[np.concatenate(([True], np.diff(s) > 1e-9))]
        s[-1] = self.length
        begin, end = s[:-1], s[1:]
        # The middle of an interval is inside of one piece, whichever way its ends are rounded.
        piece = np.clip(np.searchsorted(self.knots, (begin + end) / 2.0) - 1, 0, len(self.pieces) - 1)
        length, first, last = np.array(self.pieces)[piece].T
        rate = (last - first) / length
        return begin, end, first + rate * (begin - self.knots[piece]), first + rate * (end - self.knots[piece])

    def _varying_stations(self, sagitta: float, longest: float) -> Array:
        """Return the stations of a road of varying width.

        With curvature k and distance d, an edge p + d n has the curvature k (1 + |k| d) across the road, and
        2 d' k + d k' along it, of which the part normal to the edge counts: times d'.
        """
        begin, end, first, last = self._intervals()
        size = end - begin
        k, rate = np.maximum(np.abs(first), np.abs(last)), np.abs(last - first) / size
        step = np.full(len(size), longest)
        for side in (1, 2):
            d, d_end = self._at_stations(begin, side), self._at_stations(end, side)
            slope, far = np.abs(d_end - d) / size, np.maximum(d, d_end)
            bend = k * (1.0 + k * far) + (2.0 * slope * k + far * rate) * slope
            # Sagitta of a curve with curvature k over a step h: k h² / 8.
            step = np.minimum(step, np.sqrt(8.0 * sagitta / np.maximum(bend, 1e-12)))
        parts = np.maximum(1, np.ceil(size / step)).astype(int)
        index = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
        return np.append(np.repeat(begin, parts) + index * np.repeat(size / parts, parts), self.length)


def _union_of_strips(a: Array, b: Array) -> BaseGeometry:
    """Return the area between two polylines (n, 2) as a polygon: valid also where they fold or cross themselves."""
    # Strips of 20 steps: the union of single quadrilaterals takes far longer.
    strips = [shapely.Polygon(np.vstack((a[i : i + 21], b[i : i + 21][::-1]))) for i in range(0, len(a) - 1, 20)]
    return shapely.union_all(shapely.make_valid(strips), grid_size=1e-6)


def find_track(name: str, tracks: Mapping[str, Track], *, where: str) -> Track:
    """Return the track of a name.

    Args:
        name: the name.
        tracks: tracks by name.
        where: place of the name, for errors.

    Raises:
        ConfigError: there is no such track.
    """
    if name not in tracks:
        hint = did_you_mean(name, tracks) if tracks else "the world has no tracks"
        raise ConfigError(f"unknown track '{name}'; {hint}", where=where)
    return tracks[name]


def check_station(s: float, track: Track, *, where: str) -> None:
    """Check that a station [m] is on a track; on a closed one every station is, as it repeats with every lap.

    Raises:
        ConfigError: the station is before the start or beyond the end of an open track.
    """
    if not track.closed and not 0.0 <= s <= track.length:
        raise ConfigError(f"s = {s:g} m; the track is {track.length:g} m long", where=where)
