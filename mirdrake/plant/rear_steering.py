"""Steering of the rear wheels: angles that an actuator prescribes, in a ratio to the front wheels or from a block.

With the bicycle angles δf and δr of both axles and the wheelbase L, all wheels of a slowly driven vehicle turn about
one point, the distance xr ahead of the rear axle::

    1 / R = (tan δf - tan δr) / L,        xr = -R tan δr

A rear wheel at the lateral distance y from the middle is perpendicular to the line to that point (the Ackermann
geometry of :mod:`mirdrake.controllers.ackermann`, with a steered rear axle): tan δ = tan δr / (1 - y / R).

With a ratio k = δr / δf the steady yaw rate over δf is v (1 - k) / (L + K v²), with the understeer gradient K of the
vehicle. The ratio without side slip of the centre of mass is that of S. Sano, Y. Furukawa, S. Shiraishi, Four wheel
steering system with rear wheel steer angle controlled as a function of steering wheel angle, SAE paper 860625, 1986:
:func:`mirdrake.single_track.zero_side_slip_ratio`.
"""

from math import atan, tan
from typing import TYPE_CHECKING

from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, DiscreteValues

from mirdrake.core.interpolation import read_map
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import declare_state_output, declare_vector_input, signals
from mirdrake.plant.powertrain.actuator import ActuatorLaw
from mirdrake.plant.powertrain.system import RATE, planar_velocity

if TYPE_CHECKING:
    from mirdrake.plant.plant import VehicleInPlant

REAR_STEERING = signals(
    ("steering_angle.rear_left", "rad", "steering angle of the rear wheel, positive to the left"),
    ("steering_angle.rear_right", "rad", "the same"),
    ("steering_rate.rear_left", "rad/s", "rate of this angle"),
    ("steering_rate.rear_right", "rad/s", "the same"),
)
REFERENCE = signals(("rear_steering_reference", "rad", "bicycle angle of the rear axle, in place of the ratio"))


def rear_wheel_angles(front: float, rear: float, *, wheelbase: float, track: float) -> tuple[float, float]:
    """Return the angles of the left and right rear wheel [rad] that turn about one point with the front axle.

    Args:
        front: bicycle angle of the front axle [rad].
        rear: bicycle angle of the rear axle [rad].
        wheelbase: distance of the axles [m].
        track: distance of the rear wheels [m].
    """
    tangent = tan(rear)
    shift = 0.5 * track * (tan(front) - tangent) / wheelbase
    return atan(tangent / (1.0 - shift)), atan(tangent / (1.0 + shift))


def _bicycle_angle(left: float, right: float) -> float:
    """Return the bicycle angle of two wheels [rad]: its cotangent is the mean of theirs."""
    both = tan(left) + tan(right)
    return atan(2.0 * tan(left) * tan(right) / both) if left * right > 0.0 else 0.5 * (left + right)


class RearSteering(LeafSystem):  # type: ignore[misc, unused-ignore]
    """Actuator of the rear steering of a vehicle.

    Input ports:
        plant_state: the plant's state, positions and velocities.
        rear_steering_reference (1) [rad]: bicycle angle of the rear axle; if it is not connected, the angle is that of
            the front wheels times the ratio of vehicle.yaml at the present speed.
    Output ports:
        rear_steering (4): :data:`REAR_STEERING`, for the tyres.

    The output is a discrete state, updated :data:`mirdrake.plant.powertrain.system.RATE` times a second.

    Args:
        plant: the finalised plant.
        part: the vehicle in it.

    Raises:
        ConfigError: the delay of the actuator is not a multiple of the period.
    """

    optional_inputs: tuple[str, ...] = ("rear_steering_reference",)

    def __init__(self, plant: MultibodyPlant, part: "VehicleInPlant") -> None:
        super().__init__()
        spec = part.vehicle.spec.steering.rear
        assert spec is not None
        self._spec, self._geometry = spec, part.vehicle.geometry
        self.period = 1.0 / RATE
        self._actuator = ActuatorLaw(spec.actuator, period=self.period)
        self._angles = [joint.position_start() for joint in part.steering]
        self._quaternion = part.base.floating_positions_start()
        self._velocity = plant.num_positions() + part.base.floating_velocities_start_in_v()
        self.plant_state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
        self.reference = declare_vector_input(self, "rear_steering_reference", REFERENCE)
        self._output = self.DeclareDiscreteState(len(REAR_STEERING))
        self._memory = self.DeclareDiscreteState(self._actuator.rest(0.0))
        self.rear_steering = declare_state_output(self, "rear_steering", REAR_STEERING, self._output)
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / RATE, 0.0, self._update)

    def _update(self, context: Context, state: DiscreteValues) -> None:
        x = self.plant_state.Eval(context).tolist()
        front = _bicycle_angle(*(x[index] for index in self._angles))
        if self.reference.HasValue(context):
            target = float(self.reference.Eval(context)[0])
        else:
            speed, _, _ = planar_velocity(x[self._quaternion :][:4], x[self._velocity :][:6])
            target = read_map(self._spec.ratio, abs(speed)) * front
        target = max(-self._spec.limit, min(self._spec.limit, target))
        memory = context.get_discrete_state(self._memory).value().tolist()
        memory, rear = self._actuator.step(memory, target)
        # The rate is that of the last period; the angle itself is held.
        geometry, last = self._geometry, context.get_discrete_state(self._output).value()
        angles = rear_wheel_angles(front, rear, wheelbase=geometry.wheelbase, track=geometry.rear_track)
        rates = [(angle - before) * RATE for angle, before in zip(angles, last[:2], strict=True)]
        state.set_value(self._output, [*angles, *rates])
        state.set_value(self._memory, memory)
