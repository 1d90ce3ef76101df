"""Roads with a thickness: their visible outlines, and the slab on which vehicles drive over the same edges."""

from collections.abc import Mapping

import shapely
from shapely.geometry.base import BaseGeometry

from mirdrake.ground.terrain import Slab
from mirdrake.worlds.networks import Network
from mirdrake.worlds.networks.paving import paved_areas
from mirdrake.worlds.spec import TrackSpec
from mirdrake.worlds.tracks import Track

SAGITTA = 5e-3
"""Accuracy of the visible outline [m]."""


def make_slab(specs: Mapping[str, TrackSpec], tracks: Mapping[str, Track], network: Network | None) -> Slab | None:
    """Return the slab of all roads of a world, with the largest thickness of its tracks; None without a thickness.

    All roads have one thickness, so that the ground beside them has no edges where two of them meet.
    """
    roads = {name: spec for name, spec in specs.items() if spec.road}
    thickness = max((spec.thickness for spec in roads.values()), default=0.0)
    if thickness == 0.0:
        return None
    paved = [] if network is None else [part.area for part in paved_areas(network)]
    return Slab(shapely.union_all([*paved, *(seen_outline(tracks[name]) for name in roads)]), thickness)


def seen_outline(track: Track) -> BaseGeometry:
    """Return the visible outline of a road [m]."""
    return without_details(track.outline(sagitta=SAGITTA))


def without_details(shape: BaseGeometry) -> BaseGeometry:
    """Return a shape without negligible points; a road from a file has one per metre."""
    return shapely.simplify(shape, SAGITTA / 2.0)
