"""What a check of a world finds."""

from dataclasses import dataclass
from typing import Literal

Kind = Literal[
    "file", "unplaced", "rule", "overlap", "unchecked", "gap", "buried", "floating", "start", "goal", "way", "test",
    "steps",
]  # fmt: skip
"""Kinds of faults:

==============  ==============================================================
file            the world, or a vehicle in it, cannot be read or laid out
homeless        a random prop found no place
rule            a rule is broken
overlap         two props are in the same place
unchecked       Drake could not say whether they are
gap             two props are closer than the rule min_gap allows
buried          a prop is in the ground
floating        a prop hangs in the air
start, goal     it is no place for a vehicle
way             a vehicle has none
test            a test has a fault
steps           the first steps of a simulation fail
==============  ==============================================================
"""


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong with a world.

    Attributes:
        kind: see :data:`Kind`.
        text: one line, ``file:line: path: what``.
        names: the props that it is about; two for an overlap.
        depth: length of the shortest translation that separates two props, or how far a prop is off the ground [m].
        place: where, x, y, z in W [m].
        polygon: corners (x, y) of the area that is covered twice, seen from above, in W [m].
    """

    kind: Kind
    text: str
    names: tuple[str, ...] = ()
    depth: float | None = None
    place: tuple[float, float, float] | None = None
    polygon: tuple[tuple[float, float], ...] = ()

    def __str__(self) -> str:
        return self.text


def spot(*place: float) -> str:
    """A place as text, for example ``(3.00, -1.20) m``."""
    return f"({', '.join(f'{value + 0.0:.2f}'.replace('-0.00', '0.00') for value in place)}) m"


def amount(length: float) -> str:
    """A length as text: mm below 1 cm, cm below 1 m, else m; never rounded to nothing."""
    if length < 0.01:
        return f"{1e3 * length:.2g} mm"
    return f"{1e2 * length:.3g} cm" if length < 1.0 else f"{length:.3g} m"
