"""Elementary functions for floats, numpy arrays and AutoDiffXd alike, so that one tyre law serves all three.

``math`` is ten times as fast as numpy for one float, and a simulation asks for one wheel at a time; numpy takes arrays
and, by the methods of the object, a single AutoDiffXd. :func:`maths_for` chooses by the types of the inputs.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

Value: TypeAlias = Any
"""A float, an array of floats or an AutoDiffXd; the inputs of one call broadcast to one shape."""


@dataclass(frozen=True, slots=True)
class Maths:
    """A set of elementary functions of one kind of number.

    Attributes:
        sin: sine.
        cos: cosine.
        atan: arc tangent.
        exp: exponential.
        sqrt: square root.
        where: choice (condition, value if true, value if false).
    """

    sin: Callable[[Value], Value]
    cos: Callable[[Value], Value]
    atan: Callable[[Value], Value]
    exp: Callable[[Value], Value]
    sqrt: Callable[[Value], Value]
    where: Callable[[Value, Value, Value], Value]

    def at_least(self, value: Value, bound: Value) -> Value:
        """The larger one of both, as ``max``."""
        return self.where(value < bound, bound, value)

    def at_most(self, value: Value, bound: Value) -> Value:
        """The smaller one of both, as ``min``."""
        return self.where(value > bound, bound, value)

    def sign(self, value: Value) -> Value:
        """1 from zero on, -1 below: never 0, as the Magic Formula wants it in denominators."""
        return self.where(value < 0.0, -1.0, 1.0)

    def direction(self, speed: Value, low: float) -> Value:
        """Direction of rolling: ±1 from the speed `low` [m/s] on, sin(π v / 2 low) below; once differentiable."""
        limited = self.at_most(self.at_least(speed, -low), low)
        return self.sin((0.5 * math.pi / low) * limited)


def _choose(condition: Any, yes: Value, no: Value) -> Value:
    return yes if condition else no


def _choose_each(condition: Any, yes: Value, no: Value) -> Value:
    return np.where(np.asarray(condition, dtype=bool), yes, no)


FLOAT = Maths(math.sin, math.cos, math.atan, math.exp, math.sqrt, _choose)
AUTODIFF = Maths(np.sin, np.cos, np.arctan, np.exp, np.sqrt, _choose)
ARRAY = Maths(np.sin, np.cos, np.arctan, np.exp, np.sqrt, _choose_each)


def maths_for(*values: Value) -> Maths:
    """The functions for these inputs: of arrays if one of them is an array, else of single numbers."""
    kind = FLOAT
    for value in values:
        if isinstance(value, np.ndarray):
            return ARRAY
        if not isinstance(value, float | int):
            kind = AUTODIFF
    return kind
