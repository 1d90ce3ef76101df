"""One step of tyres that touch the ground themselves (`plant.contact: tyre`), in Python or compiled.

Each wheel has a vertical force by its deflection (:mod:`mirdrake.tyres.vertical`) along the normal of the effective
plane (:mod:`mirdrake.plant.wheels.ground_contact`), slip forces in this plane as in :mod:`mirdrake.plant.wheels.step`,
and rolling resistance. All of them follow from the present state, and the plant applies them explicitly: the scheme is
symplectic, stable for ω dt < 2, and neither damps nor excites a vehicle on its tyres.

A continuous plant has the same forces throughout a step. The servo of a wheel is solved with its spin then, linearly
implicit: with the change Δω of the spin that the law predicts, its torque is k (q* - q - ω dt) + d (ω* - ω) -
(d + k dt) Δω. :mod:`mirdrake.plant.wheels.joint_step` solves the other joints.
"""

from collections.abc import Callable, MutableSequence, Sequence
from math import atan
from typing import Any, NamedTuple

import numpy as np

from mirdrake.core.compiled import Records
from mirdrake.ground.layers import GROUND_PARTS, TerrainData
from mirdrake.plant.wheels.ground_contact import (
    CONTACT_PARTS,
    add_ground_force,
    ground_contact,
    pack_contact,
    unpack_contact,
)
from mirdrake.plant.wheels.joint_step import JOINT_PARTS, joint_steps, servo_effort
from mirdrake.plant.wheels.motion import base_motion
from mirdrake.plant.wheels.step import (
    STEP_PARTS,
    SpinningWheel,
    limited_effort,
    pivoting,
    rolling_moment,
    slip_forces,
)
from mirdrake.plant.wheels.tyre_nodes import NODE_PARTS, TyreNodes, find_tyre
from mirdrake.tyres.relaxation import Contact, Motion
from mirdrake.tyres.vertical import VerticalTyre, vertical_force


class GroundWheel(NamedTuple):
    """Wheel whose tyre touches the ground.

    Attributes:
        wheel: the wheel with its slip and spin.
        vertical: its vertical stiffness and damping.
    """

    wheel: SpinningWheel
    vertical: VerticalTyre


def ground_step(
    law: Callable[[Any, float, float, float], tuple[float, float, float]],
    x: Sequence[float],
    terrain: TerrainData,
    samples: int,
    contacts: Any,
    again: bool,
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
    loads: MutableSequence[float],
    desired: Sequence[float],
    joints: Records,
    joint_memories: Records,
    joints_after: Records,
    actuation: MutableSequence[float],
) -> bool:
    """Compute the forces of the ground on the tyres of a vehicle, and the memory of the wheels.

    Args:
        law: forces in steady state, of :class:`mirdrake.tyres.SteadyLaw`.
        x: state of the plant, positions and velocities.
        terrain: the ground.
        samples: number of samples along a wheel; zero on a plane.
        contacts: :class:`GroundContact` of each wheel as rows of numbers, overwritten; see :func:`pack_contact`.
        again: whether `contacts` are those of this step already, from a call without valid curves.
        torques: drive torque of each wheel, signed, then the largest torque of each brake [N m].
        efforts: torques of the actuators of the vehicle, which the plant applies [N m].
        frictions: friction of the ground under each wheel, relative to dry asphalt [1].
        cars: one :class:`mirdrake.plant.wheels.step.SpinningCar`.
        wheels: :class:`GroundWheel`.
        curves: the tyres at their loads, contact and curve, overwritten.
        nodes: their nodes.
        memories: :class:`mirdrake.plant.wheels.step.Memory` of the step before.
        force: generalised forces of the plant (num_velocities) [N, N m], overwritten.
        after: memories for the next step, overwritten.
        logged: Fx, Fy, Mz, kappa and alpha of each wheel, overwritten.
        resistances: torque of the rolling resistance of each wheel [N m], overwritten.
        loads: load of each wheel [N], overwritten.
        desired: set-points of the servos of the actuators, positions, then velocities.
        joints: :class:`mirdrake.plant.wheels.joint_step.StiffJoint`, the wheels first; none if the plant solves them.
        joint_memories: their memories of the step before; those of the wheels are not used.
        joints_after: their memories for the next step, overwritten.
        actuation: torques of the actuators with their servos [N m], overwritten.

    Returns:
        Whether all nodes of the curves are known; if not, the results are not valid.
    """
    car, known = cars[0], True
    period = car.period
    for i in range(len(force)):
        force[i] = 0.0
    base = base_motion(x, wheels[0].wheel.place.base, car.positions, period)
    gyros: Any = np.zeros(len(wheels))
    for i in range(len(wheels)):
        tyre, before, kept, curve = wheels[i], memories[i], after[i], curves[i]
        wheel = tyre.wheel
        if not again:  # the ground is sampled once a step
            pack_contact(
                contacts[i],
                ground_contact(x, wheel.place, wheel.radius, wheel.width, base, car.positions, terrain, samples),
            )

        # The contact goes through plain numbers, so that the repeated call of this step has the same one.
        contact = unpack_contact(contacts[i])
        # The carrier bears -ω × H of the spinning wheel; about the steering axis the steering rate has no part in it.
        (wx, wy, wz), (ax, ay, az), (ux, uy, uz) = base.turning, contact.axle, contact.up
        gyros[i] = -contact.spin * ((wy * az - wz * ay) * ux + (wz * ax - wx * az) * uy + (wx * ay - wy * ax) * uz)
        # Velocities are those of the middle of the last step, half a step before the positions. The vertical one, which
        # changes quickly, is extrapolated to them; else the damping of the tyre would depend on the step.
        rate = contact.rate
        if before.begun > 0.0:
            rate -= 0.5 * contact.normal[2] * (contact.rise - before.rise)
        load = contact.share * vertical_force(tyre.vertical, contact.deflection, contact.share * rate, contact.spin)

        # The curve at this load; if a node is missing, the caller makes it and repeats. The curve of a Coulomb tyre is
        # valid for every load.
        curve_load = wheel.static_load if wheel.coulomb else min(max(load, nodes.lowest), nodes.highest)
        if not find_tyre(nodes, i, curve_load, 0.0 if wheel.coulomb else contact.inclination, frictions[i]):
            # The other wheels are still checked, so that the caller makes all missing nodes before it repeats.
            known = False
            continue
        scale = load / curve_load if load > nodes.lowest else 0.0
        now = Motion(contact.vx, contact.vx - contact.spin * contact.rolling, contact.vy)
        patch = Contact(
            curve.contact.stiffness_x * scale,
            curve.contact.stiffness_y * scale,
            curve.contact.length_x,
            curve.contact.length_y,
            curve.contact.friction_x * scale,
            curve.contact.friction_y * scale,
            curve.contact.overturning * scale,
            curve.contact.overturning_by_fy,
        )

        # Rolling resistance, slip forces, pivoting moment.
        resistance = rolling_moment(wheel, load, contact.rolling, contact.spin)
        # The actuator's effort is part of the spin balance, but the plant applies it itself: it is subtracted below.
        effort, gain, damping, rest = limited_effort(wheel, efforts), 0.0, wheel.damping, 0.0
        if len(joints) > 0:
            if before.begun > 0.0:
                rest = wheel.inertia * (contact.spin - before.spin) / period - before.torque
            # Whether the servo is saturated follows from the road force of the last step.
            mobile = wheel.inertia / period + joints[i].damping
            others = rest + resistance - contact.rolling * before.fx
            effort, gain = servo_effort(joints[i], x, car.positions, efforts, desired, period, others, mobile)
            damping = joints[i].damping + gain
        drive, brake = torques[i] + effort, torques[len(wheels) + i]
        fx, fy, mz, kappa, tan_alpha, torque = slip_forces(
            law,
            curve.curve,
            scale,
            patch,
            wheel,
            before,
            kept,
            now,
            contact.spin,
            contact.rolling,
            drive,
            brake,
            resistance,
            damping,
            period,
        )

        twist, moment = pivoting(wheel, load, before.twist, contact.turn, now.vx, patch, period)
        add_ground_force(
            force,
            wheel.place,
            contact,
            (fx, fy, load),
            mz + moment,
            resistance,
            torque - drive,
            patch.overturning + patch.overturning_by_fy * fy,
        )
        force[wheel.place.spin] += torque - effort
        if len(joints) > 0:
            # Servo and bearing at the end of the step; the plant has the bearing of its beginning.
            change = (rest + torque + resistance - contact.rolling * fx) / (wheel.inertia / period + damping)
            limit = joints[i].effort_limit
            motor = max(-limit, min(limit, effort - gain * change))
            actuation[joints[i].actuator] = motor
            force[wheel.place.spin] -= joints[i].damping * change
            kept.torque += motor - effort - joints[i].damping * change

        kept.begun, kept.twist, kept.rise = 1.0, twist, contact.rise
        logged[i, 0], logged[i, 1], logged[i, 2], logged[i, 3], logged[i, 4] = (
            fx,
            fy,
            mz + moment,
            kappa,
            atan(tan_alpha),
        )
        resistances[i], loads[i] = resistance, load
    joint_steps(
        x,
        car.positions,
        period,
        joints,
        len(wheels),
        joint_memories,
        efforts,
        desired,
        force,
        joints_after,
        actuation,
        gyros,
    )
    return known


GROUND_STEP_PARTS = (*STEP_PARTS, *NODE_PARTS, *JOINT_PARTS, *GROUND_PARTS, *CONTACT_PARTS, vertical_force)
"""Functions that :func:`ground_step` calls, without the law."""
