"""Sine with dwell (FMVSS 126, ISO 19365): rising amplitudes, each evaluated for stability."""

import math
from typing import ClassVar, Literal

import numpy as np

from mirdrake.core.yaml_io import Angle, Duration, Frequency, Length, Speed
from mirdrake.manoeuvres.base import (
    Chart,
    Curve,
    ManoeuvreSpec,
    NotFeasible,
    Outcome,
    scaled,
    setting,
)
from mirdrake.manoeuvres.checks import check_entry, check_speed, note_held_speed
from mirdrake.manoeuvres.metrics.straight import KMH
from mirdrake.manoeuvres.metrics.transient import DwellResponse, dwell_response
from mirdrake.manoeuvres.open_loop import SlowlyIncreasingSteerSpec
from mirdrake.manoeuvres.record import Record
from mirdrake.manoeuvres.rig import Rig
from mirdrake.manoeuvres.steady_circle import SIDES

_TWO = "seen in two independent implementations"


class SineWithDwellSpec(ManoeuvreSpec):
    """Stability after one period of a sine with a dwell at its second peak, coasting, with rising amplitudes."""

    title: ClassVar[str] = "Sine with dwell"
    standard: ClassVar[str] = "FMVSS 126, ISO 19365"
    headline: ClassVar[tuple[str, ...]] = ("passed_left", "displacement_left")

    speed: Speed = setting(80.0 * KMH, "speed at the beginning of steer", "m/s", "V", _TWO, gt=0.0)
    tolerance: Speed = setting(2.0 * KMH, "allowed difference of the speed", "m/s", "R", "FMVSS 126", gt=0.0)
    frequency: Frequency = setting(0.7, "frequency of the sine", "Hz", "V", _TWO, gt=0.0)
    dwell: Duration = setting(0.5, "dwell at the second peak", "s", "V", _TWO, ge=0.0)
    angle: Angle | None = setting(
        None, "A, the hand-wheel angle at 0.3 g; by default from a slowly increasing steer", "rad", "R", "FMVSS 126"
    )
    first: float = setting(1.5, "first amplitude over A", "", "R", "FMVSS 126", gt=0.0)
    increment: float = setting(0.5, "increment of the amplitude over A", "", "R", "FMVSS 126", gt=0.0)
    last: float = setting(6.5, "last amplitude over A", "", "R", "FMVSS 126", gt=0.0)
    least_last: Angle = setting(
        math.radians(270.0), "last amplitude at least", "rad", "R", "FMVSS 126", scales=False, ge=0.0
    )
    turns: Literal["both", "left", "right"] = setting("both", "first direction of the steering", "", "R", "FMVSS 126")
    waits: tuple[float, float] = setting(
        (1.0, 1.75), "times after completion of steer at which the yaw rate is evaluated", "s", "V", _TWO
    )
    shares: tuple[float, float] = setting((0.35, 0.20), "allowed yaw rate then over its peak", "", "V", _TWO)
    displacement: Length = setting(1.83, "least lateral displacement", "m", "V", _TWO + "; mass up to 3500 kg", gt=0.0)
    displacement_time: Duration = setting(
        1.07, "time after beginning of steer at which it is evaluated", "s", "V", _TWO, gt=0.0
    )
    displacement_from: float = setting(
        5.0, "amplitude over A from which on the displacement is evaluated", "", "R", "FMVSS 126", gt=0.0
    )
    threshold: Angle = setting(
        math.radians(5.0), "hand-wheel angle that counts as turned, at most 5 % of the peak", "rad", "R", "FMVSS 126"
    )
    resolution: float = setting(
        0.001, "relative difference of amplitudes at which the search of the lowest that fails ends", "", "own", ge=1e-4
    )
    settle: Duration = setting(0.5, "time straight ahead before the sine", "s", "own", ge=0.0)

    def drive(self, rig: Rig, outcome: Outcome) -> None:
        """Simulate a slowly increasing steer if A is not given, then all amplitudes to both sides."""
        facts = rig.facts
        check_speed(facts, self.speed)
        # All amplitudes are multiples of A, so that vehicles with other steering ratios and gains have an equal test.
        angle = self.angle or self._find_angle(rig, outcome)
        outcome.add("a", "A, the hand-wheel angle at 0.3 g", math.degrees(angle), "deg")
        # The least last amplitude is an angle of a car's hand-wheel, so it does not apply to small vehicles.
        max_amplitude = max(self.last * angle, self.least_last if facts.scale == 1.0 else 0.0)
        amplitudes = [self.first * angle]
        while amplitudes[-1] < max_amplitude - 1e-9:
            amplitudes.append(min(amplitudes[-1] + self.increment * angle, max_amplitude))
        # A sine of amplitude A and frequency f has the largest rate 2 π f A.
        allowed = min(facts.steering_limit, facts.steering_rate / (2.0 * math.pi * self.frequency)) * facts.ratio
        feasible = [amplitude for amplitude in amplitudes if amplitude <= allowed]
        if not feasible:
            raise NotFeasible(
                f"the first amplitude is {math.degrees(amplitudes[0]):.0f} deg at the hand-wheel, but the steering "
                f"follows {self.frequency:g} Hz up to {math.degrees(allowed):.0f} deg only"
            )
        if len(feasible) < len(amplitudes):
            outcome.notes.append(
                f"the steering follows {self.frequency:.3g} Hz up to {math.degrees(allowed):.0f} deg at the "
                f"hand-wheel; {len(amplitudes) - len(feasible)} larger amplitudes, up to "
                f"{math.degrees(amplitudes[-1]):.0f} deg, were omitted"
            )
        note_held_speed(outcome, pedals=rig.pedals)

        # The first failure on a side ends that side.
        sides = ["left", "right"] if self.turns == "both" else [self.turns]
        responses: dict[str, list[tuple[float, DwellResponse]]] = {}
        faults: list[str] = []
        passed: dict[str, float] = {}
        lowest_failed: dict[str, float] = {}
        for side in sides:
            for amplitude in feasible:
                record = self._sine(rig, side, amplitude)
                response = self._evaluate(record, amplitude)
                responses.setdefault(side, []).append((amplitude, response))
                fault = self._fault(response, amplitude, angle, side)
                if fault is not None:
                    faults.append(fault)
                    self._draw(outcome, record, side, fault=True)
                    if side in passed:
                        lowest_failed[side] = self._lowest_failing(rig, side, passed[side], amplitude, angle)
                    break
                passed[side] = amplitude
            else:
                self._draw(outcome, record, side, fault=False)
        # The worst figures of each side, and the largest amplitude that passed.
        for side, results in responses.items():
            # The worst case over all amplitudes of a side, as each of them has to pass. Near the lowest amplitude that
            # fails, the ratios change by many times a change of the amplitude: those of a failure are in the reason.
            failed = results[-1][0] > passed.get(side, 0.0)
            for number, wait in enumerate(() if failed else self.waits):
                ratio = max(response.ratios[number] for _, response in results)
                text = f"Largest yaw-rate ratio {wait:.3g} s after completion, {side}"
                max_amplitude = 100.0 * self.shares[number]
                outcome.add(
                    f"ratio_{number + 1}_{side}", text, 100.0 * ratio, "%", f"{max_amplitude:g} %", scale=max_amplitude
                )
            if side in lowest_failed:
                lowest = lowest_failed[side]
                text, note = f"Lowest amplitude that fails, {side}", f"{lowest / angle:.2f} A, by bisection"
                outcome.add(f"failed_{side}", text, math.degrees(lowest), "deg", note)
            text = f"Smallest displacement {self.displacement_time:.3g} s after the beginning, {side}"
            min_displacement = min(
                (response.displacement for amplitude, response in results if self._is_large(amplitude, angle)),
                default=math.nan,
            )
            outcome.add(f"displacement_{side}", text, min_displacement, "m", f"at least {self.displacement:.3g} m")
            largest = max(amplitude for amplitude, _ in results)
            outcome.add(f"amplitude_{side}", f"Last amplitude, {side}", math.degrees(largest), "deg", "hand-wheel")
            passed_angle = math.degrees(passed.get(side, math.nan))
            note = f"{passed_angle / math.degrees(angle):.1f} A" if side in passed else "none"
            outcome.add(f"passed_{side}", f"Largest amplitude that passed, {side}", passed_angle, "deg", note)
        # "pass" needs all required amplitudes; without a failure but with omitted ones the test is not possible.
        outcome.verdict = "fail" if faults else "pass" if len(feasible) == len(amplitudes) else "not possible"
        outcome.reason = "; ".join(faults)
        if outcome.verdict == "not possible":
            outcome.reason = (
                f"it passes up to {math.degrees(feasible[-1]):.0f} deg, beyond which the steering is too slow for "
                f"{self.frequency:.3g} Hz; {math.degrees(amplitudes[-1]):.0f} deg are required"
            )

    def _lowest_failing(self, rig: Rig, side: str, passed: float, failed: float, angle: float) -> float:
        """Return the lowest amplitude that fails [rad], between one that passed and one that failed.

        Args:
            rig: the vehicle.
            side: first direction of the steering.
            passed: amplitude that passed [rad].
            failed: amplitude that failed [rad].
            angle: reference angle A of the standard [rad].
        """
        while failed - passed > self.resolution * failed:
            amplitude = 0.5 * (passed + failed)
            response = self._evaluate(self._sine(rig, side, amplitude), amplitude)
            if self._fault(response, amplitude, angle, side) is None:
                passed = amplitude
            else:
                failed = amplitude
        return failed

    def _is_large(self, amplitude: float, angle: float) -> bool:
        """Return whether the steering amplitude [rad] is large enough for the limit of the displacement.

        Args:
            amplitude: steering amplitude [rad].
            angle: reference angle A of the standard [rad].
        """
        return amplitude >= self.displacement_from * angle - 1e-9

    def _find_angle(self, rig: Rig, outcome: Outcome) -> float:
        """Return A [rad] from a slowly increasing steer."""
        inner = Outcome("", "", "")
        # Run within this manoeuvre: its own outcome is not reported, but its notes are.
        spec = scaled(SlowlyIncreasingSteerSpec(), rig.facts.scale).model_copy(update={"speed": self.speed})
        spec.drive(rig, inner)
        outcome.notes += inner.notes
        return math.radians(inner.value("a") or math.nan)

    def _sine(self, rig: Rig, side: str, amplitude: float) -> Record:
        # Amplitudes of the standard are those of the hand-wheel; drivers steer by the bicycle angle.
        angle = SIDES[side] * amplitude / rig.facts.ratio
        profile = {"kind": "sine_with_dwell", "amplitude": angle, "start": self.settle}
        profile |= {"frequency": self.frequency, "dwell": self.dwell}
        length = self.settle + 1.0 / self.frequency + self.dwell + max(self.waits) + 0.5
        # The throttle is released: it coasts in neutral; without pedals the speed is held instead.
        pedals = [[0.0, 0.0, 0.0, 0.0]] if rig.pedals else None
        record = rig.run(
            f"{side}_{math.degrees(amplitude):.5g}deg",
            rig.open_driver(profile, pedals=pedals, speeds=None if pedals else [[0.0, self.speed]]),
            duration=length,
            speed=self.speed,
        )
        check_entry(
            float(np.interp(self.settle, record.time, record.vx)), self.speed, self.tolerance, where="at the beginning"
        )
        return record

    def _evaluate(self, record: Record, amplitude: float) -> DwellResponse:
        return dwell_response(
            record.time,
            record.hand_wheel,
            record.yaw_rate,
            record.y_com,
            after_completion=self.waits,
            after_beginning=self.displacement_time,
            threshold=min(self.threshold, 0.05 * amplitude),
        )

    def _fault(self, response: DwellResponse, amplitude: float, angle: float, side: str) -> str | None:
        """Return the reason why an amplitude fails; None if it passes."""
        title = f"{side}, {math.degrees(amplitude):.0f} deg"
        for ratio, share, wait in zip(response.ratios, self.shares, self.waits, strict=True):
            # NaN (the run ended before) must fail as well, hence not <=.
            if not ratio <= share:
                return f"{title}: yaw rate {100 * ratio:.0f} % of its peak {wait:.3g} s after completion of steer"
        if self._is_large(amplitude, angle) and not response.displacement >= self.displacement:
            return (
                f"{title}: lateral displacement {response.displacement:.2f} m, required are {self.displacement:.3g} m"
            )
        return None

    def _draw(self, outcome: Outcome, record: Record, side: str, *, fault: bool) -> None:
        name = f"{side}, {'failed amplitude' if fault else 'largest amplitude'}"
        colour = 0 if side == "left" else 1
        rows = (
            ("Hand-wheel angle", "deg", np.degrees(record.hand_wheel)),
            ("Yaw rate", "deg/s", np.degrees(record.yaw_rate)),
            ("Lateral displacement", "m", record.y_com - record.y_com[0]),
        )
        for number, (label, unit, values) in enumerate(rows):
            line = Curve(name, record.time, values, "line", colour)
            # Both sides share a chart per signal: the second side adds its line to the existing one.
            if len(outcome.charts) > number:
                chart = outcome.charts[number]
                outcome.charts[number] = Chart("Time", "s", label, unit, (*chart.lines, line))
            else:
                outcome.charts.append(Chart("Time", "s", label, unit, (line,)))
