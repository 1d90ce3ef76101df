"""Noise and timing of sensors: Allan deviation, repeatability, latency, dropout."""

from math import exp, inf, sqrt
from typing import Any

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from mirdrake.assembly.diagram import assemble
from mirdrake.runs.simulation import Simulation
from mirdrake.sensors.noise import Noise, noise_stream
from mirdrake.sensors.noise_spec import AccelerationNoise, LengthNoise, NoiseSpec, RateNoise
from mirdrake.sensors.sampling import aligned_period
from tests.sensor_rigs import Clock, TextClock, held, shown

RATE = 100.0


def series(specs: list[NoiseSpec], count: int, *, stream: int = 5, rate: float = RATE) -> np.ndarray:
    """Return errors of a sensor that measures nothing (count x n)."""
    noise = Noise.of(specs, rate)
    state, constant = noise.start(stream), noise.constant(stream)
    errors = np.empty((count, len(specs)))
    for index in range(count):
        error, state = noise.step(stream, index, state)
        errors[index] = error + constant
    return errors


def allan_deviation(samples: np.ndarray, rate: float, tau: float) -> float:
    """Overlapping Allan deviation of series (count x n), the mean variance of them; IEEE Std 952-1997, annex C."""
    m = round(tau * rate)
    angle = np.concatenate((np.zeros((1, samples.shape[1])), np.cumsum(samples, axis=0))) / rate
    second = angle[2 * m :] - 2.0 * angle[m:-m] + angle[: -2 * m]
    return sqrt(float((second**2).mean()) / (2.0 * tau**2))


# --- figures of data sheets --------------------------------------------------------------------------------------


def test_white_noise_has_the_allan_deviation_of_its_density() -> None:
    # N / sqrt(tau): 0.005 deg/s/√Hz is 8.7266e-5 rad/s/√Hz
    errors = series([RateNoise.model_validate({"density": "0.005 deg/s/√Hz"})] * 6, 20_000)
    for tau in (0.05, 0.2, 1.0):
        assert allan_deviation(errors, RATE, tau) == pytest.approx(8.7266e-5 / sqrt(tau), rel=0.05)


def test_the_density_holds_at_any_rate() -> None:
    for rate in (20.0, 400.0):
        errors = series([NoiseSpec(density=0.3)] * 6, 8_000, rate=rate)
        assert allan_deviation(errors, rate, 0.5) == pytest.approx(0.3 / sqrt(0.5), rel=0.1)


def test_bias_instability_is_the_plateau_of_the_allan_deviation() -> None:
    # with 0.5 s of correlation the highest point is at 0.945 s; 20 000 samples of 6 axes hold it 1200 times
    errors = series([NoiseSpec(instability=0.02, correlation=0.5)] * 6, 20_000)
    assert allan_deviation(errors, RATE, 0.94) == pytest.approx(0.02, rel=0.1)
    for tau in (0.47, 1.88):  # close to it the curve is flat, and lower
        assert 0.015 < allan_deviation(errors, RATE, tau) < 0.021


def test_a_random_walk_has_the_allan_deviation_of_its_coefficient() -> None:
    # K sqrt(tau / 3)
    errors = series([NoiseSpec(walk=0.01)] * 6, 20_000)
    for tau in (0.5, 2.0):
        assert allan_deviation(errors, RATE, tau) == pytest.approx(0.01 * sqrt(tau / 3.0), rel=0.1)


def test_all_parts_together_add_in_variance() -> None:
    spec = NoiseSpec(density=0.001, instability=0.004, correlation=0.5, walk=0.002, bias=5.0)
    errors = series([spec] * 6, 20_000)
    for tau in (0.05, 0.94, 4.0):
        u = tau / 0.5
        wander = (0.004 / 0.6174) ** 2 * 2.0 / u * (1.0 - (3.0 - 4.0 * exp(-u) + exp(-2.0 * u)) / (2.0 * u))
        expected = sqrt(0.001**2 / tau + wander + 0.002**2 * tau / 3.0)
        assert allan_deviation(errors, RATE, tau) == pytest.approx(expected, rel=0.1)


def test_a_bias_is_constant_and_has_its_standard_deviation_over_seeds() -> None:
    biases = []
    for seed in range(200):
        errors = series([NoiseSpec(bias=0.3)] * 3, 3, stream=noise_stream(seed, "ego.imu"))
        assert np.all(errors == errors[0])
        biases.append(errors[0])
    assert np.std(biases) == pytest.approx(0.3, rel=0.1)
    assert np.mean(biases) == pytest.approx(0.0, abs=4 * 0.3 / sqrt(600))


@pytest.mark.parametrize(
    ("kind", "key", "text", "value"),
    [
        (RateNoise, "density", "1 deg/√h", 2.908882e-4),  # pi/180/60
        (RateNoise, "density", "0.007 deg/s/sqrt(Hz)", 1.221730e-4),
        (RateNoise, "instability", "10 deg/h", 4.848137e-5),
        (RateNoise, "white", "0.1", 0.1),
        (AccelerationNoise, "density", "120 µg/√Hz", 1.176798e-3),
        (AccelerationNoise, "density", "60 ug/sqrt(Hz)", 5.883990e-4),
        (AccelerationNoise, "density", "0.06 m/s/√h", 1e-3),
        (AccelerationNoise, "bias", "2 mg", 1.961330e-2),
        (LengthNoise, "white", "25 cm", 0.25),
    ],
)
def test_units_of_data_sheets(kind: type[NoiseSpec], key: str, text: str, value: float) -> None:
    assert getattr(kind.model_validate({key: text}), key) == pytest.approx(value, rel=1e-6)


# --- repeatability -----------------------------------------------------------------------------------------------


def test_a_sensor_shows_the_noise_of_its_stream_also_what_wanders() -> None:
    noise = Noise.of([NoiseSpec(white=0.1, instability=0.2, correlation=1.0, walk=0.3, bias=0.4)], 10.0)
    times = [0.05 + 0.1 * k for k in range(20)]
    values = [float(value[0]) for value in shown(Clock(rate=10.0, noise=noise, stream=9), times)]
    spec = NoiseSpec(white=0.1, instability=0.2, correlation=1.0, walk=0.3, bias=0.4)
    expected = series([spec], 20, stream=9, rate=10.0)[:, 0] + 0.1 * np.arange(20)
    assert values == pytest.approx(expected, abs=1e-12)


def test_more_parts_of_an_error_change_nothing_about_its_white_noise() -> None:
    white, both = series([NoiseSpec(white=0.1)], 50), series([NoiseSpec(white=0.1, bias=0.2)], 50)
    assert both - white == pytest.approx(np.full((50, 1), both[0, 0] - white[0, 0]), abs=1e-15)


def test_runs_repeat_to_the_byte_whatever_else_is_mounted() -> None:
    def run(sensors: list[str]) -> Any:
        spec = {
            "world": "empty",
            "vehicles": {"ego": {"model": "mkz", "speed": 5.0}},
            "control": {"ego": {"kind": "constant", "speed": 5.0, "steering": 0.05}},
            "sensors": {"ego": sensors},
            "plant": {"contact": "point"},
            "record": {"meshcat": False, "report": False},
        }
        return Simulation(assemble(spec)).run(duration=0.2).signals

    first, again, more = run(["imu"]), run(["imu"]), run(["gps", "encoder_rear_left", "imu"])
    assert sum(name.startswith("ego.imu") for name in first.columns) == 6
    assert first.equals(again)
    assert first.equals(more[first.columns])


def test_all_that_a_sensor_remembers_is_in_its_context() -> None:
    noise = Noise.of([NoiseSpec(white=0.1, instability=0.2, walk=0.3)], 10.0)
    builder = DiagramBuilder()
    clock = builder.AddSystem(Clock(rate=10.0, noise=noise, latency=0.33, dropout=0.2))
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(1.05)
    kept = simulator.get_context().Clone()
    futures = []
    for other in (simulator, Simulator(diagram, kept)):
        values = []
        for step in range(12, 30):
            other.AdvanceTo(step / 10.0)
            values.append(held(clock, other).tolist())
        futures.append(values)
    assert futures[0] == futures[1]


# --- latency and dropout -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate", [10.0, 30.0, 75.0])
@pytest.mark.parametrize("latency", [0.0, 0.01, 0.1, 1.0 / 30.0, 0.257, 1.0])
def test_every_sample_is_shown_exactly_its_latency_after_it_was_taken(rate: float, latency: float) -> None:
    count = 20
    before = [k / rate + latency - 1e-7 for k in range(1, count)]
    after = [k / rate + latency + 1e-7 for k in range(1, count)]
    times = [time for pair in zip(before, after, strict=True) for time in pair]
    values = np.array(shown(Clock(rate=rate, latency=latency), times))[:, 0].reshape(-1, 2)
    assert values[:, 0] == pytest.approx(
        np.arange(count - 1) / rate, abs=1e-9
    )  # until now the one before: none is missing
    assert values[:, 1] == pytest.approx(np.arange(1, count) / rate, abs=1e-9)


def test_a_stamp_is_the_time_of_the_sample_that_is_shown() -> None:
    stamps = shown(Clock(rate=10.0, latency=0.25), [0.24, 0.26, 0.3, 0.36], "stamp")
    assert [float(stamp[0]) for stamp in stamps] == [-inf, 0.0, 0.0, 0.1]


def test_text_samples_have_latency_and_dropout() -> None:
    def texts(times: list[float], **more: Any) -> list[Any]:
        return shown(TextClock(rate=10.0, **more), times, "text")

    times = [0.24, 0.26, 0.34, 0.36, 1.16]
    samples = ["0 at 0.000000", "0 at 0.000000", "1 at 0.100000", "9 at 0.900000"]
    assert texts(times, latency=0.25) == ["nothing", *samples]
    assert texts([0.05, 0.15]) == ["0 at 0.000000", "1 at 0.100000"]
    stamps = shown(TextClock(rate=10.0, latency=0.25), times, "stamp")
    assert [float(stamp[0]) for stamp in stamps] == [-inf, 0.0, 0.0, 0.1, 0.9]
    every = [0.1 * k + 0.05 for k in range(100)]
    kept = {text.split()[0] for text in texts(every, dropout=0.3, stream=1)}
    late = {text.split()[0] for text in texts([time + 0.3 for time in every], dropout=0.3, stream=1, latency=0.3)}
    assert kept == late
    assert 55 <= len(kept) <= 85


@pytest.mark.parametrize("latency", [0.0, 0.035])
def test_the_share_of_lost_samples_is_the_dropout(latency: float) -> None:
    times = [k / 100.0 + latency + 1e-6 for k in range(2000)]
    stamps = np.array(shown(Clock(rate=100.0, dropout=0.2, latency=latency), times, "stamp"))[:, 0]
    lost = stamps != [k / 100.0 for k in range(2000)]
    assert lost.mean() == pytest.approx(0.2, abs=4 * sqrt(0.16 / 2000))
    runs = np.mean(lost[1:] & lost[:-1])
    assert runs == pytest.approx(0.04, abs=0.02)  # one after another by chance only


def test_the_same_samples_are_lost_with_and_without_latency_and_noise() -> None:
    times = [k / 100.0 + 1e-6 for k in range(200)]
    plain = np.array(shown(Clock(rate=100.0, dropout=0.3), times, "stamp"))
    late = np.array(shown(Clock(rate=100.0, dropout=0.3, latency=0.5, noise=1.0), [t + 0.5 for t in times], "stamp"))
    assert np.array_equal(plain, late)


def test_a_sensor_keeps_step_with_the_plant_where_it_can() -> None:
    assert aligned_period(100.0, 0.005) == aligned_period(100.0, 0.002) == 0.01
    for rate, step in ((10.0, 0.005), (30.0, 0.005), (100.0, 0.0)):  # late at 0.3 s, on no step, no steps
        assert aligned_period(rate, step) < 1.0 / rate
        assert aligned_period(rate, step) == pytest.approx(1.0 / rate, rel=1e-14)


def test_samples_see_the_plant_as_it_is_at_their_time() -> None:
    # 3 x 0.1 s comes after 60 x 0.005 s in floating point: a sensor that followed would see the step from 0.3 on
    assert 3 * 0.1 > 60 * 0.005
    taken = [float(value[0]) for value in shown(Clock(rate=10.0), [0.1 * k + 0.01 for k in range(100)])]
    assert all(time <= k * 0.1 for k, time in enumerate(taken))
    assert taken == pytest.approx(np.arange(100) / 10.0, abs=1e-12)
