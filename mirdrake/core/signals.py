"""Named vectors with units, for systems, checks of connections, and logs.

A port of a LeafSystem that is declared by :func:`declare_vector_input` or :func:`declare_vector_output` has a name and
a unit for each element, which :func:`signals_of` returns. Ports of other systems have none; only their size is
checked.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

from pydrake.systems.framework import BasicVector, InputPort, OutputPort, System

from mirdrake.core.errors import DiagramError
from mirdrake.core.leaf_system import LeafSystem


class Signal(NamedTuple):
    """Name, SI unit ("" for a pure number) and meaning of a scalar."""

    name: str
    unit: str
    description: str = ""


Signals = tuple[Signal, ...]


def signals(*entries: tuple[str, str] | tuple[str, str, str]) -> Signals:
    """Return a named vector from (name, unit[, meaning]) tuples.

    Raises:
        DiagramError: two elements have the same name.
    """
    vector = tuple(Signal(*entry) for entry in entries)
    repeated = {signal.name for signal in vector if sum(other.name == signal.name for other in vector) > 1}
    if repeated:
        raise DiagramError(f"two signals of one vector are called '{min(repeated)}'; each needs its own name")
    return vector


def declare_vector_input(system: LeafSystem, name: str, contents: Sequence[Signal]) -> InputPort:
    """Declare a vector input port whose elements have names and units."""
    port = system.DeclareVectorInputPort(name, len(contents))
    _remember(system, "input", name, contents)
    return port


def declare_vector_output(
    system: LeafSystem,
    name: str,
    contents: Sequence[Signal],
    calc: Callable[..., None],
    *,
    prerequisites: Iterable[Any] | None = None,
) -> OutputPort:
    """Declare a vector output port whose elements have names and units."""
    arguments = {} if prerequisites is None else {"prerequisites_of_calc": set(prerequisites)}
    port = system.DeclareVectorOutputPort(name, BasicVector(len(contents)), calc, **arguments)
    _remember(system, "output", name, contents)
    return port


def declare_state_output(system: LeafSystem, name: str, contents: Sequence[Signal], state_index: Any) -> OutputPort:
    """Declare an output port of the discrete state, which Drake evaluates in C++ instead of Python."""
    port = system.DeclareStateOutputPort(name, state_index)
    _remember(system, "output", name, contents)
    return port


def signals_of(port: InputPort | OutputPort) -> Signals | None:
    """Return names and units of a port's elements; None if the system has not declared them."""
    book: dict[tuple[str, str], Signals] = getattr(port.get_system(), "_mirdrake_signals", {})
    return book.get((_direction(port), port.get_name()))


def name_elements(port: InputPort | OutputPort, contents: Sequence[Signal]) -> None:
    """Give the elements of a port, such as one of a block of Drake, names and units."""
    _remember(port.get_system(), _direction(port), port.get_name(), contents)


def copy_signals(source: InputPort | OutputPort, target: InputPort | OutputPort) -> None:
    """Give a port, such as an exported one of a Diagram, the names and units of the port behind it."""
    contents = signals_of(source)
    if contents is not None:
        _remember(target.get_system(), _direction(target), target.get_name(), contents)


def _direction(port: InputPort | OutputPort) -> str:
    return "input" if isinstance(port, InputPort) else "output"


def _remember(system: System, direction: str, name: str, contents: Sequence[Signal]) -> None:
    # Stored at the system itself, so that it lives and dies with it and no global table keeps systems alive.
    book: dict[tuple[str, str], Signals] = getattr(system, "_mirdrake_signals", {})
    book[(direction, name)] = tuple(contents)
    system._mirdrake_signals = book
