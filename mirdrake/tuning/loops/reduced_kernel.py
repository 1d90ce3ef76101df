"""Compiled loop over the control periods of a test on the reduced model.

The order of a period is that of the plant: the controller reads the measurement, and its control acts after the dead
time; loads act without it.
"""

from typing import NamedTuple

import numpy as np

from mirdrake.core.compiled import Records
from mirdrake.core.pid import PidLimits, PidNumbers, PidState, pid_step
from mirdrake.tuning.models import Floats

_START = PidState()


class RunNumbers(NamedTuple):
    """Numbers of a test on the reduced model.

    Attributes:
        period: of the controller [s].
        whole: whole periods of dead time [1].
        through: direct feedthrough of the plant [measurement/u].
        scale: measurement per output [1].
        start: output before the step [y].
        radius: nominal rolling radius over the present one [1].
        is_output: whether the measurement is the output.
        outer: whether an outer loop corrects the set-point.
        pid: gains of the loop.
        limits: of its control.
        outer_pid: gains of the outer loop.
        outer_limits: of its correction.
    """

    period: float
    whole: int
    through: float
    scale: float
    start: float
    radius: float
    is_output: bool
    outer: bool
    pid: PidNumbers
    limits: PidLimits
    outer_pid: PidNumbers
    outer_limits: PidLimits


def simulate_test(
    numbers: Records,
    step: Floats,
    old: Floats,
    new: Floats,
    held: Floats,
    row: Floats,
    output_row: Floats,
    wanted: Floats,
    feedforward: Floats,
    loads: Floats,
    resistances: Floats,
    noise: Floats,
    outputs: Floats,
    efforts: Floats,
) -> bool:
    """Simulate a test and return whether all numbers stay within bounds.

    Args:
        numbers: one record of :class:`RunNumbers`.
        step: transition of the state over a period, shape (n, n).
        old: effect of the control before the last whole period of dead time, shape (n).
        new: effect of the control after it, shape (n).
        held: effect of an input without dead time, shape (n).
        row: measurement per state, shape (n), with the nominal rolling radius.
        output_row: output times scale per state, shape (n).
        wanted: set-point of each period, less the start, times scale, shape (k).
        feedforward: control that is added, shape (k) [u].
        loads: part of the effort without dead time, shape (k) [u].
        resistances: forces on the plant that are not effort, shape (k) [u].
        noise: of the measurement, shape (k).
        outputs: overwritten, shape (k) [y].
        efforts: overwritten with the effort that acts, shape (k) [u].
    """
    n, order = numbers[0], len(row)
    state, following = np.zeros(order), np.zeros(order)
    controls = np.zeros(n.whole + 2)  # the oldest first
    loop, trim_loop = _START, _START
    value = output = 0.0  # deviations from the start, times scale
    for k in range(len(wanted)):
        # Effort at the end of the last period; none before the first.
        acting = controls[1] + (loads[k - 1] if k else 0.0)
        measured = n.radius * value + (n.radius - 1.0) * n.start * n.scale
        if n.is_output:
            output = measured
        target = wanted[k]
        if n.outer:
            trim_loop, trim = pid_step(
                trim_loop, target / n.scale, output / n.scale, n.outer_pid, n.period, n.outer_limits, 0.0
            )
            target += trim * n.scale
        loop, control = pid_step(loop, target, measured + noise[k], n.pid, n.period, n.limits, feedforward[k])
        # Written so that NaN counts as unstable.
        if not (abs(measured) < 1e9 and abs(control) < 1e12):
            return False
        outputs[k], efforts[k] = output / n.scale + n.start, acting
        for i in range(n.whole + 1):
            controls[i] = controls[i + 1]
        controls[n.whole + 1] = control
        free = loads[k] + resistances[k]
        value = output = n.through * (controls[1] + free)
        for i in range(order):
            following[i] = old[i] * controls[0] + new[i] * controls[1] + held[i] * free
            for j in range(order):
                following[i] += step[i, j] * state[j]
        for i in range(order):
            state[i] = following[i]
            value += row[i] * state[i]
            output += output_row[i] * state[i]
    return True


KERNEL_PARTS = (pid_step,)
"""Functions that :func:`simulate_test` calls."""
