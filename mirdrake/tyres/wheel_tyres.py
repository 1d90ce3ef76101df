"""Tyre forces in the plant: the four wheels of a vehicle on brush or Magic Formula tyres, their motors' torque, brakes.

The contact gives the normal load, its friction is zero, and this system gives the rest as generalised forces, straight
from the plant's state of the moment: there is no step of delay between motion and force.

One step of length dt. The deflections of the tyres are advanced to now with the mean slip velocity of the last step,
and on to its middle, where the law is asked and to which the forces are turned with the car. Between the explicit steps
of the plant this is a leap-frog, which neither damps nor excites a car that rocks on its tyres. Two things of the plant
are of first order and are made up for:

- It turns the car with the yaw rate ψ' of the end of a step, so that the heading runs ahead of the velocity by
  ψ' dt / 2: nothing in a steady turn, but slip that is not there whenever ψ' changes. The velocity v of the car is
  turned along, by the force m v Δψ' / 2 across it.
- It applies the load of the end of a step, which damps the car on its tyres by their stiffness times dt / 2, many times
  what rubber does. The difference to the load in the middle is taken back, in point contact: the stiffness of a patch
  is not known so well, and too much of it would rock the car.

The spin of a wheel is too quick for a leap-frog: 1 kg m² on a slip stiffness of 100 kN swings with 30 Hz, and steps of
10 ms would blow it up. Its change over the step is therefore predicted, linearly implicit::

    (I / dt + h S b) Δω = T + M_drive + M_brake - h {F' + S (κ - κ')},     κ(Δω) = κ + b Δω

with the spin inertia I, the rolling radius h, the secant slip stiffness S = F' / κ' of the step before, b = ∂κ/∂ω at
the middle of the step, and T the torque from elsewhere (servo, bearing, rolling resistance, pitching body), which is
what the last step's change of ω cannot be explained with otherwise. The law is asked at the slip of the middle,
κ + b Δω; this is the trapezoidal rule, stable for every stiffness and of second order. In steady motion Δω is zero,
whatever T is.

The load is measured more rarely than the plant steps, and a moment ago; a friction force that follows it so late would
drive the pitching of a braking car. What the tyre's depth says follows at once, and is kept in proportion with what is
measured. The law is worked out for a load when one is measured that differs by a part in ten thousand; until then
forces and stiffnesses go with the load.

A brake is Coulomb friction: it has the torque with which the wheel would stand still at the end of the step, within
what it can give. A wheel that stands is held by what is needed, exactly, and one that turns gets all of it.

Left out: overturning moment beyond that of the contact (:mod:`mirdrake.wheel_shape`); turn slip (the moment against
steering at standstill is that of the kingpin offset alone).
"""

from collections.abc import Sequence
from math import atan, expm1, inf
from typing import Any, NamedTuple

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem, ValueProducer

from mirdrake.plant import TyreSpring, VehicleInPlant
from mirdrake.rest_pose import check_balance
from mirdrake.signals import Signal, declare_state_output, declare_vector_input
from mirdrake.tyres.relaxation import (
    Contact,
    Deflection,
    Motion,
    RelaxationSettings,
    deflection_step,
    low_speed_weight,
    relaxed_slip,
)
from mirdrake.tyres.wheel_laws import TyreAtLoad, TyreLaw, make_tyre_laws
from mirdrake.tyres.wheel_motion import (
    BaseMotion,
    WheelMotion,
    WheelPlace,
    add_road_force,
    base_motion,
    wheel_motion,
    wheel_places,
)
from mirdrake.vehicles import WHEELS
from mirdrake.worlds.world import GRAVITY, SURFACE_MU

REFERENCE_FRICTION = SURFACE_MU["asphalt"]
"""Coefficient of the ground on which the friction of tyre data holds [1]."""

DAMPING_BY_LOAD = 0.25
"""Damper between patch and rim at standstill over the static load [s/m]; 1000 N s/m for a car's wheel."""

FORCES = (
    ("fx", "N", "force of the road ahead"),
    ("fy", "N", "force of the road to the left"),
    ("mz", "N m", "aligning moment"),
    ("kappa", "", "longitudinal slip of the tread"),
    ("alpha", "rad", "slip angle of the tread"),
)
"""What is told of each wheel: name, unit, meaning."""

_SMALL = 1e-9

_LIFTED = 0.1  # of the static load, below which loads are not compared
_SAME = 1e-4  # relative change of the load, or of the inclination [rad], for which no new curve is made
_BLEND = 0.2  # part of a new comparison that is believed
_TRUST = 3.0  # largest ratio of measured to sprung load that is believed


class SpinningWheel(NamedTuple):
    """A wheel as its tyre sees it.

    Attributes:
        place: where it is on its vehicle and in the plant's state.
        law: of its tyre.
        inertia: what its torque has to turn, rotor of the motor included [kg m²].
        damping: torque that Drake adds implicitly, by spin rate: servo gain and bearing [N m s/rad].
        held: whether a parking brake holds it.
        radius: unloaded [m].
        spring: how it is pressed in under a load.
        static_load: its load at rest [N].
        lateral_damping: of its damper to the side, beside the spring [N s/m].
    """

    place: WheelPlace
    law: TyreLaw
    inertia: float
    damping: float
    held: bool
    radius: float
    spring: TyreSpring
    static_load: float
    lateral_damping: float


def make_spinning_wheels(plant: MultibodyPlant, part: VehicleInPlant) -> list[SpinningWheel]:
    """The wheels of a vehicle in a finalised plant; none if contact friction does it all.

    Raises:
        ConfigError: a .tir file is missing or wrong; the vehicle tips over, as its centre of mass is not between its
            axles.
    """
    laws, tyres = make_tyre_laws(part.vehicle), part.vehicle.spec.tyres
    if laws is None or tyres.kind == "coulomb":
        return []
    context = plant.CreateDefaultContext()
    plant.SetFloatingBaseBodyPoseInWorldFrame(context, part.base, plant.world_frame().CalcPoseInWorld(context))
    check_balance(plant, context, part.vehicle, part.instance)
    share = plant.CalcCenterOfMassPositionInWorld(context, [part.instance])[0] / part.vehicle.geometry.wheelbase
    half = 0.5 * plant.CalcTotalMass(context, [part.instance]) * GRAVITY
    wheels = []
    for index, (place, joint, actuator) in enumerate(
        zip(wheel_places(part), part.wheels, part.wheel_actuators, strict=True)
    ):
        rear = index >= 2
        body = joint.child_body()
        inertia = body.CalcSpatialInertiaInBodyFrame(context)
        tensor = inertia.Shift(inertia.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
        gain = actuator.get_controller_gains().d if actuator.has_controller() else 0.0
        wheels.append(
            SpinningWheel(
                place,
                laws[rear],
                float(tensor[1, 1] + actuator.default_reflected_inertia()),
                float(gain + joint.default_damping()),
                part.parked,
                part.vehicle.geometry.wheel_radii[index],
                part.compression[rear],
                float(half * ((1.0 - share) if rear else share)),
                tyres.lateral_damping,
            )
        )
    return wheels


class _Memory(NamedTuple):
    """What a wheel keeps from step to step."""

    along: float  # deflections [m]
    across: float
    vx: float  # motion of the last step
    slip_x: float
    vy: float
    spin: float
    torque: float  # of motor, brake and force ahead on the spin [N m]
    fx: float  # force and slip of the law
    kappa: float
    measured: float  # load as it came in last [N]; negative: at the start
    ratio: float  # of measured load to that of the spring
    sprung: float  # load of the spring at the end of the step [N]
    load: float  # that the curve is for [N], and the inclination then
    inclination: float
    turning: float  # yaw rate of the car [rad/s]


_START = _Memory(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 1.0, 0.0, 0.0, 0.0, 0.0)
_ROW = len(_START)


class _Solution(NamedTuple):
    force: list[float]  # generalised
    memory: list[float]
    told: list[float]


class WheelTyres(LeafSystem):  # type: ignore[misc, unused-ignore]
    """Forces of the road on the tyres of a vehicle, with drive and brake torques of its wheels.

    Input ports:
        plant_state: the plant's state, positions and velocities.
        wheel_load [N]: normal loads of all wheels of the plant, from :class:`mirdrake.tyres.RollingResistance`.
        wheel_torque (8) [N m]: drive torques of the wheels, signed, then what their brakes can give, not negative;
            zeros if it is not connected.
    Output ports:
        generalized_force: for the plant's applied generalised force (num_velocities) [N, N m]; follows the plant's
            state at once.
        tyre_forces (20): per wheel Fx, Fy [N], Mz [N m], and the slips kappa [1] and alpha [rad] that made them, of the
            last step.

    Parameters of the Context: 0: friction of the ground under each wheel, relative to dry asphalt (4) [1];
    :class:`mirdrake.tyres.RoadFriction` keeps it up to date.

    Axes and signs are those of :mod:`mirdrake.tyres.magic_formula`, ISO 8855 at the contact centre.

    Args:
        plant: finalised plant with a discrete step, its wheels' spin axes along y of their bodies.
        part: the vehicle.
        wheels: of :func:`make_spinning_wheels`.
        loads: number of wheels in the plant.
        first: index of its first wheel among them.
        friction: of the ground at the start [1].
    """

    optional_inputs = ("wheel_torque",)

    def __init__(
        self,
        plant: MultibodyPlant,
        part: VehicleInPlant,
        wheels: Sequence[SpinningWheel],
        *,
        loads: int,
        first: int = 0,
        friction: float = REFERENCE_FRICTION,
    ) -> None:
        super().__init__()
        self._wheels = tuple(wheels)
        self._settings = [
            RelaxationSettings(damping=DAMPING_BY_LOAD * wheel.static_load, lateral_damping=wheel.lateral_damping)
            for wheel in wheels
        ]
        self._positions, self._velocities = plant.num_positions(), plant.num_velocities()
        self._first, self._period = first, plant.time_step()
        context = plant.CreateDefaultContext()
        plant.SetFloatingBaseBodyPoseInWorldFrame(context, part.base, RigidTransform())
        self._mass = plant.CalcTotalMass(context, [part.instance])
        self._centre = plant.CalcCenterOfMassPositionInWorld(context, [part.instance]).tolist()
        self._curves: list[tuple[tuple[float, float, float], TyreAtLoad] | None] = [None] * len(wheels)
        torques = [Signal(f"{kind}_torque.{name}", "N m") for kind in ("drive", "brake") for name in WHEELS]
        self.plant_state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
        self.wheel_load = self.DeclareVectorInputPort("wheel_load", loads)
        self.wheel_torque = declare_vector_input(self, "wheel_torque", torques)
        self.friction = self.DeclareNumericParameter(BasicVector(np.full(len(wheels), friction / REFERENCE_FRICTION)))
        self._memory = self.DeclareDiscreteState(np.tile(_START, len(wheels)))
        self._told = self.DeclareDiscreteState(len(wheels) * len(FORCES))
        self._solution = self.DeclareCacheEntry(
            "tyre forces", ValueProducer(allocate=lambda: AbstractValue.Make(object()), calc=self._calc)
        )
        self.generalized_force = self.DeclareVectorOutputPort(
            "generalized_force", self._velocities, self._copy_force, {self._solution.ticket()}
        )
        contents = [
            Signal(f"{part.name}.tyre_{name}.{wheel}", unit, meaning)
            for wheel in WHEELS
            for name, unit, meaning in FORCES
        ]
        self.tyre_forces = declare_state_output(self, "tyre_forces", contents, self._told)
        self.DeclarePeriodicDiscreteUpdateEvent(self._period, 0.0, self._update)

    def set_friction(self, context: Context, wheel: int, friction: float) -> None:
        """Change the friction of the ground under a wheel.

        Args:
            context: of this system, changed.
            wheel: its number in :data:`mirdrake.vehicles.WHEELS`.
            friction: coefficient of the ground [1].
        """
        context.get_mutable_numeric_parameter(self.friction).SetAtIndex(wheel, friction / REFERENCE_FRICTION)

    def _copy_force(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._solution.Eval(context).force)

    def _update(self, context: Context, state: DiscreteValues) -> None:
        solution = self._solution.Eval(context)
        state.get_mutable_value(self._memory)[:] = solution.memory
        state.get_mutable_value(self._told)[:] = solution.told

    def _calc(self, context: Context, result: Any) -> None:
        x = self.plant_state.Eval(context).tolist()
        loads = self.wheel_load.Eval(context).tolist()[self._first : self._first + len(self._wheels)]
        count = len(self._wheels)
        torques = self.wheel_torque.Eval(context).tolist() if self.wheel_torque.HasValue(context) else [0.0] * 2 * count
        frictions = context.get_numeric_parameter(self.friction).value().tolist()
        kept = context.get_discrete_state(self._memory).value().tolist()
        force, memory, told = [0.0] * self._velocities, [], []
        base = base_motion(x, self._wheels[0].place.base, self._positions)
        for i, wheel in enumerate(self._wheels):
            place, before, period = wheel.place, _Memory(*kept[i * _ROW : (i + 1) * _ROW]), self._period
            motion = wheel_motion(x, place, base, self._positions)
            now = Motion(motion.vx, motion.slip_x, motion.vy)
            start, settings = before.measured < 0.0, self._settings[i]
            load, ratio, sprung = self._load(wheel, motion, before, loads[i])
            known, inclination = before.load, before.inclination
            if start or (
                loads[i] != before.measured
                and (abs(load - known) > _SAME * load or abs(motion.inclination - inclination) > _SAME)
            ):
                known, inclination = load, motion.inclination
            tyre = self._tyre(i, known, inclination, frictions[i])
            scale = load / known if known > 0.0 else 0.0
            stiff_x, stiff_y, length_x, length_y, limit_x, limit_y = tyre.contact
            contact = Contact(stiff_x * scale, stiff_y * scale, length_x, length_y, limit_x * scale, limit_y * scale)

            # Deflections now and in the middle of the step, as if the spin stayed.
            deflection = Deflection(before.along, before.across)
            rest = 0.0
            if not start:
                mean = Motion(
                    0.5 * (before.vx + motion.vx),
                    0.5 * (before.slip_x + motion.slip_x),
                    0.5 * (before.vy + motion.vy),
                )
                deflection = deflection_step(deflection, mean, contact, period=period, settings=settings)
                rest = wheel.inertia * (motion.spin - before.spin) / period - before.torque
            middle = deflection_step(deflection, now, contact, period=0.5 * period, settings=settings)
            kappa, tan_alpha = relaxed_slip(middle, now, contact, settings)

            # How the spin changes.
            drive, brake, radius = torques[i], torques[count + i], motion.rolling
            mobile = inf if wheel.held else wheel.inertia / period + wheel.damping
            if not wheel.held:
                kappa += self._slip_change(
                    before, motion.spin, kappa, contact, now, settings, radius, rest + drive, brake, mobile
                )
            fx, fy, mz = tyre.forces(kappa, tan_alpha, motion.vx)
            fx, fy, mz = scale * fx, scale * fy, scale * mz
            torque = drive
            if brake > 0.0 and not wheel.held:
                needed = radius * fx - mobile * motion.spin - rest - drive
                torque += max(-brake, min(brake, needed))
            upwards = load - ratio * sprung
            add_road_force(force, place, motion, fx, fy, mz, upwards, turn=0.5 * period * base.turning[2])
            force[place.spin] += torque
            own = torque - radius * fx
            memory += [*deflection, *now, motion.spin, own, fx, kappa, loads[i], ratio, sprung, known, inclination]
            memory.append(base.turning[2])
            told += [fx, fy, mz, kappa, atan(tan_alpha)]
        before = _Memory(*kept[:_ROW])
        if before.measured >= 0.0:
            self._turn_along(force, base, base.turning[2] - before.turning)
        result.set_value(_Solution(force, memory, told))

    def _turn_along(self, force: list[float], base: BaseMotion, change: float) -> None:
        """Add the force m v Δψ' / 2 at the centre of mass, to the left of its velocity; see the head of the module."""
        first = self._wheels[0].place.base[1]
        rx, ry, rz = (sum(a * b for a, b in zip(row, self._centre, strict=True)) for row in base.rows)
        rate, push = base.turning[2], 0.5 * self._mass * change
        x, y = -push * (base.velocity[1] + rate * rx), push * (base.velocity[0] - rate * ry)
        for index, part in enumerate((-rz * y, rz * x, rx * y - ry * x, x, y)):
            force[first + index] += part

    def _load(
        self, wheel: SpinningWheel, motion: WheelMotion, before: _Memory, measured: float
    ) -> tuple[float, float, float]:
        """Load of a wheel in the middle of the step, ratio of measured to sprung load, and sprung load at its end."""
        depth = wheel.radius - motion.radius
        sprung = wheel.spring.load(depth + self._period * motion.sink)
        middle = wheel.spring.load(depth) if wheel.spring.power == 1.0 else sprung
        ratio = before.ratio
        if 0.0 <= before.measured != measured and before.sprung > _LIFTED * wheel.static_load:
            ratio += _BLEND * (max(1.0 / _TRUST, min(_TRUST, measured / before.sprung)) - ratio)
        return ratio * middle, ratio, sprung

    def _slip_change(
        self,
        before: _Memory,
        spin: float,
        kappa: float,
        contact: Contact,
        now: Motion,
        settings: RelaxationSettings,
        radius: float,
        torque: float,
        brake: float,
        mobile: float,
    ) -> float:
        """Change of the slip in the middle of the step by the change of the spin; equation in the head of the module.

        Args:
            before: the step before.
            spin: rate now [rad/s].
            kappa: slip if the spin stayed [1].
            contact: the tyre.
            now: motion of the contact point.
            settings: behaviour at low speed.
            radius: of the wheel [m].
            torque: on the spin without brake and road [N m].
            brake: what the brake can give [N m].
            mobile: I / dt [N m s/rad].
        """
        if contact.stiffness_x <= 0.0:
            return 0.0
        passed = 0.5 * self._period * abs(now.vx) / contact.length_x
        share = -expm1(-passed) / passed if passed > _SMALL else 1.0
        damper = settings.damping * low_speed_weight(now.vx, settings.low) / contact.stiffness_x
        slope = 0.5 * radius * (0.5 * self._period * share / contact.length_x + damper)
        stiffness = contact.stiffness_x
        if abs(before.kappa) > _SMALL:
            stiffness = max(0.0, min(stiffness, before.fx / before.kappa))
        inertia = mobile + radius * stiffness * slope
        torque -= radius * (before.fx + stiffness * (kappa - before.kappa))
        if brake > 0.0:
            torque += max(-brake, min(brake, -inertia * spin - torque))
        return float(slope * torque / inertia)

    def _tyre(self, wheel: int, load: float, inclination: float, friction: float) -> TyreAtLoad:
        """The tyre at a load; the last one of each wheel is kept, a pure function of its key."""
        key, known = (load, inclination, friction), self._curves[wheel]
        if known is None or known[0] != key:
            known = (key, self._wheels[wheel].law(*key))
            self._curves[wheel] = known
        return known[1]


def make_wheel_tyres(
    plant: MultibodyPlant, part: VehicleInPlant, *, loads: int, first: int, friction: float
) -> WheelTyres | None:
    """The tyres of a vehicle; None if contact friction does it all. Arguments as of :class:`WheelTyres`.

    Raises:
        ConfigError: a .tir file is missing or wrong.
    """
    wheels = make_spinning_wheels(plant, part)
    return WheelTyres(plant, part, wheels, loads=loads, first=first, friction=friction) if wheels else None
