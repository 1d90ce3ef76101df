"""Simulations for published figures: the manoeuvre of each quantity, and the value of each figure from its run."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mirdrake.core.constants import GRAVITY
from mirdrake.manoeuvres.base import Chart, Curve, Diverged, ManoeuvreSpec, Outcome
from mirdrake.manoeuvres.metrics.straight import (
    FOOT,
    KMH,
    MOVED,
    coast_times,
    moves_off,
    time_to_distance,
    time_to_speed,
)
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
from mirdrake.manoeuvres.registry import run_manoeuvre
from mirdrake.manoeuvres.rig import Rig
from mirdrake.manoeuvres.steady_circle import SteadyStateCircleSpec
from mirdrake.manoeuvres.straight import AccelerationSpec, BrakingSpec, CoastDownSpec

_MARGIN = 3.0 * KMH
"""Extension of a coast-down beyond the speeds that the figures need [m/s]."""


@dataclass(frozen=True)
class Reading:
    """Simulated value of a figure [SI] and a remark; or None and the reason for the missing value."""

    value: float | None
    note: str = ""


@dataclass(frozen=True)
class Drive:
    """Manoeuvre that was driven: its outcome, its records and its rig."""

    outcome: Outcome
    records: Sequence[Record]
    rig: Rig


def _drive_top_speed(rig: Rig) -> Outcome:
    """Drive with full throttle from just below the estimated top speed until the speed is constant."""
    outcome = Outcome("top_speed", "Top speed", "full throttle on the flat, no wind")
    if not rig.pedals:
        outcome.verdict = "not possible"
        outcome.reason = "the vehicle has no pedals: its speed control limits the speed, not its motor"
        return outcome
    # Starting just below the estimated top speed saves simulating the acceleration up to it.
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
    # A mean over 2 s, as the last sample alone may be anywhere within a ripple.
    last = record.time > record.time[-1] - 2.0
    outcome.add("top_speed", "Speed over the last 2 s", float(np.mean(record.vx[last])) / KMH, "km/h")
    outcome.charts.append(Chart("Time", "s", "Speed", "km/h", (Curve("Speed", record.time, record.vx / KMH),)))
    return outcome


def run_figures(figures: Sequence[Figure], rig: Rig) -> tuple[Drive, list[Reading]]:
    """Drive one manoeuvre, and return it with the readings of figures that have the same key of the simulation.

    Args:
        figures: figures, at least one.
        rig: rig with their payload and the folder of the run.

    Raises:
        ConfigError: a setting is out of range.
    """
    before = len(rig.records)
    name, spec = _spec(figures)
    outcome = run_manoeuvre(name, rig, spec) if spec is not None else _drive_top_speed(rig)
    drive = Drive(outcome, rig.records[before:], rig)
    if outcome.verdict in {"not possible", "diverged"}:
        return drive, [Reading(None, outcome.reason) for _ in figures]
    return drive, [_read(figure, drive) for figure in figures]


def _spec(figures: Sequence[Figure]) -> tuple[str, ManoeuvreSpec | None]:
    """Return name and settings of the manoeuvre that the figures need; no settings for the top speed."""
    first = figures[0]
    if isinstance(first, TopSpeed):
        return "top_speed", None
    if isinstance(first, BrakingDistance):
        # The figures of the manoeuvre at other speeds are not needed.
        return "braking", BrakingSpec(speed=first.speed, others=())
    if isinstance(first, LateralLimit):
        # The range of the fit lies below the published limit, whatever its size.
        limit = first.si
        return "steady_state_circle", SteadyStateCircleSpec(
            radius=0.5 * first.diameter,
            limit=1.5 * limit,
            first_lateral=0.5 * limit,
            fit_from=0.52 * limit,
            fit_to=0.7 * limit,
        )
    if isinstance(first, CoastTime | RoadLoad):
        # The fit of the road load needs the speeds of all figures, with a margin for their crossings.
        speeds = [speed for figure in figures for speed in _coasted(figure)]
        low = min(speeds)
        return "coast_down", CoastDownSpec(speed=max(speeds) + _MARGIN, last=max(low - _MARGIN, 0.5 * low))
    return "acceleration", AccelerationSpec()


def _coasted(figure: Figure) -> tuple[float, float]:
    """Return the speeds between which a car has to coast for a figure [m/s]."""
    if isinstance(figure, CoastTime):
        return figure.first, figure.last
    assert isinstance(figure, RoadLoad)
    return 1.1 * figure.speed, 0.5 * figure.speed


def _read(figure: Figure, drive: Drive) -> Reading:
    """Return the simulated value of a figure."""
    outcome = drive.outcome
    if isinstance(figure, TopSpeed):
        return _metric(outcome, "top_speed", KMH)
    if isinstance(figure, BrakingDistance):
        key = f"{figure.speed / KMH:.0f}"
        mean = outcome.value(f"mean_{key}")
        return Reading(outcome.value(f"distance_{key}"), f"mean {mean:.2f} m/s²" if mean is not None else "")
    if isinstance(figure, LateralLimit):
        return _metric(outcome, "largest", GRAVITY)
    record = drive.records[0]
    if isinstance(figure, RoadLoad):
        a, b, c = (outcome.value(key) or 0.0 for key in "abc")
        # The published road load is a force at one speed; the fit has it as a polynomial.
        return Reading(a + b * figure.speed + c * figure.speed**2)
    if isinstance(figure, CoastTime):
        took = coast_times(record.time, record.vx, [(figure.first, figure.last)])[0]
        parameters = drive.rig.facts.parameters
        rotating = f"with {parameters.rotating_mass:.0f} kg of rotating parts"
        if figure.rotating_mass:
            return _number(took, rotating)

        # Coasting time is proportional to the inertia: remove the share of the rotating parts.
        reduced = took * parameters.mass / (parameters.mass + parameters.rotating_mass)
        return _number(reduced, f"{took:.1f} s {rotating}")
    return _accelerated(figure, record)


def _accelerated(figure: TimeToSpeed | TimeToDistance | SpeedAtDistance, record: Record) -> Reading:
    # Magazines start the clock at the first movement, or after a rollout of one foot.
    begin = moves_off(record.time, record.vx, MOVED)
    roll = time_to_distance(record.time, record.distance, FOOT, start=begin)
    reached = f"it reached {float(np.max(record.vx)) / KMH:.0f} km/h"
    if isinstance(figure, TimeToSpeed):
        took = time_to_speed(record.time, record.vx, figure.speed, start=begin)
        return _number(took - figure.rollout * roll, "" if math.isfinite(took) else reached)
    if isinstance(figure, TimeToDistance):
        took = time_to_distance(record.time, record.distance, figure.distance, start=begin)
        # With rollout the distance is measured from the end of the first foot, not only the time.
        if figure.rollout:
            took = time_to_distance(record.time, record.distance, figure.distance, start=begin + roll)
        other = f"{took - roll:.2f} s less the first foot" if not figure.rollout else ""
        return _number(took, other if math.isfinite(took) else "it did not cover the distance")
    took = time_to_distance(record.time, record.distance, figure.distance, start=begin)
    if not math.isfinite(took):
        return Reading(None, "it did not cover the distance")
    return Reading(float(np.interp(begin + took, record.time, record.vx)))


def _metric(outcome: Outcome, key: str, factor: float) -> Reading:
    value = outcome.value(key)
    return Reading(None, "the run has no such figure") if value is None else Reading(factor * value)


def _number(value: float, note: str) -> Reading:
    return Reading(value, note) if math.isfinite(value) else Reading(None, note)
