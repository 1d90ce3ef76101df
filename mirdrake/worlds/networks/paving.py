"""Areas of a network from above: lanes for motor vehicles, other paved lanes, sidewalks."""

from collections.abc import Iterable
from dataclasses import dataclass

import shapely
from shapely.geometry.base import BaseGeometry

from mirdrake.worlds.networks.lane import close_gaps
from mirdrake.worlds.networks.network import Network

_PAVED = frozenset({"shoulder", "parking", "border", "biking", "restricted", "bus", "taxi", "HOV", "curb", "median"})
_SIDEWALK = frozenset({"sidewalk", "walking"})


@dataclass(frozen=True)
class PavedArea:
    """Lanes of a network with one appearance."""

    name: str
    area: BaseGeometry
    """polygon in W [m]"""
    surface: str | None
    """None: the surface of the network"""
    drivable: bool


def paved_areas(network: Network) -> list[PavedArea]:
    """Return the areas of a network, without overlaps."""
    road = network.area
    beside = shapely.difference(_area(network, _PAVED), road)
    walks = shapely.difference(_area(network, _SIDEWALK), shapely.union(road, beside))
    parts = [
        PavedArea("sidewalks", walks, "concrete", drivable=False),
        PavedArea("shoulders", beside, None, drivable=False),
        PavedArea("lanes", road, None, drivable=True),
    ]
    return [part for part in parts if not part.area.is_empty]


def _area(network: Network, kinds: Iterable[str]) -> BaseGeometry:
    return close_gaps([lane.area for lane in network.lanes.values() if lane.kind in kinds])
