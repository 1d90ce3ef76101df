"""The wheel contains the models and worlds, is small, and works outside the checkout."""

import os
import re
import subprocess
import sys
import sysconfig
import threading
import tomllib
import venv
import zipfile
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from importlib.util import find_spec
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parent.parent

pytestmark = pytest.mark.skipif(find_spec("hatchling") is None, reason="needs the Python package hatchling")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (file,) = folder.glob("*.whl")
    return file


@pytest.fixture(scope="module")
def contents(wheel: Path) -> set[str]:
    return set(zipfile.ZipFile(wheel).namelist())


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """bin/ of a fresh virtual environment with the wheel; the packages it depends on are those of this one."""
    folder = tmp_path_factory.mktemp("fresh")
    venv.create(folder, symlinks=True)
    (site,) = folder.glob("lib/python*/site-packages")
    here = dict.fromkeys((sysconfig.get_path("purelib"), sysconfig.get_path("platlib")))
    (site / "dependencies.pth").write_text("\n".join(here) + "\n")  # .pth files there are not read: no checkout
    python = folder / "bin" / "python"
    # By a URL, as from a page of releases.
    serve = partial(SimpleHTTPRequestHandler, directory=str(wheel.parent))
    with ThreadingHTTPServer(("127.0.0.1", 0), serve) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        url = f"mirdrake @ http://127.0.0.1:{server.server_port}/{wheel.name}"
        command = [sys.executable, "-m", "pip", "--python", str(python), "install", "--no-deps", "--no-index", url]
        subprocess.run(command, check=True, capture_output=True)
        server.shutdown()
    return python.parent


def _run(*command: str | Path, cwd: Path) -> str:
    """Return the standard output of a command outside the checkout, which must leave standard error empty."""
    environment = {key: value for key, value in os.environ.items() if key not in {"PYTHONPATH", "MIRDRAKE_PATH"}}
    done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def test_every_data_file_is_in_the_wheel(contents: set[str]) -> None:
    files = [file for kind in ("models", "worlds", "diagrams") for file in (ROOT / kind).rglob("*") if file.is_file()]
    expected = {str(file.relative_to(ROOT)) for file in files if "__pycache__" not in file.parts}
    assert expected - {name.removeprefix("mirdrake/share/") for name in contents} == set()
    assert "mirdrake/share/models/bolt/vehicle.yaml" in contents
    assert "mirdrake/share/worlds/test_track.yaml" in contents
    assert "mirdrake/share/diagrams/bolt_test_track.yaml" in contents


def test_the_modules_and_templates_are_in_the_wheel(contents: set[str]) -> None:
    expected = {str(file.relative_to(ROOT)) for file in (ROOT / "mirdrake").rglob("*") if file.is_file()}
    assert {name for name in expected if "__pycache__" not in name} - contents == set()


def test_the_wheel_contains_no_other_files(contents: set[str]) -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert {name.split("/")[0] for name in contents} == {"mirdrake", f"mirdrake-{version}.dist-info"}
    odd = [
        name for name in contents if "/tests/" in name or "__pycache__" in name or "/." in name or name.endswith("~")
    ]
    assert odd == []


def test_the_wheel_is_smaller_than_ten_megabytes(wheel: Path) -> None:
    assert wheel.stat().st_size < 10e6


@pytest.mark.essential
def test_the_installed_command_lists_what_is_shipped(installed: Path, tmp_path: Path) -> None:
    listed = _run(installed / "mirdrake", "list", cwd=tmp_path)
    assert all(name in listed for name in ("bolt", "test_track", "bolt_test_track"))


def test_the_installed_package_loads_its_own_vehicle_and_world(installed: Path, tmp_path: Path) -> None:
    code = (
        "import mirdrake as mir\n"
        "print(mir.__file__)\n"
        "print(mir.load_vehicle('bolt').folder)\n"
        "print(mir.load_world('test_track').path)\n"
    )
    lines = _run(installed / "python", "-W", "error", "-c", code, cwd=tmp_path).splitlines()
    assert len(lines) == 3
    assert all(Path(line).is_relative_to(installed.parent) for line in lines)


def test_the_conda_recipe_has_the_version_and_the_dependencies_of_the_project() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    recipe = yaml.safe_load((ROOT / "recipe" / "recipe.yaml").read_text())
    assert recipe["context"]["version"] == project["version"]
    least = recipe["context"]["python_min"]
    assert project["requires-python"] == f">={least}"
    assert "python >=${{ python_min }}" in recipe["requirements"]["run"]
    # Names of conda-forge that differ from those of PyPI.
    renamed = {"matplotlib-base": "matplotlib", "msgpack-python": "msgpack"}
    wanted = {re.split("[<>=;]", text)[0].strip() for text in project["dependencies"]}
    given = {text.split()[0] for text in recipe["requirements"]["run"]} - {"python", "graphviz"}
    assert {renamed.get(name, name) for name in given} == wanted
