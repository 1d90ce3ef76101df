"""Loop shaping against published gains and against its own bounds; figures of responses against closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mirdrake.core.errors import ConfigError
from mirdrake.core.pid import PidGains, PidLimits
from mirdrake.tuning import (
    FirstOrder,
    FrequencyResponse,
    LinearProcess,
    TransferFunction,
    design_for_phase_margin,
    find_margins,
    is_stable,
    lags,
    maximize_integral_gain,
    response_figures,
    simulate_loop,
    to_standard,
)

THIRD = lags(1.0, 1.0, 1.0)


@pytest.mark.parametrize(
    ("bound", "gain", "integral"), [(1.4, 0.633, 1.95), (1.6, 0.862, 1.87), (2.0, 1.22, 1.78)], ids=str
)
def test_pi_for_the_third_order_lag_has_the_published_gains(bound: float, gain: float, integral: float) -> None:
    # Åström, Panagopoulos and Hägglund (1998), example 1/(s + 1)³.
    gains = maximize_integral_gain(THIRD, max_sensitivity=bound)
    assert to_standard(gains)[:2] == pytest.approx((gain, integral), rel=0.01)
    assert find_margins(THIRD, gains).max_sensitivity == pytest.approx(bound, rel=1e-3)


@settings(deadline=None, max_examples=15)
@given(st.floats(0.1, 5.0), st.floats(1.25, 2.2))
def test_no_pi_near_the_optimum_is_better(ratio: float, bound: float) -> None:
    plant = FirstOrder(1.0, 1.0, ratio).transfer_function()
    best = maximize_integral_gain(plant, max_sensitivity=bound)
    assert is_stable(plant, best)
    assert find_margins(plant, best).max_sensitivity == pytest.approx(bound, rel=2e-3)
    for factor in (0.9, 1.1):
        beside = PidGains(factor * best.kp, best.ki * 1.01)
        assert find_margins(plant, beside).max_sensitivity > bound


@pytest.mark.parametrize(
    "plant",
    [THIRD, FirstOrder(2.0, 1.0, 0.3).transfer_function(), TransferFunction((3.0,), (1.0, 0.0, 0.0), 0.5)],
    ids=["third-order lag", "first order", "double integrator"],
)
def test_pid_meets_the_bound_and_has_more_integral_gain_than_pi(plant: TransferFunction) -> None:
    gains = maximize_integral_gain(plant, max_sensitivity=1.7, derivative=True)
    margins = find_margins(plant, gains)
    assert is_stable(plant, gains)
    assert margins.max_sensitivity == pytest.approx(1.7, rel=5e-3)
    assert gains.ki * gains.kd <= 0.25 * gains.kp**2 * (1.0 + 1e-6)
    assert gains.filter_time == pytest.approx(0.1 * gains.kd / gains.kp, rel=2e-3)
    if plant.denominator[-1]:
        assert gains.ki > 1.3 * maximize_integral_gain(plant, max_sensitivity=1.7).ki


def test_shaping_works_on_a_measured_response() -> None:
    w = np.geomspace(0.02, 20.0, 60)
    measured = maximize_integral_gain(FrequencyResponse(w, THIRD.response(w)), max_sensitivity=1.6)
    exact = maximize_integral_gain(THIRD, max_sensitivity=1.6)
    assert (measured.kp, measured.ki) == pytest.approx((exact.kp, exact.ki), rel=0.01)


@pytest.mark.parametrize(("derivative", "crossover"), [(False, 0.6), (True, 1.3)], ids=["PI", "PID"])
def test_phase_margin_and_crossover_are_those_asked_for(derivative: bool, crossover: float) -> None:
    phase_margin = math.radians(50.0)
    gains = design_for_phase_margin(THIRD, crossover, phase_margin=phase_margin, derivative=derivative)
    margins = find_margins(THIRD, gains)
    assert (margins.gain_crossover, margins.phase_margin) == pytest.approx((crossover, phase_margin), rel=1e-6)
    assert is_stable(THIRD, gains)
    if derivative:
        assert gains.kp / gains.ki == pytest.approx(4.0 * gains.kd / gains.kp)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: design_for_phase_margin(THIRD, 3.0), "choose another crossover or margin"),
        (lambda: maximize_integral_gain(lags(1.0)), "the gain is not bounded"),
        (
            lambda: maximize_integral_gain(TransferFunction((1.0,), (1.0, 0.0, 0.0)), derivative=True),
            "the gain is not bounded",
        ),
        (lambda: maximize_integral_gain(TransferFunction((1.0,), (1.0, 0.0, 0.0), 1.0)), "no PI controller"),
        (lambda: maximize_integral_gain(lags(1.0, 1.0, gain=-1.0, delay=1.0)), "sign of the gain of the plant"),
        (lambda: maximize_integral_gain(TransferFunction((1.0,), (1.0, -1.0), 0.1)), "right half plane"),
        (lambda: maximize_integral_gain(THIRD, max_sensitivity=1.0), "max_sensitivity must be > 1"),
    ],
)
def test_impossible_designs_are_rejected(call, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        call()


def test_figures_of_a_first_order_response() -> None:
    time = np.linspace(0.0, 20.0, 20_001)
    y = -np.expm1(-time)
    response = response_figures(time, 1.0, y, np.ones_like(time))
    assert (response.iae, response.itae, response.ise) == pytest.approx((1.0, 1.0, 0.5), rel=1e-5)
    assert response.overshoot == 0.0
    assert response.rise_time == pytest.approx(math.log(9.0), rel=1e-5)
    assert response.settling_time == pytest.approx(math.log(50.0), rel=1e-5)
    assert response.steady_error == pytest.approx(0.0, abs=1e-7)
    assert (response.peak_effort, response.rms_effort, response.total_variation) == pytest.approx((1.0, 1.0, 0.0))
    assert response.peak_jerk == pytest.approx(1.0, rel=2e-3)
    assert response.rms_jerk == pytest.approx(math.sqrt(0.5 / 20.0), rel=2e-3)


@pytest.mark.parametrize(("shift", "part"), [(0.0, 0.5), (1.0, 0.5), (-1.0, 1.5)])
def test_the_error_on_a_ramp_is_that_against_the_set_point_that_a_controller_holds(shift: float, part: float) -> None:
    """A set-point that moves by slope × period at each sample leads the ramp by half a period on average.

    A loop on the ramp and one that follows the set-point of the sample are half a period away from it: neither has an
    advantage.
    """
    period, slope = 0.1, 3.0
    time = np.arange(101) * period
    before = slope * time  # a record has the values before the update: that of the last sample, one period ahead
    figures = response_figures(time, before, slope * (time + shift * period), time)
    assert figures.iae == pytest.approx(part * slope * period * 10.0)
    assert figures.ise == pytest.approx((1.0 + (part > 1.0) * 4.0) * 0.5 * (slope * period) ** 2 * 10.0)


def test_figures_of_a_second_order_response() -> None:
    # Damping 0.5: overshoot exp(-π/√3) = 16.3 %; here downwards from 3 to 1.
    time = np.linspace(0.0, 40.0, 40_001)
    root = math.sqrt(0.75)
    y = 3.0 - 2.0 * (1.0 - np.exp(-0.5 * time) * (np.cos(root * time) + 0.5 / root * np.sin(root * time)))
    response = response_figures(time, 1.0, y, np.zeros_like(time))
    assert response.overshoot == pytest.approx(math.exp(-math.pi / math.sqrt(3.0)), rel=1e-5)
    assert response.settling_time == pytest.approx(8.08, abs=0.01)
    assert response.rise_time == pytest.approx(1.64, abs=0.01)


def test_figures_count_effort_and_saturation() -> None:
    time = np.arange(6.0)
    control = np.array([0.0, 2.0, 2.0, 1.0, 0.5, 0.5])
    response = response_figures(time, 1.0, time / 5.0, control, limits=PidLimits(0.0, 2.0))
    assert response.total_variation == pytest.approx(3.5)
    assert response.saturation_time == pytest.approx(3.0)  # at 0, and two periods at 2
    slow = response_figures(time, 1.0, time / 5.0, control, limits=PidLimits(rate=2.0))
    assert slow.saturation_time == pytest.approx(1.0)


def test_undefined_figures_are_nan() -> None:
    time = np.arange(10.0)
    low = response_figures(time, 1.0, 0.05 * time, time)
    assert math.isnan(low.rise_time)
    assert math.isnan(low.settling_time)
    load = response_figures(time, 0.0, np.sin(time), time)
    assert math.isnan(load.overshoot)
    bad = response_figures(time, 1.0, np.where(time > 5.0, np.inf, 0.0), time)
    assert (bad.finite, bad.iae) == (False, math.inf)
    with pytest.raises(ConfigError, match="time must increase"):
        response_figures([0.0, 1.0, 1.0], 1.0, [0.0, 1.0, 1.0], [0.0, 0.0, 0.0])


def test_the_integral_of_the_error_after_a_load_is_one_over_ki() -> None:
    gains = maximize_integral_gain(THIRD, max_sensitivity=1.4)
    run = simulate_loop(LinearProcess(THIRD, 0.02), gains, period=0.02, reference=np.zeros(3000), disturbance=1.0)
    assert 0.02 * float(np.sum(run.measurement)) == pytest.approx(1.0 / gains.ki, rel=0.01)
