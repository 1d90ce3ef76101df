"""Logs with the faults of real cars and small robots: each is added to a simulated drive, and found with its size."""

from dataclasses import replace
from math import degrees

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid

from mirdrake.identification import DataSet, Log, check_data
from mirdrake.identification.alignment import estimate_delay
from tests.test_identification_data import CAR, STEP, changed, checked, clean, held, recorded
from tests.timing import reference_seconds

GPS_NORTH = 5_300_000.0


def robot(seed=0, *, rate=50.0):
    """A drive of a small robot, 90 s: 0.33 m long, up to 3 m/s, with a servo command and poses of a camera system."""
    random = np.random.default_rng(seed)
    time = np.arange(int(90 * rate)) / rate
    speed = 1.6 + 1.1 * np.sin(0.35 * time) + 0.25 * np.sin(1.7 * time)
    command = 0.55 * np.sin(0.9 * time) + 0.35 * np.sin(2.6 * time + 1.0)
    angle = 0.34 * np.convolve(np.pad(command, (10, 0), "edge"), np.ones(11) / 11, "valid") + 0.02
    turn = speed * np.tan(angle) / 0.33
    yaw = cumulative_trapezoid(turn, time, initial=0.0)
    x, y = (cumulative_trapezoid(speed * component(yaw), time, initial=0.0) for component in (np.cos, np.sin))
    channels = {
        "vx": speed + random.normal(0, 0.02, len(time)),
        "yaw_rate": turn + random.normal(0, 0.02, len(time)),
        "longitudinal_acceleration": np.gradient(speed, time) + random.normal(0, 0.15, len(time)),
        "lateral_acceleration": speed * turn + random.normal(0, 0.15, len(time)),
        "yaw": yaw + random.normal(0, 0.003, len(time)),
        "x": x + random.normal(0, 0.002, len(time)),
        "y": y + random.normal(0, 0.002, len(time)),
        "steering_command": command,
    }
    return Log("robot", "train", time, channels)


def copied(log, counts, *, step):
    """Return a log in which each row is repeated so many times, with a clock of even steps."""
    channels = {name: np.repeat(values, counts) for name, values in log.channels.items()}
    return replace(log, time=np.arange(int(np.sum(counts))) * step, channels=channels)


def test_the_robot_itself_is_clean():
    report = checked(robot(), repairs=())
    odd = [finding for finding in report.findings if finding.severity != "info" and finding.check != "bias"]
    assert [finding.text for finding in odd] == []
    (bias,) = report.of("bias", "steering_command")
    assert bias.value == pytest.approx(-0.02 / 0.34, abs=0.015)


@pytest.mark.parametrize("stated", [0.5, 2.0, 10.0])
def test_a_robot_log_copied_to_a_higher_rate_with_a_wrong_step(stated):
    log = robot(1)
    report = checked(copied(log, np.full(len(log.time), 10), step=stated * 0.002))
    (hold,) = report.of("held_values")
    assert (hold.value, hold.channel) == (10.0, "")
    (step,) = report.of("sample_time")
    assert step.value == pytest.approx(0.02, rel=0.02)
    corrected = report.data.logs[0]
    assert np.ptp(corrected.time) == pytest.approx(90.0, rel=0.02)
    assert report.unrepaired_faults == []


def test_a_copy_with_holds_of_changing_length_is_found_and_thinned():
    log = recorded(20)
    counts = np.random.default_rng(3).integers(3, 7, len(log.time))
    report = checked(copied(log, counts, step=STEP / counts.mean()))
    (hold,) = report.of("held_values")
    assert hold.channel == ""
    assert hold.value == pytest.approx(counts.mean(), rel=0.01)
    assert "3 to 6 rows" in hold.text
    assert np.array_equal(report.data.logs[0].channels["vx"], log.channels["vx"])


def test_forty_milliseconds_between_bus_and_inertial_unit():
    """All channels of the inertial unit are delayed and those of the bus are not, or vice versa."""
    imu = ("longitudinal_acceleration", "lateral_acceleration", "yaw_rate@imu")
    log = recorded(21)
    log = changed(log, **{"yaw_rate@imu": log.channels["yaw_rate"]})
    late = {name: np.interp(log.time - 0.04, log.time, log.channels[name]) for name in imu}
    report = checked(changed(log, **late))
    for name in imu:
        (fault,) = [finding for finding in report.of("delay") if finding.channel.split(", ")[0] == name]
        assert fault.value == pytest.approx(0.04, abs=0.002), name
        assert fault.repair
    again = check_data(report.data)
    assert max(abs(finding.value) for finding in again.of("delay")) < 0.002


def test_without_a_lateral_velocity_its_part_is_not_taken_for_a_delay():
    report = checked(recorded(40, without=("vy",)))
    (finding,) = report.of("delay", "lateral_acceleration, yaw_rate")
    assert abs(finding.value) > 0.005
    assert (finding.severity, finding.repair) == ("info", "")
    assert "without a measured vy" in finding.text
    assert report.repairs == []


def test_uncertainty_of_delays_is_that_of_the_noise():
    """Compare the reported sigma with the Cramér-Rao bound of an acceleration against a velocity, both with noise."""
    time, channels = clean()
    jerk = np.gradient(channels["longitudinal_acceleration"], time)
    bound = 0.05 / np.sqrt(np.sum(jerk**2))
    delays = []
    for seed in range(12):
        log = recorded(seed, late={"longitudinal_acceleration": 3.0})
        values = log.channels
        right = np.gradient(values["vx"], STEP) - values["yaw_rate"] * values["vy"]
        delay = estimate_delay(values["longitudinal_acceleration"], right, STEP)
        assert delay is not None
        delays.append(delay)
    errors = np.array([finding.value for finding in delays]) - 0.03
    assert np.sqrt(np.mean(errors**2)) < 1.6 * bound
    assert np.sqrt(np.mean(errors**2)) < 0.06 * STEP
    assert 0.3 < np.mean([finding.sigma for finding in delays]) / np.sqrt(np.mean(errors**2)) < 3.0


def test_steering_in_normalised_units_is_reported_with_its_scale():
    log = recorded(22)
    report = checked(changed(log, road_wheel_angle=log.channels["road_wheel_angle"] / 0.05))
    (finding,) = report.of("kinematics", "yaw_rate, road_wheel_angle")
    own = checked(log).of("kinematics", "yaw_rate, road_wheel_angle")[0].value  # below 1: the tyres slip
    assert finding.value == pytest.approx(0.05 * own, rel=1e-3)
    assert finding.severity == "warning"
    report = check_data(DataSet((robot(2),)))
    (finding,) = report.of("kinematics", "yaw_rate, steering_command")
    assert finding.value == pytest.approx(0.33 / 0.34, rel=0.1)  # wheelbase over the angle at full command
    assert "m: wheelbase times ratio" in finding.text


def test_a_yaw_rate_in_degrees_is_reported_even_when_little_else_is_logged():
    log = robot(3)
    few = {name: log.channels[name] for name in ("vx", "yaw_rate", "steering_command")}
    few["yaw_rate"] = degrees(1.0) * few["yaw_rate"]
    report = checked(replace(log, channels=few))
    assert any("deg as rad" in finding.text for finding in report.of("units"))
    assert report.unrepaired_faults


@pytest.mark.parametrize("size", [30.0, 1e4, 1e7])
@pytest.mark.parametrize("length", [1, 3, 40])
def test_glitches_orders_of_magnitude_out_are_found_whatever_their_length(size, length):
    log = recorded(23)
    values = log.channels["yaw_rate"].copy()
    rows = np.unique(np.concatenate([np.arange(row, row + length) for row in (333, 2100)]))
    values[rows] = size * np.ptp(values)
    report = checked(changed(log, yaw_rate=values))
    (finding,) = report.of("glitches")
    assert (finding.channel, finding.value) == ("yaw_rate", len(rows))
    assert not report.of("sample_time")
    assert np.max(np.abs(report.data.logs[0].channels["yaw_rate"])) < 1.0


def test_duplicated_stamps_are_is_omitted():
    log = recorded(24)
    time = log.time.copy()
    again = np.arange(50, 4000, 200)
    time[again] = time[again - 1]
    report = checked(replace(log, time=time))
    assert report.of("timestamps")[0].value == len(again)
    assert len(report.data.logs[0].time) == len(log.time) - len(again)


@pytest.mark.parametrize("count", [1, 3, 12, 150])
def test_dummy_first_rows_are_is_omitted(count):
    log = recorded(25)
    _, channels = clean()
    angle = cumulative_trapezoid(channels["yaw_rate"], dx=STEP, initial=0.0)
    x, y = (
        cumulative_trapezoid(channels["vx"] * component(angle), dx=STEP, initial=0.0) for component in (np.cos, np.sin)
    )
    log = changed(log, x=x + 700_000.0, y=y + GPS_NORTH)
    values = {name: np.concatenate((np.zeros(count), signal)) for name, signal in log.channels.items()}
    report = checked(Log("dummy", "train", np.arange(float(len(log.time) + count)) * STEP, values))
    (finding,) = report.of("first_rows")
    assert finding.value == count
    assert report.data.logs[0].channels["x"][0] == pytest.approx(700_000.0, abs=1.0)
    assert report.unrepaired_faults == []


def test_a_first_stamp_from_long_ago_does_not_hang_the_check():
    log = recorded(26)
    time = np.append(0.0, log.time + 1.7e9)
    values = {name: np.append(0.0, signal) for name, signal in log.channels.items()}
    report = checked(Log("old", "train", time, values))
    (fault,) = [finding for finding in report.of("gaps") if finding.unit == "stretches"]
    assert "one stretch kept, 1 row of" in fault.repair
    assert np.ptp(report.data.logs[0].time) == pytest.approx(40.0)
    assert checked(Log("old", "train", time, values), repairs=()).table()


def test_a_long_gap_cuts_a_log_into_parts():
    log = recorded(27)
    time = log.time + np.where(log.time > 15.0, 60.0, 0.0)
    report = checked(replace(log, time=time))
    assert [log.name for log in report.data.logs] == ["drive, part 1", "drive, part 2"]
    assert [len(log.time) for log in report.data.logs] == [1501, 2500]
    assert [log.use for log in report.data.logs] == ["train", "train"]


def test_positions_in_single_precision_are_reported_and_still_used():
    log = recorded(28)
    _, channels = clean()
    yaw = np.cumsum(channels["yaw_rate"]) * STEP
    x, y = (np.cumsum(channels["vx"] * component(yaw)) * STEP for component in (np.cos, np.sin))
    x, y = (np.float32(value).astype(float) for value in (x + 700_000.0, y + GPS_NORTH))
    report = checked(changed(log, x=x, y=y))
    (finding,) = report.of("quantisation", "y")
    assert finding.value == 0.5
    assert "single precision" in finding.text
    assert report.of("kinematics", "vx, x, y")[0].value == pytest.approx(1.0, abs=0.05)
    assert not report.of("held_values")
    assert not report.of("glitches")


def test_positions_that_are_held_and_coarse_are_found_held():
    log = recorded(29)
    _, channels = clean()
    x = held(np.float32(np.cumsum(channels["vx"]) * STEP + GPS_NORTH).astype(float), 20)
    y = held(np.float32(0.3 * np.cumsum(channels["vx"]) * STEP + 700_000.0).astype(float), 20)
    report = checked(changed(log, x=x, y=y))
    assert {finding.channel: finding.value for finding in report.of("held_values")} == {"x": 20.0, "y": 20.0}


def test_one_relation_a_tenth_off_is_not_taken_for_a_wrong_step():
    """Gravity in a pitching car: a tenth more acceleration than the derivative of the speed, in one channel only."""
    log = recorded(30, without=("yaw",))
    report = checked(changed(log, longitudinal_acceleration=1.12 * log.channels["longitudinal_acceleration"]))
    assert not report.of("sample_time")
    assert report.repairs == []
    assert report.of("kinematics", "longitudinal_acceleration, vx")[0].severity == "warning"


def test_biases_at_rest_and_codes_of_gears_are_reported():
    log = recorded(31)
    # At the end: rows at the beginning in which nothing changes before a jump are taken for dummies.
    values = {name: np.concatenate((signal, np.zeros(200))) for name, signal in log.channels.items()}
    values["yaw_rate"] += 0.02
    values["gear"] = np.concatenate((np.full(4001, 2.0), np.full(200, -3.0)))
    report = checked(Log("rest", "train", np.arange(4201.0) * STEP, values))
    assert report.of("bias", "yaw_rate")[0].value == pytest.approx(0.02)
    assert "-3, 2" in report.of("codes", "gear")[0].text


def test_the_position_of_the_lateral_velocity_sensor_is_reported():
    """Our vy is measured at the centre of mass, 1.5 m ahead of the rear axle. Slow and fast curves are needed."""
    time = np.arange(6001.0) * STEP
    speed = 9.0 + 6.0 * np.sin(0.3 * time)
    turn = 2.0 * np.sin(0.8 * time) / speed
    slip = CAR.mass * CAR.front_length / (CAR.rear_stiffness * (CAR.front_length + CAR.rear_length))
    side = turn * (CAR.rear_length - slip * speed**2)
    noise = np.random.default_rng(0).normal(0, 0.003, len(time))
    report = checked(Log("bends", "train", time, {"vx": speed, "yaw_rate": turn, "vy": side + noise}))
    assert report.of("sensor_position", "vy")[0].value == pytest.approx(CAR.rear_length, abs=0.05)


@pytest.mark.slow
def test_a_log_of_a_million_rows_takes_seconds():
    log = recorded(3)
    count, random = 250, np.random.default_rng(1)
    channels = {
        name: np.tile(values, count) + random.normal(0, 1e-4, count * len(values))
        for name, values in log.channels.items()
    }
    long = replace(log, time=np.arange(count * len(log.time)) * STEP, channels=channels)
    assert reference_seconds(lambda: checked(long), times=1) < 20.0
