"""The simulations behind published figures: one manoeuvre a run, and how each figure is read from it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mirdrake.core.constants import GRAVITY
from mirdrake.manoeuvres.base import Chart, Curve, Diverged, ManoeuvreSpec, Outcome
from mirdrake.manoeuvres.metrics.straight import (
    FOOT,
    MOVED,
    coast_times,
    moves_off,
    time_to_distance,
    time_to_speed,
)
from mirdrake.manoeuvres.metrics.straight import KMH as _KMH
from mirdrake.manoeuvres.published import (
    BrakingDistance,
    CoastTime,
    Figure,
    LateralLimit,
    RoadLoad,
    SpeedAtDistance,
    TimeToDistance,
    TimeToSpeed,
    TopSpeed,
)
from mirdrake.manoeuvres.record import Record
from mirdrake.manoeuvres.registry import MANOEUVRES, run_manoeuvre
from mirdrake.manoeuvres.rig import Rig

_MARGIN = 3.0 * _KMH


@dataclass(frozen=True)
class Reading:
    """What the simulation has for a figure: a value [SI] or None, and a note or the reason why there is none."""

    value: float | None
    note: str = ""


@dataclass(frozen=True)
class Drive:
    """A run with what came of it."""

    outcome: Outcome
    records: Sequence[Record]
    rig: Rig


def _drive_top_speed(rig: Rig) -> Outcome:
    """Full throttle from just below the estimated top speed until it stays."""
    outcome = Outcome("top_speed", "Top speed", "full throttle on the flat, no wind")
    if not rig.pedals:
        outcome.verdict = "not possible"
        outcome.reason = "it has no pedals: its speed control limits the speed, not its motor"
        return outcome
    length, base = 40.0, rig.folder
    line = {"kind": "straight", "length": 1.5 * rig.facts.top_speed * length}
    driver = rig.line_driver(line, pedals=[[0.0, 1.0, 0.0, 1.0]])
    rig.folder = base / outcome.name if base is not None else None
    try:
        record = rig.run("full_throttle", driver, duration=length, speed=0.95 * rig.facts.top_speed)
    except Diverged as error:
        outcome.verdict, outcome.reason = "diverged", str(error)
        return outcome
    finally:
        rig.folder = base
    last = record.time > record.time[-1] - 2.0
    outcome.add("top_speed", "Speed over the last 2 s", float(np.mean(record.vx[last])) / _KMH, "km/h")
    outcome.charts.append(Chart("Time", "s", "Speed", "km/h", (Curve("Speed", record.time, record.vx / _KMH),)))
    return outcome


def run_figures(figures: Sequence[Figure], rig: Rig) -> tuple[Drive, list[Reading]]:
    """Drive once, and read all figures from it; they must have equal runs.

    Args:
        figures: at least one.
        rig: with their payload; what is written goes into its folder.

    Raises:
        ConfigError: a setting makes no sense.
    """
    before = len(rig.records)
    name, spec = _spec(figures)
    outcome = run_manoeuvre(name, rig, spec) if spec is not None else _drive_top_speed(rig)
    drive = Drive(outcome, rig.records[before:], rig)
    if outcome.verdict in {"not possible", "diverged"}:
        return drive, [Reading(None, outcome.reason) for _ in figures]
    return drive, [_read(figure, drive) for figure in figures]


def _spec(figures: Sequence[Figure]) -> tuple[str, ManoeuvreSpec | None]:
    """Name and settings of the manoeuvre that shows all of them; no settings for the top speed."""
    first = figures[0]
    settings: dict[str, Any] = {}
    name = "acceleration"
    if isinstance(first, TopSpeed):
        return "top_speed", None
    if isinstance(first, BrakingDistance):
        name, settings = "braking", {"speed": first.speed, "others": ()}
    elif isinstance(first, LateralLimit):
        limit = first.si
        settings = {"radius": 0.5 * first.diameter, "limit": 1.5 * limit, "first_lateral": 0.5 * limit}
        name, settings = "steady_state_circle", settings | {"fit_from": 0.52 * limit, "fit_to": 0.7 * limit}
    elif isinstance(first, CoastTime | RoadLoad):
        speeds = [speed for one in figures for speed in _coasted(one)]
        low = min(speeds)
        name, settings = "coast_down", {"speed": max(speeds) + _MARGIN, "last": max(low - _MARGIN, 0.5 * low)}
    return name, MANOEUVRES[name](**settings)


def _coasted(figure: Figure) -> tuple[float, float]:
    """Speeds between which a car has to coast for a figure [m/s]."""
    if isinstance(figure, CoastTime):
        return figure.first, figure.last
    assert isinstance(figure, RoadLoad)
    return 1.1 * figure.speed, 0.5 * figure.speed


def _read(figure: Figure, drive: Drive) -> Reading:
    """One figure of a run that was driven."""
    outcome = drive.outcome
    if isinstance(figure, TopSpeed):
        return _metric(outcome, "top_speed", _KMH)
    if isinstance(figure, BrakingDistance):
        mean = outcome.value(f"mean_{figure.speed / _KMH:.0f}")
        return Reading(
            outcome.value(f"distance_{figure.speed / _KMH:.0f}"), f"mean {mean:.2f} m/s²" if mean is not None else ""
        )
    if isinstance(figure, LateralLimit):
        return _metric(outcome, "largest", GRAVITY)
    record = drive.records[0]
    if isinstance(figure, RoadLoad):
        a, b, c = (outcome.value(key) or 0.0 for key in "abc")
        return Reading(a + b * figure.speed + c * figure.speed**2)
    if isinstance(figure, CoastTime):
        took = coast_times(record.time, record.vx, [(figure.first, figure.last)])[0]
        parameters = drive.rig.facts.parameters
        turning = f"{parameters.rotating_mass:.0f} kg that rotate"
        if figure.rotating_mass:
            return _number(took, f"with {turning}")
        reduced = took * parameters.mass / (parameters.mass + parameters.rotating_mass)
        return _number(reduced, f"{took:.1f} s as driven, with {turning}")
    return _accelerated(figure, record)


def _accelerated(figure: TimeToSpeed | TimeToDistance | SpeedAtDistance, record: Record) -> Reading:
    begin = moves_off(record.time, record.vx, MOVED)
    roll = time_to_distance(record.time, record.distance, FOOT, start=begin)
    reached = f"it reached {float(np.max(record.vx)) / _KMH:.0f} km/h"
    if isinstance(figure, TimeToSpeed):
        took = time_to_speed(record.time, record.vx, figure.speed, start=begin)
        return _number(took - figure.rollout * roll, "" if math.isfinite(took) else reached)
    if isinstance(figure, TimeToDistance):
        took = time_to_distance(record.time, record.distance, figure.distance, start=begin)
        if figure.rollout:
            took = time_to_distance(record.time, record.distance, figure.distance, start=begin + roll)
        other = f"{took - roll:.2f} s less the first foot" if not figure.rollout else ""
        return _number(took, other if math.isfinite(took) else "it did not get that far")
    took = time_to_distance(record.time, record.distance, figure.distance, start=begin)
    if not math.isfinite(took):
        return Reading(None, "it did not get that far")
    return Reading(float(np.interp(begin + took, record.time, record.vx)))


def _metric(outcome: Outcome, key: str, factor: float) -> Reading:
    value = outcome.value(key)
    return Reading(None, "the run gave none") if value is None else Reading(factor * value)


def _number(value: float, note: str) -> Reading:
    return Reading(value, note) if math.isfinite(value) else Reading(None, note)
