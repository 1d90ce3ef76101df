"""The stages of a study: designs tried on the plant, a search, a Monte Carlo, a map; each goes on where it was."""

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from mirdrake.execution.calls import Lost, call_all, open_executor
from mirdrake.tuning.designs import DIGITS, Design
from mirdrake.tuning.gain_map import map_of_two_gains
from mirdrake.tuning.loops.base import NOMINAL, Conditions, Evaluation, LoopSpec
from mirdrake.tuning.loops.evaluate import LoopEvaluator
from mirdrake.tuning.loops.make import finer
from mirdrake.tuning.outcome import MARGINS, Candidate
from mirdrake.tuning.robustness import Robustness, monte_carlo
from mirdrake.tuning.scenarios import InScenarios, drawn_ranges
from mirdrake.tuning.search import search
from mirdrake.tuning.spec import TuningSpec
from mirdrake.tuning.trials import Trials, judge

MAP = 13
"""Values of each gain in the map."""

RESERVE = 1.5
"""Delay margin that candidates need, per what the delay may grow by."""

LIMIT = 600.0
"""Wall time of a trial [s]."""

Progress = Callable[[str, int, int, float], None]
"""Called with the stage, what is done, of how much, and the time left in it [s]; nan if it is not known."""


@dataclass
class Stages:
    """What every stage of a study needs.

    Attributes:
        spec: the study.
        loop: its loop; with models once it is identified.
        folder: of the journals.
        key: of the study, so that no journal of another one is taken.
        executor: makes the trials.
        workers: processes if there is no executor.
        tell: see :data:`Progress`.
    """

    spec: TuningSpec
    loop: LoopSpec
    folder: Path
    key: str
    executor: Executor | None
    workers: int | None
    tell: Progress

    @property
    def bare(self) -> bool:
        """Whether nothing is known of the loop but its signals."""
        return self.loop.kind in ("diagram", "path")

    @property
    def ranges(self) -> dict[str, Any]:
        """Of the conditions that are drawn; friction only where the road has no patches of it."""
        return drawn_ranges(self.spec, bare=self.bare, slides=bool(self.loop.options.get("friction", True)))

    @property
    def constraints(self) -> dict[str, float]:
        """Those of the file, and a delay margin with some reserve for the delays of the Monte Carlo."""
        if self.bare:
            return {name: limit for name, limit in self.spec.constraints.items() if name not in MARGINS}
        grows = self.spec.robustness.delay[1] - self.loop.nominal["delay"]
        asked = {} if grows <= 0.0 or not self.spec.robustness.runs else {"delay_margin_s": RESERVE * grows}
        return asked | dict(self.spec.constraints)

    def try_designs(self, designs: list[Design], stage: str) -> list[Candidate]:
        """Designs on the plant, with their responses, in their order."""
        evaluate = LoopEvaluator(self.loop, keep=True)
        done: dict[int, Evaluation] = {}
        calls = ((design.gains, NOMINAL, "plant") for design in designs)
        with open_executor(self.executor, self.workers, calls=len(designs), limit=LIMIT) as (runner, ahead):
            for at, given in call_all(runner, evaluate, calls, ahead=ahead):
                done[at] = Evaluation("failed", reason=given.reason) if isinstance(given, Lost) else given
                self.tell(stage, len(done), len(designs), math.nan)
        return [self.candidate(design, done[at], at) for at, design in enumerate(designs)]

    def candidate(self, design: Design, given: Evaluation, number: int = 0) -> Candidate:
        """A design with what the plant says of it."""
        record = {"status": given.status, "reason": given.reason, "figures": given.figures}
        return Candidate(design, judge(number, design.gains, record, self.spec.cost, self.constraints), given.response)

    def search(
        self,
        space: dict[str, dict[str, Any]],
        fidelity: str,
        starts: list[dict[str, float]],
        stage: str,
        *,
        loop: LoopSpec | None = None,
        scenarios: Sequence[Conditions] = (),
    ) -> Trials:
        """Search on the reduced model by the study's method, or on the plant.

        Args:
            space: of the gains.
            fidelity: reduced or plant.
            starts: gains to begin with.
            stage: name of it, and of its journal.
            loop: another than the study's.
            scenarios: conditions in which gains that keep the constraints must be stable.
        """
        spec, reduced = self.spec, fidelity == "reduced"
        asked = spec.search.trials if reduced or (self.bare and stage == "search") else spec.search.confirm
        method = spec.search.method if reduced else "tpe"
        drawn = method in ("tpe", "cma", "nsga2")
        margins = {name: limit for name, limit in self.constraints.items() if name in MARGINS}
        evaluate: Any = LoopEvaluator(loop or self.loop, margins=margins)
        if scenarios:
            evaluate = InScenarios(evaluate, tuple(scenarios), self.constraints)
        found = search(
            evaluate,
            space,
            method=method,
            trials=max(asked, 1),
            cost=spec.cost,
            constraints=self.constraints,
            start=starts[: max(asked // 2, 1)] if drawn else (),
            seed=spec.seed,
            executor=self.executor,
            workers=self.workers if fidelity == "plant" else 0,
            store=self.folder / f"{stage}.jsonl",
            purpose={"study": self.key, "scenarios": [repr(one) for one in scenarios]},
            progress=lambda done, total, left: self.tell(stage, done, total, left),
            options={"fidelity": fidelity},
        )
        if not found.complete:
            raise KeyboardInterrupt
        return found

    def try_finer(self, design: Design) -> Candidate | None:
        """A design at a finer step of the plant; None where nothing is known of the loop but its signals."""
        return None if self.bare else self.candidate(design, LoopEvaluator(finer(self.loop))(design.gains))

    def stands(self, gains: Mapping[str, float], scenarios: Sequence[Conditions], loop: LoopSpec | None = None) -> bool:
        """Whether gains are stable in all of some scenarios."""
        evaluate = LoopEvaluator(loop or self.loop)
        for number, one in enumerate(scenarios):
            self.tell("scenarios", number, len(scenarios), math.nan)
            if evaluate(gains, one).status != "ok":
                return False
        return True

    def shake(self, chosen: list[Candidate]) -> Robustness | None:
        """The Monte Carlo; None if the study asks for none."""
        given, ranges = self.spec.robustness, self.ranges
        if not given.runs or not ranges:
            return None
        found = monte_carlo(
            LoopEvaluator(self.loop),
            {one.design.name: one.design.gains for one in chosen},
            ranges,
            runs=given.runs,
            seed=self.spec.seed,
            fidelity="plant",
            executor=self.executor,
            workers=self.workers,
            store=self.folder / "monte_carlo.jsonl",
            purpose={"study": self.key},
            progress=lambda done, total, left: self.tell("robustness", done, total, left),
        )
        if not found.complete:
            raise KeyboardInterrupt
        return found

    def map(self, space: dict[str, dict[str, Any]], winner: Candidate) -> pd.DataFrame | None:
        """Cost and stability over the first two gains, on the reduced model; the others as those of the best."""
        if len(space) < 2 or self.bare:
            return None
        names = list(space)[:2]
        part = {}
        margin = winner.trial.figures.get("gain_margin", math.nan)
        times = max(4.0, min(1.6 * margin, 12.0)) if math.isfinite(margin) else 4.0  # so far that the edge is in it
        for name in names:
            value, entry = winner.design.gains[name], space[name]
            high = min(max(times * value, 0.3 * entry["high"]), 3.0 * entry["high"])
            low = max(high / 60.0, entry["low"]) if entry["scale"] == "log" else entry["low"]
            part[name] = {"low": low, "high": high, "scale": entry["scale"]}
        found = map_of_two_gains(
            LoopEvaluator(self.loop),
            part,
            cost=self.spec.cost,
            constraints=self.constraints,
            count=MAP,
            fixed={name: value for name, value in winner.design.gains.items() if name not in names},
            store=self.folder / "map.jsonl",
            purpose={"study": self.key},
            progress=lambda done, total, left: self.tell("map", done, total, left),
            options={"fidelity": "reduced"},
        )
        return found.table


def rounded(gains: Mapping[str, float]) -> dict[str, float]:
    """Gains with the digits that are reported."""
    return {name: float(f"{value:.{DIGITS}g}") for name, value in gains.items()}
