"""Glitches of a channel and motions that resemble them: kicks of simulated vehicles, and injected outliers."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import maximum_filter1d
from scipy.signal import lfilter, lsim, lti

import mirdrake as mir
from mirdrake.identification import Log
from mirdrake.identification.channels import channel
from mirdrake.identification.column_names import channels_of_run
from mirdrake.identification.plausibility import check_relations
from mirdrake.identification.samples import check_glitches, find_glitches
from mirdrake.identification.timing import check_first_rows
from mirdrake.vehicles.scaffold import new_vehicle
from tests.marks import mostly_slow

START = [
    -0.000090, -0.000084, -0.000076, 0.018767, 0.060073, 0.049380, 0.009420, -0.012769, -0.012157, -0.003624, 0.001619,
    0.001912, 0.000683, -0.000184, -0.000363, -0.000205, -0.000032, 0.000031, 0.000020, -0.000008, -0.000021, -0.000020,
]  # fmt: skip
"""Pitch rate of a robot that stops accelerating [rad/s], 20 ms from sample to sample: it vibrates on its tyres."""


@cache
def drive(name, folder=None):
    """Return a log of ten seconds: a vehicle accelerates from rest and turns."""
    is_car = name in {"bolt", "catvehicle", "mkz"}
    world, start, track = ("test_track", "line", "main") if is_car else ("skidpad", "eight", "eight")
    diagram = mir.Diagram(world=world, time_step=0.005)
    ego = diagram.add_vehicle(name if folder is None else str(folder), start=start)
    diagram.drive(ego, mir.PathTracking(track=track, speed=5.0 if is_car else 1.5))
    diagram.sensors(ego, "imu")
    signals = diagram.simulate(10.0, inner=False).signals.iloc[1:]
    columns = channels_of_run(signals.columns)
    assert columns is not None
    return Log(name, "train", signals.index.to_numpy(), {columns[key]: signals[key].to_numpy() for key in columns})


@pytest.fixture
def log(request, tmp_path_factory):
    if request.param != "robot":
        return drive(request.param)
    folder = tmp_path_factory.getbasetemp() / "models" / "robot"
    if not folder.exists():
        new_vehicle(
            "robot", folder=folder.parent, wheelbase=0.6, track=0.5, mass=60.0, wheel_radius=0.12, sensors="imu"
        )
    return drive("robot", folder)


VEHICLES = mostly_slow(["robot", "bolt", "catvehicle", "mkz", "unior"], fast=0)


@pytest.mark.parametrize("log", VEHICLES, indirect=True)
def test_a_simulated_drive_has_no_glitch(log):
    _, findings = check_glitches(log, repair=False)
    assert [(finding.channel, finding.text) for finding in findings] == []


@pytest.mark.parametrize("log", VEHICLES, indirect=True)
def test_injected_glitches_of_a_simulated_drive_are_found(log):
    random = np.random.default_rng(5)
    # A kick at the same time cannot be separated from a glitch: torque or braking begins where the acceleration jumps.
    jumps = np.abs(np.diff(log.channels["vx"], n=2))
    near_jump = maximum_filter1d(jumps, 40)[10:-10] > 0.1 * jumps.max()
    calm = np.flatnonzero(~near_jump) + 10
    assert len(calm) > 200
    for name, values in log.channels.items():
        # Signals that are zero but for rounding and friction have no scale.
        if not channel(name).moves or np.ptp(values) < 1e-4:
            continue
        for _ in range(6):
            count = int(random.integers(1, 4))
            rows = int(random.choice(calm)) + np.arange(count)
            changed = values.copy()
            changed[rows] += random.choice([-1.0, 1.0]) * random.uniform(3.0, 30.0) * np.ptp(values)
            assert np.flatnonzero(find_glitches(changed, np.inf)).tolist() == rows.tolist(), name


def test_a_vibration_after_a_kick_is_a_motion_and_a_glitch_beside_it_is_found():
    values = np.concatenate([1e-6 * np.sin(np.arange(80.0)), START, -2e-5 + 1e-6 * np.sin(np.arange(400.0))])
    assert not find_glitches(values, np.inf).any()
    values[[60, 130, 131]] += 0.05
    assert np.flatnonzero(find_glitches(values, np.inf)).tolist() == [60, 130, 131]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("frequency", "damping"), [(2.0, 0.3), (6.0, 0.1), (10.0, 0.3)])
def test_only_what_is_added_to_a_process_is_a_glitch_and_no_kick_of_it(frequency, damping, seed):
    """A vibration by closed form, driven by noise and by kicks of 60 standard deviations, sampled at 50 Hz."""
    random = np.random.default_rng(seed)
    pole = np.exp(0.02 * 2.0 * np.pi * frequency * (-damping + 1j * np.sqrt(1.0 - damping**2)))
    force = random.normal(0.0, 1.0, 1500)
    kicks = np.arange(100, 1400, 200)
    force[kicks] += 60.0 * random.choice([-1.0, 1.0], len(kicks))
    values = lfilter([1.0], [1.0, -2.0 * pole.real, abs(pole) ** 2], force)
    assert not find_glitches(values, np.inf).any()
    glitches = kicks[:-1] + 100
    values[glitches] += 60.0 * np.std(values[190:])
    assert np.flatnonzero(find_glitches(values, np.inf)).tolist() == glitches.tolist()


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("scale", "severity"), [(1.0, "info"), (2.0, "warning")])
def test_noise_of_a_second_gyro_is_not_taken_for_its_scale(scale, severity, seed):
    """A pitch rate at rest but for vibrations: noise of 0.8 of its size makes the gain 1.3; a factor of 2 is one."""
    random = np.random.default_rng(seed)
    time: Any = 0.02 * np.arange(4000)
    rate: Any = np.convolve(random.normal(0.0, 1.0, 4000), np.exp(-np.arange(40) / 5.0), "same") * 1e-3
    second: Any = scale * (
        rate + np.convolve(random.normal(0.0, 0.8, 4000), np.exp(-np.arange(40) / 5.0), "same") * 1e-3
    )
    log = Log("drive", "train", time, {"pitch_rate": rate, "pitch_rate@imu": second})
    (finding,) = [item for item in check_relations(log) if item.check == "kinematics"]
    assert finding.value == pytest.approx(1.28 * scale, rel=0.15)
    assert finding.severity == severity


@pytest.mark.parametrize("first", [0.0, 900.0])
def test_a_zero_before_the_first_measurement_is_no_fault(first: float) -> None:
    time = np.arange(0.0, 20.0, 0.02)
    load = 160.0 + 10.0 * np.sin(3.0 * time) + 20.0 * np.sin(7.0 * time)
    values = load.copy()
    values[0] = first
    log, findings = check_glitches(Log("a", "train", time, {"tyre_force_z_front_left": values}), repair=True)
    (finding,) = findings
    if first == 0.0:
        assert (finding.check, finding.severity, finding.value) == ("first_rows", "warning", 1.0)
        assert finding.text == f"not measured in 1 row at the beginning: 0 there, then {load[1]:.4g} N"
    else:
        assert (finding.check, finding.severity) == ("glitches", "fault")
    assert log.channels["tyre_force_z_front_left"][0] == load[1]
    np.testing.assert_array_equal(log.channels["tyre_force_z_front_left"][1:], load[1:])


def launch(seed):
    """Return time, channels of a launch from rest and a long steady drive, and the first row of the steady drive.

    The speed follows a ramp of the set-point directly or as a second-order lag; with a stop on the way in some cases.
    """
    random = np.random.default_rng(seed)
    step, fine = 1.0 / random.choice([25.0, 50.0, 100.0]), 8
    time: Any = np.arange(0.0, random.uniform(40.0, 120.0), step / fine)
    speed, acceleration = random.uniform(0.5, 15.0), random.uniform(1.0, 4.0)
    begin = random.choice([0.0, random.uniform(0.1, 2.0)])
    vx: Any = np.clip(acceleration * (time - begin), 0.0, speed)
    if seed % 3 == 0:
        vx -= np.clip(speed - acceleration * np.abs(time - 0.6 * time[-1]), 0.0, speed)
    if seed % 2:
        natural = random.uniform(3.0, 12.0)
        vx = lsim(lti([natural**2], [1.0, 1.4 * natural, natural**2]), vx, time)[1]
    pitch_mode, damping = 2.0 * np.pi * random.uniform(1.0, 4.0), random.uniform(0.1, 0.4)
    rise: Any = np.gradient(vx, time)
    pitch_rate = lsim(lti([0.01 * pitch_mode**2, 0.0], [1.0, 2.0 * damping * pitch_mode, pitch_mode**2]), rise, time)[1]
    channels = {"vx": vx, "wheel_rate_front_left": vx / 0.12, "yaw_rate": 0.2 * vx, "pitch_rate": pitch_rate}
    channels |= {"longitudinal_acceleration": rise, "tyre_force_x_front_left": 200.0 * rise}
    # No vehicle keeps its speed exactly.
    noise = random.choice([1e-6, 1e-4, 1e-3])
    sampled = {
        name: values[::fine] + noise * np.ptp(values) * random.normal(size=len(values[::fine]))
        for name, values in channels.items()
    }
    return time[::fine], sampled, int((begin + 2.0 * speed / acceleration + 4.0) / step)


@pytest.mark.parametrize("seed", range(24))
def test_a_launch_and_a_stop_in_a_long_steady_drive_are_no_glitches(seed):
    time, channels, _ = launch(seed)
    assert {name: int(find_glitches(values, np.inf).sum()) for name, values in channels.items()} == dict.fromkeys(
        channels, 0
    )
    _, findings = check_first_rows(Log("launch", "train", time, channels), repair=True)
    assert findings == []


@pytest.mark.parametrize("seed", range(24))
@pytest.mark.parametrize("length", [1, 3, 15])
def test_faults_in_a_steady_drive_after_a_launch_are_found_in_continuous_channels(seed, length):
    """Up to four samples with an offset, or any number that repeat a code."""
    time, channels, steady = launch(seed)
    random = np.random.default_rng(seed)
    row = int(random.integers(steady, int(0.5 * len(time))))
    rows = row + np.arange(length)
    for name in ("vx", "wheel_rate_front_left", "yaw_rate"):
        values = channels[name].copy()
        size = random.choice([-1.0, 1.0]) * random.uniform(30.0, 300.0) * np.ptp(values)
        values[rows] = size if length > 4 else values[rows] + size
        assert np.flatnonzero(find_glitches(values, np.inf)).tolist() == rows.tolist(), name


def test_a_robot_at_rest_in_the_first_row_is_measured():
    """The pitch rate of a robot that stands in the first row and is at a steady 1.5 m/s for most of the log."""
    time = 0.02 * np.arange(3000.0)
    rate = np.full(3000, -0.0002) + 1e-6 * np.sin(np.arange(3000.0))
    rate[:40] = [0.0, -0.00038, -0.00027, -0.0549, -0.0448, -0.0105, 0.0094, *(0.02 * 0.9 ** np.arange(33.0))]
    vx = 1.5 * np.clip(time / 1.0, 0.0, 1.0) + 1e-5 * np.sin(time)
    _, findings = check_first_rows(Log("eight", "train", time, {"pitch_rate": rate, "vx": vx}), repair=True)
    assert findings == []


def peaks(seed, rate):
    """Return channels of a drive whose set-points step: forces have a peak at each step and go on to another level.

    The peaks decay to 0.05 to 0.6 from sample to sample, the acceleration follows, and the speed is its integral.
    """
    random = np.random.default_rng(seed)
    n = int(20.0 * rate)
    level, force = np.zeros(n), 1e-3 * random.normal(size=n)
    steps = np.sort(random.choice(np.arange(20, n - 20), 6, replace=False))
    for row in steps:
        size = random.normal()
        level[row:] += 0.3 * random.normal()
        force[row:] += size * random.uniform(0.05, 0.6) ** np.arange(n - row)
    force += level
    speed = 5.0 + np.cumsum(force) / rate
    acceleration = force / 40.0 + 1e-4 * random.normal(size=n)
    log = Log("peaks", "train", np.arange(n) / rate, {"vx": speed, "tyre_force_x_front_left": 100.0 * force,
              "longitudinal_acceleration": acceleration})  # fmt: skip
    return log, steps


@pytest.mark.parametrize("rate", [25.0, 50.0])
@pytest.mark.parametrize("seed", range(12))
def test_peaks_of_a_force_where_its_input_steps_are_no_glitches_and_faults_beside_them_are(seed, rate):
    log, steps = peaks(seed, rate)
    assert check_glitches(log, repair=False)[1] == []
    # A fault between calm samples, and one beside a step, which shows as it is far out of range.
    random = np.random.default_rng(seed)
    rows = [int(steps[0]) - 9, int(steps[1]) + 1]
    for name, values in log.channels.items():
        changed = values.copy()
        changed[rows] += random.choice([-1.0, 1.0]) * np.array([2.0, 25.0]) * np.ptp(values)
        other = Log("peaks", "train", log.time, {**log.channels, name: changed})
        repaired, (finding,) = check_glitches(other, repair=True)
        found = np.flatnonzero(repaired.channels[name] != changed)
        # Samples next to the fault beside the step may count as a part of it.
        assert finding.channel == name
        assert set(rows) <= set(found.tolist()) <= {*rows, *(rows[1] + np.arange(-2, 2)).tolist()}
