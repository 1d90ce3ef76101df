"""Base classes of systems written in Python that garbage collection can free with their diagram.

An object of a class derived from pydrake's own LeafSystem is never freed in Drake 1.51, nor are the objects that it
refers to, such as its diagram, for two reasons:

- A class statement adds a second reference to the instance dictionary of pydrake's classes. Garbage collection visits
  the dictionary twice, counts one reference too many, and considers the system to be in use. Classes of
  :class:`FreeableType` do not have the second reference.
- C++ holds the callbacks of ports and cache entries. A bound method refers to its system, and garbage collection
  cannot see this reference. The ``Declare...`` functions here pass callbacks that refer to the system weakly.

A system must not keep other objects with such hidden references to its diagram: Drake's bodies, joints, frames, ports
of a plant (``get_body_poses_output_port`` and others) and Simulators. Keep their indices, or the plant itself.
"""

import weakref
from collections.abc import Callable, Iterable
from functools import wraps
from types import MethodType
from typing import TYPE_CHECKING, Any

from pydrake.systems.framework import CacheEntry, ContextBase, DependencyTicket, LeafSystem_, SystemBase, ValueProducer
from pydrake.systems.framework import LeafSystem as DrakeLeafSystem

Callback = Callable[..., Any]


_PydrakeType: Any = type(DrakeLeafSystem)

if TYPE_CHECKING or _PydrakeType.__module__.startswith("nanobind"):
    FreeableType = _PydrakeType  # it cannot be derived from
else:

    class FreeableType(_PydrakeType):
        """Metaclass of systems that have the instance dictionary of pydrake's class only."""

        def __new__(mcs, name: str, bases: tuple[type, ...], namespace: dict[str, Any], **options: Any) -> Any:
            """Make a class without its own dictionary; attributes are stored in that of pydrake's class."""
            namespace.setdefault("__slots__", ())
            return super().__new__(mcs, name, bases, namespace, **options)


def weak_callback(method: Callback) -> Callback:
    """Return a callback that calls a bound method and refers to its object weakly."""
    assert isinstance(method, MethodType)
    owner, function = weakref.ref(method.__self__), method.__func__

    def call(*arguments: Any) -> Any:
        return function(owner(), *arguments)

    return call


def _weaken(system: SystemBase, argument: Any) -> Any:
    """Return a weak callback for a method of the system, and any other argument unchanged."""
    of_system = isinstance(argument, MethodType) and argument.__self__ is system
    return weak_callback(argument) if of_system else argument


class CachedValue:
    """Value that a system calculates once for a Context and the inputs and parameters in it.

    Args:
        system: the system; referred to weakly, as pydrake's CacheEntry has a hidden reference to it.
        entry: its cache entry.
    """

    def __init__(self, system: SystemBase, entry: CacheEntry) -> None:
        self._system, self._index, self._ticket = weakref.ref(system), entry.cache_index(), entry.ticket()

    def evaluate(self, context: ContextBase) -> Any:
        """Return the value, recalculated if its dependencies have changed."""
        system: Any = self._system()
        return system.get_cache_entry(self._index).Eval(context)

    def ticket(self) -> DependencyTicket:
        """Return the ticket for values that depend on this one."""
        return self._ticket


def declare_cached_value(
    system: SystemBase, name: str, allocate: Callback, calc: Callback, needs: Iterable[DependencyTicket] | None = None
) -> CachedValue:
    """Declare a cache entry of a system.

    Args:
        system: the system.
        name: name of the entry.
        allocate: creates an AbstractValue for the value.
        calc: calculates the value from a Context.
        needs: tickets of the dependencies of the value; all sources if None.
    """
    producer = ValueProducer(allocate=_weaken(system, allocate), calc=_weaken(system, calc))
    arguments = {} if needs is None else {"prerequisites_of_calc": set(needs)}
    return CachedValue(system, system.DeclareCacheEntry(name, producer, **arguments))


def freeable(base: type) -> Any:
    """Return a subclass of one of pydrake's LeafSystem classes that garbage collection can free.

    Its functions that declare ports, events and witness functions take callbacks as those of pydrake do. Cache entries
    are declared by :func:`declare_cached_value`.

    Args:
        base: ``LeafSystem_[T]`` for a scalar type T.
    """
    # All declaring functions of pydrake, so that those of later versions are covered without a list.
    names = [name for name in dir(base) if name.startswith("Declare") or name == "MakeWitnessFunction"]
    functions: dict[str, Any] = {name: _declare_weakly(getattr(base, name)) for name in names}
    return FreeableType("LeafSystem", (base,), {"__doc__": base.__doc__, "__module__": __name__, **functions})


def _declare_weakly(declare: Callback) -> Callback:
    @wraps(declare)
    def call(self: Any, *arguments: Any, **options: Any) -> Any:
        weak = [_weaken(self, argument) for argument in arguments]
        return declare(self, *weak, **{name: _weaken(self, option) for name, option in options.items()})

    return call


if TYPE_CHECKING:
    LeafSystem = DrakeLeafSystem
else:
    LeafSystem = freeable(LeafSystem_[float])
