"""Ride: a rough road and a single bump."""

import math
from typing import Any, ClassVar

import numpy as np

from mirdrake.core.constants import GRAVITY
from mirdrake.core.yaml_io import Duration, Length, Speed
from mirdrake.ground import Terrain
from mirdrake.ground.roughness import ROUGHNESS, Roughness, RoughnessClass
from mirdrake.ground.roughness_index import roughness_index
from mirdrake.manoeuvres.base import (
    Array,
    Chart,
    Curve,
    ManoeuvreSpec,
    NotFeasible,
    Outcome,
    setting,
    time_step_setting,
)
from mirdrake.manoeuvres.checks import check_speed
from mirdrake.manoeuvres.metrics.ride import WD, WK, body_acceleration, comfort, third_octaves, weighted
from mirdrake.manoeuvres.metrics.straight import KMH
from mirdrake.manoeuvres.record import Record
from mirdrake.manoeuvres.rig import Rig
from mirdrake.vehicles import WHEELS

_PROFILE = 0.05  # spacing of the profiles of the IRI [m]
_WORDS = {wheel: wheel.replace("_", " ") for wheel in WHEELS}


class _Ride(ManoeuvreSpec):
    """Settings of both manoeuvres: the place of the driver."""

    standard: ClassVar[str] = "ISO 2631-1"
    uneven: ClassVar[bool] = True

    seat_x: Length = setting(1.2, "place of the driver ahead of the rear axle", "m", "own")
    seat_y: Length = setting(0.35, "the same, to the left of the middle", "m", "own")
    seat_z: Length = setting(0.3, "the same, above the road: the floor", "m", "own")

    def run(self, rig: Rig, label: str, speed: float, *, length: float, relief: list[Any]) -> Record:
        """Return the record of a straight drive at a speed [m/s] over a length [m] from x = 0 on a relief."""
        if rig.kind == "single_track":
            raise NotFeasible("the single-track model has no vertical motion")
        check_speed(rig.facts, speed)
        driver = rig.line_driver({"kind": "straight", "length": length + 50.0}, speed=speed, speeds=[[0.0, speed]])
        return rig.run(label, driver, duration=length / speed, speed=speed, ground={"relief": relief})

    @property
    def seat(self) -> tuple[float, float, float]:
        """Place of the driver in the vehicle frame [m]."""
        return self.seat_x, self.seat_y, self.seat_z


class RoughRoadSpec(_Ride):
    """Constant speed on a straight road of a roughness class of ISO 8608."""

    title: ClassVar[str] = "Rough road"
    standard: ClassVar[str] = "ISO 8608, ISO 2631-1"
    headline: ClassVar[tuple[str, ...]] = ("vertical", "total", "load_variation")

    speed: Speed = setting(80.0 * KMH, "speed of the test", "m/s", "own", gt=0.0)
    roughness: RoughnessClass = setting("C", "class of ISO 8608: A (smooth) to E (rough)", "", "own")
    length: Length = setting(200.0, "length of the evaluated road", "m", "own", ge=20.0)
    run_up: Duration = setting(2.0, "time before the evaluation, in which the start decays", "s", "own", ge=0.0)
    time_step: Duration = time_step_setting(0.00125, "wheels that hop need it")

    def drive(self, rig: Rig, outcome: Outcome) -> None:
        """Simulate one run."""
        rig = rig.with_step(self.time_step)
        total = self.run_up * self.speed + self.length
        # A road of all lengths times λ has λ times the density: Gd(n) is in m³ and falls with n².
        density = ROUGHNESS[self.roughness] * rig.facts.scale
        relief = [{"roughness": {"density": density, "seed": rig.seed}}]
        record = self.run(rig, "rough", self.speed, length=total, relief=relief)
        shown = record.time >= self.run_up
        step, acceleration = record.step, body_acceleration(record, self.seat)
        # The filters see the run-up as well, so that they have settled where the evaluation begins.
        behind = shown[1:]
        filtered = [weighted(acceleration[:, i], step, WD if i < 2 else WK)[behind] for i in range(3)]
        x, y, z = (comfort(values, step) for values in filtered)
        outcome.add("vertical", "Weighted vertical acceleration, rms", z.rms, "m/s²", "Wk, at the driver's floor")
        outcome.add("lateral", "Weighted lateral acceleration, rms", y.rms, "m/s²", "Wd", scale=z.rms)
        outcome.add("longitudinal", "Weighted longitudinal acceleration, rms", x.rms, "m/s²", "Wd", scale=z.rms)
        outcome.add("total", "Vibration total value", math.hypot(x.rms, y.rms, z.rms), "m/s²", "comfort: k = 1")
        outcome.add("crest", "Crest factor of the vertical acceleration", z.crest, "", "above 9 the rms is too low")
        outcome.add("transient", "Largest vertical rms over 1 s (MTVV)", z.transient, "m/s²")
        outcome.add("dose", "Vertical vibration dose value", z.dose, "m/s^1.75", f"of {self.length / self.speed:.1f} s")
        plain = float(np.sqrt(np.mean(acceleration[behind, 2] ** 2)))
        outcome.add("unweighted", "Vertical acceleration without weighting, rms", plain, "m/s²")
        _add_load_variation(outcome, record, shown)
        _add_load_limits(outcome, record, shown)
        _add_travel_rms(outcome, record, shown)
        _add_travel_limits(outcome, record, shown)
        tracks = _profiles(record, shown, rig, density)
        index = float(np.mean([roughness_index(track, _PROFILE) for track in tracks]))
        outcome.add("iri", "International Roughness Index of the road", index, "m/km", "mean of both wheel tracks")
        _bands_chart(outcome, acceleration[behind, 2], filtered[2], step)
        _time_charts(outcome, record, shown, acceleration[:, 2])


class SingleBumpSpec(_Ride):
    """Constant speed over one bump across the road, height (1 - cos(2 π x / length)) / 2."""

    title: ClassVar[str] = "Single bump"
    headline: ClassVar[tuple[str, ...]] = ("peak_up", "transient", "load_peak")

    speed: Speed = setting(20.0 * KMH, "speed of the test", "m/s", "own", gt=0.0)
    height: Length = setting(0.075, "height of the bump", "m", "own", gt=0.0, le=1.0)
    bump: Length = setting(0.6, "length of the bump", "m", "own", gt=0.0)
    before: Duration = setting(1.0, "time before the bump", "s", "own", gt=0.0)
    after: Duration = setting(2.0, "time after the rear wheels have left it", "s", "own", gt=0.0)
    time_step: Duration = time_step_setting(0.00125, "the impact needs it")

    def drive(self, rig: Rig, outcome: Outcome) -> None:
        """Simulate one run."""
        rig = rig.with_step(self.time_step)
        # The vehicle frame is at the rear axle, so the front wheels are a wheelbase closer to the bump.
        start = self.before * self.speed + rig.facts.wheelbase
        total = start + self.bump + self.after * self.speed
        relief = [{"bump": {"at": [start, 0.0], "length": self.bump, "height": self.height, "width": 100.0}}]
        record = self.run(rig, "bump", self.speed, length=total, relief=relief)
        acceleration, step = body_acceleration(record, self.seat), record.step
        vertical, wk = acceleration[:, 2], weighted(acceleration[:, 2], step, WK)
        z = comfort(wk, step)
        outcome.add("peak_up", "Largest vertical acceleration", float(vertical.max()), "m/s²", "at the driver's floor")
        outcome.add(
            "peak_down",
            "Smallest vertical acceleration",
            float(vertical.min()),
            "m/s²",
            f"free fall: {-GRAVITY:.2f} m/s²",
        )
        outcome.add("peak_weighted", "Largest weighted vertical acceleration", z.peak, "m/s²", "Wk")
        outcome.add("transient", "Largest weighted vertical rms over 1 s (MTVV)", z.transient, "m/s²")
        outcome.add("dose", "Vertical vibration dose value", z.dose, "m/s^1.75")
        pitch = np.degrees(record.others["pitch"])
        outcome.add("pitch", "Pitch, peak to peak", float(np.ptp(pitch)), "deg")
        shown = np.ones(len(record.time), dtype=bool)
        _add_load_limits(outcome, record, shown)
        _add_travel_limits(outcome, record, shown)
        _time_charts(outcome, record, shown, vertical)
        curve = Curve("Pitch", record.time, pitch)
        outcome.charts.append(Chart("Time", "s", "Pitch", "deg", (curve,)))


def _add_load_variation(outcome: Outcome, record: Record, shown: Any) -> None:
    """Add the variation of the load of each wheel, and its mean."""
    loads = {wheel: record.others[f"wheel_load.{wheel}"][shown] for wheel in WHEELS}
    variation = {wheel: 100.0 * float(np.std(load) / np.mean(load)) for wheel, load in loads.items()}
    mean = float(np.mean(list(variation.values())))
    outcome.add("load_variation", "Wheel-load variation, mean of the wheels", mean, "%", "rms over mean")
    for wheel, value in variation.items():
        outcome.add(f"load_variation.{wheel}", f"Wheel-load variation, {_WORDS[wheel]}", value, "%", "rms over mean")


def _add_load_limits(outcome: Outcome, record: Record, shown: Any) -> None:
    """Add the largest and smallest wheel load, and the longest total time of a wheel in the air."""
    loads = [record.others[f"wheel_load.{wheel}"][shown] for wheel in WHEELS]
    highest, lowest = max(float(np.max(load)) for load in loads), min(float(np.min(load)) for load in loads)
    outcome.add("load_peak", "Largest wheel load", highest, "N")
    outcome.add("load_least", "Smallest wheel load", lowest, "N", scale=float(np.mean(loads)))
    air = max(time_in_air(load) for load in loads) * record.step
    outcome.add("air", "Longest time of a wheel in the air", air, "s", "in total", scale=0.1)


def time_in_air(load: Array) -> float:
    """Return the number of sampling intervals without a wheel load; lines through its last samples give both ends.

    Args:
        load: wheel load at even times [N]; zero in the air.
    """
    total = 0.0
    for values in (load, load[::-1]):  # ends, then begins
        first = np.flatnonzero((values[1:-1] > 0.0) & (values[2:] <= 0.0)) + 1
        # Interval from the last sample with a load, less the part in which the line through the last two is above zero.
        fall = values[first - 1] - values[first]
        contact = np.divide(values[first], fall, out=np.full(len(first), 0.5), where=fall > values[first])
        total += float(np.sum(1.0 - contact))
    inside = (load[1:] <= 0.0) & (load[:-1] <= 0.0)
    return total + float(np.count_nonzero(inside))


def _travels(record: Record, shown: Any) -> dict[str, list[Array]]:
    """Return the travels of the wheels of each axle [m]; none without springs."""
    travels = {}
    for axle in ("front", "rear"):
        sides = [record.others.get(f"travel.{axle}_{side}") for side in ("left", "right")]
        travels[axle] = [side[shown] for side in sides if side is not None]
    return {axle: sides for axle, sides in travels.items() if sides}


def _add_travel_rms(outcome: Outcome, record: Record, shown: Any) -> None:
    """Add the rms of the suspension travel of each axle."""
    for axle, sides in _travels(record, shown).items():
        rms = 1e3 * float(np.sqrt(np.mean([np.var(side) for side in sides])))
        outcome.add(f"travel_rms_{axle}", f"Suspension travel, {axle}, rms", rms, "mm", "about its mean")


def _add_travel_limits(outcome: Outcome, record: Record, shown: Any) -> None:
    """Add the largest bump and rebound travel of each axle."""
    for axle, sides in _travels(record, shown).items():
        bump, rebound = (1e3 * float(end) for end in (np.max(sides), np.min(sides)))
        size = bump - rebound
        outcome.add(f"travel_bump_{axle}", f"Largest bump travel, {axle}", bump, "mm", scale=size)
        outcome.add(f"travel_rebound_{axle}", f"Largest rebound travel, {axle}", rebound, "mm", scale=size)


def _profiles(record: Record, shown: Any, rig: Rig, density: float) -> list[Array]:
    """Return the heights of the ground along the tracks of the left and right front wheels [m]."""
    terrain = Terrain(list(Roughness(density, rig.seed).grids()))
    first, last = float(record.x[shown][0]), float(record.x[shown][-1])
    x = np.arange(first, last, _PROFILE)
    half = 0.5 * rig.vehicle.geometry.front_track
    y = np.interp(x, record.x, record.y)
    return [terrain.height(x, y + side * half) for side in (1.0, -1.0)]


def _bands_chart(outcome: Outcome, vertical: Array, filtered: Array, step: float) -> None:
    """Add the chart of the vertical acceleration by third octaves."""
    centres, plain = third_octaves(vertical, step)
    _, weighted_bands = third_octaves(filtered, step)
    curves = (Curve("unweighted", centres, plain), Curve("weighted (Wk)", centres, weighted_bands, colour=1))
    outcome.charts.append(Chart("Frequency", "Hz", "Vertical acceleration by third octaves", "m/s²", curves, log=True))


def _time_charts(outcome: Outcome, record: Record, shown: Any, vertical: Array) -> None:
    """Add charts of vertical acceleration, wheel loads and travels over time."""
    time = record.time[shown]
    curve = Curve("", record.time[1:][shown[1:]], vertical[shown[1:]])
    outcome.charts.append(Chart("Time", "s", "Vertical acceleration", "m/s²", (curve,)))
    for key, label, unit, factor in (
        ("wheel_load", "Wheel load", "kN", 1e-3),
        ("travel", "Suspension travel", "mm", 1e3),
    ):
        lines = [
            Curve(_WORDS[wheel], time, factor * record.others[f"{key}.{wheel}"][shown], colour=colour)
            for colour, wheel in enumerate(("front_left", "rear_left"))
            if f"{key}.{wheel}" in record.others
        ]
        if lines:
            outcome.charts.append(Chart("Time", "s", label, unit, tuple(lines)))
