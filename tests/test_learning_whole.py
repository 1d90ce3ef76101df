"""Cloning end to end through the command: stopped and continued, its report, and networks that drive (slow)."""

import json
from pathlib import Path

import pytest

from mirdrake.cli import main
from mirdrake.learning.result import read_result

NO_TORCH = "needs PyTorch, which is not part of the development extras: pip install 'mirdrake[learning]'"
pytest.importorskip("torch", reason=NO_TORCH)
pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")

WORLD = """\
mirdrake: world/1
ground: {surface: grass, mu: 0.5}
tracks:
  main:
    random: {length: 120, corners: 4, min_radius: 8, max_radius: 12, irregularity: 0.2}
    markings: [{line: left, width: 0.1}, {line: right, width: 0.1}]
start: {line: {on_track: {track: main, s: 0}}}
"""

STUDY = """\
mirdrake: learning/1
diagram:
  world: ring.yaml
  vehicles: {ego: {model: bolt, mounts: {front_camera: {width: 200, height: 112}}}}
  control: {ego: {kind: path_tracking, speed: 5}}
  plant: {contact: point, time_step: 20 ms}
  duration: 30 s
picture: {crop: {top: 50}, size: [64, 62]}
collect: {runs: 2, rate: 10, errors: 0.1 rad}
train: {epochs: 2, validation: 0.2, gap: 5}
drive: {laps: 1}
rounds: 1
"""


@pytest.fixture(autouse=True)
def _inductor_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Set what PyTorch would set in the environment."""
    monkeypatch.setenv("TORCHINDUCTOR_CACHE_DIR", str(tmp_path))


@pytest.mark.slow
def test_a_study_that_is_stopped_continues_and_gives_the_same_weights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import mirdrake.learning.clone as module

    monkeypatch.chdir(tmp_path)
    (tmp_path / "ring.yaml").write_text(WORLD, encoding="utf-8")
    (tmp_path / "study.yaml").write_text(STUDY, encoding="utf-8")

    # Stopped in the first training, as by Ctrl-C.
    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(module, "train", stop)
        assert main(["learn", "clone", "study.yaml", "--out", "first"]) == 130
    assert "first: stopped; run it again to continue" in capsys.readouterr().err
    before = (tmp_path / "first" / "journal.jsonl").read_text(encoding="utf-8")
    assert [json.loads(line).get("key") for line in before.splitlines()][1:] == [
        "delay", "delayed-expert", "expert-ring-1", "expert-ring-2",
    ]  # fmt: skip

    # Continued: the finished steps are kept, the result has two rounds, a report and networks.
    assert main(["learn", "clone", "study.yaml", "--out", "first", "--quiet"]) in {0, 1}
    after = (tmp_path / "first" / "journal.jsonl").read_text(encoding="utf-8")
    assert after.startswith(before)
    result = read_result(tmp_path / "first")
    assert [one.number for one in result.rounds] == [0, 1]
    assert result.rounds[1].pictures > result.rounds[0].pictures
    assert (tmp_path / "first" / result.last.file).is_file()
    page = (tmp_path / "first" / "learning.html").read_text(encoding="utf-8")
    assert "Largest differences of network and expert" in page
    assert "additional delay" in page

    # A finished study is read, and another study in its folder is rejected.
    assert main(["learn", "clone", "study.yaml", "--out", "first", "--quiet"]) in {0, 1}
    assert main(["learn", "clone", "study.yaml", "--out", "first", "--quiet", "--set", "seed=1"]) == 2
    assert "was begun for another purpose (study)" in capsys.readouterr().err

    # The same seed gives the same weights.
    assert main(["learn", "clone", "study.yaml", "--out", "second", "--quiet", "--set", "rounds=0"]) in {0, 1}
    assert read_result(tmp_path / "second").rounds[0].sha256 == result.rounds[0].sha256


@pytest.mark.slow
def test_from_nothing_to_three_laps_of_the_test_track_within_30_minutes_of_processor_time(tmp_path: Path) -> None:
    assert main(["learn", "clone", "clone_bolt", "--out", str(tmp_path / "clone"), "--quiet"]) == 0
    result = read_result(tmp_path / "clone")
    figures = next(iter(result.last.drives.values())).figures
    assert figures.laps >= 3.0 - 1e-3
    assert figures.interventions == 0
    assert figures.off_road == 0.0
    assert figures.rms <= 0.10
    assert figures.largest <= 0.35
    assert result.processor_s <= 30 * 60.0


@pytest.mark.slow
def test_a_network_of_random_tracks_drives_two_unseen_ones(tmp_path: Path) -> None:
    learnt = [{"name": "random_track", "seed": seed} for seed in range(1, 5)]
    judged = [{"name": "random_track", "seed": seed} for seed in (11, 12)]
    changes = [f"worlds={json.dumps(learnt)}", f"drive={json.dumps({'laps': 1, 'worlds': judged})}"]
    options = [text for change in changes for text in ("--set", change)]
    main(["learn", "clone", "clone_bolt", "--out", str(tmp_path / "clone"), "--quiet", *options])
    drives = read_result(tmp_path / "clone").last.drives
    assert len(drives) == 2
    assert min(drive.figures.autonomy for drive in drives.values()) >= 0.98
    assert all(drive.figures.finished for drive in drives.values())


@pytest.mark.slow
def test_at_8_m_s_four_of_five_seeds_finish_a_lap(tmp_path: Path) -> None:
    finished = 0
    for seed in range(5):
        changes = ["overrides.control.ego.speed=8", "drive.laps=1", f"seed={seed}"]
        options = [text for change in changes for text in ("--set", change)]
        folder = tmp_path / f"seed-{seed}"
        finished += main(["learn", "clone", "clone_bolt", "--out", str(folder), "--quiet", *options]) == 0
    assert finished >= 4
