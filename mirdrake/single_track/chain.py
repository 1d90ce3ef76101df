"""The actuator chain of the full vehicle in front of the single-track model, so that their responses can be compared.

The laws are those of :class:`mirdrake.controllers.vehicle_control.VehicleControl`: dead-man, slope of the speed, limit
and rate of the steering, speed loop. The servos of the joints are part of the model with actuators: Drake holds the
steering joints at their set-point with stiffness k and damping d and follows its rate, which is a lag of d/k; the gains
of the driven wheels, divided by the radius squared, act between the set-point of the speed and the speed.

A vehicle that is driven by pedals has its pedals and its powertrain here, too; its wheels turn with the car, so that
what acts on the slip of single wheels is left out: antilock, stability and traction control.
"""

from pydrake.systems.framework import BasicVector, Context, Diagram, DiagramBuilder, DiscreteValues

from mirdrake.controllers.ackermann import Ackermann, make_steering_law
from mirdrake.controllers.command import CommandLimits, CommandState, command_step
from mirdrake.controllers.cruise import cruise_step
from mirdrake.controllers.gain_schedule import read_schedule
from mirdrake.controllers.pedal_control import PedalLaw, PedalState
from mirdrake.controllers.pid import PidGains, PidLimits, PidState, pid_step
from mirdrake.controllers.vehicle_control import believed_geometry
from mirdrake.core.checks import check_number
from mirdrake.core.errors import ConfigError
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import copy_signals, declare_state_output, declare_vector_input, signals
from mirdrake.core.vectors import COMMAND, STATE
from mirdrake.plant.powertrain import PEDALS, ActuatorLaw
from mirdrake.single_track.dynamics import Tyres, Variant
from mirdrake.single_track.from_vehicle import estimate_parameters
from mirdrake.single_track.parameters import SingleTrackParameters
from mirdrake.single_track.powertrain import SingleTrackPowertrain, make_single_track_law
from mirdrake.single_track.system import FORCES, STEERING, SingleTrack
from mirdrake.vehicles import Vehicle

STATUS = signals(
    ("speed_setpoint", "m/s", "speed asked of the wheels, before the trim"),
    ("steering_setpoint", "rad", "bicycle steering angle after limit and rate"),
    ("speed_trim", "m/s", "correction of the speed loop"),
)
_VX = [signal.name for signal in STATE].index("vx")
_PID = len(PidState._fields)
_MESSAGE, _LAST = slice(0, 3), slice(3, 5)
_SPEED, _WHEEL = slice(5, 5 + _PID), slice(5 + _PID, 5 + 2 * _PID)
_GEAR = 5 + 2 * _PID
_WAY = slice(_GEAR + 1, None)


class SingleTrackControl(LeafSystem):  # type: ignore[misc, unused-ignore]
    """Control unit of a vehicle, for its single-track model.

    Input ports:
        command (3) [m/s, rad, s]: wanted speed of the rear axle's centre, bicycle steering angle, time stamp.
        state (12): of the vehicle.
        steering_angle (1) [rad]: its bicycle angle; read at the start only.
    Output ports:
        steering (2) [rad, rad/s]: bicycle angle for the model with actuators, and its rate.
        forces (3) [N, N, m/s]: drive force ahead of the servos, brake force (none), set-point of the wheel servos.
        status (3) [m/s, rad, m/s]: speed_setpoint, steering_setpoint, speed_trim.
        pedals (3) [1]: throttle, brake, gear; only with a wheel_speed of kind pedals, and then there are no forces.

    Parameters of the Context: 0: kp, ki of the speed loop; of the pedals where there are any.

    The outputs are discrete states, updated as often as control.yaml says. With the unior linkages ``steering`` of the
    command and of the status is the input of that robot, as in the full vehicle.

    Args:
        vehicle: a loaded vehicle.
        mass: of the vehicle [kg].
        rotating: what its turning parts add to it [kg].
        delay: from an update until its set-points show [s]; a multiple of the period.

    Raises:
        ConfigError: the delay is negative or not a multiple of the period.
    """

    def __init__(self, vehicle: Vehicle, *, mass: float, rotating: float = 0.0, delay: float = 0.0) -> None:
        super().__init__()
        control, geometry, spec = vehicle.control, vehicle.geometry, vehicle.spec
        self._control, self._period = control, 1.0 / control.rate
        check_number("SingleTrackControl", "delay", delay, unit="s", at_least=0.0)
        self._steps = round(delay / self._period)
        if abs(self._steps * self._period - delay) > 1e-9:
            raise ConfigError(
                f"SingleTrackControl: delay must be a multiple of the period, {self._period:g} s, got {delay:g} s"
            )
        self._true = Ackermann(geometry)
        believed = believed_geometry(geometry, control.believes)
        self._law = make_steering_law(believed, spec.steering.law, factor=spec.steering.factor)
        driven = spec.driven_wheels()
        radius = geometry.front_wheel_radius if spec.drive != "rear" else geometry.rear_wheel_radius
        self._radius = control.believes.wheel_radius or radius
        self._stretch = radius / self._radius  # true over believed speed of the wheels
        self._grip = len(driven) / radius  # force per torque of one wheel
        self._push = mass * self._radius / len(driven)  # torque of one wheel per acceleration
        self._wheel_pid = control.wheel_speed if control.wheel_speed.kind == "pid" else None
        torque = spec.powertrain.max_torque / len(driven)
        if self._wheel_pid is not None:
            torque = self._wheel_pid.max_torque or torque
        self._wheel_limits = PidLimits(-torque, torque)
        self._pedal_law, loop = None, [control.speed.kp, control.speed.ki]
        if control.wheel_speed.kind == "pedals":
            law = make_single_track_law(vehicle, mass=mass, rotating=rotating)
            self._pedal_law = PedalLaw(control.wheel_speed, law, spec, self._period)
            loop = [control.wheel_speed.kp, control.wheel_speed.ki]
        self._actuator = ActuatorLaw(spec.actuators.steering, period=self._period)
        correction = control.speed.max_correction
        self._speed_limits = PidLimits(-correction, correction)
        self._command_limits = CommandLimits(timeout=control.dead_man)

        self.command = declare_vector_input(self, "command", COMMAND)
        self.state = declare_vector_input(self, "state", STATE)
        self.steering_angle = declare_vector_input(self, "steering_angle", STEERING[:1])
        self._table = read_schedule(getattr(control.wheel_speed, "schedule", None))
        self._gains = self.DeclareNumericParameter(BasicVector(loop))
        self._steering = self.DeclareDiscreteState(len(STEERING))
        self._forces = self.DeclareDiscreteState(len(FORCES))
        self._status = self.DeclareDiscreteState(len(STATUS))
        # last message, last speed and steering set-point, speed loop, wheel loop, gear, steering on its way
        rest = self._actuator.rest(0.0)
        self._memory = self.DeclareDiscreteState([*CommandState(), 0.0, 0.0, *PidState(), *PidState(), 1.0, *rest])
        self._late = self.DeclareDiscreteState(self._steps * (len(STEERING) + len(FORCES)))
        self.steering = declare_state_output(self, "steering", STEERING, self._steering)
        if self._pedal_law is None:
            self.forces = declare_state_output(self, "forces", FORCES, self._forces)
        else:
            self.pedals = declare_state_output(self, "pedals", PEDALS, self._forces)
        self.status = declare_state_output(self, "status", STATUS, self._status)
        self.DeclareInitializationDiscreteUpdateEvent(self._initialize)
        self.DeclarePeriodicDiscreteUpdateEvent(self._period, 0.0, self._update)

    def _initialize(self, context: Context, values: DiscreteValues) -> None:
        """Start from the speed and steering angle that the vehicle has, so that nothing jerks."""
        speed = self.state.Eval(context)[_VX].item()
        angle = self.steering_angle.Eval(context).item()
        steering = self._law.bicycle_angle(*self._true.wheel_angles(angle))
        memory = context.get_discrete_state(self._memory).value().tolist()
        memory[_LAST] = speed, steering
        memory[_WAY] = self._actuator.rest(steering)
        now = [angle, 0.0, 0.0, 0.0, speed * self._stretch if self._pedal_law is None else 1.0]
        values.set_value(self._late, now * self._steps)
        values.set_value(self._steering, now[:2])
        values.set_value(self._forces, now[2:])
        values.set_value(self._status, [speed, steering, 0.0])
        values.set_value(self._memory, memory)

    def _update(self, context: Context, values: DiscreteValues) -> None:
        memory = context.get_discrete_state(self._memory).value().tolist()
        period, loop = self._period, self._control.speed
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
        measured = self.state.Eval(context)[_VX].item()

        # Set-points: the slope of the speed and the rate of the steering are limited.
        up, down = loop.max_acceleration * period, loop.max_deceleration * period
        slower, faster = (down, up) if last_speed >= 0.0 else (up, down)
        speed = min(max(wanted.speed, last_speed - slower), last_speed + faster)
        steering = self._law.approach(last_steering, wanted.steering, period=period)
        slope, old = (speed - last_speed) / period, self._angle(memory[_WAY][-1])
        memory[_WAY], actual = self._actuator.step(memory[_WAY], steering)
        angle = self._angle(actual)

        # Speed loop: the pedals, or what acts on the wheels ahead of their servos.
        kp, ki = context.get_numeric_parameter(self._gains).value().tolist()
        if self._pedal_law is not None:
            if self._table is not None:
                now_at = self._table.at(abs(measured))
                kp, ki = now_at.get("kp", kp), now_at.get("ki", ki)
            foot, pedals = self._pedal_law.step(
                PedalState(memory[_GEAR], PidState(*memory[_SPEED])),
                speed,
                slope,
                measured,
                gains=self._pedal_law.gains(kp, ki),
            )
            memory[_GEAR], memory[_SPEED] = foot.gear, foot.loop
            trimmed, acting = speed, list(pedals)
        else:
            trimmed, acting = self._turn_wheels(memory, speed, slope, measured, kp, ki)
        now = [angle, (angle - old) / period, *acting]
        if self._steps:
            late = [*context.get_discrete_state(self._late).value().tolist(), *now]
            now, late = late[: len(now)], late[len(now) :]
            values.set_value(self._late, late)
        memory[_LAST] = speed, steering
        values.set_value(self._steering, now[:2])
        values.set_value(self._forces, now[2:])
        values.set_value(self._status, [speed, steering, trimmed - speed])
        values.set_value(self._memory, memory)

    def _turn_wheels(
        self, memory: list[float], speed: float, slope: float, measured: float, kp: float, ki: float
    ) -> tuple[float, list[float]]:
        """Speed loop and wheel loop, whose memory is changed; trimmed speed [m/s] and the forces."""
        period = self._period
        memory[_SPEED], trimmed = cruise_step(
            PidState(*memory[_SPEED]),
            speed,
            measured,
            period=period,
            gains=PidGains(kp, ki),
            limits=self._speed_limits,
        )
        drive = self._push * slope * self._grip
        if self._wheel_pid is not None:
            loop = self._wheel_pid
            gains = {"kp": loop.kp, "ki": loop.ki, "kd": loop.kd}
            if self._table is not None:
                gains |= self._table.at(abs(measured))
            memory[_WHEEL], torque = pid_step(
                PidState(*memory[_WHEEL]),
                trimmed / self._radius,
                measured / (self._radius * self._stretch),
                gains=PidGains(**gains, filter_time=loop.filter),
                period=period,
                limits=self._wheel_limits,
                feedforward=self._push * slope,
            )
            drive = torque * self._grip
        return trimmed, [drive, 0.0, trimmed * self._stretch]

    def _angle(self, steering: float) -> float:
        """Bicycle angle [rad] of the wheels for a set-point of the steering law."""
        return self._true.bicycle_angle(*self._law.wheel_angles(steering))


def make_single_track_vehicle(
    vehicle: Vehicle,
    *,
    tyres: Tyres = "linear",
    relaxation: bool = False,
    roll: bool = False,
    parameters: SingleTrackParameters | None = None,
    delay: float = 0.0,
) -> Diagram:
    """The single-track model of a vehicle behind its control unit, driven like the full vehicle.

    Input ports of the diagram: command (3). Output ports: state (12), motion (7), status (3), with pedals also
    powertrain_status (9). Its systems are called "single_track" and "control", with pedals also "powertrain". The
    control unit is for floats only; for derivatives take the model alone.

    Args:
        vehicle: a loaded vehicle.
        tyres: "kinematic", "linear" or "brush".
        relaxation: whether slip builds up over the relaxation length.
        roll: whether the body rolls.
        parameters: in place of those of :func:`estimate_parameters`.
        delay: of the actuators [s], a multiple of the period of control.yaml.

    Raises:
        ConfigError: an argument makes no sense.
    """
    parameters = parameters or estimate_parameters(vehicle, roll=roll)
    builder = DiagramBuilder()
    variant = Variant(tyres, relaxation, actuators=True, roll=roll)
    model = builder.AddNamedSystem("single_track", SingleTrack(parameters, variant))
    mass, rotating = parameters.mass, parameters.rotating_mass
    control = builder.AddNamedSystem("control", SingleTrackControl(vehicle, mass=mass, rotating=rotating, delay=delay))
    outputs = {"state": model.state, "motion": model.motion, "status": control.status}
    if control.HasOutputPort("pedals"):
        law = make_single_track_law(vehicle, mass=mass, rotating=rotating)
        powertrain = builder.AddNamedSystem("powertrain", SingleTrackPowertrain(law))
        builder.Connect(control.pedals, powertrain.pedals)
        builder.Connect(model.state, powertrain.state)
        builder.Connect(powertrain.forces, model.forces)
        outputs["powertrain_status"] = powertrain.powertrain_status
    else:
        builder.Connect(control.forces, model.forces)
    builder.Connect(control.steering, model.steering)
    builder.Connect(model.state, control.state)
    builder.Connect(model.steering_angle, control.steering_angle)
    builder.ExportInput(control.command, "command")
    ports = [(port, builder.ExportOutput(port, name)) for name, port in outputs.items()]
    diagram = builder.Build()
    for port, index in ports:
        copy_signals(port, diagram.get_output_port(index))
    diagram.set_name("single_track_vehicle")
    return diagram
