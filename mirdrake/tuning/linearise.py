"""Linear model of a diagram between any input and any output, around an operating point.

The whole diagram is advanced by one period T with its input held: x[k+1] = f(x[k], u[k]), y[k] = g(x[k], u[k]). The
state x is that of all systems, right before the update at a multiple of T. Central differences give

    A = df/dx,  B = df/du,  C = dg/dx,  D = dg/du,

a discrete-time model with the sampling rate of the control unit; plants, controllers and user systems with faster rates
that divide T are part of it. States that the input does not reach, or that do not act on the output, are left out.

Source: K. J. Åström and B. Wittenmark, Computer-Controlled Systems, 3rd ed., chapter 2.
"""

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from pydrake.systems.analysis import InitializeParams, Simulator
from pydrake.systems.framework import BasicVector, Context

from mirdrake.assembly.diagram import Assembly, assemble, make_spec
from mirdrake.core.errors import ConfigError, MissingDependencyError
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.tuning.margins import Margins, margins_of

if TYPE_CHECKING:
    import control

Array = npt.NDArray[np.float64]

PROBE = "linear_input"
"""Name of the system that is inserted at the input."""

STEP = 1e-6
"""Change of a value by which differences are taken, relative to its size or one."""

BEFORE = 1e-9
"""Share of a period by which a state is read before the updates at the end of the period."""

NEGLIGIBLE = 1e-12
"""Entries of A, B and C below this share of the largest one do not connect states."""


class Probe(LeafSystem):  # type: ignore[misc, unused-ignore]
    """A connection that can be cut: y = gain · u + offset.

    Input ports:
        u (1): from the source of the connection.

    Output ports:
        y (1): to its sink.

    Parameters of the Context: 0: gain (1 connected, 0 cut), offset.
    """

    def __init__(self) -> None:
        super().__init__()
        self.u = self.DeclareVectorInputPort("u", 1)
        self._parameter = self.DeclareNumericParameter(BasicVector([1.0, 0.0]))
        needs = {self.u.ticket(), self.all_parameters_ticket()}
        self.y = self.DeclareVectorOutputPort("y", BasicVector(1), self._calc, prerequisites_of_calc=needs)

    def _calc(self, context: Context, output: BasicVector) -> None:
        gain, offset = context.get_numeric_parameter(self._parameter).value()
        output[0] = offset if gain == 0.0 else gain * self.u.Eval(context)[0] + offset

    def set(self, context: Context, gain: float, offset: float) -> None:
        """Write gain and offset into a Context of this system."""
        context.get_mutable_numeric_parameter(self._parameter).SetFromVector([gain, offset])


@dataclass(frozen=True)
class LinearModel:
    """Linear model between an input and an output.

    Attributes:
        system: discrete-time state space of python-control.
        input: name of the input.
        output: name of the output.
        operating_point: value of the input, and of the output, at which it was linearised.
        is_loop: whether it is the whole loop through the input, cut there: the output is the source of the input.
    """

    system: "control.StateSpace"
    input: str
    output: str
    operating_point: tuple[float, float]
    is_loop: bool

    def response(self, frequencies: Array) -> npt.NDArray[np.complex128]:
        """Return the frequency response at frequencies [rad/s]."""
        points = np.exp(1j * np.asarray(frequencies, dtype=float) * self.system.dt)
        result: npt.NDArray[np.complex128] = np.atleast_1d(self.system(points))
        return result

    def loop(self, frequencies: Array) -> npt.NDArray[np.complex128]:
        """Return the loop transfer function with negative feedback at frequencies [rad/s].

        Of a whole loop it is the negative response: the signs within the loop are part of the model. Any other model is
        taken as the plant of a loop with unit feedback.
        """
        return -self.response(frequencies) if self.is_loop else self.response(frequencies)

    def margins(self, *, lowest: float = 0.01) -> Margins:
        """Return the stability margins of the loop, from a frequency [rad/s] to the Nyquist frequency."""
        return margins_of(self.loop, lowest, 0.999 * np.pi / self.system.dt)

    def bode(self, *, lowest: float = 0.01) -> Any:
        """Return a figure of magnitude and phase, from a frequency [rad/s] to the Nyquist frequency."""
        import matplotlib.pyplot as plt

        # The response of a sampled model ends at the Nyquist frequency.
        frequencies = np.geomspace(lowest, 0.999 * np.pi / self.system.dt, 400)
        response = self.loop(frequencies) if self.is_loop else self.response(frequencies)
        figure, (above, below) = plt.subplots(2, 1, sharex=True, figsize=(8.0, 5.0), layout="constrained")
        above.loglog(frequencies, np.abs(response))
        below.semilogx(frequencies, np.degrees(np.unwrap(np.angle(response))))
        above.set_title(f"{self.input} to {self.output}" + (", cut, negative feedback" if self.is_loop else ""))
        above.set_ylabel("magnitude")
        below.set(xlabel="frequency [rad/s]", ylabel="phase [deg]")
        for axes in (above, below):
            axes.grid(alpha=0.3, which="both")
        plt.close(figure)  # a notebook shows the returned figure once
        return figure

    def step(self, duration: float) -> Any:
        """Return the response to a unit step over time [s] as a pandas Series."""
        import control
        import pandas as pd

        times = np.arange(round(duration / self.system.dt) + 1) * self.system.dt
        result = control.forced_response(self.system, times, np.ones(len(times)))
        return pd.Series(np.ravel(result.outputs), index=pd.Index(times, name="time"), name=self.output)


def linearise(
    data: Mapping[str, Any],
    factories: Mapping[str, Any],
    input: str,  # noqa: A002
    output: str | None,
    *,
    time: float,
    cut: bool,
    period: float | None = None,
) -> LinearModel:
    """Return the linear model between an input and an output of a diagram.

    Args:
        data: the diagram as plain data.
        factories: of its Python systems.
        input: name of an input, or of an element of it.
        output: name of an output, or of an element of it; None: the source that is connected to the input.
        time: time at which the operating point is read [s].
        cut: whether the connection to the input is cut; otherwise the model is that of a disturbance at the input.
        period: period T of the model [s]; that of the slowest control unit if left out. All discrete updates must
            repeat with it.

    Raises:
        ConfigError: no such port, the input has no source or more than one element, or periods do not fit.
        MissingDependencyError: python-control is not installed.
    """
    try:
        import control
    except ImportError:
        raise MissingDependencyError("linear models need python-control: pip install 'mirdrake[tuning]'") from None
    source, assembly, output = _insert_probe(data, factories, input, output)
    output = output or source
    if period is None:
        # A discrete model needs one period after which every unit has been updated: that of the slowest unit.
        period = 1.0 / min(part.vehicle.control.rate for part in assembly.parts.vehicles.values())
    stepper = _Stepper(assembly, output, period=period)
    # The operating point is just before a whole period, so that all updates at that time belong to the next step.
    context = stepper.settle(round(time / period) * period, cut=cut)
    u0, y0 = stepper.offset, stepper.output(context)
    A, B, C, D = stepper.differences(context)
    # States without connection to input and output, as the position of a car, have no part in the model.
    connected = connected_states(A, B, C)
    system = control.ss(A[np.ix_(connected, connected)], B[connected], C[:, connected], D, period)
    return LinearModel(system, input, output, (u0, y0), cut and output == source)


def _insert_probe(
    data: Mapping[str, Any], factories: Mapping[str, Any], name: str, output: str | None
) -> tuple[str, Assembly, str | None]:
    """Return the source of an input, and the diagram with a probe between the two."""
    # Plain data of the diagram, copied: the caller's diagram stays unchanged.
    changed = copy.deepcopy(dict(data))
    pairs = [list(pair) for pair in changed.get("connect", ())]
    source = next((pair[0] for pair in pairs if pair[1] == name), None)
    if source is None:
        # The first pass finds the source that the diagram connects by default.
        look = copy.deepcopy(changed)
        look["systems"] = dict(look.get("systems", {})) | {PROBE: {"kind": "constant", "value": [0.0]}}
        look["connect"] = [*pairs, [f"{PROBE}.y", name]]
        first = assemble(make_spec(look), factories=factories, expand=True)
        source = first.default_source(name)
        if source is None:
            raise ConfigError(f"linearize: input '{name}' has no source; connect it first")

    # The probe takes the place of the connection: source -> probe -> input.
    changed["connect"] = [pair for pair in pairs if pair[1] != name] + [[source, f"{PROBE}.u"], [f"{PROBE}.y", name]]
    changed["systems"] = dict(changed.get("systems", {})) | {PROBE: {"kind": f"{__name__}:Probe"}}
    # Neither logs nor reports: the probe diagram is stepped twice per state.
    record = dict(changed.get("record", {})) | {"signals": False, "meshcat": False, "report": False}
    spec = make_spec(changed | {"record": record})
    return source, assemble(spec, factories=dict(factories) | {PROBE: Probe}, expand=True), output


class _Stepper:
    """Advances a diagram by one period from changed states.

    Args:
        assembly: the diagram with its probe.
        output: name of the output.
        period: period T [s].
    """

    def __init__(self, assembly: Assembly, output: str, *, period: float) -> None:
        self._assembly, self._period, self._diagram = assembly, period, assembly.diagram
        self._probe: Any = assembly.diagram.GetSubsystemByName(PROBE)
        self._port, self._index = assembly.output_port(output)
        self.offset = 0.0

    def settle(self, time: float, *, cut: bool) -> Context:
        """Return the Context at a time, its input cut at the value that it has there, or still connected."""
        context = self._assembly.make_context()
        simulator = self._assembly.make_simulator(context)
        simulator.Initialize()
        # Before the updates at `time`: BEFORE is far below all periods.
        simulator.AdvanceTo(time - BEFORE * self._period)
        # First as a through connection (gain 1) to read the operating input.
        own = self._probe.GetMyMutableContextFromRoot(context)
        self._gain, self.offset = 1.0, 0.0
        value = float(self._probe.y.Eval(own)[0])
        # Cut: gain 0 and the operating value as a constant, so that the operating point stays.
        if cut:
            self._gain, self.offset = 0.0, value
            self._probe.set(own, 0.0, value)
        return context.Clone()

    def output(self, context: Context) -> float:
        """Return the output at a Context."""
        system = self._port.get_system()
        return float(self._port.Eval(system.GetMyContextFromRoot(context))[self._index])

    def _evaluate(self, context: Context, state: Array, offset: float) -> tuple[Array, Array]:
        """Return the state after a period, and the output before it."""
        changed = with_state(context, state)
        self._probe.set(self._probe.GetMyMutableContextFromRoot(changed), self._gain, offset)
        y = np.array([self.output(changed)])
        return advanced_state(self._assembly.make_simulator(changed), self._period), y

    def differences(self, context: Context) -> tuple[Array, Array, Array, Array]:
        """Return A, B, C and D by central differences."""
        return central_differences(
            lambda x, u: self._evaluate(context, x, float(u[0])), state_of(context), np.array([self.offset])
        )


def state_of(context: Context) -> Array:
    """Return the discrete and continuous state of a Context as one vector."""
    groups = [context.get_discrete_state(i).value() for i in range(context.num_discrete_state_groups())]
    return np.concatenate([*groups, context.get_continuous_state_vector().CopyToVector()])


def with_state(context: Context, state: Array) -> Context:
    """Return a copy of a Context with another state, as :func:`state_of` returns it."""
    result, start = context.Clone(), 0
    for i in range(result.num_discrete_state_groups()):
        size = result.get_discrete_state(i).size()
        result.SetDiscreteState(i, state[start : start + size])
        start += size
    if result.num_continuous_states():
        result.SetContinuousState(state[start:])
    return result


def advanced_state(simulator: Simulator, period: float) -> Array:
    """Return the state after a period [s] from the Context of a Simulator; initialisation events are left out."""
    parameters = InitializeParams()
    # Initialisation would reset discrete states that have been perturbed.
    parameters.suppress_initialization_events = True
    simulator.Initialize(parameters)
    simulator.AdvanceTo(simulator.get_context().get_time() + period)
    return state_of(simulator.get_context())


def central_differences(
    advance: Callable[[Array, Array], tuple[Array, Array]], x: Array, u: Array
) -> tuple[Array, Array, Array, Array]:
    """Return A, B, C and D by central differences; states that are not finite are kept as they are.

    Args:
        advance: returns the state after a period, and the outputs (p) before it, for a state (n) and inputs (m).
        x: state (n) of the operating point.
        u: inputs (m) of the operating point.
    """
    n, m = len(x), len(u)
    columns: list[tuple[Array, Array] | None] = []
    # Relative step for large values, absolute for small ones; central differences have an error of its square.
    for i, value in enumerate(np.concatenate([x, u])):
        # A state that is not finite marks something and has no derivative.
        if not np.isfinite(value):
            columns.append(None)
            continue
        step = STEP * max(1.0, abs(value))
        high, low = (advance(_plus(x, i, s), u) if i < n else advance(x, _plus(u, i - n, s)) for s in (step, -step))
        columns.append((_slope(high[0], low[0], step), (high[1] - low[1]) / (2.0 * step)))
    p = next((len(column[1]) for column in columns if column is not None), 1)
    A, C = np.zeros((n, n + m)), np.zeros((p, n + m))
    for i, column in enumerate(columns):
        if column is not None:
            A[:, i], C[:, i] = column
    return A[:, :n], A[:, n:], C[:, :n], C[:, n:]


def _plus(x: Array, index: int, step: float) -> Array:
    changed = x.copy()
    changed[index] += step
    return changed


def _slope(high: Array, low: Array, step: float) -> Array:
    """Return the difference quotient; zero where a state is not finite."""
    with np.errstate(invalid="ignore"):
        slope: Array = (high - low) / (2.0 * step)
    slope[~np.isfinite(slope)] = 0.0
    return slope


def connected_states(A: Array, B: Array, C: Array) -> npt.NDArray[np.intp]:
    """Return the states that the inputs reach and that act on the outputs."""
    # An all-zero matrix connects nothing: with infinity as size no element exceeds the threshold.
    sizes = [float(np.abs(matrix).max(initial=0.0)) or inf for matrix in (A, B, C)]
    a, b, c = (np.abs(matrix) > NEGLIGIBLE * size for matrix, size in zip((A, B, C), sizes, strict=True))
    reached, acting = b.any(axis=1), c.any(axis=0)
    # Paths through n states have at most n steps.
    for _ in range(len(A)):
        reached, acting = reached | (a @ reached), acting | (a.T @ acting)
    return np.flatnonzero(reached & acting)
