"""Conflicts of lanes: where the areas of two lanes overlap, from the geometry."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from mirdrake.worlds.networks.lane import Lane

_SMALLEST = 0.1  # overlap [m²] below which lanes only touch
_SHRINK = 0.05  # [m] by which lanes are made narrower at each edge, so that neighbours do not overlap
_BRIDGE = 3.0  # [m] difference in height of lanes that cross on a bridge
_SAME = 0.5  # [m] distance of ends that coincide


@dataclass(frozen=True)
class Conflict:
    """Two lanes whose areas overlap."""

    lanes: tuple[str, str]
    """in the order of the network"""
    kind: Literal["crossing", "merge", "split"]
    """merge: common successor or common end; split: common predecessor or common start"""
    spans: tuple[tuple[float, float], tuple[float, float]]
    """first and last station of the overlap on each lane [m]"""
    point: tuple[float, float]
    """where the centre lines meet; of a merge its end, of a split its start, else the middle of the overlap [m]"""

    def other(self, lane: str) -> str:
        """Return the other lane of the pair."""
        first, second = self.lanes
        return second if lane == first else first

    def span(self, lane: str) -> tuple[float, float]:
        """Return the first and the last station of the overlap on a lane [m]."""
        return self.spans[self.lanes.index(lane)]


def find_conflicts(lanes: Mapping[str, Lane]) -> tuple[Conflict, ...]:
    """Return all pairs of lanes that overlap; lanes that follow each other do not count.

    Lanes whose heights differ by more than 3 m at the overlap cross on a bridge and do not conflict.
    """
    rows = list(lanes.values())
    # Shrunk, so that neighbours that share an edge do not overlap by rounding.
    areas = [lane.area.buffer(-_SHRINK) for lane in rows]
    first, second = shapely.STRtree(areas).query(areas, predicate="intersects")
    found: list[Conflict] = []
    for i, j in sorted((int(i), int(j)) for i, j in zip(first, second, strict=True) if i < j):
        a, b = rows[i], rows[j]
        # Successive lanes overlap at their common end, where one follows the other.
        if b.id in (*a.successors, *a.predecessors):
            continue
        overlap = shapely.intersection(areas[i], areas[j])
        if overlap.area < _SMALLEST:
            continue
        spans = _span(a, overlap), _span(b, overlap)
        if abs(_height(a, spans[0]) - _height(b, spans[1])) > _BRIDGE:
            continue
        found.append(Conflict((a.id, b.id), _kind(a, b), spans, _point(a, b, overlap)))
    return tuple(found)


def _span(lane: Lane, overlap: BaseGeometry) -> tuple[float, float]:
    """Return the first and the last station of an area on a lane [m]."""
    corners = shapely.get_coordinates(overlap)
    s, _ = lane.project(corners[:, 0], corners[:, 1])
    return float(s.min()), float(s.max())


def _height(lane: Lane, span: tuple[float, float]) -> float:
    return float(np.interp(sum(span) / 2.0, lane.s, lane.z))


def _kind(a: Lane, b: Lane) -> Literal["crossing", "merge", "split"]:
    if set(a.successors) & set(b.successors) or _apart(a, b, -1) < _SAME:
        # Merging is checked first: lanes that part and join again need a rule where they join.
        return "merge"
    if set(a.predecessors) & set(b.predecessors) or _apart(a, b, 0) < _SAME:
        return "split"
    return "crossing"


def _apart(a: Lane, b: Lane, node: int) -> float:
    return float(np.hypot(a.x[node] - b.x[node], a.y[node] - b.y[node]))


def _point(a: Lane, b: Lane, overlap: BaseGeometry) -> tuple[float, float]:
    kind = _kind(a, b)
    if kind != "crossing":
        node = -1 if kind == "merge" else 0
        return float(a.x[node]), float(a.y[node])
    first, second = (shapely.LineString(np.column_stack((lane.x, lane.y))) for lane in (a, b))
    meeting = shapely.intersection(first, second)
    place = (overlap if meeting.is_empty else meeting).centroid
    return float(place.x), float(place.y)
