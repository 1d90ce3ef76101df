"""The whole way of tuning a loop: identify, design, search, confirm, shake, accept.

::

    TuningSpec ── make_loop_spec ─► LoopSpec ── identify_loop (plant) ─► models ── make_designs ─► rules
                                                                         │                         │ tried on the plant,
                                                                         ▼                         ▼ shaken
                 search on the reduced model ── refined on the plant, where rules have failed too ─► best ── Monte Carlo

The baseline ``published`` is 100, 0.01, 10 in the units of the joint: see :data:`mirdrake.tuning.spec.PUBLISHED`.
The winner is tried at a finer step of the plant, too. If that says otherwise, and the study asks for no step, all is
done again at the finer one. A study that was stopped goes on where it was when it is called again with the same folder.
"""

import math
import time
from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from mirdrake.core.digest import digest_data
from mirdrake.core.errors import RunError
from mirdrake.core.files import write_errors, write_file
from mirdrake.execution.worker_server import LOOP, start_server
from mirdrake.tuning.check import check_study
from mirdrake.tuning.designs import Design, make_designs, softer_designs
from mirdrake.tuning.identify import Identified, check_identified, identify_loop
from mirdrake.tuning.loops.evaluate import bench_of
from mirdrake.tuning.loops.make import baseline_gains, finer, make_loop_spec
from mirdrake.tuning.outcome import (
    accept,
    baseline_words,
    candidate_data,
    finer_data,
    finer_notes,
    frequency_table,
    loop_data,
    responses_table,
    trials_table,
    versions,
)
from mirdrake.tuning.over_speed import tune_over_speed
from mirdrake.tuning.result import TuningResult, load_result, plain, write_result
from mirdrake.tuning.selection import Selection
from mirdrake.tuning.space import known_starts, leaders_of, near_the_limits, search_space, space_around
from mirdrake.tuning.spec import TuningSpec, make_tuning
from mirdrake.tuning.stages import Progress, Stages
from mirdrake.tuning.trials import Trials

STUDY = "study.json"

ROUNDS = 2
"""Searches on the plant at most; the second is around the best of the first, and knows where others have failed. If it
was the finer step at which they failed, it is at that step, and around what stands there."""


FINE = "fine"
"""Folder of the journals of what is done again at a finer step."""


class Outcome(NamedTuple):
    """What came of a study.

    Attributes:
        result: as tuning.json has it, but for the time it took.
        tables: by the names of their files.
        doubts: what a finer step of the plant says against the best gains.
    """

    result: dict[str, Any]
    tables: dict[str, pd.DataFrame]
    doubts: list[str]


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
    if executor is None and workers != 0:
        start_server(LOOP)
    spec = make_tuning(study)
    began = time.monotonic()
    loop = make_loop_spec(spec)
    check_study(spec, loop)
    folder = Path(out)
    data = spec.model_dump(mode="json")
    key = digest_data(plain({"study": data, "loop": asdict(loop)}))
    finished = _open(folder, key)
    if finished is not None:
        return finished
    tell = progress or (lambda *_: None)
    try:
        outcome = _run(Stages(spec, loop, folder, key, executor, workers, tell), data)
        if outcome.doubts and "time_step" not in spec.plant.model_fields_set:
            outcome = _again(outcome, Stages(spec, loop, folder / FINE, key, executor, workers, tell), data)
    except KeyboardInterrupt:
        raise StoppedError(f"{folder}: stopped; call again to go on") from None
    wall = round(time.monotonic() - began, 1)
    return write_result(folder, plain(outcome.result | {"wall_s": wall}), outcome.tables)


def _again(outcome: Outcome, stages: Stages, data: dict[str, Any]) -> Outcome:
    """The same at the finer step at which gains that were found at the usual one have failed, or are other gains."""
    with write_errors(stages.folder):
        stages.folder.mkdir(exist_ok=True)
    plant = stages.spec.plant.model_copy(update={"time_step": outcome.result["finer"]["steps"][1]})
    stages.spec = stages.spec.model_copy(update={"plant": plant})
    stages.loop = make_loop_spec(stages.spec)
    fine = _run(stages, data)
    fine.result["notes"] += [f"done again with a shorter step of the plant, since {one}" for one in outcome.doubts]
    return fine


def _open(folder: Path, key: str) -> TuningResult | None:
    """Make the folder or take it up; the result if it is finished.

    Raises:
        RunError: it has something else in it.
    """
    with write_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        used = any(not entry.name.startswith(".") for entry in folder.iterdir())  # a kill may leave a file half written
    if not used:
        write_file(folder / STUDY, f'{{"key": "{key}"}}\n')
        return None
    file = folder / STUDY
    if not file.is_file() or key not in file.read_text(encoding="utf-8"):
        raise RunError(f"{folder}: is not empty, and not of this very study; choose another folder")
    return load_result(folder) if (folder / "tuning.json").is_file() else None


def _run(stages: Stages, data: dict[str, Any]) -> Outcome:
    spec, bare = stages.spec, stages.bare
    stages.tell("identification", 0, 1, math.nan)
    found = Identified(stages.loop, ())
    designs, softer = list[Design](), list[Design]()
    notes = ["a loop known by its signals only: no model, no rules, no margins"]
    if not bare:
        found = identify_loop(bench_of(stages.loop))
        check_identified(found)
        stages.loop = found.spec
        designs, notes = make_designs(found, max_sensitivity=min(max(spec.constraints.get("ms", 1.4), 1.1), 2.5))
        softer = softer_designs(found)
    base = Design("baseline", "baseline", baseline_words(spec, loop_of_signals=bare), baseline_gains(spec, stages.loop))
    tried = stages.try_designs([base, *designs], "rules")
    baseline = tried[0]
    selection = Selection(stages, tried, softer)
    rule = selection.best_rule()

    # Search on the reduced model, then on the plant around the best.
    known = tried if bare else tried[1:]
    mild = near_the_limits(stages.loop, tried[1:], stages.constraints.get("ms", math.inf))
    space = search_space(spec, stages.loop, [one.design.gains for one in mild])
    coarse = stages.search(space, "plant" if bare else "reduced", known_starts(space, known), "search")
    leaders = leaders_of(coarse)
    near = space_around(space, leaders)
    fine: list[Trials] = []
    best, fine_loop = None, None
    starts = known_starts(near, leaders, known)
    for count in range(ROUNDS):
        stage = "confirmation" if not count else f"confirmation-{count + 1}"
        fine.append(stages.search(near, "plant", starts, stage, loop=fine_loop, scenarios=selection.hard))
        best = selection.best(fine)
        if best is None or (selection.good(best, rule) and not selection.lost_at_finer):
            break
        around = leaders_of(fine[-1]) or leaders
        if selection.lost_at_finer:
            around, fine_loop = [one.trial for one in (best, rule) if one is not None], finer(stages.loop)
        near = space_around(space, around)
        starts = known_starts(near, around)
    tried += [best] if best is not None and best not in tried else []
    winner = min(tried[1:] or tried, key=lambda one: one.rank) if best is None else best

    # Robustness, map, open loops, gains over speed.
    shaken = {id(one) for one in (baseline, rule, winner, *selection.fallen_rules)}
    chosen = [one for one in tried if id(one) in shaken]
    robust = stages.shake(chosen)
    gain_map = stages.map(space, winner)
    scheduled = tune_over_speed(stages, space, winner, selection.hard)
    trials = trials_table(coarse, *fine, limits=stages.constraints, coarse_on="plant" if bare else "reduced")
    tables = {"responses": responses_table(tried), "trials": trials}
    tables |= {} if bare else {"frequency": frequency_table(stages.loop, chosen)}
    tables |= {} if gain_map is None else {"map": gain_map}
    tables |= {} if robust is None else {"monte_carlo": selection.with_grip(robust.table)}
    confirmed = selection.finer(winner)
    fine_step = None if confirmed is None else finer_data(stages.loop, confirmed)
    notes += selection.notes(winner)
    doubts = [] if fine_step is None else finer_notes(fine_step, winner.trial.figures)
    notes += doubts
    rows = accept(baseline, rule, winner, robust, stages.constraints, stages.loop.course, at_finer=selection.at_finer)
    result = {
        "name": spec.name,
        "vehicle": stages.loop.diagram["vehicles"][stages.loop.vehicle]["model"],
        "spec": data,
        "spec_sha256": digest_data(plain(data)),
        "seed": spec.seed,
        "versions": versions(),
        "loop": loop_data(stages.loop),
        "models": [asdict(model) for model in found.models],
        "notes": [*notes, *scheduled.notes],
        "candidates": [candidate_data(one) for one in tried],
        "baseline": baseline.design.name,
        "best": winner.design.name if winner.trial.feasible else None,
        "best_rule": rule.design.name if rule is not None else None,
        "finer": fine_step,
        "schedule": scheduled.rows,
        "schedule_check": scheduled.check,
        "robustness": None if robust is None else robust.data() | {"corners": selection.corners(chosen)},
        "acceptance": [*rows, *scheduled.acceptance],
    }
    return Outcome(result, tables, doubts)
