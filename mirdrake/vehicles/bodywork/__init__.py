"""Visual meshes of a new vehicle: a parametric body and wheel as glTF, in any size.

Cars, vans and lorries are lofted cross-sections (:mod:`mirdrake.vehicles.bodywork.shell`) with windows, lamps and
wheel arches cut out of them; robots are plates and boxes. Frames are ISO 8855 (x forward, y left, z up; metres). The
origin of the body is on the road below the centre of the rear axle, that of the wheel at its centre, spinning about y.
"""

from mirdrake.vehicles.bodywork.body import BODY_STYLES, write_car

__all__ = ["BODY_STYLES", "write_car"]
