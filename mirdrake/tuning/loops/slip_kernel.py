"""Compiled loop over the control periods of a test on the slip model: vehicle and driven wheels as separate inertias.

With the spin inertia J, the rolling radius r, the slip velocity s = r ω - v and a tyre of the load N::

    J ω' = T - r F,     m v' = n F - R,     u' = s - |v| u / σ,     F = N f(κ),     κ = u / σ + (k / C) s

Deflection u, relaxation length σ, slip stiffness C, damping k and the sliding of the patch at low speed, which adds to
the decay |v| / σ, are those of :mod:`mirdrake.tyres.relaxation`. The load follows the acceleration as the vehicle
pitches, N = N0 + c a_p with a_p'' = ω² (a - a_p) - 2 ζ ω a_p'. The speed is measured on the road, below the centre of
mass at the height h: v + m h² / (I ω²) a_p' with the pitch inertia I.

A wheel oscillates on its tyre with up to 50 Hz, and a sampled controller may excite that, so that a step must neither
damp it nor be unstable on the stiffest tyre: slip and deflection have the two implicit stages of the method with
γ = 1 - 1/√2 (R. Alexander, SIAM Journal on Numerical Analysis 14 (1977) 1006), which is L-stable, of second order, and
damps an oscillation by ζ = 0.0037 (ω dt)³. A stage is solved by the secant stiffness F / κ.
"""

from math import sqrt, tanh
from typing import NamedTuple

import numpy as np

from mirdrake.core.compiled import Records
from mirdrake.core.pid import PidLimits, PidNumbers, PidState, pid_step
from mirdrake.tuning.models import Floats
from mirdrake.tyres.relaxation import low_speed_weight, sliding_rate

_START = PidState()
_SMALL = 1e-9
_GAMMA = 1.0 - 0.5 * sqrt(2.0)  # length of a stage over that of a step

ITERATIONS = 3
"""Iterations of the force of a tyre in a stage."""

AXLE = ("wheels", "inertia", "load", "transfer", "stiffness", "length", "damping", "low_damping", "limit", "peak")
"""Columns of the table of driven axles of :func:`simulate_slip`."""


class SlipNumbers(NamedTuple):
    """Numbers of a test on the slip model.

    Attributes:
        period: of the controller [s].
        steps: of the model per period [1].
        whole: whole periods of dead time [1].
        part: rest of the dead time [s].
        scale: measurement per output [1].
        start: output before the step [y].
        is_speed: whether the output is the speed of the vehicle; if not, the spin rate of the wheels.
        outer: whether an outer loop corrects the set-point.
        mass: of the vehicle and of the wheels that are not driven [kg].
        radius: rolling radius [m].
        gravity: gravity along the road [m/s²].
        frequency: natural frequency of pitch [rad/s].
        damping: damping ratio of pitch [1].
        lean: m h² / (I ω²) [s²].
        low: speed below which a tyre has its damping of low speeds, and its patch slides [m/s].
        slip: slip velocity at the start [m/s].
        drag: rolling resistance as effort, part of the resistances; it is against the motion [u].
        fade: speed below which it fades [m/s].
        pid: gains of the loop of a wheel.
        limits: of its control.
        outer_pid: gains of the outer loop.
        outer_limits: of its correction.
    """

    period: float
    steps: int
    whole: int
    part: float
    scale: float
    start: float
    is_speed: bool
    outer: bool
    mass: float
    radius: float
    gravity: float
    frequency: float
    damping: float
    lean: float
    low: float
    slip: float
    drag: float
    fade: float
    pid: PidNumbers
    limits: PidLimits
    outer_pid: PidNumbers
    outer_limits: PidLimits


def force_over_load(curve: Floats, slip: float) -> float:
    """Return the longitudinal force of a tyre over its load [1].

    Args:
        curve: force over load at the slips (k / (n - 1))², shape (n).
        slip: slip; beyond 1 the force is that of 1 [1].
    """
    last = len(curve) - 1
    place = sqrt(abs(slip)) * last
    k = int(min(place, last - 1.0))
    share = min((abs(slip) * last * last - k * k) / (2.0 * k + 1.0), 1.0)
    force = float(curve[k] + share * (curve[k + 1] - curve[k]))
    return force if slip >= 0.0 else -force


def simulate_slip(
    numbers: Records,
    axles: Floats,
    curves: Floats,
    wanted: Floats,
    feedforward: Floats,
    loads: Floats,
    resistances: Floats,
    noise: Floats,
    outputs: Floats,
    efforts: Floats,
    slips: Floats,
    slides: Floats,
) -> None:
    """Simulate a test.

    Args:
        numbers: one record of :class:`SlipNumbers`.
        axles: a row per driven axle with the columns :data:`AXLE`, shape (a, 10): those of
            :class:`mirdrake.tuning.loops.base.DrivenAxle`, the largest slip of a deflection at standstill, and the slip
            of the largest force.
        curves: see :func:`force_over_load`, shape (a, n).
        wanted: set-point of each period, less the start, times scale, shape (k).
        feedforward: control that is added, shape (k) [u].
        loads: part of the effort without dead time, shape (k) [u].
        resistances: forces on the vehicle, negative against it, as effort, shape (k) [u].
        noise: of the measurement, shape (k).
        outputs: overwritten, shape (k) [y].
        efforts: overwritten with the control of the first axle, shape (k) [u].
        slips: overwritten with the slip velocity of the wheels of each axle, shape (a, k) [m/s].
        slides: overwritten with the largest slip velocity of each axle in each period beyond that of the largest force,
            which a rolling wheel has as well, shape (a, k) [m/s].
    """
    n, count = numbers[0], len(axles)
    step = n.period / n.steps
    speed = n.start * (1.0 if n.is_speed else n.radius)
    slip = np.full(count, n.slip * 1.0)
    along, force = np.zeros(count), np.zeros(count)
    pitched, rate = n.gravity, 0.0
    wheels = 0.0
    for i in range(count):
        wheels += axles[i, 0]
    controls = np.zeros((count, n.whole + 2))  # the oldest first
    memory = np.zeros((count, len(_START)))
    trim_loop = _START
    for k in range(len(wanted)):
        # The output is that of the vehicle, or the mean spin rate of the driven wheels.
        spin = 0.0
        for i in range(count):
            spin += axles[i, 0] / wheels * (speed + slip[i]) / n.radius
            slips[i, k] = slip[i]
        outputs[k] = speed + n.lean * rate if n.is_speed else spin
        target = wanted[k] + n.start * n.scale
        if n.outer:
            trim_loop, trim = pid_step(
                trim_loop, target / n.scale, outputs[k], n.outer_pid, n.period, n.outer_limits, 0.0
            )
            target += trim * n.scale

        # Each wheel has its own controller.
        for i in range(count):
            m = memory[i]
            state = PidState(m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8])
            measured = (speed + slip[i]) / n.radius + noise[k]
            state, control = pid_step(state, target, measured, n.pid, n.period, n.limits, feedforward[k])
            m[0], m[1], m[2], m[3], m[4] = state.control, state.integral, state.filtered, state.kp, state.kd
            m[5], m[6], m[7] = state.filter_time, state.proportional_weight, state.derivative_weight
            m[8] = state.started
            for j in range(n.whole + 1):
                controls[i, j] = controls[i, j + 1]
            controls[i, n.whole + 1] = control
        efforts[k] = controls[0, n.whole + 1]

        slides[:, k] = 0.0
        for part in range(n.steps):
            # The older control acts for the rest of the dead time that is not a whole period.
            old = (part + 0.5) * step < n.part
            # Forces on the vehicle [N]; the drag of the resistances is that of forward motion.
            push = (resistances[k] + n.drag * (1.0 - tanh(speed / n.fade))) * wheels / n.radius
            total = push
            for i in range(count):
                total += axles[i, 0] * force[i]
            weight = low_speed_weight(speed, n.low)
            for i in range(count):
                share, inertia, stiffness, length = axles[i, 0], axles[i, 1], axles[i, 4], axles[i, 5]
                torque = (controls[i, 0] if old else controls[i, 1]) + loads[k]
                pressed = max(axles[i, 2] + axles[i, 3] * pitched, 0.0)
                damped = (axles[i, 6] + axles[i, 7] * weight) / stiffness
                mobility = n.radius * n.radius / inertia + share / n.mass
                # Change of the slip without the axle's own tyres; the other axles have their forces of the last step.
                change = n.radius * torque / inertia - (total - share * force[i]) / n.mass
                slip_now, along_now = slip[i], along[i]
                kappa = along_now / length + damped * slip_now
                span, limit = _GAMMA * step, axles[i, 8] * length
                mean = 0.0
                for stage in range(2):
                    free = slip_now + span * change
                    following, deflected, secant = slip_now, along_now, 0.0
                    for _ in range(ITERATIONS):
                        decay = abs(speed) / length + sliding_rate(deflected, following, limit, weight)
                        fade = 1.0 + span * decay
                        held, gain = along_now / (length * fade), span / (length * fade) + damped
                        secant = pressed * stiffness
                        if abs(kappa) > _SMALL:
                            secant = pressed * force_over_load(curves[i], kappa) / kappa
                        following = (free - span * mobility * secant * held) / (1.0 + span * mobility * secant * gain)
                        deflected = (along_now + span * following) / fade
                        kappa = held + gain * following
                    pulled = secant * kappa
                    if stage == 0:
                        mean = (1.0 - _GAMMA) * pulled
                        further = (1.0 - _GAMMA) / _GAMMA
                        slip_now, along_now = (
                            slip[i] + further * (following - slip[i]),
                            along[i] + further * (deflected - along[i]),
                        )
                    else:
                        force[i] = mean + _GAMMA * pulled
                        slip[i] = following
                        along[i] = min(max(deflected, -length), length)  # a locked wheel has the slip 1
                push += share * force[i]
                slides[i, k] = max(slides[i, k], abs(slip[i]) - axles[i, 9] * abs(speed))
            acceleration = push / n.mass
            speed += step * acceleration
            rate += step * (
                n.frequency**2 * (acceleration + n.gravity - pitched) - 2.0 * n.damping * n.frequency * rate
            )
            pitched += step * rate


SLIP_PARTS = (pid_step, force_over_load, low_speed_weight, sliding_rate)
"""Functions that :func:`simulate_slip` calls."""
