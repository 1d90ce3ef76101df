"""Which channels of a data set are late, found from all its logs together, and two clocks of different rates."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from mirdrake.identification.alignment import STEERING, Delay, estimate_delay, pair_delays
from mirdrake.identification.data import Array, Log
from mirdrake.identification.findings import Finding, Severity
from mirdrake.identification.lateral_delays import CONTRADICTS, LateralDelays, contradict, estimate_lateral_delays
from mirdrake.identification.relations import Grid, Relation, make_grid
from mirdrake.identification.slip_delay import SlipDelay, slip_delay

APART = 3.0
"""So far an accelerometer may sit from the place whose velocity is logged [m]."""

Pairs = list[tuple[Relation, Delay]]


def check_delays(
    logs: Sequence[Log], sources: Sequence[Collection[str]] = (), *, wheelbase: float | None = None, repair: bool
) -> tuple[list[Log], list[Finding]]:
    """Channels that are late against others; their repair shifts as few as possible.

    One recorder has the same delays in every drive: they are found from all logs together, and all are shifted alike.
    Only logs that contradict each other are taken one by one.

    Args:
        logs: of one vehicle.
        sources: channels that come from one source: when some are late, those whose own delay is not known are, too.
        wheelbase: with it, vy is compared with the tyres where no lateral acceleration is logged [m].
        repair: whether to shift them.
    """
    found: list[Finding] = []
    mended, grids, pairs = [], [], []
    for log in logs:
        grid = make_grid(log)
        own = pair_delays(grid)
        log, seen = _check_drift(log, grid, own, repair=repair)
        if any(one.repair for one in seen):
            grid = make_grid(log)
            own = pair_delays(grid)
        found += seen
        mended.append(log)
        grids.append(grid)
        pairs.append(own)
    together = _side_of(grids, sources)
    coarsest = max(grid.step for grid in grids)
    one_recorder = _agree(pairs, 0.5 * coarsest, together) and not contradict(grids, together)
    groups = [range(len(logs))] if one_recorder else [range(at, at + 1) for at in range(len(logs))]
    for group in groups:
        members = [grids[at] for at in group]
        side = together if len(group) == len(logs) else _side_of(members, sources)
        by_tyres = None
        if wheelbase and not any("lateral_acceleration" in grid.channels for grid in members):
            by_tyres = slip_delay(members, wheelbase)
        known = _pooled([pairs[at] for at in group])
        moved, told = _late_channels(members, known, side, by_tyres, sources, repair=repair)
        for at in group:
            log = mended[at]
            for one in told:
                if set(one.channel.split(", ")) <= set(log.channels):
                    text = one.text + (", by all drives together" if len(group) > 1 else "")
                    found.append(replace(one, log=log.name, text=text))
            late = {name: value for name, value in moved.items() if name in log.channels}
            mended[at] = _moved(log, late) if repair else log
    return mended, found


def _side_of(grids: Sequence[Grid], sources: Sequence[Collection[str]]) -> LateralDelays | None:
    forward = "vx" if all("vx" in grid.channels for grid in grids) else "speed"
    one_source = True if any({"vy", forward} <= set(source) for source in sources) else None
    return estimate_lateral_delays(grids, 0.5 * max(grid.step for grid in grids), together=one_source)


def _agree(pairs: Sequence[Pairs], least: float, side: LateralDelays | None) -> bool:
    """Whether no log contradicts what all tell of a pair.

    An accelerometer in another place looks late or early, by its distance over the speed: where vy tells, it is asked.
    """
    pooled = {str(relation): delay.value for relation, delay in _pooled(pairs)}
    return all(
        abs(delay.value - pooled[str(relation)]) < max(least, CONTRADICTS, 5.0 * delay.sigma)
        for own in pairs
        for relation, delay in own
        if relation.timed and (side is None or relation.measured != "lateral_acceleration")
    )


def _pooled(pairs: Sequence[Pairs]) -> Pairs:
    """The delay of each pair, from all logs that have it."""
    by_name: dict[str, Pairs] = {}
    for own in pairs:
        for relation, delay in own:
            by_name.setdefault(str(relation), []).append((relation, delay))
    found = []
    for seen in by_name.values():
        relation, first = seen[0]
        if len(seen) > 1:
            share = np.array([max(delay.sigma, 1e-6) ** -2 for _, delay in seen])
            values = np.array([delay.value for _, delay in seen])
            share = share / share.sum()
            mean = float(share @ values)
            within = float(np.sqrt(1.0 / np.sum([max(delay.sigma, 1e-6) ** -2 for _, delay in seen])))
            between = float(np.sqrt(share @ (values - mean) ** 2 / (len(seen) - 1)))
            correlation = float(share @ np.array([delay.correlation for _, delay in seen]))
            first = Delay(mean, max(within, between), 0.0, 0.0, correlation)
        found.append((relation, first))
    return found


def _late_channels(
    grids: Sequence[Grid],
    known: Pairs,
    side: LateralDelays | None,
    by_tyres: SlipDelay | None,
    sources: Sequence[Collection[str]],
    *,
    repair: bool,
) -> tuple[dict[str, float], list[Finding]]:
    """How late channels are [s], those that are to be shifted; and findings, which have no log yet."""
    found: list[Finding] = []
    pairs = []
    step = max(grid.step for grid in grids)
    forward = "vx" if all("vx" in grid.channels for grid in grids) else "speed"
    for relation, delay in known:
        if not relation.timed:
            text = (
                f"{relation.measured} is {1e3 * abs(delay.value):.3g} ± {2e3 * delay.sigma:.2g} ms "
                f"{'late' if delay.value > 0.0 else 'early'} against what "
                f"{', '.join(relation.others)} give; vy is not logged, and its change is a part of this: not shifted"
            )
            name = f"{relation.measured}, {_clock_of(relation)}"
            found.append(Finding("", "delay", name, "info", delay.value, "s", text))
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
                    found.append(Finding("", "place", relation.measured, "warning", side.arm, "m", text))
                continue
            if side.velocity and not side.acceleration:
                continue
            if arm or side.velocity:  # else the pair by itself tells more exactly
                delay = delay._replace(value=side.acceleration, sigma=max(side.sigmas[0], 1e-4), drift=0.0)
        pairs.append((relation, delay))
    ties = _ties(side, forward)
    if by_tyres is not None and abs(by_tyres.value) > by_tyres.least:
        ties.append(("vy", "yaw_rate", by_tyres.value, 0.25 * by_tyres.least))
    late = _lateness(pairs, 0.25 * step, ties, sources)
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
        found.append(Finding("", "delay", name, severity, delay.value, "s", text, done if repair and sure else ""))
    for name, value in along.items():
        text = f"{name} changes on the same rows as what is {1e3 * value:.3g} ms late: it comes from the same source"
        done = f"shifted by {-1e3 * value:+.3g} ms" if repair else ""
        found.append(Finding("", "delay", name, "warning", value, "s", text, done))
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
        found.append(Finding("", "delay", name, "warning", side.velocity, "s", text, done if repair else ""))
    if by_tyres is not None:
        found += _told_by_tyres(by_tyres, moved, repair=repair)
    return moved, found


def _told_by_tyres(by_tyres: SlipDelay, moved: Mapping[str, float], *, repair: bool) -> list[Finding]:
    """What the rear tyres say of vy, if that is more than half of what they may make up."""
    value, least = by_tyres
    if abs(value) < 0.5 * least:
        return []
    text = (
        f"vy is about {1e3 * abs(value):.2g} ms {'late' if value > 0.0 else 'early'} against yaw_rate, if the rear "
        f"tyres slip as those of a single track; up to {1e3 * least:.2g} ms, the wheelbase over the speed, may be the "
        "vehicle itself"
    )
    if abs(value) <= least:
        text += ": not shifted; lateral_acceleration would tell"
        return [Finding("", "delay", "vy, yaw_rate", "info", value, "s", text)]
    shifted = [name for name in ("vy", "yaw_rate") if name in moved]
    done = "shifted " + ", ".join(f"{name} by {-1e3 * moved[name]:+.3g} ms" for name in shifted)
    return [Finding("", "delay", "vy, yaw_rate", "warning", value, "s", text, done if repair and shifted else "")]


def _check_drift(log: Log, grid: Grid, pairs: Pairs, *, repair: bool) -> tuple[Log, list[Finding]]:
    """Clocks that go at different rates; the repair stretches the channels that do not go with the steering."""
    span, hidden = float(np.ptp(log.time)), _drift_of_place(grid)
    seen = [(relation.measured, _clock_of(relation), delay) for relation, delay in pairs if relation.timed]
    sure = [
        (first, second, delay)
        for first, second, delay in seen
        if _drifts(delay, span, grid.step) and (first != "lateral_acceleration" or abs(delay.drift) > hidden)
    ]
    if not sure:
        return log, []
    ties = [
        (first, second, delay.drift if _drifts(delay, span, grid.step) else 0.0, delay.drift_sigma)
        for first, second, delay in seen
    ]
    steer = next((name for name in STEERING if name in grid.channels), None)
    if steer is not None and "yaw_rate" in grid.channels:
        answer = estimate_delay(grid.channels["yaw_rate"], grid.channels[steer], grid.step)
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


def _drift_of_place(grid: Grid) -> float:
    """How fast the delay d / v of an accelerometer in another place may change with the speed [s/s]."""
    speed = grid.channels.get("vx", grid.channels.get("speed"))
    if speed is None:
        return 0.0
    typical = float(np.median(np.abs(speed)))
    slowness = 1.0 / np.maximum(np.abs(speed), max(0.3 * typical, 1e-3))
    time = grid.step * np.arange(len(speed))
    return APART * abs(float(np.polyfit(time - time.mean(), slowness, 1)[0]))


def _drifts(delay: Delay, span: float, step: float) -> bool:
    """Whether a delay changes by more than a step, surely."""
    return abs(delay.drift) > 7.0 * delay.drift_sigma and abs(delay.drift) * span > step


def _ties(side: LateralDelays | None, forward: str) -> list[tuple[str, str, float, float]]:
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
