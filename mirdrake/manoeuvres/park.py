"""Creep of a held vehicle at standstill, on the flat and on a slope."""

import math
from typing import ClassVar

import numpy as np

from mirdrake.core.yaml_io import Duration, Speed
from mirdrake.manoeuvres.base import Chart, Curve, ManoeuvreSpec, NotFeasible, Outcome, setting
from mirdrake.manoeuvres.metrics.straight import creep
from mirdrake.manoeuvres.rig import Rig


class ParkSpec(ManoeuvreSpec):
    """Creep speed of a vehicle that is held on the flat, uphill and across a slope."""

    title: ClassVar[str] = "Park"
    standard: ClassVar[str] = "no standard; a check of the model at standstill"
    headline: ClassVar[tuple[str, ...]] = ("creep_flat", "creep_uphill")

    grade: float = setting(0.12, "rise over run of the slope", "", "own", gt=0.0, le=0.5)
    brake: float = setting(1.0, "position of the pedal, if there is one", "", "own", gt=0.0, le=1.0)
    settle: Duration = setting(
        5.0,
        "time at the start that is not evaluated, as the vehicle rocks on its tyres",
        "s",
        "own",
        scales=False,
        ge=0.0,
    )
    length: Duration = setting(10.0, "time over which creeping is measured", "s", "own", scales=False, gt=0.0)
    allowed: Speed = setting(1e-4, "creep speed that passes", "m/s", "own", scales=False, gt=0.0)

    def drive(self, rig: Rig, outcome: Outcome) -> None:
        """Simulate the three runs."""
        # tanh of the speed replaces dry friction in that model, so a slope always moves it slowly.
        if rig.kind == "single_track":
            raise NotFeasible("the brakes of the single-track model cannot hold it on a slope: it creeps")
        lines, faults = [], []
        if not rig.pedals:
            outcome.notes.append("the vehicle has no pedals: parking brakes hold its wheels")
        for number, (name, text, grade, heading) in enumerate(
            (
                ("flat", "on the flat", 0.0, 0.0),
                ("uphill", f"uphill, {100 * self.grade:g} %", self.grade, 0.0),
                ("across", f"across a slope of {100 * self.grade:g} %", self.grade, 0.5 * math.pi),
            )
        ):
            line = {"kind": "straight", "length": 50.0}
            pedals = [[0.0, 0.0, self.brake, 0.0]] if rig.pedals else None
            speeds = None if rig.pedals else [[0.0, 0.0]]
            driver = rig.line_driver(line, pedals=pedals, speeds=speeds, hands=False)
            # The slope tilts gravity; its heading relative to the vehicle makes it uphill or across.
            ground = {"slope": {"grade": grade, "heading": heading}} if grade else None
            record = rig.run(name, driver, duration=self.settle + self.length, ground=ground, parked=not rig.pedals)
            speed, drift = creep(record.time, record.x, record.y, settle=self.settle)
            allowed = 1000.0 * self.allowed
            outcome.add(
                f"creep_{name}", f"Creep {text}", 1000.0 * speed, "mm/s", f"at most {allowed:g} mm/s", scale=allowed
            )
            # A drift has no natural size; it is judged against the largest allowed one.
            allowed_drift = allowed * self.length
            outcome.add(
                f"drift_{name}", f"Drift in {self.length:g} s {text}", 1000.0 * drift, "mm", scale=allowed_drift
            )
            # Also fails for NaN.
            if not speed <= self.allowed:
                faults.append(f"{text} it creeps at {1000.0 * speed:.3g} mm/s")
            distance = 1000.0 * np.hypot(record.x - record.x[0], record.y - record.y[0])
            lines.append(Curve(text, record.time, distance, "line", number))
        outcome.verdict = "fail" if faults else "pass"
        outcome.reason = "; ".join(faults)
        outcome.charts.append(Chart("Time", "s", "Distance from the start", "mm", tuple(lines)))
