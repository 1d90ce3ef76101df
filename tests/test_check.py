"""`mirdrake check VEHICLE`: all faults of a folder at once, each with its place; and `mirdrake view` with layers."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from mirdrake import cli
from mirdrake.core.paths import data_root
from mirdrake.schemas import format_of

Call = Callable[..., tuple[int, str, list[str]]]


@pytest.fixture
def call_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Call:
    """A function (arguments) -> exit code, stdout, lines of stderr of a command beside a copy of the Bolt, car/."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(data_root() / "models" / "bolt", tmp_path / "car")

    def call(*arguments: str) -> tuple[int, str, list[str]]:
        try:
            code = cli.main(arguments)
        except SystemExit as stop:  # argparse
            code = int(stop.code or 0)
        out, err = capsys.readouterr()
        return code, out, err.splitlines()

    return call


def spoil(name: str, old: str, new: str) -> str:
    """Replace a text that occurs once in a file of the car; return its "car/file:line"."""
    path = Path("car", name)
    text = path.read_text(encoding="utf-8")
    assert text.count(old) == 1, f"{old!r} occurs {text.count(old)} times in {name}"
    path.write_text(text.replace(old, new), encoding="utf-8")
    return f"car/{name}:{text[: text.index(old)].count(chr(10)) + 1}"


def places(lines: list[str]) -> list[str]:
    """``file:line`` of each error."""
    return [":".join(line.removeprefix("error: ").split(":")[:2]) for line in lines]


# --- check -----------------------------------------------------------------------------------------------------------


def test_a_valid_folder_passes_by_its_name_and_by_one_of_its_files(call_command: Call) -> None:
    for name in ("car/", "car/vehicle.yaml", "car@published"):
        assert call_command("check", name) == (0, f"{name}: sound\n", [])


def test_the_faults_of_all_files_are_reported_at_once(call_command: Call) -> None:
    expected = [
        spoil("control.yaml", "rate: 50 ", "rat: 50 "),
        spoil("vehicle.yaml", "front_left: front_left_wheel_joint", "front_left: front_left_weel_joint"),
        spoil("vehicle.yaml", "rear_left: back_left_wheel_joint", "rear_left: base_link"),
        spoil("sensors.yaml", "frame: gps", "frame: gsp"),
        spoil("structure.xacro", 'velocity="${wheel_speed_limit}"', 'velocity="-3"'),
        spoil("structure.xacro", "meshes/body.gltf", "meshes/bodi.gltf"),
        spoil("structure.xacro", "meshes/wheel.gltf", "meshes/weel.gltf"),
    ]
    code, out, err = call_command("check", "car")
    assert (code, out) == (2, "")
    assert sorted(places(err)) == sorted(expected)
    assert len(set(err)) == len(err)
    assert any("no joint 'front_left_weel_joint'; did you mean 'front_left_wheel_joint'?" in line for line in err)
    assert any("no link 'gsp'; did you mean 'gps'?" in line for line in err)


def test_several_faults_of_one_yaml_file_and_the_urdf_beside_it_are_reported(call_command: Call) -> None:
    expected = [spoil("vehicle.yaml", "drive: front", "drive: frnt"), spoil("vehicle.yaml", "licence:", "license:")]
    spoil("structure.xacro", 'mass="${knuckle_mass}"', 'mass="-1"')
    code, _, err = call_command("check", "car")
    assert code == 2
    assert set(expected) <= set(places(err))
    assert any("license: unknown field" in line for line in err)
    assert any(re.search(r"structure\.xacro:\d+: link 'front_left_knuckle': mass -1 kg", line) for line in err)


def test_every_file_that_is_not_xml_is_reported(call_command: Call) -> None:
    expected = [
        spoil("contact.xacro", "</robot>", "</robt>"),
        spoil("sensors.xacro", "</robot>", "</robt>"),
    ]
    code, _, err = call_command("check", "car")
    assert code == 2
    assert places(err) == expected
    assert all("not valid XML: mismatched tag" in line for line in err)


def test_missing_files_are_reported_with_similar_names(call_command: Call) -> None:
    Path("car/sensors.yaml").rename("car/sensor.yaml")
    Path("car/vehicle.yaml").unlink()
    code, _, err = call_command("check", "car")
    assert code == 2
    assert "error: car/vehicle.yaml: no such file" in err
    assert "error: car/sensors.yaml: no such file; is it 'sensor.yaml'?" in err


def test_a_name_that_is_there_twice_is_reported_with_both_places(call_command: Call) -> None:
    first = spoil("structure.xacro", '<link name="base_link">', '<link name="base_link"/>\n  <link name="base_link">')
    code, _, err = call_command("check", "car")
    name, line = first.rsplit(":", 1)
    assert code == 2
    assert f"error: {name}:{int(line) + 1}: link 'base_link' exists already, at {first}" in err


def test_variants_are_checked_with_their_folder(call_command: Call) -> None:
    expected = spoil("variants/published.yaml", "description:", "desription:")
    assert call_command("check", "car@nothing")[0] == 2
    code, _, err = call_command("check", "car")
    assert code == 2
    assert expected in places(err)
    assert all(location.startswith("car/variants/published.yaml") for location in places(err))


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        (
            "properties.xacro",
            'name="front_axle_share" value="0.56"',
            'name="front_axle_share" value="1.2"',
            "tips over: its centre of mass is 3.12 m ahead of the rear axle",
        ),
        (
            "properties.xacro",
            'name="ground_clearance" value="0.15"',
            'name="ground_clearance" value="-0.1"',
            "does not stay",
        ),
    ],
)
def test_a_vehicle_that_does_not_stay_at_rest_fails_with_exit_code_1(
    name: str, old: str, new: str, words: str, call_command: Call
) -> None:
    spoil(name, old, new)
    code, out, err = call_command("check", "car")
    assert (code, out) == (1, "")
    assert err[0].startswith(f"error: car: {words}"), err


def test_a_broken_image_is_reported_before_anything_crashes_on_it(call_command: Call) -> None:
    spoil("meshes/wheel.gltf", '"POSITION": 3,', '"POSTION": 3,')
    code, _, err = call_command("check", "car")
    assert code == 2
    assert err == [err[0]]
    assert "broken glTF file: 'POSITION' is missing" in err[0]


def test_the_help_names_the_exit_codes(call_command: Call) -> None:
    _, out, _ = call_command("check", "--help")
    assert "0 sound, 1 the files are sound but a vehicle does not stay at rest, 2 a file has a fault" in out


# --- view ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "shown"),
    [
        ([], {"frames": False, "collision": False, "meshes": True}),
        (["--collision", "--no-meshes"], {"frames": False, "collision": True, "meshes": False}),
        (["--frames"], {"frames": True, "collision": False, "meshes": True}),
    ],
)
def test_view_starts_with_the_layers_that_are_asked_for(
    options: list[str], shown: dict[str, bool], call_command: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    from mirdrake import viewer

    requested: list[dict[str, bool]] = []
    show = viewer.show_vehicle

    def noted(vehicle, meshcat, **layers):
        requested.append(layers)
        return show(vehicle, meshcat, **layers)

    monkeypatch.setattr(viewer, "show_vehicle", noted)
    assert call_command("view", "car", *options, "--out", "page.html") == (0, "page.html\n", [])
    assert requested == [shown]
    assert Path("page.html").stat().st_size > 1e6


def test_view_has_no_layers_of_a_world(call_command: Call) -> None:
    code, _, err = call_command("view", "empty", "--frames", "--no-meshes")
    assert code == 2
    assert err == ["error: --frames, --no-meshes: only for a vehicle; 'empty' is not a vehicle"]


def test_the_help_of_view_names_the_layers(call_command: Call) -> None:
    _, out, _ = call_command("view", "--help")
    for option in ("--frames", "--collision", "--no-meshes"):
        assert re.search(rf"^  {option} +\w", out, flags=re.MULTILINE)


# --- all file formats -------------------------------------------------------------------------------------------------

SHIPPED = {
    "prop": "models/props/cone/prop.yaml",
    "presets": "models/sensors/*.yaml",
    "figures": "models/*/published_figures.yaml",
    "variant": "models/bolt/variants/handling.yaml",
    "world": "worlds/skidpad.yaml",
    "diagram": "diagrams/two_cars.yaml",
    "identification": "studies/identify*.yaml",
}


@pytest.mark.parametrize("kind", SHIPPED)
def test_the_format_of_every_file_is_known(kind: str) -> None:
    paths = sorted(data_root().glob(SHIPPED[kind]))
    assert paths
    assert {format_of(path) for path in paths} == {kind}


def test_the_missing_first_line_of_a_world_is_named(call_command: Call, tmp_path: Path) -> None:
    (tmp_path / "yard.yaml").write_text("ground: {surface: grass}\nprops: []\n")
    code, _, err = call_command("check", str(tmp_path / "yard.yaml"))
    assert code == 2
    assert "mirdrake: is missing; write `mirdrake: world/1` as its first line" in err[-1]


def test_the_published_figures_of_a_vehicle_are_checked(call_command: Call) -> None:
    Path("car/published_figures.yaml").write_text("none_becuase: a prototype\n", encoding="utf-8")
    code, _, err = call_command("check", "car")
    assert code == 2
    assert any("published_figures.yaml:1: none_becuase: unknown field" in line for line in err)
    Path("car/published_figures.yaml").write_text("figures: [{value: 1}]\n", encoding="utf-8")
    _, _, err = call_command("check", "car")
    assert any("figures.0: needs a 'quantity'; allowed: " in line for line in err)


def test_the_data_set_in_an_identification_study_is_checked(call_command: Call, tmp_path: Path) -> None:
    data = "data: {time: {column: t}, channels: {vx: {column: v, uint: m/s}}, logs: [{file: drive.csv}]}"
    (tmp_path / "study.yaml").write_text(f"mirdrake: identification/1\n{data}\nmodel: single_track\n", encoding="utf-8")
    code, _, err = call_command("check", "study.yaml")
    assert code == 2
    assert any("study.yaml:2: data.channels.vx.uint: unknown field; did you mean 'unit'" in line for line in err)


def test_a_driver_without_a_kind_is_reported_with_the_kinds(call_command: Call, tmp_path: Path) -> None:
    text = "world: empty\nvehicles: {ego: {model: bolt}}\ncontrol: {ego: {speed: 3}}\n"
    (tmp_path / "drive.yaml").write_text(text, encoding="utf-8")
    code, _, (line,) = call_command("check", "drive.yaml")
    assert (code, line.partition("; allowed: ")[0]) == (2, "error: drive.yaml:3: control.ego: needs a 'kind'")
    assert "path_tracking" in line


def test_a_fault_of_a_prop_names_the_entry_of_the_world(call_command: Call, tmp_path: Path) -> None:
    (tmp_path / "world.yaml").write_text(
        "mirdrake: world/1\nprops:\n  - {prop: ./boxes, at: [0, 0]}\n", encoding="utf-8"
    )
    code, _, err = call_command("check", "world.yaml")
    assert (code, err) == (2, ["error: world.yaml:3: props.0.prop: boxes/prop.yaml: no such file"])


def test_a_data_set_is_checked_as_one(call_command: Call, tmp_path: Path) -> None:
    rows = "".join(f"{0.1 * index:.1f},{1 + 0.1 * (index % 5)}\n" for index in range(60))
    good = "mirdrake: data/1\ntime: {column: t}\nchannels: {vx: {column: v, unit: m/s}}\nlogs: [{file: drive.csv}]\n"
    (tmp_path / "drive.csv").write_text(f"t,v\n{rows}", encoding="utf-8")
    (tmp_path / "data.yaml").write_text(good, encoding="utf-8")
    assert call_command("check", "data.yaml") == (0, "data.yaml: sound\n", [])
    for old, new, text in (
        ("data/1", "dota/1", "data.yaml:1: mirdrake: unknown format 'dota/1'; did you mean 'data/1'"),
        ("channels", "chanels", "data.yaml:3: chanels: unknown field; did you mean 'channels'"),
        ("drive.csv", "drove.csv", "drove.csv"),
    ):
        (tmp_path / "data.yaml").write_text(good.replace(old, new), encoding="utf-8")
        code, _, (line, *_) = call_command("check", "data.yaml")
        assert code == 2
        assert text in line


@pytest.mark.parametrize("name", ["prop.yaml", "published_figures.yaml"])
def test_a_file_that_is_known_by_its_name_is_checked(call_command: Call, tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("descriptoin: 3\n", encoding="utf-8")
    code, _, lines = call_command("check", name)
    assert code == 2
    assert any("descriptoin: unknown field" in line for line in lines)
    assert not any("world" in line for line in lines)
