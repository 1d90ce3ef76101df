"""Figures of lateral transients (ISO 7401) and of the sine with dwell (ISO 19365, FMVSS 126)."""

import math
from dataclasses import dataclass

import numpy as np
import scipy  # it imports its parts when they are first used

from mirdrake.manoeuvres.base import Array

PEAK_LEVEL = 0.8
"""Share of the overshoot above which a response belongs to its peak [1]. A peak is flat, and oscillations of the body
on its tyres are superposed, so the largest sample alone is at a random time near the peak."""


@dataclass(frozen=True)
class StepResponse:
    """Response to a step of the steering.

    Attributes:
        start: time at which the steering passes half of its final value [s].
        steady: final value of the response, in its unit.
        response_time: time from start until the response has 90 % of its final value [s].
        peak_time: time from start until the centroid of the response above :data:`PEAK_LEVEL` of the overshoot, which
            is the vertex of a parabolic peak [s]; NaN without overshoot.
        overshoot: largest value over the final one, less 1, interpolated between samples [1].
        gain: final value of the response over that of the steering, unit per rad.
    """

    start: float
    steady: float
    response_time: float
    peak_time: float
    overshoot: float
    gain: float


def crossing(time: Array, values: Array, level: float, *, after: float = -math.inf) -> float:
    """Return the first time after `after` at which a signal crosses a level, interpolated; NaN if it does not."""
    signs = np.sign(values - level)
    hits = np.flatnonzero((signs[:-1] * signs[1:] <= 0.0) & (values[:-1] != values[1:]) & (time[1:] > after))
    if not len(hits):
        return math.nan
    index = int(hits[0])
    part = (level - values[index]) / (values[index + 1] - values[index])
    return float(time[index] + part * (time[index + 1] - time[index]))


def step_response(time: Array, steering: Array, output: Array, *, last: float) -> StepResponse:
    """Return the figures of the response to a step.

    Args:
        time: increasing times [s].
        steering: steering angle, zero before the step [rad].
        output: yaw rate or lateral acceleration.
        last: time at the end over which final values are averaged [s].
    """
    end = time >= time[-1] - last
    final, steady = float(np.mean(steering[end])), float(np.mean(output[end]))
    # ISO 7401: the time origin is where the steering has reached half of its final value.
    start = crossing(time, steering, 0.5 * final)
    relative = output / steady
    since = time >= start

    # Before the origin the response is not that of the step; -inf keeps such samples from being the peak.
    peak = int(np.argmax(np.where(since, relative, -np.inf)))
    overshoot = _top(relative, peak) - 1.0
    # An overshoot below the remaining oscillation, or 0.5 %, has no peak time.
    noise = float(np.ptp(relative[end]))
    return StepResponse(
        start=start,
        steady=steady,
        response_time=crossing(time, relative, 0.9, after=start) - start,
        peak_time=_centroid(time, relative - 1.0 - PEAK_LEVEL * overshoot, peak) - start
        if overshoot > max(0.005, noise)
        else math.nan,
        overshoot=max(overshoot, 0.0),
        gain=steady / final,
    )


def _top(values: Array, index: int) -> float:
    """Return the height of the parabola through the largest sample and its neighbours."""
    if not 0 < index < len(values) - 1:
        return float(values[index])
    left, middle, right = values[index - 1 : index + 2].tolist()
    curve = left - 2.0 * middle + right
    return float(middle - (left - right) ** 2 / (8.0 * curve)) if curve < 0.0 and max(left, right) <= middle else middle


def _centroid(time: Array, height: Array, index: int) -> float:
    """Return the time of the centroid of the positive part of a signal around a sample, linear between the samples."""
    low = np.flatnonzero(height <= 0.0)
    after = int(np.searchsorted(low, index))
    first = int(low[after - 1]) if after else 0
    last = int(low[after]) if after < len(low) else len(height) - 1
    t, h = time[first : last + 1].copy(), height[first : last + 1].copy()
    # The ends are where the signal crosses zero.
    for end, inner in ((0, 1), (-1, -2)):
        if h[end] < 0.0:
            t[end] += h[end] / (h[end] - h[inner]) * (t[inner] - t[end])
            h[end] = 0.0
    width = np.diff(t)
    moments = width * (t[:-1] * (2.0 * h[:-1] + h[1:]) + t[1:] * (h[:-1] + 2.0 * h[1:])) / 6.0
    return float(np.sum(moments) / np.sum(0.5 * width * (h[:-1] + h[1:])))


@dataclass(frozen=True)
class FrequencyResponse:
    """Frequency response (n).

    Attributes:
        frequency: frequencies [Hz].
        gain: gain, unit of the response per rad.
        phase: unwrapped phase [rad]; negative for a lag.
        coherence: coherence, 0 to 1.
    """

    frequency: Array
    gain: Array
    phase: Array
    coherence: Array

    def at(self, frequency: float) -> tuple[float, float]:
        """Return gain and phase [rad] at a frequency [Hz], interpolated; NaN outside."""
        if not len(self.frequency) or not self.frequency[0] <= frequency <= self.frequency[-1]:
            return math.nan, math.nan
        gain = float(np.interp(frequency, self.frequency, self.gain))
        return gain, float(np.interp(frequency, self.frequency, self.phase))

    def peak(self) -> tuple[float, float]:
        """Return frequency [Hz] and value of the largest gain: the peak of a parabola through three points.

        At an end of the range it is the last point.
        """
        index = int(np.argmax(self.gain))
        f, g = self.frequency[index - 1 : index + 2], self.gain[index - 1 : index + 2]
        if not 0 < index < len(self.gain) - 1 or not g[0] + g[2] < 2.0 * g[1]:
            return float(self.frequency[index]), float(self.gain[index])
        # Vertex of the parabola, in steps of the grid from the middle point.
        part = 0.5 * float(g[0] - g[2]) / float(g[0] - 2.0 * g[1] + g[2])
        return float(f[1] + part * (f[2] - f[1])), float(g[1] - 0.25 * (g[0] - g[2]) * part)


def frequency_response(
    time: Array, steering: Array, output: Array, *, first: float, last: float, segment: float
) -> FrequencyResponse:
    """Return gain, phase and coherence: cross spectrum over power spectrum of the steering (H1 estimator).

    Args:
        time: times at equal steps [s].
        steering: steering angle [rad].
        output: response.
        first: lowest frequency [Hz].
        last: highest frequency [Hz].
        segment: length of the segments over which spectra are averaged [s]; its inverse is the resolution.
    """
    rate = 1.0 / float(time[1] - time[0])
    # Same segments for all spectra, else the ratio H1 = S_uy / S_uu is biased.
    count = min(len(time), round(segment * rate))
    settings = {"fs": rate, "nperseg": count, "noverlap": count // 2, "detrend": "constant"}
    frequency, cross = scipy.signal.csd(steering, output, **settings)
    _, power = scipy.signal.welch(steering, **settings)
    _, out = scipy.signal.welch(output, **settings)
    chosen = (frequency >= first) & (frequency <= last) & (power > 0.0)
    response = cross[chosen] / power[chosen]
    # The floor avoids 0/0 where the response has no power.
    coherence = np.abs(cross[chosen]) ** 2 / (power[chosen] * np.maximum(out[chosen], 1e-300))
    return FrequencyResponse(frequency[chosen], np.abs(response), np.unwrap(np.angle(response)), coherence)


def bandwidth(response: FrequencyResponse, lag: float) -> float:
    """Return the frequency [Hz] at which the response lags by `lag` [rad], interpolated; NaN if there is none."""
    return crossing(response.frequency, response.phase, -lag)


@dataclass(frozen=True)
class DwellResponse:
    """Response to a sine with dwell.

    Attributes:
        begin: beginning of steer [s].
        complete: completion of steer [s].
        peak: largest yaw rate after the steering has changed its side [rad/s].
        ratios: yaw rate over the peak at the given times after completion [1].
        displacement: lateral displacement of the centre of mass at the given time after the beginning [m].
        hand_wheel: largest angle of the hand-wheel [rad].
    """

    begin: float
    complete: float
    peak: float
    ratios: tuple[float, ...]
    displacement: float
    hand_wheel: float


def dwell_response(
    time: Array,
    hand_wheel: Array,
    yaw_rate: Array,
    across: Array,
    *,
    after_completion: tuple[float, ...],
    after_beginning: float,
    threshold: float,
) -> DwellResponse:
    """Return the figures of a sine with dwell.

    Args:
        time: increasing times [s].
        hand_wheel: hand-wheel angle [rad].
        yaw_rate: yaw rate [rad/s].
        across: lateral position of the centre of mass, zero at the start [m].
        after_completion: times after completion of steer at which the yaw rate is evaluated [s].
        after_beginning: time after the beginning of steer at which the displacement is evaluated [s].
        threshold: angle beyond which the hand-wheel counts as turned [rad].
    """
    # Beginning and completion of steer by a threshold, since the ideal zero crossings are not observable.
    size = np.abs(hand_wheel)
    turned = np.flatnonzero(size >= threshold)
    if not len(turned):
        return DwellResponse(math.nan, math.nan, math.nan, (math.nan,) * len(after_completion), math.nan, 0.0)
    # Turned from the first sample on: no crossing exists before it.
    begin = crossing(time, size, threshold) if turned[0] else float(time[0])
    last = int(turned[-1])
    complete = crossing(time[last:], size[last:], threshold) if last + 1 < len(time) else float(time[-1])
    # Direction of the first half-wave; it makes all following signs independent of the side.
    first = math.copysign(1.0, float(hand_wheel[turned[0]]))

    # Peak yaw rate of the second half-wave, as in FMVSS 126, up to 1 s after the completion.
    other = np.flatnonzero(first * hand_wheel <= -threshold)
    change = float(time[other[0]]) if len(other) else begin
    second = (time >= change) & (time <= complete + 1.0)
    peak = float(np.max(-first * yaw_rate[second]))
    ratios = tuple(
        # right=nan: a run that ended too early has no value, and not its last one.
        float(-first * np.interp(complete + wait, time, yaw_rate, right=math.nan)) / peak
        for wait in after_completion
    )
    displacement = first * float(np.interp(begin + after_beginning, time, across, right=math.nan))
    return DwellResponse(begin, complete, peak, ratios, displacement, float(np.max(np.abs(hand_wheel))))
