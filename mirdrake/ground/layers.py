"""Height and slope of the ground from its layers; :mod:`mirdrake.core.compiled` compiles the functions.

The layers are evaluated in their order. Each adds a height to the sum of those before it; only a road (`TRACK`)
replaces this sum, near its centre line. All derivatives are exact, except that the banking of a road ignores how its
normal turns across the blended embankment.

A grid is interpolated bilinearly or by cubic B-splines, whose second derivative is continuous; the coefficients of a
spline are computed when the layer is made, so that it passes through all heights (M. Unser, Splines: a perfect fit for
signal and image processing, IEEE Signal Processing Magazine 16 (6), 1999).
"""

from collections.abc import Sequence
from math import floor, hypot
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

PLANE, BILINEAR, SPLINE, BLOCK, WAVE, TRACK, SLAB = range(7)
"""Kinds of layers."""

STATION = 11
"""Numbers of each station of a road: s, x, y, tangent (2), height and slope, banking and its slope, left and right
width."""

_NEWTON = 2  # iterations for the foot on a centre line; the chord is a good start
_BEYOND = 0.25  # parameter by which a piece of a centre line may be extrapolated [1]


class Layer(NamedTuple):
    """Layer of the ground; which of the fields it uses depends on its kind.

    Attributes:
        kind: one of PLANE, BILINEAR, SPLINE, BLOCK, WAVE, TRACK, SLAB.
        first: index of its first number in `numbers`, or of its first height in `heights`.
        rows: number of grid rows (along y); of stations of a road.
        columns: number of grid columns (along x).
        periodic: whether a grid repeats; if not, its edge heights continue outwards. Of a road: whether it is closed.
        local: whether a grid ends at its edges, with height zero outside.
        x: origin in the world [m].
        y: the same.
        cosine: direction of the local x axis.
        sine: the same.
        cell: spacing of a grid [m]; of a road or slab: side of the cells of its index.
        a: height of a plane at the world's origin, of a block or a wave [m]; length of a road's embankment [m];
            thickness of a slab [m].
        b: slope of a plane along x; length of the rise of a block, of a wave [m]; shoulder of a road [m]; length of a
            slab's face [m].
        c: slope of a plane along y; length of the top of a block [m]; height of a road's kerb [m].
        d: length of the fall of a block [m]; length of the kerb's face across the road [m].
        e: half of the width of a block or wave [m]; width of the kerb's top [m].
        f: length of the side faces of a block or wave [m]; side of the kerb: 1 left, -1 right, 0 no kerb.
        g: start of the kerb along the road [m].
        h: end of the kerb [m].
        blends: whether a road replaces the height of the layers before it; if not, it only adds its kerb.
        cells: index in `numbers` of the cells of a road or slab.
        cells_x: number of cells along x.
        cells_y: the same along y.
        table: of a road with a table of heights: index of the first one in `heights`.
        table_rows: number of its rows along the road; 0: no table.
        table_columns: number of its columns, from right to left.
        table_step: spacing of the rows [m].
        table_right: lateral position of the first column [m].
        table_width: spacing of the columns [m].
    """

    kind: int
    first: int = 0
    rows: int = 0
    columns: int = 0
    periodic: int = 0
    local: int = 0
    x: float = 0.0
    y: float = 0.0
    cosine: float = 1.0
    sine: float = 0.0
    cell: float = 1.0
    a: float = 0.0
    b: float = 0.0
    c: float = 0.0
    d: float = 0.0
    e: float = 0.0
    f: float = 0.0
    g: float = 0.0
    h: float = 0.0
    blends: int = 0
    cells: int = 0
    cells_x: int = 0
    cells_y: int = 0
    table: int = 0
    table_rows: int = 0
    table_columns: int = 0
    table_step: float = 1.0
    table_right: float = 0.0
    table_width: float = 1.0


class TerrainData(NamedTuple):
    """Numbers of a terrain, for compiled functions.

    Attributes:
        layers: records of :class:`Layer`, or the tuples.
        numbers: stations and indices of roads.
        heights: heights or spline coefficients of the grids [m], single precision.
    """

    layers: Sequence[Any]
    numbers: npt.NDArray[np.float64]
    heights: npt.NDArray[np.float32]


def ground_at(terrain: TerrainData, x: float, y: float) -> tuple[float, float, float]:
    """Return the height [m] of the ground and its slopes along x and y [1] at a point of the world [m]."""
    z, zx, zy = 0.0, 0.0, 0.0
    for i in range(len(terrain.layers)):
        z, zx, zy = _with_layer(terrain, terrain.layers[i], x, y, z, zx, zy)
    return z, zx, zy


def _with_layer(
    terrain: TerrainData, layer: Any, x: float, y: float, z: float, zx: float, zy: float
) -> tuple[float, float, float]:
    """Return height and slopes with a further layer on those of the layers below it."""
    kind = layer.kind
    if kind == PLANE:
        return z + layer.a + layer.b * x + layer.c * y, zx + layer.b, zy + layer.c
    if kind == TRACK:
        return _on_track(terrain, layer, x, y, z, zx, zy)
    if kind == SLAB:
        lower, lower_x, lower_y = _slab(terrain.numbers, layer, x, y)
        return z + lower, zx + lower_x, zy + lower_y
    # Local axes, height and slopes in them.
    dx, dy = x - layer.x, y - layer.y
    u, v = layer.cosine * dx + layer.sine * dy, layer.cosine * dy - layer.sine * dx
    height, along, across = 0.0, 0.0, 0.0
    if kind in (BLOCK, WAVE):
        height, along, across = _feature(layer, u, v)
    elif kind == BILINEAR:
        height, along, across = _bilinear(terrain.heights, layer, u, v)
    else:
        height, along, across = _spline(terrain.heights, layer, u, v)

    # Slopes turn with the axes of the layer, (u, v) to (x, y); heights and slopes of layers add up.
    return (
        z + height,
        zx + (layer.cosine * along - layer.sine * across),
        zy + (layer.sine * along + layer.cosine * across),
    )


def ground_heights(
    terrain: TerrainData,
    x: float,
    y: float,
    ex: float,
    ey: float,
    places: npt.NDArray[np.float64],
    begin: int,
    end: int,
    heights: npt.NDArray[np.float64],
) -> None:
    """Compute the heights of :func:`ground_at` along a line, up to rounding, in a fifth of the time for splines.

    Args:
        terrain: the ground.
        x: start of the line in the world [m].
        y: the same.
        ex: its direction.
        ey: the same.
        places: positions along it [m].
        begin: index of the first position that is used.
        end: index after the last one.
        heights: overwritten from `begin` to `end`.
    """
    for k in range(begin, end):
        heights[k] = 0.0
    for i in range(len(terrain.layers)):
        layer = terrain.layers[i]
        if layer.kind == SPLINE:
            _add_spline(terrain.heights, layer, x, y, ex, ey, places, begin, end, heights)
            continue
        for k in range(begin, end):
            # The height does not depend on the slopes below.
            heights[k] = _with_layer(terrain, layer, x + places[k] * ex, y + places[k] * ey, heights[k], 0.0, 0.0)[0]


def heights_at(
    terrain: TerrainData, x: npt.NDArray[np.float64], y: npt.NDArray[np.float64], out: npt.NDArray[np.float64]
) -> None:
    """Compute height and slopes at points (N); `out` (N, 3) is overwritten."""
    for i in range(len(x)):
        out[i, 0], out[i, 1], out[i, 2] = ground_at(terrain, x[i], y[i])


# --- grids --------------------------------------------------------------------------------------------------------


def _node(index: int, count: int, periodic: int) -> int:
    """Return the index of a grid node: wrapped, or clamped to the edge."""
    if periodic != 0:
        return index % count
    return min(max(index, 0), count - 1)


def _bilinear(heights: npt.NDArray[np.float32], layer: Any, u: float, v: float) -> tuple[float, float, float]:
    column, row = u / layer.cell, v / layer.cell
    # A local grid is a patch on the ground: outside it adds nothing, while other grids continue their edge heights.
    if layer.local != 0 and not (0.0 <= column <= layer.columns - 1 and 0.0 <= row <= layer.rows - 1):
        return 0.0, 0.0, 0.0
    # The clamped coordinate is constant outside, so that its derivative must be zero there as well.
    inside_x, inside_y = 1.0, 1.0
    if layer.periodic == 0:
        inside_x, inside_y = _inside(column, layer.columns), _inside(row, layer.rows)
        column, row = min(max(column, 0.0), layer.columns - 1.0), min(max(row, 0.0), layer.rows - 1.0)
    i, j = floor(column), floor(row)
    p, q = column - i, row - j

    # Rows are along x: a row of the grid is `columns` numbers long.
    i0, i1 = _node(i, layer.columns, layer.periodic), _node(i + 1, layer.columns, layer.periodic)
    low = layer.first + _node(j, layer.rows, layer.periodic) * layer.columns
    high = layer.first + _node(j + 1, layer.rows, layer.periodic) * layer.columns
    z00, z10, z01, z11 = heights[low + i0], heights[low + i1], heights[high + i0], heights[high + i1]
    below, above = z00 + p * (z10 - z00), z01 + p * (z11 - z01)
    along = ((1.0 - q) * (z10 - z00) + q * (z11 - z01)) / layer.cell
    return below + q * (above - below), along * inside_x, (above - below) / layer.cell * inside_y


def _inside(node: float, count: int) -> float:
    """Return 1 within a grid, 0 outside, where its edge heights continue and the slope is zero."""
    return 1.0 if 0.0 <= node <= count - 1 else 0.0


def _spline(heights: npt.NDArray[np.float32], layer: Any, u: float, v: float) -> tuple[float, float, float]:
    column, row = u / layer.cell, v / layer.cell

    # As in `_bilinear`: constant heights outside, with zero slope.
    inside_x, inside_y = 1.0, 1.0
    if layer.periodic == 0:
        inside_x, inside_y = _inside(column, layer.columns), _inside(row, layer.rows)
        column, row = min(max(column, 0.0), layer.columns - 1.0), min(max(row, 0.0), layer.rows - 1.0)
    i, j = floor(column), floor(row)
    a0, a1, a2, a3, d0, d1, d2, d3 = _spline_weights(column - i)
    b0, b1, b2, b3, e0, e1, e2, e3 = _spline_weights(row - j)
    i0, i1, i2, i3 = _around(i, layer.columns, layer.periodic)
    j0, j1, j2, j3 = _around(j, layer.rows, layer.periodic)

    # Tensor product of the weights: four coefficients of each row along x, then the four rows along y.
    z, along, across = 0.0, 0.0, 0.0
    for k in range(4):
        # Scalars instead of arrays, which would be allocated for every sample of a wheel.
        start = layer.first + (j0 if k == 0 else (j1 if k == 1 else (j2 if k == 2 else j3))) * layer.columns
        c0, c1, c2, c3 = heights[start + i0], heights[start + i1], heights[start + i2], heights[start + i3]
        value = a0 * c0 + a1 * c1 + a2 * c2 + a3 * c3
        slope = d0 * c0 + d1 * c1 + d2 * c2 + d3 * c3
        weight = b0 if k == 0 else (b1 if k == 1 else (b2 if k == 2 else b3))
        change = e0 if k == 0 else (e1 if k == 1 else (e2 if k == 2 else e3))
        z += weight * value
        along += weight * slope
        across += change * value
    return z, along / layer.cell * inside_x, across / layer.cell * inside_y


def _add_spline(
    coefficients: npt.NDArray[np.float32],
    layer: Any,
    x: float,
    y: float,
    ex: float,
    ey: float,
    places: npt.NDArray[np.float64],
    begin: int,
    end: int,
    heights: npt.NDArray[np.float64],
) -> None:
    """Add the heights of a smooth grid along a line; arguments as in :func:`ground_heights`."""
    # Variables instead of fields: the loop writes to memory, so that LLVM would read the fields in each round.
    first, rows, columns, periodic = layer.first, layer.rows, layer.columns, layer.periodic
    dx, dy = x - layer.x, y - layer.y
    u, v = (layer.cosine * dx + layer.sine * dy) / layer.cell, (layer.cosine * dy - layer.sine * dx) / layer.cell
    du, dv = (layer.cosine * ex + layer.sine * ey) / layer.cell, (layer.cosine * ey - layer.sine * ex) / layer.cell
    if periodic != 0:
        # The periods at the start of the line, so that its other points need no modulo.
        u -= floor(u / columns) * columns
        v -= floor(v / rows) * rows
    # Powers of q for each power of p in the cell of the last point; neighbouring points mostly share it.
    i_last, j_last = -(1 << 60), 0
    c0, c1, c2, c3 = _NO_POWERS, _NO_POWERS, _NO_POWERS, _NO_POWERS
    for k in range(begin, end):
        column, row = u + places[k] * du, v + places[k] * dv
        if periodic == 0:
            column, row = min(max(column, 0.0), columns - 1.0), min(max(row, 0.0), rows - 1.0)
        i, j = floor(column), floor(row)
        if i != i_last or j != j_last:
            i_last, j_last = i, j
            at = _around(i, columns, periodic)
            j0, j1, j2, j3 = _around(j, rows, periodic)
            r0 = _row_powers(coefficients, first + j0 * columns, at)
            r1 = _row_powers(coefficients, first + j1 * columns, at)
            r2 = _row_powers(coefficients, first + j2 * columns, at)
            r3 = _row_powers(coefficients, first + j3 * columns, at)
            c0, c1 = _powers(r0[0], r1[0], r2[0], r3[0]), _powers(r0[1], r1[1], r2[1], r3[1])
            c2, c3 = _powers(r0[2], r1[2], r2[2], r3[2]), _powers(r0[3], r1[3], r2[3], r3[3])
        p, q = column - i, row - j
        z = c2[0] + q * (c2[1] + q * (c2[2] + q * c2[3])) + p * (c3[0] + q * (c3[1] + q * (c3[2] + q * c3[3])))
        z = c1[0] + q * (c1[1] + q * (c1[2] + q * c1[3])) + p * z
        heights[k] += c0[0] + q * (c0[1] + q * (c0[2] + q * c0[3])) + p * z


_Powers = tuple[float, float, float, float]
_NO_POWERS: _Powers = (0.0, 0.0, 0.0, 0.0)


def _row_powers(numbers: npt.NDArray[np.float32], start: int, at: tuple[int, int, int, int]) -> _Powers:
    """Return the cubic of a row of spline coefficients, of which those at four indices count."""
    i0, i1, i2, i3 = at
    # In double precision also for coefficients of single precision.
    return _powers(
        np.float64(numbers[start + i0]),
        np.float64(numbers[start + i1]),
        np.float64(numbers[start + i2]),
        np.float64(numbers[start + i3]),
    )


def _powers(a: float, b: float, c: float, d: float) -> _Powers:
    """Return the cubic of four coefficients of a uniform B-spline, in powers of the coordinate in the cell."""
    return (a + 4.0 * b + c) / 6.0, 0.5 * (c - a), 0.5 * (a + c) - b, (d - a + 3.0 * (b - c)) / 6.0


def _around(index: int, count: int, periodic: int) -> tuple[int, int, int, int]:
    """Return the indices of the four spline coefficients around a cell."""
    if periodic != 0:
        # A modulo takes as long as the sum of a row, and is rarely needed.
        own = index
        if own < 0 or own >= count:
            own = own % count
        right = own + 1 if own + 1 < count else 0
        return own - 1 if own > 0 else count - 1, own, right, right + 1 if right + 1 < count else 0
    return (
        _reflected(index - 1, count),
        _reflected(index, count),
        _reflected(index + 1, count),
        _reflected(index + 2, count),
    )


def _reflected(index: int, count: int) -> int:
    """Return the index of a spline coefficient, mirrored at the edge nodes as by the prefilter."""
    if index < 0:
        index = -index
    return index if index < count else max(2 * (count - 1) - index, 0)


def _spline_weights(t: float) -> tuple[float, float, float, float, float, float, float, float]:
    """Return the four weights of a uniform cubic B-spline at 0 <= t <= 1, and their derivatives."""
    r = 1.0 - t
    return (
        r * r * r / 6.0,
        (4.0 + t * t * (3.0 * t - 6.0)) / 6.0,
        (4.0 + r * r * (3.0 * r - 6.0)) / 6.0,
        t * t * t / 6.0,
        -0.5 * r * r,
        0.5 * t * (3.0 * t - 4.0),
        -0.5 * r * (3.0 * r - 4.0),
        0.5 * t * t,
    )


# --- features -----------------------------------------------------------------------------------------------------


def _feature(layer: Any, u: float, v: float) -> tuple[float, float, float]:
    """Return height and slopes of a block (rise, top, fall) or of a wave (1 - cos), with side faces."""
    # Factor of the side faces: 1 over the full width, falling linearly to 0 over the length of a face.
    side, side_slope = 1.0, 0.0
    beyond = abs(v) - layer.e
    if beyond >= layer.f:
        return 0.0, 0.0, 0.0
    if beyond > 0.0:
        side, side_slope = 1.0 - beyond / layer.f, (-1.0 if v > 0.0 else 1.0) / layer.f
    if u <= 0.0:
        return 0.0, 0.0, 0.0

    # Profile along u; beyond the fall, or the wave, the height remains zero.
    height, slope = 0.0, 0.0
    if layer.kind == WAVE:
        if u < layer.b:
            turn = 2.0 * np.pi * u / layer.b
            height, slope = 0.5 * layer.a * (1.0 - np.cos(turn)), np.pi * layer.a / layer.b * np.sin(turn)
    elif u < layer.b:
        height, slope = layer.a * u / layer.b, layer.a / layer.b
    elif u <= layer.b + layer.c:
        height = layer.a
    elif u < layer.b + layer.c + layer.d:
        height, slope = layer.a * (layer.b + layer.c + layer.d - u) / layer.d, -layer.a / layer.d
    # Product rule; the profile depends on u only and the factor of the side faces on v only.
    return height * side, slope * side, height * side_slope


def _slab(numbers: npt.NDArray[np.float64], layer: Any, x: float, y: float) -> tuple[float, float, float]:
    """Return height and slopes of a slab whose top has the height 0: beside it, its face leads down to the ground.

    A cell without segments is inside or outside as a whole; the others list all segments of the outline that may be
    nearest to a point in them. The slab is on the left of each segment.
    """
    i, j = floor((x - layer.x) / layer.cell), floor((y - layer.y) / layer.cell)
    if i < 0 or j < 0 or i >= layer.cells_x or j >= layer.cells_y:
        return -layer.a, 0.0, 0.0
    cell = layer.cells + j * layer.cells_x + i
    begin, end = int(numbers[cell]), int(numbers[cell + 1])
    if begin == end:
        return -layer.a * numbers[cell + layer.cells_x * layer.cells_y + 1], 0.0, 0.0
    nearest, left, px, py = 1e300, 0.0, 0.0, 0.0
    for k in range(begin, end):
        p = int(numbers[k])
        ex, ey = numbers[p + 2] - numbers[p], numbers[p + 3] - numbers[p + 1]
        dx, dy, square = x - numbers[p], y - numbers[p + 1], ex * ex + ey * ey
        along = min(max((dx * ex + dy * ey) / square, 0.0), 1.0)
        rx, ry = dx - along * ex, dy - along * ey
        distance, side = rx * rx + ry * ry, (ex * dy - ey * dx) / np.sqrt(square)
        # A corner is equally far from both of its segments; the side is that of the line farther from the point.
        tie = 1e-9 * nearest + 1e-18
        if distance < nearest - tie or (distance <= nearest + tie and abs(side) > abs(left)):
            nearest, left, px, py = min(distance, nearest), side, rx, ry
    if left >= 0.0:
        return 0.0, 0.0, 0.0
    away = np.sqrt(nearest)
    if away >= layer.b:
        return -layer.a, 0.0, 0.0
    slope = -layer.a / (layer.b * max(away, 1e-12))
    return -layer.a * away / layer.b, slope * px, slope * py


# --- roads --------------------------------------------------------------------------------------------------------


def _on_track(
    terrain: TerrainData, layer: Any, x: float, y: float, z: float, zx: float, zy: float
) -> tuple[float, float, float]:
    """Return height and slopes with a road laid on the height and slopes of the layers below it."""
    numbers = terrain.numbers
    station, t, found = _foot(numbers, layer, x, y)
    if not found:
        return z, zx, zy
    # Point, tangent and curvature of the centre line at the foot; it is a cubic Hermite spline between stations.
    p, q = layer.first + STATION * station, layer.first + STATION * (station + 1)
    length = numbers[q] - numbers[p]
    px, vx, ax = _hermite(numbers[p + 1], length * numbers[p + 3], numbers[q + 1], length * numbers[q + 3], t)
    py, vy, ay = _hermite(numbers[p + 2], length * numbers[p + 4], numbers[q + 2], length * numbers[q + 4], t)

    # The parameter t is not the arc length: dp/dt has the length `speed`, which the curvature and the slope need.
    speed = hypot(vx, vy)
    tx, ty = vx / speed, vy / speed

    # Offset n, positive to the left as in ISO 8855; `ahead` differs from zero only beyond the end of an open road.
    dx, dy = x - px, y - py
    n, ahead = tx * dy - ty * dx, tx * dx + ty * dy
    # 1 - k n, the ratio of arc lengths at the offset n; limited because it vanishes at the centre of curvature.
    bend = max(1.0 - (vx * ay - vy * ax) / (speed * speed * speed) * n, 0.1)
    left = numbers[p + 9] + t * (numbers[q + 9] - numbers[p + 9])
    right = numbers[p + 10] + t * (numbers[q + 10] - numbers[p + 10])

    # Distance beyond the nearer edge; `sign` turns derivatives by this distance into derivatives by n.
    edge, sign = (n - left, 1.0) if n > 0.0 else (-n - right, -1.0)

    past = abs(ahead) if station_is_end(layer, station, t) else 0.0

    # Height of the road, blended into the layers below it over the embankment.
    if layer.blends != 0:
        shoulder = layer.b
        # Beside and beyond the end of the road the same ramp blends it; the larger distance decides.
        outside = max(edge - shoulder, past)
        if outside < layer.a:
            height, rate, _ = _hermite(
                numbers[p + 5], length * numbers[p + 6], numbers[q + 5], length * numbers[q + 6], t
            )
            bank, bank_rate, _ = _hermite(
                numbers[p + 7], length * numbers[p + 8], numbers[q + 7], length * numbers[q + 8], t
            )
            # Beyond the end the foot does not move, so that height and banking are constant along the road.
            along = 0.0 if past > 0.0 else (rate + n * bank_rate) / (length * bend)
            road = height + n * bank
            if layer.table_rows != 0:
                more, rise, tilt = _table(terrain.heights, layer, numbers[p] + t * length, n)
                road, along, bank = road + more, along + rise / bend, bank + tilt
            weight, change = 1.0, 0.0
            if outside > 0.0:
                r = outside / layer.a
                # Cubic smoothstep: the slope is continuous at both ends of the embankment.
                weight, change = 1.0 - r * r * (3.0 - 2.0 * r), -6.0 * r * (1.0 - r) / layer.a
            # Product rule of weight * (road - z); these use the height below, so z changes only after them.
            across = bank * weight + (road - z) * change * (sign if edge - shoulder > past else 0.0)
            forward = along * weight
            if past >= edge - shoulder and past > 0.0:
                forward += (road - z) * change * (1.0 if ahead > 0.0 else -1.0)
            z += weight * (road - z)
            zx = (1.0 - weight) * zx + forward * tx - across * ty
            zy = (1.0 - weight) * zy + forward * ty + across * tx

    # Kerb beside the road; it ends with the road, up to rounding of the foot.
    if layer.f == sign and edge > 0.0 and past < 1e-6:
        s = numbers[p] + t * length
        reach = layer.d
        if edge < 2.0 * reach + layer.e and layer.g <= s <= layer.h:
            height, slope = layer.c, 0.0
            if edge < reach:
                # Trapezoid across the road: a face, the flat top, and a face down to the shoulder.
                height, slope = layer.c * edge / reach, layer.c / reach
            elif edge > reach + layer.e:
                height, slope = layer.c * (2.0 * reach + layer.e - edge) / reach, -layer.c / reach
            z += height
            zx -= sign * slope * ty
            zy += sign * slope * tx
    return z, zx, zy


def _table(heights: npt.NDArray[np.float32], layer: Any, u: float, v: float) -> tuple[float, float, float]:
    """Return height and slopes along and across a road of its bilinear table; constant beyond its edges."""
    row, column = u / layer.table_step, (v - layer.table_right) / layer.table_width
    inside_u, inside_v = _inside(row, layer.table_rows), _inside(column, layer.table_columns)
    row, column = min(max(row, 0.0), layer.table_rows - 1.0), min(max(column, 0.0), layer.table_columns - 1.0)
    # The last node belongs to the cell before it.
    i, j = min(floor(row), layer.table_rows - 2), min(floor(column), layer.table_columns - 2)
    p, q = row - i, column - j
    low = layer.table + i * layer.table_columns + j
    high = low + layer.table_columns
    right, left = heights[low] + p * (heights[high] - heights[low]), heights[low + 1]
    left += p * (heights[high + 1] - left)
    along = (1.0 - q) * (heights[high] - heights[low]) + q * (heights[high + 1] - heights[low + 1])
    return (
        right + q * (left - right),
        along / layer.table_step * inside_u,
        (left - right) / layer.table_width * inside_v,
    )


def station_is_end(layer: Any, station: int, t: float) -> bool:
    """Return whether a foot is at an end of an open road."""
    if layer.periodic != 0:
        return False
    return (station == 0 and t <= 0.0) or (station == layer.rows - 2 and t >= 1.0)


def _foot(numbers: npt.NDArray[np.float64], layer: Any, x: float, y: float) -> tuple[int, float, bool]:
    """Return the piece of a road that is nearest to a point, the parameter of the foot on it, and whether it exists.

    The cells of the index hold the numbers of all pieces that may be nearest to a point in them.
    """
    i, j = floor((x - layer.x) / layer.cell), floor((y - layer.y) / layer.cell)
    if i < 0 or j < 0 or i >= layer.cells_x or j >= layer.cells_y:
        return 0, 0.0, False
    cell = layer.cells + j * layer.cells_x + i
    begin, end = int(numbers[cell]), int(numbers[cell + 1])
    if begin == end:
        return 0, 0.0, False

    # Chords are enough to choose the piece; only the chosen one needs its curve.
    # The nearest chord.
    best, nearest, t = -1, 1e300, 0.0
    for k in range(begin, end):
        piece = int(numbers[k])
        p, q = layer.first + STATION * piece, layer.first + STATION * (piece + 1)
        x0, y0 = numbers[p + 1], numbers[p + 2]
        ex, ey = numbers[q + 1] - x0, numbers[q + 2] - y0
        along = min(max(((x - x0) * ex + (y - y0) * ey) / (ex * ex + ey * ey), 0.0), 1.0)
        distance = (x - x0 - along * ex) ** 2 + (y - y0 - along * ey) ** 2
        if distance < nearest:
            best, nearest, t = piece, distance, along
    # The foot on the curve, by Newton's method on (q - p(t)) · p'(t) = 0.
    p, q = layer.first + STATION * best, layer.first + STATION * (best + 1)
    length = numbers[q] - numbers[p]
    for _ in range(_NEWTON):
        px, vx, ax = _hermite(numbers[p + 1], length * numbers[p + 3], numbers[q + 1], length * numbers[q + 3], t)
        py, vy, ay = _hermite(numbers[p + 2], length * numbers[p + 4], numbers[q + 2], length * numbers[q + 4], t)
        dx, dy = x - px, y - py
        slope = dx * ax + dy * ay - vx * vx - vy * vy
        # Only at a minimum of the distance; beyond the centre of curvature Newton would run to a maximum.
        if slope < 0.0:
            t -= (dx * vx + dy * vy) / slope
        # Past an inner station the next cubic is nearly the same; past an end there is nothing to extrapolate to.
        low = 0.0 if layer.periodic == 0 and best == 0 else -_BEYOND
        high = 1.0 if layer.periodic == 0 and best == layer.rows - 2 else 1.0 + _BEYOND
        t = min(max(t, low), high)
    return best, t, True


def _hermite(p: float, dp: float, q: float, dq: float, t: float) -> tuple[float, float, float]:
    """Return value, first and second derivative of a cubic with given values and derivatives at t = 0 and 1."""
    b, a = 3.0 * (q - p) - 2.0 * dp - dq, 2.0 * (p - q) + dp + dq
    return p + t * (dp + t * (b + t * a)), dp + t * (2.0 * b + 3.0 * t * a), 2.0 * b + 6.0 * t * a


GROUND_PARTS = (
    ground_at,
    ground_heights,
    _with_layer,
    _node,
    _inside,
    _bilinear,
    _spline,
    _add_spline,
    _row_powers,
    _powers,
    _around,
    _reflected,
    _spline_weights,
    _feature,
    _slab,
    _on_track,
    _table,
    station_is_end,
    _foot,
    _hermite,
)
"""Functions that :mod:`mirdrake.core.compiled` compiles with users of :func:`ground_at` or :func:`ground_heights`."""
