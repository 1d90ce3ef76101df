"""Evaluates the expressions of xacro files without executing Python.

The syntax tree of an expression is walked and computed here, so that a file can do what is listed below and nothing
else: numbers, text, lists, dictionaries, arithmetic, comparisons, conditions, comprehensions, formatted text, indexing,
and calls of the functions that xacro documents (``math.*``, ``python.*``, ``xacro.*``). There is no ``lambda``, no
attribute of Python objects, and no method but those in :data:`METHODS`. Every value has a bounded size, and every
expression a bounded number of steps.
"""

import ast
import math
import operator
import re
import string
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from xacro import NameSpace, Table, XacroException, YamlDictWrapper, YamlListWrapper, tokenize

LONGEST = 5_000
"""Characters of an expression."""

STEPS = 50_000
"""Nodes of the syntax tree that an expression evaluates, with repetitions in comprehensions."""

SECONDS = 0.5
"""Processor time of an expression [s], with the properties that it uses."""

PROPERTIES = 200
"""Properties that are evaluated within one another, each for the expression of the one before."""

LARGEST = 100_000
"""Characters of a text, and items of a collection with all that is in it."""

BITS = 256
"""Bits of an integer."""

_DEPTH = 60  # of nested operations
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


class _Functions(dict[str, object]):
    """Functions and constants below a name such as ``math``."""


class Evaluator:
    """Evaluates expressions.

    Args:
        load_yaml: reads a YAML file for ``xacro.load_yaml``.
        abs_filename: for ``xacro.abs_filename``.
        argument: value of an argument, for ``xacro.arg``.
        warn: gets the texts of ``xacro.message``, ``xacro.warning`` and ``xacro.error``.
        tick: called all along an evaluation; raises an error when no time is left.
    """

    def __init__(
        self,
        *,
        load_yaml: Callable[[str], Any],
        abs_filename: Callable[[str], str],
        argument: Callable[[str], Any],
        warn: Callable[[str], None],
        tick: Callable[[], None] = lambda: None,
    ) -> None:
        def tell(*texts: Any) -> str:
            warn(" ".join(map(_text, texts)))
            return ""

        def deprecated(space: str, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
            def call(*values: Any, **named: Any) -> Any:
                warn(f"Using {name}() directly is deprecated. Use {space}.{name}() instead.")
                return function(*values, **named)

            return call

        def fatal(*texts: Any) -> None:
            raise XacroException(" ".join(map(_text, texts)))

        xacro_functions = {
            "load_yaml": load_yaml,
            "abs_filename": abs_filename,
            "arg": argument,
            "dotify": lambda value: YamlDictWrapper(dict(value)),
            "tokenize": _tokenize,
            "fatal": fatal,
        } | dict.fromkeys(("message", "warning", "error", "print_location"), tell)
        spaces = {"math": _Functions(_MATH), "python": _Functions(_PYTHON), "xacro": _Functions(xacro_functions)}
        direct = {
            name: deprecated("xacro", name, xacro_functions[name]) for name in ("load_yaml", "abs_filename", "dotify")
        }
        direct |= {
            name: deprecated("python", name, function)
            for name, function in (("sorted", _extreme(sorted)), ("range", _range))
        }
        self._names: dict[str, object] = {**_MATH, **_PYTHON, **direct, **spaces}
        self._functions = [*self._names.values(), *(value for space in spaces.values() for value in space.values())]
        self._callable = {id(entry) for entry in self._functions if callable(entry)}
        self._tick = tick
        self._steps, self._until, self._nested = 0, 0.0, 0
        self._symbols: Any = {}
        self._first: Mapping[str, Any] = {}

    def evaluate(self, text: str, symbols: Mapping[str, Any], *, names: Mapping[str, Any] | None = None) -> Any:
        """Return the value of an expression.

        Args:
            text: the expression.
            symbols: xacro's table of properties; anything else has none.
            names: more names, before all others; their functions may be called.

        Raises:
            XacroException: the expression uses what is not allowed, or its value is too large.
            NameError, TypeError, ValueError and so on: as Python raises them.
        """
        if len(text) > LONGEST:
            raise XacroException(f"an expression of {len(text)} characters; {LONGEST} are allowed")
        try:
            tree = ast.parse(text.strip(), mode="eval")
        except (MemoryError, RecursionError):
            raise XacroException("the expression is nested too deeply") from None
        except ValueError as error:  # a null character, or a number of too many digits
            raise SyntaxError(str(error)) from None
        if self._nested >= PROPERTIES:  # Python's own limit would be met in the middle of xacro's error message
            raise XacroException(f"more than {PROPERTIES} properties that refer to one another")
        # A property is evaluated when an expression uses it for the first time, within that expression.
        outer = self._steps, self._symbols, self._first, self._callable, self._until
        self._steps, self._symbols, self._first = 0, symbols, names or {}
        self._until, self._nested = time.thread_time() + SECONDS, self._nested + 1
        self._callable = self._callable | {id(function) for function in self._first.values() if callable(function)}
        try:
            return self._value(tree.body, {}, 0)
        finally:
            self._steps, self._symbols, self._first, self._callable, self._until = outer
            self._nested -= 1

    def _value(self, node: ast.AST, local: Mapping[str, Any], depth: int) -> Any:
        """Return the checked value of a node."""
        self._steps += 1
        if self._steps > STEPS:
            raise XacroException(f"the expression takes more than {STEPS} steps")
        if self._steps % 16 == 0:
            self._tick()
            if time.thread_time() > self._until:
                raise XacroException(f"the expression takes more than {SECONDS:g} s")
        if depth > _DEPTH:
            raise XacroException("the expression is nested too deeply")
        method = _NODES.get(type(node))
        if method is None:
            raise XacroException(f"{_WORDS.get(type(node), type(node).__name__)} is not allowed in an expression")
        value = method(self, node, local, depth + 1)
        return _checked(value, self._callable, new=type(node) not in _LOOKUPS)

    # --- values ------------------------------------------------------------------------------------------------------

    def _constant(self, node: ast.Constant, _local: Mapping[str, Any], _depth: int) -> Any:
        return node.value

    def _name(self, node: ast.Name, local: Mapping[str, Any], _depth: int) -> Any:
        name = node.id
        if name.startswith("__"):
            raise XacroException(f"Use of invalid name(s): {name}")
        for names in (local, self._first):
            if name in names:
                return names[name]
        table: Any = self._symbols
        while isinstance(table, Table):  # xacro's own functions are at the root, where a plain dictionary is
            if dict.__contains__(table, name):
                return table[name]
            table = table.parent
        if name in self._names:
            return self._names[name]
        raise NameError(f"name '{name}' is not defined")

    def _attribute(self, node: ast.Attribute, local: Mapping[str, Any], depth: int) -> Any:
        """Return a name below ``math`` and so on, a property of an included namespace, or a key of YAML data."""
        owner, name = self._value(node.value, local, depth), node.attr
        if isinstance(owner, _Functions):
            if name in owner:
                return owner[name]
            raise NameError(f"name '{name}' is not defined")
        if isinstance(owner, NameSpace) and not name.startswith("__"):
            table: Any = owner
            while isinstance(table, Table):
                if dict.__contains__(table, name):
                    return table[name]
                table = table.parent
            raise NameError(f"name '{name}' is not defined")
        if isinstance(owner, YamlDictWrapper) and name in owner:
            return owner[name]
        raise AttributeError(f"a {type(owner).__name__} has no '{name}'")

    def _subscript(self, node: ast.Subscript, local: Mapping[str, Any], depth: int) -> Any:
        owner = self._value(node.value, local, depth)
        if not isinstance(owner, str | list | tuple | dict) or isinstance(owner, Table):
            raise TypeError(f"a {type(owner).__name__} cannot be indexed")
        return owner[self._value(node.slice, local, depth)]

    def _slice(self, node: ast.Slice, local: Mapping[str, Any], depth: int) -> slice:
        parts = (node.lower, node.upper, node.step)
        return slice(*(None if part is None else self._value(part, local, depth) for part in parts))

    def _items(self, nodes: Iterable[ast.expr], local: Mapping[str, Any], depth: int) -> list[Any]:
        items: list[Any] = []
        size = 0
        for node in nodes:
            if isinstance(node, ast.Starred):
                items += _list(self._value(node.value, local, depth))
            else:
                items.append(self._value(node, local, depth))
                size += measure(items[-1])
            _bounded(size + len(items))
        return items

    def _list(self, node: ast.List, local: Mapping[str, Any], depth: int) -> list[Any]:
        return self._items(node.elts, local, depth)

    def _tuple(self, node: ast.Tuple, local: Mapping[str, Any], depth: int) -> tuple[Any, ...]:
        return tuple(self._items(node.elts, local, depth))

    def _set(self, node: ast.Set, local: Mapping[str, Any], depth: int) -> set[Any]:
        return set(self._items(node.elts, local, depth))

    def _dict(self, node: ast.Dict, local: Mapping[str, Any], depth: int) -> dict[Any, Any]:
        result: dict[Any, Any] = {}
        for key, value in zip(node.keys, node.values, strict=True):
            item = self._value(value, local, depth)
            if key is None:
                result.update(item if isinstance(item, dict) else {})
            else:
                result[self._value(key, local, depth)] = item
        return result

    # --- operations --------------------------------------------------------------------------------------------------

    def _unary(self, node: ast.UnaryOp, local: Mapping[str, Any], depth: int) -> Any:
        return _UNARY[type(node.op)](self._value(node.operand, local, depth))

    def _binary(self, node: ast.BinOp, local: Mapping[str, Any], depth: int) -> Any:
        left, right = self._value(node.left, local, depth), self._value(node.right, local, depth)
        if type(node.op) not in _BINARY:
            raise XacroException("the operator @ is not allowed in an expression")
        return _BINARY[type(node.op)](left, right)

    def _boolean(self, node: ast.BoolOp, local: Mapping[str, Any], depth: int) -> Any:
        value = None
        for operand in node.values:
            value = self._value(operand, local, depth)
            if bool(value) != isinstance(node.op, ast.And):
                break
        return value

    def _compare(self, node: ast.Compare, local: Mapping[str, Any], depth: int) -> Any:
        left: Any = self._value(node.left, local, depth)
        result: Any = True
        for kind, other in zip(node.ops, node.comparators, strict=True):
            right = self._value(other, local, depth)
            result = _COMPARISONS[type(kind)](left, right)
            if not result:
                break
            left = right
        return result

    def _condition(self, node: ast.IfExp, local: Mapping[str, Any], depth: int) -> Any:
        return self._value(node.body if self._value(node.test, local, depth) else node.orelse, local, depth)

    def _joined(self, node: ast.JoinedStr, local: Mapping[str, Any], depth: int) -> str:
        return "".join(map(str, (self._value(part, local, depth) for part in node.values)))

    def _formatted(self, node: ast.FormattedValue, local: Mapping[str, Any], depth: int) -> str:
        value = self._value(node.value, local, depth)
        value = {115: _text, 114: _repr, 97: _repr}.get(node.conversion, lambda one: one)(value)
        return _format_one(value, "" if node.format_spec is None else self._value(node.format_spec, local, depth))

    def _comprehension(self, node: Any, local: Mapping[str, Any], depth: int) -> Any:
        """Return the items of a list, set, dictionary or generator; the last becomes a list."""
        results: list[Any] = []
        size = 0

        def each(number: int, scope: Mapping[str, Any]) -> None:
            nonlocal size
            if number == len(node.generators):
                if isinstance(node, ast.DictComp):
                    results.append((self._value(node.key, scope, depth), self._value(node.value, scope, depth)))
                else:
                    results.append(self._value(node.elt, scope, depth))
                size += measure(results[-1])
                _bounded(size)
                return
            part = node.generators[number]
            for item in _list(self._value(part.iter, scope, depth)):
                inner = {**scope, **_bind(part.target, item)}
                if all(self._value(test, inner, depth) for test in part.ifs):
                    each(number + 1, inner)

        each(0, local)
        return (
            dict(results)
            if isinstance(node, ast.DictComp)
            else set(results)
            if isinstance(node, ast.SetComp)
            else results
        )

    def _call(self, node: ast.Call, local: Mapping[str, Any], depth: int) -> Any:
        """Call a function of xacro, or a method of :data:`METHODS`."""
        function, owner = None, None
        if isinstance(node.func, ast.Attribute):
            owner = self._value(node.func.value, local, depth)
            kinds = [kind for kind in METHODS if isinstance(owner, kind) and not isinstance(owner, Table | _Functions)]
            if kinds and node.func.attr in METHODS[kinds[0]]:
                function = _method(owner, node.func.attr)
        if function is None:
            function = self._value(node.func, local, depth)
            if id(function) not in self._callable:
                raise TypeError(f"a {type(function).__name__} cannot be called")
        positional = self._items(node.args, local, depth)
        if any(word.arg is None for word in node.keywords):
            raise XacroException("** is not allowed in a call")
        return function(*positional, **{str(word.arg): self._value(word.value, local, depth) for word in node.keywords})


# --- bounds -------------------------------------------------------------------------------------------------------


def _checked(value: Any, functions: set[int], *, new: bool = True) -> Any:
    """Return a value after checking its type and size; the size of a collection counts where it is new.

    Raises:
        XacroException: the type is not allowed, or the value is too large.
    """
    if isinstance(value, bool | float) or value is None:
        return value
    if isinstance(value, int):
        if value.bit_length() > BITS:
            raise XacroException(f"an integer of more than {BITS} bits")
        return value
    if isinstance(value, str):
        _bounded(len(value))
        return value
    if isinstance(value, _Functions | NameSpace | slice) or id(value) in functions:
        return value
    if isinstance(value, list | tuple | dict | set | frozenset) and not isinstance(value, Table):
        if new:
            _bounded(measure(value))
        return value
    raise XacroException(f"a value of the type {type(value).__name__} is not allowed in an expression")


def measure(value: Any, *, most: int = LARGEST) -> int:
    """Return the characters and items of a value, with all that is in it; counting stops above `most`."""
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


def _bounded(size: float) -> None:
    if size > LARGEST:
        raise XacroException(f"a value of more than {LARGEST} characters or items")


def _small(*numbers: Any) -> None:
    """Reject large arguments of functions whose cost grows with them."""
    for number in numbers:
        if isinstance(number, int) and abs(number) > _ARGUMENT:
            raise XacroException(f"an argument of {number.bit_length()} bits is larger than {_ARGUMENT}")


def _list(value: Any) -> list[Any]:
    """Return the items of a collection.

    Raises:
        TypeError: it is not one.
    """
    if isinstance(value, str | list | tuple | dict | set | frozenset) and not isinstance(value, Table | _Functions):
        return list(value)
    raise TypeError(f"'{type(value).__name__}' object is not iterable")


def _bind(target: ast.expr, item: Any) -> dict[str, object]:
    if isinstance(target, ast.Name):
        return {target.id: item}
    if isinstance(target, ast.Tuple | ast.List):
        items = _list(item)
        if len(items) != len(target.elts):
            raise ValueError(f"{len(items)} values for {len(target.elts)} names")
        return {
            key: value
            for element, part in zip(target.elts, items, strict=True)
            for key, value in _bind(element, part).items()
        }
    raise XacroException("only names may be assigned in a comprehension")


def _text(value: Any = "") -> str:
    return str(_printable(value))


def _repr(value: Any) -> str:
    return repr(_printable(value))


def _printable(value: Any) -> Any:
    """Return a value whose text does not contain an address in memory."""
    if callable(value) or isinstance(value, _Functions | Table):
        raise XacroException("a function has no text")
    return value


# --- operators ----------------------------------------------------------------------------------------------------


def _add(left: Any, right: Any) -> Any:
    if isinstance(left, str | list | tuple) and isinstance(right, str | list | tuple):
        _bounded(len(left) + len(right))
    return left + right


def _multiply(left: Any, right: Any) -> Any:
    for repeated, times in ((left, right), (right, left)):
        if isinstance(repeated, str | list | tuple) and isinstance(times, int):
            _bounded(measure(repeated) * max(times, 0))
    return left * right


def _power(left: Any, right: Any) -> Any:
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
        for spec in _CONVERSION.findall(left):
            _check_format(spec)
            if "*" in spec:
                raise XacroException("a format with * is not allowed in an expression")
        _printable(right)
        _bounded(len(left) + (left.count("%") + 1) * measure(right))
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
        return _format_one(value, format_spec)

    def convert_field(self, value: Any, conversion: Any) -> Any:
        return super().convert_field(_printable(value), conversion)


def _format_one(value: Any, spec: str) -> str:
    _check_format(spec)
    return format(_printable(value), spec)


def _format(text: str, *values: Any, **named: Any) -> str:
    _bounded(len(text) + text.count("{") * measure([values, named]))
    return _Formatter().vformat(text, values, named)


def _replace(text: str, old: str, new: str, count: int = -1) -> str:
    matches = text.count(old) if count < 0 else min(text.count(old), count)
    _bounded(len(text) + matches * len(new))
    return text.replace(old, new, count)


def _join(text: str, parts: Any) -> str:
    items = _list(parts)
    _bounded(measure(items) + len(text) * len(items))
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


def _method(owner: Any, name: str) -> Callable[..., Any]:
    if isinstance(owner, dict):
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


def _range(*limits: Any) -> list[int]:
    numbers = range(*limits)
    _bounded(len(numbers) if all(abs(limit) < 1 << 62 for limit in limits) else math.inf)
    return list(numbers)


def _sum(values: Any, start: Any = 0) -> Any:
    items = _list(values)
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
    for items in zip(*map(_list, values), strict=False):
        results.append(_checked(function(*items), set()))
        size += measure(results[-1])
        _bounded(10 * size)
    return results


def _filter(function: Callable[..., Any] | None, values: Any) -> list[Any]:
    items = _list(values)
    results = items if function is None else _map(function, items)
    return [item for item, keep in zip(items, results, strict=True) if keep]


def _tokenize(text: str, sep: str = ",; ", skip_empty: bool = True) -> list[str]:
    if not isinstance(sep, str) or len(sep) > 20 or any(letter in sep for letter in "[]\\^-"):
        raise XacroException("tokenize: the separators are single characters other than [ ] \\ ^ -")
    parts: list[str] = tokenize(text, sep, skip_empty)
    return parts


def _extreme(function: Callable[..., Any]) -> Callable[..., Any]:
    def extreme(*values: Any, **named: Any) -> Any:
        if named.get("key") not in {None, abs, len, float, _int, str}:
            raise XacroException("key must be abs, len, float, int or str")
        return function(*values, **named)

    return extreme


def _instance(value: Any, kinds: Any) -> bool:
    if isinstance(kinds, tuple):
        return any(_instance(value, kind) for kind in kinds)
    return isinstance(value, int if kinds is _int else kinds)


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
            result = _checked(function(result, value), set())
        return result

    return fold


def _product(values: Any, *, start: Any = 1) -> Any:
    result = start
    for value in _list(values):
        result = _checked(result * value if isinstance(value, int | float) else math.nan, set())
    return result


_PYTHON: dict[str, object] = {
    "True": True, "False": False, "list": list, "dict": dict, "len": len, "str": str, "float": float, "int": _int,
    "bool": bool, "tuple": tuple, "set": set, "frozenset": frozenset, "abs": abs, "all": all, "any": any,
    "divmod": divmod, "ord": ord, "map": _map, "filter": _filter, "min": _extreme(min), "max": _extreme(max),
    "round": _round, "sorted": _extreme(sorted), "range": _range, "sum": _sum, "repr": _repr, "isinstance": _instance,
    "enumerate": lambda values, start=0: list(enumerate(_list(values), start)),
    "reversed": lambda values: _list(values)[::-1],
    "zip": lambda *values: list(zip(*map(_list, values), strict=False)),
}  # fmt: skip

_MATH: dict[str, object] = {name: value for name, value in vars(math).items() if not name.startswith("_")}
_MATH |= {"factorial": _limited(math.factorial), "comb": _limited(math.comb), "perm": _limited(math.perm)} | {
    "prod": _product
}
_MATH |= {"gcd": _fold(math.gcd, 0), "lcm": _fold(math.lcm, 1)}

_UNARY: dict[type, Callable[[Any], Any]] = {
    ast.UAdd: operator.pos,
    ast.USub: operator.neg,
    ast.Not: operator.not_,
    ast.Invert: operator.inv,
}
_BINARY: dict[type, Callable[[Any, Any], Any]] = {
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
_COMPARISONS: dict[type, Callable[[Any, Any], Any]] = {
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
_NODES: dict[type, Callable[..., Any]] = {
    ast.Constant: Evaluator._constant,
    ast.Name: Evaluator._name,
    ast.Attribute: Evaluator._attribute,
    ast.Subscript: Evaluator._subscript,
    ast.Slice: Evaluator._slice,
    ast.List: Evaluator._list,
    ast.Tuple: Evaluator._tuple,
    ast.Set: Evaluator._set,
    ast.Dict: Evaluator._dict,
    ast.UnaryOp: Evaluator._unary,
    ast.BinOp: Evaluator._binary,
    ast.BoolOp: Evaluator._boolean,
    ast.Compare: Evaluator._compare,
    ast.IfExp: Evaluator._condition,
    ast.JoinedStr: Evaluator._joined,
    ast.FormattedValue: Evaluator._formatted,
    ast.ListComp: Evaluator._comprehension,
    ast.SetComp: Evaluator._comprehension,
    ast.DictComp: Evaluator._comprehension,
    ast.GeneratorExp: Evaluator._comprehension,
    ast.Call: Evaluator._call,
}
_LOOKUPS = {ast.Name, ast.Attribute, ast.Subscript, ast.IfExp, ast.BoolOp}
_WORDS: dict[type, str] = {ast.Lambda: "lambda", ast.NamedExpr: ":=", ast.Await: "await", ast.Starred: "*"}
