"""Tyres: forces of a wheel on the road beside Drake's contact."""

from mirdrake.tyres.road_friction import RoadFriction
from mirdrake.tyres.rolling_resistance import LOAD_PERIOD, RollingResistance, RollingWheel, make_rolling_wheels
from mirdrake.tyres.wheel_tyres import WheelTyres, make_wheel_tyres

__all__ = [
    "LOAD_PERIOD",
    "RoadFriction",
    "RollingResistance",
    "RollingWheel",
    "WheelTyres",
    "make_rolling_wheels",
    "make_wheel_tyres",
]
