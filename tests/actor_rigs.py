"""Worlds with actors, for tests."""

from pathlib import Path
from typing import Any

import yaml

from mirdrake.assembly.diagram import assemble
from mirdrake.runs.simulation import Simulation

STRAIGHT = {"main": {"segments": [{"line": 400}], "width": 7, "lanes": 2}}


def world_file(folder: Path, **keys: Any) -> Path:
    """Write a world file; by default a straight road with two lanes."""
    data = {"mirdrake": "world/1", "name": "actors", "tracks": STRAIGHT} | keys
    path = folder / "actors.yaml"
    path.write_text(yaml.safe_dump({key: value for key, value in data.items() if value is not None}, sort_keys=False))
    return path


def simulation(world: Path, *, speed: float = 0.0, start: Any = None, **keys: Any) -> Simulation:
    """Return a simulation of a Bolt at a constant speed in a world."""
    data: dict[str, Any] = {
        "world": str(world),
        "vehicles": {"ego": {"model": "bolt", "start": start or {"x": 0, "y": 0}, "speed": speed}},
        "control": {"ego": {"kind": "constant", "speed": speed}},
        "plant": {"contact": "point"},
        "record": {"meshcat": False, "report": False},
    }
    ego = keys.pop("ego", {})
    data["vehicles"]["ego"] |= ego
    return Simulation(assemble(data | keys))
