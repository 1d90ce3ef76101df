"""OpenDRIVE maps as worlds: the map is copied beside the world file, whose network it is."""

from pathlib import Path

from mirdrake.importing.roads.road_world import RoadWorld, ground_text, note_changes, start_on_longest
from mirdrake.worlds.networks.opendrive_network import read_network

TEXT = """\
mirdrake: world/1
name: {name}

ground: {ground}
network: {{{key}: {name}/{file}}}

start:
  road: {{{start}}}
"""


def read_opendrive_world(source: Path, name: str) -> RoadWorld:
    """Return a world with the network of an OpenDRIVE map, and a start on its longest lane.

    Raises:
        ConfigError: the file has faults.
    """
    network = read_network(source)
    made = RoadWorld("", [source], {"map.xodr": source.read_bytes()}, entries=len(network.driving()))
    ground = ground_text(network, source, made.changes)
    made.text = TEXT.format(ground=ground, name=name, key="xodr", file="map.xodr", start=start_on_longest(network))
    note_changes(network, source, made.changes)
    return made
