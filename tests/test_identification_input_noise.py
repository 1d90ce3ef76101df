"""Noise of recorded inputs: its size, the filter that removes it, and what it does to a fit."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.fft import dct
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter

from mirdrake.identification.data import DataSet
from mirdrake.identification.estimators import fit, segments
from mirdrake.identification.input_noise import Noise, estimate_noise, without_noise
from mirdrake.identification.models import ModelSpec
from mirdrake.identification.parameters import Setting
from tests.identification_rigs import FRONT, MASS, REAR, TRUTH, lateral_log


@pytest.fixture
def random():
    return np.random.default_rng(5)


def slow(random, size, width=20.0):
    """Return a Gaussian signal of unit variance that has no power above some 3 / width rad per sample."""
    values = gaussian_filter1d(random.normal(size=size), width)
    return values / values.std()


@pytest.mark.parametrize(("size", "accuracy"), [(500, 0.1), (2000, 0.05), (8000, 0.05)])
@pytest.mark.parametrize("noise", [0.003, 0.1])
def test_the_size_of_white_noise_is_found_beside_a_signal(random, size, accuracy, noise):
    sizes = [estimate_noise(slow(random, size) + noise * random.normal(size=size)).size for _ in range(20)]
    assert np.mean(sizes) == pytest.approx(noise, rel=accuracy)


def autocorrelated(random, size, correlation):
    """Return noise of unit variance with a correlation from sample to sample."""
    return lfilter([(1.0 - correlation**2) ** 0.5], [1.0, -correlation], random.normal(size=size + 200))[200:]


@pytest.mark.parametrize("correlation", [0.5, 0.8])
def test_the_correlation_of_noise_is_found_beside_a_signal_and_not_exceeded_on_average(random, correlation):
    """As white noise, that of 0.8 would have a third of its size: (8.87 / 70)^0.5 by the fourth differences."""
    found = [estimate_noise(slow(random, 4000) + 0.03 * autocorrelated(random, 4000, correlation)) for _ in range(20)]
    assert 0.8 * correlation < np.mean([noise.correlation for noise in found]) < correlation
    assert 0.7 * 0.03 < np.mean([noise.size for noise in found]) < 0.03


def test_the_power_of_autocorrelated_noise_is_that_of_its_cosine_transform(random):
    waves = np.mean([dct(autocorrelated(random, 512, 0.8), norm="ortho") ** 2 for _ in range(400)], axis=0)
    expected = Noise(1.0, 0.8).power(512)
    for band in (slice(1, 20), slice(100, 130), slice(400, 500)):
        assert waves[band].mean() == pytest.approx(expected[band].mean(), rel=0.1)


def test_steps_and_held_values_have_no_noise(random):
    steps = np.repeat(random.normal(size=40), 50)
    held = np.repeat(slow(random, 500), 4)
    assert estimate_noise(steps).size == 0.0
    assert estimate_noise(held).size == 0.0
    assert without_noise(steps, Noise(0.0)) is steps


def test_fast_steering_is_not_noise():
    """A sweep up to a third of the sample rate, 25 Hz."""
    time = np.arange(0.0, 30.0, 0.04)
    sweep = np.sin(2.0 * np.pi * (0.2 * time + 0.5 * 8.0 / 30.0 * time**2))
    assert np.allclose(without_noise(sweep, estimate_noise(sweep)), sweep, atol=0.01)


def test_the_filter_is_that_of_wiener(random):
    """White noise of the variance S in white noise of the variance σ²: all is multiplied by S / (S + σ²)."""
    signal, noise = random.normal(size=20_000), 0.5 * random.normal(size=20_000)
    expected = (signal + noise) / 1.25
    assert np.std(without_noise(signal + noise, Noise(0.5)) - expected) < 0.1 * np.std(expected)


def test_a_regression_on_the_filtered_input_is_consistent(random):
    """A gain of 2 from a signal of variance 1 in noise of variance 1 would be attenuated to 2 · 1 / (1 + 1)."""
    signal = slow(random, 40_000)
    recorded = signal + random.normal(size=len(signal))
    answer = 2.0 * signal + 0.1 * random.normal(size=len(signal))
    clean = without_noise(recorded, estimate_noise(recorded))
    assert answer @ recorded / (recorded @ recorded) == pytest.approx(1.0, rel=0.05)
    assert answer @ clean / (clean @ clean) == pytest.approx(2.0, rel=0.02)


def test_a_ramp_keeps_its_ends(random):
    ramp = np.linspace(0.0, 1.0, 1000)
    clean = without_noise(ramp + 0.001 * random.normal(size=1000), Noise(0.001))
    assert np.max(np.abs(clean - ramp)) < 0.003


def test_noise_of_the_steering_does_not_look_like_a_lag(monkeypatch):
    """5 mrad beside some 25 mrad of steering: a longer lag beside a shorter dead time would filter the noise."""
    log = lateral_log(channels=("yaw_rate", "lateral_acceleration", "vy"))
    noise = np.random.default_rng(1).normal(0.0, 0.005, len(log.time))
    log = replace(log, channels={**log.channels, "road_wheel_angle": log.channels["road_wheel_angle"] + noise})
    settings = {"mass": Setting(fixed=MASS), "front_length": Setting(fixed=FRONT), "rear_length": Setting(fixed=REAR),
                "steering_lag": Setting(free=True)}  # fmt: skip
    model = ModelSpec("single_track", {"tyres": "linear", "roll": False})

    def deviations():
        found = fit(DataSet((log,), wheelbase=FRONT + REAR), model, parameters=settings)
        return [
            abs(found[name].value - TRUTH[name]) / (found[name].sigma_noise or 0.0)
            for name in ("steering_delay", "steering_lag")
        ]

    assert max(deviations()) < 2.0
    monkeypatch.setattr(segments, "estimate_noise", lambda values: Noise(0.0))
    assert min(deviations()) > 4.0
