"""A model driven by the inputs of a recorded log, for many sets of parameters in one compiled loop."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from mirdrake.batched.arrays import Floats, Integers
from mirdrake.core.compiled import Records, compiled


class LogEquations(NamedTuple):
    """Equations ẋ = f(x, u, p), y = h(x, u, p) as functions that can be compiled.

    Attributes:
        rates: (settings, p, x, u, ẋ): writes the derivatives of a row of states.
        observe: (settings, p, x, u, y): writes the outputs.
        parts: functions that these call, directly or indirectly.
    """

    rates: Callable[[Any, Any, Sequence[float], Sequence[float], Any], None]
    observe: Callable[[Any, Any, Sequence[float], Sequence[float], Any], None]
    parts: tuple[Callable[..., Any], ...] = ()


class LogRuns(NamedTuple):
    """Runs along a log.

    Attributes:
        outputs: outputs at the samples (n, samples, outputs).
        last: states a sample time after the last sample (n, states).
    """

    outputs: Floats
    last: Floats


def run_log(
    equations: LogEquations,
    settings: Records,
    parameters: Records,
    inputs: Floats,
    starts: Floats,
    *,
    rows: Sequence[int],
    step: float,
    substeps: int,
    outputs: int,
) -> LogRuns:
    """Return the outputs of a model along a log, for n sets of parameters and initial states.

    Each run is integrated by Runge-Kutta steps from its initial state. A run that diverges ends in numbers that are
    not finite; the others do not change.

    Args:
        equations: equations of the model.
        settings: one record, given to the equations.
        parameters: a record for each run (n).
        inputs: sets of inputs at the ends and middles of the steps (sets, 2 · substeps · samples + 1, inputs).
        starts: initial states (n, states).
        rows: index of the set of inputs of each run (n).
        step: step of the integration [s].
        substeps: steps per sample.
        outputs: number of outputs.
    """
    # A copy: the kernel overwrites the states.
    last = np.array(starts, dtype=float)
    samples = (inputs.shape[1] - 1) // (2 * substeps)
    seen: Floats = np.empty((len(last), samples, outputs))
    kernel = compiled(_run, (equations.rates, equations.observe), parts=equations.parts, nogil=True)
    sets: Integers = np.asarray(rows, dtype=np.int64)
    kernel(settings, parameters, np.ascontiguousarray(inputs), sets, float(step), int(substeps), last, seen)
    return LogRuns(seen, last)


def _run(
    rates: Callable[..., None],
    observe: Callable[..., None],
    settings: Any,
    parameters: Any,
    inputs: Floats,
    rows: Integers,
    step: float,
    substeps: int,
    states: Floats,
    outputs: Floats,
) -> None:
    """Integrate each run along the log; arguments as in :func:`run_log`, states and outputs are overwritten."""
    # The stages of the Runge-Kutta method share buffers over all runs.
    width = states.shape[1]
    x, between = np.empty(width), np.empty(width)
    k1, k2, k3, k4 = np.empty(width), np.empty(width), np.empty(width), np.empty(width)
    half, sixth = 0.5 * step, step / 6.0
    for i in range(states.shape[0]):
        own, row = parameters[i], rows[i]
        x[:] = states[i]
        for sample in range(outputs.shape[1]):
            # Outputs before the step: those of a sample belong to its own time.
            observe(settings[0], own, x, inputs[row, 2 * substeps * sample], outputs[i, sample])
            for substep in range(substeps):
                # Inputs are tabulated at the ends and middles of steps, where the four stages need them.
                at = 2 * (substeps * sample + substep)
                rates(settings[0], own, x, inputs[row, at], k1)
                for j in range(width):
                    between[j] = x[j] + half * k1[j]
                rates(settings[0], own, between, inputs[row, at + 1], k2)
                for j in range(width):
                    between[j] = x[j] + half * k2[j]
                rates(settings[0], own, between, inputs[row, at + 1], k3)
                for j in range(width):
                    between[j] = x[j] + step * k3[j]
                rates(settings[0], own, between, inputs[row, at + 2], k4)
                for j in range(width):
                    x[j] += sixth * (k1[j] + 2.0 * (k2[j] + k3[j]) + k4[j])
        states[i] = x
