"""Search for a path that a car can drive: arcs of two radii and straights, forwards and backwards.

A hybrid A* (D. Dolgov, S. Thrun, M. Montemerlo, J. Diebel, "Path Planning for Autonomous Vehicles in Unknown
Semi-structured Environments", 2010): states (x, y, yaw) are continuous, so that every path that is found can be driven;
only the first state in each cell of a lattice is kept. Batches of states of nearly equal cost are expanded at once.

A path can be driven in both directions. If the search from the start becomes large, a search from all poses in the goal
is tried: if that one ends early, no path exists.
"""

import math
import time
from dataclasses import dataclass
from typing import Literal

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from mirdrake.world_checks.obstacles import Array, Flags, Room

HEADINGS = 72
"""Cells of the lattice in yaw."""

SEARCH_TIME = 6.0
"""Default computing time of a search [s]."""

_FIRST, _BACK = 150_000, 300_000  # states before the search from the goal, and states of that one
_HASTE = 2.0  # weight of the remaining distance: slightly longer paths with a fiftieth of the states
_BACKWARD, _SHIFT, _TURN = 1.5, 2.0, 1.05  # costs of reversing, of changing direction [m], of turning
_SAMPLES = 3  # tested poses of a move
_MOST_CELLS = 2e8

Index = NDArray[np.int64]
Outcome = Literal["found", "none", "unknown"]


@dataclass(frozen=True)
class SearchResult:
    """Result of a search.

    Attributes:
        outcome: a path was found, there is none, or the computing time is over.
        path: poses (n, 3) of the vehicle's frame B: x, y [m], yaw [rad]; empty without a path.
        nearest: x, y [m] of the position nearest to the goal that was reached.
    """

    outcome: Outcome
    path: Array
    nearest: tuple[float, float]


def search_path(
    room: Room, start: tuple[float, float, float], goal: BaseGeometry, *, time_limit: float = SEARCH_TIME
) -> SearchResult:
    """Search for a path from a pose to an area, with any heading at its end.

    Args:
        room: free space of the vehicle.
        start: x, y [m] and yaw [rad] of the vehicle's frame B, which must be free.
        goal: area that B must reach; a small one is enlarged to a cell of the lattice.
        time_limit: computing time [s].
    """
    end = time.process_time() + time_limit
    lattice = _Lattice(room)
    # A goal smaller than a cell could lie between all nodes.
    if goal.area < math.pi * lattice.cell**2:
        goal = goal.buffer(lattice.cell)
    shapely.prepare(goal)
    ahead = _Flood(lattice, np.array([start]), _Guide(room, goal), goal)
    outcome = ahead.run(_FIRST, end)
    # Without a quick result, a search backwards shows whether the goal is walled in.
    if outcome == "unknown" and time.process_time() < end:
        poses = lattice.poses_in(goal)
        back = _Flood(lattice, poses, None, None)
        if not len(poses) or (back.run(_BACK, end) == "none" and not back.has_reached(np.array([start]))):
            outcome = "none"
        else:
            outcome = ahead.run(10**9, end)
    return SearchResult(outcome, ahead.path(), ahead.nearest)


class _Lattice:
    """Cells of (x, y, yaw), and moves between them."""

    def __init__(self, room: Room) -> None:
        self.room, body = room, room.body
        size = room.high - room.low
        # The memory for one flag per cell bounds the lattice.
        finest = math.sqrt(float(np.prod(size)) * HEADINGS / _MOST_CELLS)
        self.cell = max(finest, body.half_width / 3.5, 0.04 * body.radius)
        self.shape = tuple(int(n) + 1 for n in np.ceil(size / self.cell))
        # A move is longer than the diagonal of a cell, so that it ends in another one.
        self.length = 2.2 * self.cell
        """length of a move [m]"""
        moves = []
        for sign in (1.0, -1.0):
            for curvature in np.array([0.0, 0.5, -0.5, 1.0, -1.0]) / body.radius:
                s = sign * self.length * np.arange(1, _SAMPLES + 1) / _SAMPLES
                turn = curvature * s
                # Arc of curvature k: x = sin(k s) / k, y = (1 - cos(k s)) / k.
                x = s if curvature == 0.0 else np.sin(turn) / curvature
                y = np.zeros_like(s) if curvature == 0.0 else (1.0 - np.cos(turn)) / curvature
                moves.append(np.column_stack((x, y, turn)))
        self.moves = np.array(moves)
        """(10, samples, 3): x [m], y [m] and yaw [rad] in the frame of the pose before the move"""
        # Five moves forwards, then five backwards; the first of each five is straight.
        self.is_back = np.arange(10) >= 5
        cost = self.length * np.where(self.is_back, _BACKWARD, 1.0)
        self.costs = cost * np.where(np.arange(10) % 5 == 0, 1.0, _TURN)

    def keys(self, poses: Array) -> Index:
        """Return the cells of poses (..., 3) in the domain."""
        ij = np.floor((poses[..., :2] - self.room.low) / self.cell).astype(np.int64)
        ij = np.clip(ij, 0, np.array(self.shape) - 1)
        # Cells of the heading are centred on multiples of 5 degrees; the modulo wraps the angle.
        turn = np.floor(poses[..., 2] * (HEADINGS / (2.0 * math.pi)) + 0.5).astype(np.int64) % HEADINGS
        return np.asarray((ij[..., 0] * self.shape[1] + ij[..., 1]) * HEADINGS + turn)

    def poses_in(self, area: BaseGeometry) -> Array:
        """Return one pose of every cell in an area in which the vehicle is free."""
        xmin, ymin, xmax, ymax = area.bounds
        steps = [max(1, math.ceil((high - low) / self.cell)) for low, high in ((xmin, xmax), (ymin, ymax))]
        xs, ys = (
            low + (np.arange(n) + 0.5) * (high - low) / n
            for low, high, n in ((xmin, xmax, steps[0]), (ymin, ymax, steps[1]))
        )
        yaws = np.arange(HEADINGS) * (2.0 * math.pi / HEADINGS)
        x, y, yaw = (axis.ravel() for axis in np.meshgrid(xs, ys, yaws, indexing="ij"))
        inside = shapely.contains_xy(area, x, y)
        x, y, yaw = x[inside], y[inside], yaw[inside]
        free = self.room.is_free(x, y, yaw)
        return np.column_stack((x, y, yaw))[free]


class _Guide:
    """Heuristic of the search: distance to the goal around obstacles [m], for the centre of the box.

    It may be slightly too long, which costs a detour but never a path.
    """

    def __init__(self, room: Room, goal: BaseGeometry) -> None:
        from scipy.sparse import coo_matrix
        from scipy.sparse.csgraph import dijkstra

        body = room.body
        self._room, self._goal = room, goal
        self._ahead = 0.5 * (body.front + body.rear)
        # A heuristic needs no finer grid than a part of the vehicle's width.
        self._stride = max(1, round(0.4 * body.half_width / room.cell))
        clear = room.distance[:: self._stride, :: self._stride]
        ny, nx = clear.shape
        # The grid is accurate to 1.5 cells; the heuristic must not close an open passage.
        open_ = clear > body.half_width - 1.5 * room.cell
        side = room.cell * self._stride
        number = np.arange(ny * nx).reshape(ny, nx)
        rows, columns, lengths = [], [], []
        # Four of the eight neighbours are enough, since the graph is undirected.
        for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
            a = (slice(0, ny - dy), slice(max(0, -dx), nx - max(0, dx)))
            b = (slice(dy, ny), slice(max(0, dx), nx - max(0, -dx)))
            both = open_[a] & open_[b]
            rows.append(number[a][both])
            columns.append(number[b][both])
            lengths.append(np.full(int(both.sum()), side * math.hypot(dx, dy)))
        xs = room.low[0] + (self._stride * np.arange(nx) + 0.5) * room.cell
        ys = room.low[1] + (self._stride * np.arange(ny) + 0.5) * room.cell
        near = goal.buffer(abs(self._ahead) + side)
        xmin, ymin, xmax, ymax = near.bounds
        i, k = np.flatnonzero((xs >= xmin) & (xs <= xmax)), np.flatnonzero((ys >= ymin) & (ys <= ymax))
        inside = np.zeros((ny, nx), dtype=bool)
        if len(i) and len(k):
            inside[np.ix_(k, i)] = shapely.contains_xy(near, *np.meshgrid(xs[i], ys[k]))
        # An additional node next to all cells of the goal: one search finds the distance to the nearest of them.
        targets = number[inside & open_]
        rows.append(np.full(len(targets), ny * nx))
        columns.append(targets)
        lengths.append(np.full(len(targets), 1e-6))
        shape = (ny * nx + 1, ny * nx + 1)
        graph = coo_matrix((np.concatenate(lengths), (np.concatenate(rows), np.concatenate(columns))), shape=shape)
        far = dijkstra(graph.tocsr(), directed=False, indices=ny * nx)[:-1].reshape(ny, nx)
        known = far[np.isfinite(far)]
        self._far, self._longest = far, float(known.max()) if len(known) else 0.0
        self._x, self._y = goal.centroid.x, goal.centroid.y

    def __call__(self, poses: Array) -> Array:
        """Return the remaining distance from poses (n, 3) [m]."""
        x = poses[:, 0] + self._ahead * np.cos(poses[:, 2])
        y = poses[:, 1] + self._ahead * np.sin(poses[:, 2])
        i = np.floor((x - self._room.low[0]) / self._room.cell).astype(np.int64) // self._stride
        k = np.floor((y - self._room.low[1]) / self._room.cell).astype(np.int64) // self._stride
        ny, nx = self._far.shape
        far = self._far[np.clip(k, 0, ny - 1), np.clip(i, 0, nx - 1)]
        # A pose outside of the open cells gets a long but finite distance, so that it is still expanded.
        lost = ~np.isfinite(far)
        if lost.any():
            far[lost] = self._longest + np.hypot(x[lost] - self._x, y[lost] - self._y)
        return np.asarray(far)


class _Flood:
    """States reached from some poses, in the order of cost plus, with a guide, the remaining distance."""

    def __init__(self, lattice: _Lattice, poses: Array, guide: _Guide | None, goal: BaseGeometry | None) -> None:
        self._lattice, self._guide, self._goal = lattice, guide, goal
        self._seen = np.zeros(lattice.shape[0] * lattice.shape[1] * HEADINGS, dtype=bool)
        self._poses: list[Array] = []
        self._parents: list[Index] = []
        self._count = 0
        self._waiting: dict[int, list[tuple[Index, Array, Array, Flags]]] = {}
        self._found: tuple[int, Array] | None = None
        self._nearest = (math.inf, 0.0, 0.0)
        if len(poses):
            n = len(poses)
            self._add(poses, np.full(n, -1), np.zeros(n), np.zeros(n, dtype=bool))

    @property
    def nearest(self) -> tuple[float, float]:
        return self._nearest[1:]

    def has_reached(self, poses: Array) -> bool:
        """Return whether a cell at or beside a pose was reached."""
        cell, turn = self._lattice.cell, 2.0 * math.pi / HEADINGS
        steps = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3), axis=-1).reshape(-1, 3) * [cell, cell, turn]
        return bool(self._seen[self._lattice.keys(poses[:, None, :] + steps)].any())

    def run(self, max_states: int, end: float) -> Outcome:
        """Expand states until the goal is reached, none is left, or their number or the computing time [s] is over."""
        while self._waiting and self._found is None:
            if self._count > max_states or time.process_time() > end:
                return "unknown"
            batch = self._waiting.pop(min(self._waiting))
            number, poses, costs, back = (np.concatenate(parts) for parts in zip(*batch, strict=True))
            self._move(number, poses, costs, back)
        return "found" if self._found is not None else "none"

    def path(self) -> Array:
        """Return the poses (n, 3) to the goal."""
        if self._found is None:
            return np.empty((0, 3))
        poses, parents = np.concatenate(self._poses), np.concatenate(self._parents)
        number, last = self._found
        path = [last]
        while number >= 0:
            path.append(poses[number])
            number = int(parents[number])
        return np.array(path[::-1])

    def _move(self, number: Index, poses: Array, costs: Array, back: Flags) -> None:
        """Expand some states by all moves."""
        lattice, room = self._lattice, self._lattice.room
        if self._reaches(poses, number):
            return
        c, s = np.cos(poses[:, 2])[:, None], np.sin(poses[:, 2])[:, None]
        ends = _moved(poses[:, None], c, s, lattice.moves[None, :, -1])
        keys = lattice.keys(ends)
        inside = ((ends[..., :2] >= room.low) & (ends[..., :2] <= room.high)).all(axis=-1)
        total = costs[:, None] + lattice.costs + _SHIFT * lattice.cell * (back[:, None] != lattice.is_back)
        which = np.flatnonzero((inside & ~self._seen[keys]).ravel())
        if not len(which):
            return
        # Only moves into new cells are tested; of several into one cell the cheapest is kept.
        state, move = which // len(lattice.moves), which % len(lattice.moves)
        samples = _moved(poses[state][:, None], c[state], s[state], lattice.moves[move])
        flat = samples.reshape(-1, 3)
        free = room.is_free(*flat.T).reshape(-1, _SAMPLES).all(axis=1)
        state, move, samples = state[free], move[free], samples[free]
        cost = total[state, move]
        # np.unique returns the first row of each key: the cheapest one, since rows are sorted by cost.
        order = np.argsort(cost, kind="stable")
        _, first = np.unique(keys[state, move][order], return_index=True)
        first_of_cell = order[first]
        state, move, cost = state[first_of_cell], move[first_of_cell], cost[first_of_cell]
        self._add(samples[first_of_cell, -1], number[state], cost, lattice.is_back[move])

    def _reaches(self, poses: Array, number: Index) -> bool:
        """Return whether one of some states is in the goal; the first such state becomes the end of the path."""
        if self._goal is None:
            return False
        inside = np.flatnonzero(shapely.contains_xy(self._goal, poses[:, 0], poses[:, 1]))
        if len(inside):
            best = int(inside[0])
            self._found = int(np.concatenate(self._parents)[number[best]]), poses[best]
        return bool(len(inside))

    def _add(self, poses: Array, parents: Index, costs: Array, back: Flags) -> None:
        """Add new states."""
        self._seen[self._lattice.keys(poses)] = True
        number = self._count + np.arange(len(poses))
        self._count += len(poses)
        self._poses.append(poses)
        self._parents.append(parents)
        to_go = self._guide(poses) if self._guide is not None else np.zeros(len(poses))
        if self._guide is not None and len(poses):
            nearest = int(to_go.argmin())
            if to_go[nearest] < self._nearest[0]:
                self._nearest = (float(to_go[nearest]), float(poses[nearest, 0]), float(poses[nearest, 1]))
        # States whose rank differs by less than one move share a batch.
        rank = np.floor((costs + _HASTE * to_go) / self._lattice.length).astype(np.int64)
        for value in np.unique(rank):
            mine = rank == value
            self._waiting.setdefault(int(value), []).append((number[mine], poses[mine], costs[mine], back[mine]))


def _moved(poses: Array, c: Array, s: Array, moves: Array) -> Array:
    """Return poses (..., 3) after moves (..., 3) in their frames."""
    x, y, yaw = (poses[..., i] for i in range(3))
    dx, dy, turn = (moves[..., i] for i in range(3))
    return np.stack((x + c * dx - s * dy, y + s * dx + c * dy, yaw + turn), axis=-1)
