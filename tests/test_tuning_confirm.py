"""Stability margins of a model are not reported if the plant does not confirm them."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pandas as pd
import pytest

from mirdrake.core.pid import NO_LIMITS, PidGains, PidLimits
from mirdrake.tuning import LinearProcess, TransferFunction, find_margins, simulate_loop
from mirdrake.tuning.confirm import ABOVE, LEAST, Call, confirm_margins
from mirdrake.tuning.loops.base import NOMINAL, Conditions, Course, Evaluation, Fidelity
from mirdrake.tuning.loops.blocks import LONGEST
from mirdrake.tuning.loops.judge import judge
from mirdrake.tuning.spec import breaks_limit

PERIOD, DEAD_TIME = 0.01, 0.1
GAINS = {"kp": 4.0, "ki": 2.0, "kd": 0.0}


def plant(added: float = 0.0) -> TransferFunction:
    return TransferFunction((1.0,), (1.0, 0.0), DEAD_TIME + added)


def drive(gains: Mapping[str, float], conditions: Conditions = NOMINAL, fidelity: Fidelity = "plant") -> Evaluation:
    """Return an integrator with dead time under PI control, a step at time 0."""
    added = 0.0 if conditions.delay is None else conditions.delay - DEAD_TIME
    response = simulate_loop(
        LinearProcess(plant(added), PERIOD), PidGains(**gains), period=PERIOD, reference=np.ones(1000)
    )
    table = pd.DataFrame({"t": response.time, "reference": response.reference, "output": response.measurement})
    return Evaluation("ok", response=table) if len(table) == 1000 else Evaluation("unstable")


def margins() -> dict[str, float]:
    loop_margins = find_margins(plant(), PidGains(**GAINS), period=PERIOD)
    return {"gain_margin": loop_margins.gain_margin, "delay_margin_s": loop_margins.delay_margin}


def test_true_margins_are_claimed_in_full() -> None:
    exact = margins()
    assert exact["gain_margin"] == pytest.approx(
        0.5 * np.pi / DEAD_TIME / 4.0, rel=0.1
    )  # of an integrator: π / (2 L k)
    for check in confirm_margins(one_by_one(drive), GAINS, exact, delay=DEAD_TIME, step=1.0):
        assert check.claimed == pytest.approx(check.model, rel=0.03)
        assert not check.stable_at_above


def one_by_one(evaluate: Callable[..., Evaluation]) -> Callable[[Sequence[Call]], list[Evaluation]]:
    return lambda calls: [evaluate(*call) for call in calls]


def short_test(gains: Mapping[str, float], added: float, limits: PidLimits = NO_LIMITS) -> Evaluation:
    """Return the evaluation of a test that is too short for an oscillation near the margin to decay."""
    response = simulate_loop(
        LinearProcess(plant(added), PERIOD), PidGains(**gains), period=PERIOD, reference=np.ones(600), limits=limits
    )
    course = Course(step=1.0, step_time=0.0, load=0.0, load_time=6.0, duration=6.0)
    rows = response.time, response.reference, response.measurement, response.control
    return judge(*rows, course=course, limits=limits)


@pytest.mark.parametrize("kp", [5.0, 7.0])
def test_an_oscillation_that_decays_slowly_is_within_the_margin(kp: float) -> None:
    """At the end of a short test it is still large."""
    gains = GAINS | {"kp": kp}
    exact = find_margins(plant(), PidGains(**gains), period=PERIOD)

    def drive_shortly(
        gains: Mapping[str, float], conditions: Conditions = NOMINAL, fidelity: Fidelity = "plant"
    ) -> Evaluation:
        return short_test(gains, 0.0 if conditions.delay is None else conditions.delay - DEAD_TIME)

    close = short_test(gains, 0.95 * exact.delay_margin)
    assert close.status == "ok"
    assert close.decays
    figures = {"gain_margin": exact.gain_margin, "delay_margin_s": exact.delay_margin}
    for check in confirm_margins(one_by_one(drive_shortly), gains, figures, delay=DEAD_TIME, step=1.0):
        assert check.claimed == pytest.approx(check.model, rel=0.03)
        assert not check.stable_at_above


def test_whether_an_oscillation_decays_is_not_known_at_a_limit_of_the_effort() -> None:
    """It shrinks to the size that the limit sustains."""
    exact = find_margins(plant(), PidGains(**GAINS), period=PERIOD)
    for added in (1.1 * exact.delay_margin, 1.5 * exact.delay_margin):
        result = short_test(GAINS, added, PidLimits(minimum=-3.0, maximum=3.0))
        assert result.status == "unstable"
        assert not result.decays


def test_of_margins_that_are_too_large_those_of_the_plant_are_claimed() -> None:
    exact = margins()
    claimed = {name: 1.15 * value for name, value in exact.items()}
    checks = confirm_margins(one_by_one(drive), GAINS, claimed, delay=DEAD_TIME, step=1.0)
    assert [check.name for check in checks] == ["gain_margin", "delay_margin_s"]
    for check in checks:
        assert check.claimed == pytest.approx(exact[check.name], rel=0.04)
        assert check.ratio < 0.92


def test_of_margins_that_are_too_small_the_smaller_are_claimed() -> None:
    small = {name: 0.7 * value for name, value in margins().items()}
    for check in confirm_margins(one_by_one(drive), GAINS, small, delay=DEAD_TIME, step=1.0):
        assert check.claimed == small[check.name]
        assert check.stable_at_above


@pytest.mark.parametrize(
    ("nominal", "margin", "driven"),
    [(0.05, 0.4, [0.05 + ABOVE * 0.4]), (0.08, 0.4, [LONGEST]), (0.2, 0.4, [LONGEST]), (0.35, 0.4, [])],
)
def test_delays_are_driven_up_to_the_longest_one_of_the_actuator(
    nominal: float, margin: float, driven: list[float]
) -> None:
    """A longer delay cannot be tested; it would count as unstable, and the margin of the model would not be claimed."""
    delays: list[float] = []

    def accept(
        gains: Mapping[str, float], conditions: Conditions = NOMINAL, fidelity: Fidelity = "plant"
    ) -> Evaluation:
        """Return a response that is stable at all delays that the actuator can have."""
        assert conditions.delay is not None
        delays.append(conditions.delay)
        return drive(GAINS) if conditions.delay <= LONGEST else Evaluation("failed")

    checks = confirm_margins(one_by_one(accept), GAINS, {"delay_margin_s": margin}, delay=nominal, step=1.0)
    assert [check.claimed for check in checks] == [margin] * len(driven)
    assert delays == pytest.approx(driven)  # each delay is driven once
    assert all(delay <= LONGEST for delay in delays)


def test_an_unstable_loop_with_a_long_nominal_delay_claims_what_the_plant_confirms() -> None:
    nominal, true = 0.2, 0.27

    def limited(
        gains: Mapping[str, float], conditions: Conditions = NOMINAL, fidelity: Fidelity = "plant"
    ) -> Evaluation:
        assert conditions.delay is not None
        assert conditions.delay <= LONGEST
        return drive(GAINS) if conditions.delay - nominal <= true else Evaluation("unstable")

    (check,) = confirm_margins(one_by_one(limited), GAINS, {"delay_margin_s": 0.4}, delay=nominal, step=1.0)
    assert check.claimed == pytest.approx(true, abs=0.02 * 0.4)
    assert not check.stable_at_above


def test_a_value_that_prints_as_its_limit_does_not_break_it() -> None:
    assert not breaks_limit("ms", 1.60004, 1.6)
    assert breaks_limit("ms", 1.601, 1.6)
    assert not breaks_limit("delay_margin_s", 0.0749999, 0.075)
    assert breaks_limit("delay_margin_s", 0.0749, 0.075)
    assert breaks_limit("ms", float("nan"), 1.6)


def test_a_loop_that_is_stable_at_no_part_of_its_delay_margin_has_none_and_limits_of_a_search_stay_finite() -> None:
    """A study divides its limits by the ratio, which is at least the smallest part that is driven."""
    # The true margin at a gain of 10 is about π / (2 · 10) - 0.1 = 0.06 s.
    (check,) = confirm_margins(
        one_by_one(drive), GAINS | {"kp": 10.0}, {"delay_margin_s": 0.39}, delay=DEAD_TIME, step=1.0
    )
    assert check.claimed == 0.0
    assert check.ratio == LEAST
