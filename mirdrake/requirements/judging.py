"""A parsed requirement, and its verdict and margin for a run."""

import math
from copy import copy
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mirdrake.core.errors import RunError
from mirdrake.requirements.observation import Array, Observation
from mirdrake.requirements.terms import Atom, Comparison, Expression, Happening

Kind = Literal["always", "never", "eventually", "until", "at end"]


class Finding(NamedTuple):
    """Result of a requirement for one run."""

    text: str
    """the requirement"""
    passed: bool
    margin: float
    """positive when it holds, in `unit`; infinite when nothing could ever decide it"""
    unit: str
    worst_time: float
    """when the margin was decided [s]"""
    times: Array
    """samples that count [s] (n); of ``A until B`` those before B if A decides"""
    margins: Array
    """of what is asked for, sample by sample (n); of ``A until B`` that of the one that decides"""
    decided_by: str = ""
    """the comparison or event that decided"""
    scale: float = 1.0
    """size that is usual for the margin, in `unit`: margins of different units compare by their ratio to it"""


@dataclass(frozen=True)
class Requirement:
    """A requirement that was understood; see :func:`parse_requirement`.

    Attributes:
        text: text of the requirement in the file.
        kind: the operator.
        expression: condition; A in ``A until B``.
        aim: B of ``A until B``.
        after: nothing counts before [s].
        within: nothing counts later than so much after `after` [s].
        atoms: the comparisons and events in it.
        where: ``file:line: path`` for messages.
    """

    text: str
    kind: Kind
    expression: Expression
    aim: Expression | None
    after: float
    within: float
    atoms: tuple[Atom, ...]
    where: str = ""

    @property
    def goals(self) -> tuple[str, ...]:
        """Names of the goals in the requirement; "goal" is the goal of the test."""
        events = [atom.event for atom in self.atoms if isinstance(atom, Happening)]
        return tuple(dict.fromkeys(event.removeprefix("at ") for event in events if event.startswith("at ")))

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the signals in the requirement."""
        return tuple(dict.fromkeys(atom.signal for atom in self.atoms if isinstance(atom, Comparison)))

    def judge(self, seen: Observation) -> Finding:
        """Judge a run: whether the requirement holds, and with which margin.

        Raises:
            ConfigError: the run has no such signal or goal, or the unit is another.
            RunError: a signal is not a number, or the run ended before it counts.
        """
        prefix = f"{self.where}: '{self.text}': " if self.where else f"'{self.text}': "
        # Wrong names and units are errors before any result, whatever the truth of the other terms.
        for atom in self.atoms:
            atom.check(seen, prefix)
        # A tolerance of 1 ns: sample times are sums of periods, and a boundary sample must not drop out by rounding.
        counts = (seen.times >= self.after - 1e-9) & (seen.times <= self.after + self.within + 1e-9)
        if not counts.any():
            end = seen.times[-1] if seen.times.size else 0.0
            raise RunError(f"{prefix}the run ended at {end:g} s, before this counts; make the test longer")
        rows = np.flatnonzero(counts)
        main = _Cut(self.expression, seen, rows)
        truth, margin = main.truth, main.margin
        # The margin of temporal logic: worst sample for always and never, best sample for eventually (robust
        # semantics).
        if self.kind == "until":
            assert self.aim is not None
            passed, main, worst = _until(main, _Cut(self.aim, seen, rows))
            margin = main.margin
        elif self.kind == "at end":
            worst, passed = len(rows) - 1, bool(truth[-1])
        elif self.kind == "eventually":
            worst, passed = int(margin.argmax()), bool(truth.any())
        else:
            if self.kind == "never":
                truth, margin = ~truth, -margin
            worst, passed = int(margin.argmin()), bool(truth.all())
        # The deciding sample also names the atom whose unit and scale the margin has; "until" may have cut the samples.
        decided, times = self.atoms[main.atom[worst]], seen.times[rows][: len(margin)]
        return Finding(
            text=self.text,
            passed=passed,
            margin=float(margin[worst]),
            unit=decided.unit_in(seen),
            worst_time=float(times[worst]),
            times=times,
            margins=margin,
            decided_by=decided.text,
            scale=decided.scale_in(seen),
        )

    def __str__(self) -> str:
        return self.text


class _Cut:
    """An expression at the samples that count."""

    def __init__(self, expression: Expression, seen: Observation, rows: NDArray[np.intp]) -> None:
        truth, margin, atom = expression.evaluate(seen)
        self.truth, self.margin, self.atom = truth[rows], margin[rows], atom[rows]

    def until(self, end: int) -> "_Cut":
        """Return the samples before another one."""
        cut = copy(self)
        cut.truth, cut.margin, cut.atom = self.truth[:end], self.margin[:end], self.atom[:end]
        return cut


def _until(hold: _Cut, aim: _Cut) -> tuple[bool, _Cut, int]:
    """Return the truth of ``hold until aim``, which of the two decides, and the deciding sample."""
    # Worst margin of the left side strictly before each sample: nothing has to hold before the first one.
    before = np.concatenate(([math.inf], np.minimum.accumulate(hold.margin)[:-1]))
    held_before = np.concatenate(([True], np.logical_and.accumulate(hold.truth)[:-1]))
    passed = bool((aim.truth & held_before).any())
    # Robustness of until: the best time of the smaller of "aim reached now" and "held up to now".
    best = int(np.minimum(aim.margin, before).argmax())
    if aim.margin[best] <= before[best]:
        return passed, aim, best
    return passed, hold.until(best), int(hold.margin[:best].argmin())
