"""Channels that follow from others: position from latitude and longitude; steering, travel and road of both wheels."""

from collections.abc import Callable, Collection, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pymap3d import geodetic2enu

from mirdrake.identification.channels import AXLES

Array = NDArray[np.float64]


class Derivation(NamedTuple):
    """Channels that are computed if a log has others.

    Attributes:
        targets: channels that are computed, unless the log has one of them.
        sources: channels that are needed.
        compute: returns the targets (n each) for the sources (n each).
        method: how, for the notes of a log.
    """

    targets: tuple[str, ...]
    sources: tuple[str, ...]
    compute: Callable[..., tuple[Array, ...]]
    method: str


def _local_plane(latitude: Array, longitude: Array) -> tuple[Array, Array]:
    # The altitude stretches distances by a part in 6 million per metre, so sea level is enough.
    north, east = np.degrees(latitude), np.degrees(longitude)
    known = np.flatnonzero(np.isfinite(north) & np.isfinite(east))
    first = known[0] if len(known) else 0
    x, y, _ = geodetic2enu(north, east, np.zeros(len(north)), north[first], east[first], 0.0)
    return np.asarray(x, dtype=float), np.asarray(y, dtype=float)


def _mean(left: Array, right: Array) -> tuple[Array]:
    # For angles: that of one wheel whose lateral force is the mean of both, for linear tyres with equal stiffness.
    return (0.5 * (left + right),)


DERIVATIONS = (
    Derivation(("x", "y"), ("latitude", "longitude"), _local_plane, "east and north of the first position"),
    Derivation(("road_wheel_angle",), ("road_wheel_angle_left", "road_wheel_angle_right"), _mean, "mean of both"),
    *(
        Derivation((f"{name}_{axle}",), (f"{name}_{axle}_left", f"{name}_{axle}_right"), _mean, "mean of both")
        for name in ("suspension_travel", "road_height")
        for axle in AXLES
    ),
)
"""All derivations."""


def available(names: Collection[str]) -> set[str]:
    """Return the names of channels and of those that follow from them."""
    return {*names, *(target for item in DERIVATIONS if _applies(item, names) for target in item.targets)}


def add_derived(channels: Mapping[str, Array]) -> tuple[dict[str, Array], list[str]]:
    """Return the channels of a log with those that follow from them, and notes.

    Args:
        channels: channels by name (n each).
    """
    result, notes = dict(channels), list[str]()
    for item in DERIVATIONS:
        if _applies(item, channels):
            result |= zip(item.targets, item.compute(*(channels[name] for name in item.sources)), strict=True)
            notes.append(f"{' and '.join(item.targets)} from {' and '.join(item.sources)}: {item.method}")
    return result, notes


def _applies(item: Derivation, names: Collection[str]) -> bool:
    return set(item.sources) <= set(names) and not set(item.targets) & set(names)
