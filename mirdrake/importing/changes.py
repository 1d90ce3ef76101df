"""What an import changed."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Change:
    """One line of the import report.

    Attributes:
        where: ``file:line`` in the source.
        what: the part, for example ``link 'chassis': inertia``.
        was: what the source had, with unit.
        became: what the vehicle folder has instead; "left out" if nothing.
        why: the reason.
    """

    where: str
    what: str
    was: str
    became: str
    why: str
