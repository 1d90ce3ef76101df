"""Machine code for what happens in every step of the plant, and records of numbers for it.

Python takes a hundred times as long for a formula as the processor would, which is too much for what is asked at every
step of the plant. What is asked there is therefore written as plain Python functions of floats, arrays and records of
numbers, and compiled by Numba [1]: the text that is read is the text that runs. Rules for such functions are Numba's:
indices instead of unpacking, no None, no closures, no keyword-only arguments. Arithmetic is IEEE's, in the order in
which it is written.

Compiling takes some seconds, once: the code is kept beside the source files, or in the user's cache where these cannot
be written, until one of the source files changes.

[1] S. K. Lam, A. Pitrou, S. Seibert, Numba: a LLVM-based Python JIT compiler, LLVM-HPC 2015.
"""

import inspect
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import astuple, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np
import numpy.typing as npt

from mirdrake.core.digest import digest
from mirdrake.core.maths import COMPILED_FORMS

Records = npt.NDArray[np.void]
"""An array of records; machine code reads and writes their fields with dots."""


def record_type(kind: type[Any]) -> np.dtype[np.void]:
    """The record of a named tuple or dataclass, with fields of the same names.

    Args:
        kind: the class; its fields are floats, ints, bools, tuples of one of these, or such classes again; of any
            kind: floats.
    """
    return np.dtype([(name, *_field(hint)) for name, hint in get_type_hints(kind).items()], align=True)


def _field(hint: Any) -> tuple[Any, ...]:
    if hint is Any:
        return (np.dtype(float),)
    if hint in (float, int, bool):
        return (np.dtype(hint),)
    parts = get_args(hint)  # of a tuple; Numba has no arrays of bools in records
    kind = int if parts and parts[0] is bool else parts[0] if parts else None
    return (np.dtype(kind), (len(parts),)) if parts else (record_type(hint),)


def records(kind: type[Any], values: Iterable[Any]) -> Records:
    """Named tuples or dataclasses of one class as records."""
    return np.array([plain(value) for value in values], dtype=record_type(kind))


def plain(value: Any) -> Any:
    """Named tuples and dataclasses, nested or not, as plain tuples: what a record can be set to."""
    if is_dataclass(value) and not isinstance(value, type):
        value = astuple(value)
    return tuple(map(plain, value)) if isinstance(value, tuple) else value


def compiled(
    function: Callable[..., Any],
    law: Callable[..., Any] | tuple[Callable[..., Any], ...] | None = None,
    *,
    parts: Sequence[Callable[..., Any]],
) -> Callable[..., Any]:
    """A function in machine code.

    The first call for arguments of new types loads the code, or makes it.

    Args:
        function: to compile.
        law: its first argument, or its first three, if these are functions; the compiled one goes without.
        parts: what both call, and what those call.
    """
    laws = () if law is None else law if isinstance(law, tuple) else (law,)
    return _compiled(function, laws, tuple(parts))


@cache
def _compiled(
    function: Callable[..., Any], laws: tuple[Callable[..., Any], ...], parts: tuple[Callable[..., Any], ...]
) -> Callable[..., Any]:
    from numba import njit

    everything = [function, *laws, *parts, *COMPILED_FORMS]
    for part in everything:
        _register(part)
    version = _version(everything)  # a part of the key under which Numba keeps code: it looks at one source file only

    def call(*arguments: Any) -> Any:
        _ = version
        return function(*arguments)

    def call_with_law(*arguments: Any) -> Any:
        _ = version
        return function(first, *arguments)

    def call_with_three(*arguments: Any) -> Any:
        _ = version
        return function(first, second, third, *arguments)

    # Numba resolves functions in the closure at compile time only if each is a variable of its own.
    first, second, third = (*laws, None, None, None)[:3]
    calling: Callable[..., Any] = {0: call, 1: call_with_law, 3: call_with_three}[len(laws)]
    try:
        compiling: Callable[..., Any] = njit(cache=True)(calling)
    except RuntimeError:  # nowhere to write
        compiling = njit(calling)
    return compiling


@cache
def _register(function: Callable[..., Any]) -> None:
    """Make a function known to Numba, so that compiled functions can call it."""
    from numba.extending import overload, register_jitable

    if function in COMPILED_FORMS:
        overload(function)(COMPILED_FORMS[function])
    else:
        register_jitable(function)


def _version(functions: Iterable[Callable[..., Any]]) -> int:
    """A number that is another one when a source file of the functions, or a library below, is another one."""
    files = sorted({inspect.getsourcefile(function) or "" for function in functions})
    return int(digest(f"{sys.version} {np.__version__}", *(Path(file).read_bytes() for file in files))[:14], 16)
