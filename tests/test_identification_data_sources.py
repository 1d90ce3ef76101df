"""Logs of several sources: cameras and buses with separate rates and clocks, coarse stamps, headings, units."""

from dataclasses import replace
from math import pi

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from mirdrake.identification import Log, load_data
from mirdrake.identification.mapping import map_log
from mirdrake.identification.timing import hold_factor
from mirdrake.readers.units import unit_factor
from tests.test_identification_data import CAR, STEP, changed, checked, clean, held, recorded
from tests.test_identification_data_nasty import copied, robot

CAMERA = ("vx", "yaw", "x", "y")


def watched(seed=0, *, late=0.0):
    """Return the robot at 100 Hz, observed by a camera of 40 Hz whose values are held and delayed [s]."""
    log = robot(seed, rate=100.0)
    own = np.arange(0.0, log.time[-1], 0.025)
    channels = dict(log.channels)
    for name in CAMERA:
        index = np.searchsorted(own + late - 1e-7, log.time, side="right") - 1
        channels[name] = np.interp(own, log.time, channels[name])[np.maximum(index, 0)]
    channels["yaw"] = (channels["yaw"] + pi) % (2.0 * pi) - pi
    return replace(log, channels=channels)


def test_a_delayed_camera_is_found_by_its_heading_and_shifted_as_one_source():
    """On rows of 10 ms a value that comes every 25 ms waits for 2.5 ms in the mean."""
    report = checked(watched(late=0.05))
    (fault,) = report.of("delay", "yaw_rate, yaw")
    assert fault.value == pytest.approx(-0.0525, abs=0.001)
    assert "unwrapped" in report.of("range", "yaw")[0].text
    true, corrected = robot(0, rate=100.0).channels, report.data.logs[0].channels
    for name in CAMERA:
        assert any(name in item.partition("shifted ")[2] or f": {name}: shifted" in item for item in report.repairs)
        away = np.unwrap(corrected[name][100:-100]) if name == "yaw" else corrected[name][100:-100]
        assert np.std(away - true[name][100:-100]) < (0.03 if name == "vx" else 0.01)
    assert [finding.value for finding in report.of("held_values")] == pytest.approx([2.5] * 4, rel=0.01)
    again = checked(report.data.logs[0])
    assert abs(again.of("delay", "yaw_rate, yaw")[0].value) < 0.001


def test_a_camera_without_delay_is_not_shifted():
    report = checked(watched(1))
    assert not [finding for finding in report.of("delay") if finding.severity != "info"]


def test_a_copied_log_still_has_its_slow_channels():
    log = watched(2)
    report = checked(copied(log, np.full(len(log.time), 5), step=0.001))
    assert [(finding.channel, round(finding.value, 1)) for finding in report.of("held_values")] == [
        ("", 5.0), ("vx", 2.5), ("yaw", 2.5), ("x", 2.5), ("y", 2.5),
    ]  # fmt: skip
    assert report.of("sample_time")[0].value == pytest.approx(0.01, rel=0.005)


@pytest.mark.parametrize("late", [-0.03, 0.06])
def test_a_lateral_velocity_of_another_clock_is_found(late):
    log = recorded(50)
    report = checked(changed(log, vy=CubicSpline(log.time, log.channels["vy"])(np.clip(log.time - late, 0.0, 40.0))))
    (finding,) = report.of("delay", "vy, lateral_acceleration")
    assert finding.value == pytest.approx(late, abs=0.002)
    assert "shifted vy" in finding.repair
    assert not checked(report.data.logs[0]).of("delay", "vy, lateral_acceleration")


@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_a_clock_in_another_unit_is_found(factor):
    log = recorded(51)
    (finding,) = checked(replace(log, time=log.time / factor)).of("sample_time")
    assert finding.value == pytest.approx(STEP, rel=0.01)
    assert ("in ms" in finding.text) is (factor < 1.0)


def test_an_unusual_step_is_a_fault_even_if_the_true_one_is_unknown():
    log = recorded(52, without=("longitudinal_acceleration", "yaw"))
    report = checked(replace(log, time=log.time * 1e3))
    assert [finding.check for finding in report.unrepaired_faults] == ["sample_time"]
    assert "give the clock's unit" in report.unrepaired_faults[0].text


def test_stamps_of_whole_seconds_are_spread_over_their_rows():
    log = recorded(53)
    report = checked(replace(log, time=np.floor(log.time + 0.37)))
    (fault,) = [finding for finding in report.of("timestamps") if finding.repair]
    assert fault.value == pytest.approx(STEP, rel=1e-3)
    assert len(report.data.logs[0].time) == len(log.time)
    assert np.diff(report.data.logs[0].time) == pytest.approx(STEP, rel=0.02)
    assert report.unrepaired_faults == []


def test_empty_rows_of_a_slow_channel_are_not_a_fault():
    log = recorded(54)
    vy = np.where(np.arange(len(log.time)) % 4 == 1, log.channels["vy"], np.nan)
    report = checked(changed(log, vy=vy))
    (finding,) = report.of("missing", "vy")
    assert (finding.severity, "every 4th row" in finding.text) == ("info", True)
    assert not report.of("held_values")
    random = np.where(np.random.default_rng(0).uniform(size=len(vy)) < 0.5, np.nan, log.channels["vy"])
    assert checked(changed(log, vy=random)).of("missing", "vy")[0].severity == "fault"


def test_jitter_of_time_stamps_is_not_a_gap():
    log = recorded(55)
    swing = np.random.default_rng(0).uniform(-0.4, 0.4, len(log.time)) * STEP
    report = checked(replace(log, time=log.time + swing))
    assert report.of("gaps") == []
    assert report.of("timestamps")[0].severity == "warning"


def test_coarse_values_that_repeat_by_chance_are_not_held():
    """A speed in steps of 0.02 km/h, with noise of two steps: one row in seven repeats the one before."""
    rows = np.arange(12_000.0)
    speed = 15.0 + 10.0 * np.sin(0.001 * rows) + np.random.default_rng(0).normal(0.0, 0.01, len(rows))
    speed = np.round(speed * 180.0) / 180.0
    hold = hold_factor(speed)
    assert hold is not None
    assert hold[0] == 1.0
    assert hold[1] > 0.1
    assert hold_factor(held(speed, 2)) == (2.0, 0.5)


def test_a_repaired_glitch_is_not_out_of_range():
    log = recorded(56)
    values = log.channels["yaw_rate"].copy()
    values[[500, 2000]] = 1e5
    log = changed(log, yaw_rate=values)
    assert checked(log).unrepaired_faults == []
    assert {finding.check for finding in checked(log, repairs=()).unrepaired_faults} >= {"range", "glitches"}


def test_a_delayed_steering_has_no_bias_and_a_bias_is_reported_with_its_size():
    """Fast to the left, slowly back: a delay of 0.2 s changes the apparent mean of the steering."""
    log = recorded(57)
    late = np.interp(log.time + 0.2, log.time, log.channels["road_wheel_angle"])
    assert not checked(changed(log, road_wheel_angle=late)).of("bias")
    (finding,) = checked(changed(log, road_wheel_angle=late + 0.004)).of("bias")
    assert finding.value == pytest.approx(0.004, abs=0.001)


@pytest.mark.parametrize(
    ("unit", "si", "factor"),
    [
        ("m/s2", "m/s^2", 1.0), ("m/s**2", "m/s^2", 1.0), ("KPH", "m/s", 1.0 / 3.6), ("degrees", "rad", pi / 180.0),
        ("°/s", "rad/s", pi / 180.0), ("Deg/s", "rad/s", pi / 180.0), ("sec", "s", 1.0), ("Nm", "N m", 1.0),
    ],
)  # fmt: skip
def test_units_as_people_spell_them(unit, si, factor):
    assert unit_factor(unit, si) == pytest.approx(factor)


def test_a_file_and_a_mapping_may_spell_a_unit_in_two_ways(tmp_path):
    rows = "\n".join(f"{row * 10};{row % 7},5;" for row in range(40))
    (tmp_path / "a.csv").write_bytes(f"\ufeffTime [msec];Acc [m/s2];\n{rows}\n".encode())
    text = "mirdrake: data/1\ntime: Time\nchannels: {lateral_acceleration: {column: Acc, unit: m/s^2}}\n"
    text = text.replace("time: Time", "time: {column: Time}")
    (tmp_path / "d.yaml").write_text(text + "logs: [{file: a.csv}]\n")
    log: Log = load_data(tmp_path / "d.yaml").logs[0]
    assert log.time[1] == pytest.approx(0.01)
    assert log.channels["lateral_acceleration"][1] == 1.5


def test_a_column_whose_unit_does_not_fit_its_channel_is_not_mapped_by_its_name(tmp_path):
    rows = "\n".join(f"{row * 0.01},{row % 7},0.1,0.2" for row in range(40))
    (tmp_path / "a.csv").write_text(f"time [s],ego.vx [m/s],ego.steering_command [rad],ego.yaw_rate [km]\n{rows}\n")
    spec = map_log(tmp_path / "a.csv", ["lateral_acceleration=ego.vx:m/s^2"], None, None, None)
    assert set(spec.channels) == {"lateral_acceleration"}
    assert set(map_log(tmp_path / "a.csv", [], None, None, None).channels) == {"vx"}


def test_the_car_of_these_tests_steers_as_its_wheels_do():
    """The rig itself: a wheel angle has the scale of the wheelbase, below one for the slip."""
    (finding,) = checked(recorded(58)).of("kinematics", "yaw_rate, road_wheel_angle")
    assert 0.3 < finding.value < 1.0
    assert CAR.front_length + CAR.rear_length == pytest.approx(2.7)
    assert len(clean()[0]) == 4001
