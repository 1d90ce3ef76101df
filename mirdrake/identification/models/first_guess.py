"""First guess of the steering by a regression over slow turns, before any model is simulated.

In slow turns a vehicle of any size yaws with::

    r = v (c / ρ + δ0) / (L (1 + K v²)) + r0,    nearly    r = g v c + o v - h v³ c + r0

for the steering channel c of ratio ρ and offset δ0, the wheelbase L and the gyro bias r0. This is linear in
g = 1 / (ρ L), o = δ0 / L, h = K g and r0. Scale and zero of a command of unknown units (0 to 1, ticks of a servo) are
then known well enough for a fit, whatever the size of the vehicle.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from mirdrake.identification.alignment import estimate_delay, smooth
from mirdrake.identification.data import Array, Log
from mirdrake.identification.evidence import likelihood_gain, required_gain
from mirdrake.identification.parameters import Parameter
from mirdrake.identification.relations import Grid, make_grid
from mirdrake.identification.timing import median_step

CALM = 3.0
"""Lateral acceleration at which the tyres of any vehicle have little slip [m/s²]."""

FEWEST = 50
"""Least number of rows of slow turns for an estimate."""

STEEPEST = 0.35
"""Road wheel angle in the tightest turn of a lively drive [rad]."""

LONGEST = 2.7
"""Wheelbase of a car whose turns are all wide [m]."""

_ALIGNED = 0.5
"""Correlation above which an estimated steering delay is used."""

_SLOW = 0.5
"""Smoothing of the speed [s], so that its noise does not look like a change."""

_HELD = 10.0
"""Weight that keeps K v² near zero: the noise of neighbouring rows is correlated."""

_UNDERSTEER = (-0.5, 4.0)
"""Range of K v² at the highest speed [1]: twice the characteristic speed, 0.7 of the critical one."""

MODEL_ERROR = 0.01
"""Least error of the regression over the deviation of the yaw rate [1]: without noise, what the regression neglects
must not separate a zero of the steering from a bias of the gyro at one speed."""

ALIGNED_WITHIN = 0.01
"""Usual road wheel angle at zero of the channel [rad]: 9 degrees of a hand wheel."""

_BIAS = 0.02
"""Usual bias of a gyro [rad/s]."""


class SteeringGuess(NamedTuple):
    """Estimate of the steering from slow turns.

    Attributes:
        gain: curvature over the channel, 1 / (ratio · wheelbase) [1/m by unit of the channel].
        curvature: curvature at zero of the channel [1/m].
        delay: delay of the yaw rate against the channel [s].
        tightest: largest curvature of the logs [1/m].
    """

    gain: float
    curvature: float
    delay: float
    tightest: float

    @property
    def wheelbase(self) -> float:
        """Guess where none is given: that of a car, or less if the turns are too tight for a car [m]."""
        return min(LONGEST, STEEPEST / max(self.tightest, 1e-9))


def guess_steering(logs: Sequence[Log], steer: str) -> SteeringGuess | None:
    """Return scale and zero of a steering channel, by robust regression over slow turns.

    Args:
        logs: recorded drives.
        steer: name of the channel.

    Returns:
        None if the logs carry too little information, or if the sign is wrong.
    """
    # Logs are taken together, since one alone may have a single speed, which does not separate the unknowns.
    rows, delays, tightest = [], [], 0.0
    for log in logs:
        estimate = _rows_of(make_grid(log), steer)
        if estimate is None:
            continue
        rows.append(estimate[0])
        delays.append(estimate[1])
        tightest = max(tightest, estimate[2])
    if not rows:
        return None
    # The model is linear in gain, zero, understeer and gyro bias.
    v, c, r = np.concatenate(rows, axis=1)
    if len(v) < FEWEST or np.ptp(c) == 0.0 or np.ptp(r) == 0.0:
        return None
    middle = float(np.median(c))  # a command of about 1500 is nearly collinear with the speed
    top, ones = float(np.max(v)), np.ones(len(v))
    base = np.column_stack((v * (c - middle), v, ones, -((v / top) ** 2) * v * (c - middle)))
    # K v² and r0 are kept near zero where they are not separable from the rest, as at one speed. Errors of rows within
    # the smoothing are not independent: they count once.
    memory = max(_SLOW / min(median_step(log.time) for log in logs), 1.0)
    bias = memory**0.5 / _BIAS
    penalty = np.diag([0.0, 0.0, bias, 0.0])
    # One angle does not separate ratio and zero of the channel; its zero is then that of a vehicle with wheels aligned,
    # unless the logs show another one, as of a command of a servo.
    length = min(LONGEST, STEEPEST / max(tightest, 1e-9))
    aligned = np.vstack((penalty, memory**0.5 * length / ALIGNED_WITHIN * np.array([-middle, 1.0, 0.0, 0.0])))
    free, held = (r - base[:, :3] @ _robust(base[:, :3], r, rows[:, :3]) for rows in (penalty, aligned))
    gain_of_zero, effective = likelihood_gain(held, free)
    is_aligned = gain_of_zero < required_gain(effective, 1.0)
    if is_aligned:
        penalty = aligned
    plain = _robust(base[:, :3], r, penalty[:, :3])
    # A gain of zero or less, or a poor correlation, means that the column is not the steering.
    if plain[0] <= 0.0:
        return None
    solved = _robust(base, r, np.vstack((penalty, [0.0, 0.0, 0.0, _HELD / plain[0]])))
    # Nearly one speed does not separate gain and understeer; the regression then has a gain of any size. Without
    # understeer there may be nothing left to explain.
    is_plain = 1.4826 * float(np.median(np.abs(r - base[:, :3] @ plain))) < MODEL_ERROR * float(np.std(r))
    if is_plain or not _UNDERSTEER[0] * solved[0] <= solved[3] <= _UNDERSTEER[1] * solved[0]:
        solved = np.append(plain, 0.0)
    gain, at_middle = float(solved[0]), float(solved[1])
    if np.corrcoef(base @ solved, r)[0, 1] < _ALIGNED:
        return None
    return SteeringGuess(gain, at_middle - gain * middle, float(np.median(delays)), tightest)


def _rows_of(grid: Grid, steer: str) -> tuple[Array, float, float] | None:
    """Return speed, steering and yaw rate in slow turns (3, n), the delay of the yaw rate, the largest curvature."""
    forward = "vx" if "vx" in grid.channels else "speed"
    if not {forward, steer} <= set(grid.channels) or not {"yaw_rate", "lateral_acceleration"} & set(grid.channels):
        return None
    speed, angle = smooth(grid, forward), smooth(grid, steer)
    top = float(np.max(np.abs(speed)))
    speed = gaussian_filter1d(speed, max(_SLOW / grid.step, 1e-3), mode="nearest")
    moving = speed > min(1.0, 0.2 * top)
    if "yaw_rate" in grid.channels:
        rate = smooth(grid, "yaw_rate")
    else:
        # In quasi-steady turns r = ay / v replaces a missing yaw rate.
        rate = smooth(grid, "lateral_acceleration") / np.where(moving, speed, 1.0)
    delay = estimate_delay(rate, angle, grid.step)
    late = 0.0 if delay is None or abs(delay.correlation) < _ALIGNED else max(delay.value, 0.0)  # a cause precedes
    # The steering is moved to the time of its response: a delay looks like an offset if turns to one side are faster.
    index = np.arange(float(len(angle)))
    angle = np.interp(index - late / grid.step, index, angle)
    # At low lateral acceleration the tyres have little slip, whatever the vehicle.
    calm = moving & (np.abs(speed * rate) < CALM)
    if not calm.any():
        return None
    tightest = float(np.percentile(np.abs(rate[calm] / speed[calm]), 99.0))
    return np.stack((speed[calm], angle[calm], rate[calm])), late, tightest


def _robust(base: Array, values: Array, penalty: Array) -> Array:
    """Solve least squares with Huber's, then Tukey's weights; rows of `penalty` are kept near zero, over the noise."""
    weights, unknowns = np.ones(len(values)), np.zeros(base.shape[1])
    noise = float(np.std(values))
    for turn in range(20):
        rows = np.vstack((base * weights[:, None], penalty * noise))
        # Columns are scaled to unit length, as commands may be of any size (0 to 1, or 1500 ticks).
        size = np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
        unknowns = (
            np.linalg.lstsq(rows / size, np.append(values * weights, np.zeros(len(penalty))), rcond=None)[0] / size
        )
        away = np.abs(values - base @ unknowns)
        noise = max(1.4826 * float(np.median(away)), MODEL_ERROR * float(np.std(values)), 1e-9)
        ratio = away / noise
        # Huber's loss is convex and finds the neighbourhood; Tukey's then ignores outliers altogether.
        late = turn > 9
        weights = np.maximum(1.0 - (ratio / 4.685) ** 2, 0.0) if late else 1.0 / np.sqrt(np.maximum(ratio / 1.345, 1.0))
    return np.asarray(unknowns)


def with_guess(
    parameters: Sequence[Parameter], steer: str, guess: SteeringGuess, wheelbase: float
) -> tuple[Parameter, ...]:
    """Return the parameters with guesses and bounds of the steering from slow turns.

    Args:
        parameters: parameters of a model.
        steer: its steering channel.
        guess: estimate for that channel.
        wheelbase: wheelbase of the model [m].
    """
    guesses = []
    for parameter in parameters:
        if parameter.name == "steering_ratio" and parameter.free:
            ratio = 1.0 / (guess.gain * wheelbase)
            parameter = replace(parameter, guess=ratio, low=0.1 * ratio, high=10.0 * ratio)
        elif parameter.name == "steering_offset":
            # An angle sensor is zeroed to a few degrees; a command may have its zero anywhere.
            offset, room = guess.curvature * wheelbase, 0.2 if steer != "steering_command" else 1.0
            low, high = min(-room, offset - room), max(room, offset + room)
            parameter = replace(
                parameter, guess=offset, low=low, high=high, usual=parameter.usual if room < 1.0 else 30.0
            )
        elif parameter.name == "steering_delay" and guess.delay > 0.15:
            late = guess.delay - 0.1  # the vehicle's response accounts for a part
            parameter = replace(parameter, guess=late, high=max(parameter.high, 2.0 * late))
        guesses.append(parameter)
    return tuple(guesses)
