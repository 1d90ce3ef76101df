"""Tracks from their description: pieces from segments, points or files, widths, and the checks."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import shapely

from mirdrake.core.errors import ConfigError, WorldError, did_you_mean
from mirdrake.core.yaml_io import shown, where
from mirdrake.worlds.centre_lines import edges_from_widths, pieces_through
from mirdrake.worlds.csv_lines import read_csv_track
from mirdrake.worlds.opendrive import read_opendrive
from mirdrake.worlds.pieces import Array, Piece, Placement
from mirdrake.worlds.spec import CsvSpec, TrackSpec, XodrSpec
from mirdrake.worlds.tracks import Edges, Track

_GAP_LENGTH, _GAP_ANGLE = 1e-3, math.radians(0.01)
_LONGEST = 1e5  # [m] longest track
_FARTHEST = 1e6  # [m] from the origin
_USUAL_WIDTH = 3.0  # [m]
_MOST_POINTS = 4_000  # that a centre line is smoothed at


@dataclass(frozen=True)
class _Line:
    """A centre line with what its source says of it."""

    pieces: list[Piece]
    start: Placement
    closed: bool
    edges: Edges | None = None
    """of a file with widths"""
    near: Callable[[float], str] = lambda _: ""
    """names the entry of the source that is nearest to s [m], ' (...)'"""
    notes: tuple[str, ...] = ()
    smoothed: Callable[[float, float], "_Line"] | None = None
    """the same line, smoothed by a root mean square [m] at a spacing of points [m]; None: it is stated exactly"""
    points: Array = field(default_factory=lambda: np.empty((0, 2)))
    """of the source [m]"""


def make_track(spec: TrackSpec, *, name: str = "track", folder: Path | None = None) -> Track:
    """A track from its description.

    Args:
        spec: the checked description.
        name: for messages.
        folder: where its files are looked for; default: the working directory.

    Raises:
        ConfigError: a file is not there, or has faults.
        WorldError: it does not close, it crosses itself, its inner edge folds, its length is wrong, or auto lines have
            no solution.
    """
    if spec.points is not None:
        line = _from_points(spec)
    elif spec.csv is not None:
        line = _from_csv(spec, spec.csv, folder or Path())
    elif spec.xodr is not None:
        line = _from_xodr(spec, spec.xodr, folder or Path())
    else:
        line = _from_segments(spec)
    start = line.start if spec.start is None else (*spec.start.at, spec.start.yaw)
    total = math.fsum(piece.length for piece in line.pieces)
    if not 0.1 <= total <= _LONGEST:
        raise WorldError(f"{where(spec)}: {total:g} m long; a track may have from 0.1 m to 100 km")
    if max(abs(start[0]), abs(start[1])) > _FARTHEST:
        raise WorldError(
            f"{where(spec)}: begins at ({start[0]:g}, {start[1]:g}) m, too far from the origin; set start to move it, "
            "for example start: {at: [0, 0]}"
        )
    track = _lay(spec, line, total, name)
    if line.smoothed is not None and (fold := track.folds()) is not None:
        line, track = _unfold(spec, line, track, fold)
    _check(spec, track, line)
    return track


def _lay(spec: TrackSpec, line: _Line, given: float, name: str) -> Track:
    """Return the road along a centre line; `given` is the length [m] that the stations of its widths refer to."""
    start = line.start if spec.start is None else (*spec.start.at, spec.start.yaw)
    total = math.fsum(piece.length for piece in line.pieces)
    width, edges = _USUAL_WIDTH, line.edges
    if isinstance(spec.width, float):
        width, edges = spec.width, None
    elif spec.width is not None:
        s, left, right = _edges_of(spec, spec.width, given, line.closed)
        edges = np.asarray(s) * (total / given), left, right
    return Track(line.pieces, start=start, closed=line.closed, width=width, edges=edges, name=name, notes=line.notes)


def _unfold(spec: TrackSpec, line: _Line, track: Track, fold: float) -> tuple[_Line, Track]:
    """Smooth a centre line through points by the smallest amount after which its inner edge does not fold.

    The points are smoothed at a spacing of an eighth of the width. Where a point would be more than half the width off
    the centre line, the line and the track stay as they are.

    Args:
        spec: of the track.
        line: through the points.
        track: along that line.
        fold: where its inner edge folds [m].
    """
    assert line.smoothed is not None
    spacing = max(track.width / 8.0, track.length / _MOST_POINTS)
    amount, low, high = track.width / 512.0, 0.0, math.inf
    best = line, track
    # Doubled until there is no fold, then bisected.
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


# --- where the centre line comes from ----------------------------------------------------------------------------


def _from_segments(spec: TrackSpec) -> _Line:
    pieces = _solve_auto_lines(spec, _pieces_of(spec))
    total = math.fsum(piece.length for piece in pieces)
    if not 0.1 <= (spec.length or total) <= _LONGEST:
        raise WorldError(f"{where(spec)}: {spec.length or total:g} m long; a track may have from 0.1 m to 100 km")
    if spec.length is not None and abs(spec.length / total - 1.0) > 1e-12:
        scale = spec.length / total
        pieces = [Piece(p.length * scale, p.start_curvature / scale, p.end_curvature / scale) for p in pieces]
    return _Line(pieces, (0.0, 0.0, 0.0), bool(spec.closed))


def _from_points(spec: TrackSpec) -> _Line:
    points = np.array(spec.points, dtype=float)

    def lay(smooth: float, spacing: float) -> _Line:
        pieces, start = pieces_through(points, closed=bool(spec.closed), smooth=smooth, spacing=spacing)
        near = _nearest(pieces, start, points, "point {}", range(1, 10_001))
        return _Line(pieces, start, bool(spec.closed), near=near, points=points)

    try:
        _check_extent(points)
        return replace(lay(0.0, math.inf), smoothed=lay)
    except WorldError as error:
        raise WorldError(f"{where(spec, 'points')}: {error}") from None


def _from_csv(spec: TrackSpec, csv: CsvSpec, folder: Path) -> _Line:
    path, place = _find_file(csv, folder, "csv"), where(spec, "csv")
    if (csv.right is None) != (csv.left is None):
        raise ConfigError(f"{place}: right and left belong together; name both columns, or set both null")
    columns = {"x": csv.x, "y": csv.y, "right": csv.right, "left": csv.left}
    try:
        table = read_csv_track(path, **columns, scale=csv.scale)  # type: ignore[arg-type]
        closed = table.closed_guess if spec.closed is None else spec.closed
        if closed and not table.closed_guess:
            gap = math.dist(table.points[0], table.points[-1])
            ahead = [math.atan2(*(b - a)[::-1]) for a, b in (table.points[:2], table.points[-2:])]
            turn = abs(math.degrees(math.remainder(ahead[0] - ahead[1], 2.0 * math.pi)))
            raise ConfigError(
                f"{shown(path)}:{table.lines[-1]}: does not close: gap {gap:.3g} m, {turn:.3g} deg from the last point "
                "to the first; add the missing points, or leave out closed: true"
            )
        _check_extent(table.points)

        def lay(smooth: float, spacing: float) -> _Line:
            smooth = math.hypot(csv.smooth, smooth)
            pieces, start = pieces_through(table.points, closed=closed, smooth=smooth, spacing=spacing)
            edges = None
            if table.left is not None and table.right is not None and spec.width is None:
                bare = Track(pieces, start=start, closed=closed)
                edges = edges_from_widths(bare, table.points, table.left, table.right)
            near = _nearest(pieces, start, table.points, f"{shown(path)}:{{}}", table.lines)
            return _Line(pieces, start, closed, edges, near, points=table.points)

        return replace(lay(0.0, math.inf), smoothed=lay)
    except ConfigError as error:
        raise ConfigError(f"{place}: {error}") from None
    except WorldError as error:
        raise WorldError(f"{place}: {shown(path)}: {error}") from None


def _from_xodr(spec: TrackSpec, xodr: XodrSpec, folder: Path) -> _Line:
    path = _find_file(xodr, folder, "xodr")
    try:
        road = read_opendrive(path, road=None if xodr.road is None else str(xodr.road), lane=str(xodr.lane))
    except ConfigError as error:
        raise ConfigError(f"{where(spec, 'xodr')}: {error}") from None
    closed = road.closed if spec.closed is None else spec.closed
    edges = road.edges if not closed or road.closed else None  # a gap is told before widths are compared
    return _Line(road.pieces, road.start, closed, edges, notes=tuple(road.left_out))


def _find_file(spec: CsvSpec | XodrSpec, folder: Path, suffix: str) -> Path:
    """The file of a track.

    Raises:
        ConfigError: there is none.
    """
    path = folder / spec.file
    try:
        if path.is_file():
            return path
        beside = [file.name for file in path.parent.glob(f"*.{suffix}")] if path.parent.is_dir() else []
    except (OSError, ValueError):  # a name that is too long, or holds a zero byte
        beside = []
    hint = did_you_mean(Path(spec.file).name, beside) if beside else "give its place relative to the world file"
    raise ConfigError(f"{where(spec, 'file')}: no such file: {spec.file[:200]!r}; {hint}")


def _check_extent(points: Array) -> None:
    """Refuse points before a curve is laid through them that is far too long."""
    total = float(np.hypot(*np.diff(points, axis=0).T).sum())
    if total > _LONGEST:
        raise WorldError(f"{total:.3g} m from the first point to the last; a track may have from 0.1 m to 100 km")


def _nearest(
    pieces: list[Piece], start: Placement, points: Array, name: str, numbers: list[int] | range
) -> Callable[[float], str]:
    """What tells the point nearest to a place of the centre line."""

    def tell(s: float) -> str:
        x, y, _ = Track(pieces, start=start).pose_at(s)
        at = int(np.argmin(np.hypot(points[:, 0] - x, points[:, 1] - y)))
        return f" ({name.format(numbers[at])})"

    return tell


# --- widths and checks -------------------------------------------------------------------------------------------


def _edges_of(spec: TrackSpec, widths: list[tuple[float, float]], length: float, closed: bool) -> Edges:
    """Edges of a road whose width is given at some places.

    Raises:
        WorldError: a place is beyond the end, or the width is not the same at both ends of a closed track.
    """
    s, width = np.array(widths).T
    if s[-1] > length * (1.0 + 1e-9):
        at = int(np.argmax(s > length))
        raise WorldError(f"{where(spec, 'width', at)}: s = {s[at]:g} m; the track is {length:.6g} m long")
    s = np.minimum(s, length)
    if closed and s[0] == 0.0 and s[-1] >= length * (1.0 - 1e-9):
        if abs(width[0] - width[-1]) > 1e-6:
            raise WorldError(
                f"{where(spec, 'width')}: {width[0]:g} m at s = 0 and {width[-1]:g} m at the end of a closed track; "
                "make them equal"
            )
        s, width = s[:-1], width[:-1]
    stations = np.unique(np.concatenate(([0.0], s, [length])))
    half = np.interp(stations, s, width, period=length if closed else None) / 2.0
    return stations, half, half


def _check(spec: TrackSpec, track: Track, line: _Line) -> None:
    """What must hold for every track.

    Raises:
        WorldError: it does not.
    """
    varying, (gap, angle) = track.edges is not None, track.gap
    if track.closed and (gap > _GAP_LENGTH or abs(angle) > _GAP_ANGLE):
        advice = "make the turns add up to 360 deg and two lines that are not parallel auto, or set closed: false"
        raise WorldError(
            f"{where(spec)}: does not close: gap {gap:.3g} m, {abs(math.degrees(angle)):.3g} deg; allowed are 1 mm and "
            f"0.01 deg; {advice if spec.segments is not None else 'leave out closed: true'}"
        )
    if not varying and track.min_radius <= track.width / 2.0:
        place = line.near(track.sharpest())
        raise WorldError(
            f"{where(spec)}: the inner edge folds: smallest radius {track.min_radius:.3g} m{place}, width "
            f"{track.width:.3g} m; make the radius larger than half the width"
        )
    if varying and (fold := track.folds()) is not None:
        k = track.curvature_at(fold)
        side = float(track.left_width(fold) if k > 0.0 else track.right_width(fold))
        raise WorldError(
            f"{where(spec)}: the inner edge folds at s = {fold:.6g} m{line.near(fold)}: radius {abs(1.0 / k):.3g} m, "
            f"but the edge is {side:.3g} m away; make the road narrower there"
            + (", or raise csv.smooth" if spec.csv is not None else "")
        )
    if spec.road and not spec.crossing and (crossing := _first_crossing(track)) is not None:
        first, second = crossing
        x, y, _ = track.pose_at(first)
        raise WorldError(
            f"{where(spec)}: crosses itself at ({x:.4g}, {y:.4g}) m: s = {first:.4g} m{line.near(first)} and "
            f"{second:.4g} m{line.near(second)}; correct it, or set crossing: true if it shall, as a figure of eight"
        )
    if spec.check_length is not None and abs(track.length - spec.check_length[0]) > spec.check_length[1]:
        wanted, tolerance = spec.check_length
        how = "change a segment, or let `length` scale it" if spec.segments is not None else "correct the points"
        raise WorldError(
            f"{where(spec, 'check_length')}: the track is {track.length:.6f} m long; {wanted:g} +- {tolerance:g} m was "
            f"asked; {how}"
        )


def _first_crossing(track: Track) -> tuple[float, float] | None:
    """Where [m], twice, the centre line meets itself; None if it does not. That its ends meet does not count."""
    s = track.stations(sagitta=1e-3)
    points = np.column_stack(track.point(np.append(s[:-1], 0.0) if track.closed else s))
    chords = np.asarray(shapely.linestrings(np.stack((points[:-1], points[1:]), axis=1)))
    one, other = shapely.STRtree(chords).query(chords, predicate="intersects")
    apart = other - one
    apart = np.minimum(apart, len(chords) - apart) if track.closed else apart
    met = (other > one) & (apart > 1)
    one, other = one[met], other[met]
    places = shapely.get_coordinates(shapely.centroid(shapely.intersection(chords[one], chords[other])))
    ends = [np.hypot(*(places - points[at]).T) < _GAP_LENGTH for at in (0, -1)]
    touching = (one == 0) & (other == len(chords) - 1) & ends[0] & ends[1]
    one, other, places = one[~touching], other[~touching], places[~touching]
    if not one.size:
        return None
    first = int(np.argmin(one))
    found = [float(s[i[first]] + np.hypot(*(places[first] - points[i[first]]))) for i in (one, other)]
    return found[0], found[1]


# --- segments ----------------------------------------------------------------------------------------------------


def _pieces_of(spec: TrackSpec) -> list[Piece]:
    """Pieces of a centre line; auto lines have length 0."""
    pieces: list[Piece] = []
    for segment in spec.segments or ():
        if segment.line is not None:
            pieces.append(Piece(0.0 if segment.line == "auto" else segment.line, 0.0, 0.0))
        elif segment.arc is not None:
            arc = segment.arc
            k = math.copysign(1.0 / arc.radius, arc.angle)
            clothoid = 2.0 * arc.radius * arc.transition  # length over which 0 -> 1/R turns `transition`
            rest = max(0.0, abs(arc.angle) - 2.0 * arc.transition)
            if clothoid:
                pieces.append(Piece(clothoid, 0.0, k))
            if rest > 1e-12:
                pieces.append(Piece(arc.radius * rest, k, k))
            if clothoid:
                pieces.append(Piece(clothoid, k, 0.0))
        elif segment.clothoid is not None:
            pieces.append(Piece(segment.clothoid.arc_length, *segment.clothoid.curvatures))
    return pieces


def _solve_auto_lines(spec: TrackSpec, pieces: list[Piece]) -> list[Piece]:
    """Lengths of the auto lines: position closure is linear in them, and so is the total length.

    With unit vectors t_i of the auto lines and the gap g that the other pieces leave: sum of a_i t_i = -g, and with a
    third line sum of a_i = length - rest.
    """
    unknown = [i for i, piece in enumerate(pieces) if piece.length == 0.0]
    if not unknown:
        return pieces
    place = where(spec, "segments")
    wanted = 2 if spec.length is None else 3
    if not spec.closed or len(unknown) not in (2, wanted):
        raise WorldError(
            f"{place}: {len(unknown)} auto lines; a closed track takes two, or three when `length` is given; "
            "an open one none"
        )
    rest = [piece for piece in pieces if piece.length > 0.0]
    if not rest or math.fsum(piece.length for piece in rest) > _LONGEST:
        raise WorldError(f"{place}: besides the auto lines there must be bends, and at most 100 km")
    track = Track(rest)
    yaws = np.cumsum([0.0] + [piece.turn for piece in pieces])[unknown]
    gap_x, gap_y, _ = track._end
    matrix, target = np.vstack((np.cos(yaws), np.sin(yaws))), np.array([-gap_x, -gap_y])
    if len(unknown) == 3:
        assert spec.length is not None
        matrix, target = np.vstack((matrix, np.ones(3))), np.append(target, spec.length - track.length)
    if np.linalg.cond(matrix) > 1e6:
        raise WorldError(f"{place}: the auto lines cannot close the track, for they are parallel; choose others")
    lengths = np.linalg.solve(matrix, target)
    if (lengths <= 0.0).any():
        found = ", ".join(f"{length:.3f}" for length in lengths)
        raise WorldError(
            f"{place}: auto lines would need lengths of {found} m; change the other segments so that all are positive"
        )
    result = list(pieces)
    for index, length in zip(unknown, lengths.tolist(), strict=True):
        result[index] = Piece(length, 0.0, 0.0)
    return result
