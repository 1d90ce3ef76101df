"""Steady-state circle: constant radius with rising speed, or constant speed with rising steering (ISO 4138)."""

import math
from collections.abc import Sequence
from typing import ClassVar, Literal

import numpy as np

from mirdrake.core.constants import GRAVITY
from mirdrake.core.yaml_io import Acceleration, AngularRate, Duration, Length, Speed
from mirdrake.manoeuvres.base import Array, Chart, Curve, ManoeuvreSpec, Margin, NotFeasible, Outcome, setting
from mirdrake.manoeuvres.checks import check_rate, check_speed, check_steering
from mirdrake.manoeuvres.metrics.steady import (
    Fit,
    characteristic_speed,
    critical_speed,
    fit_line,
    means,
    understeer_constant_radius,
    understeer_constant_speed,
)
from mirdrake.manoeuvres.metrics.straight import KMH
from mirdrake.manoeuvres.record import Record
from mirdrake.manoeuvres.reduced import Stop
from mirdrake.manoeuvres.rig import Rig

SIDES: dict[str, float] = {"left": 1.0, "right": -1.0}


class SteadyStateCircleSpec(ManoeuvreSpec):
    """Steady-state circle: constant radius with rising speed, or constant speed with rising steering."""

    title: ClassVar[str] = "Steady-state circle"
    standard: ClassVar[str] = "ISO 4138:2021"
    headline: ClassVar[tuple[str, ...]] = ("understeer", "largest")
    margins: ClassVar[dict[str, Margin]] = {
        "roll_left": Margin(-0.013, 0.1),
        "beta_left": Margin(-0.037, 0.1),
        "understeer_left": Margin(0.132, 0.2),
        "largest_left": Margin(0.187, 0.2),
        "roll_right": Margin(-0.013, 0.1),
        "beta_right": Margin(-0.037, 0.1),
        "understeer_right": Margin(0.132, 0.2),
        "largest_right": Margin(0.187, 0.2),
        "understeer": Margin(0.132, 0.2),
        "largest": Margin(0.187, 0.2),
    }

    method: Literal["constant_radius", "constant_speed"] = setting(
        "constant_radius", "which of the methods", "", "E", "ISO 4138:2021"
    )
    turns: Literal["both", "left", "right"] = setting("both", "turns that are driven", "", "E", "ISO 4138:2021")
    radius: Length = setting(100.0, "constant radius", "m", "R", "ISO 4138, at least 30 m", gt=0.0)
    speed: Speed = setting(100.0 * KMH, "constant speed", "m/s", "R", "ISO 4138", gt=0.0)
    first_lateral: Acceleration = setting(0.5, "lateral acceleration at the start", "m/s²", "own", gt=0.0)
    speed_rate: Acceleration = setting(0.25, "rise of the speed; constant radius", "m/s²", "own", gt=0.0)
    steering_rate: AngularRate = setting(
        math.radians(8.0), "rise of the hand-wheel angle; constant speed", "rad/s", "own", scales=False, gt=0.0
    )
    tolerance: Length = setting(2.0, "offset from the circle that ends the run; constant radius", "m", "own", gt=0.0)
    behind: Speed = setting(0.5, "speed below the set-point that ends the run; constant radius", "m/s", "own", gt=0.0)
    limit: Acceleration = setting(12.0, "lateral acceleration at which the run ends", "m/s²", "own", gt=0.0)
    fit_from: Acceleration = setting(1.0, "lower end of the regressions", "m/s²", "own", ge=0.0)
    fit_to: Acceleration = setting(4.0, "upper end of the regressions", "m/s²", "own", gt=0.0)
    settle: Duration = setting(4.0, "time at the start that is not evaluated", "s", "own", ge=0.0)
    window: Duration = setting(2.0, "window of the moving averages", "s", "own", gt=0.0)
    driver_gain: float = setting(1.0, "gains of the driver over their defaults; constant radius", "", "own", gt=0.0)

    def drive(self, rig: Rig, outcome: Outcome) -> None:
        """Simulate both turns."""
        if self.fit_to <= self.fit_from:
            raise self.fault("fit_to", "must be above fit_from")
        # An asymmetric vehicle differs between the two turns.
        sides = ["left", "right"] if self.turns == "both" else [self.turns]
        gradients, peaks = [], []
        curves: dict[str, list[Curve]] = {"delta": [], "beta": [], "roll": []}
        for number, side in enumerate(sides):
            # Both methods give δ over a_y; they differ in what is held, radius or speed.
            radius = self.method == "constant_radius"
            record = self._circle(rig, side) if radius else self._speed(rig, side)
            steady = self._points(record, SIDES[side])
            fit = self._fit(rig, steady)
            if fit is None:
                raise NotFeasible(
                    f"the turn to the {side} has no steady points from {self.fit_from:g} to {self.fit_to:g} m/s² "
                    f"(largest {np.max(steady['ay'], initial=0.0):.2f} m/s²; {record.stop})"
                )
            ratio, wheelbase = rig.facts.ratio, rig.facts.wheelbase
            peak = float(np.max(steady["ay"]))
            # All points are positive in the turn, so left and right can be averaged.
            gradients.append(fit.slope)
            peaks.append(peak)
            per_g = math.degrees(fit.slope) * GRAVITY
            note = f"{fit.low:.2f} to {fit.high:.2f} m/s², {fit.count} points, rms {math.degrees(fit.error):.3f} deg"
            outcome.add(f"understeer_{side}", f"Understeer gradient, {side}, road wheels", per_g, "deg/g", note)
            text = f"Understeer gradient, {side}, hand-wheel"
            outcome.add(f"understeer_hand_{side}", text, per_g * ratio, "deg/g")
            for key, text in (("roll", "Roll gradient"), ("beta", "Sideslip gradient")):
                slope = fit_line(steady["ay"], steady[key], self.fit_from, self.fit_to)
                value = math.degrees(slope.slope) * GRAVITY if slope else None
                outcome.add(f"{key}_{side}", f"{text}, {side}", value, "deg/g", _SIGNS[key])
            reason = "the run ended with its time" if record.stop == "duration" else record.stop
            outcome.add(f"largest_{side}", f"Largest lateral acceleration, {side}", peak / GRAVITY, "g", reason)
            curves["delta"] += _curves(steady, "delta", side, number, ratio=ratio, fit=fit if radius else None)
            curves["beta"] += _curves(steady, "beta", side, number)
            curves["roll"] += _curves(steady, "roll", side, number)
        outcome.notes.append(
            "one run for each side: a simulation has no scatter that needs the repetitions of the standard"
        )
        # Figures of both sides together.
        mean = float(np.mean(gradients))
        outcome.add("understeer", "Understeer gradient, mean", math.degrees(mean) * GRAVITY, "deg/g")
        outcome.add("largest", "Largest lateral acceleration, mean", float(np.mean(peaks)) / GRAVITY, "g")
        # One of the two speeds exists at most: K > 0 has a characteristic, K < 0 a critical speed.
        for key, text, value, word in (
            ("characteristic_speed", "Characteristic speed", characteristic_speed(wheelbase, mean), "oversteers"),
            ("critical_speed", "Critical speed", critical_speed(wheelbase, mean), "understeers"),
        ):
            outcome.add(key, text, value / KMH, "km/h", "" if math.isfinite(value) else f"none: it {word}")
        for label, key in (("Hand-wheel angle", "delta"), ("Sideslip angle", "beta"), ("Roll angle", "roll")):
            outcome.charts.append(Chart("Lateral acceleration", "m/s²", label, "deg", tuple(curves[key])))

    def _circle(self, rig: Rig, side: str) -> Record:
        sign, radius = SIDES[side], self.radius
        # v = sqrt(a_y R): start and end of the speed ramp from lateral accelerations.
        start = math.sqrt(self.first_lateral * radius)
        check_speed(rig.facts, math.sqrt(self.fit_to * radius))
        check_steering(rig.facts, math.atan(rig.facts.wheelbase / radius), what=f"a circle of {radius:g} m")
        top = min(math.sqrt(self.limit * radius), 0.98 * rig.facts.top_speed)
        rising = (top - start) / self.speed_rate
        speeds = [[0.0, start], [self.settle, start], [self.settle + rising, top]]
        # Length of the line: distance at the start speed and on the ramp, and a fifth of a lap in reserve.
        distance = start * self.settle + 0.5 * (start + top) * rising
        line = {"kind": "circle", "radius": radius, "turn": sign, "laps": distance / (2.0 * math.pi * radius) + 0.2}
        centre = sign * radius
        ahead = rig.facts.ahead

        # The test ends where the vehicle leaves the circle or the motor cannot raise the speed further: its limit.
        def stop(time: float, state: Sequence[float]) -> str | None:
            x, y, yaw = state[0], state[1], state[5]
            away = math.hypot(x + ahead * math.cos(yaw), y + ahead * math.sin(yaw) - centre) - radius
            if time > self.settle and abs(away) > self.tolerance:
                return f"it left the circle by {self.tolerance:.3g} m"
            # From twice the settling time on, so that the lag of the speed control at the start of the ramp does not
            # count.
            setpoint = start + self.speed_rate * (time - self.settle)
            if time > 2.0 * self.settle and state[6] < setpoint - self.behind:
                return f"its speed did not rise above {state[6] / KMH:.0f} km/h"
            return None

        # The natural frequency of the driver scales with the inverse root of the size (Froude number).
        gain = self.driver_gain
        return rig.run(
            side,
            rig.line_driver(line, speeds=speeds, frequency=2.5 / rig.facts.scale**0.5 * gain, integral=0.5 * gain),
            duration=self.settle + rising,
            speed=start,
            stop=stop,
        )

    def _speed(self, rig: Rig, side: str) -> Record:
        check_speed(rig.facts, self.speed)
        # The rate of the standard is that of the hand-wheel.
        rate = self.steering_rate / rig.facts.ratio
        check_rate(rig.facts, rate, what="the steering")
        limit = 0.95 * rig.facts.steering_limit
        profile = {"kind": "ramp", "rate": SIDES[side] * rate, "limit": limit, "start": self.settle}
        return rig.run(
            side,
            rig.open_driver(profile, speeds=[[0.0, self.speed]]),
            duration=self.settle + min(limit / rate, 90.0),
            speed=self.speed,
            stop=spun_or_steady(self.speed, self.settle, self.limit),
        )

    def _points(self, record: Record, sign: float) -> dict[str, Array]:
        """Return averaged signals of the part that is evaluated, positive in the turn."""
        # Without the beginning, and without the end, where the window of the averages is shorter.
        late = record.time > self.settle
        late &= record.time < record.time[-1] - 0.5 * self.window
        ay = record.vx * record.yaw_rate * sign
        if self.method == "constant_radius":  # from the driven radius, as the yaw rate oscillates at the limit
            ay = record.speed**2 / np.hypot(record.x_com, record.y_com - sign * self.radius)
        named = {"ay": ay, "delta": sign * record.steering, "beta": sign * record.sideslip, "roll": sign * record.roll}
        named["speed"] = record.speed
        return {key: means(record.time, values, self.window)[late][::10] for key, values in named.items()}

    def _fit(self, rig: Rig, steady: dict[str, Array]) -> Fit | None:
        if self.method == "constant_radius":
            return understeer_constant_radius(steady["ay"], steady["delta"], self.fit_from, self.fit_to)
        return understeer_constant_speed(
            steady["ay"], steady["delta"], steady["speed"], rig.facts.wheelbase, self.fit_from, self.fit_to
        )


_SIGNS = {"roll": "positive: the body rolls out of the turn", "beta": "negative: the nose points into the turn"}


def spun_or_steady(speed: float, settle: float, limit: float = math.inf) -> Stop:
    """Return a stop condition: the car is far too slow, slides sideways, or reaches a lateral acceleration [m/s²]."""

    def stop(time: float, state: Sequence[float]) -> str | None:
        vx, vy, rate = state[6], state[7], state[11]
        # Sideslip above 31 degrees of the rear axle; the speed in the denominator keeps a stopped car from counting.
        if time > settle and abs(vy) > 0.6 * max(abs(vx), 0.3 * speed):
            return "it spun"
        if time > settle and vx < 0.6 * speed:
            return "it lost its speed"
        if time > settle and abs(vx * rate) > limit:
            return f"{limit:g} m/s² reached"
        return None

    return stop


def _curves(
    steady: dict[str, Array], key: str, side: str, colour: int, *, ratio: float = 1.0, fit: Fit | None = None
) -> list[Curve]:
    lines = [Curve(side, steady["ay"], np.degrees(steady[key]) * ratio, "dots", colour)]
    if fit is not None:
        x = np.array([0.0, fit.high * 1.15])
        y = np.degrees(fit.offset + fit.slope * x) * ratio
        lines.append(Curve(f"{side}, line of the gradient", x, y, "dashed", colour))
    return lines
