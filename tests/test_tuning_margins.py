"""Stability margins: compared with python-control where possible, with closed forms where there is dead time."""

import math

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mirdrake.core.errors import ConfigError, MissingDependencyError
from mirdrake.core.pid import PidGains
from mirdrake.tuning import (
    FirstOrder,
    FrequencyResponse,
    Integrator,
    TransferFunction,
    find_margins,
    is_stable,
    lags,
    ultimate_point,
)
from mirdrake.tuning.gains import controller_transfer_function
from mirdrake.tuning.stability import count_unstable_poles

DOUBLE_INTEGRATOR = TransferFunction((1.0,), (1.0, 0.0, 0.0))
LOOPS = {
    "third-order lag, P": (lags(1.0, 1.0, 1.0), PidGains(3.0)),
    "third-order lag, PI": (lags(1.0, 1.0, 1.0), PidGains(1.2, 0.6)),
    "third-order lag, PID": (lags(1.0, 1.0, 1.0), PidGains(2.4, 0.9, 1.5, filter_time=0.06)),
    "double integrator, PID": (DOUBLE_INTEGRATOR * lags(0.1), PidGains(1.0, 0.2, 1.6, filter_time=0.1)),
    "four lags, PI": (lags(1.0, 0.1, 0.01, 0.001), PidGains(4.13, 7.66)),
    "resonance, I": (TransferFunction((4.0,), (1.0, 0.4, 4.0)), PidGains(0.0, 0.2)),
    "inverse response, PI": (TransferFunction((-0.5, 1.0), (1.0, 2.0, 1.0)), PidGains(0.8, 0.5)),
    "unstable plant, PI": (TransferFunction((1.0,), (0.02, 0.98, -1.0)), PidGains(4.0, 2.0)),
}


# python-control 0.10.2 sets shapes in a way that NumPy 2.5 no longer likes.
@pytest.mark.filterwarnings("ignore:Setting the shape on a NumPy array:DeprecationWarning")
@pytest.mark.parametrize("name", LOOPS)
def test_margins_equal_those_of_python_control(name: str) -> None:
    plant, gains = LOOPS[name]
    margins = find_margins(plant, gains)
    loop = (plant * controller_transfer_function(gains)).to_control()
    gain, phase, distance, w_phase, w_gain, _ = control.stability_margins(loop)
    assert margins.gain_margin == pytest.approx(gain, rel=1e-5)
    assert math.degrees(margins.phase_margin) == pytest.approx(phase, abs=1e-4)
    assert margins.max_sensitivity == pytest.approx(max(1.0 / distance, 1.0), rel=1e-4)
    assert margins.gain_crossover == pytest.approx(w_gain, rel=1e-5)
    if math.isfinite(gain):
        assert margins.phase_crossover == pytest.approx(w_phase, rel=1e-5)
    disk, disk_gain, disk_phase = control.disk_margins(loop, np.geomspace(0.03, 100.0, 4_000))
    assert margins.disk_margin == pytest.approx(disk, rel=1e-4)
    assert 20.0 * math.log10(margins.disk_gain) == pytest.approx(disk_gain, rel=1e-4)
    assert math.degrees(margins.disk_phase) == pytest.approx(disk_phase, rel=1e-4)
    assert is_stable(plant, gains)


def test_margins_of_a_delayed_integrator_have_closed_forms() -> None:
    # L = k exp(-s T)/s: crossover k, PM = 90° - k T, GM = π/(2 k T), delay margin = PM/k.
    k, delay = 0.8, 0.5
    margins = find_margins(Integrator(k, delay), PidGains(1.0))
    assert margins.gain_margin == pytest.approx(math.pi / (2.0 * k * delay), rel=1e-9)
    assert margins.phase_margin == pytest.approx(0.5 * math.pi - k * delay, rel=1e-9)
    assert margins.delay_margin == pytest.approx(0.5 * math.pi / k - delay, rel=1e-9)


def test_the_ultimate_point_of_textbook_plants() -> None:
    third = ultimate_point(lags(1.0, 1.0, 1.0))
    assert third is not None
    assert (third.gain, third.period) == pytest.approx((8.0, 2.0 * math.pi / math.sqrt(3.0)), rel=1e-9)
    ramp = ultimate_point(Integrator(2.0, 0.5))
    assert ramp is not None
    assert (ramp.gain, ramp.period) == pytest.approx((math.pi / 2.0, 2.0), rel=1e-9)
    assert ultimate_point(lags(1.0, 0.5)) is None


@settings(deadline=None, max_examples=40)
@given(st.floats(0.1, 10.0), st.floats(0.05, 5.0), st.floats(0.5, 0.98))
def test_each_margin_is_the_limit_of_stability(time: float, ratio: float, near: float) -> None:
    plant = FirstOrder(1.0, time, ratio * time).transfer_function()
    gains = PidGains(0.3 / ratio, 0.3 / (ratio * time))
    margins = find_margins(plant, gains)

    def stable(gain: float, delay: float) -> bool:
        return is_stable(TransferFunction((gain,), (time, 1.0), plant.delay + delay), gains)

    assert stable(1.0, 0.0)
    assert stable(1.0 + near * (margins.gain_margin - 1.0), 0.0)
    assert not stable(1.0 + (margins.gain_margin - 1.0) / near, 0.0)
    assert stable(1.0, near * margins.delay_margin)
    assert not stable(1.0, margins.delay_margin / near)


@settings(deadline=None, max_examples=40)
@given(st.lists(st.floats(0.1, 3.0), min_size=1, max_size=4), st.floats(0.1, 30.0), st.floats(0.0, 5.0))
def test_stability_agrees_with_the_poles_without_dead_time(time_constants: list[float], kp: float, ki: float) -> None:
    loop = lags(*time_constants) * controller_transfer_function(PidGains(kp, ki))
    poles = np.roots(np.polyadd(loop.denominator, loop.numerator))
    if np.min(np.abs(poles.real)) > 1e-3:
        tiny = TransferFunction(loop.numerator, loop.denominator, 1e-7)  # takes the path with dead time
        assert count_unstable_poles(tiny) == np.sum(poles.real > 0.0) == count_unstable_poles(loop)


def test_a_loop_with_dead_time_and_high_frequency_gain_above_one_is_unstable() -> None:
    assert count_unstable_poles(TransferFunction((1.2, 0.1), (1.0, 1.0), 0.1)) == math.inf
    assert count_unstable_poles(TransferFunction((0.8, 0.1), (1.0, 1.0), 0.1)) == 0


def test_margins_of_a_measured_response_equal_those_of_its_model() -> None:
    plant, gains = LOOPS["third-order lag, PI"]
    w = np.geomspace(0.02, 20.0, 60)
    measured = find_margins(FrequencyResponse(w, plant.response(w)), gains)
    exact = find_margins(plant, gains)
    assert measured.gain_margin == pytest.approx(exact.gain_margin, rel=1e-3)
    assert measured.phase_margin == pytest.approx(exact.phase_margin, rel=1e-3)
    assert measured.max_sensitivity == pytest.approx(exact.max_sensitivity, rel=1e-3)
    with pytest.raises(ConfigError, match=r"outside of the measured range, 0\.02 to 20 rad/s"):
        find_margins(FrequencyResponse(w, plant.response(w)), gains, frequencies=(0.01, 10.0))


def test_sampling_acts_as_half_a_period_of_delay() -> None:
    plant, gains = LOOPS["third-order lag, PI"]
    late = TransferFunction(plant.numerator, plant.denominator, 0.01)
    sampled = find_margins(plant, gains, period=0.02)
    assert sampled.phase_margin == pytest.approx(find_margins(late, gains).phase_margin, abs=0.01)
    assert sampled.phase_margin < find_margins(plant, gains).phase_margin


def test_systems_of_python_control_are_converted_both_ways() -> None:
    system = control.tf([2.0, 1.0], [3.0, 2.0, 1.0])
    w = np.geomspace(0.1, 10.0, 5)
    for form in (system, control.tf2ss(system)):
        plant = TransferFunction.from_control(form, delay=0.3)
        assert plant.response(w) == pytest.approx(system(1j * w) * np.exp(-0.3j * w), rel=1e-9)
    with pytest.raises(ConfigError, match="does not support dead time"):
        plant.to_control()
    with pytest.raises(ConfigError, match="continuous system"):
        TransferFunction.from_control(control.tf([1.0], [1.0, 0.5], 0.1))
    with pytest.raises(ConfigError, match="one input and one output"):
        TransferFunction.from_control(control.ss([[-1.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]]))


def test_without_python_control_the_message_states_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr("mirdrake.tuning.control_library.import_module", fail)
    with pytest.raises(MissingDependencyError, match=r"pip install 'mirdrake\[tuning\]'"):
        lags(1.0).to_control()
    # Margins need nothing of it.
    assert find_margins(*LOOPS["third-order lag, P"]).gain_margin == pytest.approx(8.0 / 3.0)


def test_a_transfer_function_must_be_proper() -> None:
    with pytest.raises(ConfigError, match="not proper"):
        TransferFunction((1.0, 0.0), (1.0,))
    with pytest.raises(ConfigError, match="denominator is zero"):
        TransferFunction((1.0,), (0.0,))
    with pytest.raises(ConfigError, match="set filter_time"):
        is_stable(lags(1.0), PidGains(1.0, kd=1.0))
