"""Named vectors on ports: names and units survive into the diagram, ports of other systems have none."""

import gc

import numpy as np
import pytest
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import PassThrough

from mirdrake.core.errors import DiagramError
from mirdrake.core.signals import (
    Signal,
    declare_state_output,
    declare_vector_input,
    declare_vector_output,
    signals,
    signals_of,
)

COMMAND = signals(("speed", "m/s"), ("steering", "rad", "positive to the left"))
SPEED = signals(("speed", "m/s"))


class Twice(LeafSystem):
    """Doubles a speed and keeps a discrete state."""

    def __init__(self) -> None:
        super().__init__()
        self.command = declare_vector_input(self, "command", COMMAND)
        self.speed = declare_vector_output(self, "speed", SPEED, self._calc, prerequisites={self.command.ticket()})
        self.held = declare_state_output(self, "held", SPEED, self.DeclareDiscreteState(1))

    def _calc(self, context: Context, output: BasicVector) -> None:
        output[0] = 2.0 * np.asarray(self.command.Eval(context))[0]


def test_a_signal_is_a_name_a_unit_and_a_meaning() -> None:
    speed, steering = COMMAND
    assert speed == Signal(name="speed", unit="m/s", description="")
    assert steering == Signal(name="steering", unit="rad", description="positive to the left")


def test_a_vector_has_no_two_signals_of_one_name() -> None:
    with pytest.raises(DiagramError, match="two signals of one vector are called 'speed'"):
        signals(("speed", "m/s"), ("yaw", "rad"), ("speed", "rad/s"))


def test_ports_have_the_size_of_their_signals_and_know_them() -> None:
    system = Twice()
    assert system.command.size() == 2
    assert signals_of(system.command) == COMMAND
    assert signals_of(system.speed) == SPEED
    assert signals_of(system.held) == SPEED


def test_an_input_and_an_output_of_one_name_are_kept_apart() -> None:
    system = LeafSystem()
    taken = declare_vector_input(system, "x", COMMAND)
    given = declare_vector_output(system, "x", SPEED, lambda context, output: None)
    assert signals_of(taken) == COMMAND
    assert signals_of(given) == SPEED


def test_ports_of_other_systems_have_no_signals() -> None:
    system = PassThrough(3)
    assert signals_of(system.get_input_port()) is None
    assert signals_of(system.get_output_port()) is None


def test_two_systems_of_a_class_do_not_share_their_names() -> None:
    first, second = LeafSystem(), LeafSystem()
    declare_vector_input(first, "u", COMMAND)
    second.DeclareVectorInputPort("u", 2)
    assert signals_of(second.get_input_port()) is None


def test_names_survive_when_only_the_diagram_keeps_the_system() -> None:
    builder = DiagramBuilder()
    builder.AddNamedSystem("twice", Twice())
    diagram = builder.Build()
    del builder
    gc.collect()
    system = diagram.GetSubsystemByName("twice")
    assert signals_of(system.GetInputPort("command")) == COMMAND
    assert signals_of(system.GetOutputPort("held")) == SPEED


def test_the_declared_output_computes() -> None:
    system = Twice()
    context = system.CreateDefaultContext()
    system.command.FixValue(context, [1.5, 0.1])
    assert np.asarray(system.speed.Eval(context)) == pytest.approx([3.0])
