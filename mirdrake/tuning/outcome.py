"""What a study of tuning tells of its candidates: whether they reach what they shall, and the tables of the result."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd

from mirdrake.core.paths import installed_version
from mirdrake.tuning.designs import Design
from mirdrake.tuning.loops.base import Fidelity, LoopSpec
from mirdrake.tuning.loops.make import finer
from mirdrake.tuning.loops.reduced import critical_model, pid_of
from mirdrake.tuning.margins import loop_response
from mirdrake.tuning.robustness import Robustness
from mirdrake.tuning.spec import AT_LEAST, TuningSpec
from mirdrake.tuning.trials import Trial, Trials

MARGINS = ("ms", "mt", "gain_margin", "phase_margin_deg", "delay_margin_s", "disk_margin")

SEEN = 0.05
"""Part of the IAE by which a finer step of the plant may change it without a note."""


@dataclass(frozen=True)
class Candidate:
    """A design and what the plant says of it."""

    design: Design
    trial: Trial
    response: pd.DataFrame | None = None

    @property
    def rank(self) -> tuple[float, float]:
        """Small is good: how much it breaks the constraints, then the cost."""
        return self.trial.violation, self.trial.cost


def accept(
    baseline: Candidate,
    rule: Candidate | None,
    winner: Candidate,
    robust: Robustness | None,
    constraints: Mapping[str, float],
    course: Mapping[str, Any],
    *,
    at_finer: Mapping[str, Candidate | None] = MappingProxyType({}),
) -> list[dict[str, Any]]:
    """What a tuned loop shall reach, and whether it does.

    IAE at most half of the baseline's, the constraints, no run of the Monte Carlo unstable, nor one at a finer step of
    the plant, and a cost below that of the best rule which keeps the constraints and is stable in all of them, too.
    """
    figures = winner.trial.figures
    rows: list[dict[str, Any]] = []
    before, now = _iae(baseline, course), _iae(winner, course)
    share = now / before if math.isfinite(before) and before > 0.0 else 0.0 if math.isfinite(now) else math.inf
    words = "" if baseline.trial.status == "ok" else ", which is unstable"
    rows.append({"what": f"IAE over that of the baseline{words}", "value": share, "limit": 0.5, "met": share <= 0.5})
    for name, limit in constraints.items():
        value = figures.get(name, math.nan)
        met = value >= limit if name in AT_LEAST else value <= limit
        rows.append({"what": name, "value": value, "limit": limit, "met": met})
    if robust is not None:
        failures = robust.failures(winner.design.name).failures
        rows.append({"what": "Monte-Carlo runs not stable", "value": failures, "limit": 0, "met": failures == 0})
    lost_finer = {name: one.trial.status != "ok" for name, one in at_finer.items() if one is not None}
    if winner.design.name in lost_finer:
        lost = int(lost_finer[winner.design.name])
        rows.append({"what": "not stable at a finer step of the plant", "value": lost, "limit": 0, "met": not lost})
    fallen = {
        one.design.name: bool(robust and robust.failures(one.design.name).failures) or lost_finer.get(one.design.name)
        for one in (winner, rule)
        if one is not None
    }
    if rule is not None and rule.trial.feasible and fallen[rule.design.name]:
        stable = not fallen[winner.design.name]
        rows.append({"what": "keeps the constraints and is stable in all runs, which no rule is",
                     "value": float(winner.trial.feasible and stable), "limit": 1,
                     "met": winner.trial.feasible and stable})  # fmt: skip
    elif rule is not None and rule.trial.feasible:
        also = "" if robust is None else " and is stable in all runs"
        rows.append(
            {"what": f"cost against the best rule that keeps the constraints{also}, {rule.design.name}",
             "value": winner.trial.cost, "limit": rule.trial.cost,
             "met": winner.trial.feasible and winner.trial.cost < rule.trial.cost}
        )  # fmt: skip
    elif rule is not None:
        rows.append({"what": "keeps the constraints, which no rule does", "value": float(winner.trial.feasible),
                     "limit": 1, "met": winner.trial.feasible})  # fmt: skip
    return [{**row, "met": bool(row["met"])} for row in rows]


def _iae(one: Candidate, course: Mapping[str, Any]) -> float:
    """IAE of a candidate, of one that is unstable that of its response as far as it goes; inf if it has none."""
    if "iae" in one.trial.figures or one.response is None:
        return one.trial.figures.get("iae", math.inf)
    part = one.response[one.response["t"] >= course["step_time"] - 1e-9]
    error = (part["reference"] - part["output"]).abs().to_numpy()
    return float(np.sum(0.5 * (error[1:] + error[:-1]) * np.diff(part["t"].to_numpy())))


def baseline_words(spec: TuningSpec, *, loop_of_signals: bool) -> str:
    """How the gains to compare with were found."""
    if loop_of_signals:
        return "as the diagram has them" if spec.baseline == "published" else "as the study gives them"
    if spec.baseline == "published":
        return "100, 0.01 and 10 on every joint, the untuned gains of the papers' vehicles"
    return "as the study gives them"


def candidate_data(one: Candidate) -> dict[str, Any]:
    """A candidate as tuning.json has it."""
    trial = one.trial
    return {
        "name": one.design.name,
        "kind": one.design.kind,
        "how": one.design.how,
        "gains": one.design.gains,
        "figures": {name: value for name, value in trial.figures.items() if name not in MARGINS},
        "margins": {name: trial.figures.get(name, math.nan) for name in MARGINS},
        "cost": trial.cost,
        "feasible": trial.feasible,
        "status": trial.status,
        "reason": trial.reason,
    }


def finer_data(loop: LoopSpec, one: Candidate) -> dict[str, Any]:
    """What a candidate gives at a finer step of the plant, as tuning.json has it; steps: the usual one, the finer."""
    steps = [float(spec.diagram["plant"]["time_step"]) for spec in (loop, finer(loop))]
    return {"steps": steps, "figures": one.trial.figures, "status": one.trial.status, "reason": one.trial.reason}


def finer_notes(given: Mapping[str, Any], usual: Mapping[str, float]) -> list[str]:
    """The same for the reader, where the cost of the step is more than :data:`SEEN`.

    Args:
        given: from :func:`finer_data`.
        usual: figures at the usual step.
    """
    step, fine = (f"{1e3 * value:g} ms" for value in given["steps"])
    there: Mapping[str, float] = given["figures"]
    if given["status"] != "ok":
        return [f"at a plant step of {fine} instead of {step}: {given['status']}, {given['reason']}"]
    if not abs(there["iae"] - usual.get("iae", 0.0)) > SEEN * there["iae"]:
        return []
    named = {"IAE": "iae", "overshoot in percent": "overshoot_percent"}
    parts = [f"{words} {there[name]:.4g} instead of {usual.get(name, math.nan):.4g}" for words, name in named.items()]
    return [f"at a plant step of {fine} instead of {step}: {', '.join(parts)}"]


def loop_data(loop: LoopSpec) -> dict[str, Any]:
    """A loop as tuning.json has it."""
    kept = ("reference", "output", "effort", "output_unit", "effort_unit", "settings", "course", "nominal")
    gains = {gain: {"unit": unit, "path": loop.paths.get(gain, "")} for gain, unit in loop.gains.items()}
    return {"name": loop.kind, **{name: getattr(loop, name) for name in kept}, "gains": gains}


def responses_table(tried: list[Candidate]) -> pd.DataFrame:
    """Responses of all candidates: candidate, t, reference, output, effort."""
    parts = [one.response.assign(candidate=one.design.name) for one in tried if one.response is not None]
    columns = ["candidate", "t", "reference", "output", "effort"]
    return pd.concat(parts, ignore_index=True)[columns] if parts else pd.DataFrame(columns=columns)


def trials_table(
    coarse: Trials, *fine: Trials, limits: Mapping[str, float], coarse_on: Fidelity = "reduced"
) -> pd.DataFrame:
    """Trials of the search, then those of the searches on the plant, numbered through, with their fidelity.

    Of the latter those that break the limit of a margin are the reduced model's: see
    :class:`mirdrake.tuning.loops.evaluate.LoopEvaluator`.
    """
    parts = [coarse.table.assign(fidelity=coarse_on)]
    margins = {name: limit for name, limit in limits.items() if name in MARGINS}
    for one in fine:
        table = one.table
        broken = np.zeros(len(table), dtype=bool)
        for name, limit in margins.items():
            if name in table:
                value = table[name].to_numpy(dtype=float)
                broken |= value < limit if name in AT_LEAST else value > limit
        parts.append(table.assign(fidelity=np.where(broken, "reduced", "plant")))
    table = pd.concat(parts, ignore_index=True)
    table["number"] = range(len(table))
    return table


def frequency_table(loop: LoopSpec, chosen: list[Candidate]) -> pd.DataFrame:
    """Open loops over frequency, with the model of the loop on which each candidate is closest to the edge."""
    period = float(loop.options["period"])
    top = 0.99 * math.pi / period
    omega = np.geomspace(top / 3e3, top, 300)
    parts = []
    for one in chosen:
        model = critical_model(loop, one.design.gains)
        value = loop_response(model, pid_of(loop, one.design.gains), period=period)(omega)
        parts.append(pd.DataFrame({"candidate": one.design.name, "omega": omega, "re": value.real, "im": value.imag}))
    return pd.concat(parts, ignore_index=True)


def versions() -> dict[str, str]:
    """Of what decides on the outcome."""
    from importlib.metadata import version

    return {"mirdrake": installed_version("mirdrake") or "", "drake": version("drake"), "numpy": version("numpy")}
