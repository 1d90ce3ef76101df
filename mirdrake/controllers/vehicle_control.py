"""The control unit of a vehicle: from a command to what its joints shall do.

All loops of control.yaml run in one discrete update (:mod:`mirdrake.controllers.control_step`), because in Python the
update itself costs more than the laws in it.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from mirdrake.controllers.ackermann import AxleGeometry, SteeringGeometry, make_steering_law
from mirdrake.controllers.command import CommandLimits, CommandState
from mirdrake.controllers.control_step import (
    CONTROL_PARTS,
    LAST,
    LATE,
    SPEED_LOOP,
    STEERING_LOOP,
    WHEEL_LOOP,
    ControlSetup,
    control_step,
    forward_speed,
)
from mirdrake.controllers.gain_schedule import GainTable, read_schedule
from mirdrake.controllers.pedal_control import PedalLaw, PedalState
from mirdrake.controllers.pid import PidGains, PidLimits, PidNumbers, PidState
from mirdrake.core.compiled import compiled, records
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import declare_state_output, declare_vector_input, signals
from mirdrake.core.vectors import COMMAND, WHEELS
from mirdrake.plant.powertrain import PEDALS, ActuatorLaw
from mirdrake.plant.powertrain.system import make_law
from mirdrake.vehicles.spec import Beliefs

if TYPE_CHECKING:
    from mirdrake.plant.plant import VehicleInPlant

GAINS = ("kp", "ki", "kd")
"""Order of the gains in a parameter."""

Vector = npt.NDArray[np.float64]
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
        machine_code: whether the step is compiled; half a second more to begin with, and about half of the time from
            then on. Pedals stay in Python, so there nothing is gained.
    """

    def __init__(self, plant: MultibodyPlant, part: "VehicleInPlant", *, machine_code: bool = False) -> None:
        super().__init__()
        control, spec = part.vehicle.control, part.vehicle.spec
        self._period = 1.0 / control.rate
        self._ackermann = make_steering_law(
            believed_geometry(part.vehicle.geometry, control.believes), spec.steering.law, factor=spec.steering.factor
        )
        self._actuator = ActuatorLaw(spec.actuators.steering, period=self._period)
        self._pedal_law = None
        if control.wheel_speed.kind == "pedals" and not part.parked:
            self._pedal_law = PedalLaw(control.wheel_speed, make_law(plant, part), spec, self._period)
        setup, memory = self._set_up(plant, part)
        self._setup = setup

        self.command = declare_vector_input(self, "command", COMMAND)
        self.plant_state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
        self._gains = [self.DeclareNumericParameter(_vector([control.speed.kp, control.speed.ki]))]
        self._filter_times = [0.0]
        self._tables: list[GainTable | None] = [None]
        for loop in (control.wheel_speed, control.steering):
            gains = [0.0, 0.0, 0.0]
            if loop.kind != "servo":
                gains = [loop.kp, loop.ki, loop.kd if loop.kind == "pid" else 0.0]
            self._gains.append(self.DeclareNumericParameter(_vector(gains)))
            self._filter_times.append(loop.filter if loop.kind == "pid" else 0.0)
            self._tables.append(read_schedule(getattr(loop, "schedule", None)))
        self._known_gains: dict[int, tuple[list[float], PidNumbers]] = {}
        in_use = {SPEED_LOOP: not setup.pedals, WHEEL_LOOP: setup.wheel_pid, STEERING_LOOP: setup.steering_pid}
        self._in_use = [group for group, used in in_use.items() if used]

        self._count = count = plant.num_actuators(part.instance)
        self._desired = self.DeclareDiscreteState(2 * count)
        self._actuation = self.DeclareDiscreteState(count)
        self._status = self.DeclareDiscreteState(3)
        if self._pedal_law is not None:
            self._foot = _append(memory, PedalState().flat())
        self._memory = self.DeclareDiscreteState(memory)
        self.desired_state = self.DeclareStateOutputPort("desired_state", self._desired)
        self.actuation = self.DeclareStateOutputPort("actuation", self._actuation)
        self.status = declare_state_output(self, "status", _STATUS, self._status)
        if self._pedal_law is not None:
            self._pedals = self.DeclareDiscreteState(len(PEDALS))
            self.pedals = declare_state_output(self, "pedals", PEDALS, self._pedals)

        law, numbers = self._ackermann.wheels, [PidNumbers() for _ in in_use]
        self._setups: Any = (setup,)
        self._gain_numbers: Any = numbers
        self._run: Callable[..., float] = partial(control_step, law)
        self._machine_code = machine_code
        if machine_code:
            self._setups, self._gain_numbers = records(ControlSetup, [setup]), records(PidNumbers, numbers)
            self._run = compiled(control_step, law, parts=CONTROL_PARTS)
        self.DeclareInitializationDiscreteUpdateEvent(self._initialize)
        self.DeclarePeriodicDiscreteUpdateEvent(self._period, 0.0, self._update)

    def _set_up(self, plant: MultibodyPlant, part: "VehicleInPlant") -> tuple[ControlSetup, list[float]]:
        """The unit in numbers, and its memory at the start but for the pedals."""
        control, spec = part.vehicle.control, part.vehicle.spec
        positions, driven = plant.num_positions(), [WHEELS.index(wheel) for wheel in spec.driven_wheels()]
        turned = [not part.parked and i in driven for i in range(len(WHEELS))]
        front, rear = [control.believes.wheel_radius or radius for radius in part.rolling_radii(plant)]
        radii = (front, front, rear, rear)
        mass = plant.CalcTotalMass(plant.CreateDefaultContext(), [part.instance])
        wheel_pid = control.wheel_speed if control.wheel_speed.kind == "pid" else None
        steering_pid = control.steering if control.steering.kind == "pid" else None
        torque = spec.powertrain.max_torque / len(driven)
        if wheel_pid is not None and wheel_pid.max_torque is not None:
            torque = wheel_pid.max_torque
        steering_limits = PidLimits()
        if steering_pid is not None and steering_pid.max_torque is not None:
            steering_limits = PidLimits(-steering_pid.max_torque, steering_pid.max_torque)
        correction = control.speed.max_correction
        first = min(plant.get_joint_actuator(i).input_start() for i in plant.GetJointActuatorIndices(part.instance))
        inputs = [int(one.input_start()) - first for one in (*part.wheel_actuators, *part.steering_actuators)]
        memory = [*CommandState(), 0.0, 0.0, *self._actuator.rest(0.0)]
        speed_loop = _append(memory, PidState()).start
        wheel_loops = [_append(memory, PidState()).start if wheel_pid and turns else -1 for turns in turned]
        steering_loops = [_append(memory, PidState()).start if steering_pid else -1 for _ in part.steering]
        setup = ControlSetup(
            period=self._period,
            acceleration=control.speed.max_acceleration,
            deceleration=control.speed.max_deceleration,
            command=CommandLimits(timeout=control.dead_man),
            steering=self._ackermann.numbers,
            actuator=self._actuator.numbers,
            late=self._actuator.size,
            speed_limits=PidLimits(-correction, correction),
            wheel_limits=PidLimits(-torque, torque),
            steering_limits=steering_limits,
            radii=radii,
            push=tuple(mass * radius / len(driven) for radius in radii),
            pedals=self._pedal_law is not None,
            wheel_pid=wheel_pid is not None,
            steering_pid=steering_pid is not None,
            open_differential=control.wheel_speed.kind == "servo" and control.wheel_speed.differential == "open",
            turned=tuple(turned),  # type: ignore[arg-type]
            speed_loop=speed_loop,
            wheel_loops=tuple(wheel_loops),  # type: ignore[arg-type]
            steering_loops=tuple(steering_loops),  # type: ignore[arg-type]
            wheel_inputs=tuple(inputs[: len(WHEELS)]),
            steering_inputs=tuple(inputs[len(WHEELS) :]),
            wheel_velocities=tuple(positions + joint.velocity_start() for joint in part.wheels),
            steering_positions=tuple(joint.position_start() for joint in part.steering),
            quaternion=part.base.floating_positions_start(),
            velocity=positions + part.base.floating_velocities_start_in_v() + 3,
        )
        return setup, memory

    def _initialize(self, context: Context, state: DiscreteValues) -> None:
        """Start from the speed and steering angle that the vehicle has, so that nothing jerks.

        The first outputs are shown; the update at the same time is the first that counts.
        """
        x = self.plant_state.Eval(context)
        left, right = (float(x[index]) for index in self._setup.steering_positions)
        speed, steering = self._forward_speed(x), self._ackermann.bicycle_angle(left, right)
        memory = context.get_discrete_state(self._memory).value().copy()
        memory[LAST : LAST + 2] = speed, steering
        memory[LATE : LATE + self._setup.late] = steering
        self._step(context, state, x, memory.copy())
        state.set_value(self._status, [speed, steering, 0.0])
        state.set_value(self._memory, memory)

    def _update(self, context: Context, state: DiscreteValues) -> None:
        memory = context.get_discrete_state(self._memory).value().copy()
        self._step(context, state, self.plant_state.Eval(context), memory)

    def _step(self, context: Context, state: DiscreteValues, x: Vector, memory: Vector) -> None:
        """One step of everything; the memory may be changed."""
        count = self._count
        given: tuple[Any, ...] = (x, self.command.Eval(context))
        changed: tuple[Any, ...] = (memory, np.zeros(2 * count), np.zeros(count), np.zeros(3))
        if not self._machine_code:  # lists are quicker in Python
            given, changed = tuple(one.tolist() for one in given), tuple(one.tolist() for one in changed)
        for group in self._in_use:
            self._gain_numbers[group] = self._read_gains(context, group, x)
        slope = self._run(*given, context.get_time(), self._setups, self._gain_numbers, *changed)
        after, desired, actuation, status = changed
        if self._pedal_law is not None:
            foot, pedals = self._pedal_law.step(
                PedalState.read(after[self._foot]),
                float(status[0]),
                slope,
                self._forward_speed(x),
                gains=self._read_gains(context, WHEEL_LOOP, x),
            )
            after[self._foot] = foot.flat()
            state.get_mutable_value(self._pedals)[:] = pedals
        state.get_mutable_value(self._desired)[:] = desired
        state.get_mutable_value(self._actuation)[:] = actuation
        state.get_mutable_value(self._status)[:] = status
        state.get_mutable_value(self._memory)[:] = after

    def _forward_speed(self, x: Sequence[float] | Vector) -> float:
        return float(forward_speed(x, self._setup.quaternion, self._setup.velocity))  # type: ignore[arg-type]

    def _read_gains(self, context: Context, group: int, x: Vector) -> PidNumbers:
        """Gains of a loop from the Context, and from its table at the speed now; those read last are not made anew."""
        values = context.get_numeric_parameter(self._gains[group]).value().tolist()
        table = self._tables[group]
        if table is not None:
            for name, value in table.at(abs(self._forward_speed(x))).items():
                values[GAINS.index(name)] = value
        known = self._known_gains.get(group)
        if known is None or known[0] != values:
            kp, ki, kd = values if group else (*values, 0.0)
            if group == WHEEL_LOOP and self._pedal_law is not None:
                gains = self._pedal_law.gains(kp, ki)
            else:
                gains = PidGains(kp, ki, kd, filter_time=self._filter_times[group])
            known = self._known_gains[group] = values, gains.numbers()
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


def _vector(values: Sequence[float]) -> BasicVector:
    return BasicVector(list(values))
