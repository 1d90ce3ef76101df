"""``mirdrake tune``."""

from pathlib import Path

import pytest

from mirdrake.cli import main
from mirdrake.cli.tune import format_time_left

SHORT = """\
mirdrake: tuning/1
vehicle: bolt
loop: {loop}
test: {{duration: 4, load_time: 3.5, step: 1}}
search: {{trials: 6, confirm: 1}}
constraints: {{overshoot_percent: 20, ms: 1.8}}
robustness: {{runs: 0}}
"""


def test_the_time_left_has_whole_minutes() -> None:
    times = (0.4, 59.7, 90.0, 3599.0, float("nan"), float("inf"))
    assert [format_time_left(time) for time in times] == ["0:00 left", "1:00 left", "1:30 left", "59:59 left", "", ""]


def write(folder: Path, text: str) -> str:
    path = folder / "study.yaml"
    path.write_text(text)
    return str(path)


def test_bad_input_is_a_one_line_error_and_writes_no_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study = write(tmp_path, SHORT.format(loop="sped"))
    assert main(["tune", study, "--out", str(tmp_path / "out")]) == 2
    assert "study.yaml:3: loop: no loop 'sped'; did you mean 'speed'?" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_options_may_be_anywhere(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study = write(tmp_path, SHORT.format(loop="speed"))
    out = str(tmp_path / "out")
    for words in (
        ["tune", study, "--set", "cost.iea=1", "--out", out, "--workers", "0"],
        ["tune", "--set", "cost.iea=1", "--out", out, study, "--workers", "0"],
    ):
        assert main(words) == 2
        assert "no figure 'iea'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("constraints={overshot: 5}", "constraints.overshot: no figure 'overshot'; did you mean 'overshoot"),
        ("cost={iea: 1}", "cost.iea: no figure 'iea'"),
        ("search.ranges={kq: {low: 1, high: 2}}", "search.ranges.kq: no gain 'kq'"),
        ("test.load_time=9", "test.load_time: 9 s is not between"),
    ],
)
def test_check_finds_what_tune_finds(
    change: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study = write(tmp_path, SHORT.format(loop="speed"))
    assert main(["tune", study, "--set", change, "--workers", "0", "--out", str(tmp_path / "out")]) == 2
    of_tune = capsys.readouterr().err
    assert message in of_tune
    assert main(["check", study, "--set", change]) == 2
    assert capsys.readouterr().err == of_tune


def test_a_missing_study(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["tune", "nowhere.yaml"]) == 2
    assert "nowhere.yaml" in capsys.readouterr().err


def test_apply_is_dispatched(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["tune", "apply", str(tmp_path), "--dry-run"]) == 2
    assert "not a tuning result" in capsys.readouterr().err


@pytest.mark.slow
def test_a_study_is_tuned_printed_and_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study = write(tmp_path, SHORT.format(loop="speed"))
    out = tmp_path / "out"
    assert main(["tune", study, "--workers", "0", "--out", str(out)]) in (0, 1)
    shown = capsys.readouterr().out
    assert "best" in shown
    assert "cost below that of the present gains" in shown
    assert (out / "tuning.html").is_file()
