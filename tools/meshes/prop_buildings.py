"""Buildings: a house, a shop, a city block. Fronts look along x."""

from __future__ import annotations

import numpy as np
import shapely
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry

from mirdrake.vehicles.bodywork.mesh import Mesh
from tools.meshes.prop_shapes import Layer, box, drawn, extrude, lettering, turned, window, with_holes

Rect = tuple[float, float, float, float]


def _slab(material: str, x: tuple[float, float], y: tuple[float, float], z: float, up: float = 1.0) -> Mesh:
    """Return a level rectangle that faces up or down."""
    mesh = Mesh()
    p = np.array([[x[0], y[0], z], [x[1], y[0], z], [x[1], y[1], z], [x[0], y[1], z]])
    mesh.add_flat(material, p[[[0, 1, 2], [0, 2, 3]]], (0, 0, up))
    return mesh


# --- house -------------------------------------------------------------------------------------------------------

HOUSE = (8.0, 10.0, 5.2, 7.4)  # [m] walls along x and y, height of the eaves, of the ridge; the ridge is along y
OVERHANG = 0.45  # [m] of the roof


def make_house() -> Mesh:
    """Return a two-storey family house with a gable roof, door and porch in front, a chimney."""
    mesh = Mesh()
    deep, wide, eaves, ridge = HOUSE
    hx, hy = deep / 2, wide / 2
    base = 0.45
    door: Rect = (-0.55, 0.30, 0.55, 2.45)
    low = [(-4.0, 1.05, -2.0, 2.40), (2.0, 1.05, 4.0, 2.40)]
    high = [(-3.7, 3.45, -2.3, 4.70), (-0.7, 3.45, 0.7, 4.70), (2.3, 3.45, 3.7, 4.70)]

    def wall(half: float, rects: list[Rect], gable: bool, entrance: Rect | None = None) -> Mesh:
        side = Mesh()
        shape = shapely.box(-half, base, half, eaves)
        if gable:
            shape = Polygon([(-half, base), (half, base), (half, eaves), (0, ridge), (-half, eaves)])
        holes = rects + ([entrance] if entrance else [])
        side.add_mesh(drawn([("paint", with_holes(shape, holes))]))
        plinth = shapely.box(-half, 0.0, half, base)
        side.add_mesh(drawn([("plinth", with_holes(plinth, [entrance] if entrance else []))]))
        for rect in rects:
            panes = (2, 2) if rect[2] - rect[0] < 1.7 else (3, 2)
            side.add_mesh(window(rect, 0.12, wall="trim", frame="trim", glass="window", panes=panes, sill="trim"))
            y0, z0, y1, z1 = rect
            frame = shapely.box(y0 - 0.11, z0 - 0.02, y1 + 0.11, z1 + 0.13)
            side.add_mesh(extrude("trim", frame.difference(shapely.box(*rect)), 0.0, 0.03, ends="front"))
        return side

    front = wall(hy, [*low, *high], False, door)
    y0, z0, y1, z1 = door
    front.add_mesh(window(door, 0.15, wall="trim", frame="door", glass="door", border=0.0, bar=0.0))
    for a, b in ((0.55, 1.15), (1.30, 1.90)):
        for left, right in ((y0 + 0.14, -0.05), (0.05, y1 - 0.14)):
            middle = (-0.145, (left + right) / 2, z0 + (a + b) / 2 - 0.27)
            front.add_mesh(box("door_panel", (0.03, right - left, b - a), middle, 0.01))
    front.add_mesh(box("window", (0.03, 0.70, 0.22), (-0.145, 0, z1 - 0.20)))
    front.add_mesh(box("brass", (0.07, 0.05, 0.05), (-0.10, y1 - 0.10, 1.30), 0.012))
    surround = shapely.box(y0 - 0.14, z0, y1 + 0.14, z1 + 0.16).difference(shapely.box(*door))
    front.add_mesh(extrude("trim", surround, 0.0, 0.04, ends="front"))
    for k in range(2):  # steps
        front.add_mesh(box("plinth", (0.9 - 0.4 * k, 2.2, 0.15), (0.45 - 0.2 * k, 0, 0.075 + 0.15 * k)))
    front.add_mesh(box("trim", (1.0, 2.3, 0.10), (0.5, 0, 2.86)))  # a roof over the door on two posts
    for y in (-1.02, 1.02):
        front.add_mesh(box("trim", (0.10, 0.10, 2.81), (0.85, y, 1.405)))
    front.add_mesh(box("roof", (1.1, 2.4, 0.06), (0.52, 0, 2.94)))
    mesh.add_mesh(turned(front, 0.0, (hx, 0, 0)))
    rear = [(-3.9, 1.05, -2.5, 2.40), (-0.9, 1.05, 0.9, 2.40), (2.4, 1.05, 3.8, 2.40)]
    mesh.add_mesh(turned(wall(hy, [*rear, *high], False), np.pi, (-hx, 0, 0)))
    gable = [(-2.6, 1.05, -1.2, 2.40), (1.2, 1.05, 2.6, 2.40), (-0.6, 3.45, 0.6, 4.70)]
    for angle, y in ((np.pi / 2, hy), (-np.pi / 2, -hy)):
        mesh.add_mesh(turned(wall(hx, gable, True), angle, (0, y, 0)))
    # The roof: two slabs with overhang, and a chimney.
    slope = (ridge - eaves) / hx
    thick, reach = 0.16, hx + OVERHANG
    drop = slope * OVERHANG
    section = Polygon([(-reach, eaves - drop), (0, ridge), (reach, eaves - drop), (reach, eaves - drop + thick),
                       (0, ridge + thick), (-reach, eaves - drop + thick)])  # fmt: skip
    roof = extrude("trim", section, -hy - OVERHANG, hy + OVERHANG, sides="roof")
    mesh.add_mesh(turned(roof, np.pi / 2))
    courses, n = 13, np.array([slope, 0.0, 1.0]) / np.hypot(slope, 1.0)
    for sign in (-1.0, 1.0):  # courses of shingles: narrow steps along the roof
        for k in range(1, courses):
            x = reach * k / courses
            z = ridge + thick - slope * x
            p = np.array([sign * x, 0.0, z])
            m = n * np.array([sign, 1.0, 1.0])
            down = np.array([sign, 0.0, -slope]) / np.hypot(slope, 1.0)
            quad = np.array([[p + s * np.array([0, hy + OVERHANG, 0]) + d for s in (-1, 1)]
                             for d in (-0.10 * down + 0.002 * m, 0.018 * m)])  # fmt: skip
            mesh.add_flat("roof", quad.reshape(4, 3)[[[0, 1, 2], [1, 3, 2]]], m.tolist())
            step = np.array([quad[1], quad[1] - 0.016 * m + 0.035 * down]).reshape(4, 3)  # is seen from above too
            out = (0.035 * m + 0.016 * down) / np.hypot(0.035, 0.016)
            mesh.add_flat("roof_dark", step[[[0, 1, 2], [1, 3, 2]]], out.tolist())
    mesh.add_mesh(box("roof_dark", (0.30, wide + 2 * OVERHANG, 0.07), (0, 0, ridge + thick), 0.02))
    mesh.add_mesh(box("brick", (0.75, 0.95, 2.0), (-1.6, 2.7, 7.15)))
    mesh.add_mesh(box("plinth", (0.87, 1.07, 0.10), (-1.6, 2.7, 8.10)))
    for y in (2.5, 2.9):
        mesh.add_mesh(box("pot", (0.24, 0.24, 0.25), (-1.6, y, 8.26), 0.03))
    return mesh


# --- shop --------------------------------------------------------------------------------------------------------

SHOP = (9.0, 12.0, 4.6)  # [m] along x without the awning, along y, high
AWNING = (1.1, 2.72, 3.22)  # [m] its projection, its lower and its upper edge


def make_thrift_store() -> Mesh:
    """Return a shop on one floor: two wide windows with goods behind them, a door, an awning, a board with its name."""
    mesh = Mesh()
    deep, wide, high = SHOP
    hx, hy = deep / 2, wide / 2
    panes: list[Rect] = [(-5.2, 0.60, -1.35, 2.60), (1.35, 0.60, 5.2, 2.60)]
    door: Rect = (-0.95, 0.0, 0.95, 2.60)
    front = Mesh()
    board = shapely.box(-5.0, 3.36, 5.0, 4.26)
    shape = shapely.box(-hy, 0.0, hy, high - 0.15)
    piers = shape.difference(shapely.box(-hy + 0.45, 0.0, hy - 0.45, high))
    base = shapely.box(-hy, 0.0, hy, 0.35)
    layers: list[Layer] = [("paint", shape), ("brick", piers), ("plinth", base)]
    cut = shapely.union_all([shapely.box(*rect) for rect in (*panes, door)])
    front.add_mesh(drawn([(name, part.difference(cut)) for name, part in layers]))
    for rect in panes:
        y0, z0, y1, z1 = rect
        hole = shapely.box(*rect)
        front.add_mesh(_inside(hole, 0.7))
        goods: list[Layer] = [("shop_dark", hole), ("shop_light", shapely.box(y0, z1 - 0.45, y1, z1))]
        colours = ("goods_teal", "goods_red", "goods_cream", "goods_navy", "goods_mustard")
        rail = z0 + 1.45
        goods.append(("shop_light", shapely.box(y0 + 0.25, rail, y1 - 0.25, rail + 0.04)))
        for k in range(11):  # clothes on a rail
            y = y0 + 0.35 + k * (y1 - y0 - 0.7) / 11
            drop = (0.85, 0.70, 0.95, 0.62)[k * 3 % 4]
            dress = Polygon([(y + 0.07, rail), (y + 0.17, rail), (y + 0.25, rail - drop), (y - 0.01, rail - drop)])
            goods.append((colours[(3 * k + (2 if y0 > 0 else 0)) % 5], dress))
        front.add_mesh(drawn(goods, -0.7))
        shelf = box("shop_light", (0.6, y1 - y0, 0.06), (-0.38, (y0 + y1) / 2, z0 + 0.03))
        front.add_mesh(shelf)
        for k in range(5):  # boxes, a vase, a lamp, books on the shelf
            y = y0 + 0.45 + k * (y1 - y0 - 0.9) / 4
            size = ((0.30, 0.34, 0.26), (0.22, 0.22, 0.42), (0.26, 0.50, 0.18), (0.20, 0.24, 0.36), (0.3, 0.3, 0.3))[k]
            colour = colours[(k + (1 if y0 > 0 else 3)) % 5]
            front.add_mesh(box(colour, size, (-0.36, y, z0 + 0.06 + size[2] / 2), 0.03))
        frame = hole.difference(hole.buffer(-0.07, join_style="mitre"))
        bars = [shapely.box(y - 0.03, z0, y + 0.03, z1) for y in (y0 + (y1 - y0) / 3, y0 + 2 * (y1 - y0) / 3)]
        frame = shapely.union_all([frame, *bars])
        front.add_mesh(extrude("frame", frame, -0.10, -0.02))
    leaf = shapely.box(*door)
    front.add_mesh(_inside(leaf, 0.25, "frame"))
    door_layers: list[Layer] = [("frame", leaf), ("window", shapely.box(-0.80, 2.20, 0.80, 2.52)),
                                ("window", shapely.box(-0.80, 0.32, -0.09, 2.05)),
                                ("window", shapely.box(0.09, 0.32, 0.80, 2.05)),
                                ("goods_cream", shapely.box(0.25, 1.38, 0.64, 1.62))]  # fmt: skip
    front.add_mesh(drawn(door_layers, -0.25))
    for y in (-0.14, 0.14):
        front.add_mesh(box("steel", (0.05, 0.03, 0.55), (-0.21, y, 1.10), 0.008))
    # The board and its name.
    front.add_mesh(extrude("sign_edge", board.buffer(0.06, join_style="mitre"), 0.0, 0.10, ends="none"))
    word = lettering("THRIFT STORE", 0.60, width=0.66, pen=0.20, gap=0.30)
    rim = board.buffer(0.06, join_style="mitre")
    front.add_mesh(drawn([("sign_edge", rim), ("sign_board", board)], 0.10))
    front.add_mesh(extrude("sign_letter", word, 0.10, 0.14, ends="front", sides="sign_edge"), None, (0, 0, 3.81))
    # The awning in stripes.
    out, low, up = AWNING
    count, half = 22, 5.55
    pitch = 2 * half / count
    slope = np.array([up - low - 0.12, 0.0, out])
    slope /= np.linalg.norm(slope)
    for k in range(count):
        a, b = -half + k * pitch, -half + (k + 1) * pitch
        name = ("awning", "awning_white")[k % 2]
        quad = np.array([[0.0, a, up], [0.0, b, up], [out, b, low + 0.20], [out, a, low + 0.20]])
        front.add_flat(name, quad[[[0, 1, 2], [0, 2, 3]]], slope.tolist())
        front.add_flat("awning_under", (quad - [0, 0, 0.01])[[[0, 1, 2], [0, 2, 3]]], (-slope).tolist())
        t = np.linspace(0, np.pi, 7)
        hem = np.stack([(a + b) / 2 - pitch / 2 * np.cos(t), low + 0.10 - 0.10 * np.sin(t)], axis=1)
        scallop = Polygon([(a, low + 0.20), *hem.tolist(), (b, low + 0.20)])
        front.add_mesh(drawn([(name, scallop)], out))
        front.add_mesh(drawn([("awning_under", scallop)], out - 0.01, facing=-1.0))
    for y in (-half, half):
        side = np.array([[[0.0, y, up], [out, y, low + 0.20], [0.0, y, low + 0.20]]])
        front.add_flat("awning", side, (0, np.sign(y), 0))
        front.add_flat("awning_under", side - [0, 0.01 * np.sign(y), 0], (0, -np.sign(y), 0))
    mesh.add_mesh(turned(front, 0.0, (hx, 0, 0)))
    # The other sides: brick with a door at the rear and small windows.
    blank = shapely.box(-hy, 0.35, hy, high - 0.15)
    back: Rect = (2.8, 0.0, 3.9, 2.2)
    small: list[Rect] = [(-4.2, 2.2, -3.0, 2.9), (-1.6, 2.2, -0.4, 2.9)]
    rear = Mesh()
    rear.add_mesh(drawn([("brick", with_holes(blank, [back, *small])), ("plinth", with_holes(base, [back]))]))
    rear.add_mesh(window(back, 0.10, wall="brick", frame="frame", glass="door", border=0.06))
    for rect in small:
        rear.add_mesh(window(rect, 0.12, wall="brick", frame="frame", glass="window", border=0.06, sill="plinth"))
    mesh.add_mesh(turned(rear, np.pi, (-hx, 0, 0)))
    for angle, y in ((np.pi / 2, hy), (-np.pi / 2, -hy)):
        sides: list[Rect] = [(-1.8, 1.5, -0.4, 2.6), (0.8, 1.5, 2.2, 2.6)]
        flank = Mesh()
        flank.add_mesh(drawn([("brick", with_holes(shapely.box(-hx, 0.35, hx, high - 0.15), sides)),
                              ("plinth", shapely.box(-hx, 0, hx, 0.35))]))  # fmt: skip
        for rect in sides:
            flank.add_mesh(window(rect, 0.12, wall="brick", frame="frame", glass="window", panes=(2, 1), sill="plinth"))
        mesh.add_mesh(turned(flank, angle, (0, y, 0)))
    _parapet(mesh, hx, hy, high, 0.45, "roof_flat", "plinth", "brick")
    mesh.add_mesh(box("steel", (1.6, 2.0, 0.9), (-1.2, 2.6, high + 0.0), 0.05))  # air conditioner on the roof
    mesh.add_mesh(box("frame", (1.2, 1.6, 0.04), (-1.2, 2.6, high + 0.45), 0.01))
    return mesh


def _inside(hole: BaseGeometry, depth: float, material: str = "shop_dark") -> Mesh:
    """Return the sides of an opening, seen from within."""
    sides = extrude(material, hole, -depth, 0.0, ends="none")
    return sides.transformed(lambda p: p, lambda _, n: -n)


def _parapet(mesh: Mesh, hx: float, hy: float, high: float, depth: float, roof: str, cap: str, inner: str) -> None:
    """A flat roof behind a parapet whose coping is flush: the walls' box is that of the building."""
    t = 0.25
    mesh.add_mesh(_slab(roof, (-hx + t, hx - t), (-hy + t, hy - t), high - depth))
    ring = shapely.box(-hx, -hy, hx, hy).difference(shapely.box(-hx + t, -hy + t, hx - t, hy - t))
    rotation = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])  # x (drawn along) up; (y, z) to (y, -x)
    coping = extrude(cap, shapely.affinity.affine_transform(ring, [0, 1, -1, 0, 0, 0]), high - 0.15, high)
    mesh.add_mesh(coping, rotation)
    well = shapely.affinity.affine_transform(shapely.box(-hx + t, -hy + t, hx - t, hy - t), [0, 1, -1, 0, 0, 0])
    sides = extrude(inner, well, high - depth, high - 0.15, ends="none")
    mesh.add_mesh(sides.transformed(lambda p: p, lambda _, n: -n), rotation)


# --- city block --------------------------------------------------------------------------------------------------

BUILDING = (20.0, 12.0, 13.0)  # [m]


def make_building() -> Mesh:
    """Return a plain block of four storeys, alike from front and rear: shops below, windows in rows, a parapet."""
    mesh = Mesh()
    length, width, high = BUILDING
    ground, storey = 3.6, 2.9

    def side(half: float, bays: int, entrance: int) -> Mesh:
        face = Mesh()
        pitch = 2 * half / bays
        rects: list[tuple[Rect, str]] = []
        for k in range(bays):
            y = -half + (k + 0.5) * pitch
            if k == entrance:
                rects.append(((y - 0.75, 0.0, y + 0.75, 2.7), "door"))
            else:
                rects.append(((y - 0.36 * pitch, 0.65, y + 0.36 * pitch, 2.85), "shop"))
            for level in range(3):
                z = ground + level * storey + 0.75
                rects.append(((y - 0.6, z, y + 0.6, z + 1.6), "flat"))
        wall = shapely.box(-half, 0.0, half, high - 0.15)
        base = shapely.box(-half, 0.0, half, ground - 0.25)
        cut = shapely.union_all([shapely.box(*rect) for rect, _ in rects])
        face.add_mesh(drawn([("paint", wall.difference(base).difference(cut)), ("plinth", base.difference(cut))]))
        for rect, kind in rects:
            if kind == "flat":
                face.add_mesh(window(rect, 0.18, wall="paint", frame="trim", glass="window", panes=(2, 1)))
                y0, z0, y1, _ = rect
                face.add_mesh(box("trim", (0.03, y1 - y0 + 0.2, 0.09), (-0.0149, (y0 + y1) / 2, z0 - 0.045)))
            elif kind == "shop":
                face.add_mesh(window(rect, 0.20, wall="plinth", frame="frame", glass="window", panes=(2, 1)))
            else:
                entry = window(rect, 0.35, wall="plinth", frame="frame", glass="window", panes=(2, 1), border=0.12)
                face.add_mesh(entry)
        return face

    for angle, y in ((np.pi / 2, width / 2), (-np.pi / 2, -width / 2)):
        mesh.add_mesh(turned(side(length / 2, 8, 3), angle, (0, y, 0)))
    for angle, x in ((0.0, length / 2), (np.pi, -length / 2)):
        mesh.add_mesh(turned(side(width / 2, 4, -1), angle, (x, 0, 0)))
    _parapet(mesh, length / 2, width / 2, high, 0.75, "roof_flat", "trim", "paint")
    mesh.add_mesh(box("plinth", (3.2, 2.6, 0.58), (-4.0, 0.5, high - 0.46), 0.03))
    mesh.add_mesh(box("steel", (1.6, 1.2, 0.50), (4.5, -1.5, high - 0.50), 0.05))
    return mesh
