"""A car as data: its form, drawn regions, small parts and wheels; and the meshes of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import Point
from shapely.geometry.base import BaseGeometry

from mirdrake.vehicles.bodywork.mesh import MATERIALS, Material, Mesh
from tools.meshes.outlines.curves import Array
from tools.meshes.outlines.parts import Part, Spoiler, place, spoiler, wheelhouse
from tools.meshes.outlines.regions import BELOW, LEFT, Region, cut
from tools.meshes.outlines.shell import Form, Skin, half_shell
from tools.meshes.outlines.wheels import WheelDesign, build_wheel

Map = Callable[[Array], Array]


@dataclass(frozen=True)
class Warp:
    """Monotone maps of x, y and z by knots (drawn, true), linear between them and beyond them."""

    x: tuple[tuple[float, float], ...]
    y: tuple[tuple[float, float], ...]
    z: tuple[tuple[float, float], ...]

    def _axis(self, axis: int, q: Array, *, back: bool = False) -> Array:
        knots = np.array((self.x, self.y, self.z)[axis], dtype=float)
        a, b = (knots[:, 1], knots[:, 0]) if back else (knots[:, 0], knots[:, 1])
        slope_low, slope_high = (b[1] - b[0]) / (a[1] - a[0]), (b[-1] - b[-2]) / (a[-1] - a[-2])
        low, high = np.minimum(q - a[0], 0) * slope_low, np.maximum(q - a[-1], 0) * slope_high
        result: Array = np.interp(q, a, b) + low + high
        return result

    def forth(self, p: Array) -> Array:
        """Return the true places of drawn points (…, 3)."""
        return np.stack([self._axis(i, p[..., i]) for i in range(3)], axis=-1)

    def back(self, p: Array) -> Array:
        """Return the drawn places of true points (…, 3)."""
        return np.stack([self._axis(i, p[..., i], back=True) for i in range(3)], axis=-1)

    def normals(self, p: Array, n: Array) -> Array:
        """Return the true normals of drawn points and normals (…, 3)."""
        step = 0.02  # the maps have kinks; normals see them rounded
        slope = [(self._axis(i, p[..., i] + step) - self._axis(i, p[..., i] - step)) / (2 * step) for i in range(3)]
        n = n / np.stack(slope, axis=-1)
        result: Array = n / np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), 1e-12)
        return result


@dataclass(frozen=True)
class CarOutline:
    """All that describes a car; metres, x ahead, y left, z up, origin on the road below the rear axle's centre.

    Attributes:
        form: the curves of its skin.
        wheelbase: distance of the axles.
        wheel: the wheels.
        arch_radius: of the wheel openings, about the wheels' centres; see :func:`arch_clearance`.
        arch_inner: the wheel openings reach in to this distance from the middle plane.
        regions: what is drawn on the left half (and mirrored), in this order.
        parts: small solids.
        rear_spoiler: a roof spoiler, or None.
        materials: colours that replace those of :data:`mirdrake.vehicles.bodywork.mesh.MATERIALS`.
        warp: form, regions and parts are drawn in a frame of their own, which this takes to the car's; wheelbase,
            wheel and arches are the car's in any case.
    """

    form: Form
    wheelbase: float
    wheel: WheelDesign
    arch_radius: float
    arch_inner: float
    regions: tuple[Region, ...]
    parts: tuple[Part, ...] = ()
    rear_spoiler: Spoiler | None = None
    materials: dict[str, Material] = field(default_factory=dict)
    warp: Warp | None = None


def arch_clearance(wheel: WheelDesign, steering: float, *, scrub: float = 0.0) -> tuple[float, float]:
    """Return how far a steered wheel reaches: from its axle's line in the side view, and inwards from its middle.

    The wheel, a cylinder, turns by ``steering`` about a vertical axis ``scrub`` inside its middle plane. A point of its
    outer or inner rim at the angle φ lies at x = R cos φ cos δ + w/2 sin δ and z = R sin φ; the longest x² + z² is at
    cos φ = w/2 cos δ / (R sin δ).

    Args:
        wheel: its radius and width.
        steering: largest angle of the wheel [rad].
        scrub: distance of the steering axis from the wheel's middle plane, inwards [m].
    """
    R, half, s, c = wheel.radius, wheel.width / 2, np.sin(abs(steering)), np.cos(steering)
    phi = np.linspace(0.0, np.pi / 2, 721)
    clearance = 0.0
    for across in (half + scrub, half - scrub):
        reach = np.hypot(R * np.cos(phi) * c + across * s, R * np.sin(phi))
        clearance = max(clearance, float(reach.max()))
    inwards = R * s + (half - scrub) * c + scrub
    return clearance, float(inwards)


def build_skin(car: CarOutline) -> Skin:
    """Return the skin of a car, in the frame it is drawn in."""
    if car.warp:  # the swellings around the wheels would not be round
        return Skin(car.form, (), 0.0)
    return Skin(car.form, (0.0, car.wheelbase), car.wheel.radius)


def build_body(car: CarOutline, *, shell: tuple[Array, NDArray[np.int64]] | None = None) -> Mesh:
    """Return the mesh of the whole body; ``shell`` is that of :func:`half_shell`, when it is known already."""
    skin = build_skin(car)
    points, faces = shell or half_shell(skin)
    half, mesh = Mesh(), Mesh()
    for name, triangles in cut(skin, points, faces, _regions(car)):
        snapped = skin.project(triangles)
        half.add(name, snapped, skin.normals(snapped))
    houses = [wheelhouse(skin, x, *_opening(car), warp=car.warp) for x in (0.0, car.wheelbase)]
    if not car.warp:
        for house in houses:
            half.add_mesh(house)
    for part in car.parts:
        if part.pair:
            half.add_mesh(place(skin, part))
    mesh.add_mesh(half)
    mesh.add_mesh(half.mirrored())
    if car.rear_spoiler:
        mesh.add_mesh(spoiler(skin, car.rear_spoiler))
    for part in car.parts:
        if not part.pair:
            mesh.add_mesh(place(skin, part))
    if car.warp:
        mesh = mesh.transformed(car.warp.forth, car.warp.normals)
        for house in houses:
            mesh.add_mesh(house)
            mesh.add_mesh(house.mirrored())
    return mesh


def write_outline(folder: Path, car: CarOutline, *, generator: str = "mirdrake", scale: float = 1.0) -> dict[str, Mesh]:
    """Write ``body.gltf`` and ``wheel.gltf`` with their ``.bin`` into a folder.

    Args:
        folder: where to; it is made if it is missing.
        car: the car.
        generator: the origin that is written into the files.
        scale: factor on everything, applied last.

    Returns:
        The meshes by name, scaled.
    """
    folder.mkdir(parents=True, exist_ok=True)
    meshes = {"wheel": build_wheel(car.wheel), "body": build_body(car)}
    write_meshes(folder, meshes, materials=car.materials, generator=generator, scale=scale)
    return {name: mesh.scaled(scale) for name, mesh in meshes.items()}


def write_meshes(
    folder: Path, meshes: dict[str, Mesh], *, materials: dict[str, Material], generator: str, scale: float = 1.0
) -> None:
    """Write meshes by name, enlarged by ``scale``; ``materials`` replace the common ones of the same name."""
    for name, mesh in meshes.items():
        mesh = mesh if scale == 1.0 else mesh.scaled(scale)
        mesh.write(
            folder / f"{name}.gltf", materials={**MATERIALS, **materials}, generator=generator, grid=5e-5 * scale
        )


def describe(folder: Path, meshes: dict[str, Mesh]) -> Iterable[str]:
    """Yield a line on each mesh written: triangles, size on disk, bounds."""
    for name, mesh in meshes.items():
        size = sum((folder / f"{name}{suffix}").stat().st_size for suffix in (".gltf", ".bin"))
        corners = mesh.corners()
        low, high = corners.min(axis=0).round(3).tolist(), corners.max(axis=0).round(3).tolist()
        yield f"{name}: {len(corners) // 3} triangles, {size / 1e3:.0f} kB, from {low} to {high}"


def _opening(car: CarOutline) -> tuple[float, float, float]:
    return car.wheel.radius, car.arch_radius, car.arch_inner


def _arch(car: CarOutline, axle: float, radius: float) -> BaseGeometry:
    """Return the outline of a wheel opening seen from the left, as drawn: a semicircle with straight ends."""
    height = car.wheel.radius
    circle = Point(axle, height).buffer(radius, quad_segs=16)
    shape: BaseGeometry = circle.union(shapely.box(axle - radius, -0.1, axle + radius, height))
    return shape if car.warp is None else _drawn(car.warp, shape, (0, 2))


def _drawn(warp: Warp, shape: BaseGeometry, axes: Sequence[int]) -> BaseGeometry:
    """Return a true plane shape in the frame of the drawing."""

    def back(flat: Array) -> Array:
        p = np.zeros((len(flat), 3))
        p[:, list(axes)] = flat
        return warp.back(p)[:, list(axes)]

    result: BaseGeometry = shapely.transform(shapely.segmentize(shape, 0.03), back)
    return result


def _regions(car: CarOutline) -> list[Region]:
    """Return all regions, with the wheel openings at the places of the wheels."""
    regions: list[Region] = []
    axles = (0.0, car.wheelbase)
    for region in car.regions:
        if region.wheels is None:
            regions.append(region)
        else:
            regions += [replace(region, shape=_arch(car, axle, car.arch_radius + region.wheels)) for axle in axles]
    for axle in axles:
        regions.append(Region(None, LEFT, _arch(car, axle, car.arch_radius), 0.0))
        low = shapely.box(axle - car.arch_radius, car.arch_inner, axle + car.arch_radius, 3.0)
        regions.append(Region(None, BELOW, low if car.warp is None else _drawn(car.warp, low, (0, 1)), 0.3))
    return regions
