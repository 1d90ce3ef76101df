"""Loop of a user's diagram around a block of kind pid: a linear model of the diagram gives rules and margins.

The diagram is linearised (:mod:`mirdrake.tuning.linearise`) with the measurement of the block cut. From the loop
transfer function L(z) = -C(z) P(z) and the difference equations C(z) of the block follows the frequency response of
everything else, P. Margins are computed from it, without a fit. The rules need a model of low order, which is fitted to
it.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from pydrake.systems.framework import Context

from mirdrake.assembly.diagram import Assembly, assemble
from mirdrake.assembly.diagram_spec import DiagramSpec, make_spec
from mirdrake.assembly.scene import make_scene
from mirdrake.controllers import PidGains
from mirdrake.core.errors import ConfigError
from mirdrake.core.json_io import Json
from mirdrake.tuning.frequency_response import FrequencyResponse
from mirdrake.tuning.gains import controller_response
from mirdrake.tuning.identify import Identification, fit_response, simple_experiment
from mirdrake.tuning.linearise import linearise
from mirdrake.tuning.loops.base import Conditions, LoopModel, LoopSpec, role
from mirdrake.tuning.loops.blocks import DelayedActuator
from mirdrake.tuning.loops.reduced import pid_of
from mirdrake.tuning.loops.signals import PID_GAINS, DiagramLoopKind, SignalBench
from mirdrake.tuning.models import FirstOrder, Integrator, TransferFunction
from mirdrake.tuning.spec import TuningSpec

DELAY = "tuning_delay"
"""Name of the block that is inserted behind the pid block."""

SLOWEST = 100.0
"""Time constant over delay above which a first-order model counts as an integrator."""

SAMPLES = 400
"""Frequencies at which the linear model is evaluated."""


class PidBlockLoop(DiagramLoopKind):
    """A loop of a user's diagram around a block of kind pid."""

    name: ClassVar[str] = "pid_block"
    identifiable: ClassVar[bool] = True
    has_reduced_test: ClassVar[bool] = False
    conditions: ClassVar[tuple[str, ...]] = ("delay",)

    def make_bench(self, spec: LoopSpec) -> "PidBlockBench":
        """See :meth:`LoopKind.make_bench`."""
        return PidBlockBench(spec)

    def delays(self, study: TuningSpec) -> tuple[float, float]:
        """Return the delays of the study; without an entry the diagram has all delays."""
        return study.robustness.delay or (0.0, 0.0)


def with_linear_model(spec: LoopSpec) -> LoopSpec:
    """Return a loop of signals as one that can be identified if its gains are those of one block of kind pid.

    The block must have `kp` and `ki` among the parameters, its ports must be connected in the diagram, and the control
    units of all vehicles must repeat within its period. Other loops are returned unchanged.
    """
    block = _pid_block(spec)
    if block is None:
        return spec
    entry, pairs = spec.diagram["systems"][block], [tuple(pair) for pair in spec.diagram["connect"]]
    period = float(entry.get("period") or 0.02)
    scene = make_scene(make_spec(spec.diagram))
    # The linear model needs all units to repeat within one period of the block.
    repeats = [period * vehicle.control.rate for vehicle in scene.vehicles.values()]
    if any(abs(count - round(count)) > 1e-9 or count < 0.5 for count in repeats):
        return spec

    # The control passes through a block whose delay the Monte Carlo changes.
    control = f"{block}.control"
    # All sinks of the control get the delayed one.
    delayed = [[f"{DELAY}.y" if source == control else source, sink] for source, sink in pairs]
    kind = f"{DelayedActuator.__module__}:{DelayedActuator.__name__}"
    diagram: Json = {
        **spec.diagram,
        "systems": {**spec.diagram["systems"], DELAY: {"kind": kind, "size": 1, "period": period}},
        "connect": [*delayed, [control, f"{DELAY}.u"]],
    }
    filter_time = float(entry.get("filter_time") or 0.0)
    return replace(spec, kind=PidBlockLoop.name, diagram=diagram, period=period, filter_time=filter_time)


def _pid_block(spec: LoopSpec) -> str | None:
    """Return the block of kind pid whose gains are tuned; None if there is no such block."""
    # Parameters of one block: name before the last dot is the block, the last part the role of the gain.
    blocks, roles = {name.rpartition(".")[0] for name in spec.gains}, {role(name) for name in spec.gains}
    if len(blocks) != 1 or not {"kp", "ki"} <= roles <= set(PID_GAINS):
        return None
    (block,) = blocks
    entry = (spec.diagram.get("systems") or {}).get(block)
    # A derivative gain that is not tuned would stay in the loop but not in its model.
    if entry is None or entry["kind"] != "pid" or ("kd" not in roles and entry.get("kd")):
        return None
    # Margins need the loop closed by these connections.
    pairs = spec.diagram["connect"]
    is_fed = any(source == f"{block}.control" for source, _ in pairs)
    is_measured = any(sink == f"{block}.measurement" for _, sink in pairs)
    return block if is_fed and is_measured else None


class PidBlockBench(SignalBench):
    """Test bench of a loop around a block of kind pid; built once."""

    def _apply(self, context: Context, conditions: Conditions) -> None:
        """Write the delay of the actuator."""
        delay: DelayedActuator = self.assembly.diagram.GetSubsystemByName(DELAY)
        delay.set_delay(delay.GetMyMutableContextFromRoot(context), conditions.delay or 0.0)

    def identify(self) -> Identification:
        """Linearise the diagram before the step, and fit a model of first or second order.

        Raises:
            ConfigError: the diagram cannot be linearised, or its output does not follow the effort.
            MissingDependencyError: python-control is not installed.
        """
        spec = self.spec
        response = measure_linear_response(spec)
        first, first_fit = _fit(response, spec, order=1)
        second, second_fit = _fit(response, spec, order=2)
        hold = 0.5 * float(spec.period or 0.0)
        # b / (s + a): K = b / a, T = 1 / a; the floor keeps an integrator from dividing by zero.
        gain, pole = first.numerator[0], max(first.denominator[1], 1e-9)
        lag = FirstOrder(gain / pole, 1.0 / pole, first.delay)
        # A time constant that long cannot be told from an integrator within the frequencies of the fit.
        is_slow = lag.time_constant > SLOWEST * (lag.delay + hold)
        simple = Integrator(gain, first.delay) if is_slow else lag
        samples = tuple(
            (float(w), float(value.real), float(value.imag))
            for w, value in zip(response.frequencies, response.values, strict=True)
        )
        # The second order has to fit better by 1 %, as it always fits at least as well.
        main = second if second_fit > first_fit + 1.0 else first
        model = LoopModel({"main": main}, mass_acts=False, samples=samples)
        experiment = simple_experiment("linear_model", simple, fit_percent=first_fit)
        return Identification(replace(spec, model=model), (experiment,), first=simple, frequency=response)


def measure_linear_response(spec: LoopSpec) -> FrequencyResponse:
    """Return the frequency response from effort to measurement of a loop, without the hold of the effort [y/u].

    Raises:
        ConfigError: the diagram cannot be linearised, the present gains are zero, or the output does not follow.
    """
    period, block = float(spec.period or 0.0), next(iter(spec.gains)).rpartition(".")[0]
    present = pid_of(spec, spec.present) if spec.present else PidGains(0.0)
    if not (present.kp or present.ki or present.kd):
        raise ConfigError(
            f"the gains of '{block}' are zero; write gains with which the loop is stable into the diagram"
        )
    # Cut at the measurement: the response is that of the whole loop, without its sign.
    model = linearise(
        spec.diagram, {}, _assemble, f"{block}.measurement", None, time=spec.course.step_time, cut=True, period=period
    )
    # Aliases are neglected, so the range ends below the Nyquist frequency.
    top = 0.999 * math.pi / period
    frequencies = np.geomspace(1e-4 * top, top, SAMPLES)
    # G = -L / C: the present controller, with its hold, is divided out.
    values = -model.response(frequencies) / controller_response(present, frequencies, period=period)
    # An infinite or zero response has no logarithm for the fit.
    kept = np.isfinite(values) & (np.abs(values) > 0.0)
    if kept.sum() < 2 or (not values[kept][0].real > 0.0 and not values[kept][0].imag < 0.0):
        raise ConfigError(f"the measurement of '{block}' does not follow its control; is the loop connected?")
    return FrequencyResponse(frequencies[kept], values[kept])


def _assemble(spec: DiagramSpec, factories: Mapping[str, Any], *, expand: bool = True) -> Assembly:
    return assemble(spec, expand=expand, factories=factories)


def _fit(response: FrequencyResponse, spec: LoopSpec, *, order: int) -> tuple[TransferFunction, float]:
    """Return the transfer function of an order that fits a response best, and how well [%].

    Frequencies from a thousandth of the highest one up to a phase of -270° count.
    """
    period = float(spec.period or 0.0)
    phase = np.unwrap(np.angle(response.values))
    late = np.flatnonzero(phase < -1.5 * math.pi)
    high = min(float(response.frequencies[late[0]]) if len(late) else math.inf, 0.25 * math.pi / period)
    frequencies = np.geomspace(max(1e-3 * high, response.frequencies[0]), high, 60)
    part = FrequencyResponse(frequencies, response.response(frequencies))
    # Corner frequency: 3 dB below the gain at the lowest frequency.
    gain = float(np.abs(part.values[0]))
    below = np.flatnonzero(np.abs(part.values) < gain / math.sqrt(2.0))
    corner = float(frequencies[below[0]]) if len(below) else high
    # Several starts, since the fit has local minima.
    starts = [(gain * w, 1.0 / w, delay) for w in (corner, 0.1 * corner) for delay in (0.1 * period, period)]
    if order == 2:
        starts = [
            (gain * w * w, damping * w, w * w, 0.1 * period)  # type: ignore[misc]
            for w in (corner, 3.0 * corner)
            for damping in (0.4, 2.0, 10.0)
        ]
    return max((fit_response(part, start, order=order) for start in starts), key=lambda fit: fit[1])
