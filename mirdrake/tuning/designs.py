"""Candidates by design: tuning rules and loop shaping, applied to an identified loop.

A new rule is one function that yields its solutions and one line in :data:`DESIGN_RULES`.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

from mirdrake.core.errors import MirdrakeError
from mirdrake.core.pid import PidGains
from mirdrake.tuning.gains import from_series
from mirdrake.tuning.identify import Identification
from mirdrake.tuning.loops.base import LoopSpec
from mirdrake.tuning.loops.reduced import model_of, outer_factor
from mirdrake.tuning.margins import ultimate_point
from mirdrake.tuning.models import FirstOrder, Integrator, TransferFunction
from mirdrake.tuning.relay import RelayResult
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

FAST = (1.0, 1.5, 2.0)
"""Closed-loop times of SIMC that are tried first [dead times]."""

SLOW = (3.0, 4.0, 6.0, 8.0, 12.0, 16.0)
"""Closed-loop times of SIMC that are tried if no rule is robust [dead times].

No rule considers light wheels that lose their grip.
"""

FORMS: tuple[Form, Form] = ("PI", "PID")

Kind = Literal["baseline", "rule", "shaped", "searched", "scheduled"]


@dataclass(frozen=True)
class Design:
    """A set of gains and its origin.

    Attributes:
        name: of the candidate.
        kind: baseline, rule, shaped (loop shaping), searched or scheduled.
        gains: by name.
        rule: name in :data:`DESIGN_RULES`; empty for other kinds.
        parameter: of the rule, see its description; None if it has none.
    """

    name: str
    kind: Kind
    gains: dict[str, float]
    rule: str = ""
    parameter: float | None = None


@dataclass(frozen=True)
class OmittedDesign:
    """A design that does not exist for a loop.

    Attributes:
        name: of the design.
        reason: one line.
    """

    name: str
    reason: str


@dataclass(frozen=True)
class DesignModel:
    """Identified loop as rules need it; half a period for the hold of the effort is in all dead times.

    Attributes:
        main: transfer function; None if only the rules for a double integrator fit the loop.
        first: first order with delay, or an integrator.
        lagged: `first` without the half of its lag in the dead time, and the lag [s].
        inertial: gain [y/(u s²)] and delay [s] of a double integrator.
        relay: result of the relay test.
        max_sensitivity: bound on Ms for loop shaping [1].
    """

    main: TransferFunction | None
    first: FirstOrder | Integrator | None
    lagged: tuple[FirstOrder | Integrator, float] | None
    inertial: tuple[float, float] | None
    relay: RelayResult | None
    max_sensitivity: float


Solution = tuple[str, float | None, Callable[[], PidGains]]
"""Name of the candidate, parameter, and a call that returns the gains, or raises MirdrakeError if there are none."""


@dataclass(frozen=True)
class DesignRule:
    """Tuning rule, or method of loop shaping.

    Attributes:
        name: of the rule.
        description: one sentence; ``{parameter:g}`` is replaced.
        solutions: yields the solutions for a loop; none if the rule does not fit it.
        kind: of its designs.
    """

    name: str
    description: str
    solutions: Callable[[DesignModel], Iterator[Solution]]
    kind: Kind = "rule"


def _ziegler_nichols_step(model: DesignModel) -> Iterator[Solution]:
    if model.first is not None:
        for form in FORMS:
            yield f"Ziegler-Nichols step {form}", None, partial(ziegler_nichols_step, model.first, form)


def _simc(model: DesignModel, times: Sequence[float] = FAST) -> Iterator[Solution]:
    if model.first is not None:
        for time in times:
            name = "SIMC" if time == 1.0 else f"SIMC {time:g}"
            yield name, time, partial(simc, model.first, closed_loop_time=time * model.first.delay)


def _amigo(model: DesignModel) -> Iterator[Solution]:
    if model.first is not None:
        for form in FORMS:
            yield f"AMIGO {form}", None, partial(amigo, model.first, form)


def _lambda(model: DesignModel) -> Iterator[Solution]:
    if model.first is not None:
        time = 3.0 * model.first.delay
        yield f"lambda {time:.3g} s", time, partial(lambda_tuning, model.first, time)


def _simc_lag(model: DesignModel, times: Sequence[float] = FAST) -> Iterator[Solution]:
    if model.lagged is not None:
        for time in times:
            yield f"SIMC lag {time:g}", time, partial(_with_lag, *model.lagged, time)
            yield from _simc_lag_pd(model, (time,))


def _simc_lag_pd(model: DesignModel, times: Sequence[float]) -> Iterator[Solution]:
    # Without an integral part only an integrator reaches its set-point.
    if model.lagged is not None and isinstance(model.lagged[0], Integrator):
        for time in times:
            yield f"SIMC lag PD {time:g}", time, partial(_with_lag, *model.lagged, time, integral=False)


def _relay(model: DesignModel) -> Iterator[Solution]:
    if model.relay is not None and model.first is not None:
        gain, period = model.relay.ultimate_gain, model.relay.ultimate_period
        for form in FORMS:
            yield f"Ziegler-Nichols relay {form}", None, partial(ziegler_nichols_ultimate, gain, period, form)


def _simc_inertia(model: DesignModel) -> Iterator[Solution]:
    if model.inertial is not None:
        gain, delay = model.inertial
        for time in (1.0, 2.0, 3.0):
            solve = partial(simc_double_integrator, gain, delay, closed_loop_time=time * delay)
            yield f"SIMC inertia {time:g}", time, solve
        yield from _simc_inertia_pd(model, (*FAST, 3.0))


def _simc_inertia_pd(model: DesignModel, times: Sequence[float]) -> Iterator[Solution]:
    if model.inertial is not None:
        gain, delay = model.inertial
        for time in times:
            yield f"SIMC inertia PD {time:g}", time, partial(_double_integrator_pd, gain, delay, time * delay)


def _ultimate(model: DesignModel) -> Iterator[Solution]:
    if model.inertial is not None and model.main is not None:
        yield "Ziegler-Nichols PID", None, partial(_ultimate_gains, model.main)


def _largest_integral_gain(model: DesignModel) -> Iterator[Solution]:
    if model.main is None:
        return
    bound = model.max_sensitivity
    for form in FORMS:
        solve = partial(maximize_integral_gain, model.main, max_sensitivity=bound, derivative=form == "PID")
        yield f"shaped {form}", bound, solve


def _phase_margin(model: DesignModel) -> Iterator[Solution]:
    if model.main is None:
        return
    crossover = 0.35 / max(model.main.delay, 1e-3)
    for form in FORMS:
        solve = partial(design_for_phase_margin, model.main, crossover, derivative=form == "PID")
        yield f"phase margin {form}", crossover, solve


DESIGN_RULES: dict[str, DesignRule] = {
    rule.name: rule
    for rule in (
        DesignRule(
            "ziegler_nichols_step", "step response rule of Ziegler and Nichols, identified model", _ziegler_nichols_step
        ),
        DesignRule("simc", "Skogestad's rule, closed-loop time of {parameter:g} dead times", _simc),
        DesignRule("amigo", "AMIGO rule, which aims at Ms 1.4", _amigo),
        DesignRule("lambda", "lambda tuning, closed-loop time of {parameter:.3g} s, three dead times", _lambda),
        DesignRule(
            "simc_lag",
            "Skogestad's rule for an integrator or a first order with a second lag, closed-loop time of {parameter:g} "
            "dead times; PD: without the integral part, so that a step does not overshoot",
            _simc_lag,
        ),
        DesignRule("ziegler_nichols_relay", "frequency response rule of Ziegler and Nichols, relay feedback", _relay),
        DesignRule(
            "simc_inertia",
            "Skogestad's rule for a double integrator, closed-loop time of {parameter:g} dead times; PD: without the "
            "integral part, so that a step does not overshoot",
            _simc_inertia,
        ),
        DesignRule(
            "ziegler_nichols_ultimate",
            "frequency response rule of Ziegler and Nichols, ultimate point of the identified model",
            _ultimate,
        ),
        DesignRule(
            "largest_integral_gain",
            "largest integral gain with Ms of at most {parameter:g}",
            _largest_integral_gain,
            kind="shaped",
        ),
        DesignRule(
            "phase_margin", "phase margin of 60° at a crossover of {parameter:.3g} rad/s", _phase_margin, kind="shaped"
        ),
    )
}
"""Rules by name, in the order of their candidates."""


def make_designs(
    identification: Identification, *, max_sensitivity: float
) -> tuple[tuple[Design, ...], tuple[OmittedDesign, ...]]:
    """Return the designs of all rules that fit a loop, and those that have no solution.

    The filter of the derivative is that of the loop, whatever a rule would use. A loop whose gains no rule gives has no
    designs.

    Args:
        identification: result of the experiments.
        max_sensitivity: bound on Ms for loop shaping [1].
    """
    if not identification.loop.has_rules:
        return (), ()
    model = design_model(identification, max_sensitivity)
    named_solutions = ((rule, solution) for rule in DESIGN_RULES.values() for solution in rule.solutions(model))
    return _solve(named_solutions, identification.loop)


def slower_designs(identification: Identification) -> tuple[Design, ...]:
    """Return designs of Skogestad's rule with increasing closed-loop times, for a loop for which no rule is robust."""
    if not identification.loop.has_rules:
        return ()
    model = design_model(identification, 1.4)
    if model.inertial is not None:
        rule, solutions = "simc_inertia", _simc_inertia_pd(model, SLOW)
    elif model.lagged is not None:
        integrates = isinstance(model.lagged[0], Integrator)
        rule, solutions = "simc_lag", (_simc_lag_pd if integrates else _simc_lag)(model, SLOW)
    else:
        rule, solutions = "simc", _simc(model, SLOW)
    return _solve(((DESIGN_RULES[rule], solution) for solution in solutions), identification.loop)[0]


def design_model(identification: Identification, max_sensitivity: float) -> DesignModel:
    """Return an identified loop as rules need it."""
    # Without a transfer function the dead time is that of the whole loop, with all holds.
    if identification.loop.model is None:
        return DesignModel(None, None, None, identification.inertial, None, max_sensitivity)
    # Rules count the zero-order hold of a sampled controller as half a period of dead time.
    model, period = model_of(identification.loop)
    outer = 1.0 if model.outer is None else 1.0 + model.outer.kp  # the speed loop adds to the gain of the loop
    hold, first = (
        0.5 * period,
        identification.first and replace(identification.first, gain=outer * identification.first.gain),
    )
    main = model.plants["main"] * outer_factor(model, outer - 1.0, 0.0)
    # The ultimate gain of the loop with the speed loop around it is smaller by the gain of that.
    relay = identification.relay and replace(
        identification.relay, ultimate_gain=identification.relay.ultimate_gain / outer
    )
    lagged = None
    # `first` has half of the lag as dead time (half rule); for the rule with a lag it is removed again.
    if identification.lag and first is not None:
        lag = identification.lag
        lagged = (replace(first, delay=first.delay - 0.5 * lag + hold), lag)
    return DesignModel(
        main=replace(main, delay=main.delay + hold),
        first=None if first is None else replace(first, delay=first.delay + hold),
        lagged=lagged,
        inertial=None
        if identification.inertial is None
        else (identification.inertial[0], identification.inertial[1] + hold),
        relay=relay,
        max_sensitivity=max_sensitivity,
    )


def rounded(gains: dict[str, float]) -> dict[str, float]:
    """Return gains with the digits that are reported."""
    return {name: float(f"{value:.{DIGITS}g}") for name, value in gains.items()}


def _solve(
    named_solutions: Iterable[tuple[DesignRule, Solution]], loop: LoopSpec
) -> tuple[tuple[Design, ...], tuple[OmittedDesign, ...]]:
    """Return designs with the gains of a loop, each set of gains once, and those that have no solution."""
    designs: list[Design] = []
    omitted: list[OmittedDesign] = []
    for rule, (name, parameter, solve) in named_solutions:
        # A rule without a solution is not an error of the study: it is reported as omitted.
        try:
            pid = solve()
        except MirdrakeError as error:
            omitted.append(OmittedDesign(name, str(error)))
            continue
        values = loop.gains_of(pid)
        # Gains that are negative or infinite are not candidates.
        if values is None or not all(math.isfinite(x) and x >= 0.0 for x in values.values()):
            continue
        # Rules that agree after rounding are one candidate, with the name of the first.
        gains = rounded(values)
        if gains not in [design.gains for design in designs]:
            designs.append(Design(name, rule.kind, gains, rule.name, parameter))
    return tuple(designs), tuple(omitted)


def _double_integrator_pd(gain: float, delay: float, closed_loop_time: float) -> PidGains:
    """Return the PD part of the series form of SIMC for a double integrator, which does not overshoot.

    Kc (1 + τD s) with Kc = 1 / (4 gain (τc + L)²), τD = 4 (τc + L), two equal real poles; see
    :func:`mirdrake.tuning.rules.simc_double_integrator`.
    """
    total = closed_loop_time + delay
    kp = 1.0 / (4.0 * gain * total**2)
    return PidGains(kp, 0.0, 4.0 * total * kp)


def _with_lag(model: FirstOrder | Integrator, lag: float, times: float, *, integral: bool = True) -> PidGains:
    """Return SIMC for a model with a second lag, ``1 / (1 + T2 s)``.

    Series PID: Kc and τI of :func:`mirdrake.tuning.rules.simc` with τc = `times` dead times, τD = T2; without integral
    part its PD part. Source: Skogestad (2003), table 1.
    """
    total = times * model.delay + model.delay
    if isinstance(model, Integrator):
        kp, reset = 1.0 / (model.gain * total), 4.0 * total
    else:
        kp, reset = model.time_constant / (model.gain * total), min(model.time_constant, 4.0 * total)
    return from_series(kp, reset, lag) if integral else PidGains(kp, 0.0, kp * lag)


def _ultimate_gains(main: TransferFunction) -> PidGains:
    point = ultimate_point(main)
    if point is None:
        raise MirdrakeError("the phase never reaches -180°")
    return ziegler_nichols_ultimate(point.gain, point.period, "PID")
