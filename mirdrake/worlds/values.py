"""Expressions in world files: units, parameters, random values.

Wherever the world language expects a number or a word, an expression may be given::

    12.5   90 deg   8 m/s          a number, with a unit if it has one
    0.15 .. 0.3                    uniform between two numbers
    0 +- 3 deg                     normal: mean and standard deviation; a unit at the end counts for both
    9 | 12 | 18    sedan | van     one of these, equally likely
    $pitch - 2*$street             arithmetic (+ - * / and brackets) on parameters of the world or group

They can be combined: ``0 .. $side | 5`` is a choice between a range and a number. Expressions contain no commas and
need no quotes in YAML's flow style. They are parsed here and never evaluated as Python.

Every random value has its own random stream, which depends on the seed of the world and the path of the value, so that
a new prop does not change the other ones.
"""

import hashlib
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.yaml_io import to_si

Number = float | int
Parameters = Mapping[str, Number | str]

_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.\d+|\.\d+|\d+(?:\.(?!\.))?)(?:[eE][-+]?\d+)?)"
    r"|(?P<name>\$[A-Za-z_]\w*)|(?P<operator>\.\.|\+-|[-+*/()|])|(?P<word>[^\s\d$+*/()|.-][^\s$+*()|]*))"
)
_DEEPEST = 50


@dataclass(frozen=True)
class _Token:
    kind: str
    text: str


class Stream:
    """A random stream that depends only on the seed and a path.

    Args:
        seed: seed of the world.
        path: path of the value, for example ``props.car[3].yaw``.
    """

    def __init__(self, seed: int, path: str) -> None:
        self.seed, self.path = seed, path
        # A hash of seed and path: each value has its own stream, which no other value can shift.
        digest = hashlib.sha256(f"{seed}/{path}".encode()).digest()
        self.generator = np.random.Generator(np.random.PCG64(int.from_bytes(digest[:16], "little")))

    def below(self, name: str) -> "Stream":
        """Return the stream of a part."""
        return Stream(self.seed, f"{self.path}.{name}")

    def again(self, attempt: int) -> "Stream":
        """Return the stream of a repeated draw; attempt 0 is the stream itself."""
        return Stream(self.seed, f"{self.path}#{attempt}") if attempt else self


def draw_number(value: Number | str, *, unit: str, parameters: Parameters, stream: Stream, where: str = "") -> float:
    """Return a number in an SI unit.

    Args:
        value: a number or an expression.
        unit: SI unit of :func:`mirdrake.core.yaml_io.to_si`, "" for none.
        parameters: values of ``$name``.
        stream: random stream; it continues with every draw.
        where: ``file:line: path`` for messages.

    Raises:
        ConfigError: the expression is invalid, a parameter is unknown, or the result is not finite.
    """
    result = value if isinstance(value, int | float) else _Parser(value, unit, parameters, stream, where).value()
    if isinstance(result, str):
        raise ConfigError(f"'{result}' is not a number{f' in {unit}' if unit else ''}", where=where)
    if not math.isfinite(result):
        raise ConfigError(f"'{value}' is not finite", where=where)
    return float(result)


def evaluate(value: str, *, parameters: Parameters, stream: Stream, where: str = "") -> Number | str:
    """Return the value of an expression as YAML would contain it: a number, a word, or ``number unit``.

    Raises:
        ConfigError: the expression is invalid, or a parameter is unknown.
    """
    parser = _Parser(value, None, parameters, stream, where)
    result = parser.value()
    if isinstance(result, str) or not parser.unit:
        return result
    return f"{result!r} {parser.unit}"


def draw_word(value: str, *, parameters: Parameters, stream: Stream, where: str = "") -> str:
    """Evaluate an expression with ``a | b`` and ``$name`` to a word, such as the name of a prop.

    Raises:
        ConfigError: a parameter is unknown, or a choice is empty.
    """
    words = [word.strip() for word in str(value).split("|")]
    # Nothing is drawn without a choice, so that streams stay where they are.
    word = words[int(stream.generator.integers(len(words)))] if len(words) > 1 else words[0]
    if word.startswith("$"):
        parameter = _parameter(word[1:], parameters, where)
        word = parameter if isinstance(parameter, str) else f"{parameter:g}"
    if not word:
        raise ConfigError(f"'{value}' has an empty choice", where=where)
    return word


def is_random(value: object) -> bool:
    """Return whether an expression draws a random value itself; its parameters may be random all the same."""
    return isinstance(value, str) and ("|" in value or ".." in value or "+-" in value)


class _Parser:
    """Recursive descent parser that evaluates an expression while it parses.

    ::

        value    choice  = spread ("|" spread)*
                 spread  = sum | sum ".." sum | sum "+-" sum
                 sum     = product (("+"|"-") product)*
                 product = factor (("*"|"/") factor)*
                 factor  = "-" factor | number [unit] | $name | "(" sum ")"
    """

    def __init__(self, text: str, unit: str | None, parameters: Parameters, stream: Stream, where: str) -> None:
        self._text, self._unit, self._parameters = text, unit, parameters
        self._stream, self._where = stream, where
        self._tokens, self._position, self._depth = self._tokenise(), 0, 0
        self.unit = ""  # of the result, if any unit is allowed

    def value(self) -> Number | str:
        """Return the value of the whole expression."""
        alternatives = self._split_choice()
        if len(alternatives) > 1:
            chosen = int(self._stream.generator.integers(len(alternatives)))
            for index, tokens in enumerate(alternatives):  # parse all, so that faults do not depend on the draw
                if index != chosen:
                    self._spread(tokens, draw=False)
            return self._spread(alternatives[chosen])
        return self._spread(alternatives[0])

    def _tokenise(self) -> list[_Token]:
        tokens, position = [], 0
        text = self._text.rstrip()
        while position < len(text):
            match = _TOKEN.match(text, position)
            if match is None or match.end() == position:
                self._fail(f"'{text[position:].strip()[:20]}' is not valid")
            tokens.append(_Token(str(match.lastgroup), match.group(str(match.lastgroup))))
            position = match.end()
        return tokens

    def _split_choice(self) -> list[list[_Token]]:
        parts: list[list[_Token]] = [[]]
        for token in self._tokens:
            if token.text == "|":
                parts.append([])
            else:
                parts[-1].append(token)
        if any(not part for part in parts):
            self._fail("something is missing" if len(parts) == 1 else "a choice is empty")
        return parts

    def _spread(self, tokens: list[_Token], *, draw: bool = True) -> Number | str:
        self._tokens, self._position = tokens, 0
        if len(tokens) == 1 and tokens[0].kind in {"word", "name"}:
            return tokens[0].text if tokens[0].kind == "word" else self._lookup(tokens[0].text)
        first_unit, first = self._with_unit(self._sum)
        operator = self._peek()
        if operator not in {"..", "+-"}:
            self._expect_end()
            return self._scaled(first, first_unit)
        self._position += 1
        second_unit, second = self._with_unit(self._sum)
        self._expect_end()
        # In 2 .. 3 m the unit of the second number holds for both.
        low, high = self._scaled(first, first_unit or second_unit), self._scaled(second, second_unit)
        if operator == ".." and high < low:
            self._fail(f"the range from {low:g} to {high:g} is reversed; swap its limits")
        if operator == "+-" and high < 0.0:
            self._fail(f"the standard deviation {high:g} is negative; give 0 or more")
        # The difference may overflow although both limits are finite.
        if not (math.isfinite(low) and math.isfinite(high) and math.isfinite(high - low)):
            self._fail("not finite")
        if not draw:
            return low
        generator = self._stream.generator
        return float(generator.uniform(low, high) if operator == ".." else generator.normal(low, high))

    def _with_unit(self, parse: Callable[[], float]) -> tuple[str, float]:
        """Return the optional trailing unit of an arithmetic expression, and its value."""
        number = parse()
        words: list[str] = []
        while self._position < len(self._tokens) and self._tokens[self._position].kind == "word":
            words.append(self._take())
        return " ".join(words), number

    def _scaled(self, number: float, unit: str) -> float:
        if not unit:
            return number
        if self._unit is None:
            # Any unit is allowed where the type is not known yet, but only one in a value.
            if self.unit not in {"", unit}:
                self._fail(f"two units, {self.unit} and {unit}; use the same one")
            self.unit = unit
            return number
        if not self._unit:
            self._fail(f"the unit '{unit}' is not allowed here; give a number without unit")
        try:
            scale = to_si(f"1 {unit}", self._unit)
        except ValueError as error:
            self._fail(str(error))
        return number * float(scale)

    def _sum(self) -> float:
        value = self._product()
        while self._peek() in {"+", "-"}:
            sign = 1.0 if self._take() == "+" else -1.0
            value += sign * self._product()
        return value

    def _product(self) -> float:
        value = self._factor()
        while self._peek() in {"*", "/"}:
            if self._take() == "*":
                value *= self._factor()
                continue
            divisor = self._factor()
            if divisor == 0.0:
                self._fail("division by zero")
            value /= divisor
        return value

    def _factor(self) -> float:
        self._depth += 1
        # Python's own limit of recursion would end the program with a traceback.
        if self._depth > _DEEPEST:
            self._fail(f"more than {_DEEPEST} nested brackets or signs")
        try:
            if self._position >= len(self._tokens):
                self._fail("a number is missing at the end")
            token = self._tokens[self._position]
            self._position += 1
            # A sign binds to the factor behind it, as in -2 * 3.
            if token.text in {"-", "+"}:
                return self._factor() * (-1.0 if token.text == "-" else 1.0)
            if token.text == "(":
                value = self._sum()
                if self._peek() != ")":
                    self._fail("a bracket is not closed")
                self._position += 1
                return value
            if token.kind == "number":
                return float(token.text)
            if token.kind == "name":
                parameter = self._lookup(token.text)
                if isinstance(parameter, str):
                    self._fail(f"{token.text} is '{parameter}', not a number")
                return float(parameter)
            self._fail(f"'{token.text}' is not a number")
        finally:
            self._depth -= 1

    def _lookup(self, name: str) -> Number | str:
        return _parameter(name[1:], self._parameters, self._where)

    def _peek(self) -> str:
        return self._tokens[self._position].text if self._position < len(self._tokens) else ""

    def _take(self) -> str:
        self._position += 1
        return self._tokens[self._position - 1].text

    def _expect_end(self) -> None:
        if self._position < len(self._tokens):
            self._fail(f"'{self._peek()}' is not expected here")

    def _fail(self, what: str) -> NoReturn:
        raise ConfigError(
            f"'{self._text[:60]}': {what}; a value is a number with unit, a .. b, "
            "mean +- deviation, a | b, or arithmetic on $parameters",
            where=self._where,
        )


def _parameter(name: str, parameters: Parameters, where: str) -> Number | str:
    if name not in parameters:
        known = did_you_mean(name, parameters) if parameters else "the world has no parameters; add them under params"
        raise ConfigError(f"unknown parameter ${name}; {known}", where=where)
    return parameters[name]
