"""The part of the world language that fills a world: props, groups of them, friction patches, rules and tests.

A number may be a text that says how it is found, see :mod:`mirdrake.worlds.values`; all of ``props`` and ``groups`` is
drawn once for every single thing that is laid out.

An entry of ``props`` says what (`prop`, `box`, `cylinder`, `sphere`, `file` or `group`) and where, in one layout::

    props:
      - {prop: stop_sign, at: [12, -3], yaw: 180 deg}
      - {prop: cone, line: {from: [0, 2], to: [30, 2], spacing: 3}}
      - {prop: sedan | van, name: car, grid: {step: [5.5, 18], count: [6, 2]}, yaw: [90 deg, -90 deg]}
      - {prop: barrel, along: {track: main, spacing: 20, side: both, distance: 0.5}}
      - {box: [1, 2, 0.5], ring: {center: [0, 0], radius: 10, count: 8}, color: [0.8, 0.1, 0.1]}
      - {prop: tree, scatter: {region: {rect: {center: [0, 40], size: [80, 20]}}, count: 30}, yaw: 0 .. 360 deg}
      - {group: city_block, at: [60, 0], with: {side: 40}}

`yaw` is added to the heading of the layout: along a line or a track, along the tangent of a ring (counter-clockwise), 0
otherwise. A list of yaws is taken row by row in a grid and one by one elsewhere.
"""

import math
from typing import Annotated, Any, Literal, Self

from pydantic import ConfigDict, Field, PlainValidator, field_validator, model_validator

from mirdrake.core.yaml_io import Duration, Length, Schema

LARGEST_COUNT = 20_000
"""Largest number of props in a world."""


def _value(value: Any) -> float | int | str:
    if isinstance(value, bool) or not isinstance(value, float | int | str):
        raise ValueError("a number, or a text such as '0 .. 3', is expected")
    if isinstance(value, str) and not value.strip():
        raise ValueError("is empty")
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{value} is not a finite number")
    return value


Value = Annotated[float | int | str, PlainValidator(_value, json_schema_input_type=float | str)]
Pair = Annotated[list[Value], Field(min_length=2, max_length=2)]
Triple = Annotated[list[Value], Field(min_length=3, max_length=3)]
PointSpec = Annotated[list[Value], Field(min_length=2, max_length=3)]
Label = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]
SurfaceName = Literal["asphalt", "concrete", "grass", "gravel", "ice"]


def _origin() -> list[float | int | str]:
    return [0.0, 0.0]


def _exactly_one(spec: Schema, names: tuple[str, ...]) -> None:
    given = [name for name in names if getattr(spec, name) is not None]
    if len(given) != 1:
        allowed = ", ".join(name.rstrip("_") for name in names[:-1])
        found = f"; given are {' and '.join(given)}" if given else ""
        raise ValueError(f"give exactly one of {allowed} and {names[-1]}{found}")


# --- regions ------------------------------------------------------------------------------------------------------


class RectSpec(Schema):
    """A rectangle."""

    center: Pair = Field(default_factory=_origin, description="its middle [m]")
    size: Pair = Field(description="along its x and its y [m]")
    yaw: Value = Field(default=0.0, description="heading of its x [rad]")


class DiscSpec(Schema):
    """A disc."""

    center: Pair = Field(default_factory=_origin, description="its middle [m]")
    radius: Value = Field(description="its radius [m]")


class BandSpec(Schema):
    """A strip along a track."""

    track: str = Field(description="name of the track [-]")
    s: Pair | None = Field(default=None, description="from and to, along the centre line; default: all of it [m]")
    right: Value | None = Field(default=None, description="offset of its right side, + left; default: road's edge [m]")
    left: Value | None = Field(default=None, description="offset of its left side, + left; default: road's edge [m]")


class RegionSpec(Schema):
    """An area: exactly one of rect, disc, polygon and band."""

    rect: RectSpec | None = Field(default=None, description="rectangle [-]")
    disc: DiscSpec | None = Field(default=None, description="disc [-]")
    polygon: Annotated[list[Pair], Field(min_length=3, max_length=1000)] | None = Field(
        default=None, description="corners in their order [m]"
    )
    band: BandSpec | None = Field(default=None, description="strip along a track [-]")

    @model_validator(mode="after")
    def _one(self) -> Self:
        _exactly_one(self, ("rect", "disc", "polygon", "band"))
        return self


class PatchSpec(RegionSpec):
    """A part of the ground with a friction of its own; it lies on ground, roads and earlier patches."""

    name: Label | None = Field(default=None, description="its name, by which rules and regions find it [-]")
    surface: SurfaceName | None = Field(default=None, description="what it looks like; default: as it is there [-]")
    mu: Value | None = Field(default=None, description="friction coefficient; default: that of the surface [-]")

    @model_validator(mode="after")
    def _says_something(self) -> Self:
        if self.surface is None and self.mu is None:
            raise ValueError("give surface, mu or both")
        return self


# --- layouts ------------------------------------------------------------------------------------------------------


class GridSpec(Schema):
    """Columns along x, rows along y."""

    origin: Pair = Field(default_factory=_origin, description="the first one [m]")
    step: Pair = Field(description="from one to the next, along x and y [m]")
    count: Pair = Field(description="along x and y [-]")


class LineSpec(Schema):
    """From one point to another, both included; x of the props points along."""

    from_: Pair = Field(alias="from", description="the first one [m]")
    to: Pair = Field(description="the last one [m]")
    spacing: Value | None = Field(default=None, description="largest distance from one to the next [m]")
    count: Value | None = Field(default=None, description="how many [-]")

    @model_validator(mode="after")
    def _one(self) -> Self:
        _exactly_one(self, ("spacing", "count"))
        return self


class AlongSpec(Schema):
    """Along a track; x of the props points along it."""

    track: str = Field(description="name of the track [-]")
    s: Pair | None = Field(default=None, description="from and to, along the centre line; default: all of it [m]")
    spacing: Value | None = Field(default=None, description="largest distance from one to the next [m]")
    count: Value | None = Field(default=None, description="how many, on each side [-]")
    side: Literal["left", "right", "both", "center"] = Field(default="center", description="of the road [-]")
    distance: Value = Field(default=1.0, description="from the edge of the road, outwards [m]")
    offset: Value = Field(default=0.0, description="to the left of the centre line, for side: center [m]")

    @model_validator(mode="after")
    def _one(self) -> Self:
        _exactly_one(self, ("spacing", "count"))
        if self.side != "center" and "offset" in self.model_fields_set:
            raise ValueError("offset belongs to side: center; give distance")
        if self.side == "center" and "distance" in self.model_fields_set:
            raise ValueError("distance belongs to side: left, right or both; give offset")
        return self


class RingSpec(Schema):
    """On a circle, the first one on its x; x of the props points along the tangent, counter-clockwise."""

    center: Pair = Field(default_factory=_origin, description="middle of the circle [m]")
    radius: Value = Field(description="of the circle [m]")
    count: Value = Field(description="how many [-]")


class ScatterSpec(Schema):
    """Anywhere in an area, drawn by chance, without touching anything."""

    region: RegionSpec | str = Field(description="an area, or the name of a patch or a track [-]")
    count: Value = Field(description="how many [-]")


class JitterSpec(Schema):
    """Small deviations from the place, along the axes of the layout."""

    x: Value = Field(default=0.0, description="along the layout's heading [m]")
    y: Value = Field(default=0.0, description="to the left of it [m]")
    yaw: Value = Field(default=0.0, description="of the heading [rad]")


LAYOUTS = ("at", "grid", "line", "along", "ring", "scatter")
SHAPES = ("prop", "box", "cylinder", "sphere", "file", "group")


class PropEntry(Schema):
    """Props of one kind in one layout."""

    prop: Value | None = Field(default=None, description="name of a prop [-]")
    box: Triple | None = Field(default=None, description="a box: along x, y, z [m]")
    cylinder: Pair | None = Field(default=None, description="an upright cylinder: radius, height [m]")
    sphere: Value | None = Field(default=None, description="a sphere: radius [m]")
    file: str | None = Field(
        default=None, description="a folder with a prop.yaml, or a mesh that collides as its convex hull [-]"
    )
    group: str | None = Field(default=None, description="name of a group [-]")
    name: Label | None = Field(default=None, description="default: that of the prop [-]")

    at: PointSpec | None = Field(default=None, description="x, y and perhaps z [m]")
    grid: GridSpec | None = Field(default=None, description="columns and rows [-]")
    line: LineSpec | None = Field(default=None, description="from one point to another [-]")
    along: AlongSpec | None = Field(default=None, description="along a track [-]")
    ring: RingSpec | None = Field(default=None, description="on a circle [-]")
    scatter: ScatterSpec | None = Field(default=None, description="anywhere in an area [-]")

    z: Value | None = Field(default=None, description="height of its foot; default: on the ground [m]")
    yaw: Value | list[Value] = Field(default=0.0, description="added to the heading of the layout [rad]")
    pitch: Value = Field(default=0.0, description="nose down [rad]")
    roll: Value = Field(default=0.0, description="right side down [rad]")
    jitter: JitterSpec | None = Field(default=None, description="small deviations from the place [-]")
    size: Triple | None = Field(default=None, description="of a resizable prop: along x, y, z [m]")
    scale: Value = Field(default=1.0, description="times as large [-]")
    color: Triple | str | None = Field(default=None, description="a name of CSS, or red, green, blue from 0 to 1 [-]")
    static: bool = Field(default=True, description="false: a body of its own that can be knocked over [-]")
    mass: Value | None = Field(default=None, description="of one that is not static; default: that of the prop [kg]")
    with_: dict[str, Value] = Field(default_factory=dict, alias="with", description="parameters of the group [-]")

    @field_validator("yaw")
    @classmethod
    def _some(cls, yaw: Any) -> Any:
        if isinstance(yaw, list) and not yaw:
            raise ValueError("the list is empty")
        return yaw

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        _exactly_one(self, SHAPES)
        _exactly_one(self, LAYOUTS)
        given = self.model_fields_set
        if self.group is not None:
            for name in ("size", "scale", "color", "static", "mass", "pitch", "roll"):
                if name in given:
                    raise ValueError(f"{name} belongs to a prop, not to a group")
        elif "with_" in given:
            raise ValueError("with belongs to a group")
        if self.z is not None and self.at is not None and len(self.at) == 3:
            raise ValueError("z stands in at already")
        if self.static and self.mass is not None:
            raise ValueError("mass belongs to static: false")
        return self

    @property
    def label(self) -> str:
        """The name, or what it is."""
        if self.name:
            return self.name
        if self.file is not None:
            return "".join(letter if letter.isalnum() else "_" for letter in self.file.rsplit("/", 1)[-1].split(".")[0])
        text = str(self.prop or self.group or next(shape for shape in SHAPES if getattr(self, shape) is not None))
        return text if text.isidentifier() else "prop"


class GroupSpec(Schema):
    """Props that belong together, with an origin of their own."""

    params: dict[str, Value] = Field(default_factory=dict, description="parameters and their defaults [-]")
    props: Annotated[list[PropEntry], Field(min_length=1, max_length=1000)] = Field(description="what is in it [-]")


# --- rules --------------------------------------------------------------------------------------------------------


class CorridorSpec(Schema):
    """The straight between two places."""

    from_: str = Field(alias="from", description="a start or a goal [-]")
    to: str = Field(description="a start or a goal [-]")


class KeepClearSpec(Schema):
    """An area without props: around a start or goal, along a straight between two, or on a track."""

    around: str | None = Field(default=None, description="a start or a goal [-]")
    radius: Length | None = Field(default=None, gt=0.0, description="around it [m]")
    along: CorridorSpec | None = Field(default=None, description="from one to another [-]")
    width: Length | None = Field(default=None, gt=0.0, description="of the corridor [m]")
    track: str | None = Field(default=None, description="a track [-]")
    margin: Length | None = Field(default=None, ge=0.0, description="beside the road, default 0 [m]")

    @model_validator(mode="after")
    def _one(self) -> Self:
        _exactly_one(self, ("around", "along", "track"))
        for name, owner, needed in (("radius", "around", True), ("width", "along", True), ("margin", "track", False)):
            if getattr(self, name) is not None and getattr(self, owner) is None:
                raise ValueError(f"{name} belongs to {owner}")
            if needed and getattr(self, owner) is not None and getattr(self, name) is None:
                raise ValueError(f"{owner} needs {name}")
        return self


class WhereSpec(Schema):
    """Props that shall be in, or not in, an area; all of their footprint counts."""

    props: str = Field(description="names, with * and ? [-]")
    region: RegionSpec | str = Field(description="an area, or the name of a patch or a track [-]")


class OnGroundSpec(Schema):
    """Props that shall stand on the ground."""

    props: str = Field(default="*", description="names, with * and ? [-]")
    tolerance: Length = Field(default=0.02, ge=0.0, description="largest gap or depth [m]")


class DrivableSpec(Schema):
    """A vehicle shall have a way."""

    vehicle: str = Field(default="bolt", description="name of a vehicle [-]")
    from_: str = Field(alias="from", description="a start [-]")
    to: str = Field(description="a goal or a start [-]")
    margin: Length = Field(default=0.1, ge=0.0, description="beside the vehicle [m]")


class RuleSpec(Schema):
    """What must hold in the world; a broken rule makes the world invalid, it never fails a test."""

    min_gap: Length | None = Field(default=None, ge=0.0, description="between any two props [m]")
    keep_clear: KeepClearSpec | None = Field(default=None, description="an area without props [-]")
    inside: WhereSpec | None = Field(default=None, description="props that are in an area [-]")
    outside: WhereSpec | None = Field(default=None, description="props that are not in an area [-]")
    on_ground: OnGroundSpec | None = Field(default=None, description="props that stand on the ground [-]")
    allow_overlap: Annotated[list[str], Field(min_length=2, max_length=2)] | None = Field(
        default=None, description="two names, with * and ?, that may overlap [-]"
    )
    drivable: DrivableSpec | None = Field(default=None, description="a way for a vehicle [-]")

    @model_validator(mode="after")
    def _one(self) -> Self:
        _exactly_one(self, ("min_gap", "keep_clear", "inside", "outside", "on_ground", "allow_overlap", "drivable"))
        return self


# --- tests --------------------------------------------------------------------------------------------------------


class SearchSpec(Schema):
    """Where to look for a variation that fails."""

    over: dict[str, tuple[float, float]] = Field(min_length=1, description="lower and upper end of parameters [-]")
    budget: int = Field(default=50, ge=1, le=100_000, description="runs [-]")

    @field_validator("over")
    @classmethod
    def _rising(cls, over: dict[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
        for name, (low, high) in over.items():
            if not low < high:
                raise ValueError(f"{name}: the lower end comes first")
        return over


def is_seed(value: Any) -> bool:
    """Whether a value can be a seed: a whole number."""
    return isinstance(value, int) and not isinstance(value, bool)


class CaseSpec(Schema):
    """A test: a vehicle with a behaviour, and what is required of it."""

    model_config = ConfigDict(populate_by_name=True)

    name: Label = Field(description="its name [-]")
    vehicle: str = Field(default="bolt", description="name of a vehicle [-]")
    start: str | None = Field(default=None, description="a start of the world; default: the first [-]")
    goal: str | None = Field(default=None, description="a goal of the world, 'at goal' means it [-]")
    behaviour: str | dict[str, Any] = Field(description="a driver as in a diagram file, its kind, or module:Class [-]")
    duration: Duration = Field(default=30.0, gt=0.0, le=86400.0, description="simulated time [s]")
    contact: Literal["point", "hydroelastic"] = Field(default="point", description="contact of the tyres [-]")
    variations: dict[str, int | list[Any]] = Field(
        default_factory=dict, description="values of parameters, and of seed, all with all [-]"
    )
    expect: Annotated[list[str], Field(min_length=1)] = Field(description="requirements [-]")
    search: SearchSpec | None = Field(default=None, description="where to look for failures [-]")

    @field_validator("variations")
    @classmethod
    def _lists(cls, variations: dict[str, int | list[Any]]) -> dict[str, int | list[Any]]:
        for name, values in variations.items():
            if isinstance(values, list) and not values:
                raise ValueError(f"{name}: the list is empty")
            if isinstance(values, int) and (name != "seed" or not 1 <= values <= 10_000):
                raise ValueError(f"{name}: a list of values is expected; seed may be a number of seeds")
            if name == "seed" and isinstance(values, list) and not all(map(is_seed, values)):
                raise ValueError("seed: whole numbers are expected")
        return variations
