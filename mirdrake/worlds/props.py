"""Props: collision shapes, a mesh for rendering, a mass.

::

    models/props/<name>/prop.yaml ── load_prop ──► Prop ── PlacedProp(pose) in a World

The frame P of a prop is on the ground below the centre of its bounding box: x forward, y left, z up.
"""

import fnmatch
import math
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from numpy.typing import NDArray
from pydantic import Field, create_model, model_validator
from pydrake.geometry import Shape, Sphere
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.tree import SpatialInertia
from shapely.geometry.base import BaseGeometry

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.paths import is_hidden, resolved, search_folders
from mirdrake.core.yaml_io import Angle, Length, Mass, Schema, load_yaml, where
from mirdrake.worlds.outlines import outlines_of
from mirdrake.worlds.schema_types import exactly_one
from mirdrake.worlds.solids import LARGEST, SMALLEST, SOLID_KINDS, Size, kind_of, mesh_of

Array = NDArray[np.float64]
Color = tuple[float, float, float]

DEFAULT_MU = 0.6
"""Friction coefficient of a prop's sides [-]; typical of rubber and steel on dry concrete or painted steel."""

DENSITY = 500.0
"""Density [kg/m³] of a primitive that can be knocked over and has no mass given; that of light wood."""

STIFFNESS = 1e6
"""Point contact stiffness of a prop [N/m]; that of a car's body, so that a bump of 1 m/s stops within 5 cm."""

DISSIPATION = 1.0
"""Hunt-Crossley dissipation of a prop [s/m]: a bump hardly bounces; with Drake's default of 50 s/m contact sticks."""


@dataclass(frozen=True)
class Solid:
    """A collision shape, and its pose in the frame of the prop."""

    shape: Shape
    X_PS: RigidTransform

    @cached_property
    def corners(self) -> Array:
        """Points around the shape (n, 3), in P [m], see :meth:`corners_in`."""
        return self.corners_in(RigidTransform())

    def corners_in(self, X_FP: RigidTransform) -> Array:
        """Return points around the shape (n, 3), in a frame F [m].

        Their convex hull is the shape; a circle is a polygon around it. Those of a sphere are an equator and poles
        along the axes of F, so that they bound it there.
        """
        X_FS = X_FP @ self.X_PS
        corners = self._own_corners
        if not isinstance(self.shape, Sphere):
            corners = corners @ X_FS.rotation().matrix().T
        return np.asarray(corners + X_FS.translation())

    @cached_property
    def _own_corners(self) -> Array:
        return kind_of(self.shape).corners(self.shape)

    @property
    def volume(self) -> float:
        """Volume [m³]; of a convex mesh that of its bounding box."""
        return kind_of(self.shape).volume(self.shape)

    @property
    def mesh(self) -> Path | None:
        """Mesh file of a convex mesh."""
        return mesh_of(self.shape)


@dataclass(frozen=True)
class Prop:
    """A kind of prop in its final size."""

    name: str
    solids: tuple[Solid, ...]
    size: Size
    """size of its bounding box along x, y, z [m]"""
    mass: float
    """[kg]"""
    mu: float = DEFAULT_MU
    """friction coefficient of its sides [-]"""
    visual: Path | None = None
    """mesh for rendering; None: its solids are rendered"""
    scale: Size = (1.0, 1.0, 1.0)
    """of the mesh, along x, y, z [-]"""
    paint: str | None = None
    """material of the mesh that gets the colour of the prop"""
    driven_over: bool = False
    """vehicles drive over it, as over a speed bump"""

    @property
    def inertia(self) -> SpatialInertia:
        """Inertia about P, in P: the mass is spread evenly over the bounding boxes of the solids, by their volumes."""
        total = sum(solid.volume for solid in self.solids)
        result = SpatialInertia.Zero()
        for solid in self.solids:
            corners = solid.corners
            size, middle = np.ptp(corners, axis=0), 0.5 * (corners.min(axis=0) + corners.max(axis=0))
            # The box has its inertia about its centre; shifting by -middle moves the reference point to P.
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
    """False: a body that can be knocked over"""
    color: Color | None = None
    """red, green, blue, 0 .. 1"""
    where: str = ""
    """``file:line: path`` of its entry"""
    file_line: str = "the world"
    """``file:line`` of its entry"""
    random: bool = False
    """its position was drawn at random"""
    order: tuple[int, ...] = field(default=(), compare=False)
    """position of its entry in the file"""

    @cached_property
    def footprint(self) -> BaseGeometry:
        """Area covered seen from above, in W [m]."""
        hulls = [shapely.MultiPoint(points[:, :2]).convex_hull for points in self._corners]
        return hulls[0] if len(hulls) == 1 else shapely.union_all(hulls)

    def between(self, low: float, high: float) -> tuple[BaseGeometry, ...]:
        """Return the areas that its solids cover between two heights [m], convex polygons in W [m]."""
        known = self._between
        if (low, high) not in known:
            known[low, high] = tuple(outline.area for outline in outlines_of(self, low, high))
        return known[low, high]

    @cached_property
    def _between(self) -> dict[tuple[float, float], tuple[BaseGeometry, ...]]:
        """Results of :meth:`between`."""
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
        return [solid.corners_in(self.X_WP) for solid in self.prop.solids]

    def is_called(self, pattern: str) -> bool:
        """Return whether its name, with or without its index, matches a pattern with * and ?."""
        # Brackets of an index are not character classes of a pattern.
        return fnmatch.fnmatchcase(
            self.name.replace("[", "(").replace("]", ")"), pattern.replace("[", "(").replace("]", ")")
        ) or (fnmatch.fnmatchcase(self.name.rpartition("[")[0], pattern))


# --- files --------------------------------------------------------------------------------------------------------


class _SolidPose(Schema):
    """Pose of a solid in the frame of the prop."""

    at: tuple[Length, Length, Length] = Field(default=(0.0, 0.0, 0.0), description="its centre in P [m]")
    yaw: Angle = Field(default=0.0, description="heading [rad]")
    pitch: Angle = Field(default=0.0, description="nose down [rad]")
    roll: Angle = Field(default=0.0, description="right side down [rad]")

    @model_validator(mode="after")
    def _one(self) -> "_SolidPose":
        exactly_one(self, tuple(kind.key for kind in SOLID_KINDS))
        for kind in SOLID_KINDS:
            value = getattr(self, kind.key)
            for side in value if isinstance(value, tuple) else [value]:
                if isinstance(side, float) and not SMALLEST <= side <= LARGEST:
                    raise ValueError(f"a side of {side:g} m; allowed are 1 mm to 10 km")
        return self


if TYPE_CHECKING:
    SolidSpec = _SolidPose
else:
    SolidSpec = create_model(
        "SolidSpec",
        __base__=_SolidPose,
        __module__=__name__,
        __doc__="A collision shape: exactly one of box, cylinder, sphere and convex.",
        **{
            kind.key: (kind.annotation | None, Field(default=None, description=kind.description))
            for kind in SOLID_KINDS
        },
    )


class PropFile(Schema):
    """A prop.yaml."""

    description: str = Field(description="what it is [-]")
    source: str = Field(default="", description="source of its dimensions [-]")
    size: tuple[Length, Length, Length] = Field(description="size of its bounding box, along x, y, z [m]")
    mass: Mass = Field(gt=0.0, description="mass [kg]")
    mu: float = Field(default=DEFAULT_MU, gt=0.0, le=2.0, description="friction coefficient of its sides [-]")
    visual: str | None = Field(default=None, description="mesh beside prop.yaml; default: solids are rendered [-]")
    paint: str | None = Field(default=None, description="material of the mesh that `color` replaces [-]")
    resizable: bool = Field(default=False, description="`size` may stretch it [-]")
    driven_over: bool = Field(default=False, description="vehicles drive over it, as over a speed bump [-]")
    solids: list[SolidSpec] = Field(min_length=1, max_length=200, description="its collision shapes [-]")


def prop_names() -> dict[str, Path]:
    """Return the folders of all props by name."""
    folders: dict[str, Path] = {}
    for folder in search_folders("models"):
        for path in sorted(folder.glob("props/*/prop.yaml")):
            if not is_hidden(path.parent.name):
                folders.setdefault(path.parent.name, path.parent)
    return dict(sorted(folders.items()))


def _find_prop(name: str) -> Path | None:
    """Return the folder of a prop, without listing all props."""
    folders = [folder / "props" / name for folder in search_folders("models") if name.isidentifier()]
    return next((folder for folder in folders if (folder / "prop.yaml").is_file()), None)


def load_prop(name: str, *, size: Size | None = None, scale: float = 1.0, where: str = "") -> Prop:
    """Return the prop of a name.

    Args:
        name: a folder below models/props/, or its path.
        size: requested size along x, y, z [m], of a resizable prop.
        scale: factor of all lengths [-].
        where: prefix of messages.

    Raises:
        ConfigError: the prop does not exist, its file has faults, or it cannot have that size.
    """
    folder = Path(name) if "/" in name else _find_prop(name)
    if folder is None:
        hint = did_you_mean(name, prop_names())
        raise ConfigError(f"unknown prop '{name}'; {hint}; or use box, cylinder, sphere or file", where=where)
    home = resolved(folder)
    try:
        spec = _load_file(home / "prop.yaml")
    except ConfigError as error:
        raise (error.under(where) if where else error) from None
    factors = (scale, scale, scale)
    if size is not None:
        if not spec.resizable:
            sides = " x ".join(f"{side:g}" for side in spec.size)
            raise ConfigError(f"'{folder.name}' has the size {sides} m; use scale instead", where=where)
        x, y, z = (scale * want / have for want, have in zip(size, spec.size, strict=True))
        factors = (x, y, z)
    # The times of the files are part of the key, so that a changed prop is not served from the cache.
    prop = _make_prop(home, folder.name, factors, _stamps(home, spec))
    _check_sides(prop.size, f"'{folder.name}'", where)
    return prop


def make_primitive(kind: str, sides: tuple[float, ...], *, scale: float = 1.0, where: str = "") -> Prop:
    """Return a box (along x, y, z), an upright cylinder (radius, height) or a sphere (radius) [m] on the ground.

    Raises:
        ConfigError: a side is not between 1 mm and 10 km.
    """
    sides = tuple(scale * side for side in sides)
    _check_sides(sides, kind, where)
    maker = next(kind_class for kind_class in SOLID_KINDS if kind_class.key == kind)
    shape, size = maker.make(sides), maker.extent(sides)
    solid = Solid(shape, RigidTransform([0.0, 0.0, size[2] / 2.0]))
    return Prop(kind, (solid,), size, DENSITY * solid.volume)


def make_mesh_prop(path: Path, *, scale: float = 1.0, where: str = "") -> Prop:
    """Return a prop of a mesh (glTF or OBJ) with its base on the ground; its collision shape is the convex hull.

    Raises:
        ConfigError: the file does not exist, or is not a mesh.
    """
    solid = _solid(SolidSpec(convex=path.name), path.parent, (scale,) * 3, where)  # type: ignore[call-arg]
    x, y, z = (float(side) for side in np.ptp(solid.corners, axis=0))
    return Prop(path.stem, (solid,), (x, y, z), DENSITY * solid.volume, visual=path, scale=(scale,) * 3)


# --- the inner parts ----------------------------------------------------------------------------------------------


def _stamp(path: Path) -> float:
    """Return the time of the last change of a file; 0 if it does not exist."""
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0


def _stamps(folder: Path, spec: PropFile) -> tuple[float, ...]:
    """Return the times of the last changes of prop.yaml and the meshes that it names."""
    meshes = [getattr(solid, "convex", None) for solid in spec.solids]
    names = ["prop.yaml", *(name for name in [spec.visual, *meshes] if name)]
    return tuple(_stamp(folder / name) for name in dict.fromkeys(names))


@lru_cache(maxsize=256)
def _read(path: Path, stamp: float) -> PropFile:  # noqa: ARG001
    return load_yaml(path, PropFile)


def _load_file(path: Path) -> PropFile:
    return _read(path, _stamp(path))


@lru_cache(maxsize=4096)
def _make_prop(folder: Path, name: str, factors: Size, stamps: tuple[float, ...]) -> Prop:  # noqa: ARG001
    """Return a prop, made once for all entries; `stamps` renew it when its files have changed."""
    spec = _load_file(folder / "prop.yaml")
    solids = tuple(_solid(solid, folder, factors, where(solid)) for solid in spec.solids)
    x, y, z = (factor * side for factor, side in zip(factors, spec.size, strict=True))
    visual = None
    if spec.visual is not None:
        visual = folder / spec.visual
        if not visual.is_file():
            raise ConfigError(f"no such file: {spec.visual}", where=where(spec, "visual"))
    # Density is kept.
    mass = spec.mass * math.prod(factors)
    return Prop(name, solids, (x, y, z), mass, spec.mu, visual, factors, spec.paint, spec.driven_over)


def _solid(spec: Any, folder: Path, factors: Size, location: str) -> Solid:
    """Return a solid, stretched by factors along the axes of P."""
    X_PS = RigidTransform(RollPitchYaw(spec.roll, spec.pitch, spec.yaw), np.multiply(spec.at, factors))
    # A turned solid would be sheared by different factors along the axes of the prop.
    uniform = math.isclose(factors[0], factors[1]) and math.isclose(factors[0], factors[2])
    if not uniform and (spec.roll or spec.pitch or spec.yaw):
        raise ConfigError(
            "a turned solid cannot be stretched; give the prop a scale, or leave it upright", where=location
        )
    kind = next(kind for kind in SOLID_KINDS if getattr(spec, kind.key) is not None)
    return Solid(kind.read(getattr(spec, kind.key), folder, factors, location), X_PS)


def _check_sides(sides: tuple[float, ...], what: str, location: str) -> None:
    for side in sides:
        if not SMALLEST <= side <= LARGEST:
            raise ConfigError(f"{what} with a side of {side:g} m; allowed are 1 mm to 10 km", where=location)
