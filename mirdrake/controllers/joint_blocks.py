"""Blocks at the joints of a control unit: loops of wheels and steering joints, pedals, and the hold of the actuators.

See :mod:`mirdrake.controllers.control_blocks`.
"""

from collections.abc import Mapping, Sequence

from pydrake.systems.framework import BasicVector, Context, DiscreteValues, InputPort, State

from mirdrake.controllers.control_blocks import SLOPE, SPEED, STEERING, BlockGains, ControlBlock
from mirdrake.core.checks import check_number
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.pid import NO_LIMITS, PidLimits
from mirdrake.core.signals import Signal, declare_state_output, declare_vector_input, signals
from mirdrake.core.vectors import WHEEL_SPEEDS, WHEELS
from mirdrake.plant.powertrain import PEDALS
from mirdrake.vehicles.joint_control import JointControl
from mirdrake.vehicles.joint_control.base import PedalController

STATUS = signals(
    ("speed_setpoint", "m/s", "set-point of the speed, before the trim"),
    ("steering_setpoint", "rad", "bicycle steering angle after limit and rate"),
    ("speed_trim", "m/s", "correction by the speed loop"),
)
WHEEL_TORQUES = signals(*((name, "N m") for name in WHEELS))
JOINT_ANGLE = signals(("angle", "rad"))
JOINT_TORQUE = signals(("torque", "N m"))
JOINT_SETPOINT = signals(("angle", "rad"), ("rate", "rad/s"))


class JointLoops(ControlBlock):
    """Loops of some joints, of a kind of ``wheel_speed`` or ``steering`` in control.yaml; base of the two.

    Args:
        control: the kind with its gains.
        limits: limits of each torque [N m].
        period: time between updates [s].
        loops: which of the joints have a loop; the others get no torque.
        setpoint: names and units of the set-points and measurements.
        torque: names and units of the torques.
    """

    def __init__(
        self,
        control: JointControl,
        *,
        limits: PidLimits,
        period: float,
        loops: Sequence[bool],
        setpoint: Sequence[Signal],
        torque: Sequence[Signal],
        extra: Sequence[float] = (),
    ) -> None:
        self._size, self._extra = len(control.memory), len(extra)
        super().__init__(period, [*control.memory * len(loops), *extra], restarts=bool(extra))
        self.control, self.limits, self._loops = control, limits, tuple(loops)
        self._law = control.torque_law()
        schedule = control.gain_schedule()
        table = None if schedule is None else schedule.table()
        self.gains = BlockGains(self, tuple(control.gains), control.gain_values(), control.numbers, table)
        self.setpoint = self._input("setpoint", setpoint)
        self.measurement = self._input("measurement", setpoint)
        self.slope = self._declare_slope()
        # Only a gain schedule needs the speed, so only then there is a port.
        self.speed = self._input("speed", SPEED) if table is not None else None
        inputs = [port for port in (self.setpoint, self.measurement, self.slope, self.speed) if port is not None]
        self.torque = self._step_output("torque", torque, *inputs)
        self.error = self._output("error", setpoint, self._calc_error, self.setpoint, self.measurement)

    def _declare_slope(self) -> InputPort | None:
        return None

    def _feedforward(self, context: Context, joint: int) -> float:  # noqa: ARG002
        """Return the feed-forward torque of a joint [N m]."""
        return 0.0

    def _step(self, context: Context) -> tuple[Sequence[float], Sequence[float]]:
        memory = self._read_memory(context) if self._memory is not None else []
        setpoint, measurement = self.setpoint.Eval(context).tolist(), self.measurement.Eval(context).tolist()
        gains = self.gains.read(context, 0.0 if self.speed is None else self.speed.Eval(context).item())
        torques = [
            # The law updates its part of the memory in place, as in the fused unit.
            self._law(
                memory, i * self._size, setpoint[i], measurement[i], self._feedforward(context, i),
                gains, self.period, self.limits,
            )
            if loop else 0.0
            for i, loop in enumerate(self._loops)
        ]  # fmt: skip
        return memory, torques

    def _calc_error(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self.setpoint.Eval(context) - self.measurement.Eval(context))


class WheelLoops(JointLoops):
    """Loops of the driven wheels; the kind of ``wheel_speed`` in control.yaml.

    Input ports:
        setpoint (4) [rad/s]: front_left, front_right, rear_left, rear_right.
        measurement (4) [rad/s]: measured wheel speeds.
        slope (1) [m/s²]: slope of the speed set-point, for the feed-forward torque.
        speed (1) [m/s]: only with a gain schedule.

    Output ports:
        torque (4) [N m]: torques of the wheels.
        error (4) [rad/s]: set-point minus measurement.
        servo_setpoint (4) [rad/s]: for Drake's servos; only with kind servo.

    Parameters of the Context: 0: gains of the kind.

    Args:
        control: the kind with its gains.
        torque_per_acceleration: feed-forward torque of each wheel over the slope [N m s²/m].
        driven: which wheels have a loop.
        limits: limits of each torque [N m].
        period: time between updates [s].
    """

    def __init__(
        self,
        control: JointControl,
        *,
        period: float,
        torque_per_acceleration: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
        driven: Sequence[bool] = (True, True, True, True),
        limits: PidLimits = NO_LIMITS,
    ) -> None:
        # Before the base class, which declares the ports.
        self._per_acceleration = tuple(torque_per_acceleration)
        super().__init__(
            control, limits=limits, period=period, loops=driven, setpoint=WHEEL_SPEEDS, torque=WHEEL_TORQUES
        )
        if control.servo_gains() is not None:
            self.servo_setpoint = self._output(
                "servo_setpoint", WHEEL_SPEEDS, self._calc_servo, self.setpoint, self.measurement
            )

    def _declare_slope(self) -> InputPort | None:
        return self._input("slope", SLOPE)

    def _feedforward(self, context: Context, joint: int) -> float:
        assert self.slope is not None
        return float(self._per_acceleration[joint] * self.slope.Eval(context).item())

    def _calc_servo(self, context: Context, output: BasicVector) -> None:
        rates = self.setpoint.Eval(context).tolist()
        if self.control.has_open_differential():
            # The set-point contains the measured difference of the two wheels: both errors are that of the mean speed.
            spin = self.measurement.Eval(context).tolist()
            rates = [0.5 * (rates[i] + rates[i ^ 1] + (spin[i] - spin[i ^ 1])) for i in range(len(WHEELS))]
        output.SetFromVector([rate if drives else 0.0 for rate, drives in zip(rates, self._loops, strict=True)])


class SteeringLoop(JointLoops):
    """Loop of one steering joint; the kind of ``steering`` in control.yaml.

    Input ports:
        setpoint (1) [rad]: angle of the wheel.
        measurement (1) [rad]: measured angle.
        speed (1) [m/s]: only with a gain schedule.

    Output ports:
        torque (1) [N m]: torque of the joint.
        error (1) [rad]: set-point minus measurement.
        servo_setpoint (2) [rad, rad/s]: for Drake's servo: angle and rate; only with kind servo.

    Parameters of the Context: 0: gains of the kind.

    Args:
        control: the kind with its gains.
        limits: limits of the torque [N m].
        period: time between updates [s].
    """

    def __init__(self, control: JointControl, *, period: float, limits: PidLimits = NO_LIMITS) -> None:
        servo = control.servo_gains() is not None
        super().__init__(
            control,
            limits=limits,
            period=period,
            loops=(True,),
            setpoint=JOINT_ANGLE,
            torque=JOINT_TORQUE,
            extra=(0.0, 0.0) if servo else (),  # last angle; 1 after the first update
        )
        # The servo has its own output, since a set-point of position and a torque act on the joint differently.
        if servo:
            self.servo_setpoint = self._output(
                "servo_setpoint", JOINT_SETPOINT, self._calc_servo, self.setpoint, self.measurement
            )

    def _restart(self, context: Context, state: DiscreteValues) -> None:
        state.set_value(self._memory, [*self._read_memory(context)[: -self._extra], 0.0, 0.0])

    def _step(self, context: Context) -> tuple[Sequence[float], Sequence[float]]:
        memory, torques = super()._step(context)
        if self._extra:
            # The set-point of this step is the last angle of the next one, for the rate of the servo.
            memory = [*memory[: -self._extra], *self.setpoint.Eval(context).tolist(), 1.0]
        return memory, torques

    def _calc_servo(self, context: Context, output: BasicVector) -> None:
        last, started = self._read_memory(context)[-self._extra :]
        if not started:
            last = self.measurement.Eval(context).item()
        angle = self.setpoint.Eval(context).item()
        output.SetFromVector([angle, (angle - last) / self.period])


class PedalLoop(ControlBlock):
    """Speed control with throttle and brake pedal, the kind ``pedals`` of ``wheel_speed`` in control.yaml.

    Input ports:
        reference (1) [m/s]: set-point of the speed.
        slope (1) [m/s²]: its derivative.
        measurement (1) [m/s]: speed of the vehicle.

    Output ports:
        pedals (3) [1]: throttle, brake, gear.
        error (1) [m/s]: reference minus measurement.

    Parameters of the Context: 0: gains of the kind.

    Args:
        control: the kind with its gains.
        law: its controller for the powertrain of the vehicle.
        period: time between updates [s].
    """

    def __init__(self, control: JointControl, law: PedalController, *, period: float) -> None:
        super().__init__(period, law.rest())
        self._law = law
        schedule = control.gain_schedule()
        table = None if schedule is None else schedule.table()
        self.gains = BlockGains(self, tuple(control.gains), control.gain_values(), law.numbers, table)
        self.reference = self._input("reference", SPEED)
        self.slope = self._input("slope", SLOPE)
        self.measurement = self._input("measurement", SPEED)
        inputs = self.reference, self.slope, self.measurement
        self.pedals = self._step_output("pedals", PEDALS, *inputs)
        self.error = self._output("error", signals(("error", "m/s")), self._calc_error, *inputs)

    def _step(self, context: Context) -> tuple[Sequence[float], Sequence[float]]:
        speed = self.measurement.Eval(context).item()
        return self._law.step(
            self._read_memory(context),
            self.reference.Eval(context).item(),
            self.slope.Eval(context).item(),
            speed,
            gains=self.gains.read(context, speed),
        )

    def _calc_error(self, context: Context, output: BasicVector) -> None:
        output[0] = self.reference.Eval(context).item() - self.measurement.Eval(context).item()


class ActuatorHold(LeafSystem):  # type: ignore[misc, unused-ignore]
    """Samples the chain of a control unit every period, and holds the inputs of the vehicle's actuators.

    Input ports:
        wheel_torque (4), left_torque (1), right_torque (1) [N m]: torques of wheels and steering joints.
        wheel_servo (4) [rad/s]: set-points of the wheels' servos.
        left_servo (2), right_servo (2) [rad, rad/s]: set-points of the steering joints' servos.
        pedals (3) [1]: throttle, brake, gear.
        speed, correction, measured_speed (1) [m/s]; steering, measured_steering (1) [rad]: for the status.

    Output ports:
        desired_state (2 x actuators): [rad], then [rad/s].
        actuation (actuators) [N m]
        status (3) [m/s, rad, m/s]: speed_setpoint, steering_setpoint, speed_trim.
        pedals (3) [1]

    Only the inputs that are named in `uses` exist; what is missing is zero.

    Args:
        wheels: index of each wheel among the actuators.
        steering: index of each steering joint among the actuators.
        actuators: number of actuators.
        period: time between samples [s].
        uses: names of the inputs besides those for the status.
    """

    CONTENTS: Mapping[str, Sequence[Signal]] = {
        "wheel_torque": WHEEL_TORQUES,
        "left_torque": JOINT_TORQUE,
        "right_torque": JOINT_TORQUE,
        "wheel_servo": WHEEL_SPEEDS,
        "left_servo": JOINT_SETPOINT,
        "right_servo": JOINT_SETPOINT,
        "pedals": PEDALS,
        "speed": SPEED,
        "correction": signals(("correction", "m/s")),
        "steering": STEERING,
        "measured_speed": SPEED,
        "measured_steering": STEERING,
    }

    def __init__(
        self, wheels: Sequence[int], steering: Sequence[int], *, actuators: int, period: float, uses: Sequence[str]
    ) -> None:
        super().__init__()
        self.period = check_number("ActuatorHold", "period", period, unit="s", above=0.0)
        always = ("speed", "steering", "measured_speed", "measured_steering")
        self.inputs = {
            name: declare_vector_input(self, name, contents)
            for name, contents in self.CONTENTS.items()
            if name in always or name in uses
        }
        n, (left, right) = actuators, steering
        # Drake's actuation ports have one element for each actuator in the order of the plant, which differs between
        # models.
        self._places = {
            "wheel_torque": list(wheels),
            "left_torque": [left],
            "right_torque": [right],
            # The desired state has all angles, then all rates: index n + joint is a rate.
            "wheel_servo": [n + wheel for wheel in wheels],
            "left_servo": [left, n + left],
            "right_servo": [right, n + right],
        }
        # All outputs are states, so that the plant keeps its input from one control instant to the next.
        self._desired = self.DeclareDiscreteState(2 * n)
        self._actuation = self.DeclareDiscreteState(n)
        self._status = self.DeclareDiscreteState(len(STATUS))
        self.desired_state = self.DeclareStateOutputPort("desired_state", self._desired)
        self.actuation = self.DeclareStateOutputPort("actuation", self._actuation)
        self.status = declare_state_output(self, "status", STATUS, self._status)
        if "pedals" in uses:
            self._pedals = self.DeclareDiscreteState(len(PEDALS))
            self.pedals = declare_state_output(self, "pedals", PEDALS, self._pedals)
        self.DeclareInitializationDiscreteUpdateEvent(self._initialize)
        # As in VehicleControl: before the discrete updates, so that the outputs act in the step that begins now.
        self.DeclarePeriodicUnrestrictedUpdateEvent(self.period, 0.0, self._update)

    def _initialize(self, context: Context, state: DiscreteValues) -> None:
        """Output the first sample; the status is the measured speed and steering angle."""
        self._sample(context, state)
        start = [self.inputs[name].Eval(context).item() for name in ("measured_speed", "measured_steering")]
        state.set_value(self._status, [*start, 0.0])

    def _update(self, context: Context, values: State) -> None:
        state = values.get_mutable_discrete_state()
        self._sample(context, state)
        speed, steering = (self.inputs[name].Eval(context).item() for name in ("speed", "steering"))
        port = self.inputs.get("correction")
        corrected = speed + port.Eval(context).item() if port is not None else speed
        state.set_value(self._status, [speed, steering, corrected - speed])

    def _sample(self, context: Context, state: DiscreteValues) -> None:
        for group, names in (
            (self._actuation, ("wheel_torque", "left_torque", "right_torque")),
            (self._desired, ("wheel_servo", "left_servo", "right_servo")),
        ):
            # Places without an input keep their zeros.
            samples = state.get_mutable_value(group)
            for name in names:
                if name in self.inputs:
                    samples[self._places[name]] = self.inputs[name].Eval(context)
        if "pedals" in self.inputs:
            state.get_mutable_value(self._pedals)[:] = self.inputs["pedals"].Eval(context)
