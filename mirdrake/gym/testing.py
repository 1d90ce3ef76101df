"""Unit tests of user systems: set inputs, record outputs, compare them with a closed form.

::

    from math import exp
    from mirdrake.gym.testing import assert_follows, drive

    response = drive(Lag(time_constant=0.5), inputs={"u": 1.0}, duration=3.0)
    assert_follows(response["y"], lambda t: 1.0 - exp(-t / 0.5), atol=1e-6)

:func:`drive` takes a system or a diagram file with vehicles; :func:`evaluate` returns the outputs at the start. Ports
have their names; ``port.element`` is an element of a vector with names. Equal calls give equal bits.
"""

from collections.abc import Callable, Mapping, Sequence
from math import isfinite
from typing import Any, TypeVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import (
    BasicVector,
    Context,
    Diagram,
    DiagramBuilder,
    FixedInputPortValue,
    InputPort,
    OutputPort,
    PortDataType,
    System,
)

from mirdrake.assembly.diagram import DiagramSpec, assemble, load_diagram, make_spec
from mirdrake.assembly.wiring import JOIN
from mirdrake.core.errors import ConfigError, DiagramError, did_you_mean
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import signals_of
from mirdrake.runs.simulation import Simulation
from mirdrake.runs.stop import StopReason

Array = NDArray[np.float64]
PortT = TypeVar("PortT", InputPort, OutputPort)
Input = Any
"""Constant, function of time [s], or table, which is interpolated: a pandas Series or DataFrame, or (times, values)."""

_ACCURACY = 1e-8  # relative accuracy of the integrator of systems with continuous state
_TIME_TOLERANCE = 1e-9  # [s]
_BEFORE = 1.0 - 4.0 * float(np.finfo(float).eps)  # factor of a time just before the update of that time


def drive(
    system: System | DiagramSpec | Mapping[str, Any] | str,
    *,
    inputs: Mapping[str, Input] | None = None,
    duration: float = 1.0,
    outputs: Sequence[str] | None = None,
    period: float | None = None,
    prepare: Callable[[Context], None] | None = None,
) -> pd.DataFrame:
    """Simulate a system with given inputs and return its outputs over time.

    A row of a sampled system has the values before the update of its time, as in Drake's logs.

    Args:
        system: a system, which can be driven repeatedly; or a diagram's name, file, spec or data. In a diagram the
            inputs of vehicles without a driver are driven: ``ego.speed_reference`` [m/s], ``ego.steering_reference``
            [rad]; the time stamp of their commands is current by default.
        inputs: constants, functions of time or tables by port or ``port.element``; any object for an abstract port. The
            only port of a system of Drake is ``u``.
        duration: simulated time [s]; 0 gives the start only.
        outputs: names of ports or ``port.element``, of a diagram signals of a run; by default all vectors.
        period: time between rows [s]; by default 1 % of the duration, of a diagram ``record.rate``.
        prepare: function that changes the Context of the system before the start, for example its state.

    Returns:
        a row for each sample, index ``time`` [s]; a column for each port, or for each element ``port.element`` of a
        vector. ``attrs["units"]`` has the units of ports with named signals.

    Raises:
        DiagramError: an input or output is unknown or missing, or its size is wrong.
        ConfigError: the file is unknown, or a time is not allowed.
    """
    if not (isfinite(duration) and duration >= 0.0):
        raise ConfigError(f"duration {duration} s is not allowed; it must be 0 or more")
    if period is not None and not (isfinite(period) and period > 0.0):
        raise ConfigError(f"period {period} s is not allowed; it must be above 0")
    if not isinstance(system, System):
        return _drive_file(system, inputs or {}, duration, outputs, period, prepare)
    # Defaults: 100 intervals; with duration 0 any step, as there is one row only.
    bench = _bench(system, inputs or {})
    step = period or (duration / 100.0 if duration else 1.0)
    context = bench.diagram.CreateDefaultContext()
    if prepare is not None:
        prepare(system.GetMyMutableContextFromRoot(context))
    simulator = Simulator(bench.diagram, context)
    # The default accuracy of Drake's integrators would exceed the tolerances of a closed form.
    if context.num_continuous_states():
        simulator.get_mutable_integrator().set_target_accuracy(_ACCURACY)
    simulator.Initialize()
    columns = _columns(system, outputs)
    # Multiples of the step, not sums, with a tolerance so that rounding does not drop the last row.
    times = np.arange(int(np.floor(duration / step + 1e-6)) + 1) * step
    rows = []
    for time in times:
        if time > 0.0:  # advancing to time 0 would perform its update
            simulator.AdvanceTo(time * _BEFORE)
        inner = system.GetMyContextFromRoot(context)
        rows.append([_read(port, element, inner) for _, port, element, _ in columns])
    frame = pd.DataFrame(rows, columns=[name for name, *_ in columns], index=pd.Index(times, name="time"))
    frame.attrs["units"] = {name: unit for name, _, _, unit in columns}
    return frame


def evaluate(system: System, inputs: Mapping[str, Input] | None = None, **options: Any) -> Mapping[str, Any]:
    """Return the outputs of a system at its start, for systems without state.

    Args:
        system: a system.
        inputs: inputs, see :func:`drive`.
        **options: ``outputs`` and ``prepare`` of :func:`drive`.

    Returns:
        values by the names of the columns of :func:`drive`.
    """
    frame = drive(system, inputs=inputs, duration=0.0, **options)
    values = {str(name): frame[name].iloc[0] for name in frame}
    return {name: float(value) if isinstance(value, np.floating) else value for name, value in values.items()}


def assert_follows(
    actual: pd.Series,
    expected: Callable[[float], float] | Sequence[float] | Array | pd.Series | float,
    *,
    atol: float,
    rtol: float = 0.0,
    after: float = 0.0,
) -> None:
    """Assert that samples follow a closed form.

    Args:
        actual: samples over time, a column of :func:`drive` or of a run's signals.
        expected: function of time [s], a number for each sample, or one number for all samples.
        atol: absolute tolerance, in the unit of the samples.
        rtol: tolerance relative to the expected value; both tolerances are added.
        after: time before which samples are ignored [s].

    Raises:
        AssertionError: samples differ; the message has the largest difference, its time, and the number of samples.
        ConfigError: a tolerance is not finite, a run has no samples, or the numbers of samples differ.
    """
    if not (isfinite(atol) and atol >= 0.0 and isfinite(rtol) and rtol >= 0.0):
        raise ConfigError(f"atol {atol}, rtol {rtol}: tolerances must be finite and not negative")
    # A series carries its times as the index; an array of expected values has to match it sample by sample.
    times = np.asarray(actual.index, dtype=float)
    values = np.asarray(actual, dtype=float)
    if callable(expected):
        targets = np.array([float(expected(float(time))) for time in times])
    else:
        targets = np.asarray(expected, dtype=float)
        targets = np.full(values.shape, float(targets)) if targets.ndim == 0 else targets
    if targets.shape != values.shape:
        raise ConfigError(f"expected has {targets.size} numbers for {values.size} samples; give as many, or a function")
    # Tests that evaluate no sample would always pass, hence the error.
    evaluated = times >= after - _TIME_TOLERANCE
    if not evaluated.any():
        raise ConfigError(f"no samples after {after:g} s; the last one is at {times[-1] if times.size else 0.0:g} s")
    times, values, targets = times[evaluated], values[evaluated], targets[evaluated]
    # Bound of numpy.allclose: absolute plus relative tolerance.
    excess = np.abs(values - targets) - (atol + rtol * np.abs(targets))
    outside = ~(excess <= 0.0)  # also NaN
    if not outside.any():
        return
    # NaN counts as the largest difference.
    worst = int(np.argmax(np.where(np.isfinite(excess), excess, np.inf)))
    name = actual.name if actual.name is not None else "the signal"
    raise AssertionError(
        f"{name} is {values[worst]:.9g} at t = {times[worst]:g} s, expected {targets[worst]:.9g}: the difference is "
        f"{abs(values[worst] - targets[worst]):.3g}, allowed {atol + rtol * abs(targets[worst]):.3g}; "
        f"{int(outside.sum())} of {outside.size} samples are outside"
    )


# --- one system ----------------------------------------------------------------------------------------------------


class _Source(LeafSystem):  # type: ignore[misc, unused-ignore]
    """Source of an input port; its value can be replaced before the next simulation."""

    def __init__(self, port: InputPort) -> None:
        super().__init__()
        self.value: Callable[[float], Any]
        if port.get_data_type() == PortDataType.kVectorValued:
            self.DeclareVectorOutputPort("y", BasicVector(port.size()), self._calc_vector)
        else:
            self.DeclareAbstractOutputPort("y", port.Allocate, self._calc_value)

    def _calc_vector(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self.value(context.get_time()))

    def _calc_value(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self.value(context.get_time()))


class _Bench:
    """A system with sources at its inputs; built once, as Drake allows a system in one diagram only."""

    def __init__(self, system: System, driven: Sequence[str], ports: Mapping[str, InputPort]) -> None:
        builder = DiagramBuilder()
        builder.AddSystem(system)
        self.sources: dict[str, _Source] = {}
        # Inputs are fed by systems and not fixed in the Context, so that they may change during a step.
        for name in driven:
            self.sources[name] = builder.AddSystem(_Source(ports[name]))
            builder.Connect(self.sources[name].get_output_port(), ports[name])
        try:
            self.diagram: Diagram = builder.Build()
        except RuntimeError:
            raise DiagramError(
                f"{_title(system)} is part of another diagram, or was driven with other inputs; make a new system"
            ) from None


def _bench(system: System, inputs: Mapping[str, Input]) -> _Bench:
    """Return the test bench of a system with its inputs set."""
    ports = _ports([system.get_input_port(index) for index in range(system.num_input_ports())])
    wanted: dict[str, dict[str, Input]] = {}
    for name, value in inputs.items():
        # Names of ports may contain points, and so may elements: the last point is tried first, then the first one.
        port, _, element = (name, "", "") if name in ports else name.rpartition(".")
        if port not in ports:
            port, _, element = name.partition(".")
        if port not in ports:
            raise DiagramError(f"{_title(system)} has no input '{name}'; {did_you_mean(name, ports)}")
        wanted.setdefault(port, {})[element] = value
    # An open input would fail in Drake with a message that names no input of the user.
    optional = getattr(system, "optional_inputs", ())
    missing = [name for name, port in ports.items() if name not in wanted and port.get_name() not in optional]
    if missing:
        raise DiagramError(
            f"nothing drives its input {_quoted(missing)}; give inputs={{'{missing[0]}': ...}}", where=_title(system)
        )
    functions = {name: _port_function(ports[name], name, parts) for name, parts in wanted.items()}
    # A system cannot leave its diagram, so the bench is kept with it and only its sources change.
    bench: _Bench | None = getattr(system, "_mirdrake_bench", None)
    if bench is None or set(bench.sources) != set(functions):
        bench = _Bench(system, list(functions), ports)
        system._mirdrake_bench = bench
    for name, function in functions.items():
        bench.sources[name].value = function
    return bench


def _port_function(port: InputPort, name: str, parts: Mapping[str, Input]) -> Callable[[float], Any]:
    """Return the value of an input port as a function of time."""
    # Abstract ports have no elements.
    if port.get_data_type() != PortDataType.kVectorValued:
        (value,) = parts.values()
        constant: Callable[[float], Any] = value if callable(value) else _always(value)
        return constant
    if "" in parts:
        if len(parts) > 1:
            raise DiagramError(f"input '{name}' is given as a whole and by element; give one of the two")
        return _function(parts[""], name, port.size())
    names = [signal.name for signal in signals_of(port) or ()] or [str(index) for index in range(port.size())]
    for element in parts:
        if element not in names:
            raise DiagramError(f"input '{name}' has no element '{element}'; {did_you_mean(element, names)}")
    if absent := [f"{name}.{element}" for element in names if element not in parts]:
        raise DiagramError(f"nothing drives {_quoted(absent)}; give them, or the whole of '{name}'")
    each = [_function(parts[element], f"{name}.{element}", 1) for element in names]
    return lambda time: np.concatenate([function(time) for function in each])


def _function(value: Input, name: str, size: int) -> Callable[[float], Array]:
    """Return a constant, function or table as a function of time with `size` numbers."""

    def checked(numbers: Any) -> Array:
        vector = np.atleast_1d(np.asarray(numbers, dtype=float))
        if vector.shape != (size,):
            given = "a number" if vector.shape == (1,) else f"values of shape {vector.shape}"
            raise DiagramError(f"input '{name}' has {size} numbers, not {given}")
        return vector

    if callable(value):
        # Sizes are checked before the simulation, where the message can name the input.
        checked(value(0.0))
        return lambda time: checked(value(time))
    if isinstance(value, pd.Series | pd.DataFrame):
        value = (value.index.to_numpy(dtype=float), value.to_numpy(dtype=float))
    if isinstance(value, tuple) and len(value) == 2 and np.ndim(value[0]) == 1:
        times, values = np.asarray(value[0], dtype=float), np.asarray(value[1], dtype=float)
        if len(times) != len(values) or not len(times) or (np.diff(times) <= 0.0).any():
            raise DiagramError(f"input '{name}': a table needs increasing times and a value for each")
        # np.interp holds the first and the last value beyond the ends of the table.
        columns = values.reshape(len(times), -1).T
        checked(columns[:, 0])
        return lambda time: np.array([np.interp(time, times, column) for column in columns])
    return _always(checked(value))


def _always(value: Any) -> Callable[[float], Any]:
    return lambda _: value


def _columns(system: System, outputs: Sequence[str] | None) -> list[tuple[str, OutputPort, int | None, str]]:
    """Return name, port, element and unit of every column."""
    ports = _ports([system.get_output_port(index) for index in range(system.num_output_ports())])
    # Every column by its own name, and the columns of each port, so that both names can be asked for.
    every: dict[str, tuple[str, OutputPort, int | None, str]] = {}
    whole: dict[str, list[str]] = {}
    for name, port in ports.items():
        if port.get_data_type() != PortDataType.kVectorValued:
            every[name] = (name, port, None, "")
            continue
        # Ports of Drake's own systems have no names of elements: these are numbered.
        known = signals_of(port) or ()
        for index in range(port.size()):
            element = known[index].name if known else str(index)
            full = name if port.size() == 1 else f"{name}.{element}"
            every[full] = (full, port, index, known[index].unit if known else "")
            whole.setdefault(name, []).append(full)
    if outputs is None:
        return [column for column in every.values() if column[2] is not None]
    chosen: list[tuple[str, OutputPort, int | None, str]] = []
    for name in outputs:
        if name not in every and name not in whole:
            raise DiagramError(f"{_title(system)} has no output '{name}'; {did_you_mean(name, [*ports, *every])}")
        chosen += [every[full] for full in whole.get(name, [name])]
    return chosen


def _read(port: OutputPort, element: int | None, context: Context) -> Any:
    value = port.Eval(context)
    return value if element is None else float(value[element])


def _ports(ports: Sequence[PortT]) -> dict[str, PortT]:
    """Return ports by their names in diagram files; the only port of a system of Drake is u or y."""
    words = {"u0": "u", "y0": "y", "delayed_u": "y"} if len(ports) == 1 else {}
    return {words.get(port.get_name(), port.get_name()): port for port in ports}


def _title(system: System) -> str:
    return system.get_name() or type(system).__name__


def _quoted(names: Sequence[str]) -> str:
    return ", ".join(f"'{name}'" for name in names)


# --- a diagram file ------------------------------------------------------------------------------------------------


def _drive_file(
    diagram: DiagramSpec | Mapping[str, Any] | str,
    inputs: Mapping[str, Input],
    duration: float,
    outputs: Sequence[str] | None,
    period: float | None,
    prepare: Callable[[Context], None] | None,
) -> pd.DataFrame:
    """Drive a diagram with vehicles: a run in memory, whose open inputs are held from step to step."""
    spec = load_diagram(diagram) if isinstance(diagram, str) else diagram
    spec = spec.model_copy(deep=True) if isinstance(spec, DiagramSpec) else make_spec(spec)
    if period is not None:
        spec.record.rate = 1.0 / period
    # A run that ends with the laps would be shorter than the duration that was asked for.
    spec.laps = None
    # Open inputs are those that the file leaves unconnected; a driver's inputs are not open.
    assembly = assemble(spec)
    system = assembly.diagram
    ports = _ports([system.get_input_port(index) for index in range(system.num_input_ports())])
    for name in inputs:
        vehicle, _, port = name.partition(".")
        if name not in ports and vehicle in spec.control and port in JOIN:
            raise DiagramError(f"'{name}' is driven by control.{vehicle} of the file; remove one of the two")
        if name not in ports:
            raise DiagramError(f"{_title(system)} has no open input '{name}'; {did_you_mean(name, ports)}")
    # Stamps follow the simulated time, so that the watchdog sees fresh commands.
    stamps = [name for name in ports if name.endswith(f".{JOIN[2]}") and name not in inputs]
    wanted = {**inputs, **dict.fromkeys(stamps, lambda time: time)}
    functions = {name: _function(value, name, ports[name].size()) for name, value in wanted.items()}
    fixed_values: dict[str, FixedInputPortValue] = {}

    def start(context: Context) -> None:
        for name, function in functions.items():
            fixed_values[name] = ports[name].FixValue(context, function(0.0))
        if prepare is not None:
            prepare(context)

    def follow(context: Context) -> None:
        for name, function in functions.items():
            fixed_values[name].GetMutableData().get_mutable_value().SetFromVector(function(context.get_time()))

    # Inputs of a diagram are fixed values that the monitor replaces after each step, as sources cannot be added to it.
    run = Simulation(assembly).run(duration=duration, change=start, monitor=follow if functions else None)
    # A shorter run would have fewer rows than the test expects.
    if run.stop.reason is not StopReason.DURATION:
        raise DiagramError(f"the run ended early: {run.stop}", where=_title(system))
    frame = run.signals
    for name in outputs or ():
        if name not in frame:
            raise DiagramError(f"{_title(system)} has no signal '{name}'; {did_you_mean(name, map(str, frame))}")
    frame = frame if outputs is None else frame[list(outputs)]
    frame.attrs["units"] = {str(name): run.units.get(str(name), "") for name in frame}
    return frame
