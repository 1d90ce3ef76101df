"""Records of what an import changed, and the only place where they become text."""

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import groupby

from mirdrake.core.errors import ModelError

LEFT_OUT = "left out"
KEPT = "kept: please check"
_PLACE = re.compile(r"(.*?):(\d+(?:-\d+)?)$")


class Code(StrEnum):
    """Subject of a change."""

    ELEMENT = "element"
    """An element, attribute or file of the source without counterpart, or read in another way."""
    MESH = "mesh"
    SUBMESH = "submesh"
    """A submesh that does not exist; the whole mesh is used."""
    MATERIAL = "material"
    SHAPE = "shape"
    """A visual or collision shape."""
    FRAME = "frame"
    """Base frame and names of frames."""
    DIRECTION = "direction"
    """Front end of the vehicle."""
    GEOMETRY = "geometry"
    """Wheels and steering axes that were aligned."""
    JOINT = "joint"
    JOINT_FIXED = "joint_fixed"
    """A joint that is fixed at zero."""
    SUSPENSION_FIXED = "suspension_fixed"
    """A joint of the suspension that is fixed at zero."""
    ACTUATOR = "actuator"
    DRIVE = "drive"
    LIMIT = "limit"
    """Limits, torques and speeds."""
    CONTACT = "contact"
    """Friction and stiffness of tyres and surfaces."""
    MASS = "mass"
    """Masses and centres of mass."""
    INERTIA = "inertia"
    SUSPENSION = "suspension"
    SENSOR = "sensor"
    PLUGIN = "plugin"
    GAINS = "gains"
    UNUSUAL = "unusual"
    """A value that is unusual but possible, and kept."""
    GROUND = "ground"
    ROAD = "road"
    MODEL = "model"
    """A model of a world."""
    STAND_IN = "stand_in"
    """A model without its files, replaced by a prop of known size."""
    STAND_IN_UNSURE = "stand_in_unsure"
    """The same, with size and heading that were not measured."""
    POPULATION = "population"
    LIGHT = "light"
    START = "start"
    RULE = "rule"
    """Overlaps and heights of the source that rules of the new world allow."""


@dataclass(frozen=True)
class Change:
    """One difference between the source and what the import wrote.

    Attributes:
        code: what it is about.
        place: ``file:line`` in the source.
        part: part that is changed, for example ``link 'chassis': inertia``.
        old: value in the source, with unit.
        new: value that was written instead; None if the part was left out.
        reason: why.
    """

    code: Code
    place: str
    part: str
    old: str
    new: str | None
    reason: str

    @property
    def left_out(self) -> bool:
        """Whether the part has no counterpart in the result."""
        return self.new is None

    @property
    def new_text(self) -> str:
        """The new value as text."""
        return LEFT_OUT if self.new is None else self.new

    @property
    def sentence(self) -> str:
        """The change in one line, without file and line number."""
        return " ".join(f"{self.part}: {self.old} -> {self.new_text} ({self.reason})".split())


class Changes(list[Change]):
    """Changes in the order in which they were made."""

    def add(self, code: Code, place: str, part: str, old: str, new: str | None, reason: str) -> None:
        """Append a change; see :class:`Change`."""
        self.append(Change(code, place, part, old, new, reason))

    def add_fault(self, code: Code, error: ModelError, part: str, old: str, new: str | None = None) -> None:
        """Append a change whose place and reason are those of an error."""
        self.add(code, error.where, part, old, new, error.text)


def unusual(place: str, part: str, old: str, reason: str) -> Change:
    """Return the change of a value that is kept although it is unusual."""
    return Change(Code.UNUSUAL, place, part, old, KEPT, reason)


def count_changes(changes: Iterable[Change]) -> str:
    """Return how many parts were changed and left out, for the terminal."""
    kinds = Counter(LEFT_OUT if change.left_out else "changed" for change in changes)
    return ", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items())) or "nothing changed"


TABLE_HEAD = ("| line | part | in the source | now | reason |", "| --- | --- | --- | --- | --- |")
"""First lines of a table of changes."""


@dataclass(frozen=True)
class Row:
    """A line of a table of changes: equal changes of several lines of a file together."""

    file: str
    line: int
    change: Change
    count: int

    @property
    def text(self) -> str:
        """The line in Markdown."""
        change, times = self.change, f" ({self.count} times)" if self.count > 1 else ""
        cells = (str(self.line or ""), change.part + times, change.old, change.new_text, change.reason)
        return f"| {' | '.join(map(table_cell, cells))} |"


def rows_by_file(changes: Sequence[Change], *, merge: bool = False) -> list[tuple[str, list[Row]]]:
    """Return the changes as rows by file, in the order of lines.

    Args:
        changes: equal ones are reported once.
        merge: also report changes once that differ in line and old value only.
    """
    rows: dict[object, Row] = {}
    for change in dict.fromkeys(changes):
        match = _PLACE.match(change.place)
        file, line = (match.group(1), int(match.group(2).split("-")[0])) if match else (change.place, 0)
        key = (file, change.part, change.new, change.reason) if merge else (len(rows),)
        known = rows.get(key)
        rows[key] = (
            Row(file, line, change, 1) if known is None else Row(file, known.line, known.change, known.count + 1)
        )
    ordered = sorted(rows.values(), key=lambda row: (row.file, row.line))
    return [(file, list(group)) for file, group in groupby(ordered, key=lambda row: row.file)]


def table_cell(text: str) -> str:
    """Return a text that stays within its cell of a Markdown table."""
    return " ".join(str(text).split()).replace("|", "\\|").replace("<", "&lt;")
