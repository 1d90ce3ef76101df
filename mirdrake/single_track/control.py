"""The control unit of a vehicle, connected to its single-track model.

The laws are those of the full vehicle (:class:`mirdrake.controllers.vehicle_control.ControlUnit`). Drake's servos of
the joints are part of the single-track model with actuators: the steering servo with stiffness k and damping d follows
its set-point with a lag of d/k; the gains of the driven wheels, divided by the radius squared, act between the
set-point of the speed and the speed.

The wheels of the model roll with the car without slip, so that antilock, stability and traction control do not act.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from pydrake.systems.framework import Context, DiscreteValues

from mirdrake.controllers.ackermann import Ackermann
from mirdrake.controllers.control_step import LAST, STEERING_ACTUATOR, ControlSetup
from mirdrake.controllers.joint_blocks import STATUS
from mirdrake.controllers.vehicle_control import ControlUnit, StepResult
from mirdrake.core.checks import check_number, whole_periods
from mirdrake.core.errors import ConfigError
from mirdrake.core.signals import declare_state_output, declare_vector_input
from mirdrake.core.vectors import COMMAND, STATE
from mirdrake.plant.powertrain import PEDALS
from mirdrake.single_track.powertrain import make_single_track_law
from mirdrake.single_track.signals import FORCES, STEERING
from mirdrake.vehicles import Vehicle

_VX = [signal.name for signal in STATE].index("vx")
# State that the step reads: quaternion, velocity, spin rates of four wheels; the steering angles are not used.
_PLACES = {
    "wheel_inputs": (0, 1, 2, 3),
    "steering_inputs": (4, 5),
    "quaternion": 0,
    "velocity": 4,
    "wheel_velocities": (7, 8, 9, 10),
    "steering_positions": (11, 12),
}


class SingleTrackControl(ControlUnit):
    """Control unit of a vehicle, for its single-track model.

    Input ports:
        command (3) [m/s, rad, s]: set-points of the rear axle centre's speed and of the bicycle steering angle, stamp.
        state (12): state of the vehicle.
        steering_angle (1) [rad]: bicycle angle of the model; read at the start only.
    Output ports:
        steering (2) [rad, rad/s]: bicycle angle for the model with actuators, and its rate.
        forces (3) [N, N, m/s]: drive force in addition to the servos, brake force (zero), set-point of the wheel
            servos.
        status (3) [m/s, rad, m/s]: speed_setpoint, steering_setpoint, speed_trim.
        pedals (3) [1]: throttle, brake, gear; in place of the forces if pedals drive the vehicle.

    The outputs are discrete states, updated at the rate of control.yaml. Parameters: see :class:`ControlUnit`. With
    the unior linkages, ``steering`` of the command and of the status is the input of that robot, as in the full
    vehicle.

    Args:
        vehicle: a loaded vehicle.
        mass: mass of the vehicle [kg].
        rotating: equivalent mass of its rotating parts [kg].
        delay: time from an update until the outputs show its result [s]; a multiple of the period.

    Raises:
        ConfigError: the delay is negative or not a multiple of the period.
    """

    def __init__(self, vehicle: Vehicle, *, mass: float, rotating: float = 0.0, delay: float = 0.0) -> None:
        geometry, spec, control = vehicle.geometry, vehicle.spec, vehicle.control
        # Odometry and torques refer to the driven wheels; a wrong assumed radius scales measured speed and set-point.
        self._radius = geometry.front_wheel_radius if spec.drive != "rear" else geometry.rear_wheel_radius
        assumed = control.assumed.wheel_radius or self._radius
        uses_pedals = control.wheel_speed.uses_pedals
        super().__init__(
            vehicle,
            mass=mass,
            radii=(assumed,) * 4,
            driven=(True, False, False, False),  # the first wheel represents all: they roll at the same speed
            places=_PLACES,
            actuators=6,
            powertrain=make_single_track_law(vehicle, mass=mass, rotating=rotating) if uses_pedals else None,
            single_track=True,
        )
        check_number("SingleTrackControl", "delay", delay, unit="s", at_least=0.0)
        # The delay is a shift register that moves once per update, so it must be a whole number of periods.
        steps = whole_periods(delay, self._period)
        if steps is None:
            raise ConfigError(
                f"SingleTrackControl: delay must be a multiple of the period, {self._period:g} s, got {delay:g} s"
            )
        self._delay_steps = steps
        self._true = Ackermann(geometry)
        # The model needs true speeds and forces; the laws of the unit calculate with the assumed radius.
        self._true_over_assumed = self._radius / assumed
        self._force_per_torque = len(spec.driven_wheels()) / self._radius
        self.command = declare_vector_input(self, "command", COMMAND)
        self.state = declare_vector_input(self, "state", STATE)
        self.steering_angle = declare_vector_input(self, "steering_angle", STEERING[:1])
        self._steering = self.DeclareDiscreteState(len(STEERING))
        self._forces = self.DeclareDiscreteState(len(FORCES))  # or pedals, which are three numbers, too
        self._status = self.DeclareDiscreteState(len(STATUS))
        self._memory = self.DeclareDiscreteState(self._start_memory)
        # All waiting outputs in one vector, oldest first: steering and its rate, then forces or pedals.
        self._delayed = self.DeclareDiscreteState(self._delay_steps * (len(STEERING) + len(FORCES)))
        self.steering = declare_state_output(self, "steering", STEERING, self._steering)
        if uses_pedals:
            self.pedals = declare_state_output(self, "pedals", PEDALS, self._forces)
        else:
            self.forces = declare_state_output(self, "forces", FORCES, self._forces)
        self.status = declare_state_output(self, "status", STATUS, self._status)
        self.DeclareInitializationDiscreteUpdateEvent(self._initialize)
        self.DeclarePeriodicDiscreteUpdateEvent(self._period, 0.0, self._update)

    @property
    def constants(self) -> ControlSetup:
        """Constants of the step."""
        return self.setup

    @property
    def radius(self) -> float:
        """True radius of the driven wheels [m]."""
        return self._radius

    @property
    def true_over_assumed(self) -> float:
        """True over assumed radius of the wheels [1]."""
        return self._true_over_assumed

    @property
    def force_per_torque(self) -> float:
        """Drive force over the torque of a driven wheel [1/m]."""
        return self._force_per_torque

    @property
    def true_steering(self) -> Ackermann:
        """Steering law of the true geometry."""
        return self._true

    def starting_memory(self, speed: float, angle: float) -> npt.NDArray[np.float64]:
        """Return the memory of a unit whose set-points are a speed [m/s] and a true bicycle angle [rad]."""
        memory = np.array(self._start_memory)
        steering = self.steering_law.bicycle_angle(*self._true.wheel_angles(angle))
        # Rate limits and filters start from the present set-points, the actuator from the present angle.
        memory[LAST : LAST + 2] = speed, steering
        memory[STEERING_ACTUATOR : STEERING_ACTUATOR + self.setup.actuator_size] = steering
        return memory

    def _read_state(self, context: Context) -> npt.NDArray[np.float64]:
        speed = self.state.Eval(context)[_VX].item()
        # True wheel speed: radii hold the assumed radius, and assumed times true/assumed is the true one.
        rate = speed / (self.setup.radii[0] * self._true_over_assumed)
        return np.array([1.0, 0.0, 0.0, 0.0, speed, 0.0, 0.0, rate, rate, rate, rate, 0.0, 0.0])

    def _initialize(self, context: Context, values: DiscreteValues) -> None:
        """Start from the present speed and steering angle, so that the set-points do not jump."""
        speed = self.state.Eval(context)[_VX].item()
        angle = self.steering_angle.Eval(context).item()
        steering = self.steering_law.bicycle_angle(*self._true.wheel_angles(angle))
        # Third value: set-point of the wheel servos, or the gear (1: drive) where pedals drive the vehicle.
        pedals_or_forces = [0.0, 0.0, speed * self._true_over_assumed if self.pedal_law is None else 1.0]
        now = [angle, 0.0, *pedals_or_forces]
        values.set_value(self._delayed, now * self._delay_steps)
        values.set_value(self._steering, now[:2])
        values.set_value(self._forces, now[2:])
        values.set_value(self._status, [speed, steering, 0.0])
        values.set_value(self._memory, self._start(context, speed, steering))

    def _update(self, context: Context, values: DiscreteValues) -> None:
        memory = context.get_discrete_state(self._memory).value()
        result = self._step(context, self._read_state(context), memory)
        # The rate over one period lets the model's steering lag follow a ramp without a steady error.
        old, angle = self._actual_angle(memory), self._actual_angle(result.memory)
        now = [angle, (angle - old) / self._period, *self._pedals_or_forces(result)]
        # Append the new outputs and take the oldest ones.
        if self._delay_steps:
            waiting = [*context.get_discrete_state(self._delayed).value().tolist(), *now]
            now, waiting = waiting[: len(now)], waiting[len(now) :]
            values.set_value(self._delayed, waiting)
        values.set_value(self._steering, now[:2])
        values.set_value(self._forces, now[2:])
        values.set_value(self._status, result.status)
        values.set_value(self._memory, result.memory)

    def _pedals_or_forces(self, result: StepResult) -> list[float]:
        if result.pedals is not None:
            return list(result.pedals)
        drive = result.actuation[0] * self._force_per_torque
        return [drive, 0.0, result.trimmed * self._true_over_assumed]

    def _actual_angle(self, memory: Sequence[float]) -> float:
        """Return the bicycle angle of the wheels [rad] for the output of the steering actuator."""
        steering = float(memory[STEERING_ACTUATOR + self.setup.actuator_size - 1])
        return self._true.bicycle_angle(*self.steering_law.wheels(self.steering_law.numbers, steering)[0])
