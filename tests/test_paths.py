"""Names of models, worlds and diagrams become files: a path, MIRDRAKE_PATH, the working directory, the shipped data."""

from pathlib import Path

import pytest

from mirdrake.core import paths
from mirdrake.core.errors import ConfigError
from mirdrake.worlds.props import prop_names


def _world(root: Path, name: str) -> Path:
    file = root / "worlds" / f"{name}.yaml"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text("")
    return file


def _model(root: Path, name: str) -> Path:
    folder = root / "models" / name
    folder.mkdir(parents=True)
    (folder / "vehicle.yaml").write_text("")
    return folder


def test_the_checkout_holds_the_data_and_no_share_folder() -> None:
    assert (paths.data_root() / "worlds").is_dir()
    package = Path(paths.__file__).parents[1]
    assert not (package / "share").exists() or not (package.parent / "pyproject.toml").exists()


def test_a_name_is_looked_up_in_mirdrake_path_then_the_working_directory_then_the_shipped_data(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second, here, shipped = (tmp_path / name for name in ("first", "second", "here", "shipped"))
    monkeypatch.setenv("MIRDRAKE_PATH", f"{first}::{second}:{tmp_path / 'absent'}")
    monkeypatch.setattr(paths, "data_root", lambda: shipped)
    here.mkdir()
    monkeypatch.chdir(here)
    for root in (shipped, here, second, first):  # from the last place to the first: each new one wins
        file = _world(root, "oval")
        assert paths.find("worlds", "oval") == file


def test_a_tilde_in_mirdrake_path_is_the_home_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("MIRDRAKE_PATH", "~/mine")
    file = _world(tmp_path / "mine", "oval")
    assert paths.find("worlds", "oval") == file
    assert paths.find("worlds", "~/mine/worlds/oval.yaml") == file


def test_a_path_may_replace_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, folder = _world(tmp_path, "oval"), _model(tmp_path, "cart")
    monkeypatch.chdir(tmp_path)
    assert paths.find("worlds", str(file)) == file
    assert paths.find("worlds", "worlds/oval.yaml") == file
    assert paths.find("models", str(folder)) == folder
    assert paths.find("models", "models/cart") == folder


def test_a_stray_file_does_not_hide_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = _world(tmp_path, "oval")
    (tmp_path / "oval").write_text("notes")
    monkeypatch.chdir(tmp_path)
    assert paths.find("worlds", "oval") == file


def test_names_are_sorted_and_a_model_needs_its_vehicle_yaml(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paths, "data_root", lambda: tmp_path)
    monkeypatch.delenv("MIRDRAKE_PATH", raising=False)
    monkeypatch.chdir(tmp_path)
    folders = {name: _model(tmp_path, name) for name in ("cart", "axle")}
    (tmp_path / "models" / "notes").mkdir()
    assert list(paths.names("models").items()) == sorted(folders.items())
    assert paths.names("diagrams") == {}


@pytest.mark.parametrize(
    ("kind", "name", "message"),
    [
        ("worlds", "ovall", "drive.yaml:3: world: unknown world 'ovall'; did you mean 'oval'? (allowed: oval)"),
        ("worlds", "", "drive.yaml:3: world: unknown world ''; allowed: oval"),
        ("worlds", "~nobody-here", "drive.yaml:3: world: unknown world '~nobody-here'; allowed: oval"),
        ("worlds", "a/oval.yaml", "drive.yaml:3: world: no world at 'a/oval.yaml': no such folder 'a'"),
        ("worlds", "oval.yml", "drive.yaml:3: world: no world at 'oval.yml': no such file"),
        (
            "worlds",
            "worlds/ovl.yaml",
            "drive.yaml:3: world: no world at 'worlds/ovl.yaml': no such file; did you mean 'worlds/oval.yaml'?",
        ),
        (
            "worlds",
            "worlds/oval",
            "drive.yaml:3: world: no world at 'worlds/oval': no such file or folder; did you mean 'worlds/oval.yaml'?",
        ),
        (
            "models",
            "models/tapr",
            "drive.yaml:3: world: no vehicle at 'models/tapr': no such folder; did you mean 'models/tapir'?",
        ),
        ("models", "worlds/", "drive.yaml:3: world: no vehicle at 'worlds/'; expected: a folder with a vehicle.yaml"),
        ("diagrams", "lap", "drive.yaml:3: world: unknown diagram 'lap'; nothing is available here"),
    ],
)
def test_the_error_of_an_unknown_name_lists_the_available_ones(
    kind: str, name: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(paths, "data_root", lambda: tmp_path)
    monkeypatch.delenv("MIRDRAKE_PATH", raising=False)
    monkeypatch.chdir(tmp_path)
    _world(tmp_path, "oval")
    _model(tmp_path, "tapir")
    with pytest.raises(ConfigError) as caught:
        paths.find(kind, name, where="drive.yaml:3: world")
    assert str(caught.value) == message


@pytest.mark.parametrize("name", ["a" * 5000, "zero\0byte", "../" * 400, "\N{GRINNING FACE}", "."])
def test_a_name_that_no_file_can_have_is_an_ordinary_mistake(name: str) -> None:
    for kind in ("models", "worlds", "diagrams"):
        with pytest.raises(ConfigError):
            paths.find(kind, name)


def test_hidden_vehicles_worlds_and_props_have_no_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("models/.car.123", "models/props/.cone", "worlds"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "models/.car.123/vehicle.yaml").touch()
    (tmp_path / "models/props/.cone/prop.yaml").touch()
    (tmp_path / "worlds/.half.yaml").touch()
    monkeypatch.setenv("MIRDRAKE_PATH", str(tmp_path))
    for names in (paths.names("models"), paths.names("worlds"), prop_names()):
        assert not any(tmp_path in path.parents for path in names.values())


@pytest.mark.parametrize(("given", "below"), [("", ".cache"), ("relative", ".cache"), ("{tmp}/own", "own")])
def test_the_cache_folder_follows_xdg_cache_home(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: str, below: str
) -> None:
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", given.format(tmp=tmp_path))
    assert paths.cache_folder("convex") == tmp_path / below / "mirdrake" / "convex"
