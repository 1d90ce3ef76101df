"""Loop of a user's diagram around one block: a linear model of the diagram gives margins, and rules for a PID.

The block may be of any kind: one of ours, or a user's class. The diagram is linearised with the inputs of the block
cut, and the block alone for each candidate (:mod:`mirdrake.tuning.loops.block_response`), so that margins are known
without a fit. If its parameters are gains of a PID controller, the loop transfer function over C(z) of that
controller is the plant of the rules. They need a model of low order, which is fitted to it.
"""

import math
from dataclasses import replace
from typing import ClassVar

import numpy as np
from pydrake.systems.framework import Context

from mirdrake.assembly.blocks import all_parameters
from mirdrake.assembly.diagram_spec import make_spec
from mirdrake.assembly.scene import make_scene
from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import Source
from mirdrake.tuning.frequency_response import FrequencyResponse
from mirdrake.tuning.gains import controller_response, hold_response
from mirdrake.tuning.identify import Identification, fit_response, simple_experiment
from mirdrake.tuning.loops.base import NO_ROLE, PID_ROLES, BlockModel, Conditions, LoopModel, LoopSpec
from mirdrake.tuning.loops.block_response import linearise_around, loop_of
from mirdrake.tuning.loops.controller_block import KIND, ControllerBlock, tuned_blocks
from mirdrake.tuning.loops.reduced import pid_of
from mirdrake.tuning.loops.signals import DiagramLoopKind, SignalBench
from mirdrake.tuning.models import FirstOrder, Integrator, TransferFunction

SLOWEST = 100.0
"""Time constant over delay above which a first-order model counts as an integrator."""


class BlockLoop(DiagramLoopKind):
    """A loop of a user's diagram around one of its blocks."""

    name: ClassVar[str] = "block"
    identifiable: ClassVar[bool] = True
    has_reduced_test: ClassVar[bool] = False
    conditions: ClassVar[tuple[str, ...]] = ("delay",)

    def make_bench(self, spec: LoopSpec) -> "BlockBench":
        """See :meth:`LoopKind.make_bench`."""
        return BlockBench(spec)


def with_linear_model(spec: LoopSpec) -> LoopSpec:
    """Return a loop of signals as one that can be identified if its parameters are those of one block.

    The block must have a single control of one element, and the control units of all vehicles must repeat within its
    period. Other loops are returned unchanged.
    """
    names = {name.rpartition(".")[0] for name in spec.gains}
    tuned = tuned_names(spec)
    if len(names) != 1 or tuned != list(names):
        return spec
    return around_block(spec, tuned[0]) or spec


def tuned_names(spec: LoopSpec) -> list[str]:
    """Return the names of the tuned blocks in the diagram of a loop."""
    return [name for name, entry in (spec.diagram.get("systems") or {}).items() if entry["kind"] == KIND]


def around_block(spec: LoopSpec, name: str) -> LoopSpec | None:
    """Return the loop around one of the tuned blocks of a loop, with the gains of that block.

    None if the block has no single control of one element, or the control units do not repeat within its period.
    """
    entry = spec.diagram["systems"][name]
    block = ControllerBlock(entry["entry"], entry["parameters"], entry["folder"])
    control = _control(spec, name, block)
    rates = [vehicle.control.rate for vehicle in make_scene(make_spec(spec.diagram)).vehicles.values()]
    # A block without updates counts as sampled with the slowest control unit.
    period = block.period or 1.0 / min(rates)
    repeats = [period * rate for rate in rates]
    if control is None or any(abs(count - round(count)) > 1e-9 or count < 0.5 for count in repeats):
        return None

    # The control passes through a delay that the Monte Carlo changes.
    tuned_entry = {**entry, "control": control, "period": period}
    kind, given = entry["entry"]["kind"], {key: value for key, value in entry["entry"].items() if key != "kind"}
    known = all_parameters(kind, given, source=Source("loop", {}), folder=entry["folder"])
    gains = {gain: range_ for gain, range_ in spec.gains.items() if gain.rpartition(".")[0] == name}
    filter_time = known.get("filter_time")
    # A gain that is not tuned would stay in the loop but not in the controller of the rules.
    if any(known.get(role) and role not in map(spec.role, gains) for role in PID_ROLES):
        gains = {gain: replace(range_, role=NO_ROLE) for gain, range_ in gains.items()}
    return replace(
        spec,
        kind=BlockLoop.name,
        gains=gains,
        present={gain: value for gain, value in spec.present.items() if gain in gains},
        diagram={**spec.diagram, "systems": {**spec.diagram["systems"], name: tuned_entry}},
        period=period,
        filter_time=float(filter_time) if isinstance(filter_time, int | float) else 0.0,
    )


def _control(spec: LoopSpec, name: str, block: ControllerBlock) -> str | None:
    """Return the output port of a block that is its control: the only one, or the one that the effort names."""
    ports = [port for port in block.outputs if len(block.outputs) == 1 or spec.effort == f"{name}.{port.get_name()}"]
    return ports[0].get_name() if len(ports) == 1 and ports[0].size() == 1 else None


class BlockBench(SignalBench):
    """Test bench of a loop around a block; built once."""

    def _apply(self, context: Context, conditions: Conditions) -> None:
        """Write the delay of the control."""
        (block,) = tuned_blocks(self.assembly).values()
        block.set_delay(context, conditions.delay or 0.0)

    def identify(self) -> Identification:
        """Linearise the diagram before the step, and fit a model of first or second order.

        Raises:
            ConfigError: the diagram cannot be linearised, or its output does not follow the effort.
        """
        (name,) = tuned_blocks(self.assembly)
        return identify_block(self.spec, name)


def identify_block(spec: LoopSpec, name: str) -> Identification:
    """Linearise the diagram of a loop around a block, before the step, and fit a model of first or second order.

    Raises:
        ConfigError: the diagram cannot be linearised, or its output does not follow the effort.
    """
    model = linearise_around(spec, name)
    response = plant_response(spec, model)
    first, first_fit = _fit(response, spec, order=1)
    second, second_fit = _fit(response, spec, order=2)
    # The second order has to fit better by 1 %, as it always fits at least as well.
    main = second if second_fit > first_fit + 1.0 else first
    loop = replace(spec, model=LoopModel({"main": main}, mass_acts=False, block=model))
    hold = 0.5 * float(spec.period or 0.0)
    # b / (s + a): K = b / a, T = 1 / a; the floor keeps an integrator from dividing by zero.
    gain, pole = first.numerator[0], max(first.denominator[1], 1e-9)
    lag = FirstOrder(gain / pole, 1.0 / pole, first.delay)
    # A time constant that long cannot be distinguished from an integrator within the frequencies of the fit.
    is_slow = lag.time_constant > SLOWEST * (lag.delay + hold)
    simple = Integrator(gain, first.delay) if is_slow else lag
    experiment = simple_experiment("linear_model", simple, fit_percent=first_fit)
    return Identification(loop, (experiment,), first=simple, frequency=response)


def plant_response(spec: LoopSpec, model: BlockModel) -> FrequencyResponse:
    """Return the frequency response of what rules take as the plant of a loop, without the hold of the effort [y/u].

    It is the loop transfer function over the controller with the present gains; the whole loop if its parameters are
    not gains of a PID controller.

    Raises:
        ConfigError: the output does not follow the effort.
    """
    frequencies = np.array(model.frequencies)
    loop = loop_of(model, spec.present)(frequencies)
    if not spec.has_pid_gains:
        return FrequencyResponse(frequencies, loop / hold_response(frequencies, model.period))
    values = loop / controller_response(pid_of(spec, spec.present), frequencies, period=model.period)
    if not values[0].real > 0.0 and not values[0].imag < 0.0:
        raise ConfigError(f"'{spec.output}' does not follow '{spec.effort}'; is the loop connected?")
    return FrequencyResponse(frequencies, values)


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
