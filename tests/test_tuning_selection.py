"""Choice of the best candidate: hard conditions, slipping wheels, use of grip, rules that are not robust."""

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mirdrake.core.pid import PidGains
from mirdrake.report.tuning_tables import Tables
from mirdrake.report.tuning_texts import Texts
from mirdrake.tuning.acceptance import Criterion, StepEffect
from mirdrake.tuning.designs import (
    DESIGN_RULES,
    SLOW,
    Design,
    DesignModel,
    DesignRule,
    Solution,
    make_designs,
    slower_designs,
)
from mirdrake.tuning.grip import axles_of, grip_use
from mirdrake.tuning.identify import Identification
from mirdrake.tuning.loops.base import NOMINAL, Conditions, Evaluation, LoopModel, LoopSpec
from mirdrake.tuning.loops.evaluate import LoopEvaluator, plant_bench
from mirdrake.tuning.loops.registry import LOOP_KINDS, make_loop_spec
from mirdrake.tuning.loops.speed import SETTLING
from mirdrake.tuning.models import Integrator
from mirdrake.tuning.robustness import CandidateRobustness, FailureRate, Robustness, draw_conditions
from mirdrake.tuning.scenarios import InScenarios, corners, hardest
from mirdrake.tuning.selection import (
    POOL,
    Knowledge,
    RejectedTrial,
    beats_rule,
    better_of,
    choose_best,
    choose_rule,
    complete_checks,
    verify,
    verify_baseline,
)
from mirdrake.tuning.spec import load_tuning
from mirdrake.tuning.stages import Candidate, at_finer_step
from mirdrake.tuning.tables import trials_table
from mirdrake.tuning.trials import Rejection, Trial, Trials
from mirdrake.vehicles.traction import Axles
from tests.tuning_sample import short_result

ROOT = Path(__file__).parents[1]
G = 9.80665


@pytest.fixture(scope="module")
def bolt() -> LoopSpec:
    return make_loop_spec(load_tuning(ROOT / "studies/bolt_speed.yaml"))


@pytest.mark.parametrize("driven", ["front", "rear"])
@pytest.mark.parametrize(("grade", "backward"), [(0.08, False), (-0.08, True)])
def test_the_force_of_an_axle_is_limited_by_its_load(driven: str, grade: float, backward: bool) -> None:
    """Both loads and the push from the balance of forces and of moments about the rear contact."""
    to_front, to_rear, height, mu, sign = 1.2, 1.4, 0.5, 0.3, -1.0 if backward else 1.0
    axles = Axles(to_front, to_rear, height, front=driven == "front", rear=driven == "rear")
    pushes = [0.0, 0.0]
    pushes[0 if driven == "front" else 1] = sign * mu
    balance = np.array(  # unknown per mass: load in front, load behind, s = a + g sin θ
        [[1.0, 1.0, 0.0], [*pushes, -1.0], [to_front + to_rear, 0.0, height]]
    )
    weight = G * math.cos(grade)
    _, _, most = np.linalg.solve(balance, [weight, 0.0, weight * to_rear])
    assert axles.largest(mu, grade, backward=backward) == pytest.approx(abs(most), rel=1e-12)
    assert axles.use(mu, grade, 0.0) == pytest.approx(G * math.sin(0.08) / abs(most), rel=1e-9)


def test_all_wheels_together_use_the_whole_weight() -> None:
    axles = Axles(1.2, 1.4, 0.5, front=True, rear=True)
    assert axles.use(0.5, 0.0, 0.5 * G) == pytest.approx(1.0)


def test_the_bolt_climbs_up_to_the_limit_of_its_front_axle(bolt: LoopSpec) -> None:
    axles, grade, evaluate = axles_of(plant_bench(bolt)), 0.08, LoopEvaluator(bolt)
    assert axles.to_front + axles.to_rear == pytest.approx(2.601, abs=0.002)
    soft = {"kp": 200.0, "ki": 100.0, "kd": 0.0}
    uses = {}
    for friction in (0.45, 0.15):
        conditions = Conditions(friction=friction, grade=grade)
        evaluation = evaluate(soft, conditions)
        uses[friction] = grip_use(axles, bolt, conditions)
        able = evaluation.status == "ok" and evaluation.figures["iae"] < 8.0
        assert able == (uses[friction] < 1.0)
    assert uses[0.45] < 0.7
    assert uses[0.15] > 1.3


def test_a_run_with_wheels_that_keep_slipping_is_unstable(bolt: LoopSpec) -> None:
    """The tyres can transmit 1.5 times the demand; the slip of the wheels oscillates until standstill."""
    lost = Conditions(mass=0.810571, friction=0.387201, delay=0.080918, grade=0.074670)
    assert grip_use(axles_of(plant_bench(bolt)), bolt, lost) < 0.7
    evaluate = LoopEvaluator(bolt)
    evaluation = evaluate({"kp": 511.9, "ki": 1149.0, "kd": 8.425}, lost)
    assert evaluation.status == "unstable"
    assert "wheel oscillates" in evaluation.reason
    assert evaluate({"kp": 150.0, "ki": 50.0, "kd": 0.0}, lost).status == "ok"


def test_gains_that_fail_in_a_scenario_are_unstable_with_its_conditions_as_reason() -> None:
    calls: list[Conditions] = []

    def evaluate(gains: Any, conditions: Conditions = NOMINAL, fidelity: Any = "plant") -> Evaluation:
        calls.append(conditions)
        if gains["kp"] > 2.0 and conditions.delay is not None:
            return Evaluation("unstable", reason="oscillates")
        return Evaluation("ok", {"iae": 1.0, "ms": gains["kp"]})

    late = Conditions(mass=0.8, delay=0.1, grade=0.05)
    tries = InScenarios(evaluate, (late,), {"ms": 3.0})
    assert tries({"kp": 1.0}).figures == {"iae": 1.0, "ms": 1.0}
    assert tries({"kp": 2.5}).reason == "mass × 0.80, delay 100 ms, grade 2.9°: oscillates"
    calls.clear()
    assert tries({"kp": 4.0}).status == "ok"  # breaks a constraint: the scenario is not tested
    assert calls == [NOMINAL]


def test_the_hardest_draws_have_long_delays_or_little_friction() -> None:
    ranges = {"mass": (0.8, 1.2), "friction": (0.3, 1.0), "delay": (0.0, 0.1), "grade": (-0.08, 0.08)}
    first = hardest(draw_conditions(ranges, runs=50, seed=0))
    assert 6 <= len(first) <= 12
    assert all((draw.delay or 0.0) > 0.08 or (draw.friction or 1.0) < 0.45 for draw in first)
    places = corners(ranges)
    assert {(draw.mass, draw.delay, draw.grade) for draw in places} == {
        (0.8, 0.1, -0.08), (1.2, 0.1, 0.08), (0.8, 0.0, 0.08), (1.2, 0.0, -0.08),
    }  # fmt: skip
    assert {draw.friction for draw in places} == {0.3}


class _Stages:
    """Stages without a plant: gains above a bound fail in run 3, above others at a finer step and on slopes."""

    constraints: dict[str, float] = {}  # noqa: RUF012
    hardest: tuple[Conditions, ...] = ()
    manoeuvres = ()
    spec = SimpleNamespace(cost={"iae": 1.0})

    def __init__(self, bound: float, *, finer: float = math.inf, steep: float = math.inf) -> None:
        self.bound, self.finer, self.steep = bound, finer, steep
        self.draws = draw_conditions({"delay": (0.0, 0.1)}, runs=5, seed=0)
        self.tested: list[str] = []

    def failed_runs(self, candidate: Candidate) -> tuple[Rejection, ...]:
        self.tested.append(candidate.name)
        if candidate.design.gains["kp"] <= self.bound:
            return ()
        return (Rejection("monte_carlo", run=3, conditions=self.draws[3], reason="oscillates", made_runs=4),)

    def failures_in(self, design: Design, draws: list[Conditions]) -> tuple[Rejection, ...]:
        if design.gains["kp"] <= self.bound:
            return ()
        return tuple(
            Rejection("monte_carlo", run=self.draws.index(draw), conditions=draw, reason="oscillates") for draw in draws
        )

    def followed_slopes(self, design: Design) -> dict[str, float]:
        return {"max_acceleration": self.steep}

    def with_causes(self, rejection: Rejection, design: Design) -> Rejection:
        return replace(rejection, needs={"delay": self.draws[3].delay or 0.0})

    def cost_in_runs(self, candidate: Candidate) -> float:
        return candidate.trial.cost

    def confirm_margins(self, candidate: Candidate) -> tuple[tuple[()], tuple[()]]:
        return (), ()

    def first_failure(self, gains: dict[str, float], scenarios: Any) -> None:
        return None

    def test_slip(self, design: Design) -> None:
        return None

    def test_on_own_slopes(self, design: Design) -> Evaluation:
        return Evaluation("unstable", reason="slips") if design.gains["kp"] > self.steep else Evaluation("ok")

    def test_at_finer_step(self, design: Design) -> Candidate:
        unstable = design.gains["kp"] > self.finer
        candidate = made(design.name, design.gains["kp"], kind=design.kind)
        trial = replace(candidate.trial, status="unstable", reason="oscillates") if unstable else candidate.trial
        return replace(candidate, trial=trial)

    def test(self, designs: list[Design], stage: str) -> tuple[Candidate, ...]:
        return tuple(made(candidate.name, candidate.gains["kp"], kind=candidate.kind) for candidate in designs)


def made(name: str, kp: float, *, kind: Any = "rule") -> Candidate:
    """Return a candidate whose cost decreases with its gain."""
    return Candidate(Design(name, kind, {"kp": kp}), Trial(0, {"kp": kp}, "ok", {"iae": 1.0 / kp}, 1.0 / kp, 0.0))


def searched(*gains: float) -> Trials:
    trials = (Trial(index, {"kp": kp}, "ok", {"iae": 1.0 / kp}, 1.0 / kp, 0.0) for index, kp in enumerate(gains))
    return Trials(tuple(trials), ("kp",), {"iae": 1.0})


BASE, FAST, SLOWER, MIDDLE = (
    made("baseline", 0.1, kind="baseline"),
    made("fast", 4.0),
    made("slow", 1.0),
    made("mid", 2.0),
)


def test_a_rule_that_fails_in_a_run_is_rejected_with_the_run_as_reason() -> None:
    stages: Any = _Stages(bound=3.0)
    choice = choose_rule(stages, [BASE, FAST, SLOWER, MIDDLE], ())
    assert choice.rule is MIDDLE
    assert choice.rejected == (FAST,)
    assert choice.known.hard == (stages.draws[3],)
    best, known = choose_best(stages, choice.known, [BASE, FAST, SLOWER, MIDDLE], [searched(3.5, 2.5, 2.2)])
    assert best is not None
    assert best.design.gains == {"kp": 2.5}
    assert [(trial.gains, trial.rejections[0].run) for trial in known.rejected] == [({"kp": 3.5}, 3)]
    assert beats_rule(stages, known, best, choice.rule)[0]
    rejection = Rejection("monte_carlo", run=3, conditions=stages.draws[3], reason="oscillates", made_runs=4)
    assert known.verified["fast"].rejections == (rejection,)
    assert stages.tested.count("fast") == 1  # results of checks are kept
    text = Texts(short_result("unior")).rejections((rejection,))
    assert text.startswith("not stable in 1 run of the Monte Carlo, first in run 3 (delay ")
    result = short_result("unior")
    text = Texts(replace(result, spec={**result.spec, "robustness": {"runs": 100}})).rejections((rejection,))
    assert text.endswith("; rejected after 4 of 100 runs")


def test_where_no_rule_is_robust_the_fastest_robust_slower_one_is_compared_with() -> None:
    stages: Any = _Stages(bound=0.9, finer=0.7)
    slower = [Design(f"slower {kp}", "rule", {"kp": kp}) for kp in (0.95, 0.8, 0.6, 0.4)]
    choice = choose_rule(stages, [BASE, FAST, SLOWER], slower)
    assert choice.rule is not None
    assert choice.rule.name == "slower 0.6"  # 0.95 fails in a run, 0.8 at a finer step
    assert choice.added == (choice.rule,)
    assert choice.rejected == (FAST, SLOWER)
    best, known = choose_best(stages, choice.known, [BASE, FAST, SLOWER, choice.rule], [searched(0.65)])
    assert best is not None
    assert beats_rule(stages, known, best, choice.rule)[0]


@pytest.mark.parametrize("on_slip_model", [False, True])
def test_rules_that_have_failed_do_not_keep_trials_of_the_search_from_their_turn(*, on_slip_model: bool) -> None:
    """Twenty rules cost less than the trial and fail, in the Monte Carlo or on the slip model."""
    stages: Any = _Stages(bound=3.0)
    if on_slip_model:
        stages.test_slip = lambda design: Evaluation("unstable" if design.gains["kp"] > 3.0 else "ok", reason="slips")
    rules = [made(f"rule {number}", 3.5 + number) for number in range(20)]
    choice = choose_rule(stages, [BASE, *rules], ())
    assert len(choice.known.verified) == (20 if on_slip_model else POOL)
    # The Monte Carlo of the rules took its share of the checks; what it has left is for the trials.
    tried = rules if on_slip_model else rules[20 - POOL :]
    best, known = choose_best(stages, choice.known, [BASE, *tried], [searched(2.5)])
    assert best is not None
    assert best.design.gains == {"kp": 2.5}
    assert known.verified[best.name].is_robust


@pytest.mark.parametrize(
    ("cost", "median", "chosen"), [(0.9, 0.9, "best"), (1.1, 0.9, "rule"), (0.9, 1.1, "rule"), (1.0, 1.0, "best")]
)
def test_the_best_replaces_a_rule_if_it_costs_no_more_in_the_test_and_in_the_median_run(
    cost: float, median: float, chosen: str
) -> None:
    """Costs of the best over those of the rule."""
    stages: Any = _Stages(bound=3.0)
    stages.monte_carlo = lambda candidates, pairs: SimpleNamespace(median_ratio=lambda *names: median)
    rule, best = made("rule", 1.0), replace(made("best", 1.0), trial=replace(made("best", 1.0).trial, cost=cost))
    known = verify(stages, Knowledge(), rule)[1]
    assert better_of(stages, known, best, rule).name == chosen
    # A rule that is not robust does not replace it.
    fast = made("fast", 4.0)
    known = verify(stages, known, fast)[1]
    assert better_of(stages, known, replace(best, trial=replace(best.trial, cost=9.0)), fast).name == "best"


def test_where_every_candidate_fails_the_nearest_is_chosen_and_does_not_beat_the_rule() -> None:
    stages: Any = _Stages(bound=0.5)
    choice = choose_rule(stages, [BASE, FAST, SLOWER], ())
    assert choice.rule is FAST
    best, known = choose_best(stages, choice.known, [BASE, FAST, SLOWER], [searched(3.5)])
    assert best is FAST
    assert not beats_rule(stages, known, best, choice.rule)[0]


def test_gains_that_oscillate_at_a_finer_step_are_not_robust() -> None:
    stages: Any = _Stages(bound=10.0, finer=2.5)
    choice = choose_rule(stages, [BASE, FAST, SLOWER, MIDDLE], ())
    assert choice.rule is MIDDLE
    assert choice.known.verified["fast"].rejections == (Rejection("finer_step", reason="oscillates"),)
    best, known = choose_best(stages, choice.known, [BASE, FAST, SLOWER, MIDDLE], [searched(3.0, 2.2)])
    assert best is not None
    assert best.design.gains == {"kp": 2.2}
    assert known.lost_at_finer_step
    assert [(trial.gains, trial.rejections[0].check) for trial in known.rejected] == [({"kp": 3.0}, "finer_step")]
    assert beats_rule(stages, known, best, choice.rule)[0]
    assert verify(stages, Knowledge(), best)[0].finer is not None


def test_gains_that_do_not_follow_the_vehicles_own_slopes_are_rejected_before_the_monte_carlo() -> None:
    stages: Any = _Stages(bound=10.0, steep=2.5)
    choice = choose_rule(stages, [BASE, FAST, SLOWER, MIDDLE], ())
    assert choice.rule is MIDDLE
    assert choice.known.verified["fast"].rejections == (Rejection("own_slopes", reason="slips"),)
    assert stages.tested == ["mid"]
    best, known = choose_best(stages, choice.known, [BASE, FAST, SLOWER, MIDDLE], [searched(3.0, 2.2)])
    assert best is not None
    assert best.design.gains == {"kp": 2.2}
    assert known.lost_on_slopes
    text = Texts(short_result("unior")).rejections(known.rejected[0].rejections)
    assert text == "does not follow the vehicle's own slopes of the set-point: slips"


def test_the_baseline_is_tested_in_what_candidates_have_failed() -> None:
    """Candidates fail in run 3 or on the slopes; a baseline with a high gain does, too, and one with a low gain not."""
    stages: Any = _Stages(bound=0.5, steep=2.5)
    choice = choose_rule(stages, [BASE, FAST, SLOWER], ())
    assert {rejection.check for check in choice.known.verified.values() for rejection in check.rejections} == {
        "own_slopes", "monte_carlo",
    }  # fmt: skip
    present = made("baseline", 3.0, kind="baseline")
    check = verify_baseline(stages, choice.known, present, [FAST, SLOWER]).verified["baseline"]
    run = Rejection("monte_carlo", run=3, conditions=stages.draws[3], reason="oscillates")
    assert check.rejections == (run, Rejection("own_slopes", reason="slips"))
    assert verify_baseline(stages, choice.known, BASE, [FAST, SLOWER]).verified["baseline"].is_robust
    assert verify_baseline(stages, Knowledge(), present, [FAST, SLOWER]) == Knowledge()  # nothing has failed


def test_a_study_that_keeps_the_present_gains_states_their_figures_causes_and_remedies() -> None:
    run = Rejection(
        "monte_carlo", run=41, conditions=Conditions(friction=0.39), reason="oscillates", needs={"friction": 0.39}
    )
    slopes = Rejection("own_slopes", reason="a wheel slips", needs={"max_acceleration": 2.4378})
    sharp = Rejection("constraint", "ms", 1.7213, 1.6)
    late = Rejection("constraint", "delay_margin_s", 0.0699, 0.075)
    later = Rejection("margin", "delay_margin_s", 0.0568, 0.075)  # on the plant
    undefined = Rejection("constraint", "ms", None, 1.6)
    result = short_result("unior")
    baseline, rule, best = result.candidates
    failing = replace(
        result,
        spec={"baseline": "present"},
        candidates=(
            replace(baseline, figures={"iae": 0.0867}, rejections=(undefined, run, slopes)),
            replace(rule, rejections=(sharp, late, later, run, slopes)),
            replace(best, figures={"iae": 0.122}),
        ),
        rejected=(RejectedTrial({"kp": 1.0}, 0.1, (slopes,)),),
        acceptance=(Criterion("cheaper_than_baseline", 0.122, 0.0867, met=False),),
        robustness=Robustness(100, 0, {"friction": (0.3, 1.0)}, {}),
    )
    texts = Texts(failing)
    assert "; the present gains are kept" in texts.headline()
    assert texts.after_verdict() == texts.notices()[:3] == [
        "Rejections of 3 candidates by cause: the vehicle's own slopes of the set-point (2), Ms (1), "
        "Delay margin (1), the Monte Carlo (1).",
        f"{rule.name} (cost {rule.cost:.4g}) needs: constraints.ms of 1.73; constraints.delay_margin_s of 0.0568; "
        "robustness.friction without 0.39; speed.max_acceleration of at most 2.43 m/s² in control.yaml.",
        "The present gains fail this, too: does not follow the vehicle's own slopes of the set-point: a wheel slips; "
        "not stable in 1 run of the Monte Carlo, first in run 41 (friction 0.39): oscillates.",
    ]  # fmt: skip
    assert texts.tiles()[0][:2] == ("present kp", "0.460")
    assert ("IAE", "0.0867\u00a0rad", "rejected candidate 0.122\u00a0rad") in texts.tiles()
    assert texts.winner_role == "rejected candidate"
    # The runs that candidates have failed are not a random sample, so that the rate of failures has no interval.
    runs = {"cautious": CandidateRobustness(FailureRate(12, 0, 0.0, 0.0, 0.26), {}, 12)}
    table = Tables(Texts(replace(failing, robustness=Robustness(100, 0, {}, runs))), {}).robustness()
    assert table is not None
    assert (table.rows[0].failed, table.rows[0].interval) == ("0 of 12 in which candidates failed", "–")
    # A run without a single cause, and candidates that all cost more.
    other = replace(
        failing, candidates=(baseline, replace(rule, rejections=(replace(run, needs={}),)), best), rejected=()
    )
    assert "no single condition of run 41 (friction 0.39) is the cause" in Texts(other).after_verdict()[1]
    dear = tuple(replace(one, cost=9.0, rejections=()) for one in (rule, best))
    none = replace(failing, candidates=(baseline, *dear), rejected=())
    assert Texts(none).after_verdict() == ["No candidate costs less than the baseline, whatever the limits."]
    better = replace(failing, acceptance=())
    assert Texts(better).after_verdict() == []
    assert Texts(better).tiles()[0][:2] == ("kp", "3.54")
    assert Texts(better).winner_role == "best"


def test_if_nothing_is_better_all_checks_are_made_of_the_nearest_cheaper_candidates() -> None:
    """Without a plant: the first check that fails rejects, then all are made, with what each would need."""
    stages: Any = _Stages(bound=0.5, steep=1.5, finer=2.5)
    choice = choose_rule(stages, [BASE, FAST, SLOWER], ())
    assert [len(choice.known.verified[name].rejections) for name in ("fast", "slow")] == [1, 1]
    cheap = made("baseline", 9.0, kind="baseline")
    assert complete_checks(stages, choice.known, cheap, [FAST, SLOWER]) == choice.known  # no candidate costs less
    known = complete_checks(stages, choice.known, BASE, [FAST, SLOWER])
    checks = {rejection.check: rejection for rejection in known.verified["fast"].rejections}
    assert set(checks) == {"monte_carlo", "own_slopes", "finer_step"}
    assert checks["own_slopes"].needs == {"max_acceleration": 1.5}
    assert checks["monte_carlo"].needs == {"delay": stages.draws[3].delay}


def test_gains_that_spin_the_wheels_on_the_vehicles_own_slopes_are_unstable(bolt: LoopSpec) -> None:
    """From 1.2 to 12 m/s at 3 m/s², back at 5 m/s²: the force is within the grip, only the loop makes wheels slip."""
    own = LOOP_KINDS[bolt.kind].at_own_slopes(bolt)
    assert own is not None
    course = own.course
    assert (course.speed, course.step) == pytest.approx((1.2, 10.8))
    assert course.return_time == pytest.approx(0.5 + 10.8 / 3.0 + SETTLING)
    assert course.duration == pytest.approx(0.5 + 10.8 / 3.0 + 10.8 / 5.0 + 2.0 * SETTLING)
    evaluate = LoopEvaluator(own, keep=True)
    calm = evaluate({"kp": 200.0, "ki": 100.0, "kd": 0.0})
    assert calm.status == "ok"
    assert calm.response is not None
    slopes = np.diff(calm.response["reference"]) / np.diff(calm.response["t"])
    assert (slopes.min(), slopes.max()) == pytest.approx((-5.0, 3.0), rel=1e-6)
    spinning = evaluate({"kp": 400.0, "ki": 300.0, "kd": 0.0})
    assert spinning.status == "unstable"
    assert "wheel oscillates" in spinning.reason


def test_the_finer_step_is_that_of_a_diagram_or_half_of_its_own(bolt: LoopSpec) -> None:
    assert bolt.diagram["plant"]["time_step"] == 0.005
    coarse = replace(bolt, diagram={**bolt.diagram, "plant": {**bolt.diagram["plant"], "time_step": 0.02}})
    assert at_finer_step(coarse).diagram["plant"] == bolt.diagram["plant"]
    assert at_finer_step(bolt).diagram["plant"] == {**bolt.diagram["plant"], "time_step": 0.0025}


def test_a_notice_states_the_effect_of_a_finer_step() -> None:
    effect = StepEffect(
        0.02, 0.005, {"iae": 1.0, "overshoot_percent": 2.0}, {"iae": 1.2, "overshoot_percent": 3.0}, "ok"
    )
    notices = Texts(replace(short_result("unior"), step_effect=effect)).notices()
    assert notices == [
        "At a plant step of 5 ms instead of 20 ms: IAE 1.20\u00a0rad instead of 1.00\u00a0rad, "
        "Overshoot 3.00\u00a0% instead of 2.00\u00a0%."
    ]
    assert not replace(effect, finer={"iae": 1.01, "overshoot_percent": 3.0}).is_significant
    unstable = replace(effect, status="unstable", reason="a wheel oscillates", finer={})
    notices = Texts(replace(short_result("unior"), step_effect=unstable)).notices()
    assert notices == ["At a plant step of 5 ms instead of 20 ms the best gains are unstable: a wheel oscillates."]


def test_trials_that_break_a_margin_are_evaluated_on_the_reduced_model() -> None:
    def trial(number: int, ms: float) -> Trial:
        return Trial(number, {"kp": 1.0}, "ok", {"iae": 1.0, "ms": ms}, 1.0, max(ms - 1.6, 0.0))

    lost = Trial(2, {"kp": 1.0}, "unstable", {}, math.inf, 10.0)
    coarse = Trials((trial(0, 1.2),), ("kp",), {"iae": 1.0})
    fine = Trials((trial(0, 1.5), trial(1, 1.7), lost), ("kp",), {"iae": 1.0})
    table = trials_table(coarse, [fine], limits={"ms": 1.6, "overshoot_percent": 5.0})
    assert table["fidelity"].tolist() == ["reduced", "plant", "reduced", "plant"]
    assert table["number"].tolist() == [0, 1, 2, 3]


def test_slower_designs_have_longer_closed_loop_times(bolt: LoopSpec) -> None:
    """Skogestad (2003), integrator: kp = 1 / (k (τc + L)), ki = kp / (4 (τc + L)), half a period more in L."""
    loop = replace(bolt, model=LoopModel({"main": Integrator(0.1, 0.05).transfer_function()}))
    identification = Identification(loop, first=Integrator(0.1, 0.05))
    assert bolt.period is not None
    delay = 0.05 + 0.5 * bolt.period
    for times, design in zip(SLOW, slower_designs(identification), strict=True):
        kp = 1.0 / (0.1 * (times + 1.0) * delay)
        expected = {"kp": kp, "ki": kp / (4.0 * (times + 1.0) * delay), "kd": 0.0}
        assert design.gains == pytest.approx(expected, rel=1e-3)
        assert design.name == f"SIMC {times:g}"
    steered = [design.gains for design in slower_designs(replace(identification, lag=0.02))]
    assert all(gains["ki"] == 0.0 and gains["kd"] == pytest.approx(0.02 * gains["kp"], rel=1e-3) for gains in steered)
    undamped = [
        design.gains for design in slower_designs(replace(identification, inertial=(2.0, 0.05)))
    ]  # s² + 2 kd s + 2 kp
    assert all((2.0 * gains["kd"]) ** 2 == pytest.approx(4.0 * 2.0 * gains["kp"], rel=2e-3) for gains in undamped)


def test_a_new_rule_is_one_function_and_one_entry(bolt: LoopSpec, monkeypatch: pytest.MonkeyPatch) -> None:
    def integral_only(model: DesignModel) -> Iterator[Solution]:
        yield "integral 3", 3.0, lambda: PidGains(0.0, 3.0)

    rule = DesignRule("integral", "integral part of {parameter:g} only", integral_only)
    monkeypatch.setitem(DESIGN_RULES, rule.name, rule)
    loop = replace(bolt, model=LoopModel({"main": Integrator(0.1, 0.05).transfer_function()}))
    designs, _ = make_designs(Identification(loop, first=Integrator(0.1, 0.05)), max_sensitivity=1.4)
    assert designs[-1] == Design("integral 3", "rule", {"kp": 0.0, "ki": 3.0, "kd": 0.0}, "integral", 3.0)
    candidate = replace(short_result("bolt").candidates[1], rule="integral", parameter=3.0)
    assert Texts(short_result("bolt")).how(candidate) == "integral part of 3 only"
