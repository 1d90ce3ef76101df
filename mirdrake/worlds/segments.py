"""Segments of a centre line.

A new kind is a class derived from :class:`Segment` and a field of :class:`SegmentSpec`.
"""

import math
from abc import abstractmethod
from typing import Annotated, Any, Literal, Self

from pydantic import Field, PlainValidator, RootModel, model_validator

from mirdrake.core.yaml_io import Angle, Length, Schema, to_si
from mirdrake.worlds.pieces import Piece
from mirdrake.worlds.schema_types import exactly_one, given_one, kinds_of


def _length_or_auto(value: Any) -> float | Literal["auto"]:
    if value == "auto":
        return "auto"
    number = to_si(value, "m")
    if isinstance(number, bool) or not isinstance(number, int | float) or not 1e-3 <= number < math.inf:
        raise ValueError(f"{value!r} is neither a length of at least 1 mm nor 'auto'")
    return float(number)


def _radius_or_straight(value: Any) -> float | Literal["straight"]:
    if value in ("straight", "inf"):
        return "straight"
    number = to_si(value, "m")
    if isinstance(number, bool) or not isinstance(number, int | float) or not 0.01 <= abs(number) < math.inf:
        raise ValueError(f"{value!r} is neither a signed radius of at least 0.01 m (+ turns left) nor 'straight'")
    return float(number)


LengthOrAuto = Annotated[float | Literal["auto"], PlainValidator(_length_or_auto, json_schema_input_type=float | str)]
RadiusOrStraight = Annotated[
    float | Literal["straight"], PlainValidator(_radius_or_straight, json_schema_input_type=float | str)
]


class Segment:
    """A kind of segment."""

    @abstractmethod
    def pieces(self) -> list[Piece]:
        """Return its pieces; one of unknown length has the length 0."""


class LineSegment(RootModel[LengthOrAuto], Segment):
    """A straight of a length [m], or `auto`."""

    def pieces(self) -> list[Piece]:
        """Return one piece."""
        return [Piece(0.0 if self.root == "auto" else self.root, 0.0, 0.0)]


class ArcSpec(Schema, Segment):
    """A circular arc, with clothoids at its ends if `transition` is given."""

    radius: Annotated[Length, Field(ge=0.01, le=1e6)] = Field(description="radius of the centre line [m]")
    angle: Angle = Field(description="heading change of the whole segment, + left [rad]")
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

    def pieces(self) -> list[Piece]:
        """Return the arc and its optional clothoids."""
        k = math.copysign(1.0 / self.radius, self.angle)
        clothoid = 2.0 * self.radius * self.transition  # length over which 0 -> 1/R turns `transition`
        rest = max(0.0, abs(self.angle) - 2.0 * self.transition)
        pieces = [Piece(clothoid, 0.0, k), Piece(self.radius * rest, k, k), Piece(clothoid, k, 0.0)]
        present = (bool(clothoid), rest > 1e-12, bool(clothoid))
        return [piece for piece, keep in zip(pieces, present, strict=True) if keep]


class ClothoidSpec(Schema, Segment):
    """A curve whose curvature changes linearly with arc length; radii are signed, + left."""

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
                raise ValueError("angle does not fit the radii; give it their sign (+ left), or give length")
        if not abs(self.arc_length * sum(self.curvatures) / 2.0) <= 4.0 * math.pi:
            raise ValueError("it turns more than 720 deg")
        return self

    def pieces(self) -> list[Piece]:
        """Return one piece."""
        return [Piece(self.arc_length, *self.curvatures)]


class SegmentSpec(Schema):
    """One segment of a centre line: exactly one of line, arc and clothoid."""

    line: LineSegment | None = Field(default=None, description="length of a straight, or auto [m]")
    arc: ArcSpec | None = Field(default=None, description="circular arc [-]")
    clothoid: ClothoidSpec | None = Field(default=None, description="linear change of curvature [-]")

    @model_validator(mode="after")
    def _one(self) -> Self:
        exactly_one(self, kinds_of(SegmentSpec, Segment))
        return self

    @property
    def pieces(self) -> list[Piece]:
        """Its pieces; one of unknown length has the length 0."""
        segment: Segment = given_one(self, kinds_of(SegmentSpec, Segment))
        return segment.pieces()
