"""The data check before any fit: what is odd in a data set, what was done about it, and what can be found from it."""

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from mirdrake.errors import ConfigError, did_you_mean
from mirdrake.identification.alignment import check_delays, check_response
from mirdrake.identification.channels import channel
from mirdrake.identification.data import DataSet, Log
from mirdrake.identification.excitation import check_excitation
from mirdrake.identification.findings import DataReport, Finding
from mirdrake.identification.plausibility import (
    check_course,
    check_gravity,
    check_place,
    check_relations,
    check_rest,
    check_steering,
    check_step,
)
from mirdrake.identification.samples import check_glitches, check_turns, check_values, find_glitches
from mirdrake.identification.spec import REPAIRS
from mirdrake.identification.timing import check_first_rows, check_held, check_stamps, held_together, split_at_gaps


def check_data(data: DataSet, *, repairs: Collection[str] | None = None) -> DataReport:
    """What is odd in a data set, with a repaired copy of it.

    Each check sees what the repairs before it left. Units and signs are never repaired: that is the mapping's part.

    Args:
        data: the recorded drives; they stay as they are.
        repairs: which may be made, of :data:`~mirdrake.identification.spec.REPAIRS`; None: those of the data file.

    Raises:
        ConfigError: a repair is not known.
    """
    allowed = data.repairs if repairs is None else repairs
    for name in allowed:
        if name not in REPAIRS:
            raise ConfigError(f"repairs: unknown repair '{name}'; {did_you_mean(name, REPAIRS)}")
    findings, offers, logs = [], [], []
    for log in data.logs:
        parts, found = _first_checks(log, allowed)
        findings += found
        for part in parts:
            mended, found = _check_log(part, allowed, data.wheelbase)
            findings += found
            offers += check_excitation(mended)
            logs.append(mended)
    return DataReport(tuple(findings), tuple(offers), replace(data, logs=tuple(logs)))


def _first_checks(log: Log, allowed: Collection[str]) -> tuple[list[Log], list[Finding]]:
    """What is done to a whole log: its stamps, what comes before it really begins, and long gaps, which cut it."""
    found = [Finding(log.name, "file", "", "info", 0.0, "", note) for note in log.notes]
    log, seen = check_stamps(log, repair="stamps" in allowed)
    found += seen
    logs, seen = split_at_gaps(log, repair="gaps" in allowed)
    found += seen
    parts = []
    for part in logs:
        part, seen = check_first_rows(part, repair="stamps" in allowed)
        found += seen
        parts.append(part)
    return parts, found


def _check_log(log: Log, allowed: Collection[str], wheelbase: float | None) -> tuple[Log, list[Finding]]:
    log, found = check_turns(log)
    found += check_values(_without_glitches(log) if "glitches" in allowed else log)
    # The clock first: everything else counts samples. Then single values, then what is compared between channels.
    sources = held_together(log)
    for name, check in (("held", check_held), ("glitches", check_glitches), ("step", check_step)):
        log, seen = check(log, repair=name in allowed)
        found += seen
    log, seen = check_delays(log, sources, repair="delays" in allowed)
    found += seen
    found += check_relations(log) + check_steering(log, wheelbase) + check_course(log) + check_place(log)
    found += check_gravity(log) + check_rest(log) + check_response(log)
    return log, found


def _without_glitches(log: Log) -> Log:
    """A log in which glitches are missing values: what will be mended is no fault of the range."""
    channels = dict(log.channels)
    for name, values in log.channels.items():
        if channel(name).moves and (bad := find_glitches(values, channel(name).limit)).any():
            channels[name] = np.where(bad, np.nan, values)
    return replace(log, channels=channels)
