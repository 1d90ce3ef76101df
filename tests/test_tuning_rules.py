"""Tuning rules against the gains that their papers print."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mirdrake.core.errors import ConfigError
from mirdrake.core.pid import PidGains, PidState, pid_step
from mirdrake.tuning import (
    FirstOrder,
    Integrator,
    LinearProcess,
    controller_response,
    find_margins,
    fit_first_order,
    from_series,
    from_standard,
    is_stable,
    lags,
    run_step_test,
    to_standard,
)
from mirdrake.tuning.gains import hold_response
from mirdrake.tuning.rules import (
    amigo,
    lambda_tuning,
    simc,
    simc_double_integrator,
    ziegler_nichols_step,
    ziegler_nichols_ultimate,
)

# Åström and Hägglund (2004): plant, its step test's duration, (K, Ti) of AMIGO's PI, (K, Ti, Td) of its PID.
AMIGO_BATCH = {
    "lag dominated": (lags(1.0, 0.1, 0.01, 0.001), 8.0, (4.13, 0.539), (6.44, 0.361, 0.0367)),
    "balanced": (lags(1.0, 1.0, 1.0, 1.0), 20.0, (0.414, 2.66), (1.12, 2.40, 0.619)),
    "delay dominated": (lags(0.05, 0.05, delay=1.0), 3.0, (0.175, None), (0.242, 0.474, 0.119)),
}


@pytest.mark.parametrize("name", AMIGO_BATCH)
def test_step_test_and_amigo_give_the_published_gains(name: str) -> None:
    plant, duration, pi, pid = AMIGO_BATCH[name]
    period = duration / 4000
    model = fit_first_order(
        run_step_test(LinearProcess(plant, period), period=period, duration=duration, amplitude=2.0), "tangent"
    )
    gain, integral, _ = to_standard(amigo(model, "PI"))
    assert gain == pytest.approx(pi[0], rel=0.01)
    assert pi[1] is None or integral == pytest.approx(pi[1], rel=0.01)
    assert to_standard(amigo(model, "PID")) == pytest.approx(pid, rel=0.01)
    assert find_margins(plant, amigo(model, "PI")).max_sensitivity < 1.5


# Skogestad (2003), table 4: dead time and time constant of the model, Kc and τI of PI.
SIMC_CASES = {"E2": ((1.47, 2.5), (0.85, 2.5)), "E4": ((2.5, 1.5), (0.30, 1.5)), "E5": ((0.148, 1.1), (3.72, 1.1))}


@pytest.mark.parametrize("name", SIMC_CASES)
def test_simc_gives_the_published_gains(name: str) -> None:
    (delay, lag), pi = SIMC_CASES[name]
    assert to_standard(simc(FirstOrder(1.0, lag, delay)))[:2] == pytest.approx(pi, rel=0.01)


def test_simc_has_the_published_margins() -> None:
    # Skogestad (2003), table 1, τc = θ: GM, PM [deg], Ms, Mt, allowed extra delay over θ.
    first = FirstOrder(2.0, 1.0, 0.5)
    lag = find_margins(first, simc(first))
    assert lag.gain_margin == pytest.approx(3.14, rel=0.01)
    assert math.degrees(lag.phase_margin) == pytest.approx(61.4, rel=0.01)
    assert lag.max_sensitivity == pytest.approx(1.59, rel=0.01)
    assert lag.delay_margin / first.delay == pytest.approx(2.14, rel=0.01)
    ramp = Integrator(3.0, 0.2)
    integrating = find_margins(ramp, simc(ramp))
    assert integrating.gain_margin == pytest.approx(2.96, rel=0.01)
    assert math.degrees(integrating.phase_margin) == pytest.approx(46.9, rel=0.01)
    assert integrating.max_sensitivity == pytest.approx(1.70, rel=0.01)
    assert integrating.max_complementary == pytest.approx(1.30, rel=0.01)
    assert integrating.delay_margin / ramp.delay == pytest.approx(1.59, rel=0.01)


def test_simc_for_the_double_integrator() -> None:
    # Table 1 again: Kc k'' θ² = 0.0625, τI = τD = 8 θ in series form: K = 2 Kc, Ti = 16 θ, Td = 4 θ.
    gains = simc_double_integrator(2.0, 0.5)
    assert to_standard(gains) == pytest.approx((2 * 0.0625 / (2.0 * 0.25), 16 * 0.5, 4 * 0.5))


def test_ziegler_nichols_on_textbook_examples() -> None:
    # K = 2, T = 10, L = 1: a = 0.2.
    model = FirstOrder(2.0, 10.0, 1.0)
    assert to_standard(ziegler_nichols_step(model, "P")) == pytest.approx((5.0, math.inf, 0.0))
    assert to_standard(ziegler_nichols_step(model, "PI")) == pytest.approx((4.5, 3.0, 0.0))
    assert to_standard(ziegler_nichols_step(model, "PID")) == pytest.approx((6.0, 2.0, 0.5))
    # The third-order lag: Ku = 8, Tu = 2π/√3 = 3.63 (Åström and Hägglund: K = 3.2 to 4.8, Ti 1.81, Td 0.45).
    period = 2.0 * math.pi / math.sqrt(3.0)
    assert to_standard(ziegler_nichols_ultimate(8.0, period, "PID")) == pytest.approx((4.8, 1.81, 0.453), rel=0.01)
    assert to_standard(ziegler_nichols_ultimate(8.0, period, "PI")) == pytest.approx((3.6, 3.02, 0.0), rel=0.01)


def test_lambda_tuning_gives_the_desired_time_constant() -> None:
    model = FirstOrder(2.0, 4.0, 0.0)
    w = np.geomspace(1e-2, 10.0, 30)
    loop = model.response(w) * controller_response(lambda_tuning(model, 0.5), w)
    assert loop / (1.0 + loop) == pytest.approx(1.0 / (1.0 + 0.5j * w), rel=1e-9)
    ramp = Integrator(2.0, 0.0)
    loop = ramp.response(w) * controller_response(lambda_tuning(ramp, 0.5), w)
    assert 1.0 / (1.0 + loop) == pytest.approx((1j * w * 0.5) ** 2 / (1.0 + 0.5j * w) ** 2, rel=1e-9)


@given(st.floats(0.01, 100.0), st.floats(0.1, 10.0), st.floats(0.05, 5.0))
def test_robust_rules_keep_the_loop_stable_and_scale_with_gain_and_time(gain: float, time: float, ratio: float) -> None:
    model = FirstOrder(gain, time, ratio * time)
    for rule in (amigo, simc):
        gains = rule(model)
        assert is_stable(model.transfer_function(), gains)
        unit = rule(FirstOrder(1.0, 1.0, ratio))
        assert gains.kp * gain == pytest.approx(unit.kp, rel=1e-9)
        assert gains.ki * gain * time == pytest.approx(unit.ki, rel=1e-9)


@given(st.floats(0.1, 10.0), st.floats(0.1, 10.0), st.floats(0.0, 2.0))
def test_series_and_standard_forms_are_the_same_controller(gain: float, integral: float, derivative: float) -> None:
    w = np.geomspace(1e-2, 1e2, 20)
    s = 1j * w
    series = gain * (1.0 + 1.0 / (integral * s)) * (1.0 + derivative * s)
    created = controller_response(from_series(gain, integral, derivative, filter_ratio=math.inf), w)
    assert created == pytest.approx(series, rel=1e-9)


def test_series_keeps_the_filter_time_of_its_own_derivative_time() -> None:
    assert from_series(1.0, 2.0, 1.0, filter_ratio=5.0).filter_time == pytest.approx(0.2)
    assert from_standard(1.0, 2.0, 1.0, filter_ratio=5.0).filter_time == pytest.approx(0.2)


def test_the_sampled_response_is_that_of_the_controller() -> None:
    gains = PidGains(2.0, 3.0, 0.4, filter_time=0.05)
    period, cycle = 0.02, 100
    w = 2.0 * math.pi / (cycle * period)
    state, controls = PidState(), []
    errors = [math.cos(w * k * period) for k in range(20 * cycle)]
    for error in errors:
        state, control = pid_step(state, 0.0, -error, gains=gains, period=period)
        controls.append(control)
    turn = np.exp(-1j * w * period * np.arange(cycle))
    measured = np.dot(np.array(controls[-cycle:]) - np.mean(controls[-cycle:]), turn) / np.dot(errors[-cycle:], turn)
    expected = controller_response(gains, w, period=period) / hold_response(w, period)
    assert measured == pytest.approx(complex(expected), rel=1e-6)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: amigo(FirstOrder(1.0, 1.0, 0.0)), "needs a dead time; set closed_loop_time"),
        (lambda: simc(FirstOrder(1.0, 2.0, 0.0)), "needs a dead time"),
        (lambda: amigo(FirstOrder(1.0, 1.0, 1.0), "PDI"), "did you mean"),  # type: ignore[arg-type]
        (lambda: FirstOrder(0.0, 1.0, 1.0), "gain must not be zero"),
        (lambda: FirstOrder(1.0, -1.0, 1.0), "time constant must be > 0"),
        (lambda: lags(1.0, delay=-1.0), "delay must be >= 0"),
        (lambda: ziegler_nichols_ultimate(1.0, 0.0), "period must be > 0"),
        (lambda: to_standard(PidGains(0.0, 1.0)), "no standard form"),
    ],
)
def test_invalid_input_is_rejected_in_one_line(call, message: str) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        call()
    assert "\n" not in str(caught.value)
