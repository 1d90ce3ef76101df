"""Files and folders are written completely or not at all; digests are canonical."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from mirdrake.core import paths
from mirdrake.core.digest import digest, digest_data
from mirdrake.core.errors import ConfigError, RunError
from mirdrake.core.files import read_errors, replacing, staging, write_file


def test_a_digest_is_sha_256_of_the_contents_one_after_the_other() -> None:
    assert digest("abc") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"  # FIPS 180-2
    assert digest("a", b"bc") == digest("abc")


def test_equal_data_have_equal_digests() -> None:
    assert digest_data({"a": 1, "b": [0.5, None]}) == digest_data({"b": (0.5, None), "a": 1})
    assert digest_data({"a": 1}) == digest('{"a":1}')


def test_a_file_is_replaced_completely_or_left_as_it_was(tmp_path: Path) -> None:
    file = tmp_path / "file.txt"
    write_file(file, "old")

    def stop() -> None:
        with replacing(file) as temporary:
            temporary.write_text("half")
            raise ValueError("stop")

    with pytest.raises(ValueError, match="stop"):
        stop()
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("file.txt", "old")]
    write_file(file, b"new")
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("file.txt", "new")]
    with pytest.raises(RunError, match="cannot be written: No such file"):
        write_file(tmp_path / "missing" / "file.txt", "")


@pytest.mark.parametrize("error", [KeyError("a"), RecursionError(), OverflowError("large"), UnicodeError("byte")])
def test_a_damaged_file_is_a_one_line_error(error: Exception) -> None:
    with pytest.raises(ConfigError, match=r"^file: damaged, cannot be read: .+$"), read_errors(Path("file")):
        raise error
    with pytest.raises(RuntimeError, match="bug"), read_errors(Path("file")):
        raise RuntimeError("bug")


# --- several files and folders --------------------------------------------------------------------------------------

KILLED = """
import os, signal, sys
from pathlib import Path
from mirdrake.core.files import staging

left, real = int(sys.argv[2]), Path.rename

def rename(self, target):
    global left
    left -= 1
    if left < 0:
        os.kill(os.getpid(), signal.SIGKILL)
    return real(self, target)

Path.rename = rename
with staging(Path(sys.argv[1])) as stage:
    (stage.path / "car").mkdir()
    (stage.path / "car" / "vehicle.yaml").write_text("new")
    (stage.path / "car.yaml").write_text("new")
    if left == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    stage.publish()
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="folders are locked on POSIX only")
@pytest.mark.parametrize("before", [False, True])
def test_a_killed_process_leaves_nothing_that_is_listed_and_the_next_one_clears_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, before: bool
) -> None:
    """Killed before each of its renames: all files are the old ones, or all are the new ones."""
    monkeypatch.setenv("MIRDRAKE_PATH", str(tmp_path))
    folder, steps = tmp_path / "models", 5 if before else 3
    targets = (folder / "car" / "vehicle.yaml", folder / "car.yaml")
    for renames in range(steps + 1):
        for file in targets if before else ():
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text("old")
        done = subprocess.run([sys.executable, "-c", KILLED, str(folder), str(renames)], check=False)
        assert done.returncode == -signal.SIGKILL
        assert [path.name[:10] for path in folder.glob(".*")] == [".mirdrake-"]
        assert not any(name.startswith(".") or name == "new" for name in paths.names("models"))
        with staging(folder):
            pass
        assert list(folder.glob(".*")) == []
        contents = [file.read_text() for file in targets if file.is_file()]
        assert contents == (["new"] * 2 if renames == steps else ["old"] * 2 if before else []), renames


def test_staging_that_goes_on_is_left_alone_and_publishes_everything_or_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "deep" / "models"
    with staging(folder) as first:
        (first.path / "a.yaml").write_text("a")
        with staging(folder) as second:
            assert first.path.is_dir()
            (second.path / "b.yaml").write_text("b")
            second.publish()
        first.publish()
    assert sorted(path.name for path in folder.iterdir()) == ["a.yaml", "b.yaml"]
    real = Path.rename

    def rename(path: Path, target: Path) -> Path:
        if target == folder / "b.yaml" and "new" in path.parts:
            raise OSError("no room")
        return real(path, target)

    with staging(folder) as third, monkeypatch.context() as patch:
        (third.path / "a.yaml").write_text("new")
        (third.path / "b.yaml").write_text("new")
        patch.setattr(Path, "rename", rename)
        with pytest.raises(OSError, match="no room"):
            third.publish()
    assert {path.name: path.read_text() for path in folder.iterdir()} == {"a.yaml": "a", "b.yaml": "b"}


def test_folders_created_for_a_failed_write_are_removed(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="stop"), staging(tmp_path / "a" / "b"):
        raise ValueError("stop")
    assert list(tmp_path.iterdir()) == []


def test_merged_files_keep_what_a_folder_already_holds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    meshes = tmp_path / "meshes"
    meshes.mkdir()
    (meshes / "old.obj").write_text("kept")
    (meshes / "new.obj").write_text("old")

    def publish() -> None:
        with staging(tmp_path) as stage:
            for name in ("meshes/new.obj", "more/deep.obj", "world.yaml"):
                (stage.path / name).parent.mkdir(exist_ok=True)
                (stage.path / name).write_text("new")
            stage.publish(merge=True)

    def content() -> dict[str, str]:
        return {str(path.relative_to(tmp_path)): path.read_text() for path in tmp_path.rglob("*") if path.is_file()}

    real = Path.rename

    def rename(path: Path, target: Path) -> Path:
        if target == tmp_path / "world.yaml":
            raise OSError("no room")
        return real(path, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "rename", rename)
        with pytest.raises(OSError, match="no room"):
            publish()
    assert content() == {"meshes/old.obj": "kept", "meshes/new.obj": "old"}
    assert not (tmp_path / "more").exists()
    publish()
    assert content() == {
        "meshes/old.obj": "kept", "meshes/new.obj": "new", "more/deep.obj": "new", "world.yaml": "new"
    }  # fmt: skip
