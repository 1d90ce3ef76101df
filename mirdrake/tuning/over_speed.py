"""The schedule of a study: the loop is identified and tuned anew at each speed, then the whole table is tried.

What is tried at the speeds and half-way between them is the controller of the vehicle with the table in its
control.yaml: it reads its gains at the speed of the car while that changes. The constant gains of the best candidate go
the same way, to compare with.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from mirdrake.tuning.designs import Design
from mirdrake.tuning.identify import check_identified, identify_loop
from mirdrake.tuning.loops.base import Conditions, LoopSpec
from mirdrake.tuning.loops.evaluate import LoopEvaluator, bench_of
from mirdrake.tuning.loops.make import make_loop_spec
from mirdrake.tuning.loops.reduced import find_loop_margins
from mirdrake.tuning.outcome import Candidate
from mirdrake.tuning.scenarios import hardest
from mirdrake.tuning.space import known_starts, leaders_of, space_around
from mirdrake.tuning.stages import Stages, rounded
from mirdrake.vehicles.joint_control import GainTable


@dataclass(frozen=True)
class Scheduled:
    """What became of the schedule.

    Attributes:
        rows: speed [m/s] and gains, a row a speed; None where the study asks for none, or no gains hold at some speed.
        check: a row a speed and set of gains (``scheduled``, or the name of the best): where (tuned or between), cost,
            feasible, status, reason, gains.
        notes: for the reader.
        acceptance: what the schedule shall reach.
    """

    rows: list[dict[str, Any]] | None = None
    check: list[dict[str, Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    acceptance: list[dict[str, Any]] = field(default_factory=list)


def tune_over_speed(
    stages: Stages, space: dict[str, dict[str, Any]], winner: Candidate, hard: Sequence[Conditions]
) -> Scheduled:
    """Gains at each speed of the study's schedule, and what they do; nothing where it has none.

    Args:
        stages: of the study.
        space: of the gains.
        winner: the best candidate at the study's own speed, to begin with.
        hard: conditions in which gains must be stable, besides the hardest draws of the Monte Carlo.
    """
    if stages.spec.schedule is None:
        return Scheduled()
    speeds = stages.spec.schedule.speeds
    rows: list[dict[str, Any]] = []
    for speed in speeds:
        loop = _identified(stages, speed)
        before = [row["gains"] for row in rows[-1:]]
        gains = _gains_at(stages, loop, space, f"speed-{speed:g}", [*before, winner.design.gains], hard)
        if gains is None:
            note = f"no schedule: at {speed:g} m/s no gains were found that keep the constraints in all scenarios"
            return Scheduled(notes=[note], acceptance=[_criterion(None)])
        rows.append({"speed": speed, "gains": gains})
    table = GainTable(tuple(speeds), {name: tuple(row["gains"][name] for row in rows) for name in stages.loop.gains})
    check = _check(stages, table, winner)
    broken = sum(row["gains"] == "scheduled" and not row["feasible"] for row in check)
    return Scheduled(rows, check, acceptance=[_criterion(broken)])


def with_schedule(loop: LoopSpec, table: GainTable) -> LoopSpec:
    """The loop with a table of gains in the control.yaml of its vehicle; no gain of it is left to turn."""
    section = next(iter(loop.paths.values())).partition(".")[0]
    schedule = {"speeds": list(table.speeds), **{name: list(values) for name, values in table.gains.items()}}
    vehicle = loop.diagram["vehicles"][loop.vehicle]
    control = {**vehicle["control"], section: {**vehicle["control"][section], "schedule": schedule}}
    vehicles = {**loop.diagram["vehicles"], loop.vehicle: {**vehicle, "control": control}}
    return replace(loop, diagram={**loop.diagram, "vehicles": vehicles})


def _identified(stages: Stages, speed: float) -> LoopSpec:
    found = identify_loop(bench_of(make_loop_spec(stages.spec, speed=speed)))
    check_identified(found)
    return found.spec


def _gains_at(
    stages: Stages,
    loop: LoopSpec,
    space: dict[str, dict[str, Any]],
    stage: str,
    known: list[dict[str, float]],
    hard: Sequence[Conditions],
) -> dict[str, float] | None:
    """The cheapest gains that keep the constraints on the plant and stand the scenarios; None if there are none."""
    inside = [gains for gains in known if all(space[n]["low"] <= v <= space[n]["high"] for n, v in gains.items())]
    coarse = stages.search(space, "reduced", inside, stage, loop=loop)
    leaders = leaders_of(coarse)
    near = space_around(space, leaders)
    near = {name: _stretched(entry, [gains[name] for gains in inside]) for name, entry in near.items()}
    starts = [*inside, *(gains for gains in known_starts(near, leaders) if gains not in inside)]
    fine = stages.search(near, "plant", starts, f"{stage}-confirmation", loop=loop, scenarios=hard)
    first = hardest(stages.spec, stages.ranges)
    for trial in sorted((one for one in fine.trials if one.feasible), key=lambda one: (one.cost, one.number)):
        gains = rounded(trial.gains)
        given = stages.candidate(Design(stage, "scheduled", "", gains), LoopEvaluator(loop)(gains))
        if given.trial.feasible and stages.stands(gains, [*hard, *first], loop):
            return gains
    return None


def _stretched(entry: dict[str, Any], values: list[float]) -> dict[str, Any]:
    """A range that has known values in it."""
    return {**entry, "low": min([entry["low"], *values]), "high": max([entry["high"], *values])}


def _check(stages: Stages, table: GainTable, winner: Candidate) -> list[dict[str, Any]]:
    """The table and the constant gains at its speeds and between them, on the plant; margins with the gains there."""
    rows: list[dict[str, Any]] = []
    constant = winner.design
    for speed in sorted({*table.speeds, *table.between()}):
        loop = _identified(stages, speed)
        there = table.at(speed)
        margins = find_loop_margins(loop, there)
        given = LoopEvaluator(with_schedule(loop, table))({})
        figures = {**given.figures, **margins} if given.status == "ok" else {}
        tried = {
            "scheduled": (there, replace(given, figures=figures)),
            constant.name: (constant.gains, LoopEvaluator(loop)(constant.gains)),
        }
        for name, (gains, found) in tried.items():
            trial = stages.candidate(Design(name, "scheduled", "", gains), found).trial
            rows.append(
                {"speed": speed, "gains": name, "where": "tuned" if speed in table.speeds else "between",
                 "cost": trial.cost, "feasible": trial.feasible, "status": trial.status, "reason": trial.reason,
                 "values": gains}
            )  # fmt: skip
        stages.tell("schedule", len(rows), 2 * (2 * len(table.speeds) - 1), float("nan"))
    return rows


def _criterion(broken: int | None) -> dict[str, Any]:
    what = "speeds at and between which the schedule does not keep the constraints"
    return {"what": what, "value": broken, "limit": 0, "met": broken == 0}
