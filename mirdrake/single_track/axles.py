"""Effective axle characteristics of a vehicle with a tyre law, for the single-track model.

The lateral force of an axle depends on more than the slip angle of its wheels: the wheels have camber when the body
rolls, load is transferred to the outer wheel, the aligning moments of all tyres act on the vehicle, and the steering
is compliant. In a steady turn all of this is proportional to the lateral acceleration, and thus to the force of the
axle. It can be expressed as slip of the axle (H. B. Pacejka, Tyre and Vehicle Dynamics, 3rd ed., section 1.3.1); toe
and camber of the wheels by their travel are a part of it. With the roll angle φ, the moments' sum M and the wheelbase
L, in a turn to the left of acceleration a_y::

    φ (K_f + K_r - m g h) = m (h + e) a_y,     ΔN_i = K_i φ / t_i
    F_f L = m a_y b - M,                       F_r L = m a_y a + M
    F_i = Fy(α_i, φ, N_i + ΔN_i) + Fy(α_i, φ, N_i - ΔN_i)
    C_f = -(m a_y b / L) / (α_f + M_f / k),    C_r = -(m a_y a / L) / α_r

with N_i the static load of a wheel, K the roll stiffness of an axle (springs, anti-roll bar and tyres in series), t the
track, k the stiffness of the steering of both wheels, e the overturning moment of the tyres over their lateral force,
and M_f the aligning moments of the front tyres.
Without suspension the body does not roll, and the load transfer is distributed like the load.

In a variant with roll (:class:`mirdrake.single_track.dynamics.Variant`), camber is not in C, but in
ε = (α_i0 - α_i) / φ, with α_i0 the slip for the same force without camber.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import scipy  # it imports its parts when they are first used

from mirdrake.core.constants import GRAVITY
from mirdrake.plant.wheels.arms import NO_ARMS, ArmMotion, arm_motion, make_arms
from mirdrake.plant.wheels.tyre_forces import REFERENCE_FRICTION
from mirdrake.tyres import SlipTyres, TyreLaw
from mirdrake.vehicles import Vehicle

LATERAL = 0.1 * GRAVITY
"""Lateral acceleration of the turn [m/s²]: well within the linear range of tyres."""

_SPEED = 20.0  # speed for the tyre laws [m/s]; their moments fade below 1 m/s
_MAX_SLIP = 0.3  # largest slip angle [rad]


class Axle(NamedTuple):
    """Characteristics of an axle, both tyres together.

    Attributes:
        stiffness: effective cornering stiffness [N/rad].
        friction: largest lateral force over load, at the static load [1].
        relaxation: relaxation length of lateral slip [m].
        roll_slip: equivalent slip of camber over the roll angle [1]; 0 where it is in the stiffness.
        shape: shape factor of the Magic Formula at the static load [1].
        curvature: curvature factor [1].
    """

    stiffness: float
    friction: float
    relaxation: float
    roll_slip: float = 0.0
    shape: float = 1.3
    curvature: float = 0.0


class RollStiffness(NamedTuple):
    """Roll stiffness and damping of springs, bars, dampers and tyres.

    Attributes:
        stiffness: stiffness of each axle [N m/rad].
        damping: damping of both together [N m s/rad].
    """

    stiffness: tuple[float, float]
    damping: float


class Body(NamedTuple):
    """Mass properties and vertical stiffness of a vehicle.

    Attributes:
        mass: mass of the vehicle [kg].
        front: distance of the centre of mass from the front axle [m].
        rear: distance from the rear axle [m].
        height: height of the centre of mass [m].
        tyre_stiffness: vertical stiffness of a tyre of each axle [N/m].
        unsprung: unsprung mass per wheel of each axle [kg].
    """

    mass: float
    front: float
    rear: float
    height: float
    tyre_stiffness: tuple[float, float]
    unsprung: tuple[float, float]


def find_axles(
    vehicle: Vehicle, body: Body, *, friction: float | None = None, roll: bool = False
) -> tuple[Axle, Axle] | None:
    """Return front and rear axle of a vehicle; None if it has no tyre law.

    Args:
        vehicle: a loaded vehicle.
        body: its mass and lengths.
        friction: friction of the road [1]; by default dry asphalt.
        roll: whether the model has roll states.

    Raises:
        ConfigError: a .tir file is missing or wrong.
    """
    tyres = vehicle.spec.tyres
    if not isinstance(tyres, SlipTyres):
        return None
    laws = tyres.axle_laws(vehicle.folder)
    # Tyre laws are measured on a reference surface; they take the friction of the road relative to it.
    ground = 1.0 if friction is None else friction / REFERENCE_FRICTION
    length = body.front + body.rear
    # Share of the weight and, in a steady turn, of the lateral force on the front and the rear axle.
    shares = (body.rear / length, body.front / length)
    # A turn to the left: positive lateral acceleration and force; the body rolls to the right.
    angle, transfers = _roll(vehicle, body, shares, LATERAL, find_overturning_arm(vehicle, body))
    rolled, at_rest = (_arms(vehicle, body, roll) for roll in (angle, 0.0))
    loads = [0.5 * body.mass * GRAVITY * share for share in shares]
    forces = [body.mass * LATERAL * share for share in shares]
    slips, upright, moments = [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]
    # Fixed-point iteration: the aligning moments are a small part of the forces.
    for _ in range(4):
        # The sum M of the aligning moments is balanced by a pair of lateral forces, -M / L in front and M / L at the
        # rear.
        turning = sum(moments) / length
        for i, (law, extra) in enumerate(zip(laws, (-turning, turning), strict=True)):
            force = forces[i] + extra
            # Both wheels of an axle share one slip angle, with the outer one loaded and the inner one unloaded by the
            # transfer.
            cambered, upright_wheels = (
                [
                    _wheel(law, loads[i] + sign * transfers[i], lean + arm.lean, arm.toe, ground)
                    for sign, arm in zip((1.0, -1.0), arms, strict=True)
                ]
                for lean, arms in ((angle, rolled[i]), (0.0, at_rest[i]))
            )
            slips[i], upright[i] = _slip(cambered, force), _slip(upright_wheels, force)
            # The aligning moments of the wheels as they are, with camber, enter the next iteration.
            moments[i] = sum(wheel(slips[i])[1] for wheel in cambered)
    # The front aligning moment turns the compliant steering; it adds slip to the front axle, which means understeer.
    servo = vehicle.control.steering
    compliance_angle = moments[0] / (2.0 * servo.stiffness) if servo.kind == "servo" and servo.stiffness > 0.0 else 0.0
    # Effective stiffness by axle force over slip; friction, relaxation and shape are those of a tyre at the static
    # load.
    axles = []
    for i, law in enumerate(laws):
        tyre = law(loads[i], 0.0, ground)
        contact = tyre.contact
        # With roll states camber must not be counted twice: it acts through roll_slip instead of the stiffness.
        slip = (upright[i] if roll else slips[i]) + (compliance_angle if i == 0 else 0.0)
        roll_slip = (upright[i] - slips[i]) / angle if roll and angle > 0.0 else 0.0
        axles.append(
            Axle(
                -forces[i] / slip,
                contact.friction_y / loads[i],
                contact.length_y,
                roll_slip,
                *tyres.lateral_shape(tyre),
            )
        )
    return axles[0], axles[1]


def _slip(wheels: Sequence[Callable[[float], tuple[float, float]]], force: float) -> float:
    """Return the slip angle [rad] at which wheels together have a lateral force [N]."""
    return float(
        scipy.optimize.brentq(lambda slip: sum(wheel(slip)[0] for wheel in wheels) - force, -_MAX_SLIP, _MAX_SLIP)
    )


def _arms(vehicle: Vehicle, body: Body, roll: float) -> list[tuple[ArmMotion, ArmMotion]]:
    """Return the displacements of the outer and the inner wheel of each axle by its arms, in a turn to the left.

    Args:
        vehicle: the vehicle.
        body: its mass and lengths.
        roll: roll angle [rad].
    """
    arms, springs, geometry = make_arms(vehicle), vehicle.spec.suspension, vehicle.geometry
    if springs is None:
        return [(arm_motion(NO_ARMS, 0.0),) * 2] * 2
    result = []
    stiffness = find_roll_stiffness(vehicle, body).stiffness
    for i, (axle, track) in enumerate(
        zip((springs.front, springs.rear), (geometry.front_track, geometry.rear_track), strict=True)
    ):
        # The springs of an axle roll by their part of the compliance; the outer wheel, the right one, is in bump.
        travel = 0.5 * track * roll * stiffness[i] / ((0.5 * axle.stiffness + axle.anti_roll) * track**2)
        result.append((arm_motion(arms[2 * i + 1], travel), arm_motion(arms[2 * i], -travel)))
    return result


def _wheel(
    law: TyreLaw, load: float, inclination: float, toe: float, ground: float
) -> Callable[[float], tuple[float, float]]:
    """Return a function: slip angle of an axle [rad] to lateral force [N] and aligning moment [N m] of a wheel."""
    # A lifted inner wheel keeps 1 N, since tyre laws divide by the load.
    tyre = law(max(load, 1.0), inclination, ground)

    def forces(slip: float) -> tuple[float, float]:
        _, side, moment = tyre.forces(0.0, math.tan(slip - toe), _SPEED)
        return side, moment

    return forces


def find_overturning_arm(vehicle: Vehicle, body: Body) -> float:
    """Return the overturning moment of the tyres over their lateral force [m], in a turn at the static loads.

    Args:
        vehicle: the vehicle.
        body: its mass and lengths.
    """
    tyres, length = vehicle.spec.tyres, body.front + body.rear
    if not isinstance(tyres, SlipTyres):
        return 0.0
    arm = 0.0
    for law, share in zip(tyres.axle_laws(vehicle.folder), (body.rear / length, body.front / length), strict=True):
        arm += share * law(0.5 * body.mass * GRAVITY * share, 0.0, 1.0).contact.overturning_by_fy
    return arm


def _roll(
    vehicle: Vehicle, body: Body, shares: tuple[float, float], lateral: float, overturning_arm: float
) -> tuple[float, tuple[float, float]]:
    """Return the roll angle [rad], and the load transfer from the inner to the outer wheel of each axle [N]."""
    tracks = (vehicle.geometry.front_track, vehicle.geometry.rear_track)
    springs = vehicle.spec.suspension
    moment = body.mass * (body.height + overturning_arm) * lateral
    # Without suspension roll stiffness is unknown; distribute the overturning moment like the load.
    if springs is None:
        front, rear = (moment * share / track for share, track in zip(shares, tracks, strict=True))
        return 0.0, (front, rear)
    stiffness = find_roll_stiffness(vehicle, body).stiffness
    # Gravity on the rolled body acts against the roll stiffness (inverted pendulum).
    roll = moment / (sum(stiffness) - body.mass * GRAVITY * body.height)
    front, rear = (axle * roll / track for axle, track in zip(stiffness, tracks, strict=True))
    return roll, (front, rear)


_SLOW = 1e-6  # [rad/s]


def find_roll_stiffness(vehicle: Vehicle, body: Body, frequency: float = 0.0) -> RollStiffness:
    """Return roll stiffness and damping of springs, bars and dampers in series with the tyres.

    A damper in series with a tyre makes both depend on the frequency: dampers stiffen a car by 4 % at 2 Hz. The
    inertia of the unsprung masses reduces the stiffness of the tyres by m ω².

    Args:
        vehicle: the vehicle.
        body: its mass properties.
        frequency: frequency of the roll [rad/s].
    """
    tracks, springs = (vehicle.geometry.front_track, vehicle.geometry.rear_track), vehicle.spec.suspension
    # The damping is an imaginary part over ω, whose limit at zero frequency needs ω > 0.
    omega = max(frequency, _SLOW)
    stiffness, damping = [], 0.0
    for axle, (track, tyre) in enumerate(zip(tracks, body.tyre_stiffness, strict=True)):
        # Springs in series: compliances add. Complex stiffness k + i ω d holds spring and damper together.
        softness: complex = 1.0 / (tyre - body.unsprung[axle] * omega**2)
        if springs is not None:
            spring = (springs.front, springs.rear)[axle]
            # Wheels move in opposite directions, so the bar acts twice.
            softness += 1.0 / complex(spring.stiffness + 2.0 * spring.anti_roll, omega * spring.damping)
        # Two wheels at the distance t/2: k (t/2)² for each.
        together = 0.5 * track**2 / softness
        stiffness.append(together.real)
        damping += together.imag / omega
    return RollStiffness((stiffness[0], stiffness[1]), damping)
