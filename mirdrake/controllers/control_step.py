"""One step of the control unit of a vehicle, for Python and for machine code (:mod:`mirdrake.core.compiled`).

Each law called here is also a system of its own: dead-man (``command``), steering geometry (``ackermann``), speed loop
(``cruise``), joint loops (:mod:`mirdrake.vehicles.joint_control`).
"""

from collections.abc import MutableSequence, Sequence
from typing import Any, NamedTuple

from mirdrake.controllers.ackermann import (
    SteeringLaw,
    SteeringNumbers,
    ackermann_wheels,
    approach,
    bicycle_angle,
    unior_angles,
    unior_wheels,
    wheel_angles,
    wheel_speed_ratios,
)
from mirdrake.controllers.command import CommandLimits, CommandState, command_step
from mirdrake.controllers.cruise import cruise_step, wheel_speed_setpoints
from mirdrake.core.pid import PidLimits, PidNumbers, pid_step, read_pid, write_pid
from mirdrake.plant.powertrain.actuator import ActuatorNumbers, actuator_step, follow
from mirdrake.vehicles.joint_control.base import JointLaw

MESSAGE, LAST, STEERING_ACTUATOR = 0, 3, 5
"""Indices in the memory: last message (3), last set-points of speed and steering (2), steering actuator."""


class ControlSetup(NamedTuple):
    """Constants of a control unit, as plain numbers.

    Attributes:
        period: time between two steps [s].
        acceleration: largest slope of the speed set-point while it rises [m/s²].
        deceleration: largest slope while it falls [m/s²].
        command: limits of the command.
        steering: numbers of the steering law.
        actuator: numbers of the steering actuator.
        actuator_size: length of its memory.
        speed_limits: limits of the trim of the speed loop [m/s].
        wheel_limits: limits of the torque of a wheel [N m].
        steering_limits: limits of the torque of a steering joint [N m].
        radii: radii of the wheels [m].
        torque_per_acceleration: torque of each wheel that accelerates the vehicle [N m s²/m].
        pedals: whether pedals drive and brake in place of the wheels' actuators.
        wheel_servo: whether Drake's servos follow the set-points of the wheels.
        steering_servo: whether Drake's servos follow the set-points of the steering joints.
        open_differential: whether the two wheel servos of an axle share their torque.
        driven: which wheels the unit drives.
        speed_loop: start of the speed loop in the memory.
        wheel_loops: start of each wheel's loop in the memory.
        steering_loops: start of the loops of the left and right steering joint in the memory.
        wheel_inputs: index of each wheel among the actuators.
        steering_inputs: index of each steering joint among the actuators.
        wheel_velocities: index of each wheel's rate in the state of the plant.
        steering_positions: index of each steering joint's angle in the state of the plant.
        quaternion: start of the orientation of the vehicle in the state of the plant.
        velocity: start of the velocity of its origin in the state of the plant.
    """

    period: float
    acceleration: float
    deceleration: float
    command: CommandLimits
    steering: SteeringNumbers
    actuator: ActuatorNumbers
    actuator_size: int
    speed_limits: PidLimits
    wheel_limits: PidLimits
    steering_limits: PidLimits
    radii: tuple[float, float, float, float]
    torque_per_acceleration: tuple[float, float, float, float]
    pedals: bool
    wheel_servo: bool
    steering_servo: bool
    open_differential: bool
    driven: tuple[bool, bool, bool, bool]
    speed_loop: int
    wheel_loops: tuple[int, int, int, int]
    steering_loops: tuple[int, int]
    wheel_inputs: tuple[int, int, int, int]
    steering_inputs: tuple[int, int]
    wheel_velocities: tuple[int, int, int, int]
    steering_positions: tuple[int, int]
    quaternion: int
    velocity: int


def control_step(
    steering_law: SteeringLaw,
    wheel_law: JointLaw,
    joint_law: JointLaw,
    x: Sequence[float],
    command: Sequence[float],
    time: float,
    setups: Sequence[ControlSetup],
    speed_gains: Sequence[PidNumbers],
    wheel_gains: Sequence[Any],
    steering_gains: Sequence[Any],
    memory: MutableSequence[float],
    desired: MutableSequence[float],
    actuation: MutableSequence[float],
    status: MutableSequence[float],
) -> tuple[float, float]:
    """Advance everything but the pedals by one period.

    Sequences of one element stand for that element: a record of Numba is always part of an array.

    Args:
        steering_law: angles of the wheels and ratios of their speeds for a steering angle.
        wheel_law: torque of a wheel.
        joint_law: torque of a steering joint.
        x: state of the plant, positions and velocities.
        command: speed [m/s], steering [rad], stamp [s].
        time: present time [s].
        setups: constants of the unit.
        speed_gains: gains of the speed loop.
        wheel_gains: numbers of the wheels' law.
        steering_gains: numbers of the steering joints' law.
        memory: updated in place.
        desired: angles [rad], then rates [rad/s] for the servos of the actuators; zeros, updated in place.
        actuation: torques of the actuators [N m]; zeros, updated in place.
        status: set-points of speed [m/s] and steering [rad], trim of the speed [m/s]; overwritten.

    Returns:
        Slope of the speed set-point [m/s²] and the trimmed speed [m/s].
    """
    setup = setups[0]
    period, actuators = setup.period, len(actuation)

    # Dead-man: without messages the set-point of the speed is zero.
    message = CommandState(memory[MESSAGE], memory[MESSAGE + 1], memory[MESSAGE + 2])
    message, result = command_step(message, command[0], command[1], command[2], time, setup.command)
    memory[MESSAGE], memory[MESSAGE + 1], memory[MESSAGE + 2] = message.speed, message.steering, message.stamp

    # Set-points: the slope of the speed and the rate of the steering are limited.

    # A vehicle in reverse accelerates while its signed speed falls, so the two limits change places.
    last_speed = memory[LAST]
    up, down = setup.acceleration * period, setup.deceleration * period
    if last_speed < 0.0:
        up, down = down, up
    speed = min(max(result.setpoint.speed, last_speed - down), last_speed + up)
    steering = approach(setup.steering, memory[LAST + 1], result.setpoint.steering, period)
    memory[LAST], memory[LAST + 1] = speed, steering
    slope = (speed - last_speed) / period

    # Steering actuator of vehicle.yaml: delay, lag and rate between the set-point and the joints.

    # The last element of the actuator's memory is its output.
    last_angle = memory[STEERING_ACTUATOR + setup.actuator_size - 1]
    angle = actuator_step(memory, STEERING_ACTUATOR, setup.actuator_size, steering, setup.actuator)
    angles, ratios = steering_law(setup.steering, angle)
    last_angles = angles
    if setup.steering_servo and last_angle != angle:  # the law is a tenth of the step
        last_angles = steering_law(setup.steering, last_angle)[0]

    # Speed loop and wheels, unless pedals drive: the trim corrects the wheel speeds until the vehicle has its speed.
    trimmed = speed
    if not setup.pedals:
        loop, trimmed = cruise_step(
            read_pid(memory, setup.speed_loop),
            speed,
            forward_speed(x, setup.quaternion, setup.velocity),
            period,
            speed_gains[0],
            setup.speed_limits,
        )
        write_pid(memory, setup.speed_loop, loop)
        rates = wheel_speed_setpoints(trimmed, ratios, setup.radii)
        for i in range(4):
            if not setup.driven[i]:
                continue
            actuation[setup.wheel_inputs[i]] = wheel_law(
                memory, setup.wheel_loops[i], rates[i], x[setup.wheel_velocities[i]],
                setup.torque_per_acceleration[i] * slope, wheel_gains[0], period, setup.wheel_limits,
            )  # fmt: skip
            if setup.wheel_servo:
                rate = rates[i]
                if setup.open_differential:
                    # Each servo of Drake controls its own wheel. If its set-point contains the measured difference of
                    # the two wheels, its error is that of the axle's mean speed, and both torques are equal.
                    # The order is front left, front right, rear left, rear right: the lowest bit selects the side.
                    other = i ^ 1
                    difference = x[setup.wheel_velocities[i]] - x[setup.wheel_velocities[other]]
                    rate = 0.5 * (rates[i] + rates[other] + difference)
                desired[actuators + setup.wheel_inputs[i]] = rate

    # Steering joints.
    for i in range(2):
        joint = setup.steering_inputs[i]
        actuation[joint] = joint_law(
            memory, setup.steering_loops[i], angles[i], x[setup.steering_positions[i]],
            0.0, steering_gains[0], period, setup.steering_limits,
        )  # fmt: skip
        if setup.steering_servo:
            desired[joint] = angles[i]
            # The servo damps the error of the rate; without this set-point it would damp the steering itself.
            desired[actuators + joint] = (angles[i] - last_angles[i]) / period
    status[0], status[1], status[2] = speed, steering, trimmed - speed
    return slope, trimmed


def forward_speed(x: Sequence[float], quaternion: int, velocity: int) -> float:
    """Return the speed of a floating frame's origin along its x axis [m/s].

    Args:
        x: state of the plant.
        quaternion: index of the frame's orientation in it.
        velocity: index of the velocity of its origin.
    """
    w, i, j, k = x[quaternion], x[quaternion + 1], x[quaternion + 2], x[quaternion + 3]
    vx, vy, vz = x[velocity], x[velocity + 1], x[velocity + 2]
    half = 0.5 * (w * w + i * i + j * j + k * k)  # Drake lets the quaternion's norm drift from 1
    # First column of the rotation matrix times the velocity in the world.
    return vx * (1.0 - (j * j + k * k) / half) + (vy * (i * j + w * k) + vz * (i * k - w * j)) / half


CONTROL_PARTS = (
    command_step, approach, wheel_angles, wheel_speed_ratios, bicycle_angle, unior_angles, ackermann_wheels,
    unior_wheels, actuator_step, follow, cruise_step, wheel_speed_setpoints, pid_step, read_pid, write_pid,
    forward_speed,
)  # fmt: skip
"""Functions that :func:`control_step` calls besides its laws."""
