"""From a response to its figures, and whether the loop is stable."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd

from mirdrake.core.pid import NO_LIMITS, PidLimits
from mirdrake.tuning.figures import response_figures
from mirdrake.tuning.loops.base import Evaluation
from mirdrake.tuning.models import Floats

SWING = 0.1
"""A loop is unstable if its error swings at the end by more than this part of the step, root mean square."""

AWAY = 10.0
"""A loop is unstable if its error grows beyond so many steps."""

DYING = 0.6
"""A swing that has shrunk to this part from one quarter of the time to the next dies out."""


def judge(
    t: Floats,
    reference: Floats,
    output: Floats,
    effort: Floats,
    *,
    course: dict[str, Any],
    limits: PidLimits = NO_LIMITS,
    noise: float = 0.0,
    margins: dict[str, float] | None = None,
    others: Mapping[str, Floats] = MappingProxyType({}),
) -> Evaluation:
    """Figures of a trial.

    Costs are taken from the step to the end; overshoot, rise and settling from the step to the load, the steady error
    over the last tenth before the load. The loop is unstable if a number is not finite, if the error leaves ten steps,
    or if, without its straight line, it swings over the last quarter of the time by more than :data:`SWING` of the
    step, noise aside, and the swing does not die out. Of `others` the swing counts alike: where the wheels of a car
    slip in turns its speed is smooth.

    Args:
        t: [s], shape (n,).
        reference: [y], shape (n,).
        output: [y], shape (n,).
        effort: [u], shape (n,).
        course: see :func:`mirdrake.tuning.loops.make.make_course`.
        limits: of the effort.
        noise: standard deviation of the measurement [y].
        margins: figures to add.
        others: signals that must not swing either [y], each of shape (n,), by what swings then.
    """
    response = pd.DataFrame({"t": t, "reference": reference, "output": output, "effort": effort})
    if not (np.isfinite(output).all() and np.isfinite(effort).all()) or len(t) < 20:
        return Evaluation("unstable", response=response, reason="a number is not finite")
    step = abs(float(course["step"]))
    error = reference - output
    if np.abs(error).max() > AWAY * step + 5.0 * noise:
        return Evaluation("unstable", response=response, reason="the error grows beyond ten steps")
    span = t[-1] - t[0]
    last, before = t >= t[-1] - 0.25 * span, (t >= t[-1] - 0.5 * span) & (t < t[-1] - 0.25 * span)
    bound = SWING * step + 2.0 * noise
    found = []
    for name, signal in {"": error, **others}.items():
        early, swing = _swing(t[before], signal[before]), _swing(t[last], signal[last])
        if swing > bound and (swing > DYING * early or swing > 5.0 * bound):
            found.append((swing, name))
    if found:
        swing, name = max(found)
        words = f"{name} swings at the end by {swing:.3g}, {swing / step:.0%} of the step".strip()
        return Evaluation("unstable", response=response, reason=words)
    whole = t >= course["step_time"] - 1e-9
    loaded = course["load"] != 0.0
    first = whole & (t < course["load_time"] - 1e-9) if loaded else whole
    costs = response_figures(t[whole], reference[whole], output[whole], effort[whole], limits=limits)
    steps = response_figures(t[first], reference[first], output[first], effort[first], limits=limits)
    figures = {
        "iae": costs.iae, "itae": costs.itae, "ise": costs.ise, "overshoot_percent": 100.0 * steps.overshoot,
        "rise_time": steps.rise_time, "settling_time": steps.settling_time, "steady_error": steps.steady_error,
        "peak_effort": costs.peak_effort, "rms_effort": costs.rms_effort, "total_variation": costs.total_variation,
        "saturation_time": costs.saturation_time, "rms_jerk": costs.rms_jerk, "peak_jerk": costs.peak_jerk,
    }  # fmt: skip
    return Evaluation("ok", {**figures, **(margins or {})}, response)


def _swing(t: Floats, signal: Floats) -> float:
    """Standard deviation from the straight line."""
    return float(np.std(signal - np.polyval(np.polyfit(t, signal, 1), t)))
