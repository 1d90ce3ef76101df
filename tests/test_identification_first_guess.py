"""Identification from a mapping alone: first guesses of the steering, rejected signs, default studies, validation."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from mirdrake.cli import main
from mirdrake.core.errors import ConfigError
from mirdrake.identification import DataSet, Log
from mirdrake.identification.default_study import default_study
from mirdrake.identification.estimators import fit
from mirdrake.identification.estimators.options import EstimatorOptions
from mirdrake.identification.estimators.structure import choose_structure
from mirdrake.identification.findings import DataReport, Finding, statement
from mirdrake.identification.models import ModelSpec, make_model
from mirdrake.identification.models.equations import EquationModel
from mirdrake.identification.models.first_guess import guess_steering
from mirdrake.identification.parameters import Setting
from mirdrake.identification.rejection import reject_faults
from mirdrake.identification.validation_split import lateral_jerk, split_validation
from tests.identification_rigs import pull

TIME = np.arange(0.0, 60.0, 0.02)


def steady(
    wheelbase=0.32, ratio=1.2, straight=0.53, top=4.0, lock=0.25, understeer=0.02, channel="steering_command", seed=0
):
    """A vehicle that is at any time in a steady bend: r = v δ / (L + K v²), by its command of any scale and zero."""
    random = np.random.default_rng(seed)
    v = top * (0.6 + 0.35 * np.sin(0.25 * TIME))
    angle = lock * np.sin(0.9 * TIME) * np.sin(0.11 * TIME)
    rate = v * angle / (wheelbase + understeer * v**2) + 0.01
    channels = {
        "vx": v + random.normal(0.0, 0.005 * top, len(TIME)),
        channel: straight + ratio * angle,
        "yaw_rate": rate + random.normal(0.0, 0.01, len(TIME)),
    }
    return Log("drive", "train", TIME, channels)


@pytest.mark.parametrize(
    ("ratio", "straight", "wheelbase", "top", "lock"),
    [
        (1.2, 0.53, 0.32, 4.0, 0.25),  # servo of a small robot, 0 to 1
        (500.0, 1500.0, 0.32, 4.0, 0.25),  # pulses of a servo
        (1.6, 0.0, 2.9, 25.0, 0.04),  # a car
    ],
)
def test_slow_turns_determine_scale_and_zero_of_a_command(ratio, straight, wheelbase, top, lock):
    log = steady(wheelbase, ratio, straight, top, lock, understeer=0.002 * wheelbase)
    guess = guess_steering([log], "steering_command")
    assert guess is not None
    assert guess.gain * wheelbase == pytest.approx(1.0 / ratio, rel=0.15)  # of the fit's start, K held near zero
    assert guess.curvature / guess.gain == pytest.approx(-straight, abs=0.01 * ratio)


@pytest.mark.parametrize("lag", [0.005, 0.02, 0.1])
def test_one_speed_without_noise_does_not_separate_a_zero_of_the_steering_from_a_bias(lag):
    """A figure of eight at 2 m/s from a standing start: v and 1 are collinear but for the start and some drag."""
    shape = np.tanh(8.0 * np.sin(2.0 * np.pi * TIME / 30.0))
    v = 2.0 * (1.0 - np.exp(-TIME / 0.4) - 2e-4 * (1.0 - shape**2) + 1e-4 * shape)
    angle = 0.077 * shape
    keep = np.exp(-0.02 / lag)
    rate = lfilter([1.0 - keep], [1.0, -keep], v * np.tan(angle) / 0.7)
    guess = guess_steering([Log("eight", "train", TIME, {"vx": v, "road_wheel_angle": angle, "yaw_rate": rate})],
                           "road_wheel_angle")  # fmt: skip
    assert guess is not None
    assert guess.gain == pytest.approx(1.0 / 0.7, rel=0.02)
    assert abs(0.7 * guess.curvature) < 0.005  # half of what is usual for an angle sensor


@pytest.mark.parametrize("zero", [0.0, 0.3])
def test_one_angle_does_not_separate_ratio_and_zero_of_a_command(zero):
    """A circle steered by hand: the zero is that of a vehicle with wheels aligned, unless the logs show another one."""
    random = np.random.default_rng(5)
    v = 8.0 + 2.0 * np.sin(0.2 * TIME)
    wander = (0.0002 if zero == 0.0 else 0.05) * np.sin(0.9 * TIME)
    angle = 0.06 * (1.0 + wander / 0.1)
    channels = {
        "vx": v + random.normal(0.0, 0.02, len(TIME)), "steering_command": zero + 2.2 * angle,
        "yaw_rate": v * angle / 1.4 + random.normal(0.0, 0.02, len(TIME)),
    }  # fmt: skip
    guess = guess_steering([Log("circle", "train", TIME, channels)], "steering_command")
    assert guess is not None
    assert guess.gain * 1.4 == pytest.approx(1.0 / 2.2, rel=0.1)
    assert guess.curvature / guess.gain == pytest.approx(-zero, abs=0.02)


def test_skids_do_not_change_the_guess():
    """Three seconds of skidding in every minute, with an arbitrary yaw rate; single glitches are repaired before."""
    log = steady()
    rate = log.channels["yaw_rate"].copy()
    rate[(TIME > 20.0) & (TIME < 23.0)] = 2.5
    spoilt = replace(log, channels={**log.channels, "yaw_rate": rate})
    clean, dirty = (guess_steering([data], "steering_command") for data in (log, spoilt))
    assert clean is not None
    assert dirty is not None
    assert dirty.gain == pytest.approx(clean.gain, rel=0.05)


def test_one_speed_gives_the_gain_there():
    """Ratio and understeer are one number at one speed: K is held near zero, and the gain is that of the bends."""
    top, understeer = 25.0, 0.004
    random = np.random.default_rng(2)
    angle = 0.02 * np.sin(0.7 * TIME)
    gain = 1.0 / (2.7 + understeer * top**2)
    channels = {
        "vx": top + random.normal(0.0, 0.05, len(TIME)),
        "steering_wheel_angle": 15.0 * angle + 0.1,
        "yaw_rate": top * angle * gain + random.normal(0.0, 0.002, len(TIME)),
    }
    guess = guess_steering([Log("drive", "train", TIME, channels)], "steering_wheel_angle")
    assert guess is not None
    assert guess.gain == pytest.approx(gain / 15.0, rel=0.1)


def test_no_guess_from_a_wrong_sign_or_from_noise():
    log = steady()
    wrong = replace(log, channels={**log.channels, "yaw_rate": -log.channels["yaw_rate"]})
    noise = np.random.default_rng(3).normal(0.0, 0.3, len(TIME))
    for spoilt in (wrong, replace(log, channels={**log.channels, "yaw_rate": noise})):
        assert guess_steering([spoilt], "steering_command") is None


def test_a_model_starts_at_the_guess_and_its_bounds_hold_it():
    model = make_model(ModelSpec("single_track"), DataSet((steady(),), wheelbase=0.32), {})
    p = {info.name: info for info in model.parameters}
    assert p["steering_ratio"].guess == pytest.approx(1.2, rel=0.08)
    assert p["steering_offset"].guess == pytest.approx(-0.53 / 1.2, abs=0.03)
    assert p["steering_offset"].low < -1.0
    assert p["steering_offset"].high > 0.5


def test_without_a_wheelbase_the_turns_determine_the_size():
    """A measured angle of the wheels gives the wheelbase; a command only shows that no car drives such curves."""
    lengths = ("front_length", "rear_length")
    for channel, ratio, straight, about in (("road_wheel_angle", 1.0, 0.0, 0.08), ("steering_command", 1.2, 0.53, 0.6)):
        log = steady(ratio=ratio, straight=straight, channel=channel)
        model = make_model(ModelSpec("single_track"), DataSet((log,)), {})
        p = {info.name: info for info in model.parameters}
        assert sum(p[name].guess for name in lengths) == pytest.approx(0.32, rel=about)
        assert p["front_length"].source.startswith("assumed")
    car = make_model(ModelSpec("single_track"), DataSet((steady(2.7, 15.0, 0.0, 25.0, 0.03, 0.004),)), {})
    assert sum(info.guess for info in car.parameters if info.name in lengths) == pytest.approx(2.7)


def fault(channel, what, check="units"):
    return Finding("lap", check, channel, "fault", 1.0, "1", what)


def report(*findings):
    return DataReport(tuple(findings), (), DataSet((steady(),)))


USED = {"vx", "yaw_rate", "steering_command"}
SIGN = statement("steering_sign", channel="steering_command", correlation=-0.9)
STEP = statement("unknown_step", step=2.0)


def test_a_wrong_sign_is_rejected_in_one_line_with_its_correction():
    message = fault("steering_command", SIGN)
    with pytest.raises(ConfigError) as caught:
        reject_faults(report(message, replace(message, log="other")), USED)
    text = str(caught.value)
    assert text.startswith("lap and 1 more: steering_command: ")
    assert "write 'sign: -1' at steering_command in 'channels'" in text
    assert "\n" not in text


def test_a_wrong_yaw_rate_is_not_attributed_to_the_steering():
    steering = fault("steering_command", SIGN)
    rate = fault("yaw_rate", statement("mistakes", mistakes="wrong sign of yaw_rate", signs_only=True))
    with pytest.raises(ConfigError) as caught:
        reject_faults(report(steering, rate), USED)
    assert "yaw_rate" in str(caught.value)
    assert "steering_command" not in str(caught.value)


def test_faults_of_unused_channels_are_accepted():
    signs = statement("mistakes", mistakes="wrong sign of yaw_rate or of yaw", signs_only=True)
    reject_faults(report(fault("yaw", signs), fault("yaw_rate, yaw", signs)), USED)
    repaired = replace(fault("", STEP, "sample_time"), done=statement("scaled_time", factor=2.0))
    reject_faults(report(repaired, fault("vx", statement("all_constant"), "range")), USED)


def write_log(folder, change=""):
    table = steady().to_pandas()
    table.to_csv(folder / "log.csv")
    text = f"""\
mirdrake: data/1
wheelbase: 0.32 m
channels:
  vx: {{column: vx, unit: m/s}}
  yaw_rate: {{column: yaw_rate, unit: rad/s}}
  steering_command: {{column: steering_command{change}}}
logs: [{{file: log.csv}}]
"""
    (folder / "data.yaml").write_text(text, encoding="utf-8")
    return folder / "data.yaml"


def test_a_data_file_alone_has_a_study(tmp_path):
    spec = default_study(write_log(tmp_path), overrides=["model.tyres=linear"])
    assert spec.model == {"kind": "single_track", "tyres": "linear"}
    assert spec.validation_fraction == 0.3
    assert "for validation" in spec.about


def test_a_data_file_without_a_suitable_model_names_the_missing_channel(tmp_path):
    path = write_log(tmp_path)
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    path.write_text("".join(line for line in lines if "steering_command" not in line), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"no model can be fitted .*\(vx, yaw_rate\); map the steering"):
        default_study(path)


def test_the_command_fits_a_data_file_and_rejects_a_wrong_sign(tmp_path, capsys):
    path = write_log(tmp_path)
    main(["identify", str(path), "--out", str(tmp_path / "out"), "--set", "model.kind=kinematic"])
    text = capsys.readouterr().out
    assert text.startswith("data: no study is given: model single_track, chosen by the channels")
    assert "Data check, warnings:" in text
    assert "log.csv, end" in text
    path = write_log(tmp_path, ", sign: -1")
    assert main(["identify", str(path), "--out", str(tmp_path / "wrong")]) == 2
    error = capsys.readouterr().err
    assert "write 'sign: -1' at steering_command" in error
    assert error.count("\n") == 1
    assert not (tmp_path / "wrong").exists()


def test_the_end_of_a_single_log_is_for_validation():
    single_log = steady()
    apart = split_validation(DataSet((single_log,)), 0.3)
    assert [(log.name, log.use) for log in apart.logs] == [("drive", "train"), ("drive, end", "validation")]
    assert sum(len(log.time) for log in apart.logs) == len(TIME)
    assert apart.train[0].time[-1] == pytest.approx(0.7 * TIME[-1], abs=0.05)
    assert np.all(apart.validation[0].time > apart.train[0].time[-1])


def weaving(name, hertz, lasts=60.0):
    """At 10 m/s with a yaw rate of 0.2 rad/s and a frequency: jerk 10 · 0.2 · 2π f."""
    time = np.arange(0.0, lasts, 0.01)
    channels = {"vx": np.full(len(time), 10.0), "yaw_rate": 0.2 * np.sin(2.0 * math.pi * hertz * time)}
    return Log(name, "train", time, channels)


def test_lateral_jerk_is_speed_times_yaw_acceleration():
    smoothed = math.exp(-0.5 * (2.0 * math.pi * 0.5 * 0.05) ** 2)  # a Gaussian of 50 ms
    usual = math.cos(0.005 * math.pi)  # that a cosine exceeds in a hundredth of its time
    assert lateral_jerk(weaving("half", 0.5)) == pytest.approx(2.0 * math.pi * smoothed * usual, rel=1e-3)
    assert lateral_jerk(Log("still", "train", TIME, {"vx": np.ones(len(TIME))})) == 0.0


def test_the_log_with_the_highest_lateral_jerk_stays_for_training():
    hertz = {"slow": 0.1, "sweep": 2.0, "slalom": 0.5, "step": 1.0, "bend": 0.05}
    drives = DataSet(tuple(weaving(name, frequency) for name, frequency in hertz.items()))
    apart = split_validation(drives, 0.3)
    assert [log.name for log in apart.train] == ["slow", "sweep", "slalom", "bend"]
    # 90 of 300 s: the second, then the end of the fifth in the order of quickness.
    assert [log.name for log in apart.validation] == ["step", "bend, end"]
    assert apart.validation[1].time[0] == pytest.approx(30.0, abs=0.05)
    assert [log.name for log in split_validation(drives, 0.4).train] == ["slow", "sweep", "slalom"]


def test_logs_without_turns_are_for_validation_from_the_last():
    drives = DataSet(tuple(Log(name, "train", TIME, {"vx": np.sin(TIME)}) for name in ("a", "b", "c", "d")))
    apart = split_validation(drives, 0.375)
    assert [(log.name, log.use) for log in apart.logs] == [
        ("a", "train"), ("b", "train"), ("c", "train"), ("d", "validation"), ("c, end", "validation"),
    ]  # fmt: skip


def lagging(lag):
    """Return steady curves behind a first-order steering, without other delays."""
    log = steady(top=2.0, lock=0.2)
    command = log.channels["steering_command"] + 0.1 * np.sign(np.sin(2.1 * TIME))
    angle = np.empty(len(TIME))
    angle[0] = command[0]
    for k in range(1, len(TIME)):
        angle[k] = command[k] + (angle[k - 1] - command[k]) * np.exp(-0.02 / lag) if lag else command[k]
    rate = log.channels["vx"] * (angle - 0.53) / 1.2 / 0.32
    rate = rate + np.random.default_rng(1).normal(0.0, 0.01, len(TIME))
    return DataSet((replace(log, channels={**log.channels, "steering_command": command, "yaw_rate": rate}),), 0.32)


@pytest.mark.parametrize("lag", [0.0, 0.15])
def test_a_lag_is_fitted_where_the_logs_support_it(lag):
    structure = choose_structure(lagging(lag), ModelSpec("kinematic"), {}, EstimatorOptions())
    assert ("steering_lag" in structure.settings) is (lag > 0.0)
    assert len(structure.notes) == (1 if lag else 0)
    if lag:
        assert structure.start is not None
        assert structure.start.values["steering_lag"] == pytest.approx(lag, rel=0.1)


def test_settings_of_a_study_are_not_changed(monkeypatch):
    from mirdrake.identification.estimators import structure

    data = lagging(0.15)
    monkeypatch.setattr(structure, "_minimise", lambda *_: pytest.fail("nothing is open"))
    fixed = {"steering_lag": Setting(fixed=0.1)}
    choice = choose_structure(data, ModelSpec("kinematic"), fixed, EstimatorOptions())
    assert choice.settings == fixed
    assert choose_structure(data, ModelSpec("longitudinal"), {}, EstimatorOptions()).settings == {}


def test_advice_is_left_out_where_no_manoeuvre_can_be_followed(monkeypatch):
    """The figures of a diverging manoeuvre are not numbers: no sentence is written about them."""
    from mirdrake.identification.estimators import output_error

    empty = SimpleNamespace(
        problem=SimpleNamespace(
            model=make_model(ModelSpec("kinematic"), DataSet((steady(),), 0.32), {}),
            drives=[SimpleNamespace(names={"vx"}, channels=lambda _: np.full(9, 3.0))],
            unknowns=(), values=lambda _: {"wheelbase": 0.32, "steering_ratio": 1.0}, sigmas={},
        ),
        covariance=np.eye(2), z=np.zeros(2),
    )  # fmt: skip
    for ranked in ((), (SimpleNamespace(name="step steer", d_gain=float("nan")),)):
        monkeypatch.setattr(output_error, "rank_manoeuvres", lambda *_, ranked=ranked, **__: ranked)
        assert output_error.recommend_manoeuvre(empty) is None  # type: ignore[arg-type]


def braking(height, seed=0, drive=0.5):
    """A single track whose stiffness goes with the load of its axles, braking and turning for 60 s; Euler, 1 ms."""
    random = np.random.default_rng(seed)
    front = rear = 0.16
    fine = np.arange(0.0, TIME[-1] + 5e-4, 1e-3)
    v, push = 3.2 + 1.2 * np.sin(1.1 * fine), 1.32 * np.cos(1.1 * fine)
    angle = 0.12 * np.sin(0.8 * fine) + 0.05 * np.sin(2.3 * fine + 1.0)
    vy = turn = 0.0
    channels = []
    for now, ax, steer in zip(v.tolist(), push.tolist(), angle.tolist(), strict=True):
        channels.append((vy, turn))
        along = ax - turn * vy
        moved = height / (9.81 * 0.16) * along
        tyres = -50.0 * (1.0 - moved) * (math.atan((vy + front * turn) / now) - steer)
        force = tyres * math.cos(steer) + pull(along + tyres * math.sin(steer), steer, drive)
        two = -60.0 * (1.0 + moved) * math.atan((vy - rear * turn) / now)
        vy, turn = (
            vy + 1e-3 * (force + two - now * turn),
            turn + 1e-3 * (front * force - rear * two) / 0.02,
        )
    v, angle, channels = v[::20], angle[::20], channels[::20]
    side, rate = np.array(channels).T
    return DataSet(
        (
            Log(
                "drive",
                "train",
                TIME,
                {
                    "vx": v,
                    "vy": side + random.normal(0.0, 0.01, len(TIME)),
                    "yaw_rate": rate + random.normal(0.0, 0.01, len(TIME)),
                    "road_wheel_angle": angle,
                },
            ),
        ),
        0.32,
    )


@pytest.mark.parametrize("height", [0.0, 0.08])
def test_load_transfer_is_fitted_where_the_logs_support_it(height):
    """Otherwise braking before curves appears as an early steering."""
    spec = ModelSpec("single_track", {"tyres": "linear"})
    structure = choose_structure(braking(height), spec, {}, EstimatorOptions())
    assert ("load_transfer" in structure.settings) is (height > 0.0)
    assert [note for note in structure.notes if "load transfer" in note] == list(structure.notes)
    if height:
        assert structure.start is not None
        assert structure.start.values["load_transfer"] == pytest.approx(height, rel=0.05)
        assert structure.start.values["yaw_inertia"] == pytest.approx(0.02, rel=0.05)
        # The noise is that of the sensors, not the misfit of the model without the effect.
        for sigma in structure.start.problem.sigmas.values():
            assert sigma == pytest.approx(0.01, rel=0.1)


@pytest.mark.parametrize("drive", [0.0, 1.0])
def test_the_unknown_share_of_the_front_axle_is_in_the_intervals(drive):
    """Half of the drive at the front is assumed, which moves the load transfer by far more than the noise does."""
    spec = ModelSpec("single_track", {"tyres": "linear", "relaxation": False})
    data, truth, held = braking(0.08, drive=drive), 0.08, {"load_transfer": Setting(free=True)}
    assumed: Any = fit(data, spec, parameters=held)["load_transfer"]
    assert abs(assumed.value - truth) > 5.0 * assumed.sigma_noise
    assert assumed.low < truth < assumed.high
    assert "the front axle's share of the drive force: give front_drive" in assumed.explanation
    known = fit(data, spec, parameters={**held, "front_drive": Setting(fixed=drive)})["load_transfer"]
    assert known.value == pytest.approx(truth, rel=0.02)


def test_the_force_of_an_axle_grows_with_its_load():
    """Steady bend r = v δ / (L + K v²), K = (b / Cf' - a / Cr') / L · m, with Cf' = Cf (1 - h ax / (g b)) and so on."""
    data = braking(0.0)
    model = make_model(ModelSpec("single_track", {"tyres": "linear"}), data, {})
    known = {parameter.name: parameter.guess for parameter in model.parameters}
    known |= {
        "cornering_stiffness_front": 50.0,
        "cornering_stiffness_rear": 60.0,
        "load_transfer": 0.08,
        "front_brake": 0.0,
    }
    p = {name: np.array([value]) for name, value in known.items()}
    speed, push, angle, half = 3.0, -2.0, 1e-3, 0.16
    front, rear = (50.0 * (1.0 - 0.08 * push / (9.80665 * half)), 60.0 * (1.0 + 0.08 * push / (9.80665 * half)))
    turn = speed * angle / (0.32 + (half / front - half / rear) / 0.32 * speed**2 * 0.32 / 0.32)
    side = turn * (half - half * speed**2 / (0.32 * rear))
    assert isinstance(model, EquationModel)
    rates = model.rates(np.array([[side], [turn]]), np.array([[angle], [speed], [push], [0.0], [0.0]]), p)
    assert np.abs(rates).max() < 1e-5 * speed * turn
