"""Networks as plain data and back, for run folders; nothing is rounded."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from mirdrake.core.json_io import Json
from mirdrake.worlds.networks.lane import Lane
from mirdrake.worlds.networks.network import Junction, Network, Note, PaintedLine, Signal, StopLine


def network_data(network: Network) -> Json:
    """Return a network as data for JSON."""
    return {
        "name": network.name,
        "lanes": [_plain(lane) for lane in network.lanes.values()],
        "stop_lines": [_plain(line) for line in network.stop_lines],
        "signals": [_plain(signal) for signal in network.signals.values()],
        "junctions": [_plain(junction) for junction in network.junctions.values()],
        "priorities": sorted(map(list, network.priorities)),
        "markings": [_plain(line) for line in network.markings],
        "left_hand": network.left_hand,
        "notes": [list(note) for note in network.notes],
    }


def read_network_data(data: Mapping[str, Any]) -> Network:
    """Return the network of the data of :func:`network_data`.

    Raises:
        KeyError, TypeError, ValueError: the data are not those of a network.
    """
    lanes = [Lane(**_arrays(lane)) for lane in data["lanes"]]
    signals = [Signal(**_arrays(signal)) for signal in data["signals"]]
    junctions = [Junction(**_arrays(junction)) for junction in data["junctions"]]
    return Network(
        data["name"],
        {lane.id: lane for lane in lanes},
        stop_lines=tuple(StopLine(**line) for line in data["stop_lines"]),
        signals={signal.name: signal for signal in signals},
        junctions={junction.id: junction for junction in junctions},
        priorities=frozenset((first, second) for first, second in data["priorities"]),
        # JSON has lists for arrays and tuples.
        markings=tuple(
            PaintedLine(**{**line, "points": np.array(line["points"]), "dash": line["dash"] and tuple(line["dash"])})
            for line in data["markings"]
        ),
        left_hand=data["left_hand"],
        notes=tuple(Note(*note) for note in data["notes"]),
    )


def _plain(record: Any) -> Json:
    """Return the fields of a dataclass with arrays as lists."""
    values = {field.name: getattr(record, field.name) for field in fields(record)}
    return {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in values.items()}


def _arrays(data: Mapping[str, Any]) -> Json:
    """Return fields with lists of numbers as arrays, and lists of names as tuples."""

    def read(value: Any) -> Any:
        if not isinstance(value, list):
            return value
        return tuple(value) if not value or isinstance(value[0], str) else np.array(value, dtype=float)

    values = {key: read(value) for key, value in data.items()}
    return values | {key: np.array(data[key], dtype=float) for key in ("road_s", "bank") if key in data}
