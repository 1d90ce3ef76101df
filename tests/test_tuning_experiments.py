"""Experiments on loops in time: exact simulation, step tests, relay feedback, frequency response in closed loop."""

import math
from typing import Any

import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st

from mirdrake.core.errors import ConfigError, RunError
from mirdrake.core.pid import PidGains
from mirdrake.tuning import (
    FirstOrder,
    FrequencyResponse,
    Integrator,
    LinearProcess,
    PidLoop,
    StepRecord,
    TransferFunction,
    fit_first_order,
    fit_integrator,
    lags,
    measure_frequency_response,
    run_relay_test,
    run_step_test,
    simulate_loop,
    ultimate_point,
)
from mirdrake.tuning.identify import fit_response

THIRD = lags(1.0, 1.0, 1.0)
RELAY_PLANTS = {
    "third-order lag": THIRD,
    "lag dominated": lags(1.0, 0.1, 0.01, 0.001),
    "balanced": lags(1.0, 1.0, 1.0, 1.0),
    "delay dominated": lags(0.05, 0.05, delay=1.0),
    "first order, L/T 0.1": FirstOrder(2.0, 10.0, 1.0).transfer_function(),
    "first order, L/T 10": FirstOrder(1.0, 0.1, 1.0).transfer_function(),
    "integrator": Integrator(1.0, 1.0).transfer_function(),
    "inverse response": TransferFunction((-0.5, 1.0), (1.0, 2.0, 1.0), 0.2),
}


@given(st.floats(0.2, 5.0), st.floats(0.0, 2.0), st.floats(0.01, 0.5))
def test_simulated_step_is_exact_at_any_dead_time(time: float, delay: float, period: float) -> None:
    record = run_step_test(
        LinearProcess(FirstOrder(3.0, time, delay).transfer_function(), period),
        period=period,
        duration=40 * period,
        amplitude=2.0,
    )
    exact = 6.0 * -np.expm1(-np.maximum(record.time - delay, 0.0) / time)
    assert record.measurement == pytest.approx(exact, abs=1e-9)


def test_simulated_third_order_lag_is_exact_and_passes_a_direct_part_on() -> None:
    record = run_step_test(LinearProcess(THIRD, 0.1), period=0.1, duration=10.0, amplitude=1.0)
    t = record.time
    assert record.measurement == pytest.approx(1.0 - np.exp(-t) * (1.0 + t + 0.5 * t**2), abs=1e-12)
    lead = LinearProcess(TransferFunction((2.0, 1.0), (1.0, 1.0)), 0.5)  # 2 - 1/(s + 1)
    assert [lead(1.0), lead(1.0)] == pytest.approx([1.0 + math.exp(-0.5), 1.0 + math.exp(-1.0)])


@settings(deadline=None, max_examples=25)
@given(st.floats(-5.0, 5.0).filter(lambda k: abs(k) > 0.1), st.floats(0.5, 5.0), st.floats(0.1, 3.0))
def test_every_method_recovers_a_first_order_model(gain: float, time: float, delay: float) -> None:
    period = time / 200
    process = LinearProcess(FirstOrder(gain, time, delay).transfer_function(), period)
    record = run_step_test(
        process, period=period, duration=delay + 8 * time, amplitude=0.5, control=0.3, rest=delay + 12 * time
    )
    for method in ("tangent", "area", "least_squares"):
        model = fit_first_order(record, method)
        assert (model.gain, model.time_constant) == pytest.approx((gain, time), rel=0.02), method
        assert model.delay == pytest.approx(delay, abs=0.02 * time), method


def test_least_squares_tolerates_noise() -> None:
    record = run_step_test(
        LinearProcess(FirstOrder(2.0, 1.0, 0.5).transfer_function(), 0.01), period=0.01, duration=8.0, amplitude=1.0
    )
    noise = np.random.default_rng(1).normal(0.0, 0.05, len(record.time))
    noise[0] = 0.0
    model = fit_first_order(StepRecord(record.time, record.measurement + noise, 1.0))
    assert (model.gain, model.time_constant, model.delay) == pytest.approx((2.0, 1.0, 0.5), rel=0.03)


def test_an_integrator_is_recovered_and_not_fitted_by_a_lag() -> None:
    record = run_step_test(
        LinearProcess((Integrator(2.0, 0.3).transfer_function() * lags(0.1)), 0.01),
        period=0.01,
        duration=5.0,
        amplitude=0.5,
    )
    model = fit_integrator(record)
    assert (model.gain, model.delay) == pytest.approx((2.0, 0.4), rel=1e-6)
    with pytest.raises(RunError, match="not settled at the end"):
        fit_first_order(record)


@pytest.mark.parametrize("hysteresis", [0.0, 0.3], ids=["plain", "hysteresis"])
@pytest.mark.parametrize("name", RELAY_PLANTS)
def test_relay_finds_the_ultimate_point_within_five_per_cent(name: str, hysteresis: float) -> None:
    plant = RELAY_PLANTS[name]
    exact = ultimate_point(plant)
    assert exact is not None
    period = exact.period / 100
    # The hysteresis as a part of the measurement's swing at the ultimate point.
    result = run_relay_test(
        LinearProcess(plant, period),
        period=period,
        amplitude=0.5,
        hysteresis=hysteresis * 0.5 / exact.gain,
        duration=60.0 * exact.period,
    )
    assert result.ultimate_gain == pytest.approx(exact.gain, rel=0.05)
    assert result.ultimate_period == pytest.approx(exact.period, rel=0.05)
    for frequency, value in result.points:
        assert value == pytest.approx(complex(plant.response(frequency)), rel=0.03)


def test_relay_works_at_an_operating_point_with_noise() -> None:
    plant, rng = RELAY_PLANTS["balanced"], np.random.default_rng(2)
    process = LinearProcess(plant, 0.05)
    for _ in range(1000):
        process(2.0)
    result = run_relay_test(
        lambda u: process(u) + rng.normal(0.0, 0.005), period=0.05, amplitude=0.5, hysteresis=0.03,
        reference=2.0, measurement=2.0, control=2.0, duration=400.0, tolerance=0.05,
    )  # fmt: skip
    assert result.ultimate_gain == pytest.approx(4.0, rel=0.05)
    assert result.ultimate_period == pytest.approx(2.0 * math.pi, rel=0.05)


def test_describing_function_is_exact_in_form_for_the_delayed_integrator() -> None:
    # The cycle is a triangle of amplitude d L (L = dead time) and period 4 L; 4 d/(π a) = 4/π, exact 1/|G| = π/2.
    result = run_relay_test(
        LinearProcess(RELAY_PLANTS["integrator"], 0.01), period=0.01, amplitude=2.0, duration=60.0, refine=False
    )
    assert result.relay_period == pytest.approx(4.0, rel=0.01)
    assert result.amplitude == pytest.approx(2.0, rel=0.01)
    assert result.describing_gain == pytest.approx(4.0 / math.pi, rel=0.01)


def test_relay_reports_why_it_failed() -> None:
    with pytest.raises(RunError, match="no limit cycle; increase the amplitude"):
        run_relay_test(LinearProcess(THIRD, 0.05), period=0.05, amplitude=0.1, reference=5.0, duration=50.0)
    with pytest.raises(RunError, match="grows without bound"):
        run_relay_test(
            LinearProcess(TransferFunction((1.0,), (1.0, -3.0), 1.0), 0.05), period=0.05, amplitude=1.0, duration=90.0
        )


def test_frequency_response_in_closed_loop() -> None:
    plant = lags(1.0, 0.5, delay=0.123)
    loop = PidLoop(LinearProcess(plant, 0.02), PidGains(1.0, 0.8), 0.02)
    (response,) = measure_frequency_response(
        loop,
        period=0.02,
        frequencies=np.geomspace(0.5, 20.0, 12),
        amplitude=0.5,
        settle=4,
    )
    assert len(response.frequencies) == 11  # two of twelve fall on the same multiple
    exact = plant.response(response.frequencies)
    assert np.max(np.abs(response.values / exact - 1.0)) < 0.02
    middle = math.sqrt(response.frequencies[4] * response.frequencies[5])
    assert complex(response.response(middle)) == pytest.approx(complex(plant.response(middle)), rel=0.03)


@pytest.mark.parametrize("order", [1, 2])
def test_a_fit_of_a_frequency_response_starts_at_the_first_guess(order: int, monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[np.ndarray] = []
    least_squares = scipy.optimize.least_squares

    def record(residual: Any, begin: np.ndarray, **settings: Any) -> Any:
        started.append(begin)
        return least_squares(residual, begin, **settings)

    monkeypatch.setattr(scipy.optimize, "least_squares", record)
    frequencies = np.geomspace(0.5, 20.0, 12)
    plant = TransferFunction((3.0,), (1.0, 0.5) if order == 1 else (1.0, 2.0, 5.0), 0.1)
    # Of order 1 the second value is the time constant.
    first = (2.0, 1.0, 0.05) if order == 1 else (2.0, 1.0, 4.0, 0.05)
    fitted, percent = fit_response(FrequencyResponse(frequencies, plant.response(frequencies)), first, order=order)
    np.testing.assert_allclose(np.exp(started[0]), first, rtol=1e-12)
    np.testing.assert_allclose(
        (*fitted.numerator, *fitted.denominator), (*plant.numerator, *plant.denominator), rtol=1e-6
    )
    assert percent == pytest.approx(100.0)


def test_the_deviation_of_a_frequency_response_is_that_of_the_noise() -> None:
    rng, plant = np.random.default_rng(3), lags(1.0)
    process = LinearProcess(plant, 0.05)
    loop = PidLoop(lambda u: process(u) + rng.normal(0.0, 0.05), PidGains(1.0, 0.5), 0.05)
    (response,) = measure_frequency_response(
        loop, period=0.05, frequencies=[0.5, 1.0, 2.0, 4.0], amplitude=0.5, cycles=16
    )
    assert response.deviation is not None
    errors = np.abs(response.values - plant.response(response.frequencies))
    assert (errors < 4.0 * response.deviation).all()
    assert (response.deviation < 0.1).all()
    assert (response.deviation > 1e-4).all()


def test_the_simulation_of_an_unstable_loop_ends_early() -> None:
    run = simulate_loop(LinearProcess(THIRD, 0.1), PidGains(50.0), period=0.1, reference=np.ones(5000))
    assert 10 < len(run.time) < 5000
    assert np.isfinite(run.measurement).all()
    loop = PidLoop(LinearProcess(THIRD, 0.1), PidGains(1e4), 0.1)
    with pytest.raises(RunError, match="the loop diverges"), np.errstate(all="ignore"):
        measure_frequency_response(loop, period=0.1, frequencies=[0.01, 0.02], amplitude=1.0)


def test_invalid_settings_are_rejected() -> None:
    with pytest.raises(ConfigError, match="did you mean 'area'"):
        fit_first_order(StepRecord(np.arange(30.0), np.ones(30), 1.0), "areas")  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="amplitude must not be zero"):
        StepRecord(np.arange(30.0), np.ones(30), 0.0)
    with pytest.raises(RunError, match="the measurement is constant"):
        fit_first_order(StepRecord(np.arange(30.0), np.ones(30), 1.0))
    with pytest.raises(ConfigError, match="positive and increasing"):
        FrequencyResponse(np.array([2.0, 1.0]), np.array([1.0 + 0j, 1.0]))
    with pytest.raises(ConfigError, match=r"between 0 and 31\.42 rad/s"):
        measure_frequency_response(lambda e: (e, e), period=0.1, frequencies=[1.0, 40.0], amplitude=1.0)
    with pytest.raises(ConfigError, match="amplitude must be > 0"):
        run_relay_test(LinearProcess(THIRD, 0.1), period=0.1, amplitude=0.0, duration=10.0)
