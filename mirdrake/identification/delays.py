"""Delays of channels, estimated from all logs of a data set together, and clocks of different rates."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from mirdrake.identification.alignment import (
    DELAY_ODDS,
    SMOOTHING,
    Delay,
    pair_delays,
    slack,
    steering_response,
)
from mirdrake.identification.clocks import Response, Tie, solve_ties
from mirdrake.identification.data import Array, Log
from mirdrake.identification.evidence import is_certain, likelihood_gain
from mirdrake.identification.findings import Finding, Severity, Statement, statement
from mirdrake.identification.lateral_delays import LateralDelays, estimate_lateral_delays
from mirdrake.identification.relations import Grid, Relation, make_grid

SIGNIFICANT = 5.0
"""Standard deviations within which a delay of zero is certain."""

Pairs = list[tuple[Relation, Delay]]


@dataclass(frozen=True)
class _Evidence:
    """Evidence about delays from all logs of one recorder.

    Attributes:
        grids: the logs.
        pairs: relations and their delays.
        lateral: delays of the lateral channels, if they are measured.
        sources: channels that come from one source.
        clock: channel without delay, by the data file.
    """

    grids: Sequence[Grid]
    pairs: Pairs
    lateral: LateralDelays | None
    sources: Sequence[Collection[str]]
    clock: str | None

    @property
    def response(self) -> Response | None:
        """Delay of the yaw rate behind the steering, by the log that determines it best."""
        found = [(delay[1], grid) for grid in self.grids if (delay := steering_response(grid)) is not None]
        if not found:
            return None
        best, grid = min(found, key=lambda pair: pair[0].sigma)
        return Response("yaw_rate", best.value, slack(best, grid.step))

    @property
    def step(self) -> float:
        """Coarsest step [s]."""
        return max(grid.step for grid in self.grids)

    @property
    def forward(self) -> str:
        """Channel of the speed."""
        return "vx" if all("vx" in grid.channels for grid in self.grids) else "speed"


def check_delays(
    logs: Sequence[Log], sources: Sequence[Collection[str]] = (), *, repair: bool, clock: str | None = None
) -> tuple[list[Log], list[Finding]]:
    """Find channels with a delay; the repair shifts as few as possible.

    A recorder has the same delays in every log: they are estimated from all logs together, and all logs are shifted
    alike. Logs of another recorder need a data file of their own.

    Args:
        logs: logs of one vehicle.
        sources: channels that come from one source: if some have a delay, those whose delay is unknown have it, too.
        repair: whether to shift them.
        clock: channel without delay; None for the choice of :mod:`mirdrake.identification.clocks`.
    """
    # Drifting clocks first: a delay that changes has no value.
    all_findings: list[Finding] = []
    shifted_logs, grids, pairs = [], [], []
    for log in logs:
        grid = make_grid(log)
        own = pair_delays(grid)
        log, drifts = _check_drift(log, grid, own, repair=repair, clock=clock)
        # Stretching a clock changes all delays of its channels, so they are estimated again.
        if any(drift.done for drift in drifts):
            grid = make_grid(log)
            own = pair_delays(grid)
        all_findings += drifts
        shifted_logs.append(log)
        grids.append(grid)
        pairs.append(own)

    # Logs of one recorder have the same delays, which are estimated from all of them.
    evidence = _Evidence(grids, _pooled(pairs), _lateral_delays(grids, sources), sources, clock)
    shifts, findings = _delays(evidence, repair=repair, together=len(logs) > 1)
    for index, log in enumerate(shifted_logs):
        all_findings += [
            replace(finding, log=log.name) for finding in findings if set(finding.channels) <= set(log.channels)
        ]
        own_shifts = {name: value for name, value in shifts.items() if name in log.channels}
        shifted_logs[index] = _shifted(log, own_shifts) if repair else log
    return shifted_logs, all_findings


def _lateral_delays(grids: Sequence[Grid], sources: Sequence[Collection[str]]) -> LateralDelays | None:
    forward = "vx" if all("vx" in grid.channels for grid in grids) else "speed"
    # Channels that change on the same rows have one clock; without such evidence the residuals decide.
    one_source = True if any({"vy", forward} <= set(source) for source in sources) else None
    return estimate_lateral_delays(grids, together=one_source)


def _pooled(pairs: Sequence[Pairs]) -> Pairs:
    """Return the delay of each pair, from all logs that have it, weighted by their precision."""
    by_name: dict[str, Pairs] = {}
    for own in pairs:
        for relation, delay in own:
            by_name.setdefault(str(relation), []).append((relation, delay))
    pooled = []
    for same_relation in by_name.values():
        relation, first = same_relation[0]
        if len(same_relation) > 1:
            # Weighted mean by precision. The scatter between the logs replaces its uncertainty where it is larger.
            precision = np.array([max(delay.sigma, 1e-6) ** -2 for _, delay in same_relation])
            values = np.array([delay.value for _, delay in same_relation])
            share = precision / precision.sum()
            mean = float(share @ values)
            between = float(np.sqrt(share @ (values - mean) ** 2 / (len(same_relation) - 1)))
            # Delays that differ from log to log gain less together than each by itself.
            common = mean**2 / max(float(share @ values**2), 1e-300)
            first = Delay(
                mean, max(float(precision.sum() ** -0.5), between), 0.0, 0.0,
                float(share @ np.array([delay.correlation for _, delay in same_relation])),
                common * sum(delay.gain for _, delay in same_relation),
                sum(delay.effective for _, delay in same_relation),
            )  # fmt: skip
        pooled.append((relation, first))
    return pooled


def _delays(evidence: _Evidence, *, repair: bool, together: bool) -> tuple[dict[str, float], list[Finding]]:
    """Return the delays of the channels to shift [s], and the findings, not yet assigned to a log."""
    threshold = 0.25 * evidence.step
    timed = [(relation, delay) for relation, delay in evidence.pairs if relation.timed]
    # The lateral acceleration has a model of its own, as a delay and another position of the sensor look alike.
    pairs = [pair for pair in timed if pair[0].measured != "lateral_acceleration"]

    # Each channel's delay against most of the others, then that of channels from the same source.
    delays = solve_ties(
        _pair_ties(pairs) + _lateral_ties(evidence), threshold,
        sources=evidence.sources, clock=evidence.clock, response=evidence.response,
    )  # fmt: skip
    # Both coordinates come from one receiver.
    if "x" in delays:
        delays["y"] = delays["x"]
    of_source = _delays_of_sources(delays, evidence.sources, pairs, threshold)
    delays |= of_source
    shifts = {name: value for name, value in delays.items() if abs(value) > threshold}

    def shifted(names: Collection[str]) -> Statement | None:
        """Return the repair of these channels; None if none is shifted."""
        texts = [f"{name} by {-1e3 * shifts[name]:+.3g} ms" for name in names if name in shifts]
        words = ", estimated from all logs together" if together else ""
        own = {name: shifts[name] for name in names if name in shifts}
        return statement("shifted", shifts=", ".join(texts), together=words, **own) if repair and texts else None

    # Without vy, ay leads vx r by the change of vy: such pairs have a delay even with one clock.
    findings = [_ambiguous_finding(relation, delay) for relation, delay in evidence.pairs if not relation.timed]
    findings += [_pair_finding(relation, delay, evidence.step, shifts, shifted) for relation, delay in pairs]
    for name, value in of_source.items():
        text = statement("common_source", channel=name, delay=value)
        findings.append(Finding("", "delay", name, "warning", value, "s", text, shifted([name])))
    return shifts, findings + _lateral_findings(evidence, of_source, shifts, shifted)


def _ambiguous_finding(relation: Relation, delay: Delay) -> Finding:
    other = _timing_channel(relation)
    text = statement(
        "ambiguous_delay", channel=relation.measured, other=", ".join(relation.others), delay=delay.value,
        sigma=delay.sigma,
    )  # fmt: skip
    return Finding("", "delay", f"{relation.measured}, {other}", "info", delay.value, "s", text)


def _lateral_findings(
    evidence: _Evidence,
    of_source: Collection[str],
    shifts: Mapping[str, float],
    shifted: Callable[[Collection[str]], Statement | None],
) -> list[Finding]:
    """Return the findings about delays of vy and the lateral acceleration, and the position of the accelerometer."""
    lateral = evidence.lateral
    if lateral is None:
        return []
    findings = []
    # Four deviations; with a delay of the acceleration the position of the sensor cannot be distinguished from it.
    if abs(lateral.arm) > 4.0 * lateral.arm_sigma and not lateral.acceleration:
        text = statement("accelerometer_position", distance=lateral.arm, sigma=lateral.arm_sigma)
        name = "lateral_acceleration"
        findings.append(Finding("", "sensor_position", name, "warning", lateral.arm, "m", text))
    delays = (
        ("lateral_acceleration", lateral.acceleration, "yaw_rate"),
        ("vy", lateral.velocity, "lateral_acceleration"),
    )
    for index, (channel, delay, other) in enumerate(delays):
        if channel in of_source:
            # A delay that a common source explains is reported there, once.
            continue
        if not delay:
            if (ends := lateral.limits[index]) is not None:
                # A delay that is not found may still be there.
                low, high = ends
                text = statement("no_delay", channel=channel, low=low, high=high)
                largest = max(abs(low), abs(high))
                findings.append(Finding("", "delay_limit", f"{channel}, yaw_rate", "info", largest, "s", text))
            continue
        speed = evidence.forward if channel == "vy" and lateral.together else ""
        text = statement(
            "relative_delay", channel=channel, other="lateral_acceleration and yaw_rate" if channel == "vy" else other,
            delay=delay, sigma=lateral.sigmas[index], step=evidence.step, correlation=lateral.correlation, speed=speed,
        )  # fmt: skip
        # A channel that was shifted already is reported as corrected.
        names = {"vy": ("vy", evidence.forward, "yaw_rate", "lateral_acceleration")}.get(channel, (channel, "yaw_rate"))
        done = shifted(names) if {channel, "yaw_rate"} & set(shifts) else None
        findings.append(Finding("", "delay", f"{channel}, {other}", "warning", delay, "s", text, done))
    return findings


def _pair_finding(
    relation: Relation,
    delay: Delay,
    step: float,
    shifts: Mapping[str, float],
    shifted: Callable[[Collection[str]], Statement | None],
) -> Finding:
    """Return the finding about one pair of channels."""
    other = _timing_channel(relation)
    is_significant = delay.is_likely and abs(delay.value) > 0.25 * step
    text = statement(
        "relative_delay", channel=relation.measured, other=other, delay=delay.value, sigma=delay.sigma, step=step,
        correlation=delay.correlation,
    )  # fmt: skip
    # Channels that are shifted along, so that the finding names the whole repair.
    names = [name for name in (relation.measured, other) if name in shifts]
    names += ["y"] if "x" in names else []
    names += ["vy"] if "vy" in shifts and "yaw_rate" in names else []
    done = shifted(names) if is_significant else None
    severity: Severity = "warning" if is_significant else "info"
    return Finding("", "delay", f"{relation.measured}, {other}", severity, delay.value, "s", text, done)


def _check_drift(log: Log, grid: Grid, pairs: Pairs, *, repair: bool, clock: str | None) -> tuple[Log, list[Finding]]:
    """Find clocks of different rates; the repair stretches channels with another clock than the steering."""
    span = float(np.ptp(log.time))
    seen = [(relation.measured, _timing_channel(relation), delay) for relation, delay in pairs if relation.timed]
    drifting = [
        (relation.measured, _timing_channel(relation), delay)
        for relation, delay in pairs
        if relation.timed and _drifts(delay, span, grid.step) and _is_shown(relation, delay, grid)
    ]
    if not drifting:
        return log, []
    ties = [
        Tie(first, second, delay.drift if _drifts(delay, span, grid.step) else 0.0, delay.drift_sigma)
        for first, second, delay in seen
    ]
    # Relations between sensors cannot show which clock is right; the steering, the input of the model, decides.
    steered = steering_response(grid)
    if steered is not None:
        steer, response = steered
        other = max((pair[2].drift for pair in drifting), key=abs)
        # Either the yaw rate drifts away from the steering as those two do, or it stays with it: the nearer one.
        near = min((0.0, other, -other), key=lambda rate: abs(rate - response.drift))
        ties.append(Tie("yaw_rate", steer, near, max(response.drift_sigma, 1e-6)))
        clock = clock or steer
    rates = solve_ties(ties, 1e-6, clock=clock, one_sided=False)
    # A drift that stays below a sample over the whole log is not worth interpolating all its values.
    stretched = {name: rate for name, rate in rates.items() if abs(rate) * span > grid.step}
    if "x" in stretched:
        stretched["y"] = stretched["x"]
    words = ", ".join(f"{name} stretched by {-100.0 * rate:+.3g} %" for name, rate in sorted(stretched.items()))
    findings = []
    for first, second, delay in drifting:
        text = statement("clock_drift", channel=first, other=second, drift=delay.drift)
        done = statement("stretched", channels=words) if repair and {first, second} & set(stretched) else None
        findings.append(Finding(log.name, "clock_drift", f"{first}, {second}", "fault", delay.drift, "s/s", text, done))
    if not repair:
        return log, findings
    begin = log.time - log.time[0]
    return _shifted(log, {name: rate * begin for name, rate in stretched.items()}), findings


def _is_shown(relation: Relation, delay: Delay, grid: Grid) -> bool:
    """Whether the residuals of a relation show a delay that drifts.

    The alternatives are a constant delay, none, and the further terms of the relation: an accelerometer ahead of the
    reference has an apparent delay d / v, which changes with the speed like a drift.
    """
    width = max(1.0, SMOOTHING / grid.step)
    beside = [] if relation.beside is None else relation.beside(grid)
    left, right, *beside = (
        gaussian_filter1d(values, width) for values in (relation.left(grid), relation.right(grid), *beside)
    )
    time = grid.step * np.arange(len(left))

    def residual(shift: float, drift: float = 0.0) -> Array:
        moved = np.interp(time - shift - drift * (time - time.mean()), time, right)
        base = np.column_stack((moved, grid.rate(moved), *beside, np.ones(len(time))))
        return np.asarray(left - base @ np.linalg.lstsq(base, left, rcond=None)[0])

    constant = min((residual(0.0), residual(delay.value)), key=lambda rest: float(rest @ rest))
    return is_certain(*likelihood_gain(constant, residual(delay.value, delay.drift)), DELAY_ODDS)


def _drifts(delay: Delay, span: float, step: float) -> bool:
    """Whether a delay changes significantly, and by more than a step."""
    return abs(delay.drift) > 7.0 * delay.drift_sigma and abs(delay.drift) * span > step


def _pair_ties(pairs: Pairs) -> list[Tie]:
    """Return the ties by pairs of channels; an insignificant delay ties them with zero."""
    return [
        Tie(relation.measured, _timing_channel(relation), delay.value if delay.is_likely else 0.0, delay.sigma)
        for relation, delay in pairs
    ]


def _lateral_ties(evidence: _Evidence) -> list[Tie]:
    """Return the ties of vy to the yaw rate, and of the speed to vy where both have one clock."""
    lateral = evidence.lateral
    if lateral is None:
        return []
    ties = [
        Tie("vy", "yaw_rate", lateral.velocity, max(lateral.sigmas[1], 1e-4)),
        Tie("lateral_acceleration", "yaw_rate", lateral.acceleration, max(lateral.sigmas[0], 1e-4)),
    ]
    if lateral.together and lateral.velocity:
        ties.append(Tie(evidence.forward, "vy", 0.0, 1e-4))
    return ties


def _delays_of_sources(
    delays: Mapping[str, float], sources: Sequence[Collection[str]], pairs: Pairs, least: float
) -> dict[str, float]:
    """Return the delays that channels without a decisive relation share with the others of their source [s]."""
    decided: set[str] = set()
    for relation, delay in pairs:
        # A relation within one source shows nothing about the delay of the source itself.
        ends = {relation.measured, _timing_channel(relation)}
        for group in sources:
            if not ends <= set(group) and (delay.is_likely or SIGNIFICANT * delay.sigma < least):
                decided |= ends
    values: dict[str, float] = {}
    for group in sources:
        known = [delays[name] for name in group if name in decided and name in delays]
        # Members with different delays do not share a clock.
        if not known or max(known) - min(known) > least or abs(known[0]) <= least:
            continue
        value = float(np.mean(known))
        values |= dict.fromkeys(sorted(set(group) - decided), value)
    return values


def _shifted(log: Log, delays: Mapping[str, float | Array]) -> Log:
    """Return a log with channels moved to earlier times, by a number or a value for each row (n) [s]."""
    channels = dict(log.channels)
    for name, value in delays.items():
        # No extrapolation beyond the ends, and rows without a value stay so: interpolation would invent measurements.
        good = np.isfinite(channels[name])
        curve = np.interp(log.time + value, log.time[good], channels[name][good], left=np.nan, right=np.nan)
        channels[name] = np.where(good, curve, np.nan)
    return replace(log, channels=channels)


def _timing_channel(relation: Relation) -> str:
    """Return the channel of the right side that determines its timing: the differentiated one, or the yaw rate."""
    return "yaw_rate" if "yaw_rate" in relation.others else relation.others[0]
