"""Path of a wheel on the arms of its suspension, as functions of the wheel travel (kinematics of K&C tables).

The suspension joint of the plant moves a wheel along z of the vehicle frame B. Real arms also steer the wheel, incline
it, and move its contact point ahead and sideways. These four functions of the travel z are prescribed, so the arms are
a mechanism without mass: by virtual work, the forces F and the moment Mz of the road and the torque Tb of the brake
act on the travel with

    Q = Fx dx/dz + Fy dy/dz + Fz + Mz dτ/dz + Tb dθ/dz,

and the contact point has the velocity (dx/dz, dy/dz, 1) z'. Power of the road is thus that of the slip alone.

- y: the contact point moves at right angles to the line to the roll centre at the height h, seen from behind:
  dy/dz = 2 h / T at a left wheel, -2 h / T at a right one, with the track T. The arms thereby transmit Fy h / T of the
  load transfer of an axle (W. F. and D. L. Milliken, Race Car Vehicle Dynamics, chapters 17 and 18).
- x: dx/dz is the slope of the line from the wheel centre to the instant centre, seen from the side: `anti_drive`.
- θ: rotation of the wheel carrier about the axle. A brake is fixed to the carrier, so a braking force Tb / R acts as if
  at the contact point, with dx/dz + R dθ/dz = `anti_brake`. A motor drives through half shafts and is fixed to the
  body: its torque has no such part (T. Gillespie, Fundamentals of Vehicle Dynamics, chapter 7).

Tables are interpolated by monotone cubics (F. N. Fritsch and R. E. Carlson, Monotone piecewise cubic interpolation,
SIAM Journal on Numerical Analysis 17, 1980) with continuous slopes, and continued by straight lines. Not modelled: the
inertia of the motions besides z, and gyroscopic moments.
"""

from collections.abc import Sequence
from math import sin
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import scipy  # it imports its parts when they are first used

from mirdrake.vehicles import WHEELS, Vehicle

Row = tuple[
    float, float, float, float, float, float, float, float, float, float, float, float, float, float, float, float
]
"""Values at the nodes of a table; those behind the last node are zeros."""

_SIZE = 16  # numbers of a Row
_NOTHING: Row = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class Arms(NamedTuple):
    """Arms of a wheel: nodes of the travel, with values and slopes of each quantity there.

    Attributes:
        nodes: number of nodes; zero: the wheel moves along z only.
        radius: unloaded radius of the wheel [m].
        inclination: inclination of the wheel at rest [rad].
        travel: travel at each node [m].
        toe: steering angle of the wheel, positive to the left [rad].
        toe_slope: [rad/m].
        lean: inclination, positive when the top of the wheel is inclined to the right [rad].
        lean_slope: [rad/m].
        x: displacement of the wheel ahead [m].
        x_slope: [1].
        y: displacement of the contact point to the left [m].
        y_slope: [1].
        brake_slope: slope of the path ahead for braking forces [1].
        brake_change: its derivative [1/m].
    """

    nodes: int
    radius: float
    inclination: float
    travel: Row
    toe: Row
    toe_slope: Row
    lean: Row
    lean_slope: Row
    x: Row
    x_slope: Row
    y: Row
    y_slope: Row
    brake_slope: Row
    brake_change: Row


NO_ARMS = Arms(0, 0.0, 0.0, *(_NOTHING,) * 11)
"""A wheel that moves along z only."""


class ArmMotion(NamedTuple):
    """Displacement of a wheel by its arms at a travel, and its derivatives by the travel.

    Attributes:
        toe: steering angle [rad].
        lean: inclination [rad].
        x: displacement of the wheel centre ahead [m].
        y: the same to the left [m].
        toe_rate: [rad/m].
        lean_rate: [rad/m].
        x_rate: of the contact point with a wheel that is not braked [1].
        y_rate: of the contact point [1].
        brake_rate: as `x_rate`, with a braked wheel [1].
    """

    toe: float
    lean: float
    x: float
    y: float
    toe_rate: float
    lean_rate: float
    x_rate: float
    y_rate: float
    brake_rate: float


def arm_motion(arms: Any, z: float) -> ArmMotion:
    """Return the displacement of a wheel by its :class:`Arms` at a travel [m]."""
    if arms.nodes == 0:
        return ArmMotion(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    last = arms.nodes - 1
    cell = 0
    while cell < last - 1 and z > arms.travel[cell + 1]:
        cell += 1
    # Straight lines before the first and behind the last node.
    if last == 0 or z <= arms.travel[0] or z >= arms.travel[last]:
        node = last if z > arms.travel[0] else 0
        s = z - arms.travel[node]
        toe, toe_rate = arms.toe[node] + s * arms.toe_slope[node], arms.toe_slope[node]
        lean, lean_rate = arms.lean[node] + s * arms.lean_slope[node], arms.lean_slope[node]
        x, x_rate = arms.x[node] + s * arms.x_slope[node], arms.x_slope[node]
        y, y_rate = arms.y[node] + s * arms.y_slope[node], arms.y_slope[node]
        brake_rate = arms.brake_slope[node] + s * arms.brake_change[node]
    else:
        z0, z1 = arms.travel[cell], arms.travel[cell + 1]
        toe, toe_rate = _cubic(arms.toe, arms.toe_slope, cell, z0, z1, z)
        lean, lean_rate = _cubic(arms.lean, arms.lean_slope, cell, z0, z1, z)
        x, x_rate = _cubic(arms.x, arms.x_slope, cell, z0, z1, z)
        y, y_rate = _cubic(arms.y, arms.y_slope, cell, z0, z1, z)
        brake_rate, _ = _cubic(arms.brake_slope, arms.brake_change, cell, z0, z1, z)
    # The wheel turns about its contact point, whose path is given.
    y -= arms.radius * (sin(lean) - sin(arms.inclination))
    return ArmMotion(toe, lean, x, y, toe_rate, lean_rate, x_rate, y_rate, brake_rate)


def _cubic(
    values: Sequence[float], slopes: Sequence[float], cell: int, z0: float, z1: float, z: float
) -> tuple[float, float]:
    """Return value and slope of the cubic with given values and slopes at z0 and z1 (Hermite)."""
    h = z1 - z0
    s = (z - z0) / h
    rise = values[cell + 1] - values[cell]
    a, b = h * slopes[cell] - rise, rise - h * slopes[cell + 1]
    value: float = values[cell] + s * (rise + (1.0 - s) * (a * (1.0 - s) + b * s))
    slope: float = (rise + (1.0 - 2.0 * s) * (a * (1.0 - s) + b * s) + s * (1.0 - s) * (b - a)) / h
    return value, slope


ARM_PARTS = (arm_motion, _cubic)
"""Functions that :mod:`mirdrake.core.compiled` compiles for a step."""


def make_arms(vehicle: Vehicle) -> list[Arms]:
    """Return the arms of the wheels of a vehicle, in the order of :data:`mirdrake.vehicles.WHEELS`."""
    springs, geometry = vehicle.spec.suspension, vehicle.geometry
    if springs is None:
        return [NO_ARMS] * len(WHEELS)
    result = []
    for index, axle in enumerate(springs.corners()):
        tables = (axle.toe, axle.camber, axle.anti_drive, axle.roll_centre, axle.anti_brake)
        if not any(tables):
            result.append(NO_ARMS)
            continue
        side, end = (1.0 if index % 2 == 0 else -1.0), (1.0 if index < 2 else -1.0)
        track = geometry.rear_track if index >= 2 else geometry.front_track
        z = np.array(sorted({travel for table in tables for travel, _ in table}))
        (toe, toes), (camber, cambers), (drive, _), (height, _), (brake, brakes) = (_at(table, z) for table in tables)
        # Toe-in turns a left wheel to the right; positive camber inclines its top outwards, to the left. The slopes of
        # the path have the signs of the forces that support the body: braking presses front wheels down, away from it.
        ahead, across = end * drive, side * 2.0 / track * height
        rows = [z, -side * toe, -side * toes, -side * camber, -side * cambers]
        rows += [_path(axle.anti_drive, z, end), ahead, _path(axle.roll_centre, z, side * 2.0 / track), across]
        rows += [end * brake, end * brakes]
        lean = float(-side * _at(axle.camber, np.zeros(1))[0][0])
        result.append(Arms(len(z), geometry.wheel_radii[index], lean, *(_row(values) for values in rows)))
    return result


Array = npt.NDArray[np.float64]
Table = Sequence[tuple[float, float]]


def _row(values: Array) -> Row:
    """Return the values at the nodes as a Row."""
    padded: Any = (*values.tolist(), *_NOTHING)[:_SIZE]
    return padded  # type: ignore[no-any-return]


def _at(table: Table, z: Array) -> tuple[Array, Array]:
    """Return values and slopes of a table at travels; an empty table is zero, a table with one row constant."""
    if len(table) < 2:
        return np.full(len(z), table[0][1] if table else 0.0), np.zeros(len(z))
    travel, values = np.array(table).T
    curve = scipy.interpolate.PchipInterpolator(travel, values)
    inside = np.clip(z, travel[0], travel[-1])
    slopes = curve.derivative()(inside)
    return curve(inside) + slopes * (z - inside), slopes


def _path(table: Table, z: Array, factor: float) -> Array:
    """Return the integral of a table from travel zero to other travels [m], times a factor."""
    # Gauss-Legendre with four points is exact on each cubic, and the table has kinks of the second derivative at rows.
    nodes = np.unique(np.concatenate([[0.0], z, [travel for travel, _ in table]]))
    points, weights = np.polynomial.legendre.leggauss(4)
    middle, half = 0.5 * (nodes[1:] + nodes[:-1]), 0.5 * np.diff(nodes)
    values = _at(table, (middle[:, None] + half[:, None] * points).ravel())[0].reshape(-1, len(points))
    integral = np.concatenate([[0.0], np.cumsum(half * (values @ weights))])
    path: Array = factor * (np.interp(z, nodes, integral) - np.interp(0.0, nodes, integral))
    return path
