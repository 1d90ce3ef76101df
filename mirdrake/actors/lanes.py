"""Lanes as arrays for compiled functions: poses at stations, projection of points."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from mirdrake.core.compiled import Records, record_type, records
from mirdrake.worlds.networks.lane import Lane
from mirdrake.worlds.pieces import Array

_SPACING = 0.5  # [m] largest distance of nodes
_PIECE = 16  # nodes of a piece
CHOICES = 4
"""Most successors of a lane in the table."""


class LaneRow(NamedTuple):
    """A lane for compiled functions."""

    first: int
    """its first node"""
    nodes: int
    """number of its nodes"""
    piece: int
    """its first piece: the whole lane; then those of its nodes"""
    step: float
    """distance of its nodes [m]"""
    length: float
    """[m]"""
    closed: int
    """1: its end is its start"""
    own: int
    """1: the path of a single actor, or a track that is only a line to follow: other lanes cross it or are below it"""
    fork: int
    """lane before it that has several successors; -1: none"""
    junction: int
    """1: within a junction"""
    left: int
    """next lane to the left with the same direction; -1: none"""
    right: int
    """next lane to the right; -1: none"""
    successors: tuple[int, int, int, int]
    """-1: none"""
    width: float
    """mean width [m]"""
    box: tuple[float, float, float, float]
    """smallest x and y, largest x and y of its area [m]"""


class Node(NamedTuple):
    """A point of a lane."""

    x: float
    """[m]"""
    y: float
    """[m]"""
    yaw: float
    """continuous along a lane [rad]"""
    curvature: float
    """[1/m]"""


class Piece(NamedTuple):
    """Some nodes of a lane in a row, for the search of the nearest one: their chord, and how far they are beside it."""

    x: float
    """first node [m]"""
    y: float
    """[m]"""
    dx: float
    """from the first to the last node [m]"""
    dy: float
    """[m]"""
    along_x: float
    """dx over the square of the length of the chord [1/m]"""
    along_y: float
    """[1/m]"""
    aside: float
    """largest distance of its nodes from the chord [m]"""


class LaneTable(NamedTuple):
    """Lanes in one table, as records: each array would be an argument of every compiled function that has the table."""

    lanes: Records
    """:class:`LaneRow` of each lane (l)"""
    nodes: Records
    """:class:`Node`, equally spaced; those of all lanes in a row (n)"""
    pieces: Records
    """:class:`Piece`: of each lane the whole, then each of 16 nodes, the last one of the rest (p)"""


def lane_table(lanes: Mapping[str, Lane]) -> tuple[LaneTable, dict[str, int]]:
    """Return the table of lanes, and the number of each id."""
    numbers = {lane.id: number for number, lane in enumerate(lanes.values())}
    forks = {name for name, lane in lanes.items() if len(lane.successors) > 1}
    nodes: list[Array] = []
    rows: list[LaneRow] = []
    pieces: list[Piece] = []
    first = 0
    # Equal steps along the lane make the search for a node a division.
    for lane in lanes.values():
        count = max(2, math.ceil(lane.length / _SPACING) + 1)
        s = np.linspace(0.0, lane.length, count)
        x, y, yaw = lane.pose(s)
        # Continuous, also at the end of a closed lane, where its pose is that of the start.
        nodes.append(np.column_stack((x, y, np.unwrap(yaw), lane.curvature_at(s))))
        # Nodes are on the centre line of the lane; its width extends the box to its area.
        margin = float(np.max(lane.width))
        following = [numbers[name] for name in lane.successors if name in numbers][:CHOICES]
        a, b, c, d = [*following, -1, -1, -1, -1][:CHOICES]
        rows.append(
            LaneRow(
                first=first,
                nodes=count,
                piece=len(pieces),
                step=lane.length / (count - 1),
                length=lane.length,
                closed=int(lane.id in lane.successors),  # a lane that is its own successor
                own=int(lane.kind in {"path", "line"}),
                fork=max((numbers[name] for name in lane.predecessors if name in forks), default=-1),
                junction=int(lane.junction is not None),
                left=numbers.get(lane.left or "", -1),
                right=numbers.get(lane.right or "", -1),
                successors=(a, b, c, d),
                width=float(np.mean(lane.width)),
                box=(x.min() - margin, y.min() - margin, x.max() + margin, y.max() + margin),
            )
        )
        # A piece bounds the nodes of the whole lane, the following ones parts of it: they speed up the projection.
        pieces += [_piece(x, y)]
        pieces += [_piece(x[i : i + _PIECE], y[i : i + _PIECE]) for i in range(0, count, _PIECE)]
        first += count
    points = np.concatenate(nodes) if nodes else np.empty((0, len(Node._fields)))
    nodes_ = points.view(record_type(Node))[:, 0]
    return LaneTable(records(LaneRow, rows), nodes_, records(Piece, pieces)), numbers


def _piece(x: Array, y: Array) -> Piece:
    """Return the piece of some nodes."""
    ahead, aside = x - x[0], y - y[0]
    dx, dy = float(ahead[-1]), float(aside[-1])
    square = dx * dx + dy * dy
    along_x, along_y = (dx / square, dy / square) if square > 0.0 else (0.0, 0.0)
    share = np.clip(ahead * along_x + aside * along_y, 0.0, 1.0)
    away = np.hypot(ahead - share * dx, aside - share * dy)
    # Rounded up, so that no node is missed.
    return Piece(float(x[0]), float(y[0]), dx, dy, along_x, along_y, float(away.max()) + 1e-9)


# --- compiled -----------------------------------------------------------------------------------------------------


def wrapped(value: float, period: float) -> float:
    """Return a value plus a multiple of a period, within half a period of zero."""
    return value - period * math.floor(value / period + 0.5)


def lane_cell(t: LaneTable, lane: int, s: float) -> tuple[int, float]:
    """Return the node before a station, and the share of the way to the next node."""
    at = s / t.lanes[lane].step
    i = math.floor(at)
    # At the end of the lane the last piece is used with a share of one, because there is no node beyond.
    i = max(0, min(i, t.lanes[lane].nodes - 2))
    return t.lanes[lane].first + i, at - i


def lane_pose(t: LaneTable, lane: int, s: float) -> tuple[float, float, float, float]:
    """Return x [m], y [m], yaw [rad] and curvature [1/m] of the middle of a lane; straight beyond its ends.

    Positions are cubic Hermite polynomials of the positions and tangents at the nodes.
    """
    beyond = 0.0
    if s < 0.0:
        beyond = s
    elif s > t.lanes[lane].length:
        beyond = s - t.lanes[lane].length
    # A cubic Hermite spline between nodes, whose tangents are the headings: position and heading are continuous.
    i, u = lane_cell(t, lane, s - beyond)
    h = t.lanes[lane].step
    end, start, last = u * u * (3.0 - 2.0 * u), h * u * (1.0 - u) ** 2, h * u * u * (u - 1.0)
    a, b = t.nodes[i], t.nodes[i + 1]
    x = a.x + end * (b.x - a.x) + start * math.cos(a.yaw) + last * math.cos(b.yaw)
    y = a.y + end * (b.y - a.y) + start * math.sin(a.yaw) + last * math.sin(b.yaw)
    yaw = a.yaw + u * (b.yaw - a.yaw)
    k = a.curvature + u * (b.curvature - a.curvature)
    # Beyond the ends the lane goes on straight, so that a vehicle that leaves it still has a pose.
    if beyond != 0.0:
        x += beyond * math.cos(yaw)
        y += beyond * math.sin(yaw)
        k = 0.0
    return x, y, yaw, k


def project(t: LaneTable, lane: int, x: float, y: float) -> tuple[float, float]:
    """Return the station [m] and the offset [m, + left] of a point: the nearest node, then Newton's method."""
    return foot(t, lane, x, y, max(0, nearest_node(t, lane, x, y, math.inf)))


def nearest_node(t: LaneTable, lane: int, x: float, y: float, within: float) -> int:
    """Return the number along a lane of the node nearest to a point; -1: none within a distance [m]."""
    row = t.lanes[lane]
    if is_beyond(t.pieces[row.piece], x, y, within):
        return -1
    # Squares, because a root is slow. The nearest begin of a piece is a bound that dismisses most pieces at once.
    best, nearest, pieces = within * within, -1, math.ceil(row.nodes / _PIECE)
    for k in range(pieces):
        piece = t.pieces[row.piece + 1 + k]
        dx, dy = piece.x - x, piece.y - y
        best = min(best, (dx * dx + dy * dy) * (1.0 + 1e-9) + 1e-12)  # more, so that this node is found again
    root = math.sqrt(best)
    for k in range(pieces):
        if is_beyond(t.pieces[row.piece + 1 + k], x, y, root):
            continue
        for i in range(k * _PIECE, min((k + 1) * _PIECE, row.nodes)):
            dx, dy = t.nodes[row.first + i].x - x, t.nodes[row.first + i].y - y
            if dx * dx + dy * dy < best:
                best, nearest = dx * dx + dy * dy, i
        root = math.sqrt(best)
    return nearest


def is_beyond(piece: Any, x: float, y: float, distance: float) -> bool:
    """Return whether all nodes of a piece are at least at a distance from a point [m]."""
    dx, dy = x - piece.x, y - piece.y
    share = max(0.0, min(1.0, dx * piece.along_x + dy * piece.along_y))
    dx, dy = dx - share * piece.dx, dy - share * piece.dy
    away = distance + piece.aside
    return bool(dx * dx + dy * dy >= away * away)


def foot(t: LaneTable, lane: int, x: float, y: float, nearest: int) -> tuple[float, float]:
    """Return the station [m] and the offset [m, + left] of a point from the node nearest to it."""
    # Newton's method on the condition that the offset is perpendicular: ds = along / (1 - k d).
    s = nearest * t.lanes[lane].step
    offset = 0.0
    for _ in range(4):
        px, py, yaw, k = lane_pose(t, lane, s)
        along = (x - px) * math.cos(yaw) + (y - py) * math.sin(yaw)
        offset = (y - py) * math.cos(yaw) - (x - px) * math.sin(yaw)
        # Limited steps and a limited divisor keep points near the centre of curvature from jumping along the lane.
        before = s
        s += max(-2.0, min(2.0, along / max(1.0 - k * offset, 0.2)))
        s = s % t.lanes[lane].length if t.lanes[lane].closed == 1 else max(0.0, min(s, t.lanes[lane].length))
        if s == before:  # further steps would repeat this one
            break
    return s, offset


PARTS = (wrapped, lane_cell, lane_pose, project, nearest_node, is_beyond, foot)
"""Compiled functions of this module."""
