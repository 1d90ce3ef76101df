"""Generate the visual meshes of the Avrora Unior: ``body.gltf`` and ``wheel.gltf`` (with ``.bin`` files).

The robot is drawn from scratch: a dark chassis, an angular shell with a cover plate on top, a laser on the nose, a
Kinect on a mast behind it, a GPS antenna at the rear, sonar in both bumpers. Its outer size and its tyres are the
paper's, the sensors stand at the frames of sensors.xacro; all else is invented. Frames are ISO 8855 (x forward, y left,
z up; metres). The origin of the body is on the ground below the centre of the rear axle; that of the wheel is at its
centre, spinning about y.

Usage: ``python -m tools.meshes.unior`` writes them into ``models/unior/meshes``; the result is deterministic.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from shapely.geometry import Point, Polygon

from mirdrake.vehicles.bodywork.mesh import Material, Mesh
from tools.meshes.outlines.car import describe, write_meshes
from tools.meshes.outlines.curves import Array
from tools.meshes.outlines.solids import plate, prism, rot_y, rot_z, tube
from tools.meshes.outlines.wheels import polar, revolve, sector, wheel_face

FRONT, REAR = 0.926, -0.186  # ends of the robot [m]
WHEELBASE = 0.74
RADIUS, HALF_WIDTH, RIM = 0.13, 0.055, 0.102  # of the tyre and its rim [m]
LASER, KINECT, GPS, SONAR = (0.846, 0.42), (0.74, 0.53), (0.0, 0.57), 0.25  # x and z of their frames; z [m]
DECK = 0.402  # height of the shell's flat top [m]

MATERIALS = {
    "paint": Material((0.95, 0.40, 0.03), 0.42, 0.0),
    "stripe": Material((0.93, 0.93, 0.91), 0.5),
    "cover": Material((0.17, 0.18, 0.20), 0.55, 0.1),
    "alloy": Material((0.74, 0.75, 0.77), 0.4, 0.2),
    "antenna": Material((0.95, 0.95, 0.94), 0.5),
    "casing": Material((0.055, 0.055, 0.06), 0.7),
    "lens": Material((0.10, 0.13, 0.20), 0.12, 0.1),
    "signal_yellow": Material((0.98, 0.80, 0.04), 0.5),
    "plate": Material((0.17, 0.18, 0.20), 0.6),
    "plate_text": Material((0.95, 0.95, 0.93), 0.6),
}

Loop = Sequence[Sequence[float]]  # corners (x, y, z) of a section, or of a face
Corner = tuple[float, float, float]

_Y_TO_Z = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
_Y_TO_X = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


# --- solids ------------------------------------------------------------------------------------------------------


def loft(material: str, loops: Sequence[Loop], bevel: float) -> Mesh:
    """Return the convex solid between sections of equally many corners, its edges rounded.

    Args:
        material: of the solid.
        loops: sections, one after another, each with its corners in the same order.
        bevel: radius of the edges [m].
    """
    points = np.array([corner for loop in loops for corner in loop], dtype=float)
    many = len(loops[0])
    faces = [list(range(many)), list(range(len(points) - many, len(points)))]
    for k in range(len(loops) - 1):
        for i in range(many):
            j = (i + 1) % many
            faces.append([k * many + i, k * many + j, (k + 1) * many + j, (k + 1) * many + i])
    return _rounded(material, points, faces, bevel)


def _rounded(material: str, points: Array, faces: list[list[int]], bevel: float) -> Mesh:
    """Return a convex solid: every face moved inwards by the bevel, then all of it swept with a ball of that radius."""
    mesh = Mesh()
    middle = points.mean(axis=0)
    normals = []
    for number, face in enumerate(faces):
        p = points[face]
        normal = np.cross(p, np.roll(p, -1, axis=0)).sum(axis=0)
        normal /= np.linalg.norm(normal)
        if float(normal @ (p.mean(axis=0) - middle)) < 0.0:
            normal, faces[number] = -normal, face[::-1]
        normals.append(normal)
    n = np.array(normals)
    core = points.copy()
    for v in range(len(points)):
        around = [k for k, face in enumerate(faces) if v in face]
        core[v] += np.linalg.lstsq(n[around], np.full(len(around), -bevel), rcond=None)[0]
    sides: dict[tuple[int, int], int] = {}
    arcs: dict[int, list[Array]] = {}
    for k, face in enumerate(faces):
        flat = core[face] + bevel * n[k]
        fan = np.stack([np.broadcast_to(flat[0], flat[2:].shape), flat[1:-1], flat[2:]], axis=1)
        mesh.add_flat(material, fan, n[k].tolist())
        sides.update(dict.fromkeys(zip(face, face[1:] + face[:1], strict=True), k))
    for (a, b), k in sides.items():
        other = sides[b, a]
        if k > other:
            continue
        t = np.linspace(0.0, 1.0, 4)[:, None]
        arc = (1.0 - t) * n[k] + t * n[other]
        arc /= np.linalg.norm(arc, axis=1, keepdims=True)
        mesh.add_grid(material, np.stack([core[a] + bevel * arc, core[b] + bevel * arc]), np.stack([arc, arc]))
        arcs.setdefault(a, []).append(arc)
        arcs.setdefault(b, []).append(arc)
    for v, corner_arc in arcs.items():
        top = np.mean([arc.mean(axis=0) for arc in corner_arc], axis=0)
        top /= np.linalg.norm(top)
        for arc in corner_arc:
            corners = np.stack([np.broadcast_to(top, arc[1:].shape), arc[:-1], arc[1:]], axis=1)
            mesh.add(material, core[v] + bevel * corners, corners)
    return mesh


def block(material: str, low: Corner, high: Corner, bevel: float) -> Mesh:
    """Return a box between two corners."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    return loft(material, [[(x, y0, z0), (x, y1, z0), (x, y1, z1), (x, y0, z1)] for x in (x0, x1)], bevel)


def slab(material: str, plan: Sequence[tuple[float, float]], low: float, high: float, bevel: float) -> Mesh:
    """Return a level plate over a convex plan (x, y)."""
    return loft(material, [[(x, y, z) for x, y in plan] for z in (low, high)], bevel)


def across(material: str, profile: Sequence[tuple[float, float]], half: float, bevel: float) -> Mesh:
    """Return a convex profile (x, z) extended to both sides."""
    return loft(material, [[(x, y, z) for x, z in profile] for y in (-half, half)], bevel)


def ring(*half: tuple[float, float, float]) -> Loop:
    """Return a section of its left corners (x, y, z), from below, and their mirror images."""
    return [*half, *((x, -y, z) for x, y, z in half[::-1])]


def can(material: str, radius: float, height: float, bevel: float, *, count: int = 32) -> Mesh:
    """Return an upright cylinder with its base at the origin."""
    b = bevel
    profile = [(0.0, 0.0), (0.0, radius - b), (0.3 * b, radius - 0.3 * b), (b, radius), (height - b, radius),
               (height - 0.3 * b, radius - 0.3 * b), (height, radius - b), (height, 0.0)]  # fmt: skip
    mesh = Mesh()
    mesh.add_mesh(revolve(material, profile, count), _Y_TO_Z)
    return mesh


def both(mesh: Mesh) -> Mesh:
    """Return a part of the left side together with its mirror image."""
    result = Mesh()
    result.add_mesh(mesh)
    result.add_mesh(mesh.mirrored())
    return result


# --- body --------------------------------------------------------------------------------------------------------


def build_chassis() -> Mesh:
    """Return the parts below the shell: a tub between the wheels, skid plates, axles, bumpers."""
    mesh = Mesh()
    tub = [
        (REAR + 0.030, 0.145),
        (-0.095, 0.0585),
        (0.800, 0.0585),
        (0.893, 0.165),
        (0.893, 0.300),
        (REAR + 0.030, 0.300),
    ]
    mesh.add_mesh(across("cladding", tub, 0.142, 0.006))
    mesh.add_mesh(across("alloy", [(0.803, 0.0600), (0.896, 0.166), (0.904, 0.166), (0.812, 0.0600)], 0.118, 0.002))
    mesh.add_mesh(across("alloy", [(-0.098, 0.0600), (-0.159, 0.144), (-0.165, 0.144), (-0.106, 0.0600)], 0.118, 0.002))
    for axle, joint in ((0.0, 0.215), (WHEELBASE, 0.205)):
        mesh.add_mesh(tube("rim_shadow", [(axle, -joint, RADIUS), (axle, joint, RADIUS)], 0.016))
        for along in (-0.05, 0.05):
            arm = [(axle + along, 0.13, RADIUS - 0.02), (axle + 0.2 * along, joint, RADIUS - 0.02)]
            mesh.add_mesh(both(tube("rim_shadow", arm, 0.008)))
    for end, sign in ((FRONT, 1.0), (REAR, -1.0)):
        levels = [
            ring(*((end + sign * x, y, z) for x, y in ((-0.041, 0.30), (-0.022 - back, 0.31), (-0.008 - back, 0.20))))
            for z, back in ((0.188, 0.016), (0.214, 0.0), (0.284, 0.0))
        ]
        mesh.add_mesh(loft("cladding", levels, 0.006))
        mesh.add_mesh(both(_sonar_eye(end, sign)))
        mesh.add_mesh(block("casing", (end - sign * 0.012, -0.070, 0.222), (end - sign * 0.0055, 0.070, 0.278), 0.002))
    return mesh


def _sonar_eye(end: float, sign: float) -> Mesh:
    """Return the left one of a pair of ultrasonic transducers; its face lies at the end of the robot."""
    eye = Mesh()
    rim = [(0.0, 0.0205), (0.0115, 0.0205), (0.012, 0.020), (0.012, 0.0160), (0.009, 0.0155)]
    eye.add_mesh(revolve("alloy", rim, 32, smooth=False))
    eye.add_mesh(revolve("rim_dark", [(0.009, 0.016), (0.009, 0.0)], 32, smooth=False))
    eye.add_mesh(revolve("alloy", [(0.009, 0.0045), (0.0105, 0.004), (0.0105, 0.0)], 16, smooth=False))
    mesh = Mesh()
    turn = _Y_TO_X if sign > 0 else rot_z(np.pi) @ _Y_TO_X
    mesh.add_mesh(eye, turn, (end - sign * 0.012, 0.036, SONAR))
    return mesh


def build_shell() -> Mesh:
    """Return the angular shell: an upper part over the wheels, pods between them, and what is fixed to it."""
    mesh = Mesh()
    sections = [
        ring((-0.158, 0.272, 0.276), (-0.172, 0.280, 0.318), (-0.118, 0.205, 0.386)),
        ring((-0.020, 0.306, 0.276), (-0.020, 0.322, 0.318), (-0.020, 0.232, DECK)),
        ring((0.530, 0.306, 0.276), (0.530, 0.322, 0.318), (0.530, 0.232, DECK)),
        ring((0.880, 0.262, 0.282), (0.902, 0.258, 0.306), (0.890, 0.165, 0.338)),
    ]
    mesh.add_mesh(loft("paint", sections, 0.007))
    pods = [
        ring((0.205, 0.200, 0.080), (0.185, 0.270, 0.110), (0.150, 0.314, 0.190), (0.112, 0.314, 0.290)),
        ring((0.535, 0.200, 0.080), (0.550, 0.270, 0.110), (0.580, 0.314, 0.190), (0.622, 0.314, 0.290)),
    ]
    mesh.add_mesh(loft("paint", pods, 0.007))
    mesh.add_mesh(both(_side_marks()))
    mesh.add_mesh(_nose())
    mesh.add_mesh(_tail())
    return mesh


def _side_marks() -> Mesh:
    """Return a stripe along the left shoulder, and on the pod a name and three slots."""
    mesh = Mesh()
    name = Mesh()
    name.add_mesh(plate("UNIOR").scaled(0.44), rot_z(np.pi / 2))
    mesh.add_mesh(block("cover", (0.205, 0.308, 0.205), (0.535, 0.3165, 0.272), 0.002))
    mesh.add_mesh(name, None, (0.330, 0.313, 0.2385))
    for x in (0.475, 0.495, 0.515):
        slot = Polygon([(-x - 0.006, 0.215), (-x + 0.006, 0.215), (-x - 0.004, 0.262), (-x - 0.016, 0.262)])
        mesh.add_mesh(prism("alloy", slot, 0.0015), rot_z(np.pi / 2), (0.0, 0.3160, 0.0))
    return mesh


def _nose() -> Mesh:
    """Lamps of the nose, the laser on its box, the Kinect on its mast."""
    mesh = Mesh()
    lamp = Mesh()
    lamp.add_mesh(block("gloss_black", (0.884, 0.128, 0.289), (0.9045, 0.238, 0.317), 0.003))
    for y in (0.154, 0.183, 0.212):
        lamp.add_mesh(block("lamp_white", (0.890, y - 0.0115, 0.294), (0.9065, y + 0.0115, 0.312), 0.003))
    mesh.add_mesh(both(lamp))
    mesh.add_mesh(block("cover", (0.880, -0.110, 0.292), (0.9045, 0.110, 0.318), 0.003))

    # Hokuyo URG-04LX: a body of 50 mm width, its head with a dark window at the height of the scan.
    x, z = LASER
    mesh.add_mesh(block("alloy", (x - 0.045, -0.045, 0.325), (x + 0.040, 0.045, z - 0.053), 0.003))
    mesh.add_mesh(block("gloss_black", (x - 0.028, -0.028, z - 0.054), (x + 0.028, 0.028, z - 0.018), 0.004))
    mesh.add_mesh(can("cladding", 0.026, 0.010, 0.002), None, (x, 0.0, z - 0.020))
    mesh.add_mesh(can("lens", 0.0235, 0.024, 0.001), None, (x, 0.0, z - 0.012))
    mesh.add_mesh(can("gloss_black", 0.026, 0.013, 0.004), None, (x, 0.0, z + 0.010))

    # Kinect: a bar of 0.28 m with three lenses, on two legs.
    x, z = KINECT
    leg = [(x - 0.085, 0.075, 0.355), (x - 0.045, 0.032, z - 0.040)]
    mesh.add_mesh(both(tube("alloy", leg, 0.0085)))
    for y in (-0.075, 0.075):
        mesh.add_mesh(can("cover", 0.021, 0.018, 0.004, count=20), rot_y(0.20), (x - 0.086, y, 0.369))
    foot = [[(x - 0.075, s * 0.055, z - 0.046), (x - 0.012, s * 0.055, z - 0.046), (x - 0.020, s * 0.035, z - 0.020),
             (x - 0.062, s * 0.035, z - 0.020)] for s in (-1.0, 1.0)]  # fmt: skip
    mesh.add_mesh(loft("cover", foot, 0.004))
    bar = [[(x - 0.062, y, z - 0.022), (x - 0.003, y, z - 0.026), (x - 0.003, y, z + 0.026), (x - 0.066, y, z + 0.020)]
           for y in (-0.141, 0.141)]  # fmt: skip
    mesh.add_mesh(loft("casing", bar, 0.006))
    for y, size in ((0.078, 0.0165), (0.0, 0.0145), (-0.045, 0.0145)):
        eye = Mesh()
        rim = [(0.0, size + 0.0035), (0.003, size + 0.0035), (0.003, size)]
        eye.add_mesh(revolve("alloy", rim, 28, smooth=False))
        eye.add_mesh(revolve("lens", [(0.0022, size), (0.0022, 0.0)], 28, smooth=False))
        glint = revolve("lamp", [(0.0026, 0.24 * size), (0.0026, 0.0)], 12, smooth=False)
        eye.add_mesh(glint, None, (-0.35 * size, 0.0, 0.35 * size))
        mesh.add_mesh(eye, _Y_TO_X, (x - 0.003, y, z))
    mesh.add_mesh(block("lamp_red", (x - 0.005, -0.098, z - 0.004), (x, -0.086, z + 0.004), 0.001))
    return mesh


def _tail() -> Mesh:
    """The cover plate with its bolts and handles; behind it the GPS antenna, a stop button, radio antennas, lamps."""
    mesh = Mesh()
    plan = [(0.055, 0.155), (0.085, 0.190), (0.470, 0.190), (0.500, 0.155)]
    plan += [(x, -y) for x, y in plan[::-1]]
    mesh.add_mesh(slab("cover", plan, DECK - 0.004, DECK + 0.010, 0.003))
    for x, y in ((0.075, 0.150), (0.18, 0.176), (0.28, 0.176), (0.38, 0.176), (0.480, 0.150)):
        mesh.add_mesh(both(_moved(can("alloy", 0.0055, 0.004, 0.001, count=12), (x, y, DECK + 0.0095))))
    handle = [
        (0.20, 0.125, DECK + 0.006),
        (0.20, 0.125, DECK + 0.034),
        (0.36, 0.125, DECK + 0.034),
        (0.36, 0.125, DECK + 0.006),
    ]
    mesh.add_mesh(both(tube("alloy", handle, 0.006)))
    for x in (0.13, 0.155, 0.18, 0.205, 0.23, 0.255, 0.28, 0.305, 0.33, 0.355, 0.38, 0.405, 0.43):
        mesh.add_mesh(block("cladding", (x - 0.005, -0.085, DECK + 0.008), (x + 0.005, 0.085, DECK + 0.0145), 0.002))

    x, z = GPS
    mesh.add_mesh(can("cover", 0.030, 0.012, 0.003), None, (x, 0.0, DECK - 0.006))
    mesh.add_mesh(tube("alloy", [(x, 0.0, DECK), (x, 0.0, z - 0.030)], 0.009, count=16))
    mesh.add_mesh(can("cover", 0.040, 0.008, 0.002), None, (x, 0.0, z - 0.034))
    mesh.add_mesh(can("antenna", 0.052, 0.028, 0.010, count=40), None, (x, 0.0, z - 0.028))

    tilt = rot_y(-0.16)
    mesh.add_mesh(block("signal_yellow", (-0.092, 0.093, 0.380), (-0.038, 0.147, DECK + 0.004), 0.004))
    mesh.add_mesh(can("cladding", 0.012, 0.020, 0.002, count=20), tilt, (-0.065, 0.120, DECK + 0.002))
    mesh.add_mesh(can("lamp_red", 0.021, 0.013, 0.005, count=28), tilt, (-0.066, 0.120, DECK + 0.016))
    mesh.add_mesh(tube("gloss_black", [(-0.07, -0.13, 0.385), (-0.07, -0.13, 0.425)], 0.008))
    mesh.add_mesh(tube("gloss_black", [(-0.07, -0.13, 0.42), (-0.082, -0.13, 0.545)], 0.0048))

    lamp = Mesh()
    lamp.add_mesh(block("gloss_black", (-0.173, 0.150, 0.292), (-0.150, 0.262, 0.322), 0.003))
    lamp.add_mesh(block("lamp_red", (-0.1755, 0.156, 0.297), (-0.160, 0.256, 0.317), 0.003))
    mesh.add_mesh(both(lamp))
    mesh.add_mesh(block("cover", (-0.173, -0.125, 0.286), (-0.150, 0.125, 0.326), 0.003))
    mesh.add_mesh(plate("AVRORA").scaled(0.36), rot_z(np.pi), (-0.1715, 0.0, 0.306))
    return mesh


def _moved(mesh: Mesh, to: Sequence[float]) -> Mesh:
    result = Mesh()
    result.add_mesh(mesh, None, to)
    return result


def build_body() -> Mesh:
    """Return the body in the frame base_link."""
    mesh = Mesh()
    mesh.add_mesh(build_chassis())
    mesh.add_mesh(build_shell())
    return mesh


# --- wheel -------------------------------------------------------------------------------------------------------


def _lug(corners: Sequence[tuple[float, float]], low: float, high: Sequence[float]) -> Mesh:
    """Return a block of the tread: corners (angle [deg], y), from one radius up to that of each corner."""
    mesh = Mesh()
    foot, head = (
        np.array(
            [
                [r * np.cos(np.deg2rad(a)), y, r * np.sin(np.deg2rad(a))]
                for (a, y), r in zip(corners, radii, strict=True)
            ]
        )
        for radii in ([low] * len(corners), high)
    )
    middle = 0.5 * (foot.mean(axis=0) + head.mean(axis=0))
    quads = [head, *(np.stack([foot[i], foot[i - 1], head[i - 1], head[i]]) for i in range(len(corners)))]
    for quad in quads:
        normal = np.cross(quad[2] - quad[0], quad[3] - quad[1])
        normal *= np.sign(normal @ (quad.mean(axis=0) - middle)) / np.linalg.norm(normal)
        mesh.add_flat("rubber", quad[[[0, 1, 2], [0, 2, 3]]], normal.tolist())
    return mesh


def _tread() -> Iterator[Mesh]:
    """Two staggered rows of slanting lugs that end on the tyre's shoulders."""
    count = 15
    for k in range(2 * count):
        a, side = 180.0 * k / count, 1.0 if k % 2 else -1.0
        half, slant = 4.1, 5.0
        inner, outer, edge = -0.004 * side, 0.043 * side, HALF_WIDTH * side
        yield _lug([(a - half + slant, inner), (a + half + slant, inner), (a + half, outer), (a - half, outer)],
                   RADIUS - 0.014, [RADIUS] * 4)  # fmt: skip
        yield _lug([(a - half, outer), (a + half, outer), (a + half - 0.4, edge), (a - half + 0.4, edge)],
                   RADIUS - 0.024, [RADIUS, RADIUS, RADIUS - 0.010, RADIUS - 0.010])  # fmt: skip


def _rim_side() -> Mesh:
    """Return the rim as seen from the left, with marks on the tyre's flank that show its turning."""
    side = Mesh()
    lip = [
        (0.0465, RIM + 0.001),
        (0.0485, RIM - 0.003),
        (0.0485, RIM - 0.013),
        (0.044, RIM - 0.016),
        (0.010, RIM - 0.020),
    ]
    side.add_mesh(revolve("alloy", lip[:4], 48))
    side.add_mesh(revolve("rim_dark", lip[3:], 48))
    side.add_mesh(wheel_face("rim_shadow", Point(0, 0).buffer(RIM - 0.018, quad_segs=12), 0.012))
    for k in range(12):
        bolt = Point(polar(RIM - 0.008, 30.0 * k)).buffer(0.0028, quad_segs=3)
        side.add_mesh(wheel_face("rim_dark", bolt, 0.0500, skirt=0.0015))
    for k in range(5):
        c = 72.0 * k + 90.0
        arm = Polygon(
            [
                polar(r, c + s)
                for r, s in ((0.020, -42), (0.050, -12), (0.087, -15), (0.087, 15), (0.050, 12), (0.020, 42))
            ]
        )
        side.add_mesh(wheel_face("rim_dark", arm, 0.0395, skirt=0.016))
        face = arm.buffer(-0.0030, join_style="mitre")
        side.add_mesh(wheel_face("alloy", face, 0.0405))
        slot = Polygon([polar(r, c + s) for r, s in ((0.052, -4), (0.078, -6), (0.078, 6), (0.052, 4))])
        side.add_mesh(wheel_face("rim_shadow", slot, 0.0412))
    side.add_mesh(wheel_face("rim_dark", Point(0, 0).buffer(0.028, quad_segs=8), 0.0430, skirt=0.012))
    for k in range(5):
        nut = Point(polar(0.0215, 72.0 * k + 54.0)).buffer(0.0032, quad_segs=2)
        side.add_mesh(wheel_face("alloy", nut, 0.0455, skirt=0.003))
    side.add_mesh(wheel_face("paint", Point(0, 0).buffer(0.0155, quad_segs=8), 0.0470, skirt=0.005))
    side.add_mesh(wheel_face("stripe", sector(0.003, 0.012, 65.0, 115.0, count=5), 0.0476))
    side.add_mesh(
        wheel_face("signal_yellow", Point(polar(0.080, 126.0)).buffer(0.0045, quad_segs=4), 0.034, skirt=0.02)
    )
    for start in (60.0, 240.0):
        side.add_mesh(
            wheel_face("rubber_mark", sector(RIM + 0.0035, RIM + 0.0075, start, start + 60.0, count=12), 0.0529)
        )
    return side


def build_wheel() -> Mesh:
    """Return the wheel about its centre, alike from both sides."""
    mesh = Mesh()
    flank = [(-0.044, RIM - 0.002), (-0.050, RIM + 0.002), (-0.0525, RIM + 0.008), (-0.0515, RADIUS - 0.016),
             (-0.044, RADIUS - 0.0105), (-0.020, RADIUS - 0.0095)]  # fmt: skip
    flank += [(-y, r) for y, r in flank[::-1]]
    mesh.add_mesh(revolve("rubber", flank, 60))
    for lug in _tread():
        mesh.add_mesh(lug)
    side = _rim_side()
    mesh.add_mesh(side)
    mesh.add_mesh(side.mirrored())
    return mesh


def write(folder: Path) -> dict[str, Mesh]:
    """Write both meshes into a folder; return them by name."""
    meshes = {"wheel": build_wheel(), "body": build_body()}
    write_meshes(folder, meshes, materials=MATERIALS, generator="mirdrake tools/meshes/unior.py")
    return meshes


if __name__ == "__main__":
    target = Path(__file__).resolve().parents[2] / "models" / "unior" / "meshes"
    for line in describe(target, write(target)):
        print(line)
