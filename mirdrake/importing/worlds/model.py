"""What a Gazebo world says, in one form for all its dialects, before anything of it becomes a world of mirdrake."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform

from mirdrake.importing.changes import Change
from mirdrake.importing.shape import Shape

Array = NDArray[np.float64]


@dataclass
class Thing:
    """A model that stands in the world; W is the frame of the world, M that of the model, both as in the source.

    Attributes:
        name: in the source, nested ones joined with ``::``.
        kind: name of the model that was included, or of the model itself.
        X_WM: pose.
        static: it never moves.
        visuals: shapes that are seen; their poses count from M.
        collisions: shapes that collide; their poses count from M.
        mass: of all links [kg]; None if none is given.
        mu: smallest friction coefficient that its collisions name; None if they name none.
        wheels: joints that turn without end, or that a wheel or steering might have.
        loose: joints that move.
        sources: names of the models whose files it needs and that are not at hand.
        absent: it was included, but there is no such model; it has no shapes then.
        missing: changes that tell of meshes that are not at hand.
        broken: ``file:line: fault`` of what made it, or a part of it, unreadable.
        where: ``file:line``.
    """

    name: str
    kind: str
    X_WM: RigidTransform
    static: bool
    visuals: list[Shape] = field(default_factory=list)
    collisions: list[Shape] = field(default_factory=list)
    mass: float | None = None
    mu: float | None = None
    wheels: int = 0
    loose: int = 0
    sources: list[str] = field(default_factory=list)
    absent: bool = False
    missing: list[Change] = field(default_factory=list)
    broken: list[str] = field(default_factory=list)
    where: str = ""


@dataclass
class Crowd:
    """A population: copies of one thing in one layout.

    Attributes:
        name: of the population.
        thing: one of them; its pose is that of the population.
        layout: random, uniform, grid, linear-x, linear-y or linear-z.
        count: how many; of a grid columns times rows.
        box: edges of the region [m]; None for a cylinder or a grid.
        radius: of the region [m]; None for a box or a grid.
        step: of a grid along x and y [m].
        grid: columns along x, rows along y.
        where: ``file:line``.
    """

    name: str
    thing: Thing
    layout: str
    count: int
    box: tuple[float, float, float] | None = None
    radius: float | None = None
    step: tuple[float, float] = (0.0, 0.0)
    grid: tuple[int, int] = (1, 1)
    where: str = ""


@dataclass
class Plane:
    """A ground plane.

    Attributes:
        name: of its model.
        X_WP: pose; z is its normal.
        size: what is seen of it along its x and y [m]; None if nothing says it.
        mu: friction coefficient; None if none is given.
        words: names of model and materials, from which the surface is guessed.
        where: ``file:line``.
    """

    name: str
    X_WP: RigidTransform
    size: tuple[float, float] | None
    mu: float | None
    words: str
    where: str


@dataclass
class Road:
    """A road of Gazebo: a line of points [m] (n, 3) with a width [m]."""

    name: str
    points: Array
    width: float
    words: str
    where: str


@dataclass
class Sun:
    """A directional light: the direction it shines in, in W."""

    name: str
    direction: Array
    where: str


@dataclass
class SourceWorld:
    """A whole world as read.

    Attributes:
        name: of the world.
        suns: directional lights, in order.
        actors: name, model, pose in W and place of what walks or drives along a way.
        changes: what was left out or changed while reading.
        files: that took part, main file first.
    """

    name: str
    things: list[Thing] = field(default_factory=list)
    crowds: list[Crowd] = field(default_factory=list)
    planes: list[Plane] = field(default_factory=list)
    roads: list[Road] = field(default_factory=list)
    suns: list[Sun] = field(default_factory=list)
    actors: list[tuple[str, str, RigidTransform, str]] = field(default_factory=list)
    changes: list[Change] = field(default_factory=list)
    files: list[Path] = field(default_factory=list)
