"""Tyres: forces of a wheel on the road beside Drake's contact."""

from mirdrake.tyres.road_friction import RoadFriction
from mirdrake.tyres.rolling_resistance import LOAD_PERIOD, RollingResistance, RollingWheel, make_rolling_wheels

__all__ = ["LOAD_PERIOD", "RoadFriction", "RollingResistance", "RollingWheel", "make_rolling_wheels"]
