"""Motion of a wheel on the road, and generalised forces of the plant for a force of the road on a wheel.

Both use the plant's state as floats: base pose and velocity, travel of the suspension along z of the vehicle frame B,
steering angle about the same direction, spin about the axle. This is faster than a query of the plant and needs no
Context. :mod:`mirdrake.core.compiled` compiles the functions, hence indices instead of unpacking. The arms of a
suspension (:mod:`mirdrake.plant.wheels.arms`) add toe, camber and a path of the contact point to the travel.

The road is the plane z = 0 of the world. Tyre axes are those of ISO 8855 at the contact centre P: the point of the
wheel plane on the road, below the wheel centre along the steepest line; x ahead along the wheel plane, y left, both on
the road. A wheel with v = ω Re rolls freely. The effective rolling radius Re of a tyre is a constant: for tyres with
slip larger than the distance h of P from the wheel centre, as the belt is longer than 2 π h. The slip velocity is
v - ω Re.
A longitudinal force has the lever Re about the axle, so that it does work against the slip only. About the vehicle it
has the lever h; the difference acts as if the load were some millimetres away from the axle, as it is.
"""

from collections.abc import MutableSequence, Sequence
from math import asin, cos, hypot, sin, sqrt
from typing import NamedTuple

from mirdrake.plant.plant import VehicleInPlant
from mirdrake.plant.wheels.arms import ARM_PARTS, NO_ARMS, ArmMotion, Arms, arm_motion, make_arms
from mirdrake.tyres import SlipTyres

_FLAT = 1e-3  # smallest cosine of the inclination: a wheel on its side has no rolling direction
_LEAST_RADIUS = 1e-3  # [m]

Index = tuple[int, int]
"""Index of a joint in the plant's positions and in its velocities."""

REAR_WHEELS = ("rear_left", "rear_right")
"""Wheels with a prescribed steering angle."""

NO_JOINT: Index = (-1, -1)
"""Index of a joint that does not exist."""


class WheelPlace(NamedTuple):
    """Position of a wheel on its vehicle, and its indices in the plant's state.

    Attributes:
        pivot: position in B of its steering axis at the height of the wheel centre, or of its centre if it is not
            steered [m]; suspension at rest.
        offset: lateral distance of its centre from there [m].
        spin: index of its spin rate in the plant's generalised velocities.
        steering: its steering joint, or :data:`NO_JOINT`. The indices of a prescribed angle are those behind the state
            of the plant.
        suspension: its suspension joint, along z of B, or :data:`NO_JOINT`.
        base: its vehicle's floating base.
        rolling: effective rolling radius of a tyre with slip [m]; zero: the distance of centre and contact centre.
        arms: arms of its suspension.
    """

    pivot: tuple[float, float, float]
    offset: float
    spin: int
    steering: Index
    suspension: Index
    base: Index
    rolling: float = 0.0
    arms: Arms = NO_ARMS


def wheel_places(part: VehicleInPlant) -> list[WheelPlace]:
    """Return the wheels of a vehicle in a finalised plant, in the order of :data:`mirdrake.vehicles.WHEELS`."""
    geometry = part.vehicle.geometry
    front, rear, kingpin = (0.5 * t for t in (geometry.front_track, geometry.rear_track, geometry.kingpin_track))
    length, high, low = geometry.wheelbase, geometry.front_wheel_radius, geometry.rear_wheel_radius
    # Steered wheels are placed by their kingpin; the offset to the wheel centre turns with the steering.
    places = [((length, kingpin, high), front - kingpin), ((length, -kingpin, high), kingpin - front)]
    places += [((0.0, rear, low), 0.0), ((0.0, -rear, low), 0.0)]
    # Rear wheels have no kingpin, and vehicles without suspension no travel.
    steering = [*((joint.position_start(), joint.velocity_start()) for joint in part.steering), NO_JOINT, NO_JOINT]
    if part.vehicle.spec.steering.rear is not None:
        plant = part.base.GetParentPlant()
        behind, rates = plant.num_multibody_states(), plant.num_velocities() + len(REAR_WHEELS)
        steering[2:] = [(behind + i, rates + i) for i in range(len(REAR_WHEELS))]
    travels = getattr(part, "suspension", ()) or (None,) * len(places)
    base = (part.base.floating_positions_start(), part.base.floating_velocities_start_in_v())
    tyres, radii = part.vehicle.spec.tyres, geometry.wheel_radii
    rolling = [tyres.rolling_ratio * radius if isinstance(tyres, SlipTyres) else 0.0 for radius in radii]
    return [
        WheelPlace(
            pivot,
            offset,
            wheel.velocity_start(),
            steered,
            NO_JOINT if travel is None else (travel.position_start(), travel.velocity_start()),
            base,
            effective,
            NO_ARMS if travel is None else arms,
        )
        for (pivot, offset), wheel, steered, travel, effective, arms in zip(
            places, part.wheels, steering, travels, rolling, make_arms(part.vehicle), strict=True
        )
    ]


class WheelMotion(NamedTuple):
    """Pose and velocities of a wheel in the world.

    Attributes:
        x: position of its centre [m].
        y: the same, to the left.
        z: the same, upwards.
        axle: direction of its axle, to the left (3).
        up: direction of steering axis and suspension, z of B (3).
        arm_base: contact centre from the vehicle frame's origin (3) [m].
        arm_pivot: contact centre from the steering axis (3) [m].
        ahead: direction of the tyre's x axis on the road (2).
        radius: distance of the wheel centre from the contact centre [m].
        inclination: inclination of the wheel plane, positive when its top is inclined to the right [rad].
        vx: longitudinal speed of the contact centre, as a point of the wheel carrier [m/s].
        vy: lateral speed of that point, positive to the left [m/s].
        slip_x: Vsx = vx - ω Re [m/s], negative when driving.
        rolling: Re, effective rolling radius [m].
        spin: ω about the axle, relative to the wheel carrier [rad/s].
        sink: speed of the wheel centre downwards [m/s].
        turn: angular velocity of the wheel carrier about the vertical [rad/s].
        path: derivative of the contact centre by the travel (3) [1].
        braked: rotation of the wheel carrier about the axle by the travel, as a brake sees it [rad/m].
        toe: derivative of the steering angle by the travel [rad/m].
        lean: derivative of the inclination by the travel [rad/m].
    """

    x: float
    y: float
    z: float
    axle: tuple[float, float, float]
    up: tuple[float, float, float]
    arm_base: tuple[float, float, float]
    arm_pivot: tuple[float, float, float]
    ahead: tuple[float, float]
    radius: float
    inclination: float
    vx: float
    vy: float
    slip_x: float
    rolling: float
    spin: float
    sink: float
    turn: float
    path: tuple[float, float, float]
    braked: float
    toe: float
    lean: float


class BaseMotion(NamedTuple):
    """Vehicle frame B in the world: rotation by rows, position [m], angular [rad/s] and linear velocity [m/s]."""

    rows: tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]
    place: tuple[float, float, float]
    turning: tuple[float, float, float]
    velocity: tuple[float, float, float]


def base_motion(x: Sequence[float], base: Index, positions: int, period: float = 0.0) -> BaseMotion:
    """Return the motion of the vehicle frame from the plant's state.

    The heading of a plant that makes steps leads its velocities by half a step. The velocities are therefore rotated
    by half of the yaw per step, so that their components in the vehicle frame are right.

    Args:
        x: positions and velocities of the plant.
        base: floating base.
        positions: number of the plant's positions.
        period: step of the plant [s]; zero: velocities as they are.
    """
    q, v = base[0], positions + base[1]
    w, i, j, k = x[q], x[q + 1], x[q + 2], x[q + 3]
    half = 0.5 * (w * w + i * i + j * j + k * k)  # the norm of Drake's quaternions may drift
    rows = (
        (1.0 - (j * j + k * k) / half, (i * j - w * k) / half, (i * k + w * j) / half),
        ((i * j + w * k) / half, 1.0 - (i * i + k * k) / half, (j * k - w * i) / half),
        ((i * k - w * j) / half, (j * k + w * i) / half, 1.0 - (i * i + j * j) / half),
    )
    place = (x[q + 4], x[q + 5], x[q + 6])
    turn = 0.5 * period * x[v + 2]
    turning = (x[v] - turn * x[v + 1], x[v + 1] + turn * x[v], x[v + 2])
    velocity = (x[v + 3] - turn * x[v + 4], x[v + 4] + turn * x[v + 3], x[v + 5])
    return BaseMotion(rows, place, turning, velocity)


class WheelPose(NamedTuple):
    """Pose of a wheel in the world, and what moves it.

    Attributes:
        rate: rate of its steering joint [rad/s].
        rise: speed of its suspension joint [m/s].
        arm: motion of the arms of its suspension.
        sine: component of the axle to the rear in B [1].
        cosine: component of the axle to the left in B [1].
        pivot: point of the steering axis (3) [m].
        axle: direction of its axle, to the left (3).
        centre: its centre (3) [m].
        path: derivative of a point of the wheel carrier by the travel (3) [1].
    """

    rate: float
    rise: float
    arm: ArmMotion
    sine: float
    cosine: float
    pivot: tuple[float, float, float]
    axle: tuple[float, float, float]
    centre: tuple[float, float, float]
    path: tuple[float, float, float]


def wheel_pose(x: Sequence[float], wheel: WheelPlace, base: BaseMotion, positions: int) -> WheelPose:
    """Return the pose of a wheel; arguments as in :func:`base_motion`."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = base.rows
    bx, by, bz = base.place
    # Wheels without a steering or suspension joint keep these values.
    angle, rate, travel, rise = 0.0, 0.0, 0.0, 0.0
    if wheel.steering[0] >= 0:
        angle, rate = x[wheel.steering[0]], x[positions + wheel.steering[1]]
    if wheel.suspension[0] >= 0:
        travel, rise = x[wheel.suspension[0]], x[positions + wheel.suspension[1]]
    arm = arm_motion(wheel.arms, travel)
    angle += arm.toe
    upright, lean = cos(arm.lean), sin(arm.lean)
    sine, cosine = upright * sin(angle), upright * cos(angle)

    # Steering axis, axle and wheel centre; the axle in B is (-sine, cosine, lean).
    px, py, pz = wheel.pivot[0] + arm.x, wheel.pivot[1] + arm.y, wheel.pivot[2] + travel
    kx, ky, kz = bx + xx * px + xy * py + xz * pz, by + yx * px + yy * py + yz * pz, bz + zx * px + zy * py + zz * pz
    ax = xy * cosine - xx * sine + xz * lean
    ay = yy * cosine - yx * sine + yz * lean
    az = zy * cosine - zx * sine + zz * lean
    cx, cy, cz = kx + wheel.offset * ax, ky + wheel.offset * ay, kz + wheel.offset * az
    path = (
        xz + arm.x_rate * xx + arm.y_rate * xy,
        yz + arm.x_rate * yx + arm.y_rate * yy,
        zz + arm.x_rate * zx + arm.y_rate * zy,
    )
    return WheelPose(rate, rise, arm, sine, cosine, (kx, ky, kz), (ax, ay, az), (cx, cy, cz), path)


def wheel_motion(x: Sequence[float], wheel: WheelPlace, base: BaseMotion, positions: int) -> WheelMotion:
    """Return the motion of a wheel; arguments as in :func:`base_motion`."""
    (_, _, xz), (_, _, yz), (_, _, zz) = base.rows
    bx, by, bz = base.place
    wx, wy, wz = base.turning
    pose = wheel_pose(x, wheel, base, positions)
    arm, rate, rise, path = pose.arm, pose.rate, pose.rise, pose.path
    (kx, ky, kz), (ax, ay, az), (cx, cy, cz) = pose.pivot, pose.axle, pose.centre

    # Contact centre: from the wheel centre down the wheel plane.
    # The wheel plane is inclined by asin(az), so its steepest line to the road is longer than the height.
    level = max(hypot(ax, ay), _FLAT)
    radius = max(cz / level, _LEAST_RADIUS)
    along, across = ay / level, ax / level  # tyre axes: x (along, -across), y (across, along)
    sx, sy = cx + radius * az * across, cy + radius * az * along

    # Its velocity, carried by base, suspension and steering.
    rx, ry, rz = sx - bx, sy - by, -bz
    ex, ey, ez = sx - kx, sy - ky, -kz
    vx = base.velocity[0] + wy * rz - wz * ry + rise * path[0] + rate * (yz * ez - zz * ey)
    vy = base.velocity[1] + wz * rx - wx * rz + rise * path[1] + rate * (zz * ex - xz * ez)
    ahead = vx * along - vy * across
    rolling = wheel.rolling if wheel.rolling > 0.0 else radius
    spin = x[positions + wheel.spin]
    leaning = arm.lean_rate * rise / hypot(pose.sine, pose.cosine)
    return WheelMotion(
        cx,
        cy,
        cz,
        (ax, ay, az),
        (xz, yz, zz),
        (rx, ry, rz),
        (ex, ey, ez),
        (along, -across),
        radius,
        asin(max(-1.0, min(1.0, az))),
        ahead,
        vx * across + vy * along,
        ahead - spin * rolling,
        rolling,
        spin,
        # Velocity of the wheel centre downwards, that of the suspension included.
        wy * (cx - bx) - wx * (cy - by) - base.velocity[2] - rise * zz,
        wz
        + (rate + arm.toe_rate * rise) * zz
        + leaning * (pose.cosine * base.rows[2][0] + pose.sine * base.rows[2][1]),
        path,
        (arm.brake_rate - arm.x_rate) / rolling,
        arm.toe_rate,
        arm.lean_rate,
    )


def add_road_force(
    force: MutableSequence[float],
    wheel: WheelPlace,
    motion: WheelMotion,
    fx: float,
    fy: float,
    mz: float,
    fz: float = 0.0,
    resistance: float = 0.0,
    brake: float = 0.0,
    mx: float = 0.0,
) -> None:
    """Add a force of the road on a wheel to generalised forces.

    Args:
        force: generalised forces of the plant (num_velocities) [N, N m], changed.
        wheel: the wheel.
        motion: its motion.
        fx: force at the contact centre, ahead [N].
        fy: the same to the left [N].
        mz: moment about the vertical [N m].
        fz: force upwards, beyond that of the plant's contact [N].
        resistance: moment about the axle [N m], of which the carrier bears nothing.
        brake: torque of the brake on the spin [N m].
        mx: overturning moment, about the direction ahead [N m].
    """
    along, minus_across = motion.ahead
    x, y = fx * along - fy * minus_across, fx * minus_across + fy * along
    rx, ry, rz = motion.arm_base
    (ax, ay, az), base = motion.axle, wheel.base[1]
    # Moments of the road on the wheel, which turns with its carrier.
    about = mz * az + resistance
    mx, my, mz = mx * along + resistance * ax, mx * minus_across + resistance * ay, mz + resistance * az
    # Moments about the vehicle frame's origin, in the order of Drake's floating base: angular, then linear.
    force[base] += ry * fz - rz * y + mx
    force[base + 1] += rz * x - rx * fz + my
    force[base + 2] += rx * y - ry * x + mz
    force[base + 3] += x
    force[base + 4] += y
    force[base + 5] += fz
    # Fx has the lever Re about the axle, not the height of the axle; see the head of the module.
    force[wheel.spin] += about - motion.rolling * fx
    kx, ky, kz = motion.up
    steering = kx * mx + ky * my + kz * mz
    if 0 <= wheel.steering[1] < len(force):  # an actuator that prescribes an angle bears the moment
        ex, ey, ez = motion.arm_pivot
        force[wheel.steering[1]] += (
            (ky * x - kx * y) * ez + (kx * ey - ky * ex) * fz + kz * (ex * y - ey * x) + steering
        )
    if wheel.suspension[0] >= 0:
        # The wheel travels along its path; the moments turn the wheel carrier with the travel.
        dx, dy, dz = motion.path
        leaning = lean_moment(motion.axle, motion.up, mx, my, mz)
        force[wheel.suspension[1]] += dx * x + dy * y + dz * fz
        force[wheel.suspension[1]] += motion.braked * brake + motion.toe * steering + motion.lean * leaning


def lean_moment(
    axle: tuple[float, float, float], up: tuple[float, float, float], mx: float, my: float, mz: float
) -> float:
    """Return the part of a moment about the x axis of a wheel, axle × steering axis, about which camber turns it."""
    (ax, ay, az), (kx, ky, kz) = axle, up
    x, y, z = ay * kz - az * ky, az * kx - ax * kz, ax * ky - ay * kx
    return (x * mx + y * my + z * mz) / sqrt(x * x + y * y + z * z)


STEP_PARTS = (*ARM_PARTS, base_motion, wheel_pose, wheel_motion, lean_moment, add_road_force)
"""Functions that :mod:`mirdrake.core.compiled` compiles for a step."""
