"""Tyre forces in the plant: the wheels of a vehicle on their tyres, with drive and brake torques.

Drake's contact computes the normal load, without friction. This system adds all other forces as generalised forces,
from the present state of the plant, so forces follow the motion without delay.

The equations of a step are in :mod:`mirdrake.plant.wheels.step`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.systems.framework import BasicVector, Context, Diagram, DiagramBuilder, DiscreteValues
from pydrake.systems.primitives import ConstantVectorSource, Demultiplexer, Multiplexer, ZeroOrderHold

from mirdrake.core.compiled import Records, compiled, entry_point, record_type, records
from mirdrake.core.constants import GRAVITY
from mirdrake.core.leaf_system import FreeableType, LeafSystem
from mirdrake.core.signals import Signal, copy_signals, declare_vector_input, name_elements
from mirdrake.core.vectors import SIDES
from mirdrake.plant.plant import VehicleInPlant, solves_joints
from mirdrake.plant.rear_steering import REAR_STEERING
from mirdrake.plant.rest_pose import check_balance
from mirdrake.plant.wheel_shape import TREAD
from mirdrake.plant.wheels.arms import NO_ARMS
from mirdrake.plant.wheels.joint_step import JointMemory, StiffJoint
from mirdrake.plant.wheels.motion import wheel_places
from mirdrake.plant.wheels.step import STEP_PARTS, Memory, SpinningCar, SpinningWheel, tyre_step
from mirdrake.plant.wheels.tyre_nodes import TyreCurves
from mirdrake.tyres import SlipTyres, SteadyLaw, TyreLaw
from mirdrake.tyres.coulomb import COULOMB_LAW, DAMPING, make_coulomb_law
from mirdrake.tyres.relaxation import RelaxationSettings
from mirdrake.vehicles import WHEELS
from mirdrake.vehicles.joint_control import ServoGains
from mirdrake.worlds.world import SURFACE_MU

REFERENCE_FRICTION = SURFACE_MU["asphalt"]
"""Coefficient of the ground for which tyre data hold: dry asphalt [1]."""

DAMPING_BY_LOAD = 0.25
"""Damping between contact patch and rim at standstill, over the static load [s/m]; 1000 N s/m for a car's wheel."""

_FRICTION = "friction"  # name of the block with the friction of the ground

FORCES = (
    ("fx", "N", "longitudinal force of the road, positive ahead"),
    ("fy", "N", "lateral force of the road, positive to the left"),
    ("mz", "N m", "aligning moment"),
    ("kappa", "", "longitudinal slip of the tread"),
    ("alpha", "rad", "slip angle of the tread"),
)
"""Logged quantities of each wheel: name, unit, description."""


def make_spinning_wheels(plant: MultibodyPlant, part: VehicleInPlant) -> list[SpinningWheel]:
    """Return the wheels of a vehicle in a finalised plant.

    Raises:
        ConfigError: the vehicle tips over, as its centre of mass is not between its axles.
    """
    tyres, geometry = part.vehicle.spec.tyres, part.vehicle.geometry
    coulomb = not isinstance(tyres, SlipTyres)
    context = plant.CreateDefaultContext()
    plant.SetFloatingBaseBodyPoseInWorldFrame(context, part.base, RigidTransform())
    check_balance(plant, context, part.vehicle, part.instance)
    # Static loads from the moment balance about the axles, half of each for either side.
    share = plant.CalcCenterOfMassPositionInWorld(context, [part.instance])[0] / geometry.wheelbase
    half = 0.5 * plant.CalcTotalMass(context, [part.instance]) * GRAVITY
    wheels = []
    mobility = load_mobility(plant, part)
    product = fastest_bounce(plant, part, mobility) * part.period
    first = min(plant.get_joint_actuator(i).input_start() for i in plant.GetJointActuatorIndices(part.instance))
    for index, (name, wheel_place, joint, actuator, width) in enumerate(
        zip(WHEELS, wheel_places(part), part.wheels, part.wheel_actuators, geometry.wheel_widths, strict=True)
    ):
        rear = index >= 2
        body = joint.child_body()
        inertia = body.CalcSpatialInertiaInBodyFrame(context)
        # Inertia about the centre of mass; the axle is y of the body. Rotor and servo act on the spin as well.
        tensor = inertia.Shift(inertia.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
        # In a continuous plant servo and bearing are solved by the step itself, see ground_step.
        gain = actuator.get_controller_gains().d if actuator.has_controller() else 0.0
        compression = part.compression[rear]
        static_load = float(half * ((1.0 - share) if rear else share))
        settings = RelaxationSettings(
            damping=DAMPING_BY_LOAD * static_load,
            lateral_damping=tyres.lateral_damping if isinstance(tyres, SlipTyres) else 0.0,
            # On the brush of a Coulomb tyre a wheel would oscillate above walking pace: this damping does not fade.
            lasting_damping=DAMPING * static_load if coulomb else 0.0,
        )
        # A Coulomb tyre has the rolling radius of its rest position, whatever its present load.
        if coulomb:
            wheel_place = wheel_place._replace(rolling=geometry.wheel_radii[index] - compression(static_load))
        wheels.append(
            SpinningWheel(
                wheel_place,
                float(tensor[1, 1] + actuator.default_reflected_inertia()),
                float(gain + joint.default_damping()) if solves_joints(plant) else 0.0,
                part.parked,
                geometry.wheel_radii[index],
                compression.stiffness,
                compression.damping,
                part.patches[rear] / (TREAD * width),
                -TREAD * width if name.endswith("right") else TREAD * width,
                wheel_place._replace(arms=NO_ARMS),
                static_load,
                settings,
                width,
                tyres.rolling_resistance,
                coulomb,
                actuator.input_start() - first,
                actuator.effort_limit(),
                tuple(mobility[index].tolist()),
                1.0 / max(4.0 * product * product, 1.0),
            )
        )
    return wheels


def load_mobility(plant: MultibodyPlant, part: VehicleInPlant) -> npt.NDArray[np.float64]:
    """Return the accelerations upwards of the wheels of a vehicle by loads of one newton on each of them (4, 4) [1/kg].

    They are those of a step of a discrete plant: its dampers, of the suspension, are solved implicitly.
    """
    context = plant.CreateDefaultContext()
    plant.SetFloatingBaseBodyPoseInWorldFrame(context, part.base, RigidTransform())
    mass = plant.CalcMassMatrix(context)
    for joint in part.suspension:
        mass[joint.velocity_start(), joint.velocity_start()] += joint.default_damping() * part.period
    world = plant.world_frame()
    rows = [
        plant.CalcJacobianTranslationalVelocity(
            context, JacobianWrtVariable.kV, joint.child_body().body_frame(), np.zeros(3), world, world
        )[2]
        for joint in part.wheels
    ]
    jacobian = np.array(rows)
    return np.asarray(jacobian @ np.linalg.solve(mass, jacobian.T))


def fastest_bounce(plant: MultibodyPlant, part: VehicleInPlant, mobility: npt.NDArray[np.float64]) -> float:
    """Return the highest frequency with which a vehicle and its wheels oscillate on the tyres at rest [rad/s].

    Args:
        plant: finalised.
        part: the vehicle.
        mobility: see :func:`load_mobility`.
    """
    stiffness = [
        tyre.stiffness + 2.0 * tyre.hardening * depth
        for tyre, depth in zip(part.compression, part.rest_compressions(plant), strict=True)
        for _ in SIDES
    ]
    # W K has the eigenvalues ω².
    return float(np.sqrt(np.max(np.linalg.eigvals(mobility * stiffness).real)))


def make_stiff_joints(plant: MultibodyPlant, part: VehicleInPlant) -> list[StiffJoint]:
    """Return the wheels, then the joints of steering and suspension of a vehicle in a finalised continuous plant."""
    context = plant.CreateDefaultContext()
    plant.SetFloatingBaseBodyPoseInWorldFrame(context, part.base, RigidTransform())
    mobility = np.linalg.inv(plant.CalcMassMatrix(context))
    actuators = {
        actuator.joint().index(): actuator
        for actuator in map(plant.get_joint_actuator, plant.GetJointActuatorIndices(part.instance))
    }
    first = min(actuator.input_start() for actuator in actuators.values())
    # Without the rotor of a motor, which spins about another axle or is fixed to the body.
    wheels = [joint.child_body().default_spatial_inertia().CalcRotationalInertia() for joint in part.wheels]
    spins = {joint.index(): float(wheel.get_moments()[1]) for joint, wheel in zip(part.steering, wheels, strict=False)}
    joints = []
    for joint in (*part.wheels, *part.steering, *part.suspension):
        actuator = actuators.get(joint.index())
        gains = part.servos.get(joint.index(), ServoGains(0.0, 0.0))
        velocity = joint.velocity_start()
        joints.append(
            StiffJoint(
                joint.position_start(),
                velocity,
                float(1.0 / mobility[velocity, velocity]),
                float(joint.default_damping_vector()[0]),
                gains.stiffness,
                gains.damping,
                float(joint.position_lower_limits()[0]),
                float(joint.position_upper_limits()[0]),
                -1 if actuator is None else actuator.input_start() - first,
                0.0 if actuator is None else float(actuator.effort_limit()),
                spins.get(joint.index(), 0.0),
            )
        )
    return joints


def wheel_laws(part: VehicleInPlant) -> tuple[SteadyLaw, list[TyreLaw]]:
    """Return the law in steady state of a vehicle's tyres, and the tyre law of each wheel.

    Raises:
        ConfigError: a .tir file is missing or wrong.
    """
    tyres = part.vehicle.spec.tyres
    if isinstance(tyres, SlipTyres):
        axles = tyres.axle_laws(part.vehicle.folder)
        return tyres.law, [axles[index >= 2] for index in range(len(WHEELS))]
    return COULOMB_LAW, [make_coulomb_law(friction, REFERENCE_FRICTION) for friction in part.tyre_mu]


class _Equations(LeafSystem):  # type: ignore[misc, unused-ignore]
    """Equations of a step of the tyres of a vehicle, as one function.

    Each call from Drake into Python takes about as long as the equations, so there is one a step. The rest of a
    :class:`TyreSystem` are blocks of Drake.

    In a discrete plant the solution is an output for the present state of the plant, and the memory is outside of this
    system. In a continuous plant the solution is a state, constant during a step of the plant, with the memory in it;
    servos, dampers and limits of the joints are solved as well.

    Input ports:
        given: state of the plant, prescribed steering of the rear wheels if they are steered, friction of the ground
            under each wheel; in a discrete plant the memory of the wheels, in a continuous one torques and set-points
            of the actuators.
        wheel_torque: as that of :class:`TyreSystem`.
        actuation: the same, in a discrete plant.
    Output ports:
        solution: in a discrete plant generalised forces, then those of `held`.
        force: in a continuous plant, generalised forces.
        net_actuation: the same, torques of the actuators.
        held: the same, memory of the wheels and of the joints, then quantities of :data:`FORCES` of each wheel, torques
            of the rolling resistance, and loads.

    Args:
        plant: finalised plant, its wheels' spin axes along y of their bodies.
        part: the vehicle.
        bearing: what bears the wheels.
    """

    def __init__(self, plant: MultibodyPlant, part: VehicleInPlant, bearing: "Bearing") -> None:
        super().__init__()
        count, record = len(WHEELS), record_type(Memory)
        car = records(SpinningCar, [SpinningCar(part.period, plant.num_positions())])

        # The law, compiled into the step, and the curves of the tyres at their loads.
        law, laws = wheel_laws(part)
        self.step = entry_point(compiled(bearing.step, law.forces, parts=(*bearing.parts, *law.parts)))
        self._tyres = TyreCurves(law, laws, bearing.static_loads)

        # Vectors of the ports are copied to and from arrays of which the arguments of the step are views.
        memory, motors = count * record.itemsize // np.dtype(float).itemsize, plant.num_actuators(part.instance)
        joints = records(StiffJoint, [] if solves_joints(plant) else make_stiff_joints(plant, part))
        of_joints = len(joints) * len(JointMemory._fields)
        rear = len(REAR_STEERING) if part.vehicle.spec.steering.rear is not None else 0
        self.given_sizes = [plant.num_multibody_states(), rear, count]
        self.held_sizes = [memory, count * len(FORCES), count, count]
        if solves_joints(plant):
            self.given_sizes.append(memory)
            self._given, _, _, self._friction, wheels_before = _views(self.given_sizes)
            self._efforts, self._desired = np.zeros(motors), np.zeros(2 * motors)
            self._solution, force, after, logged, resistances, loads = _views(
                [plant.num_velocities(), *self.held_sizes]
            )
            actuation, joints_before, joints_after = (np.zeros(0) for _ in range(3))
        else:
            self.given_sizes += [motors, 2 * motors]
            self.held_sizes[1:1] = [of_joints]
            self._given, _, _, self._friction, self._efforts, self._desired = _views(self.given_sizes)
            held = [sum(self.held_sizes[:2]), sum(self.held_sizes[2:])]
            self._solution, force, actuation, self._kept, _ = _views([plant.num_velocities(), motors, *held])
            self._parts = np.split(self._solution, np.cumsum([len(force), motors]))
            after, joints_after, logged, resistances, loads = np.split(self._parts[2], np.cumsum(self.held_sizes)[:-1])
            self._before, wheels_before, joints_before = _views([memory, of_joints])
            self._joints, self._positions, self._period = joints, plant.num_positions(), part.period
        x = self._given[: plant.num_multibody_states() + rear]
        self._torques = np.zeros(2 * count)
        wheels = (bearing.wheels, *self._tyres.arguments, wheels_before.view(record))
        tyres = (self._torques, self._efforts, self._friction, car, *wheels)
        self._after = after.view(record)
        results: tuple[Any, ...] = (force, self._after, logged.reshape(count, len(FORCES)), resistances, loads)
        if bearing.joints:
            was, will_be = (part.view(record_type(JointMemory)) for part in (joints_before, joints_after))
            results += (self._desired, joints, was, will_be, actuation)
        self._arguments = [(x, *bearing.arguments(again=again), *tyres, *results) for again in (False, True)]

        torques = [Signal(f"{kind}_torque.{name}", "N m") for kind in ("drive", "brake") for name in WHEELS]
        self.given = self.DeclareVectorInputPort("given", sum(self.given_sizes))
        self.wheel_torque = declare_vector_input(self, "wheel_torque", torques)
        if solves_joints(plant):
            self.actuation = self.DeclareVectorInputPort("actuation", motors)
            self.solution = self.DeclareVectorOutputPort("solution", len(self._solution), self._calc)
        else:
            self.actuation = None
            self.force, self.net_actuation, self.held = (
                self.DeclareStateOutputPort(name, self.DeclareDiscreteState(len(part)))
                for name, part in zip(("force", "net_actuation", "held"), self._parts, strict=True)
            )
            self.DeclareInitializationDiscreteUpdateEvent(self._start)
            self.DeclarePeriodicDiscreteUpdateEvent(part.period, 0.0, self._update)

    def _calc(self, context: Context, output: BasicVector) -> None:
        assert self.actuation is not None
        self._given[:] = self.given.Eval(context)
        self._efforts[:] = self.actuation.Eval(context) if self.actuation.HasValue(context) else 0.0
        self._solve(context)
        output.SetFromVector(self._solution)

    def _start(self, context: Context, state: DiscreteValues) -> None:
        """Compute the forces for the outputs before the first step, without memory and without servos."""
        self._before[:] = 0.0
        self._given[:] = self.given.Eval(context)
        # Set-points that the joints have already: the control unit may not have its own yet.
        x, joints = self._given, self._joints
        for joint in joints[joints["actuator"] >= 0]:
            v = x[self._positions + joint["velocity"]]
            self._desired[joint["actuator"]] = x[joint["position"]] + self._period * v
            self._desired[len(self._efforts) + joint["actuator"]] = v
        self._solve(context)
        self._kept[:] = 0.0
        self._write(state)

    def _update(self, context: Context, state: DiscreteValues) -> None:
        # The new state begins as a copy of the present one.
        self._before[:] = state.get_mutable_value(2)[: len(self._before)]
        self._given[:] = self.given.Eval(context)
        self._solve(context)
        self._write(state)

    def _write(self, state: DiscreteValues) -> None:
        for index, part in enumerate(self._parts):
            state.get_mutable_value(index)[:] = part

    def _solve(self, context: Context) -> None:
        """Compute the forces of a step, its memory and its logged quantities."""
        if self.wheel_torque.HasValue(context):
            self._torques[:] = self.wheel_torque.Eval(context)
        else:
            self._torques.fill(0.0)
        first, again = self._arguments
        # The step reports missing curves; they are made in Python, then the step is repeated.
        if not self.step(first):
            self._tyres.make(self._friction.tolist())
            if not self.step(again):  # the state is NaN
                self._solution.fill(np.nan)


def _views(sizes: Sequence[int]) -> tuple[Any, ...]:
    """Return a vector of zeros, then views of its consecutive parts."""
    vector = np.zeros(sum(sizes))
    return (vector, *np.split(vector, np.cumsum(sizes)[:-1]))


@dataclass(frozen=True, kw_only=True)
class Bearing:
    """What bears the wheels of a vehicle: the equations of a step and their arguments.

    Attributes:
        step: equations of a step, a function of a law and of the arguments of :class:`_Equations`.
        parts: functions that `step` calls, without the law.
        wheels: wheels of the vehicle, for `step`.
        static_loads: load of each wheel at rest [N].
        arguments: (whether the step is repeated) -> arguments of `step` of its own.
        joints: whether `step` can solve servos, dampers and limits of joints, which a continuous plant needs.
    """

    step: Callable[..., bool]
    parts: Sequence[Callable[..., Any]]
    wheels: Records
    static_loads: Sequence[float]
    arguments: Callable[..., tuple[Any, ...]]
    joints: bool = False


class TyreSystem(Diagram, metaclass=FreeableType):  # type: ignore[misc, unused-ignore]
    """Forces of the road on the tyres of a vehicle, with drive and brake torques of its wheels.

    Base of the systems for wheels that Drake's contact bears, and for tyres that touch the ground themselves.

    Input ports:
        plant_state: the plant's state, positions and velocities.
        wheel_torque (8) [N m]: drive torques of the wheels, signed, then largest torques of their brakes, not negative;
            zeros if it is not connected.
        actuation: torques of the actuators of the vehicle without their servos [N m]. A discrete plant applies them as
            well; there they are zeros if the port is not connected.
        desired_state: in a continuous plant, set-points of the servos, positions [rad], then velocities [rad/s].
        rear_steering (4): :data:`mirdrake.plant.rear_steering.REAR_STEERING`, if the vehicle steers its rear wheels.
    Output ports:
        generalized_force: value for the plant's applied generalised force (num_velocities) [N, N m]; without delay.
        net_actuation: in a continuous plant, torques of the actuators with their servos, for the plant [N m].
        tyre_forces (20): quantities of :data:`FORCES` for each wheel, of the last step.
        resistance (4) [N m]: torque of the rolling resistance about each axle, of the last step.
        wheel_load (4) [N]: load of each wheel along the normal of the ground, of the last step.

    The friction of the ground under each wheel is a parameter in the Context;
    :class:`mirdrake.plant.wheels.RoadFriction` keeps it up to date.

    Axes and signs are those of :mod:`mirdrake.tyres.magic_formula`, ISO 8855 at the contact centre.

    Args:
        plant: finalised plant, its wheels' spin axes along y of their bodies.
        part: the vehicle.
        bearing: what bears its wheels.
        friction: friction of the ground at the start [1].

    Attributes:
        equations: the system of the equations.
    """

    optional_inputs: tuple[str, ...] = ("wheel_torque", "actuation")

    def __init__(self, plant: MultibodyPlant, part: VehicleInPlant, bearing: Bearing, *, friction: float) -> None:
        super().__init__()
        builder = DiagramBuilder()
        equations = self.equations = _Equations(plant, part, bearing)
        builder.AddNamedSystem("equations", equations)
        ground = np.full(len(WHEELS), friction / REFERENCE_FRICTION)
        road = builder.AddNamedSystem(_FRICTION, ConstantVectorSource(ground))
        # A multiplexer has no input without elements.
        sizes = equations.given_sizes
        given = builder.AddNamedSystem("given", Multiplexer([size for size in sizes if size]))
        steered = int(sizes[1] > 0)
        builder.Connect(road.get_output_port(), given.get_input_port(1 + steered))
        builder.Connect(given.get_output_port(), equations.given)
        last = builder.AddNamedSystem("last", Demultiplexer(equations.held_sizes))
        if solves_joints(plant):
            held = sum(equations.held_sizes)
            split = builder.AddNamedSystem("split", Demultiplexer([plant.num_velocities(), held]))
            builder.Connect(equations.solution, split.get_input_port())
            memory = builder.AddNamedSystem("memory", ZeroOrderHold(part.period, held))
            builder.Connect(split.get_output_port(1), memory.get_input_port())
            builder.Connect(memory.get_output_port(), last.get_input_port())
            builder.Connect(last.get_output_port(0), given.get_input_port(given.num_input_ports() - 1))
            force = split.get_output_port(0)
        else:
            force = equations.force
            builder.Connect(equations.held, last.get_input_port())
        builder.ExportInput(given.get_input_port(0), "plant_state")
        builder.ExportInput(equations.wheel_torque, "wheel_torque")
        count = given.num_input_ports()
        builder.ExportInput(equations.actuation or given.get_input_port(count - 2), "actuation")
        if steered:
            builder.ExportInput(given.get_input_port(1), "rear_steering")
        if equations.actuation is None:
            builder.ExportInput(given.get_input_port(count - 1), "desired_state")
        builder.ExportOutput(force, "generalized_force")
        names = ["tyre_forces", "resistance", "wheel_load"]
        # Behind the memory.
        for index, name in enumerate(names, start=last.num_output_ports() - len(names)):
            builder.ExportOutput(last.get_output_port(index), name)
        if equations.actuation is None:
            builder.ExportOutput(equations.net_actuation, "net_actuation")
        builder.BuildInto(self)

        # BuildInto replaces the contents of the Diagram, so ports can be kept only afterwards.
        self.plant_state, self.wheel_torque, self.actuation = (self.get_input_port(index) for index in range(3))
        self.generalized_force, self.tyre_forces, self.resistance, self.wheel_load = (
            self.get_output_port(index) for index in range(4)
        )
        copy_signals(equations.wheel_torque, self.wheel_torque)
        contents = [(f"tyre_{name}.{wheel}", unit, meaning) for wheel in WHEELS for name, unit, meaning in FORCES]
        torques = [(f"resistance_torque.{wheel}", "N m", "about the axle") for wheel in WHEELS]
        loads = [(f"wheel_load.{wheel}", "N", "normal load") for wheel in WHEELS]
        for port, rows in ((self.tyre_forces, contents), (self.resistance, torques), (self.wheel_load, loads)):
            name_elements(port, [Signal(f"{part.name}.{name}", unit, meaning) for name, unit, meaning in rows])

    def set_friction(self, context: Context, wheel: int, friction: float) -> None:
        """Change the friction of the ground under a wheel.

        Args:
            context: context of this system, changed.
            wheel: its number in :data:`mirdrake.vehicles.WHEELS`.
            friction: coefficient of the ground [1].
        """
        road: ConstantVectorSource = self.GetSubsystemByName(_FRICTION)
        own = self.GetMutableSubsystemContext(road, context)
        road.get_mutable_source_value(own).SetAtIndex(wheel, friction / REFERENCE_FRICTION)

    def friction(self, context: Context) -> npt.NDArray[np.float64]:
        """Return the friction of the ground under each wheel [1].

        Args:
            context: context of this system.
        """
        road: ConstantVectorSource = self.GetSubsystemByName(_FRICTION)
        value = road.get_source_value(self.GetSubsystemContext(road, context)).value()
        return np.array(value) * REFERENCE_FRICTION


class WheelTyres(TyreSystem):
    """Tyre forces of a vehicle whose wheels Drake's contact bears.

    Args:
        plant: finalised plant with a discrete step.
        part: the vehicle.
        friction: friction of the ground at the start [1].

    Raises:
        ConfigError: a .tir file is missing or wrong, or the vehicle tips over.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        part: VehicleInPlant,
        *,
        friction: float = REFERENCE_FRICTION,
    ) -> None:
        spinning = make_spinning_wheels(plant, part)
        bearing = Bearing(
            step=tyre_step,
            parts=STEP_PARTS,
            wheels=records(SpinningWheel, spinning),
            static_loads=[wheel.static_load for wheel in spinning],
            arguments=lambda again: (),  # noqa: ARG005 - the same for a repeated step
        )
        super().__init__(plant, part, bearing, friction=friction)
