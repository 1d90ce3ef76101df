"""Car bodies and wheels as glTF, made of outlines.

A car is data: a :class:`~mirdrake.vehicles.bodywork.car.CarOutline` holds the curves of its skin, what is drawn on it,
its small parts and its wheels. :func:`write_outline` makes the two meshes of it, :func:`write_car` those of a car of no
maker in a given size. Frames are ISO 8855 (x ahead, y left, z up; metres); the body's origin is on the road below the
centre of the rear axle, the wheel's at its centre, spinning about y.
"""

from mirdrake.vehicles.bodywork.car import CarOutline, write_outline
from mirdrake.vehicles.bodywork.generic import write_car

__all__ = ["CarOutline", "write_car", "write_outline"]
