"""Parser of requirements; the grammar is in :mod:`mirdrake.requirements`."""

import math
import re
from collections.abc import Callable, Iterator
from typing import NoReturn, TypeVar

from mirdrake.core.errors import ConfigError, did_you_mean, printable
from mirdrake.core.yaml_io import to_si
from mirdrake.requirements.judging import Kind, Requirement
from mirdrake.requirements.observation import EVENTS, SIGNALS
from mirdrake.requirements.surroundings import GAP
from mirdrake.requirements.terms import COUNTS, Atom, Comparison, Expression, Happening, Junction, Negation

_UNITS = ("m", "m/s", "m/s^2", "rad", "rad/s", "s", "N", "N m", "kg", "W", "Hz")
_TOKEN = re.compile(
    r"\s*(?:(?P<number>[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)"
    r"|(?P<sign><=|>=|==|!=|[<>≤≥()=])|(?P<word>[^\s()<>=!≤≥]+))"
)
_NAME = re.compile(r"[A-Za-z_]\w*(?:\.\w+)*", re.ASCII)
_STARTS = ("after", "always", "never", "eventually")
_WORDS = {*_STARTS, "and", "or", "not", "until", "within", "abs", "at", "on", "end"}
_COMPARISONS = {"<", "<=", ">", ">=", "==", "!="}
_DEEPEST = 40
_ALLOWED = (
    "allowed: always E, never E, eventually E within T, E until E, at end E, each with 'after T' in front; E is "
    "'speed < 12 m/s', 'collision', 'stopped', 'on road', 'rollover' or 'at goal', joined by and, or, not"
)
AtomT = TypeVar("AtomT", Comparison, Happening)


def parse_requirement(text: str, *, where: str = "") -> Requirement:
    """Parse a requirement.

    Args:
        text: text of the requirement.
        where: ``file:line: path`` for messages.

    Raises:
        ConfigError: the text is not a requirement; the message states what is allowed.
    """
    return _Parser(text, where).requirement()


class _Parser:
    """Recursive descent parser; any other text raises a ConfigError."""

    def __init__(self, text: str, where: str) -> None:
        self._text, self._where = text, where
        self._atoms: list[Atom] = []
        self._at, self._depth = 0, 0
        self._tokens = list(self._tokenise(text.rstrip()))

    def requirement(self) -> Requirement:
        """Parse the whole text."""
        after, within = 0.0, math.inf
        # Grammar: [after T] temporal operator, expression, [within T], with two tokens for "at end".
        if not self._tokens:
            self._fail("it is empty")
        if self._accept("after"):
            after = self._time()
        kind: Kind
        aim = None
        if self._accept("always"):
            kind, expression = "always", self._either()
        elif self._accept("never"):
            kind, expression = "never", self._either()
        elif self._accept("eventually"):
            kind, expression = "eventually", self._either()
            if self._accept("within"):
                within = self._time()
        # "at end" needs two tokens of lookahead: "at goal" begins with the same word.
        elif self._peek() == "at" and self._peek(1) == "end":
            self._at += 2
            kind, expression = "at end", self._either()
        # "until" is an infix operator, so it is known only after its left side.
        else:
            kind, expression = "until", self._either()
            if not self._accept("until"):
                self._fail(
                    f"'{self._peek()}' is not expected" if self._peek() else "it lacks always, never or the like"
                )
            aim = self._either()
        # A remainder means that the grammar ended before the text.
        if self._peek():
            self._fail(f"'{self._peek()}' is not expected")
        text = " ".join(self._text.split())
        return Requirement(text, kind, expression, aim, after, within, tuple(self._atoms), self._where)

    def _tokenise(self, text: str) -> Iterator[tuple[str, str]]:
        offset = 0
        while offset < len(text):
            match = _TOKEN.match(text, offset)
            if match is None:
                self._fail(f"'{text[offset : offset + 10]}' is not understood")
            kind = str(match.lastgroup)
            yield kind, {"≤": "<=", "≥": ">="}.get(match[kind], match[kind])
            offset = match.end()

    def _either(self) -> Expression:
        return self._join("or", self._both)

    def _both(self) -> Expression:
        return self._join("and", self._one)

    def _join(self, word: str, part: Callable[[], Expression]) -> Expression:
        parts = [part()]
        while self._accept(word):
            parts.append(part())
        return parts[0] if len(parts) == 1 else Junction(tuple(parts), every=word == "and")

    def _one(self) -> Expression:
        # Limit the recursion, so that hostile input gives a parse error and no RecursionError.
        self._depth += 1
        if self._depth > _DEEPEST:
            self._fail("too many brackets")
        if self._accept("not"):
            result: Expression = Negation(self._one())
        elif self._accept("("):
            result = self._either()
            self._expect(")")
        else:
            result = self._atom()
        self._depth -= 1
        return result

    def _atom(self) -> Atom:
        begin = self._at
        absolute = self._accept("abs")
        bracket = absolute and self._accept("(")
        kind, word = self._tokens[self._at] if self._at < len(self._tokens) else ("", "")
        # "at" and "on" are reserved, but also begin events: "at NAME", "on road".
        if kind != "word" or not _NAME.fullmatch(word) or word in _WORDS - {"at", "on"}:
            self._fail(f"a signal or an event is expected, not '{word}'" if word else "something is missing at the end")
        self._at += 1
        # Two-word events; the prefix keeps a goal and a signal of the same name apart.
        if word == "at" and not absolute:
            name = self._peek()
            if not _NAME.fullmatch(name) or name in {"and", "or", "not", "until", "within"}:
                self._fail("the name of a goal is expected after 'at'")
            self._at += 1
            return self._add(Happening(len(self._atoms), f"at {name}", f"at {name}"))
        if word == "on" and not absolute:
            self._expect("road")
            return self._add(Happening(len(self._atoms), "on road", "on road"))
        if word == "gap" and self._peek() == "to":
            self._at += 1
            name = self._peek()
            if not _NAME.fullmatch(name):
                self._fail("the name of a vehicle or actor is expected after 'gap to'")
            self._at += 1
            return self._comparison(begin, f"{GAP}{name}", absolute)
        # Events are tested before signals; abs of an event has no meaning and leads to the error for signals.
        if word in EVENTS and not absolute:
            return self._add(Happening(len(self._atoms), word, word))
        # A name with a dot is a column of some run; whether it exists is known only when the run is judged.
        if "." not in word and word not in SIGNALS:
            known = [*SIGNALS, *EVENTS]
            self._fail(f"unknown signal '{word}'; {did_you_mean(word, known)}, or a column of the run with a dot in it")
        if bracket:
            self._expect(")")
        return self._comparison(begin, word, absolute)

    def _comparison(self, begin: int, signal: str, absolute: bool) -> Comparison:
        sign = self._peek()
        if sign not in _COMPARISONS:
            self._fail(
                f"'{signal}' needs a comparison with a value, one of < <= > >= == !=, for example '{signal} < 1'"
            )
        # Equality of a measured number is never true, so it is allowed for counts only.
        if sign in {"==", "!="} and signal not in COUNTS:
            self._fail(f"'{signal}' is not a count, so {sign} is not allowed; compare it with < or >")
        self._at += 1
        known = SIGNALS[signal][0] if signal in SIGNALS else None
        # A unit is checked now where the signal is known, else when the run is judged.
        value, unit = self._value("m" if signal.startswith(GAP) else known)
        # Text of the atom as in the requirement, with the spaces of brackets removed.
        text = " ".join(text for _, text in self._tokens[begin : self._at]).replace("( ", "(").replace(" )", ")")
        return self._add(Comparison(len(self._atoms), signal, sign, value, unit, absolute, text))

    def _value(self, known: str | None) -> tuple[float, str | None]:
        """Parse a number; return it in SI with the unit in the text. `known` is the unit of the signal, if known."""
        number = self._number()
        # Units may have several words ("N m"); they end at the next keyword.
        words = []
        while self._at < len(self._tokens) and self._tokens[self._at][0] == "word" and self._peek() not in _WORDS:
            words.append(self._peek())
            self._at += 1
        given = " ".join(words)
        if not given:
            return number, None
        # Percent scales a pure number; the conversion of units does not know it.
        if given == "%" and known in {"", None}:
            return number / 100.0, ""
        if known is not None and known not in _UNITS:
            self._fail(f"unit '{given}' does not fit; the signal is {f'in {known}' if known else 'a pure number'}")
        # Without a known signal take the first SI unit that the given unit converts to.
        fault = f"unknown unit '{given}'"
        for unit in _UNITS if known is None else (known,):
            try:
                return number * float(to_si(f"1 {given}", unit)), unit
            except ValueError as error:
                fault = str(error) if known is not None else fault
        return self._fail(fault)

    def _time(self) -> float:
        number, word = self._number(), self._peek()
        try:
            # A time without a unit is in seconds.
            scale = float(to_si(f"1 {word}", "s")) if word and word not in _WORDS else 1.0
            self._at += bool(word) and word not in _WORDS
        except ValueError:
            scale = 1.0  # it may be the signal that comes next
        if number < 0.0:
            self._fail(f"a time of {number:g} s lies before the start")
        return number * scale

    def _number(self) -> float:
        kind, word = self._tokens[self._at] if self._at < len(self._tokens) else ("", "")
        if kind != "number":
            self._fail(f"a number is expected, not '{word}'" if word else "a number is missing at the end")
        self._at += 1
        if not math.isfinite(float(word)):
            self._fail(f"{word} is not finite")
        return float(word)

    def _add(self, atom: AtomT) -> AtomT:
        self._atoms.append(atom)
        return atom

    def _peek(self, ahead: int = 0) -> str:
        offset = self._at + ahead
        return self._tokens[offset][1] if offset < len(self._tokens) else ""

    def _accept(self, word: str) -> bool:
        matches = self._peek() == word
        self._at += matches
        return matches

    def _expect(self, word: str) -> None:
        if not self._accept(word):
            self._fail(f"'{word}' is expected" + (f", not '{self._peek()}'" if self._peek() else " at the end"))

    def _fail(self, what: str) -> NoReturn:
        text = self._text if len(self._text) <= 80 else f"{self._text[:79]}…"
        line = f"'{text}' is not a requirement: {what}; {_ALLOWED}"
        raise ConfigError(printable(line, " "), where=self._where)
