"""Compiled loop over cars and their discrete events: control unit, delay, powertrain, driver, single-track model.

Time is divided into ticks. Control unit, powertrain, driver and outputs are due every so many of them, as the periodic
events of Drake: all that are due at a tick read the state and the outputs from before it.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from mirdrake.batched.arrays import Floats, Integers
from mirdrake.batched.kernels import KERNEL_PARTS, Fleet, motion_of_car, steps_of_car, write_motion, write_state
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
from mirdrake.core.pid import PidNumbers, tracking_time
from mirdrake.plant.powertrain.law import POWERTRAIN_PARTS, PowertrainNumbers, throttle_limits
from mirdrake.single_track.dynamics import Inputs, LateralForce, State, read_state
from mirdrake.single_track.powertrain import road_forces
from mirdrake.vehicles.joint_control.base import JointLaw, feedforward_only
from mirdrake.vehicles.joint_control.pedals import PEDAL_PARTS, PedalNumbers, pedal_step

ACTUATORS = 6
"""Actuators of the control unit of a single-track model: four wheels and two steering joints."""

MEASURED = 13
"""Length of the state that the control unit reads."""

OUTPUTS = 5
"""Outputs of a control unit: steering angle and its rate, then drive force, brake force and set-point of the wheel
servos, or throttle, brake and gear."""

COMMAND, PATH, STARTED, OWN, PEDALS, PRESSES = 0, 3, 7, 8, 12, 15
"""Indices in the memory of a driver: command (3), path error (4), whether it has started, numbers of its own (4),
positions of its pedals (3), whether it presses them."""

DRIVER_MEMORY = 16
"""Length of the memory of a driver."""

DriverLaw = Callable[[Any, int, State, float, float, Any], None]
"""(numbers of all drivers, car, its states, distance of its rear axle from the centre of mass [m], time [s], memory of
the driver, updated)."""


class UnitNumbers(NamedTuple):
    """Numbers between a control unit and the single-track model.

    Attributes:
        radius: true radius of the wheels [m].
        true_over_assumed: true radius of the wheels over the assumed one [1].
        force_per_torque: drive force over the torque of a wheel [1/m].
        period: control period [s].
    """

    radius: float
    true_over_assumed: float
    force_per_torque: float
    period: float


class Units(NamedTuple):
    """Control units and powertrains of all cars.

    Attributes:
        units: one record of :class:`UnitNumbers`.
        setups: one record of the control unit's constants.
        true_steering: one record of the numbers of the true steering geometry.
        speed_gains: gains of the speed loop, a record per car.
        wheel_gains: gains of the wheel loops or of the pedals, a record per car.
        present_gains: gains at the present speed, as `wheel_gains`.
        own_pid: `wheel_gains` of vehicles with a schedule.
        present_pid: `present_gains` of vehicles with a schedule, overwritten.
        pedal_gains: `present_gains` of vehicles with pedals.
        schedule: gains over speed (speeds, 4): speed [m/s], kp, ki, kd, not a number for gains that are not scheduled;
            without rows there is none.
        joint_gains: one record of the steering joints' numbers, which are not used.
        pedals: numbers of the pedals' law.
        pedal_memory: its start in the memory of a unit.
        powertrain: numbers of the powertrain.
        radii: radii of the wheels [m].
    """

    units: Records
    setups: Any
    true_steering: Records
    speed_gains: Any
    wheel_gains: Any
    present_gains: Any
    own_pid: Any
    present_pid: Any
    pedal_gains: Any
    schedule: Floats
    joint_gains: Any
    pedals: PedalNumbers
    pedal_memory: int
    powertrain: PowertrainNumbers
    radii: tuple[float, float, float, float]


class Clock(NamedTuple):
    """Events of a run.

    Attributes:
        begin: number of ticks since the start.
        ticks: ticks of the run; the control unit is due at the first one.
        control: ticks between two steps of the control unit.
        powertrain: ticks between two steps of the powertrain.
        driver: ticks between two steps of the driver; 0: the cars follow commands.
        output: ticks between two rows of the outputs.
        driver_period: time between two steps of the driver [s].
        steps: steps of the integration in a tick.
        step: step of the integration [s].
    """

    begin: int
    ticks: int
    control: int
    powertrain: int
    driver: int
    output: int
    driver_period: float
    steps: int
    step: float


class Memories(NamedTuple):
    """Memories of all cars, updated.

    Attributes:
        unit: memory of each unit (n, memory).
        delayed: outputs of each unit that do not act yet (n, longest delay + 1, :data:`OUTPUTS`), a ring.
        delays: delay of each car in control periods (n).
        driver: memory of each driver (n, :data:`DRIVER_MEMORY`).
        powertrain: memory of each powertrain (n, memory).
        forces: drive force [N], brake force [N] and speed [m/s] at the last step of the powertrain (n, 3).
    """

    unit: Floats
    delayed: Floats
    delays: Integers
    driver: Floats
    powertrain: Floats
    forces: Floats


def drive(
    law: LateralForce,
    steering_law: SteeringLaw,
    wheel_law: JointLaw,
    driver_law: DriverLaw,
    cars: Fleet,
    units: Units,
    drivers: Any,
    commands: Floats,
    noise: Floats,
    seed: np.uint64,
    clock: Clock,
    columns: Integers,
    memories: Memories,
    outputs: Floats,
    first: int,
    last: int,
) -> None:
    """Advance cars with their control units, powertrains and drivers.

    Args:
        law: lateral force of an axle.
        steering_law: angles of the wheels for a steering angle.
        wheel_law: torque of a wheel.
        driver_law: step of a driver.
        cars: all cars.
        units: control units and powertrains.
        drivers: numbers of the drivers.
        commands: speed [m/s], steering [rad] and stamp [s] (1 or n, control periods, 3); not read with drivers.
        noise: standard deviation of the measured speed (n) [m/s].
        seed: seed of the noise.
        clock: events of the run.
        columns: columns of the full row (states, motion, status, path error, commands, forces) that the outputs have.
        memories: memories of the cars, updated.
        outputs: rows (n, rows, columns), overwritten; not a number from the row on in which a car diverged.
        first: first car.
        last: car after the last one.
    """
    unit, setups = units.units[0], units.setups
    states_of_variant = cars.states.shape[1]
    # A full row: states, motion (7), status (3), path error (4), commands (2), forces (2); `columns` selects from it.
    at_motion, at_status = states_of_variant, states_of_variant + 7
    row: Any = np.empty(states_of_variant + 7 + 3 + 4 + 2 + 2)
    scheduled, pedals = units.schedule.shape[0] > 0, setups[0].pedals
    # The motion costs another evaluation of the equations.
    shows_motion = False
    for column in columns:
        shows_motion = shows_motion or at_motion <= column < at_status
    # Buffers are allocated once for all cars, as an allocation in the inner loop would dominate its cost.
    x_measured: Any = np.zeros(MEASURED)
    desired: Any = np.zeros(2 * ACTUATORS)
    torques: Any = np.zeros(ACTUATORS)
    # Identity quaternion: the unit rotates the velocity into the vehicle frame, where it is given already.
    x_measured[0] = 1.0
    last_output = STEERING_ACTUATOR + setups[0].actuator_size - 1
    for i in range(first, last):
        x, u = read_state(cars.states[i], cars.positions), Inputs(0.0, 0.0, 0.0, 0.0, 0.0)
        # The views are taken once per car; `status` is written by the unit directly into its place in the row.
        which, ring = min(i, commands.shape[0] - 1), memories.delays[i] + 1
        status, gains = row[at_status:], units.wheel_gains[i : i + 1]
        memory, delayed, driver = memories.unit[i], memories.delayed[i], memories.driver[i]
        forces, rear_length = memories.forces[i], cars.parameters[i].rear_length
        # The first command is there from the start.
        if clock.driver > 0 and driver[STARTED] == 0.0 and not cars.diverged[i]:
            driver_law(drivers, i, x, rear_length, clock.begin // clock.driver * clock.driver_period, driver)
            # Still counts as not started: the driver's own first step, below, begins anew.
            driver[STARTED] = 0.0
        for j in range(clock.ticks):
            tick, row_is_due = clock.begin + j, j % clock.output == 0
            if cars.diverged[i]:
                if row_is_due:
                    outputs[i, j // clock.output, :] = np.nan
                continue
            # Number of the present or next control instant; the outputs that act until then are at its place.
            now = (tick + clock.control - 1) // clock.control
            slot = now % ring

            # Powertrain: forces for the pedals of the driver, or those of the control unit.
            if pedals and tick % clock.powertrain == 0:
                throttle, brake, gear = delayed[slot, 2], delayed[slot, 3], delayed[slot, 4]
                if driver[PRESSES] != 0.0:
                    throttle, brake, gear = driver[PEDALS], driver[PEDALS + 1], driver[PEDALS + 2]
                forces[0], forces[1] = road_forces(
                    units.powertrain, units.radii, memories.powertrain[i], throttle, brake, gear, x.vx
                )
                forces[2] = x.vx

            # Control unit: its measured speed, its step, and the angle and rate of the steering actuator.
            acting = slot
            if tick % clock.control == 0:
                speed = x.vx
                # The counter is the period since the start, so that several calls of run give the noise of one.
                if noise[i] > 0.0:
                    speed += noise[i] * normal(seed, np.uint64(i), np.uint64(now), np.uint64(0))
                rate = speed / unit.radius
                x_measured[4] = speed
                if scheduled:
                    read_schedule(units.schedule, abs(speed), units.own_pid[i], units.present_pid[i], pedals)
                    gains = units.present_gains[i : i + 1]
                command = driver if clock.driver > 0 else commands[which, j // clock.control]
                row[at_status + 7], row[at_status + 8] = command[0], command[1]
                # All wheels roll at the speed of the car: the single-track model has no wheel speeds of its own.
                for wheel in range(7, 11):
                    x_measured[wheel] = rate
                torques[:] = 0.0
                before = _true_angle(steering_law, setups[0].steering, units.true_steering[0], memory[last_output])
                slope, trimmed = control_step(
                    steering_law, wheel_law, feedforward_only, x_measured, command, now * unit.period, setups,
                    units.speed_gains[i : i + 1], gains, units.joint_gains, memory, desired, torques, status,
                )  # fmt: skip
                angle = _true_angle(steering_law, setups[0].steering, units.true_steering[0], memory[last_output])

                # Delay: a ring with a place for each control period. The oldest output acts.
                acting = (now + 1) % ring
                # The rate is the mean over the last period.
                delayed[slot, 0], delayed[slot, 1] = angle, (angle - before) / unit.period
                if pedals:
                    pressed = pedal_step(
                        throttle_limits, units.pedals, units.powertrain, memory, units.pedal_memory,
                        status[0], slope, speed, units.pedal_gains[i],
                    )  # fmt: skip
                    delayed[slot, 2], delayed[slot, 3], delayed[slot, 4] = pressed.throttle, pressed.brake, pressed.gear
                else:
                    # Brake force 0: with servos the speed set-point brakes.
                    delayed[slot, 2], delayed[slot, 3] = torques[0] * unit.force_per_torque, 0.0
                    delayed[slot, 4] = trimmed * unit.true_over_assumed

            # Inputs of the model until the next event.
            if pedals:
                u = Inputs(delayed[acting, 0], forces[0], forces[1], delayed[acting, 1], forces[2])
            else:
                u = Inputs(
                    delayed[acting, 0], delayed[acting, 2], delayed[acting, 3], delayed[acting, 1], delayed[acting, 4]
                )

            # Driver: its new command acts at the next control instant.
            if clock.driver > 0 and tick % clock.driver == 0:
                driver_law(drivers, i, x, rear_length, tick // clock.driver * clock.driver_period, driver)

            # Outputs at the tick.
            if row_is_due:
                write_state(row, cars.positions, x)
                if shows_motion:
                    write_motion(row, at_motion, motion_of_car(law, cars, i, x, u))
                row[at_status + 3 : at_status + 7] = driver[PATH : PATH + 4]
                row[at_status + 9], row[at_status + 10] = u.drive, u.brake
                for k in range(len(columns)):
                    outputs[i, j // clock.output, k] = row[columns[k]]

            # The model until the next tick.
            alive, x = steps_of_car(law, cars, i, x, u, clock.step, clock.steps)
            cars.diverged[i] = not alive
        write_state(cars.states[i], cars.positions, x)


def _true_angle(law: SteeringLaw, assumed: SteeringNumbers, true: SteeringNumbers, steering: float) -> float:
    """Return the true bicycle angle [rad] of the wheels for the output of the steering actuator."""
    angles = law(assumed, steering)[0]
    return bicycle_angle(true, angles[0], angles[1])


def no_driver(drivers: Any, i: int, x: State, rear_length: float, time: float, memory: Any) -> None:
    """Do nothing: the cars follow commands."""


def read_schedule(schedule: Floats, speed: float, own: PidNumbers, present: Any, pedals: bool) -> None:
    """Write the gains at a speed, as :meth:`mirdrake.vehicles.joint_control.gain_schedule.GainTable.at`.

    Args:
        schedule: see :class:`Units`.
        speed: [m/s]
        own: gains of the car.
        present: overwritten.
        pedals: whether they are gains of pedals, whose anti-windup has a fixed time.
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
    if not pedals:
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
    *PEDAL_PARTS,
    *POWERTRAIN_PARTS,
    road_forces,
    _true_angle,
    no_driver,
    read_schedule,
    scheduled_gain,
    tracking_time,
)
"""Functions that :func:`drive` calls."""
