"""Values of a world file when they are needed: parameters filled in, chance drawn from streams of their own."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import Schema, Source, any_to_si, where
from mirdrake.worlds.values import Number, Stream, draw_number, draw_word, is_random, settle

_TEXTS = {"name", "file", "check_length", "mirdrake", "csv", "xodr"}
"""Keys whose texts are left as they are."""


@dataclass(frozen=True)
class Draw:
    """Finds values.

    Every value has a random stream of its own, by its name below `path`.
    """

    seed: int
    path: str
    parameters: Mapping[str, Number | str]
    attempt: int = 0
    """how often it was drawn before"""

    def below(self, name: str) -> "Draw":
        """For a part."""
        return Draw(self.seed, f"{self.path}/{name}", self.parameters, self.attempt)

    def again(self, attempt: int) -> "Draw":
        """For a repeated draw."""
        return Draw(self.seed, self.path, self.parameters, attempt)

    def stream(self, name: str) -> Stream:
        """The random stream of one value."""
        return Stream(self.seed, f"{self.path}/{name}").again(self.attempt)

    def number(self, value: Number | str, unit: str, name: str, spec: Schema | None = None) -> float:
        """A number in an SI unit.

        Args:
            value: of the file.
            unit: SI unit, "" for none.
            name: dotted path of the value below `spec`; also names its stream.
            spec: where it stands, for messages.

        Raises:
            ConfigError: the text is no such value.
        """
        if isinstance(value, int | float):
            return float(value)
        place = where(spec, *name.partition("[")[0].split(".")) if spec is not None else name
        stream = self.stream(name) if is_random(value) else _NO_CHANCE
        return draw_number(value, unit=unit, parameters=self.parameters, stream=stream, where=place)

    def numbers(self, values: Sequence[Number | str], unit: str, name: str, spec: Schema | None = None) -> list[float]:
        """Several numbers; see :meth:`number`."""
        return [self.number(value, unit, f"{name}[{i}]", spec) for i, value in enumerate(values)]

    def count(self, value: Number | str, name: str, spec: Schema, *, largest: int) -> int:
        """A whole number from 0 on; a drawn one is rounded down.

        Raises:
            ConfigError: it is negative, too large, or not whole.
        """
        number = self.number(value, "", name, spec)
        place = where(spec, *name.partition("[")[0].split("."))
        if not is_random(value) and number != int(number):
            raise ConfigError(f"{place}: {number:g} is not a whole number")
        if not 0 <= number <= largest:
            raise ConfigError(f"{place}: {number:g} props; allowed are 0 to {largest}")
        return int(number)

    def parameter(self, value: Number | str, name: str, *, place: str) -> Number | str:
        """A number in SI units, or a word, whatever the text means; `place` is ``file:line: path``.

        Raises:
            ConfigError: the text is no value.
        """
        if not isinstance(value, str):
            return value
        found = settle(value, parameters=self.parameters, stream=self.stream(name), where=place)
        return any_to_si(found) if isinstance(found, str) else found

    def word(self, value: Number | str, name: str, spec: Schema) -> str:
        """A word."""
        stream = self.stream(name) if is_random(value) else _NO_CHANCE
        return draw_word(str(value), parameters=self.parameters, stream=stream, where=where(spec, name))


_NO_CHANCE = Stream(0, "")


def settle_tree(tree: Any, draw: Draw, source: Source, path: tuple[Any, ...] = ()) -> Any:
    """A part of a file with all texts that mean a value replaced by it; units stay.

    Args:
        tree: plain data.
        draw: finds the values; the path of a value names its stream.
        source: of the whole file.
        path: of the part in the file.

    Raises:
        ConfigError: a text is no such value, or a parameter is unknown.
    """
    if isinstance(tree, dict):
        return {
            key: value if key in _TEXTS and isinstance(value, str) else settle_tree(value, draw, source, (*path, key))
            for key, value in tree.items()
        }
    if isinstance(tree, list):
        return [settle_tree(value, draw, source, (*path, index)) for index, value in enumerate(tree)]
    if isinstance(tree, str) and ("$" in tree or is_random(tree)):
        name = ".".join(map(str, path))
        return settle(tree, parameters=draw.parameters, stream=draw.stream(name), where=source.where(*path))
    return tree
