"""Generate the props: in each folder ``prop.yaml``, ``<name>.gltf`` with its ``.bin``, and solids as ``.obj``.

All shapes are made here and in the modules beside it; nothing is taken from elsewhere. The frame of a prop lies on the
ground below the centre of the box around it: x ahead, y left, z up. What has a front looks along x; a barrier, a wall
and a building are long along x.

Usage: ``python -m tools.meshes.props`` writes all props into ``models/props``, and with names
(``python -m tools.meshes.props cone van``) only those; the result is deterministic.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull

from mirdrake.vehicles.bodywork.mesh import MATERIALS, Material, Mesh
from tools.meshes import prop_buildings as buildings
from tools.meshes import prop_cars as cars
from tools.meshes import prop_cyclist as bicycles
from tools.meshes import prop_nature as nature
from tools.meshes import prop_street as street
from tools.meshes.outlines.curves import Array

COLOURS: dict[str, Material] = {
    "aluminium": Material((0.66, 0.67, 0.68), 0.55, 0.1),
    "awning": Material((0.78, 0.27, 0.22), 0.85),
    "awning_under": Material((0.50, 0.38, 0.34), 0.95),
    "awning_white": Material((0.95, 0.93, 0.88), 0.85),
    "bark": Material((0.36, 0.27, 0.20), 0.95),
    "base": Material((0.13, 0.13, 0.13), 0.9),
    "board": Material((0.06, 0.06, 0.065), 0.8),
    "brass": Material((0.80, 0.62, 0.25), 0.35, 0.3),
    "brick": Material((0.62, 0.35, 0.27), 0.95),
    "concrete": Material((0.66, 0.65, 0.62), 0.95),
    "door": Material((0.16, 0.30, 0.36), 0.5),
    "door_panel": Material((0.20, 0.37, 0.44), 0.5),
    "eye": Material((0.08, 0.06, 0.05), 0.4),
    "frame": Material((0.25, 0.27, 0.29), 0.5, 0.1),
    "goods_cream": Material((0.92, 0.86, 0.72), 0.8),
    "goods_mustard": Material((0.85, 0.63, 0.20), 0.8),
    "goods_navy": Material((0.20, 0.26, 0.42), 0.8),
    "goods_red": Material((0.70, 0.22, 0.20), 0.8),
    "goods_teal": Material((0.16, 0.50, 0.50), 0.8),
    "hair": Material((0.20, 0.13, 0.09), 0.7),
    "helmet": Material((0.93, 0.93, 0.90), 0.4),
    "hinge": Material((0.30, 0.25, 0.10), 0.6),
    "hollow": Material((0.05, 0.05, 0.05), 0.95),
    "leaf_dark": Material((0.18, 0.33, 0.11), 0.85),
    "leaf_light": Material((0.45, 0.60, 0.20), 0.8),
    "lens": Material((0.97, 0.96, 0.90), 0.3, 0.0, 0.5),
    "lips": Material((0.68, 0.42, 0.36), 0.7),
    "mortar": Material((0.50, 0.49, 0.47), 0.95),
    "plinth": Material((0.58, 0.56, 0.53), 0.95),
    "post": Material((0.47, 0.49, 0.50), 0.5, 0.15),
    "pot": Material((0.70, 0.40, 0.28), 0.9),
    "reflective": Material((0.93, 0.93, 0.92), 0.45),
    "roof": Material((0.43, 0.31, 0.28), 0.95),
    "roof_dark": Material((0.29, 0.20, 0.18), 0.95),
    "roof_flat": Material((0.38, 0.38, 0.39), 0.95),
    "shade": Material((0.12, 0.22, 0.07), 0.95),
    "shirt": Material((0.90, 0.90, 0.88), 0.9),
    "shoe": Material((0.33, 0.22, 0.15), 0.6),
    "shop_dark": Material((0.27, 0.24, 0.22), 0.9),
    "shop_light": Material((0.80, 0.76, 0.68), 0.8),
    "sign_board": Material((0.10, 0.32, 0.38), 0.6),
    "sign_edge": Material((0.90, 0.74, 0.36), 0.5),
    "sign_letter": Material((0.99, 0.96, 0.88), 0.6),
    "sign_red": Material((0.80, 0.03, 0.06), 0.7),
    "sign_white": Material((0.96, 0.96, 0.95), 0.7),
    "sign_yellow": Material((0.98, 0.80, 0.10), 0.5),
    "signal_amber": Material((0.62, 0.40, 0.05), 0.3),
    "signal_green": Material((0.04, 0.42, 0.24), 0.3),
    "signal_red": Material((1.00, 0.10, 0.07), 0.3, 0.0, 1.0),
    "skin": Material((0.80, 0.60, 0.48), 0.7),
    "sole": Material((0.12, 0.10, 0.09), 0.9),
    "steel": Material((0.66, 0.68, 0.69), 0.5, 0.15),
    "trim": Material((0.93, 0.93, 0.91), 0.7),
    "trousers": Material((0.24, 0.26, 0.31), 0.9),
    "window": Material((0.20, 0.28, 0.34), 0.2),
}


# --- solids ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Solid:
    """A line of ``solids`` in prop.yaml: numbers [m], and angles [deg] about x and y."""

    kind: str
    sizes: tuple[float, ...] = ()
    at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    roll: float = 0.0
    pitch: float = 0.0
    file: str = ""
    points: Array = field(default_factory=lambda: np.zeros((0, 3)))

    def moved(self, shift: Array) -> Solid:
        """Return the solid at another position."""
        x, y, z = (np.array(self.at) + shift).tolist()
        return Solid(self.kind, self.sizes, (x, y, z), self.roll, self.pitch, self.file, self.points + shift)

    def line(self) -> str:
        """Its line in prop.yaml."""
        if self.kind == "convex":
            return f"  - {{convex: {self.file}}}"
        angles = "".join(f', {name}: "{_number(value)} deg"' for name, value in
                         (("roll", self.roll), ("pitch", self.pitch)) if value)  # fmt: skip
        return f"  - {{{self.kind}: {_numbers(self.sizes)}, at: {_numbers(self.at)}{angles}}}"


def block(low: Sequence[float], high: Sequence[float]) -> Solid:
    """Return a box between two corners."""
    a, b = np.array(low, dtype=float), np.array(high, dtype=float)
    x, y, z = ((a + b) / 2).tolist()
    return Solid("box", tuple((b - a).tolist()), (x, y, z))


def column(radius: float, low: float, high: float, x: float = 0.0, y: float = 0.0) -> Solid:
    """Return an upright cylinder between two heights."""
    return Solid("cylinder", (radius, high - low), (x, y, (low + high) / 2))


def bar(radius: float, start: Sequence[float], end: Sequence[float]) -> Solid:
    """Return a cylinder between two points of a plane across x."""
    a, b = np.array(start, dtype=float), np.array(end, dtype=float)
    x, y, z = ((a + b) / 2).tolist()
    roll = float(np.rad2deg(np.arctan2(a[1] - b[1], b[2] - a[2])))
    return Solid("cylinder", (radius, float(np.linalg.norm(b - a))), (x, y, z), roll=roll)


def hull(file: str, points: Array) -> Solid:
    """Return the hull of points."""
    return Solid("convex", file=file, points=np.array(points, dtype=float))


def ring(radius: float, z: float, count: int = 16) -> Array:
    """Return points (n, 3) of a level circle."""
    a = 2 * np.pi * np.arange(count) / count
    return np.stack([radius * np.cos(a), radius * np.sin(a), np.full(count, z)], axis=1)


def drawn_along(profile: Sequence[tuple[float, float]], axis: int, half: float) -> Array:
    """Return the corners (n, 3) of a profile drawn along x (its points are y, z) or along y (x, z)."""
    other = 1 - axis
    vertices = np.zeros((2 * len(profile), 3))
    for k, (across, z) in enumerate(profile):
        for j, sign in enumerate((-1.0, 1.0)):
            vertices[2 * k + j, [axis, other, 2]] = sign * half, across, z
    return vertices


def support(points: Array, count: int = 160) -> Array:
    """Return those of points (n, 3) that lie farthest in each of many directions, in a frame where they fill a cube."""
    z = 1.0 - 2.0 * (np.arange(count) + 0.5) / count
    a = np.pi * (1.0 + 5.0**0.5) * np.arange(count)
    level = np.sqrt(1.0 - z**2)
    directions = np.stack([level * np.cos(a), level * np.sin(a), z], axis=1)
    directions = np.concatenate([directions, np.eye(3), -np.eye(3)])
    farthest = np.unique(np.argmax(points / np.ptp(points, axis=0) @ directions.T, axis=0))
    corners: Array = np.unique(points[farthest].round(4), axis=0)
    return corners


def write_hull(path: Path, points: Array) -> None:
    """Write the hull of points as an OBJ file, its faces outwards."""
    corners = points.round(4)
    shape = ConvexHull(corners)
    used = np.unique(shape.simplices)
    number = {int(old): new + 1 for new, old in enumerate(used)}
    faces = []
    for simplex, equation in zip(shape.simplices, shape.equations, strict=True):
        a, b, c = (int(k) for k in simplex)
        turn = np.cross(corners[b] - corners[a], corners[c] - corners[a]) @ equation[:3]
        face = [number[k] for k in ((a, b, c) if turn > 0 else (a, c, b))]
        first = face.index(min(face))
        faces.append(tuple(face[first:] + face[:first]))
    lines = ["# convex, in metres, z up"]
    lines += ["v " + " ".join(_number(float(value)) for value in corners[k]) for k in used]
    lines += ["f {} {} {}".format(*face) for face in sorted(faces)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _number(value: float) -> str:
    return f"{round(value, 4) + 0.0:.4f}".rstrip("0").rstrip(".")


def _numbers(values: Sequence[float]) -> str:
    return "[" + ", ".join(_number(value) for value in values) + "]"


# --- the props ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Prop:
    """A prop as it is made; see prop.yaml for the rest."""

    description: str
    source: str
    mass: float
    make: Callable[[], Mesh]
    solids: Callable[[Mesh], list[Solid]]
    paint: Material | None = None
    mu: float = 0.6
    resizable: bool = False
    driven_over: bool = False


def cone_solids(_: Mesh) -> list[Solid]:
    """Return the base, and the cone itself."""
    return [
        block((-0.185, -0.185, 0.0), (0.185, 0.185, 0.029)),
        hull("cone.obj", np.concatenate([ring(0.131, 0.029), ring(0.030, 0.7112)])),
    ]


def barrel_solids(_: Mesh) -> list[Solid]:
    """Return the ring of rubber, and the drum in two steps."""
    return [column(0.305, 0.0, 0.08), column(0.257, 0.08, 0.45), column(0.240, 0.45, 0.87)]


def jersey_solids(_: Mesh) -> list[Solid]:
    """Return the foot and the stem."""
    p = street.JERSEY
    return [
        hull("foot.obj", drawn_along([p[0], p[1], p[2], p[3], p[6], p[7]], 0, 1.525)),
        hull("stem.obj", drawn_along([p[3], p[4], p[5], p[6]], 0, 1.525)),
    ]


def stop_solids(_: Mesh) -> list[Solid]:
    """Return the post and the plate."""
    face, rear, half, top, middle = street.STOP
    corners = np.array(street.octagon(30 * street.INCH).exterior.coords)[:-1]
    plate = [[x, y, z + middle] for x in (face - 0.006, face) for y, z in corners]
    return [block((rear - 2 * half, -half, 0.0), (rear, half, top)), hull("plate.obj", np.array(plate))]


def signal_solids(_: Mesh) -> list[Solid]:
    """Return the foot, the post, the head, the back plate, three visors."""
    low, section, deep, wide = street.SIGNAL
    high = low + 3 * section
    return [
        block((-0.18, -0.18, 0.0), (0.18, 0.18, 0.04)),
        column(0.12, 0.04, 0.38),
        column(0.058, 0.38, low),
        block((-deep / 2, -wide / 2, low), (deep / 2, wide / 2, high)),
        block((0.025, -0.30, low - 0.125), (0.045, 0.30, high + 0.125)),
        *[Solid("cylinder", (0.163, 0.22), (deep / 2 + 0.11, 0.0, low + (k + 0.5) * section), pitch=90.0)
          for k in range(3)],
    ]  # fmt: skip


def person_solids(_: Mesh) -> list[Solid]:
    """Feet, legs, trunk with arms, head."""
    return [
        block((-0.10, -0.165, 0.0), (0.18, 0.165, 0.09)),
        column(0.075, 0.09, 0.86, 0.0, 0.095),
        column(0.075, 0.09, 0.86, 0.0, -0.095),
        block((-0.115, -0.18, 0.83), (0.115, 0.18, 1.33)),
        block((-0.09, -0.15, 1.33), (0.07, 0.15, 1.43)),
        bar(0.048, (-0.012, 0.265, 0.78), (-0.012, 0.195, 1.37)),
        bar(0.048, (-0.012, -0.265, 0.78), (-0.012, -0.195, 1.37)),
        column(0.088, 1.43, 1.745),
    ]


def cyclist_solids(mesh: Mesh) -> list[Solid]:
    """Return the wheels, the saddle, the handlebar, the frame, and the rider in hulls: legs, trunk, arms, head."""
    wheels = [bar(bicycles.WHEEL, (x, -0.03, bicycles.WHEEL), (x, 0.03, bicycles.WHEEL)) for x in bicycles.AXLES]
    frame = mesh.corners("frame")
    frame = frame[np.abs(frame[:, 1]) < 0.08]
    legs, trunk, head = mesh.corners("trousers", "shoe"), mesh.corners("paint"), mesh.corners("helmet", "skin")
    arms = np.concatenate([trunk, mesh.corners("skin")])
    arms = arms[arms[:, 2] < 1.52]
    parts = {
        "frame": frame,
        "left_leg": legs[legs[:, 1] > 0.0],
        "right_leg": legs[legs[:, 1] < 0.0],
        "trunk": trunk[np.abs(trunk[:, 1]) < 0.16],
        "left_arm": arms[arms[:, 1] > 0.14],
        "right_arm": arms[arms[:, 1] < -0.14],
        "head": head[head[:, 2] > 1.40],
    }
    hulls = [hull(f"{name}.obj", support(points, 60)) for name, points in parts.items()]
    saddle, handlebar = (
        block((-0.38, -0.065, 0.94), (-0.12, 0.065, 1.0)),
        block((0.26, -0.285, 1.0), (0.385, 0.285, 1.05)),
    )
    return [*wheels, saddle, handlebar, *hulls]


def _car_solids(wheel: tuple[float, float, float, float], belt: float, half: float) -> Callable[[Mesh], list[Solid]]:
    """The lower body, the cabin, the wheels (radius, width, wheelbase, track); mirrors stand out of ``half`` width."""
    radius, width, wheelbase, track = wheel

    def solids(mesh: Mesh) -> list[Solid]:
        names = [name for name in mesh.parts if not name.startswith(("rim", "rubber", "disc"))]
        p = mesh.corners(*names)
        p = p[np.abs(p[:, 1]) <= half + 1e-3]
        low, high = p[p[:, 2] <= belt + 0.06], p[p[:, 2] >= belt - 0.14]
        body_solids = [hull("body.obj", support(low)), hull("cabin.obj", support(high))]
        for x in (0.0, wheelbase):
            for side in (-1.0, 1.0):
                y = side * track / 2
                body_solids.append(bar(radius, (x, y - width / 2, radius), (x, y + width / 2, radius)))
        return body_solids

    return solids


def tree_solids(_: Mesh) -> list[Solid]:
    """Return the trunk, and the crown in three steps."""
    return [column(0.20, 0.0, 3.0), column(2.15, 3.0, 5.0), column(1.70, 5.0, 6.15), column(0.85, 6.15, 6.85)]


def house_solids(_: Mesh) -> list[Solid]:
    """Return the walls, the roof, the chimney, the steps, the porch."""
    deep, wide, eaves, ridge = buildings.HOUSE
    over = buildings.OVERHANG
    reach = deep / 2 + over
    low = eaves - over * (ridge - eaves) / (deep / 2)
    section = [(-reach, low), (reach, low), (reach, low + 0.17), (0.0, ridge + 0.17), (-reach, low + 0.17)]
    porch = deep / 2
    return [
        block((-deep / 2, -wide / 2, 0.0), (deep / 2, wide / 2, low)),
        hull("roof.obj", drawn_along(section, 1, wide / 2 + over)),
        block((-2.035, 2.165, 6.15), (-1.165, 3.235, 8.15)),
        block((porch, -1.1, 0.0), (porch + 0.9, 1.1, 0.15)),
        block((porch, -1.1, 0.15), (porch + 0.5, 1.1, 0.30)),
        block((porch, -1.2, 2.81), (porch + 1.07, 1.2, 2.97)),
        block((porch + 0.80, -1.07, 0.15), (porch + 0.90, -0.97, 2.81)),
        block((porch + 0.80, 0.97, 0.15), (porch + 0.90, 1.07, 2.81)),
    ]


def shop_solids(_: Mesh) -> list[Solid]:
    """Return the walls, the awning, the air conditioner on the roof."""
    deep, wide, high = buildings.SHOP
    out, low, up = buildings.AWNING
    return [
        block((-deep / 2, -wide / 2, 0.0), (deep / 2, wide / 2, high)),
        block((deep / 2, -5.55, low), (deep / 2 + 0.55, 5.55, up)),
        block((deep / 2 + 0.55, -5.55, low), (deep / 2 + out, 5.55, low + 0.34)),
        block((-2.0, 1.6, high - 0.45), (-0.4, 3.6, high + 0.45)),
    ]


def lamp_solids(_: Mesh) -> list[Solid]:
    """Return the footing, the column in steps, the arms in two pieces each, the heads."""
    solids = [
        block((-0.21, -0.21, 0.0), (0.21, 0.21, 0.10)),
        column(0.100, 0.10, 0.95), column(0.082, 0.95, 3.2), column(0.070, 3.2, 5.5), column(0.058, 5.5, 7.76),
    ]  # fmt: skip
    arm = street.lamp_arm()
    head = float(arm[-1][2])
    for side in (-1.0, 1.0):
        turn = np.array([1.0, side, 1.0])
        solids += [bar(0.030, arm[i] * turn, arm[i + 4] * turn) for i in (0, 4)]
        y = sorted((side * 0.80, side * 1.50))
        solids.append(block((-0.15, y[0], head - 0.035), (0.15, y[1], head + 0.05)))
    return solids


def whole(mesh: Mesh) -> list[Solid]:
    """Return the box around it."""
    corners = mesh.corners()
    return [block(corners.min(axis=0), corners.max(axis=0))]


PROPS: dict[str, Prop] = {
    "cone": Prop(
        "Traffic cone, 0.71 m",
        "MUTCD 2009 section 6F.64: 28 in high, white bands of 6 in and 4 in; base 0.37 m and 3.2 kg (7 lb): as sold",
        3.2, street.make_cone, cone_solids, Material((0.95, 0.33, 0.05), 0.6)
    ),
    "barrel": Prop(
        "Construction drum, 0.91 m",
        "MUTCD 2009 section 6F.67: at least 36 in high and 18 in wide, stripes of 6 in; taper, base and mass assumed",
        16.0, street.make_barrel, barrel_solids, Material((0.95, 0.36, 0.05), 0.6)
    ),
    "jersey_barrier": Prop(
        "Concrete barrier of the New Jersey shape, 3.05 m",
        "FHWA, New Jersey safety shape: 24 in wide, 32 in high, rising at 55 degrees to 13 in and then at 84 degrees; "
        "10 ft long as sold; mass of 0.74 m3 at 2400 kg/m3; chamfers and openings assumed",
        1770.0, street.make_jersey_barrier, jersey_solids, Material((0.72, 0.71, 0.68), 0.95)
    ),
    "stop_sign": Prop(
        "Stop sign on a post, 2.90 m",
        "MUTCD 2009 sections 2A.18 and 2B.05: R1-1 of 30 in, lower edge 7 ft above the ground; post of 2 in and mass "
        "assumed",
        12.0, street.make_stop_sign, stop_solids
    ),
    "traffic_light": Prop(
        "Traffic light on a post, red lit, 3.79 m",
        "MUTCD 2009 sections 4D.07 and 4D.15: lenses of 12 in, head 8 ft to 19 ft above the ground beside a road; "
        "sections, visors, back plate, post and mass assumed",
        95.0, street.make_traffic_light, signal_solids, Material((0.96, 0.73, 0.10), 0.5)
    ),
    "pedestrian": Prop(
        "Standing person, 1.75 m",
        "DIN 33402-2:2005, men of 18 to 65 years: median height 1.75 m, mass 79 kg; proportions assumed",
        79.0, nature.make_pedestrian, person_solids, Material((0.33, 0.45, 0.55), 0.85)
    ),
    "cyclist": Prop(
        "Person on a bicycle, 1.74 m long",
        "Wheels of 28 in (ISO 5775: 40-622); rider as the pedestrian; sizes of the frame and its mass of 16 kg assumed",
        95.0, bicycles.make_cyclist, cyclist_solids, Material((0.86, 0.42, 0.10), 0.8)
    ),
    "sedan": Prop(
        "Parked sedan, 4.5 m x 1.8 m x 1.45 m without mirrors",
        "Sizes and mass of a compact sedan: assumed; no maker's car",
        1400.0, cars.make_sedan, _car_solids((0.316, 0.205, 2.65, 1.54), 0.93, 0.90),
        Material((0.42, 0.10, 0.11), 0.35, 0.15)
    ),
    "van": Prop(
        "Parked van, 5.0 m x 2.0 m x 2.0 m without mirrors",
        "Sizes and mass of a panel van of 5 m: assumed; no maker's car",
        2000.0, cars.make_van, _car_solids((0.335, 0.215, 2.93, 1.70), 1.18, 0.99),
        Material((0.88, 0.89, 0.88), 0.38)
    ),
    "tree": Prop(
        "Broad-leaved tree, 7 m",
        "Sizes and mass of a young street tree: assumed",
        900.0, nature.make_tree, tree_solids, Material((0.30, 0.47, 0.15), 0.85)
    ),
    "house": Prop(
        "Two-storey house with a gable roof",
        "Sizes and mass of a family house: assumed",
        150000.0, buildings.make_house, house_solids, Material((0.90, 0.86, 0.75), 0.9)
    ),
    "building": Prop(
        "City block of four storeys, resizable",
        "Sizes and mass: assumed, storeys of 2.9 m above shops of 3.6 m",
        1200000.0, buildings.make_building, whole, Material((0.76, 0.62, 0.51), 0.95), resizable=True
    ),
    "thrift_store": Prop(
        "Shop on one floor with windows, awning and sign board",
        "Sizes and mass: assumed",
        180000.0, buildings.make_thrift_store, shop_solids, Material((0.86, 0.80, 0.70), 0.9)
    ),
    "lamp_post": Prop(
        "Street lamp with two arms, 7.9 m",
        "Height of 8 m as common along streets; arms, taper and mass assumed",
        110.0, street.make_lamp_post, lamp_solids, Material((0.40, 0.43, 0.44), 0.5, 0.2)
    ),
    "wall": Prop(
        "Wall of concrete blocks, 4 m x 0.2 m x 2 m, resizable",
        "Blocks of 16 in x 8 in x 8 in with their joints (ASTM C90); length and height assumed; mass at 2000 kg/m3",
        3200.0, street.make_wall, whole, Material((0.66, 0.65, 0.62), 0.95), resizable=True
    ),
    "speed_bump": Prop(
        "Rubber speed bump, 75 mm",
        "ITE on speed humps: 3 in to 4 in high; a bump of a car park is 1 ft to 3 ft along the road; length across and "
        "mass assumed",
        60.0, street.make_speed_bump, lambda _: [hull("bump.obj", street.bump_corners())],
        Material((0.97, 0.76, 0.08), 0.7), mu=0.8, driven_over=True
    ),
}  # fmt: skip


def write_prop(folder: Path, name: str) -> str:
    """Write a prop to ``folder/name``; return a line on it."""
    prop, home = PROPS[name], folder / name
    home.mkdir(parents=True, exist_ok=True)
    result = prop.make()
    corners = result.corners()
    low, high = corners.min(axis=0), corners.max(axis=0)
    shift = np.array([-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]])
    mesh = Mesh()
    mesh.add_mesh(result, None, shift.tolist())
    materials = {**MATERIALS, **COLOURS, **({"paint": prop.paint} if prop.paint else {})}
    count = mesh.write(home / f"{name}.gltf", materials=materials, generator="mirdrake models/props/generate.py")
    solids = [solid.moved(shift) for solid in prop.solids(result)]
    for solid in solids:
        if solid.kind == "convex":
            write_hull(home / solid.file, solid.points)
    size = _numbers((high - low).round(3).tolist())
    lines = [f"description: {prop.description}", f'source: "{prop.source}"', f"size: {size}"]
    lines += [f"mass: {_number(prop.mass)}", f"mu: {_number(prop.mu)}", f"visual: {name}.gltf"]
    lines += ["paint: paint"] if prop.paint else []
    lines += [f"resizable: {str(prop.resizable).lower()}", f"driven_over: {str(prop.driven_over).lower()}", "solids:"]
    lines += [solid.line() for solid in solids]
    (home / "prop.yaml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    bytes_ = sum(path.stat().st_size for path in home.iterdir())
    return f"{name}: {count} triangles, {len(solids)} solids, {bytes_ / 1e3:.0f} kB, size {size}"


if __name__ == "__main__":
    for chosen in sys.argv[1:] or PROPS:
        print(write_prop(Path(__file__).resolve().parents[2] / "models" / "props", chosen))
