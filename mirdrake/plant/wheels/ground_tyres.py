"""Tyres that touch the ground themselves (`plant.contact: tyre`), in the plant.

The plant's contact has no wheels on the ground then. Vertical force, slip forces and rolling resistance of a vehicle's
tyres follow from the plant's state and the terrain, without delay; the equations are in
:mod:`mirdrake.plant.wheels.ground_step`.
"""

from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from pydrake.common.value import AbstractValue
from pydrake.geometry import GeometryId
from pydrake.math import RigidTransform
from pydrake.multibody.plant import ContactResults, MultibodyPlant
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from mirdrake.core.compiled import Records, compiled, plain, record_type, records
from mirdrake.core.constants import GRAVITY
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import Signal, declare_state_output, declare_vector_output
from mirdrake.ground import Terrain
from mirdrake.plant.plant import TyreSpring, VehicleInPlant
from mirdrake.plant.rest_pose import check_balance
from mirdrake.plant.wheels.ground_contact import CONTACT_SIZE
from mirdrake.plant.wheels.ground_step import (
    GROUND_STEP_PARTS,
    GroundMemory,
    GroundWheel,
    ground_step,
)
from mirdrake.plant.wheels.motion import wheel_places
from mirdrake.plant.wheels.step import SpinningWheel
from mirdrake.plant.wheels.tyre_forces import DAMPING_BY_LOAD, FORCES, REFERENCE_FRICTION, TyreSystem, curve_type
from mirdrake.tyres import SlipTyres, TyreLaw
from mirdrake.tyres.coulomb import COULOMB_LAW, DAMPING, make_coulomb_law
from mirdrake.tyres.relaxation import RelaxationSettings
from mirdrake.tyres.vertical import VerticalTyre
from mirdrake.vehicles import WHEELS

_LOGGED = len(FORCES) + 2
_MEMORY = record_type(GroundMemory)
_MOST_CURVES = 4096  # curves of a tyre that are kept for reuse


class _Solution(NamedTuple):
    force: npt.NDArray[np.float64]  # generalised
    memory: Records
    logged: npt.NDArray[np.float64]


def make_ground_wheels(plant: MultibodyPlant, part: VehicleInPlant) -> list[GroundWheel]:
    """Return the wheels of a vehicle in a finalised plant.

    Raises:
        ConfigError: the vehicle tips over, as its centre of mass is not between its axles.
    """
    context = plant.CreateDefaultContext()
    plant.SetFloatingBaseBodyPoseInWorldFrame(context, part.base, RigidTransform())
    check_balance(plant, context, part.vehicle, part.instance)
    geometry, tyres = part.vehicle.geometry, part.vehicle.spec.tyres
    # Static loads by the moment balance, half for each side.
    share = plant.CalcCenterOfMassPositionInWorld(context, [part.instance])[0] / geometry.wheelbase
    half = 0.5 * plant.CalcTotalMass(context, [part.instance]) * GRAVITY
    wheels = []
    for index, (wheel_place, joint, actuator) in enumerate(
        zip(wheel_places(part), part.wheels, part.wheel_actuators, strict=True)
    ):
        rear = index >= 2
        # Rotor inertia and servo damping act on the spin like those of the wheel.
        inertia = joint.child_body().CalcSpatialInertiaInBodyFrame(context)
        tensor = inertia.Shift(inertia.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
        gain = actuator.get_controller_gains().d if actuator.has_controller() else 0.0
        load = float(half * ((1.0 - share) if rear else share))
        vertical = part.compression[rear]
        assert isinstance(vertical, VerticalTyre)
        lateral_damping = tyres.lateral_damping if isinstance(tyres, SlipTyres) else 0.0
        # On the brush of a Coulomb tyre a wheel would oscillate above walking pace, so this damping does not fade.
        lasting = 0.0 if isinstance(tyres, SlipTyres) else DAMPING * load
        spinning = SpinningWheel(
            wheel_place,
            float(tensor[1, 1] + actuator.default_reflected_inertia()),
            float(gain + joint.default_damping()),
            part.parked,
            geometry.wheel_radii[index],
            TyreSpring(1.0 / vertical.stiffness, 1.0),
            load,
            RelaxationSettings(
                damping=DAMPING_BY_LOAD * load, lateral_damping=lateral_damping, lasting_damping=lasting
            ),
        )
        # The moment against pivoting is part of the Coulomb law only.
        width, pivots = geometry.wheel_widths[index], not isinstance(tyres, SlipTyres)
        wheels.append(GroundWheel(spinning, vertical, width, tyres.rolling_resistance, pivots))
    return wheels


class GroundTyres(TyreSystem):
    """Forces of the ground on the tyres of a vehicle, with drive and brake torques of its wheels.

    Input ports:
        plant_state: the plant's state, positions and velocities.
        wheel_torque (8) [N m]: drive torques of the wheels, signed, then largest torques of their brakes, not negative;
            zeros if it is not connected.
        actuation: torques of the actuators of the vehicle, which the plant applies [N m]; zeros if it is not connected.
    Output ports:
        generalized_force: value for the plant's applied generalised force (num_velocities) [N, N m]; without delay.
        tyre_forces (20): per wheel Fx, Fy [N], Mz [N m], and the slips kappa [1] and alpha [rad], of the last step.
        wheel_load (4) [N]: force along the normal of the ground, of the last step.
        resistance (4) [N m]: torque of the rolling resistance about each axle, of the last step.

    Parameters of the Context: 0: friction of the ground under each wheel, relative to dry asphalt (4) [1];
    :class:`mirdrake.plant.wheels.RoadFriction` keeps it up to date.

    Args:
        plant: finalised plant with a discrete step, its wheels' spin axes along y of their bodies.
        part: the vehicle.
        terrain: the ground.
        friction: friction of the ground at the start [1].
        rolling_resistance: whether tyres have rolling resistance.
    """

    optional_inputs = ("wheel_torque", "actuation")

    def __init__(
        self,
        plant: MultibodyPlant,
        part: VehicleInPlant,
        terrain: Terrain,
        *,
        friction: float = REFERENCE_FRICTION,
        rolling_resistance: bool = True,
    ) -> None:
        super().__init__(plant, part, memory=GroundMemory(), friction=friction)
        tyres = part.vehicle.spec.tyres
        law, self._laws = _laws(part)
        # The compiled step takes arrays of records.
        wheels = make_ground_wheels(plant, part)
        if not rolling_resistance:
            wheels = [wheel._replace(resistance=0.0) for wheel in wheels]
        self._step = compiled(ground_step, law.forces, parts=(*GROUND_STEP_PARTS, *law.parts))
        self._wheels = records(GroundWheel, wheels)
        self._terrain, self._samples = terrain.data, terrain.samples
        self._curves = np.zeros(len(wheels), curve_type(law))
        self._curves["load"] = np.nan  # not evaluated yet
        self.actuation = self.DeclareVectorInputPort("actuation", plant.num_actuators(part.instance))
        first = min(plant.get_joint_actuator(i).input_start() for i in plant.GetJointActuatorIndices(part.instance))
        self._actuators = [actuator.input_start() - first for actuator in part.wheel_actuators]
        # The plant limits torques to the effort limits; the prediction of the spin must do the same.
        self._limits = np.array([actuator.effort_limit() for actuator in part.wheel_actuators])
        self._contacts = np.zeros((len(wheels), CONTACT_SIZE))
        # Wheels with the same law share their curves.
        known: dict[int, dict[tuple[float, float, float], Any]] = {id(law): {} for law in self._laws}
        self._known = [known[id(law)] for law in self._laws]
        self._loads = self.DeclareDiscreteState(len(wheels))
        self._torques = self.DeclareDiscreteState(len(wheels))
        loads = [Signal(f"{part.name}.wheel_load.{wheel}", "N", "normal load of the ground") for wheel in WHEELS]
        resistances = [Signal(f"{part.name}.resistance_torque.{wheel}", "N m", "about the axle") for wheel in WHEELS]
        self.wheel_load = declare_state_output(self, "wheel_load", loads, self._loads)
        self.resistance = declare_state_output(self, "resistance", resistances, self._torques)
        self.has_law = isinstance(tyres, SlipTyres)
        self.DeclarePeriodicDiscreteUpdateEvent(self._period, 0.0, self._update)

    def _update(self, context: Context, state: DiscreteValues) -> None:
        solution = self._solution.evaluate(context)
        state.get_mutable_value(self._memory)[:] = solution.memory.view(float)
        # The first columns are those of all tyres; load and resistance torque follow.
        logged = solution.logged
        state.get_mutable_value(self._logged)[:] = logged[:, : len(FORCES)].ravel()
        state.get_mutable_value(self._loads)[:] = logged[:, len(FORCES)]
        state.get_mutable_value(self._torques)[:] = logged[:, len(FORCES) + 1]

    def _calc(self, context: Context, result: Any) -> None:
        count = len(self._wheels)
        x = self.plant_state.Eval(context)
        torques = self.wheel_torque.Eval(context) if self.wheel_torque.HasValue(context) else self._no_torque
        frictions = context.get_numeric_parameter(self.friction).value()
        before = context.get_discrete_state(self._memory).value().view(_MEMORY)
        force, memory, logged = np.empty(self._velocities), np.empty_like(before), np.empty((count, _LOGGED))
        efforts = self._no_torque[:count]
        if self.actuation.HasValue(context):
            efforts = np.clip(self.actuation.Eval(context)[self._actuators], -self._limits, self._limits)
        given = (x, self._terrain, self._samples, torques, efforts, frictions, self._car, self._wheels, self._curves)
        kept = (before, self._contacts)
        # The second call keeps the sampled contacts (True) and finds its curves.
        if not self._step(*given, *kept, False, force, memory, logged):
            self._make_curves(memory, frictions)
            if not self._step(*given, *kept, True, force, memory, logged):  # the state is NaN
                force.fill(np.nan)
                logged.fill(np.nan)
                memory.view(float).fill(np.nan)
        result.set_value(_Solution(force, memory, logged))

    def _make_curves(self, memory: Records, frictions: npt.NDArray[np.float64]) -> None:
        """Evaluate the tyre laws where the loads or inclinations in the memory differ from those of the curves."""
        for i, law in enumerate(self._laws):
            node = float(memory["load"][i]), float(memory["inclination"][i]), float(frictions[i])
            curve, known = self._curves[i], self._known[i]
            if (curve["load"], curve["inclination"], curve["friction"]) == node or not np.isfinite(node).all():
                continue
            if node not in known:
                # A bound of memory; curves are cheap to make again.
                if len(known) >= _MOST_CURVES:
                    known.clear()
                tyre = law(*node)
                known[node] = np.array((*node, plain(tyre.contact), plain(tyre.curve)), self._curves.dtype)
            self._curves[i] = known[node]


def _laws(part: VehicleInPlant) -> tuple[Any, list[TyreLaw]]:
    """Return the law in steady state of a vehicle's tyres, and the tyre law of each wheel."""
    tyres = part.vehicle.spec.tyres
    if isinstance(tyres, SlipTyres):
        axles = tyres.axle_laws(part.vehicle.folder)
        return tyres.law, [axles[index >= 2] for index in range(len(WHEELS))]
    return COULOMB_LAW, [make_coulomb_law(friction, REFERENCE_FRICTION) for friction in part.tyre_mu]


class GroundReadings(LeafSystem):  # type: ignore[misc, unused-ignore]
    """Wheel loads and resistances of all vehicles, and contacts of their other parts, for logs and the powertrain.

    Input ports:
        contact_results: the plant's contact results (abstract).
        wheel_load_<vehicle> (4) [N]: of :class:`GroundTyres`, for each vehicle.
        resistance_<vehicle> (4) [N m]: the same.
    Output ports:
        wheel_load (4 a vehicle) [N], resistance (4 a vehicle) [N m]: those of all vehicles.
        other_contacts (1) [1]: number of contacts of vehicles, updated every `period`.

    Args:
        vehicles: names of the vehicles.
        scenery: geometries of the world; their contacts with each other are ignored.
        period: time between two counts of contacts [s].
    """

    def __init__(self, vehicles: Sequence[str], *, scenery: Collection[GeometryId], period: float) -> None:
        super().__init__()
        self._scenery = frozenset(scenery)
        self.contact_results = self.DeclareAbstractInputPort("contact_results", AbstractValue.Make(ContactResults()))
        count = len(WHEELS)
        # One system collects the readings of all vehicles, in the order of the solver's variant.
        self.load_inputs = [self.DeclareVectorInputPort(f"wheel_load_{name}", count) for name in vehicles]
        self.resistance_inputs = [self.DeclareVectorInputPort(f"resistance_{name}", count) for name in vehicles]
        self._others = self.DeclareDiscreteState(1)
        loads = [Signal(f"{name}.wheel_load.{wheel}", "N", "normal load") for name in vehicles for wheel in WHEELS]
        torques = [
            Signal(f"{name}.resistance_torque.{wheel}", "N m", "about the axle")
            for name in vehicles
            for wheel in WHEELS
        ]
        # Bound methods: a function that refers to the ports would keep the diagram alive.
        self.wheel_load = declare_vector_output(
            self, "wheel_load", loads, self._join_loads, prerequisites=[port.ticket() for port in self.load_inputs]
        )
        self.resistance = declare_vector_output(
            self,
            "resistance",
            torques,
            self._join_resistances,
            prerequisites=[port.ticket() for port in self.resistance_inputs],
        )
        others = [Signal("other_contacts", "", "contacts that are not tyres on the road")]
        self.other_contacts = declare_state_output(self, "other_contacts", others, self._others)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _join_loads(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.concatenate([port.Eval(context) for port in self.load_inputs]))

    def _join_resistances(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.concatenate([port.Eval(context) for port in self.resistance_inputs]))

    def _update(self, context: Context, state: DiscreteValues) -> None:
        results = self.contact_results.Eval(context)
        pairs = [results.point_pair_contact_info(k).point_pair() for k in range(results.num_point_pair_contacts())]
        others = sum(not (pair.id_A in self._scenery and pair.id_B in self._scenery) for pair in pairs)
        state.get_mutable_value(self._others)[:] = others
