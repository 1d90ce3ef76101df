"""Centre lines through points: pieces of linear curvature.

A chain of clothoids through points, with heading and curvature continuous at the joints, is to a plane curve what a
cubic spline is to a function: between joints the curvature is linear along the arc (do Carmo, "Differential Geometry of
Curves and Surfaces", section 1-5). Here joints are chosen among the points; clothoids.py finds the chain through them.

If points are spaced unevenly, such a chain may bulge far from the polyline through the points. There, points of a
centripetal Catmull-Rom curve (P. J. Schneider and others; C. Yuksel, S. Schaefer and J. Keyser, "Parameterization and
Applications of Catmull-Rom Curves", Computer-Aided Design 43, 2011), which stays near the polyline, are inserted.

Noisy points are smoothed first by a cubic smoothing spline (C. H. Reinsch, "Smoothing by spline functions", Numerische
Mathematik 10, 1967; P. J. Green and B. W. Silverman, "Nonparametric Regression and Generalized Linear Models", section
2.3), with the bending energy as small as the allowed deviation permits.
"""

import math

import numpy as np
import scipy  # it imports its parts when they are first used
import shapely
from numpy.typing import ArrayLike, NDArray

from mirdrake.core.errors import WorldError
from mirdrake.core.wording import plural
from mirdrake.worlds.clothoids import distances, solve
from mirdrake.worlds.pieces import Array, Piece, Placement, advance
from mirdrake.worlds.tracks import Track

_TURN = 0.35  # [rad] largest heading change between the initial joints
_FAR = 40.0  # [m] largest distance between the initial joints
_BULGE = 0.05  # small distance of the curve from a chord, over the length of the chord
_WIDER = 2.0  # largest bulge, over that of the Catmull-Rom curve
_SPLITS = 4  # number of times that inserted points are doubled where the curve bulges more
_GAP = (1e-6, 1e-8)  # [m], [rad] largest gap of a closed curve
_NO_WIDTH = 0.01  # [m] narrower roads have no width, such as lanes that close


def pieces_through(
    points: ArrayLike, *, closed: bool, smooth: float = 0.0, spacing: float = math.inf, tolerance: float = 1e-3
) -> tuple[list[Piece], Placement]:
    """Return a curve through points whose curvature is linear along every piece and continuous at the joints.

    Joints are at few points where the curve is smooth, and at every point where necessary. A
    closed curve meets its start within 1e-6 m and 1e-8 rad, with the same curvature.

    Args:
        points: N x 2 [m], four or more in driving order; the first of a closed curve may be repeated at its end.
        closed: the curve continues from the last point to the first.
        smooth: root mean square [m] of the distances by which noisy points may be moved; 0 keeps them.
        spacing: distance [m] of points above which points of a centripetal Catmull-Rom curve are inserted between
            them, before smoothing.
        tolerance: largest distance [m] of a point, after smoothing, from the curve.

    Returns:
        the pieces, and the pose (x [m], y [m], yaw [rad]) at their start: the first point, after smoothing.

    Raises:
        WorldError: the points are too few, repeated or not finite; `smooth` or `tolerance` is out of range.
    """
    places = _check_points(points, closed)
    if not (0.0 <= smooth < math.inf and 0.0 < tolerance < math.inf):
        raise WorldError(f"smooth {smooth:g} m, tolerance {tolerance:g} m: make smooth 0 or more and tolerance above 0")
    # About their mean, because the large coordinates of a map projection would cost digits.
    middle = places.mean(axis=0)
    places = places - middle
    if math.isfinite(spacing):
        places = _between(places, closed, np.ceil(_chords(places, closed) / spacing).astype(int))
    if smooth:
        places = _smooth(places, closed, smooth)

    ring, result = _curve(places, closed, tolerance)
    yaw, k, length = result
    # The curvature at the end of a piece is that at the start of the next one: it is continuous.
    following = np.append(k[1:], k[0]) if closed else k[1:]
    pieces = [Piece(*row) for row in np.column_stack((length, k[: len(length)], following)).tolist()]
    start = (float(ring[0, 0] + middle[0]), float(ring[0, 1] + middle[1]), math.remainder(float(yaw[0]), 2.0 * math.pi))
    if closed:
        end = start
        # Evaluated as a track does, piece by piece: what the solver fulfils, rounding may still violate.
        for piece in pieces:
            end = advance(end, piece)
        gap = math.hypot(end[0] - start[0], end[1] - start[1]), abs(math.remainder(end[2] - start[2], 2.0 * math.pi))
        if gap[0] > _GAP[0] or gap[1] > _GAP[1]:
            raise WorldError(f"the curve through the points misses its start by {gap[0]:.3g} m, {gap[1]:.3g} rad")
    return pieces, start


def edges_from_widths(track: Track, points: ArrayLike, left: ArrayLike, right: ArrayLike) -> tuple[Array, Array, Array]:
    """Return the `edges` of a :class:`Track` from widths that were measured at points along it.

    The edges keep their measured positions: where the smoothed centre line passes a point at a distance, one side
    becomes wider and the other narrower.

    Args:
        track: the centre line; its width is not used.
        points: N x 2 [m] in driving order, where the widths were measured.
        left: distance [m] of the left edge from each point, N.
        right: distance [m] of the right edge from each point, N.

    Returns:
        s [m] from 0 to the length, and the widths to the left and to the right [m].

    Raises:
        WorldError: a point is so far from the centre line that the line is outside the road there.
    """
    places = _check_points(points, track.closed)
    count = len(places)
    sides = [np.asarray(values, dtype=float)[:count] for values in (left, right)]
    if any(len(values) != count for values in sides):
        raise WorldError(f"{count} points, but {len(sides[0])} widths to the left and {len(sides[1])} to the right")
    chords = _chords(places, track.closed)
    # Scaled arc length along the points, so that a point is not projected on a neighbouring branch.
    near = np.concatenate(([0.0], np.cumsum(chords)))[:count] * (track.length / chords.sum())
    s, offset = track.project(places[:, 0], places[:, 1], near=near)
    if track.closed:  # the first point may be just before the start
        # Within half a lap of the expected station, not wrapped at the start.
        s = near + np.mod(s - near + track.length / 2.0, track.length) - track.length / 2.0
    # The offset is that of the point, + left of the line: seen from the line, the left edge is farther by it.
    widths = np.column_stack((sides[0] + offset, sides[1] - offset))
    if not (widths > 0.0).all():
        i = int(np.argmin(widths.min(axis=1)))
        # A road without width, such as a lane that closes, is no matter of smoothing.
        if (width := sides[0][i] + sides[1][i]) < _NO_WIDTH:
            x, y = places[i]
            raise WorldError(f"the road is {width:.3g} m wide at point {i + 1}, at ({x:.6g}, {y:.6g}) m")
        raise WorldError(
            f"point {i + 1} is {abs(offset[i]):.3g} m off the centre line, more than the road is wide there; "
            "make smooth smaller"
        )
    # Where the line was smoothed around a tight corner, projections can run back; such points are left out.
    forward = np.concatenate(([True], s[1:] > np.maximum.accumulate(s)[:-1] + 1e-6))
    s, widths = s[forward], widths[forward]
    inner = (s > 1e-6) & (s < track.length - 1e-6)
    stations = np.concatenate(([0.0], s[inner], [track.length]))
    period = track.length if track.closed else None
    both = [np.interp(stations, s, values, period=period) for values in widths.T]
    return stations, both[0], both[1]


# --- the inner parts ---------------------------------------------------------------------------------------------


def _check_points(points: ArrayLike, closed: bool) -> Array:
    """Return the points as an array, without a repeated last one.

    Raises:
        WorldError: the points are invalid.
    """
    places = np.asarray(points, dtype=float)
    if places.ndim != 2 or places.shape[1] != 2:
        raise WorldError(f"points of shape {places.shape}; give N x 2, x and y of each point [m]")
    if not np.isfinite(places).all():
        raise WorldError(
            f"point {int(np.argmin(np.isfinite(places).all(axis=1))) + 1} is not finite; give numbers in m"
        )
    # Files often repeat the first point at the end of a closed line.
    if closed and len(places) > 1 and math.dist(places[0], places[-1]) < 1e-6:
        places = places[:-1]
    if len(places) < 4:
        raise WorldError(f"{plural(len(places), 'point')}; a curve needs at least 4")
    chords = _chords(places, closed)
    if chords.min() < 1e-6:
        index = int(np.argmin(chords))
        raise WorldError(
            f"point {index + 1} at ({places[index, 0]:g}, {places[index, 1]:g}) m is repeated; remove one of them"
        )
    return places


def _chords(places: Array, closed: bool) -> Array:
    """Return the distances [m] from each point to the next; of a closed curve also from the last to the first."""
    ahead = np.roll(places, -1, axis=0) if closed else places[1:]
    return np.asarray(np.hypot(*(ahead - places[: len(ahead)]).T))


def _curve(places: Array, closed: bool, tolerance: float) -> tuple[Array, tuple[Array, Array, Array]]:
    """Return points, and headings, curvatures and lengths of clothoids through them with small bulges.

    Raises:
        WorldError: no solution exists.
    """
    best: tuple[float, Array, tuple[Array, Array, Array]] | None = None

    # Where the curve bulges far from a chord, points are inserted around it; the smallest bulge is kept.
    chords = _chords(places, closed)
    parts = np.ones(len(chords), dtype=int)
    # Each pass doubles the points where the curve bulges, so that few passes suffice or the points are at fault.
    for _ in range(_SPLITS + 1):
        ring = _between(places, closed, parts)
        result = _fit(ring, closed, tolerance)
        if result is None:
            parts = 2 * parts
            continue
        bulge = _bulges(places, closed, ring, result)
        if best is None or bulge.max() < best[0]:
            best = float(bulge.max()), ring, result
        # A chord of a tight bend bulges by nature: only what is far above its neighbours counts as an overshoot.
        wide = bulge > _BULGE
        if wide.any():
            wide &= bulge > _WIDER * _usual_bulges(places, closed)
        if not wide.any():
            return ring, result
        # Neighbours of a bulging chord as well, since the curve there depends on them.
        around = wide | (np.roll(wide, 1) if closed else np.append(False, wide[:-1]))
        around |= np.roll(wide, -1) if closed else np.append(wide[1:], False)
        parts = np.where(around, 2 * parts, parts)
    if best is None:
        raise WorldError("no smooth curve through the points was found; sort them in driving order, or add more")
    return best[1], best[2]


def _between(places: Array, closed: bool, parts: NDArray[np.int_]) -> Array:
    """Return the points, with centripetal Catmull-Rom curves of the given numbers of parts between them."""
    if (parts == 1).all():
        return places
    if closed:
        padded = np.vstack((places[-1:], places, places[:2]))
    else:  # the ends are extended straight
        padded = np.vstack((2.0 * places[0] - places[1], places, 2.0 * places[-1] - places[-2]))
    rows = []
    for index, count in enumerate(parts.tolist()):
        p0, p1, p2, p3 = padded[index : index + 4]

        # Centripetal: knots by the square root of the chords, which avoids loops and cusps at uneven spacing.
        a, b, c = (math.sqrt(math.dist(*pair)) for pair in ((p0, p1), (p1, p2), (p2, p3)))  # the knots' distances
        start = (p1 - p0) / a - (p2 - p0) / (a + b) + (p2 - p1) / b
        end = (p2 - p1) / b - (p3 - p1) / (b + c) + (p3 - p2) / c
        u = (np.arange(count) / count)[:, None]
        h1, h2 = u * u * (3.0 - 2.0 * u), u * (1.0 - u)
        rows.append(p1 + h1 * (p2 - p1) + b * (h2 * (1.0 - u) * start - h2 * u * end))
    return np.vstack(rows if closed else [*rows, places[-1:]])


def _usual_bulges(places: Array, closed: bool) -> Array:
    """Return the largest distances of a centripetal Catmull-Rom curve from each chord, over the chord's length."""
    chords = _chords(places, closed)
    curve = _between(places, closed, np.full(len(chords), 8))[: 8 * len(chords)].reshape(-1, 8, 2)
    ahead = (np.roll(places, -1, axis=0)[: len(chords)] - places[: len(chords)]) / chords[:, None]
    rest = curve - curve[:, :1]
    across = rest[..., 0] * ahead[:, None, 1] - rest[..., 1] * ahead[:, None, 0]
    return np.asarray(np.abs(across).max(axis=1) / chords)


def _bulges(places: Array, closed: bool, ring: Array, found: tuple[Array, Array, Array]) -> Array:
    """Return the largest distance of the curve from each chord, where that is nearest, over the chord's length."""
    yaw, k, length = found
    following = np.append(k[1:], k[0]) if closed else k[1:]
    pieces = [Piece(*row) for row in np.column_stack((length, k[: len(length)], following)).tolist()]
    track = Track(pieces, start=(float(ring[0, 0]), float(ring[0, 1]), float(yaw[0])))
    ends = np.vstack((places, places[:1])) if closed else places
    chords = np.asarray(shapely.linestrings(np.stack((ends[:-1], ends[1:]), axis=1)))
    # Distances to the nearest chord and not to its own: the stations of the curve and the points do not agree.
    curve = shapely.points(*track.point(np.linspace(0.0, track.length, 4 * len(ring) + 1)))
    (_, chord), distance = shapely.STRtree(chords).query_nearest(curve, return_distance=True)
    worst = np.zeros(len(chords))
    np.maximum.at(worst, chord, distance)
    return worst / _chords(places, closed)


def _smooth(places: Array, closed: bool, rms: float) -> Array:
    """Return points moved by a root mean square [m] that minimise the bending energy of the cubic spline through them.

    With second derivatives g of the spline, Q their second differences and R their products, the smoothed points are
    y - a Q g with (R + a Q' Q) g = Q' y. The deviation increases with a, which is found by bisection.
    """
    count = len(places)

    # A shift of that size would no longer follow the points.
    extent = math.sqrt(float((places**2).sum(axis=1).mean()))
    if rms > 0.1 * extent:
        raise WorldError(f"smooth {rms:g} m is too much for points within {extent:.3g} m; make it less than a tenth")

    # Q and R are banded; in a closed spline the bands continue around the end.
    h = _chords(places, closed)
    node = np.arange(count) if closed else np.arange(1, count - 1)
    before, after, row = h[node - 1], h[node], np.arange(len(node))
    q = scipy.sparse.coo_array(
        (
            np.concatenate((1.0 / before, -1.0 / before - 1.0 / after, 1.0 / after)),
            (np.concatenate(((node - 1) % count, node, (node + 1) % count)), np.tile(row, 3)),
        ),
        shape=(count, len(node)),
    ).tocsc()
    here, following = (row, (row + 1) % len(row)) if closed else (row[:-1], row[1:])
    side = after[here] / 6.0
    r = scipy.sparse.coo_array(
        (
            np.concatenate(((before + after) / 3.0, side, side)),
            (np.concatenate((row, here, following)), np.concatenate((row, following, here))),
        )
    ).tocsc()
    squared, target = scipy.sparse.csc_array(q.T @ q), q.T @ places

    def shift_for(a: float) -> Array:
        return np.asarray(a * (q @ scipy.sparse.linalg.splu(scipy.sparse.csc_array(r + a * squared)).solve(target)))

    # The exponent of a is bisected, because a varies over twenty decades with the spacing and the deviation.
    low, high, best = -6.0, 15.0, np.zeros_like(places)
    # The unit of a is m³; the cube of the spacing makes the exponents independent of it.
    scale = float(np.median(h)) ** 3
    for _ in range(40):
        exponent = (low + high) / 2.0
        shift = shift_for(10.0**exponent * scale)
        deviation = math.sqrt(float((shift**2).sum(axis=1).mean()))
        if deviation > rms:
            # The deviation increases with a; only solutions below the limit are kept.
            high = exponent
        else:
            low, best = exponent, shift
        if 0.98 * rms <= deviation <= rms:
            break
    return places - best


def _fit(places: Array, closed: bool, tolerance: float) -> tuple[Array, Array, Array] | None:
    """Return headings, curvatures and lengths of clothoids within the tolerance of all points; None without solution.

    Initial joints have small heading changes; where a point between two joints is too far from the curve, the middle
    point becomes a joint, too.
    """
    count = len(places)
    t = np.concatenate(([0.0], np.cumsum(_chords(places, closed))))
    joints = _first_joints(places, t, closed)
    while True:
        result = solve(places[joints], t[np.append(joints, count)] if closed else t[joints], closed)
        if result is None:
            # Few joints may have no solution where the points turn too much between them; then every point is one.
            if len(joints) == count:
                return None
            joints = np.arange(count)
            continue
        off = distances(places, t, joints, result)
        ends = np.append(joints, count) if closed else joints
        owner = np.searchsorted(joints, np.arange(count), side="right") - 1
        worst = np.zeros(len(joints))
        np.maximum.at(worst, owner, off)
        split = np.flatnonzero(worst > tolerance)
        if not split.size:
            return result
        # Bisection of the index range between joints, so that few joints are added per round.
        joints = np.union1d(joints, (ends[split] + ends[split + 1]) // 2)
        if split.size > 0.5 * len(result[2]) and len(joints) > 0.25 * count:  # all points become joints
            joints = np.arange(count)


def _first_joints(places: Array, t: Array, closed: bool) -> NDArray[np.intp]:
    """Return indices of points between which the chords turn by at most 0.35 rad and that are at most 40 m apart."""
    ahead = np.roll(places, -1, axis=0)[: len(t) - 1] - places[: len(t) - 1]
    heading = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0])).tolist()
    distances, joints, base = t.tolist(), [0], heading[0]
    # The heading is compared with that at the last joint: turns add up, also slow ones.
    for i in range(1, len(heading)):
        if abs(heading[i] - base) > _TURN or distances[i + 1] - distances[joints[-1]] > _FAR:
            joints.append(i)
            base = heading[i]
    if not closed:
        joints.append(len(places) - 1)
    if len(joints) < 4:
        spread = np.linspace(0, len(places), 4, endpoint=False) if closed else np.linspace(0, len(places) - 1, 4)
        joints += spread.astype(int).tolist()
    return np.unique(joints)
