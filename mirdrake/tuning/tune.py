"""Tunes a loop end to end: identify, design, search, confirm on the plant, Monte Carlo, accept.

::

    TuningSpec ── make_loop_spec ─► LoopSpec ── identify_loop (plant) ─► model ── LoopKind.designs ─► candidates
                                                                        │                        │ tested on the plant,
                                                                        ▼                        ▼ Monte Carlo
              search on the reduced model ── refined on the plant, in the draws that rules failed ─► best ── Monte Carlo

The best candidate is also tested at a finer step of the plant. If the result differs, and the study asks for no step,
the study is repeated at the finer one. A study that was interrupted is resumed by a call with the same folder.
"""

import math
import os
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd

from mirdrake.assembly.diagram_spec import make_spec
from mirdrake.assembly.scene import make_scene
from mirdrake.core.digest import digest, digest_data
from mirdrake.core.errors import RunError
from mirdrake.core.files import write_errors, write_file
from mirdrake.core.json_io import finite_or_none, finite_or_text, plain_data
from mirdrake.core.paths import installed_version
from mirdrake.execution.calls import open_executor
from mirdrake.execution.worker_server import LOOP, start_server
from mirdrake.runs.summary import scene_hashes
from mirdrake.tuning.acceptance import StepEffect, accept
from mirdrake.tuning.check import baseline_gains, check_study
from mirdrake.tuning.designs import Design, OmittedDesign, slower_designs
from mirdrake.tuning.identify import Identification, identify_loop
from mirdrake.tuning.loops.base import LoopSpec
from mirdrake.tuning.loops.evaluate import LoopEvaluator, bench_of
from mirdrake.tuning.loops.registry import LOOP_KINDS, make_loop_spec
from mirdrake.tuning.over_speed import tune_over_speed
from mirdrake.tuning.result import FILE, CandidateResult, TuningResult, read_result, write_result
from mirdrake.tuning.robustness import CornerTest, MonteCarlo
from mirdrake.tuning.scenarios import corners
from mirdrake.tuning.search_range import Space
from mirdrake.tuning.selection import (
    Knowledge,
    RuleChoice,
    Verification,
    beats_rule,
    better_of,
    choose_best,
    choose_rule,
    complete_checks,
    verify_baseline,
)
from mirdrake.tuning.space import inside, search_space, space_around
from mirdrake.tuning.spec import TuningSpec, make_tuning
from mirdrake.tuning.stages import LIMIT, Candidate, Progress, Stages, StoppedError, at_finer_step
from mirdrake.tuning.tables import frequency_table, responses_table, trials_table, with_grip
from mirdrake.tuning.trials import Trial, Trials

STUDY = "study.json"

ROUNDS = 2
"""Searches on the plant at most. The second is around the best of the first, in draws that candidates have failed; if
candidates failed at the finer step or on the vehicle's own slopes, it is there, around what is robust."""

FINE = "fine"
"""Folder of the journals of a study that is repeated at a finer step."""

Tables = dict[str, pd.DataFrame]


@dataclass(frozen=True)
class Designs:
    """Candidates by design, tested on the plant.

    Attributes:
        baseline: gains to compare with.
        tested: rules and loop shaping.
        omitted: designs without a solution.
        slower: further designs, not tested, if no rule is robust.
    """

    baseline: Candidate
    tested: tuple[Candidate, ...]
    omitted: tuple[OmittedDesign, ...] = ()
    slower: tuple[Design, ...] = ()


@dataclass(frozen=True)
class SearchOutcome:
    """Searches, and the best candidate of all.

    Attributes:
        space: ranges of the gains.
        coarse: trials on the reduced model.
        fine: trials on the plant, of each round.
        best: None if no candidate meets the constraints.
        known: results of the checks.
    """

    space: Space
    coarse: Trials
    fine: tuple[Trials, ...]
    best: Candidate | None
    known: Knowledge


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
        out: folder of the result; created. If it has an unfinished result of this study, that is resumed.
        executor: makes the tests, such as that of a Dask client; it is not shut down.
        workers: processes if there is no executor; 0: this process; None: as many as cores. The result is the same.
        progress: see :data:`Progress`.

    Raises:
        ConfigError, ModelError, WorldError: the study, its vehicle or its world has faults.
        RunError: the folder belongs to something else, or the plant cannot be measured.
        StoppedError: Ctrl-C; call again to resume.
    """
    # The fork server imports the plant while this process reads the study.
    if executor is None and workers != 0:
        start_server(LOOP)
    spec = make_tuning(study)
    began = time.monotonic()
    loop = make_loop_spec(spec)
    check_study(spec, loop)
    folder = Path(out)
    # A folder of another study is rejected, that of this one is resumed.
    key = study_key(spec, loop)
    finished = _open(folder, key)
    if finished is not None:
        return finished
    try:
        # One executor for all stages: its processes keep their test benches.
        with _shared_executor(executor, workers) as shared:
            stages = Stages(spec, loop, folder, key, shared, workers, progress or (lambda *_: None))
            result, tables = _run(stages)
            effect = result.step_effect
            # Repeated once at a finer step if that changes the result significantly, unless the study fixes the step.
            if effect is not None and effect.is_significant and "time_step" not in spec.plant.model_fields_set:
                result, tables = _repeat(stages, result, effect)
    # Finished evaluations are in the journals, so both interruptions can be resumed.
    except (KeyboardInterrupt, StoppedError):
        raise StoppedError(f"{folder}: stopped; run it again to resume") from None
    return write_result(replace(result, folder=folder, wall_s=round(time.monotonic() - began, 1)), tables)


def study_key(spec: TuningSpec, loop: LoopSpec) -> str:
    """Return what identifies a study: its spec, its loop, the contents of its vehicles and world, and the user's code.

    Raises:
        ConfigError, ModelError, WorldError: a vehicle or the world has faults.
    """
    # The spec names vehicle and world only: evaluations before and after a change of their files must not be mixed.
    content = scene_hashes(make_scene(make_spec(loop.diagram))) | user_sources(loop.diagram)
    study = {"study": spec.model_dump(mode="json"), "loop": asdict(loop), "content": content}
    return digest_data(plain_data(study, finite_or_text))


def user_sources(diagram: Any) -> dict[str, str]:
    """Return the digest of the file of each user class or function (``module:name``) that a diagram names."""
    if isinstance(diagram, Mapping):
        kind = diagram.get("kind")
        is_user_code = isinstance(kind, str) and ":" in kind and not kind.startswith("mirdrake.")
        module = sys.modules.get(str(kind).partition(":")[0]) if is_user_code else None
        file = getattr(module, "__file__", None) or ""
        digests = {str(kind): digest(Path(file).read_bytes())} if file.endswith(".py") else {}
        parts: Iterable[Any] = diagram.values()
    else:
        digests, parts = {}, diagram if isinstance(diagram, list) else ()
    for part in parts:
        digests |= user_sources(part)
    return digests


@contextmanager
def _shared_executor(executor: Executor | None, workers: int | None) -> Iterator[Executor | None]:
    """Yield the executor of all stages, whose processes build the plant once; None: tests run in this process."""
    if executor is not None or workers == 0:
        yield executor
        return
    with open_executor(None, workers, calls=os.cpu_count() or 1 if workers is None else workers, limit=LIMIT) as opened:
        yield opened[0]


def _open(folder: Path, key: str) -> TuningResult | None:
    """Create or resume the folder of a study; return its result if it is finished.

    Raises:
        RunError: it has something else in it.
    """
    with write_errors(folder):
        # An empty folder is free to use. Any other must belong to this study: results of two studies must not mix.
        folder.mkdir(parents=True, exist_ok=True)
        used = any(not entry.name.startswith(".") for entry in folder.iterdir())  # a kill may leave a hidden part
    if not used:
        write_file(folder / STUDY, f'{{"key": "{key}"}}\n')
        return None
    file = folder / STUDY
    if not file.is_file() or key not in file.read_text(encoding="utf-8"):
        raise RunError(
            f"{folder}: is not empty and does not belong to this study, or its vehicle or world has changed; "
            "choose another folder"
        )
    return read_result(folder) if (folder / FILE).is_file() else None


def _repeat(stages: Stages, coarse: TuningResult, effect: StepEffect) -> tuple[TuningResult, Tables]:
    """Run a study again at the finer step at which its best gains fail or have other figures."""
    folder = stages.folder / FINE
    with write_errors(folder):
        folder.mkdir(exist_ok=True)
    plant = stages.spec.plant.model_copy(update={"time_step": effect.finer_step})
    spec = stages.spec.model_copy(update={"plant": plant})
    result, tables = _run(replace(stages, spec=spec, loop=make_loop_spec(spec), folder=folder))
    return replace(result, repeated_for=effect, spec=coarse.spec, spec_sha256=coarse.spec_sha256), tables


def _run(stages: Stages) -> tuple[TuningResult, Tables]:
    """Run all stages of a study; the result does not have a folder yet."""
    identification = _identify(stages)
    # All later stages work on the loop with its model.
    stages = replace(stages, loop=identification.loop)
    designs = _design(stages, identification)
    choice = choose_rule(stages, [designs.baseline, *designs.tested], designs.slower)
    # Margins of the plant against those of the model, found by the check of the rules, tighten the search.
    stages = replace(stages, margin_ratios=choice.known.margin_ratios)
    outcome = _search(stages, designs, choice)

    # The winner is the best candidate, or the nearest to the constraints if there is none.
    tried = [designs.baseline, *designs.tested, *choice.added]
    if outcome.best is not None and outcome.best.name not in {candidate.name for candidate in tried}:
        tried.append(outcome.best)
    winner = outcome.best or min(tried[1:] or tried, key=lambda one: (one.trial.violation, one.trial.cost))

    # Monte Carlo of the candidates that are compared; the journal has the runs of the checks already.
    compared = {candidate.name for candidate in (designs.baseline, choice.rule, winner) if candidate}
    chosen = [candidate for candidate in tried if candidate.name in compared]
    # The median against the baseline matters only where the test itself prefers the winner.
    rivals = [designs.baseline] if winner.trial.cost < designs.baseline.trial.cost else []
    rivals += [choice.rule] if choice.rule is not None and choice.rule.name != winner.name else []
    runs = stages.monte_carlo(chosen, pairs=[(winner.name, rival.name) for rival in rivals])
    gain_map = stages.map(outcome.space, winner)
    schedule, schedule_criteria = tune_over_speed(stages, outcome.space, winner, choice.rule, outcome.known.hard)
    known = outcome.known
    if winner.name not in known.verified:  # it is not feasible
        # Infeasible winners have not been verified; the report needs the effect of the finer step.
        check = Verification(
            finer=stages.test_at_finer_step(winner.design), slopes=stages.test_on_own_slopes(winner.design)
        )
        known = replace(known, verified={**known.verified, winner.name: check})
    effect = _step_effect(stages, known.verified[winner.name], winner)
    criteria = accept(
        designs.baseline,
        choice.rule,
        # Acceptance uses the margins that the plant confirms, not those of the model.
        _with_claimed_margins(winner, known),
        cost=stages.spec.cost,
        constraints=stages.constraints,
        monte_carlo=runs,
        unavoidable=_unavoidable(stages, runs, chosen),
        verified=known.verified,
    )
    # Where the baseline remains, it is tested in what its rivals have failed; it has passed the test manoeuvre only.
    if not winner.trial.feasible or not all(criterion.met for criterion in criteria):
        known = complete_checks(stages, known, designs.baseline, tried[1:])
        known = verify_baseline(stages, known, designs.baseline, tried[1:])

    data = stages.spec.model_dump(mode="json")
    result = TuningResult(
        name=stages.spec.name,
        vehicle=stages.loop.diagram["vehicles"][stages.loop.vehicle]["model"],
        spec=data,
        spec_sha256=digest_data(plain_data(data, finite_or_text)),
        seed=stages.spec.seed,
        versions={
            "mirdrake": installed_version("mirdrake") or "",
            "drake": version("drake"),
            "numpy": version("numpy"),
        },
        loop=stages.loop,
        candidates=tuple(_candidate_result(stages, known, candidate) for candidate in tried),
        baseline=designs.baseline.name,
        # A winner that breaks constraints is reported, but is not the best.
        best=winner.name if winner.trial.feasible else None,
        best_rule=choice.rule.name if choice.rule is not None else None,
        cost=dict(stages.spec.cost),
        constraints=stages.constraints,
        experiments=identification.experiments,
        omitted=designs.omitted,
        # A trial that costs more in the test needs no reason for not having won.
        rejected=tuple(trial for trial in known.rejected if trial.cost < winner.trial.cost),
        step_effect=effect,
        schedule=schedule,
        robustness=None if runs is None else runs.summary(_corner_tests(stages, chosen)),
        acceptance=(*criteria, *schedule_criteria),
    )
    # All trials of controllers that are not PID are on the plant.
    limits = stages.constraints if stages.loop.has_pid_gains else {}
    trials = trials_table(outcome.coarse, outcome.fine, limits=limits, coarse_on=stages.first_fidelity)
    tables = {"responses": responses_table(tried), "trials": trials}
    frequency = frequency_table(stages.loop, chosen)
    tables |= {} if frequency.empty else {"frequency": frequency}
    tables |= {} if gain_map is None else {"map": gain_map}
    tables |= {} if runs is None else {"monte_carlo": with_grip(runs.table, stages.loop, stages.draws)}
    return result, tables


def _identify(stages: Stages) -> Identification:
    """Identify the loop; a loop of signals stays without a model."""
    stages.progress("identification", 0, 1, math.nan)
    if not stages.identifiable:
        return Identification(stages.loop)
    return identify_loop(bench_of(stages.loop))


def _design(stages: Stages, identification: Identification) -> Designs:
    """Make all designs and test them, with the baseline, on the plant."""
    made: tuple[Design, ...] = ()
    omitted: tuple[OmittedDesign, ...] = ()
    slower: tuple[Design, ...] = ()
    if stages.identifiable:
        # Loop shaping aims at the limit of Ms of the study, within usual values of Ms.
        bound = min(max(stages.spec.constraints.get("ms", 1.4), 1.1), 2.5)
        made, omitted = LOOP_KINDS[stages.loop.kind].designs(identification, bound)
        slower = slower_designs(identification)
    base = Design("baseline", "baseline", baseline_gains(stages.spec, stages.loop))
    baseline, *tested = stages.test([base, *made], "rules")
    return Designs(baseline, tuple(tested), omitted, slower)


def _search(stages: Stages, designs: Designs, choice: RuleChoice) -> SearchOutcome:
    """Search on the reduced model, then on the plant around the best, and choose the best candidate."""
    tried = [designs.baseline, *designs.tested, *choice.added]
    rules = [candidate.design.gains for candidate in tried[1:]]
    # Without a model all tested gains, the baseline included, start the search.
    known_gains, ranged = [candidate.design.gains for candidate in tried], rules
    if stages.identifiable:
        # The present gains start the search, too, but do not widen the ranges of the rules, if there are any.
        present = [stages.loop.present] if stages.loop.present else []
        known_gains, ranged = [*rules, *present], rules or present
    max_sensitivity = stages.constraints.get("ms", math.inf)
    space = search_space(stages.spec, stages.loop, ranged, max_sensitivity)
    # Draws that rules have failed: the slip model can test them in a search on the reduced model.
    hard = choice.known.hard if stages.first_fidelity == "reduced" else ()
    coarse = stages.search(space, stages.first_fidelity, inside(space, known_gains), "search", scenarios=hard)
    # The optimum is usually at limits, where few trials of a wide search are.
    if stages.first_fidelity == "reduced" and stages.spec.search.method == "tpe":
        near = space_around(space, coarse.leaders)
        starts = inside(near, _gains(coarse.leaders))
        coarse = coarse.extended(stages.search(near, "reduced", starts, "search-near", scenarios=hard))

    # Second stage: on the plant, in the part of the space around the best trials of the first.
    part = space_around(space, coarse.leaders)
    fine: list[Trials] = []
    best, known, loop = None, choice.known, None
    # Candidates that have been rejected are not tested once more.
    passed = [one.design.gains for one in tried[1:] if one.trial.feasible and _may_pass(known, one)]
    starts = inside(part, [*_gains(coarse.leaders), *passed])
    for count in range(ROUNDS):
        stage = "confirmation" if not count else f"confirmation-{count + 1}"
        fine.append(stages.search(part, "plant", starts, stage, loop=loop, scenarios=known.hard))
        best, known = choose_best(stages, known, tried, fine)
        # Nothing meets the constraints: another round would search around the same trials.
        if best is None:
            break
        beaten, known = beats_rule(stages, known, best, choice.rule)
        stages = replace(stages, margin_ratios=known.margin_ratios)
        # Better than the rule, and no trial was lost at the finer step or on the slopes: no further round.
        lost = known.lost_at_finer_step or known.lost_on_slopes
        if beaten and not lost:
            break

        # The next round is around the best trials, or around what is robust there.
        around = fine[-1].leaders or coarse.leaders
        if lost:
            around = [candidate.trial for candidate in (best, choice.rule) if candidate is not None]
        if known.lost_at_finer_step:
            loop = at_finer_step(stages.loop)
        part = space_around(space, around)
        starts = inside(part, _gains(around))
    # The test or the Monte Carlo may still prefer the rule.
    if best is not None:
        best = better_of(stages, known, best, choice.rule)
    return SearchOutcome(space, coarse, tuple(fine), best, known)


def _may_pass(known: Knowledge, candidate: Candidate) -> bool:
    """Return whether a candidate has not been rejected by a check so far."""
    return candidate.name not in known.verified or known.verified[candidate.name].is_robust


def _gains(trials: Sequence[Trial]) -> list[dict[str, float]]:
    return [trial.gains for trial in trials]


def _step_effect(stages: Stages, check: Verification, winner: Candidate) -> StepEffect | None:
    """Return the effect of a finer step of the plant on the winner; None for a loop of signals."""
    finer = check.finer
    if finer is None:
        return None
    steps = stages.loop.time_step, at_finer_step(stages.loop).time_step
    usual, changed = _defined(winner.trial.figures), _defined(finer.trial.figures)
    return StepEffect(*steps, usual, changed, finer.trial.status, finer.trial.reason)


def _candidate_result(stages: Stages, known: Knowledge, candidate: Candidate) -> CandidateResult:
    """Return a candidate as it is reported, with all reasons to reject it."""
    design, trial = candidate.design, candidate.trial
    check = known.verified.get(candidate.name)
    rejections = trial.rejections(stages.constraints) + (() if check is None else check.rejections)
    claimed = _with_claimed_margins(candidate, known).trial.figures
    return CandidateResult(
        design.name, design.kind, design.gains or stages.loop.present, trial.status, _defined(claimed),
        finite_or_none(trial.cost), trial.feasible, design.rule, design.parameter, trial.reason, rejections,
        () if check is None else check.margins,
    )  # fmt: skip


def _unavoidable(stages: Stages, runs: MonteCarlo | None, chosen: Sequence[Candidate]) -> dict[str, int]:
    """Return the number of runs by candidate in which neither it nor the present control is stable."""
    if runs is None:
        return {}
    tables = {one.name: runs.rows(one.name) for one in chosen if one.name in runs.candidates}
    return {
        name: int((table["status"] != "ok").sum()) - len(stages.unstable_runs(table)) for name, table in tables.items()
    }


def _with_claimed_margins(candidate: Candidate, known: Knowledge) -> Candidate:
    """Return a candidate with the margins that the plant confirms."""
    check = known.verified.get(candidate.name)
    claimed = {} if check is None else {margin.name: margin.claimed for margin in check.margins}
    return replace(candidate, trial=replace(candidate.trial, figures=candidate.trial.figures | claimed))


def _corner_tests(stages: Stages, chosen: Sequence[Candidate]) -> dict[str, tuple[CornerTest, ...]]:
    """Test candidates at corners of the ranges, which are harder than nearly every draw."""
    if not stages.identifiable:
        return {}
    conditions = corners(stages.ranges)
    # One list of calls, so that workers are busy throughout; results are in the same order.
    calls = [(candidate.design.gains, corner) for candidate in chosen for corner in conditions]
    rows = list(stages.evaluate(LoopEvaluator(stages.loop), calls, "corners"))
    tests: dict[str, tuple[CornerTest, ...]] = {}
    for number, candidate in enumerate(chosen):
        # The rows of this candidate.
        own = rows[number * len(conditions) : (number + 1) * len(conditions)]
        tests[candidate.name] = tuple(
            CornerTest(corner, row.status, row.reason) for corner, row in zip(conditions, own, strict=True)
        )
    return tests


def _defined(figures: Mapping[str, float]) -> dict[str, float]:
    """Return the figures that are not nan."""
    return {name: float(value) for name, value in figures.items() if not math.isnan(value)}
