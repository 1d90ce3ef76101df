"""What a prop is: shapes that collide, a mesh to see, a mass.

::

    models/props/<name>/prop.yaml ── load_prop ──► Prop ── PlacedProp(pose) in a World

The frame P of a prop is on the ground below the middle of the box around it: x ahead, y left, z up.
"""

import fnmatch
import math
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Self

import numpy as np
import shapely
from numpy.typing import NDArray
from pydantic import Field, model_validator
from pydrake.geometry import Box, Convex, Cylinder, Shape, Sphere
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.tree import SpatialInertia
from shapely.geometry.base import BaseGeometry

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.paths import is_hidden, resolved, search_folders
from mirdrake.core.yaml_io import Angle, Length, Mass, Schema, load_yaml, where
from mirdrake.worlds.outlines import outlines_of

Array = NDArray[np.float64]
Size = tuple[float, float, float]
Color = tuple[float, float, float]

DEFAULT_MU = 0.6
"""Friction coefficient of a prop's sides [-]; rubber and steel on dry concrete or painted steel lie around it."""

DENSITY = 500.0
"""Density [kg/m³] of a primitive that may be knocked over and has no mass given; that of light wood."""

STIFFNESS = 1e6
"""Point contact stiffness of a prop [N/m]; that of a car's body, so that a bump of 1 m/s stops within 5 cm."""

DISSIPATION = 1.0
"""Hunt-Crossley dissipation of a prop [s/m]: a bump hardly bounces; with Drake's default of 50 s/m contact sticks."""

_CIRCLE = 24  # corners of a circle seen from above
_SMALLEST, _LARGEST = 1e-3, 1e4  # [m] sides of a prop


@dataclass(frozen=True)
class Solid:
    """A shape that collides, and its pose in the frame of the prop."""

    shape: Shape
    X_PS: RigidTransform

    @cached_property
    def corners(self) -> Array:
        """Points whose convex hull is the shape (n, 3), in P [m]; circles are polygons around them."""
        return np.asarray((self.X_PS.rotation().matrix() @ _corners(self.shape).T).T + self.X_PS.translation())

    @property
    def volume(self) -> float:
        """[m³]; of a convex mesh that of the box around it."""
        if isinstance(self.shape, Box):
            return float(np.prod(self.shape.size()))
        if isinstance(self.shape, Cylinder):
            return float(math.pi * self.shape.radius() ** 2 * self.shape.length())
        if isinstance(self.shape, Sphere):
            return float(4.0 / 3.0 * math.pi * self.shape.radius() ** 3)
        return float(np.prod(np.ptp(_corners(self.shape), axis=0)))


@dataclass(frozen=True)
class Prop:
    """A kind of prop in its final size."""

    name: str
    solids: tuple[Solid, ...]
    size: Size
    """of the box around it, along x, y, z [m]"""
    mass: float
    """[kg]"""
    mu: float = DEFAULT_MU
    """friction coefficient of its sides [-]"""
    visual: Path | None = None
    """mesh; None: its solids are what is seen"""
    scale: Size = (1.0, 1.0, 1.0)
    """of the mesh, along x, y, z [-]"""
    paint: str | None = None
    """material of the mesh that has the colour of the prop"""
    driven_over: bool = False
    """made to be driven over"""

    @property
    def inertia(self) -> SpatialInertia:
        """Inertia about P, in P: the mass spread evenly over the boxes around the solids, by their volumes."""
        total = sum(solid.volume for solid in self.solids)
        result = SpatialInertia.Zero()
        for solid in self.solids:
            corners = solid.corners
            size, middle = np.ptp(corners, axis=0), 0.5 * (corners.min(axis=0) + corners.max(axis=0))
            part = SpatialInertia.SolidBoxWithMass(self.mass * solid.volume / total, *size)
            result += part.Shift(-middle)
        return result


@dataclass(frozen=True)
class PlacedProp:
    """A prop in a world."""

    name: str
    prop: Prop
    X_WP: RigidTransform
    static: bool = True
    """False: a body of its own that can be knocked over"""
    color: Color | None = None
    """red, green, blue, 0 .. 1"""
    where: str = ""
    """``file:line: path`` of its entry"""
    random: bool = False
    """its place was drawn by chance"""
    order: tuple[int, ...] = field(default=(), compare=False)
    """where it stands in the file"""

    @cached_property
    def footprint(self) -> BaseGeometry:
        """What it covers seen from above, in W [m]."""
        hulls = [shapely.MultiPoint(points[:, :2]).convex_hull for points in self._corners]
        return hulls[0] if len(hulls) == 1 else shapely.union_all(hulls)

    def between(self, low: float, high: float) -> tuple[BaseGeometry, ...]:
        """What its solids cover between two heights [m] seen from above, convex polygons in W [m]."""
        known = self._between
        if (low, high) not in known:
            known[low, high] = tuple(outline.area for outline in outlines_of(self, low, high))
        return known[low, high]

    @cached_property
    def _between(self) -> dict[tuple[float, float], tuple[BaseGeometry, ...]]:
        """What :meth:`between` found."""
        return {}

    @cached_property
    def bottom(self) -> float:
        """Height of its lowest point [m]."""
        return float(min(points[:, 2].min() for points in self._corners))

    @cached_property
    def top(self) -> float:
        """Height of its highest point [m]."""
        return float(max(points[:, 2].max() for points in self._corners))

    @cached_property
    def _corners(self) -> list[Array]:
        R, p = self.X_WP.rotation().matrix(), self.X_WP.translation()
        return [solid.corners @ R.T + p for solid in self.prop.solids]

    def is_called(self, pattern: str) -> bool:
        """Whether its name, with or without its index, fits a pattern with * and ?."""
        return fnmatch.fnmatchcase(
            self.name.replace("[", "(").replace("]", ")"), pattern.replace("[", "(").replace("]", ")")
        ) or (fnmatch.fnmatchcase(self.name.rpartition("[")[0], pattern))


# --- files --------------------------------------------------------------------------------------------------------


class SolidSpec(Schema):
    """A shape that collides: exactly one of box, cylinder, sphere and convex."""

    box: tuple[Length, Length, Length] | None = Field(default=None, description="along x, y, z [m]")
    cylinder: tuple[Length, Length] | None = Field(default=None, description="radius and height, axis z [m]")
    sphere: Length | None = Field(default=None, description="radius [m]")
    convex: str | None = Field(default=None, description="mesh beside prop.yaml; its convex hull counts [-]")
    at: tuple[Length, Length, Length] = Field(default=(0.0, 0.0, 0.0), description="its middle in P [m]")
    yaw: Angle = Field(default=0.0, description="heading [rad]")
    pitch: Angle = Field(default=0.0, description="nose down [rad]")
    roll: Angle = Field(default=0.0, description="right side down [rad]")

    @model_validator(mode="after")
    def _one(self) -> Self:
        if sum(part is not None for part in (self.box, self.cylinder, self.sphere, self.convex)) != 1:
            raise ValueError("give exactly one of box, cylinder, sphere and convex")
        for side in (*(self.box or ()), *(self.cylinder or ()), *([self.sphere] if self.sphere is not None else [])):
            if not _SMALLEST <= side <= _LARGEST:
                raise ValueError(f"a side of {side:g} m; allowed are 1 mm to 10 km")
        return self


class PropFile(Schema):
    """A prop.yaml."""

    description: str = Field(description="what it is [-]")
    source: str = Field(default="", description="where its dimensions come from [-]")
    size: tuple[Length, Length, Length] = Field(description="of the box around it, along x, y, z [m]")
    mass: Mass = Field(gt=0.0, description="[kg]")
    mu: float = Field(default=DEFAULT_MU, gt=0.0, le=2.0, description="friction coefficient of its sides [-]")
    visual: str | None = Field(default=None, description="mesh beside prop.yaml; default: its solids are seen [-]")
    paint: str | None = Field(default=None, description="material of the mesh that `color` replaces [-]")
    resizable: bool = Field(default=False, description="`size` may stretch it [-]")
    driven_over: bool = Field(default=False, description="made to be driven over [-]")
    solids: list[SolidSpec] = Field(min_length=1, max_length=200, description="what it collides with [-]")


def prop_names() -> dict[str, Path]:
    """All props by name, with their folders."""
    found: dict[str, Path] = {}
    for folder in search_folders("models"):
        for path in sorted(folder.glob("props/*/prop.yaml")):
            if not is_hidden(path.parent.name):
                found.setdefault(path.parent.name, path.parent)
    return dict(sorted(found.items()))


def _find_prop(name: str) -> Path | None:
    """The folder of a prop; unlike with all names, nothing is listed."""
    folders = [folder / "props" / name for folder in search_folders("models") if name.isidentifier()]
    return next((folder for folder in folders if (folder / "prop.yaml").is_file()), None)


def load_prop(name: str, *, size: Size | None = None, scale: float = 1.0, where: str = "") -> Prop:
    """The prop of that name.

    Args:
        name: a folder below models/props/, or its path.
        size: wanted size along x, y, z [m], of a prop that is resizable.
        scale: times as large [-].
        where: put before messages.

    Raises:
        ConfigError: there is no such prop, its file has faults, or it cannot have that size.
    """
    folder = Path(name) if "/" in name else _find_prop(name)
    if folder is None:
        hint = did_you_mean(name, prop_names())
        raise ConfigError(f"{_prefix(where)}unknown prop '{name}'; {hint}; or use box, cylinder, sphere or file")
    spec = _load_file(resolved(folder) / "prop.yaml")
    factors = (scale, scale, scale)
    if size is not None:
        if not spec.resizable:
            raise ConfigError(f"{_prefix(where)}'{folder.name}' has the size {_shown(spec.size)} m; use scale instead")
        x, y, z = (scale * want / have for want, have in zip(size, spec.size, strict=True))
        factors = (x, y, z)
    return _make_prop(resolved(folder), folder.name, factors, where)


def make_primitive(kind: str, sides: tuple[float, ...], *, scale: float = 1.0, where: str = "") -> Prop:
    """A box (along x, y, z), an upright cylinder (radius, height) or a sphere (radius) [m] that stands on the ground.

    Raises:
        ConfigError: a side is not between 1 mm and 10 km.
    """
    sides = tuple(scale * side for side in sides)
    for side in sides:
        if not _SMALLEST <= side <= _LARGEST:
            raise ConfigError(f"{_prefix(where)}{kind} with a side of {side:g} m; allowed are 1 mm to 10 km")
    shape: Shape
    if kind == "box":
        shape, size = Box(*sides), (sides[0], sides[1], sides[2])
    elif kind == "cylinder":
        shape, size = Cylinder(*sides), (2.0 * sides[0], 2.0 * sides[0], sides[1])
    else:
        shape, size = Sphere(sides[0]), (2.0 * sides[0],) * 3
    solid = Solid(shape, RigidTransform([0.0, 0.0, size[2] / 2.0]))
    return Prop(kind, (solid,), size, DENSITY * solid.volume)


def make_mesh_prop(path: Path, *, scale: float = 1.0, where: str = "") -> Prop:
    """A mesh (glTF or OBJ) that collides as its convex hull and stands on the ground.

    Raises:
        ConfigError: there is no such file, or it is no mesh.
    """
    solid = _solid(SolidSpec(convex=path.name), path.parent, (scale,) * 3, where)
    low, high = solid.corners.min(axis=0), solid.corners.max(axis=0)
    size = tuple(float(side) for side in high - low)
    return Prop(path.stem, (solid,), size, DENSITY * solid.volume, visual=path, scale=(scale,) * 3)  # type: ignore[arg-type]


# --- the inner parts ----------------------------------------------------------------------------------------------


@lru_cache(maxsize=256)
def _read(path: Path, stamp: float) -> PropFile:  # noqa: ARG001
    return load_yaml(path, PropFile)


def _load_file(path: Path) -> PropFile:
    try:
        stamp = path.stat().st_mtime
    except OSError:
        stamp = 0.0
    return _read(path, stamp)


@lru_cache(maxsize=4096)
def _make_prop(folder: Path, name: str, factors: Size, place: str) -> Prop:
    spec = _load_file(folder / "prop.yaml")
    solids = tuple(_solid(solid, folder, factors, where(solid)) for solid in spec.solids)
    size = tuple(factor * side for factor, side in zip(factors, spec.size, strict=True))
    visual = None
    if spec.visual is not None:
        visual = folder / spec.visual
        if not visual.is_file():
            raise ConfigError(f"{where(spec, 'visual')}: no such file: {spec.visual}")
    mass = spec.mass * math.prod(factors)
    for side in size:
        if not _SMALLEST <= side <= _LARGEST:
            raise ConfigError(f"{_prefix(place)}'{name}' with a side of {side:g} m; allowed are 1 mm to 10 km")
    return Prop(name, solids, size, mass, spec.mu, visual, factors, spec.paint, spec.driven_over)  # type: ignore[arg-type]


def _solid(spec: SolidSpec, folder: Path, factors: Size, place: str) -> Solid:
    """A shape, stretched by factors along the axes of P."""
    X_PS = RigidTransform(RollPitchYaw(spec.roll, spec.pitch, spec.yaw), np.multiply(spec.at, factors))
    uniform = math.isclose(factors[0], factors[1]) and math.isclose(factors[0], factors[2])
    if not uniform and (spec.roll or spec.pitch or spec.yaw):
        raise ConfigError(
            f"{_prefix(place)}a turned solid cannot be stretched; give the prop a scale, or leave it upright"
        )
    if spec.box is not None:
        return Solid(Box(*np.multiply(spec.box, factors)), X_PS)
    if spec.cylinder is not None:
        radius, height = spec.cylinder
        return Solid(Cylinder(radius * math.sqrt(factors[0] * factors[1]), height * factors[2]), X_PS)
    if spec.sphere is not None:
        return Solid(Sphere(spec.sphere * math.prod(factors) ** (1.0 / 3.0)), X_PS)
    path = folder / str(spec.convex)
    if not path.is_file():
        raise ConfigError(f"{_prefix(place)}no such file: {spec.convex}")
    solid = Solid(Convex(str(path), np.asarray(factors, dtype=float)), X_PS)
    try:
        _corners(solid.shape)
    except (RuntimeError, ValueError):  # words of Qhull or of Drake's mesh readers, which name no cause in the file
        raise ConfigError(
            f"{_prefix(place)}{path.name} is not a mesh with a volume; it needs four corners that are not in one plane"
        ) from None
    return solid


def _corners(shape: Shape) -> Array:
    """Points whose convex hull is a shape (n, 3), in its own frame [m]."""
    if isinstance(shape, Box):
        signs = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], dtype=float)
        return np.asarray(0.5 * signs * shape.size())
    angles = 2.0 * math.pi * np.arange(_CIRCLE) / _CIRCLE
    circle = np.column_stack((np.cos(angles), np.sin(angles))) / math.cos(math.pi / _CIRCLE)
    if isinstance(shape, Cylinder):
        rim, half = shape.radius() * circle, shape.length() / 2.0
        return np.vstack([np.column_stack((rim, np.full(_CIRCLE, z))) for z in (-half, half)])
    if isinstance(shape, Sphere):
        radius = shape.radius()
        poles = np.array([[0.0, 0.0, radius], [0.0, 0.0, -radius]])
        return np.vstack((np.column_stack((radius * circle, np.zeros(_CIRCLE))), poles))
    assert isinstance(shape, Convex)
    hull = shape.GetConvexHull()
    return np.array([hull.vertex(index) for index in range(hull.num_vertices())])


def _shown(size: Size) -> str:
    return " x ".join(f"{side:g}" for side in size)


def _prefix(where: str) -> str:
    return f"{where}: " if where else ""
