"""Clock of a log: time stamps, gaps, missing values, and channels that hold their values over several rows."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from mirdrake.identification.channels import channel
from mirdrake.identification.data import Array, Log
from mirdrake.identification.findings import Finding, Severity, statement

GAP = 1.7
"""Steps longer than this many median steps are gaps."""

MIN_PART = 20
"""Least number of samples of a stretch."""

MIN_STEP, MAX_STEP = 1e-5, 1.0
"""Usual range of a recorder's step [s]."""

MAX_HOLD = 60
"""Rows over which a value may be held and still indicate a rate."""

NOT_HELD = 0.95
"""Share of changing rows above which a channel is not held."""

MIN_CHANGES, ON_GRID = 60, 0.95
"""Number of changes of a channel, and the share of them on every n-th row, that indicate a lower rate."""


def median_step(time: Array) -> float:
    """Return the median of the steps that are not zero [s]."""
    steps = np.diff(time)
    return float(np.median(steps[steps > 0.0]))


def check_stamps(log: Log, *, repair: bool) -> tuple[Log, list[Finding]]:
    """Check time stamps that go back, repeat or are coarse, gaps and missing values."""
    log, findings = _check_resolution(log, repair=repair)
    # Reversed rows lie before an earlier one; repeated rows hardly advance.
    latest = np.maximum.accumulate(log.time)
    back = np.append(False, log.time[1:] < latest[:-1])
    steps = np.diff(latest)
    step = float(np.median(steps[steps > 0.0]))
    again = np.append(False, steps < 0.05 * step) & ~back
    bad = back | again
    if bad.any():
        done = statement("rows_removed", rows=int(bad.sum())) if repair else None
        if back.any():
            text = statement("reversed_time", rows=int(back.sum()), time=float(latest[np.argmax(back)]))
            findings.append(Finding(log.name, "timestamps", "", "fault", float(back.sum()), "rows", text, done))
        if again.any():
            text = statement("repeated_time", rows=int(again.sum()), time=float(log.time[np.argmax(again)]))
            findings.append(Finding(log.name, "timestamps", "", "warning", float(again.sum()), "rows", text, done))
        if repair:
            log = replace(log, time=log.time[~bad], channels={name: v[~bad] for name, v in log.channels.items()})
    steps = np.diff(log.time)
    jitter = float(np.percentile(np.abs(steps - step), 90)) / step
    # The lower bound keeps the sentence from printing rounding errors of the time stamps.
    text = statement("step", step=step, rate=1.0 / step, jitter=max(100 * jitter, 1e-3))
    findings.append(Finding(log.name, "timestamps", "", "warning" if jitter > 0.2 else "info", step, "s", text))
    return log, findings + _check_gaps(log, step, jitter) + _check_missing(log, step)


def _check_gaps(log: Log, step: float, jitter: float) -> list[Finding]:
    """Find gaps; jitter of the time stamps makes long steps beside short ones, which are not gaps."""
    steps = np.diff(log.time)
    gaps = np.flatnonzero(steps > max(GAP, 1.0 + 3.0 * jitter) * step)
    if not len(gaps):
        return []
    lost = int(np.sum(np.round(steps[gaps] / step) - 1))
    longest = gaps[np.argmax(steps[gaps])]
    time = float(log.time[longest])
    text = statement("gaps", gaps=len(gaps), lost=lost, longest=float(steps[longest]), time=time)
    severity: Severity = "fault" if steps[longest] > 20 * step else "warning"
    return [Finding(log.name, "gaps", "", severity, float(len(gaps)), "gaps", text)]


def _check_missing(log: Log, step: float) -> list[Finding]:
    """Find missing values; a channel with values at even distances has a rate of its own."""
    findings: list[Finding] = []
    for name, values in log.channels.items():
        missing = int(np.isnan(values).sum())
        # Values at even distances are complete samples of a slower channel.
        every = sparse_factor(values) if missing else None
        if every is not None:
            text = statement("sparse", every=every, rate=1.0 / (every * step))
            findings.append(Finding(log.name, "missing", name, "info", float(missing), "rows", text))
        elif missing:
            part = missing / len(values)
            text = statement("missing", missing=missing, rows=len(values), percent=100 * part)
            findings.append(
                Finding(log.name, "missing", name, "fault" if part > 0.2 else "warning", float(missing), "rows", text)
            )
    return findings


def _check_resolution(log: Log, *, repair: bool) -> tuple[Log, list[Finding]]:
    """Check for a clock that is coarser than the rows: several consecutive rows share each time stamp."""
    steps = np.diff(log.time)
    starts = np.append(0, np.flatnonzero(steps != 0.0) + 1)
    rows, ticks = np.diff(starts), np.diff(log.time[starts])
    if len(rows) < MIN_PART or np.any(steps < 0.0):
        return log, []
    # The first stretch may have begun before the log, and the last one may continue after it.
    usual, tick = float(np.median(rows[1:])), float(np.median(ticks))
    even = np.mean(np.abs(rows[1:] * tick / ticks[1:] - usual) <= max(1.0, 0.1 * usual))
    if rows[1:].mean() < 1.5 or even < 0.9 or np.mean(np.abs(ticks / tick - np.round(ticks / tick)) < 0.01) < 0.9:
        return log, []
    # The ends of the log are incomplete stretches, so they do not count.
    step = float(np.sum(ticks[1:]) / np.sum(rows[1:]))
    text = statement("coarse_clock", tick=tick, rows=usual, step=step)
    done = statement("rows_spread") if repair else None
    findings = [Finding(log.name, "timestamps", "", "fault", step, "s", text, done)]
    if repair:
        # Time stamps belong to the first row of each stretch; rows between are spread evenly, the ends by the mean
        # step.
        numbers = np.arange(float(len(log.time)))
        time = np.interp(numbers, starts[1:], log.time[starts[1:]])
        time[: starts[1]] = log.time[starts[1]] + (numbers[: starts[1]] - starts[1]) * step
        time[starts[-1] :] = log.time[starts[-1]] + (numbers[starts[-1] :] - starts[-1]) * step
        log = replace(log, time=time)
    return log, findings


def sparse_factor(values: Array) -> int | None:
    """Return the number of rows per value of a slow channel with empty rows; None for other channels."""
    rows = np.flatnonzero(np.isfinite(values))
    if len(rows) < MIN_PART:
        return None
    apart = np.diff(rows)
    usual = int(np.median(apart))
    return usual if usual >= 2 and np.mean(np.abs(apart - usual) <= 1) > 0.9 else None


def check_first_rows(log: Log, *, repair: bool) -> tuple[Log, list[Finding]]:
    """Check for first rows in which channels hold a value far from where they jump to."""
    # Only the beginning is searched: defaults before the first message, not jumps during the drive.
    max_rows = min(max(5, len(log.time) // 100), 500)
    # More rows are possible where no channel at all changes.
    still = min(int(np.argmax(values != values[0])) or len(values) for values in log.channels.values())
    max_rows = max(max_rows, min(still, len(log.time) // 10))
    dummy, text = 0, None
    for name, values in log.channels.items():
        # Forces, and what follows from them within a sample, may jump from rest.
        if not channel(name).moves or channel(name).jumps or not np.isfinite(values).all():
            continue
        steps, rest = np.abs(np.diff(values)), values[max_rows:]
        if len(rest) < MIN_PART:
            continue
        # A default value is constant, lies outside of the later range, and ends by a jump that dwarfs the later steps,
        # also those directly behind it: a launch from rest continues.
        low, high = np.percentile(rest, (1, 99))
        jumps = np.flatnonzero(
            steps[:max_rows] > max(20.0 * float(np.percentile(steps[max_rows:], 98)), 0.5 * (high - low))
        )
        ends = [
            int(row) + 1
            for row in jumps
            if np.ptp(values[: row + 1]) == 0.0
            and not low <= values[row] <= high
            and steps[row] > 20.0 * float(np.median(steps[row + 1 : row + 1 + MIN_PART]))
        ]
        if ends and ends[0] > dummy:
            dummy = ends[0]
            first, then, unit = float(values[0]), float(values[dummy]), channel(name).unit
            text = statement("first_rows", rows=dummy, channel=name, first=first, then=then, unit=unit)
    if text is None:
        return log, []
    done = statement("rows_removed", rows=dummy) if repair else None
    finding = Finding(log.name, "first_rows", "", "warning", float(dummy), "rows", text, done)
    if repair:
        log = replace(log, time=log.time[dummy:], channels={key: v[dummy:] for key, v in log.channels.items()})
    return log, [finding]


def split_at_gaps(log: Log, *, repair: bool) -> tuple[list[Log], list[Finding]]:
    """Cut a log at long gaps; parts of a few samples are removed."""
    # Short gaps are interpolated; 50 steps or a second of driving cannot be.
    step = median_step(log.time)
    longest = max(1.0, 50.0 * step)
    cuts = np.flatnonzero(np.diff(log.time) > longest) + 1
    if not len(cuts):
        return [log], []
    # Short stretches carry little information; the longest one is always kept.
    bounds = list(zip(np.append(0, cuts), np.append(cuts, len(log.time)), strict=True))
    min_rows = min(max(MIN_PART, len(log.time) // 50), max(end - start for start, end in bounds))
    parts = [(start, end) for start, end in bounds if end - start >= min_rows]
    lost = len(log.time) - sum(end - start for start, end in parts)
    text = statement("long_gaps", gaps=len(cuts), limit=longest, stretches=len(bounds))
    done = statement("cut", parts=len(parts), lost=lost) if repair else None
    findings = [Finding(log.name, "gaps", "", "fault", float(len(bounds)), "stretches", text, done)]
    if not repair:
        return [log], findings
    logs = [
        replace(
            log,
            name=f"{log.name}, part {number}" if len(parts) > 1 else log.name,
            time=log.time[start:end],
            channels={name: values[start:end] for name, values in log.channels.items()},
            notes=(),
        )
        for number, (start, end) in enumerate(parts, start=1)
    ]
    return logs, findings


def check_held(log: Log, *, repair: bool) -> tuple[Log, list[Finding]]:
    """Check for channels that change only every few rows while they move.

    A log in which all moving channels are held over the same rows was copied at a higher rate; its repair keeps one row
    of each. The repair of a single held channel interpolates linearly between new values.
    """
    factors = {name: hold_factor(values) for name, values in log.channels.items() if channel(name).moves}
    seen = {name: factor for name, factor in factors.items() if factor is not None}
    step = median_step(log.time)
    fresh = {name: changed_rows(log.channels[name]) for name in seen}
    keep = _copied_rows(fresh, seen)
    if keep is not None:
        # Long holds are standstill and would distort the mean.
        holds = np.diff(keep)
        holds = holds[holds <= MAX_HOLD]
        count = float(np.median(holds)) if np.ptp(holds) == 0 else float(holds.mean())
        shortest, longest = int(holds.min()), int(holds.max())
        text = statement("copied", least=shortest, most=longest, factor=count, step=count * step)
        done = statement("rows_kept", rows=len(log.time), kept=len(keep)) if repair else None
        findings = [Finding(log.name, "held_values", "", "fault", count, "rows", text, done)]
        if repair:
            channels = {name: values[keep] for name, values in log.channels.items()}
            log = replace(log, time=log.time[keep], channels=channels)
            # At the original rate, single channels may still be slower.
            log, more = _check_slow(log, repair=repair)
            findings += more
        return log, findings
    return _check_slow(log, repair=repair)


def _check_slow(log: Log, *, repair: bool) -> tuple[Log, list[Finding]]:
    """Check for single channels with a lower rate than the rows."""
    factors = {name: hold_factor(values) for name, values in log.channels.items() if channel(name).moves}
    seen = {name: factor for name, factor in factors.items() if factor is not None}
    step = median_step(log.time)
    # The rate of a channel is found by the rows at which it changes.
    fresh = {name: changed_rows(log.channels[name]) for name in seen}
    findings: list[Finding] = []
    repaired: dict[str, Array] = {}
    for name, (factor, part) in seen.items():
        # Values of coarse resolution repeat by chance; they have the rate of the rows.
        if factor < 1.15:
            if part > 0.1:
                text = statement("repeated_by_chance", percent=100 * part)
                findings.append(Finding(log.name, "held_values", name, "info", 1.0, "rows", text))
            continue
        rate = 1.0 / (factor * step)
        exact = factor == int(factor)
        text = statement("held", factor=factor, exact=exact, rate=rate, percent=100 * part)
        done = statement("interpolated_holds") if repair else None
        findings.append(Finding(log.name, "held_values", name, "warning", float(factor), "rows", text, done))
        if repair:
            values = log.channels[name].copy()
            rows = np.flatnonzero(fresh[name])
            if exact:  # coarse values repeat by chance, too: every row of the channel's own rate is new
                rows = np.arange(_phase(rows[1:], int(factor)), len(values), int(factor))
            inner = np.isfinite(values)
            between = np.interp(np.arange(len(values)), rows, values[rows])
            # Where the channel is really at rest, interpolation would start too early: only short holds are joined.
            hold = np.diff(np.append(rows, len(values)))
            short = np.repeat(hold <= 2 * np.ceil(factor), hold)
            values[rows[0] :][short & inner[rows[0] :]] = between[rows[0] :][short & inner[rows[0] :]]
            repaired[name] = values
    return replace(log, channels={**log.channels, **repaired}), findings


def channels_with_common_holds(log: Log) -> list[set[str]]:
    """Return groups of channels that change on the same rows: they come from one source with one clock."""
    fresh = {}
    for name, values in log.channels.items():
        hold = hold_factor(values) if channel(name).moves else None
        if hold is not None and hold[0] >= 1.3:
            fresh[name] = changed_rows(values)
    groups: list[set[str]] = []
    for name, rows in fresh.items():
        for group in groups:
            other = fresh[next(iter(group))]
            # Both directions: a channel at every row contains the changes of all others.
            if np.mean(other[rows]) > 0.9 and np.mean(rows[other]) > 0.8:
                group.add(name)
                break
        else:
            groups.append({name})
    return [group for group in groups if len(group) > 1]


def _copied_rows(fresh: dict[str, NDArray[np.bool_]], seen: dict[str, tuple[float, float]]) -> NDArray[np.int64] | None:
    """Return the rows to keep of a log whose moving channels all change on the same rows; None for others."""
    if len(seen) < 2 or min(factor for factor, _ in seen.values()) < 1.3:
        return None
    counts = {name: int(rows.sum()) for name, rows in fresh.items()}
    # The channel with the most changes defines the rows of the original log.
    lead = fresh[max(counts, key=lambda name: counts[name])]
    alike = [name for name, rows in fresh.items() if np.mean(lead[rows]) > 0.95]
    if len(alike) < len(fresh):
        return None
    whole = {factor for factor, _ in seen.values()}
    if len(whole) == 1 and (factor := whole.pop()) == int(factor):
        return np.arange(_phase(np.flatnonzero(lead)[1:], int(factor)), len(lead), int(factor))
    # Held over varying numbers of rows. Where nothing changes the vehicle is at rest: rows at the usual distance.
    rows = np.flatnonzero(np.logical_or.reduce(list(fresh.values())))
    if len(rows) > 0.75 * len(lead):
        return None
    usual = max(round(float(np.median(np.diff(rows)))), 1)
    ends = np.append(rows[1:], len(lead))
    return np.concatenate(
        [np.arange(a, b, usual) if b - a > 2 * usual else [a] for a, b in zip(rows, ends, strict=True)]
    ).astype(np.int64)


def resolution(values: Array) -> float | None:
    """Return the step that all values are multiples of, if there are far fewer levels than values."""
    levels, counts = np.unique(values[np.isfinite(values)], return_counts=True)
    if not 2 <= len(levels) <= max(2000, len(values) // 4):
        return None
    # Levels of few values, such as interpolated ones, hide the steps of the others if each step counts once.
    steps = np.repeat(np.diff(levels), np.minimum(counts[1:], counts[:-1]))
    # Rounding in the file splits levels by tiny differences, which are not quanta.
    steps = steps[steps > 1e-6 * (levels[-1] - levels[0])]
    quantum = float(np.percentile(steps, 5))
    counts = steps / quantum
    even = np.abs(counts - np.round(counts)) < 0.1
    return float(np.median(steps[even] / np.round(counts[even]))) if even.mean() > 0.9 else None


def changed_rows(values: Array) -> NDArray[np.bool_]:
    """Return which rows have another value than the row before (n); the first one counts."""
    return np.append(True, (np.diff(values) != 0.0) & np.isfinite(values[1:]))


def hold_factor(values: Array) -> tuple[float, float] | None:
    """Return the rows over which a moving channel holds its values, and the share of repeated rows.

    A whole factor is returned when the changes keep to a grid of rows. None if it moves too little.
    """
    if sparse_factor(values) is not None:  # the rows between are empty, not held
        return None
    fresh = changed_rows(values)
    changes = np.flatnonzero(fresh)[1:]
    if len(changes) < 20:
        return None
    if len(changes) > NOT_HELD * len(values):
        return 1.0, 0.0
    # However coarse the values are: changes that all fall on every n-th row are those of a slower source.
    if len(changes) >= MIN_CHANGES:
        for factor in range(min(MAX_HOLD, int(1.1 * len(values) / len(changes))), 1, -1):
            if np.mean(changes % factor == _phase(changes, factor)) > ON_GRID:
                return float(factor), 1.0 - 1.0 / factor
    # Slow quantised values repeat by themselves: only changes of several quanta count.
    quantum = resolution(values) or 0.0
    window = 2 * MAX_HOLD
    steps = np.abs(np.diff(np.nan_to_num(values)))
    level = uniform_filter1d(steps, window, mode="constant")
    # Mean size of the changes where there are any: only motion of several quanta for each change shows a hold.
    often = uniform_filter1d(fresh[1:].astype(float), window, mode="constant")
    large = level > 4.0 * quantum * np.maximum(often, 1.0 / window)
    moving = large & (level > 1e-3 * float(np.percentile(level, 99.0)))
    if moving.any():  # held values repeat at fast motion, too; coarse values do not
        fast = moving & (level >= np.median(level[moving]))
        moving = fast if fast.sum() >= 10 * window else moving
    moving = np.append(False, moving)
    here = changes[moving[changes]]
    if len(here) < 20 or moving.sum() < 60:
        return None
    holds, rested = np.diff(here), np.add.accumulate(~moving)
    inside = (holds <= MAX_HOLD) & (rested[here[1:]] == rested[here[:-1]])
    holds = holds[inside]
    if len(holds) < 15:
        return None
    usual = int(np.median(holds))
    # The largest factor first: changes on every sixth row are also on every third and second one.
    for factor in range(min(usual, MAX_HOLD), 1, -1):
        on_grid = np.bincount(here % factor).max() / len(here)
        if on_grid > 0.93 and np.mean(holds <= factor) > 0.5:
            return float(factor), 1.0 - 1.0 / factor
    mean = float(holds.mean()) / (1.0 + _chance(steps[here - 1]))
    # A slower source holds for two neighbouring numbers of rows; repetition by chance has a geometric distribution.
    by_chance = bool(quantum) and holds.var() > 0.5 * holds.mean() * (holds.mean() - 1.0)
    if mean < 1.15 or by_chance:
        return 1.0, 1.0 - 1.0 / float(holds.mean())
    near = round(mean)
    if near > 1 and abs(mean - near) < 0.03 * near:
        mean = float(near)
    # A whole number is reserved for changes that keep to a grid of rows; this one is only a mean.
    return mean if mean != int(mean) else mean + 1e-9, 1.0 - 1.0 / mean


def _phase(rows: NDArray[np.intp], factor: int) -> int:
    """Return on which of every n rows most of these rows are."""
    return int(np.bincount(rows % factor, minlength=factor).argmax())


def _chance(changes: Array) -> float:
    """Return how often coarse values repeat by chance, per change, extrapolated from changes by one and by two steps.

    Args:
        changes: sizes of the changes (n), not zero.
    """
    resolution = float(np.percentile(changes, 1.0))
    counts = changes[changes < 8.0 * resolution] / resolution
    if np.mean(np.abs(counts - np.round(counts)) < 0.1) < 0.95:
        return 0.0  # not quantised
    ones, twos = (float(np.mean(np.round(counts) == number)) for number in (1, 2))
    peak = min(max(ones / max(twos, 1e-3), 1.0), 10.0) ** (1.0 / 3.0)  # of a normal distribution
    return float(0.5 * ones * len(counts) / len(changes) * peak)
