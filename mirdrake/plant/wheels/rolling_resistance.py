"""Rolling resistance of the tyres, in place of the numerical one of discrete hydroelastic contact.

A discrete step of Drake computes the contact patch at the old position and predicts the pressure at the new time.
The centre of pressure of a rolling wheel therefore runs ahead of the axle by about v·dt. The normal load then brakes
the wheel with the moment N·v·dt, many times a tyre's own, shifts load from the front axle to the rear one, and gives
friction forces a lever about the kingpins. The contact results contain what the solver applied. It is therefore
measured and cancelled instead of modelled: per wheel, with the contact surface's centroid C and the wheel centre A,

    M = [(p_C - p_A) × N n + τ_t] · axle,        e = -M / N,

with n the road normal, τ_t the part of the contact torque parallel to the road (on a plane friction has no such
moment about C) and e the distance by which the load acts ahead of the axle. The wheel gets the opposite moments from
outside: -M about its axle and -e (f × F)·n about the vertical, with f the rolling direction and F the road's force.

The remaining moment of the road about the vertical through the wheel centre is turn slip: under Coulomb friction a
patch that follows a curve scrubs with nearly its whole load, where the tread of a tyre bends along; a car on a circle
of 13 m would turn in 2 % too little. For a rolling wheel this is cancelled, too; at standstill it is the friction of
the steering and stays.

M is proportional to N·ω for given step and shape, so their ratio is estimated with a short filter, which averages over
the facets of the wheel, and what is cancelled follows N·ω without lag. At standstill, where the ratio has no meaning,
the measured moment itself is cancelled: it is the restoring moment of a faceted wheel, which would otherwise roll the
car onto a facet.

The contact shape of a tyre with a tyre law does not turn, so it has no such moments
(:func:`mirdrake.plant.plant.add_vehicle`).

The tyre's own moment is -Crr N Re tanh(ω/ω_0), with Re the effective rolling radius, so that the road pushes
back with Crr N: like Coulomb friction, but smooth through standstill. It is also applied as an external moment.
"""

from collections.abc import Collection, MutableSequence, Sequence
from math import exp, tanh
from typing import Any, NamedTuple

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.geometry import GeometryId
from pydrake.multibody.plant import ContactResults, MultibodyPlant
from pydrake.systems.framework import Context, DiscreteValues

from mirdrake.core.compiled import compiled, records
from mirdrake.core.errors import ConfigError
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import Signal, declare_state_output
from mirdrake.plant.plant import VehicleInPlant
from mirdrake.plant.wheels.motion import STEP_PARTS, WheelPlace, base_motion, wheel_motion, wheel_places
from mirdrake.vehicles import WHEELS

FILTER_TIME = 0.1
"""Time constant of the filter for the ratio of the numerical moment to N·ω [s]: several facets at walking pace."""

LOAD_PERIOD = 0.1
"""Sufficient update period where nothing is cancelled, as in point contact [s]: loads change slowly."""

SMOOTH_SPEED = 0.3
"""ω_0: wheel speed below which rolling resistance fades [rad/s], about 0.1 m/s for a car wheel."""


class RollingWheel(NamedTuple):
    """Wheel with rolling resistance.

    Attributes:
        vehicle: name of its vehicle.
        name: its position, for example "front_left".
        geometry: its collision geometry.
        place: position on its vehicle and in the plant's state.
        coefficient: rolling-resistance coefficient Crr of the tyre.
        turning: whether its geometry turns with it; if not, no numerical moment has to be cancelled.
    """

    vehicle: str
    name: str
    geometry: GeometryId
    place: WheelPlace
    coefficient: float
    turning: bool = True


def make_rolling_wheels(part: VehicleInPlant) -> list[RollingWheel]:
    """Return the wheels of a vehicle in a finalised plant."""
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


class RollingSetup(NamedTuple):
    """Settings that all wheels share.

    Attributes:
        positions: number of the plant's positions.
        cancel: whether the numerical resistance is cancelled.
        blend: weight of a new measurement in a filter [1].
    """

    positions: int
    cancel: bool
    blend: float


class TurningWheel(NamedTuple):
    """Numbers of a :class:`RollingWheel`."""

    place: WheelPlace
    coefficient: float
    turning: bool


class Touch(NamedTuple):
    """A contact of a wheel with the road.

    Attributes:
        wheel: number of the wheel.
        patch: 1: a patch; 0: a point, of which only the load is used.
        tx: torque of the road about the centroid of the patch, in the world [N m].
        ty: the same.
        tz: the same.
        fx: force of the road [N].
        fy: the same.
        fz: the same; the road only pushes.
        x: x of the centroid in the world [m].
        y: the same.
    """

    wheel: float
    patch: float
    tx: float
    ty: float
    tz: float
    fx: float
    fy: float
    fz: float
    x: float
    y: float


def rolling_step(
    x: Sequence[float],
    touches: Sequence[Sequence[float]],
    setups: Sequence[RollingSetup],
    wheels: Sequence[TurningWheel],
    filters: MutableSequence[float],
    force: MutableSequence[float],
    loads: MutableSequence[float],
    torques: MutableSequence[float],
) -> None:
    """Compute the rolling resistance of all wheels, in Python or compiled; equations in the head of the module.

    Args:
        x: state of the plant, positions and velocities.
        touches: :class:`Touch` of each contact, or its numbers.
        setups: one.
        wheels: all of them.
        filters: per wheel: filtered M, N·ω, moment about the vertical; changed.
        force: generalised forces of the plant (num_velocities) [N, N m]; zeros, changed.
        loads: loads of the road on each wheel [N]; overwritten.
        torques: about each axle [N m]; overwritten.
    """
    setup = setups[0]
    for i in range(len(wheels)):
        wheel = wheels[i]
        place = wheel.place
        pose = wheel_motion(x, place, base_motion(x, place.base, setup.positions), setup.positions)
        ax, ay, spin = pose.axle[0], pose.axle[1], pose.spin
        load = along = across = moment = yaw = 0.0
        cancelling = setup.cancel and wheel.turning
        # Sum load, friction force and moments of the contacts of this wheel.
        for k in range(len(touches)):
            touch = touches[k]
            if touch[0] != i:
                continue
            tx, ty, tz, fx, fy, fz = touch[2], touch[3], touch[4], touch[5], touch[6], touch[7]
            load += fz
            # Point contact has no patch, hence no numerical moment; only its load is used.
            if touch[1] != 0.0:
                along += fx
                across += fy
                if cancelling:
                    rx, ry = touch[8] - pose.x, touch[9] - pose.y
                    yaw += rx * fy - ry * fx + tz
                    moment += (ry * fz + tx) * ax + (ty - rx * fz) * ay  # r × (0, 0, fz) = (ry, -rx, 0) fz
        # The tyre's own rolling resistance.
        torque = -wheel.coefficient * load * pose.rolling * tanh(spin / SMOOTH_SPEED)
        base = place.base[1]
        if cancelling:
            # Ratio of the numerical moment to N·ω, filtered; below SMOOTH_SPEED the measured moment itself.
            row, blend = 3 * i, setup.blend
            filters[row] += blend * (moment - filters[row])
            filters[row + 1] += blend * (load * spin - filters[row + 1])
            slowly, flow = filters[row], filters[row + 1]
            fading, quick = SMOOTH_SPEED * load, spin / SMOOTH_SPEED
            # Regularised quotient: it tends to zero with N·ω, also for a wheel in the air (0 / 0).
            ratio = slowly * flow / (flow * flow + fading * fading + 1.0)
            # Weight of standstill; the fourth power makes it negligible at three times the smooth speed.
            slow = 1.0 / (1.0 + quick * quick * quick * quick)
            taken = slow * moment + (1.0 - slow) * ratio * load * spin
            torque -= taken
            # Moments about the vertical: lever of the friction force, and turn slip.
            lever = (ay * across + ax * along) / load if load > 0.0 else 0.0  # (f × F)·n / N
            filters[row + 2] += blend * (yaw + moment * lever - filters[row + 2])
            turn = taken * lever - (1.0 - slow) * filters[row + 2]
            force[base + 2] += turn
            # The kingpin is along z of B: a moment about the vertical steers the wheel as well.
            if place.steering[0] >= 0:
                force[place.steering[1]] += turn
        # An external moment: it acts on the spin and, as the joint does not carry it, on the base.
        force[place.spin] += torque
        force[base] += torque * ax
        force[base + 1] += torque * ay
        loads[i], torques[i] = load, torque


class RollingResistance(LeafSystem):
    """Rolling resistance of all wheels of a plant on its ground plane.

    Input ports:
        contact_results: the plant's contact results (abstract).
        plant_state: the plant's state, positions and velocities.
    Output ports:
        generalized_force: value for the plant's applied generalised force (num_velocities) [N, N m].
        wheel_load (4 a vehicle) [N]: normal load of the road on each wheel.
        resistance (4 a vehicle) [N m]: torque applied about each wheel's axle, tyre and cancellation.
        other_contacts (1) [1]: number of contacts of vehicles that are not tyres on the road.

    All outputs are discrete states, updated every `period`.

    Args:
        plant: finalised plant, with its wheels' spin axes along y of their bodies.
        wheels: the wheels.
        ground: geometries of the road plane, whose normal is z of the world.
        scenery: other geometries of the world; their contacts with each other and the road are ignored.
        period: time between updates [s], a multiple of the plant's step.
        cancel_numerical: False keeps the numerical resistance of hydroelastic contact; then, as in point contact,
            :data:`LOAD_PERIOD` is sufficient.
        machine_code: whether :func:`rolling_step` is compiled.

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
        period: float,
        cancel_numerical: bool = True,
        machine_code: bool = False,
    ) -> None:
        super().__init__()
        if not period > 0.0:
            raise ConfigError(f"RollingResistance: period {period} is not allowed; it must be a positive time in s")
        setup = RollingSetup(plant.num_positions(), cancel_numerical, 1.0 - exp(-period / FILTER_TIME))
        # Tables of the compiled step; without machine code the same functions run in Python.
        turning = [TurningWheel(wheel.place, wheel.coefficient, wheel.turning) for wheel in wheels]
        self._machine_code = machine_code
        self._known: Any = ((setup,), turning)
        self._step: Any = rolling_step
        if machine_code:
            self._known = records(RollingSetup, [setup]), records(TurningWheel, turning)
            self._step = compiled(rolling_step, parts=STEP_PARTS)
        self._ground = frozenset(ground)
        self._scenery = self._ground | frozenset(scenery)
        # Contact results name geometries: each wheel is found by that of its tyre.
        self._row = {wheel.geometry: index for index, wheel in enumerate(wheels)}
        self._velocities, self._count = plant.num_velocities(), len(wheels)
        count = self._count
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
        # Contact results are those of the step that has just been solved.
        touches, others = self._measure(context)
        x = self.plant_state.Eval(context)
        filters = context.get_discrete_state(self._filters).value().copy()
        changed: tuple[Any, ...] = (filters, np.zeros(self._velocities), np.zeros(self._count), np.zeros(self._count))
        if self._machine_code:
            self._step(x, np.reshape(touches, (-1, len(Touch._fields))), *self._known, *changed)
        else:  # lists are faster in Python
            changed = tuple(column.tolist() for column in changed)
            self._step(x.tolist(), touches, *self._known, *changed)
        places = (self._filters, self._force, self._load, self._torque)
        for place, values in zip(places, changed, strict=True):
            state.get_mutable_value(place)[:] = values
        state.get_mutable_value(self._others)[:] = others

    def _measure(self, context: Context) -> tuple[list[Sequence[float]], int]:
        """Return the road's contacts with wheels in the last step, and the number of other contacts."""
        results, others = self.contact_results.Eval(context), 0
        touches: list[Sequence[float]] = []
        for k in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(k)
            pair = info.point_pair()
            row = self._wheel_on_road(pair.id_A, pair.id_B)
            if row is not None:
                # The sign depends on which of the two geometries is A.
                load = abs(float(info.contact_force()[2]))
                touches.append((row, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, load, 0.0, 0.0))
            elif self._counts(pair.id_A, pair.id_B):
                others += 1
        for k in range(results.num_hydroelastic_contacts()):
            info = results.hydroelastic_contact_info(k)
            surface = info.contact_surface()
            row = self._wheel_on_road(surface.id_M(), surface.id_N())
            if row is None:
                others += self._counts(surface.id_M(), surface.id_N())
                continue
            # Torque, then force. The road only pushes: of the two opposite wrenches the upward one acts on the wheel.
            wrench = info.F_Ac_W().get_coeffs().tolist()
            upwards = wrench if wrench[5] >= 0.0 else [-value for value in wrench]
            touches.append((row, 1.0, *upwards, *surface.centroid().tolist()[:2]))
        return touches, others

    def _wheel_on_road(self, first: GeometryId, second: GeometryId) -> int | None:
        """Return the number of the wheel if a pair of geometries is a wheel on the road, else None."""
        if first in self._ground:
            return self._row.get(second)
        return self._row.get(first) if second in self._ground else None

    def _counts(self, first: GeometryId, second: GeometryId) -> bool:
        """Return whether two geometries in contact are a vehicle and something that it should not touch."""
        return not (first in self._scenery and second in self._scenery)
