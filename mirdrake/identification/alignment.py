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

LONGEST = 0.6
"""Delays are sought up to this [s]."""

SMOOTHING = 0.05
"""Standard deviation of the Gaussian that both sides pass before they are compared [s]; it shifts nothing."""

LEVELS = 4
"""The comparison is made with that smoothing, twice, four times, …; the one that is surest counts."""

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


def check_delays(
    log: Log, sources: Sequence[Collection[str]] = (), *, repair: bool, second: bool = False
) -> tuple[Log, list[Finding]]:
    """Channels that are late against others; their repair shifts as few as possible.

    Args:
        log: the log.
        sources: channels that come from one source: when some are late, those whose own delay is not known are, too.
        repair: whether to shift them.
        second: the delay of vy is known and taken out.
    """
    given = log
    pairs, found = [], []
    grid = make_grid(log)
    step = grid.step
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
        arm = _lever_arm(grid, relation, delay)
        if arm is None:
            pairs.append((relation, delay))
            continue
        text = (
            f"the accelerometer sits {abs(arm):.3g} m {'ahead of' if arm > 0.0 else 'behind'} the point whose velocity "
            f"is logged: this fits better than a delay of {1e3 * delay.value:.3g} ms"
        )
        found.append(Finding(log.name, "place", relation.measured, "warning", arm, "m", text))
    late = _lateness(pairs, 0.25 * step, "vy" in log.channels, sources)
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
        if abs(delay.drift) > 7.0 * delay.drift_sigma and abs(delay.drift) * np.ptp(log.time) > step:
            text = f"the delay of {relation.measured} against {other} changes by {1e6 * delay.drift:.3g} µs each second"
            found.append(Finding(log.name, "drift", name, "fault", delay.drift, "s/s", text + ": two clocks"))
    for name, value in along.items():
        text = f"{name} changes on the same rows as what is {1e3 * value:.3g} ms late: it comes from the same source"
        done = f"shifted by {-1e3 * value:+.3g} ms" if repair else ""
        found.append(Finding(log.name, "delay", name, "warning", value, "s", text, done))
    log = _moved(log, moved) if repair else log
    if "vy" in along:
        return log, found
    side = None if second else _sideways_delay(make_grid(log))
    if side is None or side.correlation < 0.7 or abs(side.value) < max(0.5 * step, 6.0 * side.sigma):
        return log, found
    # A late vy stands in the lateral acceleration, too: once more, with a vy that is not.
    log, found = check_delays(_moved(given, {"vy": side.value}), sources, repair=repair, second=True)
    rest = _sideways_delay(make_grid(log))
    value = side.value + (rest.value if rest is not None else 0.0)
    text = (
        f"vy is {1e3 * abs(value):.3g} ± {2e3 * side.sigma:.2g} ms {'late' if value > 0.0 else 'early'} "
        f"against what lateral_acceleration and yaw_rate give ({abs(value) / step:.3g} samples, correlation "
        f"{side.correlation:.3f})"
    )
    done = f"shifted vy by {-1e3 * value:+.3g} ms" if repair else ""
    found.append(Finding(log.name, "delay", "vy, lateral_acceleration", "warning", value, "s", text, done))
    return (_moved(log, {"vy": value - side.value}) if repair else given), found


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


def _moved(log: Log, late: Mapping[str, float]) -> Log:
    """A log in which channels are so much earlier [s]."""
    channels = dict(log.channels)
    for name, value in late.items():
        good = np.isfinite(channels[name])
        curve = np.interp(log.time + value, log.time[good], channels[name][good], left=np.nan, right=np.nan)
        channels[name] = np.where(good, curve, np.nan)
    return replace(log, channels=channels)


def _sideways_delay(grid: Grid) -> Delay | None:
    """How late vy is behind the lateral acceleration and the yaw rate; None: they do not tell.

    ``dvy/dt = ay - vx r + d dr/dt`` is a small difference of large numbers, which roll and scales spoil; so it is
    compared with the best ``c1 ay + c2 vx r + c3 dr/dt + c4`` at each delay.
    """
    forward = "vx" if "vx" in grid.channels else "speed"
    if not {"vy", "yaw_rate", "lateral_acceleration", forward} <= set(grid.channels):
        return None
    best = None
    for factor in (1.0, 2.0, 4.0):
        found = _sideways_at(grid, forward, max(2.0, factor * SMOOTHING / grid.step))
        if found is not None and (best is None or found.sigma < 0.7 * best.sigma):
            best = found
    return best


def _sideways_at(grid: Grid, forward: str, width: float) -> Delay | None:
    """The same, with a smoothing over so many rows."""
    thin = max(1, int(0.5 * width))
    step = float(thin * grid.step)
    reach = int(0.5 * LONGEST / step) + 1

    def soft(values: Array) -> Array:
        return np.asarray(gaussian_filter1d(values, width, mode="nearest")[::thin])

    side = np.gradient(soft(grid.channels["vy"]), step)
    if len(side) < 2 * reach + 200 or np.ptp(side) == 0.0:
        return None
    turn = grid.channels["yaw_rate"]
    parts = [soft(grid.channels["lateral_acceleration"]), soft(turn * grid.channels[forward])]
    base = np.column_stack((*parts, np.gradient(soft(turn), step), np.ones(len(side))))[reach:-reach]
    if np.linalg.cond(base / np.maximum(np.linalg.norm(base, axis=0), 1e-12)) > 200.0:
        return None
    frame = np.linalg.qr(base)[0]
    likeness = []
    for ahead in range(2 * reach + 1):
        part = side[ahead : ahead + len(base)]
        likeness.append(float(np.sum((frame.T @ part) ** 2) / np.sum(part**2)))
    lag = float(np.argmax(likeness))
    curve, rows = CubicSpline(np.arange(len(side)), side), np.arange(len(base), dtype=float)
    for _ in range(20):
        if not 1.0 <= lag <= 2.0 * reach - 1.0:
            return None
        gains = np.linalg.lstsq(base, curve(rows + lag), rcond=None)[0]
        model = base @ gains
        slope, rest = np.gradient(model), curve(rows + lag) - model
        change = -float(slope @ rest) / max(float(slope @ slope), 1e-300)
        lag += float(np.clip(change, -1.0, 1.0))
        if abs(change) < 1e-4:
            break
    # ay and vx r must enter as they do in kinematics: else what is alike is something else.
    if not (0.5 < gains[0] < 1.5 and -1.5 < gains[1] < -0.5):
        return None
    blocks = np.array_split(np.arange(len(base)), BLOCKS)
    weights = np.array([float(slope[part] @ slope[part]) for part in blocks])
    shares = weights / weights.sum()
    away = np.array([-float(slope[part] @ rest[part]) for part in blocks]) / np.maximum(weights, 1e-300)
    enough = 1.0 / float(np.sum(shares**2))
    if enough < 3.0:
        return None
    sigma = step * float(np.sqrt(np.sum(shares * away**2) / (enough - 1.0)))
    return Delay(step * (lag - reach), sigma, 0.0, np.inf, float(np.corrcoef(model, model + rest)[0, 1]))


def check_response(log: Log) -> list[Finding]:
    """How late the yaw rate is behind the steering: the response of the car and the delay of the channels together."""
    grid, found = make_grid(log), []
    for name in ("road_wheel_angle", "steering_wheel_angle", "steering_command"):
        if name in grid.channels and "yaw_rate" in grid.channels:
            delay = delay_of(grid.channels["yaw_rate"], grid.channels[name], grid.step)
            if delay is not None and abs(delay.correlation) > 0.7:
                text = f"the yaw rate follows {name} by {1e3 * delay.value:.3g} ms, with the response of the vehicle"
                found.append(Finding(log.name, "response", f"yaw_rate, {name}", "info", delay.value, "s", text))
    return found


def _lever_arm(grid: Grid, relation: Relation, delay: Delay) -> float | None:
    """How far the accelerometer sits ahead [m], when that explains the lateral acceleration better than a delay."""
    if relation.measured != "lateral_acceleration" or abs(delay.value) < max(0.25 * grid.step, 5.0 * delay.sigma):
        return None
    width = max(1.0, SMOOTHING / grid.step)
    right, turn = relation.right(grid), grid.rate(grid.channels["yaw_rate"])
    target = gaussian_filter1d(grid.channels[relation.measured], width)
    base = np.column_stack((gaussian_filter1d(right, width), gaussian_filter1d(turn, width), np.ones(len(right))))
    solved = np.linalg.lstsq(base, target, rcond=None)[0]
    rest = float(np.var(target - base @ solved))
    return float(solved[1] / solved[0]) if rest < (1.0 - delay.correlation**2) * float(np.var(target)) else None


def _clock_of(relation: Relation) -> str:
    """The channel of the right side that has its timing: the one that is differentiated, or turns."""
    return "yaw_rate" if "yaw_rate" in relation.others else relation.others[0]


def _lateness(
    pairs: list[tuple[Relation, Delay]], least: float, sideways: bool, sources: Sequence[Collection[str]] = ()
) -> dict[str, float]:
    """How late each channel is [s] against the clock of most of those that it is tied to; a source counts as one.

    Args:
        pairs: relations and their delays; one that is not sure ties its channels, too.
        least: what is less than this is no difference [s].
        sources: channels that come from one source.
        sideways: there is a vy; its clock is that of the yaw rate, beside which it stands in the lateral acceleration.
    """
    ties = [(relation.measured, _clock_of(relation), delay.value, delay.sigma) for relation, delay in pairs]
    if sideways and any(relation.measured == "lateral_acceleration" for relation, _ in pairs):
        ties.append(("vy", "yaw_rate", 0.0, 1e-5))
    names = sorted({name for first, second, _, _ in ties for name in (first, second)})
    if not names:
        return {}
    matrix, right = np.zeros((len(ties), len(names))), np.zeros(len(ties))
    groups = {name: name for name in names}
    for row, (first, second, value, sigma) in enumerate(ties):
        scale = 1.0 / max(sigma, 1e-5)
        matrix[row, names.index(first)], matrix[row, names.index(second)] = scale, -scale
        right[row] = value * scale if abs(value) > 5.0 * sigma else 0.0
        old, new = groups[second], groups[first]
        groups = {name: new if group == old else group for name, group in groups.items()}
    solved = np.linalg.lstsq(matrix, right, rcond=None)[0]
    late: dict[str, float] = {}
    for group in set(groups.values()):
        members = {name: float(solved[names.index(name)]) for name in names if groups[name] == group}
        values = np.array(sorted(members.values()))
        share = {name: 1.0 / len(source) for source in sources for name in source}
        others = [
            sum(share.get(name, 1.0) for name, own in members.items() if abs(own - value) > least) for value in values
        ]
        late |= {name: value - float(values[int(np.argmin(others))]) for name, value in members.items()}
    return late


def smooth(grid: Grid, name: str) -> Array:
    """A channel of a grid without its fast noise (n)."""
    return np.asarray(gaussian_filter1d(grid.channels[name], max(1.0, SMOOTHING / grid.step)))
