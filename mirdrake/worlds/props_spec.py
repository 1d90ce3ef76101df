"""Part of the world language: props and groups of props.

A number may be an expression, see :mod:`mirdrake.worlds.values`. All values of ``props`` and ``groups`` are drawn once
for every prop that is placed.

An entry of ``props`` states what is placed (`prop`, `box`, `cylinder`, `sphere`, `file` or `group`) and where, in one
layout::

    props:
      - {prop: stop_sign, at: [12, -3], yaw: 180 deg}
      - {prop: cone, line: {from: [0, 2], to: [30, 2], spacing: 3}}
      - {prop: sedan | van, name: car, grid: {step: [5.5, 18], count: [6, 2]}, yaw: [90 deg, -90 deg]}
      - {prop: barrel, along: {track: main, spacing: 20, side: both, distance: 0.5}}
      - {box: [1, 2, 0.5], ring: {center: [0, 0], radius: 10, count: 8}, color: [0.8, 0.1, 0.1]}
      - {prop: tree, scatter: {region: {rect: {center: [0, 40], size: [80, 20]}}, count: 30}, yaw: 0 .. 360 deg}
      - {group: city_block, at: [60, 0], with: {side: 40}}

`yaw` is added to the heading of the layout: along a line or a track, along the tangent of a ring (counter-clockwise), 0
otherwise. A list of yaws is used row by row in a grid and one after the other elsewhere.
"""

from typing import Annotated, Any, Self

from pydantic import Field, field_validator, model_validator

from mirdrake.core.yaml_io import Schema
from mirdrake.worlds.layouts import (
    AlongLayout,
    AtLayout,
    GridLayout,
    Layout,
    LineLayout,
    RingLayout,
    ScatterLayout,
)
from mirdrake.worlds.schema_types import Label, Triple, Value, exactly_one, given_one, kinds_of
from mirdrake.worlds.shapes import BoxShape, CylinderShape, FileShape, LibraryShape, PropShape, SphereShape
from mirdrake.worlds.values import Number, is_random


class JitterSpec(Schema):
    """Small deviations from the position, along the axes of the layout."""

    x: Value = Field(default=0.0, description="deviation along the layout's heading [m]")
    y: Value = Field(default=0.0, description="deviation to the left of the layout's heading [m]")
    yaw: Value = Field(default=0.0, description="deviation of the heading [rad]")


class PropEntry(Schema):
    """Props of one kind in one layout."""

    prop: LibraryShape | None = Field(default=None, description="name of a prop [-]")
    box: BoxShape | None = Field(default=None, description="a box: along x, y, z [m]")
    cylinder: CylinderShape | None = Field(default=None, description="an upright cylinder: radius, height [m]")
    sphere: SphereShape | None = Field(default=None, description="a sphere: radius [m]")
    file: FileShape | None = Field(
        default=None, description="a folder with a prop.yaml, or a mesh whose convex hull collides [-]"
    )
    group: str | None = Field(default=None, description="name of a group [-]")
    name: Label | None = Field(default=None, description="default: that of the prop [-]")

    at: AtLayout | None = Field(default=None, description="x, y and optionally z [m]")
    grid: GridLayout | None = Field(default=None, description="columns and rows [-]")
    line: LineLayout | None = Field(default=None, description="line from one point to another [-]")
    along: AlongLayout | None = Field(default=None, description="row along a track [-]")
    ring: RingLayout | None = Field(default=None, description="on a circle [-]")
    scatter: ScatterLayout | None = Field(default=None, description="at random in a region [-]")

    z: Value | None = Field(default=None, description="height of its lower side; default: on the ground [m]")
    yaw: Value | list[Value] = Field(default=0.0, description="angle added to the heading of the layout [rad]")
    pitch: Value = Field(default=0.0, description="nose down [rad]")
    roll: Value = Field(default=0.0, description="right side down [rad]")
    jitter: JitterSpec | None = Field(default=None, description="small deviations from the position [-]")
    size: Triple | None = Field(default=None, description="size of a resizable prop, along x, y, z [m]")
    scale: Value = Field(default=1.0, description="factor of all lengths [-]")
    color: Triple | str | None = Field(default=None, description="CSS colour name, or red, green, blue, 0 to 1 [-]")
    static: bool = Field(default=True, description="false: a body that can be knocked over [-]")
    mass: Value | None = Field(
        default=None, description="mass of a body that is not static; default: that of the prop [kg]"
    )
    driven_over: bool | None = Field(
        default=None, description="vehicles drive over it, so it is part of the ground; default: that of the prop [-]"
    )
    with_: dict[str, Value] = Field(default_factory=dict, alias="with", description="parameters of the group [-]")

    @field_validator("yaw")
    @classmethod
    def _not_empty(cls, yaw: Any) -> Any:
        if isinstance(yaw, list) and not yaw:
            raise ValueError("the list is empty")
        return yaw

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        exactly_one(self, _SHAPES)
        exactly_one(self, _LAYOUTS)
        # Keys that the file has, as defaults do not contradict anything.
        given = self.model_fields_set
        if self.group is not None:
            for name in ("size", "scale", "color", "static", "mass", "driven_over", "pitch", "roll"):
                if name in given:
                    raise ValueError(f"{name} belongs to a prop, not to a group")
        elif "with_" in given:
            raise ValueError("with belongs to a group")
        if self.z is not None and self.at is not None and self.at.z is not None:
            raise ValueError("z is given in at already")
        if self.static and self.mass is not None:
            raise ValueError("mass belongs to static: false")
        return self

    @property
    def shape(self) -> PropShape:
        """Shape of the placed prop; only for entries that are not a group."""
        shape: PropShape = given_one(self, _SHAPES)
        return shape

    @property
    def layout(self) -> Layout:
        """Layout of the positions."""
        layout: Layout = given_one(self, _LAYOUTS)
        return layout

    @property
    def label(self) -> str:
        """Name of the entry, or of its group or shape."""
        if self.name:
            return self.name
        if self.group is not None:
            return self.group if self.group.isidentifier() else "prop"
        return self.shape.label

    @property
    def is_random(self) -> bool:
        """Whether positions or sizes of the props are drawn at random."""
        values: list[Number | str | None] = [self.z, self.scale]
        values += self.yaw if isinstance(self.yaw, list) else [self.yaw]
        values += self.size or []
        values += [] if self.group is not None else self.shape.values
        if self.jitter is not None:
            values += [self.jitter.x, self.jitter.y, self.jitter.yaw]
        return self.layout.is_random or any(map(is_random, values))


_SHAPES = (*kinds_of(PropEntry, PropShape), "group")
_LAYOUTS = kinds_of(PropEntry, Layout)


class GroupSpec(Schema):
    """Group of props that is placed as a unit, with its own origin."""

    params: dict[str, Value] = Field(default_factory=dict, description="parameters and their defaults [-]")
    props: Annotated[list[PropEntry], Field(min_length=1, max_length=1000)] = Field(description="its props [-]")
