"""One step of the tyres of a vehicle; :mod:`mirdrake.core.compiled` compiles it.

One step has the length dt. The deflections of the tyres are advanced to the present time with the mean slip velocity of
the last step, and on to the middle of this step. The law is evaluated there, and the forces are rotated with the
vehicle to there. With the explicit steps of the plant this is a leap-frog scheme, which neither damps nor excites
oscillations of the vehicle on its tyres. Two first-order errors of the plant are compensated:

- The plant yaws the vehicle with the yaw rate ψ' at the end of a step, so that the heading leads the velocity by
  ψ' dt / 2. In a steady turn this has no effect, but it is a spurious slip whenever ψ' changes. The velocity v of the
  vehicle is therefore rotated, too, by the lateral force m v Δψ' / 2.
- The plant applies the load at the end of a step, which damps the vehicle on its tyres by their stiffness times dt / 2,
  many times the damping of rubber. In point contact the difference to the load in the middle is subtracted. The
  stiffness of a patch is not known well enough, and overcompensation would excite oscillations.

The spin of a wheel is too fast for a leap-frog: 1 kg m² on a slip stiffness of 100 kN oscillates with 30 Hz, and steps
of 10 ms would be unstable. Its change over the step is therefore predicted, linearly implicit::

    (I / dt + h S b) Δω = T + M_drive + M_brake - h {F' + S (κ - κ')},     κ(Δω) = κ + b Δω

with the spin inertia I, the rolling radius h, the secant slip stiffness S = F' / κ' of the step before, b = ∂κ/∂ω at
the middle of the step, and T the torque from other sources (servo, bearing, rolling resistance, pitch of the body). T
is the part of the last change of ω that the other terms do not explain. The law is evaluated at the slip in the middle,
κ + b Δω; this is the trapezoidal rule, stable for every stiffness and of second order. In steady motion Δω is zero,
whatever T is.

The load is measured less often than the plant steps, and with a delay; a friction force with this delay would excite
the pitch of a braking car. The load of the tyre's compression has no delay, and is scaled to the measured load. The law
is evaluated for a new load when the measured load differs by more than 1e-4; until then forces and stiffnesses are
scaled with the load.

A brake is Coulomb friction: its torque is the one that would stop the wheel by the end of the step, within its limit. A
wheel at standstill is held by exactly the torque needed, and a turning wheel gets the full torque.

Not modelled: overturning moment beyond that of the contact (:mod:`mirdrake.plant.wheel_shape`); turn slip (the moment
against steering at standstill is that of the kingpin offset alone).
"""

from collections.abc import Callable, MutableSequence, Sequence
from math import atan, expm1, inf
from typing import Any, NamedTuple

from mirdrake.core.compiled import Records
from mirdrake.plant.plant import TyreSpring, spring_load
from mirdrake.plant.wheels import motion as wheel_motion
from mirdrake.plant.wheels.motion import BaseMotion, WheelMotion, WheelPlace, add_road_force, base_motion
from mirdrake.plant.wheels.motion import wheel_motion as motion_of
from mirdrake.tyres import relaxation
from mirdrake.tyres.relaxation import (
    Contact,
    Deflection,
    Motion,
    RelaxationSettings,
    deflection_step,
    low_speed_weight,
    relaxed_slip,
)

# Below this, differences of floats are noise: limits are taken instead of quotients.
_SMALL = 1e-9

_LIFTED = 0.1  # load over static load below which measured and spring load are not compared [1]
_SAME = 1e-4  # change of the load (relative) or of the inclination [rad] that needs no new curve
_BLEND = 0.2  # weight of a new comparison in the filtered ratio [1]
_MAX_RATIO = 3.0  # largest plausible ratio of measured to spring load [1]


class SpinningWheel(NamedTuple):
    """Wheel with a tyre law.

    Attributes:
        place: position on its vehicle and in the plant's state.
        inertia: spin inertia, with the rotor of the motor [kg m²].
        damping: damping of the spin that Drake solves implicitly: servo gain and bearing [N m s/rad].
        held: whether a parking brake holds it.
        radius: unloaded [m].
        spring: compression under a load.
        static_load: its load at rest [N].
        settings: damping of its tyre.
    """

    place: WheelPlace
    inertia: float
    damping: float
    held: bool
    radius: float
    spring: TyreSpring
    static_load: float
    settings: RelaxationSettings


class SpinningCar(NamedTuple):
    """Properties of a vehicle that its wheels share.

    Attributes:
        period: step of the plant [s].
        positions: number of the plant's positions.
        mass: mass of the vehicle [kg].
        centre: its centre of mass in B, suspension at rest [m].
    """

    period: float
    positions: int
    mass: float
    centre: tuple[float, float, float]


class Memory(NamedTuple):
    """Memory of a wheel from step to step.

    Attributes:
        along: longitudinal deflection of the tyre [m].
        across: lateral deflection [m].
        vx: motion of the last step [m/s].
        slip_x: the same [m/s].
        vy: the same [m/s].
        spin: the same [rad/s].
        torque: torque of motor, brake and longitudinal force on the spin [N m].
        fx: longitudinal force [N].
        kappa: its longitudinal slip [1].
        measured: last measured load [N]; negative: at the start.
        ratio: measured load over spring load [1].
        sprung: load of the spring at the end of the step [N].
        load: load of the curve [N].
        inclination: inclination of the curve [rad].
        turning: yaw rate of the vehicle [rad/s].
    """

    along: float = 0.0
    across: float = 0.0
    vx: float = 0.0
    slip_x: float = 0.0
    vy: float = 0.0
    spin: float = 0.0
    torque: float = 0.0
    fx: float = 0.0
    kappa: float = 0.0
    measured: float = -1.0
    ratio: float = 1.0
    sprung: float = 0.0
    load: float = 0.0
    inclination: float = 0.0
    turning: float = 0.0


def tyre_step(
    law: Callable[[Any, float, float, float], tuple[float, float, float]],
    x: Sequence[float],
    loads: Sequence[float],
    torques: Sequence[float],
    frictions: Sequence[float],
    cars: Records,
    wheels: Records,
    curves: Records,
    memories: Records,
    force: MutableSequence[float],
    after: Records,
    logged: Any,
) -> bool:
    """Compute the forces of the road on the tyres, and the memory of the wheels.

    Args:
        law: forces in steady state, of :class:`mirdrake.tyres.SteadyLaw`.
        x: state of the plant, positions and velocities.
        loads: loads of the wheels, measured [N].
        torques: drive torque of each wheel, signed, then the largest torque of each brake [N m].
        frictions: friction of the ground under each wheel, relative to dry asphalt [1].
        cars: one :class:`SpinningCar`.
        wheels: :class:`SpinningWheel`.
        curves: the tyres at their loads; load, inclination, friction, contact and curve.
        memories: :class:`Memory` of the step before.
        force: generalised forces of the plant (num_velocities) [N, N m], overwritten.
        after: memories for the next step, overwritten.
        logged: Fx, Fy, Mz, kappa, alpha of each wheel, overwritten.

    Returns:
        Whether the curves are those of the loads and inclinations in `after`, and of the frictions; if not, the results
        are not valid.
    """
    car, known = cars[0], True
    for i in range(len(force)):
        force[i] = 0.0
    base = base_motion(x, wheels[0].place.base, car.positions)
    for i in range(len(wheels)):
        wheel, before, kept, curve = wheels[i], memories[i], after[i], curves[i]
        period, contact_then = car.period, curve.contact
        # Load now, and whether the curve is valid for it; without a valid curve the caller makes one and repeats.
        motion = motion_of(x, wheel.place, base, car.positions)
        now = Motion(motion.vx, motion.slip_x, motion.vy)
        start = before.measured < 0.0
        load, ratio, sprung = _load(wheel, motion, before, loads[i], period)
        curve_load, inclination = before.load, before.inclination
        # Between two measurements the curve stays; forces are only scaled with the load.
        if start or (
            loads[i] != before.measured
            and (abs(load - curve_load) > _SAME * load or abs(motion.inclination - inclination) > _SAME)
        ):
            curve_load, inclination = load, motion.inclination
        kept.load, kept.inclination = curve_load, inclination
        if curve.load != curve_load or curve.inclination != inclination or curve.friction != frictions[i]:
            # The other wheels are still checked, so that the caller makes all missing curves before it repeats.
            known = False
            continue

        # Stiffness and friction follow the present load in proportion, until the next curve.
        scale = load / curve_load if curve_load > 0.0 else 0.0
        contact = Contact(
            contact_then.stiffness_x * scale,
            contact_then.stiffness_y * scale,
            contact_then.length_x,
            contact_then.length_y,
            contact_then.friction_x * scale,
            contact_then.friction_y * scale,
        )

        drive, brake = torques[i], torques[len(wheels) + i]
        fx, fy, mz, kappa, tan_alpha, torque = slip_forces(
            law,
            curve.curve,
            scale,
            contact,
            wheel,
            before,
            kept,
            now,
            motion.spin,
            motion.rolling,
            drive,
            brake,
            period,
        )
        # The plant applies the load at the end of the step; the vertical force changes it to that in the middle.
        add_road_force(
            force, wheel.place, motion, fx, fy, mz, load - ratio * sprung, turn=0.5 * period * base.turning[2]
        )
        force[wheel.place.spin] += torque
        kept.measured, kept.ratio, kept.sprung = loads[i], ratio, sprung
        kept.turning = base.turning[2]
        logged[i, 0], logged[i, 1], logged[i, 2], logged[i, 3], logged[i, 4] = fx, fy, mz, kappa, atan(tan_alpha)
    # In the first step there is no earlier yaw rate to compare with.
    if memories[0].measured >= 0.0:
        turn_along(force, wheels[0].place.base[1], car, base, base.turning[2] - memories[0].turning)
    return known


def slip_forces(
    law: Callable[[Any, float, float, float], tuple[float, float, float]],
    curve: Any,
    scale: float,
    contact: Contact,
    wheel: Any,
    before: Any,
    kept: Any,
    now: Motion,
    spin: float,
    radius: float,
    drive: float,
    brake: float,
    period: float,
) -> tuple[float, float, float, float, float, float]:
    """Return forces and slips of a tyre in the middle of a step, and the torque of motor and brake on its spin.

    Args:
        law: forces in steady state.
        curve: the tyre at the load of its curve.
        scale: present load over that load [1].
        contact: the tyre at the present load.
        wheel: :class:`SpinningWheel`.
        before: :class:`Memory` of the step before.
        kept: memory for the next step; deflections, motion, torque and slip are overwritten.
        now: motion of the contact point.
        spin: spin of the wheel [rad/s].
        radius: effective rolling radius [m].
        drive: drive torque, signed [N m].
        brake: largest torque of the brake [N m].
        period: step of the plant [s].

    Returns:
        Fx [N], Fy [N], Mz [N m], kappa [1], tan alpha [1], torque [N m].
    """
    # Deflections now and in the middle of the step, at constant spin.
    settings = wheel.settings
    deflection = Deflection(before.along, before.across)
    rest = 0.0
    if before.measured >= 0.0:
        mean = Motion(0.5 * (before.vx + now.vx), 0.5 * (before.slip_x + now.slip_x), 0.5 * (before.vy + now.vy))
        deflection = deflection_step(deflection, mean, contact, period=period, settings=settings)
        # T, the torque of all other sources: what the known torques leave unexplained of the last change of spin.
        rest = wheel.inertia * (spin - before.spin) / period - before.torque
    middle = deflection_step(deflection, now, contact, period=0.5 * period, settings=settings)
    kappa, tan_alpha = relaxed_slip(middle, now, contact, settings)

    # Change of the spin by drive, brake and road (linearly implicit), and the slip in the middle of the step.
    mobile = inf if wheel.held else wheel.inertia / period + wheel.damping
    if not wheel.held:
        kappa += _slip_change(before, spin, kappa, contact, now, settings, radius, rest + drive, brake, mobile, period)
    # Forces at this slip, and the torque of the brake.
    fx, fy, mz = law(curve, kappa, tan_alpha, now.vx)
    fx, fy, mz = scale * fx, scale * fy, scale * mz
    torque = drive
    if brake > 0.0 and not wheel.held:
        # Torque that stops the wheel by the end of the step: (I / dt + damping) (-ω) = T + drive + brake - Re Fx.
        needed = radius * fx - mobile * spin - rest - drive
        torque += max(-brake, min(brake, needed))

    # The longitudinal force counts as a known torque, so that the next T does not contain it.
    kept.along, kept.across = deflection.along, deflection.across
    kept.vx, kept.slip_x, kept.vy, kept.spin = now.vx, now.slip_x, now.vy, spin
    kept.torque, kept.fx, kept.kappa = torque - radius * fx, fx, kappa
    return fx, fy, mz, kappa, tan_alpha, torque


def turn_along(force: MutableSequence[float], first: int, car: Any, base: BaseMotion, change: float) -> None:
    """Add the force m v Δψ' / 2 at the centre of mass, to the left of its velocity; see the head of the module."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = base.rows
    # Arm and velocity of the centre of mass, in the world; the force is horizontal and perpendicular to the velocity.
    cx, cy, cz = car.centre[0], car.centre[1], car.centre[2]
    rx, ry, rz = xx * cx + xy * cy + xz * cz, yx * cx + yy * cy + yz * cz, zx * cx + zy * cy + zz * cz
    rate, push = base.turning[2], 0.5 * car.mass * change
    x, y = -push * (base.velocity[1] + rate * rx), push * (base.velocity[0] - rate * ry)
    force[first] -= rz * y
    force[first + 1] += rz * x
    force[first + 2] += rx * y - ry * x
    force[first + 3] += x
    force[first + 4] += y


def _load(wheel: Any, motion: WheelMotion, before: Any, measured: float, period: float) -> tuple[float, float, float]:
    """Return the load in mid-step [N], the ratio of measured to spring load [1], and the spring load at the end [N]."""
    # The plant uses the compression at the end of the step; that in the middle is known for linear springs only.
    depth = wheel.radius - motion.radius
    sprung = spring_load(wheel.spring, depth + period * motion.sink)
    middle = spring_load(wheel.spring, depth) if wheel.spring.power == 1.0 else sprung
    ratio = before.ratio
    # A measurement is of the last step, so it is compared with the spring load predicted for the end of that step.
    if before.measured >= 0.0 and before.measured != measured and before.sprung > _LIFTED * wheel.static_load:
        ratio += _BLEND * (max(1.0 / _MAX_RATIO, min(_MAX_RATIO, measured / before.sprung)) - ratio)
    return ratio * middle, ratio, sprung


def _slip_change(
    before: Any,
    spin: float,
    kappa: float,
    contact: Contact,
    now: Motion,
    settings: RelaxationSettings,
    radius: float,
    torque: float,
    brake: float,
    mobile: float,
    period: float,
) -> float:
    """Return the change of the slip in the middle of the step by the change of the spin; see the head of the module.

    Args:
        before: the step before.
        spin: rate now [rad/s].
        kappa: slip at constant spin [1].
        contact: the tyre.
        now: motion of the contact point.
        settings: behaviour at low speed.
        radius: radius of the wheel [m].
        torque: torque on the spin without brake and road [N m].
        brake: largest torque of the brake [N m].
        mobile: I / dt [N m s/rad].
        period: step of the plant [s].
    """
    if contact.stiffness_x <= 0.0:
        return 0.0
    # b = ∂κ/∂ω in the middle: relaxation over half a step, and the damper that acts at once.
    passed = 0.5 * period * abs(now.vx) / contact.length_x
    share = -expm1(-passed) / passed if passed > _SMALL else 1.0
    damping = settings.damping * low_speed_weight(now.vx, settings.low) + settings.lasting_damping
    damper = damping / contact.stiffness_x
    slope = 0.5 * radius * (0.5 * period * share / contact.length_x + damper)
    # The secant stays positive beyond the peak of the force, where the tangent would make the step unstable.
    stiffness = contact.stiffness_x
    if abs(before.kappa) > _SMALL:
        stiffness = max(0.0, min(stiffness, before.fx / before.kappa))
    inertia = mobile + radius * stiffness * slope

    # Road force linearised about the last step; a brake gives at most the torque that stops the wheel.
    torque -= radius * (before.fx + stiffness * (kappa - before.kappa))
    if brake > 0.0:
        torque += max(-brake, min(brake, -inertia * spin - torque))
    return slope * torque / inertia


STEP_PARTS = (
    *relaxation.STEP_PARTS,
    *wheel_motion.STEP_PARTS,
    spring_load,
    _load,
    slip_forces,
    _slip_change,
    turn_along,
)
"""Functions that :func:`tyre_step` calls, without the law."""
