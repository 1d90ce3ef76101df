"""Equations of the single track at a recorded speed, for floats, arrays and machine code alike.

The formulas and their sources are in the head of :mod:`mirdrake.identification.models.single_track`. The functions
branch on flags only, never on values; :mod:`mirdrake.core.compiled` compiles them for whole logs.
"""

from collections.abc import MutableSequence, Sequence
from typing import Any, NamedTuple

from mirdrake.batched.log_runs import LogEquations
from mirdrake.core.constants import GRAVITY
from mirdrake.core.maths import Value, absolute, atan, cos, larger, sin, smaller, sqrt, tan

TYRES = ("linear", "fiala", "magic_formula")
"""Tyre laws, in the order of their numbers in :class:`TrackFlags`."""

OUTPUTS = ("yaw_rate", "lateral_acceleration", "vy", "roll", "roll_rate")
"""Outputs of :func:`observe`, in their order."""

_LINEAR, _FIALA = 0, 1
_BLEND = 0.05  # time constant of the kinematic motion [s]
_MIN_LOAD = 0.1  # least load of an axle over its static load [1]
_MIN_GRIP = 0.3  # least lateral friction over friction, however the axle drives or brakes [1]
_TINY = 1e-300  # avoids 0 / 0


class TrackFlags(NamedTuple):
    """Variant of the equations.

    Attributes:
        tyres: index in :data:`TYRES`.
        roll: whether the body rolls.
        damper_lag: whether the roll dampers act in series with the tyres.
        relaxation: whether the slip of each axle is a state.
        compliant: whether the steering is compliant.
        sees_acceleration: whether the lateral acceleration is observed.
        acceleration_late: whether it has a delay.
        velocity_late: whether vy has a delay.
        low_speed: speed of the kinematic motion [m/s].
        least_time: shortest time constant of slip, dampers and compliance [s].
    """

    tyres: int
    roll: bool
    damper_lag: bool
    relaxation: bool
    compliant: bool
    sees_acceleration: bool
    acceleration_late: bool
    velocity_late: bool
    low_speed: float
    least_time: float


class TrackState(NamedTuple):
    """States of all variants; those that a variant does not have are zero."""

    vy: Value = 0.0
    yaw_rate: Value = 0.0
    roll: Value = 0.0
    roll_rate: Value = 0.0
    damper_rate: Value = 0.0
    slip_front: Value = 0.0
    slip_rear: Value = 0.0
    steering_deflection: Value = 0.0


class TrackInputs(NamedTuple):
    """Road wheel angle [rad], speed [m/s], its rate [m/s²], and the first two rates of the angle [rad/s, rad/s²]."""

    angle: Value
    speed: Value
    acceleration: Value
    angle_rate: Value
    angle_acceleration: Value


def slip_angles(k: TrackFlags, p: Any, x: TrackState, u: TrackInputs) -> tuple[Value, Value]:
    """Return the kinematic slip angles, front and rear [rad]."""
    v = larger(u.speed, k.low_speed)
    front = atan((x.vy + p.front_length * x.yaw_rate) / v) - (u.angle + x.steering_deflection)
    return front, atan((x.vy - p.rear_length * x.yaw_rate) / v)


def axle_forces(
    k: TrackFlags, p: Any, x: TrackState, u: TrackInputs, slip_front: Value, slip_rear: Value
) -> tuple[Value, Value]:
    """Return the lateral forces of the axles [N] for their kinematic slip angles [rad]."""
    # With relaxation the slip of the tyre is a state that lags the kinematic one.
    front, rear = slip_front, slip_rear
    if k.relaxation:
        front, rear = x.slip_front, x.slip_rear
    if k.roll:
        front, rear = front - p.roll_steer * x.roll, rear - p.roll_steer_rear * x.roll
    # Stiffness and friction scale with the load, so a force at another load is a scaled force at the static one.
    length = p.front_length + p.rear_length
    load_front, load_rear = p.mass * (GRAVITY / length) * p.rear_length, p.mass * (GRAVITY / length) * p.front_length
    moved = p.load_transfer / length * inertial_force(p, x, u)
    more_front = larger(1.0 - moved / load_front, _MIN_LOAD)
    more_rear = larger(1.0 + moved / load_rear, _MIN_LOAD)
    # The forces at the static load are scaled by the load, so the longitudinal force is divided by it first.
    total = total_force(p, x, u)
    along_front = front_force(p, total)
    along_rear = total - along_front
    return (
        more_front * lateral_force(
            k, front, load_front, along_front / more_front, p.cornering_stiffness_front, p.friction_front,
            p.shape_front, p.curvature_front,
        ),
        more_rear * lateral_force(
            k, rear, load_rear, along_rear / more_rear, p.cornering_stiffness_rear, p.friction_rear, p.shape_rear,
            p.curvature_rear,
        ),
    )  # fmt: skip


def inertial_force(p: Any, x: TrackState, u: TrackInputs) -> Value:
    """Return the longitudinal force on the car against inertia and drag, in the axes of the car [N]."""
    return p.mass * (u.acceleration - x.yaw_rate * x.vy) + p.drag * u.speed * u.speed


def total_force(p: Any, x: TrackState, u: TrackInputs) -> Value:
    """Return the longitudinal force of all wheels, which overcomes the backward part of the front lateral force [N]."""
    delta = u.angle + x.steering_deflection
    share = p.rear_length / (p.front_length + p.rear_length)
    return inertial_force(p, x, u) + p.mass * share * u.speed * x.yaw_rate * sin(delta) / cos(delta)


def front_force(p: Any, total: Value) -> Value:
    """Return the part of the front axle in the longitudinal force of all wheels [N]."""
    return p.front_drive * larger(total, 0.0) + p.front_brake * smaller(total, 0.0)


def lateral_force(
    k: TrackFlags,
    slip: Value,
    load: Value,
    longitudinal: Value,
    stiffness: Value,
    friction: Value,
    shape: Value,
    curvature: Value,
) -> Value:
    """Return the lateral force of an axle [N].

    Args:
        k: variant.
        slip: slip angle [rad].
        load: its load [N].
        longitudinal: its longitudinal force [N].
        stiffness: cornering stiffness [N/rad].
        friction: largest force over load [1].
        shape: shape factor [1].
        curvature: curvature factor [1].
    """
    if k.tyres == _LINEAR:
        return -stiffness * slip
    peak = friction * load
    # Friction ellipse: what the longitudinal force leaves for the lateral one.
    share = longitudinal / peak
    left = sqrt(larger(1.0 - share * share, _MIN_GRIP * _MIN_GRIP))
    if k.tyres == _FIALA:
        # Fiala's brush model; `part` above 1 is full sliding, where the force is constant.
        tangent = tan(slip)
        part = stiffness * absolute(tangent) / (3.0 * peak)
        stuck = smaller(part, 1.0)
        return -left * stiffness * (1.0 - stuck + stuck * stuck / 3.0) * tangent / larger(part, 1.0)
    # Magic Formula without shifts; B follows from the stiffness, C and the peak.
    slope = stiffness / (shape * peak) * slip
    return -left * peak * sin(shape * atan(slope - curvature * (slope - atan(slope))))


def accelerations(
    k: TrackFlags, p: Any, x: TrackState, u: TrackInputs, front: Value, rear: Value
) -> tuple[Value, Value, Value]:
    """Return lateral acceleration of the centre of mass [m/s²], yaw and roll acceleration [rad/s²].

    Args:
        k: variant.
        p: parameters by name.
        x: states.
        u: inputs.
        front: lateral force of the front axle, across its wheels [N].
        rear: that of the rear axle [N].
    """
    delta, vx = u.angle + x.steering_deflection, u.speed
    # Forces of the front axle in the axes of the car.
    sine, cosine = sin(delta), cos(delta)
    front = front * cosine + front_force(p, total_force(p, x, u)) * sine
    ahead, behind, inertia = p.front_length, p.rear_length, p.yaw_inertia + p.spin_inertia
    if k.relaxation:
        ahead, behind = ahead - p.trail_front, behind + p.trail_rear
    side = (front + rear) / p.mass
    turn = (ahead * front - behind * rear - p.steering_inertia * u.angle_acceleration) / inertia
    # Slip angles are undefined at standstill: kinematic motion at low speed, blended in.
    low = k.low_speed * k.low_speed
    part = smaller(larger((vx * vx - low) / (8.0 * low), 0.0), 1.0)
    # Smoothstep in v²: the blend has a continuous derivative, or a fit would stop at its ends.
    weigh = part * part * (3.0 - 2.0 * part)
    spin = vx * (sine / cosine) / (p.front_length + p.rear_length)
    slow_turn, slow_vy = (spin - x.yaw_rate) / _BLEND, (p.rear_length * spin - x.vy) / _BLEND
    slow_side = slow_vy + x.yaw_rate * vx
    side, turn = slow_side + weigh * (side - slow_side), slow_turn + weigh * (turn - slow_turn)
    if not k.roll:
        return side, turn, side
    turn = turn + (p.roll_moment * x.roll - p.wheel_momentum * vx * x.roll_rate) / inertia
    # The gyroscopic moment of the wheels adds to the excitation of roll.
    rate = x.roll_rate
    if k.damper_lag:
        rate = x.damper_rate
    share = p.wheel_momentum / (p.mass * p.roll_arm + p.wheel_momentum + _TINY)
    excitation = side + share * (vx * (x.yaw_rate + 0.5 * u.angle_rate) - side)
    natural = p.roll_frequency
    return side, turn, natural * (natural * (p.roll_gain * excitation - x.roll) - 2.0 * p.roll_damping * rate)


class Motion(NamedTuple):
    """Slips, forces and accelerations, from which derivatives and outputs follow.

    Attributes:
        slip_front: kinematic slip angle of the front axle [rad].
        slip_rear: that of the rear axle [rad].
        front: lateral force of the front axle [N].
        side: lateral acceleration of the centre of mass [m/s²].
        turn: yaw acceleration [rad/s²].
        roll: roll acceleration [rad/s²].
    """

    slip_front: Value
    slip_rear: Value
    front: Value
    side: Value
    turn: Value
    roll: Value


def motion_of(k: TrackFlags, p: Any, x: TrackState, u: TrackInputs) -> Motion:
    """Return slips, forces and accelerations."""
    slip_front, slip_rear = slip_angles(k, p, x, u)
    front, rear = axle_forces(k, p, x, u, slip_front, slip_rear)
    side, turn, roll = accelerations(k, p, x, u, front, rear)
    return Motion(slip_front, slip_rear, front, side, turn, roll)


def rates(k: TrackFlags, p: Any, x: TrackState, u: TrackInputs) -> TrackState:
    """Return the time derivatives of the states."""
    return rates_of(k, p, x, u, motion_of(k, p, x, u))


def rates_of(k: TrackFlags, p: Any, x: TrackState, u: TrackInputs, now: Motion) -> TrackState:
    """Return the time derivatives of the states in a motion."""
    # Derivative in the rotating frame of the car: ay = dvy/dt + r vx.
    vy_rate, roll_acceleration = now.side - x.yaw_rate * u.speed, now.roll
    roll_rate, damper_rate, front_rate, rear_rate, deflection_rate = 0.0, 0.0, 0.0, 0.0, 0.0
    if k.roll:
        vy_rate = vy_rate + p.roll_arm * roll_acceleration
        roll_rate = x.roll_rate
    else:
        roll_acceleration = 0.0
    if k.damper_lag:
        damper_rate = (x.roll_rate - x.damper_rate) / larger(p.roll_damper_time, k.least_time)
    if k.relaxation:
        v = larger(u.speed, k.low_speed)
        front_rate = (now.slip_front - x.slip_front) / relaxation_time(k, p.relaxation_front, v)
        rear_rate = (now.slip_rear - x.slip_rear) / relaxation_time(k, p.relaxation_rear, v)
    if k.compliant:
        # Moment about the steering axes: aligning moment, inertia, camber and the gyroscopic moment of the rolling
        # wheels.
        moment = -p.trail_front * now.front - p.steering_inertia * (u.angle_acceleration + now.turn)
        if k.roll:
            moment = moment + p.camber_moment * x.roll - 0.5 * p.wheel_momentum * u.speed * x.roll_rate
        time = larger(p.steering_compliance_time, k.least_time)
        deflection_rate = (p.steering_compliance * moment - x.steering_deflection) / time
    return TrackState(
        vy_rate, now.turn, roll_rate, roll_acceleration, damper_rate, front_rate, rear_rate, deflection_rate
    )  # fmt: skip


def relaxation_time(k: TrackFlags, length: Value, speed: Value) -> Value:
    """Return the time constant of the slip of an axle [s].

    It is a smooth maximum of the relaxation length over the speed and the least time: a search would stop at a corner.
    """
    ratio = length / (speed * k.least_time)
    fourth = ratio * ratio * ratio * ratio
    return k.least_time * sqrt(sqrt(sqrt(1.0 + fourth * fourth)))


def observe(k: TrackFlags, p: Any, x: TrackState, u: TrackInputs) -> tuple[Value, Value, Value, Value, Value]:
    """Return the sensor readings, in the order of :data:`OUTPUTS`; an acceleration that is not observed is zero."""
    return observe_in(k, p, x, u, motion_of(k, p, x, u))


def observe_in(
    k: TrackFlags, p: Any, x: TrackState, u: TrackInputs, now: Motion
) -> tuple[Value, Value, Value, Value, Value]:
    """Return the sensor readings in a motion; see :func:`observe`."""
    seen = 0.0
    if k.sees_acceleration:
        then, motion = x, now
        if k.acceleration_late:
            then, before = earlier(k, p, x, u, p.accelerometer_delay)
            motion = motion_of(k, p, then, before)
        # An accelerometer ahead of the centre of mass also measures d dr/dt; centripetal terms point along the car.
        seen = motion.side + p.accelerometer_ahead * motion.turn
        if k.roll:
            # Height relative to the centre of mass, and the part of gravity that a sensor on the rolling body measures.
            arm, tilt = p.roll_arm - p.accelerometer_height, p.accelerometer_tilt * GRAVITY
            seen = seen + arm * motion.roll + tilt * then.roll
    # The state vy is that of the roll axis; a point above it moves to the left as the body rolls to the left.
    late = x
    if k.velocity_late:
        late, _ = earlier(k, p, x, u, p.velocity_delay)
    vy = late.vy + p.velocity_ahead * late.yaw_rate - p.velocity_height * late.roll_rate
    return x.yaw_rate, seen, vy, x.roll, x.roll_rate


def earlier(k: TrackFlags, p: Any, x: TrackState, u: TrackInputs, delay: Value) -> tuple[TrackState, TrackInputs]:
    """Return states and inputs a delay ago, by the midpoint rule; its error is (delay times frequency)³ / 6."""
    # From the rates instead of stored states: the compiled loop has no memory of earlier steps.
    middle = moved(x, -0.5 * delay, rates(k, p, x, u))
    return moved(x, -delay, rates(k, p, middle, inputs_before(u, 0.5 * delay))), inputs_before(u, delay)


def inputs_before(u: TrackInputs, time: Value) -> TrackInputs:
    """Return the inputs a time ago [s], by their rates."""
    return TrackInputs(
        u.angle - time * u.angle_rate,
        u.speed - time * u.acceleration,
        u.acceleration,
        u.angle_rate - time * u.angle_acceleration,
        u.angle_acceleration,
    )


def moved(x: TrackState, time: Value, slope: TrackState) -> TrackState:
    """Return states after a time [s] at constant rates."""
    return TrackState(
        x.vy + time * slope.vy,
        x.yaw_rate + time * slope.yaw_rate,
        x.roll + time * slope.roll,
        x.roll_rate + time * slope.roll_rate,
        x.damper_rate + time * slope.damper_rate,
        x.slip_front + time * slope.slip_front,
        x.slip_rear + time * slope.slip_rear,
        x.steering_deflection + time * slope.steering_deflection,
    )


# --- for the compiled loop over a log ----------------------------------------------------------------------------


def read_track(x: Sequence[float]) -> TrackState:
    """Return a row as states."""
    return TrackState(x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7])


def read_inputs(u: Sequence[float]) -> TrackInputs:
    """Return a row as inputs."""
    return TrackInputs(u[0], u[1], u[2], u[3], u[4])


def fill_rates(k: Any, p: Any, x: Sequence[float], u: Sequence[float], slopes: MutableSequence[float]) -> None:
    """Write the time derivatives of a row of states."""
    result = rates(k, p, read_track(x), read_inputs(u))
    for i in range(len(result)):
        slopes[i] = result[i]


def fill_outputs(
    k: Any, p: Any, x: Sequence[float], u: Sequence[float], slopes: MutableSequence[float],
    outputs: MutableSequence[float],
) -> None:  # fmt: skip
    """Write the time derivatives and the sensor readings of a row of states."""
    states, inputs = read_track(x), read_inputs(u)
    now = motion_of(k, p, states, inputs)
    result = rates_of(k, p, states, inputs, now)
    for i in range(len(result)):
        slopes[i] = result[i]
    seen = observe_in(k, p, states, inputs, now)
    for i in range(len(seen)):
        outputs[i] = seen[i]


EQUATIONS = LogEquations(
    fill_rates,
    fill_outputs,
    (
        rates, rates_of, motion_of, observe_in, slip_angles, axle_forces, inertial_force, total_force, front_force,
        lateral_force, accelerations, relaxation_time, earlier, inputs_before, moved, read_track, read_inputs,
    ),
)  # fmt: skip
"""Equations for :func:`mirdrake.batched.log_runs.run_log`."""
