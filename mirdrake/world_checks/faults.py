"""Faults of a world: what a check found, where, and its figures. Their sentences are in sentences.py."""

from dataclasses import dataclass
from typing import Literal

Kind = Literal[
    "file", "unplaced", "rule", "overlap", "unchecked", "gap", "buried", "floating", "start", "goal", "unreachable",
    "actor", "test", "first_steps",
]  # fmt: skip
"""Kinds of faults:

==============  ==============================================================
file            the world, or a vehicle in it, cannot be loaded or laid out
unplaced        a random prop found no free position
rule            a rule is broken
overlap         two props overlap
unchecked       too many pairs of props to examine all of them
gap             two props are closer than the rule min_gap allows
buried          a prop is below the ground
floating        a prop is above the ground without support
start, goal     a start or goal is inside a prop or outside the ground
unreachable     a vehicle has no path to a goal
actor           an actor overlaps another one, or a vehicle at its start, at t = 0
test            a test has a fault
first_steps     the first steps of a simulation fail
==============  ==============================================================
"""

Position = tuple[float, float, float]


@dataclass(frozen=True)
class Fault:
    """One fault of a world.

    Attributes:
        kind: see :data:`Kind`.
        message: the fault and its correction; one line.
        where: ``file:line: path``; "" if the message contains it.
        names: names of the props; two for an overlap.
        depth: length of the shortest translation that separates two props, gap between them, or distance of a prop
            from the ground [m].
        position: x, y, z in W [m].
        polygon: corners (x, y) of the overlapping area, seen from above, in W [m].
    """

    kind: Kind
    message: str
    where: str = ""
    names: tuple[str, ...] = ()
    depth: float | None = None
    position: Position | None = None
    polygon: tuple[tuple[float, float], ...] = ()

    @property
    def text(self) -> str:
        """One line: ``file:line: path: message``."""
        return f"{self.where}: {self.message}" if self.where else self.message

    def __str__(self) -> str:
        return self.text
