"""Candidates from models: the tuning rules, and loop shaping, each with a sentence on how it was found."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

from mirdrake.core.errors import MirdrakeError
from mirdrake.core.pid import PidGains
from mirdrake.tuning.gains import from_series
from mirdrake.tuning.identify import Identified
from mirdrake.tuning.margins import ultimate_point
from mirdrake.tuning.models import FirstOrder, Integrator, TransferFunction
from mirdrake.tuning.rules import (
    Form,
    amigo,
    lambda_tuning,
    simc,
    simc_double_integrator,
    ziegler_nichols_step,
    ziegler_nichols_ultimate,
)
from mirdrake.tuning.shaping import design_for_phase_margin, maximize_integral_gain

DIGITS = 4
"""Significant digits of gains."""

SOFTER = (1.5, 2.0)
"""Closed-loop times of SIMC besides its own [dead times]: softer, for constraints that its own does not keep."""


SOFTEST = (3.0, 4.0, 6.0, 8.0, 12.0, 16.0)
"""The same where no rule stands: as soft as it takes. A rule has no say on light wheels that lose their grip."""


@dataclass(frozen=True)
class Design:
    """Gains from a rule.

    Attributes:
        name: of the candidate.
        kind: baseline, rule, shaped, searched or scheduled.
        how: one sentence.
        gains: by name.
    """

    name: str
    kind: str
    how: str
    gains: dict[str, float]


def make_designs(found: Identified, *, max_sensitivity: float) -> tuple[list[Design], list[str]]:
    """Gains from all rules that fit the loop, and by loop shaping; and why others are left out.

    Half a period is added to the dead time, for the hold of the control. The derivative's filter is that of the loop,
    whatever the rule would take.

    Args:
        found: what the experiments gave.
        max_sensitivity: bound on Ms for the shaping [1].
    """
    return _made(_ways(found, max_sensitivity), tuple(found.spec.gains))


def softer_designs(found: Identified) -> list[Design]:
    """The rule of Skogestad with longer and longer closed-loop times: to compare with where no rule stands.

    Args:
        found: what the experiments gave.
    """
    return _made(_skogestad(found, SOFTEST), tuple(found.spec.gains))[0]


_Way = tuple[str, str, str, Callable[[], PidGains]]


def _made(ways: Iterable[_Way], names: Sequence[str]) -> tuple[list[Design], list[str]]:
    """Designs with gains of these names, none twice; and why others are left out."""
    notes: list[str] = []
    designs: list[Design] = []
    for name, kind, how, make in ways:
        try:
            pid = make()
        except MirdrakeError as error:
            notes.append(f"{name}: {error}")
            continue
        given = {"kp": pid.kp, "ki": pid.ki, "kd": pid.kd}
        if (pid.kd and "kd" not in names) or not all(math.isfinite(x) and x >= 0.0 for x in given.values()):
            continue
        gains = {gain: float(f"{given[gain]:.{DIGITS}g}") for gain in names}
        if gains not in [design.gains for design in designs]:
            designs.append(Design(name, kind, how, gains))
    return designs, notes


def _ways(found: Identified, bound: float) -> Iterator[_Way]:
    spec = found.spec
    half = 0.5 * float(spec.options["period"])
    main = TransferFunction(
        tuple(spec.models["main"]["numerator"]),
        tuple(spec.models["main"]["denominator"]),
        spec.models["main"]["delay"] + half,
    )
    forms: tuple[Form, ...] = ("PI", "PID")
    if found.first is not None:
        first = _later(found.first, half)
        wide = 3.0 * first.delay
        for form in forms:
            yield (
                f"Ziegler-Nichols step {form}",
                "rule",
                "step response rule, from the identified model",
                partial(ziegler_nichols_step, first, form),
            )
        yield "SIMC", "rule", "Skogestad's rule, closed-loop time equal to the dead time", partial(simc, first)
        for times in SOFTER:
            how = f"Skogestad's rule, closed-loop time of {times:g} dead times"
            slow = times * first.delay
            yield f"SIMC {times:g}", "rule", how, partial(simc, first, closed_loop_time=slow)
        for form in forms:
            yield (f"AMIGO {form}", "rule", "AMIGO rule, made for Ms 1.4", partial(amigo, first, form))
        yield (
            f"lambda {wide:.3g} s",
            "rule",
            "lambda tuning, closed-loop time of three dead times",
            partial(lambda_tuning, first, wide),
        )
    if found.lag and isinstance(found.first, Integrator):
        velocity, delay = found.first.gain, found.first.delay - 0.5 * found.lag + half
        for times in (1.0, *SOFTER):
            yield (
                f"SIMC lag {times:g}",
                "rule",
                f"Skogestad's rule for an integrator with lag, closed-loop time of {times:g} dead times",
                partial(_integrator_with_lag, velocity, delay, found.lag, times * delay),
            )
            yield (
                f"SIMC lag PD {times:g}",
                "rule",
                f"the same with closed-loop time of {times:g} dead times, without its integral part: no overshoot",
                partial(_integrator_with_lag, velocity, delay, found.lag, times * delay, integral=False),
            )
    if found.relay is not None and found.first is not None:
        relay = found.relay
        for form in forms:
            yield (
                f"Ziegler-Nichols relay {form}",
                "rule",
                "frequency response rule, from the relay's limit cycle",
                partial(ziegler_nichols_ultimate, relay.ultimate_gain, relay.ultimate_period, form),
            )
    if found.inertial is not None:
        gain, delay = found.inertial[0], found.inertial[1] + half
        for times in (1.0, 2.0, 3.0):
            yield (
                f"SIMC inertia {times:g}",
                "rule",
                f"Skogestad's rule for a double integrator, closed-loop time of {times:g} dead times",
                partial(simc_double_integrator, gain, delay, closed_loop_time=times * delay),
            )
        for times in (1.0, *SOFTER, 3.0):
            yield (
                f"SIMC inertia PD {times:g}",
                "rule",
                f"the same with closed-loop time of {times:g} dead times, without its integral part: no overshoot",
                partial(_without_integral, gain, delay, times * delay),
            )
        yield (
            "Ziegler-Nichols PID",
            "rule",
            "frequency response rule, at the model's own ultimate point",
            partial(_ultimate, main),
        )
    for derivative, form in ((False, "PI"), (True, "PID")):
        yield (
            f"shaped {form}",
            "shaped",
            f"largest integral gain for which Ms stays below {bound:g}",
            partial(maximize_integral_gain, main, max_sensitivity=bound, derivative=derivative),
        )
    crossover = 0.35 / max(main.delay, 1e-3)
    for derivative, form in ((False, "PI"), (True, "PID")):
        yield (
            f"phase margin {form}",
            "shaped",
            f"60° of phase margin at {crossover:.3g} rad/s",
            partial(design_for_phase_margin, main, crossover, derivative=derivative),
        )


def _skogestad(found: Identified, times: Sequence[float]) -> Iterator[_Way]:
    """Skogestad's rule for the model that fits best, without an integral part where the plant has one."""
    half = 0.5 * float(found.spec.options["period"])
    for many in times:
        how = f"Skogestad's rule, softened to a closed-loop time of {many:g} dead times, as no faster rule stands"
        if found.inertial is not None:
            gain, delay = found.inertial[0], found.inertial[1] + half
            yield f"SIMC inertia PD {many:g}", "rule", how, partial(_without_integral, gain, delay, many * delay)
        elif found.lag and isinstance(found.first, Integrator):
            velocity, delay = found.first.gain, found.first.delay - 0.5 * found.lag + half
            make = partial(_integrator_with_lag, velocity, delay, found.lag, many * delay, integral=False)
            yield f"SIMC lag PD {many:g}", "rule", how, make
        elif found.first is not None:
            first = _later(found.first, half)
            yield f"SIMC {many:g}", "rule", how, partial(simc, first, closed_loop_time=many * first.delay)


def _later(model: FirstOrder | Integrator, by: float) -> FirstOrder | Integrator:
    """The model with more dead time [s]."""
    return replace(model, delay=model.delay + by)


def _without_integral(gain: float, delay: float, closed_loop_time: float) -> PidGains:
    """SIMC for a double integrator, the series form's PD part: two equal real poles, so that a step does not overshoot.

    Kc (1 + τD s) with Kc = 1 / (4 gain (τc + L)²), τD = 4 (τc + L); see
    :func:`mirdrake.tuning.rules.simc_double_integrator`.
    """
    total = closed_loop_time + delay
    kp = 1.0 / (4.0 * gain * total**2)
    return PidGains(kp, 0.0, 4.0 * total * kp)


def _integrator_with_lag(
    gain: float, delay: float, lag: float, closed_loop_time: float, *, integral: bool = True
) -> PidGains:
    """SIMC for ``gain exp(-L s) / (s (1 + T2 s))``: series PID, Kc = 1/(gain (τc + L)), τI = 4 (τc + L), τD = T2.

    Source: Skogestad (2003), table 1. Without the integral part it is the series form's PD part.
    """
    total = closed_loop_time + delay
    kp = 1.0 / (gain * total)
    return from_series(kp, 4.0 * total, lag) if integral else PidGains(kp, 0.0, kp * lag)


def _ultimate(main: TransferFunction) -> PidGains:
    point = ultimate_point(main)
    if point is None:
        raise MirdrakeError("the phase never reaches -180°")
    return ziegler_nichols_ultimate(point.gain, point.period, "PID")
