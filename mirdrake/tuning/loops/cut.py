"""Linear model of a whole loop, cut at its effort, for any values of its parameters.

All inputs that read the effort get a fixed value instead; the response of the effort's source to that value, with the
sign of negative feedback, is the loop transfer function of everything that the effort drives, however many controllers
there are. Its margins are those at the actuator: of a cascade, the gain and the delay that its innermost effort
tolerates with all loops closed. (Åström and Murray, Feedback Systems, 2nd ed., section 10.1.)

The diagram is linearised for each candidate: unlike :mod:`mirdrake.tuning.loops.block_response`, the parameters may be
those of anything.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import Context, InputPort, OutputPort

from mirdrake.assembly.diagram import Assembly
from mirdrake.core.errors import ConfigError
from mirdrake.tuning.linearise import BEFORE, advanced_state, central_differences, state_of, with_state
from mirdrake.tuning.loops.block_response import Array, StateSpace
from mirdrake.tuning.margins import LoopResponse
from mirdrake.tuning.models import Complexes, Floats

LOWEST = 1e-4
"""Lowest frequency of the margins over the Nyquist frequency; aliases are neglected, so the highest is just below 1."""


@dataclass(frozen=True)
class CutLoop:
    """A loop that can be cut: the output port of its effort, which has one element, and the inputs that read it.

    Attributes:
        assembly: the diagram.
        effort: output port.
        readers: inputs of systems of the diagram that are connected to it, without those that only log it.
        period: of the linear model, after which every control unit has been updated [s].
    """

    assembly: Assembly
    effort: OutputPort
    readers: tuple[InputPort, ...]
    period: float

    def response(self, time: float, change: Callable[[Context], None]) -> LoopResponse:
        """Return the loop transfer function at an operating point, negative feedback.

        Args:
            time: of the operating point [s], rounded to whole periods.
            change: writes the parameters into the Context of the start.

        Raises:
            RuntimeError: of Drake: the diagram diverges before the operating point.
        """
        context = self.assembly.make_context()
        change(context)
        simulator = self.assembly.make_simulator(context)
        simulator.Initialize()
        # Just before a whole period, so that all updates at that time belong to the next step.
        simulator.AdvanceTo((max(round(time / self.period), 1) - BEFORE) * self.period)
        source = self.effort.get_system()

        def advance(x: Array, u: Array) -> tuple[Array, Array]:
            changed = with_state(context, x)
            for port in self.readers:
                port.FixValue(port.get_system().GetMyMutableContextFromRoot(changed), u)
            y = np.array(self.effort.Eval(source.GetMyContextFromRoot(changed)))
            return advanced_state(self.assembly.make_simulator(changed), self.period), y

        value = np.array(self.effort.Eval(source.GetMyContextFromRoot(context)))
        model = StateSpace(*central_differences(advance, state_of(context), value), self.period)

        def response(frequencies: Floats) -> Complexes:
            return np.asarray(-model.response(np.atleast_1d(frequencies))[:, 0, 0], dtype=complex)

        return response

    @property
    def frequencies(self) -> tuple[float, float]:
        """Lowest and highest frequency at which margins are searched [rad/s]."""
        top = 0.999 * math.pi / self.period
        return LOWEST * top, top


def cut_loop(assembly: Assembly, effort: str) -> CutLoop | None:
    """Return the loop through an output of a diagram; None if it cannot be cut there.

    The effort must be the only element of an output port of the diagram that something reads, and the periods of all
    control units and drivers must repeat within the longest one.
    """
    try:
        port, _ = assembly.output_port(effort)
    except ConfigError:  # a signal that is logged, but is no output
        return None
    readers = [
        system.get_input_port(index)
        for (system, index), (source, number) in assembly.diagram.connection_map().items()
        if source is port.get_system() and number == port.get_index() and not _is_log(system.get_name())
    ]
    period = _common_period(assembly)
    return CutLoop(assembly, port, tuple(readers), period) if port.size() == 1 and readers and period else None


def _is_log(name: str) -> bool:
    return name.startswith("log/")


def _common_period(assembly: Assembly) -> float | None:
    """Return the longest period of control units, drivers and blocks [s]; None if the others do not divide it."""
    periods = [1.0 / part.vehicle.control.rate for part in assembly.parts.vehicles.values()]
    names = {*assembly.spec.systems, *(f"{vehicle}.driver" for vehicle in assembly.parts.vehicles)}
    for system in assembly.diagram.GetSystems():
        timing = system.GetUniquePeriodicDiscreteUpdateAttribute() if system.get_name() in names else None
        periods += [] if timing is None else [timing.period_sec()]
    longest = max(periods)
    counts = [longest / period for period in periods]
    return longest if all(abs(count - round(count)) < 1e-9 for count in counts) else None
