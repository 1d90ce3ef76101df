"""Figures of lateral transients (ISO 7401) and of the sine with dwell (ISO 19365, FMVSS 126)."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.signal import csd, welch

from mirdrake.manoeuvres.base import Array

ROUND_PEAK = 0.2
"""Part of its time on both sides of a largest value, in which the peak is looked for: it is flat, and wheels that are
steered by a control unit move in steps, so that the largest sample comes earlier or later by chance."""


@dataclass(frozen=True)
class StepResponse:
    """Answer to a step of the steering.

    Attributes:
        start: time at which the steering passes half of its final value [s].
        steady: final value of the answer, in its unit.
        response_time: from start until the answer has 90 % of its final value [s].
        peak_time: from start until the top of a parabola through what is around the largest value, within
            :data:`ROUND_PEAK` of that time [s]; NaN without overshoot.
        overshoot: largest value over the final one, less 1 [1].
        gain: final value of the answer over that of the steering, unit per rad.
    """

    start: float
    steady: float
    response_time: float
    peak_time: float
    overshoot: float
    gain: float


def crossing(time: Array, values: Array, level: float, *, after: float = -math.inf) -> float:
    """First time after `after` at which a signal reaches a level, from either side, between samples; NaN if never."""
    signs = np.sign(values - level)
    hits = np.flatnonzero((signs[:-1] * signs[1:] <= 0.0) & (values[:-1] != values[1:]) & (time[1:] > after))
    if not len(hits):
        return math.nan
    index = int(hits[0])
    part = (level - values[index]) / (values[index + 1] - values[index])
    return float(time[index] + part * (time[index + 1] - time[index]))


def step_response(time: Array, steering: Array, answer: Array, *, last: float) -> StepResponse:
    """Figures of the answer to a step.

    Args:
        time: rising [s].
        steering: its angle, zero before the step [rad].
        answer: yaw rate or lateral acceleration.
        last: length of the end of the signals over which final values are taken [s].
    """
    end = time >= time[-1] - last
    final, steady = float(np.mean(steering[end])), float(np.mean(answer[end]))
    start = crossing(time, steering, 0.5 * final)
    relative = answer / steady
    since = time >= start
    peak = int(np.argmax(np.where(since, relative, -np.inf)))
    overshoot = float(relative[peak]) - 1.0
    noise = float(np.ptp(relative[end]))
    return StepResponse(
        start=start,
        steady=steady,
        response_time=crossing(time, relative, 0.9, after=start) - start,
        peak_time=_top(time - start, relative, peak) if overshoot > max(0.005, noise) else math.nan,
        overshoot=max(overshoot, 0.0),
        gain=steady / final,
    )


def _top(time: Array, values: Array, index: int) -> float:
    """Time of the top of the parabola through the samples around a largest one; time from the start on."""
    at = float(time[index])
    width = ROUND_PEAK * at
    near = np.abs(time - at) <= width
    if np.count_nonzero(near) < 3:
        return at
    curve, slope, _ = np.polyfit(time[near] - at, values[near], 2)
    return at + float(np.clip(-0.5 * slope / curve, -width, width)) if curve < 0.0 else at


@dataclass(frozen=True)
class FrequencyResponse:
    """Answer over frequency (n).

    Attributes:
        frequency: [Hz].
        gain: unit of the answer per rad.
        phase: without jumps [rad]; negative: the answer is late.
        coherence: 0 to 1.
    """

    frequency: Array
    gain: Array
    phase: Array
    coherence: Array

    def at(self, frequency: float) -> tuple[float, float]:
        """Gain and phase at a frequency [Hz], between the lines; NaN outside."""
        if not len(self.frequency) or not self.frequency[0] <= frequency <= self.frequency[-1]:
            return math.nan, math.nan
        gain = float(np.interp(frequency, self.frequency, self.gain))
        return gain, float(np.interp(frequency, self.frequency, self.phase))

    def peak(self) -> tuple[float, float]:
        """Frequency [Hz] and height of the largest gain: the top of the parabola through its line and the two beside.

        At an end of the range it is the last line itself.
        """
        index = int(np.argmax(self.gain))
        f, g = self.frequency[index - 1 : index + 2], self.gain[index - 1 : index + 2]
        if not 0 < index < len(self.gain) - 1 or not g[0] + g[2] < 2.0 * g[1]:
            return float(self.frequency[index]), float(self.gain[index])
        part = 0.5 * float(g[0] - g[2]) / float(g[0] - 2.0 * g[1] + g[2])
        return float(f[1] + part * (f[2] - f[1])), float(g[1] - 0.25 * (g[0] - g[2]) * part)


def frequency_response(
    time: Array, steering: Array, answer: Array, *, first: float, last: float, segment: float
) -> FrequencyResponse:
    """Gain, phase and coherence: cross spectrum over power spectrum of the steering (the estimator called H1).

    Args:
        time: in equal steps [s].
        steering: what goes in [rad].
        answer: what comes out.
        first: lowest frequency wanted [Hz].
        last: highest one [Hz].
        segment: length of the stretches over which spectra are averaged [s]; its inverse is the resolution.
    """
    rate = 1.0 / float(time[1] - time[0])
    count = min(len(time), round(segment * rate))
    settings = {"fs": rate, "nperseg": count, "noverlap": count // 2, "detrend": "constant"}
    frequency, cross = csd(steering, answer, **settings)
    _, power = welch(steering, **settings)
    _, out = welch(answer, **settings)
    chosen = (frequency >= first) & (frequency <= last) & (power > 0.0)
    response = cross[chosen] / power[chosen]
    coherence = np.abs(cross[chosen]) ** 2 / (power[chosen] * np.maximum(out[chosen], 1e-300))
    return FrequencyResponse(frequency[chosen], np.abs(response), np.unwrap(np.angle(response)), coherence)


def bandwidth(response: FrequencyResponse, lag: float) -> float:
    """Frequency at which the answer is late by `lag` [rad], between the lines [Hz]; NaN if never."""
    return crossing(response.frequency, response.phase, -lag)


@dataclass(frozen=True)
class DwellResponse:
    """Answer to a sine with dwell.

    Attributes:
        begin: beginning of steer [s].
        complete: completion of steer [s].
        peak: largest yaw rate after the steering has changed its side [rad/s].
        ratios: yaw rate over the peak at the asked times after completion [1].
        displacement: lateral way of the centre of mass at the asked time after the beginning [m].
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
    """Figures of a sine with dwell, from recorded signals.

    Args:
        time: rising [s].
        hand_wheel: its angle as recorded [rad].
        yaw_rate: [rad/s].
        across: lateral place of the centre of mass, zero at the start [m].
        after_completion: times after completion of steer at which the yaw rate counts [s].
        after_beginning: time after the beginning of steer at which the way counts [s].
        threshold: angle from which on the wheel counts as turned [rad].
    """
    size = np.abs(hand_wheel)
    turned = np.flatnonzero(size >= threshold)
    if not len(turned):
        nothing = math.nan
        return DwellResponse(nothing, nothing, nothing, (nothing,) * len(after_completion), nothing, 0.0)
    begin = crossing(time, size, threshold) if turned[0] else float(time[0])
    last = int(turned[-1])
    complete = crossing(time[last:], size[last:], threshold) if last + 1 < len(time) else float(time[-1])
    first = math.copysign(1.0, float(hand_wheel[turned[0]]))
    other = np.flatnonzero(first * hand_wheel <= -threshold)
    change = float(time[other[0]]) if len(other) else begin
    second = (time >= change) & (time <= complete + 1.0)
    peak = float(np.max(-first * yaw_rate[second]))
    ratios = tuple(
        float(-first * np.interp(complete + wait, time, yaw_rate, right=math.nan)) / peak for wait in after_completion
    )
    way = first * float(np.interp(begin + after_beginning, time, across, right=math.nan))
    return DwellResponse(begin, complete, peak, ratios, way, float(np.max(np.abs(hand_wheel))))
