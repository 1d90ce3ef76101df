"""Evaluates the expressions of xacro files without executing Python.

The syntax tree of an expression is walked and computed here, so that a file can do what is listed below and nothing
else: numbers, text, lists, dictionaries, arithmetic, comparisons, conditions, comprehensions, formatted text, indexing,
and calls of the functions that xacro documents (``math.*``, ``python.*``, ``xacro.*``). ``lambda``,
attributes of Python objects, and methods other than those in :data:`METHODS` are rejected. Every value has a bounded
size, and every expression a bounded number of steps. Libraries for expressions, such as asteval, bound neither time nor
the size of all values.
"""

import ast
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from xacro import NameSpace, Table, XacroException, YamlDictWrapper

from mirdrake.vehicles.xacro_functions import (
    BINARY,
    COMPARISONS,
    MATH,
    METHODS,
    PYTHON,
    UNARY,
    Functions,
    check_size,
    checked,
    extreme_of,
    format_value,
    items_of,
    measure,
    method_of,
    printable,
    range_of,
    repr_of,
    text_of,
    tokenize_text,
)  # fmt: skip

LONGEST = 5_000
"""Characters of an expression."""

STEPS = 50_000
"""Nodes of the syntax tree that an expression evaluates, with repetitions in comprehensions."""

SECONDS = 0.5
"""Processor time of an expression [s], with the properties that it uses."""

PROPERTIES = 200
"""Properties that are evaluated within one another, each for the expression of the one before."""

_DEPTH = 60  # of nested operations


class Evaluator:
    """Evaluates expressions.

    Args:
        load_yaml: reads a YAML file for ``xacro.load_yaml``.
        abs_filename: implementation of ``xacro.abs_filename``.
        argument: value of an argument, for ``xacro.arg``.
        warn: gets the texts of ``xacro.message``, ``xacro.warning`` and ``xacro.error``.
        tick: called all along an evaluation; raises an error when no time is left.
        origin: returns the place of a text of a YAML file, for messages; "" if it is not known.
    """

    def __init__(
        self,
        *,
        load_yaml: Callable[[str], Any],
        abs_filename: Callable[[str], str],
        argument: Callable[[str], Any],
        warn: Callable[[str], None],
        tick: Callable[[], None] = lambda: None,
        origin: Callable[[str], str] = lambda _: "",
    ) -> None:
        def forward(*texts: Any) -> str:
            warn(" ".join(map(text_of, texts)))
            return ""

        def deprecated(space: str, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
            # The same functions are allowed directly, with the warning that xacro gives.
            def call(*values: Any, **named: Any) -> Any:
                warn(f"Using {name}() directly is deprecated. Use {space}.{name}() instead.")
                return function(*values, **named)

            return call

        def fatal(*texts: Any) -> None:
            raise XacroException(" ".join(map(text_of, texts)))

        # Names and behaviour are those of xacro's own evaluator.
        xacro_functions = {
            "load_yaml": load_yaml,
            "abs_filename": abs_filename,
            "arg": argument,
            "dotify": lambda value: YamlDictWrapper(dict(value)),
            "tokenize": tokenize_text,
            "fatal": fatal,
        } | dict.fromkeys(("message", "warning", "error", "print_location"), forward)
        # Functions of xacro are called as members of a namespace; a direct call is deprecated and gives a warning.
        spaces = {"math": Functions(MATH), "python": Functions(PYTHON), "xacro": Functions(xacro_functions)}
        direct = {
            name: deprecated("xacro", name, xacro_functions[name]) for name in ("load_yaml", "abs_filename", "dotify")
        }
        direct |= {
            name: deprecated("python", name, function)
            for name, function in (("sorted", extreme_of(sorted)), ("range", range_of))
        }
        # Only these objects may be called; they are compared by identity, so that no value can imitate one.
        self._names: dict[str, object] = {**MATH, **PYTHON, **direct, **spaces}
        self._functions = [*self._names.values(), *(value for space in spaces.values() for value in space.values())]
        self._callable = {id(entry) for entry in self._functions if callable(entry)}
        self._tick, self._origin = tick, origin
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
            XacroException: the expression uses what is not allowed, or its value is too large or a function.
            NameError, TypeError, ValueError and so on: as Python raises them.
        """
        if len(text) > LONGEST:
            raise XacroException(f"an expression of {len(text)} characters; {LONGEST} are allowed")
        try:
            # Python only parses the text; nothing is compiled or executed.
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
            return printable(self._value(tree.body, {}, 0))
        finally:
            self._steps, self._symbols, self._first, self._callable, self._until = outer
            self._nested -= 1

    def _value(self, node: ast.AST, local: Mapping[str, Any], depth: int) -> Any:
        """Return the checked value of a node."""
        self._steps += 1
        if self._steps > STEPS:
            raise XacroException(f"the expression takes more than {STEPS} steps")
        # Reading the processor time is a system call, so it is not done for each node.
        if self._steps % 16 == 0:
            self._tick()
            if time.thread_time() > self._until:
                raise XacroException(f"the expression takes more than {SECONDS:g} s")
        if depth > _DEPTH:
            raise XacroException("the expression is nested too deeply")
        method = _NODES.get(type(node))
        if method is None:
            raise XacroException(f"{_WORDS.get(type(node), type(node).__name__)} is not allowed in an expression")
        # Values from a look-up were checked when they were made.
        value = method(self, node, local, depth + 1)
        return checked(value, self._callable, new=type(node) not in _LOOKUPS)

    # --- values ------------------------------------------------------------------------------------------------------

    def _constant(self, node: ast.Constant, _local: Mapping[str, Any], _depth: int) -> Any:
        return node.value

    def _name(self, node: ast.Name, local: Mapping[str, Any], _depth: int) -> Any:
        name = node.id
        if name.startswith("__"):
            raise XacroException(f"Use of invalid name(s): {name}")
        # Variables of a comprehension hide arguments, and these hide properties.
        for names in (local, self._first):
            if name in names:
                return names[name]
        return _look_up(name, self._symbols, self._names)

    def _attribute(self, node: ast.Attribute, local: Mapping[str, Any], depth: int) -> Any:
        """Return a name below ``math`` and so on, a property of an included namespace, or a key of YAML data."""
        owner, name = self._value(node.value, local, depth), node.attr
        # Attributes of arbitrary objects would reach Python's internals: only these owners have any.
        if isinstance(owner, Functions):
            return _look_up(name, None, owner)
        if isinstance(owner, NameSpace) and not name.startswith("__"):
            return _look_up(name, owner, {})
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
                items += items_of(self._value(node.value, local, depth))
            else:
                items.append(self._value(node, local, depth))
                size += measure(items[-1])
            # Checked after every item: a list may be too large before it is complete.
            check_size(size + len(items))
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
        return UNARY[type(node.op)](self._value(node.operand, local, depth))

    def _binary(self, node: ast.BinOp, local: Mapping[str, Any], depth: int) -> Any:
        left, right = self._value(node.left, local, depth), self._value(node.right, local, depth)
        if type(node.op) not in BINARY:
            raise XacroException("the operator @ is not allowed in an expression")
        try:
            return BINARY[type(node.op)](left, right)
        except TypeError:
            # Python's message would name neither the text nor its place; the text of a YAML file may have a unit.
            for part, value in ((node.left, left), (node.right, right)):
                if isinstance(value, str):
                    name = f"{ast.unparse(part)} is " if isinstance(part, ast.Name | ast.Attribute) else ""
                    raise TypeError(f"{name}text {value!r}{self._origin(value)}, not a number") from None
            raise

    def _boolean(self, node: ast.BoolOp, local: Mapping[str, Any], depth: int) -> Any:
        value = None
        for operand in node.values:
            value = self._value(operand, local, depth)
            # The value of the last operand that was evaluated, as in Python.
            if bool(value) != isinstance(node.op, ast.And):
                break
        return value

    def _compare(self, node: ast.Compare, local: Mapping[str, Any], depth: int) -> Any:
        left: Any = self._value(node.left, local, depth)
        result: Any = True
        for kind, other in zip(node.ops, node.comparators, strict=True):
            right = self._value(other, local, depth)
            result = COMPARISONS[type(kind)](left, right)
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
        value = {115: text_of, 114: repr_of, 97: repr_of}.get(node.conversion, lambda one: one)(value)
        return format_value(value, "" if node.format_spec is None else self._value(node.format_spec, local, depth))

    def _comprehension(self, node: Any, local: Mapping[str, Any], depth: int) -> Any:
        """Return the items of a list, set, dictionary or generator; the last becomes a list."""
        results: list[Any] = []
        size = 0

        def each(number: int, scope: Mapping[str, Any]) -> None:
            nonlocal size
            # All loops have a value: one item of the result.
            if number == len(node.generators):
                if isinstance(node, ast.DictComp):
                    results.append((self._value(node.key, scope, depth), self._value(node.value, scope, depth)))
                else:
                    results.append(self._value(node.elt, scope, depth))
                size += measure(results[-1])
                check_size(size)
                return
            part = node.generators[number]
            # As in Python: loops nest from left to right, and a condition sees the names of all loops before it.
            for item in items_of(self._value(part.iter, scope, depth)):
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
        # Methods are allowed by type and name; any other function must be one of the known objects.
        if isinstance(node.func, ast.Attribute):
            owner = self._value(node.func.value, local, depth)
            kinds = [kind for kind in METHODS if isinstance(owner, kind) and not isinstance(owner, Table | Functions)]
            if kinds and node.func.attr in METHODS[kinds[0]]:
                function = method_of(owner, node.func.attr)
        if function is None:
            function = self._value(node.func, local, depth)
            if id(function) not in self._callable:
                raise TypeError(f"a {type(function).__name__} cannot be called")
        positional = self._items(node.args, local, depth)
        if any(word.arg is None for word in node.keywords):
            raise XacroException("** is not allowed in a call")
        return function(*positional, **{str(word.arg): self._value(word.value, local, depth) for word in node.keywords})


def _look_up(name: str, table: Any, names: Mapping[str, Any]) -> Any:
    """Return the value of a name in one of xacro's nested tables, or in plain names."""
    while isinstance(table, Table):  # xacro's own functions are at the root, where a plain dictionary is
        if dict.__contains__(table, name):
            return table[name]
        table = table.parent
    if name in names:
        return names[name]
    raise NameError(f"name '{name}' is not defined")


def _bind(target: ast.expr, item: Any) -> dict[str, object]:
    if isinstance(target, ast.Name):
        return {target.id: item}
    if isinstance(target, ast.Tuple | ast.List):
        items = items_of(item)
        if len(items) != len(target.elts):
            raise ValueError(f"{len(items)} values for {len(target.elts)} names")
        return {
            key: value
            for element, part in zip(target.elts, items, strict=True)
            for key, value in _bind(element, part).items()
        }
    raise XacroException("only names may be assigned in a comprehension")


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
