"""Tracks from their specifications: pieces from segments, points or files, widths, and checks."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import shapely

from mirdrake.core.errors import ConfigError, WorldError, did_you_mean
from mirdrake.core.yaml_io import display_path, where
from mirdrake.worlds.centre_lines import edges_from_widths, pieces_through
from mirdrake.worlds.networks import Network
from mirdrake.worlds.networks.routes import find_place, find_route
from mirdrake.worlds.opendrive import read_opendrive
from mirdrake.worlds.pieces import Array, Piece, Placement
from mirdrake.worlds.random_tracks import RandomTrackSpec, random_pieces
from mirdrake.worlds.spec import CsvSpec, RouteSpec, TrackSpec, XodrSpec
from mirdrake.worlds.tracks import Edges, Track

_GAP_LENGTH, _GAP_ANGLE = 1e-3, math.radians(0.01)
_LONGEST = 1e5  # [m] longest track
_FARTHEST = 1e6  # [m] from the origin
_USUAL_WIDTH = 3.0  # [m]
_MOST_POINTS = 4_000  # of a centre line that is smoothed


@dataclass(frozen=True)
class _CentreLine:
    """A centre line with the properties that its source states."""

    pieces: list[Piece]
    start: Placement
    closed: bool
    edges: Edges | None = None
    """edges of a file with widths"""
    near: Callable[[float], str] = lambda _: ""
    """returns the entry of the source nearest to s [m], as ' (...)'"""
    notes: tuple[str, ...] = ()
    smoothed: Callable[[float, float], "_CentreLine"] | None = None
    """returns the line smoothed by a root mean square [m] at a spacing of points [m]; None: the line is exact"""
    points: Array = field(default_factory=lambda: np.empty((0, 2)))
    """points of the source [m]"""


def make_track(
    spec: TrackSpec,
    *,
    name: str = "track",
    folder: Path | None = None,
    seed: int = 0,
    network: Network | None = None,
) -> Track:
    """Return the track of a specification.

    Args:
        spec: spec of the track.
        name: name for messages.
        folder: folder of its files; default: the working directory.
        seed: seed of the world, for a random track.
        network: network of the world, for routes.

    Raises:
        ConfigError: a file is missing or has faults.
        WorldError: the track does not close, it crosses itself, its inner edge folds, its length is wrong, or auto
            lines have no solution.
    """
    # Exactly one source is given; the schema has checked that.
    if spec.points is not None:
        line = _from_points(spec)
    elif spec.csv is not None:
        line = _from_csv(spec, spec.csv, folder or Path())
    elif spec.xodr is not None:
        line = _from_xodr(spec, spec.xodr, folder or Path())
    elif spec.random is not None:
        line = _from_random(spec, spec.random, seed, name)
    elif spec.route is not None:
        line = _from_route(spec, spec.route, network)
    else:
        line = _from_segments(spec)
    start = line.start if spec.start is None else (*spec.start.at, spec.start.yaw)
    total = math.fsum(piece.length for piece in line.pieces)
    # Checked before the track is laid out, which takes time and memory proportional to the length.
    if not 0.1 <= total <= _LONGEST:
        raise WorldError(f"{total:g} m long; allowed are 0.1 m to 100 km", where=where(spec))
    if max(abs(start[0]), abs(start[1])) > _FARTHEST:
        raise WorldError(
            f"starts at ({start[0]:g}, {start[1]:g}) m, too far from the origin; set start to move it, "
            "for example start: {at: [0, 0]}",
            where=where(spec),
        )
    track = _lay(spec, line, total, name)
    # Only lines through given points may be changed; exact ones are the intention of the author.
    if line.smoothed is not None and (fold := track.folds()) is not None:
        line, track = _unfold(spec, line, track, fold)
    _check(spec, track, line)
    return track


def _lay(spec: TrackSpec, line: _CentreLine, given: float, name: str) -> Track:
    """Return the road along a centre line; the stations of its widths refer to the length `given` [m]."""
    start = line.start if spec.start is None else (*spec.start.at, spec.start.yaw)
    total = math.fsum(piece.length for piece in line.pieces)
    width, edges = _USUAL_WIDTH, line.edges
    if isinstance(spec.width, float):
        width, edges = spec.width, None
    elif spec.width is not None:
        s, left, right = _edges_of(spec, spec.width, given, line.closed)
        # A smoothed line is a little shorter; widths stay where they were relative to its length.
        edges = np.asarray(s) * (total / given), left, right
    return Track(line.pieces, start=start, closed=line.closed, width=width, edges=edges, name=name, notes=line.notes)


def _unfold(spec: TrackSpec, line: _CentreLine, track: Track, fold: float) -> tuple[_CentreLine, Track]:
    """Smooth a centre line through points by the smallest amount after which its inner edge does not fold.

    The points are smoothed at a spacing of an eighth of the width. Where a point would be more than half the width off
    the centre line, the line and the track stay as they are.

    Args:
        spec: spec of the track.
        line: through the points.
        track: track along that line.
        fold: station at which its inner edge folds [m].
    """
    assert line.smoothed is not None

    # From a hardly visible amount, doubled, to half of the width, where the line would leave the road.
    spacing = max(track.width / 8.0, track.length / _MOST_POINTS)
    amount, low, high = track.width / 512.0, 0.0, math.inf
    best = line, track
    # The amount is doubled until the track does not fold, then bisected.
    while amount <= track.width / 2.0 and (math.isinf(high) or high > 1.05 * low):
        try:
            smoothed = line.smoothed(amount, spacing)
            road = _lay(spec, smoothed, track.length, track.name)
        except WorldError:  # no line was found, or it leaves the road
            road = None
        if road is None or road.folds() is not None:
            low = amount
        else:
            high, best = amount, (smoothed, road)
        amount = 2.0 * amount if math.isinf(high) else 0.5 * (low + high)
    if math.isinf(high):
        return best
    smoothed, road = best

    # The points must remain on the road: the smoothed line is rejected where it passes one by half the width.
    bare = Track(smoothed.pieces, start=smoothed.start, closed=smoothed.closed)
    curve = shapely.linestrings(np.column_stack(bare.point(bare.stations())))
    off = float(shapely.distance(shapely.points(line.points), curve).max())
    if off > track.width / 2.0:
        return line, track
    road.notes += (
        f"track '{track.name}': the inner edge folds at s = {fold:.4g} m{line.near(fold)}; the centre line is smoothed "
        f"and passes the points by up to {off:.3g} m",
    )
    return smoothed, road


# --- sources of centre lines -------------------------------------------------------------------------------------


def _from_segments(spec: TrackSpec) -> _CentreLine:
    pieces = _solve_auto_lines(spec, [piece for segment in spec.segments or () for piece in segment.pieces])
    total = math.fsum(piece.length for piece in pieces)
    if not 0.1 <= (spec.length or total) <= _LONGEST:
        raise WorldError(f"{spec.length or total:g} m long; allowed are 0.1 m to 100 km", where=where(spec))
    # Scaling keeps all angles, so that a closed track remains closed.
    if spec.length is not None and abs(spec.length / total - 1.0) > 1e-12:
        scale = spec.length / total
        pieces = [Piece(p.length * scale, p.start_curvature / scale, p.end_curvature / scale) for p in pieces]
    return _CentreLine(pieces, (0.0, 0.0, 0.0), bool(spec.closed))


def _from_random(spec: TrackSpec, random: RandomTrackSpec, seed: int, name: str) -> _CentreLine:
    if spec.closed is False:
        raise WorldError("a random track is closed; leave out closed: false", where=where(spec, "closed"))
    try:
        pieces, start = random_pieces(random, seed=seed, name=name)
    except WorldError as error:
        raise WorldError(str(error), where=where(spec, "random")) from None
    return _CentreLine(pieces, start, closed=True)


def _from_points(spec: TrackSpec) -> _CentreLine:
    points = np.array(spec.points, dtype=float)

    def lay(smooth: float, spacing: float) -> _CentreLine:
        pieces, start = pieces_through(points, closed=bool(spec.closed), smooth=smooth, spacing=spacing)
        near = _nearest(pieces, start, points, "point {}", range(1, 10_001))
        return _CentreLine(pieces, start, bool(spec.closed), near=near, points=points)

    try:
        _check_extent(points)
        return replace(lay(0.0, math.inf), smoothed=lay)
    except WorldError as error:
        raise WorldError(str(error), where=where(spec, "points")) from None


def _from_csv(spec: TrackSpec, csv: CsvSpec, folder: Path) -> _CentreLine:
    from mirdrake.worlds.csv_tracks import read_csv_track  # its pandas takes longer than all other worlds

    path, location = _find_file(csv, folder, "csv"), where(spec, "csv")
    if (csv.right is None) != (csv.left is None):
        raise ConfigError("right and left belong together; name both columns, or set both null", where=location)
    columns = {"x": csv.x, "y": csv.y, "right": csv.right, "left": csv.left}
    try:
        table = read_csv_track(path, **columns, scale=csv.scale)  # type: ignore[arg-type]
        closed = table.looks_closed if spec.closed is None else spec.closed
        if closed and not table.looks_closed:
            gap = math.dist(table.points[0], table.points[-1])
            # Headings of the first and the last chord, from dy and dx in this order.
            ahead = [math.atan2(*(b - a)[::-1]) for a, b in (table.points[:2], table.points[-2:])]
            turn = abs(math.degrees(math.remainder(ahead[0] - ahead[1], 2.0 * math.pi)))
            raise ConfigError(
                f"does not close: gap {gap:.3g} m, {turn:.3g} deg from the "
                "last point to the first; add the missing points, or remove closed: true",
                file=display_path(path),
                line=table.lines[-1],
            )
        _check_extent(table.points)

        def lay(smooth: float, spacing: float) -> _CentreLine:
            # Independent deviations add up by their squares.
            smooth = math.hypot(csv.smooth, smooth)
            pieces, start = pieces_through(table.points, closed=closed, smooth=smooth, spacing=spacing)
            edges = None
            if table.left is not None and table.right is not None and spec.width is None:
                # Edges are measured from the centre line, which exists only now; its own width is not used.
                bare = Track(pieces, start=start, closed=closed)
                edges = edges_from_widths(bare, table.points, table.left, table.right)
            near = _nearest(pieces, start, table.points, f"{display_path(path)}:{{}}", table.lines)
            return _CentreLine(pieces, start, closed, edges, near, points=table.points)

        return replace(lay(0.0, math.inf), smoothed=lay)
    except ConfigError as error:
        raise error.under(location) from None
    except WorldError as error:
        raise WorldError(f"{display_path(path)}: {error}", where=location) from None


def _from_xodr(spec: TrackSpec, xodr: XodrSpec, folder: Path) -> _CentreLine:
    path = _find_file(xodr, folder, "xodr")
    try:
        road = read_opendrive(path, road=None if xodr.road is None else str(xodr.road), lane=str(xodr.lane))
    except ConfigError as error:
        raise error.under(where(spec, "xodr")) from None
    closed = road.closed if spec.closed is None else spec.closed
    edges = road.edges if not closed or road.closed else None  # a gap is reported before widths are compared
    return _CentreLine(road.pieces, road.start, closed, edges, notes=tuple(road.left_out))


def _from_route(spec: TrackSpec, route: RouteSpec, network: Network | None) -> _CentreLine:
    if network is None:
        raise WorldError(
            "the world has no network; add for example network: {xodr: town.xodr}", where=where(spec, "route")
        )
    start, goal = (
        find_place(network, place, where=where(route, key)) for key, place in (("from", route.from_), ("to", route.to))
    )
    via = [find_place(network, place, where=where(route, "via", i)) for i, place in enumerate(route.via)]
    # The route is driven along the middles of its lanes, with the width of the lane.
    try:
        found = find_route(network, start, goal, via=via)
        pieces, pose = pieces_through(found.points, closed=False)
        bare = Track(pieces, start=pose)
        edges = edges_from_widths(bare, found.points, found.width / 2.0, found.width / 2.0)
    except WorldError as error:
        raise WorldError(str(error), where=where(spec, "route")) from None
    return _CentreLine(pieces, pose, closed=False, edges=edges)


def _find_file(spec: CsvSpec | XodrSpec, folder: Path, suffix: str) -> Path:
    """Return the file of a track.

    Raises:
        ConfigError: the file does not exist.
    """
    path = folder / spec.file
    try:
        if path.is_file():
            return path
        beside = [file.name for file in path.parent.glob(f"*.{suffix}")] if path.parent.is_dir() else []
    except (OSError, ValueError):  # a name that is too long, or contains a zero byte
        beside = []
    hint = did_you_mean(Path(spec.file).name, beside) if beside else "give its path relative to the world file"
    raise ConfigError(f"no such file: {spec.file[:200]!r}; {hint}", where=where(spec, "file"))


def _check_extent(points: Array) -> None:
    """Reject points that are far apart before a curve is fitted to them."""
    total = float(np.hypot(*np.diff(points, axis=0).T).sum())
    if total > _LONGEST:
        raise WorldError(f"{total:.3g} m from the first point to the last; allowed are 0.1 m to 100 km")


def _nearest(
    pieces: list[Piece], start: Placement, points: Array, name: str, numbers: list[int] | range
) -> Callable[[float], str]:
    """Return a function that names the point nearest to a station of the centre line."""

    def name_point(s: float) -> str:
        x, y, _ = Track(pieces, start=start).pose_at(s)
        index = int(np.argmin(np.hypot(points[:, 0] - x, points[:, 1] - y)))
        return f" ({name.format(numbers[index])})"

    return name_point


# --- widths and checks -------------------------------------------------------------------------------------------


def _edges_of(spec: TrackSpec, widths: list[tuple[float, float]], length: float, closed: bool) -> Edges:
    """Return the edges of a road whose width is given at some stations.

    Raises:
        WorldError: a station is beyond the end, or the widths at the ends of a closed track differ.
    """
    s, width = np.array(widths).T
    if s[-1] > length * (1.0 + 1e-9):
        index = int(np.argmax(s > length))
        raise WorldError(f"s = {s[index]:g} m; the track is {length:.6g} m long", where=where(spec, "width", index))
    # The station may exceed the end by rounding only; see the check above.
    s = np.minimum(s, length)
    # The last entry of a closed track is the first one again, and `interp` with a period adds it itself.
    if closed and s[0] == 0.0 and s[-1] >= length * (1.0 - 1e-9):
        if abs(width[0] - width[-1]) > 1e-6:
            raise WorldError(
                f"{width[0]:g} m at s = 0 and {width[-1]:g} m at the end of a closed track; make them equal",
                where=where(spec, "width"),
            )
        s, width = s[:-1], width[:-1]
    stations = np.unique(np.concatenate(([0.0], s, [length])))
    half = np.interp(stations, s, width, period=length if closed else None) / 2.0
    return stations, half, half


def _check(spec: TrackSpec, track: Track, line: _CentreLine) -> None:
    """Check that a track closes, that its inner edge does not fold, that it does not cross itself, and its length.

    Raises:
        WorldError: the track violates one of these conditions.
    """
    # The gap includes the heading: a track that meets its start at an angle has a kink there.
    is_varying, (gap, angle) = track.edges is not None, track.gap
    if track.closed and (gap > _GAP_LENGTH or abs(angle) > _GAP_ANGLE):
        advice = (
            "make the angles add up to 360 deg and set two lines that are not parallel to auto, or set closed: false"
        )
        raise WorldError(
            f"does not close: gap {gap:.3g} m, {abs(math.degrees(angle)):.3g} deg; allowed are 1 mm and "
            f"0.01 deg; {advice if spec.segments is not None else 'leave out closed: true'}",
            where=where(spec),
        )

    # With a constant width the sharpest bend decides, wherever it is.
    if not is_varying and track.min_radius <= track.width / 2.0:
        nearest = line.near(track.sharpest())
        raise WorldError(
            f"the inner edge folds: smallest radius {track.min_radius:.3g} m{nearest}, width "
            f"{track.width:.3g} m; make the radius larger than half the width",
            where=where(spec),
        )

    # With a varying width the product of curvature and distance of the inner edge decides.
    if is_varying and (fold := track.folds()) is not None:
        k = track.curvature_at(fold)
        side = float(track.left_width(fold) if k > 0.0 else track.right_width(fold))
        raise WorldError(
            f"{where(spec)}: the inner edge folds at s = {fold:.6g} m{line.near(fold)}: radius {abs(1.0 / k):.3g} m, "
            f"but the edge is {side:.3g} m away; make the road narrower there"
            + (", or raise csv.smooth" if spec.csv is not None else "")
        )
    # A track that is not a road has no surface that could overlap.
    if spec.road and not spec.crossing and (crossing := _first_crossing(track)) is not None:
        first, second = crossing
        x, y, _ = track.pose_at(first)
        raise WorldError(
            f"crosses itself at ({x:.4g}, {y:.4g}) m: s = {first:.4g} m{line.near(first)} and "
            f"{second:.4g} m{line.near(second)}; correct it, or set crossing: true for a figure of eight",
            where=where(spec),
        )
    if spec.expected_length is not None and abs(track.length - spec.expected_length[0]) > spec.expected_length[1]:
        expected, tolerance = spec.expected_length
        how = "change a segment, or let `length` scale it" if spec.segments is not None else "correct the points"
        raise WorldError(
            f"the track is {track.length:.6f} m long; expected are {expected:g} +- {tolerance:g} m; {how}",
            where=where(spec, "expected_length"),
        )


def _first_crossing(track: Track) -> tuple[float, float] | None:
    """Return the two stations [m] where the centre line crosses itself, or None; where its ends meet does not count."""
    # Chords within 1 mm of the line: crossings are found between straight segments.
    s = track.stations(sagitta=1e-3)
    points = np.column_stack(track.point(np.append(s[:-1], 0.0) if track.closed else s))
    # A search tree over the chords: all pairs would be too many for long tracks.
    chords = np.asarray(shapely.linestrings(np.stack((points[:-1], points[1:]), axis=1)))
    first, second = shapely.STRtree(chords).query(chords, predicate="intersects")
    apart = second - first
    # Neighbours share a point and do not count; on a closed track the last and the first are neighbours.
    apart = np.minimum(apart, len(chords) - apart) if track.closed else apart
    met = (second > first) & (apart > 1)
    first, second = first[met], second[met]
    crossings = shapely.get_coordinates(shapely.centroid(shapely.intersection(chords[first], chords[second])))
    # On an open track whose ends meet, the first and last chords touch there without a crossing.
    at_ends = [np.hypot(*(crossings - points[end]).T) < _GAP_LENGTH for end in (0, -1)]
    is_seam = (first == 0) & (second == len(chords) - 1) & at_ends[0] & at_ends[1]
    first, second, crossings = first[~is_seam], second[~is_seam], crossings[~is_seam]
    if not first.size:
        return None
    i = int(np.argmin(first))
    stations = [float(s[chord[i]] + np.hypot(*(crossings[i] - points[chord[i]]))) for chord in (first, second)]
    return stations[0], stations[1]


# --- segments ----------------------------------------------------------------------------------------------------


def _solve_auto_lines(spec: TrackSpec, pieces: list[Piece]) -> list[Piece]:
    """Return the pieces with the lengths of the auto lines: closure and total length are linear in them.

    With unit vectors t_i of the auto lines and the gap g that the other pieces leave: sum of a_i t_i = -g, and with a
    third line sum of a_i = length - rest.
    """
    auto_lines = [i for i, piece in enumerate(pieces) if piece.length == 0.0]
    if not auto_lines:
        return pieces
    location = where(spec, "segments")
    needed = 2 if spec.length is None else 3
    if not spec.closed or len(auto_lines) not in (2, needed):
        raise WorldError(
            f"{len(auto_lines)} auto lines; a closed track needs two, or three if `length` is given; "
            "an open one cannot have any",
            where=location,
        )

    # The other pieces determine the gap and the headings of the auto lines, which do not depend on their lengths.
    rest = [piece for piece in pieces if piece.length > 0.0]
    if not rest or math.fsum(piece.length for piece in rest) > _LONGEST:
        raise WorldError("give other segments beside the auto lines, of 100 km at most", where=location)
    track = Track(rest)
    # Lines do not turn, so that headings are known before their lengths.
    yaws = np.cumsum([0.0] + [piece.turn for piece in pieces])[auto_lines]
    # Closure: the auto lines have to bring the end back to the start, two equations; the total length is a third one.
    gap_x, gap_y, _ = track.end
    matrix, target = np.vstack((np.cos(yaws), np.sin(yaws))), np.array([-gap_x, -gap_y])
    if len(auto_lines) == 3:
        assert spec.length is not None
        matrix, target = np.vstack((matrix, np.ones(3))), np.append(target, spec.length - track.length)
    # Nearly parallel lines would need huge lengths of opposite sign.
    if np.linalg.cond(matrix) > 1e6:
        raise WorldError(
            "the auto lines cannot close the track because they are parallel; choose other ones", where=location
        )
    lengths = np.linalg.solve(matrix, target)
    if (lengths <= 0.0).any():
        text = ", ".join(f"{length:.3f}" for length in lengths)
        raise WorldError(
            f"auto lines would need lengths of {text} m; change the other segments so that all are positive",
            where=location,
        )
    result = list(pieces)
    for index, length in zip(auto_lines, lengths.tolist(), strict=True):
        result[index] = Piece(length, 0.0, 0.0)
    return result
