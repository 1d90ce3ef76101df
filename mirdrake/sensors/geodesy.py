"""Conversion between the world and the WGS 84 ellipsoid, with pymap3d."""

from collections.abc import Sequence
from math import cos, degrees, sin

import numpy as np
from numpy.typing import NDArray
from pymap3d import enu2geodetic, geodetic2enu

from mirdrake.vehicles.mounts import DatumSpec

Array = NDArray[np.float64]


def to_geodetic(point: Sequence[float] | Array, datum: DatumSpec) -> Array:
    """Return latitude [deg], longitude [deg] and altitude above the ellipsoid [m] of a point of the world (3).

    The world's plane z = 0 touches the Earth at the datum, so 1 km from it the altitude of a point of that plane is
    78 mm above the datum's.

    Args:
        point: x, y, z in the world [m] (3).
        datum: where the world's origin is.
    """
    x, y, z = (float(value) for value in point)
    c, s = cos(datum.heading), sin(datum.heading)
    origin = (degrees(datum.latitude), degrees(datum.longitude), datum.altitude)
    return np.array(enu2geodetic(x * s - y * c, x * c + y * s, z, *origin), dtype=float)


def from_geodetic(place: Sequence[float] | Array, datum: DatumSpec) -> Array:
    """Return the point of the world, x, y, z [m] (3), of a position on the Earth; the inverse of :func:`to_geodetic`.

    Args:
        place: latitude [deg], longitude [deg], altitude above the ellipsoid [m] (3).
        datum: where the world's origin is.
    """
    latitude, longitude, altitude = (float(value) for value in place)
    origin = (degrees(datum.latitude), degrees(datum.longitude), datum.altitude)
    east, north, up = geodetic2enu(latitude, longitude, altitude, *origin)
    c, s = cos(datum.heading), sin(datum.heading)
    return np.array([east * s + north * c, north * s - east * c, up], dtype=float)
