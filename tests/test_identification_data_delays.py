"""Delays of one recorder in all of its drives, sensors on a body that rolls, and channels of a slower source."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from mirdrake.identification import DataSet, Log, check_data
from mirdrake.identification.lateral_delays import (
    NO_DELAY,
    Hypothesis,
    LateralDelays,
    _explains,
    estimate_lateral_delays,
)
from mirdrake.identification.relations import make_grid
from mirdrake.identification.splines import Spline
from mirdrake.identification.timing import hold_factor
from tests.test_identification_data import STEP, changed, checked, held, recorded
from tests.test_identification_data_lateral import drive


def part_of(log, name, seconds):
    """Return the first seconds of a log."""
    rows = int(seconds / STEP)
    channels = {key: values[:rows] for key, values in log.channels.items()}
    return replace(log, name=name, time=log.time[:rows], channels=channels)


def calm(log, name):
    """Return a log with hardly any yaw motion, from which the delay of vy cannot be determined."""
    quiet = {key: values - log.channels[key].mean() for key, values in log.channels.items() if key != "vx"}
    random = np.random.default_rng(0)
    noise = {"vy": 0.02, "yaw_rate": 0.004, "lateral_acceleration": 0.1}
    channels = {key: 0.02 * values + random.normal(0.0, noise[key], len(values)) for key, values in quiet.items()}
    return replace(log, name=name, channels={**channels, "vx": log.channels["vx"]}, use="validation")


def shifts(report, name):
    """Return the repairs of vy in a log."""
    return [
        finding.repair
        for finding in report.findings
        if finding.log == name and finding.channel == "vy, lateral_acceleration"
    ]


def test_a_drive_without_excitation_is_shifted_like_the_others_of_its_recorder():
    """One drive that turns, and one that does not: shifted alone, the second would have another steering delay."""
    late = drive(10, late={"vy": 0.06})
    logs = (late, calm(late, "calm"), part_of(late, "short", 5.0))
    report = check_data(DataSet(logs, wheelbase=2.7))
    assert not shifts(checked(logs[1]), "calm")
    (done,) = shifts(report, "drive")
    assert done.startswith("shifted vy by -")
    assert shifts(report, "calm") == shifts(report, "short") == [done]
    assert report.of("delay", "vy, lateral_acceleration")[0].value == pytest.approx(0.06, abs=0.01)
    for before, after in zip(logs, report.data.logs, strict=True):
        assert np.array_equal(before.channels["yaw_rate"], after.channels["yaw_rate"])
        assert not np.array_equal(before.channels["vy"], after.channels["vy"])


def test_a_delay_that_cannot_be_compared_with_none_has_no_evidence():
    late = LateralDelays(0.0, 0.02, (0.0, 0.001), 0.0, 0.1, 0.99, False, 0.1, 0.01, 50.0, 200.0)
    for plain, expected in ((None, False), (late._replace(residual=0.02), True), (late, False)):
        logs: Any = SimpleNamespace(widths=(0.1,), estimate=lambda _, free, p=plain: p if free == NO_DELAY else late)
        assert _explains(Hypothesis(velocity=True), logs) == expected


def test_two_drives_reduce_the_uncertainty():
    grids = [make_grid(drive(seed, late={"vy": 0.06})) for seed in (11, 12)]
    single, both = (estimate_lateral_delays(some) for some in (grids[:1], grids))
    assert single is not None
    assert both is not None
    assert both.sigmas[1] < single.sigmas[1]
    assert both.velocity == pytest.approx(0.06, abs=0.005)


def test_drives_of_two_recorders_are_not_shifted():
    """All logs of a data set have one recorder; a delay of one of them only is none of the recorder."""
    first, second = drive(13, late={"vy": 0.1}), replace(drive(14), name="other")
    report = check_data(DataSet((first, second), wheelbase=2.7))
    for before, after in zip((first, second), report.data.logs, strict=True):
        assert np.array_equal(before.channels["vy"], after.channels["vy"])


def leaning(seed, *, late, height):
    """A drive at 15 m/s ± 7 with vy from an antenna on the roof of a body that rolls: 0.5 deg by m/s², 1.5 Hz, 0.3.

    Args:
        seed: of the noise.
        late: vx and vy [s].
        height: of the antenna over the accelerometer [m].
    """
    log = drive(seed, late={"vx": late, "vy": late})
    fine = np.arange(0.0, 80.0, STEP)
    roll, rate, natural = 0.0, 0.0, 2.0 * np.pi * 1.5
    rates = np.empty(len(fine))
    for row, side in enumerate(exact_side(fine)):
        rate += STEP * natural * (natural * (np.radians(0.5) * side - roll) - 2.0 * 0.3 * rate)
        roll += STEP * rate
        rates[row] = rate
    return changed(log, vy=log.channels["vy"] - height * np.interp(fine - late, fine, rates))


def exact_side(t):
    """Return the lateral acceleration of :func:`drive`, nearly: that of the yaw rate and the speed."""
    return (15.0 + 7.0 * np.sin(0.23 * t)) * (0.12 * np.sin(0.9 * t) + 0.08 * np.sin(2.9 * t + 1.0))


@pytest.mark.parametrize("late", [0.0, 0.06])
def test_roll_motion_of_a_roof_antenna_is_not_taken_for_a_delay_of_the_accelerometer(late):
    delays = estimate_lateral_delays([make_grid(leaning(15, late=late, height=1.0))])
    assert delays is not None
    assert delays.acceleration == 0.0
    assert delays.velocity == pytest.approx(late, abs=0.015)


@pytest.mark.parametrize("count", [2, 5])
def test_a_coarse_channel_of_a_slower_source_is_held_however_often_its_values_repeat(count):
    """Steps of 0.1 m/s², as on a bus: most rows repeat by chance, but no change comes between those of the source."""
    log = recorded(57)
    coarse = held(np.round(log.channels["lateral_acceleration"] / 0.1) * 0.1, count)
    assert hold_factor(coarse) == (count, 1.0 - 1.0 / count)
    report = checked(changed(log, lateral_acceleration=coarse))
    (fault,) = report.of("held_values")
    assert (fault.channel, fault.value) == ("lateral_acceleration", count)
    # Joined from each row of the source, none is late; joined from change to change, rests would be.
    corrected = report.data.logs[0].channels["lateral_acceleration"][::count]
    assert np.array_equal(corrected[10:-10], coarse[::count][10:-10])
    assert not [finding for finding in report.of("delay") if finding.repair]


def test_a_glitch_of_a_held_channel_is_found_before_it_is_joined_to_its_neighbours():
    log = recorded(58)
    values = held(log.channels["yaw_rate"], 10)
    values[1000:1010] = 5.0
    report = checked(changed(log, yaw_rate=values))
    (fault,) = report.of("glitches")
    assert (fault.channel, fault.value) == ("yaw_rate", 10.0)
    assert not [finding for finding in report.of("delay") if finding.repair]
    assert np.max(np.abs(report.data.logs[0].channels["yaw_rate"])) < 1.0


@pytest.mark.parametrize("moved", [0.0, 0.3, -2.7, 40.6, -55.2])
def test_a_curve_is_that_of_a_cubic_spline(moved):
    values = np.random.default_rng(0).normal(size=80)
    spline, curve = CubicSpline(np.arange(80.0), values), Spline(values)
    for derivative in range(3):
        expected = spline(np.arange(20, 60) + moved, derivative)
        assert curve.at(slice(20, 60), moved, derivative) == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_a_log_without_the_channels_does_not_count():
    whole = drive(16, late={"vy": 0.06})
    without = Log("bare", "train", whole.time, {name: whole.channels[name] for name in ("vx", "yaw_rate")})
    report = check_data(DataSet((whole, without), wheelbase=2.7))
    assert [finding.log for finding in report.of("delay", "vy, lateral_acceleration")] == ["drive"]
    assert np.array_equal(report.data.logs[1].channels["yaw_rate"], without.channels["yaw_rate"])


def test_an_accelerometer_ahead_in_an_accelerating_car_is_not_a_second_clock():
    """From 8 to 24 m/s within 80 s, 1.5 m are 190 ms at first and 60 ms at last."""
    t = np.arange(0.0, 80.0, STEP)
    speed = 8.0 + 0.2 * t
    r, turn = 0.1 * np.sin(2.0 * t), 0.2 * np.cos(2.0 * t)
    random = np.random.default_rng(0)
    exact = {"vx": speed, "yaw_rate": r, "vy": 0.3 * r, "lateral_acceleration": speed * r + (0.3 + 1.5) * turn}
    noise = {"vx": 0.02, "vy": 0.01, "yaw_rate": 0.002, "lateral_acceleration": 0.05}
    values = {name: signal + random.normal(0.0, noise[name], len(t)) for name, signal in exact.items()}
    report = checked(Log("faster", "train", t, values))
    assert not report.of("clock_drift")
    assert report.of("sensor_position", "lateral_acceleration")[0].value == pytest.approx(1.5, abs=0.1)
