"""The control unit of a vehicle: from a command to the set-points and torques of its joints.

All loops of control.yaml run in one discrete update (:mod:`mirdrake.controllers.control_step`), because in Python the
update itself costs more than the laws in it. :class:`ControlUnit` holds the step, its gains and its memory;
:class:`VehicleControl` connects it to a MultibodyPlant,
:class:`mirdrake.single_track.SingleTrackControl` to the reduced model.
"""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, State

from mirdrake.controllers.ackermann import AxleGeometry, SteeringGeometry, SteeringLaw, make_steering_law
from mirdrake.controllers.command import CommandLimits, CommandState
from mirdrake.controllers.control_step import (
    CONTROL_PARTS,
    LAST,
    STEERING_ACTUATOR,
    ControlSetup,
    control_step,
    forward_speed,
)
from mirdrake.controllers.joint_blocks import STATUS
from mirdrake.core.compiled import as_arrays, compiled, entry_point, records
from mirdrake.core.json_io import Json
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.pid import PidGains, PidLimits, PidNumbers, PidState
from mirdrake.core.signals import declare_state_output, declare_vector_input
from mirdrake.core.vectors import COMMAND, WHEELS
from mirdrake.plant.powertrain import PEDALS, ActuatorLaw, PowertrainLaw
from mirdrake.plant.powertrain.law import POWERTRAIN_PARTS, throttle_limits
from mirdrake.plant.powertrain.system import make_law
from mirdrake.vehicles import Vehicle
from mirdrake.vehicles.joint_control.base import NoNumbers, PedalController, PedalPositions, feedforward_only
from mirdrake.vehicles.joint_control.pedals import PEDAL_PARTS, PedalLaw, pedal_step
from mirdrake.vehicles.spec import AssumedGeometry

if TYPE_CHECKING:
    from mirdrake.plant.plant import VehicleInPlant

Vector = npt.NDArray[np.float64]


class StepResult(NamedTuple):
    """Outputs of one step.

    Attributes:
        memory: memory for the next step.
        desired: angles [rad], then rates [rad/s] for the servos of the actuators.
        actuation: torques of the actuators [N m].
        status: in the order of :data:`STATUS`.
        trimmed: speed after the trim [m/s].
        pedals: throttle, brake and gear; None: pedals do not drive.
    """

    memory: Sequence[float]
    desired: Sequence[float]
    actuation: Sequence[float]
    status: Sequence[float]
    trimmed: float
    pedals: PedalPositions | None


class ControlUnit(LeafSystem):  # type: ignore[misc, unused-ignore]
    """Dead-man, steering law, speed loop and joint loops of one vehicle; base of its two connections to a model.

    Parameters of the Context: 0: kp, ki of the speed loop; 1: gains of ``wheel_speed``; 2: gains of ``steering``, in
    the order of :attr:`mirdrake.vehicles.joint_control.JointControl.gains`. Gains with a schedule in control.yaml are
    read from it at the measured speed, whatever the parameter is.

    The steering actuator of vehicle.yaml (delay, lag, rate) is between the steering set-point and the joints.

    Attributes:
        vehicle: the vehicle.
        setup: constants of the step.
        steering_law: steering law of the assumed geometry.
        actuator: law of the steering actuator.
        pedal_law: controller of the pedals; None: pedals do not drive.
        actuators: number of actuators.

    Args:
        vehicle: a loaded vehicle.
        mass: its mass [kg].
        radii: effective radii of the wheels [m], from which the controllers calculate wheel speeds.
        driven: which wheels the unit drives.
        places: fields of :class:`ControlSetup` that locate joints in the state of the model and among its actuators.
        actuators: number of actuators.
        powertrain: law of the powertrain if pedals drive this vehicle.
        single_track: whether the model takes the steering angle itself and all its wheels roll at the same speed.
        machine_code: whether the step is compiled.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        *,
        mass: float,
        radii: tuple[float, float, float, float],
        driven: Sequence[bool],
        places: Json,
        actuators: int,
        powertrain: PowertrainLaw | None,
        single_track: bool = False,
        machine_code: bool = False,
    ) -> None:
        super().__init__()
        control, spec = vehicle.control, vehicle.spec
        self.vehicle, self._period, self.actuators = vehicle, 1.0 / control.rate, actuators
        # The controllers know the dimensions that control.yaml states, which may be wrong on purpose.
        assumed = assumed_geometry(vehicle.geometry, control.assumed)
        self.steering_law = make_steering_law(assumed, spec.steering.law, factor=spec.steering.factor)
        self.actuator = ActuatorLaw(spec.actuators.steering, period=self._period)
        wheel, steering = control.wheel_speed, control.steering
        self.pedal_law: PedalController | None = None
        if powertrain is not None:
            self.pedal_law = wheel.make_pedal_controller(powertrain, spec, self._period)

        # The memory is one vector: message, last set-points, steering actuator, then the state of every loop.
        memory = [*CommandState(), 0.0, 0.0, *self.actuator.rest(0.0)]
        speed_loop = _append(memory, PidState()).start
        wheel_loops = [_append(memory, wheel.memory).start if drives else -1 for drives in driven]
        steering_loops = [_append(memory, steering.memory).start for _ in range(2)]
        rest = self.pedal_law.rest() if self.pedal_law is not None else []
        self._pedal_memory = _append(memory, rest)

        # A torque in total is shared by the driven wheels.
        share = sum(name in spec.driven_wheels() for name in WHEELS)
        correction = control.speed.max_correction
        fastest = np.inf if control.speed.max_speed is None else control.speed.max_speed
        self.setup = ControlSetup(
            period=self._period,
            acceleration=control.speed.max_acceleration,
            deceleration=control.speed.max_deceleration,
            command=CommandLimits(-fastest, fastest, timeout=control.dead_man),
            steering=self.steering_law.numbers,
            actuator=self.actuator.numbers,
            actuator_size=self.actuator.size,
            speed_limits=PidLimits(-correction, correction),
            wheel_limits=wheel.torque_limits(spec.powertrain.max_torque / share),
            steering_limits=steering.torque_limits(np.inf),
            radii=radii,
            torque_per_acceleration=tuple(mass * radius / share for radius in radii),  # type: ignore[arg-type]
            pedals=self.pedal_law is not None,
            wheel_servo=wheel.servo_gains() is not None,
            steering_servo=steering.servo_gains() is not None,
            open_differential=wheel.has_open_differential(),
            driven=tuple(driven),  # type: ignore[arg-type]
            speed_loop=speed_loop,
            wheel_loops=tuple(wheel_loops),  # type: ignore[arg-type]
            steering_loops=tuple(steering_loops),
            **places,
        )
        self._start_memory = memory

        # Gains are parameters of the Context; their numbers are made anew only when a value changes.
        loops = (wheel, steering)
        values = [[control.speed.kp, control.speed.ki], *(loop.gain_values() for loop in loops)]
        self._gains = [self.DeclareNumericParameter(BasicVector(list(group))) for group in values]
        schedules = (None, *(loop.gain_schedule() for loop in loops))
        self._tables = [None if schedule is None else schedule.table() for schedule in schedules]
        self._gain_names = (("kp", "ki"), *(tuple(loop.gains) for loop in loops))
        self._make_numbers: list[Callable[[Sequence[float]], Any]] = [
            lambda gains: PidGains(*gains).numbers(),
            wheel.numbers if self.pedal_law is None else self.pedal_law.numbers,
            steering.numbers,
        ]
        self._known_gains: list[tuple[list[float], Any] | None] = [None] * len(self._gains)
        self._written: list[Any] = [None] * len(self._gains)

        # The step takes the laws of the kinds; a law without gains keeps its numbers.
        laws = (
            feedforward_only if self.pedal_law is not None else wheel.torque_law(),
            feedforward_only if single_track else steering.torque_law(),
        )
        numbers = [PidNumbers()] + [
            NoNumbers() if law is feedforward_only else loop.numbers(loop.gain_values())
            for law, loop in zip(laws, loops, strict=True)
        ]
        used = (self.pedal_law is None, *(law is not feedforward_only for law in laws))
        self._groups_in_use = [group for group in range(3) if used[group]]
        self._setups: Any = (self.setup,)
        self._gain_numbers: list[Any] = [[number] for number in numbers]
        wheels = _with_equal_speeds(self.steering_law.wheels) if single_track else self.steering_law.wheels
        self._run: Callable[[tuple[Any, ...]], tuple[float, float]]
        self._run = lambda arguments: control_step(wheels, *laws, *arguments)
        self._machine_code = machine_code
        if machine_code:
            self._setups = records(ControlSetup, [self.setup])
            self._gain_numbers = [records(type(number), [number]) for number in numbers]
            parts: list[Callable[..., Any]] = [*CONTROL_PARTS, *wheel.law_parts, *steering.law_parts]
            self._run = entry_point(compiled(control_step, (wheels, *laws), parts=parts))
        # A kind of the user's has its own law of the pedals, which stays in Python.
        self._press: Callable[[tuple[Any, ...]], PedalPositions] | None = None
        if machine_code and powertrain is not None and isinstance(self.pedal_law, PedalLaw):
            self._press_numbers = as_arrays(self.pedal_law.pedal_numbers), as_arrays(powertrain.numbers)
            press = compiled(pedal_step, throttle_limits, parts=(*PEDAL_PARTS, *POWERTRAIN_PARTS))
            self._press = entry_point(press)

    @property
    def pedal_memory(self) -> int:
        """Start of the memory of the pedals' law in that of the unit."""
        return int(self._pedal_memory.start)

    @abstractmethod
    def _read_state(self, context: Context) -> Vector:
        """Return the state that the step reads, in the layout of the setup's indices."""

    def _start(self, context: Context, speed: float, steering: float) -> Vector:
        """Return the memory of a unit whose last set-points are the present speed and steering angle."""
        memory: Vector = context.get_discrete_state(self._memory).value().copy()
        # The actuator starts settled, with its whole delay line at the present angle.
        memory[LAST : LAST + 2] = speed, steering
        memory[STEERING_ACTUATOR : STEERING_ACTUATOR + self.setup.actuator_size] = steering
        return memory

    def _step(self, context: Context, x: Vector, memory: Vector) -> StepResult:
        """Return the outputs of one step; the memory is not changed."""
        count = self.actuators
        after: Any = memory.tolist()
        desired: Any = [0.0] * (2 * count)
        actuation: Any = [0.0] * count
        status: Any = [0.0] * len(STATUS)
        if self._machine_code:
            after, desired, actuation, status = map(np.array, (after, desired, actuation, status))
        trimmed, pedals = self._advance(context, x, after, desired, actuation, status)
        return StepResult(after, desired, actuation, status, trimmed, pedals)

    def _advance(
        self, context: Context, x: Vector, memory: Any, desired: Any, actuation: Any, status: Any
    ) -> tuple[float, PedalPositions | None]:
        """Advance by one step, and return the trimmed speed [m/s] and the pedals.

        Args:
            context: for command, time and gains.
            x: state of the plant.
            memory: changed in place, as are the next three; lists, or arrays for machine code.
            desired: zeros.
            actuation: zeros.
            status: any numbers.
        """
        command = self.command.Eval(context)
        for group in self._groups_in_use:
            numbers = self._read_gains(context, group, x)
            if numbers is not self._written[group]:  # writing a record takes a microsecond
                self._written[group] = self._gain_numbers[group][0] = numbers
        given = (x, command) if self._machine_code else (x.tolist(), command.tolist())  # lists are faster in Python
        slope, trimmed = self._run(
            (*given, context.get_time(), self._setups, *self._gain_numbers, memory, desired, actuation, status)
        )
        if self.pedal_law is None:
            return trimmed, None
        if self._press is not None:
            gains, at, speed = self._read_gains(context, 1, x), self.pedal_memory, self._forward_speed(x)
            return trimmed, self._press((*self._press_numbers, memory, at, float(status[0]), slope, speed, gains))

        # Pedals follow the limited set-point and its slope, which the step has just calculated.
        memory[self._pedal_memory], pedals = self.pedal_law.step(
            memory[self._pedal_memory],
            float(status[0]),
            slope,
            self._forward_speed(x),
            gains=self._read_gains(context, 1, x),
        )
        return trimmed, pedals

    def _forward_speed(self, x: Sequence[float] | Vector) -> float:
        return float(forward_speed(x, self.setup.quaternion, self.setup.velocity))  # type: ignore[arg-type]

    def _read_gains(self, context: Context, group: int, x: Vector) -> Any:
        """Return the gains of a loop from the Context, and from its schedule at the present speed."""
        values = context.get_numeric_parameter(self._gains[group]).value().tolist()
        table = self._tables[group]
        if table is not None:
            # Forward and reverse have the same gains: a schedule is over the magnitude of the speed.
            for name, value in table.at(abs(self._forward_speed(x))).items():
                values[self._gain_names[group].index(name)] = value
        # Equal values give the same object, by which the caller sees that nothing has to be written.
        known = self._known_gains[group]
        if known is None or known[0] != values:
            known = self._known_gains[group] = values, self._make_numbers[group](values)
        return known[1]


class VehicleControl(ControlUnit):
    """Dead-man, Ackermann steering, speed loop and wheel loops of one vehicle in a MultibodyPlant.

    Input ports:
        command (3) [m/s, rad, s]: set-points of the rear axle centre's speed and of the bicycle steering angle, stamp.
        plant_state: the plant's state, positions and velocities.
    Output ports:
        desired_state (2 x actuators): for the plant's desired-state port of this vehicle, [rad] then [rad/s].
        actuation (actuators) [N m]: for the plant's actuation port of this vehicle.
        status (3) [m/s, rad, m/s]: speed_setpoint, steering_setpoint, speed_trim.
        pedals (3) [1]: throttle, brake, gear; only with a ``wheel_speed`` that drives and brakes with the pedals, and
            then the wheels' actuators get no torque.

    The outputs are discrete states, updated `rate` times a second. Parameters: see :class:`ControlUnit`.

    Args:
        plant: the finalised plant.
        part: the vehicle in it.
        machine_code: whether the step is compiled; up to 0.1 s more at the start, and about half of the time from then
            on.
    """

    def __init__(self, plant: MultibodyPlant, part: "VehicleInPlant", *, machine_code: bool = False) -> None:
        vehicle, positions = part.vehicle, plant.num_positions()
        # Ports of one model instance begin at its first actuator, indices of Drake at that of the plant.
        first = min(plant.get_joint_actuator(i).input_start() for i in plant.GetJointActuatorIndices(part.instance))
        inputs = [int(actuator.input_start()) - first for actuator in (*part.wheel_actuators, *part.steering_actuators)]
        # The controllers may have a wrong wheel radius on purpose (`assumed`), as a real unit does.
        assumed = vehicle.control.assumed.wheel_radius
        front, rear = [assumed or radius for radius in part.rolling_radii(plant)]
        driven = vehicle.spec.driven_wheels()
        uses_pedals = vehicle.control.wheel_speed.uses_pedals and not part.parked
        super().__init__(
            vehicle,
            mass=plant.CalcTotalMass(plant.CreateDefaultContext(), [part.instance]),
            radii=(front, front, rear, rear),
            driven=[not part.parked and wheel in driven for wheel in WHEELS],
            places={
                "wheel_inputs": tuple(inputs[: len(WHEELS)]),
                "steering_inputs": tuple(inputs[len(WHEELS) :]),
                "wheel_velocities": tuple(positions + joint.velocity_start() for joint in part.wheels),
                "steering_positions": tuple(joint.position_start() for joint in part.steering),
                "quaternion": part.base.floating_positions_start(),
                # The linear velocity of a floating base comes after the three angular ones.
                "velocity": positions + part.base.floating_velocities_start_in_v() + 3,
            },
            actuators=plant.num_actuators(part.instance),
            powertrain=make_law(plant, part) if uses_pedals else None,
            machine_code=machine_code,
        )
        self.command = declare_vector_input(self, "command", COMMAND)
        self.plant_state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
        self._desired = self.DeclareDiscreteState(2 * self.actuators)
        self._actuation = self.DeclareDiscreteState(self.actuators)
        self._status = self.DeclareDiscreteState(len(STATUS))
        self._memory = self.DeclareDiscreteState(self._start_memory)
        self.desired_state = self.DeclareStateOutputPort("desired_state", self._desired)
        self.actuation = self.DeclareStateOutputPort("actuation", self._actuation)
        self.status = declare_state_output(self, "status", STATUS, self._status)
        if uses_pedals:
            self._pedals = self.DeclareDiscreteState(len(PEDALS))
            self.pedals = declare_state_output(self, "pedals", PEDALS, self._pedals)
        self.DeclareInitializationDiscreteUpdateEvent(self._initialize)
        # Drake makes unrestricted updates before discrete ones, so the outputs act in the step that begins now. Else
        # they would be late by the time step of the plant.
        self.DeclarePeriodicUnrestrictedUpdateEvent(self._period, 0.0, self._update)

    def _read_state(self, context: Context) -> Vector:
        x: Vector = self.plant_state.Eval(context)
        return x

    def _initialize(self, context: Context, state: DiscreteValues) -> None:
        """Start from the present speed and steering angle, so that the set-points do not jump.

        The outputs show the result of a first step; the update at the same time is the first one that counts.
        """
        x = self._read_state(context)
        left, right = (float(x[index]) for index in self.setup.steering_positions)
        speed, steering = self._forward_speed(x), self.steering_law.bicycle_angle(left, right)
        memory = self._start(context, speed, steering)
        self._write(state, self._step(context, x, memory))
        # The first step gives the outputs; memory and status stay those of the start, or the step would count twice.
        state.set_value(self._status, [speed, steering, 0.0])
        state.set_value(self._memory, memory)

    def _update(self, context: Context, values: State) -> None:
        state = values.get_mutable_discrete_state()
        x = self.plant_state.Eval(context)
        if not self._machine_code:
            self._write(state, self._step(context, x, context.get_discrete_state(self._memory).value()))
            return
        # Machine code writes into the new state, which begins as a copy of the present one.
        desired, actuation = state.get_mutable_value(self._desired), state.get_mutable_value(self._actuation)
        desired.fill(0.0)
        actuation.fill(0.0)
        memory, status = state.get_mutable_value(self._memory), state.get_mutable_value(self._status)
        _, pedals = self._advance(context, x, memory, desired, actuation, status)
        if pedals is not None:
            state.get_mutable_value(self._pedals)[:] = pedals

    def _write(self, state: DiscreteValues, result: StepResult) -> None:
        if result.pedals is not None:
            state.get_mutable_value(self._pedals)[:] = result.pedals
        state.get_mutable_value(self._desired)[:] = result.desired
        state.get_mutable_value(self._actuation)[:] = result.actuation
        state.get_mutable_value(self._status)[:] = result.status
        state.get_mutable_value(self._memory)[:] = result.memory


def assumed_geometry(geometry: SteeringGeometry, assumed: AssumedGeometry) -> SteeringGeometry:
    """Return the geometry that the controllers calculate with: the model's, or that of ``assumed`` in control.yaml."""
    if assumed.wheelbase is None and assumed.track is None:
        return geometry
    return AxleGeometry(
        wheelbase=assumed.wheelbase or geometry.wheelbase,
        front_track=assumed.track or geometry.front_track,
        rear_track=assumed.track or geometry.rear_track,
        kingpin_track=assumed.track or geometry.kingpin_track,
        steering_limit=geometry.steering_limit,
        steering_rate=geometry.steering_rate,
    )


def _with_equal_speeds(law: SteeringLaw) -> SteeringLaw:
    """Return a steering law whose wheels all roll at the speed of the rear axle's centre."""
    return lambda numbers, steering: (law(numbers, steering)[0], (1.0, 1.0, 1.0, 1.0))


def _append(memory: list[float], values: Sequence[float]) -> slice:
    """Append values to the memory and return where they are."""
    memory.extend(values)
    return slice(len(memory) - len(values), len(memory))
