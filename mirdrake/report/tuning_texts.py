"""Texts of a tuning result: names and units of figures, sentences for criteria, rejections, designs and experiments."""

import math
from collections.abc import Mapping

from mirdrake.core.wording import plural
from mirdrake.report.tuning_causes import cause_sentences
from mirdrake.report.words import format_quantity, format_time, title_case
from mirdrake.tuning.acceptance import Criterion, StepEffect
from mirdrake.tuning.apply import Comparison
from mirdrake.tuning.designs import DESIGN_RULES
from mirdrake.tuning.identify import Experiment
from mirdrake.tuning.loops.manoeuvres import OVER_PRESENT
from mirdrake.tuning.result import CandidateResult, TuningResult
from mirdrake.tuning.robustness import CandidateRobustness
from mirdrake.tuning.scenarios import describe
from mirdrake.tuning.spec import AT_LEAST
from mirdrake.tuning.trials import Rejection

FIGURES: dict[str, tuple[str, str]] = {
    "iae": ("IAE", "{ys}"),
    "itae": ("ITAE", "{yss}"),
    "ise": ("ISE", "({y})² s"),
    "overshoot_percent": ("Overshoot", "%"),
    "rise_time": ("Rise time", "s"),
    "settling_time": ("Settling time", "s"),
    "steady_error": ("Steady error", "{y}"),
    "over_present": ("IAE over present", ""),
    "peak_effort": ("Peak effort", "{u}"),
    "rms_effort": ("RMS effort", "{u}"),
    "total_variation": ("Total variation", "{u}"),
    "saturation_time": ("Saturation", "s"),
    "rms_jerk": ("RMS jerk", "{y_ss}"),
    "peak_jerk": ("Peak jerk", "{y_ss}"),
    "ms": ("Ms", ""),
    "mt": ("Mt", ""),
    "gain_margin": ("Gain margin", "×"),
    "phase_margin_deg": ("Phase margin", "°"),
    "delay_margin_s": ("Delay margin", "s"),
    "disk_margin": ("Disk margin", ""),
}
"""Label and unit of each figure; y and u are the units of output and effort."""

GROUPS = {
    "Response": (
        "iae", "itae", "ise", "overshoot_percent", "rise_time", "settling_time", "steady_error", "over_present",
    ),
    "Effort and jerk": ("peak_effort", "rms_effort", "total_variation", "saturation_time", "rms_jerk", "peak_jerk"),
    "Stability margins": ("ms", "mt", "gain_margin", "phase_margin_deg", "delay_margin_s", "disk_margin"),
}  # fmt: skip
"""Figures of each table of candidates."""

UNLIMITED = {"gain_margin", "delay_margin_s", "phase_margin_deg"}
"""Margins that a loop may not have: nothing makes it unstable."""

KINDS = {
    "baseline": "baseline",
    "rule": "rule",
    "shaped": "loop shaping",
    "searched": "search",
    "scheduled": "schedule",
}
"""Kinds of candidates."""

EXPERIMENTS = {
    "step_test": "step test",
    "relay": "relay feedback",
    "frequency_response": "frequency response",
    "wheels_apart": "frequency response of the wheels against each other",
    "vehicle_data": "data of the vehicle",
    "linear_model": "linear model of the diagram",
}
MODELS = {
    "first_order": "first order with delay",
    "integrator": "integrator with delay",
    "inertia": "inertia with damping, stiffness and delay",
    "ultimate_point": "ultimate point",
}


class Texts:
    """Texts of one result.

    Attributes:
        y: unit of the output.
        u: unit of the effort.
        by_name: candidates by name.
        baseline: candidate to compare with.
        best: best candidate; None if none meets the constraints.
        best_rule: best rule; None without one.
        winner: the best candidate, or the nearest one to the constraints.
    """

    def __init__(self, result: TuningResult) -> None:
        self.result = result
        self.y, self.u = result.loop.output_unit or "1", result.loop.effort_unit or "1"
        self.by_name = {candidate.name: candidate for candidate in result.candidates}
        self.baseline = self.by_name.get(result.baseline)
        self.best = self.by_name.get(result.best or "")
        self.best_rule = self.by_name.get(result.best_rule or "")
        self.winner = self.best or self._nearest()

    def _nearest(self) -> CandidateResult | None:
        """Return the candidate to show if none meets the constraints: the last of the Monte Carlo, or the cheapest."""
        known = {self.result.baseline, self.result.best_rule}
        tested = self.result.robustness.candidates if self.result.robustness else {}
        checked = [self.by_name[name] for name in tested if name in self.by_name and name not in known]
        if checked:
            return checked[-1]
        stable = [
            (candidate.cost, candidate)
            for candidate in self.result.candidates
            if candidate.name not in known and candidate.cost is not None and candidate.kind != "baseline"
        ]
        return min(stable, key=lambda pair: pair[0])[1] if stable else None

    # --- figures ---

    def figure(self, name: str) -> tuple[str, str]:
        """Return label and unit of a figure."""
        label, unit = FIGURES.get(name, (title_case(name), ""))
        per_second = self.y.removesuffix("/s") if self.y.endswith("/s") else ""
        integrals = (per_second, f"{per_second} s") if per_second else (f"{self.y} s", f"{self.y} s²")
        second = f"{per_second}/s³" if per_second else f"{self.y}/s²"
        return label, unit.format(y=self.y, u=self.u, ys=integrals[0], yss=integrals[1], y_ss=second)

    def value(self, name: str, value: float | None) -> str:
        """Return a figure with its unit; "none" for a margin that a loop does not have."""
        if value is not None and math.isinf(value) and name in UNLIMITED:
            return "none"
        return "–" if value is None or not math.isfinite(value) else format_quantity(value, self.figure(name)[1])

    def weights(self) -> str:
        """Return the cost and the constraints."""
        cost = " + ".join(
            f"{'' if weight == 1 else f'{weight:g} × '}{self.figure(name)[0]}"
            for name, weight in self.result.cost.items()
        )
        bounds = [
            f"{self.figure(name)[0]} {'≥' if name in AT_LEAST else '≤'} {self.value(name, limit)}"
            for name, limit in self.result.constraints.items()
        ]
        return f"Cost: {cost or 'not given'}." + (f" Constraints: {', '.join(bounds)}." if bounds else "")

    # --- verdict ---

    def headline(self) -> str:
        """Return the comparison with the baseline, and the verdict, in one sentence."""
        # The verdict first needs a candidate within the constraints.
        result, best, baseline = self.result, self.best, self.baseline
        compared = baseline_name(result)
        consequence = f"; {compared} are kept" if self.keeps_present else ""
        if best is None:
            nearest = f", {self.winner.name} is the nearest" if self.winner else ""
            return f"no candidate meets the constraints{nearest}{consequence}"
        met = [criterion.met for criterion in result.acceptance]
        verdict = f"{sum(met)} of {len(met)} criteria are met" if met else "the study has no criteria"
        if met and all(met):
            verdict = "all criteria are met"
        name = next(iter(result.cost), "iae")
        label, after = self.figure(name)[0], best.figures.get(name)
        # A ratio to an unstable baseline has no meaning.
        if baseline is not None and baseline.status != "ok":
            return f"{label} {self.value(name, after)}, {compared} are {baseline.status}; {verdict}"
        before = baseline.figures.get(name) if baseline is not None else None
        if not before or after is None or baseline is best:
            return verdict
        change = 100.0 * (after / before - 1.0)
        values = f"{self.value(name, before)} → {self.value(name, after)}"
        if not result.is_better:
            return f"nothing is better than {compared} ({label} {values}){consequence}"
        return f"{abs(change):.0f} % {'less' if change < 0.0 else 'more'} {label} than {compared} ({values}); {verdict}"

    @property
    def keeps_present(self) -> bool:
        """Whether the vehicle keeps its present gains, because nothing is better."""
        return not self.result.is_better and self.result.spec.get("baseline") == "present"

    @property
    def winner_role(self) -> str:
        """Role of the winner; one that is not better than the present gains is not applied."""
        if self.best is None:
            return "nearest"
        return "rejected candidate" if self.keeps_present else "best"

    def after_verdict(self) -> list[str]:
        """Return sentences on why nothing is accepted: all causes, what to change, and what the baseline fails, too."""
        if self.result.is_better and self.result.is_accepted:
            return []
        sentences = cause_sentences(self)
        if self.baseline is not None and self.baseline.status == "ok":
            # A control without a model has no margins, which is not a failure.
            failed = [one for one in self.baseline.rejections if one.check != "constraint" or one.value is not None]
            if failed:
                sentences.append(
                    f"{baseline_name(self.result).capitalize()} fail this, too: {self.rejections(tuple(failed))}."
                )
        return sentences

    def tiles(self) -> list[tuple[str, str, str]]:
        """Return label, value and note of the main figures."""
        winner = self.winner
        if winner is None:
            return []
        role, others = "", [("baseline", self.baseline), ("best rule", self.best_rule)]
        # The tiles have the gains that the vehicle has after the study.
        if self.keeps_present:
            if self.baseline is not None and self.baseline.status == "ok":
                others = [("rejected candidate", winner)]
                winner, role = self.baseline, "present "
            else:
                role = "rejected candidate: "
        # Gains of zero are parts that the controller does not have.
        tiles = [
            (
                f"{role}{name}",
                format_quantity(value),
                self.result.loop.gains[name].unit if name in self.result.loop.gains else "",
            )
            for name, value in winner.gains.items()
            if value
        ][:4]
        for name in ("iae", "overshoot_percent", "settling_time", "ms", "phase_margin_deg", "delay_margin_s"):
            if name in winner.figures:
                notes = [
                    f"{label} {self.value(name, other.figures[name])}"
                    for label, other in others
                    if other is not None and name in other.figures and (label == "baseline" or other is not winner)
                ]
                tiles.append((self.figure(name)[0], self.value(name, winner.figures[name]), ", ".join(notes)))
        robustness = self.result.robustness
        # The runs in which the present gains were tested after candidates had failed in them are not a random sample.
        sampled = not role or all(rejection.check != "monte_carlo" for rejection in winner.rejections)
        if robustness is not None and winner.name in robustness.candidates and sampled:
            tested = robustness.candidates[winner.name]
            rate = tested.failures
            note = f"95 % interval {100.0 * rate.low:.1f} to {100.0 * rate.high:.1f} %{_on_model(tested)}"
            tiles.append(("Failed runs", f"{rate.failures} of {rate.runs}", note))
        # Tiles are four in a row: an incomplete row is left out, unless it is the only one.
        return tiles[: len(tiles) // 4 * 4 or len(tiles)]

    def notices(self) -> list[str]:
        """Return what a reader has to know before the figures."""
        result, notices = self.result, self.after_verdict()
        if result.loop.model is None and not result.experiments:
            margins = "its margins are those of the linear diagram, cut at the effort"
            known = "it has no margins: its effort is not the only element of an output that the diagram connects"
            notices.append(f"No rule fits this loop; {known if result.loop.period is None else margins}.")
        if result.omitted:
            omitted = "; ".join(f"{design.name} ({design.reason})" for design in result.omitted)
            notices.append(f"Designs without a solution: {omitted}.")
        # Warnings about the choice come before those about its conditions.
        notices += self._optimistic_margins()
        if result.step_effect is not None and result.step_effect.is_significant:
            notices.append(f"{self._step_effect(result.step_effect)}.")
        if result.repeated_for is not None:
            effect = self._step_effect(result.repeated_for)
            notices.append(f"The study was repeated with a shorter step of the plant. {effect}.")
        if result.schedule is not None and result.schedule.failed_speed is not None:
            notices.append(
                f"No schedule: at {result.schedule.failed_speed:g} m/s no gains meet the constraints in all scenarios."
            )
        if self.baseline is not None and self.baseline.status != "ok":
            reason = self.baseline.reason or "no reason given"
            notices.append(f"The baseline '{self.baseline.name}' is {self.baseline.status}: {reason}.")
        notices += self._failed_corners()
        return notices + robustness_notes(result, self.winner.name if self.winner else "")

    def _failed_corners(self) -> list[str]:
        """Return a sentence on corners of the ranges in which the winner fails; none if it is stable in all."""
        corners = self.result.robustness.corners if self.result.robustness else {}
        counts = {
            name: (sum(test.status != "ok" for test in tests), len(tests)) for name, tests in corners.items() if tests
        }
        failed, total = counts.get(self.winner.name, (0, 0)) if self.winner else (0, 0)
        if not failed or self.winner is None:
            return []
        other = counts.get(self.result.baseline) if self.result.baseline != self.winner.name else None
        compared = f", {baseline_name(self.result)} in {other[0]}" if other else ""
        return [
            f"For information, not a criterion: '{self.winner.name}' is not stable in {failed} of {total} corners of "
            f"the ranges{compared}. At a corner, all conditions are extreme at once."
        ]

    def _optimistic_margins(self) -> list[str]:
        """Return a sentence per margin of the winner that the plant does not confirm in full."""
        return [
            f"{self.figure(check.name)[0]}: {self.value(check.name, check.model)} on the model, "
            f"{self.value(check.name, check.claimed)} on the plant; this page states the smaller one."
            for check in (self.winner.margins if self.winner else ())
            if check.claimed < check.model
        ]

    def _step_effect(self, effect: StepEffect) -> str:
        steps = f"{1e3 * effect.finer_step:g} ms instead of {1e3 * effect.step:g} ms"
        if effect.status != "ok":
            return f"At a plant step of {steps} the best gains are {effect.status}: {effect.reason}"
        parts = [
            f"{self.figure(name)[0]} {self.value(name, effect.finer[name])} instead of "
            f"{self.value(name, effect.usual.get(name))}"
            for name in ("iae", "overshoot_percent")
        ]
        return f"At a plant step of {steps}: {', '.join(parts)}"

    # --- single entries ---

    def rejections(self, rejections: tuple[Rejection, ...]) -> str:
        """Return the reasons of a rejection; runs of the Monte Carlo are summarised, with the first of them."""
        runs = [rejection for rejection in rejections if rejection.check == "monte_carlo"]
        texts = [self._rejection(rejection) for rejection in rejections if rejection.check != "monte_carlo"]
        if runs:
            texts.append(
                f"not stable in {plural(len(runs), 'run')} of the Monte Carlo, first in run {runs[0].run} "
                f"({describe(runs[0].conditions) if runs[0].conditions else 'nominal'}): {runs[0].reason}"
                + self._made(runs[0].made_runs)
            )
        return "; ".join(texts)

    def _made(self, runs: int | None) -> str:
        """Return after how many runs of the Monte Carlo a candidate was rejected, as the end of a sentence."""
        settings = self.result.spec.get("robustness")
        total = settings.get("runs") if isinstance(settings, Mapping) else None
        return f"; rejected after {runs} of {total} runs" if runs is not None and total is not None else ""

    def _rejection(self, rejection: Rejection) -> str:
        match rejection.check:
            case "constraint" | "margin":
                sign = "below" if rejection.figure in AT_LEAST else "above"
                value, limit = _distinct(rejection.value, rejection.limit)
                on = " on the plant" if rejection.check == "margin" else ""
                if rejection.value is None or not math.isfinite(rejection.value):
                    return f"{self.figure(rejection.figure)[0]}{on} is not defined for its loop; the limit is {limit}"
                return f"{self.figure(rejection.figure)[0]} {value}{on} is {sign} the limit {limit}"
            case "finer_step":
                return f"not stable at a finer step of the plant: {rejection.reason}"
            case "own_slopes":
                return f"does not follow the vehicle's own slopes of the set-point: {rejection.reason}"
            case "scenario":
                conditions = describe(rejection.conditions) if rejection.conditions else "nominal"
                return f"not stable with {conditions}: {rejection.reason}"
            case _:
                return rejection.reason

    def how(self, candidate: CandidateResult) -> str:
        """Return how a candidate was made."""
        match candidate.kind:
            case "baseline":
                return self._baseline_origin()
            case "searched":
                search = self.result.spec.get("search")
                method = search.get("method", "search") if isinstance(search, Mapping) else "search"
                return f"{method} on the reduced model, refined on the plant"
        rule = DESIGN_RULES.get(candidate.rule)
        return rule.description.format(parameter=candidate.parameter or 0.0) if rule else ""

    def _baseline_origin(self) -> str:
        """Return which gains the study compares with."""
        loop, given = self.result.loop, self.result.spec.get("baseline")
        if not isinstance(given, str):
            return "gains given by the study"
        if not loop.present_kind:
            return "present gains of the diagram"
        if given == "published":
            return "100, 0.01 and 10 on every joint, the untuned gains of the papers' vehicles"
        delay = ", which acts without the delay of the actuators" if loop.present_kind == "servo" else ""
        return f"present control of the vehicle: {loop.present_kind}{delay}"

    def experiment(self, experiment: Experiment) -> tuple[str, str, str, str]:
        """Return name, model, parameters and fit of an experiment."""
        parameters = "; ".join(
            f"{title_case(name).lower()} {format_quantity(parameter.value, self.unit(parameter.unit))}"
            for name, parameter in experiment.parameters.items()
        )
        notes = [f"fit {experiment.fit_percent:.1f} %"] if experiment.fit_percent is not None else []
        notes += ["with the derivative part of the loop, which a relay needs"] if experiment.derivative_on else []
        notes += ["the pedal controller cancels mass, resistance and pedal maps"] * (experiment.name == "vehicle_data")
        notes += [experiment.error] if experiment.error else []
        return EXPERIMENTS[experiment.name], MODELS[experiment.model], parameters, "; ".join(notes)

    def unit(self, unit: str) -> str:
        """Return a unit of a general loop as one of this loop."""
        general = {
            "y/u": f"{self.y} per {self.u}",
            "u/y": f"{self.u} per {self.y}",
            "y/(u s)": f"{self.y} per {self.u} and s",
        }
        return "" if unit == "1" else general.get(unit, unit)

    def facts(self) -> list[str]:
        """Return seed, digest, duration and versions."""
        result = self.result
        versions = ", ".join(f"{name} {number}" for name, number in result.versions.items())
        facts = [f"seed {result.seed}", f"SHA-256 of the study {result.spec_sha256[:16]}"]
        facts += [f"duration {format_time(result.wall_s)}"] if result.wall_s is not None else []
        return [*facts, versions] if versions else facts


def criterion_text(criterion: Criterion, result: TuningResult) -> str:
    """Return what a criterion requires."""
    rule = "robust rule" if result.robustness is not None or result.step_effect is not None else "rule"
    baseline = next((candidate for candidate in result.candidates if candidate.name == result.baseline), None)
    unstable = ", which is unstable" if baseline is not None and baseline.status != "ok" else ""
    cost = "cost of at most" if result.robustness is None else "median cost in the Monte Carlo over"
    texts = {
        "cheaper_than_baseline": f"cost below that of {baseline_name(result)}{unstable}",
        "cheaper_in_runs": f"median cost in the Monte Carlo over that of {baseline_name(result)}",
        "constraint": FIGURES.get(criterion.figure, (criterion.figure, ""))[0],
        "monte_carlo": "Monte Carlo runs that are not stable",
        "finer_step": "tests at a finer step of the plant that are not stable",
        "own_slopes": "tests in which the output does not follow the vehicle's own slopes of the set-point",
        "no_costlier_than_rule": f"{cost} that of the best {rule} within the constraints, {criterion.rule}",
        "robust_unlike_rules": "meets the constraints and is robust, as no rule is",
        "feasible_unlike_rules": "meets the constraints, as no rule does",
        "schedule": "speeds at and between which the schedule breaks a constraint",
    }
    return texts[criterion.name]


def baseline_name(result: TuningResult) -> str:
    """Return what the study compares with."""
    given = result.spec.get("baseline")
    if given == "published" and not result.loop.present_kind:
        given = "present"
    return {"present": "the present gains", "published": "the published gains"}.get(str(given), "the given gains")


def comparison_lines(compared: Comparison, result: TuningResult, chosen: CandidateResult) -> list[str]:
    """Return a line for each figure of the test manoeuvre: its value before and after tuning.

    Margins after tuning are the claimed ones, the smaller of model and measurement.
    """
    texts = Texts(result)
    claimed = {check.name: check.claimed for check in chosen.margins}
    # Figures of the cost come first and once, then those that every study is asked about.
    lines = ["test manoeuvre of the study:     before -> after"]
    for name in dict.fromkeys([*result.cost, "overshoot_percent", "settling_time", "ms", "delay_margin_s"]):
        pair = [
            texts.value(name, figures.get(name)) if test.status == "ok" else test.status
            for test, figures in (
                (compared.before, compared.before.figures),
                (compared.after, compared.after.figures | claimed),
            )
        ]
        lines.append(f"  {texts.figure(name)[0]:<18} {pair[0]:>20} -> {pair[1]}")
    # Other manoeuvres than the test, such as a launch.
    if OVER_PRESENT in chosen.figures:
        label = texts.figure(OVER_PRESENT)[0]
        lines.append(f"  {label:<18} {'1':>20} -> {texts.value(OVER_PRESENT, chosen.figures[OVER_PRESENT])}")
    return lines


def _on_model(candidate: CandidateRobustness) -> str:
    """Return how many runs the plant has made, if not all, as the end of a sentence."""
    if candidate.on_plant == candidate.failures.runs:
        return ""
    return f"; {candidate.on_plant} runs on the plant, the others on the reduced model"


def robustness_notes(result: TuningResult, name: str) -> list[str]:
    """Return a note on failed runs of a candidate in the Monte Carlo; none without failures."""
    robustness = result.robustness
    if robustness is None or name not in robustness.candidates:
        return []
    rate = robustness.candidates[name].failures
    return [f"'{name}' failed in {rate.failures} of {rate.runs} runs of the Monte Carlo."] if rate.failures else []


def acceptance_notes(result: TuningResult, chosen: CandidateResult) -> list[str]:
    """Return notes on the criteria that the best candidate does not meet, and on the checks that rejected it."""
    criteria = result.acceptance if chosen.name == result.best else ()
    unmet = [criterion_text(criterion, result) for criterion in criteria if not criterion.met]
    rejected = Texts(result).rejections(chosen.rejections)
    notes = [f"criteria that are not met: {'; '.join(unmet)}"] if unmet else []
    return [*notes, f"'{chosen.name}' was rejected: {rejected}"] if rejected else notes


def _distinct(value: float | None, limit: float | None) -> tuple[str, str]:
    """Return a value and its limit with as many digits as distinguish them, at least three."""
    for digits in range(3, 7):
        texts = tuple("undefined" if number is None else f"{number:.{digits}g}" for number in (value, limit))
        if texts[0] != texts[1]:
            break
    return texts[0], texts[1]
