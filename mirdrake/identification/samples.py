"""Values of single channels: glitches, quantisation, saturation, range."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from mirdrake.identification.channels import channel, quantity
from mirdrake.identification.data import Array, Log
from mirdrake.identification.findings import Finding, Severity, statement
from mirdrake.identification.timing import changed_rows, resolution

WINDOW = 9
"""Samples of the median filter that noise is measured with."""

LONGEST = 4
"""Largest number of samples of a glitch."""

CLEAR = 5.0
"""Ratio of the distances of a glitch and of the samples beside it from their neighbours [1]. A response that decays to
a fifth or more from sample to sample is not taken for a glitch."""

BESIDE, REACH = 6, 2
"""Number of samples on each side that must be calm; rows between a kick of two channels."""

FAR = 10.0
"""Ranges of a channel beyond which a value is a glitch whatever the others do [1]."""

FINEST = 2.0**-20
"""Resolution of a sensor over the largest value of its quantity [1], below which nothing is a glitch: 20 bits."""

INTEGRALS = frozenset({"vx", "speed", "x", "y", "yaw", "latitude", "longitude"})
"""Quantities that no kick moves there and back."""

MAX_HELD = 2 * WINDOW
"""Largest number of rows that count as samples of a channel at rest."""


def unwrap_headings(log: Log) -> tuple[Log, list[Finding]]:
    """Unwrap headings that jump by a whole turn, as from 180 to -180 degrees."""
    findings, repaired = [], {}
    for name, values in log.channels.items():
        if quantity(name) != "yaw":
            continue
        good = np.isfinite(values)
        steps = np.diff(values[good])
        # Jumps by more than a turn and a half are not wraps.
        turns = np.where(np.abs(steps) < 3.0 * np.pi, -np.round(steps / (2.0 * np.pi)), 0.0)  # more is a glitch
        if turns.any():
            repaired[name] = values.copy()
            repaired[name][good] += 2.0 * np.pi * np.append(0.0, np.cumsum(turns))
            count = int(np.count_nonzero(turns))
            text = statement("wrapped", count=count)
            findings.append(Finding(log.name, "range", name, "info", float(count), "jumps", text))
    return (replace(log, channels={**log.channels, **repaired}) if repaired else log), findings


def check_glitches(log: Log, *, repair: bool) -> tuple[Log, list[Finding]]:
    """Find single samples, or up to four in a row, that differ strongly from their neighbours.

    First samples that are 0 are not yet measured: a warning, not a fault.
    """
    # Only channels that move continuously can be judged by their neighbours.
    findings, repaired = [], {}
    for name, bad in _glitches_of_log(log).items():
        values = log.channels[name]
        unit = channel(name).unit
        before = _unmeasured(values, bad)
        if before:
            text = statement("not_measured", rows=before, then=float(values[before]), unit=unit)
            done = statement("first_value") if repair else None
            findings.append(Finding(log.name, "first_rows", name, "warning", float(before), "rows", text, done))
        if repair:
            good = ~bad & np.isfinite(values)
            repaired[name] = np.where(bad, np.interp(log.time, log.time[good], values[good]), values)
        bad[:before] = False
        if not bad.any():
            continue
        count = int(bad.sum())
        times = ", ".join(f"{instant:.6g}" for instant in log.time[bad][:5]) + (", …" if count > 5 else "")
        worst = values[bad][np.argmax(np.abs(values[bad]))]
        text = statement("glitches", count=count, times=times, worst=float(worst), unit=unit)
        done = statement("interpolated") if repair else None
        findings.append(Finding(log.name, "glitches", name, "fault", float(count), "samples", text, done))
    return replace(log, channels={**log.channels, **repaired}), findings


def _glitches_of_log(log: Log) -> dict[str, NDArray[np.bool_]]:
    """Return the glitches of channels that have some: what begins in other channels as well is a kick of the vehicle.

    A faulty packet shows in speed or position, too, which no kick moves there and back.
    """
    found = {name: find_glitches(values, channel(name).limit)
             for name, values in log.channels.items() if channel(name).moves}  # fmt: skip
    found = {name: bad for name, bad in found.items() if bad.any()}
    if not found:
        return {}
    kicks = {name: find_kicks(values) for name, values in log.channels.items()}
    sure = np.any([bad & (quantity(name) in INTEGRALS) for name, bad in found.items()], axis=0)
    for name, bad in found.items():
        others = ~sure & np.any([kick for other, kick in kicks.items() if other != name] or [~bad & bad], axis=0)
        for rows in np.split(np.flatnonzero(bad), np.flatnonzero(np.diff(np.flatnonzero(bad)) > BESIDE) + 1):
            if quantity(name) not in INTEGRALS and _is_kick(log.channels[name], rows, bad, others):
                found[name] = found[name] & ~np.isin(np.arange(len(bad)), rows)
    return {name: bad for name, bad in found.items() if bad.any()}


def _unmeasured(values: Array, bad: NDArray[np.bool_]) -> int:
    """Return the number of first samples that are glitches of the value 0: the channel is not measured yet."""
    first = bad & (values == 0.0)
    return len(first) if first.all() else int(np.argmin(first))


def find_glitches(values: Array, limit: float) -> NDArray[np.bool_]:
    """Return which samples are glitches by their own channel (n).

    A glitch is up to :data:`LONGEST` samples that jump there and back between calm neighbours: their distance from the
    line between the samples on both sides exceeds :data:`CLEAR` times the largest such distance of a sample beside
    them. The vibration after a kick and a force whose input changes are not calm. The distance also exceeds noise,
    usual steps and resolution of the channel.

    Args:
        values: samples (n), NaN for missing ones.
        limit: largest possible magnitude.
    """
    bad = np.zeros(len(values), dtype=bool)
    rows, fresh = _samples(values)
    if fresh.sum() < 3 * WINDOW:
        return bad
    series = values[rows]
    floor = max(_floor(series, fresh), FINEST * limit if np.isfinite(limit) else 0.0)
    odd = np.zeros(len(series), dtype=bool)
    bend = np.abs(series - 0.5 * (np.append(series[0], series[:-1]) + np.append(series[1:], series[-1])))
    for count in range(1, LONGEST + 1):
        size, beside = _distances(series, bend, count)
        first = np.flatnonzero((size > floor) & (size > CLEAR * beside))
        odd[(first[:, None] + np.arange(count)).ravel()] = True
    away = np.abs(series - median_filter(series, WINDOW, mode="nearest"))
    usual_bend = median_filter(bend, 2 * BESIDE + 3, mode="nearest")
    odd |= _bursts(series, (away > floor) & (away > CLEAR * usual_bend) & ~odd)
    for series_, odd_ in ((series, odd), (series[::-1], odd[::-1])):
        odd_[: _glitches_at_end(series_, odd_, floor)] = True
    odd |= _codes(series) | (np.abs(series) > limit)
    if odd.mean() > 0.05:  # not single samples, but another kind of signal
        return bad
    # Rows that hold the value of a glitch belong to it.
    ends = np.append(rows[1:], len(values))
    for start, end in zip(rows[odd], ends[odd], strict=True):
        bad[start:end] = True
    return bad & np.isfinite(values)


def find_kicks(values: Array) -> NDArray[np.bool_]:
    """Return where a channel begins to move (n): samples that the line through the last two does not predict.

    The distance exceeds :data:`CLEAR` times that of the samples before, and noise, usual steps and resolution.
    """
    kicks = np.zeros(len(values), dtype=bool)
    rows, fresh = _samples(values)
    if fresh.sum() < 3 * WINDOW:
        return kicks
    series = values[rows]
    away = np.append(np.zeros(2), np.abs(np.diff(series, 2)))
    before = np.max([np.append(np.zeros(k), away[:-k]) for k in range(1, BESIDE + 1)], axis=0)
    kicks[rows[(away > CLEAR * before) & (away > _floor(series, fresh))]] = True
    return kicks


def _floor(series: Array, fresh: NDArray[np.bool_]) -> float:
    """Return the distance below which nothing is odd, by noise, usual steps and resolution of a channel."""
    # Robust figures, by new values only: held rows would make noise and steps vanish. 1.4826 times the median is the
    # standard deviation of normal noise.
    away = np.abs(series - median_filter(series, WINDOW, mode="mirror"))
    steps = np.abs(np.diff(series, prepend=series[0]))
    noise, usual = 1.4826 * float(np.median(away[fresh])), float(np.median(steps[fresh]))
    quantum = float(np.percentile(steps[steps > 0.0], 2)) if (steps > 0.0).any() else 0.0
    return max(10.0 * noise, 4.0 * usual, 5.0 * quantum)


def _distances(series: Array, bend: Array, count: int) -> tuple[Array, Array]:
    """Return distances of groups of samples, and of the samples beside them, from lines between their neighbours (n).

    Args:
        series: samples (n).
        bend: distance of each sample from the line between its neighbours (n).
        count: length of the groups; each has the row of its first sample. The nearest of a group counts.
    """
    # Before and after the log the channel is taken to be constant.
    n, padded = len(series), np.pad(series, 2, mode="edge")
    size, beside, first = np.zeros(n), np.zeros(n), np.arange(n - count + 1)
    earlier, before, after, later = (padded[first + 2 + k] for k in (-2, -1, count, count + 1))
    slope = (after - before) / (count + 1)
    size[first] = np.min([np.abs(series[first + k] - before - (k + 1) * slope) for k in range(count)], axis=0)
    # Without the group, the samples next to it are neighbours of each other.
    largest = np.maximum(
        np.abs(before - earlier - (after - earlier) / (count + 2)),
        np.abs(after - before - (later - before) * (count + 1) / (count + 2)),
    )
    wide = np.pad(bend, BESIDE)
    for k in range(2, BESIDE + 1):
        largest = np.maximum(largest, wide[first + BESIDE - k])
        largest = np.maximum(largest, wide[first + BESIDE + count - 1 + k])
    beside[first] = largest
    return size, beside


def _bursts(series: Array, suspect: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which samples are glitches near others (n): together they satisfy the condition of a single one.

    Args:
        series: samples (n).
        suspect: samples that are far away beside most samples near them (n).
    """
    bad, rows = np.zeros(len(series), dtype=bool), np.flatnonzero(suspect)
    for cluster in np.split(rows, np.flatnonzero(np.diff(rows) > BESIDE) + 1) if len(rows) else []:
        longest = max(len(run) for run in np.split(cluster, np.flatnonzero(np.diff(cluster) > 1) + 1))
        if longest == len(cluster) or longest > LONGEST:
            continue
        near = np.arange(max(cluster[0] - BESIDE, 0), min(cluster[-1] + BESIDE + 1, len(series)))
        rest = near[~suspect[near]]
        size = np.abs(series[cluster] - np.interp(cluster, rest, series[rest]))
        # The distance of each other sample from the line between those beside it.
        slope = (series[rest[2:]] - series[rest[:-2]]) / (rest[2:] - rest[:-2])
        beside = np.abs(series[rest[1:-1]] - series[rest[:-2]] - slope * (rest[1:-1] - rest[:-2]))
        bad[cluster] = len(beside) >= BESIDE and size.min() > CLEAR * beside.max()
    return bad


def _glitches_at_end(series: Array, odd: NDArray[np.bool_], floor: float) -> int:
    """Return the number of first samples that are glitches.

    How a value came or returns does not show there, and it may be a start from rest. The jump behind a glitch exceeds
    :data:`CLEAR` times the largest step of the other samples.
    """
    found = 0
    for count in range(1, LONGEST + 1):
        rest = series[count:][~odd[count:]]
        jump = float(np.min(np.abs(series[:count] - rest[0])))
        if jump > floor and jump > CLEAR * float(np.max(np.abs(np.diff(rest)))):
            found = count
    return found


def _samples(values: Array) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return rows of new values (n), and some more where a channel rests; and which of them are new values (n).

    A channel that is held over every other row has one sample in two rows; one at rest does not change for long.
    """
    first = np.flatnonzero(changed_rows(values) & np.isfinite(values))
    if not len(first):
        return first, np.ones(0, dtype=bool)
    # Rows that repeat a value beyond its usual hold are samples at rest, without which the medians see only motion.
    hold_lengths = np.diff(first, append=len(values))
    usual = max(int(np.median(hold_lengths)), 1)
    long = hold_lengths > usual
    more = first[long, None] + usual * np.arange(1, MAX_HELD)
    more = more[more < (first + hold_lengths)[long, None]]
    is_fresh, is_sample = np.zeros((2, len(values)), dtype=bool)
    is_fresh[first] = is_sample[first] = True
    is_sample[more[np.isfinite(values[more])]] = True
    rows = np.flatnonzero(is_sample)
    return rows, is_fresh[rows]


def _is_kick(values: Array, rows: NDArray[np.intp], bad: NDArray[np.bool_], others: NDArray[np.bool_]) -> bool:
    """Return whether glitches of one channel are a kick of the vehicle, which begins in another channel as well.

    Args:
        values: samples of the channel (n).
        rows: rows of glitches that are near one another.
        bad: all glitches of the channel (n).
        others: where other channels begin to move (n).
    """
    if not others[max(rows[0] - REACH, 0) : rows[-1] + 1 + REACH].any():
        return False
    rest = values[~bad & np.isfinite(values)]
    low, high = float(np.min(rest)), float(np.max(rest))
    return bool(np.all(np.abs(values[rows] - 0.5 * (low + high)) < (0.5 + FAR) * (high - low)))


def _codes(series: Array) -> NDArray[np.bool_]:
    """Return which samples are codes for missing data (n): one value any number of times, many ranges of the rest away.

    Other stretches that far away are motions, such as a launch or a stop in a long steady drive.
    """
    # The range without extremes, as these are what is looked for.
    low, high = np.percentile(series, (2.0, 98.0))
    reach = 20.0 * (high - low)
    out = (series < low - reach) | (series > high + reach)
    codes = np.zeros(len(series), dtype=bool)
    if reach == 0.0 or not out.any():
        return codes
    steps = np.abs(np.diff(series, prepend=series[0]))
    starts = np.flatnonzero(out & ~np.append(False, out[:-1]))
    ends = np.flatnonzero(out & ~np.append(out[1:], False)) + 1
    for start, end in zip(starts, ends, strict=True):
        # A motion covers the distance in many steps; a fault value jumps there and back.
        jump = 0.5 * float(np.abs(series[start:end] - np.clip(series[start:end], low, high)).max())
        came = start == 0 or steps[start] > jump
        went = end == len(series) or steps[end] > jump
        codes[start:end] = came and went and np.ptp(series[start:end]) == 0.0
    # What is more frequent belongs to the signal.
    return codes & bool(codes.mean() <= 0.02)


def check_values(log: Log) -> list[Finding]:
    """Check resolution, saturation, range, and channels that never change."""
    findings: list[Finding] = []
    if all(np.nanmax(values) == np.nanmin(values) for values in log.channels.values()):
        text = statement("all_constant")
        return [Finding(log.name, "range", "", "fault", float(len(log.channels)), "channels", text)]
    for name, values in log.channels.items():
        known, good = channel(name), values[np.isfinite(values)]
        low, high = float(good.min()), float(good.max())
        if low == high:
            at_rest = quantity(name) in {"vx", "speed"} and low == 0.0
            text = statement("constant", value=low, unit=known.unit, at_rest=at_rest)
            findings.append(Finding(log.name, "range", name, "fault" if at_rest else "warning", low, known.unit, text))
            continue
        # A magnitude that no vehicle reaches points to another unit.
        if max(-low, high) > known.limit:
            text = statement("out_of_range", value=max(-low, high), unit=known.unit, limit=known.limit)
            findings.append(Finding(log.name, "range", name, "fault", max(-low, high), known.unit, text))
        if name == "gear" and (codes := np.unique(good)).size < 40 and (codes.min() < 0 or codes.max() > 10):
            text = statement("gear_codes", codes=", ".join(f"{code:g}" for code in codes))
            findings.append(Finding(log.name, "codes", name, "info", float(codes.size), "codes", text))
        if not known.moves:
            continue
        # Positions far from the origin lose digits in single precision, which shows as coarse steps.
        quantum, levels = resolution(good), len(np.unique(good))
        moved = float(np.median(np.abs(np.diff(good)))) if quantum is not None else 0.0
        coarse = quantum is not None and name.partition("@")[0] in {"x", "y"} and quantum > 0.05 and quantum > moved
        if quantum is not None and (levels < 200 or coarse):
            # Steps that are a power of two are the spacing of 32-bit floats.
            single = bool(coarse and np.log2(quantum) == np.round(np.log2(quantum)))
            text = statement(
                "quantised",
                quantum=quantum,
                unit=known.unit,
                levels=levels,
                low=low,
                high=high,
                single_precision=single,
            )
            severity: Severity = "warning" if levels < 30 or coarse else "info"
            findings.append(Finding(log.name, "quantisation", name, severity, quantum, known.unit, text))
        # Clipping shows as repeated visits at an extreme.
        for extreme in (low, high):
            count = clipped(good, extreme)
            if count:
                text = statement("clipped", value=extreme, unit=known.unit, count=count)
                findings.append(Finding(log.name, "saturation", name, "warning", extreme, known.unit, text))
    return findings


def clipped(values: Array, extreme: float) -> int:
    """Return the number of samples at an extreme that is reached at speed several times; 0 if not clipped."""
    if extreme == 0.0:
        return 0
    at_extreme = values == extreme
    starts = np.flatnonzero(at_extreme & ~np.append(True, at_extreme[:-1]))
    ends = np.flatnonzero(at_extreme & ~np.append(at_extreme[1:], False)) + 1
    ends = ends[ends > starts[0]] if len(starts) else ends
    steps = np.abs(np.diff(values))
    # Several visits of the same extreme value are a limit; one may be a true maximum.
    quantum = resolution(values) or 0.0
    visits = [
        end - start
        for start, end in zip(starts, ends, strict=False)
        if end - start >= 5 and steps[start - 1] > max(3.0 * quantum, 0.0)
    ]
    return int(sum(visits)) if len(visits) >= 2 else 0
