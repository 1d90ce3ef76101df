"""The whole way of tuning a loop: identify, design, search, confirm, shake, accept.

::

    TuningSpec ── make_loop_spec ─► LoopSpec ── identify_loop (plant) ─► models ── make_designs ─► rules
                                                                         │                         │ tried on the plant
                                                                         ▼                         ▼
                        search on the reduced model ── refined on the plant, corners ─► best ── Monte Carlo ─► result

The baseline ``published`` is 100, 0.01, 10 in the units of the joint: see :data:`mirdrake.tuning.spec.PUBLISHED`.
A study that was stopped goes on where it was when it is called again with the same folder.
"""

import math
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from mirdrake.errors import RunError
from mirdrake.logs import write_file
from mirdrake.recording.files import told
from mirdrake.studies.calls import Lost, call_all, open_executor
from mirdrake.tuning.designs import DIGITS, Design, make_designs
from mirdrake.tuning.identify import Identified, check_identified, identify_loop
from mirdrake.tuning.loops.base import NOMINAL, Conditions, Evaluation, LoopSpec
from mirdrake.tuning.loops.evaluate import LoopEvaluator, bench_of
from mirdrake.tuning.loops.make import baseline_gains, check_names, make_loop_spec
from mirdrake.tuning.outcome import (
    MARGINS,
    Candidate,
    accept,
    baseline_words,
    candidate_data,
    frequency_table,
    loop_data,
    responses_table,
    trials_table,
    versions,
)
from mirdrake.tuning.result import TuningResult, digest, load_result, plain, write_result
from mirdrake.tuning.robustness import Robustness, draw_conditions, monte_carlo, read_ranges
from mirdrake.tuning.search import Trial, Trials, judge, map_of_two_gains, search
from mirdrake.tuning.space import known_starts, leaders_of, near_the_limits, search_space, space_around
from mirdrake.tuning.spec import TuningSpec, make_tuning

STUDY = "study.json"
MAP = 13
"""Values of each gain in the map."""

SCREEN = 6
"""Draws of the Monte Carlo, those of the longest delay, that a candidate must stand before it is shaken whole."""

POOL = 10
"""Candidates that are shaken at most before the one that fails least is taken."""

RESERVE = 1.5
"""Delay margin that candidates need, per what the delay may grow by."""

LIMIT = 600.0
"""Wall time of a trial [s]."""

Progress = Callable[[str, int, int, float], None]
"""Called with the stage, what is done, of how much, and the time left in it [s]; nan if it is not known."""


class StoppedError(Exception):
    """Ctrl-C; what is done is kept in the folder."""


def tune(
    study: TuningSpec | Mapping[str, Any] | Path | str,
    *,
    out: Path | str,
    executor: Executor | None = None,
    workers: int | None = 0,
    progress: Progress | None = None,
) -> TuningResult:
    """Tune a loop.

    Args:
        study: a tuning spec, its data or its file.
        out: folder of the result; made. One of this very study that is not finished is taken up again.
        executor: makes the trials, for example that of a Dask client; it is not shut down.
        workers: processes if there is no executor; 0: this process; None: as many as cores. The result is the same.
        progress: see :data:`Progress`.

    Raises:
        ConfigError, ModelError, WorldError: the study, its vehicle or its world has faults.
        RunError: the folder belongs to something else, or the plant cannot be measured.
        StoppedError: Ctrl-C; call again to go on.
    """
    spec = make_tuning(study)
    began = time.monotonic()
    loop = make_loop_spec(spec)
    check_names(spec, loop)
    baseline_gains(spec, loop)
    folder = Path(out)
    data = spec.model_dump(mode="json")
    key = digest({"study": data, "loop": asdict(loop)})
    finished = _open(folder, key)
    if finished is not None:
        return finished
    tell = progress or (lambda *_: None)
    try:
        return _Study(spec, loop, folder, key, executor, workers, tell, began).run(data)
    except KeyboardInterrupt:
        raise StoppedError(f"{folder}: stopped; call again to go on") from None


def _open(folder: Path, key: str) -> TuningResult | None:
    """Make the folder or take it up; the result if it is finished.

    Raises:
        RunError: it has something else in it.
    """
    with told(folder):
        folder.mkdir(parents=True, exist_ok=True)
        used = any(not entry.name.startswith(".") for entry in folder.iterdir())  # a kill may leave a file half written
    if not used:
        write_file(folder / STUDY, f'{{"key": "{key}"}}\n')
        return None
    file = folder / STUDY
    if not file.is_file() or key not in file.read_text(encoding="utf-8"):
        raise RunError(f"{folder}: is not empty, and not of this very study; choose another folder")
    return load_result(folder) if (folder / "tuning.json").is_file() else None


@dataclass
class _Study:
    spec: TuningSpec
    loop: LoopSpec
    folder: Path
    key: str
    executor: Executor | None
    workers: int | None
    tell: Progress
    began: float

    def run(self, data: dict[str, Any]) -> TuningResult:
        spec = self.spec
        self.tell("identification", 0, 1, math.nan)
        found = Identified(self.loop, ())
        if not self.bare:
            found = identify_loop(bench_of(self.loop))
            check_identified(found)
        self.loop = found.spec
        designs: list[Design] = []
        notes = ["a loop known by its signals only: no model, no rules, no margins"]
        if not self.bare:
            designs, notes = make_designs(found, max_sensitivity=min(max(spec.constraints.get("ms", 1.4), 1.1), 2.5))
        base = Design(
            "baseline", "baseline", baseline_words(spec, loop_of_signals=self.bare), baseline_gains(spec, self.loop)
        )
        tried = self._try([base, *designs], "rules")
        baseline, rules = tried[0], [one for one in tried[1:] if one.design.kind == "rule"]

        # Search on the reduced model, then on the plant around the best.
        known = tried if self.bare else tried[1:]
        mild = near_the_limits(self.loop, tried[1:], self.constraints.get("ms", math.inf))
        space = search_space(spec, self.loop, [one.design.gains for one in mild])
        coarse = self._search(
            space, "plant" if self.bare else "reduced", spec.search.trials, known_starts(space, known), "search"
        )
        leaders = leaders_of(coarse)
        near = space_around(space, leaders)
        fine = self._search(near, "plant", spec.search.confirm, known_starts(near, leaders, known), "confirmation")
        best = self._best(fine, tried)
        tried += [best] if best is not None and best not in tried else []
        pool = min(rules, key=lambda one: one.rank, default=None)
        winner = min(tried[1:] or tried, key=lambda one: one.rank) if best is None else best

        # Robustness, map, open loops.
        shaken = {id(one) for one in (baseline, pool, winner)}
        chosen = [one for one in tried if id(one) in shaken]
        robust = self._shake(chosen)
        gain_map = self._map(space, winner)
        tables = {
            "responses": responses_table(tried),
            "trials": trials_table(coarse, fine),
        }
        tables |= {} if self.bare else {"frequency": frequency_table(self.loop, chosen)}
        tables |= {} if gain_map is None else {"map": gain_map}
        tables |= {} if robust is None else {"monte_carlo": robust.table}
        result = {
            "name": spec.name,
            "vehicle": self.loop.diagram["vehicles"][self.loop.vehicle]["model"],
            "spec": data,
            "spec_sha256": digest(data),
            "seed": spec.seed,
            "versions": versions(),
            "loop": loop_data(self.loop),
            "models": [
                {
                    "name": model.name,
                    "kind": model.kind,
                    "parameters": {name: list(pair) for name, pair in model.parameters.items()},
                    "fit_percent": model.fit_percent,
                    "note": model.note,
                }
                for model in found.models
            ],
            "notes": notes,
            "candidates": [candidate_data(one) for one in tried],
            "baseline": baseline.design.name,
            "best": winner.design.name if winner.trial.feasible else None,
            "best_rule": pool.design.name if pool is not None else None,
            "schedule": self._schedule(space, winner),
            "robustness": None if robust is None else robust.data(),
            "acceptance": accept(baseline, pool, winner, robust, self.constraints, self.loop.course),
            "wall_s": round(time.monotonic() - self.began, 1),
        }
        return write_result(self.folder, plain(result), tables)

    @property
    def bare(self) -> bool:
        """Whether nothing is known of the loop but its signals."""
        return self.loop.kind in ("diagram", "path")

    @property
    def _slides(self) -> bool:
        """Whether the friction of the road can be changed: not where it has patches."""
        return bool(self.loop.options.get("friction", True))

    @property
    def constraints(self) -> dict[str, float]:
        """Those of the file, and a delay margin with some reserve for the delays of the Monte Carlo."""
        if self.bare:
            return {name: limit for name, limit in self.spec.constraints.items() if name not in MARGINS}
        grows = self.spec.robustness.delay[1] - self.loop.nominal["delay"]
        asked = {} if grows <= 0.0 or not self.spec.robustness.runs else {"delay_margin_s": RESERVE * grows}
        return asked | dict(self.spec.constraints)

    # --- stages -----------------------------------------------------------------------------------------------------

    def _try(self, designs: list[Design], stage: str) -> list[Candidate]:
        """Designs on the plant, with their responses, in their order."""
        evaluate = LoopEvaluator(self.loop, keep=True)
        done: dict[int, Evaluation] = {}
        calls = ((design.gains, NOMINAL, "plant") for design in designs)
        with open_executor(self.executor, self.workers, calls=len(designs), limit=LIMIT) as (runner, ahead):
            for at, given in call_all(runner, evaluate, calls, ahead=ahead):
                done[at] = Evaluation("failed", reason=given.reason) if isinstance(given, Lost) else given
                self.tell(stage, len(done), len(designs), math.nan)
        return [self._candidate(design, done[at], at) for at, design in enumerate(designs)]

    def _candidate(self, design: Design, given: Evaluation, number: int) -> Candidate:
        record = {"status": given.status, "reason": given.reason, "figures": given.figures}
        return Candidate(design, judge(number, design.gains, record, self.spec.cost, self.constraints), given.response)

    def _search(
        self,
        space: dict[str, dict[str, Any]],
        fidelity: str,
        trials: int,
        starts: list[dict[str, float]],
        stage: str,
    ) -> Trials:
        spec = self.spec
        method = spec.search.method if fidelity == "reduced" else "tpe"
        drawn = method in ("tpe", "cma", "nsga2")
        margins = {name: limit for name, limit in self.constraints.items() if name in MARGINS}
        found = search(
            LoopEvaluator(self.loop, margins=margins),
            space,
            method=method,
            trials=max(trials, 1),
            cost=spec.cost,
            constraints=self.constraints,
            start=starts[: max(trials // 2, 1)] if drawn else (),
            seed=spec.seed,
            executor=self.executor,
            workers=self.workers if fidelity == "plant" else 0,
            store=self.folder / f"{stage}.jsonl",
            purpose={"study": self.key},
            progress=lambda done, total, left: self.tell(stage, done, total, left),
            options={"fidelity": fidelity},
        )
        if not found.complete:
            raise KeyboardInterrupt
        return found

    def _best(self, fine: Trials, tried: list[Candidate]) -> Candidate | None:
        """The cheapest candidate that keeps the constraints and is stable in all runs of the robustness.

        If none is, the one that fails least among those that were shaken; None if none keeps the constraints.
        """
        known = [one for one in tried[1:] if one.trial.feasible]
        ranked = sorted((one for one in fine.trials if one.feasible), key=lambda one: (one.cost, one.number))
        pool: list[Candidate | Trial] = sorted(
            [*known, *ranked], key=lambda one: one.trial.cost if isinstance(one, Candidate) else one.cost
        )
        fallen: list[tuple[int, int, Candidate]] = []
        for at, one in enumerate(pool[:POOL]):
            gains = one.design.gains if isinstance(one, Candidate) else self._rounded(one.gains)
            if not self._stands(gains):
                continue
            chosen = one if isinstance(one, Candidate) else self._searched(gains, at)
            if not chosen.trial.feasible:  # by the rounding
                continue
            robust = self._shake([chosen])
            failures = 0 if robust is None else robust.failures(chosen.design.name).failures
            if not failures:
                return chosen
            fallen.append((failures, at, chosen))
        return min(fallen)[2] if fallen else None

    def _searched(self, gains: dict[str, float], at: int) -> Candidate:
        words = f"{self.spec.search.method} on the reduced model, refined on the plant"
        name = "searched" if not at else f"searched {at + 1}"
        return self._try([Design(name, "searched", words, gains)], "best")[0]

    def _rounded(self, gains: Mapping[str, float]) -> dict[str, float]:
        return {name: float(f"{value:.{DIGITS}g}") for name, value in gains.items()}

    def _stands(self, gains: Mapping[str, float]) -> bool:
        """Whether it is stable in the corners of the conditions, and in the hardest draws of the Monte Carlo."""
        given = self.spec.robustness
        if not given.runs:
            return True
        evaluate = LoopEvaluator(self.loop)
        low = given.friction[0] if self._slides else None
        corners = [
            Conditions(mass=1.0 + side * given.mass, friction=low, delay=delay, grade=grade)
            for side, delay, grade in (
                (-1.0, given.delay[1], given.grade[0]),
                (1.0, given.delay[1], given.grade[1]),
                (-1.0, given.delay[0], given.grade[1]),
                (1.0, given.delay[0], given.grade[0]),
            )
        ]
        spreads = read_ranges(self._ranges())
        draws = draw_conditions(spreads, runs=given.runs, seed=self.spec.seed) if spreads else []
        corners += sorted(draws, key=lambda one: -(one.delay or 0.0))[:SCREEN]
        for number, corner in enumerate(corners):
            self.tell("corners", number, len(corners), math.nan)
            if evaluate(gains, corner).status != "ok":
                return False
        return True

    def _ranges(self) -> dict[str, Any]:
        """Ranges of the conditions that are drawn."""
        given, ranges = self.spec.robustness, dict[str, Any]()
        if given.mass:
            ranges["mass"] = (1.0 - given.mass, 1.0 + given.mass)
        acting = ("friction", "delay", "grade") if not self.bare else ("friction",) if self._slides else ()
        for name in acting:
            low, high = getattr(given, name)
            if low < high:
                ranges[name] = (low, high)
        if given.noise:
            ranges["noise"] = (0.0, given.noise)
        return ranges

    def _shake(self, chosen: list[Candidate]) -> Robustness | None:
        given, ranges = self.spec.robustness, self._ranges()
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

    def _map(self, space: dict[str, dict[str, Any]], winner: Candidate) -> pd.DataFrame | None:
        """Cost and stability over the first two gains, on the reduced model; the others as those of the best."""
        if len(space) < 2 or self.bare:
            return None
        names = list(space)[:2]
        part = {}
        for name in names:
            value, entry = winner.design.gains[name], space[name]
            high = min(max(4.0 * value, 0.3 * entry["high"]), 3.0 * entry["high"])
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

    def _schedule(self, space: dict[str, dict[str, Any]], winner: Candidate) -> list[dict[str, Any]] | None:
        """Gains over speed, each identified and searched anew."""
        if self.spec.schedule is None:
            return None
        rows = []
        for speed in self.spec.schedule.speeds:
            loop = identify_loop(bench_of(make_loop_spec(self.spec, speed=speed))).spec
            found = search(
                LoopEvaluator(loop),
                space,
                method="tpe",
                trials=self.spec.search.trials,
                cost=self.spec.cost,
                constraints=self.constraints,
                start=known_starts(space, [winner]),
                seed=self.spec.seed,
                store=self.folder / f"speed-{speed:g}.jsonl",
                purpose={"study": self.key},
                progress=lambda done, total, left: self.tell("schedule", done, total, left),
                options={"fidelity": "reduced"},
            )
            if not found.complete:
                raise KeyboardInterrupt
            if found.best is not None:
                rows.append({"speed": speed, "gains": found.best.gains})
        return rows
