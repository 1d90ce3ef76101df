"""Conditions that gains must stand: those in which others have failed, the hardest draws, the corners of the ranges."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mirdrake.tuning.loops.base import NOMINAL, Conditions, Evaluation, Evaluator, Fidelity
from mirdrake.tuning.robustness import draw_conditions, read_ranges
from mirdrake.tuning.spec import TuningSpec
from mirdrake.tuning.trials import judge

SCREEN = 6
"""Draws of the Monte Carlo, those of the longest delay and those of the least friction, that come before all others."""


@dataclass(frozen=True)
class InScenarios:
    """Tries gains, and where they keep the constraints also in scenarios; can be pickled.

    Gains that are not stable in one of them are unstable. The figures are those of the conditions asked for.

    Attributes:
        evaluate: tries gains.
        scenarios: conditions to stand.
        constraints: limits of figures by name.
    """

    evaluate: Evaluator
    scenarios: tuple[Conditions, ...]
    constraints: dict[str, float]

    def __call__(
        self, gains: Mapping[str, float], conditions: Conditions = NOMINAL, fidelity: Fidelity = "plant"
    ) -> Evaluation:
        """Try gains; whatever happens is the answer."""
        found = self.evaluate(gains, conditions, fidelity)
        record = {"status": found.status, "figures": found.figures}
        if found.status == "ok" and judge(0, gains, record, {}, self.constraints).feasible:
            for one in self.scenarios:
                other = self.evaluate(gains, one, fidelity)
                if other.status != "ok":
                    return Evaluation(other.status, reason=f"{words(one)}: {other.reason}")
        return found


def drawn_ranges(spec: TuningSpec, *, bare: bool, slides: bool) -> dict[str, Any]:
    """Ranges of the conditions that the Monte Carlo draws.

    Args:
        spec: the study.
        bare: whether nothing is known of the loop but its signals.
        slides: whether the friction of the road can be changed.
    """
    given, ranges = spec.robustness, dict[str, Any]()
    if given.mass:
        ranges["mass"] = (1.0 - given.mass, 1.0 + given.mass)
    acting = ("friction", "delay", "grade") if not bare else ("friction",) if slides else ()
    for name in acting:
        low, high = getattr(given, name)
        if low < high:
            ranges[name] = (low, high)
    if given.noise:
        ranges["noise"] = (0.0, given.noise)
    return ranges


def hardest(spec: TuningSpec, ranges: Mapping[str, Any]) -> list[Conditions]:
    """Draws of the Monte Carlo that fail first if any does: :data:`SCREEN` of the longest delay and least friction."""
    spreads = read_ranges(ranges)
    if not spreads or not spec.robustness.runs:
        return []
    draws = draw_conditions(spreads, runs=spec.robustness.runs, seed=spec.seed)
    late = sorted(draws, key=lambda one: -(one.delay or 0.0))[:SCREEN]
    slippery = sorted(draws, key=lambda one: one.friction or math.inf)[:SCREEN]
    return late + [one for one in slippery if one not in late]


def corners(ranges: Mapping[str, Sequence[float]]) -> list[Conditions]:
    """Four corners of the ranges: light and heavy, at the least friction, with both ends of delay and grade."""

    def end(name: str, side: int, default: float | None) -> Any:
        return ranges[name][side] if name in ranges else default

    return [
        Conditions(
            mass=end("mass", mass, 1.0),
            friction=end("friction", 0, None),
            delay=end("delay", delay, None),
            grade=end("grade", grade, 0.0),
        )
        for mass, delay, grade in ((0, 1, 0), (1, 1, 1), (0, 0, 1), (1, 0, 0))
    ]


def words(conditions: Conditions) -> str:
    """Conditions that are not nominal, for people."""
    parts = [f"mass × {conditions.mass:.2f}"] if conditions.mass != 1.0 else []
    parts += [f"friction {conditions.friction:.2f}"] if conditions.friction is not None else []
    parts += [f"delay {1e3 * conditions.delay:.0f} ms"] if conditions.delay is not None else []
    parts += [f"grade {math.degrees(conditions.grade):.1f}°"] if conditions.grade else []
    parts += [f"noise {conditions.noise:.3g}"] if conditions.noise else []
    return ", ".join(parts) or "nominal"
