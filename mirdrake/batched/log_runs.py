"""A model driven by the inputs of a recorded log, for many sets of parameters in one compiled loop."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from multiprocessing import parent_process
from typing import Any, NamedTuple

import numpy as np

from mirdrake.batched.arrays import Floats, Integers, Mask
from mirdrake.core.compiled import Records, compiled


class LogEquations(NamedTuple):
    """Equations ẋ = f(x, u, p), y = h(x, u, p) as functions that can be compiled.

    Attributes:
        rates: (settings, p, x, u, ẋ): writes the derivatives of a row of states.
        observe: (settings, p, x, u, ẋ, y): writes the derivatives and the outputs, which share most of their terms.
        parts: functions that these call, directly or indirectly.
    """

    rates: Callable[[Any, Any, Sequence[float], Sequence[float], Any], None]
    observe: Callable[[Any, Any, Sequence[float], Sequence[float], Any, Any], None]
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
    follows: Sequence[bool] | None = None,
    tolerances: Floats | None = None,
) -> LogRuns:
    """Return the outputs of a model along a log, for n sets of parameters and initial states.

    Each run is integrated by Runge-Kutta steps from its initial state. A run that diverges ends in numbers that are
    not finite; the others do not change.

    A run whose derivatives are the functions of those of the first run, but whose initial state differs, converges to
    it if the model is stable. Once its states are equal to those of the first run within tolerances, they are taken
    from there, and only its outputs are computed.

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
        follows: whether a run has inputs and derivatives of the first one (n); none if left out.
        tolerances: difference of each state below which it then counts as equal (states).
    """
    # A copy: the kernel overwrites the states.
    last = np.array(starts, dtype=float)
    samples = (inputs.shape[1] - 1) // (2 * substeps)
    seen: Floats = np.empty((len(last), samples, outputs))
    kernel = compiled(_run, (equations.rates, equations.observe), parts=equations.parts, nogil=True)
    sets: Integers = np.asarray(rows, dtype=np.int64)
    joins: Mask = np.zeros(len(last), dtype=bool) if follows is None else np.asarray(follows, dtype=bool)
    equal: Floats = np.zeros(last.shape[1]) if tolerances is None else np.asarray(tolerances, dtype=float)
    arguments = (settings, parameters, np.ascontiguousarray(inputs), sets, joins, equal, float(step), int(substeps))
    changed = (last, np.empty((samples, last.shape[1])), seen)
    # The first run alone, as the others may read its states.
    kernel(*arguments, np.zeros(1, dtype=np.int64), *changed)
    # Runs that follow end early: whole runs first, dealt to the threads in turn, which are then equally busy.
    others: Integers = 1 + np.argsort(joins[1:], kind="stable")
    threads = min(_threads(), len(others))
    if threads < 2:
        kernel(*arguments, others, *changed)
        return LogRuns(seen, last)
    calls = [_pool().submit(kernel, *arguments, others[k::threads].copy(), *changed) for k in range(threads)]
    # The result is awaited to raise the exception of a thread here, which submit alone would hide.
    for call in calls:
        call.result()
    return LogRuns(seen, last)


def _run(
    rates: Callable[..., None],
    observe: Callable[..., None],
    settings: Any,
    parameters: Any,
    inputs: Floats,
    rows: Integers,
    follows: Mask,
    tolerances: Floats,
    step: float,
    substeps: int,
    chosen: Integers,
    states: Floats,
    path: Floats,
    outputs: Floats,
) -> None:
    """Integrate the chosen runs; other arguments as in :func:`run_log`.

    States, the path of the first run (samples, states) and outputs are overwritten.
    """
    # The stages of the Runge-Kutta method share buffers over all runs.
    width = states.shape[1]
    x, between = np.empty(width), np.empty(width)
    k1, k2, k3, k4 = np.empty(width), np.empty(width), np.empty(width), np.empty(width)
    half, sixth = 0.5 * step, step / 6.0
    for i in chosen:
        own, row, joined = parameters[i], rows[i], False
        x[:] = states[i]
        for sample in range(outputs.shape[1]):
            if follows[i] and not joined:
                joined = True
                for j in range(width):
                    # Written so that NaN counts as different.
                    if not abs(x[j] - path[sample, j]) <= tolerances[j]:
                        joined = False
            if joined:
                x[:] = path[sample]
            elif i == 0:
                path[sample] = x
            # Outputs before the step: those of a sample belong to its own time.
            observe(settings[0], own, x, inputs[row, 2 * substeps * sample], k1, outputs[i, sample])
            if joined:
                continue
            for substep in range(substeps):
                # Inputs are tabulated at the ends and middles of steps, where the four stages need them.
                at = 2 * (substeps * sample + substep)
                if substep > 0:
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
        states[i] = states[0] if joined else x


def _threads() -> int:
    """Return the number of threads: a core each, and one in a worker process, of which each core has one."""
    return 1 if parent_process() is not None else os.cpu_count() or 1


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(_threads())
