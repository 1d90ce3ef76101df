"""A run folder contains its scene; readers of a run use it instead of the current models/ and worlds/."""

import json
import math
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from mirdrake.assembly.diagram_spec import make_spec
from mirdrake.assembly.scene import FOLDER, make_scene, read_scene, write_scene
from mirdrake.cli import main
from mirdrake.core.errors import RunError
from mirdrake.core.paths import data_root, names
from mirdrake.export.frames import Frames, sensor_mounts
from mirdrake.report.run_report import render_report
from mirdrake.report.vehicle_charts import make_charts
from mirdrake.runs.logs import Run, load_run
from mirdrake.runs.simulation import simulate
from mirdrake.vehicles import load_vehicle
from mirdrake.vehicles.stored import read_vehicle, vehicle_data
from mirdrake.viewer.recording import views_of, write_recording
from mirdrake.workflow import run_diagram
from mirdrake.worlds import load_world
from mirdrake.worlds.lock import lock_text
from mirdrake.worlds.stored import read_world, world_data

WORLD = """\
mirdrake: world/1
tracks: {main: {width: 4, segments: [{line: 60}]}}
start: {line: {on_track: {track: main, s: 10}}}
props:
  - {prop: cone, at: [30, 4]}
  - {box: [1, 2, 1], at: [40, -5], name: crate, static: false, mass: 40}
"""
RECORD = {"meshcat": False, "report": False, "cameras": False}


def copy_vehicle(name: str, folder: Path, **changes: Any) -> Path:
    """Return a copy of a shipped vehicle under another name, with some text of its main file replaced."""
    shutil.copytree(data_root() / "models" / name, folder)
    for old, new in changes.items():
        for path in folder.glob("*.xacro"):
            text = path.read_text(encoding="utf-8")
            path.write_text(re.sub(old, new, text), encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project: an Unior called bolt, a CAT Vehicle with other mounts, a world; one run of both, moved elsewhere."""
    project = tmp_path_factory.mktemp("project")
    copy_vehicle("unior", project / "models" / "bolt")
    copy_vehicle("catvehicle", project / "models" / "cat")
    (project / "yard.yaml").write_text(WORLD, encoding="utf-8")
    spec = {
        "world": str(project / "yard.yaml"),
        "vehicles": {
            "small": {"model": str(project / "models" / "bolt")},
            "large": {
                "model": str(project / "models" / "cat"),
                "start": {"x": 0.0, "y": 20.0},
                "arguments": {"drive": "front"},
                "mounts": {"left_camera": {"width": 320, "height": 240, "horizontal_fov": 0.5}, "gps": {"rate": 5}},
            },
        },
        "control": {name: {"kind": "constant", "speed": 2.0} for name in ("small", "large")},
        "sensors": {"large": ["gps", "imu", "left_camera"]},
        "plant": {"contact": "point"},
        "record": RECORD,
        "duration": 0.4,
    }
    simulate(spec, folder=project / "run")
    (project / "run").rename(project / "moved")
    # All that the run was made from is gone, but the meshes.
    for path in [*project.glob("models/*/*"), project / "yard.yaml"]:
        if path.is_file():
            path.unlink()
    return project


@pytest.fixture
def run(project: Path) -> Run:
    return load_run(project / "moved")


# --- the files --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(names("worlds")))
def test_a_world_that_is_stored_is_read_to_the_last_bit(name: str) -> None:
    world = load_world(name)
    data = world_data(world, str)
    read = read_world(json.loads(json.dumps(data)), Path)
    assert json.dumps(world_data(read, str)) == json.dumps(data)
    assert lock_text(read) == lock_text(world)
    assert read.spec.lights == world.spec.lights
    for key, track in world.tracks.items():
        s = np.linspace(0.0, track.length, 50)
        np.testing.assert_array_equal(read.tracks[key].pose(s), track.pose(s))


@pytest.mark.parametrize("name", ["bolt@handling", "catvehicle@explorer", "mkz", "unior@printed_steering"])
def test_a_vehicle_that_is_stored_is_read_as_it_was(name: str) -> None:
    vehicle = load_vehicle(name)
    data = json.loads(json.dumps(vehicle_data(vehicle)))
    read = read_vehicle(data, urdf=vehicle.urdf, packages=vehicle.packages)
    for key in ("name", "folder", "spec", "control", "sensors", "urdf", "geometry", "packages", "spring_loads"):
        assert getattr(read, key) == getattr(vehicle, key), key


def test_a_run_carries_its_scene_and_the_lock_of_its_world(run: Run, project: Path) -> None:
    folder = project / "moved" / FOLDER
    assert {path.name for path in folder.iterdir()} == {"scene.json", "world.lock", "small.urdf", "large.urdf"}
    scene = run.scene()
    assert scene is run.scene()
    assert lock_text(scene.world) == (folder / "world.lock").read_text(encoding="utf-8")
    assert scene.vehicles["large"].spec.drive == "front"
    assert scene.vehicles["small"].geometry == load_vehicle("unior").geometry
    assert scene.changes == ()


# --- what reads a run -------------------------------------------------------------------------------------------------


def test_a_run_is_checked_without_its_models(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(project / "moved")]) == 0
    out, err = capsys.readouterr()
    assert (out.splitlines()[0], err) == (f"{project / 'moved'}: sound", "")


@pytest.fixture
def closed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Forbid the search for files by name and the rendering of xacro."""

    def fail(*arguments: Any, **_: Any) -> Any:
        raise AssertionError(f"read again: {arguments}")

    for name in (
        "mirdrake.vehicles.vehicle.find_vehicle",
        "mirdrake.vehicles.vehicle.render_xacro",
        "mirdrake.worlds.loading.find",
        "mirdrake.worlds.loading._lay_out",
        "mirdrake.worlds.props.load_yaml",
        "mirdrake.vehicles.presets.load_yaml",
    ):
        monkeypatch.setattr(name, fail)


@pytest.mark.usefixtures("closed")
def test_readers_of_a_run_open_no_model_and_no_world(project: Path, tmp_path: Path) -> None:
    shutil.copytree(project / "moved", tmp_path / "copy")
    run = load_run(tmp_path / "copy")
    name = run.summary["diagram"]
    assert f"<title>{name} · recording</title>" in write_recording(run).read_text(encoding="utf-8")
    assert "Grey: the road" in render_report(run)
    assert main(["replay", str(tmp_path / "copy"), "--out", str(tmp_path / "replay.html")]) == 0
    assert main(["view", str(tmp_path / "copy"), "--out", str(tmp_path / "view.html")]) == 0
    assert main(["export", str(tmp_path / "copy"), "--to", "csv"]) == 0
    pytest.importorskip("mcap.writer")
    assert main(["export", str(tmp_path / "copy"), "--to", "mcap"]) == 0
    assert views_of(run)


def test_mounts_are_those_of_the_run(run: Run) -> None:
    mounts = sensor_mounts(run)
    assert set(mounts) == {"large.gps", "large.imu", "large.left_camera"}
    camera = mounts["large.left_camera"]
    assert (camera.width, camera.height, camera.horizontal_fov) == (320, 240, 0.5)
    assert mounts["large.gps"].rate == 5.0
    frames = {child: pose for _, child, pose in Frames(run).sensors()}
    assert set(frames) >= {"large.left_camera", "large.left_camera.optical", "large.gps"}


def test_a_report_has_the_dimensions_of_the_vehicle_that_was_driven(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    observed: dict[str, float] = {}
    make = make_charts

    def spy(signals: Any, *arguments: Any, **options: Any) -> Any:
        observed[signals.name] = options["geometry"].get("wheelbase", math.nan)
        return make(signals, *arguments, **options)

    monkeypatch.setattr("mirdrake.report.run_report.make_charts", spy)
    page = render_report(run)
    assert observed == {
        name: pytest.approx(load_vehicle(model).geometry.wheelbase)
        for name, model in (("small", "unior"), ("large", "catvehicle"))
    }
    assert "Grey: the road" in page


def test_a_run_in_memory_has_its_scene_too() -> None:
    spec = {"world": "empty", "vehicles": {"ego": {"model": "unior"}}, "control": {"ego": {"kind": "constant"}}}
    run = simulate(spec | {"plant": {"contact": "point"}}, duration=0.1)
    assert run.scene().vehicles["ego"].name == "unior"


# --- what has changed since -------------------------------------------------------------------------------------------


def test_a_mesh_that_changed_and_one_that_is_gone_are_reported(
    project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = make_scene(make_spec({"world": "barrels", "vehicles": {"ego": {"model": "bolt"}}}))
    (tmp_path / "run").mkdir()
    write_scene(scene, tmp_path / "run")
    assert read_scene(tmp_path / "run").changes == ()

    own = copy_vehicle("unior", tmp_path / "models" / "own")
    spec = {"world": "empty", "vehicles": {"ego": {"model": str(own)}}, "control": {"ego": {"kind": "constant"}}}
    simulate(spec | {"plant": {"contact": "point"}, "record": RECORD}, duration=0.1, folder=tmp_path / "other")
    with (own / "meshes" / "wheel.bin").open("r+b") as file:
        file.write(b"\0\0\0\0")
    (own / "meshes" / "body.gltf").unlink()
    capsys.readouterr()
    assert main(["replay", str(tmp_path / "other"), "--out", str(tmp_path / "page.html")]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert [line for line in lines if "wheel.bin: has changed since the run" in line]
    assert [line for line in lines if "body.gltf: is missing" in line]
    page = render_report(load_run(tmp_path / "other"))
    assert "wheel.bin: has changed since the run" in page


@pytest.mark.parametrize(
    ("damage", "text"),
    [
        ("{", "damaged"),
        ("{}", "damaged"),
        ('{"mirdrake": "scene/9"}', "scene/9"),
        ('{"mirdrake": "scene/1", "meshes": {}, "world": 3, "vehicles": {}}', "damaged"),
        ('{"mirdrake": "scene/1", "meshes": {}, "world": {"kinds": [{}]}, "vehicles": {}}', "damaged"),
        (None, "carries no scene"),
    ],
)
def test_a_damaged_scene_is_one_line(project: Path, tmp_path: Path, damage: str | None, text: str) -> None:
    shutil.copytree(project / "moved", tmp_path / "run")
    file = tmp_path / "run" / FOLDER / "scene.json"
    file.unlink() if damage is None else file.write_text(damage, encoding="utf-8")
    with pytest.raises(RunError, match=text) as error:
        load_run(tmp_path / "run").scene()
    assert "\n" not in str(error.value)


def test_a_scene_is_made_once_in_a_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from mirdrake.vehicles import vehicle
    from mirdrake.worlds import loading

    calls: list[str] = []
    for module, name in ((vehicle, "render_xacro"), (loading, "_lay_out")):
        function = getattr(module, name)

        def count(*arguments: Any, _name: str = name, _function: Any = function, **options: Any) -> Any:
            calls.append(_name)
            return _function(*arguments, **options)

        monkeypatch.setattr(module, name, count)
    spec = {"world": "test_track", "vehicles": {"ego": {"model": "unior"}}, "control": {"ego": {"kind": "constant"}}}
    run_diagram(spec | {"plant": {"contact": "point"}}, duration=0.2, folder=tmp_path / "run")
    assert sorted(calls) == ["_lay_out", "render_xacro"]


def test_units_are_an_attribute_of_the_signals(run: Run) -> None:
    assert run.signals.attrs["units"] == run.units
    assert run.signals.attrs["units"]["large.vx"] == "m/s"
    assert yaml.safe_load((run.folder or Path()).joinpath("spec.yaml").read_text())["vehicles"]["large"]["mounts"]
