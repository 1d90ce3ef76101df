"""Equations of the single-track model, for floats, AutoDiffXd and symbolic expressions alike.

Both wheels of an axle are one; the car stays flat on the road. Velocities vx, vy and yaw rate r are those of the centre
of mass in the frame of the car, a and b its distances from the front and the rear axle, δ the steering angle
(R. Rajamani, Vehicle Dynamics and Control, 2nd ed., sections 2.2, 2.3 and 4.1; signs of ISO 8855, left positive)::

    (m + mr) v̇x = Fxf cos δ - Fyf sin δ + Fxr - D + m gx + m r vy
           m v̇y = Fxf sin δ + Fyf cos δ + Fyr + m gy - m r vx
           Iz ṙ = a (Fxf sin δ + Fyf cos δ) - b Fyr

with mr the rotating masses reduced to the road, D = ρ/2 cA |vx| vx the drag, gx and gy gravity along and across the
car: a slope tilts gravity, as in the full model. Each axle has the velocity (u, w) along and across its wheels and the
slip tan α = w / max(|u|, v1). Its lateral force is -C α (linear) or that of the brush tyre::

    |Fy| = P (1 - (1 - min(s, 1))³),    s = C |tan α| / (3 P),    P = sqrt((μ N)² - Fx²)

(E. Fiala 1954; H. B. Pacejka, Tyre and Vehicle Dynamics, 3rd ed., section 3.2.1, pure side slip; P after R. Hindiyeh
and J. C. Gerdes, J. Dyn. Sys. Meas. Control 136, 2014: drive and brake forces take their share of the friction first).
N is the static load and the transfer of the tyres' longitudinal forces over the height of the centre of mass. With
relaxation length σ the slip that counts follows: d(tan α')/dt = max(|u|, v1) (tan α - tan α') / σ.

With roll the body leans by φ, to the right in a turn to the left, about an axis along the car; ms is what leans, h its
height over the axis, J its inertia about it, K and D what springs, bars, dampers and tyres do against it. vx and vy are
then those of the point below the centre of mass in the plane of the road, and the mass leans out of the turn (Rajamani,
section 15.2; W. F. and D. L. Milliken, Race Car Vehicle Dynamics, section 11)::

    m (v̇y + r vx - gy) - ms h φ̈ = Fxf sin δ + Fyf cos δ + Fyr
    J φ̈ = ms h (v̇y + r vx - gy) - (K + ms gz h) φ - D φ̇

(gz is negative.) The axles' slip α gets ε φ more: wheels that lean, and their share in the transfer of load, see
:mod:`mirdrake.single_track.axles`. Where the roll axis is, is in h alone; it is level, and yawing and rolling do not
turn each other's inertia.

Low speed. Slip has no meaning at standstill, and tyres become stiff springs there. Below the speed v1 the car moves as
a kinematic single track, from v2 on as above, between them both derivatives are mixed with a smooth weight of v²::

    v = vx,  r = vx tan δ / L,  vy = b r        reached with the time constant BLEND_TIME
    (m + mr + (m b² + Iz) tan² δ / L²) v̇ = Fxf / cos δ + Fxr - D + m gx + m gy b tan δ / L

The last line is Lagrange's equation of the rolling car at a steering angle that does not change. The kinematic model is
this alone, at every speed, without BLEND_TIME.

The fastest pole is near (Cf + Cr) / (m v), 40 1/s for a car in the blend: Drake's runge_kutta3 takes steps of 0.02 s.
Stiffer tyres or smaller v1 need shorter ones.

Brakes and rolling resistance oppose the motion with tanh(vx / STANDSTILL_SPEED): a car that is held on a slope creeps.
"""

import math
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, Literal, NamedTuple

import pydrake.math as drake_math

Value = Any
"""A float, an AutoDiffXd or an Expression."""

Tyres = Literal["kinematic", "linear", "brush"]
TYRES: tuple[Tyres, ...] = ("kinematic", "linear", "brush")

BLEND_TIME = 0.05
"""Time constant with which the kinematic relations are reached at low speed [s]."""

STANDSTILL_SPEED = 0.1
"""Speed below which brakes and rolling resistance fade [m/s]; as for the tyres of the full model."""

LARGEST_SHARE = 0.98
"""Part of an axle's friction that drive and brake force can take, so that the rest has a derivative."""

LEAST_LOAD = 0.01
"""Part of the weight that an axle carries at least."""

_ROLL = 6  # where the roll angle is in a state without slips

_FLOAT_MATHS = SimpleNamespace(
    sin=math.sin, cos=math.cos, tan=math.tan, atan=math.atan, tanh=math.tanh, sqrt=math.sqrt, abs=abs, min=min, max=max
)


class Variant(NamedTuple):
    """Which equations a model has.

    Attributes:
        tyres: "kinematic", "linear" or "brush".
        relaxation: whether the slip of each axle is a state; not for the kinematic model.
        actuators: whether the steering angle is a state and a servo holds the speed.
        roll: whether roll angle and roll rate are states; not for the kinematic model.
    """

    tyres: Tyres = "linear"
    relaxation: bool = False
    actuators: bool = False
    roll: bool = False


class Rates(NamedTuple):
    """What the equations give.

    Attributes:
        state: time derivatives of the state, in its order.
        motion: sideslip [rad] and accelerations [m/s²] of the centre of mass, slip angles [rad] and lateral forces [N]
            of front and rear axle; see :data:`mirdrake.single_track.system.MOTION`.
    """

    state: list[Value]
    motion: list[Value]


def maths_of(scalar: type) -> Any:
    """The elementary functions for a scalar type; those of the standard library are the fast ones for floats."""
    return _FLOAT_MATHS if scalar is float else drake_math


def brush_force(slip: Value, *, stiffness: Value, limit: Value, maths: Any = _FLOAT_MATHS) -> Value:
    """Lateral force [N] of a brush tyre in pure side slip; the formula of :mod:`mirdrake.tyres.brush`.

    :func:`evaluate` asks for it once an axle, with slip and limit: the place for another tyre law.

    Written without a division by the slip and without a branch. Its first derivative is continuous, also at zero slip
    and where the whole patch begins to slide.

    Args:
        slip: tan α [1].
        stiffness: cornering stiffness [N/rad].
        limit: largest force [N], positive.
        maths: elementary functions.
    """
    share = stiffness * maths.abs(slip) / (3.0 * limit)
    sticking = maths.min(share, 1.0)
    return -stiffness * slip * (1.0 - sticking + sticking * sticking / 3.0) / maths.max(share, 1.0)


def evaluate(
    variant: Variant, parameters: Sequence[Value], state: Sequence[Value], inputs: Sequence[Value], *, maths: Any
) -> Rates:
    """The equations of the module's head.

    Args:
        variant: which of them.
        parameters: in the order of :class:`mirdrake.single_track.parameters.SingleTrackParameters`.
        state: x, y [m], yaw [rad] of the vehicle frame (rear axle centre), vx [m/s]; unless kinematic vy [m/s] of the
            centre of mass and r [rad/s]; with relaxation the slips tan α' of front and rear; with roll its angle
            [rad] and rate [rad/s]; with actuators the steering angle [rad].
        inputs: steering angle [rad], drive force [N], brake force [N]; with actuators also the rate of the steering
            set-point [rad/s] and the speed set-point [m/s].
        maths: from :func:`maths_of`.
    """
    kinematic = variant.tyres == "kinematic"
    (mass, inertia, a, b, height, rotating, c_front, c_rear, mu_front, mu_rear, relax_front, relax_rear, crr) = (
        parameters[:13]
    )
    (drag, drive_share, brake_share, max_force, servo, lag, gx, gy, gz, v1, v2) = parameters[13:24]
    yaw, vx = state[2], state[3]
    base, tail = a + b, []

    # Actuators.
    steering, drive = inputs[0], inputs[1]
    if variant.actuators:
        delta = state[-1]
        tail = [inputs[3] + (steering - delta) / lag]
        drive = drive + servo * (inputs[4] - vx)
    else:
        delta = steering
    drive = maths.min(maths.max(drive, -max_force), max_force)
    sine, cosine = maths.sin(delta), maths.cos(delta)
    tangent = sine / cosine

    # Longitudinal forces of the axles, along their wheels, and gravity along and across the car.
    weight = -mass * gz
    opposing = maths.tanh(vx / STANDSTILL_SPEED)
    brake = inputs[2] * opposing
    resistance = crr * weight * opposing
    front = drive_share * drive - brake_share * brake - resistance * b / base
    rear = (1.0 - drive_share) * drive - (1.0 - brake_share) * brake - resistance * a / base
    air = drag * maths.abs(vx) * vx
    sin_yaw, cos_yaw = maths.sin(yaw), maths.cos(yaw)
    along, across = mass * (gx * cos_yaw + gy * sin_yaw), mass * (gy * cos_yaw - gx * sin_yaw)

    # Limits of friction; the transfer of load is that of the forces asked for.
    limit_front = limit_rear = 0.0
    if variant.tyres == "brush":
        most = LARGEST_SHARE * weight * maths.max(mu_front, mu_rear)
        transfer = maths.min(maths.max(front + rear, -most), most) * height
        grip_front = mu_front * maths.max((weight * b - transfer) / base, LEAST_LOAD * weight)
        grip_rear = mu_rear * maths.max((weight * a + transfer) / base, LEAST_LOAD * weight)
        front, limit_front = _within(front, grip_front, maths)
        rear, limit_rear = _within(rear, grip_rear, maths)

    # Kinematic single track.
    turn = tangent / base
    effective = mass + rotating + (mass * b * b + inertia) * turn * turn
    slow_vx = (front / cosine + rear - air + along + across * b * turn) / effective
    if kinematic:
        place = [vx * cos_yaw, vx * sin_yaw, vx * turn]
        side = (vx * vx + b * slow_vx) * turn
        sideslip = maths.atan(b * turn)
        return Rates(
            [*place, slow_vx, *tail], [sideslip, slow_vx - b * vx * vx * turn * turn, side, 0.0, 0.0, 0.0, 0.0]
        )

    # Slips of the axles and their lateral forces.
    vy, spin = state[4], state[5]
    ahead, behind = vy + a * spin, vy - b * spin
    speed_front, speed_rear = maths.abs(vx * cosine + ahead * sine), maths.abs(vx)
    speed_front, speed_rear = maths.max(speed_front, v1), maths.max(speed_rear, v1)
    slip_front, slip_rear = (ahead * cosine - vx * sine) / speed_front, behind / speed_rear
    slips = []
    if variant.relaxation:
        now_front, now_rear = state[6], state[7]
        slips = [
            (slip_front - now_front) * speed_front / relax_front,
            (slip_rear - now_rear) * speed_rear / relax_rear,
        ]
        slip_front, slip_rear = now_front, now_rear
    lean, leaning = 0.0, 0.0
    if variant.roll:
        lean, leaning = state[_ROLL + len(slips)], state[_ROLL + len(slips) + 1]
        slip_front, slip_rear = slip_front + parameters[29] * lean, slip_rear + parameters[30] * lean
    alpha_front, alpha_rear = maths.atan(slip_front), maths.atan(slip_rear)
    if variant.tyres == "linear":
        side_front, side_rear = -c_front * alpha_front, -c_rear * alpha_rear
    else:
        side_front = brush_force(slip_front, stiffness=c_front, limit=limit_front, maths=maths)
        side_rear = brush_force(slip_rear, stiffness=c_rear, limit=limit_rear, maths=maths)

    # Newton and Euler, mixed with the kinematic relations at low speed.
    lateral = front * sine + side_front * cosine
    fast_vx = (front * cosine - side_front * sine + rear - air + along + mass * spin * vy) / (mass + rotating)
    swing = 0.0
    if variant.roll:
        leaner, high, inertia_roll, stiffness, damping = parameters[24:29]
        arm = leaner * high
        around = inertia_roll + leaner * high * high
        righting = (stiffness + arm * gz) * lean + damping * leaning
        swing = arm * (arm * (lateral + side_rear) / mass - righting) / (around - arm * arm / mass)
    fast_vy = (lateral + side_rear + across + swing) / mass - spin * vx
    fast_spin = (a * lateral - b * side_rear) / inertia
    slow_spin, slow_vy = (vx * turn - spin) / BLEND_TIME, (b * vx * turn - vy) / BLEND_TIME
    part = (vx * vx + vy * vy - v1 * v1) / (v2 * v2 - v1 * v1)
    part = maths.min(maths.max(part, 0.0), 1.0)
    weigh = part * part * (3.0 - 2.0 * part)
    dvx = slow_vx + weigh * (fast_vx - slow_vx)
    dvy = slow_vy + weigh * (fast_vy - slow_vy)
    dspin = slow_spin + weigh * (fast_spin - slow_spin)
    rolling = [leaning, (arm * (dvy + spin * vx - across / mass) - righting) / around] if variant.roll else []
    place = [vx * cos_yaw - behind * sin_yaw, vx * sin_yaw + behind * cos_yaw, spin]
    sideslip = maths.atan(vy / maths.max(maths.abs(vx), v1))
    motion = [sideslip, dvx - spin * vy, dvy + spin * vx, alpha_front, alpha_rear, side_front, side_rear]
    return Rates([*place, dvx, dvy, dspin, *slips, *rolling, *tail], motion)


def _within(force: Value, grip: Value, maths: Any) -> tuple[Value, Value]:
    """Longitudinal force of an axle [N] within its friction, and what that leaves for the lateral force [N]."""
    most = LARGEST_SHARE * grip
    force = maths.min(maths.max(force, -most), most)
    return force, maths.sqrt(grip * grip - force * force)
