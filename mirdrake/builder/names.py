"""Names of vehicles, systems and ports of a diagram, as attributes."""

from collections.abc import Callable, Iterable


class Name:
    """Name of a vehicle, system, port or element; attributes are the names below it.

    ``ego.control.speed_pid.error`` is the name "ego.control.speed_pid.error". A name is checked when it is used: in a
    connection, when the diagram is built.

    Args:
        text: the name.
        known: returns all names of the diagram, for completion.
    """

    def __init__(self, text: str, known: Callable[[], Iterable[str]]) -> None:
        self._text, self._known = text, known

    def __getattr__(self, part: str) -> "Name":
        """Return the name of a part."""
        if part.startswith("_"):
            raise AttributeError(part)
        return Name(f"{self._text}.{part}", self._known)

    def __getitem__(self, part: str) -> "Name":
        """Return the name of a part, as an attribute does."""
        return Name(f"{self._text}.{part}", self._known)

    def __dir__(self) -> list[str]:
        """Return the parts of this name, for completion."""
        start = f"{self._text}."
        return sorted({name.removeprefix(start).split(".")[0] for name in self._known() if name.startswith(start)})

    def __str__(self) -> str:
        """Return the name."""
        return self._text

    def __repr__(self) -> str:
        """Return the name and what is below it."""
        parts = dir(self)
        return f"{self._text}: {', '.join(parts)}" if parts else self._text

    def __eq__(self, other: object) -> bool:
        """Return whether another name, or a text, is the same."""
        return str(self) == str(other) if isinstance(other, Name | str) else NotImplemented

    def __hash__(self) -> int:
        """Return the hash of the text."""
        return hash(self._text)
