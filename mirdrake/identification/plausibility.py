"""Units, signs, the step and gravity: what the relations of kinematics say of a log."""

from dataclasses import replace

import numpy as np

from mirdrake.core.constants import GRAVITY
from mirdrake.identification.alignment import estimate_delay, smooth
from mirdrake.identification.channels import channel
from mirdrake.identification.data import Log
from mirdrake.identification.findings import Finding
from mirdrake.identification.relations import (
    Gain,
    Grid,
    estimate_gain,
    explain_gains,
    kinematic_relations,
    make_grid,
    step_factor,
)
from mirdrake.identification.timing import LONGEST_STEP, SHORTEST_STEP, median_step

IMPOSSIBLE = 30.0
"""No tyre on a road holds such a lateral acceleration [m/s²]."""

STANDSTILL = 0.05
"""Slower than this a vehicle stands [m/s]."""

SWAYS, SWAY = 0.85, (0.6, 1.6)
"""Correlation from which on the change of vy is known, and between which factors it is right."""

_CLOCKS = {"in ms": 1e-3, "in µs": 1e-6, "in ns": 1e-9}

STEERING = ("road_wheel_angle", "steering_wheel_angle", "steering_command")


def estimate_gains(log: Log, *, sideways: bool = True) -> list[Gain]:
    """How the relations of a log hold, of those that move enough to tell; `sideways` as in kinematic_relations."""
    grid = make_grid(log)
    gains = [estimate_gain(relation, grid) for relation in kinematic_relations(grid.channels, sideways=sideways)]
    return [gain for gain in gains if gain is not None and abs(gain.correlation) > 0.7]


def check_step(log: Log, *, repair: bool) -> tuple[Log, list[Finding]]:
    """The true step against the stated one, from all relations that have a derivative in them."""
    gains = estimate_gains(log, sideways=False)
    factor = step_factor(gains)
    step = median_step(log.time)
    if factor is None:
        if SHORTEST_STEP <= step <= LONGEST_STEP:
            return log, []
        text = f"a step of {step:.4g} s is none of a recorder, and no channels tell the true one: give the clock's unit"
        return log, [Finding(log.name, "step", "", "fault", step, "s", text)]
    timed = [gain for gain in gains if gain.relation.derivative and abs(gain.correlation) > 0.8]
    text = f"the true step is {factor * step:.5g} s, {factor:.4g} times the stated {step:.5g} s: " + "; ".join(
        f"{gain.relation} say {1.0 / gain.gain:.4g}" for gain in timed
    )
    unit = next((unit for unit, size in _CLOCKS.items() if abs(factor / size - 1.0) < 0.05), None)
    text += "" if unit is None else f": a clock {unit}?"
    done = f"time multiplied by {factor:.5g}" if repair else ""
    found = Finding(log.name, "step", "", "fault", factor * step, "s", text, done)
    return (replace(log, time=log.time[0] + factor * (log.time - log.time[0])) if repair else log), [found]


def check_relations(log: Log) -> list[Finding]:
    """Scales and offsets of the relations, and the mistakes that would explain those that do not hold."""
    found, gains = [], estimate_gains(log)
    for gain in gains:
        off = abs(gain.gain - 1.0) > max(0.1, 4.0 * gain.sigma)
        first, others = gain.relation.measured, ", ".join(gain.relation.others)
        text = f"{first} is {gain.gain:.4g} ± {2.0 * gain.sigma:.2g} times what {others} give, {gain.offset:+.3g} "
        text += channel(first).unit
        found.append(
            Finding(log.name, "relation", str(gain.relation), "warning" if off else "info", gain.gain, "1", text)
        )
    mistakes, factor = explain_gains(gains, {name: channel(name).unit for name in log.channels})
    if factor is None and mistakes:
        text = "would be explained by: " + " or by ".join(f"{what} of {name}" for name, what in mistakes)
        names = ", ".join(dict.fromkeys(name for name, _ in mistakes))
        found.append(Finding(log.name, "units", names, "fault", float(len(mistakes)), "mistakes", text))
    return found


def check_steering(log: Log, wheelbase: float | None) -> list[Finding]:
    """Sign, scale and bias of the steering against the yaw rate, where the car runs with little slip."""
    grid = make_grid(log)
    found: list[Finding] = []
    forward = "vx" if "vx" in grid.channels else "speed"
    if forward not in grid.channels or "yaw_rate" not in grid.channels:
        return found
    speed, rate = smooth(grid, forward), smooth(grid, "yaw_rate")
    most = float(np.percentile(np.abs(speed * rate), 99.0))
    if most > IMPOSSIBLE:
        text = f"speed times yaw rate reaches {most:.3g} m/s^2, which no tyre holds: deg as rad, km/h as m/s?"
        found.append(Finding(log.name, "units", f"{forward}, yaw_rate", "fault", most, "m/s^2", text))
    for name in STEERING:
        if name not in grid.channels:
            continue
        angle = smooth(grid, name)
        # Slow enough for its size: a tenth of the highest speed, and far below the limit of the tyres.
        calm = (np.abs(speed) > min(1.0, 0.2 * float(np.max(np.abs(speed))))) & (np.abs(speed * rate) < 3.0)
        # Fast, the tyres slip by more than the steering turns: without slow bends the scale is not told.
        slow = calm & (speed**2 < 4.0 * GRAVITY * (wheelbase or 0.0))
        is_slow = bool(slow.sum() > 0.2 * calm.sum() and slow.sum() >= 50)
        calm = slow if is_slow else calm
        if calm.sum() < 50 or np.std(angle[calm]) == 0.0 or np.std(rate[calm]) == 0.0:
            continue
        curvature = rate[calm] / speed[calm]
        correlation = float(np.corrcoef(angle[calm], curvature)[0, 1])
        if abs(correlation) < 0.5:
            continue
        base = np.column_stack((speed[calm] * angle[calm], speed[calm]))
        solved = np.linalg.lstsq(base, rate[calm], rcond=None)[0]
        gain = float(solved[0])
        if correlation < 0.0:
            text = f"{name} to the left turns the vehicle to the right (correlation {correlation:.2f}): wrong sign"
            found.append(Finding(log.name, "units", name, "fault", correlation, "1", text))
        unit = channel(name).unit
        bias, spread = _steering_bias(speed[calm], _aligned(grid, name, angle)[calm], rate[calm])
        if abs(bias) > max(0.01 * float(np.ptp(np.percentile(angle, (1, 99)))), 4.0 * spread, 1e-9):
            shown = f"{bias:+.3g} ± {2.0 * spread:.2g}" + (f" {unit}" if unit != "1" else "")
            text = f"{name} is {shown} where the vehicle runs straight: estimate an offset"
            found.append(Finding(log.name, "bias", name, "warning", bias, unit, text))
        if wheelbase is not None:
            scale = gain * wheelbase
            text = f"the yaw rate is {scale:.3g} times speed · {name} / wheelbase"
            odd = name == "road_wheel_angle" and not (0.5 if is_slow else 0.1) < abs(scale) < 1.25
            if name == "steering_wheel_angle":
                text += f": a steering ratio of about {1.0 / scale:.3g}, with what the tyres slip"
                odd = not 3.0 < abs(1.0 / scale) < 60.0
                text += ": deg as rad, or the angle of the road wheels?" if odd else ""
            elif odd:
                text += ": deg as rad?" if abs(scale) < 0.05 else ": a scaled signal, or of the hand wheel?"
        else:
            scale, odd = 1.0 / gain, False
            text = f"the yaw rate is speed · {name} / {scale:.3g} m: wheelbase times ratio, and what the tyres slip"
        mistake = None if wheelbase is None else _steering_mistake(name, scale, is_slow)
        if mistake is not None and abs(correlation) > 0.8:
            explained = f"would be explained by: {mistake} of {name}"
            found.append(Finding(log.name, "units", name, "fault", scale, "1", explained))
        unit = "1" if wheelbase is not None else "m"
        found.append(
            Finding(log.name, "relation", f"yaw_rate, {name}", "warning" if odd else "info", scale, unit, text)
        )
    return found


def _steering_mistake(name: str, scale: float, is_slow: bool) -> str | None:
    """The mistake that makes an angle what wheels can do, when it is not as it is given; None: there is no such one.

    Args:
        name: of the channel.
        scale: yaw rate over speed · angle / wheelbase [1].
        is_slow: whether the tyres slip little where this was seen.
    """
    if name == "steering_command":
        return None
    hand = name == "steering_wheel_angle"
    low, high = (1.0 / 40.0, 1.0 / 4.0) if hand else (0.5 if is_slow else 0.1, 1.3)
    if low < abs(scale) < high:
        return None
    turn = 180.0 / np.pi
    fits = {"deg as rad": abs(scale) * turn, "rad as deg": abs(scale) / turn}
    return next((what for what, size in fits.items() if low < size < high), None)


def _aligned(grid: Grid, name: str, angle: np.ndarray) -> np.ndarray:
    """The steering as the yaw rate follows it: a delay looks like an offset when turns to one side are quicker."""
    delay = estimate_delay(grid.channels["yaw_rate"], grid.channels[name], grid.step)
    if delay is None or abs(delay.correlation) < 0.7:
        return angle
    rows = np.arange(float(len(angle)))
    return np.asarray(np.interp(rows - delay.value / grid.step, rows, angle))


def _steering_bias(speed: np.ndarray, angle: np.ndarray, rate: np.ndarray) -> tuple[float, float]:
    """The angle at which a vehicle runs straight, and its standard deviation, from ``r = v (g δ / (1 + K v²) - b)``."""
    base = np.column_stack((speed * angle, speed, speed**3 * angle))
    size = np.linalg.norm(base, axis=0)
    if np.any(size == 0.0) or np.linalg.cond(base / size) > 50.0:
        base = base[:, :2]
    solved = np.linalg.lstsq(base, rate, rcond=None)[0]
    rest, blocks = rate - base @ solved, np.array_split(np.arange(len(rate)), 10)
    parts = [float(speed[rows] @ rest[rows]) / float(speed[rows] @ speed[rows]) for rows in blocks]
    return -float(solved[1] / solved[0]), float(np.std(parts) / np.sqrt(9.0) / abs(solved[0]))


def check_gyro_bias(log: Log) -> list[Finding]:
    """Rates that are not zero while the vehicle stands: the bias of a gyro."""
    grid, found = make_grid(log), []
    forward = "vx" if "vx" in grid.channels else "speed"
    if forward not in grid.channels:
        return []
    rest = np.abs(smooth(grid, forward)) < STANDSTILL
    if rest.sum() > max(20, 0.5 / grid.step):
        for name in ("yaw_rate", "roll_rate", "pitch_rate"):
            if name in grid.channels:
                value = float(np.median(grid.channels[name][rest]))
                if abs(value) > 0.003:
                    text = f"reads {value:+.3g} rad/s at standstill: the bias of a gyro, estimate an offset"
                    found.append(Finding(log.name, "bias", name, "warning", value, "rad/s", text))
    return found


def check_velocity_position(log: Log) -> list[Finding]:
    """How far ahead of the rear axle the place is whose lateral velocity is logged, from slow bends.

    There ``vy = r (d - c vx²)``, with the slip of the rear tyres in c.
    """
    grid = make_grid(log)
    forward = "vx" if "vx" in grid.channels else "speed"
    if not {"vy", "yaw_rate", forward} <= set(grid.channels):
        return []
    speed, rate, side = smooth(grid, forward), smooth(grid, "yaw_rate"), smooth(grid, "vy")
    calm = (np.abs(speed) > 0.2) & (np.abs(speed * rate) < 3.0)
    width = max(4, round(0.5 / grid.step))
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
    if sigma > 0.3 or solved[1] < 0.0:
        return []
    where = "ahead of" if solved[0] > 0.0 else "behind"
    text = (
        f"vy is that of a place {abs(solved[0]):.3g} ± {2 * sigma:.2g} m {where} the rear axle, if tyres slip linearly"
    )
    return [Finding(log.name, "place", "vy", "info", float(solved[0]), "m", text)]


def check_lateral_velocity(log: Log) -> list[Finding]:
    """Whether vy changes as fast as lateral acceleration and yaw rate say.

    ``ay - vx r = g (dvy/dt + d dr/dt) + s vx r`` with an accelerometer d ahead that leans by s has g = 1 + s. A wrong
    step and a wrong scale of vy look alike here, so neither is taken for it.
    """
    grid = make_grid(log)
    forward = "vx" if "vx" in grid.channels else "speed"
    if not {"vy", "yaw_rate", "lateral_acceleration", forward} <= set(grid.channels):
        return []
    rate, side = grid.channels["yaw_rate"], grid.channels["lateral_acceleration"]
    whirl = grid.channels[forward] * rate
    width = max(4, round(0.2 / grid.step))
    count = len(rate) // width
    if count < 40:
        return []

    def means(values: np.ndarray) -> np.ndarray:
        return np.asarray(values[: count * width].reshape(count, width).mean(axis=1))

    beside = np.column_stack((np.ones(count), means(whirl), means(grid.rate(rate))))
    both = np.column_stack((means(side - whirl), means(grid.rate(grid.channels["vy"]))))
    known = np.linalg.lstsq(beside, both, rcond=None)[0]
    rest = both - beside @ known
    if np.any(np.std(rest, axis=0) == 0.0):
        return []
    correlation = float(np.corrcoef(rest.T)[0, 1])
    if correlation < SWAYS:
        return []
    gain = float(rest[:, 0].var() / (rest[:, 0] @ rest[:, 1] / count))  # the noise is in the derivative
    gain /= 1.0 + float(known[1, 0] - gain * known[1, 1])
    if SWAY[0] < gain < SWAY[1]:
        return []
    text = (
        f"lateral_acceleration and yaw_rate leave {gain:.2g} times the change of vy: vy is too small by that, or "
        f"the true step is {grid.step / gain:.3g} s instead of {grid.step:.3g} s; write 'time: {{step: …}}', or a scale"
    )
    return [Finding(log.name, "relation", "vy, lateral_acceleration", "warning", gain, "1", text)]


def check_path_direction(log: Log) -> list[Finding]:
    """Whether the path turns to the side that the yaw rate says; a path has no other sign."""
    grid = make_grid(log)
    forward = "vx" if "vx" in grid.channels else "speed"
    if not {"x", "y", "yaw_rate", forward} <= set(grid.channels):
        return []
    width = max(3, round(0.5 / grid.step))
    x, y = grid.channels["x"][::width], grid.channels["y"][::width]
    course = np.unwrap(np.arctan2(np.diff(y), np.diff(x)))
    turned = np.cumsum(grid.channels["yaw_rate"])[::width] * grid.step
    fast = grid.channels[forward][::width][1:-1] > 2.0
    path, own = np.diff(course)[fast], (0.5 * (turned[2:] - turned[:-2]))[fast]
    if fast.sum() < 10 or np.std(path) == 0.0 or np.ptp(own) < 0.02:
        return []
    correlation = float(np.corrcoef(path, own)[0, 1])
    if correlation > -0.5:
        return []
    text = f"the path turns right where the yaw rate says left (correlation {correlation:.2f}): wrong sign of x or of y"
    return [Finding(log.name, "units", "x, y", "fault", correlation, "1", text)]


def check_gravity(log: Log) -> list[Finding]:
    """Accelerometers that feel gravity: an offset at standstill, or one that goes with roll and pitch."""
    grid, found = make_grid(log), []
    forward = "vx" if "vx" in grid.channels else "speed"
    if forward in grid.channels:
        rest = np.abs(smooth(grid, forward)) < STANDSTILL
        for name in ("longitudinal_acceleration", "lateral_acceleration"):
            if name in grid.channels and rest.sum() > max(10, 0.5 / grid.step):
                value = float(np.median(grid.channels[name][rest]))
                if abs(value) > 0.15:
                    tilt = np.degrees(np.arcsin(np.clip(value / GRAVITY, -1.0, 1.0)))
                    text = f"reads {value:.3g} m/s^2 at standstill, as gravity does at a tilt of {abs(tilt):.2g} deg"
                    found.append(Finding(log.name, "gravity", name, "warning", value, "m/s^2", text))
    for relation in kinematic_relations(grid.channels):
        lean = {"lateral_acceleration": ("roll", 1.0), "longitudinal_acceleration": ("pitch", -1.0)}
        name, sign = lean.get(relation.measured, ("", 1.0))
        if name not in grid.channels or np.std(grid.channels[name]) < 2e-3:
            continue
        part = _tilt_part(grid, relation.left(grid), relation.right(grid), np.sin(grid.channels[name]))
        if part is not None and abs(part[0]) > 5.0 * part[1] and 0.7 * GRAVITY < abs(part[0]) < 1.3 * GRAVITY:
            text = f"has {part[0]:.3g} ± {2 * part[1]:.2g} m/s^2 times the sine of {name} in it: gravity"
            if part[0] * sign < 0.0:
                text += f", and {name} has the opposite sign of ISO 8855"
            found.append(
                Finding(log.name, "gravity", f"{relation.measured}, {name}", "warning", part[0], "m/s^2", text)
            )
    return found


def _tilt_part(grid: Grid, left: np.ndarray, right: np.ndarray, sine: np.ndarray) -> tuple[float, float] | None:
    """How much of sin(tilt) is in a relation, and its standard deviation, from means over half a second."""
    width = max(4, round(0.5 / grid.step))
    count = len(right) // width
    if count < 12:
        return None

    def means(values: np.ndarray) -> np.ndarray:
        return np.asarray(values[: count * width].reshape(count, width).mean(axis=1))

    base = np.column_stack((means(sine), means(right), np.ones(count)))
    if np.linalg.cond(base / np.maximum(np.linalg.norm(base, axis=0), 1e-12)) > 50.0:
        return None  # the tilt goes with the acceleration itself: roll in a bend cannot be told from a scale
    target = means(left)
    solved = np.linalg.lstsq(base, target, rcond=None)[0]
    variance = float(np.sum((target - base @ solved) ** 2)) / (count - 3)
    return float(solved[0]), float(np.sqrt(variance * np.linalg.inv(base.T @ base)[0, 0]))
