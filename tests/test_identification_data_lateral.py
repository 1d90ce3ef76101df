"""A delayed vy, a delayed lateral acceleration, a displaced sensor and two clocks are distinguished from each other."""

import gzip
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from mirdrake.cli import main
from mirdrake.core.errors import ConfigError
from mirdrake.identification import DataSet, Log, check_data
from mirdrake.identification.identify import reject_poor_fit
from mirdrake.identification.lateral_delays import estimate_lateral_delays
from mirdrake.identification.plausibility import check_lateral_velocity
from mirdrake.identification.relations import make_grid
from tests.test_identification_data import STEP, checked, recorded

NOISE = {"vx": 0.02, "vy": 0.02, "yaw_rate": 0.004, "lateral_acceleration": 0.1}


def drive(seed, *, late=None, ahead=0.0, noise=1.0):
    """Return rigid-body motion at 8 to 22 m/s with noise, 80 s; channels of `late` are delayed [s].

    Args:
        seed: of the noise.
        late: by channel.
        ahead: of the place of vy, the accelerometer [m].
        noise: times that of NOISE.
    """
    time = np.arange(0.0, 80.0, STEP)
    random = np.random.default_rng(seed)

    def series(name):
        t = time - (late or {}).get(name, 0.0)
        vx, slope = 15.0 + 7.0 * np.sin(0.23 * t), 7.0 * 0.23 * np.cos(0.23 * t)
        r = 0.12 * np.sin(0.9 * t) + 0.08 * np.sin(2.9 * t + 1.0)
        turn = 0.108 * np.cos(0.9 * t) + 0.232 * np.cos(2.9 * t + 1.0)
        vy, rise = r * (1.4 - 0.006 * vx**2), turn * (1.4 - 0.006 * vx**2) - 0.012 * r * vx * slope
        exact = {"vx": vx, "vy": vy, "yaw_rate": r, "lateral_acceleration": vx * r + rise + ahead * turn}
        return exact[name] + random.normal(0.0, noise * NOISE[name], len(t))

    return Log("drive", "train", time, {name: series(name) for name in NOISE})


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("ahead", [0.0, -1.9, 1.4])
def test_a_channel_without_delay_is_unchanged_wherever_the_accelerometer_is(seed, ahead):
    delays = estimate_lateral_delays([make_grid(drive(seed, ahead=ahead))])
    assert delays is not None
    assert (delays.acceleration, delays.velocity) == (0.0, 0.0)
    assert delays.arm == pytest.approx(ahead, abs=0.1)
    report = checked(drive(seed, ahead=ahead))
    assert not [finding for finding in report.of("delay") if finding.repair]
    # The interval that the logs leave for a delay is stated, and contains the truth.
    limits = report.of("delay_limit")
    assert [finding.channels[0] for finding in limits] == ["lateral_acceleration", "vy"]
    for finding in limits:
        assert float(finding.what.figures["low"]) - 1e-3 < 0.0 < float(finding.what.figures["high"]) + 1e-3
        assert finding.value < 0.03


@pytest.mark.parametrize("ahead", [0.0, -1.9, 1.4])
@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_a_vy_that_changes_too_slowly_for_its_accelerometer_is_reported(factor, ahead):
    log = drive(6, ahead=ahead, noise=0.3)
    finding = checked(replace(log, time=factor * log.time)).of("kinematics", "vy, lateral_acceleration")
    if factor == 1.0:
        assert not finding
    else:
        assert finding[0].value == pytest.approx(factor, rel=0.1)
        assert f"instead of {factor * STEP:.3g} s" in finding[0].text


def rolling(*, late=0.0, scale=1.0, known=("roll_rate", "yaw")):
    """Return the motion of a robot at 3 m/s whose steering excites its roll at 2.7 Hz, without noise.

    Every signal is a sum of sines with its frequency response: roll by φ'' + 2 ζ ω φ' + ω² φ = ω² k ay, and the
    accelerometer is 0.27 m ahead of the place of vy and 0.18 m above it.

    Args:
        late: delay of the accelerometer [s].
        scale: error of vy as a factor.
        known: further channels of the log.
    """
    time, v, random = np.arange(0.0, 60.0, STEP), 3.0, np.random.default_rng(4)
    w = 2.0 * np.pi * np.linspace(0.2, 3.5, 23)
    phasor = 0.25 * np.exp(2j * np.pi * random.random(len(w))) / (1.0 + 0.1j * w)
    s, natural = 1j * w, 2.0 * np.pi * 2.7
    vy = phasor * (0.3 - 0.03 * s) / (1.0 + 0.05 * s)
    ay = v * phasor + s * vy
    roll = 0.008 * ay * natural**2 / (s**2 + 0.6 * natural * s + natural**2)
    measured = (ay + 0.27 * s * phasor - 0.18 * s**2 * roll) * np.exp(-late * s)
    parts = {"vy": scale * vy, "yaw_rate": phasor, "lateral_acceleration": measured}
    parts |= {name: {"roll_rate": s * roll, "yaw": phasor / s}[name] for name in known}
    waves = np.exp(1j * np.outer(time, w))
    channels = {name: np.ascontiguousarray((waves @ values).real) for name, values in parts.items()}
    return Log("drive", "train", time, {"vx": np.full(len(time), v), **channels})


@pytest.mark.parametrize("known", [("roll_rate", "yaw"), ("roll_rate",)])
def test_roll_at_its_natural_frequency_is_neither_a_scale_of_vy_nor_a_delay(known):
    report = checked(rolling(known=known))
    assert not report.of("kinematics", "vy, lateral_acceleration")
    assert not [finding for finding in report.of("delay") if finding.repair]
    (late,) = [finding for finding in checked(rolling(late=0.01, known=known)).of("delay") if finding.repair]
    assert late.repair.startswith("shifted lateral_acceleration by -")
    assert late.value == pytest.approx(0.01, abs=0.002)


def test_a_true_step_is_not_proposed_if_another_relation_excludes_it():
    (finding,) = check_lateral_velocity(rolling(scale=0.5))
    assert finding.text.endswith("2 times the change of vy: vy is too small by that factor; write a scale")
    (either,) = check_lateral_velocity(rolling(scale=0.5, known=("roll_rate",)))
    assert "vy is too small by that factor, or the true step is 0.00498 s instead of 0.01 s" in either.text


@pytest.mark.parametrize("ahead", [0.0, 1.4])
def test_velocities_of_one_source_have_the_same_delay(ahead):
    """An inertial unit with both velocities at the rear axle, 100 ms late: the lever arm alone looks like 100 ms."""
    report = checked(drive(2, late={"vx": 0.1, "vy": 0.1}, ahead=ahead))
    (fault,) = report.of("delay", "vy, lateral_acceleration")
    assert fault.value == pytest.approx(0.1, abs=0.01)
    assert "vx lags by as much" in fault.text
    assert fault.repair.startswith("shifted vy by -")
    assert "vx by -" in fault.repair
    assert "yaw_rate" not in fault.repair
    if ahead:
        (lever_arm,) = report.of("sensor_position", "lateral_acceleration")
        assert lever_arm.value == pytest.approx(ahead, abs=0.1)
    assert not [finding for finding in checked(report.data.logs[0]).of("delay") if finding.repair]


@pytest.mark.parametrize("late", [0.0, 0.06])
@pytest.mark.parametrize("seed", range(3))
def test_noise_with_a_memory_is_not_taken_for_a_delay(seed, late):
    """Noise with a memory is alike in neighbouring rows, so that only what the steering causes shows a delay."""
    log, random = drive(0, late={"vy": late}, noise=0.0), np.random.default_rng(seed)
    channels = {
        name: values + 0.5 * NOISE[name] * lfilter([0.6], [1.0, -0.8], random.normal(size=len(values)))
        for name, values in log.channels.items()
    }
    angle = 0.2 * np.interp(log.time + 0.1, log.time, log.channels["yaw_rate"])
    channels["road_wheel_angle"] = angle + random.normal(0.0, 0.0005, len(angle))
    delays = estimate_lateral_delays([make_grid(replace(log, channels=channels))])
    assert delays is not None
    assert delays.acceleration == 0.0
    assert delays.velocity == pytest.approx(late, abs=0.01)
    if not late:
        for limit in delays.limits:
            assert limit is not None
            assert limit[0] < 0.0 < limit[1]


@pytest.mark.parametrize("name", ["vy", "lateral_acceleration"])
def test_a_delayed_channel_is_found_beside_a_displaced_accelerometer(name):
    delays = estimate_lateral_delays([make_grid(drive(3, late={name: 0.06}, ahead=1.0))])
    assert delays is not None
    assert delays.velocity == pytest.approx(0.06 if name == "vy" else 0.0, abs=0.01)
    assert delays.acceleration == pytest.approx(0.0 if name == "vy" else 0.06, abs=0.015)
    assert delays.arm == pytest.approx(1.0, abs=0.25)


def test_too_short_a_drive_gives_no_estimate():
    log = drive(4)
    short = replace(log, time=log.time[:300], channels={name: values[:300] for name, values in log.channels.items()})
    assert estimate_lateral_delays([make_grid(short)]) is None


def test_a_clock_that_goes_slower_is_stretched_to_that_of_the_steering():
    """An inertial unit, 0.2 % slow, beside a vehicle bus: 80 ms after 40 s, and none after the correction."""
    log = recorded(5)
    slow = log.time * 1.002
    channels = dict(log.channels)
    for name in ("yaw_rate", "lateral_acceleration"):
        channels[name] = np.interp(slow, log.time, log.channels[name])
    report = checked(replace(log, channels=channels))
    (fault,) = report.of("clock_drift")
    assert fault.value == pytest.approx(-2e-3, rel=0.1)
    assert re.search(r"yaw_rate stretched by \+0\.[12]\d* %", fault.repair)
    assert "lateral_acceleration stretched" in fault.repair
    assert "yaw stretched" not in fault.repair
    corrected = report.data.logs[0].channels["yaw_rate"]
    inner = slice(200, 3700)
    assert np.std((corrected - log.channels["yaw_rate"])[inner]) < 1.5 * 0.002 * np.sqrt(2.0)
    assert not checked(report.data.logs[0]).of("clock_drift")
    unrepaired = check_data(DataSet((replace(log, channels=channels),)), repairs=())
    assert [finding.repair for finding in unrepaired.of("clock_drift")] == [""]
    assert unrepaired.unrepaired_faults


HEADER = "t,vx,vy,wz,ay,steer\n"
MAPPING = """\
mirdrake: data/1
wheelbase: 2.7 m
time: {column: t, unit: s}
channels:
  vx: {column: vx, unit: m/s}
  yaw_rate: {column: wz, unit: rad/s}
  road_wheel_angle: {column: steer, unit: rad}
logs: [{file: log.csv}]
"""


def rows(steer=1.0, speed=1.0, lock=0.04):
    """Return the log of a car in curves without slip, as text."""
    t = np.arange(0.0, 30.0, 0.02)
    v, angle = 6.0 + 2.0 * np.sin(0.3 * t), lock * np.sin(t)
    table = np.column_stack((t, speed * v, 0.1 * angle, v * angle / 2.7, v * v * angle / 2.7, steer * angle))
    return "\n".join(",".join(f"{value:.6g}" for value in row) for row in table) + "\n"


def check(folder, content, capsys, mapping=MAPPING):
    """Return the exit code, output and error of the check of a file."""
    (folder / "log.csv").write_bytes(content if isinstance(content, bytes) else content.encode())
    (folder / "data.yaml").write_text(mapping, encoding="utf-8")
    code = main(["identify", "check", str(folder / "data.yaml")])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


@pytest.mark.parametrize(
    ("content", "note"),
    [
        ((HEADER + rows()).encode("utf-16"), "read as utf-16"),
        ((HEADER + rows()).encode("utf-16-le"), "read as utf-16-le"),
        ((HEADER + rows()).encode("utf-16-be"), "read as utf-16-be"),
        (gzip.compress((HEADER + rows()).encode()), "is compressed with gzip"),
        ((HEADER + rows().replace("\n", ",\n").replace(",\n", "\n")).replace("\n", "\r").encode(), ""),
    ],
)
def test_text_in_any_encoding_is_read_and_its_encoding_reported(tmp_path, capsys, content, note):
    code, out, err = check(tmp_path, content, capsys)
    assert (code, err) == (0, "")
    assert note in out


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"PK\x03\x04" + bytes(900), "is a workbook or another zip file, not text; export it as CSV"),
        (b"\xd0\xcf\x11\xe0" + bytes(900), "is an Excel workbook, not text"),
        (b"\x1f\x8b" + bytes(900), "is a damaged gzip file"),
        (bytes(5000), "is not text; CSV is expected"),
        (np.random.default_rng(0).bytes(5000), "is not text; CSV is expected"),
        (HEADER.replace("vy", "vx") + rows(), "has 2 columns 'vx'; rename one"),
        (rows(), "has no header; name its columns under 'csv: {columns: […]}'"),
    ],
)
def test_each_fault_of_an_unreadable_table_is_reported_in_one_line(tmp_path, capsys, content, expected):
    code, _, err = check(tmp_path, content, capsys)
    assert code == 2
    assert expected in err
    assert all(line.startswith("error: ") for line in err.splitlines())


@pytest.mark.parametrize(("steer", "mistake"), [(57.3, "deg as rad"), (1 / 57.3, "rad as deg")])
def test_steering_in_the_wrong_unit_is_a_fault_and_no_fit(tmp_path, capsys, steer, mistake):
    code, out, _ = check(tmp_path, HEADER + rows(steer), capsys)
    assert code == 1
    assert f"would be explained by: {mistake} of road_wheel_angle" in out
    assert main(["identify", str(tmp_path / "data.yaml"), "--out", str(tmp_path / "out")]) == 2
    assert "correct 'unit' or 'sign' of road_wheel_angle" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "finding", "expected"),
    [
        ({"speed": 0.0}, "the vehicle is at rest", "vx: the vehicle is at rest in all training logs"),
        ({"steer": 0.0}, "is 0 rad all the time", "road_wheel_angle: does not move in any training log"),
    ],
)
def test_a_vehicle_at_standstill_or_a_constant_steering_gives_no_fit(tmp_path, capsys, change, finding, expected):
    _, out, _ = check(tmp_path, HEADER + rows(**change), capsys)
    assert finding in out
    assert main(["identify", str(tmp_path / "data.yaml"), "--out", str(tmp_path / "out")]) == 2
    assert expected in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_constant_log_is_a_fault(tmp_path, capsys):
    still = HEADER + "".join(f"{0.02 * row:g},5,5,5,5,5\n" for row in range(400))
    code, out, _ = check(tmp_path, still, capsys)
    assert code == 1
    assert "every channel is constant: there is nothing to identify" in out
    assert main(["identify", str(tmp_path / "data.yaml"), "--out", str(tmp_path / "out")]) == 2


def test_no_parameter_is_identified_from_noise(tmp_path):
    """A single track is fitted to noise: none of its parameters is called identified."""
    from mirdrake.identification.default_study import default_study
    from mirdrake.identification.identify import identify

    random = np.random.default_rng(3)
    t = np.arange(0.0, 10.0, 0.04)
    table = np.column_stack((t, 5.0 + random.normal(0, 1, len(t)), random.normal(0, 1, (len(t), 4))))
    (tmp_path / "log.csv").write_text(HEADER + "\n".join(",".join(f"{v:.5g}" for v in row) for row in table))
    (tmp_path / "data.yaml").write_text(MAPPING, encoding="utf-8")
    plain = ["model.tyres=linear", "parameters.steering_lag.fixed=0", "parameters.load_transfer.fixed=0"]
    plain += ["model.relaxation=false", "model.roll=false", "estimator.iterations=3"]
    try:
        fit = identify(default_study(tmp_path / "data.yaml", overrides=plain), tmp_path).fit
    except ConfigError:
        return  # a rejection is correct too
    assert all(parameter.verdict != "identified" for parameter in fit.parameters if parameter.kind != "fixed")
    assert "the model fits no channel" in fit.notes[0]
    assert reject_poor_fit(fit).parameters == fit.parameters


def test_a_key_of_a_model_in_its_short_form_can_be_set(tmp_path):
    from mirdrake.identification.study import load_identification

    text = "mirdrake: identification/1\ndata: data.yaml\nmodel: single_track\n"
    (tmp_path / "study.yaml").write_text(text, encoding="utf-8")
    spec = load_identification(tmp_path / "study.yaml", overrides=["model.tyres=fiala"])
    assert spec.model == {"kind": "single_track", "tyres": "fiala"}
