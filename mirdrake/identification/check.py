"""Data check before any fit: findings, repairs, and the excitation of each log."""

from collections.abc import Collection
from dataclasses import replace

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.identification.alignment import check_response
from mirdrake.identification.data import DataSet, Log
from mirdrake.identification.delays import check_delays
from mirdrake.identification.excitation import check_excitation
from mirdrake.identification.findings import DataReport, Finding, statement
from mirdrake.identification.plausibility import (
    check_gravity,
    check_gyro_bias,
    check_lateral_velocity,
    check_path_direction,
    check_relations,
    check_steering,
    check_step,
    check_velocity_position,
)
from mirdrake.identification.samples import check_glitches, check_values, unwrap_headings
from mirdrake.identification.spec import REPAIRS
from mirdrake.identification.timing import (
    channels_with_common_holds,
    check_first_rows,
    check_held,
    check_stamps,
    split_at_gaps,
)


def check_data(data: DataSet, *, repairs: Collection[str] | None = None) -> DataReport:
    """Check a data set and return the findings with a repaired copy of it.

    Each check sees the result of the repairs before it. Units and signs are never repaired: correct the mapping.

    Args:
        data: recorded logs; they are not changed.
        repairs: allowed repairs of :data:`~mirdrake.identification.spec.REPAIRS`; None for those of the data file.

    Raises:
        ConfigError: unknown repair.
    """
    allowed = data.repairs if repairs is None else repairs
    for name in allowed:
        if name not in REPAIRS:
            raise ConfigError(f"unknown repair '{name}'; {did_you_mean(name, REPAIRS)}", path=("repairs",))
    findings: list[Finding] = []
    logs: list[Log] = []
    sources: list[set[str]] = []
    for log in data.logs:
        parts, new_findings = _first_checks(log, allowed)
        findings += new_findings
        # From here on, a log is a stretch without long gaps.
        for part in parts:
            repaired, own, new_findings = _check_log(part, allowed)
            findings += new_findings
            sources += [source for source in own if source not in sources]
            logs.append(repaired)
    # With a wrong sign or unit the relations between the channels do not hold, and delays have no meaning.
    wrong = [*findings, *(finding for log in logs for finding in check_relations(log))]
    if not any(finding.check == "units" for finding in wrong):
        logs, new_findings = check_delays(logs, sources, repair="delays" in allowed, clock=data.clock)
        findings += new_findings
    for log in logs:
        findings += (
            check_relations(log)
            + check_steering(log, data.wheelbase)
            + check_path_direction(log)
            + check_velocity_position(log)
        )
        findings += check_gravity(log) + check_gyro_bias(log) + check_response(log)
    # Last, as figures of excitation need the repaired channels.
    offers = [offer for log in logs for offer in check_excitation(log)]
    return DataReport(tuple(findings), tuple(offers), replace(data, logs=tuple(logs)))


def _first_checks(log: Log, allowed: Collection[str]) -> tuple[list[Log], list[Finding]]:
    """Check a whole log: time stamps, first rows, and long gaps, at which it is cut."""
    findings = [Finding(log.name, "file", "", "info", 0.0, "", statement("note", text=note)) for note in log.notes]
    log, new_findings = check_stamps(log, repair="timestamps" in allowed)
    findings += new_findings
    logs, new_findings = split_at_gaps(log, repair="gaps" in allowed)
    findings += new_findings
    parts = []
    for part in logs:
        part, new_findings = check_first_rows(part, repair="timestamps" in allowed)
        findings += new_findings
        parts.append(part)
    return parts, findings


def _check_log(log: Log, allowed: Collection[str]) -> tuple[Log, list[set[str]], list[Finding]]:
    """Check a log by itself; return the repaired log, groups of channels from one source, and findings."""
    log, findings = unwrap_headings(log)
    # Glitches first: after interpolation, a glitch of a held channel would be as wide as its neighbours.
    log, new_findings = check_glitches(log, repair="glitches" in allowed)
    findings += new_findings + check_values(log)
    sources = channels_with_common_holds(log)
    # Then the clock, as comparisons between channels count samples.
    for name, check in (("held_values", check_held), ("sample_time", check_step)):
        log, new_findings = check(log, repair=name in allowed)
        findings += new_findings
    return log, sources, findings + check_lateral_velocity(log)
