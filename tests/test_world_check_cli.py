"""``mirdrake world check`` and ``mirdrake world show``, and ``mirdrake check`` of a world."""

import argparse
from collections.abc import Callable
from pathlib import Path

import pytest

from mirdrake import cli
from mirdrake.cli import world_check, world_show
from mirdrake.viewer.world_view import LAYERS, show_examination
from mirdrake.world_checks import examine

Call = Callable[..., tuple[int, str, list[str]]]

WORLD = """\
mirdrake: world/1
params: {x: 1.5}
start: {gate: {at: [-8, 0]}}
goals: {exit: {at: [8, 3], radius: 1}}
props:
  - {box: [1, 1, 1], name: a, at: [0, 0]}
  - {box: [1, 1, 1], name: b, at: [$x, 0]}
  - {prop: cone, at: [4, -4]}
rules:
  - {drivable: {from: gate, to: exit}}
"""


@pytest.fixture
def call(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Call:
    """A function (verb module, arguments) -> exit code, stdout, lines of stderr; in a folder with w.yaml."""
    monkeypatch.chdir(tmp_path)
    Path("w.yaml").write_text(WORLD, encoding="utf-8")

    def run(verb, *arguments: str) -> tuple[int, str, list[str]]:
        parser = argparse.ArgumentParser()
        verb.add_arguments(parser)
        code = verb.run(parser.parse_args(arguments))
        out, err = capsys.readouterr()
        return code, out, err.splitlines()

    return run


def test_a_world_without_faults_is_reported_with_its_paths(call: Call) -> None:
    code, out, err = call(world_check, "w.yaml", "empty")
    assert (code, err) == (0, [])
    lines = out.splitlines()
    assert lines[0] == "w.yaml: sound, 3 props"
    assert lines[1].startswith("  bolt has a path of 1")
    assert lines[2] == "empty: sound"


def test_all_faults_of_all_files_are_reported_and_the_exit_code_is_2(call: Call) -> None:
    Path("v.yaml").write_text(WORLD.replace("prop: cone", "prop: cne"), encoding="utf-8")
    code, out, err = call(world_check, "v.yaml", "w.yaml", "nothing", "-p", "x=0.9")
    assert (code, out) == (2, "")
    assert [line.split(": ")[1] for line in err[:2]] == ["v.yaml:8", "w.yaml:6"]
    assert "'a' overlaps 'b'" in err[1]
    assert "nothing" in err[2]
    assert len(err) == 3


def test_overrides_and_a_vehicle_reach_the_check(call: Call) -> None:
    assert call(world_check, "w.yaml", "--set", "params.x=0.9")[0] == 2
    assert call(world_check, "w.yaml", "-p", "x=2", "-p", "seed=3")[0] == 0
    code, _, err = call(world_check, "w.yaml", "--vehicle", "blt")
    assert code == 2
    assert "--vehicle: unknown vehicle 'blt'; did you mean 'bolt'?" in err[0]
    code, _, err = call(world_check, "w.yaml", "--set", "start.gate.at=[-3, 0]", "--vehicle", "mkz")
    assert [line.partition(" at 'gate' overlaps 'a'")[0].rpartition(": ")[2] for line in err] == ["bolt", "mkz"]


def test_check_without_world_finds_the_same(call: Call, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["check", "w.yaml"]) == 0
    assert capsys.readouterr().out == "w.yaml: sound\n"
    assert cli.main(["check", "w.yaml", "--set", "params.x=0.9"]) == 2
    assert "'a' overlaps 'b'" in capsys.readouterr().err


def test_show_writes_a_page_and_reports_the_faults(call: Call) -> None:
    code, out, err = call(world_show, "w.yaml", "-p", "x=0.9", "--save", "w.html")
    assert (code, out) == (0, "w.html\n")
    assert len(err) == 1
    assert Path("w.html").stat().st_size > 100_000
    assert call(world_show, "nothing", "--save", "n.html")[0] == 2
    assert not Path("n.html").exists()


def test_the_view_has_all_layers_and_buttons_toggle_them(call: Call) -> None:
    meshcat, view = show_examination(examine("w.yaml", overrides=["params.x=0.9"]), port=0)
    for path in ("names/a", "collision", "faults/0 a b/needle", "starts/gate/head", "goals/exit", "visualizer"):
        assert meshcat.HasPath(f"/drake/{path}"), path
    assert meshcat.HasPath("/drake/paths/0 bolt gate exit")
    assert view.shown == {"Names": True, "Collision shapes": False, "Faults": True, "Paths": True}
    assert set(LAYERS) == set(view.shown)
    assert not view.follow()
    meshcat._InjectWebsocketMessage(message=_click("Collision shapes"))
    assert view.follow()
    assert view.shown["Collision shapes"]
    view.run(timeout=0.0)


def test_people_have_a_symbol_of_a_least_size_and_actors_are_at_their_starts(call: Call) -> None:
    meshcat, _ = show_examination(examine("pedestrian_crossing"), port=0)
    for path in ("names/walker", "names/walker (symbol)/head", "visualizer/actor/walker"):
        assert meshcat.HasPath(f"/drake/{path}"), path


def _click(name: str) -> bytes:
    """Return the message of a browser for a pressed button: a map of two texts, in MessagePack."""
    words = ("type", "button", "name", name)
    return b"\x82" + b"".join(bytes([0xA0 + len(word)]) + word.encode() for word in words)
