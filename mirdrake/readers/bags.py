"""ROS 1 and ROS 2 bags and MCAP files as tables, without ROS.

A column is a topic and a field of its messages: ``/imu/data:angular_velocity.z``. The colon may also be ``.`` or ``/``;
``ranges.3`` is an item of an array, and ``orientation.yaw`` (``roll``, ``pitch``) an angle of a quaternion. MCAP files
of ``mirdrake export`` are read in the same way: ``/ego/signals:vx``.

Each topic has its own clock. The rows are those of the requested topic with the most messages; other topics are
resampled to its times: floating-point numbers linearly, integers and switches by holding. The column ``time`` is the
stamp in the header if messages have one, otherwise the time of reception; ``received`` is always the latter.
"""

import json
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack
from importlib import import_module
from math import asin, atan2
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mirdrake.core.errors import ConfigError, MissingDependencyError, did_you_mean
from mirdrake.core.extras import import_extra
from mirdrake.core.wording import plural
from mirdrake.core.yaml_io import display_path
from mirdrake.readers.tables import Request, Table

CLOCKS = ("time", "received")

MAX_BRIDGE = 5.0
"""Median steps of a topic over which its values are interpolated; longer gaps have no value."""

Messages = Callable[[Collection[str]], Iterator[tuple[str, int, Any]]]


class Bag(NamedTuple):
    """An opened file.

    Attributes:
        topics: type of the messages by topic.
        messages: returns (topic, time of reception [ns], message as mapping or object) of some topics, in order.
    """

    topics: Mapping[str, str]
    messages: Messages


def read_bag(request: Request) -> Table:
    """Read the requested columns of a bag.

    Raises:
        ConfigError: the file cannot be read, or has no such topic or field.
        MissingDependencyError: the packages for bags are not installed.
    """
    path, requested = request.path, request.columns
    columns = [name for name in requested if name not in CLOCKS]
    with ExitStack() as stack:
        bag = _open(path, stack)
        # Each topic has its own clock, so that without a topic there are no rows.
        if not columns:
            topics = ", ".join(sorted(bag.topics)[:10]) + (" …" if len(bag.topics) > 10 else "")
            raise ConfigError(
                f"no column of a topic is named, for example /odom:twist.twist.linear.x; topics: {topics or 'none'}",
                where=display_path(path),
            )
        places = {name: _split(path, name, bag.topics) for name in columns}
        rows = _collect(path, bag, places)
    received = "received" in requested
    # The topic with the most messages has the finest clock.
    clocks = {topic: _clock(times, stamps, received=received) for topic, (times, stamps, _) in rows.items()}
    # The name decides between equal counts, whatever the order of topics in the file.
    base = max(clocks, key=lambda topic: (len(clocks[topic]), topic))
    time, notes = clocks[base], []
    values: dict[str, Any] = {}
    for name, (topic, _) in places.items():
        values[name] = _resampled(time, clocks[topic], rows[topic][2][name], same=topic == base)
    for topic, clock in clocks.items():
        rate = 1e9 * (len(clock) - 1) / float(clock[-1] - clock[0]) if len(clock) > 1 and clock[-1] > clock[0] else 0.0
        stamped = "received" if received or not np.any(rows[topic][1]) else "stamped in their headers"
        how = "their times are the rows" if topic == base else "resampled to the rows"
        notes.append(f"{topic} ({bag.topics[topic]}): {len(clock)} messages, {rate:.4g} Hz, as {stamped}; {how}")
    # Integers are subtracted before the conversion to float, which keeps all nanoseconds.
    start = time[0]
    table = {"received" if received else "time": (time - start) * 1e-9, **values}
    return Table(display_path(path), list(table), table, dict.fromkeys(CLOCKS, "s"), None, notes)


class Topic(NamedTuple):
    """Contents of a topic.

    Attributes:
        name: topic.
        kind: type of its messages.
        fields: numeric fields, dotted; ``yaw`` for the heading of a quaternion.
    """

    name: str
    kind: str
    fields: tuple[str, ...]


def list_topics(path: Path) -> list[Topic]:
    """Return the topics of a bag with the numeric fields of their first message.

    Raises:
        ConfigError: the file cannot be read.
        MissingDependencyError: the packages for bags are not installed.
    """
    topics = []
    with ExitStack() as stack:
        bag = _open(path, stack)
        for name, kind in sorted(bag.topics.items()):
            # One topic at a time: the index of the file leads to its first message.
            try:
                first = next((message for _, _, message in bag.messages({name})), None)
            except MissingDependencyError:
                raise
            except Exception as error:
                raise ConfigError(f"{name}: cannot be read: {_one_line(error)}", where=display_path(path)) from None
            topics.append(Topic(name, kind, tuple(_numeric_fields(first))))
    return topics


def _numeric_fields(item: Any, prefix: str = "") -> Iterator[str]:
    """Yield the numeric fields of a message; arrays are left out."""
    for key in _keys(item):
        inner = _get(item, key)
        if isinstance(inner, bool | int | float | np.number):
            yield prefix + key
        elif key not in {"header", "stamp"} and not isinstance(inner, str | bytes | list | np.ndarray | None):
            yield from _numeric_fields(inner, f"{prefix}{key}.")
    if _angle(item, "yaw") is not None:
        yield f"{prefix}yaw"


def _open(path: Path, stack: ExitStack) -> Bag:
    # Files with JSON or Protobuf need no ROS; those with ROS messages are read by rosbags.
    if path.suffix == ".mcap" and (bag := _open_mcap(path, stack)) is not None:
        return bag
    highlevel, typesys = (
        import_extra(name, need="bags need a package", extra="bags", where=display_path(path))
        for name in ("rosbags.highlevel", "rosbags.typesys")
    )
    try:
        # Messages whose definition is not in the file are read with those of ROS 2 Humble.
        own = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
        reader = stack.enter_context(highlevel.AnyReader([path], default_typestore=own))
    except Exception as error:  # the readers raise errors of many kinds on damaged files
        raise ConfigError(f"is not a bag, or is damaged: {_one_line(error)}", where=display_path(path)) from None

    def messages(topics: Collection[str]) -> Iterator[tuple[str, int, Any]]:
        chosen = [link for link in reader.connections if link.topic in topics]
        for link, time, raw in reader.messages(connections=chosen):
            yield link.topic, time, reader.deserialize(raw, link.msgtype)

    return Bag({link.topic: link.msgtype for link in reader.connections}, messages)


def _open_mcap(path: Path, stack: ExitStack) -> Bag | None:
    """Open an MCAP file with JSON or Protobuf messages; None for ROS messages, or if the package is missing."""
    try:
        reading = import_module("mcap.reader")
    except ImportError:
        return None
    # ROS messages in MCAP are read by the reader of bags; here are those of other robots and of Foxglove.
    try:
        reader = reading.make_reader(stack.enter_context(path.open("rb")))
        summary = reader.get_summary()
        channels = list(summary.channels.values()) if summary else []
    except Exception as error:
        raise ConfigError(f"is not an MCAP file, or is damaged: {_one_line(error)}", where=display_path(path)) from None
    if not channels or any(channel.message_encoding not in {"json", "protobuf"} for channel in channels):
        return None
    schemas = {link.topic: summary.schemas.get(link.schema_id) for link in channels}
    kinds = {topic: schema.name if schema else "JSON" for topic, schema in schemas.items()}
    decoders: dict[int, Callable[[bytes], Any]] = {}

    # Decoders are made at the first message of their channel: Protobuf is needed only for its channels.
    def decoder(schema: Any, channel: Any) -> Callable[[bytes], Any]:
        if channel.message_encoding == "json":
            return json.loads
        need = "needs packages for Protobuf"
        protobuf = import_extra("mcap_protobuf.decoder", need=need, extra="bags", where=display_path(path))
        decoder: Callable[[bytes], Any] = protobuf.DecoderFactory().decoder_for("protobuf", schema)
        return decoder

    def messages(topics: Collection[str]) -> Iterator[tuple[str, int, Any]]:
        for schema, channel, message in reader.iter_messages(topics=list(topics)):
            if channel.id not in decoders:
                decoders[channel.id] = decoder(schema, channel)
            yield channel.topic, message.log_time, decoders[channel.id](message.data)

    return Bag(kinds, messages)


def _split(path: Path, column: str, topics: Mapping[str, str]) -> tuple[str, tuple[str, ...]]:
    """Split a column into topic and field names."""
    name = column if column.startswith("/") else f"/{column}"
    # Topics contain slashes, so that a column is split after the longest topic that it begins with.
    fitting = [topic for topic in topics if name.startswith(topic) and name[len(topic) : len(topic) + 1] in set(":./")]
    if not fitting:
        near = name.split(":")[0]
        raise ConfigError(f"no topic of '{column}'; {did_you_mean(near, sorted(topics))}", where=display_path(path))
    topic = max(fitting, key=len)
    return topic, tuple(name[len(topic) + 1 :].replace("/", ".").replace("[", ".").replace("]", "").split("."))


_Rows = tuple[NDArray[np.int64], NDArray[np.int64], dict[str, NDArray[Any]]]


def _collect(path: Path, bag: Bag, places: Mapping[str, tuple[str, tuple[str, ...]]]) -> dict[str, _Rows]:
    """Return times of reception and stamps [ns] and values by column, for each topic."""
    topics = {topic for topic, _ in places.values()}
    times: dict[str, list[int]] = {topic: [] for topic in topics}
    stamps: dict[str, list[int]] = {topic: [] for topic in topics}
    values: dict[str, list[Any]] = {name: [] for name in places}
    # One pass over the file, since a bag is too large to be read once for each column.
    of = {topic: [(name, keys) for name, (own, keys) in places.items() if own == topic] for topic in topics}
    try:
        for topic, time, message in bag.messages(topics):
            times[topic].append(time)
            stamps[topic].append(_stamp(message))
            for name, keys in of[topic]:
                values[name].append(_value(path, name, message, keys))
    except (ConfigError, MissingDependencyError):
        raise
    except Exception as error:
        raise ConfigError(f"cannot be read: {_one_line(error)}", where=display_path(path)) from None
    for topic in topics:
        if len(times[topic]) < 2:
            raise ConfigError(
                f"{topic} has {plural(len(times[topic]), 'message')}; at least 2 are needed", where=display_path(path)
            )
    # Messages without stamps among others would mix two clocks: stamps count only if all have one.
    return {
        topic: (
            np.array(times[topic]),
            np.array(stamps[topic]) if all(stamps[topic]) else np.zeros(0, dtype=np.int64),
            {name: np.array(values[name]) for name, _ in of[topic]},
        )
        for topic in topics
    }


def _stamp(message: Any) -> int:
    """Return the stamp in the header of a message [ns]; 0 without one."""
    stamp = _get(_get(message, "header"), "stamp") or _get(message, "stamp")
    seconds, rest = _get(stamp, "sec"), _get(stamp, "nanosec")
    return 0 if seconds is None or rest is None else int(seconds) * 10**9 + int(rest)


def _get(item: Any, key: str) -> Any:
    if isinstance(item, Mapping):
        return item.get(key)
    if isinstance(item, list | tuple | np.ndarray):
        return item[int(key)] if key.isdigit() and int(key) < len(item) else None
    return getattr(item, key, None)


def _value(path: Path, name: str, message: Any, keys: tuple[str, ...]) -> Any:
    item = message
    for depth, key in enumerate(keys):
        inner = _get(item, key)
        # Angles of a quaternion can be asked for as fields of it.
        if inner is None and key in {"roll", "pitch", "yaw"} and (angle := _angle(item, key)) is not None:
            return angle
        if inner is None:
            if isinstance(item, Mapping) and key in item:  # JSON's null
                return np.nan
            parent = ".".join(keys[:depth]) or "the message"
            raise ConfigError(
                f"'{name}': {parent} has no field '{key}'; {_fields(item, key)}", where=display_path(path)
            )
        item = inner
    if isinstance(item, bool | int | float | np.number | np.bool_):
        return item
    raise ConfigError(f"'{name}' is not a number; {_fields(item, '')}", where=display_path(path))


def _fields(item: Any, key: str) -> str:
    if isinstance(item, list | tuple | np.ndarray):
        return f"it has the items 0 to {len(item) - 1}"
    names = _keys(item)
    if isinstance(item, Mapping) or names:
        return did_you_mean(key, names) if key else "fields: " + ", ".join(names)
    return "name one of its numeric fields"


def _keys(item: Any) -> list[str]:
    """Return the names of the fields of a message."""
    if isinstance(item, Mapping):
        return list(item)
    if hasattr(item, "DESCRIPTOR"):
        return list(item.DESCRIPTOR.fields_by_name)
    return [name for name in getattr(item, "__dataclass_fields__", {}) if not name.startswith("_")]


def _angle(item: Any, key: str) -> float | None:
    """Return roll, pitch or yaw [rad] of a quaternion; None for other items."""
    parts = [_get(item, axis) for axis in ("w", "x", "y", "z")]
    if any(part is None for part in parts):
        return None
    w, x, y, z = (float(part) for part in parts)
    # Roll, pitch and yaw about the fixed axes x, y, z; rounding may exceed the domain of asin.
    if key == "roll":
        return atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    if key == "pitch":
        return asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
    return atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def _clock(times: NDArray[np.int64], stamps: NDArray[np.int64], *, received: bool) -> NDArray[np.int64]:
    return times if received or not len(stamps) else stamps


def _resampled(time: NDArray[np.int64], own: NDArray[np.int64], values: NDArray[Any], *, same: bool) -> NDArray[Any]:
    """Return values of one topic at the times of another."""
    numbers = values.astype(float)
    if same:
        return numbers
    # Messages may be stored out of order.
    order = np.argsort(own, kind="stable")
    own, numbers = own[order], numbers[order]
    # A switch has no value between two states, so that the last message is held.
    if values.dtype.kind in "bui":
        rows = np.searchsorted(own, time, side="right") - 1
        return np.where(rows >= 0, numbers[np.maximum(rows, 0)], np.nan)
    # Nanoseconds since 1970 exceed the 53 bits of a float; those since the first message do not.
    start = own[0]
    clock, target = (own - start).astype(float), (time - start).astype(float)
    result = np.interp(target, clock, numbers, left=np.nan, right=np.nan)
    steps = np.diff(clock)
    longest = MAX_BRIDGE * float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 0.0
    before = np.clip(np.searchsorted(clock, target, side="right") - 1, 0, len(clock) - 2)
    # At the time of a message the value is known, also at the edge of a gap.
    result[(steps[before] > longest) & (target != clock[before])] = np.nan
    return np.asarray(result)


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())[:160] or type(error).__name__
