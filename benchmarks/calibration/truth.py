"""Vehicles of the calibration: equations that do not come from the package under test.

``linear``, ``brush`` and ``magic`` are single tracks; ``two_track`` adds load transfer to both sides, load-dependent
tyres, relaxation, roll, and drive and brake forces; ``multi_body`` are the cars of commonroad-vehicle-models.
Speed is prescribed; the lateral motion follows Rajamani, Vehicle Dynamics and Control, 2012, sections 2.3 and 8.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from vehiclemodels.init_mb import init_mb
from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb
from vehiclemodels.vehicle_parameters import setup_vehicle_parameters

Array = NDArray[np.float64]
Kind = Literal["linear", "brush", "magic", "two_track", "multi_body"]
GRAVITY = 9.80665
STEP = 0.002
"""Step of the integration and of the motion [s]."""


@dataclass(frozen=True)
class Vehicle:
    """True parameters, SI units.

    Attributes:
        kind: model of the motion.
        mass: [kg].
        front, rear: centre of mass to the axles [m].
        yaw_inertia: [kg m²].
        stiffness_front, stiffness_rear: cornering stiffness of the axles at their static load [N/rad].
        friction: [1].
        shape, curvature: C and E of the Magic Formula [1].
        relaxation: relaxation length [m]; 0 for none.
        ratio: steering channel over road wheel angle [1].
        offset: road wheel angle at zero of the channel [rad].
        delay, lag: of the steering [s].
        height, track: of the centre of mass; between the wheels [m].
        roll_gain: roll angle over lateral acceleration [rad s²/m].
        roll_frequency, roll_damping: of roll [rad/s], [1].
        roll_front: front axle's share of the lateral load transfer [1].
        load_exponent: exponent of the cornering stiffness over the load [1].
        drive_front, brake_front: front axle's share of the force [1].
        car: number of the multi-body car.
    """

    kind: Kind
    mass: float
    front: float
    rear: float
    yaw_inertia: float
    stiffness_front: float
    stiffness_rear: float
    friction: float = 1.0
    shape: float = 1.4
    curvature: float = -0.5
    relaxation: float = 0.0
    ratio: float = 1.0
    offset: float = 0.0
    delay: float = 0.0
    lag: float = 0.0
    height: float = 0.0
    track: float = 1.5
    roll_gain: float = 0.0
    roll_frequency: float = 9.0
    roll_damping: float = 0.3
    roll_front: float = 0.5
    load_exponent: float = 1.0
    drive_front: float = 0.0
    brake_front: float = 0.6
    car: int = 0

    @property
    def wheelbase(self) -> float:
        """Distance of the axles [m]."""
        return self.front + self.rear


@dataclass(frozen=True)
class Motion:
    """Motion at the centre of mass, at multiples of :data:`STEP` (n each)."""

    time: Array
    speed: Array
    command: Array
    lateral: Array
    yaw_rate: Array
    roll: Array

    def rate(self, values: Array) -> Array:
        """Return the derivative (n)."""
        return np.gradient(values, STEP)


_LAWS = {"linear": 0, "brush": 1, "magic": 2, "two_track": 2}


@njit(cache=True)
def _force(law, alpha, stiffness, most, shape, curvature):  # type: ignore[no-untyped-def]
    """Lateral force over slip angle (Pacejka, Tire and Vehicle Dynamics, 2012, sections 3.2 and 4.3)."""
    slope = math.tan(min(max(alpha, -1.4), 1.4))
    if law == 0:
        return -stiffness * alpha
    if law == 1:
        limit = 3.0 * most / stiffness
        if abs(slope) >= limit:
            return -most * math.copysign(1.0, slope)
        x = stiffness * slope
        return -(x - x * abs(x) / (3.0 * most) + x**3 / (27.0 * most**2))
    x = stiffness * slope / (shape * most)
    return -most * math.sin(shape * math.atan(x - curvature * (x - math.atan(x))))


@njit(cache=True)
def _rates(x, angle, speed, pull, c, law):  # type: ignore[no-untyped-def]
    """Derivatives of vy, r, roll, its rate and both relaxed slip angles."""
    m, a, b, inertia, mu, relax = c[0], c[1], c[2], c[3], c[6], c[9]
    height, track, gain, omega, zeta = c[10], c[11], c[12], c[13], c[14]
    vy, r, roll, roll_rate = x[0], x[1], x[2], x[3]
    slip_front = math.atan2(vy + a * r, speed) - angle
    slip_rear = math.atan2(vy - b * r, speed)
    used_front = x[4] if relax > 0.0 else slip_front
    used_rear = x[5] if relax > 0.0 else slip_rear
    body = m * (pull - r * vy)
    length = a + b
    g = 9.80665
    load_front = m * g * b / length - body * height / length
    load_rear = m * g * a / length + body * height / length
    over = m * (roll / gain if gain > 0.0 else 0.0) * height / track
    forces = np.zeros(2)
    ahead, share = body, c[17]
    # The wheels overcome the backward part of the front lateral force, which depends on their force by the friction.
    for step in range(6):
        axle = step % 2
        if axle == 0:
            share = c[17] if body + forces[0] * math.sin(angle) > 0.0 else c[18]
            ahead = (body + forces[0] * math.sin(angle)) / (1.0 - share + share * math.cos(angle))
        load = load_front if axle == 0 else load_rear
        usual = m * g * (b if axle == 0 else a) / length
        along = ahead * (share if axle == 0 else 1.0 - share)
        stiffness = c[4 + axle]
        slip = used_front if axle == 0 else used_rear
        moved = over * (c[15] if axle == 0 else 1.0 - c[15])
        total = 0.0
        for side in (-1.0, 1.0):
            part = max(0.5 * load + side * moved, 0.02 * usual)
            most = math.sqrt(max((mu * part) ** 2 - (0.5 * along) ** 2, (0.1 * mu * part) ** 2))
            total += _force(law, slip, 0.5 * stiffness * (part / (0.5 * usual)) ** c[16], most, c[7], c[8])
        forces[axle] = total
    across = forces[0] * math.cos(angle) + ahead * share * math.sin(angle)
    side = (across + forces[1]) / m
    out = np.zeros(6)
    out[0] = side - r * speed
    out[1] = (a * across - b * forces[1]) / inertia
    out[2] = roll_rate
    out[3] = omega**2 * (gain * side - roll) - 2.0 * zeta * omega * roll_rate
    if relax > 0.0:
        out[4] = speed / relax * (slip_front - x[4])
        out[5] = speed / relax * (slip_rear - x[5])
    return out


@njit(cache=True)
def _integrate(angle, speed, pull, c, law, step):  # type: ignore[no-untyped-def]
    """Return the states (6, n) by Runge-Kutta's method with inputs between the rows by their means."""
    n = len(angle)
    states, x = np.zeros((6, n)), np.zeros(6)
    for i in range(n - 1):
        states[:, i] = x
        middle = (0.5 * (angle[i] + angle[i + 1]), 0.5 * (speed[i] + speed[i + 1]), 0.5 * (pull[i] + pull[i + 1]))
        k1 = _rates(x, angle[i], speed[i], pull[i], c, law)
        k2 = _rates(x + 0.5 * step * k1, middle[0], middle[1], middle[2], c, law)
        k3 = _rates(x + 0.5 * step * k2, middle[0], middle[1], middle[2], c, law)
        k4 = _rates(x + step * k3, angle[i + 1], speed[i + 1], pull[i + 1], c, law)
        x = x + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    states[:, n - 1] = x
    return states


def road_wheel_angle(vehicle: Vehicle, command: Array) -> Array:
    """Return the road wheel angle of a command: dead time, first-order lag, ratio, offset (n) [rad]."""
    rows = np.arange(float(len(command)))
    late = np.interp(rows - vehicle.delay / STEP, rows, command)
    if vehicle.lag > 0.0:
        decay, angle = math.exp(-STEP / vehicle.lag), late.copy()
        for i in range(1, len(late)):
            target = 0.5 * (late[i - 1] + late[i])
            angle[i] = target + decay * (angle[i - 1] - target)
        late = angle
    return np.asarray(late / vehicle.ratio + vehicle.offset)


def drive(vehicle: Vehicle, speed: Array, command: Array) -> Motion:
    """Simulate a drive with a prescribed speed [m/s] and command of the steering, at multiples of STEP (n each)."""
    angle = road_wheel_angle(vehicle, command)
    time: Array = STEP * np.arange(len(speed), dtype=np.float64)
    if vehicle.kind == "multi_body":
        return _drive_multi_body(vehicle, speed, command, angle, time)
    v = vehicle
    full = v.kind == "two_track"
    c = np.array(
        [v.mass, v.front, v.rear, v.yaw_inertia, v.stiffness_front, v.stiffness_rear, v.friction, v.shape, v.curvature,
         v.relaxation, v.height if full else 0.0, v.track, v.roll_gain if full else 0.0, v.roll_frequency,
         v.roll_damping, v.roll_front, v.load_exponent if full else 1.0, v.drive_front, v.brake_front]
    )  # fmt: skip
    pull = np.gradient(speed, STEP) if full else np.zeros(len(speed))
    fine = 4 if vehicle.wheelbase < 1.0 else 1
    grid = np.arange(0.0, len(speed) - 1 + 0.5 / fine, 1.0 / fine)
    rows = np.arange(float(len(speed)))
    inputs = [np.interp(grid, rows, values) for values in (angle, speed, pull)]
    states = _integrate(*inputs, c, _LAWS[v.kind], STEP / fine)[:, ::fine]
    if not np.isfinite(states).all() or np.max(np.abs(states[0]) / speed) > 0.6:
        raise ValueError("the vehicle spins")
    return Motion(time, speed, command, states[0], states[1], states[2])


def _drive_multi_body(vehicle: Vehicle, speed: Array, command: Array, angle: Array, time: Array) -> Motion:
    """Drive a car of commonroad-vehicle-models, mirrored: its axes are x ahead, y right, z down."""
    p = setup_vehicle_parameters(vehicle.car)
    # Ply-steer and conicity of the package change their sign with roll, which no car does.
    p.tire.p_hy1 = p.tire.p_vy1 = 0.0
    turn, pull = np.gradient(angle, STEP), np.gradient(speed, STEP)

    def rates(t: float, x: Array) -> list[float]:
        index = min(int(t / STEP), len(speed) - 1)
        return list(vehicle_dynamics_mb(x.tolist(), [turn[index], pull[index] + 1.0 * (speed[index] - x[3])], p))

    first = np.array(init_mb([0.0, 0.0, angle[0], speed[0], 0.0, 0.0, 0.0], p), dtype=float)
    shown = time[::5]
    solution = solve_ivp(
        rates, (0.0, time[-1]), first, method="LSODA", rtol=1e-5, atol=1e-7, max_step=0.02, t_eval=shown
    )
    if not solution.success or np.max(np.abs(solution.y[10]) / solution.y[3]) > 0.6:
        raise ValueError("the vehicle spins")
    along, side, rate, roll = (np.interp(time, shown, solution.y[i]) for i in (3, 10, 5, 6))
    return Motion(time, np.asarray(along), command, side, rate, roll)
