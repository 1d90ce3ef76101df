"""Kinds of collision shapes of props.

A new kind is a class derived from :class:`SolidKind` and an entry of :data:`SOLID_KINDS`. Everything that depends on
the kind is here: its key in prop.yaml, sizes, corners, volume, and its element in SDF.
"""

# ruff: noqa: ARG002  # all kinds share one signature

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Box, Convex, Cylinder, Shape, Sphere

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import Length

Array = NDArray[np.float64]
Size = tuple[float, float, float]

SMALLEST, LARGEST = 1e-3, 1e4
"""Allowed sizes of props and their solids [m]."""

_CIRCLE = 24  # corners of the polygon around a circle


class SolidKind(ABC):
    """A kind of collision shape.

    Attributes:
        key: its key in files.
        annotation: type of its value in prop.yaml.
        description: description of its value in prop.yaml, with the unit.
        shape_type: class of Drake.
        sdf_keys: children of its element in SDF.
    """

    key: ClassVar[str]
    annotation: ClassVar[Any]
    description: ClassVar[str]
    shape_type: ClassVar[type[Shape]]
    sdf_keys: ClassVar[tuple[str, ...]]

    @abstractmethod
    def make(self, sizes: Sequence[float], factors: Size = (1.0, 1.0, 1.0)) -> Shape:
        """Return the shape of some sizes [m], stretched by factors along its axes."""

    @abstractmethod
    def sizes(self, shape: Any) -> list[float]:
        """Return the sizes of a shape [m]; those of a mesh are its scale."""

    def extent(self, sizes: Sequence[float]) -> Size:
        """Return the size of the bounding box along x, y, z [m]; each primitive defines it, a mesh has none."""
        raise NotImplementedError

    @abstractmethod
    def corners(self, shape: Any) -> Array:
        """Return points whose convex hull is the shape (n, 3), in its own frame [m]; circles are polygons around."""

    @abstractmethod
    def volume(self, shape: Any) -> float:
        """Return the volume [m³]; of a mesh that of its bounding box."""

    def read(self, value: Any, folder: Path, factors: Size, where: str) -> Shape:
        """Return the shape of a value in prop.yaml.

        Args:
            value: value of the file.
            folder: folder of the file.
            factors: factors by which it is stretched along the axes of the prop.
            where: place of the entry, for messages.

        Raises:
            ConfigError: the value is invalid.
        """
        return self.make([*value] if isinstance(value, Sequence) else [value], factors)

    def sdf_values(self, shape: Any) -> tuple[Any, ...]:
        """Return a value for each of the `sdf_keys`."""
        return tuple(self.sizes(shape))


class BoxKind(SolidKind):
    """A box: along x, y, z."""

    key = "box"
    annotation = tuple[Length, Length, Length]
    description = "along x, y, z [m]"
    shape_type = Box
    sdf_keys = ("size",)

    def make(self, sizes: Sequence[float], factors: Size = (1.0, 1.0, 1.0)) -> Shape:
        """Return the box."""
        return Box(*np.multiply(sizes, factors))

    def sizes(self, shape: Box) -> list[float]:
        """Return the edge lengths of a box along x, y, z [m]."""
        sizes: list[float] = shape.size().tolist()
        return sizes

    def extent(self, sizes: Sequence[float]) -> Size:
        """Return its lengths."""
        return sizes[0], sizes[1], sizes[2]

    def corners(self, shape: Box) -> Array:
        """Return its eight corners."""
        signs = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], dtype=float)
        return np.asarray(0.5 * signs * shape.size())

    def volume(self, shape: Box) -> float:
        """Return the volume [m³]."""
        return float(np.prod(shape.size()))

    def sdf_values(self, shape: Box) -> tuple[Any, ...]:
        """Return its size."""
        return (shape.size(),)


class CylinderKind(SolidKind):
    """A cylinder about z: radius and height."""

    key = "cylinder"
    annotation = tuple[Length, Length]
    description = "radius and height, axis z [m]"
    shape_type = Cylinder
    sdf_keys = ("radius", "length")

    def make(self, sizes: Sequence[float], factors: Size = (1.0, 1.0, 1.0)) -> Shape:
        """Return the cylinder; its cross-section stays a circle of the stretched area."""
        radius, height = sizes
        return Cylinder(radius * math.sqrt(factors[0] * factors[1]), height * factors[2])

    def sizes(self, shape: Cylinder) -> list[float]:
        """Return its radius and height."""
        return [shape.radius(), shape.length()]

    def extent(self, sizes: Sequence[float]) -> Size:
        """Return the extent along x, y, z [m]: diameter, diameter, height."""
        return 2.0 * sizes[0], 2.0 * sizes[0], sizes[1]

    def corners(self, shape: Cylinder) -> Array:
        """Return the corners of the prism around it."""
        rim, half = shape.radius() * _circle(), shape.length() / 2.0
        return np.vstack([np.column_stack((rim, np.full(_CIRCLE, z))) for z in (-half, half)])

    def volume(self, shape: Cylinder) -> float:
        """Return the volume [m³]."""
        return float(math.pi * shape.radius() ** 2 * shape.length())


class SphereKind(SolidKind):
    """A sphere: radius."""

    key = "sphere"
    annotation = Length
    description = "radius [m]"
    shape_type = Sphere
    sdf_keys = ("radius",)

    def make(self, sizes: Sequence[float], factors: Size = (1.0, 1.0, 1.0)) -> Shape:
        """Return the sphere; it stays a sphere of the stretched volume."""
        return Sphere(sizes[0] * math.prod(factors) ** (1.0 / 3.0))

    def sizes(self, shape: Sphere) -> list[float]:
        """Return its radius."""
        return [shape.radius()]

    def extent(self, sizes: Sequence[float]) -> Size:
        """Return its diameter three times."""
        return 2.0 * sizes[0], 2.0 * sizes[0], 2.0 * sizes[0]

    def corners(self, shape: Sphere) -> Array:
        """Return the corners of the polygon around its equator, and its poles."""
        radius = shape.radius()
        poles = np.array([[0.0, 0.0, radius], [0.0, 0.0, -radius]])
        return np.vstack((np.column_stack((radius * _circle(), np.zeros(_CIRCLE))), poles))

    def volume(self, shape: Sphere) -> float:
        """Return the volume [m³]."""
        return float(4.0 / 3.0 * math.pi * shape.radius() ** 3)


class ConvexKind(SolidKind):
    """The convex hull of a mesh file."""

    key = "convex"
    annotation = str
    description = "mesh beside prop.yaml, whose convex hull collides [-]"
    shape_type = Convex
    sdf_keys = ("uri", "scale")

    def make(self, sizes: Sequence[float], factors: Size = (1.0, 1.0, 1.0)) -> Shape:
        """Raise an error, as meshes are read from files, see :meth:`read`."""
        raise NotImplementedError

    def read(self, value: Any, folder: Path, factors: Size, where: str) -> Shape:
        """Return the convex hull of a mesh beside prop.yaml."""
        path = folder / str(value)
        if not path.is_file():
            raise ConfigError(f"no such file: {value}", where=where)
        shape = Convex(str(path), np.asarray(factors, dtype=float))
        try:
            self.corners(shape)
        except (RuntimeError, ValueError):  # texts of Qhull or of Drake's mesh readers do not name the cause
            raise ConfigError(
                f"{path.name} is not a mesh with a volume; it needs four corners that are not in one plane", where=where
            ) from None
        return shape

    def sizes(self, shape: Convex) -> list[float]:
        """Return its scale along x, y, z."""
        return [float(factor) for factor in shape.scale3()]

    def corners(self, shape: Convex) -> Array:
        """Return the corners of its hull."""
        hull = shape.GetConvexHull()
        return np.array([hull.vertex(index) for index in range(hull.num_vertices())])

    def volume(self, shape: Convex) -> float:
        """Return the volume of its bounding box."""
        return float(np.prod(np.ptp(self.corners(shape), axis=0)))


SOLID_KINDS: tuple[SolidKind, ...] = (BoxKind(), CylinderKind(), SphereKind(), ConvexKind())
"""All kinds of solids."""


def kind_of(shape: Shape) -> SolidKind:
    """Return the kind of a shape."""
    return next(kind for kind in SOLID_KINDS if isinstance(shape, kind.shape_type))


def mesh_of(shape: Shape) -> Path | None:
    """Return the mesh file of a shape, or None for a primitive."""
    return Path(shape.source().path()) if isinstance(shape, Convex) else None


def _circle() -> Array:
    """Return the corners of a regular polygon around the unit circle (n, 2)."""
    angles = 2.0 * math.pi * np.arange(_CIRCLE) / _CIRCLE
    return np.column_stack((np.cos(angles), np.sin(angles))) / math.cos(math.pi / _CIRCLE)
