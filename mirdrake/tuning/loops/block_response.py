"""Linear models of a diagram around one of its blocks, and of the block for any values of its parameters.

All inputs of the block are cut. With the row C(z) of the block from its inputs to its control, and the column P(z) of
everything else from the control to the sources of these inputs, the loop transfer function is ``L = -C P``. The diagram
is linearised once, with the present parameters: that gives the products ``P C`` and so P. For each candidate the
block alone is linearised, so that the margins of any candidate are those of the linear loop, without a fit.

A block with continuous state counts as one that is sampled with the period of the slowest control unit, which adds up
to half of it to the delay of the loop.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from pydrake.systems.analysis import Simulator

from mirdrake.assembly.diagram import assemble
from mirdrake.assembly.diagram_spec import make_spec
from mirdrake.core.errors import ConfigError
from mirdrake.tuning.frequency_response import FrequencyResponse
from mirdrake.tuning.linearise import (
    BEFORE,
    advanced_state,
    central_differences,
    connected_states,
    state_of,
    with_state,
)
from mirdrake.tuning.loops.base import BlockModel, LoopSpec
from mirdrake.tuning.loops.controller_block import ControllerBlock, tuned_blocks
from mirdrake.tuning.margins import LoopResponse
from mirdrake.tuning.models import Complexes, Floats

SAMPLES = 400
"""Frequencies at which the linear model is evaluated."""

NEGLIGIBLE = 1e-9
"""Share of the largest loop gain over all inputs below which an input has no part in the loop."""

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class StateSpace:
    """Discrete-time model x[k+1] = A x[k] + B u[k], y[k] = C x[k] + D u[k] with n states, m inputs, p outputs."""

    A: Array
    B: Array
    C: Array
    D: Array
    period: float

    def response(self, frequencies: Floats) -> Complexes:
        """Return C (z - A)^-1 B + D at frequencies [rad/s] (k), shape (k, p, m)."""
        # States without connection to input and output, as the position of a car, have no part in the model.
        connected = connected_states(self.A, self.B, self.C)
        z = np.exp(1j * np.asarray(frequencies, dtype=float) * self.period)
        resolvent = z[:, None, None] * np.eye(len(connected)) - self.A[np.ix_(connected, connected)]
        inner = np.linalg.solve(
            resolvent, np.broadcast_to(self.B[connected], (len(z), len(connected), self.B.shape[1]))
        )
        return np.asarray(self.C[:, connected] @ inner + self.D, dtype=complex)


def linearise_around(spec: LoopSpec, block: str) -> BlockModel:
    """Return the linear model of everything but a block of a diagram.

    Args:
        spec: the loop; its diagram has the block as a TunedBlock with the present parameters and a control.
        block: name of the block.

    Raises:
        ConfigError: the diagram cannot be built or simulated, or the loop is not closed.
    """
    period = float(spec.period or 0.0)
    # Neither logs nor reports: the diagram is stepped twice per state.
    record = dict(spec.diagram.get("record", {})) | {"signals": False, "meshcat": False, "report": False}
    assembly = assemble(make_spec(spec.diagram | {"record": record}))
    part = tuned_blocks(assembly)[block].block
    # The operating point is just before a whole period, so that all updates at that time belong to the next step.
    context = assembly.make_context()
    simulator = assembly.make_simulator(context)
    simulator.Initialize()
    simulator.AdvanceTo((round(spec.course.step_time / period) - BEFORE) * period)
    own = part.GetMyMutableContextFromRoot(context)
    values, state = part.values(own), state_of(own)
    part.cut(own, values)
    # Other blocks that are tuned are those of outer loops, which are open while an inner one is designed.
    for name, other in tuned_blocks(assembly).items():
        if name != block:
            inside = other.block.GetMyMutableContextFromRoot(context)
            other.block.cut(inside, other.block.values(inside))

    def advance(x: Array, u: Array) -> tuple[Array, Array]:
        changed = with_state(context, x)
        inside = part.GetMyMutableContextFromRoot(changed)
        part.cut(inside, u)
        sources = part.values(inside)
        return advanced_state(assembly.make_simulator(changed), period), sources

    whole = StateSpace(*central_differences(advance, state_of(context), values), period)
    # Aliases are neglected, so the range ends below the Nyquist frequency.
    top = 0.999 * math.pi / period
    frequencies = np.geomspace(1e-4 * top, top, SAMPLES)
    products = whole.response(frequencies)
    entry = spec.diagram["systems"][block]
    known = BlockModel(
        entry["entry"], entry["parameters"], entry["control"], period, entry["folder"], tuple(values), tuple(state)
    )
    row = controller_model(known, spec.present).response(frequencies)[:, 0, :]
    size = np.sum(np.abs(row) ** 2, axis=1)
    if not size.any():
        raise ConfigError(
            f"the control of '{block}' does not depend on its inputs: its gains are zero, or it is at a limit; write "
            "gains with which the loop is stable into the diagram"
        )
    # Least squares of the products P C by the columns of C: exact, as their rank is one.
    observable = size > 0.0
    column = np.einsum("kji,ki->kj", products[observable], row[observable].conj()) / size[observable, None]
    gains = np.abs(column * row[observable])
    used = gains.max(axis=0) > NEGLIGIBLE * gains.max()
    # An infinite or zero response has no logarithm for the interpolation.
    good = np.isfinite(column).all(axis=1) & (np.abs(column[:, used]) > 0.0).all(axis=1)
    if good.sum() < 2 or not used.any():
        raise ConfigError(f"no input of '{block}' follows its control; is the loop connected?")
    responses = tuple(
        (int(index), tuple((float(x.real), float(x.imag)) for x in column[good, index]))
        for index in np.flatnonzero(used)
    )
    return replace(known, frequencies=tuple(map(float, frequencies[observable][good])), responses=responses)


def controller_model(model: BlockModel, gains: Mapping[str, float]) -> StateSpace:
    """Return the linear model of a block from its inputs to its control, with values of its parameters.

    Raises:
        ConfigError: the block cannot be made with them.
    """
    parameters = {name.rpartition(".")[2]: float(value) for name, value in gains.items()}
    system = ControllerBlock(model.entry, model.parameters | parameters, model.folder)
    context = system.CreateDefaultContext()
    sizes = np.cumsum([port.size() for port in system.inputs])[:-1]
    values = np.array(model.values)
    output = next(port for port in system.outputs if port.get_name() == model.control)

    def prepared(x: Array, u: Array) -> Any:
        changed = with_state(context, x)
        for port, part in zip(system.inputs, np.split(u, sizes), strict=True):
            port.FixValue(changed, part)
        changed.SetTime(model.period * (1.0 - BEFORE))
        return changed

    def advance(x: Array, u: Array) -> tuple[Array, Array]:
        changed = prepared(x, u)
        y = np.array(output.Eval(changed))
        return advanced_state(Simulator(system, changed), model.period), y

    # One period with the new parameters: a controller may adapt its state to a change of its gains.
    state, _ = advance(np.array(model.state), values)
    return StateSpace(*central_differences(advance, state, values), model.period)


def loop_of(model: BlockModel, gains: Mapping[str, float]) -> LoopResponse:
    """Return the loop transfer function L(jω) of a block with values of its parameters, negative feedback."""
    controller = controller_model(model, gains)
    w = np.array(model.frequencies)
    parts = {index: FrequencyResponse(w, np.array(pairs) @ np.array([1.0, 1.0j])) for index, pairs in model.responses}

    def response(frequencies: Floats) -> Complexes:
        row = controller.response(frequencies)[:, 0, :]
        # The grid of a search for margins may end a rounding error beyond that of the model.
        inside = np.clip(frequencies, w[0], w[-1])
        return np.asarray(-sum(row[:, index] * part.response(inside) for index, part in parts.items()), dtype=complex)

    return response
