"""Centre lines: exact curves of piecewise linear curvature, and the projection of points on them.

::

    s [m] ── pose, curvature ──► world        cells, and Gauss quadrature within them (pieces.py)
    world ── project ──► s, e_y [m]           the nearest cell, then Newton's method along the curve
"""

import math
from bisect import bisect_right
from collections.abc import Sequence
from typing import Any, overload

import numpy as np
import scipy  # it imports its parts when they are first used
from numpy.typing import ArrayLike, NDArray

from mirdrake.worlds.pieces import NODES, WEIGHTS, Array, Piece, Placement, advance, cells_of, displace

_FAR = 20.0  # [m] a hint that is farther off is not used


class Curve:
    """A centre line.

    Args:
        pieces: end to end with a common tangent.
        start: pose (x [m], y [m], yaw [rad]) at s = 0 in the world frame.
        closed: the end meets the start; s is then periodic.
        name: name for messages.

    Attributes:
        start: given pose at s = 0.
        end: pose at the end, by the pieces.
        length: length along the curve [m].
        knots: s [m] where pieces meet, from 0 to the length.
        min_radius: smallest radius [m]; infinite for a straight.
        gap: distance [m] and heading difference [rad] from the end back to the start.
    """

    def __init__(
        self,
        pieces: Sequence[Piece],
        *,
        start: Placement = (0.0, 0.0, 0.0),
        closed: bool = False,
        name: str = "track",
    ) -> None:
        self.name = name
        self.start = start
        self.closed = closed
        self.pieces = tuple(pieces)
        sharpest = max(max(abs(piece.start_curvature), abs(piece.end_curvature)) for piece in self.pieces)
        self.min_radius = 1.0 / sharpest if sharpest else math.inf

        # Each piece is divided into cells, so that positions along the curve are found by interpolation in one of them.
        columns: list[list[Array]] = [[], [], [], [], [], []]
        pose, travelled, ends = start, 0.0, [0.0]
        # Poses at the starts of cells are summed up within a piece, but each piece starts from its exact end pose.
        for piece in self.pieces:
            step, cells, rate = cells_of(piece)
            u = step * np.arange(cells)
            k = np.asarray(piece.start_curvature + rate * u)
            # The heading is exact: the integral of a linear curvature; only positions need quadrature.
            yaw = pose[2] + (piece.start_curvature + k) / 2.0 * u
            c = np.full(cells, rate)
            dx, dy = displace(yaw, k, c, np.full(cells, step))
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

        # Drivers project single points in every step; for these, lists of floats are several times as fast as arrays.
        self._cells = list(
            zip(*(a.tolist() for a in (self._s, self._x, self._y, self._yaw, self._k, self._c)), strict=True)
        )
        self._starts = self._s.tolist()
        self.end = pose

        turn = pose[2] - start[2]
        self.gap = (math.hypot(pose[0] - start[0], pose[1] - start[1]), math.remainder(turn, 2.0 * math.pi))
        self._tree: Any = None

    # --- along the curve ------------------------------------------------------------------------------------------

    def wrap(self, s: float) -> float:
        """Return s [m] wrapped into [0, length) on a closed track; unchanged on an open one."""
        if not self.closed or 0.0 <= s < self.length:
            return s
        # A tiny negative s plus the length can be the length itself by rounding, which is the start.
        s = math.fmod(s, self.length)
        if s < 0.0:
            s += self.length
        return s if s < self.length else 0.0

    def pose(self, s: ArrayLike) -> tuple[Array, Array, Array]:
        """Return poses on the centre line.

        Args:
            s: station along the centre line [m], any shape; periodic when closed, otherwise extended straight beyond
                the ends.

        Returns:
            x [m], y [m] and yaw [rad] in the world frame, each of the shape of s. yaw is continuous along a lap from
            the heading at s = 0; it is not wrapped into (-π, π].
        """
        s, shape = self._flat(s)
        i, u = self._locate(s)
        k, c = self._extended(i, u)
        dx, dy = displace(self._yaw[i], k, c, u)
        x, y, yaw = self._x[i] + dx, self._y[i] + dy, self._yaw[i] + (k + c * u / 2.0) * u

        # Beyond the end the line is straight; before the start `_extended` has made it so.
        if not self.closed and (beyond := s > self.length).any():
            x0, y0, yaw0 = self.end
            extra = s - self.length
            x = np.where(beyond, x0 + extra * math.cos(yaw0), x)
            y = np.where(beyond, y0 + extra * math.sin(yaw0), y)
            yaw = np.where(beyond, yaw0, yaw)
        return x.reshape(shape), y.reshape(shape), yaw.reshape(shape)

    def pose_at(self, s: float) -> Placement:
        """Return the pose (x [m], y [m], yaw [rad]) at one s [m]: :meth:`pose` without arrays, for control loops."""
        return self._evaluate(s)[:3]

    def curvature(self, s: ArrayLike) -> Array:
        """Return the curvature [1/m] of the centre line at s [m], any shape, + left; 0 beyond the ends if open."""
        s, shape = self._flat(s)
        i, u = self._locate(s)
        k, c = self._extended(i, u)
        value = k + c * u
        if not self.closed:
            value = np.where(s > self.length, 0.0, value)
        return np.asarray(value.reshape(shape))

    def curvature_at(self, s: float) -> float:
        """Return the curvature [1/m] at one s [m]: :meth:`curvature` without arrays, for control loops."""
        return self._evaluate(s)[3]

    def point(self, s: ArrayLike, offset: ArrayLike = 0.0) -> tuple[Array, Array]:
        """Return world x and y [m] of the track coordinates s [m] and e_y [m], which are broadcast."""
        x, y, yaw = self.pose(s)
        offset = np.asarray(offset, dtype=float)
        return x - offset * np.sin(yaw), y + offset * np.cos(yaw)

    def sharpest(self) -> float:
        """Return s [m] where the radius is smallest."""
        ends = [max(abs(piece.start_curvature), abs(piece.end_curvature)) for piece in self.pieces]
        i = int(np.argmax(ends))
        piece = self.pieces[i]
        return float(self.knots[i + (abs(piece.end_curvature) > abs(piece.start_curvature))])

    # --- from the plane to the curve ------------------------------------------------------------------------------

    @overload
    def project(self, x: float, y: float, *, near: float | None = None) -> tuple[float, float]: ...
    @overload
    def project(self, x: Array, y: Array, *, near: ArrayLike | None = None) -> tuple[Array, Array]: ...
    def project(
        self, x: float | Array, y: float | Array, *, near: ArrayLike | None = None
    ) -> tuple[float, float] | tuple[Array, Array]:
        """Return track coordinates of points in the plane, by the nearest point of the centre line.

        Args:
            x: world x [m], a float or an array.
            y: world y [m], like x.
            near: s [m] close to the result, for example the last one of a moving vehicle. The nearest point of that
                part of the road is then returned, even if another part is closer. Without it, or if the point is more
                than 20 m away, the whole track is searched.

        Returns:
            s [m] within [0, length) (open: [0, length]) and e_y [m], + left of the centre line; floats for floats.
            Beyond the ends of an open track s stays at the end and e_y is the lateral part of the distance.
        """
        if isinstance(x, float | int) and isinstance(y, float | int):
            # The last result of a moving vehicle is near: a few Newton steps, and it cannot jump to another branch.
            if near is not None:
                result = self._descend(x, y, float(near))  # type: ignore[arg-type]
                if result is not None and abs(result[1]) < _FAR:
                    return result
            nearest = int(np.argmin((self._x - x) ** 2 + (self._y - y) ** 2))
            result = self._descend(x, y, self._starts[nearest])
            if result is None:
                raise ValueError(f"cannot project the point ({x}, {y}) on track '{self.name}'")
            return result
        return self._project_many(np.asarray(x, dtype=float), np.asarray(y, dtype=float), near)

    # --- the inner parts ------------------------------------------------------------------------------------------

    def _flat(self, s: ArrayLike) -> tuple[Array, tuple[int, ...]]:
        """Return the values of s as a flat array, wrapped into one lap when closed, and their shape."""
        values = np.asarray(s, dtype=float)
        flat = values.ravel()
        if self.closed:
            flat = np.mod(flat, self.length)
            flat = np.where(flat < self.length, flat, 0.0)
        return flat, values.shape

    def _locate(self, s: Array) -> tuple[NDArray[np.intp], Array]:
        """Return the cell of each s and the distance [m] from its start, negative before an open track."""
        # The cell that starts at or before s; the clip keeps stations outside of an open track in its end cells.
        i = np.clip(np.searchsorted(self._s, s, side="right") - 1, 0, len(self._s) - 1)
        return i, np.minimum(s, self.length) - self._s[i]

    def _extended(self, i: NDArray[np.intp], u: Array) -> tuple[Array, Array]:
        """Return curvature and its rate in cells; zero where u is before the start of an open track."""
        return np.where(u < 0.0, 0.0, self._k[i]), np.where(u < 0.0, 0.0, self._c[i])

    def _evaluate(self, s: float) -> tuple[float, float, float, float]:
        """Return x, y, yaw and curvature at one s, as floats."""
        if self.closed:
            s = self.wrap(s)
        elif s > self.length:
            x, y, yaw = self.end
            extra = s - self.length
            return x + extra * math.cos(yaw), y + extra * math.sin(yaw), yaw, 0.0
        elif s < 0.0:
            _, x, y, yaw, _, _ = self._cells[0]
            return x + s * math.cos(yaw), y + s * math.sin(yaw), yaw, 0.0

        # Written out without arrays or loops, as drivers call it at every step.
        start, x, y, yaw, k, c = self._cells[bisect_right(self._starts, s) - 1]
        u = s - start
        half = 0.5 * c
        u1, u2, u3 = NODES[0] * u, 0.5 * u, NODES[2] * u
        a1, a2, a3 = yaw + (k + half * u1) * u1, yaw + (k + half * u2) * u2, yaw + (k + half * u3) * u3
        x += u * (WEIGHTS[0] * (math.cos(a1) + math.cos(a3)) + WEIGHTS[1] * math.cos(a2))
        y += u * (WEIGHTS[0] * (math.sin(a1) + math.sin(a3)) + WEIGHTS[1] * math.sin(a2))
        return x, y, yaw + (k + half * u) * u, k + c * u

    def _descend(self, x: float, y: float, near: float) -> tuple[float, float] | None:
        """Find the nearest point by Newton's method from `near`; None if it moves too far or does not converge.

        d(distance²/2)/ds = -f with f the component of the distance along the tangent, and df/ds = -(1 - k e_y). With
        that slope limited to 0.2 or more, every step descends, also beyond the centre of curvature.
        """
        s, last = near, self.length
        for _ in range(40):
            px, py, yaw, k = self._evaluate(s)
            cosine, sine = math.cos(yaw), math.sin(yaw)
            dx, dy = x - px, y - py
            along, lateral = dx * cosine + dy * sine, dy * cosine - dx * sine
            step = along / max(1.0 - k * lateral, 0.2)
            # Limited, because in a bend the first steps could otherwise reach another part of the track.
            step = max(-2.0, min(2.0, step))
            if not self.closed:
                # At the end of an open track the step becomes zero, so that the loop ends there.
                step = max(0.0, min(last, s + step)) - s
            s += step
            if abs(step) < 1e-9:
                return self.wrap(s), lateral
            if abs(s - near) > _FAR:
                return None
        # A point at the seam of a closed track, whose ends may miss each other by up to 1 mm, has no stationary point.
        return (self.wrap(s), lateral) if self.closed and abs(step) <= 2.0 * self.gap[0] else None

    def _project_many(self, x: Array, y: Array, near: ArrayLike | None) -> tuple[Array, Array]:
        """Project arrays: the same descent for all points at once; those that do not converge start from their cell."""
        x, y = np.broadcast_arrays(x, y)
        shape = x.shape
        x, y = x.ravel(), y.ravel()

        # A search tree rejects NaN; rows of a vehicle that diverged stay NaN.
        finite = np.isfinite(x) & np.isfinite(y)
        if not finite.all():
            s, lateral = np.full(len(x), np.nan), np.full(len(x), np.nan)
            hints = None if near is None else np.broadcast_to(np.asarray(near, dtype=float), shape).ravel()[finite]
            s[finite], lateral[finite] = self._project_many(x[finite], y[finite], hints)
            return s.reshape(shape), lateral.reshape(shape)
        # Without a hint the nearest sampled point is the start of the descent, from which it converges to the closest
        # point.
        if near is None:
            s, lateral, _ = self._descend_many(x, y, self._nearest_cell(x, y))
        else:
            first = np.broadcast_to(np.asarray(near, dtype=float), shape).ravel()
            s, lateral, converged = self._descend_many(x, y, first)
            # The same condition as for one point, so that both give equal results.
            again = ~converged | (np.abs(s - first) > _FAR) | (np.abs(lateral) > _FAR)
            if again.any():
                s[again], lateral[again], _ = self._descend_many(
                    x[again], y[again], self._nearest_cell(x[again], y[again])
                )
        # np.mod may return the length itself by rounding, which is the station 0.
        if self.closed:
            s = np.mod(s, self.length)
            s = np.where(s < self.length, s, 0.0)
        return s.reshape(shape), lateral.reshape(shape)

    def _nearest_cell(self, x: Array, y: Array) -> Array:
        """Return s [m] at the start of the cell nearest to each point."""
        if self._tree is None:
            self._tree = scipy.spatial.cKDTree(np.column_stack((self._x, self._y)))
        return np.asarray(self._s[self._tree.query(np.column_stack((x, y)))[1]])

    def _descend_many(self, x: Array, y: Array, s: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Descend as :meth:`_descend` for arrays; return s, e_y and whether each point converged."""
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
            # Only points that still move are evaluated again; NaN compares as false and stays active.
            active = active[~(np.abs(step) < 1e-9)]
            if not active.size:
                break
        converged = np.ones(len(s), dtype=bool)
        converged[active] = False
        return s, lateral, converged
