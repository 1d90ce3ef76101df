"""Tables of the report of a tuning study: criteria, candidates, experiments, Monte Carlo, gains over speed."""

import math
from dataclasses import dataclass

from mirdrake.report.tuning_texts import FIGURES, GROUPS, KINDS, Texts, criterion_text
from mirdrake.report.words import format_quantity
from mirdrake.tuning.result import CandidateResult, ScheduleTest
from mirdrake.tuning.scenarios import describe

_MONTE_CARLO_FIGURES = ("iae", "overshoot_percent", "settling_time", "ms", "phase_margin_deg", "saturation_time")
"""Figures of the Monte Carlo that are shown, besides those of the cost."""

_MOST_COLUMNS = 7
"""Columns of numbers of a table of candidates, so that it fits a page of 1080 px."""


@dataclass(frozen=True)
class CandidateRow:
    """Row of the table of candidates.

    Attributes:
        name: name of the candidate.
        kind: kind of the candidate.
        role: role in the charts; empty if it is not shown there.
        verdict: feasible, breaks a limit, unstable or failed.
        tone: good, plain or bad.
        numbers: text and sorting key of each column.
        reason: reason of a rejection.
    """

    name: str
    kind: str
    role: str
    verdict: str
    tone: str
    numbers: list[tuple[str, str]]
    reason: str


@dataclass(frozen=True)
class RobustnessRow:
    """Row of the table of the Monte Carlo."""

    name: str
    failed: str
    interval: str
    bad: bool
    corners: tuple[str, str] | None
    cells: list[tuple[str, str, str]]


@dataclass(frozen=True)
class RobustnessTable:
    """Table of the Monte Carlo.

    Attributes:
        runs: number of runs.
        ranges: ranges of the conditions.
        figures: label and unit of each.
        rows: rows of the candidates.
        grip: sentence on the grip that the runs require; empty if it is not known.
    """

    runs: int
    ranges: str
    figures: list[tuple[str, str]]
    rows: list[RobustnessRow]
    grip: str

    @property
    def corners(self) -> bool:
        """Whether corners of the ranges were tested."""
        return any(row.corners is not None for row in self.rows)


class Tables:
    """Tables of one result.

    Args:
        texts: texts of the result.
        roles: roles of the candidates in the charts, by name.
    """

    def __init__(self, texts: Texts, roles: dict[str, str]) -> None:
        self.texts, self.result, self.roles = texts, texts.result, roles

    def acceptance(self) -> list[tuple[str, str, str, bool]]:
        """Return criterion, value, limit, and whether it is met."""
        rows = []
        for criterion in self.result.acceptance:
            text = criterion_text(criterion, self.result)
            if criterion.name == "constraint":
                text = labelled(*self.texts.figure(criterion.figure)).removesuffix(" [1]")
            rows.append((text, _number(criterion.value), _number(criterion.limit), criterion.met))
        return rows

    def head(self) -> list[tuple[str, str]]:
        """Return label and unit of the columns of numbers in the table of candidates."""
        gains = [(name, gain.unit) for name, gain in self.result.loop.gains.items()]
        return [*gains, ("Cost", ""), *(self.texts.figure(name) for name in self._names())]

    def groups(self) -> list[tuple[str, list[int]]]:
        """Return the title of each table of candidates, and its columns as indices into :meth:`head`."""
        gains, names = len(self.result.loop.gains) + 1, self._names()
        titles = {name: title for title, figures in GROUPS.items() for name in figures}
        groups: dict[str, list[int]] = {"Gains and cost": list(range(gains))}
        for column, name in enumerate(names, start=gains):
            groups.setdefault(titles.get(name, "Other figures"), []).append(column)
        return [
            (title if start == 0 else "", columns[start : start + _MOST_COLUMNS])
            for title, columns in groups.items()
            for start in range(0, len(columns), _MOST_COLUMNS)
        ]

    def _names(self) -> list[str]:
        """Return the figures that any candidate has, in the order of :data:`FIGURES`."""
        has = dict.fromkeys(name for candidate in self.result.candidates for name in candidate.figures)
        return [name for name in FIGURES if name in has] + [name for name in has if name not in FIGURES]

    def rows(self) -> list[CandidateRow]:
        """Return the candidates with all figures."""
        rows = []
        for candidate in self.result.candidates:
            # Missing values are sorted to the end by the script of the page.
            numbers = [candidate.gains.get(name) for name in self.result.loop.gains]
            numbers += [candidate.cost, *(candidate.figures.get(name) for name in self._names())]
            verdict = _verdict(candidate)
            rows.append(
                CandidateRow(
                    name=candidate.name,
                    kind=KINDS[candidate.kind],
                    role=self.roles.get(candidate.name, ""),
                    verdict=verdict,
                    tone={"feasible": "good", "breaks a limit": "plain"}.get(verdict, "bad"),
                    numbers=[(_number(value), _sortable(value)) for value in numbers],
                    reason=self.texts.rejections(candidate.rejections) or candidate.reason,
                )
            )
        return rows

    def origins(self) -> list[tuple[str, str, str]]:
        """Return name, kind and origin of each candidate."""
        return [
            (candidate.name, KINDS[candidate.kind], self.texts.how(candidate)) for candidate in self.result.candidates
        ]

    def rejected(self) -> list[tuple[str, str, str]]:
        """Return gains, cost and reasons of candidates that are not the best though they cost less, and of trials."""
        # Only cheaper candidates need a reason for not having won.
        limit = self.texts.winner.cost if self.texts.winner else None
        rows = [
            (candidate.name, _number(candidate.cost), self.texts.rejections(candidate.rejections))
            for candidate in self.result.candidates
            if candidate.rejections and candidate.cost is not None and limit is not None and candidate.cost < limit
            and candidate.kind != "baseline"
        ]  # fmt: skip
        for trial in self.result.rejected:
            gains = ", ".join(f"{name} {value:g}" for name, value in trial.gains.items())
            rows.append((f"trial {gains}", _number(trial.cost), self.texts.rejections(trial.rejections)))
        return rows

    def robustness(self) -> RobustnessTable | None:
        """Return the table of the Monte Carlo; None if the study has none."""
        robustness = self.result.robustness
        if robustness is None:
            return None
        # Figures in the order of the page, and only those that the Monte Carlo has.
        has = {name for candidate in robustness.candidates.values() for name in candidate.figures}
        chosen = [name for name in FIGURES if name in has & {*_MONTE_CARLO_FIGURES, *self.result.cost}]
        rows = []
        for name, candidate in robustness.candidates.items():
            rate = candidate.failures
            quantiles = [candidate.figures.get(figure) for figure in chosen]
            cells = [
                ("–", "–", "–")
                if quantile is None
                else (_number(quantile.median), _number(quantile.p95), _number(quantile.worst))
                for quantile in quantiles
            ]
            interval = f"{100.0 * rate.low:.1f} to {100.0 * rate.high:.1f} %"
            failed = f"{rate.failures} of {rate.runs}"
            # The baseline is tested in the runs that candidates have failed, which are not a random sample.
            if name == self.result.baseline and rate.runs < robustness.runs:
                failed, interval = f"{failed} in which candidates failed", "–"
            if candidate.on_plant < rate.runs:
                failed += f", {candidate.on_plant} on the plant"
            rows.append(RobustnessRow(name, failed, interval, bool(rate.failures), self._corners(name), cells))
        ranges = [self._range(name, low, high) for name, (low, high) in robustness.ranges.items()]
        figures = [self.texts.figure(name) for name in chosen]
        return RobustnessTable(robustness.runs, "; ".join(ranges), figures, rows, self._grip())

    def _range(self, name: str, low: float, high: float) -> str:
        """Return the range of a condition, with its unit."""
        scale, unit = {
            "mass": (100.0, "\u00a0% of the nominal one"),
            "friction": (1.0, ""),
            "delay": (1e3, "\u00a0ms"),
            "grade": (math.degrees(1.0), "°"),
            "step": (100.0, "\u00a0% of that of the test"),
            "noise": (1.0, f"\u00a0{self.texts.y}"),
        }[name]
        ends = [f"{scale * end:.3g}".replace("-", "−") for end in (low, high)]
        # The range replaces the nominal delay, it is not added to it.
        label = "whole delay of the actuator" if name == "delay" else name
        return f"{label} {' to '.join(ends)}{unit}"

    def _corners(self, name: str) -> tuple[str, str] | None:
        """Return how many corners of the ranges failed, and which; None if they were not tested."""
        tests = self.result.robustness.corners.get(name) if self.result.robustness else None
        if not tests:
            return None
        failed = [f"{describe(test.conditions)}: {test.reason}" for test in tests if test.status != "ok"]
        return f"{len(failed)} of {len(tests)}", "; ".join(failed)

    def _grip(self) -> str:
        """Return a sentence on the grip that the runs require; empty if it is not known."""
        # Grip use shows the cause of a poor run: no controller gets more force out of a tyre than friction allows.
        table = self.result.table("monte_carlo")
        if table is None or "grip_use" not in table:
            return ""
        # The table has a row per run and figure; the grip use is the same in all rows of a run.
        use = table.drop_duplicates("run")["grip_use"]
        beyond = int((use > 1.0).sum())
        if beyond:
            return (
                f"{beyond} of {len(use)} runs require more longitudinal force than the driven tyres can provide at "
                "their grade and friction: the figures of these runs depend on the car, not on the gains."
            )
        return (
            f"All runs require at most {100.0 * use.max():.0f}\u00a0% of the available longitudinal force of the "
            "driven tyres: wheels that slip do so because of the controller."
        )

    def schedule(self) -> list[tuple[str, list[str]]]:
        """Return the gains of the schedule by speed."""
        rows = self.result.schedule.rows if self.result.schedule else ()
        gains = self.result.loop.gains
        return [(format_quantity(row.speed, "m/s"), [_number(row.gains.get(name)) for name in gains]) for row in rows]

    def schedule_tests(self) -> list[tuple[str, str, list[tuple[str, str, str]]]]:
        """Return by speed: whether it is in the schedule; name, cost and verdict of each test."""
        rows: dict[float, list[ScheduleTest]] = {}
        for test in self.result.schedule.tests if self.result.schedule else ():
            rows.setdefault(test.speed, []).append(test)
        return [
            (
                format_quantity(speed, "m/s"),
                tests[0].place,
                [(test.candidate, _number(test.cost), _verdict(test)) for test in tests],
            )
            for speed, tests in rows.items()
        ]


def _verdict(tested: CandidateResult | ScheduleTest) -> str:
    return tested.status if tested.status != "ok" else "feasible" if tested.feasible else "breaks a limit"


def labelled(label: str, unit: str) -> str:
    """Return a label with its unit in brackets."""
    return f"{label} [{unit or '1'}]"


def _number(value: float | None) -> str:
    return "–" if value is None or not math.isfinite(value) else format_quantity(float(value))


def _sortable(value: float | None) -> str:
    return repr(float(value)) if value is not None and math.isfinite(value) else "inf"
