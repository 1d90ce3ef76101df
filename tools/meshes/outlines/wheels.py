"""Wheels: a tyre and a rim with spokes, which make its rotation visible."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
from shapely.geometry import Point, Polygon
from shapely.geometry.base import BaseGeometry

from mirdrake.vehicles.bodywork.mesh import Mesh
from tools.meshes.outlines.curves import Array
from tools.meshes.outlines.regions import triangulate

_RADIUS, _WIDTH, _RIM = 0.3234, 0.215, 0.2159  # the wheel all rims are drawn for, a 215/50R17 [m]

Polar = tuple[float, float]  # radius [m], angle from the middle of the spoke [deg]


@dataclass(frozen=True)
class Rim:
    """A rim drawn for a wheel of 0.3234 m radius with a rim radius of 0.2159 m; other wheels stretch it.

    Attributes:
        count: number of spokes.
        arms: outlines of a spoke's arms, corners as (radius [m], angle [deg] from the middle of the spoke).
        mirrored: each arm is drawn a second time, mirrored at the middle of the spoke.
        web: ring sector between the arms: inner and outer radius [m], half angle [deg]; None for none.
        valve: angle of the valve from the middle of the first spoke [deg].
        bolts: angle of the first wheel bolt from the middle of the first spoke [deg].
        bolt_count: number of wheel bolts.
        face: height of the spokes' faces above the wheel's middle plane [m].
        bright: material of the spokes' faces.
        cap: material of the hub cap.
    """

    count: int = 5
    arms: tuple[tuple[Polar, ...], ...] = (
        ((0.050, 2), (0.050, 30), (0.12, 15.5), (0.2045, 18.5), (0.2045, 10.5), (0.12, 5.5)),
    )
    mirrored: bool = True
    web: tuple[float, float, float] | None = (0.045, 0.105, 8)
    valve: float = -36.0
    bolts: float = -36.0
    bolt_count: int = 5
    face: float = 0.078
    bright: str = "rim_machined"
    cap: str = "accent"


DOUBLE_SPOKES = Rim()
BROAD_SPOKES = Rim(
    count=6, arms=(((0.050, -24), (0.050, 24), (0.12, 10.5), (0.2045, 11), (0.2045, -11), (0.12, -10.5)),),
    mirrored=False, web=None, valve=-30.0, bolts=-30.0, cap="rim_dark",
)  # fmt: skip
FAN_SPOKES = Rim(
    count=9, arms=(((0.050, 1), (0.050, 20), (0.14, 9.5), (0.2045, 13.5), (0.2045, 8.5), (0.14, 4.0)),),
    web=(0.045, 0.08, 6), valve=-20.0, bolts=-20.0, cap="gloss_black",
)  # fmt: skip


@dataclass(frozen=True)
class WheelDesign:
    """A wheel: ``radius`` and ``width`` of the tyre and ``rim_radius`` [m], the drawing of its rim, the tyre's tread.

    ``blocks`` > 0 puts that many cleats around the tyre; the tyre's own surface then lies below ``radius``.
    """

    radius: float
    width: float
    rim_radius: float
    rim: Rim = DOUBLE_SPOKES
    blocks: int = 0


def revolve(material: str, profile: Sequence[tuple[float, float]], count: int, *, smooth: bool = True) -> Mesh:
    """Return a profile of (y, radius) points revolved about y; its outward side is on the left of its direction."""
    mesh = Mesh()
    q = np.array(profile, dtype=float)
    a = np.linspace(0.0, 2 * np.pi, count + 1)
    t = np.diff(q, axis=0)
    n = np.stack([-t[:, 1], t[:, 0]], axis=1)  # (y, radius)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    for i in range(len(t)):
        ends = []
        for k in (i, i + 1):
            m = n[i]
            other = k - 1 if k == i else k
            if smooth and 0 <= other < len(n) and float(np.dot(n[i], n[other])) > 0.55:
                m = n[i] + n[other]
                m = m / np.linalg.norm(m)
            p = np.stack([q[k, 1] * np.cos(a), np.full_like(a, q[k, 0]), q[k, 1] * np.sin(a)], axis=1)
            w = np.stack([m[1] * np.cos(a), np.full_like(a, m[0]), m[1] * np.sin(a)], axis=1)
            ends.append((p, w))
        mesh.add_grid(material, np.stack([ends[0][0], ends[1][0]]), np.stack([ends[0][1], ends[1][1]]))
    return mesh


def wheel_face(material: str, shape: BaseGeometry, y: float, *, skirt: float = 0.0, skirt_material: str = "") -> Mesh:
    """Return a plane shape (x, z) at height ``y`` that faces +y, with a skirt down to ``y − skirt``."""
    mesh = Mesh()
    flat = triangulate(shape)
    height = np.full(flat.shape[:2], y)
    mesh.add_flat(material, np.stack([flat[..., 0], height, flat[..., 1]], axis=-1), (0, 1, 0))
    if skirt:
        for part in getattr(shape, "geoms", [shape]):
            part = shapely.geometry.polygon.orient(part)
            for ring in (part.exterior, *part.interiors):
                c = np.array(ring.coords)
                for a, b in pairwise(c):
                    t = (b - a) / max(float(np.linalg.norm(b - a)), 1e-12)
                    low = y - skirt
                    quad = np.array([[a[0], y, a[1]], [b[0], y, b[1]], [b[0], low, b[1]], [a[0], low, a[1]]])
                    mesh.add_flat(skirt_material or material, quad[[[0, 1, 2], [0, 2, 3]]], (t[1], 0, -t[0]))
    return mesh


def polar(radius: float, degrees: float) -> tuple[float, float]:
    """Return the point (x, z) at a radius and an angle [deg]."""
    return radius * float(np.cos(np.deg2rad(degrees))), radius * float(np.sin(np.deg2rad(degrees)))


def sector(r_in: float, r_out: float, start: float, end: float, *, count: int = 8) -> BaseGeometry:
    """Return a ring sector, angles in degrees."""
    a = np.linspace(start, end, count)
    return Polygon([polar(r_in, float(v)) for v in a] + [polar(r_out, float(v)) for v in a[::-1]])


def _tyre() -> Mesh:
    h, R, r = _WIDTH / 2, _RADIUS, _RIM
    profile = [(-0.088, r - 0.003), (-0.1005, r + 0.014), (-h, r + 0.050), (-h + 0.004, R - 0.032),
               (-0.090, R - 0.010), (-0.074, R - 0.003), (-0.052, R), (-0.048, R - 0.007), (-0.042, R - 0.007),
               (-0.038, R), (-0.014, R), (-0.010, R - 0.007), (0.0, R - 0.007)]  # fmt: skip
    profile += [(-y, q) for y, q in profile[-2::-1]]
    return revolve("rubber", profile, 48)


def _cleats(count: int) -> Mesh:
    """Return the tread of an off-road tyre: two staggered rows of blocks on a tyre of the reference size."""
    mesh = Mesh()
    for k in range(2 * count):
        a = np.pi * k / count
        side = 1.0 if k % 2 else -1.0
        half = 0.30 * np.pi / count
        angles = np.array([a - half, a + half, a + half, a - half])
        for sign in (side,):
            y = np.array([0.006, 0.006, 0.088, 0.088]) * sign
            rings = [np.stack([r * np.cos(angles + s), y, r * np.sin(angles + s)], axis=1)
                     for r, s in ((_RADIUS - 0.024, 0.0), (_RADIUS, 0.0))]  # fmt: skip
            low, high = rings
            middle = (np.cos(a), 0.0, np.sin(a))
            mesh.add_flat("rubber", high[[[0, 1, 2], [0, 2, 3]]], middle)
            centre = high.mean(axis=0)
            for i in range(4):
                j = (i + 1) % 4
                quad = np.stack([low[i], low[j], high[j], high[i]])
                out = quad.mean(axis=0) - centre
                out -= np.dot(out, middle) * np.array(middle)
                mesh.add_flat("rubber", quad[[[0, 1, 2], [0, 2, 3]]], out / np.linalg.norm(out))
    return mesh


def _rim_side(rim: Rim) -> Mesh:
    """Return the rim as seen from +y, with the marks on the tyre's flank."""
    side = Mesh()
    flange = [(0.040, 0.196), (0.082, 0.203), (0.094, 0.2075), (0.0955, 0.2145), (0.086, 0.2185)]
    side.add_mesh(revolve(rim.bright, flange[1:][::-1], 48))
    side.add_mesh(revolve("rim_dark", [(0.083, 0.203), (0.030, 0.194)], 40))
    side.add_mesh(wheel_face("rim_shadow", Point(0, 0).buffer(0.197, quad_segs=10), 0.030))
    side.add_mesh(wheel_face("disc", Point(0, 0).buffer(0.140, quad_segs=8), 0.034))
    for k in range(rim.count):
        c = 360.0 / rim.count * k + 90
        for s in (-1.0, 1.0) if rim.mirrored else (1.0,):
            for corners in rim.arms:
                arm = Polygon([polar(r, c + s * angle) for r, angle in corners])
                bright = arm.buffer(-0.0035, join_style="mitre")
                side.add_mesh(wheel_face(rim.bright, bright, rim.face))
                side.add_mesh(wheel_face("rim_dark", arm, rim.face - 0.003, skirt=0.030))
        if rim.web:
            r_in, r_out, half = rim.web
            web = sector(r_in, r_out, c - half, c + half)
            side.add_mesh(wheel_face("rim_dark", web, rim.face - 0.012, skirt=0.015))
    hub = Point(0, 0).buffer(0.062, quad_segs=8)
    side.add_mesh(wheel_face("rim_dark", hub, rim.face + 0.001, skirt=0.03))
    for k in range(rim.bolt_count):
        x, z = polar(0.047, 360.0 / rim.bolt_count * k + 90 + rim.bolts)
        side.add_mesh(wheel_face("rim_shadow", Point(x, z).buffer(0.008, quad_segs=3), rim.face + 0.002))
    cap = Point(0, 0).buffer(0.034, quad_segs=8)
    side.add_mesh(wheel_face("chrome", cap, rim.face + 0.006, skirt=0.006, skirt_material="rim_dark"))
    side.add_mesh(wheel_face(rim.cap, Point(0, 0).buffer(0.029, quad_segs=8), rim.face + 0.008, skirt=0.003))
    side.add_mesh(wheel_face("plate", sector(0.004, 0.024, 60, 120, count=5), rim.face + 0.009))
    # The valve between two spokes and the marks on the tyre's flank show the turning.
    valve = Point(polar(0.186, 90 + rim.valve)).buffer(0.010, quad_segs=4)
    side.add_mesh(wheel_face("valve", valve, 0.070, skirt=0.04))
    for start, end in ((70.0, 110.0), (250.0, 290.0)):
        steps = np.linspace(start, end, 9)
        for a, b in zip(steps[:-1:2], steps[1::2], strict=True):
            mark = sector(0.278, 0.286, float(a), float(b), count=4)
            side.add_mesh(wheel_face("rubber_mark", mark, _WIDTH / 2 + 0.0008))
    return side


def build_wheel(design: WheelDesign) -> Mesh:
    """Return the wheel about its centre, spinning about y, alike from both sides."""
    mesh = Mesh()
    tyre = _tyre()
    if design.blocks:
        tyre = tyre.transformed(_stretch((0.0, _RIM, _RADIUS), (0.0, _RIM, _RADIUS - 0.016), 1.0), _keep)
        tyre.add_mesh(_cleats(design.blocks))
    side = _rim_side(design.rim)
    mesh.add_mesh(tyre)
    mesh.add_mesh(side)
    mesh.add_mesh(side.mirrored())
    if (design.radius, design.width, design.rim_radius) == (_RADIUS, _WIDTH, _RIM):
        return mesh
    to = (0.0, design.rim_radius, design.radius)
    return mesh.transformed(_stretch((0.0, _RIM, _RADIUS), to, design.width / _WIDTH), _keep)


def _stretch(radii: Sequence[float], to: Sequence[float], across: float) -> Callable[[Array], Array]:
    """Return a map of points: radii about y by straight pieces from ``at`` to ``to``, y by a factor."""

    def move(p: Array) -> Array:
        radius = np.hypot(p[..., 0], p[..., 2])
        factor = np.interp(radius, radii, to) / np.maximum(radius, 1e-9)
        return p * np.stack([factor, np.full_like(factor, across), factor], axis=-1)

    return move


def _keep(_: Array, normals: Array) -> Array:
    """Return the normals unchanged, because a wheel is stretched only slightly."""
    return normals
