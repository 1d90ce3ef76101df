"""Tyre forces in the plant: the wheels of a vehicle on tyres with a tyre law, with drive and brake torques.

The contact computes the normal load, without friction. This system adds all other forces as generalised forces, from
the present state of the plant, so forces follow the motion without delay.

The equations of a step are in :mod:`mirdrake.plant.wheels.step`.
"""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from mirdrake.core.compiled import Records, compiled, plain, record_type, records
from mirdrake.core.constants import GRAVITY
from mirdrake.core.leaf_system import LeafSystem, declare_cached_value
from mirdrake.core.signals import Signal, declare_state_output, declare_vector_input
from mirdrake.plant.plant import TyreSpring, VehicleInPlant
from mirdrake.plant.rest_pose import check_balance
from mirdrake.plant.wheels.motion import wheel_places
from mirdrake.plant.wheels.step import STEP_PARTS, Memory, SpinningCar, SpinningWheel, tyre_step
from mirdrake.tyres import SlipTyres, SteadyLaw, TyreLaw
from mirdrake.tyres.relaxation import Contact, RelaxationSettings
from mirdrake.vehicles import WHEELS
from mirdrake.worlds.world import SURFACE_MU

REFERENCE_FRICTION = SURFACE_MU["asphalt"]
"""Coefficient of the ground for which tyre data hold: dry asphalt [1]."""

DAMPING_BY_LOAD = 0.25
"""Damping between contact patch and rim at standstill, over the static load [s/m]; 1000 N s/m for a car's wheel."""

FORCES = (
    ("fx", "N", "longitudinal force of the road, positive ahead"),
    ("fy", "N", "lateral force of the road, positive to the left"),
    ("mz", "N m", "aligning moment"),
    ("kappa", "", "longitudinal slip of the tread"),
    ("alpha", "rad", "slip angle of the tread"),
)
"""Logged quantities of each wheel: name, unit, description."""


def make_spinning_wheels(plant: MultibodyPlant, part: VehicleInPlant) -> list[SpinningWheel]:
    """Return the wheels of a vehicle in a finalised plant; none without a tyre law.

    Raises:
        ConfigError: the vehicle tips over, as its centre of mass is not between its axles.
    """
    tyres = part.vehicle.spec.tyres
    if not isinstance(tyres, SlipTyres):
        return []
    context = plant.CreateDefaultContext()
    plant.SetFloatingBaseBodyPoseInWorldFrame(context, part.base, plant.world_frame().CalcPoseInWorld(context))
    check_balance(plant, context, part.vehicle, part.instance)
    # Static loads from the moment balance about the axles, half of each for either side.
    share = plant.CalcCenterOfMassPositionInWorld(context, [part.instance])[0] / part.vehicle.geometry.wheelbase
    half = 0.5 * plant.CalcTotalMass(context, [part.instance]) * GRAVITY
    wheels = []
    for index, (wheel_place, joint, actuator) in enumerate(
        zip(wheel_places(part), part.wheels, part.wheel_actuators, strict=True)
    ):
        rear = index >= 2
        body = joint.child_body()
        inertia = body.CalcSpatialInertiaInBodyFrame(context)
        # Inertia about the centre of mass; the axle is y of the body. Rotor and servo act on the spin as well.
        tensor = inertia.Shift(inertia.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
        gain = actuator.get_controller_gains().d if actuator.has_controller() else 0.0
        spring = part.compression[rear]
        assert isinstance(spring, TyreSpring)
        static_load = float(half * ((1.0 - share) if rear else share))
        wheels.append(
            SpinningWheel(
                wheel_place,
                float(tensor[1, 1] + actuator.default_reflected_inertia()),
                float(gain + joint.default_damping()),
                part.parked,
                part.vehicle.geometry.wheel_radii[index],
                spring,
                static_load,
                RelaxationSettings(damping=DAMPING_BY_LOAD * static_load, lateral_damping=tyres.lateral_damping),
            )
        )
    return wheels


_MEMORY = record_type(Memory)


class _Solution(NamedTuple):
    force: npt.NDArray[np.float64]  # generalised
    memory: Records
    logged: npt.NDArray[np.float64]


def curve_type(law: SteadyLaw) -> np.dtype[np.void]:
    """Return the record type of a tyre at a load, an inclination and a friction of the ground."""
    fields = [("load", float), ("inclination", float), ("friction", float)]
    return np.dtype([*fields, ("contact", record_type(Contact)), ("curve", record_type(law.curve))], align=True)


class TyreSystem(LeafSystem):  # type: ignore[misc, unused-ignore]
    """Base of the systems that apply the forces of all tyres of a vehicle.

    The derived class has its own inputs and equations (:meth:`_calc`); ports, parameters and states that both contacts
    share are declared here.

    Input ports:
        plant_state: the plant's state, positions and velocities.
        wheel_torque (8) [N m]: drive torques of the wheels, then largest torques of their brakes.
    Output ports:
        generalized_force: value for the plant's applied generalised force (num_velocities) [N, N m].
        tyre_forces (20): quantities of :data:`FORCES` for each wheel, of the last step.

    Args:
        plant: finalised plant with a discrete step.
        part: the vehicle.
        memory: memory of the equations at rest, of one wheel.
        friction: friction of the ground at the start [1].
    """

    optional_inputs: tuple[str, ...] = ("wheel_torque",)

    def __init__(
        self, plant: MultibodyPlant, part: VehicleInPlant, *, memory: Sequence[float], friction: float
    ) -> None:
        super().__init__()
        count = len(WHEELS)
        self._velocities, self._period = plant.num_velocities(), plant.time_step()
        # With the vehicle frame at the origin, world coordinates are those of the vehicle.
        context = plant.CreateDefaultContext()
        plant.SetFloatingBaseBodyPoseInWorldFrame(context, part.base, RigidTransform())
        mass = plant.CalcTotalMass(context, [part.instance])
        centre = tuple(plant.CalcCenterOfMassPositionInWorld(context, [part.instance]).tolist())
        self._car = records(SpinningCar, [SpinningCar(self._period, plant.num_positions(), mass, centre)])
        self._no_torque = np.zeros(2 * count)
        # Drive and brake torques are separate, because brakes cannot turn a wheel backwards.
        torques = [Signal(f"{kind}_torque.{name}", "N m") for kind in ("drive", "brake") for name in WHEELS]
        self.plant_state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
        self.wheel_torque = declare_vector_input(self, "wheel_torque", torques)
        # Friction of each wheel's road, as a parameter that a surface changes while driving.
        self.friction = self.DeclareNumericParameter(BasicVector(np.full(count, friction / REFERENCE_FRICTION)))
        self._memory = self.DeclareDiscreteState(np.tile(memory, count))
        self._logged = self.DeclareDiscreteState(count * len(FORCES))
        # One cache entry for force, memory and log: the output and the update need the same solution of a step.
        self._solution = declare_cached_value(self, "tyre forces", lambda: AbstractValue.Make(object()), self._calc)
        self.generalized_force = self.DeclareVectorOutputPort(
            "generalized_force", self._velocities, self._copy_force, {self._solution.ticket()}
        )
        contents = [
            Signal(f"{part.name}.tyre_{name}.{wheel}", unit, meaning)
            for wheel in WHEELS
            for name, unit, meaning in FORCES
        ]
        self.tyre_forces = declare_state_output(self, "tyre_forces", contents, self._logged)

    def set_friction(self, context: Context, wheel: int, friction: float) -> None:
        """Change the friction of the ground under a wheel.

        Args:
            context: context of this system, changed.
            wheel: its number in :data:`mirdrake.vehicles.WHEELS`.
            friction: coefficient of the ground [1].
        """
        context.get_mutable_numeric_parameter(self.friction).SetAtIndex(wheel, friction / REFERENCE_FRICTION)

    def _copy_force(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._solution.evaluate(context).force)

    @abstractmethod
    def _calc(self, context: Context, result: Any) -> None:
        """Compute the forces of a step, its memory and its logged quantities."""


class WheelTyres(TyreSystem):
    """Forces of the road on the tyres of a vehicle, with drive and brake torques of its wheels.

    Input ports:
        plant_state: the plant's state, positions and velocities.
        wheel_load [N]: normal loads of all wheels of the plant, from :class:`mirdrake.plant.wheels.RollingResistance`.
        wheel_torque (8) [N m]: drive torques of the wheels, signed, then largest torques of their brakes, not negative;
            zeros if it is not connected.
    Output ports:
        generalized_force: value for the plant's applied generalised force (num_velocities) [N, N m]; without
            delay.
        tyre_forces (20): per wheel Fx, Fy [N], Mz [N m], and the slips kappa [1] and alpha [rad] of these forces, of
            the last step.

    Parameters of the Context: 0: friction of the ground under each wheel, relative to dry asphalt (4) [1];
    :class:`mirdrake.plant.wheels.RoadFriction` keeps it up to date.

    Axes and signs are those of :mod:`mirdrake.tyres.magic_formula`, ISO 8855 at the contact centre.

    Args:
        plant: finalised plant with a discrete step, its wheels' spin axes along y of their bodies.
        part: the vehicle.
        wheels: result of :func:`make_spinning_wheels`.
        tyres: tyres of the vehicle.
        loads: number of wheels in the plant.
        first: index of its first wheel among them.
        friction: friction of the ground at the start [1].
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        part: VehicleInPlant,
        wheels: Sequence[SpinningWheel],
        tyres: SlipTyres,
        *,
        loads: int,
        first: int = 0,
        friction: float = REFERENCE_FRICTION,
    ) -> None:
        super().__init__(plant, part, memory=Memory(), friction=friction)
        law, axle_laws = tyres.law, tyres.axle_laws(part.vehicle.folder)
        self._laws: list[TyreLaw] = [axle_laws[index >= 2] for index in range(len(wheels))]
        self._step = compiled(tyre_step, law.forces, parts=(*STEP_PARTS, *law.parts))
        self._wheels = records(SpinningWheel, wheels)
        self._curves = np.zeros(len(wheels), curve_type(law))
        self._curves["load"] = np.nan  # not evaluated yet
        self._first = first
        self.wheel_load = self.DeclareVectorInputPort("wheel_load", loads)
        self.DeclarePeriodicDiscreteUpdateEvent(self._period, 0.0, self._update)

    def _update(self, context: Context, state: DiscreteValues) -> None:
        solution = self._solution.evaluate(context)
        state.get_mutable_value(self._memory)[:] = solution.memory.view(float)
        state.get_mutable_value(self._logged)[:] = solution.logged.ravel()

    def _calc(self, context: Context, result: Any) -> None:
        count = len(self._wheels)
        x = self.plant_state.Eval(context)
        loads = self.wheel_load.Eval(context)[self._first : self._first + count]
        torques = self.wheel_torque.Eval(context) if self.wheel_torque.HasValue(context) else self._no_torque
        frictions = context.get_numeric_parameter(self.friction).value()
        # The state is a vector of floats for Drake, viewed as records without a copy.
        before = context.get_discrete_state(self._memory).value().view(_MEMORY)
        force, memory, logged = np.empty(self._velocities), np.empty_like(before), np.empty((count, len(FORCES)))
        given = (x, loads, torques, frictions, self._car, self._wheels, self._curves, before, force, memory, logged)
        # The step reports loads without a valid curve; curves are made in Python, then the step is repeated.
        if not self._step(*given):
            self._make_curves(memory, frictions)
            if not self._step(*given):  # the state is NaN
                force.fill(np.nan)
                logged.fill(np.nan)
                memory.view(float).fill(np.nan)
        result.set_value(_Solution(force, memory, logged))

    def _make_curves(self, memory: Records, frictions: npt.NDArray[np.float64]) -> None:
        """Evaluate the tyre laws where the loads or inclinations in the memory differ from those of the curves."""
        for i, law in enumerate(self._laws):
            key = float(memory["load"][i]), float(memory["inclination"][i]), float(frictions[i])
            curve = self._curves[i]
            if (curve["load"], curve["inclination"], curve["friction"]) != key:
                tyre = law(*key)
                self._curves[i] = (*key, tyre.contact, plain(tyre.curve))


def make_wheel_tyres(
    plant: MultibodyPlant, part: VehicleInPlant, *, loads: int, first: int, friction: float
) -> WheelTyres | None:
    """Return the tyre forces of a vehicle; None without a tyre law. Arguments as in :class:`WheelTyres`.

    Raises:
        ConfigError: a .tir file is missing or wrong.
    """
    tyres = part.vehicle.spec.tyres
    if not isinstance(tyres, SlipTyres):
        return None
    wheels = make_spinning_wheels(plant, part)
    return WheelTyres(plant, part, wheels, tyres, loads=loads, first=first, friction=friction)
