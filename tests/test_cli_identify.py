"""``mirdrake identify``: exit codes, messages, files."""

import numpy as np
import pytest

from mirdrake.cli import main
from mirdrake.identification.fit import load_fit
from tests.test_identification_data import recorded
from tests.test_identification_study import STUDY, write

DATA = STUDY.split("model:")[0].replace("identification/1\ndata:", "data/1").replace("\n  ", "\n")


def test_a_study_is_run_and_its_folder_is_complete(tmp_path, capsys):
    path = write(tmp_path)
    arguments = ["identify", str(path), "--out", str(tmp_path / "out"), "--set", "parameters.yaw_inertia.given=2400"]
    assert main(arguments) == 0
    text = capsys.readouterr().out
    assert "cornering_stiffness_front" in text
    assert "report.html" in text
    assert {file.name for file in (tmp_path / "out").iterdir()} >= {
        "report.html", "fit.json", "traces.parquet", "profiles.parquet", "data_check.csv",
    }  # fmt: skip
    assert load_fit(tmp_path / "out").name == "study"
    assert main(arguments) == 2
    assert "is not empty; choose another folder with --out" in capsys.readouterr().err


def test_the_word_run_may_be_given(tmp_path, capsys):
    assert main(["identify", "run", str(tmp_path / "none.yaml")]) == 2
    assert "none.yaml': no such file" in capsys.readouterr().err
    assert main(["identify", str(tmp_path / "none.yaml")]) == 2


def test_a_fault_is_one_line_with_its_place_and_leaves_no_folder(tmp_path, capsys):
    path = write(tmp_path, STUDY.replace("low: 3e4, high: 3e5", "low: 3e5, high: 3e4"))
    assert main(["identify", str(path), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert "study.yaml:16: parameters.cornering_stiffness_front: low" in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_data_file_and_a_study_are_checked(tmp_path, capsys):
    path = write(tmp_path)
    (tmp_path / "drives.yaml").write_text(DATA, encoding="utf-8")
    for name in (path.name, "drives.yaml"):
        report = tmp_path / "check.html"
        assert main(["identify", "check", str(tmp_path / name), "--report", str(report)]) == 0
        text = capsys.readouterr().out
        assert "a.csv (train, 1000 samples" in text
        assert "no fault is left" in text
        assert "as recorded" in report.read_text(encoding="utf-8")


def test_a_log_itself_is_checked_with_a_mapping_and_nothing_else(tmp_path, capsys):
    log = recorded(1)
    table = log.to_pandas().iloc[np.repeat(np.arange(len(log.time)), 4)]
    table["yaw_rate"] = np.degrees(table["yaw_rate"])
    table.to_csv(tmp_path / "log.csv", index=False)
    base = ["identify", "check", str(tmp_path / "log.csv"), "--step", "1 ms", "--map", "vx=vx:m/s"]
    base += ["--map", "vy=vy:m/s", "--map", "longitudinal_acceleration=longitudinal_acceleration:m/s^2"]
    base += ["--map", "lateral_acceleration=lateral_acceleration:m/s^2", "--map", "yaw=yaw:rad"]
    assert main([*base, "--map", "yaw_rate=yaw_rate:deg/s"]) == 0
    text = capsys.readouterr().out
    assert "held over 4 rows" in text
    assert "the true step is 0.01 s" in text or "the true step is 0.0100" in text or "2.5 times" in text
    assert main([*base, "--map", "yaw_rate=yaw_rate:deg/s", "--repairs", "none"]) == 1
    assert "0 repairs; 2 faults without repair" in capsys.readouterr().out
    assert main([*base, "--map", "yaw_rate=yaw_rate:rad/s", "--quiet"]) == 1
    assert capsys.readouterr().out == ""


def test_columns_with_known_names_and_units_need_no_mapping(tmp_path, capsys):
    log = recorded(1)
    names = {name: f"car.{name} [{unit}]" for name, unit in log.to_pandas().attrs["units"].items()}
    log.to_pandas().rename(columns=names).to_csv(tmp_path / "log.csv")
    assert main(["identify", "check", str(tmp_path / "log.csv"), "--wheelbase", "2.7"]) == 0
    assert "speed · road_wheel_angle / wheelbase" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["log.csv"], "log.csv: no column is mapped; give --map CHANNEL=COLUMN:UNIT; columns are time, v"),
        (["log.csv", "--map", "vx"], "--map vx: write CHANNEL=COLUMN"),
        (["log.csv", "--map", "vxx=v:m/s"], "--map vxx=v:m/s: unknown channel 'vxx'; did you mean 'vx'"),
        (["log.csv", "--map", "vx=v:kg"], "unit 'kg' does not fit"),
        (["log.csv", "--map", "vx=w:m/s"], "has no column 'w'"),
        (["log.csv", "--map", "vx=v:m/s", "--time", "time", "--step", "1"], "--step: --time names a clock already"),
        (["log.csv", "--map", "vx=v:m/s", "--repairs", "delay"], "unknown repair 'delay'; did you mean 'delays'"),
        (["none.csv"], "none.csv: no such file"),
        (["other.csv", "--map", "vx=v:m/s"], "other.csv: has no column 'time'; name the clock with --time COLUMN:UNIT"),
        (["drives.yaml", "--map", "vx=v:m/s"], "--map: drives.yaml has its own mapping"),
    ],
)
def test_bad_input_of_a_check_is_one_line(tmp_path, capsys, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "log.csv").write_text("time,v\n" + "".join(f"{0.1 * i:.1f},{i}\n" for i in range(50)))
    (tmp_path / "other.csv").write_text("t_s,v\n0.0,1\n0.1,2\n")
    (tmp_path / "drives.yaml").write_text(DATA, encoding="utf-8")
    assert main(["identify", "check", *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert "Traceback" not in error


def test_help_names_the_verbs(capsys):
    with pytest.raises(SystemExit):
        main(["identify", "--help"])
    text = capsys.readouterr().out
    assert "check" in text
    assert "study.yaml" in text
