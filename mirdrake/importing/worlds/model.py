"""Content of a Gazebo world as read, in one form for all versions of SDF."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform

from mirdrake.core.errors import ModelError
from mirdrake.importing.changes import Changes
from mirdrake.importing.shape import Shape

Array = NDArray[np.float64]


@dataclass(eq=False)
class SourceObject:
    """A model of the world; W is the frame of the world, M that of the model, both as in the source.

    Attributes:
        name: name in the source; names of nested models are joined with ``::``.
        kind: name of the model that was included, or of the model itself.
        X_WM: pose.
        static: whether it never moves.
        visuals: visual shapes; poses in M.
        collisions: collision shapes; poses in M.
        mass: mass of all links [kg]; None if none is given.
        mu: smallest friction coefficient that its collisions name; None if they name none.
        wheels: joints that turn without end, or that a wheel or steering might have.
        loose: joints that move.
        sources: names of the models whose files are missing.
        absent: whether the included model was not found; it has no shapes then.
        missing: changes of missing meshes.
        broken: ``file:line: fault`` of each fault that made it or a part unreadable.
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
    missing: Changes = field(default_factory=Changes)
    broken: list[ModelError] = field(default_factory=list)
    where: str = ""


@dataclass
class Crowd:
    """A population: copies of one object in one layout.

    Attributes:
        name: name of the population.
        obj: one of the copies; its pose is that of the population.
        layout: random, uniform, grid, linear-x, linear-y or linear-z.
        count: number of copies; columns times rows of a grid.
        box: edges of the region [m]; None for a cylinder or a grid.
        radius: radius of the region [m]; None for a box or a grid.
        step: step of a grid along x and y [m].
        grid: columns along x, rows along y.
        where: ``file:line``.
    """

    name: str
    obj: SourceObject
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
        name: name of its model.
        X_WP: pose; z is its normal.
        size: size of its visual along x and y [m]; None if it is not stated.
        mu: friction coefficient; None if none is given.
        words: names of model and materials, that indicate the kind of surface.
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
        name: name of the world.
        suns: directional lights, in order.
        actors: name, model, pose in W and place of each moving actor.
        changes: changes of the readers.
        files: files that took part, main file first.
    """

    name: str
    objects: list[SourceObject] = field(default_factory=list)
    crowds: list[Crowd] = field(default_factory=list)
    planes: list[Plane] = field(default_factory=list)
    roads: list[Road] = field(default_factory=list)
    suns: list[Sun] = field(default_factory=list)
    actors: list[tuple[str, str, RigidTransform, str]] = field(default_factory=list)
    changes: Changes = field(default_factory=Changes)
    files: list[Path] = field(default_factory=list)
