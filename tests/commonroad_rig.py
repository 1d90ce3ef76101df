"""The multi-body cars of commonroad-vehicle-models beside ours: parameters, manoeuvres, traces.

The package (M. Althoff and G. Würsching, CommonRoad: Vehicle Models, 2020; BSD-3) has a multi-body model of 29 states
(R. W. Allen and others, for the US Department of Transportation) with a subset of the PAC2002 tyre, and parameters of
a Ford Escort, a BMW 320i and a VW Vanagon. Its axes are x ahead, y right, z down, so a left turn of ours is compared
with a right turn of it; numbers and signs of steering angle, yaw rate and lateral acceleration are then the same.

Both cars get the same road-wheel angle over time, the same on both front wheels, from straight running at
:data:`SPEED`, and roll freely: the package's input "acceleration" is 0, ours has no torque on any wheel.

Yaw rate: of the body. Lateral acceleration: of the centre of the sprung mass, horizontal, across the heading: dvy/dt +
r vx with the velocities of that point along and across the heading.

Peculiarities of the reference, and how they are treated:

- Its slip angles take the lateral velocity of the sprung mass, at the height of its centre, although the axles have
  velocities of their own (states 16 and 21), and the roll rate in the same slip angles is that of the axle: the
  lateral motion of a body due to roll has no effect on its tyres.
  `slip_only` puts the axles' velocities there, in four lines; nothing else is changed.
- Ply-steer and conicity (PHY1, PVY1) have the sign of the camber angle: the lateral force of each tyre jumps by 2 % of
  the load when the body rolls through zero, and a car that runs straight ahead starts to turn by itself, to the side
  of its rounding errors. No car and no .tir file does that. `wheel_slip` is `slip_only` without them.
- The coefficients of camber are those of axes with y left, but are used with y right: a wheel with camber to
  the right is pushed to the left. Our .tir file gets these coefficients with the other sign, to have the same tyre.
- Yaw moments are taken about the centre of the sprung mass, loads are those of the sprung mass and of the axles, and
  the total mass has its weight at the former: lateral forces and loads are shared differently by up to 4 %. Our car has
  its centre of mass where the yaw moments want it, and the tyres' scale factors LKY and LMUY hold the ratio of loads.
- A vertical shift is inside the sine of the longitudinal force, and the longitudinal slip has the other sign in the
  weights of combined slip: a freely rolling wheel does not notice.
"""

import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any, Literal

import numpy as np
import vehiclemodels.vehicle_dynamics_mb as package
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from vehiclemodels.init_mb import init_mb
from vehiclemodels.vehicle_parameters import setup_vehicle_parameters

SPEED = 20.0
"""At the start [m/s]."""

SAMPLE = 0.01
"""Of the traces [s]."""

GRAVITY = 9.81
"""That of the package [m/s²]; ours has 9.80665, 0.03 % less."""

CARS = {"Ford Escort": 1, "BMW 320i": 2, "VW Vanagon": 3}
MANOEUVRES = ("step", "sweep", "ramp")

TOPS = {"low_sweep": 0.7, "mid_sweep": 1.5, "sweep": 2.0}
"""Where the sweeps end [Hz]."""

Reference = Literal["published", "slip_only", "wheel_slip"]
Array = NDArray[np.floating[Any]]


def car(name: str) -> Any:
    """Return the package's parameters of a car."""
    return setup_vehicle_parameters(CARS[name])


# --- manoeuvres --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Manoeuvre:
    """A road-wheel angle over time.

    Attributes:
        name: step, ramp or a sweep of :data:`TOPS`.
        duration: [s].
        angle: time [s] -> angle [rad].
        rate: time [s] -> its rate [rad/s].
        breaks: times where the rate jumps [s].
    """

    name: str
    duration: float
    angle: Callable[[float], float]
    rate: Callable[[float], float]
    breaks: tuple[float, ...]


def manoeuvre(name: str, wheelbase: float) -> Manoeuvre:
    """Return a manoeuvre for a wheelbase [m]; amplitudes are those of a neutral car at :data:`SPEED`.

    - step: 0.4 g at 1 s, within 0.2 s; held for 2.8 s.
    - sweep: 0.3 g, 0.2 to 2 Hz, frequency linear in time over 15 s.
    - mid_sweep: the same to 1.5 Hz.
    - low_sweep: the same to 0.7 Hz, the top of the swept sine of MathWorks' reference applications.
    - ramp: to 0.5 g in 6.5 s.
    """
    per_g = GRAVITY * wheelbase / SPEED**2
    if name in TOPS:
        high = TOPS[name]
        top, start, low, slope = 0.3 * per_g, 0.5, 0.2, (high - 0.2) / 15.0

        def phase(t: float) -> float:
            return 2.0 * math.pi * (low + 0.5 * slope * t) * t

        return Manoeuvre(
            name,
            15.5,
            lambda t: top * math.sin(phase(t - start)) if t > start else 0.0,
            lambda t: (
                top * math.cos(phase(t - start)) * 2.0 * math.pi * (low + slope * (t - start)) if t >= start else 0.0
            ),
            (start,),
        )
    top, start, rise, duration = {"step": (0.4, 1.0, 0.2, 4.0), "ramp": (0.5, 0.5, 6.5, 8.0)}[name]
    top *= per_g
    return Manoeuvre(
        name,
        duration,
        lambda t: top * min(max((t - start) / rise, 0.0), 1.0),
        lambda t: top / rise if start <= t < start + rise else 0.0,
        (start, start + rise),
    )


@dataclass(frozen=True)
class Trace:
    """Motion of a car, at multiples of :data:`SAMPLE`.

    Attributes:
        time: (n) [s].
        yaw_rate: (n) [rad/s].
        lateral_acceleration: (n) [m/s²].
        speed: along the heading, (n) [m/s].
    """

    time: Array
    yaw_rate: Array
    lateral_acceleration: Array
    speed: Array


def fit(measured: Array, model: Array) -> float:
    """Return NRMSE fit [%]: 100 (1 - |y - ŷ| / |y - mean y|)."""
    return float(100.0 * (1.0 - np.linalg.norm(measured - model) / np.linalg.norm(measured - measured.mean())))


def fits(reference: Trace, model: Trace) -> tuple[float, float]:
    """Return fits of yaw rate and lateral acceleration [%]."""
    return (
        fit(reference.yaw_rate, model.yaw_rate),
        fit(reference.lateral_acceleration, model.lateral_acceleration),
    )


# --- the package's model -----------------------------------------------------------------------------------------

_ON_WHEELS = (
    ("atan((x[10] + p.a*x[5] - ", "atan((x[15] - "),
    ("atan((x[10] - p.b*x[5] - ", "atan((x[20] - "),
)


@cache
def _dynamics(kind: Reference) -> Callable[[list[float], list[float], Any], list[float]]:
    """Return the package's right-hand side, but for "published" with the four slip angles taken at the axles."""
    text, known = inspect.getsource(package.vehicle_dynamics_mb), dict(vars(package))
    if kind == "published":
        return package.vehicle_dynamics_mb  # type: ignore[no-any-return]
    for old, new in _ON_WHEELS:
        assert text.count(old) == 2, "the package has changed; look at its slip angles again"
        text = text.replace(old, new)
    exec(text, known)
    return known["vehicle_dynamics_mb"]  # type: ignore[no-any-return]


def reference_trace(name: str, steer: Manoeuvre, *, kind: Reference = "published") -> Trace:
    """Return the package's multi-body model, integrated with relative errors of 1e-7."""
    p, dynamics = car(name), _dynamics(kind)
    if kind == "wheel_slip":
        p.tire.p_hy1 = p.tire.p_vy1 = 0.0
    x = np.array(init_mb([0.0, 0.0, 0.0, SPEED, 0.0, 0.0, 0.0], p), dtype=float)
    time = SAMPLE * np.arange(round(steer.duration / SAMPLE) + 1)
    edges, rows = [0.0, *steer.breaks, steer.duration], []
    for first, last in pairwise(edges):

        def rates(t: float, x: Array, first: float = first, last: float = last) -> list[float]:
            within = min(max(t, first + 1e-9), last - 1e-9)
            return dynamics(x.tolist(), [steer.rate(within), 0.0], p)

        within = time[(time >= first - 1e-9) & (time < last - 1e-9)]
        solution = solve_ivp(
            rates, (first, last), x, method="LSODA", rtol=1e-7, atol=1e-9, max_step=0.02, t_eval=np.append(within, last)
        )
        assert solution.success, solution.message
        x = solution.y[:, -1]
        rows.append(solution.y[:, :-1])
    state = np.hstack([*rows, x[:, None]])
    vy_rate = np.array([dynamics(state[:, k].tolist(), [steer.rate(t), 0.0], p)[10] for k, t in enumerate(time)])
    return Trace(time, state[5], vy_rate + state[5] * state[3], state[3])
