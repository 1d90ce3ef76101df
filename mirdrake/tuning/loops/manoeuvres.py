"""Gains against the present ones in every manoeuvre that a speed loop is used for, on the reduced model.

A mean over a test may improve although a part of it gets worse, and other courses consist of that part. The derivative
of the measured speed is an example. It reduces the overshoot after a ramp of a loop with dead time, but it brakes with
the torque kd a / r on each slope a of the set-point, and the feed-forward of the slope does not contain this torque. In
a loop without dead time, as in a diagram, only the loss remains.

Therefore the largest ratio of the IAE counts (minimax), for both ways to measure it: against the set-point that the
controller holds, and as a recording shows it, at the samples just before the set-point changes. The latter allows a lag
by one period on a ramp. Gains must not be worse in either way.

The manoeuvres are a launch against the resistances and a stop, each with several slopes of the set-point, and the step
and the load of the study's test. Launch and stop are from a low speed and back to it: on the linear model that is the
same as from standstill, where the resistances of the plant reverse. All manoeuvres are compared with the nominal dead
time and without one; with a servo only without one, because a servo has none. Longer ones of the Monte Carlo do not
count: there, slow gains are always better, and stability is what matters.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mirdrake.tuning.figures import held_errors
from mirdrake.tuning.loops.base import Conditions, Course, Evaluation, LoopSpec
from mirdrake.tuning.loops.reduced import model_of, pid_of, reduced_test, simulate_reduced
from mirdrake.tuning.models import Floats

OVER_PRESENT = "over_present"
"""Figure: the largest ratio of the IAE of gains to that of the present ones in a manoeuvre [1]."""

MOST_OVER_PRESENT = 1.02
"""Limit of it [1]."""

NEGLIGIBLE = 0.01
"""Cost that has no effect, over the largest one of the present gains [1]."""

FAILED = (np.inf,) * 4
"""Costs of the parts of a manoeuvre in which the output grows without bound."""

HOLD = 3.0
"""Time that is added after a slope, in which the error decays [s]."""


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


def make_manoeuvres(
    spec: LoopSpec, own: LoopSpec, delays: Sequence[float], at_slopes: Callable[[LoopSpec, float, float], LoopSpec]
) -> tuple[Manoeuvre, ...]:
    """Return launch, stop, step and load with each dead time.

    Args:
        spec: the loop of the study.
        own: the same with the vehicle's own slopes of the set-point, which are the steepest ones.
        delays: of the actuator [s]; that of a diagram is negative, see :func:`mirdrake.tuning.loops.slip.direct`.
        at_slopes: see :meth:`mirdrake.tuning.loops.kind.LoopKind.at_slopes`.
    """
    course = spec.course
    parts = [Manoeuvre(spec, Conditions(), course.step_time, course.load_time if course.load else course.duration)]
    gentle, steep = slopes_of(spec), slopes_of(own)
    # Slopes of the study, of the vehicle, and their geometric mean.
    for share in (0.0, 0.5, 1.0):
        rise, fall = (low ** (1.0 - share) * high**share for low, high in zip(gentle, steep, strict=True))
        driven = at_slopes(spec, rise, fall)
        change = (driven.course.return_time or 0.0) - driven.course.step_time + HOLD
        duration = change + driven.course.duration - (driven.course.return_time or 0.0) + HOLD
        slopes = replace(driven.course, step_time=0.0, return_time=change, duration=duration)
        parts.append(Manoeuvre(replace(driven, course=slopes), Conditions(), 0.0, change))
    # The reduced model does not slip, and its copies are smaller without the tyres.
    plain = [replace(part, spec=replace(part.spec, model=replace(model_of(part.spec)[0], slip=None))) for part in parts]
    return tuple(replace(part, conditions=Conditions(delay=delay)) for delay in delays for part in plain)


def slopes_of(spec: LoopSpec) -> tuple[float, float]:
    """Return the slopes of the set-point of a loop, up and down [m/s²]."""
    limits = spec.diagram["vehicles"][spec.vehicle]["control"]["speed"]
    return float(limits["max_acceleration"]), float(limits["max_deceleration"])


def manoeuvre_costs(manoeuvres: Sequence[Manoeuvre], gains: Mapping[str, float]) -> tuple[float, ...]:
    """Return the IAE of gains in the parts of manoeuvres, on the reduced model [y s]; inf if it grows without bound.

    The integral is that of :func:`mirdrake.tuning.figures.response_figures`.
    """
    costs: list[float] = []
    for manoeuvre in manoeuvres:
        spec = manoeuvre.spec
        test = reduced_test(spec, manoeuvre.conditions)
        output, _, stable = simulate_reduced(spec, pid_of(spec, gains), test, manoeuvre.conditions)
        costs += _part_costs(manoeuvre, test.t, test.reference, output) if stable else FAILED
    return tuple(costs)


def plant_costs(manoeuvres: Sequence[Manoeuvre], drive: Callable[[LoopSpec], Evaluation]) -> tuple[float, ...]:
    """Return the IAE of a controller without dead time in the parts of manoeuvres, on the plant [y s].

    A servo is part of the plant and does not wait for the delay of an actuator: conditions have no effect on it.

    Args:
        manoeuvres: their parts are driven once.
        drive: drives the test of a loop, and keeps its response.
    """
    known: dict[tuple[float, float, Course], tuple[float, ...]] = {}
    costs: list[float] = []
    for manoeuvre in manoeuvres:
        key = (*slopes_of(manoeuvre.spec), manoeuvre.spec.course)
        if key not in known:
            result, columns = drive(manoeuvre.spec), ("t", "reference", "output")
            known[key] = FAILED
            if result.status == "ok" and result.response is not None:
                known[key] = _part_costs(manoeuvre, *(result.response[name].to_numpy() for name in columns))
        costs += known[key]
    return tuple(costs)


def _part_costs(manoeuvre: Manoeuvre, t: Floats, reference: Floats, output: Floats) -> tuple[float, ...]:
    """Return the IAE in both parts of a manoeuvre, against the held set-point and at the samples, shape (4,) [y s]."""
    begin, end = held_errors(reference, output)
    steps, begins = np.diff(t), t[:-1]
    later = begins >= manoeuvre.change - 1e-9
    first = (begins >= manoeuvre.begin - 1e-9) & ~later
    costs = [float(np.sum((sizes * steps)[part])) for sizes in (0.5 * (begin + end), end) for part in (first, later)]
    return tuple(costs) if np.isfinite(costs).all() else FAILED


def largest_ratio(costs: Sequence[float], others: Sequence[float]) -> float:
    """Return the largest ratio of costs to others, where the others are finite [1]; 0 without one.

    Costs below :data:`NEGLIGIBLE` of the largest other one count as that: an ideal feed-forward has no cost.
    """
    pairs = [(cost, other) for cost, other in zip(costs, others, strict=True) if other < np.inf]
    least = NEGLIGIBLE * max((other for _, other in pairs), default=0.0)
    return max((max(cost, least) / max(other, least, 1e-300) for cost, other in pairs), default=0.0)
