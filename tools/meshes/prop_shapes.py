"""Shapes the props are made of: turned parts, chamfered boxes, drawn faces, openings, block letters, soft bodies.

Everything is in metres, z up. Colours that meet in a plane are cut out of each other, so that nothing flickers however
far away the camera is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise, product

import numpy as np
import shapely
from shapely.geometry import LineString
from shapely.geometry.base import BaseGeometry

from mirdrake.vehicles.bodywork.mesh import Mesh
from tools.meshes.outlines.curves import Array
from tools.meshes.outlines.regions import triangulate
from tools.meshes.outlines.wheels import revolve

UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # takes y up
LYING = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # takes y ahead
Layer = tuple[str, BaseGeometry]


def lathe(
    material: str, profile: Sequence[tuple[float, float]], count: int = 24, *, smooth: bool = True, start: float = 0.0
) -> Mesh:
    """Return a profile of (radius, z) points, from below upwards, turned about z; ``start`` is where it is closed."""
    mesh = Mesh()
    c, s = np.cos(start), np.sin(start)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    mesh.add_mesh(revolve(material, [(z, r) for r, z in profile], count, smooth=smooth), turn @ UPRIGHT)
    return mesh


def turned_ahead(
    material: str, profile: Sequence[tuple[float, float]], count: int = 24, *, smooth: bool = True
) -> Mesh:
    """Return a profile of (radius, x) points, from the rear ahead, turned about x."""
    mesh = Mesh()
    mesh.add_mesh(revolve(material, [(x, r) for r, x in profile], count, smooth=smooth), LYING)
    return mesh


def box(material: str, size: Sequence[float], position: Sequence[float], bevel: float = 0.0) -> Mesh:
    """Return a box of a full size about a point, its edges chamfered by ``bevel``."""
    mesh = Mesh()
    half = np.array(size, dtype=float) / 2
    centre = np.array(position, dtype=float)

    def corner(axis: int, signs: Sequence[float]) -> Array:
        inset = np.full(3, bevel)
        inset[axis] = 0.0
        point: Array = centre + np.array(signs) * (half - inset)
        return point

    for axis in range(3):
        b, c = (axis + 1) % 3, (axis + 2) % 3
        for sign in (-1.0, 1.0):
            ring = []
            for sb, sc in ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)):
                signs = np.zeros(3)
                signs[[axis, b, c]] = sign, sb, sc
                ring.append(corner(axis, signs.tolist()))
            normal = np.zeros(3)
            normal[axis] = sign
            mesh.add_flat(material, np.array(ring)[[[0, 1, 2], [0, 2, 3]]], normal.tolist())
            if not bevel:
                continue
            for other in (-1.0, 1.0):  # the chamfers between this side and those along b
                quad = []
                for sc in (-1.0, 1.0):
                    signs = np.zeros(3)
                    signs[[axis, b, c]] = sign, other, sc
                    quad += [corner(axis, signs.tolist()), corner(b, signs.tolist())]
                between = np.zeros(3)
                between[[axis, b]] = sign, other
                mesh.add_flat(material, np.array(quad)[[[0, 1, 3], [0, 3, 2]]], (between / np.sqrt(2)).tolist())
    if bevel:
        for signs_ in product((-1.0, 1.0), repeat=3):
            tip = np.array([[corner(axis, signs_) for axis in range(3)]])
            mesh.add_flat(material, tip, (np.array(signs_) / np.sqrt(3)).tolist())
    return mesh


def frustum(material: str, low: Sequence[Sequence[float]], high: Sequence[Sequence[float]]) -> Mesh:
    """Return the solid between two polygons of as many corners, both anticlockwise seen from above."""
    mesh = Mesh()
    a, b = np.array(low, dtype=float), np.array(high, dtype=float)
    middle = np.concatenate([a, b]).mean(axis=0)
    sides = [a, b] + [np.array([a[i - 1], a[i], b[i], b[i - 1]]) for i in range(len(a))]
    for side in sides:
        fan = np.array([[side[0], side[i], side[i + 1]] for i in range(1, len(side) - 1)])
        normal = np.cross(side[1] - side[0], side[2] - side[0])
        if np.linalg.norm(normal) < 1e-12:
            normal = np.cross(side[2] - side[0], side[-1] - side[0])
        normal = normal / max(float(np.linalg.norm(normal)), 1e-12)
        normal = normal if np.dot(normal, side.mean(axis=0) - middle) > 0 else -normal
        mesh.add_flat(material, fan, normal.tolist())
    return mesh


def extrude(
    material: str, shape: BaseGeometry, start: float, end: float, *, ends: str = "both", sides: str = ""
) -> Mesh:
    """Return a plane shape in (y, z), holes and all, drawn along x; ``ends`` is both, front, rear or none."""
    mesh = Mesh()
    flat = triangulate(shape)
    for x, sign, name in ((start, -1.0, "rear"), (end, 1.0, "front")):
        if ends in ("both", name):
            mesh.add_flat(material, np.concatenate([np.full((*flat.shape[:2], 1), x), flat], axis=2), (sign, 0.0, 0.0))
    for part in getattr(shape, "geoms", [shape]):
        part = shapely.geometry.polygon.orient(part)
        for ring in (part.exterior, *part.interiors):
            for a, b in pairwise(np.array(ring.coords)):
                t = (b - a) / max(float(np.linalg.norm(b - a)), 1e-12)
                quad = np.array([[start, *a], [start, *b], [end, *b], [end, *a]])
                mesh.add_flat(sides or material, quad[[[0, 1, 2], [0, 2, 3]]], (0.0, t[1], -t[0]))
    return mesh


def drawn(layers: Iterable[Layer], x: float = 0.0, *, facing: float = 1.0) -> Mesh:
    """Return plane shapes in (y, z) at ``x`` that face along x; a later one lies over the earlier ones."""
    mesh = Mesh()
    above: BaseGeometry = shapely.Polygon()
    for material, shape in reversed(list(layers)):
        flat = triangulate(shape.difference(above))
        above = above.union(shape)
        if len(flat):
            points = np.concatenate([np.full((*flat.shape[:2], 1), x), flat], axis=2)
            mesh.add_flat(material, points, (facing, 0.0, 0.0))
    return mesh


def turned(mesh: Mesh, angle: float, position: Sequence[float] = (0.0, 0.0, 0.0)) -> Mesh:
    """Return a mesh turned about z [rad], then moved."""
    c, s = round(float(np.cos(angle)), 12), round(float(np.sin(angle)), 12)
    result = Mesh()
    result.add_mesh(mesh, np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), position)
    return result


def window(
    rect: tuple[float, float, float, float], depth: float, *, wall: str, frame: str, glass: str, border: float = 0.07,
    panes: tuple[int, int] = (1, 1), bar: float = 0.05, sill: str = ""
) -> Mesh:  # fmt: skip
    """Return the filling of an opening (y, z, y, z) of a wall that faces +x at x = 0: reveals, frame, panes, a sill."""
    mesh = Mesh()
    y0, z0, y1, z1 = rect
    hole = shapely.box(*rect)
    mesh.add_mesh(inside_out(extrude(wall, hole, -depth, 0.0, ends="none")))
    inner = (y0 + border, z0 + border, y1 - border, z1 - border)
    wide, tall = (inner[2] - inner[0] + bar) / panes[0], (inner[3] - inner[1] + bar) / panes[1]
    layers: list[Layer] = [(frame, hole)]
    for i, j in product(range(panes[0]), range(panes[1])):
        y, z = inner[0] + i * wide, inner[1] + j * tall
        layers.append((glass, shapely.box(y, z, y + wide - bar, z + tall - bar)))
    mesh.add_mesh(drawn(layers, -depth))
    if sill:
        mesh.add_mesh(box(sill, (0.10 + depth, y1 - y0 + 0.16, 0.07), (0.05 - depth / 2, (y0 + y1) / 2, z0 - 0.035)))
    return mesh


def inside_out(mesh: Mesh) -> Mesh:
    """Return a mesh that is seen from the other side."""
    return mesh.transformed(lambda p: p, lambda _, n: -n)


def with_holes(shape: BaseGeometry, rects: Iterable[tuple[float, float, float, float]]) -> BaseGeometry:
    """Return a shape without rectangles (y, z, y, z)."""
    result: BaseGeometry = shape.difference(shapely.union_all([shapely.box(*rect) for rect in rects]))
    return result


# --- block letters -----------------------------------------------------------------------------------------------


def _arc(y: float, z: float, ry: float, rz: float, start: float, end: float) -> list[tuple[float, float]]:
    a = np.deg2rad(np.linspace(start, end, max(3, int(abs(end - start) / 15) + 1)))
    return list(zip((y + ry * np.cos(a)).tolist(), (z + rz * np.sin(a)).tolist(), strict=True))


def _letter(name: str, w: float, h: float) -> list[list[tuple[float, float]]]:
    """Return the pen's way of a letter in a box w × h."""
    q, m = h / 4, h / 2
    r = min(w / 2, q)
    bowl = [(0.0, h), (w - r, h), *_arc(w - r, h - q, r, q, 90, -90), (0.0, m)]
    strokes: dict[str, list[list[tuple[float, float]]]] = {
        "E": [[(w, h), (0, h), (0, 0), (w, 0)], [(0, m), (0.85 * w, m)]],
        "F": [[(w, h), (0, h), (0, 0)], [(0, m), (0.85 * w, m)]],
        "H": [[(0, 0), (0, h)], [(w, 0), (w, h)], [(0, m), (w, m)]],
        "I": [[(w / 2, 0), (w / 2, h)]],
        "O": [[*_arc(w - r, h - r, r, r, 0, 90), *_arc(r, h - r, r, r, 90, 180), *_arc(r, r, r, r, 180, 270),
               *_arc(w - r, r, r, r, 270, 360), (w, h - r)]],
        "P": [[(0, 0), *bowl]],
        "R": [[(0, 0), *bowl], [(0.45 * w, m), (w, 0)]],
        "S": [[*_arc(w / 2, h - q, w / 2, q, 25, 270), *_arc(w / 2, q, w / 2, q, 90, -155)]],
        "T": [[(w / 2, 0), (w / 2, h)], [(0, h), (w, h)]],
    }  # fmt: skip
    return strokes[name]


def lettering(text: str, height: float, *, width: float = 0.62, pen: float = 0.19, gap: float = 0.22) -> BaseGeometry:
    """Return words in block capitals about the origin in (y, z); widths are parts of the height."""
    cursor, shapes = 0.0, []
    for name in text:
        if name == " ":
            cursor += 0.42 * height
            continue
        wide = (pen if name == "I" else width) * height
        for stroke in _letter(name, max(wide - pen * height, 1e-9), (1 - pen) * height):
            points = [(cursor + pen * height / 2 + y, z - (1 - pen) * height / 2) for y, z in stroke]
            closed = len(points) > 3 and np.allclose(points[0], points[-1])
            line = shapely.LinearRing(points[:-1]) if closed else LineString(points)
            shapes.append(line.buffer(pen * height / 2, cap_style="flat" if name == "S" else "square",
                                      join_style="mitre", mitre_limit=2.0))  # fmt: skip
        cursor += wide + gap * height
    word = shapely.union_all(shapes)
    low, _, high, _ = word.bounds
    centred: BaseGeometry = shapely.affinity.translate(word, -(low + high) / 2, 0.0).simplify(1e-3 * height)
    clipped: BaseGeometry = centred.intersection(shapely.box(-1e3, -height / 2, 1e3, height / 2))
    return clipped


# --- soft bodies -------------------------------------------------------------------------------------------------

Field = Callable[[Array], Array]  # about the distance [m] at points (…, 3), negative inside


def ball(position: Sequence[float], radii: Sequence[float]) -> Field:
    """Return the field of an ellipsoid."""
    centre, r = np.array(position, dtype=float), np.array(radii, dtype=float)

    def field(p: Array) -> Array:
        k0 = np.linalg.norm((p - centre) / r, axis=-1)
        k1 = np.linalg.norm((p - centre) / r**2, axis=-1)
        result: Array = k0 * (k0 - 1.0) / np.maximum(k1, 1e-9)
        return result

    return field


def limb(points: Sequence[Sequence[float]], radii: Sequence[float], *, flat: float = 1.0) -> Field:
    """Return the field of a round bar along points with a radius at each; ``flat`` < 1 thins it along x."""
    scale = np.array([1.0 / flat, 1.0, 1.0])
    p_ = np.array(points, dtype=float) * scale

    def field(p: Array) -> Array:
        q = p * scale
        distance = np.full(q.shape[:-1], np.inf)
        for i in range(len(p_) - 1):
            a, along = p_[i], p_[i + 1] - p_[i]
            t = np.clip(((q - a) @ along) / float(along @ along), 0.0, 1.0)
            radius = radii[i] + t * (radii[i + 1] - radii[i])
            distance = np.minimum(distance, np.linalg.norm(q - a - t[..., None] * along, axis=-1) - radius)
        result: Array = distance * flat**0.5
        return result

    return field


def joined(fields: Sequence[Field], blend: float) -> Field:
    """Return the union of fields, the creases rounded."""

    def field(p: Array) -> Array:
        distance = fields[0](p)
        for other in fields[1:]:
            d = other(p)
            h = np.maximum(blend - np.abs(distance - d), 0.0) / blend
            distance = np.minimum(distance, d) - h * h * blend / 4
        return distance

    return field


def soft(material: str, field: Field, low: Sequence[float], high: Sequence[float], cell: float) -> Mesh:
    """Return the surface of a field in a box, by surface nets with cells of a size [m].

    Source: S. F. F. Gibson, Constrained Elastic Surface Nets (1998), without the relaxation: a corner lies at the mean
    of its cell's crossings, and is then moved onto the surface.
    """
    lo = np.array(low, dtype=float)
    counts = np.ceil((np.array(high) - lo) / cell).astype(int) + 1
    grid = np.stack(np.meshgrid(*[lo[i] + cell * np.arange(counts[i]) for i in range(3)], indexing="ij"), axis=-1)
    value = field(grid)
    value = np.where(np.abs(value) < 1e-9, 1e-9, value)
    inside = value < 0
    total = np.zeros((*(counts - 1), 3))
    number = np.zeros(counts - 1)
    for axis in range(3):
        b, c = [k for k in range(3) if k != axis]
        first = tuple(slice(None, -1) if k == axis else slice(None) for k in range(3))
        second = tuple(slice(1, None) if k == axis else slice(None) for k in range(3))
        t = value[first] / np.where(inside[first] == inside[second], 1.0, value[first] - value[second])
        cross = inside[first] != inside[second]
        point = np.where(cross[..., None], grid[first] + t[..., None] * (grid[second] - grid[first]), 0.0)
        for db, dc in product((0, 1), repeat=2):
            part = [slice(None)] * 3
            part[b] = slice(db, counts[b] - 1 + db)
            part[c] = slice(dc, counts[c] - 1 + dc)
            total += point[tuple(part)]
            number += cross[tuple(part)]
    used = number > 0
    vertices = total[used] / number[used][:, None]
    step = 1e-4

    def slope(p: Array) -> Array:
        columns = [(field(p + step * e) - field(p - step * e)) / (2 * step) for e in np.eye(3)]
        return np.stack(columns, axis=-1)

    for _ in range(3):
        g = slope(vertices)
        move = field(vertices)[:, None] * g / np.maximum((g * g).sum(-1, keepdims=True), 0.2)
        vertices = vertices - np.clip(move, -0.5 * cell, 0.5 * cell)
    index = np.full(counts - 1, -1)
    index[used] = np.arange(len(vertices))
    quads = []
    for axis in range(3):
        b, c = (axis + 1) % 3, (axis + 2) % 3
        first = tuple(slice(None, -1) if k == axis else slice(1, -1) for k in range(3))
        second = tuple(slice(1, None) if k == axis else slice(1, -1) for k in range(3))
        indices = np.argwhere(inside[first] != inside[second])
        indices[:, [b, c]] += 1
        around = []
        for db, dc in ((1, 1), (0, 1), (0, 0), (1, 0)):
            cellular = indices.copy()
            cellular[:, b] -= db
            cellular[:, c] -= dc
            around.append(index[tuple(cellular.T)])
        quads.append(np.stack(around, axis=1))
    q = np.concatenate(quads)
    normals = slope(vertices)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    faces = np.concatenate([q[:, [0, 1, 2]], q[:, [0, 2, 3]]])
    mesh = Mesh()
    mesh.add(material, vertices[faces], normals[faces])
    return mesh
