"""What a data check found, as data and as a table of text."""

from dataclasses import dataclass, field
from typing import Literal

import pandas as pd

from mirdrake.identification.data import DataSet

Severity = Literal["info", "warning", "fault"]
Verdict = Literal["good", "weak", "none"]


@dataclass(frozen=True)
class Finding:
    """One thing that was seen in a log.

    Attributes:
        log: its name.
        check: what kind: stamps, first rows, gaps, missing, held, glitches, quantisation, saturation, range, codes,
            relation, step, units, gravity, bias, place, delay, drift, response, file.
        channel: the channel, or two of a pair as ``a, b``; "" for the whole log.
        severity: "info" is worth knowing, "warning" touches a fit, "fault" spoils it unless it is repaired.
        value: the number of it.
        unit: of the number.
        text: in words.
        repair: what was done about it; "" when nothing was.
    """

    log: str
    check: str
    channel: str
    severity: Severity
    value: float
    unit: str
    text: str
    repair: str = ""


@dataclass(frozen=True)
class Excitation:
    """What a drive offers for a group of parameters.

    Attributes:
        log: its name.
        parameters: which can be found from this.
        verdict: "good", "weak" or "none".
        measures: figures by name, in SI units.
        text: in words, with what is missing.
    """

    log: str
    parameters: str
    verdict: Verdict
    measures: dict[str, float]
    text: str


@dataclass(frozen=True)
class DataReport:
    """Result of :func:`mirdrake.identification.check_data`.

    Attributes:
        findings: in the order of the logs and of the checks.
        excitation: by log and group of parameters.
        data: the data set with the repairs made; the data given are as they were.
    """

    findings: tuple[Finding, ...]
    excitation: tuple[Excitation, ...]
    data: DataSet = field(repr=False)

    def of(self, check: str, channel: str | None = None) -> list[Finding]:
        """Findings of one kind, and of one channel if it is given."""
        return [
            found for found in self.findings if found.check == check and (channel is None or found.channel == channel)
        ]

    @property
    def repairs(self) -> list[str]:
        """What was changed, one sentence each."""
        return [
            f"{found.log}: {found.channel or 'all channels'}: {found.repair}" for found in self.findings if found.repair
        ]

    @property
    def unrepaired_faults(self) -> list[Finding]:
        """Faults that were not repaired: they would spoil a fit."""
        return [found for found in self.findings if found.severity == "fault" and not found.repair]

    def to_pandas(self) -> pd.DataFrame:
        """The findings, a row each."""
        return pd.DataFrame([vars(found) for found in self.findings], columns=list(Finding.__dataclass_fields__))

    def table(self) -> str:
        """Findings and excitation as text, a line each."""
        lines = []
        for log in self.data.logs:
            lines.append(f"{log.name} ({log.use}, {len(log.time)} samples, {log.time[-1] - log.time[0]:.4g} s)")
            found = [item for item in self.findings if item.log == log.name]
            rows: list[tuple[str, str, str, str]] = [
                (item.severity, item.check, item.channel or "-", item.text + _repaired(item)) for item in found
            ]
            offers = [item for item in self.excitation if item.log == log.name]
            rows += [(item.verdict, "excitation", item.parameters, item.text) for item in offers]
            widths = [max((len(row[column]) for row in rows), default=0) for column in range(3)]
            lines += [
                "  " + "  ".join([*(cell.ljust(width) for cell, width in zip(row[:3], widths, strict=True)), row[3]])
                for row in rows
            ]
            if not found:
                lines.append("  nothing odd was found")
        return "\n".join(lines)


def _repaired(found: Finding) -> str:
    return f" -> {found.repair}" if found.repair else ""
