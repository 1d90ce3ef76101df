"""The equations of the single-track model as a plain function of floats, written out by a run of the equations.

:func:`mirdrake.single_track.dynamics.evaluate` takes whatever can be added and multiplied. Here it gets symbols that
write down what is done with them; what comes of it is compiled. The operations and their order are the same, so that
the numbers are the same to the last bit. It takes 40 % of the time: what depends on parameters alone is computed
once for them, what an output does not need is left out, and ``min``, ``max`` and ``abs`` are no calls.
"""

import math
from collections.abc import Callable, Sequence
from functools import cache
from types import SimpleNamespace
from typing import Any, NamedTuple

from mirdrake.single_track.dynamics import Variant, evaluate
from mirdrake.single_track.parameters import PARAMETERS

_CALLS = ("sin", "cos", "tan", "atan", "tanh", "sqrt")


class Fast(NamedTuple):
    """The equations of a variant for floats.

    Attributes:
        prepare: from parameters, in the order of :data:`PARAMETERS`, to what the others take as their first argument.
        rates: from that, state and inputs to the derivatives of the state.
        motion: the same to :data:`mirdrake.single_track.system.MOTION`.
    """

    prepare: Callable[[Sequence[float]], tuple[float, ...]]
    rates: Callable[[tuple[float, ...], Sequence[float], Sequence[float]], list[float]]
    motion: Callable[[tuple[float, ...], Sequence[float], Sequence[float]], list[float]]


class _Symbol:
    """A value whose number is not known yet; every operation with it is written on its tape, once."""

    def __init__(self, tape: "_Tape", name: str) -> None:
        self.tape, self.name = tape, name

    def __add__(self, other: Any) -> Any:
        return self.tape.write("{} + {}", self, other)

    def __radd__(self, other: Any) -> Any:
        return self.tape.write("{} + {}", other, self)

    def __sub__(self, other: Any) -> Any:
        return self.tape.write("{} - {}", self, other)

    def __rsub__(self, other: Any) -> Any:
        return self.tape.write("{} - {}", other, self)

    def __mul__(self, other: Any) -> Any:
        return self.tape.write("{} * {}", self, other)

    def __rmul__(self, other: Any) -> Any:
        return self.tape.write("{} * {}", other, self)

    def __truediv__(self, other: Any) -> Any:
        return self.tape.write("{} / {}", self, other)

    def __rtruediv__(self, other: Any) -> Any:
        return self.tape.write("{} / {}", other, self)

    def __neg__(self) -> Any:
        return self.tape.write("-{}", self)

    def __bool__(self) -> bool:
        raise TypeError("the equations must not branch on a value")


class _Tape:
    """Operations in their order.

    Attributes:
        lines: name of each result, to its text and the names it needs.
        early: names of what depends on parameters only.
    """

    def __init__(self) -> None:
        self.lines: dict[str, tuple[str, list[str]]] = {}
        self.early = {f"p{i}" for i in range(len(PARAMETERS))}
        self._known: dict[str, str] = {}
        self.maths = SimpleNamespace(
            **{name: lambda value, call=name: self.write(call + "({})", value) for name in _CALLS},
            abs=lambda value: self.write("-{0} if {0} < 0.0 else {0}", value),
            min=lambda one, other: self.write("{1} if {1} < {0} else {0}", one, other),
            max=lambda one, other: self.write("{1} if {1} > {0} else {0}", one, other),
        )

    def symbols(self, letter: str, count: int) -> list[_Symbol]:
        """Symbols with numbers: parameters ``p``, state ``x``, inputs ``u``."""
        return [_Symbol(self, f"{letter}{i}") for i in range(count)]

    def write(self, operation: str, *values: Any) -> _Symbol:
        """The result of an operation; numbers among its values are written as they are."""
        text = operation.format(*(v.name if isinstance(v, _Symbol) else f"({float(v)!r})" for v in values))
        if text not in self._known:
            needs = [v.name for v in values if isinstance(v, _Symbol)]
            name = self._known[text] = f"t{len(self.lines)}"
            self.lines[name] = text, needs
            if self.early.issuperset(needs):
                self.early.add(name)
        return _Symbol(self, self._known[text])

    def needed(self, results: Sequence[str]) -> set[str]:
        """Names of all that results need, themselves too."""
        found, waiting = set[str](), list(results)
        while waiting:
            name = waiting.pop()
            if name not in found:
                found.add(name)
                waiting += self.lines[name][1] if name in self.lines else []
        return found


@cache
def make_fast(variant: Variant, states: int, inputs: int) -> Fast:
    """The equations of a variant, compiled.

    Args:
        variant: which equations.
        states: how many.
        inputs: the same.
    """
    tape = _Tape()
    letters = {"p": len(PARAMETERS), "x": states, "u": inputs}
    p, x, u = (tape.symbols(letter, count) for letter, count in letters.items())
    both = [
        [value.name if isinstance(value, _Symbol) else repr(float(value)) for value in values]
        for values in evaluate(variant, p, x, u, maths=tape.maths)
    ]
    parts = [tape.needed(results) for results in both]
    late = {name for part in parts for name in part - tape.early}
    # of what is early, late lines and the results themselves ask for these
    kept = {need for name in late & tape.lines.keys() for need in tape.lines[name][1] if need in tape.early}
    kept |= {name for results in both for name in results if name in tape.early}
    order = [*(f"p{i}" for i in range(len(PARAMETERS))), *tape.lines]
    constants = [name for name in order if name in kept]
    before = tape.needed(constants)
    text = _function("prepare", ["p"], letters, [n for n in tape.lines if n in before], tape, constants, "({},)")
    for name, results, part in zip(("rates", "motion"), both, parts, strict=True):
        steps = [n for n in tape.lines if n in part and n not in tape.early]
        text += _function(name, ["x", "u"], letters, steps, tape, results, "[{}]", constants)
    found: dict[str, Any] = {name: getattr(math, name) for name in _CALLS}
    exec(compile(text, f"<single track: {variant}>", "exec"), found)
    return Fast(found["prepare"], found["rates"], found["motion"])


def _function(
    name: str,
    arguments: Sequence[str],
    letters: dict[str, int],
    steps: Sequence[str],
    tape: _Tape,
    results: Sequence[str],
    form: str,
    constants: Sequence[str] = (),
) -> str:
    """The text of a function of vectors."""
    lines = [f"def {name}({', '.join([*(['c'] if constants else []), *arguments])}):"]
    lines += [f"    {', '.join(constants)}, = c"] if constants else []
    lines += [f"    {', '.join(f'{letter}{i}' for i in range(letters[letter]))}, = {letter}" for letter in arguments]
    lines += [f"    {step} = {tape.lines[step][0]}" for step in steps]
    return "\n".join([*lines, f"    return {form.format(', '.join(results))}", "", ""])
