"""Recorded drives and their check: each fault of real logs is added to a clean one, and found with its size."""

import re
from contextlib import suppress
from dataclasses import replace
from functools import cache
from itertools import product
from math import degrees, pi
from typing import Literal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial
from scipy.interpolate import CubicSpline
from scipy.io import savemat

from mirdrake.core.errors import ConfigError
from mirdrake.identification import DataSet, Log, check_data, load_data
from mirdrake.identification.alignment import estimate_delay
from mirdrake.identification.channels import CHANNELS
from mirdrake.identification.findings import DataReport, Excitation, Finding, statement
from mirdrake.identification.plausibility import check_relations
from mirdrake.identification.samples import find_glitches
from mirdrake.identification.spec import REPAIRS
from mirdrake.identification.timing import hold_factor, resolution
from mirdrake.readers.units import unit_factor
from mirdrake.runs.logs import RunWriter
from mirdrake.single_track import SingleTrack, SingleTrackParameters

CAR = SingleTrackParameters(
    mass=1500.0, yaw_inertia=2400.0, front_length=1.2, rear_length=1.5, front_stiffness=90e3, rear_stiffness=110e3
)
STEP = 0.01
NOISE = {
    "vx": 0.01, "vy": 0.005, "yaw_rate": 0.002, "yaw": 0.0005, "road_wheel_angle": 0.0003,
    "longitudinal_acceleration": 0.05, "lateral_acceleration": 0.05,
}  # fmt: skip


@cache
def clean():
    """Return the time and channels of a drive of 40 s with steering and pedals that swing, without noise."""
    time = np.arange(4001) * STEP
    angle = 0.03 * (np.sin(2.0 * time) + 0.7 * np.sin(2.0 * pi * (0.3 + 0.02 * time) * time))
    force = 3500.0 * np.sin(0.8 * time) + 1500.0 * np.sin(2.3 * time)
    builder = DiagramBuilder()
    model = builder.AddSystem(SingleTrack(CAR))
    inputs = {model.steering: [angle], model.forces: [np.maximum(force, 0.0), np.maximum(-force, 0.0)]}
    for port, values in inputs.items():
        source = builder.AddSystem(TrajectorySource(PiecewisePolynomial.FirstOrderHold(time, np.array(values))))
        builder.Connect(source.get_output_port(), port)
    sinks = [LogVectorOutput(port, builder, STEP) for port in (model.state, model.motion)]
    simulator = Simulator(builder.Build())
    model.set_state(model.GetMyMutableContextFromRoot(simulator.get_mutable_context()), vx=15.0)
    ResetIntegratorFromFlags(simulator, "runge_kutta3", STEP)
    simulator.get_mutable_integrator().set_fixed_step_mode(True)
    simulator.AdvanceTo(time[-1])
    state, motion = (sink.FindLog(simulator.get_context()).data() for sink in sinks)
    return time, {
        "vx": state[6], "vy": state[7] + CAR.rear_length * state[11],  # of the centre of mass
        "yaw_rate": state[11], "yaw": np.unwrap(state[5]), "road_wheel_angle": angle,
        "longitudinal_acceleration": motion[1], "lateral_acceleration": motion[2],
    }  # fmt: skip


def recorded(seed=0, *, late=None, without=()):
    """Return a log of the drive with noise; channels of `late` are delayed by so many samples."""
    time, channels = clean()
    random = np.random.default_rng(seed)
    values = {}
    for name, exact in channels.items():
        shift = (late or {}).get(name, 0.0) * STEP
        noise = random.normal(0.0, NOISE[name], len(time))
        if name not in without:
            values[name] = CubicSpline(time, exact)(np.clip(time - shift, 0.0, None)) + noise
    return Log("drive", "train", time, values)


def changed(log, **channels):
    return replace(log, channels={**log.channels, **channels})


def checked(log, **options):
    return check_data(DataSet((log,), wheelbase=CAR.front_length + CAR.rear_length), **options)


def held(values, count):
    return np.repeat(values[::count], count)[: len(values)]


# --- the check ---------------------------------------------------------------------------------------------------


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_a_clean_drive_has_no_fault_and_no_warning_and_stays_as_it_is(seed):
    log = recorded(seed)
    report = checked(log)
    assert [finding.text for finding in report.findings if finding.severity != "info"] == []
    assert report.repairs == []
    assert report.data.digest == DataSet((log,)).digest
    for relation in report.of("kinematics"):
        if "road_wheel_angle" not in relation.channel:  # the tyres slip
            assert relation.value == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize(
    ("name", "samples"),
    [
        *product(("longitudinal_acceleration", "yaw"), (-2.6, 0.7, 4.0, 7.3)),
        # A roll that an accelerometer measures delays it by up to 6 ms: a sample is not enough there.
        *product(("lateral_acceleration",), (-2.6, 4.0, 7.3)),
    ],
)
def test_a_delay_is_found_within_a_tenth_of_a_sample_and_taken_out(name, samples):
    log = recorded(1, late={name: samples})
    report = checked(log)
    (finding,) = [item for item in report.of("delay") if name in item.channel.split(", ")]
    sign = -1.0 if name == "yaw" else 1.0  # there the yaw rate is what is measured
    assert finding.value / STEP == pytest.approx(sign * samples, abs=0.1)
    assert "shifted" in finding.repair
    again = check_data(report.data)
    assert max(abs(item.value) for item in again.of("delay")) < 0.15 * STEP


def test_a_displaced_accelerometer_is_not_taken_for_a_delay():
    log = recorded(1)
    vy = log.channels["vy"] - CAR.rear_length * log.channels["yaw_rate"]
    report = checked(changed(log, vy=vy))
    (finding,) = report.of("sensor_position")
    assert finding.value == pytest.approx(CAR.rear_length, rel=0.03)
    assert not report.repairs


def test_two_sources_of_one_quantity_are_compared():
    log = recorded(2)
    twin = recorded(3, late={"yaw_rate": 4.4})
    (finding,) = checked(changed(log, **{"yaw_rate@imu": twin.channels["yaw_rate"]})).of(
        "delay", "yaw_rate@imu, yaw_rate"
    )
    assert finding.value == pytest.approx(0.044, abs=0.001)
    assert finding.repair.startswith("shifted yaw_rate@imu by -4")


def test_a_second_clock_shows_as_a_delay_that_grows():
    time, channels = clean()
    late = 0.004 * time  # 0.4 % slow
    other = CubicSpline(time, channels["yaw_rate"])(time - late)
    (finding,) = checked(changed(recorded(4), **{"yaw_rate@imu": other})).of("clock_drift")
    assert finding.value == pytest.approx(0.004, rel=0.1)


@pytest.mark.parametrize("factor", [0.2, 0.8, 1.25, 2.5])
def test_the_true_step_is_found_within_one_per_cent(factor):
    log = recorded(5)
    report = checked(replace(log, time=log.time / factor))
    (finding,) = report.of("sample_time")
    assert finding.value == pytest.approx(STEP, rel=0.01)
    assert np.ptp(report.data.logs[0].time) == pytest.approx(40.0, rel=0.01)
    assert not report.of("units")


@pytest.mark.parametrize("count", [2, 3, 4, 5, 10])
def test_a_copy_at_a_higher_rate_is_found_exactly_and_thinned(count):
    log = recorded(6)
    time = np.arange(len(log.time) * count) * STEP / count
    report = checked(replace(log, time=time, channels={k: np.repeat(v, count) for k, v in log.channels.items()}))
    (finding,) = report.of("held_values")
    assert (finding.value, finding.channel) == (count, "")
    corrected = report.data.logs[0]
    assert np.array_equal(corrected.channels["vx"], log.channels["vx"])
    assert np.diff(corrected.time) == pytest.approx(STEP)


def test_a_copy_with_a_wrong_step_as_well_gives_the_true_step():
    log = recorded(6)
    time = np.arange(len(log.time) * 5) * STEP / 4  # said to be 400 Hz, are 500 Hz
    report = checked(replace(log, time=time, channels={k: np.repeat(v, 5) for k, v in log.channels.items()}))
    assert report.of("held_values")[0].value == 5
    assert report.of("sample_time")[0].value == pytest.approx(STEP, rel=0.01)


@pytest.mark.parametrize("count", [2, 3, 7])
@pytest.mark.parametrize("name", ["vx", "yaw_rate", "road_wheel_angle"])
def test_one_held_channel_is_found_exactly(name, count):
    log = recorded(7)
    report = checked(changed(log, **{name: held(log.channels[name], count)}))
    (finding,) = report.of("held_values")
    assert (finding.channel, finding.value) == (name, count)
    assert hold_factor(report.data.logs[0].channels[name]) == (1.0, 0.0)
    unrepaired = checked(changed(log, **{name: held(log.channels[name], count)}), repairs=())
    assert np.array_equal(unrepaired.data.logs[0].channels[name], held(log.channels[name], count))
    assert unrepaired.repairs == []


def test_interpolated_glitches_leave_the_resolution_of_a_coarse_channel():
    """A repair leaves values between the levels; the others still repeat by chance, and the channel is not held."""
    random, quantum = np.random.default_rng(0), 0.01
    angle = 0.5 + 0.2 * np.sin(0.1 * STEP * np.arange(1800)) + random.normal(0.0, 0.0025, 1800)
    coarse = np.round(angle / quantum) * quantum
    coarse[random.choice(1800, 8, replace=False)] += random.uniform(0.2, 0.8, 8) * quantum
    assert resolution(coarse) == pytest.approx(quantum)


def test_coarse_quantisation_is_not_taken_for_held_samples():
    log = recorded(8)
    coarse = np.round(log.channels["vx"] / 0.05) * 0.05
    report = checked(changed(log, vx=coarse))
    assert not report.of("held_values")
    assert not report.of("glitches")
    assert report.of("quantisation", "vx")[0].value == pytest.approx(0.05)


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    name=st.sampled_from(sorted(NOISE)),
    count=st.integers(1, 30),
    length=st.integers(1, 3),
    size=st.floats(0.6, 1000.0),
)
def test_all_glitches_are_found_and_no_other_sample(seed, name, count, length, size):
    values = recorded(seed).channels[name].copy()
    random = np.random.default_rng(seed)
    starts = 20 + np.sort(random.choice(190, count, replace=False)) * 20
    rows = np.unique((starts[:, None] + np.arange(length)).ravel())
    values[rows] += size * np.ptp(values) * random.choice([-1.0, 1.0], count).repeat(length)
    assert np.array_equal(np.flatnonzero(find_glitches(values, np.inf)), rows)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), rate=st.floats(0.2, 30.0), height=st.floats(-50.0, 50.0), noise=st.floats(0.0, 1.0))
def test_steps_ramps_and_rests_are_not_glitches(seed, rate, height, noise):
    time = np.arange(1500) * STEP
    step = height * (1.0 - np.exp(-rate * np.clip(time - 4.0, 0.0, None))) * (time < 9.0)
    values = step + np.clip(time - 10.0, 0.0, 3.0) + np.random.default_rng(seed).normal(0.0, noise, len(time))
    assert not find_glitches(values, np.inf).any()


def test_the_peak_of_a_motion_of_a_few_samples_is_not_a_glitch():
    """Pitch rate of a simulated robot that starts to move, 20 ms from sample to sample, without noise."""
    peak = [
        0.004869, 0.02561, 0.03867, 0.02914, 0.007389, -0.008284, -0.01139, -0.006416, -0.0006037, 0.00199, 0.001435,
        -0.0002353, -0.001327, -0.001387, -0.0008581, -0.0003367, -0.0001148, -0.0001486, -0.0002579, -0.0003097,
    ]  # fmt: skip
    rest = 0.00487 + 1e-6 * np.sin(np.arange(47.0))
    values = np.concatenate([rest, peak, 0.002 * np.sin(0.05 * np.arange(1000.0))])
    assert not find_glitches(values, np.inf).any()
    values[[20, 400, 401]] += 0.034
    assert np.flatnonzero(find_glitches(values, np.inf)).tolist() == [20, 400, 401]


@settings(max_examples=40, deadline=None)
@given(rows=st.sets(st.integers(0, 1999), min_size=1, max_size=4), hold=st.sampled_from([1, 2]))
@example(rows={1999}, hold=1)
@example(rows={60, 400}, hold=2)
@example(rows={1300, 1900}, hold=2)
def test_glitches_are_found_where_a_hand_wheel_rests_as_where_it_turns(rows, hold):
    time = hold * STEP * (np.arange(2000) // hold)
    values = np.round(np.radians(260.0) * np.clip(np.minimum(time - 7.0, 14.0 - time), 0.0, 3.0) / 3.0, 3)
    values[sorted(rows)] += 14.0
    assert set(np.flatnonzero(find_glitches(values, np.inf))) == rows


def test_glitches_are_replaced_and_counted():
    log = recorded(9)
    values = log.channels["vx"].copy()
    values[[500, 1500, 1501]] = [1e4, -60.0, -60.0]
    report = checked(changed(log, vx=values))
    (finding,) = report.of("glitches")
    assert (finding.channel, finding.value) == ("vx", 3)
    assert "at 5, 15, 15.01 s" in finding.text
    assert report.data.logs[0].channels["vx"] == pytest.approx(log.channels["vx"], abs=0.3)


@pytest.mark.parametrize(
    ("name", "factor", "what"),
    [
        ("yaw_rate", degrees(1.0), "deg as rad"),
        ("vx", 3.6, "km/h as m/s"),
        ("lateral_acceleration", 1 / 9.80665, "g as m/s²"),
        ("longitudinal_acceleration", 1 / 9.80665, "g as m/s²"),
        ("lateral_acceleration", -1.0, "wrong sign"),
        ("yaw_rate", -1.0, "wrong sign"),
    ],
)
def test_a_wrong_unit_or_sign_is_named(name, factor, what):
    log = recorded(10)
    report = checked(changed(log, **{name: factor * log.channels[name]}))
    assert f"{what} of {name}" in report.of("units")[0].text
    assert not report.of("sample_time")


def test_steering_to_the_wrong_side_and_in_degrees_is_named():
    log = recorded(11)
    angle = log.channels["road_wheel_angle"]
    assert "wrong sign" in checked(changed(log, road_wheel_angle=-angle)).of("units", "road_wheel_angle")[0].text
    (finding,) = checked(changed(log, road_wheel_angle=degrees(1.0) * angle)).of(
        "kinematics", "yaw_rate, road_wheel_angle"
    )
    assert "deg as rad?" in finding.text


def test_gravity_in_an_accelerometer_is_found():
    log = recorded(12)
    roll = 0.03 * np.sin(0.21 * log.time)  # a banked road, not the roll of the car
    leaning = log.channels["lateral_acceleration"] + 9.80665 * np.sin(roll)
    (finding,) = checked(changed(log, lateral_acceleration=leaning, roll=roll)).of("gravity")
    assert finding.value == pytest.approx(9.8, rel=0.1)
    # At the end: rows at the beginning in which nothing changes before a jump are taken for dummies.
    still = {name: np.concatenate((values, np.zeros(300))) for name, values in log.channels.items()}
    still["longitudinal_acceleration"][-300:] = 0.5
    (finding,) = checked(Log("b", "train", np.arange(4301.0) * STEP, still)).of("gravity")
    assert finding.value == pytest.approx(0.5)
    assert "2.9 deg" in finding.text


def test_stamps_gaps_missing_values_and_clipping_are_counted():
    log = recorded(13)
    keep = np.ones(len(log.time), dtype=bool)
    keep[1000:1040] = keep[2000:2003] = False
    time = log.time.copy()
    time[100] = time[99]
    time[200] = time[190]
    ay = np.clip(log.channels["lateral_acceleration"], -2.5, 2.5)
    ay[3000:3007] = np.nan
    report = checked(
        Log(
            "odd",
            "train",
            time[keep],
            {**{k: v[keep] for k, v in log.channels.items()}, "lateral_acceleration": ay[keep]},
        )
    )
    assert [finding.value for finding in report.of("timestamps")][:2] == [1.0, 1.0]
    assert "45 samples missing" in report.of("gaps")[0].text  # the two rows left out are among them
    assert report.of("missing", "lateral_acceleration")[0].value == 7
    assert {finding.value for finding in report.of("saturation")} == {-2.5, 2.5}
    assert len(report.data.logs[0].time) == keep.sum() - 2
    assert np.all(np.diff(report.data.logs[0].time) > 0.0)


def test_excitation_reports_what_a_log_cannot_determine():
    offers = {item.parameters: item for item in checked(recorded(14)).excitation}
    assert offers["cornering stiffness, yaw inertia"].verdict == "good"
    log = recorded(14)
    steady = changed(log, vx=np.full(len(log.time), 15.0) + 0.01 * np.sin(log.time))
    offer = {item.parameters: item for item in checked(steady, repairs=()).excitation}[
        "steering ratio, understeer gradient"
    ]
    assert offer.verdict == "weak"
    assert "are not separable at one speed" in offer.text


def test_the_report_is_a_table_and_data():
    log = recorded(15, late={"lateral_acceleration": 4.0})
    report = checked(log)
    assert "delay" in report.table()
    assert re.search(r"-> shifted lateral_acceleration by -(39\.\d|40|40\.\d) ms", report.table())
    assert len(report.to_pandas()) == len(report.findings)
    with pytest.raises(ConfigError, match="unknown repair 'delay'; did you mean 'delays'"):
        checked(log, repairs=["delay"])
    assert set(REPAIRS) == {"timestamps", "gaps", "held_values", "glitches", "sample_time", "delays"}


@pytest.mark.parametrize("kind", ["constant", "missing", "one channel", "short"])
def test_a_poor_log_is_checked_without_a_crash(kind):
    log = recorded(16)
    if kind == "constant":
        log = replace(log, channels={name: np.full(len(log.time), 1.0) for name in log.channels})
    elif kind == "missing":
        gone = np.random.default_rng(0).random(len(log.time)) < 0.7
        log = replace(log, channels={name: np.where(gone, np.nan, v) for name, v in log.channels.items()})
    elif kind == "one channel":
        log = replace(log, channels={"vx": log.channels["vx"]})
    else:
        log = replace(log, time=log.time[:20], channels={name: v[:20] for name, v in log.channels.items()})
    assert checked(log).table()


def test_no_delay_is_reported_for_a_constant_channel():
    assert estimate_delay(np.zeros(1000), np.ones(1000), STEP) is None


# --- files -------------------------------------------------------------------------------------------------------

GERMAN = "Messung;17.3.\n# Kommentar\nZeit [ms];v (km/h);Gier\nms;km/h;deg/s\n" + "".join(
    f"{10 * i};{str(36 + 0.5 * i).replace('.', ',')};{str(-0.25 * i).replace('.', ',')}\n" for i in range(30)
)
HEAD = "mirdrake: data/1\n"


def dataset(folder, text, **files):
    for name, content in files.items():
        (folder / f"{name}.csv").write_text(content, encoding="utf-8")
    (folder / "drives.yaml").write_text(HEAD + text, encoding="utf-8")
    return load_data(folder / "drives.yaml")


def table(columns="time,v", rows=30, row=lambda i: f"{0.1 * i:.3f},{i}"):
    return "\n".join([columns, *map(row, range(rows))]) + "\n"


MAPPED = "channels: {vx: {column: v, unit: m/s}}\nlogs: [{file: a.csv}]\n"


def test_a_file_with_decimal_commas_comments_and_units_in_the_header_is_read(tmp_path):
    data = dataset(
        tmp_path,
        "time: {column: Zeit}\nchannels: {vx: v, yaw_rate: {column: Gier, sign: -1}}\nlogs: [{file: a.csv}]\n",
        a=GERMAN,
    )
    (log,) = data.logs
    assert log.time[:3] == pytest.approx([0.0, 0.01, 0.02])
    assert log.channels["vx"][2] == pytest.approx(37.0 / 3.6)
    assert log.channels["yaw_rate"][4] == pytest.approx(np.radians(1.0))
    assert any("decimal commas" in note for note in log.notes)
    assert log.to_pandas().attrs["units"] == {"vx": "m/s", "yaw_rate": "rad/s"}


@pytest.mark.parametrize("mark", [",", ";", "\t", "|", " "])
def test_every_usual_delimiter_is_found(tmp_path, mark):
    text = table().replace(",", mark)
    (log,) = dataset(tmp_path, MAPPED, a=text).logs
    assert log.channels["vx"][7] == 7.0


def test_logs_are_one_data_set_with_parts_of_their_own(tmp_path):
    data = dataset(
        tmp_path,
        "channels: {vx: {column: v, unit: km/h}}\n"
        "logs:\n- {file: a.csv, start: 0.3 s}\n- {file: b.csv, use: validation, time: {step: 20 ms},"
        " channels: {vx: {column: w, unit: m/s, scale: 2, offset: 1}}}\n",
        a=table(),
        b=table("w,z"),
    )
    first, second = data.train[0], data.validation[0]
    assert (len(first.time), first.channels["vx"][0]) == (27, pytest.approx(3 / 3.6))
    assert second.time[1] == pytest.approx(0.02)
    assert second.channels["vx"][10] == pytest.approx(3.0)
    assert len(data.digest) == 64


def test_mat_parquet_and_run_folders_are_read(tmp_path):
    time, speed = np.arange(30.0) * 0.1, np.arange(30.0)
    savemat(tmp_path / "m.mat", {"log": {"t": time[:, None], "v": speed[:, None]}, "note": "x"})
    pq.write_table(pa.table({"time": time, "v": speed}), tmp_path / "p.parquet")
    writer = RunWriter(tmp_path / "run", {"a": 1})
    writer.write_signals(time, {"ego.v": speed}, {"ego.v": "m/s"})
    writer.finish(dict)
    data = dataset(
        tmp_path,
        "channels: {vx: {column: v, unit: m/s}}\nlogs:\n- {file: p.parquet}\n- {file: run, channels: {vx: ego.v}}\n"
        "- {file: m.mat, time: {column: log.t}, channels: {vx: {column: log.v, unit: km/h}}}\n",
    )
    assert [log.channels["vx"][9] for log in data.logs] == pytest.approx([9.0, 9.0, 2.5])
    assert [log.time[9] for log in data.logs] == pytest.approx([0.9] * 3)


FAULTS = [
    (
        "channels: {vx: {column: vv, unit: m/s}}\nlogs: [{file: a.csv}]\n",
        r"2: channels.vx: .*a.csv has no column 'vv'; did you mean 'v'\?",
    ),
    (
        "channels: {vxx: {column: v, unit: m/s}}\nlogs: [{file: a.csv}]\n",
        r"2: channels: unknown channel 'vxx'; did you mean 'vx'\?",
    ),
    (
        "channels: {vx: {column: v, unit: stones}}\nlogs: [{file: a.csv}]\n",
        r"2: channels: vx: unit 'stones' does not fit; allowed: m/s, km/h",
    ),
    ("channels: {vx: {column: v, unit: rad}}\nlogs: [{file: a.csv}]\n", "vx: unit 'rad' does not fit"),
    ("channels: {vx: v}\nlogs: [{file: a.csv}]\n", "2: channels.vx: needs a unit, for example 'unit: m/s'"),
    (
        "channels: {vx: {column: v, unit: m/s}, vy: {column: v, unit: m/s}}\nlogs: [{file: a.csv}]\n",
        "column 'v' is given twice, as vx and as vy",
    ),
    (
        "channels: {vx: {column: v, unit: m/s}, vx: {column: w, unit: m/s}}\nlogs: [{file: a.csv}]\n",
        "drives.yaml:2: .*repeated",
    ),
    (MAPPED.replace("a.csv", "b.csv"), "3: logs.0.file: .*no such file"),
    (MAPPED + "time: {column: stamp}\n", "4: time: .*no column 'stamp'"),
    (MAPPED + "time: {}\n", "time: needs either a column or a step"),
    (MAPPED + "time: {column: time, unit: m}\n", "4: time.unit: unit 'm' does not fit"),
    ("channels: {}\nlogs: [{file: a.csv}]\n", "channels: no channel is mapped"),
    ("channels: {vx: {column: v, unit: m/s}}\nlogs: []\n", "logs: has 0 items; at least 1"),
    ("channels: {vx: {column: v, unit: m/s}}\nlogs: [{file: a.csv}, {file: a.csv}]\n", "a second log 'a.csv'"),
    (
        "channels: {vx: {column: v, unit: m/s}}\nlogs: [{file: a.csv, start: 2, end: 1}]\n",
        "ends at 1 s, before it starts",
    ),
    ("channels: {vx: {column: v, unit: m/s}}\nlogs: [{file: a.csv, start: 2.5}]\n", "has 5 rows to use; at least 20"),
]


@pytest.mark.parametrize(("text", "message"), FAULTS)
def test_a_fault_of_the_data_file_names_its_line(tmp_path, text, message):
    with pytest.raises(ConfigError, match=message) as caught:
        dataset(tmp_path, text, a=table())
    assert "\n" not in str(caught.value)


def test_a_clock_of_steps_is_summed_up(tmp_path):
    steps = np.random.default_rng(0).uniform(9e6, 11e6, 50).round()
    mapped = "time: {column: time, unit: ns}\n" + MAPPED
    log = dataset(tmp_path, mapped, a=table(rows=50, row=lambda i: f"{steps[i]},{i}")).logs[0]
    assert np.diff(log.time) == pytest.approx(1e-9 * steps[1:])
    assert log.time[0] == 0.0
    assert "steps from row to row" in log.notes[0]


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("time,{}\nv,{}\n", MAPPED),
        ("{}\n{}\n", MAPPED + "csv: {columns: [time, v]}\n"),
        ("{}\n{}\n", MAPPED.replace("column: v", "column: '2'") + "time: {column: '1'}\n"),
    ],
)
def test_a_file_with_a_channel_in_each_line_is_transposed(tmp_path, text, names):
    lines = [",".join(f"{value:.6g}" for value in values) for values in (0.1 * np.arange(250), np.sin(np.arange(250)))]
    log = dataset(tmp_path, names, a=text.format(*lines)).logs[0]
    assert log.time == pytest.approx(0.1 * np.arange(250))
    assert log.channels["vx"] == pytest.approx(np.sin(np.arange(250)), abs=1e-5)
    assert "a channel in each of its 2 lines" in log.notes[0]


@pytest.mark.parametrize(
    ("head", "mark", "names"),
    [
        ("# time(s),v(km/h)", ",", ("time", "v")),
        ("# time(s),v(km/h)", ",", ("time(s)", "v(km/h)")),
        ("%time,v (km/h)", ",", ("%time", "v (km/h)")),
        ("# made by hand\n# time v(km/h)", " ", ("time", "v")),
        ("# time, v(km/h)\n# 1, 1", " ", ("time", "v(km/h)")),
        ("time(s);v(km/h)", ";", ("time(s)", "v(km/h)")),
    ],
)
def test_a_header_may_be_a_comment_and_a_column_is_asked_for_with_its_unit_or_without(tmp_path, head, mark, names):
    rows = [f"{0.1 * i:.1f}{mark}{3.6 * i:.1f}" for i in range(30)]
    mapped = f"time: {{column: '{names[0]}'}}\nchannels: {{vx: '{names[1]}'}}\nlogs: [{{file: a.csv}}]\n"
    log = dataset(tmp_path, mapped, a="\n".join([head, *rows])).logs[0]
    assert log.time == pytest.approx(0.1 * np.arange(30))
    assert log.channels["vx"] == pytest.approx(np.arange(30.0))


def hhmmss(seconds):
    return f"{int(seconds // 3600) % 24:02d}{int(seconds // 60) % 60:02d}{seconds % 60:05.2f}"


VBO = """File created on 11/04/2014 @ 23:59:58

[header]
satellites
time
velocity kmh
lat accel g
Lat. Vel.

[channel units]
km/h

[comments]
Log Rate (Hz) : 10.00

[column names]
sats time velocity latacc lat._vel.

[data]
{rows}
"""


def test_a_vbo_file_is_read_over_midnight_by_short_names_and_titles(tmp_path):
    start = 24 * 3600 - 2.05
    rows = "\n".join(f"137 {hhmmss(start + 0.1 * i)} {3.6 * i:07.3f} +0000.50 {3.6e0 * 0.1 * i:E}" for i in range(40))
    mapped = (
        "channels: {vx: velocity, lateral_acceleration: lat accel g, vy: {column: lat._vel., unit: km/h, sign: -1}}\n"
        "logs: [{file: a.vbo}]\n"
    )
    (tmp_path / "a.vbo").write_text(VBO.format(rows=rows), newline="\r\n")
    log = dataset(tmp_path, mapped).logs[0]
    assert log.time == pytest.approx(start + 0.1 * np.arange(40))
    assert log.channels["vx"] == pytest.approx(np.arange(40.0))
    assert log.channels["vy"] == pytest.approx(-0.1 * np.arange(40))
    assert log.channels["lateral_acceleration"] == pytest.approx(np.full(40, 0.5 * 9.80665))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            VBO.format(rows="137 120000.00 1 2 3\n137 120000.10 1 2"),
            "a.vbo:21: has 4 cells, but there are 5 column names",
        ),
        (VBO.format(rows=""), "a.vbo: has no rows"),
        (VBO.replace("[column names]", ""), r"a.vbo: has no section \[column names\]"),
        ("time,v\n0,1\n", r"a.vbo: has no section \[column names\]"),
        (VBO.format(rows="137 noon 1 2 3\n" * 30), "rows to use; at least 20"),
    ],
)
def test_a_fault_of_a_vbo_file_names_its_line(tmp_path, text, message):
    (tmp_path / "a.vbo").write_text(text)
    with pytest.raises(ConfigError, match=message):
        dataset(tmp_path, "channels: {vx: velocity}\nlogs: [{file: a.vbo}]\n")


def test_times_of_day_continue_over_the_minute(tmp_path):
    start = 13 * 3600 + 59 * 60 + 57.0
    log = dataset(tmp_path, MAPPED, a=table(rows=60, row=lambda i: f"{hhmmss(start + 0.1 * i)},{i}")).logs[0]
    assert log.time == pytest.approx(start + 0.1 * np.arange(60))
    assert "times of day" in log.notes[0]
    # A drive with a pause is none.
    paused = dataset(tmp_path, MAPPED, a=table(rows=60, row=lambda i: f"{0.1 * i + 30 * (i > 30):.1f},{i}")).logs[0]
    assert not paused.notes


BAD_LOGS = [
    ("", "a.csv: is empty"),
    ("# nothing\n\n", "a.csv: is empty"),
    ("time,v\n", "has a header and no rows"),
    (table(row=lambda i: f"{0.1 * i},{'x7' if i == 4 else i}"), r"a.csv:6: column 'v': 'x7' is not a number"),
    (
        "# one\n" + table(row=lambda i: f"{0.1 * i},{i}{',1' if i == 4 else ''}"),
        "a.csv:7: has 3 cells, but .* 2 names in the header in line 2",
    ),
    (table(rows=90, row=lambda i: f"{0.1 * i},{i}{',1' if i == 70 else ''}"), "a.csv:72: does not have the 2 cells"),
    (table(row=lambda i: f"{0.1 * (i % 15)},{i}"), "a.csv:17: time goes back from 1.4 s to 0 s, and 14 of 30 rows"),
    (table(row=lambda i: f"1.5,{i}"), "time is constant at 1.5 s$"),
    (
        table(row=lambda i: f"0.01,{i}"),
        "time is constant at 0.01 s; if that is the step of its rows, write time: {step: 0.01",
    ),
    (table(row=lambda i: f"{0.1 * i},nan"), "2: channels.vx: column 'v' of .* has no numbers"),
    (table("time,v [km/h]"), "unit 'm/s', but .* has 'km/h'"),
]


@pytest.mark.parametrize(("text", "message"), BAD_LOGS)
def test_a_fault_of_a_log_names_its_line(tmp_path, text, message):
    with pytest.raises(ConfigError, match=message):
        dataset(tmp_path, MAPPED, a=text)


def test_unreadable_formats_raise_an_error(tmp_path):
    (tmp_path / "a.mat").write_bytes(b"MATLAB 7.3 MAT-file, Platform")
    (tmp_path / "b.mat").write_bytes(b"nothing")
    (tmp_path / "c.parquet").write_bytes(b"nothing")
    (tmp_path / "d.xyz").write_bytes(b"")
    (tmp_path / "folder").mkdir()
    for name, message in {
        "a.mat": "7.3, but is damaged", "b.mat": "not a MAT file", "c.parquet": "not a Parquet",
        "d.xyz": "unknown format '.xyz'",
        "folder": "not a run folder",
    }.items():  # fmt: skip
        with pytest.raises(ConfigError, match=message):
            dataset(tmp_path, MAPPED.replace("a.csv", name))


@settings(max_examples=60, deadline=None)
@given(text=st.text(max_size=300))
def test_no_content_of_a_log_causes_a_crash(text, tmp_path_factory):
    with suppress(ConfigError):
        data = dataset(tmp_path_factory.mktemp("any"), MAPPED, a="time,v\n" + text.encode("utf-8", "ignore").decode())
        assert len(data.logs[0].time) >= 20


def test_every_unit_of_a_channel_is_one_of_the_project():
    assert {name: unit_factor(channel.unit, channel.unit) for name, channel in CHANNELS.items()} == dict.fromkeys(
        CHANNELS, 1.0
    )
    assert unit_factor("%", "1") == 0.01
    assert unit_factor("knots", "m/s") == pytest.approx(0.514444, rel=1e-5)
    assert unit_factor("mG", "m/s^2") == unit_factor("mg", "m/s^2") == pytest.approx(1e-3 * unit_factor("g", "m/s^2"))
    assert unit_factor("1/min", "rad/s") == pytest.approx(2 * pi / 60)


@pytest.mark.parametrize(("factor", "fault"), [(1.0, False), (0.015, True), (3.6, True)])
def test_a_speed_must_be_that_of_vx(factor, fault):
    """A correction of a controller has the unit of a speed, but neither its size nor its course."""
    log = recorded()
    noise = np.random.default_rng(1).normal(1.0, 0.02, len(log.time))
    findings = check_relations(changed(log, speed=factor * noise * log.channels["vx"]))
    found = [finding for finding in findings if finding.check == "units" and "speed" in finding.channels]
    assert bool(found) == fault
    if fault:
        assert found[0].severity == "fault"
        assert found[0].value == pytest.approx(factor, rel=0.02)


def test_the_headline_names_what_the_training_logs_do_not_excite():
    """The same ratings in a validation log do not help the fit."""
    words = {"speed": 2.0, "spread": 0.0, "varied": False}
    ratings: list[tuple[str, str, Literal["good", "weak", "none"]]] = [
        ("a", "steering ratio", "good"),
        ("a", "friction", "none"),
        ("b", "friction", "good"),
    ]
    excitation = tuple(
        Excitation(log, group, verdict, {}, statement("turning", **words)) for log, group, verdict in ratings
    )
    time = np.arange(3.0)
    logs = tuple(Log(name, use, time, {"vx": time}) for name, use in (("a", "train"), ("b", "validation")))
    report = DataReport((), excitation, DataSet(logs))
    assert report.headline == "no fault is left; excitation too weak for friction"
    assert (
        replace(report, excitation=excitation[:1]).headline == "no fault is left; enough excitation for steering ratio"
    )
    fault = Finding("a", "units", "vx", "fault", 1.0, "1", statement("impossible_turn", value=40.0))
    assert replace(report, findings=(fault,)).headline == "1 fault without repair"
