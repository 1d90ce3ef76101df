"""A block of a user's diagram whose parameters are tuned: it stays in its diagram, and is made anew for each candidate.

:class:`TunedBlock` takes the place of the block, with the same ports::

    inputs ─ (cut) ─ ControllerBlock ─┬─ delay ─► control
                                      └─────────► other outputs

:class:`ControllerBlock` evaluates a system outside of the diagram, which is made from the parameters in the Context, so
that nothing else has to be built for a candidate. Any system with vector ports can be tuned in this way, whatever it
does with the arguments of its constructor.
"""

from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pydrake.systems.framework import (
    BasicVector,
    Context,
    ContinuousState,
    Diagram,
    DiagramBuilder,
    DiscreteValues,
    PortDataType,
    System,
)

from mirdrake.assembly.blocks import make_block
from mirdrake.assembly.diagram import Assembly
from mirdrake.core.errors import ConfigError
from mirdrake.core.leaf_system import FreeableType, LeafSystem, weak_callback
from mirdrake.core.signals import copy_signals
from mirdrake.core.yaml_io import Source
from mirdrake.tuning.loops.blocks import DelayedActuator

Array = npt.NDArray[np.float64]

KEPT = 4
"""Systems of other parameters that a block keeps."""

CONTROLLER, DELAY = "controller", "delay"
"""Names of the systems in a :class:`TunedBlock`."""


class ControllerBlock(LeafSystem):  # type: ignore[misc, unused-ignore]
    """A system whose parameters are in the Context, and whose inputs can be cut.

    Input and output ports: those of the system.

    Parameters of the Context: 0: the tuned parameters; 1: whether the inputs are cut (0 or 1), then their values if so.

    State: that of the system.

    Attributes:
        period: of its updates [s]; None if it has none.

    Args:
        entry: of the block in the diagram: kind, and parameters.
        parameters: tuned parameters with their present values.
        folder: of the diagram file, where a user's module may be.

    Raises:
        ConfigError: the system has ports of abstract values, abstract state, or updates with several rates.
    """

    def __init__(self, entry: Mapping[str, Any], parameters: Mapping[str, float], folder: str | None = None) -> None:
        super().__init__()
        self._entry, self.parameters, self._folder = dict(entry), tuple(parameters), folder
        self._made: OrderedDict[tuple[float, ...], tuple[System, Context]] = OrderedDict()
        system, own = self._system(tuple(float(value) for value in parameters.values()))
        self._check(system, own)
        self._values = self.DeclareNumericParameter(BasicVector(list(map(float, parameters.values()))))

        # Ports with the names and units of those of the system.
        given = [system.get_input_port(i) for i in range(system.num_input_ports())]
        taken = [system.get_output_port(i) for i in range(system.num_output_ports())]
        self.inputs = [self.DeclareVectorInputPort(port.get_name(), port.size()) for port in given]
        self._cut = self.DeclareNumericParameter(BasicVector([0.0] * (1 + sum(port.size() for port in given))))
        self._needs: list[list[int]] = []
        self.outputs = []
        for index, port in enumerate(taken):
            # An output that does not depend on an input must not evaluate it: that may be an algebraic loop.
            needs = [i for i, source in enumerate(given) if system.HasDirectFeedthrough(source.get_index(), index)]
            tickets = {self.inputs[i].ticket() for i in needs} | {self.all_parameters_ticket(), self.time_ticket()}
            tickets |= {self.xd_ticket(), self.xc_ticket()}
            self._needs.append(needs)
            self.outputs.append(
                self.DeclareVectorOutputPort(
                    port.get_name(), port.size(), self._calculation(index), prerequisites_of_calc=tickets
                )
            )
        for mine, port in zip((*self.inputs, *self.outputs), (*given, *taken), strict=True):
            copy_signals(port, mine)

        # State and updates of the system.
        for group in range(own.num_discrete_state_groups()):
            self.DeclareDiscreteState(own.get_discrete_state(group).value())
        if own.num_continuous_states():
            self.DeclareContinuousState(BasicVector(own.get_continuous_state_vector().CopyToVector()))
        timing = system.GetUniquePeriodicDiscreteUpdateAttribute()
        self.period: float | None = None if timing is None else timing.period_sec()
        if timing is not None:
            self.DeclareInitializationDiscreteUpdateEvent(self._initialize)
            self.DeclarePeriodicDiscreteUpdateEvent(timing.period_sec(), timing.offset_sec(), self._update)

    def set_parameter(self, context: Context, name: str, value: float) -> None:
        """Write a tuned parameter into a Context of this system."""
        context.get_mutable_numeric_parameter(self._values).SetAtIndex(self.parameters.index(name), value)

    def values(self, context: Context) -> Array:
        """Return the elements of all inputs as their sources give them."""
        return np.concatenate([np.zeros(0), *(port.Eval(context) for port in self.inputs)])

    def cut(self, context: Context, values: Array) -> None:
        """Cut all inputs in a Context of this system, and write the values of their elements."""
        context.get_mutable_numeric_parameter(self._cut).SetFromVector([1.0, *values])

    def _make(self, values: tuple[float, ...]) -> System:
        parameters = {key: value for key, value in self._entry.items() if key != "kind"}
        parameters |= dict(zip(self.parameters, values, strict=True))
        folder = None if self._folder is None else Path(self._folder)
        return make_block(self._entry["kind"], parameters, source=Source("loop", {}), folder=folder)

    def _system(self, values: tuple[float, ...]) -> tuple[System, Context]:
        """Return the system of parameters, and its Context."""
        pair = self._made.pop(values, None)
        if pair is None:
            system = self._make(values)
            pair = system, system.CreateDefaultContext()
            while len(self._made) >= KEPT:
                self._made.popitem(last=False)
        self._made[values] = pair
        return pair

    def _check(self, system: System, own: Context) -> None:
        ports = [system.get_input_port(i) for i in range(system.num_input_ports())]
        ports += [system.get_output_port(i) for i in range(system.num_output_ports())]
        fault = ""
        if any(port.get_data_type() != PortDataType.kVectorValued for port in ports):
            fault = "a port that is not a vector"
        elif own.num_abstract_states():
            fault = "abstract state"
        elif own.num_discrete_state_groups() and system.GetUniquePeriodicDiscreteUpdateAttribute() is None:
            fault = "discrete state without one periodic update"
        if fault:
            raise ConfigError(f"{self._entry['kind']} cannot be tuned: it has {fault}")

    def _ready(self, context: Context, needs: Sequence[int]) -> tuple[System, Context]:
        """Return the system and its Context with time, state and some inputs of a Context of this system."""
        system, own = self._system(tuple(context.get_numeric_parameter(self._values).value().tolist()))
        own.SetTime(context.get_time())
        is_cut, *values = context.get_numeric_parameter(self._cut).value().tolist()
        begins = np.cumsum([0, *(port.size() for port in self.inputs)])
        # A cut loop gets its inputs from parameters, so that the controller is linearised by itself.
        for index in needs:
            port = self.inputs[index]
            if is_cut:
                value: Any = values[begins[index] : begins[index + 1]]
            elif port.HasValue(context):
                value = port.Eval(context)
            else:
                continue
            system.get_input_port(index).FixValue(own, value)
        for group in range(own.num_discrete_state_groups()):
            own.SetDiscreteState(group, context.get_discrete_state(group).value())
        if own.num_continuous_states():
            own.SetContinuousState(context.get_continuous_state_vector().CopyToVector())
        return system, own

    def _calculation(self, index: int) -> Callable[[Context, BasicVector], None]:
        """Return the callback of an output; it refers to this system weakly, see :mod:`mirdrake.core.leaf_system`."""
        calc = weak_callback(self._calc)
        return lambda context, output: calc(index, context, output)

    def _calc(self, index: int, context: Context, output: BasicVector) -> None:
        system, own = self._ready(context, self._needs[index])
        output.SetFromVector(system.get_output_port(index).Eval(own))

    def _initialize(self, context: Context, values: DiscreteValues) -> None:
        system, own = self._ready(context, range(len(self.inputs)))
        system.ExecuteInitializationEvents(own)
        for group in range(own.num_discrete_state_groups()):
            values.set_value(group, own.get_discrete_state(group).value())

    def _update(self, context: Context, values: DiscreteValues) -> None:
        system, own = self._ready(context, range(len(self.inputs)))
        updated = system.EvalUniquePeriodicDiscreteUpdate(own)
        for group in range(updated.num_groups()):
            values.set_value(group, updated.value(group))

    def DoCalcTimeDerivatives(self, context: Context, derivatives: ContinuousState) -> None:  # noqa: N802
        """Write the time derivatives of the system."""
        system, own = self._ready(context, range(len(self.inputs)))
        derivatives.SetFromVector(system.EvalTimeDerivatives(own).CopyToVector())


class TunedBlock(Diagram, metaclass=FreeableType):  # type: ignore[misc, unused-ignore]
    """A :class:`ControllerBlock` with a delay behind its control; it takes the place of the block in its diagram.

    Args:
        entry: of the block in the diagram: kind, and parameters.
        parameters: tuned parameters with their present values.
        control: output port that is delayed; None: none.
        period: of the delay [s].
        folder: of the diagram file.

    Raises:
        ConfigError: as :class:`ControllerBlock`.
    """

    def __init__(
        self,
        entry: Mapping[str, Any],
        parameters: Mapping[str, float],
        control: str | None = None,
        period: float = 0.02,
        folder: str | None = None,
    ) -> None:
        super().__init__()
        self.block = block = ControllerBlock(entry, parameters, folder)
        builder = DiagramBuilder()
        builder.AddNamedSystem(CONTROLLER, block)
        for port in block.inputs:
            builder.ExportInput(port, port.get_name())
        for port in block.outputs:
            source = port
            if port.get_name() == control:
                delay = builder.AddNamedSystem(DELAY, DelayedActuator(port.size(), period))
                builder.Connect(port, delay.u)
                source = delay.y
            builder.ExportOutput(source, port.get_name())
        builder.BuildInto(self)
        # Exported ports lose the names and units of their elements.
        for index, port in enumerate(block.inputs):
            copy_signals(port, self.get_input_port(index))
        for index, port in enumerate(block.outputs):
            copy_signals(port, self.get_output_port(index))

    def set_delay(self, context: Context, delay: float) -> None:
        """Write the delay of the control [s] into the Context of a diagram with this one."""
        system: DelayedActuator = self.GetSubsystemByName(DELAY)
        system.set_delay(system.GetMyMutableContextFromRoot(context), delay)


KIND = f"{__name__}:{TunedBlock.__name__}"
"""Kind of a :class:`TunedBlock` in a diagram file."""


def tuned_blocks(assembly: Assembly) -> dict[str, TunedBlock]:
    """Return the tuned blocks of a diagram by name; those in place of a block of a control unit are in its Diagram."""
    blocks = {}
    for name, entry in assembly.spec.systems.items():
        if entry.kind == KIND:
            outer, _, inner = name.rpartition(".")
            diagram = assembly.diagram.GetSubsystemByName(outer) if outer else assembly.diagram
            blocks[name] = diagram.GetSubsystemByName(inner)
    return blocks
