"""Figures of ride: acceleration weighted by ISO 2631-1, its third-octave bands, and wheel-load variation.

The weightings Wk (vertical) and Wd (horizontal) are products of four transfer functions: high pass and low pass of
second order with Butterworth damping, transition from acceleration to velocity, and upward step (ISO 2631-1:1997, annex
A). They are applied to the Fourier transform, so that no digital filter distorts them.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mirdrake.manoeuvres.base import Array
from mirdrake.manoeuvres.record import Record

Complex = NDArray[np.complex128]

_PAD = 10.0  # zeros behind a record, in which the response of the filters decays [s]
_THIRD = 10.0**0.1


@dataclass(frozen=True)
class Weighting:
    """Corner frequencies [Hz] and quality factors [1] of a weighting of ISO 2631-1.

    Attributes:
        f3: zero of the transition from acceleration to velocity.
        f4: its poles.
        q4: their quality factor.
        f5: zeros of the upward step; None: no step.
        q5: their quality factor.
        f6: its poles.
        q6: their quality factor.
    """

    f3: float
    f4: float
    q4: float
    f5: float | None = None
    q5: float = 1.0
    f6: float = 1.0
    q6: float = 1.0


WK = Weighting(12.5, 12.5, 0.63, 2.37, 0.91, 3.35, 0.91)
"""Vertical acceleration of a standing or seated person."""

WD = Weighting(2.0, 2.0, 0.63)
"""Horizontal acceleration of a standing or seated person."""

_F1, _F2 = 0.4, 100.0  # band limits [Hz]


def response(weighting: Weighting, frequency: Array) -> Complex:
    """Return the frequency response of a weighting [1] at frequencies [Hz] (N), zero at 0 Hz."""
    p = 1j * np.asarray(frequency, dtype=float)
    root = math.sqrt(2.0)
    # Frequencies in Hz instead of rad/s: only ratios occur. The high pass is written without a division by zero.
    result: Complex = p**2 / (p**2 + root * _F1 * p + _F1**2)
    result = result / (1.0 + root * p / _F2 + (p / _F2) ** 2)
    w = weighting
    result = result * (1.0 + p / w.f3) / (1.0 + p / (w.q4 * w.f4) + (p / w.f4) ** 2)
    if w.f5 is not None:
        step = (1.0 + p / (w.q5 * w.f5) + (p / w.f5) ** 2) / (1.0 + p / (w.q6 * w.f6) + (p / w.f6) ** 2)
        result = result * step * (w.f5 / w.f6) ** 2
    return result


def weighted(acceleration: Array, step: float, weighting: Weighting) -> Array:
    """Return the weighted acceleration [m/s²] (N) of samples (N) with a period [s]; the car is at rest before them."""
    count = len(acceleration) + round(_PAD / step)
    gain = response(weighting, np.asarray(np.fft.rfftfreq(count, step)))
    spectrum: Complex = np.asarray(np.fft.rfft(acceleration, count)) * gain
    filtered: Array = np.fft.irfft(spectrum, count)[: len(acceleration)]
    return filtered


@dataclass(frozen=True)
class Comfort:
    """Figures of ISO 2631-1 for one axis.

    Attributes:
        rms: weighted rms acceleration [m/s²].
        transient: maximum transient vibration value, the largest rms over 1 s [m/s²].
        dose: vibration dose value [m/s^1.75].
        peak: largest weighted acceleration [m/s²].
    """

    rms: float
    transient: float
    dose: float
    peak: float

    @property
    def crest(self) -> float:
        """Crest factor, peak over rms; above 9 the rms is not sufficient [1]."""
        return self.peak / self.rms


def comfort(weighted_acceleration: Array, step: float) -> Comfort:
    """Return the figures of a weighted acceleration [m/s²] (N) with a sampling period [s]."""
    square = weighted_acceleration**2
    window = min(max(round(1.0 / step), 1), len(square))
    sums = np.concatenate([[0.0], np.cumsum(square)])
    means = (sums[window:] - sums[:-window]) / window
    return Comfort(
        rms=float(np.sqrt(square.mean())),
        transient=float(np.sqrt(means.max())),
        dose=float((np.sum(square**2) * step) ** 0.25),
        peak=float(np.abs(weighted_acceleration).max()),
    )


def third_octaves(acceleration: Array, step: float, first: int = -3, last: int = 19) -> tuple[Array, Array]:
    """Return the centres of third-octave bands [Hz] and the rms of the acceleration in each [m/s²].

    Args:
        acceleration: samples [m/s²] (N).
        step: sampling period [s].
        first: exponent of the first centre, 10^(first/10) Hz.
        last: exponent of the last one; bands above the Nyquist frequency are left out.
    """
    count = len(acceleration)
    frequency = np.fft.rfftfreq(count, step)
    power = 2.0 * np.abs(np.fft.rfft(acceleration - acceleration.mean())) ** 2 / count**2
    centres = np.array([_THIRD**n for n in range(first, last + 1) if _THIRD ** (n + 0.5) < 0.5 / step])
    edges = _THIRD**0.5
    bands = [power[(frequency >= centre / edges) & (frequency < centre * edges)].sum() for centre in centres]
    return centres, np.sqrt(np.array(bands))


def body_acceleration(record: Record, place: tuple[float, float, float]) -> Array:
    """Return the acceleration of a point of the body in body axes [m/s²] (n - 1, 3), without gravity.

    It is the change of the velocity over each sampling period, without smoothing.

    Args:
        record: run with the full plant.
        place: the point in the vehicle frame [m].
    """
    o = record.others
    roll, pitch, yaw = record.roll, o["pitch"], record.yaw
    cr, sr, cp, sp, cy, sy = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    # Rotation from body to world, roll-pitch-yaw (3, 3, n).
    R = np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
    spin = np.column_stack([o["wx"], o["wy"], record.yaw_rate])
    velocity = np.column_stack([record.vx, record.vy, o["vz"]]) + np.cross(spin, place)
    world = np.einsum("abn,nb->na", R, velocity)
    change = np.diff(world, axis=0) / np.diff(record.time)[:, None]
    mean_rotation = 0.5 * (R[:, :, 1:] + R[:, :, :-1])
    acceleration: Array = np.einsum("abn,na->nb", mean_rotation, change)
    return acceleration
