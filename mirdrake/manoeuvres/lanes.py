"""Courses between cones: double lane change, obstacle avoidance, slalom; the highest speed without a touch."""

import math
from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from mirdrake.core.constants import GRAVITY
from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import Length, Speed
from mirdrake.manoeuvres.base import (
    Chart,
    Curve,
    Diverged,
    ManoeuvreSpec,
    NotFeasible,
    Outcome,
    setting,
)
from mirdrake.manoeuvres.checks import check_speed, note_held_speed
from mirdrake.manoeuvres.courses import Body, Section, clearance, make_line
from mirdrake.manoeuvres.facts import Facts
from mirdrake.manoeuvres.metrics.straight import KMH
from mirdrake.manoeuvres.metrics.transient import crossing
from mirdrake.manoeuvres.record import Record
from mirdrake.manoeuvres.rig import Rig
from mirdrake.manoeuvres.search import find_highest, once_per_label, speed_label

_CHRONO = "Project Chrono double-lane-change demo"


class CourseSpec(ManoeuvreSpec):
    """Base class of the courses: a planned line and a bisection of the entry speed."""

    releases: ClassVar[bool] = False
    """Whether the throttle is released in the course, `release` after its entry."""

    lowest: Speed = setting(30.0 * KMH, "lowest speed of the bisection", "m/s", "own", gt=0.0)
    highest: Speed = setting(110.0 * KMH, "highest speed of the bisection", "m/s", "own", gt=0.0)
    resolution: Speed = setting(0.1 * KMH, "difference of speeds at which the bisection ends", "m/s", "own", gt=0.0)
    check: Speed = setting(2.0 * KMH, "range below the limit in which all speeds must pass", "m/s", "own", ge=0.0)
    check_step: Speed = setting(0.25 * KMH, "difference of the speeds in this range", "m/s", "own", gt=0.0)
    share: float = setting(
        0.8, "largest speed of the other figures over the speed that friction may allow", "", "own", gt=0.0
    )
    multiple: Speed = setting(
        5.0 * KMH, "step to which the speed of the other figures is rounded down", "m/s", "own", gt=0.0
    )
    margin: Length = setting(
        0.1, "distance between body and cones on the planned line, if there is room", "m", "own", ge=0.0
    )
    run_up: Length = setting(30.0, "straight distance before the course", "m", "own", gt=0.0)
    run_out: Length = setting(25.0, "straight distance after the course", "m", "own", ge=0.0)

    @abstractmethod
    def sections(self, width: float) -> list[Section]:
        """Return the course for a vehicle of a width [m]."""

    def planned_sections(self, width: float) -> list[Section]:
        """Return the course through which the line of the driver is planned, for a vehicle of a width [m]."""
        return self.sections(width)

    def drive(self, rig: Rig, outcome: Outcome) -> None:
        """Bisect the entry speed, and take the other figures at a lower speed."""
        facts = rig.facts
        if self.highest <= self.lowest:
            raise self.fault("highest", "must be above lowest")
        # Cones are placed by the width of the vehicle, as the standards do.
        sections = self.sections(facts.width)
        tightest = min((section.high - section.low for section in sections), default=math.inf)
        if tightest <= facts.width:
            raise NotFeasible(f"the vehicle is {facts.width:.2f} m wide, the narrowest lane {tightest:.2f} m")
        if self.releases:
            note_held_speed(outcome, pedals=rig.pedals)
        # Close to the top speed the vehicle could not hold its speed in the turns.
        highest = min(self.highest, 0.95 * facts.top_speed)
        check_speed(facts, self.lowest)

        passes: list[tuple[float, Record]] = []

        @once_per_label  # the speed of the figures below has often been tried by the bisection
        def attempt(speed: float) -> tuple[tuple[Record, list[float]] | None, str]:
            record, room = self._try(rig, sections, speed)
            fault = _fault(room, sections, x=float(np.max(record.x)) + facts.rear)
            if not fault:
                passes.append((speed, record))
            return (record, room), fault

        guess = self._guess(facts)
        limit = find_highest(
            attempt,
            lowest=self.lowest,
            highest=highest,
            guess=guess,
            resolution=self.resolution,
            check=self.check,
            step=self.check_step,
        )
        if limit.best is None:
            raise NotFeasible(f"it does not pass at {self.lowest / KMH:.0f} km/h, the lowest speed: {limit.reason}")
        # The entry speed is that where the front passes the first cones, not the set-point.
        best, failed = limit.best[0], limit.failed
        # A speed above the first failure may have passed by chance.
        passes = [run for run in passes if run[0] <= limit.passed]
        entry = self._entry(best, facts) / KMH
        note = f"within {self.resolution / KMH:.2g} km/h"
        outcome.add("speed", "Highest entry speed without a touch", entry, "km/h", note)
        if failed < math.inf:
            outcome.add("failed", "Lowest speed that failed", failed / KMH, "km/h", limit.reason)
        else:
            outcome.notes.append("it passes at the highest speed that was tried")

        # The limit depends on the step of the plant a little; figures at a round speed below it can be compared.
        # A round speed in steps of `multiple`; the tolerance keeps an exact multiple from being rounded down.
        target = min(self.share * guess, limit.passed)
        speed = max(self.lowest, self.multiple * math.floor(target / self.multiple + 1e-9))
        result, fault = attempt(speed)
        # Passing is not monotonous near the limit: go down until a run passes.
        while fault and speed - self.multiple >= self.lowest:
            speed -= self.multiple
            result, fault = attempt(speed)
        if result is None:
            raise Diverged(fault)
        record, room = result
        note = f"at {speed / KMH:.3g} km/h"
        outcome.add("figures_speed", "Speed at which the figures below are taken", speed / KMH, "km/h", fault)
        outcome.add("exit", "Speed at the end of the course", _exit(record, sections) / KMH, "km/h", note)
        # Scale of the clearance: the width of the lateral motion; zero clearance has no relative deviation of its own.
        inside = record.y[(record.x > sections[0].x0) & (record.x < sections[-1].x1)]
        sideways = float(np.ptp(inside)) if len(inside) else None
        outcome.add("room", "Smallest distance to the cones", min(room), "m", note, scale=sideways)
        for key, (text, value, unit) in self._peaks(record, sections, facts).items():
            outcome.add(key, text, value, unit, note)
        outcome.notes.append("the driver follows a planned line; another driver may be faster or slower")
        self._note_limit(outcome, passes, sections, facts)
        self._draw(outcome, best, sections, facts)

    def _peaks(self, record: Record, sections: list[Section], facts: Facts) -> dict[str, tuple[str, float, str]]:
        """Return the largest values in the course by key: name, value, unit."""
        course = (record.x + facts.front > sections[0].x0) & (record.x + facts.rear < sections[-1].x1)
        rows = (
            ("lateral", "Largest lateral acceleration", record.lateral_acceleration / GRAVITY, "g"),
            ("yaw_rate", "Largest yaw rate", np.degrees(record.yaw_rate), "deg/s"),
            ("sideslip", "Largest sideslip angle", np.degrees(record.sideslip), "deg"),
            ("hand_wheel", "Largest hand-wheel angle", np.degrees(record.hand_wheel), "deg"),
            ("roll", "Largest roll angle", np.degrees(record.roll), "deg"),
        )
        return {
            key: (text, float(np.max(np.abs(values[course]), initial=0.0)), unit) for key, text, values, unit in rows
        }

    def _note_limit(
        self, outcome: Outcome, passes: list[tuple[float, Record]], sections: list[Section], facts: Facts
    ) -> None:
        """Add a note with the peaks at the limit and their sensitivity to the speed; they are good to two digits."""
        # The two fastest runs that passed; with a single one there is no sensitivity.
        low, high = sorted(passes, key=lambda run: run[0])[-2:] if len(passes) > 1 else passes * 2
        peaks = self._peaks(high[1], sections, facts)
        text = ", ".join(
            f"{name.removeprefix('Largest ')} {_rough(value)} {unit}" for name, value, unit in peaks.values()
        )
        slips = [self._peaks(record, sections, facts)["sideslip"][1] for _, record in (low, high)]
        if high[0] > low[0] and min(slips) > 0.0:
            change = 100.0 * abs(math.log(slips[1] / slips[0]) / (high[0] - low[0]) * self.resolution)
            text += f"; there {self.resolution / KMH:.2g} km/h change the sideslip by {change:.2g} %"
        outcome.notes.append(f"largest values at the limit, {high[0] / KMH:.4g} km/h: {text}")

    def _guess(self, facts: Facts) -> float:
        """Return a speed [m/s] that friction may allow on the planned line."""
        try:
            line = make_line(self._line(facts, 0.3 * facts.wheelbase))
        except ConfigError as error:
            raise NotFeasible(error.text) from None
        # A quarter of the friction is left for transients and the load transfer.
        grip = 0.75 * min(facts.parameters.front_friction, facts.parameters.rear_friction) * GRAVITY
        return math.sqrt(grip / max(float(np.max(np.abs(line.curvature))), 1e-6))

    def _range(self, facts: Facts, sections: list[Section]) -> tuple[float, float]:
        """Return x of the rear axle at the start and at the end of a run [m]."""
        return sections[0].x0 - facts.front - self.run_up, sections[-1].x1 - facts.rear + self.run_out

    def _line(self, facts: Facts, point: float) -> dict[str, object]:
        """Return the line of the point that is `point` ahead of the rear axle [m]."""
        sections = self.planned_sections(facts.width)
        start, end = self._range(facts, sections)
        return {
            "kind": "within",
            # None stands for an open side, as a diagram file has no infinity.
            "sections": [[s.x0, s.x1, *(None if math.isinf(v) else v for v in (s.low, s.high))] for s in sections],
            "rear": facts.rear - point,
            "front": facts.front - point,
            # The line is that of the pointing point, so body ends and cones are relative to it.
            "half_width": 0.5 * facts.width,
            "margin": self.margin,
            "start": start - 1.0,
            "end": end + facts.front,
            "smoothness": 8.0 * facts.scale,
        }

    def _try(self, rig: Rig, sections: list[Section], speed: float) -> tuple[Record, list[float]]:
        facts = rig.facts
        # The point without sideslip follows the line: there the direction of motion is that of the body.
        point = facts.pointing(speed)
        start, end = self._range(facts, sections)
        # Throttle released: the pedals hold the speed up to the release, then nothing; without pedals the speed is
        # held.
        coasts = self.releases and rig.pedals
        driver = rig.line_driver(
            self._line(facts, point),
            speed=speed,
            speeds=None if coasts else [[0.0, speed]],
            pedals=[[0.0, 0.0, 0.0, 1.0]] if coasts else None,
            held=[speed, self._release() - facts.front] if coasts else None,
            ahead=point,
        )
        # A run that is 10 m (to scale) beside the outermost cones is lost; end it early.
        lost = max(s.high for s in sections if math.isfinite(s.high)) + 10.0 * facts.scale

        def stop(time: float, state: Sequence[float]) -> str | None:  # noqa: ARG001
            if state[0] > end:
                return "the end of the course"
            if abs(state[1]) > lost:
                return "it left the course"
            return "it stopped" if state[6] < 0.2 * speed else None

        try:
            record = rig.run(
                # Twice the time of the course at constant speed: a coasting vehicle is slower.
                speed_label(speed),
                driver,
                duration=2.0 * (end - start) / speed,
                speed=speed,
                x=start,
                stop=stop,
            )
        except ConfigError as error:
            raise NotFeasible(error.text) from None
        return record, self._room(facts, sections, record)

    def _room(self, facts: Facts, sections: list[Section], record: Record) -> list[float]:
        body = Body(facts.rear, facts.front, 0.5 * facts.width)
        return [float(value) for value in clearance(record.x, record.y, record.yaw, body, sections)]

    def _release(self) -> float:
        """Return x of the front end at which the throttle is released [m]."""
        return 0.0

    def _entry(self, record: Record, facts: Facts) -> float:
        """Return the speed [m/s] at which the front end enters the course."""
        return float(np.interp(crossing(record.time, record.x + facts.front, 0.0), record.time, record.vx))

    def _draw(self, outcome: Outcome, record: Record, sections: list[Section], facts: Facts) -> None:
        # Cones bound each section to one or both sides.
        edges: list[Curve] = []
        for number, section in enumerate(sections):
            for level in (section.low, section.high):
                if math.isfinite(level):
                    name = "" if number or edges else "lines of cones"
                    x = np.array([section.x0, section.x1])
                    edges.append(Curve(name, x, np.array([level, level]), "line", 2))
        # Only the course and a little before and after it, as the run-up is straight.
        chosen = (record.x > sections[0].x0 - 15.0 * facts.scale) & (record.x < sections[-1].x1 + 10.0 * facts.scale)
        cos, sin = np.cos(record.yaw[chosen]), np.sin(record.yaw[chosen])
        x, y, half = record.x[chosen], record.y[chosen], 0.5 * facts.width
        lines = [*edges, Curve("middle of the rear axle", x, y, "line", 0)]
        # The front corners decide whether cones fall; the rear ones follow inside.
        for sign, word in ((1.0, "front corners"), (-1.0, "")):
            px, py = x + facts.front * cos - sign * half * sin, y + facts.front * sin + sign * half * cos
            lines.append(Curve(word, px, py, "dashed", 1))
        outcome.charts.append(Chart("x", "m", "y", "m", tuple(lines)))
        for label, unit, values in (
            ("Hand-wheel angle", "deg", np.degrees(record.hand_wheel)),
            ("Lateral acceleration", "m/s²", record.lateral_acceleration),
        ):
            line = Curve(label, record.x[chosen], values[chosen])
            outcome.charts.append(Chart("x", "m", label, unit, (line,)))


def _rough(value: float) -> str:
    """Return a number with two digits and no exponent."""
    return f"{value:.2g}" if value < 99.5 else f"{value:.0f}"


def _fault(room: Sequence[float], sections: Sequence[Section], *, x: float) -> str:
    """Return the reason why a run did not pass; empty if it did.

    Args:
        room: smallest distance to the cones of each section [m].
        sections: the course.
        x: largest x of the rear end [m].
    """
    if any(math.isinf(value) for value in room):
        return f"it did not reach section {[math.isinf(value) for value in room].index(True) + 1} of {len(sections)}"
    worst = int(np.argmin(room))
    if room[worst] < 0.0:
        return f"cones hit by {1000.0 * -room[worst]:.0f} mm in section {worst + 1}"
    return "" if x > sections[-1].x1 else "it did not leave the course"


def _exit(record: Record, sections: Sequence[Section]) -> float:
    time = crossing(record.time, record.x, sections[-1].x1)
    return float(np.interp(time, record.time, record.vx)) if math.isfinite(time) else math.nan


class DoubleLaneChangeSpec(CourseSpec):
    """Double lane change at a held speed: the highest entry speed without touching a cone."""

    title: ClassVar[str] = "Double lane change"
    standard: ClassVar[str] = "ISO 3888-1"
    headline: ClassVar[tuple[str, ...]] = ("speed",)

    lengths: tuple[float, float, float, float, float] = setting(
        (15.0, 30.0, 25.0, 25.0, 30.0), "of lane A, gap, lane B, gap, lane C with exit", "m", "V", _CHRONO
    )
    factors: tuple[float, float, float] = setting((1.1, 1.2, 1.3), "lane width over vehicle width", "", "V", _CHRONO)
    extra: Length = setting(0.25, "length added to the widths of the lanes", "m", "V", _CHRONO, ge=0.0)
    offset: Length = setting(3.5, "from the axis of lane A to the near edge of lane B", "m", "V", _CHRONO, ge=0.0)

    def sections(self, width: float) -> list[Section]:
        """Return lanes A, B and C; C is aligned with the far edge of A."""
        a, b, c = (factor * width + self.extra for factor in self.factors)
        l1, g1, l2, g2, l3 = self.lengths
        return [
            Section(0.0, l1, -0.5 * a, 0.5 * a),
            Section(l1 + g1, l1 + g1 + l2, self.offset, self.offset + b),
            Section(l1 + g1 + l2 + g2, l1 + g1 + l2 + g2 + l3, -0.5 * a, -0.5 * a + c),
        ]


class ObstacleAvoidanceSpec(CourseSpec):
    """Obstacle avoidance with the throttle released: the highest entry speed without touching a cone."""

    title: ClassVar[str] = "Obstacle avoidance"
    standard: ClassVar[str] = "ISO 3888-2"
    headline: ClassVar[tuple[str, ...]] = ("speed",)
    releases: ClassVar[bool] = True

    lengths: tuple[float, float, float, float, float] = setting(
        (12.0, 13.5, 11.0, 12.5, 12.0), "of section 1, gap, section 3, gap, section 5", "m", "V", _CHRONO
    )
    first_factor: float = setting(1.1, "width of section 1 over that of the vehicle", "", "V", _CHRONO, gt=0.0)
    first_extra: Length = setting(0.25, "length added to the width of section 1", "m", "V", _CHRONO, ge=0.0)
    second_extra: Length = setting(1.0, "width of section 3 minus that of the vehicle", "m", "V", _CHRONO, ge=0.0)
    third_width: Length = setting(3.0, "width of section 5; others use 1.3 b + 0.25 m", "m", "V", _CHRONO, gt=0.0)
    offset: Length = setting(1.0, "between the edges of sections 1 and 3", "m", "V", _CHRONO, ge=0.0)
    release: Length = setting(
        2.0, "distance after the entry at which the throttle is released", "m", "R", "ISO 3888-2", ge=0.0
    )

    def _release(self) -> float:
        return self.release

    def sections(self, width: float) -> list[Section]:
        """Return sections 1, 3 and 5 for a vehicle of a width [m]; the right edges of sections 1 and 5 are in line."""
        a, b = self.first_factor * width + self.first_extra, width + self.second_extra
        l1, g1, l2, g2, l3 = self.lengths
        low = 0.5 * a + self.offset
        return [
            Section(0.0, l1, -0.5 * a, 0.5 * a),
            Section(l1 + g1, l1 + g1 + l2, low, low + b),
            Section(l1 + g1 + l2 + g2, l1 + g1 + l2 + g2 + l3, -0.5 * a, -0.5 * a + self.third_width),
        ]


class SlalomSpec(CourseSpec):
    """Slalom round cones in a row at a held speed: the highest speed without touching one."""

    title: ClassVar[str] = "Slalom"
    standard: ClassVar[str] = "no standard; cones 18 m apart, as magazines have them"
    headline: ClassVar[tuple[str, ...]] = ("speed",)

    spacing: Length = setting(18.0, "distance from cone to cone", "m", "R", "magazines", gt=0.0)
    cones: int = setting(6, "number of cones", "", "R", "magazines", ge=2, le=50)
    radius: Length = setting(0.15, "radius of a cone", "m", "own", ge=0.0)
    lowest: Speed = setting(20.0 * KMH, "lowest speed of the bisection", "m/s", "own", gt=0.0)

    def sections(self, width: float) -> list[Section]:
        """Return a short section for each cone, open to the other side, and the exit lane on the line of the cones.

        The exit lane is as far from the last cone as the start is from the first one, and is one spacing long. It is as
        wide as the range of y that a vehicle needs which passes cones on both sides, 2 (width + radius). A vehicle that
        slides or spins after the last cone does not pass it.
        """
        sides = ((self.radius, math.inf), (-math.inf, -self.radius))
        centres = [number * self.spacing for number in range(self.cones)]
        cones = [Section(x - self.radius, x + self.radius, *sides[number % 2]) for number, x in enumerate(centres)]
        half, entry = width + self.radius, centres[-1] + self.run_up
        return [*cones, Section(entry, entry + self.spacing, -half, half)]

    def planned_sections(self, width: float) -> list[Section]:
        """Return the same with a narrower exit lane, so that the driver returns to the line of the cones."""
        *cones, lane = self.sections(width)
        half = 0.5 * width + self.margin
        return [*cones, lane._replace(low=-half, high=half)]
