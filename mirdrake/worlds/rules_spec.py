"""Part of the world language: rules that a world must satisfy."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from mirdrake.core.yaml_io import Length, Schema
from mirdrake.worlds.regions import RegionSpec
from mirdrake.worlds.schema_types import exactly_one


class CorridorSpec(Schema):
    """The straight corridor between two starts or goals."""

    from_: str = Field(alias="from", description="a start or a goal [-]")
    to: str = Field(description="a start or a goal [-]")


class KeepClearSpec(Schema):
    """An area without props: around a start or goal, in a corridor between two of them, or on a track."""

    around: str | None = Field(default=None, description="a start or a goal [-]")
    radius: Length | None = Field(default=None, gt=0.0, description="radius around it [m]")
    along: CorridorSpec | None = Field(default=None, description="a corridor [-]")
    width: Length | None = Field(default=None, gt=0.0, description="width of the corridor [m]")
    track: str | None = Field(default=None, description="a track [-]")
    margin: Length | None = Field(default=None, ge=0.0, description="margin beside the road, default 0 [m]")

    @model_validator(mode="after")
    def _one(self) -> Self:
        exactly_one(self, ("around", "along", "track"))
        for name, owner, needed in (("radius", "around", True), ("width", "along", True), ("margin", "track", False)):
            if getattr(self, name) is not None and getattr(self, owner) is None:
                raise ValueError(f"{name} belongs to {owner}")
            if needed and getattr(self, owner) is not None and getattr(self, name) is None:
                raise ValueError(f"{owner} needs {name}")
        return self


class PlacementRuleSpec(Schema):
    """Props that must be inside or outside a region with their whole footprint."""

    props: str = Field(description="names, with * and ? [-]")
    region: RegionSpec | str = Field(description="a region, or the name of a patch or a track [-]")


class OnGroundSpec(Schema):
    """Props that must stand on the ground."""

    props: str = Field(default="*", description="names, with * and ? [-]")
    tolerance: Length = Field(default=0.02, ge=0.0, description="largest gap or depth [m]")


class DrivableSpec(Schema):
    """A vehicle must have a path from a start to a goal."""

    vehicle: str = Field(default="bolt", description="name of a vehicle [-]")
    from_: str = Field(alias="from", description="a start [-]")
    to: str = Field(description="a goal or a start [-]")
    margin: Length = Field(default=0.1, ge=0.0, description="margin beside the vehicle [m]")


class RuleSpec(Schema):
    """A condition on the world; a broken rule makes the world invalid, it never fails a test."""

    min_gap: Length | None = Field(default=None, ge=0.0, description="smallest gap between any two props [m]")
    keep_clear: KeepClearSpec | None = Field(default=None, description="an area without props [-]")
    inside: PlacementRuleSpec | None = Field(default=None, description="props that are inside a region [-]")
    outside: PlacementRuleSpec | None = Field(default=None, description="props that are outside a region [-]")
    on_ground: OnGroundSpec | None = Field(default=None, description="props that stand on the ground [-]")
    allow_overlap: Annotated[list[str], Field(min_length=2, max_length=2)] | None = Field(
        default=None, description="two names, with * and ?, of props that may overlap [-]"
    )
    drivable: DrivableSpec | None = Field(default=None, description="a path that a vehicle must have [-]")

    @model_validator(mode="after")
    def _one(self) -> Self:
        exactly_one(self, tuple(RuleSpec.model_fields))
        return self
