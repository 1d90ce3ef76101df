"""Paint of a network as areas: road marks and stop lines."""

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from mirdrake.worlds.networks.network import Network, PaintedLine, StopLine
from mirdrake.worlds.pieces import Array

_STOP_WIDTH = 0.5  # [m] of a stop line
_SHORTEST = 0.01  # [m] length of a dash
_BESIDE = 0.15  # [m] from the end of a stop line to the edge of its lane


def paint(network: Network) -> dict[str, BaseGeometry]:
    """Return the painted area of each colour [m]."""
    areas: dict[str, list[BaseGeometry]] = {}
    for line in [*network.markings, *(stop_mark(network, line) for line in network.stop_lines)]:
        areas.setdefault(line.color, []).append(painted_area(line))
    return {color: shapely.union_all(parts) for color, parts in areas.items()}


def stop_mark(network: Network, line: StopLine) -> PaintedLine:
    """Return a stop line as a painted line across its lane; that of a yield sign is dashed."""
    lane = network.lanes[line.lane]
    half = float(lane.width_at(line.s)) / 2.0 - _BESIDE
    # The paint ends at the station, so that a vehicle in front of it is in front of the line.
    s = min(max(line.s - _STOP_WIDTH / 2.0, 0.0), lane.length)
    points = np.column_stack(lane.pose(s, np.array([-half, half]))[:2])
    return PaintedLine(points, _STOP_WIDTH, (0.5, 0.5) if line.kind == "yield" else None)


def painted_area(line: PaintedLine) -> BaseGeometry:
    """Return the area of a painted line [m]."""
    if line.dash is None:
        middle = shapely.LineString(line.points)
        return middle.buffer(line.width / 2.0, cap_style="flat", join_style="mitre", mitre_limit=2.0)
    return shapely.union_all(shapely.buffer(dashes(line.points, *line.dash), line.width / 2.0, cap_style="flat"))


def dashes(points: Array, dash: float, gap: float) -> NDArray[np.object_]:
    """Return the dashes of a line as lines [m]; a last one of less than 1 cm is left out.

    Args:
        points: of the line (n, 2) [m].
        dash: length of a dash [m].
        gap: between two dashes [m].
    """
    s = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
    begins = np.arange(0.0, s[-1] - _SHORTEST, dash + gap)
    if not len(begins):
        return np.empty(0, dtype=object)
    ends = np.minimum(begins + dash, s[-1])
    # Both ends of all dashes, and the points of the line between them, in the order of their stations.
    inner = np.searchsorted(begins, s, side="left") - 1
    kept = (inner >= 0) & (s > begins[inner]) & (s < ends[inner])
    owners = np.concatenate((np.arange(len(begins)), inner[kept], np.arange(len(begins))))
    stations = np.concatenate((begins, s[kept], ends))
    order = np.lexsort((stations, owners))
    places = np.column_stack([np.interp(stations[order], s, points[:, i]) for i in (0, 1)])
    return np.asarray(shapely.linestrings(places, indices=owners[order]), dtype=object)
