"""A world of roads that an importer makes, before it is written."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from mirdrake.core.yaml_io import display_path
from mirdrake.importing.changes import Changes, Code
from mirdrake.worlds.networks import Lane, Network
from mirdrake.worlds.networks.network_relief import find_bridge, fitting_cell

_INTO = 10.0  # [m] from the beginning of a lane to a start


@dataclass
class RoadWorld:
    """A world of roads.

    Attributes:
        text: text of the world file.
        sources: files that were read.
        files: content of the files beside it, by path below the folder of the world.
        changes: everything that differs from the source.
        checks: sentences on what the user should check.
        entries: number of entries, for the summary.
    """

    text: str
    sources: list[Path]
    files: Mapping[str, bytes] = field(default_factory=dict)
    changes: Changes = field(default_factory=Changes)
    checks: list[str] = field(default_factory=list)
    entries: int = 0


def number(value: float) -> str:
    """Return a number with at most 4 decimals."""
    text = f"{value:.4f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def station(s: float) -> str:
    """Return a station on a lane [m], rounded down, so that it is not beyond the end of the lane."""
    return number(math.floor(s * 1e4) / 1e4)


def pose(x: float, y: float, yaw: float) -> str:
    """Return the YAML keys of a pose; the heading is rounded to 1e-4 deg."""
    # Angles within ±180 deg.
    turned = math.degrees(math.remainder(yaw, 2.0 * math.pi))
    return f"at: [{number(x)}, {number(y)}], yaw: {number(turned)} deg"


def note_changes(network: Network, source: Path, changes: Changes) -> None:
    """Add the notes of a network as changes: parts of its file that it does not represent."""
    for note in network.notes:
        why = "without counterpart in a network, or approximated"
        changes.add(Code.ROAD, f"{display_path(source)}:1", note.part, note.detail, None, why)


def ground_text(network: Network | None, source: Path, changes: Changes) -> str:
    """Return the ground: with the heights of the network if it is not flat, on a grid that is not too large.

    Args:
        network: the road network; None: there is none.
        source: file of the network, for the changes.
        changes: changed if there are bridges: then the ground is flat.
    """
    flat = "{surface: grass}"
    if network is None or not any(lane.z.any() for lane in network.lanes.values()):
        return flat
    if (bridge := find_bridge(network)) is not None:
        why = "the ground is one surface, without bridges"
        changes.add(Code.ROAD, f"{display_path(source)}:1", "heights of the roads", bridge, "flat ground", why)
        return flat
    return f"{{surface: grass, relief: [{{network: {{cell: {fitting_cell(network):g}}}}}]}}"


def start_on_longest(network: Network) -> str:
    """Return keys of a start on the longest lane for motor vehicles outside junctions, 10 m after its beginning."""
    lanes: list[Lane] = [lane for lane in network.driving() if lane.junction is None] or network.driving()
    lane = max(lanes, key=lambda lane: (round(lane.length, 6), lane.id))
    x, y, yaw = (float(value) for value in lane.pose(min(_INTO, lane.length / 2.0)))
    return pose(x, y, yaw)
