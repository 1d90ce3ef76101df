"""Servos, dampers and stops of the joints of a vehicle whose plant Drake integrates, over one step of the length dt.

Drake's contact solver also solves servos, joint damping and joint limits, implicitly. Without it (continuous plant, see
:mod:`mirdrake.plant.plant`) they are solved here, one joint at a time, linearly implicit::

    (I / dt + w D + d + k dt) Δv = R + F - D v + α D (v0 - v) + k (q* - q - v dt) + d (v* - v)

with the inertia I of the joint, its damping D, the gains k and d of its servo with the set-points q* and v*, the known
force F (road, motor, and the gyroscopic moment of a spinning wheel), and R the force of all other sources: the part of
the last change of v that the other terms do not explain. R lags by one step. A stiff servo of a light joint, I / dt <<
d, needs it exactly: an error of R changes the velocity by dt / I, which the servo corrects only in the next steps. The
gyroscopic moment on a steering axis is therefore not in R: it is the one that changes fastest, with the roll rate.

The servo has the implicit Euler rule, stable for any gain. Its force is k (q* - q - v dt) + d (v* - v) -
(d + k dt) Δv, within its limit.

The velocities v0, v and v + Δv of three steps lie half a step beside the positions, at which forces act. The damper
takes the value of their parabola there, so α = 1/8 and w = 1/2 - α: an error of third order in dt. The trapezoidal
rule, α = 0, is 6 % too weak at 20 Hz and 5 ms. For stiff dampers, a = D dt / I,

    α = max(0, 1 - a / 2) / 8,    w = max(1 / 2, 1 - 1 / a) - α.

Above a = 2 the damper alone stops the joint within the step.

An actuator without a servo has a torque that is constant during each step, from t to t + dt. The velocities of the step
are those of t - dt/2 and t + dt/2, so the mean of the torques of the last step and of this one acts: with that of this
step alone, the joint would be ahead of its torque by half a step.

The plant applies -D v by itself; the rest is added here. A joint that would pass a limit gets the force that stops it
there at the end of the step: a plastic impact.

The joint of one wheel hardly moves the others: I is the inverse of its diagonal element of the inverse mass matrix. The
scheme is stable while I is less than 4/3 of the true inertia.
"""

from collections.abc import MutableSequence, Sequence
from typing import Any, NamedTuple

from mirdrake.core.compiled import Records


class StiffJoint(NamedTuple):
    """Joint with a servo, a damper or limits.

    Attributes:
        position: index in the plant's positions.
        velocity: index in the plant's velocities.
        inertia: that a force on the joint alone accelerates [kg m² or kg].
        damping: of the joint [N m s/rad or N s/m].
        stiffness: gain of the servo [N m/rad].
        gain: the same for the velocity [N m s/rad].
        lower: limit of the position [rad or m].
        upper: the same.
        actuator: index among the actuators of the vehicle; negative without one.
        effort_limit: largest torque of the actuator [N m].
        spin_inertia: of a steering joint, inertia of its wheel about the axle [kg m²].
    """

    position: int
    velocity: int
    inertia: float
    damping: float
    stiffness: float
    gain: float
    lower: float
    upper: float
    actuator: int
    effort_limit: float
    spin_inertia: float = 0.0


class JointMemory(NamedTuple):
    """Memory of a joint from step to step.

    Attributes:
        begun: zero at the start, then 1.
        rate: velocity at the beginning of the step [rad/s or m/s].
        force: known force during the step [N m or N].
        effort: torque of the actuator without servo [N m].
    """

    begun: float
    rate: float
    force: float
    effort: float


def joint_steps(
    x: Sequence[float],
    positions: int,
    period: float,
    joints: Records,
    first: int,
    memories: Records,
    efforts: Sequence[float],
    desired: Sequence[float],
    force: MutableSequence[float],
    after: Records,
    actuation: MutableSequence[float],
    gyros: Sequence[float],
) -> None:
    """Solve the joints of a vehicle over one step.

    Args:
        x: state of the plant, positions and velocities.
        positions: number of the plant's positions.
        period: length of the step [s].
        joints: :class:`StiffJoint`.
        first: index of the first joint that is solved here.
        memories: :class:`JointMemory` of the step before.
        efforts: torques of the actuators without their servos [N m].
        desired: set-points of the servos, positions, then velocities.
        force: generalised forces of the plant, with those of the road; changed.
        after: memories for the next step, overwritten.
        actuation: torques of the actuators with their servos [N m], changed at the joints.
        gyros: gyroscopic moments about the first of these joints over the spin inertias of their wheels, which the
            plant applies [1/s²].
    """
    for i in range(first, len(joints)):
        joint, before, kept = joints[i], memories[i], after[i]
        q, v = x[joint.position], x[positions + joint.velocity]
        # Parabola of the damper; a heavily damped joint has the trapezoidal rule or is stopped.
        stiff = joint.damping * period / joint.inertia
        curved = 0.125 * max(0.0, 1.0 - 0.5 * stiff)
        weight = (max(0.5, 1.0 - 1.0 / stiff) if stiff > 0.0 else 0.5) - curved
        rest, damper = 0.0, 0.0
        if before.begun > 0.0:
            rest = joint.inertia * (v - before.rate) / period - before.force + joint.damping * (before.rate - v)
            damper = curved * joint.damping * (before.rate - v)
        known, mobile = force[joint.velocity] + damper, joint.inertia / period + weight * joint.damping
        if joint.spin_inertia > 0.0:
            known += joint.spin_inertia * gyros[i - first]
        if joint.actuator >= 0:
            servo, gain = servo_effort(joint, x, positions, efforts, desired, period, rest + known, mobile)
            torque = servo - gain * (rest + known + servo) / (mobile + gain)
            kept.effort = torque
            if joint.stiffness == 0.0 and joint.gain == 0.0 and before.begun > 0.0:
                torque = 0.5 * (before.effort + torque)
            actuation[joint.actuator] = torque
            known += torque
        change = (rest + known) / mobile
        # Force that stops the joint at its limit.
        end = q + period * (v + change)
        beyond = max(0.0, end - joint.upper) + min(0.0, end - joint.lower)
        change -= beyond / period
        added = -weight * joint.damping * change - beyond * joint.inertia / (period * period)
        force[joint.velocity] += damper + added
        kept.begun, kept.rate, kept.force = 1.0, v, known + added


def servo_effort(
    joint: Any,
    x: Sequence[float],
    positions: int,
    efforts: Sequence[float],
    desired: Sequence[float],
    period: float,
    others: float,
    mobile: float,
) -> tuple[float, float]:
    """Return the torque of an actuator at the end of a step with constant velocity [N m], and -∂torque/∂v [N m s/rad].

    A servo that would exceed its limit at the end of the step has the torque of the limit.

    Args:
        joint: :class:`StiffJoint`.
        x: state of the plant, positions and velocities.
        positions: number of the plant's positions.
        efforts: torques of the actuators without their servos [N m].
        desired: set-points of the servos, positions, then velocities.
        period: length of the step [s].
        others: torque of all other sources [N m].
        mobile: inertia over the length of the step, with the damping [N m s/rad].
    """
    a, q, v = joint.actuator, x[joint.position], x[positions + joint.velocity]
    torque = joint.stiffness * (desired[a] - q - period * v) + joint.gain * (desired[len(efforts) + a] - v) + efforts[a]
    gain: float = joint.gain + joint.stiffness * period
    limit: float = joint.effort_limit
    implicit = torque - gain * (others + torque) / (mobile + gain)
    if implicit > limit:
        return limit, 0.0
    if implicit < -limit:
        return -limit, 0.0
    return torque, gain


JOINT_PARTS = (servo_effort, joint_steps)
"""Functions of this module that steps call."""
