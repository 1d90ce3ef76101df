"""Simulation of a segment and its sensitivities by condensed multiple shooting, all shots side by side.

A segment is cut into shots of equal length. Each is integrated from a guess of its initial state, together with
small changes of every state and every free parameter, as one batch of arrays (Runge-Kutta of fourth order). Newton
steps on the initial states close the gaps between the shots. The result is the trajectory from the initial state of the
segment; its derivatives by that state and by the parameters follow by the chain rule from shot to shot::

    s[k+1] = end(s[k], θ)       ds[k+1] = Φ[k] ds[k] + G[k] dθ       dy = H ds[k] + J dθ

(H. G. Bock, 1983; here the gaps are closed exactly.) With n samples and shots of about √n the integration takes √n
steps of arrays instead of n steps of scalars.

A model with machine code needs no shots: whole runs, from changed parameters and initial states, take less time.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from mirdrake.identification.models.base import Array, Model, Segment
from mirdrake.identification.models.equations import CompiledModel, EquationModel
from mirdrake.identification.models.simulated import SimulatedModel

_DIFFERENCE = 1e-5
"""Relative change of a state or a scaled parameter for a derivative."""

_CLOSED = 1e-4
"""Gap between shots over the scale of the state below which the remainder is closed to first order."""

_SHARE = 0.3
"""Samples of a shot over √n: a step of long arrays takes little more time than one of short ones [1]."""

_MAX_LENGTH = 160
"""Largest number of samples of a shot."""


@dataclass
class Shots:
    """A segment cut into shots, with the initial states that closed the gaps last.

    Attributes:
        drive: the segment.
        count: number of shots.
        length: samples of each.
        substeps: integration steps per sample.
        times: times of samples, ends and middles of the steps [s].
        nodes: initial states (states, shots).
    """

    drive: Segment
    count: int
    length: int
    substeps: int
    times: Array = field(repr=False)
    nodes: Array = field(repr=False)


def make_shots(model: Model, drive: Segment, p: Mapping[str, float]) -> Shots:
    """Cut a segment into shots.

    Args:
        model: the model.
        drive: segment of at least two samples.
        p: parameters, for guesses of the states.
    """
    n = drive.size
    length = min(max(int(np.ceil(_SHARE * n**0.5)), 20), _MAX_LENGTH, n)
    count = -(-n // length)
    substeps = max(1, int(np.ceil(drive.step / model.max_step - 1e-9)))
    # The last shot reaches beyond the segment, where inputs are held; its extra samples are cut off at the end.
    times = np.asarray(np.arange(count * length * 2 * substeps + 1) * (drive.step / (2 * substeps)), dtype=np.float64)
    rows = np.minimum(np.arange(count) * length, n - 1)
    return Shots(drive, count, length, substeps, times, model.initial_states(p, drive, rows))


@dataclass(frozen=True)
class Sensitivity:
    """A trajectory and its derivatives.

    Attributes:
        y: outputs (outputs, n).
        by_parameters: their derivatives by scaled parameters (outputs, n, parameters).
        by_start: their derivatives by the initial state (outputs, n, states).
        last: state after the last sample (states).
        last_by: its derivatives by parameters and initial state (states, parameters + states).
    """

    y: Array
    by_parameters: Array
    by_start: Array
    last: Array
    last_by: Array


def _inputs(model: EquationModel, shots: Shots, columns: Sequence[Mapping[str, float]], same: Sequence[bool]) -> Array:
    """Return the inputs of the equations (times in a shot, inputs, columns, shots)."""
    base = model.input_signals(columns[0], shots.drive, shots.times)
    step = shots.length * 2 * shots.substeps
    index = np.arange(step + 1)[:, None] + step * np.arange(shots.count)
    first = np.moveaxis(base[:, index], 0, 1)  # times, inputs, shots
    if all(same):
        return np.asarray(first[:, :, None, :])
    # Inputs are computed again only for columns whose parameters change them, such as a delay.
    inputs = np.repeat(first[:, :, None, :], len(columns), axis=2)
    for i, (p, equal) in enumerate(zip(columns, same, strict=True)):
        if not equal:
            inputs[:, :, i] = np.moveaxis(model.input_signals(p, shots.drive, shots.times)[:, index], 0, 1)
    return inputs


def _integrate(model: EquationModel, shots: Shots, x: Array, u: Array, p: Mapping[str, Array]) -> Array:
    """Return the states at all samples and at the end of each shot (length + 1, states, columns, shots)."""
    # Classical Runge-Kutta of fourth order; inputs are given at half steps.
    h = shots.drive.step / shots.substeps
    states = np.empty((shots.length + 1, *x.shape))
    states[0] = x
    half_step = 0
    for sample in range(shots.length):
        for _ in range(shots.substeps):
            k1 = model.rates(x, u[half_step], p)
            k2 = model.rates(x + 0.5 * h * k1, u[half_step + 1], p)
            k3 = model.rates(x + 0.5 * h * k2, u[half_step + 1], p)
            k4 = model.rates(x + h * k3, u[half_step + 2], p)
            x = x + (h / 6.0) * (k1 + 2.0 * (k2 + k3) + k4)
            half_step += 2
        states[sample + 1] = x
    return states


def simulate(
    model: Model,
    shots: Shots,
    columns: Sequence[Mapping[str, float]],
    first: Array,
    *,
    changes: float = _DIFFERENCE,
    derivatives: bool = True,
    closed: bool = False,
) -> Sensitivity | None:
    """Return the trajectory of a segment from its initial state.

    Args:
        model: the model.
        shots: the segment; its nodes are moved to where the gaps are closed.
        columns: parameters, then the same with each free one changed by `changes` in its scale.
        first: initial state (states).
        changes: change of the columns after the first.
        derivatives: whether to compute the derivatives.
        closed: whether the nodes are those that an earlier call with the same numbers left.

    Returns:
        None if the states diverge.
    """
    # Only models with equations can be cut into shots; a plant is simulated as a whole.
    if isinstance(model, SimulatedModel):
        return _difference_runs(model, shots.drive, columns, first, changes, derivatives=derivatives)
    assert isinstance(model, EquationModel)  # the two kinds of models
    if isinstance(model, CompiledModel) and model.uses_machine_code:
        return _compiled_runs(model, shots, columns, first, changes, derivatives=derivatives)
    scales = np.array(model.state_scales)
    size, count = len(scales), shots.count
    # A copy, so that nodes of a run that diverges do not spoil the next one.
    nodes = shots.nodes.copy()
    nodes[:, 0] = first
    names = list(columns[0])

    def batch(sets: Sequence[Mapping[str, float]], same: Sequence[bool]) -> tuple[Array, Array, dict[str, Array]]:
        """Return states, inputs and parameters of: the base, each state changed, each of the further sets."""
        all_sets = [sets[0]] * (1 + size) + list(sets[1:])
        x = np.repeat(nodes[:, None, :], len(all_sets), axis=1)
        for i in range(size):
            x[i, 1 + i] += _DIFFERENCE * scales[i]
        p = {name: np.array([[values[name]] for values in all_sets]) for name in names}
        return x, _inputs(model, shots, all_sets, [True] * (1 + size) + list(same)), p

    closed = closed and derivatives
    moved = np.zeros((size, count))  # shift of the nodes since the path was integrated
    # Trial parameters may overflow on the way to the minimum; the check for finite ends below decides.
    with np.errstate(all="ignore"):
        if not closed:
            x, u, p = batch(columns[:1], [])
        # Newton's method closes the gaps in a few steps; 25 without success mean that the parameters are impossible.
        for _ in range(0 if closed else 25):
            x = np.repeat(nodes[:, None, :], 1 + size, axis=1)
            for i in range(size):
                x[i, 1 + i] += _DIFFERENCE * scales[i]
            path = _integrate(model, shots, x, u, p)
            ends = path[-1]
            if not np.isfinite(ends).all():
                return None
            if count == 1:  # nothing to close
                closed = True
                break
            # One Newton step on all nodes, propagated from shot to shot.
            by_state = (ends[:, 1:] - ends[:, :1]) / (_DIFFERENCE * scales)[None, :, None]
            gaps = ends[:, 0, :-1] - nodes[:, 1:]
            shift = np.zeros((size, count))
            for k in range(count - 1):
                shift[:, k + 1] = by_state[:, :, k] @ shift[:, k] + gaps[:, k]
            largest_shift = float(np.max(np.abs(shift) / scales[:, None]))
            if not np.isfinite(largest_shift) or largest_shift > 1e6:
                return None
            # Far from the solution a full step may leave the range of the model.
            nodes += shift * min(1.0, 20.0 / max(largest_shift, 1e-12))
            if largest_shift < _CLOSED:
                closed, moved = True, shift
                break
        if not closed:
            return None
        # The closed nodes are the start of the next call, whose parameters are usually near.
        shots.nodes = nodes
        # Inputs depend on few parameters: those of unchanged sets are not computed again.
        same = [
            not any(column.get(name) != columns[0].get(name) for name in model.input_parameters)
            for column in columns[1:]
        ]
        if derivatives:
            x, u, p = batch(columns, same)
            path, moved = _integrate(model, shots, x, u, p), np.zeros((size, count))
        return _chain(model, shots, path, u, p, len(columns) - 1 if derivatives else 0, changes, moved)


def _difference_runs(
    model: SimulatedModel,
    drive: Segment,
    columns: Sequence[Mapping[str, float]],
    first: Array,
    changes: float,
    *,
    derivatives: bool,
) -> Sensitivity | None:
    """Return derivatives as differences between complete runs."""
    scales = np.array(model.state_scales)
    size, free = len(scales), len(columns) - 1
    base = model.run(columns[0], drive, first)
    if base is None:
        return None
    y, last = base
    by = np.zeros((*y.shape, free + size))
    last_by = np.zeros((size, free + size))
    if derivatives:
        # Steps in the scaled parameters and states, as in the other methods.
        steps = [*([changes] * free), *(changes * scales)]
        starts = [first] * free + [first + step for step in np.diag(changes * scales)]
        for k, (p, start, step) in enumerate(zip((*columns[1:], *([columns[0]] * size)), starts, steps, strict=True)):
            run = model.run(p, drive, start)
            if run is None:
                return None
            by[:, :, k], last_by[:, k] = (run[0] - y) / step, (run[1] - last) / step
    return Sensitivity(y, by[..., :free], by[..., free:], last, last_by)


def _compiled_runs(
    model: CompiledModel,
    shots: Shots,
    columns: Sequence[Mapping[str, float]],
    first: Array,
    changes: float,
    *,
    derivatives: bool,
) -> Sensitivity | None:
    """Return derivatives as differences between complete runs by machine code, which needs no shots."""
    scales, n = np.array(model.state_scales), shots.drive.size
    size, free = len(scales), len(columns) - 1
    sets, starts = [columns[0]], first[None]
    if derivatives:
        sets = [*columns, *([columns[0]] * size)]
        starts = np.concatenate((np.repeat(starts, free + 1, axis=0), first + np.diag(changes * scales)))

    # Runs with the same inputs share them.
    inputs: dict[tuple[float, ...], int] = {}
    signals: list[Array] = []
    rows: list[int] = []
    times = shots.times[: 2 * shots.substeps * n + 1]
    for p in sets:
        key = tuple(p[name] for name in model.input_parameters if name in p)
        if key not in inputs:
            inputs[key] = len(signals)
            signals.append(model.input_signals(p, shots.drive, times).T)
        rows.append(inputs[key])
    # Runs that differ from the first one by initial state or sensors only converge to its states.
    own = [name for name in columns[0] if name not in model.sensor_parameters]
    follows = [k > 0 and all(p[name] == columns[0][name] for name in own) for k, p in enumerate(sets)]
    runs = model.run_log(
        sets, np.array(signals), rows, starts, shots.drive.step / shots.substeps, shots.substeps, follows
    )
    if not (np.isfinite(runs.outputs).all() and np.isfinite(runs.last).all()):
        return None
    steps = np.concatenate((np.full(free, changes), changes * scales)) if derivatives else np.empty(0)
    # Forward differences: the first run is the base, then the parameters, then the initial states.
    by = np.moveaxis(runs.outputs[1:] - runs.outputs[0], (0, 2), (2, 0)) / steps
    last_by = (runs.last[1:] - runs.last[0]).T / steps
    if not derivatives:
        by, last_by = np.zeros((by.shape[0], n, size)), np.zeros((size, size))
        free = 0
    return Sensitivity(runs.outputs[0].T, by[..., :free], by[..., free:], runs.last[0], last_by)


def _chain(
    model: EquationModel,
    shots: Shots,
    path: Array,
    u: Array,
    p: Mapping[str, Array],
    free: int,
    changes: float,
    nodes: Array,
) -> Sensitivity | None:
    """Return the derivatives along the whole segment by the chain rule.

    `nodes` is the shift of the nodes since the batch was integrated (states, shots).
    """
    scales = np.array(model.state_scales)
    size, n, count = len(scales), shots.drive.size, shots.count
    inside = np.moveaxis(path[:-1], 0, -1)  # states, columns, shots, samples
    seen = np.moveaxis(u[: -1 : 2 * shots.substeps], 0, -1)
    wide = {name: values[:, :, None] for name, values in p.items()}
    y = model.observe(inside, seen, wide)
    if not np.isfinite(y).all():
        return None
    outputs = len(y)
    by_state = (y[:, 1 : 1 + size] - y[:, :1]) / (_DIFFERENCE * scales)[None, :, None, None]
    # One-sided differences: half the runs of central ones, and exact enough at a relative change of 1e-5.
    by_free = (y[:, 1 + size :] - y[:, :1]) / changes
    ends = path[-1]
    phi = (ends[:, 1 : 1 + size] - ends[:, :1]) / (_DIFFERENCE * scales)[None, :, None]
    gain = (ends[:, 1 + size :] - ends[:, :1]) / changes
    # At the first node, the initial state moves by itself, and parameters do not move it.
    moved = np.zeros((count + 1, size, free + size))
    moved[0, :, free:] = np.eye(size)
    for k in range(count):
        moved[k + 1] = phi[:, :, k] @ moved[k]
        moved[k + 1, :, :free] += gain[:, :, k]
    # outputs, shots, samples, unknowns
    total = np.einsum("oskn,ksu->oknu", by_state, moved[:count], optimize=True)
    if free:
        total[..., :free] += np.moveaxis(by_free, 1, -1)
    total = total.reshape(outputs, -1, free + size)[:, :n]
    # The remaining gaps are closed to first order, so that the trajectory belongs to the initial state exactly.
    shown = y[:, 0] + np.einsum("oskn,sk->okn", by_state, nodes)
    last = ends[:, 0, -1] + phi[:, :, -1] @ nodes[:, -1]
    whole = shown.reshape(outputs, -1)[:, :n]
    return Sensitivity(whole, total[..., :free], total[..., free:], last, moved[count])
