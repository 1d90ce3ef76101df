"""Powertrain and brakes of one vehicle as a system between pedals and tyres."""

from collections.abc import MutableSequence, Sequence
from math import cos, sin
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import Context, DiscreteValues, State

from mirdrake.core.compiled import as_arrays, compiled, entry_point
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import declare_state_output, declare_vector_input, signals
from mirdrake.plant.powertrain.brakes import Four
from mirdrake.plant.powertrain.law import (
    STEP_PARTS,
    Assistance,
    Measured,
    PowertrainLaw,
    PowertrainNumbers,
    powertrain_step,
)
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
        machine_code: whether the step is compiled.

    Raises:
        ConfigError: a delay of the actuators is not a multiple of the period.
    """

    def __init__(
        self, plant: MultibodyPlant, part: "VehicleInPlant", *, rate: float = RATE, machine_code: bool = False
    ) -> None:
        super().__init__()
        geometry = part.vehicle.geometry
        self.law, self.period = make_law(plant, part, rate=rate), 1.0 / rate
        positions = plant.num_positions()
        spins = [positions + joint.velocity_start() for joint in part.wheels]
        # Speeds of the wheel centres are needed for traction control and ABS; they follow from the motion of the body.
        # Wheel centres in B, x and y; suspension and scrub radius hardly change them.
        self._places = StatePlaces(
            (spins[0], spins[1], spins[2], spins[3]),
            (part.steering[0].position_start(), part.steering[1].position_start()),
            part.base.floating_positions_start(),
            positions + part.base.floating_velocities_start_in_v(),
            geometry.wheelbase,
            0.5 * geometry.front_track,
            0.5 * geometry.rear_track,
        )
        numbers = as_arrays(self.law.numbers) if machine_code else self.law.numbers
        self._constants = (self._places, numbers, self.law.assistance)
        self._compiled = entry_point(compiled(update, parts=UPDATE_PARTS)) if machine_code else None
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
        measured = measure(self._places, self.plant_state.Eval(context), self._rear_angles(context))
        state.set_value(self._memory, self.law.rest(float(measured.speed)))

    def _update(self, context: Context, state: State) -> None:
        x, rear, pedals = self.plant_state.Eval(context), self._rear_angles(context), self.pedals.Eval(context)
        # The new state begins as a copy of the present one.
        values = state.get_mutable_discrete_state()
        memory, torque, status = (
            values.get_mutable_value(index) for index in (self._memory, self._torque, self._status)
        )
        if self._compiled is not None:
            self._compiled((*self._constants, x, rear, pedals, memory, torque, status))
            return
        # Lists are faster in Python.
        after, torques, shown = memory.tolist(), torque.tolist(), status.tolist()
        update(*self._constants, x.tolist(), rear.tolist(), pedals.tolist(), after, torques, shown)
        memory[:], torque[:], status[:] = after, torques, shown

    def _rear_angles(self, context: Context) -> Any:
        return np.zeros(4) if self._rear is None else self._rear.Eval(context)


class StatePlaces(NamedTuple):
    """Indices of a vehicle's motion in the state of the plant, and places of its wheels.

    Attributes:
        spins: spin rates of the wheels.
        angles: angles of the steering joints, left and right.
        quaternion: orientation of the vehicle frame B.
        velocity: angular, then linear velocity of B.
        wheelbase: [m]
        front: half of the front track [m].
        rear: half of the rear track [m].
    """

    spins: tuple[int, int, int, int]
    angles: tuple[int, int]
    quaternion: int
    velocity: int
    wheelbase: float
    front: float
    rear: float


def update(
    places: StatePlaces,
    numbers: PowertrainNumbers,
    assistance: Assistance,
    x: Sequence[float],
    rear: Sequence[float],
    pedals: Sequence[float],
    memory: MutableSequence[float],
    torque: MutableSequence[float],
    status: MutableSequence[float],
) -> None:
    """Advance the powertrain by one step.

    Args:
        places: where the motion is in `x`.
        numbers: the powertrain.
        assistance: antilock, stability and traction control.
        x: state of the plant.
        rear: angles of the rear wheels [rad], then their rates.
        pedals: throttle, brake and gear.
        memory: memory of the law, changed.
        torque: :data:`WHEEL_TORQUE`, overwritten.
        status: :data:`STATUS`, overwritten.
    """
    measured = measure(places, x, rear)
    torques = powertrain_step(numbers, assistance, memory, pedals[0], pedals[1], pedals[2], measured)
    for i in range(4):
        torque[i], torque[4 + i] = torques.drive[i], torques.brake[i]
    for i in range(len(status)):
        status[i] = torques.status[i]


def measure(places: StatePlaces, x: Sequence[float], rear: Sequence[float]) -> Measured:
    """Return the measured motion of a vehicle; arguments as of :func:`update`."""
    q, v = places.quaternion, places.velocity
    ahead, aside, yaw_rate = planar_velocity(
        (x[q], x[q + 1], x[q + 2], x[q + 3]),
        (x[v], x[v + 1], x[v + 2], x[v + 3], x[v + 4], x[v + 5]),
    )
    left, right = x[places.angles[0]], x[places.angles[1]]
    rates = (x[places.spins[0]], x[places.spins[1]], x[places.spins[2]], x[places.spins[3]])
    speeds: Four = (
        _along_wheel(places.wheelbase, places.front, left, ahead, aside, yaw_rate),
        _along_wheel(places.wheelbase, -places.front, right, ahead, aside, yaw_rate),
        _along_wheel(0.0, places.rear, rear[0], ahead, aside, yaw_rate),
        _along_wheel(0.0, -places.rear, rear[1], ahead, aside, yaw_rate),
    )
    # The angle that turns the vehicle is that between the two axles.
    return Measured(rates, speeds, ahead, yaw_rate, 0.5 * (left + right) - 0.5 * (rear[0] + rear[1]))


def _along_wheel(along: float, across: float, angle: float, ahead: float, aside: float, yaw_rate: float) -> float:
    """Return the velocity of a wheel centre of the rigid body along the wheel plane, turned by the steering angle."""
    return (ahead - yaw_rate * across) * cos(angle) + (aside + yaw_rate * along) * sin(angle)


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


UPDATE_PARTS = (*STEP_PARTS, measure, planar_velocity, _along_wheel, powertrain_step)
"""Functions that are compiled for :func:`update`."""


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
