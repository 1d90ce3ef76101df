"""Operations of a study on its loop: tests of designs, searches, Monte Carlo, map. An interrupted one is resumed."""

import math
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import islice
from pathlib import Path

import numpy as np
import pandas as pd

from mirdrake.execution.calls import Lost, call_all, open_executor
from mirdrake.plant.plant import PlantSpec
from mirdrake.tuning.check import baseline_gains
from mirdrake.tuning.confirm import MarginCheck, confirm_margins
from mirdrake.tuning.designs import Design
from mirdrake.tuning.gain_map import map_of_two_gains
from mirdrake.tuning.grip import axles_of
from mirdrake.tuning.loops.base import NOMINAL, Conditions, Evaluation, Evaluator, Fidelity, LoopSpec
from mirdrake.tuning.loops.evaluate import LoopEvaluator, plant_bench
from mirdrake.tuning.loops.manoeuvres import (
    MOST_OVER_PRESENT,
    OVER_PRESENT,
    Manoeuvre,
    largest_ratio,
    make_manoeuvres,
    manoeuvre_costs,
    plant_costs,
)
from mirdrake.tuning.loops.registry import LOOP_KINDS
from mirdrake.tuning.loops.slip import direct, fault_on_own_slopes, run_slip
from mirdrake.tuning.models import Floats
from mirdrake.tuning.robustness import MonteCarlo, draw_conditions, run_monte_carlo
from mirdrake.tuning.scenarios import MOST_SLIP, SLIP, InManoeuvres, InScenarios, InSlip, Ranges, drawn_ranges, hardest
from mirdrake.tuning.screening import COST, SAMPLE, WORST, InRuns, check_ranks, choose_runs, cost_ratio, is_decided
from mirdrake.tuning.search import search
from mirdrake.tuning.search_range import Space
from mirdrake.tuning.space import map_space
from mirdrake.tuning.spec import AT_LEAST, MARGINS, TuningSpec, breaks_limit
from mirdrake.tuning.trials import Rejection, Trial, Trials, make_trial

MAP = 13
"""Values of each gain in the map."""

BATCH = 4
"""Runs of the Monte Carlo after which a candidate is rejected if one of them has failed."""

TRIALS: Mapping[Fidelity, int] = {"reduced": 300, "plant": 100}
"""Default number of trials of the first search."""

NEAR = 4
"""Trials of the first search over those of the one around its best trials."""

RESERVE = 1.5
"""Required delay margin, relative to the largest increase of the delay in the Monte Carlo."""

LIMIT = 600.0
"""Wall time of a test [s]."""

Progress = Callable[[str, int, int, float], None]
"""Called with the stage, the numbers of finished and all steps, and the time left in the stage [s]; nan if unknown."""


class StoppedError(Exception):
    """Interrupted by Ctrl-C; finished work is kept in the folder."""


@dataclass(frozen=True)
class Candidate:
    """A design and the result of its test on the plant."""

    design: Design
    trial: Trial
    response: pd.DataFrame | None = None

    @property
    def name(self) -> str:
        """Name of the design."""
        return self.design.name


@dataclass(frozen=True)
class Stages:
    """A study, its loop, and what executes its tests.

    Attributes:
        spec: the study.
        loop: its loop; with a model once it is identified.
        folder: of the journals.
        key: of the study; journals of another one are rejected.
        executor: makes the tests.
        workers: processes if there is no executor.
        progress: see :data:`Progress`.
        margin_ratios: margins of the plant over those of the model, as far as they are known; a search uses limits of
            the model's margins with which those of the plant are met.
        scenarios: tests in single conditions so far, by step of the plant and gains: a Monte Carlo need not repeat
            them.
        unstable_now: whether the present control is unstable, by step of the plant and draw.
    """

    spec: TuningSpec
    loop: LoopSpec
    folder: Path
    key: str
    executor: Executor | None
    workers: int | None
    progress: Progress
    margin_ratios: Mapping[str, float] = field(default_factory=dict)
    scenarios: dict[tuple[float, ...], dict[Conditions, Evaluation]] = field(default_factory=dict)
    unstable_now: dict[tuple[float, Conditions], bool] = field(default_factory=dict)

    @property
    def identifiable(self) -> bool:
        """Whether the loop has a model, and not only signals."""
        return LOOP_KINDS[self.loop.kind].identifiable

    @property
    def first_fidelity(self) -> Fidelity:
        """Fidelity of the first search."""
        kind = LOOP_KINDS[self.loop.kind]
        return "reduced" if kind.identifiable and kind.has_reduced_test else "plant"

    @cached_property
    def ranges(self) -> Ranges:
        """Ranges of the conditions that the Monte Carlo draws."""
        return drawn_ranges(self.spec, self.loop)

    @cached_property
    def draws(self) -> list[Conditions]:
        """Conditions of the runs of the Monte Carlo; none if the study has no Monte Carlo."""
        runs = self.spec.robustness.runs
        return draw_conditions(self.ranges, runs=runs, seed=self.spec.seed) if self.ranges and runs else []

    @property
    def _sample(self) -> list[Conditions]:
        """Draws in which the reduced model estimates the cost of gains; none without a reduced model."""
        return self.draws[:SAMPLE] if self.first_fidelity == "reduced" else []

    def cost_in_runs(self, candidate: Candidate) -> float:
        """Return the cost by which candidates are ranked, as :class:`mirdrake.tuning.screening.InRuns` does."""
        ratio = cost_ratio(LoopEvaluator(self.loop), candidate.design.gains, self._sample, self.spec.cost)
        return candidate.trial.cost * ratio

    @property
    def hardest(self) -> list[Conditions]:
        """Draws that are most likely to fail."""
        return hardest(self.draws)

    @property
    def constraints(self) -> dict[str, float]:
        """Constraints of the study, and a delay margin with a reserve for the delays of the Monte Carlo.

        A loop with feed-forward of the set-point's slope follows the set-point with its dead time, so that it moves on
        by slope × dead time after the end of a ramp, whatever its gains. If the study has no constraints of its own,
        this is added to the limit of the overshoot.
        """
        # Where no margin is known, limits of margins cannot be checked.
        if self.loop.period is None:
            return {name: limit for name, limit in self.spec.constraints.items() if name not in MARGINS}
        # The nominal delay is part of the loop already: only the increase has to be covered by the margin.
        increase = LOOP_KINDS[self.loop.kind].delays(self.spec)[1] - self.loop.delay
        asked = {"delay_margin_s": RESERVE * increase} if increase > 0.0 and self.spec.robustness.runs else {}
        limits = asked | dict(self.spec.constraints)
        if self.manoeuvres:
            limits[OVER_PRESENT] = MOST_OVER_PRESENT
        # Default limits get the unavoidable overshoot of the feed-forward; limits of the user stay.
        model, step = self.loop.model, self.loop.course.step
        if model is not None and model.feedforward and "constraints" not in self.spec.model_fields_set:
            slope = model.rise if step > 0.0 else model.fall
            limits["overshoot_percent"] += 100.0 * slope * model.plants["main"].delay / abs(step)
        return limits

    @property
    def model_constraints(self) -> dict[str, float]:
        """Constraints for a search, in which margins of the model are larger than those that the plant must have."""
        return {
            name: limit / self.margin_ratios.get(name, 1.0) if name in AT_LEAST else limit
            for name, limit in self.constraints.items()
        }

    def test(self, designs: Sequence[Design], stage: str) -> tuple[Candidate, ...]:
        """Test designs on the plant; the candidates have their responses."""
        calls = [(design.gains, NOMINAL) for design in designs]
        done = list(self.evaluate(LoopEvaluator(self.loop, keep=True), calls, stage))
        return tuple(self.candidate(design, done[index], index) for index, design in enumerate(designs))

    def evaluate(
        self, evaluate: LoopEvaluator, calls: Sequence[tuple[Mapping[str, float], Conditions]], stage: str
    ) -> Generator[Evaluation, None, None]:
        """Test gains under conditions on the plant; yield the evaluations in their order.

        The tests after the last evaluation that is asked for may not be made.
        """
        # Results come in the order of completion; they are kept until their turn.
        done: dict[int, Evaluation] = {}
        following = 0
        tests = ((gains, conditions, "plant") for gains, conditions in calls)
        # Closing the generators early cancels the tests that are not asked for.
        with (
            open_executor(self.executor, self.workers, calls=len(calls), limit=LIMIT) as (runner, ahead),
            closing(call_all(runner, evaluate, tests, ahead=ahead)) as results,
        ):
            for index, given in results:
                done[index] = Evaluation("failed", reason=given.reason) if isinstance(given, Lost) else given
                self.progress(stage, len(done), len(calls), math.nan)
                while following in done:
                    yield done[following]
                    following += 1

    def candidate(self, design: Design, evaluation: Evaluation, number: int = 0) -> Candidate:
        """Return the candidate of an evaluated design."""
        if self.manoeuvres and evaluation.status == "ok":
            evaluation = replace(evaluation, figures={**evaluation.figures, OVER_PRESENT: self.over_present(design)})
        trial = make_trial(number, design.gains, evaluation, self.spec.cost, self.constraints)
        return Candidate(design, trial, evaluation.response)

    def search(
        self,
        space: Space,
        fidelity: Fidelity,
        starts: Sequence[dict[str, float]],
        stage: str,
        *,
        loop: LoopSpec | None = None,
        scenarios: Sequence[Conditions] = (),
    ) -> Trials:
        """Search gains on the reduced model by the method of the study, or on the plant.

        Args:
            space: ranges of the gains.
            fidelity: reduced or plant.
            starts: gains to begin with.
            stage: its name, and that of its journal.
            loop: instead of the study's.
            scenarios: conditions under which gains that meet the constraints must be stable.

        Raises:
            StoppedError: Ctrl-C.
        """
        spec, reduced = self.spec, fidelity == "reduced"
        # The number of trials for the cheap model, or for the plant where it is the first stage; fewer for the others.
        trials = spec.search.trials or TRIALS[fidelity]
        count = trials if reduced or stage == "search" else spec.search.confirm
        count = count // NEAR if stage == "search-near" else count
        # The method of the study is for the first search; on the plant trials are few and start from known gains.
        method = spec.search.method if reduced else "tpe"
        constraints = self.model_constraints
        # Gains whose margins are too small on the model are not worth a test on the plant.
        margins = {name: limit for name, limit in constraints.items() if name in MARGINS}
        evaluate: Evaluator = LoopEvaluator(loop or self.loop, margins=margins)
        cost = spec.cost
        if self._sample and method != "nsga2":  # which has an objective per figure of the cost
            evaluate, cost = InRuns(evaluate, tuple(self._sample), spec.cost), {COST: 1.0}
        if self.manoeuvres:
            evaluate = InManoeuvres(evaluate, self.manoeuvres, self.present_costs)
        if scenarios and not reduced:
            # Constraints first, then scenarios: an infeasible trial needs no further tests.
            evaluate = InScenarios(evaluate, tuple(scenarios), constraints)
        # Wheels that would keep slipping show on a model that takes a hundredth of the time of the plant.
        if self._slips_on is not None:
            evaluate, constraints = (
                InSlip(evaluate, self._slips_on, self.loop, tuple(scenarios)),
                constraints | {SLIP: MOST_SLIP},
            )
        outcome = search(
            evaluate,
            {name: entry.parameter() for name, entry in space.items()},
            method=method,
            trials=max(count, 1),
            cost=cost,
            constraints=constraints,
            # At most half of the trials are given, so that the sampler can propose the others; other methods take no
            # starts.
            start=starts[: max(count // 2, 1)] if method in ("tpe", "cma", "nsga2") else (),
            seed=spec.seed,
            fidelity=fidelity,
            executor=self.executor,
            workers=self.workers,
            store=self.folder / f"{stage}.jsonl",
            purpose={"study": self.key, "scenarios": [repr(scenario) for scenario in scenarios]},
            progress=lambda done, total, left: self.progress(stage, done, total, left),
        )
        # Incomplete searches are in the journal and resume with the next call.
        if not outcome.complete:
            raise StoppedError
        return outcome

    def test_at_finer_step(self, design: Design) -> Candidate | None:
        """Test a design at a finer step of the plant; None if a diagram of the user's has the step."""
        if not LOOP_KINDS[self.loop.kind].has_own_plant:
            return None
        return self.candidate(design, LoopEvaluator(at_finer_step(self.loop))(design.gains))

    @cached_property
    def manoeuvres(self) -> tuple[Manoeuvre, ...]:
        """Manoeuvres in which gains are compared with the present control.

        None without a model, or without slopes of the set-point. Present gains are compared with whatever the baseline;
        a servo only if it is the baseline. Both controllers have the same dead time, and a servo has none.
        """
        loop, own = self.loop, self.own_slopes
        if own is None or loop.model is None or not loop.has_pid_gains:
            return ()
        if not any(loop.present.values()) and self.spec.baseline != "present":
            return ()
        delays = sorted({direct(loop).delay or 0.0, *([loop.delay] if any(loop.present.values()) else [])})
        return make_manoeuvres(loop, own, delays, LOOP_KINDS[loop.kind].at_slopes)

    @cached_property
    def present_costs(self) -> tuple[float, ...]:
        """Costs of the present control in the manoeuvres; a servo has no reduced model, so that it is driven."""
        if any(self.loop.present.values()):
            return manoeuvre_costs(self.manoeuvres, self.loop.present)
        return plant_costs(self.manoeuvres, lambda loop: LoopEvaluator(loop, keep=True)({}))

    def over_present(self, design: Design) -> float:
        """Return the largest ratio of the IAE of a design to that of the present gains in a manoeuvre [1]."""
        # Without gains of its own, a design is the present control.
        costs = manoeuvre_costs(self.manoeuvres, design.gains) if design.gains else self.present_costs
        return largest_ratio(costs, self.present_costs)

    @cached_property
    def own_slopes(self) -> LoopSpec | None:
        """Loop whose test has the vehicle's own slopes of the set-point; None if the loop's set-point has none."""
        return LOOP_KINDS[self.loop.kind].at_own_slopes(self.loop)

    @property
    def _slips_on(self) -> LoopSpec | None:
        """Loop of the test on the slip model; None without one, or with gains that are not those of a PID."""
        own = self.own_slopes
        has_model = own is not None and own.model is not None and own.model.slip is not None
        return own if has_model and self.loop.has_pid_gains else None

    def test_slip(self, design: Design) -> Evaluation | None:
        """Test a design on the slip model, with the vehicle's own slopes; None if the loop has no such model."""
        if self._slips_on is None or not design.gains:
            return None
        reason = fault_on_own_slopes(self._slips_on, design.gains)
        return Evaluation("unstable", reason=f"slip model: {reason}") if reason else Evaluation("ok")

    def test_on_own_slopes(self, design: Design) -> Evaluation | None:
        """Test a design with the vehicle's own slopes of the set-point; None if the loop's set-point has none."""
        loop = self.own_slopes
        if loop is None:
            return None
        evaluate = LoopEvaluator(loop)
        nominal = evaluate(design.gains)
        if nominal.status != "ok" or loop.model is None:
            return nominal
        shortest = evaluate(design.gains, direct(loop))
        return nominal if shortest.status == "ok" else replace(shortest, reason=f"without dead time: {shortest.reason}")

    def followed_slopes(self, design: Design) -> dict[str, float]:
        """Return the largest slopes of the set-point that a design follows on the slip model, by key of control.yaml.

        Slopes of the vehicle that it follows are left out.
        """
        if self._slips_on is None or not design.gains:
            return {}
        return LOOP_KINDS[self.loop.kind].followed_slopes(self.loop, design.gains)

    def with_causes(self, rejection: Rejection, design: Design) -> Rejection:
        """Return a rejection by a run of the Monte Carlo with the conditions that cause it.

        A condition is a cause if the design is stable in the run with this condition, and no other one, nominal.
        """
        draw = rejection.conditions
        if draw is None:
            return rejection
        changed = {
            name: replace(draw, **{name: getattr(NOMINAL, name)})
            for name in self.ranges
            if getattr(draw, name) != getattr(NOMINAL, name)
        }
        results = self.evaluate(LoopEvaluator(self.loop), [(design.gains, one) for one in changed.values()], "causes")
        causes = [name for name, result in zip(changed, results, strict=True) if result.status == "ok"]
        return replace(rejection, needs={name: float(getattr(draw, name)) for name in causes})

    def confirm_margins(self, candidate: Candidate) -> tuple[tuple[MarginCheck, ...], tuple[Rejection, ...]]:
        """Confirm gain and delay margin of a candidate on the plant; return also a rejection for each broken limit."""
        if not self.identifiable:
            return (), ()
        # The baseline may have no gains of its own: then those of the vehicle.
        gains, loop = candidate.design.gains or self.loop.present, self.loop
        checks: tuple[MarginCheck, ...] = ()
        if gains:
            evaluator, figures = LoopEvaluator(loop, keep=True), dict(candidate.trial.figures)
            # The gain margin is driven with all gains times a factor, which only for a PID is the gain of the loop.
            if not loop.has_pid_gains:
                figures.pop("gain_margin", None)
            checks = confirm_margins(
                lambda calls: list(self.evaluate(evaluator, calls, "margins")),
                gains,
                figures,
                delay=loop.delay,
                step=loop.course.step,
            )
        broken = tuple(
            Rejection("margin", check.name, check.claimed, self.constraints[check.name])
            for check in checks
            if check.name in self.constraints and breaks_limit(check.name, check.claimed, self.constraints[check.name])
        )
        return checks, broken

    def first_failure(self, gains: Mapping[str, float], scenarios: Sequence[Conditions]) -> Rejection | None:
        """Return the first of some scenarios in which gains are not stable; None if they are in all."""
        calls = [(gains, scenario) for scenario in scenarios]
        made = self.scenarios.setdefault(self._test_key(gains), {})
        # Stops at the first failure; closing cancels the tests that follow.
        with closing(self.evaluate(LoopEvaluator(self.loop), calls, "scenarios")) as results:
            for scenario, result in zip(scenarios, results, strict=True):
                made[scenario] = result
                if result.status != "ok" and not self.is_unstable_now(scenario):
                    return Rejection("scenario", conditions=scenario, reason=result.reason)
        return None

    def is_unstable_now(self, draw: Conditions) -> bool:
        """Return whether the present control of the vehicle is unstable in a draw, too, and is the baseline.

        Gains are not rejected for such a draw: they are not worse there, and usually nothing is stable.
        """
        if self.spec.baseline != "present" or draw not in self.draws:
            return False
        key = (self.loop.time_step, draw)
        if key not in self.unstable_now:
            gains = baseline_gains(self.spec, self.loop)
            self.unstable_now[key] = LoopEvaluator(self.loop)(gains, draw).status == "unstable"
        return self.unstable_now[key]

    def unstable_runs(self, table: pd.DataFrame) -> list[int]:
        """Return the runs of a table that are not stable, without those in which the present control is not either."""
        failed = table.loc[table["status"] != "ok", "run"].astype(int).tolist()
        return [run for run in failed if not self.is_unstable_now(self.draws[run])]

    def _test_key(self, gains: Mapping[str, float]) -> tuple[float, ...]:
        return (self.loop.time_step, *(float(value) for value in gains.values()))

    def failed_runs(self, candidate: Candidate) -> tuple[Rejection, ...]:
        """Return a rejection for each run of the Monte Carlo that fails, until one of :data:`BATCH` runs has failed.

        Runs in which the present control is unstable as well do not count: see :meth:`is_unstable_now`. The runs that
        are most likely to fail come first.

        Raises:
            StoppedError: Ctrl-C.
        """
        if not self.draws:
            return ()
        name, total = candidate.name, len(self.draws)
        gains = {name: candidate.design.gains}
        hard, count = {self.draws.index(draw) for draw in self.hardest}, total
        if self.first_fidelity == "reduced":
            model = self._runs("reduced", gains).table
            hard, count = self._hard_runs(model, candidate.design.gains), min(SAMPLE, total)
        order = [*sorted(hard), *(run for run in range(count) if run not in hard)]
        for end in range(BATCH, len(order) + BATCH, BATCH):
            table = self._runs("plant", gains, {name: order[:end]}).table
            if self.unstable_runs(table):
                break
        else:
            # The plant makes further runs if the model does not rank these as the plant does.
            finished = self.monte_carlo([candidate])
            table = table if finished is None else finished.rows(name)
        failed = table[table["run"].isin(self.unstable_runs(table))]
        return tuple(
            Rejection("monte_carlo", run=run, conditions=self.draws[run], reason=str(reason), made_runs=len(table))
            for run, reason in zip(failed["run"].astype(int).tolist(), failed["reason"], strict=True)
        )

    def failures_in(self, design: Design, draws: Sequence[Conditions]) -> tuple[Rejection, ...]:
        """Return a rejection for each of some draws of the Monte Carlo in which a design is not stable on the plant."""
        if not draws:
            return ()
        results = self.evaluate(LoopEvaluator(self.loop), [(design.gains, draw) for draw in draws], "baseline")
        return tuple(
            Rejection("monte_carlo", run=self.draws.index(draw), conditions=draw, reason=result.reason)
            for draw, result in zip(draws, results, strict=True)
            if result.status != "ok"
        )

    def monte_carlo(
        self, candidates: Sequence[Candidate], *, pairs: Sequence[tuple[str, str]] = ()
    ) -> MonteCarlo | None:
        """Run the Monte Carlo with candidates; None if the study has none.

        The plant makes the runs of :mod:`mirdrake.tuning.screening`, the reduced model the others. The plant makes all
        runs of a loop without a reduced model, and of a candidate whose runs the model does not rank as the plant does;
        of a candidate without a model as many as decide the medians of its pairs.

        Args:
            candidates: to run.
            pairs: names of candidates that are compared with each other.

        Raises:
            StoppedError: Ctrl-C.
        """
        # Without ranges of variation there is nothing to draw.
        if not self.draws:
            return None
        gains = {candidate.name: candidate.design.gains for candidate in candidates}
        total = len(self.draws)
        models: dict[str, pd.DataFrame] = {}
        sampled = dict.fromkeys(gains, total)
        if self.first_fidelity == "reduced":
            # Present controllers that are not PID have no model, and no runs that are known to be hard.
            models = {name: self._runs("reduced", {name: entry}).table for name, entry in gains.items() if entry}
            sampled = dict.fromkeys(gains, min(SAMPLE, total))
        hard = {name: self._hard_runs(rows, gains[name]) for name, rows in models.items()}
        while True:
            selected = {name: sorted({*range(count), *hard.get(name, ())}) for name, count in sampled.items()}
            plant = self._runs("plant", gains, selected)
            checks = {name: check_ranks(rows, plant.rows(name), self.spec.cost) for name, rows in models.items()}
            more = dict.fromkeys((name for name, check in checks.items() if not check.is_trusted), total)
            # The model gives all runs of a candidate; without one, a sample of runs on the plant has to decide.
            for pair in (pair for pair in pairs if not set(pair) <= set(models)):
                ratios = replace(plant, sampled=sampled).ratios(*pair, self.spec.cost)
                more |= {name: 2 * sampled[name] for name in pair if len(ratios) and not is_decided(ratios)}
            grown = {name: min(max(count, more.get(name, 0)), total) for name, count in sampled.items()}
            if grown == sampled:
                break
            sampled = grown
        # The model stands for the runs that the plant did not make.
        others = [rows[~rows["run"].isin(selected[name])] for name, rows in models.items()]
        table = pd.concat([part for part in (plant.table, *others) if len(part)], ignore_index=True)
        places = {name: place for place, name in enumerate(gains)}
        table = table.iloc[np.lexsort([table["run"], table["candidate"].map(places)])].reset_index(drop=True)
        correlation = {name: check.correlation for name, check in checks.items() if len(selected[name]) < total}
        sampled |= dict.fromkeys(models, total)
        return replace(plant, table=table[plant.table.columns], sampled=sampled, correlation=correlation)

    def _hard_runs(self, model: pd.DataFrame, gains: Mapping[str, float]) -> set[int]:
        """Return the runs of the Monte Carlo that are most likely to fail, also those in which the slip model does.

        Args:
            model: runs of the reduced model.
            gains: of the candidate.
        """
        runs = choose_runs(model, self.draws, self.spec.cost, grip=self._grip)
        if self._slips_on is None:
            return runs
        slipping = (
            run for run, draw in enumerate(self.draws) if run_slip(self.loop, gains, draw, keep=False).status != "ok"
        )
        return runs | set(islice(slipping, WORST))

    def _runs(
        self,
        fidelity: Fidelity,
        gains: Mapping[str, Mapping[str, float]],
        selected: Mapping[str, Sequence[int]] | None = None,
    ) -> MonteCarlo:
        """Make runs of the Monte Carlo on the reduced model or on the plant, all or those selected by candidate."""
        on_plant = fidelity == "plant"
        stage = "robustness" if on_plant else "screening"
        outcome = run_monte_carlo(
            LoopEvaluator(self.loop),
            gains,
            self.ranges,
            runs=self.spec.robustness.runs,
            seed=self.spec.seed,
            fidelity=fidelity,
            executor=self.executor if on_plant else None,
            workers=self.workers if on_plant else 0,
            store=self.folder / ("monte_carlo.jsonl" if on_plant else "screening.jsonl"),
            purpose={"study": self.key},
            progress=lambda done, count, left: self.progress(stage, done, count, left),
            selected=selected,
            known={name: self.scenarios.get(self._test_key(entry), {}) for name, entry in gains.items()}
            if on_plant
            else {},
        )
        if not outcome.complete:
            raise StoppedError
        return outcome

    @cached_property
    def _grip(self) -> Floats | None:
        """Force per mass that the driven tyres provide in each draw [m/s²]; None if the loop needs none."""
        if not LOOP_KINDS[self.loop.kind].uses_traction:
            return None
        axles = axles_of(plant_bench(self.loop))
        friction = [self.loop.friction if draw.friction is None else draw.friction for draw in self.draws]
        return np.array([axles.largest(mu or 0.0, draw.grade) for mu, draw in zip(friction, self.draws, strict=True)])

    def map(self, space: Space, winner: Candidate) -> pd.DataFrame | None:
        """Return cost and stability over the first two gains, on the reduced model; None without a model."""
        # The map needs many evaluations, thus the model.
        if len(space) < 2 or self.first_fidelity != "reduced":
            return None
        ranges = map_space(space, winner.design.gains, winner.trial.figures.get("gain_margin", math.nan))
        evaluate: Evaluator = LoopEvaluator(self.loop)
        if self.manoeuvres:
            evaluate = InManoeuvres(evaluate, self.manoeuvres, self.present_costs)
        return map_of_two_gains(
            evaluate,
            {name: entry.parameter() for name, entry in ranges.items()},
            cost=self.spec.cost,
            constraints=self.constraints,
            count=MAP,
            fixed={name: value for name, value in winner.design.gains.items() if name not in ranges},
            fidelity="reduced",
            store=self.folder / "map.jsonl",
            purpose={"study": self.key},
            progress=lambda done, total, left: self.progress("map", done, total, left),
        )


def at_finer_step(loop: LoopSpec) -> LoopSpec:
    """Return a loop at a finer step of the plant: that of a diagram that names none, or half of its own if smaller.

    A long step damps what it does not resolve. Wheels that lose their grip for a moment are light, and gains that suit
    the car may make them spin; at a long step that does not show.
    """
    step = min(PlantSpec().time_step, 0.5 * loop.time_step)
    return replace(loop, diagram={**loop.diagram, "plant": {**loop.diagram["plant"], "time_step": step}})
