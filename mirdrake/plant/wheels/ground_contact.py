"""Contact of a wheel with uneven ground: effective plane, motion of the contact point, generalised forces.

The wheel is a disc in its middle plane. On a plane its deflection d is measured along the disc, and the contact centre
is the point of the plane that is nearest to the wheel centre in the disc. On uneven ground the plane is replaced by an
effective one. The tyre is a ring of radial springs (D. C. Davis, A radial-spring terrain-enveloping tire model, Vehicle
System Dynamics 4, 1975), whose energy is mapped to that of the tyre on a plane. Over the area A of the disc below the
ground, with r from the wheel centre and the radius R::

    P = ∫ (R² - r²) / 2 dA,    S = ∫ r dA = dP / d(wheel centre)

For small deflections P / R is the energy of springs of unit stiffness, and -S / R their force. On a plane
P' = S = 2/3 (2 R d - d²)^1.5.

- The effective deflection d is that of a plane with the same P. A tyre with the energy U(d) on a plane thus has U on
  uneven ground as well, and the force -U'(d) S / S_plane(d).
- The effective normal is the direction of -S. A sharp edge thus pushes towards the wheel centre.
- The share |S| / S_plane(d) is 1 on a plane, smaller on an edge and larger in a hollow.

So the force is conservative: no shape of the ground gives energy to a rolling tyre or takes it, except by its damping.
The tyre envelops short waves and bridges gaps. Both integrals are sums over samples along the disc of the difference to
the tangent plane below the wheel, plus the closed form of that plane, so they are exact on every plane.
Where the disc is far from the ground, only every eighth sample is taken.
Two rows of samples at the Gauss points of the width, ± w / (2 √3), see an obstacle under one side of the tyre. It
changes the deflection and tilts the effective plane. The force still acts in the middle plane of the wheel.
"""

from collections.abc import MutableSequence, Sequence
from math import acos, asin, sin, sqrt
from typing import NamedTuple

import numpy as np

from mirdrake.ground.layers import TerrainData, ground_at, ground_heights
from mirdrake.plant.wheels.motion import BaseMotion, WheelPlace, lean_moment, wheel_pose

_REACH = 0.92  # half of the sampled chord over the radius: obstacles up to 0.6 R high [1]
_STRIDE, _GAP = 8, 0.02  # every eighth sample is taken; those between only where the disc is nearer to the ground [m]
_GAUSS = 0.5 / sqrt(3.0)  # distance of the rows from the middle over the width [1]
_GRADE = 0.5  # largest slope of the tangent plane along the disc [1]
_STEEP = 0.2  # smallest cosine between wheel plane and vertical
# A fixed number of iterations: the parabola of the first guess is near, and the time per step is constant.
_NEWTON = 4
_SMALL = 1e-12


class GroundContact(NamedTuple):
    """Contact of a wheel with the ground, in the world.

    Attributes:
        deflection: deflection of the tyre [m]; negative: distance of the disc from the ground, if that is a plane.
        rate: speed of the wheel centre towards the effective plane [m/s].
        axle: direction of the axle, to the left (3).
        up: direction of steering axis and suspension (3).
        ahead: x axis of the tyre, on the effective plane (3).
        left: y axis of the tyre (3).
        normal: normal of the effective plane (3).
        arm_base: contact centre from the vehicle frame's origin (3) [m].
        arm_pivot: contact centre from the steering axis (3) [m].
        inclination: inclination of the wheel plane to the effective plane [rad].
        vx: speed of the contact centre ahead, as a point of the wheel carrier [m/s].
        vy: the same to the left [m/s].
        turn: angular velocity of the wheel carrier about the normal [rad/s].
        rolling: effective rolling radius [m].
        spin: spin of the wheel, relative to its carrier [rad/s].
        path: derivative of the contact centre by the travel (3) [1].
        braked: see :class:`mirdrake.plant.wheels.motion.WheelMotion`.
        toe: the same.
        lean: the same.
        rise: vertical velocity of the wheel centre [m/s].
        share: force over that of the deflection on a plane [1].
    """

    deflection: float
    rate: float
    axle: tuple[float, float, float]
    up: tuple[float, float, float]
    ahead: tuple[float, float, float]
    left: tuple[float, float, float]
    normal: tuple[float, float, float]
    arm_base: tuple[float, float, float]
    arm_pivot: tuple[float, float, float]
    inclination: float
    vx: float
    vy: float
    turn: float
    rolling: float
    spin: float
    path: tuple[float, float, float]
    braked: float
    toe: float
    lean: float
    rise: float
    share: float


CONTACT_SIZE = 37
"""Numbers of a :class:`GroundContact`."""


def pack_contact(row: MutableSequence[float], contact: GroundContact) -> None:
    """Write a contact into a row of :data:`CONTACT_SIZE` numbers."""
    row[0], row[1], row[2], row[3] = contact.deflection, contact.rate, contact.inclination, contact.vx
    row[4], row[5], row[6], row[7] = contact.vy, contact.turn, contact.rolling, contact.spin
    for i in range(3):
        row[8 + i], row[11 + i], row[14 + i] = contact.axle[i], contact.up[i], contact.ahead[i]
        row[17 + i], row[20 + i] = contact.left[i], contact.normal[i]
        row[23 + i], row[26 + i], row[29 + i] = contact.arm_base[i], contact.arm_pivot[i], contact.path[i]
    row[32], row[33], row[34] = contact.braked, contact.toe, contact.lean
    row[35], row[36] = contact.rise, contact.share


def unpack_contact(row: Sequence[float]) -> GroundContact:
    """Return the contact in a row of :func:`pack_contact`."""
    # Written out, since Numba cannot make a tuple of known length from a slice of an array.
    return GroundContact(
        row[0],
        row[1],
        (row[8], row[9], row[10]),
        (row[11], row[12], row[13]),
        (row[14], row[15], row[16]),
        (row[17], row[18], row[19]),
        (row[20], row[21], row[22]),
        (row[23], row[24], row[25]),
        (row[26], row[27], row[28]),
        row[2],
        row[3],
        row[4],
        row[5],
        row[6],
        row[7],
        (row[29], row[30], row[31]),
        row[32],
        row[33],
        row[34],
        row[35],
        row[36],
    )


class EffectivePlane(NamedTuple):
    """Ground under a disc as a plane.

    Attributes:
        deflection: see :class:`GroundContact` [m].
        slope: x component of its normal in the disc, x horizontal ahead, w upwards in the disc.
        rise: w component of its normal in the disc.
        tilt: component of the normal along the axle, over that in the disc [1].
        share: see :class:`GroundContact` [1].
    """

    deflection: float
    slope: float
    rise: float
    tilt: float
    share: float


def ground_contact(
    x: Sequence[float],
    wheel: WheelPlace,
    radius: float,
    width: float,
    base: BaseMotion,
    positions: int,
    terrain: TerrainData,
    samples: int,
) -> GroundContact:
    """Return the contact of a wheel.

    Args:
        x: state of the plant, positions and velocities.
        wheel: the wheel.
        radius: unloaded [m].
        width: width of the tread [m].
        base: motion of its vehicle.
        positions: number of the plant's positions.
        terrain: the ground.
        samples: number of samples along the disc; zero on a plane.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = base.rows
    bx, by, bz = base.place
    wx, wy, wz = base.turning
    pose = wheel_pose(x, wheel, base, positions)
    arm, rate, rise, path, sine, cosine = pose.arm, pose.rate, pose.rise, pose.path, pose.sine, pose.cosine
    (kx, ky, kz), (ax, ay, az), (cx, cy, cz) = pose.pivot, pose.axle, pose.centre

    # The effective plane; e is horizontal ahead in the disc, u upwards in it.
    level = max(sqrt(ax * ax + ay * ay), _STEEP)
    ex, ey = ay / level, -ax / level
    ux, uy = ey * az, -ex * az
    plane = effective_plane(terrain, samples, radius, width, (cx, cy, cz), (ex, ey), (ux, uy, level), (ax, ay, az))
    # i: effective normal within the disc; n: with its component along the axle.
    ix, iy, iz = plane.slope * ex + plane.rise * ux, plane.slope * ey + plane.rise * uy, plane.rise * level
    scale = 1.0 / sqrt(1.0 + plane.tilt * plane.tilt)
    nx, ny, nz = scale * (ix + plane.tilt * ax), scale * (iy + plane.tilt * ay), scale * (iz + plane.tilt * az)

    # Tyre axes: x = axle × normal, y = normal × x; contact centre.
    tx, ty, tz = ay * nz - az * ny, az * nx - ax * nz, ax * ny - ay * nx
    size = sqrt(tx * tx + ty * ty + tz * tz)
    tx, ty, tz = tx / size, ty / size, tz / size
    lx, ly, lz = ny * tz - nz * ty, nz * tx - nx * tz, nx * ty - ny * tx
    loaded = radius - max(plane.deflection, 0.0)
    sx, sy, sz = cx - loaded * ix, cy - loaded * iy, cz - loaded * iz

    # Velocity of the contact centre, carried by base, suspension and steering; that of the wheel centre.
    rx, ry, rz = sx - bx, sy - by, sz - bz
    qx, qy, qz = sx - kx, sy - ky, sz - kz
    vx = base.velocity[0] + wy * rz - wz * ry + rise * path[0] + rate * (yz * qz - zz * qy)
    vy = base.velocity[1] + wz * rx - wx * rz + rise * path[1] + rate * (zz * qx - xz * qz)
    vz = base.velocity[2] + wx * ry - wy * rx + rise * path[2] + rate * (xz * qy - yz * qx)
    # Angular velocity of the wheel carrier; camber turns it about the x axis of the wheel.
    yawing, leaning = rate + arm.toe_rate * rise, arm.lean_rate * rise / sqrt(sine * sine + cosine * cosine)
    ox = wx + yawing * xz + leaning * (cosine * xx + sine * xy)
    oy = wy + yawing * yz + leaning * (cosine * yx + sine * yy)
    oz = wz + yawing * zz + leaning * (cosine * zx + sine * zy)
    mx, my, mz = loaded * ix, loaded * iy, loaded * iz  # from the contact centre to the wheel centre
    dx, dy, dz = vx + oy * mz - oz * my, vy + oz * mx - ox * mz, vz + ox * my - oy * mx
    rolling = wheel.rolling if wheel.rolling > 0.0 else loaded
    return GroundContact(
        plane.deflection,
        -(dx * ix + dy * iy + dz * iz),
        (ax, ay, az),
        (xz, yz, zz),
        (tx, ty, tz),
        (lx, ly, lz),
        (nx, ny, nz),
        (rx, ry, rz),
        (qx, qy, qz),
        asin(max(-1.0, min(1.0, ax * nx + ay * ny + az * nz))),
        vx * tx + vy * ty + vz * tz,
        vx * lx + vy * ly + vz * lz,
        ox * nx + oy * ny + oz * nz,
        rolling,
        x[positions + wheel.spin],
        path,
        (arm.brake_rate - arm.x_rate) / rolling,
        arm.toe_rate,
        arm.lean_rate,
        dz,
        plane.share,
    )


def effective_plane(
    terrain: TerrainData,
    samples: int,
    radius: float,
    width: float,
    centre: tuple[float, float, float],
    ahead: tuple[float, float],
    upwards: tuple[float, float, float],
    axle: tuple[float, float, float],
) -> EffectivePlane:
    """Return the effective plane of the ground under a wheel; equations in the head of the module.

    Args:
        terrain: the ground.
        samples: number of samples along the disc; zero on a plane.
        radius: radius of the wheel [m].
        width: width of the wheel [m].
        centre: centre of the wheel in the world (3) [m].
        ahead: horizontal direction in the disc (2).
        upwards: direction in the disc, perpendicular to it (3).
        axle: direction of the axle (3).
    """
    cx, cy, cz = centre
    ex, ey = ahead
    ux, uy, level = upwards
    energy, moment_x, moment_w, tilt, weight = 0.0, 0.0, 0.0, 0.0, 0.0
    slope, rise, deflection = 0.0, 0.0, 0.0
    rows = 2 if samples > 0 else 1
    # Each row is a disc of its own, displaced along the axle; a plane needs the middle one only.
    for row in range(rows):
        offset = 0.0 if rows == 1 else (2 * row - 1) * _GAUSS * width
        x0, y0 = cx - radius * ux + offset * axle[0], cy - radius * uy + offset * axle[1]
        z0, zx, zy = ground_at(terrain, x0, y0)
        # The tangent plane in the disc: w = -height + gradient x.
        below = max(level - zx * ux - zy * uy, _STEEP)
        gradient = (zx * ex + zy * ey) / below
        if samples > 0:  # that of a face is for the samples: its tangent plane would leave the sampled chord
            gradient = max(-_GRADE, min(_GRADE, gradient))
        px, py, pz = cx + offset * axle[0], cy + offset * axle[1], cz + offset * axle[2]
        height = (pz - z0 + zx * (x0 - px) + zy * (y0 - py)) / below
        norm = sqrt(1.0 + gradient * gradient)
        # Closed form of P and S for the tangent plane.
        depth = radius - height / norm
        row_energy, moment = _plane_energy(radius, depth), _plane_moment(radius, depth)
        row_x, row_w = moment * gradient / norm, -moment / norm
        if samples > 0:
            row_energy, row_x, row_w = _with_samples(
                terrain,
                samples,
                radius,
                (x0, y0, z0),
                ahead,
                (gradient, height, below),
                (row_energy, row_x, row_w),
            )
        row_energy = max(row_energy, 0.0)
        energy += row_energy
        moment_x += row_x
        moment_w += row_w
        # Tilt across the wheel, weighted by the energy: normal (-zx, -zy, 1) along the axle over that in the disc.
        # The small weight lets rows without contact define the plane of a wheel in the air.
        share = row_energy + _SMALL
        tilt += share * (axle[2] - zx * axle[0] - zy * axle[1]) / (below * norm)
        weight += share
        slope -= share * gradient / norm
        rise += share / norm
        deflection += depth / rows

    # Plane of equal energy, unless nothing is below the ground or the ground is above the wheel centre.
    energy, moment_x, moment_w = energy / rows, moment_x / rows, moment_w / rows
    if samples > 0:
        size = sqrt(moment_x * moment_x + moment_w * moment_w)
        if energy > _SMALL * radius**4 and moment_w < 0.0:
            depth = _depth_of_energy(radius, energy)
            share = size / _plane_moment(radius, depth)
            return EffectivePlane(depth, -moment_x / size, -moment_w / size, tilt / weight, share)
        # Without a deflection the tangent plane must not report contact.
        deflection = min(deflection, 0.0)
    size = sqrt(slope * slope + rise * rise)
    return EffectivePlane(deflection, slope / size, rise / size, tilt / weight, 1.0)


def _with_samples(
    terrain: TerrainData,
    samples: int,
    radius: float,
    lowest: tuple[float, float, float],
    ahead: tuple[float, float],
    tangent: tuple[float, float, float],
    integrals: tuple[float, float, float],
) -> tuple[float, float, float]:
    """Return energy and moments of a disc with the differences of the sampled ground to its tangent plane.

    Args:
        terrain: the ground.
        samples: number of samples along the disc.
        radius: radius of the wheel [m].
        lowest: ground below the lowest point of the disc (3) [m].
        ahead: horizontal direction in the disc (2).
        tangent: of the tangent plane gradient in the disc [1], height below the wheel centre [m], and length upwards in
            the disc over height [1].
        integrals: P [m⁴], and the components of -S ahead and upwards in the disc [m³], of the tangent plane.
    """
    (x0, y0, z0), (ex, ey), (gradient, height, below) = lowest, ahead, tangent
    energy, moment_x, moment_w = integrals
    incline = gradient * below
    # Positions and heights of the samples, the first ones every eighth, and whether those before it are taken.
    rows = np.empty((3, samples))
    places, heights, near = rows[0], rows[1], rows[2]
    # Every eighth sample, then those between where the ground is near: far from it they cannot contribute.
    step = 2.0 * _REACH * radius / (samples - 1) if samples > 1 else 0.0
    coarse = 0
    for k in range(0, samples, _STRIDE):
        places[coarse] = -_REACH * radius + k * step
        coarse += 1
    ground_heights(terrain, x0, y0, ex, ey, places, 0, coarse, heights)
    count, gap = coarse, 0.0
    for c in range(coarse):
        s, gap_before = places[c], gap
        raised = (heights[c] - z0 - s * incline) / below
        gap = _gap(radius, s, gradient * s - height, raised)
        near[c] = 1.0 if c > 0 and min(gap, gap_before) <= _GAP else 0.0
        if near[c] > 0.0:
            for k in range(_STRIDE * (c - 1) + 1, _STRIDE * c):
                places[count] = -_REACH * radius + k * step
                count += 1
    ground_heights(terrain, x0, y0, ex, ey, places, coarse, count, heights)

    # Differences to the tangent plane.
    between = coarse
    for c in range(coarse):
        for k in range(_STRIDE if near[c] > 0.0 else 1):
            one = c
            if k > 0:
                one, between = between, between + 1
            s = places[one]
            raised = (heights[one] - z0 - s * incline) / below
            change, level_w, spring = _strip(radius, s, gradient * s - height, raised)
            energy += change * step * spring
            moment_x += change * step * s
            moment_w += change * step * level_w
    return energy, moment_x, moment_w


def _gap(radius: float, s: float, tangent: float, raised: float) -> float:
    """Return the distance of the disc from the ground or the tangent plane, whichever is higher [m]; see _strip."""
    return -sqrt(radius * radius - s * s) - tangent - max(raised, 0.0)


def _strip(radius: float, s: float, tangent: float, raised: float) -> tuple[float, float, float]:
    """Return the difference of a strip of the disc to that on the tangent plane.

    Args:
        radius: radius of the wheel [m].
        s: position along the disc [m].
        tangent: height of the tangent plane over the wheel centre [m].
        raised: height of the ground over the tangent plane [m].

    Returns:
        Length of the strip below the ground, beyond that below the plane [m], the height of its middle over the wheel
        centre [m], and the mean of (R² - r²) / 2 along it [m²].
    """
    # The strip runs from the lower edge of the disc to the ground, at most over the whole chord.
    edge = -sqrt(radius * radius - s * s)
    top = edge + min(max(tangent + raised - edge, 0.0), -2.0 * edge)
    bottom = edge + min(max(tangent - edge, 0.0), -2.0 * edge)
    spring = 0.5 * edge * edge - (top * top + top * bottom + bottom * bottom) / 6.0
    return top - bottom, 0.5 * (top + bottom), spring


def _plane_moment(radius: float, depth: float) -> float:
    """Return S of a plane at a depth of the disc [m³]; zero without contact."""
    depth = min(max(depth, 0.0), radius)
    half = sqrt(2.0 * radius * depth - depth * depth)  # of the chord
    return 2.0 / 3.0 * half * half * half


def _plane_energy(radius: float, depth: float) -> float:
    """Return P of a plane at a depth of the disc [m⁴], the integral of S; zero without contact."""
    angle = acos(1.0 - min(max(depth, 0.0), radius) / radius)  # half of that of the segment
    value: float = radius**4 * (12.0 * angle - 8.0 * sin(2.0 * angle) + sin(4.0 * angle)) / 48.0
    return value


def _depth_of_energy(radius: float, energy: float) -> float:
    """Return the depth of a plane with the energy P [m⁴], at most the radius; by Newton's method."""
    # First guess: P of a shallow segment.
    depth: float = min((3.75 * energy / (2.0 * radius) ** 1.5) ** 0.4, radius)
    for _ in range(_NEWTON):
        change = (_plane_energy(radius, depth) - energy) / _plane_moment(radius, depth)
        # The lower bound keeps the iterate positive, where S is not zero.
        depth = min(max(depth - change, 0.25 * depth), radius)
    return depth


def add_ground_force(
    force: MutableSequence[float],
    wheel: WheelPlace,
    contact: GroundContact,
    forces: tuple[float, float, float],
    mz: float,
    resistance: float,
    brake: float,
    mx: float,
) -> None:
    """Add force and moment of the ground on a wheel to generalised forces.

    Args:
        force: generalised forces of the plant (num_velocities) [N, N m], changed.
        wheel: the wheel.
        contact: its contact.
        forces: forces at the contact centre, ahead, to the left, along the normal (3) [N].
        mz: moment about the normal [N m].
        resistance: moment about the axle [N m], of which the carrier bears nothing.
        brake: torque of the brake on the spin [N m].
        mx: overturning moment, about the direction ahead [N m].
    """
    fx, fy, fz = forces
    (tx, ty, tz), (lx, ly, lz), (nx, ny, nz) = contact.ahead, contact.left, contact.normal
    x, y, z = fx * tx + fy * lx + fz * nx, fx * ty + fy * ly + fz * ny, fx * tz + fy * lz + fz * nz
    rx, ry, rz = contact.arm_base
    (ax, ay, az), base = contact.axle, wheel.base[1]
    # Moments of the road on the wheel, which turns with its carrier.
    mx, my, mz, about = (
        mz * nx + resistance * ax + mx * tx,
        mz * ny + resistance * ay + mx * ty,
        mz * nz + resistance * az + mx * tz,
        mz * (ax * nx + ay * ny + az * nz) + resistance,
    )
    # Moments about the vehicle frame's origin, in the order of Drake's floating base: angular, then linear.
    force[base] += ry * z - rz * y + mx
    force[base + 1] += rz * x - rx * z + my
    force[base + 2] += rx * y - ry * x + mz
    force[base + 3] += x
    force[base + 4] += y
    force[base + 5] += z
    force[wheel.spin] += about - contact.rolling * fx

    # Steering joint: moment about its axis, at the kingpin. Suspension: force along the path of the wheel, and moments
    # that turn the wheel carrier with the travel: toe about the steering axis, camber about the x axis of the wheel.
    kx, ky, kz = contact.up
    steering = kx * mx + ky * my + kz * mz
    if 0 <= wheel.steering[1] < len(force):  # an actuator that prescribes an angle bears the moment
        qx, qy, qz = contact.arm_pivot
        force[wheel.steering[1]] += kx * (qy * z - qz * y) + ky * (qz * x - qx * z) + kz * (qx * y - qy * x) + steering
    if wheel.suspension[0] >= 0:
        dx, dy, dz = contact.path
        leaning = lean_moment(contact.axle, contact.up, mx, my, mz)
        force[wheel.suspension[1]] += dx * x + dy * y + dz * z
        force[wheel.suspension[1]] += contact.braked * brake + contact.toe * steering + contact.lean * leaning


CONTACT_PARTS = (
    ground_contact,
    pack_contact,
    unpack_contact,
    effective_plane,
    _with_samples,
    _gap,
    _strip,
    _plane_moment,
    _plane_energy,
    _depth_of_energy,
    add_ground_force,
)
"""Functions that :mod:`mirdrake.core.compiled` compiles for a step."""
