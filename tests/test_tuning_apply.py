"""Gains of a tuning result in control.yaml: changes, rejections, and atomic writing of files."""

import json
import shutil
from datetime import date
from pathlib import Path
from typing import Any

import pytest

from mirdrake.cli import main, tune_apply
from mirdrake.core.errors import ConfigError, RunError
from mirdrake.tuning.apply import plan_apply
from mirdrake.tuning.result import TABLES, read_result, result_text
from mirdrake.vehicles import load_vehicle
from mirdrake.vehicles.joint_control.pid import Pid
from tests.tuning_sample import result_data, write_sample

ROOT = Path(__file__).resolve().parent.parent
DAY = date(2026, 3, 1)
LINE = "tuned 2026-03-01: study sample, candidate searched, sha256 0123456789abcdef, cost 0.6046 (baseline 2.17)"


@pytest.fixture
def vehicle(tmp_path: Path) -> Path:
    return Path(shutil.copytree(ROOT / "models" / "unior", tmp_path / "unior"))


def _result(tmp_path: Path, vehicle: str | Path, **changes: Any) -> Path:
    folder = tmp_path / "result"
    folder.mkdir(exist_ok=True)
    (folder / "tuning.json").write_text(json.dumps(result_data(str(vehicle)) | changes))
    return folder


def _run(capsys: pytest.CaptureFixture[str], *words: str | Path) -> str:
    import argparse

    parser = argparse.ArgumentParser()
    tune_apply.add_arguments(parser)
    assert tune_apply.run(parser.parse_args([*(str(word) for word in words), "--force"])) == 0
    return capsys.readouterr().out


def test_an_outcome_that_does_not_meet_its_criteria_is_rejected_unless_forced(tmp_path: Path, vehicle: Path) -> None:
    unmet = {"name": "cheaper_than_baseline", "value": 0.6, "limit": 0.5, "met": False}
    result = read_result(_result(tmp_path, vehicle, acceptance=[unmet]))
    with pytest.raises(ConfigError, match=r"does not meet 1 of 1 criteria of the study; tuning.html .* --force"):
        plan_apply(result)
    assert plan_apply(result, force=True).changes


def test_the_command_states_in_words_which_criterion_is_not_met(tmp_path: Path, vehicle: Path, capsys) -> None:
    unmet = {"name": "cheaper_than_baseline", "value": 0.6, "limit": 0.5, "met": False}
    assert main(["tune", "apply", str(_result(tmp_path, vehicle, acceptance=[unmet]))]) == 2
    printed = capsys.readouterr()
    assert "note: criteria that are not met: cost below that of the given gains" in printed.out
    assert "cheaper_than_baseline" not in printed.out + printed.err


def test_only_the_gains_change_and_a_comment_states_their_origin(tmp_path: Path, vehicle: Path) -> None:
    before = (vehicle / "control.yaml").read_text()
    change = plan_apply(read_result(_result(tmp_path, vehicle)), today=DAY)
    expected = before.replace("  kind: pid\n", f"  # {LINE}\n  kind: pid\n", 1)
    expected = expected.replace("  kp: 1.38  ", "  kp: 3.54082  ").replace(
        "  ki: 1.38           # N m/rad\n", "  ki: 2.74938           # N m/rad\n  kd: 0.0  # N m s²/rad\n"
    )
    assert change.after == expected
    assert (vehicle / "control.yaml").read_text() == before  # not yet


def test_the_written_vehicle_has_the_gains_and_a_second_call_changes_nothing(
    tmp_path: Path, vehicle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = _result(tmp_path, vehicle)
    first = _run(capsys, folder)
    assert "+  kp: 3.54082 " in first
    assert "-  kp: 1.38 " in first
    control = load_vehicle(str(vehicle)).control.wheel_speed
    assert isinstance(control, Pid)
    assert (control.kp, control.ki, control.kd) == (3.54082, 2.74938, 0.0)
    bytes_after = (vehicle / "control.yaml").read_bytes()
    assert "nothing to do" in _run(capsys, folder)
    assert (vehicle / "control.yaml").read_bytes() == bytes_after


def test_the_comment_of_a_later_study_replaces_an_earlier_one(tmp_path: Path, vehicle: Path) -> None:
    plan_apply(read_result(_result(tmp_path, vehicle)), today=DAY).write()
    change = plan_apply(read_result(_result(tmp_path, vehicle)), candidate="lambda", today=date(2026, 4, 2))
    assert change.after.count("# tuned ") == 1
    assert "# tuned 2026-04-02: study sample, candidate lambda" in change.after


def test_a_dry_run_prints_and_does_not_write(tmp_path: Path, vehicle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (vehicle / "control.yaml").read_bytes()
    text = _run(capsys, _result(tmp_path, vehicle), "--dry-run")
    assert "+  kp: 3.54082 " in text
    assert "not written" in text
    assert (vehicle / "control.yaml").read_bytes() == before


def test_a_controller_of_another_kind_gets_the_gains_and_loses_unknown_keys(tmp_path: Path, vehicle: Path) -> None:
    loop = result_data("x")["loop"]
    loop["settings"] = {"steering.kind": "pid", "steering.filter": 0.02}
    loop["gains"] = {name: {"unit": "", "path": f"steering.{name}"} for name in ("kp", "ki", "kd")}
    change = plan_apply(read_result(_result(tmp_path, vehicle, loop=loop)), today=DAY)
    lines = change.after.splitlines()
    tail = lines[lines.index("steering:") :]
    assert tail == [
        "steering:", f"  # {LINE}", "  kind: pid", "  filter: 0.02  # s", "  kp: 3.54082  # N m/rad",
        "  ki: 2.74938  # N m/(rad s)", "  kd: 0.0  # N m s/rad",
    ]  # fmt: skip
    change.write()
    assert load_vehicle(str(vehicle)).control.steering.kind == "pid"


def test_gains_of_a_loop_of_a_variant_are_written_to_the_variant(tmp_path: Path, vehicle: Path) -> None:
    loop = result_data("x")["loop"] | {"settings": {}}
    loop["gains"] = {name: {"unit": "", "path": f"wheel_speed.{name}"} for name in ("kp", "ki")}
    candidates = [{"name": "searched", "kind": "searched", "gains": {"kp": 1.25, "ki": 0.75}, "feasible": True}]
    folder = _result(tmp_path, f"{vehicle}@handling", loop=loop, candidates=candidates)
    before = (vehicle / "variants" / "handling.yaml").read_text()
    assert "wheel_speed: {kind: pedals" in before
    change = plan_apply(read_result(folder), today=DAY)
    assert change.path == vehicle / "variants" / "handling.yaml"
    change.write()
    control = load_vehicle(f"{vehicle}@handling").control.wheel_speed
    assert (control.kind, control.kp, control.ki) == ("pedals", 1.25, 0.75)  # type: ignore[union-attr]
    assert load_vehicle(str(vehicle)).control.wheel_speed.kind == "pid"


BROKEN = {"check": "constraint", "figure": "ms", "value": 1.9, "limit": 1.6}


def _changed_candidate(**changes: Any) -> list[dict[str, Any]]:
    return [
        candidate | (changes if candidate["name"] == "searched" else {}) for candidate in result_data("x")["candidates"]
    ]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"candidates": _changed_candidate(feasible=False, rejections=[BROKEN])},
            "tuning.json: candidate 'searched' does not meet the constraints of the study (ms 1.9, limit 1.6); choose "
            "another with --candidate",
        ),
        (
            {"candidates": _changed_candidate(status="unstable", reason="it oscillates")},
            "tuning.json: candidate 'searched' is unstable (it oscillates); choose another with --candidate",
        ),
        (
            {"best": None},
            "tuning.json: best: the study found no candidate that meets its constraints; choose one by name",
        ),
        ({"best": "lamda"}, "tuning.json: no candidate 'lamda'; did you mean 'lambda'?"),
        ({"mirdrake": "tuning/1"}, "tuning.json: mirdrake: is 'tuning/1'; 'tuning-result/1' is expected"),
        (
            {"candidates": _changed_candidate(gains={"kp": None})},
            "tuning.json: candidates.2.gains.kp: should be a valid number",
        ),
        (
            {"candidates": _changed_candidate(gains={"kq": 1.0})},
            "tuning.json: loop.gains.kq: is not a path in control.yaml",
        ),
        (
            {"candidates": _changed_candidate(gains={"kp": "inf"})},
            "tuning.json: candidate 'searched': kp is inf, not a finite number",
        ),
        (
            {"candidates": _changed_candidate(gains={"kp": -4.0})},
            "wheel_speed.kp: -4.0 is not allowed; it should be greater than or equal to 0",
        ),
    ],
)
def test_a_result_that_does_not_fit_is_rejected_and_the_file_is_unchanged(
    tmp_path: Path, vehicle: Path, changes: dict[str, Any], message: str
) -> None:
    before = (vehicle / "control.yaml").read_bytes()
    with pytest.raises(ConfigError) as caught:
        plan_apply(read_result(_result(tmp_path, vehicle, **changes)), today=DAY).write()
    assert message in str(caught.value)
    assert (vehicle / "control.yaml").read_bytes() == before


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("kind: pid", "kind: servo\n  gain: 3", "control.yaml:13: wheel_speed.kp: unknown field"),
        ("  kp: 1.38 ", "  kp: [1.38] ", "control.yaml:12: wheel_speed.kp: a list is not"),
        ("wheel_speed:", "wheel_spede:", "control.yaml:10: wheel_spede: unknown field"),
        ("rate: 100", "rate: 100\n\trate", "control.yaml:3: not valid YAML: this line is indented with a tab"),
    ],
)
def test_a_file_that_does_not_load_is_rejected(tmp_path: Path, vehicle: Path, old: str, new: str, message: str) -> None:
    path = vehicle / "control.yaml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(ConfigError) as caught:
        plan_apply(read_result(_result(tmp_path, vehicle)), today=DAY)
    assert message in str(caught.value)
    assert path.read_text() == text.replace(old, new)


def test_gains_of_a_pid_are_not_written_to_a_servo(tmp_path: Path, vehicle: Path) -> None:
    path = vehicle / "control.yaml"
    text = path.read_text().replace("kind: pid", "kind: servo\n  gain: 3")
    path.write_text("\n".join(line for line in text.split("\n") if not line.startswith(("  kp: 1.38", "  ki: 1.38"))))
    loop = result_data("x")["loop"] | {"settings": {}}
    with pytest.raises(ConfigError, match=r"control.yaml:11: wheel_speed.kind: is servo, which has no kp; the study"):
        plan_apply(read_result(_result(tmp_path, vehicle, loop=loop)), today=DAY)


def test_a_file_that_changes_before_it_is_written_is_left_unchanged(tmp_path: Path, vehicle: Path) -> None:
    change = plan_apply(read_result(_result(tmp_path, vehicle)), today=DAY)
    path = vehicle / "control.yaml"
    path.write_text(change.before + "# by someone else\n")
    with pytest.raises(RunError, match="has changed in the meantime; run it again"):
        change.write()
    assert path.read_text().endswith("# by someone else\n")


def test_the_file_keeps_its_mode_and_its_line_ends(tmp_path: Path, vehicle: Path) -> None:
    path = vehicle / "control.yaml"
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    path.chmod(0o640)
    plan_apply(read_result(_result(tmp_path, vehicle)), today=DAY).write()
    after = path.read_bytes()
    assert after.count(b"\r\n") == after.count(b"\n")
    assert path.stat().st_mode & 0o777 == 0o640
    assert [path.name for path in vehicle.glob("*.tmp")] == []


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda path: None, "no such folder; give the folder that mirdrake tune has written"),
        (lambda path: path.mkdir(), "not a tuning result (it has no tuning.json); is the study finished?"),
        (
            lambda path: (path.mkdir(), (path / "tuning.json").write_text("{\n 'a'")),
            "tuning.json:2: not valid JSON: Expecting property name enclosed in double quotes; run the study again",
        ),
        (
            lambda path: (path.mkdir(), (path / "tuning.json").write_text('{"mirdrake": "tuning-result/1"}')),
            "tuning.json: name: is missing; run the study again",
        ),
    ],
)
def test_a_folder_without_a_result_is_rejected(tmp_path: Path, make: Any, message: str) -> None:
    make(tmp_path / "result")
    with pytest.raises(ConfigError) as caught:
        read_result(tmp_path / "result")
    assert message in str(caught.value)


@pytest.mark.parametrize("value", [3, "text", [1], {"a": [2]}], ids=repr)
@pytest.mark.parametrize("key", ["loop", "candidates", "schedule", "robustness", "acceptance", "step_effect"])
def test_a_damaged_value_gives_one_line_with_the_key(tmp_path: Path, key: str, value: Any) -> None:
    (tmp_path / "tuning.json").write_text(json.dumps(result_data("unior") | {key: value}))
    with pytest.raises(ConfigError) as caught:
        read_result(tmp_path)
    assert f"tuning.json: {key}" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("value", [3, [1], {"a": [2]}], ids=repr)
@pytest.mark.parametrize("key", ["name", "baseline", "best"])
def test_a_name_that_is_not_text_gives_one_line_with_the_key(tmp_path: Path, key: str, value: Any) -> None:
    (tmp_path / "tuning.json").write_text(json.dumps(result_data("unior") | {key: value}))
    with pytest.raises(ConfigError) as caught:
        read_result(tmp_path)
    assert f"tuning.json: {key}" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_failures_of_the_monte_carlo_and_unmet_criteria_are_reported(
    tmp_path: Path, vehicle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rate = {"runs": 40, "failures": 3, "rate": 0.075, "low": 0.01, "high": 0.2}
    candidates = {"searched": {"failures": rate, "figures": {}, "on_plant": 30}}
    spread = {"runs": 40, "seed": 0, "ranges": {}, "candidates": candidates}
    unmet = [{"name": "constraint", "figure": "ms", "value": 1.7, "limit": 1.6, "met": False}]
    text = _run(capsys, _result(tmp_path, vehicle, robustness=spread, acceptance=unmet), "--dry-run")
    assert "note: criteria that are not met: Ms\n" in text
    assert "note: 'searched' failed in 3 of 40 runs of the Monte Carlo.\n" in text


def test_a_written_result_is_read_back_equal(tmp_path: Path) -> None:
    written = write_sample(tmp_path / "result", runs=4, trials=30, cells=(3, 3))
    again = read_result(tmp_path / "result")
    assert again == written
    assert (tmp_path / "result" / "tuning.json").read_text() == result_text(again)
    for name in TABLES:
        first, second = written.table(name), again.table(name)
        assert first is not None
        assert second is not None
        assert first.reset_index(drop=True).equals(second)
