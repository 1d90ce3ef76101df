"""Obstacles of a vehicle, and poses at which its bounding box is free: exactly, and quickly by a grid of distances."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from mirdrake.controllers.ackermann import Ackermann
from mirdrake.controllers.behaviours.outline import outline_of
from mirdrake.vehicles import Vehicle
from mirdrake.world_checks.overlaps import Neighbours
from mirdrake.worlds.clearance import Volume
from mirdrake.worlds.outlines import Outline, outlines_of

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Bounds = tuple[float, float, float, float]

_CELLS = 1.5e6  # of the grid of distances
_FINEST = 0.1  # [m] side of a cell


@dataclass(frozen=True)
class Body:
    """A vehicle for the search of paths: a box about its x axis, and a turning circle.

    Attributes:
        name: name of the vehicle.
        rear: x of its rear end in B [m].
        front: x of its front end in B [m].
        half_width: half of its width [m].
        height: height of its top [m].
        radius: smallest turning radius of the middle of its rear axle [m].
    """

    name: str
    rear: float
    front: float
    half_width: float
    height: float
    radius: float

    @classmethod
    def of(cls, vehicle: Vehicle, *, name: str = "") -> "Body":
        """Return the box of a vehicle's collision shapes, and its turning radius."""
        box, steering = outline_of(vehicle), Ackermann(vehicle.geometry)
        radius = steering.wheelbase / math.tan(steering.limit)
        return cls(name or vehicle.name, box.rear, box.front, box.half_width, box.height, radius)

    @property
    def text(self) -> str:
        """Its name and size, for messages."""
        return (
            f"{self.name} ({2.0 * self.half_width:.2f} m wide, {self.front - self.rear:.2f} m long, turning radius "
            f"{self.radius:.1f} m)"
        )

    def wider(self, margin: float) -> "Body":
        """Return the box with a margin [m] on all sides."""
        return replace(self, rear=self.rear - margin, front=self.front + margin, half_width=self.half_width + margin)

    def boxes(self, x: Array, y: Array, yaw: Array) -> NDArray[np.object_]:
        """Return its box at poses (n), as polygons in W."""
        return np.asarray(shapely.polygons(self.corners(x, y, yaw)))

    def corners(self, x: Array, y: Array, yaw: Array) -> Array:
        """Return the corners of its box at poses (n): (n, 4, 2) in W [m]."""
        ahead = np.array([self.rear, self.front, self.front, self.rear])
        left = np.array([-1.0, -1.0, 1.0, 1.0]) * self.half_width
        c, s = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
        return np.stack((x[:, None] + c * ahead - s * left, y[:, None] + s * ahead + c * left), axis=-1)


@dataclass(frozen=True)
class Obstacle:
    """A solid that is an obstacle: index of its prop, and its outline at the vehicle's heights."""

    prop: int
    outline: Outline


def obstacles_for(near: Neighbours, volume: Volume) -> list[Obstacle]:
    """Return the solids that a vehicle cannot pass over or below, cut at its heights."""
    return [
        obstacle for index in range(len(near.props)) for obstacle in obstacles_of(near, index, volume.low, volume.high)
    ]


def obstacles_of(near: Neighbours, index: int, low: float, high: float) -> list[Obstacle]:
    """Return the solids of one prop between two heights [m]."""
    placed = near.props[index]
    if placed.prop.driven_over or placed.top <= low or placed.bottom >= high:
        return []
    return [Obstacle(index, solid) for solid in outlines_of(placed, low, high)]


class Room:
    """Free space of a vehicle among obstacles.

    Args:
        obstacles: the obstacles.
        extent: extent of the ground: smallest x, y, largest x, y [m].
        body: the vehicle, with its margin.
        around: points that the grid must cover, (n, 2) in W [m], with room to pass and turn around them and obstacles.
    """

    def __init__(self, obstacles: Sequence[Obstacle], extent: Bounds, body: Body, around: Array) -> None:
        self.obstacles, self.body = obstacles, body
        self.areas = [obstacle.outline.area for obstacle in obstacles]
        self._tree = shapely.STRtree(self.areas)
        # Room to turn around beyond the outermost obstacle.
        beyond = 4.0 * body.radius + 2.0 * (body.front - body.rear)
        boxes = np.vstack([shapely.bounds(self.areas).reshape(-1, 4), np.tile(around, 2)])
        low, high = boxes[:, :2].min(axis=0) - beyond, boxes[:, 2:].max(axis=0) + beyond
        self.low: Array = np.maximum(low, extent[:2])
        self.high: Array = np.minimum(high, extent[2:])
        self.cell = max(_FINEST, 0.05 * body.half_width, math.sqrt(float(np.prod(self.high - self.low)) / _CELLS))

    @cached_property
    def domain(self) -> BaseGeometry:
        """The rectangle in which the body must stay."""
        return shapely.box(*self.low, *self.high)

    @cached_property
    def distance(self) -> Array:
        """Distances of the cells of the grid (y, x) from obstacles and the domain's edge [m], accurate to 1.5 cells."""
        from scipy.ndimage import distance_transform_edt

        nx, ny = (int(n) for n in np.ceil((self.high - self.low) / self.cell))
        free = np.zeros((ny + 2, nx + 2), dtype=bool)  # with a border that is not free
        free[1:-1, 1:-1] = True
        # Half the diagonal of a cell: no cell that an obstacle touches is free.
        reach = self.cell * math.sqrt(0.5)
        for area in self.areas:
            grown = area.buffer(reach, 2)
            xmin, ymin, xmax, ymax = grown.bounds
            i, k = (max(0, int(n)) for n in ((xmin - self.low[0]) / self.cell, (ymin - self.low[1]) / self.cell))
            j, m = (int(n) + 1 for n in ((xmax - self.low[0]) / self.cell, (ymax - self.low[1]) / self.cell))
            j, m = min(j, nx), min(m, ny)
            if i >= j or k >= m:
                continue
            xs = self.low[0] + (np.arange(i, j) + 0.5) * self.cell
            ys = self.low[1] + (np.arange(k, m) + 0.5) * self.cell
            shapely.prepare(grown)
            free[k + 1 : m + 1, i + 1 : j + 1] &= ~shapely.contains_xy(grown, *np.meshgrid(xs, ys))
        return np.asarray(self.cell * distance_transform_edt(free)[1:-1, 1:-1])

    def clearance(self, x: Array, y: Array) -> Array:
        """Return the distances of points from obstacles and the edge [m], accurate to 1.5 cells; 0 outside."""
        ny, nx = self.distance.shape
        i = np.floor((x - self.low[0]) / self.cell).astype(np.int64)
        k = np.floor((y - self.low[1]) / self.cell).astype(np.int64)
        inside = (i >= 0) & (i < nx) & (k >= 0) & (k < ny)
        return np.where(inside, self.distance[np.clip(k, 0, ny - 1), np.clip(i, 0, nx - 1)], 0.0)

    def is_free(self, x: Array, y: Array, yaw: Array) -> Flags:
        """Return whether the vehicle is free at poses (n).

        Discs on the grid of distances decide clear cases; close ones are tested with the box itself.
        """
        body = self.body
        length = body.front - body.rear
        # Discs along the box, each for a piece shorter than it is wide.
        count = max(1, math.ceil(length / (1.2 * body.half_width)))
        places = body.rear + length * (np.arange(count) + 0.5) / count
        c, s = np.cos(yaw), np.sin(yaw)
        clear = np.array([self.clearance(x + c * ahead, y + s * ahead) for ahead in places])
        # Discs around the pieces cover the box: if all are free, so is the box.
        free = clear.min(axis=0) > math.hypot(body.half_width, 0.5 * length / count) + 1.5 * self.cell
        inner = np.minimum(body.half_width, np.minimum(places - body.rear, body.front - places))  # discs in the box
        # Only poses between the two tests need the exact one.
        close = np.flatnonzero(~free & (clear > inner[:, None] - 3.0 * self.cell).all(axis=0))
        if len(close):
            free[close] = self.fits(x[close], y[close], yaw[close])
        return np.asarray(free)

    def fits(self, x: Array, y: Array, yaw: Array) -> Flags:
        """Return whether the box is free at poses (n), exactly."""
        corners = self.body.corners(x, y, yaw)
        free = np.asarray(((corners >= self.low) & (corners <= self.high)).all(axis=(1, 2)))
        hit, _ = self._tree.query(shapely.polygons(corners), predicate="intersects")
        free[hit] = False
        return free
