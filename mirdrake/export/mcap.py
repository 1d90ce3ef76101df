"""Export of a run as MCAP for Foxglove: its schemas in Protobuf, two of ROS 2, and the signals as JSON.

=========================  ===========================  ===========================================================
topic                      schema                       content
=========================  ===========================  ===========================================================
/tf                        foxglove.FrameTransforms     vehicles, their links and sensors, loose props and actors
/scene                     foxglove.SceneUpdate         once: the world, its props and the vehicles, for the 3D panel
/actors                    foxglove.SceneUpdate         once: the actors of the world
/<vehicle>/joint_states    sensor_msgs/msg/JointState   wheels, steering and springs at record.rate (ROS 2, CDR)
/<vehicle>/signals         mirdrake.Signals (JSON)      all signals of a vehicle at record.rate, units in the schema
/<vehicle>/<camera>        foxglove.CompressedImage     JPEG of colours, PNG of 16 bits of depths (mm) and labels
/<vehicle>/<camera>/info   foxglove.CameraCalibration   with each picture
/<vehicle>/<scanner>       foxglove.LaserScan           scans; inf: no return
/<vehicle>/<lidar>         foxglove.PointCloud          returns in the frame of the sensor
/<vehicle>/<gps>           foxglove.LocationFix         each sample with a fix
/<vehicle>/<gps>/sample    mirdrake.Signals (JSON)      each sample, with its velocity
/<vehicle>/<imu>           sensor_msgs/msg/Imu          each sample; no orientation (ROS 2, CDR)
/<vehicle>/<sensor>        mirdrake.Signals (JSON)      each sample of other sensors with vector samples
/log                       foxglove.Log                 events of the run
=========================  ===========================  ===========================================================

Times are those of the recording, counted from the start time of the run (`record.start_time`, by default 1970-01-01).
"""

import heapq
import json
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mirdrake.core.extras import import_extra
from mirdrake.core.files import replacing
from mirdrake.core.recording.arrays import Samples
from mirdrake.core.recording.parts import read_groups, stored
from mirdrake.core.recording.pictures import EPOCH, Picture
from mirdrake.export.frames import (
    WORLD,
    Frames,
    Pose,
    actor_frame,
    eyes_of,
    joint_columns,
    optical_name,
    sensor_mounts,
)
from mirdrake.export.models import Fields, Primitive, actor_entities, scene_entities
from mirdrake.export.ros import ENCODING, NEED, SCHEMA, Ros2Message, definition, imu_message, joint_message
from mirdrake.plant.plant import VehicleInPlant
from mirdrake.runs.logs import ACTORS, SIGNALS, Run, reads_run

Arrays = Mapping[str, NDArray[np.float64]]

SECOND = 10**9  # ns
_FLOAT32, _INFO, _ERROR = 7, 2, 4  # of Foxglove's enumerations
_IMU = ("wx", "wy", "wz", "fx", "fy", "fz")  # of the samples of an IMU
_GPS = {"latitude", "longitude", "altitude"}  # of the samples of a receiver


class Message(NamedTuple):
    """Message of an MCAP file; messages are sorted by time, then topic.

    Attributes:
        time: time since 1970-01-01 [ns].
        topic: name of the topic.
        content: Protobuf message, ROS 2 message, or mapping for JSON.
    """

    time: int
    topic: str
    content: Any


@reads_run
def write_mcap(run: Run, path: Path) -> dict[str, int]:
    """Write a run as MCAP.

    Args:
        run: run with a folder.
        path: path of the file.

    Returns:
        number of messages by topic.

    Raises:
        MissingDependencyError: the packages for MCAP are not installed.
        RunError: the file cannot be written.
    """
    writing = _import("mcap.writer")
    streams = _Streams(run)
    counts: Counter[str] = Counter()
    channels: dict[str, int] = {}
    with replacing(path) as temporary, temporary.open("wb") as file:
        writer = writing.Writer(file)
        writer.start("", library="mirdrake")
        # Each stream is sorted, so that merging keeps one message of each in memory; contents cannot be compared.
        for message in heapq.merge(*streams.all(), key=lambda entry: entry[:2]):
            topic = message.topic
            if topic not in channels:
                channels[topic] = _register(writer, message, streams.schemas.get(topic))
            data = _bytes(message.content)
            writer.add_message(channels[topic], message.time, data, message.time, counts[topic])
            counts[topic] += 1
        writer.finish()
    return dict(counts)


def _register(writer: Any, message: Message, schema: Mapping[str, object] | None) -> int:
    """Register the channel of a topic, and return its number."""
    content = message.content
    if isinstance(content, Ros2Message):
        number = writer.register_schema(content.kind, SCHEMA, definition(content.kind).encode())
        return int(writer.register_channel(message.topic, ENCODING, number))
    if schema is not None:
        number = writer.register_schema("mirdrake.Signals", "jsonschema", json.dumps(schema).encode())
        return int(writer.register_channel(message.topic, "json", number))
    number = _import("mcap_protobuf.schema").register_schema(writer, type(content))
    return int(writer.register_channel(message.topic, "protobuf", number))


def _bytes(content: Any) -> bytes:
    if isinstance(content, Ros2Message):
        return content.data
    data: bytes = json.dumps(content).encode() if isinstance(content, dict) else content.SerializeToString()
    return data


def _import(name: str) -> Any:
    return import_extra(name, need=NEED, extra="mcap")


def _make(kind: str) -> Any:
    """Return a message class of Foxglove's schemas."""
    return getattr(_import(f"foxglove_schemas_protobuf.{kind}_pb2"), kind)


class _Streams:
    """Messages of a run: for each topic a stream with increasing times."""

    def __init__(self, run: Run) -> None:
        self._run = run
        # datetime has microseconds: rounded there, the nanoseconds are exact.
        self._start = round((run.start - EPOCH).total_seconds() * 1e6) * 1000
        self.schemas: dict[str, Mapping[str, object]] = {}
        self._mounts = sensor_mounts(run)
        self._frames = Frames(run)
        self._eyes = {
            eye: (mount, y) for name, mount in self._mounts.items() for eye, y in eyes_of(name, mount).items()
        }

    def all(self) -> list[Iterator[Message]]:
        """Return an iterator of messages for each stream: events, signals, joints, frames, scene, sensors."""
        run, streams = self._run, [self._events()]
        # Signals exist only for a run with a folder, in which they were stored.
        if run.folder is not None and stored(run.folder / SIGNALS):
            streams += [self._signals(vehicle) for vehicle in run.spec["vehicles"]]
            streams += [self._joints(part) for part in self._frames.parts.vehicles.values()]
            streams.append(self._transforms())
            streams.append(self._scene())
            if stored(run.folder / ACTORS):
                streams.append(self._actors())
        for name, pictures in run.pictures.items():
            streams.append(self._images(name, pictures))
            if name in self._eyes:
                streams.append(self._infos(name, pictures))
        streams += [self._scans(name, samples) for name, samples in run.arrays.items()]
        streams += [self._fixes(name, samples) for name, samples in run.arrays.items() if set(samples) >= _GPS]
        return streams

    def _stamp(self, time: float) -> int:
        return self._start + round(time * SECOND)

    def _message(self, time: float, topic: str, kind: str, **fields: Any) -> Message:
        stamp = self._stamp(time)
        content = _make(kind)(**fields)
        content.timestamp.FromNanoseconds(stamp)
        return Message(stamp, topic, content)

    def _rows(self, columns: list[str]) -> Iterator[tuple[float, ...]]:
        assert self._run.folder is not None
        for group in read_groups(self._run.folder / SIGNALS, ["time", *columns]):
            yield from zip(*(group[name].to_pylist() for name in ("time", *columns)), strict=True)

    def _signals(self, vehicle: str) -> Iterator[Message]:
        topic, names = f"/{vehicle}/signals", [name for name in self._run.units if name.startswith(f"{vehicle}.")]
        # A dot separates fields in Foxglove's message paths.
        keys = [name.removeprefix(f"{vehicle}.").replace(".", "_") for name in names]
        numbers = {
            key: {"type": "number", "description": f"[{self._run.units[name] or '-'}]"}
            for key, name in zip(keys, names, strict=True)
        }
        self.schemas[topic] = {"title": "mirdrake.Signals", "type": "object", "properties": numbers}
        for time, *values in self._rows(names):
            # JSON has no NaN, so that such a value is null.
            finite = (value if math.isfinite(value) else None for value in values)
            yield Message(self._stamp(time), topic, dict(zip(keys, finite, strict=True)))

    def _fixes(self, name: str, samples: Samples) -> Iterator[Message]:
        for time, values in samples.each():
            position = {key: float(values[key]) for key in _GPS}
            if all(map(math.isfinite, position.values())):
                yield self._message(time, _topic(name), "LocationFix", frame_id=name, **position)

    def _transforms(self) -> Iterator[Message]:
        """Yield the poses of moving frames at each sample, and those of the sensors on their vehicles once a second."""
        transform, many = _make("FrameTransform"), _make("FrameTransforms")
        fixed, next_fixed = self._frames.sensors(), 0.0
        for time, poses in self._frames.moving():
            entries = list(poses)
            # The tolerance absorbs rounding of the sample times.
            if time >= next_fixed - 1e-9:
                entries += fixed
                next_fixed += 1.0
            content, stamp = many(), self._stamp(time)
            for parent, child, pose in entries:
                entry = transform(parent_frame_id=parent, child_frame_id=child)
                entry.timestamp.FromNanoseconds(stamp)
                _put_pose(entry.translation, entry.rotation, pose)
                content.transforms.append(entry)
            yield Message(stamp, "/tf", content)

    def _scene(self) -> Iterator[Message]:
        """Yield the visible shapes once, at the first sample; they move with the frames of :meth:`_transforms`."""
        first = next(iter(self._rows([])), None)
        if first is not None:
            yield self._entities(self._stamp(first[0]), "/scene", scene_entities(self._frames))

    def _actors(self) -> Iterator[Message]:
        """Yield the actors once, and the poses of their frames at each sample."""
        actors, table = self._run.scene().world.actors, self._run.actors
        transform, many = _make("FrameTransform"), _make("FrameTransforms")
        columns = [table[[f"{actor.name}.{key}" for key in ("x", "y", "yaw")]].to_numpy() for actor in actors]
        for row, time in enumerate(table.index.tolist()):
            content, stamp = many(), self._stamp(time)
            if row == 0:
                yield self._entities(stamp, "/actors", actor_entities(actors))
            for actor, poses in zip(actors, columns, strict=True):
                x, y, yaw = poses[row].tolist()
                entry = transform(parent_frame_id=WORLD, child_frame_id=actor_frame(actor.name))
                entry.timestamp.FromNanoseconds(stamp)
                # Quaternion w, x, y, z of a rotation about z.
                pose = (x, y, 0.0, math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw))
                _put_pose(entry.translation, entry.rotation, pose)
                content.transforms.append(entry)
            yield Message(stamp, "/tf", content)

    def _entities(self, stamp: int, topic: str, entities: Iterable[tuple[str, str, list[Primitive]]]) -> Message:
        """Return a scene of entities, each with its id, frame and primitives."""
        content = _make("SceneUpdate")()
        for name, frame, primitives in entities:
            # frame_locked: the shapes follow their frame instead of staying where it was at the stamp.
            entity = content.entities.add(id=name, frame_id=frame, frame_locked=True)
            entity.timestamp.FromNanoseconds(stamp)
            for key, fields in primitives:
                _fill(getattr(entity, key).add(), fields)
        return Message(stamp, topic, content)

    def _joints(self, part: VehicleInPlant) -> Iterator[Message]:
        joints, topic = joint_columns(self._run, part), f"/{part.name}/joint_states"
        if not joints:
            return
        names = [joint.name() for joint, _, _ in joints]
        rates = [rate for _, _, rate in joints if rate is not None]
        indices = [rates.index(rate) if rate is not None else None for _, _, rate in joints]
        for time, *values in self._rows([*(column for _, column, _ in joints), *rates]):
            recorded = values[len(names) :]
            # Lists of a JointState have one entry per joint, so that a rate that was not recorded is NaN.
            speeds = [math.nan if index is None else recorded[index] for index in indices]
            stamp = self._stamp(time)
            yield Message(stamp, topic, joint_message(stamp, names, values[: len(names)], speeds))

    def _images(self, name: str, pictures: list[Picture]) -> Iterator[Message]:
        frame, topic = optical_name(name if name in self._eyes else self._mounted(name)), _topic(name)
        for picture in pictures:
            kind = {".jpg": "jpeg", ".png": "png"}[picture.path.suffix]
            data = picture.path.read_bytes()
            yield self._message(picture.time, topic, "CompressedImage", frame_id=frame, data=data, format=kind)

    def _infos(self, name: str, pictures: list[Picture]) -> Iterator[Message]:
        (mount, y), frame, topic = self._eyes[name], optical_name(name), f"{_topic(name)}/info"
        # Pinhole camera: focal length in pixels from the horizontal field of view.
        focal = 0.5 * mount.width / math.tan(0.5 * mount.horizontal_fov)
        # The centre of the first pixel is (0, 0), so that the principal point is half a pixel before the middle.
        u, v = 0.5 * (mount.width - 1), 0.5 * (mount.height - 1)
        lens = getattr(mount, "distortion", None)
        # ROS: P[0, 3] is -f times the baseline for the right lens, at y = -baseline / 2, and 0 for the left one.
        shift = 2.0 * focal * min(y, 0.0)  # of the right lens of a stereo camera against the left one
        fields = {
            "width": mount.width,
            "height": mount.height,
            "distortion_model": "plumb_bob",
            "D": [float(getattr(lens, key, 0.0)) for key in ("k1", "k2", "p1", "p2", "k3")],
            "K": [focal, 0.0, u, 0.0, focal, v, 0.0, 0.0, 1.0],
            "R": np.eye(3).ravel().tolist(),
            "P": [focal, 0.0, u, shift, 0.0, focal, v, 0.0, 0.0, 0.0, 1.0, 0.0],
        }
        for picture in pictures:
            yield self._message(picture.time, topic, "CameraCalibration", frame_id=frame, **fields)

    def _mounted(self, name: str) -> str:
        """Return the sensor of a stream of pictures: ``ego.kinect`` for ``ego.kinect.depth``."""
        sensors = [f"{vehicle}.{sensor}" for vehicle, names in self._run.spec["sensors"].items() for sensor in names]
        return next((sensor for sensor in sensors if name == sensor or name.startswith(f"{sensor}.")), name)

    def _scans(self, name: str, samples: Samples) -> Iterator[Message]:
        """Yield point clouds of a lidar, scans of a laser scanner, and other samples as JSON."""
        topic, make = _topic(name) + ("/sample" if set(samples) >= _GPS else ""), self._values
        # The kind of a sensor is recognised by its arrays, which a run folder always has.
        if {"azimuths", "elevations"} <= set(samples):
            make = self._cloud
        elif hasattr(self._mounts.get(name), "start_angle"):
            make = self._fan
        elif set(samples) >= set(_IMU):
            make = self._imu
        if make == self._values:
            number, units = {"type": "number"}, samples.units
            kinds = {key: number if samples.is_number(key) else {"type": "array", "items": number} for key in samples}
            shapes = {key: kind | {"description": f"[{units[key] or '-'}]"} for key, kind in kinds.items()}
            self.schemas[topic] = {"title": "mirdrake.Signals", "type": "object", "properties": shapes}
        convert: Callable[..., Message] = make
        for time, arrays in samples.each():
            yield convert(time, topic, name, arrays)

    def _fan(self, time: float, topic: str, name: str, arrays: Arrays) -> Message:
        mount, ranges = self._mounts[name], arrays["ranges"].ravel().tolist()
        angles = {"start_angle": mount.start_angle, "end_angle": mount.end_angle}
        message = self._message(time, topic, "LaserScan", frame_id=name, ranges=ranges, **angles)
        # The default quaternion of Protobuf has four zeros, which is not a rotation.
        message.content.pose.orientation.w = 1.0
        return message

    def _cloud(self, time: float, topic: str, name: str, arrays: Arrays) -> Message:
        # Ranges have a row per elevation and a column per azimuth.
        azimuths, elevations = np.broadcast_arrays(arrays["azimuths"][None, :], arrays["elevations"][:, None])
        rays = [np.cos(elevations) * np.cos(azimuths), np.cos(elevations) * np.sin(azimuths), np.sin(elevations)]
        hits = np.isfinite(arrays["ranges"])
        points = np.stack([ray[hits] * arrays["ranges"][hits] for ray in rays], axis=-1).astype("<f4")
        element = _make("PackedElementField")
        parts = [element(name=axis, offset=4 * index, type=_FLOAT32) for index, axis in enumerate("xyz")]
        fields = {"frame_id": name, "point_stride": 12, "fields": parts, "data": points.tobytes()}
        message = self._message(time, topic, "PointCloud", **fields)
        message.content.pose.orientation.w = 1.0
        return message

    def _imu(self, time: float, topic: str, name: str, arrays: Arrays) -> Message:
        values = [float(arrays[key]) for key in _IMU]
        stamp = self._stamp(time)
        return Message(stamp, topic, imu_message(stamp, name, values[:3], values[3:]))

    def _values(self, time: float, topic: str, name: str, arrays: Arrays) -> Message:
        # The converters of all kinds of samples have the same arguments.
        del name
        flat = {
            key: [value if math.isfinite(value) else None for value in np.ravel(values).tolist()]
            for key, values in arrays.items()
        }
        content = {key: values if np.ndim(arrays[key]) else values[0] for key, values in flat.items()}
        return Message(self._stamp(time), topic, content)

    def _events(self) -> Iterator[Message]:
        for event in sorted(self._run.events, key=lambda event: float(event["time"])):
            level = _ERROR if event["kind"] == "failure" else _INFO
            text, kind = str(event["text"]), str(event["kind"])
            yield self._message(event["time"], "/log", "Log", level=level, message=text, name=kind)


def _topic(name: str) -> str:
    return "/" + name.replace(".", "/")


def _put_pose(translation: Any, rotation: Any, pose: Pose) -> None:
    translation.x, translation.y, translation.z = pose[:3]
    rotation.w, rotation.x, rotation.y, rotation.z = pose[3:]


def _fill(primitive: Any, fields: Fields) -> None:
    """Set the fields of a primitive of a SceneEntity."""
    for key, value in fields.items():
        # Protobuf messages are filled field by field; nested ones cannot be assigned.
        target = getattr(primitive, key)
        if key == "pose":
            _put_pose(target.position, target.orientation, value)
        elif key == "color":
            target.r, target.g, target.b, target.a = value
        elif key in {"size", "scale"}:
            target.x, target.y, target.z = value
        elif key == "points":
            for point in value.tolist():
                target.add(x=point[0], y=point[1], z=point[2])
        elif key == "indices":
            target.extend(int(index) for index in value)
        else:
            setattr(primitive, key, value)
