"""Drivable line of a track: a line with bounded steering rate, and a speed profile, both planned in advance.

A track of straights and arcs has jumps in its curvature, which no steering follows at speed. So before driving, the
centre line is replaced by a line close to it whose steering rate the vehicle has. With e(s) the offset of that line
from the centre line, positive to the left, and kappa(s) the curvature of the centre line, the curvature of the line is,
for small e, kappa_line = kappa + e''. Wanted is the line with the least offset whose curvature changes slowly enough
(delta = atan(L kappa_line), with the steering rate and the speed v)::

    minimise  sum of e^2   subject to   |kappa_line'| <= (1 + (L kappa_line)^2) rate / (L v)

It is found by least squares with weights, sum of e^2 + w (kappa_line')^2, the weights raised where the bound is broken
until it holds (an exterior penalty). Unweighted by place this is the zero-phase filter 1/(1 + w k^6) on the curvature:
steering leads each corner and the offset swings evenly to both sides. Where even that leaves the tolerance, the car
drives slower.
"""

import math
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import scipy  # which imports its parts when they are first named
from numpy.typing import ArrayLike, NDArray

from mirdrake.core.checks import check_number
from mirdrake.core.errors import ConfigError

Array = NDArray[np.float64]

_STEP = 0.1  # spacing of the tables [m]
_BASE_LENGTH = 0.3  # smoothing length that is always there, so that the curvature is continuous [m]
_MARGIN = 0.2  # part of the steering rate left to the feedback [1]
_ROUNDS = 30  # most rounds of raising the weights


class Track(Protocol):
    """The properties of a track that a tracker uses; all methods accept arrays and, if closed, any s."""

    @property
    def length(self) -> float:
        """Length of the centre line [m]."""

    @property
    def closed(self) -> bool:
        """Whether the end of the track is its start."""

    def pose(self, s: Any) -> tuple[Any, Any, Any]:
        """Return position x, y [m] and direction yaw [rad] of the centre line at arc lengths s [m]."""

    def project(self, x: Any, y: Any, *, near: Any = None) -> tuple[Any, Any]:
        """Return arc length s [m] and offset to the left e_y [m] of points."""


@dataclass(frozen=True)
class DrivingLimits:
    """Limits of the accelerations and of the offset that a path tracker plans with.

    Attributes:
        lateral: largest lateral acceleration v^2 kappa [m/s²].
        acceleration: largest acceleration along the path [m/s²].
        deceleration: largest deceleration along the path [m/s²].
        tolerance: largest planned offset from the centre line [m]; the car slows down where it needs to.

    Raises:
        ConfigError: one of them is not a positive number.
    """

    lateral: float = 5.0
    acceleration: float = 1.5
    deceleration: float = 2.0
    tolerance: float = 0.1

    def __post_init__(self) -> None:
        for name, unit in (
            ("lateral", "m/s^2"),
            ("acceleration", "m/s^2"),
            ("deceleration", "m/s^2"),
            ("tolerance", "m"),
        ):
            check_number("DrivingLimits", name, getattr(self, name), unit=unit, above=0.0)


def make_speed_profile(
    ceiling: ArrayLike,
    spacing: float,
    *,
    acceleration: float,
    deceleration: float,
    closed: bool,
    end_speed: float = math.inf,
) -> Array:
    """Return the highest speeds below given limits that acceleration and deceleration allow.

    Each point takes part with v^2 <= v_j^2 + 2 a |s - s_j| from every other point j, forwards with the acceleration,
    backwards with the deceleration; that is what a forward and a backward pass give.

    Args:
        ceiling: largest speed at each point (N) [m/s], for example ``min(v_set, sqrt(a_lat / |kappa|))``.
        spacing: distance of the points [m].
        acceleration: largest acceleration [m/s²].
        deceleration: largest deceleration [m/s²].
        closed: whether the point after the last one is the first one.
        end_speed: largest speed at the last point of an open track [m/s].

    Returns:
        Speeds (N) [m/s].
    """
    # In v² the limits are straight lines over the distance.
    square = np.asarray(ceiling, dtype=float) ** 2
    count = square.size
    if not closed:
        square = square.copy()
        square[-1] = min(square[-1], end_speed**2)
        return np.sqrt(_pass(_pass(square, 2.0 * acceleration * spacing)[::-1], 2.0 * deceleration * spacing)[::-1])
    # Nothing reaches past the lowest point, so the ring may be cut there.
    low = int(np.argmin(square))
    ring = np.concatenate([np.roll(square, -low), square[low : low + 1]])
    ring = _pass(_pass(ring, 2.0 * acceleration * spacing)[::-1], 2.0 * deceleration * spacing)[::-1]
    return np.sqrt(np.roll(ring[:count], low))


def _pass(square: Array, gain: float) -> Array:
    """Limit the rise of v^2 per point: min over all earlier j of square[j] + gain (i - j)."""
    # The recursion v²[i] = min(v²[i], v²[i-1] + gain) without a loop.
    ramp = gain * np.arange(square.size)
    return np.asarray(np.minimum.accumulate(square - ramp) + ramp)


@dataclass(frozen=True)
class CentreLine:
    """Evenly spaced tables of a track; closed tracks repeat their first point at the end.

    Attributes:
        length: length of the track [m].
        closed: whether the end is the start.
        spacing: distance of the points [m].
        x: positions (N) [m].
        y: positions (N) [m].
        yaw: directions (N), unwrapped [rad].
        curvature: mean curvature of each interval (N - 1) [1/m].
    """

    length: float
    closed: bool
    spacing: float
    x: Array
    y: Array
    yaw: Array
    curvature: Array


def make_centre_line(track: Track) -> CentreLine:
    """Return the tables of a track."""
    length = float(track.length)
    count = max(8, math.ceil(length / _STEP - 1e-9))
    s = np.linspace(0.0, length, count + 1)
    # The last point of a closed track is exactly the first one; `unwrap` adds the full turn to its direction.
    inside = s.copy()
    if track.closed:
        inside[-1] = 0.0
    x, y, yaw = (np.asarray(values, dtype=float) for values in track.pose(inside))
    yaw = np.unwrap(yaw)
    return CentreLine(length, bool(track.closed), length / count, x, y, yaw, np.diff(yaw) * count / length)


@dataclass(frozen=True)
class DrivableLine:
    """Line and speeds of one vehicle on one track at one speed set-point; tables at the points of the centre line.

    Attributes:
        offset: e, to the left of the centre line (N) [m].
        slope: e' (N) [1].
        curvature: of the line (N) [1/m].
        speed: speeds (N) [m/s].
    """

    offset: Array
    slope: Array
    curvature: Array
    speed: Array


def make_drivable_line(
    centre: CentreLine,
    *,
    speed: float,
    wheelbase: float,
    steering_limit: float,
    steering_rate: float,
    limits: DrivingLimits,
) -> DrivableLine:
    """Plan line and speeds; the head of the module explains how.

    Args:
        centre: the track.
        speed: set-point [m/s].
        wheelbase: distance of the axles [m].
        steering_limit: largest bicycle angle [rad].
        steering_rate: largest rate of the bicycle angle [rad/s]; inf: no limit.
        limits: how hard to drive.

    Raises:
        ConfigError: the track turns tighter than the vehicle can.
    """
    tightest = float(np.max(np.abs(centre.curvature)))
    if tightest > math.tan(steering_limit) / wheelbase:
        at = float(np.argmax(np.abs(centre.curvature))) * centre.spacing
        raise ConfigError(
            f"path tracking: the track turns with radius {1.0 / tightest:.2f} m at s = {at:.1f} m, the vehicle needs "
            f"at least {wheelbase / math.tan(steering_limit):.2f} m; use a wider track or a vehicle that steers further"
        )
    # Repeat a closed track to both sides, so that its ends fit together.
    count = centre.curvature.size
    margin = min(count, math.ceil(100.0 / centre.spacing)) if centre.closed else 0
    kappa = np.pad(centre.curvature, margin, mode="wrap")

    def profile(curvature: Array, cap: Array) -> Array:
        with np.errstate(divide="ignore"):
            ceiling = np.minimum(np.sqrt(limits.lateral / np.abs(curvature)), cap)
        return make_speed_profile(
            ceiling,
            centre.spacing,
            acceleration=limits.acceleration,
            deceleration=limits.deceleration,
            closed=False,
            end_speed=math.inf if centre.closed else 0.0,
        )

    # Line and speeds depend on each other: plan the line for the speeds, then lower these where it deviates too far.
    rate = (1.0 - _MARGIN) * steering_rate
    raw = _at_points(0.5 * (kappa[:-1] + kappa[1:]))
    cap = np.full(raw.size, speed)
    for _ in range(4):
        speeds = profile(raw, cap)
        offset, curvature = _smooth(kappa, centre.spacing, speeds, wheelbase=wheelbase, rate=rate)
        worst = np.abs(offset) / limits.tolerance
        if np.max(worst) <= 1.0:
            break
        # The offset grows with the square of the speed: slow down around the places that leave the tolerance.
        reach = max(1, round(4.0 / centre.spacing))
        around = np.max(
            np.lib.stride_tricks.sliding_window_view(np.pad(worst, reach, mode="edge"), 2 * reach + 1), axis=1
        )
        cap = np.minimum(cap, speeds / np.sqrt(np.maximum(around, 1.0)))

    # Speeds once more, with the curvature and steering rate that the line really has.
    turning = np.abs(np.gradient(np.arctan(wheelbase * curvature), centre.spacing))
    with np.errstate(divide="ignore"):
        cap = np.minimum(cap, rate / turning)
    speeds = profile(curvature, cap)
    slope = np.gradient(offset, centre.spacing)
    # Remove the repeated ends again.
    keep = slice(margin, margin + count + 1)
    return DrivableLine(offset[keep], slope[keep], curvature[keep], speeds[keep])


def _smooth(kappa: Array, h: float, speeds: Array, *, wheelbase: float, rate: float) -> tuple[Array, Array]:
    """Return offset and curvature (N) of the line with bounded steering rate for curvatures of the intervals (N - 1).

    With e at the points, the curvature of the line at an inner point is that of the centre line plus the second
    difference of e; the change of curvature from one inner point to the next is ``rise`` plus the third difference of
    e.
    """
    inner = 0.5 * (kappa[:-1] + kappa[1:])
    rise = np.diff(inner) / h
    # w of the filter 1/(1 + w k^6), hence the sixth power of a length.
    weight = np.full(rise.size, _BASE_LENGTH**6)
    # Speeds in the middle between inner points; not zero, as the bound would be infinite at a stop.
    speeds = np.maximum(0.5 * (speeds[1:-2] + speeds[2:-1]), 0.5)
    for _ in range(_ROUNDS):
        offset = _solve(weight, rise, h)
        curvature = inner + np.diff(offset, 2) / h**2
        if math.isinf(rate):
            break
        middle = 0.5 * (curvature[:-1] + curvature[1:])
        bound = (1.0 + (wheelbase * middle) ** 2) * rate / (wheelbase * speeds)
        excess = np.abs(np.diff(curvature)) / h / bound
        # Two per cent are far within the part of the rate that is left to the feedback.
        if np.max(excess) < 1.02:
            break
        # Exterior penalty: only places that break the bound get more weight.
        weight *= np.maximum(excess, 1.0) ** 2
    return offset, _at_points(curvature)


def _solve(weight: Array, rise: Array, h: float) -> Array:
    """Return the e that minimises the sum of e² + weight (third difference of e / h³ + rise)²: a banded system."""
    # Normal equations I + D'WD of the third difference D, in the lower bands that `solveh_banded` takes.
    third = np.array([-1.0, 3.0, -3.0, 1.0]) / h**3
    rows = weight.size
    band = np.zeros((4, rows + 3))
    band[0] = 1.0
    right = np.zeros(rows + 3)
    for i in range(4):
        right[i : i + rows] -= third[i] * weight * rise
        for j in range(i + 1):
            band[i - j, j : j + rows] += third[i] * third[j] * weight
    return np.asarray(scipy.linalg.solveh_banded(band, right, lower=True, check_finite=False))


def _at_points(inner: Array) -> Array:
    """Return values at all points (N): those of the inner points (N - 2), repeated at the ends."""
    return np.concatenate([inner[:1], inner, inner[-1:]])
