"""Driving from recorded commands: a run repeated, a table with units, a driving log, and rejected files."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mirdrake.cli import main
from mirdrake.controllers.command_log import read_commands
from mirdrake.core.errors import ConfigError
from mirdrake.runs.logs import load_run
from mirdrake.runs.simulation import simulate

DIAGRAM = """\
world: skidpad
vehicles:
  ego: {model: bolt, start: left}
control:
  ego: {kind: path_tracking, track: left, speed: 5 m/s}
plant: {contact: point}
record: {meshcat: false, report: false}
duration: 5
"""


@pytest.fixture
def diagram(tmp_path: Path) -> Path:
    path = tmp_path / "drive.yaml"
    path.write_text(DIAGRAM, encoding="utf-8")
    return path


def call(*arguments: object) -> int:
    return main([*map(str, arguments), "--quiet"])


def apart(folder: Path, other: Path) -> float:
    """Return the largest distance between the paths of two runs [m]."""
    a, b = load_run(folder).signals, load_run(other).signals
    assert len(a) == len(b)
    return float(np.hypot(a["ego.x"] - b["ego.x"], a["ego.y"] - b["ego.y"]).max())


def test_the_commands_of_a_run_give_the_same_drive(diagram: Path, tmp_path: Path) -> None:
    assert call("run", diagram, "--out", tmp_path / "a") == 0
    assert call("run", diagram, "--commands", tmp_path / "a", "--out", tmp_path / "b") == 0
    assert load_run(tmp_path / "a")["ego.yaw"].abs().max() > 1.0  # round the circle
    assert apart(tmp_path / "a", tmp_path / "b") < 1e-4
    spec = load_run(tmp_path / "b").spec
    assert spec["control"]["ego"]["kind"] == "schedule"
    assert spec["duration"] == 5.0
    assert len(spec["provenance"]["content_sha256"]["ego.commands"]) == 64
    assert call("run", tmp_path / "b" / "spec.yaml", "--out", tmp_path / "c") == 0  # and that run again
    assert apart(tmp_path / "b", tmp_path / "c") == 0.0


def test_an_exported_table_gives_the_same_drive_but_for_a_fiftieth_of_a_second(diagram: Path, tmp_path: Path) -> None:
    assert call("run", diagram, "--out", tmp_path / "a") == 0
    assert main(["export", str(tmp_path / "a"), "--to", "csv"]) == 0
    log = tmp_path / "a" / "signals.csv"
    assert call("run", diagram, "--commands", f"ego={log}", "--out", tmp_path / "b") == 0
    assert apart(tmp_path / "a", tmp_path / "b") < 0.2  # 0.02 s at 5 m/s, and what grows from it in an open loop


def test_rows_with_units_drive_as_a_schedule_does(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    table = "steering [deg],time [ms],note,speed [km/h]\n0,0,go,3.6\n10,1000,,7.2\n0,2000,,7.2\n"
    log.write_text(table, encoding="utf-8")
    expected = [(0.0, 1.0, 0.0), (1.0, 2.0, np.radians(10.0)), (2.0, 2.0, 0.0)]
    np.testing.assert_allclose(read_commands(log).rows, expected, rtol=1e-12)
    rows = [
        {"time": 0.0, "speed": 1.0},
        {"time": 1.0, "speed": 2.0, "steering": float(np.radians(10.0))},
        {"time": 2.0, "speed": 2.0},
    ]
    data: dict[str, Any] = {
        "world": "empty",
        "vehicles": {"ego": {"model": "bolt"}},
        "plant": {"contact": "point"},
        "duration": 2.5,
    }
    drivers = ({"file": str(log)}, {"rows": rows, "interpolation": "hold"})
    a, b = (simulate(data | {"control": {"ego": {"kind": "schedule"} | driver}}) for driver in drivers)
    assert np.array_equal(a["ego.x"], b["ego.x"])
    assert a["ego.steering_command"].max() == pytest.approx(np.radians(10.0))


def test_a_file_of_a_diagram_lies_beside_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "log.csv").write_text("time,speed,steering\n0,1,0\n1,1,0\n", encoding="utf-8")
    path = tmp_path / "drive.yaml"
    path.write_text(
        DIAGRAM.replace("path_tracking, track: left, speed: 5 m/s", "schedule, file: log.csv"), encoding="utf-8"
    )
    monkeypatch.chdir("/")
    assert call("run", path, "--duration", 0.1, "--out", tmp_path / "run") == 0


def test_a_driving_log_drives(tmp_path: Path, diagram: Path) -> None:
    moments = ["12-00-59-000000", "12-00-59-500000", "12-01-00-000000"]
    lines = [f"2019-05-31-{moment}.jpg\t{0.1 * k:.2f}\t{2.0 + k}\r\n" for k, moment in enumerate(moments)]
    log = tmp_path / "driving_log.txt"
    log.write_bytes("".join(lines).encode())
    commands = read_commands(log)
    assert commands.interpolation == "linear"
    np.testing.assert_allclose(commands.rows, [(0.0, 2.0, 0.0), (0.5, 3.0, 0.1), (1.0, 4.0, 0.2)], atol=1e-9)
    assert call("run", diagram, "--commands", log, "--out", tmp_path / "run") == 0
    run = load_run(tmp_path / "run")
    assert run.signals.index[-1] == pytest.approx(1.0)  # as long as the log lasts
    assert run["ego.speed_command"].iloc[-1] == pytest.approx(4.0, abs=0.01)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "log.csv: is empty; a header and rows of numbers are expected"),
        ("time,speed,steering\n", "has a header and no rows"),
        (
            "time,velocty,steering\n0,1,0\n",
            "log.csv: no column 'speed' (or velocity, speed_command); there are: time, velocty, steering",
        ),
        ("time [h],speed [kg],steering\n0,1,0\n", "log.csv: speed: unit 'kg' does not fit; allowed: m/s, km/h, mph"),
        ("time,speed,steering\n0,fast,0\n", "log.csv:2: column 'speed': 'fast' is not a number"),
        ("time,speed,steering\n0,nan,0\n", "log.csv:2: speed: a finite number is missing"),
        ("time,speed,steering\n0,1,2\n", "log.csv:2: steering: 2 rad is out of range"),
        ("time,speed,steering\n0,1\n", "log.csv:2: steering: a finite number is missing"),
        ("time,speed,steering\n0,1,0\n0,1,0\n", "log.csv:3: time 0 s is not later than the time of the row before"),
        ("2019-05-31-12-00-59-000000.jpg\t0\n", "log.csv:1: speed: a finite number is missing"),
        (
            "2019-15-31-12-00-59-000000.jpg\t0\t1\n",
            "log.csv:1: '2019-15-31-12-00-59-000000.jpg' is not the name of a picture",
        ),
        ("\xff\n1\n", "no column 'time'"),
    ],
)
def test_a_log_with_faults_is_rejected_with_its_line(tmp_path: Path, text: str, words: str) -> None:
    log = tmp_path / "log.csv"
    log.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        read_commands(log)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_faults_are_reported_before_anything_is_written(
    diagram: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "one.csv").write_text("time,speed,steering\n0,1,0\n", encoding="utf-8")
    (tmp_path / "bad.csv").write_text("time,speed\n0,1\n", encoding="utf-8")
    expected_errors = {
        "--commands nothing.csv: no such file": "nothing.csv",
        "no vehicle 'ego2'; did you mean 'ego'?": "ego2=log.csv",
        "contains fewer than two rows at different times": str(tmp_path / "one.csv"),
        "bad.csv: no column 'steering'": str(tmp_path / "bad.csv"),
        "is a folder, but not a run folder": str(tmp_path),
    }
    for words, log in expected_errors.items():
        assert call("run", diagram, "--commands", log, "--out", tmp_path / "out") == 2
        error = capsys.readouterr().err
        assert words in error
        assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("driver", "words"),
    [
        ("schedule", "control.ego: needs either rows or a file"),
        ("schedule, file: x.csv, rows: [{time: 0}]", "control.ego: needs either rows or a file"),
        ("schedule, file: x.csv", "drive.yaml:5: control.ego.file: "),
    ],
)
def test_a_schedule_has_rows_or_a_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], driver: str, words: str
) -> None:
    path = tmp_path / "drive.yaml"
    path.write_text(DIAGRAM.replace("path_tracking, track: left, speed: 5 m/s", driver), encoding="utf-8")
    assert call("run", path, "--out", tmp_path / "out") == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
