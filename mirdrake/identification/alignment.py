"""How late channels are against each other, to a fraction of a sample, from pairs that kinematics ties together."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from mirdrake.identification.data import Array, Log
from mirdrake.identification.findings import Finding, Severity
from mirdrake.identification.relations import Grid, Relation, make_grid, relations_of
from mirdrake.identification.sideways import Sideways, sideways_delays

LONGEST = 0.6
"""Delays are sought up to this [s]."""

SMOOTHING = 0.05
"""Standard deviation of the Gaussian that both sides pass before they are compared [s]; it shifts nothing."""

LEVELS = 4
"""The comparison is made with that smoothing, twice, four times, …; the one that is surest counts."""

STEERING = ("road_wheel_angle", "steering_wheel_angle", "steering_command")

BLOCKS = 10
"""Parts of a log, whose delays give the uncertainty and the drift."""


class Delay(NamedTuple):
    """How late one signal is behind another.

    Attributes:
        value: positive when the first one is late [s].
        sigma: its standard deviation, from its scatter over the log [s].
        drift: change of the delay with time [s/s].
        drift_sigma: its standard deviation [s/s].
        correlation: of both, once they are aligned.
    """

    value: float
    sigma: float
    drift: float
    drift_sigma: float
    correlation: float


def delay_of(left: Array, right: Array, step: float) -> Delay | None:
    """How late the first signal is behind the second, whatever its scale and offset; None: too little moves.

    It is where the cross-correlation has its peak; noise leaves it alone, if that of one side is not of the other.

    Args:
        left: samples on even steps (n).
        right: samples at the same times (n).
        step: [s].
    """
    if np.ptp(left) == 0.0 or np.ptp(right) == 0.0:
        return None
    best, width, passed, sides = None, SMOOTHING, 0.0, (left - left.mean(), right - right.mean())
    for _ in range(LEVELS):
        rows = np.sqrt(max(width**2 - passed**2, 0.0)) / step
        if rows >= 1.0 or passed == 0.0:
            rows = max(rows, 1.0)
            sides = (
                gaussian_filter1d(sides[0], rows, mode="nearest"),
                gaussian_filter1d(sides[1], rows, mode="nearest"),
            )
            passed = np.hypot(passed, rows * step)
            thin = max(1, int(passed / (2.0 * step)))  # what is smooth needs few samples
            sides, step = (sides[0][::thin], sides[1][::thin]), step * thin
            found = _delay_at(*sides, step, passed)
            if found is not None and (best is None or found.sigma < 0.7 * best.sigma):
                best = found
        width *= 2.0
    return best


def _delay_at(a: Array, b: Array, step: float, width: float) -> Delay | None:
    """The delay between two smooth signals; `width` is that of their smoothing [s]."""
    margin = int(np.ceil(3 * width / step))
    reach = min(int(LONGEST / step) + 1, len(a) // 4)
    if len(a) < 4 * margin + 40 or np.ptp(a) == 0.0 or np.ptp(b) == 0.0:
        return None
    size = 1 << int(2 * len(a) - 1).bit_length()
    # Differences of the samples weigh the fast part, which has the timing.
    spectrum = np.fft.rfft(np.gradient(a), size) * np.conj(np.fft.rfft(np.gradient(b), size))
    product = np.fft.irfft(spectrum, size)
    lags = np.arange(-reach, reach + 1)
    at = int(np.argmax(np.abs(product[lags])))
    delay = float(lags[at])
    if abs(delay) == reach:
        return None
    rows = np.arange(len(a), dtype=float)
    inner = slice(margin + reach, len(a) - margin - reach)
    curve, own = CubicSpline(rows, b), np.gradient(a)[inner]
    # Newton's steps to the peak of the cross-correlation. Its curvature is that of one slope with the other, in which
    # noise of either side has no part.
    for _ in range(20):
        rest, slope, shifted = _compared(a[inner], curve, rows[inner] - delay)
        curvature = float(own @ slope)
        change = float(np.clip(-(rest @ slope) / curvature, -1.0, 1.0)) if curvature else 0.0
        delay += change
        if abs(change) < 1e-4:
            break
    if abs(delay) > reach:
        return None
    rest, slope, shifted = _compared(a[inner], curve, rows[inner] - delay)
    correlation = float(np.corrcoef(a[inner], shifted)[0, 1])
    # One more step in each part by itself. The offset may wander (grade, mounting): each part has its own.
    parts = np.array_split(np.arange(len(shifted)), BLOCKS)
    values, weights, times, sign = [], [], [], np.sign(own @ slope)
    for part in parts:
        tangent = slope[part] - slope[part].mean()
        weight = float(sign * (own[part] @ tangent))
        if weight > 0.0:
            values.append(-float(sign * (tangent @ (rest[part] - rest[part].mean()))) / weight)
            weights.append(weight)
            times.append(float(part.mean()) * step)
    if not weights:
        return None
    value, share, time = np.array(values) * step, np.array(weights) / sum(weights), np.array(times)
    enough = 1.0 / float(np.sum(share**2))  # effective number of parts
    if enough < 1.5:
        return None
    spread = float(np.sum(share * value**2)) / max(enough - 1.0, 0.5)
    mean = float(np.sum(share * time))
    across = float(np.sum(share * (time - mean) ** 2))
    drift = float(np.sum(share * (time - mean) * value)) / across
    left_over = float(np.sum(share * (value - drift * (time - mean)) ** 2)) / max(enough - 2.0, 0.5)
    return Delay(delay * step, float(np.sqrt(spread)), drift, float(np.sqrt(left_over / across)), correlation)


def _compared(left: Array, curve: CubicSpline, rows: Array) -> tuple[Array, Array, Array]:
    """What the right side leaves of the left one, the slope of the right side, and itself, each without its mean."""
    right, slope = curve(rows), curve(rows, 1)
    right, slope, left = right - right.mean(), slope - slope.mean(), left - left.mean()
    gain = np.sign(left @ right) * left.std() / max(right.std(), 1e-300)
    return left - gain * right, slope, right


def find_delays(log: Log) -> list[tuple[Relation, Delay]]:
    """The delays of all pairs of a log that move alike enough to tell."""
    grid = make_grid(log)
    found = []
    for relation in relations_of(grid.channels):
        delay = delay_of(relation.left(grid), relation.right(grid), grid.step)
        if delay is not None and abs(delay.correlation) > 0.8:
            found.append((relation, delay))
    return found


def check_delays(log: Log, sources: Sequence[Collection[str]] = (), *, repair: bool) -> tuple[Log, list[Finding]]:
    """Channels that are late against others; their repair shifts as few as possible.

    Args:
        log: the log.
        sources: channels that come from one source: when some are late, those whose own delay is not known are, too.
        repair: whether to shift them.
    """
    log, found = _check_drift(log, repair=repair)
    pairs = []
    grid = make_grid(log)
    step = grid.step
    forward = "vx" if "vx" in grid.channels else "speed"
    one_source = True if any({"vy", forward} <= set(source) for source in sources) else None
    side = sideways_delays(grid, 0.5 * step, together=one_source)
    for relation, delay in find_delays(log):
        if not relation.timed:
            text = (
                f"{relation.measured} is {1e3 * abs(delay.value):.3g} ± {2e3 * delay.sigma:.2g} ms "
                f"{'late' if delay.value > 0.0 else 'early'} against what "
                f"{', '.join(relation.others)} give; vy is not logged, and its change is a part of this: not shifted"
            )
            name = f"{relation.measured}, {_clock_of(relation)}"
            found.append(Finding(log.name, "delay", name, "info", delay.value, "s", text))
            continue
        if relation.measured == "lateral_acceleration" and side is not None:
            arm = abs(side.arm) > 4.0 * side.arm_sigma
            if arm and not side.acceleration:
                if abs(delay.value) > max(0.25 * step, 5.0 * delay.sigma):
                    text = (
                        f"the accelerometer sits {abs(side.arm):.3g} ± {2.0 * side.arm_sigma:.2g} m "
                        f"{'ahead of' if side.arm > 0.0 else 'behind'} the point whose velocity is logged: this fits "
                        f"better than a delay of {1e3 * delay.value:.3g} ms"
                    )
                    found.append(Finding(log.name, "place", relation.measured, "warning", side.arm, "m", text))
                continue
            if side.velocity and not side.acceleration:
                continue
            if arm or side.velocity:  # else the pair by itself tells more exactly
                delay = delay._replace(value=side.acceleration, sigma=max(side.sigmas[0], 1e-4), drift=0.0)
        pairs.append((relation, delay))
    late = _lateness(pairs, 0.25 * step, _ties(side, forward), sources)
    if "x" in late:
        late["y"] = late["x"]
    along = _along(late, sources, pairs, 0.25 * step)
    late |= along
    moved = {name: value for name, value in late.items() if abs(value) > 0.25 * step}
    for relation, delay in pairs:
        sure = abs(delay.value) > max(0.25 * step, 5.0 * delay.sigma)
        behind = "late" if delay.value > 0.0 else "early"
        other = _clock_of(relation)
        text = (
            f"{relation.measured} is {1e3 * abs(delay.value):.3g} ± {2e3 * delay.sigma:.2g} ms {behind} "
            f"against what {other} gives ({abs(delay.value) / step:.3g} samples, correlation {delay.correlation:.3f})"
        )
        shifted = [name for name in (relation.measured, other) if name in moved]
        shifted += ["y"] if "x" in shifted else []
        shifted += ["vy"] if "vy" in moved and "yaw_rate" in shifted else []
        done = "shifted " + ", ".join(f"{name} by {-1e3 * moved[name]:+.3g} ms" for name in shifted) if shifted else ""
        severity: Severity = "warning" if sure else "info"
        name = f"{relation.measured}, {other}"
        found.append(
            Finding(log.name, "delay", name, severity, delay.value, "s", text, done if repair and sure else "")
        )
    for name, value in along.items():
        text = f"{name} changes on the same rows as what is {1e3 * value:.3g} ms late: it comes from the same source"
        done = f"shifted by {-1e3 * value:+.3g} ms" if repair else ""
        found.append(Finding(log.name, "delay", name, "warning", value, "s", text, done))
    if side is not None and side.velocity and "vy" not in along:
        text = (
            f"vy is {1e3 * abs(side.velocity):.3g} ± {2e3 * side.sigmas[1]:.2g} ms "
            f"{'late' if side.velocity > 0.0 else 'early'} against what lateral_acceleration and yaw_rate give "
            f"({abs(side.velocity) / step:.3g} samples, correlation {side.correlation:.3f})"
        )
        text += f"; {forward} is as late" if side.together else ""
        shifted = [name for name in ("vy", forward, "yaw_rate", "lateral_acceleration") if name in moved]
        shifted = shifted if {"vy", "yaw_rate"} & set(shifted) else []
        done = "shifted " + ", ".join(f"{name} by {-1e3 * moved[name]:+.3g} ms" for name in shifted) if shifted else ""
        name = "vy, lateral_acceleration"
        found.append(Finding(log.name, "delay", name, "warning", side.velocity, "s", text, done if repair else ""))
    return (_moved(log, moved) if repair else log), found


def _check_drift(log: Log, *, repair: bool) -> tuple[Log, list[Finding]]:
    """Clocks that go at different rates; the repair stretches the channels that do not go with the steering."""
    grid, span = make_grid(log), float(np.ptp(log.time))
    seen = [(relation.measured, _clock_of(relation), delay) for relation, delay in find_delays(log) if relation.timed]
    sure = [one for one in seen if _drifts(one[2], span, grid.step)]
    if not sure:
        return log, []
    ties = [
        (first, second, delay.drift if _drifts(delay, span, grid.step) else 0.0, delay.drift_sigma)
        for first, second, delay in seen
    ]
    steer = next((name for name in STEERING if name in grid.channels), None)
    if steer is not None and "yaw_rate" in grid.channels:
        answer = delay_of(grid.channels["yaw_rate"], grid.channels[steer], grid.step)
        other = max((one[2].drift for one in sure), key=abs)
        if answer is not None and abs(answer.correlation) > 0.7:
            # Whether the yaw rate drifts away from the steering as those two do, or stays with it: what is nearer.
            drift = answer.drift
            near = min((0.0, other, -other), key=lambda rate: abs(rate - drift))
            ties.append(("yaw_rate", steer, near, max(answer.drift_sigma, 1e-6)))
    rates = _levelled(ties, 1e-6, (), steer)
    moved = {name: rate for name, rate in rates.items() if abs(rate) * span > grid.step}
    if "x" in moved:
        moved["y"] = moved["x"]
    done = ", ".join(f"{name} stretched by {-100.0 * rate:+.3g} %" for name, rate in sorted(moved.items()))
    found = []
    for first, second, delay in sure:
        text = f"the delay of {first} against {second} changes by {1e6 * delay.drift:.3g} µs each second: two clocks"
        repaired = done if repair and {first, second} & set(moved) else ""
        found.append(Finding(log.name, "drift", f"{first}, {second}", "fault", delay.drift, "s/s", text, repaired))
    if not repair:
        return log, found
    begin = log.time - log.time[0]
    return _moved(log, {name: rate * begin for name, rate in moved.items()}), found


def _drifts(delay: Delay, span: float, step: float) -> bool:
    """Whether a delay changes by more than a step, surely."""
    return abs(delay.drift) > 7.0 * delay.drift_sigma and abs(delay.drift) * span > step


def _ties(side: Sideways | None, forward: str) -> list[tuple[str, str, float, float]]:
    """How late vy is behind the yaw rate, and the speed behind vy where both have one clock."""
    if side is None:
        return []
    ties = [("vy", "yaw_rate", side.velocity, max(side.sigmas[1], 1e-4))]
    if side.velocity and not side.acceleration:
        ties.append(("lateral_acceleration", "yaw_rate", 0.0, 1e-4))
    return ties + ([(forward, "vy", 0.0, 1e-4)] if side.together and side.velocity else [])


def _along(
    late: Mapping[str, float],
    sources: Sequence[Collection[str]],
    pairs: Sequence[tuple[Relation, Delay]],
    least: float,
) -> dict[str, float]:
    """How late channels are of a source whose others are late [s], where their own relations do not tell."""
    sharp: set[str] = set()
    for relation, delay in pairs:
        ends = {relation.measured, _clock_of(relation)}
        for group in sources:
            if not ends <= set(group) and 5.0 * delay.sigma < max(abs(delay.value), least):
                sharp |= ends
    found: dict[str, float] = {}
    for group in sources:
        known = [late[name] for name in group if name in sharp and name in late]
        if not known or max(known) - min(known) > least or abs(known[0]) <= least:
            continue
        value = float(np.mean(known))
        found |= dict.fromkeys(sorted(set(group) - sharp), value)
    return found


def _moved(log: Log, late: Mapping[str, float | Array]) -> Log:
    """A log in which channels are so much earlier, as a number or for each row (n) [s]."""
    channels = dict(log.channels)
    for name, value in late.items():
        good = np.isfinite(channels[name])
        curve = np.interp(log.time + value, log.time[good], channels[name][good], left=np.nan, right=np.nan)
        channels[name] = np.where(good, curve, np.nan)
    return replace(log, channels=channels)


def check_response(log: Log) -> list[Finding]:
    """How late the yaw rate is behind the steering: the response of the car and the delay of the channels together."""
    grid, found = make_grid(log), []
    for name in STEERING:
        if name in grid.channels and "yaw_rate" in grid.channels:
            delay = delay_of(grid.channels["yaw_rate"], grid.channels[name], grid.step)
            if delay is not None and abs(delay.correlation) > 0.7:
                text = f"the yaw rate follows {name} by {1e3 * delay.value:.3g} ms, with the response of the vehicle"
                found.append(Finding(log.name, "response", f"yaw_rate, {name}", "info", delay.value, "s", text))
    return found


def _clock_of(relation: Relation) -> str:
    """The channel of the right side that has its timing: the one that is differentiated, or turns."""
    return "yaw_rate" if "yaw_rate" in relation.others else relation.others[0]


def _lateness(
    pairs: list[tuple[Relation, Delay]],
    least: float,
    more: Sequence[tuple[str, str, float, float]] = (),
    sources: Sequence[Collection[str]] = (),
) -> dict[str, float]:
    """How late each channel is [s] against the clock of most of those that it is tied to; a source counts as one.

    Args:
        pairs: relations and their delays; one that is not sure ties its channels, too.
        least: what is less than this is no difference [s].
        more: ties beside the relations: a channel, the one that it is late against, how late, and how sure that is [s].
        sources: channels that come from one source.
    """
    ties = [
        (
            relation.measured,
            _clock_of(relation),
            delay.value if abs(delay.value) > 5.0 * delay.sigma else 0.0,
            delay.sigma,
        )
        for relation, delay in pairs
    ]
    return _levelled([*ties, *more], least, sources)


def _levelled(
    ties: Sequence[tuple[str, str, float, float]],
    least: float,
    sources: Sequence[Collection[str]] = (),
    lead: str | None = None,
) -> dict[str, float]:
    """Values of channels from their differences, zero for most of those that are tied together, or for the `lead`."""
    names = sorted({name for first, second, _, _ in ties for name in (first, second)})
    if not names:
        return {}
    matrix, right = np.zeros((len(ties), len(names))), np.zeros(len(ties))
    groups = {name: name for name in names}
    for row, (first, second, value, sigma) in enumerate(ties):
        scale = 1.0 / max(sigma, 0.01 * least)
        matrix[row, names.index(first)], matrix[row, names.index(second)] = scale, -scale
        right[row] = value * scale
        old, new = groups[second], groups[first]
        groups = {name: new if group == old else group for name, group in groups.items()}
    solved = np.linalg.lstsq(matrix, right, rcond=None)[0]
    levelled: dict[str, float] = {}
    for group in set(groups.values()):
        members = {name: float(solved[names.index(name)]) for name in names if groups[name] == group}
        values = np.array(sorted(members.values()))
        share = {name: 1.0 / len(source) for source in sources for name in source}
        others = [
            sum(share.get(name, 1.0) for name, own in members.items() if abs(own - value) > least) for value in values
        ]
        zero = members[lead] if lead in members else float(values[int(np.argmin(others))])
        levelled |= {name: value - zero for name, value in members.items()}
    return levelled


def smooth(grid: Grid, name: str) -> Array:
    """A channel of a grid without its fast noise (n)."""
    return np.asarray(gaussian_filter1d(grid.channels[name], max(1.0, SMOOTHING / grid.step)))
