"""The control unit of a vehicle: from a command to what its joints shall do.

All loops of control.yaml run in one discrete update, because in Python the update itself costs more than the laws
in it. The laws are those of this package, each also a system of its own.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from mirdrake.controllers.ackermann import AxleGeometry, SteeringGeometry, make_steering_law
from mirdrake.controllers.command import CommandLimits, CommandState, command_step
from mirdrake.controllers.cruise import WheelRates, cruise_step, wheel_speed_setpoints
from mirdrake.controllers.gain_schedule import read_schedule
from mirdrake.controllers.pedal_control import PedalLaw, PedalState
from mirdrake.controllers.pid import PidGains, PidLimits, PidState, pid_step
from mirdrake.controllers.vectors import COMMAND, WHEELS
from mirdrake.powertrain import PEDALS, ActuatorLaw
from mirdrake.powertrain.system import make_law
from mirdrake.signals import declare_state_output, declare_vector_input, signals
from mirdrake.vehicles.spec import Beliefs

if TYPE_CHECKING:
    from mirdrake.plant import VehicleInPlant

GAINS = ("kp", "ki", "kd")
"""Order of the gains in a parameter."""

_MESSAGE, _LAST = slice(0, 3), slice(3, 5)
"""Places in the memory of the last message and of the last speed and steering set-points."""
_STATUS = signals(
    ("speed_setpoint", "m/s", "speed asked of the wheels, before the trim"),
    ("steering_setpoint", "rad", "bicycle steering angle after limit and rate"),
    ("speed_trim", "m/s", "correction of the speed loop"),
)


class VehicleControl(LeafSystem):  # type: ignore[misc, unused-ignore]
    """Dead-man, Ackermann steering, speed loop and wheel loops of one vehicle.

    Input ports:
        command (3) [m/s, rad, s]: wanted speed of the rear axle's centre, bicycle steering angle, time stamp.
        plant_state: the plant's state, positions and velocities.
    Output ports:
        desired_state (2 x actuators): for the plant's desired-state port of this vehicle, [rad] then [rad/s].
        actuation (actuators) [N m]: for the plant's actuation port of this vehicle.
        status (3) [m/s, rad, m/s]: speed_setpoint, steering_setpoint, speed_trim.
        pedals (3) [1]: throttle, brake, gear; only with a wheel_speed of kind pedals, which drives and brakes with them
            and leaves the wheels' actuators alone.

    Parameters of the Context: 0: kp, ki of the speed loop; then, for loops of kind pid, kp, ki, kd of the
    wheel-speed loop and of the steering loop; with pedals kp, ki of theirs and a zero for the wheel-speed loop. Gains
    that control.yaml schedules over speed are read there, at the measured speed, whatever the parameter says.

    Between steering set-point and joints stands the steering actuator of vehicle.yaml: delay, lag, rate.

    The outputs are discrete states, updated `rate` times a second.

    Args:
        plant: the finalised plant.
        part: the vehicle in it.
    """

    def __init__(self, plant: MultibodyPlant, part: "VehicleInPlant") -> None:
        super().__init__()
        control, geometry = part.vehicle.control, part.vehicle.geometry
        self._period = 1.0 / control.rate
        self._control = control
        steering, believes = part.vehicle.spec.steering, control.believes
        front, rear = [believes.wheel_radius or radius for radius in part.rolling_radii(plant)]
        self._radii = (front, front, rear, rear)
        self._ackermann = make_steering_law(believed_geometry(geometry, believes), steering.law, factor=steering.factor)
        self._index = _Indices(plant, part)
        count = self._index.actuators
        self._turned: Sequence[int] = () if part.parked else self._index.driven
        self._wheel_pid = control.wheel_speed if control.wheel_speed.kind == "pid" else None
        self._steering_pid = control.steering if control.steering.kind == "pid" else None
        mass = plant.CalcTotalMass(plant.CreateDefaultContext(), [part.instance])
        self._push = [mass * radius / len(self._index.driven) for radius in self._radii]  # torque per acceleration
        torque_share = part.vehicle.spec.powertrain.max_torque / len(self._index.driven)
        correction = control.speed.max_correction
        self._speed_limits = PidLimits(-correction, correction)
        self._command_limits = CommandLimits(timeout=control.dead_man)
        self._wheel_limits = PidLimits(-torque_share, torque_share)
        if self._wheel_pid is not None and self._wheel_pid.max_torque is not None:
            self._wheel_limits = PidLimits(-self._wheel_pid.max_torque, self._wheel_pid.max_torque)
        self._pedal_law = None
        if control.wheel_speed.kind == "pedals" and not part.parked:
            self._pedal_law = PedalLaw(control.wheel_speed, make_law(plant, part), part.vehicle.spec, self._period)
        self._steering_actuator = ActuatorLaw(part.vehicle.spec.actuators.steering, period=self._period)
        self._steering_limits = PidLimits()
        if self._steering_pid is not None and self._steering_pid.max_torque is not None:
            self._steering_limits = PidLimits(-self._steering_pid.max_torque, self._steering_pid.max_torque)

        self.command = declare_vector_input(self, "command", COMMAND)
        self.plant_state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())

        self._gains = [self.DeclareNumericParameter(_vector([control.speed.kp, control.speed.ki]))]
        for loop in (control.wheel_speed, control.steering):
            gains = [0.0, 0.0, 0.0]
            if loop.kind != "servo":
                gains = [loop.kp, loop.ki, loop.kd if loop.kind == "pid" else 0.0]
            self._gains.append(self.DeclareNumericParameter(_vector(gains)))
        self._filter_times = [0.0, *(loop.filter if loop else 0.0 for loop in (self._wheel_pid, self._steering_pid))]
        schedules = [getattr(loop, "schedule", None) for loop in (control.wheel_speed, control.steering)]
        self._tables = (None, *map(read_schedule, schedules))
        self._known_gains: dict[int, tuple[list[float], PidGains]] = {}
        self._wheels: dict[float, tuple[tuple[float, float], WheelRates]] = {}
        self._desired = self.DeclareDiscreteState(2 * count)
        self._actuation = self.DeclareDiscreteState(count)
        self._status = self.DeclareDiscreteState(3)
        # Memory: last message, last speed and steering set-point, steering on its way, pedals, loops.
        memory = [*CommandState(), 0.0, 0.0]
        self._late = _append(memory, self._steering_actuator.rest(0.0))
        if self._pedal_law is not None:
            self._foot = _append(memory, PedalState().flat())
        self._speed_loop = _append(memory, PidState())
        self._wheel_loops = {i: _append(memory, PidState()) for i in self._turned if self._wheel_pid is not None}
        self._steering_loops = [_append(memory, PidState()) for _ in range(2) if self._steering_pid is not None]
        self._memory = self.DeclareDiscreteState(memory)
        self.desired_state = self.DeclareStateOutputPort("desired_state", self._desired)
        self.actuation = self.DeclareStateOutputPort("actuation", self._actuation)
        self.status = declare_state_output(self, "status", _STATUS, self._status)
        if self._pedal_law is not None:
            self._pedals = self.DeclareDiscreteState(len(PEDALS))
            self.pedals = declare_state_output(self, "pedals", PEDALS, self._pedals)
        self.DeclareInitializationDiscreteUpdateEvent(self._initialize)
        self.DeclarePeriodicDiscreteUpdateEvent(self._period, 0.0, self._update)

    def _initialize(self, context: Context, state: DiscreteValues) -> None:
        """Start from the speed and steering angle that the vehicle has, so that nothing jerks.

        The first outputs are shown; the update at the same time is the first that counts.
        """
        x = self.plant_state.Eval(context).tolist()
        left, right = (x[index] for index in self._index.steering_positions)
        speed, steering = self._index.forward_speed(x), self._ackermann.bicycle_angle(left, right)
        memory = context.get_discrete_state(self._memory).value().tolist()
        memory[_LAST] = speed, steering
        memory[self._late] = self._steering_actuator.rest(steering)
        self._step(context, state, x, list(memory))
        state.set_value(self._status, [speed, steering, 0.0])
        state.set_value(self._memory, memory)

    def _update(self, context: Context, state: DiscreteValues) -> None:
        memory = context.get_discrete_state(self._memory).value().tolist()
        self._step(context, state, self.plant_state.Eval(context).tolist(), memory)

    def _step(self, context: Context, state: DiscreteValues, x: list[float], memory: list[float]) -> None:
        """One step of everything; the memory is changed."""
        period, loops, index = self._period, self._control.speed, self._index
        last_speed, last_steering = memory[_LAST]
        speed, steering, stamp = self.command.Eval(context).tolist()
        memory[_MESSAGE], (wanted, _) = command_step(
            CommandState(*memory[_MESSAGE]),
            speed,
            steering,
            stamp=stamp,
            time=context.get_time(),
            limits=self._command_limits,
        )

        # Set-points: the slope of the speed and the rate of the steering are limited.
        up, down = loops.max_acceleration * period, loops.max_deceleration * period
        slower, faster = (down, up) if last_speed >= 0.0 else (up, down)
        speed = min(max(wanted.speed, last_speed - slower), last_speed + faster)
        steering = self._ackermann.approach(last_steering, wanted.steering, period=period)
        last_angle = memory[self._late][-1]
        memory[self._late], angle = self._steering_actuator.step(memory[self._late], steering)
        angles, ratios = self._wheels_at(angle)
        slope = (speed - last_speed) / period
        memory[_LAST] = speed, steering

        # Speed loop: the pedals, or trimmed wheel speeds until the vehicle has the speed.
        desired = [0.0] * (2 * index.actuators)
        actuation = [0.0] * index.actuators
        trimmed = speed
        if self._pedal_law is not None:
            foot, pedals = self._pedal_law.step(
                PedalState.read(memory[self._foot]),
                speed,
                slope,
                index.forward_speed(x),
                gains=self._read_gains(context, 1, x),
            )
            memory[self._foot] = foot.flat()
            state.get_mutable_value(self._pedals)[:] = pedals
        else:
            trimmed = self._turn_wheels(context, x, memory, speed, slope, ratios, desired, actuation)
        if self._steering_pid is None:
            old_angles, _ = self._wheels_at(last_angle)
            for at, angle, old in zip(index.steering_inputs, angles, old_angles, strict=True):
                desired[at] = angle
                desired[index.actuators + at] = (angle - old) / period
        else:
            gains = self._read_gains(context, 2, x)
            for i, loop in enumerate(self._steering_loops):
                actuation[index.steering_inputs[i]] = self._pid(
                    memory, loop, angles[i], x[index.steering_positions[i]], gains, self._steering_limits
                )
        state.get_mutable_value(self._desired)[:] = desired
        state.get_mutable_value(self._actuation)[:] = actuation
        state.get_mutable_value(self._status)[:] = speed, steering, trimmed - speed
        state.get_mutable_value(self._memory)[:] = memory

    def _turn_wheels(
        self,
        context: Context,
        x: list[float],
        memory: list[float],
        speed: float,
        slope: float,
        ratios: WheelRates,
        desired: list[float],
        actuation: list[float],
    ) -> float:
        """Speed loop and loops of the wheels; memory and outputs are changed, the trimmed speed is returned [m/s]."""
        index = self._index
        memory[self._speed_loop], trimmed = cruise_step(
            memory[self._speed_loop],
            speed,
            index.forward_speed(x),
            period=self._period,
            gains=self._read_gains(context, 0, x),
            limits=self._speed_limits,
        )
        rates = wheel_speed_setpoints(trimmed, ratios, radii=self._radii)
        if self._wheel_pid is None:
            for i in self._turned:
                actuation[index.wheel_inputs[i]] = self._push[i] * slope
                desired[index.actuators + index.wheel_inputs[i]] = rates[i]
        else:
            gains = self._read_gains(context, 1, x)
            for i, loop in self._wheel_loops.items():
                measured, push = x[index.wheel_velocities[i]], self._push[i] * slope
                actuation[index.wheel_inputs[i]] = self._pid(
                    memory, loop, rates[i], measured, gains, self._wheel_limits, push
                )
        return trimmed

    def _wheels_at(self, steering: float) -> tuple[tuple[float, float], WheelRates]:
        """Wheel angles and speed ratios of a steering angle; the last few are remembered, as most are asked twice."""
        known = self._wheels.get(steering)
        if known is None:
            if len(self._wheels) > 8:
                self._wheels.clear()
            known = self._ackermann.wheel_angles(steering), self._ackermann.wheel_speed_ratios(steering)
            self._wheels[steering] = known
        return known

    def _pid(
        self,
        memory: list[float],
        loop: slice,
        reference: float,
        measurement: float,
        gains: PidGains,
        limits: PidLimits,
        feedforward: float = 0.0,
    ) -> float:
        """One step of the PID kept at a place of the memory, which is changed."""
        memory[loop], control = pid_step(
            memory[loop],
            reference,
            measurement,
            gains=gains,
            period=self._period,
            limits=limits,
            feedforward=feedforward,
        )
        return control

    def _read_gains(self, context: Context, group: int, x: Sequence[float]) -> PidGains:
        """Gains of a loop from the Context, and from its table at the speed now; those read last are not made anew."""
        values = context.get_numeric_parameter(self._gains[group]).value().tolist()
        table = self._tables[group]
        if table is not None:
            for name, value in table.at(abs(self._index.forward_speed(x))).items():
                values[GAINS.index(name)] = value
        known = self._known_gains.get(group)
        if known is None or known[0] != values:
            kp, ki, kd = values if group else (*values, 0.0)
            if group == 1 and self._pedal_law is not None:
                gains = self._pedal_law.gains(kp, ki)
            else:
                gains = PidGains(kp, ki, kd, filter_time=self._filter_times[group])
            known = self._known_gains[group] = values, gains
        return known[1]


def believed_geometry(geometry: SteeringGeometry, believes: Beliefs) -> SteeringGeometry:
    """The geometry that a controller calculates with: the model's, or what control.yaml says instead."""
    if believes.wheelbase is None and believes.track is None:
        return geometry
    return AxleGeometry(
        wheelbase=believes.wheelbase or geometry.wheelbase,
        front_track=believes.track or geometry.front_track,
        rear_track=believes.track or geometry.rear_track,
        kingpin_track=believes.track or geometry.kingpin_track,
        steering_limit=geometry.steering_limit,
        steering_rate=geometry.steering_rate,
    )


def _append(memory: list[float], values: Sequence[float]) -> slice:
    """Make room in the memory for values, and put them there; their place."""
    memory.extend(values)
    return slice(len(memory) - len(values), len(memory))


class _Indices:
    """Where a vehicle's joints stand in the plant's state and in the ports of its model instance."""

    def __init__(self, plant: MultibodyPlant, part: "VehicleInPlant") -> None:
        positions = plant.num_positions()
        self.actuators = plant.num_actuators(part.instance)
        self.wheel_inputs = [int(actuator.input_start()) for actuator in part.wheel_actuators]
        self.steering_inputs = [int(actuator.input_start()) for actuator in part.steering_actuators]
        first = min(plant.get_joint_actuator(i).input_start() for i in plant.GetJointActuatorIndices(part.instance))
        self.wheel_inputs = [i - first for i in self.wheel_inputs]
        self.steering_inputs = [i - first for i in self.steering_inputs]
        self.wheel_velocities = [positions + joint.velocity_start() for joint in part.wheels]
        self.steering_positions = [joint.position_start() for joint in part.steering]
        self.driven: Sequence[int] = [WHEELS.index(wheel) for wheel in part.vehicle.spec.driven_wheels()]
        self.quaternion = part.base.floating_positions_start()
        self.velocity = positions + part.base.floating_velocities_start_in_v() + 3

    def forward_speed(self, x: Sequence[float]) -> float:
        """Speed of the base frame's origin along its x axis [m/s]."""
        w, i, j, k = x[self.quaternion : self.quaternion + 4]
        vx, vy, vz = x[self.velocity : self.velocity + 3]
        half = 0.5 * (w * w + i * i + j * j + k * k)  # Drake lets the quaternion's norm drift from 1
        return vx * (1.0 - (j * j + k * k) / half) + (vy * (i * j + w * k) + vz * (i * k - w * j)) / half


def _vector(values: Sequence[float]) -> BasicVector:
    return BasicVector(list(values))
