"""Contact shape of a wheel.

Vehicle files have a cylinder. In a simulation it has two faults, both measured:

- point contact on a plane has no unique deepest point along the cylinder's lower edge, so the contact point jumps
  sideways; an ellipsoid with the same radius and half width has one point and rolls identically;
- Drake meshes a hydroelastic cylinder into tetrahedra that differ from facet to facet, so the wheel rides over
  bumps (up to 1.5 mm at 20 m/s with resolution hint 0.1 m). A wedge mesh, the same around the circumference, is ten
  times smoother with as many contact polygons.

Both bear the load in the middle plane of the wheel, or nearly so. The mesh is half as wide as the wheel: a wheel with
inclination γ is compressed more on the side to which its top is inclined, so the load moves to that side: on the Bolt
by 1.7 mm at a depth of 18 mm and an inclination of 0.08, and by 22 mm at a depth of 2 mm. On an ellipsoid of the width
w the contact point moves by (w² / (4 R) - d / 2) γ from the wheel plane on the road. The tyre step
(:mod:`mirdrake.plant.wheels.step`) removes the moment of both.

The pressure is p = E (1 - r / R) at the distance r from the axle, down to zero at the sides. The sides are concave,
so that the pressure does not rise upwards near them. Drake ignores such parts of a patch, which leaves the share
1 - p / E of the width. On a plane at the depth d, with the half length a of the patch and the height h = R - d of the
axle, the load is::

    N = E w ∫ (p / E - (p / E)²) dx = E w (a + h² asinh(a / h) / R - 2 a h² / R² - 2 a³ / (3 R²)),    a² = R² - h²

In a discrete step Drake takes the area of each polygon of the patch at the beginning of the step and the pressure at
its end; the force of a polygon acts at its centroid. :func:`patch_load` adds up these forces for a mesh on a plane. It
differs from the closed form by up to 0.1 %, as the tread has facets; on an inclined wheel it is up to 2 % of the static
load more, as the lower side touches the road where the middle does not.

The modulus E is chosen so that a tyre has the deflection of its vertical stiffness at the static load; the tyre step
adds what the patch lacks elsewhere.
"""

from itertools import pairwise
from math import acos, asinh, ceil, copysign, cos, floor, pi, sin, sqrt

from pydrake.common import MemoryFile
from pydrake.geometry import Ellipsoid, InMemoryMesh, Mesh, Shape

from mirdrake.core.contacts import ContactModel

SEGMENTS = 64
"""Number of sectors around the circumference. At depths of 3 to 9 % of the radius the load differs from the closed
form by at most 0.1 % at every angle, also of a wheel inclined by 5 degrees; with 32 by 2 %."""

TREAD = 0.5
"""Width of the mesh over that of the wheel [1]."""

DISH = 0.1
"""Depth by which the middles of the sides are inside of the edges of the tread over the radius [1]. A wheel that is
inclined by more than this angle bears load on its side."""

LEAST_DEPTH = 0.02
"""Least depth of a patch under the static load over the radius [1]: a shallower one is on one or two facets. Stiffer
tyres have the deflection of this depth in hydroelastic contact."""

Point = tuple[float, float, float]


def usual_stiffness(load: float, radius: float) -> float:
    """Return the vertical stiffness of a tyre whose file has none [N/m]: the depth at rest is :data:`LEAST_DEPTH`.

    Args:
        load: at rest [N].
        radius: of the wheel [m].
    """
    return load / (LEAST_DEPTH * radius)


def make_wheel_shape(contact: ContactModel, *, radius: float, width: float, mirrored: bool = False) -> Shape:
    """Return the contact shape of a wheel whose spin axis is the y axis of its frame.

    Args:
        contact: "hydroelastic" gives a compliant volume mesh, the others an ellipsoid.
        radius: outer radius [m].
        width: width of the tread [m].
        mirrored: whether the wheel is on the right side, see :func:`write_wheel_vtk`.
    """
    if contact != "hydroelastic":
        return Ellipsoid(radius, width / 2.0, radius)
    contents = write_wheel_vtk(radius=radius, width=TREAD * width, segments=SEGMENTS, mirrored=mirrored)
    return Mesh(InMemoryMesh(mesh_file=MemoryFile(contents, ".vtk", "wheel")))


def patch_size(radius: float, depth: float) -> float:
    """Return the load of a patch of an upright wheel over modulus and width of the mesh [m].

    Args:
        radius: of the wheel [m].
        depth: of the patch, positive and less than the radius [m].
    """
    height = radius - depth
    half = sqrt(depth * (radius + height))
    share = height / radius
    return half * (1.0 - 2.0 * share * share - 2.0 / 3.0 * (half / radius) ** 2) + height * share * asinh(half / height)


def patch_load(
    radius: float, width: float, height: float, sine: float, pitch: float, drop: float
) -> tuple[float, float]:
    """Return load and overturning moment of a mesh on a plane; :mod:`mirdrake.core.compiled` can compile it.

    Each polygon is the section of a tetrahedron, of two surface triangles of a facet and the centre, with the plane.

    Args:
        radius: of the wheel [m].
        width: of the mesh [m]; negative if it is mirrored, see :func:`write_wheel_vtk`.
        height: of the centre of the wheel above the plane [m].
        sine: that of the inclination; positive if the top is inclined to the right [1].
        pitch: rotation of the mesh about the axle, positive if its lowest point moved ahead [rad].
        drop: by which the wheel sinks in the step, with the area of each polygon unchanged [m].

    Returns:
        Load [m²], and its moment about the direction ahead at the contact centre [m³], both over the modulus.
    """
    sector = 2.0 * pi / SEGMENTS
    corner, cosine, side = radius * sqrt(sector / sin(sector)), sqrt(1.0 - sine * sine), 0.5 * width
    lowest = (height - abs(side * sine)) / (corner * cosine)
    if lowest >= 1.0:
        return 0.0, 0.0
    reach, contact = acos(lowest), height * sine / cosine
    load, moment = 0.0, 0.0
    first, last = ceil((-reach - pitch) / sector - 0.5), floor((reach - pitch) / sector + 0.5)
    for facet in range(first, last + 1):
        middle = pitch + facet * sector
        # The pressure of a facet is p = E (1 - n r / (n r of its surface)), with its normal n.
        rise = drop * cos(middle) * cosine / (corner * cos(0.5 * sector))
        # Corners: behind and ahead, each at -y and at y of the mesh. Ahead, to the left, and height of each.
        xi, di = corner * sin(middle - 0.5 * sector), corner * cos(middle - 0.5 * sector)
        xj, dj = corner * sin(middle + 0.5 * sector), corner * cos(middle + 0.5 * sector)
        a = (xi, di * sine - side * cosine, height - di * cosine - side * sine)
        b = (xj, dj * sine - side * cosine, height - dj * cosine - side * sine)
        c = (xi, di * sine + side * cosine, height - di * cosine + side * sine)
        d = (xj, dj * sine + side * cosine, height - dj * cosine + side * sine)
        for triangle in ((a, b, c), (b, d, c)):
            area, across, share = _section(triangle[0], triangle[1], triangle[2], height)
            force = area * max(share + rise, 0.0)
            load += force
            moment += force * (across - contact)
    return load, moment


def _section(a: Point, b: Point, c: Point, height: float) -> tuple[float, float, float]:
    """Return the section of a tetrahedron with the plane: area [m²], lateral place of its centroid [m], p / E there.

    Args:
        a: corner at the surface [m].
        b: another.
        c: the third.
        height: that of the fourth corner, in the axle above the origin, where p = E [m].
    """
    below = (1 if a[2] < 0.0 else 0) + (1 if b[2] < 0.0 else 0) + (1 if c[2] < 0.0 else 0)
    if below == 0:
        return 0.0, 0.0, 0.0
    # The first corner is the only one of its side of the plane, if there is one.
    for _ in range(2):
        if below < 3 and (a[2] < 0.0) != (below == 1):
            a, b, c = b, c, a
    if below == 1:
        p, q, r = _to_centre(a, height), _between(a, b), _between(a, c)
        return _triangle(p, q, r)
    if below == 3:
        return _triangle(_to_centre(a, height), _to_centre(b, height), _to_centre(c, height))
    p, q = _to_centre(b, height), _to_centre(c, height)
    r, s = _between(c, a), _between(b, a)
    one, y_one, share_one = _triangle(p, q, r)
    two, y_two, share_two = _triangle(p, r, s)
    area = one + two
    if area <= 0.0:
        return 0.0, 0.0, 0.0
    return area, (one * y_one + two * y_two) / area, (one * share_one + two * share_two) / area


def _to_centre(corner: Point, height: float) -> Point:
    """Return where the edge from the centre to a lower corner meets the plane: ahead [m], to the left [m], p / E."""
    part = height / (height - corner[2])
    return part * corner[0], part * corner[1], 1.0 - part


def _between(a: Point, b: Point) -> Point:
    """Return where an edge of the surface meets the plane: ahead [m], to the left [m], p / E = 0."""
    part = a[2] / (a[2] - b[2])
    return a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1]), 0.0


def _triangle(p: Point, q: Point, r: Point) -> tuple[float, float, float]:
    """Return area [m²], lateral place of the centroid [m], and p / E there, of a triangle in the plane."""
    area = 0.5 * abs((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]))
    return area, (p[1] + q[1] + r[1]) / 3.0, (p[2] + q[2] + r[2]) / 3.0


PATCH_PARTS = (patch_load, _section, _to_centre, _between, _triangle)
"""Functions of :func:`patch_load`, with itself, to be compiled."""


def write_wheel_vtk(*, radius: float, width: float, segments: int, mirrored: bool = False) -> str:
    """Return a solid wheel as a tetrahedral VTK file (legacy ASCII text).

    The pressure is largest at the centre and zero on the surface. One inner point needs the fewest tetrahedra, four per
    sector, and the cost of contact is proportional to the number of polygons.

    All sectors are cut along the same diagonal of the tread, so that the load of a rolling wheel acts some millimetres
    off centre, in proportion to speed times step. A right wheel is therefore the mirror image of a left one, which
    avoids a roll moment.

    Args:
        radius: outer radius [m].
        width: width along y [m].
        segments: number of equal sectors around the axle.
        mirrored: whether the mesh is mirrored at the plane y = 0.
    """
    sector = 2.0 * pi / segments
    corner = radius * sqrt(sector / sin(sector))  # the polygon has the area of the circle
    # In the design position the middle of a facet is straight below the axle, not a corner.
    angles = [sector * (i + 0.5) for i in range(segments)]
    width = -width if mirrored else width
    right: list[Point] = [(corner * cos(a), -width / 2.0, corner * sin(a)) for a in angles]
    left: list[Point] = [(x, -y, z) for x, y, z in right]
    side = 0.5 * width - copysign(min(DISH * radius, 0.4 * abs(width)), width)
    points = [*right, *left, (0.0, 0.0, 0.0), (0.0, -side, 0.0), (0.0, side, 0.0)]
    # Pressure is interpolated between the centre (largest) and all other points (zero).
    centre, cap_right, cap_left = range(2 * segments, 2 * segments + 3)

    # Two wedges and two caps for each facet, all with the corner in the centre.
    cells: list[tuple[int, int, int, int]] = []
    for i, j in pairwise([*range(segments), 0]):
        right_i, right_j, left_i, left_j = i, j, segments + i, segments + j
        cells += [
            (right_i, right_j, left_i, centre),
            (right_j, left_i, left_j, centre),
            (right_i, right_j, cap_right, centre),
            (left_i, left_j, cap_left, centre),
        ]
    # Drake needs tetrahedra with positive volume; mirroring turns them inside out.
    oriented = [cell if _volume(points, cell) > 0.0 else (cell[0], cell[2], cell[1], cell[3]) for cell in cells]
    lines = [
        "# vtk DataFile Version 3.0",
        "wheel",
        "ASCII",
        "DATASET UNSTRUCTURED_GRID",
        f"POINTS {len(points)} double",
        *(f"{x!r} {y!r} {z!r}" for x, y, z in points),
        f"CELLS {len(cells)} {5 * len(cells)}",
        *("4 {} {} {} {}".format(*cell) for cell in oriented),
        f"CELL_TYPES {len(cells)}",
        *(["10"] * len(cells)),
    ]
    return "\n".join(lines) + "\n"


def _volume(points: list[Point], cell: tuple[int, int, int, int]) -> float:
    """Return six times the signed volume of a tetrahedron [m³]."""
    a, b, c, d = (points[index] for index in cell)
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    wx, wy, wz = d[0] - a[0], d[1] - a[1], d[2] - a[2]
    return (uy * vz - uz * vy) * wx + (uz * vx - ux * vz) * wy + (ux * vy - uy * vx) * wz
