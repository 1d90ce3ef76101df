"""Gains against the present ones in every manoeuvre that a speed loop is used for, on the reduced model.

A mean over a test may improve although a part of it gets worse, and other courses consist of that part. The derivative
of the measured speed is an example. It reduces the overshoot after a ramp of a loop with dead time, but it brakes with
the torque kd a / r on each slope a of the set-point, and the feed-forward of the slope does not contain this torque. In
a loop without dead time, as in a diagram, only the loss remains.

Therefore the largest ratio of the IAE counts (minimax). The manoeuvres are a launch from standstill against the
resistances and a stop, each with several slopes of the set-point, and the step and the load of the study's test; all
of them without dead time, with the nominal one and with the longest one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mirdrake.tuning.loops.base import Conditions, Course, LoopSpec
from mirdrake.tuning.loops.reduced import model_of, pid_of, reduced_test, simulate_reduced

OVER_PRESENT = "over_present"
"""Figure: the largest ratio of the IAE of gains to that of the present ones in a manoeuvre [1]."""

MOST_OVER_PRESENT = 1.02
"""Limit of it [1]."""

NEGLIGIBLE = 0.01
"""Cost that has no effect, over the largest one of the present gains [1]."""

HOLD = 5.0
"""Time for which the set-point is constant after a slope [s]."""


@dataclass(frozen=True)
class Manoeuvre:
    """A test whose parts are compared.

    Attributes:
        spec: a loop with its model and test manoeuvre.
        conditions: of the test.
        begin: of the first part [s].
        change: end of the first part, and begin of the second one [s]; the second one ends with the test.
    """

    spec: LoopSpec
    conditions: Conditions
    begin: float
    change: float


def make_manoeuvres(spec: LoopSpec, own: LoopSpec, delays: Sequence[float]) -> tuple[Manoeuvre, ...]:
    """Return launch, stop, step and load with each dead time.

    Args:
        spec: the loop of the study.
        own: the same with the vehicle's own slopes of the set-point, which are the steepest ones.
        delays: of the actuator [s]; that of a diagram is negative, see :func:`mirdrake.tuning.loops.slip.direct`.
    """
    model, _ = model_of(spec)
    steepest, _ = model_of(own)
    course = spec.course
    made = []
    # The reduced model does not slip, and its copies are smaller without the tyres.
    plain = replace(model, slip=None)
    for delay in delays:
        conditions = Conditions(delay=delay)
        change = course.load_time if course.load else course.duration
        made.append(Manoeuvre(replace(spec, model=plain), conditions, course.step_time, change))
        # Slopes of the study, of the vehicle, and their geometric mean.
        for part in (0.0, 0.5, 1.0):
            rise = float(model.rise ** (1.0 - part) * steepest.rise**part)
            fall = float(model.fall ** (1.0 - part) * steepest.fall**part)
            top = model.start + max(course.step, 0.0)
            stop = top / rise + HOLD
            slopes = Course(
                speed=0.0, step=top, step_time=0.0, load=0.0, load_time=0.0, duration=stop + top / fall + HOLD,
                return_time=stop,
            )  # fmt: skip
            driven = replace(spec, model=replace(plain, start=0.0, rise=rise, fall=fall), course=slopes)
            made.append(Manoeuvre(driven, conditions, 0.0, stop))
    return tuple(made)


def manoeuvre_costs(manoeuvres: Sequence[Manoeuvre], gains: Mapping[str, float]) -> tuple[float, ...]:
    """Return the IAE of gains in the parts of manoeuvres [y s]; inf where the output grows without bound.

    The error is that against the set-point that the controller gets, which has moved by one period at a sample.
    """
    costs = []
    for manoeuvre in manoeuvres:
        spec = manoeuvre.spec
        model, period = model_of(spec)
        test = reduced_test(spec, manoeuvre.conditions)
        output, _, stable = simulate_reduced(spec, pid_of(spec, gains), test, manoeuvre.conditions)
        error = np.abs(test.wanted / model.scale + model.start - output)
        later = test.t >= manoeuvre.change - 1e-9
        first = (test.t >= manoeuvre.begin - 1e-9) & ~later
        for part in (first, later):
            cost = float(np.sum(error[part]) * period)
            costs.append(cost if stable and np.isfinite(cost) else np.inf)
    return tuple(costs)


def largest_ratio(costs: Sequence[float], others: Sequence[float]) -> float:
    """Return the largest ratio of costs to others, where the others are finite [1]; 0 without one.

    Costs below :data:`NEGLIGIBLE` of the largest other one count as that: an ideal feed-forward has no cost.
    """
    pairs = [(cost, other) for cost, other in zip(costs, others, strict=True) if other < np.inf]
    least = NEGLIGIBLE * max((other for _, other in pairs), default=0.0)
    return max((max(cost, least) / max(other, least, 1e-300) for cost, other in pairs), default=0.0)
