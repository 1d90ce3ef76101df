"""Steady state and linearisation of the single-track model, and its handling figures in closed form."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import atan, nan, sqrt

import numpy as np
import scipy  # it imports its parts when they are first used
from numpy.typing import NDArray
from pydrake.autodiffutils import InitializeAutoDiff
from pydrake.systems.primitives import LinearSystem

from mirdrake.core.errors import ConfigError
from mirdrake.single_track.dynamics import LateralForce, Variant, evaluate, lateral_force_of
from mirdrake.single_track.parameters import SingleTrackParameters
from mirdrake.single_track.signals import MOTION

Matrix = NDArray[np.float64]

POSE = 3
"""Number of the first states, x, y, yaw, on which nothing depends on level ground."""

_TOLERANCE = 1e-10  # of accelerations and slip rates, SI
_ITERATIONS = 60
_LARGEST_SLIP = 1.0  # tangent of a slip angle, beyond the largest force of every tyre law


@dataclass(frozen=True)
class SteadyState:
    """Steady circular or straight motion at constant speed.

    Attributes:
        variant: equations of the model.
        state: continuous state at x = y = yaw = 0; names from :attr:`Variant.state_names`.
        inputs: inputs in the order of :attr:`input_names`.
        motion: see :data:`mirdrake.single_track.signals.MOTION`.
    """

    variant: Variant
    state: tuple[float, ...]
    inputs: tuple[float, ...]
    motion: tuple[float, ...]

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs."""
        return self.variant.input_names

    def __getitem__(self, name: str) -> float:
        """Return a state, an input or a handling quantity by name; "drive" is the force that holds the speed."""
        motion = [signal.name for signal in MOTION]
        names = (*self.variant.state_names, *motion, *self.input_names)
        return (*self.state, *self.motion, *self.inputs)[names.index(name)]


@dataclass(frozen=True)
class LinearSingleTrack:
    """ẋ = A x + B u, y = C x + D u for small deviations from a steady state, SI units.

    Attributes:
        steady: the steady state.
        A: (n, n).
        B: (n, m).
        C: (p, n).
        D: (p, m).
        states: names of the n states: vx and, of the centre of mass, vy, yaw_rate; slips; steering.
        inputs: names of the m inputs: steering, drive, brake; with actuators also steering_rate, speed.
        outputs: names of the p outputs: vx, yaw_rate, then those of the motion.
    """

    steady: SteadyState
    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def part(
        self,
        *,
        states: Sequence[str] | None = None,
        inputs: Sequence[str] | None = None,
        outputs: Sequence[str] | None = None,
    ) -> "LinearSingleTrack":
        """Return the model of some states, inputs and outputs; other states are held constant."""
        # Rows and columns of the matrices by name.
        x = [self.states.index(name) for name in (states or self.states)]
        u = [self.inputs.index(name) for name in (inputs or self.inputs)]
        y = [self.outputs.index(name) for name in (outputs or self.outputs)]
        return LinearSingleTrack(
            self.steady,
            self.A[np.ix_(x, x)],
            self.B[np.ix_(x, u)],
            self.C[np.ix_(y, x)],
            self.D[np.ix_(y, u)],
            tuple(self.states[i] for i in x),
            tuple(self.inputs[i] for i in u),
            tuple(self.outputs[i] for i in y),
        )

    def system(self) -> LinearSystem:
        """Return the model as a Drake system."""
        return LinearSystem(self.A, self.B, self.C, self.D)

    def eigenvalues(self) -> NDArray[np.complex128]:
        """Return the poles [1/s]."""
        return np.asarray(np.linalg.eigvals(self.A), dtype=np.complex128)

    def gain(self, output: str, source: str) -> float:
        """Return the steady-state gain from an input to an output; A must be invertible."""
        y, u = self.outputs.index(output), self.inputs.index(source)
        return float(self.D[y, u] - self.C[y] @ np.linalg.solve(self.A, self.B[:, u]))


def find_steady_state(
    parameters: SingleTrackParameters, variant: Variant, *, speed: float, steering: float = 0.0
) -> SteadyState:
    """Find the steady state at a speed and a steering angle, with Newton's method; the drive force holds the speed.

    Args:
        parameters: parameters of the model; gravity along x and y is ignored, as a circle on a slope is not steady.
        variant: equations of the model.
        speed: vx [m/s].
        steering: bicycle angle [rad].

    Raises:
        ConfigError: no steady state exists: the tyres slide or the motor is too weak.
    """
    # Start of Newton's method: the kinematic solution. x[4] and x[5] are vy and the yaw rate, u[-1] the servo's set-
    # point.
    level = _level(parameters)
    count, inputs = len(variant.state_names), len(variant.input_names)
    turn = np.tan(steering) / parameters.wheelbase
    x, u = np.zeros(count), np.zeros(inputs)
    x[POSE], u[0] = speed, steering
    if variant.tyres != "kinematic":
        x[4], x[5] = parameters.rear_length * speed * turn, speed * turn
    if variant.actuators:
        x[-1], u[-1] = steering, speed
    # Unknowns are columns of the Jacobian by (x, u): count + 1 is the drive force. vx, angle and set-points are given.
    free = np.r_[np.arange(POSE + 1, count - int(variant.actuators)), count + 1]  # vy, r, slips; drive force
    rows = np.arange(POSE, count - int(variant.actuators))
    residual, jacobian, motion = _differentiate(variant, level, x, u)

    # As many equations as unknowns: the rates of vx, vy, r, slips and roll must vanish.
    for _ in range(_ITERATIONS):
        size = np.abs(residual[rows]).max()
        if size < _TOLERANCE:
            break
        matrix = jacobian[np.ix_(rows, free)]
        # Least squares instead of solve: a sliding axle can make the Jacobian singular, and then no steady state is
        # found.
        step = np.linalg.lstsq(matrix, -residual[rows], rcond=None)[0]
        # Backtracking line search: halve the step until the largest residual decreases.
        for shrink in 0.5 ** np.arange(12.0):
            z = np.r_[x, u]
            z[free] += shrink * step
            trial = _differentiate(variant, level, z[:count], z[count:])
            if np.abs(trial[0][rows]).max() < size:
                break
        x, u = z[:count], z[count:]
        residual, jacobian, motion = trial
    # Looser than the tolerance of the iteration, which rounding may keep from getting any closer.
    if np.abs(residual[rows]).max() > 1e3 * _TOLERANCE:
        raise ConfigError(
            f"find_steady_state: the vehicle cannot hold {speed:g} m/s at {steering:g} rad; reduce speed or steering"
        )
    return SteadyState(variant, tuple(x.tolist()), tuple(u.tolist()), tuple(motion.tolist()))


def linearize_single_track(
    parameters: SingleTrackParameters, variant: Variant, *, speed: float, steering: float = 0.0
) -> LinearSingleTrack:
    """Linearise the model about the steady state at a speed and a steering angle.

    Position and heading are not states of the result: on level ground nothing depends on them.

    Args:
        parameters: parameters of the model; see :func:`find_steady_state`.
        variant: equations of the model.
        speed: vx [m/s].
        steering: bicycle angle [rad].

    Raises:
        ConfigError: the steady state does not exist.
    """
    steady = find_steady_state(parameters, variant, speed=speed, steering=steering)
    x, u = np.array(steady.state), np.array(steady.inputs)
    names, inputs = variant.state_names[POSE:], variant.input_names
    count = len(x)
    _, rates, _ = _differentiate(variant, _level(parameters), x, u)
    motion = _differentiate(variant, _level(parameters), x, u, motion=True)[1]
    # The first output is vx itself; the rate of yaw, row 2, is the yaw rate in every variant.
    outputs = np.vstack([np.eye(1, count + len(u), POSE), rates[2:3], motion])  # vx; the rate of yaw
    return LinearSingleTrack(
        steady=steady,
        A=rates[POSE:, POSE:count],
        B=rates[POSE:, count:],
        C=outputs[:, POSE:count],
        D=outputs[:, count:],
        states=names,
        inputs=inputs,
        outputs=("vx", "yaw_rate", *(signal.name for signal in MOTION)),
    )


def zero_side_slip_ratio(parameters: SingleTrackParameters, speed: float) -> float:
    """Return the angle of the rear wheels over that of the front wheels without side slip in a steady turn [1].

    With the lengths a and b in front of and behind the centre of mass, the cornering stiffnesses C and the wheelbase L
    it is (m a v² / (L Cr) - b) / (m b v² / (L Cf) + a): opposite at low and in the same direction at high speed (S.
    Sano, Y. Furukawa, S. Shiraishi, SAE paper 860625, 1986).

    Args:
        parameters: parameters of the vehicle.
        speed: [m/s].
    """
    p = parameters
    pull = p.mass * speed**2 / (p.front_length + p.rear_length)
    rear = pull * p.front_length / p.rear_stiffness - p.rear_length
    return rear / (pull * p.rear_length / p.front_stiffness + p.front_length)


def understeer_gradient(parameters: SingleTrackParameters) -> float:
    """Return the steering angle per lateral acceleration K [rad s²/m] of linear tyres: δ = L / R + K v² / R.

    K = m / L (b / Cf - a / Cr); Rajamani, section 3.3.
    """
    p = parameters
    return p.mass / p.wheelbase * (p.rear_length / p.front_stiffness - p.front_length / p.rear_stiffness)


def characteristic_speed(parameters: SingleTrackParameters) -> float:
    """Return the characteristic speed of an understeering vehicle, or minus the critical speed of an oversteering one.

    sqrt(L / K) and -sqrt(-L / K); infinite for neutral steer. [m/s] Linear tyres.
    """
    gradient = understeer_gradient(parameters)
    # Neutral steer has neither a characteristic nor a critical speed.
    if gradient == 0.0:
        return np.inf
    return float(np.copysign(sqrt(parameters.wheelbase / abs(gradient)), gradient))


def steady_gain(parameters: SingleTrackParameters, speed: float) -> float:
    """Return yaw rate over steering angle [1/s] in the steady state of linear tyres: v / (L + K v²)."""
    return speed / (parameters.wheelbase + understeer_gradient(parameters) * speed * speed)


def steady_steering(parameters: SingleTrackParameters, tyres: str, lateral_acceleration: float, speed: float) -> float:
    """Return the steering angle [rad] of a steady turn to the left; NaN beyond the limit of the tyres.

    δ = L a_y / v² + α_r - α_f, with the slip angles at which the tyre law has the forces m a_y b / L and m a_y a / L
    at the static loads, and the slip by the roll angle m h a_y / (K - m g h). Rajamani, section 3.3, with the tyre law
    in place of a stiffness. Longitudinal forces are neglected.

    Args:
        parameters: of a model with roll, or without.
        tyres: tyres of the variant.
        lateral_acceleration: [m/s²]
        speed: [m/s]
    """
    p, law = parameters, lateral_force_of(Variant(tyres))
    arm = p.roll_mass * p.roll_height
    roll = arm * lateral_acceleration / (p.roll_stiffness + arm * p.gravity_z) if arm else 0.0
    angles = []
    for share, stiffness, friction, shape, curvature, roll_slip in (
        (p.rear_length, p.front_stiffness, p.front_friction, p.front_shape, p.front_curvature, p.front_roll_slip),
        (p.front_length, p.rear_stiffness, p.rear_friction, p.rear_shape, p.rear_curvature, p.rear_roll_slip),
    ):
        mass = p.mass * share / p.wheelbase
        force, limit = mass * lateral_acceleration, -mass * p.gravity_z * friction

        def excess(slip: float, law: LateralForce, force: float, *numbers: float) -> float:
            return float(law(-slip, *numbers)) - force

        # The first slip with the force: beyond its peak a law may fall below it again.
        numbers = (law, force, stiffness, limit, shape, curvature)
        high = force / stiffness
        while not excess(high, *numbers) > 0.0:
            high *= 1.2
            if high > _LARGEST_SLIP:
                return nan
        slip = float(scipy.optimize.brentq(excess, 0.0, high, args=numbers, xtol=1e-9))
        angles.append(atan(-slip - roll_slip * roll))
    return p.wheelbase * lateral_acceleration / speed**2 + angles[1] - angles[0]


def _level(parameters: SingleTrackParameters) -> list[float]:
    """Return the values of the parameters on level ground."""
    return replace(parameters, gravity_x=0.0, gravity_y=0.0).values()


def _differentiate(
    variant: Variant, parameters: Sequence[float], x: Matrix, u: Matrix, *, motion: bool = False
) -> tuple[Matrix, Matrix, Matrix]:
    """Return the rates of the state (or the motion), their derivatives by (x, u), and the motion."""
    z = InitializeAutoDiff(np.r_[x, u]).ravel()
    result = evaluate(variant, parameters, z[: len(x)], z[len(x) :])
    # Handling quantities that are constant come as floats; added to an AutoDiffXd zero they have derivatives, too.
    zero = 0.0 * z[0]  # converts floats to AutoDiffXd
    outputs = [zero + value for value in (result.motion if motion else result.state)]
    gradient = np.array([value.derivatives() for value in outputs])
    motions = np.array([(zero + value).value() for value in result.motion])
    return np.array([value.value() for value in outputs]), gradient, motions
