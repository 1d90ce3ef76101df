"""Generates the visual meshes of the Chevrolet Bolt EV: ``body.gltf`` and ``wheel.gltf`` (with their ``.bin`` files).

The car is modelled from scratch. Its body is the zero set of one smooth scalar function of space, made of a few
outline curves (roof line, bonnet line, plan view, tumblehome, nose and tail profiles) that are joined by rounded
intersections and unions. Rays from a spine inside the car sample that surface on a structured grid; windows, lamps,
cladding, shut lines and wheel openings are outlines in a side, front, rear or oblique view, along which the triangles
are cut, so every boundary between two materials is sharp. The gradient of the function gives the normals. Only the
left half is computed; the right one is its mirror image. Small parts (mirrors, handles, spoiler, plates) are added as
solids of their own.

Frames are ISO 8855 (x forward, y left, z up; metres). The origin of the body is on the ground below the centre of the
rear axle; that of the wheel is at its centre, spinning about y. The files follow glTF's Y-up convention, which Drake
turns into Z-up when it loads them.

Usage: ``python generate.py`` (needs numpy and shapely; it is deterministic and writes next to itself).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import LineString, Point, Polygon
from shapely.geometry.base import BaseGeometry

Array = NDArray[np.float64]
Curve = Callable[[Array], Array]

WHEELBASE = 2.601
TRACK = 1.501
TYRE_RADIUS = 0.3234
TYRE_WIDTH = 0.215
RIM_RADIUS = 0.2159
ARCH_RADIUS = 0.368
ARCH_INNER_Y = 0.46


@dataclass(frozen=True)
class Material:
    """A material of glTF's metallic-roughness model; the colour is given in sRGB."""

    rgb: tuple[float, float, float]
    roughness: float
    metallic: float = 0.0
    emissive: float = 0.0


MATERIALS: dict[str, Material] = {
    "paint": Material((0.07, 0.45, 0.90), 0.36, 0.1),
    "glass": Material((0.13, 0.19, 0.25), 0.22),
    "gloss_black": Material((0.05, 0.05, 0.06), 0.3),
    "cladding": Material((0.13, 0.13, 0.14), 0.8),
    "gap": Material((0.03, 0.04, 0.07), 0.9),
    "dark": Material((0.04, 0.04, 0.045), 0.95),
    "grille": Material((0.24, 0.25, 0.27), 0.45, 0.2),
    "lamp": Material((0.80, 0.84, 0.88), 0.2, 0.1),
    "lamp_white": Material((1.0, 1.0, 1.0), 0.3, 0.0, 0.35),
    "lamp_red": Material((0.78, 0.03, 0.05), 0.25, 0.0, 0.08),
    "lamp_dark_red": Material((0.42, 0.02, 0.03), 0.3),
    "amber": Material((0.98, 0.55, 0.08), 0.35),
    "chrome": Material((0.82, 0.83, 0.85), 0.3, 0.25),
    "gold": Material((0.86, 0.66, 0.22), 0.35, 0.2),
    "plate": Material((0.93, 0.93, 0.90), 0.6),
    "plate_text": Material((0.06, 0.08, 0.20), 0.7),
    "rubber": Material((0.09, 0.09, 0.095), 0.9),
    "rubber_mark": Material((0.42, 0.42, 0.42), 0.8),
    "rim_machined": Material((0.90, 0.91, 0.93), 0.4, 0.1),
    "rim_dark": Material((0.20, 0.21, 0.23), 0.5, 0.1),
    "rim_shadow": Material((0.07, 0.07, 0.075), 0.9),
    "disc": Material((0.45, 0.45, 0.46), 0.5, 0.2),
    "accent": Material((0.05, 0.36, 0.86), 0.4, 0.1),
    "valve": Material((0.95, 0.25, 0.05), 0.5),
}


# --- Curves and rounded set operations ------------------------------------------------------------------------------


def curve(*knots: tuple[float, float]) -> Curve:
    """Returns the shape-preserving cubic (Fritsch-Carlson) through knots of ascending abscissa, constant beyond."""
    t, f = np.array(knots, dtype=float).T
    h, s = np.diff(t), np.diff(f) / np.diff(t)
    m = np.zeros_like(f)
    w1, w2 = 2 * h[1:] + h[:-1], h[1:] + 2 * h[:-1]
    same = s[1:] * s[:-1] > 0
    safe = np.where(same, s[:-1], 1.0), np.where(same, s[1:], 1.0)
    m[1:-1] = np.where(same, (w1 + w2) / (w1 / safe[0] + w2 / safe[1]), 0.0)
    m[0], m[-1] = s[0], s[-1]

    def evaluate(at: Array) -> Array:
        q = np.clip(at, t[0], t[-1])
        i = np.clip(np.searchsorted(t, q, side="right") - 1, 0, len(h) - 1)
        u = (q - t[i]) / h[i]
        a, b = (1 + 2 * u) * (1 - u) ** 2, u * (1 - u) ** 2
        c, d = u * u * (3 - 2 * u), u * u * (u - 1)
        result: Array = a * f[i] + b * h[i] * m[i] + c * f[i + 1] + d * h[i] * m[i + 1]
        return result

    return evaluate


def smooth_max(a: Array, b: Array, k: float) -> Array:
    """Returns max(a, b) with the crease rounded where |a − b| < k."""
    h: Array = np.maximum(k - np.abs(a - b), 0.0) / k
    return np.maximum(a, b) + h * h * k / 4


def smooth_min(a: Array, b: Array, k: float) -> Array:
    """Returns min(a, b) with the crease rounded where |a − b| < k."""
    return -smooth_max(-a, -b, k)


# --- The body's surface ---------------------------------------------------------------------------------------------

PLAN = curve(
    (-0.75, 0.800), (-0.45, 0.852), (-0.1, 0.8800), (0.3, 0.8790), (1.2, 0.8765), (2.2, 0.8790), (2.6, 0.8815),
    (2.85, 0.872), (3.1, 0.835), (3.3, 0.770), (3.46, 0.66),
)  # fmt: skip
SIDE_INSET = curve(
    (0.10, 0.11), (0.20, 0.048), (0.27, 0.022), (0.36, 0.023), (0.46, 0.022), (0.60, 0.016), (0.74, 0.006),
    (0.85, 0.000), (0.92, 0.010), (1.02, 0.045), (1.15, 0.10),
)  # fmt: skip
NOSE = curve(
    (0.12, 3.30), (0.20, 3.375), (0.32, 3.432), (0.46, 3.451), (0.58, 3.446), (0.70, 3.425), (0.80, 3.385),
    (0.90, 3.31), (1.0, 3.15),
)  # fmt: skip
TAIL = curve(
    (0.15, -0.52), (0.24, -0.62), (0.34, -0.685), (0.48, -0.715), (0.60, -0.713), (0.66, -0.690), (0.72, -0.668),
    (0.85, -0.674), (0.95, -0.672), (1.02, -0.655), (1.10, -0.60), (1.2, -0.50),
)  # fmt: skip
BONNET = curve(
    (-0.8, 1.120), (-0.4, 1.120), (0.5, 1.095), (1.5, 1.065), (2.2, 1.055), (2.6, 1.025), (2.9, 0.985), (3.15, 0.930),
    (3.32, 0.868), (3.42, 0.80), (3.6, 0.60),
)  # fmt: skip
ROOF = curve(
    (-0.80, 1.430), (-0.5, 1.497), (-0.2, 1.545), (0.2, 1.578), (0.6, 1.5935), (0.9, 1.595), (1.2, 1.587),
    (1.5, 1.556), (1.75, 1.485), (2.0, 1.372), (2.3, 1.212), (2.6, 1.040), (2.9, 0.86), (3.6, 0.40), (5.0, -0.5),
)  # fmt: skip
CABIN_PLAN = curve(
    (-0.75, 0.66), (-0.5, 0.735), (-0.2, 0.785), (0.2, 0.818), (0.8, 0.832), (1.6, 0.832), (2.2, 0.815), (2.7, 0.77)
)
CABIN_TAPER = curve((0.75, 0.12), (0.95, 0.02), (1.05, 0.0), (1.2, 0.040), (1.35, 0.098), (1.5, 0.175), (1.6, 0.24))
CABIN_TAIL = curve(
    (0.75, -0.50), (0.95, -0.640), (1.07, -0.638), (1.2, -0.592), (1.35, -0.525), (1.45, -0.47), (1.6, -0.36)
)
BOTTOM = curve((-0.75, 0.26), (-0.45, 0.19), (-0.2, 0.150), (2.9, 0.145), (3.2, 0.165), (3.45, 0.20))


def body_function(p: Array) -> Array:
    """Returns a function of space, negative inside the body (about the distance near its surface), at points (…, 3)."""
    x, y, z = p[..., 0], np.abs(p[..., 1]), p[..., 2]
    r_y = y / 0.85
    flare = np.zeros_like(x)
    for axle in (0.0, WHEELBASE):
        r = np.hypot(x - axle, z - TYRE_RADIUS)
        flare = flare + 0.012 * np.exp(-(((r - 0.40) / 0.07) ** 2))
    side = y - np.minimum(PLAN(x) - SIDE_INSET(z) + flare, 0.8825)
    nose = (x - NOSE(z) + 0.30 * r_y**2.4) / np.sqrt(1 + (0.5 * r_y) ** 2)
    tail = (TAIL(z) + 0.13 * r_y**2.6 - x) / np.sqrt(1 + (0.3 * r_y) ** 2)
    ridge = 0.018 * np.exp(-(((y - 0.60) / 0.10) ** 2)) * np.clip((x - 2.0) / 0.6, 0, 1)
    deck = (z - BONNET(x) + 0.050 * r_y**2 - ridge) / np.sqrt(1 + 0.2**2)
    lower = smooth_max(smooth_max(nose, tail, 0.02), deck, 0.10)
    lower = smooth_max(lower, side, 0.11)
    lower = smooth_max(lower, BOTTOM(x) - z, 0.05)
    cabin_side = (y - CABIN_PLAN(x) + CABIN_TAPER(z)) / 1.06
    roof = (z - ROOF(x + 0.26 * y**2) + 0.055 * (y / 0.65) ** 2) / np.sqrt(1 + 0.3 * np.clip((x - 1.5) / 0.4, 0, 1))
    back = (CABIN_TAIL(z) + 0.13 * (y / 0.7) ** 2.4 - x) / 1.08
    cabin = smooth_max(smooth_max(cabin_side, roof, 0.10), back, 0.08)
    cabin = smooth_max(cabin, 0.7 - z, 0.02)
    return smooth_min(lower, cabin, 0.055)


def gradient(p: Array, step: float = 2e-4) -> Array:
    """Returns the gradient of the body's function at points (…, 3)."""
    columns = []
    for axis in range(3):
        d = np.zeros(3)
        d[axis] = step
        columns.append((body_function(p + d) - body_function(p - d)) / (2 * step))
    return np.stack(columns, axis=-1)


def surface_normals(p: Array) -> Array:
    """Returns the outward unit normals at points on the body's surface."""
    g = gradient(p, 2e-3)
    on_plane = np.abs(p[..., 1]) < 1e-6
    g[on_plane, 1] = 0.0
    result: Array = g / np.maximum(np.linalg.norm(g, axis=-1, keepdims=True), 1e-9)
    return result


def project(p: Array) -> Array:
    """Moves points near the body's surface onto it (those on the plane of symmetry stay there)."""
    for _ in range(4):
        g = gradient(p)
        g[np.abs(p[..., 1]) < 1e-6, 1] = 0.0
        move = body_function(p)[..., None] * g / np.maximum((g * g).sum(-1, keepdims=True), 0.25)
        p = p - np.clip(move, -0.01, 0.01)
    return p


def cast(origin: Array, direction: Array, reach: float = 1.6) -> Array:
    """Returns the points where rays from inside the body first leave it."""
    steps = np.linspace(0.0, reach, 161)
    values = np.stack([body_function(origin + s * direction) for s in steps])
    first = np.argmax(values > 0, axis=0)
    low, high = steps[np.maximum(first - 1, 0)], steps[first]
    for _ in range(24):
        mid = (low + high) / 2
        outside = body_function(origin + mid[..., None] * direction) > 0
        low, high = np.where(outside, low, mid), np.where(outside, mid, high)
    result: Array = origin + high[..., None] * direction
    return result


# --- Meshes ---------------------------------------------------------------------------------------------------------


@dataclass
class Mesh:
    """Triangles with normals, collected by material."""

    parts: dict[str, list[tuple[Array, Array]]] = field(default_factory=dict)  # material: (triangles, normals) (n,3,3)

    def add(self, material: str, triangles: Array, normals: Array) -> None:
        """Adds triangles (n, 3, 3) with the normals at their corners; turns those that face against their normals."""
        face = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        keep = np.linalg.norm(face, axis=1) > 1e-10
        triangles, normals, face = triangles[keep], normals[keep], face[keep]
        wrong = np.einsum("ij,ij->i", face, normals.sum(axis=1)) < 0
        triangles = np.where(wrong[:, None, None], triangles[:, ::-1], triangles)
        normals = np.where(wrong[:, None, None], normals[:, ::-1], normals)
        self.parts.setdefault(material, []).append((triangles, normals))

    def add_grid(self, material: str, points: Array, normals: Array) -> None:
        """Adds the quadrilaterals of a grid of points (m, n, 3)."""

        def split(a: Array) -> Array:
            p, q, r, s = a[:-1, :-1], a[1:, :-1], a[1:, 1:], a[:-1, 1:]
            both = np.stack([np.stack([p, q, r], axis=2), np.stack([p, r, s], axis=2)])
            return both.reshape(-1, 3, 3)

        self.add(material, split(points), split(normals))

    def add_flat(self, material: str, triangles: Array, normal: Sequence[float]) -> None:
        """Adds flat triangles that share one normal."""
        self.add(material, triangles, np.broadcast_to(np.array(normal, dtype=float), triangles.shape).copy())

    def add_mesh(self, other: Mesh, rotation: Array | None = None, offset: Sequence[float] = (0, 0, 0)) -> None:
        """Adds another mesh, rotated and moved."""
        R = np.eye(3) if rotation is None else rotation
        for material, chunks in other.parts.items():
            for triangles, normals in chunks:
                self.add(material, triangles @ R.T + np.array(offset), normals @ R.T)

    def mirrored(self) -> Mesh:
        """Returns the mirror image at the plane y = 0."""
        flip = np.array([1.0, -1.0, 1.0])
        result = Mesh()
        for material, chunks in self.parts.items():
            for triangles, normals in chunks:
                result.add(material, triangles * flip, normals * flip)
        return result

    def write(self, path: Path) -> int:
        """Writes ``path`` (.gltf) and its .bin; returns the number of triangles."""
        blob = bytearray()
        views: list[dict[str, object]] = []
        accessors: list[dict[str, object]] = []
        primitives: list[dict[str, object]] = []
        materials: list[dict[str, object]] = []
        count = 0

        def store(data: NDArray[np.generic], kind: str, component: int, target: int, bounds: bool) -> int:
            while len(blob) % 4:
                blob.append(0)
            raw = data.tobytes()
            views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(raw), "target": target})
            entry: dict[str, object] = {
                "bufferView": len(views) - 1, "componentType": component, "count": len(data), "type": kind,
            }  # fmt: skip
            if bounds:
                entry["min"], entry["max"] = data.min(axis=0).tolist(), data.max(axis=0).tolist()
            accessors.append(entry)
            blob.extend(raw)
            return len(accessors) - 1

        for name in sorted(self.parts):
            corners = np.concatenate([t for t, _ in self.parts[name]]).reshape(-1, 3)
            normals = np.concatenate([n for _, n in self.parts[name]]).reshape(-1, 3)
            normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
            key = np.concatenate([np.round(corners * 2e4), np.round(normals * 60)], axis=1)
            _, first, inverse = np.unique(key, axis=0, return_index=True, return_inverse=True)
            faces = inverse.reshape(-1, 3)
            good = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
            faces = faces[good]
            if not len(faces):
                continue
            count += len(faces)
            y_up = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])  # ISO 8855 to glTF: (x, z, −y)
            p = np.ascontiguousarray((corners[first] @ y_up.T).astype("<f4"))
            n = np.ascontiguousarray((normals[first] @ y_up.T).astype("<f4"))
            small = len(p) < 65535
            index = faces.reshape(-1).astype("<u2" if small else "<u4")
            attributes = {
                "POSITION": store(p, "VEC3", 5126, 34962, True),
                "NORMAL": store(n, "VEC3", 5126, 34962, False),
            }
            indices = store(index, "SCALAR", 5123 if small else 5125, 34963, False)
            primitives.append({"attributes": attributes, "indices": indices, "material": len(materials)})
            m = MATERIALS[name]
            linear = [round(c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4, 5) for c in m.rgb]
            entry: dict[str, object] = {
                "name": name,
                "pbrMetallicRoughness": {
                    "baseColorFactor": [*linear, 1.0], "metallicFactor": m.metallic, "roughnessFactor": m.roughness,
                },
            }  # fmt: skip
            if m.emissive:
                entry["emissiveFactor"] = [round(c * m.emissive, 5) for c in linear]
            materials.append(entry)
        name = path.stem
        document = {
            "asset": {"version": "2.0", "generator": "mirdrake models/bolt/meshes/generate.py"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"name": name, "mesh": 0}],
            "meshes": [{"name": name, "primitives": primitives}],
            "materials": materials,
            "accessors": accessors,
            "bufferViews": views,
            "buffers": [{"uri": f"{name}.bin", "byteLength": len(blob)}],
        }
        path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
        path.with_suffix(".bin").write_bytes(bytes(blob))
        return count


def triangulate(shape: BaseGeometry) -> Array:
    """Returns the triangles (n, 3, 2) of a plane shape."""
    found = []
    for part in getattr(shape, "geoms", [shape]):
        if isinstance(part, Polygon) and part.area > 1e-10:
            triangles = shapely.constrained_delaunay_triangles(part).geoms
            found += [np.array(triangle.exterior.coords)[:3, :2] for triangle in triangles]
    return np.array(found).reshape(-1, 3, 2)


# --- Regions drawn on the body --------------------------------------------------------------------------------------

LEFT, FRONT, REAR, ABOVE, BELOW = (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)
FRONT_LEFT = (float(np.cos(0.75)), float(np.sin(0.75)), 0.0)
REAR_LEFT = (-float(np.cos(0.65)), float(np.sin(0.65)), 0.0)


def view_axes(direction: Sequence[float]) -> tuple[Array, Array]:
    """Returns the two axes of the picture plane of a view from ``direction``."""
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


@dataclass
class Region:
    """A shape in the picture plane of a view; the faces seen there get ``material`` (None cuts a hole)."""

    material: str | None
    view: Sequence[float]
    shape: BaseGeometry
    facing: float = 0.1
    only: tuple[str, ...] = ()  # the materials it is drawn over; all if empty


def outline(points: Iterable[Sequence[float]], round_by: float = 0.0) -> BaseGeometry:
    """Returns a polygon with rounded corners."""
    shape: BaseGeometry = Polygon([tuple(p) for p in points])
    if round_by:
        shape = shape.buffer(-round_by, quad_segs=4).buffer(2 * round_by, quad_segs=4).buffer(-round_by, quad_segs=4)
        shape = shape.simplify(8e-4)
    return shape


def stroke(points: Iterable[Sequence[float]], width: float) -> BaseGeometry:
    """Returns a polyline drawn with a pen of that width."""
    return LineString([tuple(p) for p in points]).buffer(width / 2, cap_style="flat", join_style="mitre")


def seen(view: Sequence[float], points: Iterable[Sequence[float]]) -> list[tuple[float, float]]:
    """Returns points of space in the picture plane of a view."""
    u, v = view_axes(view)
    return [(float(np.dot(u, p)), float(np.dot(v, p))) for p in points]


def smooth_line(points: Sequence[Sequence[float]], count: int = 24) -> list[tuple[float, float]]:
    """Returns points on a smooth curve through the given ones."""
    p = np.array(points, dtype=float)
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))])
    t = np.linspace(0.0, s[-1], count)
    fx, fy = (curve(*zip(s.tolist(), p[:, i].tolist(), strict=True))(t) for i in (0, 1))
    return list(zip(fx.tolist(), fy.tolist(), strict=True))


def arch(axle: float, radius: float) -> BaseGeometry:
    """Returns the outline of a wheel opening seen from the left: a semicircle with straight ends."""
    circle = Point(axle, TYRE_RADIUS).buffer(radius, quad_segs=16)
    return circle.union(shapely.box(axle - radius, -0.1, axle + radius, TYRE_RADIUS))


def regions() -> list[Region]:
    """Returns everything that is drawn on the body, in the order of drawing."""
    found: list[Region] = []

    def draw(material: str | None, view: Sequence[float], shape: BaseGeometry, facing: float = 0.1) -> None:
        found.append(Region(material, view, shape, facing))

    # Underbody and lower cladding, all around the car.
    draw("dark", BELOW, outline([(-1, -1), (4, -1), (4, 1), (-1, 1)]), 0.75)
    sill = [(-0.9, 0.0), (-0.9, 0.40), (-0.34, 0.40), (0.34, 0.285), (2.26, 0.285), (2.94, 0.27), (3.6, 0.27), (3.6, 0)]
    draw("cladding", LEFT, outline(sill), 0.0)
    draw("cladding", FRONT, outline([(-0.1, 0), (1, 0), (1, 0.27), (-0.1, 0.27)]), 0.1)
    draw("cladding", REAR, outline([(-0.1, 0), (1, 0), (1, 0.40), (-0.1, 0.40)]), 0.1)
    for axle in (0.0, WHEELBASE):
        draw("cladding", LEFT, arch(axle, ARCH_RADIUS + 0.018), 0.2)

    # Side windows: one dark band with the panes in it, which ends in the black "floating roof" pillar.
    belt = smooth_line([(2.27, 1.064), (1.9, 1.064), (1.2, 1.075), (0.5, 1.10), (0.05, 1.135), (-0.28, 1.19)], 20)
    rail = smooth_line([(-0.46, 1.392), (-0.1, 1.436), (0.4, 1.474), (0.9, 1.486), (1.3, 1.476), (1.62, 1.425)], 20)
    pillar = smooth_line([(1.62, 1.425), (1.86, 1.315), (2.07, 1.180), (2.27, 1.064)], 12)
    back = [(-0.36, 1.205), (-0.70, 1.225), (-0.70, 1.33), (-0.62, 1.365)]
    band = outline([*belt, *back, *rail, *pillar[1:-1]], 0.012)
    draw("gloss_black", LEFT, band, 0.15)
    panes = band.buffer(-0.022, join_style="mitre")
    for x_low, x_high, lean in ((1.93, 2.30, 0.02), (1.02, 1.88, 0.02), (0.13, 0.93, 0.03), (-0.26, 0.07, 0.05)):
        box = outline([(x_low, 1.0), (x_high, 1.0), (x_high - lean, 1.6), (x_low - lean, 1.6)])
        pane = panes.intersection(box).buffer(-0.014, quad_segs=3).buffer(0.014, quad_segs=3).simplify(4e-4)
        draw("glass", LEFT, pane, 0.15)

    # Windscreen and rear window.
    screen = [(-0.1, 1.058), (0.30, 1.060), (0.55, 1.064), (0.69, 1.076), (0.695, 1.11), (0.68, 1.20), (0.655, 1.30),
              (0.615, 1.40), (0.575, 1.458), (0.53, 1.480), (0.40, 1.500), (0.20, 1.515), (-0.1, 1.520)]  # fmt: skip
    draw("gloss_black", FRONT, outline(screen), 0.12)
    draw("glass", FRONT, outline(screen).buffer(-0.028).intersection(shapely.box(-0.05, 1.0, 1, 1.6)), 0.12)
    hatch = [(-0.1, 1.030), (0.50, 1.045), (0.66, 1.10), (0.675, 1.20), (0.635, 1.33), (0.585, 1.39), (0.50, 1.425),
             (0.48, 1.46), (-0.1, 1.50)]  # fmt: skip
    draw("gloss_black", REAR, outline(hatch), 0.2)
    draw("glass", REAR, outline([(-0.1, 1.115), (0.50, 1.125), (0.585, 1.20), (0.50, 1.405), (-0.1, 1.425)], 0.02), 0.2)

    # Front: closed grille panel, headlamps, lower intake, fog lamp pods.
    draw("gloss_black", FRONT, outline([(-0.1, 0.618), (0.34, 0.632), (0.50, 0.680), (0.56, 0.765), (0.40, 0.760),
                                        (-0.1, 0.754)], 0.01), 0.1)  # fmt: skip
    for row in range(3):
        z = 0.652 + 0.032 * row
        draw("grille", FRONT, outline([(-0.1, z), (0.36 + 0.05 * row, z), (0.375 + 0.05 * row, z + 0.014),
                                       (-0.1, z + 0.014)]), 0.1)  # fmt: skip
    lamp = seen(
        FRONT_LEFT,
        [
            (3.38, 0.42, 0.685),
            (3.30, 0.60, 0.702),
            (3.12, 0.76, 0.748),
            (2.95, 0.83, 0.825),
            (2.84, 0.84, 0.890),
            (3.02, 0.79, 0.878),
            (3.20, 0.67, 0.838),
            (3.34, 0.46, 0.775),
        ],
    )
    bezel = outline(lamp, 0.012)
    draw("gloss_black", FRONT_LEFT, bezel, 0.15)
    draw("lamp", FRONT_LEFT, bezel.buffer(-0.013), 0.15)
    low, high = lamp[:5], [lamp[7], lamp[6], lamp[5], lamp[4]]
    draw("lamp_white", FRONT_LEFT, stroke(high, 0.03).intersection(bezel.buffer(-0.012)), 0.15)
    draw("amber", FRONT_LEFT, stroke(low[2:], 0.028).intersection(bezel.buffer(-0.013)), 0.15)
    for at, radius in (((3.335, 0.515, 0.743), 0.032), ((3.24, 0.64, 0.772), 0.032)):
        spot = Point(seen(FRONT_LEFT, [at])[0])
        draw("gloss_black", FRONT_LEFT, spot.buffer(radius, quad_segs=5), 0.15)
        draw("lamp_white", FRONT_LEFT, spot.buffer(radius * 0.6, quad_segs=4), 0.15)
    intake = outline([(-0.1, 0.285), (0.46, 0.285), (0.53, 0.33), (0.50, 0.425), (0.36, 0.470), (-0.1, 0.480)], 0.015)
    draw("dark", FRONT, intake, 0.1)
    for z in (0.335, 0.385, 0.435):
        draw("cladding", FRONT, shapely.box(-0.1, z - 0.008, 1, z + 0.008).intersection(intake.buffer(-0.012)), 0.1)
    pod = outline(seen(FRONT_LEFT, [(3.30, 0.60, 0.315), (3.10, 0.78, 0.33), (3.06, 0.80, 0.47), (3.20, 0.72, 0.50),
                                    (3.31, 0.60, 0.42)]), 0.012)  # fmt: skip
    draw("cladding", FRONT_LEFT, pod, 0.1)
    drl = stroke(seen(FRONT_LEFT, [(3.30, 0.60, 0.40), (3.20, 0.72, 0.475), (3.07, 0.80, 0.45)]), 0.016)
    draw("lamp_white", FRONT_LEFT, drl.intersection(pod.buffer(-0.006)), 0.1)

    # Rear: tail lamps high on the hatch, plate recess, reflectors.
    tail = outline(seen(REAR_LEFT, [(-0.66, 0.40, 0.945), (-0.60, 0.62, 0.925), (-0.42, 0.80, 0.945),
                                    (-0.30, 0.83, 1.045), (-0.44, 0.76, 1.075), (-0.58, 0.58, 1.035),
                                    (-0.655, 0.40, 0.995)]), 0.014)  # fmt: skip
    draw("gloss_black", REAR_LEFT, tail, 0.1)
    draw("lamp_red", REAR_LEFT, tail.buffer(-0.010), 0.1)
    draw("lamp_dark_red", REAR_LEFT, tail.buffer(-0.034), 0.1)
    draw("cladding", REAR, outline([(-0.1, 0.715), (0.27, 0.715), (0.30, 0.865), (-0.1, 0.865)], 0.01), 0.1)
    draw("lamp_red", REAR, outline([(0.52, 0.425), (0.72, 0.435), (0.72, 0.462), (0.52, 0.452)]), 0.1)

    # Shut lines.
    line = 0.0065
    gaps: list[tuple[Sequence[float], list[tuple[float, float]]]] = [
        (LEFT, [(2.06, 1.062), (2.06, 0.95), (2.10, 0.75), (2.11, 0.55), (2.08, 0.38), (2.03, 0.335), (1.02, 0.335)]),
        (LEFT, [(0.975, 1.085), (0.975, 0.90), (0.99, 0.60), (1.02, 0.335)]),
        (LEFT, [(1.02, 0.335), (0.62, 0.335), (0.52, 0.36), (0.44, 0.48), (0.36, 0.62), (0.20, 0.72), (0.08, 0.80),
                (0.04, 0.90), (0.03, 1.135)]),
        (LEFT, [(2.20, 0.985), (2.40, 0.975), (2.70, 0.940), (2.90, 0.880)]),
        (LEFT, [(2.06, 0.985), (2.20, 0.985)]),
        (LEFT, [(2.87, 0.86), (2.80, 0.62)]),
        (LEFT, [(-0.31, 0.55), (-0.42, 0.62), (-0.48, 0.67)]),
        (FRONT, [(-0.05, 0.790), (0.36, 0.793), (0.47, 0.790)]),
        (REAR, [(-0.05, 0.665), (0.62, 0.665), (0.70, 0.70), (0.72, 0.95)]),
    ]  # fmt: skip
    found += [Region("gap", view, stroke(points, line), 0.25, ("paint",)) for view, points in gaps]
    charge = outline([(2.70, 0.735), (2.50, 0.75), (2.50, 0.90), (2.68, 0.885)], 0.02)
    found.append(Region("gap", LEFT, charge.boundary.buffer(0.0025), 0.25, ("paint",)))

    # Wheel openings.
    for axle in (0.0, WHEELBASE):
        draw(None, LEFT, arch(axle, ARCH_RADIUS), 0.0)
        draw(None, BELOW, shapely.box(axle - ARCH_RADIUS, ARCH_INNER_Y, axle + ARCH_RADIUS, 1.0), 0.3)
    return found


def cut(points: Array, faces: NDArray[np.int64]) -> list[tuple[str, Array]]:
    """Cuts the half body's triangles along all regions; returns (material, triangles) pairs."""
    tris = points[faces]
    labels = np.full(len(tris), "paint", dtype=object)
    for region in regions():
        u, v = view_axes(region.view)
        d = np.array(region.view)
        normal = np.cross(tris[:, 1] - tris[:, 0], tris[:, 2] - tris[:, 0])
        size = np.maximum(np.linalg.norm(normal, axis=1), 1e-12)
        flat = np.stack([tris @ u, tris @ v], axis=-1)
        visible = normal @ d / size > region.facing
        if region.view in (FRONT, REAR):
            visible &= (tris[:, :, 0].mean(axis=1) - 1.0) * d[0] > 0
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
            basis = np.linalg.inv(np.stack([b - a, c - a], axis=1))
            for pieces, label in ((outer, labels[index]), (inner, region.material)):
                if label is None or not len(pieces):
                    continue
                w = (pieces - a) @ basis.T
                A, B, C = tris[index]
                new_tris.append(A + w[..., :1] * (B - A) + w[..., 1:] * (C - A))
                new_labels += [label] * len(pieces)
        kept = ~drop
        tris = np.concatenate([tris[kept], *new_tris]) if new_tris else tris[kept]
        labels = np.concatenate([labels[kept], np.array(new_labels, dtype=object)])
        if new_tris:  # keep the orientation of the original faces
            normal = np.cross(tris[:, 1] - tris[:, 0], tris[:, 2] - tris[:, 0])
            outward = surface_normals(tris.mean(axis=1))
            wrong = np.einsum("ij,ij->i", normal, outward) < 0
            tris = np.where(wrong[:, None, None], tris[:, ::-1], tris)
    return [(str(name), tris[labels == name]) for name in sorted(set(labels))]


def half_shell() -> tuple[Array, NDArray[np.int64]]:
    """Samples the left half of the body on a structured grid; returns its points and triangles."""
    x_rear, x_front = -0.15, 2.85
    fan = np.linspace(np.pi / 2, 0.0, 16)
    stations = [(x_rear, -np.sin(a), np.cos(a)) for a in fan[:-1]]
    stations += [(float(x), 0.0, 1.0) for x in np.linspace(x_rear, x_front, 40)]
    stations += [(x_front, np.sin(a), np.cos(a)) for a in fan[::-1][1:]]
    dense, count = 260, 35
    rows = []
    theta = np.linspace(-np.pi / 2, np.pi / 2, dense)
    spine = curve((-0.5, 0.78), (1.5, 0.72), (3.0, 0.58))
    for x, along, across in stations:
        origin = np.broadcast_to(np.array([x, 0.0, float(spine(np.array(x)))]), (dense, 3))
        level = np.cos(theta)
        level[[0, -1]] = 0.0
        across = 0.0 if across < 1e-9 else across
        direction = np.stack([along * level, across * level, np.sin(theta)], axis=1)
        p = cast(origin, direction, 2.2)
        n = surface_normals(p)
        length = np.linalg.norm(np.diff(p, axis=0), axis=1)
        turn = np.linalg.norm(np.diff(n, axis=0), axis=1)
        below = (n[:-1, 2] + n[1:, 2]) / 2 < -0.8
        weight = np.where(below, 0.2, 1.0) * (length + 0.10 * turn) + 1e-7
        rows.append((p, weight))
    # Blend the sampling of neighbouring stations, so that the grid lines along the car run smoothly.
    share = np.stack([np.concatenate([[0.0], np.cumsum(w)]) / w.sum() for _, w in rows])
    for _ in range(4):
        share[1:-1] = 0.25 * share[:-2] + 0.5 * share[1:-1] + 0.25 * share[2:]
    wanted = np.linspace(0.0, 1.0, count)
    grid = np.stack(
        [
            np.stack([np.interp(wanted, s, p[:, axis]) for axis in range(3)], axis=1)
            for s, (p, _) in zip(share, rows, strict=True)
        ]
    )
    for _ in range(2):
        grid[:, [0, -1], 1] = 0.0
        grid[[0, -1], :, 1] = 0.0
        grid = project(grid)
    m, n = grid.shape[:2]
    index = np.arange(m * n).reshape(m, n)
    p, q, r, s = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    points = grid.reshape(-1, 3)
    # The shorter diagonal divides each quadrilateral.
    one = np.linalg.norm(points[p] - points[r], axis=-1) <= np.linalg.norm(points[q] - points[s], axis=-1)
    first = np.where(one[..., None], np.stack([p, q, r], -1), np.stack([p, q, s], -1))
    second = np.where(one[..., None], np.stack([p, r, s], -1), np.stack([q, r, s], -1))
    faces = np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)])
    corner = points[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    keep = np.linalg.norm(normal, axis=1) > 1e-9
    faces, normal, corner = faces[keep], normal[keep], corner[keep]
    wrong = np.einsum("ij,ij->i", normal, surface_normals(corner.mean(axis=1))) < 0
    faces = np.where(wrong[:, None], faces[:, ::-1], faces)
    return points, faces


# --- Small solids ---------------------------------------------------------------------------------------------------


def rot_y(angle: float) -> Array:
    """Returns the rotation by an angle about y."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def rot_z(angle: float) -> Array:
    """Returns the rotation by an angle about z."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def pillow(material: str, size: Sequence[float], sharp: float = 0.35, count: tuple[int, int] = (20, 11)) -> Mesh:
    """Returns a superellipsoid (a box with rounded edges for small ``sharp``) of the given full size."""
    mesh = Mesh()
    a = np.linspace(0, 2 * np.pi, count[0] + 1)[:, None]
    b = np.linspace(-np.pi / 2, np.pi / 2, count[1])[None, :]

    def power(value: Array, e: float) -> Array:
        value = np.where(np.abs(value) < 1e-12, 0.0, value)
        result: Array = np.sign(value) * np.abs(value) ** e
        return result

    half = np.array(size) / 2
    one = np.ones_like(a * b)
    p = np.stack([power(np.cos(a), sharp) * power(np.cos(b), sharp), power(np.sin(a), sharp) * power(np.cos(b), sharp),
                  power(np.sin(b), sharp) * one], axis=-1)  # fmt: skip
    e = 2 - sharp
    n = np.stack([power(np.cos(a), e) * power(np.cos(b), e), power(np.sin(a), e) * power(np.cos(b), e),
                  power(np.sin(b), e) * one], axis=-1) / half  # fmt: skip
    n /= np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), 1e-12)
    mesh.add_grid(material, p * half, n)
    return mesh


def prism(material: str, shape: BaseGeometry, depth: float) -> Mesh:
    """Returns a plane shape (in y, z) extruded along x from 0 to ``depth``, with flat faces and edges."""
    mesh = Mesh()
    flat = triangulate(shape)
    zero = np.zeros((*flat.shape[:2], 1))
    mesh.add_flat(material, np.concatenate([zero + depth, flat], axis=2), (1, 0, 0))
    mesh.add_flat(material, np.concatenate([zero, flat], axis=2), (-1, 0, 0))
    for part in getattr(shape, "geoms", [shape]):
        ring = np.array(shapely.geometry.polygon.orient(part).exterior.coords)
        for a, b in pairwise(ring):
            t = (b - a) / max(float(np.linalg.norm(b - a)), 1e-12)
            quad = np.array([[0, *a], [0, *b], [depth, *b], [depth, *a]])
            mesh.add_flat(material, quad[[[0, 1, 2], [0, 2, 3]]], (0, t[1], -t[0]))
    return mesh


GLYPHS = {
    "B": ("110", "101", "110", "101", "110"), "O": ("111", "101", "101", "101", "111"),
    "L": ("100", "100", "100", "100", "111"), "T": ("111", "010", "010", "010", "010"),
    "E": ("111", "100", "110", "100", "111"), "V": ("101", "101", "101", "101", "010"),
    " ": ("000", "000", "000", "000", "000"), "M": ("101", "111", "111", "101", "101"),
    "I": ("111", "010", "010", "010", "111"), "R": ("110", "101", "110", "101", "101"),
    "2": ("111", "001", "111", "100", "111"), "0": ("111", "101", "101", "101", "111"),
    "1": ("010", "110", "010", "010", "111"), "7": ("111", "001", "010", "010", "010"),
}  # fmt: skip


def plate(text: str) -> Mesh:
    """Returns a licence plate that faces +x, with its text in block letters."""
    mesh = prism("plate_text", shapely.box(-0.262, -0.058, 0.262, 0.058), 0.008)
    mesh.add_mesh(prism("plate", shapely.box(-0.257, -0.053, 0.257, 0.053), 0.010))
    cell_y, cell_z = 0.0125, 0.0145
    width = (4 * len(text) - 1) * cell_y
    boxes = []
    for i, letter in enumerate(text):
        for row, bits in enumerate(GLYPHS[letter]):
            for column, bit in enumerate(bits):
                if bit == "1":
                    y = (4 * i + column) * cell_y - width / 2
                    z = (2.5 - row) * cell_z
                    boxes.append(shapely.box(y, z - cell_z, y + cell_y, z))
    flat = triangulate(shapely.union_all(boxes))
    face = np.concatenate([np.full((*flat.shape[:2], 1), 0.0112), flat], axis=2)
    mesh.add_flat("plate_text", face, (1, 0, 0))
    return mesh


def surface_point(origin: Sequence[float], direction: Sequence[float]) -> Array:
    """Returns the point where a ray from inside leaves the body."""
    found: Array = cast(np.array([origin], dtype=float), np.array([direction], dtype=float))[0]
    return found


def wheelhouse(axle: float) -> Mesh:
    """Returns the dark inside of the left wheel opening at an axle."""
    mesh = Mesh()
    a = np.concatenate([np.zeros(4), np.linspace(0.0, np.pi, 37), np.full(4, np.pi)])
    drop = np.concatenate([[0.15, 0.10, 0.05, 0.0], np.zeros(37), [0.0, 0.05, 0.10, 0.15]])
    x, z = axle + ARCH_RADIUS * np.cos(a), TYRE_RADIUS + ARCH_RADIUS * np.sin(a) - drop
    z = np.maximum(z, BOTTOM(x) + 0.03)
    start = np.stack([x, np.full_like(x, 0.3), z], axis=1)
    outer = cast(start, np.broadcast_to(np.array([0.0, 1.0, 0.0]), start.shape), 0.9)
    inner = outer.copy()
    inner[:, 1] = ARCH_INNER_Y
    normal = np.stack([-np.cos(a), np.zeros_like(a), -np.sin(a)], axis=1)
    lip = outer.copy()
    lip[:, 1] -= 0.016
    outer = outer - 0.007 * normal  # starts behind the skin, so that no gap shows along the edge
    outer[:, 1] -= 0.003
    mesh.add_grid("cladding", np.stack([outer, lip]), np.stack([normal, normal]))
    mesh.add_grid("dark", np.stack([lip, inner]), np.stack([normal, normal]))
    wall = shapely.Polygon(np.stack([inner[:, 0], inner[:, 2]], axis=1))
    flat = triangulate(wall)
    side = np.stack([flat[..., 0], np.full(flat.shape[:2], ARCH_INNER_Y), flat[..., 1]], axis=-1)
    mesh.add_flat("dark", side, (0, 1, 0))
    return mesh


def left_parts() -> Mesh:
    """Returns the small solids of the left side."""
    mesh = Mesh()
    # Door mirror: a painted shell with a black foot and a mirror glass.
    shell = pillow("paint", (0.145, 0.19, 0.13), 0.62, (16, 11))
    mesh.add_mesh(shell, rot_z(-0.18), (1.965, 0.945, 1.115))
    mesh.add_mesh(pillow("gloss_black", (0.10, 0.20, 0.035), 0.5, (10, 5)), None, (1.985, 0.880, 1.055))
    glass = pillow("glass", (0.02, 0.155, 0.10), 0.5, (12, 5))
    mesh.add_mesh(glass, rot_z(-0.18), (1.894, 0.935, 1.115))
    # Door handles.
    for x, z in ((1.16, 0.905), (0.20, 0.925)):
        y = surface_point((x, 0.3, z), (0, 1, 0))[1]
        mesh.add_mesh(pillow("gap", (0.19, 0.012, 0.045), 0.5, (10, 5)), None, (x, y, z - 0.004))
        mesh.add_mesh(pillow("paint", (0.205, 0.034, 0.026), 0.5, (12, 7)), None, (x, y + 0.010, z + 0.006))
    return mesh


def spoiler() -> Mesh:
    """Returns the roof spoiler, a wing profile swept across the car that continues the roof to the rear."""
    mesh = Mesh()
    y = np.linspace(-0.54, 0.54, 23)
    share = np.linspace(0.0, 1.0, 9)
    rows_top, rows_low = [], []
    for yy in y:
        front, root, back = -0.30, -0.40 + 0.05 * (yy / 0.6) ** 2, -0.650 + 0.10 * abs(yy / 0.6) ** 3
        x = front + share * (back - front)
        probe = np.stack([np.maximum(x, root), np.full_like(x, yy), np.full_like(x, 1.2)], axis=1)
        z = cast(probe, np.broadcast_to(np.array([0.0, 0.0, 1.0]), probe.shape), 0.6)[:, 2] + 0.003
        z = z - 0.19 * np.maximum(root - x, 0.0)
        rows_top.append(np.stack([x, np.full_like(x, yy), z], axis=1))
        thick = np.interp(x, [back, back + 0.02, front], [0.014, 0.030, 0.06])
        rows_low.append(np.stack([x + 0.012, np.full_like(x, yy), z - thick], axis=1))

    def normals(grid: Array, up: float) -> Array:
        n = np.cross(np.gradient(grid, axis=0), np.gradient(grid, axis=1))
        n /= np.linalg.norm(n, axis=-1, keepdims=True)
        result: Array = n * np.sign(n[..., 2:]) * up
        return result

    top, low = np.stack(rows_top), np.stack(rows_low)
    mesh.add_grid("paint", top, normals(top, 1.0))
    mesh.add_grid("gloss_black", low, normals(low, -1.0))
    rear = np.stack([top[:, -1], low[:, -1]])
    mesh.add_grid("paint", rear, np.broadcast_to(np.array([-1.0, 0, 0.1]), rear.shape).copy())
    for k, sign in ((0, -1.0), (-1, 1.0)):
        end = np.stack([top[k], low[k]])
        mesh.add_grid("paint", end, np.broadcast_to(np.array([0, sign, 0.0]), end.shape).copy())
        # A black winglet beside the rear window closes the gap between the spoiler and the pillar.
        fin = np.stack([top[k] - [0, 0, 0.004], top[k] - np.linspace([0, 0, 0.13], [0, 0, 0.02], top.shape[1])])
        fin[1, :, 0] += np.linspace(0.0, 0.025, top.shape[1])
        for shift, facing in ((-0.004, sign), (-0.026, -sign)):
            side = fin + np.array([0.0, sign * shift, 0.0])
            mesh.add_grid("gloss_black", side, np.broadcast_to(np.array([0, facing, 0.0]), fin.shape).copy())
        width = np.array([0.0, 0.022 * sign, 0.0])
        edge = np.stack([fin[1] - 0.004 * np.array([0, sign, 0]), fin[1] - 0.004 * np.array([0, sign, 0]) - width])
        mesh.add_grid("gloss_black", edge, np.broadcast_to(np.array([-0.5, 0, -0.8]), edge.shape).copy())
    stop = pillow("lamp_red", (0.012, 0.30, 0.014), 0.4, (12, 7))
    mesh.add_mesh(stop, None, (float(rear[0, 11, 0]) + 0.002, 0.0, float(rear[:, 11, 2].mean())))
    return mesh


def centre_parts() -> Mesh:
    """Returns the small solids on the plane of symmetry."""
    mesh = spoiler()
    flip = rot_z(np.pi)
    front = surface_point((3.0, 0, 0.54), (1, 0, 0))
    mesh.add_mesh(plate("MIR 2017"), None, (float(front[0]) - 0.005, 0, 0.535))
    rear = surface_point((-0.3, 0, 0.79), (-1, 0, 0))
    mesh.add_mesh(plate("BOLT EV"), flip, (float(rear[0]) + 0.002, 0, 0.79))
    # Oval emblems of no maker.
    angles = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    oval = outline([(0.055 * float(np.cos(a)), 0.022 * float(np.sin(a))) for a in angles])
    nose = surface_point((3.0, 0, 0.69), (1, 0, 0))
    mesh.add_mesh(prism("gold", oval, 0.014), None, (float(nose[0]) - 0.004, 0, 0.69))
    hatch = surface_point((-0.3, 0, 0.965), (-1, 0, 0))
    mesh.add_mesh(prism("gold", oval, 0.014), flip, (float(hatch[0]) + 0.004, 0, 0.965))
    # Aerial and rear wiper.
    mesh.add_mesh(pillow("gloss_black", (0.15, 0.035, 0.075), 0.8, (16, 9)), rot_y(-0.25), (-0.17, 0, 1.560))
    return mesh


def build_body() -> Mesh:
    """Returns the complete body."""
    points, faces = half_shell()
    half = Mesh()
    for name, triangles in cut(points, faces):
        snapped = project(triangles)
        half.add(name, snapped, surface_normals(snapped))
    for axle in (0.0, WHEELBASE):
        half.add_mesh(wheelhouse(axle))
    half.add_mesh(left_parts())
    mesh = Mesh()
    mesh.add_mesh(half)
    mesh.add_mesh(half.mirrored())
    mesh.add_mesh(centre_parts())
    return mesh


# --- The wheel ------------------------------------------------------------------------------------------------------


def revolve(material: str, profile: Sequence[tuple[float, float]], count: int, smooth: bool = True) -> Mesh:
    """Returns a profile of (y, radius) points revolved about y; its outward side is on the left of its direction."""
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


def wheel_face(material: str, shape: BaseGeometry, y: float, skirt: float = 0.0, skirt_material: str = "") -> Mesh:
    """Returns a plane shape (x, z) at height ``y`` that faces +y, with a skirt down to ``y − skirt``."""
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
    """Returns the point (x, z) at a radius and an angle."""
    return radius * float(np.cos(np.deg2rad(degrees))), radius * float(np.sin(np.deg2rad(degrees)))


def sector(r_in: float, r_out: float, start: float, end: float, count: int = 8) -> BaseGeometry:
    """Returns a ring sector, angles in degrees."""
    a = np.linspace(start, end, count)
    return Polygon([polar(r_in, float(v)) for v in a] + [polar(r_out, float(v)) for v in a[::-1]])


def build_wheel() -> Mesh:
    """Returns the wheel: a tyre and a rim with five two-tone double spokes on either side."""
    mesh = Mesh()
    h, R, r = TYRE_WIDTH / 2, TYRE_RADIUS, RIM_RADIUS
    profile = [(-0.088, r - 0.003), (-0.1005, r + 0.014), (-h, r + 0.050), (-h + 0.004, R - 0.032),
               (-0.090, R - 0.010), (-0.074, R - 0.003), (-0.052, R), (-0.048, R - 0.007), (-0.042, R - 0.007),
               (-0.038, R), (-0.014, R), (-0.010, R - 0.007), (0.0, R - 0.007)]  # fmt: skip
    profile += [(-y, q) for y, q in profile[-2::-1]]
    mesh.add_mesh(revolve("rubber", profile, 48))
    side = Mesh()
    # Rim flange, dark well behind the spokes, brake disc.
    flange = [(0.040, 0.196), (0.082, 0.203), (0.094, 0.2075), (0.0955, 0.2145), (0.086, 0.2185)]
    side.add_mesh(revolve("rim_machined", flange[1:][::-1], 48))
    side.add_mesh(revolve("rim_dark", [(0.083, 0.203), (0.030, 0.194)], 40))
    side.add_mesh(wheel_face("rim_shadow", Point(0, 0).buffer(0.197, quad_segs=10), 0.030))
    side.add_mesh(wheel_face("disc", Point(0, 0).buffer(0.140, quad_segs=8), 0.034))
    # Five double spokes: dark flanks, bright faces.
    face_y = 0.078
    for k in range(5):
        c = 72.0 * k + 90
        for s in (-1.0, 1.0):
            arm = Polygon(
                [
                    polar(0.050, c + s * 2),
                    polar(0.050, c + s * 30),
                    polar(0.12, c + s * 15.5),
                    polar(0.2045, c + s * 18.5),
                    polar(0.2045, c + s * 10.5),
                    polar(0.12, c + s * 5.5),
                ]
            )
            side.add_mesh(wheel_face("rim_machined", arm.buffer(-0.0035, join_style="mitre"), face_y))
            side.add_mesh(wheel_face("rim_dark", arm, face_y - 0.003, 0.030))
        web = sector(0.045, 0.105, c - 8, c + 8)
        side.add_mesh(wheel_face("rim_dark", web, face_y - 0.012, 0.015))
    hub = Point(0, 0).buffer(0.062, quad_segs=8)
    side.add_mesh(wheel_face("rim_dark", hub, face_y + 0.001, 0.03))
    for k in range(5):
        x, z = polar(0.047, 72.0 * k + 54)
        side.add_mesh(wheel_face("rim_shadow", Point(x, z).buffer(0.008, quad_segs=3), face_y + 0.002))
    side.add_mesh(wheel_face("chrome", Point(0, 0).buffer(0.034, quad_segs=8), face_y + 0.006, 0.006, "rim_dark"))
    side.add_mesh(wheel_face("accent", Point(0, 0).buffer(0.029, quad_segs=8), face_y + 0.008, 0.003))
    side.add_mesh(wheel_face("plate", sector(0.004, 0.024, 60, 120, 5), face_y + 0.009))
    # Valve between two spokes, marks on the tyre's flank.
    side.add_mesh(wheel_face("valve", Point(polar(0.186, 54)).buffer(0.010, quad_segs=4), 0.070, 0.04))
    for start, end in ((70.0, 110.0), (250.0, 290.0)):
        steps = np.linspace(start, end, 9)
        for a, b in zip(steps[:-1:2], steps[1::2], strict=True):
            side.add_mesh(wheel_face("rubber_mark", sector(0.278, 0.286, float(a), float(b), 4), h + 0.0008))
    mesh.add_mesh(side)
    mesh.add_mesh(side.mirrored())
    return mesh


def main() -> None:
    """Writes both meshes next to this file."""
    here = Path(__file__).resolve().parent
    for name, mesh in (("wheel", build_wheel()), ("body", build_body())):
        count = mesh.write(here / f"{name}.gltf")
        size = sum((here / f"{name}{suffix}").stat().st_size for suffix in (".gltf", ".bin"))
        corners = np.concatenate([t.reshape(-1, 3) for chunks in mesh.parts.values() for t, _ in chunks])
        low, high = corners.min(axis=0).round(3).tolist(), corners.max(axis=0).round(3).tolist()
        print(f"{name}: {count} triangles, {size / 1e3:.0f} kB, from {low} to {high}")


if __name__ == "__main__":
    main()
