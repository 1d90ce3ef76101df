"""Compiled loop over cars and control periods: control unit, delay, single-track model."""

import math
from typing import Any, NamedTuple

import numpy as np

from mirdrake.batched.arrays import Floats, Integers, Mask
from mirdrake.batched.ground import apply_ground
from mirdrake.batched.kernels import KERNEL_PARTS, steps_of_car, write_motion, write_state
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
from mirdrake.controllers.path_law import (
    PATH_PARTS,
    PathNumbers,
    Place,
    TrackerNumbers,
    nearest_point,
    project,
    tracker_step,
)
from mirdrake.controllers.path_law import Motion as PathMotion
from mirdrake.controllers.path_tracking import PathGains
from mirdrake.core.compiled import Records
from mirdrake.core.maths import wrap_angle
from mirdrake.core.pid import PidNumbers, tracking_time
from mirdrake.single_track.dynamics import Inputs, LateralForce, State, equations, read_state
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
    present_gains: Any,
    own_pid: Any,
    present_pid: Any,
    schedule: Floats,
    joint_gains: Any,
    paths: Any,
    table: Floats,
    lines: Floats,
    which_line: Integers,
    trackers: Any,
    path_gains: Any,
    tracker_every: int,
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
    diverged: Mask,
    memory: Floats,
    delayed: Floats,
    delays: Integers,
    tracked: Floats,
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
        present_gains: gains at the present speed, as `wheel_gains`.
        own_pid: `wheel_gains` of vehicles with a schedule.
        present_pid: `present_gains` of vehicles with a schedule, overwritten.
        schedule: gains over speed (speeds, 4): speed [m/s], kp, ki, kd, not a number for gains that are not scheduled;
            without rows there is none.
        joint_gains: one record of the steering joints' numbers, which are not used.
        paths: one record of the numbers of the centre line.
        table: centre line; without rows the cars follow the commands.
        lines: drivable lines (lines, points, 4), see :mod:`mirdrake.controllers.path_law`.
        which_line: index of the line of each car (n).
        trackers: one record of the numbers of the path tracker.
        path_gains: gains of the path tracker, a record per car.
        tracker_every: control periods between two steps of the path tracker.
        commands: speed [m/s], steering [rad] and stamp [s] (1 or n, periods, 3).
        noise: standard deviation of the measured speed (n) [m/s].
        seed: seed of the noise.
        begin: number of control periods since the start.
        every: control periods between two rows of the outputs.
        step: step of the integration [s].
        steps: steps in a control period.
        columns: columns of the full row (states, motion, status, path error, commands) that the outputs have.
        first: first car.
        last: car after the last one.
        states: states (n, states), updated.
        diverged: flags of the diverged cars (n), updated.
        memory: memory of each unit (n, memory), updated.
        delayed: outputs of each unit that do not act yet (n, longest delay + 1, 5), a ring, updated; the present ones
            are at the place of the last control instant.
        delays: delay of each car in control periods (n).
        tracked: command (3) of the path tracker, path error (4), whether it has started, and its filtered side slip
            (n, 9), updated.
        outputs: rows (n, rows, columns), overwritten; not a number from the row on in which a car diverged.
    """
    unit, periods = units[0], commands.shape[1]
    states_of_variant = states.shape[1]
    # A full row: states, motion (7), status (3), path error (4), commands (2); `columns` selects from it.
    row: Any = np.empty(states_of_variant + 7 + 3 + 4 + 2)
    follows, scheduled = table.shape[0] > 0, schedule.shape[0] > 0
    # Buffers are allocated once for all cars, as an allocation in the inner loop would dominate its cost.
    x_measured: Any = np.zeros(MEASURED)
    desired: Any = np.zeros(2 * ACTUATORS)
    torques: Any = np.zeros(ACTUATORS)
    # Identity quaternion: the unit rotates the velocity into the vehicle frame, where it is given already.
    x_measured[0] = 1.0
    last_output = STEERING_ACTUATOR + setups[0].actuator_size - 1
    for i in range(first, last):
        x = read_state(states[i], positions)
        # The views are taken once per car; `status` is written by the unit directly into its place in the row.
        which, ring = min(i, commands.shape[0] - 1), delays[i] + 1
        status, gains = row[states_of_variant + 7 :], wheel_gains[i : i + 1]
        for k in range(periods):
            now, period = begin + k, unit.period
            if follows and tracked[i, 7] == 0.0 and not diverged[i]:  # the first command is there from the start
                track(
                    paths[0], table, lines[which_line[i]], path_gains[i], trackers[0], x, parameters[i].rear_length,
                    now * period, tracked[i],
                )  # fmt: skip
                # Still counts as not started: the tracker's own first step, below, begins anew.
                tracked[i, 7] = 0.0
            # Control unit: its measured speed, its step, and the angle and rate of the steering actuator.
            speed = x.vx
            # The counter is the period since the start, so that several calls of run give the noise of one.
            if noise[i] > 0.0:
                speed += noise[i] * normal(seed, np.uint64(i), np.uint64(now), np.uint64(0))
            rate = speed / unit.radius
            x_measured[4] = speed
            if scheduled:
                read_schedule(schedule, abs(speed), own_pid[i], present_pid[i])
                gains = present_gains[i : i + 1]
            command = tracked[i] if follows else commands[which, k]
            speed_command, steering_command = command[0], command[1]
            # All wheels roll at the speed of the car: the single-track model has no wheel speeds of its own.
            for wheel in range(7, 11):
                x_measured[wheel] = rate
            torques[:] = 0.0
            before = _true_angle(steering_law, setups[0].steering, true_steering[0], memory[i, last_output])
            _, trimmed = control_step(
                steering_law, wheel_law, feedforward_only, x_measured, command, now * period, setups,
                speed_gains[i : i + 1], gains, joint_gains, memory[i], desired, torques, status,
            )  # fmt: skip
            angle = _true_angle(steering_law, setups[0].steering, true_steering[0], memory[i, last_output])

            # Delay: a ring with a place for each control period. The oldest output acts.
            slot, acting = now % ring, (now + 1) % ring
            delayed[i, slot, 0], delayed[i, slot, 1] = angle, torques[0] * unit.force_per_torque
            # Brake force 0: with servos the speed set-point brakes. The rate is the mean over the last period.
            delayed[i, slot, 2], delayed[i, slot, 3] = 0.0, (angle - before) / period
            delayed[i, slot, 4] = trimmed * unit.true_over_believed
            u = Inputs(
                delayed[i, acting, 0], delayed[i, acting, 1], delayed[i, acting, 2], delayed[i, acting, 3],
                delayed[i, acting, 4],
            )  # fmt: skip

            # Path tracker: its new command acts at the next control instant.
            if follows and now % tracker_every == 0 and not diverged[i]:
                track(
                    paths[0], table, lines[which_line[i]], path_gains[i], trackers[0], x, parameters[i].rear_length,
                    now * period, tracked[i],
                )  # fmt: skip

            # Outputs at the control instant.
            if k % every == 0:
                if diverged[i]:
                    outputs[i, k // every, :] = np.nan
                else:
                    write_state(row, positions, x)
                    apply_ground(frame, grid, parameters[i], present[i], x.x, x.y)
                    write_motion(row, states_of_variant, equations(law, flags[0], present[i], x, u)[1])
                    row[states_of_variant + 10 : states_of_variant + 14] = tracked[i, 3:7]
                    row[states_of_variant + 14], row[states_of_variant + 15] = speed_command, steering_command
                    for j in range(len(columns)):
                        outputs[i, k // every, j] = row[columns[j]]
            if diverged[i]:
                continue

            # The model until the next control instant.
            alive, x = steps_of_car(law, flags[0], frame, grid, parameters[i], present[i], x, u, step, steps)
            diverged[i] = not alive
        write_state(states[i], positions, x)


def _true_angle(law: SteeringLaw, believed: SteeringNumbers, true: SteeringNumbers, steering: float) -> float:
    """Return the true bicycle angle [rad] of the wheels for the output of the steering actuator."""
    angles = law(believed, steering)[0]
    return bicycle_angle(true, angles[0], angles[1])


def track(
    path: PathNumbers,
    table: Floats,
    line: Floats,
    gains: PathGains,
    tracker: TrackerNumbers,
    x: State,
    rear_length: float,
    time: float,
    tracked: Any,
) -> None:
    """Advance the path tracker of a car by a step, as :class:`mirdrake.controllers.path_tracking.PathTracker`.

    Args:
        path: numbers of the centre line.
        table: its table.
        line: drivable line of the car.
        gains: gains of the path tracker.
        tracker: numbers of the path tracker.
        x: states.
        rear_length: from the centre of mass to the rear axle [m].
        time: present time [s].
        tracked: command, path error, whether it has started, and the filtered side slip; updated.
    """
    # Newton's projection from the last place is cheap; the search over all points is for the start and for lost cars.
    started = tracked[7] != 0.0
    settled, place = False, Place(tracked[5], 0.0, 0.0, 0.0)
    if started:
        settled, place = project(path, table, x.x, x.y, tracked[5])
    if not settled:
        _, place = project(path, table, x.x, x.y, nearest_point(path, table, x.x, x.y))
    motion = PathMotion(x.x, x.y, wrap_angle(x.yaw), x.vx, x.vy - rear_length * x.yaw_rate, x.yaw_rate)
    speed, steering, tracked[8] = tracker_step(
        path, table, line, gains, tracker, place, motion, tracked[0], tracked[8], started
    )
    # The arc length of a closed track jumps at the start line: the shorter way round is the distance covered.
    covered = place.s - tracked[5] if started else 0.0
    if path.closed:
        covered -= path.length * math.floor(covered / path.length + 0.5)
    tracked[0], tracked[1], tracked[2] = speed, steering, time
    tracked[3], tracked[4], tracked[5] = place.lateral, wrap_angle(motion.yaw - place.yaw), place.s
    tracked[6], tracked[7] = tracked[6] + covered / path.length, 1.0


def read_schedule(schedule: Floats, speed: float, own: PidNumbers, present: Any) -> None:
    """Write the gains at a speed, as :meth:`mirdrake.vehicles.joint_control.gain_schedule.GainTable.at`.

    Args:
        schedule: see :func:`drive`.
        speed: [m/s]
        own: gains of the car.
        present: overwritten.
    """
    # Number of speeds up to the present one; schedules have few rows, so a linear search is enough.
    after, last = 0, schedule.shape[0]
    while after < last and schedule[after, 0] <= speed:
        after += 1
    present.kp, present.ki, present.kd = own.kp, own.ki, own.kd
    # Only NaN differs from itself: such a gain is not scheduled and stays that of the car.
    if schedule[0, 1] == schedule[0, 1]:
        present.kp = scheduled_gain(schedule, after, speed, 1)
    if schedule[0, 2] == schedule[0, 2]:
        present.ki = scheduled_gain(schedule, after, speed, 2)
    if schedule[0, 3] == schedule[0, 3]:
        present.kd = scheduled_gain(schedule, after, speed, 3)
    # The tracking time of the anti-windup follows from the gains, so it changes with them.
    present.anti_windup_time = tracking_time(present.kp, present.ki, present.kd)


def scheduled_gain(schedule: Floats, after: int, speed: float, column: int) -> float:
    """Return a gain at a speed; `after` is the number of speeds in the schedule up to it."""
    # Gains are held beyond the ends of the schedule; extrapolated ones could become negative.
    if after in (0, schedule.shape[0]):
        end_gain: float = schedule[max(after - 1, 0), column]
        return end_gain
    low, high = schedule[after - 1, 0], schedule[after, 0]
    value: float = schedule[after - 1, column]
    value += (speed - low) / (high - low) * (schedule[after, column] - value)
    return value


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
    *PATH_PARTS,
    track,
    read_schedule,
    scheduled_gain,
    tracking_time,
)
"""Functions that :func:`drive` calls."""
