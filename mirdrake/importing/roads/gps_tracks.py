"""Tracks of GPS receivers as worlds: GPX files, and CSV files with latitude and longitude.

Positions are converted to local metres east and north of the first point (WGS 84, pymap3d). Noise of the receiver is
removed by the smallest amount of smoothing with which a car can follow the line: no radius below 8 m, and no fold of
the road's inner edge.
"""

import csv
import io
import math
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
import pymap3d

from mirdrake.core.errors import ConfigError, WorldError
from mirdrake.core.wording import plural
from mirdrake.core.xml_reader import parse_xml, read_xml_bytes
from mirdrake.core.yaml_io import display_path
from mirdrake.importing.changes import Code
from mirdrake.importing.roads.road_world import RoadWorld, number
from mirdrake.readers.csv_files import read_csv
from mirdrake.readers.tables import Request
from mirdrake.worlds.centre_lines import pieces_through
from mirdrake.worlds.csv_tracks import JUMP
from mirdrake.worlds.pieces import Array, Piece
from mirdrake.worlds.tracks import Track

_LARGEST = 100_000_000  # bytes
_WIDTH = 6.0  # [m] of the road
_RADIUS = 8.0  # [m] smallest radius that a car can follow
_APART = 2.0  # [m] least distance of points
_MOST_POINTS = 3_000
_CLOSED = 25.0  # [m] largest gap of a closed track
_LARGEST_SMOOTH = 20.0  # [m]
_NAMES = {
    "latitude": ("lat", "latitude", "lat_deg", "latitude_deg"),
    "longitude": ("lon", "lng", "long", "longitude", "lon_deg", "longitude_deg"),
    "height": ("ele", "alt", "altitude", "elevation", "height", "altitude_m", "height_m"),
}
_HEIGHT_STEP = 40.0  # [m] between heights, each the mean over twice this distance

_TEXT = """\
# Local metres east and north of {latitude:.8f} deg, {longitude:.8f} deg (WGS 84).
mirdrake: world/1
name: {name}

ground:{ground}

tracks:
  main:
    csv: {{file: {name}/track.csv, right: null, left: null, smooth: {smooth}}}
    closed: {closed}
    width: {width:g}

start:
  line: {{on_track: {{track: main, s: {s}}}}}
"""


def read_gps_world(source: Path, name: str) -> RoadWorld:
    """Return a world with a track along the positions of a GPX or CSV file.

    Raises:
        ConfigError: the file has no such positions, or they do not form a line.
    """
    degrees, lines = _read_gpx(source) if source.suffix.lower() == ".gpx" else _read_csv(source)
    if len(degrees) < 4:
        raise ConfigError(f"{plural(len(degrees), 'position')}; a track needs four or more", where=display_path(source))
    # The map is flat: heights are zero here and become a relief along the track.
    east, north, _ = pymap3d.geodetic2enu(degrees[:, 0], degrees[:, 1], 0.0, degrees[0, 0], degrees[0, 1], 0.0)
    places, indices = _thinned(np.column_stack((east, north)))
    made = RoadWorld("", [source], entries=1)
    if len(places) < 4:
        raise ConfigError(
            f"the positions are within {_APART:g} m of each other; a track needs four", where=display_path(source)
        )
    # Positions far apart, such as the turns of a route, do not tell where the road between them is.
    chords = np.hypot(*np.diff(places, axis=0).T)
    if (far := float(chords.max())) > JUMP[0]:
        line = lines[indices[int(chords.argmax()) + 1]]
        raise ConfigError(
            f"{far:.4g} m from the position before; a track needs at most "
            f"{JUMP[0]:g} m; record the way, or export the route with its shape",
            file=display_path(source),
            line=line,
        )
    if len(indices) < len(degrees):
        why = f"points closer than {_spacing(east, north):.3g} m carry noise only"
        old = f"{len(degrees)}, from line {lines[0]}"
        made.changes.add(Code.ROAD, f"{display_path(source)}:{lines[0]}", "positions", old, str(len(indices)), why)

    # The last point of a closed track may be before, at or beyond the first one.
    closed = math.dist(places[0], places[-1]) < _CLOSED and len(places) > 8
    places = _cut(places) if closed else places
    smooth, pieces = _smallest(places, closed, display_path(source))
    if smooth:
        why = "the smallest amount with which a car can follow the line"
        # The original line would bend more than a car can steer, so that the amount of smoothing is reported.
        made.changes.add(
            Code.ROAD, f"{display_path(source)}:{lines[0]}", "positions", "noisy", f"smoothed by {smooth:g} m", why
        )
    ground = " {surface: grass}"
    heights = degrees[indices[: len(places)], 2]
    # Less than 1 m is noise of the receiver.
    if np.isfinite(heights).all() and np.ptp(heights) > 1.0:
        table = _heights(places, heights, math.fsum(piece.length for piece in pieces), closed)
        ground = f"\n  surface: grass\n  relief:\n    - road: {{along: main, elevation: [{table}]}}"
    text = _TEXT.format(
        latitude=degrees[0, 0], longitude=degrees[0, 1], name=name, ground=ground, smooth=number(smooth),
        closed=str(closed).lower(), width=_WIDTH, s=0 if closed else 5,
    )  # fmt: skip
    rows = io.StringIO()
    writer = csv.writer(rows, lineterminator="\n")
    # Millimetres are far below the accuracy of a receiver and keep the file short.
    writer.writerow(("x_m", "y_m"))
    writer.writerows([(f"{x:.3f}", f"{y:.3f}") for x, y in places])
    made.text, made.files = text, {"track.csv": rows.getvalue().encode()}
    made.checks.append(f"The width of the road, {_WIDTH:g} m, is not in the source.")
    return made


# --- reading ------------------------------------------------------------------------------------------------------


def _read_gpx(source: Path) -> tuple[Array, list[int]]:
    """Return latitude, longitude [deg] and height [m] of the points of a GPX file, N x 3, and their lines.

    The longest track is used, else the longest route, else the waypoints.
    """
    data = read_xml_bytes(source, largest=_LARGEST, error=ConfigError, advice="cut out the part that is needed")
    document = parse_xml(data, display_path(source), error=ConfigError, prefixes=False)
    if document.root.tag != "gpx":
        raise ConfigError(f"<{document.root.tag}> is not GPX, whose root is <gpx>", where=document.where(document.root))
    # A file may contain tracks, routes and single waypoints: the longest list is the line.
    lists = [list(track.iterfind("trkseg/trkpt")) for track in document.root.iterfind("trk")]
    lists += [list(route.iterfind("rtept")) for route in document.root.iterfind("rte")]
    points = max([*lists, list(document.root.iterfind("wpt"))], key=len)

    def read(point: Element) -> tuple[float, float, float]:
        try:
            height = point.findtext("ele")
            return float(point.get("lat", "")), float(point.get("lon", "")), float(height or "nan")
        except ValueError:
            raise ConfigError(
                f"lat and lon of <{point.tag}> should be numbers in deg", where=document.where(point)
            ) from None

    rows = np.array([read(point) for point in points], dtype=float).reshape(-1, 3)
    return _checked(rows, [document.lines[point] for point in points], source)


def _read_csv(source: Path) -> tuple[Array, list[int]]:
    """Return latitude, longitude [deg] and height [m] of the lines of a CSV file, N x 3, and their lines."""
    table = read_csv(Request(source, [name for known in _NAMES.values() for name in known]))
    names = {name.lower(): name for name in table.names}
    columns = {part: next((names[n] for n in known if n in names), None) for part, known in _NAMES.items()}
    # Without a header the columns could be anything; a guess could exchange latitude and longitude.
    if columns["latitude"] is None or columns["longitude"] is None:
        raise ConfigError(
            "no columns of latitude and longitude; name them lat and lon [deg], or give a CSV file in "
            "metres to a track of a world: csv: {file: ...}",
            where=table.name,
        )
    lines = [] if table.lines is None else table.lines.tolist()
    missing = np.full(len(lines), math.nan)
    values = [missing if name is None else table.numbers(name, table.name) for name in columns.values()]
    return _checked(np.column_stack(values), lines, source)


def _checked(rows: Array, lines: list[int], source: Path) -> tuple[Array, list[int]]:
    for row, line in zip(rows, lines, strict=True):
        # The comparison is false for NaN, too.
        if not (abs(row[0]) <= 90.0 and abs(row[1]) <= 360.0):
            raise ConfigError(
                f"{row[0]:g}, {row[1]:g} deg is not a latitude and a longitude", file=display_path(source), line=line
            )
    return rows, lines


# --- the line -----------------------------------------------------------------------------------------------------


def _spacing(x: Array, y: Array) -> float:
    """Return the least distance of points [m]: 2 m, or more for long tracks."""
    return max(_APART, float(np.hypot(np.diff(x), np.diff(y)).sum()) / _MOST_POINTS)


def _thinned(places: Array) -> tuple[Array, list[int]]:
    """Return points at a least distance from the one before, and their numbers."""
    spacing = _spacing(*places.T)
    indices = [0]
    for i in range(1, len(places)):
        if math.dist(places[i], places[indices[-1]]) >= spacing:
            indices.append(i)
    return places[indices], indices


def _cut(places: Array) -> Array:
    """Return a closed track without its overlap: up to the point before its end that is nearest to the start."""
    near = np.hypot(*(places - places[0]).T)
    ahead = (places[1] - places[0]) / np.hypot(*(places[1] - places[0]))
    last = len(places)
    # Points beyond the start, along the first segment, were driven twice.
    while last > 8 and near[last - 1] < _CLOSED and (places[last - 1] - places[0]) @ ahead > -_APART / 2.0:
        last -= 1
    return places[:last]


def _smallest(places: Array, closed: bool, name: str) -> tuple[float, list[Piece]]:
    """Return the smallest smoothing [m] with which a car can follow the line, and its pieces.

    Raises:
        ConfigError: there is none up to 20 m.
    """

    def lay(smooth: float) -> list[Piece] | None:
        try:
            pieces, start = pieces_through(places, closed=closed, smooth=smooth)
        except WorldError:
            return None
        track = Track(pieces, start=start, closed=closed, width=_WIDTH)
        return list(pieces) if track.min_radius >= _RADIUS else None

    if (pieces := lay(0.0)) is not None:
        return 0.0, pieces
    # Doubling finds an upper bound, bisection the smallest amount.
    low, high = 0.0, 0.05
    while (pieces := lay(high)) is None:
        low, high = high, 2.0 * high
        if high > _LARGEST_SMOOTH:
            raise ConfigError(
                f"no smoothing up to {_LARGEST_SMOOTH:g} m gives radii of {_RADIUS:g} m or more; remove "
                "standstills, turns on the spot and outliers",
                where=name,
            )
    # Six halvings: the result is within 1/64 of the interval, far finer than the noise.
    for _ in range(6):
        middle = (low + high) / 2.0
        trial = lay(round(middle, 3))
        if trial is None:
            low = middle
        else:
            high, pieces = round(middle, 3), trial
    return high, pieces


def _heights(places: Array, heights: Array, length: float, closed: bool) -> str:
    """Return the table of heights over the track, above the first one: means over 80 m."""
    ring = np.vstack((places, places[:1])) if closed else places
    s = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(ring, axis=0).T))))
    z = np.append(heights, heights[0]) if closed else heights
    # Distances along the points are scaled to the length of the smoothed track.
    s = s * (length / s[-1])
    stations = np.linspace(0.0, length, max(2, round(length / _HEIGHT_STEP)) + 1)
    grid = np.linspace(-_HEIGHT_STEP, _HEIGHT_STEP, 17)
    # The window continues across the joint of a closed track, and ends with an open one.
    means = [
        np.interp((at + grid) % length if closed else np.clip(at + grid, 0.0, length), s, z).mean() for at in stations
    ]
    if closed:
        stations, means = stations[:-1], means[:-1]
    return ", ".join(f"[{number(at)}, {number(mean - means[0])}]" for at, mean in zip(stations, means, strict=True))
