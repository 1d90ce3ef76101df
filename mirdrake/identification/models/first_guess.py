"""Where the fit of a steering starts: by a regression, before any model is simulated.

In slow bends a vehicle of any size turns with::

    r = v (c / ρ + δ0) / (L (1 + K v²)) + r0,    nearly    r = g v c + o v - h v³ c + r0

for the steering channel c of ratio ρ and offset δ0, the wheelbase L and the bias r0 of the gyro: it is linear in
g = 1 / (ρ L), o = δ0 / L, h = K g and r0. So scale and zero of a command of unknown units (0 to 1,
ticks of a servo) are known well enough for a fit, whatever the size of the vehicle.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from mirdrake.identification.alignment import estimate_delay, smooth
from mirdrake.identification.data import Array, Log
from mirdrake.identification.parameters import Parameter
from mirdrake.identification.relations import Grid, make_grid

CALM = 3.0
"""Tyres of any vehicle slip little at this lateral acceleration [m/s²]."""

FEWEST = 50
"""Rows of slow bends that tell something."""

STEEPEST = 0.35
"""Angle of the front wheels in the tightest bend of a lively drive [rad]."""

LONGEST = 2.7
"""Wheelbase of a car that makes wide bends only [m]."""

_ALIGNED = 0.5
"""Correlation from which on a delay of the steering is one."""

_SLOW = 0.5
"""Smoothing of the speed [s]: its noise must not look like a change of it."""

_HELD = 10.0
"""How strongly K v² is held near zero: noise of neighbouring rows is one noise."""

_BIAS = 0.02
"""Usual bias of a gyro [rad/s]."""


class SteeringGuess(NamedTuple):
    """What slow bends say of the steering.

    Attributes:
        gain: of the curvature over the channel, 1 / (ratio · wheelbase) [1/m by unit of the channel].
        curvature: at zero of the channel [1/m].
        delay: of the yaw rate behind the channel [s].
        tightest: largest curvature of the drives [1/m].
    """

    gain: float
    curvature: float
    delay: float
    tightest: float

    @property
    def wheelbase(self) -> float:
        """A guess where none is given: that of a car, or less if no car makes such bends [m]."""
        return min(LONGEST, STEEPEST / max(self.tightest, 1e-9))


def guess_steering(logs: Sequence[Log], steer: str) -> SteeringGuess | None:
    """Scale and zero of a steering channel, by robust regression over slow bends.

    Args:
        logs: drives.
        steer: name of the channel.

    Returns:
        None if the drives do not tell, or if the sign is wrong.
    """
    rows, delays, tightest = [], [], 0.0
    for log in logs:
        found = _rows_of(make_grid(log), steer)
        if found is None:
            continue
        rows.append(found[0])
        delays.append(found[1])
        tightest = max(tightest, found[2])
    if not rows:
        return None
    v, c, r = np.concatenate(rows, axis=1)
    if len(v) < FEWEST or np.ptp(c) == 0.0 or np.ptp(r) == 0.0:
        return None
    middle = float(np.median(c))  # a command about 1500 is nearly the same column as the speed
    top, one = float(np.max(v)), np.ones(len(v))
    base = np.column_stack((v * (c - middle), v, one, -((v / top) ** 2) * v * (c - middle)))
    # K v² and r0 are held near zero where nothing tells them apart from the rest, as at one speed.
    plain = _robust(base[:, :3], r, np.array([0.0, 0.0, 1.0 / _BIAS]))
    if plain[0] <= 0.0:
        return None
    solved = _robust(base, r, np.array([0.0, 0.0, 1.0 / _BIAS, _HELD / plain[0]]))
    gain, at_middle = float(solved[0]), float(solved[1])
    if gain <= 0.0 or np.corrcoef(base @ solved, r)[0, 1] < _ALIGNED:
        return None
    return SteeringGuess(gain, at_middle - gain * middle, float(np.median(delays)), tightest)


def _rows_of(grid: Grid, steer: str) -> tuple[Array, float, float] | None:
    """Speed, steering and yaw rate of slow bends (3, n), the delay of the latter, and the largest curvature."""
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
        rate = smooth(grid, "lateral_acceleration") / np.where(moving, speed, 1.0)
    delay = estimate_delay(rate, angle, grid.step)
    late = 0.0 if delay is None or abs(delay.correlation) < _ALIGNED else max(delay.value, 0.0)  # no cause comes late
    index = np.arange(float(len(angle)))
    angle = np.interp(index - late / grid.step, index, angle)
    calm = moving & (np.abs(speed * rate) < CALM)
    if not calm.any():
        return None
    tightest = float(np.percentile(np.abs(rate[calm] / speed[calm]), 99.0))
    return np.stack((speed[calm], angle[calm], rate[calm])), late, tightest


def _robust(base: Array, values: Array, held: Array) -> Array:
    """Least squares with weights of Huber, then of Tukey; unknowns are held near zero by that much over the noise."""
    weights, found = np.ones(len(values)), np.zeros(base.shape[1])
    noise = float(np.std(values))
    for turn in range(20):
        rows = np.vstack((base * weights[:, None], np.diag(held) * noise))
        size = np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
        found = np.linalg.lstsq(rows / size, np.append(values * weights, np.zeros(len(held))), rcond=None)[0] / size
        away = np.abs(values - base @ found)
        noise = max(1.4826 * float(np.median(away)), 1e-9)
        ratio = away / noise
        # What is far off counts with all its size in Huber's loss; in Tukey's it does not count.
        late = turn > 9
        weights = np.maximum(1.0 - (ratio / 4.685) ** 2, 0.0) if late else 1.0 / np.sqrt(np.maximum(ratio / 1.345, 1.0))
    return np.asarray(found)


def with_guess(
    parameters: Sequence[Parameter], steer: str, guess: SteeringGuess, wheelbase: float
) -> tuple[Parameter, ...]:
    """Parameters with guesses and bounds of the steering by what slow bends say.

    Args:
        parameters: of a model.
        steer: its steering channel.
        guess: of the channel.
        wheelbase: of the model [m].
    """
    found = []
    for one in parameters:
        if one.name == "steering_ratio" and one.free:
            ratio = 1.0 / (guess.gain * wheelbase)
            one = replace(one, guess=ratio, low=0.1 * ratio, high=10.0 * ratio)
        elif one.name == "steering_offset":
            # An angle is zeroed to some degrees; a command may have its zero anywhere.
            offset, room = guess.curvature * wheelbase, 0.2 if steer != "steering_command" else 1.0
            low, high = min(-room, offset - room), max(room, offset + room)
            one = replace(one, guess=offset, low=low, high=high, usual=one.usual if room < 1.0 else 30.0)
        elif one.name == "steering_delay" and guess.delay > 0.15:
            late = guess.delay - 0.1  # the vehicle itself takes some of it
            one = replace(one, guess=late, high=max(one.high, 2.0 * late))
        found.append(one)
    return tuple(found)
