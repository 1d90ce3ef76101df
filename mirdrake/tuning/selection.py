"""Choice of the rule to compare with and of the best candidate: the cheapest one that is robust.

A candidate is *robust* if it is stable in every run of the Monte Carlo, at a finer step of the plant and on the
vehicle's own slopes of the set-point. The first check that fails rejects it; the others are not made.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from mirdrake.tuning.confirm import MarginCheck
from mirdrake.tuning.designs import Design, rounded
from mirdrake.tuning.loops.base import Conditions, Evaluation
from mirdrake.tuning.loops.manoeuvres import MOST_OVER_PRESENT
from mirdrake.tuning.spec import printed
from mirdrake.tuning.stages import Candidate, Stages
from mirdrake.tuning.trials import Rejection, Trial, Trials

COMPLETED = 2
"""Candidates for which all checks are made, if nothing is better than the baseline."""

FAR = 1.0
"""Sum of the excesses over limits, relative to them, above which other limits are no remedy for a candidate [1]."""

POOL = 8
"""Checks on the plant that may fail at most before the candidate with the latest failure is chosen."""

HARD = 6
"""Failed draws of other candidates that a search has to pass at most."""


@dataclass(frozen=True)
class Verification:
    """Checks of the robustness of a candidate.

    Attributes:
        failed_runs: rejections by runs of the Monte Carlo, which ends with the first of them.
        slopes: the test on the vehicle's own slopes; None if it was not made.
        finer: the candidate at a finer step of the plant; None if it cannot be tested.
        margins: gain and delay margin as far as the plant confirms them.
        broken: margins of the plant that break their limits.
    """

    failed_runs: tuple[Rejection, ...] = ()
    finer: Candidate | None = None
    margins: tuple[MarginCheck, ...] = ()
    broken: tuple[Rejection, ...] = ()
    slopes: Evaluation | None = None

    @property
    def fails_on_slopes(self) -> bool:
        """Whether it does not follow the vehicle's own slopes of the set-point."""
        return self.slopes is not None and self.slopes.status != "ok"

    @property
    def fails_at_finer_step(self) -> bool:
        """Whether it is not stable at a finer step of the plant."""
        return self.finer is not None and self.finer.trial.status != "ok"

    @property
    def passed_runs(self) -> int:
        """Number of stable runs until it was rejected; 0 if the Monte Carlo was not made."""
        return (self.failed_runs[0].made_runs or 0) - len(self.failed_runs) if self.failed_runs else 0

    @property
    def used_plant(self) -> bool:
        """Whether a check was made on the plant, which takes a hundred times as long as one on the slip model."""
        return self.finer is not None or bool(self.margins or self.failed_runs)

    @property
    def is_robust(self) -> bool:
        """Whether all checks passed."""
        return not self.rejections

    @property
    def rejections(self) -> tuple[Rejection, ...]:
        """Reasons to reject the candidate."""
        reasons = [*self.broken, *self.failed_runs]
        if self.finer is not None and self.fails_at_finer_step:
            reasons.append(Rejection("finer_step", reason=self.finer.trial.reason))
        if self.slopes is not None and self.fails_on_slopes:
            reasons.append(Rejection("own_slopes", reason=self.slopes.reason, needs=self.slopes.figures))
        return tuple(reasons)


@dataclass(frozen=True)
class RejectedTrial:
    """A trial of the search on the plant that meets the constraints, costs less than the best and was rejected.

    Attributes:
        gains: by name, rounded.
        cost: its cost in the test, as that of a candidate. The search ranks trials by their mean cost in several runs.
        rejections: reasons.
    """

    gains: dict[str, float]
    cost: float
    rejections: tuple[Rejection, ...]


@dataclass(frozen=True)
class Knowledge:
    """Results of checks so far; every check returns an extended copy.

    Attributes:
        verified: robustness by name of the candidate.
        hard: draws of the Monte Carlo in which candidates that meet the constraints have failed.
        finer: candidates of the search at a finer step of the plant, by name.
        slopes: their tests on the vehicle's own slopes, by name.
        searched: candidates made of trials of the search.
        rejected: trials of the search that are not candidates.
        lost_at_finer_step: whether a trial was rejected for the finer step.
        lost_on_slopes: whether a trial was rejected on the vehicle's own slopes.
        margin_ratios: margins of the plant over those of the model, of the last candidate that was checked.
    """

    verified: dict[str, Verification] = field(default_factory=dict)
    hard: tuple[Conditions, ...] = ()
    finer: dict[str, Candidate | None] = field(default_factory=dict)
    slopes: dict[str, Evaluation | None] = field(default_factory=dict)
    searched: tuple[Candidate, ...] = ()
    rejected: tuple[RejectedTrial, ...] = ()
    lost_at_finer_step: bool = False
    lost_on_slopes: bool = False
    margin_ratios: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class RuleChoice:
    """The rule to compare with.

    Attributes:
        rule: None if there is no rule.
        rejected: rules that meet the constraints, cost less and are not robust.
        added: slower rules that became candidates.
        known: results of the checks.
    """

    rule: Candidate | None
    rejected: tuple[Candidate, ...]
    added: tuple[Candidate, ...]
    known: Knowledge


def verify(stages: Stages, known: Knowledge, candidate: Candidate) -> tuple[Verification, Knowledge]:
    """Check the robustness of a candidate, unless it is known; the Monte Carlo, which takes longest, is the last check.

    Args:
        stages: of the study.
        known: results so far.
        candidate: to check.
    """
    if candidate.name in known.verified:
        return known.verified[candidate.name], known
    # Slip model, finer step and slopes have been tested if a trial became the candidate.
    tested = candidate.name in known.finer
    # The slip model takes a hundredth of the time of the plant.
    slip = None if tested else stages.test_slip(candidate.design)
    if slip is not None and slip.status != "ok":
        made = Verification(slopes=slip)
        return made, replace(known, verified={**known.verified, candidate.name: made})
    made = Verification(finer=known.finer[candidate.name] if tested else stages.test_at_finer_step(candidate.design))
    if candidate.trial.status == "ok":
        checks, broken = stages.confirm_margins(candidate)
        made = replace(made, margins=checks, broken=broken)
        known = replace(known, margin_ratios=known.margin_ratios | {check.name: check.ratio for check in checks})
    if made.is_robust:
        on_slopes = known.slopes[candidate.name] if tested else stages.test_on_own_slopes(candidate.design)
        made = replace(made, slopes=on_slopes)
    if made.is_robust:
        made = replace(made, failed_runs=stages.failed_runs(candidate))
    # Draws in which this candidate has failed become scenarios of the next search.
    conditions = [failure.conditions for failure in made.failed_runs if failure.conditions is not None]
    new = [draw for draw in conditions if draw not in known.hard]
    return made, replace(known, verified={**known.verified, candidate.name: made}, hard=(*known.hard, *new)[:HARD])


def verify_baseline(stages: Stages, known: Knowledge, baseline: Candidate, tried: Sequence[Candidate]) -> Knowledge:
    """Test the baseline in the robustness checks that candidates have failed, which it did not have to pass.

    These are the vehicle's own slopes of the set-point, and the runs of the Monte Carlo.

    Args:
        stages: of the study.
        known: results of the checks of the candidates.
        baseline: to test.
        tried: candidates that have been tested.
    """
    checks = [known.verified[candidate.name].rejections for candidate in tried if candidate.name in known.verified]
    checks += [trial.rejections for trial in known.rejected]
    failed = [rejection for rejections in checks for rejection in rejections]
    draws = dict.fromkeys(
        rejection.conditions
        for rejection in failed
        if rejection.check in ("monte_carlo", "scenario") and rejection.conditions is not None
    )
    steep = any(rejection.check == "own_slopes" for rejection in failed)
    # A baseline that fails in the test manoeuvre needs no further test.
    if baseline.trial.status != "ok" or not (draws or steep):
        return known
    # The slip model needs gains; the plant has the present controllers if the baseline has none of its own.
    slopes = None
    if steep:
        slopes = stages.test_slip(replace(baseline.design, gains=baseline.design.gains or stages.loop.present))
        if slopes is None or slopes.status == "ok":
            slopes = stages.test_on_own_slopes(baseline.design)
    check = Verification(slopes=slopes, failed_runs=stages.failures_in(baseline.design, [*draws][:HARD]))
    return replace(known, verified={**known.verified, baseline.name: check})


def complete_checks(stages: Stages, known: Knowledge, baseline: Candidate, tried: Sequence[Candidate]) -> Knowledge:
    """Make all checks of the candidates that cost less than the baseline, those nearest to the constraints.

    A candidate is usually rejected by the first check that fails. If nothing is better than the baseline, a user needs
    all causes, and what would have to change for each.

    Args:
        stages: of the study.
        known: results of the checks.
        baseline: to compare with.
        tried: candidates that have been tested.
    """
    cheaper = [
        candidate
        for candidate in tried
        if candidate.design.kind != "baseline"
        and candidate.trial.violation <= FAR
        and candidate.trial.cost < baseline.trial.cost
    ]
    for candidate in sorted(cheaper, key=lambda one: (one.trial.violation, one.trial.cost))[:COMPLETED]:
        check = known.verified.get(candidate.name, Verification())
        # Passed all checks, and is rejected for its cost in the runs.
        if candidate.name in known.verified and check.is_robust:
            continue
        finer = check.finer or stages.test_at_finer_step(candidate.design)
        margins, broken = (check.margins, check.broken) if check.margins else stages.confirm_margins(candidate)
        slopes = stages.test_slip(candidate.design)
        if slopes is None or slopes.status == "ok":
            slopes = check.slopes or stages.test_on_own_slopes(candidate.design)
        if slopes is not None and slopes.status != "ok":
            slopes = replace(slopes, figures=stages.followed_slopes(candidate.design))
        failed = check.failed_runs or stages.failed_runs(candidate)
        failed = (*(stages.with_causes(run, candidate.design) for run in failed[:1]), *failed[1:])
        complete = Verification(failed_runs=failed, finer=finer, margins=margins, broken=broken, slopes=slopes)
        known = replace(known, verified={**known.verified, candidate.name: complete})
    return known


def choose_rule(stages: Stages, tried: Sequence[Candidate], slower: Sequence[Design]) -> RuleChoice:
    """Choose the cheapest rule that meets the constraints and is robust.

    If there is none, take the fastest robust one of the slower designs, or else the rule with the latest failure.

    Args:
        stages: of the study.
        tried: candidates that have been tested.
        slower: further designs, the fastest first.
    """
    known = Knowledge()
    # Rank: violation of the constraints, then cost.
    costs = {rule.name: stages.cost_in_runs(rule) for rule in tried if rule.design.kind == "rule"}
    rules = [candidate for candidate in tried if candidate.name in costs]
    rules.sort(key=lambda rule: (rule.trial.violation, costs[rule.name]))
    rejected: list[Candidate] = []
    checked = 0
    for rule in [rule for rule in rules if rule.trial.feasible]:
        check, known = verify(stages, known, rule)
        if check.is_robust:
            return RuleChoice(rule, tuple(rejected), (), known)
        rejected.append(rule)
        # A Monte Carlo takes long, so only the cheapest rules get one.
        checked += check.used_plant
        if checked == POOL:
            break
    # Slower designs, the fastest first: the first robust one has the best performance among them.
    for design in slower:
        # Known before the test on the plant.
        if stages.manoeuvres and stages.over_present(design) > MOST_OVER_PRESENT:
            continue
        (rule,) = stages.test([design], "slower rules")
        if rule.trial.feasible:
            check, known = verify(stages, known, rule)
            if check.is_robust:
                return RuleChoice(rule, tuple(rejected), (rule,), known)
    # No robust rule: the one with the latest failure is the bar.
    if rejected:
        nearest = max(rejected, key=lambda rule: known.verified[rule.name].passed_runs)
        return RuleChoice(nearest, tuple(rule for rule in rejected if rule is not nearest), (), known)
    return RuleChoice(rules[0] if rules else None, (), (), known)


def choose_best(
    stages: Stages, known: Knowledge, tried: Sequence[Candidate], searches: Sequence[Trials]
) -> tuple[Candidate | None, Knowledge]:
    """Choose the cheapest candidate that meets the constraints and is robust.

    If none is robust, take the one with the latest failure among those that were checked; None if none meets the
    constraints.

    Args:
        stages: of the study.
        known: results so far.
        tried: candidates that have been tested.
        searches: trials on the plant.
    """
    # Rejections are those of this choice, so earlier ones are dropped.
    known = replace(known, rejected=())
    # Candidates with a test and trials of the searches, together in the order of their cost.
    pool: list[tuple[float, Candidate | Trial]] = [
        (stages.cost_in_runs(candidate), candidate)
        for candidate in tried
        if candidate.trial.feasible and candidate.design.kind != "baseline"
    ]
    pool += [(trial.cost, trial) for trials in searches for trial in trials.trials if trial.feasible]
    failed: list[tuple[int, Candidate]] = []
    checked = 0
    for _, entry in sorted(pool, key=lambda pair: pair[0]):
        # A trial becomes a candidate only when it is its turn: that takes tests of its own.
        if isinstance(entry, Candidate):
            candidate: Candidate | None = entry
        else:
            candidate, known = _candidate_of(stages, known, entry)
        if candidate is None:
            continue
        is_new = candidate.name not in known.verified
        check, known = verify(stages, known, candidate)
        if check.is_robust:
            return candidate, known
        failed.append((check.passed_runs, candidate))
        # Two trials may have the same rounded gains.
        lost = RejectedTrial(candidate.design.gains, candidate.trial.cost, check.rejections)
        if not isinstance(entry, Candidate) and lost not in known.rejected:
            known = replace(known, rejected=(*known.rejected, lost))
        # Only new checks on the plant take time. Rules that failed before must not keep the trials from their turn.
        checked += is_new and check.used_plant
        if checked == POOL:
            break
    return max(failed, key=lambda pair: pair[0], default=(0, None))[1], known


def _candidate_of(stages: Stages, known: Knowledge, trial: Trial) -> tuple[Candidate | None, Knowledge]:
    """Return a trial with rounded gains as a candidate; None if it fails a check, or due to the rounding."""
    # Rounded gains, as they would be written; they may equal those of an earlier trial.
    gains = rounded(trial.gains)
    for candidate in known.searched:
        if candidate.design.gains == gains:
            return candidate, known

    def rejected(*reasons: Rejection) -> Knowledge:
        cost = sum(weight * trial.figures[figure] for figure, weight in stages.spec.cost.items() if weight)
        return replace(known, rejected=(*known.rejected, RejectedTrial(gains, cost, reasons)))

    # Cheap checks before expensive ones: own slopes, hard scenarios, finer step, then the full test with response.
    name = "searched" if not known.searched else f"searched {len(known.searched) + 1}"
    design = Design(name, "searched", gains)
    # The search has tested the gains on the slip model, but before they were rounded.
    slip = stages.test_slip(design)
    if slip is not None and slip.status != "ok":
        return None, rejected(Rejection("own_slopes", reason=slip.reason))
    slopes = stages.test_on_own_slopes(design)
    if slopes is not None and slopes.status != "ok":
        return None, replace(rejected(Rejection("own_slopes", reason=slopes.reason)), lost_on_slopes=True)
    failure = stages.first_failure(gains, [*known.hard, *stages.hardest])
    if failure is not None:
        return None, rejected(failure)
    finer = stages.test_at_finer_step(design)
    if finer is not None and finer.trial.status != "ok":
        return None, replace(rejected(Rejection("finer_step", reason=finer.trial.reason)), lost_at_finer_step=True)
    (candidate,) = stages.test([design], "best")
    if not candidate.trial.feasible:
        return None, rejected(*candidate.trial.rejections(stages.constraints))
    return candidate, replace(
        known,
        searched=(*known.searched, candidate),
        finer={**known.finer, candidate.name: finer},
        slopes={**known.slopes, candidate.name: slopes},
    )


def better_of(stages: Stages, known: Knowledge, best: Candidate, rule: Candidate | None) -> Candidate:
    """Return the best candidate if it costs no more than the rule in the test and in the median run, else the rule.

    A rule that is not feasible or not robust is not returned. The test has the nominal conditions; the runs have other
    steps, masses, delays and grades. Gains that are better in one of them only replace one compromise by another.
    """
    check = known.verified.get(rule.name) if rule is not None else None
    if rule is None or check is None or not (rule.trial.feasible and check.is_robust):
        return best
    if printed(best.trial.cost) > printed(rule.trial.cost):
        return rule
    runs = stages.monte_carlo([best, rule], pairs=[(best.name, rule.name)])
    ratio = None if runs is None else runs.median_ratio(best.name, rule.name, stages.spec.cost)
    return rule if ratio is not None and printed(ratio) > 1.0 else best


def beats_rule(stages: Stages, known: Knowledge, best: Candidate, rule: Candidate | None) -> tuple[bool, Knowledge]:
    """Return whether a candidate is robust, and costs less than the rule if that is robust."""
    check, known = verify(stages, known, best)
    if not check.is_robust or rule is None:
        return check.is_robust, known
    other, known = verify(stages, known, rule)
    return not other.is_robust or stages.cost_in_runs(best) < stages.cost_in_runs(rule), known
