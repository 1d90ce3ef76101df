"""Bags, MCAP and MAT files of version 7.3: written data is read back, and faults are reported in one line."""

import json
import math
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from mcap.writer import Writer

from mirdrake.core.errors import ConfigError, MissingDependencyError
from mirdrake.export.mcap import write_mcap
from mirdrake.identification import load_data
from mirdrake.readers import read_table
from mirdrake.runs.logs import RunWriter, load_run
from mirdrake.vehicles import load_vehicle
from mirdrake.worlds import load_world

rosbags = pytest.importorskip("rosbags")
from rosbags.rosbag1 import Writer as Writer1  # noqa: E402
from rosbags.rosbag2 import StoragePlugin  # noqa: E402
from rosbags.rosbag2 import Writer as Writer2  # noqa: E402
from rosbags.typesys import Stores, get_typestore  # noqa: E402

START = 1_700_000_000_000_000_000
LATE = 7_000_000  # ns that each message needs from its stamp to its reception


def rates(time):
    return 0.3 * np.sin(time)


def ros_messages(store, ros1):
    """(time of reception, topic, type, message): an IMU at 100 Hz, odometry at 20 Hz, a switch at 2 Hz."""
    types = store.types

    def header(time):
        stamp = types["builtin_interfaces/msg/Time"](sec=time // 10**9, nanosec=time % 10**9)
        return types["std_msgs/msg/Header"](stamp=stamp, frame_id="base", **({"seq": 0} if ros1 else {}))

    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    messages = []
    for row in range(500):
        log_time, time = START + row * 10_000_000, 0.01 * row
        imu = types["sensor_msgs/msg/Imu"](
            header(log_time), quaternion(0.0, 0.0, math.sin(0.1 * time), math.cos(0.1 * time)), np.zeros(9),
            vector(0.0, 0.0, float(rates(np.array(time)))), np.zeros(9), vector(1.0, 2.0, 9.8), np.zeros(9),
        )  # fmt: skip
        messages.append((log_time + LATE, "/imu/data", "sensor_msgs/msg/Imu", imu))
        if row % 5 == 2:
            twist = types["geometry_msgs/msg/Twist"](vector(2.0 + time, 0.0, 0.0), vector(0.0, 0.0, 0.0))
            odometry = types["nav_msgs/msg/Odometry"](
                header(log_time), "base",
                types["geometry_msgs/msg/PoseWithCovariance"](
                    types["geometry_msgs/msg/Pose"](
                        types["geometry_msgs/msg/Point"](0.0, 0.0, 0.0), quaternion(0.0, 0.0, 0.0, 1.0)
                    ),
                    np.zeros(36),
                ),
                types["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
            )  # fmt: skip
            messages.append((log_time + LATE, "/odom", "nav_msgs/msg/Odometry", odometry))
        if row % 50 == 0:
            messages.append((log_time, "/gear", "std_msgs/msg/Int32", types["std_msgs/msg/Int32"](row // 250)))
    return messages


def write_ros(folder, kind):
    """Return a bag with the messages; its name."""
    store = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)
    messages = ros_messages(store, ros1=kind == "ros1")
    if kind == "ros1":
        writer, name = Writer1(folder / "drive.bag"), "drive.bag"
    else:
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        writer, name = Writer2(folder / "drive", version=9, storage_plugin=plugin), "drive"
    with writer:
        links = {
            topic: writer.add_connection(topic, kind_of, typestore=store)
            for topic, kind_of in dict.fromkeys((topic, kind_of) for _, topic, kind_of, _ in messages)
        }
        for time, topic, kind_of, message in messages:
            raw = store.serialize_ros1(message, kind_of) if kind == "ros1" else store.serialize_cdr(message, kind_of)
            writer.write(links[topic], time, raw)
    return name


MAPPED = """\
mirdrake: data/1
channels:
  yaw_rate: {column: "/imu/data:angular_velocity.z", unit: rad/s}
  yaw: {column: /imu/data/orientation/yaw, unit: rad}
  vx: {column: /odom.twist.twist.linear.x, unit: m/s}
  gear: {column: "/gear:data"}
"""


def load(folder, file, text=MAPPED):
    (folder / "drives.yaml").write_text(f"{text}logs: [{{file: {file}}}]\n", encoding="utf-8")
    return load_data(folder / "drives.yaml").logs[0]


@pytest.mark.parametrize("kind", ["ros1", "sqlite", "mcap"])
def test_a_bag_of_ros_is_read_with_the_clock_of_its_headers(tmp_path, kind):
    name = write_ros(tmp_path, kind)
    files = [name]
    files += [f"drive/{file.name}" for file in (tmp_path / "drive").glob("*.mcap")] if kind == "mcap" else []
    for file in files:
        log = load(tmp_path, file)
        assert log.time == pytest.approx(0.01 * np.arange(500), abs=1e-9)
        assert log.channels["yaw_rate"] == pytest.approx(rates(log.time))
        assert log.channels["yaw"] == pytest.approx(0.2 * log.time)
        is_recorded = np.isfinite(log.channels["vx"])
        assert np.flatnonzero(~is_recorded).tolist() == [0, 1, 498, 499]  # before its first and behind its last message
        assert log.channels["vx"][is_recorded] == pytest.approx(2.0 + log.time[is_recorded])
        assert np.unique(log.channels["gear"]).tolist() == [0.0, 1.0]
        assert any("/odom (nav_msgs/msg/Odometry): 100 messages, 20 Hz" in note for note in log.notes)


def test_the_time_of_reception_is_used_when_it_is_asked_for(tmp_path):
    log = load(tmp_path, write_ros(tmp_path, "sqlite"), MAPPED + "time: {column: received}\n")
    assert np.diff(log.time) == pytest.approx(0.01)
    assert any("as received" in note for note in log.notes)


@pytest.mark.parametrize(
    ("column", "message"),
    [
        ("/imu/dat:angular_velocity.z", "no topic of '/imu/dat:angular_velocity.z'; did you mean '/imu/data'"),
        ("/imu/data:angular_velocity.w", "angular_velocity has no field 'w'; "),
        ("/imu/data:angular_velocity", "is not a number; fields: x, y, z"),
        ("/imu/data:orientation_covariance.9", "it has the items 0 to 8"),
    ],
)
def test_a_wrong_topic_or_field_is_reported(tmp_path, column, message):
    text = f'mirdrake: data/1\nchannels: {{yaw_rate: {{column: "{column}", unit: rad/s}}}}\n'
    with pytest.raises(ConfigError, match=message) as caught:
        load(tmp_path, write_ros(tmp_path, "sqlite"), text)
    assert "\n" not in str(caught.value)


def test_an_exported_run_is_read_back(tmp_path, monkeypatch):
    time = 0.02 * np.arange(200.0)
    writer = RunWriter(tmp_path / "run", {"vehicles": {"ego": {}}, "sensors": {}, "record": {}})
    writer.write_signals(time, {"ego.vx": 3.0 + time, "ego.yaw_rate": rates(time)}, {"ego.vx": "m/s"})
    writer.finish(dict)
    run = load_run(tmp_path / "run")
    from mirdrake.export import mcap as exporting

    empty = SimpleNamespace(vehicles={}, world=load_world("empty"))  # the run carries signals only
    monkeypatch.setattr(type(run), "scene", lambda _: empty)
    streams = exporting._Streams(run)
    with (tmp_path / "own.mcap").open("wb") as file:
        own, channels = Writer(file), {}
        own.start("", library="test")
        for message in streams._signals("ego"):
            if message.topic not in channels:
                channels[message.topic] = exporting._register(own, message, streams.schemas[message.topic])
            own.add_message(channels[message.topic], message.time, json.dumps(message.content).encode(), message.time)
        own.finish()
    assert callable(write_mcap)
    text = (
        "mirdrake: data/1\nchannels: {vx: {column: '/ego/signals:vx', unit: m/s}, "
        "yaw_rate: {column: /ego/signals/yaw_rate, unit: rad/s}}\n"
    )
    log = load(tmp_path, "own.mcap", text)
    assert log.time == pytest.approx(time)
    assert log.channels["vx"] == pytest.approx(3.0 + time)
    assert log.channels["yaw_rate"] == pytest.approx(rates(time))


@pytest.mark.parametrize("columns", [[], ["time"], ["time", "received"]])
def test_a_bag_without_a_requested_topic_is_one_line(tmp_path, columns):
    bag = tmp_path / write_ros(tmp_path, "mcap")
    with pytest.raises(ConfigError, match=r"no column of a topic is named, .*; topics: /\w+") as error:
        read_table(bag, columns)
    assert "\n" not in str(error.value)


def test_a_run_without_joints_has_no_joint_states(tmp_path, monkeypatch):
    writer = RunWriter(tmp_path / "run", {"vehicles": {"ego": {}}, "sensors": {}, "record": {}})
    writer.write_signals(0.1 * np.arange(5.0), {"ego.vx": np.ones(5)}, {"ego.vx": "m/s"})
    writer.finish(dict)
    run = load_run(tmp_path / "run")
    from mirdrake.export import mcap as exporting

    vehicle = load_vehicle("bolt")
    scene = SimpleNamespace(vehicles={"ego": vehicle}, world=load_world("empty"))
    monkeypatch.setattr(type(run), "scene", lambda _: scene)
    streams = exporting._Streams(run)
    (part,) = streams._frames.parts.vehicles.values()
    assert list(streams._joints(part)) == []


def test_without_the_package_its_extra_is_named(tmp_path, monkeypatch):
    name = write_ros(tmp_path, "ros1")
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'mirdrake\[bags\]'"):
        load(tmp_path, name)


@pytest.mark.parametrize("name", ["broken.bag", "broken.db3", "broken.mcap"])
@pytest.mark.parametrize("content", [b"", b"#ROSBAG V2.0\n" + b"x" * 50, b"\x89MCAP0\r\n" + b"x" * 50])
def test_a_damaged_bag_raises_an_error(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ConfigError, match=f"{name}: is not .*damaged") as caught:
        load(tmp_path, name)
    assert "\n" not in str(caught.value)


def test_mat_files_of_version_7_3_are_read(tmp_path):
    h5py = pytest.importorskip("h5py")
    time = 0.1 * np.arange(40)
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        file["log/t"] = time[None, :]
        file["log/v"] = (2.0 + time)[None, :]
        file["both"] = np.vstack((time, time**2))
    raw = (tmp_path / "a.mat").read_bytes()
    (tmp_path / "a.mat").write_bytes(b"MATLAB 7.3 MAT-file".ljust(512) + raw[512:])
    text = (
        "mirdrake: data/1\ntime: {column: log.t}\nchannels: {vx: {column: log.v, unit: m/s}, "
        "vy: {column: both.2, unit: m/s}}\n"
    )
    log = load(tmp_path, "a.mat", text)
    assert log.channels["vx"] == pytest.approx(2.0 + time)
    assert log.channels["vy"] == pytest.approx(time**2)
