"""`mirdrake world build`: three files and meshes, or a one-line error and no file."""

import argparse
from pathlib import Path

import pytest
import yaml

from mirdrake.cli import world_build
from mirdrake.core.errors import MirdrakeError, RunError
from mirdrake.world_files import build_world, file_name
from mirdrake.worlds import load_world, make_world
from mirdrake.worlds.lock import lock_hash

YARD = """\
mirdrake: world/1
name: yard
params: {mu: 0.6, crates: 2}
ground: {patches: [{name: wet, disc: {radius: 2}, mu: $mu}]}
props:
  - {prop: cone, at: [5, 5], static: false}
  - {box: [1, 1, 1], name: crate, line: {from: [0, -3], to: [9, -3], count: $crates}}
  - {box: [1, 1, 1], name: late, at: [0.5, -3]}
"""


@pytest.fixture
def yard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "yard.yaml").write_text(YARD, encoding="utf-8")
    return tmp_path


def _run(*arguments: str) -> int:
    parser = argparse.ArgumentParser()
    world_build.add_arguments(parser)
    return world_build.run(parser.parse_args(arguments))


def _files(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def test_all_files_are_written_and_printed(yard: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert _run("yard.yaml", "--set", "seed=3", "-p", "mu=0.3", "-p", "crates=4") == 0
    folder = yard / "worlds-out" / "yard"
    lock = yaml.safe_load((folder / "yard.lock.yaml").read_text(encoding="utf-8"))
    assert (lock["seed"], lock["params"], lock["patches"][0]["mu"]) == (3, {"mu": 0.3, "crates": 4}, 0.3)
    assert capsys.readouterr().out.splitlines() == [
        "worlds-out/yard/",
        f"  yard.lock.yaml  6 props, seed 3, hash {lock['hash'][:12]}",
        "  yard.sdf        for Gazebo and Drake, with 6 files in meshes/",
        "  yard.svg        plan from above",
        "left out of the SDF world: friction 0.3 of patch 'wet'",
        "overlap: crate[0] and late, 0.5 m²",
    ]
    assert _files(folder) >= {"yard.lock.yaml", "yard.sdf", "yard.svg", "meshes/cone/cone.obj"}
    assert "crate[0] and late overlap" in (folder / "yard.svg").read_text(encoding="utf-8")


def test_a_second_build_writes_the_same_bytes(yard: Path) -> None:
    first = build_world(load_world("yard.yaml"), "one")
    second = build_world(load_world("yard.yaml"), yard / "two" / "deep")
    assert first.hash == second.hash == lock_hash(load_world("yard.yaml"))
    for a in first.folder.rglob("*"):
        b = second.folder / a.relative_to(first.folder)
        assert a.is_dir() or a.read_bytes() == b.read_bytes()
    before = _files(first.folder)
    build_world(load_world("yard.yaml"), "one")
    assert _files(first.folder) == before


def test_unplaced_props_are_reported_and_make_the_exit_code_1(yard: Path, capsys: pytest.CaptureFixture[str]) -> None:
    crowd = (
        YARD + "  - {box: [3, 3, 3], name: crowd, scatter: {region: {disc: {center: [30, 0], radius: 4}}, count: 9}}\n"
    )
    (yard / "yard.yaml").write_text(crowd, encoding="utf-8")
    assert _run("yard.yaml") == 1
    captured = capsys.readouterr()
    assert captured.err.startswith("error: yard.yaml:9: props.3: no free position for 'crowd[")
    assert captured.err.count("\n") == 1
    assert (yard / "worlds-out" / "yard" / "yard.svg").is_file()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["yrd.yaml"], "^no world at 'yrd.yaml'"),
        (["yard.yaml", "-p", "crate=1"], "^-p crate=1: the world has no parameter 'crate'; did you mean 'crates'"),
        (["yard.yaml", "-p", "mu"], "^-p mu: expected NAME=VALUE"),
        (["yard.yaml", "-p", "=3"], "^-p =3: expected NAME=VALUE"),
        (["yard.yaml", "-p", "mu=wide"], "mu"),
        (["yard.yaml", "--set", "sed=3"], "sed: unknown field; did you mean 'seed'"),
        (["yard.yaml", "-o", "yard.yaml"], "^yard.yaml: cannot be written: .*; choose another folder$"),
        (["yard.yaml", "-o", "yard.yaml/out"], "^yard.yaml/out: cannot be written: Not a directory"),
        (["yard.yaml", "-o", "/proc/nowhere/out"], "^/proc/nowhere/out: cannot be written: "),
        (["empty", "-p", "mu=3"], "the world has no parameter 'mu'; it has none"),
    ],
)
def test_bad_input_is_a_one_line_error_and_writes_no_file(yard: Path, arguments: list[str], message: str) -> None:
    with pytest.raises(MirdrakeError, match=message) as caught:
        _run(*arguments)
    assert "\n" not in str(caught.value)
    assert _files(yard) == {"yard.yaml"}


def test_a_folder_in_the_way_leaves_all_else_as_it_was(yard: Path) -> None:
    (yard / "out" / "yard.svg").mkdir(parents=True)
    (yard / "out" / "yard.sdf").write_text("mine", encoding="utf-8")
    with pytest.raises(RunError, match=r"^out: cannot be written: yard\.svg is a folder; "):
        _run("yard.yaml", "-o", "out")
    assert _files(yard / "out") == {"yard.svg", "yard.sdf"}
    assert (yard / "out" / "yard.sdf").read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize("existing", [True, False])
def test_a_full_disk_leaves_no_half_files(yard: Path, monkeypatch: pytest.MonkeyPatch, existing: bool) -> None:
    world, write = load_world("yard.yaml"), Path.write_bytes

    def fill(path: Path, content: bytes) -> int:
        if path.suffix == ".svg":
            write(path, content[:10])
            raise OSError(28, "No space left on device")
        return write(path, content)

    if existing:
        (yard / "out").mkdir()
    monkeypatch.setattr(Path, "write_bytes", fill)
    with pytest.raises(RunError, match=r"^out: cannot be written: No space left on device; "):
        build_world(world, yard / "out")
    assert _files(yard) == {"yard.yaml", *(["out"] if existing else [])}


def test_invalid_file_names_are_replaced(tmp_path: Path) -> None:
    assert file_name("../my world/ü:1") == "my_world_ü_1"
    assert file_name("..") == file_name("") == "world"
    build = build_world(make_world({"mirdrake": "world/1", "name": "../a b"}), tmp_path)
    assert build.lock == tmp_path / "a_b.lock.yaml"
    assert build.lock.is_file()
