"""A world laid out: from the world file to tracks, starts and ground.

::

    worlds/<name>.yaml ── load_world ──► WorldSpec ── make_world ──► World(tracks, starts, ground)
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import ArrayLike

from mirdrake.errors import ConfigError, WorldError, did_you_mean
from mirdrake.paths import find
from mirdrake.worlds.spec import GroundSpec, StartSpec, TrackSpec, WorldSpec
from mirdrake.worlds.tracks import Array, Piece, Track
from mirdrake.yaml_io import load_yaml, where

SURFACE_MU = {"asphalt": 0.85, "concrete": 0.85, "gravel": 0.6, "grass": 0.5, "ice": 0.1}
"""Friction coefficients of dry surfaces [-]: asphalt and concrete (0.8 .. 0.9), gravel and ice are peak values of
J. Y. Wong, "Theory of Ground Vehicles", table of average road adhesion (after Taborek); grass is an estimate."""

GRAVITY = 9.80665
"""Standard gravity [m/s²]."""

_GAP_LENGTH, _GAP_ANGLE = 1e-3, math.radians(0.01)
_MARGIN = 50.0  # [m] ground beyond the tracks
_VERGE = 2.0  # [m]
_LONGEST = 1e5  # [m] longest track
_BARE_SIZE = 400.0  # [m] side of the ground of a world without tracks


@dataclass(frozen=True)
class Start:
    """A place to start from: pose of the vehicle's frame B in W and its forward speed."""

    x: float
    """[m]"""
    y: float
    """[m]"""
    yaw: float
    """[rad], within ±π"""
    speed: float = 0.0
    """[m/s]"""
    track: str | None = None
    """track it stands on, if it was placed by `on_track`"""
    s: float | None = None
    """along that track [m]"""


@dataclass(frozen=True)
class Ground:
    """The base plane z = 0."""

    surface: str
    """what it looks like"""
    mu: float
    """friction coefficient beside the tracks [-]"""
    extent: tuple[float, float, float, float]
    """smallest x, smallest y, largest x, largest y [m]; starts lie within, and the visible ground ends there"""
    grade: float = 0.0
    """rise over run [-]"""
    heading: float = 0.0
    """uphill direction [rad]"""

    @property
    def gravity(self) -> Array:
        """Gravity in W [m/s²]: W stays on the road plane; a slope of angle a tilts gravity by a, towards downhill."""
        angle = math.atan(self.grade)
        downhill = GRAVITY * math.sin(angle)
        return np.array(
            [-downhill * math.cos(self.heading), -downhill * math.sin(self.heading), -GRAVITY * math.cos(angle)]
        )

    def check_place(self, x: float, y: float, *, where: str) -> None:
        """Refuse a place to start from that is not on the ground.

        Raises:
            WorldError: it is outside; `where` is put before the message.
        """
        xmin, ymin, xmax, ymax = self.extent
        if not (xmin <= x <= xmax and ymin <= y <= ymax):
            raise WorldError(
                f"{where}: start outside the world: ({x:g}, {y:g}) m; the ground reaches from "
                f"({xmin:g}, {ymin:g}) to ({xmax:g}, {ymax:g}) m; move the start or set ground.size"
            )


@dataclass(frozen=True)
class World:
    """A world laid out."""

    name: str
    spec: WorldSpec
    path: Path | None
    """file it was read from"""
    tracks: dict[str, Track] = field(default_factory=dict)
    starts: dict[str, Start] = field(default_factory=dict)
    ground: Ground = field(
        default_factory=lambda: Ground("asphalt", SURFACE_MU["asphalt"], (-200.0, -200.0, 200.0, 200.0))
    )

    @property
    def road_mu(self) -> float:
        """Friction coefficient of the physical plane [-]: that of the first track, or of the ground without tracks."""
        return track_mu(next(iter(self.spec.tracks.values()))) if self.tracks else self.ground.mu

    def mu(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Friction coefficient [-] at points (world x, y [m], any shape).

        That of the last track they are on, else of a verge (`edges`), else of the ground.
        """
        x, y = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
        value = np.full(x.shape, self.ground.mu)
        for name, track in self.tracks.items():
            edges = self.spec.tracks[name].edges
            if edges is not None and edges != self.ground.surface:
                value[shapely.contains_xy(verge(track), x, y)] = SURFACE_MU[edges]
        for name, track in self.roads().items():
            value[track.inside(x, y)] = track_mu(self.spec.tracks[name])
        return value

    def on_road(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Whether points (world x, y [m], any shape) are on a track; everywhere in a world without tracks."""
        x, y = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
        value = np.full(x.shape, not self.roads())
        for track in self.roads().values():
            value |= track.inside(x, y)
        return value

    def roads(self) -> dict[str, Track]:
        """The tracks that are roads, by name."""
        return {name: track for name, track in self.tracks.items() if self.spec.tracks[name].road}

    def start(self, name: str, *, where: str = "") -> Start:
        """The start of that name.

        Raises:
            ConfigError: there is none; `where` is put before the message.
        """
        if name not in self.starts:
            prefix = f"{where}: " if where else ""
            raise ConfigError(f"{prefix}world '{self.name}' has no start '{name}'; {did_you_mean(name, self.starts)}")
        return self.starts[name]

    def track(self, name: str, *, where: str = "") -> Track:
        """The track of that name.

        Raises:
            ConfigError: there is none; `where` is put before the message.
        """
        if name not in self.tracks:
            prefix = f"{where}: " if where else ""
            raise ConfigError(f"{prefix}world '{self.name}' has no track '{name}'; {did_you_mean(name, self.tracks)}")
        return self.tracks[name]


def load_world(name: str, *, where: str = "", overrides: Iterable[str] = ()) -> World:
    """The world of that name or file.

    Args:
        name: a name below worlds/ or a path of a YAML file.
        where: prefix of the message when there is no such world, for example ``"drive.yaml:3: world"``.
        overrides: ``"dotted.path=value"`` texts, see :func:`mirdrake.yaml_io.parse_yaml`.

    Raises:
        ConfigError: no such world, or the file has faults.
        WorldError: the world cannot be laid out.
    """
    path = find("worlds", name, where=where)
    return make_world(load_yaml(path, WorldSpec, overrides=overrides), path=path)


def make_world(spec: WorldSpec, *, path: Path | None = None) -> World:
    """A world from its description.

    Args:
        spec: the checked description.
        path: the file it came from.

    Raises:
        WorldError: a track does not close or folds in its bends, a length is wrong, a start is outside the world; all
            faults, one per line.
    """
    faults: list[str] = []

    # Tracks: pieces from segments, lengths of the auto lines, then the checks.
    tracks: dict[str, Track] = {}
    for name, track_spec in spec.tracks.items():
        try:
            tracks[name] = make_track(track_spec, name=name)
        except WorldError as error:
            faults.append(str(error))
    if faults:
        raise WorldError("\n".join(faults))

    # Ground: as large as the tracks need.
    ground = _make_ground(spec.ground, tracks)

    # Starts, then the names in the goals.
    starts: dict[str, Start] = {}
    for name, start_spec in (spec.start or {"origin": StartSpec()}).items():
        try:
            starts[name] = _make_start(start_spec, tracks, ground)
        except WorldError as error:
            faults.append(str(error))
    faults += [
        f"{where(gate, 'track')}: unknown track '{gate.track}'; {did_you_mean(gate.track, tracks)}"
        for gate in (goal.gate for goal in spec.goals.values())
        if gate is not None and gate.track not in tracks
    ]
    if faults:
        raise WorldError("\n".join(faults))
    return World(spec.name or (path.stem if path else "world"), spec, path, tracks, starts, ground)


def make_track(spec: TrackSpec, *, name: str = "track") -> Track:
    """A track from its description.

    Args:
        spec: the checked description.
        name: for messages.

    Raises:
        WorldError: it does not close, its inner edge folds, its length is wrong, or auto lines have no solution.
    """
    start = (*spec.start.at, spec.start.yaw)
    pieces = _solve_auto_lines(spec, _pieces_of(spec))
    total = math.fsum(piece.length for piece in pieces)
    if not 0.1 <= (spec.length or total) <= _LONGEST:
        raise WorldError(f"{where(spec)}: {spec.length or total:g} m long; a track may have from 0.1 m to 100 km")
    if spec.length is not None and abs(spec.length / total - 1.0) > 1e-12:
        scale = spec.length / total
        pieces = [Piece(p.length * scale, p.start_curvature / scale, p.end_curvature / scale) for p in pieces]
    track = Track(pieces, start=start, closed=spec.closed, width=spec.width, name=name)
    gap, angle = track.gap
    if spec.closed and (gap > _GAP_LENGTH or abs(angle) > _GAP_ANGLE):
        raise WorldError(
            f"{where(spec)}: does not close: gap {gap:.3g} m, {abs(math.degrees(angle)):.3g} deg; allowed are 1 mm and "
            "0.01 deg; make the turns add up to 360 deg and two lines that are not parallel auto, or set closed: false"
        )
    if track.min_radius <= spec.width / 2.0:
        raise WorldError(
            f"{where(spec)}: the inner edge folds: smallest radius {track.min_radius:.3g} m, width "
            f"{spec.width:.3g} m; make the radius larger than half the width"
        )
    if spec.check_length is not None and abs(track.length - spec.check_length[0]) > spec.check_length[1]:
        wanted, tolerance = spec.check_length
        raise WorldError(
            f"{where(spec, 'check_length')}: the track is {track.length:.6f} m long; {wanted:g} +- {tolerance:g} m was "
            "asked; change a segment, or let `length` scale it"
        )
    return track


# --- the inner parts ---------------------------------------------------------------------------------------------


def _pieces_of(spec: TrackSpec) -> list[Piece]:
    """Pieces of a centre line; auto lines have length 0."""
    pieces: list[Piece] = []
    for segment in spec.segments:
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


def _make_ground(spec: GroundSpec, tracks: dict[str, Track]) -> Ground:
    mu = SURFACE_MU[spec.surface] if spec.mu is None else spec.mu
    if tracks:
        boxes = np.array([track.bounds for track in tracks.values()])
        low, high = boxes[:, :2].min(axis=0) - _MARGIN, boxes[:, 2:].max(axis=0) + _MARGIN
    else:
        low, high = np.full(2, -_BARE_SIZE / 2.0), np.full(2, _BARE_SIZE / 2.0)
    if spec.size is not None:
        middle, half = (low + high) / 2.0, np.array(spec.size) / 2.0
        low, high = middle - half, middle + half
    extent = (float(low[0]), float(low[1]), float(high[0]), float(high[1]))
    return Ground(spec.surface, mu, extent, spec.slope.grade, spec.slope.heading)


def _make_start(spec: StartSpec, tracks: dict[str, Track], ground: Ground) -> Start:
    if spec.on_track is None:
        x, y = spec.at or (0.0, 0.0)
        ground.check_place(x, y, where=where(spec, "at"))
        return Start(x, y, _folded(spec.yaw or 0.0), spec.speed)
    on_track = spec.on_track
    if on_track.track not in tracks:
        raise WorldError(
            f"{where(spec, 'on_track', 'track')}: unknown track '{on_track.track}'; "
            f"{did_you_mean(on_track.track, tracks)}"
        )
    track = tracks[on_track.track]
    if not 0.0 <= on_track.s <= track.length:
        raise WorldError(
            f"{where(spec, 'on_track', 's')}: start outside the world: s = {on_track.s:g} m; the track is "
            f"{track.length:g} m long"
        )
    if abs(on_track.offset) > track.width / 2.0:
        raise WorldError(
            f"{where(spec, 'on_track', 'offset')}: start outside the world: {on_track.offset:g} m beside the centre "
            f"line; the road is {track.width:g} m wide; make it at most {track.width / 2.0:g} m"
        )
    x, y, yaw = track.pose_at(on_track.s)
    x, y = x - on_track.offset * math.sin(yaw), y + on_track.offset * math.cos(yaw)
    return Start(x, y, _folded(yaw), spec.speed, on_track.track, on_track.s)


def _folded(angle: float) -> float:
    """The angle within [-π, π]."""
    return math.remainder(angle, 2.0 * math.pi)


def verge(track: Track) -> shapely.Geometry:
    """The road and a verge of 2 m on both sides, as a polygon."""
    return shapely.buffer(track.area, _VERGE)


def track_mu(spec: TrackSpec) -> float:
    """Friction coefficient of a track [-]: as given, or that of its surface."""
    return SURFACE_MU[spec.surface] if spec.mu is None else spec.mu
