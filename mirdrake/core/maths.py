"""Elementary functions for floats, arrays, arrays of JAX, AutoDiffXd and Expressions: one equation serves all of them.

For a float they are those of the standard library, which are much faster than Drake's and NumPy's for single numbers.
:mod:`mirdrake.core.compiled` compiles them to the same functions.
"""

import math
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
import pydrake.math as drake_math

Value: TypeAlias = Any
"""A float, an array of floats, an AutoDiffXd or an Expression; the arguments of one call broadcast to one shape."""


def _library(*values: Value) -> Any:
    """Return the module with the functions for values that are not all floats."""
    # An array of NumPy wins over a Drake type: an object array of AutoDiffXd is one, too.
    if any(isinstance(value, np.ndarray) for value in values):
        return np
    if any(type(value).__module__.startswith("jax") for value in values):
        import jax.numpy

        return jax.numpy
    return drake_math


def sin(x: Value) -> Value:
    """Return the sine."""
    return math.sin(x) if isinstance(x, float) else _library(x).sin(x)


def cos(x: Value) -> Value:
    """Return the cosine."""
    return math.cos(x) if isinstance(x, float) else _library(x).cos(x)


def tan(x: Value) -> Value:
    """Return the tangent."""
    return math.tan(x) if isinstance(x, float) else _library(x).tan(x)


def atan(x: Value) -> Value:
    """Return the arc tangent."""
    if isinstance(x, float):
        return math.atan(x)
    library = _library(x)
    return library.atan(x) if library is drake_math else library.arctan(x)


def tanh(x: Value) -> Value:
    """Return the hyperbolic tangent."""
    return math.tanh(x) if isinstance(x, float) else _library(x).tanh(x)


def exp(x: Value) -> Value:
    """Return the exponential."""
    return math.exp(x) if isinstance(x, float) else _library(x).exp(x)


def sqrt(x: Value) -> Value:
    """Return the square root."""
    return math.sqrt(x) if isinstance(x, float) else _library(x).sqrt(x)


def absolute(x: Value) -> Value:
    """Return the absolute value."""
    return abs(x) if isinstance(x, float) else _library(x).abs(x)


def smaller(x: Value, y: Value) -> Value:
    """Return the smaller one of two values; the first if they are equal."""
    if isinstance(x, float) and isinstance(y, float):
        return y if y < x else x
    library = _library(x, y)
    return library.min(x, y) if library is drake_math else library.minimum(x, y)


def larger(x: Value, y: Value) -> Value:
    """Return the larger one of two values; the first if they are equal."""
    if isinstance(x, float) and isinstance(y, float):
        return y if y > x else x
    library = _library(x, y)
    return library.max(x, y) if library is drake_math else library.maximum(x, y)


def choose(condition: Any, yes: Value, no: Value) -> Value:
    """Return one of two values by a condition, for each element of arrays; not for Expressions."""
    # Most conditions are plain, and this is called at every step.
    if isinstance(condition, bool):
        return yes if condition else no
    library = _library(condition)
    return (yes if condition else no) if library is drake_math else library.where(condition, yes, no)


def wrap_angle(angle: float) -> float:
    """Return an angle in [-pi, pi] [rad]; for floats only."""
    return math.remainder(angle, 2.0 * math.pi)


def _wrap_angle(angle):  # type: ignore[no-untyped-def]  # Numba compares its signature with that of a lambda
    """Return the same as :func:`wrap_angle`, bit by bit; for Numba, which does not know math.remainder.

    The remainders of positive numbers are exact; m is in [0, 2 pi), and c is its distance to 2 pi.
    """
    turn, size = 2.0 * math.pi, abs(angle)
    m = size % turn
    c = turn - m
    # Half a turn goes to the even number of turns, as IEEE 754 has it.
    r = m if m < c else -c if m > c else m - 2.0 * (0.5 * (size - m) % turn)
    return math.copysign(1.0, angle) * r


# Numba matches the names of arguments, so each overload repeats them.
# ruff: noqa: ARG005
COMPILED_FORMS: dict[Callable[..., Any], Callable[..., Any]] = {
    sin: lambda x: lambda x: math.sin(x),
    cos: lambda x: lambda x: math.cos(x),
    tan: lambda x: lambda x: math.tan(x),
    atan: lambda x: lambda x: math.atan(x),
    tanh: lambda x: lambda x: math.tanh(x),
    exp: lambda x: lambda x: math.exp(x),
    sqrt: lambda x: lambda x: math.sqrt(x),
    absolute: lambda x: lambda x: abs(x),
    smaller: lambda x, y: lambda x, y: y if y < x else x,
    larger: lambda x, y: lambda x, y: y if y > x else x,
    choose: lambda condition, yes, no: lambda condition, yes, no: yes if condition else no,
    wrap_angle: lambda angle: _wrap_angle,
}
"""Numba overload of each function for floats, which :mod:`mirdrake.core.compiled` compiles in its place."""
