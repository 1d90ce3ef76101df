"""Findings of a data check as figures; their sentences are made in :mod:`mirdrake.identification.finding_texts`."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import pandas as pd

from mirdrake.core.wording import plural
from mirdrake.identification.data import DataSet
from mirdrake.identification.finding_texts import EXCITATION, FINDINGS, REPAIRS, Figures, render

Severity = Literal["info", "warning", "fault"]
Verdict = Literal["good", "weak", "none"]
Check = Literal[
    "file", "timestamps", "first_rows", "gaps", "missing", "held_values", "glitches", "quantisation", "saturation",
    "range", "codes", "sample_time", "kinematics", "units", "gravity", "bias", "sensor_position", "delay",
    "delay_limit", "clock_drift", "response",
]  # fmt: skip


@dataclass(frozen=True)
class Statement:
    """Code of a sentence and the figures in it.

    Attributes:
        code: key of the sentence.
        figures: numbers and names by placeholder.
    """

    code: str
    figures: Figures


def statement(code: str, **figures: float | str) -> Statement:
    """Return a statement."""
    return Statement(code, figures)


@dataclass(frozen=True)
class Finding:
    """Observation about a log.

    Attributes:
        log: name of the log.
        check: kind of the check.
        channel: the channel, or several as ``a, b``; "" for the whole log.
        severity: "info", "warning" (affects a fit) or "fault" (makes a fit wrong unless it is repaired).
        value: main figure.
        unit: its unit.
        what: what was observed.
        done: repair that was made; None without one.
    """

    log: str
    check: Check
    channel: str
    severity: Severity
    value: float
    unit: str
    what: Statement
    done: Statement | None = None

    @property
    def text(self) -> str:
        """The observation as a sentence."""
        return render(FINDINGS, self.what.code, self.what.figures)

    @property
    def repair(self) -> str:
        """The repair as a sentence; "" without one."""
        return "" if self.done is None else render(REPAIRS, self.done.code, self.done.figures)

    @property
    def channels(self) -> list[str]:
        """Names of the channels."""
        return [name for name in self.channel.split(", ") if name]


@dataclass(frozen=True)
class Excitation:
    """Excitation of a group of parameters by a log.

    Attributes:
        log: name of the log.
        parameters: the group.
        verdict: "good", "weak" or "none".
        measures: figures by name, in SI units.
        what: the figures in words, with what is missing.
    """

    log: str
    parameters: str
    verdict: Verdict
    measures: Mapping[str, float]
    what: Statement

    @property
    def text(self) -> str:
        """The figures as a sentence, with what is missing."""
        return render(EXCITATION, self.what.code, self.what.figures)


@dataclass(frozen=True)
class DataReport:
    """Result of :func:`mirdrake.identification.check_data`.

    Attributes:
        findings: findings in the order of logs and checks.
        excitation: excitation by log and group of parameters.
        data: data set with the repairs.
    """

    findings: tuple[Finding, ...]
    excitation: tuple[Excitation, ...]
    data: DataSet = field(repr=False)

    def of(self, check: Check, channel: str | None = None) -> list[Finding]:
        """Return the findings of one check, and of one channel if it is given."""
        return [
            finding
            for finding in self.findings
            if finding.check == check and (channel is None or finding.channel == channel)
        ]

    @property
    def repairs(self) -> list[str]:
        """The repairs, one sentence each."""
        return [
            f"{finding.log}: {finding.channel or 'all channels'}: {finding.repair}"
            for finding in self.findings
            if finding.done
        ]

    @property
    def unrepaired_faults(self) -> list[Finding]:
        """Faults that were not repaired and make a fit wrong."""
        return [finding for finding in self.findings if finding.severity == "fault" and finding.done is None]

    @property
    def headline(self) -> str:
        """Whether the data can be used, and for which parameters no log has enough excitation."""
        if left := len(self.unrepaired_faults):
            return f"{plural(left, 'fault')} without repair"
        # Parameters are fitted to the training logs.
        train = {log.name for log in self.data.train}
        groups = dict.fromkeys(rating.parameters for rating in self.excitation)
        enough = {rating.parameters for rating in self.excitation if rating.verdict == "good" and rating.log in train}
        if not groups:
            return f"no fault is left; the excitation cannot be rated without {self._missing()}"
        if weak := [group for group in groups if group not in enough]:
            return f"no fault is left; excitation too weak for {'; '.join(weak)}"
        return f"no fault is left; enough excitation for {'; '.join(groups)}"

    def _missing(self) -> str:
        """Return what the training logs lack for a rating of the excitation."""
        known = {name.partition("@")[0] for log in self.data.train for name in log.channels}
        if not known & {"vx", "speed"}:
            return "a speed"
        return "a yaw rate or the pedals"

    def to_pandas(self) -> pd.DataFrame:
        """Return the findings, a row each."""
        columns = ["log", "check", "channel", "severity", "value", "unit", "text", "repair"]
        return pd.DataFrame(
            [[getattr(finding, name) for name in columns] for finding in self.findings], columns=columns
        )

    def table(self) -> str:
        """Return findings and excitation as text, a line each."""
        lines = []
        for log in self.data.logs:
            lines.append(f"{log.name} ({log.use}, {len(log.time)} samples, {log.time[-1] - log.time[0]:.4g} s)")
            # Excitation follows the findings, since a faulty channel explains a missing excitation.
            findings = [finding for finding in self.findings if finding.log == log.name]
            rows = [
                (
                    finding.severity,
                    finding.check,
                    finding.channel or "-",
                    finding.text + (f" -> {finding.repair}" if finding.done else ""),
                )
                for finding in findings
            ]
            offers = [rating for rating in self.excitation if rating.log == log.name]
            lines += _aligned(
                [*rows, *((rating.verdict, "excitation", rating.parameters, rating.text) for rating in offers)]
            )
            if not findings:
                lines.append("  no findings")
        return "\n".join(lines)


def _aligned(rows: Iterable[tuple[str, str, str, str]]) -> list[str]:
    """Return rows with their first three columns aligned."""
    rows = list(rows)
    widths = [max((len(row[column]) for row in rows), default=0) for column in range(3)]
    return [
        "  " + "  ".join([*(cell.ljust(width) for cell, width in zip(row[:3], widths, strict=True)), row[3]])
        for row in rows
    ]
