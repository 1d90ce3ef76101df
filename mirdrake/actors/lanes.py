"""Lanes as arrays for compiled functions: poses at stations, projection of points."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mirdrake.core.compiled import Records, record_type, records
from mirdrake.worlds.networks.lane import Lane
from mirdrake.worlds.pieces import Array

Ints = NDArray[np.int64]

_SPACING = 0.5  # [m] largest distance of nodes
_CHOICES = 4  # successors of a lane


class LaneRow(NamedTuple):
    """A lane for compiled functions."""

    first: int
    """its first node"""
    nodes: int
    """number of its nodes"""
    step: float
    """distance of its nodes [m]"""
    length: float
    """[m]"""
    closed: int
    """1: its end is its start"""
    own: int
    """1: the path of a single actor"""
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


class LaneTable(NamedTuple):
    """Lanes in one table, as records: each array would be an argument of every compiled function that has the table."""

    lanes: Records
    """:class:`LaneRow` of each lane (l)"""
    nodes: Records
    """:class:`Node`, equally spaced; those of all lanes in a row (n)"""


def lane_table(lanes: Mapping[str, Lane]) -> tuple[LaneTable, dict[str, int]]:
    """Return the table of lanes, and the number of each id."""
    numbers = {lane.id: number for number, lane in enumerate(lanes.values())}
    nodes: list[Array] = []
    rows: list[LaneRow] = []
    first = 0
    for lane in lanes.values():
        count = max(2, math.ceil(lane.length / _SPACING) + 1)
        s = np.linspace(0.0, lane.length, count)
        x, y, yaw = lane.pose(s)
        nodes.append(np.column_stack((x, y, yaw, lane.curvature_at(s))))
        # Nodes are on the centre line of the lane; its width extends the box to its area.
        margin = float(np.max(lane.width))
        following = [numbers[name] for name in lane.successors if name in numbers][:_CHOICES]
        a, b, c, d = [*following, -1, -1, -1, -1][:_CHOICES]
        rows.append(
            LaneRow(
                first=first,
                nodes=count,
                step=lane.length / (count - 1),
                length=lane.length,
                closed=int(lane.id in lane.successors),  # a lane that is its own successor
                own=int(lane.kind == "path"),
                left=numbers.get(lane.left or "", -1),
                right=numbers.get(lane.right or "", -1),
                successors=(a, b, c, d),
                width=float(np.mean(lane.width)),
                box=(x.min() - margin, y.min() - margin, x.max() + margin, y.max() + margin),
            )
        )
        first += count
    points = np.concatenate(nodes) if nodes else np.empty((0, len(Node._fields)))
    return LaneTable(records(LaneRow, rows), points.view(record_type(Node))[:, 0]), numbers


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
    i, u = lane_cell(t, lane, s - beyond)
    h = t.lanes[lane].step
    end, start, last = u * u * (3.0 - 2.0 * u), h * u * (1.0 - u) ** 2, h * u * u * (u - 1.0)
    a, b = t.nodes[i], t.nodes[i + 1]
    x = a.x + end * (b.x - a.x) + start * math.cos(a.yaw) + last * math.cos(b.yaw)
    y = a.y + end * (b.y - a.y) + start * math.sin(a.yaw) + last * math.sin(b.yaw)
    yaw = a.yaw + u * (b.yaw - a.yaw)
    k = a.curvature + u * (b.curvature - a.curvature)
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
    first, count, step = t.lanes[lane].first, t.lanes[lane].nodes, t.lanes[lane].step
    best, root, nearest, i = within * within, within, -1, 0
    while i < count:
        # Squares, because a root is slow and only strides need it.
        dx, dy = t.nodes[first + i].x - x, t.nodes[first + i].y - y
        square = dx * dx + dy * dy
        if square < best:
            best, root, nearest = square, math.sqrt(square), i
            i += 1
        else:
            i += max(1, int((math.sqrt(square) - root) / step))  # nodes between are farther away
    return nearest


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


PARTS = (wrapped, lane_cell, lane_pose, project, nearest_node, foot)
"""Compiled functions of this module."""
