"""Powertrain and brakes of one vehicle as a system between pedals and tyres."""

from collections.abc import Sequence
from math import cos, sin
from typing import TYPE_CHECKING

from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import Context, DiscreteValues, State

from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import declare_state_output, declare_vector_input, signals
from mirdrake.plant.powertrain.law import Measured, PowertrainLaw
from mirdrake.vehicles import WHEELS

if TYPE_CHECKING:
    from mirdrake.plant.plant import VehicleInPlant

RATE = 100.0
"""Update rate [Hz]."""

PEDALS = signals(
    ("throttle", "", "pedal position, 0 released to 1"),
    ("brake", "", "pedal position, 0 released to 1"),
    ("gear", "", "1 drive, 0 neutral, -1 reverse"),
)
WHEEL_TORQUE = signals(
    *((f"drive.{name}", "N m", "torque on the wheel, positive ahead") for name in WHEELS),
    *((f"brake.{name}", "N m", "largest torque of the brake") for name in WHEELS),
)
STATUS = signals(
    ("throttle", "", "pedal position behind its actuator"),
    ("brake", "", "pedal position behind its actuator"),
    ("gear", "", "number of the gear, 0 neutral, -1 reverse"),
    ("motor_speed", "rad/s", "of motor or engine"),
    ("motor_torque", "N m", "of motor or engine"),
    ("drive_power", "W", "at the driven wheels"),
    ("drive_torque", "N m", "of all driven wheels, positive ahead"),
    ("brake_torque", "N m", "of all four brakes"),
    ("interventions", "", "wheels and motors on which antilock, stability or traction control acts"),
)


class Powertrain(LeafSystem):  # type: ignore[misc, unused-ignore]
    """Motor, gears, brakes, and antilock, stability and traction control.

    Input ports:
        pedals (3): :data:`PEDALS`.
        plant_state: the plant's state, positions and velocities.
        rear_steering (4): :data:`mirdrake.plant.rear_steering.REAR_STEERING`, if the vehicle steers its rear wheels.
    Output ports:
        wheel_torque (8) [N m]: :data:`WHEEL_TORQUE`, for the tyres.
        powertrain_status (9): :data:`STATUS`.

    The outputs are discrete states, updated :data:`RATE` times a second. Spin rates, speeds of the wheel centres, yaw
    rate and steering are read from the plant without error.

    Args:
        plant: the finalised plant.
        part: the vehicle in it.
        rate: update rate [Hz].

    Raises:
        ConfigError: a delay of the actuators is not a multiple of the period.
    """

    def __init__(self, plant: MultibodyPlant, part: "VehicleInPlant", *, rate: float = RATE) -> None:
        super().__init__()
        geometry = part.vehicle.geometry
        self.law = make_law(plant, part, rate=rate)
        positions = plant.num_positions()
        self._spins = [positions + joint.velocity_start() for joint in part.wheels]
        # Speeds of the wheel centres are needed for traction control and ABS; they follow from the motion of the body.
        self._angles = [joint.position_start() for joint in part.steering]
        self._quaternion = part.base.floating_positions_start()
        self._velocity = positions + part.base.floating_velocities_start_in_v()
        # Wheel centres in B, x and y; suspension and scrub radius hardly change them.
        self._places = (
            (geometry.wheelbase, 0.5 * geometry.front_track),
            (geometry.wheelbase, -0.5 * geometry.front_track),
            (0.0, 0.5 * geometry.rear_track),
            (0.0, -0.5 * geometry.rear_track),
        )
        self.pedals = declare_vector_input(self, "pedals", PEDALS)
        self.plant_state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
        rear = part.vehicle.spec.steering.rear is not None
        self._rear = self.DeclareVectorInputPort("rear_steering", 2 * 2) if rear else None
        # Torque and status are states: the plant reads them between the updates.
        self._torque = self.DeclareDiscreteState(len(WHEEL_TORQUE))
        self._status = self.DeclareDiscreteState(len(STATUS))
        self._memory = self.DeclareDiscreteState(self.law.rest())
        self.wheel_torque = declare_state_output(self, "wheel_torque", WHEEL_TORQUE, self._torque)
        self.powertrain_status = declare_state_output(self, "powertrain_status", STATUS, self._status)
        self.DeclareInitializationDiscreteUpdateEvent(self._initialize)
        self.DeclarePeriodicUnrestrictedUpdateEvent(1.0 / rate, 0.0, self._update)

    def _initialize(self, context: Context, state: DiscreteValues) -> None:
        """Start in the gear for the present speed, with the pedals released."""
        state.set_value(self._memory, self.law.rest(self._measure(context).speed))

    def _update(self, context: Context, state: State) -> None:
        memory = context.get_discrete_state(self._memory).value().tolist()
        memory, torques = self.law.step(memory, self.pedals.Eval(context).tolist(), self._measure(context))
        values = state.get_mutable_discrete_state()
        values.set_value(self._torque, [*torques.drive, *torques.brake])
        values.set_value(self._status, torques.status)
        values.set_value(self._memory, memory)

    def _measure(self, context: Context) -> Measured:
        x = self.plant_state.Eval(context).tolist()
        rates = [x[index] for index in self._spins]
        left, right = (x[index] for index in self._angles)
        rear = self._rear.Eval(context)[:2].tolist() if self._rear is not None else [0.0, 0.0]
        ahead, aside, yaw_rate = planar_velocity(x[self._quaternion :][:4], x[self._velocity :][:6])
        speeds = []
        for (along, across), angle in zip(self._places, (left, right, *rear), strict=True):
            # Velocity of the wheel centre (rigid body), along the wheel plane turned by the steering angle.
            speeds.append((ahead - yaw_rate * across) * cos(angle) + (aside + yaw_rate * along) * sin(angle))
        # The angle that turns the vehicle is that between the two axles.
        steering = 0.5 * (left + right) - 0.5 * sum(rear)
        return Measured(tuple(rates), tuple(speeds), ahead, yaw_rate, steering)  # type: ignore[arg-type]


def make_law(plant: MultibodyPlant, part: "VehicleInPlant", *, rate: float = RATE) -> PowertrainLaw:
    """Return the powertrain law of a vehicle in a finalised plant, for steps at a rate [Hz]."""
    front, rear = part.rolling_radii(plant)
    return PowertrainLaw(
        part.vehicle.spec,
        radii=(front, front, rear, rear),
        mass=plant.CalcTotalMass(plant.CreateDefaultContext(), [part.instance]),
        wheelbase=part.vehicle.geometry.wheelbase,
        inertias=wheel_inertias(plant, part),
        period=1.0 / rate,
    )


def planar_velocity(quaternion: Sequence[float], velocity: Sequence[float]) -> tuple[float, float, float]:
    """Return the velocity of a body's origin along its x and y axes [m/s], and its yaw rate about its z axis [rad/s].

    Args:
        quaternion: w, x, y, z of its orientation in the world; its norm may have drifted.
        velocity: angular [rad/s], then linear [m/s], in the world.
    """
    w, i, j, k = quaternion
    wx, wy, wz, vx, vy, vz = velocity
    # Division by the squared norm: Drake's quaternions may drift from 1.
    scale = 2.0 / (w * w + i * i + j * j + k * k)
    ahead = vx * (1.0 - (j * j + k * k) * scale) + scale * (vy * (i * j + w * k) + vz * (i * k - w * j))
    aside = vy * (1.0 - (i * i + k * k) * scale) + scale * (vx * (i * j - w * k) + vz * (j * k + w * i))
    yaw_rate = wz * (1.0 - (i * i + j * j) * scale) + scale * (wx * (i * k + w * j) + wy * (j * k - w * i))
    return ahead, aside, yaw_rate


def wheel_inertias(plant: MultibodyPlant, part: "VehicleInPlant") -> list[float]:
    """Return the inertia of each wheel about its axle, with the rotor of its motor [kg m²]."""
    context = plant.CreateDefaultContext()
    inertias = []
    for joint, actuator in zip(part.wheels, part.wheel_actuators, strict=True):
        body = plant.get_body(BodyIndex(joint.child_body().index()))
        axis = joint.frame_on_child().GetFixedPoseInBodyFrame().rotation().multiply(joint.revolute_axis())
        own = body.CalcSpatialInertiaInBodyFrame(context)
        tensor = own.Shift(own.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
        # Reflected through the gear, hence its ratio squared.
        rotor = actuator.default_rotor_inertia() * actuator.default_gear_ratio() ** 2
        inertias.append(float(axis @ tensor @ axis) + rotor)
    return inertias
