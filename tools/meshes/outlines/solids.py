"""Small solids: rounded boxes, prisms, tubes, licence plates."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from mirdrake.vehicles.bodywork.mesh import Mesh
from tools.meshes.outlines.curves import Array
from tools.meshes.outlines.regions import triangulate


def rot_y(angle: float) -> Array:
    """Return the rotation by an angle about y."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def rot_z(angle: float) -> Array:
    """Return the rotation by an angle about z."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def pillow(material: str, size: Sequence[float], sharp: float = 0.35, count: tuple[int, int] = (20, 11)) -> Mesh:
    """Return a superellipsoid (a box with rounded edges for small ``sharp``) of the given full size."""
    mesh = Mesh()
    a = np.linspace(0, 2 * np.pi, count[0] + 1)[:, None]
    b = np.linspace(-np.pi / 2, np.pi / 2, count[1])[None, :]

    def power(value: Array, e: float) -> Array:
        value = np.where(np.abs(value) < 1e-12, 0.0, value)
        result: Array = np.sign(value) * np.abs(value) ** e
        return result

    half = np.array(size) / 2
    ones = np.ones_like(a * b)
    p = np.stack([power(np.cos(a), sharp) * power(np.cos(b), sharp), power(np.sin(a), sharp) * power(np.cos(b), sharp),
                  power(np.sin(b), sharp) * ones], axis=-1)  # fmt: skip
    e = 2 - sharp
    n = np.stack([power(np.cos(a), e) * power(np.cos(b), e), power(np.sin(a), e) * power(np.cos(b), e),
                  power(np.sin(b), e) * ones], axis=-1) / half  # fmt: skip
    n /= np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), 1e-12)
    mesh.add_grid(material, p * half, n)
    return mesh


def prism(material: str, shape: BaseGeometry, depth: float) -> Mesh:
    """Return a plane shape (in y, z) extruded along x from 0 to ``depth``, with flat faces and edges."""
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


def tube(material: str, points: Sequence[Sequence[float]], radius: float, *, count: int = 12) -> Mesh:
    """Return a round bar along a polyline (its bends mitred), with flat ends."""
    mesh = Mesh()
    p = np.array(points, dtype=float)
    t = np.diff(p, axis=0)
    t /= np.linalg.norm(t, axis=1, keepdims=True)
    a = np.linspace(0, 2 * np.pi, count + 1)
    for i, along in enumerate(t):
        u = np.cross(along, [0.0, 1.0, 0.0] if abs(along[1]) < 0.9 else [0.3, 0.0, 1.0])
        u /= np.linalg.norm(u)
        v = np.cross(along, u)
        round_ = np.cos(a)[:, None] * u + np.sin(a)[:, None] * v
        ends = []
        for k in (i, i + 1):
            other = t[k - 1] if k == i else t[min(k, len(t) - 1)]
            cross = along + (other if 0 < k < len(p) - 1 else along)
            shift = -(round_ @ cross) / np.dot(along, cross)
            ends.append(p[k] + radius * (round_ + shift[:, None] * along))
        mesh.add_grid(material, np.stack(ends), np.stack([round_, round_]))
        for k, end, sign in ((0, 0, -1.0), (len(p) - 1, 1, 1.0)):
            if (k == i and end == 0) or (k == i + 1 and end == 1):
                ring = ends[end][:-1]
                fan = np.stack(
                    [np.broadcast_to(ring.mean(axis=0), ring.shape), ring, np.roll(ring, -1, axis=0)], axis=1
                )
                mesh.add_flat(material, fan, (sign * along).tolist())
    return mesh


_GLYPHS = {  # 3 x 5 dots a letter, row by row from the top
    letter: [f"{int(row):03b}" for row in rows]
    for letter, rows in {
        " ": "00000", "A": "25755", "B": "65656", "C": "34443", "D": "65556", "E": "74647", "F": "74644", "G": "34553",
        "H": "55755", "I": "72227", "J": "11152", "K": "55655", "L": "44447", "M": "57755", "N": "65555", "O": "75557",
        "P": "65644", "Q": "25563", "R": "65655", "S": "34216", "T": "72222", "U": "55557", "V": "55552", "W": "55775",
        "X": "55255", "Y": "55222", "Z": "71247", "0": "75557", "1": "26227", "2": "71747", "3": "71317", "4": "55711",
        "5": "74617", "6": "74757", "7": "71222", "8": "75757", "9": "75717", "-": "00700",
    }.items()
}  # fmt: skip


def plate(text: str) -> Mesh:
    """Return a licence plate that faces +x, with its text in block letters."""
    mesh = prism("plate_text", shapely.box(-0.262, -0.058, 0.262, 0.058), 0.008)
    mesh.add_mesh(prism("plate", shapely.box(-0.257, -0.053, 0.257, 0.053), 0.010))
    cell_y, cell_z = 0.0125, 0.0145
    width = (4 * len(text) - 1) * cell_y
    boxes = []
    for i, letter in enumerate(text):
        for row, bits in enumerate(_GLYPHS[letter]):
            for column, bit in enumerate(bits):
                if bit == "1":
                    y = (4 * i + column) * cell_y - width / 2
                    z = (2.5 - row) * cell_z
                    boxes.append(shapely.box(y, z - cell_z, y + cell_y, z))
    flat = triangulate(shapely.union_all(boxes))
    face = np.concatenate([np.full((*flat.shape[:2], 1), 0.0112), flat], axis=2)
    mesh.add_flat("plate_text", face, (1, 0, 0))
    return mesh
