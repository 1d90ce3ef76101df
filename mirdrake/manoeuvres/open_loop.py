"""Open-loop steering: step, slowly increasing, and frequency response."""

import math
from typing import ClassVar, Literal

import numpy as np

from mirdrake.core.constants import GRAVITY
from mirdrake.core.yaml_io import Acceleration, AngularRate, Duration, Frequency, Speed
from mirdrake.manoeuvres.base import (
    Array,
    Chart,
    Curve,
    ManoeuvreSpec,
    Margin,
    NotFeasible,
    Outcome,
    setting,
)
from mirdrake.manoeuvres.checks import check_entry, check_rate, check_speed, check_steering
from mirdrake.manoeuvres.facts import Facts
from mirdrake.manoeuvres.metrics.steady import fit_line, means, understeer_constant_speed
from mirdrake.manoeuvres.metrics.straight import KMH
from mirdrake.manoeuvres.metrics.transient import bandwidth, crossing, frequency_response, step_response
from mirdrake.manoeuvres.rig import Rig
from mirdrake.manoeuvres.steady_circle import SIDES, spun_or_steady

_OVER = 10.0
"""Least scale of the change of an overshoot [%], which is a small difference of large numbers."""


class StepSteerSpec(ManoeuvreSpec):
    """Step of the steering at constant speed: response times, overshoot, gains."""

    title: ClassVar[str] = "Step steer"
    standard: ClassVar[str] = "ISO 7401:2011, clause 10"
    headline: ClassVar[tuple[str, ...]] = ("yaw_response", "yaw_overshoot")
    margins: ClassVar[dict[str, Margin]] = {
        "rise": Margin(0.062, 0.1),
        "yaw_response": Margin(-0.021, 0.1),
        "yaw_peak": Margin(-0.037, 0.1),
        "yaw_gain": Margin(-0.052, 0.1),
        "lateral_response": Margin(-0.039, 0.1),
        "lateral_peak": Margin(-0.116, 0.15),
        "lateral_gain": Margin(-0.052, 0.1),
    }

    speed: Speed = setting(100.0 * KMH, "speed at the start", "m/s", "R", "ISO 7401", gt=0.0)
    tolerance: Speed = setting(3.0 * KMH, "allowed difference of the speed at the step", "m/s", "R", "ISO 7401", gt=0.0)
    lateral: Acceleration = setting(4.0, "required steady lateral acceleration", "m/s²", "R", "ISO 7401", gt=0.0)
    rise: Duration = setting(
        0.15, "rise of the steering, 0 to 100 %", "s", "R", "ISO 7401: 10 to 90 % within 0.15 s", ge=0.0
    )
    turn: Literal["left", "right"] = setting("left", "direction", "", "own")
    settle: Duration = setting(1.0, "time straight ahead before the step", "s", "own", ge=0.0)
    length: Duration = setting(5.0, "time after the step", "s", "own", gt=0.0)
    average: Duration = setting(1.0, "time at the end over which steady values are averaged", "s", "own", gt=0.0)

    def drive(self, rig: Rig, outcome: Outcome) -> None:
        """Simulate steps until the steady lateral acceleration is as required; the last run counts."""
        facts, sign = rig.facts, SIDES[self.turn]
        check_speed(facts, self.speed)

        # Three attempts are sufficient near the linear range; the for-else raises an error if none of them fits.
        # The gain at this lateral acceleration is not known beforehand: the angle is corrected by the result.
        angle = _first_angle(facts, self.lateral, self.speed)
        for number in range(3):
            check_steering(facts, angle, what="the step")
            # The steering actuator has a rate limit, so a step may take longer than asked for.
            fastest = angle / facts.steering_rate
            if self.rise < fastest:
                outcome.notes.append(f"the steering needs {fastest:.2f} s for the step instead of {self.rise:.2f} s")
            profile = {"kind": "step", "amplitude": sign * angle, "start": self.settle, "rise": self.rise}
            record = rig.run(
                f"step_{number + 1}",
                rig.open_driver(profile, speeds=[[0.0, self.speed]]),
                duration=self.settle + self.length,
                speed=self.speed,
                stop=spun_or_steady(self.speed, self.settle),
            )
            if record.stop != "duration":
                raise NotFeasible(f"with {math.degrees(angle):.2f} deg at the road wheels {record.stop}")
            end = record.time > record.time[-1] - self.average
            steady = abs(float(np.mean(record.lateral_acceleration[end])))
            if abs(steady - self.lateral) < 0.05 * self.lateral:
                break
            # Steering is nearly proportional to the lateral acceleration; the factor is limited near the limit of
            # friction.
            angle *= min(max(self.lateral / max(steady, 1e-3), 0.4), 2.0)
        else:
            raise NotFeasible(f"no angle gives {self.lateral:g} m/s²; the last one gave {steady:.2f} m/s²")
        # Figures from the signals of the last run.
        # Every attempt may have added the same note.
        outcome.notes = list(dict.fromkeys(outcome.notes))
        # ISO 7401 asks for a tolerance of the speed at the beginning of the step.
        before = float(np.interp(self.settle, record.time, record.vx))
        check_entry(before, self.speed, self.tolerance, where="at the step")
        time, steer = record.time, record.hand_wheel
        # Yaw rate and lateral acceleration are evaluated against the recorded steering, not its set-point.
        yaw = step_response(time, steer, record.yaw_rate, last=self.average)
        side = step_response(time, steer, record.lateral_acceleration, last=self.average)
        ramp = _rise(time, steer)
        outcome.add("speed", "Speed at the step", before / KMH, "km/h")
        outcome.add("hand_wheel", "Hand-wheel angle", math.degrees(abs(float(np.mean(steer[end])))), "deg")
        outcome.add("rise", "Steering, 10 to 90 %", ramp, "s", "as recorded at the road wheels")
        outcome.add("lateral", "Steady lateral acceleration", abs(side.steady), "m/s²")
        outcome.add("yaw_response", "Response time of the yaw rate", yaw.response_time, "s", "50 % steer to 90 %")
        outcome.add("yaw_peak", "Peak time of the yaw rate", yaw.peak_time, "s", "none without overshoot")
        outcome.add("yaw_overshoot", "Overshoot of the yaw rate", 100.0 * yaw.overshoot, "%", scale=_OVER)
        outcome.add("yaw_gain", "Yaw-rate gain", yaw.gain, "1/s", "over the hand-wheel angle")
        outcome.add("lateral_response", "Response time of the lateral acceleration", side.response_time, "s")
        outcome.add("lateral_peak", "Peak time of the lateral acceleration", side.peak_time, "s")
        over = 100.0 * side.overshoot
        outcome.add("lateral_overshoot", "Overshoot of the lateral acceleration", over, "%", scale=_OVER)
        outcome.add("lateral_gain", "Lateral-acceleration gain", side.gain * math.radians(1.0), "m/s² per deg")
        # Positive in the sense of the turn, so that left and right are comparable.
        slip = math.degrees(float(np.mean(record.sideslip[end]))) * sign
        outcome.add("sideslip", "Steady sideslip angle", slip, "deg", "negative: the nose points into the turn")
        # NaN compares unequal to itself: without a peak there is no TB factor.
        factor = -slip * yaw.peak_time if yaw.peak_time == yaw.peak_time else math.nan
        outcome.add("tb", "TB factor", factor, "deg s", "sideslip × peak time of the yaw rate")
        shown = time > self.settle - 0.3
        for label, unit, values in (
            ("Road-wheel angle times steering ratio", "deg", np.degrees(steer)),
            ("Yaw rate", "deg/s", np.degrees(record.yaw_rate)),
            ("Lateral acceleration", "m/s²", record.lateral_acceleration),
        ):
            outcome.charts.append(Chart("Time", "s", label, unit, (Curve(label, time[shown], values[shown]),)))


def _first_angle(facts: Facts, lateral: float, speed: float) -> float:
    """Return an estimated bicycle angle [rad] for a lateral acceleration [m/s²]; never far below that at low speed."""
    # An oversteering vehicle could have an estimate of zero or less near its critical speed.
    return max(facts.steering_for(lateral, speed), 0.2 * facts.wheelbase * lateral / speed**2)


def _rise(time: Array, steer: Array) -> float:
    """Return the time of the steering from 10 to 90 % [s]."""
    final = float(np.mean(steer[time > time[-1] - 0.2]))
    return crossing(time, steer, 0.9 * final) - crossing(time, steer, 0.1 * final)


class SlowlyIncreasingSteerSpec(ManoeuvreSpec):
    """Slowly increasing steering at constant speed: the angle A at 0.3 g, understeer, the limit."""

    title: ClassVar[str] = "Slowly increasing steer"
    standard: ClassVar[str] = "FMVSS 126, ISO 19365"
    headline: ClassVar[tuple[str, ...]] = ("a", "largest")

    speed: Speed = setting(
        80.0 * KMH, "constant speed", "m/s", "E", "MathWorks reference application: 50 mph (80 km/h)", gt=0.0
    )
    rate: AngularRate = setting(
        math.radians(13.5), "rate of the hand-wheel", "rad/s", "E", "MathWorks reference application", scales=False,
        gt=0.0,
    )  # fmt: skip
    most: float = setting(
        math.radians(270.0), "largest hand-wheel angle", "rad", "E", "MathWorks reference application", gt=0.0
    )
    limit: Acceleration = setting(12.0, "lateral acceleration at which the run ends", "m/s²", "own", gt=0.0)
    at: Acceleration = setting(0.3 * GRAVITY, "lateral acceleration of the angle A", "m/s²", "R", "FMVSS 126", gt=0.0)
    fit_from: Acceleration = setting(0.1 * GRAVITY, "lower end of the regression", "m/s²", "R", "FMVSS 126", ge=0.0)
    fit_to: Acceleration = setting(0.375 * GRAVITY, "upper end of the regression", "m/s²", "R", "FMVSS 126", gt=0.0)
    turn: Literal["left", "right"] = setting("left", "direction", "", "own")
    settle: Duration = setting(1.0, "time straight ahead before the steering", "s", "own", ge=0.0)
    window: Duration = setting(0.4, "window of the moving averages", "s", "own", gt=0.0)

    def drive(self, rig: Rig, outcome: Outcome) -> None:
        """Simulate one run."""
        facts, sign = rig.facts, SIDES[self.turn]
        check_speed(facts, self.speed)
        # The rate is that of a hand-wheel; small vehicles have no hand-wheel ratio and are given that of a car, 16.
        rate = self.rate / facts.ratio * (1.0 if facts.scale == 1.0 else facts.ratio / 16.0)
        check_rate(facts, rate, what="the steering")
        # A margin of 2 % to the stop of the steering, where the angle would not follow.
        limit = min(self.most / facts.ratio, 0.98 * facts.steering_limit)
        profile = {"kind": "ramp", "rate": sign * rate, "limit": limit, "start": self.settle}
        record = rig.run(
            "increasing",
            rig.open_driver(profile, speeds=[[0.0, self.speed]]),
            duration=self.settle + limit / rate + 0.5,
            speed=self.speed,
            stop=spun_or_steady(self.speed, self.settle, self.limit),
        )
        # Moving averages have shorter windows at the ends, so these samples are left out.
        late = (record.time > self.settle) & (record.time < record.time[-1] - self.window)
        ay = means(record.time, sign * record.lateral_acceleration, self.window)[late]
        delta = means(record.time, sign * record.steering, self.window)[late]
        speed = means(record.time, record.speed, self.window)[late]
        line = fit_line(ay, delta, self.fit_from, self.fit_to)
        # Speed drops at high lateral acceleration, so the share L / v² of a neutral car is removed per sample.
        fit = understeer_constant_speed(ay, delta, speed, facts.wheelbase, self.fit_from, self.fit_to)
        reason = "the steering was at its last angle" if record.stop == "duration" else record.stop
        if line is None or fit is None or float(np.max(ay, initial=0.0)) < self.at:
            raise NotFeasible(
                f"it reached {np.max(ay, initial=0.0) / GRAVITY:.2f} g; {self.at / GRAVITY:.2f} g are required "
                f"({reason})"
            )
        angle = facts.ratio * (line.offset + line.slope * self.at)
        note = f"{line.low:.2f} to {line.high:.2f} m/s², {line.count} points"
        outcome.add("a", f"A, the hand-wheel angle at {self.at / GRAVITY:.2g} g", math.degrees(angle), "deg", note)
        per_g = math.degrees(fit.slope) * GRAVITY
        outcome.add("understeer", "Understeer gradient, road wheels", per_g, "deg/g", note)
        outcome.add("understeer_hand", "Understeer gradient, hand-wheel", per_g * facts.ratio, "deg/g")
        outcome.add("largest", "Largest lateral acceleration", float(np.max(ay)) / GRAVITY, "g", reason)
        # Steering at the largest lateral acceleration, which need not be the largest angle.
        at_most = float(delta[int(np.argmax(ay))])
        outcome.add("hand_wheel", "Hand-wheel angle there", math.degrees(at_most) * facts.ratio, "deg")
        # Every tenth sample, as logs have 200 per second.
        points = Curve("recorded", ay[::10], np.degrees(delta[::10]) * facts.ratio, "dots")
        ends = np.array([0.0, line.high * 1.3])
        fitted = Curve("regression", ends, np.degrees(line.offset + line.slope * ends) * facts.ratio, "dashed", 1)
        outcome.charts.append(Chart("Lateral acceleration", "m/s²", "Hand-wheel angle", "deg", (points, fitted)))


class FrequencyResponseSpec(ManoeuvreSpec):
    """Gains and phases over frequency, from random or swept steering."""

    title: ClassVar[str] = "Frequency response"
    standard: ClassVar[str] = "ISO 7401:2011, clauses 12 and 14"
    headline: ClassVar[tuple[str, ...]] = ("yaw_bandwidth", "lateral_bandwidth")

    input: Literal["sweep", "random"] = setting("sweep", "signal of the steering", "", "E", "ISO 7401:2011")
    speed: Speed = setting(100.0 * KMH, "constant speed", "m/s", "R", "ISO 7401", gt=0.0)
    lateral: Acceleration = setting(2.0, "steady lateral acceleration of the steering amplitude", "m/s²", "own", gt=0.0)
    first: Frequency = setting(0.2, "lowest frequency", "Hz", "R", "ISO 7401", gt=0.0)
    last: Frequency = setting(3.0, "highest frequency", "Hz", "E", "Altair MotionView, sweep to 3 Hz", gt=0.0)
    length: Duration = setting(
        60.0, "duration of the steering; the standard requires 12 min of random steering", "s", "own", gt=0.0
    )
    segment: Duration = setting(12.0, "length of the segments over which spectra are averaged", "s", "own", gt=0.0)
    lag: float = setting(math.radians(45.0), "phase lag of the bandwidth", "rad", "own", gt=0.0)
    settle: Duration = setting(1.0, "time straight ahead before the steering", "s", "own", ge=0.0)

    def drive(self, rig: Rig, outcome: Outcome) -> None:
        """Simulate one run."""
        facts = rig.facts
        # Settings that this vehicle cannot drive are rejected before the simulation, with the reason.
        if self.last <= self.first:
            raise self.fault("last", "must be above first")
        check_speed(facts, self.speed)
        angle = _first_angle(facts, self.lateral, self.speed)
        check_steering(facts, angle, what="the steering")
        # The largest rate of a sine of the highest frequency must be within the limit of the steering.
        check_rate(facts, 2.0 * math.pi * self.last * angle, what=f"{self.last:g} Hz")
        profile = {
            "kind": self.input,
            "amplitude": angle,
            "first": self.first,
            "last": self.last,
            "length": self.length,
            "start": self.settle,
        }
        if self.input == "random":
            profile["seed"] = rig.seed
        record = rig.run(
            self.input,
            rig.open_driver(profile, speeds=[[0.0, self.speed]]),
            duration=self.settle + self.length,
            speed=self.speed,
            stop=spun_or_steady(self.speed, self.settle),
        )
        if record.stop != "duration":
            raise NotFeasible(f"with {math.degrees(angle):.2f} deg at the road wheels {record.stop}")
        # Gains and phases within the excited band; outside of it the spectrum of the steering is too small.

        # Welch's method with segments; both responses over the same excitation, so that they can be compared.
        band = {"first": self.first, "last": self.last, "segment": self.segment}
        yaw = frequency_response(record.time, record.hand_wheel, record.yaw_rate, **band)
        side = frequency_response(record.time, record.hand_wheel, record.lateral_acceleration, **band)
        slowest = float(yaw.gain[0])
        fastest, highest = yaw.peak()
        outcome.add("hand_wheel", "Amplitude at the hand-wheel", math.degrees(angle) * facts.ratio, "deg")
        outcome.add("yaw_gain", f"Yaw-rate gain at {yaw.frequency[0]:.2f} Hz", slowest, "1/s")
        outcome.add("yaw_peak_ratio", f"Largest gain over that at {yaw.frequency[0]:.2f} Hz", highest / slowest, "1")
        outcome.add("yaw_peak_frequency", "Frequency of the largest gain", fastest, "Hz")
        # 1 Hz for a car, at equal Froude number for a small vehicle.
        frequency = 1.0 / facts.scale**0.5
        # Bandwidth where the phase lags by a stated angle, since the gain of the yaw rate may have no corner.
        signals = (("yaw", "yaw rate", yaw), ("lateral", "lateral acceleration", side))
        for key, name, response in signals:
            text = f"Bandwidth of the {name}, {math.degrees(self.lag):.0f} deg lag"
            outcome.add(f"{key}_bandwidth", text, bandwidth(response, self.lag), "Hz")
        for key, name, response in signals:
            phase = math.degrees(response.at(frequency)[1])
            outcome.add(f"{key}_phase", f"Phase of the {name} at {frequency:.3g} Hz", phase, "deg")
        outcome.add("coherence", "Smallest coherence of the yaw rate", float(np.min(yaw.coherence)), "1")
        gains = Curve("yaw rate", yaw.frequency, yaw.gain), Curve("lateral acceleration", side.frequency, side.gain)
        phases = tuple(
            Curve(name, response.frequency, np.degrees(response.phase), "line", colour)
            for colour, (_, name, response) in enumerate(signals)
        )
        for label, unit, curves in (
            ("Yaw-rate gain", "1/s", gains[:1]),
            ("Lateral-acceleration gain", "m/s² per rad", gains[1:]),
            ("Phase", "deg", phases),
        ):
            outcome.charts.append(Chart("Frequency", "Hz", label, unit, curves, log=True))
