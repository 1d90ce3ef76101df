"""The clock of a log: stamps, gaps, missing values, and channels that hold their values over several rows."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from mirdrake.identification.channels import channel
from mirdrake.identification.data import Array, Log
from mirdrake.identification.findings import Finding, Severity

GAP = 1.7
"""A step longer than so many usual ones is a gap."""

LEAST_PART = 20
"""A stretch of fewer samples is no drive."""

SHORTEST_STEP, LONGEST_STEP = 1e-5, 1.0
"""No recorder of a drive has a shorter or a longer step [s]."""

LONGEST_HOLD = 60
"""Rows over which a value may be held and still be a rate."""

NOT_HELD = 0.95
"""A channel that changes in more of the rows than this is not held."""

LEAST_CHANGES, ON_GRID = 60, 0.95
"""Changes of a channel of which so many come on every so many rows are no chance."""


def median_step(time: Array) -> float:
    """The median of the steps that are not zero [s]."""
    steps = np.diff(time)
    return float(np.median(steps[steps > 0.0]))


def check_stamps(log: Log, *, repair: bool) -> tuple[Log, list[Finding]]:
    """Stamps that go back, repeat or are bunched, gaps and missing values."""
    log, found = _check_resolution(log, repair=repair)
    latest = np.maximum.accumulate(log.time)
    back = np.append(False, log.time[1:] < latest[:-1])
    steps = np.diff(latest)
    step = float(np.median(steps[steps > 0.0]))
    again = np.append(False, steps < 0.05 * step) & ~back
    bad = back | again
    if bad.any():
        done = f"{int(bad.sum())} rows left out" if repair else ""
        if back.any():
            text = f"time goes back in {int(back.sum())} rows, first after {latest[np.argmax(back)]:.6g} s"
            found.append(Finding(log.name, "stamps", "", "fault", float(back.sum()), "rows", text, done))
        if again.any():
            first = log.time[np.argmax(again)]
            text = f"{int(again.sum())} rows have the time of the row before (to 5 % of a step), first at {first:.6g} s"
            found.append(Finding(log.name, "stamps", "", "warning", float(again.sum()), "rows", text, done))
        if repair:
            log = replace(log, time=log.time[~bad], channels={name: v[~bad] for name, v in log.channels.items()})
    steps = np.diff(log.time)
    jitter = float(np.percentile(np.abs(steps - step), 90)) / step
    text = f"usual step {step:.6g} s ({1.0 / step:.5g} Hz); nine of ten within {max(100 * jitter, 1e-3):.2g} % of it"
    found.append(Finding(log.name, "stamps", "", "warning" if jitter > 0.2 else "info", step, "s", text))
    # Stamps that swing about even ones leave steps that are long, with short ones beside them.
    gaps = np.flatnonzero(steps > max(GAP, 1.0 + 3.0 * jitter) * step)
    if len(gaps):
        lost = int(np.sum(np.round(steps[gaps] / step) - 1))
        longest = gaps[np.argmax(steps[gaps])]
        text = (
            f"{len(gaps)} gaps, about {lost} samples are missing; the longest is {steps[longest]:.4g} s after "
            f"{log.time[longest]:.6g} s"
        )
        severity: Severity = "fault" if steps[longest] > 20 * step else "warning"
        found.append(Finding(log.name, "gaps", "", severity, float(len(gaps)), "gaps", text))
    for name, values in log.channels.items():
        missing = int(np.isnan(values).sum())
        every = sparse_factor(values) if missing else None
        if every is not None:
            text = f"has a value in every {_ordinal(every)} row: its own rate is about {1.0 / (every * step):.4g} Hz"
            found.append(Finding(log.name, "missing", name, "info", float(missing), "rows", text))
        elif missing:
            part = missing / len(values)
            text = f"{missing} of {len(values)} values are missing ({100 * part:.3g} %)"
            found.append(
                Finding(log.name, "missing", name, "fault" if part > 0.2 else "warning", float(missing), "rows", text)
            )
    return log, found


def _check_resolution(log: Log, *, repair: bool) -> tuple[Log, list[Finding]]:
    """A clock that is coarser than the rows: several rows in turn share a stamp, again and again."""
    steps = np.diff(log.time)
    starts = np.append(0, np.flatnonzero(steps != 0.0) + 1)
    rows, ticks = np.diff(starts), np.diff(log.time[starts])
    if len(rows) < LEAST_PART or np.any(steps < 0.0):
        return log, []
    # The first stretch may have begun before the log did, the last one goes on after it.
    usual, tick = float(np.median(rows[1:])), float(np.median(ticks))
    even = np.mean(np.abs(rows[1:] * tick / ticks[1:] - usual) <= max(1.0, 0.1 * usual))
    if rows[1:].mean() < 1.5 or even < 0.9 or np.mean(np.abs(ticks / tick - np.round(ticks / tick)) < 0.01) < 0.9:
        return log, []
    step = float(np.sum(ticks[1:]) / np.sum(rows[1:]))
    text = f"the stamps have steps of {tick:.4g} s, and {usual:g} rows share each: the true step is {step:.5g} s"
    done = "rows spread evenly between the stamps" if repair else ""
    found = [Finding(log.name, "stamps", "", "fault", step, "s", text, done)]
    if repair:
        at = np.arange(float(len(log.time)))
        time = np.interp(at, starts[1:], log.time[starts[1:]])
        time[: starts[1]] = log.time[starts[1]] + (at[: starts[1]] - starts[1]) * step
        time[starts[-1] :] = log.time[starts[-1]] + (at[starts[-1] :] - starts[-1]) * step
        log = replace(log, time=time)
    return log, found


def _ordinal(number: int) -> str:
    return {2: "second", 3: "third"}.get(number, f"{number}th")


def sparse_factor(values: Array) -> int | None:
    """Rows from one value of a slow channel to the next, when the rows between are empty; None: it is no such one."""
    rows = np.flatnonzero(np.isfinite(values))
    if len(rows) < LEAST_PART:
        return None
    apart = np.diff(rows)
    usual = int(np.median(apart))
    return usual if usual >= 2 and np.mean(np.abs(apart - usual) <= 1) > 0.9 else None


def check_first_rows(log: Log, *, repair: bool) -> tuple[Log, list[Finding]]:
    """Rows at the start that hold one value each before everything jumps to where it really is."""
    most = min(max(5, len(log.time) // 100), 500)
    dummy, text = 0, ""
    for name, values in log.channels.items():
        if not channel(name).moves or not np.isfinite(values).all():
            continue
        steps, rest = np.abs(np.diff(values)), values[most:]
        if len(rest) < LEAST_PART:
            continue
        low, high = np.percentile(rest, (1, 99))
        jumps = np.flatnonzero(steps[:most] > max(20.0 * float(np.percentile(steps[most:], 98)), 0.5 * (high - low)))
        ends = [int(row) + 1 for row in jumps if np.ptp(values[: row + 1]) == 0.0 and not low <= values[row] <= high]
        if ends and ends[0] > dummy:
            dummy = ends[0]
            text = f"{name} is {values[0]:.4g} there, then {values[dummy]:.4g} {channel(name).unit}"
    if not dummy:
        return log, []
    done = f"{dummy} rows left out" if repair else ""
    text = f"the first {dummy} rows are no measurements: {text}"
    found = Finding(log.name, "first rows", "", "warning", float(dummy), "rows", text, done)
    if repair:
        log = replace(log, time=log.time[dummy:], channels={key: v[dummy:] for key, v in log.channels.items()})
    return log, [found]


def split_at_gaps(log: Log, *, repair: bool) -> tuple[list[Log], list[Finding]]:
    """A log cut where it has long gaps; parts of a few samples are left out."""
    step = median_step(log.time)
    longest = max(1.0, 50.0 * step)
    cuts = np.flatnonzero(np.diff(log.time) > longest) + 1
    if not len(cuts):
        return [log], []
    bounds = list(zip(np.append(0, cuts), np.append(cuts, len(log.time)), strict=True))
    least = min(max(LEAST_PART, len(log.time) // 50), max(end - start for start, end in bounds))
    parts = [(start, end) for start, end in bounds if end - start >= least]
    lost = len(log.time) - sum(end - start for start, end in parts)
    text = f"{len(cuts)} gaps are longer than {longest:.3g} s: the log is {len(bounds)} stretches"
    done = (f"cut into {len(parts)} parts" if len(parts) > 1 else "one stretch kept") if repair else ""
    done += f", {lost} rows of short stretches left out" if done and lost else ""
    found = [Finding(log.name, "gaps", "", "fault", float(len(bounds)), "stretches", text, done)]
    if not repair:
        return [log], found
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
    return logs, found


def check_held(log: Log, *, repair: bool) -> tuple[Log, list[Finding]]:
    """Channels that change only every so many rows while they move.

    A log in which all that moves is held over the same rows is a copy at a higher rate; its repair is to keep one row
    of each. A single held channel is joined by straight lines between its fresh samples.
    """
    factors = {name: hold_factor(values) for name, values in log.channels.items() if channel(name).moves}
    seen = {name: factor for name, factor in factors.items() if factor is not None}
    step = median_step(log.time)
    fresh = {name: changed_rows(log.channels[name]) for name in seen}
    keep = _copied_rows(fresh, seen)
    if keep is not None:
        holds = np.diff(keep)
        holds = holds[holds <= LONGEST_HOLD]
        count = float(np.median(holds)) if np.ptp(holds) == 0 else float(holds.mean())
        over = (
            f"{count:.0f} rows"
            if np.ptp(holds) == 0
            else f"{holds.min()} to {holds.max()} rows, {count:.4g} in the mean"
        )
        text = (
            f"every value is held over {over}: a copy at {count:.4g} times the rate; the true step is "
            f"{count * step:.6g} s in the log's own time"
        )
        done = f"of {len(log.time)} rows the {len(keep)} with new values kept" if repair else ""
        found = [Finding(log.name, "held", "", "fault", count, "rows", text, done)]
        if repair:
            channels = {name: values[keep] for name, values in log.channels.items()}
            log = replace(log, time=log.time[keep], channels=channels)
            log, more = _check_slow(log, repair=repair)
            found += more
        return log, found
    return _check_slow(log, repair=repair)


def _check_slow(log: Log, *, repair: bool) -> tuple[Log, list[Finding]]:
    """Single channels that come at a lower rate than the rows."""
    factors = {name: hold_factor(values) for name, values in log.channels.items() if channel(name).moves}
    seen = {name: factor for name, factor in factors.items() if factor is not None}
    step = median_step(log.time)
    fresh = {name: changed_rows(log.channels[name]) for name in seen}
    found: list[Finding] = []
    mended: dict[str, Array] = {}
    for name, (factor, part) in seen.items():
        if factor < 1.15:
            if part > 0.1:
                text = (
                    f"{100 * part:.2g} % of the rows repeat the one before while it moves, as often as values of steps "
                    "so coarse do by chance: not taken for held"
                )
                found.append(Finding(log.name, "held", name, "info", 1.0, "rows", text))
            continue
        rate = 1.0 / (factor * step)
        exact = factor == int(factor)
        text = (
            f"is held over {factor:.3g} rows{'' if exact else ' in the mean'} while it moves: its true rate is about "
            f"{rate:.3g} Hz ({100 * part:.2g} % of those rows repeat the one before)"
        )
        done = "joined by straight lines between fresh samples" if repair else ""
        found.append(Finding(log.name, "held", name, "warning", float(factor), "rows", text, done))
        if repair:
            values = log.channels[name].copy()
            rows = np.flatnonzero(fresh[name])
            if exact:  # coarse values repeat by chance, too: each row of their own rate is a fresh one
                rows = np.arange(_phase(rows[1:], int(factor)), len(values), int(factor))
            inner = np.isfinite(values)
            between = np.interp(np.arange(len(values)), rows, values[rows])
            # Where it really stands still the line would start too early: only holds as long as the rate are joined.
            hold = np.diff(np.append(rows, len(values)))
            short = np.repeat(hold <= 2 * np.ceil(factor), hold)
            values[rows[0] :][short & inner[rows[0] :]] = between[rows[0] :][short & inner[rows[0] :]]
            mended[name] = values
    return replace(log, channels={**log.channels, **mended}), found


def channels_with_common_holds(log: Log) -> list[set[str]]:
    """Channels that are held and change on the same rows: they come from one source, with one clock."""
    fresh = {}
    for name, values in log.channels.items():
        hold = hold_factor(values) if channel(name).moves else None
        if hold is not None and hold[0] >= 1.3:
            fresh[name] = changed_rows(values)
    found: list[set[str]] = []
    for name, rows in fresh.items():
        for group in found:
            other = fresh[next(iter(group))]
            if np.mean(other[rows]) > 0.9 and np.mean(rows[other]) > 0.8:
                group.add(name)
                break
        else:
            found.append({name})
    return [group for group in found if len(group) > 1]


def _copied_rows(fresh: dict[str, NDArray[np.bool_]], seen: dict[str, tuple[float, float]]) -> NDArray[np.int64] | None:
    """The rows to keep of a log in which all that moves changes on the same rows only; None: it is no such log."""
    if len(seen) < 2 or min(factor for factor, _ in seen.values()) < 1.3:
        return None
    counts = {name: int(rows.sum()) for name, rows in fresh.items()}
    lead = fresh[max(counts, key=lambda name: counts[name])]
    near = lead
    alike = [name for name, rows in fresh.items() if np.mean(near[rows]) > 0.95]
    if len(alike) < len(fresh):
        return None
    whole = {factor for factor, _ in seen.values()}
    if len(whole) == 1 and (factor := whole.pop()) == int(factor):
        return np.arange(_phase(np.flatnonzero(lead)[1:], int(factor)), len(lead), int(factor))
    # Held over changing numbers of rows. Where nothing changes, the vehicle stands: rows there at the usual distance.
    rows = np.flatnonzero(np.logical_or.reduce(list(fresh.values())))
    if len(rows) > 0.75 * len(lead):
        return None
    usual = max(round(float(np.median(np.diff(rows)))), 1)
    ends = np.append(rows[1:], len(lead))
    return np.concatenate(
        [np.arange(a, b, usual) if b - a > 2 * usual else [a] for a, b in zip(rows, ends, strict=True)]
    ).astype(np.int64)


def resolution(values: Array) -> float | None:
    """The step that all values are multiples of, if there are much fewer levels than values."""
    levels = np.unique(values[np.isfinite(values)])
    if not 2 <= len(levels) <= max(2000, len(values) // 4):
        return None
    steps = np.diff(levels)
    steps = steps[steps > 1e-6 * (levels[-1] - levels[0])]
    quantum = float(np.percentile(steps, 5))
    counts = steps / quantum
    even = np.abs(counts - np.round(counts)) < 0.1
    return float(np.median(steps[even] / np.round(counts[even]))) if even.mean() > 0.9 else None


def changed_rows(values: Array) -> NDArray[np.bool_]:
    """Which rows have another value than the row before (n); the first one has."""
    return np.append(True, (np.diff(values) != 0.0) & np.isfinite(values[1:]))


def hold_factor(values: Array) -> tuple[float, float] | None:
    """Rows over which a channel holds its values, and the part of repeated rows, while it moves.

    A whole factor is returned when the changes keep to a grid of rows. None: it moves too little to tell.
    """
    if sparse_factor(values) is not None:  # the rows between are empty, not held
        return None
    fresh = changed_rows(values)
    changes = np.flatnonzero(fresh)[1:]
    if len(changes) < 20:
        return None
    if len(changes) > NOT_HELD * len(values):
        return 1.0, 0.0
    # However coarse the values are: changes that all come on every so many rows are those of a slower source.
    if len(changes) >= LEAST_CHANGES:
        for factor in range(min(LONGEST_HOLD, int(1.1 * len(values) / len(changes))), 1, -1):
            if np.mean(changes % factor == _phase(changes, factor)) > ON_GRID:
                return float(factor), 1.0 - 1.0 / factor
    # Quantised values repeat by themselves when they are slow: look only where a change is one of several quanta.
    quantum = resolution(values) or 0.0
    window = 2 * LONGEST_HOLD
    steps = np.abs(np.diff(np.nan_to_num(values)))
    level = uniform_filter1d(steps, window, mode="constant")
    often = uniform_filter1d(fresh[1:].astype(float), window, mode="constant")
    large = level > 4.0 * quantum * np.maximum(often, 1.0 / window)
    moving = large & (level > 1e-3 * float(np.percentile(level, 99.0)))
    if moving.any():  # what is held is so where it moves fast, too; what is coarse is not
        fast = moving & (level >= np.median(level[moving]))
        moving = fast if fast.sum() >= 10 * window else moving
    moving = np.append(False, moving)
    here = changes[moving[changes]]
    if len(here) < 20 or moving.sum() < 60:
        return None
    holds = np.diff(here)
    holds = holds[
        (holds <= LONGEST_HOLD) & (np.add.accumulate(~moving)[here[1:]] == np.add.accumulate(~moving)[here[:-1]])
    ]
    if len(holds) < 15:
        return None
    usual = int(np.median(holds))
    for factor in range(min(usual, LONGEST_HOLD), 1, -1):
        on_grid = np.bincount(here % factor).max() / len(here)
        if on_grid > 0.93 and np.mean(holds <= factor) > 0.5:
            return float(factor), 1.0 - 1.0 / factor
    mean = float(holds.mean()) / (1.0 + _chance(steps[here - 1]))
    if mean < 1.15:
        return 1.0, 1.0 - 1.0 / float(holds.mean())
    near = round(mean)
    if near > 1 and abs(mean - near) < 0.03 * near:
        mean = float(near)
    return mean if mean != int(mean) else mean + 1e-9, 1.0 - 1.0 / mean


def _phase(rows: NDArray[np.intp], factor: int) -> int:
    """On which of every so many rows most of these rows are."""
    return int(np.bincount(rows % factor, minlength=factor).argmax())


def _chance(changes: Array) -> float:
    """How often coarse values repeat by chance, per change: as changes by none are beside those by one and two steps.

    Args:
        changes: sizes of the changes (n), not zero.
    """
    least = float(np.percentile(changes, 1.0))
    counts = changes[changes < 8.0 * least] / least
    if np.mean(np.abs(counts - np.round(counts)) < 0.1) < 0.95:
        return 0.0  # fine values
    ones, twos = (float(np.mean(np.round(counts) == number)) for number in (1, 2))
    peak = min(max(ones / max(twos, 1e-3), 1.0), 10.0) ** (1.0 / 3.0)  # of a normal distribution
    return float(0.5 * ones * len(counts) / len(changes) * peak)
