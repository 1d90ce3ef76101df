"""Functions, operators and methods that expressions of xacro files may use, each with a bounded cost and result."""

import ast
import math
import operator
import re
import string
from collections.abc import Callable
from typing import Any

from xacro import NameSpace, Table, XacroException, YamlDictWrapper, YamlListWrapper, tokenize

LARGEST = 100_000
"""Characters of a text, and items of a collection with all that is in it."""

BITS = 256
"""Largest size of an integer [bit]."""

_ARGUMENT = 1_000  # the largest argument of functions whose cost grows with it; widths and precisions of formats
_NUMBER = re.compile(r"\d+")
_CONVERSION = re.compile(r"%(?:\([^)]*\))?([-#0 +]*[\d*]*(?:\.[\d*]*)?)")

METHODS: dict[type, frozenset[str]] = {
    str: frozenset({
        "capitalize", "center", "count", "endswith", "find", "format", "index", "isalnum", "isalpha", "isdigit",
        "islower", "isnumeric", "isspace", "isupper", "join", "ljust", "lower", "lstrip", "partition", "replace",
        "rfind", "rindex", "rjust", "rpartition", "rsplit", "rstrip", "split", "splitlines", "startswith", "strip",
        "swapcase", "title", "upper", "zfill"
    }),
    list: frozenset({"count", "index"}),
    tuple: frozenset({"count", "index"}),
    dict: frozenset({"get", "items", "keys", "values"}),
    float: frozenset({"is_integer"}),
}  # fmt: skip
"""Methods that an expression may call, by type."""


class Functions(dict[str, object]):
    """Functions and constants below a name such as ``math``."""


# --- bounds -------------------------------------------------------------------------------------------------------


def checked(value: Any, functions: set[int], *, new: bool = True) -> Any:
    """Return a value after checking its type and size; the size of a collection counts where it is new.

    Raises:
        XacroException: the type is not allowed, or the value is too large.
    """
    # Numbers and None have a fixed size; bool is an int and comes first.
    if isinstance(value, bool | float) or value is None:
        return value
    if isinstance(value, int):
        if value.bit_length() > BITS:
            raise XacroException(f"an integer of more than {BITS} bits")
        return value
    if isinstance(value, str):
        check_size(len(value))
        return value
    if isinstance(value, Functions | NameSpace | slice) or id(value) in functions:
        return value
    if isinstance(value, list | tuple | dict | set | frozenset) and not isinstance(value, Table):
        # Measuring a collection again at each look-up would cost more than the expression.
        if new:
            check_size(measure(value))
        return value
    raise XacroException(f"a value of the type {type(value).__name__} is not allowed in an expression")


def measure(value: Any, *, most: int = LARGEST) -> int:
    """Return the characters and items of a value, with all that is in it; counting stops above `most`."""
    # Without recursion, so that deep nesting cannot exhaust the stack; values met twice count twice.
    total, waiting = 0, [value]
    while waiting and total <= most:
        item = waiting.pop()
        total += 1
        if isinstance(item, str):
            total += len(item)
        elif isinstance(item, dict):
            total += len(item)
            if total <= most:
                waiting += [*dict.keys(item), *dict.values(item)]
        elif isinstance(item, list | tuple | set | frozenset):
            total += len(item)
            if total <= most:
                waiting += item
    return total


def check_size(size: float) -> None:
    """Raise an error for a size above :data:`LARGEST`."""
    if size > LARGEST:
        raise XacroException(f"a value of more than {LARGEST} characters or items")


def _small(*numbers: Any) -> None:
    """Reject large arguments of functions whose cost grows with them."""
    for number in numbers:
        if isinstance(number, int) and abs(number) > _ARGUMENT:
            raise XacroException(f"an argument of {number.bit_length()} bits is larger than {_ARGUMENT}")


def items_of(value: Any) -> list[Any]:
    """Return the items of a collection.

    Raises:
        TypeError: it is not one.
    """
    if isinstance(value, str | list | tuple | dict | set | frozenset) and not isinstance(value, Table | Functions):
        return list(value)
    raise TypeError(f"'{type(value).__name__}' object is not iterable")


def text_of(value: Any = "") -> str:
    """Return the text of a value."""
    return str(printable(value))


def repr_of(value: Any) -> str:
    """Return the text of a value as Python writes it."""
    return repr(printable(value))


def printable(value: Any) -> Any:
    """Return a value whose text does not contain an address in memory.

    Raises:
        XacroException: it is a function or contains one.
    """
    # Shared parts are visited again each time, so the size is checked first.
    check_size(measure(value))
    waiting = [value]
    while waiting:
        item = waiting.pop()
        if callable(item) or isinstance(item, Functions | Table):
            raise XacroException("a function has no text")
        if isinstance(item, dict):
            waiting += [*dict.keys(item), *dict.values(item)]
        elif isinstance(item, list | tuple | set | frozenset):
            waiting += item
    return value


# --- operators ----------------------------------------------------------------------------------------------------


def _add(left: Any, right: Any) -> Any:
    if isinstance(left, str | list | tuple) and isinstance(right, str | list | tuple):
        check_size(len(left) + len(right))
    return left + right


def _multiply(left: Any, right: Any) -> Any:
    # The size of the result is known before it is made.
    for repeated, times in ((left, right), (right, left)):
        if isinstance(repeated, str | list | tuple) and isinstance(times, int):
            check_size(measure(repeated) * max(times, 0))
    return left * right


def _power(left: Any, right: Any) -> Any:
    # A lower bound of the bits of the result: |left| >= 2^(bits - 1).
    integers = isinstance(left, int) and isinstance(right, int) and abs(left) > 1
    if integers and (left.bit_length() - 1) * abs(right) > BITS:
        raise XacroException(f"an integer of more than {BITS} bits")
    return left**right


def _shift(operation: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    def shift(left: Any, right: Any) -> Any:
        if isinstance(right, int) and right > BITS:
            raise XacroException(f"a shift by more than {BITS} bits")
        return operation(left, right)

    return shift


def _modulo(left: Any, right: Any) -> Any:
    if isinstance(left, str):
        # Widths and precisions of a format are memory that the text does not show.
        for spec in _CONVERSION.findall(left):
            _check_format(spec)
            if "*" in spec:
                raise XacroException("a format with * is not allowed in an expression")
        printable(right)
        check_size(len(left) + (left.count("%") + 1) * measure(right))
    return left % right


def _check_format(text: str) -> None:
    if any(len(number) > 4 or int(number) > _ARGUMENT for number in _NUMBER.findall(text)):
        raise XacroException(f"a format with a number above {_ARGUMENT}")


# --- functions ----------------------------------------------------------------------------------------------------


class _Formatter(string.Formatter):
    """``str.format`` without attributes and items of the arguments."""

    def get_field(self, field_name: str, args: Any, kwargs: Any) -> Any:
        if "." in field_name or "[" in field_name:
            raise XacroException("a format may not use attributes or items: give the value itself")
        return super().get_field(field_name, args, kwargs)

    def format_field(self, value: Any, format_spec: str) -> Any:
        return format_value(value, format_spec)

    def convert_field(self, value: Any, conversion: Any) -> Any:
        return super().convert_field(printable(value), conversion)


def format_value(value: Any, spec: str) -> str:
    """Return a value formatted with a bounded width and precision."""
    _check_format(spec)
    return format(printable(value), spec)


def _format(text: str, *values: Any, **named: Any) -> str:
    check_size(len(text) + text.count("{") * measure([values, named]))
    return _Formatter().vformat(text, values, named)


def _replace(text: str, old: str, new: str, count: int = -1) -> str:
    matches = text.count(old) if count < 0 else min(text.count(old), count)
    check_size(len(text) + matches * len(new))
    return text.replace(old, new, count)


def _join(text: str, parts: Any) -> str:
    items = items_of(parts)
    check_size(measure(items) + len(text) * len(items))
    return text.join(items)


def _padded(name: str) -> Callable[..., str]:
    def pad(text: str, width: int, *fill: str) -> str:
        _small(width)
        return str(getattr(text, name)(width, *fill))

    return pad


_SAFE_METHODS: dict[str, Callable[..., Any]] = {
    "format": _format,
    "replace": _replace,
    "join": _join,
    **{name: _padded(name) for name in ("center", "ljust", "rjust", "zfill")},
}


def method_of(owner: Any, name: str) -> Callable[..., Any]:
    """Return a method of :data:`METHODS`."""
    if isinstance(owner, dict):
        # Nested YAML data keep the wrapper that gives them attribute access.
        wrap = YamlListWrapper.wrap if isinstance(owner, YamlDictWrapper) else lambda value: value
        plain: dict[str, Callable[..., Any]] = {
            "get": lambda *key: wrap(dict.get(owner, *key)),
            "items": lambda: [(key, wrap(value)) for key, value in dict.items(owner)],
            "keys": lambda: list(dict.keys(owner)),
            "values": lambda: [wrap(value) for value in dict.values(owner)],
        }
        return plain[name]
    if isinstance(owner, str) and name in _SAFE_METHODS:
        return lambda *values, **named: _SAFE_METHODS[name](owner, *values, **named)
    method: Callable[..., Any] = getattr(owner, name)
    return method


def _round(value: Any, digits: int | None = None) -> Any:
    _small(digits)
    return round(value, digits)


def range_of(*limits: Any) -> list[int]:
    """Return the numbers of a range as a list."""
    numbers = range(*limits)
    # len() of a longer range raises an OverflowError.
    check_size(len(numbers) if all(abs(limit) < 1 << 62 for limit in limits) else math.inf)
    return list(numbers)


def _sum(values: Any, start: Any = 0) -> Any:
    items = items_of(values)
    # Sums of lists would grow without a check of their size.
    if any(not isinstance(item, int | float) for item in (*items, start)):
        raise TypeError("sum adds numbers only")
    return sum(items, start)


def _int(value: Any = 0, *base: Any) -> int:
    if isinstance(value, str):
        _small(len(value))
    return int(value, *base)


def _map(function: Callable[..., Any], *values: Any) -> list[Any]:
    results: list[Any] = []
    size = 0
    for items in zip(*map(items_of, values), strict=False):
        # The function may be any allowed one, so each result is checked like a value of an expression.
        results.append(checked(function(*items), set()))
        size += measure(results[-1])
        check_size(10 * size)
    return results


def _filter(function: Callable[..., Any] | None, values: Any) -> list[Any]:
    items = items_of(values)
    results = items if function is None else _map(function, items)
    return [item for item, keep in zip(items, results, strict=True) if keep]


def tokenize_text(text: str, sep: str = ",; ", skip_empty: bool = True) -> list[str]:
    """Return the parts of a text between separators."""
    if not isinstance(sep, str) or len(sep) > 20 or any(letter in sep for letter in "[]\\^-"):
        raise XacroException("tokenize: the separators are single characters other than [ ] \\ ^ -")
    parts: list[str] = tokenize(text, sep, skip_empty)
    return parts


def extreme_of(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return ``min``, ``max`` or ``sorted`` with plain functions as key only."""

    def extreme(*values: Any, **named: Any) -> Any:
        if named.get("key") not in {None, abs, len, float, _int, text_of}:
            raise XacroException("key must be abs, len, float, int or str")
        return function(*values, **named)

    return extreme


def _instance(value: Any, kinds: Any) -> bool:
    if isinstance(kinds, tuple):
        return any(_instance(value, kind) for kind in kinds)
    return isinstance(value, {_int: int, text_of: str}.get(kinds, kinds))


def _limited(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of integers with a limit on their size, on which its cost depends."""

    def limited(*values: Any) -> Any:
        _small(*values)
        return function(*values)

    return limited


def _fold(function: Callable[[Any, Any], Any], start: int) -> Callable[..., Any]:
    """Return a function of any number of integers with a limit on its result."""

    def fold(*values: Any) -> Any:
        result: Any = start
        for value in values:
            result = checked(function(result, value), set())
        return result

    return fold


def _product(values: Any, *, start: Any = 1) -> Any:
    result = start
    for value in items_of(values):
        result = checked(result * value if isinstance(value, int | float) else math.nan, set())
    return result


PYTHON: dict[str, object] = {
    "True": True, "False": False, "list": list, "dict": dict, "len": len, "str": text_of, "float": float, "int": _int,
    "bool": bool, "tuple": tuple, "set": set, "frozenset": frozenset, "abs": abs, "all": all, "any": any,
    "divmod": divmod, "ord": ord, "map": _map, "filter": _filter, "min": extreme_of(min), "max": extreme_of(max),
    "round": _round, "sorted": extreme_of(sorted), "range": range_of, "sum": _sum, "repr": repr_of,
    "isinstance": _instance,
    "enumerate": lambda values, start=0: list(enumerate(items_of(values), start)),
    "reversed": lambda values: items_of(values)[::-1],
    "zip": lambda *values: list(zip(*map(items_of, values), strict=False)),
}  # fmt: skip

MATH: dict[str, object] = {name: value for name, value in vars(math).items() if not name.startswith("_")}
MATH |= {"factorial": _limited(math.factorial), "comb": _limited(math.comb), "perm": _limited(math.perm)} | {
    "prod": _product
}
MATH |= {"gcd": _fold(math.gcd, 0), "lcm": _fold(math.lcm, 1)}

UNARY: dict[type, Callable[[Any], Any]] = {
    ast.UAdd: operator.pos,
    ast.USub: operator.neg,
    ast.Not: operator.not_,
    ast.Invert: operator.inv,
}
BINARY: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: _add,
    ast.Sub: operator.sub,
    ast.Mult: _multiply,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: _modulo,
    ast.Pow: _power,
    ast.LShift: _shift(operator.lshift),
    ast.RShift: _shift(operator.rshift),
    ast.BitAnd: operator.and_,
    ast.BitOr: operator.or_,
    ast.BitXor: operator.xor,
}
COMPARISONS: dict[type, Callable[[Any, Any], Any]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Is: operator.is_,
    ast.IsNot: operator.is_not,
    ast.In: lambda left, right: left in right,
    ast.NotIn: lambda left, right: left not in right,
}
