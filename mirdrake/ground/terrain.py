"""Terrain: a stack of layers as one compiled function of the position.

::

    Plane, Grid, Block, Wave, Road, Slab ──► Terrain ── at(x, y) ──► height, normal
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, sin, sqrt
from typing import Any, NamedTuple, Protocol

import numpy as np
import scipy  # it imports its parts when they are first used
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely.geometry.base import BaseGeometry

from mirdrake.core.compiled import compiled, records
from mirdrake.core.errors import WorldError
from mirdrake.ground.layers import (
    BILINEAR,
    BLOCK,
    GROUND_PARTS,
    PLANE,
    SLAB,
    SPLINE,
    STATION,
    TRACK,
    WAVE,
    Layer,
    TerrainData,
    heights_at,
)
from mirdrake.ground.rays import RAY_PARTS, refine_hits

Array = NDArray[np.float64]

SAMPLES = 65
"""Samples of the ground along a wheel on uneven ground: one every 9 mm for a wheel with a radius of 0.3 m. Steep
faces should be longer than this, so that the force changes smoothly."""

FACE = 0.01
"""Shortest face of a slab [m]: a wheel is sampled every 9 mm."""

_CELL = 8.0  # side of the cells in which the pieces of a road are indexed [m]
_SLAB_CELL, _SLAB_CELLS = 1.0, 250_000  # smallest side [m] and largest number of the cells of a slab
_LARGEST_GRID = 25_000_000  # nodes of a grid: 100 MB


class GroundPoint(NamedTuple):
    """Ground at a point.

    Attributes:
        z: height [m].
        normal: unit normal, upwards (3).
    """

    z: float
    normal: tuple[float, float, float]


class LayerSource(Protocol):
    """Description of a layer, which is packed into a terrain."""

    def pack(self, numbers: int, heights: int) -> tuple[Layer, Array, NDArray[np.float32]]:
        """Return the layer, its numbers and its heights, given how many there are before it."""


_NO_NUMBERS, _NO_HEIGHTS = np.empty(0), np.empty(0, np.float32)
_NO_LAYERS = TerrainData(records(Layer, []), _NO_NUMBERS, _NO_HEIGHTS)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Plane:
    """Inclined plane.

    Attributes:
        z: height at the origin of the world [m].
        slope_x: rise over run along x [1].
        slope_y: the same along y [1].
    """

    z: float = 0.0
    slope_x: float = 0.0
    slope_y: float = 0.0

    def pack(self, numbers: int, heights: int) -> tuple[Layer, Array, NDArray[np.float32]]:  # noqa: ARG002, D102
        return Layer(PLANE, a=self.z, b=self.slope_x, c=self.slope_y), _NO_NUMBERS, _NO_HEIGHTS


@dataclass(frozen=True)
class Grid:
    """Grid of heights.

    Attributes:
        z: heights [m], rows along y, columns along x.
        cell: spacing [m].
        x: position of the first node in the world [m].
        y: the same.
        yaw: direction of the rows [rad].
        smooth: cubic B-spline; otherwise bilinear.
        periodic: the grid repeats; otherwise its edges continue outwards.
        local: a bilinear grid ends at its edges, with height zero outside.
    """

    z: NDArray[Any]
    cell: float
    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0
    smooth: bool = True
    periodic: bool = False
    local: bool = False

    def pack(self, numbers: int, heights: int) -> tuple[Layer, Array, NDArray[np.float32]]:  # noqa: ARG002, D102
        # The compiled evaluation reads the grid without checks.
        z = np.asarray(self.z, dtype=float)
        if z.ndim != 2 or min(z.shape) < 2 or z.size > _LARGEST_GRID or not np.isfinite(z).all():
            raise WorldError(
                f"grid of heights: shape {z.shape}; it must have at least 2 rows and 2 columns and at most 25 million "
                "values, all finite"
            )
        if self.smooth:  # the spline passes through the heights; its coefficients are heights with a prefilter
            z = scipy.ndimage.spline_filter(z, order=3, mode="grid-wrap" if self.periodic else "mirror")
        layer = Layer(
            SPLINE if self.smooth else BILINEAR,
            first=heights,
            rows=z.shape[0],
            columns=z.shape[1],
            periodic=int(self.periodic),
            local=int(self.local),
            x=self.x,
            y=self.y,
            cosine=cos(self.yaw),
            sine=sin(self.yaw),
            cell=self.cell,
        )
        return layer, _NO_NUMBERS, z.astype(np.float32).ravel()


@dataclass(frozen=True)
class Block:
    """Straight obstacle or hollow: a rise, a flat top and a fall, along its own x axis.

    Attributes:
        height: height of the top [m]; negative: a hollow.
        rise: length of the rise [m].
        top: length of the top [m].
        fall: length of the fall [m].
        width: width of the full height [m], the middle on the x axis.
        side: length of the faces at both sides [m].
        x: start of the rise in the world [m].
        y: the same.
        yaw: direction [rad].
    """

    height: float
    rise: float
    top: float
    fall: float
    width: float
    side: float
    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0

    def pack(self, numbers: int, heights: int) -> tuple[Layer, Array, NDArray[np.float32]]:  # noqa: ARG002, D102
        return _obstacle(self, BLOCK, a=self.height, b=self.rise, c=self.top, d=self.fall)


@dataclass(frozen=True)
class Wave:
    """Obstacle of the form height (1 - cos(2 π u / length)) / 2; attributes as in :class:`Block`."""

    height: float
    length: float
    width: float
    side: float
    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0

    def pack(self, numbers: int, heights: int) -> tuple[Layer, Array, NDArray[np.float32]]:  # noqa: ARG002, D102
        return _obstacle(self, WAVE, a=self.height, b=self.length)


def _obstacle(
    obstacle: Block | Wave, kind: int, *, a: float, b: float, c: float = 0.0, d: float = 0.0
) -> tuple[Layer, Array, NDArray[np.float32]]:
    """Return the layer of an obstacle; a to d are the numbers of its profile."""
    x, y, yaw, half = obstacle.x, obstacle.y, obstacle.yaw, 0.5 * obstacle.width
    layer = Layer(kind, x=x, y=y, cosine=cos(yaw), sine=sin(yaw), a=a, b=b, c=c, d=d, e=half, f=obstacle.side)
    return layer, _NO_NUMBERS, _NO_HEIGHTS


@dataclass(frozen=True)
class Kerb:
    """Kerb along a road.

    Attributes:
        left: whether the kerb is on the left of the road; otherwise it is on the right.
        height: [m].
        face: length of each face across the road [m].
        top: width of its top [m].
        begin: start along the road [m].
        end: end along the road [m].
    """

    left: bool
    height: float
    face: float
    top: float
    begin: float = -np.inf
    end: float = np.inf


@dataclass(frozen=True)
class Table:
    """Heights of a road above its centre line and banking, bilinear.

    Attributes:
        z: heights [m], rows along the road from its start, columns from right to left.
        step: spacing of the rows [m].
        right: lateral position of the first column, positive to the left [m].
        width: spacing of the columns [m].
    """

    z: NDArray[Any]
    step: float
    right: float
    width: float


@dataclass(frozen=True)
class Road:
    """Road along a centre line with height and banking.

    Attributes:
        s: stations along the centre line [m] (N), rising.
        x: x of the centre line [m] (N).
        y: the same (N).
        yaw: heading of the centre line [rad] (N).
        z: height of the centre line [m] (N).
        slope: dz/ds [1] (N).
        bank: rise to the left over distance [1] (N): positive where the left edge is higher.
        bank_slope: its derivative [1/m] (N).
        left: distance of the left edge [m] (N).
        right: distance of the right edge [m] (N).
        closed: the last station is the first one.
        shoulder: width beside the edges that continues the surface of the road [m].
        embankment: length beyond the shoulder over which the road blends into the ground [m].
        kerb: a kerb beside it.
        blends: False adds the kerb only.
        table: heights above centre line and banking.
    """

    s: Array
    x: Array
    y: Array
    yaw: Array
    z: Array
    slope: Array
    bank: Array
    bank_slope: Array
    left: Array
    right: Array
    closed: bool = False
    shoulder: float = 1.0
    embankment: float = 10.0
    kerb: Kerb | None = None
    blends: bool = True
    table: Table | None = None

    def pack(self, numbers: int, heights: int) -> tuple[Layer, Array, NDArray[np.float32]]:  # noqa: D102
        pose = (self.s, self.x, self.y, np.cos(self.yaw), np.sin(self.yaw))
        shape = (self.z, self.slope, self.bank, self.bank_slope, self.left, self.right)
        stations = np.column_stack((*pose, *shape))
        assert stations.shape[1] == STATION

        # The index must cover everything that the road changes: the embankment, or a kerb that is wider.
        kerb = self.kerb
        beside = self.shoulder + self.embankment if self.blends else 0.0
        reach = float(max(self.left.max(), self.right.max())) + max(beside, kerb.top + 2.0 * kerb.face if kerb else 0.0)
        index, origin, size = _index(stations[:, 1:3], reach, numbers + stations.size)
        layer = Layer(
            TRACK,
            first=numbers,
            rows=len(stations),
            periodic=int(self.closed),
            x=origin[0],
            y=origin[1],
            cell=_CELL,
            a=self.embankment,
            b=self.shoulder,
            blends=int(self.blends),
            cells=numbers + stations.size,
            cells_x=size[0],
            cells_y=size[1],
        )
        grid = _NO_HEIGHTS
        if self.table is not None:
            table = self.table
            grid = np.asarray(table.z, dtype=np.float32).ravel()
            layer = layer._replace(
                table=heights,
                table_rows=table.z.shape[0],
                table_columns=table.z.shape[1],
                table_step=table.step,
                table_right=table.right,
                table_width=table.width,
            )
        if kerb is not None:
            layer = layer._replace(
                c=kerb.height, d=kerb.face, e=kerb.top, f=1.0 if kerb.left else -1.0, g=kerb.begin, h=kerb.end
            )
        return layer, np.concatenate([stations.ravel(), index]), grid


@dataclass(frozen=True)
class Slab:
    """Paved area above the ground beside it, which is lower by the thickness of the slab; its top has the height 0.

    Attributes:
        area: polygons in the world [m].
        thickness: height of its top above the ground beside it [m].
    """

    area: BaseGeometry
    thickness: float

    @property
    def face(self) -> float:
        """Length of the face at its edge [m]: 45 degrees, or less if that were shorter than :data:`FACE`."""
        return max(self.thickness, FACE)

    def pack(self, numbers: int, heights: int) -> tuple[Layer, Array, NDArray[np.float32]]:  # noqa: ARG002, D102
        segments = _segments(self.area)
        index, origin, cell, size = _slab_index(self.area, segments, self.face, numbers)
        layer = Layer(
            SLAB,
            first=numbers,
            rows=len(segments),
            x=origin[0],
            y=origin[1],
            cell=cell,
            a=self.thickness,
            b=self.face,
            cells=numbers + segments.size,
            cells_x=size[0],
            cells_y=size[1],
        )
        return layer, np.concatenate([segments.ravel(), index]), _NO_HEIGHTS


def _segments(area: BaseGeometry) -> Array:
    """Return the segments of the outline of polygons, x0, y0, x1, y1 (N, 4) [m], with the area on their left."""
    parts = shapely.get_parts(shapely.orient_polygons(area))
    rings = [shapely.get_coordinates(ring) for part in parts for ring in (part.exterior, *part.interiors)]
    segments = np.concatenate([np.hstack([ring[:-1], ring[1:]]) for ring in rings])
    return np.asarray(segments[np.any(segments[:, :2] != segments[:, 2:], axis=1)])


def _slab_index(
    area: BaseGeometry, segments: Array, face: float, first: int
) -> tuple[Array, tuple[float, float], float, tuple[int, int]]:
    """Return the index of the segments of a slab by cells.

    Args:
        area: the slab.
        segments: of its outline (N, 4) [m].
        face: length of its face [m].
        first: index of the first number of the segments among all numbers.

    Returns:
        The numbers: for each cell where its list begins, and where the last one ends, then for each cell whether its
        centre is outside, then the lists of segments; the origin and the side of the cells [m]; their numbers along x
        and y.
    """
    bounds = np.asarray(area.bounds) + np.array([-face, -face, face, face])
    low, sides = bounds[:2], bounds[2:] - bounds[:2]
    cell = max(_SLAB_CELL, sqrt(float(sides.prod()) / _SLAB_CELLS))
    nx, ny = (int(n) for n in np.ceil(sides / cell))
    centres = low + cell * (np.stack(np.meshgrid(np.arange(nx), np.arange(ny)), axis=-1).reshape(-1, 2) + 0.5)
    shapely.prepare(area)
    outside = ~shapely.contains_xy(area, centres)

    # Triangle inequality: no point of a cell is farther than `half` from its centre, so that the segment nearest to the
    # point is at most twice that farther from the centre than the one nearest to the centre.
    half = cell / sqrt(2.0)
    points = shapely.points(centres)
    lines: Any = shapely.linestrings(segments.reshape(-1, 2, 2))
    tree = shapely.STRtree(lines)
    (near, _), distances = tree.query_nearest(points, max_distance=face + half, return_distance=True, all_matches=False)
    which, found = tree.query(points[near], predicate="dwithin", distance=distances + 2.0 * half)
    owners = near[which]
    order = np.lexsort((found, owners))
    counts = np.bincount(owners, minlength=nx * ny)
    begins = first + segments.size + 2 * nx * ny + 1 + np.concatenate([[0], np.cumsum(counts)])
    lists = first + segments.shape[1] * found[order]
    return (
        np.concatenate([begins, outside, lists]).astype(float),
        (float(low[0]), float(low[1])),
        cell,
        (nx, ny),
    )


def _index(points: Array, reach: float, first: int) -> tuple[Array, tuple[float, float], tuple[int, int]]:
    """Return the index of the pieces of a centre line by cells.

    Args:
        points: stations [m] (N, 2).
        reach: distance to both sides that the road covers [m].
        first: index of the first number of the result among all numbers.

    Returns:
        The numbers: for each cell where its list begins, and where the last one ends, then the lists; the origin of
        the cells [m]; their numbers along x and y.
    """
    low, high = points.min(axis=0) - reach, points.max(axis=0) + reach
    nx, ny = (int(n) for n in np.ceil((high - low) / _CELL))
    # Half of the length of each chord: no point of a piece is farther than this from its middle.
    ends = np.hypot(*np.diff(points, axis=0).T) / 2.0
    middles = 0.5 * (points[1:] + points[:-1])
    # A piece is listed in a cell if it may be the nearest one to a point in it, within the reach.
    tree = scipy.spatial.cKDTree(middles)
    # Half of the diagonal of a cell, the largest distance of one of its points from its centre.
    half, longest = _CELL / np.sqrt(2.0), float(ends.max())
    centres = low + _CELL * (np.stack(np.meshgrid(np.arange(nx), np.arange(ny)), axis=-1).reshape(-1, 2) + 0.5)
    nearest, _ = tree.query(centres)
    # Triangle inequality: another piece can only be nearest within twice both half lengths of the nearest middle.
    within = np.where(nearest > reach + half + longest, 0.0, nearest + 2.0 * (half + longest))
    lists = tree.query_ball_point(centres, within)

    # Sorted, so that ties in `_foot` go to the first piece; outside of the reach the list is empty.
    lists = [sorted(pieces) if radius > 0.0 else [] for pieces, radius in zip(lists, within, strict=True)]
    # The lists follow one number per cell and one more, the end of the last list.
    begins = first + len(lists) + 1 + np.concatenate([[0], np.cumsum([len(pieces) for pieces in lists])])
    flat = [float(piece) for pieces in lists for piece in pieces]
    return np.concatenate([begins.astype(float), flat]), (float(low[0]), float(low[1])), (nx, ny)


class Terrain:
    """Height and slope of the ground.

    Args:
        sources: the layers, the lowest one first; none: the plane z = 0.

    Attributes:
        data: numbers of its layers, for compiled functions.
        flat: whether the ground is the plane z = 0.
        even: whether the ground is a plane of any inclination.
        samples: number of samples along a wheel that tyres need: zero on a plane.
    """

    def __init__(self, sources: Sequence[LayerSource] = ()) -> None:
        self.flat = not sources
        self.even = all(isinstance(source, Plane) for source in sources)
        self.samples = 0 if self.even else SAMPLES
        self.data = _pack(sources, _NO_LAYERS)

    def with_layers(self, sources: Sequence[LayerSource]) -> "Terrain":
        """Return this terrain with further layers above it; both share the heights in memory."""
        result = Terrain()
        result.flat = self.flat and not sources
        result.even = self.even and all(isinstance(source, Plane) for source in sources)
        result.samples = 0 if result.even else SAMPLES
        result.data = _pack(sources, self.data)
        # The heights of this terrain are the first ones of the other.
        self.data = self.data._replace(heights=result.data.heights[: self.data.heights.size])
        return result

    @property
    def nbytes(self) -> int:
        """Memory of the terrain [B]."""
        return int(self.data.numbers.nbytes + self.data.heights.nbytes)

    def at(self, x: float, y: float) -> GroundPoint:
        """Return height and normal at a point of the world [m]."""
        z, zx, zy = self.slopes(x, y).tolist()
        norm = sqrt(1.0 + zx * zx + zy * zy)
        return GroundPoint(z, (-zx / norm, -zy / norm, 1.0 / norm))

    def height(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the heights [m] at points of the world [m], any shape."""
        return self.slopes(x, y)[..., 0]

    def slopes(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return height [m] and slopes along x and y [1] at points of the world [m] of any shape (..., 3)."""
        x, y = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
        result = np.zeros((x.size, 3))
        if not self.flat:
            # Copies: a broadcast view is read-only and perhaps not contiguous, which is another type for compiled code.
            compiled(heights_at, parts=GROUND_PARTS)(self.data, x.ravel().copy(), y.ravel().copy(), result)
        return result.reshape(*x.shape, 3)

    def refine_hits(self, starts: Array, directions: Array, distances: Array) -> None:
        """Move hits of rays on a mesh of the ground to the ground; see :func:`mirdrake.ground.rays.refine_hits`."""
        compiled(refine_hits, parts=RAY_PARTS)(self.data, starts, directions, distances)


def _pack(sources: Sequence[LayerSource], below: TerrainData) -> TerrainData:
    """Return the numbers of layers above those of another terrain; the layers themselves are not kept."""
    layers: list[Layer] = []
    numbers, heights = [below.numbers], [below.heights]
    for source in sources:
        # Offsets into the joined arrays, which a layer stores as the index of its first number or height.
        counts = (sum(part.size for part in numbers), sum(part.size for part in heights))
        layer, more, grid = source.pack(*counts)
        layers.append(layer)
        numbers.append(more)
        heights.append(grid)
    joined = np.concatenate([np.asarray(below.layers), records(Layer, layers)])
    return TerrainData(joined, _join(numbers), _join(heights))  # type: ignore[arg-type]


def _join(parts: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Concatenate arrays; a single one with numbers is not copied, as a grid can be large."""
    filled = [part for part in parts if part.size]
    return filled[0] if len(filled) == 1 else np.concatenate(parts)


FLAT = Terrain()
"""The plane z = 0."""
