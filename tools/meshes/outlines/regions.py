"""Windows, lamps, shut lines and wheel openings: outlines in a view, along which the skin's triangles are cut."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import LineString, Point, Polygon
from shapely.geometry.base import BaseGeometry

from tools.meshes.outlines.curves import Array
from tools.meshes.outlines.shell import Skin


def triangulate(shape: BaseGeometry) -> Array:
    """Return the triangles (n, 3, 2) of a plane shape."""
    parts = [part for part in getattr(shape, "geoms", [shape]) if isinstance(part, Polygon) and part.area > 1e-10]
    triangles = [
        shapely.get_coordinates(shapely.constrained_delaunay_triangles(part)).reshape(-1, 4, 2)[:, :3] for part in parts
    ]
    return np.concatenate(triangles) if triangles else np.zeros((0, 3, 2))


LEFT, FRONT, REAR, ABOVE, BELOW = (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)
FRONT_LEFT = (float(np.cos(0.75)), float(np.sin(0.75)), 0.0)
REAR_LEFT = (-float(np.cos(0.65)), float(np.sin(0.65)), 0.0)


def view_axes(direction: Sequence[float]) -> tuple[Array, Array]:
    """Return the two axes of the picture plane of a view from ``direction``."""
    d = np.array(direction)
    if abs(d[2]) > 0.9:
        return np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
    u = np.array([-d[1], d[0], 0.0])
    u = u if abs(d[0]) > abs(d[1]) and d[0] > 0 else -u
    if abs(d[1]) > 0.99:
        u = np.array([1.0, 0, 0])
    elif abs(d[0]) > 0.99:
        u = np.array([0, 1.0, 0])
    return u, np.array([0, 0, 1.0])


@dataclass(frozen=True)
class Region:
    """A shape in the picture plane of a view; the faces seen there get ``material`` (None cuts a hole)."""

    material: str | None
    view: Sequence[float]
    shape: BaseGeometry
    facing: float = 0.1
    only: tuple[str, ...] = ()  # the materials it is drawn over; all if empty
    wheels: float | None = None  # the shape is the wheel openings' outline, this much larger


def arches(material: str, beyond: float, *, facing: float = 0.2) -> Region:
    """Return a border around the wheel openings; where they are is known when the car is built."""
    return Region(material, LEFT, Point(0, 0).buffer(beyond), facing, wheels=beyond)


def outline(points: Iterable[Sequence[float]], round_by: float = 0.0) -> BaseGeometry:
    """Return a polygon with rounded corners."""
    shape: BaseGeometry = Polygon([tuple(p) for p in points])
    if round_by:
        shape = shape.buffer(-round_by, quad_segs=4).buffer(2 * round_by, quad_segs=4).buffer(-round_by, quad_segs=4)
        shape = shape.simplify(8e-4)
    return shape


def stroke(points: Iterable[Sequence[float]], width: float) -> BaseGeometry:
    """Return a polyline drawn with a pen of that width."""
    return LineString([tuple(p) for p in points]).buffer(width / 2, cap_style="flat", join_style="mitre")


def seen(view: Sequence[float], points: Iterable[Sequence[float]]) -> list[tuple[float, float]]:
    """Return points of space in the picture plane of a view."""
    u, v = view_axes(view)
    return [(float(np.dot(u, p)), float(np.dot(v, p))) for p in points]


def cut(skin: Skin, points: Array, faces: NDArray[np.int64], regions: Iterable[Region]) -> list[tuple[str, Array]]:
    """Cut the triangles of the left half along all regions, in their order; return (material, triangles) pairs."""
    tris = points[faces]
    labels = np.full(len(tris), "paint", dtype=object)
    for region in regions:
        u, v = view_axes(region.view)
        d = np.array(region.view)
        normal = np.cross(tris[:, 1] - tris[:, 0], tris[:, 2] - tris[:, 0])
        size = np.maximum(np.linalg.norm(normal, axis=1), 1e-12)
        flat = np.stack([tris @ u, tris @ v], axis=-1)
        visible = normal @ d / size > region.facing
        if region.view in (FRONT, REAR):
            visible &= (tris[:, :, 0].mean(axis=1) - skin.form.middle) * d[0] > 0
        if region.only:
            visible &= np.isin(labels, region.only)
        if region.view == LEFT:
            visible &= tris[:, :, 1].mean(axis=1) > 0.35
        candidates = np.flatnonzero(visible)
        shapely.prepare(region.shape)
        polygons = shapely.polygons(flat[candidates])
        inside = shapely.covers(region.shape, polygons)
        touched = ~inside & shapely.intersects(region.shape, polygons)
        drop = np.zeros(len(tris), dtype=bool)
        new_tris, new_labels = [], []
        if region.material is None:
            drop[candidates[inside]] = True
        else:
            labels[candidates[inside]] = region.material
        for index, polygon in zip(candidates[touched], np.asarray(polygons)[touched], strict=True):
            inner = triangulate(polygon.intersection(region.shape))
            if not len(inner):
                continue
            outer = triangulate(polygon.difference(region.shape))
            drop[index] = True
            a, b, c = flat[index]
            turned = (b - a)[0] * (c - a)[1] < (b - a)[1] * (c - a)[
                0
            ]  # pieces are drawn the way round that the triangle is
            basis = np.linalg.inv(np.stack([b - a, c - a], axis=1))
            for pieces, label in ((outer, labels[index]), (inner, region.material)):
                if label is None or not len(pieces):
                    continue
                left = np.linalg.det(pieces[:, 1:] - pieces[:, :1]) > 0
                pieces = np.where((left == turned)[:, None, None], pieces[:, ::-1], pieces)
                w = (pieces - a) @ basis.T
                A, B, C = tris[index]
                new_tris.append(A + w[..., :1] * (B - A) + w[..., 1:] * (C - A))
                new_labels += [label] * len(pieces)
        kept = ~drop
        tris = np.concatenate([tris[kept], *new_tris]) if new_tris else tris[kept]
        labels = np.concatenate([labels[kept], np.array(new_labels, dtype=object)])
    return [(str(name), tris[labels == name]) for name in sorted(set(labels))]
