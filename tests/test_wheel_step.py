"""Steps of one wheel on its tyre, against a fine integration of the same equations: order and size of the error."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mirdrake.plant.wheels.step import Memory, slip_forces
from mirdrake.tyres.brush import BrushTyre, brush_at_load, brush_on
from mirdrake.tyres.relaxation import Contact, Motion, RelaxationSettings

LOAD, RADIUS, INERTIA, LENGTH = 4000.0, 0.31, 1.2, 0.2
TYRE = BrushTyre(
    nominal_load=LOAD,
    longitudinal_stiffness=88000.0,
    cornering_stiffness=54000.0,
    friction=1.0,
    peak_load=8000.0,
    half_length=0.06,
)
CURVE = brush_at_load(TYRE, LOAD)
CONTACT = Contact(CURVE.longitudinal, CURVE.cornering, LENGTH, 0.4, CURVE.limit, CURVE.limit)
WHEEL = SimpleNamespace(inertia=INERTIA, held=False, settings=RelaxationSettings())


def speed(t: float) -> float:
    """Return the speed of a car that brakes at 8 m/s² [m/s]."""
    return 20.0 - 8.0 * t


def torque_at(t: float, torque: float) -> float:
    """Return the torque of a powertrain that is updated every 10 ms [N m]."""
    return torque * min(1.0, (math.floor(t / 0.01 + 1e-6) + 1.0) / 3.0)


def spins(step: float, torque: float, *, brake: bool, end: float = 0.3) -> np.ndarray:
    """Return the spin every 10 ms [rad/s], with the steps of the plant."""
    before = SimpleNamespace(**dict.fromkeys(Memory._fields, 0.0))
    spin, result = speed(0.0) / RADIUS, []
    for i in range(round(end / step) + 1):
        t = i * step
        if i % round(0.01 / step) == 0:
            result.append(spin)
        kept = SimpleNamespace(begun=1.0)
        vx = speed(t)
        now = Motion(vx, vx - spin * RADIUS, 0.0)
        given = torque_at(t, torque)
        drive, limit = (0.0, -given) if brake else (given, 0.0)
        fx, _, _, _, _, applied = slip_forces(
            brush_on, CURVE, 1.0, CONTACT, WHEEL, before, kept, now, spin, RADIUS, drive, limit, 0.0, 0.0, step
        )
        spin += step / INERTIA * (applied - RADIUS * fx)
        before = kept
    return np.array(result)


def reference(torque: float, *, end: float = 0.3) -> np.ndarray:
    """Return the same by fine integration, of one update of the torque after the other."""

    def rates(t: float, state: np.ndarray, given: float) -> list[float]:
        spin, deflection = state
        vx = speed(t)
        fx, _, _ = brush_on(CURVE, deflection / LENGTH, 0.0, vx)
        return [(given - RADIUS * float(fx)) / INERTIA, spin * RADIUS - vx - vx * deflection / LENGTH]

    state, result = np.array([speed(0.0) / RADIUS, 0.0]), []
    for i in range(round(end / 0.01) + 1):
        result.append(state[0])
        t = 0.01 * i
        given = torque_at(t, torque)
        state = solve_ivp(rates, (t, t + 0.01), state, args=(given,), rtol=1e-10, atol=1e-10).y[:, -1]
    return np.array(result)


@pytest.mark.parametrize("brake", [False, True], ids=["motor", "brake"])
@pytest.mark.parametrize("torque", [-300.0, -1000.0, -1200.0])
def test_the_spin_of_a_wheel_is_of_second_order_at_least(torque: float, brake: bool) -> None:
    """Up to 97 % of the friction force. A slip velocity of 0.02 m/s is a slip of 0.1 %."""
    exact = reference(torque)
    errors = [RADIUS * np.abs(spins(step, torque, brake=brake) - exact).max() for step in (0.01, 0.005, 0.0025)]
    assert errors[0] < 0.04
    assert errors[1] < 0.2 * errors[0]
    assert errors[2] < 0.25 * errors[1]
