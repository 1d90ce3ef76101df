"""Rolling resistance: the numerical one of discrete hydroelastic contact out, the tyre's own in.

A discrete step of Drake computes the contact patch at the old position and predicts the pressure at the new time.
The centre of pressure of a rolling wheel therefore runs ahead of the axle by about v·dt. The normal load then brakes
the wheel with the moment N·v·dt, many times a tyre's own, shifts load from the front axle to the rear one, and friction
forces gain a lever about the kingpins. What the solver really applied can be read from the contact results, so it is
measured and cancelled instead of modelled: per wheel, with the contact surface's centroid C and the wheel centre A
where it was when the patch was computed,

    M = [(p_C - (p_A - v_A dt)) × N n + τ_t] · axle,        e = -M / N,

with n the road normal, τ_t the part of the contact torque parallel to the road (on a plane friction has no such
moment about C) and e the distance by which the load acts ahead of the axle. The wheel gets the opposite moments from
outside: -M about its axle and -e (f × F)·n about the vertical, with f the rolling direction and F the force of the road.

What is left of the road's moment about the vertical through the wheel centre is turn slip: under Coulomb friction a
patch that follows a curve scrubs with nearly its whole load, where the tread of a tyre bends along; a car on a circle of
13 m would turn in 2 % too little. Of a rolling wheel it is cancelled, too; at standstill it is the steering's friction
and stays.

M is proportional to N·ω for given step and shape, so their ratio is estimated with a short filter, which averages over
the facets of the wheel, and what is cancelled follows N·ω without lag. At standstill, where the ratio has no meaning,
the measured moment itself is cancelled: it is the restoring moment of a faceted wheel, which would otherwise roll the
car onto a facet.

The tyre's own moment is -Crr N h tanh(ω/ω_0), with h the height of the axle above the road, so that the road pushes
back with Crr N: Coulomb-like, smooth through standstill. It is a shift of the load, too, and acts from outside.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, tanh
from typing import NamedTuple

from pydrake.common.value import AbstractValue
from pydrake.geometry import GeometryId
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import ContactResults, MultibodyPlant
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from mirdrake.errors import ConfigError
from mirdrake.plant import VehicleInPlant
from mirdrake.signals import Signal, declare_state_output
from mirdrake.vehicles import WHEELS

FILTER_TIME = 0.1
"""Time constant of the estimate of the numerical moment's ratio to N·ω [s]: several facets at walking pace."""

SMOOTH_SPEED = 0.3
"""ω_0: wheel speed below which rolling resistance fades [rad/s], about 0.1 m/s for a car wheel."""


class RollingWheel(NamedTuple):
    """One wheel as the rolling resistance sees it.

    Attributes:
        vehicle: name of its vehicle.
        name: its place, for example "front_left".
        geometry: its collision geometry.
        body: index of its body in the plant.
        spin: index of its spin rate in the plant's generalised velocities.
        steering: index of the rate of its steering joint, or None.
        base: index of the three angular velocities of its vehicle's floating base.
        coefficient: rolling-resistance coefficient Crr of the tyre.
    """

    vehicle: str
    name: str
    geometry: GeometryId
    body: int
    spin: int
    steering: int | None
    base: int
    coefficient: float


def make_rolling_wheels(part: VehicleInPlant) -> list[RollingWheel]:
    """The wheels of a vehicle in a finalised plant."""
    return [
        RollingWheel(
            vehicle=part.name,
            name=wheel,
            geometry=tyre,
            body=int(joint.child_body().index()),
            spin=joint.velocity_start(),
            steering=part.steering[i].velocity_start() if i < len(part.steering) else None,
            base=part.base.floating_velocities_start_in_v(),
            coefficient=part.vehicle.spec.tyres.rolling_resistance,
        )
        for i, (wheel, tyre, joint) in enumerate(zip(WHEELS, part.tyres, part.wheels, strict=True))
    ]


class RollingResistance(LeafSystem):  # type: ignore[misc, unused-ignore]
    """Rolling resistance of all wheels of a plant on its ground plane.

    Input ports:
        contact_results: the plant's contact results (abstract).
        body_poses: the plant's body poses (abstract).
        body_spatial_velocities: the plant's body velocities (abstract).
        plant_state: the plant's state, positions and velocities.
    Output ports:
        generalized_force: for the plant's applied generalised force (num_velocities) [N m at the wheels' joints].
        wheel_load: normal load of the road on each wheel (len(wheels)) [N].
        resistance: torque applied about each wheel's axle, tyre and cancellation (len(wheels)) [N m].
        other_contacts (1) [1]: number of contacts that are not tyres on the road.

    All outputs are discrete states, updated every `period`.

    Args:
        plant: finalised plant, with its wheels' spin axes along y of their bodies.
        wheels: the wheels.
        ground: geometries of the road plane, whose normal is z of the world.
        period: time between updates [s], a multiple of the plant's step.
        cancel_numerical: False leaves the numerical resistance of hydroelastic contact in place.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        wheels: Sequence[RollingWheel],
        *,
        ground: Sequence[GeometryId],
        period: float,
        cancel_numerical: bool = True,
    ) -> None:
        super().__init__()
        if not period > 0.0:
            raise ConfigError(f"RollingResistance: period {period} is not allowed; it must be a positive time in s")
        self._wheels = tuple(wheels)
        self._ground = frozenset(ground)
        self._row = {wheel.geometry: index for index, wheel in enumerate(wheels)}
        self._step = plant.time_step()
        self._positions = plant.num_positions()
        self._cancel = cancel_numerical
        self._blend = 1.0 - exp(-period / FILTER_TIME)
        count = len(wheels)
        self.contact_results = self.DeclareAbstractInputPort("contact_results", AbstractValue.Make(ContactResults()))
        self.body_poses = self.DeclareAbstractInputPort("body_poses", AbstractValue.Make([RigidTransform()]))
        self.body_spatial_velocities = self.DeclareAbstractInputPort(
            "body_spatial_velocities", AbstractValue.Make([SpatialVelocity()])
        )
        self.plant_state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
        self._force = self.DeclareDiscreteState(plant.num_velocities())
        self._load = self.DeclareDiscreteState(count)
        self._torque = self.DeclareDiscreteState(count)
        self._moment_filter = self.DeclareDiscreteState(3 * count)  # per wheel: filtered M, N·ω, M_z
        self.generalized_force = self.DeclareStateOutputPort("generalized_force", self._force)
        load = [Signal(f"{wheel.vehicle}.wheel_load.{wheel.name}", "N", "normal load of the road") for wheel in wheels]
        torque = [Signal(f"{wheel.vehicle}.resistance_torque.{wheel.name}", "N m", "torque about the axle") for wheel in wheels]
        self.wheel_load = declare_state_output(self, "wheel_load", load, self._load)
        self.resistance = declare_state_output(self, "resistance", torque, self._torque)
        self._others = self.DeclareDiscreteState(1)
        others = [Signal("other_contacts", "", "contacts that are not tyres on the road")]
        self.other_contacts = declare_state_output(self, "other_contacts", others, self._others)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _update(self, context: Context, state: DiscreteValues) -> None:
        poses = self.body_poses.Eval(context)
        contacts, others = self._measure(context, poses)
        velocities = self.plant_state.Eval(context)[self._positions :].tolist()
        memory = context.get_discrete_state(self._moment_filter).value().tolist()
        force = [0.0] * len(velocities)
        torques = []
        for i, (wheel, contact) in enumerate(zip(self._wheels, contacts, strict=True)):
            load, spin = contact.load, velocities[wheel.spin]
            pose = poses[wheel.body]
            torque = -wheel.coefficient * load * float(pose.translation()[2]) * tanh(spin / SMOOTH_SPEED)
            ax, ay, _ = pose.rotation().matrix()[:, 1].tolist()
            if self._cancel:
                row = 3 * i
                memory[row] += self._blend * (contact.moment - memory[row])
                memory[row + 1] += self._blend * (load * spin - memory[row + 1])
                moment, flow = memory[row], memory[row + 1]
                ratio = moment * flow / (flow * flow + (SMOOTH_SPEED * load) ** 2 + 1.0)
                slow = 1.0 / (1.0 + (spin / SMOOTH_SPEED) ** 4)
                moment = slow * contact.moment + (1.0 - slow) * ratio * load * spin
                torque -= moment
                lever = (ay * contact.fy + ax * contact.fx) / load if load > 0.0 else 0.0  # (f × F)·n / N
                memory[row + 2] += self._blend * (contact.yaw + contact.moment * lever - memory[row + 2])
                yaw = moment * lever - (1.0 - slow) * memory[row + 2]
                force[wheel.base + 2] += yaw
                if wheel.steering is not None:
                    force[wheel.steering] += yaw
            force[wheel.spin] += torque
            force[wheel.base] += torque * ax
            force[wheel.base + 1] += torque * ay
            torques.append(torque)
        state.get_mutable_vector(self._force).SetFromVector(force)
        state.get_mutable_vector(self._load).SetFromVector([contact.load for contact in contacts])
        state.get_mutable_vector(self._torque).SetFromVector(torques)
        state.get_mutable_vector(self._moment_filter).SetFromVector(memory)
        state.get_mutable_vector(self._others).SetFromVector([others])

    def _measure(self, context: Context, poses: Sequence[RigidTransform]) -> tuple[list["_Contact"], int]:
        """The road's contact with each wheel in the last step, and the number of other contacts."""
        results, others = self.contact_results.Eval(context), 0
        contacts = [_Contact() for _ in self._wheels]
        for k in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(k)
            pair = info.point_pair()
            row = self._row.get(pair.id_A, self._row.get(pair.id_B))
            if row is not None and (pair.id_A in self._ground or pair.id_B in self._ground):
                contacts[row].load += abs(float(info.contact_force()[2]))
            else:
                others += 1
        count = results.num_hydroelastic_contacts()
        spatial_velocities = self.body_spatial_velocities.Eval(context) if count and self._cancel else None
        for k in range(count):
            info = results.hydroelastic_contact_info(k)
            surface = info.contact_surface()
            id_M, id_N = surface.id_M(), surface.id_N()
            row = self._row.get(id_M, self._row.get(id_N))
            if row is None or not (id_M in self._ground or id_N in self._ground):
                others += 1
                continue
            contact = contacts[row]
            wrench = info.F_Ac_W()
            sign = 1.0 if id_M in self._row else -1.0  # the force is given on the body of M
            fx, fy, fz = (sign * wrench.translational()).tolist()
            contact.load += fz
            contact.fx += fx
            contact.fy += fy
            if spatial_velocities is None:
                continue
            tx, ty, tz = (sign * wrench.rotational()).tolist()
            cx, cy, _ = surface.centroid().tolist()
            pose = poses[self._wheels[row].body]
            px, py, _ = pose.translation().tolist()
            vx, vy, _ = spatial_velocities[self._wheels[row].body].translational().tolist()
            ax, ay = pose.rotation().matrix()[:2, 1].tolist()
            rx, ry = cx - px + vx * self._step, cy - py + vy * self._step
            contact.yaw += rx * fy - ry * fx + tz
            contact.moment += (ry * fz + tx) * ax + (ty - rx * fz) * ay  # r × (0, 0, fz) = (ry, -rx, 0) fz
        return contacts, others


@dataclass(slots=True)
class _Contact:
    """The road on one wheel: force in the world [N], pressure moment about the axle, moment about the vertical [N m]."""

    load: float = 0.0
    fx: float = 0.0
    fy: float = 0.0
    moment: float = 0.0
    yaw: float = 0.0
