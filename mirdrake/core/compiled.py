"""Compiled functions for the equations of each plant step, and records of numbers as their arguments.

Python evaluates a formula a hundred times more slowly than machine code, too slowly for every step of the plant. These
equations are therefore plain Python functions of floats, arrays and records of numbers, compiled by Numba [1]: the same
source runs with and without compilation. Numba sets the rules: indices instead of unpacking, no None, no closures, no
keyword-only arguments. Arithmetic follows IEEE 754, in the order of the source.

Compiling takes a few seconds, once: the machine code is cached beside the source files, or in the user's cache folder
if these are not writable, until one of the source files changes.

[1] S. K. Lam, A. Pitrou, S. Seibert, Numba: a LLVM-based Python JIT compiler, LLVM-HPC 2015.
"""

import inspect
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import astuple, is_dataclass
from functools import cache
from multiprocessing import parent_process
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np
import numpy.typing as npt

from mirdrake.core.digest import digest
from mirdrake.core.maths import COMPILED_FORMS

Records = npt.NDArray[np.void]
"""An array of records; compiled functions access the fields as attributes."""


_NUMBERS = (float, int)  # as a tuple, twice as fast to check against as a union


_types: dict[type[Any], np.dtype[np.void]] = {}


def record_type(kind: type[Any]) -> np.dtype[np.void]:
    """Return the NumPy type of the record of a named tuple or dataclass, with the same fields.

    Args:
        kind: the class; its fields are floats, ints, bools, tuples of one of these, or such classes again. Fields of
            type Any are floats.
    """
    # Once for each class, as hints are slow to evaluate. Aligned as a C structure, as Numba requires for its fields.
    if kind not in _types:
        _types[kind] = np.dtype([(name, *_field(hint)) for name, hint in get_type_hints(kind).items()], align=True)
    return _types[kind]


def _field(hint: Any) -> tuple[Any, ...]:
    if hint is Any:
        return (np.dtype(float),)
    if hint in (float, int, bool):
        return (np.dtype(hint),)
    parts = get_args(hint)  # of a tuple; Numba has no arrays of bools in records
    kind = int if parts and parts[0] is bool else parts[0] if parts else None
    return (np.dtype(kind), (len(parts),)) if parts else (record_type(hint),)


def records(kind: type[Any], values: Iterable[Any]) -> Records:
    """Return named tuples or dataclasses of one class as an array of records."""
    return np.array([plain(value) for value in values], dtype=record_type(kind))


def plain(value: Any) -> Any:
    """Return a named tuple or dataclass, nested or not, as plain tuples, which can be assigned to a record."""
    # NumPy fills a structured array from tuples only, not from lists or dataclasses.
    if isinstance(value, tuple):
        return tuple([part if isinstance(part, _NUMBERS) else plain(part) for part in value])
    return plain(astuple(value)) if is_dataclass(value) and not isinstance(value, type) else value


def as_arrays(numbers: Any) -> Any:
    """Return a named tuple with its tables and sequences as arrays, as compiled functions take it."""
    values = []
    for value in numbers:
        if hasattr(value, "_fields"):
            values.append(as_arrays(value))
        elif isinstance(value, list | tuple):
            # Tables without rows have two columns, too: Numba compiles for a number of dimensions.
            table = np.array(value, dtype=float)
            values.append(table if len(table) else np.empty((0, 2)))
        else:
            values.append(value)
    return type(numbers)(*values)


def compiled(
    function: Callable[..., Any],
    law: Callable[..., Any] | tuple[Callable[..., Any], ...] | None = None,
    *,
    parts: Sequence[Callable[..., Any]],
    nogil: bool = False,
) -> Callable[..., Any]:
    """Return a compiled function.

    The first call with arguments of new types loads the machine code, or compiles it.

    Args:
        function: the function.
        law: its first argument, or its first two to four, if these are functions; the compiled function does not have
            them.
        parts: functions that these call, directly or indirectly.
        nogil: whether other threads of Python run meanwhile.
    """
    laws = () if law is None else law if isinstance(law, tuple) else (law,)
    return _compiled(function, laws, tuple(parts), nogil)


@cache
def _compiled(
    function: Callable[..., Any],
    laws: tuple[Callable[..., Any], ...],
    parts: tuple[Callable[..., Any], ...],
    nogil: bool,
) -> Callable[..., Any]:
    _listen()
    everything = [function, *laws, *parts, *COMPILED_FORMS]
    # Helper functions must be known to Numba before the first call is compiled.
    for part in everything:
        _register(part)
    version = _version(everything)  # part of the cache key, as Numba itself only checks one source file

    if not laws:
        # Directly, without a function around it, for which LLVM would optimise all of the code once more.
        return _cached(function, version, nogil=nogil)

    def call_with_law(*arguments: Any) -> Any:
        return function(first, *arguments)

    def call_with_two(*arguments: Any) -> Any:
        return function(first, second, *arguments)

    def call_with_three(*arguments: Any) -> Any:
        return function(first, second, third, *arguments)

    def call_with_four(*arguments: Any) -> Any:
        return function(first, second, third, fourth, *arguments)

    # Numba resolves functions in the closure at compile time only if each is a variable of its own.
    first, second, third, fourth = (*laws, None, None, None)[:4]
    calling: Callable[..., Any] = (call_with_law, call_with_two, call_with_three, call_with_four)[len(laws) - 1]
    return _cached(calling, version, nogil=nogil)


def entry_point(function: Callable[..., Any]) -> Callable[[tuple[Any, ...]], Any]:
    """Return a compiled function as one of a tuple of its arguments, whose types are checked in the first call only.

    The check takes microseconds for records and named tuples, which have many fields. The arguments of later calls must
    have the types of the first ones.

    Args:
        function: a function of :func:`compiled`.
    """
    machine_code: Any = function
    quick: Callable[..., Any] | None = None
    # All arguments of a function around laws are one tuple for Numba.
    around = hasattr(machine_code, "compile") and bool(machine_code.py_func.__code__.co_flags & inspect.CO_VARARGS)

    def call(arguments: tuple[Any, ...]) -> Any:
        nonlocal quick
        if quick is None:
            if not hasattr(machine_code, "compile"):  # Numba is switched off
                return machine_code(*arguments)
            given = (arguments,) if around else arguments
            quick = machine_code.compile(tuple(map(machine_code.typeof_pyval, given)))
        return quick(arguments) if around else quick(*arguments)

    return call


def _cached(function: Callable[..., Any], version: int, *, nogil: bool) -> Callable[..., Any]:
    """Return a compiled function whose machine code is cached by the version."""
    from numba import njit
    from numba.core.caching import FunctionCache, IndexDataCacheFile
    from numba.core.runtime import rtsys

    class File(IndexDataCacheFile):
        """Files of the machine code; those that cannot be read, as of another version of mirdrake, do not exist."""

        # Numba unpickles the classes of all arguments that the function ever had, before it looks for the key. One that
        # was renamed since then, or an incomplete file, raises one of many errors.
        def _load_index(self) -> Any:
            with suppress(Exception):
                return super()._load_index()
            return {}

        def _load_data(self, name: str) -> Any:
            with suppress(Exception):
                return super()._load_data(name)
            return None

    class VersionedCache(FunctionCache):
        """Cache with files of its own for each version.

        Reading an index imports the modules of all types of arguments in it, and all functions around laws have the
        same name: with one index for them a tyre on its own would load the plant.
        """

        def __init__(self, function: Callable[..., Any]) -> None:
            super().__init__(function)
            name = f"{self._impl.filename_base}.{version:x}"
            self._cache_file = File(self._cache_path, name, self._impl.locator.get_source_stamp())

        # Numba would prepare its compiler here, which takes longer than reading the code; the code needs the runtime
        # only. A compilation prepares the compiler itself.
        def load_overload(self, sig: Any, target_context: Any) -> Any:
            rtsys.initialize(target_context)
            with self._guard_against_spurious_io_errors():
                return self._load_overload(sig, target_context)

    machine_code: Any = njit(nogil=nogil)(function)
    with suppress(RuntimeError):  # no folder is writable
        machine_code._cache = VersionedCache(function)
    result: Callable[..., Any] = machine_code
    return result


_watchers: list[Callable[[bool], None]] = []
_spent: list[float] = []


def compilation_time() -> float:
    """Return the wall time that this process has spent on compilations so far [s]."""
    return sum(_spent)


def watch_compilation(watcher: Callable[[bool], None]) -> None:
    """Have a function called with True before each compilation in this process, and with False after it.

    Compilations within one another count as one. Loading machine code from the cache is none.
    """
    _watchers.append(watcher)


@cache
def announce_compilation() -> None:
    """Announce a compilation, which is silent for up to a minute, in a terminal; once in a process."""
    if sys.stderr.isatty():
        # At the start of the line, over a progress bar that may be there.
        sys.stderr.write("\rcompiling the equations of plant, tyres and traffic: once, for up to a minute\n")
        sys.stderr.flush()


@cache
def _listen() -> None:
    """Tell the watchers of the compilations of this process; without any, the first one is announced."""
    from numba.core import event

    class Listener(event.Listener):
        """Counts the compilations in progress."""

        def __init__(self) -> None:
            self.depth, self.began = 0, 0.0

        # Compilations are nested: a function compiles those that it calls. Only the outermost one is announced and
        # timed.
        def on_start(self, _: Any) -> None:
            self.depth += 1
            if self.depth == 1:
                self.began = time.monotonic()
                for watcher in _watchers:
                    watcher(True)
                # Worker processes are silent: all would print the same line at the same time.
                if not _watchers and parent_process() is None:
                    announce_compilation()

        def on_end(self, _: Any) -> None:
            self.depth -= 1
            if self.depth == 0:
                _spent.append(time.monotonic() - self.began)
                for watcher in _watchers:
                    watcher(False)

    event.register("numba:compile", Listener())


@cache
def _register(function: Callable[..., Any]) -> None:
    """Make a function known to Numba, so that compiled functions can call it."""
    from numba.extending import overload, register_jitable

    # Only compiled functions call it: without entry points for C, compiling takes a seventh less time.
    options = {"no_cfunc_wrapper": True}
    # Functions that choose by the type of their argument cannot be compiled; their forms for floats take their place.
    if function in COMPILED_FORMS:
        overload(function, jit_options=options)(COMPILED_FORMS[function])
    else:
        register_jitable(**options)(function)


def _version(functions: Iterable[Callable[..., Any]]) -> int:
    """Return a number that changes with the source files of the functions and the versions of Python and NumPy."""
    files = sorted({inspect.getsourcefile(function) or "" for function in functions})
    # 14 hexadecimal digits are 56 bits, which fit into the 64-bit integers of Numba.
    return int(digest(f"{sys.version} {np.__version__}", *(Path(file).read_bytes() for file in files))[:14], 16)
