"""Why a tuning study found nothing better than the baseline: all causes at once, and the changes that would help."""

import math
from collections import Counter
from typing import TYPE_CHECKING

from mirdrake.core.wording import plural
from mirdrake.tuning.result import CandidateResult
from mirdrake.tuning.scenarios import describe
from mirdrake.tuning.selection import COMPLETED, FAR
from mirdrake.tuning.spec import AT_LEAST
from mirdrake.tuning.trials import Rejection

if TYPE_CHECKING:
    from mirdrake.report.tuning_texts import Texts

CHECKS = {
    "test": "the test manoeuvre",
    "finer_step": "the finer step of the plant",
    "own_slopes": "the vehicle's own slopes of the set-point",
    "scenario": "the hardest draws of the Monte Carlo",
    "monte_carlo": "the Monte Carlo",
}
"""What rejects candidates, besides limits of figures."""

CONDITIONS = {
    "mass": ("× {:.2f}", 1.0),
    "friction": ("{:.2f}", 1.0),
    "delay": ("{:.0f} ms", 1e3),
    "grade": ("{:.1f}°", math.degrees(1.0)),
    "step": ("× {:.2f}", 1.0),
    "noise": ("{:.3g}", 1.0),
}
"""Text and scale of a condition of a run."""


def cause_sentences(texts: "Texts") -> list[str]:
    """Return what rejected candidates, and for those that cost less than the baseline what would have to change."""
    result, baseline = texts.result, texts.baseline
    candidates = [candidate for candidate in result.candidates if candidate.kind != "baseline"]
    counts = Counter(
        cause
        for rejections in (*(one.rejections for one in candidates), *(trial.rejections for trial in result.rejected))
        for cause in dict.fromkeys(_cause(texts, rejection) for rejection in rejections)
    )
    total = len(candidates) + len(result.rejected)
    named = ", ".join(f"{cause} ({number})" for cause, number in counts.most_common())
    sentences = [f"Rejections of {plural(total, 'candidate')} by cause: {named}."] if named else []

    # Candidates that would be better: first those that need the fewest changes.
    bar = math.inf if baseline is None or baseline.cost is None else baseline.cost
    cheaper = [one for one in candidates if one.cost is not None and one.cost < bar and one.rejections]
    cheaper.sort(key=lambda one: (_excess(one), one.cost))
    near = [one for one in cheaper if _excess(one) <= FAR]
    sentences += [sentence for one in near if (sentence := _changes(one))][:COMPLETED]
    if not cheaper and math.isfinite(bar) and all(one.cost is None or one.cost >= bar for one in candidates):
        servo = ": they are servos, which act without the delay of the actuators" * (
            result.loop.present_kind == "servo" and result.spec.get("baseline") == "present"
        )
        sentences.append(f"No candidate costs less than the baseline, whatever the limits{servo}.")
    return sentences


def _cause(texts: "Texts", rejection: Rejection) -> str:
    return texts.figure(rejection.figure)[0] if rejection.figure else CHECKS.get(rejection.check, rejection.check)


def _excess(candidate: CandidateResult) -> float:
    """Return by how much a candidate breaks limits of figures, relative to them [1]."""
    return sum(_beyond(one) / max(abs(one.limit), 1e-9) for one in candidate.rejections if one.limit is not None)


def _changes(candidate: CandidateResult) -> str:
    """Return with which changes a candidate would pass; empty if one of its causes has no remedy that is known."""
    worst: dict[str, Rejection] = {}
    for rejection in candidate.rejections:
        # A margin may break its limit on the model and on the plant; of the failed runs the first has the causes.
        known = worst.setdefault(rejection.figure or rejection.check, rejection)
        if _beyond(rejection) > _beyond(known):
            worst[rejection.figure or rejection.check] = rejection
    changes = [_change(rejection) for rejection in worst.values()]
    return f"{candidate.name} (cost {candidate.cost:.4g}) needs: {'; '.join(changes)}." if all(changes) else ""


def _beyond(rejection: Rejection) -> float:
    """Return by how much a figure breaks its limit; inf if it is not defined."""
    return math.inf if rejection.value is None else abs(rejection.value - (rejection.limit or 0.0))


def _change(rejection: Rejection) -> str:
    match rejection.check:
        case "constraint" | "margin" if rejection.value is not None and math.isfinite(rejection.value):
            return f"constraints.{rejection.figure} of {_outward(rejection.value, rejection.figure in AT_LEAST)}"
        case "own_slopes" if rejection.needs:
            slopes = " and ".join(
                f"speed.{name} of at most {_outward(value, down=True)} m/s²" for name, value in rejection.needs.items()
            )
            return f"{slopes} in control.yaml"
        case "monte_carlo" if rejection.needs:
            limits = [
                f"robustness.{name} without {CONDITIONS[name][0].format(CONDITIONS[name][1] * value)}"
                for name, value in rejection.needs.items()
            ]
            return " or ".join(limits)
        case "monte_carlo" if rejection.conditions is not None:
            return f"narrower ranges of robustness, as no single condition of run {rejection.run} " + (
                f"({describe(rejection.conditions)}) is the cause"
            )
        case _:
            return ""


def _outward(value: float, down: bool) -> str:
    """Return a value with three digits, rounded down or up so that what has this value is within the limit."""
    if not value:
        return "0"
    scale = 10.0 ** (2 - math.floor(math.log10(abs(value))))
    return f"{(math.floor if down else math.ceil)(value * scale) / scale:.3g}"
