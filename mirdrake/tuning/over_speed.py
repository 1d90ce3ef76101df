"""Gain schedule of a study: the loop is identified and tuned at each speed, then the whole table is tested.

The tests, at the speeds of the table and half-way between them, use the vehicle's controller with the table in its
control.yaml, which reads its gains at the measured speed. The constant gains of the best candidate are tested as well.

W. J. Rugh and J. S. Shamma, Research on gain scheduling, Automatica 36 (2000) 1401: good gains at some speeds guarantee
nothing between them.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

from mirdrake.core.json_io import finite_or_none
from mirdrake.tuning.acceptance import Criterion
from mirdrake.tuning.designs import Design, rounded
from mirdrake.tuning.identify import identify_loop
from mirdrake.tuning.loops.base import Conditions, LoopSpec
from mirdrake.tuning.loops.evaluate import LoopEvaluator, plant_bench
from mirdrake.tuning.loops.reduced import find_loop_margins
from mirdrake.tuning.loops.registry import make_loop_spec
from mirdrake.tuning.result import Schedule, ScheduleRow, ScheduleTest
from mirdrake.tuning.search_range import Range, Space
from mirdrake.tuning.space import inside, space_around
from mirdrake.tuning.stages import Candidate, Stages
from mirdrake.vehicles.joint_control import GainTable


def tune_over_speed(
    stages: Stages, space: Space, winner: Candidate, rule: Candidate | None, hard: Sequence[Conditions]
) -> tuple[Schedule | None, tuple[Criterion, ...]]:
    """Find gains at each speed of the study's schedule and test them; None if the study has no schedule.

    Args:
        stages: of the study.
        space: ranges of the gains.
        winner: the best candidate at the study's own speed, with which the searches begin.
        rule: the best rule there; the searches begin with it, too, as the winner may not be robust.
        hard: conditions under which gains must be stable, besides the hardest draws of the Monte Carlo.
    """
    if stages.spec.schedule is None:
        return None, ()
    speeds = stages.spec.schedule.speeds
    rows: list[ScheduleRow] = []
    for speed in speeds:
        loop = identified_at(stages, speed)
        # Neighbouring speeds have similar gains: start from those of the speed before, from the rule and the winner.
        known = [row.gains for row in rows[-1:]] + [one.design.gains for one in (rule, winner) if one is not None]
        # Manoeuvres, slopes and tests in single conditions are those of this speed.
        at_speed = replace(stages, loop=loop, scenarios={}, unstable_now={})
        gains = _gains_at(at_speed, space, f"speed-{speed:g}", known, hard)
        # A table with a gap cannot be applied.
        if gains is None:
            return Schedule((), failed_speed=speed), (Criterion("schedule", None, 0.0, met=False),)
        rows.append(ScheduleRow(speed, gains))
    table = GainTable(tuple(speeds), {name: tuple(row.gains[name] for row in rows) for name in stages.loop.gains})
    tests = _test(stages, table, winner)
    broken = sum(test.candidate == "scheduled" and not test.feasible for test in tests)
    return Schedule(tuple(rows), tests), (Criterion("schedule", float(broken), 0.0, broken == 0),)


def with_schedule(loop: LoopSpec, table: GainTable) -> LoopSpec:
    """Return a loop with a table of gains in the control.yaml of its vehicle, so that no gain is left to set."""
    section = next(iter(loop.gains.values())).path.partition(".")[0]
    schedule = {"speeds": list(table.speeds), **{name: list(values) for name, values in table.gains.items()}}
    control = loop.diagram["vehicles"][loop.vehicle]["control"]
    return loop.with_control({**control, section: {**control[section], "schedule": schedule}})


def identified_at(stages: Stages, speed: float | None = None) -> LoopSpec:
    """Return the study's loop with its model, at another speed [m/s] if one is given."""
    return identify_loop(plant_bench(make_loop_spec(stages.spec, speed=speed))).loop


def _gains_at(
    stages: Stages,
    space: Space,
    stage: str,
    known: Sequence[dict[str, float]],
    hard: Sequence[Conditions],
) -> dict[str, float] | None:
    """Return the cheapest gains that meet the constraints on the plant and are stable in all scenarios, if any."""
    # Starts outside of the ranges would be rejected by the search.
    starts = inside(space, known)
    coarse = stages.search(space, "reduced", starts, stage)
    # Around the best trials of the model, extended to the starting gains.
    near = {
        name: Range(
            min([entry.low, *(gains[name] for gains in starts)]),
            max([entry.high, *(gains[name] for gains in starts)]),
            entry.scale,
        )
        for name, entry in space_around(space, coarse.leaders).items()
    }
    best = inside(near, (trial.gains for trial in coarse.leaders))
    starts = [*starts, *(gains for gains in best if gains not in starts)]
    fine = stages.search(near, "plant", starts, f"{stage}-confirmation", scenarios=hard)

    # Cheapest first, rounded as they would be written; rounding and scenarios may reject a trial.
    feasible = [trial for trial in fine.trials if trial.feasible]
    for trial in sorted(feasible, key=lambda trial: (trial.cost, trial.number)):
        gains = rounded(trial.gains)
        candidate = stages.candidate(Design(stage, "scheduled", gains), LoopEvaluator(stages.loop)(gains))
        if candidate.trial.feasible and stages.first_failure(gains, [*hard, *stages.hardest]) is None:
            return gains
    return None


def _test(stages: Stages, table: GainTable, winner: Candidate) -> tuple[ScheduleTest, ...]:
    """Test the table and the constant gains at its speeds and between them, on the plant."""
    tests: list[ScheduleTest] = []
    constant = winner.design
    # Between the speeds of the table too, where gains are interpolated and were not tuned.
    for speed in sorted({*table.speeds, *table.between()}):
        loop = identified_at(stages, speed)
        gains = table.at(speed)
        # Margins belong to constant gains: those of the interpolated gains at this speed are added.
        given = LoopEvaluator(with_schedule(loop, table))({})
        figures = {**given.figures, **find_loop_margins(loop, gains)} if given.status == "ok" else {}
        for name, values, evaluation in (
            ("scheduled", gains, replace(given, figures=figures)),
            (constant.name, constant.gains, LoopEvaluator(loop)(constant.gains)),
        ):
            trial = stages.candidate(Design(name, "scheduled", values), evaluation).trial
            place: Literal["tuned", "between"] = "tuned" if speed in table.speeds else "between"
            cost = finite_or_none(trial.cost)
            tests.append(ScheduleTest(speed, name, place, values, trial.status, cost, trial.feasible, trial.reason))
        # Two candidates at each of the n speeds and the n - 1 between them.
        stages.progress("schedule", len(tests), 2 * (2 * len(table.speeds) - 1), math.nan)
    return tuple(tests)
