"""Contact shape of a wheel.

Vehicle files have a cylinder. In a simulation it has two faults, both measured:

- point contact on a plane has no unique deepest point along the cylinder's lower edge, so the contact point jumps
  sideways; an ellipsoid with the same radius and half width has one point and rolls identically;
- Drake meshes a hydroelastic cylinder into tetrahedra that differ from facet to facet, so the wheel rides over
  bumps (up to 1.5 mm at 20 m/s with resolution hint 0.1 m). A wedge mesh, the same around the circumference, is ten
  times smoother with as many contact polygons.

The tread is flat, with two rows of triangles. A wheel with inclination γ is compressed more on the side to which its
top is inclined. In a discrete step, with one pressure per triangle, the load moves to that side by w² γ / (24 d), with
the width w and the depth d: this is the overturning moment of a patch, for a car about that of a load below the
wheel's centre. On the ellipsoid the contact point moves by (w/2)² γ / R.
"""

from itertools import pairwise
from math import cos, pi, sin, sqrt
from typing import Literal

from pydrake.common import MemoryFile
from pydrake.geometry import Ellipsoid, InMemoryMesh, Mesh, Shape

ContactModel = Literal["hydroelastic", "point", "tyre"]

SEGMENTS = 64
"""Number of sectors around the circumference. At depths of 4 to 12 mm the load differs from the closed form of a round
wheel by up to 1.4 %, by 0.8 % from one angle to another; with 32 by 5 and 9 %."""

Point = tuple[float, float, float]


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
    contents = write_wheel_vtk(radius=radius, width=width, segments=SEGMENTS, mirrored=mirrored)
    return Mesh(InMemoryMesh(mesh_file=MemoryFile(contents, ".vtk", "wheel")))


def write_wheel_vtk(*, radius: float, width: float, segments: int, mirrored: bool = False) -> str:
    """Return a solid wheel as a tetrahedral VTK file (legacy ASCII text).

    The pressure is largest at the centre and zero on the surface. Below the tread the hydroelastic pressure
    therefore grows linearly with depth, E·depth/radius, evenly across the width. One inner point needs the fewest
    tetrahedra, four per sector, and the cost of contact is proportional to the number of polygons.

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
    points = [*right, *left, (0.0, 0.0, 0.0), (0.0, -width / 2.0, 0.0), (0.0, width / 2.0, 0.0)]
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
