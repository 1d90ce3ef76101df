"""Plausibility of units, signs, sample time and gravity by the kinematic relations of a log."""

from dataclasses import replace

import numpy as np
from scipy.optimize import lsq_linear

from mirdrake.core.constants import GRAVITY
from mirdrake.identification.alignment import estimate_delay, smooth
from mirdrake.identification.channels import channel
from mirdrake.identification.data import Log
from mirdrake.identification.evidence import is_certain, likelihood_gain, required_gain
from mirdrake.identification.findings import Finding, Severity, statement
from mirdrake.identification.lateral_delays import MAX_SCALE
from mirdrake.identification.relations import (
    Gain,
    Grid,
    estimate_gain,
    explain_gains,
    kinematic_relations,
    make_grid,
    step_factor,
)
from mirdrake.identification.timing import MAX_STEP, MIN_STEP, median_step

IMPOSSIBLE = 30.0
"""Lateral acceleration that no tyre on a road can hold [m/s²]."""

STANDSTILL = 0.05
"""Speed below which a vehicle is at rest [m/s]."""

MIN_CORRELATION, SCALE_RANGE = 0.85, (0.6, 1.6)
"""Correlation above which the change of vy is known, and the range of its scale that is accepted."""

SIGN_ODDS = 1e3
"""Prior odds against a wrong sign [1]."""

LARGEST_DELAY = 0.2
"""Largest delay of vy that is an alternative to a wrong sign [s]."""

MIN_OPPOSITE = 0.5
"""Least correlation of a wrong sign: that of a delayed response to fast steering may be negative, too."""

MIN_MOVING, SPEED_RATIO = 1.0, (0.5, 2.0)
"""Time in motion that shows the ratio of speed and vx [s], and the range of the ratio that is accepted [1]."""

MIN_EXCHANGED, MAX_EXCHANGED = 0.9, 0.5
"""Correlation with speed times yaw rate from which on an acceleration is the lateral one, and up to which it is not."""

_CLOCKS = {"in ms": 1e-3, "in µs": 1e-6, "in ns": 1e-9}

STEERING = ("road_wheel_angle", "steering_wheel_angle", "steering_command")


def estimate_gains(log: Log, *, use_vy: bool = True) -> list[Gain]:
    """Return the gains of the sufficiently correlated relations of a log; `use_vy` as in kinematic_relations."""
    grid = make_grid(log)
    gains = [estimate_gain(relation, grid) for relation in kinematic_relations(grid.channels, use_vy=use_vy)]
    return [gain for gain in gains if gain is not None and abs(gain.correlation) > 0.7]


def check_step(log: Log, *, repair: bool) -> tuple[Log, list[Finding]]:
    """Compare the true step with the stated one, by all relations with a derivative."""
    gains = estimate_gains(log, use_vy=False)
    factor = step_factor(gains)
    step = median_step(log.time)
    if factor is None:
        if MIN_STEP <= step <= MAX_STEP:
            return log, []
        return log, [Finding(log.name, "sample_time", "", "fault", step, "s", statement("unknown_step", step=step))]
    # The relations that the factor was derived from, as its reasons.
    timed = [gain for gain in gains if gain.relation.derivative and abs(gain.correlation) > 0.8]
    reasons = "; ".join(f"{gain.relation} give {1.0 / gain.gain:.4g}" for gain in timed)
    clock = next((unit for unit, size in _CLOCKS.items() if abs(factor / size - 1.0) < 0.05), "")
    text = statement("true_step", step=factor * step, factor=factor, stated=step, reasons=reasons, clock=clock)
    done = statement("scaled_time", factor=factor) if repair else None
    finding = Finding(log.name, "sample_time", "", "fault", factor * step, "s", text, done)
    return (replace(log, time=log.time[0] + factor * (log.time - log.time[0])) if repair else log), [finding]


def check_speed(log: Log) -> list[Finding]:
    """Find a speed that is not that of vx: its size differs, whether or not it follows vx."""
    if not {"speed", "vx"} <= log.channels.keys():
        return []
    grid = make_grid(log)
    speed, forward = (np.abs(smooth(grid, name)) for name in ("speed", "vx"))
    moving = forward > max(STANDSTILL, 0.2 * float(np.max(forward)))
    if moving.sum() * grid.step < MIN_MOVING:
        return []
    ratio = float(np.median(speed[moving] / forward[moving]))
    # Sideslip enlarges the speed by 1 / cos β: 1.15 at 30 degrees. Between the limits it is left to the relations.
    if SPEED_RATIO[0] < ratio < SPEED_RATIO[1]:
        return []
    medians = {"speed": float(np.median(speed[moving])), "vx": float(np.median(forward[moving]))}
    text = statement("speed_ratio", **medians)
    return [Finding(log.name, "units", "speed, vx", "fault", ratio, "1", text)]


def exchanged_axes(log: Log) -> tuple[float, float] | None:
    """Return the correlations of longitudinal and lateral acceleration with speed times yaw rate if they are exchanged.

    This is the case if the first one follows it and the second one does not, as with a sensor turned by 90 degrees.
    """
    grid = make_grid(log)
    forward = "vx" if "vx" in grid.channels else "speed"
    if not {forward, "yaw_rate", "longitudinal_acceleration", "lateral_acceleration"} <= grid.channels.keys():
        return None
    names = (forward, "yaw_rate", "longitudinal_acceleration", "lateral_acceleration")
    speed, rate, ahead, side = (smooth(grid, name) for name in names)
    turn = speed * rate
    if min(float(np.std(values)) for values in (turn, ahead, side)) < 1e-9:
        return None
    along, across = (float(np.corrcoef(values, turn)[0, 1]) for values in (ahead, side))
    return (along, across) if abs(along) > MIN_EXCHANGED and abs(across) < MAX_EXCHANGED else None


def check_axes(log: Log) -> list[Finding]:
    """Find longitudinal and lateral accelerations that are exchanged."""
    found = exchanged_axes(log)
    if found is None:
        return []
    text = statement("exchanged_axes", longitudinal=found[0], lateral=found[1])
    names = "longitudinal_acceleration, lateral_acceleration"
    return [Finding(log.name, "units", names, "fault", found[0], "1", text)]


def check_relations(log: Log) -> list[Finding]:
    """Check scales and offsets of the relations, and find the mistakes that would explain those that do not hold."""
    findings, gains = check_speed(log) + check_axes(log), estimate_gains(log)
    for gain in gains:
        # 10 %: gravity in a pitching car alone changes the gain of its longitudinal relation by as much. Noise beside a
        # small motion changes it by more: a gain of 1 between the bounds is not excluded.
        low, high = gain.bounds
        off = abs(gain.gain - 1.0) > 0.1 and not (gain.gain > 0.0 and low < 1.0 < high)
        first, others = gain.relation.measured, ", ".join(gain.relation.others)
        text = statement(
            "scale", channel=first, gain=gain.gain, width=2.0 * gain.sigma, others=others, offset=gain.offset,
            unit=channel(first).unit,
        )  # fmt: skip
        severity: Severity = "warning" if off else "info"
        findings.append(Finding(log.name, "kinematics", str(gain.relation), severity, gain.gain, "1", text))
    mistakes, factor = explain_gains(gains, {name: channel(name).unit for name in log.channels})
    if factor is None and mistakes:
        words = " or by ".join(f"{mistake} of {name}" for name, mistake in mistakes)
        text = statement("mistakes", mistakes=words, signs_only=all(mistake == "wrong sign" for _, mistake in mistakes))
        names = ", ".join(dict.fromkeys(name for name, _ in mistakes))
        findings.append(Finding(log.name, "units", names, "fault", float(len(mistakes)), "mistakes", text))
    return findings


def check_steering(log: Log, wheelbase: float | None) -> list[Finding]:
    """Check sign, scale and bias of the steering against the yaw rate, where the tyres slip little."""
    grid = make_grid(log)
    findings: list[Finding] = []
    forward = "vx" if "vx" in grid.channels else "speed"
    if forward not in grid.channels or "yaw_rate" not in grid.channels:
        return findings
    speed, rate = smooth(grid, forward), smooth(grid, "yaw_rate")
    # A product that no tyre can hold shows a wrong unit of speed or yaw rate, even without a second relation.
    largest = float(np.percentile(np.abs(speed * rate), 99.0))
    if largest > IMPOSSIBLE:
        text = statement("impossible_turn", value=largest)
        findings.append(Finding(log.name, "units", f"{forward}, yaw_rate", "fault", largest, "m/s^2", text))
    # Slow enough for its size: far below the limit of the tyres.
    calm = (np.abs(speed) > min(1.0, 0.2 * float(np.max(np.abs(speed))))) & (np.abs(speed * rate) < 3.0)
    # At higher speed the tyres slip by more than the steering turns, so the scale is uncertain without slow turns.
    slow = calm & (speed**2 < 4.0 * GRAVITY * (wheelbase or 0.0))
    is_slow = bool(slow.sum() > 0.2 * calm.sum() and slow.sum() >= 50)
    rows = slow if is_slow else calm
    for name in STEERING:
        if name in grid.channels:
            findings += _check_steering_channel(log, grid, name, (speed[rows], rate[rows], rows), wheelbase, is_slow)
    return findings


def steering_sign(log: Log, name: str) -> float | None:
    """Return the partial correlation of a steering channel with the yaw rate; None if it is unknown or too small."""
    grid = make_grid(log)
    forward = "vx" if "vx" in grid.channels else "speed"
    if not {forward, "yaw_rate", name} <= set(grid.channels):
        return None
    value = _steering_correlation(*(smooth(grid, channel) for channel in (forward, name, "yaw_rate")))
    return value if value is not None and abs(value) > MIN_OPPOSITE else None


def _check_steering_channel(
    log: Log,
    grid: Grid,
    name: str,
    calm: tuple[np.ndarray, np.ndarray, np.ndarray],
    wheelbase: float | None,
    is_slow: bool,
) -> list[Finding]:
    """Check one steering channel; `calm` are speed, yaw rate and the mask of the rows in which tyres slip little."""
    findings: list[Finding] = []
    speed, rate, rows = calm
    whole = smooth(grid, name)
    angle = whole[rows]
    if len(angle) < 50 or np.std(angle) == 0.0 or np.std(rate) == 0.0:
        return findings
    # Sign first: it does not depend on the scale or the wheelbase.
    correlation = _steering_correlation(speed, angle, rate)
    if correlation is None:
        return findings
    if correlation < -MIN_OPPOSITE:
        text = statement("steering_sign", channel=name, correlation=correlation)
        findings.append(Finding(log.name, "units", name, "fault", correlation, "1", text))
    unit = channel(name).unit
    # A bias must exceed both 1 % of the range and its own uncertainty.
    bias, spread = _steering_bias(speed, _aligned(grid, name, whole)[rows], rate)
    if abs(bias) > max(0.01 * float(np.ptp(np.percentile(whole, (1, 99)))), 4.0 * spread, 1e-9):
        text = statement("steering_bias", channel=name, bias=bias, sigma=spread, unit=unit)
        findings.append(Finding(log.name, "bias", name, "warning", bias, unit, text))

    # The scale over the wheelbase, or as a length without one.
    base = np.column_stack((speed * angle, speed))
    # r = v (g δ - b): kinematic steering of the calm rows, in which tyre slip is neglected.
    gain = float(np.linalg.lstsq(base, rate, rcond=None)[0][0])
    # Without a wheelbase only ratio times wheelbase is known, a length.
    scale = 1.0 / gain if wheelbase is None else gain * wheelbase
    is_odd = wheelbase is not None and _is_odd(name, scale, is_slow)
    mistake = None if wheelbase is None else _steering_mistake(name, scale, is_slow)
    if mistake is not None and abs(correlation) > 0.8:
        text = statement("mistakes", mistakes=f"{mistake} of {name}", signs_only=False)
        findings.append(Finding(log.name, "units", name, "fault", scale, "1", text))
    text = statement("steering_scale", channel=name, scale=scale, length=wheelbase is None, odd=is_odd)
    unit = "m" if wheelbase is None else "1"
    severity: Severity = "warning" if is_odd else "info"
    findings.append(Finding(log.name, "kinematics", f"yaw_rate, {name}", severity, scale, unit, text))
    return findings


def _steering_correlation(speed: np.ndarray, angle: np.ndarray, rate: np.ndarray) -> float | None:
    """Return the partial correlation of yaw rate and steering beside ``v`` and ``v³``, which a constant steering gives.

    None without evidence for an effect: sign and scale of a constant or merely noisy steering are not identifiable.
    """
    beside = np.column_stack((speed, speed**3))
    pair = np.column_stack((rate, speed * (angle - angle.mean())))
    # Both sides without what v and v³ explain; the correlation of the rest is the partial correlation.
    left, right = (pair - beside @ np.linalg.lstsq(beside, pair, rcond=None)[0]).T
    if np.std(left) == 0.0 or np.std(right) == 0.0:
        return None
    gain, effective = likelihood_gain(left, left - (left @ right) / (right @ right) * right)
    return float(np.corrcoef(left, right)[0, 1]) if gain > required_gain(effective, SIGN_ODDS) else None


def _is_odd(name: str, scale: float, is_slow: bool) -> bool:
    """Whether the scale of a steering channel over the wheelbase is unusual."""
    if name == "steering_wheel_angle":
        return not 3.0 < abs(1.0 / scale) < 60.0
    return name == "road_wheel_angle" and not (0.5 if is_slow else 0.1) < abs(scale) < 1.25


def _steering_mistake(name: str, scale: float, is_slow: bool) -> str | None:
    """Return the mistake that would make an implausible angle plausible; None if there is none.

    Args:
        name: name of the channel.
        scale: yaw rate over speed · angle / wheelbase [1].
        is_slow: whether this was measured where the tyres slip little.
    """
    if name == "steering_command":
        return None
    hand = name == "steering_wheel_angle"
    low, high = (1.0 / 40.0, 1.0 / 4.0) if hand else (0.5 if is_slow else 0.1, 1.3)
    if low < abs(scale) < high:
        return None
    # The mistake is named only if it would make the scale plausible.
    turn = 180.0 / np.pi
    fits = {"deg as rad": abs(scale) * turn, "rad as deg": abs(scale) / turn}
    return next((mistake for mistake, size in fits.items() if low < size < high), None)


def _aligned(grid: Grid, name: str, angle: np.ndarray) -> np.ndarray:
    """Return the steering shifted to the yaw rate: a delay looks like an offset when turns to one side are faster."""
    delay = estimate_delay(grid.channels["yaw_rate"], grid.channels[name], grid.step)
    if delay is None or abs(delay.correlation) < 0.7:
        return angle
    rows = np.arange(float(len(angle)))
    return np.asarray(np.interp(rows - delay.value / grid.step, rows, angle))


def _steering_bias(speed: np.ndarray, angle: np.ndarray, rate: np.ndarray) -> tuple[float, float]:
    """Return the angle of straight driving and its standard deviation, from ``r = v (g δ / (1 + K v²) - b)``."""
    base = np.column_stack((speed * angle, speed, speed**3 * angle))
    size = np.linalg.norm(base, axis=0)
    if np.any(size == 0.0) or np.linalg.cond(base / size) > 50.0:
        base = base[:, :2]
    solved = np.linalg.lstsq(base, rate, rcond=None)[0]
    rest, blocks = rate - base @ solved, np.array_split(np.arange(len(rate)), 10)
    # Scatter of the bias over parts of the log: the residuals are correlated, so their number is not a measure.
    parts = [float(speed[rows] @ rest[rows]) / float(speed[rows] @ speed[rows]) for rows in blocks]
    return -float(solved[1] / solved[0]), float(np.std(parts) / np.sqrt(9.0) / abs(solved[0]))


def check_gyro_bias(log: Log) -> list[Finding]:
    """Find rates that are not zero at standstill: the bias of a gyro."""
    grid, findings = make_grid(log), []
    forward = "vx" if "vx" in grid.channels else "speed"
    if forward not in grid.channels:
        return []
    # At standstill a gyro shows its bias alone; 0.003 rad/s are 0.17 deg/s.
    rest = np.abs(smooth(grid, forward)) < STANDSTILL
    if rest.sum() > max(20, 0.5 / grid.step):
        for name in ("yaw_rate", "roll_rate", "pitch_rate"):
            if name in grid.channels:
                value = float(np.median(grid.channels[name][rest]))
                if abs(value) > 0.003:
                    text = statement("gyro_bias", value=value)
                    findings.append(Finding(log.name, "bias", name, "warning", value, "rad/s", text))
    return findings


def check_velocity_position(log: Log) -> list[Finding]:
    """Estimate the position ahead of the rear axle at which the lateral velocity is measured, from slow turns.

    There ``vy = r (d - c vx²)``, with the slip of the rear tyres in c.
    """
    grid = make_grid(log)
    forward = "vx" if "vx" in grid.channels else "speed"
    if not {"vy", "yaw_rate", forward} <= set(grid.channels):
        return []
    speed, rate, side = smooth(grid, forward), smooth(grid, "yaw_rate"), smooth(grid, "vy")
    calm = (np.abs(speed) > 0.2) & (np.abs(speed * rate) < 3.0)
    width = max(4, round(0.5 / grid.step))
    # Rows half a second apart, nearly independent, so that the variance below is that of ordinary least squares.
    rows = np.flatnonzero(calm)[::width]
    if len(rows) < 15:
        return []
    base = np.column_stack((rate[rows], -rate[rows] * speed[rows] ** 2))
    size = np.linalg.norm(base, axis=0)
    if np.any(size == 0.0) or np.linalg.cond(base / size) > 20.0:
        return []
    solved = np.linalg.lstsq(base, side[rows], rcond=None)[0]
    variance = float(np.sum((side[rows] - base @ solved) ** 2)) / (len(rows) - 2)
    sigma = float(np.sqrt(variance * np.linalg.inv(base.T @ base)[0, 0]))
    # Slip of the rear tyres moves the point without lateral motion forward with speed; the opposite is an artefact.
    if sigma > 0.3 or solved[1] < 0.0:
        return []
    text = statement("velocity_position", distance=float(solved[0]), sigma=sigma)
    return [Finding(log.name, "sensor_position", "vy", "info", float(solved[0]), "m", text)]


def check_lateral_velocity(log: Log) -> list[Finding]:
    """Compare the change of vy with lateral acceleration and yaw rate.

    ``ay - vx r = g (dvy/dt + d dr/dt) + s vx r`` holds with g = 1 + s for an accelerometer d ahead on a body that rolls
    such that it measures s of the acceleration more, and with h dp/dt for one h lower at the roll rate p. A wrong step
    and a wrong scale of vy look alike here, so neither is assumed. Other relations with a derivative may exclude the
    step.
    """
    grid = make_grid(log)
    # The relation is ay = dvy/dt + v r, plus the acceleration of the sensor's position, proportional to dr/dt.
    forward = "vx" if "vx" in grid.channels else "speed"
    if not {"vy", "yaw_rate", "lateral_acceleration", forward} <= set(grid.channels):
        return []
    rate, side = grid.channels["yaw_rate"], grid.channels["lateral_acceleration"]
    whirl = grid.channels[forward] * rate
    # Means over 0.2 s suppress the noise that the derivative amplifies.
    width = max(4, round(0.2 / grid.step))
    count = len(rate) // width
    if count < 40:
        return []

    def means(values: np.ndarray) -> np.ndarray:
        return np.asarray(values[: count * width].reshape(count, width).mean(axis=1))

    # Partial regression: offset, v r, dr/dt and dp/dt (position of the sensor) are removed from both sides. If no roll
    # rate is logged, the roll is taken to follow v r, so that its acceleration is the second derivative.
    roll_rate = grid.channels["roll_rate"] if "roll_rate" in grid.channels else grid.rate(whirl)
    beside = np.column_stack((np.ones(count), *map(means, (whirl, grid.rate(rate), grid.rate(roll_rate)))))
    both = np.column_stack((means(side - whirl), means(grid.rate(grid.channels["vy"]))))
    if (evidence := _opposite_velocity(grid, forward, width)) is not None:
        text = statement("velocity_sign", correlation=evidence)
        return [Finding(log.name, "units", "vy", "fault", evidence, "1", text)]
    known = np.linalg.lstsq(beside, both, rcond=None)[0]
    rest = both - beside @ known
    if np.any(np.std(rest, axis=0) == 0.0):
        return []
    correlation = float(np.corrcoef(rest.T)[0, 1])
    if correlation < MIN_CORRELATION:
        return []
    # v r may carry a part of the gain as well, which is removed here.
    gain = float(rest[:, 0].var() / (rest[:, 0] @ rest[:, 1] / count))  # the noise is in the derivative
    gain /= 1.0 + float(known[1, 0] - gain * known[1, 1])
    if SCALE_RANGE[0] < gain < SCALE_RANGE[1]:
        return []
    # With another step, the gains of all relations with a derivative would be this one.
    timed = [other for other in estimate_gains(log, use_vy=False) if other.relation.derivative]
    is_step = all(other.bounds[0] < gain < other.bounds[1] for other in timed)
    text = statement("lateral_velocity", gain=gain, true_step=grid.step / gain, step=grid.step, is_step=is_step)
    return [Finding(log.name, "kinematics", "vy, lateral_acceleration", "warning", gain, "1", text)]


def check_path_direction(log: Log) -> list[Finding]:
    """Check whether the path turns to the same side as the yaw rate, which determines the signs of x and y."""
    grid = make_grid(log)
    forward = "vx" if "vx" in grid.channels else "speed"
    if not {"x", "y", "yaw_rate", forward} <= set(grid.channels):
        return []
    width = max(3, round(0.5 / grid.step))
    x, y = grid.channels["x"][::width], grid.channels["y"][::width]
    # Sideslip changes slowly, so the course of the path turns as fast as the vehicle yaws.
    course = np.unwrap(np.arctan2(np.diff(y), np.diff(x)))
    turned = np.cumsum(grid.channels["yaw_rate"])[::width] * grid.step
    fast = grid.channels[forward][::width][1:-1] > 2.0
    path, own = np.diff(course)[fast], (0.5 * (turned[2:] - turned[:-2]))[fast]
    if fast.sum() < 10 or np.std(path) == 0.0 or np.ptp(own) < 0.02:
        return []
    correlation = float(np.corrcoef(path, own)[0, 1])
    if correlation > -0.5:
        return []
    text = statement("path_direction", correlation=correlation)
    return [Finding(log.name, "units", "x, y", "fault", correlation, "1", text)]


def _opposite_velocity(grid: Grid, forward: str, width: int) -> float | None:
    """Return the correlation of ay - vx r with dvy/dt if vy has the wrong sign; None without evidence for it.

    Both signs are hypotheses with equal freedom, so noise of the derivative favours neither. With the right sign vy
    or the acceleration may have a delay.

    Args:
        grid: a log.
        forward: channel of the speed.
        width: rows of the means that suppress the noise of the derivative.
    """
    rate, side = grid.channels["yaw_rate"], grid.channels["lateral_acceleration"]
    rise, whirl = grid.rate(grid.channels["vy"]), grid.channels[forward] * rate
    reach = int(np.ceil(LARGEST_DELAY / grid.step))
    count = (len(rate) - 2 * reach) // width

    def means(values: np.ndarray, shift: int = 0) -> np.ndarray:
        first = reach + shift
        return np.asarray(values[first : first + count * width].reshape(count, width).mean(axis=1))

    beside = np.column_stack((np.ones(count), means(whirl), means(grid.rate(rate))))
    # The accelerometer has a small error of its scale only; position and offset are free.
    bounds = ([-np.inf, -MAX_SCALE, -np.inf], [np.inf, MAX_SCALE, np.inf])

    def residual(sign: float, velocity_shift: int = 0, acceleration_shift: int = 0) -> np.ndarray:
        left = means(side, acceleration_shift) - means(whirl) - sign * means(rise, velocity_shift)
        return np.asarray(left - beside @ lsq_linear(beside, left, bounds).x)

    opposite = residual(-1.0)
    # A delayed channel is the alternative; it need not be searched for where even the plain sign fits as well.
    if not is_certain(*likelihood_gain(residual(1.0), opposite), SIGN_ODDS):
        return None
    lags = np.unique(np.linspace(-reach, reach, 21).astype(int)).tolist()
    delayed = [residual(1.0, lag, 0) for lag in lags] + [residual(1.0, 0, lag) for lag in lags]
    right = min(delayed, key=lambda rest: float(rest @ rest))
    if not is_certain(*likelihood_gain(right, opposite), SIGN_ODDS):
        return None
    return float(np.corrcoef(means(side) - means(whirl), means(rise))[0, 1])


def check_gravity(log: Log) -> list[Finding]:
    """Find gravity in accelerometers: an offset at standstill, or a part that follows roll and pitch."""
    grid, findings = make_grid(log), []
    forward = "vx" if "vx" in grid.channels else "speed"
    if forward in grid.channels:
        # At standstill an accelerometer shows nothing but gravity; above 0.15 m/s² it is more than an offset of usual
        # sensors.
        rest = np.abs(smooth(grid, forward)) < STANDSTILL
        for name in ("longitudinal_acceleration", "lateral_acceleration"):
            if name in grid.channels and rest.sum() > max(10, 0.5 / grid.step):
                value = float(np.median(grid.channels[name][rest]))
                if abs(value) > 0.15:
                    tilt = float(np.degrees(np.arcsin(np.clip(value / GRAVITY, -1.0, 1.0))))
                    text = statement("gravity_at_rest", value=value, tilt=abs(tilt))
                    findings.append(Finding(log.name, "gravity", name, "warning", value, "m/s^2", text))
    for relation in kinematic_relations(grid.channels):
        # Axes of ISO 8855: roll to the right raises the left side and adds +g sin φ to ay; pitch down adds -g sin θ to
        # ax.
        tilts = {"lateral_acceleration": ("roll", 1.0), "longitudinal_acceleration": ("pitch", -1.0)}
        name, sign = tilts.get(relation.measured, ("", 1.0))
        if name not in grid.channels or np.std(grid.channels[name]) < 2e-3:
            continue
        part = _tilt_part(grid, relation.left(grid), relation.right(grid), np.sin(grid.channels[name]))
        # Close to g and well above its uncertainty: otherwise it is a correlation by chance.
        if part is not None and abs(part[0]) > 5.0 * part[1] and 0.7 * GRAVITY < abs(part[0]) < 1.3 * GRAVITY:
            text = statement(
                "gravity_with_tilt", part=part[0], sigma=part[1], angle=name, opposite=part[0] * sign < 0.0
            )
            findings.append(
                Finding(log.name, "gravity", f"{relation.measured}, {name}", "warning", part[0], "m/s^2", text)
            )
    return findings


def _tilt_part(grid: Grid, left: np.ndarray, right: np.ndarray, sine: np.ndarray) -> tuple[float, float] | None:
    """Return the part of sin(tilt) in a relation and its standard deviation, from means over half a second."""
    width = max(4, round(0.5 / grid.step))
    count = len(right) // width
    if count < 12:
        return None

    def means(values: np.ndarray) -> np.ndarray:
        return np.asarray(values[: count * width].reshape(count, width).mean(axis=1))

    # Three unknowns: part of the tilt, scale of the relation, and offset.
    base = np.column_stack((means(sine), means(right), np.ones(count)))
    if np.linalg.cond(base / np.maximum(np.linalg.norm(base, axis=0), 1e-12)) > 50.0:
        return None  # tilt proportional to the acceleration itself, as roll in a turn, is not separable from a scale
    target = means(left)
    solved = np.linalg.lstsq(base, target, rcond=None)[0]
    variance = float(np.sum((target - base @ solved) ** 2)) / (count - 3)
    return float(solved[0]), float(np.sqrt(variance * np.linalg.inv(base.T @ base)[0, 0]))
