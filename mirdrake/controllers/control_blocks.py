"""The blocks of a control unit, each a LeafSystem that works alone in any Drake diagram.

The laws are those of :mod:`mirdrake.controllers.control_step`. An output is a function of the present inputs and of the
memory: a chain of blocks has no delay, and the block at its end (:class:`ActuatorHold`) samples it every period. In the
same update every block stores its new memory. Therefore the chain gives the same bits as the fused step.

A block that limits a rate starts from a measured value, so that its set-point does not jump. It reads the measurement
until its first update.
"""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

from pydrake.systems.framework import BasicVector, Context, DiscreteValues, InputPort, OutputPort

from mirdrake.controllers.ackermann import Ackermann
from mirdrake.controllers.command import NO_COMMAND_LIMITS, CommandLimits, CommandState, command_step
from mirdrake.controllers.control_step import forward_speed
from mirdrake.controllers.cruise import CRUISE_GAINS, CRUISE_LIMITS, cruise_step, wheel_speed_setpoints
from mirdrake.core.checks import check_number
from mirdrake.core.leaf_system import LeafSystem, weak_callback
from mirdrake.core.pid import PidGains, PidLimits, PidState
from mirdrake.core.signals import (
    Signal,
    declare_vector_input,
    declare_vector_output,
    signals,
)
from mirdrake.core.vectors import COMMAND, SPEED_RATIOS, WHEEL_SPEEDS
from mirdrake.plant.powertrain import ActuatorLaw
from mirdrake.vehicles.joint_control.gain_schedule import GainTable

SPEED = signals(("speed", "m/s"))
STEERING = signals(("steering", "rad"))
SLOPE = signals(("slope", "m/s²"))


class ControlBlock(LeafSystem):  # type: ignore[misc, unused-ignore]
    """A block of a control unit: its outputs are functions of inputs and memory, and its memory advances every period.

    Args:
        period: time between updates [s].
        memory: memory before the first update; empty: the block has none.
        restarts: whether a simulation begins with this memory, instead of that in its Context.

    Raises:
        ConfigError: the period is not positive.
    """

    def __init__(self, period: float, memory: Sequence[float] = (), *, restarts: bool = False) -> None:
        super().__init__()
        self.period = check_number(type(self).__name__, "period", period, unit="s", above=0.0)
        self._memory: Any = None
        self._start = list(memory)
        if memory:
            self._memory = self.DeclareDiscreteState(self._start)
            self.DeclarePeriodicDiscreteUpdateEvent(self.period, 0.0, self._update)
        if restarts:
            self.DeclareInitializationDiscreteUpdateEvent(self._restart)

    @abstractmethod
    def _step(self, context: Context) -> tuple[Sequence[float], Sequence[float]]:
        """Return the memory after one period, and the outputs now."""

    def _restart(self, context: Context, state: DiscreteValues) -> None:  # noqa: ARG002
        state.set_value(self._memory, self._start)

    def _update(self, context: Context, state: DiscreteValues) -> None:
        state.set_value(self._memory, self._step(context)[0])

    def _read_memory(self, context: Context) -> list[float]:
        values: list[float] = context.get_discrete_state(self._memory).value().tolist()
        return values

    def _input(self, name: str, contents: Sequence[Signal]) -> InputPort:
        return declare_vector_input(self, name, contents)

    def _output(
        self, name: str, contents: Sequence[Signal], calc: Callable[..., None], *inputs: InputPort, timed: bool = False
    ) -> OutputPort:
        """Declare an output that depends on these inputs, the memory and the parameters; `timed`: also on the time."""
        needs = {port.ticket() for port in inputs} | {self.xd_ticket(), self.all_parameters_ticket()}
        needs |= {self.time_ticket()} if timed else set()
        return declare_vector_output(self, name, contents, calc, prerequisites=needs)

    def _step_output(
        self, name: str, contents: Sequence[Signal], *inputs: InputPort, first: int = 0, timed: bool = False
    ) -> OutputPort:
        """Declare outputs of :meth:`_step` from the number `first` on; see :meth:`_output`."""
        step, part = weak_callback(self._step), slice(first, first + len(contents))

        def calc(context: Context, output: BasicVector) -> None:
            output.SetFromVector(step(context)[1][part])

        return self._output(name, contents, calc, *inputs, timed=timed)


class Measurements(LeafSystem):  # type: ignore[misc, unused-ignore]
    """Speed, steering and joints of one vehicle, from the state of its plant.

    Input ports:
        plant_state: positions and velocities of the plant.

    Output ports:
        speed (1) [m/s]: forward speed of the rear axle's centre.
        steering (1) [rad]: bicycle angle of the steering joints.
        wheel_speeds (4) [rad/s]: front_left, front_right, rear_left, rear_right.
        left_angle (1), right_angle (1) [rad]: angles of the steering joints.

    Args:
        size: length of the state.
        law: steering law.
        quaternion: index of the orientation of the vehicle in the state.
        velocity: index of the velocity of its origin.
        wheels: indices of the rates of the wheels.
        steering: indices of the angles of the left and right steering joint.
    """

    def __init__(
        self,
        size: int,
        law: Ackermann,
        *,
        quaternion: int,
        velocity: int,
        wheels: Sequence[int],
        steering: Sequence[int],
    ) -> None:
        super().__init__()
        self._law, self._places = law, (quaternion, velocity)
        self._wheels, self._joints = list(wheels), list(steering)
        self.plant_state = self.DeclareVectorInputPort("plant_state", size)
        for name, contents, calc in (
            ("speed", SPEED, self._calc_speed),
            ("steering", STEERING, self._calc_steering),
            ("wheel_speeds", WHEEL_SPEEDS, self._calc_wheels),
            ("left_angle", signals(("left_angle", "rad")), self._calc_left),
            ("right_angle", signals(("right_angle", "rad")), self._calc_right),
        ):
            declare_vector_output(self, name, contents, calc, prerequisites={self.plant_state.ticket()})

    def _calc_speed(self, context: Context, output: BasicVector) -> None:
        output[0] = float(forward_speed(self.plant_state.Eval(context), *self._places))

    def _calc_steering(self, context: Context, output: BasicVector) -> None:
        output[0] = self._law.bicycle_angle(*self.plant_state.Eval(context)[self._joints].tolist())

    def _calc_wheels(self, context: Context, output: BasicVector) -> None:
        output.set_value(self.plant_state.Eval(context)[self._wheels])

    def _calc_left(self, context: Context, output: BasicVector) -> None:
        output[0] = self.plant_state.Eval(context)[self._joints[0]]

    def _calc_right(self, context: Context, output: BasicVector) -> None:
        output[0] = self.plant_state.Eval(context)[self._joints[1]]


class DeadMan(ControlBlock):
    """Commands zero speed when no new message comes; :func:`mirdrake.controllers.command.command_step`.

    Input ports:
        command (3) [m/s, rad, s]: speed, steering, stamp.

    Output ports:
        speed (1) [m/s]: 0 once the last message is older than the timeout.
        steering (1) [rad]: of the last message.

    Args:
        period: time between updates [s].
        limits: limits of the command, and the timeout.
    """

    def __init__(self, *, period: float, limits: CommandLimits = NO_COMMAND_LIMITS) -> None:
        super().__init__(period, CommandState())
        self.limits = limits
        self.command = self._input("command", COMMAND)
        self.speed = self._step_output("speed", SPEED, self.command, timed=True)
        self.steering = self._step_output("steering", STEERING, self.command, first=1, timed=True)

    def _step(self, context: Context) -> tuple[Sequence[float], Sequence[float]]:
        message = CommandState(*self._read_memory(context))
        speed, steering, stamp = self.command.Eval(context).tolist()
        message, result = command_step(message, speed, steering, stamp, context.get_time(), self.limits)
        return message, result.setpoint


class AccelerationLimit(ControlBlock):
    """Limits the slope of the speed set-point.

    Input ports:
        reference (1) [m/s]: set-point of the speed.
        measured_speed (1) [m/s]: where the set-point starts.

    Output ports:
        speed (1) [m/s]: set-point of the speed.
        slope (1) [m/s²]: its derivative.

    Args:
        acceleration: largest slope while the magnitude of the speed rises [m/s²].
        deceleration: largest slope while it falls [m/s²].
        period: time between updates [s].
    """

    def __init__(self, acceleration: float, deceleration: float, *, period: float) -> None:
        super().__init__(period, (0.0, 0.0), restarts=True)
        name = type(self).__name__
        self.acceleration = check_number(name, "acceleration", acceleration, unit="m/s²", above=0.0)
        self.deceleration = check_number(name, "deceleration", deceleration, unit="m/s²", above=0.0)
        self.reference = self._input("reference", SPEED)
        self.measured_speed = self._input("measured_speed", SPEED)
        inputs = self.reference, self.measured_speed
        self.speed = self._step_output("speed", SPEED, *inputs)
        self.slope = self._step_output("slope", SLOPE, *inputs, first=1)

    def _step(self, context: Context) -> tuple[Sequence[float], Sequence[float]]:
        last, started = self._read_memory(context)
        # The set-point starts at the measured speed, so that it does not jump.
        if not started:
            last = self.measured_speed.Eval(context).item()
        up, down = self.acceleration * self.period, self.deceleration * self.period
        # In reverse the signed speed falls while the vehicle accelerates.
        if last < 0.0:
            up, down = down, up
        speed = min(max(self.reference.Eval(context).item(), last - down), last + up)
        return (speed, 1.0), (speed, (speed - last) / self.period)


class SteeringRateLimit(ControlBlock):
    """Limits the steering angle and its rate.

    Input ports:
        reference (1) [rad]: set-point of the bicycle angle.
        measured_steering (1) [rad]: where the set-point starts.

    Output ports:
        steering (1) [rad]: set-point of the bicycle angle.

    Args:
        law: steering law with the limits.
        period: time between updates [s].
    """

    def __init__(self, law: Ackermann, *, period: float) -> None:
        super().__init__(period, (0.0, 0.0), restarts=True)
        self._law = law
        self.reference = self._input("reference", STEERING)
        self.measured_steering = self._input("measured_steering", STEERING)
        self.steering = self._step_output("steering", STEERING, self.reference, self.measured_steering)

    def _step(self, context: Context) -> tuple[Sequence[float], Sequence[float]]:
        last, started = self._read_memory(context)
        if not started:
            last = self.measured_steering.Eval(context).item()
        steering = self._law.approach(last, self.reference.Eval(context).item(), period=self.period)
        return (steering, 1.0), (steering,)


class SteeringActuator(ControlBlock):
    """Delay, lag and rate limit of the steering; :mod:`mirdrake.plant.powertrain.actuator`.

    Input ports:
        reference (1) [rad]: set-point of the bicycle angle.
        measured_steering (1) [rad]: where the actuator starts.

    Output ports:
        steering (1) [rad]: bicycle angle that the actuator demands from the joints.

    Args:
        law: delay, lag and rate; its period is that of the block.
    """

    def __init__(self, law: ActuatorLaw) -> None:
        super().__init__(law.numbers.period, [0.0] * (law.size + 1), restarts=True)
        self._law = law
        self.reference = self._input("reference", STEERING)
        self.measured_steering = self._input("measured_steering", STEERING)
        self.steering = self._step_output("steering", STEERING, self.reference, self.measured_steering)

    def _step(self, context: Context) -> tuple[Sequence[float], Sequence[float]]:
        # The memory is that of the law and, at its end, whether the block has started.
        *line, started = self._read_memory(context)
        if not started:
            line = self._law.rest(self.measured_steering.Eval(context).item())
        line, output = self._law.step(line, self.reference.Eval(context).item())
        return [*line, 1.0], (output,)


class BlockGains:
    """Gains of a block: a parameter of the Context, and their schedule over the speed."""

    def __init__(
        self,
        block: ControlBlock,
        names: Sequence[str],
        values: Sequence[float],
        numbers: Callable[[Sequence[float]], Any],
        table: GainTable | None = None,
    ) -> None:
        self.index = block.DeclareNumericParameter(BasicVector(list(values)))
        self._names, self._numbers, self.table = tuple(names), numbers, table
        self._known: tuple[list[float], Any] | None = None

    def read(self, context: Context, speed: float = 0.0) -> Any:
        """Return the numbers of the law at a speed [m/s]."""
        values = context.get_numeric_parameter(self.index).value().tolist()
        if self.table is not None:
            for name, value in self.table.at(abs(speed)).items():
                values[self._names.index(name)] = value
        # The numbers are made anew only when a gain changes.
        if self._known is None or self._known[0] != values:
            self._known = values, self._numbers(values)
        return self._known[1]


class SpeedPid(ControlBlock):
    """PI controller of the speed; its output corrects the speed from which the wheel speeds are calculated.

    Input ports:
        reference (1) [m/s]: set-point of the speed.
        measurement (1) [m/s]: speed of the vehicle.

    Output ports:
        output (1) [m/s]: correction of the speed.
        error (1) [m/s]: reference minus measurement.
        integral (1) [m/s]: integral part.

    Parameters of the Context: 0: kp [1], ki [1/s].

    Args:
        gains: gains; only kp and ki are used.
        limits: limits of the correction [m/s].
        period: time between updates [s].
    """

    def __init__(self, gains: PidGains = CRUISE_GAINS, *, period: float, limits: PidLimits = CRUISE_LIMITS) -> None:
        super().__init__(period, PidState())
        self.limits = limits
        self.gains = BlockGains(self, ("kp", "ki"), (gains.kp, gains.ki), lambda values: PidGains(*values).numbers())
        self.reference = self._input("reference", SPEED)
        self.measurement = self._input("measurement", SPEED)
        inputs = self.reference, self.measurement
        self.output = self._step_output("output", signals(("output", "m/s")), *inputs)
        self.error = self._output("error", signals(("error", "m/s")), self._calc_error, *inputs)
        self.integral = self._output("integral", signals(("integral", "m/s")), self._calc_integral)

    def _step(self, context: Context) -> tuple[Sequence[float], Sequence[float]]:
        reference = self.reference.Eval(context).item()
        memory, output = cruise_step(
            self._read_memory(context),
            reference,
            self.measurement.Eval(context).item(),
            self.period,
            self.gains.read(context),
            self.limits,
        )
        # cruise_step returns the corrected speed; the correction is the control in the PI state, or zero at a stop.
        return memory, (memory[0] if reference != 0.0 else output,)

    def _calc_error(self, context: Context, output: BasicVector) -> None:
        output[0] = self.reference.Eval(context).item() - self.measurement.Eval(context).item()

    def _calc_integral(self, context: Context, output: BasicVector) -> None:
        output[0] = self._read_memory(context)[1]


class WheelSpeeds(LeafSystem):  # type: ignore[misc, unused-ignore]
    """Set-points of the wheel speeds: free rolling at the corrected speed.

    Input ports:
        speed (1) [m/s]: set-point of the speed.
        correction (1) [m/s]: added to it.
        ratios (4) [1]: speeds of the wheel centres over that of the rear axle's centre.

    Output ports:
        wheel_speeds (4) [rad/s]: front_left, front_right, rear_left, rear_right.

    Args:
        radii: rolling radii of the wheels [m].
    """

    def __init__(self, radii: tuple[float, float, float, float]) -> None:
        super().__init__()
        self.radii = radii
        self.speed = declare_vector_input(self, "speed", SPEED)
        self.correction = declare_vector_input(self, "correction", signals(("correction", "m/s")))
        self.ratios = declare_vector_input(self, "ratios", SPEED_RATIOS)
        needs = {port.ticket() for port in (self.speed, self.correction, self.ratios)}
        self.wheel_speeds = declare_vector_output(self, "wheel_speeds", WHEEL_SPEEDS, self._calc, prerequisites=needs)

    def _calc(self, context: Context, output: BasicVector) -> None:
        speed = self.speed.Eval(context).item() + self.correction.Eval(context).item()
        output.SetFromVector(wheel_speed_setpoints(speed, self.ratios.Eval(context).tolist(), self.radii))
