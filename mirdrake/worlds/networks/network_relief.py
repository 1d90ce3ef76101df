"""Layer `network` of a relief: the heights of the lanes of the road network, as one grid."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import numpy as np
import scipy  # it imports its parts when they are first used
from pydantic import Field

from mirdrake.core.compiled import compiled
from mirdrake.core.errors import WorldError
from mirdrake.core.yaml_io import Length, Schema, where
from mirdrake.ground.terrain import Grid, LayerSource
from mirdrake.worlds.networks.network import Network
from mirdrake.worlds.pieces import Array
from mirdrake.worlds.tracks import Track

_MARGIN = 30.0  # [m] of the grid beyond the lanes
_MOST = 4_000_000  # nodes of the grid
_NEAR, _STEP = 1.0, 0.5  # [m] lanes that are so close in the plane have the same height within this


CELLS = (1.0, 2.0, 5.0, 10.0, 20.0)
"""Spacings of the grid for maps of any size [m]."""


def fitting_cell(network: Network) -> float:
    """Return the smallest of :data:`CELLS` [m] with which the grid is not too large."""
    points, _ = _points(network)
    return next((cell for cell in CELLS if math.prod(_size(points, cell)) <= _MOST), CELLS[-1])


class NetworkRelief(Schema):
    """Heights of the road network, linear between its lanes, constant beyond them."""

    cell: Annotated[Length, Field(ge=0.1, le=20.0)] = Field(default=1.0, description="spacing of the grid [m]")

    def make(self, tracks: Mapping[str, Track], folder: Path, network: Network | None) -> list[LayerSource]:  # noqa: ARG002
        """Return its layers.

        Raises:
            WorldError: the world has no network, it is too large, or lanes cross on a bridge.
        """
        if network is None:
            raise WorldError("the world has no network; add for example network: {xodr: town.xodr}", where=where(self))
        points, z = _points(network)
        _check_bridges(points, z, where(self))
        low = points.min(axis=0) - _MARGIN
        rows, columns = _size(points, self.cell)
        if rows * columns > _MOST:
            raise WorldError(
                f"{rows} x {columns} heights; allowed are {_MOST / 1e6:g} million; make cell larger", where=where(self)
            )
        x, y = np.meshgrid(low[0] + self.cell * np.arange(columns), low[1] + self.cell * np.arange(rows))
        heights = scipy.interpolate.griddata(points, z, (x, y), method="linear")
        # Linear interpolation ends at the convex hull of the lanes; beyond it the nearest height continues.
        order = np.lexsort((points[:, 1], points[:, 0]))
        compiled(fill_from_nearest, parts=())(points[order] - low, z[order], self.cell, heights)
        return [Grid(heights, self.cell, float(low[0]), float(low[1]))]


def _size(points: Array, cell: float) -> tuple[int, int]:
    """Return the number of rows and columns of the grid around points (N, 2) [m]."""
    low, high = points.min(axis=0) - _MARGIN, points.max(axis=0) + _MARGIN
    width, height = (high - low).tolist()
    return math.ceil(height / cell) + 1, math.ceil(width / cell) + 1


def _points(network: Network) -> tuple[Array, Array]:
    """Return nodes of all centre lines and edges, N x 2 [m], and their heights [m], N."""
    places: list[Array] = []
    heights: list[Array] = []
    for lane in network.lanes.values():
        bank = lane.bank if len(lane.bank) else np.zeros_like(lane.s)
        # Edges as well as centre lines, so that the surface follows the banking of each lane.
        for side in (0.5, 0.0, -0.5):
            places.append(np.column_stack(lane.pose(lane.s, side * lane.width)[:2]))
            heights.append(lane.z + side * lane.width * bank)
    points, z = np.vstack(places), np.concatenate(heights)
    # Neighbours share their edges: equal points would make the triangulation degenerate.
    _, indices = np.unique(np.round(points, 3), axis=0, return_index=True)
    return points[indices], z[indices]


def _check_bridges(points: Array, z: Array, place: str) -> None:
    """Check that lanes that meet in the plane have the same height.

    Raises:
        WorldError: they have not.
    """
    if (bridge := _highest_bridge(points, z)) is not None:
        raise WorldError(
            f"{bridge}; the ground is one surface, without bridges: leave the layer out, or remove a road from the map",
            where=place,
        )


def fill_from_nearest(points: Array, z: Array, cell: float, heights: Array) -> None:
    """Replace the heights of a grid that are not numbers by that of the nearest point.

    In a row at y, the square of the distance of a point P from x is x² - 2 x px + c, with c = px² + (y - py)². Without
    x², these are straight lines, and the nearest points those of their lower envelope from left to right (after
    P. Felzenszwalb, D. Huttenlocher, Distance transforms of sampled functions, Theory of Computing 8, 2012). This is
    ten times faster than a search tree, as most nodes are far from the points.

    Args:
        points: in ascending order of x, relative to the first node (n, 2) [m].
        z: their heights (n) [m].
        cell: spacing of the nodes [m].
        heights: of the nodes (rows, columns) [m]; changed.
    """
    # Points of the envelope, their c, and where each begins to be the nearest one.
    chosen, offset, begin = np.empty(len(points), np.int64), np.empty(len(points)), np.empty(len(points))
    rows, columns = heights.shape
    for row in range(rows):
        if not np.isnan(heights[row]).any():
            continue
        y, count = row * cell, 0
        for i in range(len(points)):
            px, c = points[i, 0], points[i, 0] ** 2 + (y - points[i, 1]) ** 2
            # Of points with the same x only the nearest one counts.
            if count > 0 and points[chosen[count - 1], 0] == px:
                if c >= offset[count - 1]:
                    continue
                count -= 1
            start = -math.inf
            while count > 0:
                start = (c - offset[count - 1]) / (2.0 * (px - points[chosen[count - 1], 0]))
                if start > begin[count - 1]:
                    break
                count -= 1
                start = -math.inf
            chosen[count], offset[count], begin[count] = i, c, start
            count += 1
        k = 0
        for column in range(columns):
            while k + 1 < count and begin[k + 1] < column * cell:
                k += 1
            if math.isnan(heights[row, column]):
                heights[row, column] = z[chosen[k]]


def find_bridge(network: Network) -> str | None:
    """Return where lanes that meet in the plane have different heights, as a clause; None: nowhere."""
    return _highest_bridge(*_points(network))


def _highest_bridge(points: Array, z: Array) -> str | None:
    pairs = scipy.spatial.cKDTree(points).query_pairs(_NEAR, output_type="ndarray")
    step = np.abs(z[pairs[:, 0]] - z[pairs[:, 1]]) if len(pairs) else np.zeros(1)
    if step.max() <= _STEP:
        return None
    x, y = points[pairs[int(step.argmax()), 0]]
    return f"lanes at ({x:.4g}, {y:.4g}) m differ in height by {step.max():.3g} m"
