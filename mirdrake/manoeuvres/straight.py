"""Straight ahead: coast-down, acceleration, braking, braking on split friction."""

import math
from collections.abc import Sequence
from typing import Any, ClassVar, Literal

import numpy as np

from mirdrake.core.yaml_io import Duration, Length, Speed
from mirdrake.manoeuvres.base import Chart, Curve, ManoeuvreSpec, NotFeasible, Outcome, setting
from mirdrake.manoeuvres.checks import check_entry, check_speed
from mirdrake.manoeuvres.metrics.straight import (
    FOOT,
    KMH,
    MILE,
    MOVED,
    MPH,
    coast_times,
    moves_off,
    road_load,
    stop_from,
    time_to_distance,
    time_to_speed,
)
from mirdrake.manoeuvres.metrics.transient import crossing
from mirdrake.manoeuvres.record import Record
from mirdrake.manoeuvres.rig import Rig

_LINE = {"kind": "straight", "length": 1.0}
_STEADY_HANDS = {"course": 0.0, "preview": 0.2}
"""How the driver of a brake test keeps to his line: he catches a car that turns before it has left it."""

_BEFORE = 0.3  # time before the brake is pressed [s]
_ROUND = math.radians(60.0)  # heading from which on a car does not come back, but turns round


def _line(length: float) -> dict[str, Any]:
    return _LINE | {"length": max(length, 10.0)}


class CoastDownSpec(ManoeuvreSpec):
    """Coasting in neutral: the road load F = A + B v + C v², and times from speed to speed."""

    title: ClassVar[str] = "Coast-down"
    standard: ClassVar[str] = "SAE J2263"
    headline: ClassVar[tuple[str, ...]] = ("force_100", "time_100_80")

    speed: Speed = setting(115.0 * KMH, "at the start", "m/s", "R", "SAE J2263", gt=0.0)
    last: Speed = setting(15.0 * KMH, "at the end", "m/s", "R", "SAE J2263", gt=0.0)
    rotating: bool = setting(True, "count the mass that rotates, reduced to the road", "", "own")
    longest: Duration = setting(400.0, "longest run", "s", "own", gt=0.0)

    def drive(self, rig: Rig, outcome: Outcome) -> None:
        """One run; on flat ground without wind both directions are alike."""
        if self.last >= self.speed:
            raise self.fault("last", "must be below speed")
        if not rig.pedals:
            raise NotFeasible("coasting needs pedals with a neutral gear; control.yaml has servos on its wheels")
        check_speed(rig.facts, self.speed)

        def stop(time: float, state: Sequence[float]) -> str | None:  # noqa: ARG001
            return "the last speed" if state[6] < self.last * 0.98 else None

        driver = rig.line_driver(_line(self.speed * self.longest), pedals=[[0.0, 0.0, 0.0, 0.0]])
        record = rig.run("coast", driver, duration=self.longest, speed=self.speed * 1.005, stop=stop)
        if record.vx[-1] > self.last:
            raise NotFeasible(f"after {self.longest:g} s it still coasted at {record.vx[-1] / KMH:.0f} km/h")
        parameters = rig.facts.parameters
        mass = parameters.mass + (parameters.rotating_mass if self.rotating else 0.0)
        chosen = (record.vx <= self.speed) & (record.vx >= self.last)
        load = road_load(record.time[chosen], record.vx[chosen], mass)
        outcome.add("a", "A", load.a, "N")
        outcome.add("b", "B", load.b, "N s/m")
        outcome.add("c", "C", load.c, "N s²/m²", f"rms of the speed {load.error:.3g} m/s")
        fast = 100.0 * KMH
        if self.last < fast < self.speed:
            outcome.add("force_100", "Road load at 100 km/h", load.at(fast), "N")
        added = f"with {parameters.rotating_mass:.0f} kg that rotate" if self.rotating else "without what rotates"
        outcome.add("mass", "Mass in the fit", mass, "kg", added)
        steps = [(self.speed, self.last)]
        steps += [(a * KMH, b * KMH) for a, b in ((100, 80), (80, 60), (60, 40), (40, 20)) if a * KMH < self.speed]
        for (high, low), took in zip(steps, coast_times(record.time, record.vx, steps), strict=True):
            name = f"{high / KMH:.0f}_{low / KMH:.0f}"
            outcome.add(f"time_{name}", f"Time from {high / KMH:.0f} to {low / KMH:.0f} km/h", took, "s")
        outcome.notes.append("one direction: flat ground, no wind")
        outcome.charts.append(Chart("Time", "s", "Speed", "km/h", (Curve("Speed", record.time, record.vx / KMH),)))
        v = np.linspace(self.last, self.speed, 50)
        force = Curve("A + B v + C v²", v / KMH, np.array([load.at(float(one)) for one in v]))
        outcome.charts.append(Chart("Speed", "km/h", "Road load", "N", (force,)))


class AccelerationSpec(ManoeuvreSpec):
    """Full throttle from standstill: times to speeds from first movement, less rollout, and from pedal application."""

    title: ClassVar[str] = "Acceleration"
    standard: ClassVar[str] = "0-100 km/h, 0-60 mph, quarter mile, as magazines measure"
    headline: ClassVar[tuple[str, ...]] = ("time_100kmh", "time_top", "quarter_mile")

    throttle: float = setting(1.0, "position of the pedal", "", "own", gt=0.0, le=1.0)
    wait: Duration = setting(1.0, "standing before", "s", "own", ge=0.0)
    rollout: Length = setting(
        FOOT, "way whose time is subtracted", "m", "E", "Edmunds, Car and Driver", scales=False, gt=0.0
    )
    longest: Duration = setting(60.0, "longest run", "s", "own", gt=0.0)
    time_step: Duration = setting(
        0.0025,
        "of the plant, unless plant.time_step is given; wheels that swing after a shift need it",
        "s",
        "own",
        scales=False,
        gt=0.0,
    )

    def drive(self, rig: Rig, outcome: Outcome) -> None:
        """One run."""
        rig = rig.with_step(self.time_step)
        facts = rig.facts
        fast, quarter = 100.0 * KMH, 0.25 * MILE
        wanted = min(fast, 0.97 * facts.top_speed)
        if facts.scale < 1.0:
            quarter *= facts.scale
            wanted = min(wanted, fast * facts.scale**0.5)
        driver: dict[str, Any]
        if rig.pedals:
            rows = [[0.0, 0.0, 0.3, 1.0], [self.wait, 0.0, 0.3, 1.0], [self.wait, self.throttle, 0.0, 1.0]]
            driver = rig.line_driver(_line(60.0 * self.longest), pedals=rows)
        else:
            top = min(1.2 * wanted, facts.top_speed)
            rows = [[0.0, 0.0], [self.wait, 0.0], [self.wait, top]]
            driver = rig.line_driver(_line(60.0 * self.longest), speeds=rows)
            outcome.notes.append("it has no pedals: the speed command steps up; its speed control limits the rise")

        def stop(time: float, state: Sequence[float]) -> str | None:  # noqa: ARG001
            return "all done" if state[6] > wanted * 1.001 and state[0] > quarter * 1.01 else None

        record = rig.run("full_throttle", driver, duration=self.longest, stop=stop)
        begin = moves_off(record.time, record.vx, MOVED)
        if not math.isfinite(begin):
            raise NotFeasible(f"it did not move off within {self.longest:g} s")
        roll = time_to_distance(record.time, record.distance, self.rollout, start=begin)
        pedal, pressed = begin - self.wait, "pedal application" if rig.pedals else "the speed command"
        reached = float(np.max(record.vx))
        speeds = [("30mph", 30.0 * MPH, "30 mph"), ("60mph", 60.0 * MPH, "60 mph"), ("75mph", 75.0 * MPH, "75 mph")]
        speeds.append(("100kmh", fast, "100 km/h"))
        if facts.scale < 1.0:
            speeds = [("top", wanted, f"{wanted / KMH:.1f} km/h")]
        for key, speed, text in speeds:
            took = time_to_speed(record.time, record.vx, speed, start=begin)
            if key == "75mph" and not math.isfinite(took):
                continue
            note = "from first movement" if math.isfinite(took) else f"it reached {reached / KMH:.0f} km/h"
            outcome.add(f"time_{key}", f"0 to {text}", took, "s", note)
            outcome.add(f"rollout_{key}", f"The same less the first {self.rollout:.4g} m", took - roll, "s")
            outcome.add(f"pedal_{key}", f"0 to {text} from {pressed}", took + pedal, "s")
        took = time_to_distance(record.time, record.distance, quarter, start=begin)
        name = "Quarter mile" if facts.scale == 1.0 else f"{quarter:.1f} m (a quarter mile to scale)"
        outcome.add("quarter_mile", name, took, "s")
        trap = float(np.interp(begin + took, record.time, record.vx)) if math.isfinite(took) else math.nan
        outcome.add("trap_speed", "Speed there", trap / KMH, "km/h", f"{trap / MPH:.1f} mph" if trap == trap else "")
        outcome.add("rollout_time", f"Time of the first {self.rollout:.4g} m", roll, "s")
        peak = float(np.max(record.longitudinal_acceleration[record.time > begin + 0.1]))
        outcome.add("peak", "Largest acceleration", peak, "m/s²")
        note = f"time counts from {MOVED:g} m/s on"
        outcome.add("begin", f"First movement after {pressed}", pedal, "s", note, scale=roll)
        shown = record.time > self.wait - 0.2
        _speed_charts(outcome, record, shown)


class BrakingSpec(ManoeuvreSpec):
    """Full braking to standstill: distances and decelerations."""

    title: ClassVar[str] = "Braking"
    standard: ClassVar[str] = "100-0 km/h and 60-0 mph; mean fully developed deceleration as in UN R13-H"
    headline: ClassVar[tuple[str, ...]] = ("distance_100", "mfdd")

    speed: Speed = setting(100.0 * KMH, "at which the distance begins", "m/s", "E", "Car and Driver, Edmunds", gt=0.0)
    others: tuple[float, ...] = setting(
        (60.0 * MPH, 30.0 * MPH), "further speeds from which distances are reported", "m/s", "E", "Edmunds"
    )
    brake: float = setting(1.0, "position of the pedal", "", "own", gt=0.0, le=1.0)
    lead: Speed = setting(3.0 * KMH, "faster than that when the brake is pressed", "m/s", "own", ge=0.0)
    lowest: float = setting(1.0, "deceleration below which it counts as not possible", "m/s²", "own", gt=0.0)

    def drive(self, rig: Rig, outcome: Outcome) -> None:
        """One run."""
        record = brake_run(rig, outcome, "brake", self.speed + self.lead, self.brake, lowest=self.lowest)
        speeds = [self.speed, *(one for one in self.others if one < self.speed + 0.9 * self.lead)]
        for number, speed in enumerate(speeds):
            found = stop_from(record.time, record.vx, record.distance, speed)
            text = f"{speed / KMH:.1f} km/h ({speed / MPH:.0f} mph)" if number else f"{speed / KMH:.4g} km/h"
            key = f"{speed / KMH:.0f}"
            outcome.add(f"distance_{key}", f"From {text} to standstill", found.distance, "m")
            if number == 0:
                outcome.add("time", "Time", found.time, "s")
            outcome.add(f"mean_{key}", "Mean deceleration of the distance", found.mean, "m/s²", text)
            if number == 0:
                outcome.add(
                    "mfdd", "Mean fully developed deceleration", found.developed, "m/s²", "80 to 10 % of the speed"
                )
        sideways = float(np.max(np.abs(record.y)))
        outcome.add("sideways", "Largest offset to the side", sideways, "m", scale=rig.facts.width)
        locked = _locked(record)
        if locked:
            outcome.notes.append(f"wheels locked: {', '.join(locked)}")
        _speed_charts(outcome, record, record.time >= 0.0)


class SplitFrictionSpec(ManoeuvreSpec):
    """Full braking with the left wheels on a slippery strip: deceleration, yaw and lateral displacement."""

    title: ClassVar[str] = "Braking on split friction"
    standard: ClassVar[str] = "after UN R13-H and ISO 14512; numbers are a choice of this program"
    headline: ClassVar[tuple[str, ...]] = ("distance", "sideways")

    speed: Speed = setting(80.0 * KMH, "when the brake is pressed", "m/s", "own", gt=0.0)
    brake: float = setting(1.0, "position of the pedal", "", "own", gt=0.0, le=1.0)
    slippery: float = setting(0.25, "friction under the left wheels", "", "own", gt=0.0, le=2.0)
    hands: Literal["corrects", "fixed"] = setting("corrects", "what the driver does with the wheel", "", "own")
    sideways: Length = setting(1.75, "largest offset that passes: half a lane", "m", "own", gt=0.0)
    yaw: float = setting(math.radians(15.0), "largest heading error that passes", "rad", "own", gt=0.0)
    lowest: float = setting(0.5, "deceleration below which it counts as not possible", "m/s²", "own", gt=0.0)
    time_step: Duration = setting(
        0.00125,
        "of the plant, unless plant.time_step is given; the first steering and a spin need it",
        "s",
        "own",
        scales=False,
        gt=0.0,
    )

    def drive(self, rig: Rig, outcome: Outcome) -> None:
        """One run."""
        if rig.kind == "single_track":
            raise NotFeasible("the single-track model has one wheel an axle, none of them left or right")
        rig = rig.with_step(self.time_step)
        strip = {"rect": {"center": [2500.0, 50.0], "size": [6000.0, 100.0]}, "mu": self.slippery, "name": "slippery"}
        record = brake_run(
            rig,
            outcome,
            "split",
            self.speed,
            self.brake,
            lowest=self.lowest,
            hands=self.hands == "corrects",
            ground={"patches": [strip]},
            wide=4.0 * self.sideways,
        )
        heading = np.abs(record.yaw)
        turned = crossing(record.time, heading, _ROUND)  # from then on it spins, and the figures are those of a spin
        seen = ~(record.time > turned)
        offset, most = float(np.max(np.abs(record.y[seen]))), float(np.max(heading[seen]))
        angle, rate = np.abs(np.degrees(record.hand_wheel)), np.abs(np.degrees(record.yaw_rate))
        if math.isnan(turned):
            braking = stop_from(record.time, record.vx, record.distance, 0.95 * self.speed)
            driven = (record.vx > 0.2 * self.speed) & (record.vx < 0.8 * self.speed)
            steered = float(np.mean(np.degrees(record.hand_wheel[driven]))) if driven.any() else math.nan
            outcome.add("distance", f"From {0.95 * self.speed / KMH:.1f} km/h to standstill", braking.distance, "m")
            outcome.add("mean", "Mean deceleration", braking.mean, "m/s²")
            outcome.add("hand_wheel_mean", "Mean hand-wheel angle, 80 to 20 % of the speed", steered, "deg", "+ left")
        else:
            text = f"Time until it had turned by {math.degrees(_ROUND):.0f} deg, after which no figures are reported"
            outcome.add("turned", text, turned - _BEFORE, "s")
            offset, most = max(offset, abs(float(np.interp(turned, record.time, record.y)))), _ROUND
        outcome.add("sideways", "Largest offset to the side", offset, "m", f"at most {self.sideways:.3g} m")
        outcome.add(
            "yaw", "Largest heading error", math.degrees(most), "deg", f"at most {math.degrees(self.yaw):.0f} deg"
        )
        outcome.add("yaw_rate", "Largest yaw rate", float(np.max(rate[seen])), "deg/s")
        if not turned < _BEFORE + 1.0:
            later = float(np.interp(_BEFORE + 1.0, record.time, np.degrees(record.yaw)))
            outcome.add("yaw_1s", "Heading after 1 s of braking", later, "deg")
        outcome.add(
            "hand_wheel", "Largest hand-wheel angle", float(np.max(angle[seen])), "deg", "UN R13-H: 240 deg, recalled"
        )
        early = float(np.max(angle[seen & (record.time < _BEFORE + 2.0 + 1e-6)]))
        outcome.add("hand_wheel_2s", "The same in the first 2 s", early, "deg", "UN R13-H: 120 deg, recalled")
        locked = _locked(record)
        if locked:
            outcome.notes.append(f"wheels locked: {', '.join(locked)}")
        stays = offset <= self.sideways and most <= self.yaw
        outcome.verdict = "pass" if stays else "fail"
        if not stays:
            outcome.reason = f"it went {offset:.2f} m to the side and turned by {math.degrees(most):.0f} deg"
            outcome.reason += "" if math.isnan(turned) else " and on"
        _speed_charts(outcome, record, record.time >= 0.0)
        outcome.charts.append(Chart("x", "m", "y", "m", (Curve("middle of the rear axle", record.x, record.y),)))
        wheel = Curve("Hand-wheel angle", record.time, np.degrees(record.hand_wheel))
        outcome.charts.append(Chart("Time", "s", "Hand-wheel angle", "deg", (wheel,)))


def brake_run(
    rig: Rig,
    outcome: Outcome,
    label: str,
    speed: float,
    brake: float,
    *,
    lowest: float,
    hands: bool = True,
    ground: dict[str, Any] | None = None,
    wide: float = math.inf,
) -> Record:
    """Brake from a speed to the first standstill, from :data:`_BEFORE` on; the record ends there.

    Args:
        rig: where.
        outcome: gets a note if there are no pedals.
        label: of the run.
        speed: when the brake is pressed [m/s].
        brake: position of the pedal [1].
        lowest: deceleration [m/s²] below which this is not possible.
        hands: whether the driver corrects.
        ground: of the world.
        wide: offset to the side at which the run ends [m].
    """
    check_speed(rig.facts, speed)
    longest = _BEFORE + speed / lowest
    driver: dict[str, Any]
    if rig.pedals:
        rows = [[0.0, 0.0, 0.0, 0.0], [_BEFORE, 0.0, 0.0, 0.0], [_BEFORE, 0.0, brake, 0.0]]
        driver = rig.line_driver(_line(speed * longest), pedals=rows, hands=hands, **_STEADY_HANDS)
    else:
        rows = [[0.0, speed], [_BEFORE, speed], [_BEFORE, 0.0]]
        driver = rig.line_driver(_line(speed * longest), speeds=rows, hands=hands, **_STEADY_HANDS)
        outcome.notes.append("it has no pedals: the speed command steps to zero; its speed control limits the slope")

    stood: list[float] = []

    def stop(time: float, state: Sequence[float]) -> str | None:
        if abs(state[1]) > wide:
            return f"it went {wide:g} m to the side"
        if time > _BEFORE and state[6] < 0.01 and abs(state[7]) < 0.1:
            stood.append(time)
        return "standstill" if stood and (state[6] <= 0.0 or time > stood[0] + 0.1) else None

    record = rig.run(label, driver, duration=longest, speed=speed, ground=ground, stop=stop)
    check_entry(
        float(np.interp(_BEFORE, record.time, record.vx)), speed, 0.02 * speed, where="when the brake is pressed"
    )
    if record.stop == "duration" and record.vx[-1] > 0.05:
        raise NotFeasible(f"it still drove at {record.vx[-1] / KMH:.0f} km/h after {longest:.0f} s of braking")
    if record.stop == "standstill" and record.vx[-1] < 0.0:
        # A car that spins may have rolled backwards before: what counts is the crossing with which the run ended.
        forward = record.time[record.vx > 0.0][-1]
        record = record.until(crossing(record.time, record.vx, 0.0, after=float(forward)))
    return record


def _locked(record: Record) -> list[str]:
    """Wheels that stood while the vehicle drove."""
    fast = record.vx > 0.25 * float(np.max(record.vx))
    found = []
    for wheel in ("front_left", "front_right", "rear_left", "rear_right"):
        rate = record.others.get(f"wheel_speed.{wheel}")
        if rate is not None and fast.any() and float(np.mean(np.abs(rate[fast]) < 0.5)) > 0.05:
            found.append(wheel)
    return found


def _speed_charts(outcome: Outcome, record: Record, shown: Any) -> None:
    time = record.time[shown]
    speed, slope = record.vx[shown] / KMH, record.longitudinal_acceleration[shown]
    outcome.charts.append(Chart("Time", "s", "Speed", "km/h", (Curve("Speed", time, speed),)))
    outcome.charts.append(Chart("Time", "s", "Longitudinal acceleration", "m/s²", (Curve("", time, slope),)))
