"""Street furniture: cone, drum, barrier, sign, signal, lamp, wall, bump."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import shapely
from shapely.geometry import Point, Polygon

from mirdrake.vehicles.bodywork.mesh import Mesh
from tools.meshes.outlines.curves import Array
from tools.meshes.outlines.solids import tube
from tools.meshes.prop_shapes import (
    Layer,
    box,
    drawn,
    extrude,
    frustum,
    lathe,
    lettering,
    turned,
    turned_ahead,
)

INCH = 0.0254  # [m]


def make_cone() -> Mesh:
    """Return a cone of 28 in with collars of 6 in and 4 in on a square base."""
    mesh = Mesh()
    height, foot, tip = 28 * INCH, 0.129, 0.030

    def radius(z: float) -> float:
        return foot + (tip - foot) * (z - 0.03) / (height - 0.03)

    mesh.add_mesh(box("base", (0.37, 0.37, 0.024), (0, 0, 0.017), 0.006))
    for x in (-0.15, 0.15):
        for y in (-0.15, 0.15):
            mesh.add_mesh(box("base", (0.05, 0.05, 0.01), (x, y, 0.005)))
    mesh.add_mesh(lathe("paint", [(0.152, 0.028), (0.140, 0.038), (radius(0.05), 0.05)], 28))
    top = height - 3.5 * INCH
    marks = [0.05, top - 12 * INCH, top - 8 * INCH, top - 6 * INCH, top, height - 0.004]
    for k, (low, high) in enumerate(pairwise(marks)):
        collar = k in (1, 3)
        out = 0.0015 if collar else 0.0
        mesh.add_mesh(
            lathe("reflective" if collar else "paint", [(radius(low) + out, low), (radius(high) + out, high)], 28)
        )
    mesh.add_mesh(lathe("paint", [(tip, height - 0.004), (tip - 0.005, height), (tip - 0.011, height)], 28))
    mesh.add_mesh(lathe("hollow", [(tip - 0.011, height), (tip - 0.011, height - 0.03), (0.0, height - 0.03)], 14))
    return mesh


def make_barrel() -> Mesh:
    """A channelizing drum of 36 in: steps that narrow upwards, four stripes of 6 in, a handle, a ring of rubber."""
    mesh = Mesh()
    ring = [(0.0, 0.0), (0.305, 0.0), (0.310, 0.012), (0.300, 0.07), (0.285, 0.082), (0.26, 0.082)]
    mesh.add_mesh(lathe("base", ring, 36))
    step = 6 * INCH
    z, r = 0.075, 0.266
    mesh.add_mesh(lathe("paint", [(r, z), (r, z + 0.075)], 36))
    z += 0.075
    for k in range(4):
        name = ("reflective", "paint")[k % 2]
        mesh.add_mesh(lathe(name, [(r, z), (r - 0.009, z + 0.010), (r - 0.009, z + step)], 36))
        r, z = r - 0.009, z + step
    mesh.add_mesh(lathe("paint", [(r, z), (r, z + 0.030), (r - 0.014, z + 0.048), (0.17, z + 0.054), (0.0, z + 0.054)],
                        36))  # fmt: skip
    top = z + 0.052
    grip = 36 * INCH
    bow = [(0, -0.085, top - 0.02), (0, -0.080, grip - 0.040), (0, -0.05, grip - 0.014), (0, 0.05, grip - 0.014),
           (0, 0.080, grip - 0.040), (0, 0.085, top - 0.02)]  # fmt: skip
    mesh.add_mesh(tube("paint", bow, 0.014, count=10))
    return mesh


JERSEY = [(-0.3048, 0.0), (0.3048, 0.0), (0.3048, 0.0762), (0.127, 0.3302), (0.0762, 0.8128), (-0.0762, 0.8128),
          (-0.127, 0.3302), (-0.3048, 0.0762)]  # fmt: skip
"""Half widths and heights (y, z) [m] of the New Jersey profile: 24 in wide, rising at 55° and 84° to 32 in."""


def make_jersey_barrier() -> Mesh:
    """A barrier of concrete, 10 ft long: chamfered ends, two openings for a fork, a slot and a loop at either end."""
    mesh = Mesh()
    half, chamfer = 1.525, 0.02
    slots = [(-0.95, -0.55), (0.55, 0.95)]
    profile = Polygon(JERSEY)
    openings = shapely.union_all([shapely.box(-1, -1, 1, 0.0762)])
    solid = profile.difference(openings)
    mesh.add_mesh(extrude("paint", solid, -half + chamfer, half - chamfer, ends="none"))
    foot = shapely.box(-0.3048, 0.0, 0.3048, 0.0762)
    edges = [-half + chamfer, *[x for slot in slots for x in slot], half - chamfer]
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        mesh.add_mesh(extrude("paint", foot, a, b))
    for a, b in slots:
        roof = np.array([[a, -0.3048, 0.0762], [b, -0.3048, 0.0762], [b, 0.3048, 0.0762], [a, 0.3048, 0.0762]])
        mesh.add_flat("hollow", roof[[[0, 1, 2], [0, 2, 3]]], (0, 0, -1))
    for sign in (-1.0, 1.0):
        small = [(y * 0.92, 0.012 + z * 0.972) if z > 0 else (y * 0.92, 0.0) for y, z in JERSEY]
        ring = list(zip([*JERSEY, JERSEY[0]], [*small, small[0]], strict=True))
        for (p, q), (s, t) in pairwise(ring):
            quad = np.array([[sign * (half - chamfer), *p], [sign * (half - chamfer), *s], [sign * half, *t],
                             [sign * half, *q]])  # fmt: skip
            normal = np.cross(quad[1] - quad[0], quad[3] - quad[0])
            # Outwards, away from a point in the middle of the barrier; the lowest face is horizontal.
            normal *= np.sign(normal @ (quad.mean(axis=0) - [0.0, 0.0, 0.4]))
            mesh.add_flat("paint", quad[[[0, 1, 2], [0, 2, 3]]], (normal / np.linalg.norm(normal)).tolist())
        face = Polygon(small)
        slot = shapely.box(-0.035, 0.0, 0.035, 0.70)
        mesh.add_mesh(drawn([("paint", face), ("hollow", slot)], sign * half, facing=sign))
    for x in (-0.9, 0.9):  # eyes to lift it by
        loop = [(x - 0.045, 0, 0.800), (x - 0.04, 0, 0.8075), (x + 0.04, 0, 0.8075), (x + 0.045, 0, 0.800)]
        mesh.add_mesh(tube("steel", loop, 0.005, count=6))
    return mesh


def octagon(across: float) -> Polygon:
    """Return an octagon about the origin, its sides ``across`` apart."""
    a = np.deg2rad(22.5 + 45.0 * np.arange(8))
    r = across / 2 / np.cos(np.deg2rad(22.5))
    return Polygon(np.stack([r * np.cos(a), r * np.sin(a)], axis=1))


STOP = (0.0285, 0.0255, 1.0 * INCH, 84 * INCH + 30 * INCH - 0.05, 84 * INCH + 15 * INCH)
"""x of the face and of its rear, half width and top of the post, height of the face's middle [m]."""


def make_stop_sign() -> Mesh:
    """Return an R1-1 of 30 in on a square tube with holes, its lower edge 7 ft above the ground."""
    mesh = Mesh()
    across, low = 30 * INCH, 84 * INCH
    x, rear, half, top, middle = STOP
    post = rear - half
    mesh.add_mesh(box("steel", (2 * half, 2 * half, top), (post, 0, top / 2)))
    holes = [Point(0, z).buffer(0.0055, quad_segs=2) for z in np.arange(0.15, low - 0.02, 0.0762)]
    for k in (1, 2, 3):
        position = (post + half * np.cos(k * np.pi / 2), half * np.sin(k * np.pi / 2), 0.0)
        mesh.add_mesh(turned(drawn([("hollow", hole) for hole in holes], 0.0006), k * np.pi / 2, position))
    plate = octagon(across)
    mesh.add_mesh(extrude("aluminium", plate, rear, x, ends="rear"), None, (0, 0, middle))
    layers: list[Layer] = [
        ("sign_white", plate), ("sign_red", octagon(across - 1.5 * INCH)),
        ("sign_white", lettering("STOP", 10 * INCH, width=0.56, pen=0.185, gap=0.14)),
    ]  # fmt: skip
    mesh.add_mesh(drawn(layers, x), None, (0, 0, middle))
    for z in (-0.30, 0.30):
        mesh.add_mesh(turned_ahead("steel", [(0.008, x), (0.008, x + 0.003), (0.0, x + 0.003)], 8), None,
                      (0, 0, middle + z))  # fmt: skip
    return mesh


SIGNAL = (2.60, 0.356, 0.19, 0.345)  # [m] lower edge of the head, height of a section, depth, width


def make_traffic_light() -> Mesh:
    """Three sections of 12 in with visors before a back plate, on top of a post."""
    mesh = Mesh()
    low, section, deep, wide = SIGNAL
    high = low + 3 * section
    mesh.add_mesh(box("post", (0.36, 0.36, 0.04), (0, 0, 0.02), 0.008))
    foot = [(0.165, 0.04), (0.150, 0.07), (0.095, 0.36), (0.075, 0.40), (0.057, 0.42), (0.057, low - 0.12)]
    mesh.add_mesh(lathe("post", foot, 20, smooth=False))
    mesh.add_mesh(lathe("post", [(0.070, low - 0.16), (0.070, low - 0.05), (0.092, low - 0.02), (0.092, low)], 20,
                        smooth=False))  # fmt: skip
    front = deep / 2
    for k in range(3):
        mesh.add_mesh(box("paint", (deep, wide, section - 0.006), (0, 0, low + (k + 0.5) * section), 0.018))
        mesh.add_mesh(box("hinge", (0.05, 0.014, 0.05), (0.03, wide / 2, low + (k + 0.3) * section), 0.004))
    plate = shapely.box(-0.30, low - 0.125, 0.30, high + 0.125).buffer(-0.04).buffer(0.04, quad_segs=4)
    ring = plate.difference(shapely.box(-0.170, low, 0.170, high))
    edge = plate.difference(plate.buffer(-0.050, join_style="mitre"))
    mesh.add_mesh(drawn([("board", ring), ("sign_yellow", edge)], front - 0.060))
    mesh.add_mesh(extrude("board", ring, front - 0.064, front - 0.060, ends="rear"))
    for k, name in enumerate(("signal_green", "signal_amber", "signal_red")):
        z = low + (k + 0.5) * section
        mesh.add_mesh(extrude("board", Point(0, 0).buffer(0.163, quad_segs=7), front, front + 0.012, ends="front"),
                      None, (0, 0, z))  # fmt: skip
        lens = turned_ahead(name, [(0.150, front + 0.013), (0.12, front + 0.028), (0.07, front + 0.040),
                                   (0.0, front + 0.045)], 24)  # fmt: skip
        mesh.add_mesh(lens, None, (0, 0, z))
        a = np.linspace(-0.22 * np.pi, 1.22 * np.pi, 21)
        reach = 0.06 + 0.20 * np.clip(0.5 + 0.62 * np.sin(a), 0.0, 1.0) ** 0.8
        for r, sign, material in ((0.163, 1.0, "board"), (0.158, -1.0, "hollow")):
            rear = np.stack([np.full_like(a, front + 0.005), r * np.cos(a), r * np.sin(a) + z], axis=1)
            ahead = np.stack([front + reach, r * np.cos(a), r * np.sin(a) + z - 0.03 * reach], axis=1)
            normal = sign * np.stack([np.zeros_like(a), np.cos(a), np.sin(a)], axis=1)
            mesh.add_grid(material, np.stack([rear, ahead]), np.stack([normal, normal]))
    return mesh


def lamp_arm() -> Array:
    """Return points (9, 3) along the left arm."""
    t = np.linspace(0.0, 1.0, 9)
    return np.stack([np.zeros_like(t), 0.03 + 0.85 * t, 7.20 + 0.66 * np.sin(t * np.pi / 2) ** 0.9], axis=1)


def make_lamp_post() -> Mesh:
    """Return a tapered column of 8 m with two arms and flat LED heads, to the left and to the right."""
    mesh = Mesh()
    mesh.add_mesh(box("concrete", (0.42, 0.42, 0.10), (0, 0, 0.05), 0.02))
    mesh.add_mesh(lathe("paint", [(0.15, 0.10), (0.15, 0.125), (0.105, 0.135), (0.100, 0.90), (0.092, 0.95)], 20,
                        smooth=False))  # fmt: skip
    mesh.add_mesh(lathe("paint", [(0.090, 0.95), (0.052, 7.70), (0.046, 7.76), (0.0, 7.78)], 20))
    mesh.add_mesh(box("gap", (0.012, 0.11, 0.36), (0.098, 0, 0.55)))
    mesh.add_mesh(box("paint", (0.012, 0.10, 0.35), (0.101, 0, 0.55), 0.003))
    arm = lamp_arm()
    half = Mesh()
    half.add_mesh(tube("paint", arm.tolist(), 0.030, count=10))
    z = float(arm[-1, 2])
    right = [(0.06, 0.80, 0.055), (0.20, 1.05, 0.060), (0.20, 1.38, 0.045), (0.10, 1.50, 0.015)]
    outline = [*right, *[(-across, y, up) for across, y, up in right[::-1]]]
    top = [(0.62 * across, y, z + up) for across, y, up in outline]
    low = [(1.25 * across, y, z - 0.035) for across, y, _ in top]
    half.add_mesh(frustum("paint", low, top))
    lens = np.array([[-0.11, 1.02, z - 0.0362], [0.11, 1.02, z - 0.0362], [0.11, 1.40, z - 0.0362],
                     [-0.11, 1.40, z - 0.0362]])  # fmt: skip
    half.add_flat("lens", lens[[[0, 1, 2], [0, 2, 3]]], (0, 0, -1))
    mesh.add_mesh(half)
    mesh.add_mesh(half.mirrored())
    return mesh


def make_wall() -> Mesh:
    """Return a wall of concrete blocks, 16 in x 8 in x 8 in with their joints, in running bond; 4 m long, 2 m high."""
    mesh = Mesh()
    wide, tall, deep, joint = 0.4, 0.2, 0.2, 0.010
    recess, slope = 0.008, 0.012

    def face(length: float, stagger: bool) -> Mesh:
        side, rings = Mesh(), []
        for row in range(10):
            shift = 0.5 * wide if row % 2 and stagger else 0.0
            for start in np.arange(-length / 2 - shift, length / 2 - 1e-9, wide).tolist():
                a, b = max(start, -length / 2), min(start + wide, length / 2)
                a += joint / 2 if a > -length / 2 else 0.0
                b -= joint / 2 if b < length / 2 else 0.0
                c = row * tall + (joint / 2 if row else 0.0)
                d = (row + 1) * tall - (joint / 2 if row < 9 else 0.0)
                outer = [(a, c), (b, c), (b, d), (a, d)]
                ia = a + (slope if a > -length / 2 else 0.0)
                ib = b - (slope if b < length / 2 else 0.0)
                ic = c + (slope if row else 0.0)
                id_ = d - (slope if row < 9 else 0.0)
                inner = [(ia, ic), (ib, ic), (ib, id_), (ia, id_)]
                flat = np.array([[0.0, *p] for p in inner])
                side.add_flat("paint", flat[[[0, 1, 2], [0, 2, 3]]], (1, 0, 0))
                for i in range(4):
                    j = (i + 1) % 4
                    quad = np.array([[-recess, *outer[i]], [-recess, *outer[j]], [0, *inner[j]], [0, *inner[i]]])
                    normal = np.cross(quad[1] - quad[0], quad[2] - quad[0])
                    if np.linalg.norm(normal) < 1e-9 or abs(normal[0]) < 1e-9:
                        continue
                    normal = normal / np.linalg.norm(normal) * np.sign(normal[0])
                    side.add_flat("paint", quad[[[0, 1, 2], [0, 2, 3]]], normal.tolist())
                rings.append(Polygon(outer))
        mortar = shapely.box(-length / 2, 0, length / 2, 10 * tall).difference(shapely.union_all(rings))
        side.add_mesh(drawn([("mortar", mortar)], -recess))
        return side

    for angle, position in ((np.pi / 2, (0, deep / 2, 0)), (-np.pi / 2, (0, -deep / 2, 0))):
        mesh.add_mesh(turned(face(4.0, True), angle, position))
    for angle, x in ((0.0, 2.0), (np.pi, -2.0)):
        mesh.add_mesh(turned(face(deep, False), angle, (x, 0, 0)))
    for z, sign in ((0.0, -1.0), (2.0, 1.0)):
        flat = np.array([[-2.0, -deep / 2, z], [2.0, -deep / 2, z], [2.0, deep / 2, z], [-2.0, deep / 2, z]])
        mesh.add_flat("paint", flat[[[0, 1, 2], [0, 2, 3]]], (0, 0, sign))
    return mesh


BUMP = (0.60, 3.0, 0.075)  # [m] along the road, across it, high
_RAMP = 0.15  # [m] by which its ends fall to the ground


def bump_section(count: int = 13) -> Array:
    """Return points (x, z) of the bump's section, an arc of a circle."""
    half, height = BUMP[0] / 2, BUMP[2]
    radius = (half**2 + height**2) / (2 * height)
    a = np.linspace(-1.0, 1.0, count) * np.arcsin(half / radius)
    section = np.stack([radius * np.sin(a), radius * np.cos(a) - radius + height], axis=1)
    section[[0, -1], 1] = 0.0
    return section


def bump_corners() -> Array:
    """Return points (n, 3) whose hull is the bump."""
    s = bump_section()
    side = BUMP[1] / 2
    ends = ((-side, 0.8, 0.0), (-side + _RAMP, 1.0, 1.0), (side - _RAMP, 1.0, 1.0), (side, 0.8, 0.0))
    return np.concatenate([np.stack([s[:, 0] * w, np.full(len(s), y), s[:, 1] * h], axis=1) for y, w, h in ends])


def make_speed_bump() -> Mesh:
    """Return a bump of rubber with yellow arrows across, flat ramps at its ends."""
    mesh = Mesh()
    s = bump_section()
    n = s + np.array([0.0, (BUMP[0] / 2) ** 2 / (2 * BUMP[2]) - BUMP[2] / 2])
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    side, inner = BUMP[1] / 2, BUMP[1] / 2 - _RAMP
    period, count = inner / 6, 12

    def edge(k: int) -> Array:
        """Across (y) at each point of the section: a zigzag, straight at the ends."""
        y = np.full(len(s), -inner + k * period)
        return y if k in (0, count) else y + 0.30 * period * (1.0 - 2.0 * np.abs(s[:, 0]) / (BUMP[0] / 2))

    for k in range(count):
        rows = [np.stack([s[:, 0], edge(i), s[:, 1]], axis=1) for i in (k, k + 1)]
        normals = np.stack([n[:, 0], np.zeros(len(s)), n[:, 1]], axis=1)
        mesh.add_grid(("rubber", "paint")[k % 2], np.stack(rows), np.stack([normals, normals]))
    for sign in (-1.0, 1.0):
        high = np.stack([s[:, 0], np.full(len(s), sign * inner), s[:, 1]], axis=1)
        low = np.stack([0.8 * s[:, 0], np.full(len(s), sign * side), np.zeros(len(s))], axis=1)
        slope = np.stack([n[:, 0], np.full(len(s), sign * BUMP[2] / _RAMP), n[:, 1]], axis=1)
        slope /= np.linalg.norm(slope, axis=1, keepdims=True)
        mesh.add_grid("rubber", np.stack([high, low]), np.stack([slope, slope]))
    flat = np.array([[-0.24, -side, 0], [0.24, -side, 0], [0.30, -inner, 0], [0.30, inner, 0], [0.24, side, 0],
                     [-0.24, side, 0], [-0.30, inner, 0], [-0.30, -inner, 0]])  # fmt: skip
    mesh.add_flat("rubber", np.array([[flat[0], flat[i], flat[i + 1]] for i in range(1, 7)]), (0, 0, -1))
    return mesh
