"""Cars, random parameter sets and the plain Runge-Kutta method, for tests of batches."""

from dataclasses import replace

import numpy as np

from mirdrake.single_track import SingleTrackParameters
from mirdrake.single_track.dynamics import Variant, evaluate
from mirdrake.single_track.parameters import PARAMETERS

CAR = SingleTrackParameters(
    mass=1500.0,
    yaw_inertia=2400.0,
    front_length=1.2,
    rear_length=1.5,
    com_height=0.55,
    rotating_mass=40.0,
    front_stiffness=90e3,
    rear_stiffness=110e3,
    rolling_resistance=0.01,
    drag=0.5,
    max_force=6000.0,
    servo_gain=5000.0,
    roll_mass=1300.0,
    roll_height=0.45,
    roll_inertia=400.0,
    roll_stiffness=60e3,
    roll_damping=2500.0,
    overturning_arm=0.03,
)
MAGIC = Variant("magic_formula", True, True, True)
LINEAR, BRUSH, RICH = Variant("linear"), Variant("brush"), Variant("brush", True, True, True)
STEP = 0.005


def random_columns(count, seed=0):
    """Return every parameter of each car, between 0.8 and 1.2 of the car's; shares and signs stay allowed."""
    rng = np.random.default_rng(seed)
    nominal = replace(
        CAR, gravity_x=0.1, gravity_y=-0.1, front_roll_slip=0.05, front_curvature=-1.0, rear_curvature=-0.5, wind_x=-4.0
    )
    return {
        name: getattr(nominal, name) * (0.8 + 0.4 * rng.random(count))
        for name in PARAMETERS
        if name not in {"front_drive", "front_brake"}
    }


def runge_kutta_steps(variant, parameters, state, inputs, steps, step=STEP):
    """Python alone: the classical method on the equations for floats."""
    x, u, p = [float(value) for value in state], [float(value) for value in inputs], parameters.values()

    def rates(x_now):
        return [0.0 + value for value in evaluate(variant, p, x_now, u).state]

    def moved(time, slope):
        return [a + time * b for a, b in zip(x, slope, strict=True)]

    for _ in range(steps):
        k1 = rates(x)
        k2 = rates(moved(0.5 * step, k1))
        k3 = rates(moved(0.5 * step, k2))
        k4 = rates(moved(step, k3))
        x = [a + step / 6.0 * (p1 + 2.0 * (p2 + p3) + p4) for a, p1, p2, p3, p4 in zip(x, k1, k2, k3, k4, strict=True)]
    return np.array(x)
