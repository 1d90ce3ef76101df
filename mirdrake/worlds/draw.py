"""Evaluation of the values of a world file: parameters are inserted, random values drawn from their own streams."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import Schema, Source, any_to_si, where
from mirdrake.worlds.values import Number, Stream, draw_number, draw_word, evaluate, is_random

_TEXTS = {"name", "file", "expected_length", "mirdrake", "csv", "xodr"}
"""Keys whose texts are not expressions."""


@dataclass(frozen=True)
class Draw:
    """Evaluates values; each has its own random stream, by its name below `path`."""

    seed: int
    path: str
    parameters: Mapping[str, Number | str]
    attempt: int = 0
    """number of earlier draws of the same thing"""

    def below(self, name: str) -> "Draw":
        """Return the evaluation of a part."""
        return Draw(self.seed, f"{self.path}/{name}", self.parameters, self.attempt)

    def again(self, attempt: int) -> "Draw":
        """Return the evaluation of a repeated draw."""
        return Draw(self.seed, self.path, self.parameters, attempt)

    def stream(self, name: str) -> Stream:
        """Return the random stream of one value."""
        return Stream(self.seed, f"{self.path}/{name}").again(self.attempt)

    def number(self, value: Number | str, unit: str, name: str, spec: Schema | None = None) -> float:
        """Return a number in an SI unit.

        Args:
            value: value of the file.
            unit: SI unit, "" for none.
            name: dotted path of the value below `spec`; it also names the stream.
            spec: the schema that holds it, for messages.

        Raises:
            ConfigError: the text is not a valid expression.
        """
        if isinstance(value, int | float):
            return float(value)
        location = where(spec, *name.partition("[")[0].split(".")) if spec is not None else name
        stream = self.stream(name) if is_random(value) else _NO_STREAM
        return draw_number(value, unit=unit, parameters=self.parameters, stream=stream, where=location)

    def numbers(self, values: Sequence[Number | str], unit: str, name: str, spec: Schema | None = None) -> list[float]:
        """Return several numbers; see :meth:`number`."""
        return [self.number(value, unit, f"{name}[{i}]", spec) for i, value in enumerate(values)]

    def count(self, value: Number | str, name: str, spec: Schema, *, largest: int) -> int:
        """Return a whole number, 0 or more; a random one is rounded down.

        Raises:
            ConfigError: the value is negative, too large, or not a whole number.
        """
        number = self.number(value, "", name, spec)
        location = where(spec, *name.partition("[")[0].split("."))
        if not is_random(value) and number != int(number):
            raise ConfigError(f"{number:g} is not a whole number", where=location)
        if not 0 <= number <= largest:
            raise ConfigError(f"{number:g} props; allowed are 0 to {largest}", where=location)
        return int(number)

    def parameter(self, value: Number | str, name: str, *, location: str) -> Number | str:
        """Return a number in SI units, or a word; `place` is ``file:line: path``.

        Raises:
            ConfigError: the text is not a valid expression.
        """
        if not isinstance(value, str):
            return value
        result = evaluate(value, parameters=self.parameters, stream=self.stream(name), where=location)
        return any_to_si(result) if isinstance(result, str) else result

    def word(self, value: Number | str, name: str, spec: Schema) -> str:
        """Return a word."""
        stream = self.stream(name) if is_random(value) else _NO_STREAM
        return draw_word(str(value), parameters=self.parameters, stream=stream, where=where(spec, name))


_NO_STREAM = Stream(0, "")


def evaluate_tree(tree: Any, draw: Draw, source: Source, path: tuple[Any, ...] = ()) -> Any:
    """Return a part of a file with all expressions evaluated; units stay.

    Args:
        tree: plain data.
        draw: evaluates values; the path of a value names its stream.
        source: source of the whole file.
        path: path of the part in the file.

    Raises:
        ConfigError: a text is not a valid expression, or a parameter is unknown.
    """
    if isinstance(tree, dict):
        return {
            key: value if key in _TEXTS and isinstance(value, str) else evaluate_tree(value, draw, source, (*path, key))
            for key, value in tree.items()
        }
    if isinstance(tree, list):
        return [evaluate_tree(value, draw, source, (*path, index)) for index, value in enumerate(tree)]
    if isinstance(tree, str) and ("$" in tree or is_random(tree)):
        name = ".".join(map(str, path))
        return evaluate(tree, parameters=draw.parameters, stream=draw.stream(name), where=source.where(*path))
    return tree
