"""The world language `world/1`: format of a world file.

Lengths are in m and angles in rad once loaded; in the file they may have a unit (``90 deg``). x forward, y left, z up;
a positive angle, curvature or signed radius turns left.

A track is given in one of five ways. `segments` are laid end to end with a common tangent:

* ``{line: 40}`` is a straight; the length of ``{line: auto}`` is computed. Two auto lines close a closed track; a third
  one gives it the length `length`.
* ``{arc: {radius: 20, angle: 90 deg}}`` is a circular arc; a positive angle turns left.
  ``transition: 20 deg`` puts a clothoid at both ends, each turning that part of the angle, for continuous curvature.
* ``{clothoid: {from_radius: straight, to_radius: -30, length: 25}}`` has a curvature that changes linearly. Its radii
  are signed (+ left); `straight` (or `inf`) means zero curvature. Instead of `length`, `angle` may be given: its signed
  heading change.

``points: [[0, 0], [40, 5], ...]`` are joined by a smooth curve; ``csv: monza.csv`` or ``csv: {file: monza.csv, ...}``
reads points and optionally widths from a file; ``xodr: {file: town.xodr, road: 3}`` reads a road of an OpenDRIVE file;
``route: {from: 3.0.-1@10, to: [80, 45]}`` is the shortest way over the lanes of the `network`.
Files are relative to the world file.
"""

import math
import re
from typing import Annotated, Any, Literal, Self

from pydantic import Field, PlainValidator, field_validator, model_validator

from mirdrake.core.yaml_io import Angle, Length, Schema, Speed, to_si
from mirdrake.worlds.actors_spec import ActorList, Step
from mirdrake.worlds.case_spec import CaseSpec
from mirdrake.worlds.lights import LightSpec
from mirdrake.worlds.networks.network_spec import NetworkSpec
from mirdrake.worlds.props_spec import GroupSpec, PropEntry
from mirdrake.worlds.random_tracks import RandomTrackSpec
from mirdrake.worlds.regions import PatchSpec
from mirdrake.worlds.relief import ReliefSpec
from mirdrake.worlds.rules_spec import RuleSpec
from mirdrake.worlds.schema_types import Label, SurfaceName, Value, exactly_one
from mirdrake.worlds.segments import SegmentSpec
from mirdrake.worlds.yield_lines import YieldLineSpec

Coordinate = Annotated[Length, Field(ge=-1e6, le=1e6)]
Position = tuple[Coordinate, Coordinate]
Heading = Annotated[Angle, Field(ge=-4.0 * math.pi, le=4.0 * math.pi)]

_TOLERANCE = re.compile(r"\s*(\S+(?: \w+)?)\s*\+-\s*(\S.*?)\s*$")
_WIDTHS = (0.01, 100.0)  # [m]


def _length_with_tolerance(value: Any) -> tuple[float, float]:
    match = _TOLERANCE.match(value) if isinstance(value, str) else None
    parts = [to_si(text, "m") for text in match.groups()] if match else []
    if len(parts) != 2 or not all(isinstance(part, float) and 0.0 < part < math.inf for part in parts):
        raise ValueError(f"{value!r} is not a length with its tolerance; write for example '965 +- 1'")
    return parts[0], parts[1]


def _width(value: Any) -> float | list[tuple[float, float]]:
    if isinstance(value, list | tuple) and value:
        rows = [[to_si(part, "m") for part in row] if isinstance(row, list | tuple) else [] for row in value]
        for index, row in enumerate(rows):
            if len(row) != 2 or any(isinstance(part, bool) or not isinstance(part, int | float) for part in row):
                raise ValueError(f"entry {index + 1} is not [s, width], two numbers in m")
            if not 0.0 <= row[0] <= 1e6 or (index and row[0] <= rows[index - 1][0]):
                raise ValueError(f"entry {index + 1}: s = {row[0]:g} m; s must increase from 0 or more")
        widths = [float(width) for _, width in rows]
    else:
        # A plain width holds everywhere.
        number = to_si(value, "m")
        if isinstance(number, bool) or not isinstance(number, int | float):
            raise ValueError(f"{str(value)[:40]!r} is not a width; give a number in m, or [[s, width], ...]")
        rows, widths = [], [float(number)]
    if not all(_WIDTHS[0] <= width <= _WIDTHS[1] for width in widths):
        raise ValueError(f"a width must be from {_WIDTHS[0]:g} to {_WIDTHS[1]:g} m")
    return [(float(s), width) for (s, _), width in zip(rows, widths, strict=True)] if rows else widths[0]


def _column(value: Any) -> int | str:
    if isinstance(value, bool) or not isinstance(value, int | str) or not str(value).strip():
        raise ValueError("give the name of a column, or its number counted from 1")
    return value


Width = Annotated[
    float | list[tuple[float, float]],
    PlainValidator(_width, json_schema_input_type=float | str | list[tuple[float, float]]),
]
Column = Annotated[int | str, PlainValidator(_column, json_schema_input_type=int | str)]
ExpectedLength = Annotated[tuple[float, float], PlainValidator(_length_with_tolerance, json_schema_input_type=str)]
Friction = Annotated[float, Field(gt=0.0, le=2.0)]


# --- ground -------------------------------------------------------------------------------------------------------


class SlopeSpec(Schema):
    """A uniform slope of the whole world. W stays on the road plane; gravity is tilted instead."""

    grade: float = Field(default=0.0, ge=-1.0, le=1.0, description="rise over run towards `heading` [-]")
    heading: Heading = Field(default=0.0, description="uphill direction, from x towards y [rad]")


class GroundSpec(Schema):
    """The base plane z = 0."""

    surface: SurfaceName = Field(default="asphalt", description="its appearance [-]")
    mu: Friction | None = Field(default=None, description="friction coefficient; default: that of the surface [-]")
    size: tuple[Length, Length] | None = Field(
        default=None,
        description="extent in x and y about the middle of the tracks; default: 50 m beyond them, or 400 m [m]",
    )
    slope: SlopeSpec = Field(default_factory=SlopeSpec, description="uniform slope [-]")
    patches: list[PatchSpec] = Field(default_factory=list, description="parts with their own friction [-]")
    relief: list[ReliefSpec] = Field(default_factory=list, description="heights, kerbs, bumps, roughness, in order [-]")

    @field_validator("size")
    @classmethod
    def _positive(cls, size: tuple[float, float] | None) -> tuple[float, float] | None:
        if size is not None and not all(0.0 < side <= 1e5 for side in size):
            raise ValueError("both sides must be above 0 m and at most 100 km")
        return size


# --- tracks -------------------------------------------------------------------------------------------------------


class PoseSpec(Schema):
    """A position and a heading in the plane."""

    at: Position = Field(default=(0.0, 0.0), description="x and y [m]")
    yaw: Heading = Field(default=0.0, description="heading, from x towards y [rad]")


class MarkingSpec(Schema):
    """A painted line."""

    line: Literal["left", "right", "center", "start"] = Field(
        description="edge line, centre line, or start line across the road at s = 0 [-]"
    )
    kind: Literal["solid", "dashed"] = Field(default="solid", description="continuous or interrupted [-]")
    width: Annotated[Length, Field(ge=1e-3, le=2.0)] = Field(default=0.1, description="width of the paint [m]")
    dash: tuple[Length, Length] = Field(default=(3.0, 3.0), description="lengths of dashes and of gaps [m]")

    @field_validator("dash")
    @classmethod
    def _long_enough(cls, dash: tuple[float, float]) -> tuple[float, float]:
        if not all(0.1 <= part <= 1e4 for part in dash):
            raise ValueError("both lengths must be from 0.1 m to 10 km")
        return dash


class _FileSpec(Schema):
    file: Annotated[str, Field(min_length=1)] = Field(description="path relative to the world file [-]")

    @model_validator(mode="before")
    @classmethod
    def _name_alone(cls, data: Any) -> Any:
        return {"file": data} if isinstance(data, str) else data


class CsvSpec(_FileSpec):
    """Points of a centre line in a file, one per line; by default in the format of the TUM racetrack database."""

    x: Column = Field(default="x_m", description="column of x: its name, or its number from 1 [-]")
    y: Column = Field(default="y_m", description="column of y [-]")
    right: Column | None = Field(
        default="w_tr_right_m", description="column of the distance to the right edge; null: none [-]"
    )
    left: Column | None = Field(
        default="w_tr_left_m", description="column of the distance to the left edge; null: none [-]"
    )
    scale: Annotated[float, Field(gt=0.0, le=1e6)] = Field(
        default=1.0, description="metres per unit of the file, also of the widths [-]"
    )
    smooth: Annotated[Length, Field(ge=0.0, le=100.0)] = Field(
        default=0.0, description="root mean square by which noisy points may be moved [m]"
    )


class XodrSpec(_FileSpec):
    """A road, or a chain of roads, of an OpenDRIVE file."""

    road: Column | None = Field(
        default=None, description="its id, or several in driving order: '1, 7, 2'; default: the only one [-]"
    )
    lane: Column = Field(default="driving", description="type of the lanes that form the road, or a lane id [-]")


RoutePlace = Annotated[str | Position, Field(description="lane@station, or x and y [m]")]


class RouteSpec(Schema):
    """The shortest route over the lanes of the network, with lane changes."""

    from_: RoutePlace = Field(alias="from", description="its start: lane@station, or x and y [m]")
    to: RoutePlace = Field(description="its end [m]")
    via: Annotated[list[RoutePlace], Field(max_length=100)] = Field(
        default_factory=list, description="places on the way [m]"
    )


class TrackSpec(Schema):
    """A road along a centre line: exactly one of segments, points, csv, xodr, random and route."""

    segments: Annotated[list[SegmentSpec], Field(min_length=1, max_length=2000)] | None = Field(
        default=None, description="in driving order [-]"
    )
    points: Annotated[list[Position], Field(min_length=1, max_length=10_000)] | None = Field(
        default=None, description="x and y in driving order, four or more, joined by a smooth curve [m]"
    )
    csv: CsvSpec | None = Field(default=None, description="file of points and widths [-]")
    xodr: XodrSpec | None = Field(default=None, description="road of an OpenDRIVE file [-]")
    random: RandomTrackSpec | None = Field(default=None, description="random closed track [-]")
    route: RouteSpec | None = Field(
        default=None, description="route over the network: a line to follow, not a road of its own [-]"
    )
    start: PoseSpec | None = Field(
        default=None, description="pose at s = 0; default: the origin, or that of the points or the file [-]"
    )
    closed: bool | None = Field(
        default=None, description="the end meets the start; default: false, or as in the file [-]"
    )
    crossing: bool = Field(default=False, description="it may cross itself, as a figure of eight does [-]")
    width: Width | None = Field(
        default=None,
        description="road width, or [[s, width], ...], interpolated linearly; default: as in the file, else 3 [m]",
    )
    thickness: Annotated[Length, Field(ge=0.0, le=0.5)] = Field(
        default=0.0, description="height of the road above the ground beside it; the largest of a world counts [m]"
    )
    surface: SurfaceName = Field(default="asphalt", description="its appearance [-]")
    mu: Friction | None = Field(default=None, description="friction coefficient; default: that of the surface [-]")
    verge: SurfaceName | None = Field(
        default=None, description="surface of a verge of 2 m on both sides; default: the ground's [-]"
    )
    markings: list[MarkingSpec] = Field(default_factory=list, description="painted lines [-]")
    road: bool = Field(
        default=True, description="false: only a line to follow, on other roads; default: false for a route [-]"
    )
    length: Annotated[Length, Field(gt=0.0, le=1e6)] | None = Field(
        default=None,
        description="required length of segments: by a third auto line, otherwise by scaling the centre line [m]",
    )
    expected_length: ExpectedLength | None = Field(
        default=None, description="length with tolerance, '965 +- 1', that is checked [m]"
    )
    lanes: Annotated[int, Field(ge=1, le=8)] = Field(
        default=1, description="lanes of actors in the direction of the track, on its right side [-]"
    )
    oncoming: Annotated[int, Field(ge=0, le=8)] = Field(
        default=0, description="lanes of actors in the opposite direction, on its left side [-]"
    )

    @model_validator(mode="after")
    def _one(self) -> Self:
        exactly_one(self, ("segments", "points", "csv", "xodr", "random", "route"))
        if self.route is not None and "road" not in self.model_fields_set:
            self.road = False
        if self.length is not None and self.segments is None:
            raise ValueError("length belongs to segments; set csv.scale, or correct the points")
        return self


# --- light --------------------------------------------------------------------------------------------------------


class SunSpec(Schema):
    """The sun: a directional light."""

    azimuth: Heading = Field(default=math.radians(135.0), description="direction to the sun, from x towards y [rad]")
    elevation: Annotated[Angle, Field(gt=0.0, le=math.pi / 2.0 + 1e-9)] = Field(
        default=math.radians(50.0), description="height above the horizon [rad]"
    )
    intensity: Annotated[float, Field(ge=0.0, le=100.0)] = Field(default=1.0, description="1 is a clear day [-]")


class LightsSpec(Schema):
    """Lights of the world."""

    sun: SunSpec = Field(default_factory=SunSpec, description="directional light [-]")
    ambient: Annotated[float, Field(ge=0.0, le=100.0)] = Field(
        default=0.35, description="light from all directions, as a share of the sun's [-]"
    )


# --- starts, goals, scenery ---------------------------------------------------------------------------------------


class OnTrackSpec(Schema):
    """A pose on a track, heading along it."""

    track: str = Field(description="name of the track [-]")
    s: Coordinate = Field(default=0.0, description="s along the centre line [m]")
    offset: Coordinate = Field(default=0.0, description="offset to the left of the centre line [m]")


class StartSpec(Schema):
    """A start: `at` and `yaw`, or `on_track`."""

    at: Position | None = Field(default=None, description="x and y of the vehicle's frame B, below the rear axle [m]")
    yaw: Heading | None = Field(default=None, description="heading, from x towards y [rad]")
    on_track: OnTrackSpec | None = Field(default=None, description="pose on a track [-]")
    speed: Speed = Field(default=0.0, description="forward speed at the start [m/s]")

    @model_validator(mode="after")
    def _one(self) -> Self:
        if self.on_track is not None and (self.at is not None or self.yaw is not None):
            raise ValueError("give either at and yaw, or on_track")
        return self


class ScenerySpec(Schema):
    """A mesh without collision geometry; cameras and lidars see it."""

    file: Annotated[str, Field(min_length=1)] = Field(description="glTF or OBJ, relative to the world file [-]")
    at: tuple[Coordinate, Coordinate, Coordinate] = Field(default=(0.0, 0.0, 0.0), description="its origin [m]")
    yaw: Heading = Field(default=0.0, description="heading, from x towards y [rad]")
    pitch: Heading = Field(default=0.0, description="nose down [rad]")
    roll: Heading = Field(default=0.0, description="right side down [rad]")


class GateSpec(Schema):
    """A line across a track."""

    track: str = Field(description="name of the track [-]")
    s: Coordinate = Field(default=0.0, description="s along the centre line [m]")


class GoalSpec(Schema):
    """A goal: a disc (`at`, `radius`), a `gate`, or a number of `laps`."""

    at: Position | None = Field(default=None, description="centre of the disc [m]")
    radius: Annotated[Length, Field(gt=0.0)] | None = Field(
        default=None, description="radius of the disc, default 1 [m]"
    )
    gate: GateSpec | None = Field(default=None, description="line across a track [-]")
    laps: Annotated[int, Field(ge=1)] | None = Field(default=None, description="laps of a closed track [-]")

    @model_validator(mode="after")
    def _one(self) -> Self:
        exactly_one(self, ("at", "gate", "laps"))
        if self.radius is not None and self.at is None:
            raise ValueError("radius belongs to at")
        return self


class WorldSpec(Schema):
    """A world file."""

    mirdrake: Literal["world/1"] = Field(description="format and its version [-]")
    name: str = Field(default="", description="default: the file's name [-]")
    seed: int = Field(default=0, description="seed of all random values [-]")
    params: dict[Label, Value] = Field(default_factory=dict, description="numbers and words for $name [-]")
    include: list[str] = Field(default_factory=list, description="files with groups, relative to this one [-]")
    ground: GroundSpec = Field(default_factory=GroundSpec, description="the base plane [-]")
    tracks: dict[str, TrackSpec] = Field(default_factory=dict, description="roads by name; later ones are on top [-]")
    network: NetworkSpec | None = Field(default=None, description="roads and junctions from a file [-]")
    lights: LightsSpec = Field(default_factory=LightsSpec, description="sun and ambient light [-]")
    sky: Literal["clear", "overcast"] = Field(default="clear", description="appearance of the sky [-]")
    start: dict[str, StartSpec] = Field(
        default_factory=dict,
        description="starts by name; default: origin at [0, 0], or s = 0 of a track that is far from it [-]",
    )
    goals: dict[str, GoalSpec] = Field(default_factory=dict, description="goals by name [-]")
    props: list[PropEntry] = Field(default_factory=list, max_length=5000, description="props in the world [-]")
    scenery: list[ScenerySpec] = Field(
        default_factory=list, max_length=5000, description="visual meshes without collision, in frame W [-]"
    )
    groups: dict[Label, GroupSpec] = Field(default_factory=dict, description="props that belong together [-]")
    rules: list[RuleSpec] = Field(default_factory=list, description="conditions on the world [-]")
    tests: list[CaseSpec] = Field(default_factory=list, description="requirements on a vehicle in the world [-]")
    actors: ActorList = Field(default_factory=list, max_length=2000, description="props that move [-]")
    signals: dict[Label, LightSpec] = Field(default_factory=dict, description="traffic lights by name [-]")
    yield_lines: list[YieldLineSpec] = Field(
        default_factory=list, description="lines at which vehicles yield to others [-]"
    )
    scenario: dict[Label, list[Step]] = Field(default_factory=dict, description="steps of actors by name [-]")
