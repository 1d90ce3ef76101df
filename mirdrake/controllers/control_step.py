"""One step of the control unit of a vehicle, for Python and for machine code (:mod:`mirdrake.core.compiled`).

The laws are those of this package, each also a system of its own.
"""

from collections.abc import Callable, MutableSequence, Sequence
from typing import NamedTuple

from mirdrake.controllers.ackermann import (
    SteeringNumbers,
    WheelAngles,
    WheelRatios,
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
from mirdrake.controllers.pid import PidLimits, PidNumbers, pid_step, read_pid, write_pid
from mirdrake.plant.powertrain.actuator import ActuatorNumbers, actuator_step, follow

MESSAGE, LAST, LATE = 0, 3, 5
"""Places in the memory: last message (3), last speed and steering set-point (2), the steering on its way."""

SPEED_LOOP, WHEEL_LOOP, STEERING_LOOP = 0, 1, 2
"""Order of the gains."""


class ControlSetup(NamedTuple):
    """What a control unit is, in plain numbers.

    Attributes:
        period: between two steps [s].
        acceleration: largest slope of the speed set-point [m/s²].
        deceleration: the same to lower speeds [m/s²].
        command: limits of commands.
        steering: the steering law.
        actuator: of the steering.
        late: numbers that it remembers.
        speed_limits: of the speed loop's trim [m/s].
        wheel_limits: of the wheels' torques [N m].
        steering_limits: of the steering's torques [N m].
        radii: of the wheels [m].
        push: torque of a wheel per acceleration [N m s²/m].
        pedals: whether pedals drive and brake, and not the wheels' actuators.
        wheel_pid: whether a PID turns the wheels, and not their servos.
        steering_pid: whether PIDs steer, and not the servos.
        open_differential: whether the wheel servos of an axle share their torque.
        turned: which wheels the unit turns.
        speed_loop: place of the speed loop in the memory.
        wheel_loops: places of the wheels' loops.
        steering_loops: places of the steering's loops, left and right.
        wheel_inputs: of the wheels among the actuators.
        steering_inputs: of the steering joints among the actuators.
        wheel_velocities: of the wheels in the plant's state.
        steering_positions: of the steering joints in the plant's state.
        quaternion: of the vehicle in the plant's state.
        velocity: of its origin in the plant's state.
    """

    period: float
    acceleration: float
    deceleration: float
    command: CommandLimits
    steering: SteeringNumbers
    actuator: ActuatorNumbers
    late: int
    speed_limits: PidLimits
    wheel_limits: PidLimits
    steering_limits: PidLimits
    radii: tuple[float, float, float, float]
    push: tuple[float, float, float, float]
    pedals: bool
    wheel_pid: bool
    steering_pid: bool
    open_differential: bool
    turned: tuple[bool, bool, bool, bool]
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
    law: Callable[[SteeringNumbers, float], tuple[WheelAngles, WheelRatios]],
    x: Sequence[float],
    command: Sequence[float],
    time: float,
    setups: Sequence[ControlSetup],
    gains: Sequence[PidNumbers],
    memory: MutableSequence[float],
    desired: MutableSequence[float],
    actuation: MutableSequence[float],
    status: MutableSequence[float],
) -> float:
    """One step of everything but the pedals.

    Args:
        law: of the steering.
        x: state of the plant, positions and velocities.
        command: speed [m/s], steering [rad], stamp [s].
        time: now [s].
        setups: one.
        gains: of the speed loop, the wheels' loops and the steering's loops.
        memory: changed.
        desired: angles [rad], then rates [rad/s] for the actuators; zeros, changed.
        actuation: torques for the actuators [N m]; zeros, changed.
        status: set-points of speed [m/s] and steering [rad], trim of the speed [m/s]; overwritten.

    Returns:
        Slope of the speed set-point [m/s²].
    """
    setup = setups[0]
    period, actuators = setup.period, len(actuation)
    message = CommandState(memory[MESSAGE], memory[MESSAGE + 1], memory[MESSAGE + 2])
    message, result = command_step(message, command[0], command[1], command[2], time, setup.command)
    memory[MESSAGE], memory[MESSAGE + 1], memory[MESSAGE + 2] = message.speed, message.steering, message.stamp

    # Set-points: the slope of the speed and the rate of the steering are limited.
    last_speed = memory[LAST]
    up, down = setup.acceleration * period, setup.deceleration * period
    if last_speed < 0.0:
        up, down = down, up
    speed = min(max(result.setpoint.speed, last_speed - down), last_speed + up)
    steering = approach(setup.steering, memory[LAST + 1], result.setpoint.steering, period)
    memory[LAST], memory[LAST + 1] = speed, steering
    slope = (speed - last_speed) / period
    last_angles, _ = law(setup.steering, memory[LATE + setup.late - 1])
    angles, ratios = law(setup.steering, actuator_step(memory, LATE, setup.late, steering, setup.actuator))

    # Speed loop, unless it is the pedals': trimmed wheel speeds until the vehicle has the speed.
    trimmed = speed
    if not setup.pedals:
        loop, trimmed = cruise_step(
            read_pid(memory, setup.speed_loop),
            speed,
            forward_speed(x, setup.quaternion, setup.velocity),
            period,
            gains[SPEED_LOOP],
            setup.speed_limits,
        )
        write_pid(memory, setup.speed_loop, loop)
        rates = wheel_speed_setpoints(trimmed, ratios, setup.radii)
        for i in range(4):
            if not setup.turned[i]:
                continue
            push = setup.push[i] * slope
            if setup.wheel_pid:
                at, spin = setup.wheel_loops[i], x[setup.wheel_velocities[i]]
                loop, push = pid_step(
                    read_pid(memory, at), rates[i], spin, gains[WHEEL_LOOP], period, setup.wheel_limits, push
                )
                write_pid(memory, at, loop)
            else:
                rate = rates[i]
                if setup.open_differential:
                    # Each servo of Drake holds its own wheel. When its set-point has the difference of speed that the
                    # wheels have, its error is that of the axle's mean speed, and both torques are equal.
                    other = i ^ 1
                    difference = x[setup.wheel_velocities[i]] - x[setup.wheel_velocities[other]]
                    rate = 0.5 * (rates[i] + rates[other] + difference)
                desired[actuators + setup.wheel_inputs[i]] = rate
            actuation[setup.wheel_inputs[i]] = push
    for i in range(2):
        joint = setup.steering_inputs[i]
        if setup.steering_pid:
            at, angle = setup.steering_loops[i], x[setup.steering_positions[i]]
            loop, torque = pid_step(
                read_pid(memory, at), angles[i], angle, gains[STEERING_LOOP], period, setup.steering_limits, 0.0
            )
            write_pid(memory, at, loop)
            actuation[joint] = torque
        else:
            desired[joint] = angles[i]
            desired[actuators + joint] = (angles[i] - last_angles[i]) / period
    status[0], status[1], status[2] = speed, steering, trimmed - speed
    return slope


def forward_speed(x: Sequence[float], quaternion: int, velocity: int) -> float:
    """Speed of a floating frame's origin along its x axis [m/s].

    Args:
        x: state of the plant.
        quaternion: place of its orientation.
        velocity: place of its origin's velocity.
    """
    w, i, j, k = x[quaternion], x[quaternion + 1], x[quaternion + 2], x[quaternion + 3]
    vx, vy, vz = x[velocity], x[velocity + 1], x[velocity + 2]
    half = 0.5 * (w * w + i * i + j * j + k * k)  # Drake lets the quaternion's norm drift from 1
    return vx * (1.0 - (j * j + k * k) / half) + (vy * (i * j + w * k) + vz * (i * k - w * j)) / half


CONTROL_PARTS = (
    command_step, approach, wheel_angles, wheel_speed_ratios, bicycle_angle, unior_angles, ackermann_wheels,
    unior_wheels, actuator_step, follow, cruise_step, wheel_speed_setpoints, pid_step, read_pid, write_pid,
    forward_speed,
)  # fmt: skip
"""What :func:`control_step` calls beside the law."""
