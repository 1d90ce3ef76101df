"""Layer `network` of a relief: the heights of the lanes of the road network, as one grid."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import numpy as np
import scipy  # it imports its parts when they are first used
from pydantic import Field

from mirdrake.core.errors import WorldError
from mirdrake.core.yaml_io import Length, Schema, where
from mirdrake.ground.terrain import Grid, LayerSource
from mirdrake.worlds.networks.network import Network
from mirdrake.worlds.pieces import Array
from mirdrake.worlds.tracks import Track

_MARGIN = 30.0  # [m] of the grid beyond the lanes
_MOST = 4_000_000  # nodes of the grid
_NEAR, _STEP = 1.0, 0.5  # [m] lanes that are so close in the plane have the same height within this


class NetworkRelief(Schema):
    """Heights of the road network, linear between its lanes, constant beyond them."""

    cell: Annotated[Length, Field(ge=0.1, le=20.0)] = Field(default=1.0, description="spacing of the grid [m]")

    def make(self, tracks: Mapping[str, Track], folder: Path, network: Network | None) -> list[LayerSource]:  # noqa: ARG002
        """Return its layers.

        Raises:
            WorldError: the world has no network, it is too large, or lanes cross on a bridge.
        """
        if network is None:
            raise WorldError(f"{where(self)}: the world has no network; add for example network: {{xodr: town.xodr}}")
        points, z = _points(network)
        _check_bridges(points, z, where(self))
        low, high = points.min(axis=0) - _MARGIN, points.max(axis=0) + _MARGIN
        columns, rows = (math.ceil(side / self.cell) + 1 for side in (high - low).tolist())
        if rows * columns > _MOST:
            raise WorldError(
                f"{where(self)}: {rows} x {columns} heights; allowed are {_MOST / 1e6:g} million; make cell larger"
            )
        x, y = np.meshgrid(low[0] + self.cell * np.arange(columns), low[1] + self.cell * np.arange(rows))
        heights = scipy.interpolate.griddata(points, z, (x, y), method="linear")
        # Linear interpolation ends at the convex hull of the lanes; beyond it the nearest height continues.
        outside = np.isnan(heights)
        nearest = scipy.spatial.cKDTree(points).query(np.column_stack((x[outside], y[outside])))[1]
        heights[outside] = z[nearest]
        return [Grid(heights, self.cell, float(low[0]), float(low[1]))]


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
    pairs = scipy.spatial.cKDTree(points).query_pairs(_NEAR, output_type="ndarray")
    step = np.abs(z[pairs[:, 0]] - z[pairs[:, 1]]) if len(pairs) else np.zeros(1)
    if step.max() > _STEP:
        x, y = points[pairs[int(step.argmax()), 0]]
        raise WorldError(
            f"{place}: lanes at ({x:.4g}, {y:.4g}) m differ in height by {step.max():.3g} m; the ground is one "
            "surface, without bridges: leave the layer out, or remove a road from the map"
        )
