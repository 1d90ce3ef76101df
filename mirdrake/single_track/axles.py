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
"""

import math
from collections.abc import Callable
from typing import NamedTuple

from scipy.optimize import brentq

from mirdrake.tyres.wheel_laws import TyreLaw, make_tyre_laws
from mirdrake.tyres.wheel_tyres import REFERENCE_FRICTION
from mirdrake.vehicles import Vehicle
from mirdrake.worlds.world import GRAVITY

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
    """

    stiffness: float
    friction: float
    relaxation: float


class Body(NamedTuple):
    """What rests on the axles.

    Attributes:
        mass: all of it [kg].
        front: distance of the centre of mass from the front axle [m].
        rear: from the rear axle [m].
        height: of the centre of mass [m].
        tyre_stiffness: of a tyre of each axle, vertical [N/m].
    """

    mass: float
    front: float
    rear: float
    height: float
    tyre_stiffness: tuple[float, float]


def find_axles(
    vehicle: Vehicle, body: Body, *, friction: float | None = None, lateral: float = LATERAL
) -> tuple[Axle, Axle] | None:
    """Front and rear axle of a vehicle; None if it has no tyre model.

    Args:
        vehicle: a loaded vehicle.
        body: its mass and lengths.
        friction: of the road [1]; dry asphalt if left out.
        lateral: lateral acceleration of the turn [m/s²].

    Raises:
        ConfigError: a .tir file is missing or wrong.
    """
    laws = make_tyre_laws(vehicle)
    if laws is None:
        return None
    ground = 1.0 if friction is None else friction / REFERENCE_FRICTION
    length = body.front + body.rear
    shares = (body.rear / length, body.front / length)
    roll, transfers = _roll(vehicle, body, shares, lateral)
    loads = [0.5 * body.mass * GRAVITY * share for share in shares]
    forces = [body.mass * lateral * share for share in shares]
    slips, moments = [0.0, 0.0], [0.0, 0.0]
    for _ in range(4):  # moments are a small part of the forces
        turning = sum(moments) / length
        for i, (law, extra) in enumerate(zip(laws, (-turning, turning), strict=True)):
            wanted = forces[i] + extra
            wheels = [_wheel(law, loads[i] + sign * transfers[i], roll, ground) for sign in (1.0, -1.0)]
            slips[i] = float(brentq(lambda slip: sum(one(slip)[0] for one in wheels) - wanted, -_LARGEST, _LARGEST))  # noqa: B023
            moments[i] = sum(one(slips[i])[1] for one in wheels)
    servo = vehicle.control.steering
    yielding = moments[0] / (2.0 * servo.stiffness) if servo.kind == "servo" and servo.stiffness > 0.0 else 0.0
    found = []
    for i, law in enumerate(laws):
        contact = law(loads[i], 0.0, ground).contact
        slip = slips[i] + (yielding if i == 0 else 0.0)
        found.append(Axle(-forces[i] / slip, contact.friction_y / loads[i], contact.length_y))
    return found[0], found[1]


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
    stiffness = []
    for spring, track, tyre in zip((springs.front, springs.rear), tracks, body.tyre_stiffness, strict=True):
        wheel = spring.stiffness + 2.0 * spring.anti_roll  # both wheels move, one up and one down
        stiffness.append(0.5 * track**2 / (1.0 / wheel + 1.0 / tyre))
    roll = moment / (sum(stiffness) - body.mass * GRAVITY * body.height)
    front, rear = (one * roll / track for one, track in zip(stiffness, tracks, strict=True))
    return roll, (front, rear)
