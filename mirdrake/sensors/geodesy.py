"""Conversion between the world and the WGS 84 ellipsoid, with pymap3d."""

from collections.abc import Sequence
from math import cos, degrees, pi, sin

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pymap3d import enu2geodetic

from mirdrake.core.yaml_io import Angle, Length, Schema

Array = NDArray[np.float64]


MAX_LATITUDE = 89.9 * pi / 180.0  # east and north are not defined at the poles


class DatumSpec(Schema):
    """Position of the world's origin on the WGS 84 ellipsoid."""

    latitude: Angle = Field(
        default=0.0, ge=-MAX_LATITUDE, le=MAX_LATITUDE, description="[rad] positive north, for example 45 deg"
    )
    longitude: Angle = Field(default=0.0, ge=-pi, le=pi, description="[rad] positive east, for example -81 deg")
    altitude: Length = Field(default=0.0, ge=-1000, le=10_000, description="[m] altitude above the ellipsoid")
    heading: Angle = Field(
        default=0.5 * pi, ge=-2 * pi, le=2 * pi, description="[rad] heading of the world's x axis, clockwise from north"
    )


def to_geodetic(point: Sequence[float] | Array, datum: DatumSpec) -> Array:
    """Return latitude [deg], longitude [deg] and altitude above the ellipsoid [m] of a point of the world (3).

    The world's plane z = 0 touches the Earth at the datum, so 1 km from it the altitude of a point of that plane is
    78 mm above the datum's.

    Args:
        point: x, y, z in the world [m] (3).
        datum: position of the world's origin.
    """
    x, y, z = (float(value) for value in point)
    c, s = cos(datum.heading), sin(datum.heading)
    # pymap3d takes degrees; the local frame is east, north, up at the datum.
    origin = (degrees(datum.latitude), degrees(datum.longitude), datum.altitude)
    # Heading is clockwise from north: the x axis points (sin h, cos h) in (east,
    # north), y is a quarter turn to its left.
    return np.array(enu2geodetic(x * s - y * c, x * c + y * s, z, *origin), dtype=float)
