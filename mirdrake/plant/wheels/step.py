"""One step of the tyres of a vehicle; :mod:`mirdrake.core.compiled` compiles it.

One step has the length dt. The law is evaluated at the deflections in the middle of the step. The lateral deflection is
known in the middle of the last step. It is advanced by a step with the present slip velocity, which is that between
both, and with the last change of it. With the explicit steps of the plant this is a leap-frog scheme, which neither
damps nor excites oscillations of the vehicle on its tyres, and a slip velocity that changes linearly has exactly the
lag of the relaxation. Velocities of dampers are extrapolated to the middle of the step. Two properties of the plant
would cause first-order errors:

- The plant moves the vehicle with the velocities at the end of a step, so that positions lead velocities by half a
  step. The heading is then that of the middle of a step, where the forces act, and slip velocities are those of a
  vehicle that is turned back by ψ' dt / 2, with the yaw rate ψ' (:func:`base_motion`).
- The plant applies the load of Drake's contact at the end of a step. That would damp the vehicle on its tyres by their
  stiffness k times dt / 2, many times the damping of rubber, and add k dt² to the mass that bounces.

The load of a tyre is its stiffness times its deflection, plus damping, on every contact, in the middle of the step.
What Drake's contact will give at the end of the step is subtracted from it, and the rest is applied. That needs the
change of the velocity of each wheel in this step. The acceleration a by which a wheel sinks depends on the loads N of
all wheels and on all other forces, whose part r in it changes slowly and is extrapolated::

    a = r - W N,    r = 2 r' - r",    r' = a' + W N'

Dashes mark the steps before; W = J (M + D dt)⁻¹ Jᵀ with the Jacobian J of the wheels' heights, the mass matrix M and
the joint dampers D that the plant solves implicitly. A mass on springs then moves as in explicit steps, which have
errors of second order and diverge beyond ω dt = 2, with the highest frequency ω of vehicle and wheels on the tyres.
Drake's implicit contact never does. Beyond ω dt = 1/2 only the share 1 / (2 ω dt)² of a is used, so that a step is
stable at any length.

A patch of hydroelastic contact has another characteristic (:mod:`mirdrake.plant.wheel_shape`), and so another load at
the end of the step. The load of the tyre acts at its contact centre. The load of the contact shape, which the arms of
the suspension do not move, is subtracted at that of the shape, with the moment that an inclined shape has about it.

The spin of a wheel is too fast for a leap-frog: 1 kg m² on a slip stiffness of 100 kN oscillates with 30 Hz, and steps
of 10 ms would be unstable. The equations of spin and deflection, linear in the step with the slip stiffness S, are
therefore solved exactly::

    (I / h) (s' + Vx') = T + M - h F,    u' = s - |Vx| u / σ,    F = F0 + S {(u - u0) / σ + (k / C) (s - s0)}

with the spin inertia I, the rolling radius h, the slip velocity s = h ω - Vx, the torque M of motor, brake and rolling
resistance, and T the torque from other sources (servo, bearing, pitch of the body). T is the part of the last change of
ω that the other terms do not explain, and Vx' is that of the last step. S is the secant F0 / κ0 of the step before;
where the law deviates from it, S is the chord of the law from κ0 to the slip that this secant gives. The law is
evaluated at the slip that gives the mean of F. The mean of s, which deflects the tyre, is not that of both ends of the
step; their difference is remembered. In steady motion s is constant, whatever T is.

The curve of a tyre at its load is interpolated (:mod:`mirdrake.plant.wheels.tyre_nodes`). That of a Coulomb tyre is
proportional to the load, so one curve is sufficient.

The pivoting moment resists the turn rate ω of a Coulomb tyre about the normal. On a patch of width w with the slip
stiffness C of a tyre, in rolling, slip velocities ω y give Mz = -C w² ω / (12 |v|), at most μ N w / 4, the moment of
sliding friction on a line of width w. At standstill it is a spring, C w² / (12 σ), with the same limit. The relaxation
of :mod:`mirdrake.tyres.relaxation` joins both. The rolling resistance is an external moment about the axle, so that the
road pushes back with Crr N.

A brake is Coulomb friction: its torque is the one that would stop the wheel by the end of the step, within its limit. A
wheel at standstill is held by exactly the torque needed, and a turning wheel gets the full torque. As T is late by a
step, a wheel that is held turns a little to and fro while the body pitches. This is not a slip velocity of the tyre: it
would feed the oscillation of a light vehicle, which rocks at 60 rad/s, at steps of 10 ms.

The overturning moment of a tyre file is linear in the lateral force at each load and inclination.

Not modelled: turn slip of tyres with slip (their moment against steering at standstill is that of the kingpin offset
alone).
"""

from collections.abc import Callable, MutableSequence, Sequence
from math import asin, atan, cos, exp, inf, sin, sqrt, tanh
from typing import Any, NamedTuple

from mirdrake.core.compiled import Records
from mirdrake.plant.wheel_shape import PATCH_PARTS, patch_load
from mirdrake.plant.wheels import motion as wheel_motion
from mirdrake.plant.wheels.motion import WheelMotion, WheelPlace, add_road_force, base_motion
from mirdrake.plant.wheels.motion import wheel_motion as motion_of
from mirdrake.plant.wheels.tyre_nodes import NODE_PARTS, TyreNodes, find_tyre
from mirdrake.tyres import relaxation
from mirdrake.tyres.coulomb import PIVOT_LENGTH, PIVOT_STIFFNESS
from mirdrake.tyres.relaxation import (
    Contact,
    Deflection,
    Motion,
    RelaxationSettings,
    deflect_across,
    deflect_along,
    low_speed_weight,
    relaxation_step,
    relaxed_slip,
)

SMOOTH_SPEED = 0.3
"""Wheel speed below which rolling resistance fades [rad/s], about 0.1 m/s for a car wheel."""

_LYING = 0.5  # sine of the inclination from which a wheel lies on its side [1]

# Below this, differences of floats are noise: limits are taken instead of quotients.
_SMALL = 1e-9

_LINEAR = 1e-3  # deviation of a force from its secant, over the friction force, up to which it is linear [1]
_SLOW = 1e-6  # product of both rates and the squared step below which a sliding tyre is not solved exactly [1]


class SpinningWheel(NamedTuple):
    """Wheel with a tyre law.

    Attributes:
        place: position on its vehicle and in the plant's state.
        inertia: spin inertia, with the rotor of the motor [kg m²].
        damping: damping of the spin that Drake solves implicitly: servo gain and bearing [N m s/rad].
        held: whether a parking brake holds it.
        radius: unloaded [m].
        stiffness: vertical stiffness [N/m]; not used where the tyre touches the ground itself.
        rebound: vertical damping over the force [s/m]; not used there either.
        modulus: of its hydroelastic mesh [Pa]; zero in point contact.
        mesh: width of this mesh, negative if it is mirrored [m].
        shape: place of its contact shape in the plant, which the arms of its suspension do not move.
        static_load: its load at rest [N].
        settings: damping of its tyre.
        width: width of the tread [m].
        resistance: rolling-resistance coefficient Crr [1].
        coulomb: whether its tyre has Coulomb friction: forces proportional to the load, and a pivoting moment.
        actuator: index of its actuator among those of its vehicle.
        effort_limit: largest torque of the actuator [N m].
        mobility: acceleration upwards by a load of one newton on each wheel of the vehicle [1/kg]; not used where the
            tyre touches the ground itself.
        foresight: share of the acceleration in a step that counts; not used there either.
    """

    place: WheelPlace
    inertia: float
    damping: float
    held: bool
    radius: float
    stiffness: float
    rebound: float
    modulus: float
    mesh: float
    shape: WheelPlace
    static_load: float
    settings: RelaxationSettings
    width: float
    resistance: float
    coulomb: bool
    actuator: int
    effort_limit: float
    mobility: tuple[float, float, float, float]
    foresight: float


class SpinningCar(NamedTuple):
    """Properties of a vehicle that its wheels share.

    Attributes:
        period: step of the plant [s].
        positions: number of the plant's positions.
    """

    period: float
    positions: int


class Memory(NamedTuple):
    """Memory of a wheel from step to step.

    Attributes:
        along: longitudinal deflection of the tyre at the beginning of the last step [m].
        across: lateral deflection in its middle [m].
        vx: motion of the last step [m/s].
        slip_x: the same [m/s].
        vy: the same [m/s].
        spin: the same [rad/s].
        torque: torque of motor, brake, rolling resistance and longitudinal force on the spin [N m].
        fx: longitudinal force [N].
        kappa: its longitudinal slip [1].
        bend: mean slip velocity in the step, less the mean of its ends [m/s].
        begun: zero at the start, then 1, and 2 from the second step on of wheels on Drake's contact.
        stopped: 1 if the brake has stopped the wheel in the last step, else zero.
        twist: angle by which the contact patch is twisted [rad].
        rise: vertical velocity of the wheel centre [m/s].
        load: load of a wheel that Drake's contact bears [N].
        rest: change of its velocity downwards in the step before that, by all forces but the loads [m/s].
    """

    along: float
    across: float
    vx: float
    slip_x: float
    vy: float
    spin: float
    torque: float
    fx: float
    kappa: float
    bend: float
    begun: float
    stopped: float
    twist: float
    rise: float
    load: float
    rest: float


def tyre_step(
    law: Callable[[Any, float, float, float], tuple[float, float, float]],
    x: Sequence[float],
    torques: Sequence[float],
    efforts: Sequence[float],
    frictions: Sequence[float],
    cars: Records,
    wheels: Records,
    curves: Records,
    nodes: TyreNodes,
    memories: Records,
    force: MutableSequence[float],
    after: Records,
    logged: Any,
    resistances: MutableSequence[float],
    tyre_load: MutableSequence[float],
) -> bool:
    """Compute the forces of the road on the tyres, and the memory of the wheels.

    Args:
        law: forces in steady state, of :class:`mirdrake.tyres.SteadyLaw`.
        x: state of the plant, positions and velocities.
        torques: drive torque of each wheel, signed, then the largest torque of each brake [N m].
        efforts: torques of the actuators of the vehicle, which the plant applies [N m].
        frictions: friction of the ground under each wheel, relative to dry asphalt [1].
        cars: one :class:`SpinningCar`.
        wheels: :class:`SpinningWheel`.
        curves: the tyres at their loads, contact and curve, overwritten.
        nodes: their nodes.
        memories: :class:`Memory` of the step before.
        force: generalised forces of the plant (num_velocities) [N, N m], overwritten.
        after: memories for the next step, overwritten.
        logged: Fx, Fy, Mz, kappa and alpha of each wheel, overwritten.
        resistances: torque of the rolling resistance of each wheel [N m], overwritten.
        tyre_load: load of each wheel in the middle of the step [N], overwritten.

    Returns:
        Whether all nodes of the curves are known; if not, the results are not valid.
    """
    car, known = cars[0], True
    for i in range(len(force)):
        force[i] = 0.0
    period = car.period
    base = base_motion(x, wheels[0].place.base, car.positions, period)
    motions = [motion_of(x, wheels[i].place, base, car.positions) for i in range(len(wheels))]
    for i in range(len(wheels)):
        after[i].rise, after[i].load = -motions[i].sink, tyre_load_of(wheels[i], motions[i], memories[i])
    for i in range(len(wheels)):
        wheel, before, kept, curve = wheels[i], memories[i], after[i], curves[i]
        contact_then, motion, load = curve.contact, motions[i], kept.load
        now = Motion(motion.vx, motion.slip_x, motion.vy)
        # Change of the speed in this step, by the loads and by all other forces.
        change, kept.rest = 0.0, 0.0
        if before.begun > 0.0:
            kept.rest = motion.sink + before.rise
            for j in range(len(wheels)):
                kept.rest += wheel.mobility[j] * period * memories[j].load
                change -= wheel.mobility[j] * period * after[j].load
            change += 2.0 * kept.rest - before.rest if before.begun > 1.0 else kept.rest
        shape = motion_of(x, wheel.shape, base, car.positions)
        borne, moment_x = drake_load(wheel, shape, period, shape.sink + wheel.foresight * change)
        # The curve at the present load; if a node is missing, the caller makes it and repeats.
        curve_load = wheel.static_load if wheel.coulomb else min(max(load, nodes.lowest), nodes.highest)
        if not find_tyre(nodes, i, curve_load, 0.0 if wheel.coulomb else motion.inclination, frictions[i]):
            # The other wheels are still checked, so that the caller makes all missing nodes before it repeats.
            known = False
            continue

        scale = load / curve_load if load > nodes.lowest else 0.0
        contact = Contact(
            contact_then.stiffness_x * scale,
            contact_then.stiffness_y * scale,
            contact_then.length_x,
            contact_then.length_y,
            contact_then.friction_x * scale,
            contact_then.friction_y * scale,
            contact_then.overturning * scale,
            contact_then.overturning_by_fy,
        )

        # The actuator's effort is part of the spin balance, but the plant applies it itself: it is subtracted below.
        effort = limited_effort(wheel, efforts)
        drive, brake = torques[i] + effort, torques[len(wheels) + i]
        resistance = rolling_moment(wheel, load, motion.rolling, motion.spin)
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
            resistance,
            wheel.damping,
            period,
        )
        twist, moment = pivoting(wheel, load, before.twist, motion.turn, now.vx, contact, period)
        # The load of the tyre replaces that which the plant applies by its contact.
        add_road_force(
            force,
            wheel.place,
            motion,
            fx,
            fy,
            mz + moment,
            load,
            resistance,
            torque - drive,
            contact.overturning + contact.overturning_by_fy * fy,
        )
        add_road_force(force, wheel.shape, shape, 0.0, 0.0, 0.0, -borne, 0.0, 0.0, -moment_x)
        force[wheel.place.spin] += torque - effort
        kept.begun, kept.twist = min(before.begun + 1.0, 2.0), twist
        logged[i, 0], logged[i, 1], logged[i, 2] = fx, fy, mz + moment
        logged[i, 3], logged[i, 4] = kappa, atan(tan_alpha)
        resistances[i], tyre_load[i] = resistance, load
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
    resistance: float,
    damping: float,
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
        resistance: torque of the rolling resistance [N m].
        damping: of the spin, by servo and bearing at the end of the step [N m s/rad].
        period: step of the plant [s].

    Returns:
        Fx [N], Fy [N], Mz [N m], kappa [1], tan alpha [1], torque [N m].
    """
    # Deflections: along now, and in the middle of the step if the wheel does not turn; across in the middle.
    settings, still = wheel.settings, before.stopped > 0.0
    if still:
        now = Motion(now.vx, now.vx, now.vy)
    along, across, rest, push, middle = before.along, before.across, 0.0, 0.0, now
    if before.begun > 0.0:
        change_x, change_y = now.slip_x - before.slip_x, now.vy - before.vy
        mean = Motion(0.5 * (before.vx + now.vx), 0.5 * (before.slip_x + now.slip_x) - before.bend, before.vy)
        along = deflect_along(along, mean, contact, period, settings, change_x)
        across = deflect_across(across, now, contact, period, settings, change_y)
        slip_x = now.slip_x + 0.5 * change_x if still or wheel.held else now.slip_x
        middle = Motion(now.vx, slip_x, now.vy + 0.5 * change_y)
        push = now.vx - before.vx
        # T, the torque of all other sources: what the known torques leave unexplained of the last change of spin.
        rest = wheel.inertia * (spin - before.spin) / period - before.torque
    else:
        across = deflect_across(across, now, contact, 0.5 * period, settings)
    ahead = along
    if still or wheel.held:
        ahead = deflect_along(along, now, contact, 0.5 * period, settings)
    kappa, tan_alpha = relaxed_slip(Deflection(ahead, across), middle, contact, settings)

    # Forces of a wheel that stands still, if the brake can hold it: it must bear T + M - Re Fx and remove the rest of
    # the spin, -(I / dt + damping) ω.
    mobile = inf if wheel.held else wheel.inertia / period + damping
    given, bend, stopped = rest + drive + resistance, 0.0, 0.0
    torque, needed = drive, 0.0
    fx, fy, mz = 0.0, 0.0, 0.0
    if still or wheel.held:
        fx, fy, mz = law(curve, kappa, tan_alpha, now.vx)
        if not wheel.held:
            needed = scale * radius * fx - mobile * spin - given
            still = abs(needed) < brake
    # Slip for the mean force, with the spin changed by drive, brake, rolling resistance and road.
    if not (still or wheel.held):
        known, force = before.kappa, before.fx
        # The secant stays positive beyond the peak of the force, where the tangent would make the step unstable.
        slope = contact.stiffness_x
        if abs(known) > _SMALL:
            slope = max(0.0, min(slope, force / known))
        kappa, bend = _mean_slip(
            known, force, slope, along, spin, contact, now, settings, radius, given, brake, mobile, push, period
        )
        fx, fy, mz = law(curve, kappa, tan_alpha, now.vx)
        # Where the force is not that of the secant, a chord of the law at this load and lateral slip replaces it.
        wrong, moved = scale * fx - force - slope * (kappa - known), kappa - known
        if abs(wrong) > _LINEAR * contact.friction_x and abs(moved) > _SMALL:
            force = scale * law(curve, known, tan_alpha, now.vx)[0]
            slope = max(0.0, min(contact.stiffness_x, (scale * fx - force) / moved))
            kappa, bend = _mean_slip(
                known, force, slope, along, spin, contact, now, settings, radius, given, brake, mobile, push, period
            )
            fx, fy, mz = law(curve, kappa, tan_alpha, now.vx)
        needed = scale * radius * fx - mobile * spin - given
    fx, fy, mz = scale * fx, scale * fy, scale * mz
    if brake > 0.0 and not wheel.held:
        torque += max(-brake, min(brake, needed))
        stopped = 1.0 if abs(needed) < brake else 0.0

    # Longitudinal force and rolling resistance count as known torques, so that the next T does not contain them.
    kept.along, kept.across, kept.stopped = along, across, stopped
    kept.vx, kept.slip_x, kept.vy, kept.spin = now.vx, now.slip_x, now.vy, spin
    kept.torque, kept.fx, kept.kappa, kept.bend = torque + resistance - radius * fx, fx, kappa, bend
    return fx, fy, mz, kappa, tan_alpha, torque


def pivoting(
    wheel: Any, load: float, twist: float, turn: float, vx: float, patch: Contact, period: float
) -> tuple[float, float]:
    """Return the twist of the contact patch after a step [rad], and the pivoting moment [N m].

    Args:
        wheel: :class:`SpinningWheel`.
        load: normal load [N].
        twist: twist before the step [rad].
        turn: angular velocity of the wheel carrier about the normal [rad/s].
        vx: longitudinal speed [m/s].
        patch: the tyre at its load.
        period: length of the step [s].
    """
    if not wheel.coulomb or patch.stiffness_x <= 0.0:
        return 0.0, 0.0
    # Limit and stiffness of the head of the module: friction on a line of the width, and a spring at standstill.
    largest = 0.25 * patch.friction_y * wheel.width
    stiffness = PIVOT_STIFFNESS * load * wheel.width * wheel.width / (12.0 * PIVOT_LENGTH)
    limit = largest / stiffness
    twist = relaxation_step(
        twist, turn, abs(vx) / PIVOT_LENGTH, limit, low_speed_weight(vx, wheel.settings.low), period
    )
    return twist, -max(-largest, min(largest, stiffness * twist))


def limited_effort(wheel: Any, efforts: Sequence[float]) -> float:
    """Return the torque of the actuator of a wheel [N m], limited as by the plant."""
    effort: float = max(-wheel.effort_limit, min(wheel.effort_limit, efforts[wheel.actuator]))
    return effort


def rolling_moment(wheel: Any, load: float, radius: float, spin: float) -> float:
    """Return the moment of the rolling resistance about the axle [N m], -Crr N Re, smooth through standstill."""
    moment: float = -wheel.resistance * load * radius * tanh(spin / SMOOTH_SPEED)
    return moment


def tyre_load_of(wheel: Any, motion: WheelMotion, before: Any) -> float:
    """Return the load of a tyre in the middle of the step [N].

    Args:
        wheel: :class:`SpinningWheel`.
        motion: its motion.
        before: :class:`Memory` of the step before.
    """
    # Positions lead the velocities by half a step: those at the beginning of a step are those of its middle. The speed
    # of the damper is extrapolated to it.
    sink = motion.sink + (0.5 * wheel.foresight * (motion.sink + before.rise) if before.begun > 0.0 else 0.0)
    load: float = wheel.stiffness * max(wheel.radius - motion.radius, 0.0) * max(1.0 + wheel.rebound * sink, 0.0)
    return load


def drake_load(wheel: Any, motion: WheelMotion, period: float, sink: float) -> tuple[float, float]:
    """Return the load [N] and the overturning moment about the tyre's x axis [N m] of Drake's contact in a step.

    Args:
        wheel: :class:`SpinningWheel`.
        motion: motion of the contact shape of the wheel.
        period: step of the plant [s].
        sink: speed of the wheel centre downwards at the end of the step [m/s].
    """
    sine, damping = motion.axle[2], max(1.0 + wheel.rebound * sink, 0.0)
    # The equations below do not hold for a wheel that lies on its side.
    if abs(sine) > _LYING:
        return wheel.stiffness * max(wheel.radius - motion.radius, 0.0) * damping, 0.0
    if wheel.modulus > 0.0:
        ahead, up = motion.ahead, motion.up
        pitch = -asin(max(-1.0, min(1.0, ahead[0] * up[0] + ahead[1] * up[1])))
        height = max(motion.z, 0.5 * wheel.radius)
        size, moment = patch_load(wheel.radius, wheel.mesh, height, sine, pitch, period * sink)
        return wheel.modulus * size * damping, wheel.modulus * moment * damping
    # The lowest point of an ellipsoid; fcl moves it by half the depth towards the centre.
    cosine, side = sqrt(1.0 - sine * sine), 0.5 * wheel.width
    low = sqrt(wheel.radius * wheel.radius * cosine * cosine + side * side * sine * sine)
    depth = low - motion.z
    borne = wheel.stiffness * max(depth + period * sink, 0.0) * damping
    left = (wheel.radius * wheel.radius - side * side) * sine * cosine / low * (1.0 - 0.5 * depth / low)
    return borne, borne * (left - motion.z * sine / cosine)


def _mean_slip(
    known: float,
    force: float,
    slope: float,
    along: float,
    spin: float,
    contact: Contact,
    now: Motion,
    settings: RelaxationSettings,
    radius: float,
    torque: float,
    brake: float,
    mobile: float,
    push: float,
    period: float,
) -> tuple[float, float]:
    """Return the slip for the mean force of a step, and the mean of s less that of its ends [m/s].

    See the head of the module.

    Args:
        known: slip about which the force is linear [1].
        force: force at this slip [N].
        slope: its derivative, not negative [N].
        along: longitudinal deflection now [m].
        spin: rate now [rad/s].
        contact: the tyre.
        now: motion of the contact point.
        settings: behaviour at low speed.
        radius: radius of the wheel [m].
        torque: torque on the spin without brake and road [N m].
        brake: largest torque of the brake [N m].
        mobile: I / dt [N m s/rad].
        push: change of Vx in the step [m/s].
        period: step of the plant [s].
    """
    if contact.stiffness_x <= 0.0:
        return 0.0, 0.0
    damping = settings.damping * low_speed_weight(now.vx, settings.low) + settings.lasting_damping
    damper, decay = damping / contact.stiffness_x, abs(now.vx) / contact.length_x
    s0, u0, gain = -now.slip_x, along, radius / (mobile * period)
    # x' = A x + g for x = (s - s0, u - u0).
    pull = radius * gain * slope
    a, b = -pull * damper, -pull / contact.length_x
    determinant, trace = pull * (damper * decay + 1.0 / contact.length_x), a - decay
    if determinant * period * period < _SLOW:
        # The force is constant, so s is linear.
        change = gain * (torque - radius * force) * period
        if brake > 0.0:
            limit = gain * brake * period
            change += max(-limit, min(limit, -radius * spin - change))
        return _slip_of_ramp(u0, s0, change - push, decay, damper, contact.length_x, period), 0.0

    # exp(A t) = c 1 + e (A - trace / 2 1), for real and for complex eigenvalues.
    square = 0.25 * trace * trace - determinant
    if square > 0.0:
        fast = 0.5 * trace - sqrt(square)
        slow = determinant / fast
        one, other = exp(slow * period), exp(fast * period)
        c, e = 0.5 * (one + other), (one - other) / (slow - fast)
    else:
        rate, size = sqrt(-square), exp(0.5 * trace * period)
        c, e = size * cos(rate * period), size * (sin(rate * period) / rate if rate > _SMALL else period)
    half = 0.5 * (a + decay)  # of A - trace / 2 1, the first of its diagonal
    # P = A⁻¹ (exp(A t) - 1), with A⁻¹ = ((-decay, -b), (-1, a)) / determinant.
    m11, m12, m21, m22 = c + e * half - 1.0, e * b, e, c - e * half - 1.0
    p11, p12 = (-decay * m11 - b * m21) / determinant, (-decay * m12 - b * m22) / determinant
    p21, p22 = (-m11 + a * m21) / determinant, (-m12 + a * m22) / determinant

    # Force at the beginning of the step.
    start = force + slope * (u0 / contact.length_x + damper * s0 - known)
    g1, g2 = gain * (torque - radius * start) - push / period, s0 - decay * u0
    if brake > 0.0:
        # The torque that stops the wheel by the end of the step, within its limit.
        held = max(-brake, min(brake, (-radius * spin - push - p11 * g1 - p12 * g2) / (p11 * gain)))
        torque += held
        g1 += gain * held
    change, moved = p11 * g1 + p12 * g2, p21 * g1 + p22 * g2
    # Mean of x over the step: A⁻¹ (x - g t) / t.
    mean = (-decay * (change - g1 * period) - b * (moved - g2 * period)) / (determinant * period)
    needed = (torque - mobile * (change + push) / radius) / radius
    return known + (needed - force) / slope, mean - 0.5 * change


def _slip_of_ramp(
    u0: float, s0: float, change: float, decay: float, damper: float, length: float, period: float
) -> float:
    """Return the mean slip of a step with a linear slip velocity.

    Args:
        u0: deflection at its beginning [m].
        s0: slip velocity there [m/s].
        change: its change in the step [m/s].
        decay: |Vx| / σ [1/s].
        damper: k / C [s/m].
        length: relaxation length σ [m].
        period: length of the step [s].
    """
    # Means of u over the step, for a deflection, a slip velocity and a ramp of it of one; series for small p.
    p = decay * period
    if p < 1e-3:
        rest, constant, ramp = 1.0 - p / 2.0 + p * p / 6.0, 0.5 - p / 6.0 + p * p / 24.0, (1.0 - 0.25 * p) / 6.0
    else:
        rest = (1.0 - exp(-p)) / p
        constant = (1.0 - rest) / p
        ramp = (0.5 - constant) / p
    deflection = rest * u0 + period * (constant * s0 + ramp * change)
    return deflection / length + damper * (s0 + 0.5 * change)


STEP_PARTS = (
    *relaxation.STEP_PARTS,
    *wheel_motion.STEP_PARTS,
    *NODE_PARTS,
    *PATCH_PARTS,
    tyre_load_of,
    drake_load,
    slip_forces,
    pivoting,
    limited_effort,
    rolling_moment,
    _mean_slip,
    _slip_of_ramp,
)
"""Functions that :func:`tyre_step` calls, without the law."""
