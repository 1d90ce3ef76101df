"""Values of single channels: glitches, quantisation, saturation, range."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, median_filter

from mirdrake.identification.channels import channel, quantity
from mirdrake.identification.data import Array, Log
from mirdrake.identification.findings import Finding, Severity, statement
from mirdrake.identification.timing import changed_rows, resolution

WINDOW = 9
"""Samples of the median filter that glitches are compared with: up to four in a row are found."""

ORDER = 6
"""Order of the autoregressive model of the neighbourhood: three modes."""

NEIGHBOURHOOD = 30
"""Samples on each side of odd ones that the model is fitted to."""

ROUNDING = 1e-9
"""Relative size of residuals that are only rounding errors [1]."""

UNEXPLAINED = 0.5
"""Largest ratio of the sums of squares, as kicks over as glitches, if odd samples begin a motion [1]."""

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
    for name, values in log.channels.items():
        if not channel(name).moves:
            continue
        bad = find_glitches(values, channel(name).limit)
        if not bad.any():
            continue
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


def _unmeasured(values: Array, bad: NDArray[np.bool_]) -> int:
    """Return the number of first samples that are glitches of the value 0: the channel is not measured yet."""
    first = bad & (values == 0.0)
    return len(first) if first.all() else int(np.argmin(first))


def find_glitches(values: Array, limit: float) -> NDArray[np.bool_]:
    """Return which samples are glitches (n).

    A glitch is far from the median of its neighbourhood, relative to the usual distance in the channel (noise), the
    steps of the neighbourhood (motion) and the resolution, and the samples behind it do not respond to it. A step, a
    ramp, a peak of a smooth motion and the vibration after a kick are not glitches.

    Args:
        values: samples (n), NaN for missing ones.
        limit: largest possible magnitude.
    """
    bad = np.zeros(len(values), dtype=bool)
    rows, fresh = _samples(values)
    if fresh.sum() < 3 * WINDOW:
        return bad
    series = values[rows]
    # A median keeps steps and ramps and removes outliers of up to half its window, so its distance isolates them.
    away = np.abs(series - median_filter(series, WINDOW, mode="mirror"))
    steps = np.abs(np.diff(series, prepend=series[0]))
    # Robust figures of the channel, by new values only: held rows would make noise and steps vanish. 1.4826 times the
    # median is the standard deviation of normal noise.
    noise = 1.4826 * float(np.median(away[fresh]))
    usual = float(np.median(steps[fresh]))
    quantum = float(np.percentile(steps[steps > 0.0], 2)) if (steps > 0.0).any() else 0.0
    # Motion of the neighbourhood, without the samples next to the one in question.
    level = median_filter(steps, 15, mode="mirror")
    motion = maximum_filter1d(level, 2 * WINDOW + 1, mode="nearest")
    floor = np.maximum(8.0 * motion, max(10.0 * noise, 4.0 * usual, 5.0 * quantum))
    # Rough stretches, such as a shock, have many large distances, which a glitch must exceed.
    rough = maximum_filter1d(median_filter(away, 25, mode="mirror"), 25, mode="nearest")
    floor = np.maximum(floor, 12.0 * rough)
    # A glitch exceeds its limit, or its neighbourhood by noise, motion and roughness.
    ends = np.append(rows[1:], len(values))
    out, jumped, codes = _far_out(series, steps)
    odd = (away > floor) | jumped
    # All of a vibration far out is one motion, of which the test below needs the first sample.
    odd &= ~_begin_motion(series, odd | out, odd)
    odd |= codes | (np.abs(series) > limit)
    if odd.mean() > 0.05:  # not single samples, but another kind of signal
        return bad
    # Rows that hold the value of a glitch belong to it.
    for start, end in zip(rows[odd], ends[odd], strict=True):
        bad[start:end] = True
    return bad & np.isfinite(values)


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
    more = first[:, None] + usual * np.arange(1, MAX_HELD)
    more = more[more < (first + hold_lengths)[:, None]]
    rows = np.union1d(first, more[np.isfinite(values[more])])
    return rows, np.isin(rows, first)


def _begin_motion(values: Array, odd: NDArray[np.bool_], asked: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which odd samples begin a motion (n): the samples behind them continue it.

    A glitch is an additive outlier of an autoregressive process, which changes single samples. A kick of the vehicle is
    an innovation outlier, to which all later samples respond (A. J. Fox, Journal of the Royal Statistical Society B 34,
    1972; I. Chang, G. C. Tiao and C. Chen, Technometrics 30, 1988). Both have a free number for each odd sample, so
    their sums of squares are compared directly. If neither explains more, as in white noise, they are glitches. A
    glitch within a few samples of a kick is taken for a part of it.

    Args:
        values: samples (n).
        odd: which are far from their neighbours or from the rest (n).
        asked: which of the odd ones may be glitches (n); groups without one are omitted.
    """
    begin, rows = np.zeros(len(values), dtype=bool), np.flatnonzero(odd)
    groups = np.split(rows, np.flatnonzero(np.diff(rows) > ORDER) + 1) if len(rows) else []
    groups = [group for group in groups if asked[group].any()]
    for group in groups:
        start, end = max(group[0] - NEIGHBOURHOOD, 0), group[-1] + 1 + NEIGHBOURHOOD
        # Before the log the channel is taken to be constant.
        padded = ORDER if start == 0 else 0
        part = np.pad(values[start:end], (padded, 0), mode="edge")
        others = np.setdiff1d(rows[(rows >= start) & (rows < end)], group)
        first, none = start - padded, group[:0]
        as_glitches = _sum_of_squares(part, group - first, none, others - first)
        as_kicks = _sum_of_squares(part, none, group - first, others - first)
        begin[group] = group[0] > 0 and as_kicks < UNEXPLAINED * as_glitches
    # At an end little shows how a value came, or whether it returns: less than a range away from the others it may be
    # a motion, such as a start from rest.
    for group in groups:
        if group[0] < ORDER or group[-1] + ORDER >= len(values):
            others = values[~odd | begin]
            low, high = float(np.min(others)), float(np.max(others))
            begin[group] |= np.all(np.abs(values[group] - 0.5 * (low + high)) < 1.5 * (high - low))
    return begin


def _sum_of_squares(
    series: Array, glitches: NDArray[np.intp], kicks: NDArray[np.intp], others: NDArray[np.intp]
) -> float:
    """Return the sum of squared residuals of an autoregressive model, relative to the largest value.

    Args:
        series: odd samples and their neighbourhood (n).
        glitches: rows of glitches: their values are replaced by those that fit the model of the others best.
        kicks: rows of kicks: they have any innovation, and the model has to predict all others.
        others: rows of other odd samples, which are left out.
    """
    odd = np.concatenate((glitches, kicks))
    values = series - np.median(np.delete(series, odd))
    values = values / max(float(np.abs(np.delete(values, others)).max()), 1e-300)
    rows = np.arange(ORDER, len(values))
    rows = rows[~np.isin(rows, kicks) & ~np.isin(rows[:, None] - np.arange(ORDER + 1), others).any(axis=1)]
    lags = rows[:, None] - np.arange(1, ORDER + 1)
    values[glitches] = 0.0
    past, present = np.column_stack((values[lags], np.ones(len(rows)))), values[rows]
    clean = ~np.isin(np.column_stack((rows, lags)), glitches).any(axis=1)
    model = np.linalg.lstsq(past[clean], present[clean], rcond=ROUNDING)[0]
    residual = present - past @ model
    if len(glitches):
        effect = (rows[:, None] == glitches) - np.einsum("k,rko->ro", model[:ORDER], lags[:, :, None] == glitches)
        residual -= effect @ np.linalg.lstsq(effect, residual, rcond=None)[0]
    # Below the rounding errors of the values, the residuals mean nothing.
    return float(residual @ residual) + len(rows) * ROUNDING**2


def _far_out(series: Array, steps: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which samples are many ranges of the rest away (n), and two kinds of faults among them.

    The faults are up to four samples in a row that are entered and left by a jump (n), and codes for missing data (n),
    which repeat one value any number of times. Other stretches are motions: a launch or a stop in a long steady drive
    is as far away, and an acceleration begins and ends by a jump as well.
    """
    # The range without extremes, as these are what is looked for.
    low, high = np.percentile(series, (2.0, 98.0))
    reach = 20.0 * (high - low)
    out = (series < low - reach) | (series > high + reach)
    jumped, codes = np.zeros(len(series), dtype=bool), np.zeros(len(series), dtype=bool)
    if reach == 0.0 or not out.any():
        return out & False, jumped, codes
    starts = np.flatnonzero(out & ~np.append(False, out[:-1]))
    ends = np.flatnonzero(out & ~np.append(out[1:], False)) + 1
    for start, end in zip(starts, ends, strict=True):
        # A motion covers the distance in many steps; a fault value jumps there and back.
        jump = 0.5 * float(np.abs(series[start:end] - np.clip(series[start:end], low, high)).max())
        came = start == 0 or steps[start] > jump
        went = end == len(series) or steps[end] > jump
        if came and went and end - start <= WINDOW // 2:
            jumped[start:end] = True
        elif came and went and np.ptp(series[start:end]) == 0.0:
            codes[start:end] = True
    # What is more frequent belongs to the signal.
    return out, jumped & bool(jumped.mean() <= 0.02), codes & bool(codes.mean() <= 0.02)


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
