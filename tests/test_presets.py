"""Sensors by product name, and rejected entries of a sensors.yaml."""

import json
from math import radians
from pathlib import Path
from typing import Any

import pytest

from mirdrake.assembly.diagram import assemble, load_diagram
from mirdrake.cli import main
from mirdrake.core.errors import ConfigError
from mirdrake.core.paths import data_root
from mirdrake.core.yaml_io import Source, load_yaml, parse_tree, parse_yaml, validate
from mirdrake.core.yaml_tree import merge_over
from mirdrake.sensors.cameras.mounts import CameraMount
from mirdrake.sensors.gps import GpsMount
from mirdrake.sensors.ranging.laser_scanner import LaserScannerMount
from mirdrake.sensors.ranging.lidar import LidarMount
from mirdrake.sensors.ranging.sonar import SonarMount
from mirdrake.sensors.wheel_encoder import WheelEncoderMount
from mirdrake.vehicles import load_vehicle
from mirdrake.vehicles.mounts import SensorsSpec, change_mounts
from mirdrake.vehicles.presets import presets
from tests.sensor_rigs import vehicle_with

PRESETS = sorted(presets())
WANTED = {
    "automotive_imu", "bolt_camera", "catvehicle_camera", "consumer_gps", "continental_ars408", "hokuyo_urg_04lx",
    "hokuyo_utm_30lx", "kinect_v1", "parking_sonar", "rtk_gps", "sick_lms111", "sick_lms291", "velodyne_hdl32e",
    "velodyne_vlp16",
}  # fmt: skip


def mounts(text: str) -> SensorsSpec:
    return parse_yaml(f"mounts:\n{text}", SensorsSpec, name="sensors.yaml")


def rejection(text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        mounts(text)
    return str(caught.value)


def test_the_products_are_there() -> None:
    assert set(PRESETS) >= WANTED


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_is_a_sensor_and_each_of_its_numbers_has_a_source(name: str) -> None:
    mount = mounts(f"  it: {{preset: {name}, frame: there}}").mounts["it"]
    preset = presets()[name]
    assert (mount.kind, mount.preset, mount.frame) == (preset.mount["kind"], name, "there")
    assert preset.numbers_without_source() == []
    assert preset.sources_without_number() == []


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_with_more_assumed_than_known_is_grade_c(name: str) -> None:
    preset = presets()[name]
    assumed = [text.startswith("assumed") for text in preset.sources.values()]
    assert (sum(assumed) > 0.6 * len(assumed)) == (preset.grade == "C")


def test_keys_of_the_mount_replace_those_of_the_preset() -> None:
    spec = mounts(
        "  front: {preset: sick_lms291, frame: front, rate: 30}\n  gps: {preset: rtk_gps, frame: b, noise: 2}"
    )
    front, gps = spec.mounts["front"], spec.mounts["gps"]
    assert isinstance(front, LaserScannerMount)
    assert (front.rate, front.far) == (30.0, 80.0)
    assert isinstance(gps, GpsMount)
    assert (gps.rate, gps.noise.white, gps.vertical_noise.white) == (20.0, 2.0, 0.015)


def test_the_vehicles_have_the_sensors_of_their_originals() -> None:
    bolt, cat, mkz, unior = (load_vehicle(name).sensors.mounts for name in ("bolt", "catvehicle", "mkz", "unior"))
    camera = bolt["front_camera"]
    assert isinstance(camera, CameraMount)
    assert (camera.width, camera.height, camera.rate, camera.noise) == (800, 800, 30.0, 0.007)
    assert camera.horizontal_fov == pytest.approx(1.3962634, abs=1e-7)
    sick, velodyne, triclops = cat["front_lidar"], cat["roof_lidar"], cat["triclops"]
    assert isinstance(sick, LaserScannerMount)
    assert (sick.beams, sick.rate, sick.near, sick.far, sick.noise) == (180, 30.0, 1.5, 180.0, 0.02)
    assert (sick.start_angle, sick.end_angle) == (-1.57, 1.57)
    assert isinstance(velodyne, LidarMount)
    assert (velodyne.columns, velodyne.rows, velodyne.rate, velodyne.near, velodyne.far) == (100, 20, 5.0, 1.0, 50.0)
    assert (velodyne.horizontal_start, velodyne.horizontal_end) == (-0.4, 0.4)
    assert (velodyne.vertical_start, velodyne.vertical_end) == (-0.0349, 0.326)
    assert (velodyne.resolution, velodyne.noise) == (0.02, 0.02)
    assert isinstance(triclops, CameraMount)
    assert (triclops.width, triclops.height, triclops.rate) == (1280, 960, 16.0)
    vlp, gps, encoder = mkz["roof_lidar"], mkz["gps"], mkz["encoder_rear_left"]
    assert isinstance(vlp, LidarMount)
    assert (vlp.columns, vlp.rows, vlp.rate) == (440, 16, 10.0)
    assert isinstance(gps, GpsMount)
    assert (gps.rate, gps.datum.latitude, gps.datum.longitude) == (50.0, radians(45), radians(-81))
    assert isinstance(encoder, WheelEncoderMount)
    assert encoder.counts == 125.5
    sonar = unior["front_sonar"]
    assert isinstance(sonar, SonarMount)
    assert (sonar.far, sonar.cone, sonar.resolution) == (2.5, radians(10), 0.1)


def test_a_user_folder_of_models_brings_user_presets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "models" / "sensors").mkdir(parents=True)
    file = tmp_path / "models" / "sensors" / "mine.yaml"
    text = "presets:\n  my_gps: {name: mine, grade: C, sources: {}, mount: {kind: gps, rate: 7}}\n"
    file.write_text(text, encoding="utf-8")
    monkeypatch.setenv("MIRDRAKE_PATH", str(tmp_path))
    assert mounts("  gps: {preset: my_gps, frame: roof}").mounts["gps"].rate == 7.0
    assert set(presets()) >= WANTED
    file.write_text(text.replace("kind: gps, ", ""), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"mine.yaml:2: presets.my_gps.*mount needs a kind, and neither frame nor"):
        mounts("  gps: {preset: my_gps, frame: roof}")


def test_the_file_of_presets_is_shipped() -> None:
    assert (data_root() / "models" / "sensors" / "presets.yaml").is_file()


# --- rejected, with file and line --------------------------------------------------------------------------------


RTK = "  a:\n    preset: rtk_gps\n    frame: b\n    "  # the next key is in line 5


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "  a: {preset: sick_lms29, frame: b}",
            "2: mounts.a: unknown preset 'sick_lms29'; did you mean 'sick_lms291'?",
        ),
        ("  a: {preset: [1], frame: b}", "2: mounts.a: unknown preset '[1]'"),
        ("  a: {preset: sick_lms291}", "2: mounts.a.frame: is missing"),
        ("  a: {preset: rtk_gps, frame: b, kind: imu}", "2: mounts.a: preset 'rtk_gps' is a gps; leave `kind` out"),
        (RTK + "rat: 3", "5: mounts.a.rat: unknown field; did you mean 'rate'?"),
        (RTK + "rate: 0", "5: mounts.a.rate: 0 is not allowed; it should be greater than 0"),
        (RTK + "latency: -10 ms", "5: mounts.a.latency: -0.01 is not allowed; it should be greater than or equal to 0"),
        (RTK + "dropout: 1", "5: mounts.a.dropout: 1 is not allowed; it should be less than 1"),
        (RTK + "noise: -1", "5: mounts.a.noise: -1 is not allowed"),
        (RTK + "noise: true", "5: mounts.a.noise"),
        (RTK + "noise: 3 kg", "5: mounts.a.noise: unit 'kg' does not fit; allowed: m, cm, mm"),
        (RTK + "noise: {white: 1, density: 2}", "5: mounts.a.noise: white and density are both given"),
        (RTK + "noise: {withe: 1}", "5: mounts.a.noise.withe: unknown field; did you mean 'white'?"),
        (RTK + "datum: {latitude: 45}", "5: mounts.a.datum.latitude: 45 is not allowed"),
        ("  a: {kind: imu, frame: b, rate: 9, gyro_noise: {correlation: 0}}", "mounts.a.gyro_noise.correlation: 0 is"),
        ("  a: {kind: wheel_encoder, frame: b, rate: 1, counts: 0}", "mounts.a.counts: 0 is not allowed"),
        ("  a: {kind: wheel_encoder, frame: b, rate: 1, counts: 9, wrap: 1}", "mounts.a.wrap: 1 is not allowed"),
        (
            "  a: {kind: steering_angle, frame: b, rate: 1, counts: 9, resolution: 1}",
            "counts and resolution are both given",
        ),
        ("  a: {kind: steering_angle, frame: b, rate: 1, of: rear}", "mounts.a.of: 'rear' is not allowed"),
        ("  a: {kind: ground_truth, frame: b, rate: 0}", "mounts.a.rate: 0 is not allowed"),
    ],
)
def test_invalid_values_are_rejected_with_file_and_line(text: str, message: str) -> None:
    lines = rejection(text).splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("sensors.yaml:")
    assert message in lines[0]


def test_an_unknown_frame_is_rejected_with_file_and_line(tmp_path: Path) -> None:
    folder = vehicle_with(tmp_path / "car", "mounts:\n  roof:\n    preset: rtk_gps\n    frame: gsp\n")
    with pytest.raises(ConfigError, match=r"sensors.yaml:4: mounts.roof.frame: no link 'gsp'; did you mean 'gps'\?"):
        load_vehicle(str(folder))


def test_an_encoder_that_is_not_on_a_wheel_is_rejected_with_file_and_line(tmp_path: Path) -> None:
    folder = vehicle_with(tmp_path / "car", "mounts:\n  odo:\n    preset: mkz_wheel_encoder\n    frame: gps\n")
    spec = {"world": "empty", "vehicles": {"ego": {"model": str(folder)}}, "sensors": {"ego": ["odo"]}}
    with pytest.raises(
        ConfigError, match=r"sensors.yaml:4: mounts.odo.frame: 'gps' is not on a wheel; .*rear_left_wheel"
    ):
        assemble(spec)


def test_all_small_sensors_run_on_a_vehicle(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = """\
mounts:
  gps: {preset: consumer_gps, frame: gps, latency: 120 ms, dropout: 0.1}
  rtk: {preset: rtk_gps, frame: gps, datum: {latitude: 29.7 deg, longitude: -95.4 deg, heading: 20 deg}}
  imu: {preset: automotive_imu, frame: imu}
  wheel: {preset: mkz_wheel_encoder, frame: rear_left_wheel, wrap: 65536, quadrature: false}
  hand_wheel: {preset: steering_angle_sensor, frame: base_link}
  body: {kind: ground_truth, frame: base_link, rate: 50}
"""
    folder = vehicle_with(tmp_path / "car", text)
    names = list(load_yaml(folder / "sensors.yaml", SensorsSpec).mounts)
    diagram = tmp_path / "drive.yaml"
    diagram.write_text(
        f"world: empty\nvehicles: {{ego: {{model: {folder}, speed: 5}}}}\n"
        "control: {ego: {kind: constant, speed: 5, steering: 3 deg}}\n"
        f"sensors: {{ego: {names}}}\nplant: {{contact: point}}\nduration: 0.3\n"
        "record: {meshcat: false, report: false}\n",
        encoding="utf-8",
    )
    assert main(["run", str(diagram), "--out", str(tmp_path / "run")]) == 0, capsys.readouterr().err


# --- changed in a diagram ------------------------------------------------------------------------------------------


def drive(mounts):
    return {"world": "empty", "vehicles": {"ego": {"model": "bolt", "mounts": mounts}}, "control": {"ego": "constant"}}


def test_a_diagram_changes_keys_of_a_mount():
    mount = assemble(drive({"front_camera": {"width": 640, "height": 480, "rate": 25}})).parts.vehicles["ego"]
    camera, usual = mount.vehicle.sensors.mounts["front_camera"], load_vehicle("bolt").sensors.mounts["front_camera"]
    assert isinstance(camera, CameraMount)
    assert isinstance(usual, CameraMount)
    assert (camera.width, camera.height, camera.rate) == (640, 480, 25.0)
    assert camera.horizontal_fov == usual.horizontal_fov
    assert mount.vehicle.sensors.mounts["imu"] == load_vehicle("bolt").sensors.mounts["imu"]


@pytest.mark.parametrize(
    ("mounts", "expected"),
    [
        ({"front_camra": {"rate": 25}}, "mounts.front_camra: no sensor 'front_camra' is mounted; did you mean 'fro"),
        ({"front_camera": {"rate": 0}}, "mounts.front_camera.rate: "),
        ({"front_camera": {"rat": 1}}, "mounts.front_camera.rat: unknown field; did you mean 'rate'"),
    ],
)  # fmt: skip
def test_a_change_of_a_mount_is_checked_with_its_line(tmp_path, mounts, expected):
    path = tmp_path / "drive.yaml"
    text = f"world: empty\nvehicles:\n  ego:\n    model: bolt\n    mounts: {json.dumps(mounts)}\n"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        assemble(load_diagram(str(path)))
    assert "drive.yaml:5: vehicles.ego." in str(caught.value)
    assert expected in str(caught.value)


# --- a preset over a mount --------------------------------------------------------------------------------------------

RECEIVERS = ["rtk_gps", "consumer_gps"]


def product_of(mount: Any) -> dict[str, Any]:
    """Return all keys of a mount except those of its pose."""
    return {key: value for key, value in mount.model_dump().items() if key not in {"frame", "datum"}}


@pytest.mark.parametrize("old", [*RECEIVERS, None])
@pytest.mark.parametrize("new", RECEIVERS)
def test_a_preset_in_a_diagram_replaces_all_of_a_mount_but_its_place(old: str | None, new: str) -> None:
    own = f"preset: {old}" if old else "kind: gps, rate: 3, noise: 7"
    below = mounts(f"  gps: {{{own}, frame: mast, dropout: 0.25, datum: {{latitude: 0.5}}}}")
    source = Source("d.yaml", {}, ("vehicles", "ego", "mounts"))
    changed = change_mounts(below, {"gps": {"preset": new, "latency": 0.3}}, source=source).mounts["gps"]
    bare = mounts(f"  gps: {{preset: {new}, frame: mast, latency: 0.3}}").mounts["gps"]
    assert product_of(changed) == product_of(bare)
    assert changed.frame == "mast"
    before = below.mounts["gps"]
    assert isinstance(changed, GpsMount)
    assert isinstance(before, GpsMount)
    assert changed.datum == before.datum


def test_a_preset_in_a_variant_replaces_a_mount_likewise() -> None:
    text = "mounts:\n  gps: {kind: gps, rate: 3, noise: 7, frame: mast}\n"
    over = parse_tree("mounts: {gps: {preset: rtk_gps}}", "variant.yaml")
    data, source = merge_over(*parse_tree(text, "sensors.yaml"), *over)
    (mount,) = validate(data, SensorsSpec, source).mounts.values()
    assert product_of(mount) == product_of(mounts("  gps: {preset: rtk_gps, frame: mast}").mounts["gps"])


def test_a_preset_of_another_kind_and_an_unknown_one() -> None:
    below = mounts("  it: {preset: sick_lms291, frame: there}")
    source = Source("d.yaml", {}, ("vehicles", "ego", "mounts"))
    changed = change_mounts(below, {"it": {"preset": "velodyne_vlp16"}}, source=source).mounts["it"]
    assert changed.kind == "lidar"
    with pytest.raises(ConfigError, match=r"vehicles\.ego\.mounts\.it\.preset: unknown preset 'velodyne_vlp17'"):
        change_mounts(below, {"it": {"preset": "velodyne_vlp17"}}, source=source)
