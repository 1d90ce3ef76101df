"""What the axles of a vehicle with a tyre model are worth to a single-track model: effective axle characteristics.

The lateral force of an axle depends on more than the slip angle of its wheels: the body rolls and its wheels lean with
it, the load goes to the outer wheel, the aligning moments of all tyres turn the car, and the steering gives way to
those in front. In a steady turn all of this goes with the lateral acceleration, and so with the force of the axle; it
can be counted as slip of the axle (H. B. Pacejka, Tyre and Vehicle Dynamics, 3rd ed., section 1.3.1). With the roll
angle φ, the moments' sum M and its wheelbase L, in a turn to the left of acceleration a_y::

    φ (K_f + K_r - m g h) = m h a_y,           ΔN_i = K_i φ / t_i
    F_f L = m a_y b - M,                       F_r L = m a_y a + M
    F_i = Fy(α_i, φ, N_i + ΔN_i) + Fy(α_i, φ, N_i - ΔN_i)
    C_f = -(m a_y b / L) / (α_f + M_f / k),    C_r = -(m a_y a / L) / α_r

with N_i the static load of a wheel, K the roll stiffness of an axle (springs, anti-roll bar and tyres one behind the
other), t the track, k the stiffness of the steering of both wheels, and M_f the aligning moments of the front tyres.
Without suspension the body does not roll, and the axles share the transfer as they share the load.

Where the model rolls itself (:class:`mirdrake.single_track.dynamics.Variant`), the wheels' leaning is not in C, but in
ε = (α_i0 - α_i) / φ, with α_i0 the slip that would make the same force with upright wheels.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from scipy.optimize import brentq

from mirdrake.core.constants import GRAVITY
from mirdrake.plant.wheels.tyre_forces import REFERENCE_FRICTION
from mirdrake.tyres import SlipTyres, TyreLaw
from mirdrake.vehicles import Vehicle

LATERAL = 0.1 * GRAVITY
"""Lateral acceleration of the turn [m/s²]: well inside of where tyres are linear."""

_SPEED = 20.0  # at which the laws are asked [m/s]; the moments of tyres fade below 1 m/s
_LARGEST = 0.3  # slip angle [rad]


class Axle(NamedTuple):
    """Both tyres of an axle together.

    Attributes:
        stiffness: effective cornering stiffness [N/rad].
        friction: largest lateral force over load, at the static load [1].
        relaxation: relaxation length of lateral slip [m].
        roll_slip: slip that leaning wheels are worth over the roll angle [1]; 0 where it is in the stiffness.
    """

    stiffness: float
    friction: float
    relaxation: float
    roll_slip: float = 0.0


class Leaning(NamedTuple):
    """How the body rolls on its springs, bars and tyres.

    Attributes:
        stiffness: of each axle [N m/rad].
        damping: of both together [N m s/rad].
    """

    stiffness: tuple[float, float]
    damping: float


class Body(NamedTuple):
    """What rests on the axles.

    Attributes:
        mass: all of it [kg].
        front: distance of the centre of mass from the front axle [m].
        rear: from the rear axle [m].
        height: of the centre of mass [m].
        tyre_stiffness: of a tyre of each axle, vertical [N/m].
        unsprung: mass that goes up and down with a wheel of each axle [kg].
    """

    mass: float
    front: float
    rear: float
    height: float
    tyre_stiffness: tuple[float, float]
    unsprung: tuple[float, float]


def find_axles(
    vehicle: Vehicle, body: Body, *, friction: float | None = None, lateral: float = LATERAL, roll: bool = False
) -> tuple[Axle, Axle] | None:
    """Front and rear axle of a vehicle; None if it has no tyre model.

    Args:
        vehicle: a loaded vehicle.
        body: its mass and lengths.
        friction: of the road [1]; dry asphalt if left out.
        lateral: lateral acceleration of the turn [m/s²].
        roll: whether the model rolls itself.

    Raises:
        ConfigError: a .tir file is missing or wrong.
    """
    tyres = vehicle.spec.tyres
    if not isinstance(tyres, SlipTyres):
        return None
    laws = tyres.axle_laws(vehicle.folder)
    ground = 1.0 if friction is None else friction / REFERENCE_FRICTION
    length = body.front + body.rear
    shares = (body.rear / length, body.front / length)
    angle, transfers = _roll(vehicle, body, shares, lateral)
    loads = [0.5 * body.mass * GRAVITY * share for share in shares]
    forces = [body.mass * lateral * share for share in shares]
    slips, upright, moments = [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]
    for _ in range(4):  # moments are a small part of the forces
        turning = sum(moments) / length
        for i, (law, extra) in enumerate(zip(laws, (-turning, turning), strict=True)):
            wanted = forces[i] + extra
            leaning, straight = (
                [_wheel(law, loads[i] + sign * transfers[i], lean, ground) for sign in (1.0, -1.0)]
                for lean in (angle, 0.0)
            )
            slips[i], upright[i] = _slip(leaning, wanted), _slip(straight, wanted)
            moments[i] = sum(one(slips[i])[1] for one in leaning)
    servo = vehicle.control.steering
    yielding = moments[0] / (2.0 * servo.stiffness) if servo.kind == "servo" and servo.stiffness > 0.0 else 0.0
    found = []
    for i, law in enumerate(laws):
        contact = law(loads[i], 0.0, ground).contact
        slip = (upright[i] if roll else slips[i]) + (yielding if i == 0 else 0.0)
        roll_slip = (upright[i] - slips[i]) / angle if roll and angle > 0.0 else 0.0
        found.append(Axle(-forces[i] / slip, contact.friction_y / loads[i], contact.length_y, roll_slip))
    return found[0], found[1]


def _slip(wheels: Sequence[Callable[[float], tuple[float, float]]], wanted: float) -> float:
    """Slip angle [rad] at which wheels together have a lateral force [N]."""
    return float(brentq(lambda slip: sum(one(slip)[0] for one in wheels) - wanted, -_LARGEST, _LARGEST))


def _wheel(law: TyreLaw, load: float, inclination: float, ground: float) -> Callable[[float], tuple[float, float]]:
    """Lateral force [N] and aligning moment [N m] of a wheel over its slip angle [rad]."""
    tyre = law(max(load, 1.0), inclination, ground)

    def forces(slip: float) -> tuple[float, float]:
        _, side, moment = tyre.forces(0.0, math.tan(slip), _SPEED)
        return side, moment

    return forces


def _roll(
    vehicle: Vehicle, body: Body, shares: tuple[float, float], lateral: float
) -> tuple[float, tuple[float, float]]:
    """Roll angle [rad] and the load that goes from the inner to the outer wheel of each axle [N]."""
    tracks = (vehicle.geometry.front_track, vehicle.geometry.rear_track)
    springs = vehicle.spec.suspension
    moment = body.mass * body.height * lateral
    if springs is None:
        front, rear = (moment * share / track for share, track in zip(shares, tracks, strict=True))
        return 0.0, (front, rear)
    stiffness = find_leaning(vehicle, body).stiffness
    roll = moment / (sum(stiffness) - body.mass * GRAVITY * body.height)
    front, rear = (one * roll / track for one, track in zip(stiffness, tracks, strict=True))
    return roll, (front, rear)


_SLOW = 1e-6  # [rad/s]


def find_leaning(vehicle: Vehicle, body: Body, frequency: float = 0.0) -> Leaning:
    """Roll stiffness and damping of a vehicle's springs, bars and dampers with its tyres behind them.

    A damper behind a tyre gives way with it, so that both depend on the frequency: dampers stiffen the car, by 4 % at
    2 Hz. Wheels that swing make their tyres softer, by m ω².

    Args:
        vehicle: the vehicle.
        body: of it.
        frequency: of the roll [rad/s].
    """
    tracks, springs = (vehicle.geometry.front_track, vehicle.geometry.rear_track), vehicle.spec.suspension
    omega = max(frequency, _SLOW)
    stiffness, damping = [], 0.0
    for axle, (track, tyre) in enumerate(zip(tracks, body.tyre_stiffness, strict=True)):
        softness: complex = 1.0 / (tyre - body.unsprung[axle] * omega**2)
        if springs is not None:
            spring = (springs.front, springs.rear)[axle]
            # Both wheels move, one up and one down.
            softness += 1.0 / complex(spring.stiffness + 2.0 * spring.anti_roll, omega * spring.damping)
        together = 0.5 * track**2 / softness
        stiffness.append(together.real)
        damping += together.imag / omega
    return Leaning((stiffness[0], stiffness[1]), damping)
