"""Equations of the single-track model, for floats, AutoDiffXd and symbolic expressions alike.

The model has one wheel at each axle and stays flat on the road. Velocities vx, vy and yaw rate r are those of the
centre of mass in the frame of the vehicle, a and b its distances from the front and the rear axle, δ the steering angle
(R. Rajamani, Vehicle Dynamics and Control, 2nd ed., sections 2.2, 2.3 and 4.1; signs of ISO 8855, left positive)::

    (m + mr) v̇x = Fxf cos δ - Fyf sin δ + Fxr - D + m gx + m r vy
           m v̇y = Fxf sin δ + Fyf cos δ + Fyr + m gy - m r vx
           Iz ṙ = a (Fxf sin δ + Fyf cos δ) - b Fyr

with mr the rotating masses reduced to the road, D = ρ/2 cA |vx - q| (vx - q) the drag with the wind q along the
vehicle, gx and gy gravity along and across it: a slope tilts gravity, as in the full model. Each axle has the velocity
(u, w) along and across its wheels and the slip tan α = w / max(|u|, v1). Its lateral force is -C α (linear), that of
the brush tyre, or that of the Magic Formula::

    |Fy| = P (1 - (1 - min(s, 1))³),    s = C |tan α| / (3 P),    P = sqrt((μ N)² - Fx²)
    |Fy| = P sin(c atan(B - E (B - atan B))),    B = C |tan α| / (c P)

(E. Fiala 1954; H. B. Pacejka, Tyre and Vehicle Dynamics, 3rd ed., sections 3.2.1 and 4.3.2, pure lateral slip; P after
R. Hindiyeh and J. C. Gerdes, J. Dyn. Sys. Meas. Control 136, 2014: drive and brake forces use their share of the
friction first). c and E are shape and curvature factor; the shifts by conicity and ply steer are left out.
N is the static load and the transfer of the tyres' longitudinal forces over the height of the centre of mass. With
relaxation length σ the effective slip follows: d(tan α')/dt = max(|u|, v1) (tan α - tan α') / σ.

With roll the body rolls by φ, to the right in a turn to the left, about an axis along the vehicle; ms is the rolling
mass, h its height over the axis, J its inertia about it, K and D stiffness and damping of springs, bars, dampers and
tyres. vx and vy are then those of the point below the centre of mass in the plane of the road, and the rolling mass
moves out of the turn (Rajamani, section 15.2; W. F. and D. L. Milliken, Race Car Vehicle Dynamics, section 11)::

    m (v̇y + r vx - gy) - ms h φ̈ = Fxf sin δ + Fyf cos δ + Fyr
    J φ̈ = ms h (v̇y + r vx - gy) + e (Fxf sin δ + Fyf cos δ + Fyr) - (K + ms gz h) φ - D φ̇

(gz is negative, e is the overturning moment of the tyres over their lateral force.) The slip of an axle increases by ε
φ, for camber and load transfer; see :mod:`mirdrake.single_track.axles`. The position of the roll axis is in h alone;
the axis is level, and yaw and roll are not coupled by products of inertia.

Low speed. Slip has no meaning at standstill, where tyres become stiff springs. Below the speed v1 the vehicle moves as
a kinematic single track, from v2 on as above; between them both derivatives are blended with a smooth weight of v²::

    v = vx,  r = vx tan δ / L,  vy = b r        reached with the time constant BLEND_TIME
    (m + mr + (m b² + Iz) tan² δ / L²) v̇ = Fxf / cos δ + Fxr - D + m gx + m gy b tan δ / L

The last line is Lagrange's equation of the rolling vehicle at a constant steering angle. The kinematic model is this
alone, at every speed, without BLEND_TIME.

The fastest pole is near (Cf + Cr) / (m v), 40 1/s for a car in the blend: Drake's runge_kutta3 takes steps of 0.02 s.
Stiffer tyres or smaller v1 need shorter ones.

Brakes and rolling resistance oppose the motion with tanh(vx / STANDSTILL_SPEED): a vehicle held on a slope creeps.

The functions branch on flags only, never on values, so that they also take symbolic expressions. For floats
:mod:`mirdrake.core.compiled` compiles them.
"""

from collections.abc import Callable, MutableSequence, Sequence
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from mirdrake.core.compiled import Records, compiled, records
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.maths import Value, absolute, atan, cos, larger, sin, smaller, sqrt, tanh
from mirdrake.single_track.parameters import PARAMETERS
from mirdrake.tyres import TYRES, SlipTyres

BLEND_TIME = 0.05
"""Time constant with which the kinematic relations are reached at low speed [s]."""

STANDSTILL_SPEED = 0.1
"""Speed below which brakes and rolling resistance fade [m/s]; as for the tyres of the full model."""

MAX_LONGITUDINAL_SHARE = 0.98
"""Share of an axle's friction that drive and brake force can use, so that the rest has a derivative [1]."""

MIN_LOAD_SHARE = 0.01
"""Smallest share of the weight on an axle [1]."""

LateralForce = Callable[[Value, Value, Value, Value, Value], Value]
"""(tan α, cornering stiffness [N/rad], largest force [N], shape factor, curvature factor) -> lateral force [N]."""


class Variant(NamedTuple):
    """Equations of a model.

    Attributes:
        tyres: "kinematic", "linear", or a kind of tyres with a lateral force for this model, as "brush".
        relaxation: whether the slip of each axle is a state; not for the kinematic model.
        actuators: whether the steering angle is a state and a servo holds the speed.
        roll: whether roll angle and roll rate are states; not for the kinematic model.
    """

    tyres: str = "linear"
    relaxation: bool = False
    actuators: bool = False
    roll: bool = False

    def check(self) -> None:
        """Check the combination of equations.

        Raises:
            ConfigError: unknown tyres, or relaxation or roll without tyres.
        """
        allowed = ["kinematic", *lateral_forces()]
        if self.tyres not in allowed:
            raise ConfigError(f"SingleTrack: unknown tyres '{self.tyres}'; {did_you_mean(self.tyres, allowed)}")
        if self.relaxation and self.tyres == "kinematic":
            raise ConfigError("SingleTrack: kinematic tyres have no slip; leave out relaxation, or use linear tyres")
        if self.roll and self.tyres == "kinematic":
            raise ConfigError("SingleTrack: the kinematic model has no forces; leave out roll, or use linear tyres")

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the continuous states, in the order of the Context; SI units."""
        names: tuple[str, ...] = ("x", "y", "yaw", "vx")
        if self.tyres != "kinematic":
            names += ("vy", "yaw_rate")
            names += ("front_slip", "rear_slip") if self.relaxation else ()
            names += ("roll", "roll_rate") if self.roll else ()
        return names + (("steering",) if self.actuators else ())

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs, in their order; SI units."""
        return Inputs._fields if self.actuators else Inputs._fields[:3]


class Flags(NamedTuple):
    """Variant as flags, for compiled functions.

    Attributes:
        kinematic: whether the wheels roll without slip.
        saturates: whether friction limits the tyre forces.
        relaxation: as in :class:`Variant`, like the next two.
        actuators: see there.
        roll: see there.
    """

    kinematic: bool
    saturates: bool
    relaxation: bool
    actuators: bool
    roll: bool


class State(NamedTuple):
    """States of all variants; those that a variant does not have are zero.

    Attributes:
        x: position of the vehicle frame (rear axle centre) [m].
        y: the same [m].
        yaw: heading [rad].
        vx: longitudinal velocity of the centre of mass [m/s].
        vy: lateral velocity of the centre of mass [m/s].
        yaw_rate: r [rad/s].
        front_slip: effective slip tan α' of the front axle [1].
        rear_slip: the same at the rear [1].
        roll: φ [rad].
        roll_rate: its rate [rad/s].
        steering: steering angle [rad].
    """

    x: Value = 0.0
    y: Value = 0.0
    yaw: Value = 0.0
    vx: Value = 0.0
    vy: Value = 0.0
    yaw_rate: Value = 0.0
    front_slip: Value = 0.0
    rear_slip: Value = 0.0
    roll: Value = 0.0
    roll_rate: Value = 0.0
    steering: Value = 0.0


class Inputs(NamedTuple):
    """Inputs; the last two are for actuators.

    Attributes:
        steering: steering angle, or its set-point with actuators [rad].
        drive: drive force at the road [N].
        brake: brake force at the road [N], positive.
        steering_rate: rate of the set-point [rad/s].
        speed: set-point of the wheel servos [m/s].
    """

    steering: Value = 0.0
    drive: Value = 0.0
    brake: Value = 0.0
    steering_rate: Value = 0.0
    speed: Value = 0.0


class Motion(NamedTuple):
    """Handling quantities; slips and forces are zero in the kinematic model.

    Attributes:
        sideslip: sideslip angle of the centre of mass [rad].
        longitudinal_acceleration: longitudinal acceleration of the centre of mass [m/s²].
        lateral_acceleration: lateral acceleration of the centre of mass [m/s²].
        front_slip_angle: [rad].
        rear_slip_angle: [rad].
        front_lateral_force: across the front wheels [N].
        rear_lateral_force: [N].
    """

    sideslip: Value
    longitudinal_acceleration: Value
    lateral_acceleration: Value
    front_slip_angle: Value
    rear_slip_angle: Value
    front_lateral_force: Value
    rear_lateral_force: Value


class Rates(NamedTuple):
    """Result of the equations.

    Attributes:
        state: time derivatives of the states of a variant, in their order.
        motion: values of :class:`Motion`.
    """

    state: list[Value]
    motion: list[Value]


def linear_lateral_force(
    tan_alpha: Value,
    stiffness: Value,
    limit: Value,  # noqa: ARG001 - no limit
    shape: Value,  # noqa: ARG001
    curvature: Value,  # noqa: ARG001
) -> Value:
    """Return the lateral force of a linear tyre [N]; arguments as in :data:`LateralForce`."""
    return -stiffness * atan(tan_alpha)


def lateral_forces() -> dict[str, LateralForce]:
    """Return the lateral forces that the model can use, by ``tyres`` of :class:`Variant`."""
    registered = {
        kind: tyres.lateral_force
        for kind, tyres in TYRES.items()
        if issubclass(tyres, SlipTyres) and tyres.lateral_force is not None
    }
    return {"linear": linear_lateral_force, **registered}


def lateral_force_of(variant: Variant) -> LateralForce:
    """Return the lateral force of a variant; that of linear tyres for kinematic ones, which do not use it."""
    return lateral_forces().get(variant.tyres, linear_lateral_force)


def flags_of(variant: Variant) -> Flags:
    """Return the flags of a variant."""
    kinematic = variant.tyres == "kinematic"
    # The linear law has no limit, so it also needs no load transfer and no friction ellipse.
    saturates = variant.tyres not in {"kinematic", "linear"}
    return Flags(kinematic, saturates, variant.relaxation, variant.actuators, variant.roll)


def evaluate(variant: Variant, parameters: Sequence[Value], state: Sequence[Value], inputs: Sequence[Value]) -> Rates:
    """Evaluate the equations of the module's head, for any number type.

    Args:
        variant: equations.
        parameters: values in the order of :data:`mirdrake.single_track.parameters.PARAMETERS`.
        state: state in the order of :attr:`Variant.state_names`.
        inputs: inputs in the order of :attr:`Variant.input_names`.
    """
    names = variant.state_names
    law = lateral_force_of(variant)
    # States and inputs that the variant lacks take their default of zero, so that one set of equations serves all.
    x = State(**dict(zip(names, state, strict=True)))
    u = Inputs(**dict(zip(variant.input_names, inputs, strict=True)))
    derivatives, motion = equations(
        law, flags_of(variant), SimpleNamespace(**dict(zip(PARAMETERS, parameters, strict=True))), x, u
    )
    return Rates([getattr(derivatives, name) for name in names], list(motion))


def equations(law: LateralForce, flags: Flags, p: Any, x: State, u: Inputs) -> tuple[State, Motion]:
    """Return the time derivatives of the states, and the motion; equations in the head of the module.

    Args:
        law: lateral force of an axle.
        flags: variant of the equations.
        p: parameters by name.
        x: states.
        u: inputs.
    """
    a, b = p.front_length, p.rear_length
    base, vx = a + b, x.vx

    # Actuators: a first-order lag of the steering, a servo that holds the speed.
    # Without actuators the input is the angle itself; its rate is then not needed.
    delta, drive, steering_rate = u.steering, u.drive, 0.0
    if flags.actuators:
        delta = x.steering
        # The rate of the set-point is fed forward, so that the angle follows a ramp without a steady error.
        steering_rate = u.steering_rate + (u.steering - delta) / p.steering_lag
        drive = drive + p.servo_gain * (u.speed - vx)
    # The motors limit servo force and commanded force together; smaller and larger also take AutoDiffXd and Expression.
    drive = smaller(larger(drive, -p.max_force), p.max_force)
    sine, cosine = sin(delta), cos(delta)
    tangent = sine / cosine

    # Longitudinal forces of the axles, along their wheels, and gravity along and across the vehicle.
    weight = -p.mass * p.gravity_z
    # tanh in place of the sign: resistance and brakes stay differentiable at standstill.
    opposing = tanh(vx / STANDSTILL_SPEED)
    brake = u.brake * opposing
    # Rolling resistance follows the static loads: b / L of the weight is on the front axle, a / L on the rear one.
    resistance = p.rolling_resistance * weight * opposing
    front = p.front_drive * drive - p.front_brake * brake - resistance * b / base
    rear = (1.0 - p.front_drive) * drive - (1.0 - p.front_brake) * brake - resistance * a / base
    # Wind and gravity are given in the world; rotate them into the frame of the vehicle.
    sin_yaw, cos_yaw = sin(x.yaw), cos(x.yaw)
    air_speed = vx - (p.wind_x * cos_yaw + p.wind_y * sin_yaw)
    air = p.drag * absolute(air_speed) * air_speed
    # A slope appears as gravity that has components in the plane of the road, in N.
    along = p.mass * (p.gravity_x * cos_yaw + p.gravity_y * sin_yaw)
    across = p.mass * (p.gravity_y * cos_yaw - p.gravity_x * sin_yaw)

    # Limits of friction; the load transfer is that of the demanded longitudinal forces.
    limit_front, limit_rear = 0.0, 0.0
    if flags.saturates:
        # Clip the demand first, since a force that the tyres cannot transmit does not transfer load either.
        force_limit = MAX_LONGITUDINAL_SHARE * weight * larger(p.front_friction, p.rear_friction)
        transfer = smaller(larger(front + rear, -force_limit), force_limit) * p.com_height
        # Acceleration unloads the front axle; the smallest share keeps the limits, and thus the root, positive.
        grip_front = p.front_friction * larger((weight * b - transfer) / base, MIN_LOAD_SHARE * weight)
        grip_rear = p.rear_friction * larger((weight * a + transfer) / base, MIN_LOAD_SHARE * weight)
        # Longitudinal forces have priority; what the friction circle leaves is the lateral limit P.
        front, limit_front = _limit_force(front, grip_front)
        rear, limit_rear = _limit_force(rear, grip_rear)

    # Kinematic single track.
    # Curvature of the path of the rear axle's centre [1/m]: yaw rate over vx.
    turn = tangent / base
    # Mass of the motion with one degree of freedom: lateral and yaw kinetic energy follow vx by the constraint.
    effective = p.mass + p.rotating_mass + (p.mass * b * b + p.yaw_inertia) * turn * turn
    # The front wheel travels at vx / cos δ, so the power of its force divided by vx is F / cos δ.
    slow_vx = (front / cosine + rear - air + along + across * b * turn) / effective
    if flags.kinematic:
        # Accelerations of the centre of mass with vy = b r and r = vx tan δ / L; the rate of δ is left out.
        lateral = (vx * vx + b * slow_vx) * turn
        longitudinal = slow_vx - b * vx * vx * turn * turn
        return (
            State(vx * cos_yaw, vx * sin_yaw, vx * turn, slow_vx, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, steering_rate),
            Motion(atan(b * turn), longitudinal, lateral, 0.0, 0.0, 0.0, 0.0),
        )

    # Slips of the axles, with relaxation and roll, and their lateral forces.
    v1, v2, vy, yaw_rate = p.blend_start, p.blend_end, x.vy, x.yaw_rate
    # Rigid-body velocities across the vehicle at the axles, then in the direction of the steered front wheels.
    vy_front, vy_rear = vy + a * yaw_rate, vy - b * yaw_rate
    # v1 as a floor of the denominator keeps the slip finite at standstill.
    speed_front = larger(absolute(vx * cosine + vy_front * sine), v1)
    speed_rear = larger(absolute(vx), v1)
    slip_front, slip_rear = (vy_front * cosine - vx * sine) / speed_front, vy_rear / speed_rear
    slip_rate_front, slip_rate_rear = 0.0, 0.0
    # First-order relaxation over the distance rolled; the effective slip, a state, then replaces the present one.
    if flags.relaxation:
        slip_rate_front = (slip_front - x.front_slip) * speed_front / p.front_relaxation
        slip_rate_rear = (slip_rear - x.rear_slip) * speed_rear / p.rear_relaxation
        slip_front, slip_rear = x.front_slip, x.rear_slip
    if flags.roll:
        slip_front, slip_rear = slip_front + p.front_roll_slip * x.roll, slip_rear + p.rear_roll_slip * x.roll
    side_front = law(slip_front, p.front_stiffness, limit_front, p.front_shape, p.front_curvature)
    side_rear = law(slip_rear, p.rear_stiffness, limit_rear, p.rear_shape, p.rear_curvature)

    # Newton and Euler at speed; a rolling body adds a lateral force.
    lateral = front * sine + side_front * cosine
    fast_vx = (front * cosine - side_front * sine + rear - air + along + p.mass * yaw_rate * vy) / (
        p.mass + p.rotating_mass
    )
    # Neutral values: without roll the lateral equation is that of a rigid body.
    arm, over, around, righting, roll_force = 0.0, 0.0, 1.0, 0.0, 0.0
    if flags.roll:
        arm, over = p.roll_mass * p.roll_height, p.overturning_arm
        # Parallel axes: from the centre of the rolling mass to the roll axis (J in the head of the module).
        around = p.roll_inertia + p.roll_mass * p.roll_height * p.roll_height
        # gravity_z is negative, so gravity lowers the stiffness: the body rolls out of the turn like an inverted
        # pendulum.
        righting = (p.roll_stiffness + arm * p.gravity_z) * x.roll + p.roll_damping * x.roll_rate
        # ms h φ̈, from solving the lateral and the roll equation together: both contain v̇y and φ̈.
        roll_force = arm * ((arm / p.mass + over) * (lateral + side_rear) - righting) / (around - arm * arm / p.mass)
    fast_vy = (lateral + side_rear + across + roll_force) / p.mass - yaw_rate * vx
    fast_yaw = (a * lateral - b * side_rear) / p.yaw_inertia

    # Blend with the kinematic relations at low speed.
    # Relaxation towards the rolling constraint, as vy and r remain states at low speed.
    slow_yaw, slow_vy = (vx * turn - yaw_rate) / BLEND_TIME, (b * vx * turn - vy) / BLEND_TIME
    # The weight is a function of v², which has a derivative at v = 0, and smoothstep makes it C1 at v1 and v2.
    share = (vx * vx + vy * vy - v1 * v1) / (v2 * v2 - v1 * v1)
    share = smaller(larger(share, 0.0), 1.0)
    weigh = share * share * (3.0 - 2.0 * share)
    dvx = slow_vx + weigh * (fast_vx - slow_vx)
    dvy = slow_vy + weigh * (fast_vy - slow_vy)
    dyaw = slow_yaw + weigh * (fast_yaw - slow_yaw)
    roll_acceleration = 0.0
    if flags.roll:
        # Roll follows the blended acceleration; at speed this is the φ̈ that is already in roll_force. The lateral
        # force of the tyres is that of this acceleration, m (v̇y + r vx - gy) - ms h φ̈.
        sideways = dvy + yaw_rate * vx - across / p.mass
        roll_acceleration = ((arm + over * p.mass) * sideways - righting) / (around + over * arm)

    # x, y are those of the rear axle's centre, thus vy_rear; vx is the same everywhere on the longitudinal axis.
    derivatives = State(
        vx * cos_yaw - vy_rear * sin_yaw,
        vx * sin_yaw + vy_rear * cos_yaw,
        yaw_rate,
        dvx,
        dvy,
        dyaw,
        slip_rate_front,
        slip_rate_rear,
        x.roll_rate,
        roll_acceleration,
        steering_rate,
    )
    motion = Motion(
        # Below v1 the sideslip angle fades instead of jumping between ±90 degrees.
        atan(vy / larger(absolute(vx), v1)),
        dvx - yaw_rate * vy,
        dvy + yaw_rate * vx,
        atan(slip_front),
        atan(slip_rear),
        side_front,
        side_rear,
    )
    return derivatives, motion


def _limit_force(force: Value, grip: Value) -> tuple[Value, Value]:
    """Return the longitudinal force of an axle within its friction, and the remaining lateral grip [N]."""
    # A little grip is left over so that the square root has a finite derivative.
    force_limit = MAX_LONGITUDINAL_SHARE * grip
    force = smaller(larger(force, -force_limit), force_limit)
    return force, sqrt(grip * grip - force * force)


# --- compiled for floats -----------------------------------------------------------------------------------------

_PARAMETERS_TYPE = np.dtype([(name, float) for name in PARAMETERS])


def record_of(values: npt.NDArray[np.float64]) -> Records:
    """Return parameters (p) or (n, p) in the order of :data:`PARAMETERS` as records (1) or (n), a view."""
    return np.ascontiguousarray(values).view(_PARAMETERS_TYPE).reshape(-1)


class CompiledEquations:
    """The equations of a variant for floats, compiled.

    Args:
        variant: equations.
    """

    def __init__(self, variant: Variant) -> None:
        law = lateral_force_of(variant)
        names = variant.state_names
        self._step = compiled(_fill_rates, law, parts=(equations, *EQUATION_PARTS))
        self._flags = records(Flags, [flags_of(variant)])
        # Numba cannot look up fields by name at run time; -1 marks a state that this variant does not have.
        self._positions = np.array([names.index(name) if name in names else -1 for name in State._fields])
        self._states, self._inputs = len(names), len(variant.input_names)

    @staticmethod
    def parameters(values: npt.NDArray[np.float64]) -> Records:
        """Return parameters in the order of :data:`PARAMETERS` as a record."""
        return record_of(values)

    def inputs(self, values: Sequence[float]) -> npt.NDArray[np.float64]:
        """Return inputs in the order of :attr:`Variant.input_names` as the vector that :meth:`__call__` takes."""
        # The compiled step always reads five inputs; those of the actuators stay zero without actuators.
        u = np.zeros(len(Inputs._fields))
        u[: self._inputs] = values
        return u

    def __call__(
        self, parameters: Records, state: npt.NDArray[np.float64], inputs: npt.NDArray[np.float64]
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Return the derivatives of the variant's states, and the motion.

        Args:
            parameters: parameters from :meth:`parameters`.
            state: state in the order of :attr:`Variant.state_names`.
            inputs: inputs from :meth:`inputs`.
        """
        rates, motion = np.empty(self._states), np.empty(_MOTIONS)
        self._step(self._flags, self._positions, parameters, state, inputs, rates, motion)
        return rates, motion


_MOTIONS = len(Motion._fields)


def _fill_rates(
    law: LateralForce,
    flags: Records,
    k: Sequence[int],
    parameters: Records,
    x: Sequence[float],
    u: Sequence[float],
    rates: MutableSequence[float],
    motion: MutableSequence[float],
) -> None:
    """Evaluate the equations of one vehicle in arrays.

    Args:
        law: lateral force of an axle.
        flags: one :class:`Flags`.
        k: position in `x` of each field of :class:`State`; -1: the variant does not have it.
        parameters: one record of :data:`PARAMETERS`.
        x: states of the variant.
        u: values of :class:`Inputs`.
        rates: derivatives of `x`, overwritten.
        motion: values of :class:`Motion`, overwritten.
    """
    inputs = Inputs(u[0], u[1], u[2], u[3], u[4])
    derivatives, quantities = equations(law, flags[0], parameters[0], read_state(x, k), inputs)
    # Rates of states that the variant lacks are dropped.
    for i in range(len(k)):
        if k[i] >= 0:
            rates[k[i]] = derivatives[i]
    for i in range(len(motion)):
        motion[i] = quantities[i]


def read_state(row: Sequence[float], k: Sequence[int] | npt.NDArray[np.int64]) -> State:
    """Return the states of a row whose column of each field of :class:`State` is in `k`; -1: zero."""
    # Written out, not in a loop: Numba needs the fields of a named tuple at compile time.
    return State(
        element(row, k[0]),
        element(row, k[1]),
        element(row, k[2]),
        element(row, k[3]),
        element(row, k[4]),
        element(row, k[5]),
        element(row, k[6]),
        element(row, k[7]),
        element(row, k[8]),
        element(row, k[9]),
        element(row, k[10]),
    )


def element(x: Sequence[float], position: int) -> float:
    """Return an element of a vector; zero for the position -1."""
    return x[position] if position >= 0 else 0.0


EQUATION_PARTS = (_limit_force, element, read_state)
"""Functions that :func:`equations` and the reading of its states call."""
