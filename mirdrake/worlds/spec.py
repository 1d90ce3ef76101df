"""The world language `world/1`: what a world file may hold.

Lengths in m and angles in rad once loaded; in the file they may carry a unit (``90 deg``). x forward, y left, z up;
a positive angle, curvature or signed radius turns left.

A track is written in one of four ways. `segments` are laid end to end with a common tangent:

* ``{line: 40}`` is a straight; ``{line: auto}`` lets the loader find the length. Two auto lines close a closed
  track; a third one makes its `length` too.
* ``{arc: {radius: 20, angle: 90 deg}}`` is a circular arc; the sign of the angle says where it turns (+ left).
  ``transition: 20 deg`` puts a clothoid at both ends, each turning that much of the angle; curvature is then steady.
* ``{clothoid: {from_radius: straight, to_radius: -30, length: 25}}`` has a curvature that changes linearly. Its radii
  are signed (+ left), `straight` (or `inf`) means no curvature. Instead of `length`, `angle` may be given: what it
  turns, signed.

``points: [[0, 0], [40, 5], ...]`` are joined by a smooth curve; ``csv: monza.csv`` or ``csv: {file: monza.csv, ...}``
takes points, and widths if there are any, from a file; ``xodr: {file: town.xodr, road: 3}`` takes a road of an
OpenDRIVE file. Files are looked for beside the world file.
"""

import math
import re
from typing import Annotated, Any, Literal, Self

from pydantic import Field, PlainValidator, field_validator, model_validator

from mirdrake.core.yaml_io import Angle, Length, Schema, Speed, to_si
from mirdrake.worlds.props_spec import CaseSpec, GroupSpec, Label, PatchSpec, PropEntry, RuleSpec, Value

Surface = Literal["asphalt", "concrete", "grass", "gravel", "ice"]
Coordinate = Annotated[Length, Field(ge=-1e6, le=1e6)]
Point = tuple[Coordinate, Coordinate]
Heading = Annotated[Angle, Field(ge=-4.0 * math.pi, le=4.0 * math.pi)]


def _length_or_auto(value: Any) -> float | Literal["auto"]:
    if value == "auto":
        return "auto"
    number = to_si(value, "m")
    if isinstance(number, bool) or not isinstance(number, int | float) or not 1e-3 <= number < math.inf:
        raise ValueError(f"{value!r} is not a length of at least 1 mm, nor 'auto'")
    return float(number)


def _radius_or_straight(value: Any) -> float | Literal["straight"]:
    if value in ("straight", "inf"):
        return "straight"
    number = to_si(value, "m")
    if isinstance(number, bool) or not isinstance(number, int | float) or not 0.01 <= abs(number) < math.inf:
        raise ValueError(f"{value!r} is not a signed radius of at least 0.01 m (+ turns left), nor 'straight'")
    return float(number)


_CHECK = re.compile(r"\s*(\S+(?: \w+)?)\s*\+-\s*(\S.*?)\s*$")


def _length_with_tolerance(value: Any) -> tuple[float, float]:
    match = _CHECK.match(value) if isinstance(value, str) else None
    parts = [to_si(text, "m") for text in match.groups()] if match else []
    if len(parts) != 2 or not all(isinstance(part, float) and 0.0 < part < math.inf for part in parts):
        raise ValueError(f"{value!r} is not a length with its tolerance; write for example '965 +- 1'")
    return parts[0], parts[1]


_WIDTHS = (0.01, 100.0)  # [m]


def _width(value: Any) -> float | list[tuple[float, float]]:
    if isinstance(value, list | tuple) and value:
        rows = [[to_si(part, "m") for part in row] if isinstance(row, list | tuple) else [] for row in value]
        for at, row in enumerate(rows):
            if len(row) != 2 or any(isinstance(part, bool) or not isinstance(part, int | float) for part in row):
                raise ValueError(f"entry {at + 1} is not [s, width], two numbers in m")
            if not 0.0 <= row[0] <= 1e6 or (at and row[0] <= rows[at - 1][0]):
                raise ValueError(f"entry {at + 1}: s = {row[0]:g} m; make s rise from 0 or more")
        widths = [float(width) for _, width in rows]
    else:
        number = to_si(value, "m")
        if isinstance(number, bool) or not isinstance(number, int | float):
            raise ValueError(f"{str(value)[:40]!r} is not a width; give a number in m, or [[s, width], ...]")
        rows, widths = [], [float(number)]
    if not all(_WIDTHS[0] <= width <= _WIDTHS[1] for width in widths):
        raise ValueError(f"a width must be from {_WIDTHS[0]:g} to {_WIDTHS[1]:g} m")
    return [(float(s), width) for (s, _), width in zip(rows, widths, strict=True)] if rows else widths[0]


def _column(value: Any) -> int | str:
    if isinstance(value, bool) or not isinstance(value, int | str) or not str(value).strip():
        raise ValueError("the name of a column, or its number counted from 1, is expected")
    return value


Width = Annotated[
    float | list[tuple[float, float]],
    PlainValidator(_width, json_schema_input_type=float | str | list[tuple[float, float]]),
]
Column = Annotated[int | str, PlainValidator(_column, json_schema_input_type=int | str)]
LengthOrAuto = Annotated[float | Literal["auto"], PlainValidator(_length_or_auto, json_schema_input_type=float | str)]
RadiusOrStraight = Annotated[
    float | Literal["straight"], PlainValidator(_radius_or_straight, json_schema_input_type=float | str)
]
CheckedLength = Annotated[tuple[float, float], PlainValidator(_length_with_tolerance, json_schema_input_type=str)]
Friction = Annotated[float, Field(gt=0.0, le=2.0)]


class SlopeSpec(Schema):
    """A uniform slope of the whole world. W stays on the road plane; gravity is tilted instead."""

    grade: float = Field(default=0.0, ge=-1.0, le=1.0, description="rise over run towards `heading` [-]")
    heading: Heading = Field(default=0.0, description="uphill direction, from x towards y [rad]")


class GroundSpec(Schema):
    """The base plane z = 0."""

    surface: Surface = Field(default="asphalt", description="what it looks like [-]")
    mu: Friction | None = Field(default=None, description="friction coefficient; default: that of the surface [-]")
    size: tuple[Length, Length] | None = Field(
        default=None,
        description="extent in x and y about the middle of the tracks; default: 50 m beyond them, or 400 m [m]",
    )
    slope: SlopeSpec = Field(default_factory=SlopeSpec, description="uniform slope [-]")
    patches: list[PatchSpec] = Field(default_factory=list, description="parts with a friction of their own [-]")

    @field_validator("size")
    @classmethod
    def _positive(cls, size: tuple[float, float] | None) -> tuple[float, float] | None:
        if size is not None and not all(0.0 < side <= 1e5 for side in size):
            raise ValueError("both sides must be above 0 m and at most 100 km")
        return size


class ArcSpec(Schema):
    """A circular arc, with clothoids at its ends if `transition` is given."""

    radius: Annotated[Length, Field(ge=0.01, le=1e6)] = Field(description="radius of the centre line [m]")
    angle: Angle = Field(description="heading change over the whole, + left [rad]")
    transition: Annotated[Angle, Field(ge=0.0)] = Field(
        default=0.0, description="part of `angle` that the clothoid at each end turns, unsigned [rad]"
    )

    @model_validator(mode="after")
    def _turns(self) -> Self:
        if not 1e-6 <= abs(self.angle) <= 4.0 * math.pi:
            raise ValueError("angle must not be 0, nor above 720 deg; write the unit: 90 deg")
        if 0.0 < self.transition < 1e-6:
            raise ValueError("transition must be 0 or at least 1e-6 rad")
        if 2.0 * self.transition > abs(self.angle) * (1.0 + 1e-12):
            raise ValueError("the two transitions turn more than the angle; make transition at most half of it")
        return self


class ClothoidSpec(Schema):
    """A curve whose curvature changes linearly with arc length; see the module's text for the signs."""

    from_radius: RadiusOrStraight = Field(default="straight", description="signed radius at its start [m]")
    to_radius: RadiusOrStraight = Field(default="straight", description="signed radius at its end [m]")
    length: Annotated[Length, Field(ge=1e-3, le=1e6)] | None = Field(default=None, description="arc length [m]")
    angle: Angle | None = Field(default=None, description="heading change, + left, instead of `length` [rad]")

    @property
    def curvatures(self) -> tuple[float, float]:
        """Curvature at the start and at the end [1/m], + left."""
        start, end = (0.0 if radius == "straight" else 1.0 / radius for radius in (self.from_radius, self.to_radius))
        return start, end

    @property
    def arc_length(self) -> float:
        """Length [m]; from `angle` it is 2 angle / (start curvature + end curvature)."""
        return self.length if self.length is not None else 2.0 * (self.angle or 0.0) / sum(self.curvatures)

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if (self.length is None) == (self.angle is None):
            raise ValueError("give exactly one of length and angle")
        if self.length is None:
            total = sum(self.curvatures)
            if abs(total) < 1e-9 or (self.angle or 0.0) * total <= 0.0 or not 1e-3 <= self.arc_length <= 1e6:
                raise ValueError("angle does not fit the radii; its sign must be theirs (+ left), or give length")
        if not abs(self.arc_length * sum(self.curvatures) / 2.0) <= 4.0 * math.pi:
            raise ValueError("it turns more than 720 deg")
        return self


class SegmentSpec(Schema):
    """One piece of a centre line: exactly one of line, arc and clothoid."""

    line: LengthOrAuto | None = Field(default=None, description="length of a straight, or auto [m]")
    arc: ArcSpec | None = Field(default=None, description="circular arc [-]")
    clothoid: ClothoidSpec | None = Field(default=None, description="linear change of curvature [-]")

    @model_validator(mode="after")
    def _one(self) -> Self:
        if sum(part is not None for part in (self.line, self.arc, self.clothoid)) != 1:
            raise ValueError("give exactly one of line, arc and clothoid")
        return self


class PoseSpec(Schema):
    """A place and a heading in the plane."""

    at: Point = Field(default=(0.0, 0.0), description="x and y [m]")
    yaw: Heading = Field(default=0.0, description="heading, from x towards y [rad]")


class MarkingSpec(Schema):
    """A painted line."""

    line: Literal["left", "right", "center", "start"] = Field(
        description="which; start lies across the road at s = 0 [-]"
    )
    kind: Literal["solid", "dashed"] = Field(default="solid", description="continuous or interrupted [-]")
    width: Annotated[Length, Field(ge=1e-3, le=2.0)] = Field(default=0.1, description="width of the paint [m]")
    dash: tuple[Length, Length] = Field(default=(3.0, 3.0), description="painted and open length of a dashed line [m]")

    @field_validator("dash")
    @classmethod
    def _long_enough(cls, dash: tuple[float, float]) -> tuple[float, float]:
        if not all(0.1 <= part <= 1e4 for part in dash):
            raise ValueError("both lengths must be from 0.1 m to 10 km")
        return dash


class _FileSpec(Schema):
    file: Annotated[str, Field(min_length=1)] = Field(description="looked for beside the world file [-]")

    @model_validator(mode="before")
    @classmethod
    def _name_alone(cls, data: Any) -> Any:
        return {"file": data} if isinstance(data, str) else data


class CsvSpec(_FileSpec):
    """Points of a centre line in a file, one per line; by default as the race lines of TUM have them."""

    x: Column = Field(default="x_m", description="column of x: its name, or its number from 1 [-]")
    y: Column = Field(default="y_m", description="column of y [-]")
    right: Column | None = Field(
        default="w_tr_right_m", description="column of the distance of the right edge; null: none [-]"
    )
    left: Column | None = Field(
        default="w_tr_left_m", description="column of the distance of the left edge; null: none [-]"
    )
    scale: Annotated[float, Field(gt=0.0, le=1e6)] = Field(
        default=1.0, description="metres per unit of the file; also of the widths [-]"
    )
    smooth: Annotated[Length, Field(ge=0.0, le=100.0)] = Field(
        default=0.0, description="root mean square by which noisy points may be moved [m]"
    )


class XodrSpec(_FileSpec):
    """A road, or a chain of roads, of an OpenDRIVE file."""

    road: Column | None = Field(
        default=None, description="its id, or several in driving order: '1, 7, 2'; default: the only one [-]"
    )
    lane: Column = Field(default="driving", description="type of the lanes that are the road, or the id of one [-]")


class TrackSpec(Schema):
    """A road along a centre line: exactly one of segments, points, csv and xodr."""

    segments: Annotated[list[SegmentSpec], Field(min_length=1, max_length=2000)] | None = Field(
        default=None, description="in driving order [-]"
    )
    points: Annotated[list[Point], Field(min_length=1, max_length=10_000)] | None = Field(
        default=None, description="x and y in driving order, four or more; a smooth curve goes through them [m]"
    )
    csv: CsvSpec | None = Field(default=None, description="file of points and widths [-]")
    xodr: XodrSpec | None = Field(default=None, description="road of an OpenDRIVE file [-]")
    start: PoseSpec | None = Field(
        default=None, description="where s = 0 is; default: the origin, or where the points or the file have it [-]"
    )
    closed: bool | None = Field(
        default=None, description="the end meets the start; default: false, or as it is in the file [-]"
    )
    crossing: bool = Field(default=False, description="it may cross itself, as a figure of eight does [-]")
    width: Width | None = Field(
        default=None,
        description="of the road, or [[s, width], ...] with straight edges between; default: the file's, else 3 [m]",
    )
    thickness: Annotated[Length, Field(ge=0.0, le=0.5)] = Field(
        default=0.01, description="height of the road above the surface beside it; seen, not felt [m]"
    )
    surface: Surface = Field(default="asphalt", description="what it looks like [-]")
    mu: Friction | None = Field(default=None, description="friction coefficient; default: that of the surface [-]")
    edges: Surface | None = Field(
        default=None, description="surface of a verge of 2 m on both sides; default: the ground's [-]"
    )
    markings: list[MarkingSpec] = Field(default_factory=list, description="painted lines [-]")
    road: bool = Field(default=True, description="false: only a line to follow, on roads of other tracks [-]")
    length: Annotated[Length, Field(gt=0.0, le=1e6)] | None = Field(
        default=None,
        description="wanted length, of segments: met by a third auto line, otherwise by scaling the centre line [m]",
    )
    check_length: CheckedLength | None = Field(default=None, description="'965 +- 1': the length must be that [m]")

    @model_validator(mode="after")
    def _one(self) -> Self:
        if sum(part is not None for part in (self.segments, self.points, self.csv, self.xodr)) != 1:
            raise ValueError("give exactly one of segments, points, csv and xodr")
        if self.length is not None and self.segments is None:
            raise ValueError("length belongs to segments; set csv.scale, or correct the points")
        return self


class SunSpec(Schema):
    """The sun: a directional light."""

    azimuth: Heading = Field(default=math.radians(135.0), description="direction to the sun, from x towards y [rad]")
    elevation: Annotated[Angle, Field(gt=0.0, le=math.pi / 2.0 + 1e-9)] = Field(
        default=math.radians(50.0), description="height above the horizon [rad]"
    )
    intensity: Annotated[float, Field(ge=0.0, le=100.0)] = Field(default=1.0, description="1 is a clear day [-]")


class LightsSpec(Schema):
    """What lights the world."""

    sun: SunSpec = Field(default_factory=SunSpec, description="directional light [-]")
    ambient: Annotated[float, Field(ge=0.0, le=100.0)] = Field(
        default=0.35, description="light from everywhere; 1 is the sun's [-]"
    )


class OnTrackSpec(Schema):
    """A place on a track, heading along it."""

    track: str = Field(description="name of the track [-]")
    s: Coordinate = Field(default=0.0, description="along the centre line [m]")
    offset: Coordinate = Field(default=0.0, description="to the left of the centre line [m]")


class StartSpec(Schema):
    """A place to start from: `at` and `yaw`, or `on_track`."""

    at: Point | None = Field(default=None, description="x and y of the vehicle's frame B, below the rear axle [m]")
    yaw: Heading | None = Field(default=None, description="heading, from x towards y [rad]")
    on_track: OnTrackSpec | None = Field(default=None, description="place on a track [-]")
    speed: Speed = Field(default=0.0, description="forward speed at the start [m/s]")

    @model_validator(mode="after")
    def _one(self) -> Self:
        if self.on_track is not None and (self.at is not None or self.yaw is not None):
            raise ValueError("give either at and yaw, or on_track")
        return self


class ScenerySpec(Schema):
    """A mesh that is only drawn: cameras and lidars see it, and nothing touches it."""

    file: Annotated[str, Field(min_length=1)] = Field(description="glTF or OBJ, looked for beside the world file [-]")
    at: tuple[Coordinate, Coordinate, Coordinate] = Field(default=(0.0, 0.0, 0.0), description="its origin [m]")
    yaw: Heading = Field(default=0.0, description="heading, from x towards y [rad]")
    pitch: Heading = Field(default=0.0, description="nose down [rad]")
    roll: Heading = Field(default=0.0, description="right side down [rad]")


class GateSpec(Schema):
    """A line across a track."""

    track: str = Field(description="name of the track [-]")
    s: Coordinate = Field(default=0.0, description="along the centre line [m]")


class GoalSpec(Schema):
    """What to reach: a disc (`at`, `radius`), a `gate`, or a number of `laps`."""

    at: Point | None = Field(default=None, description="middle of the disc [m]")
    radius: Annotated[Length, Field(gt=0.0)] | None = Field(
        default=None, description="radius of the disc, default 1 [m]"
    )
    gate: GateSpec | None = Field(default=None, description="line across a track [-]")
    laps: Annotated[int, Field(ge=1)] | None = Field(default=None, description="laps of a closed track [-]")

    @model_validator(mode="after")
    def _one(self) -> Self:
        if sum(part is not None for part in (self.at, self.gate, self.laps)) != 1:
            raise ValueError("give exactly one of at, gate and laps")
        if self.radius is not None and self.at is None:
            raise ValueError("radius belongs to at")
        return self


class WorldSpec(Schema):
    """A world file."""

    mirdrake: Literal["world/1"] = Field(description="the language and its version [-]")
    name: str = Field(default="", description="default: the file's name [-]")
    seed: int = Field(default=0, description="seed of everything random in the world [-]")
    params: dict[Label, Value] = Field(default_factory=dict, description="numbers and words for $name [-]")
    use: list[str] = Field(default_factory=list, description="files whose groups may be used, beside this one [-]")
    ground: GroundSpec = Field(default_factory=GroundSpec, description="the base plane [-]")
    tracks: dict[str, TrackSpec] = Field(default_factory=dict, description="roads by name; later ones lie on top [-]")
    lights: LightsSpec = Field(default_factory=LightsSpec, description="sun and ambient light [-]")
    sky: Literal["clear", "overcast"] = Field(default="clear", description="what the sky looks like [-]")
    start: dict[str, StartSpec] = Field(
        default_factory=dict,
        description="places to start from, by name; default: origin at [0, 0], or s = 0 of a track that is far off [-]",
    )
    goals: dict[str, GoalSpec] = Field(default_factory=dict, description="what to reach, by name [-]")
    props: list[PropEntry] = Field(default_factory=list, max_length=5000, description="what stands in the world [-]")
    scenery: list[ScenerySpec] = Field(
        default_factory=list, max_length=5000, description="meshes that are only drawn, in the world's frame [-]"
    )
    groups: dict[Label, GroupSpec] = Field(default_factory=dict, description="props that belong together [-]")
    rules: list[RuleSpec] = Field(default_factory=list, description="what must hold in the world [-]")
    tests: list[CaseSpec] = Field(default_factory=list, description="what must hold for a vehicle in it [-]")
