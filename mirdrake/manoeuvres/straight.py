"""Straight ahead: coast-down, acceleration, braking, braking on split friction."""

import math
from collections.abc import Mapping, Sequence
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from mirdrake.core.yaml_io import Duration, Length, Speed
from mirdrake.manoeuvres.base import (
    Chart,
    Curve,
    ManoeuvreSpec,
    Margin,
    NotFeasible,
    Outcome,
    setting,
)
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
from mirdrake.manoeuvres.rig import STANDSTILL, Rig
from mirdrake.vehicles import WHEELS

_BRAKING_DRIVER = {"course": 0.0, "preview": 0.2}
"""Settings of the driver of a brake test: he corrects the heading of the car before it leaves its line."""

_BEFORE = 0.3  # time before the brake is pressed [s]
_SPIN = math.radians(60.0)  # heading beyond which a car spins


def _line(length: float) -> dict[str, object]:
    """Return a straight line of a length [m]."""
    return {"kind": "straight", "length": max(length, 10.0)}


class CoastDownSpec(ManoeuvreSpec):
    """Coasting in neutral: the road load F = A + B v + C v², and times from speed to speed."""

    title: ClassVar[str] = "Coast-down"
    standard: ClassVar[str] = "SAE J2263"
    headline: ClassVar[tuple[str, ...]] = ("force_100", "time_100_80")

    speed: Speed = setting(115.0 * KMH, "speed at the start", "m/s", "R", "SAE J2263", gt=0.0)
    last: Speed = setting(15.0 * KMH, "speed at the end", "m/s", "R", "SAE J2263", gt=0.0)
    rotating: bool = setting(True, "whether the equivalent mass of rotating parts is included", "", "own")
    longest: Duration = setting(400.0, "longest run", "s", "own", gt=0.0)

    def drive(self, rig: Rig, outcome: Outcome) -> None:
        """Simulate one run; on flat ground without wind both directions are alike."""
        if self.last >= self.speed:
            raise self.fault("last", "must be below speed")
        # Servos on the wheels would hold the speed instead of letting the vehicle coast.
        if not rig.pedals:
            raise NotFeasible("coasting needs pedals with a neutral gear; control.yaml has servos on its wheels")
        check_speed(rig.facts, self.speed)

        # 2 % below the last speed, so that its crossing is in the record; the start is 0.5 % above for the same reason.
        def stop(time: float, state: Sequence[float]) -> str | None:  # noqa: ARG001
            return "the last speed" if state[6] < self.last * 0.98 else None

        driver = rig.line_driver(_line(self.speed * self.longest), pedals=[[0.0, 0.0, 0.0, 0.0]])
        record = rig.run("coast", driver, duration=self.longest, speed=self.speed * 1.005, stop=stop)
        if record.vx[-1] > self.last:
            raise NotFeasible(f"after {self.longest:g} s it still coasted at {record.vx[-1] / KMH:.0f} km/h")
        parameters = rig.facts.parameters
        # Wheels and rotors coast, too: their equivalent mass belongs to the inertia unless the figure is without it.
        mass = parameters.mass + (parameters.rotating_mass if self.rotating else 0.0)
        chosen = (record.vx <= self.speed) & (record.vx >= self.last)
        load = road_load(record.time[chosen], record.vx[chosen], mass)
        outcome.add("a", "A", load.a, "N")
        # B is often zero: the others explain the road load alone.
        outcome.add("b", "B", load.b, "N s/m", scale=load.at(self.speed) / self.speed)
        outcome.add("c", "C", load.c, "N s²/m²", f"rms of the speed {load.error:.3g} m/s")
        fast = 100.0 * KMH
        if self.last < fast < self.speed:
            outcome.add("force_100", "Road load at 100 km/h", load.at(fast), "N")
        rotating = f"{parameters.rotating_mass:.0f} kg of rotating parts"
        outcome.add("mass", "Mass in the fit", mass, "kg", f"{'with' if self.rotating else 'without'} {rotating}")
        steps = [(self.speed, self.last)]
        # Intervals that are usual in road-load tests, as far as the coast-down covers them from above.
        steps += [(a * KMH, b * KMH) for a, b in ((100, 80), (80, 60), (60, 40), (40, 20)) if a * KMH < self.speed]
        for (high, low), took in zip(steps, coast_times(record.time, record.vx, steps), strict=True):
            name = f"{high / KMH:.0f}_{low / KMH:.0f}"
            outcome.add(f"time_{name}", f"Time from {high / KMH:.0f} to {low / KMH:.0f} km/h", took, "s")
        outcome.notes.append("one direction: flat ground, no wind")
        outcome.charts.append(Chart("Time", "s", "Speed", "km/h", (Curve("Speed", record.time, record.vx / KMH),)))
        v = np.linspace(self.last, self.speed, 50)
        force = Curve("A + B v + C v²", v / KMH, load.a + load.b * v + load.c * v**2)
        outcome.charts.append(Chart("Speed", "km/h", "Road load", "N", (force,)))


class AccelerationSpec(ManoeuvreSpec):
    """Full throttle from standstill: times to speeds from first movement, less rollout, and from pedal application."""

    title: ClassVar[str] = "Acceleration"
    standard: ClassVar[str] = "0-100 km/h, 0-60 mph, quarter mile, as magazines measure"
    headline: ClassVar[tuple[str, ...]] = ("time_100kmh", "time_top", "quarter_mile")

    throttle: float = setting(1.0, "position of the pedal", "", "own", gt=0.0, le=1.0)
    wait: Duration = setting(1.0, "time at standstill before", "s", "own", ge=0.0)
    rollout: Length = setting(
        FOOT, "distance whose time is subtracted", "m", "E", "Edmunds, Car and Driver", scales=False, gt=0.0
    )
    longest: Duration = setting(60.0, "longest run", "s", "own", gt=0.0)

    def drive(self, rig: Rig, outcome: Outcome) -> None:
        """Simulate one run."""
        facts = rig.facts
        # The usual distances and speeds, or for a small vehicle those at equal Froude number; never above its top
        # speed.
        fast, quarter = 100.0 * KMH, 0.25 * MILE
        target = min(fast, 0.97 * facts.top_speed)
        if facts.scale < 1.0:
            quarter *= facts.scale
            target = min(target, fast * facts.scale**0.5)
        # The brake holds the vehicle until the throttle opens; equal times in two rows make a step.
        if rig.pedals:
            rows = [[0.0, 0.0, 0.3, 1.0], [self.wait, 0.0, 0.3, 1.0], [self.wait, self.throttle, 0.0, 1.0]]
            driver = rig.line_driver(_line(60.0 * self.longest), pedals=rows)
        else:
            top = min(1.2 * target, facts.top_speed)
            rows = [[0.0, 0.0], [self.wait, 0.0], [self.wait, top]]
            driver = rig.line_driver(_line(60.0 * self.longest), speeds=rows)
            outcome.notes.append("the vehicle has no pedals: the speed command steps up, and the speed control follows")

        # Both targets are passed by a little, so that their crossings are in the record.
        def stop(time: float, state: Sequence[float]) -> str | None:  # noqa: ARG001
            return "speed and distance reached" if state[6] > target * 1.001 and state[0] > quarter * 1.01 else None

        record = rig.run("full_throttle", driver, duration=self.longest, stop=stop)
        begin = moves_off(record.time, record.vx, MOVED)
        if not math.isfinite(begin):
            raise NotFeasible(f"it did not move off within {self.longest:g} s")
        roll = time_to_distance(record.time, record.distance, self.rollout, start=begin)
        # Times to speeds: from the first movement, less the rollout as magazines do, and from the pedal on.
        pedal, pressed = begin - self.wait, "pedal application" if rig.pedals else "the speed command"
        reached = float(np.max(record.vx))
        speeds = [("30mph", 30.0 * MPH, "30 mph"), ("60mph", 60.0 * MPH, "60 mph"), ("75mph", 75.0 * MPH, "75 mph")]
        speeds.append(("100kmh", fast, "100 km/h"))
        # 60 mph means nothing to a small vehicle: only its own target speed.
        if facts.scale < 1.0:
            speeds = [("top", target, f"{target / KMH:.1f} km/h")]
        for key, speed, text in speeds:
            took = time_to_speed(record.time, record.vx, speed, start=begin)
            # Not all cars reach 75 mph within the time; the other speeds are reported as missing.
            if key == "75mph" and not math.isfinite(took):
                continue
            note = "from first movement" if math.isfinite(took) else f"it reached {reached / KMH:.0f} km/h"
            outcome.add(f"time_{key}", f"0 to {text}", took, "s", note)
            outcome.add(f"rollout_{key}", f"0 to {text} less the first {self.rollout:.4g} m", took - roll, "s")
            outcome.add(f"pedal_{key}", f"0 to {text} from {pressed}", took + pedal, "s")
        took = time_to_distance(record.time, record.distance, quarter, start=begin)
        name = "Quarter mile" if facts.scale == 1.0 else f"{quarter:.1f} m (a quarter mile to scale)"
        outcome.add("quarter_mile", name, took, "s")
        trap = float(np.interp(begin + took, record.time, record.vx)) if math.isfinite(took) else math.nan
        mph = f"{trap / MPH:.1f} mph" if math.isfinite(trap) else ""
        outcome.add("trap_speed", "Speed at the quarter mile", trap / KMH, "km/h", mph)
        outcome.add("rollout_time", f"Time of the first {self.rollout:.4g} m", roll, "s")
        peak = float(np.max(record.longitudinal_acceleration[record.time > begin + 0.1]))
        outcome.add("peak", "Largest acceleration", peak, "m/s²")
        note = f"first movement: {MOVED:g} m/s"
        outcome.add("begin", f"First movement after {pressed}", pedal, "s", note, scale=roll)
        _speed_charts(outcome, record, record.time > self.wait - 0.2)


class BrakingSpec(ManoeuvreSpec):
    """Full braking to standstill: distances and decelerations."""

    title: ClassVar[str] = "Braking"
    standard: ClassVar[str] = "100-0 km/h and 60-0 mph; mean fully developed deceleration as in UN R13-H"
    headline: ClassVar[tuple[str, ...]] = ("distance_100", "mfdd")
    margins: ClassVar[dict[str, Margin]] = {
        "distance_100": Margin(0.062, 0.1),
        "time": Margin(0.061, 0.1),
        "mfdd": Margin(-0.07, 0.1),
    }

    speed: Speed = setting(
        100.0 * KMH, "speed at which the distance begins", "m/s", "E", "Car and Driver, Edmunds", gt=0.0
    )
    others: tuple[float, ...] = setting(
        (60.0 * MPH, 30.0 * MPH), "further speeds from which distances are reported", "m/s", "E", "Edmunds"
    )
    brake: float = setting(1.0, "position of the pedal", "", "own", gt=0.0, le=1.0)
    lead: Speed = setting(3.0 * KMH, "excess of the speed when the brake is pressed", "m/s", "own", ge=0.0)
    lowest: float = setting(1.0, "deceleration below which it counts as not possible", "m/s²", "own", gt=0.0)

    def drive(self, rig: Rig, outcome: Outcome) -> None:
        """Simulate one run."""
        # The brake is pressed at a higher speed, so that at the speed of the figure the deceleration has built up.
        record = brake_run(rig, outcome, "brake", self.speed + self.lead, self.brake, lowest=self.lowest)
        for speed in (self.speed, *(other for other in self.others if other < self.speed + 0.9 * self.lead)):
            braking = stop_from(record.time, record.vx, record.distance, speed)
            first = speed == self.speed
            text = f"{speed / KMH:.4g} km/h" if first else f"{speed / KMH:.1f} km/h ({speed / MPH:.0f} mph)"
            key = f"{speed / KMH:.0f}"
            outcome.add(f"distance_{key}", f"From {text} to standstill", braking.distance, "m")
            if first:
                outcome.add("time", "Braking time", braking.time, "s")
            outcome.add(f"mean_{key}", "Mean deceleration over the distance", braking.mean, "m/s²", text)
            if first:
                note = "80 to 10 % of the speed"
                outcome.add("mfdd", "Mean fully developed deceleration", braking.developed, "m/s²", note)
        # The width is the scale of a change: the displacement itself is near zero.
        sideways = float(np.max(np.abs(record.y)))
        outcome.add("sideways", "Largest lateral displacement", sideways, "m", scale=rig.facts.width)
        _note_locked(outcome, record)
        _speed_charts(outcome, record, record.time >= 0.0)


class SplitFrictionSpec(ManoeuvreSpec):
    """Full braking with the left wheels on a slippery strip: deceleration, yaw and lateral displacement."""

    title: ClassVar[str] = "Braking on split friction"
    standard: ClassVar[str] = "similar to UN R13-H and ISO 14512; the numbers are chosen by mirdrake"
    headline: ClassVar[tuple[str, ...]] = ("distance", "sideways")

    speed: Speed = setting(80.0 * KMH, "speed when the brake is pressed", "m/s", "own", gt=0.0)
    brake: float = setting(1.0, "position of the pedal", "", "own", gt=0.0, le=1.0)
    slippery: float = setting(0.25, "friction under the left wheels", "", "own", gt=0.0, le=2.0)
    hands: Literal["corrects", "fixed"] = setting("corrects", "steering of the driver", "", "own")
    sideways: Length = setting(1.75, "largest lateral displacement that passes: half a lane", "m", "own", gt=0.0)
    yaw: float = setting(math.radians(15.0), "largest heading error that passes", "rad", "own", gt=0.0)
    until: Speed = setting(
        15.0 * KMH, "speed down to which steering and motion count: below it wheels may lock", "m/s", "R"
    )
    lowest: float = setting(0.5, "deceleration below which it counts as not possible", "m/s²", "own", gt=0.0)

    def drive(self, rig: Rig, outcome: Outcome) -> None:
        """Simulate one run."""
        if rig.kind == "single_track":
            raise NotFeasible("the single-track model has no left and right wheels")
        # Left half of the road; it begins before the braking and ends far behind it.
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
            # End the run only well beyond the allowed displacement, so that its size is reported.
            wide=4.0 * self.sideways,
        )
        # A car that turns beyond _SPIN spins, and at walking speed the wheels lock, so that the steering has no effect:
        # only what is before that time is evaluated. Both are NaN if they do not happen.
        turned = crossing(record.time, np.abs(record.yaw), _SPIN)
        slow = crossing(record.time, record.vx, self.until, after=_BEFORE)
        turned = math.nan if turned > slow else turned
        ends = [time for time in (turned, slow) if not math.isnan(time)]
        seen = record.until(min(ends)) if ends else record
        offset, largest_heading = float(np.max(np.abs(seen.y))), float(np.max(np.abs(seen.yaw)))
        angle, rate = np.abs(np.degrees(seen.hand_wheel)), np.abs(np.degrees(seen.yaw_rate))
        if math.isnan(turned):
            # 95 % of the speed: at the brake's first contact the deceleration has not built up.
            braking = stop_from(record.time, record.vx, record.distance, 0.95 * self.speed)
            driven = (record.vx > 0.2 * self.speed) & (record.vx < 0.8 * self.speed)
            steered = float(np.mean(np.degrees(record.hand_wheel[driven]))) if driven.any() else math.nan
            outcome.add("distance", f"From {0.95 * self.speed / KMH:.1f} km/h to standstill", braking.distance, "m")
            outcome.add("mean", "Mean deceleration", braking.mean, "m/s²")
            outcome.add("hand_wheel_mean", "Mean hand-wheel angle, 80 to 20 % of the speed", steered, "deg", "+ left")
        else:
            text = f"Time until it had turned by {math.degrees(_SPIN):.0f} deg, after which no figures are reported"
            outcome.add("turned", text, turned - _BEFORE, "s")
        outcome.add("sideways", "Largest lateral displacement", offset, "m", f"at most {self.sideways:.3g} m")
        note = f"at most {math.degrees(self.yaw):.0f} deg"
        outcome.add("yaw", "Largest heading error", math.degrees(largest_heading), "deg", note)
        outcome.add("yaw_rate", "Largest yaw rate", float(np.max(rate)), "deg/s")
        # Negated for NaN: also evaluated if it never turned.
        if not turned < _BEFORE + 1.0:
            later = float(np.interp(_BEFORE + 1.0, record.time, np.degrees(record.yaw)))
            outcome.add("yaw_1s", "Heading after 1 s of braking", later, "deg")
        largest = float(np.max(angle))
        outcome.add("hand_wheel", "Largest hand-wheel angle", largest, "deg", "UN R13-H: 240 deg, recalled")
        early = float(np.max(angle[seen.time < _BEFORE + 2.0 + 1e-6]))
        text = "Largest hand-wheel angle in the first 2 s"
        outcome.add("hand_wheel_2s", text, early, "deg", "UN R13-H: 120 deg, recalled")
        _note_locked(outcome, record)
        passed = offset <= self.sideways and largest_heading <= self.yaw
        outcome.verdict = "pass" if passed else "fail"
        if not passed:
            turn = f"turned by {math.degrees(largest_heading):.0f} deg" if math.isnan(turned) else "spun"
            outcome.reason = f"it moved {offset:.2f} m sideways and {turn}"
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
    ground: Mapping[str, object] | None = None,
    wide: float = math.inf,
) -> Record:
    """Brake from a speed to the first standstill, from :data:`_BEFORE` on; the record ends there.

    Args:
        rig: vehicle and conditions.
        outcome: gets a note if the vehicle has no pedals.
        label: name of the run.
        speed: speed when the brake is pressed [m/s].
        brake: position of the pedal [1].
        lowest: deceleration [m/s²] below which this is not possible.
        hands: whether the driver corrects.
        ground: keys of the world's ground.
        wide: lateral displacement at which the run ends [m].
    """
    check_speed(rig.facts, speed)
    # At the lowest allowed deceleration it stops exactly at the end of the run.
    longest = _BEFORE + speed / lowest
    settings = {"hands": hands, **_BRAKING_DRIVER}
    if rig.pedals:
        rows = [[0.0, 0.0, 0.0, 0.0], [_BEFORE, 0.0, 0.0, 0.0], [_BEFORE, 0.0, brake, 0.0]]
        driver = rig.line_driver(_line(speed * longest), pedals=rows, **settings)
    else:
        rows = [[0.0, speed], [_BEFORE, speed], [_BEFORE, 0.0]]
        driver = rig.line_driver(_line(speed * longest), speeds=rows, **settings)
        outcome.notes.append(
            "the vehicle has no pedals: the speed command steps to zero, and the speed control follows"
        )

    stood: list[float] = []

    def stop(time: float, state: Sequence[float]) -> str | None:
        if abs(state[1]) > wide:
            return f"it moved {wide:g} m sideways"
        # Standstill is a crossing of zero, a state that compliant tyres may only approach: 0.1 s after nearly zero
        # counts.
        if time > _BEFORE and state[6] < 0.01 and abs(state[7]) < 0.1:
            stood.append(time)
        return STANDSTILL if stood and (state[6] <= 0.0 or time > stood[0] + 0.1) else None

    record = rig.run(label, driver, duration=longest, speed=speed, ground=ground, stop=stop)
    entry = float(np.interp(_BEFORE, record.time, record.vx))
    check_entry(entry, speed, 0.02 * speed, where="when the brake is pressed")
    # The time ran out: the deceleration is below the lowest allowed one.
    if record.stop == "duration" and record.vx[-1] > 0.05:
        raise NotFeasible(f"it still drove at {record.vx[-1] / KMH:.0f} km/h after {longest:.0f} s of braking")
    if record.stop == STANDSTILL and record.vx[-1] < 0.0:
        # A car that spins may have rolled backwards before: the crossing at the end of the run counts.
        forward = record.time[record.vx > 0.0][-1]
        record = record.until(crossing(record.time, record.vx, 0.0, after=float(forward)))
    return record


def _note_locked(outcome: Outcome, record: Record) -> None:
    """Add a note that names the wheels which were locked for more than 5 % of the time above a quarter of the speed."""
    fast = record.vx > 0.25 * float(np.max(record.vx))
    rates = {wheel: record.others.get(f"wheel_speed.{wheel}") for wheel in WHEELS}
    locked = [
        wheel
        for wheel, rate in rates.items()
        if rate is not None and fast.any() and float(np.mean(np.abs(rate[fast]) < 0.5)) > 0.05
    ]
    if locked:
        outcome.notes.append(f"wheels locked: {', '.join(locked)}")


def _speed_charts(outcome: Outcome, record: Record, shown: NDArray[np.bool_]) -> None:
    time = record.time[shown]
    speed, slope = record.vx[shown] / KMH, record.longitudinal_acceleration[shown]
    outcome.charts.append(Chart("Time", "s", "Speed", "km/h", (Curve("Speed", time, speed),)))
    outcome.charts.append(Chart("Time", "s", "Longitudinal acceleration", "m/s²", (Curve("", time, slope),)))
