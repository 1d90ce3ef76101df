"""Tyres: forces of a wheel on the road beside Drake's contact."""

from mirdrake.tyres.rolling_resistance import RollingResistance, RollingWheel, make_rolling_wheels

__all__ = ["RollingResistance", "RollingWheel", "make_rolling_wheels"]
