"""Conditions under which gains must be stable: the hardest draws of the Monte Carlo, and corners of its ranges."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from mirdrake.tuning.loops.base import NOMINAL, Conditions, Evaluation, Evaluator, Fidelity, LoopSpec
from mirdrake.tuning.loops.manoeuvres import (
    MOST_OVER_PRESENT,
    OVER_PRESENT,
    Manoeuvre,
    largest_ratio,
    manoeuvre_costs,
)
from mirdrake.tuning.loops.registry import LOOP_KINDS
from mirdrake.tuning.loops.slip import UNSTABLE, reaction_on_own_slopes, run_with_reaction
from mirdrake.tuning.spec import TuningSpec
from mirdrake.tuning.trials import make_trial

SCREEN = 6
"""Draws with the longest delay, and draws with the least friction, that are tested before all others."""

SLIP = "slip_reaction"
"""Figure: largest :func:`mirdrake.tuning.loops.slip.slip_reaction` of gains."""

MOST_SLIP = 1.0
"""Limit of it [1]."""

Ranges = dict[str, tuple[float, float]]
"""Lower and upper end by name of a condition."""


@dataclass(frozen=True)
class InScenarios:
    """Tests gains, and those that meet the constraints also in scenarios; can be pickled.

    Gains that are not stable in a scenario are unstable. The figures are those of the conditions that were asked for.

    Attributes:
        evaluate: tests gains.
        scenarios: conditions under which gains must be stable.
        constraints: limits of figures by name.
    """

    evaluate: Evaluator
    scenarios: tuple[Conditions, ...]
    constraints: dict[str, float]

    def __call__(
        self, gains: Mapping[str, float], conditions: Conditions = NOMINAL, fidelity: Fidelity = "plant"
    ) -> Evaluation:
        """Test gains; every failure is an evaluation."""
        result = self.evaluate(gains, conditions, fidelity)
        if result.status == "ok" and make_trial(0, gains, result, {}, self.constraints).feasible:
            for scenario in self.scenarios:
                other = self.evaluate(gains, scenario, fidelity)
                if other.status != "ok":
                    return Evaluation(other.status, reason=f"{describe(scenario)}: {other.reason}")
        return result


@dataclass(frozen=True)
class InSlip:
    """Tests gains, and adds the reaction of their controllers to wheels that slide as the figure :data:`SLIP`.

    Can be pickled. The slip model (:mod:`mirdrake.tuning.loops.slip`) takes a hundredth of the time of the plant, which
    does not test gains that break the limit. As a figure the reaction shows a search in which direction it decreases.

    Attributes:
        evaluate: tests gains.
        slopes: loop whose test has the vehicle's own slopes of the set-point.
        loop: the loop.
        scenarios: conditions of further tests of the loop.
    """

    evaluate: Evaluator
    slopes: LoopSpec
    loop: LoopSpec
    scenarios: tuple[Conditions, ...] = ()

    def __call__(
        self, gains: Mapping[str, float], conditions: Conditions = NOMINAL, fidelity: Fidelity = "plant"
    ) -> Evaluation:
        """Test gains; every failure is an evaluation."""
        # Other conditions are tests of the same gains.
        if conditions != NOMINAL:
            return self.evaluate(gains, conditions, fidelity)
        reaction = reaction_on_own_slopes(self.slopes, gains)
        for scenario in self.scenarios:
            # With little friction wheels may have to slide, so that only those that keep sliding are a fault.
            result, found = run_with_reaction(self.loop, gains, scenario)
            if result.status != "ok":
                reaction = max(reaction, found, UNSTABLE)
        result = self.evaluate(gains, conditions, fidelity if reaction <= MOST_SLIP else "reduced")
        return replace(result, figures={**result.figures, SLIP: reaction}) if result.status == "ok" else result


@dataclass(frozen=True)
class InManoeuvres:
    """Tests gains, and adds the largest ratio of the IAE to that of the present ones in a manoeuvre; can be pickled.

    The plant does not test gains that break the limit of the ratio.

    Attributes:
        evaluate: tests gains.
        manoeuvres: see :mod:`mirdrake.tuning.loops.manoeuvres`.
        present: costs of the present gains in their parts.
    """

    evaluate: Evaluator
    manoeuvres: tuple[Manoeuvre, ...]
    present: tuple[float, ...]

    def __call__(
        self, gains: Mapping[str, float], conditions: Conditions = NOMINAL, fidelity: Fidelity = "plant"
    ) -> Evaluation:
        """Test gains; every failure is an evaluation."""
        # Other conditions are tests of the same gains.
        if conditions != NOMINAL:
            return self.evaluate(gains, conditions, fidelity)
        ratio = largest_ratio(manoeuvre_costs(self.manoeuvres, gains), self.present)
        result = self.evaluate(gains, conditions, fidelity if ratio <= MOST_OVER_PRESENT else "reduced")
        return replace(result, figures={**result.figures, OVER_PRESENT: ratio}) if result.status == "ok" else result


def drawn_ranges(spec: TuningSpec, loop: LoopSpec) -> Ranges:
    """Return the ranges of the conditions that the Monte Carlo of a study draws, of those that affect the loop."""
    given, ranges = spec.robustness, Ranges()
    # Scale of the mass, symmetric about nominal.
    if given.mass:
        ranges["mass"] = (1.0 - given.mass, 1.0 + given.mass)
    # Without a uniform friction of the road there is nothing to draw.
    friction = ("friction",) if loop.friction is not None else ()
    kind = LOOP_KINDS[loop.kind]
    for name in (*friction, *kind.conditions):
        low, high = kind.delays(spec) if name == "delay" else getattr(given, name)
        # An empty range is a constant: nothing is drawn.
        if low < high:
            ranges[name] = (low, high)
    if given.noise:
        ranges["noise"] = (0.0, given.noise)
    return ranges


def hardest(draws: Sequence[Conditions]) -> list[Conditions]:
    """Return the draws that are most likely to fail: :data:`SCREEN` each of longest delay and least friction."""
    delayed = sorted(draws, key=lambda draw: -(draw.delay or 0.0))[:SCREEN]
    slippery = sorted(draws, key=lambda draw: draw.friction or math.inf)[:SCREEN]
    return delayed + [draw for draw in slippery if draw not in delayed]


def corners(ranges: Ranges) -> list[Conditions]:
    """Return four corners of the ranges: light and heavy, least friction, both ends of delay and grade."""

    def end(name: str, side: int) -> float | None:
        return ranges[name][side] if name in ranges else None

    return [
        # Mass, delay and grade at their ends; friction only at its lower end, which is the harder one.
        Conditions(
            mass=end("mass", mass) or 1.0,
            friction=end("friction", 0),
            delay=end("delay", delay),
            grade=end("grade", grade) or 0.0,
        )
        for mass, delay, grade in ((0, 1, 0), (1, 1, 1), (0, 0, 1), (1, 0, 0))
    ]


def describe(conditions: Conditions) -> str:
    """Return the conditions that are not nominal as text."""
    parts = [f"mass × {conditions.mass:.2f}"] if conditions.mass != 1.0 else []
    parts += [f"friction {conditions.friction:.2f}"] if conditions.friction is not None else []
    parts += [f"delay {1e3 * conditions.delay:.0f} ms"] if conditions.delay is not None else []
    parts += [f"grade {math.degrees(conditions.grade):.1f}°"] if conditions.grade else []
    parts += [f"step × {conditions.step:.2f}"] if conditions.step != 1.0 else []
    parts += [f"noise {conditions.noise:.3g}"] if conditions.noise else []
    return ", ".join(parts) or "nominal"
