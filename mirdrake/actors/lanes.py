"""Lanes as arrays for compiled functions: poses at stations, projection of points."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mirdrake.worlds.networks.lane import Lane
from mirdrake.worlds.pieces import Array

Ints = NDArray[np.int64]

_SPACING = 0.5  # [m] largest distance of nodes
_CHOICES = 4  # successors of a lane


class LaneTable(NamedTuple):
    """Lanes in one table. Nodes of a lane are equally spaced; arrays of nodes have those of all lanes in a row."""

    first: Ints
    """first node of each lane (l)"""
    nodes: Ints
    """number of its nodes (l)"""
    step: Array
    """distance of its nodes (l) [m]"""
    length: Array
    """(l) [m]"""
    closed: Ints
    """1: its end is its start (l)"""
    left: Ints
    """next lane to the left with the same direction (l); -1: none"""
    right: Ints
    """next lane to the right (l); -1: none"""
    successors: Ints
    """(l, 4); -1: none"""
    width: Array
    """mean width (l) [m]"""
    box: Array
    """smallest x and y, largest x and y of its area (l, 4) [m]"""
    x: Array
    """(n) [m]"""
    y: Array
    """(n) [m]"""
    yaw: Array
    """continuous along a lane (n) [rad]"""
    curvature: Array
    """(n) [1/m]"""
    left_s: Array
    """station on the lane to the left (n) [m]"""
    right_s: Array
    """station on the lane to the right (n) [m]"""


def lane_table(lanes: Mapping[str, Lane]) -> tuple[LaneTable, dict[str, int]]:
    """Return the table of lanes, and the number of each id."""
    numbers = {lane_id: number for number, lane in enumerate(lanes.values()) for lane_id in [lane.id]}
    nodes: list[tuple[Array, ...]] = []
    first: list[int] = []
    count: list[int] = []
    step: list[float] = []
    box: list[tuple[float, ...]] = []
    for lane in lanes.values():
        amount = max(2, math.ceil(lane.length / _SPACING) + 1)
        s = np.linspace(0.0, lane.length, amount)
        x, y, yaw = lane.pose(s)
        beside = [_beside(lanes, one, x, y) for one in (lane.left, lane.right)]
        first.append(sum(count))
        count.append(amount)
        step.append(lane.length / (amount - 1))
        # Nodes are on the centre line of the lane; its width extends the box to its area.
        margin = float(np.max(lane.width))
        box.append((x.min() - margin, y.min() - margin, x.max() + margin, y.max() + margin))
        nodes.append((x, y, yaw, lane.curvature_at(s), *beside))
    # Tables have no ragged rows: nodes of all lanes are joined, and `first` finds those of one lane.
    joined = [np.concatenate(column) for column in zip(*nodes, strict=True)] if nodes else [np.empty(0)] * 6
    successors = np.full((len(numbers), _CHOICES), -1, dtype=np.int64)
    for row, lane in zip(successors, lanes.values(), strict=True):
        following = [numbers[name] for name in lane.successors if name in numbers][:_CHOICES]
        row[: len(following)] = following
    table = LaneTable(
        np.array(first, dtype=np.int64),
        np.array(count, dtype=np.int64),
        np.array(step),
        np.array([lane.length for lane in lanes.values()]),
        # A lane that is its own successor is closed.
        np.array([int(lane.id in lane.successors) for lane in lanes.values()], dtype=np.int64),
        np.array([numbers.get(lane.left or "", -1) for lane in lanes.values()], dtype=np.int64),
        np.array([numbers.get(lane.right or "", -1) for lane in lanes.values()], dtype=np.int64),
        successors,
        np.array([float(np.mean(lane.width)) for lane in lanes.values()]),
        np.array(box, dtype=float).reshape(-1, 4),
        *joined,
    )
    return table, numbers


def _beside(lanes: Mapping[str, Lane], other: str | None, x: Array, y: Array) -> Array:
    """Return the stations on a lane beside points [m]; 0 without one."""
    return np.zeros(len(x)) if other is None or other not in lanes else lanes[other].project(x, y)[0]


# --- compiled -----------------------------------------------------------------------------------------------------


def wrapped(value: float, period: float) -> float:
    """Return a value plus a multiple of a period, within half a period of zero."""
    return value - period * math.floor(value / period + 0.5)


def lane_cell(t: LaneTable, lane: int, s: float) -> tuple[int, float]:
    """Return the node before a station, and the share of the way to the next node."""
    at = s / t.step[lane]
    i = math.floor(at)
    # At the end of the lane the last piece is used with a share of one, because there is no node beyond.
    i = max(0, min(i, t.nodes[lane] - 2))
    return t.first[lane] + i, at - i


def lane_pose(t: LaneTable, lane: int, s: float) -> tuple[float, float, float, float]:
    """Return x [m], y [m], yaw [rad] and curvature [1/m] of the middle of a lane; straight beyond its ends.

    Positions are cubic Hermite polynomials of the positions and tangents at the nodes.
    """
    beyond = 0.0
    if s < 0.0:
        beyond = s
    elif s > t.length[lane]:
        beyond = s - t.length[lane]
    i, u = lane_cell(t, lane, s - beyond)
    h = t.step[lane]
    end, start, last = u * u * (3.0 - 2.0 * u), h * u * (1.0 - u) ** 2, h * u * u * (u - 1.0)
    x = t.x[i] + end * (t.x[i + 1] - t.x[i]) + start * math.cos(t.yaw[i]) + last * math.cos(t.yaw[i + 1])
    y = t.y[i] + end * (t.y[i + 1] - t.y[i]) + start * math.sin(t.yaw[i]) + last * math.sin(t.yaw[i + 1])
    yaw = t.yaw[i] + u * (t.yaw[i + 1] - t.yaw[i])
    k = t.curvature[i] + u * (t.curvature[i + 1] - t.curvature[i])
    if beyond != 0.0:
        x += beyond * math.cos(yaw)
        y += beyond * math.sin(yaw)
        k = 0.0
    return x, y, yaw, k


def station_beside(t: LaneTable, lane: int, s: float, left: bool) -> float:
    """Return the station on the next lane to the left, else right [m].

    Stations of a closed neighbour jump by its length at its start.
    """
    i, u = lane_cell(t, lane, s)
    if left:
        a, b, other = t.left_s[i], t.left_s[i + 1], t.left[lane]
    else:
        a, b, other = t.right_s[i], t.right_s[i + 1], t.right[lane]
    # Interpolation across the seam of the neighbour would run backwards along the whole lane.
    if t.closed[other] == 1:
        b = a + wrapped(b - a, t.length[other])
        a = a % t.length[other]
    station: float = a + u * (b - a)
    return station


def project(t: LaneTable, lane: int, x: float, y: float) -> tuple[float, float]:
    """Return the station [m] and the offset [m, + left] of a point: the nearest node, then Newton's method."""
    best, nearest, i = math.inf, 0, 0
    while i < t.nodes[lane]:
        node = t.first[lane] + i
        away = math.hypot(t.x[node] - x, t.y[node] - y)
        if away < best:
            best, nearest = away, i
        i += max(1, int((away - best) / t.step[lane]))  # nodes between are farther away

    # Newton's method on the condition that the offset is perpendicular: ds = along / (1 - k d).
    s = nearest * t.step[lane]
    offset = 0.0
    for _ in range(4):
        px, py, yaw, k = lane_pose(t, lane, s)
        along = (x - px) * math.cos(yaw) + (y - py) * math.sin(yaw)
        offset = (y - py) * math.cos(yaw) - (x - px) * math.sin(yaw)
        # Limited steps and a limited divisor keep points near the centre of curvature from jumping along the lane.
        s += max(-2.0, min(2.0, along / max(1.0 - k * offset, 0.2)))
        s = s % t.length[lane] if t.closed[lane] == 1 else max(0.0, min(s, t.length[lane]))
    return s, offset


PARTS = (wrapped, lane_cell, lane_pose, station_beside, project)
"""Compiled functions of this module."""
