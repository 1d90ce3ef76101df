"""Relief of the ground, `ground.relief`: heights, graded and banked roads, kerbs, bumps, ramps, potholes, roughness.

Each entry is one layer on the base plane, in the order of the file, with exactly one kind::

    ground:
      relief:
        - grid: {file: hills.png, cell: 1 m, lowest: 0 m, highest: 12 m}
        - road: {along: main, elevation: [[0, 0], [120, 6], [300, 0]], banking: [[0, 0 deg], [60, 4 deg]]}
        - kerb: {along: main, side: right, height: 12 cm}
        - bump: {on_track: {track: main, s: 40}, length: 0.6, height: 75 mm}
        - roughness: {class: B}
        - network: {cell: 1 m}

A kind is one class here and one field of :class:`ReliefSpec`.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import scipy  # it imports its parts when they are first used
from pydantic import Field, model_validator

from mirdrake.core.digest import digest
from mirdrake.core.errors import ConfigError, WorldError
from mirdrake.core.yaml_io import Angle, Length, Schema, where
from mirdrake.ground import Terrain
from mirdrake.ground.crg_files import CrgRoad, read_crg
from mirdrake.ground.height_files import read_heights
from mirdrake.ground.roughness import ROUGHNESS, Roughness, RoughnessClass
from mirdrake.ground.terrain import Block, Grid, Kerb, LayerSource, Plane, Road, Table, Wave
from mirdrake.worlds.networks import Network
from mirdrake.worlds.networks.network_relief import NetworkRelief
from mirdrake.worlds.pieces import Array
from mirdrake.worlds.schema_types import exactly_one, given_one
from mirdrake.worlds.tracks import Track, find_track

Coordinate = Annotated[Length, Field(ge=-1e6, le=1e6)]
Heading = Annotated[Angle, Field(ge=-4.0 * math.pi, le=4.0 * math.pi)]
Size = Annotated[Length, Field(gt=0.0, le=1e4)]
Rise = Annotated[Length, Field(gt=0.0, le=10.0)]
FaceAngle = Annotated[Angle, Field(gt=0.0, le=math.radians(80.0))]

_STEEPEST = math.radians(80.0)
_SPACING = 2.0  # largest distance of the stations of a road [m]
_CRG_ERROR = 1e-3  # largest distance of a road from its file [m]
_STEP_LIMIT = 0.02  # largest step of a road's height where two parts of it meet [m]


class TrackPlace(Schema):
    """A position on a track."""

    track: str = Field(description="name of the track [-]")
    s: Coordinate = Field(default=0.0, description="s along the centre line [m]")
    offset: Coordinate = Field(default=0.0, description="offset to the left of the centre line [m]")


class _Placed(Schema):
    """An obstacle at a pose: `at` and `yaw`, or `on_track`."""

    at: tuple[Coordinate, Coordinate] | None = Field(default=None, description="x and y of its beginning [m]")
    yaw: Heading = Field(default=0.0, description="its direction, from x towards y [rad]")
    on_track: TrackPlace | None = Field(default=None, description="its beginning on a track, along it [-]")

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        exactly_one(self, ("at", "on_track"))
        return self

    def pose(self, tracks: Mapping[str, Track]) -> tuple[float, float, float]:
        """Return x [m], y [m] and yaw [rad] of its beginning."""
        if self.on_track is None:
            assert self.at is not None
            return (*self.at, self.yaw)
        place = self.on_track
        x, y, yaw = find_track(place.track, tracks, where=where(place, "track")).pose_at(place.s)
        return x - place.offset * math.sin(yaw), y + place.offset * math.cos(yaw), yaw + self.yaw


class PlaneRelief(Schema):
    """An inclined plane; gravity stays vertical."""

    grade: float = Field(default=0.0, ge=-1.0, le=1.0, description="rise over run towards `heading` [-]")
    heading: Heading = Field(default=0.0, description="uphill direction, from x towards y [rad]")
    height: Coordinate = Field(default=0.0, description="height at the origin of the world [m]")

    def make(self, tracks: Mapping[str, Track], folder: Path, network: Network | None) -> list[LayerSource]:  # noqa: ARG002
        """Return its layers."""
        return [Plane(self.height, self.grade * math.cos(self.heading), self.grade * math.sin(self.heading))]


class GridRelief(Schema):
    """A grid of heights from a file."""

    file: Annotated[str, Field(min_length=1)] = Field(
        description="NPY, CSV (rows along y), 16-bit PNG (top row: largest y) or OBJ, relative to the world file [-]"
    )
    cell: Annotated[Length, Field(gt=0.0, le=1e3)] = Field(default=1.0, description="spacing of the heights [m]")
    at: tuple[Coordinate, Coordinate] = Field(default=(0.0, 0.0), description="x and y of the first height [m]")
    yaw: Heading = Field(default=0.0, description="direction of the rows [rad]")
    lowest: Coordinate = Field(default=0.0, description="height of black in a PNG; added in other files [m]")
    highest: Coordinate | None = Field(default=None, description="height of white in a PNG [m]")
    interpolation: Literal["smooth", "linear"] = Field(
        default="smooth", description="cubic spline, or bilinear for edges [-]"
    )

    def make(self, tracks: Mapping[str, Track], folder: Path, network: Network | None) -> list[LayerSource]:  # noqa: ARG002
        """Return its layers."""
        z, origin = read_heights(
            folder / self.file,
            cell=self.cell,
            lowest=self.lowest,
            highest=self.highest,
            place=where(self, "file"),
        )
        x, y = self.at[0] + origin[0], self.at[1] + origin[1]
        return [Grid(z, self.cell, x, y, self.yaw, smooth=self.interpolation == "smooth")]


class RoadRelief(Schema):
    """Height and banking along a track; beside its edges the road blends into the ground."""

    along: str = Field(description="name of the track [-]")
    elevation: list[tuple[Coordinate, Coordinate]] | None = Field(
        default=None, description="[[s, height], ...], joined by a smooth curve [m]"
    )
    grade: list[tuple[Coordinate, float]] | None = Field(
        default=None, description="[[s, rise over run], ...], linear in between: parabolic crests and sags [m, -]"
    )
    banking: list[tuple[Coordinate, Angle]] = Field(
        default_factory=list, description="[[s, angle], ...], positive where the left edge is higher [m, rad]"
    )
    shoulder: Annotated[Length, Field(ge=0.0, le=100.0)] = Field(
        default=1.0, description="width beside each edge that continues the road [m]"
    )
    embankment: Annotated[Length, Field(ge=0.1, le=1000.0)] = Field(
        default=10.0, description="length beyond it over which the road blends into the ground [m]"
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.elevation is not None and self.grade is not None:
            raise ValueError("give elevation or grade, not both")
        for name in ("elevation", "grade", "banking"):
            table = getattr(self, name) or []
            if any(b[0] <= a[0] for a, b in pairwise(table)):
                raise ValueError(f"{name}: s must increase from entry to entry")
        if any(abs(angle) > math.radians(60.0) for _, angle in self.banking):
            raise ValueError("banking: an angle must be within 60 deg")
        return self

    def make(self, tracks: Mapping[str, Track], folder: Path, network: Network | None) -> list[LayerSource]:  # noqa: ARG002
        """Return its layers.

        Raises:
            ConfigError: all entries of a table are outside of a closed track.
            WorldError: a closed track does not return to its height, or two parts of it meet at different heights.
        """
        track = find_track(self.along, tracks, where=where(self, "along"))
        s = _stations(track, [row[0] for table in (self.elevation, self.grade, self.banking) for row in table or []])
        # A given grade is integrated to heights; a given elevation is interpolated by a smooth curve.
        if self.grade is not None:
            z, slope = _height_of_grade(self.grade, s)
            if track.closed and abs(z[-1] - z[0]) > 0.01:
                raise WorldError(
                    f"the closed track '{self.along}' ends {z[-1] - z[0]:.2f} m above its "
                    "start; make the mean grade zero",
                    where=where(self, "grade"),
                )
        else:
            z, slope = _smooth(self.elevation or [], s, track, where(self, "elevation"))
        # Banking is a slope across the road: the tangent is interpolated, as heights are proportional to it.
        tangents = [(station, math.tan(angle)) for station, angle in self.banking]
        bank, bank_slope = _smooth(tangents, s, track, where(self, "banking"))
        road = replace(
            _road(track, s),
            z=z,
            slope=slope,
            bank=bank,
            bank_slope=bank_slope,
            shoulder=self.shoulder,
            embankment=self.embankment,
        )
        _check_meeting(road, track, where(self, "embankment"), self.along)
        return [road]


class KerbRelief(Schema):
    """A kerb beside a track."""

    along: str = Field(description="name of the track [-]")
    side: Literal["left", "right"] = Field(description="side of the road [-]")
    height: Rise = Field(default=0.12, description="height of its top [m]")
    slope: FaceAngle = Field(default=math.radians(45.0), description="slope of its faces, at most 80 deg [rad]")
    width: Size = Field(default=0.3, description="width of its top [m]")
    from_: Coordinate | None = Field(default=None, alias="from", description="its start along the track [m]")
    to: Coordinate | None = Field(default=None, description="its end along the track [m]")

    def make(self, tracks: Mapping[str, Track], folder: Path, network: Network | None) -> list[LayerSource]:  # noqa: ARG002
        """Return its layers."""
        track = find_track(self.along, tracks, where=where(self, "along"))
        begin = -math.inf if self.from_ is None else self.from_
        end = math.inf if self.to is None else self.to
        kerb = Kerb(self.side == "left", self.height, self.height / math.tan(self.slope), self.width, begin, end)
        return [replace(_road(track, _stations(track, [])), kerb=kerb, blends=False)]


class BumpRelief(_Placed):
    """A bump across the direction of travel."""

    length: Size = Field(description="length along the direction of travel [m]")
    height: Rise = Field(description="height of its top [m]")
    width: Size = Field(default=3.0, description="width across the direction of travel [m]")
    shape: Literal["sine", "trapezoid"] = Field(default="sine", description="half (1 - cos), or with a flat top [-]")
    slope: FaceAngle = Field(
        default=math.radians(45.0), description="slope of the faces of a trapezoid, and at the sides [rad]"
    )

    def make(self, tracks: Mapping[str, Track], folder: Path, network: Network | None) -> list[LayerSource]:  # noqa: ARG002
        """Return its layers."""
        face = self.height / math.tan(self.slope)
        pose = self.pose(tracks)
        if self.shape == "sine":
            return [Wave(self.height, self.length, self.width, face, *pose)]
        top = self.length - 2.0 * face
        # Both faces must fit into the length; a sine has no faces.
        if top < 0.0:
            raise ConfigError(
                f"{self.length:g} m; two faces of {face:.3g} m need more; make slope steeper",
                where=where(self, "length"),
            )
        return [Block(self.height, face, top, face, self.width, face, *pose)]


class RampRelief(_Placed):
    """A ramp with a top and a drop, for example for jumps."""

    length: Size = Field(description="length of the rise [m]")
    height: Rise = Field(description="height of its top [m]")
    width: Size = Field(default=3.0, description="width across the direction of travel [m]")
    top: Annotated[Length, Field(ge=0.0, le=1e4)] = Field(default=0.0, description="length of its flat top [m]")
    fall: Annotated[Length, Field(ge=0.0, le=1e4)] = Field(default=0.0, description="length of its end; 0: 80 deg [m]")

    def make(self, tracks: Mapping[str, Track], folder: Path, network: Network | None) -> list[LayerSource]:  # noqa: ARG002
        """Return its layers."""
        face = self.height / math.tan(_STEEPEST)
        # A vertical end would have an infinite slope; the steepest allowed face takes its place.
        fall = max(self.fall, face)
        return [Block(self.height, self.length, self.top, fall, self.width, face, *self.pose(tracks))]


class PotholeRelief(_Placed):
    """A hollow with sloping faces."""

    length: Size = Field(description="length along the direction of travel, at the top [m]")
    depth: Rise = Field(description="depth [m]")
    width: Size = Field(default=0.5, description="across, at the top [m]")
    slope: FaceAngle = Field(default=math.radians(60.0), description="slope of its faces [rad]")

    def make(self, tracks: Mapping[str, Track], folder: Path, network: Network | None) -> list[LayerSource]:  # noqa: ARG002
        """Return its layers."""
        face = self.depth / math.tan(self.slope)
        if 2.0 * face > min(self.length, self.width):
            raise ConfigError(
                f"{self.depth:g} m; two faces of {face:.3g} m do not fit into "
                f"{self.length:g} by {self.width:g} m; make it larger or the slope steeper",
                where=where(self, "depth"),
            )
        return [
            Block(-self.depth, face, self.length - 2.0 * face, face, self.width - 2.0 * face, face, *self.pose(tracks))
        ]


class RoughnessRelief(Schema):
    """Random roughness of the whole ground by ISO 8608."""

    class_: RoughnessClass | None = Field(default=None, alias="class", description="A (smooth) to E (rough) [-]")
    density: Annotated[float, Field(gt=0.0, le=1.0)] | None = Field(
        default=None, description="Gd(n0) at 0.1 cycles/m, instead of a class [m³]"
    )
    seed: int = Field(default=0, ge=0, description="seed of its random phases [-]")

    @model_validator(mode="after")
    def _one(self) -> Self:
        exactly_one(self, ("class_", "density"))
        return self

    def make(self, tracks: Mapping[str, Track], folder: Path, network: Network | None) -> list[LayerSource]:  # noqa: ARG002
        """Return its layers."""
        density = self.density if self.class_ is None else ROUGHNESS[self.class_]
        assert density is not None
        return list(Roughness(density, self.seed).grids())


class CrgRelief(Schema):
    """A road of an OpenCRG file: heights, slope and banking along a reference line."""

    file: Annotated[str, Field(min_length=1)] = Field(description="OpenCRG file, relative to the world file [-]")
    at: tuple[Coordinate, Coordinate] | None = Field(
        default=None, description="x and y of the start of the reference line; by default those of the file [m]"
    )
    yaw: Heading | None = Field(default=None, description="its heading there; by default that of the file [rad]")
    height: Coordinate | None = Field(default=None, description="its height there; by default that of the file [m]")
    embankment: Annotated[Length, Field(ge=0.1, le=1000.0)] = Field(
        default=10.0, description="length beside its edges over which it blends into the ground [m]"
    )

    def make(self, tracks: Mapping[str, Track], folder: Path, network: Network | None) -> list[LayerSource]:  # noqa: ARG002
        """Return its layers."""
        road = read_crg(folder / self.file, place=where(self, "file"))
        first = float(road.phi[0])
        turn = 0.0 if self.yaw is None else self.yaw - first
        x, y = (road.x[0], road.y[0]) if self.at is None else self.at
        dx, dy = road.x - road.x[0], road.y - road.y[0]
        rise = 0.0 if self.height is None else self.height - float(road.z[0])
        stations = _crg_stations(road)
        knots = road.step * stations
        return [
            Road(
                s=knots,
                x=(x + math.cos(turn) * dx - math.sin(turn) * dy)[stations],
                y=(y + math.sin(turn) * dx + math.cos(turn) * dy)[stations],
                yaw=road.phi[stations] + turn,
                z=road.z[stations] + rise,
                slope=np.gradient(road.z, road.step)[stations],
                bank=road.banking[stations],
                bank_slope=np.gradient(road.banking, road.step)[stations],
                left=np.full(len(knots), float(road.v[-1])),
                right=np.full(len(knots), -float(road.v[0])),
                shoulder=0.0,
                embankment=self.embankment,
                table=Table(road.heights, road.step, float(road.v[0]), float(road.v[1] - road.v[0])),
            )
        ]


class ReliefSpec(Schema):
    """One layer of the ground."""

    plane: PlaneRelief | None = Field(default=None, description="inclined plane [-]")
    grid: GridRelief | None = Field(default=None, description="grid of heights [-]")
    road: RoadRelief | None = Field(default=None, description="height and banking along a track [-]")
    kerb: KerbRelief | None = Field(default=None, description="kerb beside a track [-]")
    bump: BumpRelief | None = Field(default=None, description="bump [-]")
    ramp: RampRelief | None = Field(default=None, description="ramp [-]")
    pothole: PotholeRelief | None = Field(default=None, description="hollow [-]")
    roughness: RoughnessRelief | None = Field(default=None, description="random roughness [-]")
    network: NetworkRelief | None = Field(default=None, description="heights of the lanes of the network [-]")
    crg: CrgRelief | None = Field(default=None, description="road of an OpenCRG file [-]")

    @model_validator(mode="after")
    def _one(self) -> Self:
        exactly_one(self, tuple(type(self).model_fields))
        return self


def make_relief(
    specs: Sequence[ReliefSpec], tracks: Mapping[str, Track], folder: Path, network: Network | None = None
) -> Terrain:
    """Return the terrain of a world.

    Args:
        specs: entries of `ground.relief`.
        tracks: the tracks of the world, by name.
        folder: folder to which paths of files are relative.
        network: road network of the world.

    Raises:
        ConfigError: an entry has faults.
        WorldError: a road does not fit itself.
    """
    sources: list[LayerSource] = []
    for spec in specs:
        kind: Any = given_one(spec, tuple(ReliefSpec.model_fields))
        sources += kind.make(tracks, folder, network)
    return Terrain(sources)


_FILE_KINDS = ("grid", "crg")  # kinds of layers that read a file


def _file_kind(spec: ReliefSpec) -> str:
    """Return the kind of a layer that reads a file; empty for others."""
    return next((kind for kind in _FILE_KINDS if getattr(spec, kind) is not None), "")


def relief_files(specs: Sequence[ReliefSpec], path: Path | None) -> dict[str, Path]:
    """Return the files of heights, by their names in the world file; `path` as in :func:`relief_content`."""
    folder = path.parent if path is not None else Path.cwd()
    names = [getattr(spec, kind).file for spec in specs if (kind := _file_kind(spec))]
    return {name: folder / name for name in names}


def in_files(specs: Sequence[ReliefSpec], files: Mapping[str, Path]) -> list[ReliefSpec]:
    """Return entries of `ground.relief` with other files of heights, by their names in the world file."""
    result = []
    for spec in specs:
        kind = _file_kind(spec)
        layer = getattr(spec, kind) if kind else None
        if layer is not None and layer.file in files:
            moved = layer.model_copy(update={"file": str(files[layer.file].absolute())})
            result.append(spec.model_copy(update={kind: moved}))
        else:
            result.append(spec)
    return result


def relief_content(specs: Sequence[ReliefSpec], path: Path | None) -> list[Any]:
    """Return the relief as plain data for a lock file, with the digests of its files.

    Args:
        specs: entries of `ground.relief`.
        path: the world file; files are relative to its folder.
    """
    folder = path.parent if path is not None else Path.cwd()
    content: list[Any] = []
    for spec in specs:
        data = spec.model_dump(mode="json", exclude_none=True, by_alias=True)
        kind = _file_kind(spec)
        if kind:
            data[kind]["sha256"] = digest((folder / getattr(spec, kind).file).read_bytes())
        content.append(data)
    return content


# --- roads --------------------------------------------------------------------------------------------------------


def _stations(track: Track, tables: Sequence[float]) -> Array:
    """Return stations of a road: where its centre line or a table has a knot, and between them every 2 m."""
    inner = [s for s in tables if 0.0 < s < track.length]
    # Rounded, so that stations of a table that are also knots of the track occur once.
    knots = np.unique(np.round(np.concatenate([track.stations(sagitta=1e-3, longest=_SPACING), inner]), 6))
    keep = np.concatenate([[True], np.diff(knots) > 1e-3])
    knots = knots[keep]
    # Exactly the ends: rounding moved them, and a closed road must end where it begins.
    knots[0], knots[-1] = 0.0, track.length
    return np.asarray(knots)


def _crg_stations(road: CrgRoad) -> Array:
    """Return the points of a reference line that are stations: the fewest whose spline is within 1 mm of all points.

    Files have a point every few centimetres; each station costs time where a tyre looks for the nearest one.
    """
    count = len(road.x)
    every = max(int(_SPACING / road.step), 1)
    while True:
        chosen = np.unique(np.append(np.arange(0, count, every), count - 1))
        s = road.step * chosen
        lines = [
            scipy.interpolate.CubicHermiteSpline(s, values[chosen], slopes[chosen])(road.step * np.arange(count))
            for values, slopes in (
                (road.x, np.cos(road.phi)),
                (road.y, np.sin(road.phi)),
                (road.z, np.gradient(road.z, road.step)),
                (road.banking * road.v[-1], np.gradient(road.banking, road.step) * road.v[-1]),
            )
        ]
        errors = [
            np.max(np.abs(line - values))
            for line, values in zip(lines, (road.x, road.y, road.z, road.banking * road.v[-1]), strict=True)
        ]
        if every == 1 or max(errors) < _CRG_ERROR:
            return np.asarray(chosen)
        every = max(every // 2, 1)


def _road(track: Track, s: Array) -> Road:
    """Return the flat road of a track."""
    x, y, yaw = track.pose(s)
    if track.closed:
        # A closed track may miss its start by up to 1 mm, which would be a step in the road.
        x[-1], y[-1] = x[0], y[0]
    none = np.zeros_like(s)
    return Road(s, x, y, yaw, none, none, none, none, track.left_width(s), track.right_width(s), closed=track.closed)


def _smooth(table: Sequence[tuple[float, float]], s: Array, track: Track, place: str) -> tuple[Array, Array]:
    """Return values and derivatives of a table at stations: monotone cubic (PCHIP), periodic on a closed track."""
    if not table:
        return np.zeros_like(s), np.zeros_like(s)
    knots, values = (np.array(column, dtype=float) for column in zip(*table, strict=True))
    if track.closed:
        inside = (knots >= 0.0) & (knots < track.length)
        if not inside.any():
            raise ConfigError(
                f"no s is on the closed track '{track.name}', from 0 to {track.length:.4g} m", where=place
            )
        knots, values = knots[inside], values[inside]
        # Three laps, of which the middle one is used: the curve is smooth across the start.
        knots = np.concatenate([knots + lap * track.length for lap in (-1, 0, 1)])
        values = np.tile(values, 3)
    if len(knots) < 2:
        return np.full_like(s, values[0]), np.zeros_like(s)
    curve = scipy.interpolate.PchipInterpolator(knots, values)
    # Constant before the first and after the last entry; extrapolated cubics would run away.
    within = np.clip(s, knots[0], knots[-1])
    outside = within != s
    return np.asarray(curve(within)), np.where(outside, 0.0, curve(within, 1))


def _height_of_grade(table: Sequence[tuple[float, float]], s: Array) -> tuple[Array, Array]:
    """Return heights and grades at stations; the grade is linear between the entries, so heights are exact."""
    knots, values = (np.array(column, dtype=float) for column in zip(*table, strict=True))
    grade = np.interp(s, knots, values)
    # The trapezoidal rule is exact, because stations include all entries and the grade is linear between them.
    z = np.concatenate([[0.0], np.cumsum(0.5 * (grade[1:] + grade[:-1]) * np.diff(s))])
    return z, np.asarray(grade)


def _check_meeting(road: Road, track: Track, place: str, name: str) -> None:
    """Check that parts of a road that come close to each other have the same height where they meet.

    Raises:
        WorldError: there is a step.
    """
    for side, width in ((1.0, road.left), (-1.0, road.right)):
        for beyond in (0.25, 0.5, 0.75):
            # Points on the embankment, where another part of the road may be nearer than their own one.
            reach = width + road.shoulder + beyond * road.embankment
            x, y = track.point(road.s, side * reach)
            nearest, offset = track.project(np.asarray(x), np.asarray(y))
            # Nearer to another part than to their own.
            other = np.abs(offset) < reach - 0.05
            weight = 1.0 - beyond**2 * (3.0 - 2.0 * beyond)
            step = np.abs(
                np.interp(nearest, road.s, road.z) - road.z
                + np.interp(nearest, road.s, road.bank) * offset - road.bank * side * reach
            )  # fmt: skip
            worst = int(np.argmax(np.where(other, weight * step, 0.0)))
            if other[worst] and weight * step[worst] > _STEP_LIMIT:
                raise WorldError(
                    f"{road.embankment:g} m; beside s = {road.s[worst]:.0f} m the track '{name}' meets "
                    f"itself at s = {nearest[worst]:.0f} m with a step of {weight * step[worst]:.2f} m; make the "
                    "embankment shorter",
                    where=place,
                )
