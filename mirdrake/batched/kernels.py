"""Compiled loops over cars: Runge-Kutta steps of the single-track model.

Each loop handles the cars `first` to `last` - 1, so that several threads share a batch. A car uses its own numbers
only, and its operations have a fixed order: results do not depend on the other cars or on the number of threads.
"""

from collections.abc import MutableSequence
from typing import Any, NamedTuple

import numpy as np

from mirdrake.batched.arrays import Floats, Integers, Mask
from mirdrake.batched.ground import GROUND_PARTS, apply_ground
from mirdrake.core.compiled import Records
from mirdrake.single_track.dynamics import (
    EQUATION_PARTS,
    Flags,
    Inputs,
    LateralForce,
    Motion,
    State,
    equations,
    read_state,
)


class Fleet(NamedTuple):
    """Cars of a batch, as compiled loops take them.

    Attributes:
        flags: one record of :class:`Flags`.
        positions: column in `states` of each field of :class:`State`; -1: the variant does not have it.
        parameters: a record per car.
        present: parameters at the place of each car, overwritten; `parameters` itself without a ground.
        frame: see :class:`mirdrake.batched.ground.Ground`.
        grid: see there.
        states: states of the variant (n, states), updated.
        diverged: cars whose state is not finite, updated; their last finite state remains.
    """

    flags: Records
    positions: Integers
    parameters: Records
    present: Records
    frame: Floats
    grid: Floats
    states: Floats
    diverged: Mask


def advance(law: LateralForce, cars: Fleet, inputs: Floats, step: float, steps: int, first: int, last: int) -> None:
    """Advance cars under inputs that are held.

    Args:
        law: lateral force of an axle.
        cars: all cars.
        inputs: values of :class:`Inputs` (n, 5).
        step: step of the integration [s].
        steps: number of steps.
        first: first car.
        last: car after the last one.
    """
    for i in range(first, last):
        # A diverged car keeps its last state: its numbers would slow down the others, and end as NaN.
        if cars.diverged[i]:
            continue
        x = read_state(cars.states[i], cars.positions)
        u = Inputs(inputs[i, 0], inputs[i, 1], inputs[i, 2], inputs[i, 3], inputs[i, 4])
        alive, x = steps_of_car(law, cars, i, x, u, step, steps)
        cars.diverged[i] = not alive
        write_state(cars.states[i], cars.positions, x)


def advance_over_time(
    law: LateralForce, cars: Fleet, inputs: Floats, step: float, steps: int, outputs: Floats, first: int, last: int
) -> None:
    """Advance cars under inputs over time.

    Args:
        law: lateral force of an axle.
        cars: all cars.
        inputs: values of :class:`Inputs` (1 or n, times, 5); each row is held for `steps` steps.
        step: step of the integration [s].
        steps: number of steps for a row.
        outputs: states and motion (n, times + 1, states + motion), at the start and after each row; overwritten,
            not a number from the row on in which a car diverged.
        first: first car.
        last: car after the last one.
    """
    states_of_variant = cars.states.shape[1]
    for i in range(first, last):
        x = read_state(cars.states[i], cars.positions)
        # Row 0 holds the inputs of all cars if there is only one.
        row = min(i, inputs.shape[0] - 1)
        u = Inputs(0.0, 0.0, 0.0, 0.0, 0.0)
        for k in range(inputs.shape[1] + 1):
            if k < inputs.shape[1]:
                u = Inputs(
                    inputs[row, k, 0], inputs[row, k, 1], inputs[row, k, 2], inputs[row, k, 3], inputs[row, k, 4]
                )
            if cars.diverged[i]:
                outputs[i, k, :] = np.nan
                continue
            # The motion of the last row is that under the last inputs.
            write_state(outputs[i, k], cars.positions, x)
            write_motion(outputs[i, k], states_of_variant, motion_of_car(law, cars, i, x, u))
            if k == inputs.shape[1]:
                continue
            alive, x = steps_of_car(law, cars, i, x, u, step, steps)
            cars.diverged[i] = not alive
        write_state(cars.states[i], cars.positions, x)


def motion_of_car(law: LateralForce, cars: Fleet, i: int, x: State, u: Inputs) -> Motion:
    """Return the motion of a car at its place."""
    apply_ground(cars.frame, cars.grid, cars.parameters[i], cars.present[i], x.x, x.y)
    return equations(law, cars.flags[0], cars.present[i], x, u)[1]


def steps_of_car(
    law: LateralForce, cars: Fleet, i: int, x: State, u: Inputs, step: float, steps: int
) -> tuple[bool, State]:
    """Return whether the state of a car is finite after some steps under held inputs, and its last finite state.

    Args:
        law: lateral force of an axle.
        cars: all cars.
        i: number of the car.
        x: its state at the start.
        u: inputs.
        step: step of the integration [s].
        steps: number of steps.
    """
    own, present = cars.parameters[i], cars.present[i]
    for _ in range(steps):
        # The ground is read once per step, not per stage: friction, slope and wind are constant within a step.
        apply_ground(cars.frame, cars.grid, own, present, x.x, x.y)
        after = runge_kutta(law, cars.flags[0], present, x, u, step)
        if not is_finite(after):
            return False, x
        x = after
    return True, x


def runge_kutta(law: LateralForce, flags: Flags, p: Any, x: State, u: Inputs, step: float) -> State:
    """Return the state after one step of the classical fourth-order Runge-Kutta method.

    Source: E. Hairer, S. P. Nørsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd ed., section II.1.

    Args:
        law: lateral force of an axle.
        flags: variant of the equations.
        p: parameters by name.
        x: state at the start.
        u: inputs, held.
        step: step [s].
    """
    # Written out by field: Numba and JAX both trace it, and the fixed order of additions keeps results bit-identical.
    half, sixth = 0.5 * step, step / 6.0
    k1 = equations(law, flags, p, x, u)[0]
    k2 = equations(law, flags, p, moved(x, half, k1), u)[0]
    k3 = equations(law, flags, p, moved(x, half, k2), u)[0]
    k4 = equations(law, flags, p, moved(x, step, k3), u)[0]
    return State(
        x.x + sixth * (k1.x + 2.0 * (k2.x + k3.x) + k4.x),
        x.y + sixth * (k1.y + 2.0 * (k2.y + k3.y) + k4.y),
        x.yaw + sixth * (k1.yaw + 2.0 * (k2.yaw + k3.yaw) + k4.yaw),
        x.vx + sixth * (k1.vx + 2.0 * (k2.vx + k3.vx) + k4.vx),
        x.vy + sixth * (k1.vy + 2.0 * (k2.vy + k3.vy) + k4.vy),
        x.yaw_rate + sixth * (k1.yaw_rate + 2.0 * (k2.yaw_rate + k3.yaw_rate) + k4.yaw_rate),
        x.front_slip + sixth * (k1.front_slip + 2.0 * (k2.front_slip + k3.front_slip) + k4.front_slip),
        x.rear_slip + sixth * (k1.rear_slip + 2.0 * (k2.rear_slip + k3.rear_slip) + k4.rear_slip),
        x.roll + sixth * (k1.roll + 2.0 * (k2.roll + k3.roll) + k4.roll),
        x.roll_rate + sixth * (k1.roll_rate + 2.0 * (k2.roll_rate + k3.roll_rate) + k4.roll_rate),
        x.steering + sixth * (k1.steering + 2.0 * (k2.steering + k3.steering) + k4.steering),
    )


def moved(x: State, time: float, rates: State) -> State:
    """Return a state after a time at constant rates."""
    return State(
        x.x + time * rates.x,
        x.y + time * rates.y,
        x.yaw + time * rates.yaw,
        x.vx + time * rates.vx,
        x.vy + time * rates.vy,
        x.yaw_rate + time * rates.yaw_rate,
        x.front_slip + time * rates.front_slip,
        x.rear_slip + time * rates.rear_slip,
        x.roll + time * rates.roll,
        x.roll_rate + time * rates.roll_rate,
        x.steering + time * rates.steering,
    )


def is_finite(x: State) -> bool:
    """Return whether every state is a finite number."""
    # NaN and infinity survive the sum, and only they differ from zero when subtracted from themselves.
    total = x.x + x.y + x.yaw + x.vx + x.vy + x.yaw_rate
    total += x.front_slip + x.rear_slip + x.roll + x.roll_rate + x.steering
    return bool(total - total == 0.0)


def write_state(row: MutableSequence[float], k: Integers, x: State) -> None:
    """Write states into a row; the inverse of :func:`mirdrake.single_track.dynamics.read_state`."""
    for i in range(len(k)):
        if k[i] >= 0:
            row[k[i]] = x[i]


def write_motion(row: MutableSequence[float], start: int, motion: Motion) -> None:
    """Write the values of :class:`Motion` into a row from a column on."""
    for i in range(len(motion)):
        row[start + i] = motion[i]


KERNEL_PARTS = (
    *EQUATION_PARTS,
    *GROUND_PARTS,
    equations,
    motion_of_car,
    steps_of_car,
    runge_kutta,
    moved,
    is_finite,
    write_state,
    write_motion,
)
"""Functions that the loops call."""
