"""Figures of a test from its response, and whether the loop is stable."""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
import pandas as pd

from mirdrake.core.pid import NO_LIMITS, PidLimits
from mirdrake.tuning.figures import response_figures
from mirdrake.tuning.loops.base import Course, Evaluation
from mirdrake.tuning.models import Floats

OSCILLATION = 0.1
"""A loop is unstable if the oscillation of its error at the end has a larger RMS than this fraction of the step."""

DIVERGED = 10.0
"""A loop is unstable if its error exceeds so many steps."""

LEAST_SAMPLES = 20
"""A loop is unstable if its record has fewer samples."""

LEAST_PERIODS = 1.0
"""Periods of an oscillation in each of two parts of the time, from which its decay can be seen."""

FOLLOWED = 0.05
"""A loop follows slopes if its mean error at the end of a constant set-point is at most this fraction of the step."""

CONSTANT = 0.5
"""Time before the end of a constant set-point over which the error is averaged [s]."""


def judge(
    t: Floats,
    reference: Floats,
    output: Floats,
    effort: Floats,
    *,
    course: Course,
    limits: PidLimits = NO_LIMITS,
    noise: float = 0.0,
    margins: Mapping[str, float] = MappingProxyType({}),
    others: Mapping[str, Floats] = MappingProxyType({}),
    keep: bool = True,
) -> Evaluation:
    """Evaluate the response of a test.

    Costs are taken from the step to the end; overshoot, rise and settling from the step to the load, the steady error
    over the last tenth before the load. The loop is unstable if a number is not finite, if the error exceeds ten steps,
    if the record has fewer than :data:`LEAST_SAMPLES` samples, or if its oscillation about a straight line in the last
    quarter of the time has an RMS above :data:`OSCILLATION` of the step, apart from noise, and does not decay: see
    :func:`_decays`. The same holds for `others`: the speed of a car is smooth even if its wheels slip in turns.

    If the set-point returns, the oscillation is also judged from the step to the return, and from there to the end,
    and the loop is unstable if it does not follow: see :data:`FOLLOWED`.

    Args:
        t: [s], shape (n,).
        reference: [y], shape (n,).
        output: [y], shape (n,).
        effort: [u], shape (n,).
        course: the test manoeuvre.
        limits: of the effort.
        noise: standard deviation of the measurement [y].
        margins: added to the figures.
        others: further signals that must not oscillate [y], each of shape (n,), by what oscillates.
        keep: whether the evaluation has the response.
    """
    columns = {"t": t, "reference": reference, "output": output, "effort": effort}
    response = pd.DataFrame(columns) if keep else None
    if not (np.isfinite(output).all() and np.isfinite(effort).all()):
        return Evaluation("unstable", response=response, reason="a number is not finite")
    # All bounds are relative to the step, as loops have different units and sizes.
    step = abs(course.step)
    error = reference - output
    # Noise of five standard deviations does not count as divergence.
    if np.abs(error).max(initial=0.0) > DIVERGED * step + 5.0 * noise:
        return Evaluation("unstable", response=response, reason="the error exceeds ten steps")
    # Oscillations of fewer samples cannot be judged; such a run has ended early.
    if len(t) < LEAST_SAMPLES:
        return Evaluation("unstable", response=response, reason=f"the run ended after {len(t)} samples")

    # Oscillation in the last half of the time, or after the load or the return of the set-point if that is later.
    middle, end = t[0] + 0.5 * (t[-1] - t[0]), t[-1]
    changes = [course.load_time] if course.load else []
    changes += [] if course.return_time is None else [course.return_time]
    begin = max([middle, *changes])
    later = 0.5 * (begin + end)
    at_limit = (effort >= limits.maximum) | (effort <= limits.minimum)
    # The transient of a change decays, and hides a sustained oscillation; an oscillation at a limit of the effort
    # shrinks to the size that the limit sustains. Then the later half has to decay as well, without limit.
    sustained = bool(at_limit[t >= later].any())
    begins = (begin, later) if begin > middle or at_limit[t >= begin].any() else (begin,)

    def dies(signal: Floats) -> bool:
        return not sustained and all(_decays(t[t >= start], signal[t >= start]) for start in begins)

    last, bound = t >= t[-1] - 0.25 * (t[-1] - t[0]), OSCILLATION * step + 2.0 * noise
    sizes = {name: _oscillation(t[last], signal[last]) for name, signal in {"": error, **others}.items()}
    oscillations = [
        (sizes[name], name)
        for name, signal in {"": error, **others}.items()
        if sizes[name] > bound and not dies(signal)
    ]
    decays = len(begins) == 1 and all(dies(signal) for signal in (error, *others.values()))
    if oscillations:
        # Report the largest of them.
        size, name = max(oscillations)
        reason = f"{name or 'the error'} oscillates at the end, RMS {size:.3g}, {size / step:.0%} of the step"
        return Evaluation("unstable", response=response, reason=reason, decays=decays)

    if course.return_time is not None:
        fault = _fault_on_slopes(t, error, others, course)
        if fault:
            return Evaluation("unstable", response=response, reason=fault)

    # Costs count the load, figures of the step do not.
    whole = t >= course.step_time - 1e-9

    # Times are sums of periods; the sample at the step must not be lost by rounding.
    first = whole & (t < course.load_time - 1e-9) if course.load != 0.0 else whole
    costs = response_figures(t[whole], reference[whole], output[whole], effort[whole], limits=limits)
    steps = response_figures(t[first], reference[first], output[first], effort[first], limits=limits)
    figures = {
        "iae": costs.iae, "itae": costs.itae, "ise": costs.ise, "overshoot_percent": 100.0 * steps.overshoot,
        "rise_time": steps.rise_time, "settling_time": steps.settling_time, "steady_error": steps.steady_error,
        "peak_effort": costs.peak_effort, "rms_effort": costs.rms_effort, "total_variation": costs.total_variation,
        "saturation_time": costs.saturation_time, "rms_jerk": costs.rms_jerk, "peak_jerk": costs.peak_jerk,
    }  # fmt: skip
    return Evaluation("ok", {**figures, **margins}, response, decays=decays)


def _fault_on_slopes(t: Floats, error: Floats, others: Mapping[str, Floats], course: Course) -> str:
    """Return why a loop does not follow the slopes to a set-point and back; empty if it does."""
    step, end = abs(course.step), float(t[-1])
    back = end if course.return_time is None else course.return_time
    for first, last, slope in ((course.step_time, back, "on the way to the set-point"), (back, end, "on the way back")):
        part = (t >= first) & (t <= last)
        for name, signal in others.items():
            size = _oscillation(t[part], signal[part])
            if size > OSCILLATION * step:
                return f"{name} oscillates {slope}: RMS {size:.3g}, {size / step:.2g} times the change of the set-point"
        left = abs(float(np.mean(error[part & (t > last - CONSTANT)])))
        if left > FOLLOWED * step:
            return f"the error at the end {slope} is {left:.3g}, {left / step:.0%} of the change of the set-point"
    return ""


def _oscillation(t: Floats, signal: Floats) -> float:
    """Return the standard deviation from the straight line that fits best."""
    past, change = t - np.mean(t), signal - np.mean(signal)
    line = (past @ change) / (past @ past) * past
    return float(np.sqrt(np.mean((change - line) ** 2)))


def _decays(t: Floats, signal: Floats) -> bool:
    """Return whether the envelope of an oscillation is smaller in the second half of the time than in the first.

    The square of the envelope is x² + (x' / ω)², with the frequency ω from the sizes of x' and x. Unlike that of x, its
    mean over a part of a period does not depend on the phase. The straight line that is subtracted contains a part of
    the oscillation, which changes the ratio of the envelopes by at most 3 / (ω L)² for halves of the length L, of one
    period at least: the line through a sustained sin(ω t + φ) has a rise of up to 3 / (ω L) over L. A ratio further
    below 1 is a decay.
    """
    past, change = t - np.mean(t), signal - np.mean(signal)
    x = change - (past @ change) / (past @ past) * past
    rate = np.gradient(x, past)
    size, speed = float(np.std(x)), float(np.std(rate))
    if size == 0.0 or speed == 0.0:
        return True
    angle = speed / size * 0.5 * float(t[-1] - t[0])
    if angle < 2.0 * np.pi * LEAST_PERIODS:
        return False
    square = x**2 + (size / speed * rate) ** 2
    sustained = 1.0 - 3.0 / angle**2
    return bool(np.mean(square[past >= 0.0]) < sustained**2 * np.mean(square[past < 0.0]))
