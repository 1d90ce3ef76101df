"""Rolling resistance: the numerical one of discrete hydroelastic contact out, the tyre's own in.

A discrete step of Drake computes the contact patch at the old position and predicts the pressure at the new time.
The centre of pressure of a rolling wheel therefore runs ahead of the axle by about v·dt. The normal load then brakes
the wheel with the moment N·v·dt, many times a tyre's own, shifts load from the front axle to the rear one, and friction
forces gain a lever about the kingpins. What the solver really applied can be read from the contact results, so it is
measured and cancelled instead of modelled: per wheel, with the contact surface's centroid C and the wheel centre A,

    M = [(p_C - p_A) × N n + τ_t] · axle,        e = -M / N,

with n the road normal, τ_t the part of the contact torque parallel to the road (on a plane friction has no such
moment about C) and e the distance by which the load acts ahead of the axle. The wheel gets the opposite moments from
outside: -M about its axle and -e (f × F)·n about the vertical, with f the rolling direction and F the road's force.

What is left of the road's moment about the vertical through the wheel centre is turn slip: under Coulomb friction a
patch that follows a curve scrubs with nearly its whole load, where the tread of a tyre bends along; a car on a circle
of 13 m would turn in 2 % too little. Of a rolling wheel it is cancelled, too; at standstill it is the steering's
friction and stays.

M is proportional to N·ω for given step and shape, so their ratio is estimated with a short filter, which averages over
the facets of the wheel, and what is cancelled follows N·ω without lag. At standstill, where the ratio has no meaning,
the measured moment itself is cancelled: it is the restoring moment of a faceted wheel, which would otherwise roll the
car onto a facet.

The shape of a tyre with a law of its own does not turn and has none of this (:func:`mirdrake.plant.add_vehicle`).

The tyre's own moment is -Crr N Re tanh(ω/ω_0), with Re the effective rolling radius, so that the road pushes
back with Crr N: Coulomb-like, smooth through standstill. It is a shift of the load, too, and acts from outside.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from math import exp, tanh
from typing import NamedTuple

from pydrake.common.value import AbstractValue
from pydrake.geometry import GeometryId
from pydrake.multibody.plant import ContactResults, MultibodyPlant
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from mirdrake.errors import ConfigError
from mirdrake.plant import VehicleInPlant
from mirdrake.signals import Signal, declare_state_output
from mirdrake.tyres.wheel_motion import WheelMotion, WheelPlace, base_motion, wheel_motion, wheel_places
from mirdrake.vehicles import WHEELS

FILTER_TIME = 0.1
"""Time constant of the estimate of the numerical moment's ratio to N·ω [s]: several facets at walking pace."""

LOAD_PERIOD = 0.1
"""Period that is enough where nothing is cancelled, as in point contact [s]: loads change slowly."""

SMOOTH_SPEED = 0.3
"""ω_0: wheel speed below which rolling resistance fades [rad/s], about 0.1 m/s for a car wheel."""


class RollingWheel(NamedTuple):
    """One wheel as the rolling resistance sees it.

    Attributes:
        vehicle: name of its vehicle.
        name: its place, for example "front_left".
        geometry: its collision geometry.
        place: where it is on its vehicle and in the plant's state.
        coefficient: rolling-resistance coefficient Crr of the tyre.
        turning: whether its geometry turns with it; if not, the solver makes no moment that is to be cancelled.
    """

    vehicle: str
    name: str
    geometry: GeometryId
    place: WheelPlace
    coefficient: float
    turning: bool = True


def make_rolling_wheels(part: VehicleInPlant) -> list[RollingWheel]:
    """The wheels of a vehicle in a finalised plant."""
    return [
        RollingWheel(
            vehicle=part.name,
            name=name,
            geometry=geometry,
            place=place,
            coefficient=part.vehicle.spec.tyres.rolling_resistance,
            turning=not part.tyre_model,
        )
        for name, geometry, place in zip(WHEELS, part.tyres, wheel_places(part), strict=True)
    ]


class RollingResistance(LeafSystem):
    """Rolling resistance of all wheels of a plant on its ground plane.

    Input ports:
        contact_results: the plant's contact results (abstract).
        plant_state: the plant's state, positions and velocities.
    Output ports:
        generalized_force: for the plant's applied generalised force (num_velocities) [N, N m].
        wheel_load (4 a vehicle) [N]: normal load of the road on each wheel.
        resistance (4 a vehicle) [N m]: torque applied about each wheel's axle, tyre and cancellation.
        other_contacts (1) [1]: number of contacts of vehicles that are not tyres on the road.

    All outputs are discrete states, updated every `period`.

    Args:
        plant: finalised plant, with its wheels' spin axes along y of their bodies.
        wheels: the wheels.
        ground: geometries of the road plane, whose normal is z of the world.
        scenery: other geometries of the world; how they touch each other or the road is of no interest.
        bumps: those of them that are made to be driven over.
        period: time between updates [s], a multiple of the plant's step.
        cancel_numerical: False leaves the numerical resistance of hydroelastic contact in place; then, as in point
            contact, :data:`LOAD_PERIOD` is enough.

    Raises:
        ConfigError: the period is not positive.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        wheels: Sequence[RollingWheel],
        *,
        ground: Sequence[GeometryId],
        scenery: Collection[GeometryId] = (),
        bumps: Collection[GeometryId] = (),
        period: float,
        cancel_numerical: bool = True,
    ) -> None:
        super().__init__()
        if not period > 0.0:
            raise ConfigError(f"RollingResistance: period {period} is not allowed; it must be a positive time in s")
        self._wheels = tuple(wheels)
        self._ground, self._bumps = frozenset(ground), frozenset(bumps)
        self._scenery = self._ground | frozenset(scenery)
        self._row = {wheel.geometry: index for index, wheel in enumerate(wheels)}
        self._positions, self._velocities = plant.num_positions(), plant.num_velocities()
        self._cancel = cancel_numerical
        self._blend = 1.0 - exp(-period / FILTER_TIME)
        count = len(wheels)
        self.contact_results = self.DeclareAbstractInputPort("contact_results", AbstractValue.Make(ContactResults()))
        self.plant_state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
        self._force = self.DeclareDiscreteState(self._velocities)
        self._load = self.DeclareDiscreteState(count)
        self._torque = self.DeclareDiscreteState(count)
        self._others = self.DeclareDiscreteState(1)
        self._filters = self.DeclareDiscreteState(3 * count)  # per wheel: filtered M, N·ω, moment about the vertical
        self.generalized_force = self.DeclareStateOutputPort("generalized_force", self._force)
        loads = [Signal(f"{wheel.vehicle}.wheel_load.{wheel.name}", "N", "normal load of the road") for wheel in wheels]
        torques = [
            Signal(f"{wheel.vehicle}.resistance_torque.{wheel.name}", "N m", "about the axle") for wheel in wheels
        ]
        others = [Signal("other_contacts", "", "contacts that are not tyres on the road")]
        self.wheel_load = declare_state_output(self, "wheel_load", loads, self._load)
        self.resistance = declare_state_output(self, "resistance", torques, self._torque)
        self.other_contacts = declare_state_output(self, "other_contacts", others, self._others)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _update(self, context: Context, state: DiscreteValues) -> None:
        x = self.plant_state.Eval(context).tolist()
        poses = self._wheel_motions(x)
        contacts, others = self._measure(context, poses)
        filters = context.get_discrete_state(self._filters).value().tolist()
        force, torques = [0.0] * self._velocities, []
        for i, (wheel, contact, pose) in enumerate(zip(self._wheels, contacts, poses, strict=True)):
            place, load, spin = wheel.place, contact.load, pose.spin
            ax, ay, _ = pose.axle
            torque = -wheel.coefficient * load * pose.rolling * tanh(spin / SMOOTH_SPEED)
            base = place.base[1]
            if self._cancel and wheel.turning:
                row = 3 * i
                filters[row] += self._blend * (contact.moment - filters[row])
                filters[row + 1] += self._blend * (load * spin - filters[row + 1])
                moment, flow = filters[row], filters[row + 1]
                ratio = moment * flow / (flow * flow + (SMOOTH_SPEED * load) ** 2 + 1.0)
                slow = 1.0 / (1.0 + (spin / SMOOTH_SPEED) ** 4)
                moment = slow * contact.moment + (1.0 - slow) * ratio * load * spin
                torque -= moment
                lever = (ay * contact.fy + ax * contact.fx) / load if load > 0.0 else 0.0  # (f × F)·n / N
                filters[row + 2] += self._blend * (contact.yaw + contact.moment * lever - filters[row + 2])
                yaw = moment * lever - (1.0 - slow) * filters[row + 2]
                force[base + 2] += yaw
                if place.steering[0] >= 0:
                    force[place.steering[1]] += yaw
            force[place.spin] += torque
            force[base] += torque * ax
            force[base + 1] += torque * ay
            torques.append(torque)
        state.get_mutable_value(self._load)[:] = [contact.load for contact in contacts]
        state.get_mutable_value(self._others)[:] = others
        state.get_mutable_value(self._force)[:] = force
        state.get_mutable_value(self._torque)[:] = torques
        if self._cancel:
            state.get_mutable_value(self._filters)[:] = filters

    def _measure(self, context: Context, poses: Sequence[WheelMotion]) -> tuple[list["_Contact"], int]:
        """The road's contact with each wheel in the last step, and the number of other contacts."""
        results, others = self.contact_results.Eval(context), 0
        contacts = [_Contact() for _ in self._wheels]
        for k in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(k)
            pair = info.point_pair()
            row = self._wheel_on_road(pair.id_A, pair.id_B)
            if row is not None:
                contacts[row].load += abs(float(info.contact_force()[2]))
            elif self._counts(pair.id_A, pair.id_B):
                others += 1
        for k in range(results.num_hydroelastic_contacts()):
            info = results.hydroelastic_contact_info(k)
            surface = info.contact_surface()
            row = self._wheel_on_road(surface.id_M(), surface.id_N())
            if row is None:
                others += self._counts(surface.id_M(), surface.id_N())
                continue
            contact, pose = contacts[row], poses[row]
            wrench = info.F_Ac_W().get_coeffs().tolist()
            tx, ty, tz, fx, fy, fz = (
                wrench if wrench[5] >= 0.0 else [-value for value in wrench]
            )  # the road only pushes
            contact.load += fz
            contact.fx += fx
            contact.fy += fy
            if self._cancel and self._wheels[row].turning:
                cx, cy, _ = surface.centroid().tolist()
                rx, ry = cx - pose.x, cy - pose.y
                contact.yaw += rx * fy - ry * fx + tz
                ax, ay, _ = pose.axle
                contact.moment += (ry * fz + tx) * ax + (ty - rx * fz) * ay  # r × (0, 0, fz) = (ry, -rx, 0) fz
        return contacts, others

    def _wheel_on_road(self, first: GeometryId, second: GeometryId) -> int | None:
        """Number of the wheel of a pair of geometries that is a wheel on the road, else None."""
        if first in self._ground:
            return self._row.get(second)
        return self._row.get(first) if second in self._ground else None

    def _counts(self, first: GeometryId, second: GeometryId) -> bool:
        """Whether two geometries that touch are a vehicle and something that it should not touch."""
        if first in self._scenery and second in self._scenery:
            return False
        return not (first in self._bumps and second in self._row) and not (second in self._bumps and first in self._row)

    def _wheel_motions(self, x: Sequence[float]) -> list[WheelMotion]:
        """Where every wheel is and how it moves, from the plant's state."""
        places = [wheel.place for wheel in self._wheels]
        bases = {base: base_motion(x, base, self._positions) for base in {place.base for place in places}}
        return [wheel_motion(x, place, bases[place.base], self._positions) for place in places]


@dataclass(slots=True)
class _Contact:
    """The road on one wheel: force in the world [N], pressure moment about the axle, yaw moment [N m]."""

    load: float = 0.0
    fx: float = 0.0
    fy: float = 0.0
    moment: float = 0.0
    yaw: float = 0.0
