"""Contact shape of a wheel.

Vehicle files have a cylinder. In a simulation it has two faults, both measured:

- point contact on a plane has no unique deepest point along the cylinder's lower edge, so the contact point jumps
  sideways; an ellipsoid with the same radius and half width has one point and rolls identically;
- Drake meshes a hydroelastic cylinder into tetrahedra that differ from facet to facet, so the wheel rides over
  bumps (up to 1.5 mm at 20 m/s with resolution hint 0.1 m). A wedge mesh, the same around the circumference, is ten
  times smoother with as many contact polygons.

Both bear the load in the middle plane of the wheel, or nearly so. The mesh is half as wide as the wheel: a wheel with
inclination γ is compressed more on the side to which its top is inclined, and in a discrete step, with one pressure per
triangle, the load moves to that side by w² γ / (36 d), with the width w of the mesh and the depth d. On an ellipsoid
of the width w the contact point moves by (w² / (4 R) - d / 2) γ from the wheel plane on the road. The tyre step
(:mod:`mirdrake.plant.wheels.step`) removes the moment of both.

The pressure is p = E (1 - r / R) at the distance r from the axle, down to zero at the sides. The sides are concave,
so that the pressure does not rise upwards near them. Drake ignores such parts of a patch, which leaves the share
1 - p / E of the width. On a plane at the depth d, with the half length a of the patch and the height h = R - d of the
axle, the load is::

    N = E w ∫ (p / E - (p / E)²) dx = E w (a + h² asinh(a / h) / R - 2 a h² / R² - 2 a³ / (3 R²)),    a² = R² - h²

With an inclination γ the distances are those in the wheel plane, and the ends of the patch move with the height of the
axle over each line of it. To second order in γ the load is larger by the share γ² / 2, as the plane cuts the wheel
obliquely, and by::

    γ² E w³ (2 a R + 6 h² asinh(a / h) - 16 a³ / (9 R) - 16 a h² / R + 4 h² R / (3 a)) / (16 R³)

In a discrete step Drake takes the area of the patch at its beginning and the pressure at its end. The load thus changes
with the depth by 2 E w a h / R².

The modulus E is chosen so that a tyre has the deflection of its vertical stiffness at the static load; the tyre step
adds what the patch lacks elsewhere.
"""

from itertools import pairwise
from math import asinh, copysign, cos, pi, sin, sqrt

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


def patch_size(radius: float, depth: float, inclination: float = 0.0, width: float = 0.0) -> float:
    """Return the load of a patch over modulus and width of the mesh [m]; :mod:`mirdrake.core.compiled` can compile it.

    Args:
        radius: of the wheel [m].
        depth: of the patch in the wheel plane, positive and less than the radius [m].
        inclination: of the wheel [rad].
        width: of the mesh [m]; an upright wheel needs none.
    """
    height = radius - depth
    half = sqrt(depth * (radius + height))
    share, angle = height / radius, asinh(half / height)
    size = half * (1.0 - 2.0 * share * share - 2.0 / 3.0 * (half / radius) ** 2) + height * share * angle
    # Where one side of the wheel loses the road, the load hardly increases any more.
    lean = min(abs(inclination) * width, 2.0 * depth)
    wider = (
        2.0 * half * radius
        + 6.0 * height * height * angle
        - 16.0 * half * (half * half / 9.0 + height * height) / radius
    )
    wider += 4.0 / 3.0 * height * height * radius / half
    return size * (1.0 + 0.5 * inclination * inclination) + lean * lean * wider / (16.0 * radius**3)


def patch_slope(radius: float, depth: float) -> float:
    """Return the change of :func:`patch_size` by the change of depth in a step; arguments as there."""
    height = radius - depth
    return 2.0 * sqrt(depth * (radius + height)) * height / (radius * radius)


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
