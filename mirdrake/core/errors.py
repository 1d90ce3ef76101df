"""Exceptions of mirdrake.

::

    MirdrakeError            base of all, with its place; the command line prints it and exits with code 2
    ├── ConfigError          a file or an override is wrong
    ├── ModelError           a vehicle folder cannot become a plant (xacro, URDF, meshes, inertia)
    ├── WorldError           a world cannot be laid out (unclosed track, start outside the world)
    ├── DiagramError         ports do not fit: unknown name, size, type or unit, open inputs
    ├── RunError             a run cannot start or be written (read-only folder)
    │   └── DivergedError    the state of a run is not finite any more
    └── MissingDependencyError   an optional package or system library is not installed

Every message is one line that states what was given, where, what is allowed, and what to do.
"""

from collections.abc import Collection, Hashable, Iterable, Sequence
from difflib import get_close_matches
from itertools import accumulate
from traceback import extract_tb
from typing import Literal, Self

FaultCode = Literal[
    "",  # not classified
    "no_such_file", "unreadable", "not_yaml", "bad_override",
    "unknown_key", "missing_key", "repeated_key", "unknown_kind", "missing_kind",
    "wrong_type", "not_a_number", "not_finite", "wrong_length", "not_allowed", "bad_value", "too_many",
]  # fmt: skip
"""Code of a fault in an entry of a file, for programs; the message of the error is for people."""


class Place(str):
    """Place of a fault as text, ``file:line: dotted.path``, with its parts apart.

    Args:
        file: the file, or the override in its place; empty if it is not known.
        line: line in the file; None for an override, or if it is unknown.
        path: keys of the entry.

    Attributes:
        file, line, path: as given.
    """

    file: str
    line: int | None
    path: tuple[Hashable, ...]

    def __new__(cls, file: str = "", line: int | None = None, path: Sequence[Hashable] = ()) -> Self:
        """Return the place with its parts."""
        place = super().__new__(
            cls, ": ".join(filter(None, [file if line is None else f"{file}:{line}", dotted(path)]))
        )
        place.file, place.line, place.path = file, line, tuple(path)
        return place


class MirdrakeError(Exception):
    """Base of every error that mirdrake raises on purpose.

    Messages quote files and commands: characters that do not print are escaped, and long lines are cut. Several faults
    of one file are reported together, one per line.

    Args:
        text: the message without its place.
        where: its place, a :class:`Place` or another text; the message begins with it.
        file, line, path: parts of the place, instead of it; see :class:`Place`.
        code: kind of the fault.
        faults: the single errors, instead of all that.

    Attributes:
        text, where, file, line, path, code: as given, so that nobody reads them from the message.
        faults: the single errors; the error itself if there is only one.
    """

    def __init__(
        self,
        text: str = "",
        *,
        where: str = "",
        file: str = "",
        line: int | None = None,
        path: Sequence[Hashable] = (),
        code: FaultCode = "",
        faults: Iterable["MirdrakeError"] = (),
    ) -> None:
        place = where if isinstance(where, Place) else Place(file, line, path)
        self.file, self.line, self.path, self.code = place.file, place.line, place.path, code
        # Equal lines, for example of two branches of a union, are reported once.
        single = {str(part): part for fault in faults for part in fault.faults}
        self.faults: tuple[MirdrakeError, ...] = tuple(single.values()) or (self,)
        self.text, self.where = _lines("\n".join(single) or text), "" if single else where or place
        super().__init__(_lines(f"{self.where}: {self.text}") if self.where else self.text)

    def under(self, where: str) -> "ConfigError":
        """Return the faults as those of the entry that led to them: its place precedes each of them."""
        return ConfigError(faults=[ConfigError(str(fault), where=where, code=fault.code) for fault in self.faults])

    def _render_traceback_(self) -> list[str]:
        """Return the text that Jupyter shows: the line of the cell, and the message, without the frames of mirdrake."""
        calls = [frame for frame in extract_tb(self.__traceback__) if frame.name == "<module>" and frame.line]
        line = [f"line {calls[-1].lineno}: {calls[-1].line}"] if calls else []
        return [*line, f"{type(self).__name__}: {self}"]


class ConfigError(MirdrakeError):
    """A file or an override is wrong."""


class ModelError(MirdrakeError):
    """A vehicle folder cannot become a plant."""


class WorldError(MirdrakeError):
    """A world cannot be laid out."""


class DiagramError(MirdrakeError):
    """Systems cannot be wired as asked."""


class RunError(MirdrakeError):
    """A run cannot start, continue or be written."""


class DivergedError(RunError):
    """The state is not finite: the simulation has diverged."""


class MissingDependencyError(MirdrakeError):
    """An optional package or a system library is missing; the message names what to install."""


_LONGEST_LINE = 1000  # characters


def _lines(message: str) -> str:
    """Return a message in which every line can be printed and is short enough to read."""
    lines = []
    for line in message.split("\n"):
        text = printable(line)
        lines.append(text if len(text) <= _LONGEST_LINE else f"{text[: _LONGEST_LINE - 300]} … {text[-290:]}")
    return "\n".join(lines)


def printable(text: str, instead: str | None = None) -> str:
    """Return a text with another one instead of each character that does not print; its escape without one."""
    return "".join(
        letter if letter.isprintable() else ascii(letter)[1:-1] if instead is None else instead for letter in text
    )


def dotted(path: Iterable[Hashable]) -> str:
    """Return a key path as text; characters that do not print are escaped, so that a message stays one line."""
    return ".".join(text if (text := str(step)).isprintable() else repr(text) for step in path)


def first_line(error: BaseException) -> str:
    """Return the first line of the message of an exception; the name of its type if it has no message."""
    return next(iter(str(error).strip().splitlines()), type(error).__name__)


def one_line(error: BaseException) -> str:
    """Return an exception as one line: the message of an error of mirdrake, type and message of another one."""
    kind, line = type(error).__name__, first_line(error)
    return line if isinstance(error, MirdrakeError) or line == kind else f"{kind}: {line}"


def not_found(kind: str, name: str, known: Iterable[str], *, of: str, where: str = "") -> ConfigError:
    """Return the error for a name that something does not have, such as a start of a world; `where` is its place."""
    return ConfigError(f"{of} has no {kind} '{name}'; {did_you_mean(name, known)}", where=where)


def closest(given: str, names: Collection[str]) -> str | None:
    """Return the name that is most similar to a given one; None if none is similar."""
    return next(iter(get_close_matches(given, names, n=1, cutoff=0.6)), None)


def did_you_mean(given: object, allowed: Iterable[str]) -> str:
    """Return the tail of an error message: the most similar allowed name, and all allowed names.

    Args:
        given: the name that the user wrote.
        allowed: the allowed names.

    Returns:
        for example ``"did you mean 'bolt'? (allowed: bolt, unior)"``, or ``"allowed: bolt, unior"`` if none is
        similar; the list is cut after 12 names, or 180 characters.
    """
    names = sorted({str(name).replace("\n", "\\n") for name in allowed})
    if not names:
        return "nothing is available here"
    near = closest(str(given), names)
    few = min(12, max(1, sum(length <= 180 for length in accumulate(len(name) + 2 for name in names))))
    shown = ", ".join(names[:few]) + (", …" if len(names) > few else "")
    return f"did you mean '{near}'? (allowed: {shown})" if near else f"allowed: {shown}"
