"""Exports, read back by independent readers."""

import csv
import io
import json
import math
import shutil
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix

from mirdrake.cli import main
from mirdrake.export.frames import eyes_of
from mirdrake.export.video import write_videos
from mirdrake.runs.logs import Run, load_run
from mirdrake.runs.simulation import simulate
from mirdrake.vehicles import load_vehicle
from tests.recording_rigs import COLUMNS, ROWS, install_stubs
from tests.test_recording import drive

SEEN_LINKS = [f"{end}_{side}_wheel" for end in ("front", "rear") for side in ("left", "right")]
START = 1780228800 * 10**9  # 2026-05-31 12:00 UTC [ns]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One second of a CAT Vehicle with camera, lasers, GPS; a start time; an event."""
    folder = tmp_path_factory.mktemp("export") / "run"
    record = {"cameras": True, "meshcat": False, "report": False, "start_time": "2026-05-31 12:00"}
    spec = drive(record=record)
    spec["sensors"] = {"ego": ["left_camera", "front_lidar", "roof_lidar", "gps", "imu"]}
    spec["control"] = {"ego": {"kind": "constant", "speed": 2.0, "steering": 0.2}}
    with pytest.MonkeyPatch.context() as patch:
        install_stubs(patch, several=True)
        simulate(spec, folder=folder)
    (folder / "events.jsonl").write_text('{"time": 0.5, "kind": "road", "text": "ego: 3 of 4"}\n', encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def run(folder: Path) -> Run:
    return load_run(folder)


def decode_ros2(schema: Any, data: bytes) -> Any:
    """Return a ROS 2 message by rosbags, which knows its type; the definition in the file is that type."""
    typesys = pytest.importorskip("rosbags.typesys")
    assert schema.encoding == "ros2msg"
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    given = typesys.get_types_from_msg(schema.data.decode(), schema.name)
    for name, definition in given.items():
        assert definition[1] == store.fielddefs[name][1], name
    return store.deserialize_cdr(data, schema.name)


def export(folder: Path, kind: str, out: Path) -> int:
    return main(["export", str(folder), "--to", kind, "--out", str(out)])


# --- MCAP ------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def messages(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[tuple[int, str, Any]]]:
    """(log time [ns], schema, content) of an exported file by topic, in the order of the file."""
    reading = pytest.importorskip("mcap.reader")
    decoding = pytest.importorskip("mcap_protobuf.decoder")
    path = tmp_path_factory.mktemp("mcap") / "run.mcap"
    assert export(folder, "mcap", path) == 0
    by_topic: dict[str, list[tuple[int, str, Any]]] = {}
    with path.open("rb") as file:
        reader = reading.make_reader(file, decoder_factories=[decoding.DecoderFactory()])
        summary = reader.get_summary()
        for schema, channel, message in reader.iter_messages():
            data = message.data
            if channel.message_encoding == "protobuf":
                content: Any = decoding.DecoderFactory().decoder_for("protobuf", schema)(data)
            elif channel.message_encoding == "cdr":
                content = decode_ros2(schema, data)
            else:
                content = json.loads(data)
            assert message.log_time == message.publish_time
            by_topic.setdefault(channel.topic, []).append((message.log_time, schema.name, content))
        counts = Counter({topic: len(entries) for topic, entries in by_topic.items()})
        numbers = {channel.id: channel.topic for channel in summary.channels.values()}
        statistics = summary.statistics.channel_message_counts
        assert counts == {numbers[number]: count for number, count in statistics.items()}
    return by_topic


def test_every_topic_has_its_schema_and_no_message_is_missing(messages: dict[str, Any], run: Run) -> None:
    about = {topic: (entries[0][1], len(entries)) for topic, entries in messages.items()}
    assert about == {
        "/ego/gps": ("foxglove.LocationFix", 11),
        "/ego/gps/sample": ("mirdrake.Signals", 11),
        "/ego/signals": ("mirdrake.Signals", 51),
        "/tf": ("foxglove.FrameTransforms", 51),
        "/ego/left_camera": ("foxglove.CompressedImage", 31),
        "/ego/left_camera/info": ("foxglove.CameraCalibration", 31),
        "/ego/left_camera/depth": ("foxglove.CompressedImage", 31),
        "/ego/left_camera/label": ("foxglove.CompressedImage", 31),
        "/ego/front_lidar": ("foxglove.LaserScan", 30),
        "/ego/roof_lidar": ("foxglove.PointCloud", 5),
        "/ego/imu": ("sensor_msgs/msg/Imu", len(run.arrays["ego.imu"]["wz"])),
        "/ego/joint_states": ("sensor_msgs/msg/JointState", 51),
        "/scene": ("foxglove.SceneUpdate", 1),
        "/log": ("foxglove.Log", 1),
    }


def test_times_are_those_of_the_recording(messages: dict[str, Any], run: Run) -> None:
    expected = {
        "/ego/signals": run.signals.index.to_numpy(),
        "/tf": run.signals.index.to_numpy(),
        "/ego/left_camera": np.round(np.arange(31) / 30.0, 6),
        "/ego/front_lidar": np.arange(30) / 30.0,
        "/ego/roof_lidar": np.arange(5) / 5.0,
        "/log": np.array([0.5]),
    }
    for topic, times in expected.items():
        stamps = [stamp - START for stamp, _, _ in messages[topic]]
        np.testing.assert_allclose(stamps, 1e9 * times, atol=1.0, err_msg=topic)
        for stamp, schema, content in messages[topic]:
            if schema.startswith("foxglove") and topic not in {"/tf", "/scene"}:
                assert content.timestamp.seconds * 10**9 + content.timestamp.nanos == stamp


def test_signals_and_pictures_and_scans_are_as_recorded(messages: dict[str, Any], run: Run) -> None:
    speeds = [content["vx"] for _, _, content in messages["/ego/signals"]]
    assert speeds == run["ego.vx"].tolist()
    assert messages["/ego/signals"][0][2]["wheel_speed_front_left"] == run["ego.wheel_speed.front_left"].iloc[0]
    pictures = run.pictures["ego.left_camera"]
    assert [content.data for _, _, content in messages["/ego/left_camera"]] == [p.path.read_bytes() for p in pictures]
    assert {(c.format, c.frame_id) for _, _, c in messages["/ego/left_camera"]} == {("jpeg", "ego.left_camera.optical")}
    assert {(c.format, c.frame_id) for _, _, c in messages["/ego/left_camera/depth"]} == {
        ("png", "ego.left_camera.optical")
    }
    info = messages["/ego/left_camera/info"][0][2]
    focal = 400.0 / math.tan(math.radians(40.0))
    assert list(info.K) == pytest.approx([focal, 0.0, 399.5, 0.0, focal, 399.5, 0.0, 0.0, 1.0])
    scan = messages["/ego/front_lidar"][7][2]
    assert list(scan.ranges) == [7.0] * 180
    assert (scan.start_angle, scan.end_angle) == (-1.57, 1.57)
    assert messages["/log"][0][2].message == "ego: 3 of 4"


def test_a_cloud_has_the_returns_where_they_are(messages: dict[str, Any]) -> None:
    cloud = messages["/ego/roof_lidar"][3][2]
    assert [(field.name, field.offset, field.type) for field in cloud.fields] == [("x", 0, 7), ("y", 4, 7), ("z", 8, 7)]
    points = np.frombuffer(cloud.data, dtype="<f4").reshape(-1, 3)
    assert cloud.point_stride == 12
    assert len(points) == ROWS * COLUMNS - 1  # one beam had no return
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 3.0, rtol=1e-6)
    last = points[-1]  # azimuth 0.4 to the left, elevation 0.3 upwards
    np.testing.assert_allclose(np.arctan2(last[1], last[0]), 0.4, rtol=1e-6)
    np.testing.assert_allclose(np.arcsin(last[2] / 3.0), 0.3, rtol=1e-6)


def test_transforms_lead_from_the_world_to_the_pictures(messages: dict[str, Any], run: Run) -> None:
    def pose(entry: Any) -> RigidTransform:
        turn, translation = entry.rotation, entry.translation
        rotation = RotationMatrix(Quaternion(wxyz=[turn.w, turn.x, turn.y, turn.z]))
        return RigidTransform(rotation, [translation.x, translation.y, translation.z])

    first, final = ({e.child_frame_id: e for e in messages["/tf"][i][2].transforms} for i in (0, -1))
    assert {name: entry.parent_frame_id for name, entry in first.items()} == {
        "ego": "world",
        "ego.left_camera": "ego",
        "ego.left_camera.optical": "ego.left_camera",
        "ego.front_lidar": "ego",
        "ego.roof_lidar": "ego",
        "ego.gps": "ego",
        "ego.imu": "ego",
    } | {f"ego/{link}": "ego" for link in SEEN_LINKS}
    row = run.signals.iloc[-1]
    X_WB = pose(final["ego"])
    np.testing.assert_allclose(X_WB.translation(), [row[f"ego.{key}"] for key in "xyz"], atol=1e-12)
    assert RollPitchYaw(X_WB.rotation()).yaw_angle() == pytest.approx(row["ego.yaw"], abs=1e-9)
    assert abs(row["ego.yaw"]) > 0.01
    X_SC = pose(first["ego.left_camera.optical"])
    np.testing.assert_allclose(X_SC.rotation() @ [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], atol=1e-12)  # ahead
    np.testing.assert_allclose(X_SC.rotation() @ [1.0, 0.0, 0.0], [0.0, -1.0, 0.0], atol=1e-12)  # to the right
    lidar = pose(first["ego.front_lidar"]).translation()
    assert lidar[0] > load_vehicle("catvehicle").geometry.wheelbase  # at the front bumper


def test_the_eyes_of_a_pair_have_frames_and_calibrations_of_their_own() -> None:
    class Pair:
        width, baseline = 640, 0.12

    assert eyes_of("ego.pair", Pair()) == {"ego.pair.left": 0.06, "ego.pair.right": -0.06}
    assert eyes_of("ego.imu", object()) == {}


def test_positions_are_those_of_the_receiver(messages: dict[str, Any], run: Run) -> None:
    fixes = messages["/ego/gps"]
    samples = run.arrays["ego.gps"]
    np.testing.assert_allclose([stamp - START for stamp, _, _ in fixes], 1e8 * np.arange(11), atol=1.0)  # 10 Hz
    assert [content.latitude for _, _, content in fixes] == samples["latitude"].tolist()
    assert [content.longitude for _, _, content in fixes] == samples["longitude"].tolist()
    assert [content["vx"] for _, _, content in messages["/ego/gps/sample"]] == samples["vx"].tolist()


def test_an_imu_and_the_joints_are_messages_of_ros(messages: dict[str, Any], run: Run) -> None:
    samples = run.arrays["ego.imu"]
    imu = [content for _, _, content in messages["/ego/imu"]]
    assert [message.angular_velocity.z for message in imu] == samples["wz"].tolist()
    assert [message.linear_acceleration.x for message in imu] == samples["fx"].tolist()
    assert {message.header.frame_id for message in imu} == {"ego.imu"}
    assert {message.orientation_covariance[0] for message in imu} == {-1.0}  # no orientation, as REP 145 has it
    joints = [content for _, _, content in messages["/ego/joint_states"]]
    names = run.scene().vehicles["ego"].spec.joints.wheels
    index = joints[0].name.index(names.rear_left)
    assert [message.position[index] for message in joints] == run["ego.wheel_angle.rear_left"].tolist()
    assert [message.velocity[index] for message in joints] == run["ego.wheel_speed.rear_left"].tolist()
    for (stamp, _, content), time in zip(messages["/ego/joint_states"], run.signals.index, strict=True):
        assert stamp - START == content.header.stamp.sec * 10**9 + content.header.stamp.nanosec - START
        assert stamp - START == pytest.approx(1e9 * time, abs=1.0)


def test_the_3d_panel_shows_the_vehicle_and_its_wheels(messages: dict[str, Any]) -> None:
    trimesh = pytest.importorskip("trimesh")
    (entry,) = messages["/scene"]
    entities = {entity.id: entity for entity in entry[2].entities}
    frames = {"world"} | {e.child_frame_id for _, _, content in messages["/tf"] for e in content.transforms}
    assert {entity.frame_id for entity in entities.values()} <= frames
    assert {"ego", "scenery/world", *(f"ego/{link}" for link in SEEN_LINKS)} <= set(entities)
    wheel = entities[f"ego/{SEEN_LINKS[0]}"]
    assert wheel.frame_locked
    for entity in entities.values():
        for model in entity.models:  # each is a whole GLB
            assert model.media_type == "model/gltf-binary"
            loaded = trimesh.load(io.BytesIO(model.data), file_type="glb")
            assert np.isfinite(loaded.bounds).all()
    radius = load_vehicle("catvehicle").geometry.front_wheel_radius
    (model,) = wheel.models
    loaded = trimesh.load(io.BytesIO(model.data), file_type="glb")
    assert 0.5 * np.ptp(loaded.bounds[:, 0]) == pytest.approx(radius, rel=0.1)


# --- CSV -------------------------------------------------------------------------------------------------------------


def test_a_table_has_units_in_its_header_and_every_digit(folder: Path, run: Run, tmp_path: Path) -> None:
    path = tmp_path / "signals.csv"
    assert export(folder, "csv", path) == 0
    with path.open(newline="", encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    assert header[:3] == ["time [s]", "ego.x [m]", "ego.y [m]"]
    assert "ego.wheel_torque.rear_left [N m]" in header
    assert "ego.wheels_on_road" in header  # a pure number
    assert len(rows) == 51
    table = pd.read_csv(path)
    assert np.array_equal(table["ego.vx [m/s]"].to_numpy(), run["ego.vx"].to_numpy())
    assert np.array_equal(table["time [s]"].to_numpy(), run.signals.index.to_numpy())
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "signals.csv",
        "signals.ego.gps.csv",
        "signals.ego.imu.csv",
    ]
    samples = pd.read_csv(tmp_path / "signals.ego.gps.csv")
    assert np.array_equal(samples["time [s]"].to_numpy(), run.arrays["ego.gps"].times)
    assert np.array_equal(samples["latitude [deg]"].to_numpy(), run.arrays["ego.gps"]["latitude"])


# --- video -----------------------------------------------------------------------------------------------------------


def test_a_video_has_every_picture_at_its_time(folder: Path, run: Run, tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    assert export(folder, "video", tmp_path) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ego.left_camera.mp4"]  # colours only
    with av.open(str(tmp_path / "ego.left_camera.mp4")) as container:
        decoded = list(container.decode(video=0))
    frames = [(float(frame.pts * frame.time_base), frame.to_ndarray(format="rgb24")) for frame in decoded]
    np.testing.assert_allclose([time for time, _ in frames], np.arange(31) / 30.0, atol=2e-5)
    assert frames[0][1].shape == (800, 800, 3)
    np.testing.assert_allclose([float(pixels.mean()) for _, pixels in frames], 20.0 + np.arange(31), atol=2.0)


# --- what goes wrong -------------------------------------------------------------------------------------------------


def test_the_folder_of_videos_is_made(run: Run, tmp_path: Path) -> None:
    videos = write_videos(run, tmp_path / "films" / "of the run")
    assert videos
    assert all(path.is_file() and frames > 0 for path, frames in videos.items())


@pytest.mark.parametrize(
    ("kind", "package", "extra"), [("mcap", "mcap.writer", "mcap"), ("video", "av", "video")], ids=["mcap", "video"]
)
def test_the_error_of_a_missing_package_states_what_to_install(
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    kind: str,
    package: str,
    extra: str,
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    out = tmp_path if kind == "video" else tmp_path / "run.mcap"
    assert export(folder, kind, out) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert f"pip install 'mirdrake[{extra}]'" in error
    assert list(tmp_path.iterdir()) == []


def test_an_export_without_data_is_an_error(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bare = tmp_path / "bare"
    bare.mkdir()
    shutil.copy(folder / "spec.yaml", bare)
    expected_errors: dict[str, Callable[[], int]] = {
        "no such folder": lambda: export(tmp_path / "nothing", "csv", tmp_path / "x.csv"),
        "no signals were recorded": lambda: export(bare, "csv", tmp_path / "x.csv"),
        "has no pictures; record them": lambda: export(bare, "video", tmp_path),
        "is not a folder; make it first": lambda: export(folder, "video", tmp_path / "nowhere"),
        "is a folder; a file is expected": lambda: export(folder, "mcap", tmp_path),
        "cannot be written: No such file": lambda: export(folder, "mcap", tmp_path / "nowhere" / "run.mcap"),
    }
    for words, call in expected_errors.items():
        assert call() == 2, words
        error = capsys.readouterr().err
        assert words.replace("is not a", "not a") in error
        assert error.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bare"]


def test_a_run_without_sensors_and_one_that_was_killed_can_be_exported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("mcap.writer")
    simulate(drive(sensors={}, record={"meshcat": False, "report": False}, duration=0.2), folder=tmp_path / "run")
    (tmp_path / "run" / "summary.json").unlink()
    whole = tmp_path / "run" / "signals.parquet"
    parts = tmp_path / "run" / ".signals.parquet.parts"
    parts.mkdir()
    whole.rename(parts / "part-000000.parquet")
    assert main(["export", str(tmp_path / "run"), "--to", "mcap"]) == 0
    assert main(["export", str(tmp_path / "run"), "--to", "csv"]) == 0
    capsys.readouterr()
    assert {path.name for path in (tmp_path / "run").iterdir()} >= {"run.mcap", "signals.csv"}
