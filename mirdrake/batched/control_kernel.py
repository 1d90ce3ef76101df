"""Compiled loop over cars and control periods: control unit, delay, single-track model."""

from typing import Any, NamedTuple

import numpy as np

from mirdrake.batched.arrays import Floats, Integers, Mask
from mirdrake.batched.ground import apply_ground
from mirdrake.batched.kernels import KERNEL_PARTS, is_finite, read_state, runge_kutta, write_motion, write_state
from mirdrake.batched.noise import NOISE_PARTS, normal
from mirdrake.controllers.ackermann import (
    SteeringLaw,
    SteeringNumbers,
    WheelAngles,
    WheelRatios,
    bicycle_angle,
    unior_angles,
    wheel_angles,
)
from mirdrake.controllers.control_step import CONTROL_PARTS, STEERING_ACTUATOR, control_step
from mirdrake.core.compiled import Records
from mirdrake.single_track.dynamics import Inputs, LateralForce, equations
from mirdrake.vehicles.joint_control.base import JointLaw, feedforward_only

ACTUATORS = 6
"""Actuators of the control unit of a single-track model: four wheels and two steering joints."""

MEASURED = 13
"""Length of the state that the control unit reads."""


class UnitNumbers(NamedTuple):
    """Numbers between a control unit and the single-track model.

    Attributes:
        radius: true radius of the wheels [m].
        true_over_believed: true radius of the wheels over the believed one [1].
        force_per_torque: drive force over the torque of a wheel [1/m].
        period: control period [s].
    """

    radius: float
    true_over_believed: float
    force_per_torque: float
    period: float


def drive(
    law: LateralForce,
    steering_law: SteeringLaw,
    wheel_law: JointLaw,
    flags: Records,
    positions: Integers,
    parameters: Records,
    present: Records,
    frame: Floats,
    grid: Floats,
    units: Records,
    setups: Any,
    true_steering: Records,
    speed_gains: Any,
    wheel_gains: Any,
    joint_gains: Any,
    commands: Floats,
    noise: Floats,
    seed: np.uint64,
    begin: int,
    every: int,
    step: float,
    steps: int,
    columns: Integers,
    first: int,
    last: int,
    states: Floats,
    dead: Mask,
    memory: Floats,
    delayed: Floats,
    delays: Integers,
    outputs: Floats,
) -> None:
    """Advance cars with their control units over the control periods of the commands.

    The order is that of Drake: at a control instant the unit reads the present state; its result acts, after the delay,
    until the next instant.

    Args:
        law: lateral force of an axle.
        steering_law: angles of the wheels for a steering angle.
        wheel_law: torque of a wheel.
        flags: one record of the variant's flags.
        positions: column in `states` of each field of the state.
        parameters: a record per car.
        present: parameters at the place of each car, overwritten; `parameters` itself without a ground.
        frame: see :class:`mirdrake.batched.ground.Ground`.
        grid: see there.
        units: one record of :class:`UnitNumbers`.
        setups: one record of the control unit's constants.
        true_steering: one record of the numbers of the true steering geometry.
        speed_gains: gains of the speed loop, a record per car.
        wheel_gains: gains of the wheel loops, a record per car.
        joint_gains: one record of the steering joints' numbers, which are not used.
        commands: speed [m/s], steering [rad] and stamp [s] (1 or n, periods, 3).
        noise: standard deviation of the measured speed (n) [m/s].
        seed: seed of the noise.
        begin: number of control periods since the start.
        every: control periods between two rows of the outputs.
        step: step of the integration [s].
        steps: steps in a control period.
        columns: columns of the full row (states, motion, status) that the outputs have.
        first: first car.
        last: car after the last one.
        states: states (n, states), updated.
        dead: flags of the diverged cars (n), updated.
        memory: memory of each unit (n, memory), updated.
        delayed: outputs of each unit that do not act yet (n, longest delay + 1, 5), a ring, updated; the present ones
            are at the place of the last control instant.
        delays: delay of each car in control periods (n).
        outputs: rows (n, rows, columns), overwritten; not a number from the row on in which a car diverged.
    """
    unit, periods = units[0], commands.shape[1]
    states_of_variant = states.shape[1]
    row: Any = np.empty(states_of_variant + 7 + 3)
    x_measured: Any = np.zeros(MEASURED)
    desired: Any = np.zeros(2 * ACTUATORS)
    torques: Any = np.zeros(ACTUATORS)
    x_measured[0] = 1.0
    last_output = STEERING_ACTUATOR + setups[0].actuator_size - 1
    for i in range(first, last):
        x = read_state(states[i], positions)
        which, ring = min(i, commands.shape[0] - 1), delays[i] + 1
        status = row[states_of_variant + 7 :]
        for k in range(periods):
            now, period = begin + k, unit.period
            # Control unit: its measured speed, its step, and the angle and rate of the steering actuator.
            speed = x.vx
            if noise[i] > 0.0:
                speed += noise[i] * normal(seed, np.uint64(i), np.uint64(now), np.uint64(0))
            rate = speed / unit.radius
            x_measured[4] = speed
            for wheel in range(7, 11):
                x_measured[wheel] = rate
            torques[:] = 0.0
            before = _true_angle(steering_law, setups[0].steering, true_steering[0], memory[i, last_output])
            _, trimmed = control_step(
                steering_law, wheel_law, feedforward_only, x_measured, commands[which, k], now * period, setups,
                speed_gains[i : i + 1], wheel_gains[i : i + 1], joint_gains, memory[i], desired, torques, status,
            )  # fmt: skip
            angle = _true_angle(steering_law, setups[0].steering, true_steering[0], memory[i, last_output])

            # Delay: a ring with a place for each control period. The oldest output acts.
            slot, acting = now % ring, (now + 1) % ring
            delayed[i, slot, 0], delayed[i, slot, 1] = angle, torques[0] * unit.force_per_torque
            delayed[i, slot, 2], delayed[i, slot, 3] = 0.0, (angle - before) / period
            delayed[i, slot, 4] = trimmed * unit.true_over_believed
            u = Inputs(
                delayed[i, acting, 0], delayed[i, acting, 1], delayed[i, acting, 2], delayed[i, acting, 3],
                delayed[i, acting, 4],
            )  # fmt: skip

            # Outputs at the control instant.
            if k % every == 0:
                if dead[i]:
                    outputs[i, k // every, :] = np.nan
                else:
                    write_state(row, positions, x)
                    apply_ground(frame, grid, parameters[i], present[i], x.x, x.y)
                    write_motion(row, states_of_variant, equations(law, flags[0], present[i], x, u)[1])
                    for j in range(len(columns)):
                        outputs[i, k // every, j] = row[columns[j]]
            if dead[i]:
                continue

            # The model until the next control instant.
            for _ in range(steps):
                apply_ground(frame, grid, parameters[i], present[i], x.x, x.y)
                after = runge_kutta(law, flags[0], present[i], x, u, step)
                if not is_finite(after):
                    dead[i] = True
                    break
                x = after
        write_state(states[i], positions, x)


def _true_angle(law: SteeringLaw, believed: SteeringNumbers, true: SteeringNumbers, steering: float) -> float:
    """Return the true bicycle angle [rad] of the wheels for the output of the steering actuator."""
    angles = law(believed, steering)[0]
    return bicycle_angle(true, angles[0], angles[1])


def ackermann_rolling(numbers: SteeringNumbers, steering: float) -> tuple[WheelAngles, WheelRatios]:
    """Return the angles of the wheels; they all roll at the speed of the car."""
    return wheel_angles(numbers, steering), (1.0, 1.0, 1.0, 1.0)


def unior_rolling(numbers: SteeringNumbers, steering: float) -> tuple[WheelAngles, WheelRatios]:
    """Return the angles of the wheels for the Unior's linkages; they all roll at the speed of the car."""
    return unior_angles(numbers, steering), (1.0, 1.0, 1.0, 1.0)


DRIVE_PARTS: tuple[Any, ...] = (
    *KERNEL_PARTS,
    *NOISE_PARTS,
    *CONTROL_PARTS,
    control_step,
    feedforward_only,
    _true_angle,
)
"""Functions that :func:`drive` calls."""
