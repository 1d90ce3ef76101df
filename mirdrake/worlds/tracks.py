"""Centre lines of roads: exact curves of piecewise linear curvature, and the way back from points to them.

Track coordinates: s [m] along the centre line, e_y [m] to its left. With curvature k(u) = k0 + c u over a piece, the
heading is yaw(u) = yaw0 + k0 u + c u²/2 and the position is the integral of its cosine and sine: a straight line
(k0 = c = 0), a circle (c = 0) or a clothoid (do Carmo, "Differential Geometry of Curves and Surfaces", section 1-5: a
plane curve is found from its curvature by these two integrations).

Each piece is cut into cells that turn at most 0.08 rad; within a cell three-point Gauss quadrature of the integral is
exact to 1e-12 m, without the cancellation that the closed form by Fresnel integrals suffers when c is small.
"""

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from typing import NamedTuple, overload

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree
from shapely.geometry.base import BaseGeometry

from mirdrake.errors import WorldError

Array = NDArray[np.float64]
Placement = tuple[float, float, float]
Edges = tuple[ArrayLike, ArrayLike, ArrayLike]
Offset = float | Callable[[Array], Array]

# Gauss-Legendre on [0, 1] with three points: exact for polynomials up to degree 5.
_NODES = (0.5 - math.sqrt(0.15), 0.5, 0.5 + math.sqrt(0.15))
_WEIGHTS = (5.0 / 18.0, 8.0 / 18.0, 5.0 / 18.0)
_CELL_ANGLE = 0.08  # [rad] largest turn of a cell
_CELL_LENGTH = 0.5  # [m] longest cell
_FAR = 20.0  # [m] a hint that is worse than this is not used
_CELLS = 8  # fewest cells of a piece


class Piece(NamedTuple):
    """A part of a centre line whose curvature changes linearly, + left."""

    length: float
    """[m]"""
    start_curvature: float
    """[1/m]"""
    end_curvature: float
    """[1/m]"""

    @property
    def turn(self) -> float:
        """Heading change [rad]."""
        return self.length * (self.start_curvature + self.end_curvature) / 2.0


def advance(pose: Placement, piece: Piece) -> Placement:
    """The pose (x [m], y [m], yaw [rad]) at the end of a piece that starts at `pose`.

    Lines and arcs by their closed forms, clothoids by Gauss quadrature over their cells.
    """
    x, y, yaw = pose
    if piece.start_curvature == piece.end_curvature:
        half = piece.turn / 2.0
        chord = piece.length * (math.sin(half) / half if half else 1.0)
        return x + chord * math.cos(yaw + half), y + chord * math.sin(yaw + half), yaw + piece.turn
    step, cells, rate = _cells_of(piece)
    u = step * np.arange(cells)
    k = np.asarray(piece.start_curvature + rate * u)
    dx, dy = _displace(yaw + (piece.start_curvature + k) / 2.0 * u, k, np.full(cells, rate), np.full(cells, step))
    return x + math.fsum(dx), y + math.fsum(dy), yaw + piece.turn


def offset_at(offset: Offset, s: Array) -> Array:
    """An offset, a number or a function of s, at all of s [m]."""
    return np.broadcast_to(np.asarray(offset(s) if callable(offset) else offset, dtype=float), s.shape)


def _cells_of(piece: Piece) -> tuple[float, int, float]:
    """Cell length [m], number of cells and rate of curvature [1/m²] of a piece."""
    sharpest = max(abs(piece.start_curvature), abs(piece.end_curvature))
    cells = max(_CELLS, math.ceil(piece.length / _CELL_LENGTH), math.ceil(piece.length * sharpest / _CELL_ANGLE))
    return piece.length / cells, cells, (piece.end_curvature - piece.start_curvature) / piece.length


def _displace(yaw: Array, k: Array, c: Array, u: Array) -> tuple[Array, Array]:
    """Displacement [m] in x and y over a length u from where heading, curvature and its rate are yaw, k and c."""
    dx, dy = np.zeros_like(u), np.zeros_like(u)
    for node, weight in zip(_NODES, _WEIGHTS, strict=True):
        part = node * u
        angle = yaw + (k + c * part / 2.0) * part
        dx += weight * np.cos(angle)
        dy += weight * np.sin(angle)
    return u * dx, u * dy


class Track:
    """A road: a centre line and its width to both sides.

    Args:
        pieces: the centre line, end to end with a common tangent.
        start: pose (x [m], y [m], yaw [rad]) at s = 0 in the world frame.
        closed: the end meets the start; s is then periodic.
        width: of the road [m], half of it to each side; not used when `edges` is given.
        edges: for a road of varying width: s [m], rising from 0 to the length, and how far the left and the right edge
            are from the centre line there [m], three arrays of N; straight between them, so the width is continuous.
        name: for messages.
        notes: what its source had and it has not, a line each.

    Raises:
        WorldError: `edges` do not fit the centre line.

    Attributes:
        length: of the centre line [m].
        width: of the road [m]; where it varies, the largest.
        min_radius: smallest radius of the centre line [m]; infinite for a straight.
        gap: distance [m] and heading difference [rad] from the end back to the start.

    The constructor does not judge `gap`; :func:`mirdrake.worlds.make_world` does.
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
        self.name = name
        self.notes = tuple(notes)
        self.closed = closed
        self.pieces = tuple(pieces)
        self.length = math.fsum(piece.length for piece in self.pieces)
        sharpest = max(max(abs(piece.start_curvature), abs(piece.end_curvature)) for piece in self.pieces)
        self.min_radius = 1.0 / sharpest if sharpest else math.inf

        columns: list[list[Array]] = [[], [], [], [], [], []]
        pose, travelled, ends = start, 0.0, [0.0]
        for piece in self.pieces:
            step, cells, rate = _cells_of(piece)
            u = step * np.arange(cells)
            k = np.asarray(piece.start_curvature + rate * u)
            yaw = pose[2] + (piece.start_curvature + k) / 2.0 * u
            c = np.full(cells, rate)
            dx, dy = _displace(yaw, k, c, np.full(cells, step))
            x = pose[0] + np.concatenate(([0.0], np.cumsum(dx[:-1])))
            y = pose[1] + np.concatenate(([0.0], np.cumsum(dy[:-1])))
            for column, part in zip(columns, (travelled + u, x, y, yaw, k, c), strict=True):
                column.append(part)
            pose = advance(pose, piece)
            travelled += piece.length
            ends.append(travelled)
        self.length = travelled
        self.knots = np.array(ends)
        self._s, self._x, self._y, self._yaw, self._k, self._c = (np.concatenate(column) for column in columns)
        self._cells = list(
            zip(*(a.tolist() for a in (self._s, self._x, self._y, self._yaw, self._k, self._c)), strict=True)
        )
        self._starts = self._s.tolist()
        self._end = pose
        self._end_curvature = self.pieces[-1].end_curvature
        turn = pose[2] - start[2]
        self.gap = (math.hypot(pose[0] - start[0], pose[1] - start[1]), math.remainder(turn, 2.0 * math.pi))
        self._edges = None if edges is None else self._check_edges(edges)
        self.width = width if self._edges is None else float((self._edges[1] + self._edges[2]).max())
        self._tree: cKDTree | None = None
        self._area: BaseGeometry | None = None

    def __repr__(self) -> str:
        shape = "closed" if self.closed else "open"
        sizes = f"length={self.length:.3f}, width={self.width:g}, min_radius={self.min_radius:.3f}"
        return f"Track({self.name!r}, {shape}, {sizes})"

    # --- along the centre line ------------------------------------------------------------------------------------

    def wrap(self, s: float) -> float:
        """Fold s [m] into [0, length) on a closed track; unchanged on an open one."""
        if not self.closed or 0.0 <= s < self.length:
            return s
        s = math.fmod(s, self.length)
        if s < 0.0:
            s += self.length
        return s if s < self.length else 0.0

    def pose(self, s: ArrayLike) -> tuple[Array, Array, Array]:
        """Poses on the centre line.

        Args:
            s: along the centre line [m], any shape; periodic when closed, otherwise continued straight beyond the ends.

        Returns:
            x [m], y [m] and yaw [rad] in the world frame, each of the shape of s. yaw is continuous along a lap from
            the heading at s = 0; it is not folded into (-π, π].
        """
        s, shape = self._flat(s)
        i, u = self._locate(s)
        k, c = self._extended(i, u)
        dx, dy = _displace(self._yaw[i], k, c, u)
        x, y, yaw = self._x[i] + dx, self._y[i] + dy, self._yaw[i] + (k + c * u / 2.0) * u
        if not self.closed and (beyond := s > self.length).any():
            x0, y0, yaw0 = self._end
            extra = s - self.length
            x = np.where(beyond, x0 + extra * math.cos(yaw0), x)
            y = np.where(beyond, y0 + extra * math.sin(yaw0), y)
            yaw = np.where(beyond, yaw0, yaw)
        return x.reshape(shape), y.reshape(shape), yaw.reshape(shape)

    def pose_at(self, s: float) -> Placement:
        """The pose (x [m], y [m], yaw [rad]) at one s [m]: :meth:`pose` for the control loop, without arrays."""
        return self._evaluate(s)[:3]

    def curvature(self, s: ArrayLike) -> Array:
        """Curvature [1/m] of the centre line at s [m], + left, in the shape of s; 0 beyond the ends if open."""
        s, shape = self._flat(s)
        i, u = self._locate(s)
        k, c = self._extended(i, u)
        value = k + c * u
        if not self.closed:
            value = np.where(s > self.length, 0.0, value)
        return np.asarray(value.reshape(shape))

    def curvature_at(self, s: float) -> float:
        """Curvature [1/m] at one s [m]: :meth:`curvature` for the control loop, without arrays."""
        return self._evaluate(s)[3]

    def point(self, s: ArrayLike, offset: ArrayLike = 0.0) -> tuple[Array, Array]:
        """World x and y [m] of the track coordinates s [m] and offset e_y [m], broadcast against each other."""
        x, y, yaw = self.pose(s)
        offset = np.asarray(offset, dtype=float)
        return x - offset * np.sin(yaw), y + offset * np.cos(yaw)

    def left_width(self, s: ArrayLike) -> Array:
        """Distance [m] of the left edge from the centre line at s [m], in the shape of s; steady beyond the ends."""
        return self._side_width(s, 1)

    def right_width(self, s: ArrayLike) -> Array:
        """Distance [m] of the right edge from the centre line at s [m], positive, in the shape of s."""
        return self._side_width(s, 2)

    @property
    def edges(self) -> tuple[Array, Array, Array] | None:
        """Of a road of varying width: s and how far the left and the right edge are there [m], N each; else None."""
        return self._edges

    def sharpest(self) -> float:
        """Where the radius is smallest: s [m]."""
        ends = [max(abs(piece.start_curvature), abs(piece.end_curvature)) for piece in self.pieces]
        at = int(np.argmax(ends))
        piece = self.pieces[at]
        return float(self.knots[at + (abs(piece.end_curvature) > abs(piece.start_curvature))])

    def folds(self) -> float | None:
        """Where the inner edge of a bend folds back on itself: s [m] of the worst such place, None if there is none.

        An edge at the distance d inside a bend of curvature k advances by 1 - k d per metre of the centre line, so it
        folds where k d >= 1. Between joints and stations both are linear; the largest k d is found exactly.
        """
        s, end, k, k_end = self._intervals()
        worst, place = -math.inf, 0.0
        for side, sign in ((1, 1.0), (2, -1.0)):
            # k d = (k + p u)(d + q u), u from 0 to 1 over an interval, is largest at an end or at its vertex.
            d = sign * self._at_stations(s, side)
            p, q = k_end - k, sign * self._at_stations(end, side) - d
            bend = 2.0 * p * q
            vertex = np.clip(np.divide(-(k * q + p * d), bend, out=np.zeros_like(bend), where=bend < 0.0), 0.0, 1.0)
            for u in (np.zeros_like(s), np.ones_like(s), vertex):
                product = (k + p * u) * (d + q * u)
                at = int(np.argmax(product))
                if product[at] > worst:
                    worst, place = float(product[at]), float(s[at] + u[at] * (end[at] - s[at]))
        return place if worst >= 1.0 else None

    # --- from the plane to the track ------------------------------------------------------------------------------

    @overload
    def project(self, x: float, y: float, *, near: float | None = None) -> tuple[float, float]: ...
    @overload
    def project(self, x: Array, y: Array, *, near: ArrayLike | None = None) -> tuple[Array, Array]: ...
    def project(
        self, x: float | Array, y: float | Array, *, near: ArrayLike | None = None
    ) -> tuple[float, float] | tuple[Array, Array]:
        """Track coordinates of points in the plane: the nearest point of the centre line.

        Args:
            x: world x [m], a float or an array.
            y: world y [m], like x.
            near: s [m] close to the answer, for example the last one of a moving vehicle. The nearest point of that
                stretch of road is then taken, even if another stretch passes closer. Without it, and when the point
                turns out to be more than 20 m away, the whole track is searched.

        Returns:
            s [m] within [0, length) (open: [0, length]) and e_y [m], + left of the centre line; floats for floats.
            Beyond the ends of an open track s stays at the end and e_y is the lateral part of the distance.
        """
        if isinstance(x, float | int) and isinstance(y, float | int):
            if near is not None:
                found = self._descend(x, y, float(near))  # type: ignore[arg-type]
                if found is not None and abs(found[1]) < _FAR:
                    return found
            nearest = int(np.argmin((self._x - x) ** 2 + (self._y - y) ** 2))
            found = self._descend(x, y, self._starts[nearest])
            if found is None:
                raise ValueError(f"cannot project the point ({x}, {y}) on track '{self.name}'")
            return found
        return self._project_many(np.asarray(x, dtype=float), np.asarray(y, dtype=float), near)

    def inside(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.bool_]:
        """Whether points (world x, y [m], any shape) are on the road; its sides are true to 1 mm."""
        shapely.prepare(self.area)
        return np.asarray(shapely.contains_xy(self.area, np.asarray(x, dtype=float), np.asarray(y, dtype=float)))

    # --- outline --------------------------------------------------------------------------------------------------

    def stations(self, *, sagitta: float = 1e-3, longest: float = 10.0) -> Array:
        """Values of s [m] at which to sample the road: every joint, and between them as many as its bends need.

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
                step = min(longest, 2.0 * math.acos(1.0 - min(sagitta / radius, 0.01)) / sharpest)
            else:
                step = longest
            values.append(begin + piece.length * np.arange(n := max(1, math.ceil(piece.length / step))) / n)
        return np.append(np.concatenate(values), self.length)

    def boundaries(self, *, sagitta: float = 1e-3) -> tuple[Array, Array]:
        """The left and the right edge of the road, N x 2 [m] each, true to `sagitta`; last = first if closed."""
        s = self.stations(sagitta=sagitta)
        if self.closed:
            s[-1] = 0.0
        left = np.column_stack(self.point(s, self.left_width(s)))
        right = np.column_stack(self.point(s, -self.right_width(s)))
        return left, right

    @property
    def area(self) -> BaseGeometry:
        """The road as a shapely polygon [m], true to 1 mm; parts that overlap are merged."""
        if self._area is None:
            self._area = self.outline()
        return self._area

    def outline(self, *, sagitta: float = 1e-3) -> BaseGeometry:
        """The road as a shapely polygon [m], true to `sagitta` [m]; :attr:`area` keeps that of 1 mm."""
        return self.band(lambda s: -self.right_width(s), self.left_width, sagitta=sagitta)

    def band(self, right: Offset, left: Offset, *, sagitta: float = 1e-3) -> BaseGeometry:
        """The strip between two offsets over the whole length, as a polygon true to `sagitta` [m].

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
            outer, inner = sorted((shapely.Polygon(a), shapely.Polygon(b)), key=lambda ring: -ring.area)
            ring = shapely.Polygon(outer.exterior, [inner.exterior])
            if ring.is_valid:
                return ring
        strips = [shapely.Polygon(np.vstack((a[i : i + 21], b[i : i + 21][::-1]))) for i in range(0, len(s) - 1, 20)]
        return shapely.union_all(shapely.make_valid(strips), grid_size=1e-6)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Smallest x, smallest y, largest x and largest y of the road [m]."""
        xmin, ymin, xmax, ymax = np.vstack(self.boundaries())[:, [0, 1, 0, 1]].T
        return float(xmin.min()), float(ymin.min()), float(xmax.max()), float(ymax.max())

    # --- the edges ------------------------------------------------------------------------------------------------

    def _check_edges(self, edges: Edges) -> tuple[Array, Array, Array]:
        """Stations and the widths to both sides as arrays; the last station is exactly the length.

        Raises:
            WorldError: they do not fit the centre line.
        """
        s, left, right = (np.array(values, dtype=float) for values in edges)
        where = f"track '{self.name}': edges"
        if s.ndim != 1 or len(s) < 2 or s.shape != left.shape or s.shape != right.shape:
            shapes = ", ".join(str(values.shape) for values in (s, left, right))
            raise WorldError(
                f"{where}: shapes {shapes}; give s, left and right with one value each per station, two or more"
            )
        if not all(np.isfinite(values).all() for values in (s, left, right)):
            raise WorldError(f"{where}: some values are not finite; give numbers in m")
        slack = 1e-6 * max(1.0, self.length)
        if abs(s[0]) > slack or abs(s[-1] - self.length) > slack:
            raise WorldError(f"{where}: s goes from {s[0]:g} to {s[-1]:g} m; make it go from 0 to {self.length:.6f} m")
        s[0], s[-1] = 0.0, self.length
        if (np.diff(s) <= 0.0).any():
            at = int(np.argmax(np.diff(s) <= 0.0))
            raise WorldError(
                f"{where}: s does not rise from {s[at]:g} to {s[at + 1]:g} m; sort the stations, each once"
            )
        for side, values in (("left", left), ("right", right)):
            if values.min() <= 0.0:
                at = int(np.argmin(values))
                raise WorldError(f"{where}: {side} is {values[at]:g} m at s = {s[at]:g} m; make it more than 0")
            if self.closed and abs(values[-1] - values[0]) > 1e-6:
                raise WorldError(
                    f"{where}: {side} is {values[0]:g} m at the start and {values[-1]:g} m at the end of a closed "
                    "track; make them equal"
                )
        return s, left, right

    def _side_width(self, s: ArrayLike, side: int) -> Array:
        """Distance [m] of an edge at s [m], any shape; side 1 is left, 2 is right."""
        flat, shape = self._flat(s)
        return self._at_stations(flat, side).reshape(shape)

    def _at_stations(self, s: Array, side: int) -> Array:
        """:meth:`_side_width` for a flat s within 0 to the length; there the end of a lap is not its start."""
        if self._edges is None:
            return np.full(len(s), self.width / 2.0)
        return np.interp(s, self._edges[0], self._edges[side])

    def _intervals(self) -> tuple[Array, Array, Array, Array]:
        """Start and end [m], and curvature at start and end [1/m], of the parts over which all is linear."""
        s = self.knots if self._edges is None else np.unique(np.concatenate((self.knots, self._edges[0])))
        s = s[np.concatenate(([True], np.diff(s) > 1e-9))]
        s[-1] = self.length
        begin, end = s[:-1], s[1:]
        piece = np.clip(np.searchsorted(self.knots, (begin + end) / 2.0) - 1, 0, len(self.pieces) - 1)
        length, first, last = np.array(self.pieces)[piece].T
        rate = (last - first) / length
        return begin, end, first + rate * (begin - self.knots[piece]), first + rate * (end - self.knots[piece])

    def _varying_stations(self, sagitta: float, longest: float) -> Array:
        """:meth:`stations` where the width varies.

        An edge p + d n bends by k (1 + |k| d) across the road, k the curvature and d the distance. Along the road it
        bends by 2 d' k + d k', which counts by its part across the edge: times d'.
        """
        begin, end, first, last = self._intervals()
        size = end - begin
        k, rate = np.maximum(np.abs(first), np.abs(last)), np.abs(last - first) / size
        step = np.full(len(size), longest)
        for side in (1, 2):
            d, d_end = self._at_stations(begin, side), self._at_stations(end, side)
            slope, far = np.abs(d_end - d) / size, np.maximum(d, d_end)
            bend = k * (1.0 + k * far) + (2.0 * slope * k + far * rate) * slope
            step = np.minimum(step, np.sqrt(8.0 * sagitta / np.maximum(bend, 1e-12)))
        parts = np.maximum(1, np.ceil(size / step)).astype(int)
        index = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
        return np.append(np.repeat(begin, parts) + index * np.repeat(size / parts, parts), self.length)

    # --- the inner parts ------------------------------------------------------------------------------------------

    def _flat(self, s: ArrayLike) -> tuple[Array, tuple[int, ...]]:
        """The values of s as a flat array, folded into one lap when closed, and their shape."""
        values = np.asarray(s, dtype=float)
        flat = values.ravel()
        if self.closed:
            flat = np.mod(flat, self.length)
            flat = np.where(flat < self.length, flat, 0.0)
        return flat, values.shape

    def _locate(self, s: Array) -> tuple[NDArray[np.intp], Array]:
        """Cell of each s, and the distance [m] from the cell's start; negative before the start of an open track."""
        i = np.clip(np.searchsorted(self._s, s, side="right") - 1, 0, len(self._s) - 1)
        return i, np.minimum(s, self.length) - self._s[i]

    def _extended(self, i: NDArray[np.intp], u: Array) -> tuple[Array, Array]:
        """Curvature and its rate for cells; zero where u is before the start of an open track."""
        return np.where(u < 0.0, 0.0, self._k[i]), np.where(u < 0.0, 0.0, self._c[i])

    def _evaluate(self, s: float) -> tuple[float, float, float, float]:
        """x, y, yaw and curvature at one s, in plain floats."""
        if self.closed:
            s = self.wrap(s)
        elif s > self.length:
            x, y, yaw = self._end
            extra = s - self.length
            return x + extra * math.cos(yaw), y + extra * math.sin(yaw), yaw, 0.0
        elif s < 0.0:
            _, x, y, yaw, _, _ = self._cells[0]
            return x + s * math.cos(yaw), y + s * math.sin(yaw), yaw, 0.0
        start, x, y, yaw, k, c = self._cells[bisect_right(self._starts, s) - 1]
        u = s - start
        half = 0.5 * c
        u1, u2, u3 = _NODES[0] * u, 0.5 * u, _NODES[2] * u
        a1, a2, a3 = yaw + (k + half * u1) * u1, yaw + (k + half * u2) * u2, yaw + (k + half * u3) * u3
        x += u * (_WEIGHTS[0] * (math.cos(a1) + math.cos(a3)) + _WEIGHTS[1] * math.cos(a2))
        y += u * (_WEIGHTS[0] * (math.sin(a1) + math.sin(a3)) + _WEIGHTS[1] * math.sin(a2))
        return x, y, yaw + (k + half * u) * u, k + c * u

    def _descend(self, x: float, y: float, near: float) -> tuple[float, float] | None:
        """Newton's method from `near` to the nearest point; None when it wanders far off or does not settle.

        d(distance²/2)/ds = -f with f the component of the distance along the tangent, and df/ds = -(1 - k e_y). Keeping
        that slope above 0.2 makes every step go downhill, also beyond the centre of curvature.
        """
        s, last = near, self.length
        for _ in range(40):
            px, py, yaw, k = self._evaluate(s)
            cosine, sine = math.cos(yaw), math.sin(yaw)
            dx, dy = x - px, y - py
            along, lateral = dx * cosine + dy * sine, dy * cosine - dx * sine
            step = along / max(1.0 - k * lateral, 0.2)
            step = max(-2.0, min(2.0, step))
            if not self.closed:
                step = max(0.0, min(last, s + step)) - s
            s += step
            if abs(step) < 1e-9:
                return self.wrap(s), lateral
            if abs(s - near) > _FAR:
                return None
        return None

    def _project_many(self, x: Array, y: Array, near: ArrayLike | None) -> tuple[Array, Array]:
        """Vectorised :meth:`project`: the same descent for all points at once, the unsettled ones again from afar."""
        x, y = np.broadcast_arrays(x, y)
        shape = x.shape
        x, y = x.ravel(), y.ravel()
        finite = np.isfinite(x) & np.isfinite(y)
        if not finite.all():
            s, lateral = np.full(len(x), np.nan), np.full(len(x), np.nan)
            hints = None if near is None else np.broadcast_to(np.asarray(near, dtype=float), shape).ravel()[finite]
            s[finite], lateral[finite] = self._project_many(x[finite], y[finite], hints)
            return s.reshape(shape), lateral.reshape(shape)
        if near is None:
            s, lateral, _ = self._descend_many(x, y, self._nearest_cell(x, y))
        else:
            first = np.broadcast_to(np.asarray(near, dtype=float), shape).ravel()
            s, lateral, settled = self._descend_many(x, y, first)
            again = ~settled | (np.abs(s - first) > _FAR) | (np.abs(lateral) > _FAR)
            if again.any():
                s[again], lateral[again], _ = self._descend_many(
                    x[again], y[again], self._nearest_cell(x[again], y[again])
                )
        if self.closed:
            s = np.mod(s, self.length)
            s = np.where(s < self.length, s, 0.0)
        return s.reshape(shape), lateral.reshape(shape)

    def _nearest_cell(self, x: Array, y: Array) -> Array:
        """Where [m] the cell nearest to each point starts."""
        if self._tree is None:
            self._tree = cKDTree(np.column_stack((self._x, self._y)))
        return np.asarray(self._s[self._tree.query(np.column_stack((x, y)))[1]])

    def _descend_many(self, x: Array, y: Array, s: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Steps of :meth:`_descend` for arrays; also says which points settled."""
        s, lateral = s.copy(), np.zeros_like(s)
        active = np.arange(len(s))
        for _ in range(40):
            px, py, yaw = self.pose(s[active])
            k = self.curvature(s[active])
            cosine, sine = np.cos(yaw), np.sin(yaw)
            dx, dy = x[active] - px, y[active] - py
            lateral[active] = dy * cosine - dx * sine
            step = np.clip((dx * cosine + dy * sine) / np.maximum(1.0 - k * lateral[active], 0.2), -2.0, 2.0)
            moved = s[active] + step
            if not self.closed:
                moved = np.clip(moved, 0.0, self.length)
                step = moved - s[active]
            s[active] = moved
            active = active[~(np.abs(step) < 1e-9)]
            if not active.size:
                break
        settled = np.ones(len(s), dtype=bool)
        settled[active] = False
        return s, lateral, settled
