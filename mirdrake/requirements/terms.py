"""The terms of a requirement: comparisons, events, negations and junctions, evaluated sample by sample."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mirdrake.core.errors import ConfigError, RunError, did_you_mean
from mirdrake.requirements.observation import Array, Observation, Truth

COUNTS = ("wheels_on_road", "other_contacts")
"""Signals that are whole numbers; only these are compared with == and !=."""


USUAL = {"rad": 0.1, "rad/s": 0.1}
"""Usual sizes of margins by unit; 1 for other units."""


class Verdict(NamedTuple):
    """Truth, margin and deciding atom of an expression, sample by sample."""

    truth: Truth
    margin: Array
    atom: NDArray[np.intp]


@dataclass(frozen=True)
class Comparison:
    """A signal compared with a number."""

    index: int
    signal: str
    sign: str
    value: float
    unit: str | None
    """SI unit in the text; None if there is none."""
    absolute: bool
    text: str

    def evaluate(self, seen: Observation) -> Verdict:
        """Evaluate the term at every sample."""
        values = seen.signals[self.signal]
        values = np.abs(values) if self.absolute else values
        below, strict = self.sign in {"<", "<="}, self.sign in {"<", ">"}
        # Counts differ by at least 1, so a margin of ±0.5 separates equal from different.
        if self.sign in {"==", "!="}:
            margin = (0.5 - np.abs(values - self.value)) * (1.0 if self.sign == "==" else -1.0)
            truth = np.asarray(values == self.value if self.sign == "==" else values != self.value)
        else:
            bound = self.value
            if self.signal in COUNTS:  # halfway between the last allowed and the first other count
                bound = math.ceil(bound) - 0.5 if below == strict else math.floor(bound) + 0.5
            margin = bound - values if below else values - bound
            truth = np.asarray(margin > 0.0 if strict else margin >= 0.0)
        return Verdict(truth, margin, np.full(len(values), self.index))

    def unit_in(self, seen: Observation) -> str:
        """Return the unit of the margin."""
        return seen.units.get(self.signal, "")

    def scale_in(self, seen: Observation) -> float:
        """Return the usual size of the margin: the value compared with, or :data:`USUAL` of its unit."""
        usual = USUAL.get(seen.units.get(self.signal, ""), 1.0)
        return abs(self.value) if self.value and self.signal not in COUNTS else usual

    def check(self, seen: Observation, prefix: str) -> None:
        """Check that the run has the signal.

        Raises:
            ConfigError: the run has no such signal, or its unit differs.
            RunError: a sample is not a number.
        """
        if self.signal not in seen.signals:
            raise ConfigError(
                f"{prefix}the run has no signal '{self.signal}'; {did_you_mean(self.signal, seen.signals)}"
            )
        have = seen.units.get(self.signal, "")
        if self.unit is not None and self.unit != have:
            raise ConfigError(f"{prefix}'{self.signal}' is in {have or 'pure numbers'}, not in {self.unit}")
        bad = np.isnan(seen.signals[self.signal])
        if bad.any():
            raise RunError(f"{prefix}'{self.signal}' is not a number at t = {seen.times[int(np.argmax(bad))]:g} s")


@dataclass(frozen=True)
class Happening:
    """An event, such as a collision."""

    index: int
    event: str
    text: str

    def _name(self, seen: Observation) -> str:
        return f"at {seen.goal}" if self.event == "at goal" and seen.goal else self.event

    def evaluate(self, seen: Observation) -> Verdict:
        """Evaluate the term at every sample."""
        event = seen.events[self._name(seen)]
        return Verdict(event.truth, event.margin, np.full(len(event.truth), self.index))

    def unit_in(self, seen: Observation) -> str:
        """Return the unit of the margin."""
        return seen.events[self._name(seen)].unit

    def scale_in(self, seen: Observation) -> float:
        """Return the usual size of the margin."""
        return seen.events[self._name(seen)].scale

    def check(self, seen: Observation, prefix: str) -> None:
        """Check that the run has the event, and that its margins are numbers."""
        name = self._name(seen)
        if name not in seen.events:
            if name == "at goal":
                raise ConfigError(f"{prefix}the test has no goal; add goal: NAME to it")
            known = [event.removeprefix("at ") for event in seen.events if event.startswith("at ")]
            given = name.removeprefix("at ")
            hint = did_you_mean(given, known) if known else "the world has none; add it under goals"
            raise ConfigError(f"{prefix}the world has no goal '{given}' that this run can reach; {hint}")
        bad = np.isnan(seen.events[name].margin)
        if bad.any():
            raise RunError(f"{prefix}'{name}' cannot be judged at t = {seen.times[int(np.argmax(bad))]:g} s")


@dataclass(frozen=True)
class Negation:
    """The negation of a term."""

    part: "Expression"

    def evaluate(self, seen: Observation) -> Verdict:
        """Evaluate the term at every sample."""
        truth, margin, atom = self.part.evaluate(seen)
        return Verdict(~truth, -margin, atom)


@dataclass(frozen=True)
class Junction:
    """Terms of which all must hold (and), or one (or)."""

    parts: tuple["Expression", ...]
    every: bool

    def evaluate(self, seen: Observation) -> Verdict:
        """Evaluate the term at every sample."""
        parts = [part.evaluate(seen) for part in self.parts]
        margins = np.array([part.margin for part in parts])
        row = (margins.argmin(axis=0) if self.every else margins.argmax(axis=0))[None]
        truths = np.array([part.truth for part in parts])
        atoms = np.array([part.atom for part in parts])
        return Verdict(
            np.asarray(truths.all(axis=0) if self.every else truths.any(axis=0)),
            np.take_along_axis(margins, row, axis=0)[0],
            np.take_along_axis(atoms, row, axis=0)[0],
        )


Atom = Comparison | Happening
Expression = Comparison | Happening | Negation | Junction
