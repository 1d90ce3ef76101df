"""Centre lines of roads: of a line of points with a width, and of an area, as lines and arcs that a car can follow.

The centre line of an area is the part of its medial axis that is longest: around a closed circuit, or from one end of a
road to the other (medial_axis.py).
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
from scipy.ndimage import gaussian_filter1d
from shapely.ops import substring

from mirdrake.core.errors import ConfigError, WorldError
from mirdrake.importing.worlds.entry import number
from mirdrake.importing.worlds.medial_axis import medial_line
from mirdrake.importing.worlds.model import Array
from mirdrake.worlds.spec import TrackSpec
from mirdrake.worlds.track_layout import make_track
from mirdrake.worlds.tracks import Track

WIDEST = 25.0
"""Mean width up to which an area is a road and not a yard [m]."""

_RADIUS = 7.0  # [m] that a corner gets if there is room: most cars can turn on it
_LEAST_LINE = 1e-3  # [m] of a line that is left between a corner and its neighbour
_STRAIGHT = 1e-4  # [rad] turn of a corner that is none
_BACK = math.radians(170.0)  # turn above which a line reverses its direction
_BESIDE = 1.2  # [m] between a line to follow and the edge of a wide road: half a car
_INTO_MARGIN = 0.2  # [m] into the room for a car beside obstacles, which is more than half of its width
# Smoothing, and tolerance of the remaining points, in widths of the road. With a small tolerance the points of a
# smoothed line stay even, so that no arc is tight; a large one leaves few corners around an obstacle.
_SMOOTHINGS = ((0.5, 0.01), (0.75, 0.01), (1.0, 0.01), (1.5, 0.01), (2.5, 0.01), (0.0, 0.12), (0.0, 0.25))
_POINTED = 0.04  # likewise, of a line that is not smoothed
_SMALLER = (_RADIUS, 5.5, 4.6)  # [m] of corners on narrower roads; the last suits a small car
_MOST_SEGMENTS = 1500
_LONG = 3.0  # length over width of a road


@dataclass(frozen=True)
class Route:
    """A track of the new world.

    Attributes:
        track: laid out.
        text: its keys in the world file, without its name, surface and friction.
        is_road: its area is that of the road; else it is a line to follow on patches.
    """

    track: Track
    text: str
    is_road: bool


def route_of_line(points: Array, width: float, *, is_road: bool = True, radius: float = _RADIUS) -> Route | None:
    """Return the track along points (n, 2) [m] with a width and a radius of its corners [m]; None if there is none."""
    # A line is closed if the gap between its ends is small against its width.
    closed = len(points) > 3 and math.dist(points[0], points[-1]) < 1e-3 + 0.05 * width
    laid = _rounded(points, closed=closed, width=width, radius=radius)
    if laid is None:
        return None
    (x, y, yaw), segments = laid
    start = f"start: {{at: [{number(x)}, {number(y)}], yaw: {math.degrees(yaw):.8f} deg}}"
    # Many digits, because errors of lengths and angles add up along a track.
    parts = [
        f"{{line: {size:.12g}}}"
        if angle == 0.0
        else f"{{arc: {{radius: {size:.12g}, angle: {math.degrees(angle):.13g} deg}}}}"
        for size, angle in segments
    ]
    # Prefer a road of the full width; tight bends may only allow a narrower line to follow.
    for road, wide in ((True, width), (False, width), (False, 0.5 * width), (False, min(1.0, 0.2 * width))):
        if road and not is_road:
            continue
        spec = {
            "start": {"at": (round(x, 4), round(y, 4)), "yaw": math.radians(round(math.degrees(yaw), 8))},
            "segments": [{"line": size} if angle == 0.0 else
                         {"arc": {"radius": size, "angle": angle}}
                         for size, angle in segments],
            "closed": closed, "width": round(wide, 3), "road": road,
        }  # fmt: skip
        try:
            track = make_track(TrackSpec.model_validate(spec), name="route")
        except (ConfigError, WorldError, ValueError):
            continue
        keys = [start, *(["closed: true"] if closed else []), f"width: {number(round(wide, 3))}"]
        keys += [] if road else ["road: false"]
        return Route(track, ", ".join([*keys, f"segments: [{', '.join(parts)}]"]), road)
    return None


def route_in_area(area: shapely.Polygon, whole: shapely.Polygon | None = None, *, ends: float = 0.5) -> Route | None:
    """Return the track along the middle of an area; None if it is too wide or too short for a road.

    Args:
        area: the road, without obstacles and room for a car beside them [m].
        whole: the road with its obstacles; None if it has none.
        ends: length that an open line loses at both ends, in widths; they fork into the corners of the area.
    """
    # A long area has about the area length x width and the circumference 2 x length.
    width = 2.0 * area.area / area.length
    if width > WIDEST or width < 0.05:
        return None
    # The medial axis is noisy: smooth it until it has a radius that a car can follow.
    # Passages beside obstacles may be narrow, as room for the car is already subtracted.
    line, clear = medial_line(area, width, narrowest=0.2 if whole is None else 0.05)
    if len(line) < 2 or float(np.hypot(*np.diff(line, axis=0).T).sum()) < _LONG * width:
        return None
    # The lower quartile: wide places do not make the whole road wide.
    wide = 2.0 * float(np.quantile(clear, 0.25))
    closed = bool(np.allclose(line[0], line[-1]))
    if not closed:
        line = _trimmed(line, ends * wide)
    best: tuple[float, Array, float] | None = None
    edges = (area if whole is None else whole).boundary
    pointed = _smoothed(line, wide, 0.0, _POINTED, closed=closed)
    corners = _with_corners(pointed, wide, closed=closed)
    # The line itself, its straights joined by arcs, then more and more smoothing; the first that suits most cars.
    tries = [(pointed, _RADIUS), *((corners, radius) for radius in _SMALLER)]
    tries += [(_smoothed(line, wide, *smoothing, closed=closed), _RADIUS) for smoothing in _SMOOTHINGS]
    for simple, rounding in tries:
        route = route_of_line(simple, wide, is_road=False, radius=rounding)
        if route is None:
            continue
        x, y = route.track.point(s := np.linspace(0.0, route.track.length, 400), np.zeros_like(s))
        points = shapely.points(x, y)
        if shapely.distance(points, edges).min() < min(0.25 * wide, _BESIDE):
            continue
        if whole is not None and shapely.distance(points, area).max() > _INTO_MARGIN:
            continue
        radius = min(route.track.min_radius, _RADIUS)
        if best is None or radius > best[0] + 0.1:
            best = radius, simple, rounding
        if radius >= _RADIUS:
            break
    if best is None:
        return None
    # The track is the road itself if it covers the area; else it is a line to follow on patches.
    _, simple, rounding = best
    road = route_of_line(simple, wide, radius=rounding)
    if road is not None and road.is_road:
        covered = shapely.intersection(road.track.area, area).area
        if covered > 0.93 * area.area and covered > 0.97 * road.track.area.area:
            return road
    return route_of_line(simple, wide, is_road=False, radius=rounding)


# --- the inner parts ----------------------------------------------------------------------------------------------


def _trimmed(line: Array, length: float) -> Array:
    """Return a line shortened by a length at both ends [m]."""
    whole = shapely.LineString(line)
    if whole.length < 4.0 * length:
        return line
    inner: Array = shapely.get_coordinates(substring(whole, length, whole.length - length))
    return inner


def _smoothed(line: Array, wide: float, smoothness: float, tolerance: float, *, closed: bool) -> Array:
    """Return a line smoothed over a multiple of the road width [m], with few points within a part of that width."""
    if smoothness:
        whole = shapely.LineString(line)
        count = max(8, math.ceil(whole.length / (0.25 * wide)))
        even = shapely.get_coordinates(shapely.line_interpolate_point(whole, np.linspace(0.0, whole.length, count + 1)))
        places = even[:-1] if closed else even
        sigma = smoothness * wide / (whole.length / count)
        places = gaussian_filter1d(places, sigma, axis=0, mode="wrap" if closed else "nearest")
        line = np.vstack((places, places[:1])) if closed else places
    simple: Array = shapely.get_coordinates(shapely.simplify(shapely.LineString(line), tolerance * wide))
    return simple


def _with_corners(points: Array, wide: float, *, closed: bool) -> Array:
    """Return a line whose straights are extended to their intersections, where bends between them are short.

    The middle of a road turns at a corner along a parabola, which leaves less room for an arc than the corner of its
    straights.
    """
    if closed:  # from the middle of the longest straight, so that no corner is at the end
        points = points[:-1]
        first = int(np.argmax(np.hypot(*(np.roll(points, -1, axis=0) - points).T)))
        points = np.roll(points, -first, axis=0)
        middle = 0.5 * (points[0] + points[1 % len(points)])
        points = np.vstack((middle, points[1:], points[:1], middle))
    steps = np.diff(points, axis=0)
    lengths = np.hypot(*steps.T)
    straights = np.flatnonzero(lengths > wide)
    line, last = [points[0]], 0  # up to the point with the index `last`
    for before, after in pairwise(straights.tolist()):
        bend = float(lengths[before + 1 : after].sum())
        # Bends much longer than the road is wide are curves, not rounded corners.
        if after == before + 1 or bend > 2.5 * wide:
            continue
        # p + a u = q - b v for the end p of one straight and the begin q of the next one.
        p, q, u, v = points[before + 1], points[after], steps[before], steps[after]
        across = float(u[0] * v[1] - u[1] * v[0])
        # Almost parallel straights intersect far away or nowhere.
        if abs(across) < _STRAIGHT * float(lengths[before] * lengths[after]):
            continue
        a = float((q - p)[0] * v[1] - (q - p)[1] * v[0]) / across
        corner = p + a * u
        b = float((q - corner) @ v) / float(v @ v)
        if a > 0.0 and b > 0.0 and math.dist(corner, p) < 2.0 * wide and math.dist(corner, q) < 2.0 * wide:
            line += [*points[last + 1 : before + 1], corner]
            last = after
    return np.vstack((*line, *points[last + 1 :]))


def _rounded(
    points: Array, *, closed: bool, width: float, radius: float
) -> tuple[tuple[float, float, float], list[tuple[float, float]]] | None:
    """Return a line of points with arcs in its corners.

    Returns:
        the pose where it starts, and its segments: length [m] and 0, or radius [m] and turn [rad]; None if it goes back
        on itself or has too many corners.
    """
    places = np.asarray(points, dtype=float)[:, :2]
    places = shapely.get_coordinates(shapely.simplify(shapely.LineString(places), 0.01)) if len(places) > 2 else places
    if closed:
        places = places[:-1] if math.dist(places[0], places[-1]) < 1e-3 + 0.05 * width else places
        first = int(np.argmax(np.hypot(*(np.roll(places, -1, axis=0) - places).T)))  # start in the longest line
        places = np.roll(places, -first, axis=0)
        # With the start midway on a straight, the ends of a closed track meet without a corner.
        middle = 0.5 * (places[0] + places[1])
        places = np.vstack((middle, places[1:], places[:1], middle))
    steps = np.diff(places, axis=0)
    lengths = np.hypot(*steps.T)
    keep = lengths > 1e-4
    steps, lengths = steps[keep], lengths[keep]
    if not len(steps) or len(steps) > _MOST_SEGMENTS // 2:
        return None
    headings = np.arctan2(steps[:, 1], steps[:, 0])
    # Turns within ±π, positive to the left.
    turns = np.remainder(np.diff(headings) + math.pi, 2.0 * math.pi) - math.pi
    if len(turns) and np.abs(turns).max() > _BACK:
        return None

    # The arc of a corner uses up to half of the adjacent lines, and all of the first and last line.
    share = np.full(len(lengths), 0.5)
    share[0] = share[-1] = 0.98 if len(lengths) > 1 else 1.0
    cut = np.zeros(len(turns))
    for index, turn in enumerate(turns):
        if abs(turn) < _STRAIGHT:
            continue
        # Distance of an arc's ends from the corner: radius x tan(turn / 2).
        half = math.tan(abs(turn) / 2.0)
        room = min(share[index] * lengths[index], share[index + 1] * lengths[index + 1]) - _LEAST_LINE
        if room <= 0.0:
            return None
        off = max(0.25 * width, 0.1) / (1.0 / math.cos(turn / 2.0) - 1.0)  # radius that cuts the corner so far
        cut[index] = min(room, max(off, radius, 0.6 * width) * half)
    segments: list[tuple[float, float]] = []
    for index, length in enumerate(lengths):
        left = length - (cut[index - 1] if index else 0.0) - (cut[index] if index < len(turns) else 0.0)
        if left > 1e-3:
            segments.append((float(left), 0.0))
        if index < len(turns) and abs(turns[index]) >= _STRAIGHT:
            size = cut[index] / math.tan(abs(turns[index]) / 2.0)
            if size < 0.05:
                return None
            segments.append((float(size), float(turns[index])))
    return (float(places[0, 0]), float(places[0, 1]), float(headings[0])), segments
