"""Paint of a network as areas: road marks and stop lines."""

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry
from shapely.ops import substring

from mirdrake.worlds.networks.network import Network, PaintedLine, StopLine

_STOP_WIDTH = 0.5  # [m] of a stop line
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
    middle = shapely.LineString(line.points)
    if line.dash is None:
        return middle.buffer(line.width / 2.0, cap_style="flat", join_style="mitre", mitre_limit=2.0)
    dash, gap = line.dash
    starts = np.arange(0.0, middle.length, dash + gap)
    parts = [substring(middle, start, min(start + dash, middle.length)) for start in starts]
    return shapely.union_all(
        shapely.buffer([part for part in parts if part.length > 0.01], line.width / 2.0, cap_style="flat")
    )
