"""Skidpad: laps of a figure of eight between cones, or of a circle."""

import math
from collections.abc import Sequence
from typing import ClassVar, Literal

import numpy as np

from mirdrake.core.constants import GRAVITY
from mirdrake.core.yaml_io import Length, Speed
from mirdrake.manoeuvres.base import (
    Chart,
    Curve,
    ManoeuvreSpec,
    NotFeasible,
    Outcome,
    setting,
)
from mirdrake.manoeuvres.checks import check_speed, check_steering
from mirdrake.manoeuvres.courses import make_line
from mirdrake.manoeuvres.metrics.straight import KMH
from mirdrake.manoeuvres.metrics.transient import crossing
from mirdrake.manoeuvres.record import Record
from mirdrake.manoeuvres.rig import Rig
from mirdrake.manoeuvres.search import find_highest, once_per_label, speed_label

_FSAE = "FSAE Rules 2026, D.10"
_TIMED = ("right", "left")

_APPROACH = 0.8
"""Speed at the start of a circle over that of its timed lap [1]: a car that enters a circle at its limit, with straight
wheels or from the other side, oscillates laterally in the timed lap or leaves the lane."""

_PARTS = (0.2, 0.4)
"""Parts of the untimed lap of a circle with that speed, and with a rising speed [1]."""

_EXTRA_TIME = _PARTS[0] * (1.0 / _APPROACH - 1.0) + _PARTS[1] * (2.0 / (1.0 + _APPROACH) - 1.0)
"""Extra time of an untimed lap for it, over the time of a timed lap [1]."""


class SkidpadSpec(ManoeuvreSpec):
    """Two laps to the right and two to the left, the second of each timed; the fastest within the lane."""

    title: ClassVar[str] = "Skidpad"
    standard: ClassVar[str] = "Formula SAE Rules 2026, D.10"
    headline: ClassVar[tuple[str, ...]] = ("lap", "lateral")

    layout: Literal["eight", "circle"] = setting("eight", "figure of eight, or a circle of path_radius", "", "V", _FSAE)
    path_radius: Length = setting(9.125, "radius of the middle of the lane", "m", "V", _FSAE, gt=0.0)
    width: Length = setting(3.0, "width of the lane", "m", "V", _FSAE, gt=0.0)
    diameter: Length = setting(17.10, "D of the formula g = 2.012 D / t²", "m", "E", "FSAE 2014", gt=0.0)
    highest: Speed = setting(60.0 * KMH, "highest speed of the bisection", "m/s", "own", gt=0.0)
    lowest: Speed = setting(15.0 * KMH, "lowest speed of the bisection", "m/s", "own", gt=0.0)
    resolution: Speed = setting(0.05 * KMH, "difference of speeds at which the bisection ends", "m/s", "own", gt=0.0)

    def drive(self, rig: Rig, outcome: Outcome) -> None:
        """Bisect the speed."""
        facts = rig.facts
        if self.highest <= self.lowest:
            raise self.fault("highest", "must be above lowest")
        room = self.width - facts.width
        if room <= 0.0:
            raise NotFeasible(f"the vehicle is {facts.width:.2f} m wide, the lane {self.width:.2f} m")
        check_speed(facts, self.lowest)
        check_steering(facts, math.atan(facts.wheelbase / self.path_radius), what=f"a radius of {self.path_radius:g} m")

        limit = find_highest(
            once_per_label(lambda speed: self._try(rig, speed)),
            lowest=self.lowest,
            # 12 m/s² with a third more speed is beyond road tyres, so the bisection always has an upper end that fails.
            highest=min(self.highest, 0.95 * facts.top_speed, 1.3 * math.sqrt(12.0 * self.path_radius)),
            guess=math.sqrt((0.6 if self.layout == "eight" else 0.75) * GRAVITY * self.path_radius),
            resolution=self.resolution,
        )
        # Lap times and lateral acceleration of the fastest run within the lane.
        best = limit.best
        if best is None:
            raise NotFeasible(f"at {self.lowest / KMH:.0f} km/h, the lowest speed, {limit.reason}")
        # Expected time of the change of direction: two laps of the first circle, the slow start included.
        times = self._laps(best, switch=(2.0 + _EXTRA_TIME) * 2.0 * math.pi * self.path_radius / limit.passed)
        mean = float(np.mean(times))
        for side, lap in zip(_TIMED if self.layout == "eight" else ("left",), times, strict=False):
            outcome.add(f"lap_{side}", f"Timed lap, {side}", lap, "s")
        outcome.add("lap", "Lap time, mean", mean, "s")
        # The formula is for the dimensions of the rules, which a small vehicle does not drive.
        if facts.scale == 1.0:
            note = "of the timed laps" if self.layout == "eight" else "D = 2 path radius"
            diameter = self.diameter if self.layout == "eight" else 2.0 * self.path_radius
            outcome.add("g_formula", "g = 2.012 D / t², D in m", 2.012 * diameter / mean**2, "g", note)
        # The last lap only: it is in steady state.
        chosen = best.time > best.time[-1] - mean
        lateral = float(np.mean(np.abs((best.vx * best.yaw_rate)[chosen]))) / GRAVITY
        outcome.add("lateral", "Mean lateral acceleration, last lap", lateral, "g")
        outcome.add("speed", "Speed", float(np.mean(best.speed[chosen])) / KMH, "km/h", "centre of mass, last lap")
        if limit.failed < math.inf:
            outcome.add("failed", "Lowest speed that failed", limit.failed / KMH, "km/h", limit.reason)
        else:
            outcome.notes.append("it stays in the lane at the highest speed that was tried")
        if facts.scale == 1.0 and self.layout == "eight":
            outcome.notes.append(
                f"the vehicle is {facts.width:.2f} m wide; the lane of {self.width:g} m is made for narrower cars"
            )
        self._draw(outcome, best)

    def _try(self, rig: Rig, speed: float) -> tuple[Record, str]:
        radius, facts = self.path_radius, rig.facts
        lap = 2.0 * math.pi * radius
        swing = 2.0 * math.atan(facts.wheelbase / radius) / facts.steering_rate  # time from one side to the other [s]
        if self.layout == "eight":
            # The curvature changes over the distance travelled while the steering turns from one side to the other.
            line = {"kind": "eight", "radius": radius, "laps": 2, "ease": 0.5 * swing * speed}
            laps, circles = 4.0, 2
        else:
            line = {"kind": "circle", "radius": radius, "turn": 1.0, "laps": 2.2}
            laps, circles = 2.1, 1
        start = make_line(line)
        # One per cent more path than the laps and 0.2 s, so that the last crossing is in the record.
        duration = (laps * 1.01 + circles * _EXTRA_TIME) * lap / speed + 0.2
        # Only the second lap of each direction is timed; in the first, the speed rises.
        # Durations of its parts: constant slow speed, then at the mean of slow and full speed.
        slow, rising = _PARTS[0] * lap / (_APPROACH * speed), _PARTS[1] * lap / (0.5 * (1.0 + _APPROACH) * speed)
        both = (2.0 + _EXTRA_TIME) * lap / speed  # duration of the laps of a circle
        speeds: list[list[float]] = []
        for begin in (number * both for number in range(circles)):
            if speeds:
                speeds.append([begin, speed])
            # The speed is reduced within the distance in which the curvature changes.
            entry = begin + (swing if speeds else 0.0)
            speeds += [[entry, _APPROACH * speed], [begin + slow, _APPROACH * speed], [begin + slow + rising, speed]]
        # Untimed laps may leave the lane by its width; a timed lap must stay inside and hold the speed.
        half = 0.5 * (self.width - facts.width)
        # The figure of eight starts with the circle to the right, whose centre is at negative y.
        centres = (-radius, radius) if self.layout == "eight" else (radius,)
        faults: list[str] = []

        def stop(time: float, state: Sequence[float]) -> str | None:
            # The centre of mass stands for the body: the lane is narrowed by the width of the vehicle.
            x = state[0] + facts.ahead * math.cos(state[5])
            y = state[1] + facts.ahead * math.sin(state[5])
            away = [math.hypot(x, y - centre) - radius for centre in centres]
            out = max(-min(away), min(away)) - half  # over the inner cones of a circle, or the outer ones of both
            # The second lap of a circle is timed, after the slow first lap.
            timed = time % both > both - lap / speed
            if out > (0.02 if timed else self.width):
                faults.append(f"it left its lane by {out:.2f} m")
                return faults[-1]
            if state[6] < (0.97 if timed else 0.5) * speed:
                faults.append("it did not hold the speed")
                return faults[-1]
            return None

        # A driver with an integral part holds the radius without a steady error of the lane.
        record = rig.run(
            speed_label(speed),
            rig.line_driver(line, speeds=speeds, integral=0.5, frequency=3.0 / facts.scale**0.5),
            duration=duration,
            speed=_APPROACH * speed,
            # The centre of mass starts at the start of the line.
            x=float(start.x[0]) - facts.ahead,
            y=float(start.y[0]),
            stop=stop,
        )
        return record, faults[0] if faults else ""

    def _laps(self, record: Record, *, switch: float) -> list[float]:
        """Return the times of the timed laps [s]: the second of each direction, by the angle about the centre.

        Args:
            record: record of the run.
            switch: time at which a figure of eight changes from its first circle to the other [s].
        """
        laps = []
        # Angles about the centre of each circle, unwrapped, count laps without a timing line.
        for number, centre in enumerate((-self.path_radius, self.path_radius)):
            if self.layout == "circle" and number == 0:
                continue
            angle = np.unwrap(np.arctan2(record.y_com - centre, record.x_com))
            turned = np.abs(angle - angle[0])
            if self.layout == "circle":
                time, values = record.time, turned
            else:
                part = record.time < switch if number == 0 else record.time >= 0.96 * switch
                time, values = record.time[part], np.abs(angle[part] - angle[part][0])

            # One full turn that ends within the part: the second lap if there are two, else the last complete one.
            end = float(values[-1])
            first = min(2.0 * math.pi, max(end - 2.0 * math.pi - 0.05, 0.1))
            laps.append(crossing(time, values, first + 2.0 * math.pi) - crossing(time, values, first))
        return laps

    def _draw(self, outcome: Outcome, record: Record) -> None:
        turn = np.linspace(0.0, 2.0 * math.pi, 181)
        lines = []
        centres = (-self.path_radius, self.path_radius) if self.layout == "eight" else (self.path_radius,)
        for number, centre in enumerate(centres):
            for edge in (-0.5, 0.5):
                radius = self.path_radius + edge * self.width
                name = "edges of the lane" if number == 0 and edge < 0.0 else ""
                lines.append(Curve(name, radius * np.cos(turn), centre + radius * np.sin(turn), "line", 2))
        lines.append(Curve("centre of mass", record.x_com, record.y_com, "line", 0))
        outcome.charts.append(Chart("x", "m", "y", "m", tuple(lines), equal=True))
        lateral = Curve("Lateral acceleration", record.time, record.vx * record.yaw_rate)
        outcome.charts.append(Chart("Time", "s", "Lateral acceleration", "m/s²", (lateral,)))
