"""Gain scheduling over speed: gains tuned at several speeds, straight lines between them, and a check in between.

W. J. Rugh and J. S. Shamma, Research on gain scheduling, Automatica 36 (2000) 1401: gains that are good where they
were tuned promise nothing between these points; so the check tries the interpolated gains there.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from pydrake.systems.framework import Context

from mirdrake.controllers.pid import DiscretePid
from mirdrake.core.checks import check_number
from mirdrake.core.errors import RunError
from mirdrake.core.pid import NO_LIMITS, PidGains, PidLimits
from mirdrake.core.signals import declare_vector_input, signals
from mirdrake.execution.calls import open_executor
from mirdrake.execution.journal import Journal
from mirdrake.studies.optimise import LEARNING
from mirdrake.tuning.loops.base import Evaluation, Evaluator
from mirdrake.tuning.search import LIMIT, Evaluations, search
from mirdrake.tuning.trials import judge
from mirdrake.vehicles.joint_control import GainTable

EvaluatorAt = Callable[[float], Evaluator]
"""The evaluator of the loop at a speed [m/s]."""

__all__ = ["EvaluatorAt", "GainTable", "ScheduledPid", "check_schedule", "tune_schedule"]


def tune_schedule(
    evaluator_at: EvaluatorAt,
    space: Mapping[str, Any],
    speeds: Iterable[float],
    *,
    start: Sequence[Mapping[str, float]] = (),
    store: Path | str | None = None,
    purpose: Mapping[str, Any] | None = None,
    **more: Any,
) -> GainTable:
    """Search for gains at each speed; a sampler begins with what was best at the speed before.

    Args:
        evaluator_at: the loop at a speed.
        space: see :func:`mirdrake.tuning.search.search`.
        speeds: where to tune [m/s], rising.
        start: candidates to begin with.
        store: folder of the journals, one a speed.
        purpose: see :func:`mirdrake.tuning.search.search`.
        more: further arguments of it, cost among them.

    Raises:
        ConfigError: speeds that do not rise, and as the search.
        RunError: no candidate meets the constraints at a speed.
    """
    wanted = tuple(check_number("schedule", "speed", speed, unit="m/s") for speed in speeds)
    GainTable(wanted, {})
    found: list[dict[str, float]] = []
    learns = more.get("method", "tpe") in LEARNING
    for speed in wanted:
        place = Path(store) / f"speed-{speed:g}.jsonl" if store is not None else None
        before = [point for point in found[-1:] if learns and point not in start]
        trials = search(
            evaluator_at(speed),
            space,
            start=[*start, *before],
            store=place,
            purpose={**(purpose or {}), "speed": speed},
            **more,
        )
        if not trials.complete:
            raise KeyboardInterrupt
        if trials.best is None:
            raise RunError(
                f"schedule: no candidate meets the constraints at {speed:g} m/s; relax them, or widen the ranges"
            )
        found.append(trials.best.gains)
    return GainTable(wanted, {name: tuple(gains[name] for gains in found) for name in found[0]})


def check_schedule(
    evaluator_at: EvaluatorAt,
    table: GainTable,
    *,
    cost: Mapping[str, float],
    constraints: Mapping[str, float] | None = None,
    between: int = 1,
    others: Mapping[str, Mapping[str, float]] | None = None,
    options: Mapping[str, Any] | None = None,
    workers: int | None = 0,
    limit: float = LIMIT,
) -> pd.DataFrame:
    """Try a schedule at its speeds and between them.

    Args:
        evaluator_at: the loop at a speed.
        table: the schedule.
        cost: see :func:`mirdrake.tuning.search.search`.
        constraints: see there.
        between: speeds in each gap.
        others: constant gains to compare with, by name.
        options: further arguments of the evaluators.
        workers: see :func:`mirdrake.tuning.search.search`.
        limit: see there.

    Returns:
        A row a speed and set of gains, columns speed [m/s], gains ("scheduled", or a name of `others`), where ("tuned"
        or "between"), the gains, cost, violation, feasible, status, reason.

    Raises:
        ConfigError: no such figure.
    """
    speeds = sorted({*table.speeds, *table.between(between)})
    sets = {
        (speed, name): gains
        for speed in speeds
        for name, gains in {"scheduled": table.at(speed), **(others or {})}.items()
    }
    tasks = {key: (gains, {**(options or {}), "speed": key[0]}) for key, gains in sets.items()}
    journal = Journal(None, {})
    with open_executor(None, workers, calls=len(tasks), limit=limit) as (runner, ahead):
        evaluate = _BySpeed({speed: evaluator_at(speed) for speed in speeds})
        Evaluations(evaluate, journal, runner, ahead, total=len(tasks)).make(tasks)
    rows = []
    for (speed, name), gains in sets.items():
        trial = judge(0, gains, journal[speed, name], cost, constraints or {})
        rows.append(
            {"speed": speed, "gains": name, "where": "tuned" if speed in table.speeds else "between", **gains}
            | trial.verdict()
        )
    return pd.DataFrame(rows)


@dataclass(frozen=True)
class _BySpeed:
    """Evaluates at the speed that it is given with the gains."""

    evaluators: dict[float, Evaluator]

    def __call__(self, gains: Mapping[str, float], *, speed: float, **options: Any) -> Evaluation:
        return self.evaluators[speed](gains, **options)


class ScheduledPid(DiscretePid):
    """A PID controller whose gains follow a :class:`GainTable`.

    In a diagram file::

        systems:
          cruise: {kind: "mirdrake.tuning.schedule:ScheduledPid", speeds: [5, 25], kp: [2, 1], period: 0.02}

    Input ports:
        reference (1), measurement (1): see :class:`~mirdrake.controllers.pid.DiscretePid`.
        schedule (1) [m/s]: the speed at which the gains are read, at every update; the control does not jump.

    Output ports:
        control (1): see there.

    Args:
        speeds: of the table [m/s], rising.
        kp: proportional gain at each speed.
        ki: integral gain; 0 if left out, as the next.
        kd: derivative gain.
        period: time between updates [s].
        filter_time: of the derivative [s].
        minimum: smallest control.
        maximum: largest control.

    Raises:
        ConfigError: speeds that do not rise, rows of other lengths, or values out of range.
    """

    def __init__(
        self,
        speeds: Sequence[float],
        kp: Sequence[float],
        ki: Sequence[float] | None = None,
        kd: Sequence[float] | None = None,
        *,
        period: float,
        filter_time: float = 0.0,
        minimum: float = -math.inf,
        maximum: float = math.inf,
    ) -> None:
        given = {"kp": kp, "ki": ki, "kd": kd}
        rows = {name: tuple(map(float, values)) for name, values in given.items() if values is not None}
        self.table = GainTable(tuple(map(float, speeds)), rows)
        self._filter_time = filter_time
        limits = PidLimits(minimum, maximum) if (minimum, maximum) != (-math.inf, math.inf) else NO_LIMITS
        super().__init__(self._gains_at(self.table.speeds[0]), period=period, limits=limits)
        self.schedule = declare_vector_input(self, "schedule", signals(("speed", "m/s")))

    def get_gains(self, context: Context) -> PidGains:
        """The gains of the table at the speed of the input port."""
        return self._gains_at(self.schedule.Eval(context).item())

    def _gains_at(self, speed: float) -> PidGains:
        return PidGains(**self.table.at(speed), filter_time=self._filter_time)
