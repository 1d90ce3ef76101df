"""Wheels with a tyre, five double spokes and a coloured valve, by which one sees them turn."""

from __future__ import annotations

import numpy as np
import shapely
from shapely.geometry import Point, Polygon

from mirdrake.vehicles.bodywork.mesh import Mesh
from mirdrake.vehicles.bodywork.shapes import ALONG_Y, extrude, revolve

_SPOKES = 5


def build_wheel(radius: float, width: float, *, rim: float, cleats: int = 0) -> Mesh:
    """Return a wheel about its centre, spinning about y.

    Args:
        radius: radius of the tyre [m].
        width: width of the tyre [m].
        rim: radius of the rim over that of the tyre.
        cleats: number of tread blocks around the tyre in each of two rows; 0 for a road tyre.
    """
    R, h, r = radius, width / 2, rim * radius
    tread = R - 0.07 * R if cleats else R
    # Profile (y, radius) of the left half from the rim to the middle; the right half is its mirror image.
    flank = [(-0.86 * h, r), (-0.95 * h, r + 0.05 * R), (-h, 0.5 * (r + tread)), (-0.96 * h, tread - 0.09 * R)]
    crown = [(-0.84 * h, tread - 0.02 * R), (-0.6 * h, tread), (-0.42 * h, tread), (-0.38 * h, tread - 0.025 * R)]
    crown += [(-0.32 * h, tread - 0.025 * R), (-0.28 * h, tread)]  # a groove
    left = flank + crown
    mesh = revolve("rubber", [*left, *[(-y, q) for y, q in left[::-1]]], 48)
    side = _rim_side(h, r)
    mesh.add_mesh(side)
    mesh.add_mesh(side.mirrored())
    # Blocks of the two rows alternate around the tyre.
    for k in range(2 * cleats):
        angle, half = np.pi * k / cleats, 0.30 * np.pi / cleats
        sector = Polygon([(q * np.cos(angle + s), q * np.sin(angle + s))
                          for q, s in ((0.9 * R, -half), (R, -half), (R, half), (0.9 * R, half))])  # fmt: skip
        low, high = (0.04 * h, 0.88 * h) if k % 2 else (-0.88 * h, -0.04 * h)
        mesh.add_mesh(extrude("rubber", sector, low, high, axes=ALONG_Y))
    return mesh


def _rim_side(h: float, r: float) -> Mesh:
    """Return the rim as seen from +y, for a half width h of the tyre and a radius r of the rim."""

    def disc(material: str, q: float, y: float, depth: float, x: float = 0.0, z: float = 0.0) -> Mesh:
        return extrude(material, Point(x, z).buffer(q, quad_segs=10), y - depth, y, axes=ALONG_Y)

    # A bright flange, a dark dish with a brake disc, and the spokes with a dark step behind their bright faces.
    side = revolve("rim_machined", [(0.86 * h, 1.01 * r), (0.88 * h, 0.98 * r), (0.78 * h, 0.93 * r)], 48)
    side.add_mesh(revolve("rim_dark", [(0.78 * h, 0.93 * r), (0.3 * h, 0.9 * r)], 40))
    side.add_mesh(disc("rim_shadow", 0.92 * r, 0.3 * h, 0.02 * h))
    side.add_mesh(disc("disc", 0.66 * r, 0.34 * h, 0.02 * h))
    # Each spoke is a pair of arms, given by radius (as a share) and angle from the middle of the spoke (deg).
    arms = []
    for k in range(_SPOKES):
        for sign in (-1.0, 1.0):
            corners = ((0.2, 1), (0.2, 32), (0.55, 15.5), (0.95, 18.5), (0.95, 10.0), (0.55, 5.5))
            angles = [np.deg2rad(90.0 + 360.0 / _SPOKES * k + sign * angle) for _, angle in corners]
            arms.append(Polygon([(q * r * np.cos(a), q * r * np.sin(a))
                                 for (q, _), a in zip(corners, angles, strict=True)]))  # fmt: skip
    star = shapely.union_all([*arms, Point(0, 0).buffer(0.27 * r, quad_segs=8)])
    side.add_mesh(extrude("rim_dark", star, 0.5 * h, 0.72 * h, axes=ALONG_Y))
    # The bright face is a little smaller than the spoke below, whose edge stays dark.
    face = shapely.union_all([arm.buffer(-0.016 * r, join_style="mitre") for arm in arms])
    side.add_mesh(extrude("rim_machined", face, 0.72 * h, 0.74 * h, axes=ALONG_Y))
    side.add_mesh(disc("gloss_black", 0.15 * r, 0.78 * h, 0.06 * h))
    # Five nuts between the spokes, and the valve.
    for k in range(_SPOKES):
        a = np.deg2rad(126.0 + 360.0 / _SPOKES * k)
        side.add_mesh(disc("rim_shadow", 0.035 * r, 0.75 * h, 0.03 * h, 0.21 * r * np.cos(a), 0.21 * r * np.sin(a)))
    a = np.deg2rad(54.0)
    side.add_mesh(disc("valve", 0.05 * r, 0.78 * h, 0.3 * h, 0.86 * r * np.cos(a), 0.86 * r * np.sin(a)))
    return side
